"""Shared regression stumps: what joint boosting learns, and what they say about a scan.

Based on: A. Torralba, K. P. Murphy, W. T. Freeman, "Sharing visual features for multiclass and multiview
object detection", IEEE Transactions on Pattern Analysis and Machine Intelligence 29(5), 2007.
Departs from it in: a missing value goes to a side of its own choosing, learnt for each stump; the sum of
stumps starts from an intercept per class.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classify._checks import check_array, check_range
from treegraph.errors import InputError

__all__ = ["Stumps", "check_features", "two_sided"]

MOST_INTERCEPT = 50.0
"""Half log-odds of a class of which there is one sample in 10^43."""

MOST_GAIN = 2.0
"""No stump takes away more than there is, which is 1; the rest is room for rounding."""


@dataclass(frozen=True, eq=False)
class Stumps:
    """A sum of m stumps for o outputs: one output per class, or a single one where there are two classes.

    Stump j looks at feature f = ``feature[j]``. For output c of its sharing set (``shared[j, c]``) it gives
    ``above[j]`` if the value is over ``threshold[j]`` and ``below[j]`` if not; for any other output it gives
    ``constant[j, c]``, whatever the value. The score of output c is ``intercept[c]`` and the sum over all
    stumps.

    Attributes
    ----------
    n_features : int
        Columns that the features must have, > 0.
    intercept : (o,) float64
        Score before any stump, -50 to 50.
    feature : (m,) int32
        Column that the stump looks at, ``0 <= feature < n_features``.
    threshold : (m,) float64
        In the feature's unit. A value equal to it is below.
    missing_above : (m,) bool
        Whether a missing value (NaN) counts as above.
    above, below : (m,) float64
        What the stump adds, in half log-odds, -1 to 1.
    shared : (m, o) bool
        The sharing set: the outputs for which the stump's value depends on the feature.
    constant : (m, o) float64
        What the stump adds for the others, -1 to 1; 0 where ``shared``.
    above_share : (m,) float64
        Share of the training samples that were above, 0 to 1.
    gain : (m,) float64
        How much weighted squared error the stump took away when it was chosen, of 1 at the start; 0 to 2.

    Raises
    ------
    InputError
        If a shape, a type or a range is wrong.
    """

    n_features: int
    intercept: NDArray[np.float64]
    feature: NDArray[np.int32]
    threshold: NDArray[np.float64]
    missing_above: NDArray[np.bool_]
    above: NDArray[np.float64]
    below: NDArray[np.float64]
    shared: NDArray[np.bool_]
    constant: NDArray[np.float64]
    above_share: NDArray[np.float64]
    gain: NDArray[np.float64]

    def __post_init__(self) -> None:
        m, o = np.shape(self.shared) if np.ndim(self.shared) == 2 else (-1, -1)
        if o < 1:
            raise InputError(
                f"shared must have shape (stumps, outputs) with an output, got {np.shape(self.shared)}"
            )
        shapes: dict[str, tuple[int, ...]] = {"intercept": (o,), "shared": (m, o), "constant": (m, o)}
        types = {"feature": np.int32, "missing_above": np.bool_, "shared": np.bool_}
        for field in fields(self)[1:]:
            name = field.name
            array = check_array(
                name, getattr(self, name), shapes.get(name, (m,)), types.get(name, np.float64)
            )
            object.__setattr__(self, name, array)
        if self.n_features < 1:
            raise InputError(f"n_features must be at least 1, got {self.n_features}")
        check_range("feature", self.feature, 0, self.n_features - 1)
        check_range("above_share", self.above_share, 0.0, 1.0)
        check_range("gain", self.gain, 0.0, MOST_GAIN)
        check_range("intercept", self.intercept, -MOST_INTERCEPT, MOST_INTERCEPT)
        for name in ("above", "below", "constant"):  # means of -1 and 1
            check_range(name, getattr(self, name), -1.0, 1.0)
        if self.constant[self.shared].any():
            raise InputError("constant must be 0 where shared; a shared stump has no constant")

    @property
    def n_stumps(self) -> int:
        """Number of stumps m."""
        return int(self.feature.size)

    @property
    def n_outputs(self) -> int:
        """Number of outputs o."""
        return int(self.intercept.size)

    def scores(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return the scores (n, o) of samples (n, n_features), in half log-odds; NaN is missing.

        Each score is summed in the order of the stumps, so that it has the same bytes alone and among others.
        """
        x = check_features(x, self.n_features)
        score = np.repeat(self.intercept[None, :], len(x), axis=0)
        self._add(x, slice(None), score)
        return score

    def staged_scores(self, x: ArrayLike) -> Iterator[NDArray[np.float64]]:
        """Yield the scores (n, o) after 1, 2, ... m stumps; the last is :meth:`scores`."""
        x = check_features(x, self.n_features)
        score = np.repeat(self.intercept[None, :], len(x), axis=0)
        for j in range(self.n_stumps):
            self._add(x, slice(j, j + 1), score)
            yield score.copy()

    def first(self, n_stumps: int) -> Stumps:
        """Return the first stumps alone."""
        kept = {
            field.name: getattr(self, field.name)[:n_stumps]
            for field in fields(self)
            if field.name not in ("n_features", "intercept")
        }
        return Stumps(n_features=self.n_features, intercept=self.intercept, **kept)

    def importances(self) -> NDArray[np.float64]:
        """Return each feature's share of the gain of all stumps, (n_features,); all 0 if there is none."""
        gain = np.zeros(self.n_features)
        np.add.at(gain, self.feature, self.gain)
        return gain / gain.sum() if gain.any() else gain

    def contributions(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return what each feature adds to each output's score of one sample (n_features,).

        A stump's word is measured from what it says on average over the training samples:
        ``above - (q above + (1 - q) below)`` with q = ``above_share``. So an average scan
        speaks for nothing, and constants, which no feature changes, are no feature's word.

        Returns
        -------
        contribution : (n_features, o) float64 ndarray
            In half log-odds. The sum over features and :meth:`mean_scores` is :meth:`scores`, to rounding.
        """
        value = check_features(np.reshape(x, (1, -1)), self.n_features)[0, self.feature]
        is_above = np.where(np.isnan(value), self.missing_above, value > self.threshold)
        said = np.where(is_above, self.above, self.below) - self._mean_value()
        contribution = np.zeros((self.n_features, self.n_outputs))
        np.add.at(contribution, self.feature, said[:, None] * self.shared)
        return contribution

    def mean_scores(self) -> NDArray[np.float64]:
        """Return the outputs' mean scores (o,) over the training samples: what no feature explains."""
        return self.intercept + (self._mean_value()[:, None] * self.shared + self.constant).sum(axis=0)

    def _mean_value(self) -> NDArray[np.float64]:
        return self.above_share * self.above + (1.0 - self.above_share) * self.below

    def _add(self, x: NDArray[np.float64], part: slice, score: NDArray[np.float64]) -> None:
        """Add the stumps of `part` to `score` (n, o)."""
        from classify._boost_kernels import add_scores

        add_scores(
            x,
            self.feature[part],
            self.threshold[part],
            self.missing_above[part],
            self.above[part],
            self.below[part],
            self.shared[part],
            self.constant[part],
            score,
        )


def two_sided(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return one score per class: (n, c) as they are; a single output (n, 1) is class 1, minus it 0."""
    return np.concatenate([-scores, scores], axis=1) if scores.shape[1] == 1 else scores


def check_features(x: ArrayLike, n_features: int) -> NDArray[np.float64]:
    """Return samples as a C-contiguous float64 array (n, n_features) without infinities; NaN may be there."""
    array = np.ascontiguousarray(x, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != n_features:
        raise InputError(f"x must have shape (samples, {n_features}), got {array.shape}")
    if np.isinf(array).any():
        row, column = np.argwhere(np.isinf(array))[0]
        raise InputError(
            f"x must be finite or NaN, but x[{row}, {column}] is {array[row, column]}; give NaN for unknown"
        )
    return array
