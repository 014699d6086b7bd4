r"""The leaves of a tree through its life: clusters that wander towards the root as the years are taken back.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.3.2 (Eq. 4.4, 4.5, figure 4.3).
Departs from it in: a cluster that is divided between several new tips gives each its share of the volume; a
new tip that leaves of several clusters reach belongs to the one that brings most; the ratio of distances in
Eq. 4.5 never exceeds 1, so that no cluster grows towards the past, and is taken to the third power (`taper`):
leaves of grown trees follow the reach of their branches with an exponent of 2.6 to 4, and with 1, as printed,
young trees stand in their own night (docs/plastic.md). A tree without clusters gets virtual ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plastic.seasons import Seasons
from treegraph import NO_PARENT, Cluster, ClusterTree, TreeGraph

__all__ = ["TAPER", "Crown", "grow_crown", "leaf_clusters", "virtual_clusters"]

LEAST_RADIUS = 1e-3  # metres
REACH = 1.2  # nodes that follow a seed belong to its cluster up to so many radii from its centre
TIPS_PER_CLUSTER = 6  # of a tree without clusters
MOST_VIRTUAL = 64
BALL = 5.0 / 3.0  # squared radius of a ball over the mean squared distance of its points from the centre
TIE = 1e-9  # of a share of volume
TAPER = 3.0
"""Exponent of the ratios of distances in Eq. 4.5; 1 as printed."""


@dataclass(frozen=True, eq=False)
class Crown:
    """Leaf clusters of every season; s sites, that is clusters of all seasons together.

    Attributes
    ----------
    first : (seasons + 2,) int32
        Sites ``first[g]`` to ``first[g + 1]`` are group g: group 0 has one site without leaves at every root,
        and group t + 1 the clusters as they were at the end of season t. The last group has the clusters
        of the tree, in their order.
    center : (s, 3) float64
        Metres.
    radius : (s,) float64
        Metres; 0 in group 0.
    seat_first : (s + 1,) int32
        Site k sits on the nodes ``seat[seat_first[k]:seat_first[k + 1]]``, ascending.
    seat : (m,) int32
    look : (n,) int32
        The site whose light each node grew in: of the group before its season; -1 if there is none.
    """

    first: NDArray[np.int32]
    center: NDArray[np.float64]
    radius: NDArray[np.float64]
    seat_first: NDArray[np.int32]
    seat: NDArray[np.int32]
    look: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class _Leaves:
    """The clusters of one moment: centre, radius, and one row per node and cluster on it."""

    center: NDArray[np.float64]
    radius: NDArray[np.float64]
    node: NDArray[np.int64]
    cluster: NDArray[np.int64]
    volume: NDArray[Any]  # float64, share of the cube of the radius


def grow_crown(tree: ClusterTree, seasons: Seasons, *, taper: float = TAPER) -> Crown:
    r"""Leaf clusters of every season, from the present ones backwards (thesis 4.3.2).

    Season by season the youngest nodes are taken away. Clusters that lose nodes move to the nodes that are
    tips now: their centre is the centroid of these, and their radius

    .. math:: r_n = \sqrt[3]{\sum_{i \in C_p} r_i^3 \prod_{i \in C_p} (d_n / d_i)^k} \qquad (4.5)

    with the distances d of the centres from the root, and k = `taper`. Clusters that lose nothing stay as
    they are.

    Parameters
    ----------
    tree : ClusterTree
    seasons : Seasons
        Of its graph.
    taper : float, default 3
        k, 0 or more.

    Returns
    -------
    crown : Crown
    """
    graph = tree.graph
    now = _seat(graph, *(leaf_clusters(graph, tree.clusters) if tree.clusters else virtual_clusters(graph)))
    groups = [now]
    for season in range(seasons.count - 2, -1, -1):
        groups.append(_take_back(graph, groups[-1], seasons.birth, season, taper))
    groups.append(_seedlings(graph))
    return _lay_out(graph, groups[::-1], seasons)


def leaf_clusters(
    graph: TreeGraph, clusters: tuple[Cluster, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[NDArray[np.int64]]]:
    """Clusters as balls of their hulls' volumes around their hulls' centroids, and the nodes they sit on.

    A cluster sits on the ends of what belongs to it: its seeds, and the nodes that follow them within 1.2
    radii of its centre. One without seeds sits on the node next to its centre.

    Returns
    -------
    center : (k, 3), radius : (k,) float64 ndarrays
        Metres.
    seats : list of (m,) int64 ndarray
        Ascending node numbers, at least one.
    """
    from plastic import _analysis_kernels as kernels

    n = graph.n_nodes
    taken = np.zeros(n, bool)
    for cluster in clusters:
        taken[cluster.seed] = True
    center, radius = np.empty((len(clusters), 3)), np.empty(len(clusters))
    seats = []
    member = np.empty(n, bool)
    for k, cluster in enumerate(clusters):
        center[k], radius[k] = _ball_of(cluster.vertices, cluster.faces, graph, cluster.seed)
        is_seed = np.zeros(n, bool)
        is_seed[cluster.seed] = True
        if not cluster.seed.size:
            is_seed[np.argmin(((graph.position - center[k]) ** 2).sum(axis=1))] = True
        kernels.members_of_cluster(
            graph.parent, graph.position, is_seed, taken, center[k], REACH * radius[k], member
        )
        kernels.keep_ends(graph.parent, member)
        seats.append(np.flatnonzero(member))
    return center, radius, seats


def _ball_of(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], graph: TreeGraph, seed: NDArray[np.int32]
) -> tuple[NDArray[np.float64], float]:
    """Centroid of a closed hull and the radius of a ball of its volume; of a flat one from its corners."""
    if not len(vertices):
        return graph.position[seed].mean(axis=0) if seed.size else graph.position[0], LEAST_RADIUS
    middle = vertices.mean(axis=0)
    corner = (vertices - middle)[faces]
    signed = np.einsum("fi,fi->f", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    volume = float(signed.sum())
    spread = math.sqrt(BALL * float(((vertices - middle) ** 2).sum(axis=1).mean()))
    if volume <= (0.05 * spread) ** 3:  # flat, open or inside out
        return middle, max(spread, LEAST_RADIUS)
    centroid = middle + (signed[:, None] * corner.sum(axis=1)).sum(axis=0) / (4.0 * volume)
    return centroid, max((3.0 * volume / (4.0 * math.pi)) ** (1.0 / 3.0), LEAST_RADIUS)


def virtual_clusters(
    graph: TreeGraph,
) -> tuple[NDArray[np.float64], NDArray[np.float64], list[NDArray[np.int64]]]:
    """Leaf clusters for a tree that has none: its tips in round groups of about six, at most 64.

    The radius is that of a ball in which points have the tips' mean squared distance from the centre, and
    half the way from a tip to its nearest branching at least. What is returned is as of
    :func:`leaf_clusters`.
    """
    from plastic import _analysis_kernels as kernels
    from recon.clusters import lumps

    is_tip = np.ones(graph.n_nodes, bool)
    is_tip[graph.parent[graph.parent >= 0]] = False
    tip = np.flatnonzero(is_tip)
    way, _ = kernels.way_to_branching(graph.parent, graph.position)
    count = int(np.clip(round(len(tip) / TIPS_PER_CLUSTER), 1, MOST_VIRTUAL))
    label = lumps(graph.position[tip], count)
    center, radius, seats = [], [], []
    for k in range(int(label.max()) + 1):
        mine = tip[label == k]
        middle = graph.position[mine].mean(axis=0)
        spread = math.sqrt(BALL * float(((graph.position[mine] - middle) ** 2).sum(axis=1).mean()))
        center.append(middle)
        radius.append(max(spread, 0.5 * float(np.median(way[mine])), LEAST_RADIUS))
        seats.append(mine)
    return np.array(center), np.array(radius), seats


def _seat(
    graph: TreeGraph,
    center: NDArray[np.float64],
    radius: NDArray[np.float64],
    seats: list[NDArray[np.int64]],
) -> _Leaves:
    """Each cluster's volume in equal shares on its nodes."""
    size = np.array([len(nodes) for nodes in seats])
    cluster = np.repeat(np.arange(len(seats)), size)
    node = np.concatenate([*seats, np.empty(0, np.int64)])
    return _Leaves(center, radius, node, cluster, radius[cluster] ** 3 / size[cluster])


def _seedlings(graph: TreeGraph) -> _Leaves:
    """A site without leaves at every root."""
    root = np.flatnonzero(graph.parent == NO_PARENT)
    k = len(root)
    return _Leaves(graph.position[root], np.zeros(k), root, np.arange(k), np.zeros(k))


def _take_back(
    graph: TreeGraph, later: _Leaves, birth: NDArray[np.int32], season: int, taper: float
) -> _Leaves:
    """The clusters at the end of a season from those at the end of the next one."""
    from plastic import _analysis_kernels as kernels

    moved = birth[later.node] > season
    if not moved.any():
        return later
    to = kernels.living_ancestor(graph.parent, birth, season)[later.node]
    key = later.cluster.copy()
    key[moved] = _winners(to[moved], later.cluster[moved], later.volume[moved], len(later.radius))
    label, key = np.unique(key, return_inverse=True)
    k = len(label)
    center, radius = np.empty((k, 3)), np.empty(k)
    # one row per node and new cluster
    place, row = np.unique(np.column_stack([key, to]), axis=0, return_inverse=True)
    cluster, node = place[:, 0], place[:, 1]
    volume = np.bincount(row.reshape(-1), later.volume, len(place))
    share = later.volume / (later.radius**3)[later.cluster]  # of its old cluster, per old row
    root = graph.position[kernels.living_ancestor(graph.parent, birth, -1)]
    for c in range(k):
        rows = np.flatnonzero(key == c)
        if label[c] < len(later.radius) and not moved[rows].any() and share[rows].sum() > 1.0 - TIE:
            center[c], radius[c] = later.center[label[c]], later.radius[label[c]]
            continue
        mine = node[cluster == c]
        center[c] = graph.position[mine].mean(axis=0)
        near = np.linalg.norm(center[c] - root[mine[0]])
        shrink = 1.0
        for i in np.unique(later.cluster[rows]):
            far = np.linalg.norm(later.center[i] - root[mine[0]])
            part = share[rows][later.cluster[rows] == i].sum()
            shrink *= min(near / far, 1.0) ** (taper * part) if far > 0.0 else 1.0
        radius[c] = max((volume[cluster == c].sum() * shrink) ** (1.0 / 3.0), LEAST_RADIUS)
        volume[cluster == c] *= radius[c] ** 3 / volume[cluster == c].sum()
    return _Leaves(center, radius, node, cluster, volume)


def _winners(
    to: NDArray[np.int32], cluster: NDArray[np.int64], volume: NDArray[np.float64], n_clusters: int
) -> NDArray[np.int64]:
    """For each row the cluster that brings most to its node; several that bring the same are a new one."""
    place, row = np.unique(np.column_stack([to, cluster]), axis=0, return_inverse=True)
    row = row.reshape(-1)
    total = np.bincount(row, volume, len(place))
    first = np.flatnonzero(np.r_[True, place[1:, 0] != place[:-1, 0]])
    size = np.diff(np.r_[first, len(place)])
    most = np.repeat(np.maximum.reduceat(total, first), size)
    best = total >= most * (1.0 - TIE)
    alone = np.repeat(np.add.reduceat(best.astype(np.int64), first), size) == 1
    key = np.repeat(np.maximum.reduceat(np.where(best, place[:, 1], -1), first), size)
    met: dict[tuple[int, ...], int] = {}
    for begin in first[~alone[first]]:
        end = begin + size[np.searchsorted(first, begin)]
        group = tuple(place[begin:end, 1][best[begin:end]].tolist())
        key[begin:end] = n_clusters + met.setdefault(group, len(met))
    return key[row]


def _lay_out(graph: TreeGraph, groups: list[_Leaves], seasons: Seasons) -> Crown:
    """Groups one after the other, and which site each node looks at."""
    first = np.concatenate([[0], np.cumsum([len(g.radius) for g in groups])]).astype(np.int32)
    look = np.full(graph.n_nodes, -1, np.int32)
    seats, starts = [], [np.zeros(1, np.int64)]
    filled = 0
    for g, group in enumerate(groups):
        order = np.lexsort((group.node, group.cluster))
        seats.append(group.node[order])
        size = np.bincount(group.cluster, minlength=len(group.radius))
        starts.append(filled + np.cumsum(size))
        filled += len(group.node)
        if g < len(groups) - 1:
            born = np.flatnonzero((seasons.birth == g) & (graph.parent != NO_PARENT))
            if born.size and len(group.radius):
                look[born] = first[g] + _nearest_site(graph, group, born, seasons.birth, g - 1)
    return Crown(
        first,
        np.concatenate([g.center for g in groups]),
        np.concatenate([g.radius for g in groups]),
        np.concatenate(starts).astype(np.int32),
        np.concatenate(seats).astype(np.int32),
        look,
    )


def _nearest_site(
    graph: TreeGraph, group: _Leaves, born: NDArray[np.int64], birth: NDArray[np.int32], season: int
) -> NDArray[np.int64]:
    """The cluster on the node that a new shoot sets out from; else the one whose centre is nearest."""
    from scipy.spatial import cKDTree

    from plastic import _analysis_kernels as kernels

    site = cKDTree(group.center).query(graph.position[born])[1].astype(np.int64)
    on_node = np.full(graph.n_nodes, -1)
    many = np.bincount(group.node, minlength=graph.n_nodes) > 1
    on_node[group.node] = group.cluster
    source = kernels.living_ancestor(graph.parent, birth, season)[born]
    return np.where((on_node[source] >= 0) & ~many[source], on_node[source], site)
