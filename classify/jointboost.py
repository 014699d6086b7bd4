"""Joint boosting as a scikit-learn estimator: the one module of this package that loads scikit-learn.

Based on: A. Torralba, K. P. Murphy, W. T. Freeman, "Sharing visual features for multiclass and multiview
object detection", IEEE Transactions on Pattern Analysis and Machine Intelligence 29(5), 2007.
Departs from it in: what the heads of ``boosting.py`` and ``stumps.py`` say; probabilities, of which the paper
has none.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils import check_random_state
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from classify.boosting import BoostSettings, boost
from classify.stumps import two_sided
from treegraph.errors import InputError

__all__ = ["JointBoostClassifier"]


class JointBoostClassifier(ClassifierMixin, BaseEstimator):
    """Boosted regression stumps that several classes share.

    Every stump looks at one feature and serves a set of classes that the training chose
    (``boosting.py`` has the method, and what is different from the published one). NaN is a missing value.

    Parameters
    ----------
    n_rounds : int, default=300
        Most stumps.
    learning_rate : float, default=1.0
        Factor of every stump, over 0 to 1.
    sharing : {"greedy", "single"}, default="greedy"
        "single" gives every stump to one class: one-versus-rest boosting.
    max_thresholds : int or None, default=99
        Most thresholds per feature; None: between all values.
    max_features : float, default=1.0
        Share of the features, drawn in each round, among which to choose.
    validation_fraction : float, default=0.0
        Share of each class' samples that is set aside to say when to stop; 0: all ``n_rounds`` are done.
    n_rounds_no_change : int, default=30
        Rounds without a better loss on them after which to stop.
    tol : float, default=1e-4
        By how much that loss must fall to be better.
    random_state : int, RandomState or None, default=None
        For the samples set aside and the features drawn. Without either, nothing is random.

    Attributes
    ----------
    classes_ : (c,) ndarray
        The labels, sorted.
    n_features_in_ : int
    feature_names_in_ : (f,) ndarray of str
        Only if X had names for all its columns.
    stumps_ : Stumps
        What was learnt; needs no scikit-learn.
    n_rounds_ : int
        Number of stumps.
    sharing_ : (n_rounds_, o) bool ndarray
        Which classes share which stump; for two classes o = 1, which is ``classes_[1]``.
    feature_importances_ : (f,) float64 ndarray
        Each feature's share of the error taken away.
    train_loss_ : (n_rounds_ + 1,) float64 ndarray
        Mean of e^(-z H) after every round.
    validation_loss_ : (r + 1,) float64 ndarray
        Mean of log(1 + e^(-2 z H)) over the samples set aside, for all rounds tried.

    Notes
    -----
    The numbers do not depend on how many threads there are; training runs on one.

    Examples
    --------
    >>> import numpy as np
    >>> from classify import JointBoostClassifier
    >>> x = np.array([[0.0], [1.0], [2.0], [3.0], [4.0], [np.nan]])
    >>> model = JointBoostClassifier(n_rounds=10).fit(x, ["oak", "oak", "elm", "elm", "ash", "ash"])
    >>> model.predict([[0.4], [3.0], [np.nan]]).tolist()
    ['oak', 'elm', 'ash']
    """

    def __init__(
        self,
        *,
        n_rounds: int = BoostSettings.n_rounds,
        learning_rate: float = BoostSettings.learning_rate,
        sharing: str = BoostSettings.sharing,
        max_thresholds: int | None = BoostSettings.max_thresholds,
        max_features: float = BoostSettings.max_features,
        validation_fraction: float = BoostSettings.validation_fraction,
        n_rounds_no_change: int = BoostSettings.n_rounds_no_change,
        tol: float = BoostSettings.tol,
        random_state: Any = None,
    ) -> None:
        self.n_rounds = n_rounds
        self.learning_rate = learning_rate
        self.sharing = sharing
        self.max_thresholds = max_thresholds
        self.max_features = max_features
        self.validation_fraction = validation_fraction
        self.n_rounds_no_change = n_rounds_no_change
        self.tol = tol
        self.random_state = random_state

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> JointBoostClassifier:
        """Train on samples X (n, f), NaN where missing, with labels y (n,).

        ``sample_weight`` (n,), >= 0: weight 2 counts as two samples, weight 0 as none.

        Raises
        ------
        InputError
            If a parameter or weight is out of range, or fewer than two classes have weight.
        """
        settings = BoostSettings(**{name: getattr(self, name) for name in BoostSettings.__dataclass_fields__})
        x, target = validate_data(self, X, y, dtype=np.float64, order="C", ensure_all_finite="allow-nan")
        check_classification_targets(target)
        weight = _check_weight(sample_weight, len(target))
        counts = weight > 0.0
        if not counts.any():
            raise InputError(f"sample_weight must not be zero everywhere, got {len(target)} zeros")
        self.classes_, label = np.unique(target[counts], return_inverse=True)
        if self.classes_.size < 2:
            raise InputError(
                f"y must have at least 2 classes (with weight), got {self.classes_.size} class in "
                f"{len(target)} samples"
            )
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31))
        boosted = boost(x[counts], label, weight[counts], settings, rng)
        self.stumps_ = boosted.stumps
        self.train_loss_ = boosted.train_loss
        self.validation_loss_ = boosted.validation_loss
        return self

    @property
    def n_rounds_(self) -> int:
        check_is_fitted(self)
        return self.stumps_.n_stumps

    @property
    def sharing_(self) -> NDArray[np.bool_]:
        check_is_fitted(self)
        return self.stumps_.shared

    @property
    def feature_importances_(self) -> NDArray[np.float64]:
        check_is_fitted(self)
        return self.stumps_.importances()

    def decision_function(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the scores H in half log-odds: (n, c), or for two classes (n,), of ``classes_[1]``."""
        return _one_or_many(self._scores(X))

    def predict_proba(self, X: ArrayLike) -> NDArray[np.float64]:
        """Return the classes' probabilities (n, c); see ``calibration.py`` for better ones."""
        return _probabilities(self._scores(X))

    def predict(self, X: ArrayLike) -> NDArray:
        """Return the label with the highest score for each sample, (n,)."""
        scores = self._scores(X)
        return self.classes_[two_sided(scores).argmax(axis=1)]

    def staged_decision_function(self, X: ArrayLike) -> Iterator[NDArray[np.float64]]:
        """Yield :meth:`decision_function` after 1, 2, ... stumps."""
        return (_one_or_many(scores) for scores in self._staged_scores(X))

    def staged_predict_proba(self, X: ArrayLike) -> Iterator[NDArray[np.float64]]:
        """Yield :meth:`predict_proba` after 1, 2, ... stumps."""
        return (_probabilities(scores) for scores in self._staged_scores(X))

    def staged_predict(self, X: ArrayLike) -> Iterator[NDArray]:
        """Yield :meth:`predict` after 1, 2, ... stumps."""
        scores = self._staged_scores(X)
        return (self.classes_[two_sided(each).argmax(axis=1)] for each in scores)

    def _scores(self, X: ArrayLike) -> NDArray[np.float64]:
        checked = self._check(X)
        return self.stumps_.scores(checked)

    def _staged_scores(self, X: ArrayLike) -> Iterator[NDArray[np.float64]]:
        checked = self._check(X)
        return self.stumps_.staged_scores(checked)

    def _check(self, X: ArrayLike) -> NDArray[np.float64]:
        check_is_fitted(self)
        return validate_data(self, X, dtype=np.float64, order="C", ensure_all_finite="allow-nan", reset=False)


def _one_or_many(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    return scores[:, 0] if scores.shape[1] == 1 else scores


def _probabilities(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    both = two_sided(scores)
    both = np.exp(both - both.max(axis=1, keepdims=True))
    return both / both.sum(axis=1, keepdims=True)


def _check_weight(weight: ArrayLike | None, n: int) -> NDArray[np.float64]:
    if weight is None:
        return np.ones(n)
    array = np.asarray(weight, dtype=np.float64)
    if array.shape != (n,):
        raise InputError(f"sample_weight must have shape ({n},), got {array.shape}")
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        raise InputError(f"sample_weight must be finite and at least 0, got {array.min()}")
    return array
