"""The neighbourhood graph of a scan and the shortest paths through it.

Based on: Livny et al., "Automatic reconstruction of tree skeletal structures from point
clouds", ACM Trans. Graph. 29(6), 2010, as retold in S. Pirk, "Efficient Processing of Plant Life in
Computer Graphics", PhD thesis, University of Konstanz, 2013, section 3.3.1:
connect neighbouring points, weigh each edge by its length to the power beta, take the
shortest paths from the base of the trunk.

Departs from it in: gaps (occlusion, scan lines) are bridged by links between the closest
points of the separate pieces, and of these links only those survive that a shortest path
under the weights |u - v|^beta uses. So beta decides what is connected to what, while the
distances from the base that the skeleton is cut into slices by are plain lengths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LINK_NEIGHBOURS = 8  # how many neighbours of a cell may become bridges
LINK_FIRST_CELL = 4.0  # first cell of the bridge search, in units of the point spacing
LINK_CELL_GROWTH = 3.0  # each further round looks this much wider
MIN_LENGTH = 1e-9  # metres; a zero weight would read as "no edge" in a sparse matrix
MIN_SPACING = 1e-4  # metres; of points that mostly coincide
SPACING_NEIGHBOUR = 4  # the spacing of a cloud is the median distance to this neighbour


@dataclass(frozen=True, eq=False)
class NeighbourGraph:
    """An undirected weighted graph over points, both directions stored, as CSR.

    Attributes
    ----------
    start : (n + 1,) int32
        Where the neighbours of each point begin in `neighbour`.
    neighbour : (m,) int32
        Indices of the neighbours.
    length : (m,) float64
        Length of each edge, metres.
    n_near : int
        Edges whose two points are near neighbours come from the k-nearest search; the
        others are bridges over gaps. Number of near edges (each counted twice).
    spacing : float
        Median distance of a point to its fourth neighbour, metres.
    """

    start: np.ndarray
    neighbour: np.ndarray
    length: np.ndarray
    n_near: int
    spacing: float

    @property
    def n_points(self) -> int:
        return self.start.size - 1


def neighbour_graph(xyz: np.ndarray, n_neighbours: int = 10) -> NeighbourGraph:
    """Connect every point with its nearest neighbours; both ends know the edge.

    Parameters
    ----------
    xyz : (n, 3) float64
        Points, metres. Sorting them into cells first makes this faster.
    n_neighbours : int, default 10
        Nearest neighbours of each point, > 0.

    Returns
    -------
    NeighbourGraph
        Symmetric; may fall into several components.

    Notes
    -----
    O(n log n) time, about 200 bytes per point at 10 neighbours.
    """
    from scipy.spatial import cKDTree

    from recon import _skeleton_kernels as kernels

    n = xyz.shape[0]
    k = min(n_neighbours, n - 1)
    if k < 1:
        return NeighbourGraph(np.zeros(n + 1, np.int32), np.zeros(0, np.int32), np.zeros(0), 0, 0.0)
    tree = cKDTree(xyz, balanced_tree=False, compact_nodes=False)
    distance, index = tree.query(xyz, k + 1)
    spacing = max(float(np.median(distance[:, min(SPACING_NEIGHBOUR, k)])), MIN_SPACING)
    start, neighbour, length = kernels.symmetric_edges(index.astype(np.int32), distance)
    return NeighbourGraph(start, neighbour, length, neighbour.size, spacing)


def components(graph: NeighbourGraph) -> tuple[int, np.ndarray]:
    """Number of connected components and the component of each point, (n,) int32."""
    from scipy.sparse.csgraph import connected_components

    return connected_components(_as_csr(graph, graph.length), directed=False)


def bridge_gaps(xyz: np.ndarray, graph: NeighbourGraph) -> NeighbourGraph:
    """Join the components of a graph by links between their closest points.

    In rounds of growing reach, one point of each component stands for its cell of a grid;
    its nearest neighbours in other components become links, whose ends then walk to the
    locally closest pair. Rounds end when one component is left.

    Parameters
    ----------
    xyz : (n, 3) float64
        The points of `graph`, metres.
    graph : NeighbourGraph
        May have any number of components.

    Returns
    -------
    NeighbourGraph
        Connected, with the same near edges first in meaning (`n_near` is unchanged).
    """
    from recon import _skeleton_kernels as kernels

    n_components, component = components(graph)
    if n_components == 1:
        return graph
    low = xyz.min(axis=0)
    extent = float((xyz.max(axis=0) - low).max())
    cell = LINK_FIRST_CELL * max(graph.spacing, 1e-6 * max(extent, 1e-9))
    links = [np.zeros((0, 2), np.int64)]
    joined = component
    while n_components > 1:
        # A cell that holds everything: components in groups find only their own, so groups count as one.
        seen = component if cell <= extent else joined
        found = _links_between_cells(xyz - low, seen.astype(np.int64), cell)
        if found.size:
            ends = kernels.descend_to_closest(xyz, graph.start, graph.neighbour, found)
            links.append(ends)
            n_components, joined = _join(component, np.concatenate(links))
        cell *= LINK_CELL_GROWTH
    return _with_links(xyz, graph, np.concatenate(links))


def _links_between_cells(local: np.ndarray, component: np.ndarray, cell: float) -> np.ndarray:
    """Pairs of points of different components, one point of each component per cell.

    The largest component only receives links: the others find it.
    """
    from scipy.spatial import cKDTree

    key = np.floor(local / cell).astype(np.int64)
    size = key.max(axis=0) + 1
    code = ((component * size[0] + key[:, 0]) * size[1] + key[:, 1]) * size[2] + key[:, 2]
    _, row = np.unique(code, return_index=True)
    if row.size < 2:
        return np.zeros((0, 2), np.int64)
    k = min(LINK_NEIGHBOURS + 1, row.size)
    seek = row[component[row] != np.bincount(component).argmax()]
    _, index = cKDTree(local[row]).query(local[seek], k)
    a = np.repeat(seek, k)
    b = row[index.ravel()]
    other = component[a] != component[b]
    return np.stack([a[other], b[other]], axis=1)


def _join(component: np.ndarray, links: np.ndarray) -> tuple[int, np.ndarray]:
    """Components after adding links, from the components before."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = int(component.max()) + 1
    a, b = component[links[:, 0]], component[links[:, 1]]
    count, label = connected_components(coo_matrix((np.ones(a.size), (a, b)), (n, n)), directed=False)
    return count, label[component].astype(np.int64)


def _with_links(xyz: np.ndarray, graph: NeighbourGraph, links: np.ndarray) -> NeighbourGraph:
    """The graph with links added in both directions; doubles and self-links dropped."""
    from recon import _skeleton_kernels as kernels

    n = graph.n_points
    code = np.unique(links.min(axis=1) * n + links.max(axis=1))
    low, high = code // n, code % n
    gap = np.maximum(np.linalg.norm(xyz[low] - xyz[high], axis=1), MIN_LENGTH)
    pair = np.concatenate([np.stack([low, high], 1), np.stack([high, low], 1)])
    start, neighbour, length = kernels.insert_edges(
        graph.start, graph.neighbour, graph.length, pair, np.concatenate([gap, gap])
    )
    return NeighbourGraph(start, neighbour, length, graph.n_near, graph.spacing)


def shortest_paths(
    graph: NeighbourGraph, sources: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Dijkstra from a set of sources.

    Parameters
    ----------
    graph : NeighbourGraph
    sources : (s,) int
        Points at distance 0.
    weight : (m,) float64
        Weight of each stored edge, >= 0.

    Returns
    -------
    distance : (n,) float64
        Sum of weights from the nearest source, inf where there is no path.
    before : (n,) int32
        The point before each one on its path, negative at sources and unreached points.
    """
    from scipy.sparse.csgraph import dijkstra

    distance, before, _ = dijkstra(
        _as_csr(graph, weight), directed=True, indices=sources, return_predecessors=True, min_only=True
    )
    return distance, before


def trusted_graph(graph: NeighbourGraph, sources: np.ndarray, beta: float, reach: float) -> NeighbourGraph:
    """Keep the near edges up to `reach` and those that a |u - v|^beta shortest path uses.

    Edge weights as in section 3.3.1 of [1]_. Long links that no shortest path needs are
    the ones that would let the distance from the base run across gaps between branches.

    Parameters
    ----------
    graph : NeighbourGraph
        Connected.
    sources : (s,) int
        Points at the base of the trunk.
    beta : float
        Exponent, >= 1: larger means that many short steps win against a long one.
    reach : float
        Edges not longer than this are kept anyway, metres.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis,
       University of Konstanz, 2013.
    """
    from recon import _skeleton_kernels as kernels

    _, before = shortest_paths(graph, sources, graph.length**beta)
    keep = kernels.edges_to_keep(graph.start, graph.neighbour, graph.length, before, reach)
    owner = np.repeat(np.arange(graph.n_points), np.diff(graph.start))
    start = np.zeros(graph.n_points + 1, np.int32)
    np.cumsum(np.bincount(owner[keep], minlength=graph.n_points), out=start[1:])
    return NeighbourGraph(
        start, graph.neighbour[keep], graph.length[keep], min(graph.n_near, int(keep.sum())), graph.spacing
    )


def _as_csr(graph: NeighbourGraph, weight: np.ndarray):
    from scipy.sparse import csr_matrix

    n = graph.n_points
    return csr_matrix((weight, graph.neighbour, graph.start), shape=(n, n))
