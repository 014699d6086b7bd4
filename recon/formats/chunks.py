"""What every format reader hands over: blocks of points, and what the file said about itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

CHUNK = 1_000_000  # points a reader holds at a time


@dataclass
class Chunk:
    """A block of points in file order, in world coordinates, with labels still as they were stored.

    Attributes
    ----------
    xyz : (m, 3) float64
        May hold NaN rows; they are dropped, and counted, by :func:`recon.read_cloud`.
    extra : dict of str to (m,) or (m, 3) ndarray
        Any of "color" (m, 3), "intensity", "tree", "wood" and "leaf", raw: what they mean can depend on
        values that come later in the file. Every chunk of a file has the same keys and dtypes.
    """

    xyz: np.ndarray
    extra: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass
class Source:
    """An opened point file.

    Attributes
    ----------
    chunks : iterator of Chunk
        Blocks in file order; reading errors surface while it runs.
    notes : list of str
        Remarks; complete once `chunks` is used up.
    names : dict of str to str
        For each key of :attr:`Chunk.extra` the column it came from.
    epsg, unit
        As in :class:`recon.Cloud`.
    is_geographic : bool
        Whether the file says that its coordinates are degrees.
    n_skipped : int
        Points that the reader itself left out; complete once `chunks` is used up.
    """

    chunks: Iterator[Chunk]
    notes: list[str] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    epsg: int | None = None
    unit: str | None = None
    is_geographic: bool = False
    n_skipped: int = 0
