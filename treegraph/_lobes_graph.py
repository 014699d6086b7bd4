"""The graph of the ``.lobes`` format: parents, positions and radii as small integers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from treegraph import _lobes_bytes as codec
from treegraph.errors import FormatError, TreeError
from treegraph.graph import NO_PARENT

__all__ = [
    "encode_graph",
    "position_exponent",
    "read_parents",
    "read_positions",
    "read_radii",
    "to_grid",
]

COARSEST = 10
"""The coarsest grid of positions has a step of 2**-10 m = 0.98 mm."""
FINEST = 20
FEWEST_STEPS = 512
"""The grid is made finer until the tree reaches as many steps from the origin."""
MAX_STEPS = 1 << 40
"""Coordinates must be below this many steps: a million kilometres on the coarsest grid."""
RADIUS_FINER = 2
"""Small radii have a grid four times as fine as positions."""
RADIUS_BITS = 8
"""Radii of 2**9 steps and more keep 8 bits after the leading one."""
MAX_RADIUS_SHIFT = 31
MAX_RADIUS_CODE = (MAX_RADIUS_SHIFT << RADIUS_BITS) + 511
"""Code of the largest radius, 511 * 2**31 steps."""


def position_exponent(position: NDArray[np.float64]) -> int:
    """Smallest exponent whose grid the tree spans with enough steps, also after rounding to that grid."""
    reach = float(np.abs(position).max())
    exponent = _exponent_for(reach)
    while exponent > COARSEST:
        again = _exponent_for(round(reach * 2.0**exponent) * 2.0**-exponent)
        if again == exponent:
            break
        exponent = again
    return exponent


def _exponent_for(reach: float) -> int:
    for exponent in range(COARSEST, FINEST + 1):
        if reach >= FEWEST_STEPS * 2.0**-exponent:
            return exponent
    return COARSEST


def to_grid(coordinates: NDArray[np.float64], exponent: int, name: str) -> NDArray[np.int64]:
    """Coordinates in metres to the nearest grid steps."""
    bad = np.flatnonzero((np.abs(coordinates) >= np.ldexp(MAX_STEPS - 0.5, -exponent)).any(axis=1))
    if bad.size:
        raise TreeError(
            f"{name} must lie within {MAX_STEPS >> exponent} m of the origin along each axis, "
            f"but {name}[{bad[0]}] is {coordinates[bad[0]]}; {bad.size} of {len(coordinates)} break this. "
            "Move the tree with transform() and put the shift into origin."
        )
    return np.rint(np.ldexp(coordinates, exponent)).astype(np.int64)


def _first_difference(parent: NDArray[np.signedinteger], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Each node's value less its parent's; a root keeps its own."""
    rooted = np.concatenate([values, np.zeros_like(values[:1])])
    return values - rooted[parent]


def encode_graph(
    parent: NDArray[np.int32], grid: NDArray[np.int64], radius: NDArray[np.float64], exponent: int
) -> list[bytes]:
    """Return the sections ``starts``, ``jumps``, ``positions`` and ``radii``."""
    back = np.arange(parent.size) - 1 - parent
    is_start = back > 0
    return [
        codec.pack_bits(is_start),
        codec.pack_planes(back[is_start]),
        codec.pack_planes(codec.zigzag(_position_residual(parent, grid)).T),
        codec.pack_planes(codec.zigzag(_first_difference(parent, _radius_code(radius, exponent)))),
    ]


def _position_residual(parent: NDArray[np.signedinteger], grid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Segments; within a chain the change from the segment before."""
    segment = _first_difference(parent, grid)
    residual = segment.copy()
    chained = np.flatnonzero(parent[1:] == np.arange(len(parent) - 1)) + 1
    residual[chained] -= segment[chained - 1]
    return residual


def _radius_code(radius: NDArray[np.float64], exponent: int) -> NDArray[np.int64]:
    """0 for unknown; else 1 and a number that is linear for thin, logarithmic for thick branches."""
    known = ~np.isnan(radius)
    largest = np.ldexp(511.0, MAX_RADIUS_SHIFT - exponent - RADIUS_FINER)
    bad = np.flatnonzero(known & (radius > largest))
    if bad.size:
        raise TreeError(
            f"radius must be at most {largest:g} m in a .lobes file, but radius[{bad[0]}] is "
            f"{radius[bad[0]]}; {bad.size} of {radius.size} nodes break this"
        )
    steps = np.ldexp(np.where(known, radius, 0.0), exponent + RADIUS_FINER)
    shift = np.maximum(np.frexp(steps)[1].astype(np.int64) - 1 - RADIUS_BITS, 0)
    code = (shift << RADIUS_BITS) + np.rint(np.ldexp(steps, -shift)).astype(np.int64)
    code = np.maximum(code, (steps > 0.0).astype(np.int64))
    return np.where(known, code + 1, 0)


def read_parents(starts: bytes, jumps: bytes, n: int) -> NDArray[np.int64]:
    """Parent of each of n nodes from the bits of those that do not follow theirs, and how far back it is."""
    is_start = codec.unpack_bits(starts, n, "starts")
    start = np.flatnonzero(is_start)
    jump = codec.unpack_planes(jumps, start.size, "jumps")
    bad = np.flatnonzero((jump < 1) | (jump > start))
    if bad.size:
        i = start[bad[0]]
        raise FormatError(
            f"node {i} must go back 1 to {i} nodes to its parent, got {jump[bad[0]]}; the file is damaged"
        )
    parent = np.arange(-1, n - 1)
    parent[start] -= jump
    return parent


def _sum_from_root(parent: NDArray[np.signedinteger], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sum of the values on the path from the root to each node, by doubling the reach of every node.

    O(n log(depth)); overflow wraps and is caught by the caller's check of the range.
    """
    total = np.concatenate([values, np.zeros_like(values[:1])])
    ancestor = np.concatenate([parent, [NO_PARENT]])
    while (ancestor >= 0).any():
        total = total + total[ancestor]
        ancestor = ancestor[ancestor]
    return total[:-1]


def read_positions(raw: bytes, parent: NDArray[np.int64]) -> NDArray[np.int64]:
    """Positions in grid steps."""
    n = parent.size
    residual = codec.unzigzag(codec.unpack_planes(raw, 3 * n, "positions")).reshape(3, n).T
    # Within a chain residuals add up to segments: sum over all nodes, less the sum before the chain.
    total = np.cumsum(residual, axis=0)
    is_start = parent != np.arange(-1, n - 1)
    is_start[0] = True
    start = np.flatnonzero(is_start)[np.cumsum(is_start) - 1]
    segment = total - total[start] + residual[start]
    grid = _sum_from_root(parent, segment)
    bad = np.flatnonzero((np.abs(grid) >= MAX_STEPS).any(axis=1))
    if bad.size:
        raise FormatError(
            f"coordinates must be less than {MAX_STEPS} steps, but node {bad[0]} is at {grid[bad[0]]}; "
            "the file is damaged"
        )
    return grid


def read_radii(raw: bytes, parent: NDArray[np.int64], exponent: int) -> NDArray[np.float64]:
    """Radii in metres; NaN where unknown."""
    change = codec.unzigzag(codec.unpack_planes(raw, parent.size, "radii"))
    code = _sum_from_root(parent, change)
    bad = np.flatnonzero((code < 0) | (code > MAX_RADIUS_CODE + 1))
    if bad.size:
        raise FormatError(
            f"the code of a radius must be 0 to {MAX_RADIUS_CODE + 1}, but node {bad[0]} has {code[bad[0]]}; "
            "the file is damaged"
        )
    code, known = np.maximum(code - 1, 0), code > 0
    shift = np.maximum((code >> RADIUS_BITS) - 1, 0)
    steps = (code - (shift << RADIUS_BITS)) << shift
    return np.where(known, np.ldexp(steps, -exponent - RADIUS_FINER), np.nan)
