"""Compiled loops of the growth model. Arrays in, arrays out; nothing is checked here.

The nodes of all trees of a stand lie in one set of arrays, parents before children; ``plant`` says whose
a node is. A growth cycle is :func:`find_probes`, then the light at the probes, then :func:`flush`,
:func:`extend`, :func:`shed` and :func:`settle`. Whatever is random is a hash of the node's identity, which is
its path from the root: it depends neither on the order of the nodes nor on what grows elsewhere.

All of it is in one file, as the compiled cache of a function does not see changes in another file. The light
kernels are in another: after a change to them touch this file, or what was compiled from it stays.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from treegraph._light_kernels import BLOCK, LEAF_ROWS, gather

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

# Columns of a plant's parameters, in the order of table 1; angles in radians, spreads as standard deviations.
AAS, NLB, BAM, BAS, RAM, RAS = range(6)
AB_D, LB_D, LF_A, LF_L, AD_BF, AD_DF, AD_AF = range(6, 13)
GR, IBL, IL_AF, AC, AC_AF, PT, GT = range(13, 20)
PF, LB_PF, GBS, GBA = range(20, 24)

# Columns of the settings.
FOLIAGE, LEAF_CYCLES, TIP_SHARE, PIPE_EXPONENT, WOOD_DENSITY, LEAF_DENSITY, SHED_UNIT = range(7)
BEND_UNIT, MAX_CLUSTERS, MAX_NODES, UNIT_TRANSLUCENCY, UNIT_LEAF_DENSITY, KEEP_ALL, GROUND = range(7, 14)
N_SETTINGS = 14

NONE, DORMANT, DEAD, SPENT = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)  # what a bud can be
ALIVE = np.int32(2**30)  # death of what lives
EARLY, LATE = 0, 1  # when in a year: 2 * year + phase; before and after the branches are weighed
GROWN, NODE_LIMIT, FULL = 0, 1, 2  # how a run ended; FULL: the arrays are too small

# What a draw is for.
DIES, FLUSHES, LEANS, TURNS, BRANCHES, ROLLS = 1, 2, 3, 4, 5, 6

CELLS_PER_INTERNODE = 1.5  # least size of a leaf cluster's cell, in internodes of the longest kind
CELL_GROWTH = 1.26  # cells get larger by this factor (their volume twice) until there are few enough
BALL = 0.6203504908994  # radius of a ball over the edge of a cube of its volume


class Nodes(NamedTuple):
    """State of all nodes, dead ones too; each array has a row per node and room for more."""

    parent: np.ndarray  # int32
    plant: np.ndarray  # int32
    birth: np.ndarray  # int32: year in which it grew
    death: np.ndarray  # int32: 2 * year + phase, or ALIVE
    order: np.ndarray  # int32: level of its branch, 0 on the trunk
    bud_of: np.ndarray  # uint8: from which of the parent's buds it comes; 0 the apical one
    key: np.ndarray  # uint64: identity
    position: np.ndarray  # (., 3)
    direction: np.ndarray  # (., 3) unit vector from the parent
    side: np.ndarray  # (., 3) unit vector across it, from which the lateral buds' azimuth counts
    roll: np.ndarray  # azimuth of the first lateral bud
    length: np.ndarray  # of the segment from the parent
    radius: np.ndarray
    bend: np.ndarray  # bending so far at the foot of the segment, radians
    pipe: np.ndarray  # radius to the pipe exponent
    spent: np.ndarray  # pipes of branches that were shed here
    mass: np.ndarray  # kg of the segment and all it carries
    light: np.ndarray  # amount at the node when last looked at
    buds: np.ndarray  # (., 1 + most lateral buds) uint8
    first_direction: np.ndarray  # (., 3) as grown; no rows unless the history is kept


class Stand(NamedTuple):
    """What does not change while trees grow."""

    parameter: np.ndarray  # (plants, 24)
    planted: np.ndarray  # (plants,) int32: year
    base_z: np.ndarray  # (plants,)
    corner: np.ndarray  # (3,) where the grid of leaf clusters begins
    settings: np.ndarray  # (N_SETTINGS,)
    static_leaves: np.ndarray  # (k, 5) x, y, z, radius, translucency
    branches: np.ndarray  # as the light kernel wants them
    planes: np.ndarray
    balls: np.ndarray
    boxes: np.ndarray
    grid: tuple  # cells of the sky, as the light kernel wants them
    fine: np.ndarray
    weight: np.ndarray
    reach: np.ndarray  # (2,) blur and tent


class Probes(NamedTuple):
    """Where the light is looked at in a cycle, and the leaves as they stand."""

    point: np.ndarray  # (p, 3)
    own: np.ndarray  # (p,) int64: leaf cluster around it, or -1
    of_node: np.ndarray  # (n,) int32: probe of each node, or -1
    leaves: np.ndarray  # packed
    n_leaves: int
    area: np.ndarray  # (clusters,) leaf area, m2
    size: float  # edge of a cluster's cell, metres


# ---------------------------------------------------------------- chance


@_jit
def mix(z):
    """The finaliser of SplitMix64: a hash of 64 bits."""
    z = np.uint64(z) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@_jit
def child_key(key, bud):
    """Identity of the node that grows from a bud of a node."""
    return mix(np.uint64(key) ^ (np.uint64(0xD1B54A32D192ED03) * np.uint64(bud + 1)))


@_jit
def uniform(key, purpose, bud, year):
    """A number in [0, 1) that belongs to a node, a purpose, a bud and a year."""
    word = (np.uint64(purpose) << np.uint64(48)) | (np.uint64(bud) << np.uint64(32)) | np.uint64(year)
    return np.float64(mix(np.uint64(key) ^ mix(word)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@_jit
def normal(key, purpose, bud):
    """A standard normal number that belongs to a node, a purpose and a bud (Box and Muller)."""
    one = uniform(key, purpose, bud, 1)
    two = uniform(key, purpose, bud, 2)
    return math.sqrt(-2.0 * math.log(1.0 - one)) * math.cos(2.0 * math.pi * two)


# ---------------------------------------------------------------- rules


@_jit
def internodes_of_shoot(parameter, age, order, max_order):
    """Eq. 1 with its age factor, rounded to the nearest whole number."""
    control = parameter[AC] * parameter[AC_AF] ** age
    level = float(order if control > 1.0 else order - max_order)  # a whole exponent would not give inf
    return int(math.floor(parameter[GR] / control**level + 0.5))


@_jit
def bend_limit(parameter, diameter):
    """beta_max of appendix A; the diameter in metres."""
    return 0.5 * math.pi * parameter[GBA] ** (100.0 * diameter)


@_jit
def load_turn(force, limit, before):
    """Appendix A with the saturating form: how far a load turns a branch further."""
    if limit <= 0.0:
        return 0.0
    return max(0.0, limit * (1.0 - math.exp(-force / limit)) - before)


@_jit
def unit3(x, y, z):
    """A vector scaled to length one."""
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@_jit
def side_of(side, direction):
    """Take from `side` what lies along `direction`; any vector across it if nothing is left."""
    dot = side[0] * direction[0] + side[1] * direction[1] + side[2] * direction[2]
    x = side[0] - dot * direction[0]
    y = side[1] - dot * direction[1]
    z = side[2] - dot * direction[2]
    if x * x + y * y + z * z < 1e-12:
        if abs(direction[0]) < 0.6:
            x, y, z = 0.0, direction[2], -direction[1]
        else:
            x, y, z = -direction[2], 0.0, direction[0]
    return unit3(x, y, z)


@_jit
def lean(direction, side, angle, azimuth):
    """`direction` turned by `angle` towards the vector at `azimuth` around it, counted from `side`."""
    nx = direction[1] * side[2] - direction[2] * side[1]
    ny = direction[2] * side[0] - direction[0] * side[2]
    nz = direction[0] * side[1] - direction[1] * side[0]
    ca, sa = math.cos(azimuth), math.sin(azimuth)
    c, s = math.cos(angle), math.sin(angle)
    return unit3(
        c * direction[0] + s * (ca * side[0] + sa * nx),
        c * direction[1] + s * (ca * side[1] + sa * ny),
        c * direction[2] + s * (ca * side[2] + sa * nz),
    )


@_jit
def blocked(ax, ay, az, bx, by, bz, planes, balls, boxes):
    """Whether the way from a to b ends in an obstacle or leads through one."""
    for k in range(planes.shape[0]):
        nx, ny, nz = planes[k, 3], planes[k, 4], planes[k, 5]
        if (bx - planes[k, 0]) * nx + (by - planes[k, 1]) * ny + (bz - planes[k, 2]) * nz < 0.0:
            return True
    dx, dy, dz = bx - ax, by - ay, bz - az
    length2 = dx * dx + dy * dy + dz * dz
    for k in range(balls.shape[0]):
        ox, oy, oz = balls[k, 0] - ax, balls[k, 1] - ay, balls[k, 2] - az
        t = 0.0
        if length2 > 0.0:
            t = min(max((ox * dx + oy * dy + oz * dz) / length2, 0.0), 1.0)
        gx, gy, gz = ox - t * dx, oy - t * dy, oz - t * dz
        if gx * gx + gy * gy + gz * gz < balls[k, 3] ** 2:
            return True
    for k in range(boxes.shape[0]):
        near, far = 0.0, 1.0
        for axis in range(3):
            row = 3 + 3 * axis
            middle = boxes[k, row] * (boxes[k, 0] - ax)
            middle += boxes[k, row + 1] * (boxes[k, 1] - ay)
            middle += boxes[k, row + 2] * (boxes[k, 2] - az)
            along = boxes[k, row] * dx + boxes[k, row + 1] * dy + boxes[k, row + 2] * dz
            half = boxes[k, 12 + axis]
            if abs(along) < 1e-300:
                if abs(middle) > half:
                    near = 2.0
                continue
            one, two = (middle - half) / along, (middle + half) / along
            near = max(near, min(one, two))
            far = min(far, max(one, two))
        if near <= far:
            return True
    return False


# ---------------------------------------------------------------- leaves and light


@_jit
def mark_tips(nodes, n, tip):
    """Which living nodes carry no living one."""
    for i in range(n):
        tip[i] = nodes.death[i] == ALIVE
        if tip[i] and nodes.parent[i] >= 0:
            tip[nodes.parent[i]] = False


@_jit
def leaf_area(nodes, i, is_tip, stand, year):
    """Leaf area on the segment of a living node, m2: on young segments and on tips with a living bud."""
    if nodes.parent[i] < 0:
        return 0.0
    young = nodes.birth[i] > year - stand.settings[LEAF_CYCLES]
    if young or (is_tip and nodes.buds[i, 0] == DORMANT):
        return stand.settings[FOLIAGE] * nodes.length[i] * stand.parameter[nodes.plant[i], IBL]
    return 0.0


@_jit
def kill_buds(nodes, n, stand, year):
    """Buds die by chance."""
    for i in range(n):
        if nodes.death[i] != ALIVE or year < stand.planted[nodes.plant[i]]:
            continue
        parameter = stand.parameter[nodes.plant[i]]
        for k in range(nodes.buds.shape[1]):
            rate = parameter[LB_D] if k else parameter[AB_D]
            if nodes.buds[i, k] == DORMANT and uniform(nodes.key[i], DIES, k, year) < rate:
                nodes.buds[i, k] = DEAD


@_jit
def cell_of(x, y, z, size):
    """A number for the cell of a cubic grid that holds a point, counted from a corner."""
    a = np.int64(math.floor(x / size)) & 0x1FFFFF
    b = np.int64(math.floor(y / size)) & 0x1FFFFF
    c = np.int64(math.floor(z / size)) & 0x1FFFFF
    return (a << 42) | (b << 21) | c


@_jit
def place_of(table, keys, key):
    """Where a key is in a hash table, or the empty place where it belongs."""
    mask = np.uint64(table.size - 1)
    at = mix(key) & mask
    while table[at] >= 0 and keys[table[at]] != key:
        at = (at + np.uint64(1)) & mask
    return at


@_jit
def group(position, member, n, corner, size, most, label, keys):
    """Number the occupied cells in the order of their first member; -1 if there are more than `most`."""
    bits = 4
    while (1 << bits) < 2 * min(n, most) + 2:
        bits += 1
    table = np.full(1 << bits, -1, np.int32)
    count = 0
    for i in range(n):
        if not member[i]:
            continue
        x, y, z = position[i, 0] - corner[0], position[i, 1] - corner[1], position[i, 2] - corner[2]
        key = cell_of(x, y, z, size)
        at = place_of(table, keys, key)
        if table[at] < 0:
            if count == most:
                return -1
            table[at] = count
            keys[count] = key
            count += 1
        label[i] = table[at]
    return count


@_jit
def pack_clusters(center, area, size, stand):
    """Leaf clusters (thesis, Eq. 4.4 and 4.14) and the standing ones, as the light kernel wants them."""
    n = area.size
    total = n + stand.static_leaves.shape[0]
    blocks = (total + BLOCK - 1) // BLOCK
    packed = np.zeros(blocks * LEAF_ROWS * BLOCK)
    radius = BALL * size
    volume = size**3
    for k in range(total):
        at = (k // BLOCK) * LEAF_ROWS * BLOCK + k % BLOCK
        if k < n:
            for axis in range(3):
                packed[at + axis * BLOCK] = center[k, axis]
            packed[at + 3 * BLOCK] = radius
            density = area[k] / volume / stand.settings[UNIT_LEAF_DENSITY]
            packed[at + 4 * BLOCK] = stand.settings[UNIT_TRANSLUCENCY] ** (radius * density)
        else:
            for row in range(LEAF_ROWS):
                packed[at + row * BLOCK] = stand.static_leaves[k - n, row]
    return packed, total


@_jit
def find_probes(nodes, n, stand, size, year):
    """Gather leaves into clusters, and nodes whose light matters into probes of half a cluster's size."""
    leafy = np.zeros(n, np.bool_)
    wanted = np.zeros(n, np.bool_)
    tip = np.empty(n, np.bool_)
    area_of = np.zeros(n)
    mark_tips(nodes, n, tip)
    for i in range(n):
        if nodes.death[i] != ALIVE or year < stand.planted[nodes.plant[i]]:
            continue
        area_of[i] = leaf_area(nodes, i, tip[i], stand, year - 1)  # as they stood last summer
        leafy[i] = area_of[i] > 0.0
        wanted[i] = leafy[i]
        for k in range(nodes.buds.shape[1]):
            wanted[i] |= nodes.buds[i, k] == DORMANT
    label = np.full(n, -1, np.int32)
    most = int(stand.settings[MAX_CLUSTERS])
    keys = np.empty(most, np.int64)
    count = group(nodes.position, leafy, n, stand.corner, size, most, label, keys)
    while count < 0:
        size *= CELL_GROWTH
        count = group(nodes.position, leafy, n, stand.corner, size, most, label, keys)
    area = np.zeros(count)
    center = np.zeros((count, 3))
    for i in range(n):
        if leafy[i]:
            area[label[i]] += area_of[i]
            for axis in range(3):
                center[label[i], axis] += area_of[i] * nodes.position[i, axis]
    for k in range(count):
        center[k] /= area[k]
    packed, total = pack_clusters(center, area, size, stand)
    of_node = np.full(n, -1, np.int32)
    probe_keys = np.empty(n, np.int64)
    n_probes = group(nodes.position, wanted, n, stand.corner, 0.5 * size, n, of_node, probe_keys)
    point = np.zeros((n_probes, 3))
    members = np.zeros(n_probes)
    own = np.full(n_probes, -1, np.int64)
    for i in range(n):
        if wanted[i]:
            members[of_node[i]] += 1.0
            for axis in range(3):
                point[of_node[i], axis] += nodes.position[i, axis]
            if leafy[i]:
                own[of_node[i]] = label[i]
    for q in range(n_probes):
        point[q] /= members[q]
    return Probes(point, own, of_node, packed, total, area, size), area_of


@_jit
def look(probes, stand, seen, amount, vector):
    """The light at the probes."""
    gather(
        probes.point,
        probes.own,
        probes.n_leaves,
        probes.leaves,
        stand.branches,
        (stand.planes, stand.balls, stand.boxes),
        seen,
        stand.grid,
        stand.fine,
        stand.weight,
        np.empty(stand.grid[0].size, np.float32),
        stand.reach[0],
        stand.reach[1],
        amount,
        vector,
    )


@_jit
def spread_light(nodes, n, stand, probes, area_of, amount):
    """The light of each node: its probe's, dimmed by half of what else is in its own cluster."""
    radius = BALL * probes.size
    unit = radius / probes.size**3 / stand.settings[UNIT_LEAF_DENSITY]
    for i in range(n):
        q = probes.of_node[i]
        if q < 0:
            continue
        light = amount[q]
        if probes.own[q] >= 0:
            rest = max(0.0, probes.area[probes.own[q]] - area_of[i])
            light *= stand.settings[UNIT_TRANSLUCENCY] ** (0.5 * unit * rest)
        nodes.light[i] = light


# ---------------------------------------------------------------- a growth cycle


@_jit
def flush(nodes, n, stand, year, max_order, count):
    """Which buds flush (Eq. 2, 3): ``count`` (n, buds) gets the internodes of each new shoot.

    One pass towards the roots: the auxin that reaches a node is all that the buds above it made, less what
    was lost on the way. Returns the number of new nodes.
    """
    auxin = np.zeros(n)
    count[:n] = 0
    total = 0
    for i in range(n - 1, -1, -1):
        if nodes.death[i] != ALIVE:
            continue
        p = nodes.plant[i]
        parameter = stand.parameter[p]
        age = year - stand.planted[p]
        if age >= 0:
            base = parameter[AD_BF] * parameter[AD_AF] ** age
            internodes = internodes_of_shoot(parameter, age, nodes.order[i], max_order[p])
            if internodes > 0 and nodes.buds[i, 0] == DORMANT:
                chance = nodes.light[i] ** parameter[LF_A]
                if uniform(nodes.key[i], FLUSHES, 0, year) < chance:
                    count[i, 0] = internodes
                    total += internodes
                    auxin[i] += base
            made = 0.0
            if internodes > 0:
                chance = nodes.light[i] ** parameter[LF_L] * math.exp(-auxin[i])
                for k in range(1, nodes.buds.shape[1]):
                    if nodes.buds[i, k] == DORMANT and uniform(nodes.key[i], FLUSHES, k, year) < chance:
                        count[i, k] = internodes
                        total += internodes
                        made += base
            auxin[i] += made
        if nodes.parent[i] >= 0:
            auxin[nodes.parent[i]] += auxin[i] * parameter[AD_DF] ** nodes.length[i]
    return total


@_jit
def bud_direction(nodes, i, k, parameter):
    """Direction of a bud: the apical one leans by chance, lateral ones stand around the node."""
    if k == 0:
        angle = parameter[AAS] * normal(nodes.key[i], LEANS, 0)
        azimuth = 2.0 * math.pi * uniform(nodes.key[i], TURNS, 0, 0)
    else:
        angle = parameter[BAM] + parameter[BAS] * normal(nodes.key[i], BRANCHES, k)
        angle = min(max(angle, 0.0), math.pi)
        azimuth = nodes.roll[i] + 2.0 * math.pi * (k - 1) / parameter[NLB]
    return lean(nodes.direction[i], nodes.side[i], angle, azimuth)


@_jit
def add_node(nodes, n, i, k, direction, length, stand, year):
    """Node n grows from bud k of node i."""
    p = nodes.plant[i]
    parameter = stand.parameter[p]
    nodes.parent[n] = i
    nodes.plant[n] = p
    nodes.birth[n] = year
    nodes.death[n] = ALIVE
    nodes.order[n] = nodes.order[i] + (k > 0)
    nodes.bud_of[n] = k
    nodes.key[n] = child_key(nodes.key[i], k)
    side = side_of(nodes.direction[i] if k else nodes.side[i], direction)
    for axis in range(3):
        nodes.position[n, axis] = nodes.position[i, axis] + length * direction[axis]
        nodes.direction[n, axis] = direction[axis]
        nodes.side[n, axis] = side[axis]
    turn = parameter[RAM] + parameter[RAS] * normal(nodes.key[n], ROLLS, 0)
    nodes.roll[n] = ((0.0 if k else nodes.roll[i]) + turn) % (2.0 * math.pi)
    nodes.length[n] = length
    nodes.radius[n] = stand.settings[TIP_SHARE] * parameter[IBL]
    nodes.pipe[n] = nodes.radius[n] ** stand.settings[PIPE_EXPONENT]
    nodes.spent[n] = 0.0
    nodes.bend[n] = 0.0
    nodes.mass[n] = 0.0
    nodes.light[n] = nodes.light[i]
    nodes.buds[n] = NONE
    nodes.buds[n, 0] = DORMANT
    for bud in range(1, int(parameter[NLB]) + 1):
        nodes.buds[n, bud] = DORMANT
    if nodes.first_direction.shape[0]:
        nodes.first_direction[n] = nodes.direction[n]


@_jit
def extend(nodes, n, stand, year, count, probes, vector):
    """Grow the shoots; what runs into an obstacle or the ground stops there. Returns the number of nodes."""
    last = n
    d = np.empty(3)
    for i in range(last):
        p = nodes.plant[i]
        parameter = stand.parameter[p]
        for k in range(nodes.buds.shape[1]):
            if count[i, k] == 0:
                continue
            nodes.buds[i, k] = SPENT
            d[0], d[1], d[2] = bud_direction(nodes, i, k, parameter)
            lx, ly, lz = 0.0, 0.0, 0.0
            q = probes.of_node[i]
            if q >= 0:
                lx, ly, lz = vector[q, 0], vector[q, 1], vector[q, 2]
                size = math.sqrt(lx * lx + ly * ly + lz * lz)
                if size > 0.0:
                    lx, ly, lz = lx / size, ly / size, lz / size
            length = parameter[IBL] * parameter[IL_AF] ** (year - stand.planted[p])
            at, bud = i, k
            for _ in range(count[i, k]):
                x = d[0] + parameter[PT] * lx
                y = d[1] + parameter[PT] * ly
                z = d[2] + parameter[PT] * lz + parameter[GT]
                if x * x + y * y + z * z > 1e-12:
                    d[0], d[1], d[2] = unit3(x, y, z)
                px, py, pz = nodes.position[at, 0], nodes.position[at, 1], nodes.position[at, 2]
                ex, ey, ez = px + length * d[0], py + length * d[1], pz + length * d[2]
                under = stand.settings[GROUND] > 0.0 and ez < stand.base_z[p]
                if under or blocked(px, py, pz, ex, ey, ez, stand.planes, stand.balls, stand.boxes):
                    nodes.buds[at, bud] = DEAD
                    break
                add_node(nodes, n, at, bud, d, length, stand, year)
                if at != i:
                    nodes.buds[at, 0] = SPENT
                at, bud = n, 0
                n += 1
    return n


@_jit
def let_fall(nodes, n, fallen, stamp):
    """Let the marked nodes and all they carry die; their pipes stay as disused wood below."""
    for i in range(n):
        if nodes.death[i] != ALIVE:
            continue
        parent = nodes.parent[i]
        if parent >= 0 and nodes.death[parent] != ALIVE:
            nodes.death[i] = nodes.death[parent]
        elif fallen[i]:
            nodes.death[i] = stamp
            if parent >= 0 and 2 * nodes.birth[i] + LATE <= stamp:  # else it was never weighed
                nodes.spent[parent] += nodes.pipe[i]


@_jit
def shed(nodes, n, stand, year):
    """Branches with too little light for their size fall, and those that leave their bearer too low."""
    gathered = np.zeros(n)
    carried = np.zeros(n)
    fallen = np.zeros(n, np.bool_)
    tip = np.empty(n, np.bool_)
    mark_tips(nodes, n, tip)
    for i in range(n - 1, -1, -1):
        if nodes.death[i] != ALIVE or nodes.parent[i] < 0:
            continue
        if leaf_area(nodes, i, tip[i], stand, year) > 0.0:
            gathered[i] += nodes.light[i]
        carried[i] += 1.0
        parent = nodes.parent[i]
        gathered[parent] += gathered[i]
        carried[parent] += carried[i]
        if nodes.bud_of[i] > 0:
            parameter = stand.parameter[nodes.plant[i]]
            low = nodes.position[parent, 2] - stand.base_z[nodes.plant[i]] < parameter[LB_PF]
            dark = gathered[i] < stand.settings[SHED_UNIT] * parameter[PF] * carried[i]
            fallen[i] = low or dark
    let_fall(nodes, n, fallen, 2 * year + EARLY)


@_jit
def weigh(nodes, n, alive, stand, year, moment):
    """Radii by the pipe model, masses, and first moments of what each segment carries, itself included."""
    exponent = stand.settings[PIPE_EXPONENT]
    has_child = np.zeros(n, np.bool_)
    nodes.mass[:n] = 0.0
    moment[:n] = 0.0
    for i in range(n):
        if alive[i]:
            tip = stand.settings[TIP_SHARE] * stand.parameter[nodes.plant[i], IBL]
            nodes.pipe[i] = nodes.spent[i] + tip**exponent  # shed branches' pipes and its own leaves'
    for i in range(n - 1, -1, -1):
        if not alive[i]:
            continue
        parent = nodes.parent[i]
        nodes.radius[i] = nodes.pipe[i] ** (1.0 / exponent)
        if parent < 0:
            continue
        area = stand.settings[FOLIAGE] * nodes.length[i] * stand.parameter[nodes.plant[i], IBL]
        leafy = not has_child[i] or nodes.birth[i] > year - stand.settings[LEAF_CYCLES]
        own = stand.settings[WOOD_DENSITY] * math.pi * nodes.radius[i] ** 2 * nodes.length[i]
        own += stand.settings[LEAF_DENSITY] * area if leafy else 0.0
        nodes.mass[i] += own
        for axis in range(3):
            middle = nodes.position[i, axis] - 0.5 * nodes.length[i] * nodes.direction[i, axis]
            moment[i, axis] += own * middle
            moment[parent, axis] += moment[i, axis]
        nodes.mass[parent] += nodes.mass[i]
        nodes.pipe[parent] += nodes.pipe[i]
        has_child[parent] = True


@_jit
def turn_about(axis_x, axis_y, angle, out):
    """Rotation about a horizontal axis of length one, into ``out`` (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    out[0, 0] = c + axis_x * axis_x * (1.0 - c)
    out[0, 1] = axis_x * axis_y * (1.0 - c)
    out[0, 2] = axis_y * s
    out[1, 0] = axis_x * axis_y * (1.0 - c)
    out[1, 1] = c + axis_y * axis_y * (1.0 - c)
    out[1, 2] = -axis_x * s
    out[2, 0] = -axis_y * s
    out[2, 1] = axis_x * s
    out[2, 2] = c


@_jit
def times3(a, v, i):
    """Replace row i of `v` by a times it."""
    x, y, z = v[i, 0], v[i, 1], v[i, 2]
    for axis in range(3):
        v[i, axis] = a[axis, 0] * x + a[axis, 1] * y + a[axis, 2] * z


@_jit
def after_turn(extra, turned, parent, has_turned, i):
    """The turn of node i: `extra` after that of its parent."""
    for row in range(3):
        for column in range(3):
            total = extra[row, column]
            if has_turned:
                total = 0.0
                for k in range(3):
                    total += extra[row, k] * turned[parent, k, column]
            turned[i, row, column] = total


@_jit
def bend(nodes, n, alive, stand, moment):
    """Branches sink under what they carry (appendix A); what hangs on them turns along."""
    turned = np.zeros((n, 3, 3))
    moved = np.zeros(n, np.bool_)
    extra = np.empty((3, 3))
    for i in range(n):
        parent = nodes.parent[i]
        if not alive[i] or parent < 0:
            continue
        parameter = stand.parameter[nodes.plant[i]]
        hx, hy, hz = nodes.direction[i, 0], nodes.direction[i, 1], nodes.direction[i, 2]
        foot_x = nodes.position[i, 0] - nodes.length[i] * hx
        foot_y = nodes.position[i, 1] - nodes.length[i] * hy
        angle = 0.0
        if parameter[GBS] > 0.0 and nodes.mass[i] > 0.0:
            # With the position as it was when the moments were taken: below, parents may have moved.
            lever = (moment[i, 0] / nodes.mass[i] - foot_x) * hx + (
                moment[i, 1] / nodes.mass[i] - foot_y
            ) * hy
            force = stand.settings[BEND_UNIT] * parameter[GBS] * nodes.mass[i] * abs(lever) * (1.0 - abs(hz))
            limit = bend_limit(parameter, 2.0 * nodes.radius[i])
            angle = load_turn(force, limit, nodes.bend[i])
        if moved[parent]:
            times3(turned[parent], nodes.direction, i)
            times3(turned[parent], nodes.side, i)
            turned[i] = turned[parent]
            moved[i] = True
        hx, hy, hz = nodes.direction[i, 0], nodes.direction[i, 1], nodes.direction[i, 2]
        level = math.sqrt(hx * hx + hy * hy)
        if angle > 0.0 and level > 1e-9:
            angle = min(angle, math.atan2(level, -hz))  # not past straight down
            nodes.bend[i] += angle
            turn_about(-hy / level, hx / level, angle, extra)
            times3(extra, nodes.direction, i)
            times3(extra, nodes.side, i)
            after_turn(extra, turned, parent, moved[parent], i)
            moved[i] = True
        if moved[i]:
            x, y, z = unit3(nodes.direction[i, 0], nodes.direction[i, 1], nodes.direction[i, 2])
            nodes.direction[i, 0], nodes.direction[i, 1], nodes.direction[i, 2] = x, y, z
            sx, sy, sz = side_of(nodes.side[i], nodes.direction[i])
            nodes.side[i, 0], nodes.side[i, 1], nodes.side[i, 2] = sx, sy, sz
        for axis in range(3):
            step = nodes.length[i] * nodes.direction[i, axis]
            nodes.position[i, axis] = nodes.position[parent, axis] + step


@_jit
def find_crossings(nodes, n, alive, stand, fallen):
    """Mark living segments that now lead into an obstacle or under the ground; whether there are any."""
    found = False
    for i in range(n):
        parent = nodes.parent[i]
        fallen[i] = False
        if not alive[i] or parent < 0:
            continue
        a, b = nodes.position[parent], nodes.position[i]
        under = stand.settings[GROUND] > 0.0 and b[2] < stand.base_z[nodes.plant[i]]
        if under or blocked(a[0], a[1], a[2], b[0], b[1], b[2], stand.planes, stand.balls, stand.boxes):
            fallen[i] = True
            found = True
    return found


@_jit
def settle(nodes, n, stand, year):
    """Weigh, bend, and let fall what was bent into something."""
    alive = nodes.death[:n] == ALIVE
    moment = np.empty((n, 3))
    weigh(nodes, n, alive, stand, year, moment)
    bend(nodes, n, alive, stand, moment)
    fallen = np.empty(n, np.bool_)
    if find_crossings(nodes, n, alive, stand, fallen):
        let_fall(nodes, n, fallen, 2 * year + LATE)


@_jit
def compact(nodes, n):
    """Forget the dead; the others keep their order. Returns their number."""
    place = np.empty(n, np.int32)
    kept = 0
    for i in range(n):
        if nodes.death[i] != ALIVE:
            place[i] = -1
            continue
        place[i] = kept
        if kept != i:
            nodes.parent[kept] = place[nodes.parent[i]] if nodes.parent[i] >= 0 else -1
            nodes.plant[kept] = nodes.plant[i]
            nodes.birth[kept] = nodes.birth[i]
            nodes.death[kept] = nodes.death[i]
            nodes.order[kept] = nodes.order[i]
            nodes.bud_of[kept] = nodes.bud_of[i]
            nodes.key[kept] = nodes.key[i]
            nodes.position[kept] = nodes.position[i]
            nodes.direction[kept] = nodes.direction[i]
            nodes.side[kept] = nodes.side[i]
            nodes.roll[kept] = nodes.roll[i]
            nodes.length[kept] = nodes.length[i]
            nodes.radius[kept] = nodes.radius[i]
            nodes.bend[kept] = nodes.bend[i]
            nodes.pipe[kept] = nodes.pipe[i]
            nodes.spent[kept] = nodes.spent[i]
            nodes.mass[kept] = nodes.mass[i]
            nodes.light[kept] = nodes.light[i]
            nodes.buds[kept] = nodes.buds[i]
        kept += 1
    return kept


@_jit
def highest_orders(nodes, n, n_plants):
    """zeta_max of Eq. 1 of each plant, and the number of living nodes."""
    out = np.zeros(n_plants, np.int64)
    living = 0
    for i in range(n):
        if nodes.death[i] == ALIVE:
            living += 1
            out[nodes.plant[i]] = max(out[nodes.plant[i]], nodes.order[i])
    return out, living


@_jit
def grow_cycle(nodes, n, stand, year, count, probes, area_of, amount, vector):
    """A cycle from the light on, up to the shoots. Returns the number of nodes and how it went.

    With FULL or NODE_LIMIT nothing has grown: with buds and light put back, the cycle can be begun anew.
    """
    spread_light(nodes, n, stand, probes, area_of, amount)
    max_order, living = highest_orders(nodes, n, stand.parameter.shape[0])
    wanted = flush(nodes, n, stand, year, max_order, count)
    if living + wanted > stand.settings[MAX_NODES]:
        return n, NODE_LIMIT
    if n + wanted > nodes.parent.size:
        return n, FULL
    return extend(nodes, n, stand, year, count, probes, vector), GROWN


@_jit
def finish_cycle(nodes, n, stand, year):
    """A cycle after the shoots: shedding, radii, bending. Returns the number of nodes."""
    shed(nodes, n, stand, year)
    if stand.settings[KEEP_ALL] == 0.0:
        n = compact(nodes, n)
    settle(nodes, n, stand, year)
    return n


@_jit
def run(nodes, n, stand, size, first, last):
    """Grow from year `first` until before year `last`: (number of nodes, year, cell size, status)."""
    seen = np.empty((0, 0), np.float32)
    count = np.zeros((nodes.parent.size, nodes.buds.shape[1]), np.int32)
    for year in range(first, last):
        buds, light = nodes.buds[:n].copy(), nodes.light[:n].copy()
        kill_buds(nodes, n, stand, year)
        probes, area_of = find_probes(nodes, n, stand, size, year)
        size = probes.size
        amount = np.empty(probes.point.shape[0])
        vector = np.empty((probes.point.shape[0], 3))
        look(probes, stand, seen, amount, vector)
        n, status = grow_cycle(nodes, n, stand, year, count, probes, area_of, amount, vector)
        if status != GROWN:
            nodes.buds[:n], nodes.light[:n] = buds, light
            return n, year, size, status
        n = finish_cycle(nodes, n, stand, year)
    return n, last, size, GROWN


@_jit
def replay_year(nodes, n, stand, death, year):
    """Bring nodes with a known life one year on; ``death`` (n,) is when each died. True: alive at its end."""
    alive = np.zeros(n, np.bool_)
    for i in range(n):
        parent = nodes.parent[i]
        early = 2 * year + EARLY
        if death[i] == early and parent >= 0 and death[parent] != early and nodes.birth[i] < year:
            nodes.spent[parent] += nodes.pipe[i]
        alive[i] = (nodes.birth[i] <= year or parent < 0) and death[
            i
        ] > early  # seeds lie there from the start
        if alive[i] and nodes.birth[i] == year and parent >= 0:
            nodes.direction[i] = nodes.first_direction[i]
            for axis in range(3):
                step = nodes.length[i] * nodes.direction[i, axis]
                nodes.position[i, axis] = nodes.position[parent, axis] + step
    moment = np.empty((n, 3))
    weigh(nodes, n, alive, stand, year, moment)
    bend(nodes, n, alive, stand, moment)
    late = 2 * year + LATE
    for i in range(n):
        parent = nodes.parent[i]
        if alive[i] and death[i] == late:
            alive[i] = False
            if death[parent] != late:
                nodes.spent[parent] += nodes.pipe[i]
    return alive
