"""Features of skeletons and clusters: by hand, and against a slow reference."""

import numpy as np
import numpy.testing as npt
import pytest

from classify._skeleton import REACH, describe_clusters, describe_skeleton, find_branches
from tests.classify.feature_clouds import box_cluster, comb_tree
from tests.corpus import TREES, realistic_tree
from treegraph import TreeGraph, chains, gravelius_order, tree_from_unsorted

HEIGHT = 10.0


@pytest.fixture(scope="module")
def comb():
    return describe_skeleton(comb_tree(), HEIGHT)


def along(position, at):
    """Place at a way along a polyline, held at its ends: slow and obvious."""
    position = np.asarray(position, float)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    return np.array([np.interp(at, way, position[:, c]) for c in range(3)])


def angle(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)


# ---------------------------------------------------------------- by hand


@pytest.mark.parametrize(
    "name, value",
    [
        ("trunk_length", 1.0),
        ("trunk_straightness", 1.0),
        ("trunk_bend", 0.0),
        ("trunk_lean", 0.0),
        ("trunk_tip", 1.0),
        ("order_1_number", 2.0),
        ("order_2_number", 1.0),
        ("order_1_length", 0.2),
        ("order_2_length", 0.1),
        ("order_1_length_to_parent", 0.2),
        ("order_2_length_to_parent", 0.5),
        ("order_1_parent_angle", np.pi / 2),
        ("order_2_parent_angle", np.pi / 2),
        ("order_1_slope", 0.0),
        ("order_2_slope", np.pi / 2),
        ("order_1_first_slope", 0.0),
        ("order_1_straightness", 1.0),
        ("order_1_spacing", 0.2),
        ("order_2_radius_to_parent", 1 / 3),
        ("wood_length", 1.5),
        ("branches_per_metre", 0.2),
        ("lowest_branch", 0.4),
        ("branching_ratio", 0.5),
        ("order_0_share", 10 / 15),
        ("order_1_share", 4 / 15),
        ("order_2_share", 1 / 15),
        ("order_3_share", 0.0),
        ("order_mean", (4 * 1 + 1 * 2) / 15),
        ("wood_slope_1", 4 / 15),
        ("wood_slope_6", 11 / 15),
        ("tips_per_length", 4 * 10 / 15),
        ("heading_evenness", 1.0 - np.sqrt(0.5)),
        ("wood_height", (10 * 5 + 2 * 4 + 2 * 6 + 1 * 4.5) / 15 / 10),
        ("taper_50", 0.125 / 0.185),
    ],
)
def test_the_comb_by_hand(comb, name, value):
    assert comb[name] == pytest.approx(value, abs=1e-9)


def test_means_are_weighted_by_thickness_and_length(comb):
    """Section 5.2 of Stava et al.: D L and D^2 L, for angles D and D^2; D is the largest radius."""
    length, thick = np.array([10.0, 2.0, 2.0, 1.0]), np.array([0.1925, 0.03, 0.03, 0.01])
    slope = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2])
    for power, ending in ((1, ""), (2, "_stout")):
        weight = thick**power * length
        mean = np.average(slope, weights=weight)
        assert comb[f"slope_mean{ending}"] == pytest.approx(mean)
        assert comb[f"slope_spread{ending}"] == pytest.approx(
            np.sqrt(np.average((slope - mean) ** 2, weights=weight))
        )
        assert comb[f"length_mean{ending}"] == pytest.approx(np.average(length / HEIGHT, weights=weight))
        assert comb[f"thickness_mean{ending}"] == pytest.approx(np.average(thick / thick[0], weights=weight))
        assert comb[f"parent_angle_mean{ending}"] == pytest.approx(np.pi / 2)
        assert comb[f"sibling_angle_mean{ending}"] == pytest.approx(np.pi / 2)


def test_volume_of_frustums():
    """A cone of 10 m and 20 cm at the foot, with half of its radius at the top; a branch keeps its own."""
    graph = TreeGraph([-1, 0, 0], [(0, 0, 0), (0, 0, 10), (4, 0, 3)], [0.2, 0.1, 0.05])
    found = describe_skeleton(graph, HEIGHT)
    trunk = np.pi * 10.0 / 3.0 * (0.2**2 + 0.2 * 0.1 + 0.1**2)
    branch = np.pi * 5.0 * 0.05**2
    assert found["wood_volume_m3"] == pytest.approx(trunk + branch)
    assert found["wood_volume"] == pytest.approx((trunk + branch) / 1000.0)
    assert found["trunk_volume_share"] == pytest.approx(trunk / (trunk + branch))


def test_a_bent_branch_is_bent_by_its_angles():
    """A branch along a quarter of a circle turns by 90 degrees, whatever its nodes are."""
    turns = []
    for n in (12, 200):
        t = np.linspace(0.0, np.pi / 2, n)
        arc = np.stack([2.0 * np.sin(t), 0.0 * t, 5.0 + 2.0 * (1.0 - np.cos(t))], axis=1)
        position = np.concatenate([[(0, 0, 0), (0, 0, 5), (0, 0, 10)], arc[1:]])
        parent = [-1, 0, 1, 1, *range(3, len(position) - 1)]
        branches = find_branches(TreeGraph(parent, position, [0.2, 0.15, 0.1] + [0.05] * (n - 1)), HEIGHT)
        turns.append(branches.bend[1])
        assert branches.length[1] == pytest.approx(np.pi, rel=0.01)
        assert branches.straightness[1] == pytest.approx(2.0 * np.sqrt(2.0) / np.pi, rel=0.01)
        assert branches.slope[1] == pytest.approx(np.pi / 4, abs=1e-6)
    assert turns == pytest.approx([np.pi / 2] * 2, rel=0.2)
    assert turns[0] == pytest.approx(turns[1], rel=0.1)


def test_short_twigs_are_no_branches_and_what_they_carry_is_their_parents():
    """A twig of 0.4 m on the trunk forks: its longer prong is a branch of the trunk."""
    at = [(0, 0, 0), (0, 0, 5), (0, 0, 10), (0.1, 0, 5), (0.1, 1.5, 5), (0.3, 0, 5), (0, 0, 6), (0.2, 0, 6)]
    graph = tree_from_unsorted([-1, 0, 1, 1, 3, 3, 1, 6], at, [0.2, 0.15, 0.1, 0.05, 0.02, 0.05, 0.15, 0.01])
    branches = find_branches(graph, HEIGHT)
    assert (branches.length[1:] >= 0.5).all()
    assert (branches.parent[1:] == 0).all()
    assert branches.parent[0] == -1


def test_nothing_is_known_without_a_skeleton():
    assert describe_skeleton(None, HEIGHT) == {}
    assert describe_skeleton(TreeGraph([-1, 0], [(0, 0, 0), (0, 0, 1)], [0.1, 0.1]), HEIGHT) == {}
    assert describe_skeleton(comb_tree(), 0.0) == {}


def test_a_lone_trunk_has_no_branches():
    found = describe_skeleton(
        TreeGraph([-1, 0, 1], [(0, 0, 0), (0, 0, 5), (0, 0, 10)], [0.2, 0.1, 0.05]), HEIGHT
    )
    assert found["order_1_number"] == 0.0
    assert np.isnan([found["order_1_length"], found["branching_ratio"], found["lowest_branch"]]).all()
    assert found["order_0_share"] == 1.0


# ---------------------------------------------------------------- against a slow reference


@pytest.mark.parametrize("name", [*TREES, "realistic"])
def test_branches_are_the_chains_as_table_3_has_them(name):
    graph = realistic_tree(1) if name == "realistic" else TREES[name]
    from classify import _feature_kernels as kernels

    start, node = chains(graph)
    reach = REACH * max(float(np.ptp(graph.position[:, 2])), 0.1)
    parent, column = kernels.branch_table(graph.position, graph.radius, start, node, reach)
    lines = [node[a:b] for a, b in zip(start[:-1], start[1:], strict=True)]
    owner = {}
    for k, line in enumerate(lines[:300]):
        place = graph.position[line]
        if line[0] not in owner:
            owner[line[0]] = k
        owner.update(dict.fromkeys(line[1:], k))
        expected_parent = -1 if owner[line[0]] == k else owner[line[0]]
        assert parent[k] == expected_parent
        if len(line) < 2:
            assert column[k, 0] == 0.0
            continue
        length = np.linalg.norm(np.diff(place, axis=0), axis=1).sum()
        chord = place[-1] - place[0]
        npt.assert_allclose(column[k, :3], [length, np.linalg.norm(chord), chord[2]], atol=1e-9)
        known = graph.radius[line[1:]]
        npt.assert_allclose(column[k, 3], np.nanmax(known) if np.isfinite(known).any() else np.nan)
        npt.assert_allclose(column[k, 4], known[0])
        if expected_parent >= 0 and length > 0.0:
            before = lines[expected_parent]
            at = np.flatnonzero(before == line[0])[0]
            way = np.linalg.norm(np.diff(graph.position[before[: at + 1]], axis=0), axis=1).sum()
            first = along(place, reach) - place[0]
            onwards = along(graph.position[before], way + reach) - along(graph.position[before], way - reach)
            npt.assert_allclose(column[k, [7, 8]], [way, place[0, 2]], atol=1e-9)
            if np.linalg.norm(first) > 1e-9 and np.linalg.norm(onwards) > 1e-9:
                npt.assert_allclose(column[k, 9], angle(first, onwards), atol=1e-6)
                npt.assert_allclose(column[k, 10:], first / np.linalg.norm(first), atol=1e-9)
    keep = column[:, 0] > 0.0
    keep[0] = True
    order = gravelius_order(graph)[[line[-1] for line in lines]]
    npt.assert_array_equal(find_branches(graph, 1e-9).order, order[keep])


def test_siblings_are_the_nearest_on_the_same_parent():
    rng = np.random.default_rng(3)
    at = np.sort(rng.random(12)) * 9.0 + 0.5
    way = rng.normal(size=(12, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    trunk = np.concatenate([[0.0], at, [10.0]])
    position = [(0, 0, z) for z in trunk] + [
        tuple(np.array([0, 0, z]) + 3.0 * w) for z, w in zip(at, way, strict=True)
    ]
    parent = [*range(-1, 13), *range(1, 13)]
    graph = tree_from_unsorted(parent, position, [0.2] * 14 + [0.02] * 12)
    branches = find_branches(graph, HEIGHT)
    order = np.argsort(branches.attached[1:])
    for k, mine in enumerate(1 + order):
        gaps = np.abs(at - at[k])
        gaps[k] = np.inf
        nearest = int(gaps.argmin())
        assert branches.sibling_angle[mine] == pytest.approx(angle(way[k], way[nearest]), abs=1e-6)
        expected = at[k + 1] - at[k] if k < 11 else np.nan
        npt.assert_allclose(branches.spacing[mine], expected, atol=1e-9)


# ---------------------------------------------------------------- clusters


def test_clusters_by_hand():
    boxes = (box_cluster((-1, -1, 6), (2, 1, 7), 60), box_cluster((0, 3, 8), (2, 4, 10), 140))
    found = describe_clusters(boxes, HEIGHT)
    volume, middle = np.array([6.0, 4.0]), np.array([[0.5, 0.0, 6.5], [1.0, 3.5, 9.0]])
    surface = np.array([2 * (6 + 3 + 2), 2 * (2 + 4 + 2)])
    height = np.average(middle[:, 2], weights=volume)
    for name, value in (
        ("number", 2.0),
        ("volume", 10.0),
        ("volume_to_cube", 0.01),
        ("volume_mean", 5.0),
        ("volume_variation", 0.2),
        ("volume_largest", 0.6),
        ("size", np.mean(np.cbrt(volume)) / 10.0),
        ("flatness", np.mean([1.0 / 2.5, 2.0 / 1.5])),
        ("elongation", np.mean([1.5, 2.0])),
        ("sphericity", np.mean(np.cbrt(36.0 * np.pi * volume**2) / surface)),
        ("height_mean", height / 10.0),
        ("height_spread", np.sqrt(np.average((middle[:, 2] - height) ** 2, weights=volume)) / 10.0),
        ("lowest", 0.6),
        ("distance_mean", np.average(np.hypot(*middle[:, :2].T), weights=volume) / 10.0),
        ("density_variation", np.std([10.0, 35.0]) / 22.5),
        ("point_share_largest", 0.7),
        ("seeds", 1.0),
    ):
        assert found[f"cluster_{name}"] == pytest.approx(value, rel=1e-9), name
    assert len(found) == 17


def test_bare_trees_and_unknown_clusters():
    assert describe_clusters((), HEIGHT) == {"cluster_number": 0.0}
    assert describe_clusters(None, HEIGHT) == {}
    assert describe_clusters((box_cluster((0, 0, 0), (1, 1, 1)),), 0.0) == {"cluster_number": 1.0}
