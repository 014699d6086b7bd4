"""Axes of a tree: which child continues which branch, branch orders, and chains.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, sections 5.2.2 and 6.1.3.

Departs from it in: how thickness and length take part (6.1.3 names them without a rule), the trunk's
number (0 here, 1 there), and bifurcations with missing directions or radii, which it leaves open.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from treegraph import _kernels
from treegraph.errors import InputError
from treegraph.graph import TreeGraph

__all__ = ["chains", "continue_axis", "gravelius_order"]

MIN_RADIUS_SHARE = 0.7
"""A child thinner than this share of its thickest sibling does not continue the axis."""

MIN_LENGTH_SHARE = 0.5
"""A child that leads less far than this share of its farthest-leading sibling does not continue the axis."""

ALIKE = 0.05
"""Relative difference in angle and radius below which children have one order (thesis 5.2.2)."""

TIE = 1e-6
"""Angles this close, in radians, and radii and lengths this close, relatively, are equal: rounding does not
choose between the two halves of an even fork."""


def continue_axis(tree: TreeGraph) -> NDArray[np.int32]:
    """The child of each node that continues its axis.

    Of the children of a node, in this order (thesis 5.2.2 and 6.1.3):

    1. thickness: those with a radius below 0.7 times the largest among them drop out (an unknown
       radius never drops out);
    2. length: of the rest, those drop out whose longest way to a tip, their own segment included, is
       below half of the longest among that rest;
    3. the smallest deviation angle, between the child's segment and the node's own, wins; if angles are
       equal to 1e-6 rad, the larger radius (if all of them are known), then the longer way, both
       to one part in 10^6, then the lower index.

    A twig that happens to leave straight on therefore never takes over the trunk. At a root, which has
    no segment of its own, all angles count as equal, as 0. A segment without length has the
    direction of its parent's.

    Parameters
    ----------
    tree : TreeGraph
        ``parent``, ``position`` (metres) and ``radius`` (metres) are read.

    Returns
    -------
    axis : (n,) int32 ndarray
        Index of the child; -1 at a tip.

    Notes
    -----
    O(n) time and memory. The choice does not change with rotation, translation or scale; nor, unless the
    lower index has to decide, with the order of the children.

    Examples
    --------
    >>> up = [[0, 0, 0], [0, 0, 1], [0, 0, 2]]
    >>> tree = TreeGraph([-1, 0, 1, 1], up + [[0, 1, 1]], [0.2, 0.2, 0.01, 0.2])  # a twig goes straight on
    >>> continue_axis(tree).tolist()
    [1, 3, -1, -1]
    """
    return _axes(tree)[0]


def _axes(tree: TreeGraph) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    edge = _kernels.edge_length(tree.parent, tree.position)
    direction = _kernels.edge_direction(tree.parent, tree.position, edge)
    angle = _kernels.deviation_angle(tree.parent, direction)
    length = _kernels.reach(tree.parent, edge) + edge
    start, child = _kernels.child_lists(tree.parent)
    axis = np.empty(tree.n_nodes, np.int32)
    _kernels.continue_axes(
        start, child, angle, tree.radius, length, MIN_RADIUS_SHARE, MIN_LENGTH_SHARE, TIE, axis
    )
    return axis, angle


def gravelius_order(tree: TreeGraph, *, alike: float = ALIKE) -> NDArray[np.int32]:
    """Order of the branch to which each node belongs: 0 on the trunk, one more at every side branch.

    At each node the child of :func:`continue_axis` keeps the order, the others have one more (thesis
    5.2.2). So that trees without a leader have no arbitrary one, a child also keeps the order if its
    deviation angle and its radius both differ by less than 5% from those of the continuing child. The
    difference of a and b is measured against the larger, ``|a - b| < alike * max(a, b)``. Equal radii never
    differ, nor do angles within 1e-6 rad of each other; unknown radii always differ.

    Parameters
    ----------
    tree : TreeGraph
        ``parent``, ``position`` (metres) and ``radius`` (metres) are read.
    alike : float, default 0.05
        The relative difference, dimensionless, >= 0; at 0 there is no such exception.

    Returns
    -------
    order : (n,) int32 ndarray
        0 at a root. The thesis counts from 1: add 1 for its g.

    Raises
    ------
    InputError
        If `alike` is negative or not finite.

    Notes
    -----
    O(n) time and memory. One more than at the parent at most, and never less. In a forest every root is 0.

    Examples
    --------
    >>> trunk = [[0, 0, 0], [0, 0, 1], [0, 0, 2]]
    >>> tree = TreeGraph([-1, 0, 1, 1], trunk + [[0, 1, 1]], [0.2, 0.1, 0.1, 0.05])
    >>> gravelius_order(tree).tolist()
    [0, 0, 0, 1]
    """
    if not (np.isfinite(alike) and alike >= 0.0):
        raise InputError(f"alike must be a finite number >= 0, got {alike!r}")
    axis, angle = _axes(tree)
    order = np.empty(tree.n_nodes, np.int32)
    _kernels.branch_orders(tree.parent, axis, angle, tree.radius, float(alike), TIE, order)
    return order


def chains(tree: TreeGraph) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Chains of the tree: its branches as runs of consecutive segments (thesis 6.1.3).

    A chain follows :func:`continue_axis` up to a tip. Every segment is in exactly one chain, and all
    segments of a chain have one order. Two children of one order (:func:`gravelius_order`) are still
    two chains, as a node of a chain has one successor.

    Parameters
    ----------
    tree : TreeGraph
        ``parent``, ``position`` (metres) and ``radius`` (metres) are read.

    Returns
    -------
    chain_start : (c + 1,) int64 ndarray
        Chain k is ``chain_node[chain_start[k]:chain_start[k + 1]]``, root side first. Chains are
        sorted by the first node of their own, so a chain comes after the one that it leaves.
    chain_node : (n - n_roots + c,) int32 ndarray
        Node indices. The first chain of a root begins with the root; every other chain begins with
        the node it leaves from, which belongs to another chain, then goes on with its own nodes. A
        root without children is a chain of one node.

    Notes
    -----
    O(n) time and memory. Departs from [1]_, which walks from each tip towards the root until it meets a
    marked node: that gives the same chains if the tips are taken in the right order, which is what
    :func:`continue_axis` decides.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", 2013, section 6.1.3

    Examples
    --------
    >>> trunk = [[0, 0, 0], [0, 0, 1], [0, 0, 2]]
    >>> start, node = chains(TreeGraph([-1, 0, 1, 1], trunk + [[0, 1, 1]], [0.2, 0.1, 0.1, 0.05]))
    >>> [node[a:b].tolist() for a, b in zip(start[:-1], start[1:])]
    [[0, 1, 2], [1, 3]]
    """
    return _kernels.list_chains(tree.parent, continue_axis(tree))
