"""A tree as pieces between its forks: the branch graph whose nodes the paper compares.

Based on: O. Stava, S. Pirk, J. Kratt, B. Chen, R. Mech, O. Deussen, B. Benes, "Inverse Procedural Modeling of
Trees", Computer Graphics Forum 33(6), 2014, section 5.2 and table 3.

Departs from it in, or reads it as: a node of the branch graph is the piece of a branch from one fork to the
next, or to a tip, so that how finely its segments are sampled does not matter. A segment is as thick as its
own node, the one farther from the root: at a fork all branches share a node, whose radius is that of the
thickest. Nodes that lie where interpolation between their neighbours puts them, in place and radius, are
passed over, or sampling a segment more finely would spread the fork's radius along it. The paper calls a
piece a branch; elsewhere in Sapwood a branch goes on through its forks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treegraph import ClusterTree, InputError, TreeGraph

__all__ = ["Pieces", "cut_into_pieces"]

LARGEST = 1e9  # metres; the fourth power of what is larger by far is no number any more


@dataclass(frozen=True, eq=False)
class Pieces:
    """A tree cut at its forks.

    Pieces that carry others (**forks**) come first, depth-first, then those that carry none (**tips**), in
    the order of the forks that they sit on. So ``parent[i] < i``; what is above fork i are the forks that
    follow it.

    Attributes
    ----------
    graph : TreeGraph
        The tree itself, n nodes.
    parent : (m,) int32
        The piece on which each sits; -1 for piece 0, which begins at the root.
    length : (m,) float64
        Metres; 0 for piece 0 if the root is a fork itself.
    thickness : (m,) float64
        Largest diameter of its segments, metres; of the trunk the root's too. A piece that is a single cone
        with radius 0 at its end is as thick as its mean.
    bend : (m,) float64
        Sum of the angles between its segments, radians: the deformation of table 3.
    joint : (m,) float64
        Angle between its first segment and the last one of its parent, radians.
    first, last : (m,) int32
        Node at which it begins, which belongs to the piece below, and node at which it ends.
    piece_of : (n,) int32
        The piece of each node's segment; 0 for the root.
    n_forks : int
        How many of the pieces carry others.
    """

    graph: TreeGraph
    parent: NDArray[np.int32]
    length: NDArray[np.float64]
    thickness: NDArray[np.float64]
    bend: NDArray[np.float64]
    joint: NDArray[np.float64]
    first: NDArray[np.int32]
    last: NDArray[np.int32]
    piece_of: NDArray[np.int32]
    n_forks: int

    @property
    def n_pieces(self) -> int:
        """Number of pieces, at least 1."""
        return int(self.parent.size)

    @property
    def start(self) -> NDArray[np.float64]:
        """Where each begins, (m, 3), metres."""
        return self.graph.position[self.first]

    @property
    def end(self) -> NDArray[np.float64]:
        """Where each ends, (m, 3), metres."""
        return self.graph.position[self.last]

    def __repr__(self) -> str:
        return f"<Pieces {self.n_forks} forks, {self.n_pieces - self.n_forks} tips>"


def cut_into_pieces(tree: TreeGraph | ClusterTree | Pieces, *, every_segment: bool = False) -> Pieces:
    """Cut a tree at its forks.

    Parameters
    ----------
    tree : TreeGraph, ClusterTree or Pieces
        Of a ClusterTree its graph; pieces are returned as they are. One root; all radii known.
    every_segment : bool, default False
        Whether every segment is a piece of its own: how a tree is compared that is not cut at its forks
        first.

    Returns
    -------
    pieces : Pieces
        A tree of one node is one piece without length. With a root that is a fork, piece 0 has no length.

    Raises
    ------
    InputError
        If there are several roots, a radius is unknown, or a coordinate or radius is beyond 10^9 m.

    Notes
    -----
    O(n).

    Examples
    --------
    >>> up = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 3], [-1, 0, 3]]
    >>> pieces = cut_into_pieces(TreeGraph([-1, 0, 1, 2, 2], up, [0.2, 0.2, 0.2, 0.1, 0.1]))
    >>> pieces, pieces.parent.tolist(), pieces.length.round(3).tolist()
    (<Pieces 1 forks, 2 tips>, [-1, 0, 0], [2.0, 1.414, 1.414])
    """
    if isinstance(tree, Pieces):
        return tree
    from inverse import _piece_kernels
    from treegraph import _kernels

    graph = tree.graph if isinstance(tree, ClusterTree) else tree
    _check_graph(graph)
    edge = _kernels.edge_length(graph.parent, graph.position)
    direction = _kernels.edge_direction(graph.parent, graph.position, edge)
    angle = _kernels.deviation_angle(graph.parent, direction)
    start, child = _kernels.child_lists(graph.parent)
    parent, length, thickness, bend, joint, first, last, piece_of = _piece_kernels.cut_pieces(
        graph.parent, graph.position, graph.radius, edge, angle, start, child, every_segment
    )
    order = np.empty(parent.size, np.int64)
    n_forks = _piece_kernels.number_pieces(parent, order)
    rank = np.empty(parent.size + 1, np.int32)
    rank[order] = np.arange(parent.size, dtype=np.int32)
    rank[-1] = -1  # parent -1 reads the last entry
    return Pieces(
        graph, rank[parent[order]], length[order], thickness[order], bend[order], joint[order], first[order],
        last[order], rank[piece_of], n_forks,
    )  # fmt: skip


def _check_graph(graph: TreeGraph) -> None:
    roots = int((graph.parent < 0).sum())
    if roots > 1:
        raise InputError(f"a tree to compare must have one root, got {roots}; compare its trees one by one")
    unknown = np.flatnonzero(np.isnan(graph.radius[1:]))
    if unknown.size:
        raise InputError(
            f"a tree to compare must have known radii, but that of node {unknown[0] + 1} is not; "
            f"{unknown.size} of {graph.n_nodes} nodes break this. treegraph.allometric_radii() makes some."
        )
    largest = max(float(np.abs(graph.position).max()), float(np.nanmax(graph.radius, initial=0.0)))
    if largest > LARGEST:
        raise InputError(
            f"a tree to compare must have coordinates and radii up to {LARGEST:g} m, got {largest:g} m"
        )
