"""Leaf clusters: which points they are, how they are grouped, and their hulls.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.3.2.

Departs from it in: f_s (eq. 3.2) is compounded for every `F_S_STEP` of path from the root, so that
the result does not depend on how finely the graph is sampled; the distance of an edge's points is
taken from the surface of the branch, as points of a bare trunk lie half a diameter from its axis;
the low-confidence subtrees of one bough are gathered into clusters of comparable size, which have
several seeds each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.hulls import alpha_hull
from recon.skeleton import Skeleton, chains_of
from treegraph.clustertree import Cluster

F_S_STEP = 0.5  # metres of path for one power of f_s
CONFIDENCE_WINDOW = 0.4  # metres of chain that are judged together
NOISE = 0.004  # points are no nearer to the surface of a branch than this, metres
LEAF_DISTANCE = 0.03  # points that belong to no branch are leaves if farther from all wood, metres
MIN_CLUSTER_POINTS = 12
MIN_CLUSTER_SHARE = 0.002  # of all leaf points; smaller pieces are strays
REACH_SPACINGS = 3.0  # leaves farther apart, in point spacings, are not of one cluster ...
REACH = 0.15  # ... nor farther than this, metres, where points are dense
HULL_POINTS = 220  # that a hull is made from
SPACING_SAMPLE = 500  # points that the spacing of the leaves is taken from
MOST_OF_TARGET = 2.0  # a cluster with so many times its share of the points is divided
LUMP_ROUNDS = 4
MIN_VOLUME = 1e-6  # m3, for the density of flat clusters


@dataclass(frozen=True, eq=False)
class PointGroup:
    """Points of one cluster and where it sits on the skeleton.

    Attributes
    ----------
    row : (k,) int64
        Rows of the points.
    seed : (s,) int32
        Nodes the cluster grows from.
    """

    row: np.ndarray
    seed: np.ndarray


def leafy_nodes(xyz: np.ndarray, skeleton: Skeleton, f_s: float) -> np.ndarray:
    r"""Nodes beyond the first low-confidence edge on the way from the root.

    An edge is of low confidence where the mean distance of its points from the surface of the
    branch is larger than :math:`d'(u) = f_s^{s/s_0} d(u)`, eq. 3.2 of [1]_ compounded along the
    path of length s from the root, with s_0 = 0.5 m.

    Parameters
    ----------
    xyz : (n, 3) float64
    skeleton : Skeleton
        With final radii.
    f_s : float
        0 < f_s <= 1.

    Returns
    -------
    (n_nodes,) bool
        Closed outwards: what a leafy node carries is leafy. Never the root.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis,
       University of Konstanz, 2013.
    """
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    spread = tubes.mean_surface_distance(
        xyz,
        chains.point_start,
        chains.point,
        skeleton.parent,
        chains.onward,
        skeleton.position,
        skeleton.radius,
    )
    return tubes.low_confidence(
        skeleton.parent,
        chains.onward,
        skeleton.position,
        skeleton.radius,
        spread,
        chains.n_points,
        f_s,
        F_S_STEP,
        NOISE,
        CONFIDENCE_WINDOW,
    )


def median_turn(skeleton: Skeleton) -> float:
    """Median angle by which the chains of a skeleton turn at a node, radians.

    Chains of twigs are smooth; a chain through leaves turns at every one. On the bare trees of the
    benchmarks it is 2 to 16 degrees, on those with leaves 20 to 29.
    """
    onward = chains_of(skeleton).onward
    node = np.flatnonzero((onward >= 0) & (skeleton.parent >= 0))
    a = skeleton.position[node] - skeleton.position[skeleton.parent[node]]
    b = skeleton.position[onward[node]] - skeleton.position[node]
    length = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    cosine = (a * b).sum(axis=1)[length > 0] / length[length > 0]
    return float(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))) if cosine.size else 0.0


def bough_groups(skeleton: Skeleton, leafy: np.ndarray, max_clusters: int) -> np.ndarray:
    """Group of every point that may be a leaf: the bough that it hangs on.

    Parameters
    ----------
    skeleton : Skeleton
        The whole one, before its leafy nodes go.
    leafy : (n_nodes,) bool
        From :func:`leafy_nodes`.
    max_clusters : int
        About how many groups to make.

    Returns
    -------
    (m,) int64
        A number for each point; it says nothing for points of wood.
    """
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    is_leaf = leafy[skeleton.home] | (skeleton.label < 0)
    count = np.bincount(skeleton.home[is_leaf], minlength=skeleton.n_nodes)
    target = max(is_leaf.sum() / max_clusters, MIN_CLUSTER_POINTS)
    return tubes.gather_groups(skeleton.parent, chains.onward, count, target)[skeleton.home].astype(np.int64)


def cluster_points(
    xyz: np.ndarray, skeleton: Skeleton, group: np.ndarray, max_clusters: int
) -> list[PointGroup]:
    """The points that belong to no branch, by their groups and the gaps within them.

    Parameters
    ----------
    xyz : (n, 3) float64
    skeleton : Skeleton
        Main branches only; `label` -1 marks the points that belong to none of them.
    group : (n,) int64
        From :func:`bough_groups`.
    max_clusters : int
        About how many clusters to make.

    Returns
    -------
    list of PointGroup
        Each with at least `MIN_CLUSTER_POINTS` points.
    """
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    row = np.flatnonzero(skeleton.label < 0)
    gap = tubes.home_distance(
        xyz[row], skeleton.home[row], skeleton.parent, chains.onward, skeleton.position, skeleton.radius
    )
    row = row[gap > LEAF_DISTANCE]
    if row.size < MIN_CLUSTER_POINTS:
        return []
    fewest = max(MIN_CLUSTER_POINTS, MIN_CLUSTER_SHARE * row.size)
    target = row.size / max_clusters
    reach = max(REACH_SPACINGS * max(skeleton.spacing, _spacing(xyz[row])), REACH)
    found = []
    for g in np.unique(group[row]):
        member = row[group[row] == g]
        piece = separate(xyz[member], reach)
        for k in np.flatnonzero(np.bincount(piece) >= fewest):
            row_of = member[piece == k]
            n_lumps = int(row_of.size / target) if row_of.size > MOST_OF_TARGET * target else 1
            lump = lumps(xyz[row_of], n_lumps) if n_lumps > 1 else np.zeros(row_of.size, np.int64)
            for j in range(int(lump.max()) + 1):
                mine = row_of[lump == j]
                found.append(PointGroup(mine, np.unique(skeleton.home[mine]).astype(np.int32)))
    return found


def _spacing(xyz: np.ndarray) -> float:
    """Median distance of some points of a set to their fourth neighbours in it, metres."""
    from scipy.spatial import cKDTree

    some = xyz[:: max(len(xyz) // SPACING_SAMPLE, 1)]
    return float(np.median(cKDTree(xyz).query(some, min(5, len(xyz)))[0][:, -1]))


def lumps(xyz: np.ndarray, n_lumps: int) -> np.ndarray:
    """Divide a set of points into round lumps: k-means from points far apart.

    Parameters
    ----------
    xyz : (n, 3) float64
    n_lumps : int
        1 to n.

    Returns
    -------
    (n,) int64
        Lump of each point, each at least one point. It does not depend on the order of the points.
    """
    from scipy.spatial import cKDTree

    middle = xyz.mean(axis=0)[None]
    gap = np.linalg.norm(xyz - middle[0], axis=1)
    centre = []
    for _ in range(n_lumps):
        centre.append(xyz[np.argmax(gap)])
        gap = np.minimum(gap if len(centre) > 1 else np.inf, np.linalg.norm(xyz - centre[-1], axis=1))
    centres = np.array(centre)
    for _ in range(LUMP_ROUNDS):
        _, lump = cKDTree(centres).query(xyz)
        count = np.bincount(lump, minlength=n_lumps)
        total = np.stack([np.bincount(lump, xyz[:, c], n_lumps) for c in range(3)], axis=1)
        centres = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], centres)
    _, lump = cKDTree(centres).query(xyz)
    return np.unique(lump, return_inverse=True)[1]


def separate(xyz: np.ndarray, reach: float) -> np.ndarray:
    """Pieces of a set of points with gaps of about `reach` or more between them.

    Parameters
    ----------
    xyz : (n, 3) float64
    reach : float
        Metres, > 0.

    Returns
    -------
    (n,) int
        Piece of each point: points in the same cell of a grid of `reach` / 2 are in one piece, and
        cells whose middles (of points) are nearer than `reach`.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    cell = np.floor((xyz - xyz.min(axis=0)) / (reach / 2)).astype(np.int64)
    size = cell.max(axis=0) + 1
    code = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    _, cell_of = np.unique(code, return_inverse=True)
    count = np.bincount(cell_of)
    middle = np.stack([np.bincount(cell_of, xyz[:, c]) for c in range(3)], axis=1) / count[:, None]
    pair = cKDTree(middle).query_pairs(reach, output_type="ndarray")
    joined = coo_matrix((np.ones(len(pair)), (pair[:, 0], pair[:, 1])), (count.size, count.size))
    return connected_components(joined, directed=False)[1][cell_of]


def make_clusters(xyz: np.ndarray, groups: list[PointGroup], max_faces: int) -> tuple[Cluster, ...]:
    """Hulls of point groups as clusters; see :func:`recon.hulls.alpha_hull`."""
    out = []
    for group in groups:
        hull = alpha_hull(xyz[group.row], max_points=HULL_POINTS, max_faces=max_faces)
        density = group.row.size / max(hull.volume, MIN_VOLUME)
        out.append(Cluster(hull.vertices, hull.faces, group.seed, float(density), int(group.row.size)))
    return tuple(out)
