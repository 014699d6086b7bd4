"""Compiled loops of the constrained edit distance. Arrays in, arrays out; nothing is checked here."""

import numpy as np
from numba import njit

from inverse._edit_kernels import match

_jit = njit(cache=True, error_model="numpy", nogil=True)  # 1/0 is inf, as in NumPy; no fastmath


@_jit
def removal_costs(parent, cost):
    """Cost of removing each node with all above it, and of all above it."""
    whole = cost.copy()
    for i in range(parent.size - 1, 0, -1):
        whole[parent[i]] += whole[i]
    return whole, whole - cost


@_jit
def _least_detour(rest, kids, row):
    """The least of ``row[k] - rest[k]`` over the children, infinite without any."""
    best = np.inf
    for k in kids:
        best = min(best, row[k] - rest[k])
    return best


@_jit
def fill_distances(start_1, child_1, start_2, child_2, change, delete, insert, tree, forest, saved, room):
    """Fill ``tree`` and ``forest``: distance of what is at and above each two nodes, and of what is above.

    ``delete`` and ``insert`` are pairs as from :func:`removal_costs`; ``saved`` is room of the same shape.
    """
    tree_1, forest_1 = delete
    tree_2, forest_2 = insert
    for i in range(start_1.size - 2, -1, -1):
        kids = child_1[start_1[i] : start_1[i + 1]]
        for j in range(start_2.size - 2, -1, -1):
            others = child_2[start_2[j] : start_2[j + 1]]
            best = forest_1[i] + forest_2[j]
            if kids.size > 0 and others.size > 0:
                best -= match(saved, kids, others, room)
                best = min(best, forest_2[j] + _least_detour(forest_2, others, forest[i]))
                best = min(best, forest_1[i] + _least_detour(forest_1, kids, forest[:, j]))
            forest[i, j] = best
            best += change[i, j]
            best = min(best, tree_2[j] + _least_detour(tree_2, others, tree[i]))
            best = min(best, tree_1[i] + _least_detour(tree_1, kids, tree[:, j]))
            tree[i, j] = best
            saved[i, j] = max(tree_1[i] + tree_2[j] - best, 0.0)
