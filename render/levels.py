"""Levels of detail: fewer and larger leaves of the same area, and the thickest branches only.

Based on: R. L. Cook, J. Halstead, M. Planck, D. Ryu, "Stochastic simplification of aggregate detail", ACM
Trans. Graph. 26(3), 2007 (a random subset stands for all, enlarged so that the area stays); S. Pirk,
"Efficient Processing of Plant Life in Computer Graphics", dissertation, University of Konstanz, 2013, section
3.5.2 (leaves in a fixed random order and edges by thickness, of which any prefix is a level).
Departs from it in: the enlargement follows from the area of the very leaves that are kept, not from their
number, so that the area stays exactly; the contrast of the subset is not corrected.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from treegraph import NO_PARENT, InputError, TreeGraph, take_nodes

__all__ = ["check_share", "lod_leaves", "thickest_edges"]


def lod_leaves(leaf_area: int | NDArray[np.float64], share: float) -> tuple[int, float]:
    """How many of a patch's leaves stand for all, and how much larger they have to be.

    Parameters
    ----------
    leaf_area : int or (m,) float64
        Number of leaves, all of one size; or the area of each, in their fixed order, m2.
    share : float
        Part of the leaves that is kept, above 0 to 1.

    Returns
    -------
    count : int
        The first so many leaves are kept: `share` of all, rounded up, so at least one if there are any.
    scale : float
        Factor on the length and the width of each: the kept area times its square is the whole area.

    Raises
    ------
    InputError
        If `share` is out of its range.
    """
    share = check_share("share", share)
    equal = isinstance(leaf_area, int | np.integer)
    area = np.ones(int(leaf_area)) if equal else np.asarray(leaf_area, np.float64)
    if not len(area):
        return 0, 1.0
    count = min(len(area), int(np.ceil(share * len(area) * (1.0 - 1e-12))))
    kept = float(area[:count].sum())
    if count == len(area) or kept <= 0.0:
        return count, 1.0
    return count, float(np.sqrt(area.sum() / kept))


def thickest_edges(
    tree: TreeGraph, share: float, keep: NDArray[np.integer] | None = None
) -> tuple[TreeGraph, NDArray[np.int64]]:
    """The thickest branches of a tree, connected to its roots.

    Parameters
    ----------
    tree : TreeGraph
        Every radius must be known.
    share : float
        Part of its edges (node to parent) that is kept, above 0 to 1.
    keep : (k,) int, optional
        Nodes that are kept in any case, with all that they grow from: what bears leaves must not float. They
        count towards the share, and may be more.

    Returns
    -------
    tree : TreeGraph
        The roots and the kept nodes, in their old order.
    node : (m,) int64
        What their numbers were, ascending.

    Raises
    ------
    InputError
        If `share` is out of its range.

    Notes
    -----
    An edge counts as no thicker than the thinnest between it and its root, so that whatever number of edges
    is taken from the thick end, each comes with all that it grows from. The levels are nested.
    """
    share = check_share("share", share)
    root = tree.parent == NO_PARENT
    n_edges = int((~root).sum())
    first = root if keep is None else root | _on_the_way(tree, keep)
    count = min(n_edges, max(int(np.ceil(share * n_edges * (1.0 - 1e-12))), int((first & ~root).sum())))
    if count == n_edges:
        return tree, np.arange(tree.n_nodes)
    order = np.lexsort((np.arange(tree.n_nodes), -_thickness(tree, root), ~first, ~root))  # roots first
    node = np.sort(order[: tree.n_nodes - n_edges + count])
    return take_nodes(tree, node), node


def _on_the_way(tree: TreeGraph, nodes: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Whether each node is one of some, or between one of them and its root."""
    marked = np.zeros(tree.n_nodes, bool)
    marked[nodes] = True
    on_the_way, parent = marked.tolist(), tree.parent.tolist()
    for i in range(tree.n_nodes - 1, -1, -1):
        if on_the_way[i] and parent[i] != NO_PARENT:
            on_the_way[parent[i]] = True
    return np.array(on_the_way)


def _thickness(tree: TreeGraph, root: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The least radius on the way from the root to each node, by doubling steps upwards."""
    least = np.where(root, np.inf, tree.radius)
    up = np.where(root, np.arange(tree.n_nodes), tree.parent)
    while True:
        above = up[up]
        least = np.minimum(least, least[up])
        if (above == up).all():
            return least
        up = above


def check_share(name: str, share: float) -> float:
    """A share above 0 to 1, or an :class:`InputError`."""
    if not 0.0 < share <= 1.0:
        raise InputError(f"{name} must be above 0 and at most 1, got {share!r}")
    return float(share)
