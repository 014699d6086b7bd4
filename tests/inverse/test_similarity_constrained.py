"""The constrained edit distance against every mapping that the thesis allows."""

import itertools

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from inverse_trees import all_shapes, grown, random_tree, shuffled, subdivided, trees, turned
from reference_edit import constrained_by_force, is_allowed

from inverse import constrained as module
from inverse import constrained_edit_distance, cut_into_pieces, structural_distance
from inverse.constrained import constrained_tree_distance, standardised_costs
from treegraph import InputError, TreeGraph


def random_costs(m, n, rng):
    """Costs of labels on a line, where changing never costs more than deleting and inserting."""
    one, two = rng.normal(size=(m, 2)), rng.normal(size=(n, 2))
    return standardised_costs(one, two)


def check(parent_a, parent_b, rng):
    change, delete, insert = random_costs(len(parent_a), len(parent_b), rng)
    got = constrained_tree_distance(parent_a, parent_b, change, delete, insert)
    npt.assert_allclose(got, constrained_by_force(parent_a, parent_b, change, delete, insert), atol=1e-9)


@pytest.mark.parametrize("largest", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_all_pairs_of_small_trees(largest):
    rng = np.random.default_rng(largest)
    shapes = [shape for n in range(1, largest + 1) for shape in all_shapes(n)]
    for one, two in itertools.product(shapes, repeat=2):
        check(one, two, rng)


@pytest.mark.parametrize("seed", range(12))
def test_random_pairs_of_five(seed):
    rng = np.random.default_rng(seed)
    one, two = ([-1, *(int(rng.integers(0, i)) for i in range(1, 5))] for _ in range(2))
    check(one, two, rng)


def test_what_the_thesis_allows():
    """Figure 4.10: ancestors stay ancestors, and branching systems apart."""
    fork, chain = [-1, 0, 1, 1], [-1, 0, 1, 2]
    assert is_allowed(fork, fork, [(0, 0), (2, 3)])
    assert not is_allowed(fork, fork, [(1, 2), (2, 1)])
    assert not is_allowed(fork, chain, [(2, 2), (3, 3)])
    two_systems = [-1, 0, 0, 1, 1]
    assert not is_allowed(two_systems, [-1, 0, 0, 1, 2], [(3, 3), (4, 4), (2, 1)])


def test_unit_costs():
    """By hand: one node less is one deletion; a chain and a star share a root and one child."""
    ones = np.ones(4)
    equal = np.zeros((4, 3))
    assert constrained_tree_distance([-1, 0, 1, 1], [-1, 0, 1], equal, ones, ones[:3]) == 1.0
    assert constrained_tree_distance([-1, 0, 0, 0], [-1, 0, 1, 2], np.zeros((4, 4)), ones, ones) == 4.0


def test_standardised_by_hand():
    """Attributes 1, 2, 3, 6 of both trees: mean 3, deviation sqrt(14 / 3)."""
    change, delete, insert = standardised_costs([[1.0, 7.0], [2.0, 7.0]], [[3.0, 7.0], [6.0, 7.0]])
    s = np.sqrt(14.0 / 3.0)
    npt.assert_allclose(change, np.array([[2.0, 5.0], [1.0, 4.0]]) / s)
    npt.assert_allclose(delete, np.array([2.0, 1.0]) / s)
    npt.assert_allclose(insert, np.array([0.0, 3.0]) / s)


def test_of_trees_by_hand():
    """Stems of 2 x 0.4 m and 1 x 0.2 m: both attributes are 1/sqrt(2) from their mean, so 2 sqrt(2) apart."""
    a = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 2]], [0.2, 0.2])
    b = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 1]], [0.1, 0.1])
    npt.assert_allclose(constrained_edit_distance(a, b), 2.0 * np.sqrt(2.0))


def test_stand_in_for_a_root_that_is_a_fork_costs_nothing():
    fork = TreeGraph([-1, 0, 0], [[0, 0, 0], [0, 0, 2], [0, 1, 1]], [0.2, 0.2, 0.1])
    stem = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 2]], [0.2, 0.2])
    both = np.array([[2.0, 0.4], [np.sqrt(2.0), 0.2], [2.0, 0.4]])
    f = (both - both.mean(axis=0)) / both.std(axis=0, ddof=1)
    npt.assert_allclose(constrained_edit_distance(fork, stem), np.abs(f[1]).sum())


@given(trees, trees)
@settings(deadline=None, max_examples=60)
def test_properties(a, b):
    distance = constrained_edit_distance(a, b)
    assert distance >= 0.0
    npt.assert_allclose(constrained_edit_distance(b, a), distance, atol=1e-9)
    assert constrained_edit_distance(a, a) < 1e-9
    again = shuffled(turned(b, 1.0), np.random.default_rng(0))
    npt.assert_allclose(constrained_edit_distance(a, again), distance, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_triangle_inequality_with_costs_of_one_scale(seed):
    """Change is a metric that deletion and insertion extend: so is the distance."""
    rng = np.random.default_rng(seed)
    parents = [[-1, *(int(rng.integers(0, i)) for i in range(1, n))] for n in rng.integers(2, 12, 3)]
    labels = [rng.normal(size=len(p)) for p in parents]

    def distance(i, j):
        change = np.abs(labels[i][:, None] - labels[j])
        return constrained_tree_distance(parents[i], parents[j], change, np.abs(labels[i]), np.abs(labels[j]))

    assert distance(0, 2) <= distance(0, 1) + distance(1, 2) + 1e-9


def test_finer_segments_are_another_tree_to_it():
    """What split and merge are for: with insertion and deletion alone a resampled tree is far from itself."""
    tree = grown("F6b", 7, 3)
    one, two = (cut_into_pieces(t, every_segment=True) for t in (tree, subdivided(tree, 3)))
    length = np.abs(one.length[:, None] - two.length)
    change = np.minimum(one.length[:, None], two.length) * np.abs(one.thickness[:, None] - two.thickness)
    change += length * np.where(one.length[:, None] > two.length, one.thickness[:, None], two.thickness)
    delete, insert = one.length * one.thickness, two.length * two.thickness
    distance = constrained_tree_distance(one.parent, two.parent, change, delete, insert)
    assert distance / (2.0 * max(delete.sum(), insert.sum())) > 0.3
    assert structural_distance(one, two) < 1e-6


def test_no_difference_at_all():
    """All nodes alike: every deviation is 0 and everything is free."""
    stem = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 2]], [0.2, 0.2])
    assert constrained_edit_distance(stem, stem) == 0.0
    assert standardised_costs(np.zeros((0, 2)), np.ones((1, 2)))[2].tolist() == [0.0]


def test_many_children():
    rng = np.random.default_rng(3)
    a, b = random_tree(200, rng, spread=60), random_tree(150, rng, spread=60)
    assert constrained_edit_distance(a, shuffled(a, rng)) < 1e-9
    npt.assert_allclose(constrained_edit_distance(a, b), constrained_edit_distance(shuffled(b, rng), a))


@pytest.mark.parametrize(
    "changes, match",
    [
        (
            {"parent_a": [[-1]]},
            r"parent_a must be whole numbers of shape \(n,\) with n > 0, got int64 \(1, 1\)",
        ),
        ({"parent_b": [-1, 1]}, r"parent_b must be -1 for node 0 .* but parent_b\[1\] is 1; 1 of 2 nodes"),
        ({"parent_b": [-1, -1]}, r"parent_b\[1\] is -1"),
        ({"parent_a": [0, 0]}, r"parent_a\[0\] is 0"),
        ({"change": [[0.0]]}, r"change must have shape \(2, 2\), got \(1, 1\)"),
        ({"delete": [1.0, -1.0]}, "delete must be finite and >= 0, got -1.0 to 1.0"),
        ({"insert": [1.0, np.inf]}, "insert must be finite and >= 0, got 1.0 to inf"),
        (
            {"change": [[0.0, 3.0], [0.0, 0.0]]},
            r"change must be at most delete \+ insert, but change\[0, 1\] is 3.0",
        ),
    ],
)
def test_errors(changes, match):
    good = {
        "parent_a": [-1, 0],
        "parent_b": [-1, 0],
        "change": np.zeros((2, 2)),
        "delete": [1, 1],
        "insert": [1, 1],
    }
    assert constrained_tree_distance(**good) == 0.0
    with pytest.raises(InputError, match=match):
        constrained_tree_distance(**good | changes)


def test_too_large(monkeypatch):
    monkeypatch.setattr(module, "MOST_PAIRS", 3)
    with pytest.raises(InputError, match="at most 3 pairs of nodes, got 2 x 2"):
        constrained_tree_distance([-1, 0], [-1, 0], np.zeros((2, 2)), [1, 1], [1, 1])
