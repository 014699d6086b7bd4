"""Several trees in one scan: which points are whose, simply."""

from __future__ import annotations

import numpy as np

from recon.neighbours import bridge_gaps, neighbour_graph
from recon.ordering import morton_order, thin
from recon.stems import CROWN_SHARE, TOP, Stems, crown_tops, separate_stems, upright_groups

MAX_POINTS = 150_000  # of the thinned cloud that ways are looked for in
WAY_EXPONENT = 2.0  # ways take short steps: a gap between two crowns costs more than its length
SLAB = 1.0  # metres
STEM_ZONE = 0.6  # share of the height in which stems are looked for
LEAN = 0.5  # metres that a stem moves by from slab to slab at most
MIN_COLUMN = 3.0  # metres of column that make a stem ...
MIN_COLUMN_SHARE = 0.15  # ... and this share of the height
STEM_REACH = 0.3  # metres around a stem, beyond its spread, where its tree begins
STEM_TOP = 2.0  # metres above its middle in the slab


def nearest_tree(xyz: np.ndarray, stems: Stems, height: np.ndarray) -> np.ndarray:
    """Number of the tree that each point is nearest to on a way through the points.

    Trees begin at the stems that stand apart on the ground. Where no two are seen (from the air) they
    are the tops of the crowns, and a point belongs to the nearest top on the map.

    Parameters
    ----------
    xyz : (n, 3) float64
        Metres.
    stems : Stems
    height : (n,) float64
        Above the ground, metres.

    Returns
    -------
    (n,) int64
        From 0.
    """
    from scipy.spatial import cKDTree

    top = float(np.quantile(height, TOP))
    centre, spread = stem_columns(xyz, top)
    if len(centre) < 2:
        chosen = separate_stems(xyz, stems, height, top)
        centre, spread = stems.centre[chosen], stems.spread[chosen]
    if len(centre) < 2:
        tops = crown_tops(xyz[height > CROWN_SHARE * top], top)
        return cKDTree(tops).query(xyz[:, :2])[1] if len(tops) else np.zeros(len(xyz), np.int64)
    order, code, _ = morton_order(xyz)
    thinned, cell_of = thin(xyz[order], code, MAX_POINTS)
    tree = np.empty(len(xyz), np.int64)
    tree[order] = _by_ways(thinned, centre, spread)[cell_of]
    return tree


def stem_columns(xyz: np.ndarray, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Stems that stand on a ground of any shape: compact groups of points on top of each other.

    The scan is cut into slabs of `SLAB` metres. A compact upright group of points in a slab carries on
    the column that ends in the slab below (or the one below that) within `LEAN` metres. Columns of
    enough slabs are stems.

    Parameters
    ----------
    xyz : (n, 3) float64
    top : float
        Height of the scan, metres.

    Returns
    -------
    centre : (k, 3) float64
        Middle of the lowest group of each stem.
    spread : (k,) float64
        Root mean square distance of its points from there, metres.
    """
    low = float(np.quantile(xyz[:, 2], 1 - TOP))
    slab = np.floor((xyz[:, 2] - low) / SLAB).astype(np.int64)
    columns: list[list[tuple[int, np.ndarray, float]]] = []
    for k in range(int(STEM_ZONE * top / SLAB) + 1):
        middle, spread = upright_groups(xyz[slab == k], low + k * SLAB, SLAB)
        free = [c for c in columns if k - c[-1][0] <= 2]
        for m, r in zip(middle, spread, strict=True):
            gap = [float(np.hypot(*(c[-1][1] - m)[:2])) for c in free]
            if gap and min(gap) < LEAN:
                free.pop(int(np.argmin(gap))).append((k, m, r))
            else:
                columns.append([(k, m, r)])
    fewest = max(MIN_COLUMN, MIN_COLUMN_SHARE * top) / SLAB
    stems = [c[0] for c in columns if len(c) >= fewest]
    if not stems:
        return np.zeros((0, 3)), np.zeros(0)
    return np.array([m for _, m, _ in stems]), np.array([r for _, _, r in stems])


def _by_ways(xyz: np.ndarray, centre: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Stem from which the shortest way leads to each point."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    graph = bridge_gaps(xyz, neighbour_graph(xyz))
    weight = csr_matrix((graph.length**WAY_EXPONENT, graph.neighbour, graph.start), shape=(len(xyz),) * 2)
    source, owner = [], []
    for k, (middle, radius) in enumerate(zip(centre, spread, strict=True)):
        near = np.hypot(*(xyz[:, :2] - middle[:2]).T) < radius + STEM_REACH
        at = np.flatnonzero(near & (xyz[:, 2] < middle[2] + STEM_TOP))
        source.append(at)
        owner.append(np.full(at.size, k))
    rows = np.concatenate(source)
    of_point = np.full(len(xyz), -1, np.int64)
    of_point[rows[::-1]] = np.concatenate(owner)[::-1]
    _, _, start = dijkstra(
        weight, directed=True, indices=np.unique(rows), return_predecessors=True, min_only=True
    )
    return of_point[start]
