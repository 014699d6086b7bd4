r"""When each branch of a tree grew: internode length, growth rates, ages.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.3.1 (Eq. 4.1, 4.2).
Departs from it in: Eq. 4.2 is printed with a product, l_s / l_i times nu_s. The rate is in internodes per
year, and the text wants all branches to reach their tips at the same time; so time is length over rate (on
grown trees the quotient follows the true years of growth, the product does not: docs/plastic.md). Where the
years are more, or fewer, than a number of seasons allows, a season holds more than one of them, or less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treegraph import InputError, TreeGraph

__all__ = ["Seasons", "branch_ages", "branching_distances", "growth_rates", "internode_length", "seasons_of"]

RATE_SHARE = 0.2
"""Rates of segments that lead less far than this share of d_r are those of their parents (thesis 4.3.1)."""

MOST_DISTANCES = 512  # order statistics that stand for all distances between branching nodes
STARTS = 64  # of them, from which mean shift begins
MOST_SHIFTS = 500
SHIFT_END = 1e-6  # a shift by less than this share of the bandwidth ends the search
SAME_PEAK = 1e-3  # share by which a peak may be lower and counts as equally high
LEAST_BANDWIDTH = 0.05  # of the median distance, where most distances are equal
LONE_INTERNODES = 20  # of a tree whose branchings give no distance, along its longest way
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Seasons:
    """When the segments of a tree of n nodes grew.

    Attributes
    ----------
    internode : float
        Length of an internode l_i, metres, > 0.
    rate : (n,) float64
        Absolute growth rate nu_s, internodes per year, >= 1 at the slowest; of the segment that ends at the
        node. 1 at a root.
    age : (n,) float64
        t_s of Eq. 4.2, years after the seed, at the end of the segment; 0 at a root.
    years : float
        The largest age.
    birth : (n,) int32
        Season in which the segment was made, 0 to ``count - 1``; never less than its parent's.
    count : int
        Number of seasons, at least 1.
    season : float
        How many years a season holds.
    """

    internode: float
    rate: NDArray[np.float64]
    age: NDArray[np.float64]
    years: float
    birth: NDArray[np.int32]
    count: int
    season: float


def branching_distances(tree: TreeGraph) -> NDArray[np.float64]:
    """Way from each branching node to the nearest branching node, or the root, below it.

    Parameters
    ----------
    tree : TreeGraph
        ``parent`` and ``position`` (metres) are read.

    Returns
    -------
    distance : (m,) float64 ndarray
        Metres, > 0, one for each branching node but the roots, in the order of the nodes.

    Examples
    --------
    >>> z = [[0, 0, 0], [0, 0, 1], [0, 0, 3], [0, 1, 3], [0, -1, 3]]
    >>> branching_distances(TreeGraph([-1, 0, 1, 2, 2], z, [0.1] * 5)).tolist()
    [3.0]
    """
    from plastic import _analysis_kernels as kernels

    way, branching = kernels.way_to_branching(tree.parent, tree.position)
    distance = way[branching & (tree.parent >= 0)]
    return distance[distance > 0.0]


def internode_length(tree: TreeGraph) -> float:
    """Length of an internode: the highest peak of the distances between branching nodes (thesis 4.3.1).

    The peak is found by mean shift with a Gaussian kernel whose bandwidth is Silverman's,
    0.9 min(sigma, IQR / 1.34) m^(-1/5), and no less than 5% of the median distance. Of peaks that are equally
    high, the shortest.

    Parameters
    ----------
    tree : TreeGraph
        ``parent`` and ``position`` (metres) are read.

    Returns
    -------
    length : float
        Metres, > 0. Scales with the tree, does not change when it is turned. Without branchings it is a
        twentieth of the way from the root to the farthest tip; 1 if that is 0 too.

    Notes
    -----
    O(n), and O(64 * 512) per shift: of more than 512 distances as many of their quantiles are taken.

    Examples
    --------
    >>> z = [[0, 0, k] for k in range(4)] + [[0, 1, 1], [0, 1, 2], [0, 1, 3]]
    >>> internode_length(TreeGraph([-1, 0, 1, 2, 1, 2, 2], z, [0.1] * 7))
    1.0
    """
    distance = np.sort(branching_distances(tree))
    if not distance.size:
        from treegraph import path_length

        return float(path_length(tree).max()) / LONE_INTERNODES or 1.0
    sample = _thin(distance, MOST_DISTANCES)
    median = float(np.median(sample))
    spread = min(float(sample.std()), float(np.subtract(*np.percentile(sample, [75, 25]))) / 1.34)
    bandwidth = max(0.9 * spread * len(distance) ** -0.2, LEAST_BANDWIDTH * median)
    at = _thin(sample, STARTS)
    for _ in range(MOST_SHIFTS):
        weight = np.exp(-0.5 * ((at[:, None] - sample) / bandwidth) ** 2)
        to = (weight @ sample) / weight.sum(axis=1)
        done = np.abs(to - at).max() < SHIFT_END * bandwidth
        at = to
        if done:
            break
    density = np.exp(-0.5 * ((at[:, None] - sample) / bandwidth) ** 2).sum(axis=1)
    return float(at[density >= (1.0 - SAME_PEAK) * density.max()].min())


def _thin(ascending: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """At most so many of the values, evenly spaced in their order, both ends among them."""
    if len(ascending) <= most:
        return ascending
    return ascending[np.rint(np.linspace(0, len(ascending) - 1, most)).astype(np.int64)]


def growth_rates(tree: TreeGraph) -> NDArray[np.float64]:
    r"""Relative growth rate of each segment, Eq. 4.1.

    :math:`\hat\nu_s = d_{s,l} / (d_r - d_{s,r})`, with distances along the branches from the foot of the
    segment: to its farthest tip, from its root, and from that root to its farthest tip. Segments from whose
    foot no way is longer than 0.2 d_r have the rate of their parents.

    Parameters
    ----------
    tree : TreeGraph
        ``parent`` and ``position`` (metres) are read.

    Returns
    -------
    rate : (n,) float64 ndarray
        0.2 to 1; 1 along the longest way, and at a root.

    Examples
    --------
    >>> z = [[0, 0, 0], [0, 0, 1], [0, 0, 4], [0, 1.5, 1]]
    >>> growth_rates(TreeGraph([-1, 0, 1, 1], z, [0.1] * 4)).tolist()
    [1.0, 1.0, 1.0, 0.5]
    """
    from plastic import _analysis_kernels as kernels

    return kernels.relative_rates(tree.parent, tree.position, RATE_SHARE)


def branch_ages(
    tree: TreeGraph, internode: float, rate: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Absolute growth rates, and the ages at which segments were complete.

    :math:`\nu_s = \hat\nu_s / \hat\nu_{min}` and :math:`t_s = (l_s / l_i) / \nu_s + t_{s_p}`: Eq. 4.2 with a
    quotient (see the head of this module).

    Parameters
    ----------
    tree : TreeGraph
    internode : float
        l_i, metres, > 0.
    rate : (n,) float64 ndarray
        From :func:`growth_rates`.

    Returns
    -------
    rate : (n,) float64 ndarray
        Internodes per year, >= 1.
    age : (n,) float64 ndarray
        Years; 0 at a root, never smaller than at the parent.

    Examples
    --------
    >>> z = [[0, 0, 0], [0, 0, 1], [0, 0, 4], [0, 1.5, 1]]
    >>> tree = TreeGraph([-1, 0, 1, 1], z, [0.1] * 4)
    >>> branch_ages(tree, 0.5, growth_rates(tree))[1].tolist()
    [0.0, 1.0, 4.0, 4.0]
    """
    from plastic import _analysis_kernels as kernels

    segments = rate[tree.parent >= 0]
    absolute = rate / (segments.min() if segments.size else 1.0)
    return absolute, kernels.sum_ages(tree.parent, tree.position, float(internode), absolute)


def seasons_of(tree: TreeGraph, *, internode: float | None = None, fewest: int, most: int) -> Seasons:
    """When each segment of a tree grew.

    Parameters
    ----------
    tree : TreeGraph
    internode : float, optional
        l_i, metres, > 0; by default from :func:`internode_length`.
    fewest, most : int
        Number of seasons, 1 <= fewest <= most.

    Returns
    -------
    seasons : Seasons

    Raises
    ------
    InputError
        If a number is out of its range.
    """
    if internode is not None and not 0.0 < internode < math.inf:
        raise InputError(f"internode must be a positive finite number of metres, got {internode!r}")
    if not 1 <= fewest <= most:
        raise InputError(f"seasons must be from 1 up, the fewest first, got {fewest} to {most}")
    length = internode_length(tree) if internode is None else float(internode)
    rate, age = branch_ages(tree, length, growth_rates(tree))
    years = float(age.max())
    yearly = math.floor(years + ROUNDING) + 1  # "clamped to the nearest lower integer"
    count = int(np.clip(yearly, fewest, most))
    season = 1.0 if count == yearly or years == 0.0 else years / count
    birth = np.minimum(np.floor(age / season + ROUNDING), count - 1).astype(np.int32)
    return Seasons(length, rate, age, years, birth, count, season)
