"""The cylinder table: a tree graph as the list of cylinders that foresters' programs read.

One cylinder for each segment of the graph at most. A side branch begins where its axis leaves the
surface of the branch that carries it, so that no wood is counted twice.
"""

from __future__ import annotations

from io import StringIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from treegraph import TreeGraph

__all__ = [
    "CYLINDER_DTYPE",
    "CYLINDER_HEADER",
    "cylinder_length",
    "cylinder_table",
    "cylinder_volume",
    "format_cylinders",
    "move_cylinders",
]

#: Columns of the table, in the order in which they are written.
CYLINDER_DTYPE = np.dtype(
    [("id", np.int32), ("parent", np.int32)]
    + [(name, np.float64) for name in ("x0", "y0", "z0", "x1", "y1", "z1", "r0", "r1")]
    + [("order", np.int32), ("measured", np.bool_)]
)
CYLINDER_HEADER = ",".join(CYLINDER_DTYPE.names or ())

SHORTEST = 1e-6
"""Segments shorter than this are no cylinders, metres."""


def cylinder_table(graph: TreeGraph, origin: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.void]:
    """List the cylinders of a tree, parents before children.

    A cylinder is the frustum of one segment. The first one of a side branch begins where the
    branch's axis leaves the surface of its parent branch, with the branch's own radius there, and its
    parent is the cylinder on whose surface that is; segments that lie wholly inside the parent branch, or
    have no length, are left out and what grows from them is linked to the next cylinder towards the root.

    Parameters
    ----------
    graph : TreeGraph
        Positions, radii, and the attribute ``measured`` (n,) bool if there is one.
    origin : (3,) array_like
        Added to the positions, metres: the world position of the local origin.

    Returns
    -------
    table : (m,) structured ndarray of CYLINDER_DTYPE
        ``id`` counts from 0; ``parent`` is an id smaller than the row's own, or -1; end points and
        radii in metres; ``order`` is the Gravelius order (trunk 0); ``measured`` says that the radius
        was measured rather than inferred. m < n; 0 for a graph of single nodes.

    Notes
    -----
    O(n). An unknown radius (NaN) of the carrying branch counts as 0: nothing is cut off.

    Examples
    --------
    >>> from treegraph import TreeGraph
    >>> tree = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 1]], [0.1, 0.1, 0.1, 0.02])
    >>> table = cylinder_table(tree)
    >>> table["parent"].tolist(), table["x0"].round(3).tolist()
    ([-1, 0, 0], [0.0, 0.0, 0.1])
    """
    import treegraph

    parent = graph.parent
    has_segment = parent >= 0
    before = np.where(has_segment, parent, 0)
    start = graph.position[before]
    start_radius = graph.radius[before]
    kept = has_segment.copy()
    below = parent.astype(np.int64)
    _trim(graph, start, start_radius, kept, below)
    kept &= np.linalg.norm(graph.position - start, axis=1) > SHORTEST

    node, parent_row = _rows(below, kept)
    table = np.zeros(node.size, CYLINDER_DTYPE)
    table["id"] = np.arange(table.size)
    table["parent"] = parent_row
    for axis, name in enumerate("xyz"):
        table[f"{name}0"] = start[node, axis]
        table[f"{name}1"] = graph.position[node, axis]
    table["r0"] = start_radius[node]
    table["r1"] = graph.radius[node]
    table["order"] = np.asarray(treegraph.gravelius_order(graph))[node]
    if "measured" in graph.attribute:
        table["measured"] = graph.attribute["measured"][node]
    return move_cylinders(table, origin)


def move_cylinders(table: NDArray[np.void], offset: ArrayLike) -> NDArray[np.void]:
    """Return a copy of a :func:`cylinder_table` with (3,) metres added to every end point."""
    moved = table.copy()
    for axis, shift in zip("xyz", np.asarray(offset, np.float64), strict=True):
        moved[f"{axis}0"] += shift
        moved[f"{axis}1"] += shift
    return moved


def _trim(graph, start, start_radius, kept, below):
    """Cut the feet of all side chains; changes `start`, `start_radius`, `kept` and `below` in place."""
    import treegraph

    chain_start, chain_node = (np.asarray(array, np.int64) for array in treegraph.chains(graph))
    n_chains = chain_start.size - 1
    length = np.diff(chain_start)
    chain_of = np.repeat(np.arange(n_chains), length)
    is_foot = np.zeros(chain_node.size, bool)
    is_foot[chain_start[:-1][length > 0]] = True
    home = np.full((graph.n_nodes, 2), -1, np.int64)
    member = np.flatnonzero(~is_foot)
    home[chain_node[member], 0] = chain_of[member]
    home[chain_node[member], 1] = member
    # A root is the foot of every chain that leaves it: the first of them is the trunk and carries the others.
    side = []
    for c in np.flatnonzero(length > 1):
        foot = chain_node[chain_start[c]]
        if home[foot, 0] < 0:
            home[foot] = c, chain_start[c]
        else:
            side.append(c)
    if not side:
        return
    from sapwood import _cylinder_kernels

    radius = np.nan_to_num(graph.radius, nan=0.0)
    side = np.array(side, np.int64)  # treegraph.chains lists a chain after the one that it leaves
    _cylinder_kernels.trim_side_chains(
        side, chain_start, chain_node, home, graph.position, radius, start, start_radius, kept, below
    )


def _rows(below, kept):
    """The nodes whose segments are kept, parents first, and the row of the kept segment below each."""
    import treegraph

    # Of each node's segment, or of the next kept one below it; the last entry is what is below a root.
    row = np.full(below.size + 1, -1, np.int64)
    nodes: list[int] = []
    parent_rows: list[int] = []
    for i in treegraph.sort_topological(below).tolist():
        under = row[below[i]]
        if kept[i]:
            row[i] = len(nodes)
            nodes.append(i)
            parent_rows.append(under)
        else:
            row[i] = under
    return np.array(nodes, np.int64), np.array(parent_rows, np.int64)


def cylinder_length(table: NDArray[np.void]) -> NDArray[np.float64]:
    """Length of each cylinder of a :func:`cylinder_table`, (m,) metres."""
    delta = [table[f"{axis}1"] - table[f"{axis}0"] for axis in "xyz"]
    return np.sqrt(delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2)


def cylinder_volume(table: NDArray[np.void]) -> NDArray[np.float64]:
    """Volume of each frustum of a :func:`cylinder_table`, (m,) cubic metres; 0 where a radius is unknown."""
    r0, r1 = table["r0"], table["r1"]
    return np.nan_to_num(np.pi * cylinder_length(table) * (r0 * r0 + r0 * r1 + r1 * r1) / 3.0, nan=0.0)


def format_cylinders(table: NDArray[np.void]) -> str:
    """Write a :func:`cylinder_table` as CSV text.

    Coordinates have 4 decimals (0.1 mm), radii 5, at any distance from zero; ``measured`` is 0 or 1.
    """
    out = StringIO()
    out.write(CYLINDER_HEADER + "\n")
    for row in table.tolist():
        point = ",".join(_fixed(value, 4) for value in row[2:8])
        out.write(
            f"{row[0]},{row[1]},{point},{_fixed(row[8], 5)},{_fixed(row[9], 5)},{row[10]},{row[11]:d}\n"
        )
    return out.getvalue()


def _fixed(value: float, decimals: int) -> str:
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text
