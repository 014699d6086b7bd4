"""From scans to their description by numbers, and to what a trained model says of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sapwood.batch import DONE, Job, Outcome, guarded
from treegraph.errors import InputError

if TYPE_CHECKING:
    from classify import FeatureVector, SpeciesModel
    from sapwood.pipeline import Reconstruction

__all__ = ["check_model", "describe_job", "features_of", "say_species"]

N_SPOKEN = 5
"""Most features that are named as having spoken for a species."""


def features_of(reconstruction: Reconstruction) -> FeatureVector:
    """Describe the tree of a reconstruction by the numbers that species are told apart by.

    Parameters
    ----------
    reconstruction : Reconstruction
        Made with the default allometry; that of a species changes the skeleton, and with it some numbers.

    Returns
    -------
    FeatureVector
        Of its points, its skeleton and its clusters: see :func:`classify.describe_scan`.

    Raises
    ------
    InputError
        If it has fewer than 10 points.

    Examples
    --------
    >>> import sapwood
    >>> tree = sapwood.reconstruct("samples/itsme_tls_tree2.laz")
    >>> round(sapwood.features_of(tree)["height"], 1)
    17.9
    """
    from classify import describe_scan

    return describe_scan(reconstruction.cloud.xyz, reconstruction.tree)


def describe_job(job: Job, progress: Callable[[str], object] | None = None) -> Outcome:
    """Reconstruct a scan with the default allometry and describe it; a failure is an outcome.

    The outcome's report has ``features``, (f,) float64 in the order of :data:`classify.FEATURES`, and
    ``notes``, the remarks on the scan.
    """

    def work() -> Outcome:
        from sapwood.pipeline import reconstruct

        tree = reconstruct(job.scan, progress=progress, **job.options)
        if progress is not None:
            progress("describe")
        try:
            features = features_of(tree)
        except InputError as error:
            raise InputError(f"{job.scan}: {error}") from error
        return Outcome(job, DONE, report={"features": features.array, "notes": list(tree.notes)})

    return guarded(job, work)


def check_model(model: SpeciesModel) -> None:
    """Raise InputError if the model looks at a feature that is not computed here."""
    from classify import FEATURES

    known = {feature.name for feature in FEATURES}
    missing = [name for name in model.features if name not in known]
    if missing:
        raise InputError(
            f"the model looks at {missing[0]!r}, a feature that this version does not compute "
            f"({len(missing)} such); train it anew with `sapwood species train`."
        )


def say_species(model: SpeciesModel, features: NDArray[np.float64]) -> dict[str, Any]:
    """What a model says of one scan.

    Parameters
    ----------
    model : SpeciesModel
    features : (f,) float64
        In the order of :data:`classify.FEATURES`.

    Returns
    -------
    dict
        ``species`` (None: none of these), ``probability`` of the most probable species, ``probabilities`` of
        all, the most probable first, and ``features``: at most 5 with ``name``, ``unit``, ``value`` (None
        where missing) and ``part``, their part of the log-odds against the runner-up, which is over 0; the
        largest first.

    Raises
    ------
    InputError
        As :func:`check_model`.
    """
    from classify import FEATURES

    check_model(model)
    place = {feature.name: k for k, feature in enumerate(FEATURES)}
    x = np.asarray(features, np.float64)[[place[name] for name in model.features]]
    said, why = model.classify(x[None, :]), model.explain(x)
    order = np.argsort(-said.probability[0], kind="stable")
    return {
        "species": said.species[0],
        "probability": float(said.probability[0].max()),
        "probabilities": {model.classes[k]: float(said.probability[0, k]) for k in order},
        "features": [
            {
                "name": name,
                "unit": FEATURES[place[name]].unit,
                "value": None if math.isnan(value) else value,
                "part": part,
            }
            for name, value, part in why.features[:N_SPOKEN]
            if part > 0.0
        ],
    }
