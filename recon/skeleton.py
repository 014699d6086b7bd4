"""From points to the first skeleton: slices of equal distance from the base.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.3.1 (shortest paths from the base of the trunk over a
graph of neighbouring points, after Livny et al. 2010), with the cut into slices of equal distance
from the base of Verroust and Lazarus, "Extracting skeletal curves from 3D scattered data", The
Visual Computer 16(1), 2000.

Departs from it in: a point on a path lies on the bark, so paths are not branches. The connected
pieces of each slice are the nodes; `recon.tubes` then puts them on the axes. A slice that is much
wider than a branch with so many paths through it can be (dense twigs, foliage) is split into the
bundles of paths it is made of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recon.neighbours import NeighbourGraph, shortest_paths

SLICE_SPACINGS = 1.4  # thickness of a slice in point spacings
SLICE_RANGE = (0.012, 0.10)  # and its limits, metres
BASE_SPACINGS = 2.0  # points this near the foot, in spacings, are where the paths begin
BASE_REACH = 1.5  # looked for within this times the distance of the nearest point
BASE_HEIGHT = 0.05  # and at least this, metres
STEM_FLOW = 0.5  # slices with this share of all paths through them belong to the stem
WIDE_FACTOR = 2.0  # branches may be this much wider than the pipe model says ...
RING_VARIATION = 0.25  # distances from the middle vary less, relative to their mean, in rings: never too wide
MIN_RING_POINTS = 12
SEQUEL_GROWTH = 1.1  # a tube may go on so much wider than it was ...
SEQUEL_SHARE = 0.2  # ... if no other child slice has this share of its points
WIDE_SLICES = 1.0  # ... plus this many slices


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Nodes on the axes of branches, and which points are whose.

    Attributes
    ----------
    parent : (n,) int32
        -1 at the root; parents come first.
    position : (n, 3) float64
        Metres, in the frame of the points.
    radius : (n,) float64
        Metres, as the points of each node show it; see :mod:`recon.radii` for the final ones.
    label : (m,) int32
        Node of each point, -1 where it belongs to none (any more).
    home : (m,) int32
        The same, but points that belong to none have the node they hung on last.
    is_tube : (n,) bool
        Where circles across the axis were found on this stretch of the chain.
    arc : (n,) float64
        Share of the round on which the node's circle has points.
    slice_width : float
        Thickness of the slices, metres.
    spacing : float
        Median distance of a point to its fourth neighbour, metres.
    thickest : float
        No branch has a larger radius than this, metres.
    """

    parent: np.ndarray
    position: np.ndarray
    radius: np.ndarray
    label: np.ndarray
    home: np.ndarray
    is_tube: np.ndarray
    arc: np.ndarray
    slice_width: float
    spacing: float
    thickest: float = np.inf

    @property
    def n_nodes(self) -> int:
        return self.parent.size

    @property
    def n_points(self) -> np.ndarray:
        """Number of points of each node, (n,) int64."""
        return np.bincount(self.label[self.label >= 0], minlength=self.n_nodes)


def base_points(xyz: np.ndarray, base: np.ndarray, spacing: float) -> np.ndarray:
    """The points that the paths begin at: the lowest piece of the trunk around its foot.

    Parameters
    ----------
    xyz : (n, 3) float64
    base : (3,) float64
        Foot of the trunk, metres.
    spacing : float
        Median point spacing, metres.

    Returns
    -------
    (s,) int64
        At least one point.
    """
    step = max(BASE_SPACINGS * spacing, BASE_HEIGHT)
    away = np.linalg.norm(xyz - base, axis=1)
    near = np.flatnonzero(away <= BASE_REACH * away.min() + step)
    z = xyz[near, 2]
    return near[z <= z.min() + step]


def slice_tree(xyz: np.ndarray, graph: NeighbourGraph, sources: np.ndarray) -> Skeleton:
    """Cut the cloud into slices of equal distance from the base; their pieces are nodes.

    Parameters
    ----------
    xyz : (n, 3) float64
    graph : NeighbourGraph
        Connected.
    sources : (s,) int
        Where distances are 0.

    Returns
    -------
    Skeleton
        Nodes at the means of their points, radii nan.
    """
    from recon import _skeleton_kernels as kernels

    distance, before = shortest_paths(graph, sources, graph.length)
    width = float(np.clip(SLICE_SPACINGS * graph.spacing, *SLICE_RANGE))
    level = np.floor(distance / width).astype(np.int32)
    level[sources] = 0
    label, n_nodes = kernels.slice_labels(graph.start, graph.neighbour, level)
    label, n_nodes = _one_root(label, level, n_nodes)
    label, n_nodes = _split_wide(xyz, label, n_nodes, distance, before, width)
    parent = kernels.slice_parents(label, n_nodes, before)
    position, _ = kernels.group_means(xyz, label, n_nodes)
    nothing = np.full(n_nodes, np.nan)
    return Skeleton(
        parent,
        position,
        nothing,
        label,
        label,
        np.zeros(n_nodes, bool),
        np.zeros(n_nodes),
        width,
        graph.spacing,
    )


def _split_wide(
    xyz: np.ndarray, label: np.ndarray, n_nodes: int, distance: np.ndarray, before: np.ndarray, width: float
) -> tuple[np.ndarray, int]:
    """Split the slices that are wider than a branch with so many paths through it can be.

    In a trunk or branch the slices are rings; in dense twigs and foliage the front of equal
    distance is a shell, whose middle is nowhere near a branch.
    """
    from recon import _skeleton_kernels as kernels

    mean, count = kernels.group_means(xyz, label, n_nodes)
    extent, variation = kernels.slice_extents(xyz, label, mean, count)
    through = kernels.paths_through(np.argsort(distance, kind="stable"), before)
    flow = kernels.slice_flow(label, n_nodes, before, through) / through.size
    flow[0] = 1.0
    stem = flow > STEM_FLOW
    widest = WIDE_FACTOR * np.median(extent[stem]) * np.sqrt(flow) + WIDE_SLICES * width
    widest[0] = np.inf
    parent = kernels.slice_parents(label, n_nodes, before)
    too_wide = kernels.wide_slices(
        parent, extent, variation, count, widest, RING_VARIATION, MIN_RING_POINTS, SEQUEL_GROWTH, SEQUEL_SHARE
    )
    return kernels.split_slices(label, too_wide, np.maximum(widest, 2 * width), distance, before)


def _one_root(label: np.ndarray, level: np.ndarray, n_nodes: int) -> tuple[np.ndarray, int]:
    """Join all pieces of the first slice into node 0."""
    n_first = int(label[level == 0].max()) + 1
    return np.maximum(label - (n_first - 1), 0).astype(np.int32), n_nodes - (n_first - 1)


@dataclass(frozen=True, eq=False)
class Chains:
    """What the fitting kernels need to know of a skeleton, derived from it."""

    onward: np.ndarray
    head: np.ndarray
    point_start: np.ndarray
    point: np.ndarray
    n_points: np.ndarray


def chains_of(skeleton: Skeleton) -> Chains:
    """Continuations by the largest length carried, chain heads and the points of each node."""
    from recon import _tube_kernels as tubes

    weight = tubes.subtree_length(skeleton.parent, skeleton.position)
    onward = tubes.continuations(skeleton.parent, weight)
    head, _ = tubes.chain_heads(skeleton.parent, onward)
    start, point = tubes.group_points(skeleton.label, skeleton.n_nodes)
    return Chains(onward, head, start, point, np.diff(start))


def merge_nodes(skeleton: Skeleton, into: np.ndarray, *, lose: bool = False) -> Skeleton:
    """The skeleton with nodes given to others, their children with them.

    Parameters
    ----------
    into : (n,) int
        The node each node goes into, itself where it stays; chains of them are followed.
    lose : bool
        If true, the points of nodes that go belong to no node from then on (label -1), else
        they go with them.
    """
    from treegraph import sort_topological

    final = into.astype(np.int64)
    while True:
        further = final[final]
        if (further == final).all():
            break
        final = further
    kept = np.flatnonzero(final == np.arange(final.size))
    new = np.full(final.size, -1, np.int64)
    parent = skeleton.parent[kept].astype(np.int64)
    parent = np.where(parent >= 0, final[parent], -1)
    new[kept] = np.arange(kept.size)
    parent = np.where(parent >= 0, new[parent], -1)
    order = sort_topological(parent)
    rank = np.empty(order.size, np.int64)
    rank[order] = np.arange(order.size)
    parent = parent[order]
    row = kept[order]
    home = rank[new[final[skeleton.home]]]
    label = np.where(skeleton.label >= 0, home, -1)
    if lose:
        label[(skeleton.label >= 0) & (final[skeleton.label] != skeleton.label)] = -1
    return replace(
        skeleton,
        parent=np.where(parent >= 0, rank[parent], -1).astype(np.int32),
        position=skeleton.position[row],
        radius=skeleton.radius[row],
        label=label.astype(np.int32),
        home=home.astype(np.int32),
        is_tube=skeleton.is_tube[row],
        arc=skeleton.arc[row],
    )


def reorder(skeleton: Skeleton, order: np.ndarray) -> Skeleton:
    """The skeleton with its nodes in another order, in which parents come first again."""
    rank = np.empty(order.size, np.int64)
    rank[order] = np.arange(order.size)
    parent = skeleton.parent[order]
    return replace(
        skeleton,
        parent=np.where(parent >= 0, rank[parent], -1).astype(np.int32),
        position=skeleton.position[order],
        radius=skeleton.radius[order],
        label=np.where(skeleton.label >= 0, rank[skeleton.label], -1).astype(np.int32),
        home=rank[skeleton.home].astype(np.int32),
        is_tube=skeleton.is_tube[order],
        arc=skeleton.arc[order],
    )


def keep_nodes(skeleton: Skeleton, kept: np.ndarray) -> Skeleton:
    """The skeleton with only some nodes; the others' points go to the next kept one outwards.

    Parameters
    ----------
    kept : (k,) int
        Ascending; with the root, all tips and all branching nodes.
    """
    n = skeleton.n_nodes
    into = np.full(n, -1, np.int64)
    into[kept] = np.arange(kept.size)
    above = np.full(n, -1, np.int64)
    for i in range(n - 1, 0, -1):
        if into[i] < 0:
            into[i] = above[i]
        above[skeleton.parent[i]] = into[i]
    up = skeleton.parent.astype(np.int64)
    stays = np.zeros(n, bool)
    stays[kept] = True
    parent = np.full(n, -1, np.int64)
    for i in range(1, n):
        parent[i] = up[i] if stays[up[i]] else parent[up[i]]
    parent = parent[kept]
    return replace(
        skeleton,
        parent=np.where(parent >= 0, into[parent], -1).astype(np.int32),
        position=skeleton.position[kept],
        radius=skeleton.radius[kept],
        label=np.where(skeleton.label >= 0, into[skeleton.home], -1).astype(np.int32),
        home=into[skeleton.home].astype(np.int32),
        is_tube=skeleton.is_tube[kept],
        arc=skeleton.arc[kept],
    )
