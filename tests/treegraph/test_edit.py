"""Resampling, simplifying, cutting and moving: hand examples, brute force, invariants, messages."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corpus import TREES, along, make_tree, parents, random_rotation, realistic_tree, rooted_parents
from tests.treegraph import reference
from treegraph import (
    InputError,
    TreeError,
    TreeGraph,
    count_tips,
    path_length,
    prune,
    resample,
    segment_length,
    simplify,
    simplify_nodes,
    take_nodes,
    transform,
)

COMMON = {name: tree for name, tree in TREES.items() if name not in ("deep chain", "a million metres off")}


def key_nodes(tree):
    kids = reference.children(tree.parent)
    return [i for i in range(tree.n_nodes) if tree.parent[i] < 0 or len(kids[i]) != 1]


def shape(tree):
    """Parents of the key nodes among themselves: what resampling and simplifying must keep."""
    key = key_nodes(tree)
    rank = {node: k for k, node in enumerate(key)}
    out = []
    for i in key:
        p = int(tree.parent[i])
        while p >= 0 and p not in rank:
            p = int(tree.parent[p])
        out.append(rank.get(p, -1))
    return out


class TestResample:
    def test_by_hand(self):
        bent = along([(0, 0, 0), (0, 0, 1), (1, 0, 1)], [0.3, 0.2, 0.1])
        new = resample(bent, 0.5)
        npt.assert_allclose(new.position, [(0, 0, 0), (0, 0, 0.5), (0, 0, 1), (0.5, 0, 1), (1, 0, 1)])
        npt.assert_allclose(new.radius, [0.3, 0.25, 0.2, 0.15, 0.1])
        assert new.parent.tolist() == [-1, 0, 1, 2, 3]

    def test_steps_go_around_corners_and_are_even(self):
        bent = along([(0, 0, 0), (0, 0, 1), (1, 0, 1)])
        npt.assert_allclose(resample(bent, 0.9).position[1:-1], [(0, 0, 2 / 3), (1 / 3, 0, 1)])

    @pytest.mark.parametrize(
        "spacing, n", [(1.0, 11), (10 / 3, 4), (3.34, 4), (3.33, 5), (100.0, 2), (0.1, 101)]
    )
    def test_fewest_steps(self, spacing, n):
        assert resample(TREES["straight chain"], spacing).n_nodes == n

    @pytest.mark.parametrize("tree", COMMON.values(), ids=COMMON)
    @pytest.mark.parametrize("spacing", [0.03, 0.4, 1e3])
    def test_keeps_shape_ends_and_length_of_path(self, tree, spacing):
        new = resample(tree, spacing)
        assert shape(new) == shape(tree)
        key, new_key = key_nodes(tree), key_nodes(new)
        npt.assert_array_equal(new.position[new_key], tree.position[key])
        npt.assert_array_equal(new.radius[new_key], tree.radius[key])
        before, after = segment_length(tree), segment_length(new)
        for old, run in zip(reference.runs(tree.parent), reference.runs(new.parent), strict=True):
            length, steps = before[old[1:]].sum(), len(run) - 1
            assert steps == max(1, math.ceil(length / spacing - 1e-9))
            assert (after[run[1:]] <= length / steps * (1 + 1e-9) + 1e-12).all()  # a corner only shortens

    @pytest.mark.parametrize("name", ["bush", "chain", "comb", "zero-length segment"])
    def test_new_nodes_lie_on_the_old_polyline_in_order(self, name):
        tree = TREES[name]
        marked = tree.replace(attribute={"s": path_length(tree), "node": np.arange(tree.n_nodes)})
        new = resample(marked, 0.07)
        for i in range(new.n_nodes):
            b = int(new.attribute["node"][i])
            a = max(int(tree.parent[b]), 0)
            distance, t = reference.distance_to_segment(new.position[i], tree.position[a], tree.position[b])
            assert distance < 1e-12
            if segment_length(tree)[b] > 0:
                want = (1 - t) * tree.radius[a] + t * tree.radius[b]
                assert new.radius[i] == pytest.approx(want, abs=1e-9)
        child = np.flatnonzero(new.parent >= 0)
        assert (new.attribute["s"][child] >= new.attribute["s"][new.parent[child]] - 1e-12).all()

    def test_unknown_radius_spreads_to_its_segments_only(self):
        tree = along([(0, 0, 0), (0, 0, 1), (0, 0, 2)], [0.1, 0.1, math.nan])
        assert np.isnan(resample(tree, 0.5).radius).tolist() == [False, False, False, True, True]

    def test_attributes_come_from_the_segment(self):
        tree = along([(0, 0, 0), (0, 0, 1), (0, 0, 2)]).replace(attribute={"measured": [True, False, True]})
        new = resample(tree, 0.4)
        assert new.attribute["measured"].dtype == bool
        assert new.attribute["measured"].tolist() == [True, False, False, True, True, True]

    def test_twice_is_once(self):
        once = resample(TREES["straight chain"], 0.3)
        npt.assert_allclose(resample(once, 0.3).position, once.position, atol=1e-12)

    @pytest.mark.parametrize("spacing", [0, -1.0, math.nan, math.inf])
    def test_bad_spacing(self, spacing):
        with pytest.raises(
            InputError, match=f"spacing must be a positive finite number of metres, got {spacing}"
        ):
            resample(TREES["comb"], spacing)

    @pytest.mark.parametrize("spacing", [1e-9, 1e-30])
    def test_mistyped_spacing_does_not_eat_the_memory(self, spacing):
        with pytest.raises(
            InputError, match=r"at most 50000000 nodes, but .* m of branches gives .*in metres\?"
        ):
            resample(TREES["comb"], spacing)


def random_chain(rng, n):
    """A crooked chain in space with steps of uneven length, radii that wander, and a fold now and then."""
    step = rng.normal(size=(n, 3)) * (0.3, 0.3, 0.1) + (0, 0, rng.choice([0.3, 1.0, -0.2]))
    return along(np.cumsum(step, axis=0), np.abs(np.cumsum(rng.normal(size=n) * 0.05) + 0.3))


class TestSimplify:
    def test_by_hand(self):
        """A zigzag of amplitude 1 cm: all of it fits in 2 cm, none of it in 5 mm."""
        zigzag = along([(0.01 * (-1) ** k, 0, 0.5 * k) for k in range(9)])
        assert simplify_nodes(zigzag, 0.021).tolist() == [0, 8]
        assert simplify_nodes(zigzag, 0.005).size == 9

    def test_right_angle_keeps_its_corner(self):
        corner = along([*[(0, 0, z) for z in range(5)], *[(x, 0, 4) for x in range(1, 4)]])
        assert simplify_nodes(corner, 0.01).tolist() == [0, 4, 7]
        assert simplify_nodes(corner, 0.0).tolist() == [0, 4, 7]

    def test_fewer_than_greedy_and_than_halving(self):
        """A bump that few pairs of chords pass: splitting at the farthest node would keep more."""
        x = [0, 0, 1, 2, 2, 1, 0, 0]
        tree = along([(v, 0, 3.0 * k) for k, v in enumerate(x)])
        n = simplify_nodes(tree, 0.9).size
        assert n - 2 == reference.fewest_inner_nodes(tree, list(range(8)), 0.9)

    @pytest.mark.parametrize("seed", range(40))
    @pytest.mark.parametrize("tolerance", [0.05, 0.3, 1.0])
    def test_fewest_nodes_by_brute_force(self, seed, tolerance):
        tree = random_chain(np.random.default_rng(seed), 9)
        node = simplify_nodes(tree, tolerance)
        run = list(range(9))
        assert all(
            reference.chord_holds(tree, run, a, b, tolerance)
            for a, b in zip(node[:-1], node[1:], strict=True)
        )
        assert node.size - 2 == reference.fewest_inner_nodes(tree, run, tolerance)

    @pytest.mark.parametrize("seed", range(40))
    def test_fewest_nodes_with_radii_by_brute_force(self, seed):
        tree = random_chain(np.random.default_rng(seed), 8)
        node = simplify_nodes(tree, 0.4, 0.06)
        run = list(range(8))
        assert all(
            reference.chord_holds(tree, run, a, b, 0.4, 0.06)
            for a, b in zip(node[:-1], node[1:], strict=True)
        )
        assert node.size - 2 == reference.fewest_inner_nodes(tree, run, 0.4, 0.06)

    @pytest.mark.parametrize("seed", range(10))
    def test_fewest_nodes_of_a_smooth_run(self, seed):
        """Long chords, where cones of directions cut the search short: against plain dynamic programming."""
        rng = np.random.default_rng(seed)
        s = np.linspace(0, 6, 70)
        tree = along(np.column_stack([np.sin(s), np.cos(1.3 * s), s]) + rng.normal(size=(70, 3)) * 0.01)
        run = list(range(70))
        steps = [0] + [70] * 69
        for j in range(1, 70):
            steps[j] = 1 + min(steps[i] for i in range(j) if reference.chord_holds(tree, run, i, j, 0.05))
        assert simplify_nodes(tree, 0.05).size == steps[-1] + 1

    @pytest.mark.parametrize("tree", COMMON.values(), ids=COMMON)
    @pytest.mark.parametrize("tolerance", [0.0, 0.05, 10.0])
    def test_keeps_shape_and_ends(self, tree, tolerance):
        node = simplify_nodes(tree, tolerance)
        new = simplify(tree, tolerance)
        assert np.isin(key_nodes(tree), node).all()
        assert shape(new) == shape(tree)
        npt.assert_array_equal(new.position, tree.position[node])
        npt.assert_array_equal(new.radius, tree.radius[node])
        assert count_tips(new)[new.parent < 0].sum() == count_tips(tree)[tree.parent < 0].sum()

    def test_huge_tolerance_leaves_the_key_nodes(self):
        tree = TREES["bush"]
        assert simplify_nodes(tree, 1e3).tolist() == key_nodes(tree)

    def test_a_real_looking_tree(self):
        tree = realistic_tree(height=4.0, levels=1)
        new = simplify(tree, 0.01, 0.005)
        node = simplify_nodes(tree, 0.01, 0.005)
        assert new.n_nodes < tree.n_nodes / 5
        npt.assert_array_equal(new.attribute["measured"], tree.attribute["measured"][node])
        kept = np.zeros(tree.n_nodes, bool)
        kept[node] = True
        for run in reference.runs(tree.parent):
            stops = [k for k, i in enumerate(run) if kept[i]]
            for a, b in zip(stops[:-1], stops[1:], strict=True):
                assert reference.chord_holds(tree, run, a, b, 0.01 + 1e-12, 0.005 + 1e-12)

    @pytest.mark.parametrize("seed", range(5))
    def test_the_new_polyline_stays_by_the_old_one(self, seed):
        """Both ways, also between the nodes and with folds."""
        tree = random_chain(np.random.default_rng(seed), 30)
        new = simplify(tree, 0.4)
        for one, other in ((tree, new), (new, tree)):
            for i in range(1, one.n_nodes):
                for t in np.linspace(0, 1, 7):
                    p = (1 - t) * one.position[i - 1] + t * one.position[i]
                    nearest = min(
                        reference.distance_to_segment(p, other.position[j - 1], other.position[j])[0]
                        for j in range(1, other.n_nodes)
                    )
                    assert nearest <= 0.4 + 1e-9

    def test_more_tolerance_never_keeps_more(self):
        tree = TREES["chain"]
        sizes = [simplify_nodes(tree, t).size for t in np.linspace(0, 0.5, 30)]
        assert sizes == sorted(sizes, reverse=True)

    def test_tolerance_per_node(self):
        bump = along([(0, 0, 0), (0.1, 0, 1), (0, 0, 2), (0.1, 0, 3), (0, 0, 4)])
        assert simplify_nodes(bump, [0, 0.2, 0, 0.01, 0]).tolist() == [0, 2, 3, 4]

    def test_radius_is_compared_at_the_foot(self):
        cone = along([(0, 0, 0), (0, 0, 1), (0, 0, 4)], [0.4, 0.3, 0.0])
        assert simplify_nodes(cone, 0.01, 1e-9).tolist() == [0, 2]
        assert simplify_nodes(cone.replace(radius=[0.4, 0.2, 0.0]), 0.01, 0.09).tolist() == [0, 1, 2]
        assert simplify_nodes(cone.replace(radius=[0.4, 0.2, 0.0]), 0.01, 0.11).tolist() == [0, 2]

    @pytest.mark.parametrize(
        "radius, kept",
        [
            ([math.nan] * 3, [0, 2]),
            ([0.1, math.nan, 0.1], [0, 1, 2]),
            ([math.nan, 0.1, 0.1], [0, 1, 2]),
            ([math.nan, math.nan, 0.1], [0, 2]),
        ],
    )
    def test_unknown_radii_stand_for_unknown_radii_only(self, radius, kept):
        line = along([(0, 0, 0), (0, 0, 1), (0, 0, 2)], radius)
        assert simplify_nodes(line, 0.01, 0.01).tolist() == kept
        assert simplify_nodes(line, 0.01).tolist() == [0, 2]

    def test_nodes_that_must_stay(self):
        line = TREES["straight chain"]
        keep = np.zeros(line.n_nodes, bool)
        keep[[17, 50]] = True
        assert simplify_nodes(line, 0.01, keep=keep).tolist() == [0, 17, 50, 100]
        assert simplify(line, 0.01, keep=keep).parent.tolist() == [-1, 0, 1, 2]

    def test_long_straight_runs(self):
        line = along(np.linspace((0, 0, 0), (0, 0, 50), 1501))
        assert simplify_nodes(line, 1e-6).tolist() == [0, 1500]  # a whole run, however long
        corner = np.vstack([np.linspace((0, 0, 0), (0, 0, 50), 1201), [(9, 0, 50)]])
        assert simplify_nodes(along(corner), 1e-6).tolist() == [0, 1000, 1200, 1201]  # a piece spans 1000

    @pytest.mark.parametrize("scale", [0.01, 30.0])
    def test_scale_and_rigid_motion(self, scale):
        tree = random_chain(np.random.default_rng(1), 200)
        rng = np.random.default_rng(2)
        moved = transform(tree, random_rotation(rng), rng.normal(size=3), scale)
        npt.assert_array_equal(
            simplify_nodes(moved, 0.3 * scale, 0.05 * scale), simplify_nodes(tree, 0.3, 0.05)
        )

    @pytest.mark.parametrize(
        "arguments, match",
        [
            ({"tolerance": -0.1}, "tolerance must be finite and >= 0 metres, got -0.1 to -0.1"),
            ({"tolerance": math.nan}, "tolerance must be finite and >= 0 metres, got nan"),
            (
                {"tolerance": [0.1, 0.2]},
                r"tolerance must be one number or have shape \(25,\), got shape \(2,\)",
            ),
            ({"tolerance": "fine"}, "tolerance must be a number or an array of numbers, got"),
            (
                {"tolerance": 1, "radius_tolerance": math.inf},
                "radius_tolerance must be finite and >= 0 metres",
            ),
            (
                {"tolerance": 1, "keep": [1, 2]},
                r"keep must be a mask of shape \(25,\), got int64 of shape \(2,\)",
            ),
            (
                {"tolerance": 1, "keep": [True]},
                r"keep must be a mask of shape \(25,\), got bool of shape \(1,\)",
            ),
        ],
    )
    def test_bad_arguments(self, arguments, match):
        for function in (simplify, simplify_nodes):
            with pytest.raises(InputError, match=match):
                function(TREES["comb"], **arguments)


class TestTakeNodes:
    def test_by_hand(self):
        tree = TREES["not depth-first"].replace(attribute={"name": np.arange(9)})
        #  0 -> 1 -> {3 -> 7, 5}, 0 -> 2 -> {4, 6}, 0 -> 8
        new = take_nodes(tree, [0, 2, 5, 7])
        assert new.parent.tolist() == [-1, 0, 0, 0]
        assert new.attribute["name"].tolist() == [0, 2, 5, 7]
        npt.assert_array_equal(new.position, tree.position[[0, 2, 5, 7]])
        assert take_nodes(tree, [1, 4, 7]).parent.tolist() == [-1, -1, 0]

    @given(parents(), st.randoms(use_true_random=False))
    @settings(deadline=None)
    def test_nearest_kept_ancestor(self, parent, random):
        tree = make_tree(parent)
        keep = sorted(random.sample(range(len(parent)), random.randint(1, len(parent))))
        new = take_nodes(tree, keep)
        mask = np.zeros(len(parent), bool)
        mask[keep] = True
        npt.assert_array_equal(take_nodes(tree, mask).parent, new.parent)
        for k, i in enumerate(keep):
            p = parent[i]
            while p >= 0 and p not in keep:
                p = parent[p]
            assert new.parent[k] == (keep.index(p) if p >= 0 else -1)

    @pytest.mark.parametrize(
        "node, match",
        [
            ([], "at least one node must be kept, got none"),
            (np.zeros(25, bool), "at least one node must be kept, got none"),
            ([2, 1], "node must ascend strictly within 0 to 24; sort it and drop duplicates"),
            ([1, 1], "node must ascend strictly"),
            ([-1, 1], "node must ascend strictly"),
            ([24, 25], "node must ascend strictly"),
            ([0.5], r"node must hold indices or be a mask, got float64 of shape \(1,\)"),
            ([[1]], r"node must hold indices or be a mask, got int64 of shape \(1, 1\)"),
            ([True], r"node must be a mask of shape \(25,\), got bool of shape \(1,\)"),
        ],
    )
    def test_bad_nodes(self, node, match):
        with pytest.raises(InputError, match=match):
            take_nodes(TREES["comb"], node)


class TestPrune:
    def test_by_hand(self):
        tree = TREES["comb"].replace(attribute={"name": np.arange(25)})
        new = prune(tree, tree.radius > 0.05)
        assert new.attribute["name"].tolist() == [0, *range(1, 25, 2)]
        assert new.parent.tolist() == list(range(-1, 12))

    def test_everything(self):
        tree = TREES["forest"]
        npt.assert_array_equal(prune(tree, np.ones(tree.n_nodes, bool)).parent, tree.parent)

    @given(rooted_parents(), st.integers(0, 39))
    @settings(deadline=None)
    def test_the_cut_branch_is_gone_and_nothing_else(self, parent, cut):
        cut = cut % len(parent)
        if cut == 0:
            return
        tree = make_tree(parent).replace(attribute={"name": np.arange(len(parent))})
        gone = reference.subtree(parent, cut)
        new = prune(tree, ~np.isin(np.arange(len(parent)), gone))
        assert new.attribute["name"].tolist() == [i for i in range(len(parent)) if i not in gone]
        old = new.attribute["name"]
        npt.assert_array_equal(np.where(new.parent < 0, -1, old[new.parent]), tree.parent[old])

    def test_whole_trees_of_a_forest_can_go(self):
        assert prune(TREES["only roots"], [False, True, False]).n_nodes == 1

    def test_parent_must_stay(self):
        with pytest.raises(
            TreeError,
            match=r"node 2 is kept and its parent 1 is not; 2 nodes break this. take_nodes\(\) reconnects",
        ):
            prune(make_tree([-1, 0, 1, 1]), [True, False, True, True])

    @pytest.mark.parametrize(
        "mask, match",
        [
            ([True], r"keep_mask must be a mask of shape \(4,\), got bool of shape \(1,\)"),
            ([1, 0, 0, 0], r"keep_mask must be a mask of shape \(4,\), got int64 of shape \(4,\)"),
            ([False] * 4, "at least one node must be kept, got none"),
        ],
    )
    def test_bad_mask(self, mask, match):
        with pytest.raises(InputError, match=match):
            prune(make_tree([-1, 0, 1, 1]), mask)


class TestTransform:
    def test_order_is_rotate_scale_shift(self):
        tree = along([(1, 0, 0), (0, 2, 0)], 0.5)
        new = transform(tree, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], (10, 20, 30), 3.0)
        npt.assert_allclose(new.position, [(10, 23, 30), (4, 20, 30)])
        npt.assert_allclose(new.radius, 1.5)

    def test_nothing_to_do(self):
        tree = TREES["bush"]
        npt.assert_array_equal(transform(tree).position, tree.position)

    @pytest.mark.parametrize("name", ["bush", "some radii unknown", "one node"])
    def test_there_and_back(self, name):
        tree = TREES[name].replace(attribute={"name": np.arange(TREES[name].n_nodes)})
        rng = np.random.default_rng(4)
        rotation, shift = random_rotation(rng), rng.normal(size=3)
        there = transform(tree, rotation, shift, 2.5)
        back = transform(transform(there, translation=-shift), rotation.T, scale=1 / 2.5)
        npt.assert_allclose(back.position, tree.position, atol=1e-12)
        npt.assert_allclose(back.radius, tree.radius, rtol=1e-12)
        npt.assert_array_equal(there.parent, tree.parent)
        npt.assert_array_equal(there.attribute["name"], tree.attribute["name"])

    @pytest.mark.parametrize(
        "arguments, match",
        [
            ({"scale": 0}, "scale must be a positive finite number, got 0"),
            ({"scale": -1.0}, "scale must be a positive finite number, got -1.0"),
            ({"scale": math.nan}, "scale must be a positive finite number, got nan"),
            (
                {"rotation": np.eye(2)},
                r"rotation must be a finite matrix of shape \(3, 3\), got shape \(2, 2\)",
            ),
            ({"rotation": np.full((3, 3), math.nan)}, "rotation must be a finite matrix"),
            (
                {"rotation": 2 * np.eye(3)},
                "must be a rotation matrix .* misses this by 3 and has determinant 8",
            ),
            ({"rotation": np.diag([1, 1, -1])}, "rotation matrix .* misses this by 0 and has determinant -1"),
            ({"translation": (1, 2)}, r"translation must be three finite numbers, got \(1, 2\)"),
            ({"translation": (1, 2, math.inf)}, "translation must be three finite numbers, got"),
        ],
    )
    def test_bad_arguments(self, arguments, match):
        with pytest.raises(InputError, match=match):
            transform(TREES["comb"], **arguments)


class TestDepth:
    """20 000 nodes in one chain: no recursion, no quadratic time."""

    def test_deep_chain(self):
        tree = TREES["deep chain"]
        assert 1000 < simplify(tree, 0.0015).n_nodes < 19_000
        even = resample(tree, 0.05)
        npt.assert_allclose(segment_length(even)[1:], 0.05, rtol=0.2)
        assert prune(tree, np.arange(20_000) < 700).n_nodes == 700


def test_given_trees_are_not_changed():
    tree = make_tree([-1, 0, 1, 2, 2])
    before = tree.position.copy(), tree.radius.copy()
    for new in (
        resample(tree, 0.1),
        simplify(tree, 0.1),
        transform(tree, scale=2.0),
        take_nodes(tree, [0, 4]),
    ):
        assert isinstance(new, TreeGraph) and new is not tree
    npt.assert_array_equal(tree.position, before[0])
    npt.assert_array_equal(tree.radius, before[1])
