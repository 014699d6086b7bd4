"""From trees to the growth parameters whose trees resemble them.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
sections 5.4 and 6. Departs from it in: the default is another optimiser (:mod:`inverse.evolution`), the
paper's is ``method="annealing"``; several runs of either tell how far apart they end; a run can be stopped
and go on.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inverse.annealing import AnnealingSettings
from inverse.distance import EQUAL_WEIGHTS, Description, Weights, compare_trees, describe_tree
from inverse.evolution import EvolutionSettings
from inverse.pieces import cut_into_pieces
from inverse.prior import OWN_SHARE, guess_parameters, guess_tip_share, thickened
from inverse.runs import (
    Task,
    Time,
    check_settings,
    evaluations_of,
    first_state,
    go_on,
    restored,
    share_done,
    spread_runs,
)
from inverse.space import AGE, TIP, search_space
from inverse.trials import Judge
from treegraph import ClusterTree, InputError, TreeGraph

__all__ = ["Fit", "Progress", "fit_trees"]

VERSION = 2  # of the checkpoint
CHECK_SEED = 1_000_003  # what is added to the seed for the trees by which the runs are compared in the end
CHECK_SAMPLES = 16
CHECKPOINT_SECONDS = 10.0
MOST_PIECES = 4000
TIP_REACH = 8.0  # factor below and above the guess within which the radius of a tip is searched
AS_MANY_AS_TIME_ALLOWS = 10**9  # evaluations

DONE, STOPPED = "done", "stopped"
"""What :attr:`Fit.status` can be."""


@dataclass(frozen=True)
class Progress:
    """How far a fit is.

    Attributes
    ----------
    run, runs : int
        Which of them, from 0, and how many.
    share : float
        Done of this run, 0 to 1.
    distance : float
        Mean distance as last found.
    """

    run: int
    runs: int
    share: float
    distance: float


@dataclass(frozen=True, eq=False)
class Fit:
    """Growth parameters that were fitted to trees.

    Attributes
    ----------
    parameters : GrowthParameters
    age : int
        Growth cycles.
    distance, shape, geometry, structure : float
        Means over new trees grown from them, and over the targets; 0 to 1.
    distances : tuple of float
        D_T of the result of each run, found in the same way.
    runs : tuple of dict
        Values of each run by symbol, ``"t"`` among them; the first run's first.
    spread : dict of float
        Standard deviation over the runs of every parameter that was free; NaN of a single run.
    curves : tuple of list of (int, float)
        Of each run: evaluations, and mean distance then (figure 11).
    evaluations : int
        Trees that the method asked for, 8 per point in the paper.
    grown, compared : int
        Trees grown, and of these compared to the end: what did not matter was left out.
    status : str
        ``"done"``, or ``"stopped"`` if time ran out.
    tip_share : float
        How thick their wood is; trees are to be grown with the same.
    """

    parameters: Any
    age: int
    distance: float
    shape: float
    geometry: float
    structure: float
    distances: tuple[float, ...]
    runs: tuple[dict[str, float], ...]
    spread: dict[str, float]
    curves: tuple[list[tuple[int, float]], ...]
    evaluations: int
    grown: int
    compared: int
    status: str
    tip_share: float

    def __repr__(self) -> str:
        return (
            f"<Fit {self.distance:.4f} after {self.age} cycles, {len(self.runs)} runs, "
            f"{self.evaluations} evaluations, {self.status}>"
        )


def fit_trees(
    trees: Sequence[TreeGraph | ClusterTree],
    *,
    method: str = "evolution",
    settings: AnnealingSettings | EvolutionSettings | None = None,
    runs: int = 1,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    fixed: Mapping[str, float] | None = None,
    weights: Weights = EQUAL_WEIGHTS,
    tip_share: float | None = None,
    seed: int = 0,
    workers: int = 1,
    executor: Executor | None = None,
    seconds: float | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Fit:
    """Find growth parameters whose trees resemble the given ones, Eq. 9 of [1]_.

    Parameters
    ----------
    trees : sequence of TreeGraph or ClusterTree
        One tree, or several of one kind; one root each, radii known.
    method : {"evolution", "annealing"}
        The default, or the one of the paper.
    settings : EvolutionSettings or AnnealingSettings, optional
        Of the method; the number of evaluations among them.
    runs : int, default 1
        From different random numbers; the best one is the result, their spread says how sure a parameter is.
    bounds, fixed : mapping, optional
        As in :func:`inverse.space.search_space`.
    weights : Weights
        Of shape, geometry and structure.
    tip_share : float, optional
        How thick wood is: radius of a tip as a share of the internode length, 0.0005 to 0.2. By default 0.01,
        the growth model's own, unless :func:`inverse.guess_tip_share` sees other wood: then it is searched.
    seed : int
    workers : int, default 1
        Threads of each run. The result does not depend on it.
    executor : concurrent.futures.Executor, optional
        The runs are spread over it, side by side; without one they are done here, one after the other. It may
        be of processes or of a cluster (``distributed.Client(address).get_executor()``), whose workers must
        have Sapwood too. The result does not depend on it.
    seconds : float, optional
        Time after which the fit stops with what it has; runs that are done one after the other share it
        evenly. Where it stops depends on the machine. Without `settings` the default method uses all of it.
    checkpoint : path, optional
        A file in which the state is kept, every 10 s and at each run's end. If it is there, the fit goes on
        from it and ends as if it had never stopped. It is left there.
    progress : callable, optional
        Told after every iteration or generation; of runs on an executor every few seconds.

    Returns
    -------
    fit : Fit

    Raises
    ------
    InputError
        If a tree cannot be compared, has no length or more than 4000 branches between forks, an argument is
        out of its range, or the checkpoint is damaged, of another fit or cannot be written.

    References
    ----------
    .. [1] O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014.
    """
    if runs < 1:
        raise InputError(f"runs must be 1 or more, got {runs!r}")
    targets = [_target(tree, k) for k, tree in enumerate(trees)]
    if settings is None and seconds is not None and method == "evolution":
        settings = EvolutionSettings(evaluations=AS_MANY_AS_TIME_ALLOWS)
    settings = check_settings(method, settings)
    height = max((_height(target) for target in targets), default=0.0)
    if not height > 0.0:
        raise InputError("a tree to fit must have some height, got none")
    tip_radius = _tip_bounds(targets) if tip_share is None else None
    space = search_space(height, bounds=bounds, fixed=fixed, tip_radius=tip_radius)
    tip_share = OWN_SHARE if tip_share is None else tip_share
    with Judge(
        targets, space, samples=settings.samples, seed=seed, weights=weights, workers=workers,
        tip_share=tip_share,
    ) as judge:  # fmt: skip
        keeper = _Keeper(checkpoint, _name_of(method, settings, judge, runs))
        states = keeper.load(settings, space.n_free) or [first_state(settings, judge, k) for k in range(runs)]
        clock = _Clock(seconds, runs)

        def tell(k: int) -> None:
            keeper.save_now_and_then(states)
            if progress is not None:
                state = states[k]
                distance = state.curve[-1][1] if state.curve else 1.0
                progress(Progress(k, runs, clock.share(k, share_done(settings, state)), distance))

        if executor is None:
            for k, state in enumerate(states):
                _run(judge, settings, state, clock.of(k), partial(tell, k))
        else:
            graphs = tuple(_bare(target.pieces.graph) for target in targets)
            task = Task(graphs, space, settings, seed, weights, tip_share, workers)
            grown, compared = spread_runs(executor, task, states, clock.of_all(), tell)
            judge.grown, judge.compared = judge.grown + grown, judge.compared + compared
        keeper.save(states)
        return _conclude(judge, settings, states, targets)


def _target(tree: TreeGraph | ClusterTree, k: int) -> Description:
    """A tree described, unless it is too large to be compared thousands of times."""
    pieces = cut_into_pieces(tree)
    if pieces.n_pieces > MOST_PIECES:
        raise InputError(
            f"a tree to fit must have at most {MOST_PIECES} branches between forks, but tree {k} has "
            f"{pieces.n_pieces}; leave its thinnest ones out (--branches, inverse.thin_out)"
        )
    return describe_tree(pieces)


def _tip_bounds(targets: Sequence[Description]) -> tuple[float, float] | None:
    """Where the radius of a tip is searched; None if it is the growth model's own."""
    share = guess_tip_share(targets)
    if share == OWN_SHARE:
        return None
    radius = share * guess_parameters(targets)["IBL"]
    return radius / TIP_REACH, radius * TIP_REACH


def _bare(tree: TreeGraph) -> TreeGraph:
    """A tree without its attributes."""
    return TreeGraph(tree.parent, tree.position, tree.radius)


def _height(target: Description) -> float:
    """Extent of a tree: its height, or what it has instead if it hangs or lies."""
    return float(np.ptp(target.pieces.graph.position, axis=0).max())


def _run(judge: Judge, settings: Any, state: Any, time: Time, tell: Callable[[], None]) -> None:
    """Go on with one run until it is done or its time is over."""
    start = monotonic()
    if time.left <= 0.0 or share_done(settings, state) >= 1.0:
        return

    def keep_going(_: Any) -> bool:
        tell()
        return monotonic() - start < time.left

    go_on(judge, settings, state, keep_going, lambda: time.spent(start))


class _Clock:
    """Shares a time among runs; what one leaves the next ones get."""

    def __init__(self, seconds: float | None, runs: int) -> None:
        if seconds is not None and not 0.0 <= seconds < np.inf:
            raise InputError(f"seconds must be a finite number >= 0, got {seconds!r}")
        self._seconds = np.inf if seconds is None else seconds
        self._start, self._runs = monotonic(), runs
        self._begun: dict[int, tuple[Time, float]] = {}

    def of_all(self) -> Time:
        """The time of all runs that go on side by side."""
        now = monotonic()
        time = Time(self._seconds, self._seconds - (now - self._start))
        self._begun = dict.fromkeys(range(self._runs), (time, now))
        return time

    def of(self, k: int) -> Time:
        """The time of run k, which begins now; the runs after it will have as much."""
        now = monotonic()
        left = (self._seconds - (now - self._start)) / (self._runs - k)
        self._begun[k] = Time(max(left, 0.0), left), now
        return self._begun[k][0]

    def share(self, k: int, done: float) -> float:
        """How far run k is: by what is done, or by its time."""
        time, since = self._begun[k]
        return max(done, time.spent(since))


class _Keeper:
    """Keeps the state of a fit in a file that appears whole or not at all."""

    def __init__(self, path: str | os.PathLike[str] | None, name: dict[str, Any]) -> None:
        self._path = None if path is None else Path(path)
        self._name = name
        self._last = monotonic()

    def load(self, settings: Any, n_free: int) -> list[Any] | None:
        """The states of the runs, None if there is no file yet.

        Raises
        ------
        InputError
            If it cannot be read or written, is damaged, or of another fit; before any work is done.
        """
        if self._path is None:
            return None
        self._check_place(self._path)
        if not self._path.exists():
            return None
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
            name, runs = found["fit"], list(found["runs"])
        except OSError as error:
            raise InputError(f"{self._path}: the file cannot be read ({error.strerror}).") from None
        except (ValueError, KeyError, TypeError, RecursionError):
            raise InputError(f"{self._path}: this is no checkpoint of a fit; remove it.") from None
        if name != json.loads(json.dumps(self._name)):
            raise InputError(
                f"{self._path}: this checkpoint is of a fit of other trees or settings; remove it, or name "
                "another."
            )
        try:
            states = [restored(settings, state) for state in runs]
        except InputError as error:
            raise InputError(f"{self._path}: {error}; remove it.") from None
        if [(state.number, len(state.point)) for state in states] != [
            (k, n_free) for k in range(self._name["runs"])
        ]:
            raise InputError(
                f"{self._path}: the runs of this checkpoint are not those of its fit; remove it."
            )
        return states

    @staticmethod
    def _check_place(path: Path) -> None:
        """Whether a file can be made there; better known now than when there is something to keep."""
        try:
            with tempfile.TemporaryFile(dir=path.parent):
                pass
        except OSError as error:
            raise InputError(f"{path}: cannot write here ({error.strerror}); name another place.") from None

    def save_now_and_then(self, states: list[Any]) -> None:
        """Save if the last time is long enough ago."""
        if self._path is not None and monotonic() - self._last >= CHECKPOINT_SECONDS:
            self.save(states)

    def save(self, states: list[Any]) -> None:
        """Write the file."""
        if self._path is None:
            return
        from treegraph._files import write_whole

        said = {"fit": self._name, "runs": [state.to_dict() for state in states]}
        write_whole(self._path, json.dumps(said).encode())
        self._last = monotonic()


def _name_of(method: str, settings: Any, judge: Judge, runs: int) -> dict[str, Any]:
    """What tells one fit from another; one that goes on has the same."""
    import hashlib

    digest = hashlib.sha256()
    for target in judge.targets:
        graph = target.pieces.graph
        for array in (graph.parent, graph.position, graph.radius):
            digest.update(np.ascontiguousarray(array).tobytes())
    ranges = [[d.symbol, d.low, d.high, d.scale] for d in judge.space.dimensions]
    return {
        "version": VERSION, "method": method, "settings": asdict(settings), "trees": digest.hexdigest(),
        "space": ranges, "weights": asdict(judge.weights), "seed": judge.seed, "runs": runs,
        "tip_share": judge.settings.tip_share,
    }  # fmt: skip


def _conclude(judge: Judge, settings: Any, states: list[Any], targets: Sequence[Description]) -> Fit:
    """Compare the runs by new trees, and say what was found."""
    points = [np.asarray(state.point, np.float64) for state in states]
    check = Judge(
        targets, judge.space, samples=CHECK_SAMPLES, seed=judge.seed + CHECK_SEED, weights=judge.weights,
        max_nodes=judge.settings.max_nodes, tip_share=judge.settings.tip_share,
    )  # fmt: skip
    points = [thickened(check, point, (1, 0)) for point in points]
    distances = tuple(check.mean_distance(check.trial(point, (0,))) for point in points)
    best = int(np.argmin(distances))
    parameters, age = judge.space.decode(points[best])
    values = []
    for point in points:
        kind, years = judge.space.decode(point)
        more = {d.symbol: d.value(x) for d, x in zip(judge.space.free, point, strict=True) if d.symbol == TIP}
        values.append(kind.symbols() | {AGE: float(years)} | more)
    spread = {
        d.symbol: float(np.std([v[d.symbol] for v in values], ddof=1)) if len(values) > 1 else float("nan")
        for d in judge.space.free
    }
    finished = all(share_done(settings, state) >= 1.0 for state in states)
    return Fit(
        parameters, age, *_parts(check, points[best], targets), distances, tuple(values), spread,
        tuple(_curve(settings, state) for state in states),
        sum(evaluations_of(settings, state) for state in states), judge.grown, judge.compared,
        DONE if finished else STOPPED, judge.settings_at(points[best]).tip_share,
    )  # fmt: skip


def _curve(settings: Any, state: Any) -> list[tuple[int, float]]:
    """Evaluations and distances; annealing counts iterations."""
    factor = settings.samples if isinstance(settings, AnnealingSettings) else 1
    return [(factor * count, distance) for count, distance in state.curve]


def _parts(
    check: Judge, point: NDArray[np.float64], targets: Sequence[Description]
) -> tuple[float, float, float, float]:
    """Mean distance and its three parts over new trees; those that outgrow the limit count as 1."""
    from species import grow
    from species.growth import GROWN

    parameters, age = check.space.decode(point)
    rows = []
    for j in range(check.samples):
        rng = np.random.default_rng([check.seed, 0, j])
        tree = grow(parameters, age, rng=rng, settings=check.settings_at(point))
        for target in targets:
            if tree.status != GROWN:
                rows.append((1.0, 1.0, 1.0, 1.0))
                continue
            found = compare_trees(target, tree.tree, weights=check.weights)
            rows.append((found.distance, found.shape, found.geometry, found.structure))
    mean = np.mean(rows, axis=0)
    return float(mean[0]), float(mean[1]), float(mean[2]), float(mean[3])
