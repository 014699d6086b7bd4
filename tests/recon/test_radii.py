from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

from recon import _tube_kernels as kernels
from recon.encoding import _hidden_stem, _main_stem
from recon.radii import CARRIED_MARGIN, SMALLEST_RADIUS, carried_points, final_radii, limit_by_load
from recon.skeleton import Skeleton


def skeleton(parent, position, radius, n_points, is_tube):
    parent = np.asarray(parent, np.int32)
    label = np.repeat(np.arange(parent.size), n_points).astype(np.int32)
    return Skeleton(
        parent,
        np.asarray(position, float),
        np.asarray(radius, float),
        label,
        label,
        np.asarray(is_tube, bool),
        np.ones(parent.size),
        0.05,
        0.01,
    )


def straight(radius, n_points, is_tube):
    n = len(radius)
    position = np.stack([np.zeros(n), np.zeros(n), np.arange(n, dtype=float)], 1)
    return skeleton([-1, *range(n - 1)], position, radius, n_points, is_tube)


def test_beyond_the_last_circle_eq_3_1_holds():
    # l(u) above nodes 0..4 of a chain of four metres, edges below included: 4, 4, 3, 2, 1
    chain = straight([0.2, 0.2, np.nan, np.nan, np.nan], [50, 50, 0, 0, 0], [1, 1, 0, 0, 0])
    chain.radius[2:] = 0.5
    radius, measured = final_radii(chain, 1.5)
    npt.assert_allclose(radius[:2], 0.2)
    npt.assert_allclose(radius[2:], 0.2 * (np.array([3, 2, 1]) / 4) ** 1.5)
    assert measured.tolist() == [True, True, False, False, False]


def test_points_that_cannot_be_wood_are_not_believed():
    far = straight([0.1, 0.1, 0.4, 0.4], [50, 50, 20, 20], [1, 1, 0, 0])
    near = straight([0.1, 0.1, 0.05, 0.04], [50, 50, 20, 20], [1, 1, 0, 0])
    assert final_radii(far, 1.5)[0][2] == pytest.approx(0.1 * (2 / 3) ** 1.5)
    assert final_radii(near, 1.5)[0][2] == pytest.approx(0.05 * np.sqrt(20 / 19))


def test_wood_is_no_thicker_than_what_it_carries_allows():
    # at 2/3 of the length the pipe model allows 0.1 * (2/3)^(1/2) = 0.0816
    for observed, believed in ((0.079, True), (0.083, False)):
        chain = straight([0.1, 0.1, observed, 0.01], [50, 50, 10_000, 20], [1, 1, 0, 0])
        wanted = observed if believed else 0.1 * (2 / 3) ** 1.5
        assert final_radii(chain, 1.5)[0][2] == pytest.approx(wanted, rel=1e-3)


def test_a_spread_below_the_spacing_may_be_a_twig_but_not_among_leaves():
    chain = straight([0.008, 0.008, 0.0075, 0.0075], [50, 50, 10_000, 10_000], [1, 1, 0, 0])
    chain.position[2:, 2] = [1.9, 2.0]
    chain.position[1, 2] = 1.8  # spacing 0.01; most by the pipe model: 0.008 * (0.1 / 2)^(1/2) = 0.0018
    npt.assert_allclose(final_radii(chain, 1.5)[0][2:], 0.0075, rtol=1e-3)
    npt.assert_allclose(final_radii(chain, 1.5, leafy=True)[0][2:], SMALLEST_RADIUS)


def test_a_bulge_is_pooled_not_followed():
    chain = straight([0.2, 0.1, 0.15, 0.05], [100, 100, 100, 100], [1, 1, 1, 1])
    npt.assert_allclose(final_radii(chain, 1.5)[0], [0.2, 0.125, 0.125, 0.05])


def test_a_side_branch_is_no_thicker_than_its_parent():
    fork = skeleton(
        [-1, 0, 1, 1, 3],
        [[0, 0, 0], [0, 0, 2], [0, 0, 6], [1, 0, 2], [2, 0, 2]],
        [0.1, 0.1, 0.08, 0.3, 0.25],
        [50] * 5,
        [1, 1, 1, 1, 1],
    )
    npt.assert_allclose(final_radii(fork, 1.5)[0], [0.1, 0.1, 0.08, 0.1, 0.1])


@pytest.mark.parametrize("seed", range(8))
def test_radii_never_grow_towards_the_tips(seed):
    rng = np.random.default_rng(seed)
    n = 60
    parent = [-1] + [int(rng.integers(max(0, i - 4), i)) for i in range(1, n)]
    tree = skeleton(
        parent, rng.random((n, 3)) * 3, rng.random(n) * 0.2, rng.integers(0, 12, n), rng.random(n) < 0.4
    )
    radius, measured = final_radii(tree, 1.3)
    assert np.isfinite(radius).all() and (radius > 0).all()
    child = np.arange(1, n)
    assert (radius[child] <= radius[tree.parent[child]] + 1e-12).all()
    assert not measured[tree.n_points == 0].any()


def test_subtree_length_is_the_sum_of_edges(rng):
    parent = np.array([-1, 0, 1, 1, 3, 0], np.int32)
    position = rng.random((6, 3))
    edge = np.array([0] + [np.linalg.norm(position[i] - position[parent[i]]) for i in range(1, 6)])
    below = {0: range(1, 6), 1: (1, 2, 3, 4), 2: (2,), 3: (3, 4), 4: (4,), 5: (5,)}
    wanted = [sum(edge[j] for j in below[i]) for i in range(6)]
    npt.assert_allclose(kernels.subtree_length(parent, position), wanted)


def bough(points_on_it):
    """A stem of four metres with a side branch of one from its middle, as thick as the stem."""
    position = [[0, 0, z] for z in range(5)] + [[0.5, 0, 2], [1, 0, 2]]
    n_points = [0, 0, 0, 0, 1000 - points_on_it, 0, points_on_it]
    return skeleton([-1, 0, 1, 2, 3, 2, 5], position, [0.2] * 7, n_points, [1] * 7)


def test_among_leaves_a_bough_is_no_thicker_than_its_share_of_the_crown():
    # 10 of 1000 points and 0.5 of 5 metres beyond its first node: the length rules
    limited = limit_by_load(bough(10), np.full(7, 0.2))
    npt.assert_allclose(limited[5], CARRIED_MARGIN * 0.2 * np.sqrt(0.5 / 5.0 + 0.5 / 5.0), rtol=1e-12)
    npt.assert_allclose(limited[6], CARRIED_MARGIN * 0.2 * np.sqrt(0.5 / 5.0), rtol=1e-12)
    # 200 of 1000 points: now they do
    limited = limit_by_load(bough(250), np.full(7, 0.2))
    npt.assert_allclose(limited[6], min(0.2, CARRIED_MARGIN * 0.2 * np.sqrt(0.25)), rtol=1e-12)
    assert (limit_by_load(bough(10), np.full(7, 0.2), margin=9.0) == 0.2).all()
    assert (limited <= 0.2).all() and (np.diff(limited[:5]) <= 0.0).all()
    npt.assert_allclose(limited[:2], 0.2)


def test_a_load_of_nothing_leaves_the_thinnest_twig():
    bare = bough(10)
    alone = skeleton([-1, 0], [[0, 0, 0], [0, 0, 0.5]], [0.05, 0.04], [5, 0], [1, 1])
    assert (limit_by_load(alone, alone.radius) >= SMALLEST_RADIUS).all()
    moved = replace(bare, position=bare.position + [3.0, 4.0, 5.0])
    npt.assert_allclose(limit_by_load(moved, bare.radius), limit_by_load(bare, bare.radius), rtol=1e-9)


def test_what_most_points_hang_beyond_is_stem():
    # 500 points at the top of the stem, 300 on its side branch, 200 below
    tree = skeleton(
        [-1, 0, 1, 2, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3], [1, 0, 1]], [0.1] * 5,
        [0, 200, 100, 400, 300], [1] * 5,
    )  # fmt: skip
    assert carried_points(tree).tolist() == [1000, 1000, 500, 400, 300]
    assert _main_stem(tree).tolist() == [True, True, True, True, False]


def test_a_stem_among_leaves_stands_in_their_middle():
    """Tubes that were fitted to leaves had put two nodes far outside of them."""
    rng = np.random.default_rng(2)
    position = np.array([[0, 0, 0], [0, 0, 1], [5, 0, 2], [0, -7, 3.0]])
    tree = skeleton([-1, 0, 1, 2], position, [0.1] * 4, [50, 50, 400, 400], [1] * 4)
    xyz = np.repeat([[0, 0, 0], [0, 0, 1], [0.2, 0, 2], [0, 0.2, 3.0]], tree.n_points, axis=0)
    xyz += rng.normal(0.0, 0.1, xyz.shape)
    stem = _hidden_stem(xyz, tree, np.array([False, False, True, True]))
    npt.assert_array_equal(stem.position[:2], position[:2])
    assert np.abs(stem.position[2:, :2]).max() < 0.25 and (np.diff(stem.position[:, 2]) > 0.3).all()
    assert (stem.label >= 0).sum() == 100 and (stem.home == tree.home).all()
    assert stem.is_tube.tolist() == [True, True, False, False]
