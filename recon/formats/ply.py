"""PLY: ASCII and binary of either byte order.

The header is checked against the size of the file before anything is allocated: a file that
declares 10^12 points or stops half way is refused or read as far as it goes, and says so.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from recon.formats.columns import ColumnMap, chunk_of, map_columns
from treegraph.errors import FormatError, InputError

MAX_HEADER = 1 << 20  # bytes
TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
    "int64": "i8", "long": "i8", "uint64": "u8", "ulong": "u8",
}  # fmt: skip
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Element:
    """One element of the header: its name, count and properties (name, type, type of a list's length)."""

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)

    def has_list(self) -> bool:
        """Whether rows differ in size."""
        return any(length for _, _, length in self.properties)

    def dtype(self, order: str) -> np.dtype:
        """Layout of one row; names are made unique, as some writers repeat them."""
        return np.dtype([(f"p{i}", order + kind) for i, (_, kind, _) in enumerate(self.properties)])


def is_ply(head: bytes) -> bool:
    """Whether a file that begins with `head` is a PLY file."""
    return head[:3] == b"ply" and head[3:4] in (b"\n", b"\r", b" ")


def open_ply(path: str, *, as_points: bool = False) -> Source:
    """Open a PLY file; the points are the element "vertex".

    Raises
    ------
    FormatError
        For a broken header or missing vertices.
    InputError
        For a mesh, unless `as_points`.
    """
    with open(path, "rb") as file:
        order, elements, start = _read_header(file, path)
    vertex = next((e for e in elements if e.name.lower() in ("vertex", "vertices", "point", "points")), None)
    if vertex is None:
        listed = ", ".join(f"{e.name} ({e.count})" for e in elements) or "nothing"
        raise FormatError(
            f"{path}: this PLY has no vertices, only {listed}. Export the scan's points as PLY, LAS or text."
        )
    if vertex.count == 0:
        raise FormatError(
            f"{path}: this PLY declares no points (element {vertex.name} 0). Export the scan again."
        )
    faces = sum(e.count for e in elements if e.name.lower() in ("face", "faces", "tristrips"))
    if faces and not as_points:
        raise InputError(
            f"{path}: this PLY is a mesh of {faces} faces, not a scan. Give a point cloud, "
            "or read its vertices with as_points=True (--as-points)."
        )
    columns = map_columns([name for name, _, _ in vertex.properties])
    if columns.xyz is None:
        raise FormatError(
            f"{path}: the PLY vertices have no x, y and z, only "
            f"{', '.join(p[0] for p in vertex.properties) or 'nothing'}."
        )
    source = Source(iter(()), names=dict(columns.names))
    if faces:
        source.notes.append(f"the vertices of a mesh of {faces} faces were read as points")
    read = _ascii_chunks if order == "" else _binary_chunks
    source.chunks = read(path, order, elements, vertex, start, columns, source.notes)
    return source


def _read_header(file: BinaryIO, path: str) -> tuple[str, list[Element], int]:
    head = file.read(MAX_HEADER)
    end = head.find(b"end_header")
    if end < 0:
        raise FormatError(
            f"{path}: the PLY header has no end_header line; the file is damaged or cut off. Export it again."
        )
    stop = end + len(b"end_header")
    if head[stop : stop + 1] == b" ":
        stop = len(head) if head.find(b"\n", stop) < 0 else head.find(b"\n", stop)
    if head[stop : stop + 2] == b"\r\n":
        stop += 2
    elif head[stop : stop + 1] in (b"\n", b"\r"):
        stop += 1
    order: str | None = None
    elements: list[Element] = []
    for line in head[:end].decode("latin-1").splitlines():
        words = line.split()
        if not words or words[0] in ("ply", "comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) > 1 and words[1] in FORMATS:
            order = FORMATS[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,18}", words[2]):
            elements.append(Element(words[1], int(words[2])))
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_property(words, path))
        else:
            raise FormatError(
                f"{path}: the PLY header has a line that is not understood: {line.strip()[:60]!r}."
            )
    if order is None:
        raise FormatError(
            f"{path}: the PLY header does not say ascii, binary_little_endian or binary_big_endian."
        )
    return order, elements, stop


def _property(words: list[str], path: str) -> tuple[str, str, str]:
    if len(words) == 3 and words[1] in TYPES:
        return words[2], TYPES[words[1]], ""
    if len(words) == 5 and words[1] == "list" and words[2] in TYPES and words[3] in TYPES:
        return words[4], TYPES[words[3]], TYPES[words[2]]
    raise FormatError(f"{path}: the PLY header has a property of unknown type: {' '.join(words)[:60]!r}.")


def _binary_chunks(
    path: str,
    order: str,
    elements: list[Element],
    vertex: Element,
    start: int,
    columns: ColumnMap,
    notes: list[str],
) -> Iterator[Chunk]:
    if vertex.has_list():
        raise FormatError(
            f"{path}: the PLY vertices hold lists, which a scan does not. Export plain x y z properties."
        )
    size = os.path.getsize(path)
    with open(path, "rb") as file:
        file.seek(start)
        for element in elements:
            if element is vertex:
                break
            _skip_binary(file, element, order, size, path)
        dtype = vertex.dtype(order)
        there = min(vertex.count, (size - file.tell()) // dtype.itemsize)
        if there < vertex.count:
            if there <= 0:
                raise FormatError(
                    f"{path}: the PLY declares {vertex.count} points and holds none; it is cut off. "
                    "Copy it again."
                )
            notes.append(
                f"the file declares {vertex.count} points and ends after {there}: it is cut off; "
                "those there were read"
            )
        for begin in range(0, there, CHUNK):
            rows = np.fromfile(file, dtype, min(CHUNK, there - begin))
            yield chunk_of(columns, lambda i: rows[f"p{i}"].astype(dtype[i].newbyteorder("="), copy=False))  # noqa: B023


def _skip_binary(file: BinaryIO, element: Element, order: str, size: int, path: str) -> None:
    """Step over an element that stands before the vertices."""
    if not element.has_list():
        file.seek(min(file.tell() + element.count * element.dtype(order).itemsize, size))
        return
    for _ in range(element.count):
        for _, kind, length in element.properties:
            n = 1
            if length:
                count = np.fromfile(file, order + length, 1)
                n = int(count[0]) if count.size and np.isfinite(count[0]) else -1
            if n < 0 or file.tell() + n * np.dtype(kind).itemsize > size:
                raise FormatError(
                    f"{path}: the PLY is cut off or damaged in element {element.name}. Export it again."
                )
            file.seek(n * np.dtype(kind).itemsize, os.SEEK_CUR)


def _ascii_chunks(
    path: str,
    order: str,
    elements: list[Element],
    vertex: Element,
    start: int,
    columns: ColumnMap,
    notes: list[str],
) -> Iterator[Chunk]:
    from recon.formats.text import Layout, parse_rows

    if vertex.has_list():
        raise FormatError(
            f"{path}: the PLY vertices hold lists, which a scan does not. Export plain x y z properties."
        )
    skip = sum(e.count for e in elements[: elements.index(vertex)])
    layout = Layout(delimiter=" ", decimal=".", columns=columns, n_columns=len(vertex.properties))
    seen = 0
    for chunk in parse_rows(path, layout, start=start, skip_lines=skip, max_rows=vertex.count, notes=notes):
        seen += len(chunk.xyz)
        yield chunk
    if seen < vertex.count:
        if seen == 0:
            raise FormatError(
                f"{path}: the PLY declares {vertex.count} points and holds none; it is cut off. "
                "Copy it again."
            )
        notes.append(
            f"the file declares {vertex.count} points and ends after {seen}: it is cut off; those "
            "there were read"
        )
