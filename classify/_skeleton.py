"""Features: the skeleton and the leaf clusters of a first reconstruction.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 ("from an approximate first reconstruction"); O. Stava et al., "Inverse
Procedural Modelling of Trees", Computer Graphics Forum, 2014, section 5.2 and table 3 (the properties of
branches, and their weights: thickness, or its square, and for all but angles times length).
Departs from it in: directions are taken over 1/40 of the tree's height instead of from node to node, so
that they do not depend on how finely the skeleton is sampled; branches shorter than 1/20 are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classify._feature import (
    Feature,
    Floats,
    divided,
    family,
    mean_of,
    quantiles_of,
    ratio_of,
    shares_of,
    spread_of,
)

if TYPE_CHECKING:
    from treegraph import Cluster, TreeGraph

REACH = 1.0 / 40.0  # of the height: over which directions are taken
MIN_LENGTH = 1.0 / 20.0  # of the height: shorter branches are left out
N_SLOPES = 6
N_ORDERS = 4
TAPER_AT = (25, 50, 75)  # % of the trunk's length
FLUSH = 1e-9
SKELETON, CLUSTERS = "skeleton", "clusters"

_PROPERTIES = [
    ("length", "", "length of a branch over the tree's height"),
    ("thickness", "", "largest radius of a branch over the trunk's"),
    ("bend", "rad", "bend of a branch, added up, per tenth of the height"),
    ("straightness", "", "distance of a branch's ends over its length"),
    ("slope", "rad", "angle of a branch's ends over the horizontal"),
    ("parent_angle", "rad", "angle between a branch and its parent"),
    ("sibling_angle", "rad", "angle between a branch and its nearest sibling"),
]
_BY_ORDER = [
    ("number", "", "number of branches"),
    ("length", "", "median length over the tree's height"),
    ("length_to_parent", "", "median length over the parent's"),
    ("parent_angle", "rad", "median angle to the parent"),
    ("slope", "rad", "median slope over the horizontal"),
    ("first_slope", "rad", "median slope of the first piece"),
    ("straightness", "", "median distance of the ends over the length"),
    ("radius_to_parent", "", "median first radius over the parent's there"),
    ("spacing", "", "median distance to the next branch on the parent over the tree's height"),
    ("spacing_variation", "", "standard deviation of these distances over their mean"),
]
_WHOLE = [
    ("trunk_length", "", "length of the trunk's axis over the tree's height"),
    ("trunk_straightness", "", "distance of the trunk's ends over its length"),
    ("trunk_bend", "rad", "accumulated bend of the trunk per tenth of the tree's height"),
    ("trunk_lean", "rad", "angle of the trunk's ends to the vertical"),
    ("trunk_tip", "", "height of the trunk's tip over the tree's"),
    ("wood_length", "", "length of all wood over the tree's height"),
    ("wood_volume", "", "volume of all wood over the cube of the tree's height"),
    ("wood_volume_m3", "m3", "volume of all wood"),
    ("trunk_volume_share", "", "share of the trunk in the volume of all wood"),
    ("wood_height", "", "mean height of the wood, by length, over the tree's"),
    ("wood_height_spread", "", "standard deviation of the same"),
    ("branches_per_metre", "1/m", "branches of order 1 per metre of trunk"),
    ("lowest_branch", "", "height of the lowest branch with 5% of the wood's length over the tree's"),
    ("branching_ratio", "", "branches of order 2 per branch of order 1"),
    ("order_mean", "", "mean order of the wood, by length"),
    ("tips_per_length", "", "tips per length of wood of the tree's height"),
    ("heading_evenness", "", "branches of order 1 around the trunk: 1 less the length of the mean direction"),
    ("rise_of_angles", "rad", "change of the angle of order 1 from the lower to the upper half of the trunk"),
    ("rise_of_lengths", "", "the same of the length over the tree's height"),
    ("measured_share", "", "share of the wood's length whose radius was measured"),
]  # fmt: skip
_CLUSTER = [
    ("number", "", "number of leaf clusters"),
    ("volume", "m3", "volume of all clusters"),
    ("volume_to_cube", "", "the same over the cube of the tree's height"),
    ("volume_mean", "m3", "mean volume of a cluster"),
    ("volume_variation", "", "standard deviation of the volumes over their mean"),
    ("volume_largest", "", "share of the largest cluster in the volume"),
    ("size", "", "median edge of a cube of a cluster's volume over the tree's height"),
    ("flatness", "", "median height of a cluster over its mean width"),
    ("elongation", "", "median of the longer over the shorter horizontal extent"),
    ("sphericity", "", "median surface of a sphere of a cluster's volume over the cluster's"),
    ("height_mean", "", "mean height of the clusters, by volume, over the tree's"),
    ("height_spread", "", "standard deviation of the same"),
    ("lowest", "", "lower end of the lowest cluster over the tree's height"),
    ("distance_mean", "", "mean distance from the trunk's axis, by volume, over the tree's height"),
    ("density_variation", "", "standard deviation of the points per volume over their mean"),
    ("point_share_largest", "", "share of the points of all clusters in the largest"),
    ("seeds", "", "mean number of nodes that a cluster grows from"),
]  # fmt: skip

_ORDERS = [*((str(k), str(k)) for k in range(N_ORDERS - 1)), (str(N_ORDERS - 1), f"{N_ORDERS - 1} and above")]

FEATURES = (
    *(
        Feature(f"{name}_{kind}{weight}", unit, SKELETON, f"{text}: {word}, weight {rule}")
        for name, unit, text in _PROPERTIES
        for kind, word in (("mean", "mean"), ("spread", "standard deviation"))
        for weight, rule in (("", "thickness"), ("_stout", "thickness squared"))
    ),
    *(
        Feature(f"order_{order}_{name}", unit, SKELETON, f"{text}, order {order}")
        for order in (1, 2)
        for name, unit, text in _BY_ORDER
    ),
    *family(SKELETON, "order_{}_share", "share of the wood's length in order {}", _ORDERS),
    *family(
        SKELETON,
        "wood_slope_{}",
        "share of the wood's length with |sine of the slope| in sixth {}, from 0",
        range(1, N_SLOPES + 1),
    ),
    *family(SKELETON, "taper_{}", "radius of the trunk at {}% of its length over that at 10%", TAPER_AT),
    *(Feature(name, unit, SKELETON, text) for name, unit, text in _WHOLE),
    *(Feature(f"cluster_{name}", unit, CLUSTERS, text) for name, unit, text in _CLUSTER),
)


@dataclass(frozen=True, eq=False)
class Branches:
    """The branches of a skeleton; c rows, the trunk first, a branch after its parent.

    Attributes
    ----------
    parent : (c,) int64
        -1: none.
    order : (c,) int64
        0 on the trunk.
    length, chord, rise, radius, first_radius, parent_radius, bend : (c,) float64
        Metres, and radians.
    attached, attached_z : (c,) float64
        Way along the parent and height at which it leaves, metres.
    parent_angle, sibling_angle : (c,) float64
        Radians.
    direction : (c, 3) float64
        Of the first piece.
    spacing : (c,) float64
        Way on the parent to the next branch, metres.
    """

    parent: NDArray[np.int64]
    order: NDArray[np.int64]
    length: Floats
    chord: Floats
    rise: Floats
    radius: Floats
    first_radius: Floats
    parent_radius: Floats
    bend: Floats
    attached: Floats
    attached_z: Floats
    parent_angle: Floats
    direction: Floats
    sibling_angle: Floats
    spacing: Floats

    @property
    def slope(self) -> Floats:
        """(c,) angle of the chord over the horizontal, radians."""
        return np.arcsin(np.clip(divided(self.rise, self.chord), -1.0, 1.0))

    @property
    def straightness(self) -> Floats:
        """(c,) chord over length."""
        return divided(self.chord, self.length)


def find_branches(graph: TreeGraph, height: float) -> Branches:
    """The trunk, and the branches that are not shorter than a share of the height, with what table 3 has."""
    from classify import _feature_kernels as kernels
    from treegraph import chains, gravelius_order

    start, node = chains(graph)
    parent, column = kernels.branch_table(graph.position, graph.radius, start, node, REACH * height)
    order = np.asarray(gravelius_order(graph))[node[start[1:] - 1]].astype(np.int64)
    keep = column[:, 0] >= MIN_LENGTH * height
    keep[0] = True
    lost = (parent >= 0) & ~keep[np.maximum(parent, 0)]
    while lost.any():  # a branch of one that is left out counts as its grandparent's
        parent = np.where(lost, parent[np.maximum(parent, 0)], parent)
        lost = (parent >= 0) & ~keep[np.maximum(parent, 0)]
    into = np.cumsum(keep) - 1
    parent = np.where(parent >= 0, into[np.maximum(parent, 0)], -1)[keep]
    column, order = column[keep], order[keep]
    length, chord, rise, radius, first_radius, parent_radius, bend, attached, attached_z, angle = column[
        :, :10
    ].T
    direction = column[:, 10:]
    sibling, spacing = _siblings(parent, attached, direction)
    return Branches(
        parent, order, length, chord, rise, radius, first_radius, parent_radius, bend, attached, attached_z,
        angle, direction, sibling, spacing,
    )  # fmt: skip


def _siblings(parent: NDArray[np.int64], attached: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Angle to the nearest branch on the same parent, and the way to the next one up."""
    n = len(parent)
    angle, spacing = np.full(n, np.nan), np.full(n, np.nan)
    order = np.lexsort((attached, parent))
    a, b = order[:-1], order[1:]
    same = (parent[a] == parent[b]) & (parent[a] >= 0)
    a, b = a[same], b[same]
    gap = attached[b] - attached[a]
    turn = np.arccos(np.clip((direction[a] * direction[b]).sum(axis=1), -1.0, 1.0))
    spacing[a] = gap
    nearest = np.full(n, np.inf)
    for one in (a, b):  # each pair may be the nearest of both
        better = gap < nearest[one]
        angle[one[better]], nearest[one[better]] = turn[better], gap[better]
    return angle, spacing


def describe_skeleton(graph: TreeGraph | None, height: float) -> dict[str, float]:
    """Statistics of the branches, by name; nothing without a skeleton."""
    if graph is None or graph.n_nodes < 3 or not height > 0.0:
        return {}
    branches = find_branches(graph, height)
    out = _weighted(branches, height)
    for order in (1, 2):
        out |= _of_order(branches, order, height)
    return out | _wood(graph, height) | _trunk(graph, branches, height) | _first_order(branches, height)


def _weighted(branches: Branches, height: float) -> dict[str, float]:
    """Mean and standard deviation of the properties of table 3 with both weights of section 5.2."""
    trunk = branches.radius[0]
    values = {
        "length": branches.length / height,
        "thickness": divided(branches.radius, trunk),
        "bend": divided(branches.bend, branches.length) * (0.1 * height),
        "straightness": branches.straightness,
        "slope": branches.slope,
        "parent_angle": branches.parent_angle,
        "sibling_angle": branches.sibling_angle,
    }
    out = {}
    thick = np.nan_to_num(branches.radius)
    for name, value in values.items():
        by_length = 1.0 if name.endswith("angle") else branches.length
        for ending, weight in (("", thick * by_length), ("_stout", thick**2 * by_length)):
            out[f"{name}_mean{ending}"] = mean_of(value, weight)
            out[f"{name}_spread{ending}"] = spread_of(value, weight)
    return out


def _median(value: Floats) -> float:
    return float(quantiles_of(value, (0.5,))[0])


def _of_order(branches: Branches, order: int, height: float) -> dict[str, float]:
    mine = (branches.order == order) & (branches.parent >= 0)
    length, before = branches.length[mine], branches.parent[mine]
    spacing = branches.spacing[mine]
    values = {
        "number": float(mine.sum()),
        "length": _median(length / height),
        "length_to_parent": _median(divided(length, branches.length[before])),
        "parent_angle": _median(branches.parent_angle[mine]),
        "slope": _median(branches.slope[mine]),
        "first_slope": _median(np.arcsin(np.clip(branches.direction[mine, 2], -1.0, 1.0))),
        "straightness": _median(branches.straightness[mine]),
        "radius_to_parent": _median(divided(branches.first_radius[mine], branches.parent_radius[mine])),
        "spacing": _median(spacing / height),
        "spacing_variation": ratio_of(spread_of(spacing), mean_of(spacing)),
    }
    return {f"order_{order}_{name}": value for name, value in values.items()}


def _wood(graph: TreeGraph, height: float) -> dict[str, float]:
    """Statistics over the segments, by their length."""
    from treegraph import count_tips, gravelius_order, segment_length, subtree_length

    parent, z = graph.parent, graph.position[:, 2]
    before = np.maximum(parent, 0)
    length = np.asarray(segment_length(graph))
    total = float(length.sum())
    order = np.asarray(gravelius_order(graph)).astype(np.int64)
    r1 = graph.radius
    r0 = np.where(order == order[before], r1[before], r1)
    volume = np.nan_to_num(np.pi / 3.0 * length * (r0 * r0 + r0 * r1 + r1 * r1))
    share = 0.5 * (z + z[before]) / height
    rise = np.nan_to_num(divided(np.abs(z - z[before]), length))
    slope = np.minimum((rise * N_SLOPES).astype(np.int64), N_SLOPES - 1)
    out = {f"wood_slope_{k + 1}": float(s) for k, s in enumerate(shares_of(slope, N_SLOPES, length))}
    orders = shares_of(np.minimum(order, N_ORDERS - 1), N_ORDERS, length)
    out |= {f"order_{k}_share": float(s) for k, s in enumerate(orders)}
    side = (order == 1) & (parent >= 0) & (order[before] == 0)
    large = side & (np.asarray(subtree_length(graph)) + length >= 0.05 * total)
    measured = graph.attribute.get("measured")
    return out | {
        "wood_length": total / height,
        "wood_volume": float(volume.sum()) / height**3,
        "wood_volume_m3": float(volume.sum()),
        "trunk_volume_share": ratio_of(float(volume[order == 0].sum()), float(volume.sum())),
        "wood_height": mean_of(share, length),
        "wood_height_spread": spread_of(share, length),
        "lowest_branch": float(z[before[large]].min()) / height if large.any() else np.nan,
        "order_mean": mean_of(order.astype(float), length),
        "tips_per_length": ratio_of(float(np.asarray(count_tips(graph))[parent < 0].sum()) * height, total),
        "measured_share": np.nan if measured is None else mean_of(np.asarray(measured, float), length),
    }


def _trunk(graph: TreeGraph, branches: Branches, height: float) -> dict[str, float]:
    from treegraph import chains

    start, node = chains(graph)
    trunk = node[: start[1]]
    position, radius = graph.position[trunk], graph.radius[trunk]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    length = float(way[-1])
    known = np.isfinite(radius)
    at = np.array([10, *TAPER_AT]) / 100.0 * length
    there = np.interp(at, way[known], radius[known]) if known.sum() > 1 else np.full(len(at), np.nan)
    out = {
        f"taper_{a}": ratio_of(float(r), float(there[0])) for a, r in zip(TAPER_AT, there[1:], strict=True)
    }
    return out | {
        "trunk_length": length / height,
        "trunk_straightness": ratio_of(float(branches.chord[0]), length),
        "trunk_bend": ratio_of(float(branches.bend[0]) * 0.1 * height, length),
        "trunk_lean": 0.5 * np.pi - float(branches.slope[0]),
        "trunk_tip": float(position[-1, 2]) / height,
    }


def _first_order(branches: Branches, height: float) -> dict[str, float]:
    """How the branches of order 1 stand around the trunk and change along it."""
    on_trunk = branches.parent == 0
    n_first, n_second = int((branches.order == 1).sum()), int((branches.order == 2).sum())
    direction = branches.direction[on_trunk, :2]
    flat = np.hypot(*direction.T)
    direction = direction[flat > FLUSH] / flat[flat > FLUSH, None]
    upper = (
        branches.attached[on_trunk] >= _median(branches.attached[on_trunk])
        if on_trunk.any()
        else np.zeros(0, bool)
    )
    angle, length = branches.parent_angle[on_trunk], branches.length[on_trunk] / height
    return {
        "branches_per_metre": ratio_of(float(on_trunk.sum()), float(branches.length[0])),
        "branching_ratio": ratio_of(float(n_second), float(n_first)),
        "heading_evenness": 1.0 - float(np.hypot(*direction.mean(axis=0))) if len(direction) else np.nan,
        "rise_of_angles": _median(angle[upper]) - _median(angle[~upper]),
        "rise_of_lengths": _median(length[upper]) - _median(length[~upper]),
    }


def describe_clusters(clusters: tuple[Cluster, ...] | None, height: float) -> dict[str, float]:
    """Statistics of the leaf clusters, by name; a bare tree has 0 of them and nothing else."""
    if clusters is None:
        return {}
    if not clusters or not height > 0.0:
        return {"cluster_number": float(len(clusters))}
    volume, surface, low, high, long, short, x, y, z = _hulls(clusters).T
    n_points = np.array([c.n_points for c in clusters], float)
    total = float(volume.sum())
    density = divided(n_points, volume)
    values = {
        "number": float(len(clusters)),
        "volume": total,
        "volume_to_cube": total / height**3,
        "volume_mean": float(volume.mean()),
        "volume_variation": ratio_of(float(volume.std()), float(volume.mean())),
        "volume_largest": ratio_of(float(volume.max()), total),
        "size": _median(np.cbrt(volume)) / height,
        "flatness": _median(divided(high - low, 0.5 * (long + short))),
        "elongation": _median(divided(long, short)),
        "sphericity": _median(divided(np.cbrt(36.0 * np.pi * volume**2), surface)),
        "height_mean": mean_of(z, volume) / height,
        "height_spread": spread_of(z, volume) / height,
        "lowest": float(low.min()) / height,
        "distance_mean": mean_of(np.hypot(x, y), volume) / height,
        "density_variation": ratio_of(spread_of(density), mean_of(density)),
        "point_share_largest": ratio_of(float(n_points.max()), float(n_points.sum())),
        "seeds": float(np.mean([len(c.seed) for c in clusters])),
    }
    return {f"cluster_{name}": value for name, value in values.items()}


def _hulls(clusters: tuple[Cluster, ...]) -> Floats:
    """Measures (k, 9) of the hulls: the columns of ``hull_table``."""
    from classify import _feature_kernels as kernels

    first_vertex = np.concatenate([[0], np.cumsum([len(c.vertices) for c in clusters])])
    first_face = np.concatenate([[0], np.cumsum([len(c.faces) for c in clusters])])
    vertices = np.concatenate([c.vertices for c in clusters])
    faces = np.concatenate([c.faces + begin for c, begin in zip(clusters, first_vertex[:-1], strict=True)])
    return kernels.hull_table(vertices, faces, first_vertex, first_face)
