"""Trees cut at their forks."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from inverse_trees import grown, shuffled, subdivided, trees

from inverse import cut_into_pieces
from treegraph import (
    Cluster,
    ClusterTree,
    InputError,
    TreeGraph,
    find_allometry,
    resample,
    segment_length,
    take_nodes,
)


def y_tree(**changes):
    """A stem of two segments that forks into one and two segments."""
    position = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 3], [-1, 0, 3], [-1, 1, 3]]
    return TreeGraph([-1, 0, 1, 2, 2, 4], position, [0.3, 0.2, 0.18, 0.05, 0.1, 0.07]).replace(**changes)


def test_by_hand():
    pieces = cut_into_pieces(y_tree())
    assert (pieces.n_forks, pieces.n_pieces) == (1, 3)
    assert pieces.parent.tolist() == [-1, 0, 0]
    npt.assert_allclose(pieces.length, [2.0, math.sqrt(2.0), math.sqrt(2.0) + 1.0])
    npt.assert_allclose(pieces.thickness, [0.6, 0.1, 0.2])
    npt.assert_allclose(pieces.bend, [0.0, 0.0, np.pi / 2], atol=1e-12)
    npt.assert_allclose(pieces.joint, [0.0, np.pi / 4, np.pi / 4], atol=1e-12)
    assert pieces.first.tolist() == [0, 2, 2]
    assert pieces.last.tolist() == [2, 3, 5]
    assert pieces.piece_of.tolist() == [0, 0, 0, 1, 2, 2]
    assert repr(pieces) == "<Pieces 1 forks, 2 tips>"
    assert cut_into_pieces(pieces) is pieces


def test_every_segment():
    pieces = cut_into_pieces(y_tree(), every_segment=True)
    assert (pieces.n_forks, pieces.n_pieces) == (3, 5)
    npt.assert_allclose(np.sort(pieces.length), np.sort(segment_length(y_tree())[1:]))
    npt.assert_allclose(pieces.bend, 0.0)


def test_root_that_is_a_fork_begins_with_a_piece_without_length():
    pieces = cut_into_pieces(TreeGraph([-1, 0, 0], [[0, 0, 0], [1, 0, 1], [-1, 0, 1]], [0.2, 0.1, 0.1]))
    assert pieces.parent.tolist() == [-1, 0, 0]
    assert (pieces.length[0], pieces.thickness[0], pieces.first[0], pieces.last[0]) == (0.0, 0.0, 0, 0)


def test_one_node():
    pieces = cut_into_pieces(TreeGraph([-1], [[0, 0, 0]], [0.1]))
    assert (pieces.n_pieces, pieces.n_forks, pieces.length[0]) == (1, 0, 0.0)


def test_cluster_tree_counts_by_its_graph():
    hull = Cluster(np.eye(3), [[0, 1, 2]], [3], 1.0, 5)
    tree = ClusterTree(y_tree(), (hull,), None, find_allometry(None), np.zeros(3))
    npt.assert_array_equal(cut_into_pieces(tree).length, cut_into_pieces(y_tree()).length)


@given(trees)
@settings(deadline=None, max_examples=60)
def test_order_of_pieces(tree):
    """Forks first and depth-first, then tips by their forks; lengths and nodes are all there once."""
    for every in (False, True):
        pieces = cut_into_pieces(tree, every_segment=every)
        m, k = pieces.n_pieces, pieces.n_forks
        assert (pieces.parent < np.maximum(np.arange(m), 0)).all()
        assert set(pieces.parent[1:].tolist()) == set(range(k))
        assert (np.diff(pieces.parent[k:]) >= 0).all()
        for i in range(k):
            above = [j for j in range(k) if i in ways_down(pieces.parent, j)]
            assert above == list(range(i, i + len(above)))
        npt.assert_allclose(pieces.length.sum(), segment_length(tree).sum())
        npt.assert_array_equal(pieces.first[1:], pieces.last[pieces.parent[1:]])
        assert (pieces.piece_of[pieces.last] == np.arange(m)).all()


def ways_down(parent, i):
    while i >= 0:
        yield i
        i = parent[i]


@given(trees)
@settings(deadline=None, max_examples=40)
def test_order_of_children_does_not_matter(tree):
    one, two = cut_into_pieces(tree), cut_into_pieces(shuffled(tree, np.random.default_rng(1)))
    for name in ("length", "thickness", "bend", "joint"):
        npt.assert_allclose(np.sort(getattr(one, name)), np.sort(getattr(two, name)), atol=1e-12)


# ---------------------------------------------------------------- thickness


def test_side_branch_is_not_as_thick_as_the_fork_it_sits_on():
    """However finely its first segment is cut, with the fork's radius spread along it."""
    tree = y_tree()
    for finer in (resample(tree, 0.1), resample(tree, 0.01)):
        npt.assert_allclose(cut_into_pieces(finer).thickness, [0.6, 0.1, 0.2], rtol=0.1)
    short = take_nodes(tree, [0, 1, 2, 3, 4])  # nothing but straight branches: to the last digit
    for finer in (short, resample(short, 0.5), resample(short, 0.01)):
        npt.assert_allclose(cut_into_pieces(finer).thickness, [0.6, 0.1, 0.2], rtol=1e-9)


def test_nodes_that_say_something_count():
    """A thick node off the line between its neighbours' radii, or off their line."""
    thick = TreeGraph([-1, 0, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2]], [0.1, 0.3, 0.1])
    assert cut_into_pieces(thick).thickness.tolist() == [0.6]
    branch = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 1], [2, 0, 1.01]]
    bent = TreeGraph([-1, 0, 1, 1, 3], branch, [0.3, 0.3, 0.3, 0.2, 0.1])
    assert cut_into_pieces(bent).thickness.tolist() == [0.6, 0.6, 0.4]
    straight = bent.replace(position=[*branch[:4], [2, 0, 1]])
    assert cut_into_pieces(straight).thickness.tolist() == [0.6, 0.6, 0.2]


def test_cone_is_as_thick_as_its_mean():
    trunk = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 1]]
    tree = TreeGraph([-1, 0, 1, 1], trunk, [0.3, 0.3, 0.1, 0.0])
    assert cut_into_pieces(tree).thickness.tolist() == [0.6, 0.2, 0.3]


def test_grown_tree_resampled_has_the_same_pieces():
    tree = subdivided(grown(), 1)
    one, two = cut_into_pieces(tree), cut_into_pieces(subdivided(tree, 4))
    for name in ("length", "thickness", "bend", "joint"):
        npt.assert_allclose(getattr(one, name), getattr(two, name), atol=1e-7)


# ---------------------------------------------------------------- errors


def test_several_roots():
    with pytest.raises(InputError, match="must have one root, got 2; compare its trees one by one"):
        cut_into_pieces(TreeGraph([-1, -1], np.eye(3)[:2], [0.1, 0.1]))


def test_unknown_radii():
    with pytest.raises(InputError, match=r"must have known radii, but that of node 3 is not; 1 of 6 nodes"):
        cut_into_pieces(y_tree(radius=[0.3, 0.2, 0.18, math.nan, 0.1, 0.07]))


def test_radius_of_the_root_may_be_unknown():
    pieces = cut_into_pieces(y_tree(radius=[math.nan, 0.2, 0.18, 0.05, 0.1, 0.07]))
    assert pieces.thickness.tolist() == [0.4, 0.1, 0.2]


@pytest.mark.parametrize("what", ["position", "radius"])
def test_numbers_too_large_to_be_squared(what):
    tree = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 1]], [1.0, 1.0])
    huge = tree.replace(**{what: getattr(tree, what) * 1e200})
    with pytest.raises(InputError, match=r"coordinates and radii up to 1e\+09 m, got 1e\+200 m"):
        cut_into_pieces(huge)
    assert cut_into_pieces(tree.replace(**{what: getattr(tree, what) * 1e8})).n_pieces == 1
