"""Bytes of the .lobes file of every single-tree scan at default settings, and what coding costs.

The file must stay under 40 kB and its quantisation must move the wood by less than 1 mm in the median.

    python -m benchmarks.sizes --data DIR
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import data, report
from benchmarks.data import Scan

MAX_BYTES = 40_000
GOOD_BYTES = 15_000
MAX_MEDIAN_ERROR = 0.001  # metres


def coding_error(before: Any, after: Any) -> dict[str, float]:
    """How far coding moves the wood: positions in the median and at worst, radii in the median, metres.

    Nodes are compared row by row where there are as many as before, else by the nearest one.
    """
    a, b = before.graph, after.graph
    there, here = a.position + before.origin, b.position + after.origin
    if len(there) == len(here):
        row = np.arange(len(there))
    else:
        from scipy.spatial import cKDTree

        row = cKDTree(here).query(there)[1]
    gap = np.linalg.norm(there - here[row], axis=1)
    known = np.isfinite(a.radius) & np.isfinite(b.radius[row])
    off = np.abs(a.radius - b.radius[row])[known]
    return {
        "median_error": float(np.median(gap)),
        "worst_error": float(gap.max()),
        "radius_error": float(np.median(off)) if off.size else float("nan"),
    }


def measure_scan(root: Path, scan: Scan) -> dict[str, Any]:
    """One row."""
    from recon import encode
    from treegraph import decode_lobes, encode_lobes

    tree = encode(data.read_points(root, scan))
    blob = encode_lobes(tree)
    error = coding_error(tree, decode_lobes(blob))
    return {
        "scan": scan.name,
        "bytes": len(blob),
        "nodes": tree.graph.n_nodes,
        "clusters": len(tree.clusters),
        "faces": sum(len(cluster.faces) for cluster in tree.clusters),
        "median_error_mm": round(1000.0 * error["median_error"], 3),
        "worst_error_mm": round(1000.0 * error["worst_error"], 3),
        "radius_error_mm": round(1000.0 * error["radius_error"], 3),
        "ok": len(blob) <= MAX_BYTES and error["median_error"] < MAX_MEDIAN_ERROR,
    }


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed with the counts."""
    rows = []
    for scan in data.chosen(arguments, data.SCANS):
        print(scan.name, file=sys.stderr)
        rows.append(measure_scan(Path(arguments.data), scan))
    print(report.table(rows))
    n_good = sum(row["bytes"] <= GOOD_BYTES for row in rows)
    n_ok = sum(row["ok"] for row in rows)
    print(
        f"{n_ok} of {len(rows)} under {MAX_BYTES} bytes and true to 1 mm, {n_good} under {GOOD_BYTES} bytes"
    )
    report.write_json(arguments.json, "sizes", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
