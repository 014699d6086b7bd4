"""Leaves of a grown tree: where each one is, and the clusters in which they hang together.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 4.2 (leaves along the terminal branches, made at the end of growth); R. L. Cook et al., "Stochastic
simplification of aggregate detail", ACM Trans. Graph. 26(3), 2007 (fewer and larger leaves of the same area).
Departs from it in: the branchlets that hold the leaves are not there; leaves stand where their leaves would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treegraph import NO_PARENT, Cluster, InputError, TreeGraph

__all__ = ["LeafSet", "gather_clusters", "place_leaves"]

LEAF_LENGTH = 0.09  # metres
LEAF_ASPECT = 0.62  # width over length
MOST_LEAVES = 150_000
SPREAD = 0.36  # how far leaves are from their internode's axis at most, in roots of its leaf area
GOLDEN_ANGLE = float(np.pi * (3.0 - np.sqrt(5.0)))
LIFT = 0.35  # how much leaves turn up, over how much they turn outwards
TILT = 0.6  # standard deviation of a leaf's turn about its own axis, radians
HULL_DIRECTIONS = 42  # in which the extent of a cluster is taken: at most 80 faces
NODES_PER_CLUSTER = 12
ROUNDS = 12  # of k-means


@dataclass(frozen=True, eq=False)
class LeafSet:
    """Leaves as flat blades.

    Attributes
    ----------
    base : (m, 3) float64
        Where each blade begins, metres.
    along : (m, 3) float64
        Unit vector from its base to its tip.
    normal : (m, 3) float64
        Unit vector across its upper face.
    length, width : (m,) float64
        Metres.
    node : (m,) int32
        The node of the tree on whose segment it is.
    """

    base: NDArray[np.float64]
    along: NDArray[np.float64]
    normal: NDArray[np.float64]
    length: NDArray[np.float64]
    width: NDArray[np.float64]
    node: NDArray[np.int32]

    @property
    def n_leaves(self) -> int:
        """Number of leaves."""
        return len(self.node)

    @property
    def area(self) -> float:
        """One side of all blades, which are rhombi, m2."""
        return float(0.5 * (self.length * self.width).sum())


def place_leaves(
    tree: TreeGraph,
    *,
    rng: np.random.Generator,
    leaf_length: float = LEAF_LENGTH,
    most: int = MOST_LEAVES,
) -> LeafSet:
    """Place the leaves of a grown tree.

    Parameters
    ----------
    tree : TreeGraph
        With the attribute ``leaf_area`` of the growth model (m2 per node).
    rng : numpy.random.Generator
    leaf_length : float, default 0.09
        Metres, 0.001 to 2.
    most : int, default 150000
        Where the leaf area asks for more leaves than this, there are so many larger ones of the same area.

    Returns
    -------
    leaves : LeafSet
        Its area is that of the attribute to within half a leaf per leafy node on average; sorted by node.

    Raises
    ------
    InputError
        If the tree has no ``leaf_area``, or a number is out of its range.
    """
    if "leaf_area" not in tree.attribute:
        raise InputError("the tree has no attribute leaf_area; only grown trees say where their leaves are")
    if not 0.001 <= leaf_length <= 2.0:
        raise InputError(f"leaf_length must be from 0.001 to 2 metres, got {leaf_length!r}")
    if most < 1:
        raise InputError(f"most must be 1 or more leaves, got {most!r}")
    area = np.asarray(tree.attribute["leaf_area"], float)
    blade = 0.5 * leaf_length * leaf_length * LEAF_ASPECT
    scale = float(np.sqrt(max(1.0, area.sum() / blade / most)))
    wanted = area / (blade * scale**2)
    count = np.floor(wanted + rng.random(len(wanted))).astype(np.int64)  # the right area on average
    node = np.repeat(np.arange(tree.n_nodes), count)
    first = np.concatenate([[0], np.cumsum(count)[:-1]])
    step = np.arange(len(node)) - first[node]
    start = tree.position[np.maximum(tree.parent, 0)]
    axis = tree.position - start
    length = np.linalg.norm(axis, axis=1)
    axis = np.divide(axis, length[:, None], out=np.zeros_like(axis), where=length[:, None] > 0.0)
    side, other = _across(axis)
    turn = step * GOLDEN_ANGLE + 2.0 * np.pi * rng.random(tree.n_nodes)[node]
    out = np.cos(turn)[:, None] * side[node] + np.sin(turn)[:, None] * other[node]
    at = (step + rng.random(len(node))) / np.maximum(count[node], 1)
    away = SPREAD * np.sqrt(area[node] * rng.random(len(node)))
    base = start[node] + (at * length[node])[:, None] * axis[node] + away[:, None] * out
    along = _unit(
        out + 0.5 * axis[node] + LIFT * np.array([0.0, 0.0, 1.0]) + 0.3 * rng.normal(size=out.shape)
    )
    up = _unit(np.array([0.0, 0.0, 1.0]) - along[:, 2:] * along + 1e-9)
    tilt = TILT * rng.normal(size=len(node))
    normal = np.cos(tilt)[:, None] * up + np.sin(tilt)[:, None] * np.cross(along, up)
    size = leaf_length * scale * np.sqrt(rng.uniform(0.6, 1.4, len(node)))
    return LeafSet(base, along, normal, size, LEAF_ASPECT * size, node.astype(np.int32))


def gather_clusters(tree: TreeGraph, leaves: LeafSet, *, most: int = 64) -> tuple[Cluster, ...]:
    """Gather leaves into clusters: those nearest to one of some evenly spread middles, in their convex hull.

    Parameters
    ----------
    tree : TreeGraph
    leaves : LeafSet
        Of this tree.
    most : int, default 64
        Most clusters; there is one for every 12 leafy nodes up to this number.

    Returns
    -------
    clusters : tuple of Cluster
        Each with a closed hull of at most 80 faces. Its seeds are the leafy nodes whose parents bear no
        leaves of the same cluster. Fewer than four leaves, or leaves in one plane, make no cluster.

    Notes
    -----
    The middles are those of k-means, begun at nodes that are farthest from each other. No chance is in it.
    """
    if not leaves.n_leaves:
        return ()
    leafy, which = np.unique(leaves.node, return_inverse=True)
    group = _group(tree.position[leafy], min(most, max(1, len(leafy) // NODES_PER_CLUSTER)))
    home = np.full(tree.n_nodes, -1)
    home[leafy] = group
    first = (tree.parent == NO_PARENT) | (home != home[np.maximum(tree.parent, 0)])
    label = group[which.reshape(-1)]
    tips = leaves.base + leaves.length[:, None] * leaves.along
    out = []
    for k in range(group.max() + 1):
        mine = label == k
        hull = _hull(np.concatenate([leaves.base[mine], tips[mine]]))
        if hull is not None:
            seeds = np.flatnonzero((home == k) & first)
            out.append(Cluster(*hull, seed=seeds.astype(np.int32), density=float("nan"), n_points=0))
    return tuple(out)


def _group(points: NDArray[np.float64], k: int) -> NDArray[np.int64]:
    """Number of the nearest of k middles for each point: k-means from points far from each other."""
    from scipy.spatial import cKDTree

    middle = points[[np.argmin(points[:, 2])]]
    gap = np.linalg.norm(points - middle[0], axis=1)
    for _ in range(k - 1):
        farthest = points[np.argmax(gap)]
        middle = np.vstack([middle, farthest])
        gap = np.minimum(gap, np.linalg.norm(points - farthest, axis=1))
    label = np.zeros(len(points), np.int64)
    for _ in range(ROUNDS):
        label = cKDTree(middle).query(points)[1]
        count = np.bincount(label, minlength=len(middle))
        total = np.stack([np.bincount(label, points[:, c], len(middle)) for c in range(3)], axis=1)
        middle = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], middle)
    return label


def _hull(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]] | None:
    """Convex hull of the outermost points in some directions: vertices, outward faces; None if it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    z = 1.0 - (2.0 * np.arange(HULL_DIRECTIONS) + 1.0) / HULL_DIRECTIONS
    turn = GOLDEN_ANGLE * np.arange(HULL_DIRECTIONS)
    level = np.sqrt(1.0 - z * z)
    direction = np.column_stack([level * np.cos(turn), level * np.sin(turn), z])
    outer = points[np.unique(np.argmax(points @ direction.T, axis=0))]
    if len(outer) < 4:
        return None
    try:
        hull = ConvexHull(outer)
    except QhullError:
        return None
    place = np.full(len(outer), -1)
    place[hull.vertices] = np.arange(len(hull.vertices))
    corner = outer[hull.simplices]
    inward = np.einsum(
        "ij,ij->i",
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]),
        hull.equations[:, :3],
    )
    faces = place[hull.simplices]
    faces[inward < 0.0] = faces[inward < 0.0][:, ::-1]
    return outer[hull.vertices], faces.astype(np.int32)


def _across(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors (n, 3) across each axis and each other."""
    helper = np.where(np.abs(axis[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    side = _unit(np.cross(axis, helper) + 1e-12)
    return side, np.cross(axis, side)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-12)
