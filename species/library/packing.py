"""What is derived of a species as one file: branchlets and pictures, packed; read without trust.

Layout, little-endian: ``SAPTWIGS``, a byte of version, SHA-256 (32 bytes) of the species' definition, SHA-256
of what follows, then a table of sizes and the sections, each a zstd frame where that is smaller. The first
section is JSON: counts, ranges and the sizes of the pictures.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from species.foliage import LeafSet
from species.library.branchlets import MOST_LEAVES, MOST_NODES, Branchlet
from species.library.definition import MOST_BRANCHLETS
from treegraph import TreeGraph
from treegraph._lobes_bytes import (
    _decompress,
    join_sections,
    pack_planes,
    read_varint,
    split_sections,
    unpack_planes,
    unzigzag,
    zigzag,
)
from treegraph.errors import FormatError, InputError

__all__ = ["MOST_BYTES", "PICTURES", "Packed", "pack_species", "unpack_species"]

MAGIC = b"SAPTWIGS"
VERSION = 1
HEAD = len(MAGIC) + 1 + 32 + 32
MOST_BYTES = 4_000_000
MOST_HEADER = 100_000
MOST_PICTURE = 1_000_000
PICTURES = ("leaf_spring", "leaf_summer", "leaf_autumn", "leaf_winter", "leaf_normal", "bark", "bark_normal")
GRID = 16383  # steps of a coordinate in the extent of its branchlet
LOGS = 4095  # steps of a logarithm
TURNS = 1023  # steps of a direction's coordinate or angle
LOG_RADIUS = (math.log(1e-5), math.log(1.0))
LOG_LENGTH = (math.log(1e-4), math.log(10.0))
SECTIONS = {  # bytes that a section holds for each node or leaf at most
    "parent": ("nodes", 2),
    "order": ("nodes", 2),
    "position": ("nodes", 6),
    "radius": ("nodes", 2),
    "base": ("leaves", 6),
    "along": ("leaves", 4),
    "turn": ("leaves", 2),
    "length": ("leaves", 2),
    "node": ("leaves", 2),
}


@dataclass(frozen=True, eq=False)
class Packed:
    """What a file holds.

    Attributes
    ----------
    key : str
        SHA-256 of the definition that it was made from, hexadecimal.
    branchlets : tuple of Branchlet
    pictures : dict of str to bytes
        WebP files by the names of :data:`PICTURES`; those of seasons without leaves are left out.
    leaf_box : (float, float, float, float)
        Left, bottom, right and top of the leaf's pictures in the leaf's frame, metres.
    bark_tile : float
        Metres of stem that the bark's pictures cover.
    """

    key: str
    branchlets: tuple[Branchlet, ...]
    pictures: dict[str, bytes]
    leaf_box: tuple[float, float, float, float]
    bark_tile: float


def pack_species(
    key: str,
    branchlets: Sequence[Branchlet],
    pictures: Mapping[str, bytes],
    leaf_box: Sequence[float],
    bark_tile: float,
) -> bytes:
    """Pack branchlets and pictures; see :class:`Packed`.

    Returns
    -------
    data : bytes
        The same for the same input. Positions are right to half of 1/16383 of the branchlet's extent, lengths
        and radii to 0.15%, directions to 0.25 degrees, how leaves are turned about them to 0.2 degrees.
    """
    width_share = [float(b.leaves.width[0] / b.leaves.length[0]) for b in branchlets]
    header: dict[str, Any] = {
        "branchlets": [
            {
                "nodes": b.graph.n_nodes,
                "leaves": b.leaves.n_leaves,
                "size": b.size,
                "slope_deg": b.slope_deg,
                "width_share": share,
                **_extent(b),
            }
            for b, share in zip(branchlets, width_share, strict=True)
        ],
        "leaf_box": [float(side) for side in leaf_box],
        "bark_tile": float(bark_tile),
        "pictures": {name: len(pictures[name]) for name in PICTURES if name in pictures},
    }
    columns: dict[str, list[NDArray[np.int64]]] = {name: [] for name in SECTIONS}
    for branchlet in branchlets:
        for name, values in _columns(branchlet).items():
            columns[name].append(values)
    sections = [json.dumps(header, separators=(",", ":"), sort_keys=True).encode()]
    sections += [pack_planes(np.concatenate(columns[name], axis=None)) for name in SECTIONS]
    sections += [pictures[name] for name in PICTURES if name in pictures]
    body = join_sections(sections)
    digest = hashlib.sha256(body).digest()
    return MAGIC + bytes([VERSION]) + bytes.fromhex(key) + digest + body


def unpack_species(data: bytes) -> Packed:
    """Undo :func:`pack_species`.

    Raises
    ------
    FormatError
        If it is no such file, of another version, or damaged; nothing is allocated that the file has no
        bytes for.
    """
    if len(data) > MOST_BYTES:
        raise FormatError(f"a species' derived file has at most {MOST_BYTES} bytes, got {len(data)}")
    if data[: len(MAGIC)] != MAGIC or len(data) < HEAD:
        raise FormatError(f"not a file of a species' branchlets: it must begin with {MAGIC!r}")
    if data[len(MAGIC)] != VERSION:
        raise FormatError(f"version {data[len(MAGIC)]} is not known; this reads version {VERSION}")
    key, digest = data[len(MAGIC) + 1 : HEAD - 32].hex(), data[HEAD - 32 : HEAD]
    body = data[HEAD:]
    if hashlib.sha256(body).digest() != digest:
        raise FormatError("the checksum does not fit; the file is damaged")
    header = _header(body)
    n_nodes = sum(entry["nodes"] for entry in header["branchlets"])
    n_leaves = sum(entry["leaves"] for entry in header["branchlets"])
    count = {"nodes": n_nodes, "leaves": n_leaves}
    limits = {"header": MOST_HEADER, **{name: count[per] * most for name, (per, most) in SECTIONS.items()}}
    sections = split_sections(body, limits | header["pictures"])
    for name, size in header["pictures"].items():
        if len(sections[name]) != size:
            raise FormatError(f"picture {name!r} must have {size} bytes; the file is damaged")
    each = {"position": 3, "base": 3, "along": 2}
    columns = {
        name: unpack_planes(sections[name], count[per] * each.get(name, 1), name)
        for name, (per, _) in SECTIONS.items()
    }
    try:
        branchlets = _branchlets(header["branchlets"], columns)
    except (InputError, ValueError, IndexError) as error:
        raise FormatError(f"the branchlets are no trees ({error}); the file is damaged") from None
    pictures = {name: sections[name] for name in header["pictures"]}
    return Packed(key, branchlets, pictures, header["leaf_box"], header["bark_tile"])


def _header(body: bytes) -> dict[str, Any]:
    """The first section, every value checked."""
    raw_size, at = read_varint(body, 0, "the table of sections")
    size, _ = read_varint(body, at, "the table of sections")
    if raw_size > MOST_HEADER or size > raw_size:
        raise FormatError(f"the header must hold at most {MOST_HEADER} bytes; the file is damaged")
    first = _start_of_sections(body)
    raw = body[first : first + size]
    raw = raw if size == raw_size else _decompress(raw, raw_size, "header")
    try:
        header = json.loads(raw)
        entries = [_entry(entry) for entry in header["branchlets"]]
        box = tuple(_number(side, -20.0, 20.0) for side in header["leaf_box"])
        tile = _number(header["bark_tile"], 0.001, 100.0)
        found = dict(header["pictures"])
        sizes = {name: _count(found[name], 1, MOST_PICTURE) for name in PICTURES if name in found}
        good = 1 <= len(entries) <= MOST_BRANCHLETS and len(sizes) == len(found)
        if not (good and len(box) == 4 and box[0] < 0.0 < box[2] and box[1] < box[3]):
            raise ValueError("counts, names or sizes out of their range")
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise FormatError(f"the header is wrong ({error}); the file is damaged") from None
    return {"branchlets": entries, "leaf_box": box, "bark_tile": tile, "pictures": sizes}


def _start_of_sections(body: bytes) -> int:
    """Where the bodies begin: their sizes add up to the rest of the file."""
    at = total = 0
    for _ in range(1 + len(SECTIONS) + len(PICTURES)):
        if at + total >= len(body):
            break
        _, at = read_varint(body, at, "the table of sections")
        size, at = read_varint(body, at, "the table of sections")
        total += size
    if at + total != len(body):
        raise FormatError("the sections must fill the file; the file is damaged")
    return at


def _entry(entry: Mapping[str, Any]) -> dict[str, Any]:
    low = [_number(value, -1e3, 1e3) for value in entry["low"]]
    if len(low) != 3:
        raise ValueError("low must be three numbers")
    return {
        "nodes": _count(entry["nodes"], 2, MOST_NODES),
        "leaves": _count(entry["leaves"], 1, MOST_LEAVES),
        "low": np.array(low),
        "extent": _number(entry["extent"], 1e-6, 1e3),
        "size": _number(entry["size"], 0.0, 1e3),
        "slope_deg": _number(entry["slope_deg"], -90.0, 90.0),
        "width_share": _number(entry["width_share"], 1e-6, 1e4),
    }


def _number(value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{str(value)[:40]!r} is not a number from {low:g} to {high:g}")
    return float(value)


def _count(value: Any, low: int, high: int) -> int:
    if not isinstance(value, int):
        raise ValueError(f"{str(value)[:40]!r} is not a whole number")
    return int(_number(value, low, high))


def _extent(branchlet: Branchlet) -> dict[str, Any]:
    points = np.concatenate([branchlet.graph.position, branchlet.leaves.base])
    low = points.min(axis=0)
    return {"low": low.tolist(), "extent": max(float((points - low).max()), 1e-6)}


def _columns(branchlet: Branchlet) -> dict[str, NDArray[np.int64]]:
    graph, leaves, extent = branchlet.graph, branchlet.leaves, _extent(branchlet)

    def placed(points: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.rint((points - extent["low"]) / extent["extent"] * GRID).astype(np.int64)

    index = np.arange(graph.n_nodes)
    position = placed(graph.position)
    before = np.where(index[:, None] > 0, position[np.maximum(graph.parent, 0)], 0)
    return {
        "parent": (index - np.maximum(graph.parent, 0)).astype(np.int64),
        "order": np.asarray(graph.attribute["order"], np.int64),
        "position": zigzag((position - before).T),
        "radius": _log_steps(graph.radius, LOG_RADIUS),
        "base": zigzag((placed(leaves.base) - position[leaves.node]).T),
        "along": _to_octahedron(leaves.along).T,
        "turn": _turn_of(leaves),
        "length": _log_steps(leaves.length, LOG_LENGTH),
        "node": leaves.node.astype(np.int64),
    }


def _branchlets(
    entries: Sequence[Mapping[str, Any]], columns: Mapping[str, NDArray[np.int64]]
) -> tuple[Branchlet, ...]:
    out, node, leaf = [], 0, 0
    for entry in entries:
        n, m = entry["nodes"], entry["leaves"]
        mine = slice(node, node + n), slice(leaf, leaf + m)
        parent = np.arange(n) - columns["parent"][mine[0]]
        if not ((parent[1:] >= 0) & (parent[1:] < np.arange(1, n))).all():
            raise ValueError("a parent does not come before its child")
        parent[0] = -1
        its = columns["node"][mine[1]]
        if (its >= n).any():
            raise ValueError("a leaf hangs on a node that is not there")
        place = unzigzag(columns["position"][3 * node : 3 * (node + n)]).reshape(3, n).T.copy()
        for i in range(1, n):
            place[i] += place[parent[i]]
        base = unzigzag(columns["base"][3 * leaf : 3 * (leaf + m)]).reshape(3, m).T + place[its]
        along = _from_octahedron(columns["along"][2 * leaf : 2 * (leaf + m)].reshape(2, m).T)
        length = _from_log(columns["length"][mine[1]], LOG_LENGTH)
        graph = TreeGraph(
            parent.astype(np.int32),
            entry["low"] + entry["extent"] * place / GRID,
            _from_log(columns["radius"][mine[0]], LOG_RADIUS),
            {"order": columns["order"][mine[0]].astype(np.int32)},
        )
        leaves = LeafSet(
            entry["low"] + entry["extent"] * base / GRID,
            along,
            _normal_of(along, columns["turn"][mine[1]]),
            length,
            entry["width_share"] * length,
            its.astype(np.int32),
        )
        out.append(Branchlet(graph, leaves, entry["size"], entry["slope_deg"]))
        node, leaf = node + n, leaf + m
    return tuple(out)


def _log_steps(value: NDArray[np.float64], log_range: tuple[float, float]) -> NDArray[np.int64]:
    low, high = log_range
    share = (np.log(np.maximum(value, 1e-300)) - low) / (high - low)
    return np.rint(np.clip(share, 0.0, 1.0) * LOGS).astype(np.int64)


def _from_log(steps: NDArray[np.int64], log_range: tuple[float, float]) -> NDArray[np.float64]:
    low, high = log_range
    return np.exp(low + (high - low) * np.minimum(steps, LOGS) / LOGS)


def _to_octahedron(unit: NDArray[np.float64]) -> NDArray[np.int64]:
    """Unit vectors (m, 3) as two whole numbers from 0 to TURNS: the octahedron folded flat."""
    x, y, z = (unit / np.abs(unit).sum(axis=1, keepdims=True)).T
    lower = z < 0.0
    folded_x = np.where(lower, (1.0 - np.abs(y)) * np.where(x >= 0.0, 1.0, -1.0), x)
    folded_y = np.where(lower, (1.0 - np.abs(x)) * np.where(y >= 0.0, 1.0, -1.0), y)
    flat = np.column_stack([folded_x, folded_y])
    return np.rint((flat + 1.0) * 0.5 * TURNS).astype(np.int64)


def _from_octahedron(steps: NDArray[np.int64]) -> NDArray[np.float64]:
    x, y = (np.minimum(steps, TURNS) / TURNS * 2.0 - 1.0).T
    z = 1.0 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0.0)
    unit = np.column_stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z])
    return unit / np.linalg.norm(unit, axis=1, keepdims=True)


def _across(along: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors across each direction and across each other."""
    helper = np.where(np.abs(along[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    side = np.cross(along, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(side, along)


def _turn_of(leaves: LeafSet) -> NDArray[np.int64]:
    side, other = _across(_from_octahedron(_to_octahedron(leaves.along)))  # those that the reader will have
    normal = leaves.normal
    angle = np.arctan2(np.einsum("ij,ij->i", normal, other), np.einsum("ij,ij->i", normal, side))
    return np.rint(angle / (2.0 * np.pi) % 1.0 * TURNS).astype(np.int64)


def _normal_of(along: NDArray[np.float64], steps: NDArray[np.int64]) -> NDArray[np.float64]:
    side, other = _across(along)
    angle = 2.0 * np.pi * np.minimum(steps, TURNS)[:, None] / TURNS
    return np.cos(angle) * side + np.sin(angle) * other
