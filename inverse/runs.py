"""The runs of a fit, whichever their method: where one begins, going on with it, and many side by side.

A run is a state that can go on from wherever it was written down and ends with the same bits. So it can be
done in slices, each by whoever has time: a thread, a process, a machine of a cluster.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from time import monotonic
from typing import Any

from inverse.annealing import AnnealingSettings, Chain, anneal, start_chain
from inverse.distance import Weights
from inverse.evolution import Evolution, EvolutionSettings, Search, evolve
from inverse.prior import first_point
from inverse.space import SearchSpace
from inverse.trials import Judge
from treegraph import InputError, TreeGraph

__all__ = [
    "METHODS",
    "Task",
    "Time",
    "advance",
    "check_settings",
    "evaluations_of",
    "first_state",
    "go_on",
    "restored",
    "share_done",
    "spread_runs",
]

METHODS = {"annealing": AnnealingSettings, "evolution": EvolutionSettings}
NOT_YET = 0.999  # the share of a run that has yet to choose its result
SLICE_SECONDS = 3.0  # for which a run goes on elsewhere before it reports


def check_settings(method: str, settings: Any) -> Any:
    """The settings of a method, its defaults if there are none.

    Raises
    ------
    InputError
        If there is no such method, or the settings are those of another one.
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    settings = METHODS[method]() if settings is None else settings
    if not isinstance(settings, METHODS[method]):
        raise InputError(
            f"settings must be {METHODS[method].__name__} with method {method!r}, got {settings!r}"
        )
    return settings


def first_state(settings: Any, judge: Judge, number: int) -> Chain | Evolution:
    """Where run `number` begins."""
    if isinstance(settings, AnnealingSettings):
        return start_chain(judge, number)
    mean, spread = first_point(judge.space, judge.targets)
    return Evolution(number, [Search(mean)], spread)


def restored(settings: Any, values: dict[str, Any]) -> Chain | Evolution:
    """A state from what :meth:`to_dict` made of it.

    Raises
    ------
    InputError
        If it is damaged.
    """
    return (Chain if isinstance(settings, AnnealingSettings) else Evolution).from_dict(values)


def share_done(settings: Any, state: Any) -> float:
    """Share of a run that is done, 0 to 1."""
    if isinstance(settings, AnnealingSettings):
        return float(state.iteration / settings.iterations)
    done = min(state.evaluations / settings.evaluations, 1.0)
    return float(min(done, NOT_YET) if state.past else done)


def evaluations_of(settings: Any, state: Any) -> int:
    """Trees that a run has asked for."""
    if isinstance(settings, AnnealingSettings):
        return int((state.iteration + 1) * settings.samples)
    return int(state.evaluations)


def go_on(
    judge: Judge,
    settings: Any,
    state: Any,
    keep_going: Callable[[Any], bool],
    spent: Callable[[], float],
) -> None:
    """Go on with a run until it is done or told to stop; ``state`` is changed.

    ``spent`` tells which share of the time is over, if that is limited.
    """
    if isinstance(settings, AnnealingSettings):
        anneal(judge, settings, state, keep_going=keep_going)
    else:
        evolve(judge, settings, state, keep_going=keep_going, spent=spent)


@dataclass(frozen=True, eq=False)
class Task:
    """All that a run needs wherever it is done; it can be pickled.

    Attributes
    ----------
    trees : tuple of TreeGraph
        The targets, without attributes that a fit does not look at.
    space : SearchSpace
    settings : AnnealingSettings or EvolutionSettings
    seed : int
    weights : Weights
    tip_share : float
        Unless it is searched.
    workers : int
        Threads for one run.
    """

    trees: tuple[TreeGraph, ...]
    space: SearchSpace
    settings: Any
    seed: int
    weights: Weights
    tip_share: float
    workers: int = 1


@dataclass(frozen=True)
class Time:
    """What a fit has of it.

    Attributes
    ----------
    total, left : float
        Seconds; infinite without a limit.
    """

    total: float = math.inf
    left: float = math.inf

    def spent(self, since: float) -> float:
        """Share that is over at :func:`time.monotonic` now, if ``left`` was that at ``since``."""
        if math.isinf(self.total):
            return 0.0
        if not self.total > 0.0:
            return 1.0
        return min(max(1.0 - (self.left - (monotonic() - since)) / self.total, 0.0), 1.0)


def advance(
    task: Task, state: dict[str, Any], seconds: float, time: Time = Time()
) -> tuple[dict[str, Any], int, int]:
    """Go on with a run for some seconds, at least one step.

    Parameters
    ----------
    task : Task
    state : dict
        As :meth:`to_dict` made it.
    seconds : float
    time : Time
        Of the whole fit.

    Returns
    -------
    state : dict
    grown, compared : int
        Trees grown for it, and of these compared to the end.
    """
    start = monotonic()
    known = restored(task.settings, state)
    with Judge(
        task.trees, task.space, samples=task.settings.samples, seed=task.seed, weights=task.weights,
        workers=task.workers, tip_share=task.tip_share,
    ) as judge:  # fmt: skip
        go_on(judge, task.settings, known, lambda _: monotonic() - start < seconds, lambda: time.spent(start))
    return known.to_dict(), judge.grown, judge.compared


def spread_runs(
    executor: Executor,
    task: Task,
    states: list[Any],
    time: Time,
    told: Callable[[int], None],
) -> tuple[int, int]:
    """Go on with all runs side by side, slice by slice, until they are done or the time is over.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        What is handed to it is :func:`advance` and its arguments.
    task : Task
    states : list of Chain or Evolution
        Replaced by newer ones as these come in.
    time : Time
        What is under way when it is over still ends, which takes a slice at most.
    told : callable
        Called with the number of a run of which there is news.

    Returns
    -------
    grown, compared : int
    """
    grown = compared = 0
    under_way: dict[Future[Any], int] = {}
    start = monotonic()

    def hand_out(k: int) -> None:
        left = time.left - (monotonic() - start)
        seconds = min(SLICE_SECONDS, left)
        if seconds > 0.0 and share_done(task.settings, states[k]) < 1.0:
            under_way[
                executor.submit(advance, task, states[k].to_dict(), seconds, Time(time.total, left))
            ] = k

    try:
        for k in range(len(states)):
            hand_out(k)
        while under_way:
            for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                k = under_way.pop(future)
                values, more_grown, more_compared = future.result()
                states[k] = restored(task.settings, values)
                grown, compared = grown + more_grown, compared + more_compared
                told(k)
                hand_out(k)
    finally:
        for future in under_way:
            future.cancel()
    return grown, compared
