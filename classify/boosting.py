r"""Joint boosting: several two-class problems boosted together, so that they can share their features.

Based on: A. Torralba, K. P. Murphy, W. T. Freeman, "Sharing visual features for multiclass and multiview
object detection", IEEE Transactions on Pattern Analysis and Machine Intelligence 29(5), 2007; and for the
form of boosting (GentleBoost) J. Friedman, T. Hastie, R. Tibshirani, "Additive logistic regression: a
statistical view of boosting", Annals of Statistics 28(2), 2000.

With z = 1 for a sample of class c and -1 for all others, the loss is the mean of :math:`e^{-z H(v, c)}` over
samples v and classes c. A round adds to H the stump h that leaves the least weighted squared error
:math:`\sum_c \sum_i w_i^c (z_i^c - h(v_i, c))^2` with :math:`w_i^c = e^{-z_i^c H(v_i, c)}`. For the classes
of its sharing set S, h is the weighted mean of z above, or below, a threshold of one feature, over all of S
together; for every other class it is that class' weighted mean. S is sought greedily: the best class alone,
then whichever class leaves the least error when it joins, until all are in; the best of these sets is taken.

Departs from it in: H starts from the classes' frequencies (each class' problem then begins with as much
weight for as against it) and not from 0; thresholds are at most the percentiles of a feature; missing
values go to the side where they leave less error; a share of the features can be drawn for each round, and
stumps can be shortened (``learning_rate``), as is usual in boosting today.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from classify.stumps import Stumps
from treegraph.errors import InputError

__all__ = ["SHARING", "BoostSettings", "Boosted", "boost"]

SHARING = ("greedy", "single")

SIDE_SHARE = 1e-12
"""Least share of a set's weight on either side of a split. The weight above is the difference of two sums;
below this share it would be rounding."""

TIE_SHARE = 1e-13
"""Gains that differ by less than this share of the weight are equal: the first feature, or class, is taken,
and not the one that rounding favours."""

LEAST_GAIN = 1e-12
"""Share of the weight that a stump must take off the error; less is rounding."""

MOST_THRESHOLDS = 65_000
"""Most thresholds per feature: bins are numbered in 16 bits, and one more number stands for missing."""

RAREST = 1e-15
"""Share of all weight that a class is taken to have at least, so that its log-odds are finite."""

LEAST_LOSS = 1e-200
"""Mean loss at which training is over: all is right, and the weights come near the smallest float."""


@dataclass(frozen=True)
class BoostSettings:
    """How to boost. The defaults stand here and nowhere else.

    Attributes
    ----------
    n_rounds : int
        Most stumps, >= 1.
    learning_rate : float
        Factor of every stump, over 0 to 1. 1 is the published algorithm.
    sharing : str
        "greedy": any set of classes may share a stump. "single": every stump serves one class, which is
        one-versus-rest boosting.
    max_thresholds : int or None
        Most thresholds per feature, 1 to 65000; None: between all values.
    max_features : float
        Share of the features, drawn anew in each round, among which to choose; over 0 to 1.
    validation_fraction : float
        Share of each class' samples that is set aside to say when to stop, 0 (never stop) to 0.5.
    n_rounds_no_change : int
        Rounds without a better loss on the samples set aside after which to stop, >= 1; the stumps after the
        best round are dropped.
    tol : float
        By how much a loss must fall to be better, >= 0.
    """

    n_rounds: int = 300
    learning_rate: float = 1.0
    sharing: str = "greedy"
    max_thresholds: int | None = 99
    max_features: float = 1.0
    validation_fraction: float = 0.0
    n_rounds_no_change: int = 30
    tol: float = 1e-4

    def __post_init__(self) -> None:
        good = {
            "n_rounds": (_is_count(self.n_rounds), "a whole number from 1"),
            "learning_rate": (0.0 < self.learning_rate <= 1.0, "over 0 and at most 1"),
            "sharing": (self.sharing in SHARING, f"one of {', '.join(SHARING)}"),
            "max_thresholds": (
                self.max_thresholds is None
                or (_is_count(self.max_thresholds) and self.max_thresholds <= MOST_THRESHOLDS),
                f"a whole number from 1 to {MOST_THRESHOLDS}, or None",
            ),
            "max_features": (0.0 < self.max_features <= 1.0, "over 0 and at most 1"),
            "validation_fraction": (0.0 <= self.validation_fraction <= 0.5, "from 0 to 0.5"),
            "n_rounds_no_change": (_is_count(self.n_rounds_no_change), "a whole number from 1"),
            "tol": (self.tol >= 0.0, "at least 0"),
        }
        for name, (is_good, rule) in good.items():
            if not is_good:
                raise InputError(f"{name} must be {rule}, got {getattr(self, name)!r}")


def _is_count(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1


@dataclass(frozen=True, eq=False)
class Boosted:
    """The stumps, and how the loss fell.

    Attributes
    ----------
    stumps : Stumps
    train_loss : (m + 1,) float64
        Mean of e^(-z H) over samples and outputs before the first and after each of the m stumps; falls.
    validation_loss : (r + 1,) float64
        Mean of log(1 + e^(-2 z H)) over the samples set aside, for all rounds tried; empty without them.
    """

    stumps: Stumps
    train_loss: NDArray[np.float64]
    validation_loss: NDArray[np.float64]


def boost(
    x: NDArray[np.float64],
    label: NDArray[np.int64],
    weight: NDArray[np.float64],
    settings: BoostSettings,
    rng: np.random.Generator,
) -> Boosted:
    """Train shared stumps.

    Parameters
    ----------
    x : (n, f) float64
        Features; NaN is missing, nothing is infinite.
    label : (n,) int64
        Class of each sample, 0 to c - 1, each there at least once, c >= 2.
    weight : (n,) float64
        Weight of each sample, > 0. A sample of weight 2 counts as two.
    settings : BoostSettings
    rng : numpy Generator
        Draws the samples set aside and the features of each round, if the settings ask for it.

    Returns
    -------
    boosted : Boosted
        One output per class; for two classes one in all, which is for class 1.

    Notes
    -----
    O(c^2 k + c n f) per round for k thresholds of all features together; O(c k) memory. No stump is added any
    more when none lowers the error.
    """
    sign = np.where(label[:, None] == np.arange(int(label.max()) + 1), 1.0, -1.0)
    if sign.shape[1] == 2:
        sign = sign[:, 1:]
    aside = _set_aside(label, settings.validation_fraction, rng)
    problem = _Problem(x[~aside], sign[~aside], weight[~aside])
    judge = _Judge(_Problem(x[aside], sign[aside], weight[aside]), problem.intercept())
    splits = _split_table(problem.x, problem.weight, settings.max_thresholds)
    sums = np.empty((2, sign.shape[1], int(splits.sizes(np.arange(x.shape[1])).sum())))
    score = np.repeat(problem.intercept()[None, :], len(problem.x), axis=0)
    stumps: list[_Stump] = []
    loss = []
    while True:
        w = problem.weight[:, None] * np.exp(-problem.sign * score)
        loss.append(float(w.sum() / (problem.weight.sum() * w.shape[1])))
        if len(stumps) == settings.n_rounds or loss[-1] <= LEAST_LOSS:
            break
        found = _find_split(w / w.sum(), problem.sign, splits, settings, rng, sums)
        if found is None:
            break
        stumps.append(_make_stump(problem, w, splits, found, loss[-1] / loss[0], settings.learning_rate))
        score += stumps[-1].values(problem.x)
        if aside.any() and judge.says_stop(stumps[-1], settings):
            break
    if aside.any():
        del stumps[judge.best :]
    packed = _pack(stumps, x.shape[1], problem.intercept())
    return Boosted(packed, np.array(loss[: len(stumps) + 1]), np.array(judge.loss))


def _set_aside(label: NDArray[np.int64], fraction: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw the same share of every class' samples, rounded down; True is set aside."""
    aside = np.zeros(label.size, bool)
    if fraction == 0.0:
        return aside
    for c in range(int(label.max()) + 1):
        own = rng.permutation(np.flatnonzero(label == c))
        aside[own[: int(fraction * own.size)]] = True
    if not aside.any():
        raise InputError(
            f"validation_fraction must set samples aside, but {fraction} of {label.size} samples is none of "
            "any class; give a larger one, or 0 to train without"
        )
    return aside


@dataclass(frozen=True, eq=False)
class _Splits:
    """All splits of all features: each sample's bin, and the thresholds between bins."""

    code: NDArray[np.uint16]  # (f, n); n_bins[f] for a missing value
    n_bins: NDArray[np.int64]  # (f,)
    has_missing: NDArray[np.bool_]  # (f,)
    threshold: tuple[NDArray[np.float64], ...]  # of each feature (n_bins[f] - 1,), ascending

    def sizes(self, used: NDArray[np.int64]) -> NDArray[np.int64]:
        """Number of splits of each of the features `used`: each threshold once per side of missing values."""
        return (self.n_bins[used] - 1) * (1 + self.has_missing[used])

    def find(self, used: NDArray[np.int64], at: int) -> tuple[int, int, bool]:
        """Return (feature, threshold, whether missing values are above) of split `at` of those of `used`."""
        ends = np.cumsum(self.sizes(used))
        j = int(np.searchsorted(ends, at, side="right"))
        feature = int(used[j])
        n_thresholds = int(self.n_bins[feature]) - 1
        local = at - int(ends[j] - self.sizes(used)[j])
        return feature, local % n_thresholds, local >= n_thresholds


def _split_table(x: NDArray[np.float64], weight: NDArray[np.float64], max_thresholds: int | None) -> _Splits:
    """Sort every feature once; bins and thresholds stay the same in all rounds."""
    n, n_features = x.shape
    code = np.empty((n_features, n), np.uint16)
    most = min(n, MOST_THRESHOLDS) if max_thresholds is None else max_thresholds
    thresholds = []
    for f in range(n_features):
        thresholds.append(_thresholds(x[:, f], weight, most))
        code[f] = np.searchsorted(thresholds[f], x[:, f], side="left")
        code[f, np.isnan(x[:, f])] = thresholds[f].size + 1
    n_bins = np.array([t.size + 1 for t in thresholds], np.int64)
    return _Splits(code, n_bins, np.any(np.isnan(x), axis=0), tuple(thresholds))


def _thresholds(value: NDArray[np.float64], weight: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """Midpoints between neighbouring values, or as many of them as allowed, with equal weight between."""
    is_known = ~np.isnan(value)
    distinct, place = np.unique(value[is_known], return_inverse=True)
    if distinct.size < 2:
        return np.empty(0)
    gap = np.arange(distinct.size - 1)
    if gap.size > most:
        reached = np.cumsum(np.bincount(place, weights=weight[is_known]))
        wanted = reached[-1] * np.arange(1, most + 1) / (most + 1)
        gap = np.unique(np.minimum(np.searchsorted(reached, wanted), gap[-1]))
    low, high = distinct[gap], distinct[gap + 1]
    middle = 0.5 * low + 0.5 * high
    return np.where((middle >= low) & (middle < high), middle, low)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Samples with their signs: of every output, 1 for its class and -1 for all others."""

    x: NDArray[np.float64]  # (n, f)
    sign: NDArray[np.float64]  # (n, o)
    weight: NDArray[np.float64]  # (n,)

    def intercept(self) -> NDArray[np.float64]:
        """Half log-odds of the outputs' classes, (o,)."""
        share = np.clip(self.weight @ (self.sign > 0.0) / self.weight.sum(), RAREST, 1.0 - RAREST)
        return 0.5 * np.log(share / (1.0 - share))


class _Split(NamedTuple):
    gain: float  # share of the present weight
    shared: NDArray[np.bool_]  # (o,)
    feature: int
    place: int  # of the threshold
    missing_above: bool


class _Stump(NamedTuple):
    """One row of :class:`Stumps`, whose fields it has."""

    feature: int
    threshold: float
    missing_above: bool
    above: float
    below: float
    shared: NDArray[np.bool_]
    constant: NDArray[np.float64]
    above_share: float
    gain: float

    def values(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the stump adds to the scores of samples, (n, o)."""
        is_above = _is_above(x[:, self.feature], self.threshold, self.missing_above)
        return np.where(self.shared, np.where(is_above, self.above, self.below)[:, None], self.constant)


def _is_above(value: NDArray[np.float64], threshold: float, missing_above: bool) -> NDArray[np.bool_]:
    return np.where(np.isnan(value), missing_above, value > threshold)


def _find_split(
    weight: NDArray[np.float64],
    sign: NDArray[np.float64],
    splits: _Splits,
    settings: BoostSettings,
    rng: np.random.Generator,
    sums: NDArray[np.float64],
) -> _Split | None:
    """Return the split and sharing set that leave the least error; None if constants do as well.

    ``weight`` (n, o) adds up to 1; ``sums`` is room to work in. If no feature of those drawn gains anything,
    all are tried.
    """
    n_features = splits.n_bins.size
    n_used = max(1, round(settings.max_features * n_features))
    if n_used < n_features:
        drawn = np.sort(rng.choice(n_features, n_used, replace=False))
        found = _search(weight, sign, splits, settings.sharing, drawn, sums)
        if found is not None:
            return found
    return _search(weight, sign, splits, settings.sharing, np.arange(n_features), sums)


def _search(
    weight: NDArray[np.float64],
    sign: NDArray[np.float64],
    splits: _Splits,
    sharing: str,
    used: NDArray[np.int64],
    sums: NDArray[np.float64],
) -> _Split | None:
    from classify._boost_kernels import search, sums_below

    signed = weight * sign
    k = sums_below(splits.code, splits.n_bins, splits.has_missing, used, weight, signed, sums[0], sums[1])
    shared = np.zeros(sign.shape[1], bool)
    gain, at = search(
        sums[0, :, :k],
        sums[1, :, :k],
        weight.sum(axis=0),
        signed.sum(axis=0),
        shared.size if sharing == "greedy" else 1,
        SIDE_SHARE,
        TIE_SHARE,
        shared,
    )
    if gain <= LEAST_GAIN:
        return None
    return _Split(gain, shared, *splits.find(used, at))


def _make_stump(
    problem: _Problem,
    weight: NDArray[np.float64],
    splits: _Splits,
    split: _Split,
    loss: float,
    learning_rate: float,
) -> _Stump:
    """Fit the values of a stump whose split is known, from sums over the samples of each side."""
    value = problem.x[:, split.feature]
    threshold = float(splits.threshold[split.feature][split.place])
    missing_above = split.missing_above
    if not splits.has_missing[split.feature]:  # nothing to learn from: the heavier side
        missing_above = bool(problem.weight @ np.where(value > threshold, 1.0, -1.0) > 0.0)
    is_above = _is_above(value, threshold, missing_above)
    signed = weight * problem.sign
    own_weight, own_signed = weight[:, split.shared].sum(axis=1), signed[:, split.shared].sum(axis=1)
    others = weight.sum(axis=0)
    constant = np.divide(
        signed.sum(axis=0), others, out=np.zeros_like(others), where=~split.shared & (others > 0.0)
    )
    return _Stump(
        feature=split.feature,
        threshold=threshold,
        missing_above=missing_above,
        above=float(learning_rate * own_signed[is_above].sum() / own_weight[is_above].sum()),
        below=float(learning_rate * own_signed[~is_above].sum() / own_weight[~is_above].sum()),
        shared=split.shared,
        constant=learning_rate * constant,
        above_share=float(problem.weight[is_above].sum() / problem.weight.sum()),
        gain=split.gain * loss,
    )


def _pack(stumps: list[_Stump], n_features: int, intercept: NDArray[np.float64]) -> Stumps:
    """Put the stumps' fields into arrays; without a stump they are empty."""
    o = intercept.size

    def column(name: str, dtype: type, *shape: int) -> NDArray:
        values = [getattr(stump, name) for stump in stumps]
        return np.array(values, dtype).reshape(len(stumps), *shape)

    return Stumps(
        n_features=n_features,
        intercept=intercept,
        feature=column("feature", np.int32),
        threshold=column("threshold", np.float64),
        missing_above=column("missing_above", np.bool_),
        above=column("above", np.float64),
        below=column("below", np.float64),
        shared=column("shared", np.bool_, o),
        constant=column("constant", np.float64, o),
        above_share=column("above_share", np.float64),
        gain=column("gain", np.float64),
    )


class _Judge:
    """Watches the samples that were set aside, and says when they stopped getting better."""

    def __init__(self, problem: _Problem, intercept: NDArray[np.float64]) -> None:
        self.problem = problem
        self.score = np.repeat(intercept[None, :], len(problem.x), axis=0)
        self.loss = [self._loss()] if len(problem.x) else []
        self.best = 0

    def says_stop(self, stump: _Stump, settings: BoostSettings) -> bool:
        """Take the next stump in; True if the best round is ``n_rounds_no_change`` rounds ago."""
        self.score += stump.values(self.problem.x)
        self.loss.append(self._loss())
        n_rounds = len(self.loss) - 1
        if self.loss[-1] < self.loss[self.best] - settings.tol:
            self.best = n_rounds
        return n_rounds - self.best >= settings.n_rounds_no_change

    def _loss(self) -> float:
        each = np.logaddexp(0.0, -2.0 * self.problem.sign * self.score).mean(axis=1)
        return float(self.problem.weight @ each / self.problem.weight.sum())
