"""Draws bark from a few numbers, as a texture that continues over its own borders, with its normal map.

The texture wraps around a stem: u across it and around the stem, v up it and along the stem. Opposite
borders continue each other, so that it can be repeated any whole number of times around and along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from species._art_fields import (
    Color,
    as_unit,
    check_fields,
    check_rng,
    check_size,
    choice,
    number,
    srgb,
    whole,
)
from species._art_pixels import encode_normals, encode_png, encode_webp, periodic_noise, smoothstep

__all__ = ["BARKS", "BarkShape", "BarkTexture", "draw_bark", "encode_png", "encode_webp"]

Array = NDArray[np.float64]

BARKS = ("ridged", "diamond", "plates", "lenticels", "smooth", "patched", "rings")

STEEPEST = 2.5  # slope at which normals stop to tilt further: furrows have no overhangs
GRAIN = 0.035  # height of the finest grain, in depths, at roughness 1


@dataclass(frozen=True)
class BarkShape:
    """Bark from a few numbers. ``docs/leaves.md`` has a table of them.

    ``ridged`` has long interlaced ridges (oak, willow), ``diamond`` furrows that cross (ash), ``plates``
    islands between cracks (pine; small and round: spruce), ``lenticels`` short lines across smooth bark
    (birch, cherry), ``smooth`` hardly anything (beech), ``patched`` peels in flakes of several tones (plane,
    crape myrtle), ``rings`` leaf scars around the stem (palm).

    Raises
    ------
    InputError
        If a number is out of its range; the message has the field, its range and the value.

    Examples
    --------
    >>> BarkShape("plates", count=6).tile
    0.3
    >>> BarkShape("plates", count=0)
    Traceback (most recent call last):
        ...
    treegraph.errors.InputError: count must be a whole number from 1 to 40, got 0
    """

    kind: str = choice(BARKS, "how the surface is built")
    tile: float = number(0.02, 5, "metres", "width and height of stem that the texture covers", 0.3)
    count: int = whole(1, 40, "ridges, plates or patches across the texture; rings along it", 6)
    stretch: float = number(
        0.2, 12, "", "how much longer along the stem than across ridges and plates are", 3.0
    )
    weave: float = number(0, 1, "", "0 regular and straight, 1 interlaced and irregular", 0.6)
    depth: float = number(0, 0.1, "metres", "from the ridges to the furrows", 0.008)
    crack: float = number(0, 1, "", "width of furrows and cracks", 0.4)
    roughness: float = number(0, 1, "", "fine grain of the surface", 0.5)
    marks: float = number(0, 1, "", "how many lenticels, scars or lichens", 0.0)
    color: Color = srgb("of ridges, plates, the smooth surface", (112, 98, 82))
    deep: Color = srgb("of furrows, cracks, what lies under flakes", (52, 42, 34))
    mark: Color = srgb("of lenticels, scars, lichens", (70, 62, 54))
    variation: float = number(0, 1, "", "how much colours differ from place to place", 0.4)

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, eq=False)
class BarkTexture:
    """Bark as a texture without seams.

    Attributes
    ----------
    rgba : (h, w, 4) uint8
        sRGB, opaque; columns go around the stem, row 0 is up.
    normal : (h, w, 3) uint8
        Tangent-space normals: red to the right, green up the stem, blue outwards.
    tile : float
        Width and height that it covers, metres.
    """

    rgba: NDArray[np.uint8]
    normal: NDArray[np.uint8]
    tile: float


@dataclass(frozen=True, eq=False)
class _Surface:
    """Height from 0 (furrow) to 1, share of the marks' colour, and a tone around 0, all (h, w)."""

    height: Array
    mark: Array
    tone: Array


def draw_bark(shape: BarkShape, size_px: int = 256, *, rng: np.random.Generator) -> BarkTexture:
    """Draw bark.

    Parameters
    ----------
    shape : BarkShape
    size_px : int, default 256
        Width and height of the texture: a power of two from 32 to 2048.
    rng : numpy.random.Generator
        Where ridges, plates and marks are.

    Returns
    -------
    texture : BarkTexture

    Raises
    ------
    InputError
        If size_px is none.
    """
    size = check_size(size_px)
    check_rng(rng)
    draw = {
        "ridged": _draw_ridges,
        "diamond": _draw_diamonds,
        "plates": _draw_plates,
        "lenticels": _draw_lenticels,
        "smooth": _draw_smooth,
        "patched": _draw_patches,
        "rings": _draw_rings,
    }[shape.kind]
    surface = draw(shape, size, rng)
    fine = periodic_noise(rng, (size, size), 0.006, 0.004)
    broad = periodic_noise(rng, (size, size), 0.12, 0.08)
    height = surface.height + GRAIN * shape.roughness * fine
    pixel = shape.tile / size
    return BarkTexture(
        _colors_of(shape, surface, fine, broad),
        encode_normals(*_slopes(shape.depth * height, pixel)),
        shape.tile,
    )


def _slopes(height: Array, pixel: float) -> tuple[Array, Array]:
    """Slopes to the right and up of a height (metres) that continues over its borders."""
    right = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) / (2.0 * pixel)
    up = (np.roll(height, 1, axis=0) - np.roll(height, -1, axis=0)) / (2.0 * pixel)
    return STEEPEST * np.tanh(right / STEEPEST), STEEPEST * np.tanh(up / STEEPEST)


def _colors_of(shape: BarkShape, surface: _Surface, fine: Array, broad: Array) -> NDArray[np.uint8]:
    """sRGB and alpha (h, w, 4) of a surface."""
    rise = np.clip(surface.height, 0.0, 1.0)[:, :, None]
    top, deep, mark = as_unit(shape.color), as_unit(shape.deep), as_unit(shape.mark)
    rgb = deep + rise * (top - deep)
    rgb = rgb + surface.mark[:, :, None] * (mark - rgb)
    light = shape.variation * (0.05 * broad + 0.16 * surface.tone) + 0.09 * shape.roughness * fine
    warmth = shape.variation * np.array([0.05, 0.0, -0.05]) * (surface.tone + 0.4 * broad)[:, :, None]
    rgb = np.clip(rgb * (1.0 + light[:, :, None] + warmth), 0.0, 1.0)
    return np.concatenate(
        [np.rint(255.0 * rgb).astype(np.uint8), np.full((*rise.shape[:2], 1), 255, np.uint8)], axis=2
    )


def _grid(size: int) -> tuple[Array, Array]:
    """u (1, w) to the right and v (h, 1) upwards, 0 to 1."""
    middle = (np.arange(size) + 0.5) / size
    return middle[None, :], middle[::-1, None]


def _edge(crack: float, value: Array) -> Array:
    """0 in a furrow where ``value`` is 0, 1 beyond its side."""
    return smoothstep(0.12 * crack, 0.12 * crack + 0.25 + 0.5 * crack, value)


def _draw_ridges(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Ridges along the stem that part and meet: furrows follow the zeros of stretched noise."""
    u, v = _grid(size)
    width = 1.0 / shape.count
    square = (size, size)
    sway = periodic_noise(rng, square, 0.12 * shape.stretch * width + 0.05, 0.5 * width)
    straight = np.abs(np.sin(np.pi * (shape.count * u + 0.28 * shape.weave * sway)))
    woven = np.abs(periodic_noise(rng, square, 0.3 * shape.stretch * width, 0.3 * width))
    value = (1.0 - shape.weave) * straight + shape.weave * np.minimum(woven, 1.2)
    tone = periodic_noise(rng, square, 0.15 * shape.stretch * width, 0.12 * width)
    across = np.abs(periodic_noise(rng, square, 0.10 * width, 0.45 * width))
    broken = 0.3 * shape.weave * (1.0 - smoothstep(0.0, 0.25, across)) * smoothstep(0.2, 1.2, tone)
    height = _edge(shape.crack, value)
    fibre = periodic_noise(rng, square, 0.05 * shape.stretch * width, 0.04 * width)
    height = height * (1.0 - broken) * (0.86 + 0.14 * np.minimum(value, 1.0)) + 0.07 * shape.roughness * fibre
    return _Surface(height, _lichen(shape, rng, size) * height.clip(0.0, 1.0), tone)


def _draw_diamonds(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Furrows that cross and leave diamonds."""
    u, v = _grid(size)
    width = 1.0 / shape.count
    rows = max(1, round(shape.count / shape.stretch))
    square = (size, size)
    sway = [periodic_noise(rng, square, 0.4 * shape.stretch * width, 0.5 * width) for _ in range(2)]
    one = np.abs(np.sin(np.pi * (shape.count * u + rows * v + 0.2 * shape.weave * sway[0])))
    other = np.abs(np.sin(np.pi * (shape.count * u - rows * v + 0.2 * shape.weave * sway[1])))
    value = np.minimum(one, other)
    fibre = periodic_noise(rng, square, 0.06 * shape.stretch * width, 0.05 * width)
    tone = periodic_noise(rng, square, 0.15 * shape.stretch * width, 0.15 * width)
    height = _edge(shape.crack, value + 0.06 * shape.weave * fibre) * (0.8 + 0.2 * value)
    height = height + 0.07 * shape.roughness * fibre
    return _Surface(height, _lichen(shape, rng, size) * height.clip(0.0, 1.0), tone)


def _draw_plates(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Islands with cracks around them, each of its own height and tone, in thin layers."""
    width = 1.0 / shape.count
    square = (size, size)
    sway = [periodic_noise(rng, square, 0.25 * width, 0.25 * width) for _ in range(2)]
    gap, cell, n_cells = _cells(shape, size, rng, 0.16 * width * shape.weave * np.array(sway))
    height = _edge(shape.crack, gap / (0.6 * width))
    level, shade = rng.random(n_cells)[cell], rng.standard_normal(n_cells)[cell]
    layer = periodic_noise(rng, square, 0.22 * width, 0.22 * width)
    steps = np.tanh(6.0 * (layer - np.rint(layer))) * 0.5 + np.rint(layer)
    height = height * (0.75 + 0.15 * level + 0.05 * steps)
    return _Surface(height, _lichen(shape, rng, size) * height, 0.7 * shade + 0.4 * steps)


def _cells(
    shape: BarkShape, size: int, rng: np.random.Generator, sway: Array
) -> tuple[Array, NDArray[np.int64], int]:
    """Voronoi cells on the torus: distance to the border between cells, cell of every pixel, their number.

    Distances are in widths of the picture, with v shortened by ``stretch``.
    """
    from scipy.spatial import cKDTree

    n_u = shape.count
    n_v = max(1, round(shape.count / shape.stretch))
    n_v += n_v % 2  # every other row is shifted by half a cell
    tall = n_v / n_u  # height of the torus, its width being 1: cells are about as tall as wide on it
    row, column = np.divmod(np.arange(n_u * n_v), n_u)
    jitter = (rng.random((2, n_u * n_v)) - 0.5) * (0.25 + 0.65 * shape.weave)
    x = (column + 0.5 * (row % 2) + 0.25 + jitter[0]) / n_u % 1.0
    y = (row + 0.5 + jitter[1]) / n_u % tall
    seed = np.stack([x, np.minimum(y, np.nextafter(tall, 0.0))], axis=1)
    u, v = _grid(size)
    at_u, at_v = (u + sway[0]) % 1.0, ((v + sway[1] * shape.stretch) % 1.0) * tall
    point = np.stack([np.broadcast_to(at_u, (size, size)), at_v], axis=2).reshape(-1, 2)
    point[:, 1] = np.minimum(point[:, 1], np.nextafter(tall, 0.0))
    distance, nearest = cKDTree(seed, boxsize=(1.0, tall)).query(point, k=min(2, len(seed)))
    if distance.ndim == 1 or distance.shape[1] == 1:
        return np.ones((size, size)), np.zeros((size, size), np.int64), 1
    gap = (distance[:, 1] - distance[:, 0]).reshape(size, size)
    return gap, nearest[:, 0].reshape(size, size), len(seed)


def _draw_lenticels(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Short dark lines across smooth bark, and with many marks rough black scars."""
    square = (size, size)
    width = 1.0 / shape.count
    line = periodic_noise(rng, square, 0.035 * width, 0.32 * width)
    limit = 1.55 - 0.6 * shape.marks + 12.0 * max(0.1 - shape.marks, 0.0)  # without marks hardly any
    thin = smoothstep(limit, limit + 0.45, line)
    ragged = periodic_noise(rng, square, 0.06 * width, 0.14 * width)
    scar = periodic_noise(rng, square, 0.22 * width, 0.42 * width) + 0.35 * ragged
    scars = smoothstep(2.3 - 1.1 * shape.marks, 2.6 - 1.1 * shape.marks, scar)
    peel = periodic_noise(rng, square, 0.012, 0.5)
    rough = scars * periodic_noise(rng, square, 0.012, 0.012)
    swell = smoothstep(limit - 0.35, limit + 0.45, line)
    height = 0.88 + 0.05 * peel * shape.roughness - 0.35 * thin + 0.12 * swell - 0.3 * scars + 0.2 * rough
    mark = np.maximum(0.85 * thin, scars * np.clip(0.92 + 0.1 * rough, 0.0, 1.0))
    return _Surface(height, mark, 0.5 * peel)


def _draw_smooth(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Hardly any relief: broad tones, faint wrinkles across, lichens."""
    square = (size, size)
    wrinkle = periodic_noise(rng, square, 0.012, 0.12)
    swell = periodic_noise(rng, square, 0.1, 0.1)
    pore = smoothstep(2.0, 2.6, periodic_noise(rng, square, 0.006, 0.012))
    folds = 1.0 - smoothstep(
        0.0, 0.5 * max(shape.crack, 0.02), np.abs(periodic_noise(rng, square, 0.02, 0.3))
    )
    height = 0.9 + 0.06 * wrinkle * shape.roughness + 0.08 * swell - 0.2 * pore - 0.10 * folds * shape.crack
    return _Surface(height, _lichen(shape, rng, size), 0.45 * swell + 0.3 * wrinkle)


def _draw_patches(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Flakes that have fallen off at different times: a few flat levels with sharp edges."""
    square = (size, size)
    width = 1.0 / shape.count
    stretch = np.sqrt(shape.stretch)
    ragged = periodic_noise(rng, square, 0.05 * width, 0.05 * width)
    level = np.zeros(square)
    for _ in range(3):
        patch = periodic_noise(rng, square, 0.3 * width * stretch, 0.3 * width / stretch)
        level = level + smoothstep(-0.04, 0.04, patch + 0.12 * shape.weave * ragged + 0.25) / 3.0
    tone = periodic_noise(rng, square, 0.2 * width, 0.2 * width)
    return _Surface(level, _lichen(shape, rng, size), 0.7 * tone)


def _draw_rings(shape: BarkShape, size: int, rng: np.random.Generator) -> _Surface:
    """Scars of fallen fronds around the stem, and fibres along it."""
    u, v = _grid(size)
    square = (size, size)
    sway = periodic_noise(rng, square, 0.3 / shape.count, 0.2)
    phase = shape.count * v + 0.5 + (0.05 + 0.15 * shape.weave) * sway
    part = phase - np.floor(phase)
    groove = smoothstep(0.0, 0.10 + 0.3 * shape.crack, part) * (1.0 - 0.5 * smoothstep(0.9, 1.0, part))
    fibre = periodic_noise(rng, square, 0.06, 0.006)
    split = smoothstep(1.6, 2.2, periodic_noise(rng, square, 0.05, 0.006))
    height = groove * (0.86 + 0.14 * part) + 0.05 * shape.roughness * fibre - 0.35 * split * shape.roughness
    return _Surface(height, _lichen(shape, rng, size), 0.4 * fibre + 0.6 * (part - 0.5))


def _lichen(shape: BarkShape, rng: np.random.Generator, size: int) -> Array:
    """Share of the marks' colour: blotches with ragged edges."""
    if shape.marks == 0.0:
        return np.zeros((size, size))
    blotch = periodic_noise(rng, (size, size), 0.035, 0.035)
    ragged = periodic_noise(rng, (size, size), 0.008, 0.008)
    limit = 2.2 - 2.0 * shape.marks
    return 0.75 * smoothstep(limit - 0.2, limit + 0.3, blotch + 0.35 * ragged)
