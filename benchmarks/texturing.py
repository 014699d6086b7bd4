"""Texturing: processor time for the instances of a tree, and its leaf area against density times volume.

The scans with leaves are reconstructed with their species and textured with its patches, on one core; the
first texturing, which compiles, is left out. ``copy_us`` is what copying the instances' bytes into new
memory takes, for information. ``off_pct``: the tree's leaf area over its target. ``off_clusters_pct``: what
clusters have too much or too little, as a share of it. ``empty_pct``: the target of clusters without a leaf.
``inside_pct``: middles of leaves that lie in their cluster or within 10 cm of it.

    python -m benchmarks.texturing --data DIR
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import data, report
from benchmarks.data import Scan

REPEATS = 9
MARGIN = 0.1  # metres
WANTED_OFF, WANTED_MS = 1.0, 50.0  # percent; milliseconds for 5000 instances


def texture(tree: Any, species: Any, table: Any) -> Any:
    """The tree filled with patches."""
    from species import texture_tree

    density = species.definition.leaf_area_density
    return texture_tree(tree, table, leaf_density=density, rng=np.random.default_rng(0))


def copy_instances(rows: Any) -> None:
    """Copy what texturing has made."""
    for name in ("patch", "position", "rotation", "scale", "cluster", "order"):
        array = getattr(rows, name)
        np.copyto(np.empty_like(array), array)


def leaf_middles(made: Any, patches: Any) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Middles of all leaves, and the cluster of each."""
    from scipy.spatial.transform import Rotation

    rows, points, cluster = made.instances, [np.empty((0, 3))], [np.empty(0, np.int32)]
    turn = Rotation.from_quat(rows.rotation) if len(rows) else None
    for i, patch in enumerate(rows.patch):
        leaves = patches[patch].leaves
        if leaves.n_leaves and turn is not None:
            local = leaves.base + 0.5 * leaves.length[:, None] * leaves.along
            points.append(rows.position[i] + rows.scale[i] * turn[i].apply(local))
            cluster.append(np.full(leaves.n_leaves, rows.cluster[i]))
    return np.concatenate(points), np.concatenate(cluster)


def share_inside(made: Any, tree: Any, patches: Any) -> float:
    """Share of the leaves whose middles are in their cluster's hull or within 10 cm of it."""
    import open3d as o3d

    points, cluster = leaf_middles(made, patches)
    inside = 0
    for k, hull in enumerate(tree.clusters):
        mine = points[cluster == k].astype(np.float32)
        if len(mine):
            scene = o3d.t.geometry.RaycastingScene()
            scene.add_triangles(hull.vertices.astype(np.float32), hull.faces.astype(np.uint32))
            inside += int((scene.compute_signed_distance(mine).numpy() <= MARGIN).sum())
    return inside / max(len(points), 1)


def measure_scan(root: Path, scan: Scan) -> dict[str, Any]:
    """One row."""
    import sapwood
    from render.dressing import blade_of, leaf_share
    from species import pack_patches
    from species.library import find_species

    tree = sapwood.reconstruct(data.read_points(root, scan), species=scan.species, name="tree").tree
    species = find_species(scan.species or "")
    table = pack_patches(species.patches, leaf_share(species), blade_of(species).bend)
    made = texture(tree, species, table)
    best, middle = report.seconds_of(lambda: texture(tree, species, table), REPEATS)
    copy, _ = report.seconds_of(lambda: copy_instances(made.instances), REPEATS)
    n, wanted = len(made.instances), max(float(made.target.sum()), 1e-12)
    empty = made.target[~np.isin(np.arange(len(made.target)), made.instances.cluster)].sum()
    return {
        "scan": scan.name,
        "species": scan.species,
        "clusters": len(made.target),
        "twigs": n,
        "ms": 1e3 * best,
        "median_ms": 1e3 * middle,
        "us_per_twig": 1e6 * best / max(n, 1),
        "copy_us": 1e6 * copy,
        "off_pct": 100.0 * (made.leaf_area.sum() / wanted - 1.0),
        "off_clusters_pct": 100.0 * float(np.abs(made.leaf_area - made.target).sum()) / wanted,
        "empty_pct": 100.0 * empty / wanted,
        "inside_pct": 100.0 * share_inside(made, tree, species.patches),
    }


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed."""
    rows = []
    for scan in data.chosen(arguments, data.SCANS):
        if scan.species is not None:
            print(scan.name, file=sys.stderr)
            rows.append(measure_scan(Path(arguments.data), scan))
    print(report.table(rows))
    if rows:
        twigs, ms = sum(row["twigs"] for row in rows), sum(row["ms"] for row in rows)
        print(f"5000 twigs: {5000 * ms / max(twigs, 1):.1f} ms (wanted {WANTED_MS:g})")
        off = max(abs(row["off_pct"]) for row in rows)
        print(f"leaf area: off by {off:.2g}% at most (wanted {WANTED_OFF:g})")
    report.write_json(arguments.json, "texturing", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=(__doc__ or "").splitlines()[0])
    data.add_arguments(parser)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
