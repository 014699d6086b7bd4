"""Compiled loops of the skeleton: arrays in, arrays out; nothing is checked here."""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)


@_jit
def symmetric_edges(index, distance):
    """CSR of a k-nearest list (column 0 is the point itself or a double of it), both ways."""
    n, columns = index.shape
    count = np.zeros(n + 1, np.int32)
    mutual = np.zeros((n, columns), np.bool_)
    for i in range(n):
        for c in range(columns):
            j = index[i, c]
            if j == i:
                continue
            for d in range(columns):
                if index[j, d] == i:
                    mutual[i, c] = True
                    break
            count[i + 1] += 1
            if not mutual[i, c]:
                count[j + 1] += 1
    start = np.cumsum(count).astype(np.int32)
    fill = start[:-1].copy()
    neighbour = np.empty(start[n], np.int32)
    length = np.empty(start[n], np.float64)
    for i in range(n):
        for c in range(columns):
            j = index[i, c]
            if j == i:
                continue
            neighbour[fill[i]] = j
            length[fill[i]] = max(distance[i, c], 1e-9)
            fill[i] += 1
            if not mutual[i, c]:
                neighbour[fill[j]] = i
                length[fill[j]] = max(distance[i, c], 1e-9)
                fill[j] += 1
    return start, neighbour, length


@_jit
def descend_to_closest(xyz, start, neighbour, pair):
    """Walk both ends of each pair along the graph while that brings them nearer."""
    out = pair.copy()
    for p in range(pair.shape[0]):
        a, b = pair[p, 0], pair[p, 1]
        moved = True
        while moved:
            moved = False
            for end in range(2):
                here, there = (a, b) if end == 0 else (b, a)
                best = here
                dx = xyz[here] - xyz[there]
                best_d = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]
                for e in range(start[here], start[here + 1]):
                    q = neighbour[e]
                    dx = xyz[q] - xyz[there]
                    d = dx[0] * dx[0] + dx[1] * dx[1] + dx[2] * dx[2]
                    if d < best_d:
                        best_d = d
                        best = q
                if best != here:
                    moved = True
                    if end == 0:
                        a = best
                    else:
                        b = best
        out[p, 0] = a
        out[p, 1] = b
    return out


@_jit
def edges_to_keep(start, neighbour, length, before, reach):
    """Edges not longer than reach, and edges of the shortest-path tree in both directions."""
    n = start.size - 1
    keep = np.zeros(neighbour.size, np.bool_)
    for i in range(n):
        for e in range(start[i], start[i + 1]):
            j = neighbour[e]
            keep[e] = length[e] <= reach or before[i] == j or before[j] == i
    return keep


@_jit
def _find(root, i):
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@_jit
def slice_labels(start, neighbour, level):
    """Connected pieces of points that share a level, numbered by level, then by point.

    Two points of a level hang together if a way between them leaves it by no more than one level:
    thin slices of a sparsely hit trunk are full of holes.
    """
    n = level.size
    piece = np.empty(n, np.int64)
    root = np.empty(n, np.int64)
    for shift in range(3):  # slabs of three levels with the middle one at shift, shift + 3, ...
        for i in range(n):
            root[i] = i
        for i in range(n):
            slab = (level[i] - shift + 1) // 3
            for e in range(start[i], start[i + 1]):
                j = neighbour[e]
                if j < i and (level[j] - shift + 1) // 3 == slab:
                    a = _find(root, i)
                    b = _find(root, j)
                    if a != b:
                        root[max(a, b)] = min(a, b)
        for i in range(n):
            if (level[i] - shift) % 3 == 0:
                piece[i] = _find(root, i)
    order = np.argsort(level, kind="mergesort")
    label = np.full(n, -1, np.int32)
    at = np.full(n, -1, np.int32)  # number of the piece, as last met
    met = np.full(n, -1, np.int32)  # and at which level
    count = 0
    for i in order:
        g = piece[i]
        if at[g] < 0 or met[g] != level[i]:
            at[g] = count
            met[g] = level[i]
            count += 1
        label[i] = at[g]
    return label, count


@_jit
def slice_parents(label, n_slices, before):
    """For each slice the slice that most shortest paths of its points come from, -1 at the start."""
    n = label.size
    head = np.full(n_slices, -1, np.int32)
    follow = np.full(n, -1, np.int32)
    for i in range(n - 1, -1, -1):
        follow[i] = head[label[i]]
        head[label[i]] = i
    votes = np.zeros(n_slices, np.int32)
    parent = np.full(n_slices, -1, np.int32)
    for s in range(n_slices):
        best = 0
        i = head[s]
        while i >= 0:
            b = before[i]
            if b >= 0 and label[b] != s:
                p = label[b]
                votes[p] += 1
                if votes[p] > best or (votes[p] == best and p < parent[s]):
                    best = votes[p]
                    parent[s] = p
            i = follow[i]
        i = head[s]
        while i >= 0:
            b = before[i]
            if b >= 0:
                votes[label[b]] = 0
            i = follow[i]
    return parent


@_jit
def group_means(xyz, label, n_groups):
    """Mean position and number of points of each group."""
    mean = np.zeros((n_groups, 3))
    count = np.zeros(n_groups, np.int32)
    for i in range(label.size):
        g = label[i]
        if g < 0:
            continue
        count[g] += 1
        for c in range(3):
            mean[g, c] += xyz[i, c]
    for g in range(n_groups):
        for c in range(3):
            mean[g, c] /= max(count[g], 1)
    return mean, count


@_jit
def insert_edges(start, neighbour, length, pair, gap):
    """The CSR graph with further directed edges added behind the others of each point."""
    n = start.size - 1
    count = np.zeros(n + 1, np.int32)
    for i in range(n):
        count[i + 1] = start[i + 1] - start[i]
    for p in range(pair.shape[0]):
        count[pair[p, 0] + 1] += 1
    new_start = np.cumsum(count).astype(np.int32)
    out = np.empty(new_start[n], np.int32)
    out_length = np.empty(new_start[n], np.float64)
    fill = new_start[:-1].copy()
    for i in range(n):
        for e in range(start[i], start[i + 1]):
            out[fill[i]] = neighbour[e]
            out_length[fill[i]] = length[e]
            fill[i] += 1
    for p in range(pair.shape[0]):
        i = pair[p, 0]
        out[fill[i]] = pair[p, 1]
        out_length[fill[i]] = gap[p]
        fill[i] += 1
    return new_start, out, out_length


@_jit
def paths_through(order, before):
    """How many shortest paths run through each point, its own included. `order`: nearest first."""
    count = np.ones(before.size, np.int32)
    for k in range(order.size - 1, -1, -1):
        i = order[k]
        if before[i] >= 0:
            count[before[i]] += count[i]
    return count


@_jit
def slice_extents(xyz, label, mean, count):
    """Root mean square distance of the points of each group from their mean, and how much the
    distances vary: their standard deviation over their mean, 0 for a ring, 0.35 for a disc."""
    n_groups = mean.shape[0]
    square = np.zeros(n_groups)
    first = np.zeros(n_groups)
    for i in range(label.size):
        g = label[i]
        d = 0.0
        for c in range(3):
            d += (xyz[i, c] - mean[g, c]) ** 2
        square[g] += d
        first[g] += np.sqrt(d)
    extent = np.empty(n_groups)
    variation = np.empty(n_groups)
    for g in range(n_groups):
        n = max(count[g], 1)
        extent[g] = np.sqrt(square[g] / n)
        middle = first[g] / n
        variation[g] = np.sqrt(max(square[g] / n - middle * middle, 0.0)) / max(middle, 1e-12)
    return extent, variation


@_jit
def slice_flow(label, n_slices, before, through):
    """Number of shortest paths that run through each slice (entering it from below)."""
    flow = np.zeros(n_slices)
    for i in range(label.size):
        b = before[i]
        if b < 0 or label[b] != label[i]:
            flow[label[i]] += through[i]
    return flow


@_jit
def split_slices(label, too_wide, back, distance, before):
    """Split wide groups into bundles of points whose paths were one point `back[g]` ago.

    Returns new labels, in the order of the old ones.
    """
    n = label.size
    n_groups = too_wide.size
    ancestor = np.full(n, -1, np.int32)
    for i in range(n):
        g = label[i]
        if too_wide[g]:
            a = i
            while before[a] >= 0 and distance[i] - distance[a] < back[g]:
                a = before[a]
            ancestor[i] = a
    head = np.full(n_groups, -1, np.int32)
    follow = np.full(n, -1, np.int32)
    for i in range(n - 1, -1, -1):
        follow[i] = head[label[i]]
        head[label[i]] = i
    out = np.empty(n, np.int32)
    bundle = np.full(n, -1, np.int32)
    count = 0
    for g in range(n_groups):
        i = head[g]
        if not too_wide[g]:
            while i >= 0:
                out[i] = count
                i = follow[i]
            count += 1
            continue
        first = count
        while i >= 0:
            a = ancestor[i]
            if bundle[a] < first:
                bundle[a] = count
                count += 1
            out[i] = bundle[a]
            i = follow[i]
    return out, count


@_jit
def _spread_bits(v):
    """Put two zero bits between the low 21 bits of v."""
    v = (v | (v << 32)) & 0x1F00000000FFFF
    v = (v | (v << 16)) & 0x1F0000FF0000FF
    v = (v | (v << 8)) & 0x100F00F00F00F00F
    v = (v | (v << 4)) & 0x10C30C30C30C30C3
    return (v | (v << 2)) & 0x1249249249249249


@_jit
def morton_codes(xyz, low, cell):
    """Z-order code of each point."""
    n = xyz.shape[0]
    out = np.empty(n, np.int64)
    for i in range(n):
        x = np.int64((xyz[i, 0] - low[0]) / cell)
        y = np.int64((xyz[i, 1] - low[1]) / cell)
        z = np.int64((xyz[i, 2] - low[2]) / cell)
        out[i] = _spread_bits(x) | (_spread_bits(y) << 1) | (_spread_bits(z) << 2)
    return out


@_jit
def wide_slices(parent, extent, variation, count, widest, ring, few, growth, share):
    """True for slices wider than `widest` that are neither a ring nor the sequel of a tube.

    A ring has at least `few` points whose distances from the middle vary by at most `ring`. The sequel
    of a tube follows a slice that is not too wide, as the only child of more than `share` of its
    points, and is no more than `growth` times as wide as the tube was where it last was narrow enough.
    """
    n = parent.size
    out = np.zeros(n, np.bool_)
    heirs = np.zeros(n, np.int32)
    for i in range(1, n):
        if count[i] > share * count[parent[i]]:
            heirs[parent[i]] += 1
    tube = extent.copy()
    for i in range(1, n):
        if extent[i] <= widest[i] or (variation[i] <= ring and count[i] >= few):
            continue
        p = parent[i]
        if not out[p] and heirs[p] == 1 and count[i] > share * count[p] and extent[i] <= growth * tube[p]:
            tube[i] = tube[p]
        else:
            out[i] = True
    return out
