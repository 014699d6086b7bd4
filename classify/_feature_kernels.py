"""Compiled loops of the features: arrays in, arrays out; nothing is checked here."""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

N_MOMENTS = 10  # points, x, y, z, xx, xy, xz, yy, yz, zz
SINGLE = 1e-7  # product of the distances to the other two eigenvalues, which have errors of 1e-8
KEY = 1 << 20  # of a cell's place on one axis, so that all three make one number
MAX_STEPS = 1000  # along a branch: a skeleton may be far larger than the tree is high
N_SHAPE = 11  # points, linearity, planarity, scattering, size, long axis (3), short axis (3)


@_jit
def _slot(code, mask):
    """Where a code belongs in a table of 2^k places (Fibonacci hashing, high bits folded in)."""
    x = np.uint64(code) * np.uint64(0x9E3779B97F4A7C15)
    return np.int64((x ^ (x >> np.uint64(29))) & mask)


@_jit
def mix(code):
    """Sixty-four well-mixed bits of a number (SplitMix64)."""
    x = np.uint64(code) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@_jit
def cell_rank(i, j, k):
    """A number of a cell that looks random."""
    return mix((np.int64(i) * KEY + np.int64(j)) * KEY + np.int64(k))


@_jit
def ranks_of(cell):
    """The rank of each cell (m, 3)."""
    out = np.empty(cell.shape[0], np.uint64)
    for i in range(cell.shape[0]):
        out[i] = cell_rank(cell[i, 0], cell[i, 1], cell[i, 2])
    return out


@_jit
def voxel_sums(xyz, low, edge, shape, quantum, first, most):
    """Points and sums of whole-number coordinates in each filled voxel, in no order.

    xyz (n, 3); voxel (i, j, k) of `shape` begins at low + edge (i, j, k) and has the code
    (i shape[1] + j) shape[2] + k; points outside are left out. Coordinates are counted in `quantum` from
    `low`, so that sums do not depend on the order of the points. Of more than `most` filled voxels those of
    the lowest :func:`cell_rank` are kept; their places are counted from `first` (3,). Returns code (m,),
    sums (m, 4): x, y, z, points, and rank (m,).

    Whenever twice as many are filled, the higher half is forgotten, and from then on no point of theirs is
    looked at twice: a voxel of those kept in the end was never forgotten.
    """
    size = 1 << 12
    key = np.full(size, np.int64(-1))
    at = np.empty(size, np.int64)
    code = np.empty(size, np.int64)
    sums = np.zeros((size, 4), np.int64)
    ranks = np.empty(size, np.uint64)
    used, is_full, limit = 0, False, np.uint64(0)
    per_edge, per_quantum = 1.0 / edge, 1.0 / quantum
    for p in range(xyz.shape[0]):
        x, y, z = xyz[p, 0] - low[0], xyz[p, 1] - low[1], xyz[p, 2] - low[2]
        i, j, k = np.floor(x * per_edge), np.floor(y * per_edge), np.floor(z * per_edge)
        if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
            continue
        c = (np.int64(i) * shape[1] + np.int64(j)) * shape[2] + np.int64(k)
        r = np.uint64(0)
        if is_full:
            r = cell_rank(np.int64(i) + first[0], np.int64(j) + first[1], np.int64(k) + first[2])
            if r > limit:
                continue
        slot = _place(key, c)
        if key[slot] == -1:
            if not is_full:
                r = cell_rank(np.int64(i) + first[0], np.int64(j) + first[1], np.int64(k) + first[2])
            if 2 * used >= key.size:
                if used >= 2 * most:
                    limit = np.partition(ranks[:used], most - 1)[most - 1]
                    is_full = True
                    used = _forget(code, sums, ranks, used, limit)
                    if r > limit:
                        key = _table(key.size, code, at, used)
                        continue
                else:
                    size = 2 * key.size
                    code, sums = _longer(code, size), _longer(sums, size)
                    ranks, at = _longer(ranks, size), np.empty(size, np.int64)
                    key = np.empty(size, np.int64)
                key = _table(key.size, code, at, used)
                slot = _place(key, c)
            key[slot] = c
            at[slot] = used
            code[used], ranks[used] = c, r
            used += 1
        row = at[slot]
        sums[row, 0] += np.int64(np.rint(x * per_quantum))
        sums[row, 1] += np.int64(np.rint(y * per_quantum))
        sums[row, 2] += np.int64(np.rint(z * per_quantum))
        sums[row, 3] += 1
    if used > most:
        limit = np.partition(ranks[:used], most - 1)[most - 1]
        used = _forget(code, sums, ranks, used, limit)
    return code[:used].copy(), sums[:used].copy(), ranks[:used].copy()


@_jit
def _place(key, code):
    """Where a code is in a table of 2^k places, or would be."""
    mask = np.uint64(key.size - 1)
    slot = _slot(code, mask)
    while key[slot] != -1 and key[slot] != code:
        slot = (slot + 1) & (key.size - 1)
    return slot


@_jit
def _table(size, code, at, used):
    """A table of so many places with the first `used` codes in it; their rows go into `at`."""
    key = np.full(size, np.int64(-1))
    for u in range(used):
        slot = _place(key, code[u])
        key[slot] = code[u]
        at[slot] = u
    return key


@_jit
def _longer(array, size):
    """A copy with room for more rows, zero."""
    out = np.zeros((size,) + array.shape[1:], array.dtype)
    out[: array.shape[0]] = array
    return out


@_jit
def _forget(code, sums, ranks, used, limit):
    """Move the rows whose rank is at most the limit to the front, clear the others; returns their number."""
    n = 0
    for u in range(used):
        if ranks[u] <= limit:
            code[n], ranks[n] = code[u], ranks[u]
            sums[n] = sums[u]
            n += 1
    sums[n:used] = 0
    return n


@_jit
def plan_moments(xyz, middle, step, far):
    """Number of points and sums of x, y, z, x x, x y, y y in whole steps from the middle.

    Points more than `far` steps away, seen from above, are left out. Sums of whole numbers: the order means
    nothing.
    """
    out = np.zeros(7, np.int64)
    for p in range(xyz.shape[0]):
        dx, dy = (xyz[p, 0] - middle[0]) / step, (xyz[p, 1] - middle[1]) / step
        dz = (xyz[p, 2] - middle[2]) / step
        if dx * dx + dy * dy > far * far or abs(dz) > far:
            continue
        x, y = np.int64(np.rint(dx)), np.int64(np.rint(dy))
        out[0] += 1
        out[1] += x
        out[2] += y
        out[3] += np.int64(np.rint(dz))
        out[4] += x * x
        out[5] += x * y
        out[6] += y * y
    return out


@_jit
def plan_lean(xyz, middle, step, far, cos, sin):
    """Sum of the cubes of the points' ways along a horizontal direction, as `plan_moments`."""
    cubes = np.int64(0)
    for p in range(xyz.shape[0]):
        x, y = (xyz[p, 0] - middle[0]) / step, (xyz[p, 1] - middle[1]) / step
        if x * x + y * y <= far * far:
            along = np.int64(np.rint(cos * x + sin * y))
            cubes += along * along * along
    return cubes


@_jit
def _add(row, x, y, z):
    """One point more in a row of moments."""
    row[0] += 1.0
    row[1] += x
    row[2] += y
    row[3] += z
    row[4] += x * x
    row[5] += x * y
    row[6] += x * z
    row[7] += y * y
    row[8] += y * z
    row[9] += z * z


@_jit
def cell_moments(xyz, order, code):
    """Moments of the points of each cell; `order` sorts the points by their cell's `code`.

    Returns cell (k,) ascending, moments (k, N_MOMENTS), cell_of (n,) the row of each point.
    """
    n = xyz.shape[0]
    cell = np.empty(n, np.int64)
    moments = np.zeros((n, N_MOMENTS))
    cell_of = np.empty(n, np.int64)
    k = -1
    for r in range(n):
        p = order[r]
        if k < 0 or code[p] != cell[k]:
            k += 1
            cell[k] = code[p]
        cell_of[p] = k
        _add(moments[k], xyz[p, 0], xyz[p, 1], xyz[p, 2])
    return cell[: k + 1].copy(), moments[: k + 1].copy(), cell_of


@_jit
def neighbour_sums(cell, moments, stride_x, stride_y, pick):
    """Moments of some cells and the 26 around each; codes are i stride_x + j stride_y + k, ascending.

    pick (p,): rows of `cell`, ascending. The cells of one column offset are met in ascending order too: one
    pointer for each of the nine.
    """
    n = cell.size
    out = np.zeros((pick.size, moments.shape[1]))
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            shift = dx * stride_x + dy * stride_y
            first = 0
            for c in range(pick.size):
                wanted = cell[pick[c]] + shift
                while first < n and cell[first] < wanted - 1:
                    first += 1
                other = first
                while other < n and cell[other] <= wanted + 1:
                    for m in range(moments.shape[1]):
                        out[c, m] += moments[other, m]
                    other += 1
    return out


@_jit
def _axis_of(a, b, c, d, e, f, value, out):
    """Unit eigenvector of the symmetric [[a, b, c], [b, d, e], [c, e, f]] of trace 1 for a single eigenvalue.

    NaN if it is not single: any vector of a plane would do.
    """
    best = -1.0
    for pair in range(3):
        if pair == 0:
            ux, uy, uz, vx, vy, vz = a - value, b, c, b, d - value, e
        elif pair == 1:
            ux, uy, uz, vx, vy, vz = a - value, b, c, c, e, f - value
        else:
            ux, uy, uz, vx, vy, vz = b, d - value, e, c, e, f - value
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(x * x + y * y + z * z)
        if length > best:
            best = length
            if length > 0.0:
                out[0], out[1], out[2] = x / length, y / length, z / length
    if not best > SINGLE:
        out[0], out[1], out[2] = np.nan, np.nan, np.nan


@_jit
def shapes(moments, least):
    """Shape of the points behind each row of moments; NaN where they are fewer than `least`.

    Columns as N_SHAPE says: with eigenvalues l1 >= l2 >= l3 of the covariance, linearity (l1 - l2) / l1,
    planarity (l2 - l3) / l1, scattering l3 / l1, size sqrt(l1 + l2 + l3).
    """
    n = moments.shape[0]
    out = np.full((n, N_SHAPE), np.nan)
    for i in range(n):
        w = moments[i, 0]
        out[i, 0] = w
        if not w >= least:
            continue
        x, y, z = moments[i, 1] / w, moments[i, 2] / w, moments[i, 3] / w
        a, b, c = moments[i, 4] / w - x * x, moments[i, 5] / w - x * y, moments[i, 6] / w - x * z
        d, e, f = moments[i, 7] / w - y * y, moments[i, 8] / w - y * z, moments[i, 9] / w - z * z
        trace = a + d + f
        if not trace > 0.0:
            continue
        a, b, c, d, e, f = a / trace, b / trace, c / trace, d / trace, e / trace, f / trace
        q = 1.0 / 3.0
        off = b * b + c * c + e * e
        p = np.sqrt(((a - q) ** 2 + (d - q) ** 2 + (f - q) ** 2 + 2.0 * off) / 6.0)
        if p > 0.0:
            ba, bd, bf = (a - q) / p, (d - q) / p, (f - q) / p
            bb, bc, be = b / p, c / p, e / p
            half = 0.5 * (ba * (bd * bf - be * be) - bb * (bb * bf - be * bc) + bc * (bb * be - bd * bc))
            angle = np.arccos(min(max(half, -1.0), 1.0)) / 3.0
            l1 = q + 2.0 * p * np.cos(angle)
            l3 = q + 2.0 * p * np.cos(angle + 2.0 * np.pi / 3.0)
            l2 = 1.0 - l1 - l3
        else:
            l1 = l2 = l3 = q
        l3 = max(l3, 0.0)
        out[i, 1] = (l1 - l2) / l1
        out[i, 2] = (l2 - l3) / l1
        out[i, 3] = l3 / l1
        out[i, 4] = np.sqrt(trace)
        _axis_of(a, b, c, d, e, f, l1, out[i, 5:8])
        _axis_of(a, b, c, d, e, f, l3, out[i, 8:11])
    return out


@_jit
def _on_chain(way, position, first, last, node, at, out):
    """Position at a way along the chain whose nodes are node[first:last], held at its ends."""
    if at <= 0.0:
        out[:] = position[node[first]]
        return
    if at >= way[last - 1]:
        out[:] = position[node[last - 1]]
        return
    low, high = first, last - 1
    while high - low > 1:
        middle = (low + high) // 2
        if way[middle] <= at:
            low = middle
        else:
            high = middle
    part = (at - way[low]) / max(way[high] - way[low], 1e-300)
    for c in range(3):
        a = position[node[low], c]
        out[c] = a + part * (position[node[high], c] - a)


@_jit
def _angle(ax, ay, az, bx, by, bz):
    """Angle between two vectors; NaN if one has no length."""
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    dot = ax * bx + ay * by + az * bz
    across = np.sqrt(x * x + y * y + z * z)
    return np.arctan2(across, dot) if across > 0.0 or dot != 0.0 else np.nan


@_jit
def branch_table(position, radius, start, node, reach):
    """What is known of each chain of a tree, in columns.

    start (c + 1,), node (k,): the chains, root side first, a chain after the one that it leaves. Directions
    are taken over `reach`. Returns parent (c,) the chain that it leaves, -1 for none, and columns (c, 13):
    length, chord, rise of the chord, largest radius and first radius of its own nodes, radius of the parent
    there, accumulated bend over steps of reach, way along the parent and height where it leaves, angle to the
    parent, first direction (3).
    """
    n = start.size - 1
    parent = np.full(n, np.int64(-1))
    out = np.full((n, 13), np.nan)
    way = np.zeros(node.size)
    chain_of = np.full(position.shape[0], np.int64(-1))
    place = np.empty(position.shape[0], np.int64)
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        first, last = start[k], start[k + 1]
        foot = node[first]
        if chain_of[foot] < 0:
            chain_of[foot] = k
            place[foot] = first
        else:
            parent[k] = chain_of[foot]
        thickest = np.nan
        for r in range(first + 1, last):
            d = position[node[r]] - position[node[r - 1]]
            way[r] = way[r - 1] + np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            chain_of[node[r]] = k
            place[node[r]] = r
            value = radius[node[r]]
            if value > thickest or np.isnan(thickest):
                thickest = value
        if last - first < 2:
            out[k, 0] = 0.0
            continue
        length = way[last - 1]
        chord = position[node[last - 1]] - position[foot]
        straight = np.sqrt(chord[0] * chord[0] + chord[1] * chord[1] + chord[2] * chord[2])
        out[k, 0], out[k, 1], out[k, 2] = length, straight, chord[2]
        out[k, 3], out[k, 4] = thickest, radius[node[first + 1]]
        bend = 0.0
        step = max(reach, length / MAX_STEPS)
        at = step
        while step > 0.0 and at + step <= length:
            _on_chain(way, position, first, last, node, at - step, a)
            _on_chain(way, position, first, last, node, at, b)
            _on_chain(way, position, first, last, node, at + step, c)
            turn = _angle(b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - b[0], c[1] - b[1], c[2] - b[2])
            if turn == turn:
                bend += turn
            at += step
        out[k, 6] = bend
        _on_chain(way, position, first, last, node, reach, b)
        b -= position[foot]
        long = np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2])
        if long > 0.0:
            out[k, 10], out[k, 11], out[k, 12] = b[0] / long, b[1] / long, b[2] / long
        p = parent[k]
        if p >= 0:
            at = way[place[foot]]
            out[k, 5], out[k, 7], out[k, 8] = radius[foot], at, position[foot, 2]
            _on_chain(way, position, start[p], start[p + 1], node, at - reach, a)
            _on_chain(way, position, start[p], start[p + 1], node, at + reach, c)
            out[k, 9] = _angle(c[0] - a[0], c[1] - a[1], c[2] - a[2], b[0], b[1], b[2])
    return parent, out


@_jit
def sample_moments(xyz, rank, order, cell, first, stride_x, stride_y, k, parts, pick):
    """Moments of samples of `k` points from some cells and the 26 around each: those of lowest rank.

    order: the points by cell, those of cell c at first[c]:first[c + 1], by rank. pick (p,): rows of `cell`,
    ascending. Returns (p, parts, N_MOMENTS): the k lowest, the next k, and so on; zero where there are not
    that many.
    """
    n = cell.size
    out = np.zeros((pick.size, parts, N_MOMENTS))
    most = k * parts
    best = np.empty(most, np.uint64)
    who = np.empty(most, np.int64)
    begin = np.zeros(9, np.int64)
    for c in range(pick.size):
        found = 0
        column = 0
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                wanted = cell[pick[c]] + dx * stride_x + dy * stride_y
                at = begin[column]
                while at < n and cell[at] < wanted - 1:
                    at += 1
                begin[column] = at
                column += 1
                while at < n and cell[at] <= wanted + 1:
                    for r in range(first[at], first[at + 1]):
                        p = order[r]
                        value = rank[p]
                        if found == most and value >= best[most - 1]:
                            break
                        if found < most:
                            found += 1
                        j = found - 1
                        while j > 0 and best[j - 1] > value:
                            best[j], who[j] = best[j - 1], who[j - 1]
                            j -= 1
                        best[j], who[j] = value, p
                    at += 1
        for part in range(found // k):
            for j in range(part * k, (part + 1) * k):
                p = who[j]
                _add(out[c, part], xyz[p, 0], xyz[p, 1], xyz[p, 2])
    return out


@_jit
def hull_table(vertices, faces, first_vertex, first_face):
    """Measures of closed triangle meshes, one after the other in the arrays; NaN without vertices.

    faces: rows of `vertices`. Returns (k, 9): volume, surface, lowest and highest z, longer and shorter
    extent, seen from above along the principal directions, and the mean vertex (3).
    """
    n = first_vertex.size - 1
    out = np.full((n, 9), np.nan)
    for k in range(n):
        a, b = first_vertex[k], first_vertex[k + 1]
        if a == b:
            continue
        row = out[k]
        row[6:] = 0.0
        row[2], row[3] = np.inf, -np.inf
        for v in range(a, b):
            for c in range(3):
                row[6 + c] += vertices[v, c] / (b - a)
            row[2], row[3] = min(row[2], vertices[v, 2]), max(row[3], vertices[v, 2])
        volume = surface = 0.0
        for f in range(first_face[k], first_face[k + 1]):
            p, q, r = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
            ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            volume += ((p[0] - row[6]) * x + (p[1] - row[7]) * y + (p[2] - row[8]) * z) / 6.0
            surface += 0.5 * np.sqrt(x * x + y * y + z * z)
        row[0], row[1] = abs(volume), surface
        xx = xy = yy = 0.0
        for v in range(a, b):
            x, y = vertices[v, 0] - row[6], vertices[v, 1] - row[7]
            xx += x * x
            xy += x * y
            yy += y * y
        angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
        cos, sin = np.cos(angle), np.sin(angle)
        low_along = low_across = np.inf
        high_along = high_across = -np.inf
        for v in range(a, b):
            along = cos * vertices[v, 0] + sin * vertices[v, 1]
            across = cos * vertices[v, 1] - sin * vertices[v, 0]
            low_along, high_along = min(low_along, along), max(high_along, along)
            low_across, high_across = min(low_across, across), max(high_across, across)
        row[4], row[5] = high_along - low_along, high_across - low_across
    return out
