"""Plastic trees: a tree bends, sheds and thins as if it had grown in other surroundings.

Names that need compiled loops are imported when they are first used, so that ``import plastic``
stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plastic.adapted import BY_LIGHT, BY_OBSTACLE, Adapted, light_density
    from plastic.analysis import AnalysisSettings, PlasticState, analyse
    from plastic.crowns import Crown, grow_crown
    from plastic.scene import Neighbour, Scene, SceneFile, SceneTree, parse_scene, read_scene
    from plastic.seasons import Seasons, branch_ages, growth_rates, internode_length, seasons_of
    from plastic.stand import Session, adapt_stand
    from plastic.tropism import Tropisms, invert_tropism, lean_of, tropism_direction

_LAZY = {
    "BY_LIGHT": "adapted",
    "BY_OBSTACLE": "adapted",
    "Adapted": "adapted",
    "AnalysisSettings": "analysis",
    "Crown": "crowns",
    "Neighbour": "scene",
    "PlasticState": "analysis",
    "Scene": "scene",
    "SceneFile": "scene",
    "SceneTree": "scene",
    "Seasons": "seasons",
    "Session": "stand",
    "Tropisms": "tropism",
    "adapt_stand": "stand",
    "analyse": "analysis",
    "branch_ages": "seasons",
    "grow_crown": "crowns",
    "growth_rates": "seasons",
    "internode_length": "seasons",
    "invert_tropism": "tropism",
    "lean_of": "tropism",
    "light_density": "adapted",
    "parse_scene": "scene",
    "read_scene": "scene",
    "seasons_of": "seasons",
    "tropism_direction": "tropism",
}

__all__ = [
    "BY_LIGHT",
    "BY_OBSTACLE",
    "Adapted",
    "AnalysisSettings",
    "Crown",
    "Neighbour",
    "PlasticState",
    "Scene",
    "SceneFile",
    "SceneTree",
    "Seasons",
    "Session",
    "Tropisms",
    "adapt_stand",
    "analyse",
    "branch_ages",
    "grow_crown",
    "growth_rates",
    "internode_length",
    "invert_tropism",
    "lean_of",
    "light_density",
    "parse_scene",
    "read_scene",
    "seasons_of",
    "tropism_direction",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"plastic.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'plastic' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
