"""Compiled chance, closed hulls and rotations. Arrays in, arrays out; nothing is checked here."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath


@_jit
def next_random(state):
    """A number in [0, 1), and the next state (SplitMix64, in place)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@_jit
def hull_volume(vertices, faces):
    """Volume that closed faces enclose."""
    total = 0.0
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        total += a[0] * (b[1] * c[2] - b[2] * c[1])
        total += a[1] * (b[2] * c[0] - b[0] * c[2])
        total += a[2] * (b[0] * c[1] - b[1] * c[0])
    return total / 6.0


@_jit
def fill_columns(vertices, faces, low, cell, n_x, n_y, n_z, inside):
    """Mark the cells whose middles lie in a closed hull: crossings of a column flip what is above them."""
    inside[: n_x * n_y * n_z] = False
    for f in range(faces.shape[0]):
        ax, ay, az = vertices[faces[f, 0]]
        bx, by, bz = vertices[faces[f, 1]]
        cx, cy, cz = vertices[faces[f, 2]]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        x0 = max(0, int(math.ceil((min(ax, bx, cx) - low[0]) / cell - 0.5)))
        x1 = min(n_x - 1, int(math.floor((max(ax, bx, cx) - low[0]) / cell - 0.5)))
        y0 = max(0, int(math.ceil((min(ay, by, cy) - low[1]) / cell - 0.5)))
        y1 = min(n_y - 1, int(math.floor((max(ay, by, cy) - low[1]) / cell - 0.5)))
        for i in range(x0, x1 + 1):
            px = low[0] + (i + 0.5) * cell
            for j in range(y0, y1 + 1):
                py = low[1] + (j + 0.5) * cell
                u = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area
                v = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                z = u * az + v * bz + w * cz
                k0 = max(0, int(math.ceil((z - low[2]) / cell - 0.5)))
                base = (i * n_y + j) * n_z
                for k in range(k0, n_z):
                    inside[base + k] = not inside[base + k]


@_jit
def frame_of(dx, dy, dz, roll, out):
    """Rotation (3, 3) that takes z to a direction, and x to what is up across it, turned by `roll`."""
    ux, uy, uz = -dz * dx, -dz * dy, 1.0 - dz * dz
    size = math.sqrt(ux * ux + uy * uy + uz * uz)
    if size < 1e-6:  # straight up or down: any side is as good
        ux, uy, uz, size = 1.0, 0.0, 0.0, 1.0
        dot = ux * dx
        ux, uy, uz = ux - dot * dx, -dot * dy, -dot * dz
        size = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / size, uy / size, uz / size
    vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
    c, s = math.cos(roll), math.sin(roll)
    out[0, 0], out[1, 0], out[2, 0] = c * ux + s * vx, c * uy + s * vy, c * uz + s * vz
    out[0, 1], out[1, 1], out[2, 1] = c * vx - s * ux, c * vy - s * uy, c * vz - s * uz
    out[0, 2], out[1, 2], out[2, 2] = dx, dy, dz


@_jit
def quaternion_of(m, out):
    """Unit quaternion x, y, z, w of a rotation matrix (Shepperd's method)."""
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace > 0.0:
        s = 2.0 * math.sqrt(trace + 1.0)
        x, y, z, w = (m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s, 0.25 * s
    elif m[0, 0] > m[1, 1] and m[0, 0] > m[2, 2]:
        s = 2.0 * math.sqrt(1.0 + m[0, 0] - m[1, 1] - m[2, 2])
        x, y, z, w = 0.25 * s, (m[0, 1] + m[1, 0]) / s, (m[0, 2] + m[2, 0]) / s, (m[2, 1] - m[1, 2]) / s
    elif m[1, 1] > m[2, 2]:
        s = 2.0 * math.sqrt(1.0 + m[1, 1] - m[0, 0] - m[2, 2])
        x, y, z, w = (m[0, 1] + m[1, 0]) / s, 0.25 * s, (m[1, 2] + m[2, 1]) / s, (m[0, 2] - m[2, 0]) / s
    else:
        s = 2.0 * math.sqrt(1.0 + m[2, 2] - m[0, 0] - m[1, 1])
        x, y, z, w = (m[0, 2] + m[2, 0]) / s, (m[1, 2] + m[2, 1]) / s, 0.25 * s, (m[1, 0] - m[0, 1]) / s
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    out[0], out[1], out[2], out[3] = x / norm, y / norm, z / norm, w / norm
