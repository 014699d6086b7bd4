"""The tree itself: graph, clusters, allometry, and the ``.lobes`` file format.

Names that need compiled loops are imported when they are first used, so that ``import treegraph``
stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from treegraph.allometry import (
    DEFAULT_ALLOMETRY,
    SPECIES_ALLOMETRY,
    Allometry,
    allometric_radii,
    find_allometry,
)
from treegraph.clustertree import Cluster, ClusterTree
from treegraph.errors import FitError, FormatError, InputError, SapwoodError, TreeError
from treegraph.graph import NO_PARENT, TreeGraph, check_tree, sort_topological, tree_from_unsorted

if TYPE_CHECKING:
    from treegraph.measure import children, count_tips, path_length, segment_length, subtree_length

_LAZY = {
    "children": "measure",
    "count_tips": "measure",
    "path_length": "measure",
    "segment_length": "measure",
    "subtree_length": "measure",
}

__all__ = [
    "DEFAULT_ALLOMETRY",
    "NO_PARENT",
    "SPECIES_ALLOMETRY",
    "Allometry",
    "Cluster",
    "ClusterTree",
    "FitError",
    "FormatError",
    "InputError",
    "SapwoodError",
    "TreeError",
    "TreeGraph",
    "allometric_radii",
    "check_tree",
    "children",
    "count_tips",
    "find_allometry",
    "path_length",
    "segment_length",
    "sort_topological",
    "subtree_length",
    "tree_from_unsorted",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"treegraph.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'treegraph' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
