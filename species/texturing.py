r"""Clusters filled with a species' twigs and leaves: from seeds, patch by patch.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 3.4 (Eq. 3.3) and Eq. 4.13 (density by light); Y. Livny et al., "Texture-lobes for
tree modelling", ACM Trans. Graph. 30(4), 2011.
Departs from it in: Eq. 3.3 is printed as a product in which a worse match of thicknesses raises the value;
here equal thickness and equal direction are best. The fit to the cluster is measured against its
hull and against what is there already. Where docking points end before the cluster is full, patches
are grown to its emptiest places, from the docking point or the wood from which they are reached best. At the
end patches that carry no others are scaled so that the leaf area is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from species.patches import Instances, Patch
from treegraph import NO_PARENT, ClusterTree, InputError, TreeGraph, path_length

__all__ = ["PatchTable", "Texture", "pack_patches", "texture_tree"]

MOST_INSTANCES = 20_000  # of one cluster
MOST_PLACES = 40_000  # docking points and points of wood of one cluster
GOLDEN = 0.6180339887498949
AXIS_POINTS = 12  # of a patch with docking points at most: where others can go on besides
WOOD_STEP = 0.15  # metres between the points of branches from which patches can grow
SCALE = (0.8, 1.25)  # of a patch, so that it fits its docking point or reaches its place
STRETCH = (0.7, 1.3)  # by which patches that carry no others are scaled besides, for the leaf area
DENSITY_RANGE = (0.5, 2.0)  # of the factors by which leaves follow a scan's density


@dataclass(frozen=True, eq=False)
class PatchTable:
    """A species' patches as flat arrays, packed once by :func:`pack_patches`.

    Attributes
    ----------
    radius, slope : (p,) float64
        Of the patches' roots.
    leaf_area : (p,) float64
        One side of all leaves of a patch, m2.
    sample : (p, 16, 3) float64
        Points of each patch, spread over its leaves.
    reach, droop : (p,) float64
        How far from the root the middle of these is, metres, and by how much it lies below the root's
        direction, radians.
    lead : (p,) float64
        How far along its axis a patch with docking points goes, metres; 0 for those without.
    promise : (p,) float64
        Leaf area that will hang on its docking points, m2, if each gets the smallest patch that fits.
    dock_start : (p + 1,) int64
        Docking points ``dock_start[i]:dock_start[i + 1]`` are the i-th patch's.
    dock_place, dock_way : (d, 3) float64
        Where they are and in which direction.
    dock_radius, dock_promise : (d,) float64
    dock_kind : (d,) int64
        0: a docking point. 1: a point of the patch's axis, from which growth can go on.
    """

    radius: NDArray[np.float64]
    slope: NDArray[np.float64]
    leaf_area: NDArray[np.float64]
    sample: NDArray[np.float64]
    reach: NDArray[np.float64]
    droop: NDArray[np.float64]
    lead: NDArray[np.float64]
    promise: NDArray[np.float64]
    dock_start: NDArray[np.int64]
    dock_place: NDArray[np.float64]
    dock_way: NDArray[np.float64]
    dock_radius: NDArray[np.float64]
    dock_promise: NDArray[np.float64]
    dock_kind: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Texture:
    """The foliage of a tree.

    Attributes
    ----------
    instances : Instances
        What is where; sorted by cluster.
    holder : (k,) int32
        The instance on which each hangs, a row before its own; -1: a branch of the tree.
    leaf_area : (c,) float64
        In each cluster of the tree, m2.
    target : (c,) float64
        What it should be: the density times the volume of the hull, m2.
    """

    instances: Instances
    holder: NDArray[np.int32]
    leaf_area: NDArray[np.float64]
    target: NDArray[np.float64]


def pack_patches(patches: Sequence[Patch], leaf_share: float = 0.5, leaf_bend: float = 0.0) -> PatchTable:
    """Flat arrays of patches.

    Parameters
    ----------
    patches : sequence of Patch
        Those without leaves are wood between others. At least one has leaves.
    leaf_share : float, default 0.5
        Area of a leaf over its length times its width, above 0 to 1: 0.5 is a rhombus.
    leaf_bend : float, default 0
        By how much leaves bend down from base to tip, radians, -3 to 3: of large leaves it matters for
        where they reach.

    Raises
    ------
    InputError
        If there is no patch or no leaf, or `leaf_share` or `leaf_bend` is out of its range.
    """
    if not patches:
        raise InputError("patches must have at least one patch")
    if not 0.0 < leaf_share <= 1.0:
        raise InputError(f"leaf_share must be above 0 and at most 1, got {leaf_share!r}")
    if not -3.0 <= leaf_bend <= 3.0:
        raise InputError(f"leaf_bend must be an angle of -3 to 3 radians, got {leaf_bend!r}")
    if not any(patch.leaves.n_leaves for patch in patches):
        raise InputError(f"at least one patch must have leaves, but none of {len(patches)} has")
    sample = np.stack([_sample_points(patch, leaf_bend) for patch in patches])
    middle = sample.mean(axis=1)
    radius = np.array([patch.radius for patch in patches])
    area = np.array([leaf_share * float(patch.leaves.length @ patch.leaves.width) for patch in patches])
    promise = [_promises(patch.dock_radius, radius, area, patches) for patch in patches]
    axes = [_axis_points(patch) for patch in patches]
    kind = [
        np.repeat([0, 1], [patch.n_docks, len(axis[2])]) for patch, axis in zip(patches, axes, strict=True)
    ]
    return PatchTable(
        radius=radius,
        slope=np.array([patch.slope for patch in patches], float),
        leaf_area=area,
        sample=sample,
        reach=np.maximum(np.linalg.norm(middle, axis=1), 1e-6),
        droop=np.where(middle[:, 2] > 0.0, np.arctan2(-middle[:, 0], middle[:, 2]), 0.0),
        lead=np.array([max([0.0, *patch.dock_position[:, 2], *axis[0][:, 2]])
                       for patch, axis in zip(patches, axes, strict=True)]),
        promise=np.array([float(each.sum()) for each in promise]),
        dock_start=np.append(0, np.cumsum([len(each) for each in kind])),
        dock_place=_both([patch.dock_position for patch in patches], [axis[0] for axis in axes]),
        dock_way=_both([patch.dock_direction for patch in patches], [axis[1] for axis in axes]),
        dock_radius=_both([patch.dock_radius for patch in patches], [axis[2] for axis in axes]),
        dock_promise=_both(promise, [np.zeros(len(axis[2])) for axis in axes]),
        dock_kind=np.concatenate(kind),
    )  # fmt: skip


def _both(docks: Sequence[NDArray], axes: Sequence[NDArray]) -> NDArray:
    """Docking points and points of the axis of each patch, one patch after the other."""
    return np.concatenate([part for pair in zip(docks, axes, strict=True) for part in pair])


def _sample_points(patch: Patch, leaf_bend: float) -> NDArray[np.float64]:
    """Points spread over the leaves of a patch, or over wood and docking points of one without."""
    from species._texturing_kernels import SAMPLES

    leaves = patch.leaves
    bare = not leaves.n_leaves
    points = np.concatenate([patch.graph.position, patch.dock_position]) if bare else leaves.base
    pick = np.linspace(0, len(points) - 1, SAMPLES).round().astype(int)
    if bare:
        return points[pick]
    share = (np.arange(SAMPLES) + 0.5) * GOLDEN % 1.0  # of the way from base to tip, along an arc
    bend = max(abs(leaf_bend), 1e-6) * np.sign(leaf_bend + 1e-12)
    ahead, below = np.sin(bend * share) / bend, (1.0 - np.cos(bend * share)) / bend
    length = leaves.length[pick, None]
    return (
        leaves.base[pick]
        + length * ahead[:, None] * leaves.along[pick]
        - length * below[:, None] * leaves.normal[pick]
    )


def _promises(
    dock_radius: NDArray[np.float64],
    radius: NDArray[np.float64],
    area: NDArray[np.float64],
    patches: Sequence[Patch],
) -> NDArray[np.float64]:
    """Leaf area of the patch without docking points that is nearest in thickness to each docking point."""
    ends = np.flatnonzero((area > 0.0) & np.array([patch.n_docks == 0 for patch in patches]))
    if not len(ends):
        return np.full(len(dock_radius), area[area > 0.0].min())
    off = np.abs(np.log(dock_radius[:, None] / radius[None, ends]))
    return area[ends[off.argmin(axis=1)]] if len(dock_radius) else np.empty(0)


def _axis_points(patch: Patch) -> tuple[NDArray, NDArray, NDArray]:
    """Place, direction and radius of points of the longest way through a patch; none if it has no docks."""
    graph = patch.graph
    if not patch.n_docks or graph.n_nodes < 2:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0)
    node = int(np.argmax(path_length(graph)))
    way = []
    while graph.parent[node] != NO_PARENT:
        way.append(node)
        node = int(graph.parent[node])
    at = np.array(way[:: -(-len(way) // AXIS_POINTS)])
    along = _unit(graph.position[at] - graph.position[graph.parent[at]])
    return graph.position[at], along, np.maximum(graph.radius[at], 1e-5)


def texture_tree(
    tree: ClusterTree,
    patches: PatchTable,
    *,
    leaf_density: float,
    rng: np.random.Generator,
    density: ArrayLike = 1.0,
    follow_scan: bool = False,
    scale_limits: tuple[float, float] = SCALE,
) -> Texture:
    r"""Fill the clusters of a tree with patches.

    From the cluster's seeds on, the docking points are taken in turn. Of a few patches of about
    its thickness the one is put there whose score is best: the match
    :math:`\frac{\min(t_r, t_d)}{\max(t_r, t_d)} \cos(\alpha_r - \alpha_d)` of thicknesses :math:`t` and
    slopes :math:`\alpha` of root and dock (Eq. 3.3 of [1]_, see the head of this module), times how much
    of it lies in free space of the cluster. Its own docking points wait in the same line. Some patches in
    between, and all once no docking point waits, are grown: to an empty place, from the docking point,
    the point of a patch's axis or of a branch from which it is reached best, over further patches where it is
    too far for one. It ends when the leaf area is reached.

    Parameters
    ----------
    tree : ClusterTree
        Its clusters' hulls are closed.
    patches : PatchTable
        Of the species, by :func:`pack_patches`.
    leaf_density : float
        Leaf area per volume of a hull, m2/m3, above 0 and at most 50.
    rng : numpy.random.Generator
        One number is drawn. Clusters do not depend on each other, but for the last part of the leaf area.
    density : float or (c,) array_like, default 1
        Factor for each cluster, >= 0: what light has left of its leaves (Eq. 4.13).
    follow_scan : bool, default False
        Clusters in which the scan has more points get more leaves: by the root of their density over the
        mean, within 0.5 to 2; the sum stays. Unknown densities count as the mean.
    scale_limits : (float, float), default (0.8, 1.25)
        Least and most scale of a patch, 0.1 to 10, before the last correction of the leaf area.

    Returns
    -------
    texture : Texture
        The sum of leaf areas is that of the targets, to rounding, unless patches that carry no others would
        have to be scaled by less than 0.7 or more than 1.3 for it. In a single cluster it may be off by what
        leads to it from far away, and by a patch; clusters smaller than a patch get one with the chance of
        their share of it, those out of reach stay empty. Every instance begins at a point of a branch, or at
        a docking point or a point of the axis of its holder.

    Raises
    ------
    InputError
        If a number is out of its range.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
       Konstanz, 2013.
    """
    low, high = (float(limit) for limit in scale_limits)
    if not 0.1 <= low <= high <= 10.0:
        raise InputError(f"scale_limits must be two ascending numbers from 0.1 to 10, got {scale_limits!r}")
    target = _targets(tree, leaf_density, density, follow_scan)
    seed = int(rng.integers(2**63))
    rows, holder, count, inside = _fill_clusters(tree, patches, target, np.array([low, high]), seed)
    cluster = np.repeat(np.arange(len(target)), count)
    area = patches.leaf_area[rows[:, 0].astype(int)] * rows[:, 8] ** 2
    keep = _thin(area, _carries_none(holder), float(target.sum()), seed)
    rows, cluster, area, holder = rows[keep], cluster[keep], area[keep], _renumber(holder, keep)
    free = _carries_none(holder)
    stretch = np.where(free, _stretch(area, free, cluster, target, inside)[cluster], 1.0)
    rows[:, 8] *= stretch
    leaf_area = np.zeros(len(target))
    np.add.at(leaf_area, cluster, area * stretch**2)
    holder.flags.writeable = False
    return Texture(_instances(rows, cluster, seed), holder, leaf_area, target)


def _targets(
    tree: ClusterTree, leaf_density: float, density: ArrayLike, follow_scan: bool
) -> NDArray[np.float64]:
    """Leaf area that each cluster should have, m2."""
    from species._space_kernels import hull_volume

    if not 0.0 < leaf_density <= 50.0:
        raise InputError(f"leaf_density must be above 0 and at most 50 m2/m3, got {leaf_density!r}")
    clusters = tree.clusters
    factor = np.array(np.broadcast_to(np.asarray(density, float), (len(clusters),)))
    if not (np.isfinite(factor).all() and (factor >= 0.0).all()):
        raise InputError("density must be finite numbers >= 0, one per cluster")
    volume = np.array([hull_volume(c.vertices, c.faces) if len(c.faces) else 0.0 for c in clusters])
    target = np.maximum(0.0, volume) * leaf_density * factor
    if follow_scan and target.sum() > 0.0:
        points = np.array([c.density for c in clusters])
        known = np.isfinite(points) & (volume > 0.0)
        mean = float(points[known] @ volume[known] / volume[known].sum()) if known.any() else 0.0
        if mean > 0.0:
            weight = np.sqrt(np.where(np.isfinite(points), points, mean) / mean).clip(*DENSITY_RANGE)
            target *= weight * (target.sum() / (target @ weight))
    return target


def _fill_clusters(
    tree: ClusterTree, table: PatchTable, target: NDArray[np.float64], limits: NDArray[np.float64], seed: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int64], NDArray[np.float64]]:
    """Instances of all clusters (k, 9), the row each hangs on; how many a cluster has, and its leaf area."""
    from species import _texturing_kernels as kernels

    packed = kernels.Patches(
        table.radius, table.slope, table.leaf_area, table.sample, table.reach, table.droop, table.lead,
        table.promise, table.dock_start, table.dock_place, table.dock_way, table.dock_radius,
        table.dock_promise, table.dock_kind,
    )  # fmt: skip
    m = MOST_PLACES
    docks = kernels.Docks(
        np.empty((m, 3)), np.empty((m, 3)), np.empty(m), np.empty(m), np.empty(m), np.empty(m, np.int64),
        np.empty(m, np.int64), np.empty(m, bool),
    )  # fmt: skip
    inside = np.empty((kernels.MOST_SIDE + 1) ** 3, bool)
    out, hold = np.empty((MOST_INSTANCES, 9)), np.empty(MOST_INSTANCES, np.int64)
    nodes = (tree.graph.position, tree.graph.parent, tree.graph.radius)
    wood = _wood_points(tree.graph)
    rows, holder = [np.empty((0, 9))], [np.empty(0, np.int64)]
    count, inside_area, total = np.zeros(len(target), np.int64), np.zeros(len(target)), 0
    for c in np.flatnonzero(target > 0.0):
        cluster = tree.clusters[c]
        n, inside_area[c] = kernels.fill_cluster(
            (cluster.vertices, cluster.faces), nodes, cluster.seed, wood, target[c], packed, docks,
            _cluster_seed(seed, int(c)), limits, inside, out, hold,
        )  # fmt: skip
        rows.append(out[:n].copy())
        holder.append(np.where(hold[:n] >= 0, hold[:n] + total, -1))
        count[c] = n
        total += n
    return np.concatenate(rows), np.concatenate(holder).astype(np.int32), count, inside_area


def _cluster_seed(seed: int, cluster: int) -> np.uint64:
    """A seed of its own for each cluster."""
    return np.uint64((seed + 0x9E3779B97F4A7C15 * (cluster + 1)) % 2**64)


def _carries_none(holder: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Whether an instance is free to be scaled or left out, as no others hang on it."""
    free = np.ones(len(holder), bool)
    free[holder[holder >= 0]] = False
    return free


def _renumber(holder: NDArray[np.int32], keep: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Rows on which those that are kept hang, counted among these; they are kept too."""
    row = np.cumsum(keep) - 1
    return np.where(holder >= 0, row[holder], -1)[keep].astype(np.int32)


def _thin(area: NDArray[np.float64], free: NDArray[np.bool_], target: float, seed: int) -> NDArray[np.bool_]:
    """Which instances stay, if there are too many even when all are scaled as small as they may be."""
    keep = np.ones(len(area), bool)
    least = np.where(free, STRETCH[0] ** 2, 1.0) * area
    if least.sum() > target:
        order = np.random.default_rng([seed, 1]).permutation(np.flatnonzero(free))
        left = least.sum() - np.cumsum(least[order])
        keep[order[: np.searchsorted(-left, -target) + 1]] = False
    return keep


def _stretch(
    area: NDArray[np.float64],
    free: NDArray[np.bool_],
    cluster: NDArray[np.int64],
    target: NDArray[np.float64],
    inside: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Factor for each cluster on the scale of patches that are free for it, as they carry no others.

    What is missing or too much inside each cluster first; what then is in the tree, by a common factor.
    """
    k, low, high = len(target), *STRETCH
    loose = np.bincount(cluster, np.where(free, area, 0.0), minlength=k)
    fixed = float(area[~free].sum())
    wanted = np.maximum(loose + target - inside, 0.0)
    own = np.sqrt(np.divide(wanted, loose, out=np.ones(k), where=loose > 0.0)).clip(low, high)
    least, most = low / high, high / low
    for _ in range(60):
        common = 0.5 * (least + most)
        if fixed + loose @ (own * common).clip(low, high) ** 2 < target.sum():
            least = common
        else:
            most = common
    return (own * 0.5 * (least + most)).clip(low, high)


def _instances(rows: NDArray[np.float64], cluster: NDArray[np.int64], seed: int) -> Instances:
    """Rows of all clusters as one table, and an order in which any prefix is spread over the tree."""
    order = np.random.default_rng(seed).permutation(len(rows))
    return Instances(
        patch=rows[:, 0].astype(np.int32),
        position=rows[:, 1:4],
        rotation=rows[:, 4:8],
        scale=rows[:, 8],
        cluster=cluster.astype(np.int32),
        order=order.astype(np.int32),
    )


def _wood_points(graph: TreeGraph) -> NDArray[np.float64]:
    """Place, direction and radius (m, 7) of points along all branches, 0.15 m apart at most."""
    node = np.flatnonzero(graph.parent != NO_PARENT)
    start, end = graph.position[graph.parent[node]], graph.position[node]
    count = np.maximum(np.ceil(np.linalg.norm(end - start, axis=1) / WOOD_STEP), 1).astype(int)
    row = np.repeat(np.arange(len(node)), count)
    step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count) + 1
    share = (step / count[row])[:, None]
    place = start[row] * (1.0 - share) + end[row] * share
    return np.column_stack([place, _unit(end - start)[row], graph.radius[node][row]])


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows scaled to length one; (0, 0, 1) for those without length."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.where(length > 1e-12, vector / np.maximum(length, 1e-12), (0.0, 0.0, 1.0))
