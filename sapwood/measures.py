"""The figures of a tree that people ask for: heights, crown, wood, counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sapwood.cylinders import cylinder_length, cylinder_volume

if TYPE_CHECKING:
    from treegraph import TreeGraph

__all__ = ["Measures", "crown_base", "crown_width", "measure"]

CROWN_BRANCH_SHARE = 0.02
"""A branch belongs to the crown if it carries at least this share of all the wood's length."""

CROWN_DIRECTIONS = 36
"""Directions over half a turn in which the crown's width is taken."""


@dataclass(frozen=True)
class Measures:
    """What was measured on one tree; None where it could not be.

    Attributes
    ----------
    height_m : float
        Highest point of the scan above the foot of the trunk, metres.
    dbh_m : float or None
        Diameter of the trunk 1.3 m above its foot, metres.
    dbh_method : str
        How the diameter was measured.
    dbh_reason : str or None
        Why there is no diameter.
    crown_width_m : float or None
        Mean horizontal extent of the crown's points over all directions, metres.
    crown_base_m : float or None
        Height above the foot of the trunk at which the lowest branch of the crown leaves it, metres.
        A branch counts if it carries at least 2 % of the wood's length.
    wood_volume_m3 : float
        Volume of the cylinders, cubic metres.
    total_length_m : float
        Length of the cylinders, metres.
    n_nodes, n_tips, n_clusters : int
        Nodes and tips of the graph, leaf clusters.
    """

    height_m: float
    dbh_m: float | None
    dbh_method: str
    dbh_reason: str | None
    crown_width_m: float | None
    crown_base_m: float | None
    wood_volume_m3: float
    total_length_m: float
    n_nodes: int
    n_tips: int
    n_clusters: int


def measure(
    graph: TreeGraph,
    table: NDArray[np.void],
    xyz: NDArray[np.float64],
    *,
    n_clusters: int = 0,
    dbh_m: float | None = None,
    dbh_method: str = "none",
    dbh_reason: str | None = None,
) -> Measures:
    """Measure a tree from its graph, its cylinder table and its points.

    Parameters
    ----------
    graph : TreeGraph
        In the local frame: foot of the trunk at the origin, z up, metres.
    table : (m,) structured ndarray
        The :func:`sapwood.cylinder_table` of `graph`.
    xyz : (n, 3) float64 ndarray
        The tree's points in the local frame; the nodes are taken in their stead if there are none.
    n_clusters, dbh_m, dbh_method, dbh_reason
        Passed on as they are.
    """
    import treegraph

    points = xyz if len(xyz) else graph.position
    base = crown_base(graph)
    return Measures(
        height_m=float(points[:, 2].max()),
        dbh_m=dbh_m,
        dbh_method=dbh_method,
        dbh_reason=dbh_reason,
        crown_width_m=crown_width(points[points[:, 2] >= base]) if base is not None else None,
        crown_base_m=base,
        wood_volume_m3=float(cylinder_volume(table).sum()),
        total_length_m=float(cylinder_length(table).sum()),
        n_nodes=graph.n_nodes,
        n_tips=int(treegraph.count_tips(graph)[graph.parent < 0].sum()),
        n_clusters=n_clusters,
    )


def crown_base(graph: TreeGraph) -> float | None:
    """Height at which the lowest branch of the crown leaves the trunk, metres; None if there is none.

    A branch is a side axis of order 1 that carries at least :data:`CROWN_BRANCH_SHARE` of the length of
    all wood (its own first segment included).
    """
    import treegraph

    parent = graph.parent
    order = np.asarray(treegraph.gravelius_order(graph))
    segment = np.asarray(treegraph.segment_length(graph))
    carried = np.asarray(treegraph.subtree_length(graph)) + segment
    before = np.where(parent >= 0, parent, 0)
    leaves_trunk = (parent >= 0) & (order == 1) & (order[before] == 0)
    leaves_trunk &= carried >= CROWN_BRANCH_SHARE * segment.sum()
    if not leaves_trunk.any():
        return None
    return float(graph.position[before[leaves_trunk], 2].min())


def crown_width(xyz: NDArray[np.float64]) -> float | None:
    """Mean horizontal extent of points over all directions, metres; None without points.

    By Cauchy's formula this is the perimeter of the points' convex outline, seen from above, over pi.

    Examples
    --------
    >>> ring = np.linspace(0.0, 2.0 * np.pi, 361)
    >>> round(crown_width(np.stack([3.0 * np.cos(ring), 3.0 * np.sin(ring), ring], axis=1)), 2)
    6.0
    """
    if not len(xyz):
        return None
    angle = np.arange(CROWN_DIRECTIONS) * (np.pi / CROWN_DIRECTIONS)
    extents = [
        np.ptp(xyz[:, 0] * c + xyz[:, 1] * s) for c, s in zip(np.cos(angle), np.sin(angle), strict=True)
    ]
    return float(np.mean(extents))
