"""The copy of a scan that features are computed on: one point per cell of a grid as large as the tree.

Scans have many points near the scanner and few elsewhere, and a hundred times more in one scan than in
another. Cells whose edge is a fixed share of the tree's size even that out: what is seen at all counts, not
how often. The grid is the one neighbour structure of all features. The graph of nearest points, with which
a scan is encoded, would not do: how far it reaches depends on how dense the scan is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from classify._feature import Floats, divided

Ints = NDArray[np.int64]

FINE_CELLS = 64  # cells over the size of the tree
METRIC_EDGE = 0.1  # metres; cells of the copy for shapes at distances in metres
MAX_CELLS = 2000  # of that copy over the size of the tree: larger things are no trees
LEAF_EDGE = 0.016  # metres; cells of the copy for shapes of leaves and twigs
MAX_LEAF_CELLS = 20_000  # the same of that copy
LEAF_CELLS = 500_000  # of more filled ones only those of lowest rank are kept ...
METRIC_CELLS = 1_000_000  # ... which no tree has of the larger kind
QUANTA = 1 << 14  # steps of a coordinate in a cell's edge
PLAN_STEPS = 1 << 16  # steps of a coordinate in the tree's size, for second moments ...
LEAN_STEPS = 1 << 10  # ... and for third ones: 64-bit sums hold 10^8 points
FAR = 2.0  # points farther from the middle than this, in sizes of the tree, are none of its
TOP = 0.998  # quantile of heights: the top of the tree, without strays
WIDE = 0.98  # quantile of distances from the middle
N_PROFILE = 32  # bins of height in which the crown's spread is looked at
CROWN_SPREAD = 0.35  # the crown begins where the spread reaches this share of the largest
TRUNK_PART = (0.02, 0.12)  # of the height: where the trunk's spread is looked at
MIN_BIN = 3  # cells in a bin of height; fewer say nothing


@dataclass(frozen=True, eq=False)
class Grid:
    """A cloud in cells: one row for each filled cell, sorted by cell; m rows.

    Attributes
    ----------
    xyz : (m, 3) float64
        Mean of the points of each cell, metres.
    count : (m,) int64
        Points in it.
    cell : (m, 3) int64
        Place of the cell: that at the anchor is 0, 0, 0.
    edge : float
        Metres.
    rank : (m,) uint64
        A random number of each cell, the same in every scan of a tree in which the cell is filled.
    """

    xyz: Floats
    count: Ints
    cell: Ints
    edge: float
    rank: NDArray[np.uint64]

    @cached_property
    def by_rank(self) -> Ints:
        """Rows in the order of their rank."""
        return np.argsort(self.rank)

    def coarse(self, ratio: int) -> tuple[Ints, int, int]:
        """Codes of cells that are `ratio` times larger, and the strides of their first two axes.

        There is an empty row of cells between any two columns, so that neighbours of codes are neighbours.
        """
        place = self.cell // ratio
        place = place - place.min(axis=0) + 1
        shape = place.max(axis=0) + 2
        stride_x, stride_y = int(shape[1] * shape[2]), int(shape[2])
        return place[:, 0] * stride_x + place[:, 1] * stride_y + place[:, 2], stride_x, stride_y


def make_grid(
    xyz: Floats, low: Floats, high: Floats, edge: float, anchor: Floats, most: int | None = None
) -> Grid:
    """Put points between two corners into cells of which one begins at `anchor`.

    Of more than `most` filled cells those of lowest rank are kept. The result does not depend on the order of
    the points: sums are those of whole numbers.
    """
    from classify import _feature_kernels as kernels

    first = np.floor((low - anchor) / edge)
    shape = (np.floor((high - anchor) / edge) - first + 1.0).astype(np.int64)
    quantum, begin = edge / QUANTA, first * edge + anchor
    most = len(xyz) if most is None else most
    code, sums, rank = kernels.voxel_sums(xyz, begin, edge, shape, quantum, first.astype(np.int64), most)
    order = np.argsort(code)
    code, sums, rank = code[order], sums[order], rank[order]
    mean = sums[:, :3] / sums[:, 3:] * quantum + begin
    rest, k = np.divmod(code, shape[2])
    i, j = np.divmod(rest, shape[1])
    cell = np.stack([i, j, k], axis=1) + first.astype(np.int64)
    return Grid(mean, sums[:, 3].copy(), cell, edge, rank)


@dataclass(frozen=True, eq=False)
class TreeView:
    """A tree's cloud as all groups of features look at it; m cells of the fine grid.

    Attributes
    ----------
    grid : Grid
        Cells of a fixed share of the tree's size.
    metric : Grid
        Cells of a fixed edge.
    leaf : Grid
        The same, far smaller.
    height : float
        Of the top over the foot, metres; 0 where there is none.
    size : float
        The larger of height and width, metres, > 0.
    share : (m,) float64
        Height of each cell's point over that of the tree, 0 to 1.
    """

    grid: Grid
    metric: Grid
    leaf: Grid
    height: float
    size: float
    share: Floats

    @property
    def xyz(self) -> Floats:
        """(m, 3) metres, foot of the trunk at the origin."""
        return self.grid.xyz

    @cached_property
    def profile(self) -> tuple[Ints, Floats, Floats]:
        """Bin of height of each cell, and of each bin the middle (2,) and the spread, metres, NaN if empty.

        The spread is the root mean square distance from the middle.
        """
        row = np.minimum((self.share * N_PROFILE).astype(np.int64), N_PROFILE - 1)
        n = np.bincount(row, minlength=N_PROFILE)
        x, y = self.xyz[:, 0], self.xyz[:, 1]
        some = np.where(n >= MIN_BIN, n, np.nan)
        middle = np.stack([np.bincount(row, v, N_PROFILE) / some for v in (x, y)], axis=1)
        off = (x - middle[row, 0]) ** 2 + (y - middle[row, 1]) ** 2
        return row, middle, np.sqrt(np.bincount(row, off, N_PROFILE) / some)

    @cached_property
    def crown_base(self) -> float:
        """Share of the height at which the crown begins, going down from where it is widest."""
        spread = self.profile[2]
        if np.isnan(spread).all():
            return 0.0
        spread = np.where(np.isnan(spread), 0.0, spread)
        widest = int(spread.argmax())
        least = CROWN_SPREAD * spread[widest]
        thin = np.flatnonzero(spread[:widest] < least)
        if not thin.size:
            return 0.0
        k = int(thin[-1])
        part = (least - spread[k]) / (spread[k + 1] - spread[k])
        return float((k + 0.5 + part) / N_PROFILE)

    @cached_property
    def in_crown(self) -> NDArray[np.bool_]:
        """(m,) whether each cell is above the crown's base."""
        return self.share >= self.crown_base

    @cached_property
    def crown_middle(self) -> Floats:
        """(2,) middle of the crown's cells, seen from above, metres."""
        return self.xyz[self.in_crown, :2].mean(axis=0)

    @cached_property
    def outwards(self) -> tuple[Floats, Floats]:
        """Distance of each cell from the crown's upright axis, metres, and the unit vector (m, 2) there."""
        off = self.xyz[:, :2] - self.crown_middle
        distance = np.hypot(off[:, 0], off[:, 1])
        return distance, divided(off, distance[:, None])

    @cached_property
    def trunk_spread(self) -> float:
        """Diameter of the ring that would spread as the cells of the lower trunk do, metres; may be NaN."""
        low, high = (round(s * N_PROFILE) for s in TRUNK_PART)
        spread = self.profile[2][low:high]
        spread = spread[np.isfinite(spread)]
        return 2.0 * float(np.median(spread)) if spread.size else np.nan


def view_cloud(xyz: Floats) -> TreeView:
    """Look at (n, 3) finite points, n > 0: metres, foot of the trunk at the origin, z up."""
    height = max(float(np.quantile(xyz[:, 2], TOP)), 0.0)
    middle = np.median(xyz, axis=0)  # holds against strays; the mean turns with the tree
    middle, _ = _mean(xyz, middle, _size(xyz, middle, height))
    size = _size(xyz, middle, height)
    xyz, middle = _turned(xyz, middle, size)
    low = np.maximum(xyz.min(axis=0), middle - FAR * size)
    high = np.minimum(xyz.max(axis=0), middle + FAR * size)
    grid = make_grid(xyz, low, high, size / FINE_CELLS, middle)
    metric = make_grid(xyz, low, high, max(METRIC_EDGE, size / MAX_CELLS), middle, METRIC_CELLS)
    leaf = make_grid(xyz, low, high, max(LEAF_EDGE, size / MAX_LEAF_CELLS), middle, LEAF_CELLS)
    share = np.clip(grid.xyz[:, 2] / height, 0.0, 1.0) if height > 0.0 else np.zeros(len(grid.xyz))
    return TreeView(grid, metric, leaf, height, size, share)


def _size(xyz: Floats, middle: Floats, height: float) -> float:
    """Height or width, whichever is more, metres; so much that not all points are strays."""
    size = max(height, _width(xyz, middle), METRIC_EDGE)
    x, y, z = (np.abs(xyz[:, k] - middle[k]) for k in range(3))
    off = np.maximum(np.maximum(x, y), z)
    return size if float(off.min()) < 0.5 * FAR * size else max(size, float(off.max()))


def _width(xyz: Floats, middle: Floats) -> float:
    """Diameter of the circle that holds nearly all points, seen from above, metres."""
    return 2.0 * float(np.quantile(np.hypot(xyz[:, 0] - middle[0], xyz[:, 1] - middle[1]), WIDE))


def _mean(xyz: Floats, middle: Floats, size: float) -> tuple[Floats, float]:
    """Mean (3,) of the points without strays, and the heading of their long side, seen from above."""
    from classify import _feature_kernels as kernels

    step = size / PLAN_STEPS
    n, x, y, z, xx, xy, yy = kernels.plan_moments(xyz, middle, step, FAR * PLAN_STEPS).astype(np.float64)
    if n == 0.0:  # all are far from their middle: a few points in corners
        return np.array(middle, np.float64), 0.0
    heading = 0.5 * np.arctan2(2.0 * (xy - x * y / n), (xx - x * x / n) - (yy - y * y / n))
    return middle + step * np.array([x, y, z]) / n, float(heading)


def _turned(xyz: Floats, middle: Floats, size: float) -> tuple[Floats, Floats]:
    """The points and their middle (3,) with the crown's long side along x and its heavier end ahead.

    Cells of a grid would otherwise lie differently in the same tree under another heading.
    """
    from classify import _feature_kernels as kernels

    _, heading = _mean(xyz, middle, size)
    cos, sin = np.cos(heading), np.sin(heading)
    if kernels.plan_lean(xyz, middle, size / LEAN_STEPS, FAR * LEAN_STEPS, cos, sin) < 0:
        cos, sin = -cos, -sin
    out = xyz.copy()
    out[:, 0] = cos * xyz[:, 0] + sin * xyz[:, 1]
    out[:, 1] = cos * xyz[:, 1] - sin * xyz[:, 0]
    x, y, z = middle
    return out, np.array([cos * x + sin * y, cos * y - sin * x, z])
