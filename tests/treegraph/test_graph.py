"""The tree graph itself: its rules, their messages, and putting unsorted nodes in order."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import treegraph
from tests.corpus import TREES, make_tree, parents
from treegraph import NO_PARENT, TreeError, TreeGraph, check_tree, sort_topological, tree_from_unsorted

ROOT = Path(__file__).parents[2]

UP = [(0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 2.0)]

shuffled_parents = parents(30).flatmap(lambda p: st.tuples(st.just(p), st.permutations(range(len(p)))))


def shuffle(parent, new_index):
    """The same tree with node i called new_index[i]."""
    out = [None] * len(parent)
    for i, p in enumerate(parent):
        out[new_index[i]] = -1 if p < 0 else new_index[p]
    return out


class TestTreeGraph:
    def test_arrays_have_the_promised_types(self):
        tree = TreeGraph(np.array([-1, 0, 1], np.int64), np.array(UP, np.float32), [1, 1, 0])
        assert tree.parent.dtype == np.int32
        assert tree.position.dtype == tree.radius.dtype == np.float64
        assert tree.n_nodes == 3 and type(tree.n_nodes) is int

    def test_arrays_are_contiguous_copies(self):
        parent = np.array([-1, 0, 1], np.int32)
        position = np.asfortranarray(np.array(UP))
        radius = np.arange(6.0)[::2]
        measured = np.array([True, False, True])
        tree = TreeGraph(parent, position, radius, {"measured": measured})
        for array in (tree.parent, tree.position, tree.radius, tree.attribute["measured"]):
            assert array.flags.c_contiguous
        parent[1], position[1], radius[1], measured[1] = -1, 9.0, 9.0, True
        npt.assert_array_equal(tree.parent, [-1, 0, 1])
        npt.assert_array_equal(tree.position, UP)
        npt.assert_array_equal(tree.radius, [0, 2, 4])
        npt.assert_array_equal(tree.attribute["measured"], [True, False, True])

    def test_arrays_are_read_only(self):
        tree = TreeGraph([-1, 0, 1], UP, [1, 1, 1], {"age": np.arange(3)})
        for array in (tree.parent, tree.position, tree.radius, tree.attribute["age"]):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0
        with pytest.raises(AttributeError):
            tree.parent = [-1, 0, 0]
        with pytest.raises(TypeError):
            tree.attribute["new"] = np.zeros(3)

    def test_given_arrays_stay_writable(self):
        radius = np.ones(3)
        TreeGraph([-1, 0, 1], UP, radius)
        radius[0] = 2.0

    @pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda t: pickle.loads(pickle.dumps(t))])
    def test_copies_are_equal_and_read_only(self, duplicate):
        tree = make_tree([-1, 0, 1, 1]).replace(attribute={"n_points": np.arange(4, dtype=np.int32)})
        twin = duplicate(tree)
        assert twin is not tree
        for name in ("parent", "position", "radius"):
            npt.assert_array_equal(getattr(twin, name), getattr(tree, name))
            assert not getattr(twin, name).flags.writeable
        assert twin.attribute["n_points"].dtype == np.int32
        assert not twin.attribute["n_points"].flags.writeable
        npt.assert_array_equal(twin.attribute["n_points"], [0, 1, 2, 3])

    def test_replace_changes_only_what_is_named(self):
        tree = make_tree([-1, 0, 1]).replace(attribute={"age": [1, 2, 3]})
        new = tree.replace(radius=[0.3, 0.2, 0.1])
        npt.assert_array_equal(new.radius, [0.3, 0.2, 0.1])
        npt.assert_array_equal(new.position, tree.position)
        npt.assert_array_equal(new.attribute["age"], [1, 2, 3])
        assert dict(tree.replace(attribute={}).attribute) == {}

    def test_replace_checks_again(self):
        with pytest.raises(TreeError, match=r"parent\[1\] is 1"):
            make_tree([-1, 0]).replace(parent=[-1, 1])
        with pytest.raises(TypeError, match="colour"):
            make_tree([-1, 0]).replace(colour=1)

    @pytest.mark.parametrize(
        "parent, text",
        [([-1], "<TreeGraph 1 node, 1 root>"), ([-1, 0, -1], "<TreeGraph 3 nodes, 2 roots>")],
    )
    def test_repr(self, parent, text):
        assert repr(make_tree(parent)) == text

    def test_attributes_keep_their_own_type_and_shape(self):
        given_ = {
            "measured": np.array([True, False]),
            "arc": np.array([0.5, 1.0], np.float32),
            "colour": np.zeros((2, 3), np.uint8),
            "name": np.array(["trunk", "tip"]),
        }
        tree = TreeGraph([-1, 0], UP[:2], [1, 1], given_)
        for name, value in given_.items():
            assert tree.attribute[name].dtype == value.dtype
            npt.assert_array_equal(tree.attribute[name], value)


class TestRules:
    @pytest.mark.parametrize("tree", TREES.values(), ids=TREES)
    def test_corpus_holds_them(self, tree):
        check_tree(tree.parent, tree.position, tree.radius, tree.attribute)

    @pytest.mark.parametrize(
        "changes, match",
        [
            ({"parent": []}, r"parent must have shape \(n,\) with n > 0, got \(0,\)"),
            ({"parent": [[-1, 0, 1]]}, r"parent must have shape \(n,\) with n > 0, got \(1, 3\)"),
            ({"parent": [-1.0, 0.0, 1.0]}, "parent must hold integers, got dtype float64"),
            ({"parent": [-1, None, 1]}, "parent must hold integers, got dtype object"),
            ({"parent": [-1, [0, 1], 1]}, "parent must be an array of integers, got"),
            ({"parent": [-1, 0, 2**32]}, "parent must fit 32-bit integers, got values from -1 to 4294967296"),
            (
                {"parent": [-1, 2, 0]},
                r"parent\[1\] is 2, but a parent must come before its child \(-1 <= parent\[i\] < i\); "
                r"1 of 3 nodes break this. Reorder them with sort_topological\(\).",
            ),
            ({"parent": [-1, 1, 2]}, r"parent\[1\] is 1, .* 2 of 3 nodes"),
            ({"parent": [0, 0, 1]}, r"parent\[0\] is 0"),
            ({"parent": [-1, 0, -2]}, r"parent\[2\] is -2"),
            ({"position": UP[:2]}, r"position must have shape \(3, 3\) to match parent, got \(2, 3\)"),
            ({"position": [0, 0, 0]}, r"position must have shape \(3, 3\) to match parent, got \(3,\)"),
            ({"position": "here"}, "position must be an array of numbers, got dtype <U4"),
            ({"position": [[1j] * 3] * 3}, "position must be an array of numbers, got dtype complex128"),
            ({"position": [[0, 0, {}]] * 3}, "position must be an array of numbers, got"),
            ({"position": [[0, 0], [0]]}, "position must be an array of numbers, got"),
            (
                {"position": [*UP[:2], (0, np.nan, 0)]},
                r"position must be finite, but position\[2\] is .*nan.*; 1 of 3 nodes break this",
            ),
            ({"position": [UP[0], (0, np.inf, 0), UP[2]]}, r"position must be finite, but position\[1\]"),
            ({"radius": [1, 1]}, r"radius must have shape \(3,\) to match parent, got \(2,\)"),
            ({"radius": 0.1}, r"radius must have shape \(3,\) to match parent, got \(\)"),
            (
                {"radius": [1, -0.1, -2]},
                r"radius must be >= 0 and finite, or NaN where unknown, but radius\[1\] is -0.1; 2 of 3",
            ),
            ({"radius": [np.inf, 1, 1]}, r"radius\[0\] is inf"),
            (
                {"attribute": {"age": [1, 2]}},
                r"attribute 'age' must have 3 rows to match parent, got shape \(2,\)",
            ),
            ({"attribute": {"age": 1}}, r"attribute 'age' must have 3 rows to match parent, got shape \(\)"),
            ({"attribute": {"age": [None] * 3}}, "attribute 'age' must have a plain dtype, got object"),
            ({"attribute": {"age": [[1], [1, 2], []]}}, "attribute 'age' must be an array, got"),
            ({"attribute": {"radius": [1, 1, 1]}}, "other than parent, position, radius, got 'radius'"),
            ({"attribute": {"": [1, 1, 1]}}, "name must be a non-empty string other than .*, got ''"),
            ({"attribute": {3: [1, 1, 1]}}, "name must be a non-empty string other than .*, got 3"),
        ],
    )
    def test_broken_rule_is_named(self, changes, match):
        arrays = {"parent": [-1, 0, 1], "position": UP, "radius": [0.1, 0.1, 0.1]}
        with pytest.raises(TreeError, match=match):
            TreeGraph(**(arrays | changes))

    def test_nan_radius_is_allowed(self):
        assert np.isnan(TreeGraph([-1], [(0, 0, 0)], [np.nan]).radius[0])

    def test_error_is_a_value_error_of_the_project(self):
        with pytest.raises(treegraph.SapwoodError):
            TreeGraph([0], [(0, 0, 0)], [1])
        with pytest.raises(ValueError):
            TreeGraph([0], [(0, 0, 0)], [1])


class TestSorting:
    def test_by_hand(self):
        #   4 -> 1 -> {0 -> 3, 2}
        assert sort_topological([1, 4, 1, 0, -1]).tolist() == [4, 1, 0, 3, 2]

    def test_nothing_to_sort(self):
        assert sort_topological([]).tolist() == []

    @pytest.mark.parametrize("name", ["chain", "deep chain", "star", "only roots"])
    def test_depth_first_order_is_left_alone(self, name):
        parent = TREES[name].parent
        npt.assert_array_equal(sort_topological(parent), np.arange(parent.size))

    @given(shuffled_parents)
    @settings(deadline=None)
    def test_parents_first_branches_together_siblings_in_order(self, case):
        parent = shuffle(*case)
        order = sort_topological(parent).tolist()
        assert sorted(order) == list(range(len(parent)))
        rank = {node: k for k, node in enumerate(order)}
        for node, p in enumerate(parent):
            assert p < 0 or rank[p] < rank[node]
        for node in range(len(parent)):
            kids = [j for j, p in enumerate(parent) if p == node]
            assert sorted(kids, key=rank.get) == kids
        # depth-first: what lies between a node and the last of its subtree is all in its subtree
        for k, node in enumerate(order):
            inside = [is_above(parent, node, other) for other in order[k:]]
            assert inside == sorted(inside, reverse=True)
        renumbered = [-1 if parent[node] < 0 else rank[parent[node]] for node in order]
        npt.assert_array_equal(sort_topological(renumbered), np.arange(len(order)))

    @given(shuffled_parents)
    @settings(deadline=None)
    def test_unsorted_arrays_become_the_same_tree(self, case):
        parent = shuffle(*case)
        n = len(parent)
        name = np.arange(n)
        position = np.column_stack([name, name * 2.0, name * 3.0])
        tree = tree_from_unsorted(parent, position, name / 100, {"name": name})
        old = tree.attribute["name"]
        npt.assert_array_equal(tree.position, position[old])
        npt.assert_array_equal(tree.radius, old / 100)
        for i, p in enumerate(tree.parent):
            assert (parent[old[i]] == NO_PARENT) if p < 0 else (parent[old[i]] == old[p])

    def test_radius_left_out_is_unknown(self):
        assert np.isnan(tree_from_unsorted([1, -1], UP[:2]).radius).all()

    @pytest.mark.parametrize(
        "parent, match",
        [
            ([0], "parents must lead to a root, but node 0 never reaches one: 1 of 1 nodes hang on a cycle"),
            (
                [-1, 2, 1, 2],
                r"node 1 never reaches one: 3 of 4 nodes .* making one of its nodes a root \(-1\)",
            ),
            ([-1, 4], r"parent\[1\] is 4, but a parent must be a node \(0 to 1\) or -1 at a root; 1 of 2"),
            ([-3, 0], r"parent\[0\] is -3"),
            ([[-1, 0]], r"parent must have shape \(n,\), got \(1, 2\)"),
            ([0.5], "parent must hold integers, got dtype float64"),
        ],
    )
    def test_what_cannot_be_sorted(self, parent, match):
        with pytest.raises(TreeError, match=match):
            sort_topological(parent)

    @pytest.mark.parametrize(
        "arrays, match",
        [
            ({"position": UP}, r"position must have 2 rows to match parent, got shape \(3, 3\)"),
            ({"radius": 0.5}, r"radius must have 2 rows to match parent, got shape \(\)"),
            (
                {"attribute": {"age": [1]}},
                r"attribute 'age' must have 2 rows to match parent, got shape \(1,\)",
            ),
            ({"attribute": {"age": [[1], [1, 2]]}}, "attribute 'age' must be an array, got"),
            ({"parent": []}, "must have 0 rows|n > 0"),
        ],
    )
    def test_unsorted_arrays_must_fit(self, arrays, match):
        with pytest.raises(TreeError, match=match):
            tree_from_unsorted(**({"parent": [1, -1], "position": UP[:2]} | arrays))


def is_above(parent, node, other):
    while other != node and other >= 0:
        other = parent[other]
    return other == node


class TestPackage:
    @pytest.mark.parametrize("name", treegraph.__all__)
    def test_every_public_name_is_there_and_documented(self, name):
        thing = getattr(treegraph, name)
        if callable(thing):
            assert thing.__doc__ and len(thing.__doc__) > 30

    def test_unknown_name(self):
        with pytest.raises(AttributeError, match="module 'treegraph' has no attribute 'forest'"):
            treegraph.forest  # noqa: B018

    def test_lazy_names_are_listed(self):
        assert {"TreeGraph", "simplify", "read_swc"} <= set(dir(treegraph))

    def test_import_is_cheap(self):
        code = (
            "import sys, treegraph; print([m for m in ('numba', 'scipy', 'zstandard') if m in sys.modules])"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == "[]"
