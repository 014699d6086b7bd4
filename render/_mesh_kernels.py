"""Compiled loops that turn chains of nodes into tubes. Arrays in, arrays filled; nothing is checked here.

Chains come parents first: a side chain's first node is a later node of a chain before it. The control
points, rings, vertices and faces of chain c are the rows ``start[c]:start[c + 1]`` of their arrays.
"""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

NO_CHAIN = -1
SAME_POINT = 1e-9  # metres: nodes closer than this are one control point
CONTAINED = 0.95  # a side chain's first ring fills at most this part of its parent's inner circle
FULL_TURN = 1e-6  # length of the sum of two unit vectors below which they are opposite
LONGEST_GAP = 64  # rings: no more than these are left out in a row
CONTROLS_PER_NODE = 3  # the node, and at most two points on the segment behind it


@_jit
def copy_row(source, i, target, j):
    """Copy row i of an (n, 3) array to row j of another. Loops compile several times faster than slices."""
    for d in range(3):
        target[j, d] = source[i, d]


@_jit
def distance(a, i, b, j):
    """Distance between row i of one (n, 3) array and row j of another."""
    x, y, z = b[j, 0] - a[i, 0], b[j, 1] - a[i, 1], b[j, 2] - a[i, 2]
    return np.sqrt(x * x + y * y + z * z)


@_jit
def polyline(nodes, position, radius, start_radius, axis, point, width, index):
    """Copy one chain without its repeated points; return how many points are left.

    The first point lies on the parent's smoothed axis. ``index[i]`` is the point that the chain's
    i-th node became.
    """
    copy_row(axis, nodes[0], point, 0)
    width[0] = start_radius
    index[0] = 0
    n = 1
    for i in range(1, nodes.size):
        node = nodes[i]
        if distance(point, n - 1, position, node) > SAME_POINT:
            copy_row(position, node, point, n)
            width[n] = radius[node]
            n += 1
        index[i] = n - 1
    return n


@_jit
def corner_reach(point, width, n, tolerance, tolerance_radii, reach):
    """How far from each point its neighbours may be before the spline cuts the corner too much.

    At a knot the spline lies (P[i-1] - 2 P[i] + P[i+1]) / 6 away from P[i], Eq. (6.7) at t = 0. With both
    neighbours at a distance d that is d |u - w| / 6, where u and w are the unit directions before and after
    the corner. The reach is the d at which this equals the tolerance: infinite where the chain is straight.
    """
    reach[0] = np.inf
    reach[n - 1] = np.inf
    for i in range(1, n - 1):
        before = distance(point, i - 1, point, i)
        after = distance(point, i, point, i + 1)
        bend = 0.0
        for d in range(3):
            turn = (point[i + 1, d] - point[i, d]) / after - (point[i, d] - point[i - 1, d]) / before
            bend += turn * turn
        allowed = min(tolerance, tolerance_radii * width[i])
        reach[i] = 6.0 * allowed / np.sqrt(bend) if bend > 0.0 else np.inf


@_jit
def segment_cuts(length, reach_a, reach_b, cut):
    """Fill ``cut`` with the distances at which control points are put on a segment; return how many."""
    if reach_a >= length and reach_b >= length:
        return 0
    low = max(length - reach_b, 0.0)
    high = min(reach_a, length)
    if low <= high:
        cut[0] = min(max(0.5 * length, low), high)
        return 1
    cut[0] = min(reach_a, 0.5 * length)
    cut[1] = length - min(reach_b, 0.5 * length)
    return 2


@_jit
def place_controls(point, width, n, reach, control, control_width, segment, control_of_point):
    """Fill the control polygon of one chain; return its number of points.

    ``segment[k]`` is the point that ends the segment on which control point k lies (1 at the first).
    """
    cut = np.empty(2)
    copy_row(point, 0, control, 0)
    control_width[0] = width[0]
    segment[0] = 1
    control_of_point[0] = 0
    fill = 1
    for i in range(n - 1):
        length = distance(point, i, point, i + 1)
        for k in range(segment_cuts(length, reach[i], reach[i + 1], cut)):
            t = cut[k] / length
            for d in range(3):
                control[fill, d] = point[i, d] + t * (point[i + 1, d] - point[i, d])
            control_width[fill] = (1.0 - t) * width[i] + t * width[i + 1]
            segment[fill] = i + 1
            fill += 1
        copy_row(point, i + 1, control, fill)
        control_width[fill] = width[i + 1]
        segment[fill] = i + 1
        control_of_point[i + 1] = fill
        fill += 1
    return fill


@_jit
def start_width(own, parent_axis_radius, sides, parent_sides):
    """Radius with which a side chain starts: its own, as far as its corners stay inside the parent."""
    inner = parent_axis_radius * ring_scale(parent_sides) * np.cos(np.pi / parent_sides)
    return min(own, CONTAINED * inner / ring_scale(sides))


@_jit
def ring_scale(sides):
    """Corner distance of the regular polygon whose area is that of the unit circle."""
    angle = 2.0 * np.pi / sides
    return np.sqrt(angle / np.sin(angle))


@_jit
def build_controls(
    chain_start, chain_node, position, radius, sides, tolerance, tolerance_radii,
    control, control_width, control_node, control_start,
):  # fmt: skip
    """Fill the control polygons of all chains; an empty one for a chain without length."""
    n_nodes = radius.size
    axis = position.copy()
    axis_radius = radius.copy()
    owner = np.full(n_nodes, NO_CHAIN, np.int64)
    longest = 0
    for c in range(chain_start.size - 1):
        longest = max(longest, chain_start[c + 1] - chain_start[c])
    point = np.empty((longest, 3))
    width = np.empty(longest)
    reach = np.empty(longest)
    index = np.empty(longest, np.int64)
    control_of_point = np.empty(longest, np.int64)
    segment = np.empty(CONTROLS_PER_NODE * longest, np.int64)
    last_of_point = np.empty(longest, np.int64)
    fill = 0
    control_start[0] = 0
    for c in range(chain_start.size - 1):
        nodes = chain_node[chain_start[c] : chain_start[c + 1]]
        base = radius[nodes[0]]
        if owner[nodes[0]] != NO_CHAIN and nodes.size > 1:
            base = start_width(radius[nodes[1]], axis_radius[nodes[0]], sides[c], sides[owner[nodes[0]]])
        n = polyline(nodes, position, radius, base, axis, point, width, index)
        for i in range(nodes.size):
            last_of_point[index[i]] = nodes[i]
            if owner[nodes[i]] == NO_CHAIN:
                owner[nodes[i]] = c
        count = 0
        if n > 1:
            corner_reach(point, width, n, tolerance, tolerance_radii, reach)
            out = control[fill:]
            out_width = control_width[fill:]
            count = place_controls(point, width, n, reach, out, out_width, segment, control_of_point)
            for k in range(count):
                control_node[fill + k] = last_of_point[segment[k]]
        for i in range(1, nodes.size):
            copy_row(point, index[i], axis, nodes[i])
            if 0 < index[i] < n - 1:
                k = control_of_point[index[i]]
                for d in range(3):
                    axis[nodes[i], d] = (out[k - 1, d] + 4.0 * out[k, d] + out[k + 1, d]) / 6.0
                axis_radius[nodes[i]] = (out_width[k - 1] + 4.0 * out_width[k] + out_width[k + 1]) / 6.0
        fill += count
        control_start[c + 1] = fill


@_jit
def blend(t, weight):
    """Fill the four weights of a uniform cubic B-spline, Eq. (6.7)."""
    s = 1.0 - t
    weight[0] = s * s * s / 6.0
    weight[1] = (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0
    weight[2] = (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0
    weight[3] = t * t * t / 6.0


@_jit
def span_points(control, first, last, k, support):
    """The four control points of span k ... k + 1; mirrored beyond either end to clamp it there."""
    for d in range(3):
        support[1, d] = control[k, d]
        support[2, d] = control[k + 1, d]
        support[0, d] = control[k - 1, d] if k > first else 2.0 * control[k, d] - control[k + 1, d]
        support[3, d] = control[k + 2, d] if k + 2 < last else 2.0 * control[k + 1, d] - control[k, d]


@_jit
def angle_between(ax, ay, az, bx, by, bz):
    """Angle between two vectors, radians; 0 if one of them has no length."""
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return np.arctan2(np.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz)


@_jit
def span_turn(p):
    """How far a span turns, radians: from its first tangent to its chord, and on to its last tangent."""
    ax, ay, az = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    bx, by, bz = p[3, 0] - p[1, 0], p[3, 1] - p[1, 1], p[3, 2] - p[1, 2]
    # The chord of Eq. (6.7) from t = 0 to 1.
    cx = (p[3, 0] + 3.0 * (p[2, 0] - p[1, 0]) - p[0, 0]) / 6.0
    cy = (p[3, 1] + 3.0 * (p[2, 1] - p[1, 1]) - p[0, 1]) / 6.0
    cz = (p[3, 2] + 3.0 * (p[2, 2] - p[1, 2]) - p[0, 2]) / 6.0
    return angle_between(ax, ay, az, cx, cy, cz) + angle_between(cx, cy, cz, bx, by, bz)


@_jit
def count_rings(control, control_start, steps, max_turn, span_steps, ring_start):
    """Choose the steps of every span from how far it turns; fill where each chain's rings start."""
    support = np.empty((4, 3))
    fill = 0
    ring_start[0] = 0
    for c in range(control_start.size - 1):
        first, last = control_start[c], control_start[c + 1]
        for k in range(first, last - 1):
            span_points(control, first, last, k, support)
            turn = span_turn(support)
            span_steps[k] = min(max(int(np.ceil(turn / max_turn)), 1), steps)
            fill += span_steps[k]
        if last > first:
            fill += 1
        ring_start[c + 1] = fill


@_jit
def fill_rings(control, control_width, control_node, control_start, span_steps, centre, width, node):
    """Evaluate the splines: centre, radius and node of every ring."""
    support = np.empty((4, 3))
    weight = np.empty(4)
    ring = 0
    for c in range(control_start.size - 1):
        first, last = control_start[c], control_start[c + 1]
        for k in range(first, last - 1):
            span_points(control, first, last, k, support)
            w1, w2 = control_width[k], control_width[k + 1]
            w0 = control_width[k - 1] if k > first else 2.0 * w1 - w2
            w3 = control_width[k + 2] if k + 2 < last else 2.0 * w2 - w1
            n = span_steps[k]
            for step in range(n + (k == last - 2)):  # the last span brings its end as well
                blend(step / n, weight)
                for d in range(3):
                    centre[ring, d] = (
                        weight[0] * support[0, d]
                        + weight[1] * support[1, d]
                        + weight[2] * support[2, d]
                        + weight[3] * support[3, d]
                    )
                width[ring] = weight[0] * w0 + weight[1] * w1 + weight[2] * w2 + weight[3] * w3
                node[ring] = control_node[k + 1] if step > 0 or k == first else control_node[k]
                ring += 1


@_jit
def fits_without(centre, width, i, j, error):
    """Whether a tube straight from ring i to ring j strays by at most ``error`` radii at those between."""
    length = distance(centre, i, centre, j)
    for k in range(i + 1, j):
        t = 0.0
        for d in range(3):
            t += (centre[k, d] - centre[i, d]) * (centre[j, d] - centre[i, d])
        t = min(max(t / (length * length), 0.0), 1.0) if length > SAME_POINT else 0.0
        off = 0.0
        for d in range(3):
            side = centre[k, d] - centre[i, d] - t * (centre[j, d] - centre[i, d])
            off += side * side
        limit = error * width[k]
        if off > limit * limit or abs(width[k] - (1.0 - t) * width[i] - t * width[j]) > limit:
            return False
    return True


@_jit
def drop_rings(centre, width, node, ring_start, error):
    """Leave out rings that a tube does not need, moving the others up; ``ring_start`` is renewed in place."""
    fill = 0
    lo = ring_start[0]
    for c in range(ring_start.size - 1):
        hi = ring_start[c + 1]
        i = lo
        while i < hi:
            copy_row(centre, i, centre, fill)
            width[fill], node[fill] = width[i], node[i]
            fill += 1
            j = i + 1
            while j + 1 < hi and j - i < LONGEST_GAP and fits_without(centre, width, i, j + 1, error):
                j += 1
            i = j
        lo = hi
        ring_start[c + 1] = fill
    return fill


@_jit
def tangents(centre, tangent):
    """Unit tangent of each ring: it halves the angle between the pieces before and after."""
    n = centre.shape[0]
    bx, by, bz = 0.0, 0.0, 0.0
    for i in range(n):
        ax, ay, az = bx, by, bz
        for j in range(i + 1, n):  # the next ring that lies elsewhere
            length = distance(centre, i, centre, j)
            if length > SAME_POINT:
                ax = (centre[j, 0] - centre[i, 0]) / length
                ay = (centre[j, 1] - centre[i, 1]) / length
                az = (centre[j, 2] - centre[i, 2]) / length
                break
        x, y, z = ax + bx, ay + by, az + bz
        length = np.sqrt(x * x + y * y + z * z)
        if length < FULL_TURN:  # turning back, there is no middle direction
            x, y, z, length = ax, ay, az, 1.0
        tangent[i, 0], tangent[i, 1], tangent[i, 2] = x / length, y / length, z / length
        bx, by, bz = ax, ay, az


@_jit
def parallel_transport(tangent, normal):
    """Carry ``normal[0]`` along a curve without twist: Algorithm 1 of the thesis, Eqs. (6.2) to (6.5).

    The angle comes from both sine and cosine instead of the arc cosine, which loses small angles, and
    what rounding leaves of the normal along the tangent is taken off at every step.
    """
    for i in range(tangent.shape[0] - 1):
        a, b = tangent[i], tangent[i + 1]
        x = a[1] * b[2] - a[2] * b[1]
        y = a[2] * b[0] - a[0] * b[2]
        z = a[0] * b[1] - a[1] * b[0]
        sine = np.sqrt(x * x + y * y + z * z)
        v = normal[i]
        if sine == 0.0:
            copy_row(normal, i, normal, i + 1)
            continue
        x, y, z = x / sine, y / sine, z / sine
        cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        along = (x * v[0] + y * v[1] + z * v[2]) * (1.0 - cosine)
        u0 = cosine * v[0] + sine * (y * v[2] - z * v[1]) + along * x
        u1 = cosine * v[1] + sine * (z * v[0] - x * v[2]) + along * y
        u2 = cosine * v[2] + sine * (x * v[1] - y * v[0]) + along * z
        drift = u0 * b[0] + u1 * b[1] + u2 * b[2]
        u0, u1, u2 = u0 - drift * b[0], u1 - drift * b[1], u2 - drift * b[2]
        length = np.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
        normal[i + 1, 0], normal[i + 1, 1], normal[i + 1, 2] = u0 / length, u1 / length, u2 / length


@_jit
def any_normal(tangent, normal):
    """Fill a unit vector at right angles to the tangent: the axis least along it, projected."""
    axis = 0
    for d in range(1, 3):
        if abs(tangent[d]) < abs(tangent[axis]):
            axis = d
    scale = 1.0 / np.sqrt(1.0 - tangent[axis] * tangent[axis])
    for d in range(3):
        normal[d] = ((1.0 if d == axis else 0.0) - tangent[axis] * tangent[d]) * scale


@_jit
def build_tubes(
    centre, width, ring_node, ring_start, sides, vertex_start, face_start,
    vertex, normal, uv, vertex_node, face,
):  # fmt: skip
    """Fill the surface of every chain: rings with a doubled seam, and a cap at either end."""
    n_rings = centre.shape[0]
    tangent = np.empty((n_rings, 3))
    frame = np.empty((n_rings, 3))
    for c in range(ring_start.size - 1):
        lo, hi = ring_start[c], ring_start[c + 1]
        if hi - lo < 2:
            continue
        tangents(centre[lo:hi], tangent[lo:hi])
        any_normal(tangent[lo], frame[lo])
        parallel_transport(tangent[lo:hi], frame[lo:hi])
        s = sides[c]
        v = vertex_start[c]
        fill_side(
            centre[lo:hi], width[lo:hi], ring_node[lo:hi], tangent[lo:hi], frame[lo:hi], s,
            vertex[v:], normal[v:], uv[v:], vertex_node[v:],
        )  # fmt: skip
        f = stitch_rings(hi - lo, s, v, face, face_start[c])
        cap = v + (hi - lo) * (s + 1)
        last = cap - s - 1
        close_end(v, s, -1.0, tangent[lo], vertex, normal, uv, vertex_node, cap, face, f)
        close_end(last, s, 1.0, tangent[hi - 1], vertex, normal, uv, vertex_node, cap + s, face, f + s - 2)


@_jit
def fill_side(centre, width, ring_node, tangent, frame, sides, vertex, normal, uv, vertex_node):
    """Vertices, normals and texture coordinates of one tube's side."""
    n = centre.shape[0]
    scale = ring_scale(sides)
    along = 0.0
    v = 0
    for i in range(n):
        if i > 0:
            along += distance(centre, i - 1, centre, i)
        a, b = max(i - 1, 0), min(i + 1, n - 1)
        run = distance(centre, a, centre, b)
        slope = (width[b] - width[a]) / run if run > SAME_POINT else 0.0
        t, e = tangent[i], frame[i]
        g0 = t[1] * e[2] - t[2] * e[1]
        g1 = t[2] * e[0] - t[0] * e[2]
        g2 = t[0] * e[1] - t[1] * e[0]
        tilt = 1.0 / np.sqrt(1.0 + slope * slope)
        r = scale * width[i]
        for j in range(sides + 1):
            phi = 2.0 * np.pi * (j % sides) / sides  # the seam's two vertices agree to the last bit
            cosine, sine = np.cos(phi), np.sin(phi)
            x = cosine * e[0] + sine * g0
            y = cosine * e[1] + sine * g1
            z = cosine * e[2] + sine * g2
            vertex[v, 0] = centre[i, 0] + r * x
            vertex[v, 1] = centre[i, 1] + r * y
            vertex[v, 2] = centre[i, 2] + r * z
            normal[v, 0] = (x - slope * t[0]) * tilt
            normal[v, 1] = (y - slope * t[1]) * tilt
            normal[v, 2] = (z - slope * t[2]) * tilt
            uv[v, 0] = j / sides
            uv[v, 1] = along
            vertex_node[v] = ring_node[i]
            v += 1


@_jit
def stitch_rings(n_rings, sides, first_vertex, face, f):
    """Two triangles between every two neighbours of every two rings; return the next free face."""
    for i in range(n_rings - 1):
        for j in range(sides):
            a = first_vertex + i * (sides + 1) + j
            b = a + sides + 1
            face[f, 0], face[f, 1], face[f, 2] = a, a + 1, b + 1
            face[f + 1, 0], face[f + 1, 1], face[f + 1, 2] = a, b + 1, b
            f += 2
    return f


@_jit
def close_end(ring, sides, side, tangent, vertex, normal, uv, vertex_node, v, face, f):
    """A flat cap with vertices of its own; ``side`` is -1 at the start of a tube and 1 at its end."""
    for j in range(sides):
        copy_row(vertex, ring + j, vertex, v + j)
        normal[v + j, 0] = side * tangent[0]
        normal[v + j, 1] = side * tangent[1]
        normal[v + j, 2] = side * tangent[2]
        uv[v + j, 0], uv[v + j, 1] = uv[ring + j, 0], uv[ring + j, 1]
        vertex_node[v + j] = vertex_node[ring + j]
    for j in range(1, sides - 1):
        face[f, 0] = v
        face[f, 1] = v + j if side > 0 else v + j + 1
        face[f, 2] = v + j + 1 if side > 0 else v + j
        f += 1
