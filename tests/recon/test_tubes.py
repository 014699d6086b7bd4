import numpy as np
import numpy.testing as npt
import pytest
from sklearn.isotonic import IsotonicRegression
from synthetic import tube

from recon import _tube_kernels as kernels
from recon.encoding import build_skeleton
from recon.ordering import morton_order
from recon.skeleton import chains_of, merge_nodes, reorder


def circle(rng, n=200, centre=(0.3, -0.2), r=0.25, arc=1.0, noise=0.0):
    angle = rng.random(n) * 2 * np.pi * arc
    radius = r + noise * rng.standard_normal(n)
    return centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)


@pytest.mark.parametrize("arc", [1.0, 0.5, 0.2])
def test_circle_through_exact_points(rng, arc):
    x, y = circle(rng, arc=arc)
    npt.assert_allclose(kernels.circle_through(x, y, np.ones(x.size)), (0.3, -0.2, 0.25), atol=1e-9)


def test_collinear_points_have_no_circle():
    x = np.linspace(0, 1, 10)
    assert np.isnan(kernels.circle_through(x, 2 * x, np.ones(10))).all()


def test_refined_circle_ignores_outliers(rng):
    x, y = circle(rng, noise=0.002)
    x[:30] += 0.6 * rng.random(30)
    weight = np.ones(x.size)
    cx, cy, r, scale = kernels.refine_circle(x, y, 0.25, -0.15, 0.2, weight, 20)
    npt.assert_allclose((cx, cy, r), (0.3, -0.2, 0.25), atol=0.002)
    assert 0.001 < scale < 0.004
    assert (weight[:30][np.abs(np.hypot(x[:30] - 0.3, y[:30] + 0.2) - 0.25) > 0.05] == 0).all()


@pytest.mark.parametrize("arc", [1.0, 0.5, 0.25])
def test_arc_is_the_share_of_the_round(rng, arc):
    x, y = circle(rng, 2000, arc=arc)
    got = kernels.arc_covered(x, y, 0.3, -0.2, np.ones(x.size))
    assert got == pytest.approx(arc, abs=2 / kernels.ARC_BINS)


def test_decreasing_fit_is_isotonic_regression(rng):
    for _ in range(20):
        value, weight = rng.random(30), rng.random(30) + 0.1
        wanted = IsotonicRegression(increasing=False).fit(np.arange(30), value, weight).predict(np.arange(30))
        npt.assert_allclose(kernels.decreasing_fit(value, weight), wanted, atol=1e-12)


def test_plane_basis_is_orthonormal(rng):
    for _ in range(20):
        axis = rng.standard_normal(3)
        axis /= np.linalg.norm(axis)
        u, v = kernels.plane_basis(axis)
        npt.assert_allclose(np.stack([axis, u, v]) @ np.stack([axis, u, v]).T, np.eye(3), atol=1e-12)


def skeleton_of(xyz, base=(0, 0, 0)):
    xyz = xyz[morton_order(xyz)[0]]
    return build_skeleton(xyz, np.asarray(base, float), beta=2.0), xyz


def off_axis(skeleton, start, end):
    d = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    p = skeleton.position - start
    return np.linalg.norm(p - (p @ d)[:, None] * d, axis=1)


@pytest.mark.parametrize("direction", [(0, 0, 3.0), (2.0, 1.0, 2.0), (3.0, 0, 0)])
def test_cylinder_has_its_axis_and_radius(rng, direction):
    xyz = tube((0, 0, 0), direction, 0.1, 0.1, 8000, rng, noise=0.003)
    skeleton, _ = skeleton_of(xyz)
    middle = slice(3, -3)
    assert off_axis(skeleton, (0, 0, 0), direction)[middle].max() < 0.01
    npt.assert_allclose(skeleton.radius[middle], 0.1, rtol=0.03)
    assert skeleton.is_tube[middle].all()


def test_half_a_cylinder_has_its_axis_not_that_of_its_points(rng):
    xyz = tube((0, 0, 0), (0, 0, 3.0), 0.15, 0.04, 8000, rng, arc=0.5, noise=0.002)
    skeleton, _ = skeleton_of(xyz)
    middle = slice(2, -2)
    off = off_axis(skeleton, (0, 0, 0), (0, 0, 1))[middle]
    assert off.max() < 0.03  # the mean of the points is 0.095 off at the foot
    npt.assert_allclose(skeleton.radius[middle], 0.15 - 0.11 * skeleton.position[middle, 2] / 3, rtol=0.1)


def test_a_quarter_of_a_cylinder_is_not_measured(rng):
    xyz = tube((0, 0, 0), (0, 0, 3.0), 0.15, 0.04, 8000, rng, arc=0.25, noise=0.002)
    assert not skeleton_of(xyz)[0].is_tube.any()


def test_no_branch_is_thicker_than_the_thickest(rng):
    xyz = tube((0, 0, 0), (0, 0, 3.0), 0.15, 0.12, 8000, rng, noise=0.002)
    xyz = xyz[morton_order(xyz)[0]]
    skeleton = build_skeleton(xyz, np.zeros(3), beta=2.0, thickest=0.08)
    assert skeleton.radius.max() <= 0.08 and not skeleton.is_tube.any()


def refined(xyz, label, parent, position, radius, is_tube):
    parent, position = np.array(parent, np.int32), np.array(position, float)
    onward = kernels.continuations(parent, kernels.subtree_length(parent, position))
    start, point = kernels.group_points(label.astype(np.int32), parent.size)
    return kernels.refine_tubes(
        xyz, start, point, parent, onward, position, np.array(radius), np.array(is_tube), position,
        *(1e-3, 30, 0.1, 0.1),
    )[:2]  # fmt: skip


@pytest.mark.parametrize("is_tube, low, high", [(True, -0.01, 0.01), (False, 0.03, 0.08)])
def test_tubes_go_around_their_points_and_other_axes_through_them(rng, is_tube, low, high):
    # the middle of the points is 0.064 from the axis
    xyz = tube((0, 0, 0), (0, 0, 1.0), 0.1, 0.1, 4000, rng, arc=0.5, noise=0.001)
    middle = xyz[:, :2].mean(axis=0) / np.linalg.norm(xyz[:, :2].mean(axis=0))
    start = [[*(0.02 * middle), z] for z in (0.0, 0.25, 0.5, 0.75, 1.0)]
    label = np.clip(np.round(xyz[:, 2] * 4), 0, 4)
    position, _ = refined(xyz, label, [-1, 0, 1, 2, 3], start, [0.1] * 5, [is_tube] * 5)
    across = position[:, :2] @ middle
    assert low < across.min() and across.max() < high


def test_a_side_branch_begins_with_its_own_radius(rng):
    trunk = tube((0, 0, 0), (0, 0, 2.0), 0.2, 0.2, 8000, rng)
    side = tube((0.2, 0, 1.0), (0.8, 0, 1.0), 0.03, 0.03, 3000, rng)
    position = [[0, 0, 0], [0, 0, 1.0], [0, 0, 2.0], [0.4, 0, 1.0], [0.6, 0, 1.0], [0.8, 0, 1.0]]
    label = np.concatenate([np.round(trunk[:, 2]), np.clip(np.round(side[:, 0] * 5), 2, 4) + 1])
    _, radius = refined(
        np.concatenate([trunk, side]),
        label,
        [-1, 0, 1, 1, 3, 4],
        position,
        [0.2] * 3 + [0.03] * 3,
        [True] * 6,
    )
    npt.assert_allclose(radius, [0.2] * 3 + [0.03] * 3, rtol=0.03)


def test_two_halves_that_do_not_touch_are_one_trunk(rng):
    xyz = np.concatenate(
        [
            tube((0, 0, 0), (0, 0, 3.0), 0.2, 0.2, 6000, rng, arc=0.47, noise=0.002),
            tube((0, 0, 0), (0, 0, 3.0), 0.2, 0.2, 6000, rng, arc=0.47, noise=0.002) * [-1, 1, 1],
        ]
    )
    skeleton, _ = skeleton_of(xyz)
    n_children = np.bincount(skeleton.parent[1:], minlength=skeleton.n_nodes)
    assert (n_children <= 1).all()
    npt.assert_allclose(skeleton.radius[2:-2], 0.2, rtol=0.05)


def test_taper_is_followed(rng):
    xyz = tube((0, 0, 0), (0, 0, 4.0), 0.15, 0.05, 12000, rng, noise=0.002)
    skeleton, _ = skeleton_of(xyz)
    wanted = 0.15 - 0.1 * skeleton.position[:, 2] / 4
    npt.assert_allclose(skeleton.radius[2:-2], wanted[2:-2], rtol=0.06)


def test_merging_and_reordering_keep_points_and_parents(rng):
    xyz = np.concatenate(
        [tube((0, 0, 0), (0, 0, 2), 0.1, 0.1, 4000, rng), tube((0, 0, 1), (1, 0, 1.8), 0.03, 0.03, 1500, rng)]
    )
    skeleton, xyz = skeleton_of(xyz)
    tip = int(np.flatnonzero(np.bincount(skeleton.parent[1:], minlength=skeleton.n_nodes) == 0)[0])
    into = np.arange(skeleton.n_nodes)
    into[tip] = skeleton.parent[tip]
    kept, lost = merge_nodes(skeleton, into), merge_nodes(skeleton, into, lose=True)
    assert kept.n_nodes == lost.n_nodes == skeleton.n_nodes - 1
    mine = skeleton.label == tip
    assert mine.any()
    assert (kept.label[mine] >= 0).all() and (lost.label[mine] == -1).all()
    npt.assert_allclose(
        kept.position[lost.home[mine]], skeleton.position[[skeleton.parent[tip]] * mine.sum()]
    )
    npt.assert_array_equal(kept.label[~mine] < 0, skeleton.label[~mine] < 0)
    order = np.argsort(chains_of(kept).n_points, kind="stable")
    order = np.concatenate([[0], order[order != 0]])
    moved = reorder(kept, order)
    npt.assert_allclose(
        moved.position[moved.label[kept.label >= 0]], kept.position[kept.label[kept.label >= 0]]
    )
    child = np.flatnonzero(moved.parent >= 0)
    there = {
        tuple(p) for p in np.hstack([moved.position[child], moved.position[moved.parent[child]]]).tolist()
    }
    child = np.flatnonzero(kept.parent >= 0)
    assert there == {
        tuple(p) for p in np.hstack([kept.position[child], kept.position[kept.parent[child]]]).tolist()
    }


def test_a_circle_unlike_its_neighbours_is_not_believed():
    radius = np.array([0.10, 0.11, 0.30, 0.10, 0.09, 0.02, 0.10, 0.09])
    onward = np.array([1, 2, 3, 4, 5, 6, 7, -1], np.int32)
    believed = kernels.believable_circles(np.array([0]), onward, radius, np.ones(8, bool), 4, 0.3)
    assert believed.tolist() == [True, True, False, True, True, False, True, True]


@pytest.mark.parametrize("reach, bridged", [(10.0, True), (3.0, False)])
def test_centres_between_two_near_circles_are_in_line(reach, bridged):
    position = np.array([[0.0, 0, 0], [0.05, 0, 0.1], [0.05, 0, 0.3], [0, 0, 0.4], [0.05, 0, 0.5]])
    accepted = np.array([True, False, False, True, False])
    onward = np.array([1, 2, 3, 4, -1], np.int32)
    got = kernels.bridge_centres(
        np.array([0]), onward, position, position.copy(), accepted, np.full(5, 0.1), reach
    )
    npt.assert_allclose(got[[1, 2], 0], 0.0 if bridged else 0.05, atol=1e-12)
    npt.assert_array_equal(got[[0, 3, 4]], position[[0, 3, 4]])
