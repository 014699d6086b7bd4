"""From the numbers of a leaf to the outlines of its blades and stalks.

The leaf's frame: metres, the origin at the foot of the petiole, +y to the tip, +x to the right. A blade's own
frame: its base at the origin, +y along its midrib. All of it is a function of the shape alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from species._art_shape import LeafShape

__all__ = ["Layout", "blade_profile", "lay_out", "sickle", "stroke_outline"]

Array = NDArray[np.float64]

GOLDEN_ANGLE = float(np.pi * (3.0 - np.sqrt(5.0)))
GOLDEN_RATIO = 0.6180339887498949
PROFILE_STEPS = 257
TOOTH_BACK = 0.7  # share of a tooth's pitch that its long lower side takes
TOOTH_START, TOOTH_END = 0.07, 0.97  # teeth stand between these shares of the length
LEAST_DRIP = 1e-4  # of the length; shorter tails are none
FULL_TEETH = 0.45  # where the blade is narrower than this share of its half width, teeth get smaller
TAIL_WIDTH = 0.16  # half width of a long drip tip where it begins, in half widths of the blade
TAIL_SLOPE = 1.4  # the same of a short one, per share of the length that it takes
RACHIS_TIP = 0.45  # thickness of a rachis at its end, over that at its beginning
INTO_BLADE = 0.03  # how far a petiole goes on under the blade, of its length: bases are pointed
PETIOLULE = 0.03  # stalk of a leaflet, of its length
LOBE_ROUND = 0.6  # under 1: lobes are broad and the cuts between them narrow
TIP_LOBE = 0.9  # how far the lobe at the tip reaches of what a side lobe does
LEAST_SIZE = 0.05  # of the smallest leaflet or pinna, over that of the largest
FIRST_PAIR = 0.06  # where the first leaflets stand, of the rachis
ANGLE_FALL = {"pinnate": 0.3, "frond": 0.8, "bipinnate": 0.4}  # how much steeper the last leaflets stand


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the k blades of a leaf are, in the order in which they are painted.

    Attributes
    ----------
    base : (k, 2) float64
        Metres.
    angle : (k,) float64
        Of the midrib against +y, radians, positive to the right.
    length, half : (k,) float64
        Metres: along the midrib, and half of the greatest width.
    side : (k,) float64
        1, or -1 for a blade that is mirrored.
    light : (k,) float64
        Factor of its brightness: needles behind are darker.
    profile : (PROFILE_STEPS,) float64
        Half width along the midrib in units of ``half``, without teeth and lobes, as it is painted.
    fills : bool
        One blade covers the leaf: all of the picture is painted in its frame.
    stroke : (j, 6) float64
        Stalks as x, y at the foot, x, y at the end, thickness at both, metres.
    outline : list of (m, 2) float64
        The blades' outlines, metres.
    """

    base: Array
    angle: Array
    length: Array
    half: Array
    side: Array
    light: Array
    profile: Array
    fills: bool
    stroke: Array
    outline: list[Array]


def lay_out(shape: LeafShape, n: int) -> Layout:
    """Lay out a leaf with about ``n`` points along each side of every blade."""
    if shape.kind in ("star", "fan"):
        return _lay_out_star(shape, n)
    place = {
        "palmate": _place_palmate,
        "pinnate": _place_pinnate,
        "frond": _place_pinnate,
        "bipinnate": _place_bipinnate,
        "needle": _place_needles,
    }.get(shape.kind, _place_single)
    base, angle, length, half, side, light, stroke = place(shape)
    unit = _unit_outline(shape, n)
    outline = _placed_outlines(shape, unit, base, angle, length, half, side)
    share = np.linspace(0.0, 1.0, PROFILE_STEPS)
    profile = blade_profile(shape, share)
    if shape.base < 0.0:  # a heart's lobes are as wide as the blade
        filled = min(1.0, -4.0 * shape.base)
        profile = np.where(share < shape.widest, profile + filled * (1.0 - profile), profile)
    fills = shape.kind in ("simple", "linear", "lobed")
    return Layout(base, angle, length, half, side, light, profile, fills, stroke, outline)


# ---------------------------------------------------------------- one blade


def blade_profile(shape: LeafShape, along: Array) -> Array:
    """Half width of a blade at shares of its length, greatest 1, without teeth and lobes."""
    if shape.kind in ("linear", "frond", "needle"):
        return _strap(shape, along)
    body_end = 1.0 - shape.drip
    y = np.clip(along / body_end, 0.0, 1.0)
    m = shape.widest
    upper = np.clip((y - m) / (1.0 - m), 0.0, 1.0)
    lower = np.clip((m - y) / m, 0.0, 1.0)
    body = (1.0 - upper**2) ** (0.5 * 4.0**shape.tip) * (1.0 - lower**2) ** (
        0.5 * 4.0 ** max(shape.base, 0.0)
    )
    if shape.drip < LEAST_DRIP:
        return body
    tail = np.clip((1.0 - along) / shape.drip, 0.0, 1.0) ** 0.8
    tail *= min(TAIL_WIDTH, TAIL_SLOPE * shape.drip) * np.clip((y - m) / (1.0 - m), 0.0, 1.0) ** 2
    return np.sqrt(body**2 + tail**2)


def _strap(shape: LeafShape, along: Array) -> Array:
    """Parallel sides between a base and a tip; the sharper, the longer they taper."""
    foot = 0.03 + 0.4 * max(shape.base, 0.0)
    end = 0.04 + 0.75 * shape.tip
    lower = np.clip(1.0 - along / foot, 0.0, 1.0)
    upper = np.clip((along - 1.0 + end) / end, 0.0, 1.0)
    return (1.0 - lower**2) ** (0.5 + 0.5 * max(shape.base, 0.0)) * (1.0 - upper**1.6) ** (
        0.5 + 0.5 * shape.tip
    )


def sickle(along: Array) -> Array:
    """Sideways shift of the midrib at shares of its length, per unit of ``bend`` and length."""
    return along * (1.0 - along) * 1.6


def _unit_outline(shape: LeafShape, n: int) -> Array:
    """Outline (m, 2) of a blade: x in half widths, y in lengths, up its right side and down its left."""
    along = _sample(shape, n)
    x, y = blade_profile(shape, along), along.copy()
    if shape.kind == "lobed":
        x, y = _cut_lobes(shape, along, x)
    if shape.teeth and shape.margin != "entire":
        x, y = _cut_teeth(shape, along, x, y)
    if shape.base < 0.0:
        back = np.clip((shape.widest - along) / shape.widest, 0.0, 1.0)
        y = y + 0.3 * shape.base * np.sin(np.pi * np.clip(x, 0.0, 1.0)) * back**2
    x = x / x.max()
    return np.concatenate([np.stack([x, y], axis=1), np.stack([-x[-2:0:-1], y[-2:0:-1]], axis=1)])


def _sample(shape: LeafShape, n: int) -> Array:
    """Shares of the length at which the outline has points: denser at both ends, and at each tooth."""
    along = 0.5 - 0.5 * np.cos(np.pi * np.arange(n + 1) / n)
    parts = [along]
    if shape.kind == "lobed":
        parts.append(np.linspace(0.0, 1.0, 16 * shape.lobes + 1))
    if shape.teeth and shape.margin != "entire":
        corners = {
            "serrate": np.array([0.0, TOOTH_BACK]),
            "double": (np.arange(3)[:, None] + [0.0, TOOTH_BACK]).ravel() / 3.0,
        }.get(shape.margin, np.arange(8) / 8.0)
        phase = (np.arange(shape.teeth)[:, None] + corners).ravel() / shape.teeth
        parts.append(TOOTH_START + (TOOTH_END - TOOTH_START) * phase)
    return np.unique(np.concatenate(parts))


def _tooth(phase: Array) -> Array:
    """A saw tooth: 0 in the notch, 1 at the tip."""
    part = phase - np.floor(phase)
    return np.where(part < TOOTH_BACK, part / TOOTH_BACK, (1.0 - part) / (1.0 - TOOTH_BACK))


def _teeth(margin: str, phase: Array) -> Array:
    """Margin from 0 (notch) to 1 (tip) at a phase that counts teeth."""
    if margin == "serrate":
        return _tooth(phase)
    if margin == "double":
        return 0.62 * _tooth(phase) + 0.38 * _tooth(3.0 * phase)
    if margin == "crenate":
        return np.abs(np.sin(np.pi * phase)) ** 0.7
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * phase)


def _cut_teeth(shape: LeafShape, along: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Cut teeth into the margin; saw teeth lean to the tip."""
    phase = (along - TOOTH_START) / (TOOTH_END - TOOTH_START) * shape.teeth
    toothed = (along >= TOOTH_START) & (along <= TOOTH_END)
    tooth = np.where(toothed, _teeth(shape.margin, phase), 0.0)
    reach = np.minimum(1.0, x / FULL_TEETH) ** 1.5
    depth = shape.tooth_depth * reach
    lean = 0.4 / shape.teeth if shape.margin in ("serrate", "double") else 0.0
    return np.maximum(x - depth * (1.0 - tooth), 0.0), y + lean * tooth * reach * (1.0 - y)


def _cut_lobes(shape: LeafShape, along: Array, x: Array) -> tuple[Array, Array]:
    """Round lobes along both sides and one at the tip; they point forwards."""
    phase = along * (shape.lobes + 0.5)
    lobe = (0.5 - 0.5 * np.cos(2.0 * np.pi * phase)) ** LOBE_ROUND
    lobe = np.where(phase > shape.lobes + 0.4, np.maximum(lobe, TIP_LOBE), lobe)
    inner = x * (1.0 - shape.lobe_depth * (1.0 - lobe))
    return inner, along + 0.36 / (shape.lobes + 0.5) * lobe * x * (1.0 - along)


def _placed_outlines(
    shape: LeafShape, unit: Array, base: Array, angle: Array, length: Array, half: Array, side: Array
) -> list[Array]:
    """The unit outline at every blade's place (k outlines of (m, 2), metres)."""
    y = unit[None, :, 1] * length[:, None]
    x = side[:, None] * (unit[None, :, 0] * half[:, None])
    x = x + side[:, None] * shape.bend * sickle(unit[None, :, 1]) * length[:, None]
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    placed = np.stack([x * cos + y * sin, y * cos - x * sin], axis=2) + base[:, None, :]
    return list(placed)


def stroke_outline(stroke: Array, least: float = 0.0) -> list[Array]:
    """Outlines of stalks (j, 6), no thinner than ``least`` metres."""
    start, end = stroke[:, 0:2], stroke[:, 2:4]
    axis = end - start
    length = np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
    across = np.stack([axis[:, 1], -axis[:, 0]], axis=1) / length
    w0 = 0.5 * np.maximum(stroke[:, 4:5], least) * across
    w1 = 0.5 * np.maximum(stroke[:, 5:6], least) * across
    return list(np.stack([start + w0, end + w1, end - w1, start - w0], axis=1))


# ---------------------------------------------------------------- where blades stand

Placed = tuple[Array, Array, Array, Array, Array, Array, Array]


def _stalks(shape: LeafShape, end: float, more: list[Array] | None = None) -> Array:
    """Petiole and rachis up to ``end`` metres, and further strokes."""
    thick, thin = shape.stalk_width, RACHIS_TIP * shape.stalk_width
    rows = []
    if shape.petiole > 0.0:
        rows.append([0.0, 0.0, 0.0, shape.petiole, thick, thick])
    if end > shape.petiole:
        rows.append([0.0, shape.petiole, 0.0, end, thick, thin])
    return np.concatenate([np.array(rows, float).reshape(-1, 6), *(more or [])])


def _place_single(shape: LeafShape) -> Placed:
    one = np.ones(1)
    half = 0.5 * float(shape.width or 0.0)
    base = np.array([[0.0, shape.petiole]])
    stroke = _stalks(shape, 0.0)
    stroke[:, 3] += INTO_BLADE * shape.length
    return base, 0.0 * one, shape.length * one, half * one, one, one, stroke


def _place_palmate(shape: LeafShape) -> Placed:
    long, wide = float(shape.leaflet_length or 0.0), float(shape.leaflet_width or 0.0)
    n = shape.leaflets
    place = np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1)
    order = np.argsort(-np.abs(place), kind="stable")  # the middle one lies on top
    place = place[order]
    angle = place * np.deg2rad(0.5 * shape.spread_deg)
    size = 1.0 - shape.taper * place**2
    stalk = (shape.length - long) * (1.0 - 0.6 * np.abs(place))
    heading = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    foot = np.array([0.0, shape.petiole])
    base = foot + stalk[:, None] * heading
    thin = np.full(n, 0.7 * shape.stalk_width)
    strokes = np.column_stack([np.tile(foot, (n, 1)), base, thin, thin])
    side = np.where(place < 0.0, -1.0, 1.0)
    stroke = _stalks(shape, 0.0, [strokes[stalk > 0.0]])
    return base, angle, long * size, 0.5 * wide * size, side, np.ones(n), stroke


def _place_pinnate(shape: LeafShape) -> Placed:
    long, wide = float(shape.leaflet_length or 0.0), float(shape.leaflet_width or 0.0)
    pairs, odd = divmod(shape.leaflets, 2)
    small = 1.0 - shape.taper
    steep = np.deg2rad(shape.leaflet_angle_deg)
    fall = ANGLE_FALL[shape.kind]
    reach = long * small * (1.0 if odd else np.cos(steep * (1.0 - fall)))
    rachis = max(shape.length - reach, 0.02 * shape.length)
    at = np.linspace(FIRST_PAIR, 1.0 - odd * 0.6 / max(pairs, 1), pairs)
    angle = np.concatenate([np.repeat(steep * (1.0 - fall * at**1.5), 2), np.zeros(odd)])
    side = np.concatenate([np.tile([-1.0, 1.0], pairs), np.ones(odd)])
    angle = angle * side
    size = np.concatenate([np.repeat(1.0 - shape.taper * (2.0 * at - 0.9) ** 2, 2), np.full(odd, small)])
    size = np.maximum(size, LEAST_SIZE)
    height = shape.petiole + rachis * np.concatenate([np.repeat(at, 2), np.ones(odd)])
    foot = np.stack([np.zeros(len(height)), height], axis=1)
    stalk = PETIOLULE * long * size * (shape.kind == "pinnate")
    heading = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    base = foot + stalk[:, None] * heading
    thin = np.full(len(angle), 0.5 * shape.stalk_width)
    more = [np.column_stack([foot, base, thin, thin])[stalk > 0.0]]
    length = (size - PETIOLULE * size * (shape.kind == "pinnate")) * long
    return (
        base, angle, length, 0.5 * wide * size, side, np.ones(len(angle)),
        _stalks(shape, shape.petiole + rachis, more),
    )  # fmt: skip


def _place_bipinnate(shape: LeafShape) -> Placed:
    long, wide = float(shape.leaflet_length or 0.0), float(shape.leaflet_width or 0.0)
    steep, fall = np.deg2rad(shape.leaflet_angle_deg), ANGLE_FALL["bipinnate"]
    longest = 0.5 * float(shape.width or 0.0) / np.sin(steep)
    reach = longest * (1.0 - shape.taper) * np.cos(steep * (1.0 - fall))
    rachis = max(shape.length - reach, 0.3 * shape.length)
    at = np.repeat(np.linspace(FIRST_PAIR, 1.0, shape.pinnae), 2)
    sign = np.tile([-1.0, 1.0], shape.pinnae)
    turn = sign * steep * (1.0 - fall * at**1.5)
    share = np.maximum(1.0 - shape.taper * (2.0 * at - 0.9) ** 2, LEAST_SIZE)
    pinna = np.maximum(longest * share - 0.5 * long, 0.5 * long)
    foot = np.stack([np.zeros(len(at)), shape.petiole + rachis * at], axis=1)
    heading = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    thin = 0.5 * shape.stalk_width
    strokes = np.column_stack(
        [foot, foot + pinna[:, None] * heading, np.full(len(at), thin), np.full(len(at), 0.5 * thin)]
    )
    pairs = shape.leaflets // 2
    on = np.repeat(np.linspace(0.04, 1.0, pairs), 2)
    side = np.tile([-1.0, 1.0], pairs)
    open_angle = np.deg2rad(72.0) * (1.0 - 0.35 * on**3)
    size = 1.0 - 0.3 * (2.0 * on - 0.9) ** 2
    k = len(at) * len(on)
    base = (foot[:, None] + (pinna[:, None] * on)[:, :, None] * heading[:, None]).reshape(k, 2)
    angle = (turn[:, None] + side * open_angle).reshape(k)
    shrink = (np.sqrt(pinna / pinna.max())[:, None] * size).reshape(k)
    return (
        base, angle, long * shrink, 0.5 * wide * shrink, np.tile(side, len(at)), np.ones(k),
        _stalks(shape, shape.petiole + rachis, [strokes]),
    )  # fmt: skip


def _place_needles(shape: LeafShape) -> Placed:
    long, wide = float(shape.leaflet_length or 0.0), float(shape.leaflet_width or 0.0)
    spread = np.deg2rad(shape.spread_deg)
    fan = np.linspace(-0.5, 0.5, shape.cluster) * spread if shape.cluster > 1 else np.zeros(1)
    if shape.leaflets == 1:
        base = np.tile([0.0, shape.petiole], (shape.cluster, 1))
        one = np.ones(shape.cluster)
        size = long * one
        return base, fan, size, 0.5 * wide * one, np.where(fan < 0, -1.0, 1.0), one, _stalks(shape, 0.0)
    n = shape.leaflets
    steep = np.deg2rad(shape.leaflet_angle_deg)
    axis = max(shape.length - long, 0.02 * shape.length)
    bundle = np.arange(n)
    at = (bundle + 0.5) / n
    turn, rise = bundle * GOLDEN_ANGLE, steep * (1.0 - 0.85 * at**4)
    towards = np.sin(rise) * np.cos(turn)
    jitter = np.modf(bundle * GOLDEN_RATIO)[0]
    order = np.argsort(towards, kind="stable")
    x, y = np.sin(rise) * np.sin(turn), np.cos(rise)
    size = long * (1.0 - 0.15 * jitter) * (1.0 - shape.taper * (1.0 - at) ** 2) * np.hypot(x, y)
    angle = (np.arctan2(x, y)[:, None] + fan)[order].ravel()
    base = np.stack([np.zeros(n), shape.petiole + axis * at], axis=1)[order].repeat(shape.cluster, axis=0)
    length = size[order].repeat(shape.cluster)
    light = (1.0 + 0.16 * towards + 0.08 * (jitter - 0.5))[order].repeat(shape.cluster)
    side = np.where(angle < 0.0, -1.0, 1.0)
    half = np.full(len(angle), 0.5 * wide)
    return base, angle, length, half, side, light, _stalks(shape, shape.petiole + axis)


# ---------------------------------------------------------------- lobes around the base


def _lay_out_star(shape: LeafShape, n: int) -> Layout:
    """One blade whose outline is a radius over the angle; each lobe has a midrib of its own."""
    k = shape.lobes
    spread = np.deg2rad(shape.spread_deg)
    gap = spread / k
    lobe = (np.arange(k) - 0.5 * (k - 1)) * gap
    per_lobe = max(2 * (n // (2 * k)), 12)
    corners = np.empty(0)
    if shape.teeth and shape.margin != "entire":
        one_side = np.arange(0.0, shape.teeth, 0.1) / shape.teeth * 0.5 * gap
        corners = (lobe[:, None] + np.concatenate([-one_side, one_side])).ravel()
    angle = np.unique(np.concatenate([np.linspace(-0.5 * spread, 0.5 * spread, per_lobe * k + 1), corners]))
    radius = _star_radius(shape, angle, lobe, gap)
    rim = np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=1)
    foot = np.array([0.0, shape.petiole])
    outline = np.concatenate([[foot], rim + foot])
    length = shape.length * _lobe_size(shape, lobe)
    half = length * np.tan(min(0.5 * gap, 1.2))
    profile = np.linspace(0.0, 1.0, PROFILE_STEPS)
    one = np.ones(k)
    side = np.where(lobe < 0.0, -1.0, 1.0)
    return Layout(
        np.tile(foot, (k, 1)), lobe, length, half, side, one, profile, k == 1, _stalks(shape, 0.0), [outline]
    )


def _lobe_size(shape: LeafShape, angle: Array) -> Array:
    """Length of a lobe at an angle, over that of the middle one."""
    return 1.0 - shape.taper * (2.0 * angle / np.deg2rad(shape.spread_deg)) ** 2


def _star_radius(shape: LeafShape, angle: Array, lobe: Array, gap: float) -> Array:
    """Distance of the rim from the base at each angle, metres."""
    nearest = np.clip(np.rint((angle - lobe[0]) / gap), 0, len(lobe) - 1).astype(np.int64)
    off = np.clip(np.abs(angle - lobe[nearest]) * 2.0 / gap, 0.0, 1.0)  # 0 on a midrib, 1 in a cut
    depth = shape.lobe_depth
    if shape.kind == "fan":  # segments of constant width, then pointed
        share = np.minimum((1.0 - depth) / np.maximum(off, 1e-6), 1.0 - 0.5 * depth * off)
    else:
        share = 1.0 - depth + depth * (1.0 - off) ** (0.5 * 4.0**shape.tip)
    radius = shape.length * _lobe_size(shape, angle) * share
    if shape.teeth and shape.margin != "entire":
        saw = shape.margin in ("serrate", "double")
        phase = (TOOTH_BACK if saw else 0.5) - off * shape.teeth  # the tip of every lobe is a tooth's tip
        radius = radius * (1.0 - shape.tooth_depth * (1.0 - _teeth(shape.margin, phase)))
    return radius
