"""Growth: the compiled model beside the slow reference, time by size, batches, and the published curve."""

from __future__ import annotations

import math
import os
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.report import seconds_of

REPEATS = 9
SEED = 3
#: A kind and an age with about 2500 nodes, as the second age of the published curve.
BESIDE_REFERENCE = ("F6b", 18)
#: More than 10 000 nodes in 30 cycles.
LARGE = ("F6f", 30)
#: One kind whose shoots and leaves keep their habit, by ages: about 500 to 50 000 nodes.
CURVE = ("F6b", (12, 14, 16, 18, 22, 26, 34, 42, 52))
#: Thesis, table 4.2: nodes and milliseconds of an Open L-system, on the computer of its time.
PUBLISHED = ((530, 216.3), (2541, 8855.6), (9134, 61843.9))
BATCH = 64
#: Trees as an inverse fitter grows them: kind and age with about 300, 600 and 2300 nodes.
EVALUATED = (("F6e", 10), ("F6b", 12), ("F6b", 18))


def grown(kind: str, age: int, seed: int = SEED) -> Any:
    """One tree of a preset."""
    from species import find_preset, grow

    return grow(find_preset(kind).parameters, age, rng=np.random.default_rng(seed))


def beside_reference(kind: str, age: int) -> list[dict[str, Any]]:
    """The compiled model and the reference of the tests, with the same and with the plain light."""
    from species import find_preset
    from tests.species.reference_growth import grow_reference

    parameters = find_preset(kind).parameters
    fast_s = seconds_of(lambda: grown(kind, age), REPEATS)[0]
    nodes = grown(kind, age).tree.n_nodes
    rows = [{"model": "compiled", "nodes": nodes, "cpu_s": fast_s}]
    for light, name in (
        ("fast", "reference, compiled light"),
        ("exact", "reference, every ray against every cluster"),
    ):
        seconds = math.inf
        for _ in range(2):
            start = process_time()
            stand = grow_reference([parameters], age, np.random.default_rng(SEED), light=light)
            seconds = min(seconds, process_time() - start)
        # Other light grows another tree: compared is the time per node.
        ratio = seconds / len(stand.nodes) / (fast_s / nodes)
        rows.append({"model": name, "nodes": len(stand.nodes), "cpu_s": seconds, "times_slower": ratio})
    return rows


def curve(kind: str, ages: tuple[int, ...]) -> list[dict[str, Any]]:
    """Time by size of one kind, with the published times at the sizes that come nearest."""
    rows: list[dict[str, Any]] = []
    for age in ages:
        nodes = grown(kind, age).tree.n_nodes
        seconds = seconds_of(lambda age=age: grown(kind, age), REPEATS)[0]
        rows.append(
            {
                "age": age,
                "nodes": nodes,
                "cpu_ms": seconds * 1e3,
                "us_per_node": seconds / nodes * 1e6,
                "published_nodes": None,
                "published_ms": None,
            }
        )
    for nodes, milliseconds in PUBLISHED:
        nearest = min(rows, key=lambda row: abs(np.log(row["nodes"] / nodes)))
        nearest |= {"published_nodes": nodes, "published_ms": milliseconds}
    return rows


def batch(n: int = BATCH) -> list[dict[str, Any]]:
    """Trees of different parameters on 1 and on 2 threads: wall time, and whether the bytes are the same.

    Where ``cores`` is well below the number of workers others kept the cores busy.
    """
    from species import grow_many, presets

    rng = np.random.default_rng(SEED)
    kinds = list(presets().values())
    jobs = []
    for k in range(n):
        kind = kinds[k % len(kinds)]
        rate = kind.parameters.lateral_light_factor * rng.uniform(0.8, 1.2)
        jobs.append((kind.parameters.replace(LF_L=rate), max(8, kind.age)))
    workers = (1, 2)
    walls: dict[int, list[tuple[float, float]]] = {n_workers: [] for n_workers in workers}
    bytes_of, nodes = set(), 0
    grow_many(jobs[:2], seed=SEED)
    for _ in range(REPEATS):
        for n_workers in workers:
            start, cpu = perf_counter(), process_time()
            trees = grow_many(jobs, seed=SEED, workers=n_workers)
            wall = perf_counter() - start
            walls[n_workers].append((wall, (process_time() - cpu) / wall))
            bytes_of.add(tuple((g.tree.parent.tobytes(), g.tree.position.tobytes()) for g in trees))
            nodes = sum(g.tree.n_nodes for g in trees)
    return [
        {
            "trees": n,
            "workers": n_workers,
            "nodes": nodes,
            "wall_s": min(walls[n_workers])[0],
            "cores": min(walls[n_workers])[1],
            "faster": min(walls[1])[0] / min(walls[n_workers])[0],
            "same_bytes": len(bytes_of) == 1,
        }
        for n_workers in workers
    ]


def evaluations(trees: tuple[tuple[str, int], ...]) -> list[dict[str, Any]]:
    """How many trees of a size one core grows in a second."""
    rows = []
    for kind, age in trees:
        seconds = seconds_of(lambda kind=kind, age=age: grown(kind, age), REPEATS)[0]
        rows.append(
            {
                "kind": kind,
                "age": age,
                "nodes": grown(kind, age).tree.n_nodes,
                "trees_per_s": 1.0 / seconds,
            }
        )
    return rows


def large(kind: str, age: int) -> list[dict[str, Any]]:
    """The tree of more than 10 000 nodes in 30 cycles."""
    return [
        {
            "kind": kind,
            "cycles": age,
            "nodes": grown(kind, age).tree.n_nodes,
            "cpu_s": seconds_of(lambda: grown(kind, age), REPEATS)[0],
        }
    ]


def run(arguments: Namespace) -> None:
    """Print one table per question."""
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "Beside the slow reference": lambda: beside_reference(*BESIDE_REFERENCE),
        "A large tree": lambda: large(*LARGE),
        "Time by size, and the published Open L-system (thesis, table 4.2)": lambda: curve(*CURVE),
        f"A batch, {len(os.sched_getaffinity(0))} cores": batch,
        "Trees per second of one core": lambda: evaluations(EVALUATED),
    }
    found = {}
    for title, part in parts.items():
        found[title] = part()
        print(f"### {title}\n\n{report.table(found[title])}\n", flush=True)
    rows = [{"question": title, **row} for title, part in found.items() for row in part]
    report.write_json(getattr(arguments, "json", None), "growth", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
