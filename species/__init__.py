"""What a species is: growth parameters, the developmental growth model, and L-systems.

Names that need compiled loops are imported when they are first used, so that ``import species``
stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from species.errors import DerivationError, GrammarError
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
    from species.lsystem import (
        DerivationLimits,
        Drawing,
        Grammar,
        LeafPlacements,
        TurtleSettings,
        Word,
        derive_word,
        draw_word,
        parse_grammar,
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
    from species.patches import Instances, Patch
    from species.texturing import PatchTable, Texture, pack_patches, texture_tree

_LAZY = {
    "Instances": "patches",
    "Patch": "patches",
    "PatchTable": "texturing",
    "Texture": "texturing",
    "pack_patches": "texturing",
    "texture_tree": "texturing",
    "DerivationError": "errors",
    "DerivationLimits": "lsystem",
    "Drawing": "lsystem",
    "Grammar": "lsystem",
    "GrammarError": "errors",
    "GrownTree": "growth",
    "GrowthParameters": "parameters",
    "GrowthSettings": "growth",
    "History": "growth",
    "LeafPlacements": "lsystem",
    "LeafSet": "foliage",
    "Plant": "growth",
    "Preset": "parameters",
    "Site": "growth",
    "TurtleSettings": "lsystem",
    "Word": "lsystem",
    "derive_word": "lsystem",
    "draw_word": "lsystem",
    "find_preset": "parameters",
    "format_growth": "parameters",
    "gather_clusters": "foliage",
    "grow": "growth",
    "grow_many": "growth",
    "grow_stand": "growth",
    "parameter_table": "parameters",
    "parse_grammar": "lsystem",
    "place_leaves": "foliage",
    "presets": "parameters",
    "read_growth": "parameters",
}

__all__ = [
    "Instances",
    "Patch",
    "PatchTable",
    "Texture",
    "pack_patches",
    "texture_tree",
    "DerivationError",
    "DerivationLimits",
    "Drawing",
    "Grammar",
    "GrammarError",
    "GrownTree",
    "GrowthParameters",
    "GrowthSettings",
    "History",
    "LeafPlacements",
    "LeafSet",
    "Plant",
    "Preset",
    "Site",
    "TurtleSettings",
    "Word",
    "derive_word",
    "draw_word",
    "find_preset",
    "format_growth",
    "gather_clusters",
    "grow",
    "grow_many",
    "grow_stand",
    "parameter_table",
    "parse_grammar",
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
