"""Known growth parameters found again: trees of random parameters fitted blind, beside trees of the truth."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import report

TREES = 20
EVALUATIONS = 6000  # per run: the default of fit_trees
RUNS = 2  # of which the one nearer to the input counts
BROTHERS = 8  # new trees of the true and of the fitted parameters; 28 pairs among the true, 64 between
LEAST_NODES, MOST_NODES = 80, 600
AGES = (8, 12)
SPAN = 0.25  # of the bounds, around a preset, from which parameters are drawn
HEIGHT = 8.0  # metres: what the bounds of lengths follow
KINDS = ("F6a", "F6b", "F6c", "F6d", "F6f")
QUANTILE = 0.95  # of the distances among true trees, up to which a fit is within their spread
AROUND, ANYWHERE = "around the presets", "anywhere within the bounds"


def known_trees(n: int, where: str = AROUND, *, seed: int = 0) -> list[tuple[Any, int, list[Any]]]:
    """Random parameters whose trees are neither bare nor huge, their age, and trees of each."""
    from inverse import search_space
    from species import GrowthSettings, find_preset, grow

    out: list[tuple[Any, int, list[Any]]] = []
    rng = np.random.default_rng([seed, where == ANYWHERE] if seed or where == ANYWHERE else 0)
    limit = GrowthSettings(max_nodes=10 * MOST_NODES)
    while len(out) < n:
        kind = find_preset(KINDS[len(out) % len(KINDS)])
        space = search_space(HEIGHT, fixed={"t": int(rng.integers(AGES[0], AGES[1] + 1))})
        centre = space.encode(kind.parameters, 10)
        if where == AROUND:
            point = np.clip(centre + SPAN * rng.uniform(-0.5, 0.5, centre.size), 0.0, 1.0)
        else:
            point = rng.random(centre.size)
        parameters, age = space.decode(point)
        trees = []
        for k in range(BROTHERS):
            rng_tree = np.random.default_rng([seed, len(out), k])
            trees.append(grow(parameters, age, rng=rng_tree, settings=limit).tree)
            if not LEAST_NODES <= trees[-1].n_nodes <= MOST_NODES:
                break
        else:
            out.append((parameters, age, trees))
    return out


def spread_of(parameters: Any, age: int, trees: list[Any], fit: Any) -> tuple[list[float], list[float]]:
    """Distances among trees of the true parameters, and of them to new trees of the fitted ones."""
    from inverse import compare_trees, describe_tree
    from species import GrowthSettings, grow

    true, settings = [describe_tree(tree) for tree in trees], GrowthSettings(tip_share=fit.tip_share)
    new = []
    for k in range(len(trees)):
        rng = np.random.default_rng([7, k])
        new.append(describe_tree(grow(fit.parameters, fit.age, rng=rng, settings=settings).tree))
    among = [compare_trees(a, b).distance for i, a in enumerate(true) for b in true[:i]]
    between = [compare_trees(a, b).distance for a in true for b in new]
    return among, between


def fits(n: int, where: str, settings: Any, runs: int = 1) -> Iterator[tuple[dict[str, Any], Any, Any]]:
    """One fit after the other: what is told of it, the true values, and those that were found.

    The first tree of the true parameters is the input; the others, among them it is, are never seen.
    """
    from inverse import fit_trees

    for k, (parameters, age, trees) in enumerate(known_trees(n, where)):
        start = perf_counter()
        fit = fit_trees([trees[0]], settings=settings, seed=k, runs=runs)
        seconds = perf_counter() - start
        among, between = spread_of(parameters, age, trees, fit)
        limit = float(np.quantile(among, QUANTILE))
        row = {
            "tree": k,
            "nodes": trees[0].n_nodes,
            "among_true_mean": float(np.mean(among)),
            "among_true_95": limit,
            "fitted_to_true": float(np.mean(between)),
            "fitted_to_input": fit.distance,
            "within": float(np.mean(between)) <= limit,
            "within_mean": float(np.mean(between)) <= float(np.mean(among)),
            "seconds": seconds,
        }
        yield (
            row,
            [*parameters.symbols().values(), age],
            [*fit.parameters.symbols().values(), fit.age],
        )


def found_again(
    n: int, where: str, evaluations: int, runs: int = 1
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """What is told of each fit, and how well each parameter's order was found."""
    from inverse import EvolutionSettings

    rows, truth, found = [], [], []
    for row, true, fitted in fits(n, where, EvolutionSettings(evaluations), runs):
        print(f"{where}, tree {row['tree']}: {row['fitted_to_true']:.3f}", file=sys.stderr, flush=True)
        rows.append(row)
        truth.append(true)
        found.append(fitted)
    return rows, identified(np.array(truth, float), np.array(found, float))


def identified(truth: np.ndarray, found: np.ndarray) -> list[dict[str, Any]]:
    """Rank correlation of true and fitted values of each parameter over the trees, the highest first."""
    from scipy.stats import spearmanr

    from species import parameter_table

    symbols = [entry["symbol"] for entry in parameter_table()] + ["t"]
    rows = []
    for k, symbol in enumerate(symbols):
        varies = np.ptp(truth[:, k]) > 0.0 and np.ptp(found[:, k]) > 0.0
        rank = float(spearmanr(truth[:, k], found[:, k]).statistic) if varies else float("nan")
        rows.append({"parameter": symbol, "rank_correlation": rank})
    return sorted(rows, key=lambda row: -np.nan_to_num(row["rank_correlation"], nan=-2.0))


def run(arguments: Namespace) -> None:
    """Print the fits and the parameters, of either kind of random parameters."""
    n = getattr(arguments, "trees", TREES)
    evaluations = getattr(arguments, "evaluations", EVALUATIONS)
    runs = getattr(arguments, "runs", RUNS)
    log = []
    for where in (AROUND, ANYWHERE):
        rows, parameters = found_again(n, where, evaluations, runs)
        within = sum(row["within"] for row in rows)
        print(f"### Parameters {where}: {within} of {n} within the spread\n\n{report.table(rows)}\n")
        print(f"{report.table(parameters)}\n", flush=True)
        log += [{"question": where, **row} for row in rows + parameters]
    report.write_json(getattr(arguments, "json", None), "recovery", log)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.recovery", description=__doc__)
    parser.add_argument("--trees", type=int, default=TREES)
    parser.add_argument("--evaluations", type=int, default=EVALUATIONS, help="per run")
    parser.add_argument("--runs", type=int, default=RUNS, help="the one nearer to the input counts")
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
