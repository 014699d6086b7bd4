"""Camera, rasteriser and light against closed forms."""

import numba
import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from render import _raster_kernels as kernels
from render.camera import Camera, fit_camera, view_axes
from render.lighting import (
    Layer,
    cast_rays,
    gather_sky,
    ground_sky,
    light_layer,
    make_light,
    sky_directions,
    to_linear,
    to_srgb,
)
from render.software import LitLayer, SoftwareRenderer
from treegraph import InputError

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT, reason="drawing without compiled loops takes minutes"
)

UP = np.array([[0.0, 0.0, 1.0]])
NOBODY = np.empty((0, 0), np.int32)


def quad(z, half=1.0, centre=(0.0, 0.0)):
    """A level square seen from above."""
    corner = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half + centre
    vertices = np.column_stack([corner, np.full(4, z)])
    return vertices, np.array([(0, 1, 2), (0, 2, 3)], np.int32)


def layer(vertices, faces, **more):
    normals = np.tile(UP, (len(vertices), 1))
    return Layer(vertices, faces, normals, np.full((len(vertices), 3), 0.5), **more)


def both_sides(vertices, faces):
    return vertices, np.concatenate([faces, faces[:, ::-1]])


# Camera


ASPECTS = st.sampled_from([(1, 1), (3, 1), (1, 4)])


@given(st.integers(0, 10**6), st.floats(-3, 3), st.floats(-1.4, 1.4), st.floats(0.01, 100), ASPECTS)
@settings(deadline=None, max_examples=100)
def test_camera_holds_every_point_and_touches_the_frame(seed, azimuth, elevation, size, aspect):
    rng = np.random.default_rng(seed)
    points = (
        rng.normal(size=(rng.integers(1, 50), 3)) * rng.lognormal(0, 1, 3) * size + rng.normal(size=3) * 100
    )
    width, height = 100 * aspect[0], 100 * aspect[1]
    camera = fit_camera(points, view_axes(azimuth, elevation), width, height, margin=0.1, bottom=0.2)
    x, y, depth = camera.project(points, width, height).T
    assert (depth > 0).all()
    x, y = x / width, y / height
    eps = 1e-6
    assert x.min() > 0.1 - eps and x.max() < 0.9 + eps and y.min() > 0.1 - eps and y.max() < 0.8 + eps
    npt.assert_allclose((x.min() + x.max()) / 2, 0.5, atol=0.2)
    if len(points) > 10 and np.ptp(points @ camera.axes[2]) < np.ptp(points @ camera.axes[0]):
        gap = min(x.min() - 0.1, y.min() - 0.1, 0.9 - x.max(), 0.8 - y.max())
        assert gap < 0.01  # the nearest such camera


def test_view_axes_are_a_right_handed_frame():
    right, up, forward = view_axes(0.7, 0.3)
    npt.assert_allclose(np.cross(right, up), -forward, atol=1e-15)
    assert up[2] > 0 and abs(right[2]) < 1e-15
    npt.assert_allclose(view_axes(0.0, 0.0)[2], (-1, 0, 0), atol=1e-15)  # seen from +x


def test_camera_needs_points():
    with pytest.raises(InputError, match="at least one point, all of them finite, got 0 points"):
        fit_camera(np.zeros((0, 3)), view_axes(0, 0), 10, 10)


# Rasteriser


def draw(vertices, faces, size=32):
    screen = np.empty((len(vertices), 3))
    kernels.project(
        vertices,
        view_axes(-np.pi / 2, np.pi / 2),
        np.zeros(3),
        0.5 * size,
        kernels.PARALLEL,
        size,
        size,
        screen,
    )
    key = np.full((size, size), kernels.NOTHING, np.float32)
    owner = np.full((size, size), -1, np.int32)
    kernels.draw_triangles(screen, faces, key, owner)
    return key, owner


def test_triangles_cover_the_pixels_whose_middles_they_hold():
    rng = np.random.default_rng(0)
    for _ in range(50):
        corner = rng.uniform(-1.2, 1.2, (3, 2))
        a, b, c = corner
        turn = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]
        if turn < 0:
            corner = corner[::-1]
        key, owner = draw(np.column_stack([corner, np.zeros(3)]), np.array([[0, 1, 2]], np.int32))
        y, x = np.mgrid[0:32, 0:32]
        px, py = (x + 0.5) / 16 - 1, 1 - (y + 0.5) / 16
        a, b, c = corner
        inside = np.ones((32, 32), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= (q[0] - p[0]) * (py - p[1]) - (q[1] - p[1]) * (px - p[0]) >= 0
        npt.assert_array_equal(owner >= 0, inside)
        npt.assert_array_equal(key > kernels.NOTHING, inside)


def test_the_nearest_triangle_wins_and_backs_are_not_drawn():
    low, faces = quad(0.0)
    high, _ = quad(0.5, half=0.5)
    stack = np.concatenate([high, low])
    key, owner = draw(stack, np.concatenate([faces, faces + 4]))
    assert set(owner[12:20, 12:20].ravel()) == {0, 1} and set(owner[:4].ravel()) == {2, 3}
    npt.assert_allclose(key[16, 16], 0.5)
    assert (draw(low, faces[:, ::-1])[1] == -1).all()


def test_colours_are_interpolated_in_perspective():
    """A strip that runs away from the eye: its middle in space is not its middle on the screen."""
    vertices = np.array([(-1, 1, 0), (1, 1, 0), (1, 9, 0), (-1, 9, 0)], float)
    faces = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
    camera = Camera(np.array([0.0, 0.0, 1.0]), view_axes(-np.pi / 2, 0.0), 1.0)
    color = np.array([[0] * 3, [0] * 3, [240] * 3, [240] * 3], np.uint8)
    seen = SoftwareRenderer().draw(camera, 201, 200, [LitLayer(layer(vertices, faces), color, color)])[0]
    rows = np.flatnonzero(seen.key[:, 100] > kernels.NOTHING)
    depth = 100 / (rows + 0.5 - 100)  # a point on the ground below a camera one metre above it
    npt.assert_allclose(1 / seen.key[rows, 100], depth, rtol=1e-5)
    npt.assert_allclose(seen.ambient[rows, 100, 0], (depth - 1) * 30, atol=0.51)


def test_what_is_behind_the_eye_is_not_drawn():
    vertices, faces = quad(0.0)
    camera = Camera(np.array([0.0, 0.0, -1.0]), view_axes(0.0, np.pi / 2), 1.0)
    color = np.zeros((4, 3), np.uint8)
    seen = SoftwareRenderer().draw(camera, 20, 20, [LitLayer(layer(vertices, faces), color, color)])[0]
    assert (seen.key == kernels.NOTHING).all()


def test_points_are_discs_of_their_size():
    screen = np.array([[16.0, 16.0, 1.0]])
    key = np.full((32, 32), kernels.NOTHING, np.float32)
    kernels.draw_points(screen, 6.0, False, key, NOBODY)
    npt.assert_allclose((key > kernels.NOTHING).sum(), np.pi * 36, rtol=0.03)


# Light


def test_sky_directions_are_even():
    d = sky_directions(400)
    npt.assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    npt.assert_allclose(d.mean(axis=0), (0, 0, 0.5), atol=0.005)
    npt.assert_allclose((d[:, :2] ** 2).mean(), 1 / 3, atol=0.005)


def far_away():
    """A layer that hides nothing from the origin."""
    return layer(*quad(-100.0, 0.001))


def test_open_sky_is_the_view_factor():
    """A surface whose normal is tilted by a from the zenith sees (1 + cos a) / 2 of the sky."""
    sky = cast_rays([far_away()], sky_directions(2000), 16)
    angle = np.linspace(0, np.pi, 7)
    normals = np.column_stack([np.sin(angle), np.zeros(7), np.cos(angle)])
    light = gather_sky(np.zeros((7, 3)), normals, sky)
    npt.assert_allclose(light, (1 + np.cos(angle)) / 2, atol=0.01)


def test_furnace():
    """All light from an open sky, none under a lid."""
    sky = cast_rays([layer(*both_sides(*quad(5.0, 40.0)))], sky_directions(200), 256)
    points = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, 10.0)])
    npt.assert_allclose(gather_sky(points, np.tile(UP, (2, 1)), sky), (0.0, 1.0), atol=0.03)


def test_sky_below_a_disc_is_its_view_factor():
    """A disc of radius r at height h hides r^2 / (r^2 + h^2) of the light below its middle."""
    turn = np.linspace(0, 2 * np.pi, 65)[:-1]
    rim = np.column_stack([2 * np.cos(turn), 2 * np.sin(turn), np.full(64, 2.0)])
    vertices = np.concatenate([[(0, 0, 2.0)], rim])
    faces = np.array([(0, 1 + k, 1 + (k + 1) % 64) for k in range(64)], np.int32)
    sky = cast_rays([layer(vertices, faces)], sky_directions(1000), 256)
    npt.assert_allclose(gather_sky(np.zeros((1, 3)), UP, sky), 0.5, atol=0.02)


def test_a_shadow_falls_where_the_sun_says():
    plate = layer(*both_sides(*quad(2.0, 0.5)))
    direction = np.array([[0.6, 0.0, 0.8]])
    rays = cast_rays([plate], direction, 512)
    x = np.linspace(-4, 4, 801)
    seen = [
        kernels.light_seen(rays.shadow[0], rays.axes[0], rays.centre, rays.focal, a, 0.0, 0.0, rays.bias)
        for a in x
    ]
    dark = x[np.array(seen) < 0.5]
    npt.assert_allclose([dark.min(), dark.max()], [-2.0, -1.0], atol=0.02)  # shifted by 2 * 0.6 / 0.8


def test_a_plate_does_not_shade_itself():
    plate = layer(*both_sides(*quad(0.0, 3.0)))
    light = make_light([plate], None, view_axes(-1.0, 0.2))
    grid = np.linspace(-2.5, 2.5, 41)
    points = np.array([(a, b, 0.0) for a in grid for b in grid])
    sun = light.sun
    seen = [
        kernels.light_seen(sun.shadow[0], sun.axes[0], sun.centre, sun.focal, *p, sun.bias) for p in points
    ]
    npt.assert_allclose(seen, 1.0)
    assert gather_sky(points, np.tile(UP, (len(points), 1)), light.sky).min() > 0.97


def test_ground_is_darker_under_the_tree_and_open_far_away():
    plate = layer(*both_sides(*quad(1.0, 1.0)))
    sky = cast_rays([plate], sky_directions(60), 128)
    shade = ground_sky(sky, np.zeros(2), 0.0, 6.0)
    assert shade.min() == pytest.approx(shade[len(shade) // 2, len(shade) // 2], abs=0.02)
    assert shade.min() < 0.55 and shade[0, 0] > 0.95 and shade.max() <= 1.01
    npt.assert_allclose(shade, shade.T, atol=0.12)


def test_light_does_not_come_from_nothing():
    """No vertex gives back more than its albedo times the light there is."""
    plate = layer(*both_sides(*quad(0.0, 3.0)))
    light = make_light([plate], None, view_axes(-1.0, 0.2))
    ambient, direct = light_layer(plate, light)
    from render.lighting import FILL_COLOR, SKY_COLOR, STORED_MAX, SUN_COLOR

    brightest = 0.5 * (SKY_COLOR + FILL_COLOR + SUN_COLOR)
    total = STORED_MAX * ((ambient / 255.0) ** 2 + (direct / 255.0) ** 2)
    assert (total <= brightest * 1.02).all() and (total > 0.5 * brightest).all()


def test_srgb_is_inverted():
    x = np.linspace(0, 1, 1001)
    npt.assert_allclose(to_srgb(to_linear(x)), x, atol=1e-7)
    npt.assert_allclose(to_linear(np.array([0.5])), 0.21404, atol=1e-5)
    npt.assert_allclose(to_srgb(np.array([-1.0, 2.0])), [0.0, 1.0])
