"""Axes, orders and chains: examples by hand and after the thesis, the rule word by word, invariants."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corpus import TREES, make_tree, parents, random_rotation
from tests.treegraph import reference
from treegraph import (
    InputError,
    TreeGraph,
    chains,
    continue_axis,
    gravelius_order,
    segment_length,
    transform,
)

SMALL = {name: tree for name, tree in TREES.items() if tree.n_nodes <= 60}
EXACT = {name: tree for name, tree in SMALL.items() if name != "a million metres off"}


def fork(angles_deg, radii, lengths=None):
    """A vertical metre of trunk, then one straight child per deviation angle, in one plane."""
    lengths = [1.0] * len(angles_deg) if lengths is None else lengths
    tips = [
        (length * math.sin(math.radians(a)), 0.0, 1.0 + length * math.cos(math.radians(a)))
        for a, length in zip(angles_deg, lengths, strict=True)
    ]
    return TreeGraph([-1, 0] + [1] * len(tips), [(0, 0, 0), (0, 0, 1), *tips], [0.2, 0.2, *radii])


def chain_lists(tree):
    start, node = chains(tree)
    return [node[a:b].tolist() for a, b in zip(start[:-1], start[1:], strict=True)]


def relabelled(tree, rng):
    """The same tree with its nodes in another topological order; and the old index of each node."""
    new_order, ready = [], np.flatnonzero(tree.parent < 0).tolist()
    while ready:
        node = ready.pop(int(rng.integers(len(ready))))
        new_order.append(node)
        ready += np.flatnonzero(tree.parent == node).tolist()
    old = np.array(new_order)
    rank = np.empty(old.size, int)
    rank[old] = np.arange(old.size)
    parent = np.where(tree.parent[old] < 0, -1, rank[tree.parent[old]])
    return TreeGraph(parent, tree.position[old], tree.radius[old]), old


class TestContinuingChild:
    @pytest.mark.parametrize(
        "angles, radii, lengths, winner",
        [
            ([40, 10], [0.1, 0.1], [1, 1], 1),  # smallest deviation angle (thesis 5.2.2)
            ([-40, 10, 60], [0.1, 0.1, 0.1], [1, 1, 1], 1),
            ([40, 0], [0.1, 0.069], [1, 1], 0),  # too thin to go on, however straight
            ([40, 0], [0.1, 0.071], [1, 1], 1),
            ([40, 0], [0.1, 0.1], [1, 0.49], 0),  # too short
            ([40, 0], [0.1, 0.1], [1, 0.51], 1),
            ([40, 20, 0], [0.1, 0.09, 0.02], [1, 1, 9], 1),  # the thin one does not make the others short
            ([40, 0], [0.1, math.nan], [1, 1], 1),  # an unknown radius does not drop out
            ([30, -30], [0.1, 0.11], [1, 1], 1),  # an even fork: thicker
            ([30, -30], [0.1, 0.1], [1, 1.2], 1),  # then longer
            ([30, -30], [0.1, 0.1], [1, 1], 0),  # then first
            ([30, -30], [math.nan, 0.1], [1.2, 1], 0),  # thickness unknown: longer
            ([170, 90], [0.1, 0.1], [1, 1], 1),
        ],
    )
    def test_by_hand(self, angles, radii, lengths, winner):
        assert continue_axis(fork(angles, radii, lengths))[1] == 2 + winner

    def test_length_is_that_of_the_longest_way_not_of_all_wood(self):
        # child 2 carries much wood in short twigs, child 3 leads far
        tree = TreeGraph(
            [-1, 0, 1, 1, 2, 2, 2, 2, 3],
            [(0, 0, 0), (0, 0, 1), (0, 0, 2), (1, 0, 2)]
            + [(0.3, 0, 2.2), (-0.3, 0, 2.2), (0, 0.3, 2.2), (0, -0.3, 2.2), (3, 0, 4)],
            [0.1] * 9,
        )
        assert continue_axis(tree)[1] == 3

    def test_a_root_has_no_direction(self):
        tree = TreeGraph([-1, 0, 0], [(0, 0, 0), (1, 0, 0), (0, 0, 0.9)], [0.1, 0.1, 0.2])
        assert continue_axis(tree)[0] == 2

    def test_a_root_has_no_direction_in_any_octant(self):
        tree = TreeGraph([-1, 0, 0], [(0, 0, 0), (1, 1, 1), (-1, -1, -1)], [0.1, 0.1, 0.11])
        assert continue_axis(tree)[0] == 2

    def test_zero_length_segment_keeps_the_direction_below_it(self):
        tree = TREES["zero-length segment"]  # at node 2, which lies on node 1, straight up goes on
        assert continue_axis(tree).tolist() == [1, 2, 3, -1, -1]

    @pytest.mark.parametrize("turn", range(10))
    def test_rounding_does_not_choose_the_leader_of_an_even_fork(self, turn):
        rng = np.random.default_rng(turn)
        tree = transform(fork([33, -33], [0.1, 0.101]), random_rotation(rng), rng.normal(size=3) * 10)
        assert continue_axis(tree)[1] == 3

    @pytest.mark.parametrize("kids", [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]])
    def test_one_unknown_radius_makes_no_circle(self, kids):
        """Pairwise comparison of (0.10, 1.5 m), (0.12, 1.2 m), (unknown, 1.4 m) has no winner."""
        radii, lengths = [0.10, 0.12, math.nan], [1.5, 1.2, 1.4]
        tree = TreeGraph(
            [-1, 0, 0, 0], [(0, 0, 0), *[(0, 0, lengths[k]) for k in kids]], [0.2, *[radii[k] for k in kids]]
        )
        assert kids[continue_axis(tree)[0] - 1] == 0

    @pytest.mark.parametrize("tree", EXACT.values(), ids=EXACT)
    def test_follows_the_rule(self, tree):
        want = [reference.axis_child(tree, i) for i in range(tree.n_nodes)]
        assert continue_axis(tree).tolist() == want

    @given(parents(25), st.integers(0, 3))
    @settings(deadline=None)
    def test_follows_the_rule_on_random_trees(self, parent, seed):
        tree = coarse(parent, seed)
        assert continue_axis(tree).tolist() == [reference.axis_child(tree, i) for i in range(len(parent))]


def coarse(parent, seed):
    """A tree on a grid with few different radii, some unknown: ties, doubled nodes, straight lines."""
    rng = np.random.default_rng(seed)
    n = len(parent)
    radius = rng.choice([0.05, 0.1, 0.102, math.nan], n)
    return TreeGraph(parent, rng.integers(0, 3, (n, 3)), radius)


class TestGraveliusOrder:
    def test_thesis_rule(self):
        """The child with the smallest deviation angle keeps the level, the others are one higher (5.2.2)."""
        assert gravelius_order(fork([0, 50, -70], [0.1, 0.09, 0.08])).tolist() == [0, 0, 0, 1, 1]

    def test_levels_add_up_along_side_branches(self):
        tree = TREES["comb"]
        order = gravelius_order(tree)
        trunk = [0, *range(1, tree.n_nodes, 2)]
        assert order.dtype == np.int32
        npt.assert_array_equal(order[trunk], 0)
        npt.assert_array_equal(order[2:-1:2], 1)
        assert order[-1] == 0  # the topmost tooth is the only child of the last node of the trunk

    def test_third_order(self):
        #  0-1-2 trunk upwards; 3-4 leaves 1; 5 leaves 3
        tree = TreeGraph(
            [-1, 0, 1, 1, 3, 3],
            [(0, 0, 0), (0, 0, 1), (0, 0, 3), (1, 0, 1.2), (2, 0, 1.4), (1, 0.5, 1.8)],
            [0.2, 0.2, 0.1, 0.05, 0.04, 0.02],
        )
        assert gravelius_order(tree).tolist() == [0, 0, 0, 1, 1, 2]

    @pytest.mark.parametrize(
        "angles, radii, equal",
        [
            ([30, -30], [0.1, 0.1], True),
            ([30, -31.5], [0.1, 0.1], True),  # 4.8% of the larger angle
            ([30, -31.6], [0.1, 0.1], False),  # 5.06%
            ([30, -30], [0.1, 0.0951], True),
            ([30, -30], [0.1, 0.0949], False),
            ([30, -31], [0.1, 0.0949], False),  # both have to be alike
            ([30, -32], [0.1, 0.1], False),
            ([30, -30], [0.1, math.nan], False),
            ([0, 0], [0.1, 0.1], True),  # no angle at all: equal
        ],
    )
    def test_five_per_cent(self, angles, radii, equal):
        order = gravelius_order(fork(angles, radii))
        assert sorted(order[2:].tolist()) == ([0, 0] if equal else [0, 1])

    def test_three_leaders(self):
        assert gravelius_order(TREES["many stems"]).tolist() == [0] * 7

    def test_without_the_exception(self):
        assert gravelius_order(fork([30, -30], [0.1, 0.1]), alike=0).tolist() == [0, 0, 0, 1]

    def test_wider_exception(self):
        assert gravelius_order(fork([30, -35], [0.1, 0.09]), alike=0.2).tolist() == [0, 0, 0, 0]

    @pytest.mark.parametrize("turn", range(5))
    def test_rounding_does_not_spoil_an_even_fork(self, turn):
        rng = np.random.default_rng(turn)
        tree = transform(TREES["even fork"], random_rotation(rng), rng.normal(size=3))
        assert gravelius_order(tree).tolist() == [0, 0, 0, 0]

    @pytest.mark.parametrize("tree", EXACT.values(), ids=EXACT)
    @pytest.mark.parametrize("alike", [0.0, 0.05, 0.5])
    def test_follows_the_rule(self, tree, alike):
        assert gravelius_order(tree, alike=alike).tolist() == reference.gravelius(tree, alike)

    @given(parents(25), st.integers(0, 3))
    @settings(deadline=None)
    def test_follows_the_rule_on_random_trees(self, parent, seed):
        tree = coarse(parent, seed)
        assert gravelius_order(tree).tolist() == reference.gravelius(tree)

    @pytest.mark.parametrize("alike", [-0.01, math.nan, math.inf])
    def test_bad_share(self, alike):
        with pytest.raises(InputError, match=f"alike must be a finite number >= 0, got {alike}"):
            gravelius_order(TREES["comb"], alike=alike)


class TestChains:
    def test_by_hand(self):
        assert chain_lists(TREES["even fork"]) == [[0, 1, 2], [1, 3]]

    def test_comb(self):
        tree = TREES["comb"]
        trunk = [0, *range(1, tree.n_nodes, 2)]
        teeth = [[1, 2], *[[k, k + 1] for k in range(3, tree.n_nodes, 2)]]
        teeth[-1] = [tree.n_nodes - 2, tree.n_nodes - 1]
        # at the last node of the trunk its only child, a thin tooth, goes on
        assert chain_lists(tree) == [trunk + [tree.n_nodes - 1], *teeth[:-1]]

    def test_lone_roots_are_chains_of_one_node(self):
        assert chain_lists(TREES["only roots"]) == [[0], [1], [2]]

    def test_types(self):
        start, node = chains(TREES["comb"])
        assert start.dtype == np.int64 and node.dtype == np.int32

    @pytest.mark.parametrize("tree", EXACT.values(), ids=EXACT)
    def test_follows_the_definition(self, tree):
        assert chain_lists(tree) == reference.chain_lists(tree)

    @given(parents())
    @settings(deadline=None)
    def test_every_segment_is_in_one_chain_of_one_order(self, parent):
        tree = make_tree(parent)
        order = gravelius_order(tree)
        found = chain_lists(tree)
        segments = [(a, b) for chain in found for a, b in zip(chain[:-1], chain[1:], strict=True)]
        assert sorted(b for _, b in segments) == [i for i, p in enumerate(parent) if p >= 0]
        assert all(parent[b] == a for a, b in segments)
        seen = set()
        for chain in found:
            own = chain if parent[chain[0]] < 0 and chain[0] not in seen else chain[1:]
            assert len(set(order[own])) == 1
            assert chain[0] in seen or parent[chain[0]] < 0  # a chain comes after the one it leaves
            assert chain[-1] not in parent  # and ends at a tip
            seen.update(chain)
        assert seen == set(range(len(parent)))

    @pytest.mark.parametrize("name", ["bush", "comb", "forest"])
    def test_lengths_add_up(self, name):
        tree = TREES[name]
        segment = segment_length(tree)
        total = sum(
            np.linalg.norm(np.diff(tree.position[chain], axis=0), axis=1).sum() for chain in chain_lists(tree)
        )
        assert total == pytest.approx(segment.sum())


class TestInvariants:
    @pytest.mark.parametrize("name", ["bush", "star", "even fork", "many stems", "some radii unknown"])
    @pytest.mark.parametrize("scale", [1e-3, 1.0, 40.0])
    def test_rigid_motion_and_scale(self, name, scale):
        tree = TREES[name]
        rng = np.random.default_rng(5)
        moved = transform(tree, random_rotation(rng), rng.normal(size=3), scale)
        npt.assert_array_equal(continue_axis(moved), continue_axis(tree))
        npt.assert_array_equal(gravelius_order(moved), gravelius_order(tree))

    @pytest.mark.parametrize("name", ["bush", "star", "some radii unknown", "radii unknown"])
    @pytest.mark.parametrize("seed", range(3))
    def test_order_of_children(self, name, seed):
        """These trees have no exact ties, so what decides is never the index."""
        tree = TREES[name]
        other, old = relabelled(tree, np.random.default_rng(seed))
        axis = continue_axis(other)
        npt.assert_array_equal(np.where(axis < 0, -1, old[axis]), continue_axis(tree)[old])
        npt.assert_array_equal(gravelius_order(other), gravelius_order(tree)[old])

    @given(parents(25), st.integers(0, 3), st.integers(0, 3))
    @settings(deadline=None)
    def test_ties_change_no_order_of_lengths(self, parent, seed, shuffle):
        """With ties another of several equals may go on, but it is equal in all that the rule looks at."""
        tree = coarse(parent, seed)
        other, old = relabelled(tree, np.random.default_rng(shuffle))
        axis, axis_other = continue_axis(tree), continue_axis(other)
        for k, i in enumerate(old):
            a, b = axis[i], old[axis_other[k]] if axis_other[k] >= 0 else -1
            if a != b:
                assert reference.deviation(tree, a) == pytest.approx(reference.deviation(tree, b), abs=1e-6)
                assert reference.longest_way(tree, a) == pytest.approx(reference.longest_way(tree, b))
