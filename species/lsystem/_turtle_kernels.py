"""Compiled walk of the turtle. Arrays in, arrays filled; nothing is checked here."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

NOTHING, DRAW, MOVE, YAW, PITCH, ROLL, LEVEL, WIDTH, THIN, BEND, LEAF, PUSH, POP = range(13)

TINY = 1e-12  # sine of the smallest angle whose plane is told, radians
N_STATE = 14  # position, heading, left, up, width, bend


@_jit
def _rotate(state, a, b, angle):
    """Turn the vectors at columns a and b of the state in their plane, a towards b."""
    c, s = math.cos(angle), math.sin(angle)
    for k in range(3):
        u, v = state[a + k], state[b + k]
        state[a + k] = c * u + s * v
        state[b + k] = c * v - s * u


@_jit
def _level(state):
    """Roll about the heading until left is horizontal and up points upwards; a vertical heading stays."""
    hx, hy = state[3], state[4]
    size = math.sqrt(hx * hx + hy * hy)
    if size < TINY:
        return
    state[6], state[7], state[8] = -hy / size, hx / size, 0.0
    hz = state[5]
    state[9] = -hz * state[7]
    state[10] = hz * state[6]
    state[11] = hx * state[7] - hy * state[6]


@_jit
def _bend(state, strength, tropism):
    """Turn the heading by strength |h x t| radians towards a unit vector t, at most onto it."""
    hx, hy, hz = state[3], state[4], state[5]
    ax = hy * tropism[2] - hz * tropism[1]
    ay = hz * tropism[0] - hx * tropism[2]
    az = hx * tropism[1] - hy * tropism[0]
    sine = math.sqrt(ax * ax + ay * ay + az * az)
    if sine < TINY:
        return
    cosine = hx * tropism[0] + hy * tropism[1] + hz * tropism[2]
    full = math.atan2(sine, cosine)
    angle = max(full - math.pi, min(strength * sine, full))  # at most onto t, or onto its opposite
    ax, ay, az = ax / sine, ay / sine, az / sine
    c, s = math.cos(angle), math.sin(angle)
    for first in (3, 6, 9):
        x, y, z = state[first], state[first + 1], state[first + 2]
        along = (ax * x + ay * y + az * z) * (1.0 - c)
        state[first] = c * x + s * (ay * z - az * y) + along * ax
        state[first + 1] = c * y + s * (az * x - ax * z) + along * ay
        state[first + 2] = c * z + s * (ax * y - ay * x) + along * az


@_jit
def walk(
    operation,
    value,
    kind,
    start,
    tropism,
    stack,
    stack_node,
    parent,
    position,
    radius,
    order,
    module,
    leaf_base,
    leaf_along,
    leaf_normal,
    leaf_size,
    leaf_kind,
    leaf_node,
):
    """Obey all modules; return the number of nodes and of leaves.

    `operation` (m,) uint8, `value` (m,) float64 (metres, radians), `kind` (m,) int32 of leaves, `start`
    (14,) float64 the state to begin with, `stack` (depth, 14) and `stack_node` (depth, 2) room for branches.
    There is room for two nodes for each DRAW, one for each LEAF and one more, and for a leaf for each LEAF.
    """
    state = start.copy()
    depth = 0
    node = -1  # the last node of the axis
    is_loose = False  # whether the turtle has left it without drawing
    n = n_leaves = 0
    for i in range(operation.size):
        what = operation[i]
        if what == NOTHING:
            continue
        x = value[i]
        if (
            (what == DRAW and (node < 0 or is_loose))
            or (what == LEAF and node < 0)
            or (what == PUSH and node < 0 and not is_loose)  # so that branches from the begin share a root
        ):
            parent[n] = -1
            for k in range(3):
                position[n, k] = state[k]
            radius[n], order[n], module[n] = 0.5 * state[12], depth, i
            node = n
            n += 1
            is_loose = False
        if what == DRAW:
            for k in range(3):
                state[k] += x * state[3 + k]
                position[n, k] = state[k]
            parent[n], radius[n], order[n], module[n] = node, 0.5 * state[12], depth, i
            node = n
            n += 1
            if state[13] != 0.0:
                _bend(state, state[13], tropism)
        elif what == LEAF:
            for k in range(3):
                leaf_base[n_leaves, k] = state[k]
                leaf_along[n_leaves, k] = state[3 + k]
                leaf_normal[n_leaves, k] = state[9 + k]
            leaf_size[n_leaves], leaf_kind[n_leaves], leaf_node[n_leaves] = x, kind[i], node
            n_leaves += 1
        elif what == MOVE:
            for k in range(3):
                state[k] += x * state[3 + k]
            is_loose = True
        elif what == YAW:
            _rotate(state, 3, 6, x)
        elif what == PITCH:
            _rotate(state, 9, 3, x)
        elif what == ROLL:
            _rotate(state, 6, 9, x)
        elif what == LEVEL:
            _level(state)
        elif what == WIDTH:
            state[12] = x
        elif what == THIN:
            state[12] *= x
        elif what == BEND:
            state[13] = x
        elif what == PUSH:
            stack[depth] = state
            stack_node[depth, 0], stack_node[depth, 1] = node, np.int32(is_loose)
            depth += 1
        else:
            depth -= 1
            state[:] = stack[depth]
            node, is_loose = stack_node[depth, 0], stack_node[depth, 1] != 0
    return n, n_leaves
