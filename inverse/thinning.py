"""Trees without their thinnest branches, so that they can be compared thousands of times."""

from __future__ import annotations

import numpy as np

from inverse.pieces import cut_into_pieces
from treegraph import ClusterTree, InputError, TreeGraph, prune

__all__ = ["thin_out"]


def thin_out(tree: TreeGraph | ClusterTree, branches: int) -> TreeGraph:
    """Leave branches out, those with least wood first, until no more than so many are left.

    Parameters
    ----------
    tree : TreeGraph or ClusterTree
        One root, all radii known.
    branches : int
        Pieces between forks that may stay, 1 or more (:func:`inverse.cut_into_pieces`).

    Returns
    -------
    graph : TreeGraph
        A branch goes with all that it carries; wood is length times thickness, its own and theirs. What is
        left where a branch went is one piece, no fork.

    Raises
    ------
    InputError
        If `branches` is less than 1, or as :func:`inverse.cut_into_pieces`.

    Examples
    --------
    >>> up = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0.5, 0, 1.5], [1, 0, 3]]
    >>> tree = TreeGraph([-1, 0, 1, 1, 2], up, [0.2, 0.2, 0.2, 0.01, 0.1])
    >>> thin_out(tree, 1).position[:, 2].tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    if branches < 1:
        raise InputError(f"branches must be 1 or more, got {branches!r}")
    graph = tree.graph if isinstance(tree, ClusterTree) else tree
    pieces = cut_into_pieces(graph)
    if pieces.n_pieces <= branches:
        return graph
    wood = pieces.length * pieces.thickness
    for i in range(pieces.n_pieces - 1, 0, -1):
        wood[pieces.parent[i]] += wood[i]
    order = np.lexsort((np.arange(pieces.n_pieces), -wood))  # none before the one that carries it

    def kept(n: int) -> TreeGraph:
        stays = np.zeros(pieces.n_pieces, np.bool_)
        stays[order[:n]] = True
        return prune(graph, stays[pieces.piece_of])

    low, high = 1, pieces.n_pieces  # low fits, high does not
    while high - low > 1:
        middle = (low + high) // 2
        if cut_into_pieces(kept(middle)).n_pieces <= branches:
            low = middle
        else:
            high = middle
    return kept(low)
