"""Features of scans: how many hold when a scan is thinned or turned, and what they cost beside the encoding.

Every scan is encoded and described four times: as it is, twice with a random third of its points, and
turned around the vertical. A feature *holds* when it changes by at most 10% of its value (the larger of
both), or, in the second figure, of its value or of its standard deviation over all trees, whichever is more;
unknown on one side only is a change, unknown on both is not counted.

    python -m benchmarks.features --data DIR
    python -m benchmarks.features --data DIR --only itsme
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks import data, report

CONIFERS = "local/eqv_als_conifers"
HOLDS = 0.10
THIRD = 1.0 / 3.0
TURN = 2.0  # radians
WAYS = ("third", "other third", "turned")


@dataclass(frozen=True, eq=False)
class Described:
    """One scan: its features as it is and changed, (4, f), and what they cost."""

    name: str
    kind: str
    n_points: int
    features: np.ndarray
    encode_s: float
    features_s: float


def scans(arguments: Namespace) -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """Name, kind and points of every scan that was asked for and is there."""
    for scan in data.chosen(arguments, data.SCANS):
        yield scan.name, "near", lambda scan=scan: data.read_points(Path(arguments.data), scan)  # type: ignore[misc]
    words = [word.strip() for word in arguments.only.split(",") if word.strip()]
    for path in sorted(Path(arguments.data).glob(f"{CONIFERS}/*/*.laz")):
        name = f"{path.parent.name}/{path.stem}"
        if not words or any(word in name for word in words):
            yield name, "from the air", lambda path=path: _read(path)  # type: ignore[misc]


def _read(path: Path) -> np.ndarray:
    from recon import read_cloud

    cloud = read_cloud(path)
    return cloud.xyz + cloud.origin


def describe(name: str, kind: str, points: np.ndarray) -> Described:
    """Features of a scan as it is, of two thirds of it, and of it turned; CPU seconds of the first."""
    from classify import describe_scan
    from recon import encode_with_report

    rng = np.random.default_rng(0)
    middle = points.mean(axis=0)
    c, s = np.cos(TURN), np.sin(TURN)
    turned = (points - middle) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + middle
    thirds = [points[rng.random(len(points)) < THIRD] for _ in range(2)]
    rows, seconds = [], []
    for cloud in (points, *thirds, turned):
        begin = process_time()
        made = encode_with_report(cloud)
        middle_s = process_time()
        rows.append(describe_scan(made.cloud.xyz, made.tree).array)
        seconds.append((middle_s - begin, process_time() - middle_s))
    return Described(name, kind, len(points), np.array(rows), *seconds[0])


def held(a: np.ndarray, b: np.ndarray, spread: np.ndarray | float = 0.0) -> np.ndarray:
    """Whether each feature holds, as float; NaN where it is unknown in both."""
    size = np.maximum(np.fmax(np.abs(a), np.abs(b)), spread)
    out = np.where(np.abs(a - b) <= HOLDS * size, 1.0, 0.0)  # a comparison with NaN is false
    out[np.isnan(a) & np.isnan(b)] = np.nan
    return out


def rows_of(found: list[Described]) -> list[dict[str, Any]]:
    """A row for each scan, and one for each kind of scans."""
    spread = np.nanstd([one.features[0] for one in found], axis=0) if len(found) > 1 else 0.0
    rows = [_row(one, spread) for one in found if one.kind == "near"]
    for kind in dict.fromkeys(one.kind for one in found):
        mine = [_row(one, spread) for one in found if one.kind == kind]
        mean: dict[str, Any] = {"scan": f"all {len(mine)} {kind}"}
        mean |= {key: float(np.mean([row[key] for row in mine])) for key in mine[0] if key != "scan"}
        rows.append(mean)
    return rows


def _row(one: Described, spread: np.ndarray | float) -> dict[str, Any]:
    shares = {}
    for k, way in enumerate(WAYS, 1):
        shares[way] = float(np.nanmean(held(one.features[0], one.features[k])))
        shares[f"{way}, or spread"] = float(np.nanmean(held(one.features[0], one.features[k], spread)))
    return {
        "scan": one.name,
        "points": one.n_points,
        "encode_s": one.encode_s,
        "features_s": one.features_s,
        "features_to_encode": one.features_s / one.encode_s,
        "known": float(np.isfinite(one.features[0]).mean()),
        **shares,
    }


def group_rows(found: list[Described]) -> list[dict[str, Any]]:
    """For each group of features the share that holds when a scan is thinned to a third."""
    from classify import FEATURES

    group = np.array([feature.group for feature in FEATURES])
    rows = []
    for name in dict.fromkeys(group):
        row: dict[str, Any] = {"group": name, "features": int((group == name).sum())}
        for kind in dict.fromkeys(one.kind for one in found):
            part = [
                held(one.features[0], one.features[1])[group == name] for one in found if one.kind == kind
            ]
            row[kind] = float(np.nanmean(part))
        rows.append(row)
    return rows


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed as tables."""
    found = []
    for name, kind, points in scans(arguments):
        print(name, file=sys.stderr)
        found.append(describe(name, kind, points()))
        if len(found) == 1:
            found[0] = describe(name, kind, points())  # the first one compiled
    if not found:
        print("(no scans)")
        return []
    rows = rows_of(found)
    print(report.table(rows))
    print()
    groups = group_rows(found)
    print(report.table(groups))
    report.write_json(arguments.json, "features", [*rows, *groups])
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.features", description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    run(parser.parse_args())


if __name__ == "__main__":
    main()
