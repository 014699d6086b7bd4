"""From layers and a camera to pixels."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from render.camera import Camera
from render.lighting import (
    STORED_MAX,
    Layer,
    Light,
    Rays,
    ground_sky,
    light_layer,
    make_light,
    sun_share,
    to_linear,
    to_srgb,
)
from render.software import LitLayer, Seen

__all__ = ["Renderer", "Stage", "draw_picture"]


class Renderer(Protocol):
    """What finds out which part of a layer a camera sees: :mod:`render.software` or :mod:`render.gl`."""

    def draw(self, camera: Camera, width: int, height: int, layers: Sequence[LitLayer]) -> list[Seen]:
        """What the camera sees of each layer on its own."""


SAMPLES = 2  # per pixel along each side
BANDS = 4  # of rows that are shaded side by side
BACKDROP = np.array([[0.86, 0.87, 0.88], [0.955, 0.96, 0.965]])  # sRGB at the bottom and the top
GROUND = np.array([0.83, 0.825, 0.81])  # sRGB, in full light


@dataclass(frozen=True, eq=False)
class Stage:
    """Where a tree stands in a picture.

    Attributes
    ----------
    centre : (2,) float64
        Middle of the ground disc, metres.
    ground_z : float
        Height of the ground, metres.
    disc, rim : float
        Radii between which the ground fades into the backdrop, metres.
    """

    centre: NDArray[np.float64]
    ground_z: float
    disc: float
    rim: float


def draw_picture(
    renderer: Renderer,
    layers: Sequence[Layer],
    camera: Camera,
    stage: Stage,
    size: tuple[int, int],
    sky: Rays | None = None,
) -> tuple[NDArray[np.uint8], Rays]:
    """Draw layers on a stage.

    Parameters
    ----------
    renderer : Renderer
    layers : sequence of Layer
        Opaque ones first; a later one is blended over those before it.
    camera : Camera
    stage : Stage
    size : (int, int)
        Width and height of the image, pixels.
    sky : Rays, optional
        Sky maps of an earlier picture of the same layers.

    Returns
    -------
    image : (h, w, 3) uint8
        sRGB.
    sky : Rays
        For the next picture.
    """
    width, height = size
    light = make_light(layers, sky, camera.axes, camera.eye)
    lit = [LitLayer(layer, *light_layer(layer, light)) for layer in layers]
    seen = renderer.draw(camera, SAMPLES * width, SAMPLES * height, lit)
    shade = ground_sky(light.sky, stage.centre, stage.ground_z, stage.rim)
    out = np.empty((height, width, 3))
    rows = np.array_split(np.arange(height), min(BANDS, height))

    def band(chosen: NDArray[np.int64]) -> None:
        out[chosen[0] : chosen[-1] + 1] = _shade_rows(chosen, layers, seen, camera, stage, light, shade, size)

    with ThreadPoolExecutor(max_workers=BANDS) as pool:
        list(pool.map(band, rows))
    return np.rint(255.0 * to_srgb(out)).astype(np.uint8), light.sky


def _shade_rows(
    rows: NDArray[np.int64],
    layers: Sequence[Layer],
    seen: Sequence[Seen],
    camera: Camera,
    stage: Stage,
    light: Light,
    shade: NDArray[np.float64],
    size: tuple[int, int],
) -> NDArray[np.float64]:
    """Linear colour of some rows of the image."""
    from render import _raster_kernels as kernels

    width, height = SAMPLES * size[0], SAMPLES * size[1]
    first = SAMPLES * int(rows[0])
    focal = camera.focal(height)
    fine = np.empty((SAMPLES * len(rows), width, 4), np.float32)
    sun = light.sun
    kernels.fill_background(height, first, to_linear(BACKDROP), fine)
    kernels.draw_ground(
        camera.axes, camera.eye, focal, height, first, stage.ground_z, stage.centre, stage.disc, stage.rim,
        to_linear(GROUND), shade, sun_share(light),
        sun.shadow[0], sun.axes[0], sun.centre, sun.focal, sun.bias, fine,
    )  # fmt: skip
    for layer, view in zip(layers, seen, strict=True):
        kernels.shade_layer(
            view.key, view.ambient, view.direct, STORED_MAX, layer.alpha, camera.axes, camera.eye, focal,
            sun.shadow[0], sun.axes[0], sun.centre, sun.focal, 2.0 * sun.bias, first, fine,
        )  # fmt: skip
    out = np.empty((len(rows), size[0], 3))
    kernels.average_blocks(fine, SAMPLES, out)
    return out
