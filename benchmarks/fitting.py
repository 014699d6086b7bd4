"""Fits: evaluations per second, the default method beside the published one, and parameters found again."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.growth import grown
from benchmarks.similarity import PUBLISHED, SIZES

#: Kinds, ages and seeds of the trees that both methods are set to.
FITTED = (("F6a", 8, 1), ("F6b", 11, 2), ("F6c", 11, 1), ("F6d", 11, 1), ("F6f", 11, 3))
SPEED_ITERATIONS = 400  # of annealing, in which the temperature falls as it does in 7500
QUICK_ITERATIONS = 750
SAMPLES, CHECKS = 8, 16
KNOWN_TREES = 20
SPAN = 0.25  # of the bounds, around a preset, from which known parameters are drawn
LEAST_NODES, MOST_NODES = 60, 600


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
        rows.append(row | {"published_nodes": nodes, "published_per_s": per_second})
    return rows


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


def found_again(n: int, evaluations: int) -> list[dict[str, Any]]:
    """Trees of random parameters, fitted blind: new trees of what was found beside new trees of the truth."""
    from scipy.stats import spearmanr

    from inverse import EvolutionSettings, fit_trees

    rows, truth, found = [], [], []
    for k, (parameters, age, trees) in enumerate(known_trees(n)):
        fit = fit_trees([trees[0]], settings=EvolutionSettings(evaluations), seed=k)
        among, between = spread_of(parameters, age, trees, fit)
        rows.append(
            {
                "tree": k,
                "nodes": trees[0].n_nodes,
                "among_true_mean": float(np.mean(among)),
                "among_true_95": float(np.quantile(among, 0.95)),
                "fitted_to_true": float(np.mean(between)),
                "within": float(np.mean(between)) <= float(np.quantile(among, 0.95)),
            }
        )
        truth.append([*parameters.symbols().values(), age])
        found.append([*fit.parameters.symbols().values(), fit.age])
    names = [*parameters.symbols(), "t"]
    ranks = {
        name: float(spearmanr([t[i] for t in truth], [f[i] for f in found]).statistic)
        for i, name in enumerate(names)
        if n > 2
    }
    rows.append({"tree": "within the spread", "within": sum(bool(row["within"]) for row in rows)})
    return rows + [{"parameter": name, "rank_correlation": value} for name, value in ranks.items()]


def known_trees(n: int) -> list[tuple[Any, int, list[Any]]]:
    """Random parameters around the presets whose trees are neither bare nor huge, and trees of each."""
    from inverse import search_space
    from species import find_preset, grow

    out: list[tuple[Any, int, list[Any]]] = []
    rng = np.random.default_rng(0)
    kinds = ("F6a", "F6b", "F6c", "F6d", "F6f")
    while len(out) < n:
        kind = find_preset(kinds[len(out) % len(kinds)])
        space = search_space(8.0, fixed={"t": int(rng.integers(8, 13))})
        centre = space.encode(kind.parameters, 10)
        point = np.clip(centre + SPAN * rng.uniform(-0.5, 0.5, centre.size), 0.0, 1.0)
        parameters, age = space.decode(point)
        trees = [grow(parameters, age, rng=np.random.default_rng([len(out), k])).tree for k in range(8)]
        if all(LEAST_NODES <= tree.n_nodes <= MOST_NODES for tree in trees):
            out.append((parameters, age, trees))
    return out


def spread_of(parameters: Any, age: int, trees: list[Any], fit: Any) -> tuple[list[float], list[float]]:
    """Distances among trees of the true parameters, and of them to trees of the fitted ones."""
    from inverse import compare_trees, describe_tree
    from species import grow

    true = [describe_tree(tree) for tree in trees]
    new = [
        describe_tree(grow(fit.parameters, fit.age, rng=np.random.default_rng([7, k])).tree)
        for k in range(len(trees))
    ]
    among = [compare_trees(a, b).distance for i, a in enumerate(true) for b in true[:i]]
    between = [compare_trees(a, b).distance for a in true for b in new]
    return among, between


def run(arguments: Namespace) -> None:
    """Print one table per question; the last only if asked for alone, with ``--long``."""
    full = getattr(arguments, "long", False)
    iterations = 7500 if full else QUICK_ITERATIONS
    parts: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "Evaluations per second of one core, and the published ones": lambda: speed(1),
        f"Annealing of {iterations} iterations, and the default": lambda: both_methods(iterations),
    }
    if full:
        parts["Known parameters found again"] = lambda: found_again(KNOWN_TREES, 6000)
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
    parser.add_argument(
        "--long", action="store_true", help="7500 iterations, and 20 trees found again: hours"
    )
    run(parser.parse_args())


if __name__ == "__main__":
    main()
