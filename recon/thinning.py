"""Voxel thinning of a stream of points, independent of their order and of how they are blocked."""

from __future__ import annotations

import numpy as np

from recon.formats.chunks import Chunk

FINEST = 2.0**-14  # edge of the finest voxel in units of the file: 0.06 mm in metres
SPARE = 0.25  # share of max_points that is gathered before thinning again
MAX_LEVEL = 150  # voxels of 2^36 units


class Thinner:
    """Gathers chunks and keeps at most `max_points` points, one a voxel.

    The voxels are nested: level k + 1 joins two voxels of level k along z, y and x in turn, and they are
    aligned to the world. The point kept in a voxel is the one with the smallest hash of its coordinates. The smallest of
    the smallest is the smallest of all, and the level only rises when the points seen so far already fill more
    than `max_points` voxels; so the result is that of thinning the whole file at once.

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
        if self._held > self.max_points * (1 + SPARE):
            self._thin()

    def result(self) -> Chunk:
        """The points kept, in the order they came."""
        if self._held > self.max_points:
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
        self.level = max(self.level, 0)
        while True:
            keep = thin_rows(chunk.xyz, self.level)
            if len(keep) <= self.max_points or self.level >= MAX_LEVEL:
                break
            chunk = Chunk(chunk.xyz[keep], {k: v[keep] for k, v in chunk.extra.items()})
            self.level += 1
        if len(keep) < len(chunk.xyz):
            chunk = Chunk(chunk.xyz[keep], {k: v[keep] for k, v in chunk.extra.items()})
        self._parts = [chunk]
        self._held = len(chunk.xyz)


def thin_rows(xyz: np.ndarray, level: int) -> np.ndarray:
    """Rows of the one point kept in each voxel of `level`, ascending."""
    cell = np.empty((len(xyz), 3), np.int64)
    for axis in range(3):
        edge = FINEST * 2.0 ** ((level + axis) // 3)
        np.floor(xyz[:, axis] / edge, out=cell[:, axis], casting="unsafe")
    key = _mix(
        _mix(_mix(cell[:, 0].view(np.uint64)) ^ cell[:, 1].view(np.uint64)) ^ cell[:, 2].view(np.uint64)
    )
    bits = np.ascontiguousarray(xyz).view(np.uint64)
    rank = _mix(_mix(_mix(bits[:, 0]) ^ bits[:, 1]) ^ bits[:, 2])
    order = np.lexsort((rank, key))
    first = np.ones(len(order), bool)
    first[1:] = key[order][1:] != key[order][:-1]
    return np.sort(order[first])


def _mix(x: np.ndarray) -> np.ndarray:
    """SplitMix64's finaliser: 64 bits to 64 well-mixed bits."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
