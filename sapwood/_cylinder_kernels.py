"""Compiled loops over chains for the cylinder table. Arrays in, arrays filled; nothing is checked here."""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

WINDOW = 3  # segments of the carrying axis looked at to either side of the foot and of the nearest one
MARCH_STEPS = 32  # samples along a segment between which its way out is looked for
BISECTIONS = 40  # halvings of the sampled interval: 1e-12 of the segment


@_jit
def _above(point, a, b, position, radius):
    """Distance of `point` (3,) above the surface of the cone from node a to b (< 0: inside), and the share of
    the cone's axis at which that is."""
    along = 0.0
    length2 = 0.0
    for axis in range(3):
        edge = position[b, axis] - position[a, axis]
        along += edge * (point[axis] - position[a, axis])
        length2 += edge * edge
    t = 0.0
    if length2 > 0.0:
        t = min(1.0, max(0.0, along / length2))
    distance2 = 0.0
    for axis in range(3):
        gap = point[axis] - position[a, axis] - t * (position[b, axis] - position[a, axis])
        distance2 += gap * gap
    return np.sqrt(distance2) - (radius[a] + t * (radius[b] - radius[a])), t


@_jit
def _depth(point, chain_node, first, last, foot, centre, position, radius):
    """Distance of `point` (3,) above the surface of an axis (< 0: inside), nearest axis node and segment.

    The axis is ``chain_node[first:last]``; only nodes within WINDOW of the indices `foot`, where the branch
    begins, and `centre` are looked at. Of the segment, the index of the node at which it ends.
    """
    best = np.inf
    nearest = centre
    segment = centre
    for about in (centre, foot):
        for k in range(max(first, about - WINDOW), min(last - 1, about + WINDOW)):
            above, t = _above(point, chain_node[k], chain_node[k + 1], position, radius)
            if above < best:
                best = above
                nearest = k + 1 if t > 0.5 else k
                segment = k + 1
        if foot == centre:
            break
    return best, nearest, segment


@_jit
def _way_out(start, end, chain_node, first, last, foot, centre, position, radius, point):
    """Share of the segment (0 to 1) at which it leaves the axis' surface; axis node and segment there.

    1 says that it never leaves. `point` (3,) is scratch space.
    """
    inside_until = 0.0
    for step in range(MARCH_STEPS + 1):
        t = step / MARCH_STEPS
        for axis in range(3):
            point[axis] = start[axis] + t * (end[axis] - start[axis])
        above, nearest, carrying = _depth(point, chain_node, first, last, foot, centre, position, radius)
        if above >= 0.0:
            break
        inside_until = t
        centre = nearest
    else:
        return 1.0, centre, carrying
    low, high = inside_until, t
    for _ in range(BISECTIONS):
        t = 0.5 * (low + high)
        for axis in range(3):
            point[axis] = start[axis] + t * (end[axis] - start[axis])
        above, nearest, segment = _depth(point, chain_node, first, last, foot, centre, position, radius)
        if above >= 0.0:
            high = t
        else:
            low = t
            carrying = segment
    return high, centre, carrying


@_jit
def trim_side_chains(
    chain_order, chain_start, chain_node, home, position, radius, start, start_radius, kept, below
):
    """Move the foot of every side chain to the surface of the axis that carries it.

    chain_order (s,): the side chains, a carrying chain always before the chains it carries.
    home (n, 2): chain and index into chain_node at which each node is a member (not as a foot).
    start (n, 3), start_radius (n,), kept (n,) bool: of the segment that ends at each node; changed.
    below (n,): the node whose segment is next towards the root; where a chain comes out of its carrier,
    changed to the carrier's segment there.
    `home` is changed too: a node inside the carrying axis takes that axis as its home.
    """
    point = np.empty(3)
    for c in chain_order:
        foot = chain_node[chain_start[c]]
        carrier, begin = home[foot, 0], home[foot, 1]
        centre = begin
        first, last = chain_start[carrier], chain_start[carrier + 1]
        for k in range(chain_start[c] + 1, chain_start[c + 1]):
            node = chain_node[k]
            before = chain_node[k - 1]
            share, centre, carrying = _way_out(
                position[before],
                position[node],
                chain_node,
                first,
                last,
                begin,
                centre,
                position,
                radius,
                point,
            )
            if share >= 1.0:
                kept[node] = False
                home[node, 0] = carrier
                home[node, 1] = centre
                continue
            for axis in range(3):
                start[node, axis] += share * (position[node, axis] - start[node, axis])
            start_radius[node] = radius[node]
            if share > 0.0:
                below[node] = chain_node[carrying]
            break
