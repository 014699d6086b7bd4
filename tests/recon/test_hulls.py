"""Hulls: known shapes, a slow reference for alpha_min, invariants, degenerate points, messages."""

from collections import Counter

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, Delaunay

from recon.hulls import MINIMUM_SIZE, alpha_hull, mesh_volume, thin_points


def check_closed(hull):
    """Every directed edge once and its opposite once; no unused vertex; a positive volume."""
    faces = hull.faces
    edge = [(int(f[i]), int(f[(i + 1) % 3])) for f in faces for i in range(3)]
    count = Counter(edge)
    assert max(count.values()) == 1
    assert all((b, a) in count for a, b in count)
    assert sorted(set(faces.ravel().tolist())) == list(range(len(hull.vertices)))
    assert np.isfinite(hull.vertices).all()
    assert hull.volume > 0.0


def euler(hull):
    return len(hull.vertices) - len(hull.faces) // 2


def n_bodies(faces):
    label = np.arange(faces.max() + 1)
    for _ in range(len(label)):
        new = label.copy()
        for f in faces:
            new[f] = new[f].min()
        if (new == label).all():
            return len(set(label.tolist()))
        label = new
    raise AssertionError("did not settle")


def outside_distance(points, hull):
    """Distance of each point to the hull, 0 inside, by plain NumPy (winding angles, sampled faces)."""
    a, b, c = (hull.vertices[hull.faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    det = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(2) * lc + (b * c).sum(2) * la + (c * a).sum(2) * lb
    inside = np.arctan2(det, below).sum(axis=1) * 2.0 > 2.0 * np.pi
    weight = np.array([[i, j, 12 - i - j] for i in range(13) for j in range(13 - i)]) / 12.0
    surface = (weight @ hull.vertices[hull.faces]).reshape(-1, 3)
    gap = np.sqrt(((points[:, None] - surface[None]) ** 2).sum(2).min(axis=1))
    return np.where(inside, 0.0, gap)


def sphere(n):
    k = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * k / n, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


def torus(n_ring, n_tube, big, small):
    u, v = np.meshgrid(np.arange(n_ring) * 2 * np.pi / n_ring, np.arange(n_tube) * 2 * np.pi / n_tube)
    u, v = u.ravel(), v.ravel()
    r = big + small * np.cos(v)
    return np.column_stack([r * np.cos(u), r * np.sin(u), small * np.sin(v)])


def reference_alpha_min(points):
    """Every circumradius in turn: all corners used, one piece by faces, outside in one piece."""
    mesh = Delaunay(points)
    radius = []
    for corners in points[mesh.simplices]:
        d = corners[1:] - corners[0]
        radius.append(float(np.linalg.norm(np.linalg.solve(2.0 * d, (d * d).sum(axis=1)))))
    n = len(radius)

    def pieces(cells, neighbours):
        todo, count = set(cells), 0
        while todo:
            stack = [todo.pop()]
            count += 1
            while stack:
                for s in neighbours(stack.pop()):
                    if s in todo:
                        todo.remove(s)
                        stack.append(s)
        return count

    def inner(t):
        return mesh.neighbors[t].tolist()

    at_border = [t for t in range(n) if -1 in inner(t)]

    def outer(t):  # the cell -1 is the outside
        return at_border if t == -1 else inner(t)

    for alpha in sorted(radius):
        kept = {t for t in range(n) if radius[t] <= alpha * (1.0 + 1e-9)}
        covered = len(np.unique(mesh.simplices[sorted(kept)])) == len(points)
        rest = set(range(-1, n)) - kept
        if covered and pieces(kept, inner) == 1 and pieces(rest, outer) == 1:
            return alpha
    raise AssertionError("all tetrahedra together must do")


@pytest.mark.parametrize("n", [5, 8, 15, 40, 120])
@pytest.mark.parametrize("seed", range(4))
def test_alpha_min_matches_reference(n, seed):
    rng = np.random.default_rng(seed)
    points = rng.random((n, 3)) * [1.0, 2.0, 0.7]
    if seed % 2:
        points[: n // 2] += [3.0, 0.0, 0.0]
    hull = alpha_hull(points)
    npt.assert_allclose(hull.alpha_min, reference_alpha_min(points), rtol=1e-3)
    npt.assert_allclose(hull.alpha, 5.0 * hull.alpha_min, rtol=1e-12)
    check_closed(hull)


def test_sphere_has_its_volume_and_roundness():
    hull = alpha_hull(sphere(3000), max_faces=150)
    check_closed(hull)
    assert len(hull.faces) <= 150
    npt.assert_allclose(hull.volume, 4.0 / 3.0 * np.pi, rtol=0.06)
    npt.assert_allclose(np.linalg.norm(hull.vertices, axis=1), 1.0, atol=0.06)
    assert euler(hull) == 2


def test_cube_with_many_points_keeps_its_size():
    axis = np.linspace(0.0, 1.0, 14)
    points = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    hull = alpha_hull(points, max_points=400, max_faces=60)
    check_closed(hull)
    npt.assert_allclose(hull.volume, 1.0, rtol=0.03)


def test_torus_keeps_its_hole_with_small_alpha_and_loses_it_with_large():
    rng = np.random.default_rng(3)
    ring = torus(36, 10, 1.0, 0.25)
    core = torus(36, 1, 1.0, 0.0)
    points = np.concatenate([ring, core]) + rng.normal(0.0, 0.002, (396, 3))
    open_hull = alpha_hull(points, multiple=1.2, max_faces=400)
    check_closed(open_hull)
    assert euler(open_hull) == 0
    closed_hull = alpha_hull(points, multiple=100.0, max_faces=400)
    check_closed(closed_hull)
    assert euler(closed_hull) == 2
    npt.assert_allclose(closed_hull.volume, ConvexHull(points).volume, rtol=0.02)


def test_two_blobs_are_joined():
    rng = np.random.default_rng(0)
    blob = rng.normal(size=(400, 3))
    blob /= np.maximum(np.linalg.norm(blob, axis=1, keepdims=True), 1.0)
    apart = 6.0
    hull = alpha_hull(np.concatenate([blob, blob + [apart, 0.0, 0.0]]))
    check_closed(hull)
    assert n_bodies(hull.faces) == 1
    assert hull.alpha_min > (apart - 2.0) / 2.0 * 0.9  # the ball that bridges the gap
    assert alpha_hull(blob).alpha_min < 0.5 * hull.alpha_min


def test_shell_is_filled():
    """A hollow crown is one surface: no second one inside."""
    hull = alpha_hull(np.concatenate([sphere(700), 0.8 * sphere(450)]), multiple=1.0, max_points=2000)
    check_closed(hull)
    assert n_bodies(hull.faces) == 1


@pytest.mark.parametrize("seed", range(5))
def test_holds_nearly_all_points(seed):
    rng = np.random.default_rng(seed)
    middle = rng.random((30, 3)) * [2.0, 1.0, 1.5]
    points = middle[rng.integers(30, size=1200)] + rng.normal(0.0, 0.08, (1200, 3))
    hull = alpha_hull(points)
    check_closed(hull)
    assert 12 <= len(hull.faces) <= 120
    allowed = hull.spacing + 0.02 * np.ptp(points, axis=0).max()
    gap = outside_distance(points[::4], hull)
    assert (gap <= allowed).mean() >= 0.95
    assert (gap <= 0.0).mean() > 0.7


DEGENERATE = {
    "one point": np.array([[1.0, 2.0, 3.0]]),
    "two points": np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]),
    "three points": np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 2.0]]),
    "same point often": np.full((50, 3), 7.25),
    "collinear": np.linspace(0.0, 1.0, 40)[:, None] * [1.0, 2.0, 3.0],
    "coplanar": np.random.default_rng(0).random((200, 3)) @ np.diag([1.0, 2.0, 0.0]) + [0.0, 0.0, 4.0],
    "slanted plane": np.random.default_rng(0).random((90, 2)) @ np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]]),
    "square": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float),
    "nearly coplanar": np.random.default_rng(1).random((90, 3)) * [1.0, 1.0, 1e-9],
    "tiny": np.random.default_rng(2).random((60, 3)) * 1e-4,
    "four": np.random.default_rng(3).random((4, 3)),
    "lattice": np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3),
    "lattice, duplicated": np.repeat(np.stack(np.meshgrid(*[np.arange(3.0)] * 3), -1).reshape(-1, 3), 3, 0),
    "stray far away": np.r_[np.random.default_rng(4).random((80, 3)), [[1000.0, 0.0, 0.0]]],
    "needle": np.random.default_rng(5).random((80, 3)) * [10.0, 0.03, 0.03],
    "map coordinates": np.random.default_rng(6).random((80, 3)) + [4.5e5, 5.4e6, 300.0],
}


@pytest.mark.parametrize("points", DEGENERATE.values(), ids=DEGENERATE)
def test_degenerate_points_get_a_closed_hull(points):
    hull = alpha_hull(points)
    check_closed(hull)
    assert len(hull.faces) <= 120
    low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
    slack = MINIMUM_SIZE + (0.3 if np.isnan(hull.alpha) else 0.05) * np.ptp(points, axis=0).max()
    assert (low >= points.min(axis=0) - slack).all() and (high <= points.max(axis=0) + slack).all()
    assert (low <= points.min(axis=0) + slack).all() and (high >= points.max(axis=0) - slack).all()


def test_box_of_one_point_has_the_minimum_size():
    hull = alpha_hull(np.zeros((1, 3)), minimum_size=0.1)
    npt.assert_allclose(hull.volume, 0.001)
    assert np.isnan(hull.alpha_min) and np.isnan(hull.alpha)


def cluster(seed, n=300):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 3)) * [1.0, 0.6, 0.4]


def test_order_of_points_does_not_matter():
    points = cluster(0, 1500)
    hull = alpha_hull(points)
    again = alpha_hull(np.random.default_rng(1).permutation(points))
    npt.assert_array_equal(hull.vertices, again.vertices)
    npt.assert_array_equal(hull.faces, again.faces)
    assert hull.alpha_min == again.alpha_min


def test_moves_with_the_points():
    points = np.round(cluster(2) * 1024.0) / 1024.0  # sums with whole metres are exact
    shift = np.array([400.0, -96.0, 8.0])
    hull, moved = alpha_hull(points), alpha_hull(points + shift)
    npt.assert_array_equal(hull.faces, moved.faces)
    npt.assert_allclose(moved.vertices - shift, hull.vertices, atol=1e-9)


def test_scales_with_the_points():
    points = cluster(3)
    hull, larger = alpha_hull(points), alpha_hull(8.0 * points)
    npt.assert_allclose(larger.volume, 512.0 * hull.volume, rtol=1e-9)
    npt.assert_allclose(larger.alpha_min, 8.0 * hull.alpha_min, rtol=1e-9)


def test_larger_alpha_is_the_convex_hull():
    points = cluster(4, 200)
    hull = alpha_hull(points, multiple=1e6, max_faces=1000)
    npt.assert_allclose(hull.volume, ConvexHull(points).volume, rtol=1e-5)


@given(st.integers(0, 10**6), st.integers(4, 90), st.floats(1.0, 6.0), st.sampled_from([12, 20, 60]))
@example(78, 78, 1.0, 12)  # a grid whose tetrahedra were flat to the last bit, and turned inside out
@settings(deadline=None, max_examples=60)
def test_any_points_any_budget(seed, n, multiple, max_faces):
    rng = np.random.default_rng(seed)
    points = rng.random((n, 3)) if seed % 3 else rng.integers(0, 4, (n, 3)).astype(float)
    hull = alpha_hull(points, multiple=multiple, max_faces=max_faces)
    check_closed(hull)
    assert len(hull.faces) <= max_faces
    assert n_bodies(hull.faces) == 1


@given(st.integers(0, 10**6), st.integers(1, 400), st.integers(4, 100))
@settings(deadline=None, max_examples=60)
def test_thinning_keeps_points_of_the_input(seed, n, max_points):
    rng = np.random.default_rng(seed)
    points = rng.random((n, 3))
    kept, spacing = thin_points(points, max_points)
    assert 1 <= len(kept) <= max_points
    assert {tuple(p) for p in kept.tolist()} <= {tuple(p) for p in points.tolist()}
    gap = np.sqrt(((points[:, None] - kept[None]) ** 2).sum(2).min(axis=1))
    assert gap.max() <= spacing * 3.0**0.5 + 1e-12


def test_volume_of_a_tetrahedron():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float) + 100.0
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    npt.assert_allclose(mesh_volume(vertices, faces), 1.0 / 6.0)
    npt.assert_allclose(mesh_volume(vertices, faces[:, ::-1]), -1.0 / 6.0)


@pytest.mark.parametrize(
    "points, match",
    [
        (np.zeros((0, 3)), r"points must have shape \(n, 3\) with n > 0, got \(0, 3\)"),
        (np.zeros((4, 2)), r"got \(4, 2\)"),
        (np.array([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]]), r"must be finite.* at row 1 \(1 of 2 such rows\)"),
    ],
)
def test_bad_points(points, match):
    with pytest.raises(ValueError, match=match):
        alpha_hull(points)


@pytest.mark.parametrize(
    "argument, match",
    [
        ({"max_points": 3}, "max_points must be at least 4, got 3"),
        ({"max_faces": 11}, "max_faces must be at least 12"),
        ({"multiple": 0.5}, "multiple must be at least 1, got 0.5"),
        ({"multiple": np.nan}, "multiple must be at least 1, got nan"),
        ({"minimum_size": 0.0}, "minimum_size must be a positive finite number"),
    ],
)
def test_bad_parameters(argument, match):
    with pytest.raises(ValueError, match=match):
        alpha_hull(np.zeros((5, 3)), **argument)
