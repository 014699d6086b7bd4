"""How far the trees that grow at a point of the search space are from the targets, as exactly as needed.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 5.4 (Eq. 9). Departs from it in: a distance is known by bounds first, and exactly when a decision
needs it. Several targets count by their mean. Trees that outgrow the node limit are as far away as can be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from inverse import geometry, shape
from inverse.comparing import minkowski_mean
from inverse.distance import EQUAL_WEIGHTS, Description, Weights, describe_tree
from inverse.pieces import cut_into_pieces
from inverse.space import SearchSpace
from inverse.structure import bounds_of, distance_of
from treegraph import ClusterTree, InputError, TreeGraph

if TYPE_CHECKING:
    from species import GrowthSettings

__all__ = ["Judge", "Trial", "is_no_farther"]

UNKNOWN, BOUNDED, EXACT = 0, 1, 2
"""What is known of a sample: nothing, its tree with bounds of its distance, its distance."""

ROUNDING = 1e-9  # sums closer than this are compared by their exact values
PIECE_NODES = 4  # a target counts as no more nodes than that for each piece, however finely it is sampled
NODE_FACTOR, NODE_ROOM = 3, 200  # times the largest target's nodes that a grown tree may have, and some


@dataclass(eq=False)
class Trial:
    """A point, and what is known of the trees that grow there.

    Attributes
    ----------
    point : (d,) float64
        Of the search space.
    key : tuple of int
        From which, and the number of the sample, each tree's randomness follows.
    low, high : (samples,) float64
        Bounds of D_T of each sample; equal where it is known.
    known : (samples,) uint8
        UNKNOWN, BOUNDED or EXACT.
    softness : float
        Of the differences in shape and geometry, see :func:`inverse.comparing.differences`; 1 is D_T.
    plain : (samples,) float64
        D_T itself of the samples that are known, whatever the softness.
    """

    point: NDArray[np.float64]
    key: tuple[int, ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    known: NDArray[np.uint8]
    softness: float
    plain: NDArray[np.float64]
    _kept: dict[int, Any] = field(default_factory=dict)

    @property
    def is_exact(self) -> bool:
        """Whether every sample's distance is known."""
        return bool((self.known == EXACT).all())

    @property
    def total(self) -> float:
        """Sum of the distances, in the order of the samples; of what is known exactly only."""
        return float(self.low.sum())


@dataclass(frozen=True)
class Size:
    """Of a tree: height (m), length times thickness of its pieces (m2), and how many these are."""

    height: float
    wood: float
    pieces: int


class Judge:
    """Measures trials against target trees.

    Parameters
    ----------
    targets : sequence of TreeGraph, ClusterTree or Description
        At least one; each with length.
    space : SearchSpace
    samples : int
        Trees grown per trial, 1 or more: eight in the paper.
    seed : int
    weights : Weights
    workers : int
        Threads; the results do not depend on them.
    max_nodes : int, optional
        Where growth is stopped. By default three times the nodes of the largest target, and 200; of a finely
        sampled one four nodes for each branch between forks count.
    tip_share : float
        How thick wood is, see :class:`species.GrowthSettings`.

    Raises
    ------
    InputError
        If there is no target, one cannot be compared, or has no length; or a number is out of its range.
    """

    def __init__(
        self,
        targets: Sequence[TreeGraph | ClusterTree | Description],
        space: SearchSpace,
        *,
        samples: int = 8,
        seed: int = 0,
        weights: Weights = EQUAL_WEIGHTS,
        workers: int = 1,
        max_nodes: int | None = None,
        tip_share: float = 0.01,
    ) -> None:
        from species import GrowthSettings

        if not targets:
            raise InputError("a fit must have at least one tree, got none")
        if samples < 1 or workers < 1:
            raise InputError(f"samples and workers must be 1 or more, got {samples!r} and {workers!r}")
        self.targets = tuple(describe_tree(tree) for tree in targets)
        for k, target in enumerate(self.targets):
            if not float(target.pieces.length.sum()) > 0.0:
                raise InputError(f"a tree to fit must have some length, but tree {k} has none")
        self.space, self.samples, self.seed, self.weights = space, samples, seed, weights
        largest = max(
            min(target.pieces.graph.n_nodes, PIECE_NODES * target.pieces.n_pieces) for target in self.targets
        )
        self.settings = GrowthSettings(
            max_nodes=max_nodes or NODE_FACTOR * largest + NODE_ROOM, tip_share=tip_share
        )
        self.grown = self.compared = 0
        self._pool = ThreadPoolExecutor(workers) if workers > 1 else None
        self.workers = workers

    def __enter__(self) -> Judge:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown()

    def settings_at(self, point: NDArray[np.float64]) -> GrowthSettings:
        """How trees grow at a point, beside its parameters."""
        share = self.space.tip_share(point)
        return self.settings if share is None else replace(self.settings, tip_share=share)

    def trial(self, point: NDArray[np.float64], key: tuple[int, ...], softness: float = 1.0) -> Trial:
        """A trial of which nothing is known yet."""
        n = self.samples
        return Trial(point, key, np.zeros(n), np.ones(n), np.zeros(n, np.uint8), softness, np.ones(n))

    def bound(self, wanted: Iterable[tuple[Trial, int]]) -> None:
        """Grow trees of some trials' samples; their shape and geometry, once found, bound their distance."""
        todo = [(trial, j) for trial, j in wanted if trial.known[j] == UNKNOWN]
        for (trial, j), found in zip(todo, self._map(self._grow, todo), strict=True):
            trial.low[j], trial.high[j], kept = found
            trial.known[j] = EXACT if kept is None else BOUNDED
            trial._kept[j] = kept
        self.grown += len(todo)

    def settle(self, wanted: Iterable[tuple[Trial, int]]) -> None:
        """Find the distances of some trials' samples exactly, side by side."""

        def work(item: tuple[Trial, int]) -> tuple[float, float, bool]:
            trial, j = item
            if trial.known[j] == BOUNDED:
                return *self._compare(trial._kept[j]), True
            distance, _, kept = self._grow(item)
            return (distance, distance, False) if kept is None else (*self._compare(kept), True)

        todo = [(trial, j) for trial, j in wanted if trial.known[j] != EXACT]
        for (trial, j), (distance, plain, compared) in zip(todo, self._map(work, todo), strict=True):
            self.grown += int(trial.known[j] == UNKNOWN)
            self.compared += int(compared)
            trial.low[j] = trial.high[j] = distance
            trial.plain[j] = plain
            trial.known[j] = EXACT
            trial._kept.pop(j, None)

    def sizes(self, points: Sequence[NDArray[np.float64]], key: tuple[int, ...]) -> list[Size]:
        """Size of a tree at each point; all 0 if it outgrows the limit."""
        from species import grow
        from species.growth import GROWN

        def work(point: NDArray[np.float64]) -> Size:
            parameters, age = self.space.decode(point)
            rng = np.random.default_rng([self.seed, *key])
            tree = grow(parameters, age, rng=rng, settings=self.settings_at(point))
            if tree.status != GROWN:
                return Size(0.0, 0.0, 0)
            pieces = cut_into_pieces(tree.tree)
            return Size(tree.height, float(pieces.length @ pieces.thickness), pieces.n_pieces)

        self.grown += len(points)
        return self._map(work, points)

    def settle_all(self, trial: Trial) -> float:
        """Sum of all samples' distances."""
        self.settle((trial, j) for j in range(self.samples))
        return trial.total

    def mean_distance(self, trial: Trial) -> float:
        """Mean of all samples' distances, 0 to 1."""
        return self.settle_all(trial) / self.samples

    def _map(self, work: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        if self._pool is None or len(items) < 2:
            return [work(item) for item in items]
        return list(self._pool.map(work, items))

    def _grow(self, item: tuple[Trial, int]) -> tuple[float, float, Any]:
        """Bounds of a sample's distance, and what is needed to find it; None if it is known."""
        from species import grow
        from species.growth import GROWN

        trial, j = item
        parameters, age = self.space.decode(trial.point)
        rng = np.random.default_rng([self.seed, *trial.key, j])
        tree = grow(parameters, age, rng=rng, settings=self.settings_at(trial.point))
        if tree.status != GROWN:
            return 1.0, 1.0, None
        found = describe_tree(tree.tree)
        partial, plain = np.empty(len(self.targets)), np.empty(len(self.targets))
        low, high = 0.0, 0.0
        for k, target in enumerate(self.targets):
            plain[k] = partial[k] = self._partial(target, found, 1.0)
            if trial.softness != 1.0:
                partial[k] = self._partial(target, found, trial.softness)
            least, most = bounds_of(target.edit, found.edit)
            low += partial[k] + self.weights.structure * least
            high += partial[k] + self.weights.structure * most
        n = len(self.targets)
        return low / n, high / n, (partial, plain, found)

    def _partial(self, target: Description, found: Description, softness: float) -> float:
        """What shape and geometry have in the distance."""
        return self.weights.mean(
            minkowski_mean(shape.compare_descriptors(target.shape, found.shape, softness)),
            minkowski_mean(geometry.compare_descriptors(target.geometry, found.geometry, softness)),
            0.0,
        )

    def _compare(
        self, kept: tuple[NDArray[np.float64], NDArray[np.float64], Description]
    ) -> tuple[float, float]:
        partial, plain, found = kept
        total, true = 0.0, 0.0
        for part, other, target in zip(partial, plain, self.targets, strict=True):
            structure = self.weights.structure * distance_of(target.edit, found.edit)
            total += float(part) + structure
            true += float(other) + structure
        return total / len(self.targets), true / len(self.targets)


def is_no_farther(judge: Judge, trial: Trial, current: Trial, slack: float) -> bool:
    """Whether the sum of a trial's distances is at most that of the current one and some slack.

    The answer is that of comparing the exact sums; as little as possible is computed for it.

    Parameters
    ----------
    judge : Judge
    trial, current : Trial
    slack : float
        >= 0.

    Notes
    -----
    First the trial's trees are grown, sample by sample, which bounds their distances; then the current
    point's, whose distances serve the next decisions too, are made exact, then the trial's.
    """
    steps = [
        *((judge.bound, trial, j) for j in range(judge.samples)),
        *((judge.settle, current, j) for j in range(judge.samples)),
        *((judge.settle, trial, j) for j in range(judge.samples)),
    ]
    width = judge.workers
    for refine, which, first in steps:
        if first % width:
            continue
        least = trial.low.sum() - current.high.sum() - slack
        most = trial.high.sum() - current.low.sum() - slack
        if most < -ROUNDING:
            return True
        if least > ROUNDING:
            return False
        refine((which, j) for j in range(first, min(first + width, judge.samples)))
    return judge.settle_all(trial) <= judge.settle_all(current) + slack
