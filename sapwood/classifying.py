"""From scans to their description by numbers, and to what a trained model says of them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sapwood.batch import DONE, Job, Outcome, guarded
from treegraph.errors import InputError

if TYPE_CHECKING:
    from classify import FeatureVector, SpeciesModel
    from recon import Encoding
    from sapwood.pipeline import Reconstruction

__all__ = ["check_model", "describe_job", "features_of", "find_model", "recognise", "say_species"]

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
    >>> tree = sapwood.reconstruct("samples/itsme_tls_tree2.laz", species=None)
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

        tree = reconstruct(job.scan, species=None, progress=progress, **job.options)
        if progress is not None:
            progress("describe")
        try:
            features = features_of(tree)
        except InputError as error:
            raise InputError(f"{job.scan}: {error}") from error
        return Outcome(job, DONE, report={"features": features.array, "notes": list(tree.notes)})

    return guarded(job, work)


def find_model(model: str | os.PathLike[str] | SpeciesModel | None = None) -> SpeciesModel:
    """A model, the model of a file, or the one that comes along, if its features are computed here.

    Raises
    ------
    InputError, FormatError, OSError
        If the file cannot be read or is no model, or a feature is missing.
    """
    from classify import SpeciesModel, read_model, shipped_model

    if isinstance(model, SpeciesModel):
        check_model(model)
        return model
    if model is None:
        return shipped_model()
    found = read_model(model)
    try:
        check_model(found)
    except InputError as error:
        raise InputError(f"{os.fspath(model)}: {error}") from None
    return found


def recognise(encoding: Encoding, model: SpeciesModel) -> dict[str, Any]:
    """What a model says of a tree made with the default allometry, and whether that is to be believed.

    Returns
    -------
    dict
        As :func:`say_species`, ``model`` (name and version), and ``taken``: the tree is none of those that
        the model does not know, and its species is more than 1.5 times as probable as the next (thesis
        3.5.1). Of fewer than 10 points nothing is said: ``species`` and ``probability`` are None.
    """
    from classify import describe_scan, is_confident

    name = f"{model.name}, {model.version}"
    try:
        features = describe_scan(encoding.cloud.xyz, encoding.tree)
    except InputError:
        nothing: dict[str, Any] = {"species": None, "probability": None, "probabilities": {}, "features": []}
        return {**nothing, "taken": False, "model": name}
    said = say_species(model, features.array)
    sure = bool(is_confident([list(said["probabilities"].values())])[0])
    return {**said, "taken": said["species"] is not None and sure, "model": name}


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
