"""The spatial vote: how long it takes for many trees, and what it does to the share that is right.

Trees stand at random, one on 64 or 400 square metres. The classifier is a draw: a score for each of 12
species, normal, and higher by a constant for the true one. *Streets*: one species in each square of 120 m;
*mixed*: any species anywhere.

    python -m benchmarks.vote
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks import report

N_SPECIES = 12
STREET = 120.0  # metres
LADDER = (10_000, 100_000, 1_000_000)
N_TREES = 50_000
CLEAR, DOUBTFUL = 4.0, 3.3  # how much higher the true species' score is


def drawn(true: np.ndarray, lead: float, rng: np.random.Generator) -> np.ndarray:
    """Probabilities (n, c) that are true to how they are drawn."""
    score = rng.normal(size=(len(true), N_SPECIES))
    score[np.arange(len(true)), true] += lead
    weight = np.exp(lead * (score - score.max(axis=1, keepdims=True)))
    return weight / weight.sum(axis=1, keepdims=True)


def timing(n: int, area: float) -> dict[str, Any]:
    """CPU seconds of one vote over n trees, a quarter of them in doubt."""
    from classify import vote_species

    rng = np.random.default_rng(0)
    position = rng.random((n, 2)) * np.sqrt(n * area)
    probability = rng.dirichlet(np.full(N_SPECIES, 0.12), n)
    vote_species(position[:100], probability[:100])
    begin = process_time()
    vote = vote_species(position, probability)
    seconds = process_time() - begin
    return {
        "trees": n,
        "m2 for each": area,
        "in doubt": float((~vote.is_confident).mean()),
        "cpu_s": seconds,
        "us for each": 1e6 * seconds / n,
    }


def accuracy(layout: str, lead: float) -> dict[str, Any]:
    """Share of trees that are right before the vote and after it, by both scores."""
    from classify import vote_species

    rng = np.random.default_rng(1)
    side = np.sqrt(64.0 * N_TREES)
    position = rng.random((N_TREES, 2)) * side
    n_streets = int(side // STREET) + 1
    street = (position // STREET).astype(np.int64) @ [n_streets, 1]
    streets = rng.integers(0, N_SPECIES, n_streets**2)[street]
    true = streets if layout == "streets" else rng.integers(0, N_SPECIES, N_TREES)
    probability = drawn(true, lead, rng)
    votes = {score: vote_species(position, probability, score=score) for score in ("own", "neighbours")}  # type: ignore[arg-type]
    return {
        "layout": layout,
        "in doubt": float((~votes["own"].is_confident).mean()),
        "before": float((probability.argmax(axis=1) == true).mean()),
        **{f"after, {score}": float((vote.label == true).mean()) for score, vote in votes.items()},
    }


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """Both tables."""
    times = [timing(n, area) for n in LADDER for area in (64.0, 400.0)]
    print(report.table(times))
    print()
    shares = [accuracy(layout, lead) for lead in (DOUBTFUL, CLEAR) for layout in ("streets", "mixed")]
    print(report.table(shares))
    report.write_json(getattr(arguments, "json", None), "vote", [*times, *shares])
    return times


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.vote", description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
