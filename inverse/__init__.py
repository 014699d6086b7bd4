"""From a tree to the numbers that grow its like: how unlike two trees are, and fits of growth parameters.

Names are imported when they are first used, so that ``import inverse`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inverse.annealing import AnnealingSettings
    from inverse.comparing import differences, minkowski_mean
    from inverse.constrained import constrained_edit_distance
    from inverse.crowns import fill_crown
    from inverse.distance import (
        EQUAL_WEIGHTS,
        Comparison,
        Description,
        Weights,
        compare_trees,
        describe_tree,
    )
    from inverse.evolution import EvolutionSettings
    from inverse.fitting import Fit, Progress, fit_trees
    from inverse.geometry import (
        GEOMETRIC_DESCRIPTORS,
        geometric_descriptors,
        geometric_differences,
        geometric_distance,
        piece_properties,
    )
    from inverse.pieces import Pieces, cut_into_pieces
    from inverse.prior import guess_parameters, guess_tip_share
    from inverse.shape import SHAPE_DESCRIPTORS, shape_descriptors, shape_differences, shape_distance
    from inverse.space import SearchSpace, search_space
    from inverse.structure import Mapping, map_pieces, structural_distance
    from inverse.thinning import thin_out

_LAZY = {
    "AnnealingSettings": "annealing",
    "EQUAL_WEIGHTS": "distance",
    "EvolutionSettings": "evolution",
    "Fit": "fitting",
    "GEOMETRIC_DESCRIPTORS": "geometry",
    "SHAPE_DESCRIPTORS": "shape",
    "Comparison": "distance",
    "Description": "distance",
    "Mapping": "structure",
    "Pieces": "pieces",
    "Progress": "fitting",
    "SearchSpace": "space",
    "Weights": "distance",
    "compare_trees": "distance",
    "constrained_edit_distance": "constrained",
    "cut_into_pieces": "pieces",
    "describe_tree": "distance",
    "differences": "comparing",
    "fill_crown": "crowns",
    "fit_trees": "fitting",
    "geometric_descriptors": "geometry",
    "geometric_differences": "geometry",
    "geometric_distance": "geometry",
    "guess_parameters": "prior",
    "guess_tip_share": "prior",
    "map_pieces": "structure",
    "minkowski_mean": "comparing",
    "piece_properties": "geometry",
    "search_space": "space",
    "shape_descriptors": "shape",
    "shape_differences": "shape",
    "shape_distance": "shape",
    "structural_distance": "structure",
    "thin_out": "thinning",
}

__all__ = [
    "AnnealingSettings",
    "EQUAL_WEIGHTS",
    "EvolutionSettings",
    "Fit",
    "GEOMETRIC_DESCRIPTORS",
    "SHAPE_DESCRIPTORS",
    "Comparison",
    "Description",
    "Mapping",
    "Pieces",
    "Progress",
    "SearchSpace",
    "Weights",
    "compare_trees",
    "constrained_edit_distance",
    "cut_into_pieces",
    "describe_tree",
    "differences",
    "fill_crown",
    "fit_trees",
    "geometric_descriptors",
    "geometric_differences",
    "geometric_distance",
    "guess_parameters",
    "guess_tip_share",
    "map_pieces",
    "minkowski_mean",
    "piece_properties",
    "search_space",
    "shape_descriptors",
    "shape_differences",
    "shape_distance",
    "structural_distance",
    "thin_out",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"inverse.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'inverse' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
