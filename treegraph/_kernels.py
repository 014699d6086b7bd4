"""Compiled loops over tree arrays. Arrays in, arrays out; nothing is checked here.

Every loop relies on ``parent[i] < i`` unless it says otherwise: tips to root is one pass backwards,
root to tips one pass forwards.
"""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath


@_jit
def child_lists(parent):
    """Children as CSR: ``child[child_start[i]:child_start[i + 1]]``, ascending. Any node order."""
    n = parent.size
    start = np.zeros(n + 1, np.int64)
    for i in range(n):
        if parent[i] >= 0:
            start[parent[i] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    child = np.empty(start[n], np.int32)
    for i in range(n):
        p = parent[i]
        if p >= 0:
            child[fill[p]] = i
            fill[p] += 1
    return start, child


@_jit
def depth_first(parent, child_start, child, order):
    """Fill ``order`` with the nodes depth-first; return how many a root leads to. Any node order."""
    n = parent.size
    stack = np.empty(n, np.int32)
    reached = 0
    for root in range(n):
        if parent[root] >= 0:
            continue
        stack[0] = root
        top = 1
        while top > 0:
            top -= 1
            node = stack[top]
            order[reached] = node
            reached += 1
            for k in range(child_start[node + 1] - 1, child_start[node] - 1, -1):
                stack[top] = child[k]
                top += 1
    return reached


@_jit
def edge_length(parent, position):
    """Length of the edge from each node to its parent; 0 at a root."""
    n = parent.size
    out = np.zeros(n)
    for i in range(n):
        p = parent[i]
        if p >= 0:
            dx = position[i, 0] - position[p, 0]
            dy = position[i, 1] - position[p, 1]
            dz = position[i, 2] - position[p, 2]
            out[i] = np.sqrt(dx * dx + dy * dy + dz * dz)
    return out


@_jit
def path_length(parent, position):
    """Length of the path from the root to each node."""
    out = edge_length(parent, position)
    for i in range(parent.size):
        p = parent[i]
        if p >= 0:
            out[i] += out[p]
    return out


@_jit
def carried_length(parent, position):
    """Length of all edges in the subtree of each node."""
    n = parent.size
    edge = edge_length(parent, position)
    out = np.zeros(n)
    for i in range(n - 1, -1, -1):
        p = parent[i]
        if p >= 0:
            out[p] += out[i] + edge[i]
    return out


@_jit
def count_tips(parent):
    """Number of tips at or above each node."""
    n = parent.size
    out = np.zeros(n, np.int32)
    for i in range(n - 1, -1, -1):
        if out[i] == 0:
            out[i] = 1
        p = parent[i]
        if p >= 0:
            out[p] += out[i]
    return out


@_jit
def root_of(parent):
    """Index of the root that each node belongs to."""
    n = parent.size
    out = np.empty(n, np.int32)
    for i in range(n):
        p = parent[i]
        out[i] = i if p < 0 else out[p]
    return out
