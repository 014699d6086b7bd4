"""Compiled loops of preparing: arrays in, arrays out; nothing is checked here."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)


@_jit
def cell_lows(xyz, low, cell, shape):
    """Lowest height in each cell of a horizontal grid, inf where there is no point."""
    out = np.full((shape[0], shape[1]), math.inf)
    for k in range(xyz.shape[0]):
        i = int((xyz[k, 0] - low[0]) / cell)
        j = int((xyz[k, 1] - low[1]) / cell)
        if xyz[k, 2] < out[i, j]:
            out[i, j] = xyz[k, 2]
    return out


@_jit
def smooth_patches(lows, step):
    """Label cells so that neighbours whose lows differ by at most `step` share a label; -1 is empty."""
    nx, ny = lows.shape
    label = np.full((nx, ny), -1, np.int32)
    stack_i = np.empty(nx * ny, np.int32)
    stack_j = np.empty(nx * ny, np.int32)
    count = 0
    for i0 in range(nx):
        for j0 in range(ny):
            if label[i0, j0] >= 0 or not math.isfinite(lows[i0, j0]):
                continue
            label[i0, j0] = count
            stack_i[0] = i0
            stack_j[0] = j0
            top = 1
            while top > 0:
                top -= 1
                i = stack_i[top]
                j = stack_j[top]
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        a = i + di
                        b = j + dj
                        if a < 0 or b < 0 or a >= nx or b >= ny or label[a, b] >= 0:
                            continue
                        reach = step * (1.0 if di == 0 or dj == 0 else 1.4142135623730951)
                        if abs(lows[a, b] - lows[i, j]) <= reach:
                            label[a, b] = count
                            stack_i[top] = a
                            stack_j[top] = b
                            top += 1
            count += 1
    return label, count


@_jit
def smoothed(lows, inside):
    """Mean of the lows of the inside cells among the nine around each cell, inf where there are none."""
    nx, ny = lows.shape
    out = np.full((nx, ny), math.inf)
    for i in range(nx):
        for j in range(ny):
            total = 0.0
            n = 0
            for a in range(max(i - 1, 0), min(i + 2, nx)):
                for b in range(max(j - 1, 0), min(j + 2, ny)):
                    if inside[a, b]:
                        total += lows[a, b]
                        n += 1
            if n > 0:
                out[i, j] = total / n
    return out


@_jit
def grid_values(xyz, low, cell, grid):
    """Value of the grid at each point."""
    out = np.empty(xyz.shape[0])
    for k in range(xyz.shape[0]):
        i = min(max(int((xyz[k, 0] - low[0]) / cell), 0), grid.shape[0] - 1)
        j = min(max(int((xyz[k, 1] - low[1]) / cell), 0), grid.shape[1] - 1)
        out[k] = grid[i, j]
    return out


@_jit
def column_cover(z, group, n_groups, low, bin_height, n_bins):
    """Share of the height bins in which each group has a point."""
    seen = np.zeros((n_groups, n_bins), np.bool_)
    for k in range(z.size):
        if group[k] >= 0:
            b = int((z[k] - low) / bin_height)
            if 0 <= b < n_bins:
                seen[group[k], b] = True
    out = np.zeros(n_groups)
    for g in range(n_groups):
        out[g] = seen[g].sum() / n_bins
    return out


@_jit
def steepest(grid):
    """Largest difference of each finite cell from its finite neighbours across an edge, 0 without any."""
    nx, ny = grid.shape
    out = np.zeros((nx, ny))
    for i in range(nx):
        for j in range(ny):
            if not math.isfinite(grid[i, j]):
                continue
            for k in range(4):
                a = i + (1 if k == 0 else -1 if k == 1 else 0)
                b = j + (1 if k == 2 else -1 if k == 3 else 0)
                if 0 <= a < nx and 0 <= b < ny and math.isfinite(grid[a, b]):
                    out[i, j] = max(out[i, j], abs(grid[a, b] - grid[i, j]))
    return out
