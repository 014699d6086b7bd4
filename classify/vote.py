"""Trees whose species is in doubt follow their neighbours.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 (the spatial voting).
Departs from it in: nothing that it states; what it leaves open is fixed here. "In case the neighbor exemplars
provide more reliable classification, a set of possible species is created and the candidate species with the
highest probability is selected": the neighbours that count are the confident ones, and where there is none,
those whose h1 / h2 is larger than the tree's own; the candidates are the first species of each of them; and
the probability of a candidate is, as chosen, what the tree itself gives to it, or the sum of what these
neighbours give to it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph.errors import InputError

__all__ = ["Vote", "is_confident", "reliable_ratio", "vote_species"]

CONFIDENT = 1.5  # h1 > 1.5 h2 is a confident classification (thesis 3.5.1)
RELIABLE = 0.99  # share of the confident answers that are right, if the ratio is learnt
MOST_RATIO = 1000.0  # that is learnt
REACH = 25.0  # metres in which neighbours are asked (thesis 3.5.1)
MAX_PAIRS = 4_000_000  # pairs of trees in work at a time: about 40 bytes each
SCORES = ("own", "neighbours")


@dataclass(frozen=True, eq=False)
class Vote:
    """The species of many trees after the vote; n trees.

    Attributes
    ----------
    label : (n,) int32
        Column of the species, -1: none.
    changed : (n,) bool
        Whether that is another one than the tree's own most probable species.
    is_confident : (n,) bool
        Trees that were not put to the vote.
    n_voters : (n,) int32
        Neighbours that decided; 0 for confident trees and for those without reliable neighbours.
    """

    label: NDArray[np.int32]
    changed: NDArray[np.bool_]
    is_confident: NDArray[np.bool_]
    n_voters: NDArray[np.int32]

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    def __repr__(self) -> str:
        return (
            f"<Vote {self.label.size} trees, {int((~self.is_confident).sum())} in doubt, "
            f"{int(self.changed.sum())} changed>"
        )


def is_confident(probability: ArrayLike, ratio: float = CONFIDENT) -> NDArray[np.bool_]:
    """Whether the highest probability is more than `ratio` times the second highest: h1 > 1.5 h2.

    Parameters
    ----------
    probability : (n, c) array_like of float
        Probability of each species for each tree, >= 0. A row with a NaN says nothing.
    ratio : float, default 1.5
        >= 1.

    Returns
    -------
    (n,) bool ndarray
        False for rows with a NaN and rows of zeros. With one species every other row is confident.

    Examples
    --------
    >>> is_confident([[0.6, 0.4], [0.61, 0.39]]).tolist()
    [False, True]
    """
    return _reliability(*_checked(probability, ratio)[:2], ratio)[1]


def reliable_ratio(probability: ArrayLike, label: ArrayLike, share: float = RELIABLE) -> float:
    """The ratio h1 / h2 beyond which answers are right: for :func:`vote_species`, from scans held out.

    With calibrated probabilities most wrong answers have h1 > 1.5 h2, and are never put to the vote. This is
    the least ratio from 1.5 on for which a share of the confident answers is right.

    Parameters
    ----------
    probability : (n, c) array_like of float
        What a model said of scans that it had not been trained with (:attr:`Training.probability`).
    label : (n,) array_like of int
        The true columns.
    share : float, default 0.99
        Of the confident answers that are to be right, 0 to 1.

    Returns
    -------
    float
        From 1.5 to 1000; 1000 also if no ratio is enough.

    Raises
    ------
    InputError
        If a shape, a probability or a share is out of its range.

    Examples
    --------
    >>> reliable_ratio([[0.9, 0.1], [0.8, 0.2], [0.3, 0.7], [0.1, 0.9]], [0, 0, 0, 1])  # the third is wrong
    2.3333333333333335
    """
    weight, speaks = _checked(probability, CONFIDENT)
    true = np.asarray(label)
    if true.shape != (len(weight),) or true.dtype.kind not in "iu":
        raise InputError(f"label must be {len(weight)} whole numbers to match probability, got {true.shape}")
    if not 0.0 <= share <= 1.0:
        raise InputError(f"share must be from 0 to 1, got {share!r}")
    margin = _reliability(weight, speaks, CONFIDENT)[0]
    order = np.argsort(margin[speaks], kind="stable")
    margin = margin[speaks][order]
    right = (weight.argmax(axis=1) == true)[speaks][order]
    n_right = np.append(np.cumsum(right[::-1])[::-1], 0)  # of those from each row on
    tried = np.unique(np.append(np.clip(margin, CONFIDENT, MOST_RATIO), CONFIDENT))
    first = np.searchsorted(margin, tried, side="right")  # row of the first confident one
    n_sure = len(margin) - first
    enough = np.flatnonzero((n_sure > 0) & (n_right[first] / np.maximum(n_sure, 1) >= share))
    return float(tried[enough[0]]) if enough.size else MOST_RATIO


def vote_species(
    position: ArrayLike,
    probability: ArrayLike,
    *,
    reach: float = REACH,
    ratio: float = CONFIDENT,
    score: Literal["own", "neighbours"] = "own",
) -> Vote:
    """Give each tree in doubt the most probable of the species that stand around it.

    A tree is in doubt unless h1 > `ratio` h2 for its two highest probabilities. Its voters are the confident
    trees within `reach`; without any, the trees there whose h1 / h2 is larger than its own. The candidates
    are the most probable species of the voters; the candidate with the highest score is taken. Equal scores:
    more voters, then the lower column. Without voters it keeps its own most probable species (the lowest
    column among equals). All votes are counted at once on what the classifier said, so the order of trees
    means nothing.

    Parameters
    ----------
    position : (n, 2) or (n, 3) array_like of float
        Where the trees stand, metres; distances are horizontal, heights are not looked at. A tree with a
        coordinate that is not finite has no neighbours and is nobody's neighbour.
    probability : (n, c) array_like of float
        Probability of each of c > 0 species for each tree, >= 0; rows need not add up to 1. A row with a NaN,
        or of zeros, says nothing: the tree votes for nobody, and the most frequent candidate is taken for it.
    reach : float, default 25
        Neighbours are at most so far away, metres, >= 0. Trees in the same place are neighbours.
    ratio : float, default 1.5
        Of a confident classification, >= 1.
    score : {"own", "neighbours"}
        Probability of a candidate: what the tree itself gives to it, or the sum of what the voters give
        to it.

    Returns
    -------
    Vote

    Raises
    ------
    InputError
        If a shape, a probability or a number is out of its range.

    Notes
    -----
    O(n log n) time, plus O(c) for each tree in doubt and O(1) for each pair of such a tree and a neighbour.
    Memory is bounded but for an oversized neighbourhood, whose pairs are all held at once.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", 2013, section 3.5.1

    Examples
    --------
    >>> vote = vote_species([[0, 0], [9, 0], [90, 0]], [[0.9, 0.1], [0.45, 0.55], [0.45, 0.55]])
    >>> vote.label.tolist(), vote.changed.tolist(), vote.n_voters.tolist()
    ([0, 0, 1], [False, True, False], [0, 1, 0])
    """
    weight, speaks = _checked(probability, ratio)
    xy, placed = _places(position, len(weight))
    if not (np.isfinite(reach) and reach >= 0.0):
        raise InputError(f"reach must be a finite number of metres >= 0, got {reach!r}")
    if score not in SCORES:
        raise InputError(f"score must be one of {', '.join(SCORES)}, got {score!r}")
    margin, confident = _reliability(weight, speaks, ratio)
    own = np.where(speaks, weight.argmax(axis=1), -1).astype(np.int32)
    label, n_voters = own.copy(), np.zeros(len(own), np.int32)
    asking = np.flatnonzero(~confident & placed)
    for voters in (confident & placed, ~confident & placed & speaks):
        for tree, voter in _pairs(xy, asking, np.flatnonzero(voters), reach):
            better = confident[voter] | (margin[voter] > margin[tree])
            tree, voter = tree[better], voter[better]
            np.add.at(n_voters, tree, 1)
            who = np.unique(tree)
            label[who] = _candidates(who, tree, voter, own, weight, score)
        asking = asking[n_voters[asking] == 0]
    return Vote(label, label != own, confident, n_voters)


def _checked(probability: ArrayLike, ratio: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The probabilities, 0 in rows that say nothing, and which rows say something."""
    weight = np.array(probability, np.float64)
    if weight.ndim != 2 or weight.shape[1] == 0:
        raise InputError(f"probability must have shape (n, c) with c > 0, got {weight.shape}")
    known = ~np.isnan(weight).any(axis=1)
    weight[~known] = 0.0
    wrong = ~((weight >= 0.0) & (weight < np.inf))
    bad = np.flatnonzero(wrong.any(axis=1))
    if bad.size:
        raise InputError(
            f"probability must be >= 0 and finite, got {weight[bad[0]][wrong[bad[0]]][0]} in row {bad[0]} "
            f"({bad.size} such rows)"
        )
    if not (np.isfinite(ratio) and ratio >= 1.0):
        raise InputError(f"ratio must be a finite number >= 1, got {ratio!r}")
    return weight, weight.max(axis=1) > 0.0


def _places(position: ArrayLike, n: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Horizontal positions (n, 2), and which of them are known."""
    place = np.asarray(position, np.float64)
    if place.ndim != 2 or place.shape[0] != n or place.shape[1] not in (2, 3):
        raise InputError(
            f"position must have shape ({n}, 2) or ({n}, 3) to match probability, got {place.shape}"
        )
    return np.ascontiguousarray(place[:, :2]), np.asarray(np.isfinite(place).all(axis=1))


def _reliability(
    weight: NDArray[np.float64], speaks: NDArray[np.bool_], ratio: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """h1 / h2 of each row, -1 where it says nothing, and whether it is confident."""
    if weight.shape[1] == 1:
        return np.where(speaks, np.inf, -1.0), speaks.copy()
    second, first = np.partition(weight, -2, axis=1)[:, -2:].T
    margin = np.full(len(weight), -1.0)
    with np.errstate(divide="ignore"):
        np.divide(first, second, out=margin, where=speaks)
    return margin, speaks & (first > ratio * second)


def _pairs(
    xy: NDArray[np.float64], asking: NDArray[np.int64], voters: NDArray[np.int64], reach: float
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs of a tree that asks and a voter within reach, some trees at a time with all their pairs."""
    from scipy.spatial import cKDTree

    if asking.size == 0 or voters.size == 0:
        return
    asking = asking[cKDTree(xy[asking]).indices]  # near trees together
    among = cKDTree(xy[voters])
    count = among.query_ball_point(xy[asking], reach, return_length=True)
    part = np.cumsum(count) // MAX_PAIRS
    for some in np.split(asking, np.flatnonzero(np.diff(part)) + 1):
        found = cKDTree(xy[some]).sparse_distance_matrix(among, reach, output_type="ndarray")
        yield some[found["i"]], voters[found["j"]]


def _candidates(
    who: NDArray[np.int64],
    tree: NDArray[np.int64],
    voter: NDArray[np.int64],
    own: NDArray[np.int32],
    weight: NDArray[np.float64],
    score: str,
) -> NDArray[np.int64]:
    """The species that the voters of each tree in `who` decide on."""
    n_species = weight.shape[1]
    key = np.searchsorted(who, tree) * n_species + own[voter]
    votes = np.bincount(key, minlength=who.size * n_species).reshape(-1, n_species)
    value: NDArray[Any] = weight[who]
    if score == "neighbours":
        given = weight[voter, own[voter]]
        order = np.lexsort((given, key))  # added up in an order of their own, not in that of the trees
        value = np.bincount(key[order], given[order], who.size * n_species).reshape(-1, n_species)
    value = np.where(votes > 0, value, -1.0)
    best = value == value.max(axis=1, keepdims=True)
    return np.where(best, votes, 0).argmax(axis=1)
