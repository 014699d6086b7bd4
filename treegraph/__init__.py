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
from treegraph.clustertree import Cluster, ClusterTree, hull_volumes
from treegraph.errors import FitError, FormatError, InputError, SapwoodError, TreeError
from treegraph.graph import NO_PARENT, TreeGraph, check_tree, sort_topological, tree_from_unsorted

if TYPE_CHECKING:
    from treegraph.edit import prune, resample, simplify, simplify_nodes, take_nodes, transform
    from treegraph.light import (
        Branches,
        Leaves,
        Light,
        Occluders,
        Sky,
        branches_of,
        gather_light,
        gather_light_exact,
        join_occluders,
        make_leaves,
    )
    from treegraph.lobes import decode_lobes, encode_lobes, read_lobes, write_lobes
    from treegraph.measure import children, count_tips, path_length, segment_length, subtree_length
    from treegraph.obstacles import Ball, Box, HalfSpace, TriangleMesh, make_wall
    from treegraph.order import chains, continue_axis, gravelius_order
    from treegraph.swc import read_swc, write_swc

_LAZY = {
    "Branches": "light",
    "Leaves": "light",
    "Light": "light",
    "Occluders": "light",
    "Sky": "light",
    "branches_of": "light",
    "gather_light": "light",
    "gather_light_exact": "light",
    "join_occluders": "light",
    "make_leaves": "light",
    "Ball": "obstacles",
    "Box": "obstacles",
    "HalfSpace": "obstacles",
    "TriangleMesh": "obstacles",
    "make_wall": "obstacles",
    "chains": "order",
    "children": "measure",
    "continue_axis": "order",
    "count_tips": "measure",
    "gravelius_order": "order",
    "path_length": "measure",
    "decode_lobes": "lobes",
    "encode_lobes": "lobes",
    "prune": "edit",
    "read_lobes": "lobes",
    "read_swc": "swc",
    "resample": "edit",
    "segment_length": "measure",
    "simplify": "edit",
    "simplify_nodes": "edit",
    "subtree_length": "measure",
    "take_nodes": "edit",
    "transform": "edit",
    "write_lobes": "lobes",
    "write_swc": "swc",
}

__all__ = [
    "DEFAULT_ALLOMETRY",
    "NO_PARENT",
    "SPECIES_ALLOMETRY",
    "Allometry",
    "Ball",
    "Box",
    "Branches",
    "Cluster",
    "ClusterTree",
    "hull_volumes",
    "FitError",
    "FormatError",
    "HalfSpace",
    "InputError",
    "Leaves",
    "Light",
    "Occluders",
    "SapwoodError",
    "Sky",
    "TreeError",
    "TreeGraph",
    "TriangleMesh",
    "allometric_radii",
    "branches_of",
    "chains",
    "check_tree",
    "children",
    "continue_axis",
    "count_tips",
    "decode_lobes",
    "encode_lobes",
    "find_allometry",
    "gather_light",
    "gather_light_exact",
    "gravelius_order",
    "join_occluders",
    "make_leaves",
    "make_wall",
    "path_length",
    "prune",
    "read_lobes",
    "read_swc",
    "resample",
    "segment_length",
    "simplify",
    "simplify_nodes",
    "sort_topological",
    "subtree_length",
    "take_nodes",
    "transform",
    "tree_from_unsorted",
    "write_lobes",
    "write_swc",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"treegraph.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'treegraph' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
