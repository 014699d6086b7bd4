"""Paints blades and stalks into the channels from which colours and normals of a leaf are made.

Every blade is painted in a window of its own over what lies under it; there is no loop over pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from species._art_blades import PROFILE_STEPS, Layout, sickle
from species._art_shape import LeafShape

__all__ = ["LIGHT", "N_CHANNELS", "SLOPE_X", "SLOPE_Y", "STALK", "TONE", "VEIN", "Frame", "paint"]

Array = NDArray[np.float64]

LIGHT, VEIN, STALK, TONE, SLOPE_X, SLOPE_Y = range(6)
"""Brightness factor; share of the veins' and of the stalks' colour; nearness to margin and tip; slopes."""
N_CHANNELS = 6

OVERHANG_PX = (
    1.0  # blades are painted this far beyond their outline, so that its pixels have their full colour
)
VEIN_SPAN = (0.03, 0.9)  # side veins leave the midrib between these shares of the length
VEIN_CURVE = 0.45  # how much side veins turn to the tip at the margin
VEIN_WIDTH = 0.42  # of the midrib's
THINNEST_PX = 0.55  # half width under which a vein gets paler instead of thinner
LOWEST = -0.35  # how far the lobes of a heart-shaped blade may lie behind its base, of the length
CUP = 0.12  # how far the margin lies over the midrib, in half widths
BULGE = 0.03  # height of the blade between side veins, in distances between them
NO_LENGTH = 1e-9  # metres; shorter stalks are none
STEEPEST = 1.2  # slopes of the normal map tend to this: the blade has an edge, no wall
GROOVE = 0.5  # depth of a vein, in its half widths


@dataclass(frozen=True)
class Frame:
    """Where a picture lies in the leaf's frame.

    Attributes
    ----------
    left, bottom, right, top : float
        Its borders, metres.
    width, height : int
        Its size, pixels.
    """

    left: float
    bottom: float
    right: float
    top: float
    width: int
    height: int

    @property
    def pixel(self) -> tuple[float, float]:
        """Width and height of a pixel, metres."""
        return (self.right - self.left) / self.width, (self.top - self.bottom) / self.height

    def to_pixels(self, point: Array) -> Array:
        """Points (n, 2) in metres as pixel coordinates, y down."""
        px, py = self.pixel
        return np.stack([(point[:, 0] - self.left) / px, (self.top - point[:, 1]) / py], axis=1)

    def window(self, low: Array, high: Array) -> tuple[slice, slice] | None:
        """Rows and columns that a box (x, y low and high, metres) touches, with a border of two pixels."""
        px, py = self.pixel
        first = max(int((low[0] - self.left) / px) - 2, 0)
        last = min(int((high[0] - self.left) / px) + 3, self.width)
        above = max(int((self.top - high[1]) / py) - 2, 0)
        below = min(int((self.top - low[1]) / py) + 3, self.height)
        return (slice(above, below), slice(first, last)) if last - first > 1 and below - above > 1 else None

    def centres(self, window: tuple[slice, slice]) -> tuple[Array, Array]:
        """Middles of a window's pixels in metres: x (1, w), y (h, 1)."""
        px, py = self.pixel
        x = self.left + (np.arange(window[1].start, window[1].stop) + 0.5) * px
        y = self.top - (np.arange(window[0].start, window[0].stop) + 0.5) * py
        return x[None, :], y[:, None]


def paint(shape: LeafShape, layout: Layout, frame: Frame, tint: Array, back: bool) -> Array:
    """Paint a leaf.

    Parameters
    ----------
    shape : LeafShape
    layout : Layout
    frame : Frame
    tint : (k,) float64
        Brightness factor of each blade.
    back : bool
        The lower side: veins stand out and the blade hangs over.

    Returns
    -------
    channel : (height, width, N_CHANNELS) float64
    """
    channel = np.zeros((frame.height, frame.width, N_CHANNELS))
    channel[:, :, LIGHT] = 1.0
    for row in layout.stroke:
        _paint_stroke(channel, frame, row, shape.relief)
    for i in range(len(layout.length)):
        _paint_blade(channel, shape, layout, frame, i, float(tint[i] * layout.light[i]))
    slope = channel[:, :, SLOPE_X:]
    slope /= np.sqrt(1.0 + np.sum(slope**2, axis=2, keepdims=True) / STEEPEST**2)
    if back:
        slope *= -1.0
        channel[:, :, VEIN] = np.minimum(1.4 * channel[:, :, VEIN], 1.0)
    return channel


def _blend(target: Array, source: Array, share: Array) -> None:
    """Lay ``source`` over ``target`` in place."""
    target += share[:, :, None] * (source - target)


def _paint_stroke(channel: Array, frame: Frame, stroke: Array, relief: float) -> None:
    """Paint a stalk: round across, no veins."""
    start, end = stroke[0:2], stroke[2:4]
    reach = max(stroke[4], stroke[5])
    window = frame.window(np.minimum(start, end) - reach, np.maximum(start, end) + reach)
    length = float(np.hypot(*(end - start)))
    if window is None or length < NO_LENGTH:
        return
    x, y = frame.centres(window)
    axis = (end - start) / length
    along = ((x - start[0]) * axis[0] + (y - start[1]) * axis[1]) / length
    across = (x - start[0]) * axis[1] - (y - start[1]) * axis[0]
    pixel = max(frame.pixel)
    half = 0.5 * (stroke[4] + np.clip(along, 0.0, 1.0) * (stroke[5] - stroke[4]))
    share = np.clip((half - np.abs(across)) / pixel + 0.5 + OVERHANG_PX, 0.0, 1.0)
    share = share * ((along > -pixel / length) & (along < 1.0 + pixel / length))
    slope = -np.clip(across / np.maximum(half, pixel), -1.0, 1.0) * relief
    painted = np.zeros((*share.shape, N_CHANNELS))
    painted[:, :, LIGHT] = 1.0 + 0.12 * (1.0 - (across / np.maximum(half, pixel)) ** 2).clip(-1.0, 1.0)
    painted[:, :, STALK] = 1.0
    painted[:, :, SLOPE_X], painted[:, :, SLOPE_Y] = slope * axis[1], -slope * axis[0]
    _blend(channel[window], painted, share)


def _paint_blade(
    channel: Array, shape: LeafShape, layout: Layout, frame: Frame, i: int, light: float
) -> None:
    """Paint blade ``i``."""
    outline = layout.outline[i] if len(layout.outline) == len(layout.length) else _sector(layout, i)
    window = frame.window(outline.min(axis=0), outline.max(axis=0))
    if layout.fills:
        window = (slice(0, frame.height), slice(0, frame.width))
    if window is None:
        return
    x, y = frame.centres(window)
    dx, dy = x - layout.base[i, 0], y - layout.base[i, 1]
    cos, sin = np.cos(layout.angle[i]), np.sin(layout.angle[i])
    length, half, side = layout.length[i], layout.half[i], layout.side[i]
    along = np.clip((dx * sin + dy * cos) / length, LOWEST, 1.0)
    t = dx * cos - dy * sin
    if shape.bend:
        t = t - side * shape.bend * length * sickle(along)
    place = np.maximum(along, 0.0) * (PROFILE_STEPS - 1)
    step = place.astype(np.int64)
    profile = layout.profile
    following = profile[np.minimum(step + 1, PROFILE_STEPS - 1)]
    wide = half * (profile[step] + (place - step) * (following - profile[step]))
    pixel = max(frame.pixel)
    away = np.abs(t)
    painted = _blade_channels(shape, along, t, np.maximum(wide, 0.25 * pixel), length, half, frame.pixel)
    painted[:, :, LIGHT] *= light
    if layout.fills:
        stalk = (channel[:, :, STALK] > 0.5) & (dy < 0.0)
        channel[~stalk] = painted[~stalk]
        return
    share = np.clip((wide - away) / pixel + 0.5 + OVERHANG_PX, 0.0, 1.0)
    beyond = dx * sin + dy * cos
    share = share * ((beyond > -pixel) & (beyond < length + pixel))
    _blend(channel[window], painted, share)


def _sector(layout: Layout, i: int) -> Array:
    """The triangle (3, 2) in which lobe ``i`` of a blade with lobes around its base lies, metres."""
    cos, sin = np.cos(layout.angle[i]), np.sin(layout.angle[i])
    tip = layout.base[i] + layout.length[i] * np.array([sin, cos])
    across = layout.half[i] * np.array([cos, -sin])
    return np.stack([layout.base[i], tip - across, tip + across])


def _blade_channels(
    shape: LeafShape,
    along: Array,
    t: Array,
    wide: Array,
    length: float,
    half: float,
    pixel: tuple[float, float],
) -> Array:
    """Channels of a blade at points of its own frame.

    ``along`` is the share of its length (negative behind the base), ``t`` the distance from its midrib to the
    right (metres), ``wide`` the half width there (metres).
    """
    out = np.clip(np.abs(t) / wide, 0.0, 1.15)
    ahead = np.maximum(along, 0.0)
    least = THINNEST_PX * max(pixel)
    thick = shape.midrib * half * (1.0 - 0.8 * ahead)
    rib = np.where(along >= 0.0, thick, 0.0)
    drawn = np.maximum(rib, least)
    vein = np.exp(-((t / drawn) ** 2)) * np.minimum(rib / least, 1.0)
    height = CUP * half * out**2 - GROOVE * drawn * vein
    if shape.veins:
        sides, rise = _side_veins(shape, along, t, out, VEIN_WIDTH * thick, length, least)
        vein, height = np.maximum(vein, 0.75 * sides), height + rise
    slope = np.gradient(shape.relief * height)
    painted = np.zeros((*out.shape, N_CHANNELS))
    halves = 0.025 * np.tanh(t / (0.12 * wide))  # the two halves catch the light differently
    painted[:, :, LIGHT] = (1.06 - 0.16 * out**2) * (1.02 - 0.06 * ahead) + halves
    painted[:, :, VEIN] = vein
    painted[:, :, TONE] = np.clip(0.6 * out**3 + 0.4 * ahead**3, 0.0, 1.0)
    painted[:, :, SLOPE_X], painted[:, :, SLOPE_Y] = slope[1] / pixel[0], -slope[0] / pixel[1]
    return painted


def _side_veins(
    shape: LeafShape, along: Array, t: Array, out: Array, thick: Array, length: float, least: float
) -> tuple[Array, Array]:
    """How much of a side vein is at points of a blade (0 to 1), and the height of veins and bulges, metres.

    Veins thinner than ``least`` (metres, half width) get paler, and those too close to each other too.
    """
    gap = (VEIN_SPAN[1] - VEIN_SPAN[0]) / shape.veins
    slant = np.deg2rad(shape.vein_angle_deg)
    start = along - np.abs(t) / length / np.tan(slant) * (1.0 + VEIN_CURVE * out**2)
    phase = (start - VEIN_SPAN[0]) / gap + np.where(t > 0.0, 0.15, -0.15)
    part = phase - np.floor(phase) - 0.5
    inside = (phase > -0.3) & (phase < shape.veins + 0.3)
    apart = gap * length * np.sin(slant)
    thick = thick * (1.0 - 0.6 * np.minimum(out, 1.0))
    seen = np.maximum(thick, least)
    sides = np.exp(-((part * apart / seen) ** 2)) * np.minimum(thick / least, 1.0) * inside
    sides = sides * min(1.0, apart / (5.0 * least))
    bulge = BULGE * apart * min(1.0, apart / (8.0 * least)) * np.cos(2.0 * np.pi * part) * inside
    return sides, bulge - GROOVE * seen * sides
