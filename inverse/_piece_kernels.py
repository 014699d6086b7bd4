"""Compiled loops that cut a tree into pieces and describe them. Arrays in, arrays out; nothing is checked."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

STRAIGHT = 1e-6  # how far, as a share of the segments, a node that says nothing may lie off the line
LEVEL = 1e-4  # a segment that rises by less, as a share of its height, is taken as level by its logarithm


@_jit
def cut_pieces(parent, position, radius, edge, angle, child_start, child, every_segment):
    """Pieces in depth-first order: parent, length, thickness, bend, joint, ends, and the piece of each node.

    Piece 0 begins at node 0, the root; it has no length if the root is a fork. ``angle`` is that between a
    segment and the one below it.
    """
    n = parent.size
    above, first, last = np.empty(n + 1, np.int32), np.empty(n + 1, np.int32), np.empty(n + 1, np.int32)
    length, thickness, bend, joint = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    piece_of = np.zeros(n, np.int32)
    stack, below = np.empty(n + 1, np.int32), np.empty(n + 1, np.int32)
    m, top = 0, 0
    if child_start[1] - child_start[0] == 1:
        stack[0], below[0] = child[0], -1
        top = 1
    else:
        above[0], first[0], last[0] = -1, 0, 0
        m = 1
        for k in range(child_start[1] - 1, -1, -1):
            stack[top], below[top] = child[k], 0
            top += 1
    while top > 0:
        top -= 1
        i = stack[top]
        before = parent[i]  # the last node that says something
        above[m], first[m], joint[m] = below[top], before, angle[i]
        length[m], piece_of[i] = edge[i], m
        if m == 0:
            thickness[0] = max(0.0, 2.0 * radius[before])
        while not every_segment and child_start[i + 1] - child_start[i] == 1:
            after = child[child_start[i]]
            if not _is_between(position, radius, before, i, after):
                thickness[m] = max(thickness[m], 2.0 * radius[i])
                before = i
            i = after
            length[m] += edge[i]
            bend[m] += angle[i]
            piece_of[i] = m
        thickness[m] = max(thickness[m], 2.0 * radius[i])
        if thickness[m] == 0.0:  # a cone: its mean
            thickness[m] = max(0.0, radius[before])
        last[m] = i
        for k in range(child_start[i + 1] - 1, child_start[i] - 1, -1):
            stack[top], below[top] = child[k], m
            top += 1
        m += 1
    return above[:m], length[:m], thickness[:m], bend[:m], joint[:m], first[:m], last[:m], piece_of


@_jit
def number_pieces(parent, order):
    """Fill ``order``: old index of each new piece, forks first, then tips by forks; return how many forks."""
    m = parent.size
    is_fork = np.zeros(m, np.bool_)
    for i in range(1, m):
        is_fork[parent[i]] = True
    n = 0
    for i in range(m):
        if is_fork[i]:
            order[n] = i
            n += 1
    count = np.zeros(m + 1, np.int64)
    for i in range(1, m):
        if not is_fork[i]:
            count[parent[i] + 1] += 1
    for i in range(m):
        count[i + 1] += count[i]
    if n == 0:
        order[0] = 0
        return 0
    for i in range(1, m):
        if not is_fork[i]:
            order[n + count[parent[i]]] = i
            count[parent[i]] += 1
    return n


@_jit
def _is_between(position, radius, a, i, b):
    """Whether node i has the place and radius that interpolation between a and b gives: it says nothing."""
    near, far = 0.0, 0.0
    for k in range(3):
        near += (position[i, k] - position[a, k]) ** 2
        far += (position[b, k] - position[i, k]) ** 2
    near, far = math.sqrt(near), math.sqrt(far)
    whole = near + far
    if not whole > 0.0:
        return False
    t = near / whole
    off = 0.0
    for k in range(3):
        off += (position[i, k] - (1.0 - t) * position[a, k] - t * position[b, k]) ** 2
    if math.sqrt(off) > STRAIGHT * whole:
        return False
    return abs(radius[i] - (1.0 - t) * radius[a] - t * radius[b]) <= STRAIGHT * max(radius[a], radius[b])


@_jit
def angles_between(parent, chord):
    """Angle of each piece's chord with its parent's and its nearest sibling's; NaN where there is none."""
    m = parent.size
    unit = np.zeros((m, 3))
    known = np.zeros(m, np.bool_)
    for i in range(m):
        size = math.sqrt(chord[i, 0] ** 2 + chord[i, 1] ** 2 + chord[i, 2] ** 2)
        if size > 0.0:
            known[i] = True
            for k in range(3):
                unit[i, k] = chord[i, k] / size
    start = np.zeros(m + 1, np.int64)
    for i in range(1, m):
        start[parent[i] + 1] += 1
    for i in range(m):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    child = np.empty(max(m - 1, 0), np.int32)
    for i in range(1, m):
        child[fill[parent[i]]] = i
        fill[parent[i]] += 1
    to_parent, to_sibling = np.full(m, np.nan), np.full(m, np.nan)
    for p in range(m):
        for k in range(start[p], start[p + 1]):
            i = child[k]
            if not known[i]:
                continue
            if known[p]:
                to_parent[i] = _angle(unit[i], unit[p])
            for q in range(k + 1, start[p + 1]):
                j = child[q]
                if known[j]:
                    between = _angle(unit[i], unit[j])
                    if not to_sibling[i] <= between:
                        to_sibling[i] = between
                    if not to_sibling[j] <= between:
                        to_sibling[j] = between
    return to_parent, to_sibling


@_jit
def _angle(u, v):
    """Angle between two vectors, exact for small ones too."""
    cx, cy, cz = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    return math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


@_jit
def weighted_moments(value, weight):
    """Mean and variance of the values that are known; NaN without any weight."""
    total, mean = 0.0, 0.0
    for i in range(value.size):
        if not math.isnan(value[i]):
            total += weight[i]
            mean += weight[i] * value[i]
    if not total > 0.0:
        return np.nan, np.nan
    mean /= total
    spread = 0.0
    for i in range(value.size):
        if not math.isnan(value[i]):
            spread += weight[i] * (value[i] - mean) ** 2
    return mean, spread / total


@_jit
def mean_logarithm(start, end, weight, least, low, high):
    """Mean of log(height) over the parts of segments between two heights; NaN if there are none.

    Heights below ``least`` count as that.
    """
    total, mean = 0.0, 0.0
    for i in range(weight.size):
        lower, upper = _clip(start[i, 2], end[i, 2], low, high)
        share = weight[i] * (upper - lower)
        if share > 0.0:
            rise = end[i, 2] - start[i, 2]
            h0, h1 = start[i, 2] + lower * rise, start[i, 2] + upper * rise
            mean += share * _log_between(h0, h1, least)
            total += share
    return mean / total if total > 0.0 else np.nan


@_jit
def _log_between(h0, h1, least):
    """Mean of log(max(h, least)) for h from h0 to h1."""
    middle, rise = 0.5 * (h0 + h1), abs(h1 - h0)
    if rise < LEVEL * max(middle, least):
        middle = max(middle, least)
        return math.log(middle) - (rise / middle) ** 2 / 24.0
    return (_log_integral(h1, least) - _log_integral(h0, least)) / (h1 - h0)


@_jit
def _log_integral(h, least):
    """An integral of log(max(h, least))."""
    if h > least:
        return h * math.log(h) - h
    return h * math.log(least) - least


@_jit
def _clip(z0, z1, low, high):
    """Part 0 ... 1 of a segment that lies at low <= z < high; a level one as a whole or not at all."""
    if z0 == z1:
        return (0.0, 1.0) if low <= z0 < high else (0.0, 0.0)
    s, t = (low - z0) / (z1 - z0), (high - z0) / (z1 - z0)
    return max(0.0, min(s, t)), min(1.0, max(s, t))


@_jit
def slab_moments(start, end, weight, low, high):
    """Weight, and weighted sums of x, y, xx, xy, yy, over the parts of segments between two heights."""
    out = np.zeros(6)
    for i in range(weight.size):
        lower, upper = _clip(start[i, 2], end[i, 2], low, high)
        share = weight[i] * (upper - lower)
        if share <= 0.0:
            continue
        dx, dy = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1]
        x0, y0 = start[i, 0] + lower * dx, start[i, 1] + lower * dy
        x1, y1 = start[i, 0] + upper * dx, start[i, 1] + upper * dy
        out[0] += share
        out[1] += share * 0.5 * (x0 + x1)
        out[2] += share * 0.5 * (y0 + y1)
        out[3] += share * (x0 * x0 + x0 * x1 + x1 * x1) / 3.0
        out[4] += share * (2.0 * x0 * y0 + x0 * y1 + x1 * y0 + 2.0 * x1 * y1) / 6.0
        out[5] += share * (y0 * y0 + y0 * y1 + y1 * y1) / 3.0
    return out
