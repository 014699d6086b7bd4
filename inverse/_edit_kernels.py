"""Compiled loops of the edit distances. Arrays in, arrays out; nothing is checked here.

A tree is given as pieces, parents first. Its **forks** (pieces with children) are numbered first, in
depth-first order, so that those above a fork follow it; then come the **tips** (pieces without), in the order
of the forks that carry them, so that those above a fork follow each other too. Tips are counted from 0.

A **run** is the way from a piece to one above it, both included: what a piece becomes when it is joined with
a child, and that with one of its own. Mapping run u of one tree onto run v of the other saves

    gain(u, v) = cost(u) + cost(v) - assign(J(u), J(v)),

where cost is that of removing the pieces one by one and J joins them. The edit distance is the cost of
removing both trees less the most that can be saved; see :mod:`inverse.structure`. All here is written in
savings, which makes what lies beside a run drop out: it is removed in any case.

All of it is in one file, as the compiled cache of a function does not see changes in another file. The
constants of Eq. 4 are in another: after a change to them touch this file, or what was compiled from it stays.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from inverse.comparing import ANGLE_RESOLUTION, SHARE, STRAIGHT_RESOLUTION

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath
_inline = njit(cache=True, error_model="numpy", nogil=True, forceinline=True)  # a call would cost more

ONE_OF_THREE = (1.0 / 3.0) ** 0.4  # dissimilarity if one of the three differences is 1 and the others are 0

# A fast exponential of -u, for 0 <= u <= FAR: (1 - v + v^2/2 ...)^(2^10) with v = u / 2^10.
FAR = 40.0
SCALE = 1.0 / 1024.0
# First guess of x^0.4 from the bits of x: they are nearly its logarithm.
ROOT_SHIFT = 0.6 * (1023.0 - 0.0450465) * 2.0**52
TINY = 1e-60


class EditTree(NamedTuple):
    """A tree as the structural distance reads it; m pieces, k forks, r runs between forks, s up to tips."""

    child_start: np.ndarray  # (m + 1,) int64
    child: np.ndarray  # (m - 1,) int32
    length: np.ndarray  # (m,)
    thickness: np.ndarray
    slope: np.ndarray
    straight: np.ndarray
    bend: np.ndarray
    cost: np.ndarray  # (m,) of removing the piece
    whole: np.ndarray  # (m,) of removing it and all above
    place: np.ndarray  # (k + 1, 4) int64: whole numbers of each fork, columns SIZE to TIP_RUNS
    above: np.ndarray  # (k, 3): what is above each fork, columns REACH to THICKEST
    fork_runs: (
        np.ndarray
    )  # (r, 6): columns LENGTH to STRAIGHT; the run from fork a up to b is in row place[a, RUNS] + b
    tip_runs: np.ndarray  # (s, 6): the run from fork a up to tip t is in row place[a, TIP_RUNS] + t


SIZE, RUNS, FIRST_TIP, TIP_RUNS = range(4)
REACH, PATH, THICKEST = range(3)  # longest way, largest cost of a way, thickest piece; its own not counted
LENGTH, THICKNESS, BEND, COST, SLOPE, STRAIGHT = range(6)  # columns of the runs


@_jit
def _slope(dx, dy, dz):
    """Angle of a chord with the horizontal plane; 0 without a chord."""
    flat = math.sqrt(dx * dx + dy * dy)
    return math.atan2(dz, flat) if flat > 0.0 or dz != 0.0 else 0.0


@_jit
def _straight(dx, dy, dz, length):
    """Chord over length, 1 where there is no length."""
    return min(1.0, math.sqrt(dx * dx + dy * dy + dz * dz) / length) if length > 0.0 else 1.0


@_jit
def _extend(below, length, thickness, bend, cost, start, end, out):
    """Fill ``out``: the run ``below`` joined with one more piece."""
    out[LENGTH] = below[LENGTH] + length
    out[THICKNESS] = max(below[THICKNESS], thickness)
    out[BEND] = below[BEND] + bend
    out[COST] = below[COST] + cost
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    out[SLOPE] = _slope(dx, dy, dz)
    out[STRAIGHT] = _straight(dx, dy, dz, out[LENGTH])


@_jit
def count_runs(parent):
    """Number of runs of a tree: of each piece as many as lie on its way to the root."""
    depth = np.ones(parent.size, np.int64)
    total = 1
    for i in range(1, parent.size):
        depth[i] = depth[parent[i]] + 1
        total += depth[i]
    return total


@_jit
def cost_of_thinnest(length, thickness, wanted):
    """Cost of so many metres of the first pieces."""
    cost = 0.0
    for i in range(length.size):
        if wanted <= length[i]:
            return cost + wanted * thickness[i]
        wanted -= length[i]
        cost += length[i] * thickness[i]
    return cost


@_jit
def label_runs(parent, foot, head, out):
    """Fill ``out`` with the number of the run to which each piece belongs; the others are left."""
    for k in range(foot.size):
        i = head[k]
        out[i] = k
        while i != foot[k]:
            i = parent[i]
            out[i] = k


@_jit
def _list_children(parent):
    """Children as CSR; parents come first."""
    m = parent.size
    start = np.zeros(m + 1, np.int64)
    for i in range(1, m):
        start[parent[i] + 1] += 1
    for i in range(m):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    child = np.empty(m - 1, np.int32)
    for i in range(1, m):
        child[fill[parent[i]]] = i
        fill[parent[i]] += 1
    return start, child


@_jit
def _place_forks(k, parent):
    """The columns SIZE to TIP_RUNS of the forks, and how many runs there are."""
    place = np.zeros((k + 1, 4), np.int64)
    for i in range(parent.size - 1, 0, -1):
        if i < k:
            place[i, SIZE] += 1
            place[parent[i], SIZE] += place[i, SIZE]
        else:
            place[parent[i] + 1, FIRST_TIP] += 1
    if k > 0:
        place[0, SIZE] += 1
    for a in range(k):
        place[a + 1, FIRST_TIP] += place[a, FIRST_TIP]
    n_runs, n_tip_runs = 0, 0
    for a in range(k):
        place[a, RUNS] = n_runs - a
        place[a, TIP_RUNS] = n_tip_runs - place[a, FIRST_TIP]
        n_runs += place[a, SIZE]
        n_tip_runs += place[a + place[a, SIZE], FIRST_TIP] - place[a, FIRST_TIP]
    return place, n_runs, n_tip_runs


@_jit
def _look_above(k, parent, length, thickness, cost):
    """The columns REACH to THICKEST of the forks."""
    above = np.zeros((k, 3))
    for i in range(parent.size - 1, 0, -1):
        far, most, thick = length[i], cost[i], thickness[i]
        if i < k:
            far, most, thick = far + above[i, REACH], most + above[i, PATH], max(thick, above[i, THICKEST])
        below = above[parent[i]]
        below[REACH], below[PATH], below[THICKEST] = (
            max(below[REACH], far), max(below[PATH], most), max(below[THICKEST], thick),
        )  # fmt: skip
    return above


@_jit
def make_tree(k, parent, length, thickness, bend, joint, start, end):
    """The arrays of an :class:`EditTree`; see :class:`inverse.Pieces`."""
    m = parent.size
    cost = length * thickness
    whole = cost.copy()
    for i in range(m - 1, 0, -1):
        whole[parent[i]] += whole[i]
    slope, straight = np.empty(m), np.empty(m)
    for i in range(m):
        dx, dy, dz = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1], end[i, 2] - start[i, 2]
        slope[i] = _slope(dx, dy, dz)
        straight[i] = _straight(dx, dy, dz, length[i])
    child_start, child = _list_children(parent)
    place, n_runs, n_tip_runs = _place_forks(k, parent)
    fork_runs, tip_runs = np.empty((n_runs, 6)), np.empty((n_tip_runs, 6))
    for a in range(k):
        own, first = fork_runs[place[a, RUNS] + a], place[a, RUNS]
        own[LENGTH], own[THICKNESS], own[BEND], own[COST] = length[a], thickness[a], bend[a], cost[a]
        own[SLOPE], own[STRAIGHT] = slope[a], straight[a]
        for b in range(a + 1, a + place[a, SIZE]):
            _extend(
                fork_runs[first + parent[b]], length[b], thickness[b], joint[b] + bend[b], cost[b], start[a],
                end[b], fork_runs[first + b],
            )  # fmt: skip
        for t in range(place[a, FIRST_TIP], place[a + place[a, SIZE], FIRST_TIP]):
            i = k + t
            _extend(
                fork_runs[first + parent[i]], length[i], thickness[i], joint[i] + bend[i], cost[i], start[a],
                end[i], tip_runs[place[a, TIP_RUNS] + t],
            )  # fmt: skip
    return EditTree(
        child_start, child, length, thickness, slope, straight, bend, cost, whole, place,
        _look_above(k, parent, length, thickness, cost), fork_runs, tip_runs,
    )  # fmt: skip


@_jit
def _difference(x, y, resolution):
    """Eq. 4 with a least sigma."""
    sigma = max(SHARE * min(abs(x), abs(y)), resolution)
    d = (x - y) / sigma
    return 1.0 - math.exp(-0.5 * d * d)


@_inline
def _least_difference(x, y, resolution):
    """A lower bound of :func:`_difference` without an exponential: exp(-u) <= 1 / (1 + u + u^2 / 2)."""
    sigma = max(SHARE * min(abs(x), abs(y)), resolution)
    n, q = 0.5 * (x - y) * (x - y), sigma * sigma
    v = n * q + 0.5 * n * n
    return v / (q * q + v)


@_inline
def _bend_difference(x, y):
    """Numerator and denominator of :func:`_least_difference` of two bends, which are never negative."""
    sigma = SHARE * (x if x < y else y)
    sigma = sigma if sigma > ANGLE_RESOLUTION else ANGLE_RESOLUTION
    n, q = 0.5 * (x - y) * (x - y), sigma * sigma
    v = n * (q + 0.5 * n)
    return v, q * q + v


@_jit
def dissimilarity(slope_1, straight_1, bend_1, slope_2, straight_2, bend_2):
    """s of appendix B: Minkowski mean of order 2.5 of the three differences."""
    x = _difference(slope_1, slope_2, ANGLE_RESOLUTION)
    y = _difference(straight_1, straight_2, STRAIGHT_RESOLUTION)
    z = _difference(bend_1, bend_2, ANGLE_RESOLUTION)
    return ((x * x * math.sqrt(x) + y * y * math.sqrt(y) + z * z * math.sqrt(z)) / 3.0) ** 0.4


@_inline
def _fast_power(x, y, resolution):
    """The difference of Eq. 4 to the power 2.5, in a form that compiles to vector instructions."""
    ax = x if x > 0.0 else -x
    ay = y if y > 0.0 else -y
    sigma = SHARE * (ax if ax < ay else ay)
    sigma = sigma if sigma > resolution else resolution
    d = (x - y) / sigma
    v = (0.5 * SCALE) * d * d
    v = v if v < FAR * SCALE else FAR * SCALE
    e = 1.0 - v * (1.0 - v * (1.0 / 2.0) * (1.0 - v * (1.0 / 3.0) * (1.0 - v * (1.0 / 4.0) * (
        1.0 - v * (1.0 / 5.0) * (1.0 - v * (1.0 / 6.0) * (1.0 - v * (1.0 / 7.0)))))))  # fmt: skip
    for _ in range(10):
        e *= e
    q = 1.0 - e
    q = q if q > 0.0 else 0.0
    return q * q * math.sqrt(q)


@_jit
def dissimilarity_row(slope, straight, bend, tree, power, power_bits, out, out_bits):
    """Fill ``out``: :func:`dissimilarity` of one piece and every piece of a tree, to 1e-11.

    ``power`` is room; ``power_bits`` and ``out_bits`` are the same memory read as whole numbers.
    """
    m = out.size
    for i in range(m):
        x = _fast_power(slope, tree.slope[i], ANGLE_RESOLUTION)
        y = _fast_power(straight, tree.straight[i], STRAIGHT_RESOLUTION)
        z = _fast_power(bend, tree.bend[i], ANGLE_RESOLUTION)
        power[i] = (x + y + z) * (1.0 / 3.0)
    for i in range(m):
        out_bits[i] = np.int64(power_bits[i] * 0.4 + ROOT_SHIFT)
    for i in range(m):
        square = power[i] * power[i]
        s = out[i]
        s5 = s * s * s * s * s
        s = s * (2.0 * s5 + 3.0 * square) / (3.0 * s5 + 2.0 * square)  # Halley's step to the fifth root
        s5 = s * s * s * s * s
        s = s * (2.0 * s5 + 3.0 * square) / (3.0 * s5 + 2.0 * square)
        s = s if s < 1.0 else 1.0
        out[i] = s if power[i] > TINY else 0.0


@_inline
def _gain(us, i, vs, j, more, best):
    """Gain of run us[i] onto run vs[j], plus ``more``; ``best`` if it is not above that."""
    u_length, v_length = us[i, LENGTH], vs[j, LENGTH]
    u_thick, v_thick = us[i, THICKNESS], vs[j, THICKNESS]
    longer = u_length - v_length
    g = us[i, COST] + vs[j, COST] + more - (longer * u_thick if longer > 0.0 else -longer * v_thick)
    if g <= best:
        return best
    room = (v_length if longer > 0.0 else u_length) * (u_thick + v_thick)
    part, whole = _bend_difference(us[i, BEND], vs[j, BEND])
    if (g - best) * whole <= ONE_OF_THREE * part * room:
        return best
    x = part / whole
    y = _least_difference(us[i, SLOPE], vs[j, SLOPE], ANGLE_RESOLUTION)
    z = _least_difference(us[i, STRAIGHT], vs[j, STRAIGHT], STRAIGHT_RESOLUTION)
    spare = g - best  # the mean of order 2.5 is not below that of order 2
    if spare * spare <= room * room * (x * x + y * y + z * z) * (1.0 / 3.0):
        return best
    unlike = dissimilarity(
        us[i, SLOPE], us[i, STRAIGHT], us[i, BEND], vs[j, SLOPE], vs[j, STRAIGHT], vs[j, BEND]
    )
    return g - room * unlike


@_inline
def _search_single(place, above, runs, tips, a, vs, j, with_first, with_forks, best):
    """The best gain of a run from fork a onto the run vs[j], if above ``best``; what follows is removed.

    Returns the gain and where the run ends: a fork b as b, tip t as -2 - t, -1 if ``best`` was not passed.
    """
    end = -1
    b, stop = a, a + place[a, SIZE]
    first, shift = place[a, RUNS], place[a, TIP_RUNS]
    v_length, v_thick, v_bend, v_cost = vs[j, LENGTH], vs[j, THICKNESS], vs[j, BEND], vs[j, COST]
    while b < stop:
        i = first + b
        longer = runs[i, LENGTH] - v_length
        # What is added to a longer u costs at least what it saves; to a shorter one, up to its length.
        most = runs[i, COST] + v_cost - longer * (runs[i, THICKNESS] if longer >= 0.0 else above[b, THICKEST])
        if most <= best:
            b += place[b, SIZE]
            continue
        if runs[i, BEND] > v_bend:  # and it will be more
            part, whole = _bend_difference(runs[i, BEND], v_bend)
            most = min(runs[i, LENGTH] + above[b, REACH], v_length)
            most *= max(runs[i, THICKNESS], above[b, THICKEST]) + v_thick
            if (whole - ONE_OF_THREE * part) * most <= best * whole:
                b += place[b, SIZE]
                continue
        if with_forks and (with_first or b > a):
            g = _gain(runs, i, vs, j, 0.0, best)
            if g > best:
                best, end = g, b
        for t in range(place[b, FIRST_TIP], place[b + 1, FIRST_TIP]):
            g = _gain(tips, shift + t, vs, j, 0.0, best)
            if g > best:
                best, end = g, -2 - t
        b += 1
    return best, end


@_inline
def _search_forks(
    place_1, above_1, runs_1, place_2, above_2, runs_2, a, c, matched, best_row, best_block, best
):
    """The best of gain and what follows over runs from forks a and c that end in forks, but (a, c).

    ``matched[b, d]`` is what follows; ``best_row[b, d]`` the most of it over the forks above d,
    ``best_block[b, d]`` over the forks above b and above d.
    """
    end_1, end_2 = a, c
    b, stop_1, stop_2 = a, a + place_1[a, SIZE], c + place_2[c, SIZE]
    first_1, first_2 = place_1[a, RUNS], place_2[c, RUNS]
    own = first_2 + c
    far, most_2 = runs_2[own, LENGTH] + above_2[c, REACH], runs_2[own, COST] + above_2[c, PATH]
    thick_2 = max(runs_2[own, THICKNESS], above_2[c, THICKEST])
    while b < stop_1:
        i = first_1 + b
        length, thick, bend, cost = runs_1[i, LENGTH], runs_1[i, THICKNESS], runs_1[i, BEND], runs_1[i, COST]
        longer = length - far
        most = cost + most_2 - longer * (thick if longer >= 0.0 else above_1[b, THICKEST])
        way = min(length + above_1[b, REACH], far)
        most = min(most, way * (max(thick, above_1[b, THICKEST]) + thick_2))
        if most + best_block[b, c] <= best:
            b += place_1[b, SIZE]
            continue
        d = c
        while d < stop_2:
            j = first_2 + d
            longer = runs_2[j, LENGTH] - length
            most = (
                cost
                + runs_2[j, COST]
                - longer * (runs_2[j, THICKNESS] if longer >= 0.0 else above_2[d, THICKEST])
            )
            if most + best_row[b, d] <= best:
                d += place_2[d, SIZE]
                continue
            if runs_2[j, BEND] > bend:
                part, whole = _bend_difference(bend, runs_2[j, BEND])
                most = min(runs_2[j, LENGTH] + above_2[d, REACH], length)
                most *= thick + max(runs_2[j, THICKNESS], above_2[d, THICKEST])
                if (whole - ONE_OF_THREE * part) * most <= (best - best_row[b, d]) * whole:
                    d += place_2[d, SIZE]
                    continue
            if b > a or d > c:
                g = _gain(runs_1, i, runs_2, j, matched[b, d], best)
                if g > best:
                    best, end_1, end_2 = g, b, d
            d += 1
        b += 1
    return best, end_1, end_2


@_jit
def _search_tips(place_1, above_1, runs_1, tips_1, place_2, above_2, runs_2, tips_2, a, c, best):
    """The best gain over runs from fork a and fork c of which at least one ends in a tip."""
    end_1, end_2 = -1, -1
    i, j = place_1[a, RUNS] + a, place_2[c, RUNS] + c
    path, way = runs_1[i, COST] + above_1[a, PATH], runs_1[i, LENGTH] + above_1[a, REACH]
    if path + runs_2[j, COST] + above_2[c, PATH] <= best:
        return best, end_1, end_2
    thick = max(runs_1[i, THICKNESS], above_1[a, THICKEST])
    first, shift = place_2[c, RUNS], place_2[c, TIP_RUNS]
    d, stop = c, c + place_2[c, SIZE]
    while d < stop:
        j = first + d
        length, thick_2, cost = runs_2[j, LENGTH], runs_2[j, THICKNESS], runs_2[j, COST]
        slack = length * thick_2 - cost  # grows with the run, and is not saved
        far = min(way, length + above_2[d, REACH])
        if (
            cost + above_2[d, PATH] + path <= best
            or far * (thick + max(thick_2, above_2[d, THICKEST])) - slack <= best
        ):
            d += place_2[d, SIZE]
            continue
        if min(way, length) * (thick + thick_2) - slack > best and cost + path > best:
            g, end = _search_single(place_1, above_1, runs_1, tips_1, a, runs_2, j, True, False, best)
            if end != -1:
                best, end_1, end_2 = g, end, d
        for t in range(place_2[d, FIRST_TIP], place_2[d + 1, FIRST_TIP]):
            j = shift + t
            length, thick_2, cost = tips_2[j, LENGTH], tips_2[j, THICKNESS], tips_2[j, COST]
            slack = length * thick_2 - cost
            if min(way, length) * (thick + thick_2) - slack > best and cost + path > best:
                g, end = _search_single(place_1, above_1, runs_1, tips_1, a, tips_2, j, True, True, best)
                if end != -1:
                    best, end_1, end_2 = g, end, -2 - t
        d += 1
    return best, end_1, end_2


@_jit
def _assign(weight, n, m, row, column, mate, way, least, used):
    """Assign n rows to n of m >= n columns at the most weight; fill ``mate``: the row of each column.

    The Hungarian method with potentials, rows and columns counted from 1; ``mate`` is 0 where a column is
    free.
    """
    row[: n + 1] = 0.0
    column[: m + 1] = 0.0
    mate[: m + 1] = 0
    for i in range(1, n + 1):
        mate[0] = i
        j = 0
        least[: m + 1] = np.inf
        used[: m + 1] = False
        while True:
            used[j] = True
            r, step, nearest = mate[j], np.inf, 0
            for q in range(1, m + 1):
                if not used[q]:
                    slack = -weight[r - 1, q - 1] - row[r] - column[q]
                    if slack < least[q]:
                        least[q] = slack
                        way[q] = j
                    if least[q] < step:
                        step = least[q]
                        nearest = q
            for q in range(m + 1):
                if used[q]:
                    row[mate[q]] += step
                    column[q] -= step
                else:
                    least[q] -= step
            j = nearest
            if mate[j] == 0:
                break
        while j != 0:
            mate[j] = mate[way[j]]
            j = way[j]
    total = 0.0
    for q in range(1, m + 1):
        if mate[q] > 0:
            total += weight[mate[q] - 1, q - 1]
    return total


class Room(NamedTuple):
    """Scratch of :func:`match`, for at most d children on each side."""

    weight: np.ndarray  # (d, d)
    row: np.ndarray  # (d + 1,)
    column: np.ndarray
    mate: np.ndarray  # (d + 1,) int64
    way: np.ndarray
    least: np.ndarray
    used: np.ndarray  # (d + 1,) bool


@_jit
def make_room(d):
    """Scratch for nodes of at most d children."""
    return Room(
        np.empty((d, d)), np.empty(d + 1), np.empty(d + 1), np.empty(d + 1, np.int64),
        np.empty(d + 1, np.int64), np.empty(d + 1), np.empty(d + 1, np.bool_),
    )  # fmt: skip


@_jit
def _match_fully(saved, few, many, turned, room):
    """The most that matching ``few`` with ``many`` children saves; leaves the assignment in ``room.mate``."""
    n, m = few.size, many.size
    for i in range(n):
        for j in range(m):
            room.weight[i, j] = saved[many[j], few[i]] if turned else saved[few[i], many[j]]
    return _assign(room.weight, n, m, room.row, room.column, room.mate, room.way, room.least, room.used)


@_jit
def _match_two(saved, two, many, turned):
    """The most that two children save, each with another one of several."""
    best, first, second = 0.0, 0.0, 0.0  # of the columns so far: with both rows, with one of them
    for j in range(many.size):
        x = saved[many[j], two[0]] if turned else saved[two[0], many[j]]
        y = saved[many[j], two[1]] if turned else saved[two[1], many[j]]
        best = max(best, first + y, second + x)
        first, second = max(first, x), max(second, y)
    return best


@_jit
def match(saved, kids_1, kids_2, room):
    """The most that matching children with children saves; ``saved`` is never negative."""
    n, m = kids_1.size, kids_2.size
    if n == 1 or m == 1:
        best = 0.0
        for i in kids_1:
            for j in kids_2:
                best = max(best, saved[i, j])
        return best
    if n == 2:
        return _match_two(saved, kids_1, kids_2, False)
    if m == 2:
        return _match_two(saved, kids_2, kids_1, True)
    if n == 3 and m == 3:
        best = 0.0
        for i in range(3):
            p, q = kids_1[(i + 1) % 3], kids_1[(i + 2) % 3]
            y, z = kids_2[1], kids_2[2]
            rest = max(saved[p, y] + saved[q, z], saved[p, z] + saved[q, y])
            best = max(best, saved[kids_1[i], kids_2[0]] + rest)
        return best
    if n <= m:
        return _match_fully(saved, kids_1, kids_2, False, room)
    return _match_fully(saved, kids_2, kids_1, True, room)


@_jit
def fill_savings(one, two, joins, saved, matched, best_row, best_block, room):
    """Fill ``saved[a, c]``, the most that mapping what is above a onto what is above c saves, a on c.

    ``matched`` (forks by forks) is what the children of two forks save; ``best_row`` and ``best_block`` are
    its maxima over the forks above the second, and above both.
    """
    m1, m2, k1, k2 = one.cost.size, two.cost.size, one.above.shape[0], two.above.shape[0]
    start_1, child_1, start_2, child_2 = one.child_start, one.child, two.child_start, two.child
    place_1, above_1, runs_1, tips_1 = one.place, one.above, one.fork_runs, one.tip_runs
    place_2, above_2, runs_2, tips_2 = two.place, two.above, two.fork_runs, two.tip_runs
    length_2, thickness_2 = two.length, two.thickness
    like, power = np.empty(m2), np.empty(m2)
    like_bits, power_bits = like.view(np.int64), power.view(np.int64)
    single_1, single_2 = np.empty((m1, 6)), np.empty((m2, 6))
    for i in range(m1):
        _copy_piece(one, i, single_1[i])
    for i in range(m2):
        _copy_piece(two, i, single_2[i])
    for a in range(m1 - 1, -1, -1):
        dissimilarity_row(one.slope[a], one.straight[a], one.bend[a], two, power, power_bits, like, like_bits)
        length, thick = one.length[a], one.thickness[a]
        for c in range(m2):
            way = length if length < length_2[c] else length_2[c]
            saved[a, c] = way * (thick + thickness_2[c]) * (1.0 - like[c])
        if a < k1:
            kids = child_1[start_1[a] : start_1[a + 1]]
            for c in range(k2 - 1, -1, -1):
                others = child_2[start_2[c] : start_2[c + 1]]
                best = match(saved, kids, others, room)
                matched[a, c] = best
                saved[a, c] += best
                for i in others:
                    if i < k2:
                        best = max(best, best_row[a, i])
                best_row[a, c] = best
                for i in others:
                    if i < k2:
                        best = max(best, best_block[a, i])
                for i in kids:
                    if i < k1:
                        best = max(best, best_block[i, c])
                best_block[a, c] = best
                if joins:
                    best, _, _ = _search_forks(
                        place_1, above_1, runs_1, place_2, above_2, runs_2, a, c, matched, best_row,
                        best_block, saved[a, c],
                    )  # fmt: skip
                    saved[a, c], _, _ = _search_tips(
                        place_1, above_1, runs_1, tips_1, place_2, above_2, runs_2, tips_2, a, c, best
                    )
            if joins:
                for c in range(k2, m2):
                    saved[a, c], _ = _search_single(
                        place_1, above_1, runs_1, tips_1, a, single_2, c, False, True, saved[a, c]
                    )
        elif joins:
            for c in range(k2):
                saved[a, c], _ = _search_single(
                    place_2, above_2, runs_2, tips_2, c, single_1, a, False, True, saved[a, c]
                )


@_jit
def _copy_piece(tree, i, out):
    """Write a piece as a run of its own."""
    out[LENGTH], out[THICKNESS], out[BEND] = tree.length[i], tree.thickness[i], tree.bend[i]
    out[COST], out[SLOPE], out[STRAIGHT] = tree.cost[i], tree.slope[i], tree.straight[i]


@_jit
def _find_runs(one, two, a, c, matched, best_row, best_block, joins, single_1, single_2):
    """The ends of the two runs with which a is best mapped onto c, as numbers of pieces."""
    k1, k2 = one.above.shape[0], two.above.shape[0]
    unlike = dissimilarity(
        one.slope[a], one.straight[a], one.bend[a], two.slope[c], two.straight[c], two.bend[c]
    )
    way = min(one.length[a], two.length[c])
    best = way * (one.thickness[a] + two.thickness[c]) * (1.0 - unlike)
    if a < k1 and c < k2:
        best += matched[a, c]
    b, d = a, c
    if not joins:
        return b, d
    if a < k1 and c < k2:
        best, b, d = _search_forks(
            one.place, one.above, one.fork_runs, two.place, two.above, two.fork_runs, a, c, matched, best_row,
            best_block, best,
        )  # fmt: skip
        _, end_1, end_2 = _search_tips(
            one.place, one.above, one.fork_runs, one.tip_runs, two.place, two.above, two.fork_runs,
            two.tip_runs, a, c, best,
        )  # fmt: skip
        if end_1 != -1:
            b, d = end_1, end_2
    elif a < k1:
        _, end = _search_single(
            one.place, one.above, one.fork_runs, one.tip_runs, a, single_2, c, False, True, best
        )
        b = a if end == -1 else end
    elif c < k2:
        _, end = _search_single(
            two.place, two.above, two.fork_runs, two.tip_runs, c, single_1, a, False, True, best
        )
        d = c if end == -1 else end
    if b <= -2:
        b = k1 - 2 - b
    if d <= -2:
        d = k2 - 2 - d
    return b, d


@_jit
def _run_cost(one, a, b, two, c, d):
    """Cost of assigning the run from a to b of one tree to that from c to d of another."""
    u, v = np.empty((1, 6)), np.empty((1, 6))
    _copy_run(one, a, b, u[0])
    _copy_run(two, c, d, v[0])
    longer = u[0, LENGTH] - v[0, LENGTH]
    unlike = dissimilarity(u[0, SLOPE], u[0, STRAIGHT], u[0, BEND], v[0, SLOPE], v[0, STRAIGHT], v[0, BEND])
    cost = unlike * min(u[0, LENGTH], v[0, LENGTH]) * (u[0, THICKNESS] + v[0, THICKNESS])
    return cost + abs(longer) * (u[0, THICKNESS] if longer > 0.0 else v[0, THICKNESS])


@_jit
def _copy_run(tree, a, b, out):
    """Write the run from piece a to piece b."""
    k = tree.above.shape[0]
    if a == b:
        _copy_piece(tree, a, out)
    elif b < k:
        out[:] = tree.fork_runs[tree.place[a, RUNS] + b]
    else:
        out[:] = tree.tip_runs[tree.place[a, TIP_RUNS] + b - k]


@_jit
def trace(one, two, joins, saved, matched, best_row, best_block, room, runs, cost):
    """Fill ``runs`` (., 4: from a to b onto from c to d) and ``cost`` by a best mapping; return how many."""
    m1, m2, k1, k2 = one.cost.size, two.cost.size, one.above.shape[0], two.above.shape[0]
    single_1, single_2 = np.empty((m1, 6)), np.empty((m2, 6))
    for i in range(m1):
        _copy_piece(one, i, single_1[i])
    for i in range(m2):
        _copy_piece(two, i, single_2[i])
    stack = np.empty((min(m1, m2) + 1, 2), np.int64)
    stack[0, 0], stack[0, 1] = 0, 0
    top, count = 1, 0
    while top > 0:
        top -= 1
        a, c = stack[top]
        b, d = _find_runs(one, two, a, c, matched, best_row, best_block, joins, single_1, single_2)
        runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = a, b, c, d
        cost[count] = _run_cost(one, a, b, two, c, d)
        count += 1
        if b >= k1 or d >= k2:
            continue
        kids = one.child[one.child_start[b] : one.child_start[b + 1]]
        others = two.child[two.child_start[d] : two.child_start[d + 1]]
        turned = kids.size > others.size
        few, many = (others, kids) if turned else (kids, others)
        _match_fully(saved, few, many, turned, room)
        for j in range(many.size):
            i = room.mate[j + 1] - 1
            if i >= 0 and room.weight[i, j] > 0.0:
                stack[top, 0], stack[top, 1] = (many[j], few[i]) if turned else (few[i], many[j])
                top += 1
    return count
