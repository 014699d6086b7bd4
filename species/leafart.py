"""Draws leaves from a few numbers: outline, veins, colours of the seasons, as a texture with its normal map.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 6.1.5 (each leaf is a textured quad that can be refined to a curved surface).
Departs from it in: the textures are not photographs, they are drawn; where the quad lies in the leaf's own
frame comes with the texture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from species._art_blades import Layout, lay_out, stroke_outline
from species._art_fields import as_unit, check_rng, check_size
from species._art_paint import LIGHT, SLOPE_X, SLOPE_Y, STALK, TONE, VEIN, Frame, paint
from species._art_pixels import (
    balance_alpha,
    bleed,
    coverage,
    encode_normals,
    encode_png,
    encode_webp,
    periodic_noise,
)
from species._art_shape import DIVIDED, KINDS, MARGINS, SEASONS, LeafColors, LeafShape
from treegraph.errors import InputError

__all__ = [
    "DIVIDED",
    "KINDS",
    "MARGINS",
    "SEASONS",
    "LeafColors",
    "LeafShape",
    "LeafTexture",
    "draw_leaf",
    "encode_png",
    "encode_webp",
    "leaf_area",
    "leaf_frame",
    "outline",
    "stalk_outline",
]

Array = NDArray[np.float64]

OUTLINE_POINTS = 64
MARGIN_PX = 2.0  # transparent border around the leaf
LEAST_STALK_PX = 1.3  # thinner stalks would break up
LEAST_SIDE_PX = 16
MOST_STRETCH = 8  # the longer side of a texture over the shorter one
WOOD = np.array([0.44, 0.35, 0.24])  # what stalks tend to
PALE = np.array([0.86, 0.88, 0.66])  # what veins tend to
GLAUCOUS = np.array([0.74, 0.78, 0.70])  # what lower sides tend to
BROWN = np.array([0.80, 0.66, 0.52])  # factor of the colour at margins and tip that age


@dataclass(frozen=True, eq=False)
class LeafTexture:
    """A leaf as a texture.

    Attributes
    ----------
    rgba : (h, w, 4) uint8
        sRGB with straight alpha; row 0 is the tip's end. The colours go on where alpha is 0.
    normal : (h, w, 3) uint8
        Tangent-space normals: red to the right, green to the tip, blue out of the drawn side.
    area_share : float
        Share of the texture whose alpha is at least one half.
    aspect : float
        Width over height in metres; the pixels need not be square.
    box : (4,) float64
        Left, bottom, right and top of the texture in the leaf's frame, metres: the petiole begins at (0, 0)
        and +y leads to the tip.
    """

    rgba: NDArray[np.uint8]
    normal: NDArray[np.uint8]
    area_share: float
    aspect: float
    box: Array


def outline(shape: LeafShape, n: int = OUTLINE_POINTS) -> list[Array]:
    """Outlines of a leaf's blades, leaflets or needles.

    Parameters
    ----------
    shape : LeafShape
    n : int, default 64
        About so many points along each side of a blade, 8 or more; lobes and teeth get points of their own.

    Returns
    -------
    outline : list of (m, 2) float64
        Metres, in the leaf's frame: the petiole begins at (0, 0), +y leads to the tip. Needles and leaflets
        that overlap in the picture are all there.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 8:
        raise InputError(f"n must be a whole number of 8 or more points, got {n!r}")
    return lay_out(shape, int(n)).outline


def stalk_outline(shape: LeafShape) -> list[Array]:
    """Outlines (4, 2) of a leaf's petiole, rachis and the stalks of its leaflets, metres."""
    return stroke_outline(lay_out(shape, 8).stroke)


def leaf_area(shape: LeafShape) -> float:
    """Area of one side of all blades, m2, without stalks: what the outlines enclose."""
    total = 0.0
    for polygon in outline(shape):
        following = np.roll(polygon, -1, axis=0)
        total += 0.5 * abs(float(np.sum(polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1])))
    return total


def leaf_frame(shape: LeafShape, size_px: int = 256) -> tuple[float, float, float, float]:
    """Left, bottom, right and top of a leaf's texture in its own frame, metres, as in `LeafTexture.box`."""
    frame = _frame_of(lay_out(shape, OUTLINE_POINTS), check_size(size_px))
    return frame.left, frame.bottom, frame.right, frame.top


def draw_leaf(
    shape: LeafShape,
    colors: LeafColors,
    size_px: int = 256,
    *,
    rng: np.random.Generator,
    season: str = "summer",
    back: bool = False,
) -> LeafTexture:
    """Draw a leaf.

    Parameters
    ----------
    shape : LeafShape
    colors : LeafColors
    size_px : int, default 256
        Longer side of the texture: a power of two from 32 to 2048. The shorter one is a power of two as well.
    rng : numpy.random.Generator
        For the small differences in colour. Outline, alpha and normals depend on the shape alone.
    season : str, default "summer"
        "spring", "summer", "autumn" or "winter".
    back : bool, default False
        The lower side, for the same texture coordinates: paler, with veins that stand out.

    Returns
    -------
    texture : LeafTexture

    Raises
    ------
    InputError
        If size or season is none, or there are no leaves in that season.
    """
    size = check_size(size_px)
    color = colors.of_season(season)
    if color is None:
        raise InputError(f"there are no leaves in {season}: colors.{season} is left out")
    check_rng(rng)
    layout = lay_out(shape, OUTLINE_POINTS)
    frame = _frame_of(layout, size)
    stalks = stroke_outline(layout.stroke, LEAST_STALK_PX * max(frame.pixel))
    pixels = [frame.to_pixels(polygon) for polygon in [*layout.outline, *stalks]]
    alpha = np.rint(255.0 * balance_alpha(coverage(pixels, (frame.height, frame.width))))
    tint = 1.0 + 0.12 * colors.variation * rng.standard_normal(len(layout.length))
    channel = paint(shape, layout, frame, np.clip(tint, 0.75, 1.25), back)
    known = alpha >= 128.0
    if known.any():
        channel[:, :, SLOPE_X:] = bleed(channel[:, :, SLOPE_X:], known)
    rgb = _colors_of(channel, colors, season, back, rng)
    if known.any():
        rgb = bleed(rgb, known)
    rgba = np.concatenate([np.rint(255.0 * np.clip(rgb, 0.0, 1.0)), alpha[:, :, None]], axis=2)
    return LeafTexture(
        rgba.astype(np.uint8),
        encode_normals(channel[:, :, SLOPE_X], channel[:, :, SLOPE_Y]),
        float(known.mean()),
        (frame.right - frame.left) / (frame.top - frame.bottom),
        np.array([frame.left, frame.bottom, frame.right, frame.top]),
    )


def _frame_of(layout: Layout, size: int) -> Frame:
    """The picture around a leaf, with a transparent border."""
    points = np.concatenate([*layout.outline, *stroke_outline(layout.stroke)])
    low, high = points.min(axis=0), points.max(axis=0)
    extent = np.maximum(high - low, 1e-4 * (high - low).max())
    stretch = min(float(extent.max() / extent.min()), float(MOST_STRETCH))
    short = max(size // 2 ** int(np.log2(stretch)), LEAST_SIDE_PX)
    width, height = (size, short) if extent[0] > extent[1] else (short, size)
    inner = np.array([width, height]) - 2.0 * MARGIN_PX
    pixel = extent / inner
    # a border that is as wide as the thinnest stalk is drawn, wherever pixels are much longer than wide
    border = np.maximum(MARGIN_PX * pixel, 0.5 * LEAST_STALK_PX * pixel.max() + pixel)
    low, high = low - border, high + border
    return Frame(float(low[0]), float(low[1]), float(high[0]), float(high[1]), width, height)


def _colors_of(
    channel: Array, colors: LeafColors, season: str, back: bool, rng: np.random.Generator
) -> Array:
    """sRGB (h, w, 3) from 0 to 1 of the painted channels."""
    leaf = as_unit(getattr(colors, season))
    if back:
        leaf = as_unit(colors.back) if colors.back and season == "summer" else 0.6 * leaf + 0.4 * GLAUCOUS
    vein = as_unit(colors.vein) if colors.vein else 0.58 * leaf + 0.42 * PALE
    stalk = as_unit(colors.stalk) if colors.stalk else 0.5 * leaf + 0.5 * WOOD
    size = channel.shape[:2]
    broad = periodic_noise(rng, size, 0.08, 0.08)
    fine = periodic_noise(rng, size, 0.008, 0.008)
    patch = np.clip(0.5 + 0.25 * broad, 0.0, 1.0)
    age = 0.9 if season == "autumn" else 0.25
    aged = np.clip(age * channel[:, :, TONE] * (0.4 + 1.2 * patch), 0.0, 1.0)[:, :, None]
    rgb = leaf * (1.0 - aged + aged * BROWN)
    rgb = rgb * (1.0 + colors.variation * np.array([0.10, 0.02, -0.06]) * broad[:, :, None])
    share = 0.8 * channel[:, :, VEIN : VEIN + 1]
    rgb = rgb + share * (vein - rgb)
    rgb = rgb + channel[:, :, STALK : STALK + 1] * (stalk - rgb)
    light = channel[:, :, LIGHT] * (1.0 + colors.variation * (0.05 * fine + 0.06 * broad))
    return np.clip(rgb * light[:, :, None], 0.0, 1.0)
