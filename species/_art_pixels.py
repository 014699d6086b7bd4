"""Pictures from arrays: exact coverage of polygons, noise without a seam, normal maps, small files.

Pixel coordinates: x to the right, y down, pixel (row, column) covers [column, column + 1) x [row, row + 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from treegraph.errors import InputError

__all__ = [
    "balance_alpha",
    "bleed",
    "coverage",
    "encode_normals",
    "encode_png",
    "encode_webp",
    "periodic_noise",
    "smoothstep",
]

BLEED_PX = 12.0  # beyond this distance from the leaf the surroundings have its mean colour

Array = NDArray[np.float64]


def coverage(polygons: Sequence[Array], shape: tuple[int, int]) -> Array:
    """Share of every pixel that polygons cover, exactly.

    Every edge is cut where it crosses the pixel grid; each piece adds the trapezium between itself and the
    right border of the picture. All in one go, without a loop over edges or pixels.

    Parameters
    ----------
    polygons : sequence of (m, 2) float64
        Closed outlines in pixel coordinates, inside the picture, of either orientation.
    shape : (height, width)

    Returns
    -------
    share : (height, width) float64
        0 to 1. Where polygons overlap their shares are added, to 1 at most.
    """
    height, width = shape
    start, end = _edges(polygons)
    x, y = _grid_cuts(start, end)
    middle_x, middle_y = 0.5 * (x[:, 0] + x[:, 1]), 0.5 * (y[:, 0] + y[:, 1])
    column = np.clip(np.floor(middle_x).astype(np.int64), 0, width - 1)
    row = np.clip(np.floor(middle_y).astype(np.int64), 0, height - 1)
    rise, inside = y[:, 1] - y[:, 0], middle_x - column
    cell = row * (width + 1) + column
    size = height * (width + 1)
    total = np.bincount(cell, rise * (1.0 - inside), size) + np.bincount(cell + 1, rise * inside, size)
    return np.clip(np.cumsum(total.reshape(height, width + 1), axis=1)[:, :width], 0.0, 1.0)


def _edges(polygons: Sequence[Array]) -> tuple[Array, Array]:
    """Start and end (n, 2) of all edges, every polygon in the same sense."""
    starts, ends = [], []
    for polygon in polygons:
        following = np.roll(polygon, -1, axis=0)
        twice = np.sum(polygon[:, 0] * following[:, 1] - following[:, 0] * polygon[:, 1])
        first, second = (polygon, following) if twice <= 0.0 else (following, polygon)
        starts.append(first)
        ends.append(second)
    # with y down, an edge that goes down the picture opens the area to its right
    return np.concatenate(starts), np.concatenate(ends)


def _grid_cuts(start: Array, end: Array) -> tuple[Array, Array]:
    """Cut edges at whole x and y: (n, 2) start and end of each piece, for x and for y."""
    edge, at = [np.arange(len(start))] * 2, [np.zeros(len(start)), np.ones(len(start))]
    for axis in (0, 1):
        low = np.minimum(start[:, axis], end[:, axis])
        high = np.maximum(start[:, axis], end[:, axis])
        first = np.floor(low) + 1.0
        n = np.maximum(np.ceil(high) - first, 0.0).astype(np.int64)
        which = np.repeat(np.arange(len(start)), n)
        step = np.arange(len(which)) - np.repeat(np.cumsum(n) - n, n)
        edge.append(which)
        at.append((first[which] + step - start[which, axis]) / (end - start)[which, axis])
    edges, share = np.concatenate(edge), np.clip(np.concatenate(at), 0.0, 1.0)
    order = np.lexsort((share, edges))
    edges, share = edges[order], share[order]
    point = start[edges] + share[:, None] * (end - start)[edges]
    piece = np.flatnonzero(edges[1:] == edges[:-1])
    return (
        np.stack([point[piece, 0], point[piece + 1, 0]], axis=1),
        np.stack([point[piece, 1], point[piece + 1, 1]], axis=1),
    )


def balance_alpha(share: Array) -> Array:
    """Bend coverage so that as many pixels reach 0.5 as the coverage adds up to.

    A renderer that cuts at 0.5 then shows the right leaf area, also of parts thinner than a pixel.
    0 stays 0, 1 stays 1, the order of values stays.
    """
    wanted = int(round(float(share.sum())))
    if not 0 < wanted < share.size:
        return share
    cut = float(np.partition(share.ravel(), -wanted)[-wanted])
    cut = min(max(cut, 0.02), 0.98)
    return np.where(share < cut, 0.5 * share / cut, 0.5 + 0.5 * (share - cut) / (1.0 - cut))


def bleed(values: Array, known: NDArray[np.bool_], reach: float = BLEED_PX) -> Array:
    """Continue values into their surroundings: the nearest known one, further out the mean of all.

    Parameters
    ----------
    values : (h, w, c) float64
    known : (h, w) bool
        Where they count; somewhere at least.
    reach : float
        Pixels over which the nearest value fades into the mean, > 0.
    """
    from scipy.ndimage import distance_transform_edt

    distance, (row, column) = distance_transform_edt(~known, return_indices=True)
    mean = values[known].mean(axis=0)
    far = smoothstep(2.0, 2.0 + reach, distance)[:, :, None]
    return (1.0 - far) * values[row, column] + far * mean


def periodic_noise(rng: np.random.Generator, shape: tuple[int, int], along_v: float, along_u: float) -> Array:
    """Smooth noise that continues over opposite borders: mean 0, standard deviation 1.

    Parameters
    ----------
    rng : numpy.random.Generator
    shape : (height, width)
    along_v, along_u : float
        Its grain down and across the picture, as standard deviations of a Gaussian, in picture sizes.
    """
    height, width = shape
    white = np.fft.rfft2(rng.standard_normal(shape))
    v = np.fft.fftfreq(height, 1.0 / height)[:, None] * along_v
    u = np.fft.rfftfreq(width, 1.0 / width)[None, :] * along_u
    white *= np.exp(-2.0 * np.pi**2 * (u**2 + v**2))
    white[0, 0] = 0.0
    smooth = np.fft.irfft2(white, shape)
    spread = float(smooth.std())
    return smooth / spread if spread > 0.0 else smooth


def smoothstep(low: float, high: float, value: Array) -> Array:
    """0 up to ``low``, 1 from ``high`` on, smooth between."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def encode_normals(slope_x: Array, slope_y: Array) -> NDArray[np.uint8]:
    """Tangent-space normals (h, w, 3) uint8 of a surface with these slopes to the right and up the picture.

    Red to the right, green up, blue out of the surface, as glTF has it; flat is (128, 128, 255).
    """
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.rint((0.5 * normal + 0.5) * 255.0).astype(np.uint8)


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """A picture (h, w, 3 or 4) uint8 as the bytes of a PNG file, without loss."""
    return _encode(picture, "PNG", optimize=True)


def encode_webp(picture: NDArray[np.uint8], quality: int = 85) -> bytes:
    """A picture (h, w, 3 or 4) uint8 as the bytes of a WebP file.

    Parameters
    ----------
    picture : (h, w, 3) or (h, w, 4) uint8
    quality : int, default 85
        0 to 100 for the colours; alpha is kept without loss, and so are the colours under alpha 0.
    """
    if isinstance(quality, bool) or not isinstance(quality, int) or not 0 <= quality <= 100:
        raise InputError(f"quality must be a whole number from 0 to 100, got {quality!r}")
    return _encode(picture, "WEBP", quality=quality, method=4, exact=True, alpha_quality=100)


def _encode(picture: NDArray[np.uint8], kind: str, **options: object) -> bytes:
    from PIL import Image

    array = np.ascontiguousarray(picture)
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] not in (3, 4) or not array.size:
        raise InputError(f"picture must be (h, w, 3 or 4) uint8, got {array.shape} {array.dtype}")
    out = BytesIO()
    Image.fromarray(array).save(out, kind, **options)
    return out.getvalue()
