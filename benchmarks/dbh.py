"""DBH against a circle through the points at breast height, on every scan of a single tree.

Where the ring of points is clean over at least half of its arc, our DBH must be within 1 cm or 5% of the
circle's diameter; everywhere there must be a DBH, or a null with its reason.

    python -m benchmarks.dbh --data DIR
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import data, report
from benchmarks.data import Scan
from benchmarks.fidelity_measure import Circle, slice_circle
from benchmarks.wood import dbh_agrees

CLEAN_ARC = 0.5
CLEAN_RESIDUAL = 0.01  # metres, or
CLEAN_RESIDUAL_SHARE = 0.10  # of the radius: median distance of the points from the circle


def is_clean(circle: Circle | None) -> bool:
    """True if the points make a ring over half of its arc."""
    if circle is None:
        return False
    close = circle.residual <= max(CLEAN_RESIDUAL, CLEAN_RESIDUAL_SHARE * circle.radius)
    return circle.arc >= CLEAN_ARC and close


def judge(dbh: float | None, reason: str | None, circle: Circle | None) -> str:
    """``pass``, ``fail`` or, where there is no clean ring, whether a null was explained."""
    if is_clean(circle):
        assert circle is not None
        return "pass" if dbh_agrees(dbh, 2.0 * circle.radius) else "fail"
    if dbh is None:
        return "null, explained" if reason else "null without a reason"
    return "no clean ring"


def off_circle(dbh: float | None, circle: Circle | None) -> float | None:
    """Our DBH against the circle's diameter, per cent; None where one of them is unknown."""
    if dbh is None or circle is None:
        return None
    return round(100.0 * (dbh / (2.0 * circle.radius) - 1.0), 1)


def measure_scan(root: Path, scan: Scan) -> dict[str, Any]:
    """One row; the slice is taken above the trunk base that the reconstruction found."""
    from recon import EncodeSettings, encode_with_report

    points = data.read_points(root, scan)
    settings = EncodeSettings(f_s=1.0) if scan.is_wood else EncodeSettings()
    encoding = encode_with_report(points, settings=settings)
    base = float(encoding.tree.origin[2])
    circle = slice_circle(points, base, np.random.default_rng(0))
    facts = encoding.report
    return {
        "scan": scan.name,
        "dbh_cm": None if facts.dbh_m is None else round(100.0 * facts.dbh_m, 1),
        "circle_cm": None if circle is None else round(200.0 * circle.radius, 1),
        "off_pct": off_circle(facts.dbh_m, circle),
        "arc": None if circle is None else circle.arc,
        "residual_mm": None if circle is None else round(1000.0 * circle.residual, 1),
        "base_above_lowest_m": round(base - float(points[:, 2].min()), 2),
        "verdict": judge(facts.dbh_m, facts.dbh_reason, circle),
        "how": facts.dbh_method if facts.dbh_m is not None else facts.dbh_reason,
    }


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed with the count that passed."""
    rows = []
    for scan in data.chosen(arguments, data.SCANS):
        print(scan.name, file=sys.stderr)
        rows.append(measure_scan(Path(arguments.data), scan))
    print(report.table(rows))
    clean = [row for row in rows if row["verdict"] in ("pass", "fail")]
    print(f"{sum(row['verdict'] == 'pass' for row in clean)} of {len(clean)} clean rings pass")
    report.write_json(arguments.json, "dbh", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
