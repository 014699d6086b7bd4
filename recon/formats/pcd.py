"""PCD of the Point Cloud Library: ascii, binary and binary_compressed.

Based on: "The PCD (Point Cloud Data) file format", PCL documentation, version 0.7; M. Lehmann, LibLZF (the
layout of the compressed bytes).
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from recon.formats.columns import ColumnMap, chunk_of, map_columns
from treegraph.errors import FormatError

MAX_HEADER = 1 << 16  # bytes
MAX_EXPANSION = 90  # LZF writes at most 264 bytes for 3
KINDS = {("F", 4): "f4", ("F", 8): "f8", **{(t, s): f"{t.lower()}{s}" for t in "IU" for s in (1, 2, 4, 8)}}
PACKED_COLOR = ("rgb", "rgba")
_START = re.compile(rb"\s*(#[^\n]*\n\s*)*(#[^\n]*PCD|VERSION[ \t]|FIELDS[ \t])")


@dataclass(frozen=True)
class PcdHeader:
    """Columns (a field of COUNT 3 is three), number of points and where the data begin."""

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    count: int
    data: str
    start: int

    def dtype(self) -> np.dtype:
        """Layout of a point."""
        return np.dtype([(f"p{i}", "<" + kind) for i, kind in enumerate(self.kinds)])


def is_pcd(head: bytes) -> bool:
    """Whether a file that begins with `head` is a PCD file."""
    return _START.match(head) is not None and b"FIELDS" in head


def open_pcd(path: str) -> Source:
    """Open a PCD file.

    Raises
    ------
    FormatError
        If the header is damaged, has no x, y and z, or declares points that are not there.
    """
    with open(path, "rb") as file:
        head = file.read(MAX_HEADER)
    header = _read_header(head, path)
    columns = map_columns(header.names)
    if columns.xyz is None:
        raise FormatError(f"{path}: the PCD fields have no x, y and z, only {', '.join(header.names)[:60]}.")
    packed = next((i for i, name in enumerate(header.names) if name in PACKED_COLOR), None)
    packed = packed if packed is not None and header.kinds[packed][1:] == "4" else None
    if packed is not None:
        columns.extra.pop("color", None)
    source = Source(iter(()), names=dict(columns.names))
    if header.count == 0:
        raise FormatError(f"{path}: the PCD header declares no points. Export the scan again.")
    read = {"ascii": _ascii_chunks, "binary": _binary_chunks, "binary_compressed": _packed_chunks}[
        header.data
    ]
    source.chunks = read(path, header, columns, packed, source.notes)
    return source


def _read_header(head: bytes, path: str) -> PcdHeader:
    match = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?(\n|$)", head, re.MULTILINE)
    if match is None:
        raise FormatError(
            f"{path}: the PCD header has no DATA line; the file is damaged or cut off. Export it again."
        )
    found: dict[str, list[str]] = {}
    for line in head[: match.end()].decode("latin-1").splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            found[words[0]] = words[1:]
    names = found.get("FIELDS", [])
    counts = _whole(found.get("COUNT", ["1"] * len(names)), path, "COUNT")
    sizes = _whole(found.get("SIZE", []), path, "SIZE")
    types = found.get("TYPE", [])
    if not names or not len(names) == len(counts) == len(sizes) == len(types) or max(counts) > 4096:
        raise FormatError(
            f"{path}: FIELDS, SIZE, TYPE and COUNT of the PCD header do not match. Export it again."
        )
    points = _whole(found.get("POINTS", []), path, "POINTS")
    grid = _whole([*found.get("WIDTH", []), *found.get("HEIGHT", [])], path, "WIDTH and HEIGHT")
    count = points[0] if points else (grid[0] * grid[1] if len(grid) == 2 else 0)
    flat: list[tuple[str, str]] = []
    for name, kind, size, repeat in zip(names, types, sizes, counts, strict=True):
        if (kind.upper(), size) not in KINDS:
            raise FormatError(
                f"{path}: the PCD field {name[:20]} has the unknown type {kind[:4]}{size}. Export it again."
            )
        for i in range(repeat):
            flat.append((name if repeat == 1 else f"{name}{i}", KINDS[kind.upper(), size]))
    data = match.group(1).decode("latin-1").lower()
    if data not in ("ascii", "binary", "binary_compressed"):
        raise FormatError(f"{path}: the PCD data are {data[:30]!r}, not ascii, binary or binary_compressed.")
    if not flat:
        raise FormatError(f"{path}: the PCD header names no fields. Export it again.")
    return PcdHeader(tuple(n for n, _ in flat), tuple(k for _, k in flat), count, data, match.end())


def _whole(words: list[str], path: str, what: str) -> list[int]:
    if not all(re.fullmatch("[0-9]{1,18}", word) for word in words):
        raise FormatError(
            f"{path}: {what} of the PCD header must be whole numbers, got {' '.join(words)[:40]!r}."
        )
    return [int(word) for word in words]


def _chunk(columns: ColumnMap, packed: int | None, get: Callable[[int], np.ndarray]) -> Chunk:
    chunk = chunk_of(columns, get)
    if packed is not None:
        bits = np.ascontiguousarray(get(packed)).view(np.uint32)
        chunk.extra["color"] = np.stack([(bits >> s & 255).astype(np.uint8) for s in (16, 8, 0)], axis=1)
    return chunk


def _ascii_chunks(
    path: str, header: PcdHeader, columns: ColumnMap, packed: int | None, notes: list[str]
) -> Iterator[Chunk]:
    from recon.formats.text import Layout, parse_rows

    if packed is not None:
        columns.extra["packed"] = (packed,)
    layout = Layout(delimiter=" ", decimal=".", columns=columns, n_columns=len(header.names))
    seen = 0
    for chunk in parse_rows(path, layout, start=header.start, max_rows=header.count, notes=notes):
        seen += len(chunk.xyz)
        if packed is not None:
            value = chunk.extra.pop("packed")
            is_float = header.kinds[packed][0] == "f"
            limit = 3.4e38 if is_float else 2.0**32 - 1
            value = np.clip(np.nan_to_num(value), -limit if is_float else 0, limit)
            bits = value.astype(np.float32).view(np.uint32) if is_float else value.astype(np.uint32)
            chunk.extra["color"] = np.stack([(bits >> s & 255).astype(np.uint8) for s in (16, 8, 0)], axis=1)
        yield chunk
    if seen < header.count:
        _tell_cut(path, header.count, seen, notes)


def _tell_cut(path: str, declared: int, there: int, notes: list[str]) -> None:
    if there <= 0:
        raise FormatError(
            f"{path}: the PCD declares {declared} points and holds none; it is cut off. Copy it again."
        )
    notes.append(
        f"the file declares {declared} points and ends after {there}: it is cut off; those there were read"
    )


def _binary_chunks(
    path: str, header: PcdHeader, columns: ColumnMap, packed: int | None, notes: list[str]
) -> Iterator[Chunk]:
    dtype = header.dtype()
    there = min(header.count, (os.path.getsize(path) - header.start) // dtype.itemsize)
    if there < header.count:
        _tell_cut(path, header.count, there, notes)
    with open(path, "rb") as file:
        file.seek(header.start)
        for begin in range(0, there, CHUNK):
            rows = np.fromfile(file, dtype, min(CHUNK, there - begin))
            yield _chunk(columns, packed, lambda i: rows[f"p{i}"])  # noqa: B023


def _packed_chunks(
    path: str, header: PcdHeader, columns: ColumnMap, packed: int | None, notes: list[str]
) -> Iterator[Chunk]:
    """The compressed data are one block, field after field: it is held whole, at most 4 GB by its format."""
    from recon.formats._lzf_kernels import lzf_decode

    with open(path, "rb") as file:
        file.seek(header.start)
        sizes = file.read(8)
        n_packed, n_raw = struct.unpack("<II", sizes) if len(sizes) == 8 else (0, 0)
        there = os.path.getsize(path) - header.start - 8
        if n_packed > there or n_packed == 0:
            raise FormatError(
                f"{path}: the compressed PCD data are cut off ({max(there, 0)} of {n_packed} "
                "bytes). Copy it again."
            )
        if n_raw != header.count * header.dtype().itemsize or n_raw > MAX_EXPANSION * n_packed:
            raise FormatError(
                f"{path}: the compressed PCD data do not hold the {header.count} points declared. "
                "Export it again."
            )
        raw = np.empty(n_raw, np.uint8)
        if lzf_decode(np.fromfile(file, np.uint8, n_packed), raw) != n_raw:
            raise FormatError(f"{path}: the compressed PCD data are damaged. Copy the file again.")
    widths = [np.dtype(kind).itemsize for kind in header.kinds]
    begins = np.concatenate([[0], np.cumsum(widths)]) * header.count
    fields = [raw[begins[i] : begins[i + 1]].view("<" + kind) for i, kind in enumerate(header.kinds)]
    for at in range(0, header.count, CHUNK):
        yield _chunk(columns, packed, lambda i: fields[i][at : at + CHUNK])  # noqa: B023
