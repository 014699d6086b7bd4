"""LAS and LAZ in blocks, with what a decoder would trust checked first.

Points are unpacked with NumPy from the layout in the header; LAZ is decompressed by lazrs, the decoder that
laspy uses. laspy itself is not used: it refuses files that name a dimension twice and follows any count that
a header declares.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from recon.formats.columns import ColumnMap, map_columns
from recon.formats.las_header import COLOR_AT, LasHeader, read_header
from treegraph.errors import FormatError

NOISE = (7, 18)
MAX_NOISE_SHARE = 0.2  # of the first block; above, these classes mean something else in this file
VARIABLE_CHUNKS = 0xFFFFFFFF
ITEM_BYTES, ITEM_BYTES_LAYERED = 0, 14  # item types of any size
ITEM_SIZES = {6: 20, 7: 8, 8: 6, 9: 29, 10: 30, 11: 6, 12: 8, 13: 29}
ITEM_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
CUT = "the file is cut off"


def is_las(head: bytes) -> bool:
    """Whether a file that begins with `head` is LAS or LAZ."""
    return head[:4] == b"LASF"


def open_las(path: str) -> Source:
    """Open a LAS or LAZ file.

    Raises
    ------
    FormatError
        If header or compression contradict themselves or the size of the file.
    """
    with open(path, "rb") as file:
        header = read_header(file, path)
    columns = map_columns([dimension.name for dimension in header.extra])
    source = Source(iter(()), names=dict(columns.names), epsg=header.epsg, unit=header.unit)
    source.is_geographic = header.is_geographic
    if columns.unclear:
        named = ", ".join(columns.unclear)
        source.notes.append(f"dimension {named} was not used: its name does not say what it means")
    raw = _plain_records if header.laszip is None else _laz_records
    source.chunks = _chunks(raw(path, header, source.notes), header, columns, source)
    return source


def _plain_records(path: str, header: LasHeader, notes: list[str]) -> Iterator[np.ndarray]:
    """Records (m, record_size) uint8 of a LAS file."""
    room = header.end - header.start
    there = room // header.record_size
    count = header.declared
    if there == 0:
        raise FormatError(
            f"{path}: the file declares {count} points and holds none; it is cut off. Copy it again."
        )
    if there < count:
        notes.append(f"the header declares {count} points, but the file holds {there}; those were read")
    elif there > count and room % header.record_size == 0:
        notes.append(f"the header declares {count} points, but the file holds {there}; all were read")
        count = there
    elif count == 0:
        raise FormatError(f"{path}: the LAS header declares no points. Export the scan again.")
    count = min(count, there)
    with open(path, "rb") as file:
        file.seek(header.start)
        for begin in range(0, count, CHUNK):
            raw = file.read(min(CHUNK, count - begin) * header.record_size)
            whole = len(raw) // header.record_size
            yield np.frombuffer(raw, np.uint8, whole * header.record_size).reshape(whole, header.record_size)


def _laz_records(path: str, header: LasHeader, notes: list[str]) -> Iterator[np.ndarray]:
    """Records (m, record_size) uint8 of a LAZ file."""
    import lazrs

    with open(path, "rb") as file:
        count = _check_laz(file, header, path, notes)
        file.seek(header.start)
        try:
            decoder = lazrs.LasZipDecompressor(file, header.laszip)
        except (lazrs.LazrsError, OSError, ValueError) as error:
            raise FormatError(
                f"{path}: the LAZ points cannot be decoded ({_line(error)}). Copy the file again."
            ) from error
        done = 0
        while done < count:
            rows = min(CHUNK, count - done)
            raw = bytearray(rows * header.record_size)
            try:
                decoder.decompress_many(raw)
            except (lazrs.LazrsError, OSError, ValueError) as error:
                records = _before_error(raw, header)
                if done + len(records) == 0:
                    raise FormatError(
                        f"{path}: the LAZ points cannot be decoded ({_line(error)}). Copy the file again."
                    ) from error
                held = done + len(records)
                notes.append(
                    f"the header declares {count} points, but only {held} can be decoded; those were read"
                )
                yield records
                return
            yield np.frombuffer(raw, np.uint8).reshape(rows, header.record_size)
            done += rows


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:80] or type(error).__name__


def _before_error(raw: bytearray, header: LasHeader) -> np.ndarray:
    """Records decoded before the decoder gave up: the last ones may be rubbish, and go if out of bounds."""
    records = np.frombuffer(raw, np.uint8).reshape(-1, header.record_size)
    filled = np.flatnonzero(records.any(axis=1))
    records = records[: filled[-1]] if len(filled) else records[:0]
    xyz = _coordinates(records, header)
    slack = 0.01 + 1e-3 * np.abs(header.high - header.low)
    inside = ((xyz >= header.low - slack) & (xyz <= header.high + slack)).all(axis=1)
    kept = np.flatnonzero(inside)
    return records[: kept[-1] + 1] if len(kept) else records[:0]


def _check_laz(file: BinaryIO, header: LasHeader, path: str, notes: list[str]) -> int:
    """Check compression record, table of chunks and the sizes in each chunk; the number of points to read."""
    import lazrs

    items, chunk_size = _items(header, path)
    file.seek(0, 2)
    size = file.tell()
    file.seek(header.start)
    raw = file.read(8)
    table = struct.unpack("<q", raw)[0] if len(raw) == 8 else -1
    if table == -1 and size >= header.start + 16:  # written to a pipe: the place stands at the end
        file.seek(size - 8)
        table = struct.unpack("<q", file.read(8))[0]
    if not header.start + 8 <= table <= size - 8:
        raise FormatError(f"{path}: the table of the compressed points is missing: {CUT}. Copy it again.")
    file.seek(table)
    n_chunks = struct.unpack("<4xI", file.read(8))[0]
    if n_chunks > (table - header.start - 8) // header.record_size:
        raise FormatError(
            f"{path}: the LAZ file declares {n_chunks} blocks of points, more than fit into it. "
            "Copy it again."
        )
    file.seek(header.start)
    try:
        chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(header.laszip))
    except (lazrs.LazrsError, OSError, ValueError) as error:
        raise FormatError(
            f"{path}: the table of the compressed points is damaged ({_line(error)}). Copy it again."
        ) from error
    at = header.start + 8
    most = 0
    for n_points, n_bytes in chunks:
        if n_bytes < header.record_size or at + n_bytes > table:
            raise FormatError(f"{path}: the LAZ points end before their table says so. Copy the file again.")
        own = _check_layers(file, header, items, at, n_bytes, path)
        room = n_points if chunk_size == VARIABLE_CHUNKS else chunk_size
        most += room if own is None else min(own, room)
        at += n_bytes
    if header.declared == 0 or most == 0:
        raise FormatError(f"{path}: the LAS header declares no points. Export the scan again.")
    if header.declared > most:
        notes.append(f"the header declares {header.declared} points, but the file holds at most {most}")
    elif header.point_format >= 6 and header.declared < most:
        notes.append(
            f"the header declares {header.declared} points, but the file holds {most}; all were read"
        )
        return most
    elif header.declared <= most - chunk_size:  # without layers the last chunk's points are not counted
        notes.append(f"the header declares {header.declared} points, but there are more; those were not read")
    return min(header.declared, most)


def _items(header: LasHeader, path: str) -> tuple[list[tuple[int, int]], int]:
    """Type and size of the parts of a compressed record, and the points of a chunk."""
    record = header.laszip or b""
    damaged = FormatError(f"{path}: the LAZ compression record is damaged. Copy the file again.")
    if len(record) < 34:
        raise damaged
    chunk_size, n_items = struct.unpack_from("<12xI16xH", record)
    if len(record) < 34 + 6 * n_items or chunk_size == 0:
        raise damaged
    items = [struct.unpack_from("<HH", record, 34 + 6 * i) for i in range(n_items)]
    if sum(size for _, size in items) != header.record_size:
        raise damaged
    first = 10 if header.point_format >= 6 else 6
    if not items or items[0][0] != first:
        raise damaged
    for kind, size in items:
        if kind not in (ITEM_BYTES, ITEM_BYTES_LAYERED) and ITEM_SIZES.get(kind) != size:
            raise damaged
    return items, chunk_size


def _check_layers(
    file: BinaryIO, header: LasHeader, items: list[tuple[int, int]], at: int, n_bytes: int, path: str
) -> int | None:
    """The sizes that a layered chunk declares must fit into it: the decoder allocates by them.

    Returns the number of points that the chunk says it has; None for a chunk without layers.
    """
    if header.point_format < 6:
        return None
    n_layers = sum(size if kind == ITEM_BYTES_LAYERED else ITEM_LAYERS.get(kind, 0) for kind, size in items)
    begins = header.record_size + 4 * (1 + n_layers)
    file.seek(at + header.record_size)
    sizes = np.frombuffer(file.read(begins - header.record_size), "<u4") if n_bytes >= begins else None
    if sizes is None or begins + int(sizes[1:].sum(dtype=np.uint64)) > n_bytes:
        raise FormatError(
            f"{path}: a block of LAZ points declares more bytes than it has. Copy the file again."
        )
    return int(sizes[0])


def _chunks(
    blocks: Iterator[np.ndarray], header: LasHeader, columns: ColumnMap, source: Source
) -> Iterator[Chunk]:
    drops: bool | None = None
    for records in blocks:
        chunk = Chunk(_coordinates(records, header), _extras(records, header, columns))
        noise = _is_noise(records, header)
        if drops is None:
            drops = float(noise.mean()) <= MAX_NOISE_SHARE if len(noise) else True
        if drops and noise.any():
            source.n_skipped += int(noise.sum())
            keep = ~noise
            chunk = Chunk(chunk.xyz[keep], {k: v[keep] for k, v in chunk.extra.items()})
        yield chunk
    if source.n_skipped:
        source.notes.append(
            f"{source.n_skipped} points that the file marks as noise or withheld were left out"
        )


def _field(records: np.ndarray, at: int, kind: str) -> np.ndarray:
    """Column of little-endian values of `kind` that begins at byte `at` of each record."""
    width = np.dtype(kind).itemsize
    return np.ascontiguousarray(records[:, at : at + width]).view("<" + kind)[:, 0]


def _coordinates(records: np.ndarray, header: LasHeader) -> np.ndarray:
    xyz = np.empty((len(records), 3), np.float64)
    for axis in range(3):
        xyz[:, axis] = _field(records, 4 * axis, "i4") * header.scale[axis] + header.offset[axis]
    return xyz


def _extras(records: np.ndarray, header: LasHeader, columns: ColumnMap) -> dict[str, np.ndarray]:
    extra: dict[str, np.ndarray] = {"intensity": _field(records, 12, "u2").astype(np.float32)}
    at = COLOR_AT.get(header.point_format)
    if at is not None:
        extra["color"] = np.stack([_field(records, at + 2 * i, "u2") for i in range(3)], axis=1)
    for key in ("tree", "wood", "leaf"):
        if key in columns.extra:
            dimension = header.extra[columns.extra[key][0]]
            value = _field(records, dimension.at, dimension.kind).astype(np.float64)
            with np.errstate(over="ignore", invalid="ignore"):
                extra[key] = value * dimension.scale + dimension.shift
    return extra


def _is_noise(records: np.ndarray, header: LasHeader) -> np.ndarray:
    """Points of the classes for noise, and those withheld."""
    if header.point_format >= 6:
        code, withheld = records[:, 16], (records[:, 15] & 0x04) > 0
    else:
        code, withheld = records[:, 15] & 0x1F, (records[:, 15] & 0x80) > 0
    return np.isin(code, NOISE) | withheld
