"""Simulated annealing over growth parameters, as the paper has it: the reference among the fitting methods.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 5.4 (Eq. 8 to 11) and figure 11.

Departs from it in, or reads it as:

- the paper does not say how a new point is proposed. Here some of the free parameters, at least one, move by
  a normal step along their bounds and are reflected there: a symmetric proposal, as Eq. 10 asks for;
- the number that decides on acceptance is drawn before anything is grown. Eq. 10, accept if u <= (p' / p)^(1
  / zeta), is then: accept if the sum of distances is at most the current one less zeta ln(u), and trees are
  grown and compared only until that is certain. The chain is the one that full evaluation gives;
- everything random in an iteration follows from the seed, the chain and the number of the iteration, so that
  a run that was broken off goes on as if it had not been.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inverse.trials import Judge, is_no_farther
from treegraph import InputError

__all__ = ["AnnealingSettings", "Chain", "anneal"]

START = -1  # the "iteration" from which a chain's first point comes


@dataclass(frozen=True)
class AnnealingSettings:
    """How the annealing runs; the first three are the paper's.

    Attributes
    ----------
    iterations : int, default 7500
    samples : int, default 8
        Trees grown per point.
    hottest : float, default 4
        zeta at the first iteration; it falls linearly and is 0 at the last.
    step : float, default 0.1
        Standard deviation of a parameter's step, as a share of its bounds.
    share : float, default 0.2
        Of the free parameters that move in an iteration, on average.
    report_every : int, default 25
        Iterations after which the current distance is found exactly for the convergence curve.
    lazy : bool, default True
        Whether to compute only what decides. The chain is the same.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    iterations: int = 7500
    samples: int = 8
    hottest: float = 4.0
    step: float = 0.1
    share: float = 0.2
    report_every: int = 25
    lazy: bool = True

    def __post_init__(self) -> None:
        for name, least in (("iterations", 1), ("samples", 1), ("report_every", 1)):
            if getattr(self, name) < least:
                raise InputError(f"{name} must be a whole number >= {least}, got {getattr(self, name)!r}")
        for name in ("hottest", "step", "share"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} must be a finite number >= 0, got {getattr(self, name)!r}")
        if not self.step > 0.0 or not 0.0 < self.share <= 1.0:
            raise InputError(f"step must be > 0 and share above 0 to 1, got {self.step!r} and {self.share!r}")

    def temperature(self, iteration: int) -> float:
        """zeta of an iteration, counted from 0."""
        last = max(self.iterations - 1, 1)
        return self.hottest * (1.0 - iteration / last)


@dataclass
class Chain:
    """Where a chain stands; all that is needed to go on.

    Attributes
    ----------
    number : int
        Of the chain, from 0.
    iteration : int
        How many are done.
    origin : int
        Iteration that proposed the current point; -1: it is the first.
    accepted : int
        Proposals accepted so far.
    point : list of float
        The current point.
    curve : list of (int, float)
        Iterations done, and mean distance of the current point then.
    """

    number: int
    point: list[float]
    iteration: int = 0
    origin: int = START
    accepted: int = 0
    curve: list[tuple[int, float]] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """For a checkpoint; numbers are kept to the bit."""
        return {
            "number": self.number, "iteration": self.iteration, "origin": self.origin,
            "accepted": self.accepted, "point": self.point, "curve": [list(pair) for pair in self.curve],
        }  # fmt: skip

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Chain:
        """From a checkpoint.

        Raises
        ------
        InputError
            If something is missing, no number or out of its range.
        """
        try:
            curve = [(int(k), float(value)) for k, value in values["curve"]]
            chain = cls(
                int(values["number"]), [float(x) for x in values["point"]], int(values["iteration"]),
                int(values["origin"]), int(values["accepted"]), curve,
            )  # fmt: skip
            if min(chain.number, chain.iteration, chain.origin - START, chain.accepted) < 0:
                raise ValueError("a count is negative")
            if not all(0.0 <= x <= 1.0 for x in chain.point):
                raise ValueError("its point is out of bounds")
            return chain
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"the state of a chain is damaged: {type(error).__name__} {error}") from None


def start_chain(judge: Judge, number: int, first: NDArray[np.float64] | None = None) -> Chain:
    """A chain at a point, by default a random one."""
    if first is None:
        first = np.random.default_rng([judge.seed, number]).random(judge.space.n_free)
    return Chain(number, [float(x) for x in first])


def anneal(
    judge: Judge,
    settings: AnnealingSettings,
    chain: Chain,
    *,
    keep_going: Callable[[Chain], bool] = lambda chain: True,
) -> Chain:
    """Run a chain to its last iteration, or until it is told to stop.

    Parameters
    ----------
    judge : Judge
        Whose samples are those of the settings.
    settings : AnnealingSettings
    chain : Chain
        Where to begin; it is changed.
    keep_going : callable
        Asked after every iteration with the chain; False stops it, and it can go on later.

    Returns
    -------
    chain : Chain
        The same. Its point is the current one, which at the end, where zeta is 0, is the result.

    Notes
    -----
    ``samples`` evaluations per iteration, or as many of them as the decision needs.
    """
    if judge.samples != settings.samples:
        raise InputError(f"samples must be {settings.samples} as in the settings, got {judge.samples}")
    current = judge.trial(np.array(chain.point), (chain.number, chain.origin + 1))
    if not chain.curve:
        chain.curve.append((0, judge.mean_distance(current)))
    while chain.iteration < settings.iterations:
        rng = np.random.default_rng([judge.seed, chain.number, chain.iteration])
        chance = rng.random()
        slack = -settings.temperature(chain.iteration) * math.log(1.0 - chance)
        point = propose(current.point, settings, rng)
        trial = judge.trial(point, (chain.number, chain.iteration + 1))
        if not settings.lazy:
            judge.settle_all(current)
            judge.settle_all(trial)
        if is_no_farther(judge, trial, current, slack):
            current = trial
            chain.point, chain.origin = [float(x) for x in point], chain.iteration
            chain.accepted += 1
        chain.iteration += 1
        if chain.iteration % settings.report_every == 0 or chain.iteration == settings.iterations:
            chain.curve.append((chain.iteration, judge.mean_distance(current)))
        if not keep_going(chain):
            break
    return chain


def propose(
    point: NDArray[np.float64], settings: AnnealingSettings, rng: np.random.Generator
) -> NDArray[np.float64]:
    """A point near another one; as likely as the other way round."""
    moves = rng.random(point.size) < settings.share
    moves[rng.integers(point.size)] = True
    moved = point + np.where(moves, settings.step * rng.standard_normal(point.size), 0.0)
    return 1.0 - np.abs(1.0 - moved % 2.0)  # reflected at 0 and 1
