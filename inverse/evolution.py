"""The default way of fitting: an evolution strategy that begins near what the trees show.

Based on: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, 2016 (its default constants),
on the distance of O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6),
2014, Eq. 9.

Departs from it in: points are reflected at the bounds. All points of a generation grow from the same random
numbers, so that they differ by their parameters alone; all are measured with a quarter of the samples, the
better half with half of them, the best quarter with all (successive halving). Of those that are left out
nothing
more is found than that they are farther.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inverse.trials import EXACT, Judge, Trial
from treegraph import InputError

__all__ = ["Evolution", "EvolutionSettings", "evolve"]

FIRST_SIGMA = 0.4  # of the standard deviations that the guess comes with


@dataclass(frozen=True)
class EvolutionSettings:
    """How the evolution strategy runs.

    Attributes
    ----------
    evaluations : int, default 6000
        Trees grown and compared; the generation that reaches it is the last.
    samples : int, default 4
        Trees grown per point at most, 4 or more: on so small a budget more points tell more than more trees
        of each.
    population : int, default 14
        Points per generation, 4 or more.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    evaluations: int = 6000
    samples: int = 4
    population: int = 14

    def __post_init__(self) -> None:
        for name, least in (("evaluations", 1), ("samples", 4), ("population", 4)):
            if getattr(self, name) < least:
                raise InputError(f"{name} must be a whole number >= {least}, got {getattr(self, name)!r}")


@dataclass
class Evolution:
    """Where an evolution stands; all that is needed to go on.

    Attributes
    ----------
    number : int
        Of the run, from 0.
    mean : (d,) float64
        Middle of the next generation; its reflection into the bounds is the result so far.
    spread : (d,) float64
        Standard deviations from which it began.
    sigma : float
        Overall step.
    covariance : (d, d) float64
    path_sigma, path_c : (d,) float64
        Evolution paths.
    generation, evaluations : int
        Done so far.
    curve : list of (int, float)
        Evaluations done, and mean distance of the best quarter of the generation.
    """

    number: int
    mean: NDArray[np.float64]
    spread: NDArray[np.float64]
    sigma: float = FIRST_SIGMA
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    path_sigma: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    path_c: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    generation: int = 0
    evaluations: int = 0
    curve: list[tuple[int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        n = self.mean.size
        if not self.covariance.size:
            self.covariance, self.path_sigma, self.path_c = np.eye(n), np.zeros(n), np.zeros(n)

    @property
    def point(self) -> NDArray[np.float64]:
        """The middle, inside the bounds."""
        return reflected(self.mean)

    def to_dict(self) -> dict[str, Any]:
        """For a checkpoint; numbers are kept to the bit."""
        arrays = ("mean", "spread", "covariance", "path_sigma", "path_c")
        plain = ("number", "sigma", "generation", "evaluations")
        return (
            {name: getattr(self, name).tolist() for name in arrays}
            | {name: getattr(self, name) for name in plain}
            | {"curve": [list(pair) for pair in self.curve]}
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Evolution:
        """From a checkpoint.

        Raises
        ------
        InputError
            If something is missing or no number.
        """
        try:
            arrays = {
                name: np.array(values[name], np.float64)
                for name in ("mean", "spread", "covariance", "path_sigma", "path_c")
            }
            curve = [(int(k), float(value)) for k, value in values["curve"]]
            return cls(
                number=int(values["number"]), sigma=float(values["sigma"]), curve=curve,
                generation=int(values["generation"]), evaluations=int(values["evaluations"]), **arrays,
            )  # fmt: skip
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"the state of a run is damaged: {type(error).__name__} {error}") from None


def evolve(
    judge: Judge,
    settings: EvolutionSettings,
    run: Evolution,
    *,
    keep_going: Callable[[Evolution], bool] = lambda run: True,
) -> Evolution:
    """Run an evolution to its last generation, or until it is told to stop.

    Parameters
    ----------
    judge : Judge
        Whose samples are those of the settings.
    settings : EvolutionSettings
    run : Evolution
        Where to begin; it is changed.
    keep_going : callable
        Asked after every generation with the run; False stops it, and it can go on later.

    Returns
    -------
    run : Evolution
        The same.
    """
    if judge.samples != settings.samples:
        raise InputError(f"samples must be {settings.samples} as in the settings, got {judge.samples}")
    while run.evaluations < settings.evaluations:
        rng = np.random.default_rng([judge.seed, run.number, run.generation])
        root = _root(run.covariance)
        steps = rng.standard_normal((settings.population, run.mean.size)) @ root.T
        points = run.mean + run.sigma * run.spread * steps
        key = (run.number, run.generation + 1)
        trials = [judge.trial(reflected(point), key) for point in points]
        order, cost, best = rank(judge, trials)
        run.evaluations += cost
        run.curve.append((run.evaluations, best))
        _adapt(run, steps[order], root)
        run.generation += 1
        if not keep_going(run):
            break
    return run


def rank(judge: Judge, trials: list[Trial]) -> tuple[list[int], int, float]:
    """Order of trials, the nearest first; how many trees that took; and mean distance of the best quarter."""
    n, alive, cost, done = judge.samples, list(range(len(trials))), 0, 0
    order: list[int] = []
    for share, kept in ((4, 2), (2, 4), (1, 0)):
        wanted = max(n // share, 1)
        cut = math.ceil(len(trials) / kept) if kept else len(alive)
        alive = _nearest(judge, trials, alive, wanted, len(alive) if done else cut)
        cost += len(alive) * (wanted - done)
        done = wanted
        order = alive[cut:] + order
        alive = alive[:cut]
    best = float(np.mean([trials[k].low.mean() for k in alive]))
    return alive + order, cost, best


def _nearest(judge: Judge, trials: list[Trial], alive: list[int], samples: int, exact: int) -> list[int]:
    """Trials in order of their first samples' distances; the nearest are exact, the rest are farther."""
    judge.bound((trials[k], j) for k in alive for j in range(samples))

    def least(k: int) -> tuple[float, int]:
        return float(trials[k].low[:samples].sum()), k

    while True:
        alive = sorted(alive, key=least)
        unsettled = [(k, j) for k in alive[:exact] for j in range(samples) if trials[k].known[j] != EXACT]
        if not unsettled:
            return alive
        judge.settle((trials[k], j) for k, j in unsettled)


def reflected(point: NDArray[np.float64]) -> NDArray[np.float64]:
    """A point moved into 0 to 1 by reflection."""
    return 1.0 - np.abs(1.0 - point % 2.0)


def _root(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Symmetric square root."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(np.maximum(values, 1e-20))) @ vectors.T


def _adapt(run: Evolution, steps: NDArray[np.float64], root: NDArray[np.float64]) -> None:
    """One update of mean, step and covariance from steps in order; the constants are the tutorial's."""
    n, population = run.mean.size, len(steps)
    half = population // 2
    weights = np.log(half + 0.5) - np.log(np.arange(1, half + 1))
    weights /= weights.sum()
    effective = 1.0 / (weights**2).sum()
    c_sigma = (effective + 2.0) / (n + effective + 5.0)
    d_sigma = 1.0 + 2.0 * max(0.0, math.sqrt((effective - 1.0) / (n + 1.0)) - 1.0) + c_sigma
    c_c = (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n)
    c_1 = 2.0 / ((n + 1.3) ** 2 + effective)
    c_mu = min(1.0 - c_1, 2.0 * (effective - 2.0 + 1.0 / effective) / ((n + 2.0) ** 2 + effective))
    expected = math.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))
    chosen = steps[:half]
    step = weights @ chosen
    run.mean = run.mean + run.sigma * run.spread * step
    whitened = np.linalg.solve(root, step)
    run.path_sigma = (1.0 - c_sigma) * run.path_sigma + math.sqrt(
        c_sigma * (2.0 - c_sigma) * effective
    ) * whitened
    length = float(np.linalg.norm(run.path_sigma))
    fading = math.sqrt(1.0 - (1.0 - c_sigma) ** (2 * (run.generation + 1)))
    small = length / fading < (1.4 + 2.0 / (n + 1.0)) * expected
    run.path_c = (1.0 - c_c) * run.path_c + small * math.sqrt(c_c * (2.0 - c_c) * effective) * step
    rank_one = np.outer(run.path_c, run.path_c) + (not small) * c_c * (2.0 - c_c) * run.covariance
    rank_mu = (weights[:, None] * chosen).T @ chosen
    run.covariance = (1.0 - c_1 - c_mu) * run.covariance + c_1 * rank_one + c_mu * rank_mu
    run.sigma = min(run.sigma * math.exp(c_sigma / d_sigma * (length / expected - 1.0)), 2.0)
