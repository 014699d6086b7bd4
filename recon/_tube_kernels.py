"""Compiled loops over the chains and tubes of a skeleton; nothing is checked here.

One file, though a long one: these loops call each other, and the cache of compiled code does not
notice a change in another file.
"""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

ARC_BINS = 24
HOPELESS = 0.5  # a circle whose residuals are this large, in radii, is not refined
INSIDE = 0.5  # of a circle's radius
TUKEY_CUT = 3.0  # residuals beyond so many scales have no weight
FIT_ROUNDS = 6  # of the circle at each node
SMALLEST_CIRCLE = 1e-4  # metres, of radii and of the cut
SMALLEST_TUBE = 5e-4  # metres
SMALLEST_CUT = 0.004  # metres, of the residuals of a frustum
SCALE_OF_MEAN = 1.25  # mean absolute deviation of a normal distribution to its sigma
MOST_WEIGHT = 400  # points; more of them say no more of a radius
FOOT_SLACK = 0.02  # metres that a foot may move anyway
FOOT_COST = 0.3  # radians for a foot that moved as far as it may
FOOT_RADIUS = 0.005  # metres, of the thinnest branch that counts in that
SCALE_OF_MAD = 1.4826  # median absolute deviation of a normal distribution to its sigma


@_jit
def group_points(label, n_groups):
    """CSR of the members of each group, in the order of the points."""
    start = np.zeros(n_groups + 1, np.int32)
    for i in range(label.size):
        if label[i] >= 0:
            start[label[i] + 1] += 1
    for g in range(n_groups):
        start[g + 1] += start[g]
    fill = start[:-1].copy()
    member = np.empty(start[n_groups], np.int32)
    for i in range(label.size):
        g = label[i]
        if g >= 0:
            member[fill[g]] = i
            fill[g] += 1
    return start, member


@_jit
def subtree_length(parent, position):
    """Length of all edges above each node and of the edge below it, without which tips had none."""
    n = parent.size
    out = np.zeros(n)
    for i in range(n - 1, -1, -1):
        p = parent[i]
        if p >= 0:
            d = 0.0
            for c in range(3):
                d += (position[i, c] - position[p, c]) ** 2
            out[i] += math.sqrt(d)
            out[p] += out[i]
    return out


@_jit
def continuations(parent, weight):
    """The child that carries on the chain of each node: the one of largest weight, -1 at tips."""
    n = parent.size
    onward = np.full(n, -1, np.int32)
    for i in range(n):
        p = parent[i]
        if p >= 0 and (onward[p] < 0 or weight[i] > weight[onward[p]]):
            onward[p] = i
    return onward


@_jit
def _step_back(i, parent, onward):
    """The node before i on its chain, or -1 where the chain begins."""
    p = parent[i]
    if p >= 0 and onward[p] == i:
        return p
    return -1


@_jit
def _distance(position, a, b):
    d = 0.0
    for c in range(3):
        d += (position[a, c] - position[b, c]) ** 2
    return math.sqrt(d)


@_jit
def axis_directions(position, parent, onward, reach):
    """Unit direction of the chain at each node, over a stretch of `reach` either way."""
    n = parent.size
    out = np.zeros((n, 3))
    for i in range(n):
        a = i
        gone = 0.0
        while gone < reach[i]:
            p = _step_back(a, parent, onward)
            if p < 0:
                break
            gone += _distance(position, a, p)
            a = p
        b = i
        gone = 0.0
        while gone < reach[i]:
            q = onward[b]
            if q < 0:
                break
            gone += _distance(position, b, q)
            b = q
        if a == i and b == i and parent[i] >= 0:
            a = parent[i]
        norm = 0.0
        for c in range(3):
            out[i, c] = position[b, c] - position[a, c]
            norm += out[i, c] ** 2
        norm = math.sqrt(norm)
        if norm > 0:
            for c in range(3):
                out[i, c] /= norm
        else:
            out[i, 2] = 1.0
    return out


@_jit
def plane_basis(axis):
    """Two unit vectors at right angles to a unit axis."""
    u = np.zeros(3)
    if abs(axis[2]) < 0.9:
        u[0], u[1] = -axis[1], axis[0]
    else:
        u[1], u[2] = -axis[2], axis[1]
    norm = math.sqrt(u[0] ** 2 + u[1] ** 2 + u[2] ** 2)
    for c in range(3):
        u[c] /= norm
    v = np.array(
        [axis[1] * u[2] - axis[2] * u[1], axis[2] * u[0] - axis[0] * u[2], axis[0] * u[1] - axis[1] * u[0]]
    )
    return u, v


@_jit
def _solve3(a, b):
    """Solve a symmetric 3 x 3 system by Cramer's rule; nan when singular."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    scale = abs(a[0, 0] * a[1, 1] * a[2, 2])
    if not abs(det) > 1e-12 * scale:
        return math.nan, math.nan, math.nan
    x = (
        b[0] * c00
        + b[1] * (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2])
        + b[2] * (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1])
    ) / det
    y = (
        b[0] * c01
        + b[1] * (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0])
        + b[2] * (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2])
    ) / det
    z = (
        b[0] * c02
        + b[1] * (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1])
        + b[2] * (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
    ) / det
    return x, y, z


@_jit
def _solve_spd4(m, g):
    """Solve a symmetric positive definite 4 x 4 system in place: `g` becomes the solution."""
    for k in range(4):
        pivot = max(m[k, k], 1e-12)
        for i in range(k + 1, 4):
            f = m[i, k] / pivot
            for j in range(k, 4):
                m[i, j] -= f * m[k, j]
            g[i] -= f * g[k]
    for k in range(3, -1, -1):
        for j in range(k + 1, 4):
            g[k] -= m[k, j] * g[j]
        g[k] /= max(m[k, k], 1e-12)


@_jit
def circle_through(x, y, weight):
    """Weighted algebraic circle (Kasa): centre and radius, nan when the points are collinear."""
    sw = 0.0
    mx = 0.0
    my = 0.0
    for i in range(x.size):
        sw += weight[i]
        mx += weight[i] * x[i]
        my += weight[i] * y[i]
    mx /= sw
    my /= sw
    a = np.zeros((3, 3))
    b = np.zeros(3)
    for i in range(x.size):
        u = x[i] - mx
        v = y[i] - my
        z = u * u + v * v
        w = weight[i]
        a[0, 0] += w * u * u
        a[0, 1] += w * u * v
        a[1, 1] += w * v * v
        b[0] += w * u * z
        b[1] += w * v * z
        b[2] += w * z
    a[1, 0] = a[0, 1]
    a[2, 2] = sw
    p, q, s = _solve3(a, b)
    if not (math.isfinite(p) and math.isfinite(q)):
        return math.nan, math.nan, math.nan
    cx = p / 2
    cy = q / 2
    rr = s + cx * cx + cy * cy
    if not rr > 0:
        return math.nan, math.nan, math.nan
    return cx + mx, cy + my, math.sqrt(rr)


@_jit
def refine_circle(x, y, cx, cy, r, weight, rounds):
    """Robust geometric circle from a first guess: Gauss-Newton with Tukey weights.

    Returns centre, radius, scale of the residuals; `weight` ends as the last weights.
    """
    n = x.size
    residual = np.empty(n)
    scale = 0.0
    for step in range(rounds + 1):
        for i in range(n):
            residual[i] = math.hypot(x[i] - cx, y[i] - cy) - r
        scale = SCALE_OF_MAD * np.median(np.abs(residual))
        cut = max(TUKEY_CUT * scale, SMALLEST_CIRCLE)
        for i in range(n):
            t = residual[i] / cut
            weight[i] = (1 - t * t) ** 2 if abs(t) < 1 else 0.0
        if step == rounds or scale > HOPELESS * r:
            break
        a = np.zeros((3, 3))
        b = np.zeros(3)
        for i in range(n):
            if weight[i] == 0:
                continue
            dx = x[i] - cx
            dy = y[i] - cy
            d = max(math.hypot(dx, dy), 1e-9)
            jx = -dx / d
            jy = -dy / d
            w = weight[i]
            e = residual[i]
            a[0, 0] += w * jx * jx
            a[0, 1] += w * jx * jy
            a[0, 2] -= w * jx
            a[1, 1] += w * jy * jy
            a[1, 2] -= w * jy
            a[2, 2] += w
            b[0] -= w * jx * e
            b[1] -= w * jy * e
            b[2] += w * e
        a[1, 0] = a[0, 1]
        a[2, 0] = a[0, 2]
        a[2, 1] = a[1, 2]
        sx, sy, sr = _solve3(a, b)
        if not (math.isfinite(sx) and math.isfinite(sy) and math.isfinite(sr)):
            break
        cap = 0.5 * r
        size = max(abs(sx), abs(sy), abs(sr))
        if size > cap:
            sx *= cap / size
            sy *= cap / size
            sr *= cap / size
        cx += sx
        cy += sy
        r = max(r + sr, SMALLEST_CIRCLE)
        if size < 1e-5:
            break
    return cx, cy, r, scale


@_jit
def arc_covered(x, y, cx, cy, weight):
    """Share of the directions around a centre in which there is a point of positive weight."""
    seen = np.zeros(ARC_BINS, np.bool_)
    for i in range(x.size):
        if weight[i] > 0:
            k = int((math.atan2(y[i] - cy, x[i] - cx) + math.pi) / (2 * math.pi) * ARC_BINS)
            seen[min(max(k, 0), ARC_BINS - 1)] = True
    return seen.sum() / ARC_BINS


@_jit
def circle_fits(xyz, point_start, point, position, parent, onward, axis, fewest, max_points):
    """A circle around the axis at every node, from its points and those of its chain neighbours.

    Returns per node: centre (n, 3), radius, residual scale, arc covered, points used, and the
    share of points nearer to the centre than INSIDE radii (a trunk is empty there); a
    radius of nan where there were fewer than `fewest` points or they had no curvature.
    """
    n = parent.size
    centre = position.copy()
    radius = np.full(n, np.nan)
    scale = np.full(n, np.nan)
    arc = np.zeros(n)
    used = np.zeros(n, np.int32)
    inside = np.zeros(n)
    near = np.empty(3, np.int64)
    for i in range(n):
        near[0] = i
        near[1] = _step_back(i, parent, onward)
        near[2] = onward[i]
        count = 0
        for k in range(3):
            if near[k] >= 0:
                count += point_start[near[k] + 1] - point_start[near[k]]
        used[i] = count
        if count < fewest:
            continue
        stride = max(1, (count + max_points - 1) // max_points)
        size = (count + stride - 1) // stride
        x = np.empty(size)
        y = np.empty(size)
        u, v = plane_basis(axis[i])
        seen = 0
        m = 0
        for k in range(3):
            if near[k] < 0:
                continue
            for e in range(point_start[near[k]], point_start[near[k] + 1]):
                if seen % stride == 0:
                    q = point[e]
                    d0 = xyz[q, 0] - position[i, 0]
                    d1 = xyz[q, 1] - position[i, 1]
                    d2 = xyz[q, 2] - position[i, 2]
                    x[m] = d0 * u[0] + d1 * u[1] + d2 * u[2]
                    y[m] = d0 * v[0] + d1 * v[1] + d2 * v[2]
                    m += 1
                seen += 1
        weight = np.ones(m)
        cx, cy, r = circle_through(x[:m], y[:m], weight)
        if not math.isfinite(r):
            continue
        cx, cy, r, s = refine_circle(x[:m], y[:m], cx, cy, r, weight, FIT_ROUNDS)
        radius[i] = r
        scale[i] = s
        arc[i] = arc_covered(x[:m], y[:m], cx, cy, weight)
        for k in range(m):
            if (x[k] - cx) ** 2 + (y[k] - cy) ** 2 < (INSIDE * r) ** 2:
                inside[i] += 1.0 / m
        for c in range(3):
            centre[i, c] = position[i, c] + cx * u[c] + cy * v[c]
    return centre, radius, scale, arc, used, inside


@_jit
def mean_axis_distance(xyz, point_start, point, position, axis):
    """Mean distance of each node's own points from the line through it."""
    n = position.shape[0]
    out = np.zeros(n)
    for i in range(n):
        count = point_start[i + 1] - point_start[i]
        total = 0.0
        for e in range(point_start[i], point_start[i + 1]):
            q = point[e]
            along = 0.0
            square = 0.0
            for c in range(3):
                d = xyz[q, c] - position[i, c]
                along += d * axis[i, c]
                square += d * d
            total += math.sqrt(max(square - along * along, 0.0))
        out[i] = total / max(count, 1)
    return out


@_jit
def chain_heads(parent, onward):
    """First node of every chain, in the order of the nodes, and the chain of every node."""
    n = parent.size
    chain = np.full(n, -1, np.int32)
    head = np.empty(n, np.int32)
    count = 0
    for i in range(n):
        p = parent[i]
        if p >= 0 and onward[p] == i:
            chain[i] = chain[p]
        else:
            head[count] = i
            chain[i] = count
            count += 1
    return head[:count].copy(), chain


@_jit
def decreasing_fit(value, weight):
    """Weighted least-squares fit that never increases (pool adjacent violators)."""
    n = value.size
    level = np.empty(n)
    mass = np.empty(n)
    size = np.empty(n, np.int64)
    top = 0
    for i in range(n):
        level[top] = value[i]
        mass[top] = weight[i]
        size[top] = 1
        top += 1
        while top > 1 and level[top - 1] > level[top - 2]:
            total = mass[top - 1] + mass[top - 2]
            level[top - 2] = (level[top - 1] * mass[top - 1] + level[top - 2] * mass[top - 2]) / total
            mass[top - 2] = total
            size[top - 2] += size[top - 1]
            top -= 1
    out = np.empty(n)
    at = 0
    for b in range(top):
        for _ in range(size[b]):
            out[at] = level[b]
            at += 1
    return out


@_jit
def believable_circles(head, onward, radius, accepted, window, tolerance):
    """Drop accepted circles that differ from the running median of their chain by too much."""
    out = accepted.copy()
    n = radius.size
    row = np.empty(n, np.int64)
    for h in head:
        m = 0
        i = h
        while i >= 0:
            if accepted[i]:
                row[m] = i
                m += 1
            i = onward[i]
        for k in range(m):
            a = max(0, k - window)
            b = min(m, k + window + 1)
            middle = np.median(radius[row[a:b]])
            if abs(radius[row[k]] - middle) > tolerance * middle:
                out[row[k]] = False
    return out


@_jit
def chain_radii(head, parent, onward, radius, accepted, weight, share):
    """Radius along each chain from its accepted circles: never growing, between them linear.

    nan after the last accepted circle of a chain and on chains that have none. A chain is
    never thicker than `share` times its parent where it leaves it.
    """
    n = radius.size
    out = np.full(n, np.nan)
    row = np.empty(n, np.int64)
    for h in head:
        m = 0
        i = h
        last = -1
        while i >= 0:
            row[m] = i
            if accepted[i]:
                last = m
            m += 1
            i = onward[i]
        if last < 0:
            continue
        count = 0
        for k in range(last + 1):
            if accepted[row[k]]:
                count += 1
        value = np.empty(count)
        mass = np.empty(count)
        at = np.empty(count, np.int64)
        c = 0
        for k in range(last + 1):
            if accepted[row[k]]:
                value[c] = radius[row[k]]
                mass[c] = weight[row[k]]
                at[c] = k
                c += 1
        value = decreasing_fit(value, mass)
        top = math.inf
        if parent[h] >= 0 and math.isfinite(out[parent[h]]):
            top = share * out[parent[h]]
        c = 0
        for k in range(last + 1):
            while c < count and at[c] < k:
                c += 1
            if at[c] == k or c == 0:
                r = value[c]
            else:
                f = (k - at[c - 1]) / (at[c] - at[c - 1])
                r = value[c - 1] + f * (value[c] - value[c - 1])
            out[row[k]] = min(r, top)
    return out


@_jit
def _axis_gap(position, a, b, q):
    """Distance of the point q (3,) from the segment a-b of the skeleton, and where along it."""
    ab = 0.0
    ap = 0.0
    for c in range(3):
        e = position[b, c] - position[a, c]
        ab += e * e
        ap += e * (q[c] - position[a, c])
    t = min(max(ap / ab, 0.0), 1.0) if ab > 0 else 0.0
    d = 0.0
    for c in range(3):
        x = position[a, c] + t * (position[b, c] - position[a, c]) - q[c]
        d += x * x
    return math.sqrt(d), t


@_jit
def absorb_into_tubes(parent, onward, position, tube, extent, slack):
    """Which node each node is swallowed by, itself where by none.

    A side chain is swallowed from its start on for as long as its slices lie inside the
    tube of the chain it leaves (`tube` (n,) radii, nan unknown): the foot of a branch
    inside the trunk, and the far side of a trunk that was seen as a branch of its own.
    """
    n = parent.size
    into = np.arange(n).astype(np.int32)
    for j in range(n):
        p = parent[j]
        if p < 0 or onward[p] == j and into[p] == p:
            continue
        i = into[p]
        best, _ = _axis_gap(position, i, i, position[j])
        while True:  # walk along the chain of i to the piece of axis nearest to j
            step = -1
            a = _step_back(i, parent, onward)
            if a >= 0:
                d, _ = _axis_gap(position, a, a, position[j])
                if d < best:
                    best = d
                    step = a
            b = onward[i]
            if b >= 0 and b != j:
                d, _ = _axis_gap(position, b, b, position[j])
                if d < best:
                    best = d
                    step = b
            if step < 0:
                break
            i = step
        if onward[i] == j or not math.isfinite(tube[i]):
            continue
        gap = best
        if onward[i] >= 0 and onward[i] != j:
            d, _ = _axis_gap(position, i, onward[i], position[j])
            gap = min(gap, d)
        a = _step_back(i, parent, onward)
        if a >= 0:
            d, _ = _axis_gap(position, a, i, position[j])
            gap = min(gap, d)
        if gap + 0.5 * extent[j] < tube[i] * (1 + slack):
            into[j] = i
    return into


@_jit
def absorb_rims(head, parent, onward, position, tube, into, reach, slack):
    """Give the end of a chain back to its tube where it only runs along the tube's rim.

    Where a thick tube ends, the last slices are pieces of its rim, off the axis. The end goes if
    all of it lies within `reach` radii beyond the last circle and (1 + slack) radii of the axis.
    Nodes that carry side chains are left. Changes `into`.
    """
    n = onward.size
    row = np.empty(n, np.int64)
    forks = np.zeros(n, np.int32)
    for i in range(n):
        if parent[i] >= 0 and onward[parent[i]] != i and into[i] == i:
            forks[parent[i]] += 1
    d = np.empty(3)
    for h in head:
        m = 0
        last = -1
        i = h
        while i >= 0:
            row[m] = i
            if math.isfinite(tube[i]):
                last = m
            m += 1
            i = onward[i]
        if last < 1 or last == m - 1:
            continue
        end = row[last]
        r = tube[end]
        back = last
        while back > 0 and _distance(position, row[back], end) < 2 * r:
            back -= 1
        norm = _distance(position, row[back], end)
        if norm <= 0:
            continue
        for c in range(3):
            d[c] = (position[end, c] - position[row[back], c]) / norm
        rim = True
        for k in range(last + 1, m):
            along = 0.0
            square = 0.0
            for c in range(3):
                e = position[row[k], c] - position[end, c]
                along += e * d[c]
                square += e * e
            off = math.sqrt(max(square - along * along, 0.0))
            if along > reach * r or off > r * (1 + slack) or forks[row[k]] > 0:
                rim = False
        if rim:
            for k in range(last + 1, m):
                into[row[k]] = end


@_jit
def refine_tubes(
    xyz, point_start, point, parent, onward, position, radius, is_tube, anchor, hold, rounds, stiff, stiff_r
):
    """Move the nodes of all tubes, and their radii, so that the surfaces meet the points.

    Gauss-Newton on the distance of each point from the surface of its two nearest frusta
    (lumped per node), robust weights, with `stiff` points' worth of pull towards the middle
    of the neighbours on the chain and `hold` points' worth towards `anchor`. Nodes that are
    no tubes have their axis go through the points, and their mean distance as radius.
    """
    n = parent.size
    pos = position.copy()
    rad = radius.copy()
    residual = np.zeros(n)
    q = np.empty(3)
    for _ in range(rounds):
        a4 = np.zeros((n, 10))
        b4 = np.zeros((n, 4))
        spread = np.zeros(n)
        seen = np.zeros(n)
        for j in range(n):
            low = parent[j]
            high = onward[j]
            own_start = low >= 0 and onward[low] != j
            for e in range(point_start[j], point_start[j + 1]):
                for c in range(3):
                    q[c] = xyz[point[e], c]
                d = math.inf
                t = 0.0
                a, b = j, j
                if low >= 0:
                    d, t = _axis_gap(pos, low, j, q)
                    a = low
                if high >= 0:
                    d2, t2 = _axis_gap(pos, j, high, q)
                    if d2 < d:
                        d, t, a, b = d2, t2, j, high
                if a == b:
                    d, t = _axis_gap(pos, j, j, q)
                ra = rad[a]
                if a == low and own_start:
                    ra = rad[b]
                r = ra + t * (rad[b] - ra)
                res = d - r
                spread[j] += abs(res)
                seen[j] += 1
                cut = math.inf
                if is_tube[j]:
                    cut = max(0.5 * r, SMALLEST_CUT)
                    if residual[j] > 0:
                        cut = max(min(cut, TUKEY_CUT * residual[j]), SMALLEST_CUT)
                elif residual[j] > 0:
                    cut = max(0.5 * r, TUKEY_CUT * residual[j], SMALLEST_CUT)
                w = res / cut
                if abs(w) >= 1:
                    continue
                w = (1 - w * w) ** 2
                safe = max(d, 1e-9)
                for end in range(2):
                    node = a if end == 0 else b
                    h = (1 - t) if end == 0 else t
                    if a == b:
                        h = 0.5
                    if node == low and own_start:
                        continue
                    h *= w
                    pull = res if is_tube[node] else d
                    n0 = (pos[a, 0] + t * (pos[b, 0] - pos[a, 0]) - q[0]) / safe
                    n1 = (pos[a, 1] + t * (pos[b, 1] - pos[a, 1]) - q[1]) / safe
                    n2 = (pos[a, 2] + t * (pos[b, 2] - pos[a, 2]) - q[2]) / safe
                    a4[node, 0] += h * n0 * n0
                    a4[node, 1] += h * n0 * n1
                    a4[node, 2] += h * n0 * n2
                    a4[node, 3] -= h * n0
                    a4[node, 4] += h * n1 * n1
                    a4[node, 5] += h * n1 * n2
                    a4[node, 6] -= h * n1
                    a4[node, 7] += h * n2 * n2
                    a4[node, 8] -= h * n2
                    a4[node, 9] += h
                    b4[node, 0] -= h * n0 * pull
                    b4[node, 1] -= h * n1 * pull
                    b4[node, 2] -= h * n2 * pull
                    b4[node, 3] += h * res
        new = pos.copy()
        m = np.zeros((4, 4))
        g = np.zeros(4)
        for j in range(n):
            if seen[j] > 0:
                residual[j] = spread[j] / seen[j] * SCALE_OF_MEAN
            prev = _step_back(j, parent, onward)
            foot = parent[j]
            high = onward[j]
            m[:] = 0.0
            m[0, 0], m[0, 1], m[0, 2], m[0, 3] = a4[j, 0], a4[j, 1], a4[j, 2], a4[j, 3]
            m[1, 1], m[1, 2], m[1, 3] = a4[j, 4], a4[j, 5], a4[j, 6]
            m[2, 2], m[2, 3], m[3, 3] = a4[j, 7], a4[j, 8], a4[j, 9]
            if not is_tube[j]:  # the axis goes through the points; the radius follows it
                for c in range(3):
                    m[c, 3] = 0.0
            for c in range(4):
                g[c] = b4[j, c]
                for k in range(c):
                    m[c, k] = m[k, c]
            pull_n = min(stiff, a4[j, 9])
            if foot >= 0 and high >= 0:
                for c in range(3):
                    m[c, c] += pull_n
                    g[c] += pull_n * (0.5 * (pos[foot, c] + pos[high, c]) - pos[j, c])
            for c in range(3):
                m[c, c] += hold + 1e-6
                g[c] += hold * (anchor[j, c] - pos[j, c])
            near_r = 0.0
            near_n = 0.0
            if prev >= 0:
                near_r += rad[prev]
                near_n += 1
            if high >= 0:
                near_r += rad[high]
                near_n += 1
            if near_n > 0:
                m[3, 3] += stiff_r
                g[3] += stiff_r * (near_r / near_n - rad[j])
            m[3, 3] += 1e-6
            _solve_spd4(m, g)
            s = g
            size = math.sqrt(s[0] ** 2 + s[1] ** 2 + s[2] ** 2)
            cap = max(0.5 * rad[j], 0.01)
            f = min(1.0, cap / size) if size > 0 else 1.0
            for c in range(3):
                new[j, c] = pos[j, c] + f * s[c]
            rad[j] = max(rad[j] + min(max(s[3], -0.5 * rad[j]), cap), SMALLEST_TUBE)
        pos = new
    return pos, rad, residual


@_jit
def spurs(xyz, point_start, point, parent, onward, head, position, radius, shortest, far, few, stride):
    """Which node each node goes into when side chains of little weight are dropped.

    A side chain without side chains of its own is dropped if it sticks out of its parent's
    tube by less than `shortest`, or if no more than `few` of its points for each `stride`
    begun of its length lie farther than `far` outside that tube.
    """
    n = parent.size
    into = np.arange(n).astype(np.int32)
    children = np.zeros(n, np.int32)
    for i in range(n):
        if parent[i] >= 0:
            children[parent[i]] += 1
    q = np.empty(3)
    for k in range(head.size - 1, -1, -1):
        h = head[k]
        p = parent[h]
        if p < 0:
            continue
        before = _step_back(p, parent, onward)
        after = onward[p]
        reach = 0.0
        gain = 0
        i = h
        bare = True
        length = 0.0
        while i >= 0:
            length += _distance(position, i, parent[i])
            reach = max(reach, _distance(position, i, p) - radius[p])
            if children[i] > (1 if onward[i] >= 0 else 0):
                bare = False
            i = onward[i]
        if not bare:
            continue
        enough = few * math.ceil((length - radius[p]) / stride)
        i = h
        while i >= 0 and gain <= enough and reach >= shortest:
            for e in range(point_start[i], point_start[i + 1]):
                for c in range(3):
                    q[c] = xyz[point[e], c]
                d, _ = _axis_gap(position, p, p, q)
                if before >= 0:
                    d = min(d, _axis_gap(position, before, p, q)[0])
                if after >= 0:
                    d = min(d, _axis_gap(position, p, after, q)[0])
                if d - radius[p] > far:
                    gain += 1
            i = onward[i]
        if reach < shortest or gain <= enough:
            i = h
            while i >= 0:
                into[i] = p
                i = onward[i]
            children[p] -= 1
    return into


@_jit
def unsupported_tips(points_per_metre, parent, position, n_points, reach):
    """False for the nodes of branch ends that hang behind a gap without enough points.

    From the tips down: an end is dropped where the gap before it is longer than `reach` and
    it has, with all it carries, fewer points than `points_per_metre` times the gap.
    """
    n = parent.size
    points = n_points.astype(np.float64)
    keep = np.ones(n, np.bool_)
    for i in range(n - 1, 0, -1):
        p = parent[i]
        gap = _distance(position, i, p)
        if gap > reach and points[i] < points_per_metre * gap:
            keep[i] = False
        else:
            points[p] += points[i]
    for i in range(1, n):
        if not keep[parent[i]]:
            keep[i] = False
    return keep


@_jit
def _believed(i, observed, n_points, r_ref, share, gamma, pipe_exponent, resolution, enough):
    """Radius of a node beyond the last circle: what its points show if that can be wood."""
    most = max(r_ref * share**pipe_exponent, resolution)
    m = n_points[i]
    if m >= enough:
        r = observed[i] * math.sqrt(m / (m - 1.0))  # the axis has been fitted to the same points
        if r <= most:
            return r, min(m, MOST_WEIGHT) * 1.0
    return r_ref * share**gamma, 1.0


@_jit
def final_radii(
    head,
    parent,
    onward,
    observed,
    n_points,
    is_tube,
    length,
    gamma,
    pipe_exponent,
    resolution,
    smallest,
    enough,
):
    """Radius of every node, and whether a circle measured it; see `recon.radii.final_radii`."""
    n = parent.size
    out = np.full(n, np.nan)
    measured = np.zeros(n, np.bool_)
    row = np.empty(n, np.int64)
    value = np.empty(n)
    mass = np.empty(n)
    for h in head:
        m = 0
        last = -1
        i = h
        while i >= 0:
            row[m] = i
            if is_tube[i]:
                last = m
            m += 1
            i = onward[i]
        top = math.inf
        r_ref = observed[h]
        l_ref = length[h]
        if parent[h] >= 0:
            top = out[parent[h]]
            r_ref = top
            l_ref = length[parent[h]]
        if last >= 0:
            for k in range(last + 1):
                value[k] = max(observed[row[k]], smallest)
                mass[k] = max(min(n_points[row[k]], MOST_WEIGHT), 1)
                measured[row[k]] = n_points[row[k]] > 0
            fit = decreasing_fit(value[: last + 1], mass[: last + 1])
            for k in range(last + 1):
                out[row[k]] = min(fit[k], top)
            r_ref = out[row[last]]
            l_ref = length[row[last]]
            top = r_ref
        for k in range(last + 1, m):
            i = row[k]
            share = min(length[i] / l_ref, 1.0) if l_ref > 0 else 0.0
            v, w = _believed(i, observed, n_points, r_ref, share, gamma, pipe_exponent, resolution, enough)
            value[k] = max(v, smallest)
            mass[k] = w
        if last + 1 < m:
            fit = decreasing_fit(value[last + 1 : m], mass[last + 1 : m])
            for k in range(last + 1, m):
                out[row[k]] = min(fit[k - last - 1], top)
    return out, measured


@_jit
def coarsen(parent, onward, head, position, tube, ratio, apart):
    """Which node each node goes into so that nodes are `ratio` radii of their tube apart.

    Where there is no tube, or a thin one, they are `apart` (n,) apart.
    """
    n = parent.size
    into = np.arange(n).astype(np.int32)
    for h in head:
        kept = h
        gone = 0.0
        i = onward[h]
        before = h
        while i >= 0:
            gone += _distance(position, before, i)
            least = apart[i]
            if math.isfinite(tube[i]):
                least = max(least, ratio * tube[i])
            if gone < least and onward[i] >= 0:
                into[i] = kept
            else:
                kept = i
                gone = 0.0
            before = i
            i = onward[i]
    return into


@_jit
def _surface_gap(q, i, parent, onward, position, radius):
    """Distance of a point from the frusta on either side of node i, and the radius there."""
    best, _ = _axis_gap(position, i, i, q)
    r = radius[i]
    p = parent[i]
    if p >= 0:
        d, t = _axis_gap(position, p, i, q)
        if d < best:
            best = d
            foot = radius[p] if onward[p] == i else radius[i]
            r = foot + t * (radius[i] - foot)
    o = onward[i]
    if o >= 0:
        d, t = _axis_gap(position, i, o, q)
        if d < best:
            best = d
            r = radius[i] + t * (radius[o] - radius[i])
    return best, r


@_jit
def mean_surface_distance(xyz, point_start, point, parent, onward, position, radius):
    """Mean distance of each node's points from the surface of its branch, 0 without points."""
    n = parent.size
    out = np.zeros(n)
    q = np.empty(3)
    for i in range(n):
        for e in range(point_start[i], point_start[i + 1]):
            for c in range(3):
                q[c] = xyz[point[e], c]
            d, r = _surface_gap(q, i, parent, onward, position, radius)
            out[i] += abs(d - r)
        out[i] /= max(point_start[i + 1] - point_start[i], 1)
    return out


@_jit
def home_distance(xyz, home, parent, onward, position, radius):
    """Distance of each point outside the branch at its node, negative inside."""
    out = np.empty(home.size)
    q = np.empty(3)
    for k in range(home.size):
        for c in range(3):
            q[c] = xyz[k, c]
        d, r = _surface_gap(q, home[k], parent, onward, position, radius)
        out[k] = d - r
    return out


@_jit
def low_confidence(parent, onward, position, radius, spread, n_points, f_s, step, noise, window):
    """True from the first node outwards whose points are farther off than f_s^(path/step) d.

    Spread and diameter are means over the points of the chain from the node on for `window`
    metres: one ragged slice at the foot of a branch does not end a bough.
    """
    n = parent.size
    path = np.zeros(n)
    out = np.zeros(n, np.bool_)
    for i in range(1, n):
        p = parent[i]
        path[i] = path[p] + _distance(position, i, p)
        if out[p]:
            out[i] = True
            continue
        off = 0.0
        thick = 0.0
        count = 0.0
        j = i
        gone = 0.0
        while j >= 0 and (gone <= window or count == 0):
            off += n_points[j] * max(spread[j], noise)
            thick += n_points[j] * 2 * radius[j]
            count += n_points[j]
            if onward[j] >= 0:
                gone += _distance(position, j, onward[j])
            j = onward[j]
        out[i] = off > thick * f_s ** (path[i] / step)
    return out


@_jit
def gather_groups(parent, onward, count, target):
    """Group of every node: counts are gathered from the tips towards the root until full.

    A group closes when it has `target`; what is left at the foot of a chain goes on with the
    parent's, and the rest at the root joins the group it met last.
    """
    n = parent.size
    group = np.full(n, -1, np.int32)
    pending = count.astype(np.float64)
    closed = np.zeros(n, np.bool_)
    last = -1
    for i in range(n - 1, -1, -1):
        if pending[i] >= target or (i == 0 and last < 0):
            closed[i] = True
            last = i
        elif i > 0:
            pending[parent[i]] += pending[i]
    for i in range(n):
        if closed[i] or i == 0:
            group[i] = i
        else:
            group[i] = group[parent[i]]
    if not closed[0] and last > 0:
        for i in range(n):
            if group[i] == 0:
                group[i] = last
    return group


@_jit
def bridge_centres(head, onward, position, centre, accepted, tube, reach):
    """Centres between two accepted circles of a chain go on the line between them.

    Only where the two are no more than `reach` radii apart: across the foot of a branch the
    mean of the points is pulled out of the trunk.
    """
    out = centre.copy()
    n = onward.size
    row = np.empty(n, np.int64)
    along = np.empty(n)
    for h in head:
        m = 0
        i = h
        before = -1
        while i >= 0:
            row[m] = i
            along[m] = 0.0 if m == 0 else along[m - 1] + _distance(position, i, before)
            before = i
            m += 1
            i = onward[i]
        last = -1
        for k in range(m):
            if not accepted[row[k]]:
                continue
            if last >= 0 and k - last > 1:
                span = along[k] - along[last]
                a = row[last]
                b = row[k]
                if 0 < span < reach * tube[a]:
                    for j in range(last + 1, k):
                        t = (along[j] - along[last]) / span
                        for c in range(3):
                            out[row[j], c] = centre[a, c] + t * (centre[b, c] - centre[a, c])
            last = k
    return out


@_jit
def forward_feet(parent, onward, head, position, radius, look, reach):
    """Where each side chain best leaves its parent: the node of the parent's chain, near the
    present one, from which the chain sets off most nearly in its own direction."""
    out = parent.copy()
    d = np.empty(3)
    e = np.empty(3)
    for h in head:
        p = parent[h]
        if p < 0:
            continue
        tip = h
        gone = 0.0
        while onward[tip] >= 0 and gone < look:
            gone += _distance(position, tip, onward[tip])
            tip = onward[tip]
        if tip == h or gone <= 0:
            continue
        for c in range(3):
            d[c] = position[tip, c] - position[h, c]
        dn = math.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
        if dn <= 0:
            continue
        best = p
        best_cost = math.inf
        for way in range(2):
            i = p
            moved = 0.0
            while i >= 0 and moved <= reach * radius[p] + FOOT_SLACK:
                en = 0.0
                dot = 0.0
                for c in range(3):
                    e[c] = position[h, c] - position[i, c]
                    en += e[c] ** 2
                    dot += e[c] * d[c]
                en = math.sqrt(en)
                if en > 0:
                    angle = math.acos(min(max(dot / (en * dn), -1.0), 1.0))
                    cost = angle + FOOT_COST * moved / max(radius[p], FOOT_RADIUS) / max(reach, 1.0)
                    if cost < best_cost - 1e-9:
                        best_cost = cost
                        best = i
                step = _step_back(i, parent, onward) if way == 0 else onward[i]
                if step < 0 or step == h:
                    break
                moved += _distance(position, i, step)
                i = step
        out[h] = best
    return out
