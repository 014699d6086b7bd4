"""The ground in a scan: whether there is any, where it is, and which points are it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CELL = 0.25  # metres; of the grid that the lowest points are looked for in
MAX_CELLS = 4_000_000
COARSER = (2.0, 4.0)  # times larger cells, for a wide scan that shows no ground
WIDE_AREA = 150.0  # m2 of such a scan
STEP = 0.20  # per cell of 0.25 m: neighbouring cells of the ground differ by no more than this, metres
MIN_AREA = 1.5  # a smaller patch of low points is a root, grass or a low branch, m2
MIN_AREA_SHARE = 0.12  # of the area under the tree that a patch must cover to be ground
LOW_SHARE = 0.12  # the middle of the ground lies below this share of the scan's height ...
LOW_SLOPE = 0.5  # ... plus this times the distance from the lowest place
FLAT_AREA = 150.0  # m2; a smaller patch must be flat
FLAT_ROUNDS = 3
FLAT_TOLERANCE = 0.20  # metres from the plane ...
FLAT_SHARE = 0.8  # ... of so many of its cells
MAX_SLOPE = 1.0  # rise over run
BELOW_SHARE = 0.03  # of all cells that may lie below the ground
LOW_CELLS = 0.8  # share of a patch that must be so low
BOTTOM, TOP = 0.001, 0.999  # quantiles of the heights
THICKNESS = 0.12  # points up to this (and a cell's rise) above the ground belong to it, metres


@dataclass(frozen=True, eq=False)
class Ground:
    """Height of the ground on a grid.

    Attributes
    ----------
    height : (nx, ny) float64
        Metres; inf where the scan shows no ground.
    low : (2,) float64
        Corner of the grid.
    cell : float
        Metres.
    """

    height: np.ndarray
    low: np.ndarray
    cell: float

    @property
    def area(self) -> float:
        """Of the known ground, square metres."""
        return float(np.isfinite(self.height).sum()) * self.cell**2

    @property
    def is_wide(self) -> bool:
        """Whether it is more than a strip of cells: three by three of them are known somewhere."""
        from scipy.ndimage import binary_erosion

        return bool(binary_erosion(np.isfinite(self.height), np.ones((3, 3))).any())

    def under(self, xyz: np.ndarray) -> np.ndarray:
        """Height of the ground under each point, inf where none is known, (n,) float64."""
        from recon import _prepare_kernels as kernels

        return kernels.grid_values(xyz, self.low, self.cell, self.height)

    def is_ground(self, xyz: np.ndarray) -> np.ndarray:
        """True for points of the ground, (n,) bool."""
        from recon import _prepare_kernels as kernels

        rise = np.minimum(kernels.steepest(self.height), STEP * self.cell / CELL)
        top = np.where(np.isfinite(self.height), self.height + THICKNESS + rise, -np.inf)
        return xyz[:, 2] < kernels.grid_values(xyz, self.low, self.cell, top)

    def near(self, x: float, y: float) -> float:
        """Height of the ground at the known cell nearest to a place."""
        known = np.argwhere(np.isfinite(self.height))
        middle = self.low + (known + 0.5) * self.cell
        nearest = known[np.argmin(np.hypot(middle[:, 0] - x, middle[:, 1] - y))]
        return float(self.height[tuple(nearest)])


def find_ground(xyz: np.ndarray) -> Ground | None:
    """Find the ground in a scan, if any is there.

    The lowest points of neighbouring grid cells are joined where they differ little. The ground is
    the patches so made that lie at the bottom of the scan and are wider than the foot of a tree.

    Parameters
    ----------
    xyz : (n, 3) float64
        Metres, z up.

    Returns
    -------
    Ground or None
    """
    size = np.ptp(xyz[:, :2], axis=0)
    cell = max(CELL, float(np.sqrt(size[0] * size[1] / MAX_CELLS)))
    ground = _ground_on(xyz, cell)
    if ground is None and size[0] * size[1] >= WIDE_AREA:  # a ground hit too seldom for small cells
        found = [g for g in (_ground_on(xyz, times * cell) for times in COARSER) if g is not None]
        return max(found, key=lambda g: g.area, default=None)
    return ground


def _ground_on(xyz: np.ndarray, cell: float) -> Ground | None:
    """The ground on a grid of cells of this size, if it shows there."""
    from recon import _prepare_kernels as kernels

    low = xyz[:, :2].min(axis=0)
    size = xyz[:, :2].max(axis=0) - low
    step = STEP * cell / CELL
    shape = np.floor(size / cell).astype(np.int64) + 1
    lows = kernels.cell_lows(xyz, low, cell, shape)
    label, count = kernels.smooth_patches(lows, step)
    filled = label >= 0
    n_cells = np.bincount(label[filled], minlength=count)
    bottom = float(np.quantile(xyz[:, 2], BOTTOM))
    height = float(np.quantile(xyz[:, 2], TOP)) - bottom
    cell_i, cell_j = np.nonzero(filled)
    lowest = np.argmin(np.where(filled, lows, np.inf))
    away = cell * np.hypot(cell_i - lowest // shape[1], cell_j - lowest % shape[1])
    is_low = lows[filled] < bottom + LOW_SHARE * height + LOW_SLOPE * away
    low_share = np.bincount(label[filled], is_low, minlength=count) / np.maximum(n_cells, 1)
    fewest = max(MIN_AREA / cell**2, MIN_AREA_SHARE * filled.sum())
    ground = (n_cells >= fewest) & (low_share > LOW_CELLS)
    if not ground.any():
        return None
    inside = np.zeros(lows.shape, bool)
    inside[filled] = ground[label[filled]]
    if inside.sum() * cell**2 < FLAT_AREA and not _is_flat(lows, inside, cell):
        return None
    return Ground(kernels.smoothed(lows, inside), low, cell)


def _is_flat(lows: np.ndarray, inside: np.ndarray, cell: float) -> bool:
    """Whether the lows of the inside cells lie near a plane that is not steep, with hardly a low below.

    The underside of a crown is smooth, too, but a cone or a bowl.
    """
    i, j = np.nonzero(inside)
    design = np.stack([np.ones(i.size), i * cell, j * cell], axis=1)
    keep = np.ones(i.size, bool)
    for _ in range(FLAT_ROUNDS):
        plane, *_ = np.linalg.lstsq(design[keep], lows[i, j][keep], rcond=None)
        off = lows[i, j] - design @ plane
        keep = np.abs(off) <= max(FLAT_TOLERANCE, 2 * float(np.median(np.abs(off))))
    if np.hypot(plane[1], plane[2]) > MAX_SLOPE or np.mean(np.abs(off) <= FLAT_TOLERANCE) < FLAT_SHARE:
        return False
    a, b = np.nonzero(np.isfinite(lows))
    below = lows[a, b] < plane[0] + plane[1] * a * cell + plane[2] * b * cell - 2 * FLAT_TOLERANCE
    return bool(below.mean() < BELOW_SHARE)
