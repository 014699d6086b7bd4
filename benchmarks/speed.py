"""Time, memory and start-up.

The unit of time is what every program on a point cloud has to pay: one core's CPU seconds of
``scipy.spatial.cKDTree(P).query(P, k=16)``, build and query, on the same cloud in the same process.

    python -m benchmarks.speed --data DIR              (scans of 50 000 points and more, and the ladder)
    python -m benchmarks.speed --data DIR --ladder 100000,1000000,10000000
"""

from __future__ import annotations

import json
import math
import resource
import shutil
import subprocess
import sys
import time
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import data, report

N_NEIGHBOURS = 16
MIN_POINTS = 50_000
MAX_MULTIPLE = 6.0
LADDER = (100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
LADDER_MODEL = data.MODELS[4]  # eztree/oak_small
RESAMPLE_NOISE = 0.002  # metres
MAX_LADDER_GROWTH = 1.5  # of seconds / (n log n), between the first rung and any later one
MAX_MEMORY_MB = 6000.0
MAX_START_S = 0.5
N_STARTS = 5
WARM_UP_POINTS = 3000


def neighbour_seconds(points: np.ndarray) -> float:
    """CPU seconds of the 16 nearest neighbours of all points, on one core."""
    from scipy.spatial import cKDTree

    begin = time.process_time()
    cKDTree(points).query(points, k=N_NEIGHBOURS, workers=1)
    return time.process_time() - begin


def small_tree(seed: int = 0, n: int = WARM_UP_POINTS) -> np.ndarray:
    """(n, 3) points on the bark of a forked stem 3 m high: enough to touch every stage."""
    rng = np.random.default_rng(seed)
    share, turn = rng.random(n), rng.random(n) * 2.0 * np.pi
    limb = rng.integers(0, 3, n)
    lean = np.array([0.0, 0.5, -0.4])[limb]
    foot = np.array([0.0, 1.2, 1.6])[limb]
    radius = np.array([0.12, 0.05, 0.04])[limb] * (1.0 - 0.7 * share)
    rise = share * (3.0 - foot)
    return np.column_stack([radius * np.cos(turn) + lean * rise, radius * np.sin(turn), foot + rise])


def warm_up() -> None:
    """Compile and load what the first call would pay for, with and without clusters."""
    from recon import EncodeSettings, encode

    encode(small_tree())
    encode(small_tree(), settings=EncodeSettings(f_s=1.0))


def measure_scan(root: Path, scan: data.Scan) -> dict[str, Any] | None:
    """One row; None for a scan of fewer than 50 000 points."""
    from recon import EncodeSettings, encode_with_report

    points = data.read_points(root, scan)
    if len(points) < MIN_POINTS:
        return None
    settings = EncodeSettings(f_s=1.0) if scan.is_wood else EncodeSettings()
    begin = time.process_time()
    encoding = encode_with_report(points, settings=settings)
    cpu = time.process_time() - begin
    unit = neighbour_seconds(points)
    row = {"scan": scan.name, "points": len(points), "cpu_s": cpu, "unit_s": unit, "multiple": cpu / unit}
    row["ok"] = row["multiple"] <= MAX_MULTIPLE
    row.update({f"{stage}_s": seconds for stage, seconds in encoding.report.seconds.items()})
    return row


def resample(points: np.ndarray, n: int, seed: int = 0) -> np.ndarray:
    """(n, 3): a draw without repeats, or, of more than there are, repeats moved by 2 mm of noise."""
    rng = np.random.default_rng(seed)
    if n <= len(points):
        return points[np.sort(rng.choice(len(points), n, replace=False))]
    row = np.sort(rng.integers(0, len(points), n))
    return points[row] + rng.normal(0.0, RESAMPLE_NOISE, (n, 3))


def peak_memory_mb() -> float:
    """Highest resident memory of this process so far, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def measure_rung(root: Path, n: int) -> dict[str, Any]:
    """One rung of the ladder, in this process."""
    from benchmarks.skeleton_truth import read_scan
    from recon import EncodeSettings, encode

    points = resample(read_scan(root, LADDER_MODEL), n)
    warm_up()
    before = peak_memory_mb()
    begin = time.process_time()
    tree = encode(points, settings=EncodeSettings(f_s=1.0))
    cpu = time.process_time() - begin
    return {
        "points": n,
        "cpu_s": cpu,
        "cpu_s_per_n_log_n": cpu / (n * math.log(n)),
        "peak_mb": peak_memory_mb(),
        "before_mb": before,
        "nodes": tree.graph.n_nodes,
    }


def run_ladder(arguments: Namespace) -> list[dict[str, Any]]:
    """Every rung in a process of its own: peak memory has no way down."""
    rows: list[dict[str, Any]] = []
    for n in arguments.rungs:
        command = [sys.executable, "-m", "benchmarks.speed", "--data", str(arguments.data), "--rung", str(n)]
        print(f"ladder, {n} points", file=sys.stderr)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            rows.append({"points": n, "failed": (done.stderr.strip().splitlines() or ["no message"])[-1]})
            continue
        rows.append(json.loads(done.stdout))
        growth = rows[-1]["cpu_s_per_n_log_n"] / rows[0].get("cpu_s_per_n_log_n", math.nan)
        rows[-1]["growth"] = growth
        rows[-1]["ok"] = growth <= MAX_LADDER_GROWTH and rows[-1]["peak_mb"] <= MAX_MEMORY_MB
    return rows


def measure_start(n_starts: int = N_STARTS) -> dict[str, Any]:
    """Wall seconds of ``reconstruct --help``: the best of five, the first left out."""
    beside = Path(sys.executable).with_name("reconstruct")
    command = [str(beside)] if beside.is_file() else [shutil.which("reconstruct") or ""]
    if not command[0]:
        code = (
            "import sys; sys.argv[0] = 'reconstruct'; from sapwood.cli.main import reconstruct_main as m; m()"
        )
        command = [sys.executable, "-c", code]
    seconds = []
    for _ in range(n_starts + 1):
        begin = time.perf_counter()
        subprocess.run([*command, "--help"], check=True, capture_output=True)
        seconds.append(time.perf_counter() - begin)
    best = min(seconds[1:])
    return {"command": "reconstruct --help", "first_s": seconds[0], "best_s": best, "ok": best <= MAX_START_S}


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """Scans, ladder and start-up, printed as three tables."""
    root = Path(arguments.data)
    scans = data.chosen(arguments, data.SCANS)
    warm_up()
    rows = []
    for scan in scans:
        row = measure_scan(root, scan)
        if row is not None:
            print(scan.name, file=sys.stderr)
            rows.append(row)
    print(report.table(rows), end="\n\n")
    report.write_json(arguments.json, "speed", rows)
    if (root / LADDER_MODEL.path).is_file() and arguments.rungs:
        ladder = run_ladder(arguments)
        print(report.table(ladder), end="\n\n")
        report.write_json(arguments.json, "speed_ladder", ladder)
    start = [measure_start()]
    print(report.table(start))
    report.write_json(arguments.json, "start", start)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    parser.add_argument(
        "--ladder",
        dest="rungs",
        type=lambda text: [int(float(n)) for n in text.split(",") if n.strip()],
        default=list(LADDER),
        help="numbers of points, by commas; empty for none",
    )
    parser.add_argument("--rung", type=int, help="measure one rung in this process and print it as JSON")
    arguments = parser.parse_args()
    if arguments.rung:
        print(json.dumps(measure_rung(Path(arguments.data), arguments.rung)))
    else:
        run(arguments)


if __name__ == "__main__":
    main()
