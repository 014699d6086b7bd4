"""Internode lengths, growth rates and ages (thesis 4.3.1)."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from plastic import branch_ages, growth_rates, internode_length, seasons_of
from plastic.seasons import branching_distances
from species import find_preset, grow
from tests.corpus import TREES, along, make_tree
from treegraph import InputError, TreeGraph, path_length, segment_length, transform

FORK = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 4], [0, 1.5, 1]], [0.1] * 4)
"""A trunk of 4 m with a branch of 1.5 m from its first metre."""

parents = st.integers(2, 40).flatmap(lambda n: st.tuples(st.just(-1), *[st.integers(0, i) for i in range(n)]))


def comb(spacing, teeth=12):
    """A trunk with a twig at every node; the distances are all the same."""
    parent, position, at = [-1], [(0, 0, 0)], 0
    for k in range(1, teeth + 1):
        parent += [at, len(parent)]
        position += [(0, 0, k * spacing), (0.2, 0, k * spacing)]
        at = len(parent) - 2
    return TreeGraph(parent, position, [0.1] * len(parent))


def reference_rates(tree):
    """Eq. 4.1 from the definitions, by recursion."""
    kids = {i: np.flatnonzero(tree.parent == i) for i in range(tree.n_nodes)}
    length, way = segment_length(tree), path_length(tree)

    def reach(i):
        return max([length[j] + reach(j) for j in kids[i]], default=0.0)

    def root(i):
        return i if tree.parent[i] < 0 else root(tree.parent[i])

    def rate(i):
        p = tree.parent[i]
        if p < 0:
            return 1.0
        whole = reach(root(i))
        ahead = reach(i) + length[i]
        if ahead > 0.2 * whole and whole > way[p]:
            return min(ahead / (whole - way[p]), 1.0)
        return rate(p)

    return np.array([rate(i) for i in range(tree.n_nodes)])


def test_distances_are_ways_between_branching_nodes():
    z = [[0, 0, 0], [0, 0, 1], [0, 0, 3], [0, 0, 4], [1, 0, 4], [-1, 0, 4], [0, 2, 3]]
    tree = TreeGraph([-1, 0, 1, 2, 3, 3, 2], z, [0.1] * 7)
    assert branching_distances(tree).tolist() == [3.0, 1.0]


@pytest.mark.parametrize("spacing", [0.01, 0.3, 2.0])
def test_equal_distances_are_the_internode(spacing):
    assert internode_length(comb(spacing)) == pytest.approx(spacing, rel=1e-9)


def test_the_highest_of_two_peaks_is_taken():
    """Thirty branchings at about 0.2 m, ten at about 1 m: a mean would be 0.4."""
    rng = np.random.default_rng(0)
    steps = np.concatenate([rng.normal(0.2, 0.02, 30), rng.normal(1.0, 0.02, 10)])
    parent, position, at, z = [-1], [(0.0, 0.0, 0.0)], 0, 0.0
    for step in rng.permutation(steps):
        z += step
        parent += [at, len(parent)]
        position += [(0, 0, z), (0.2, 0, z)]
        at = len(parent) - 2
    assert internode_length(TreeGraph(parent, position, [0.1] * 81)) == pytest.approx(0.2, abs=0.02)


def test_without_branchings_it_is_a_share_of_the_height():
    assert internode_length(along(np.linspace((0, 0, 0), (0, 0, 10), 31))) == pytest.approx(0.5)
    assert internode_length(TreeGraph([-1], [[0, 0, 0]], [0.1])) == 1.0


@given(parents, st.floats(0.01, 100.0))
@example((-1, 0, 1, 1, 2, 2), 3.0)  # two distances: two peaks of one height
@settings(deadline=None, max_examples=50)
def test_internode_scales_with_the_tree(parent, scale):
    tree = make_tree(parent)
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = transform(tree, turn, (5, 6, 7), scale)
    npt.assert_allclose(internode_length(moved), scale * internode_length(tree), rtol=1e-5)


@pytest.mark.parametrize("spread", [0.05, 0.2])
def test_grown_internodes_are_found(spread):
    """Every node of a grown tree's shoots may branch: the peak is the internode, not its multiples."""
    kind = find_preset("F6b").parameters
    tree = grow(kind.replace(IL_AF=1.0), 14, rng=np.random.default_rng(int(spread * 100))).tree
    assert internode_length(tree) == pytest.approx(kind.internode_length, rel=0.05)


# ---------------------------------------------------------------- rates and ages


def test_rates_by_hand():
    """The branch has 1.5 m where the trunk has 3 m left: half the rate."""
    assert growth_rates(FORK).tolist() == [1.0, 1.0, 1.0, 0.5]


def test_short_branches_grow_like_their_bearer():
    """0.2 d_r = 0.8 m: a branch of 0.75 m has its parent's rate, one of 0.85 m its own."""
    for length, rate in ((0.75, 1.0), (0.85, 0.85 / 3)):
        tree = FORK.replace(position=[[0, 0, 0], [0, 0, 1], [0, 0, 4], [0, length, 1]])
        assert growth_rates(tree)[3] == pytest.approx(rate)


@pytest.mark.parametrize("name", [name for name, tree in TREES.items() if tree.n_nodes < 200])
def test_rates_match_the_reference(name):
    tree = TREES[name]
    npt.assert_allclose(growth_rates(tree), reference_rates(tree), rtol=1e-9)


def test_ages_by_hand():
    """l_i = 0.5 m; the branch makes one internode a year, the trunk two: both end after 4 years."""
    rate, age = branch_ages(FORK, 0.5, growth_rates(FORK))
    assert rate.tolist() == [2.0, 2.0, 2.0, 1.0]
    assert age.tolist() == [0.0, 1.0, 4.0, 4.0]


@given(parents)
@settings(deadline=None, max_examples=50)
def test_ages_grow_towards_the_tips(parent):
    tree = make_tree(parent)
    rate, age = branch_ages(tree, 0.3, growth_rates(tree))
    inner = tree.parent >= 0
    assert rate[inner].min() == 1.0
    assert (age[inner] > age[tree.parent[inner]]).all()


def test_long_branches_reach_their_tips_at_the_same_time():
    """What eq. 4.1 is for; true of the farthest tip of every branch longer than 0.2 d_r."""
    _, age = branch_ages(FORK, 0.5, growth_rates(FORK))
    assert age[2] == age[3] == age.max()


def test_the_quotient_follows_the_true_years_of_growth():
    """Eq. 4.2 as printed, with a product, does not: why it is read as a quotient."""
    tree = grow(find_preset("F6f").parameters, 16, rng=np.random.default_rng(2)).tree
    true = tree.attribute["birth"][1:]
    rate, age = branch_ages(tree, internode_length(tree), growth_rates(tree))
    printed = np.zeros(tree.n_nodes)
    length = segment_length(tree)
    for i in range(1, tree.n_nodes):
        printed[i] = printed[tree.parent[i]] + length[i] * rate[i]
    assert np.corrcoef(age[1:], true)[0, 1] > 0.9
    assert np.corrcoef(age[1:], true)[0, 1] > np.corrcoef(printed[1:], true)[0, 1] + 0.1


def test_ages_are_clamped_to_whole_years():
    found = seasons_of(FORK, internode=0.5, fewest=1, most=100)
    assert found.birth.tolist() == [0, 1, 4, 4]
    assert (found.count, found.season, found.years) == (5, 1.0, 4.0)


def test_more_years_than_seasons_share_them():
    found = seasons_of(FORK, internode=0.01, fewest=1, most=10)
    assert found.count == 10
    assert found.season == pytest.approx(found.years / 10)
    assert found.birth.tolist() == [0, 2, 9, 9]


def test_few_years_are_divided():
    found = seasons_of(FORK, internode=4.0, fewest=8, most=24)
    assert found.count == 8
    assert found.birth.tolist() == [0, 2, 7, 7]


@given(parents, st.integers(1, 12), st.integers(0, 30))
@settings(deadline=None, max_examples=50)
def test_seasons_hold_every_node_and_never_go_back(parent, fewest, more):
    tree = make_tree(parent)
    found = seasons_of(tree, fewest=fewest, most=fewest + more)
    assert fewest <= found.count <= fewest + more
    assert (found.birth >= 0).all()
    assert found.birth.max() == found.count - 1
    inner = tree.parent >= 0
    assert (found.birth[inner] >= found.birth[tree.parent[inner]]).all()


@pytest.mark.parametrize("internode", [0.0, -1.0, np.nan, np.inf])
def test_bad_internode(internode):
    with pytest.raises(InputError, match="internode must be a positive finite number of metres, got"):
        seasons_of(FORK, internode=internode, fewest=1, most=2)


@pytest.mark.parametrize("fewest, most", [(0, 3), (4, 3)])
def test_bad_seasons(fewest, most):
    with pytest.raises(
        InputError, match=f"seasons must be from 1 up, the fewest first, got {fewest} to {most}"
    ):
        seasons_of(FORK, fewest=fewest, most=most)
