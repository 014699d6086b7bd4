"""The renderer that is always there: rasterisation on the processor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.camera import Camera
from render.lighting import Layer

__all__ = ["LitLayer", "SoftwareRenderer", "Seen"]


@dataclass(frozen=True, eq=False)
class LitLayer:
    """A layer and the light that its vertices give back (see :func:`render.lighting.light_layer`)."""

    layer: Layer
    ambient: NDArray[np.uint8]
    direct: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Seen:
    """What a camera sees of one layer.

    Attributes
    ----------
    key : (h, w) float32
        1 / depth, 1 / metres; ``_raster_kernels.NOTHING`` where there is nothing.
    ambient, direct : (h, w, 3) uint8
        The vertices' light, interpolated.
    """

    key: NDArray[np.float32]
    ambient: NDArray[np.uint8]
    direct: NDArray[np.uint8]


class SoftwareRenderer:
    """Draws layers without OpenGL; the same on every machine."""

    name = "software"

    def draw(self, camera: Camera, width: int, height: int, layers: Sequence[LitLayer]) -> list[Seen]:
        """What the camera sees of each layer on its own."""
        return [self._draw_layer(camera, width, height, lit) for lit in layers]

    def close(self) -> None:
        """Nothing is held."""

    def _draw_layer(self, camera: Camera, width: int, height: int, lit: LitLayer) -> Seen:
        from render import _raster_kernels as kernels

        layer = lit.layer
        focal = camera.focal(height)
        screen = np.empty((len(layer.vertices), 3))
        view = (camera.axes, camera.eye, focal, kernels.PERSPECTIVE, width, height)
        kernels.project(layer.vertices, *view, screen)
        key = np.full((height, width), kernels.NOTHING, np.float32)
        owner = np.full((height, width), -1, np.int32)
        ambient, direct = np.zeros((height, width, 3), np.uint8), np.zeros((height, width, 3), np.uint8)
        if layer.faces is None:
            kernels.draw_points(screen, layer.point_radius * focal, True, key, owner)
            kernels.resolve_points(owner, lit.ambient, lit.direct, ambient, direct)
        elif layer.image is not None:
            image = (layer.uv, layer.image)
            kernels.draw_textured(
                screen, layer.faces, *image, kernels.PERSPECTIVE, layer.clamp, layer.both_sides, key, owner
            )
            kernels.resolve_textured(
                screen, layer.faces, owner, kernels.PERSPECTIVE, lit.ambient, lit.direct, *image, layer.clamp,
                ambient, direct,
            )  # fmt: skip
        else:
            kernels.draw_triangles(screen, layer.faces, key, owner)
            kernels.resolve_triangles(
                screen, layer.faces, owner, kernels.PERSPECTIVE, lit.ambient, lit.direct, ambient, direct
            )
        return Seen(key, ambient, direct)
