"""Compiled loops of the fast light model. Arrays in, arrays out; nothing is checked here.

One query point at a time. Its sky has rows of float32: x, y, z of the cells' directions, what is let through,
and what the present branch covers. What is let through starts at what the obstacles leave and is multiplied
by each leaf sphere and each branch, on the tiles of 16 cells that its shadow touches. The work on a tile and
the search for tiles do not branch, so that the compiler turns them into vector code; four tiles stand
together, so that the distances between their rows are constant and it need not ask whether they overlap.
"""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath
_jit_fused = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})  # a * b + c in one step

BLOCK = 64  # leaf spheres whose rows stand together as they come in
LEAF_ROWS = 5  # x, y, z, radius, gamma
BATCH = 128  # leaf spheres that are projected together
LANES = 16  # float32 numbers in a cache line: cells of a tile
SUBCELLS = 4  # directions per cell at which obstacles are tested
DARK = np.float32(1e-30)  # less is 0: arithmetic with denormal numbers is many times slower
QUARTERS = 4  # tiles that a quarter turn about the vertical makes of one
GROUP = 8  # tiles that are searched together
TILE_ROWS = 4  # x, y, z of a tile's axis over the cosine of its radius, and the radius' tangent
SKY_ROWS = 5  # x, y, z, let through, covered
PANEL = QUARTERS * LANES  # cells whose rows stand together in the sky
OPEN = 3 * PANEL  # distance of what is let through from x
COVER = 4 * PANEL
CAP_ROWS = 6  # a (3), offset, top, reach
HEIGHT_BINS = 256  # leaf spheres are sorted by height into so many
PLACE_ROWS = 6  # x, y, z, and what float32 leaves of them
SIZE_ROWS = 2  # radius, 1 - gamma


def _list_bits() -> tuple[np.ndarray, np.ndarray]:
    """Of each byte: which bits are set, as four and four uint16 times BATCH in two uint64, and how many."""
    place, count = np.zeros((256, GROUP), np.uint16), np.zeros(256, np.int64)
    for byte in range(256):
        bits = [k for k in range(GROUP) if byte >> k & 1]
        place[byte, : len(bits)] = bits
        count[byte] = len(bits)
    four = (place.astype(np.uint64) * np.uint64(BATCH)).reshape(256, 2, 4)
    return (four << np.arange(0, 64, 16, dtype=np.uint64)).sum(axis=2).ravel(), count


BIT_PLACES, BIT_COUNT = _list_bits()
SPLAT = np.uint64(0x0001000100010001)  # times a uint16: four of it


@_jit
def _place_of_tile(tile):
    """Where its first cell's x stands in the sky."""
    cell = tile * np.uint64(LANES)
    return cell + cell // np.uint64(PANEL) * np.uint64((SKY_ROWS - 1) * PANEL)


@_jit
def _aligned_room(size):
    """Float32 array (size,) that begins at a cache line, not cleared."""
    room = np.empty(size + LANES, np.float32)
    begin = (-room.ctypes.data % (4 * LANES)) // 4
    return room[begin : begin + size]


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _weigh(weight, trans):
    """Sums of the products with the four rows of ``weight``, in whatever order is fastest."""
    amount = 0.0
    x = 0.0
    y = 0.0
    z = 0.0
    for i in range(np.uint64(trans.size)):
        t = np.float64(trans[i])
        amount += weight[0, i] * t
        x += weight[1, i] * t
        y += weight[2, i] * t
        z += weight[3, i] * t
    return amount, x, y, z


@_jit
def _measure_leaves(n_leaves, leaves, rank):
    """Centre (x, y) and radius of an upright cylinder around their centres; each one's height in ``rank``."""
    low = np.full(3, np.inf)
    high = np.full(3, -np.inf)
    for k in range(n_leaves):
        i = (k // BLOCK) * LEAF_ROWS * BLOCK + k % BLOCK
        for axis in range(3):
            low[axis] = min(low[axis], leaves[i + axis * BLOCK])
            high[axis] = max(high[axis], leaves[i + axis * BLOCK])
    scale = (HEIGHT_BINS - 1) / (high[2] - low[2]) if high[2] > low[2] else 0.0
    for k in range(n_leaves):
        rank[k] = int((high[2] - leaves[((k // BLOCK) * LEAF_ROWS + 2) * BLOCK + k % BLOCK]) * scale)
    x = 0.5 * (low[0] + high[0])
    y = 0.5 * (low[1] + high[1])
    return x, y, math.hypot(high[0] - x, high[1] - y)


@_jit
def _sort_leaves(n_leaves, leaves, sin_tent):
    """Leaf spheres from high to low, in batches of PLACE_ROWS and SIZE_ROWS rows, filled up with nothing.

    ``rank`` (n_leaves,) is where each one went. ``top`` (one per LANES of them): a point that is higher than
    this by sin_tent / (1 - sin_tent) times its greatest level distance from any leaf has them and all that
    follow, with their blurred edges, below its horizon. The level distance is at most that from (x, y) and
    the radius together: the cylinder is around all centres.
    """
    n_batches = (n_leaves + BATCH - 1) // BATCH
    place = _aligned_room(n_batches * PLACE_ROWS * BATCH)
    size = _aligned_room(n_batches * SIZE_ROWS * BATCH)
    place[:] = 0.0
    for i in range(size.size):
        size[i] = 1.0 if i % (SIZE_ROWS * BATCH) < BATCH else 0.0
    rank = np.empty(n_leaves, np.int64)
    top = np.full((n_leaves + LANES - 1) // LANES, -np.inf)
    x, y, radius = _measure_leaves(n_leaves, leaves, rank)
    begin = np.zeros(HEIGHT_BINS + 1, np.int64)
    for k in range(n_leaves):
        begin[rank[k] + 1] += 1
    for b in range(HEIGHT_BINS):
        begin[b + 1] += begin[b]
    for k in range(n_leaves):
        i = (k // BLOCK) * LEAF_ROWS * BLOCK + k % BLOCK
        to = begin[rank[k]]
        begin[rank[k]] += 1
        rank[k] = to
        batch = to // BATCH
        j = to % BATCH
        for axis in range(3):
            whole = np.float32(leaves[i + axis * BLOCK])
            place[(batch * PLACE_ROWS + axis) * BATCH + j] = whole
            place[(batch * PLACE_ROWS + 3 + axis) * BATCH + j] = leaves[i + axis * BLOCK] - whole
        size[batch * SIZE_ROWS * BATCH + j] = leaves[i + 3 * BLOCK]
        size[(batch * SIZE_ROWS + 1) * BATCH + j] = 1.0 - leaves[i + 4 * BLOCK]
        reach = leaves[i + 2 * BLOCK] + leaves[i + 3 * BLOCK] / (1.0 - sin_tent)
        top[to // LANES] = max(top[to // LANES], reach)
    for group in range(top.size - 2, -1, -1):
        top[group] = max(top[group], top[group + 1])
    return place, size, rank, top, x, y, radius


@_jit_fused
def _project_leaves(px, py, pz, batch, n, place, size, sin_blur, cos_tent, cap):
    """What each of the first n leaf spheres of a batch is in the sky: rows a (3), offset, top, reach.

    The blurred coverage of a sphere of angular radius alpha is a ramp in the cosine from the axis, from 0 at
    c_out to 1 at c_in with c_in + c_out = 2 cos(alpha), so that its integral is the sphere's solid angle.
    Where c_in would pass 1 the ramp ends lower. It is a . w - offset, from 0 to top; reach is the sine that
    belongs to c_out in the same unit. top < 0 says that the point is inside: then all else is 0. Returns
    how many it is inside of.
    Without branches and with rows at constant distances this is vector code over the spheres.
    """
    zero = np.float32(0.0)
    one = np.float32(1.0)
    two = np.float32(2.0)
    count = np.uint32(0)
    ux = np.float32(px)
    uy = np.float32(py)
    uz = np.float32(pz)
    vx = np.float32(px - ux)
    vy = np.float32(py - uy)
    vz = np.float32(pz - uz)
    at = np.uint64(batch) * np.uint64(PLACE_ROWS * BATCH)
    at_size = np.uint64(batch) * np.uint64(SIZE_ROWS * BATCH)
    for j in range(np.uint64(n)):
        i = at + j
        x = (place[i] - ux) + (place[i + np.uint64(3 * BATCH)] - vx)
        y = (place[i + np.uint64(BATCH)] - uy) + (place[i + np.uint64(4 * BATCH)] - vy)
        z = (place[i + np.uint64(2 * BATCH)] - uz) + (place[i + np.uint64(5 * BATCH)] - vz)
        r = size[at_size + j]
        dim = size[at_size + j + np.uint64(BATCH)]
        d2 = x * x + y * y + z * z
        inside = d2 <= r * r
        count += np.uint32(inside)
        inv = one / np.sqrt(d2 if d2 > zero else one)
        s = one if inside else r * inv  # at most 1: r (1 / r) rounds to 1 or less
        c = np.sqrt(one - s * s)
        area = s * s / (one + c)  # 1 - cos, without cancellation
        half = s * sin_blur
        narrow = one - two * area
        narrow = narrow if narrow < cos_tent else cos_tent
        wide = half <= area
        c_out = c - half if wide else narrow
        per_run = one / (half + half if wide else one - narrow)
        top = dim if wide else dim * two * area * per_run
        slope = zero if inside else top * per_run
        scaled = inv * slope
        s2 = one - c_out * c_out
        cap[j] = x * scaled
        cap[j + np.uint64(BATCH)] = y * scaled
        cap[j + np.uint64(2 * BATCH)] = z * scaled
        cap[j + np.uint64(3 * BATCH)] = c_out * slope
        cap[j + np.uint64(4 * BATCH)] = -one if inside else top
        cap[j + np.uint64(5 * BATCH)] = slope * np.sqrt(s2 if s2 > zero else zero)
    return np.uint32(count)  # so that 32 bits are counted in, beside the float32


@_jit_fused
def _find_tiles(cap, n, tile, group, hit):
    """Bit k of ``hit[j]``: cap j touches tile k of the group, cos(angle) > cos(width + radius).

    Over the product of slope and the cosine of the radius that is a . axis > offset - reach tan(radius).
    """
    at = np.uint64(group) * np.uint64(GROUP // QUARTERS * TILE_ROWS)
    for j in range(np.uint64(n)):
        bits = np.uint32(0)
        for k in range(np.uint64(GROUP // QUARTERS)):
            x = tile[at + k * np.uint64(TILE_ROWS)]
            y = tile[at + k * np.uint64(TILE_ROWS) + np.uint64(1)]
            z = tile[at + k * np.uint64(TILE_ROWS) + np.uint64(2)]
            tangent = tile[at + k * np.uint64(TILE_ROWS) + np.uint64(3)]
            over = cap[j + np.uint64(5 * BATCH)] * tangent - cap[j + np.uint64(3 * BATCH)]
            over += cap[j + np.uint64(2 * BATCH)] * z
            along = cap[j] * x + cap[j + np.uint64(BATCH)] * y
            across = cap[j + np.uint64(BATCH)] * x - cap[j] * y
            bit = np.uint32(1) << (np.uint64(QUARTERS) * k)
            bits |= bit if along > -over else np.uint32(0)
            bits |= bit << np.uint32(1) if across > -over else np.uint32(0)
            bits |= bit << np.uint32(2) if along < over else np.uint32(0)
            bits |= bit << np.uint32(3) if across < over else np.uint32(0)
        hit[j] = bits


@_jit
def _list_pairs(hit, n, pair):
    """All pairs of a cap and a tile that it touches, as tile * BATCH + cap; returns how many.

    Four places are written for each cap, in one step once the compiler has joined them, and overwritten by
    the next one as far as they do not count; rarely four more. So no branch is hard to foresee.
    """
    m = np.uint64(0)
    for j in range(np.uint64(n)):
        byte = np.uint64(hit[j])
        code = j * SPLAT
        four = code + BIT_PLACES[byte * np.uint64(2)]
        pair[m] = np.uint16(four)
        pair[m + np.uint64(1)] = np.uint16(four >> np.uint64(16))
        pair[m + np.uint64(2)] = np.uint16(four >> np.uint64(32))
        pair[m + np.uint64(3)] = np.uint16(four >> np.uint64(48))
        if BIT_COUNT[byte] > 4:
            four = code + BIT_PLACES[byte * np.uint64(2) + np.uint64(1)]
            pair[m + np.uint64(4)] = np.uint16(four)
            pair[m + np.uint64(5)] = np.uint16(four >> np.uint64(16))
            pair[m + np.uint64(6)] = np.uint16(four >> np.uint64(32))
            pair[m + np.uint64(7)] = np.uint16(four >> np.uint64(48))
        m += np.uint64(BIT_COUNT[byte])
    return m


@_jit_fused
def _shade_pairs(sky, cap, pair, m, group):
    """Multiply the cells of each tile by 1 - clamp(a . w - offset, 0, top) of its cap."""
    zero = np.float32(0.0)
    first_of_group = np.uint64(group) * np.uint64(GROUP * LANES * SKY_ROWS)
    for p in range(np.uint64(m)):
        code = np.uint64(pair[p])
        j = code & np.uint64(BATCH - 1)
        first = first_of_group + _place_of_tile(code // np.uint64(BATCH))
        ax = cap[j]
        ay = cap[j + np.uint64(BATCH)]
        az = cap[j + np.uint64(2 * BATCH)]
        offset = cap[j + np.uint64(3 * BATCH)]
        top = cap[j + np.uint64(4 * BATCH)]
        for i in range(first, first + np.uint64(LANES)):
            f = az * sky[i + np.uint64(2 * PANEL)] - offset
            f += ay * sky[i + np.uint64(PANEL)]
            f += ax * sky[i]
            f = f if f > zero else zero
            f = f if f < top else top
            t = sky[i + np.uint64(OPEN)]
            sky[i + np.uint64(OPEN)] = t - t * f


@_jit
def _around(cap, size, batch, n):
    """The factor of the spheres of a batch that contain the point: they dim the whole sky."""
    factor = 1.0
    for j in range(n):
        if cap[j + 4 * BATCH] < 0.0:
            factor *= 1.0 - size[(batch * SIZE_ROWS + 1) * BATCH + j]
    return factor


@_jit
def _clear_dark(sky):
    """Let nothing through where it is next to nothing."""
    for panel in range(np.uint64(sky.size // (SKY_ROWS * PANEL))):
        first = panel * np.uint64(SKY_ROWS * PANEL) + np.uint64(OPEN)
        for i in range(first, first + np.uint64(PANEL)):
            sky[i] = sky[i] if sky[i] > DARK else np.float32(0.0)


@_jit
def _shade_leaves(px, py, pz, n, own, place, size, sin_blur, cos_tent, cap, tile, hit, pair, sky):
    """The first n leaf spheres on one point; returns the factor of those around it."""
    around = 1.0
    for first in range(0, n, BATCH):
        batch = first // BATCH
        some = min(BATCH, n - first)
        inside = _project_leaves(px, py, pz, batch, some, place, size, sin_blur, cos_tent, cap)
        if first <= own < first + some:
            for row in range(CAP_ROWS):
                cap[row * BATCH + own - first] = 0.0
        if inside > 0:
            around *= _around(cap, size, batch, some)
        for group in range(tile.size // (GROUP // QUARTERS * TILE_ROWS)):
            _find_tiles(cap, some, tile, group, hit)
            m = _list_pairs(hit, some, pair)
            _shade_pairs(sky, cap, pair, m, group)
        if first + BATCH < n:
            _clear_dark(sky)
    return around


@_jit
def _nearest_gap(x, y, z, ex, ey, ez, r, dr):
    """Least distance of the origin from the spheres c + s e, r + s dr of one branch; <= 0 inside."""
    a = ex * ex + ey * ey + ez * ez - dr * dr
    ce = x * ex + y * ey + z * ez
    # d/ds (|c + s e| - r - s dr) = 0 where the axis meets the cone's normal through the origin
    length2 = ex * ex + ey * ey + ez * ez
    s = 0.0
    if a > 0.0 and length2 > 0.0:
        off2 = max(0.0, x * x + y * y + z * z - ce * ce / length2)
        s = -ce / length2 + dr * math.sqrt(off2 / (length2 * a))
        s = min(max(s, 0.0), 1.0)
    elif dr > 0.0:
        s = 1.0
    gx = x + s * ex
    gy = y + s * ey
    gz = z + s * ez
    return math.sqrt(gx * gx + gy * gy + gz * gz) - r - s * dr


@_jit_fused
def _cover_cone(sky, first, x, y, z, ex, ey, ez, r, dr, join0, join1, blur):
    """Add the blurred coverage of one piece of a branch on one tile. All lengths in one unit, float32.

    It is that of a strip, blurred by a box of half width blur across and along: exact for straight strips,
    however narrow or short. A free end (join 0) is longer by pi/4 of its radius, which is a half disc's
    area, and by all of it where it is seen end-on. Pieces that follow each other add up to one strip.
    """
    zero = np.float32(0.0)
    one = np.float32(1.0)
    half = np.float32(0.5)
    tiny = np.float32(1e-12)
    floor = np.float32(0.05)  # cosine of the branch's half width below which the ramp is not narrowed further
    free0 = one - join0
    free1 = one - join1
    per_blur = half / blur
    flat = np.float32(1.0 - 0.25 * math.pi) / (ex * ex + ey * ey + ez * ez + tiny)
    for i in range(first, first + np.uint64(LANES)):
        wx = sky[i]
        wy = sky[i + np.uint64(PANEL)]
        wz = sky[i + np.uint64(2 * PANEL)]
        ux = wy * z - wz * y
        uy = wz * x - wx * z
        uz = wx * y - wy * x
        vx = wy * ez - wz * ey
        vy = wz * ex - wx * ez
        vz = wx * ey - wy * ex
        vv = vx * vx + vy * vy + vz * vz + tiny
        s = -(ux * vx + uy * vy + uz * vz) / vv
        near = s if s > zero else zero
        near = near if near < one else one
        ux += s * vx
        uy += s * vy
        uz += s * vz
        nx = x + near * ex
        ny = y + near * ey
        nz = z + near * ez
        t = nx * wx + ny * wy + nz * wz
        inv = one / np.sqrt(nx * nx + ny * ny + nz * nz + tiny)
        radius = r + near * dr
        sine = radius * inv
        c2 = one - sine * sine
        cosine = np.sqrt(c2 if c2 > floor * floor else floor * floor)
        f = half + (radius - np.sqrt(ux * ux + uy * uy + uz * uz)) * inv * per_blur / cosine
        top = sine / blur
        top = top if top < one else one
        f = f if f > zero else zero
        f = f if f < top else top
        step = np.sqrt(vv) * inv
        cap = sine * (one - flat * vv)
        begun = half + (s * step + free0 * cap) * per_blur
        ended = half + ((one - s) * step + free1 * cap) * per_blur
        begun = begun if begun < one else one
        ended = ended if ended < one else one
        along = begun + ended - one
        along = along if along > zero else zero
        sky[i + np.uint64(COVER)] += f * along if t > zero else zero


@_jit_fused
def _apply_cover(sky, panel):
    """Multiply the cells of a panel by 1 - the coverage of a branch, and clear it."""
    zero = np.float32(0.0)
    one = np.float32(1.0)
    first = panel * np.uint64(SKY_ROWS * PANEL)
    for i in range(first, first + np.uint64(PANEL)):
        t = one - sky[i + np.uint64(COVER)]
        t = sky[i + np.uint64(OPEN)] * (t if t > zero else zero)
        sky[i + np.uint64(OPEN)] = t if t > DARK else zero
        sky[i + np.uint64(COVER)] = zero


@_jit_fused
def _tiles_of_cap(tile, n_tiles, ax, ay, az, cosine, sine, found):
    """Tiles that a cap of the given width around an axis touches, in ``found``; returns how many."""
    n = np.uint64(0)
    for k in range(np.uint64(n_tiles // QUARTERS)):
        x = tile[k * np.uint64(TILE_ROWS)]
        y = tile[k * np.uint64(TILE_ROWS) + np.uint64(1)]
        z = tile[k * np.uint64(TILE_ROWS) + np.uint64(2)]
        over = sine * tile[k * np.uint64(TILE_ROWS) + np.uint64(3)] - cosine + az * z
        along = ax * x + ay * y
        across = ay * x - ax * y
        t = k * np.uint64(QUARTERS)
        found[n] = t
        n += np.uint64(along > -over)
        found[n] = t + np.uint64(1)
        n += np.uint64(across > -over)
        found[n] = t + np.uint64(2)
        n += np.uint64(along < over)
        found[n] = t + np.uint64(3)
        n += np.uint64(across < over)
    return n


@_jit
def _finish_branch(sky, covered):
    """Shade the panels that it may cover."""
    for panel in range(np.uint64(covered.size)):
        if covered[panel]:
            _apply_cover(sky, panel)
            covered[panel] = False


@_jit
def _shade_branches(px, py, pz, branches, cos_reach, sin_reach, blur, tile, found, covered, sky):
    """All branches on one point; pieces that contain it do not shade it."""
    n_tiles = sky.size // (SKY_ROWS * LANES)
    for k in range(branches.shape[0]):
        if branches[k, 11] == 0.0:
            _finish_branch(sky, covered)
        x = branches[k, 0] - px
        y = branches[k, 1] - py
        z = branches[k, 2] - pz
        ex = branches[k, 3]
        ey = branches[k, 4]
        ez = branches[k, 5]
        r = branches[k, 6]
        dr = branches[k, 7]
        mx = x + 0.5 * ex
        my = y + 0.5 * ey
        mz = z + 0.5 * ez
        d = math.sqrt(mx * mx + my * my + mz * mz)
        bound = branches[k, 10]
        cosine = np.float32(-1.0)  # all tiles
        sine = np.float32(0.0)
        inv = np.float32(0.0)
        if bound < d:
            inv = np.float32(1.0 / d)
            s = bound / d
            c = math.sqrt(1.0 - s * s)
            cosine = np.float32(c * cos_reach - s * sin_reach)
            sine = np.float32(s * cos_reach + c * sin_reach)
        elif _nearest_gap(x, y, z, ex, ey, ez, r, dr) <= 0.0:
            continue
        n = _tiles_of_cap(
            tile,
            n_tiles,
            np.float32(mx) * inv,
            np.float32(my) * inv,
            np.float32(mz) * inv,
            cosine,
            sine,
            found,
        )
        unit = 1.0 / max(d, bound)
        for m in range(n):
            t = found[m]
            _cover_cone(
                sky,
                _place_of_tile(t),
                np.float32(x * unit),
                np.float32(y * unit),
                np.float32(z * unit),
                np.float32(ex * unit),
                np.float32(ey * unit),
                np.float32(ez * unit),
                np.float32(r * unit),
                np.float32(dr * unit),
                np.float32(branches[k, 8]),
                np.float32(branches[k, 9]),
                blur,
            )
            covered[t // np.uint64(PANEL // LANES)] = True
    _finish_branch(sky, covered)


@_jit_fused
def _shade_plane(trans, wx, wy, wz, nx, ny, nz, gamma, per_edge):
    """Directions against the outward normal run into a half-space; its edge is a ramp 1 / per_edge wide."""
    zero = np.float32(0.0)
    one = np.float32(1.0)
    half = np.float32(0.5)
    for i in range(np.uint64(wx.size)):
        past = half + (nx * wx[i] + ny * wy[i] + nz * wz[i]) * per_edge
        past = past if past > zero else zero
        past = past if past < one else one
        trans[i] *= gamma + (one - gamma) * past


@_jit_fused
def _shade_ball(trans, wx, wy, wz, x, y, z, r, gamma, blur, tent):
    """A ball that does not contain the point: a leaf sphere's ramp (see _project_leaves)."""
    zero = np.float32(0.0)
    one = np.float32(1.0)
    d = math.sqrt(x * x + y * y + z * z)
    s = r / d
    c = math.sqrt(max(0.0, 1.0 - s * s))
    area = s * s / (1.0 + c)
    half = s * math.sin(blur)
    wide = half <= area
    c_out = c - half if wide else min(1.0 - 2.0 * area, math.cos(tent))
    run = 2.0 * half if wide else 1.0 - c_out
    dim = 1.0 - gamma
    top = np.float32(dim if wide else dim * 2.0 * area / run)
    slope = top / run
    ax = np.float32(x / d * slope)
    ay = np.float32(y / d * slope)
    az = np.float32(z / d * slope)
    offset = np.float32(c_out * slope)
    for i in range(np.uint64(wx.size)):
        f = ax * wx[i] + ay * wy[i] + az * wz[i] - offset
        f = f if f > zero else zero
        f = f if f < top else top
        trans[i] *= one - f


@_jit_fused
def _shade_box(trans, wx, wy, wz, box, px, py, pz):
    """Slab test of one box (centre 3, rows of its frame 9, half sizes 3, gamma) in every direction."""
    zero = np.float32(0.0)
    one = np.float32(1.0)
    gamma = np.float32(box[15])
    m = np.empty(3, np.float32)
    for axis in range(3):
        away = (box[0] - px) * box[3 + 3 * axis]
        away += (box[1] - py) * box[4 + 3 * axis]
        away += (box[2] - pz) * box[5 + 3 * axis]
        m[axis] = away
    m0 = m[0]
    m1 = m[1]
    m2 = m[2]
    h0 = np.float32(box[12])
    h1 = np.float32(box[13])
    h2 = np.float32(box[14])
    a0 = np.float32(box[3])
    a1 = np.float32(box[4])
    a2 = np.float32(box[5])
    b0 = np.float32(box[6])
    b1 = np.float32(box[7])
    b2 = np.float32(box[8])
    c0 = np.float32(box[9])
    c1 = np.float32(box[10])
    c2 = np.float32(box[11])
    for i in range(np.uint64(wx.size)):
        inv0 = one / (a0 * wx[i] + a1 * wy[i] + a2 * wz[i])
        inv1 = one / (b0 * wx[i] + b1 * wy[i] + b2 * wz[i])
        inv2 = one / (c0 * wx[i] + c1 * wy[i] + c2 * wz[i])
        mid0 = m0 * inv0
        mid1 = m1 * inv1
        mid2 = m2 * inv2
        half0 = h0 * abs(inv0)
        half1 = h1 * abs(inv1)
        half2 = h2 * abs(inv2)
        near = mid0 - half0
        far = mid0 + half0
        near = mid1 - half1 if mid1 - half1 > near else near
        far = mid1 + half1 if mid1 + half1 < far else far
        near = mid2 - half2 if mid2 - half2 > near else near
        far = mid2 + half2 if mid2 + half2 < far else far
        near = near if near > zero else zero
        trans[i] *= gamma if near <= far else one


@_jit
def _shade_obstacles(px, py, pz, planes, balls, boxes, sx, sy, sz, blur, tent, trans):
    """Obstacles at the finer directions: boxes have hard edges, the others less than a cell's blur."""
    for k in range(planes.shape[0]):
        nx = planes[k, 3]
        ny = planes[k, 4]
        nz = planes[k, 5]
        gamma = np.float32(planes[k, 6])
        if (px - planes[k, 0]) * nx + (py - planes[k, 1]) * ny + (pz - planes[k, 2]) * nz <= 0.0:
            trans *= gamma
        else:
            per_edge = np.float32(1.0 / blur)  # the lowest directions see past level ground
            _shade_plane(trans, sx, sy, sz, np.float32(nx), np.float32(ny), np.float32(nz), gamma, per_edge)
    for k in range(balls.shape[0]):
        x = balls[k, 0] - px
        y = balls[k, 1] - py
        z = balls[k, 2] - pz
        r = balls[k, 3]
        if x * x + y * y + z * z <= r * r:
            trans *= np.float32(balls[k, 4])
        else:
            _shade_ball(trans, sx, sy, sz, x, y, z, r, balls[k, 4], 0.5 * blur, 0.5 * tent)
    for k in range(boxes.shape[0]):
        _shade_box(trans, sx, sy, sz, boxes[k], px, py, pz)


@_jit
def _open_sky(grid):
    """A clear sky."""
    n_cells = grid[0].size
    sky = _aligned_room(SKY_ROWS * n_cells)
    for panel in range(n_cells // PANEL):
        for j in range(PANEL):
            at = panel * SKY_ROWS * PANEL + j
            sky[at] = grid[0][panel * PANEL + j]
            sky[at + PANEL] = grid[1][panel * PANEL + j]
            sky[at + 2 * PANEL] = grid[2][panel * PANEL + j]
            sky[at + OPEN] = 1.0
            sky[at + COVER] = 0.0
    return sky


@_jit
def _dim_sky(sky, finer):
    """Write the means over the finer directions into the sky."""
    n_cells = np.uint64(finer.size // SUBCELLS)
    for panel in range(n_cells // np.uint64(PANEL)):
        to = panel * np.uint64(SKY_ROWS * PANEL) + np.uint64(OPEN)
        for j in range(np.uint64(PANEL)):
            i = panel * np.uint64(PANEL) + j
            total = finer[i] + finer[n_cells + i]
            total += finer[np.uint64(2) * n_cells + i] + finer[np.uint64(3) * n_cells + i]
            sky[to + j] = total * np.float32(0.25)


@_jit
def _take_light(sky, trans):
    """Read what is let through from the sky, and open it for the next point."""
    for panel in range(np.uint64(trans.size // PANEL)):
        at = panel * np.uint64(SKY_ROWS * PANEL) + np.uint64(OPEN)
        for j in range(np.uint64(PANEL)):
            t = sky[at + j]
            trans[panel * np.uint64(PANEL) + j] = t if t > DARK else np.float32(0.0)
            sky[at + j] = np.float32(1.0)


@_jit
def gather(
    points,
    own,
    n_leaves,
    leaves,
    branches,
    obstacles,
    seen,
    grid,
    fine,
    weight,
    trans,
    blur,
    tent,
    amount,
    vector,
):
    """Fill ``amount`` (n,) and ``vector`` (n, 3) with the light at each point.

    ``leaves`` (blocks * 5 * BLOCK,) has the rows x, y, z, radius, gamma of each block one after the other.
    ``branches`` (m, 12): start, end - start, radius, its change, joined at start and end, half length +
    radius, and whether it goes on from the row before.
    ``seen`` (n, 4 N) float32 is what the meshes let through per finer direction, or has no row.
    ``grid``: x, y, z (N,) float32 of the cells, LANES to a tile, PANEL to a tile with its quarter turns, 0
    where filled up; and TILE_ROWS float32 for each panel, flat, filled up to an even number of panels.
    ``weight`` (4, N) float64: share of the light of each cell, and its three components times the direction.
    ``trans`` (N,) float32 is scratch.
    """
    tile = grid[3]
    n_cells = grid[0].size
    sky = _open_sky(grid)
    finer = np.empty(SUBCELLS * n_cells, np.float32)
    cap = _aligned_room(CAP_ROWS * BATCH)
    hit = np.empty(BATCH, np.uint32)
    pair = np.empty(GROUP * BATCH + GROUP, np.uint16)
    found = np.empty(n_cells // LANES + 1, np.uint64)
    covered = np.zeros(n_cells // PANEL, np.bool_)
    sin_tent = math.sin(tent)
    place, size, rank, top, middle_x, middle_y, radius = _sort_leaves(n_leaves, leaves, sin_tent)
    rise = sin_tent / (1.0 - sin_tent)
    sin_blur = np.float32(math.sin(blur))
    cos_reach = math.cos(2.0 * blur)  # a strip's blurred corner lies sqrt(2) blurs off
    sin_reach = math.sin(2.0 * blur)
    cos_tent = np.float32(math.cos(tent))
    any_obstacle = obstacles[0].shape[0] + obstacles[1].shape[0] + obstacles[2].shape[0] + seen.shape[0] > 0
    for q in range(points.shape[0]):
        px = points[q, 0]
        py = points[q, 1]
        pz = points[q, 2]
        if any_obstacle:
            finer[:] = 1.0
            if seen.shape[0] > 0:
                finer[:] = seen[q]
            _shade_obstacles(
                px,
                py,
                pz,
                obstacles[0],
                obstacles[1],
                obstacles[2],
                fine[0],
                fine[1],
                fine[2],
                blur,
                tent,
                finer,
            )
            _dim_sky(sky, finer)
        around = 1.0
        n_groups = top.size
        if n_groups > 0:
            bar = pz - rise * (math.hypot(px - middle_x, py - middle_y) + radius)
            while n_groups > 0 and top[n_groups - 1] < bar:
                n_groups -= 1
            around = _shade_leaves(
                px,
                py,
                pz,
                n_groups * LANES,
                rank[own[q]] if own[q] >= 0 else -1,
                place,
                size,
                sin_blur,
                cos_tent,
                cap,
                tile,
                hit,
                pair,
                sky,
            )
        _shade_branches(
            px,
            py,
            pz,
            branches,
            cos_reach,
            sin_reach,
            np.float32(blur),
            tile,
            found,
            covered,
            sky,
        )
        _take_light(sky, trans)
        light, x, y, z = _weigh(weight, trans)
        amount[q] = around * light
        vector[q, 0] = around * x
        vector[q, 1] = around * y
        vector[q, 2] = around * z
