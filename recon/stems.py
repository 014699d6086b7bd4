"""Stems in a scan: how many, and where the foot of the trunk is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELL = 0.10  # metres; cells of a slab that touch belong to one stem
MAX_CELLS = 4_000_000
SLAB_LOW = (0.06, 0.3, 1.0)  # share of the height, and limits in metres, where the slab begins
SLAB_SIZE = (0.08, 0.3, 1.5)  # and how high it is
BIN = 0.10  # metres of height
MIN_COVER = 0.6  # share of the slab's height in which a stem has points
MIN_COVER_ABOVE = 0.4  # and of the slab on top of it, around the same place
ABOVE_REACH = 0.35  # metres that a stem may lean and spread by from one slab to the next
MAX_SPREAD = 0.75  # root mean square distance from the middle of a stem, metres
MIN_GROUP_POINTS = 8  # of a piece of stem in a slab of a plot
MAX_GROUP_SPREAD = 0.45  # and the root mean square distance of its points from its axis, metres
MIN_STEM_SHARE = 0.15  # of the points of the thickest stem in the slab
TREE_DISTANCE = 2.0  # stems nearer than this, metres, are of one tree
MIN_TREE_POINTS = 30  # in the slab; fewer, from the air, do not tell a stem from a branch
MAX_FOOT = 0.4  # metres above the ground that a stem of its own must reach down to
TREE_SHARE = 0.5  # of the scan's height that a tree of its own must reach up to
WIDE_AREA = 450.0  # m2 of ground under one tree at most
WIDE_RATIO = 2.5  # width over height of one tree at most
CROWN_SHARE = 0.3  # of the height: what is above belongs to crowns
CROWN_RADIUS_SHARE = 0.1  # of the height: no other top is so near the top of a crown
TOP = 0.998  # quantile of the heights
FOOT_SPREADS = 1.5  # points of a stem are this near to its middle, in spreads ...
FOOT_MARGIN = 0.10  # ... plus this, metres
FOOT_WANDER = 0.5  # metres that the middle may wander on the way down
FOOT_STEP = 0.10  # metres
FOOT_GAP = 0.5  # a stem is followed down over gaps up to this, metres ...
FOOT_FEW = 100  # ... and over any if it has fewer points than these from the slab down ...
FOOT_CONE = 0.5  # ... in a cone that widens by so much a metre
FOOT_COUNT = 0.25  # fewer of the stem's points a step than this share hardly tell where it is
FOOT_QUANTILE = 0.25  # of the widths of a stem's steps; most of them may lie among roots or grass
FOOT_FLARE = 1.3  # wider by this than the stem is: roots, grass or ground, which do not move the middle


@dataclass(frozen=True, eq=False)
class Stems:
    """Stems that pass through a slab above the ground.

    Attributes
    ----------
    centre : (k, 3) float64
        Middle of each stem in the slab, the one with the most points first.
    spread : (k,) float64
        Root mean square distance of its points from the middle, metres.
    n_points : (k,) int64
    """

    centre: np.ndarray
    spread: np.ndarray
    n_points: np.ndarray


NO_STEMS = Stems(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int64))


def find_stems(xyz: np.ndarray, height: np.ndarray, top: float) -> Stems:
    """Compact upright columns of points in a slab above the ground.

    Parameters
    ----------
    xyz : (n, 3) float64
        Metres.
    height : (n,) float64
        Of each point above the ground or the foot of the scan, metres.
    top : float
        Height of the scan, metres.

    Returns
    -------
    Stems
    """
    low = float(np.clip(SLAB_LOW[0] * top, *SLAB_LOW[1:]))
    size = float(np.clip(SLAB_SIZE[0] * top, *SLAB_SIZE[1:]))
    row = np.flatnonzero((height >= low) & (height < low + size))
    if row.size < 3:
        return NO_STEMS
    group, n_groups = _touching(xyz[row, :2])
    n_points = np.bincount(group)
    centre = np.stack([np.bincount(group, xyz[row, c]) for c in range(3)], axis=1) / n_points[:, None]
    off = np.hypot(*(xyz[row, :2] - centre[group, :2]).T)
    spread = np.sqrt(np.bincount(group, off**2) / n_points)
    cover = _cover(height[row], group, n_groups, low, size)
    stem = np.flatnonzero((cover >= MIN_COVER) & (spread <= MAX_SPREAD) & (n_points >= 3))
    above = np.flatnonzero((height >= low + size) & (height < low + 2 * size))
    stem = stem[_goes_on(xyz[above], height[above], centre[stem], spread[stem], low + size, size)]
    if stem.size == 0:
        return NO_STEMS
    stem = stem[n_points[stem] >= MIN_STEM_SHARE * n_points[stem].max()]
    stem = stem[np.argsort(-n_points[stem], kind="stable")]
    return Stems(centre[stem], spread[stem], n_points[stem])


def upright_groups(xyz: np.ndarray, low: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Compact upright groups of points in a slab of the scan.

    Parameters
    ----------
    xyz : (n, 3) float64
        The points of the slab.
    low, size : float
        Where the slab begins and how high it is, metres.

    Returns
    -------
    centre : (k, 3) float64
    spread : (k,) float64
        Root mean square distance of the points of each group from its axis, metres.
    """
    if len(xyz) < MIN_GROUP_POINTS:
        return np.zeros((0, 3)), np.zeros(0)
    group, n_groups = _touching(xyz[:, :2])
    n_points = np.bincount(group)
    centre = np.stack([np.bincount(group, xyz[:, c]) for c in range(3)], axis=1) / n_points[:, None]
    off = np.hypot(*(xyz[:, :2] - centre[group, :2]).T)
    spread = np.sqrt(np.bincount(group, off**2) / n_points)
    cover = _cover(xyz[:, 2], group, n_groups, low, size)
    good = (cover >= MIN_COVER) & (spread <= MAX_GROUP_SPREAD) & (n_points >= MIN_GROUP_POINTS)
    return centre[good], spread[good]


def _touching(xy: np.ndarray) -> tuple[np.ndarray, int]:
    """Group of each point: cells of a grid that touch are one group."""
    from scipy.ndimage import label

    low = xy.min(axis=0)
    size = xy.max(axis=0) - low
    cell = max(CELL, float(np.sqrt(size[0] * size[1] / MAX_CELLS)))
    at = np.floor((xy - low) / cell).astype(np.int64)
    filled = np.zeros(at.max(axis=0) + 1, bool)
    filled[at[:, 0], at[:, 1]] = True
    labels, count = label(filled, structure=np.ones((3, 3)))
    return labels[at[:, 0], at[:, 1]] - 1, count


def _cover(height: np.ndarray, group: np.ndarray, n_groups: int, low: float, size: float) -> np.ndarray:
    from recon import _prepare_kernels as kernels

    n_bins = max(int(round(size / BIN)), 3)
    return kernels.column_cover(height, group.astype(np.int64), n_groups, low, size / n_bins, n_bins)


def _goes_on(
    xyz: np.ndarray, height: np.ndarray, centre: np.ndarray, spread: np.ndarray, low: float, size: float
) -> np.ndarray:
    """True for the columns that have points above them, too."""
    out = np.zeros(len(centre), bool)
    for k, (middle, radius) in enumerate(zip(centre, spread, strict=True)):
        near = np.hypot(*(xyz[:, :2] - middle[:2]).T) < radius + ABOVE_REACH
        group = np.zeros(near.sum(), np.int64)
        out[k] = near.any() and _cover(height[near], group, 1, low, size)[0] >= MIN_COVER_ABOVE
    return out


def count_trees(xyz: np.ndarray, stems: Stems, height: np.ndarray, top: float) -> int:
    """How many trees a scan looks like: stems apart that stand on the ground, or crowns of a wide scan.

    Parameters
    ----------
    xyz : (n, 3) float64
    stems : Stems
    height : (n,) float64
        Above the ground, metres.
    top : float
        Height of the scan, metres.

    Returns
    -------
    int
        At least 1.
    """
    n_stems = len(separate_stems(xyz, stems, height, top))
    if n_stems > 1:
        return n_stems
    return max(len(crown_tops(xyz[height > CROWN_SHARE * top], top)), 1)


def separate_stems(xyz: np.ndarray, stems: Stems, height: np.ndarray, top: float) -> np.ndarray:
    """Stems that stand on the ground, one of each group nearer than `TREE_DISTANCE`, indices."""
    chosen: list[np.int64] = []
    compact = (stems.n_points >= MIN_TREE_POINTS) & (stems.spread <= MAX_GROUP_SPREAD)
    for s in np.flatnonzero(compact):
        apart = all(np.hypot(*(stems.centre[s, :2] - stems.centre[t, :2])) > TREE_DISTANCE for t in chosen)
        if apart and _stands(xyz, height, stems.centre[s], stems.spread[s], top):
            chosen.append(s)
    return np.array(chosen, np.int64)


def _stands(xyz: np.ndarray, height: np.ndarray, centre: np.ndarray, spread: float, top: float) -> bool:
    """Whether a column of points reaches from the ground to a good part of the scan's height."""
    near = np.hypot(*(xyz[:, :2] - centre[:2]).T) < spread + ABOVE_REACH
    return bool(height[near].min() < MAX_FOOT and height[near].max() > TREE_SHARE * top)


def crown_tops(crown: np.ndarray, top: float) -> np.ndarray:
    """Tops of the crowns of a scan that is wider than any tree.

    Parameters
    ----------
    crown : (n, 3) float64
        Points above the undergrowth, metres.
    top : float
        Height of the scan, metres.

    Returns
    -------
    (k, 2) float64
        Places of the tops; none if the scan is no wider than a tree can be.
    """
    from scipy.ndimage import maximum_filter

    if len(crown) < 10 or top <= 0:
        return np.zeros((0, 2))
    low = crown[:, :2].min(axis=0)
    size = crown[:, :2].max(axis=0) - low
    cell = max(1.0, float(np.sqrt(size[0] * size[1] / MAX_CELLS)))
    at = np.floor((crown[:, :2] - low) / cell).astype(np.int64)
    tallest = np.full(at.max(axis=0) + 1, -np.inf)
    np.maximum.at(tallest, (at[:, 0], at[:, 1]), crown[:, 2])
    filled = np.isfinite(tallest)
    if filled.sum() * cell**2 < WIDE_AREA and size.max() < WIDE_RATIO * max(top, 4.0):
        return np.zeros((0, 2))
    window = 2 * int(np.ceil(CROWN_RADIUS_SHARE * top / cell)) + 1
    peak = filled & (tallest == maximum_filter(tallest, size=max(window, 3), mode="nearest"))
    return low + (np.argwhere(peak) + 0.5) * cell


def stem_foot(xyz: np.ndarray, centre: np.ndarray, spread: float) -> np.ndarray:
    """Follow a stem down to its foot.

    Parameters
    ----------
    xyz : (n, 3) float64
    centre : (3,) float64
        Middle of the stem in a slab.
    spread : float
        Root mean square distance of its points from there, metres.

    Returns
    -------
    (3,) float64
        Middle of the lowest points of the stem, at the height of the lowest.
    """
    reach = FOOT_SPREADS * spread + FOOT_MARGIN
    away = np.hypot(*(xyz[:, :2] - centre[:2]).T)
    below = xyz[:, 2] < centre[2]
    near = xyz[(away < reach + FOOT_WANDER) & below]
    middle = centre.copy()
    foot = centre.copy()
    widths: list[float] = []
    counts: list[int] = []
    z = centre[2]
    while z > foot[2] - FOOT_GAP and len(near):
        slab = near[(near[:, 2] <= z) & (near[:, 2] > z - FOOT_STEP)]
        slab = slab[np.hypot(*(slab[:, :2] - middle[:2]).T) < reach]
        if len(slab):
            low, high = slab[:, :2].min(axis=0), slab[:, :2].max(axis=0)
            widths.append(float((high - low).max()))
            counts.append(len(slab))
            is_thin = widths[-1] <= FOOT_FLARE * float(np.quantile(widths, FOOT_QUANTILE))
            if is_thin and counts[-1] >= FOOT_COUNT * float(np.median(counts)):
                foot[:2] = 0.5 * (low + high)
                middle[:2] += 0.5 * (foot[:2] - middle[:2])
            foot[2] = slab[:, 2].min()
        z -= FOOT_STEP
    if len(near) < FOOT_FEW:  # seen from the air: what is left of the trunk lies far apart
        lower = below & (xyz[:, 2] < foot[2]) & (away < reach + FOOT_CONE * (centre[2] - xyz[:, 2]))
        foot[2] = xyz[lower, 2].min(initial=foot[2])
    return foot
