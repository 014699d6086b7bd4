"""How far apart the shapes of two trees' crowns are.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 5.1.

Departs from it in, or reads it as:

- leaf branches are the pieces that end in a tip. Each counts as one, spread evenly over its length, so that
  neither sampling nor a twig that reaches through a plane makes a jump;
- the geometric means are those of the heights of leaf branches above the foot, each at least a hundredth of
  the tree's size: of its height, the crown's height or its radius, whatever is largest;
- the radii of a slab are the half axes of the ellipse that, evenly filled, has the same second moments about
  the crown's middle. They belong to the slab's own principal directions: a round crown has none of its own;
- the density is that of leaf branches in the elliptic cylinder of a slab's height and radii;
- lengths are told apart to a hundredth of the smaller tree's size, see :mod:`inverse.comparing`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from inverse.comparing import LENGTH_RESOLUTION, differences, minkowski_mean
from inverse.pieces import Pieces, cut_into_pieces
from treegraph import ClusterTree, TreeGraph

__all__ = ["SHAPE_DESCRIPTORS", "shape_descriptors", "shape_differences", "shape_distance"]

SLABS = ("lower", "middle", "upper")
SHAPE_DESCRIPTORS = (
    "height",
    *(f"{what}_{slab}" for slab in SLABS for what in ("height", "radius_min", "radius_max", "density")),
)
"""Names of the descriptors: of the whole tree its height, of each slab four."""

_IS_LENGTH = np.array([not name.startswith("density") for name in SHAPE_DESCRIPTORS])


def shape_descriptors(tree: TreeGraph | ClusterTree | Pieces) -> NDArray[np.float64]:
    """Height of a tree, and height, radii and density of leaf branches in three slabs of its crown.

    The crown's leaf branches are cut at the geometric mean of their heights; the geometric means of the upper
    and of the lower half are the two planes between the slabs.

    Parameters
    ----------
    tree : TreeGraph, ClusterTree or Pieces
        One root.

    Returns
    -------
    descriptors : (13,) float64 ndarray
        In the order of :data:`SHAPE_DESCRIPTORS`; metres, and leaf branches per cubic metre. A tree of one
        node has zeros.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`.

    Notes
    -----
    O(n). Does not change if the tree is turned about the vertical, moved, or sampled otherwise along its
    segments.

    Examples
    --------
    >>> up = [[0, 0, 0], [0, 0, 2], [1, 0, 4], [-1, 0, 4], [0, 1, 4], [0, -1, 4]]
    >>> tree = TreeGraph([-1, 0, 1, 1, 1, 1], up, [0.1] * 6)
    >>> shape_descriptors(tree)[:4].round(2).tolist()
    [4.0, 0.46, 0.19, 0.19]
    """
    from inverse import _piece_kernels as kernels

    pieces = cut_into_pieces(tree)
    graph = pieces.graph
    out = np.zeros(len(SHAPE_DESCRIPTORS))
    out[0] = height = float(graph.position[:, 2].max() - graph.position[0, 2])
    start, end, weight = _leaf_segments(pieces)
    if not weight.size:
        return out
    whole = kernels.slab_moments(start, end, weight, -math.inf, math.inf)
    centre = whole[1:3] / whole[0]
    bottom, top = (
        float(min(start[:, 2].min(), end[:, 2].min())),
        float(max(start[:, 2].max(), end[:, 2].max())),
    )

    size = max(height, top - bottom, _half_axes(whole, centre)[1])
    least = LENGTH_RESOLUTION * size if size > 0.0 else 1.0

    def mean_height(low: float, high: float) -> float:
        return math.exp(kernels.mean_logarithm(start, end, weight, least, low, high))

    middle = mean_height(-math.inf, math.inf)
    planes = [bottom, mean_height(-math.inf, middle), mean_height(middle, math.inf), top]
    planes[1:3] = [middle if math.isnan(plane) else plane for plane in planes[1:3]]
    cuts = [-math.inf, *planes[1:3], math.inf]
    for k in range(3):
        moments = kernels.slab_moments(start, end, weight, cuts[k], cuts[k + 1])
        thick = max(planes[k + 1] - planes[k], 0.0)
        small, large = _half_axes(moments, centre)
        room = math.pi * max(small, least) * max(large, least) * max(thick, least)
        out[1 + 4 * k : 5 + 4 * k] = thick, small, large, moments[0] / room
    return out


def shape_differences(
    a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces
) -> NDArray[np.float64]:
    """Difference of each descriptor of two trees, 0 to 1, in the order of :data:`SHAPE_DESCRIPTORS`."""
    return compare_descriptors(shape_descriptors(a), shape_descriptors(b))


def shape_distance(a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces) -> float:
    """Shape distance d_S of two trees (section 5.1).

    Parameters
    ----------
    a, b : TreeGraph, ClusterTree or Pieces
        One root each.

    Returns
    -------
    distance : float
        0 (alike) to 1: Minkowski mean of the differences of :func:`shape_descriptors`.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`.

    Examples
    --------
    >>> pole = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])
    >>> tall = pole.replace(position=pole.position * 3)
    >>> shape_distance(pole, pole), shape_distance(pole, tall) > 0.5
    (0.0, True)
    """
    return minkowski_mean(shape_differences(a, b))


def compare_descriptors(
    one: NDArray[np.float64], two: NDArray[np.float64], softness: float = 1.0
) -> NDArray[np.float64]:
    """As :func:`shape_differences`, of descriptors that are there already."""
    size = min(float(one[_IS_LENGTH].max()), float(two[_IS_LENGTH].max()))
    resolution = np.where(_IS_LENGTH, LENGTH_RESOLUTION * size, 0.0)
    return differences(one, two, resolution, softness)


def _leaf_segments(pieces: Pieces) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Both ends of the segments of leaf branches, from the foot on, and each one's part of its branch."""
    from treegraph import _kernels

    graph = pieces.graph
    node = np.flatnonzero((pieces.piece_of >= pieces.n_forks) & (graph.parent >= 0))
    foot = graph.position[0]
    start, end = graph.position[graph.parent[node]] - foot, graph.position[node] - foot
    whole = pieces.length[pieces.piece_of[node]]
    edge = _kernels.edge_length(graph.parent, graph.position)[node]
    is_last = pieces.last[pieces.piece_of[node]] == node
    weight = np.where(whole > 0.0, edge / np.where(whole > 0.0, whole, 1.0), is_last)
    return start, end, weight


def _half_axes(moments: NDArray[np.float64], centre: NDArray[np.float64]) -> tuple[float, float]:
    """Half axes of the evenly filled ellipse with these second moments about a point, the smaller first."""
    weight, x, y, xx, xy, yy = moments
    if not weight > 0.0:
        return 0.0, 0.0
    cx, cy = centre
    a = xx / weight - 2.0 * cx * x / weight + cx * cx
    b = xy / weight - (cx * y + cy * x) / weight + cx * cy
    c = yy / weight - 2.0 * cy * y / weight + cy * cy
    half, spread = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
    return 2.0 * math.sqrt(max(half - spread, 0.0)), 2.0 * math.sqrt(max(half + spread, 0.0))
