"""Compiled loops that cut hulls at obstacles. Arrays in, arrays out; nothing is checked here."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath


@_jit
def _enter(ax, ay, az, bx, by, bz, solids):
    """Share of the way from a to b at which it first meets an obstacle; 2 if it does not."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    best = 2.0
    for k in range(solids.planes.shape[0]):
        plane = solids.planes[k]
        gap = (ax - plane[0]) * plane[3] + (ay - plane[1]) * plane[4] + (az - plane[2]) * plane[5]
        toward = -(dx * plane[3] + dy * plane[4] + dz * plane[5])
        if toward > 0.0 and gap < toward * best:
            best = max(gap / toward, 0.0)
    for k in range(solids.balls.shape[0]):
        ball = solids.balls[k]
        ox, oy, oz = ax - ball[0], ay - ball[1], az - ball[2]
        a = dx * dx + dy * dy + dz * dz
        b = ox * dx + oy * dy + oz * dz
        c = ox * ox + oy * oy + oz * oz - ball[3] * ball[3]
        inside = b * b - a * c
        if b < 0.0 and inside > 0.0:
            best = min(best, max((-b - math.sqrt(inside)) / a, 0.0))
    for k in range(solids.boxes.shape[0]):
        box = solids.boxes[k]
        near, far = 0.0, 2.0
        for axis in range(3):
            row = 3 + 3 * axis
            middle = box[row] * (box[0] - ax) + box[row + 1] * (box[1] - ay) + box[row + 2] * (box[2] - az)
            along = box[row] * dx + box[row + 1] * dy + box[row + 2] * dz
            half = box[12 + axis]
            if abs(along) < 1e-300:
                if abs(middle) > half:
                    near = 3.0
                continue
            one, two = (middle - half) / along, (middle + half) / along
            near = max(near, min(one, two))
            far = min(far, max(one, two))
        if near <= far:
            best = min(best, near)
    return best


@_jit
def cut_hull(vertices, seats, solids, short):
    """Move vertices that an obstacle hides from the nearest seat to just before it. In place.

    Ways to the obstacle are shortened by the share `short`. Returns how many vertices moved.
    """
    moved = 0
    for v in range(vertices.shape[0]):
        least = np.inf
        at = 0
        for k in range(seats.shape[0]):
            d2 = 0.0
            for axis in range(3):
                d2 += (vertices[v, axis] - seats[k, axis]) ** 2
            if d2 < least:
                least = d2
                at = k
        ax, ay, az = seats[at, 0], seats[at, 1], seats[at, 2]
        share = _enter(ax, ay, az, vertices[v, 0], vertices[v, 1], vertices[v, 2], solids)
        if share <= 1.0:
            share *= 1.0 - short
            vertices[v, 0] = ax + share * (vertices[v, 0] - ax)
            vertices[v, 1] = ay + share * (vertices[v, 1] - ay)
            vertices[v, 2] = az + share * (vertices[v, 2] - az)
            moved += 1
    return moved
