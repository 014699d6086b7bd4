"""Compiled loops of the cluster hulls. Arrays in, arrays out; nothing is checked here."""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

FLAT_DET = 1e-12  # of the longest edge cubed: below it a tetrahedron has no circumsphere to speak of
TIE = 1e-9  # radii closer than this share enter the complex together
SOFT_MIDPOINT = 1e-3  # pull of the edge's middle on the quadric's optimum (keeps flat quadrics solvable)
MIN_NORMAL_DOT = 0.1  # a collapse may not turn a face by more than about 84 degrees
FAR_OPTIMUM = 1.5  # of the edge length: an optimum farther from the middle is not believed


@_jit
def circumradii(xyz, tetra, out):
    """Fill ``out`` (t,) with the circumradius of each tetrahedron, inf where it is flat."""
    for t in range(tetra.shape[0]):
        o, i, j, k = tetra[t, 0], tetra[t, 1], tetra[t, 2], tetra[t, 3]
        ax, ay, az = xyz[i, 0] - xyz[o, 0], xyz[i, 1] - xyz[o, 1], xyz[i, 2] - xyz[o, 2]
        bx, by, bz = xyz[j, 0] - xyz[o, 0], xyz[j, 1] - xyz[o, 1], xyz[j, 2] - xyz[o, 2]
        cx, cy, cz = xyz[k, 0] - xyz[o, 0], xyz[k, 1] - xyz[o, 1], xyz[k, 2] - xyz[o, 2]
        aa = ax * ax + ay * ay + az * az
        bb = bx * bx + by * by + bz * bz
        cc = cx * cx + cy * cy + cz * cz
        ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx  # b x c
        vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax  # c x a
        wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx  # a x b
        det = ax * ux + ay * uy + az * uz
        longest = max(aa, max(bb, cc))
        if abs(det) <= FLAT_DET * longest * np.sqrt(longest):
            out[t] = np.inf
        else:
            x = aa * ux + bb * vx + cc * wx
            y = aa * uy + bb * vy + cc * wy
            z = aa * uz + bb * vz + cc * wz
            out[t] = 0.5 * np.sqrt(x * x + y * y + z * z) / abs(det)


@_jit
def _find(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@_jit
def _join(parent, i, j):
    """Join two sets; 1 if they were apart, else 0."""
    a, b = _find(parent, i), _find(parent, j)
    if a == b:
        return 0
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
    return 1


@_jit
def first_single_surface(order, radius, tetra, neighbour, n_vertices):
    """Rank of the last tetrahedron of the smallest complex with one closed surface.

    ``order`` sorts ``radius``. Of all prefixes of it, the first is taken that covers every vertex,
    hangs together by faces and shuts in no void (the outside counts as one more cell).
    """
    n = order.size
    rank = np.empty(n, np.int64)
    for k in range(n):
        rank[order[k]] = k
    without_void = np.empty(n, np.bool_)
    parent = np.arange(n + 1)
    n_sets = 1
    for k in range(n - 1, -1, -1):  # take the tetrahedra away again, the largest first
        without_void[k] = n_sets == 1
        t = order[k]
        n_sets += 1
        for i in range(4):
            s = neighbour[t, i]
            if s < 0:
                n_sets -= _join(parent, t, n)
            elif rank[s] > k:
                n_sets -= _join(parent, t, s)
    parent = np.arange(n + 1)
    seen = np.zeros(n_vertices, np.bool_)
    n_missing = n_vertices
    n_sets = 0
    for k in range(n):
        t = order[k]
        n_sets += 1
        for i in range(4):
            v = tetra[t, i]
            if not seen[v]:
                seen[v] = True
                n_missing -= 1
            s = neighbour[t, i]
            if s >= 0 and rank[s] < k:
                n_sets -= _join(parent, t, s)
        last = k == n - 1 or radius[order[k + 1]] > radius[t] * (1.0 + TIE)
        if last and n_missing == 0 and n_sets == 1 and without_void[k]:
            return k
    return n - 1


@_jit
def keep_largest(keep, neighbour):
    """Clear every kept tetrahedron that is not joined by faces to the largest such group."""
    n = keep.size
    parent = np.arange(n)
    for t in range(n):
        if keep[t]:
            for i in range(4):
                s = neighbour[t, i]
                if s >= 0 and keep[s]:
                    _join(parent, t, s)
    size = np.zeros(n, np.int64)
    for t in range(n):
        if keep[t]:
            size[_find(parent, t)] += 1
    best = np.argmax(size)
    for t in range(n):
        if keep[t] and _find(parent, t) != best:
            keep[t] = False


@_jit
def fill_voids(keep, neighbour):
    """Keep also what the outside cannot reach through faces of tetrahedra not kept."""
    n = keep.size
    reached = np.zeros(n, np.bool_)
    stack = np.empty(n, np.int64)
    top = 0
    for t in range(n):
        if not keep[t]:
            for i in range(4):
                if neighbour[t, i] < 0 and not reached[t]:
                    reached[t] = True
                    stack[top] = t
                    top += 1
    while top > 0:
        top -= 1
        t = stack[top]
        for i in range(4):
            s = neighbour[t, i]
            if s >= 0 and not keep[s] and not reached[s]:
                reached[s] = True
                stack[top] = s
                top += 1
    for t in range(n):
        keep[t] = not reached[t]


@_jit
def boundary_faces(xyz, tetra, neighbour, keep, out):
    """Fill ``out`` with the faces between kept and not kept, outward; their number."""
    m = 0
    for t in range(keep.size):
        if not keep[t]:
            continue
        for i in range(4):
            s = neighbour[t, i]
            if s >= 0 and keep[s]:
                continue
            a, b, c = tetra[t, (i + 1) % 4], tetra[t, (i + 2) % 4], tetra[t, (i + 3) % 4]
            normal = np.cross(xyz[b] - xyz[a], xyz[c] - xyz[a])
            if np.dot(normal, xyz[tetra[t, i]] - xyz[a]) > 0.0:
                b, c = c, b
            out[m, 0], out[m, 1], out[m, 2] = a, b, c
            m += 1
    return m


@_jit
def fill_edges(tetra, keep, bad, n_vertices):
    """Keep every tetrahedron that has one of the sorted edge keys ``bad`` (low * n + high)."""
    for t in range(keep.size):
        if keep[t]:
            continue
        for i in range(4):
            for j in range(i + 1, 4):
                a, b = tetra[t, i], tetra[t, j]
                key = min(a, b) * n_vertices + max(a, b)
                k = np.searchsorted(bad, key)
                if k < bad.size and bad[k] == key:
                    keep[t] = True


@_jit
def split_pinches(face, n_vertices, twin, source):
    """Give every fan of faces around a vertex its own vertex; the new number of vertices.

    ``face`` (f, 3) is rewritten. ``twin`` (3 f,): the opposite half-edge of half-edge 3 f + i (from
    corner i to corner i + 1). ``source`` (3 f,) is filled with the old vertex of each new one.
    """
    n = face.shape[0] * 3
    parent = np.arange(n)  # corners; the two ends of an edge are shared by the faces at its sides
    for h in range(n):
        g = twin[h]
        g_next = g - 2 if g % 3 == 2 else g + 1
        _join(parent, h, g_next)
    number = np.full(n, -1, np.int64)
    m = 0
    for h in range(n):
        root = _find(parent, h)
        if number[root] < 0:
            number[root] = m
            source[m] = face[h // 3, h % 3]
            m += 1
    for h in range(n):
        face[h // 3, h % 3] = number[_find(parent, h)]
    return m


@_jit
def _face_quadric(xyz, a, b, c, quadric, v):
    """Add the area-weighted plane quadric of a face to ``quadric[v]`` (10,)."""
    normal = np.cross(xyz[b] - xyz[a], xyz[c] - xyz[a])
    area = np.sqrt(np.dot(normal, normal))
    if area <= 0.0:
        return
    x, y, z = normal[0] / area, normal[1] / area, normal[2] / area
    d = -(x * xyz[a, 0] + y * xyz[a, 1] + z * xyz[a, 2])
    q = quadric[v]
    q[0] += area * x * x
    q[1] += area * x * y
    q[2] += area * x * z
    q[3] += area * y * y
    q[4] += area * y * z
    q[5] += area * z * z
    q[6] += area * x * d
    q[7] += area * y * d
    q[8] += area * z * d
    q[9] += area * d * d


@_jit
def _quadric_cost(q, p):
    x, y, z = p[0], p[1], p[2]
    return (
        q[0] * x * x
        + q[3] * y * y
        + q[5] * z * z
        + 2.0 * (q[1] * x * y + q[2] * x * z + q[4] * y * z + q[6] * x + q[7] * y + q[8] * z)
        + q[9]
    )


@_jit
def _place(xyz, quadric, u, v, out):
    """Fill ``out`` with the best point for edge u-v; the cost of going there."""
    q = quadric[u] + quadric[v]
    middle = 0.5 * (xyz[u] + xyz[v])
    length2 = np.dot(xyz[u] - xyz[v], xyz[u] - xyz[v])
    w = SOFT_MIDPOINT * (q[0] + q[3] + q[5])
    if w <= 0.0:
        out[:] = middle
        return length2 * 1e-12
    a00, a11, a22 = q[0] + w, q[3] + w, q[5] + w
    a01, a02, a12 = q[1], q[2], q[4]
    b0, b1, b2 = w * middle[0] - q[6], w * middle[1] - q[7], w * middle[2] - q[8]
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    det = a00 * c00 + a01 * c01 + a02 * c02
    out[0] = (c00 * b0 + c01 * b1 + c02 * b2) / det
    out[1] = (c01 * b0 + (a00 * a22 - a02 * a02) * b1 + (a01 * a02 - a00 * a12) * b2) / det
    out[2] = (c02 * b0 + (a01 * a02 - a00 * a12) * b1 + (a00 * a11 - a01 * a01) * b2) / det
    gap = out - middle
    if not np.dot(gap, gap) <= FAR_OPTIMUM * FAR_OPTIMUM * length2:
        out[:] = middle
    return _quadric_cost(q, out) + 1e-9 * w * length2


@_jit
def _has(face, f, v):
    return face[f, 0] == v or face[f, 1] == v or face[f, 2] == v


@_jit
def _common_neighbours(face, u, v, mark, stamp):
    """Number of vertices beside both u and v: two where the edge u-v may go (the link condition)."""
    common = 0
    for f in range(face.shape[0]):
        if _has(face, f, u):
            for i in range(3):
                mark[face[f, i]] = stamp
    for f in range(face.shape[0]):
        if _has(face, f, v):
            for i in range(3):
                w = face[f, i]
                if w != u and w != v and mark[w] == stamp:
                    mark[w] = -stamp
                    common += 1
    return common


@_jit
def _turns_a_face(xyz, face, u, v, place):
    """True if moving both u and v to ``place`` turns a face over or makes it vanish."""
    for f in range(face.shape[0]):
        has_u, has_v = _has(face, f, u), _has(face, f, v)
        if has_u == has_v:
            continue  # away from the edge, or gone with it
        moved = u if has_u else v
        a, b, c = xyz[face[f, 0]], xyz[face[f, 1]], xyz[face[f, 2]]
        before = np.cross(b - a, c - a)
        if face[f, 0] == moved:
            a = place
        elif face[f, 1] == moved:
            b = place
        else:
            c = place
        after = np.cross(b - a, c - a)
        scale = np.sqrt(np.dot(before, before) * np.dot(after, after))
        if np.dot(before, after) < MIN_NORMAL_DOT * scale or np.dot(after, after) <= 0.0:
            return True
    return False


@_jit
def _edge_costs(xyz, face, quadric, f, cost, place):
    """Set cost and place of the half-edges of face f; each edge is held by its rising half."""
    for i in range(3):
        u, v = face[f, i], face[f, (i + 1) % 3]
        cost[f, i] = _place(xyz, quadric, u, v, place[f, i]) if u < v else np.inf


@_jit
def collapse_edges(xyz, face, target):
    """Collapse edges of a closed mesh in place, cheapest quadric first; the faces left.

    Rows of ``face`` beyond the returned number are rubbish; ``xyz`` keeps unused rows.
    """
    n_faces = face.shape[0]
    quadric = np.zeros((xyz.shape[0], 10))
    for f in range(n_faces):
        for i in range(3):
            _face_quadric(xyz, face[f, 0], face[f, 1], face[f, 2], quadric, face[f, i])
    cost = np.empty((n_faces, 3))
    place = np.empty((n_faces, 3, 3))
    for f in range(n_faces):
        _edge_costs(xyz, face, quadric, f, cost, place)
    mark = np.zeros(xyz.shape[0], np.int64)
    stamp = 0
    while n_faces > target and n_faces > 4:
        best, at, corner = np.inf, -1, -1
        for f in range(n_faces):
            for i in range(3):
                if cost[f, i] < best:
                    best, at, corner = cost[f, i], f, i
        if at < 0:
            break
        u, v = face[at, corner], face[at, (corner + 1) % 3]
        stamp += 1
        point = place[at, corner].copy()
        ring = face[:n_faces]
        if _common_neighbours(ring, u, v, mark, stamp) != 2 or _turns_a_face(xyz, ring, u, v, point):
            cost[at, corner] = np.inf  # looked at again when something beside it changes
            continue
        xyz[u] = point
        quadric[u] += quadric[v]
        n_faces = _merge_vertex(face, n_faces, u, v, cost, place)
        for f in range(n_faces):
            if face[f, 0] == u or face[f, 1] == u or face[f, 2] == u:
                _edge_costs(xyz, face, quadric, f, cost, place)
    return n_faces


@_jit
def _merge_vertex(face, n_faces, u, v, cost, place):
    """Rename v to u and drop the two faces that had both; the faces left."""
    m = 0
    for f in range(n_faces):
        has_u, has_v = False, False
        for i in range(3):
            has_u |= face[f, i] == u
            has_v |= face[f, i] == v
        if has_u and has_v:
            continue
        for i in range(3):
            face[m, i] = u if face[f, i] == v else face[f, i]
        if m != f:
            cost[m] = cost[f]
            place[m] = place[f]
        m += 1
    return m
