"""Wood: our cylinders against other programs' on scans without leaves.

Each scan is reconstructed with f_s = 1 (no clusters) and judged by ``benchmarks.fidelity_measure``; the other
programs' figures, taken with the same definitions, are in ``rivals.csv``. A scan passes when

- the median distance of its points from the surface is no worse than the best rival's,
- the share of its points within 5 cm is at most one percentage point below the best rival's,
- invented wood (surface more than 10 cm from any point) and unsupported length are no worse than
  the better of AdTree and PyTLidar,
- and all that with at most 4000 segments.

It is *near* when every figure that fails is within 20% of its bound.

    python -m benchmarks.wood --data DIR
    python -m benchmarks.wood --data DIR --models FOLDER      (judge FOLDER/NAME.cylinders.csv)
"""

from __future__ import annotations

import csv
import sys
import time
from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import data, report
from benchmarks.data import Scan
from benchmarks.fidelity_measure import measure
from benchmarks.segments import Segments, read_cylinders
from benchmarks.speed import neighbour_seconds

RIVALS = Path(__file__).with_name("rivals.csv")
STRICT_RIVALS = ("AdTree", "PyTLidar")  # of the programs, those whose invented wood is the bound
WITHIN_SLACK = 1.0  # percentage points
MAX_SEGMENTS = 4000
NEAR = 0.2
N_MUST_PASS = 7
DBH_SLACK = (0.01, 0.05)  # metres, share


@dataclass(frozen=True)
class Bounds:
    """What a scan's figures are held against; as the rivals' are rounded, so are ours."""

    median_mm: float
    within_5cm_pct: float
    back_over_10cm_pct: float
    unsupported_pct: float
    segments: float = MAX_SEGMENTS


def read_rivals(path: Path = RIVALS) -> list[dict[str, Any]]:
    """Rows of the rivals' figures; numbers as float, NaN where unknown."""
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    text = ("scan", "program")
    return [{k: v if k in text else float(v or "nan") for k, v in row.items()} for row in rows]


def bounds_for(name: str, rivals: list[dict[str, Any]]) -> Bounds | None:
    """The bounds of one scan, None where no rival was measured."""
    rows = [row for row in rivals if row["scan"] == name]
    strict = [row for row in rows if row["program"].startswith(STRICT_RIVALS)]
    if not rows or not strict:
        return None
    return Bounds(
        min(row["median_mm"] for row in rows),
        max(row["within_5cm_pct"] for row in rows) - WITHIN_SLACK,
        min(row["back_over_10cm_pct"] for row in strict),
        min(row["unsupported_pct"] for row in strict),
    )


def rounded(figures: dict[str, Any]) -> dict[str, float]:
    """The judged figures in the units and decimals of the rivals' table."""
    return {
        "median_mm": round(1000.0 * figures["median"], 1),
        "within_5cm_pct": round(100.0 * figures["within_5cm"], 1),
        "back_over_10cm_pct": round(100.0 * figures["back_over_10cm"], 1),
        "unsupported_pct": round(100.0 * figures["unsupported"], 1),
        "segments": float(figures["segments"]),
    }


def judge(figures: dict[str, float], bounds: Bounds) -> tuple[str, list[str]]:
    """``pass``, ``near`` or ``fail``, and the names of the figures that fail.

    A bound of 0 has no 20%: there a figure is near up to 0.2 (per cent).
    """
    failed, is_near = [], True
    for name, value in figures.items():
        bound = getattr(bounds, name)
        if name == "within_5cm_pct":
            fails, near = value < bound - 1e-9, value >= (1.0 - NEAR) * bound
        else:
            fails, near = value > bound + 1e-9, value <= max((1.0 + NEAR) * bound, NEAR)
        if fails:
            failed.append(name)
            is_near &= near
    return ("pass" if not failed else "near" if is_near else "fail"), failed


def reconstruct_wood(points: np.ndarray) -> tuple[Segments, str, float, float | None]:
    """Cylinders by our own reconstruction with f_s = 1: segments, their CSV, CPU seconds, DBH in metres."""
    from benchmarks.segments import from_cylinders
    from recon import EncodeSettings, encode_with_report
    from sapwood.cylinders import cylinder_table, format_cylinders

    begin = time.process_time()
    encoding = encode_with_report(points, settings=EncodeSettings(f_s=1.0))
    cpu = time.process_time() - begin
    table = cylinder_table(encoding.tree.graph, encoding.tree.origin)
    return from_cylinders(table), format_cylinders(table), cpu, encoding.report.dbh_m


def dbh_agrees(model: float | None, circle: float | None) -> bool | None:
    """True if within 1 cm or 5% of the circle; None where one of them is unknown."""
    if model is None or circle is None:
        return None
    return bool(abs(model - circle) <= max(DBH_SLACK[0], DBH_SLACK[1] * circle))


def measure_scan(root: Path, scan: Scan, models: Path | None, out: Path | None) -> dict[str, Any]:
    """One row of the table."""
    points = data.read_points(root, scan)
    row: dict[str, Any] = {"scan": scan.name, "points": len(points)}
    dbh, cpu, file_name = None, None, f"{Path(scan.path).stem}.cylinders.csv"
    if models is not None:
        segments = read_cylinders(models / file_name)
    else:
        segments, text, cpu, dbh = reconstruct_wood(points)
        if out is not None:
            (out / file_name).write_text(text, encoding="utf-8")
    figures = measure(points, segments)
    ours = rounded(figures)
    bounds = bounds_for(scan.name, read_rivals())
    for name, value in ours.items():
        row[name] = f"{value:g}" + (f" ({getattr(bounds, name):g})" if bounds else "")
    row["dbh_cm"] = None if dbh is None else round(100.0 * dbh, 1)
    row["dbh_model_cm"] = None if figures["dbh_model"] is None else round(100.0 * figures["dbh_model"], 1)
    row["dbh_circle_cm"] = None if figures["dbh_points"] is None else round(100.0 * figures["dbh_points"], 1)
    row["arc"] = figures["dbh_arc"]
    row["cpu_s"] = cpu
    row["cpu_multiple"] = None if cpu is None else cpu / neighbour_seconds(points)
    if bounds:
        row["verdict"], failed = judge(ours, bounds)
        row["failed"] = " ".join(failed)
    return row


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed with the count that passed."""
    scans = data.chosen(arguments, tuple(s for s in data.SCANS if s.is_wood))
    models, out = getattr(arguments, "models", None), getattr(arguments, "out", None)
    if models is not None:
        scans = [s for s in scans if (models / f"{Path(s.path).stem}.cylinders.csv").is_file()]
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    rows = []
    for scan in scans:
        print(scan.name, file=sys.stderr)
        rows.append(measure_scan(Path(arguments.data), scan, models, out))
    print(report.table(rows))
    n_pass = sum(row.get("verdict") == "pass" for row in rows)
    n_fail = sum(row.get("verdict") == "fail" for row in rows)
    print(f"{n_pass} of {len(rows)} pass, {n_fail} fail by more than {NEAR:.0%}; in brackets the bound")
    report.write_json(arguments.json, "wood", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    parser.add_argument("--models", type=Path, help="folder of NAME.cylinders.csv to judge instead")
    parser.add_argument("--out", type=Path, help="folder to write our NAME.cylinders.csv to")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
