"""Voxel thinning of a stream of points, independent of their order and of how they are blocked."""

from __future__ import annotations

import numpy as np

from recon.formats.chunks import Chunk

FINEST = 2.0**-14  # edge of the finest voxel in units of the file: 0.06 mm in metres
SPARE = 0.25  # share of max_points that is gathered before thinning again,
SPARE_POINTS = 3_000_000  # and so many more, as each thinning goes over all
MAX_LEVEL = 180  # voxels of 2^46 units, more than any coordinate


class Thinner:
    """Gathers chunks and keeps at most `max_points` points, one a voxel.

    The voxels are nested: level k + 1 joins two voxels of level k along z, y and x in turn, and they are
    aligned to the world. The point kept in a voxel is the one with the smallest hash of its coordinates. The
    smallest of the smallest is the smallest of all, and the level only rises when the points seen so far
    already fill more than `max_points` voxels; so the result is that of thinning the whole file at once.

    Attributes
    ----------
    voxel : float
        Edge of the voxels now (geometric mean of the three), 0 while nothing was thinned.
    """

    def __init__(self, max_points: int) -> None:
        self.max_points = max_points
        self.level = -1
        self._parts: list[Chunk] = []
        self._held = 0

    @property
    def voxel(self) -> float:
        """Mean edge of a voxel, in units of the file."""
        return 0.0 if self.level < 0 else FINEST * 2.0 ** (self.level / 3.0)

    def add(self, chunk: Chunk) -> None:
        """Take in a chunk of finite points."""
        if len(chunk.xyz) == 0 and self._parts:
            return
        self._parts.append(chunk)
        self._held += len(chunk.xyz)
        if self._held > self.max_points * (1 + SPARE) + SPARE_POINTS:
            self._thin()

    def result(self) -> Chunk:
        """The points kept, in the order they came."""
        if self._held > self.max_points or self.level >= 0:
            self._thin()
        return self._join()

    def _join(self) -> Chunk:
        parts = self._parts
        if not parts:
            return Chunk(np.empty((0, 3)))
        if len(parts) > 1:
            keys = parts[0].extra
            joined = Chunk(np.concatenate([p.xyz for p in parts]))
            for key in keys:
                joined.extra[key] = np.concatenate([p.extra[key] for p in parts])
            self._parts = [joined]
        return self._parts[0]

    def _thin(self) -> None:
        chunk = self._join()
        level, keep = thin_rows(chunk.xyz, self.max_points, max(self.level, 0))
        self.level = level
        self._parts = [Chunk(chunk.xyz[keep], {k: v[keep] for k, v in chunk.extra.items()})]
        self._held = len(keep)


def voxel_edges(level: int) -> np.ndarray:
    """Edges (3,) of a voxel of `level`: each level doubles one of them, z first.

    >>> (voxel_edges(4) / FINEST).tolist()
    [2.0, 2.0, 4.0]
    """
    return FINEST * 2.0 ** ((level + np.arange(3)) // 3)


def thin_rows(xyz: np.ndarray, max_points: int, level: int = 0) -> tuple[int, np.ndarray]:
    """The finest voxels, from `level` up, that at most `max_points` of are filled, and the row kept in each.

    Parameters
    ----------
    xyz : (n, 3) float64
        Finite points.
    max_points : int
        Most rows that may be kept, > 0.
    level : int
        Finest level to try.

    Returns
    -------
    level : int
        Level of the voxels.
    keep : (k,) int64 ndarray
        Rows kept, ascending.

    Notes
    -----
    O(n) for each of the levels tried, about eight; 32 to 64 bytes for each of `max_points`.
    """
    low, high = level, MAX_LEVEL
    best = None
    step = 1
    while low < high:  # the number of voxels falls with the level: gallop up, then halve
        middle = min(low + step - 1, high - 1) if best is None else (low + high) // 2
        keep = _one_per_voxel(xyz, middle, max_points)
        if keep is None:
            low = middle + 1
            step *= 2
        else:
            high, best = middle, keep
    if best is None:
        best = _one_per_voxel(xyz, high, max_points)
    if best is None:  # points 10^12 apart; no scan
        best = np.arange(max_points)
    return high, best


def _one_per_voxel(xyz: np.ndarray, level: int, max_points: int) -> np.ndarray | None:
    from recon._thinning_kernels import EMPTY, keep_one_per_voxel

    size = 1 << int(np.ceil(np.log2(1.6 * min(max_points, len(xyz)) + 2)))
    key, best = np.empty(size, np.uint64), np.empty(size, np.uint64)
    row = np.full(size, EMPTY, np.int32 if len(xyz) < 2**31 else np.int64)
    bits = xyz.view(np.uint64)
    if keep_one_per_voxel(xyz, bits, voxel_edges(level), max_points, key, best, row) < 0:
        return None
    return np.sort(row[row != EMPTY]).astype(np.int64)
