"""The fidelity figures: exact scenes and slow references."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy.spatial import cKDTree

from benchmarks.fidelity_measure import (
    fit_circle,
    measure,
    model_diameter,
    slice_circle,
    spread_on_surface,
    surface_distance,
    tubes,
    unsupported_share,
)
from benchmarks.segments import Segments


def segments(start, end, r0, r1=None, parent=None):
    start, end = np.atleast_2d(np.asarray(start, float)), np.atleast_2d(np.asarray(end, float))
    r0 = np.full(len(start), r0, float) if np.isscalar(r0) else np.asarray(r0, float)
    r1 = r0 if r1 is None else np.asarray(r1, float)
    parent = np.arange(len(start)) - 1 if parent is None else np.asarray(parent)
    return Segments(start, end, r0, r1, parent)


def pipe_points(radius, height=3.0, n=20000, seed=0, noise=0.0):
    rng = np.random.default_rng(seed)
    turn = rng.random(n) * 2.0 * np.pi
    r = radius + rng.normal(0.0, noise, n)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), rng.random(n) * height])


def test_the_true_pipe_is_near_perfect():
    points = pipe_points(0.15)
    figures = measure(points, segments([0, 0, 0], [0, 0, 3], 0.15))
    flat = 0.15 * (1.0 - np.cos(np.pi / 24.0))  # the tube has 24 flat sides
    assert figures["median"] <= flat and figures["within_2cm"] == 1.0
    assert figures["back_over_10cm"] == 0.0 and figures["unsupported"] == 0.0
    npt.assert_allclose(figures["dbh_points"], 0.30, atol=1e-3)
    npt.assert_allclose(figures["dbh_model"], 0.30)
    npt.assert_allclose(figures["volume"], np.pi * 0.15**2 * 3.0)
    assert figures["dbh_arc"] == 1.0 and figures["segments"] == 1 and figures["tips"] == 1


def test_a_pipe_too_thin_is_seen_from_both_sides():
    figures = measure(pipe_points(0.25), segments([0, 0, 0], [0, 0, 3], 0.10))
    npt.assert_allclose([figures["median"], figures["back_p95"]], 0.15, atol=0.01)
    assert figures["within_10cm"] == 0.0 and figures["within_2cm"] == 0.0
    assert figures["back_over_10cm"] == 1.0  # no point within 10 cm of the surface
    assert figures["unsupported"] == 1.0  # nor within radius + 10 cm of the axis


def test_invented_wood_is_counted_by_area_and_by_length():
    model = segments([[0, 0, 0], [0, 0, 3]], [[0, 0, 3], [0, 0, 4]], [0.15, 0.15])
    figures = measure(pipe_points(0.15), model)
    npt.assert_allclose(
        figures["back_over_10cm"], 0.9 / 4.0, atol=0.01
    )  # but for 10 cm above the last points
    npt.assert_allclose(figures["unsupported"], (1.0 - 0.2) / 4.0, atol=0.015)  # sqrt(0.25^2 - 0.15^2)


def test_side_by_side_figures_do_not_depend_on_where_the_scan_stands():
    points, model = pipe_points(0.15, n=5000), segments([0.01, 0, 0], [0, 0.02, 3], 0.14)
    shift = np.array([452000.0, 5410000.0, 300.0])
    here, there = measure(points, model), measure(points + shift, model.moved(shift))
    for name in ("median", "p95", "back_p95", "dbh_points", "dbh_model", "unsupported"):
        npt.assert_allclose(there[name], here[name], atol=2e-5)


@pytest.mark.parametrize("seed", range(3))
def test_distance_to_tubes_matches_dense_samples_of_them(seed):
    rng = np.random.default_rng(seed)
    start = rng.random((6, 3))
    model = segments(start, start + rng.normal(0.0, 0.3, (6, 3)), rng.random(6) * 0.1, rng.random(6) * 0.1)
    vertices, faces = tubes(model)
    points = rng.random((200, 3)) * 2.0 - 0.5
    dense = spread_on_surface(vertices, faces, 400_000, rng)
    npt.assert_allclose(
        surface_distance(points, vertices, faces), cKDTree(dense).query(points)[0], atol=0.006
    )


def test_tubes_are_round_open_and_as_long_as_the_segment():
    model = segments([[1, 2, 3], [0, 0, 0]], [[1, 2, 5], [0.3, 0.4, 0]], [0.2, 0.05], [0.1, 0.05])
    vertices, faces = tubes(model)
    ring = vertices[:24] - [1.0, 2.0, 3.0]
    npt.assert_allclose(np.hypot(ring[:, 0], ring[:, 1]), 0.2)
    npt.assert_allclose(ring[:, 2], 0.0, atol=1e-12)
    assert len(faces) == 2 * 2 * 24 and len(vertices) == 2 * 2 * 24
    area = (
        np.linalg.norm(np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))), axis=1) / 2
    )
    npt.assert_allclose(area[48:].sum(), 2.0 * np.pi * 0.05 * 0.5, rtol=0.01)


def test_segments_without_length_or_place_have_no_tube():
    model = segments([[0, 0, 0], [0, 0, 1], [0, 0, 1]], [[0, 0, 1], [0, 0, 1], [np.nan, 0, 2]], 0.1)
    assert len(tubes(model)[1]) == 48


def test_points_spread_evenly_by_area():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    at = spread_on_surface(vertices, faces, 80_000, np.random.default_rng(0))
    count = np.histogram2d(at[:, 0], at[:, 1], bins=(4, 2), range=[[0, 2], [0, 1]])[0]
    npt.assert_allclose(count / 80_000, 1.0 / 8.0, rtol=0.05)


def test_support_reaches_radius_and_10_cm():
    tree = cKDTree([[0.19, 0.0, z] for z in np.arange(0.0, 1.0, 0.005)])
    assert unsupported_share(segments([0, 0, 0], [0, 0, 1], 0.10), tree) == 0.0
    assert unsupported_share(segments([0, 0, 0], [0, 0, 1], 0.08), tree) == 1.0


@pytest.mark.parametrize("arc", [1.0, 0.5, 0.35])
def test_circle_of_a_noisy_arc(arc):
    rng = np.random.default_rng(1)
    turn = rng.random(600) * 2.0 * np.pi * arc
    r = 0.2 + rng.normal(0.0, 0.004, 600)
    circle = fit_circle(np.column_stack([5.0 + r * np.cos(turn), -3.0 + r * np.sin(turn)]), rng)
    npt.assert_allclose(
        [circle.x, circle.y, circle.radius], [5.0, -3.0, 0.2], atol=0.01 if arc < 0.5 else 0.004
    )
    npt.assert_allclose(circle.arc, arc, atol=0.08)
    assert circle.residual < 0.006


def test_circle_is_not_drawn_off_by_a_shrub():
    rng = np.random.default_rng(2)
    trunk = pipe_points(0.12, n=4000, noise=0.003)
    shrub = rng.random((600, 3)) * [0.4, 0.4, 3.0] + [0.13, -0.2, 0.0]
    circle = slice_circle(np.concatenate([trunk, shrub]), 0.0, rng)
    npt.assert_allclose(circle.radius, 0.12, atol=0.006)


def test_slice_is_the_largest_clump_above_the_foot():
    near, far = pipe_points(0.1, n=4000), pipe_points(0.3, n=2000) + [3.0, 0.0, 0.0]
    circle = slice_circle(np.concatenate([near, far]) + [0.0, 0.0, 7.0], 7.0, np.random.default_rng(0))
    npt.assert_allclose([circle.x, circle.radius], [0.0, 0.1], atol=2e-3)
    assert slice_circle(near, 5.0, np.random.default_rng(0)) is None


def test_diameter_of_the_model_at_a_height():
    model = segments(
        [[0, 0, 0], [4, 0, 0], [0, 0, 1]], [[0, 0, 2], [4, 0, 3], [2, 0, 1]], [0.2, 0.5, 0.9], [0.1, 0.5, 0.9]
    )
    npt.assert_allclose(model_diameter(model, 1.5, np.zeros(2)), 2.0 * 0.125)
    npt.assert_allclose(model_diameter(model, 1.5, None), 1.0)
    assert model_diameter(model, 9.0, None) is None
