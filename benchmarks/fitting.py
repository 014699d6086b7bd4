"""Fits: evaluations per second, and the default method beside the published one."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.growth import grown
from benchmarks.similarity import PUBLISHED, SIZES

#: Kinds, ages and seeds of the trees that both methods are set to.
FITTED = (("F6a", 8, 1), ("F6b", 11, 2), ("F6c", 11, 1), ("F6d", 11, 1), ("F6f", 11, 3))
SPEED_ITERATIONS = 400  # of annealing, in which the temperature falls as it does in 7500
QUICK_ITERATIONS = 750
PROCESSES = 2
SAMPLES, CHECKS = 8, 16


def speed(workers: int) -> list[dict[str, Any]]:
    """Evaluations per second of the published method over a whole schedule, as lazily as decisions allow."""
    from inverse import AnnealingSettings, search_space
    from inverse.annealing import anneal, start_chain
    from inverse.trials import Judge

    rows = []
    for (kind, age, seeds), (nodes, per_second) in zip(SIZES, PUBLISHED, strict=True):
        tree = grown(kind, age, seeds[0]).tree
        space = search_space(float(np.ptp(tree.position[:, 2])))
        row: dict[str, Any] = {"nodes": tree.n_nodes}
        iterations = SPEED_ITERATIONS if tree.n_nodes < 1000 else SPEED_ITERATIONS // 8
        for name, lazy in (("lazy", True), ("full", False)):
            settings = AnnealingSettings(iterations=iterations, lazy=lazy)
            with Judge([tree], space, seed=1, workers=workers) as judge:
                chain = start_chain(judge, 0)
                anneal(judge, AnnealingSettings(iterations=2), start_chain(judge, 9))
                judge.grown = judge.compared = 0
                start = process_time()
                anneal(judge, settings, chain)
                seconds = process_time() - start
            row |= {
                f"{name}_per_cpu_s": SAMPLES * iterations / seconds,
                f"{name}_compared": judge.compared / (SAMPLES * iterations),
            }
        row |= side_by_side(tree, iterations, PROCESSES)
        rows.append(row | {"published_nodes": nodes, "published_per_s": per_second})
    return rows


def side_by_side(tree: Any, iterations: int, processes: int) -> dict[str, Any]:
    """Evaluations per second of as many chains as processes, in wall time and in their processor time."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    bare = type(tree)(tree.parent, tree.position, tree.radius)
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        list(pool.map(one_chain, [bare] * processes, [2] * processes, range(processes)))
        start = perf_counter()
        seconds = list(pool.map(one_chain, [bare] * processes, [iterations] * processes, range(processes)))
        wall = perf_counter() - start
    evaluations = SAMPLES * iterations * processes
    return {
        f"{processes}_processes_per_s": evaluations / wall,
        f"{processes}_processes_per_cpu_s": evaluations / (sum(seconds) / processes),
    }


def one_chain(tree: Any, iterations: int, number: int) -> float:
    """Processor seconds of one chain of annealing."""
    from inverse import AnnealingSettings, search_space
    from inverse.annealing import anneal, start_chain
    from inverse.trials import Judge

    space = search_space(float(np.ptp(tree.position[:, 2])))
    with Judge([tree], space, seed=1) as judge:
        chain = start_chain(judge, number)
        start = process_time()
        anneal(judge, AnnealingSettings(iterations=iterations), chain)
        return process_time() - start


def both_methods(iterations: int) -> list[dict[str, Any]]:
    """What annealing ends with, what the default does with a tenth of that, and when it is as near."""
    from inverse import AnnealingSettings, EvolutionSettings, fit_trees

    rows = []
    for kind, age, seed in FITTED:
        tree = grown(kind, age, seed).tree
        published = fit_trees([tree], method="annealing", settings=AnnealingSettings(iterations), seed=1)
        tenth = published.evaluations // 10
        default = fit_trees([tree], settings=EvolutionSettings(tenth), seed=1)
        reached = [count for count, distance in default.curves[0] if distance <= published.distance]
        rows.append(
            {
                "kind": kind,
                "nodes": tree.n_nodes,
                "true_parameters": float(np.mean(among_brothers(kind, age, tree))),
                "annealing": published.distance,
                "evaluations": published.evaluations,
                "default": default.distance,
                "default_evaluations": default.evaluations,
                "as_near_after": reached[0] if reached else None,
            }
        )
    if rows:
        shares = [row["as_near_after"] / row["evaluations"] if row["as_near_after"] else 1.0 for row in rows]
        rows.append({"kind": "median share of evaluations", "as_near_after": median(shares)})
    return rows


def among_brothers(kind: str, age: int, tree: Any) -> list[float]:
    """Distances from a tree to others of its parameters."""
    from inverse import compare_trees

    return [compare_trees(tree, grown(kind, age, 100 + k).tree).distance for k in range(CHECKS)]


def run(arguments: Namespace) -> None:
    """Print one table per question."""
    full = getattr(arguments, "long", False)
    iterations = 7500 if full else QUICK_ITERATIONS
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "Evaluations per second of one core, and the published ones": lambda: speed(1),
        f"Annealing of {iterations} iterations, and the default": lambda: both_methods(iterations),
    }
    found = {}
    for title, part in parts.items():
        found[title] = part()
        print(f"### {title}\n\n{report.table(found[title])}\n", flush=True)
    rows = [{"question": title, **row} for title, part in found.items() for row in part]
    report.write_json(getattr(arguments, "json", None), "fitting", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.fitting", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    parser.add_argument("--long", action="store_true", help="the published 7500 iterations: half an hour")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
