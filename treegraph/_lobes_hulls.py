"""The leaf clusters of the ``.lobes`` format: hulls, seeds and densities as small integers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph import _lobes_bytes as codec
from treegraph import _lobes_mesh as meshes
from treegraph._lobes_graph import MAX_STEPS, to_grid
from treegraph.clustertree import Cluster
from treegraph.errors import FormatError, TreeError

__all__ = ["CLUSTER_COLUMNS", "encode_clusters", "read_clusters"]

HULL_COARSER = 3
"""Hulls have a grid eight times as coarse as positions (7.8 mm), or a finer one where vertices would meet."""
MAX_HULL_LEVEL = 16
DENSITY_DROPPED = 8
"""Bits that a density loses of its 32."""
MAX_DENSITY = 2.0**127
INFINITE_DENSITY = 0x7F8000
"""Densities have codes below this one."""
UNKNOWN_DENSITY = 0x7FC000
MAX_POINTS = 1 << 48
CLUSTER_COLUMNS = 6
"""Vertices, faces, seeds, points, level and density of each cluster."""


@dataclass(frozen=True)
class _Hull:
    row: NDArray[np.int64]
    symbols: bytes
    names: bytes
    residual: NDArray[np.int64]


def _concatenate(parts: list[NDArray[Any]]) -> NDArray[np.int64]:
    return np.concatenate([np.zeros(0, np.int64), *parts]).astype(np.int64)


def encode_clusters(clusters: tuple[Cluster, ...], grid: NDArray[np.int64], exponent: int) -> list[bytes]:
    """Return the sections ``clusters``, ``seeds``, ``symbols``, ``names`` and ``vertices``."""
    hulls = [_encode_hull(k, cluster, grid, exponent) for k, cluster in enumerate(clusters)]
    rows = _concatenate([hull.row for hull in hulls]).reshape(-1, CLUSTER_COLUMNS)
    seeds = _concatenate([cluster.seed for cluster in clusters])
    residual = _concatenate([hull.residual.ravel() for hull in hulls]).reshape(-1, 3)
    return [
        codec.pack_planes(rows.T),
        codec.pack_planes(codec.zigzag(np.diff(seeds, prepend=0))),
        b"".join(hull.symbols for hull in hulls),
        b"".join(hull.names for hull in hulls),
        codec.pack_planes(codec.zigzag(residual).T),
    ]


def _encode_hull(k: int, cluster: Cluster, grid: NDArray[np.int64], exponent: int) -> _Hull:
    level, vertices = _hull_grid(cluster.vertices, exponent - HULL_COARSER, f"clusters[{k}].vertices")
    number, reference, symbols, names = meshes.walk_faces(cluster.faces, len(vertices))
    ordered = vertices[number]
    near = np.array(reference, np.int64).reshape(-1, 2)
    guess = (ordered[near[:, 0]] + ordered[near[:, 1]]) >> 1 if len(near) else ordered
    guess[:1] = _hull_anchor(cluster.seed, grid, level - HULL_COARSER)
    row = [
        len(cluster.vertices),
        len(cluster.faces),
        len(cluster.seed),
        cluster.n_points,
        level,
        _density_code(k, cluster),
    ]
    return _Hull(np.array(row, np.int64), symbols, names, ordered - guess)


def _hull_anchor(seed: NDArray[np.int32], grid: NDArray[np.int64], finer: int) -> NDArray[np.int64]:
    """Where the first vertex is expected, in steps of the hull's grid: at the first seed, or the origin."""
    if seed.size == 0:
        return np.zeros(3, np.int64)
    anchor = grid[seed[0]] << finer if finer >= 0 else grid[seed[0]] >> -finer
    return np.clip(anchor, 1 - MAX_STEPS, MAX_STEPS - 1)


def _hull_grid(vertices: NDArray[np.float64], exponent: int, name: str) -> tuple[int, NDArray[np.int64]]:
    """Coarsest grid on which vertices that differ stay apart, also when rounded ones are coded again."""
    level, steps = _distinct_level(vertices, exponent, name)
    while True:
        vertices = np.ldexp(steps, -exponent - level)
        again, steps = _distinct_level(vertices, exponent, name)
        if again == level:
            return level, steps
        level = again


def _distinct_level(vertices: NDArray[np.float64], exponent: int, name: str) -> tuple[int, NDArray[np.int64]]:
    coarsest = to_grid(vertices, exponent, name)
    wanted = _count_distinct(vertices)
    reach = float(np.abs(vertices).max()) if len(vertices) else 0.0
    steps = coarsest
    for level in range(MAX_HULL_LEVEL + 1):
        if np.ldexp(reach, exponent + level) >= MAX_STEPS - 1:
            break
        steps = np.rint(np.ldexp(vertices, exponent + level)).astype(np.int64)
        if _count_distinct(steps) == wanted:
            return level, steps
    return 0, coarsest


def _count_distinct(rows: NDArray[Any]) -> int:
    if len(rows) == 0:
        return 0
    ordered = rows[np.lexsort(rows.T)]
    return 1 + int((ordered[1:] != ordered[:-1]).any(axis=1).sum())


def _density_code(k: int, cluster: Cluster) -> int:
    """The upper 24 bits of the density as a float32, rounded to nearest."""
    if cluster.density > MAX_DENSITY:
        raise TreeError(
            f"clusters[{k}].density must be at most 2**127 points per cubic metre, got {cluster.density!r}"
        )
    if cluster.n_points >= MAX_POINTS:
        raise TreeError(f"clusters[{k}].n_points must be less than {MAX_POINTS}, got {cluster.n_points}")
    if np.isnan(cluster.density):
        return UNKNOWN_DENSITY
    bits = int(np.float32(abs(cluster.density)).view(np.uint32))
    half = 1 << (DENSITY_DROPPED - 1)
    return (bits + half) >> DENSITY_DROPPED


def read_clusters(
    sections: dict[str, bytes], counts: tuple[int, int, int, int], grid: NDArray[np.int64], exponent: int
) -> tuple[Cluster, ...]:
    """Undo :func:`encode_clusters`; `counts` are those of clusters, vertices, faces and seeds."""
    rows = _read_table(sections["clusters"], *counts)
    code = rows[:, 5]
    density = np.where(code == UNKNOWN_DENSITY, 0, code << DENSITY_DROPPED).astype(np.uint32).view(np.float32)
    per_m3 = np.where(code == UNKNOWN_DENSITY, np.nan, density.astype(float))
    seed = _read_seeds(sections["seeds"], counts[3], len(grid))
    flat = codec.unzigzag(codec.unpack_planes(sections["vertices"], 3 * counts[1], "vertices"))
    if flat.size and np.abs(flat).max() >= 4 * MAX_STEPS:
        raise FormatError(
            f"vertices must be less than {4 * MAX_STEPS} steps from where they are expected, "
            f"got {np.abs(flat).max()}; the file is damaged"
        )
    residual = flat.reshape(3, counts[1])
    reader = meshes.MeshReader(sections["symbols"], sections["names"])
    vertex_end, _, seed_end = np.cumsum(rows[:, :3], axis=0).T.tolist()
    clusters = []
    for k, (n_vertices, n_faces, n_seeds, n_points, level, _) in enumerate(rows.tolist()):
        seeds = seed[seed_end[k] - n_seeds : seed_end[k]]
        faces, reference = reader.read(n_vertices, n_faces)
        anchor = _hull_anchor(seeds, grid, level - HULL_COARSER)
        steps = _read_vertices(residual[:, vertex_end[k] - n_vertices : vertex_end[k]], reference, anchor)
        clusters.append(
            Cluster(
                vertices=np.ldexp(steps, HULL_COARSER - exponent - level),
                faces=np.array(faces, np.int32).reshape(-1, 3),
                seed=seeds,
                density=per_m3[k],
                n_points=n_points,
            )
        )
    reader.finish()
    return tuple(clusters)


def _read_table(raw: bytes, n: int, n_vertices: int, n_faces: int, n_seeds: int) -> NDArray[np.int64]:
    """One row for each of n clusters, checked against the counts of the header."""
    rows = codec.unpack_planes(raw, CLUSTER_COLUMNS * n, "clusters").reshape(CLUSTER_COLUMNS, n).T
    declared = n_vertices, n_faces, n_seeds
    found = tuple(rows[:, :3].sum(axis=0).tolist())
    if found != declared:
        raise FormatError(
            f"the clusters must have {declared} vertices, faces and seeds by the header, got {found}; "
            "the file is damaged"
        )
    bad = np.flatnonzero(rows[:, 4] > MAX_HULL_LEVEL)
    if bad.size:
        raise FormatError(
            f"the level of a cluster must be 0 to {MAX_HULL_LEVEL}, got {rows[bad[0], 4]}; "
            "the file is damaged"
        )
    code = rows[:, 5]
    bad = np.flatnonzero((code >= INFINITE_DENSITY) & (code != UNKNOWN_DENSITY))
    if bad.size:
        raise FormatError(
            f"the code of a density must be less than {INFINITE_DENSITY:#x} or {UNKNOWN_DENSITY:#x}, "
            f"got {code[bad[0]]:#x}; the file is damaged"
        )
    return rows


def _read_seeds(raw: bytes, n_seeds: int, n_nodes: int) -> NDArray[np.int32]:
    seed = np.cumsum(codec.unzigzag(codec.unpack_planes(raw, n_seeds, "seeds")))
    bad = np.flatnonzero((seed < 0) | (seed >= n_nodes))
    if bad.size:
        raise FormatError(
            f"seeds must be nodes of the graph (0 to {n_nodes - 1}), got {seed[bad[0]]}; the file is damaged"
        )
    return seed.astype(np.int32)


def _read_vertices(
    residual: NDArray[np.int64], reference: list[tuple[int, int]], anchor: NDArray[np.int64]
) -> NDArray[np.int64]:
    axes = [meshes.restore(residual[axis].tolist(), reference, int(anchor[axis])) for axis in range(3)]
    steps = np.array(axes, np.int64).T
    bad = np.flatnonzero((np.abs(steps) >= MAX_STEPS).any(axis=1))
    if bad.size:
        raise FormatError(
            f"coordinates must be less than {MAX_STEPS} steps, but a vertex is at {steps[bad[0]]}; "
            "the file is damaged"
        )
    return steps
