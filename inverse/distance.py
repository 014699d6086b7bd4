"""One number for how unlike two trees are, its three parts, and what became of which.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 5. Departs from it in: nothing that is not said in :mod:`inverse.shape`, :mod:`inverse.geometry` and
:mod:`inverse.structure`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inverse import geometry, shape, structure
from inverse.comparing import minkowski_mean
from inverse.pieces import Pieces, cut_into_pieces
from inverse.structure import Mapping
from treegraph import ClusterTree, InputError, TreeGraph

if TYPE_CHECKING:
    from inverse._edit_kernels import EditTree

__all__ = ["EQUAL_WEIGHTS", "Comparison", "Description", "Weights", "compare_trees", "describe_tree"]


@dataclass(frozen=True)
class Weights:
    """How much each part counts: each 0 to 1, all together 1.

    Attributes
    ----------
    shape, geometry, structure : float
        w_S, w_G and w_T. Equal by default, as in the paper.

    Raises
    ------
    InputError
        If one is out of its range, or they do not add up to 1.
    """

    shape: float = 1.0 / 3.0
    geometry: float = 1.0 / 3.0
    structure: float = 1.0 / 3.0

    def __post_init__(self) -> None:
        values = (self.shape, self.geometry, self.structure)
        if not all(0.0 <= value <= 1.0 for value in values) or abs(sum(values) - 1.0) > 1e-6:
            got = ", ".join(map(str, values))
            raise InputError(f"weights must be three numbers from 0 to 1 that add up to 1, got {got}")

    def mean(self, shape_part: float, geometry_part: float, structure_part: float) -> float:
        """The weighted sum of three distances."""
        return self.shape * shape_part + self.geometry * geometry_part + self.structure * structure_part


EQUAL_WEIGHTS = Weights()


@dataclass(frozen=True, eq=False)
class Description:
    """What has to be known of a tree to compare it with many others; made once by :func:`describe_tree`.

    Attributes
    ----------
    pieces : Pieces
    shape : (13,) float64
        :func:`inverse.shape_descriptors`.
    geometry : (28,) float64
        :func:`inverse.geometric_descriptors`.
    edit : EditTree
        Arrays of the structural distance.
    """

    pieces: Pieces
    shape: NDArray[np.float64]
    geometry: NDArray[np.float64]
    edit: EditTree


@dataclass(frozen=True, eq=False)
class Comparison:
    """How unlike two trees are.

    Attributes
    ----------
    distance : float
        D_T, 0 (alike) to 1: the weighted sum of the next three.
    shape, geometry, structure : float
        d_S, d_G and d_T, 0 to 1 each.
    weights : Weights
    shape_parts : dict of float
        Difference of each descriptor of the shape, 0 to 1, by its name in :data:`inverse.SHAPE_DESCRIPTORS`.
    geometry_parts : dict of float
        The same of :data:`inverse.GEOMETRIC_DESCRIPTORS`.
    mapping : Mapping
        Which pieces of the one became which of the other.
    """

    distance: float
    shape: float
    geometry: float
    structure: float
    weights: Weights
    shape_parts: dict[str, float]
    geometry_parts: dict[str, float]
    mapping: Mapping

    def __repr__(self) -> str:
        return (
            f"<Comparison {self.distance:.4f}: shape {self.shape:.4f}, geometry {self.geometry:.4f}, "
            f"structure {self.structure:.4f}>"
        )


def describe_tree(tree: TreeGraph | ClusterTree | Pieces | Description) -> Description:
    """What :func:`compare_trees` needs of a tree, so that it is made only once if the tree is compared often.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`, or if the tree has more than 2 10^7 runs of pieces.
    """
    if isinstance(tree, Description):
        return tree
    pieces = cut_into_pieces(tree)
    return Description(
        pieces,
        shape.shape_descriptors(pieces),
        geometry.geometric_descriptors(pieces),
        structure.edit_tree(pieces),
    )


def compare_trees(
    a: TreeGraph | ClusterTree | Pieces | Description,
    b: TreeGraph | ClusterTree | Pieces | Description,
    *,
    weights: Weights = EQUAL_WEIGHTS,
) -> Comparison:
    """Compare two trees: the similarity measure D_T of [1]_ with its parts.

    Parameters
    ----------
    a, b : TreeGraph, ClusterTree, Pieces or Description
        One root each, all radii known. Of a ClusterTree only the graph counts, not its leaf clusters.
    weights : Weights
        How much shape, geometry and structure count.

    Returns
    -------
    comparison : Comparison
        Symmetric in a and b. It does not change if a tree is turned about the vertical, moved, or its
        children are reordered, and hardly if it is sampled more finely; it does if the tree is tilted or
        scaled.

    Raises
    ------
    InputError
        If a tree has several roots or unknown radii, or is too large (:func:`inverse.structural_distance`).

    Notes
    -----
    docs/similarity.md has what each part looks at, and how long it takes.

    References
    ----------
    .. [1] O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014.

    Examples
    --------
    >>> pole = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])
    >>> compare_trees(pole, pole)
    <Comparison 0.0000: shape 0.0000, geometry 0.0000, structure 0.0000>
    """
    one, two = describe_tree(a), describe_tree(b)
    shape_parts = shape.compare_descriptors(one.shape, two.shape)
    geometry_parts = geometry.compare_descriptors(one.geometry, two.geometry)
    structure_part, mapping = structure.mapping_of(one.pieces, one.edit, two.pieces, two.edit)
    parts = minkowski_mean(shape_parts), minkowski_mean(geometry_parts), structure_part
    return Comparison(
        weights.mean(*parts), *parts, weights,
        dict(zip(shape.SHAPE_DESCRIPTORS, shape_parts.tolist(), strict=True)),
        dict(zip(geometry.GEOMETRIC_DESCRIPTORS, geometry_parts.tolist(), strict=True)), mapping,
    )  # fmt: skip
