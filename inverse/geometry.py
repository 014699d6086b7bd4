"""How far apart the statistics of two trees' branches are.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 5.2 and table 3.

Departs from it in, or reads it as:

- the branches are pieces between forks, see :mod:`inverse.pieces`; the angle to sibling and parent is that
  between their end-point directions, as the slope is;
- the trunk has neither, an only child no sibling: they do not count there;
- slope, bend and angles are told apart to 0.05 radians, straightness to 0.01, lengths and thickness to a
  hundredth of their mean; variances to the squares of these. See :mod:`inverse.comparing`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from inverse.comparing import (
    ANGLE_RESOLUTION,
    LENGTH_RESOLUTION,
    STRAIGHT_RESOLUTION,
    differences,
    minkowski_mean,
)
from inverse.pieces import Pieces, cut_into_pieces
from treegraph import ClusterTree, TreeGraph

__all__ = [
    "GEOMETRIC_DESCRIPTORS",
    "geometric_descriptors",
    "geometric_differences",
    "geometric_distance",
    "piece_properties",
]

PROPERTIES = ("length", "thickness", "bend", "straightness", "slope", "sibling_angle", "parent_angle")
WEIGHTINGS = ("all", "main")  # w' and w'' of the paper: by thickness, by its square
GEOMETRIC_DESCRIPTORS = tuple(
    f"{name}_{moment}_{weighting}"
    for name in PROPERTIES
    for weighting in WEIGHTINGS
    for moment in ("mean", "variance")
)
"""Names of the descriptors: of each property mean and variance, with both weightings."""

_RESOLUTION = {"bend": ANGLE_RESOLUTION, "straightness": STRAIGHT_RESOLUTION, "slope": ANGLE_RESOLUTION,
               "sibling_angle": ANGLE_RESOLUTION, "parent_angle": ANGLE_RESOLUTION}  # fmt: skip
_ANGULAR = ("sibling_angle", "parent_angle")


def piece_properties(tree: TreeGraph | ClusterTree | Pieces) -> dict[str, NDArray[np.float64]]:
    """The seven properties of table 3 of every piece of a tree.

    Parameters
    ----------
    tree : TreeGraph, ClusterTree or Pieces
        One root, all radii known.

    Returns
    -------
    properties : dict of (m,) float64 ndarray
        ``length`` and ``thickness`` (m), ``bend`` (deformation, rad), ``straightness`` (0 to 1, 1 without
        length), ``slope`` (-pi/2 to pi/2, up is positive), ``sibling_angle`` and ``parent_angle`` (0 to pi).
        NaN: the slope without a chord, the angle without a sibling or parent that has one.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`.

    Examples
    --------
    >>> up = [[0, 0, 0], [0, 0, 2], [1, 0, 3], [-1, 0, 3]]
    >>> properties = piece_properties(TreeGraph([-1, 0, 1, 1], up, [0.1] * 4))
    >>> np.degrees(properties["slope"]).round().tolist()
    [90.0, 45.0, 45.0]
    >>> np.degrees(properties["sibling_angle"]).round().tolist()
    [nan, 90.0, 90.0]
    """
    from inverse import _piece_kernels as kernels

    pieces = cut_into_pieces(tree)
    chord = pieces.end - pieces.start
    distance = np.linalg.norm(chord, axis=1)
    to_parent, to_sibling = kernels.angles_between(pieces.parent, chord)
    straight = np.ones(pieces.n_pieces)
    np.divide(distance, pieces.length, out=straight, where=pieces.length > 0.0)
    slope = np.arctan2(chord[:, 2], np.hypot(chord[:, 0], chord[:, 1]))
    return {
        "length": pieces.length,
        "thickness": pieces.thickness,
        "bend": pieces.bend,
        "straightness": np.minimum(straight, 1.0),
        "slope": np.where(distance > 0.0, slope, np.nan),
        "sibling_angle": to_sibling,
        "parent_angle": to_parent,
    }


def geometric_descriptors(tree: TreeGraph | ClusterTree | Pieces) -> NDArray[np.float64]:
    """Mean and variance of the seven properties of table 3, with both weightings.

    The angles to sibling and parent weigh by thickness D, or D^2; the others by D L, or D^2 L, L being the
    length.

    Parameters
    ----------
    tree : TreeGraph, ClusterTree or Pieces
        One root, all radii known.

    Returns
    -------
    descriptors : (28,) float64 ndarray
        In the order of :data:`GEOMETRIC_DESCRIPTORS`; metres and radians, and their squares. NaN where no
        piece has the property, or none any weight.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`.

    Notes
    -----
    O(m) for m pieces, and the square of the number of children at each fork.
    """
    from inverse import _piece_kernels as kernels

    pieces = cut_into_pieces(tree)
    out = []
    for name, value in piece_properties(pieces).items():
        for power in (1, 2):
            weight = pieces.thickness**power
            if name not in _ANGULAR:
                weight = weight * pieces.length
            out += kernels.weighted_moments(value, weight)
    return np.array(out)


def geometric_differences(
    a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces
) -> NDArray[np.float64]:
    """Difference of each descriptor of two trees, 0 to 1, in the order of :data:`GEOMETRIC_DESCRIPTORS`."""
    return compare_descriptors(geometric_descriptors(a), geometric_descriptors(b))


def geometric_distance(a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces) -> float:
    """Geometric distance d_G of two trees (section 5.2).

    Parameters
    ----------
    a, b : TreeGraph, ClusterTree or Pieces
        One root each, all radii known.

    Returns
    -------
    distance : float
        0 (alike) to 1: Minkowski mean of the differences of :func:`geometric_descriptors`.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`.

    Examples
    --------
    >>> pole = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])
    >>> long = pole.replace(position=pole.position * 3)
    >>> geometric_distance(pole, pole), geometric_distance(pole, long) > 0.3
    (0.0, True)
    """
    return minkowski_mean(geometric_differences(a, b))


def compare_descriptors(
    one: NDArray[np.float64], two: NDArray[np.float64], softness: float = 1.0
) -> NDArray[np.float64]:
    """As :func:`geometric_differences`, of descriptors that are there already."""
    resolution = np.empty(one.size)
    for k in range(0, one.size, 2):
        relative = LENGTH_RESOLUTION * min(one[k], two[k])
        finest = _RESOLUTION.get(PROPERTIES[k // 4], relative)
        resolution[k : k + 2] = finest, finest * finest
    return differences(one, two, resolution, softness)
