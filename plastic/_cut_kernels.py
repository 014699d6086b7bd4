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
def move_hulls(
    vertex,
    first,
    seats,
    seats_first,
    before,
    position,
    alive,
    turn,
    shift,
    solids,
    short,
    out,
    moved,
):
    """Carry hulls along with their living seats, and move what an obstacle hides from the nearest of these.

    vertex (v, 3), hull c from first[c] on; seats: nodes, those of hull c from seats_first[c] on; before and
    position (n, 3) of all nodes; the scene's frame is x -> turn x + shift. Ways to an obstacle are shortened
    by the share `short`. Writes out (v, 3) and moved (c,): whether an obstacle took something of it. A hull
    without living seats stays as it is.
    """
    any_solid = solids.planes.shape[0] + solids.balls.shape[0] + solids.boxes.shape[0] > 0
    for c in range(first.size - 1):
        count = 0
        offset = np.zeros(3)
        for s in range(seats_first[c], seats_first[c + 1]):
            node = seats[s]
            if alive[node]:
                count += 1
                for axis in range(3):
                    offset[axis] += position[node, axis] - before[node, axis]
        moved[c] = False
        if count:
            offset /= count
        for v in range(first[c], first[c + 1]):
            for axis in range(3):
                out[v, axis] = vertex[v, axis] + offset[axis]
        if count == 0 or not any_solid:
            continue
        living = np.empty((count, 3))
        k = 0
        for s in range(seats_first[c], seats_first[c + 1]):
            if alive[seats[s]]:
                living[k] = position[seats[s]]
                k += 1
        for v in range(first[c], first[c + 1]):
            at = _nearest(living, out[v])
            ax, ay, az = _placed(living[at], turn, shift)
            bx, by, bz = _placed(out[v], turn, shift)
            share = _enter(ax, ay, az, bx, by, bz, solids)
            if share <= 1.0:
                share *= 1.0 - short
                for axis in range(3):
                    out[v, axis] = living[at, axis] + share * (out[v, axis] - living[at, axis])
                moved[c] = True


@_jit
def _nearest(points, place):
    """Row of the point that is nearest to a place; the first of several."""
    least, at = np.inf, 0
    for k in range(points.shape[0]):
        d2 = 0.0
        for axis in range(3):
            d2 += (place[axis] - points[k, axis]) ** 2
        if d2 < least:
            least, at = d2, k
    return at


@_jit
def _placed(place, turn, shift):
    """Where a place of the tree is in the scene."""
    x, y, z = place
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift[0],
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift[1],
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift[2],
    )
