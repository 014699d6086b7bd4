"""Which species is it? Features of a scan, a classifier that shares them, and the vote of neighbours.

Names that need compiled loops or scikit-learn are imported when they are first used, so that
``import classify`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from classify.boosting import BoostSettings, Boosted, boost
    from classify.jointboost import JointBoostClassifier
    from classify.stumps import Stumps
    from classify.vote import Vote, is_confident, vote_species

_LAZY = {
    "BoostSettings": "boosting",
    "Boosted": "boosting",
    "JointBoostClassifier": "jointboost",
    "Stumps": "stumps",
    "Vote": "vote",
    "boost": "boosting",
    "is_confident": "vote",
    "vote_species": "vote",
}

__all__ = [
    "BoostSettings",
    "Boosted",
    "JointBoostClassifier",
    "Stumps",
    "Vote",
    "boost",
    "is_confident",
    "vote_species",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"classify.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'classify' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
