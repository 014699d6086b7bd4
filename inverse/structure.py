"""How far apart the branching of two trees is: the cost of turning one into the other.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014,
section 5.3 (Eq. 5 to 7) and appendix B (Eq. 12); K. Zhang, "A constrained edit distance between unordered
labeled trees", Algorithmica 15, 1996.

Departs from it in, or reads it as:

- the last two terms of d_N carry a flipped sign in print. Meant is the least of: assigning t1 to t2, with
  their children matched; joining t2 with its i-th child, whose siblings are inserted with all they carry; the
  same in t1;
- a joined piece is a run of pieces from one to one above it. Runs on both sides are part of the state, so
  that any run can be mapped onto any run, as the repeated application of split and merge promises;
- split and merge take the place of insertion and deletion of pieces that carry others: what is not on a run
  that is mapped, is inserted or deleted with all it carries. Children are matched, as few or as many as pay;
- the bend of a joined piece includes the angles at its joints; angles and straightness are told apart to a
  resolution, see :mod:`inverse.comparing`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inverse.pieces import Pieces, cut_into_pieces
from treegraph import ClusterTree, InputError, TreeGraph

if TYPE_CHECKING:
    from inverse._edit_kernels import EditTree

__all__ = ["MOST_PAIRS", "Mapping", "map_pieces", "structural_distance"]

MOST_PAIRS = 100_000_000
"""Most pairs of a piece of one tree and one of another that are compared: 10 000 pieces each, or 0.8 GB."""

MOST_RUNS = 20_000_000
"""Most runs of a tree; those of a chain of 6000 pieces."""

ROUNDING = 1e-9
"""How much a lower bound is lowered, as a share of it, lest rounding lifts it above what it bounds."""


@dataclass(frozen=True, eq=False)
class Mapping:
    """Which pieces of tree a become which pieces of tree b, at the least cost.

    Attributes
    ----------
    a, b : Pieces
    foot_a, head_a, foot_b, head_b : (k,) int32
        Pair i maps the run of pieces from `foot_a` to `head_a` onto that from `foot_b` to `head_b`. The first
        pair has the two trunks' feet.
    cost : (k,) float64
        Of assigning one run to the other, square metres.
    pair_of_a : (m,) int32
        The pair to which each piece of a belongs; -1: it has no counterpart and is deleted.
    pair_of_b : (m,) int32
        The same of b, whose pieces are inserted.
    removal_a, removal_b : float
        Cost of deleting all of a and of inserting all of b, square metres.
    """

    a: Pieces
    b: Pieces
    foot_a: NDArray[np.int32]
    head_a: NDArray[np.int32]
    foot_b: NDArray[np.int32]
    head_b: NDArray[np.int32]
    cost: NDArray[np.float64]
    pair_of_a: NDArray[np.int32]
    pair_of_b: NDArray[np.int32]
    removal_a: float
    removal_b: float

    @property
    def n_pairs(self) -> int:
        """Number of pairs, at least 1."""
        return int(self.cost.size)

    @property
    def total_cost(self) -> float:
        """Cost of the whole: of the pairs, and of all pieces without a counterpart; square metres."""
        lost_a, lost_b = self.pair_of_a < 0, self.pair_of_b < 0
        rest = (self.a.length * self.a.thickness)[lost_a].sum() + (self.b.length * self.b.thickness)[
            lost_b
        ].sum()
        return float(self.cost.sum() + rest)

    @property
    def matched_a(self) -> float:
        """Share of a's length that has a counterpart, 0 to 1; 0 without length."""
        return _share(self.a.length, self.pair_of_a >= 0)

    @property
    def matched_b(self) -> float:
        """Share of b's length that has a counterpart, 0 to 1; 0 without length."""
        return _share(self.b.length, self.pair_of_b >= 0)

    def __repr__(self) -> str:
        return f"<Mapping {self.n_pairs} pairs, {self.matched_a:.0%} of a, {self.matched_b:.0%} of b>"


def structural_distance(
    a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces, *, joins: bool = True
) -> float:
    r"""Structural distance d_T of two trees, Eq. 7 of [1]_.

    :math:`d_N / (2 \max(d_N(a, \epsilon), d_N(\epsilon, b)))`, where :math:`d_N` is the least cost of turning
    a into b. Deleting or inserting a piece costs its length times its thickness; assigning one piece to
    another, Eq. 12, costs more the more they differ in length, slope, straightness and bend.

    Parameters
    ----------
    a, b : TreeGraph, ClusterTree or Pieces
        One root each, all radii known.
    joins : bool, default True
        Whether a piece can be joined with those above it (split and merge). Without that the distance depends
        on where trees are cut.

    Returns
    -------
    distance : float
        0 (alike) to 1; 0 if neither has any length or thickness. Symmetric. It does not change if a tree is
        turned about the vertical, moved, or its children are reordered.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`, or if there are more than 10^8 pairs of pieces, or 2 10^7 runs in
        a tree.

    Notes
    -----
    Time about in proportion to the number of pairs of pieces; docs/similarity.md has the figures.

    References
    ----------
    .. [1] O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014.

    Examples
    --------
    >>> pole = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])
    >>> longer = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 5]], [0.1, 0.1])
    >>> structural_distance(pole, pole), round(structural_distance(pole, longer), 3)
    (0.0, 0.1)
    """
    one, two = edit_tree(cut_into_pieces(a)), edit_tree(cut_into_pieces(b))
    return distance_of(one, two, joins=joins)


def map_pieces(
    a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces, *, joins: bool = True
) -> Mapping:
    """Which pieces of a become which of b in a cheapest way of turning a into b.

    Parameters
    ----------
    a, b, joins
        As of :func:`structural_distance`.

    Returns
    -------
    mapping : Mapping
        One of the cheapest, if there are several.

    Raises
    ------
    InputError
        As :func:`structural_distance`.

    Examples
    --------
    >>> pole = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])
    >>> map_pieces(pole, pole)
    <Mapping 1 pairs, 100% of a, 100% of b>
    """
    pieces_a, pieces_b = cut_into_pieces(a), cut_into_pieces(b)
    return mapping_of(pieces_a, edit_tree(pieces_a), pieces_b, edit_tree(pieces_b), joins=joins)[1]


def edit_tree(pieces: Pieces) -> EditTree:
    """The arrays from which the distance is computed."""
    from inverse import _edit_kernels as kernels

    n_runs = kernels.count_runs(pieces.parent)
    if n_runs > MOST_RUNS:
        raise InputError(
            f"a tree to compare must have at most {MOST_RUNS} runs of pieces, got {n_runs} in "
            f"{pieces.n_pieces} pieces; prune or simplify it"
        )
    return kernels.make_tree(
        pieces.n_forks, pieces.parent, pieces.length, pieces.thickness, pieces.bend, pieces.joint,
        pieces.start, pieces.end,
    )  # fmt: skip


def distance_of(one: EditTree, two: EditTree, *, joins: bool = True) -> float:
    """As :func:`structural_distance`, of arrays that are there already."""
    return _normalised(one, two, _fill(one, two, joins)[0])


def bounds_of(one: EditTree, two: EditTree) -> tuple[float, float]:
    """Bounds of the structural distance, in time of the sum of the pieces rather than of the pairs.

    At least the surplus of the longer tree's length has to be paid, at its thinnest; at most both trees are
    removed.
    """
    from inverse import _edit_kernels as kernels

    removal = float(one.whole[0]), float(two.whole[0])
    larger = max(removal)
    if not larger > 0.0:
        return 0.0, 0.0
    surplus = float(one.length.sum() - two.length.sum())
    longer = one if surplus > 0.0 else two
    order = np.argsort(longer.thickness, kind="stable")
    least = kernels.cost_of_thinnest(longer.length[order], longer.thickness[order], abs(surplus))
    return least / (2.0 * larger) * (1.0 - ROUNDING), min(sum(removal) / (2.0 * larger), 1.0)


def mapping_of(
    pieces_a: Pieces, one: EditTree, pieces_b: Pieces, two: EditTree, *, joins: bool = True
) -> tuple[float, Mapping]:
    """As :func:`structural_distance` and :func:`map_pieces`, of arrays that are there already."""
    from inverse import _edit_kernels as kernels

    saved, matched, best_row, best_block = _fill(one, two, joins)
    room = kernels.make_room(_most_children(one, two))
    runs = np.empty((min(one.cost.size, two.cost.size), 4), np.int32)
    cost = np.empty(len(runs))
    n = kernels.trace(one, two, joins, saved, matched, best_row, best_block, room, runs, cost)
    foot_a, head_a, foot_b, head_b = np.ascontiguousarray(runs[:n].T)
    mapping = Mapping(
        pieces_a, pieces_b, foot_a, head_a, foot_b, head_b, cost[:n], _label(pieces_a, foot_a, head_a),
        _label(pieces_b, foot_b, head_b), float(one.whole[0]), float(two.whole[0]),
    )  # fmt: skip
    return _normalised(one, two, saved), mapping


def _fill(
    one: EditTree, two: EditTree, joins: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    from inverse import _edit_kernels as kernels

    m1, m2 = one.cost.size, two.cost.size
    if m1 * m2 > MOST_PAIRS:
        raise InputError(
            f"two trees to compare must have at most {MOST_PAIRS} pairs of pieces, got {m1} x {m2}; "
            "prune one or both"
        )
    forks = len(one.above), len(two.above)
    saved, matched, best_row, best_block = (
        np.empty((m1, m2)),
        np.empty(forks),
        np.empty(forks),
        np.empty(forks),
    )
    room = kernels.make_room(_most_children(one, two))
    kernels.fill_savings(one, two, joins, saved, matched, best_row, best_block, room)
    return saved, matched, best_row, best_block


def _most_children(one: EditTree, two: EditTree) -> int:
    return max(int(np.diff(tree.child_start).max()) for tree in (one, two))


def _normalised(one: EditTree, two: EditTree, saved: NDArray[np.float64]) -> float:
    removal_a, removal_b = float(one.whole[0]), float(two.whole[0])
    larger = max(removal_a, removal_b)
    if not larger > 0.0:
        return 0.0
    cost = removal_a + removal_b - float(saved[0, 0])
    return min(max(cost / (2.0 * larger), 0.0), 1.0)


def _label(pieces: Pieces, foot: NDArray[np.int32], head: NDArray[np.int32]) -> NDArray[np.int32]:
    """The pair of each piece, -1 if it has none."""
    from inverse import _edit_kernels as kernels

    out = np.full(pieces.n_pieces, -1, np.int32)
    kernels.label_runs(pieces.parent, foot, head, out)
    return out


def _share(length: NDArray[np.float64], chosen: NDArray[np.bool_]) -> float:
    whole = float(length.sum())
    return float(length[chosen].sum()) / whole if whole > 0.0 else 0.0
