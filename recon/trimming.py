"""Trimming: branches that are none go, and the skeleton keeps to its budget of nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from recon.radii import final_radii
from recon.skeleton import Skeleton, chains_of, keep_nodes, merge_nodes
from recon.tubes import coarsen

SPUR_SLICES = 1.2  # side chains that stick out less than this, in slices, are no branches
SPUR_LENGTH = 0.015  # metres, at least
SPUR_STRIDE = 0.10  # ... for each such piece of its length, metres
SPUR_FAR = 0.03  # points farther than this outside the parent's tube count for a side chain, metres
FEW_POINTS = 1.0  # and if it has no more of them it is no branch
GAP_SPACINGS = 3.0  # a gap on a branch is longer than so many point spacings ...
GAP_LENGTH = 0.10  # ... and than this, metres
GAP_POINTS = 1.0  # points that excuse a gap, for each point spacing of it

# Each round over the budget relaxes what follows a little more.
TINY = 1e-9
SPEND_STEPS = 5
MAX_ROUNDS = 50
TOLERANCE = 0.002  # of the axis of twigs with a median number of points a metre, metres
TOLERANCE_RANGE = (0.001, 0.03)
DENSITY_RANGE = (0.4, 4.0)  # denser chains get less of it and sparser ones more, within this
TUBE_TOLERANCE = 0.15  # of the axis of a tube, in radii ...
TUBE_SPACINGS = 0.1  # ... or point spacings
RADIUS_TOLERANCE = 0.15  # in radii
SMALLEST_RADIUS_TOLERANCE = 0.0015  # metres
RELAX_TOLERANCE, RELAX_TUBE, RELAX_RADIUS, RELAX_FEW = 1.12, 1.10, 1.06, 1.12
FEW_OVER_BUDGET = 0.5
FAR_OVER_BUDGET = 0.055  # metres
APART_OVER_BUDGET = 0.015  # metres between the nodes of a twig
APART_RANGE = (0.4, 3.0)


def drop_spurs(
    xyz: np.ndarray, skeleton: Skeleton, few: float = FEW_POINTS, far: float = SPUR_FAR
) -> Skeleton:
    """Give side chains back to their parent that hardly stick out of it or carry few points."""
    from recon import _tube_kernels as tubes

    chains = chains_of(skeleton)
    shortest = max(SPUR_SLICES * skeleton.slice_width, SPUR_LENGTH)
    into = tubes.spurs(
        xyz,
        chains.point_start,
        chains.point,
        skeleton.parent,
        chains.onward,
        chains.head,
        skeleton.position,
        skeleton.radius,
        shortest,
        far,
        few,
        SPUR_STRIDE,
    )
    return merge_nodes(skeleton, into, lose=True)


def drop_unsupported(skeleton: Skeleton) -> Skeleton:
    """Cut branch ends that hang behind a long gap with hardly a point to show for it."""
    from recon import _tube_kernels as tubes

    n_points = skeleton.n_points
    gap = max(GAP_SPACINGS * skeleton.spacing, GAP_LENGTH)
    keep = tubes.unsupported_tips(
        GAP_POINTS / skeleton.spacing, skeleton.parent, skeleton.position, n_points, gap
    )
    into = np.arange(skeleton.n_nodes)
    into[~keep] = skeleton.parent[~keep]
    return merge_nodes(skeleton, into, lose=True)


def fit_budget(xyz: np.ndarray, skeleton: Skeleton, gamma: float, max_nodes: int) -> Skeleton:
    """The skeleton with as few nodes as its points need, and no more than `max_nodes`.

    Nodes go where the axis and the radius stay within a tolerance, tight on tubes and where there
    are many points, wide on twigs with few. While there are too many left, the tolerance grows and
    the side chains with the fewest points of their own go.

    Parameters
    ----------
    xyz : (n, 3) float64
    skeleton : Skeleton
        With fitted tubes.
    gamma : float
        Exponent of eq. 3.1, for the radii that the tolerances are measured in.
    max_nodes : int

    Returns
    -------
    Skeleton
        At most `max_nodes` nodes, or as near to it as `MAX_ROUNDS` rounds come.
    """
    reference = None
    for k in range(MAX_ROUNDS):
        radius, _ = final_radii(skeleton, gamma)
        skeleton = replace(skeleton, radius=radius)
        density = _points_per_metre(skeleton)
        if reference is None:
            reference = _weighted_median(density, skeleton.n_points)
        kept = _nodes_within_tolerance(skeleton, density / reference, k)
        if kept.size <= max_nodes:
            kept = _spend_the_rest(skeleton, density / reference, k, kept, max_nodes)
            break
        skeleton = drop_spurs(xyz, skeleton, FEW_OVER_BUDGET * RELAX_FEW**k, FAR_OVER_BUDGET)
        sparse = np.clip(np.sqrt(reference / np.maximum(_points_per_metre(skeleton), TINY)), *APART_RANGE)
        apart = np.where(skeleton.is_tube, 0.0, APART_OVER_BUDGET * RELAX_TOLERANCE**k * sparse)
        skeleton = coarsen(skeleton, np.where(skeleton.is_tube, skeleton.radius, np.nan), apart)
    else:
        return skeleton
    return keep_nodes(skeleton, kept)


def _spend_the_rest(
    skeleton: Skeleton, density: np.ndarray, k: int, kept: np.ndarray, max_nodes: int
) -> np.ndarray:
    """The tightest tolerance between those of rounds 0 and `k` that keeps to the budget."""
    low, high = 0.0, float(k)
    for _ in range(SPEND_STEPS if k else 0):
        middle = 0.5 * (low + high)
        more = _nodes_within_tolerance(skeleton, density, middle)
        if more.size <= max_nodes:
            kept, high = more, middle
        else:
            low = middle
    return kept


def _nodes_within_tolerance(skeleton: Skeleton, density: np.ndarray, k: float) -> np.ndarray:
    """Nodes that the simplification keeps in round `k`; `density` relative to the median."""
    from treegraph import TreeGraph, simplify_nodes

    radius = skeleton.radius
    tolerance = (
        TOLERANCE * RELAX_TOLERANCE**k * np.clip(1 / np.sqrt(np.maximum(density, TINY)), *DENSITY_RANGE)
    )
    tolerance = np.clip(tolerance, *TOLERANCE_RANGE)
    tight = np.maximum(TUBE_TOLERANCE * radius, TUBE_SPACINGS * skeleton.spacing) * RELAX_TUBE**k
    tolerance = np.where(skeleton.is_tube, np.minimum(tolerance, tight), tolerance)
    of_radius = np.maximum(RADIUS_TOLERANCE * radius, SMALLEST_RADIUS_TOLERANCE) * RELAX_RADIUS**k
    return simplify_nodes(TreeGraph(skeleton.parent, skeleton.position, radius), tolerance, of_radius)


def _points_per_metre(skeleton: Skeleton) -> np.ndarray:
    length = np.full(skeleton.n_nodes, np.inf)
    length[1:] = np.linalg.norm(skeleton.position[1:] - skeleton.position[skeleton.parent[1:]], axis=1)
    return skeleton.n_points / np.maximum(length, skeleton.slice_width)


def _weighted_median(value: np.ndarray, weight: np.ndarray) -> float:
    order = np.argsort(value, kind="stable")
    total = np.cumsum(weight[order])
    return max(float(value[order[np.searchsorted(total, total[-1] / 2)]]), TINY)
