"""Quantities that follow from a tree graph in one pass over its nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from treegraph import _kernels
from treegraph.graph import TreeGraph

__all__ = ["children", "count_tips", "path_length", "segment_length", "subtree_length"]


def segment_length(tree: TreeGraph) -> NDArray[np.float64]:
    """Length of the segment from each node to its parent.

    Parameters
    ----------
    tree : TreeGraph
        Only ``parent`` and ``position`` (metres) are read.

    Returns
    -------
    length : (n,) float64 ndarray
        Metres; 0 at a root.

    Notes
    -----
    O(n) time and memory, as everything in this module.

    Examples
    --------
    >>> segment_length(TreeGraph([-1, 0], [[0, 0, 0], [0, 3, 4]], [0, 0])).tolist()
    [0.0, 5.0]
    """
    return _kernels.edge_length(tree.parent, tree.position)


def path_length(tree: TreeGraph) -> NDArray[np.float64]:
    """Length of the path from each node down to its root.

    Parameters
    ----------
    tree : TreeGraph
        Only ``parent`` and ``position`` (metres) are read.

    Returns
    -------
    length : (n,) float64 ndarray
        Metres; 0 at a root, never smaller at a child than at its parent.

    Examples
    --------
    >>> path_length(TreeGraph([-1, 0, 1], [[0, 0, 0], [0, 3, 4], [0, 3, 5]], [0] * 3)).tolist()
    [0.0, 5.0, 6.0]
    """
    return _kernels.path_length(tree.parent, tree.position)


def subtree_length(tree: TreeGraph) -> NDArray[np.float64]:
    """Length of all segments that a node carries, l(u) of Eq. (3.1) in [1]_.

    The segment that leads to the node itself is not counted.

    Parameters
    ----------
    tree : TreeGraph
        Only ``parent`` and ``position`` (metres) are read.

    Returns
    -------
    length : (n,) float64 ndarray
        Metres; 0 at a tip, the length of the whole tree at its root, never larger at a child than at its
        parent.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
       Konstanz, 2013, section 3.3.1

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 4], [0, 0, 6], [1, 0, 4]], [0] * 4)
    >>> subtree_length(tree).tolist()
    [7.0, 3.0, 0.0, 0.0]
    """
    return _kernels.carried_length(tree.parent, tree.position)


def count_tips(tree: TreeGraph) -> NDArray[np.int32]:
    """Number of tips that a node carries; a tip counts itself.

    Parameters
    ----------
    tree : TreeGraph
        Only ``parent`` is read.

    Returns
    -------
    n_tips : (n,) int32 ndarray
        At least 1; at a root the number of tips of its tree.

    Examples
    --------
    >>> count_tips(TreeGraph([-1, 0, 1, 1], [[0, 0, 0]] * 4, [0] * 4)).tolist()
    [2, 2, 1, 1]
    """
    return _kernels.count_tips(tree.parent)


def children(tree: TreeGraph) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Children of every node as compressed rows.

    Parameters
    ----------
    tree : TreeGraph
        Only ``parent`` is read.

    Returns
    -------
    child_start : (n + 1,) int64 ndarray
        The children of node i are ``child[child_start[i]:child_start[i + 1]]``.
    child : (n - n_roots,) int32 ndarray
        Node indices, ascending within each node.

    Examples
    --------
    >>> start, child = children(TreeGraph([-1, 0, 0], [[0, 0, 0]] * 3, [0] * 3))
    >>> start.tolist(), child.tolist()
    ([0, 2, 2, 2], [1, 2])
    """
    return _kernels.child_lists(tree.parent)
