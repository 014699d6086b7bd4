r"""From scores to probabilities that can be believed, and to "none of these".

Based on: C. Guo, G. Pleiss, Y. Sun, K. Q. Weinberger, "On calibration of modern neural networks", ICML 2017
(temperature scaling, expected calibration error); J. Platt, "Probabilistic outputs for support vector
machines", 1999 (targets that leave room for doubt).
Departs from it in: the scores are those of boosting, and come from folds that the stumps have not seen.

Why a temperature, :math:`p \propto e^{H / T}` with one T for all classes: a species has some dozen scans. On
scores of 12 classes with 10, 25 and 50 samples each a sigmoid or a monotone step function per class lost more
by what they had to learn than they won; ``benchmarks/jointboost.py`` has the figures. One T also leaves the
order of the classes alone, and makes the logarithm of p1/p2 a sum over features.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classify._checks import check_array, check_number, check_range
from treegraph.errors import InputError

__all__ = [
    "FeatureRange",
    "Rejection",
    "Reliability",
    "calibration_error",
    "fit_range",
    "fit_rejection",
    "fit_temperature",
    "log_loss",
    "reliability",
    "to_probabilities",
]

LEAST_TEMPERATURE, MOST_TEMPERATURE = 1e-3, 1e3
LEAST_PROBABILITY = 1e-15
"""Below it a probability counts as this much in the log loss, so that one certain error is not infinite."""

MOST_SCORE = 1e6
"""A score is at most the sum of the stumps' values, of which none is over 1."""

MOST_SCANS = 10**9

LEAST_VALUE = 1e-100
"""Least spread of a feature, and over 1 the largest value, so that no quotient of two leaves the floats."""

CLIP = 5.0
"""Spreads at which a feature's distance is cut: one wild feature must not decide alone."""

OWN_SHARE = 0.5
"""Share of a class' own variance in its spread; the rest is the mean of all classes. A class may have six
scans, of which no spread is known well."""

LEAST_SPREAD = 0.1
"""Least spread of a feature within a class, in spreads over all classes: a feature that never varies among a
class' few scans may do so in the next."""

DISTANCE_SHARE = 0.2
"""Share of the allowed false rejections that goes to the distance; the score has the rest. Of species left
out in training the score finds more; the distance is there for what is no tree at all."""


def to_probabilities(scores: NDArray[np.float64], temperature: float) -> NDArray[np.float64]:
    """Return probabilities (n, c) for scores (n, c), one per class: e^(H / T), scaled to add up to 1."""
    power = (scores - scores.max(axis=1, keepdims=True)) / temperature
    share = np.exp(power)
    return share / share.sum(axis=1, keepdims=True)


def fit_temperature(scores: NDArray[np.float64], label: NDArray[np.int64]) -> float:
    """Return the temperature of least log loss on samples that the scores were not trained with.

    The true class' target is 1 - 1 / (n + 2) and not 1, so that n right samples do not make it certain that
    the next will be right.

    Parameters
    ----------
    scores : (n, c) float64
        One score per class, n >= 1, c >= 2.
    label : (n,) int64
        True class.

    Returns
    -------
    temperature : float
        0.001 to 1000. Over 1: the scores are too sure of themselves.

    Notes
    -----
    The loss is convex in 1 / T; its slope is brought to 0 by bisection, 60 steps of O(n c).
    """
    n, n_classes = scores.shape
    doubt = 1.0 / (n + 2.0)
    target = np.full((n, n_classes), doubt / (n_classes - 1))
    target[np.arange(n), label] = 1.0 - doubt
    wanted = float((target * scores).sum())
    low, high = math.log(1.0 / MOST_TEMPERATURE), math.log(1.0 / LEAST_TEMPERATURE)
    for _ in range(60):
        middle = 0.5 * (low + high)
        mean = float((to_probabilities(scores, math.exp(-middle)) * scores).sum())
        low, high = (low, middle) if mean > wanted else (middle, high)
    return math.exp(-0.5 * (low + high))


def log_loss(probability: ArrayLike, label: ArrayLike) -> float:
    """Return the mean of -ln p of the true class, for probabilities (n, c) and classes (n,)."""
    probability, true = _checked(probability, label)
    own = probability[np.arange(true.size), true]
    return float(-np.log(np.maximum(own, LEAST_PROBABILITY)).mean())


@dataclass(frozen=True, eq=False)
class Reliability:
    """How often what was said to be p sure was right: one row per bin that is not empty.

    Attributes
    ----------
    low, high : (b,) float64
        Bin of the probability of the class said: low < p <= high.
    predicted : (b,) float64
        Mean of the probability.
    observed : (b,) float64
        Share that was right.
    count : (b,) int64
        Samples.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    predicted: NDArray[np.float64]
    observed: NDArray[np.float64]
    count: NDArray[np.int64]


def reliability(probability: ArrayLike, label: ArrayLike, *, n_bins: int = 10) -> Reliability:
    """Sort samples by how sure the answer was, and count how often it was right.

    Parameters
    ----------
    probability : (n, c) float
        Rows add up to 1.
    label : (n,) int
        True class.
    n_bins : int
        Bins of equal width between 0 and 1, >= 1.

    Returns
    -------
    reliability : Reliability
        Empty bins are left out; the counts add up to n.

    Raises
    ------
    InputError
        If a shape is wrong, a row does not add up to 1, or a label is no class.
    """
    probability, true = _checked(probability, label)
    if n_bins < 1:
        raise InputError(f"n_bins must be at least 1, got {n_bins}")
    said = probability.max(axis=1)
    is_right = probability.argmax(axis=1) == true
    place = np.clip(np.ceil(said * n_bins).astype(np.int64) - 1, 0, n_bins - 1)
    count = np.bincount(place, minlength=n_bins)
    full = np.flatnonzero(count)
    return Reliability(
        low=full / n_bins,
        high=(full + 1) / n_bins,
        predicted=np.bincount(place, said, n_bins)[full] / count[full],
        observed=np.bincount(place, is_right, n_bins)[full] / count[full],
        count=count[full],
    )


def calibration_error(probability: ArrayLike, label: ArrayLike, *, n_bins: int = 10) -> float:
    """Return the expected calibration error: the mean of |observed - predicted| over the samples' bins."""
    table = reliability(probability, label, n_bins=n_bins)
    return float(table.count @ np.abs(table.observed - table.predicted) / table.count.sum())


@dataclass(frozen=True, eq=False)
class FeatureRange:
    """Where each class' training samples lie, feature by feature.

    Attributes
    ----------
    centre : (c, f) float64
        Median, in the feature's unit; NaN where no sample of the class has the feature.
    spread : (c, f) float64
        Spread in the feature's unit, 1e-100 to 1e100: a standard deviation, taken from quartiles.

    Raises
    ------
    InputError
        If a shape, a type or a range is wrong.
    """

    centre: NDArray[np.float64]
    spread: NDArray[np.float64]

    def __post_init__(self) -> None:
        shape = np.shape(self.centre)
        if len(shape) != 2:
            raise InputError(f"centre must have shape (classes, features), got {shape}")
        put = partial(object.__setattr__, self)
        put("centre", check_array("centre", self.centre, shape, may_miss=True))
        put("spread", check_array("spread", self.spread, shape))
        check_range("centre", self.centre, -1.0 / LEAST_VALUE, 1.0 / LEAST_VALUE)
        check_range("spread", self.spread, LEAST_VALUE, 1.0 / LEAST_VALUE)

    def distance(
        self, x: NDArray[np.float64], label: NDArray[np.int64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return how far samples lie from the class that they are said to be.

        Parameters
        ----------
        x : (n, f) float64
            Features; those missing are left out.
        label : (n,) int64
            Class of each sample.
        weight : (f,) float64
            Weight of each feature, >= 0: features that decide nothing should have none.

        Returns
        -------
        distance : (n,) float64 ndarray
            Weighted root mean square of the features' distances in spreads, each cut at 5; 0 to 5, and 5 if
            nothing is known.
        """
        spread = self.spread[label]
        apart = np.minimum(np.abs(x - self.centre[label]), CLIP * spread) / spread
        known = np.where(np.isnan(apart), 0.0, weight)
        square = np.nan_to_num(apart, nan=0.0) ** 2
        total = known.sum(axis=1)
        mean = np.divide((known * square).sum(axis=1), total, out=np.full(len(x), CLIP**2), where=total > 0.0)
        return np.sqrt(mean)


def fit_range(x: NDArray[np.float64], label: NDArray[np.int64], n_classes: int) -> FeatureRange:
    """Return the training samples' range: x (n, f) with NaN where missing, label (n,), 0 to n_classes - 1."""
    own = [_middle_and_spread(x[label == c]) for c in range(n_classes)]
    centre = np.array([middle for middle, _ in own])
    spread = np.array([spread for _, spread in own])
    pooled = np.sqrt(_mean_known(spread**2))
    spread = np.where(np.isnan(spread), pooled, spread)
    spread = np.sqrt(OWN_SHARE * spread**2 + (1.0 - OWN_SHARE) * pooled**2)
    overall = _middle_and_spread(x)[1]
    spread = np.maximum(spread, LEAST_SPREAD * overall)
    return FeatureRange(
        centre, np.where(spread >= LEAST_VALUE, spread, 1.0)
    )  # also where nothing is known (NaN)


def _middle_and_spread(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median and spread of each column over the values that are known; NaN where there is none."""
    middle, spread = np.full(x.shape[1], np.nan), np.full(x.shape[1], np.nan)
    for f in range(x.shape[1]):
        value = x[~np.isnan(x[:, f]), f]
        if value.size:
            low, middle[f], high = np.quantile(value, [0.25, 0.5, 0.75])
            spread[f] = (high - low) / 1.349 or value.std()  # a normal distribution's quartiles
    return middle, spread


def _mean_known(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of each column over the rows that are not NaN; NaN where all are."""
    is_known = ~np.isnan(rows)
    count = is_known.sum(axis=0)
    total = np.where(is_known, rows, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full(rows.shape[1], np.nan), where=count > 0)


@dataclass(frozen=True)
class Rejection:
    """When the answer is "none of these".

    Attributes
    ----------
    score_min : float
        Least score of the best class, half log-odds against all others. Below it no class claims the scan.
    distance_max : float
        Largest distance from the best class' range, in spreads. Above it the scan lies outside of what the
        class has shown.
    asked : float
        Share of scans of known species that may be rejected, over 0 and under 1.
    measured : float
        Share that is rejected among scans that neither the stumps nor these two thresholds were trained with.
    n_measured : int
        Scans behind `measured`, >= 1.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    score_min: float
    distance_max: float
    asked: float
    measured: float
    n_measured: int

    def __post_init__(self) -> None:
        check_number("score_min", self.score_min, -MOST_SCORE, MOST_SCORE)
        check_number("distance_max", self.distance_max, 0.0, CLIP)
        check_number("asked", self.asked, 0.0, 1.0)
        check_number("measured", self.measured, 0.0, 1.0)
        check_number("n_measured", self.n_measured, 1, MOST_SCANS)

    def rejects(self, score: NDArray[np.float64], distance: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which scans are of none of the classes: best scores (n,) and distances (n,)."""
        return (score < self.score_min) | (distance > self.distance_max)


def fit_rejection(
    score: NDArray[np.float64],
    distance: NDArray[np.float64],
    fold: NDArray[np.int64],
    asked: float,
    distance_share: float = DISTANCE_SHARE,
) -> Rejection:
    """Choose the thresholds so that the share `asked` of known scans is rejected, at most.

    Parameters
    ----------
    score, distance : (n,) float64
        Best class' score and distance of held-out scans.
    fold : (n,) int64
        Fold in which each was held out. The share is measured on every fold with thresholds from the others.
    asked : float
        Over 0 and under 1.
    distance_share : float
        Share of `asked` that goes to the distance, 0 to 1; the score has the rest.

    Returns
    -------
    rejection : Rejection
        Of the n scans given, no more than the share `asked` are rejected by the thresholds.

    Raises
    ------
    InputError
        If `asked` or `distance_share` is out of range, or all scans are of one fold.
    """
    if not 0.0 < asked < 1.0:
        raise InputError(f"false_rejection must be over 0 and under 1, got {asked}")
    if not 0.0 <= distance_share <= 1.0:
        raise InputError(f"distance_share must be from 0 to 1, got {distance_share}")
    folds = np.unique(fold)
    if folds.size < 2:
        raise InputError(f"fold must have at least 2 folds, got {folds.size}")
    wrong = 0
    for k in folds:
        own = fold == k
        score_min, distance_max = _thresholds(score[~own], distance[~own], asked, distance_share)
        wrong += int(((score[own] < score_min) | (distance[own] > distance_max)).sum())
    return Rejection(
        *_thresholds(score, distance, asked, distance_share), asked, wrong / score.size, int(score.size)
    )


def _thresholds(
    score: NDArray[np.float64], distance: NDArray[np.float64], asked: float, distance_share: float
) -> tuple[float, float]:
    """Strictest thresholds that reject no more than floor(asked n): the distance first has its share."""
    allowed = int(asked * score.size)
    far = int(distance_share * allowed)
    distance_max = float(np.sort(distance)[score.size - 1 - far])
    near = np.sort(np.where(distance > distance_max, np.inf, score))  # the far ones are rejected already
    return float(near[allowed - int((distance > distance_max).sum())]), distance_max


def _checked(probability: ArrayLike, label: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    share, true = np.asarray(probability, np.float64), np.asarray(label)
    if share.ndim != 2 or share.shape[0] < 1 or share.shape[1] < 2 or true.shape != share.shape[:1]:
        raise InputError(
            f"probability must have shape (n, classes) and label (n,), got {share.shape} and {true.shape}"
        )
    if not (share >= 0.0).all() or not np.allclose(share.sum(axis=1), 1.0):
        raise InputError("probability must be at least 0, and every row must add up to 1; scale the rows")
    if true.dtype.kind not in "iu" or not ((true >= 0) & (true < share.shape[1])).all():
        raise InputError(f"label must be a class from 0 to {share.shape[1] - 1}, got {np.unique(true)[:5]}")
    return share, true.astype(np.int64)
