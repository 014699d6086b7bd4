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
