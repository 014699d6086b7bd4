"""How well a model of cylinders holds a scan: distances both ways, invented wood, DBH.

Definitions (metres unless the name says otherwise), the same for every program that is compared:

- The surface of a model is one open tube of 24 flat sides per segment, from the start radius to the end one.
- ``median``, ``p95``, ``within_2cm`` ...: distance of the scan's points to that surface.
- ``back_p95``, ``back_over_10cm``: distance of points spread evenly over the surface to the nearest
  scan point; what is more than 10 cm from any point is invented wood.
- ``unsupported``: share of the skeleton's length whose axis is farther than radius + 10 cm from any point.
- ``dbh_points``: circle through the largest clump of the points between 1.2 and 1.4 m, with how much
  of its arc they cover and how far they lie off it; ``dbh_model``: the model's diameter at 1.3 m there.

    python -m benchmarks.fidelity_measure SCAN CYLINDERS.csv
"""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.segments import Segments, read_cylinders, sample

SIDES = 24
THINNEST_TUBE = 1e-4  # metres of radius
SHORTEST_TUBE = 1e-9
MAX_POINTS = 400_000  # of larger scans that many points are judged
N_SURFACE_POINTS = 200_000
POINTS_PER_CHUNK = 200_000
SUPPORT = 0.10  # metres beyond the radius
SUPPORT_STEP = 0.02  # metres along the axis
SLICE = (1.2, 1.4)  # metres above the foot
BREAST_HEIGHT = 1.3
CLUMP_GAP = 0.06  # metres between points of one clump
MIN_SLICE_POINTS = 10
MAX_SLICE_POINTS = 5000
RING_SIGMA = 0.008  # metres: a point this far off counts 0.6 for a circle
EMPTY_SHARE = 0.7  # of the radius: no point of a trunk lies farther inside
N_TRIPLES = 500
RADIUS_RANGE = (0.01, 2.0)
ARC_BINS = 36
NEAR_TRUNK = 0.5  # metres between the circle's middle and the model's axis


@dataclass(frozen=True)
class Circle:
    """A circle through a slice: middle, radius, median distance of the points, share of arc covered."""

    x: float
    y: float
    radius: float
    residual: float
    arc: float


def measure(
    points: np.ndarray, model: Segments, *, seed: int = 0, foot: float | None = None
) -> dict[str, Any]:
    """Figures of one model for one scan; see the head of this file.

    Parameters
    ----------
    points : (n, 3) float64
        The scan, metres, same frame as the model.
    model : Segments
        Segments with a NaN in an end point are left out.
    seed : int, default 0
        Of the points drawn on the surface and of the circle's candidates.
    foot : float, optional
        Height of the trunk's foot; default the lowest point.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    tree = cKDTree(points)
    vertices, faces = tubes(model)
    judged = (
        points if len(points) <= MAX_POINTS else points[rng.choice(len(points), MAX_POINTS, replace=False)]
    )
    gap = surface_distance(judged, vertices, faces)
    out: dict[str, Any] = {"points": len(points), "segments": len(model)}
    out["median"], out["p95"] = float(np.median(gap)), float(np.percentile(gap, 95))
    for cm in (2, 5, 10):
        out[f"within_{cm}cm"] = float((gap <= cm / 100.0).mean())
    back = tree.query(spread_on_surface(vertices, faces, N_SURFACE_POINTS, rng))[0]
    out["back_p95"] = float(np.percentile(back, 95))
    out["back_over_10cm"] = float((back > 0.10).mean())
    out["unsupported"] = unsupported_share(model, tree)
    out["length"], out["volume"] = float(np.nansum(model.length)), float(np.nansum(model.volume))
    out["tips"] = int((np.bincount(model.parent[model.parent >= 0], minlength=len(model)) == 0).sum())
    foot = float(points[:, 2].min()) if foot is None else foot
    circle = slice_circle(points, foot, rng)
    middle = None if circle is None else np.array([circle.x, circle.y])
    out["dbh_points"] = None if circle is None else 2.0 * circle.radius
    out["dbh_arc"] = None if circle is None else circle.arc
    out["dbh_residual"] = None if circle is None else circle.residual
    out["dbh_model"] = model_diameter(model, foot + BREAST_HEIGHT, middle)
    return out


def tubes(model: Segments) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of one open tube per segment."""
    real = (model.length > SHORTEST_TUBE) & np.isfinite(model.start + model.end).all(axis=1)
    start, end = model.start[real], model.end[real]
    axis = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    steep = np.abs(axis[:, 2:]) >= 0.9
    side = np.cross(np.where(steep, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]), axis)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(axis, side)
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    radii = [np.nan_to_num(r[real], nan=0.0) for r in (model.start_radius, model.end_radius)]
    ends = [
        at[:, None] + np.maximum(r, THINNEST_TUBE)[:, None, None] * ring
        for at, r in zip((start, end), radii, strict=True)
    ]
    low = np.arange(SIDES)
    high = (low + 1) % SIDES
    one = np.concatenate(
        [np.stack([low, high, low + SIDES], 1), np.stack([high, high + SIDES, low + SIDES], 1)]
    )
    faces = one[None] + 2 * SIDES * np.arange(len(start))[:, None, None]
    return np.concatenate(ends, axis=1).reshape(-1, 3), faces.reshape(-1, 3)


def surface_distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n,) exact distance of each point to the nearest triangle, metres."""
    import open3d

    middle = vertices.mean(axis=0)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor((vertices - middle).astype(np.float32)),
        open3d.core.Tensor(faces.astype(np.uint32)),
    )
    parts = [
        scene.compute_distance(open3d.core.Tensor((chunk - middle).astype(np.float32))).numpy()
        for chunk in np.array_split(points, max(1, -(-len(points) // POINTS_PER_CHUNK)))
    ]
    return np.concatenate(parts)


def spread_on_surface(
    vertices: np.ndarray, faces: np.ndarray, n: int, rng: np.random.Generator
) -> np.ndarray:
    """(n, 3) points spread evenly by area over triangles."""
    corner = vertices[faces]
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    total = np.cumsum(np.linalg.norm(np.cross(u, v), axis=1))
    row = np.minimum(np.searchsorted(total, rng.random(n) * total[-1], side="right"), len(faces) - 1)
    a, b = rng.random((2, n))
    over = a + b > 1.0
    a, b = np.where(over, 1.0 - a, a), np.where(over, 1.0 - b, b)
    return corner[row, 0] + a[:, None] * u[row] + b[:, None] * v[row]


def unsupported_share(model: Segments, tree: Any) -> float:
    """Share of the length whose axis is farther than its radius + 10 cm from any point."""
    pieces = sample(model, SUPPORT_STEP)
    real = np.isfinite(pieces.xyz).all(axis=1)
    gap = tree.query(pieces.xyz[real])[0]
    alone = gap > np.nan_to_num(pieces.radius[real], nan=0.0) + SUPPORT
    return float(pieces.length[real][alone].sum() / pieces.length[real].sum())


def slice_circle(points: np.ndarray, foot: float, rng: np.random.Generator) -> Circle | None:
    """Circle through the largest clump of the slice at breast height, None without one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    at = points[(points[:, 2] > foot + SLICE[0]) & (points[:, 2] < foot + SLICE[1]), :2]
    if len(at) < MIN_SLICE_POINTS:
        return None
    pair = cKDTree(at).query_pairs(CLUMP_GAP, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), (len(at), len(at)))
    label = connected_components(graph, directed=False)[1]
    clump = at[label == np.bincount(label).argmax()]
    if len(clump) > MAX_SLICE_POINTS:
        clump = clump[rng.choice(len(clump), MAX_SLICE_POINTS, replace=False)]
    return fit_circle(clump, rng) if len(clump) >= MIN_SLICE_POINTS else None


def fit_circle(at: np.ndarray, rng: np.random.Generator) -> Circle | None:
    """Circle with the most points on it and the fewest inside, among 500 triples; then least squares.

    None if no triple gives a radius between 1 cm and 2 m.
    """
    from scipy.optimize import least_squares

    middle = at.mean(axis=0)
    local = at - middle
    triple = np.array([rng.choice(len(at), 3, replace=False) for _ in range(N_TRIPLES)])
    best, best_score = None, 0.0
    for candidate in _circles_through(local[triple]):
        gap = np.hypot(local[:, 0] - candidate[0], local[:, 1] - candidate[1])
        on = np.exp(-0.5 * ((gap - candidate[2]) / RING_SIGMA) ** 2).sum()
        score = on - (gap < EMPTY_SHARE * candidate[2]).sum()
        if score > best_score:
            best, best_score = candidate, score
    if best is None:
        return None

    def residual(q: np.ndarray) -> np.ndarray:
        return np.hypot(local[:, 0] - q[0], local[:, 1] - q[1]) - q[2]

    free = np.inf
    bounds = ([-free, -free, 0.3 * best[2]], [free, free, 3.0 * best[2]])
    fitted = least_squares(residual, best, loss="soft_l1", f_scale=0.01, bounds=bounds).x
    turn = np.arctan2(local[:, 1] - fitted[1], local[:, 0] - fitted[0])
    covered = np.unique(((turn + np.pi) / (2.0 * np.pi) * ARC_BINS).astype(int) % ARC_BINS)
    off = float(np.median(np.abs(residual(fitted))))
    x, y = fitted[:2] + middle
    return Circle(float(x), float(y), float(fitted[2]), off, len(covered) / ARC_BINS)


def _circles_through(triple: np.ndarray) -> np.ndarray:
    """(k, 3) x, y, radius of the circles through triples (m, 3, 2); those of odd size are left out."""
    a = 2.0 * (triple[:, 1:] - triple[:, :1])
    square = (triple**2).sum(axis=2)
    b = square[:, 1:] - square[:, :1]
    det = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0]
    good = np.abs(det) > 1e-9
    a, b, det, first = a[good], b[good], det[good], triple[good, 0]
    x = (b[:, 0] * a[:, 1, 1] - b[:, 1] * a[:, 0, 1]) / det
    y = (a[:, 0, 0] * b[:, 1] - a[:, 1, 0] * b[:, 0]) / det
    radius = np.hypot(first[:, 0] - x, first[:, 1] - y)
    sized = (radius > RADIUS_RANGE[0]) & (radius < RADIUS_RANGE[1])
    return np.column_stack([x, y, radius])[sized]


def model_diameter(model: Segments, height: float, middle: np.ndarray | None) -> float | None:
    """Diameter of the thickest segment that crosses a height, near the trunk if its place is known."""
    z0, z1 = model.start[:, 2], model.end[:, 2]
    crossing = (np.minimum(z0, z1) <= height) & (np.maximum(z0, z1) >= height)
    if not crossing.any():
        return None
    rise = np.where(np.abs(z1 - z0) < 1e-9, 1.0, z1 - z0)[crossing]
    share = np.clip((height - z0[crossing]) / rise, 0.0, 1.0)
    start, end = model.start_radius[crossing], model.end_radius[crossing]
    radius = start + share * (end - start)
    at = model.start[crossing, :2] + share[:, None] * (model.end - model.start)[crossing, :2]
    if middle is not None:
        near = np.linalg.norm(at - middle, axis=1) < NEAR_TRUNK
        radius = radius[near] if near.any() else radius
    return 2.0 * float(np.nanmax(radius))


def main() -> None:
    """Command line."""
    from recon import read_cloud

    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scan")
    parser.add_argument(
        "cylinders", help="CSV with the columns x0,y0,z0,x1,y1,z1,r0,r1 and, if there, parent"
    )
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    cloud = read_cloud(arguments.scan)
    figures = measure(cloud.xyz + cloud.origin, read_cylinders(arguments.cylinders), seed=arguments.seed)
    print(report.table([{"figure": name, "value": value} for name, value in figures.items()]))


if __name__ == "__main__":
    main()
