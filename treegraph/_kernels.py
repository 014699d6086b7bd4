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


@_jit
def reach(parent, edge):
    """Length of the longest way from each node up to a tip."""
    n = parent.size
    out = np.zeros(n)
    for i in range(n - 1, -1, -1):
        p = parent[i]
        if p >= 0 and out[i] + edge[i] > out[p]:
            out[p] = out[i] + edge[i]
    return out


@_jit
def edge_direction(parent, position, edge):
    """Unit vector of each edge; that of the parent's edge where length or parent are missing."""
    n = parent.size
    out = np.zeros((n, 3))
    for i in range(n):
        p = parent[i]
        if p < 0:
            continue
        for k in range(3):
            out[i, k] = (position[i, k] - position[p, k]) / edge[i] if edge[i] > 0.0 else out[p, k]
    return out


@_jit
def deviation_angle(parent, direction):
    """Angle between each edge and its parent's edge, radians; 0 where one of them has no direction."""
    n = parent.size
    out = np.zeros(n)
    for i in range(n):
        p = parent[i]
        if p < 0:
            continue
        ax, ay, az = direction[p]
        bx, by, bz = direction[i]
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        sine, cosine = np.sqrt(cx * cx + cy * cy + cz * cz), ax * bx + ay * by + az * bz
        if sine != 0.0 or cosine != 0.0:  # a missing direction is all zeros; arctan2(0, -0) would be pi
            out[i] = np.arctan2(sine, cosine)
    return out


@_jit
def _drop_below(kids, value, share, alive):
    """Clear ``alive`` where a value is below ``share`` of the largest alive one; NaN is never dropped."""
    largest = 0.0
    for k in range(kids.size):
        if alive[k] and value[kids[k]] > largest:
            largest = value[kids[k]]
    for k in range(kids.size):
        if value[kids[k]] < share * largest:
            alive[k] = False


@_jit
def _continuing_child(kids, angle, radius, length, min_radius_share, min_length_share, tie):
    """The one of several children that continues the axis; see :func:`treegraph.continue_axis`."""
    alive = np.ones(kids.size, np.bool_)
    _drop_below(kids, radius, min_radius_share, alive)
    _drop_below(kids, length, min_length_share, alive)
    least = np.inf
    for k in range(kids.size):
        if alive[k] and angle[kids[k]] < least:
            least = angle[kids[k]]
    all_known = True
    for k in range(kids.size):
        if angle[kids[k]] > least + tie:
            alive[k] = False
        if alive[k] and np.isnan(radius[kids[k]]):
            all_known = False
    if all_known:
        _drop_below(kids, radius, 1.0 - tie, alive)
    _drop_below(kids, length, 1.0 - tie, alive)
    k = 0
    while not alive[k]:  # the last filter has left at least one
        k += 1
    return kids[k]


@_jit
def continue_axes(child_start, child, angle, radius, length, min_radius_share, min_length_share, tie, axis):
    """Fill ``axis`` with the child that continues each node's axis, -1 at a tip."""
    for i in range(axis.size):
        first, last = child_start[i], child_start[i + 1]
        if last - first > 1:
            axis[i] = _continuing_child(
                child[first:last], angle, radius, length, min_radius_share, min_length_share, tie
            )
        elif last - first == 1:
            axis[i] = child[first]
        else:
            axis[i] = -1


@_jit
def branch_orders(parent, axis, angle, radius, alike, tie, order):
    """Fill ``order``: an axis keeps its parent's, a side branch one more unless it is like the axis."""
    for i in range(parent.size):
        p = parent[i]
        if p < 0:
            order[i] = 0
            continue
        a = axis[p]
        if i == a:
            order[i] = order[p]
            continue
        spread, wide = abs(angle[i] - angle[a]), max(angle[i], angle[a])
        same_angle = spread <= tie or spread < alike * wide
        same_radius = radius[i] == radius[a] or abs(radius[i] - radius[a]) < alike * max(radius[i], radius[a])
        order[i] = order[p] + (0 if alike > 0.0 and same_angle and same_radius else 1)


@_jit
def list_chains(parent, axis):
    """Chains as CSR, sorted by their first own node; a side chain begins with the node it leaves."""
    n = parent.size
    heads = 0
    links = 0
    for i in range(n):
        p = parent[i]
        if p < 0 or axis[p] != i:
            heads += 1
        if p >= 0:
            links += 1
    start = np.empty(heads + 1, np.int64)
    node = np.empty(heads + links, np.int32)
    c = 0
    at = 0
    for i in range(n):
        p = parent[i]
        if p >= 0 and axis[p] == i:
            continue
        start[c] = at
        c += 1
        if p >= 0:
            node[at] = p
            at += 1
        j = i
        while j >= 0:
            node[at] = j
            at += 1
            j = axis[j]
    start[c] = at
    return start, node


@_jit
def mark_keys(parent, out):
    """Fill ``out`` (n,) bool: True at roots, tips and branching nodes."""
    n = parent.size
    n_children = np.zeros(n, np.int32)
    for i in range(n):
        if parent[i] >= 0:
            n_children[parent[i]] += 1
    for i in range(n):
        out[i] = parent[i] < 0 or n_children[i] != 1


@_jit
def _collect_run(end, parent, key, run):
    """Write the nodes from the key node below ``end`` up to ``end`` into ``run``; return their number."""
    count = 1
    i = end
    while True:
        i = parent[i]
        count += 1
        if key[i]:
            break
    i = end
    for k in range(count - 1, -1, -1):
        run[k] = i
        i = parent[i]
    return count


@_jit
def count_steps(parent, edge, key, spacing):
    """Number of equal steps of at most ``spacing`` for the run that ends in each key node; else 0."""
    n = parent.size
    out = np.zeros(n)
    length = np.zeros(n)  # from the key node below
    for i in range(n):
        p = parent[i]
        if p < 0:
            continue
        length[i] = edge[i] + (0.0 if key[p] else length[p])
        if key[i]:
            out[i] = max(1.0, np.ceil(length[i] / spacing - 1e-9))
    return out


@_jit
def lay_steps(parent, edge, key, steps, new_parent, node, fraction):
    """Fill the resampled tree: parents, and where on which edge each new node lies."""
    n = parent.size
    run = np.empty(n, np.int32)
    index = np.empty(n, np.int32)  # of the key nodes, in the new tree
    at = 0
    for i in range(n):
        if parent[i] < 0:
            new_parent[at], node[at], fraction[at] = -1, i, 1.0
            index[i] = at
            at += 1
            continue
        if not key[i]:
            continue
        count = _collect_run(i, parent, key, run)
        total = 0.0
        for k in range(1, count):
            total += edge[run[k]]
        last = index[run[0]]
        k = 1
        passed = 0.0
        m = int(steps[i])
        for s in range(1, m):
            target = total * s / m
            while k < count - 1 and passed + edge[run[k]] < target:
                passed += edge[run[k]]
                k += 1
            length = edge[run[k]]
            new_parent[at], node[at] = last, run[k]
            fraction[at] = min(1.0, max(0.0, (target - passed) / length)) if length > 0.0 else 1.0
            last = at
            at += 1
        new_parent[at], node[at], fraction[at] = last, i, 1.0
        index[i] = at
        at += 1


@_jit
def _misses(run, i, j, k, position, radius, tolerance, radius_tolerance, use_radius):
    """Whether node run[k] lies beyond its tolerance from the chord between run[i] and run[j]."""
    a, b, c = run[i], run[j], run[k]
    ux = position[b, 0] - position[a, 0]
    uy = position[b, 1] - position[a, 1]
    uz = position[b, 2] - position[a, 2]
    wx = position[c, 0] - position[a, 0]
    wy = position[c, 1] - position[a, 1]
    wz = position[c, 2] - position[a, 2]
    uu = ux * ux + uy * uy + uz * uz
    t = 0.0
    if uu > 0.0:
        t = min(1.0, max(0.0, (wx * ux + wy * uy + wz * uz) / uu))
    dx, dy, dz = wx - t * ux, wy - t * uy, wz - t * uz
    if dx * dx + dy * dy + dz * dz > tolerance[c] * tolerance[c]:
        return True
    if not use_radius:
        return False
    thick = radius[a] + t * (radius[b] - radius[a])
    return np.isnan(thick) != np.isnan(radius[c]) or abs(thick - radius[c]) > radius_tolerance[c]


@_jit
def _first_miss(run, i, j, position, radius, tolerance, radius_tolerance, use_radius):
    """First node between run[i] and run[j] beyond its tolerance from their chord; -1 if none."""
    for k in range(i + 1, j):
        if _misses(run, i, j, k, position, radius, tolerance, radius_tolerance, use_radius):
            return k
    return -1


@_jit
def _chords_from(
    run, i, stop, position, radius, tolerance, radius_tolerance, use_radius, before, found, size
):
    """Append to ``found`` what one chord from run[i] newly reaches, farthest first; return its new size.

    A chord that passes node k within its tolerance has a direction inside the cone around k seen from
    run[i]; once two such cones are disjoint, no chord passes both and the search ends.
    """
    a = run[i]
    ax, ay, az, sin_a, cos_a = 0.0, 0.0, 0.0, 2.0, 0.0  # the narrowest cone so far; 2: none yet
    first = size
    culprit = i + 1  # the node that spoilt the last chord spoils the next one, most often
    for j in range(i + 1, stop):
        c = run[j]
        dx = position[c, 0] - position[a, 0]
        dy = position[c, 1] - position[a, 1]
        dz = position[c, 2] - position[a, 2]
        far = np.sqrt(dx * dx + dy * dy + dz * dz)
        along = 1.0
        if far > 0.0:
            dx, dy, dz = dx / far, dy / far, dz / far
            along = dx * ax + dy * ay + dz * az
        if before[j] < 0 and (sin_a > 1.0 or far == 0.0 or along >= cos_a - 1e-9):
            miss = culprit
            if culprit >= j or not _misses(
                run, i, j, culprit, position, radius, tolerance, radius_tolerance, use_radius
            ):
                miss = _first_miss(run, i, j, position, radius, tolerance, radius_tolerance, use_radius)
            if miss < 0:
                before[j] = i
                found[size] = j
                size += 1
            else:
                culprit = miss
        if far > tolerance[c]:
            sine = tolerance[c] / far
            cosine = np.sqrt(1.0 - sine * sine)
            if sin_a <= 1.0 and along < cos_a * cosine - sin_a * sine - 1e-9:
                break
            if sine < sin_a:
                ax, ay, az, sin_a, cos_a = dx, dy, dz, sine, cosine
    for k in range((size - first) // 2):
        found[first + k], found[size - 1 - k] = found[size - 1 - k], found[first + k]
    return size


@_jit
def _fewest_chords(
    run, count, position, radius, tolerance, radius_tolerance, use_radius, span, before, found
):
    """Fill ``before``: the node before each on a way of fewest chords from the first to the last.

    Breadth-first over the nodes of the run; ``found`` is scratch and holds them level by level.
    """
    last = count - 1
    for k in range(count):
        before[k] = -1
    if _first_miss(run, 0, last, position, radius, tolerance, radius_tolerance, use_radius) < 0:
        before[last] = 0
        return
    before[0] = 0
    found[0] = 0
    size = 1
    at = 0
    while before[last] < 0:
        i = found[at]
        at += 1
        stop = min(count, i + 1 + span)
        size = _chords_from(
            run, i, stop, position, radius, tolerance, radius_tolerance, use_radius, before, found, size
        )


@_jit
def thin_runs(parent, position, radius, key, tolerance, radius_tolerance, use_radius, span, keep):
    """Fill ``keep``: the key nodes, and between them the fewest nodes that hold the tolerances."""
    n = parent.size
    run = np.empty(n, np.int32)
    before = np.empty(n, np.int32)
    found = np.empty(n, np.int32)
    keep[:] = key
    for i in range(n):
        if parent[i] < 0 or not key[i]:
            continue
        count = _collect_run(i, parent, key, run)
        if count < 3:
            continue
        _fewest_chords(
            run, count, position, radius, tolerance, radius_tolerance, use_radius, span, before, found
        )
        k = before[count - 1]
        while k > 0:
            keep[run[k]] = True
            k = before[k]


@_jit
def kept_parents(parent, keep, new_parent):
    """Fill ``new_parent`` of the kept nodes with their nearest kept ancestors' new indices."""
    n = parent.size
    nearest = np.empty(n, np.int32)  # new index of the node itself or its nearest kept ancestor
    at = 0
    for i in range(n):
        below = nearest[parent[i]] if parent[i] >= 0 else -1
        nearest[i] = below
        if keep[i]:
            new_parent[at] = below
            nearest[i] = at
            at += 1
