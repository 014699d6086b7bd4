"""A first guess of growth parameters, read off the trees that are to be fitted.

What a tree shows is taken from it: angles, the distance of forks, buds per node, height, where the crown
begins. For the rest there are values in the middle of those of the paper's own trees (table 2). How far each
may be off goes along.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inverse.distance import Description
from inverse.space import AGE, SearchSpace

__all__ = ["guess_parameters", "first_point"]

#: Of what a tree does not show; near the middle of table 2.
TYPICAL = {
    "AAV": 9.0, "NLB": 2.0, "BAM": 45.0, "BAV": 9.0, "RAM": 95.0, "RAV": 9.0, "AB_D": 0.01, "LB_D": 0.15,
    "LF_A": 0.37, "LF_L": 0.8, "AD_BF": 2.0, "AD_DF": 0.5, "AD_AF": 0.9, "GR": 2.0, "IL_AF": 0.97, "AC": 1.2,
    "AC_AF": 0.92, "PT": 0.15, "GT": 0.15, "PF": 0.5, "GBS": 0.2, "GBA": 0.3, AGE: 14.0,
}  # fmt: skip
SURE, UNSURE = 0.08, 0.2  # standard deviations along the bounds, of what is read off and of what is not
READ_OFF = ("NLB", "BAM", "BAV", "IBL", "LB_PF")
INTERNODE_SHARE = 0.3  # quantile of the distances between forks that is taken for one internode
MOST_TURN = np.pi / 2  # joints beyond that are no branching angles


def guess_parameters(trees: Sequence[Description]) -> dict[str, float]:
    """Growth parameters and age by symbol, as far as possible from the trees themselves.

    Parameters
    ----------
    trees : sequence of Description
        At least one, with some length.

    Returns
    -------
    values : dict of float
        All 24 and ``"t"``; angles in degrees as in the growth model. Not held to any bounds.
    """
    guesses = [_guess(tree) for tree in trees]
    return {name: float(np.mean([guess[name] for guess in guesses])) for name in guesses[0]}


def first_point(
    space: SearchSpace, trees: Sequence[Description]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The guess as a point of a search space, and how far each coordinate may be off."""
    values = guess_parameters(trees)
    shares = [d.share(min(max(values[d.symbol], d.low), d.high)) for d in space.free]
    spread = [SURE if d.symbol in READ_OFF else UNSURE for d in space.free]
    return np.array(shares), np.array(spread)


def _guess(tree: Description) -> dict[str, float]:
    pieces = tree.pieces
    values = dict(TYPICAL)
    height = float(np.ptp(pieces.graph.position[:, 2]))
    inner = pieces.length[1 : pieces.n_forks]
    between = inner[inner > 0.0] if (inner > 0.0).any() else pieces.length[pieces.length > 0.0]
    values["IBL"] = float(np.quantile(between, INTERNODE_SHARE))
    children = np.bincount(pieces.parent[1:], minlength=1)
    forks = children[children > 1]
    if forks.size:
        values["NLB"] = float(max(np.median(forks) - 1.0, 1.0))
        side = _side_joints(pieces.parent, pieces.joint)
        values["BAM"] = float(np.degrees(np.median(side)))
        values["BAV"] = float(np.degrees(0.5 * (np.quantile(side, 0.75) - np.quantile(side, 0.25))) ** 2)
    first_fork = float(pieces.graph.position[pieces.last[0], 2] - pieces.graph.position[0, 2])
    values["LB_PF"] = max(first_fork, 0.0) * 0.9
    values[AGE] = float(np.clip(round(height / (TYPICAL["GR"] * values["IBL"]) * 1.3), 5, 25))
    return values


def _side_joints(parent: NDArray[np.int32], joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """The joints of all children but the straightest of each fork."""
    order = np.lexsort((joint, parent))
    first = np.concatenate([[True], np.diff(parent[order]) > 0])
    side = joint[order][~first]
    usable = side[side <= MOST_TURN]
    return usable if usable.size else side
