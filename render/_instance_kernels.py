"""Compiled loops that put instances in place. Arrays in, arrays filled; nothing is checked here."""

import numpy as np
from numba import njit

FLOAT = np.float32
_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath


@_jit
def sort_instances(
    patch, order, position, rotation, scale, start, out_row, out_position, out_rotation, out_scale
):
    """Fill the tables patch by patch, in ``order`` within each; ``start`` (p + 1,) says where each begins."""
    start[:] = 0
    for i in range(patch.size):
        start[patch[i] + 1] += 1
    for g in range(start.size - 1):
        start[g + 1] += start[g]
    place = start[:-1].copy()
    for k in range(order.size):
        i = order[k]
        at = place[patch[i]]
        place[patch[i]] = at + 1
        out_row[at] = i
        for c in range(3):
            out_position[at, c] = position[i, c]
        for c in range(4):
            out_rotation[at, c] = rotation[i, c]
        out_scale[at] = scale[i]


@_jit
def turn_points(u, v, w, m, scale, x, y, z, out):
    """A matrix times points given by coordinate, times a scale, plus a shift; ``out`` is x, y, z, x, ...

    Coordinates apart on the way in, one flat array on the way out and single precision throughout: so it is
    compiled to vector instructions, and four times as fast as from rows to rows.
    """
    a, b, c = FLOAT(scale * m[0, 0]), FLOAT(scale * m[0, 1]), FLOAT(scale * m[0, 2])
    d, e, f = FLOAT(scale * m[1, 0]), FLOAT(scale * m[1, 1]), FLOAT(scale * m[1, 2])
    g, h, k = FLOAT(scale * m[2, 0]), FLOAT(scale * m[2, 1]), FLOAT(scale * m[2, 2])
    for j in range(u.size):
        p, q, r = u[j], v[j], w[j]
        out[3 * j] = a * p + b * q + c * r + x
        out[3 * j + 1] = d * p + e * q + f * r + y
        out[3 * j + 2] = g * p + h * q + k * r + z


@_jit
def place_vertices(
    first, last, patch, position, rotation, scale, vertex_start, in_vertex, in_normal, vertex_at,
    out_vertex, out_normal,
):  # fmt: skip
    """Turn, scale and shift the vertices (3, v) of instances ``first`` to ``last`` into flat arrays."""
    m = np.empty((3, 3))
    nil = FLOAT(0.0)
    for i in range(first, last):
        x, y, z, w = (
            float(rotation[i, 0]), float(rotation[i, 1]), float(rotation[i, 2]), float(rotation[i, 3]),
        )  # fmt: skip
        m[0, 0], m[0, 1], m[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)
        m[1, 0], m[1, 1], m[1, 2] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)
        m[2, 0], m[2, 1], m[2, 2] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)
        begin, end = vertex_start[patch[i]], vertex_start[patch[i] + 1]
        at, to = 3 * vertex_at[i], 3 * vertex_at[i + 1]
        vertex, normal = in_vertex[:, begin:end], in_normal[:, begin:end]
        px, py, pz = position[i, 0], position[i, 1], position[i, 2]
        turn_points(vertex[0], vertex[1], vertex[2], m, scale[i], px, py, pz, out_vertex[at:to])
        turn_points(normal[0], normal[1], normal[2], m, 1.0, nil, nil, nil, out_normal[at:to])


@_jit
def place_faces(first, last, patch, face_start, in_face, face_at, vertex_at, out_face):
    """Number the faces of instances ``first`` to ``last`` on from where their vertices begin."""
    for i in range(first, last):
        face = in_face[face_start[patch[i]] : face_start[patch[i] + 1]]
        to = out_face[face_at[i] : face_at[i + 1]]
        shift = np.int32(vertex_at[i])
        for j in range(face.shape[0]):
            to[j, 0] = face[j, 0] + shift
            to[j, 1] = face[j, 1] + shift
            to[j, 2] = face[j, 2] + shift


@_jit
def wrap_tubes(vertex, start, tile, uv):
    """Repeat a bark image of ``tile`` metres around and along tubes whose vertices begin at ``start``.

    Around, as many whole times as fit the tube's longest ring best: neighbours on a ring have rising u.
    """
    for k in range(start.size - 1):
        girth = 0.0
        for i in range(start[k], start[k + 1] - 1):
            step = uv[i + 1, 0] - uv[i, 0]
            if step > 0.0:
                x, y, z = (
                    vertex[i + 1, 0] - vertex[i, 0],
                    vertex[i + 1, 1] - vertex[i, 1],
                    vertex[i + 1, 2] - vertex[i, 2],
                )
                girth = max(girth, np.sqrt(x * x + y * y + z * z) / step)
        times = max(np.floor(girth / tile + 0.5), 1.0)
        for i in range(start[k], start[k + 1]):
            uv[i, 0] *= times
            uv[i, 1] /= tile


@_jit
def repeat_rows(first, last, patch, vertex_start, in_item, vertex_at, width, out_item):
    """Copy what all instances of a patch have in common, ``width`` items a vertex; flat arrays."""
    for i in range(first, last):
        item = in_item[width * vertex_start[patch[i]] : width * vertex_start[patch[i] + 1]]
        to = out_item[width * vertex_at[i] : width * vertex_at[i + 1]]
        for j in range(item.size):
            to[j] = item[j]
