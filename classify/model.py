"""A trained classifier of species: stumps, calibration, and the rule for "none of these".

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 3.5.1.
Departs from it in: the vector h of probabilities is calibrated on scans that were held out; a scan may be of
none of the species; the answer names the features that spoke for it.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classify._checks import check_number
from classify.boosting import BoostSettings, boost
from classify.calibration import (
    DISTANCE_SHARE,
    LEAST_TEMPERATURE,
    MOST_TEMPERATURE,
    FeatureRange,
    Rejection,
    fit_range,
    fit_rejection,
    fit_temperature,
    to_probabilities,
)
from classify.stumps import Stumps, check_features, two_sided
from treegraph.errors import InputError

__all__ = [
    "SPECIES_SETTINGS",
    "Classification",
    "Explanation",
    "SpeciesModel",
    "Training",
    "train_model",
]

SPECIES_SETTINGS = BoostSettings(n_rounds=1200, learning_rate=0.2, max_features=0.05)
"""How species are trained. Against the published settings, shorter stumps and a draw of features win two
points of accuracy in no more time (``benchmarks/jointboost.py``)."""

MOST_NAME, MOST_NAME_BYTES = 200, 255
"""Most characters of a name, and bytes in UTF-8: a tree's file holds no more."""

MOST_TEXT = 2000
"""Most characters of a line of provenance."""


@dataclass(frozen=True, eq=False)
class Classification:
    """What the model says about n scans.

    Attributes
    ----------
    classes : tuple of str
        Names of the c species.
    label : (n,) int64
        Most probable species, also where it is rejected.
    probability : (n, c) float64
        Calibrated; rows add up to 1.
    score : (n,) float64
        Best species' score, half log-odds against all others.
    distance : (n,) float64
        From the best species' range, in spreads, 0 to 5.
    is_unknown : (n,) bool
        Whether the answer is "none of these".
    """

    classes: tuple[str, ...]
    label: NDArray[np.int64]
    probability: NDArray[np.float64]
    score: NDArray[np.float64]
    distance: NDArray[np.float64]
    is_unknown: NDArray[np.bool_]

    @property
    def species(self) -> tuple[str | None, ...]:
        """Name of each scan's species; None: of none of them."""
        return tuple(
            None if unknown else self.classes[at]
            for at, unknown in zip(self.label, self.is_unknown, strict=True)
        )


@dataclass(frozen=True)
class Explanation:
    """Why one species and not the next.

    Attributes
    ----------
    species, against : str
        The most probable species and the runner-up.
    log_odds : float
        ln of their probabilities' ratio, >= 0; the sum of `base` and all features' parts.
    base : float
        The part that no feature explains: what an average scan of the training would have.
    features : tuple of (str, float, float)
        Name, value and part of each feature that the stumps look at, the largest part first. A part over 0
        spoke for `species`, one under 0 for `against`. The value is NaN where it is missing.
    """

    species: str
    against: str
    log_odds: float
    base: float
    features: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True, eq=False)
class SpeciesModel:
    """A trained model. It needs no scikit-learn, and can be written to a file (``model_file.py``).

    Attributes
    ----------
    name, version : str
        Given by who trained it; not empty, at most 200 characters.
    classes : tuple of str
        Names of the c >= 2 species, each once.
    features : tuple of str
        Names of the f features in the order of the columns, each once.
    stumps : Stumps
        c outputs, or 1 if there are two species.
    temperature : float
        Of the scores, 0.001 to 1000.
    span : FeatureRange
        Where the species' training scans lie, (c, f).
    rejection : Rejection
        When the answer is "none of these".
    provenance : mapping of str to str
        Whatever is to be known about the training: seed, data, version of the program. At most 2000
        printable characters each.

    Raises
    ------
    InputError
        If a name, a shape or a range is wrong.
    """

    name: str
    version: str
    classes: tuple[str, ...]
    features: tuple[str, ...]
    stumps: Stumps
    temperature: float
    span: FeatureRange
    rejection: Rejection
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for key in ("name", "version"):
            _check_names(key, (getattr(self, key),))
        for key in ("classes", "features"):
            _check_names(key, getattr(self, key))
        c, f = len(self.classes), len(self.features)
        if c < 2:
            raise InputError(f"classes must be at least 2, got {c}")
        wanted = 1 if c == 2 else c
        if (self.stumps.n_features, self.stumps.n_outputs) != (f, wanted):
            raise InputError(
                f"stumps must be for {f} features and {wanted} outputs, got {self.stumps.n_features} and "
                f"{self.stumps.n_outputs}"
            )
        check_number("temperature", self.temperature, LEAST_TEMPERATURE, MOST_TEMPERATURE)
        for key, text in self.provenance.items():
            _check_names("provenance", (key,))
            _check_text("provenance", text)
        if self.span.centre.shape != (c, f):
            raise InputError(f"span must have shape ({c}, {f}), got {self.span.centre.shape}")

    def probabilities(self, x: ArrayLike) -> NDArray[np.float64]:
        """Return calibrated probabilities (n, c) for features (n, f), NaN where missing.

        The same features give the same bytes, alone or among others.
        """
        return to_probabilities(two_sided(self.stumps.scores(x)), self.temperature)

    def classify(self, x: ArrayLike) -> Classification:
        """Return species, probabilities and whether to believe them, for features (n, f)."""
        x = check_features(x, len(self.features))
        scores = two_sided(self.stumps.scores(x))
        label = scores.argmax(axis=1)
        best = scores.max(axis=1)
        distance = self.span.distance(x, label, self.stumps.importances())
        return Classification(
            classes=self.classes,
            label=label,
            probability=to_probabilities(scores, self.temperature),
            score=best,
            distance=distance,
            is_unknown=self.rejection.rejects(best, distance),
        )

    def explain(self, x: ArrayLike) -> Explanation:
        """Return the features of one scan (f,) that spoke for its species, and those that spoke against.

        ln(p1 / p2) = (H1 - H2) / T is a sum over stumps, and so over features (:meth:`Stumps.contributions`).
        """
        value = check_features(np.reshape(x, (1, -1)), len(self.features))
        scores = two_sided(self.stumps.scores(value))[0]
        first, second = np.argsort(-scores, kind="stable")[:2]
        parts = two_sided(self.stumps.contributions(value[0])) / self.temperature
        part = parts[:, first] - parts[:, second]
        base = two_sided(self.stumps.mean_scores()[None, :])[0] / self.temperature
        used = np.unique(self.stumps.feature)
        order = used[np.argsort(-part[used], kind="stable")]
        return Explanation(
            species=self.classes[first],
            against=self.classes[second],
            log_odds=float(scores[first] - scores[second]) / self.temperature,
            base=float(base[first] - base[second]),
            features=tuple((self.features[f], float(value[0, f]), float(part[f])) for f in order),
        )


@dataclass(frozen=True, eq=False)
class Training:
    """A model, and what it says about scans that were held out while it was calibrated.

    Attributes
    ----------
    model : SpeciesModel
    label : (n,) int64
        True species of the n scans, an index into ``model.classes``.
    fold : (n,) int64
        Fold in which each scan was held out.
    probability : (n, c) float64
        Calibrated probabilities from the stumps of the other folds. The temperature was chosen on them.
    uncalibrated : (n, c) float64
        The same at temperature 1.
    """

    model: SpeciesModel
    label: NDArray[np.int64]
    fold: NDArray[np.int64]
    probability: NDArray[np.float64]
    uncalibrated: NDArray[np.float64]


def train_model(
    x: ArrayLike,
    species: Sequence[str],
    features: Sequence[str],
    *,
    rng: np.random.Generator,
    trees: Sequence[Hashable] | None = None,
    settings: BoostSettings = SPECIES_SETTINGS,
    n_folds: int = 10,
    false_rejection: float = 0.05,
    distance_share: float = DISTANCE_SHARE,
    name: str = "species",
    version: str = "1",
    provenance: Mapping[str, str] | None = None,
    n_threads: int = 1,
) -> Training:
    """Train stumps on all scans; calibrate on scans held out in turn.

    Scans of a species together weigh as much as those of any other, however many they are.

    Parameters
    ----------
    x : (n, f) float
        Features, NaN where missing.
    species : n str
        Species of each scan.
    features : f str
        Names of the features.
    rng : numpy Generator
        Deals trees into folds and draws features.
    trees : n hashable, optional
        Which tree each scan shows; scans of one tree are held out together. Without it each scan is a tree.
    settings : BoostSettings
    n_folds : int
        Parts into which every species' trees are dealt, >= 2. With few, the stumps of a fold know less than
        those of the model, which is then surer than its probabilities say, and rejects less than was asked.
    false_rejection : float
        Share of scans of these species that may be called "none of these", over 0 and under 1.
    distance_share : float
        Share of `false_rejection` that goes to scans far from all that their species has shown, 0 to 1; the
        rest to those that no species claims. More of it rejects more of what is scanned in another way, less
        of it more of other species scanned in the same way.
    name, version, provenance
        Kept in the model.
    n_threads : int
        Threads that train the folds; the result does not depend on it.

    Returns
    -------
    training : Training

    Raises
    ------
    InputError
        If a shape is wrong, there are fewer than 2 species, a species has fewer than 2 trees, or a tree has
        two species.

    Notes
    -----
    ``n_folds + 1`` times the time of one training.
    """
    x = check_features(x, len(features))
    classes, label = np.unique(np.asarray(species, dtype=str), return_inverse=True)
    if label.size != len(x):
        raise InputError(f"species must have one name per scan ({len(x)}), got {label.size}")
    if classes.size < 2:
        raise InputError(f"species must name at least 2 species, got {classes.size}: {', '.join(classes)}")
    fold = _deal(label, list(range(len(x))) if trees is None else list(trees), classes, n_folds, rng)
    parts = list(range(int(fold.max()) + 1))
    own_rng = rng.spawn(len(parts) + 1)

    def held_out(k: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        train, test = fold != k, fold == k
        return _judge(x[train], label[train], x[test], settings, own_rng[k])

    scores, distance = np.empty((len(x), classes.size)), np.empty(len(x))
    with ThreadPoolExecutor(n_threads) as pool:
        for k, (part_scores, part_distance) in zip(parts, pool.map(held_out, parts), strict=True):
            scores[fold == k], distance[fold == k] = part_scores, part_distance
    temperature = fit_temperature(scores, label)
    model = SpeciesModel(
        name=name,
        version=version,
        classes=tuple(str(each) for each in classes),
        features=tuple(features),
        stumps=boost(x, label, _balanced(label), settings, own_rng[-1]).stumps,
        temperature=temperature,
        span=fit_range(x, label, classes.size),
        rejection=fit_rejection(scores.max(axis=1), distance, fold, false_rejection, distance_share),
        provenance=dict(provenance or {}),
    )
    return Training(model, label, fold, to_probabilities(scores, temperature), to_probabilities(scores, 1.0))


def _balanced(label: NDArray[np.int64]) -> NDArray[np.float64]:
    """Weight of each sample: that of all samples of a class is the same for every class, the mean is 1."""
    count = np.bincount(label)
    weight = 1.0 / count[label]
    return weight / weight.mean()


def _judge(
    x: NDArray[np.float64],
    label: NDArray[np.int64],
    test: NDArray[np.float64],
    settings: BoostSettings,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Train on (x, label); return scores (k, c) and distances (k,) of other samples."""
    stumps = boost(x, label, _balanced(label), settings, rng).stumps
    scores = two_sided(stumps.scores(test))
    span = fit_range(x, label, scores.shape[1])
    return scores, span.distance(test, scores.argmax(axis=1), stumps.importances())


def _deal(
    label: NDArray[np.int64],
    trees: list[Hashable],
    classes: NDArray[np.str_],
    n_folds: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Deal every species' trees into folds, like cards; return each scan's fold."""
    if n_folds < 2:
        raise InputError(f"n_folds must be at least 2, got {n_folds}")
    if len(trees) != label.size:
        raise InputError(f"trees must have one entry per scan ({label.size}), got {len(trees)}")
    owner: dict[Hashable, int] = {}
    for tree, own in zip(trees, label, strict=True):
        if owner.setdefault(tree, int(own)) != own:
            raise InputError(
                f"a tree must be of one species, but {tree!r} is {classes[owner[tree]]} and {classes[own]}"
            )
    fold_of: dict[Hashable, int] = {}
    dealt = 0
    for c in range(classes.size):
        own_trees = [tree for tree, own in owner.items() if own == c]
        if len(own_trees) < 2:
            raise InputError(
                f"every species must have scans of at least 2 trees, got {len(own_trees)} of {classes[c]}; "
                "add scans, or leave the species out"
            )
        for at in rng.permutation(len(own_trees)):
            fold_of[own_trees[at]] = dealt % n_folds
            dealt += 1
    return np.array([fold_of[tree] for tree in trees], np.int64)


def _check_names(key: str, names: Sequence[str]) -> None:
    for name in names:
        _check_text(key, name, MOST_NAME)
        if len(name.encode()) > MOST_NAME_BYTES:
            raise InputError(f"{key} must take at most {MOST_NAME_BYTES} bytes in UTF-8, got {name[:50]!r}")
    if len(set(names)) != len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise InputError(f"{key} must differ from each other, but {twice!r} comes twice")


def _check_text(key: str, text: object, most: int = MOST_TEXT) -> None:
    if not isinstance(text, str) or not 1 <= len(text) <= most or not text.isprintable():
        raise InputError(f"{key} must be 1 to {most} printable characters, got {str(text)[:50]!r}")
