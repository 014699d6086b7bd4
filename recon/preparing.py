"""Preparing a scan: what is no part of the tree goes, and the trunk's foot becomes the origin.

In turn: the unit and the axis that is up; one tree of those that the file numbers; duplicate points;
stray points far from everything; the ground; the stems, of which a plot has several; the foot of the trunk.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from recon.cloud import Cloud, as_cloud
from recon.ground import BOTTOM, Ground, find_ground
from recon.ordering import morton_order
from recon.stems import NO_STEMS, TOP, Stems, count_trees, find_stems, separate_stems, stem_foot
from treegraph.errors import InputError

MIN_POINTS = 16
METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}
UP = {"z": (0, 1, 2), "y": (0, 2, 1), "x": (1, 2, 0)}  # rows of the scan that become x, y, z
TALLEST = 130.0  # metres; no tree is taller
TALL = 65.0  # metres; hardly one is: the scan may be in feet
SMALLEST = 0.25  # metres
WIDEST = 20_000.0  # metres between the points, strays apart; no scan with a tree in it is wider
FOOT_DECIMALS = 6  # of metres: sums over points depend on their order beyond
CELL_SHARE = 0.03  # cells that strays are looked for in, as a share of the scan's extent ...
CELL_RANGE = (0.05, 0.5)  # ... and their limits, metres
STRAY_SHARE = 0.02  # a piece with fewer of all points may be stray ...
STRAY_GAP = 0.10  # ... if it is so much of the extent away from the rest
STRAY_CELLS = 4.0  # ... and so many cells
UNDER_SHARE = 1.0  # of the height of the rest: no stray is nearer below it, as a trunk seen from the air ...
UNDER_RIM = (0.1, 0.9)  # ... and between these quantiles of its places
SPARSE_STEM = 150  # points; a stem of fewer that ends so far up ...
HANGING_SHARE = 0.05  # ... as a share of the height, is a cluster of branches ...
HIGH_SLAB_SHARE = 0.25  # ... and so is one that was found in a slab so high
MOST_STRAY = 0.2  # of all points; where more look stray the scan is sparse, and none are
MIN_TREE_SHARE = 0.02  # of the numbered points; smaller numbers are no trees
BASE_AWAY = 1.0  # metres that a given base may be from the nearest point, or ...
BASE_SHARE = 0.15  # ... this share of the height
FOOT_SHARE = 0.04  # of the height: where the foot is looked for if there is no stem
FOOT_POINTS = 3  # the fewest that the place of such a foot is taken from
LYING_STEMS = 4  # along another axis than z are no chance ...
LYING_POINTS = 200  # ... if they have so many points
WIDE_FOOT = 0.08  # lowest points spread wider than this share of the height are no foot
GROUND_RADIUS_STEPS = 2.0  # the trunk keeps its points down to the ground this far around, in spreads


@dataclass(frozen=True)
class PrepareSettings:
    """What the user can say about a scan.

    Attributes
    ----------
    base : (3,) tuple or None
        Foot of the trunk in the scan's own coordinates and unit; found if None.
    units : {None, "m", "cm", "mm", "ft"}
        Unit of the scan. If None: what the file declares, else metres; an error if that cannot be.
    up : {"z", "y", "x", "-z", "-y", "-x"}
        Axis of the scan that points up.
    keep_ground : bool
        Leave the ground in.
    largest : bool
        Of several trees take the largest.
    tree_id : int or None
        Of a scan with tree numbers take this one.
    """

    base: tuple[float, float, float] | None = None
    units: str | None = None
    up: str = "z"
    keep_ground: bool = False
    largest: bool = False
    tree_id: int | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A cloud ready for the skeleton.

    Attributes
    ----------
    cloud : Cloud
        Metres, z up, foot of the trunk at (0, 0, 0).
    index : (m,) int64
        Row of the given cloud of each point.
    ground_z : float or None
        Height of the ground at the trunk, metres, in the new frame.
    looks_like_many : int
        Number of trees if the scan looks like several, else 1.
    notes : tuple of str
        What was noticed and done.
    stem_spread : float or None
        Root mean square distance of the points of the stem from its middle, near its foot, metres:
        its radius if nothing but bark was hit; None if no stem stands out.
    """

    cloud: Cloud
    index: np.ndarray
    ground_z: float | None
    looks_like_many: int
    notes: tuple[str, ...]
    stem_spread: float | None = None


def prepare(points: Any, settings: PrepareSettings | None = None) -> Prepared:
    """Drop what is no part of the tree and move its foot to the origin.

    Parameters
    ----------
    points : Cloud or (n, 3) array_like
    settings : PrepareSettings, optional

    Returns
    -------
    Prepared
        If `looks_like_many` is more than 1 and `settings.largest` is not set, all trees are still in
        the cloud and its origin is the foot of the one with the most points on its stem.

    Raises
    ------
    InputError
        If there are too few points, they are too far apart, the unit cannot be metres, or a setting makes
        no sense.
    """
    settings = settings or PrepareSettings()
    given = as_cloud(points)
    notes: list[str] = []
    index = np.flatnonzero(np.isfinite(given.xyz).all(axis=1))
    index = _numbered_tree(given, index, settings, notes)
    _enough(len(index))
    xyz = _turned(given.xyz[index], settings.up)
    scale = _metres_per_unit(given, xyz, settings, notes)
    xyz = xyz * scale if scale != 1.0 else xyz
    keep = _drop_duplicates(xyz, notes)
    keep = keep[_drop_strays(xyz[keep], notes)]
    index, xyz = index[keep], np.ascontiguousarray(xyz[keep])
    _enough(len(index))
    _narrow_enough(xyz)
    ground = None if settings.keep_ground else find_ground(xyz)
    stems, height, top = _stems_above(xyz, ground)
    stands = len(stems.centre) > 0 or (ground is not None and ground.is_wide)
    if not stands and settings.up == "z":
        _remark_lying(xyz, notes)
    n_trees = _n_numbered(given, settings) or _n_standing(xyz, stems, height, top)
    if n_trees > 1 and (settings.largest or settings.base is not None):
        base = None if settings.base is None else _given_base(given, xyz, settings, scale)
        mine = _one_of_many(given, index, xyz, stems, height, base, notes)
        index, xyz, height = index[mine], np.ascontiguousarray(xyz[mine]), height[mine]
        stems, height, top = _stems_above(xyz, ground)
    if ground is None and _hangs(xyz, stems):
        stems = NO_STEMS
    wood = np.ones(len(xyz), bool)
    if ground is not None:
        wood = _without_ground(xyz, ground, stems, notes)
        _enough_above(int(wood.sum()), len(xyz))
    index, xyz = index[wood], xyz[wood]
    base = _base(given, xyz, stems, ground, settings, scale)
    cloud = _moved(given, index, xyz, base, scale, settings, notes)
    ground_z = None if ground is None else ground.near(base[0], base[1]) - float(base[2])
    spread = round(float(stems.spread[0]), FOOT_DECIMALS) if len(stems.centre) else None
    return Prepared(cloud, index, ground_z, n_trees, tuple(notes), spread)


def _enough(n: int) -> None:
    if n < MIN_POINTS:
        raise InputError(f"{n} usable points are too few for a tree (at least {MIN_POINTS})")


def _enough_above(n: int, n_all: int) -> None:
    if n < MIN_POINTS:
        raise InputError(
            f"{n_all - n} of {n_all} points look like ground, which leaves too few for a tree: pass "
            "keep_ground=True (--keep-ground) if they are none"
        )


def _narrow_enough(xyz: np.ndarray) -> None:
    widest = float(np.ptp(xyz, axis=0).max())
    if widest > WIDEST:
        raise InputError(
            f"the points spread over {widest / 1000:.3g} km, which no scan of a tree does: check their unit "
            "(--units), or drop the points that are far away"
        )


def _numbered_tree(
    cloud: Cloud, index: np.ndarray, settings: PrepareSettings, notes: list[str]
) -> np.ndarray:
    """The points of the tree asked for by its number."""
    if settings.tree_id is None:
        return index
    if cloud.tree_id is None:
        raise InputError("tree_id needs a scan with a tree number for each point, and this one has none")
    mine = index[cloud.tree_id[index] == settings.tree_id]
    if mine.size == 0:
        known = np.unique(cloud.tree_id[cloud.tree_id >= 0])
        raise InputError(f"there is no tree {settings.tree_id}; the scan has {_some(known)}")
    notes.append(f"tree {settings.tree_id} has {mine.size} of {index.size} points")
    return mine


def _some(numbers: np.ndarray) -> str:
    shown = ", ".join(str(v) for v in numbers[:8])
    return f"{shown} and {numbers.size - 8} more" if numbers.size > 8 else shown


def _is_numbered(tree_id: np.ndarray) -> np.ndarray:
    """True where a number is a tree's: -1 is none, and so is 0 beside others: trees are counted from 1."""
    return tree_id > 0 if (tree_id > 0).any() else tree_id >= 0


def _n_numbered(cloud: Cloud, settings: PrepareSettings) -> int:
    """Number of trees that the points of a scan are numbered by, 0 if they are not or one is chosen."""
    if cloud.tree_id is None or settings.tree_id is not None:
        return 0
    _, count = np.unique(cloud.tree_id[_is_numbered(cloud.tree_id)], return_counts=True)
    return int((count >= MIN_TREE_SHARE * max(count.sum(), 1)).sum())


def _n_standing(xyz: np.ndarray, stems: Stems, height: np.ndarray, top: float) -> int:
    """Number of trees that a scan shows; if it is not one, counted on a ground of any shape."""
    n_trees = count_trees(xyz, stems, height, top)
    if n_trees > 1:
        from recon.plots import stem_columns

        return max(n_trees, len(stem_columns(xyz, top)[0]))
    return n_trees


def _turned(xyz: np.ndarray, up: str) -> np.ndarray:
    """The points with the axis that is up as z, right-handed."""
    if up not in [sign + axis for sign in ("", "-") for axis in UP]:
        raise InputError(f"up must be one of z, y, x, -z, -y, -x, got {up!r}")
    if up == "z":
        return xyz
    name = up[-1]
    a, b, c = UP[name]
    first = xyz[:, a] if name == "x" else -xyz[:, a] if name == "y" else xyz[:, a]
    if up.startswith("-"):
        return np.stack([-first, xyz[:, b], -xyz[:, c]], axis=1)
    return np.stack([first, xyz[:, b], xyz[:, c]], axis=1)


def _metres_per_unit(cloud: Cloud, xyz: np.ndarray, settings: PrepareSettings, notes: list[str]) -> float:
    """Factor to metres; remarks and errors where that looks wrong."""
    units = settings.units
    if units is not None and units not in METRES:
        raise InputError(f"units must be one of {', '.join(METRES)}, got {units!r}")
    if units is None and cloud.unit in METRES and cloud.unit != "m":
        units = cloud.unit
        notes.append(f"the file says that it is in {units}; it was converted to metres")
    scale = METRES[units or "m"]
    low, high = np.quantile(xyz[:, 2], [0.005, 0.995])
    tall = float(high - low) * scale
    if settings.units is None and tall > TALLEST:
        guess = "mm" if tall > 1500 else "cm" if tall > 400 else "ft"
        raise InputError(
            f"the scan is {tall:.0f} m tall if its unit is the metre, and no tree is: pass units={guess!r} "
            f'(--units {guess}) if that is what it is in, or units="m" to insist'
        )
    if settings.units is None and tall > TALL:
        notes.append(f"the scan is {tall:.0f} m tall: if it is in feet, pass units='ft' (--units ft)")
    if tall < SMALLEST and float((xyz.max(axis=0) - xyz.min(axis=0)).max()) * scale < SMALLEST:
        notes.append(f"the scan is only {100 * tall:.1f} cm tall: check its unit (--units)")
    return scale


def _drop_duplicates(xyz: np.ndarray, notes: list[str]) -> np.ndarray:
    """Rows of the points without exact doubles, ascending."""
    order, code, _ = morton_order(xyz)
    again = np.concatenate([[False], code[1:] == code[:-1]])
    if not again.any():
        return np.arange(len(xyz))
    shared = np.flatnonzero(again | np.concatenate([again[1:], [False]]))
    rows = np.sort(order[shared])
    _, first = np.unique(xyz[rows], axis=0, return_index=True)
    keep = np.ones(len(xyz), bool)
    keep[rows] = False
    keep[rows[first]] = True
    n_double = len(xyz) - int(keep.sum())
    if n_double:
        notes.append(f"{n_double} of {len(xyz)} points were there twice")
    return np.flatnonzero(keep)


def _drop_strays(xyz: np.ndarray, notes: list[str]) -> np.ndarray:
    """Rows of the points that are no small piece far from the rest, ascending."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    low, high = np.quantile(xyz, [0.01, 0.99], axis=0)
    extent = float(np.linalg.norm(high - low))
    cell = float(np.clip(CELL_SHARE * extent, *CELL_RANGE))
    at = np.floor((xyz - xyz.min(axis=0)) / cell).astype(np.int64)
    size = at.max(axis=0) + 1
    if float(size[0]) * float(size[1]) * float(size[2]) > 2.0**62:
        at = np.minimum(at, 2**20 - 1)
        size = at.max(axis=0) + 1
    _, cell_of = np.unique((at[:, 0] * size[1] + at[:, 1]) * size[2] + at[:, 2], return_inverse=True)
    count = np.bincount(cell_of)
    middle = np.stack([np.bincount(cell_of, xyz[:, c]) for c in range(3)], axis=1) / count[:, None]
    pair = cKDTree(middle).query_pairs(2 * cell, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pair), np.int8), (pair[:, 0], pair[:, 1])), (count.size, count.size))
    n_pieces, piece = connected_components(graph, directed=False)
    if n_pieces == 1:
        return np.arange(len(xyz))
    weight = np.bincount(piece, count)
    big = weight >= min(STRAY_SHARE * len(xyz), weight.max())
    near, _ = cKDTree(middle[big[piece]]).query(middle)
    far = np.full(n_pieces, np.inf)
    np.minimum.at(far, piece, near)
    stray = far > max(STRAY_GAP * extent, STRAY_CELLS * cell)
    stray[piece[_under(middle, middle[big[piece]])]] = False
    keep = np.flatnonzero(~stray[piece][cell_of])
    if len(keep) < (1 - MOST_STRAY) * len(xyz):
        return np.arange(len(xyz))
    if len(keep) < len(xyz):
        notes.append(f"{len(xyz) - len(keep)} of {len(xyz)} points are strays far from the tree")
    return keep


def _under(places: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Which of `places` lie below `rest`, but for its rim on the map, and not far below, (k,) bool."""
    left, right = np.quantile(rest[:, :2], UNDER_RIM, axis=0)
    low, high = rest[:, 2].min(), rest[:, 2].max()
    inside = ((places[:, :2] >= left) & (places[:, :2] <= right)).all(axis=1)
    return inside & (places[:, 2] < low) & (places[:, 2] > low - UNDER_SHARE * (high - low))


def _stems_above(xyz: np.ndarray, ground: Ground | None) -> tuple[Stems, np.ndarray, float]:
    """Stems, the height of each point above the ground or the foot of the scan, and that of the scan."""
    height = xyz[:, 2] - np.quantile(xyz[:, 2], BOTTOM)
    if ground is not None:
        under = ground.under(xyz)
        height = np.where(np.isfinite(under), xyz[:, 2] - under, height)
    top = float(np.quantile(height, TOP))
    return find_stems(xyz, height, top), height, top


def _remark_lying(xyz: np.ndarray, notes: list[str]) -> None:
    """Say so if several stems stand along another axis than z."""
    for up in ("y", "-y", "x", "-x"):
        turned = _turned(xyz, up)
        stems, height, top = _stems_above(turned, find_ground(turned))
        standing = separate_stems(turned, stems, height, top)
        if (stems.n_points[standing] >= LYING_POINTS).sum() >= LYING_STEMS:
            notes.append(
                f"no stem stands along z, but some do along {up}: if that is up, pass up={up!r} (--up {up})"
            )
            return


def _without_ground(xyz: np.ndarray, ground: Ground, stems: Stems, notes: list[str]) -> np.ndarray:
    """True for the points above the ground; the trunk keeps its points down to it."""
    is_ground = ground.is_ground(xyz)
    if len(stems.centre):
        trunk = np.hypot(*(xyz[:, :2] - stem_foot(xyz, stems.centre[0], stems.spread[0])[:2]).T)
        is_ground &= trunk > GROUND_RADIUS_STEPS * stems.spread[0]
    if is_ground.any():
        notes.append(f"{int(is_ground.sum())} of {len(xyz)} points are ground")
    return ~is_ground


def _one_of_many(
    cloud: Cloud,
    index: np.ndarray,
    xyz: np.ndarray,
    stems: Stems,
    height: np.ndarray,
    base: np.ndarray | None,
    notes: list[str],
) -> np.ndarray:
    """True for the points of the tree that stands at `base`, or of the largest without one."""
    from recon.plots import nearest_tree

    if cloud.tree_id is not None and (cloud.tree_id >= 0).any():
        tree = np.where(_is_numbered(cloud.tree_id), cloud.tree_id, -1)[index].astype(np.int64)
    else:
        tree = nearest_tree(xyz, stems, height)
    number = np.unique(tree[tree >= 0])
    if base is None:
        mine = tree == number[np.argmax([_size(xyz[tree == k]) for k in number])]
        notes.append(f"of {number.size} trees the largest was taken: {int(mine.sum())} of {len(xyz)} points")
        return mine
    away = np.where(tree >= 0, ((xyz - base) ** 2).sum(axis=1), np.inf)
    mine = tree == tree[np.argmin(away)]
    notes.append(
        f"of {number.size} trees the one at the base was taken: {int(mine.sum())} of {len(xyz)} points"
    )
    return mine


def _size(xyz: np.ndarray) -> float:
    """What the largest of several trees has most of: points times height."""
    return len(xyz) * float(np.ptp(np.quantile(xyz[:, 2], [0.02, 0.98])))


def _given_base(cloud: Cloud, xyz: np.ndarray, settings: PrepareSettings, scale: float) -> np.ndarray:
    """The base that the user gave, in the turned and scaled frame."""
    try:
        base = np.asarray(settings.base, np.float64)
    except (TypeError, ValueError):
        base = np.full(3, np.nan)
    if base.shape != (3,) or not np.isfinite(base).all():
        raise InputError(f"base must be three finite numbers, got {settings.base!r}")
    base = _turned((base - cloud.origin)[None], settings.up)[0] * scale
    off = xyz - base
    away = float(np.hypot(np.hypot(off[:, 0], off[:, 1]), off[:, 2]).min())
    if away > max(BASE_SHARE * float(np.ptp(xyz[:, 2])), BASE_AWAY):
        raise InputError(
            f"base is {away:.1f} m from the nearest point: give it in the scan's own coordinates"
        )
    return base


def _base(
    cloud: Cloud,
    xyz: np.ndarray,
    stems: Stems,
    ground: Ground | None,
    settings: PrepareSettings,
    scale: float,
) -> np.ndarray:
    """Foot of the trunk in the turned and scaled frame, (3,)."""
    if settings.base is not None:
        return _given_base(cloud, xyz, settings, scale)
    if len(stems.centre):
        foot = stem_foot(xyz, stems.centre[0], stems.spread[0])
    else:
        foot = _foot_without_stem(xyz)
    if ground is not None:
        foot[2] = ground.near(foot[0], foot[1])
    return np.round(foot, FOOT_DECIMALS)


def _foot_without_stem(xyz: np.ndarray) -> np.ndarray:
    """Foot of a scan in which no stem stands: its lowest points if they are a foot, else below its middle."""
    low, high = xyz[:, 2].min(), xyz[:, 2].max()
    few = np.sort(xyz[:, 2])[min(FOOT_POINTS, len(xyz)) - 1]
    at_foot = xyz[xyz[:, 2] <= max(low + FOOT_SHARE * (high - low), few), :2]
    middle = np.median(at_foot, axis=0)
    if np.median(np.hypot(*(at_foot - middle).T)) > WIDE_FOOT * (high - low):
        middle = np.median(xyz[:, :2], axis=0)
    return np.array([*middle, low])


def _hangs(xyz: np.ndarray, stems: Stems) -> bool:
    """Whether the thickest stem is none but some branches of a scan from the air."""
    if len(stems.centre) == 0 or stems.n_points[0] >= SPARSE_STEM:
        return False
    foot = stem_foot(xyz, stems.centre[0], stems.spread[0])
    ends, starts = np.array([foot[2], stems.centre[0, 2]]) - xyz[:, 2].min()
    tall = float(np.ptp(xyz[:, 2]))
    return bool(ends > HANGING_SHARE * tall or starts > HIGH_SLAB_SHARE * tall)


def _moved(
    cloud: Cloud,
    index: np.ndarray,
    xyz: np.ndarray,
    base: np.ndarray,
    scale: float,
    settings: PrepareSettings,
    notes: list[str],
) -> Cloud:
    """The cloud of the tree alone, with its foot at the origin."""
    origin = _turned(np.asarray(cloud.origin)[None], settings.up)[0] * scale + base
    return replace(cloud.take(index), xyz=xyz - base, origin=origin, notes=(*cloud.notes, *notes), unit="m")
