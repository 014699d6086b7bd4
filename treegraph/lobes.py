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
from treegraph._files import write_whole
from treegraph._lobes_graph import (
    COARSEST,
    FINEST,
    encode_graph,
    position_exponent,
    read_parents,
    read_positions,
    read_radii,
    to_grid,
)
from treegraph._lobes_hulls import CLUSTER_COLUMNS, encode_clusters, read_clusters
from treegraph.allometry import Allometry
from treegraph.clustertree import ClusterTree
from treegraph.errors import FormatError, InputError, TreeError
from treegraph.graph import TreeGraph

__all__ = ["LobesLimits", "decode_lobes", "encode_lobes", "read_lobes", "write_lobes"]

MAGIC = b"\x89LOBES\r\n"
VERSION = 1
HEADER = struct.Struct("<8sHHIIIIIIIBB3d4d")
"""Magic, version, flags, file size, nodes, clusters, vertices, faces, seeds, EPSG, exponent, bytes of the
species, origin, and beta, gamma, f_s, d_root."""
CHECKSUM = struct.Struct("<I")
HAS_MEASURED = 1
"""Flag: the section ``measured`` has a bit for each node."""


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

    def cluster_counts(self) -> tuple[int, int, int, int]:
        """Clusters, vertices, faces, seeds."""
        return self.n_clusters, self.n_vertices, self.n_faces, self.n_seeds

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
        If the tree is larger than the format allows (:class:`LobesLimits`), lies more than a
        million kilometres from its origin, or ``measured`` is not one bool per node.

    Notes
    -----
    The order of the nodes is kept. Positions move by at most 0.49 mm along each axis, radii by at most
    0.13 mm (0.2 % above 125 mm; a positive radius stays positive), hull vertices by at most 8 mm along
    each axis, densities by 0.002 %. The faces of a hull come back in another order, and its vertices with
    other numbers; which vertices a face joins does not change. Trees that reach less than half a metre from
    their origin get proportionally finer grids.
    """
    graph = tree.graph
    _check_sizes(tree)
    exponent = position_exponent(graph.position)
    grid = to_grid(graph.position, exponent, "position")
    flags, measured = 0, b""
    if "measured" in graph.attribute:
        flags, measured = HAS_MEASURED, _pack_measured(graph.attribute["measured"])
    sections = [
        *encode_graph(graph.parent, grid, graph.radius, exponent),
        measured,
        *encode_clusters(tree.clusters, grid, exponent),
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
    parent = read_parents(sections["starts"], sections["jumps"], header.n_nodes)
    grid = read_positions(sections["positions"], parent)
    try:
        graph = TreeGraph(
            parent.astype(np.int32),
            np.ldexp(grid, -header.exponent),
            read_radii(sections["radii"], parent, header.exponent),
            _read_measured(sections["measured"], header),
        )
        return ClusterTree(
            graph=graph,
            clusters=read_clusters(sections, header.cluster_counts(), grid, header.exponent),
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


def _pack_measured(measured: NDArray[Any]) -> bytes:
    if measured.dtype != np.bool_ or measured.ndim != 1:
        raise TreeError(
            f"attribute 'measured' must be one bool per node, got dtype {measured.dtype} "
            f"and shape {measured.shape}"
        )
    return codec.pack_bits(measured)


def _read_measured(raw: bytes, header: _Header) -> dict[str, NDArray[np.bool_]]:
    if not header.flags & HAS_MEASURED:
        return {}
    return {"measured": codec.unpack_bits(raw, header.n_nodes, "measured")}
