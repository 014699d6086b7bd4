"""The structural distance against every mapping there is, and the recursion of the paper; its properties."""

import itertools

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inverse_trees import all_shapes, grown, random_tree, segments_tree, shuffled, subdivided, trees, turned
from reference_edit import (
    Fused,
    assign,
    best_by_force,
    cost_of,
    distance_by_recursion,
    removal,
)

from inverse import cut_into_pieces, map_pieces, structural_distance
from inverse import structure as module
from treegraph import InputError, TreeGraph, resample


def as_segments(tree):
    return cut_into_pieces(tree, every_segment=True)


def force(a, b, **how):
    return best_by_force(a, b, **how) / (2.0 * max(removal(Fused(a)), removal(Fused(b))))


# ---------------------------------------------------------------- against brute force


def test_number_of_shapes():
    """1, 1, 2, 4, 9, 20 rooted unordered trees: none is left out."""
    assert [len(all_shapes(n)) for n in range(1, 7)] == [1, 1, 2, 4, 9, 20]


def check_all_shapes(largest, *, joins):
    rng = np.random.default_rng(largest)
    shapes = [shape for n in range(1, largest + 1) for shape in all_shapes(n)]
    for one, two in itertools.product(shapes, repeat=2):
        if len(one) < largest and len(two) < largest and largest > 5:
            continue
        a, b = segments_tree(one, rng, lean=0.15), segments_tree(two, rng, lean=0.15)
        got = structural_distance(as_segments(a), as_segments(b), joins=joins)
        npt.assert_allclose(got, force(a, b, joins=joins), atol=1e-9, err_msg=f"{one} {two}")


@pytest.mark.parametrize("joins", [True, False])
def test_all_pairs_of_small_trees(joins):
    check_all_shapes(4, joins=joins)


@pytest.mark.slow
def test_all_pairs_of_trees_of_five():
    check_all_shapes(5, joins=True)


@pytest.mark.slow
def test_all_pairs_with_trees_of_six():
    check_all_shapes(6, joins=True)


def similar(shape, rng):
    """Nearly straight trees of nearly equal pieces: joined ones are often worth it."""
    tree = segments_tree(shape, rng, lean=0.04)
    return evened(tree, rng)


def evened(tree, rng):
    """The tree with nearly equal radii."""
    radius = rng.uniform(0.04, 0.05, tree.n_nodes)
    radius[0] = radius[1]
    return tree.replace(radius=radius)


@pytest.mark.parametrize("seed", range(25))
def test_random_pairs_of_six(seed):
    rng = np.random.default_rng(seed)
    shapes = [[-1, *(int(rng.integers(0, i)) for i in range(1, 6))] for _ in range(2)]
    a, b = (similar(shape, rng) for shape in shapes)
    npt.assert_allclose(structural_distance(as_segments(a), as_segments(b)), force(a, b), atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("spread", [2, 4, 12])
def test_recursion_of_the_paper(seed, spread):
    rng = np.random.default_rng([seed, spread])
    a, b = random_tree(14, rng, spread=spread), random_tree(18, rng, spread=spread)
    npt.assert_allclose(
        structural_distance(as_segments(a), as_segments(b)), distance_by_recursion(a, b), atol=1e-9
    )


def test_recursion_of_the_paper_on_grown_trees():
    """With many children, long runs and thin twigs."""
    a, b = grown("F6b", 7, 0), grown("F6b", 7, 2)
    assert min(a.n_nodes, b.n_nodes) >= 25
    a, b = (tree.replace(radius=[tree.radius[1], *tree.radius[1:]]) for tree in (a, b))
    npt.assert_allclose(
        structural_distance(as_segments(a), as_segments(b)), distance_by_recursion(a, b), atol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(150))
def test_recursion_of_the_paper_on_larger_trees(seed):
    rng = np.random.default_rng([9, seed])
    n, m = rng.integers(2, 45, 2)
    lean = float(rng.choice([0.02, 0.1, 0.5]))
    a, b = (
        segments_tree([-1, *(int(rng.integers(max(0, i - s), i)) for i in range(1, k))], rng, lean=lean)
        for k, s in zip((n, m), rng.integers(1, 10, 2), strict=True)
    )
    if rng.random() < 0.5:
        a, b = evened(a, rng), evened(b, rng)
    npt.assert_allclose(
        structural_distance(as_segments(a), as_segments(b)), distance_by_recursion(a, b), atol=1e-9
    )


# ---------------------------------------------------------------- by hand


def pole(*lengths, thick=0.1, lean=0.0):
    """A straight stem of segments."""
    z = np.concatenate([[0.0], np.cumsum(lengths)])
    position = np.column_stack([lean * z, np.zeros_like(z), z])
    return TreeGraph(np.arange(-1, len(lengths)), position, np.full(z.size, thick / 2))


def test_longer_pole():
    """Eq. 12: alike but in length, so the surplus times its thickness: 1 m x 0.1 m of 5 m x 0.1 m, twice."""
    npt.assert_allclose(structural_distance(pole(4), pole(5)), 0.1, atol=1e-12)


def test_leaning_pole():
    """Only the slope differs: s = delta x (1/3)^(1/2.5), cost s L (D + D), by Eq. 7 over 2 L D."""
    straight, leaning = pole(4.0), pole(4.0, lean=0.3)
    leaning = leaning.replace(position=leaning.position / np.hypot(1.0, 0.3))
    slope_1, slope_2 = np.pi / 2, np.arctan2(1.0, 0.3)
    delta = 1.0 - np.exp(-((slope_1 - slope_2) ** 2) / (2.0 * (slope_2 / 5.0) ** 2))
    npt.assert_allclose(structural_distance(straight, leaning), delta * 3.0**-0.4, atol=1e-9)


def test_a_branch_that_is_missing_costs_its_length_times_its_thickness():
    bare = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 2], [0.5, 0, 4], [-0.5, 0, 4]], [0.1, 0.1, 0.05, 0.05])
    more = TreeGraph([-1, 0, 1, 1, 1], [*bare.position, [0, 3, 2]], [0.1, 0.1, 0.05, 0.05, 0.04])
    whole = (cut_into_pieces(more).length * cut_into_pieces(more).thickness).sum()
    npt.assert_allclose(structural_distance(bare, more), 3.0 * 0.08 / (2.0 * whole), atol=1e-12)


# ---------------------------------------------------------------- what split and merge are for


def test_finer_segments_make_no_difference_with_joins_and_much_without():
    tree = grown("F6b", 7, 3)
    finer = subdivided(tree, 3)
    with_joins = structural_distance(as_segments(tree), as_segments(finer))
    without = structural_distance(as_segments(tree), as_segments(finer), joins=False)
    assert with_joins < 1e-6
    assert without > 0.4


def test_twigs_that_cut_a_stem_make_little_difference_with_joins_and_much_without():
    """One model has the small twigs, the other has not: the same stem is eleven pieces or one."""
    position, radius, parent, top = [[0, 0, 0]], [0.1], [-1], 0
    for k in range(1, 11):
        parent += [top, len(parent)]
        position += [[0, 0, k], [0.2, 0, k + 0.1]]
        radius += [0.1, 0.002]
        top = len(parent) - 2
    parent.append(top)
    position.append([0, 0, 11])
    radius.append(0.1)
    twiggy = TreeGraph(parent, position, radius)
    plain = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 11]], [0.1, 0.1])
    assert structural_distance(twiggy, plain) < 0.01
    assert structural_distance(twiggy, plain, joins=False) > 0.4


@pytest.mark.parametrize("spacing", [0.05, 0.11])
def test_resampled_tree_is_the_same_tree(spacing):
    """Cut at forks, it does not matter where the nodes between them are."""
    tree = grown("F6b", 9, 1)
    assert structural_distance(tree, resample(tree, spacing)) < 0.01


# ---------------------------------------------------------------- properties


@given(trees, trees)
@settings(deadline=None, max_examples=60)
def test_range_symmetry_and_never_more_than_without_joins(a, b):
    distance = structural_distance(a, b)
    assert 0.0 <= distance <= 1.0
    npt.assert_allclose(structural_distance(b, a), distance, atol=1e-12)
    assert distance <= structural_distance(a, b, joins=False) + 1e-12


@given(trees, st.floats(-10, 10), st.integers(0, 100))
@settings(deadline=None, max_examples=40)
def test_the_same_tree_turned_and_reordered(tree, angle, seed):
    again = shuffled(turned(tree, angle), np.random.default_rng(seed))
    assert structural_distance(tree, tree) < 1e-12
    assert structural_distance(tree, again) < 1e-9


@given(trees, trees, st.floats(-10, 10), st.integers(0, 100))
@settings(deadline=None, max_examples=40)
def test_invariance_between_different_trees(a, b, angle, seed):
    again = shuffled(turned(b, angle), np.random.default_rng(seed))
    npt.assert_allclose(structural_distance(a, again), structural_distance(a, b), atol=1e-9)


def test_a_little_noise_makes_a_little_difference():
    a, b = grown("F6b", 9, 1), grown("F6b", 9, 2)
    rng = np.random.default_rng(0)
    noise = rng.normal(size=a.position.shape)
    before, last = structural_distance(a, b), 1.0
    for size in (1e-2, 1e-3, 1e-4, 1e-5):
        noisy = a.replace(position=a.position + size * noise)
        itself, change = structural_distance(a, noisy), abs(structural_distance(noisy, b) - before)
        assert change <= 2.0 * itself + 1e-9
        assert itself < last
        last = itself
    assert last < 1e-4


# ---------------------------------------------------------------- the mapping


@given(trees, trees, st.booleans())
@settings(deadline=None, max_examples=60)
def test_mapping_costs_what_the_distance_says(a, b, joins):
    mapping = map_pieces(a, b, joins=joins)
    distance = mapping.total_cost / (2.0 * max(mapping.removal_a, mapping.removal_b))
    npt.assert_allclose(distance, structural_distance(a, b, joins=joins), atol=1e-9)


@given(trees, trees)
@settings(deadline=None, max_examples=40)
def test_mapping_is_a_mapping(a, b):
    """Feet sit on the heads of one pair, runs go upwards and share no pieces; costs are those of Eq. 12."""
    a, b = as_segments(a), as_segments(b)
    mapping = map_pieces(a, b)
    assert (mapping.foot_a[0], mapping.foot_b[0]) == (0, 0)
    runs = []
    for side, foot, head, pair_of in (
        (a, mapping.foot_a, mapping.head_a, mapping.pair_of_a),
        (b, mapping.foot_b, mapping.head_b, mapping.pair_of_b),
    ):
        ways = []
        for k in range(mapping.n_pairs):
            way = [int(head[k])]
            while way[-1] != foot[k]:
                way.append(int(side.parent[way[-1]]))
            assert (pair_of[way] == k).all()
            ways.append(way[::-1])
        assert sum(map(len, ways)) == (pair_of >= 0).sum()
        runs.append(ways)
    for k in range(1, mapping.n_pairs):
        below_a, below_b = a.parent[mapping.foot_a[k]], b.parent[mapping.foot_b[k]]
        pair = mapping.pair_of_a[below_a]
        assert pair == mapping.pair_of_b[below_b]
        assert (mapping.head_a[pair], mapping.head_b[pair]) == (below_a, below_b)
    one, two = Fused(a.graph), Fused(b.graph)
    pairs = [
        ([int(a.last[i]) - 1 for i in run_a], [int(b.last[j]) - 1 for j in run_b])
        for run_a, run_b in zip(*runs, strict=True)
    ]
    npt.assert_allclose(mapping.cost, [assign(one, u, two, v) for u, v in pairs], atol=1e-9)
    npt.assert_allclose(mapping.total_cost, cost_of(one, two, pairs), atol=1e-9)


def test_tree_maps_onto_itself():
    tree = grown("F6b", 9, 1)
    mapping = map_pieces(tree, tree)
    assert mapping.matched_a == mapping.matched_b == 1.0
    npt.assert_array_equal(mapping.foot_a, mapping.foot_b)
    npt.assert_array_equal(mapping.head_a, mapping.head_b)
    assert repr(mapping).endswith("pairs, 100% of a, 100% of b>")


# ---------------------------------------------------------------- limits


def test_trees_without_length_or_thickness():
    node = TreeGraph([-1], [[0, 0, 0]], [0.1])
    thin = pole(1.0, 2.0, thick=0.0)
    assert structural_distance(node, node) == structural_distance(node, thin) == 0.0
    npt.assert_allclose(structural_distance(node, pole(2.0)), 0.5)
    assert map_pieces(node, pole(2.0)).n_pairs == 1


def test_star_of_many_children():
    rng = np.random.default_rng(0)
    a, b = (segments_tree([-1] + [0] * n, rng) for n in (60, 45))
    assert structural_distance(a, shuffled(a, rng)) < 1e-9
    npt.assert_allclose(
        structural_distance(as_segments(a), as_segments(b)), distance_by_recursion(a, b), atol=1e-9
    )


def test_too_large(monkeypatch):
    tree = grown("F6b", 9, 1)
    monkeypatch.setattr(module, "MOST_PAIRS", 100)
    with pytest.raises(InputError, match=r"at most 100 pairs of pieces, got \d+ x \d+; prune one or both"):
        structural_distance(tree, tree)
    monkeypatch.setattr(module, "MOST_RUNS", 10)
    with pytest.raises(
        InputError, match=r"at most 10 runs of pieces, got \d+ in \d+ pieces; prune or simplify it"
    ):
        structural_distance(tree, tree)
