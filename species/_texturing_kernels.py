"""Compiled loops of cluster texturing. Arrays in, arrays out; nothing is checked here."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from species._space_kernels import fill_columns, frame_of, next_random, quaternion_of

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

SAMPLES = 16  # points by which a patch is compared with the space around it
MOST_SIDE = 12  # cells of a cluster's grid along its longest side
TRIES = 6  # patches that are compared for one place
LEAST_INSIDE = 0.45  # share of a patch's points that have to be in the cluster
DOCK_FRESH, GROW_FRESH = 0.75, 0.5  # of that share: below it the place has its leaves; at a dock, at a place
LIKE = 1.8  # ratio of thicknesses up to which a patch is like a dock
ROLL = 0.5  # radians: how far patches are turned about their axis at most
UPRIGHT = 0.9  # upward component of a direction from which on no side is up: any roll will do
MATCH_FLOOR, FRESH_FLOOR = 0.2, 0.1  # what counts besides match and free space
PLACES = 16  # cells that are compared for the emptiest
GROW_SHARE = 0.3  # of patches that are grown to empty places while docks still wait
NEAR = 0.5  # share of its reach by which a patch may miss its place
IMPATIENT = 0.5  # patience below which it does that a patch comes to its place, in the cluster or not
STALE = 100  # places in a row that did not do before the rest of a cluster is left empty
COS_TURN = math.cos(math.radians(70.0))  # patches turn away from their dock's direction by at most that
STEEPEST = math.radians(80.0)  # elevation of a direction that is raised for a patch that hangs down
TURN_COST = 0.5  # how much longer a way counts that begins across the dock's direction
USED_COST, WOOD_COST = 1.3, 1.25  # how much longer a way counts from a used dock, from wood without one
BEYOND = 1e4  # metres: a dock from which a place cannot be reached counts as so much farther away
SLACK = 1.15  # a place is in a patch's reach up to so many times its reach
MOST_LINKS = 12  # patches in a row towards one place
OVER = 1.5  # a patch has at most so many times the leaf area that is still missing
COARSE = 5.0  # a patch with so many times less than the leaf area that is missing counts half
LEAD_SHARE = 0.6  # of what a patch leads on along its axis, what it brings one nearer to a place
MOST_LINKED = 1.0  # leaf area on the way to a cluster, over that of the cluster
TOO_THICK = 100.0  # how much worse a patch fits that is too thick for a dock: taken only if all are
OVER_PROMISE = 0.1  # what a patch with docks counts where the waiting docks promise enough leaves
PIPE_EXPONENT = 2.49  # a seed of this many times the radius feeds so many more patches (thesis, Eq. 5.6)
MOST_DOCKS = 6  # docks of one seed
FAN = 0.7  # radians between the docks of a thick seed and its own direction
LEAN = 0.5  # how much a seed's direction is turned to the middle of its cluster
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
MOST_GAP = 5.0  # metres between a cluster without seeds and the nearest branch
LINK_FLOOR = 0.5  # what counts besides the match of a patch that leads on

QUEUED, WOOD = 0, 1  # kinds of docks: those that wait for a patch, and points of wood
N_DOCKS, N_TAKEN, N_MADE = 0, 1, 2  # places in `count`
# Places in `sums`, all leaf areas: wanted, in the cluster, to come, on the way to it, of the smallest patch.
TARGET, AREA, PROMISED, LINKED, LEAST = 0, 1, 2, 3, 4


class Patches(NamedTuple):
    """A species' patches; p of them, with docks and points of their axes one after the other."""

    radius: np.ndarray  # (p,)
    slope: np.ndarray  # (p,)
    area: np.ndarray  # (p,) of the leaves
    sample: np.ndarray  # (p, SAMPLES, 3)
    reach: np.ndarray  # (p,) distance of the middle of the leaves from the root
    droop: np.ndarray  # (p,) radians by which it lies below the root's direction
    lead: np.ndarray  # (p,) how far the docks reach along the axis; 0 without docks
    promise: np.ndarray  # (p,) leaf area that its docks will bring
    dock_start: np.ndarray  # (p + 1,) int64
    dock_place: np.ndarray  # (d, 3)
    dock_way: np.ndarray  # (d, 3)
    dock_radius: np.ndarray  # (d,)
    dock_promise: np.ndarray  # (d,)
    dock_kind: np.ndarray  # (d,) int64


class Docks(NamedTuple):
    """Where patches can hang in a cluster; room for more."""

    place: np.ndarray  # (m, 3)
    way: np.ndarray  # (m, 3) unit vectors
    radius: np.ndarray  # (m,)
    span: np.ndarray  # (m,) reach of the longest patch that fits
    promise: np.ndarray  # (m,)
    kind: np.ndarray  # (m,) int64
    holder: np.ndarray  # (m,) int64: the instance whose dock it is, -1: the tree
    used: np.ndarray  # (m,) bool


class Room(NamedTuple):
    """A cluster's grid."""

    low: np.ndarray  # (3,)
    cell: float
    n_x: int
    n_y: int
    n_z: int
    inside: np.ndarray  # (cells,) bool
    cells: np.ndarray  # (n,) int64: those inside
    block: np.ndarray  # (cells,) int64: the block of cells that each belongs to
    space: np.ndarray  # (blocks,) leaf area that there is room for
    filled: np.ndarray  # (blocks,) leaf area over that


class Work(NamedTuple):
    """Memory that is used again."""

    rotation: np.ndarray  # (3, 3) of the patch in hand
    best_rotation: np.ndarray  # (3, 3)
    place: np.ndarray  # (3,) where a patch should go
    way: np.ndarray  # (3,) direction of a patch
    pool: np.ndarray  # (p,) int64
    cells: np.ndarray  # (SAMPLES,) int64
    state: np.ndarray  # (1,) uint64
    limits: np.ndarray  # (2,) least and most scale of a patch


@_jit
def score_match(radius_root, slope_root, radius_dock, slope_dock):
    """Eq. 3.3, its two ingredients turned so that 1 is best: ratio of thicknesses, cosine of directions."""
    thin = min(radius_root, radius_dock) / max(radius_root, radius_dock)
    return thin * max(0.0, math.cos(slope_root - slope_dock))


@_jit
def find_cells(rotation, scale, position, sample, room, cells):
    """Cells of the cluster's grid in which a placed patch has its points, into `cells`; -1 outside."""
    low, inside, n_x, n_y, n_z = room.low, room.inside, room.n_x, room.n_y, room.n_z
    factor = scale / room.cell
    xx, xy, xz = factor * rotation[0, 0], factor * rotation[0, 1], factor * rotation[0, 2]
    yx, yy, yz = factor * rotation[1, 0], factor * rotation[1, 1], factor * rotation[1, 2]
    zx, zy, zz = factor * rotation[2, 0], factor * rotation[2, 1], factor * rotation[2, 2]
    px = (position[0] - low[0]) / room.cell
    py = (position[1] - low[1]) / room.cell
    pz = (position[2] - low[2]) / room.cell
    for s in range(SAMPLES):
        x, y, z = sample[s, 0], sample[s, 1], sample[s, 2]
        i = int(math.floor(px + xx * x + xy * y + xz * z))
        j = int(math.floor(py + yx * x + yy * y + yz * z))
        k = int(math.floor(pz + zx * x + zy * y + zz * z))
        cells[s] = -1
        if 0 <= i < n_x and 0 <= j < n_y and 0 <= k < n_z:
            at = (i * n_y + j) * n_z + k
            if inside[at]:
                cells[s] = at


@_jit
def score_space(rotation, scale, position, sample, room, cells):
    """Shares of a patch's points that lie in the cluster, and in cells of it where there is nothing yet."""
    find_cells(rotation, scale, position, sample, room, cells)
    block, filled = room.block, room.filled
    n_inside = 0
    fresh = 0.0
    for s in range(SAMPLES):
        if cells[s] >= 0:
            n_inside += 1
            fresh += 1.0 / (1.0 + filled[block[cells[s]]])
    return n_inside / SAMPLES, fresh / SAMPLES


@_jit
def mark_filled(rotation, scale, position, sample, amount, room, cells):
    """Add a patch's leaf area to the blocks of its points; the share of it that is in the cluster."""
    find_cells(rotation, scale, position, sample, room, cells)
    block, filled, space = room.block, room.filled, room.space
    n_inside = 0
    for s in range(SAMPLES):
        if cells[s] >= 0:
            n_inside += 1
            filled[block[cells[s]]] += amount / SAMPLES / space[block[cells[s]]]
    return n_inside / SAMPLES


@_jit
def draw(state, n):
    """A number from 0 to n - 1."""
    return int(next_random(state) * n)


@_jit
def mark_surface(vertices, low, cell, n_x, n_y, n_z, inside):
    """Mark the cells of the corners: of a cluster that is thinner than a cell."""
    for v in range(vertices.shape[0]):
        i = min(int((vertices[v, 0] - low[0]) / cell), n_x - 1)
        j = min(int((vertices[v, 1] - low[1]) / cell), n_y - 1)
        k = min(int((vertices[v, 2] - low[2]) / cell), n_z - 1)
        inside[(i * n_y + j) * n_z + k] = True


@_jit
def make_room(vertices, faces, target, typical, inside):
    """The grid of a cluster, empty. Its cells are put together to blocks with room for a typical patch."""
    low = np.empty(3)
    high = np.empty(3)
    for axis in range(3):
        low[axis] = vertices[:, axis].min()
        high[axis] = vertices[:, axis].max()
    cell = max(high[0] - low[0], high[1] - low[1], high[2] - low[2]) / MOST_SIDE
    n_x = max(1, int(math.ceil((high[0] - low[0]) / cell)))
    n_y = max(1, int(math.ceil((high[1] - low[1]) / cell)))
    n_z = max(1, int(math.ceil((high[2] - low[2]) / cell)))
    fill_columns(vertices, faces, low, cell, n_x, n_y, n_z, inside)
    if not inside[: n_x * n_y * n_z].any():
        mark_surface(vertices, low, cell, n_x, n_y, n_z, inside)
    cells = np.flatnonzero(inside[: n_x * n_y * n_z])
    side = max(1, int(round((typical / target * cells.size) ** (1.0 / 3.0))))
    b_y, b_z = -(-n_y // side), -(-n_z // side)
    block = np.empty(n_x * n_y * n_z, np.int64)
    share = np.zeros(-(-n_x // side) * b_y * b_z)
    for at in range(block.size):
        i, j, k = at // (n_y * n_z), at // n_z % n_y, at % n_z
        block[at] = (i // side * b_y + j // side) * b_z + k // side
        if inside[at]:
            share[block[at]] += target / cells.size
    return Room(low, cell, n_x, n_y, n_z, inside, cells, block, share, np.zeros(share.size))


@_jit
def place_in_cell(at, room, x, y, z, place):
    """A place in a cell, by its shares of the cell's sides."""
    place[0] = room.low[0] + (at // (room.n_y * room.n_z) + x) * room.cell
    place[1] = room.low[1] + (at // room.n_z % room.n_y + y) * room.cell
    place[2] = room.low[2] + (at % room.n_z + z) * room.cell


@_jit
def middle_place(room, place):
    """The middle of the cell that is nearest to the middle of all cells of the cluster, into `place`."""
    middle = np.zeros(3)
    for at in room.cells:
        middle[0] += at // (room.n_y * room.n_z) / room.cells.size
        middle[1] += at // room.n_z % room.n_y / room.cells.size
        middle[2] += at % room.n_z / room.cells.size
    nearest, best = np.inf, room.cells[0]
    for at in room.cells:
        gap = (at // (room.n_y * room.n_z) - middle[0]) ** 2
        gap += (at // room.n_z % room.n_y - middle[1]) ** 2 + (at % room.n_z - middle[2]) ** 2
        if gap < nearest:
            nearest, best = gap, at
    place_in_cell(best, room, 0.5, 0.5, 0.5, place)


@_jit
def empty_place(state, room, place):
    """A place in the emptiest of a few cells of the cluster, into `place`."""
    best, least = -1, np.inf
    for _ in range(PLACES):
        trial = room.cells[draw(state, room.cells.size)]
        if room.filled[room.block[trial]] < least:
            best, least = trial, room.filled[room.block[trial]]
    x, y, z = next_random(state), next_random(state), next_random(state)
    place_in_cell(best, room, x, y, z, place)


@_jit
def add_dock(place, way, radius, kind, docks, n):
    """A dock on the tree."""
    docks.place[n] = place
    docks.way[n] = way
    docks.radius[n] = radius
    docks.promise[n] = 0.0
    docks.kind[n] = kind
    docks.holder[n] = -1
    docks.used[n] = False


@_jit
def seed_docks(position, parent, radius, seed, middle, needed, thickest, docks):
    """Docks at a cluster's seeds, of thick ones several in a fan around the branch's direction; how many."""
    n = 0
    frame = np.empty((3, 3))
    way = np.empty(3)
    for node in seed:
        thick = radius[node] if radius[node] == radius[node] else thickest
        thick = max(thick, needed)
        along, inward = 0.0, 0.0
        for axis in range(3):
            if parent[node] >= 0:
                along += (position[node, axis] - position[parent[node], axis]) ** 2
            inward += (middle[axis] - position[node, axis]) ** 2
        for axis in range(3):
            way[axis] = 1.0 if axis == 2 else 0.0
            if along > 0.0:
                way[axis] = (position[node, axis] - position[parent[node], axis]) / math.sqrt(along)
            way[axis] += LEAN * (middle[axis] - position[node, axis]) / math.sqrt(max(inward, 1e-24))
        size = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        for axis in range(3):
            way[axis] /= size
        frame_of(way[0], way[1], way[2], 0.0, frame)
        many = min(max(int(math.ceil((thick / thickest) ** PIPE_EXPONENT)), 1), MOST_DOCKS)
        for k in range(many):
            turn, lean = GOLDEN_ANGLE * k, FAN if k else 0.0
            for axis in range(3):
                across = math.cos(turn) * frame[axis, 0] + math.sin(turn) * frame[axis, 1]
                way[axis] = math.cos(lean) * frame[axis, 2] + math.sin(lean) * across
            if n < docks.radius.size:
                add_dock(position[node], way, min(thick, thickest), QUEUED, docks, n)
                n += 1
    return n


@_jit
def way_length(x, y, z, way):
    """How long the way to a place counts that lies at x, y, z from a dock, and the distance.

    Turning away from the dock's direction makes it longer; too far, and the place is as good as out of reach.
    """
    gap = math.sqrt(x * x + y * y + z * z)
    cosine = (x * way[0] + y * way[1] + z * way[2]) / gap if gap > 1e-9 else 1.0
    return gap * (1.0 + TURN_COST * (1.0 - cosine)) + (BEYOND if cosine < COS_TURN else 0.0), gap


@_jit
def wood_docks(low, high, wood, needed, thickest, most_gap, docks, n):
    """Docks at the points of branches in a box, and at the one from which its middle is reached best.

    ``wood``: (m, 7) place, direction, radius. Returns how many docks there are then.
    """
    best, best_way = -1, np.inf
    for k in range(wood.shape[0]):
        square = 0.0
        for axis in range(3):
            square += max(low[axis] - wood[k, axis], wood[k, axis] - high[axis], 0.0) ** 2
        x = 0.5 * (low[0] + high[0]) - wood[k, 0]
        y = 0.5 * (low[1] + high[1]) - wood[k, 1]
        z = 0.5 * (low[2] + high[2]) - wood[k, 2]
        way, _ = way_length(x, y, z, wood[k, 3:6])
        if square <= 0.0 and n < docks.radius.size:
            thick = wood[k, 6] if wood[k, 6] == wood[k, 6] else thickest
            add_dock(wood[k, :3], wood[k, 3:6], max(thick, needed), WOOD, docks, n)
            n += 1
        elif square <= most_gap * most_gap and way < best_way:
            best, best_way = k, way
    if best >= 0 and n < docks.radius.size:
        thick = wood[best, 6] if wood[best, 6] == wood[best, 6] else thickest
        add_dock(wood[best, :3], wood[best, 3:6], max(thick, needed), WOOD, docks, n)
        n += 1
    return n


@_jit
def find_dock(place, docks, n, leads_from, limits):
    """The dock from which a place is reached on the shortest way, and how far it is; -1: there is none.

    Turning counts as a longer way, and so do used docks and wood without one. Docks from which no patch
    reaches the place, and none leads on, and those that point elsewhere come after all others.
    """
    places, ways, kind, used = docks.place, docks.way, docks.kind, docks.used
    span, radius, most = docks.span, docks.radius, SLACK * limits[1]
    best, best_way, best_gap = -1, np.inf, 0.0
    for d in range(n):
        x = place[0] - places[d, 0]
        y = place[1] - places[d, 1]
        z = place[2] - places[d, 2]
        square = x * x + y * y + z * z
        if square >= best_way * best_way:
            continue
        way, gap = way_length(x, y, z, ways[d])
        if kind[d] == WOOD:
            way *= WOOD_COST
        elif used[d]:
            way *= USED_COST
        if gap > most * span[d] and radius[d] < leads_from:
            way += BEYOND
        if way < best_way:
            best, best_way, best_gap = d, way, gap
    return best, best_gap


@_jit
def aim(place, dock_place, dock_way, droop, way):
    """Direction in which a patch sets off so that its leaves come to a place, into `way`; whether it can.

    It is raised by what the patch hangs down, and turned from the dock's direction by 70 degrees at most.
    """
    x, y, z = place[0] - dock_place[0], place[1] - dock_place[1], place[2] - dock_place[2]
    flat = math.sqrt(x * x + y * y)
    if flat < 1e-9 and abs(z) < 1e-9:
        way[:] = dock_way
        return True
    rise = math.atan2(z, flat)
    if flat > 1e-9 and droop != 0.0:
        rise = min(max(rise + droop, -STEEPEST), STEEPEST)
        way[0], way[1], way[2] = math.cos(rise) * x / flat, math.cos(rise) * y / flat, math.sin(rise)
    else:
        size = math.sqrt(flat * flat + z * z)
        way[0], way[1], way[2] = x / size, y / size, z / size
    cosine = way[0] * dock_way[0] + way[1] * dock_way[1] + way[2] * dock_way[2]
    if cosine >= COS_TURN:
        return True
    across = 0.0
    for axis in range(3):
        way[axis] -= cosine * dock_way[axis]
        across += way[axis] ** 2
    if across < 1e-12:  # straight back: any side will do
        frame = np.empty((3, 3))
        frame_of(dock_way[0], dock_way[1], dock_way[2], 0.0, frame)
        way[:] = frame[:, 0]
        across = 1.0
    sine = math.sqrt(1.0 - COS_TURN * COS_TURN)
    for axis in range(3):
        way[axis] = COS_TURN * dock_way[axis] + sine * way[axis] / math.sqrt(across)
    return False


@_jit
def turned_frame(way, state, rotation):
    """Rotation of a patch that sets off in a direction: its upper side up, but for a little chance."""
    roll = ROLL * (2.0 * next_random(state) - 1.0)
    if abs(way[2]) > UPRIGHT:
        roll *= math.pi / ROLL
    frame_of(way[0], way[1], way[2], roll, rotation)


@_jit
def fineness(area, sums):
    """Nearly 1 for a patch that brings little of the leaf area that is missing, less for one with much."""
    return 1.0 / (1.0 + COARSE * area / max(sums[TARGET] - sums[AREA], sums[LEAST]))


@_jit
def most_area(sums):
    """Leaf area that a patch may have at most."""
    return max(OVER * (sums[TARGET] - sums[AREA]), sums[LEAST])


@_jit
def unpromised(sums):
    """Leaf area that is missing and that no waiting dock promises."""
    return max(sums[TARGET] - sums[AREA] - sums[PROMISED], 0.0)


@_jit
def like_patches(radius, sums, patches, limits, pool):
    """Patches about as thick as a dock, into `pool`: how many; the nearest in thickness if there is none."""
    patch_radius, area = patches.radius, patches.area
    n, most = 0, most_area(sums) / (limits[0] * limits[0])
    nearest, nearest_ratio = -1, np.inf
    for p in range(patch_radius.size):
        if area[p] > most:
            continue
        ratio = max(radius / patch_radius[p], patch_radius[p] / radius)
        if ratio <= LIKE:
            pool[n] = p
            n += 1
        elif ratio < nearest_ratio:
            nearest, nearest_ratio = p, ratio
    if n == 0 and nearest >= 0:
        pool[0] = nearest
        n = 1
    return n


@_jit
def fit_dock(d, sums, patches, docks, room, work):
    """The patch that fits a waiting dock best, of a few (Eq. 3.3, and space): row or -1, and scale.

    Its rotation comes into ``work.best_rotation``.
    """
    state, limits, way = work.state, work.limits, docks.way[d]
    radius, slope = docks.radius[d], math.asin(min(max(way[2], -1.0), 1.0))
    n = like_patches(radius, sums, patches, limits, work.pool)
    best, best_score, best_scale = -1, 0.0, 1.0
    for _ in range(TRIES if n else 0):
        p = work.pool[draw(state, n)]
        scale = min(max(radius / patches.radius[p], limits[0]), limits[1])
        turned_frame(way, state, work.rotation)
        share, fresh = score_space(work.rotation, scale, docks.place[d], patches.sample[p], room, work.cells)
        if share < LEAST_INSIDE or fresh < DOCK_FRESH * share:
            continue
        match = score_match(patches.radius[p], patches.slope[p], radius, slope)
        score = (MATCH_FLOOR + match) * (FRESH_FLOOR + fresh) * fineness(patches.area[p], sums)
        if patches.promise[p] > unpromised(sums):
            score *= OVER_PROMISE
        if score > best_score:
            best, best_score, best_scale = p, score, scale
            work.best_rotation[:] = work.rotation
    return best, best_scale


@_jit
def reaching_patches(gap, radius, sums, patches, limits, pool):
    """Patches whose leaves come to a place so far from a dock, into `pool`: how many; or the nearest."""
    patch_radius, area, reach, promise = patches.radius, patches.area, patches.reach, patches.promise
    n, most = 0, most_area(sums) / (limits[0] * limits[0])
    open_area, thickest = unpromised(sums), LIKE * radius / limits[0]
    nearest, nearest_miss = -1, np.inf
    for p in range(patch_radius.size):
        if area[p] == 0.0 or area[p] > most:
            continue
        scaled = min(max(gap, limits[0] * reach[p]), limits[1] * reach[p])
        miss = max(scaled / gap, gap / scaled)
        if promise[p] > open_area:
            miss /= OVER_PROMISE
        if patch_radius[p] > thickest:
            miss *= TOO_THICK * patch_radius[p] / thickest
        if miss <= SLACK:
            pool[n] = p
            n += 1
        elif miss < nearest_miss:
            nearest, nearest_miss = p, miss
    if n == 0 and nearest >= 0:
        pool[0] = nearest
        n = 1
    return n


@_jit
def fit_place(d, gap, patience, sums, patches, docks, room, work):
    """The patch with which a place is best reached from a dock: row or -1, and scale.

    ``patience``: 1 at first, falls to 0 as places do not do, and with it what is asked of a patch.
    """
    state, limits = work.state, work.limits
    gap = max(gap, 1e-6)
    n = reaching_patches(gap, docks.radius[d], sums, patches, limits, work.pool)
    best, best_score, best_scale = -1, 0.0, 1.0
    for _ in range(TRIES if n else 0):
        p = work.pool[draw(state, n)]
        scale = min(max(gap / patches.reach[p], limits[0]), limits[1])
        comes = aim(work.place, docks.place[d], docks.way[d], patches.droop[p], work.way)
        comes &= abs(gap - scale * patches.reach[p]) <= NEAR * scale * patches.reach[p]
        turned_frame(work.way, state, work.rotation)
        share, fresh = score_space(work.rotation, scale, docks.place[d], patches.sample[p], room, work.cells)
        if share < LEAST_INSIDE * patience and not (comes and patience < IMPATIENT):
            continue
        if fresh < GROW_FRESH * patience * share:
            continue
        slope = math.asin(min(max(work.way[2], -1.0), 1.0))
        thickness = max(docks.radius[d], patches.radius[p])  # thin twigs stand on thick ones as well
        match = score_match(thickness, patches.slope[p], docks.radius[d], slope)
        score = (MATCH_FLOOR + match) * (FRESH_FLOOR + fresh) * fineness(patches.area[p], sums)
        if score > best_score:
            best, best_score, best_scale = p, score, scale
            work.best_rotation[:] = work.rotation
    return best, best_scale


@_jit
def fit_link(d, gap, sums, patches, docks, work):
    """The patch with docks that leads farthest towards a place, of a few that fit: row or -1, and scale."""
    state, limits, radius = work.state, work.limits, docks.radius[d]
    n, most = 0, MOST_LINKED * sums[TARGET] - sums[LINKED]
    for p in range(patches.radius.size):
        fits = patches.radius[p] * limits[0] <= LIKE * radius
        if fits and patches.lead[p] > 0.0 and patches.area[p] * limits[0] * limits[0] <= most:
            work.pool[n] = p
            n += 1
    best, best_score, best_scale = -1, 0.0, 1.0
    for _ in range(TRIES if n else 0):
        p = work.pool[draw(state, n)]
        scale = min(max(radius / patches.radius[p], limits[0]), limits[1])
        match = score_match(patches.radius[p], 0.0, radius, 0.0)
        steps = max(1.0, math.ceil((gap - docks.span[d]) / (LEAD_SHARE * scale * patches.lead[p])))
        if steps * patches.area[p] * scale * scale > most:
            continue
        score = (LINK_FLOOR + match) * min(scale * patches.lead[p], gap) / (most + patches.area[p])
        if score > best_score:
            best, best_score, best_scale = p, score, scale
    if best >= 0:
        aim(work.place, docks.place[d], docks.way[d], 0.0, work.way)
        turned_frame(work.way, state, work.best_rotation)
    return best, best_scale


@_jit
def span_of(radius, patches, limits):
    """Reach of the longest patch that fits to such a thickness."""
    patch_radius, area, reach = patches.radius, patches.area, patches.reach
    span, most = 0.0, LIKE * radius / limits[0]
    for p in range(patch_radius.size):
        if area[p] > 0.0 and patch_radius[p] <= most:
            span = max(span, reach[p])
    return span


@_jit
def put_patch(p, scale, d, link, patches, docks, room, work, count, sums, out, holder):
    """Hang a patch on a dock, turned by ``work.best_rotation``, and add its own docks."""
    made, rotation = count[N_MADE], work.best_rotation
    out[made, 0] = p
    out[made, 1:4] = docks.place[d]
    quaternion_of(rotation, out[made, 4:8])
    out[made, 8] = scale
    holder[made] = docks.holder[d]
    take_dock(d, docks, sums)
    gained = patches.area[p] * scale * scale
    inside = mark_filled(rotation, scale, docks.place[d], patches.sample[p], gained, room, work.cells)
    if not link:
        inside = 1.0
    sums[AREA] += gained * inside
    sums[LINKED] += gained * (1.0 - inside)
    sums[PROMISED] += patches.promise[p]
    for k in range(patches.dock_start[p], patches.dock_start[p + 1]):
        n = count[N_DOCKS]
        if n == docks.radius.size:
            break
        for axis in range(3):
            moved, turned = 0.0, 0.0
            for c in range(3):
                moved += rotation[axis, c] * patches.dock_place[k, c]
                turned += rotation[axis, c] * patches.dock_way[k, c]
            docks.place[n, axis] = out[made, 1 + axis] + scale * moved
            docks.way[n, axis] = turned
        docks.radius[n] = scale * patches.dock_radius[k]
        docks.span[n] = span_of(docks.radius[n], patches, work.limits)
        docks.promise[n] = patches.dock_promise[k]
        docks.kind[n] = patches.dock_kind[k]
        docks.holder[n] = made
        docks.used[n] = False
        count[N_DOCKS] += 1
    count[N_MADE] += 1


@_jit
def take_dock(d, docks, sums):
    """A dock has its patch, or gets none: nothing more is promised of it."""
    if not docks.used[d]:
        docks.used[d] = True
        sums[PROMISED] -= docks.promise[d]


@_jit
def next_dock(docks, count):
    """The next dock that waits, or -1."""
    while count[N_TAKEN] < count[N_DOCKS]:
        d = count[N_TAKEN]
        count[N_TAKEN] += 1
        if docks.kind[d] == QUEUED and not docks.used[d]:
            return d
    return -1


@_jit
def grow_to_place(patience, leads_from, patches, docks, room, work, count, sums, out, holder):
    """Grow to ``work.place``, over as many patches as it takes; whether the last one came there."""
    for _ in range(MOST_LINKS):
        if count[N_MADE] == out.shape[0]:
            return False
        d, gap = find_dock(work.place, docks, count[N_DOCKS], leads_from, work.limits)
        if d < 0:
            return False
        near = gap <= SLACK * work.limits[1] * docks.span[d] or docks.radius[d] < leads_from
        if near:
            p, scale = fit_place(d, gap, patience, sums, patches, docks, room, work)
        else:
            p, scale = fit_link(d, gap, sums, patches, docks, work)
        if p < 0:
            return False
        put_patch(p, scale, d, not near, patches, docks, room, work, count, sums, out, holder)
        if near:
            return True
    return False


@_jit
def docks_on_tree(vertices, graph, seeds, wood, target, patches, limits, docks):
    """Put a cluster's seeds, and the points of branches in and next to it, into `docks`: how many.

    A seed is taken for as thick as it must be to carry its cluster's leaves (thesis, Eq. 5.6), for at the
    ends of a scan's branches the thickness is little more than a guess.
    """
    low, high, middle = np.empty(3), np.empty(3), np.empty(3)
    for axis in range(3):
        low[axis] = vertices[:, axis].min()
        high[axis] = vertices[:, axis].max()
        middle[axis] = vertices[:, axis].mean()
    thickest, whole = 0.0, 0.0
    for p in range(patches.radius.size):
        thickest = max(thickest, patches.radius[p])
        whole = max(whole, patches.area[p] + patches.promise[p])
    needed = thickest * min(1.0, target / max(seeds.size, 1) / whole) ** (1.0 / PIPE_EXPONENT)
    n = seed_docks(graph[0], graph[1], graph[2], seeds, middle, needed, thickest, docks)
    most_gap = MOST_GAP if n == 0 else np.inf
    n = wood_docks(low, high, wood, needed, thickest, most_gap, docks, n)
    for d in range(n):
        docks.span[d] = span_of(docks.radius[d], patches, limits)
    return n


@_jit
def fill_cluster(hull, graph, seeds, wood, target, patches, docks, seed, limits, inside, out, holder):
    """Texture one cluster: how many instances came into ``out``, and their leaf area in the cluster.

    ``hull``: vertices and faces. ``graph``: position, parent and radius of its nodes; ``seeds``: nodes;
    ``wood``: points of branches, see `wood_docks`. ``limits``: least and most scale. ``inside``: room for
    the grid. ``out`` (most, 9): patch, position, quaternion, scale. ``holder`` (most,):
    the instance on which each hangs, -1: the tree.
    """
    work = Work(
        np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(patches.radius.size, np.int64),
        np.empty(SAMPLES, np.int64), np.array([seed], np.uint64), limits,
    )  # fmt: skip
    count, sums = np.zeros(3, np.int64), np.zeros(5)
    sums[TARGET] = target
    count[N_DOCKS] = docks_on_tree(hull[0], graph, seeds, wood, target, patches, limits, docks)
    if count[N_DOCKS] == 0:
        return 0, 0.0
    smallest, leads_from, leafy = np.inf, np.inf, 0
    for p in range(patches.radius.size):
        if patches.area[p] > 0.0:
            leafy += 1
            smallest = min(smallest, patches.area[p])
        if patches.lead[p] > 0.0:
            leads_from = min(leads_from, patches.radius[p] * limits[0] / LIKE)
    room = make_room(hull[0], hull[1], target, patches.area.sum() / leafy, inside)
    sums[LEAST] = smallest * limits[0] * limits[0]
    rest = smallest * next_random(work.state)  # so that on average small clusters get the right leaf area
    missed, grown = 0, False
    while target - sums[AREA] > rest and count[N_MADE] < out.shape[0] and missed < STALE:
        d = -1
        if count[N_MADE] == 0 or next_random(work.state) >= GROW_SHARE:
            d = next_dock(docks, count)
        if d >= 0:
            p, scale = fit_dock(d, sums, patches, docks, room, work)
            if p >= 0:
                put_patch(p, scale, d, False, patches, docks, room, work, count, sums, out, holder)
            else:
                take_dock(d, docks, sums)
            continue
        if not grown and count[N_MADE] == 0:
            middle_place(room, work.place)
        else:
            empty_place(work.state, room, work.place)
        grown = True
        patience = 1.0 - missed / STALE
        came = grow_to_place(patience, leads_from, patches, docks, room, work, count, sums, out, holder)
        missed = 0 if came else missed + 1
    return count[N_MADE], sums[AREA]
