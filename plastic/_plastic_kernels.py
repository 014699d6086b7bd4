"""Compiled loops of the transformation. Arrays in, arrays out; nothing is checked here.

The trees of a stand lie one after the other in one set of arrays. Within a tree nodes are ordered by season,
parents before children, and sites (leaf clusters of all seasons) by group. An event is a season of one
or several trees at the same time: :func:`bend`, :func:`place`, the light at the sites, :func:`prune`.

What a session keeps from its last run is in ``Work``; a site or a node is worked out again only if something
that it depends on is no longer the same, to the bit. Offsets of clusters and changes of light are rounded to
steps, so that what changes by next to nothing does not change.

The light kernels are in another file: after a change to them touch this one, or what was compiled from it
stays.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from species._growth_kernels import blocked
from treegraph._light_kernels import (
    BATCH,
    BLOCK,
    CAP_ROWS,
    GROUP,
    LANES,
    LEAF_ROWS,
    SUBCELLS,
    _aligned_room,
    _open_sky,
    _shade_leaves,
    _shade_obstacles,
    _sort_leaves,
    _take_light,
    _weigh,
)

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

ALIVE = np.int32(2**30)
BY_LIGHT, BY_OBSTACLE = np.uint8(1), np.uint8(2)  # what a branch died of
STEP = 1.0 / 1024.0  # changes of light, in its amount and its direction, are multiples of this
GRAIN = 0.25  # offsets of clusters are multiples of this share of their radius
SLACK = 1.0 - 1e-12  # so that rounding prunes nothing at a strength of 1
UNSEEN = 0.25 * STEP  # an obstacle that can take less light than this is not looked at


class Plan(NamedTuple):
    """What does not depend on the surroundings: n nodes and s sites of k trees."""

    node_first: np.ndarray  # (k, seasons + 1) int32: nodes of a tree's season
    site_first: np.ndarray  # (k, seasons + 2) int32: sites of a tree's group; 0 at its end
    parent: np.ndarray  # (n,) int32
    position: np.ndarray  # (n, 3) as it came in
    heading: np.ndarray  # (n, 3) unit direction as it came in
    length: np.ndarray  # (n,)
    rest: np.ndarray  # (n, 3) w_s d_o
    lean: np.ndarray  # (n, 3) (1 - w_s) t in the light of the analysis
    pull: np.ndarray  # (n,) (1 - w_s) times the share of phototropism
    look: np.ndarray  # (n,) int32: site whose light it grows in, or -1
    least: np.ndarray  # (n,) min(psi_ref, min over t of psi_s(t)), m; 0: light never prunes it
    slack: np.ndarray  # (k, seasons) greatest least / psi_s(t) of a tree's season
    center: np.ndarray  # (s, 3)
    radius: np.ndarray  # (s,)
    translucency: np.ndarray  # (s,)
    gain: np.ndarray  # (s,) 2 pi r^2 for each seat
    seat_first: np.ndarray  # (s + 1,) int32
    seat: np.ndarray  # (m,) int32
    amount: np.ndarray  # (s,) light at the analysis
    toward: np.ndarray  # (s, 3) its mean direction, 0 without light
    passed: np.ndarray  # (s, cells) float32: what the clusters of its tree let through; may have no rows
    around: np.ndarray  # (s,) factor of the clusters that contain the site


class Events(NamedTuple):
    """What happens when: an event is one season of some of the trees."""

    first: np.ndarray  # (e + 1,) int32
    tree: np.ndarray  # (a,) int32
    season: np.ndarray  # (a,) int32
    group: np.ndarray  # (e, k) int32: last group of each tree that is there at the end of the event; -1 none
    near_first: np.ndarray  # (k + 1,) int32
    near: np.ndarray  # int32: other trees that can take light from it


class Work(NamedTuple):
    """What comes out, and what a session keeps of it."""

    position: np.ndarray  # (n, 3)
    turn: np.ndarray  # (n, 9) rotation of the segment; read only where `turned`
    turned: np.ndarray  # (n,) bool: not as it came in
    valid: np.ndarray  # (n,) bool: position and turn belong to the last light of its site
    dirty: np.ndarray  # (n,) bool: worked out anew in this run
    death: np.ndarray  # (n,) int32: event, or ALIVE
    cause: np.ndarray  # (n,) uint8
    offset: np.ndarray  # (s, 3) mean of its living seats
    center: np.ndarray  # (s, 3) where it is
    local: np.ndarray  # (s, 3) where it is against the other clusters of its group
    living: np.ndarray  # (s,) int32 seats that live
    translucency: np.ndarray  # (s,)
    changed: np.ndarray  # (s,) bool: for its own tree another cluster than in the last run
    moved: np.ndarray  # (s,) bool: for other trees and obstacles too
    former: np.ndarray  # (s, 3) `local` as it was in the last run
    earlier: np.ndarray  # (s, 3) `center` as it was
    amount: np.ndarray  # (s,)
    shift: np.ndarray  # (s, 3) change of the light's direction
    shifted: np.ndarray  # (s,) bool: it is not that of the last run
    lit: np.ndarray  # (s,) bool: an obstacle took light from it
    passed: np.ndarray  # (s, cells) float32: what its own tree lets through; kept if it has rows
    around: np.ndarray  # (s,)
    beyond: np.ndarray  # (s, cells) float32: what the other trees let through; no rows for a single tree
    outside: np.ndarray  # (s,)
    gathered: np.ndarray  # (n,) scratch
    carried: np.ndarray  # (n,) scratch
    affected: np.ndarray  # (k,) bool: something of the tree is not as it came in
    fallen: np.ndarray  # (k,) bool: a branch died
    news: np.ndarray  # (k,) bool: a node may not be as in the last run, so that clusters have to be looked at
    buried: np.ndarray  # (k,) bool: its foot is inside an obstacle
    counts: np.ndarray  # (4,) int64: sites shaded by clusters, by obstacles, weighed, nodes turned


class Sky(NamedTuple):
    """The cells of the sky and their light."""

    grid: tuple
    fine: np.ndarray
    weight: np.ndarray
    reach: np.ndarray  # (2,) blur and tent, radians
    bright: np.ndarray  # (4,) brightest direction, and the light of a unit of solid angle there


class Solids(NamedTuple):
    """Obstacles as the light kernels want them, and balls around the boxes."""

    planes: np.ndarray
    balls: np.ndarray
    boxes: np.ndarray
    bounds: np.ndarray  # (balls + boxes, 4) centre, radius


class Rules(NamedTuple):
    """Strengths, and what of the last run still holds."""

    bending: float
    pruning: float
    rebend: bool  # all segments whose light differs from the analysis
    reshade: bool  # all sites, by clusters
    relight: bool  # all sites that obstacles reach, or reached
    reweigh: bool  # all sites: the sky is another
    first: bool  # the analysis: light as it is, not as steps from that of the analysis


# ---------------------------------------------------------------- bending


@_jit
def _turn_between(ax, ay, az, bx, by, bz):
    """Rotation that takes one unit vector to another by the shortest way, row by row."""
    c = ax * bx + ay * by + az * bz
    if c < -0.999999:  # straight back: half a turn about any axis across
        x, y, z = 0.0, -az, ay
        if abs(ax) > 0.6:
            x, y, z = az, 0.0, -ax
        k = 2.0 / (x * x + y * y + z * z)
        return (
            k * x * x - 1.0,
            k * x * y,
            k * x * z,
            k * x * y,
            k * y * y - 1.0,
            k * y * z,
            k * x * z,
            k * y * z,
            k * z * z - 1.0,
        )
    vx = ay * bz - az * by
    vy = az * bx - ax * bz
    vz = ax * by - ay * bx
    k = 1.0 / (1.0 + c)
    kx, ky, kz = k * vx, k * vy, k * vz
    return (
        c + kx * vx,
        kx * vy - vz,
        kx * vz + vy,
        kx * vy + vz,
        c + ky * vy,
        ky * vz - vx,
        kx * vz - vy,
        ky * vz + vx,
        c + kz * vz,
    )


@_jit
def _grow_segment(i, p, parent_turned, gx, gy, gz, rest, lean, heading, length, turn, position):
    """Eq. 4.6 for one segment: its rest turned with its parent, and the tropisms as they are now."""
    rx, ry, rz = rest[i, 0], rest[i, 1], rest[i, 2]
    hx, hy, hz = heading[i, 0], heading[i, 1], heading[i, 2]
    p0, p1, p2, p3, p4, p5, p6, p7, p8 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    if parent_turned:
        p0, p1, p2 = turn[p, 0], turn[p, 1], turn[p, 2]
        p3, p4, p5 = turn[p, 3], turn[p, 4], turn[p, 5]
        p6, p7, p8 = turn[p, 6], turn[p, 7], turn[p, 8]
        rx, ry, rz = (
            p0 * rx + p1 * ry + p2 * rz,
            p3 * rx + p4 * ry + p5 * rz,
            p6 * rx + p7 * ry + p8 * rz,
        )
        hx, hy, hz = (
            p0 * hx + p1 * hy + p2 * hz,
            p3 * hx + p4 * hy + p5 * hz,
            p6 * hx + p7 * hy + p8 * hz,
        )
        inverse = 1.0 / math.sqrt(hx * hx + hy * hy + hz * hz)  # or errors would double with every segment
        hx, hy, hz = hx * inverse, hy * inverse, hz * inverse
    bx, by, bz = rx + lean[i, 0] + gx, ry + lean[i, 1] + gy, rz + lean[i, 2] + gz
    size2 = bx * bx + by * by + bz * bz
    if size2 > 1e-18:
        inverse = 1.0 / math.sqrt(size2)
        bx, by, bz = bx * inverse, by * inverse, bz * inverse
    else:
        bx, by, bz = hx, hy, hz
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = _turn_between(hx, hy, hz, bx, by, bz)
    turn[i, 0], turn[i, 1], turn[i, 2] = (
        m0 * p0 + m1 * p3 + m2 * p6,
        m0 * p1 + m1 * p4 + m2 * p7,
        m0 * p2 + m1 * p5 + m2 * p8,
    )
    turn[i, 3], turn[i, 4], turn[i, 5] = (
        m3 * p0 + m4 * p3 + m5 * p6,
        m3 * p1 + m4 * p4 + m5 * p7,
        m3 * p2 + m4 * p5 + m5 * p8,
    )
    turn[i, 6], turn[i, 7], turn[i, 8] = (
        m6 * p0 + m7 * p3 + m8 * p6,
        m6 * p1 + m7 * p4 + m8 * p7,
        m6 * p2 + m7 * p5 + m8 * p8,
    )
    reach = length[i]
    position[i, 0] = position[p, 0] + reach * bx
    position[i, 1] = position[p, 1] + reach * by
    position[i, 2] = position[p, 2] + reach * bz


@_jit
def _is_near(bounds, x, y, z, reach):
    """Whether a ball around an obstacle comes within reach of a point."""
    for k in range(bounds.shape[0]):
        dx, dy, dz = bounds[k, 0] - x, bounds[k, 1] - y, bounds[k, 2] - z
        far = bounds[k, 3] + reach
        if dx * dx + dy * dy + dz * dz <= far * far:
            return True
    return False


@_jit
def bend(plan, work, solids, rules, tree, season, event):
    """Turn the segments of a tree's season; those that would enter an obstacle die with all they carry."""
    parent, look, length, pull = plan.parent, plan.look, plan.length, plan.pull
    position, turned, valid, dirty = work.position, work.turned, work.valid, work.dirty
    death, cause, shift, shifted = work.death, work.cause, work.shift, work.shifted
    planes, bounds = solids.planes, solids.bounds
    rest, lean, heading, turn = plan.rest, plan.lean, plan.heading, work.turn
    any_plane = planes.shape[0] > 0
    rebend, bending = rules.rebend, rules.bending
    affected, news = work.affected[tree], work.news[tree]
    n_turned = 0
    for i in range(plan.node_first[tree, season], plan.node_first[tree, season + 1]):
        p = parent[i]
        if p < 0:
            death[i] = ALIVE
            continue
        s = look[i]
        stale = not valid[i] or dirty[p] or (s >= 0 and (shifted[s] or rebend))
        if death[p] != ALIVE:
            death[i] = death[p]
            cause[i] = cause[p]
            valid[i] = not stale and valid[p]
            dirty[i] = False
            continue
        death[i] = ALIVE
        dirty[i] = stale
        if stale:
            news = True
            gx, gy, gz = 0.0, 0.0, 0.0
            if s >= 0:
                by = bending * pull[i]
                gx, gy, gz = by * shift[s, 0], by * shift[s, 1], by * shift[s, 2]
            if turned[p] or gx != 0.0 or gy != 0.0 or gz != 0.0:
                _grow_segment(i, p, turned[p], gx, gy, gz, rest, lean, heading, length, turn, position)
                turned[i] = True
                affected = True
                n_turned += 1
            else:
                position[i, 0] = plan.position[i, 0]
                position[i, 1] = plan.position[i, 1]
                position[i, 2] = plan.position[i, 2]
                turned[i] = False
            valid[i] = True
        elif turned[i]:
            affected = True
        x, y, z = position[i, 0], position[i, 1], position[i, 2]
        if (any_plane or _is_near(bounds, x, y, z, length[i])) and blocked(
            position[p, 0],
            position[p, 1],
            position[p, 2],
            x,
            y,
            z,
            planes,
            solids.balls,
            solids.boxes,
        ):
            death[i] = event
            cause[i] = BY_OBSTACLE
            affected = news = True
            work.fallen[tree] = True
    work.affected[tree] = affected
    work.news[tree] = news
    work.counts[3] += n_turned


# ---------------------------------------------------------------- leaf clusters


@_jit
def _to_grain(value, grain):
    """The nearest multiple."""
    return grain * math.floor(value / grain + 0.5)


@_jit
def place(plan, work, tree, group):
    """Offset, living seats and translucency (Eq. 4.14) of a tree's clusters of a season.

    Offsets are in steps: those in space, and those against what all clusters have moved on average.
    """
    seat_first, seat, before, home, radius = (
        plan.seat_first,
        plan.seat,
        plan.position,
        plan.center,
        plan.radius,
    )
    position, turned, death, offset = work.position, work.turned, work.death, work.offset
    center, local, former, living = work.center, work.local, work.former, work.living
    earlier = work.earlier
    changed, moved, translucency, affected = work.changed, work.moved, work.translucency, work.affected[tree]
    a, b = plan.site_first[tree, group], plan.site_first[tree, group + 1]
    if not work.news[tree]:
        for s in range(a, b):
            changed[s] = False
            moved[s] = False
        return
    mx, my, mz = 0.0, 0.0, 0.0
    n = 0
    for s in range(a, b):
        count = seat_first[s + 1] - seat_first[s]
        x, y, z = 0.0, 0.0, 0.0
        if affected:
            count = 0
            for k in range(seat_first[s], seat_first[s + 1]):
                i = seat[k]
                if death[i] != ALIVE:
                    continue
                count += 1
                if turned[i]:
                    x += position[i, 0] - before[i, 0]
                    y += position[i, 1] - before[i, 1]
                    z += position[i, 2] - before[i, 2]
        changed[s] = living[s] != count
        if changed[s]:
            seats = seat_first[s + 1] - seat_first[s]
            living[s] = count
            share = count / seats
            translucency[s] = plan.translucency[s] if count == seats else plan.translucency[s] ** share
        if count > 0:
            x, y, z = x / count, y / count, z / count
            mx, my, mz = mx + x, my + y, mz + z
            n += 1
        offset[s, 0], offset[s, 1], offset[s, 2] = x, y, z
    if n > 0:
        mx, my, mz = mx / n, my / n, mz / n
    for s in range(a, b):
        x, y, z = home[s, 0], home[s, 1], home[s, 2]
        cx, cy, cz = x, y, z
        if affected and living[s] > 0:
            grain = GRAIN * radius[s]
            x += _to_grain(offset[s, 0] - mx, grain)
            y += _to_grain(offset[s, 1] - my, grain)
            z += _to_grain(offset[s, 2] - mz, grain)
            cx += _to_grain(offset[s, 0], grain)
            cy += _to_grain(offset[s, 1], grain)
            cz += _to_grain(offset[s, 2], grain)
        moved[s] = changed[s] or not (center[s, 0] == cx and center[s, 1] == cy and center[s, 2] == cz)
        former[s, 0], former[s, 1], former[s, 2] = local[s, 0], local[s, 1], local[s, 2]
        earlier[s, 0], earlier[s, 1], earlier[s, 2] = center[s, 0], center[s, 1], center[s, 2]
        changed[s] = changed[s] or not (local[s, 0] == x and local[s, 1] == y and local[s, 2] == z)
        local[s, 0], local[s, 1], local[s, 2] = x, y, z
        center[s, 0], center[s, 1], center[s, 2] = cx, cy, cz


@_jit
def _own_sites(plan, work, tree, group, out, new):
    """Clusters of a tree that shade each other, and those that are not as before; how many of both."""
    n = 0
    m = 0
    changed, living = work.changed, work.living
    for s in range(plan.site_first[tree, group], plan.site_first[tree, group + 1]):
        if changed[s]:
            new[m] = s
            m += 1
        if living[s] > 0:
            out[n] = s
            n += 1
    return n, m


@_jit
def _other_sites(plan, work, events, event, tree, out, new):
    """Living clusters of other trees that shade those of a tree, and those that are not as before."""
    n = 0
    m = 0
    if event < 0:
        return n, m
    for k in range(events.near_first[tree], events.near_first[tree + 1]):
        other = events.near[k]
        group = events.group[event, other]
        if group < 1:
            continue
        for s in range(plan.site_first[other, group], plan.site_first[other, group + 1]):
            if work.moved[s]:
                new[m] = s
                m += 1
            if work.living[s] > 0:
                out[n] = s
                n += 1
    return n, m


@_jit
def _is_concerned(s, new, n_new, center, former, radius, per_radius, rise):
    """Whether any cluster that is not as before stands, or stood, so that it can shade a site.

    One that is lower than the site by `per_radius` radii and `rise` times the level distance has its blurred
    shadow below the horizon.
    """
    x, y, z = center[s, 0], center[s, 1], center[s, 2]
    for k in range(n_new):
        j = new[k]
        if j == s:
            if center[s, 0] != former[s, 0] or center[s, 1] != former[s, 1] or center[s, 2] != former[s, 2]:
                return True
            continue
        low = z - per_radius * radius[j]
        level = math.hypot(center[j, 0] - x, center[j, 1] - y)
        if center[j, 2] >= low - rise * level:
            return True
        level = math.hypot(former[j, 0] - x, former[j, 1] - y)
        if former[j, 2] >= low - rise * level:
            return True
    return False


@_jit
def _pack_sites(sites, n, center, radius, translucency):
    """Leaf spheres in the blocks that the light kernels take."""
    packed = np.zeros((n + BLOCK - 1) // BLOCK * LEAF_ROWS * BLOCK)
    for k in range(n):
        s = sites[k]
        at = (k // BLOCK) * LEAF_ROWS * BLOCK + k % BLOCK
        packed[at] = center[s, 0]
        packed[at + BLOCK] = center[s, 1]
        packed[at + 2 * BLOCK] = center[s, 2]
        packed[at + 3 * BLOCK] = radius[s]
        packed[at + 4 * BLOCK] = translucency[s]
    return packed


# ---------------------------------------------------------------- light
#
# Functions that are called for every site take arrays, not the tuples that hold them: to hand over a tuple
# is to count the references of all that is in it.


@_jit
def _can_shade(bounds, bright, x, y, z):
    """Whether a ball around any obstacle could take a noticeable share of the light at a point."""
    for k in range(bounds.shape[0]):
        dx, dy, dz = bounds[k, 0] - x, bounds[k, 1] - y, bounds[k, 2] - z
        r = bounds[k, 3]
        d2 = dx * dx + dy * dy + dz * dz
        if d2 <= r * r:
            return True
        if dz + r <= 0.0:
            continue  # all of it is below the horizon
        s2 = r * r / d2
        c = math.sqrt(1.0 - s2)
        toward = (dx * bright[0] + dy * bright[1] + dz * bright[2]) / math.sqrt(d2)
        best = 1.0  # cosine of the least angle between the brightest point and the ball
        if toward < c:
            best = max(0.0, toward * c + math.sqrt(max(0.0, 1.0 - toward * toward) * s2))
        if 2.0 * math.pi * (s2 / (1.0 + c)) * best * best * bright[3] > UNSEEN:
            return True
    return False


@_jit
def _see_past(finer, trans):
    """Multiply what is let through, per cell, by the mean over its finer directions."""
    n = np.uint64(trans.size)
    for i in range(n):
        total = finer[i] + finer[n + i]
        total += finer[np.uint64(2) * n + i] + finer[np.uint64(3) * n + i]
        trans[i] *= total * np.float32(0.25)


@_jit
def _in_steps(value, base):
    """By how much the value differs from the base, as a whole number of steps."""
    return STEP * math.floor((value - base) / STEP + 0.5)


@_jit
def _copy(source, to):
    """Row by element: an assignment of slices would look for overlaps first."""
    for i in range(np.uint64(to.size)):
        to[i] = source[i]


@_jit
def _times(factor, to):
    """Multiply row by element."""
    for i in range(np.uint64(to.size)):
        to[i] *= factor[i]


@_jit
def _read_light(s, weight, trans, around, base_amount, base_toward, amount, shift):
    """Amount and direction at a site, in steps from those of the analysis; whether the direction is new."""
    light, x, y, z = _weigh(weight, trans)
    light *= around
    amount[s] = max(base_amount[s] + _in_steps(light, base_amount[s]), 0.0)
    size = math.sqrt(x * x + y * y + z * z)
    sx, sy, sz = 0.0, 0.0, 0.0
    if size > 0.0 and around > 0.0:
        sx = _in_steps(x / size, base_toward[s, 0])
        sy = _in_steps(y / size, base_toward[s, 1])
        sz = _in_steps(z / size, base_toward[s, 2])
    if sx == shift[s, 0] and sy == shift[s, 1] and sz == shift[s, 2]:
        return False
    shift[s, 0], shift[s, 1], shift[s, 2] = sx, sy, sz
    return True


@_jit
def _first_light(s, weight, trans, around, amount, shift):
    """The same as it is, for the analysis."""
    light, x, y, z = _weigh(weight, trans)
    light *= around
    amount[s] = light
    size = math.sqrt(x * x + y * y + z * z)
    if size > 0.0 and around > 0.0:
        shift[s, 0], shift[s, 1], shift[s, 2] = x / size, y / size, z / size


@_jit
def _shade(
    x,
    y,
    z,
    own,
    places,
    sizes,
    rank,
    top,
    mx,
    my,
    radius,
    sin_blur,
    cos_tent,
    rise,
    cells,
    cap,
    hit,
    pair,
    tile,
    trans,
):
    """What leaf spheres let through at a point, into ``trans``; returns the factor of those around it."""
    n_groups = top.size
    around = 1.0
    if n_groups > 0:
        bar = z - rise * (math.hypot(x - mx, y - my) + radius)
        while n_groups > 0 and top[n_groups - 1] < bar:
            n_groups -= 1
        own = rank[own] if own >= 0 else -1
        m = n_groups * LANES
        around = _shade_leaves(
            x, y, z, m, own, places, sizes, sin_blur, cos_tent, cap, tile, hit, pair, cells
        )
    _take_light(cells, trans)
    return around


@_jit
def light(plan, work, events, sky, solids, rules, seen, tree, group, event, room):
    """Light at the clusters of a tree's group (group 0: at its foot), as far as it is not known already.

    ``seen`` (sites of the group, 4 N) float32 is what meshes let through per finer direction, or has no row.
    ``room`` is scratch, from :func:`make_room`.
    """
    a, b = plan.site_first[tree, group], plan.site_first[tree, group + 1]
    cells, finer, cap, hit, pair, trans, sites, fresh, others, new_others = room
    n_own, n_new = 0, 0
    if group > 0:
        n_own, n_new = _own_sites(plan, work, tree, group, sites, fresh)
    n_others, n_new_others = 0, 0
    any_other = work.beyond.shape[0] > 0
    if any_other:
        row = event if group > 0 else event - 1
        n_others, n_new_others = _other_sites(plan, work, events, row, tree, others, new_others)
    shifted, moved = work.shifted, work.moved
    any_moved = False
    for s in range(a, b):
        shifted[s] = False
        any_moved = any_moved or (group > 0 and moved[s])
    if n_new + n_new_others == 0 and not (any_moved or rules.reshade or rules.relight):
        return
    center, local, lit = work.center, work.local, work.lit
    keep = work.passed.shape[0] > 0
    known = work.passed if keep else plan.passed
    planes, bounds, bright, fine, tile = solids.planes, solids.bounds, sky.bright, sky.fine, sky.grid[3]
    any_plane, any_mesh = planes.shape[0] > 0, seen.shape[0] > 0
    balls, boxes, weight, amount, shift = solids.balls, solids.boxes, sky.weight, work.amount, work.shift
    blur, tent, sin_tent = sky.reach[0], sky.reach[1], math.sin(sky.reach[1])
    rise = sin_tent / (1.0 - sin_tent)
    sin_blur, cos_tent = np.float32(math.sin(blur)), np.float32(math.cos(tent))
    concern = 1.0 / (1.0 - sin_tent)
    former, earlier, radius = work.former, work.earlier, plan.radius
    arounds, outside, beyond_trees = work.around, work.outside, work.beyond
    n_shaded, n_solid, n_weighed = 0, 0, 0
    n = n_own if rules.reshade or n_new > 0 else 0
    packed = _pack_sites(sites, n, local, radius, work.translucency)
    places, sizes, rank, top, mx, my, span = _sort_leaves(n, packed, sin_tent)
    n = n_others if rules.reshade or n_new_others > 0 or any_moved else 0
    packed = _pack_sites(others, n, center, radius, work.translucency)
    places2, sizes2, rank2, top2, mx2, my2, span2 = _sort_leaves(n, packed, sin_tent)
    at = 0
    for s in range(a, b):
        own = -1
        if at < n_own and sites[at] == s:
            own = at
            at += 1
        x, y, z = center[s, 0], center[s, 1], center[s, 2]
        went = group > 0 and moved[s]
        by_own = rules.reshade or (
            n_new > 0 and _is_concerned(s, fresh, n_new, local, former, radius, concern, rise)
        )
        by_others = any_other and (
            rules.reshade
            or went
            or _is_concerned(s, new_others, n_new_others, center, earlier, radius, concern, rise)
        )
        solid = any_plane or any_mesh or _can_shade(bounds, bright, x, y, z)
        by_solids = (rules.relight or went) and (solid or lit[s])
        if not (by_own or by_others or by_solids or rules.reweigh):
            continue
        lit[s] = solid
        n_weighed += 1
        if by_others:
            outside[s] = _shade(
                x,
                y,
                z,
                -1,
                places2,
                sizes2,
                rank2,
                top2,
                mx2,
                my2,
                span2,
                sin_blur,
                cos_tent,
                rise,
                cells,
                cap,
                hit,
                pair,
                tile,
                beyond_trees[s],
            )
        if by_own:
            n_shaded += 1
            arounds[s] = _shade(
                local[s, 0],
                local[s, 1],
                local[s, 2],
                own,
                places,
                sizes,
                rank,
                top,
                mx,
                my,
                span,
                sin_blur,
                cos_tent,
                rise,
                cells,
                cap,
                hit,
                pair,
                tile,
                trans,
            )
            if keep:
                _copy(trans, known[s])
        else:
            _copy(known[s], trans)
        if any_other:
            _times(beyond_trees[s], trans)
        if solid:
            n_solid += 1
            finer[:] = np.float32(1.0)
            _shade_obstacles(x, y, z, planes, balls, boxes, fine[0], fine[1], fine[2], blur, tent, finer)
            _see_past(finer, trans)
        if any_mesh:
            _see_past(seen[s - a], trans)
        around = arounds[s] * outside[s]
        if rules.first:
            _first_light(s, sky.weight, trans, around, work.amount, work.shift)
        else:
            shifted[s] = _read_light(s, weight, trans, around, plan.amount, plan.toward, amount, shift)
    work.counts[0] += n_shaded
    work.counts[1] += n_solid
    work.counts[2] += n_weighed


@_jit
def make_room(sky, n_sites):
    """Scratch for :func:`light`."""
    n_cells = sky.grid[0].size
    return (
        _open_sky(sky.grid),
        np.empty(SUBCELLS * n_cells, np.float32),
        _aligned_room(CAP_ROWS * BATCH),
        np.empty(BATCH, np.uint32),
        np.empty(GROUP * BATCH + GROUP, np.uint16),
        _aligned_room(n_cells),
        np.empty(n_sites, np.int32),
        np.empty(n_sites, np.int32),
        np.empty(n_sites, np.int32),
        np.empty(n_sites, np.int32),
    )


# ---------------------------------------------------------------- pruning


@_jit
def _seat_light(plan, work, tree, season):
    """Each living segment's own resources (Eq. 4.11) and length."""
    length, seat_first, seat = plan.length, plan.seat_first, plan.seat
    gathered, carried = work.gathered, work.carried
    for i in range(plan.node_first[tree, 0], plan.node_first[tree, season + 1]):
        gathered[i] = 0.0
        carried[i] = length[i]
    for s in range(plan.site_first[tree, season + 1], plan.site_first[tree, season + 2]):
        share = plan.gain[s] * work.amount[s]
        for k in range(seat_first[s], seat_first[s + 1]):
            gathered[seat[k]] += share


@_jit
def weigh_branches(plan, work, tree, season):
    """Resources and length of what each living segment carries, itself included."""
    _seat_light(plan, work, tree, season)
    parent, gathered, carried, death = plan.parent, work.gathered, work.carried, work.death
    first = plan.node_first[tree, 0]
    for i in range(plan.node_first[tree, season + 1] - 1, first - 1, -1):
        p = parent[i]
        if p >= 0 and death[i] == ALIVE:
            gathered[p] += gathered[i]
            carried[p] += carried[i]


@_jit
def _cannot_prune(plan, work, rules, tree, season):
    """Whether all sites have so much light that no branch can fall, and none has fallen before.

    If no site has less than a share q of its light at the analysis, no psi_s(t) is below q times what it was.
    """
    if work.fallen[tree]:
        return False
    amount, base = work.amount, plan.amount
    bar = rules.pruning * plan.slack[tree, season]
    for s in range(plan.site_first[tree, season + 1], plan.site_first[tree, season + 2]):
        if amount[s] < bar * base[s]:
            return False
    return bar <= 1.0


@_jit
def prune(plan, work, rules, tree, season, event):
    """Let branches die whose resources for their length are too small (section 4.4.1).

    From the tips to the root: what falls does not count for what it hung on.
    """
    if _cannot_prune(plan, work, rules, tree, season):
        return
    _seat_light(plan, work, tree, season)
    parent, least, death, cause = plan.parent, plan.least, work.death, work.cause
    gathered, carried = work.gathered, work.carried
    strength = SLACK * rules.pruning
    first, last = plan.node_first[tree, 0], plan.node_first[tree, season + 1]
    fell = False
    for i in range(last - 1, first - 1, -1):
        p = parent[i]
        if p < 0 or death[i] != ALIVE:
            continue
        if gathered[i] < strength * least[i] * carried[i]:
            death[i] = event
            cause[i] = BY_LIGHT
            fell = True
        else:
            gathered[p] += gathered[i]
            carried[p] += carried[i]
    if fell:
        work.affected[tree] = True
        work.fallen[tree] = True
        work.news[tree] = True
        for i in range(first, last):
            p = parent[i]
            if p >= 0 and death[i] == ALIVE and death[p] != ALIVE:
                death[i] = death[p]
                cause[i] = cause[p]


@_jit
def least_factors(plan, work, tree, seasons, percent, least, slack):
    """Fill ``least`` with min(psi_ref, min over the seasons of psi_s(t)), 0 where a segment never has leaves.

    psi_ref, which is returned, is the percentile, with linear interpolation, of all psi_s(t) of segments that
    carry leaves. ``slack`` (seasons,) gets the greatest least / psi_s(t) of each season.
    """
    total = 0
    for t in range(seasons):
        total += plan.node_first[tree, t + 1] - plan.node_first[tree, 0]
    values = np.empty(total)
    n = 0
    least[:] = np.inf
    for t in range(seasons):
        weigh_branches(plan, work, tree, t)
        for i in range(plan.node_first[tree, 0], plan.node_first[tree, t + 1]):
            if plan.parent[i] < 0 or work.carried[i] <= 0.0:
                continue
            factor = work.gathered[i] / work.carried[i]
            least[i] = min(least[i], factor)
            if factor > 0.0:
                values[n] = factor
                n += 1
    reference = np.percentile(values[:n], percent) if n > 0 else 0.0
    for i in range(least.size):
        least[i] = min(least[i], reference)
    for t in range(seasons):
        weigh_branches(plan, work, tree, t)
        slack[t] = 0.0
        for i in range(plan.node_first[tree, 0], plan.node_first[tree, t + 1]):
            if plan.parent[i] >= 0 and work.gathered[i] > 0.0:
                slack[t] = max(slack[t], least[i] * work.carried[i] / work.gathered[i])
    return reference


@_jit
def _is_inside(solids, x, y, z):
    """Whether a point is in an obstacle or on its surface."""
    for k in range(solids.planes.shape[0]):
        plane = solids.planes[k]
        if (x - plane[0]) * plane[3] + (y - plane[1]) * plane[4] + (z - plane[2]) * plane[5] <= 0.0:
            return True
    for k in range(solids.balls.shape[0]):
        ball = solids.balls[k]
        if (x - ball[0]) ** 2 + (y - ball[1]) ** 2 + (z - ball[2]) ** 2 <= ball[3] ** 2:
            return True
    for k in range(solids.boxes.shape[0]):
        box = solids.boxes[k]
        inside = True
        for axis in range(3):
            row = 3 + 3 * axis
            away = box[row] * (x - box[0]) + box[row + 1] * (y - box[1]) + box[row + 2] * (z - box[2])
            inside = inside and abs(away) <= box[12 + axis]
        if inside:
            return True
    return False


@_jit
def begin(plan, work, solids):
    """Nothing has changed yet in this run; which trees have a foot in an obstacle."""
    work.affected[:] = False
    for tree in range(work.fallen.size):
        work.news[tree] = work.fallen[tree]  # what died in the last run may live in this one
        work.fallen[tree] = False
    work.counts[:] = 0
    for tree in range(work.buried.size):
        work.buried[tree] = False
        for i in range(plan.node_first[tree, 0], plan.node_first[tree, 1]):
            if plan.parent[i] < 0:
                at = plan.position[i]
                work.buried[tree] |= _is_inside(solids, at[0], at[1], at[2])


@_jit
def reset(plan, work):
    """The tree as it came in, in scratch that another run has left."""
    work.position[:] = plan.position
    work.turned[:] = False
    work.valid[:] = True
    work.dirty[:] = False
    work.cause[:] = 0
    work.center[:] = plan.center
    work.local[:] = plan.center
    work.translucency[:] = plan.translucency
    work.amount[:] = plan.amount
    work.around[:] = plan.around
    work.shift[:] = 0.0
    work.lit[:] = False
    work.fallen[:] = False
    for s in range(work.living.size):
        work.living[s] = plan.seat_first[s + 1] - plan.seat_first[s]


@_jit
def let_die(plan, work, tree, season, nodes, event):
    """Let some segments of a season die with what they carry, as they lead through a surface."""
    for k in range(nodes.size):
        work.death[nodes[k]] = event
        work.cause[nodes[k]] = BY_OBSTACLE
    for i in range(plan.node_first[tree, season], plan.node_first[tree, season + 1]):
        p = plan.parent[i]
        if p >= 0 and work.death[i] == ALIVE and work.death[p] != ALIVE:
            work.death[i] = work.death[p]
            work.cause[i] = work.cause[p]
    work.affected[tree] = True
    work.fallen[tree] = True
    work.news[tree] = True


@_jit
def run(plan, work, events, sky, solids, rules, anew):
    """All events, without meshes; `anew`: from the tree as it came in, whatever the scratch holds."""
    if anew:
        reset(plan, work)
    begin(plan, work, solids)
    room = make_room(sky, plan.radius.size)
    seen = np.empty((0, 0), np.float32)
    for e in range(events.first.size - 1):
        for a in range(events.first[e], events.first[e + 1]):
            tree, season = events.tree[a], events.season[a]
            if season == 0:
                light(plan, work, events, sky, solids, rules, seen, tree, 0, e, room)
            bend(plan, work, solids, rules, tree, season, e)
            place(plan, work, tree, season + 1)
        for a in range(events.first[e], events.first[e + 1]):
            tree, season = events.tree[a], events.season[a]
            light(plan, work, events, sky, solids, rules, seen, tree, season + 1, e, room)
        for a in range(events.first[e], events.first[e + 1]):
            prune(plan, work, rules, events.tree[a], events.season[a], e)


# ---------------------------------------------------------------- hulls


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


@_jit
def read_nodes(position, death, cause, before, order, out, alive, why):
    """Nodes of one tree in the order in which they came in; dead ones where they were."""
    for k in range(order.size):
        i = order[k]
        alive[i] = death[k] == ALIVE
        why[i] = np.uint8(0) if alive[i] else cause[k]
        for axis in range(3):
            out[i, axis] = position[k, axis] if alive[i] else before[k, axis]
