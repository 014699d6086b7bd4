"""The ``.lobes`` file: a cluster tree in a few kilobytes, quantised, compressed and checksummed.

The format is written down in ``docs/lobes-format.md``; this module and that text say the same.
"""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph import _lobes_bytes as codec
from treegraph import _lobes_mesh as meshes
from treegraph._files import write_whole
from treegraph.allometry import Allometry
from treegraph.clustertree import Cluster, ClusterTree
from treegraph.errors import FormatError, InputError, TreeError
from treegraph.graph import NO_PARENT, TreeGraph

__all__ = ["LobesLimits", "decode_lobes", "encode_lobes", "read_lobes", "write_lobes"]

MAGIC = b"\x89LOBES\r\n"
VERSION = 1
HEADER = struct.Struct("<8sHHIIIIIIIBB3d4d")
"""Magic, version, flags, file size, nodes, clusters, vertices, faces, seeds, EPSG, exponent, bytes of the
species, origin, and beta, gamma, f_s, d_root."""
CHECKSUM = struct.Struct("<I")
HAS_MEASURED = 1
"""Flag: the section ``measured`` has a bit for each node."""

COARSEST = 10
"""The coarsest grid of positions has a step of 2**-10 m = 0.98 mm."""
FINEST = 24
FEWEST_STEPS = 512
"""The grid is made finer until the tree reaches as many steps from the origin."""
MAX_STEPS = 1 << 28
"""Coordinates must be below this many steps: 262 km on the coarsest grid."""
RADIUS_FINER = 2
"""Small radii have a grid four times as fine as positions."""
RADIUS_BITS = 8
"""Radii of 2**9 steps and more keep 8 bits after the leading one."""
HULL_COARSER = 3
"""Hulls have a grid eight times as coarse as positions (7.8 mm), or a finer one where vertices would meet."""
MAX_RADIUS_CODE = (19 << RADIUS_BITS) + 511
"""Code of the largest radius, 511 * 2**19 steps (65 km on the coarsest grid)."""
MAX_HULL_LEVEL = 16
DENSITY_DROPPED = 8
"""Bits that a density loses of its 32."""
MAX_DENSITY = 2.0**127
INFINITE_DENSITY = 0x7F8000
"""Densities have codes below this one."""
UNKNOWN_DENSITY = 0x7FC000
CLUSTER_COLUMNS = 6
"""Vertices, faces, seeds, points, level and density of each cluster."""


@dataclass(frozen=True)
class LobesLimits:
    """The most that a reader takes; it refuses a file that declares more before allocating for it.

    Attributes
    ----------
    n_bytes : int
        Bytes of the file.
    n_nodes, n_clusters, n_vertices, n_faces, n_seeds : int
        Counts in the whole file.
    """

    n_bytes: int = 1 << 25
    n_nodes: int = 1 << 20
    n_clusters: int = 1 << 14
    n_vertices: int = 1 << 18
    n_faces: int = 1 << 18
    n_seeds: int = 1 << 20


DEFAULT_LIMITS = LobesLimits()


@dataclass(frozen=True)
class _Header:
    flags: int
    n_nodes: int
    n_clusters: int
    n_vertices: int
    n_faces: int
    n_seeds: int
    epsg: int
    exponent: int
    origin: tuple[float, ...]
    allometry: tuple[float, ...]
    species: str | None

    def section_limits(self) -> dict[str, int]:
        """Every section in the order of the file and the most bytes it may hold."""
        mask = (self.n_nodes + 7) // 8
        word = codec.MAX_PLANES
        return {
            "starts": mask,
            "jumps": word * self.n_nodes,
            "positions": 3 * word * self.n_nodes,
            "radii": word * self.n_nodes,
            "measured": mask if self.flags & HAS_MEASURED else 0,
            "clusters": CLUSTER_COLUMNS * word * self.n_clusters,
            "seeds": word * self.n_seeds,
            "symbols": 3 * self.n_faces,
            "names": 3 * codec.MAX_VARINT_BYTES * self.n_faces,
            "vertices": 3 * word * self.n_vertices,
        }


def encode_lobes(tree: ClusterTree) -> bytes:
    """Return the bytes of a ``.lobes`` file.

    Parameters
    ----------
    tree : ClusterTree
        Of the node attributes only ``measured`` (bool) is kept.

    Returns
    -------
    data : bytes
        The same for the same tree, and ``encode_lobes(decode_lobes(data)) == data``.

    Raises
    ------
    TreeError
        If the tree is larger than the format allows (:class:`LobesLimits`), lies more than 262 km
        from its origin, or ``measured`` is not one bool per node.

    Notes
    -----
    The order of the nodes is kept. Positions move by at most 0.49 mm along each axis, radii by at most
    0.13 mm (0.2 % above 125 mm; a positive radius stays positive), hull vertices by at most 8 mm along
    each axis, densities by 0.001 %. The faces of a hull come back in another order, and its vertices with
    other numbers; which vertices a face joins does not change. Trees that reach less than half a metre from
    their origin get proportionally finer grids.
    """
    graph = tree.graph
    _check_sizes(tree)
    exponent = _position_exponent(graph.position)
    grid = _to_grid(graph.position, exponent, "position")
    flags, measured = 0, b""
    if "measured" in graph.attribute:
        flags, measured = HAS_MEASURED, _pack_measured(graph.attribute["measured"])
    parent = graph.parent.astype(np.int64)
    is_start = parent != np.arange(graph.n_nodes) - 1
    clusters = [_encode_hull(k, cluster, grid, exponent) for k, cluster in enumerate(tree.clusters)]
    seeds = _concatenate([cluster.seed for cluster in tree.clusters])
    sections = [
        codec.pack_bits(is_start),
        codec.pack_planes((np.arange(graph.n_nodes) - 1 - parent)[is_start]),
        codec.pack_planes(codec.zigzag(_position_residual(parent, grid)).T),
        codec.pack_planes(codec.zigzag(_first_difference(parent, _radius_code(graph.radius, exponent)))),
        measured,
        codec.pack_planes(_concatenate([hull.row for hull in clusters]).reshape(-1, CLUSTER_COLUMNS).T),
        codec.pack_planes(codec.zigzag(np.diff(seeds, prepend=0))),
        b"".join(hull.symbols for hull in clusters),
        b"".join(hull.names for hull in clusters),
        codec.pack_planes(
            codec.zigzag(_concatenate([hull.residual.ravel() for hull in clusters]).reshape(-1, 3).T)
        ),
    ]
    return _assemble(tree, flags, exponent, codec.join_sections(sections))


def decode_lobes(data: bytes, *, limits: LobesLimits = DEFAULT_LIMITS) -> ClusterTree:
    """Return the tree in the bytes of a ``.lobes`` file.

    Parameters
    ----------
    data : bytes
        The whole file; nothing in it is trusted.
    limits : LobesLimits, optional
        The most to accept.

    Returns
    -------
    tree : ClusterTree
        ``graph.attribute`` has ``measured`` if the file has it.

    Raises
    ------
    FormatError
        If the bytes are not a ``.lobes`` file, a damaged one, one of a later version, or one above
        the limits. No other exception leaves this function, whatever the bytes are.
    """
    header, body = _read_header(bytes(data), limits)
    sections = codec.split_sections(body, header.section_limits())
    parent = _read_parents(sections, header.n_nodes)
    grid = _read_positions(sections["positions"], parent)
    try:
        graph = TreeGraph(
            parent.astype(np.int32),
            np.ldexp(grid, -header.exponent),
            _read_radii(sections["radii"], parent, header.exponent),
            _read_measured(sections["measured"], header),
        )
        return ClusterTree(
            graph=graph,
            clusters=_read_clusters(sections, header, grid),
            species=header.species,
            allometry=Allometry(*header.allometry),
            origin=np.array(header.origin),
            epsg=header.epsg or None,
        )
    except (TreeError, InputError) as error:
        raise FormatError(f"the file holds no valid tree: {' '.join(str(error).split())}") from error


def read_lobes(path: str | os.PathLike[str], *, limits: LobesLimits = DEFAULT_LIMITS) -> ClusterTree:
    """Read a ``.lobes`` file.

    Parameters
    ----------
    path : path
        The file.
    limits : LobesLimits, optional
        The most to accept.

    Raises
    ------
    FormatError
        As :func:`decode_lobes`; the message begins with the name of the file.
    OSError
        If the file cannot be opened or read.
    """
    path = Path(path)
    with path.open("rb") as file:
        data = file.read(limits.n_bytes + 1)
    try:
        return decode_lobes(data, limits=limits)
    except FormatError as error:
        raise FormatError(f"{path.name}: {error}") from error


def write_lobes(tree: ClusterTree, path: str | os.PathLike[str]) -> None:
    """Write a ``.lobes`` file, whole or not at all (a temporary file beside it is renamed).

    Parameters
    ----------
    tree : ClusterTree
        What to write.
    path : path
        The file; an existing one is replaced.

    Raises
    ------
    TreeError
        As :func:`encode_lobes`.
    OSError
        If the file cannot be written.
    """
    write_whole(path, encode_lobes(tree))


# ---------------------------------------------------------------------------------------------- header


def _assemble(tree: ClusterTree, flags: int, exponent: int, body: bytes) -> bytes:
    species = _species_bytes(tree.species)
    clusters = tree.clusters
    allometry = tree.allometry
    size = HEADER.size + len(species) + len(body) + CHECKSUM.size
    if size > DEFAULT_LIMITS.n_bytes:
        raise TreeError(f"a .lobes file must be at most {DEFAULT_LIMITS.n_bytes} bytes long, got {size}")
    head = HEADER.pack(
        MAGIC,
        VERSION,
        flags,
        size,
        tree.graph.n_nodes,
        len(clusters),
        sum(len(cluster.vertices) for cluster in clusters),
        sum(len(cluster.faces) for cluster in clusters),
        sum(len(cluster.seed) for cluster in clusters),
        tree.epsg or 0,
        exponent,
        len(species),
        *tree.origin,
        allometry.beta,
        allometry.gamma,
        allometry.f_s,
        allometry.d_root if allometry.d_root > 0.0 else float("nan"),
    )
    data = head + species + body
    return data + CHECKSUM.pack(zlib.crc32(data))


def _species_bytes(species: str | None) -> bytes:
    try:
        name = (species or "").encode("utf-8")
    except UnicodeEncodeError as error:
        raise TreeError(f"species must be valid Unicode text, got {species!r}") from error
    if len(name) > 255:
        raise TreeError(f"species must take at most 255 bytes in UTF-8, got {len(name)}")
    return name


def _check_sizes(tree: ClusterTree) -> None:
    for name, count in (
        ("n_nodes", tree.graph.n_nodes),
        ("n_clusters", len(tree.clusters)),
        ("n_vertices", sum(len(cluster.vertices) for cluster in tree.clusters)),
        ("n_faces", sum(len(cluster.faces) for cluster in tree.clusters)),
        ("n_seeds", sum(len(cluster.seed) for cluster in tree.clusters)),
    ):
        limit = getattr(DEFAULT_LIMITS, name)
        if count > limit:
            raise TreeError(
                f"{name} must be at most {limit} in a .lobes file, got {count}; simplify the tree"
            )


def _read_header(data: bytes, limits: LobesLimits) -> tuple[_Header, bytes]:
    if not data.startswith(MAGIC):
        raise FormatError(f"a .lobes file must begin with {MAGIC!r}, got {data[: len(MAGIC)]!r}")
    if len(data) > limits.n_bytes:
        raise FormatError(
            f"a .lobes file must be at most {limits.n_bytes} bytes long, got {len(data)} or more"
        )
    if len(data) < HEADER.size + CHECKSUM.size:
        raise FormatError(
            f"a .lobes file must be at least {HEADER.size + CHECKSUM.size} bytes long, got {len(data)}; "
            "it has been cut short"
        )
    values = HEADER.unpack_from(data)
    version, flags, size = values[1:4]
    if version != VERSION:
        raise FormatError(
            f"the file must be of version {VERSION}, got {version}; read it with a newer Sapwood"
        )
    if size != len(data):
        raise FormatError(f"the file must be {size} bytes long by its header, got {len(data)}; it is damaged")
    stored = CHECKSUM.unpack_from(data, size - CHECKSUM.size)[0]
    actual = zlib.crc32(data[: -CHECKSUM.size])
    if stored != actual:
        raise FormatError(
            f"the checksum must be {actual:08x} for these bytes, got {stored:08x}; the file is damaged"
        )
    counts = dict(
        zip(("n_nodes", "n_clusters", "n_vertices", "n_faces", "n_seeds"), values[4:9], strict=True)
    )
    _check_declared(flags, counts, values[10], limits)
    body_at = HEADER.size + values[11]
    if body_at > size - CHECKSUM.size:
        raise FormatError(f"the name of the species must end within the file, got {values[11]} bytes")
    header = _Header(
        flags=flags,
        **counts,
        epsg=values[9],
        exponent=values[10],
        origin=values[12:15],
        allometry=values[15:19],
        species=_species_text(data[HEADER.size : body_at]),
    )
    return header, data[body_at : -CHECKSUM.size]


def _check_declared(flags: int, counts: dict[str, int], exponent: int, limits: LobesLimits) -> None:
    if flags & ~HAS_MEASURED:
        raise FormatError(f"the flags must be 0 or {HAS_MEASURED}, got {flags}; the file is damaged")
    for name, count in counts.items():
        limit = getattr(limits, name)
        if count > limit:
            raise FormatError(
                f"{name} must be at most {limit}, got {count}; the file is damaged or too large"
            )
    if counts["n_nodes"] == 0:
        raise FormatError("a tree must have at least one node, got 0; the file is damaged")
    if not COARSEST <= exponent <= FINEST:
        raise FormatError(
            f"the exponent of the grid must be {COARSEST} to {FINEST}, got {exponent}; the file is damaged"
        )


def _species_text(name: bytes) -> str | None:
    try:
        return name.decode("utf-8") or None
    except UnicodeDecodeError as error:
        raise FormatError(f"the name of the species must be UTF-8, got {name!r}") from error


# ----------------------------------------------------------------------------------------------- graph


def _position_exponent(position: NDArray[np.float64]) -> int:
    """Smallest exponent whose grid the tree spans with enough steps, also after rounding to that grid."""
    reach = float(np.abs(position).max())
    exponent = _exponent_for(reach)
    while exponent > COARSEST:
        again = _exponent_for(round(reach * 2.0**exponent) * 2.0**-exponent)
        if again == exponent:
            break
        exponent = again
    return exponent


def _exponent_for(reach: float) -> int:
    for exponent in range(COARSEST, FINEST + 1):
        if reach >= FEWEST_STEPS * 2.0**-exponent:
            return exponent
    return COARSEST


def _to_grid(coordinates: NDArray[np.float64], exponent: int, name: str) -> NDArray[np.int64]:
    bad = np.flatnonzero((np.abs(coordinates) >= np.ldexp(MAX_STEPS - 0.5, -exponent)).any(axis=1))
    if bad.size:
        raise TreeError(
            f"{name} must lie within {MAX_STEPS >> exponent} m of the origin along each axis, "
            f"but {name}[{bad[0]}] is {coordinates[bad[0]]}; {bad.size} of {len(coordinates)} break this. "
            "Move the tree with transform() and put the shift into origin."
        )
    return np.rint(np.ldexp(coordinates, exponent)).astype(np.int64)


def _first_difference(parent: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Each node's value less its parent's; a root keeps its own."""
    rooted = np.concatenate([values, np.zeros_like(values[:1])])
    return values - rooted[parent]


def _position_residual(parent: NDArray[np.int64], grid: NDArray[np.int64]) -> NDArray[np.int64]:
    """Segments; within a chain the change from the segment before."""
    segment = _first_difference(parent, grid)
    residual = segment.copy()
    chained = np.flatnonzero(parent[1:] == np.arange(len(parent) - 1)) + 1
    residual[chained] -= segment[chained - 1]
    return residual


def _pack_measured(measured: NDArray[Any]) -> bytes:
    if measured.dtype != np.bool_ or measured.ndim != 1:
        raise TreeError(
            f"attribute 'measured' must be one bool per node, got dtype {measured.dtype} "
            f"and shape {measured.shape}"
        )
    return codec.pack_bits(measured)


def _radius_code(radius: NDArray[np.float64], exponent: int) -> NDArray[np.int64]:
    """0 for unknown; else 1 and a number that is linear for thin, logarithmic for thick branches."""
    known = ~np.isnan(radius)
    largest = np.ldexp(511.0, 19 - exponent - RADIUS_FINER)
    bad = np.flatnonzero(known & (radius > largest))
    if bad.size:
        raise TreeError(
            f"radius must be at most {largest:g} m in a .lobes file, but radius[{bad[0]}] is "
            f"{radius[bad[0]]}; {bad.size} of {radius.size} nodes break this"
        )
    steps = np.ldexp(np.where(known, radius, 0.0), exponent + RADIUS_FINER)
    shift = np.maximum(np.frexp(steps)[1].astype(np.int64) - 1 - RADIUS_BITS, 0)
    code = (shift << RADIUS_BITS) + np.rint(np.ldexp(steps, -shift)).astype(np.int64)
    code = np.maximum(code, (steps > 0.0).astype(np.int64))
    return np.where(known, code + 1, 0)


def _read_parents(sections: dict[str, bytes], n: int) -> NDArray[np.int64]:
    is_start = codec.unpack_bits(sections["starts"], n, "starts")
    start = np.flatnonzero(is_start)
    jump = codec.unpack_planes(sections["jumps"], start.size, "jumps")
    bad = np.flatnonzero((jump < 1) | (jump > start))
    if bad.size:
        i = start[bad[0]]
        raise FormatError(
            f"node {i} must go back 1 to {i} nodes to its parent, got {jump[bad[0]]}; the file is damaged"
        )
    parent = np.arange(-1, n - 1)
    parent[start] -= jump
    return parent


def _sum_from_root(parent: NDArray[np.int64], values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sum of the values on the path from the root to each node, by doubling the reach of every node.

    O(n log(depth)); overflow wraps and is caught by the caller's check of the range.
    """
    total = np.concatenate([values, np.zeros_like(values[:1])])
    ancestor = np.concatenate([parent, [NO_PARENT]])
    while (ancestor >= 0).any():
        total = total + total[ancestor]
        ancestor = ancestor[ancestor]
    return total[:-1]


def _read_positions(raw: bytes, parent: NDArray[np.int64]) -> NDArray[np.int64]:
    n = parent.size
    residual = codec.unzigzag(codec.unpack_planes(raw, 3 * n, "positions")).reshape(3, n).T
    # Within a chain residuals add up to segments: sum over all nodes, less the sum before the chain.
    total = np.cumsum(residual, axis=0)
    is_start = parent != np.arange(-1, n - 1)
    is_start[0] = True
    start = np.flatnonzero(is_start)[np.cumsum(is_start) - 1]
    segment = total - total[start] + residual[start]
    grid = _sum_from_root(parent, segment)
    bad = np.flatnonzero((np.abs(grid) >= MAX_STEPS).any(axis=1))
    if bad.size:
        raise FormatError(
            f"coordinates must be less than {MAX_STEPS} steps, but node {bad[0]} is at {grid[bad[0]]}; "
            "the file is damaged"
        )
    return grid


def _read_radii(raw: bytes, parent: NDArray[np.int64], exponent: int) -> NDArray[np.float64]:
    change = codec.unzigzag(codec.unpack_planes(raw, parent.size, "radii"))
    code = _sum_from_root(parent, change)
    bad = np.flatnonzero((code < 0) | (code > MAX_RADIUS_CODE + 1))
    if bad.size:
        raise FormatError(
            f"the code of a radius must be 0 to {MAX_RADIUS_CODE + 1}, but node {bad[0]} has {code[bad[0]]}; "
            "the file is damaged"
        )
    code, known = np.maximum(code - 1, 0), code > 0
    shift = np.maximum((code >> RADIUS_BITS) - 1, 0)
    steps = (code - (shift << RADIUS_BITS)) << shift
    return np.where(known, np.ldexp(steps, -exponent - RADIUS_FINER), np.nan)


def _read_measured(raw: bytes, header: _Header) -> dict[str, NDArray[np.bool_]]:
    if not header.flags & HAS_MEASURED:
        return {}
    return {"measured": codec.unpack_bits(raw, header.n_nodes, "measured")}


# -------------------------------------------------------------------------------------------- clusters


@dataclass(frozen=True)
class _Hull:
    row: NDArray[np.int64]
    symbols: bytes
    names: bytes
    residual: NDArray[np.int64]


def _concatenate(parts: list[NDArray[Any]]) -> NDArray[np.int64]:
    return np.concatenate([np.zeros(0, np.int64), *parts]).astype(np.int64)


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
    return grid[seed[0]] << finer if finer >= 0 else grid[seed[0]] >> -finer


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
    coarsest = _to_grid(vertices, exponent, name)
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
    if cluster.n_points >= 1 << 32:
        raise TreeError(f"clusters[{k}].n_points must be less than 2**32, got {cluster.n_points}")
    if np.isnan(cluster.density):
        return UNKNOWN_DENSITY
    bits = int(np.float32(abs(cluster.density)).view(np.uint32))
    half = 1 << (DENSITY_DROPPED - 1)
    return (bits + half) >> DENSITY_DROPPED


def _read_clusters(
    sections: dict[str, bytes], header: _Header, grid: NDArray[np.int64]
) -> tuple[Cluster, ...]:
    rows = _read_table(sections["clusters"], header)
    code = rows[:, 5]
    density = np.where(code == UNKNOWN_DENSITY, 0, code << DENSITY_DROPPED).astype(np.uint32).view(np.float32)
    per_m3 = np.where(code == UNKNOWN_DENSITY, np.nan, density.astype(float))
    seed = _read_seeds(sections["seeds"], header)
    flat = codec.unzigzag(codec.unpack_planes(sections["vertices"], 3 * header.n_vertices, "vertices"))
    residual = flat.reshape(3, header.n_vertices)
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
                vertices=np.ldexp(steps, HULL_COARSER - header.exponent - level),
                faces=np.array(faces, np.int32).reshape(-1, 3),
                seed=seeds,
                density=per_m3[k],
                n_points=n_points,
            )
        )
    reader.finish()
    return tuple(clusters)


def _read_table(raw: bytes, header: _Header) -> NDArray[np.int64]:
    """One row for each cluster, checked against the header."""
    n = header.n_clusters
    rows = codec.unpack_planes(raw, CLUSTER_COLUMNS * n, "clusters").reshape(CLUSTER_COLUMNS, n).T
    declared = header.n_vertices, header.n_faces, header.n_seeds
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


def _read_seeds(raw: bytes, header: _Header) -> NDArray[np.int32]:
    seed = np.cumsum(codec.unzigzag(codec.unpack_planes(raw, header.n_seeds, "seeds")))
    bad = np.flatnonzero((seed < 0) | (seed >= header.n_nodes))
    if bad.size:
        raise FormatError(
            f"seeds must be nodes of the graph (0 to {header.n_nodes - 1}), got {seed[bad[0]]}; "
            "the file is damaged"
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
