"""A first guess of growth parameters, read off the trees that are to be fitted.

What a tree shows is taken from it: angles, the distance of forks, buds per node, height, where the crown
begins. For the rest there are values in the middle of those of the paper's own trees (table 2). How far each
may be off goes along.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inverse.distance import Description
from inverse.pieces import Pieces
from inverse.space import AGE, TIP, TIP_SHARES, SearchSpace

if TYPE_CHECKING:
    from inverse.trials import Judge

__all__ = ["DRAWN", "first_point", "guess_parameters", "guess_tip_share", "survey_points", "thickened"]

#: Of what a tree does not show; near the middle of table 2.
TYPICAL = {
    "AAV": 9.0, "NLB": 2.0, "BAM": 45.0, "BAV": 9.0, "RAM": 95.0, "RAV": 9.0, "AB_D": 0.01, "LB_D": 0.15,
    "LF_A": 0.37, "LF_L": 0.8, "AD_BF": 2.0, "AD_DF": 0.5, "AD_AF": 0.9, "GR": 2.0, "IL_AF": 0.97, "AC": 1.2,
    "AC_AF": 0.92, "PT": 0.15, "GT": 0.15, "PF": 0.5, "GBS": 0.2, "GBA": 0.3, AGE: 14.0,
}  # fmt: skip
SURE, UNSURE = 0.08, 0.2  # standard deviations along the bounds, of what is read off and of what is not
#: Of the radius of a tip. It is set by the thickness of the tree rather than searched: to trees of much
#: thicker or thinner wood the structural distance is never above a half, however unlike they are.
SURE_OF_TIP = 0.005
READ_OFF = ("BAM", "BAV", "IBL", "LB_PF")
#: Of which trees tell least by themselves, as they work together: a survey draws them evenly.
OPEN = ("NLB", "BAM", "LF_A", "LF_L", "AD_BF", "AD_DF", "GR", "AC", "AC_AF", "PT", "GT", "PF", AGE)
DRAWN = 4  # points drawn for each that is compared
NEAR = 4  # every so many points of a survey is near the guess
SURVEY_WIDE = 1.0  # of the guess's standard deviations, for the others
INTERNODE_SHARE = 0.3  # quantile of the distances between forks that is taken for one internode
OWN_SHARE, ITS_REACH = 0.01, 4.0  # the growth model's tip_share, and the factor within which it is kept
PIPE = 2.49  # exponent of the growth model
WOOD_TREES = 6  # by which the radius of a tip is set
TWIG_SHARE = 0.02  # of the tips: a branch with fewer does not say where the crown begins
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
    values[TIP] = guess_tip_share(trees) * values["IBL"]
    shares = [d.share(min(max(values[d.symbol], d.low), d.high)) for d in space.free]
    sure = {name: SURE for name in READ_OFF} | {TIP: SURE_OF_TIP}
    spread = [sure.get(d.symbol, UNSURE) for d in space.free]
    return np.array(shares), np.array(spread)


def guess_tip_share(trees: Sequence[Description]) -> float:
    """How thick the trees' wood is: radius of a tip as a share of the internode length, 0.0005 to 0.2.

    By the pipe model, from the thickest branch and the number of internodes. What the growth model takes by
    itself, 0.01, is kept if this is within a factor of 4 of it. Scanned trees are thicker: a few internodes
    stand for all the twigs that a scan does not show.
    """
    shares = []
    for tree in trees:
        internode = _guess(tree)["IBL"]
        count = max(float(tree.pieces.length.sum()) / internode, 1.0)
        shares.append(0.5 * float(tree.pieces.thickness.max()) / (internode * count ** (1.0 / PIPE)))
    share = float(np.mean(shares))
    if OWN_SHARE / ITS_REACH <= share <= OWN_SHARE * ITS_REACH:
        return OWN_SHARE
    return float(np.clip(share, *TIP_SHARES))


def survey_points(
    judge: Judge,
    guess: NDArray[np.float64],
    spread: NDArray[np.float64],
    n: int,
    rng: np.random.Generator,
) -> list[NDArray[np.float64]]:
    """Points to look at first, whose trees have the targets' height and about as many branches.

    Four times as many are drawn, and a tree grown at each: most are bare poles or outgrow all bounds.
    Those stay whose number of branches is most like that of the targets; and their internode length is
    changed in proportion to the height: all other lengths of a tree follow it, nearly. So is the radius of a
    tip, if it is searched, to the wood.
    """
    free = judge.space.free
    is_open = np.array([d.symbol in OPEN for d in free])
    points = []
    for k in range(DRAWN * n):
        near = guess + SURVEY_WIDE * spread * rng.standard_normal(guess.size)
        near = 1.0 - np.abs(1.0 - near % 2.0)
        anywhere = rng.random(guess.size)
        points.append(near if k % NEAR == 0 else np.where(is_open, anywhere, near))
    wanted = [np.log(target.pieces.n_pieces) for target in judge.targets]
    sizes = judge.sizes(points, (1 << 32,))
    off = [abs(np.log(size.pieces) - np.mean(wanted)) if size.pieces else np.inf for size in sizes]
    kept = np.sort(np.argsort(off, kind="stable")[:n])
    aims: dict[str, tuple[str, float]] = {
        "IBL": ("height", float(np.mean([_height(t.pieces.graph.position) for t in judge.targets]))),
        TIP: ("wood", _wood(judge)),
    }
    for i, d in enumerate(free):
        for k in kept if d.symbol in aims else ():
            name, aim = aims[d.symbol]
            found = getattr(sizes[k], name)
            if found > 0.0 and aim > 0.0:
                value = d.value(points[k][i]) * aim / found
                points[k][i] = d.share(min(max(value, d.low), d.high))
    return [points[k] for k in kept]


def thickened(judge: Judge, point: NDArray[np.float64], key: tuple[int, ...]) -> NDArray[np.float64]:
    """The point with a radius of the tip by which its trees have as much wood as the targets; a new one.

    Without a radius that is searched, the point itself. Wood is length times thickness, of which the
    structural distance is made.
    """
    free = judge.space.free
    index = next((i for i, d in enumerate(free) if d.symbol == TIP), None)
    if index is None:
        return point
    wood = [judge.sizes([point], (*key, k))[0].wood for k in range(WOOD_TREES)]
    if not sum(wood) > 0.0:
        return point
    point, d = point.copy(), free[index]
    value = d.value(point[index]) * _wood(judge) / float(np.mean([w for w in wood if w > 0.0]))
    point[index] = d.share(min(max(value, d.low), d.high))
    return point


def _wood(judge: Judge) -> float:
    """Length times thickness of the targets' pieces, m2, their mean."""
    return float(np.mean([target.pieces.length @ target.pieces.thickness for target in judge.targets]))


def _height(position: NDArray[np.float64]) -> float:
    """Highest node above the foot, metres."""
    return float(position[:, 2].max() - position[0, 2])


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
    values["LB_PF"] = 0.9 * _crown_base(pieces)
    values[AGE] = float(np.clip(round(height / (TYPICAL["GR"] * values["IBL"]) * 1.3), 5, 25))
    return values


def _crown_base(pieces: Pieces) -> float:
    """Height of the lowest fork whose lesser branches are more than a stray twig, metres above the foot."""
    tips = np.where(np.arange(pieces.n_pieces) >= pieces.n_forks, 1, 0)
    for i in range(pieces.n_pieces - 1, 0, -1):
        tips[pieces.parent[i]] += tips[i]
    order = np.lexsort((-tips, pieces.parent))[1:]  # the root, whose parent is -1, is the first
    lesser = order[1:][pieces.parent[order[1:]] == pieces.parent[order[:-1]]]
    lesser = lesser[tips[lesser] >= TWIG_SHARE * tips[0]]
    if not lesser.size:
        return 0.0
    return max(float(pieces.start[lesser, 2].min() - pieces.graph.position[0, 2]), 0.0)


def _side_joints(parent: NDArray[np.int32], joint: NDArray[np.float64]) -> NDArray[np.float64]:
    """The joints of all children but the straightest of each fork."""
    order = np.lexsort((joint, parent))
    first = np.concatenate([[True], np.diff(parent[order]) > 0])
    side = joint[order][~first]
    usable = side[side <= MOST_TURN]
    return usable if usable.size else side
