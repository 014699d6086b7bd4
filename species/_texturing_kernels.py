"""Compiled loops of cluster texturing. Arrays in, arrays out; nothing is checked here."""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

SAMPLES = 16  # points by which a patch is compared with the space around it
MOST_SIDE = 12  # cells of a cluster's grid along its longest side
TRIES = 6  # patches that are compared for a docking point
LEAST_INSIDE = 0.45  # share of a patch's points that have to be in the cluster
DOCK_FRESH, FREE_FRESH = 0.75, 0.5  # of that share: below it the place has its leaves; with a dock, without
LIKE = 1.8  # ratio of thicknesses up to which a patch is considered where there is any such
LEAST_SCALE, MOST_SCALE = 0.8, 1.25  # of a patch, so that its thickness is the dock's
ROLL = 0.5  # radians: how far patches are turned about their axis at most
UPRIGHT = 0.9  # upward component of a direction from which on no side is up: any roll will do
MATCH_FLOOR, FRESH_FLOOR = 0.2, 0.1  # what counts besides match and free space
PLACES = 16  # cells that are compared for a patch without a docking point
FREE_SHARE = 0.3  # of patches that are put into empty places while docking points still wait
STALE = 400  # places in a row that did not do before the rest of a cluster is left empty


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


@_jit
def score_match(radius_root, slope_root, radius_dock, slope_dock):
    """Eq. 3.3, its two ingredients turned so that 1 is best: ratio of thicknesses, cosine of directions."""
    thin = min(radius_root, radius_dock) / max(radius_root, radius_dock)
    return thin * max(0.0, math.cos(slope_root - slope_dock))


@_jit
def cell_of_point(rotation, scale, position, point, grid):
    """Cell of the cluster's grid in which a placed patch has a point; -1 outside the grid."""
    low, cell, n_x, n_y, n_z = grid
    x, y, z = point[0], point[1], point[2]
    wx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z
    wy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z
    wz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
    i = int(math.floor((position[0] + scale * wx - low[0]) / cell))
    j = int(math.floor((position[1] + scale * wy - low[1]) / cell))
    k = int(math.floor((position[2] + scale * wz - low[2]) / cell))
    if 0 <= i < n_x and 0 <= j < n_y and 0 <= k < n_z:
        return (i * n_y + j) * n_z + k
    return -1


@_jit
def score_space(rotation, scale, position, sample, grid, inside, filled):
    """Shares of a patch's points that lie in the cluster, and in cells of it where there is nothing yet."""
    n_inside = 0
    fresh = 0.0
    for s in range(sample.shape[0]):
        at = cell_of_point(rotation, scale, position, sample[s], grid)
        if at >= 0 and inside[at]:
            n_inside += 1
            fresh += 1.0 / (1.0 + filled[at])
    return n_inside / sample.shape[0], fresh / sample.shape[0]


@_jit
def mark_filled(rotation, scale, position, sample, grid, amount, filled):
    """Add a patch's leaf area, in units of what a full cell holds, to the cells of its points."""
    for s in range(sample.shape[0]):
        at = cell_of_point(rotation, scale, position, sample[s], grid)
        if at >= 0:
            filled[at] += amount / sample.shape[0]


@_jit
def candidates(radius_dock, patch_radius, by_radius):
    """Range of `by_radius` with thicknesses like the dock's; the nearest few if there is none."""
    n = by_radius.size
    first = 0
    while first < n and patch_radius[by_radius[first]] < radius_dock / LIKE:
        first += 1
    last = first
    while last < n and patch_radius[by_radius[last]] <= radius_dock * LIKE:
        last += 1
    if last - first < 3:
        last = min(n, max(last, first + 3))
        first = max(0, last - max(3, last - first))
    return first, last


@_jit
def empty_place(state, low, cell, n_x, n_y, n_z, inside, filled, position):
    """A place in the emptiest of a few cells of the cluster, into ``position``; whether one was found."""
    best = np.inf
    at = -1
    for _ in range(PLACES):
        trial = int(next_random(state) * (n_x * n_y * n_z))
        if inside[trial] and filled[trial] < best:
            best = filled[trial]
            at = trial
    if at < 0:
        return False
    position[0] = low[0] + (at // (n_y * n_z) + next_random(state)) * cell
    position[1] = low[1] + (at // n_z % n_y + next_random(state)) * cell
    position[2] = low[2] + (at % n_z + next_random(state)) * cell
    return True


@_jit
def away_from_wood(position, dock_position, low, high, direction):
    """Unit vector from the nearest seed, or without seeds from the cluster's middle."""
    nearest = -1
    gap = np.inf
    for d in range(dock_position.shape[0]):
        g = 0.0
        for axis in range(3):
            g += (dock_position[d, axis] - position[axis]) ** 2
        if g < gap:
            gap = g
            nearest = d
    size = 0.0
    for axis in range(3):
        origin = 0.5 * (low[axis] + high[axis])
        if nearest >= 0:
            origin = dock_position[nearest, axis]
        direction[axis] = position[axis] - origin
        size += direction[axis] ** 2
    size = math.sqrt(size)
    if size < 1e-9:
        direction[0], direction[1], direction[2] = 0.0, 0.0, 1.0
        return
    for axis in range(3):
        direction[axis] /= size


@_jit
def choose_patch(
    direction, radius, position, patches, grid, inside, filled, state, least_fresh, rotation, best_rotation
):
    """The patch of a few that fits a docking point best (Eq. 3.3, and space): row or -1, and scale."""
    patch_radius, patch_slope, by_radius, sample = patches
    slope = math.asin(min(max(direction[2], -1.0), 1.0))
    first, last = candidates(radius, patch_radius, by_radius)
    best = -1
    best_score = 0.0
    best_scale = 1.0
    for _ in range(TRIES):
        p = by_radius[first + int(next_random(state) * (last - first))]
        scale = min(max(radius / patch_radius[p], LEAST_SCALE), MOST_SCALE)
        roll = ROLL * (2.0 * next_random(state) - 1.0)
        if abs(direction[2]) > UPRIGHT:
            roll *= math.pi / ROLL
        frame_of(direction[0], direction[1], direction[2], roll, rotation)
        share, fresh = score_space(rotation, scale, position, sample[p], grid, inside, filled)
        if share < LEAST_INSIDE or fresh < least_fresh * share:
            continue
        match = score_match(patch_radius[p], patch_slope[p], radius, slope)
        score = (MATCH_FLOOR + match) * (FRESH_FLOOR + fresh)
        if score > best_score:
            best, best_score, best_scale = p, score, scale
            best_rotation[:] = rotation
    return best, best_scale


@_jit
def add_docks(rotation, scale, position, first, last, docks, queue, waiting):
    """Put a patch's docking points at the end of the queue; how many wait then."""
    docks_position, docks_direction, docks_radius = docks
    for d in range(first, last):
        if waiting >= queue.shape[0]:
            break
        for axis in range(3):
            moved = 0.0
            turned = 0.0
            for c in range(3):
                moved += rotation[axis, c] * docks_position[d, c]
                turned += rotation[axis, c] * docks_direction[d, c]
            queue[waiting, axis] = position[axis] + scale * moved
            queue[waiting, 3 + axis] = turned
        queue[waiting, 6] = scale * docks_radius[d]
        waiting += 1
    return waiting


@_jit
def fill_cluster(
    vertices, faces, seeds, target, patches, patch_area, reach, dock_start, docks, seed, scratch, out
):
    """Texture one cluster; how many instances came into ``out``, their leaf area, how many without a dock.

    ``seeds``: position, direction, radius of the docking points on the tree. ``patches``: radius, slope,
    rows by radius, sample points. ``reach``: how far along its axis a patch's leaves lie. ``docks``:
    position, direction, radius of the patches' docking points, ``dock_start`` those of each patch.
    ``scratch``: inside and filled of each cell, and the queue of docking points (most, 7). ``out``
    (most, 9): patch, position, quaternion, scale.
    """
    inside, filled, queue = scratch
    seed_position, seed_direction, seed_radius = seeds
    patch_radius, _, by_radius, sample = patches
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
    filled[: n_x * n_y * n_z] = 0.0
    n_inside = 0
    for at in range(n_x * n_y * n_z):
        n_inside += inside[at]
    if n_inside == 0:
        return 0, 0.0, 0
    waiting = seed_radius.size
    for d in range(waiting):
        queue[d, :3] = seed_position[d]
        queue[d, 3:6] = seed_direction[d]
        queue[d, 6] = seed_radius[d]
    state = np.array([seed], np.uint64)
    rotation = np.empty((3, 3))
    best_rotation = np.empty((3, 3))
    position = np.empty(3)
    direction = np.empty(3)
    grid = (low, cell, n_x, n_y, n_z)
    thickest = patch_radius[by_radius[by_radius.size - 1]]
    full = target / n_inside
    area = 0.0
    made = taken = missed = free = 0
    while area < target and made < out.shape[0] and missed < STALE:
        docked = taken < waiting and (made == 0 or next_random(state) >= FREE_SHARE)
        if docked:
            position[:] = queue[taken, :3]
            direction[:] = queue[taken, 3:6]
            radius = min(queue[taken, 6], thickest)
            taken += 1
        else:
            if not empty_place(state, low, cell, n_x, n_y, n_z, inside, filled, position):
                missed += 1
                continue
            away_from_wood(position, seed_position, low, high, direction)
            pick = by_radius[int(next_random(state) * by_radius.size)]
            radius = patch_radius[pick]
            for axis in range(3):
                position[axis] -= reach[pick] * direction[axis]
        least = DOCK_FRESH if docked else FREE_FRESH
        best, scale = choose_patch(
            direction, radius, position, patches, grid, inside, filled, state, least, rotation, best_rotation
        )
        if best < 0:
            missed += not docked
            continue
        missed = 0
        free += not docked
        out[made, 0] = best
        out[made, 1:4] = position
        quaternion_of(best_rotation, out[made, 4:8])
        out[made, 8] = scale
        made += 1
        gained = patch_area[best] * scale * scale
        area += gained
        mark_filled(best_rotation, scale, position, sample[best], grid, gained / full, filled)
        waiting = add_docks(
            best_rotation, scale, position, dock_start[best], dock_start[best + 1], docks, queue, waiting
        )
    return made, area, free
