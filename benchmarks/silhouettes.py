"""Silhouettes of dressed models against those of their scans, from 8 directions around.

Points and surfaces are drawn into pixels of 5 cm, gaps up to 30 cm are closed and holes filled, for scan and
model alike; agreement is intersection over union. Wanted: a median of 0.75 over the scans with leaves.

    python -m benchmarks.silhouettes --data DIR
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import data, report
from benchmarks.data import Scan

PIXEL = 0.05  # metres
DIRECTIONS = 8
CLOSING = 3  # pixels: radius of the disk that closes gaps
STEP = 0.4  # of a pixel, at most, between the points that a surface is drawn by
WANTED = 0.75
MARGIN = CLOSING + 2  # pixels around a silhouette, so that closing has room


def silhouette(
    points: NDArray[np.float64], direction: float, low: NDArray, shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """Pixels (across, up) that points cover as seen along a horizontal direction, gaps and holes filled."""
    from scipy.ndimage import binary_closing, binary_fill_holes

    flat = np.column_stack([points[:, :2] @ [-np.sin(direction), np.cos(direction)], points[:, 2]])
    at = np.floor((flat - low) / PIXEL).astype(int) + MARGIN
    image = np.zeros(shape, bool)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    image[tuple(at[inside].T)] = True
    span = np.arange(-CLOSING, CLOSING + 1)
    disk = span[:, None] ** 2 + span**2 <= CLOSING**2
    return binary_fill_holes(binary_closing(image, disk))


def agreement(a: NDArray[np.float64], b: NDArray[np.float64]) -> list[float]:
    """Intersection over union of the silhouettes of two point sets, for each direction."""
    out = []
    for k in range(DIRECTIONS):
        direction = np.pi * k / DIRECTIONS
        side = [-np.sin(direction), np.cos(direction)]
        flat = [np.column_stack([points[:, :2] @ side, points[:, 2]]) for points in (a, b)]
        low = np.minimum(*(one.min(axis=0) for one in flat))
        high = np.maximum(*(one.max(axis=0) for one in flat))
        shape = tuple(np.ceil((high - low) / PIXEL).astype(int) + 1 + 2 * MARGIN)
        one, other = (silhouette(points, direction, low, shape) for points in (a, b))
        out.append(float((one & other).sum() / max((one | other).sum(), 1)))
    return out


def surface_points(parts: Any) -> NDArray[np.float64]:
    """Points on the surfaces of meshes, closer than a pixel; of leaves only where they are opaque."""
    out = []
    for part in parts:
        mesh, texture = part.mesh, part.material.texture
        corner = mesh.vertices[mesh.faces].astype(np.float64)
        longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
        pieces = np.clip(np.ceil(longest / (STEP * PIXEL)).astype(int), 1, 400)
        for n in np.unique(pieces):
            mine = pieces == n
            weight = _lattice(int(n))
            points = np.einsum("wc,fcx->fwx", weight, corner[mine]).reshape(-1, 3)
            if part.material.alpha_cutoff is not None and texture is not None:
                uv = np.einsum("wc,fcx->fwx", weight, mesh.uv[mesh.faces[mine]]).reshape(-1, 2)
                points = points[_opaque(texture.pixels, uv, part.material.alpha_cutoff)]
            out.append(points)
    return np.concatenate(out)


def _lattice(n: int) -> NDArray[np.float64]:
    """Barycentric coordinates of the corners of a triangle cut n times along each side."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    keep = i + j <= n
    u, v = i[keep] / n, j[keep] / n
    return np.column_stack([1.0 - u - v, u, v])


def _opaque(pixels: NDArray[np.uint8], uv: NDArray[np.float64], cutoff: float) -> NDArray[np.bool_]:
    height, width = pixels.shape[:2]
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(((1.0 - uv[:, 1]) * height).astype(int), 0, height - 1)
    return pixels[row, column, 3] >= 255.0 * cutoff


def measure_scan(root: Path, scan: Scan) -> dict[str, Any]:
    """One row: the scan's own points, prepared, against the tree dressed with its species."""
    import sapwood
    from sapwood.dressing import dress, find_kind

    points = data.read_points(root, scan)
    made = sapwood.reconstruct(points, species=scan.species, name="tree")
    kind = find_kind(made.tree)
    assert kind is not None
    dressed = dress(made.tree, kind)
    model = surface_points(dressed.parts())
    each = agreement(made.cloud.xyz, model)
    hulls = [cluster.vertices for cluster in made.tree.clusters]
    figures = dressed.figures()
    return {
        "scan": scan.name,
        "species": scan.species,
        "iou_median": round(median(each), 3),
        "iou_least": round(min(each), 3),
        "clusters": len(hulls),
        "twigs": figures["n_twigs"],
        "leaves": figures["n_leaves"],
        "leaf_area_m2": figures["leaf_area_m2"],
        "off_density_pct": round(100.0 * _off(figures), 2),
    }


def _off(figures: dict[str, Any]) -> float:
    """Leaf area over density times volume, less one."""
    wanted = figures["leaf_area_density"] * figures["cluster_volume_m3"]
    return figures["leaf_area_m2"] / wanted - 1.0 if wanted else 0.0


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed with the median over the scans."""
    rows = []
    for scan in data.chosen(arguments, data.SCANS):
        if scan.species is not None:
            print(scan.name, file=sys.stderr)
            rows.append(measure_scan(Path(arguments.data), scan))
    print(report.table(rows))
    if rows:
        middle = median(row["iou_median"] for row in rows)
        print(f"median {middle:.3f} over {len(rows)} scans (wanted {WANTED})")
    report.write_json(arguments.json, "silhouettes", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
