"""Compiled loops of the transformation. Arrays in, arrays out; nothing is checked here.

The trees of a stand lie one after the other in one set of arrays. Within a tree nodes are ordered by season,
parents before children, and sites (leaf clusters of all seasons) by group. An event is a season of one
or several trees at the same time: :func:`bend`, :func:`place`, the :func:`light` at the sites, :func:`prune`.

What a session keeps from its last run is in ``Work``; a site or a node is worked out again only if something
that it depends on is no longer the same, to the bit. Offsets of clusters and changes of light are rounded to
steps, so that what changes by next to nothing does not change.

After a change to the kernels of sites, of light or of growth touch this file, or what was compiled from it
stays.
"""

import math

import numpy as np
from numba import njit

from plastic._plans import ALIVE, BY_LIGHT, BY_OBSTACLE, SLACK
from plastic._site_kernels import light, make_room, place
from species._growth_kernels import blocked

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath
_jit_fused = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})  # a * b + c in one step


# ---------------------------------------------------------------- bending


@_jit_fused
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


@_jit_fused
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


@_jit_fused
def _is_near(bounds, x, y, z, reach):
    """Whether a ball around an obstacle comes within reach of a point."""
    for k in range(bounds.shape[0]):
        dx, dy, dz = bounds[k, 0] - x, bounds[k, 1] - y, bounds[k, 2] - z
        far = bounds[k, 3] + reach
        if dx * dx + dy * dy + dz * dz <= far * far:
            return True
    return False


@_jit
def _fill_box(a, b, position, length, box):
    """Lowest and highest corner of some nodes, and their longest segment."""
    for axis in range(3):
        box[axis], box[3 + axis] = np.inf, -np.inf
    box[6] = 0.0
    for i in range(a, b):
        for axis in range(3):
            box[axis] = min(box[axis], position[i, axis])
            box[3 + axis] = max(box[3 + axis], position[i, axis])
        box[6] = max(box[6], length[i])


@_jit
def _is_clear(box, planes, bounds):
    """Whether no obstacle comes as near to any node in a box as its segment is long."""
    reach = box[6]
    for k in range(planes.shape[0]):
        away = 0.0
        for axis in range(3):
            slope = planes[k, 3 + axis]
            corner = box[axis] if slope > 0.0 else box[3 + axis]
            away += slope * (corner - planes[k, axis])
        if away <= reach * (1.0 + 1e-9):
            return False
    for k in range(bounds.shape[0]):
        d2 = 0.0
        for axis in range(3):
            gap = max(box[axis] - bounds[k, axis], bounds[k, axis] - box[3 + axis], 0.0)
            d2 += gap * gap
        far = (bounds[k, 3] + reach) * (1.0 + 1e-9)
        if d2 <= far * far:
            return False
    return True


@_jit
def _stays(
    tree, season, rebend, node_first, site_first, news, shifted, boxed, box, position, length, planes, bounds
):
    """Whether all nodes of a tree's season are as in the last run, so that none has to be asked.

    So it is where nothing has changed in the tree so far, nothing fell in the last run, the light in which
    the season grows has the same direction, and no obstacle is near.
    """
    if rebend or news[tree]:
        return False
    for s in range(site_first[tree, season], site_first[tree, season + 1]):
        if shifted[s]:
            return False
    if not boxed[tree, season]:
        a, b = node_first[tree, season], node_first[tree, season + 1]
        _fill_box(a, b, position, length, box[tree, season])
        boxed[tree, season] = True
    return _is_clear(box[tree, season], planes, bounds)


@_jit
def _let_stay(tree, season, node_first, dirty, bent, stirred, affected):
    """A season of which no node has to be asked."""
    if stirred[tree, season]:
        for i in range(node_first[tree, season], node_first[tree, season + 1]):
            dirty[i] = False
        stirred[tree, season] = False
    if bent[tree, season]:
        affected[tree] = True


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
    any_turned = any_dirty = False
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
            news = any_dirty = True
            gx, gy, gz = 0.0, 0.0, 0.0
            if s >= 0:
                by = bending * pull[i]
                gx, gy, gz = by * shift[s, 0], by * shift[s, 1], by * shift[s, 2]
            if turned[p] or gx != 0.0 or gy != 0.0 or gz != 0.0:
                _grow_segment(i, p, turned[p], gx, gy, gz, rest, lean, heading, length, turn, position)
                turned[i] = True
                n_turned += 1
            else:
                position[i, 0] = plan.position[i, 0]
                position[i, 1] = plan.position[i, 1]
                position[i, 2] = plan.position[i, 2]
                turned[i] = False
            valid[i] = True
        if turned[i]:
            affected = any_turned = True
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
    work.bent[tree, season] = any_turned
    work.stirred[tree, season] = any_dirty
    if any_dirty:
        work.boxed[tree, season] = False
    work.counts[3] += n_turned


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
def _has_light(a, b, amount, base, share):
    """Whether no site has less than a share of its light at the analysis."""
    enough = True
    for s in range(a, b):
        enough = enough and amount[s] >= share * base[s]
    return enough


@_jit
def _may_prune(tree, season, pruning, slack, fallen, site_first, amount, base):
    """Whether any branch of a tree's season may have too little light.

    If no site has less than a share of its light, no psi_s(t) is below that share of what it was.
    """
    bar = pruning * slack[tree, season]
    if fallen[tree] or bar > 1.0:
        return True
    return not _has_light(site_first[tree, season + 1], site_first[tree, season + 2], amount, base, bar)


@_jit
def prune(plan, work, rules, tree, season, event):
    """Let branches die whose resources for their length are too small (section 4.4.1).

    From the tips to the root: what falls does not count for what it hung on.
    """
    if not _may_prune(
        tree, season, rules.pruning, plan.slack, work.fallen, plan.site_first, work.amount, plan.amount
    ):
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
    work.boxed[:] = False
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
    room = make_room(sky, solids, plan.radius.size)
    seen = np.empty((0, 0), np.float32)
    slack, fallen, site_first, amount, base = (
        plan.slack,
        work.fallen,
        plan.site_first,
        work.amount,
        plan.amount,
    )
    node_first, length, planes, bounds = plan.node_first, plan.length, solids.planes, solids.bounds
    news, shifted, position, dirty = work.news, work.shifted, work.position, work.dirty
    boxed, box, bent, stirred, affected = work.boxed, work.box, work.bent, work.stirred, work.affected
    changed, moved = work.changed, work.moved
    for e in range(events.first.size - 1):
        for a in range(events.first[e], events.first[e + 1]):
            tree, season = events.tree[a], events.season[a]
            if season == 0:
                light(plan, work, events, sky, solids, rules, seen, tree, 0, e, room)
            if _stays(
                tree,
                season,
                rules.rebend or anew,
                node_first,
                site_first,
                news,
                shifted,
                boxed,
                box,
                position,
                length,
                planes,
                bounds,
            ):
                _let_stay(tree, season, node_first, dirty, bent, stirred, affected)
            else:
                bend(plan, work, solids, rules, tree, season, e)
            if news[tree]:
                place(plan, work, tree, season + 1)
            else:
                for s in range(site_first[tree, season + 1], site_first[tree, season + 2]):
                    changed[s] = False
                    moved[s] = False
        for a in range(events.first[e], events.first[e + 1]):
            tree, season = events.tree[a], events.season[a]
            light(plan, work, events, sky, solids, rules, seen, tree, season + 1, e, room)
        for a in range(events.first[e], events.first[e + 1]):
            tree, season = events.tree[a], events.season[a]
            # asked here too, as to hand over the tuples takes longer than to find that nothing falls
            if _may_prune(tree, season, rules.pruning, slack, fallen, site_first, amount, base):
                prune(plan, work, rules, tree, season, e)


@_jit
def read_nodes(position, death, cause, before, order, out, alive, why):
    """Nodes of one tree in the order in which they came in; dead ones where they were."""
    for k in range(order.size):
        i = order[k]
        alive[i] = death[k] == ALIVE
        why[i] = np.uint8(0) if alive[i] else cause[k]
        for axis in range(3):
            out[i, axis] = position[k, axis] if alive[i] else before[k, axis]
