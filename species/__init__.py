"""What a species is: growth parameters and the developmental growth model.

Names that need compiled loops are imported when they are first used, so that ``import species``
stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from species.foliage import LeafSet, gather_clusters, place_leaves
    from species.growth import (
        GrownTree,
        GrowthSettings,
        History,
        Plant,
        Site,
        grow,
        grow_many,
        grow_stand,
    )
    from species.parameters import (
        GrowthParameters,
        Preset,
        find_preset,
        format_growth,
        parameter_table,
        presets,
        read_growth,
    )

_LAZY = {
    "GrownTree": "growth",
    "GrowthParameters": "parameters",
    "GrowthSettings": "growth",
    "History": "growth",
    "LeafSet": "foliage",
    "Plant": "growth",
    "Preset": "parameters",
    "Site": "growth",
    "find_preset": "parameters",
    "format_growth": "parameters",
    "gather_clusters": "foliage",
    "grow": "growth",
    "grow_many": "growth",
    "grow_stand": "growth",
    "parameter_table": "parameters",
    "place_leaves": "foliage",
    "presets": "parameters",
    "read_growth": "parameters",
}

__all__ = [
    "GrownTree",
    "GrowthParameters",
    "GrowthSettings",
    "History",
    "LeafSet",
    "Plant",
    "Preset",
    "Site",
    "find_preset",
    "format_growth",
    "gather_clusters",
    "grow",
    "grow_many",
    "grow_stand",
    "parameter_table",
    "place_leaves",
    "presets",
    "read_growth",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"species.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'species' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
