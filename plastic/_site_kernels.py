"""Compiled loops of leaf clusters and their light. Arrays in, arrays out; nothing is checked here.

A site is a leaf cluster of one season. The light kernels are in another file: after a change to them touch
this one and :mod:`plastic._plastic_kernels`, or what was compiled from it stays.
"""

import math

import numpy as np
from numba import njit

from plastic._plans import ALIVE, GRAIN, STEP, UNSEEN
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
def _own_sites(a, b, changed, living, out, new):
    """Clusters of a tree that shade each other, and those that are not as before; how many of both."""
    n = 0
    m = 0
    for s in range(a, b):
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
def _box_slopes(boxes, fine):
    """1 / component of each finer direction along the axes of each box, (boxes, 3, 4 N) float32."""
    one = np.float32(1.0)
    slopes = np.empty((boxes.shape[0], 3, fine.shape[1]), np.float32)
    for k in range(boxes.shape[0]):
        for axis in range(3):
            row = 3 + 3 * axis
            a = np.float32(boxes[k, row])
            b = np.float32(boxes[k, row + 1])
            c = np.float32(boxes[k, row + 2])
            for i in range(np.uint64(fine.shape[1])):
                slopes[k, axis, i] = one / (a * fine[0, i] + b * fine[1, i] + c * fine[2, i])
    return slopes


@_jit
def _shade_box(trans, slope0, slope1, slope2, box, px, py, pz):
    """Slab test of one box in every direction; to the bit what the light model's own gives."""
    zero = np.float32(0.0)
    one = np.float32(1.0)
    gamma = np.float32(box[15])
    m0 = np.float32((box[0] - px) * box[3] + (box[1] - py) * box[4] + (box[2] - pz) * box[5])
    m1 = np.float32((box[0] - px) * box[6] + (box[1] - py) * box[7] + (box[2] - pz) * box[8])
    m2 = np.float32((box[0] - px) * box[9] + (box[1] - py) * box[10] + (box[2] - pz) * box[11])
    h0 = np.float32(box[12])
    h1 = np.float32(box[13])
    h2 = np.float32(box[14])
    for i in range(np.uint64(trans.size)):
        mid0 = m0 * slope0[i]
        mid1 = m1 * slope1[i]
        mid2 = m2 * slope2[i]
        half0 = h0 * abs(slope0[i])
        half1 = h1 * abs(slope1[i])
        half2 = h2 * abs(slope2[i])
        near = mid0 - half0
        far = mid0 + half0
        near = mid1 - half1 if mid1 - half1 > near else near
        far = mid1 + half1 if mid1 + half1 < far else far
        near = mid2 - half2 if mid2 - half2 > near else near
        far = mid2 + half2 if mid2 + half2 < far else far
        near = near if near > zero else zero
        trans[i] *= gamma if near <= far else one


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
    cells, finer, cap, hit, pair, trans, sites, fresh, others, new_others, slopes, none, no_boxes = room
    n_own, n_new = 0, 0
    if group > 0:
        n_own, n_new = _own_sites(a, b, work.changed, work.living, sites, fresh)
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
    any_round = any_plane or solids.balls.shape[0] > 0
    balls, boxes, weight, amount, shift = solids.balls, solids.boxes, sky.weight, work.amount, work.shift
    blur, tent, sin_tent = sky.reach[0], sky.reach[1], math.sin(sky.reach[1])
    rise = sin_tent / (1.0 - sin_tent)
    sin_blur, cos_tent = np.float32(math.sin(blur)), np.float32(math.cos(tent))
    concern = 1.0 / (1.0 - sin_tent)
    former, earlier, radius = work.former, work.earlier, plan.radius
    arounds, outside, beyond_trees = work.around, work.outside, work.beyond
    n_shaded, n_solid, n_weighed = 0, 0, 0
    places, sizes, rank, top, mx, my, span = none
    if n_own > 0 and (rules.reshade or n_new > 0):
        packed = _pack_sites(sites, n_own, local, radius, work.translucency)
        places, sizes, rank, top, mx, my, span = _sort_leaves(n_own, packed, sin_tent)
    places2, sizes2, rank2, top2, mx2, my2, span2 = none
    if n_others > 0 and (rules.reshade or n_new_others > 0 or any_moved):
        packed = _pack_sites(others, n_others, center, radius, work.translucency)
        places2, sizes2, rank2, top2, mx2, my2, span2 = _sort_leaves(n_others, packed, sin_tent)
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
            for i in range(np.uint64(finer.size)):
                finer[i] = np.float32(1.0)
            if any_round:
                _shade_obstacles(
                    x, y, z, planes, balls, no_boxes, fine[0], fine[1], fine[2], blur, tent, finer
                )
            for k in range(slopes.shape[0]):
                _shade_box(finer, slopes[k, 0], slopes[k, 1], slopes[k, 2], boxes[k], x, y, z)
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
def make_room(sky, solids, n_sites):
    """Scratch for :func:`light`; what of the obstacles is the same for all sites; and no leaf spheres."""
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
        _box_slopes(solids.boxes, sky.fine),
        _sort_leaves(0, np.empty(0), 0.5),
        np.empty((0, 16)),
    )
