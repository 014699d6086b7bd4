"""Branches where a scan saw only leaves: a skeleton that ends where its clusters begin grows on into them.

Based on: A. Runions, B. Lane, P. Prusinkiewicz, "Modeling Trees with a Space Colonization Algorithm",
Eurographics Workshop on Natural Phenomena, 2007; S. Pirk, "Efficient Processing of Plant Life in Computer
Graphics", dissertation, University of Konstanz, 2013, Eq. 5.6 (pipe model).

Departs from it in: the places that branches are drawn to fill the clusters on a grid, shifted by halves from
layer to layer, so that nothing is random. All places of a radius of influence are there from the beginning.
Each place draws the nearest node within reach; while none is within reach, the reach grows. New branches are
as thick as the pipe model has them from the foot of the trunk; what was measured stays, unless it would be
thinner than what it carries.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from treegraph import Cluster, ClusterTree, InputError, TreeGraph

__all__ = ["fill_crown"]

PLACES = 1000
STEP = 0.5  # length of a new segment, in the distance of places
KILL = 0.9  # a place that a node has come so near is reached
REACH = 3.0  # within which a place draws a node at first
WIDER = 1.5  # by which the reach grows where it holds none
WANTED = 0.2  # of the places have to lie beyond KILL from the skeleton, or it fills its crown already
MOST_STEPS = 2000
PIPE = 2.49  # exponent of the pipe model (thesis, Eq. 5.6)
TURN = 1e-3  # of a direction: nodes that are drawn to both sides alike would stand still
FINEST = 64  # cells along a hull's longest side


def fill_crown(tree: ClusterTree, *, places: int = PLACES) -> TreeGraph:
    """The graph of a tree, with branches into its leaf clusters where it does not reach them.

    Parameters
    ----------
    tree : ClusterTree
        One root, all radii known.
    places : int, default 1000
        About how many places of the clusters are to be reached, 1 to 5000: how finely the crown branches.

    Returns
    -------
    graph : TreeGraph
        Nodes of the tree come first, as they are; only radii may be larger. Without clusters, or if its
        branches reach most of their clusters already, it is the tree's own.

    Raises
    ------
    InputError
        If `places` is out of its range.

    Notes
    -----
    The same tree gives the same branches; nothing is random.
    """
    if not 1 <= places <= 5000:
        raise InputError(f"places must be a whole number from 1 to 5000, got {places!r}")
    graph = tree.graph
    hulls = [cluster for cluster in tree.clusters if len(cluster.faces)]
    if not hulls or graph.n_nodes < 2:
        return graph
    place, spacing = _places(hulls, places)
    if not len(place):
        return graph
    first = _beyond(_along(graph, 0.5 * spacing), place, KILL * spacing)
    if first.mean() < WANTED:
        return graph
    parent, position = _colonise(graph, place[first], spacing)
    radius = np.concatenate([graph.radius, np.zeros(len(parent) - graph.n_nodes)])
    above = np.array(parent, np.int32)
    return TreeGraph(above, position, _thicken(above, radius, graph.n_nodes))


def _places(hulls: list[Cluster], wanted: int) -> tuple[NDArray[np.float64], float]:
    """Places that fill the hulls evenly, (p, 3), and how far apart they are."""
    from treegraph import hull_volumes

    volume = float(hull_volumes(hulls).sum())
    if not volume > 0.0:
        return np.empty((0, 3)), 1.0
    spacing = (volume / wanted) ** (1.0 / 3.0)
    found = [_inside(hull, spacing) for hull in hulls]
    return np.concatenate(found), spacing


def _inside(hull: Cluster, spacing: float) -> NDArray[np.float64]:
    """Places of a grid in a hull, whose rows are shifted by halves; its middle if it holds none."""
    from species._space_kernels import fill_columns

    vertices = np.ascontiguousarray(hull.vertices, np.float64)
    low, extent = vertices.min(axis=0), np.ptp(vertices, axis=0)
    cell = max(spacing / 2.0, float(extent.max()) / FINEST)
    size = np.maximum(np.ceil(extent / cell).astype(np.int64), 1)
    n_x, n_y, n_z = (int(n) for n in size)
    inside = np.zeros(n_x * n_y * n_z, np.bool_)
    fill_columns(vertices, np.ascontiguousarray(hull.faces), low, cell, n_x, n_y, n_z, inside)
    at = np.argwhere(inside.reshape(n_x, n_y, n_z))
    every = max(round(spacing / cell), 1)
    shift = (at[:, 2] // every) % 2 * (every // 2)
    chosen = at[
        ((at[:, 0] + shift) % every == 0) & ((at[:, 1] + shift) % every == 0) & (at[:, 2] % every == 0)
    ]
    if not len(chosen):
        return vertices.mean(axis=0)[None]
    return low + (chosen + 0.5) * cell


def _along(graph: TreeGraph, step: float) -> NDArray[np.float64]:
    """Points along the branches, no farther apart than a step."""
    start, end = graph.position[graph.parent[1:]], graph.position[1:]
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / step).astype(np.int64), 1)
    which = np.repeat(np.arange(len(count)), count)
    at = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[which]
    return np.concatenate([graph.position[:1], start[which] + at[:, None] * (end - start)[which]])


def _beyond(position: NDArray[np.float64], place: NDArray[np.float64], reach: float) -> NDArray[np.bool_]:
    """Which places have no node within reach."""
    from scipy.spatial import cKDTree

    return np.isinf(cKDTree(position).query(place, distance_upper_bound=reach)[0])


def _colonise(
    graph: TreeGraph, place: NDArray[np.float64], spacing: float
) -> tuple[list[int], NDArray[np.float64]]:
    """Parents and positions of the tree's nodes and of new ones that grow towards the places."""
    from scipy.spatial import cKDTree

    parent = graph.parent.tolist()
    position = graph.position
    step, reach = STEP * spacing, REACH * spacing
    for _ in range(MOST_STEPS):
        if not len(place):
            break
        far, node = cKDTree(position).query(place, distance_upper_bound=reach)
        drawn = np.isfinite(far)
        if not drawn.any():
            reach *= WIDER
            continue
        way = (place[drawn] - position[node[drawn]]) / far[drawn][:, None]
        which, back = np.unique(node[drawn], return_inverse=True)
        total = np.zeros((len(which), 3))
        np.add.at(total, back, way)
        total += TURN * way[np.unique(back, return_index=True)[1]]
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
        new = position[which] + step * total
        fresh = _beyond(position, new, 0.2 * step)  # else it would grow the same segment again
        if not fresh.any():
            nearest = np.argmin(far)  # one place draws alone, or it is never reached
            which, new = node[[nearest]], place[[nearest]]
            fresh = np.ones(1, bool)
        parent += which[fresh].tolist()
        position = np.concatenate([position, new[fresh]])
        place = place[_beyond(new[fresh], place, KILL * spacing)]
    return parent, position


def _thicken(parent: NDArray[np.int32], radius: NDArray[np.float64], known: int) -> NDArray[np.float64]:
    """Radii of new nodes from the foot's, by the tips that each carries; no other is thinner than these."""
    tips = np.zeros(parent.size)
    for i in range(parent.size - 1, 0, -1):
        tips[i] = max(tips[i], 1.0)
        tips[parent[i]] += tips[i]
    base = max(float(radius[1]), float(radius[0]), 1e-6)
    radius = radius.copy()
    for i in range(known, parent.size):
        radius[i] = base * math.pow(tips[i] / tips[0], 1.0 / PIPE)
    for i in range(parent.size - 1, 0, -1):
        if i >= known or radius[i] > radius[parent[i]]:
            radius[parent[i]] = max(radius[parent[i]], radius[i])
    return radius
