"""Differences, shape and geometry of trees: by hand, and their properties."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_trees import grown, shuffled, subdivided, trees, turned

from inverse import (
    GEOMETRIC_DESCRIPTORS,
    SHAPE_DESCRIPTORS,
    differences,
    geometric_descriptors,
    geometric_differences,
    geometric_distance,
    minkowski_mean,
    piece_properties,
    shape_descriptors,
    shape_differences,
    shape_distance,
)
from treegraph import TreeGraph, resample, transform

NODE = TreeGraph([-1], [[0, 0, 0]], [0.1])
POLE = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])


def named(names, values):
    return dict(zip(names, values.tolist(), strict=True))


# ---------------------------------------------------------------- differences


def test_equation_4():
    """sigma is a fifth of the smaller: 1 and 1.2 are one sigma apart."""
    npt.assert_allclose(differences([1.0, 1.2], [1.2, 1.0]), 1.0 - math.exp(-0.5))


def test_zero_in_one_tree():
    """Erratum 7: 0 if both are 0, else 1."""
    assert differences([0.0, 0.0, 1e-300], [0.0, 1e-300, 0.0]).tolist() == [0.0, 1.0, 1.0]


def test_resolution_is_the_least_sigma():
    npt.assert_allclose(differences([0.0, 10.0], [0.1, 12.0], [0.1, 0.1]), 1.0 - math.exp(-0.5))


def test_sign_counts_but_not_for_sigma():
    npt.assert_allclose(differences([-1.0], [-1.2]), 1.0 - math.exp(-0.5))
    npt.assert_allclose(differences([-1.0], [1.0]), 1.0)


def test_softness_is_a_factor_on_sigma():
    assert differences([1.0], [1.4], softness=2.0)[0] == pytest.approx(1.0 - np.exp(-0.5))
    assert differences([1.0], [1.4]) > differences([1.0], [1.4], softness=5.0)
    assert differences([0.0, 0.0], [0.0, 0.1], softness=5.0).tolist() == [0.0, 1.0]


def test_missing_values():
    assert differences([math.nan, math.nan, 1.0], [math.nan, 1.0, math.nan]).tolist() == [0.0, 1.0, 1.0]


@given(st.lists(st.floats(0, 1), min_size=1, max_size=9))
def test_minkowski_mean(values):
    got = minkowski_mean(values)
    npt.assert_allclose(got, (sum(x**2.5 for x in values) / len(values)) ** 0.4, atol=1e-12)
    assert np.mean(values) - 1e-9 <= got <= max(values) + 1e-9
    npt.assert_allclose(minkowski_mean(values, 1.0), np.mean(values), atol=1e-12)


# ---------------------------------------------------------------- shape


def fan(height=4.0, reach=1.0, n=4):
    """A stem with n equal level twigs at its top, all around."""
    angle = 2.0 * np.pi * np.arange(n) / n
    tips = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), np.full(n, height)])
    return TreeGraph([-1, 0, *[1] * n], [[0, 0, 0], [0, 0, height], *tips], np.full(n + 2, 0.05))


def mean_height(low, high, least=0.0):
    """Geometric mean of evenly spread heights, by brute force."""
    z = np.linspace(low, high, 400_001)
    return math.exp(np.log(np.maximum(0.5 * (z[1:] + z[:-1]), least)).mean())


@pytest.mark.parametrize("spacing", [10.0, 0.3])
@pytest.mark.parametrize("low", [0.0, 2.0])
def test_planes_between_the_slabs(low, spacing):
    """Upright twigs up to 4 m: the planes are geometric means, of the whole and of its halves."""
    twigs = [[0, 0, 0], [0, 0, low], [0, 0, 4], [0, 0, 4]]
    tree = resample(TreeGraph([-1, 0, 1, 1], twigs, [0.1] * 4), spacing)
    got = named(SHAPE_DESCRIPTORS, shape_descriptors(tree))
    middle = mean_height(low, 4, 0.04)
    planes = [low, mean_height(low, middle, 0.04), mean_height(middle, 4, 0.04), 4.0]
    assert got["height"] == 4.0
    for k, slab in enumerate(("lower", "middle", "upper")):
        npt.assert_allclose(got[f"height_{slab}"], planes[k + 1] - planes[k], atol=1e-6)
        assert got[f"radius_min_{slab}"] == got[f"radius_max_{slab}"] == 0.0


def test_radii_are_those_of_an_ellipse_evenly_filled():
    """Many upright twigs that fill an ellipse of half axes 3 and 1, turned by 0.5."""
    rng = np.random.default_rng(0)
    n = 20_000
    r, phi = np.sqrt(rng.random(n)), 2.0 * np.pi * rng.random(n)
    x, y = 3.0 * r * np.cos(phi), r * np.sin(phi)
    foot = np.column_stack([x, y, np.full(n, 2.0)])
    position = np.concatenate([[[0, 0, 0], [0, 0, 1]], foot, foot + (0, 0, 2)])
    parent = [-1, 0, *[1] * n, *range(2, n + 2)]
    # Beside each twig one without length at its foot, or the way there would belong to the leaf branch.
    parent, position = [*parent, *range(2, n + 2)], np.concatenate([position, foot])
    tree = turned(TreeGraph(parent, position, np.full(len(parent), 0.01)), 0.5)
    got = named(SHAPE_DESCRIPTORS, shape_descriptors(tree))
    npt.assert_allclose([got["radius_max_middle"], got["radius_min_middle"]], [3.0, 1.0], rtol=0.02)
    npt.assert_allclose(got["density_middle"], n / (math.pi * 3.0 * 2.0), rtol=0.03)


def test_crown_of_level_twigs_has_no_height():
    got = named(SHAPE_DESCRIPTORS, shape_descriptors(fan()))
    assert got["height"] == 4.0
    assert got["height_lower"] == got["height_middle"] == 0.0
    npt.assert_allclose(got["height_upper"], 0.0, atol=1e-12)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_round_crown_has_equal_radii(n):
    """A rod of length 1 from the middle: second moment 1/3 along it, so 2 sqrt(1/6) both ways."""
    tall = fan(n=n).replace()
    got = shape_descriptors(tall)
    weight_slab = [k for k in range(3) if got[4 * k + 4] > 0]
    assert len(weight_slab) >= 1
    for k in weight_slab:
        npt.assert_allclose(got[4 * k + 2 : 4 * k + 4], 2.0 * math.sqrt(1.0 / 6.0), rtol=1e-9)


def test_shape_by_hand_of_one_descriptor():
    """The same crown on a stem of 10 and of 12 m: the height differs by 2 m, sigma is a fifth of 11 m."""
    crown = np.array([[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]])
    low, high = (
        TreeGraph([-1, 0, *[1] * 4], [[0, 0, 0], [0, 0, z], *(crown + (0, 0, z))], [0.1] * 6)
        for z in (10.0, 12.0)
    )
    parts = named(SHAPE_DESCRIPTORS, shape_differences(low, high))
    npt.assert_allclose(parts["height"], 1.0 - math.exp(-(2.0**2) / (2.0 * (11.0 / 5.0) ** 2)))
    assert max(value for name, value in parts.items() if name != "height") < 0.01
    npt.assert_allclose(shape_distance(low, high), minkowski_mean([*parts.values()]), atol=1e-12)


def test_shape_sees_what_it_is_for():
    tree = grown("F6b", 9, 1)
    wide = tree.replace(position=tree.position * (1.5, 1.5, 1.0))
    flat = tree.replace(position=tree.position * (1.5, 1.0 / 1.5, 1.0))
    for other, names in ((wide, ("radius_min", "radius_max")), (flat, ("radius_min",))):
        parts = named(SHAPE_DESCRIPTORS, shape_differences(tree, other))
        assert parts["height"] < 1e-9
        assert all(parts[f"{name}_middle"] > 0.3 for name in names)
        assert shape_distance(tree, other) > 0.2


def test_one_node_has_no_shape():
    assert shape_descriptors(NODE).tolist() == [0.0] * 13
    assert shape_distance(NODE, NODE) == 0.0
    assert shape_distance(NODE, POLE) > 0.5


# ---------------------------------------------------------------- geometry


def test_properties_of_table_3():
    """A stem, a level side branch bent by a right angle, and one that goes straight on."""
    position = [[0, 0, 0], [0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 0, 5]]
    tree = TreeGraph([-1, 0, 1, 2, 1], position, [0.2, 0.2, 0.1, 0.05, 0.15])
    got = piece_properties(tree)
    npt.assert_allclose(got["length"], [2, 2, 3])
    npt.assert_allclose(got["thickness"], [0.4, 0.2, 0.3])
    npt.assert_allclose(got["bend"], [0, np.pi / 2, 0], atol=1e-12)
    npt.assert_allclose(got["straightness"], [1, math.sqrt(2) / 2, 1])
    npt.assert_allclose(got["slope"], [np.pi / 2, 0, np.pi / 2], atol=1e-12)
    npt.assert_allclose(got["sibling_angle"], [np.nan, np.pi / 2, np.pi / 2])
    npt.assert_allclose(got["parent_angle"], [np.nan, np.pi / 2, 0], atol=1e-12)


def test_nearest_sibling():
    """Three siblings at 0, 30 and 90 degrees."""
    angle = np.radians([0, 30, 90])
    tips = np.column_stack([np.sin(angle), np.zeros(3), 1 + np.cos(angle)])
    tree = TreeGraph([-1, 0, 1, 1, 1], [[0, 0, 0], [0, 0, 1], *tips], [0.1] * 5)
    npt.assert_allclose(np.degrees(piece_properties(tree)["sibling_angle"][1:]), [30, 30, 60])


def test_weights():
    """Two branches of 1 and 3 m, 0.4 and 0.2 m thick: w' = D L, w'' = D^2 L, angles by D and D^2."""
    position = [[0, 0, 0], [0, 0, 1], [3, 0, 0]]
    tree = TreeGraph([-1, 0, 0], position, [0.2, 0.2, 0.1])
    got = named(GEOMETRIC_DESCRIPTORS, geometric_descriptors(tree))
    length, weight = np.array([1.0, 3.0]), {"all": np.array([0.4, 0.6]), "main": np.array([0.16, 0.12])}
    for kind, w in weight.items():
        mean = (w * length).sum() / w.sum()
        npt.assert_allclose(got[f"length_mean_{kind}"], mean)
        npt.assert_allclose(got[f"length_variance_{kind}"], (w * (length - mean) ** 2).sum() / w.sum())
    npt.assert_allclose(got["slope_mean_all"], 0.4 * np.pi / 2)
    npt.assert_allclose(got["slope_mean_main"], 0.16 / 0.28 * np.pi / 2)
    npt.assert_allclose(got["sibling_angle_mean_all"], np.pi / 2)
    assert math.isnan(got["parent_angle_mean_all"])
    assert len(got) == 28


def test_geometry_by_hand_of_one_descriptor():
    """Stems alike but in their length, which are 1 and 1.2 m long: two of 28 differ, by Eq. 4."""
    stems = [TreeGraph([-1, 0], [[0, 0, 0], [0, 0, z]], [0.1, 0.1]) for z in (1.0, 1.2)]
    parts = named(GEOMETRIC_DESCRIPTORS, geometric_differences(*stems))
    differ = {name for name, value in parts.items() if value > 1e-9}
    assert differ == {"length_mean_all", "length_mean_main"}
    delta = 1.0 - math.exp(-0.5)
    npt.assert_allclose(geometric_distance(*stems), (2.0 / 28.0 * delta**2.5) ** 0.4)


def test_geometry_sees_what_it_is_for():
    tree = grown("F6b", 9, 1)
    thick = tree.replace(radius=tree.radius * 2.0)
    parts = named(GEOMETRIC_DESCRIPTORS, geometric_differences(tree, thick))
    assert {name for name, value in parts.items() if value > 0.5} == {
        f"thickness_{moment}_{kind}" for moment in ("mean", "variance") for kind in ("all", "main")
    }
    hanging = tree.replace(position=tree.position * (1, 1, -1))
    parts = named(GEOMETRIC_DESCRIPTORS, geometric_differences(tree, hanging))
    assert parts["slope_mean_all"] == pytest.approx(1.0)
    assert parts["parent_angle_mean_all"] < 1e-6


def test_trees_without_branches_or_thickness():
    assert geometric_distance(NODE, NODE) == 0.0
    bare = POLE.replace(radius=[0.0, 0.0])
    assert np.isnan(geometric_descriptors(bare)).all()
    assert geometric_distance(bare, bare) == 0.0
    assert geometric_distance(bare, POLE) > 0.5
    assert geometric_distance(POLE, grown()) > 0.1


# ---------------------------------------------------------------- properties of both

DISTANCES = pytest.mark.parametrize("distance", [shape_distance, geometric_distance])


@DISTANCES
@given(a=trees, b=trees)
@settings(deadline=None, max_examples=40)
def test_range_and_symmetry(distance, a, b):
    got = distance(a, b)
    assert 0.0 <= got <= 1.0
    assert distance(b, a) == got
    assert distance(a, a) == 0.0


@DISTANCES
@given(a=trees, b=trees, angle=st.floats(-10, 10), seed=st.integers(0, 100))
@settings(deadline=None, max_examples=40)
def test_invariance(distance, a, b, angle, seed):
    again = shuffled(turned(b, angle), np.random.default_rng(seed))
    moved = transform(again, translation=(30.0, -20.0, 5.0))
    npt.assert_allclose(distance(a, moved), distance(a, b), atol=1e-6)
    assert distance(b, moved) < 1e-6


@DISTANCES
@pytest.mark.parametrize("tree", [fan(), fan(n=5), POLE], ids=["fan", "fan of five", "pole"])
def test_trees_without_a_direction_of_their_own(distance, tree):
    """A round crown, or none at all, has no principal direction that rounding could swap."""
    for angle in np.linspace(0.1, 6.2, 9):
        assert distance(tree, turned(tree, angle)) < 1e-6


@DISTANCES
def test_sampling(distance):
    tree = grown("F6b", 9, 1)
    assert distance(tree, subdivided(tree, 3)) < 0.01
    assert distance(tree, resample(tree, 0.1)) < 0.05


@DISTANCES
def test_continuity(distance):
    """Noise on all nodes but the root: the less, the nearer."""
    tree, other = grown("F6b", 9, 1), grown("F6b", 9, 2)
    noise = np.random.default_rng(0).normal(size=tree.position.shape)
    noise[0] = 0.0
    before, last = distance(tree, other), 1.0
    for size in (1e-2, 1e-3, 1e-4, 1e-5):
        noisy = tree.replace(position=tree.position + size * noise)
        itself = distance(tree, noisy)
        assert itself < last
        last = itself
    assert last < 1e-4
    assert abs(distance(noisy, other) - before) < 1e-3
