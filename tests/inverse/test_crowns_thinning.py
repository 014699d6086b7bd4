"""Targets made ready for a fit: branches into the leaves of a scan, and thin branches left out."""

import numpy as np
import numpy.testing as npt
import pytest
from inverse_trees import grown

from inverse import cut_into_pieces, fill_crown, thin_out
from treegraph import DEFAULT_ALLOMETRY, Cluster, ClusterTree, InputError, TreeGraph


def box(low, high):
    """A closed hull."""
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
             [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]  # fmt: skip
    low, high = np.array(low, float), np.array(high, float)
    return Cluster(low + corner * (high - low), faces, seed=[], density=10.0, n_points=100)


def scanned(graph, *hulls):
    return ClusterTree(graph, tuple(hulls), None, DEFAULT_ALLOMETRY, np.zeros(3))


POLE = TreeGraph(np.arange(11) - 1, [[0, 0, 0.5 * k] for k in range(11)], np.linspace(0.12, 0.06, 11))
CROWN = scanned(POLE, box((-1.5, -1.5, 4), (1.5, 1.5, 7)), box((1.0, -0.5, 3.0), (2.5, 0.5, 4.5)))


def test_branches_reach_every_part_of_the_clusters():
    graph = fill_crown(CROWN)
    pieces = cut_into_pieces(graph)
    assert pieces.n_pieces - pieces.n_forks > 60
    spacing = (27.0 + 2.25) ** (1 / 3) / 400 ** (1 / 3)
    rng = np.random.default_rng(0)
    inside = rng.uniform((-1.5, -1.5, 4), (1.5, 1.5, 7), (500, 3))
    far = np.linalg.norm(inside[:, None] - graph.position[None], axis=2).min(axis=1)
    assert far.max() < 2.5 * spacing
    assert far.mean() < spacing
    new = graph.position[POLE.n_nodes :]
    assert (new[:, 2] > 2.4).all()  # none where there are no leaves
    assert (np.abs(new) < (2.8, 1.8, 7.3)).all()


def test_what_was_measured_stays():
    graph = fill_crown(CROWN)
    npt.assert_array_equal(graph.parent[:11], POLE.parent)
    npt.assert_array_equal(graph.position[:11], POLE.position)
    assert (graph.radius[:11] >= POLE.radius).all()
    inner = graph.parent[1:]
    assert (graph.radius[inner] >= graph.radius[1:] - 1e-12).all()
    assert (graph.radius > 0.0).all()


def test_more_places_more_branches_and_the_same_every_time():
    counts = [cut_into_pieces(fill_crown(CROWN, places=n)).n_pieces for n in (50, 400, 1200)]
    assert counts[0] < counts[1] < counts[2]
    one, two = fill_crown(CROWN), fill_crown(CROWN)
    npt.assert_array_equal(one.position, two.position)
    npt.assert_array_equal(one.radius, two.radius)


def test_trees_that_need_none_are_left_as_they_are():
    tree = grown("F6b", 9, 1)
    low, high = tree.position.min(axis=0), tree.position.max(axis=0)
    assert fill_crown(scanned(tree)) is tree
    middle = 0.5 * (low + high)
    full = scanned(tree, box(middle - 0.3, middle + 0.3))
    if len(fill_crown(full).parent) == tree.n_nodes:
        assert fill_crown(full) is tree
    seed = TreeGraph([-1], [[0, 0, 0]], [0.1])
    assert fill_crown(scanned(seed, box((0, 0, 1), (1, 1, 2)))) is seed
    along = scanned(POLE, box((-0.1, -0.1, 0.2), (0.1, 0.1, 4.8)))
    assert fill_crown(along, places=20) is POLE


def test_cluster_without_volume_and_one_far_away():
    flat = Cluster([[0, 0, 6], [1, 0, 6], [0, 1, 6]], [[0, 1, 2]], seed=[], density=1.0, n_points=3)
    assert fill_crown(scanned(POLE, flat)) is POLE
    far = fill_crown(scanned(POLE, box((30, 0, 3), (31, 1, 4))), places=30)
    assert far.position[:, 0].max() > 30


@pytest.mark.parametrize("places", [0, 5001])
def test_bad_places(places):
    with pytest.raises(InputError, match="places must be a whole number from 1 to 5000, got"):
        fill_crown(CROWN, places=places)


@pytest.mark.parametrize("branches", [1, 5, 30, 10_000])
def test_thinned_tree_has_no_more_branches_and_keeps_the_thickest(branches):
    tree = grown("F6b", 11, 1)
    thin = thin_out(tree, branches)
    assert cut_into_pieces(thin).n_pieces <= branches
    assert (thin.position[:, None] == tree.position[None]).all(axis=2).any(axis=1).all()
    assert thin.radius[0] == tree.radius[0]
    if branches == 10_000:
        assert thin is tree
    else:
        more = cut_into_pieces(thin).length.sum()
        assert more <= cut_into_pieces(tree).length.sum()


def test_the_thin_branch_goes_with_what_it_carries():
    up = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0.5, 0, 1.5], [0.9, 0, 1.5], [0.5, 0, 2.0], [1, 0, 3], [-1, 0, 3]]
    tree = TreeGraph([-1, 0, 1, 1, 3, 3, 2, 2], up, [0.2, 0.2, 0.2, 0.01, 0.01, 0.01, 0.1, 0.1])
    assert thin_out(tree, 3).position.tolist() == [up[k] for k in (0, 1, 2, 6, 7)]
    with pytest.raises(InputError, match="branches must be 1 or more, got 0"):
        thin_out(tree, 0)
