"""Light among leaves, wood and obstacles: the fast model's time and error beside the exact one's.

Beside the time stands how many multiply-adds (float32, in vector registers, without memory) the same core
does in it, measured just before: that depends less on what else the machine does than the time.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.report import seconds_of

REPEATS = 25
EXACT_POINTS = 4
SEED = 0
CHAIN = 64  # multiply-adds on each number of the reference
NUMBERS, ROUNDS = 4096, 100  # of the reference: 16 KB, in the first cache
CALLS = 2000
ZENITH_SPHERES = 2000


@cache
def multiply_adds() -> Callable[[np.ndarray, int], None]:
    """The compiled reference: CHAIN multiply-adds on each number, ``rounds`` times."""
    from numba import njit

    def kernel(values: np.ndarray, rounds: int) -> None:
        a, b = np.float32(0.999), np.float32(0.001)
        for _ in range(rounds):
            for i in range(np.uint64(values.size)):
                x = values[i]
                for _ in range(CHAIN):
                    x = x * a + b
                values[i] = x

    return njit(error_model="numpy", fastmath={"contract"})(kernel)


def multiply_add_seconds() -> float:
    """Processor time of one float32 multiply-add among many, the least of several runs."""
    kernel, values = multiply_adds(), np.ones(NUMBERS, np.float32)
    return seconds_of(lambda: kernel(values, ROUNDS), REPEATS)[0] / (NUMBERS * ROUNDS * CHAIN)


def call_seconds(n_leaves: int, n_points: int) -> float:
    """Processor time of one call of the kernel from compiled code, as the growth model calls it."""
    from numba import njit

    from treegraph import Sky, light
    from treegraph._light_kernels import gather

    rng = np.random.default_rng(SEED)
    leaf, wood, obstacles, _ = light._pack(leaves(rng, n_leaves))
    points, own = light._check_points(rng.uniform([-5, -5, 0], [5, 5, 10], (n_points, 3)), None, n_leaves)
    cells = light._sky_cells(light.DEFAULT_RINGS)
    weight, trans = light._cell_weight(light.DEFAULT_RINGS, Sky()), light._aligned(cells.grid[0].size)
    seen, amount, vector = np.empty((0, 0), np.float32), np.empty(n_points), np.empty((n_points, 3))

    @njit
    def repeat(calls: int, *arguments: Any) -> None:
        for _ in range(calls):
            gather(*arguments)

    sky = cells.grid, cells.fine, weight, trans, light.BLUR * cells.width, light.TENT * cells.width
    given = (points, own, n_leaves, leaf, wood, obstacles, seen, *sky, amount, vector)
    return seconds_of(lambda: repeat(CALLS, *given), REPEATS)[0] / CALLS


def study_errors(n_scenes: int) -> dict[str, float]:
    """Fast against exact at two points of each random scene of the tests, and for a sphere in the zenith."""
    from tests.treegraph.test_light_model import around, opaque, random_scene, random_sky
    from treegraph import Occluders, gather_light, gather_light_exact

    amount, vector = [], []
    for seed in range(n_scenes):
        rng = np.random.default_rng(seed)
        points, scene, sky = around(rng, 2, 0.0), random_scene(rng), random_sky(rng)
        fast, exact = gather_light(points, scene, sky), gather_light_exact(points, scene, sky)
        amount.append(fast.amount - exact.amount)
        vector.append(np.linalg.norm(fast.vector - exact.vector, axis=1))
    sine = np.linspace(0.001, 0.9999, ZENITH_SPHERES)
    here = np.zeros((1, 3))
    zenith = [gather_light(here, Occluders(opaque((0, 0, 1), s))).amount[0] for s in sine]
    return {
        "points": 2 * n_scenes,
        "amount_largest": float(np.abs(amount).max()),
        "amount_rms": float(np.sqrt(np.mean(np.square(amount)))),
        "vector_largest": float(np.max(vector)),
        "vector_rms": float(np.sqrt(np.mean(np.square(vector)))),
        "zenith_sphere_largest": float(np.abs(zenith - (1 - sine**2) ** 1.5).max()),  # cos^3 in closed form
    }


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


CALL_LADDER = ((0, 1), (1, 1), (10, 10), (100, 1))


def measure(scene: Callable[[np.random.Generator, int], Any], n: int, n_points: int) -> dict[str, Any]:
    """Time per point of both models and how far apart they are."""
    from treegraph import gather_light, gather_light_exact

    rng = np.random.default_rng(SEED)
    occluders, points = scene(rng, n), rng.uniform([-5, -5, 0], [5, 5, 10], (n_points, 3))
    one = multiply_add_seconds()
    fast_s, median_s = (t / n_points for t in seconds_of(lambda: gather_light(points, occluders), REPEATS))
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
        "median_us_per_point": median_s * 1e6,
        "multiply_adds_per_point": fast_s / one,
        "fast_ns_per_pair": fast_s * 1e9 / n if n else None,
        "exact_us_per_point": exact_s * 1e6,
        "times_faster": exact_s / fast_s,
        "largest_error": float(np.abs(fast.amount - exact.amount).max()),
    }


def run(arguments: Namespace) -> None:
    """Print one row per rung."""
    print(
        "| scene | occluders | points | fast, us/point: least | median | ns/pair | multiply-adds/point "
        "| exact, us/point | times faster | largest error |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows = []
    for rung in LADDER:
        row = measure(*rung)
        rows.append(row)
        pair = "" if row["fast_ns_per_pair"] is None else f"{row['fast_ns_per_pair']:.1f}"
        print(
            f"| {row['scene']} | {row['occluders']} | {row['points']} "
            f"| {row['fast_us_per_point']:.2f} | {row['median_us_per_point']:.2f} | {pair} "
            f"| {row['multiply_adds_per_point']:.0f} | {row['exact_us_per_point']:.0f} "
            f"| {row['times_faster']:.0f} | {row['largest_error']:.4f} |",
            flush=True,
        )
    calls = {f"{n} leaves, {q} points": call_seconds(n, q) * 1e6 for n, q in CALL_LADDER}
    print("\nOne call from compiled code, us: " + "; ".join(f"{k}: {v:.1f}" for k, v in calls.items()))
    n_errors = getattr(arguments, "errors", 0)
    errors = study_errors(n_errors) if n_errors else None
    if errors:
        print("\n" + ", ".join(f"{k} {v:.4g}" for k, v in errors.items()))
    extra = [{"calls_us": calls, "errors": errors}]
    report.write_json(getattr(arguments, "json", None), "light", rows + extra)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.light", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    parser.add_argument(
        "--errors", type=int, default=0, metavar="N", help="study the error in N random scenes (0.3 s each)"
    )
    run(parser.parse_args())


if __name__ == "__main__":
    main()
