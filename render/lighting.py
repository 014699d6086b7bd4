"""Light on a tree: a sun with a shadow map, and a sky that is seen or hidden direction by direction.

Sky light is gathered from the shadow maps of a few dozen directions spread over the upper hemisphere, so
a crown is darker inside and a branch casts a soft shadow where it meets another, without ray tracing. It is
kept per vertex; the sun's shadow is looked up per pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Layer",
    "Light",
    "Rays",
    "cast_rays",
    "gather_sky",
    "ground_sky",
    "light_layer",
    "make_light",
    "sun_share",
    "to_linear",
    "to_srgb",
]

SUN_COLOR = np.array([1.62, 1.52, 1.36])
SKY_COLOR = np.array([0.92, 1.00, 1.10])
BOUNCE_COLOR = np.array([0.34, 0.32, 0.29])  # the sky, given back by the ground
FILL_COLOR = np.array([0.22, 0.23, 0.25])  # from the camera, without shadow
SUN_ASIDE = np.radians(-52.0)  # of the camera
SUN_ELEVATION = np.radians(52.0)
N_SKY = 40
SKY_MAP = 320  # texels a side
SUN_MAP = 1536
MAP_MARGIN = 1.02
BIAS_TEXELS = 1.5
GROUND_GRID = 192
GROUND_BLUR = 6  # passes of a 1-2-1 filter
POINT_COSINE = 0.6  # of the sun, on points, which have no side
LEAF_SCATTER = 0.35  # part of the sun that a leafy or pointwise surface shows on its far side
LEAF_THROUGH = 0.55  # part of the light on a thin leaf that comes out on its other side
LEAF_TINT = np.array([1.0, 1.0, 0.55])  # of that light, which has passed through green
STORED_MAX = 1.5  # brightest light that the 8-bit square-root code holds


@dataclass(frozen=True, eq=False)
class Layer:
    """What is drawn as one: triangles, or points if there are no faces.

    Attributes
    ----------
    vertices : (v, 3) float64
        Metres.
    faces : (f, 3) int32 or None
        None for points.
    normals : (v, 3) float64
        Unit normals; zeros for points.
    albedo : (v, 3) float64
        Linear reflectance, 0 to 1.
    alpha : float
        Opacity, 0 to 1.
    scatter : float
        Part of the light that reaches the far side.
    point_radius : float
        Metres; of points.
    uv : (v, 2) float32 or None
        Texture coordinates; with an image only.
    image : (h, w, 4) uint8 or None
        What the albedo is multiplied with, as square roots of linear colour, and alpha: the surface is there
        where it is at least one half. The first row is at v = 1.
    clamp : bool
        Whether the image's edge goes on beyond it; else it repeats.
    both_sides : bool
        Whether the back is drawn too, and lit as the thin leaf that it is; with an image only.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32] | None
    normals: NDArray[np.float64]
    albedo: NDArray[np.float64]
    alpha: float = 1.0
    scatter: float = 0.0
    point_radius: float = 0.0
    uv: NDArray[np.float32] | None = None
    image: NDArray[np.uint8] | None = None
    clamp: bool = False
    both_sides: bool = False


@dataclass(frozen=True, eq=False)
class Rays:
    """Shadow maps of parallel light from one or more directions.

    Attributes
    ----------
    direction : (m, 3) float64
        Unit vectors towards the light.
    axes : (m, 3, 3) float64
        Right, up and forward of each map.
    shadow : (m, s, s) float32
        Keys (minus the distance along the ray) of what is nearest to the light.
    centre : (3,) float64
        The middle of all maps, metres.
    focal : float
        Texels per metre.
    """

    direction: NDArray[np.float64]
    axes: NDArray[np.float64]
    shadow: NDArray[np.float32]
    centre: NDArray[np.float64]
    focal: float

    @property
    def bias(self) -> float:
        """How much nearer to the light than a point its shadow must be, metres."""
        return BIAS_TEXELS / self.focal


@dataclass(frozen=True, eq=False)
class Light:
    """Sun and sky of one picture."""

    sun: Rays
    sky: Rays
    to_camera: NDArray[np.float64]
    eye: NDArray[np.float64] | None = None


def make_light(
    layers: Sequence[Layer],
    sky: Rays | None,
    camera_axes: NDArray[np.float64],
    eye: NDArray[np.float64] | None = None,
) -> Light:
    """Light from over the viewer's shoulder; the sky's maps can be kept from an earlier picture."""
    to_camera = -camera_axes[2]
    azimuth = np.arctan2(to_camera[1], to_camera[0]) + SUN_ASIDE
    ce = np.cos(SUN_ELEVATION)
    sun = np.array([[ce * np.cos(azimuth), ce * np.sin(azimuth), np.sin(SUN_ELEVATION)]])
    if sky is None:
        sky = cast_rays(layers, sky_directions(N_SKY), SKY_MAP)
    return Light(cast_rays(layers, sun, SUN_MAP), sky, to_camera, eye)


def sky_directions(n: int) -> NDArray[np.float64]:
    """Directions spread evenly over the upper hemisphere (a Fibonacci spiral)."""
    k = np.arange(n) + 0.5
    z = k / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z * z)
    return np.column_stack([flat * np.cos(angle), flat * np.sin(angle), z])


def cast_rays(layers: Sequence[Layer], direction: NDArray[np.float64], size: int) -> Rays:
    """Draw the shadow maps of everything in the layers.

    Parameters
    ----------
    layers : sequence of Layer
        With at least one vertex in all.
    direction : (m, 3) float64
        Unit vectors towards the light.
    size : int
        Texels along a map's side.
    """
    from render import _raster_kernels as kernels

    low = np.min([layer.vertices.min(axis=0) for layer in layers], axis=0)
    high = np.max([layer.vertices.max(axis=0) for layer in layers], axis=0)
    centre = 0.5 * (low + high)
    radius = max(max(np.linalg.norm(layer.vertices - centre, axis=1).max() for layer in layers), 1e-3)
    focal = 0.5 * size / (MAP_MARGIN * radius)
    axes = np.stack([_axes_against(d) for d in direction])
    shadow = np.full((len(direction), size, size), kernels.NOTHING, np.float32)
    nobody = np.empty((0, 0), np.int32)

    def draw(m: int) -> None:
        for layer in layers:
            screen = np.empty((len(layer.vertices), 3))
            kernels.project(layer.vertices, axes[m], centre, focal, kernels.PARALLEL, size, size, screen)
            if layer.faces is None:
                kernels.draw_points(screen, layer.point_radius * focal, False, shadow[m], nobody)
            elif layer.image is None:
                kernels.draw_triangles(screen, layer.faces, shadow[m], nobody)
            else:
                kernels.draw_textured(
                    screen, layer.faces, layer.uv, layer.image, kernels.PARALLEL, layer.clamp,
                    layer.both_sides, shadow[m], nobody,
                )  # fmt: skip

    with ThreadPoolExecutor(max_workers=min(4, len(direction))) as pool:
        list(pool.map(draw, range(len(direction))))
    return Rays(direction, axes, shadow, centre, focal)


def light_layer(layer: Layer, light: Light) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Light given back by each vertex: from everywhere but the sun, and from an unshadowed sun.

    Returns
    -------
    ambient, direct : (v, 3) uint8
        Square roots of linear colour, scaled so that 255 is `STORED_MAX`.
    """
    if layer.both_sides:
        return _light_leaves(layer, light)
    normals = layer.normals
    sky = gather_sky(layer.vertices, normals, light.sky)[:, None]
    s = layer.scatter
    cosine = ((normals @ light.sun.direction[0] + s) / (1.0 + s)).clip(0.0)[:, None]
    up = (0.5 + 0.5 * normals[:, 2])[:, None]
    front = (normals @ light.to_camera).clip(0.0)[:, None]
    if layer.faces is None:  # points face everywhere
        cosine, front = np.full_like(cosine, POINT_COSINE), np.full_like(front, 0.5)
    openness = np.minimum(1.0, 0.25 + 1.5 * sky)  # what the sky does not reach, its reflection hardly does
    ambient = SKY_COLOR * sky + openness * (BOUNCE_COLOR * (1.0 - up) + FILL_COLOR * front)
    return _encode(layer.albedo * ambient), _encode(layer.albedo * SUN_COLOR * cosine)


def _light_leaves(layer: Layer, light: Light) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """As :func:`light_layer`, for thin surfaces: the side that is seen, and light that comes through."""
    to_eye = light.to_camera if light.eye is None else light.eye - layer.vertices
    away = (layer.normals * to_eye).sum(axis=1) < 0.0
    normals = np.where(away[:, None], -layer.normals, layer.normals)
    sky = gather_sky(layer.vertices, normals, light.sky, through=LEAF_THROUGH)[:, None]
    cosine = (normals @ light.sun.direction[0])[:, None]
    sun = cosine.clip(0.0) + LEAF_THROUGH * LEAF_TINT * (-cosine).clip(0.0)
    up = (0.5 + 0.5 * normals[:, 2])[:, None]
    front = np.abs(normals @ light.to_camera)[:, None]
    openness = np.minimum(1.0, 0.25 + 1.5 * sky)
    ambient = SKY_COLOR * sky + openness * (BOUNCE_COLOR * (1.0 - up) + FILL_COLOR * front)
    return _encode(layer.albedo * ambient), _encode(layer.albedo * SUN_COLOR * sun)


def ground_sky(sky: Rays, centre: NDArray[np.float64], ground_z: float, rim: float) -> NDArray[np.float64]:
    """Part of the open sky's light that reaches the ground around the tree.

    Returns
    -------
    shade : (k, k) float64
        0 to 1 on a grid over the square of half width `rim` around `centre`; rows along y.
    """
    side = ((np.arange(GROUND_GRID) + 0.5) / GROUND_GRID * 2.0 - 1.0) * rim
    x, y = np.meshgrid(centre[0] + side, centre[1] + side)
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, ground_z)])
    shade = gather_sky(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), sky).reshape(x.shape)
    for _ in range(GROUND_BLUR):  # takes away the pattern of the single directions, not the shadow
        for axis in (0, 1):
            shade = 0.5 * shade + 0.25 * (_shifted(shade, 1, axis) + _shifted(shade, -1, axis))
    return shade


def sun_share(light: Light) -> float:
    """Part of the light on open level ground that comes from the sun."""
    sun = SUN_COLOR.mean() * light.sun.direction[0, 2]
    return float(sun / (sun + SKY_COLOR.mean()))


def to_linear(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linear colour of sRGB values, both 0 to 1 (IEC 61966-2-1)."""
    srgb = np.asarray(srgb, np.float64)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """sRGB values of linear colour, both 0 to 1; what is outside is clipped."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def gather_sky(
    points: NDArray[np.float64], normals: NDArray[np.float64], rays: Rays, *, through: float = 0.0
) -> NDArray[np.float64]:
    """Part of an open sky's light on a level surface that reaches each point.

    With `through`, that part of the light on the far side comes through.
    """
    from render import _raster_kernels as kernels

    weight = np.full(len(rays.direction), 1.0)
    weight /= (weight * rays.direction[:, 2]).sum()
    out = np.empty(len(points))
    halves = np.array_split(np.arange(len(points)), min(4, max(len(points) // 20000, 1)))

    def part(rows: NDArray[np.int64]) -> None:
        chosen = slice(rows[0], rows[-1] + 1)
        maps = (rays.shadow, rays.axes, rays.direction, weight, rays.centre, rays.focal, rays.bias, rays.bias)
        if through > 0.0:
            kernels.gather_sky_through(points[chosen], normals[chosen], through, *maps, out[chosen])
        else:
            kernels.gather_sky(points[chosen], normals[chosen], *maps, out[chosen])

    if len(points):
        with ThreadPoolExecutor(max_workers=len(halves)) as pool:
            list(pool.map(part, halves))
    return out


def _shifted(grid: NDArray[np.float64], step: int, axis: int) -> NDArray[np.float64]:
    """The grid moved by one cell, its edge repeated."""
    return np.take(grid, np.clip(np.arange(grid.shape[axis]) + step, 0, grid.shape[axis] - 1), axis=axis)


def _axes_against(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Axes of a map that looks along the light, away from `direction`."""
    helper = np.array([1.0, 0.0, 0.0]) if abs(direction[2]) > 0.9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(helper, direction)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), -direction])


def _encode(linear: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(255.0 * np.sqrt(np.clip(linear / STORED_MAX, 0.0, 1.0))).astype(np.uint8)
