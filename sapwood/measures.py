"""The figures of a tree that people ask for: heights, crown, wood, counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sapwood.cylinders import cylinder_length, cylinder_volume

if TYPE_CHECKING:
    from treegraph import ClusterTree, TreeGraph

__all__ = ["Measures", "crown_base", "crown_width", "measure"]

CROWN_SHARE = 0.02
"""The crown begins where this share of all leaf points, or a branch of this share of all wood, is reached."""

CROWN_DIRECTIONS = 36
"""Directions over half a turn in which the crown's width is taken."""


@dataclass(frozen=True)
class Measures:
    """What was measured on one tree; None where it could not be.

    Attributes
    ----------
    height_m : float
        Highest point of the tree above the foot of its trunk, metres.
    dbh_m : float or None
        Diameter of the trunk 1.3 m above its foot, metres.
    dbh_method : str
        ``"circle"`` (fitted to the points there), ``"tube"`` (the modelled trunk) or ``"none"``.
    dbh_reason : str or None
        Why there is no diameter, or why it is not from a circle.
    dbh_arc : float
        Share of the trunk's round on which the circle has points, 0 to 1.
    crown_width_m : float or None
        Mean horizontal extent over all directions of the points above the crown's base, metres.
    crown_base_m : float or None
        Height of the crown's base above the foot of the trunk, metres; see :func:`crown_base`.
    wood_volume_m3 : float
        Volume of the cylinders, cubic metres: trunk and branches as far as they are modelled.
    total_length_m : float
        Length of the cylinders, metres.
    n_nodes, n_tips, n_clusters : int
        Nodes and tips of the graph, leaf clusters.
    """

    height_m: float
    dbh_m: float | None
    dbh_method: str
    dbh_reason: str | None
    dbh_arc: float
    crown_width_m: float | None
    crown_base_m: float | None
    wood_volume_m3: float
    total_length_m: float
    n_nodes: int
    n_tips: int
    n_clusters: int


def measure(
    tree: ClusterTree,
    table: NDArray[np.void],
    xyz: NDArray[np.float64],
    *,
    dbh_m: float | None = None,
    dbh_method: str = "none",
    dbh_reason: str | None = None,
    dbh_arc: float = 0.0,
) -> Measures:
    """Measure a tree from its graph, its clusters, its cylinder table and its points.

    Parameters
    ----------
    tree : ClusterTree
        In the local frame: foot of the trunk at the origin, z up, metres.
    table : (m,) structured ndarray
        The :func:`sapwood.cylinder_table` of its graph.
    xyz : (n, 3) float64 ndarray
        The tree's points in the local frame; nodes and hulls are taken in their stead if there are none.
    dbh_m, dbh_method, dbh_reason, dbh_arc
        Passed on as they are.
    """
    import treegraph

    graph = tree.graph
    points = xyz if len(xyz) else np.concatenate([graph.position, *(c.vertices for c in tree.clusters)])
    base = crown_base(tree)
    return Measures(
        height_m=float(points[:, 2].max()),
        dbh_m=None if dbh_m is None else float(dbh_m),
        dbh_method=dbh_method,
        dbh_reason=dbh_reason,
        dbh_arc=float(dbh_arc),
        crown_width_m=crown_width(points[points[:, 2] >= base]) if base is not None else None,
        crown_base_m=base,
        wood_volume_m3=float(cylinder_volume(table).sum()),
        total_length_m=float(cylinder_length(table).sum()),
        n_nodes=graph.n_nodes,
        n_tips=int(treegraph.count_tips(graph)[graph.parent < 0].sum()),
        n_clusters=len(tree.clusters),
    )


def crown_base(tree: ClusterTree) -> float | None:
    """Height above the foot of the trunk at which the crown begins, metres; None if there is no crown.

    With leaf clusters: the lowest point of the cluster with which the clusters, taken from the lowest up,
    hold :data:`CROWN_SHARE` of all their points, so that a tuft at the foot does not count.
    Without: the height at which the lowest branch leaves the trunk (side axis of order 1) that carries
    :data:`CROWN_SHARE` of the length of all wood.
    """
    if tree.clusters:
        bottom = np.array([c.vertices[:, 2].min() if len(c.vertices) else np.inf for c in tree.clusters])
        n_points = np.array([c.n_points for c in tree.clusters], np.float64)
        order = np.argsort(bottom, kind="stable")
        reached = np.cumsum(n_points[order]) >= CROWN_SHARE * n_points.sum()
        lowest = float(bottom[order[np.argmax(reached)]])
        if np.isfinite(lowest):
            return max(lowest, 0.0)
    return _lowest_branch(tree.graph)


def _lowest_branch(graph: TreeGraph) -> float | None:
    """Height at which the lowest branch of some length leaves the trunk, metres; None if none does."""
    import treegraph

    parent = graph.parent
    order = np.asarray(treegraph.gravelius_order(graph))
    segment = np.asarray(treegraph.segment_length(graph))
    carried = np.asarray(treegraph.subtree_length(graph)) + segment
    before = np.where(parent >= 0, parent, 0)
    leaves_trunk = (parent >= 0) & (order == 1) & (order[before] == 0)
    leaves_trunk &= carried >= CROWN_SHARE * segment.sum()
    if not leaves_trunk.any():
        return None
    return max(float(graph.position[before[leaves_trunk], 2].min()), 0.0)


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
