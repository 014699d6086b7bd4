"""The default way of fitting: evolution strategies that begin at the best of many places.

Based on: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv:1604.00772, 2016 (its default constants),
on the distance of O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6),
2014, Eq. 9.

Departs from it in: points are reflected at the bounds. All points of a generation grow one tree each, from
the same random numbers, so that they differ by their parameters alone; the next generation has others. Of the
worse half nothing more is found than that they are farther. Towards the end the better ones have more trees.

Differences of shape and geometry reach 1 where values differ by half: from afar all trees are as unlike. So
sigma of Eq. 4 is several times as large at first and falls to what it is (the softness). And the distance has
many valleys: a part of the budget goes to a survey, whose points have the height of the target as trees grow
nearly in proportion to their internodes; from its best points several searches go on side by side, of which
the worse half is given up, and again, until one is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inverse.prior import DRAWN, survey_points, thickened
from inverse.trials import EXACT, UNKNOWN, Judge, Trial
from treegraph import InputError

__all__ = ["Evolution", "EvolutionSettings", "Search", "evolve"]

FIRST_SIGMA = 0.4  # of the standard deviations that the guess comes with
SOFTEST, SOFT_SHARE = 5.0, 0.8  # softness at first, and share of the budget after which there is none
SURVEY = 0.1  # share of the budget
CHUNK = 30  # points of a survey that are looked at together, at most
SURVEY_KEPT = 16  # points of the survey that are measured by all samples
SEARCHES, HALVED = 4, (0.25, 0.4)  # side by side, and shares of the budget at which half of them are given up
APART = 0.1  # least distance of two searches' first points along the bounds, per root of the parameters
CLOSELY = 0.7  # share of the budget after which the better points of a generation have more trees than one
REMEMBERED = (0.7, 0.8, 0.9)  # shares of the budget at which the search's place is kept for the final choice
WORTH = 20  # a final choice is worth its trees if the budget is so many times those of one place
DUEL = 4  # how many times the samples points are compared by in the end


@dataclass(frozen=True)
class EvolutionSettings:
    """How the evolution strategy runs.

    Attributes
    ----------
    evaluations : int, default 6000
        Trees grown and compared; the generation that reaches it is the last.
    samples : int, default 4
        Trees by which the best points of the survey are compared, and towards the end those of a generation,
        4 or more. Before, each point has one: more points tell more than more trees of each.
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
class Search:
    """Where a search stands: the state of the strategy.

    Attributes
    ----------
    mean : (d,) float64
        Middle of the next generation; its reflection into the bounds is the result so far.
    sigma : float
        Overall step.
    covariance : (d, d) float64
    path_sigma, path_c : (d,) float64
        Evolution paths.
    generation : int
        Done so far.
    """

    mean: NDArray[np.float64]
    sigma: float = FIRST_SIGMA
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    path_sigma: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    path_c: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    generation: int = 0

    def __post_init__(self) -> None:
        n = self.mean.size
        if not self.covariance.size:
            self.covariance, self.path_sigma, self.path_c = np.eye(n), np.zeros(n), np.zeros(n)

    @property
    def point(self) -> NDArray[np.float64]:
        """The middle, inside the bounds."""
        return reflected(self.mean)


ARRAYS = ("mean", "covariance", "path_sigma", "path_c")


@dataclass
class Evolution:
    """Where an evolution stands; all that is needed to go on.

    Attributes
    ----------
    number : int
        Of the run, from 0.
    searches : list of Search
        Those that are still under way, the one that leads first. At the very beginning one, at the guess.
    spread : (d,) float64
        Standard deviations from which they began.
    found : list of (float, list of float) or None
        The nearest points of the survey so far, each with the distance of one tree; None: it is over.
    past : list of list of float
        Where the search was when some shares of the budget were spent.
    generation, evaluations : int
        Done so far, by all of them; chunks of the survey count as generations.
    curve : list of (int, float)
        Evaluations done, and mean distance of the best quarter of the generation.
    """

    number: int
    searches: list[Search]
    spread: NDArray[np.float64]
    found: list[tuple[float, list[float]]] | None = field(default_factory=list)
    past: list[list[float]] = field(default_factory=list)
    generation: int = 0
    evaluations: int = 0
    curve: list[tuple[int, float]] = field(default_factory=list)

    @property
    def point(self) -> NDArray[np.float64]:
        """The middle of the search that leads, inside the bounds."""
        return self.searches[0].point

    def to_dict(self) -> dict[str, Any]:
        """For a checkpoint; numbers are kept to the bit."""
        searches = [
            {name: getattr(search, name).tolist() for name in ARRAYS}
            | {"sigma": search.sigma, "generation": search.generation}
            for search in self.searches
        ]
        return {
            "number": self.number, "searches": searches, "spread": self.spread.tolist(),
            "found": None if self.found is None else [list(pair) for pair in self.found],
            "past": self.past, "generation": self.generation, "evaluations": self.evaluations,
            "curve": [list(pair) for pair in self.curve],
        }  # fmt: skip

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Evolution:
        """From a checkpoint.

        Raises
        ------
        InputError
            If something is missing, no number or out of its range.
        """
        try:
            searches = [
                Search(
                    **{name: np.array(found[name], np.float64) for name in ARRAYS},
                    sigma=float(found["sigma"]), generation=int(found["generation"]),
                )
                for found in values["searches"]
            ]  # fmt: skip
            if not searches:
                raise ValueError("no searches")
            curve = [(int(k), float(value)) for k, value in values["curve"]]
            found = values["found"]
            if found is not None:
                found = [(float(value), [float(x) for x in point]) for value, point in found]
            past = [[float(x) for x in point] for point in values["past"]]
            run = cls(
                int(values["number"]), searches, np.array(values["spread"], np.float64), found, past,
                int(values["generation"]), int(values["evaluations"]), curve,
            )  # fmt: skip
            _check_state(run)
            return run
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"the state of a run is damaged: {type(error).__name__} {error}") from None


def _check_state(run: Evolution) -> None:
    """Raise ValueError if arrays do not fit each other, or a number is out of its range."""
    n = run.spread.size
    counts = [run.number, run.generation, run.evaluations, *(search.generation for search in run.searches)]
    if min(counts) < 0:
        raise ValueError("a count is negative")
    for search in run.searches:
        for name in ARRAYS:
            array = getattr(search, name)
            if array.shape != ((n, n) if name == "covariance" else (n,)) or not np.isfinite(array).all():
                raise ValueError(f"{name} does not fit {n} parameters")
        if not 0.0 <= search.sigma < math.inf:
            raise ValueError("sigma is no number from 0 on")
    for point in [*run.past, *(point for _, point in run.found or [])]:
        if len(point) != n or not all(0.0 <= x <= 1.0 for x in point):
            raise ValueError(f"a point is not {n} numbers from 0 to 1")


def evolve(
    judge: Judge,
    settings: EvolutionSettings,
    run: Evolution,
    *,
    keep_going: Callable[[Evolution], bool] = lambda run: True,
    spent: Callable[[], float] = lambda: 0.0,
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
    spent : callable
        Share of the time, 0 to 1, if that is limited: what has to be done in time is not left to the number
        of evaluations.

    Returns
    -------
    run : Evolution
        The same.
    """
    if judge.samples != settings.samples:
        raise InputError(f"samples must be {settings.samples} as in the settings, got {judge.samples}")
    while run.evaluations < settings.evaluations:
        share = max(run.evaluations / settings.evaluations, spent())
        surveys = SURVEY * settings.evaluations >= settings.population
        if run.found is not None and share < SURVEY and surveys:
            _look_around(judge, settings, run)
        elif run.found is not None:
            _begin(judge, run)
        elif len(run.searches) > _wanted(share):
            _give_up(judge, run, share)
        else:
            enough = settings.evaluations >= WORTH * DUEL * settings.samples
            if enough and len(run.past) < sum(share >= at for at in REMEMBERED):
                run.past.append(run.point.tolist())
            _breed(judge, settings, run, share)
        if not keep_going(run):
            break
    if run.past and max(run.evaluations / settings.evaluations, spent()) >= 1.0:
        _finish(judge, run)
    return run


def soften(share: float) -> float:
    """Softness of the differences when so much of the budget is spent."""
    return float(SOFTEST ** max(0.0, 1.0 - share / SOFT_SHARE))


def _wanted(share: float) -> int:
    """How many searches go on when so much of the budget is spent."""
    return max(SEARCHES >> sum(share >= at for at in HALVED), 1)


def _look_around(judge: Judge, settings: EvolutionSettings, run: Evolution) -> None:
    """Some more points of the survey, one tree each; the nearest are remembered."""
    assert run.found is not None
    rng = np.random.default_rng([judge.seed, run.number, run.generation])
    n = min(CHUNK, max(int(SURVEY * settings.evaluations) // (DRAWN + 1), 2))
    guess = run.searches[0].mean
    points = survey_points(judge, guess, run.spread, n, rng)
    if run.generation == 0:
        points.append(guess)
    trials = [judge.trial(point, (run.number, 0), SOFTEST) for point in points]
    order = _nearest(judge, trials, list(range(len(trials))), 1, SURVEY_KEPT)[:SURVEY_KEPT]
    run.found += [(float(trials[k].low[0]), trials[k].point.tolist()) for k in order]
    run.found = sorted(run.found)[:SURVEY_KEPT]
    run.evaluations += DRAWN * n + len(trials)  # for their size, and to be compared
    run.generation += 1
    run.curve.append((run.evaluations, float(trials[order[0]].plain[0])))


def _begin(judge: Judge, run: Evolution) -> None:
    """Searches begin at the best points of the survey that are not too near each other."""
    found, run.found = run.found, None
    if not found:
        return
    trials = [judge.trial(np.array(point), (run.number, run.generation + 1), SOFTEST) for _, point in found]
    far = [judge.settle_all(trial) for trial in trials]
    chosen: list[NDArray[np.float64]] = []
    for k in np.argsort(far, kind="stable"):
        point = trials[k].point
        least = APART * math.sqrt(point.size)
        if len(chosen) < SEARCHES and all(np.linalg.norm(point - other) > least for other in chosen):
            chosen.append(point)
    run.searches = [Search(point) for point in chosen]
    run.evaluations += len(trials) * judge.samples
    run.generation += 1
    run.curve.append((run.evaluations, float(trials[int(np.argmin(far))].plain.mean())))


def _breed(judge: Judge, settings: EvolutionSettings, run: Evolution, share: float) -> None:
    """One generation of the search whose turn it is."""
    search = min(run.searches, key=lambda one: one.generation)
    rng = np.random.default_rng([judge.seed, run.number, run.generation])
    root = _root(search.covariance)
    steps = rng.standard_normal((settings.population, search.mean.size)) @ root.T
    points = search.mean + search.sigma * run.spread * steps
    key = (run.number, run.generation + 1)
    softness = soften(share)
    trials = [judge.trial(reflected(point), key, softness) for point in points]
    order, cost, best = rank(judge, trials, closely=share >= CLOSELY)
    run.evaluations += cost
    run.curve.append((run.evaluations, best))
    _adapt(search, run.spread, steps[order], root)
    run.generation += 1


def _give_up(judge: Judge, run: Evolution, share: float) -> None:
    """Compare the searches by the same new trees, and leave the farther ones."""
    for search in run.searches:
        search.mean = thickened(judge, search.point, (run.number, run.generation + 1))
    order, _ = _duel(judge, run, [search.mean for search in run.searches], soften(share))
    run.searches = [run.searches[k] for k in order[: _wanted(share)]]


def _finish(judge: Judge, run: Evolution) -> None:
    """The result is the best of where the search was at the end and some time before."""
    points = [run.point, *(np.array(point) for point in run.past)]
    (best, *_), nearest = _duel(judge, run, points, 1.0)
    run.past = []
    run.curve.append((run.evaluations, nearest))
    if best > 0:
        run.searches[0] = Search(points[best])


def _duel(
    judge: Judge, run: Evolution, points: list[NDArray[np.float64]], softness: float
) -> tuple[list[int], float]:
    """The order of points by the same new trees, the nearest first, and its mean distance."""
    far = []
    for point in points:
        keys = [(run.number, run.generation + 1, k) for k in range(1, 1 + DUEL)]
        far.append(sum(judge.settle_all(judge.trial(point, key, softness)) for key in keys))
    run.evaluations += len(points) * DUEL * judge.samples
    return [int(k) for k in np.argsort(far, kind="stable")], min(far) / (DUEL * judge.samples)


def rank(judge: Judge, trials: list[Trial], *, closely: bool = False) -> tuple[list[int], int, float]:
    """Order of trials, the nearest first; how many trees that took; and mean distance of the best quarter.

    By one tree each: the better half is in order, of the others no more is found than that they are farther.
    Closely: then the better half by half of the samples, and the best quarter by all of them.
    """
    half, quarter = len(trials) // 2, math.ceil(len(trials) / 4)
    order = _nearest(judge, trials, list(range(len(trials))), 1, half)
    cost, seen = len(trials), 1
    if closely:
        for n, seen in ((half, max(judge.samples // 2, 1)), (quarter, judge.samples)):
            before = int(sum((trials[k].known[:seen] == UNKNOWN).sum() for k in order[:n]))
            order = _nearest(judge, trials, order[:n], seen, n) + order[n:]
            cost += before
    best = order[:quarter]
    return order, cost, float(np.mean([trials[k].plain[:seen].mean() for k in best]))


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


def _adapt(
    search: Search, spread: NDArray[np.float64], steps: NDArray[np.float64], root: NDArray[np.float64]
) -> None:
    """One update of mean, step and covariance from steps in order; the constants are the tutorial's."""
    n, population = search.mean.size, len(steps)
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
    search.mean = search.mean + search.sigma * spread * step
    whitened = np.linalg.solve(root, step)
    search.path_sigma = (1.0 - c_sigma) * search.path_sigma + math.sqrt(
        c_sigma * (2.0 - c_sigma) * effective
    ) * whitened
    length = float(np.linalg.norm(search.path_sigma))
    fading = math.sqrt(1.0 - (1.0 - c_sigma) ** (2 * (search.generation + 1)))
    small = length / fading < (1.4 + 2.0 / (n + 1.0)) * expected
    search.path_c = (1.0 - c_c) * search.path_c + small * math.sqrt(c_c * (2.0 - c_c) * effective) * step
    rank_one = np.outer(search.path_c, search.path_c) + (not small) * c_c * (2.0 - c_c) * search.covariance
    rank_mu = (weights[:, None] * chosen).T @ chosen
    search.covariance = (1.0 - c_1 - c_mu) * search.covariance + c_1 * rank_one + c_mu * rank_mu
    search.sigma = min(search.sigma * math.exp(c_sigma / d_sigma * (length / expected - 1.0)), 2.0)
