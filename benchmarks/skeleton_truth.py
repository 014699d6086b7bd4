"""Recall and precision of skeleton length, and radius error, against true skeletons.

Both skeletons are cut into pieces of at most 5 mm. Recall at t is the share of the true length whose
middle of piece lies within t of a piece of the model; precision the same the other way round. A true skeleton
may have branches that the scanner never saw: *seen* figures count only the true pieces within REACH of
a scan point (measured from the bark where the true radius is known).

    python -m benchmarks.skeleton_truth --data DIR
    python -m benchmarks.skeleton_truth --data DIR --only A3B4 --model A3B4.cylinders.csv
"""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import data, report
from benchmarks.data import Scan
from benchmarks.segments import (
    Samples,
    Segments,
    from_tree,
    read_branch_polylines,
    read_cylinders,
    read_skeleton_nodes,
    sample,
)

SPACING = 0.005  # metres: both skeletons are cut into pieces no longer than this
TOLERANCES = (0.02, 0.03)  # metres
REACH = 0.05  # metres from the bark (known radius) to the nearest scan point: seen
REACH_WITHOUT_RADIUS = 0.10  # metres from the axis, where the radius is unknown
RADIUS_MATCH = 0.03  # metres: radii are compared between pieces this close
RUN = 10  # pieces that a radius is taken over from the points
RUN_POINTS = 5
MAX_RADII = 3.0  # points farther from the axis, in true radii, are not of this branch
MODEL_SCALE = 0.25  # metres per unit of the synthetic models


def compare(model: Samples, truth: Samples, scan: np.ndarray | None = None) -> dict[str, float]:
    """Figures of one model against one truth.

    Parameters
    ----------
    model, truth : Samples
        Pieces of both skeletons, same frame.
    scan : (n, 3) float64, optional
        The scan, for the *seen* figures.

    Returns
    -------
    figures : dict
        ``recall_2cm`` ... ``precision_3cm`` in [0, 1]; ``seen_share`` of the true length and
        ``seen_recall_2cm`` ...; ``radius_error``: median of abs(model - truth) / truth over the true length
        matched within 3 cm, and ``radius_bias``, its signed median (NaN where radii are unknown);
        ``points_error`` and ``points_bias`` of the scan's own points (:func:`points_against_radius`);
        lengths in metres.
    """
    from scipy.spatial import cKDTree

    to_model, nearest = cKDTree(model.xyz).query(truth.xyz)
    to_truth = cKDTree(truth.xyz).query(model.xyz)[0]
    out = {"length_m": float(model.length.sum()), "true_length_m": float(truth.length.sum())}
    for t in TOLERANCES:
        out[f"recall_{t * 100:.0f}cm"] = share(truth.length, to_model <= t)
        out[f"precision_{t * 100:.0f}cm"] = share(model.length, to_truth <= t)
    if scan is not None:
        seen = is_seen(truth, scan)
        out["seen_share"] = share(truth.length, seen)
        for t in TOLERANCES:
            out[f"seen_recall_{t * 100:.0f}cm"] = share(truth.length[seen], to_model[seen] <= t)
    matched = (to_model <= RADIUS_MATCH) & np.isfinite(truth.radius) & np.isfinite(model.radius[nearest])
    ratio = model.radius[nearest[matched]] / truth.radius[matched] - 1.0
    out["radius_error"] = weighted_median(np.abs(ratio), truth.length[matched])
    out["radius_bias"] = weighted_median(ratio, truth.length[matched])
    if scan is not None:
        out["points_error"], out["points_bias"] = points_against_radius(truth, scan)
    return out


def points_against_radius(truth: Samples, scan: np.ndarray) -> tuple[float, float]:
    """How far the scan itself is from the true radii: what a perfect measurement would get.

    The mean distance of the points from the true axis, over runs of `RUN` pieces with at least
    `RUN_POINTS` points nearest to them, against the mean true radius: median absolute relative
    difference and its signed median, NaN where radii are unknown. Polygonal models have their bark
    inside the nominal circle, and corrected skeletons carry modelled radii.
    """
    from scipy.spatial import cKDTree

    if not np.isfinite(truth.radius).any():
        return float("nan"), float("nan")
    gap, nearest = cKDTree(truth.xyz).query(scan)
    near = gap <= MAX_RADII * truth.radius[nearest]
    n_runs = len(truth.radius) // RUN + 1
    run = np.arange(len(truth.radius)) // RUN
    count = np.bincount(run[nearest[near]], minlength=n_runs)
    mean = np.bincount(run[nearest[near]], gap[near], minlength=n_runs) / np.maximum(count, 1)
    radius = np.bincount(run, truth.radius, minlength=n_runs) / np.maximum(
        np.bincount(run, minlength=n_runs), 1
    )
    length = np.bincount(run, truth.length, minlength=n_runs)
    enough = (count >= RUN_POINTS) & (radius > 0)
    ratio = mean[enough] / radius[enough] - 1.0
    return weighted_median(np.abs(ratio), length[enough]), weighted_median(ratio, length[enough])


def is_seen(truth: Samples, scan: np.ndarray) -> np.ndarray:
    """(k,) bool: the piece has a scan point within reach."""
    from scipy.spatial import cKDTree

    gap = cKDTree(scan).query(truth.xyz)[0]
    known = np.isfinite(truth.radius)
    return gap <= np.where(known, np.where(known, truth.radius, 0.0) + REACH, REACH_WITHOUT_RADIUS)


def share(length: np.ndarray, mask: np.ndarray) -> float:
    """Share of the length where the mask holds; NaN of nothing."""
    total = float(length.sum())
    return float(length[mask].sum()) / total if total > 0.0 else float("nan")


def weighted_median(value: np.ndarray, weight: np.ndarray) -> float:
    """Smallest value that half of the weight does not exceed; NaN of nothing."""
    if value.size == 0:
        return float("nan")
    order = np.argsort(value, kind="stable")
    total = np.cumsum(weight[order])
    return float(value[order][np.searchsorted(total, 0.5 * total[-1])])


def samples_of_points(xyz: np.ndarray) -> Samples:
    """Points that lie evenly along a skeleton, each standing for their usual spacing; radii unknown."""
    from scipy.spatial import cKDTree

    spacing = float(np.median(cKDTree(xyz).query(xyz, k=2)[0][:, 1]))
    return Samples(xyz, np.full(len(xyz), np.nan), np.full(len(xyz), spacing))


def read_truth(root: Path, scan: Scan) -> Samples:
    """The true skeleton of a scan, cut into pieces."""
    assert scan.truth is not None
    path = root / scan.truth
    if path.suffix == ".csv":
        if scan.name.startswith("eztree"):
            return sample(read_branch_polylines(path, MODEL_SCALE), SPACING)
        return sample(read_skeleton_nodes(path), SPACING)
    from recon import read_cloud

    cloud = read_cloud(path)
    return samples_of_points(cloud.xyz + cloud.origin)


def read_scan(root: Path, scan: Scan, *, seed: int = 0) -> np.ndarray:
    """The points of a scan; of a synthetic model, a virtual scan of its bark."""
    if not scan.name.startswith("eztree"):
        return data.read_points(root, scan)
    from benchmarks.synthetic import scan_model

    return scan_model(root / scan.path, scale=MODEL_SCALE, seed=seed)


def encode_wood(points: np.ndarray) -> tuple[Segments, float]:
    """Skeleton by our own reconstruction with f_s = 1, and its CPU seconds."""
    from recon import EncodeSettings, encode

    begin = time.process_time()
    tree = encode(points, settings=EncodeSettings(f_s=1.0))
    return from_tree(tree), time.process_time() - begin


def measure(
    root: Path,
    scan: Scan,
    model: Path | None = None,
    encode: Callable[[np.ndarray], tuple[Segments, float]] = encode_wood,
) -> dict[str, Any]:
    """One row of the table; `encode` makes segments and CPU seconds of points, unless a `model` is read."""
    points = read_scan(root, scan)
    truth = read_truth(root, scan)
    cpu = float("nan")
    if model is None:
        segments, cpu = encode(points)
    else:
        segments = read_cylinders(model)
    figures = compare(sample(segments, SPACING), truth, points)
    return {"scan": scan.name, "points": len(points), "segments": len(segments), "cpu_s": cpu, **figures}


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed as a table."""
    scans = data.chosen(arguments, tuple(s for s in (*data.WALNUT, *data.SCANS, *data.MODELS) if s.truth))
    rows = []
    for scan in scans:
        print(scan.name, file=sys.stderr)
        rows.append(measure(Path(arguments.data), scan, getattr(arguments, "model", None)))
    print(report.table(rows))
    report.write_json(arguments.json, "skeleton_truth", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    parser.add_argument("--model", type=Path, help="cylinders CSV to judge instead of a new reconstruction")
    arguments = parser.parse_args()
    if arguments.model and not arguments.only:
        parser.error("--model judges one scan: say which with --only")
    run(arguments)


if __name__ == "__main__":
    main()
