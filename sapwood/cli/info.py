"""``info``: what is in a tree's file or in a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal


def info(
    source: o.LobesOrScan,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Say what is in a tree's file, or in a scan.

    \b
    Example:  sapwood info out/oak.lobes
              sapwood info oak.laz --json
    """
    from sapwood.trees import is_lobes

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    facts = _about_tree(source) if is_lobes(source) else _about_scan(source)
    for note in facts["notes"]:
        terminal.note(note)
    terminal.result(str(source))
    for key, value in facts.items():
        if key != "notes":
            terminal.result(f"  {key:<15} {_shown(value)}")
    terminal.json("info", input=str(source), **facts)
    return 0


def _about_tree(path: Path) -> dict[str, Any]:
    import numpy as np

    import treegraph
    from sapwood.cylinders import cylinder_length, cylinder_table, cylinder_volume
    from sapwood.trees import read_tree

    tree = read_tree(path)
    graph = tree.graph
    table = cylinder_table(graph)
    hulls = [cluster.vertices for cluster in tree.clusters]
    top = np.concatenate([graph.position, *hulls])[:, 2].max()
    allometry = tree.allometry
    return {
        "kind": "tree",
        "bytes": path.stat().st_size,
        "height_m": round(float(top), 3),
        "total_length_m": round(float(cylinder_length(table).sum()), 3),
        "wood_volume_m3": round(float(cylinder_volume(table).sum()), 6),
        "n_nodes": graph.n_nodes,
        "n_tips": int(treegraph.count_tips(graph)[graph.parent < 0].sum()),
        "n_clusters": len(tree.clusters),
        "n_faces": sum(len(cluster.faces) for cluster in tree.clusters),
        "species": tree.species,
        "beta": _number(allometry.beta),
        "gamma": _number(allometry.gamma),
        "f_s": _number(allometry.f_s),
        "d_root_m": _number(allometry.d_root),
        "origin": [round(value, 4) for value in tree.origin.tolist()],
        "epsg": tree.epsg,
        "notes": [],
    }


def _about_scan(path: Path) -> dict[str, Any]:
    import recon
    from recon.cloud import PER_POINT

    cloud = recon.read_cloud(path)
    low = cloud.xyz.min(axis=0) + cloud.origin
    high = cloud.xyz.max(axis=0) + cloud.origin
    return {
        "kind": "scan",
        "bytes": path.stat().st_size,
        "n_points": cloud.n_read,
        "n_points_used": cloud.n_points,
        "low": [round(value, 4) for value in low.tolist()],
        "high": [round(value, 4) for value in high.tolist()],
        "size": [round(value, 4) for value in (high - low).tolist()],
        "unit": cloud.unit,
        "epsg": cloud.epsg,
        "has": [name for name in PER_POINT if getattr(cloud, name) is not None],
        "notes": list(cloud.notes),
    }


def _number(value: float) -> float | None:
    return None if value != value else round(value, 6)


def _shown(value: Any) -> str:
    if value is None or value == []:
        return "-"
    if isinstance(value, list):
        return "  ".join(str(item) for item in value)
    return str(value)
