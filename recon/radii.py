"""Radii of a skeleton: measured where points support them, inferred elsewhere.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, eq. 3.1.

Departs from it in: the trunk and the branches that have circles across their axis keep the
measured radius; eq. 3.1 starts anew from the last measured node on the way to the root, instead of
from the foot of the trunk for all of the tree.
"""

from __future__ import annotations

import numpy as np

from recon.skeleton import Skeleton

PIPE_EXPONENT = 0.5  # area of wood in proportion to the length it carries: the thickest believable
RESOLUTION_SPACINGS = 1.0  # a spread below this many point spacings may always be a twig's ...
MAX_RESOLUTION = 0.03  # ... but not above this, metres
SMALLEST_RADIUS = 0.002  # metres; of twigs
ENOUGH_POINTS = 2  # a node with fewer shows no radius
CARRIED_MARGIN = 1.8  # how much thicker than its share of the crown a branch with leaves may be
STEM_HEIGHT = 1.0  # metres above the foot where the stem is taken that the shares refer to


def carried_points(skeleton: Skeleton) -> np.ndarray:
    """Points that hang on each node and on all beyond it, (n,) int64."""
    home = skeleton.home[skeleton.home >= 0]
    carried = np.bincount(home, minlength=skeleton.n_nodes)
    for i in range(skeleton.n_nodes - 1, 0, -1):
        carried[skeleton.parent[i]] += carried[i]
    return carried


def limit_by_load(skeleton: Skeleton, radius: np.ndarray, *, margin: float = CARRIED_MARGIN) -> np.ndarray:
    r"""Radii of a tree with leaves, none thicker than what it carries asks for.

    Around a bough its leaves look like thick bark to a circle fit. By the pipe model (thesis 5.3.4) the area
    of wood goes with the leaves beyond it, so
    :math:`r(u) \le m \, r_0 \sqrt{\max(p(u) / p, l(u) / l)}` with the points :math:`p` and the length
    :math:`l` of wood beyond u, the same of the whole tree, the radius :math:`r_0` of the stem one metre
    above its foot, and a margin m, for points are not spread evenly.

    Parameters
    ----------
    skeleton : Skeleton
    radius : (n,) float64
        Metres.
    margin : float

    Returns
    -------
    radius : (n,) float64
        Metres; unchanged on the stem below one metre.
    """
    from recon import _tube_kernels as tubes

    length = tubes.subtree_length(skeleton.parent, skeleton.position)
    onward = tubes.continuations(skeleton.parent, length)
    carried = carried_points(skeleton)
    stem = 0
    foot = skeleton.position[0, 2]
    while onward[stem] >= 0 and skeleton.position[stem, 2] < foot + STEM_HEIGHT:
        stem = int(onward[stem])
    share = np.maximum(carried / max(carried[0], 1), length / max(length[0], 1e-9))
    limit = np.maximum(margin * radius[stem] * share**PIPE_EXPONENT, SMALLEST_RADIUS)
    below = np.zeros(skeleton.n_nodes, bool)
    while stem >= 0:
        below[stem] = True
        stem = int(skeleton.parent[stem])
    return np.where(below, radius, np.minimum(radius, limit))


def final_radii(skeleton: Skeleton, gamma: float, *, leafy: bool = False) -> tuple[np.ndarray, np.ndarray]:
    r"""Radius of every node, never growing towards the tips.

    On stretches with believed circles: the fitted tube. Beyond them
    :math:`r(u) = r_m (l(u) / l(m))^\gamma`, eq. 3.1 of [1]_ with the last measured node m in the
    place of the root (the edge below u counts as part of l(u), or tips had no radius), unless the node's
    own points lie nearer around its axis than :math:`r_m (l(u)/l(m))^{1/2}` or than the scan resolves:
    then their mean distance, times :math:`\sqrt{k/(k-1)}` for an axis fitted to the same k points.

    Parameters
    ----------
    skeleton : Skeleton
        With fitted tubes.
    gamma : float
        Exponent of eq. 3.1.
    leafy : bool
        Whether points may be leaves: then a small spread says nothing of wood.

    Returns
    -------
    radius : (n,) float64
        Metres.
    measured : (n,) bool
        True where a circle across the axis stands behind the radius.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis,
       University of Konstanz, 2013.
    """
    from recon import _tube_kernels as tubes

    length = tubes.subtree_length(skeleton.parent, skeleton.position)
    onward = tubes.continuations(skeleton.parent, length)
    head, _ = tubes.chain_heads(skeleton.parent, onward)
    return tubes.final_radii(
        head,
        skeleton.parent,
        onward,
        skeleton.radius,
        skeleton.n_points,
        skeleton.is_tube,
        length,
        gamma,
        PIPE_EXPONENT,
        0.0 if leafy else min(RESOLUTION_SPACINGS * skeleton.spacing, MAX_RESOLUTION),
        SMALLEST_RADIUS,
        ENOUGH_POINTS,
    )
