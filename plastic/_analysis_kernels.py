"""Compiled loops of the analysis. Arrays in, arrays out; nothing is checked here."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath


@_jit
def _edge(parent, position, i):
    """Length of the segment that ends at node i."""
    p = parent[i]
    x = position[i, 0] - position[p, 0]
    y = position[i, 1] - position[p, 1]
    z = position[i, 2] - position[p, 2]
    return math.sqrt(x * x + y * y + z * z)


@_jit
def way_to_branching(parent, position):
    """Way from each node to the nearest branching node or root below it, and which nodes branch."""
    n = parent.size
    count = np.zeros(n, np.int32)
    for i in range(n):
        if parent[i] >= 0:
            count[parent[i]] += 1
    way = np.zeros(n)
    for i in range(n):
        p = parent[i]
        if p >= 0:
            before = 0.0 if count[p] > 1 or parent[p] < 0 else way[p]
            way[i] = before + _edge(parent, position, i)
    return way, count > 1


@_jit
def relative_rates(parent, position, share):
    """Eq. 4.1 from the foot of each segment; 1 at a root."""
    n = parent.size
    reach = np.zeros(n)  # farthest tip from the node
    for i in range(n - 1, -1, -1):
        p = parent[i]
        if p >= 0:
            reach[p] = max(reach[p], reach[i] + _edge(parent, position, i))
    rate = np.ones(n)
    way = np.zeros(n)
    whole = np.zeros(n)
    for i in range(n):
        p = parent[i]
        if p < 0:
            whole[i] = reach[i]
            continue
        length = _edge(parent, position, i)
        whole[i] = whole[p]
        way[i] = way[p] + length
        ahead = reach[i] + length
        left = whole[i] - way[p]
        rate[i] = rate[p]
        if ahead > share * whole[i] and left > 0.0:
            rate[i] = min(ahead / left, 1.0)
    return rate


@_jit
def sum_ages(parent, position, internode, rate):
    """Eq. 4.2 with a quotient."""
    n = parent.size
    age = np.zeros(n)
    for i in range(n):
        p = parent[i]
        if p >= 0:
            age[i] = age[p] + _edge(parent, position, i) / internode / rate[i]
    return age


@_jit
def headings(parent, position):
    """Unit direction and length of each segment; without length that of the parent, up at a root."""
    n = parent.size
    heading = np.zeros((n, 3))
    length = np.zeros(n)
    for i in range(n):
        p = parent[i]
        if p < 0:
            heading[i, 2] = 1.0
            continue
        length[i] = _edge(parent, position, i)
        for k in range(3):
            along = position[i, k] - position[p, k]
            heading[i, k] = along / length[i] if length[i] > 0.0 else heading[p, k]
    return heading, length


@_jit
def invert_tropism(heading, keep, lean, floor, rest):
    """Eq. 4.8 to 4.10: fill ``rest`` with w_s d_o = p h - t_w; ``floor`` (n,) is the least p."""
    for i in range(heading.shape[0]):
        ht = 0.0
        tt = 0.0
        for k in range(3):
            ht += heading[i, k] * lean[i, k]
            tt += lean[i, k] * lean[i, k]
        inside = ht * ht - tt + keep[i] * keep[i]
        p = ht + math.sqrt(inside) if inside > 0.0 else ht
        p = max(p, floor[i])
        for k in range(3):
            rest[i, k] = p * heading[i, k] - lean[i, k]


@_jit
def living_ancestor(parent, birth, season):
    """For each node the nearest of itself and its ancestors that grew up to a season."""
    n = parent.size
    out = np.empty(n, np.int32)
    for i in range(n):
        out[i] = i if birth[i] <= season or parent[i] < 0 else out[parent[i]]
    return out


@_jit
def members_of_cluster(parent, position, is_seed, taken, center, reach, out):
    """Fill ``out`` (n,) with the seeds of a cluster and what follows them within `reach` of its centre.

    ``taken`` marks the seeds of any cluster: what follows a seed of another one belongs to that.
    """
    for i in range(parent.size):
        p = parent[i]
        out[i] = is_seed[i]
        if not out[i] and p >= 0 and out[p] and not taken[i]:
            x = position[i, 0] - center[0]
            y = position[i, 1] - center[1]
            z = position[i, 2] - center[2]
            out[i] = x * x + y * y + z * z <= reach * reach


@_jit
def keep_ends(parent, member):
    """Clear the members that carry another member next to them. In place."""
    inner = np.zeros(parent.size, np.bool_)
    for i in range(parent.size):
        if parent[i] >= 0 and member[i]:
            inner[parent[i]] = True
    for i in range(parent.size):
        if inner[i]:
            member[i] = False
