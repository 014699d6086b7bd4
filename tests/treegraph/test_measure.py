"""Quantities derived in one pass: known values, the slow definitions, invariants."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings

from tests.corpus import TREES, make_tree, parents, random_rotation
from tests.treegraph import reference
from treegraph import (
    TreeGraph,
    children,
    count_tips,
    path_length,
    segment_length,
    subtree_length,
    transform,
    tree_from_unsorted,
)

SMALL = {name: tree for name, tree in TREES.items() if tree.n_nodes <= 60}

#       3   4
#        \ /      5
#         2      /      all segments but the trunk's (2 m) are 3-4-5 triangles
#         |    /
#         1 -
#         0
HAND = TreeGraph(
    [-1, 0, 1, 2, 2, 1],
    [(0, 0, 0), (0, 0, 2), (0, 0, 5), (-3, 0, 9), (3, 0, 9), (0, 4, 5)],
    [0.1] * 6,
)


class TestByHand:
    def test_segment_length(self):
        npt.assert_allclose(segment_length(HAND), [0, 2, 3, 5, 5, 5])

    def test_path_length(self):
        npt.assert_allclose(path_length(HAND), [0, 2, 5, 10, 10, 7])

    def test_subtree_length_is_what_a_node_carries(self):
        npt.assert_allclose(subtree_length(HAND), [20, 18, 10, 0, 0, 0])

    def test_count_tips(self):
        assert count_tips(HAND).tolist() == [3, 3, 2, 1, 1, 1]
        assert count_tips(HAND).dtype == np.int32

    def test_children(self):
        start, child = children(HAND)
        assert start.tolist() == [0, 1, 3, 5, 5, 5, 5]
        assert child.tolist() == [1, 2, 5, 3, 4]
        assert start.dtype == np.int64 and child.dtype == np.int32

    def test_roots_of_a_forest_begin_anew(self):
        forest = TreeGraph([-1, 0, -1, 2], [(0, 0, 0), (0, 0, 1), (9, 0, 0), (9, 0, 2)], [0.1] * 4)
        npt.assert_allclose(path_length(forest), [0, 1, 0, 2])
        npt.assert_allclose(subtree_length(forest), [1, 0, 2, 0])
        assert count_tips(forest).tolist() == [1, 1, 1, 1]


@pytest.mark.parametrize("tree", SMALL.values(), ids=SMALL)
class TestAgainstDefinitions:
    def test_lengths(self, tree):
        nodes = range(tree.n_nodes)
        exact = {"rtol": 1e-12, "atol": 1e-12}
        npt.assert_allclose(segment_length(tree), [reference.segment(tree, i) for i in nodes], **exact)
        npt.assert_allclose(path_length(tree), [reference.path_length(tree, i) for i in nodes], **exact)
        npt.assert_allclose(subtree_length(tree), [reference.subtree_length(tree, i) for i in nodes], **exact)

    def test_tips(self, tree):
        want = [reference.count_tips(tree.parent, i) for i in range(tree.n_nodes)]
        assert count_tips(tree).tolist() == want

    def test_children(self, tree):
        start, child = children(tree)
        kids = reference.children(tree.parent)
        assert [child[a:b].tolist() for a, b in zip(start[:-1], start[1:], strict=True)] == [
            kids[i] for i in range(tree.n_nodes)
        ]


class TestInvariants:
    @given(parents())
    @settings(deadline=None)
    def test_sums_are_conserved(self, parent):
        tree = make_tree(parent)
        segment, carried, tips = segment_length(tree), subtree_length(tree), count_tips(tree)
        roots = tree.parent < 0
        assert carried[roots].sum() == pytest.approx(segment.sum())
        assert tips[roots].sum() == len(set(range(len(parent))) - set(parent))
        for i in range(len(parent)):
            kids = np.flatnonzero(tree.parent == i)
            assert carried[i] == pytest.approx((carried[kids] + segment[kids]).sum())
            assert tips[i] == max(1, tips[kids].sum())
            assert (carried[kids] <= carried[i]).all()

    @pytest.mark.parametrize("scale", [1.0, 1e-3, 250.0])
    def test_rigid_motion_and_scale(self, scale):
        rng = np.random.default_rng(3)
        tree = TREES["bush"]
        moved = transform(tree, random_rotation(rng), rng.normal(size=3), scale)
        for measure in (segment_length, path_length, subtree_length):
            npt.assert_allclose(measure(moved), scale * measure(tree), rtol=1e-9, atol=1e-12 * scale)

    def test_order_of_nodes_does_not_matter(self):
        tree = TREES["bush"]
        n = tree.n_nodes
        new = np.random.default_rng(1).permutation(n)
        parent = np.full(n, -1)
        parent[new] = np.where(tree.parent < 0, -1, new[tree.parent])
        position, name = np.empty((n, 3)), np.empty(n, int)
        position[new], name[new] = tree.position, np.arange(n)
        other = tree_from_unsorted(parent, position, attribute={"name": name})
        for measure in (segment_length, path_length, subtree_length, count_tips):
            npt.assert_allclose(measure(other), measure(tree)[other.attribute["name"]], rtol=1e-12)

    def test_no_recursion_on_a_deep_chain(self):
        tree = TREES["deep chain"]
        npt.assert_allclose(path_length(tree) + subtree_length(tree), subtree_length(tree)[0], rtol=1e-10)

    def test_trees_are_not_changed(self):
        tree = make_tree([-1, 0, 0])
        before = tree.parent.copy(), tree.position.copy()
        for measure in (segment_length, path_length, subtree_length, count_tips, children):
            measure(tree)
        npt.assert_array_equal(tree.parent, before[0])
        npt.assert_array_equal(tree.position, before[1])
