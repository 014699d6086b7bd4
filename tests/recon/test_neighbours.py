import numpy as np
import numpy.testing as npt
import pytest

from recon.neighbours import (
    bridge_gaps,
    components,
    neighbour_graph,
    shortest_paths,
    trusted_graph,
)


def edges(graph):
    owner = np.repeat(np.arange(graph.n_points), np.diff(graph.start))
    return dict(zip(zip(owner.tolist(), graph.neighbour.tolist(), strict=True), graph.length, strict=True))


def slow_neighbours(xyz, k):
    distance = np.linalg.norm(xyz[:, None] - xyz[None], axis=2)
    found = {}
    for i in range(len(xyz)):
        for j in np.argsort(distance[i])[1 : k + 1]:
            found[i, int(j)] = found[int(j), i] = distance[i, j]
    return found


def slow_distances(n, weight, source):
    best = np.full(n, np.inf)
    best[source] = 0
    for _ in range(n):
        for (i, j), w in weight.items():
            best[j] = min(best[j], best[i] + w)
    return best


@pytest.mark.parametrize("k", [1, 4, 9])
def test_graph_is_the_symmetric_nearest_neighbours(rng, k):
    xyz = rng.random((80, 3))
    got, wanted = edges(neighbour_graph(xyz, k)), slow_neighbours(xyz, k)
    assert got.keys() == wanted.keys()
    npt.assert_allclose([got[e] for e in wanted], list(wanted.values()))


def test_two_points_and_one():
    assert edges(neighbour_graph(np.array([[0.0, 0, 0], [0, 0, 2]]), 10)) == {(0, 1): 2.0, (1, 0): 2.0}
    assert neighbour_graph(np.zeros((1, 3)), 10).neighbour.size == 0


def test_duplicates_do_not_break_the_graph(rng):
    xyz = np.repeat(rng.random((20, 3)), 3, axis=0)
    graph = bridge_gaps(xyz, neighbour_graph(xyz, 4))
    assert components(graph)[0] == 1
    assert (graph.length > 0).all()


def test_gap_is_bridged_at_its_narrowest_place(rng):
    lower = rng.random((300, 3)) * [0.1, 0.1, 1.0]
    upper = rng.random((300, 3)) * [0.1, 0.1, 1.0] + [0, 0, 1.4]
    xyz = np.concatenate([lower, upper])
    graph = neighbour_graph(xyz, 8)
    assert components(graph)[0] == 2
    joined = bridge_gaps(xyz, graph)
    assert components(joined)[0] == 1
    across = [d for (i, j), d in edges(joined).items() if (i < 300) != (j < 300)]
    narrowest = np.linalg.norm(lower[:, None] - upper[None], axis=2).min()
    assert min(across) < narrowest * 1.1
    near = edges(graph)
    assert all(edges(joined)[e] == pytest.approx(d) for e, d in near.items())


def test_many_pieces_become_one(rng):
    xyz = np.concatenate([rng.random((15, 3)) * 0.05 + rng.random(3) * 4 for _ in range(40)])
    assert components(bridge_gaps(xyz, neighbour_graph(xyz, 5)))[0] == 1


def test_connected_graph_is_left_alone(rng):
    xyz = rng.random((100, 3))
    graph = neighbour_graph(xyz, 10)
    assert bridge_gaps(xyz, graph) is graph


def test_shortest_paths_match_relaxation(rng):
    xyz = rng.random((40, 3))
    graph = bridge_gaps(xyz, neighbour_graph(xyz, 4))
    distance, before = shortest_paths(graph, np.array([3]), graph.length)
    npt.assert_allclose(distance, slow_distances(40, edges(graph), 3))
    weight = edges(graph)
    for i in range(40):
        if i != 3:
            assert distance[i] == pytest.approx(distance[before[i]] + weight[before[i], i])


@pytest.mark.parametrize("beta, direct", [(1.0, True), (2.0, False)])
def test_beta_prefers_many_short_steps(beta, direct):
    # from 0 to 2 directly 1.9, over 1 it is 1 + 1: 1.9 < 2 but 1.9^2 > 1 + 1
    xyz = np.array([[0.0, 0, 0], [np.sqrt(1 - 0.95**2), 0, 0.95], [0, 0, 1.9]])
    graph = neighbour_graph(xyz, 2)
    kept = edges(trusted_graph(graph, np.array([0]), beta, reach=0.0))
    assert ((0, 2) in kept) == direct
    assert ((1, 2) in kept) != direct


def test_trusted_graph_keeps_short_edges_and_all_points_reachable(rng):
    xyz = rng.random((200, 3)) * [1, 1, 4]
    graph = bridge_gaps(xyz, neighbour_graph(xyz, 8))
    kept = trusted_graph(graph, np.array([0]), 1.5, reach=0.2)
    assert np.isfinite(shortest_paths(kept, np.array([0]), kept.length)[0]).all()
    assert set(edges(kept)) <= set(edges(graph))
    assert {e for e, d in edges(graph).items() if d <= 0.2} <= set(edges(kept))


def test_two_groups_of_many_clumps_far_apart_are_joined():
    """Every clump finds only clumps of its own group, at any distance; the groups are joined all the same."""
    rng = np.random.default_rng(0)
    clumps = [
        [60.0 * group, 1.0 * i, 1.0 * j] + rng.normal(0.0, 0.01, (14, 3))
        for group in range(2) for i in range(6) for j in range(6)
    ]  # fmt: skip
    xyz = np.concatenate(clumps)
    graph = bridge_gaps(xyz, neighbour_graph(xyz, 4))
    assert components(graph)[0] == 1
