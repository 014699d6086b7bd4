"""What is drawn, where it stands, and from where it is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.camera import Camera
from render.gltf import check_coordinates
from render.lighting import LEAF_SCATTER, Layer, to_linear
from render.mesh import MeshSettings
from render.parts import Part, tree_parts
from render.picture import SAMPLES, Stage
from render.textures import shrink_image
from treegraph import NO_PARENT, ClusterTree, InputError, TreeGraph

__all__ = [
    "broad_side",
    "choose_panels",
    "find_outline",
    "foot_points",
    "orbit",
    "pick_points",
    "revolve",
    "scan_layer",
    "set_stage",
    "tree_layers",
]

IMAGE_HEIGHT = 1024  # pixels, where no size is given
NARROWEST, WIDEST = 0.62, 1.5  # panel width over height where no size is given
PREVIEW_MESH = MeshSettings(sides=28, steps=6)
SMALLEST = 1e-6  # metres: what is no larger than this cannot be framed
THIN_BRANCH = 0.3  # pixels: thinner branches are drawn with this radius, or they would break into dots
MAX_SCAN_POINTS = 300_000
POINT_PIXELS = (0.6, 1.8)  # radius of a scan point in a picture of 1024 pixels, many and few points
POINTS_FINE = 90_000  # points from which on they are drawn smallest
STRAY_SHARE = 0.002  # part of a scan's points that may lie outside the picture at either end of an axis
BELOW_BASE = 0.03  # of the height: branches that hang this far below the base do not push the ground down
RING_STEPS, RING_LEVELS = 24, 48  # of the solid of revolution that a turntable's camera frames
HEIGHT_RAMP = np.array(  # sRGB from the ground to the top, for scans without colours
    [[0.30, 0.25, 0.33], [0.24, 0.34, 0.46], [0.20, 0.46, 0.45], [0.34, 0.54, 0.33], [0.60, 0.60, 0.24]]
)


def pick_points(scan: Any) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Points and linear colours (or None) to draw: finite, not too many."""
    xyz, color = scan if isinstance(scan, tuple) else (scan, None)
    xyz = np.asarray(xyz, np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise InputError(f"scan must have shape (n, 3), got {xyz.shape}")
    if color is not None:
        color = np.asarray(color)
        if color.shape != xyz.shape or color.dtype != np.uint8:
            raise InputError(
                f"scan colours must be uint8 of shape {xyz.shape}, got {color.dtype} of shape {color.shape}"
            )
        if color.size == 0 or not np.ptp(color, axis=0).any():
            color = None  # one colour for all points: a field that nobody filled
    kept = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    if kept.size > MAX_SCAN_POINTS:
        kept = np.sort(np.random.default_rng(0).choice(kept, MAX_SCAN_POINTS, replace=False))
    if not kept.size:
        raise InputError("scan must have at least one finite point")
    return xyz[kept], None if color is None else to_linear(color[kept] / 255.0)


def find_outline(
    tree: ClusterTree,
    cloud: tuple[NDArray[np.float64], Any] | None,
    more: Sequence[Part] = (),
    instead: Sequence[Part] | None = None,
) -> NDArray[np.float64]:
    """Points that have to be in the picture: branches at both sides, hulls, and the scan but for strays.

    Parts that are drawn instead of branches and hulls are in the picture in the place of these.
    """
    if instead is None:
        parts = [*_surface(tree.graph), *(cluster.vertices for cluster in tree.clusters)]
    else:
        parts = [part.mesh.vertices for part in instead]
        if not sum(len(vertices) for vertices in parts):
            raise InputError("there is nothing to draw: the parts have no vertices")
    parts += [part.mesh.vertices for part in more]
    if cloud is not None:
        xyz = cloud[0]
        low, high = np.quantile(xyz, (STRAY_SHARE, 1.0 - STRAY_SHARE), axis=0)
        slack = 0.02 * (high - low)
        parts.append(xyz[((xyz >= low - slack) & (xyz <= high + slack)).all(axis=1)])
    outline = np.concatenate(parts)
    if np.ptp(outline, axis=0).max() < SMALLEST:
        raise InputError("there is nothing to draw: the tree has no size")
    return outline


def _surface(graph: TreeGraph) -> list[NDArray[np.float64]]:
    """The outermost points of a ring around every node, along each axis."""
    along = graph.position - graph.position[graph.parent]
    root = graph.parent == NO_PARENT
    along[root] = 0.0
    first = np.flatnonzero(~root)[::-1]
    along[graph.parent[first]] += np.where(root[graph.parent[first]][:, None], along[first], 0.0)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    across = np.sqrt(1.0 - (along / np.where(length > 0.0, length, 1.0)).clip(-1.0, 1.0) ** 2)
    reach = np.nan_to_num(graph.radius)[:, None] * across
    return [graph.position + sign * reach * axis for axis in np.eye(3) for sign in (-1.0, 1.0)]


def tree_layers(
    tree: ClusterTree,
    camera: Camera,
    size: tuple[int, int],
    settings: MeshSettings | None,
    more: Sequence[Part] = (),
    instead: Sequence[Part] | None = None,
) -> list[Layer]:
    """Wood, hulls and `more` as layers; branches thinner than a sample are thickened to one.

    Parts that are drawn `instead` of wood and hulls are drawn as they are.
    """
    settings = settings or PREVIEW_MESH
    depth = float((np.median(tree.graph.position, axis=0) - camera.eye) @ camera.axes[2])
    pixel = depth / camera.focal(size[1])
    settings = replace(settings, min_radius=max(THIN_BRANCH * pixel, settings.min_radius))
    own = tree_parts(tree, settings) if instead is None else instead
    layers = [_part_layer(part, pixel) for part in (*own, *more) if len(part.mesh.faces)]
    if not layers:
        raise InputError("there is nothing to draw: the tree has neither branches nor clusters")
    return layers


def _part_layer(part: Part, pixel: float) -> Layer:
    """A part as a layer; `pixel` is how large a pixel is on it, metres."""
    mesh, material = part.mesh, part.material
    textured: dict[str, Any] = {}
    if material.texture is not None:
        check_coordinates([part])
        cut = material.alpha_cutoff is not None
        image = material.texture.coded(material.alpha_cutoff)
        if not cut:  # bark
            image = shrink_image(image, int(pixel / SAMPLES / material.tile * len(image)))
        textured = {"uv": mesh.uv, "image": image, "clamp": cut, "both_sides": material.double_sided}
    albedo = np.tile(to_linear(np.array(material.color)), (len(mesh.vertices), 1))
    if mesh.color is not None:
        albedo *= to_linear(mesh.color / 255.0)
    return Layer(
        vertices=mesh.vertices,
        faces=mesh.faces,
        normals=mesh.normals.astype(np.float64),
        albedo=albedo,
        alpha=material.alpha,
        scatter=LEAF_SCATTER if material.double_sided else 0.0,
        **textured,
    )


def scan_layer(
    xyz: NDArray[np.float64], color: NDArray[np.float64] | None, camera: Camera, size: tuple[int, int]
) -> Layer:
    """The scan's points, smaller the more there are."""
    if color is None:
        low, high = np.quantile(xyz[:, 2], (STRAY_SHARE, 1.0 - STRAY_SHARE))
        place = (xyz[:, 2] - low) / max(high - low, 1e-9)
        at = np.linspace(0.0, 1.0, len(HEIGHT_RAMP))
        color = to_linear(np.column_stack([np.interp(place, at, HEIGHT_RAMP[:, c]) for c in range(3)]))
    pixels = np.clip(POINT_PIXELS[0] * np.sqrt(POINTS_FINE / len(xyz)), *POINT_PIXELS)
    depth = float((np.median(xyz, axis=0) - camera.eye) @ camera.axes[2])
    radius = float(pixels) * size[1] / IMAGE_HEIGHT * depth / camera.focal(size[1])
    return Layer(xyz, None, np.zeros_like(xyz), color, point_radius=radius)


def broad_side(outline: NDArray[np.float64]) -> float:
    """Azimuth from which the outline is widest."""
    flat = outline[:, :2] - outline[:, :2].mean(axis=0)
    _, vectors = np.linalg.eigh(flat.T @ flat)
    x, y = vectors[:, 0]  # the narrow direction is the one to look along
    if y > 0 or (y == 0 and x < 0):
        x, y = -x, -y
    return float(np.arctan2(y, x))


def _ground_z(outline: NDArray[np.float64], tree: ClusterTree) -> float:
    """Height of the ground: that of the base, unless the tree or its scan hangs well below it."""
    base = float(tree.graph.position[tree.graph.parent == NO_PARENT, 2].min())
    low, high = float(outline[:, 2].min()), float(outline[:, 2].max())
    return base if base - low <= BELOW_BASE * (high - low) else low


def set_stage(outline: NDArray[np.float64], tree: ClusterTree) -> Stage:
    low, high = outline.min(axis=0), outline.max(axis=0)
    reach = 0.5 * max(np.hypot(*(high - low)[:2]) * 0.9, 0.5 * (high - low)[2])
    return Stage(0.5 * (low + high)[:2], _ground_z(outline, tree), 0.7 * reach, 1.7 * reach)


def foot_points(outline: NDArray[np.float64], tree: ClusterTree) -> NDArray[np.float64]:
    """A few points on the ground around the base, so that the picture does not end at the trunk's foot."""
    base = tree.graph.position[np.argmax(tree.graph.parent == NO_PARENT)]
    angle = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    reach = 0.04 * np.ptp(outline, axis=0).max()
    z = np.full(8, _ground_z(outline, tree))
    return np.column_stack([base[0] + reach * np.cos(angle), base[1] + reach * np.sin(angle), z])


def choose_panels(
    size: tuple[int, int] | None, n: int, outline: NDArray[np.float64], axes: NDArray[np.float64]
) -> tuple[tuple[int, int], int]:
    """Size of each panel, and the width of the image."""
    if size is not None:
        return (size[0] // n, size[1]), size[0]
    right, up, _ = np.ptp(outline @ axes.T, axis=0)
    aspect = np.clip(1.06 * right / max(up, 1e-9), NARROWEST, WIDEST)
    width = 2 * round(0.5 * aspect * IMAGE_HEIGHT)
    return (width, IMAGE_HEIGHT), n * width


def revolve(outline: NDArray[np.float64], stage: Stage) -> NDArray[np.float64]:
    """Rings that hold the outline at every turn around the stage's middle."""
    reach = np.hypot(*(outline[:, :2] - stage.centre).T)
    edges = np.linspace(outline[:, 2].min(), outline[:, 2].max(), RING_LEVELS + 1)
    level = np.clip(np.searchsorted(edges, outline[:, 2], side="right") - 1, 0, RING_LEVELS - 1)
    widest = np.zeros(RING_LEVELS)
    np.maximum.at(widest, level, reach)
    angle = np.linspace(0.0, 2.0 * np.pi, RING_STEPS, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / RING_STEPS)
    flat = (widest[:, None, None] * ring).reshape(-1, 2) + stage.centre
    return np.concatenate(
        [np.column_stack([flat, np.repeat(z, RING_STEPS)]) for z in (edges[:-1], edges[1:])]
    )


def orbit(camera: Camera, stage: Stage, angle: float) -> Camera:
    """The camera, turned around the vertical through the stage's middle."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    middle = np.array([*stage.centre, 0.0])
    return Camera(turn @ (camera.eye - middle) + middle, camera.axes @ turn.T, camera.tan_half)
