"""One order for the points of a scan whatever order they came in, and thinning along it."""

from __future__ import annotations

import numpy as np

BITS = 21  # per axis: three fit into one 63-bit number


def morton_order(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Order of points along a Z-order curve through the cube around them.

    Near points come near each other, which makes neighbour searches fast, and the order does not
    depend on that of the input (but for points closer than 2^-21 of the extent on every axis).

    Parameters
    ----------
    xyz : (n, 3) float64
        Finite, metres.

    Returns
    -------
    order : (n,) int64
    code : (n,) int64
        Z-order code of each point, in this order.
    cell : float
        Edge of the finest cell, metres.
    """
    from recon import _skeleton_kernels as kernels

    low = xyz.min(axis=0)
    extent = float((xyz.max(axis=0) - low).max())
    cell = max(extent, 1e-9) / (2**BITS - 1)
    code = kernels.morton_codes(xyz, low, cell)
    order = np.argsort(code, kind="stable")
    return order, code[order], cell


def thin(xyz: np.ndarray, code: np.ndarray, max_points: int) -> tuple[np.ndarray, np.ndarray]:
    """Replace the points of each cell by their mean, with the smallest cells that leave few enough.

    Parameters
    ----------
    xyz : (n, 3) float64
        In the order of `code`.
    code : (n,) int64
        Ascending Z-order codes.
    max_points : int
        > 0.

    Returns
    -------
    thinned : (m, 3) float64
        m <= max_points.
    cell_of : (n,) int64
        Row of `thinned` that each point went into.
    """
    from recon import _skeleton_kernels as kernels

    n = code.size
    if n <= max_points:
        return xyz, np.arange(n)
    shift = 1
    while 1 + np.count_nonzero(np.diff(code >> shift)) > max_points:
        shift += 1
    cell_of = np.concatenate([[0], np.cumsum(np.diff(code >> shift) != 0)])
    mean, _ = kernels.group_means(xyz, cell_of, int(cell_of[-1]) + 1)
    return mean, cell_of
