"""Light among leaves, wood and obstacles: the fast model's time and error beside the exact one's."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

REPEATS = 7
EXACT_POINTS = 4
SEED = 0


def best_seconds(work: Callable[[], Any]) -> float:
    """Least processor time of several runs, after one that compiles."""
    work()
    seconds = []
    for _ in range(REPEATS):
        start = process_time()
        work()
        seconds.append(process_time() - start)
    return min(seconds)


def leaves(rng: np.random.Generator, n: int) -> Any:
    """Clusters of 0.1 to 1 m in a cube of 10 m."""
    from treegraph import Occluders, make_leaves

    return Occluders(make_leaves(rng.uniform([-5, -5, 0], [5, 5, 10], (n, 3)), rng.uniform(0.1, 1.0, n)))


def wood(rng: np.random.Generator, n: int) -> Any:
    """Twigs of 0.3 m and 1 to 3 cm in the same cube."""
    from treegraph import Branches, Occluders

    start = rng.uniform([-5, -5, 0], [5, 5, 10], (n, 3))
    step = rng.normal(size=(n, 3))
    end = start + 0.3 * step / np.linalg.norm(step, axis=1, keepdims=True)
    return Occluders(branches=Branches(start, end, rng.uniform(0.01, 0.03, n), rng.uniform(0.01, 0.03, n)))


def boxes(rng: np.random.Generator, n: int) -> Any:
    """Boxes of 0.2 to 1.5 m in the same cube."""
    from treegraph import Box, Occluders

    return Occluders(
        obstacles=[Box(rng.uniform([-5, -5, 0], [5, 5, 10]), rng.uniform(0.2, 1.5, 3)) for _ in range(n)]
    )


#: scene, occluders, points
LADDER = (
    (leaves, 0, 20_000),
    (leaves, 100, 1_000),
    (leaves, 100, 10_000),
    (leaves, 100, 100_000),
    (leaves, 1_000, 10_000),
    (leaves, 10_000, 1_000),
    (wood, 100, 5_000),
    (wood, 1_000, 1_000),
    (wood, 10_000, 100),
    (boxes, 1, 5_000),
    (boxes, 10, 1_000),
)


def measure(scene: Callable[[np.random.Generator, int], Any], n: int, n_points: int) -> dict[str, Any]:
    """Time per point of both models and how far apart they are."""
    from treegraph import gather_light, gather_light_exact

    rng = np.random.default_rng(SEED)
    occluders, points = scene(rng, n), rng.uniform([-5, -5, 0], [5, 5, 10], (n_points, 3))
    fast_s = best_seconds(lambda: gather_light(points, occluders)) / n_points
    few = points[:EXACT_POINTS]
    start = perf_counter()
    exact = gather_light_exact(few, occluders)
    exact_s = (perf_counter() - start) / len(few)
    fast = gather_light(few, occluders)
    return {
        "scene": scene.__name__,
        "occluders": n,
        "points": n_points,
        "fast_us_per_point": fast_s * 1e6,
        "fast_ns_per_pair": fast_s * 1e9 / n if n else None,
        "exact_us_per_point": exact_s * 1e6,
        "times_faster": exact_s / fast_s,
        "largest_error": float(np.abs(fast.amount - exact.amount).max()),
    }


def run(arguments: Namespace) -> None:
    """Print one row per rung."""
    print(
        "| scene | occluders | points | fast, us/point | ns/pair "
        "| exact, us/point | times faster | largest error |"
    )
    print("|---|---|---|---|---|---|---|---|")
    rows = []
    for rung in LADDER:
        row = measure(*rung)
        rows.append(row)
        pair = "" if row["fast_ns_per_pair"] is None else f"{row['fast_ns_per_pair']:.1f}"
        print(
            f"| {row['scene']} | {row['occluders']} | {row['points']} "
            f"| {row['fast_us_per_point']:.2f} | {pair} | "
            f"{row['exact_us_per_point']:.0f} | {row['times_faster']:.0f} | {row['largest_error']:.4f} |",
            flush=True,
        )
    if getattr(arguments, "json", None):
        Path(arguments.json).write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.light", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
