"""Which species is it? Features of a scan, a classifier that shares them, and the vote of neighbours.

Names that need compiled loops or scikit-learn are imported when they are first used, so that
``import classify`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from classify.boosting import Boosted, BoostSettings, boost
    from classify.calibration import (
        FeatureRange,
        Rejection,
        Reliability,
        calibration_error,
        fit_temperature,
        log_loss,
        reliability,
        to_probabilities,
    )
    from classify.features import FEATURES, Feature, FeatureVector, describe_scan, feature_table
    from classify.jointboost import JointBoostClassifier
    from classify.model import (
        SPECIES_SETTINGS,
        Classification,
        Explanation,
        SpeciesModel,
        Training,
        train_model,
    )
    from classify.model_file import decode_model, encode_model, read_model, shipped_model, write_model
    from classify.stumps import Stumps
    from classify.vote import Vote, is_confident, reliable_ratio, vote_species

_LAZY = {
    "BoostSettings": "boosting",
    "Boosted": "boosting",
    "Classification": "model",
    "Explanation": "model",
    "FEATURES": "features",
    "Feature": "features",
    "FeatureRange": "calibration",
    "FeatureVector": "features",
    "JointBoostClassifier": "jointboost",
    "Rejection": "calibration",
    "Reliability": "calibration",
    "SPECIES_SETTINGS": "model",
    "SpeciesModel": "model",
    "Stumps": "stumps",
    "Training": "model",
    "Vote": "vote",
    "boost": "boosting",
    "calibration_error": "calibration",
    "decode_model": "model_file",
    "describe_scan": "features",
    "encode_model": "model_file",
    "feature_table": "features",
    "fit_temperature": "calibration",
    "is_confident": "vote",
    "log_loss": "calibration",
    "read_model": "model_file",
    "shipped_model": "model_file",
    "reliability": "calibration",
    "to_probabilities": "calibration",
    "train_model": "model",
    "reliable_ratio": "vote",
    "vote_species": "vote",
    "write_model": "model_file",
}

__all__ = [
    "BoostSettings",
    "Boosted",
    "Classification",
    "Explanation",
    "FEATURES",
    "Feature",
    "FeatureRange",
    "FeatureVector",
    "JointBoostClassifier",
    "Rejection",
    "Reliability",
    "SPECIES_SETTINGS",
    "SpeciesModel",
    "Stumps",
    "Training",
    "Vote",
    "boost",
    "calibration_error",
    "decode_model",
    "describe_scan",
    "encode_model",
    "feature_table",
    "fit_temperature",
    "is_confident",
    "log_loss",
    "read_model",
    "shipped_model",
    "reliability",
    "to_probabilities",
    "train_model",
    "reliable_ratio",
    "vote_species",
    "write_model",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"classify.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'classify' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
