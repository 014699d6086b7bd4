"""The features as a whole: their table, what is unknown, what must not matter, and what is refused."""

import re
import runpy
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from classify.features import FEATURES, FeatureVector, describe_scan, feature_table
from tests.classify.feature_clouds import (
    as_cluster_tree,
    box_cluster,
    broken_clouds,
    comb_tree,
    grown_tree,
    lollipop,
    turned,
    turned_tree,
)
from tests.corpus import TREES
from treegraph import InputError

ROOT = Path(__file__).parent.parent.parent
GROUPS = {
    "dimensions",
    "slabs",
    "vertical profile",
    "radial profile",
    "local geometry",
    "normals",
    "leaves and twigs",
    "inhomogeneity",
    "stems",
    "skeleton",
    "clusters",
}
#: A crown filled with random points has too few in a few centimetres.
LEAVES = {feature.name for feature in FEATURES if feature.group == "leaves and twigs"}
#: Power of the length in each unit.
POWER = {"": 0, "rad": 0, "m": 1, "m2": 2, "m3": 3, "1/m": -1, "1/m3": -3}


def described(cloud, tree=None):
    return describe_scan(cloud, tree).array


def example_tree():
    """The comb with two clusters: nothing of it is unknown."""
    boxes = [box_cluster((-1, -1, 6), (1.4, 1, 7)), box_cluster((0, -1, 8), (1, 2, 9.5), 300)]
    return as_cluster_tree(comb_tree(), boxes)


def example_cloud(rng, n=30_000):
    return lollipop(rng, crown=(2.0, 1.2), base=4.0, top=10.0, n=n)


# ---------------------------------------------------------------- the table


def test_there_are_more_than_200_features_in_all_groups():
    assert len(FEATURES) > 200
    assert {feature.group for feature in FEATURES} == GROUPS


def test_every_feature_has_a_name_a_unit_and_a_line():
    names = [feature.name for feature in FEATURES]
    assert len(set(names)) == len(names)
    for feature in FEATURES:
        assert re.fullmatch(r"[a-z0-9]+(_[a-z0-9]+)*", feature.name), feature
        assert feature.unit in POWER, feature
        assert 10 < len(feature.text) <= 100, feature
        assert "\n" not in feature.text, feature
        assert "{" not in feature.text, feature


def test_the_table_is_that_of_the_features():
    table = feature_table()
    assert [row["name"] for row in table] == [feature.name for feature in FEATURES]
    assert set(table[0]) == {"name", "unit", "group", "text"}


def test_the_page_is_current():
    script = runpy.run_path(str(ROOT / "docs" / "make_features.py"))
    page = (ROOT / "docs" / "features.md").read_text(encoding="utf-8")
    assert page == script["make_page"](), "write it anew: python docs/make_features.py"


def test_a_vector_is_a_mapping_of_names():
    vector = describe_scan(example_cloud(np.random.default_rng(0)))
    assert list(vector) == [feature.name for feature in FEATURES]
    assert vector["height"] == vector.array[0]
    assert dict(vector)["crown_width"] == vector["crown_width"]
    assert re.fullmatch(r"<FeatureVector \d+ features, \d+ unknown>", repr(vector))
    with pytest.raises(ValueError, match="read-only"):
        vector.array[0] = 1.0
    with pytest.raises(KeyError):
        vector["no such feature"]


# ---------------------------------------------------------------- what is unknown


def test_without_a_skeleton_only_what_needs_it_is_unknown():
    cloud = example_cloud(np.random.default_rng(0))
    vector = describe_scan(cloud)
    needs = {"skeleton", "clusters"}
    names = {feature.name for feature in FEATURES if feature.group in needs}
    names |= {name for name in vector if re.search(r"_tips$|tip_share$|n_leaders|^trunk_width|^breast", name)}
    unknown = {name for name, value in vector.items() if np.isnan(value)}
    assert names <= unknown
    assert unknown - names - LEAVES <= {"layer_10_width"}


def test_with_a_tree_nearly_everything_is_known():
    vector = describe_scan(example_cloud(np.random.default_rng(0)), example_tree())
    unknown = {name for name, value in vector.items() if np.isnan(value)}
    assert unknown - LEAVES == {
        "measured_share",  # the comb does not say
        "order_2_spacing",  # there is one branch of order 2
        "order_2_spacing_variation",
    }


def test_a_graph_without_clusters_tells_nothing_of_them_and_a_bare_tree_has_none():
    cloud = example_cloud(np.random.default_rng(0))
    graph = describe_scan(cloud, comb_tree())
    bare = describe_scan(cloud, as_cluster_tree(comb_tree()))
    assert np.isnan(graph["cluster_number"])
    assert bare["cluster_number"] == 0.0
    assert np.isnan(bare["cluster_volume"])
    assert graph["order_1_number"] == bare["order_1_number"] == 2.0


@pytest.mark.parametrize("name", broken_clouds())
def test_no_cloud_of_ten_points_is_an_error(name):
    """Warnings are errors here: nothing is divided by nothing on the way either."""
    array = described(broken_clouds()[name])
    assert not np.isinf(array).any()
    assert np.isfinite(array[0])


@pytest.mark.parametrize("name", TREES)
def test_no_skeleton_is_an_error(name):
    cloud = np.random.default_rng(0).normal(size=(300, 3)) * [1.0, 1.0, 3.0] + [0.0, 0.0, 5.0]
    array = described(cloud, TREES[name])
    assert not np.isinf(array).any()


@given(seed=st.integers(0, 10**6), n=st.integers(10, 80), digits=st.integers(0, 4), size=st.floats(-2.0, 2.0))
@example(seed=613, n=10, digits=0, size=0.0)  # half the points a metre below the others, the middle between
@settings(deadline=None, max_examples=40)
def test_any_cloud_has_a_description(seed, n, digits, size):
    rng = np.random.default_rng(seed)
    cloud = np.round(rng.normal(size=(n, 3)) * 10.0**size * rng.integers(0, 2, 3), digits)
    array = described(cloud)
    assert not np.isinf(array).any()


def test_points_that_are_all_far_from_their_middle_have_no_heading():
    from classify._thinned import _mean

    middle, heading = _mean(np.full((12, 3), 100.0), np.array([1.0, 2.0, 3.0]), 1.0)
    assert middle.tolist() == [1.0, 2.0, 3.0] and heading == 0.0


# ---------------------------------------------------------------- what must not matter


def test_the_order_of_points_means_nothing_to_the_last_bit():
    rng = np.random.default_rng(1)
    cloud = example_cloud(rng)
    first = described(cloud, example_tree())
    for _ in range(2):
        cloud = cloud[rng.permutation(len(cloud))]
        assert described(cloud, example_tree()).tobytes() == first.tobytes()


@pytest.mark.parametrize("angle", [0.3, 1.7, np.pi / 2, np.pi, 5.0])
def test_the_heading_means_nearly_nothing(angle):
    """Cells whose points rounding moves across an edge may change; nothing else does."""
    cloud, tree = example_cloud(np.random.default_rng(2)), example_tree()
    before = described(cloud, tree)
    after = described(turned(cloud, angle), turned_tree(tree, angle))
    npt.assert_allclose(after, before, rtol=5e-3, atol=5e-4)
    assert (np.isclose(after, before, rtol=1e-5, atol=1e-5) | np.isnan(before)).mean() > 0.9


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_every_feature_grows_with_the_tree_as_its_unit_says(factor):
    """Powers of two, so that cells, too, grow exactly; what is looked at in metres is left out."""
    cloud, tree = example_cloud(np.random.default_rng(3)), example_tree()
    before = described(cloud, tree)
    after = described(cloud * factor, grown_tree(tree, factor))
    for k, feature in enumerate(FEATURES):
        if re.search(r"\dcm|breast", feature.name):
            continue
        expected = before[k] * factor ** POWER[feature.unit]
        npt.assert_allclose(after[k], expected, rtol=1e-6, atol=1e-9, err_msg=feature.name)


def test_what_is_looked_at_in_metres_does_not_grow_with_the_tree():
    """Twice as large a tree of the same twigs: at 45 cm the same shapes, at a share of the size others."""
    rng = np.random.default_rng(4)

    def wires(size, n):  # straight upright wires, a metre long, in a box
        foot = rng.random((n, 3)) * size
        along = np.linspace(0.0, 1.0, 40)
        return (foot[:, None] + along[:, None] * [0.0, 0.0, 1.0]).reshape(-1, 3)

    small, large = describe_scan(wires(5.0, 60)), describe_scan(wires(10.0, 480))
    for name in ("linearity_45cm", "uprightness_45cm", "compactness_45cm"):
        assert small[name] == pytest.approx(large[name], rel=0.1), name
    assert small["linearity_45cm"] > large["linearity_coarse"]


def test_more_points_in_the_same_places_change_hardly_anything():
    cloud = example_cloud(np.random.default_rng(6), n=20_000)
    before, after = (
        describe_scan(cloud, example_tree()),
        describe_scan(np.repeat(cloud, 9, axis=0), example_tree()),
    )
    npt.assert_allclose(after.array, before.array, rtol=0.05, atol=0.02)


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "cloud, message",
    [
        (np.zeros((20, 2)), r"xyz must have shape \(n, 3\), got \(20, 2\)"),
        (np.zeros(30), r"xyz must have shape \(n, 3\), got \(30,\)"),
        (np.zeros((9, 3)), r"xyz must hold at least 10 points to be described, got 9"),
        (np.zeros((0, 3)), r"at least 10 points to be described, got 0"),
        (
            np.array([[0.0, 0.0, k] for k in range(19)] + [[0, np.nan, 0]]),
            r"finite, got .* in row 19 \(1 such",
        ),
        (
            np.full((10, 3), np.inf),
            r"xyz must be finite, got .* in row 0 \(10 such rows\); recon.prepare drops",
        ),
        (np.full((10, 3), 1e160), r"xyz must be within 1e\+09 m of the foot of the trunk, got 1e\+160; are"),
    ],
)
def test_refusals(cloud, message):
    with pytest.raises(InputError, match=message):
        describe_scan(cloud)


def test_a_vector_has_as_many_values_as_there_are_features():
    with pytest.raises(InputError, match=rf"array must have shape \({len(FEATURES)},\), got \(3,\)"):
        FeatureVector(np.zeros(3))
