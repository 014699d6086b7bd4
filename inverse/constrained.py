"""The edit distance between plants of Ferraro and Godin: what it costs to change, insert and delete nodes.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 4.5 (Eq. 4.17 to 4.26), after P. Ferraro and C. Godin, "A distance measure between
plant architectures", Annals of Forest Science 57, 2000; K. Zhang, "A constrained edit distance between
unordered labeled trees", Algorithmica 15, 1996.

Departs from it in: nothing. Eq. 4.23 and 4.24 write the mean once as n_i and once as m_i; it is that of both
trees' nodes together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inverse.pieces import Pieces, cut_into_pieces
from inverse.structure import MOST_PAIRS
from treegraph import ClusterTree, InputError, TreeGraph

__all__ = ["constrained_edit_distance", "constrained_tree_distance", "standardised_costs"]

SAME = 1e-9
"""Deviation of an attribute, as a share of its mean, up to which it is taken as the same everywhere."""


def constrained_edit_distance(
    a: TreeGraph | ClusterTree | Pieces, b: TreeGraph | ClusterTree | Pieces
) -> float:
    r"""Constrained edit distance of two trees, Eq. 4.22 of [1]_, by length and thickness.

    Nodes are the pieces between forks. Their length and thickness are standardised over both trees, :math:`f
    = (a - m) / s` (Eq. 4.23, 4.24). Changing one node into another costs :math:`\sum |f_1 - f_2|` (Eq. 4.25),
    deleting or inserting one :math:`\sum |f|` (Eq. 4.26). A mapping keeps who is above whom and which
    branching systems are apart (Eq. 4.19 to 4.21).

    Parameters
    ----------
    a, b : TreeGraph, ClusterTree or Pieces
        One root each, all radii known. With ``cut_into_pieces(tree, every_segment=True)`` nodes are segments.

    Returns
    -------
    distance : float
        >= 0, no unit; it grows with the number of nodes. Symmetric; 0 for the same tree. Where the root is a
        fork, the piece without length that stands for it costs nothing.

    Raises
    ------
    InputError
        As :func:`inverse.cut_into_pieces`, or if there are more than 10^8 pairs of nodes.

    Notes
    -----
    O(m n) for trees of m and n nodes with few children each. As the mean is taken away, what is like the
    average costs next to nothing to delete: so the papers have it.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
       Konstanz, 2013, section 4.5.

    Examples
    --------
    >>> up = [[0, 0, 0], [0, 0, 2], [1, 0, 3], [-1, 0, 4]]
    >>> tree = TreeGraph([-1, 0, 1, 1], up, [0.2, 0.2, 0.1, 0.1])
    >>> pole = TreeGraph([-1, 0], up[:2], [0.2, 0.2])
    >>> constrained_edit_distance(tree, tree), constrained_edit_distance(tree, pole) > 1.0
    (0.0, True)
    """
    one, two = cut_into_pieces(a), cut_into_pieces(b)
    change, delete, insert = standardised_costs(
        np.column_stack([one.length, one.thickness]), np.column_stack([two.length, two.thickness]),
        one.first != one.last, two.first != two.last,
    )  # fmt: skip
    return constrained_tree_distance(one.parent, two.parent, change, delete, insert)


def standardised_costs(
    one: ArrayLike, two: ArrayLike, counts_one: ArrayLike | None = None, counts_two: ArrayLike | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Costs of changing, deleting and inserting nodes from their attributes, Eq. 4.23 to 4.26 of the thesis.

    Parameters
    ----------
    one, two : (m, k) and (n, k) array_like
        Attributes of the nodes of two trees.
    counts_one, counts_two : (m,) and (n,) bool array_like, optional
        Nodes that are there. The others cost nothing and take no part in mean and deviation.

    Returns
    -------
    change : (m, n) float64
    delete : (m,) float64
    insert : (n,) float64
        An attribute that is the same everywhere costs nothing.

    Examples
    --------
    >>> change, delete, insert = standardised_costs([[1.0], [2.0]], [[3.0]])
    >>> change.tolist(), delete.tolist(), insert.tolist()
    ([[2.0], [1.0]], [1.0, 0.0], [1.0])
    """
    one, two = np.asarray(one, np.float64), np.asarray(two, np.float64)
    there_one = np.ones(len(one), bool) if counts_one is None else np.asarray(counts_one, bool)
    there_two = np.ones(len(two), bool) if counts_two is None else np.asarray(counts_two, bool)
    both = np.concatenate([one[there_one], two[there_two]])
    standard_one, standard_two = np.zeros_like(one), np.zeros_like(two)
    if len(both) > 1:
        mean, deviation = both.mean(axis=0), both.std(axis=0, ddof=1)
        differs = deviation > SAME * np.abs(mean)  # not by rounding alone
        scale = np.where(differs, deviation, 1.0)
        standard_one = np.where(there_one[:, None] & differs, (one - mean) / scale, 0.0)
        standard_two = np.where(there_two[:, None] & differs, (two - mean) / scale, 0.0)
    change = np.zeros((len(one), len(two)))
    for k in range(one.shape[1]):
        change += np.abs(standard_one[:, k, None] - standard_two[:, k])
    return change, np.abs(standard_one).sum(axis=1), np.abs(standard_two).sum(axis=1)


def constrained_tree_distance(
    parent_a: ArrayLike, parent_b: ArrayLike, change: ArrayLike, delete: ArrayLike, insert: ArrayLike
) -> float:
    """Constrained edit distance of two unordered trees, Zhang 1996, with costs of one's own.

    Parameters
    ----------
    parent_a, parent_b : (m,) and (n,) int array_like
        Index of each node's parent, -1 for node 0, the root; parents come first.
    change : (m, n) array_like
        Cost of changing each node of a into each of b, >= 0; no more than deleting the one and inserting the
        other.
    delete, insert : (m,) and (n,) array_like
        Cost of deleting a node of a, of inserting one of b, >= 0. Its children then belong to its parent.

    Returns
    -------
    distance : float
        Least cost of a mapping that keeps ancestors and separate subtrees separate.

    Raises
    ------
    InputError
        If the arrays do not fit each other, a tree has more than one root or a parent after its child, a cost
        is negative or not finite, changing costs more than deleting and inserting, or there are more than
        10^8 pairs.

    Notes
    -----
    O(m n) time for few children; 24 bytes per pair of nodes.

    Examples
    --------
    >>> equal = [[0.0, 1.0], [1.0, 0.0]]
    >>> constrained_tree_distance([-1, 0], [-1, 0], equal, [1, 1], [1, 1])
    0.0
    """
    from inverse import _constrained_kernels as kernels
    from inverse import _edit_kernels
    from treegraph import _kernels

    parents = [_checked_parents(name, p) for name, p in (("parent_a", parent_a), ("parent_b", parent_b))]
    m, n = parents[0].size, parents[1].size
    if m * n > MOST_PAIRS:
        raise InputError(f"two trees to compare must have at most {MOST_PAIRS} pairs of nodes, got {m} x {n}")
    costs = _checked_costs(change, delete, insert, m, n)
    start_a, child_a = _kernels.child_lists(parents[0])
    start_b, child_b = _kernels.child_lists(parents[1])
    tree, forest, saved = np.empty((m, n)), np.empty((m, n)), np.empty((m, n))
    room = _edit_kernels.make_room(int(max(np.diff(start_a).max(), np.diff(start_b).max())))
    kernels.fill_distances(
        start_a, child_a, start_b, child_b, costs[0], kernels.removal_costs(parents[0], costs[1]),
        kernels.removal_costs(parents[1], costs[2]), tree, forest, saved, room,
    )  # fmt: skip
    return max(float(tree[0, 0]), 0.0)


def _checked_parents(name: str, parent: ArrayLike) -> NDArray[np.int32]:
    array = np.asarray(parent)
    if array.ndim != 1 or array.size == 0 or array.dtype.kind not in "iu":
        raise InputError(
            f"{name} must be whole numbers of shape (n,) with n > 0, got {array.dtype} {array.shape}"
        )
    index = np.arange(array.size)
    bad = np.flatnonzero((array >= index) | ((array < 0) != (index == 0)) | (array < -1))
    if bad.size:
        i = int(bad[0])
        raise InputError(
            f"{name} must be -1 for node 0 and else lie before its node, but {name}[{i}] is {array[i]}; "
            f"{bad.size} of {array.size} nodes break this"
        )
    return array.astype(np.int32)


def _checked_costs(
    change: ArrayLike, delete: ArrayLike, insert: ArrayLike, m: int, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    out = []
    for name, value, shape in (
        ("change", change, (m, n)),
        ("delete", delete, (m,)),
        ("insert", insert, (n,)),
    ):
        array = np.ascontiguousarray(value, np.float64)
        if array.shape != shape:
            raise InputError(f"{name} must have shape {shape}, got {array.shape}")
        if not (np.isfinite(array).all() and (array >= 0.0).all()):
            raise InputError(f"{name} must be finite and >= 0, got {array.min()} to {array.max()}")
        out.append(array)
    most = out[1][:, None] + out[2]
    bad = np.argwhere(out[0] > most * (1.0 + 1e-9) + 1e-12)
    if len(bad):
        i, j = bad[0]
        raise InputError(
            f"change must be at most delete + insert, but change[{i}, {j}] is {out[0][i, j]}, "
            f"that {most[i, j]}"
        )
    return out[0], out[1], out[2]
