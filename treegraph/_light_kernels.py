"""Compiled loops of the fast light model. Arrays in, arrays out; nothing is checked here.

One query point at a time: the transmittance of every cell of the sky (float32, one per cell, cells in rings
from the zenith to the horizon) starts at what the obstacles leave and is multiplied by each leaf sphere and
each branch. The loops over cells are free of branches, so that the compiler turns them into vector code.
"""

import math

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath
_jit_fused = njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract"})  # a * b + c in one step

BLOCK = 64  # leaf spheres that are projected together
ROW = BLOCK + 16  # of projected caps: behind the block there is one that shades nothing
LEAF_ROWS = 5  # x, y, z, radius, gamma
LANES = 16  # float32 numbers in a cache line: ranges of cells begin and end at multiples of this
SUBCELLS = 4  # directions per cell at which obstacles are tested
DARK = np.float32(1e-30)  # less is 0: arithmetic with denormal numbers is many times slower
HEIGHT_BINS = 256  # table from the height of a direction to its ring


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"reassoc", "contract", "nsz"})
def _dot(weight, trans):
    """Sum of products, in whatever order is fastest."""
    total = 0.0
    for i in range(np.uint64(weight.size)):
        total += weight[i] * trans[i]
    return total


@_jit
def _cell_range(up, cos_width, sin_width, cell_first, cell_last):
    """Cells [first, last) of the rings that a cap of the given width around an axis can touch."""
    side = math.sqrt(max(0.0, 1.0 - up * up)) * sin_width
    high = 1.0 if up >= cos_width else up * cos_width + side
    low = 0.0 if -up >= cos_width else max(0.0, up * cos_width - side)
    if high < 0.0:
        return 0, 0
    return cell_first[int(high * HEIGHT_BINS)], cell_last[int(low * HEIGHT_BINS)]


@_jit_fused
def _shade_two_caps(trans, wx, wy, wz, first, last, cap, j, k):
    """Multiply cells by 1 - clamp(a . w - offset, 0, top) of two caps: half the loops, loads and stores."""
    zero = np.float32(0.0)
    ax = cap[j]
    ay = cap[j + np.uint64(ROW)]
    az = cap[j + np.uint64(2 * ROW)]
    a_offset = cap[j + np.uint64(3 * ROW)]
    a_top = cap[j + np.uint64(4 * ROW)]
    bx = cap[k]
    by = cap[k + np.uint64(ROW)]
    bz = cap[k + np.uint64(2 * ROW)]
    b_offset = cap[k + np.uint64(3 * ROW)]
    b_top = cap[k + np.uint64(4 * ROW)]
    for i in range(np.uint64(first), np.uint64(last)):  # unsigned: no wrap-around, so it is vectorised
        f = ax * wx[i] + ay * wy[i] + az * wz[i] - a_offset
        f = f if f > zero else zero
        f = f if f < a_top else a_top
        g = bx * wx[i] + by * wy[i] + bz * wz[i] - b_offset
        g = g if g > zero else zero
        g = g if g < b_top else b_top
        t = trans[i] - trans[i] * f
        trans[i] = t - t * g


@_jit_fused
def _project_leaves(px, py, pz, block, leaves, sin_blur, cos_tent, cap):
    """What each of BLOCK leaf spheres is in the sky: ``cap`` has rows a (3), offset, top, two heights.

    The blurred coverage of a sphere of angular radius alpha is a ramp in the cosine from the axis, from 0 at
    c_out to 1 at c_in with c_in + c_out = 2 cos(alpha), so that its integral is the sphere's solid angle.
    Where c_in would pass 1 the ramp ends lower. top < 0 says that the point is inside.
    Without branches and with rows at constant distances this is vector code over the spheres.
    """
    zero = np.float32(0.0)
    one = np.float32(1.0)
    two = np.float32(2.0)
    bins = np.float32(HEIGHT_BINS)
    base = np.uint64(block) * np.uint64(LEAF_ROWS * BLOCK)
    for j in range(np.uint64(BLOCK)):
        i = base + j
        x = np.float32(leaves[i] - px)
        y = np.float32(leaves[i + np.uint64(BLOCK)] - py)
        z = np.float32(leaves[i + np.uint64(2 * BLOCK)] - pz)
        r = np.float32(leaves[i + np.uint64(3 * BLOCK)])
        dim = one - np.float32(leaves[i + np.uint64(4 * BLOCK)])
        d2 = x * x + y * y + z * z
        inside = d2 <= r * r
        inv = one / np.sqrt(d2 if d2 > zero else one)
        s = one if inside else r * inv
        c = np.sqrt(one - s * s)
        area = s * s / (one + c)  # 1 - cos, without cancellation
        half = s * sin_blur
        narrow = one - two * area
        narrow = narrow if narrow < cos_tent else cos_tent
        wide = half <= area
        c_out = c - half if wide else narrow
        run = half + half if wide else one - narrow
        top = dim if wide else dim * two * area / run
        slope = top / run
        scaled = inv * slope
        up = z * inv
        side2 = (one - up * up) * (one - c_out * c_out)
        side = np.sqrt(side2 if side2 > zero else zero)
        high = up * c_out + side
        low = up * c_out - side
        high = one if up >= c_out else high  # the zenith is in it
        low = low if low > zero else zero
        low = zero if -up >= c_out else low
        cap[j] = x * scaled
        cap[j + np.uint64(ROW)] = y * scaled
        cap[j + np.uint64(2 * ROW)] = z * scaled
        cap[j + np.uint64(3 * ROW)] = c_out * slope
        cap[j + np.uint64(4 * ROW)] = -one if inside else top
        cap[j + np.uint64(5 * ROW)] = -one if high < zero or inside else high * bins
        cap[j + np.uint64(6 * ROW)] = low * bins


@_jit
def _shade_leaves(
    px,
    py,
    pz,
    n_leaves,
    leaves,
    own,
    sin_blur,
    cos_tent,
    cap,
    above,
    wx,
    wy,
    wz,
    cell_first,
    cell_last,
    trans,
):
    """All leaf spheres on one point; returns the factor of those around it, which dim the whole sky."""
    around = 1.0
    for first_leaf in range(0, n_leaves, BLOCK):
        block = first_leaf // BLOCK
        _project_leaves(px, py, pz, block, leaves, sin_blur, cos_tent, cap)
        n_above = 0
        for j in range(np.uint64(min(BLOCK, n_leaves - first_leaf))):
            above[np.uint64(n_above)] = j  # overwritten by the next one if it does not count
            other = j != np.uint64(own - first_leaf)
            if cap[j + np.uint64(4 * ROW)] < 0.0 and other:
                around *= leaves[np.uint64((block * LEAF_ROWS + 4) * BLOCK) + j]
            n_above += np.int64(cap[j + np.uint64(5 * ROW)] >= 0.0 and other)
        above[np.uint64(n_above)] = BLOCK  # the empty cap behind the block makes the last pair
        for m in range(0, n_above, 2):
            j = np.uint64(above[np.uint64(m)])
            k = np.uint64(above[np.uint64(m + 1)])
            j_high = cap[j + np.uint64(5 * ROW)]
            k_high = cap[k + np.uint64(5 * ROW)]
            j_low = cap[j + np.uint64(6 * ROW)]
            k_low = cap[k + np.uint64(6 * ROW)]
            high = j_high if j_high > k_high else k_high
            low = j_low if j_low < k_low else k_low
            _shade_two_caps(
                trans, wx, wy, wz, cell_first[np.uint64(high)], cell_last[np.uint64(low)], cap, j, k
            )
        for i in range(np.uint64(trans.size)):
            trans[i] = trans[i] if trans[i] > DARK else np.float32(0.0)
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
def _cover_cone(cover, wx, wy, wz, first, last, x, y, z, ex, ey, ez, r, dr, join0, join1, blur):
    """Add the blurred coverage of one piece of a branch. All lengths in one unit, float32.

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
    for i in range(np.uint64(first), np.uint64(last)):
        ux = wy[i] * z - wz[i] * y
        uy = wz[i] * x - wx[i] * z
        uz = wx[i] * y - wy[i] * x
        vx = wy[i] * ez - wz[i] * ey
        vy = wz[i] * ex - wx[i] * ez
        vz = wx[i] * ey - wy[i] * ex
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
        t = nx * wx[i] + ny * wy[i] + nz * wz[i]
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
        cover[i] += f * along if t > zero else zero


@_jit_fused
def _apply_cover(trans, cover, first, last):
    """Multiply cells by 1 - the coverage of a branch, and clear it."""
    zero = np.float32(0.0)
    one = np.float32(1.0)
    for i in range(np.uint64(first), np.uint64(last)):
        t = one - cover[i]
        t = trans[i] * (t if t > zero else zero)
        trans[i] = t if t > DARK else zero
        cover[i] = zero


@_jit
def _shade_branches(
    px, py, pz, branches, cos_reach, sin_reach, blur, wx, wy, wz, cell_first, cell_last, cover, trans
):
    """All branches on one point; pieces that contain it do not shade it."""
    low = wx.size  # cells that the present branch may cover
    high = 0
    for k in range(branches.shape[0]):
        if branches[k, 11] == 0.0 and low < high:
            _apply_cover(trans, cover, low, high)
            low = wx.size
            high = 0
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
        first = 0
        last = wx.size
        bound = branches[k, 10]
        if bound < d:
            s = bound / d
            c = math.sqrt(1.0 - s * s)
            cos_width = c * cos_reach - s * sin_reach
            first, last = _cell_range(mz / d, cos_width, s * cos_reach + c * sin_reach, cell_first, cell_last)
            if first >= last:
                continue
        elif _nearest_gap(x, y, z, ex, ey, ez, r, dr) <= 0.0:
            continue
        unit = 1.0 / max(d, bound)
        _cover_cone(
            cover,
            wx,
            wy,
            wz,
            first,
            last,
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
        low = min(low, first)
        high = max(high, last)
    if low < high:
        _apply_cover(trans, cover, low, high)


@_jit
def _shade_plane(trans, wx, wy, wz, nx, ny, nz, gamma):
    """Directions against the outward normal run into a half-space."""
    one = np.float32(1.0)
    for i in range(np.uint64(wx.size)):
        trans[i] *= gamma if nx * wx[i] + ny * wy[i] + nz * wz[i] < np.float32(0.0) else one


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
def _shade_obstacles(px, py, pz, planes, balls, boxes, sx, sy, sz, trans):
    """Hard shadows at the finer directions."""
    for k in range(planes.shape[0]):
        nx = planes[k, 3]
        ny = planes[k, 4]
        nz = planes[k, 5]
        gamma = np.float32(planes[k, 6])
        if (px - planes[k, 0]) * nx + (py - planes[k, 1]) * ny + (pz - planes[k, 2]) * nz <= 0.0:
            trans *= gamma
        else:
            _shade_plane(trans, sx, sy, sz, np.float32(nx), np.float32(ny), np.float32(nz), gamma)
    for k in range(balls.shape[0]):
        x = balls[k, 0] - px
        y = balls[k, 1] - py
        z = balls[k, 2] - pz
        r = balls[k, 3]
        gamma = np.float32(balls[k, 4])
        d2 = x * x + y * y + z * z
        if d2 <= r * r:
            trans *= gamma
            continue
        edge = np.float32(math.sqrt(d2 - r * r))  # a . w >= d cos(alpha), not divided by d
        fx = np.float32(x)
        fy = np.float32(y)
        fz = np.float32(z)
        for i in range(np.uint64(sx.size)):
            trans[i] *= gamma if fx * sx[i] + fy * sy[i] + fz * sz[i] >= edge else np.float32(1.0)
    for k in range(boxes.shape[0]):
        _shade_box(trans, sx, sy, sz, boxes[k], px, py, pz)


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
    ``weight`` (4, N) float64: share of the light of each cell, and its three components times the direction.
    """
    wx, wy, wz, cell_first, cell_last = grid  # once: each time counts references, atomically
    n_cells = wx.size
    finer = np.empty(SUBCELLS * n_cells, np.float32)
    cover = np.zeros(n_cells, np.float32)
    above = np.empty(BLOCK + 1, np.int32)
    cap = np.zeros(7 * ROW, np.float32)
    cap[6 * ROW + BLOCK] = HEIGHT_BINS
    sin_blur = np.float32(math.sin(blur))
    cos_reach = math.cos(2.0 * blur)  # a strip's blurred corner lies sqrt(2) blurs off
    sin_reach = math.sin(2.0 * blur)
    cos_tent = np.float32(math.cos(tent))
    any_obstacle = obstacles[0].shape[0] + obstacles[1].shape[0] + obstacles[2].shape[0] + seen.shape[0] > 0
    for q in range(points.shape[0]):
        px = points[q, 0]
        py = points[q, 1]
        pz = points[q, 2]
        trans[:] = 1.0
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
                finer,
            )
            for i in range(n_cells):
                total = finer[i] + finer[n_cells + i] + finer[2 * n_cells + i] + finer[3 * n_cells + i]
                trans[i] = total * np.float32(0.25)
        around = _shade_leaves(
            px,
            py,
            pz,
            n_leaves,
            leaves,
            own[q],
            sin_blur,
            cos_tent,
            cap,
            above,
            wx,
            wy,
            wz,
            cell_first,
            cell_last,
            trans,
        )
        _shade_branches(
            px,
            py,
            pz,
            branches,
            cos_reach,
            sin_reach,
            np.float32(blur),
            wx,
            wy,
            wz,
            cell_first,
            cell_last,
            cover,
            trans,
        )
        for row in range(4):
            total = around * _dot(weight[row], trans)
            if row == 0:
                amount[q] = total
            else:
                vector[q, row - 1] = total
