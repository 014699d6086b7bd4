"""Compiled loops of the software renderer. Arrays in, arrays filled; nothing is checked here.

A *view* is a (3, 3) matrix of axes (rows: right, up, forward), an eye, a focal length in pixels and a flag
for parallel projection. A *key* is what a depth buffer holds, larger nearer and linear on the screen:
1 / distance in perspective, -distance in parallel projection. Empty pixels hold ``NOTHING``.
"""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath

NOTHING = -3.0e38
NEAREST = 1e-6  # metres: what is closer to the eye is not drawn
SIDE_FADE = 0.14  # part of the image's width over which the ground fades out at either side
PERSPECTIVE = 0
PARALLEL = 1


@_jit
def project(point, axes, eye, focal, mode, width, height, screen):
    """Fill ``screen`` (n, 3) with x, y in pixels and the key; the key is NOTHING behind the eye."""
    for i in range(point.shape[0]):
        a = point[i, 0] - eye[0]
        b = point[i, 1] - eye[1]
        c = point[i, 2] - eye[2]
        x = axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c
        y = axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c
        z = axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c
        key = -z
        scale = focal
        if mode == PERSPECTIVE:
            if z <= NEAREST:
                screen[i, 2] = NOTHING
                continue
            key = 1.0 / z
            scale = focal * key
        screen[i, 0] = 0.5 * width + scale * x
        screen[i, 1] = 0.5 * height - scale * y
        screen[i, 2] = key


@_jit
def edge(ax, ay, bx, by, px, py):
    """Twice the area of the triangle a, b, p; positive if clockwise on a screen whose y goes down."""
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@_jit
def draw_triangles(screen, face, buffer, owner):
    """Draw the front sides of triangles: the nearest key and the face it belongs to, for each pixel.

    Keys in ``buffer`` from an earlier call stay where they are nearer. Pass an ``owner`` of no size to
    fill the keys alone.
    """
    height, width = buffer.shape
    keep_owner = owner.size > 0
    for f in range(face.shape[0]):
        i, j, k = face[f, 0], face[f, 1], face[f, 2]
        if screen[i, 2] == NOTHING or screen[j, 2] == NOTHING or screen[k, 2] == NOTHING:
            continue
        ax, ay, bx, by = screen[i, 0], screen[i, 1], screen[j, 0], screen[j, 1]
        cx, cy = screen[k, 0], screen[k, 1]
        area = -edge(ax, ay, bx, by, cx, cy)  # counter-clockwise from outside: negative with y down
        if area <= 0.0:
            continue
        x0 = max(int(np.ceil(min(ax, bx, cx) - 0.5)), 0)
        x1 = min(int(np.floor(max(ax, bx, cx) - 0.5)), width - 1)
        y0 = max(int(np.ceil(min(ay, by, cy) - 0.5)), 0)
        y1 = min(int(np.floor(max(ay, by, cy) - 0.5)), height - 1)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = -edge(bx, by, cx, cy, x + 0.5, y + 0.5)
                v = -edge(cx, cy, ax, ay, x + 0.5, y + 0.5)
                w = -edge(ax, ay, bx, by, x + 0.5, y + 0.5)
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                key = (u * screen[i, 2] + v * screen[j, 2] + w * screen[k, 2]) / area
                if key > buffer[y, x]:
                    buffer[y, x] = key
                    if keep_owner:
                        owner[y, x] = f


@_jit
def texel_rows(image, u, v, clamp):
    """Where (u, v) is in an image whose first row is at v = 1: two columns, two rows, and how far between."""
    height, width = image.shape[0], image.shape[1]
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    i, j = int(np.floor(x)), int(np.floor(y))
    s, t = x - i, y - j
    if clamp:
        return (
            min(max(i, 0), width - 1), min(max(i + 1, 0), width - 1),
            min(max(j, 0), height - 1), min(max(j + 1, 0), height - 1), s, t,
        )  # fmt: skip
    return i % width, (i + 1) % width, j % height, (j + 1) % height, s, t


@_jit
def texel(image, at, c):
    """One channel of an image (uint8), between its pixels."""
    i, k, j, m, s, t = at
    upper = (1.0 - s) * image[j, i, c] + s * image[j, k, c]
    lower = (1.0 - s) * image[m, i, c] + s * image[m, k, c]
    return (1.0 - t) * upper + t * lower


@_jit
def draw_textured(screen, face, uv, image, mode, clamp, both, buffer, owner):
    """Draw triangles where their image's alpha is at least one half; backs too if ``both``.

    Alpha is read from the whole image, however small the triangle: a sample hits or misses the leaf as it
    would its outline, so that a crown is as dense from afar as from near.
    """
    height, width = buffer.shape
    keep_owner = owner.size > 0
    for f in range(face.shape[0]):
        i, j, k = face[f, 0], face[f, 1], face[f, 2]
        if screen[i, 2] == NOTHING or screen[j, 2] == NOTHING or screen[k, 2] == NOTHING:
            continue
        ax, ay, bx, by = screen[i, 0], screen[i, 1], screen[j, 0], screen[j, 1]
        cx, cy = screen[k, 0], screen[k, 1]
        x0 = max(int(np.ceil(min(ax, bx, cx) - 0.5)), 0)
        x1 = min(int(np.floor(max(ax, bx, cx) - 0.5)), width - 1)
        y0 = max(int(np.ceil(min(ay, by, cy) - 0.5)), 0)
        y1 = min(int(np.floor(max(ay, by, cy) - 0.5)), height - 1)
        if x1 < x0 or y1 < y0:
            continue
        area = -edge(ax, ay, bx, by, cx, cy)
        if area == 0.0 or (area < 0.0 and not both):
            continue
        scale = 1.0 / area
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = -scale * edge(bx, by, cx, cy, x + 0.5, y + 0.5)
                v = -scale * edge(cx, cy, ax, ay, x + 0.5, y + 0.5)
                w = -scale * edge(ax, ay, bx, by, x + 0.5, y + 0.5)
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                key = u * screen[i, 2] + v * screen[j, 2] + w * screen[k, 2]
                if key <= buffer[y, x]:
                    continue
                if mode == PERSPECTIVE:
                    u, v, w = u * screen[i, 2] / key, v * screen[j, 2] / key, w * screen[k, 2] / key
                s = u * uv[i, 0] + v * uv[j, 0] + w * uv[k, 0]
                t = u * uv[i, 1] + v * uv[j, 1] + w * uv[k, 1]
                if texel(image, texel_rows(image, s, t, clamp), 3) < 127.5:
                    continue
                buffer[y, x] = key
                if keep_owner:
                    owner[y, x] = f


@_jit
def draw_points(screen, size, perspective, buffer, owner):
    """Draw points as discs of radius ``size`` pixels, in perspective ``size * key``; at least half of one."""
    height, width = buffer.shape
    keep_owner = owner.size > 0
    for i in range(screen.shape[0]):
        key = screen[i, 2]
        if key == NOTHING:
            continue
        r = max(size * key if perspective else size, 0.5)
        x0 = max(int(np.ceil(screen[i, 0] - r - 0.5)), 0)
        x1 = min(int(np.floor(screen[i, 0] + r - 0.5)), width - 1)
        y0 = max(int(np.ceil(screen[i, 1] - r - 0.5)), 0)
        y1 = min(int(np.floor(screen[i, 1] + r - 0.5)), height - 1)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                dx = x + 0.5 - screen[i, 0]
                dy = y + 0.5 - screen[i, 1]
                if dx * dx + dy * dy <= max(r * r, 0.5) and key > buffer[y, x]:
                    buffer[y, x] = key
                    if keep_owner:
                        owner[y, x] = i


@_jit
def weights_at(screen, i, j, k, mode, x, y):
    """Shares of a triangle's corners at a place of the picture; they add up to 1."""
    u = edge(screen[j, 0], screen[j, 1], screen[k, 0], screen[k, 1], x, y)
    v = edge(screen[k, 0], screen[k, 1], screen[i, 0], screen[i, 1], x, y)
    w = edge(screen[i, 0], screen[i, 1], screen[j, 0], screen[j, 1], x, y)
    if mode == PERSPECTIVE:
        u, v, w = u * screen[i, 2], v * screen[j, 2], w * screen[k, 2]
    total = u + v + w
    return u / total, v / total, w / total


@_jit
def resolve_triangles(screen, face, owner, mode, first, second, out_first, out_second):
    """Interpolate two sets of vertex colours (uint8) at the pixels that have an owner."""
    height, width = owner.shape
    for y in range(height):
        for x in range(width):
            f = owner[y, x]
            if f < 0:
                continue
            i, j, k = face[f, 0], face[f, 1], face[f, 2]
            u, v, w = weights_at(screen, i, j, k, mode, x + 0.5, y + 0.5)
            for c in range(3):
                out_first[y, x, c] = int(u * first[i, c] + v * first[j, c] + w * first[k, c] + 0.5)
                out_second[y, x, c] = int(u * second[i, c] + v * second[j, c] + w * second[k, c] + 0.5)


@_jit
def resolve_textured(screen, face, owner, mode, first, second, uv, image, clamp, out_first, out_second):
    """As :func:`resolve_triangles`, times the image's colours: 255 is 1."""
    height, width = owner.shape
    for y in range(height):
        for x in range(width):
            f = owner[y, x]
            if f < 0:
                continue
            i, j, k = face[f, 0], face[f, 1], face[f, 2]
            u, v, w = weights_at(screen, i, j, k, mode, x + 0.5, y + 0.5)
            s = u * uv[i, 0] + v * uv[j, 0] + w * uv[k, 0]
            t = u * uv[i, 1] + v * uv[j, 1] + w * uv[k, 1]
            at = texel_rows(image, s, t, clamp)
            for c in range(3):
                shade = texel(image, at, c) / 255.0
                out_first[y, x, c] = int(shade * (u * first[i, c] + v * first[j, c] + w * first[k, c]) + 0.5)
                out_second[y, x, c] = int(
                    shade * (u * second[i, c] + v * second[j, c] + w * second[k, c]) + 0.5
                )


@_jit
def resolve_points(owner, first, second, out_first, out_second):
    """Copy two sets of point colours (uint8) to the pixels that have an owner."""
    height, width = owner.shape
    for y in range(height):
        for x in range(width):
            i = owner[y, x]
            if i >= 0:
                for c in range(3):
                    out_first[y, x, c] = first[i, c]
                    out_second[y, x, c] = second[i, c]


@_jit
def light_seen(shadow, axes, centre, focal, x, y, z, bias):
    """Part of a parallel light, 0 to 1, that reaches a point: its shadow map read at four texels."""
    size = shadow.shape[0]
    a, b, c = x - centre[0], y - centre[1], z - centre[2]
    u = 0.5 * size + focal * (axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c) - 0.5
    v = 0.5 * size - focal * (axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c) - 0.5
    key = bias - (axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c)
    i, j = int(np.floor(u)), int(np.floor(v))
    if i < 0 or j < 0 or i >= size - 1 or j >= size - 1:
        return 1.0
    s, t = u - i, v - j
    seen = 0.0
    if key >= shadow[j, i]:
        seen += (1.0 - s) * (1.0 - t)
    if key >= shadow[j, i + 1]:
        seen += s * (1.0 - t)
    if key >= shadow[j + 1, i]:
        seen += (1.0 - s) * t
    if key >= shadow[j + 1, i + 1]:
        seen += s * t
    return seen


@_jit
def gather_sky(point, normal, shadows, axes, direction, weight, centre, focal, lift, bias, out):
    """Sky light at points: sum of weight * cosine over the sky directions that are not hidden.

    A normal of length 0 stands for a surface that faces every direction alike (cosine 1/2).
    """
    for i in range(point.shape[0]):
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        facing = nx * nx + ny * ny + nz * nz > 0.25
        x, y, z = point[i, 0] + lift * nx, point[i, 1] + lift * ny, point[i, 2] + lift * nz
        total = 0.0
        for m in range(direction.shape[0]):
            cosine = 0.5
            if facing:
                cosine = nx * direction[m, 0] + ny * direction[m, 1] + nz * direction[m, 2]
            if cosine > 0.0:
                total += weight[m] * cosine * light_seen(shadows[m], axes[m], centre, focal, x, y, z, bias)
        out[i] = total


@_jit
def gather_sky_through(
    point, normal, through, shadows, axes, direction, weight, centre, focal, lift, bias, out
):
    """As :func:`gather_sky`, for thin surfaces: the part ``through`` of the far side's light comes too."""
    for i in range(point.shape[0]):
        nx, ny, nz = normal[i, 0], normal[i, 1], normal[i, 2]
        total = 0.0
        for m in range(direction.shape[0]):
            cosine = nx * direction[m, 0] + ny * direction[m, 1] + nz * direction[m, 2]
            side, share = (lift, cosine) if cosine > 0.0 else (-lift, -through * cosine)
            x, y, z = point[i, 0] + side * nx, point[i, 1] + side * ny, point[i, 2] + side * nz
            total += weight[m] * share * light_seen(shadows[m], axes[m], centre, focal, x, y, z, bias)
        out[i] = total


@_jit
def blurred_sun(shadow, axes, centre, focal, x, y, z, bias, reach):
    """The sun seen by a point, averaged over 3 x 3 neighbouring rays: soft edges."""
    total = 0.0
    for i in range(-1, 2):
        for j in range(-1, 2):
            a, b = i * reach, j * reach
            total += light_seen(
                shadow, axes, centre, focal,
                x + a * axes[0, 0] + b * axes[1, 0],
                y + a * axes[0, 1] + b * axes[1, 1],
                z + a * axes[0, 2] + b * axes[1, 2],
                bias,
            )  # fmt: skip
    return total / 9.0


@_jit
def shade_layer(
    key, ambient, direct, gain, alpha, axes, eye, focal, shadow, sun_axes, centre, sun_focal, bias, row, out
):
    """Put one layer over ``out`` (rows of linear colour and key): ambient light, and the sun where seen.

    Colours are square roots in uint8, 255 for `gain`. ``out[..., 3]`` is the nearest key so far.
    """
    height, width = key.shape
    reach = 0.75 / sun_focal
    for y in range(out.shape[0]):
        for x in range(width):
            k = key[row + y, x]
            if k == NOTHING or k <= out[y, x, 3]:
                continue
            z = 1.0 / k
            a = (x + 0.5 - 0.5 * width) * z / focal
            b = (0.5 * height - row - y - 0.5) * z / focal
            px = eye[0] + a * axes[0, 0] + b * axes[1, 0] + z * axes[2, 0]
            py = eye[1] + a * axes[0, 1] + b * axes[1, 1] + z * axes[2, 1]
            pz = eye[2] + a * axes[0, 2] + b * axes[1, 2] + z * axes[2, 2]
            sun = blurred_sun(shadow, sun_axes, centre, sun_focal, px, py, pz, bias, reach)
            for c in range(3):
                first = ambient[row + y, x, c] / 255.0
                second = direct[row + y, x, c] / 255.0
                light = gain * (first * first + sun * second * second)
                out[y, x, c] += alpha * (light - out[y, x, c])
            out[y, x, 3] = k


@_jit
def smooth(t):
    """A smooth step from 0 to 1."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@_jit
def grid_at(grid, u, v):
    """A square grid read between its points; ``u`` and ``v`` run from 0 to 1 over it."""
    n = grid.shape[0]
    x = min(max(u * n - 0.5, 0.0), n - 1.001)
    y = min(max(v * n - 0.5, 0.0), n - 1.001)
    i, j = int(x), int(y)
    x, y = x - i, y - j
    low = grid[j, i] * (1.0 - x) + grid[j, i + 1] * x
    high = grid[j + 1, i] * (1.0 - x) + grid[j + 1, i + 1] * x
    return low * (1.0 - y) + high * y


@_jit
def fill_background(height, row, sky, out):
    """Fill rows of ``out`` with the backdrop: ``sky[0]`` at the image's bottom, ``sky[1]`` at its top."""
    for y in range(out.shape[0]):
        t = (row + y + 0.5) / height
        for x in range(out.shape[1]):
            for c in range(3):
                out[y, x, c] = t * sky[0, c] + (1.0 - t) * sky[1, c]
            out[y, x, 3] = NOTHING


@_jit
def draw_ground(
    axes, eye, focal, height, row, ground_z, middle, disc, rim, floor, shade, sun_share,
    shadow, sun_axes, sun_centre, sun_focal, bias, out,
):  # fmt: skip
    """Put the ground disc into rows of ``out``: ``floor`` times the light that reaches it.

    ``shade``, the sky's light, covers the square of half width ``rim`` around ``middle``; the sun has
    ``sun_share`` of all light. Between the radii ``disc`` and ``rim``, and towards the image's sides, the
    ground fades into what is behind.
    """
    width = out.shape[1]
    reach = 1.25 / sun_focal
    for y in range(out.shape[0]):
        b = (0.5 * height - row - y - 0.5) / focal
        for x in range(width):
            a = (x + 0.5 - 0.5 * width) / focal
            dz = a * axes[0, 2] + b * axes[1, 2] + axes[2, 2]
            if dz >= 0.0 or eye[2] <= ground_z:
                continue
            z = (ground_z - eye[2]) / dz
            px = eye[0] + z * (a * axes[0, 0] + b * axes[1, 0] + axes[2, 0])
            py = eye[1] + z * (a * axes[0, 1] + b * axes[1, 1] + axes[2, 1])
            gx, gy = px - middle[0], py - middle[1]
            fade = (rim - np.sqrt(gx * gx + gy * gy)) / (rim - disc)
            if fade <= 0.0:
                continue
            to_side = min(x + 0.5, width - x - 0.5)
            fade = smooth(fade) * smooth(to_side / (SIDE_FADE * width))
            sun = blurred_sun(shadow, sun_axes, sun_centre, sun_focal, px, py, ground_z, bias, reach)
            sky = grid_at(shade, 0.5 * (gx / rim + 1.0), 0.5 * (gy / rim + 1.0))
            lit = sun_share * sun + (1.0 - sun_share) * sky
            for c in range(3):
                out[y, x, c] += fade * (lit * floor[c] - out[y, x, c])
            out[y, x, 3] = 1.0 / z


@_jit
def average_blocks(fine, factor, out):
    """Average blocks of factor x factor samples of linear colour into pixels."""
    scale = 1.0 / (factor * factor)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            for c in range(3):
                total = 0.0
                for j in range(factor):
                    for i in range(factor):
                        total += fine[y * factor + j, x * factor + i, c]
                out[y, x, c] = total * scale
