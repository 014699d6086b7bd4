"""Leaf clusters through a tree's life (thesis 4.3.2, Eq. 4.4 and 4.5)."""

import numpy as np
import numpy.testing as npt
import pytest

from plastic import Seasons, grow_crown, seasons_of
from plastic.crowns import LEAST_RADIUS, leaf_clusters, virtual_clusters
from tests.plastic.plastic_trees import ball_cluster, grown_state, grown_tree, mirrored_tree, palm
from treegraph import DEFAULT_ALLOMETRY, Cluster, ClusterTree, TreeGraph


def with_clusters(graph, *clusters):
    return ClusterTree(graph, tuple(clusters), None, DEFAULT_ALLOMETRY, np.zeros(3))


def seasons(birth):
    """Seasons with given births and nothing else."""
    birth = np.array(birth, np.int32)
    n = len(birth)
    return Seasons(1.0, np.ones(n), birth.astype(float), float(birth.max()), birth, int(birth.max()) + 1, 1.0)


def group(crown, g):
    """Centres, radii and seats of a group."""
    rows = range(crown.first[g], crown.first[g + 1])
    seats = [crown.seat[crown.seat_first[s] : crown.seat_first[s + 1]].tolist() for s in rows]
    return crown.center[list(rows)], crown.radius[list(rows)], seats


FORK = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 2], [1, 0, 4], [-1, 0, 4]], [0.1] * 4)
BIRTH = seasons([0, 0, 1, 1])


# ---------------------------------------------------------------- clusters of the present


def test_a_hull_becomes_a_ball_of_its_volume():
    tree = with_clusters(FORK, ball_cluster((1, 0, 4.5), 0.7, 2))
    center, radius, seats = leaf_clusters(FORK, tree.clusters)
    npt.assert_allclose(center, [[1, 0, 4.5]], atol=1e-12)
    npt.assert_allclose(radius, [0.7], rtol=1e-12)
    assert [s.tolist() for s in seats] == [[2]]


def test_a_flat_hull_has_the_spread_of_its_corners():
    square = Cluster([[0, 0, 4], [2, 0, 4], [2, 2, 4], [0, 2, 4]], [[0, 1, 2], [0, 2, 3]], [2], 1.0, 4)
    center, radius, _ = leaf_clusters(FORK, (square,))
    npt.assert_allclose(center, [[1, 1, 4]])
    npt.assert_allclose(radius, [np.sqrt(5 / 3 * 2)])


def test_clusters_sit_on_the_ends_of_what_follows_their_seeds():
    """Seed 1 is at the fork: both tips follow it within 1.2 radii, if the ball is large enough."""
    for radius, wanted in ((3.0, [2, 3]), (0.5, [1])):
        _, _, seats = leaf_clusters(FORK, (ball_cluster((0, 0, 3), radius, 1),))
        assert seats[0].tolist() == wanted


def test_what_follows_another_seed_belongs_to_that():
    _, _, seats = leaf_clusters(FORK, (ball_cluster((0, 0, 3), 3.0, 1), ball_cluster((1, 0, 4), 0.3, 2)))
    assert [s.tolist() for s in seats] == [[3], [2]]


def test_without_seeds_the_nearest_node_is_taken():
    cluster = ball_cluster((1.2, 0, 4.5), 0.3, [])
    assert leaf_clusters(FORK, (cluster,))[2][0].tolist() == [2]


def test_a_bare_tree_gets_clusters_at_its_tips():
    graph = grown_tree().graph
    center, radius, seats = virtual_clusters(graph)
    tips = np.setdiff1d(np.arange(graph.n_nodes), graph.parent)
    assert sorted(np.concatenate(seats).tolist()) == tips.tolist()
    assert (radius > 0).all()
    assert len(radius) == round(len(tips) / 6)
    for k, nodes in enumerate(seats):
        npt.assert_allclose(center[k], graph.position[nodes].mean(axis=0))


def test_a_palm_has_one_round_crown():
    center, radius, seats = virtual_clusters(palm())
    assert len(radius) == 1
    npt.assert_allclose(center[0, :2], 0.0, atol=1e-12)
    npt.assert_allclose(radius[0], np.sqrt(5 / 3) * 1.5)


# ---------------------------------------------------------------- back through the seasons


def test_equation_45_as_printed():
    """Two clusters meet at the fork: r^3 = (r1^3 + r2^3) (d_n / d_1) (d_n / d_2)."""
    tree = with_clusters(FORK, ball_cluster((1, 0, 5), 0.8, 2), ball_cluster((-1, 0, 5), 0.8, 3))
    crown = grow_crown(tree, BIRTH, taper=1.0)
    center, radius, seats = group(crown, 1)
    assert seats == [[1]]
    npt.assert_allclose(center, [[0, 0, 2]])
    npt.assert_allclose(radius**3, 2 * 0.8**3 * (2 / np.sqrt(26)) ** 2, rtol=1e-12)


def test_the_ratio_is_cubed_by_default():
    tree = with_clusters(FORK, ball_cluster((1, 0, 5), 0.8, 2), ball_cluster((-1, 0, 5), 0.8, 3))
    printed, cubed = (group(grow_crown(tree, BIRTH, **more), 1)[1] for more in ({"taper": 1.0}, {}))
    whole = (2 * 0.8**3) ** (1 / 3)
    npt.assert_allclose(cubed / whole, (printed / whole) ** 3, rtol=1e-12)


def test_a_cluster_never_grows_towards_the_past():
    """A weeping branch: the new centre is farther from the root than the old one."""
    graph = TreeGraph([-1, 0, 1], [[0, 0, 0], [0, 0, 5], [1, 0, 1]], [0.1] * 3)
    tree = with_clusters(graph, ball_cluster((1, 0, 0.5), 0.6, 2))
    _, radius, _ = group(grow_crown(tree, seasons([0, 0, 1])), 1)
    npt.assert_allclose(radius, 0.6, rtol=1e-12)


def test_clusters_that_lose_nothing_stay():
    graph = TreeGraph([-1, 0, 1, 1], FORK.position, [0.1] * 4)
    tree = with_clusters(graph, ball_cluster((1, 0, 5), 0.8, 2), ball_cluster((-1, 0, 5), 0.5, 3))
    crown = grow_crown(tree, seasons([0, 0, 1, 2]))
    center, radius, seats = group(crown, 2)
    assert sorted(seats) == [[1], [2]]
    kept = seats.index([2])
    npt.assert_allclose(center[kept], [1, 0, 5], atol=1e-12)
    npt.assert_allclose(radius[kept], 0.8, rtol=1e-12)


def test_the_larger_share_gives_the_cluster():
    """One cluster sits on both branches of a fork, another only on one: the fork is the first one's."""
    tree = with_clusters(FORK, ball_cluster((0, 0, 5), 1.0, [2, 3]), ball_cluster((-1, 0, 5), 0.3, 3))
    crown = grow_crown(tree, BIRTH, taper=0.0)
    _, radius, seats = group(crown, 1)
    assert seats == [[1]]
    npt.assert_allclose(radius**3, 1.0 + 0.3**3, rtol=1e-12)


@pytest.mark.parametrize("age", [6, 9])
def test_without_taper_no_volume_is_lost(age):
    tree = grown_tree(age)
    found = seasons_of(tree.graph, fewest=8, most=24)
    crown = grow_crown(tree, found, taper=0.0)
    total = [(group(crown, g)[1] ** 3).sum() for g in range(1, found.count + 1)]
    npt.assert_allclose(total, total[-1], rtol=1e-6)


def test_young_trees_have_few_leaves():
    """Leaf area of grown trees goes with the reach to the power of 2.6 to 4."""
    crown = grown_state(14).crown
    total = np.array([(group(crown, g)[1] ** 3).sum() for g in range(1, len(crown.first) - 1)])
    assert (np.diff(total) >= -1e-9).all()
    half = len(total) // 2
    assert total[half] < 0.5 * total[-1]
    assert total[2] < 0.02 * total[-1]


@pytest.mark.parametrize("state", [grown_state(), grown_state(8, "F6e")], ids=["F6b", "F6e"])
def test_sites_sit_on_what_has_grown(state):
    crown, birth = state.crown, state.seasons.birth
    assert crown.first[0] == 0
    assert crown.first[-1] == len(crown.radius)
    for g in range(1, state.seasons.count + 1):
        _, radius, seats = group(crown, g)
        assert (radius >= LEAST_RADIUS).all()
        for nodes in seats:
            assert len(nodes) > 0
            assert nodes == sorted(set(nodes))
            assert (birth[nodes] <= g - 1).all()
    last = group(crown, state.seasons.count)
    assert len(last[1]) == len(state.tree.clusters)


def test_nodes_look_at_the_season_before_theirs():
    state = grown_state()
    crown, birth, parent = state.crown, state.seasons.birth, state.tree.graph.parent
    inner = parent >= 0
    assert (crown.look[inner] >= crown.first[birth[inner]]).all()
    assert (crown.look[inner] < crown.first[birth[inner] + 1]).all()
    assert (crown.look[~inner] == -1).all()


def test_mirrored_trees_have_mirrored_crowns():
    tree = mirrored_tree()
    crown = grow_crown(tree, seasons_of(tree.graph, fewest=8, most=24))
    for g in range(1, len(crown.first) - 1):
        center, radius, _ = group(crown, g)
        rows = np.column_stack([center, radius]).round(9) + 0.0
        other = rows * (-1, 1, 1, 1) + 0.0
        assert sorted(map(tuple, rows)) == sorted(map(tuple, other))
