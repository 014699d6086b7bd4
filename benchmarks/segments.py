"""A skeleton as a plain list of tapered segments, whoever made it."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

UNKNOWN = np.nan


@dataclass(frozen=True, eq=False)
class Segments:
    """Straight pieces of a skeleton.

    Attributes
    ----------
    start, end : (m, 3) float64
        World metres.
    start_radius, end_radius : (m,) float64
        Metres, NaN where unknown.
    parent : (m,) int64
        Row of the segment it grows from, -1 at a root.
    """

    start: np.ndarray
    end: np.ndarray
    start_radius: np.ndarray
    end_radius: np.ndarray
    parent: np.ndarray

    def __len__(self) -> int:
        return len(self.start)

    @property
    def length(self) -> np.ndarray:
        """(m,) metres."""
        return np.linalg.norm(self.end - self.start, axis=1)

    @property
    def volume(self) -> np.ndarray:
        """(m,) cubic metres of each frustum."""
        a, b = self.start_radius, self.end_radius
        return np.pi * self.length * (a * a + a * b + b * b) / 3.0

    def moved(self, offset: Any) -> Segments:
        """The same skeleton, shifted by (3,) metres."""
        shift = np.asarray(offset, float)
        return Segments(self.start + shift, self.end + shift, self.start_radius, self.end_radius, self.parent)


@dataclass(frozen=True, eq=False)
class Samples:
    """Points along a skeleton: ``xyz (k, 3)``, ``radius (k,)`` and the ``length (k,)`` each stands for."""

    xyz: np.ndarray
    radius: np.ndarray
    length: np.ndarray


def sample(segments: Segments, spacing: float) -> Samples:
    """Middles of equal pieces of every segment, none longer than `spacing` metres."""
    length = segments.length
    n = np.maximum(1, np.ceil(length / spacing - 1e-9)).astype(np.int64)
    row = np.repeat(np.arange(len(segments)), n)
    share = (np.arange(len(row)) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[row]
    xyz = segments.start[row] + share[:, None] * (segments.end - segments.start)[row]
    radius = segments.start_radius[row] + share * (segments.end_radius - segments.start_radius)[row]
    return Samples(xyz, radius, (length / n)[row])


def from_nodes(parent: np.ndarray, xyz: np.ndarray, radius: np.ndarray) -> Segments:
    """Segments of nodes (n,) with the row of each one's parent (-1 none) and (n, 3) positions.

    A child much thinner than its parent is a side branch: its segment has the child's radius at both
    ends, as no branch tapers from the trunk's radius to its own within one step.
    """
    parent = np.asarray(parent, np.int64)
    node = np.flatnonzero(parent >= 0)
    before = parent[node]
    start_radius = np.asarray(radius, float)[before]
    end_radius = np.asarray(radius, float)[node]
    is_side = start_radius > SIDE_BRANCH_TAPER * end_radius
    row = np.full(len(parent), -1)
    row[node] = np.arange(len(node))
    xyz = np.asarray(xyz, float)
    return Segments(
        xyz[before], xyz[node], np.where(is_side, end_radius, start_radius), end_radius, row[before]
    )


SIDE_BRANCH_TAPER = 1.5  # parent radius / own radius beyond which a segment is the foot of a side branch


def from_cylinders(table: np.ndarray) -> Segments:
    """Segments of a cylinder table (structured array with x0..z1, r0, r1 and, if there, parent)."""
    names = table.dtype.names or ()
    parent = table["parent"].astype(np.int64) if "parent" in names else np.full(len(table), -1)
    start, end = (np.column_stack([table[f"{a}{k}"] for a in "xyz"]).astype(float) for k in (0, 1))
    return Segments(start, end, table["r0"].astype(float), table["r1"].astype(float), parent)


def from_tree(tree: Any) -> Segments:
    """Segments of a ClusterTree, in world coordinates, as the cylinder table has them."""
    from sapwood.cylinders import cylinder_table

    return from_cylinders(cylinder_table(tree.graph, tree.origin))


def read_cylinders(path: str | Path) -> Segments:
    """Read a CSV with the columns x0,y0,z0,x1,y1,z1,r0,r1 and, if there, parent."""
    return from_cylinders(_read_csv(path))


def read_skeleton_nodes(path: str | Path) -> Segments:
    """Read a CSV of nodes with the columns id,parent,x,y,z,radius; ``#`` begins a remark."""
    table = _read_csv(path)
    row = {int(i): k for k, i in enumerate(table["id"])}
    parent = np.array([row.get(int(p), -1) for p in table["parent"]])
    return from_nodes(parent, np.column_stack([table[a] for a in "xyz"]), table["radius"])


def read_branch_polylines(path: str | Path, scale: float = 1.0) -> Segments:
    """Read a CSV of branches with the columns branch_id,parent_branch,node,x,y,z,radius, scaled."""
    table = _read_csv(path)
    branch = table["branch_id"].astype(np.int64)
    xyz = np.column_stack([table[a] for a in "xyz"]) * scale
    radius = table["radius"] * scale
    end = np.flatnonzero(branch[1:] == branch[:-1]) + 1
    row = np.full(len(branch), -1)
    row[end] = np.arange(len(end))
    parent = row[end - 1]
    last_of = {int(branch[e]): int(row[e]) for e in end}
    first = parent < 0
    parent_branch = table["parent_branch"].astype(np.int64)[end]
    parent[first] = [last_of.get(int(p), -1) for p in parent_branch[first]]
    return Segments(xyz[end - 1], xyz[end], radius[end - 1], radius[end], parent)


def _read_csv(path: str | Path) -> np.ndarray:
    """Structured array of a CSV of numbers with a header."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.reader(line for line in file if line.strip() and not line.startswith("#")))
    header = [name.strip() for name in rows[0]]
    values = np.array([[float(value or "nan") for value in row] for row in rows[1:]], float)
    table = np.empty(len(values), [(name, float) for name in header])
    for k, name in enumerate(header):
        table[name] = values[:, k]
    return table
