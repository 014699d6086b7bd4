r"""Clusters filled with a species' twigs and leaves: from seeds, patch by patch.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 3.4 (Eq. 3.3) and Eq. 4.13 (density by light); Y. Livny et al., "Texture-lobes for
tree modelling", ACM Trans. Graph. 30(4), 2011.
Departs from it in: Eq. 3.3 is printed as a product in which a worse match of thicknesses raises the value;
here equal thickness and equal direction are best. The fit to the cluster is measured against its
hull and against what is there already. Where docking points end before the cluster is full, patches go
on in its emptiest places. At the end all patches of a cluster are scaled so that its leaf area is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from species.patches import Instances, Patch
from treegraph import NO_PARENT, ClusterTree, InputError

__all__ = ["PatchTable", "Texture", "pack_patches", "texture_tree"]

PIPE_EXPONENT = 2.49  # a seed of this many times the radius feeds so many more patches (thesis, Eq. 5.6)
MOST_DOCKS = 6  # docking points of one seed
FAN = 0.7  # radians between the docking points of a thick seed and its own direction
LEAN = 0.5  # how much a seed's direction is turned to the middle of its cluster
GOLDEN_ANGLE = float(np.pi * (3.0 - np.sqrt(5.0)))
MOST_INSTANCES = 20_000  # of one cluster
STRETCH = (
    0.7,
    1.3,
)  # factors by which a cluster's patches are scaled at most, so that its leaf area is right


@dataclass(frozen=True, eq=False)
class PatchTable:
    """A species' patches as flat arrays, packed once by :func:`pack_patches`.

    Attributes
    ----------
    radius, slope : (p,) float64
        Of the patches' roots.
    leaf_area : (p,) float64
        One side of all leaves of a patch, m2.
    by_radius : (p,) int64
        Patches from thin to thick.
    sample : (p, 16, 3) float64
        Points of each patch, spread over its leaves.
    reach : (p,) float64
        Mean height of these above the root, metres.
    dock_start : (p + 1,) int64
        Docking points ``dock_start[i]:dock_start[i + 1]`` are the i-th patch's.
    docks : tuple of (d, 3), (d, 3), (d,) float64
        Their positions, directions and radii.
    """

    radius: NDArray[np.float64]
    slope: NDArray[np.float64]
    leaf_area: NDArray[np.float64]
    by_radius: NDArray[np.int64]
    sample: NDArray[np.float64]
    reach: NDArray[np.float64]
    dock_start: NDArray[np.int64]
    docks: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class Texture:
    """The foliage of a tree.

    Attributes
    ----------
    instances : Instances
        What is where; sorted by cluster.
    leaf_area : (k,) float64
        In each cluster of the tree, m2.
    target : (k,) float64
        What it should be: the density times the volume of the hull, m2.
    free : int
        Instances that hang on no docking point.
    """

    instances: Instances
    leaf_area: NDArray[np.float64]
    target: NDArray[np.float64]
    free: int


def pack_patches(patches: Sequence[Patch], leaf_share: float = 0.5) -> PatchTable:
    """Flat arrays of patches.

    Parameters
    ----------
    patches : sequence of Patch
        Those without leaves are wood between others. At least one has leaves.
    leaf_share : float, default 0.5
        Area of a leaf over its length times its width, above 0 to 1: 0.5 is a rhombus.

    Raises
    ------
    InputError
        If there is no patch or no leaf, or `leaf_share` is out of its range.
    """
    if not patches:
        raise InputError("patches must have at least one patch")
    if not 0.0 < leaf_share <= 1.0:
        raise InputError(f"leaf_share must be above 0 and at most 1, got {leaf_share!r}")
    if not any(patch.leaves.n_leaves for patch in patches):
        raise InputError(f"at least one patch must have leaves, but none of {len(patches)} has")
    sample = np.stack([_sample_points(patch) for patch in patches])
    radius = np.array([patch.radius for patch in patches])
    area = [leaf_share * float(patch.leaves.length @ patch.leaves.width) for patch in patches]
    return PatchTable(
        radius=radius,
        slope=np.array([patch.slope for patch in patches], float),
        leaf_area=np.array(area),
        by_radius=np.argsort(radius, kind="stable"),
        sample=sample,
        reach=sample[:, :, 2].mean(axis=1),
        dock_start=np.concatenate([[0], np.cumsum([patch.n_docks for patch in patches])]).astype(np.int64),
        docks=(
            np.concatenate([patch.dock_position for patch in patches]),
            np.concatenate([patch.dock_direction for patch in patches]),
            np.concatenate([patch.dock_radius for patch in patches]),
        ),
    )


def _sample_points(patch: Patch) -> NDArray[np.float64]:
    """Points spread over a patch: the middles of its leaves, or of a bare one wood and docking points."""
    from species._texturing_kernels import SAMPLES

    leaves = patch.leaves
    points = leaves.base + 0.5 * leaves.length[:, None] * leaves.along
    if not len(points):
        points = np.concatenate([patch.graph.position, patch.dock_position])
    return points[np.linspace(0, len(points) - 1, SAMPLES).round().astype(int)]


def texture_tree(
    tree: ClusterTree,
    patches: PatchTable,
    *,
    leaf_density: float,
    rng: np.random.Generator,
    density: ArrayLike = 1.0,
) -> Texture:
    r"""Fill the clusters of a tree with patches.

    From the cluster's seeds on, the docking points are taken in turn. Of a few patches of about
    its thickness the one is put there whose score is best: the match
    :math:`\frac{\min(t_r, t_d)}{\max(t_r, t_d)} \cos(\alpha_r - \alpha_d)` of thicknesses :math:`t` and
    slopes :math:`\alpha` of root and dock (Eq. 3.3 of [1]_, see the head of this module), times how much
    of it lies in free space of the cluster. Its own docking points wait in the same line. It ends when the
    leaf area is reached.

    Parameters
    ----------
    tree : ClusterTree
        Its clusters' hulls are closed; its seeds' radii are known.
    patches : PatchTable
        Of the species, by :func:`pack_patches`.
    leaf_density : float
        Leaf area per volume of a hull, m2/m3, above 0 and at most 50.
    rng : numpy.random.Generator
        One number is drawn. Clusters do not depend on each other.
    density : float or (k,) array_like, default 1
        Factor for each cluster, >= 0: what light has left of its leaves (Eq. 4.13).

    Returns
    -------
    texture : Texture
        The leaf area of a cluster is its target, to rounding, unless patches would have to be scaled by less
        than 0.7 or more than 1.3 for it. A cluster too thin for any patch stays empty.

    Raises
    ------
    InputError
        If a number is out of its range.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
       Konstanz, 2013.
    """
    from species import _texturing_kernels as kernels

    if not 0.0 < leaf_density <= 50.0:
        raise InputError(f"leaf_density must be above 0 and at most 50 m2/m3, got {leaf_density!r}")
    k = len(tree.clusters)
    factor = np.array(np.broadcast_to(np.asarray(density, float), (k,)))
    if not (np.isfinite(factor).all() and (factor >= 0.0).all()):
        raise InputError("density must be finite numbers >= 0, one per cluster")
    seed = int(rng.integers(2**63))
    packed = (patches.radius, patches.slope, patches.by_radius, patches.sample)
    cells = (kernels.MOST_SIDE + 1) ** 3
    scratch = (np.empty(cells, bool), np.empty(cells), np.empty((MOST_INSTANCES * 2, 7)))
    rows = np.empty((MOST_INSTANCES, 9))
    made: list[NDArray[np.float64]] = []
    target, area, free = np.zeros(k), np.zeros(k), 0
    for c, cluster in enumerate(tree.clusters):
        volume = kernels.hull_volume(cluster.vertices, cluster.faces) if len(cluster.faces) else 0.0
        target[c] = max(0.0, volume) * leaf_density * factor[c]
        if target[c] == 0.0:
            made.append(np.empty((0, 9)))
            continue
        n, area[c], loose = kernels.fill_cluster(
            cluster.vertices,
            cluster.faces,
            _docks_of(tree, c, float(patches.radius.max())),
            target[c],
            packed,
            patches.leaf_area,
            patches.reach,
            patches.dock_start,
            patches.docks,
            _cluster_seed(seed, c),
            scratch,
            rows,
        )
        free += int(loose)
        part = rows[:n].copy()
        if n:
            stretch = float(np.clip(np.sqrt(target[c] / area[c]), *STRETCH))
            part[:, 8] *= stretch
            area[c] *= stretch**2
        made.append(part)
    return Texture(_instances(made, seed), area, target, free)


def _cluster_seed(seed: int, cluster: int) -> np.uint64:
    """A seed of its own for each cluster."""
    return np.uint64((seed + 0x9E3779B97F4A7C15 * (cluster + 1)) % 2**64)


def _instances(made: Sequence[NDArray[np.float64]], seed: int) -> Instances:
    """Rows of all clusters as one table, and an order in which any prefix is spread over the tree."""
    rows = np.concatenate([np.empty((0, 9)), *made])
    cluster = np.repeat(np.arange(len(made)), [len(part) for part in made])
    order = np.random.default_rng(seed).permutation(len(rows))
    return Instances(
        patch=rows[:, 0].astype(np.int32),
        position=rows[:, 1:4],
        rotation=rows[:, 4:8],
        scale=rows[:, 8],
        cluster=cluster.astype(np.int32),
        order=order.astype(np.int32),
    )


def _docks_of(tree: ClusterTree, cluster: int, thickest: float) -> tuple[NDArray, NDArray, NDArray]:
    """Docking points on the tree: the seeds, of thick ones several in a fan around the branch's direction."""
    graph, seeds = tree.graph, tree.clusters[cluster].seed
    if not len(seeds):
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0)
    position, radius = graph.position[seeds], np.nan_to_num(graph.radius[seeds], nan=thickest)
    radius = np.maximum(radius, 1e-4)
    before = graph.position[np.maximum(graph.parent[seeds], 0)]
    along = np.where((graph.parent[seeds] == NO_PARENT)[:, None], (0.0, 0.0, 1.0), position - before)
    middle = tree.clusters[cluster].vertices.mean(axis=0)
    axis = _unit(_unit(along) + LEAN * _unit(middle - position))
    count = np.clip(np.ceil((radius / thickest) ** PIPE_EXPONENT), 1, MOST_DOCKS).astype(int)
    row = np.repeat(np.arange(len(seeds)), count)
    step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    helper = np.where(np.abs(axis[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    side = _unit(np.cross(axis, helper))
    other = np.cross(axis, side)
    turn = (GOLDEN_ANGLE * step)[:, None]
    lean = np.where(step == 0, 0.0, FAN)[:, None]
    across = np.cos(turn) * side[row] + np.sin(turn) * other[row]
    direction = np.cos(lean) * axis[row] + np.sin(lean) * across
    return np.ascontiguousarray(position[row]), np.ascontiguousarray(direction), radius[row]


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows scaled to length one; (0, 0, 1) for those without length."""
    length = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.where(length > 1e-12, vector / np.maximum(length, 1e-12), (0.0, 0.0, 1.0))
