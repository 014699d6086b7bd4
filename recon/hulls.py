"""Closed hulls around the points of a cluster: alpha shapes, made small.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", 2013, section 3.3.2;
H. Edelsbrunner and E. P. Muecke, "Three-dimensional alpha shapes", 1994; the simplification on
M. Garland and P. Heckbert, "Surface simplification using quadric error metrics", 1997.

Departs from them in: the points are thinned to one per voxel first, so that a Delaunay triangulation
stays cheap; ``alpha_min`` is found exactly among the circumradii of that triangulation; edges
where the alpha shape touches itself are filled, so that what comes out is always a closed manifold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DEFAULT_MAX_POINTS = 500
DEFAULT_MAX_FACES = 120
DEFAULT_MULTIPLE = 5.0  # alpha / alpha_min of the thesis, 3.3.2
MINIMUM_SIZE = 0.02  # metres: no hull is thinner than this
FLAT_SHARE = 1e-3  # of the largest extent: thinner sets of points have no triangulation worth having
JITTER = 1e-6  # of the extent: moves points off common spheres and planes for the triangulation only
VOXEL_STEP = 2.0**0.25  # ladder of voxel sizes tried when thinning
MAX_EDGE_FILLS = 50
THINNER = 0.5  # share of the points used when the faces did not come down to the budget
MAX_ATTEMPTS = 4


@dataclass(frozen=True, eq=False)
class Hull:
    """A closed triangle mesh around points.

    Attributes
    ----------
    vertices : (v, 3) float64
        Metres, in the frame of the points.
    faces : (f, 3) int32
        Counter-clockwise seen from outside; every edge belongs to exactly two faces.
    alpha_min : float
        Smallest alpha, metres, at which the thinned points are held by one closed surface; NaN where
        they have no triangulation (fewer than four, or flat) and the hull is a box.
    alpha : float
        Alpha of the shape before it was simplified, metres; NaN likewise.
    spacing : float
        Edge of the voxels the points were thinned with, metres; 0 where nothing was thinned.
    """

    vertices: np.ndarray
    faces: np.ndarray
    alpha_min: float
    alpha: float
    spacing: float

    @property
    def volume(self) -> float:
        """Enclosed volume, cubic metres, > 0."""
        return mesh_volume(self.vertices, self.faces)

    def __repr__(self) -> str:
        return f"<Hull {len(self.vertices)} vertices, {len(self.faces)} faces, alpha {self.alpha:.3g} m>"


def alpha_hull(
    points: np.ndarray,
    *,
    max_points: int = DEFAULT_MAX_POINTS,
    max_faces: int = DEFAULT_MAX_FACES,
    multiple: float = DEFAULT_MULTIPLE,
    minimum_size: float = MINIMUM_SIZE,
) -> Hull:
    """Closed hull of a cluster's points: the alpha shape at `multiple` times alpha_min, simplified.

    ``alpha_min`` is the smallest value at which the points are represented "by a single surface without
    holes" (thesis [1]_, 3.3.2): the tetrahedra of the Delaunay triangulation whose circumradius is at
    most alpha have every point as a corner, hang together by faces, and shut in no void. The thesis
    takes five times that.

    Parameters
    ----------
    points : (n, 3) float array_like
        Metres, finite, n > 0. Their order is nothing; duplicates are allowed.
    max_points : int, default 500
        Points left after thinning to one per voxel, >= 4.
    max_faces : int, default 120
        Faces of the hull at most, >= 12.
    multiple : float, default 5.0
        alpha / alpha_min, >= 1.
    minimum_size : float, default 0.02
        Points thinner than this share or fewer than four get a box at least this thick, metres, > 0.

    Returns
    -------
    hull : Hull
        Closed, manifold, outward, of positive volume. Thinning and simplification move the surface: by
        about ``spacing`` and a few per cent of the extent.

    Raises
    ------
    ValueError
        If `points` is empty, not (n, 3) or not finite, or a parameter is out of range.

    Notes
    -----
    O(n) for the thinning and about 5 ms for 500 points kept. Voxels start at the lowest corner of the
    points, so the hull moves with them.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", 2013.

    Examples
    --------
    >>> corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    >>> hull = alpha_hull(corners)
    >>> len(hull.faces), round(hull.volume, 6)
    (12, 1.0)
    """
    xyz = _check_points(points)
    _check_parameters(max_points, max_faces, multiple, minimum_size)
    centre = xyz.min(axis=0)
    local = xyz - centre
    for attempt in range(MAX_ATTEMPTS):
        budget = max(4, int(max_points * THINNER**attempt))
        kept, spacing = thin_points(local, budget)
        if _is_flat(kept, minimum_size):
            vertices, faces = _box(kept, minimum_size)
            return Hull(vertices + centre, faces, np.nan, np.nan, spacing)
        vertices, faces, alpha_min, alpha = _alpha_surface(kept, multiple)
        vertices, faces = _simplify(vertices, faces, max_faces)
        if len(faces) <= max_faces and mesh_volume(vertices, faces) > 0.0:
            return Hull(vertices + centre, faces, alpha_min, alpha, spacing)
    vertices, faces, alpha_min, alpha = _alpha_surface(kept, np.inf)
    vertices, faces = _simplify(vertices, faces, max_faces)
    if len(faces) > max_faces or not mesh_volume(vertices, faces) > 0.0:
        vertices, faces = _box(kept, minimum_size)
    return Hull(vertices + centre, faces, alpha_min, alpha, spacing)


def thin_points(points: np.ndarray, max_points: int) -> tuple[np.ndarray, float]:
    """One point per voxel, at most `max_points` of them, with the smallest voxels that do.

    Of the points in a voxel the one farthest from the middle of all is taken: the hull of the points kept
    then holds nearly all of them, where centroids would shrink it by half a voxel.

    Parameters
    ----------
    points : (n, 3) float64
        Metres, n > 0.
    max_points : int
        >= 1.

    Returns
    -------
    kept : (m, 3) float64
        Distinct rows of `points`, whatever their order was.
    spacing : float
        Edge of the voxels, metres; 0 if every distinct point was kept.
    """
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0]))
    ordered = points[order]
    first = np.ones(len(ordered), bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    distinct = ordered[first]
    if len(distinct) <= max_points:
        return distinct, 0.0
    low = distinct.min(axis=0)
    extent = float((distinct.max(axis=0) - low).max())
    offset = (distinct - low) / extent
    smallest = 1.0 / max_points
    lo, hi = -1, int(np.ceil(np.log(2.0 / smallest) / np.log(VOXEL_STEP)))
    while hi - lo > 1:  # the largest voxel holds everything; bisect for the smallest that is enough
        middle = (lo + hi) // 2
        if _count_distinct(_voxel_keys(offset, smallest * VOXEL_STEP**middle)) <= max_points:
            hi = middle
        else:
            lo = middle
    voxel = smallest * VOXEL_STEP**hi
    key = _voxel_keys(offset, voxel)
    from_middle = ((offset - offset.mean(axis=0)) ** 2).sum(axis=1)
    order = np.lexsort((from_middle, key))
    last = np.ones(len(order), bool)
    last[:-1] = np.diff(key[order]) != 0
    return distinct[order[last]], float(voxel * extent)


def mesh_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of a closed mesh, positive if its faces look outward.

    Parameters
    ----------
    vertices : (v, 3) float
    faces : (f, 3) int

    Returns
    -------
    volume : float
        In the cube of the vertices' unit.
    """
    local = vertices - vertices.mean(axis=0)
    a, b, c = (local[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def _check_points(points: np.ndarray) -> np.ndarray:
    xyz = np.ascontiguousarray(points, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or len(xyz) == 0:
        raise ValueError(f"points must have shape (n, 3) with n > 0, got {xyz.shape}")
    bad = np.flatnonzero(~np.isfinite(xyz).all(axis=1))
    if bad.size:
        raise ValueError(
            f"points must be finite, got {xyz[bad[0]]} at row {bad[0]} ({bad.size} of {len(xyz)} such rows); "
            "drop them first"
        )
    return xyz


def _check_parameters(max_points: int, max_faces: int, multiple: float, minimum_size: float) -> None:
    if max_points < 4:
        raise ValueError(f"max_points must be at least 4, got {max_points!r}")
    if max_faces < 12:
        raise ValueError(f"max_faces must be at least 12 (a box), got {max_faces!r}")
    if not multiple >= 1.0:
        raise ValueError(f"multiple must be at least 1, got {multiple!r}")
    if not (np.isfinite(minimum_size) and minimum_size > 0.0):
        raise ValueError(f"minimum_size must be a positive finite number of metres, got {minimum_size!r}")


def _voxel_keys(offset: np.ndarray, size: float) -> np.ndarray:
    """One whole number per voxel of edge `size`, for rows in [0, 1]."""
    cell = (offset * (1.0 / size)).astype(np.int64)
    n = int(1.0 / size) + 2
    return (cell[:, 0] * n + cell[:, 1]) * n + cell[:, 2]


def _count_distinct(key: np.ndarray) -> int:
    return int(1 + np.count_nonzero(np.diff(np.sort(key))))


def _is_flat(points: np.ndarray, minimum_size: float) -> bool:
    if len(points) < 4:
        return True
    extent = _principal_box(points)[2]
    return bool(extent.min() < min(FLAT_SHARE * extent.max(), minimum_size) or extent.max() < minimum_size)


def _principal_box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre (3,), axes as rows (3, 3), right-handed, and extents (3,) along the principal axes."""
    mean = points.mean(axis=0)
    local = points - mean
    axes = np.linalg.eigh(local.T @ local)[1].T
    if np.linalg.det(axes) < 0.0:
        axes[0] = -axes[0]
    along = local @ axes.T
    low, high = along.min(axis=0), along.max(axis=0)
    return mean + 0.5 * (low + high) @ axes, axes, high - low


def _box(points: np.ndarray, minimum_size: float) -> tuple[np.ndarray, np.ndarray]:
    """Box along the principal axes, no side shorter than `minimum_size`."""
    centre, axes, extent = _principal_box(points)
    half = 0.5 * np.maximum(extent, minimum_size)
    corner = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [[q[i] for i in side] for q in quads for side in ((0, 1, 2), (0, 2, 3))]
    return centre + (corner * half) @ axes, np.array(faces, np.int32)


def _alpha_surface(points: np.ndarray, multiple: float) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Closed manifold boundary of the alpha shape of distinct points that are not flat."""
    from scipy.spatial import Delaunay

    from recon import _hull_kernels as kernels

    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    moved = (points - points.mean(axis=0)) / extent + JITTER * _scatter(len(points))
    mesh = Delaunay(moved)
    tetra = np.ascontiguousarray(mesh.simplices, np.int64)
    neighbour = np.ascontiguousarray(mesh.neighbors, np.int64)
    tetra, used = _renumber(tetra)
    moved, points = moved[used], points[used]
    radius = np.empty(len(tetra))
    kernels.circumradii(moved, tetra, radius)
    finite = np.isfinite(radius)
    radius[~finite] = 2.0 * radius[finite].max() if finite.any() else 1.0
    order = np.argsort(radius, kind="stable")
    rank = kernels.first_single_surface(order, radius, tetra, neighbour, len(points))
    alpha_min = float(radius[order[rank]])
    alpha = min(multiple * alpha_min, max(float(radius.max()), alpha_min))
    keep = radius <= max(alpha, alpha_min) * (1.0 + kernels.TIE)
    faces = _closed_boundary(moved, tetra, neighbour, keep)
    faces, source = _split_pinches(faces, len(points))
    alpha = multiple * alpha_min if np.isfinite(multiple) else alpha
    return points[source], faces, alpha_min * extent, alpha * extent


def _scatter(n: int) -> np.ndarray:
    """(n, 3) numbers in [0, 1), the same at every call.

    A regular sequence will not do: it moves the corners of a parallelogram whose numbers are i, i + 1,
    j and j + 1 in step, so that points of a grid stay on common planes.
    """
    return np.random.default_rng(0).random((n, 3))


def _renumber(tetra: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corner numbers without gaps, and the old numbers in their order."""
    used, inverse = np.unique(tetra, return_inverse=True)
    return inverse.reshape(tetra.shape).astype(np.int64), used


def _closed_boundary(
    moved: np.ndarray, tetra: np.ndarray, neighbour: np.ndarray, keep: np.ndarray
) -> np.ndarray:
    """Faces of the boundary, every edge in exactly two of them."""
    from recon import _hull_kernels as kernels

    out = np.empty((4 * len(tetra), 3), np.int64)
    n = len(moved)
    for _ in range(MAX_EDGE_FILLS):
        kernels.keep_largest(keep, neighbour)
        kernels.fill_voids(keep, neighbour)
        faces = out[: kernels.boundary_faces(moved, tetra, neighbour, keep, out)].copy()
        ends = np.stack([faces, np.roll(faces, -1, axis=1)])
        key, count = np.unique(ends.min(axis=0) * n + ends.max(axis=0), return_counts=True)
        bad = key[count > 2]
        if not bad.size:
            return faces
        kernels.fill_edges(tetra, keep, bad, n)
    keep[:] = True
    return out[: kernels.boundary_faces(moved, tetra, neighbour, keep, out)].copy()


def _split_pinches(faces: np.ndarray, n_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Faces with one vertex per fan, and the old vertex of each new one."""
    from recon import _hull_kernels as kernels

    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward = np.argsort(start * n_vertices + end, kind="stable")
    backward = np.argsort(end * n_vertices + start, kind="stable")
    twin = np.empty(len(start), np.int64)
    twin[forward] = backward
    faces = faces.copy()
    source = np.empty(len(start), np.int64)
    n = kernels.split_pinches(faces, n_vertices, twin, source)
    return faces, source[:n]


def _simplify(vertices: np.ndarray, faces: np.ndarray, max_faces: int) -> tuple[np.ndarray, np.ndarray]:
    """At most `max_faces` faces where edge collapses that keep a manifold reach that."""
    from recon import _hull_kernels as kernels

    vertices = np.ascontiguousarray(vertices, np.float64)
    middle = vertices.mean(axis=0)
    moved, faces = vertices - middle, np.ascontiguousarray(faces, np.int64).copy()
    if len(faces) > max_faces:
        faces = faces[: kernels.collapse_edges(moved, faces, max_faces)]
    faces, used = _renumber(faces)
    return moved[used] + middle, faces.astype(np.int32)
