"""Bytes of the ``.lobes`` format: integers as byte planes, bit masks, and compressed sections."""

from __future__ import annotations

import numpy as np
import zstandard
from numpy.typing import NDArray

from treegraph.errors import FormatError

__all__ = [
    "join_sections",
    "pack_bits",
    "pack_planes",
    "split_sections",
    "unpack_bits",
    "unpack_planes",
    "unzigzag",
    "varint",
    "read_varint",
    "zigzag",
]

MAX_PLANES = 6
"""Bytes of the widest integer in a section of byte planes."""

ZSTD_LEVEL = 19
MAX_WINDOW = 1 << 23
"""Bytes of history that a compressed section may ask the reader to keep."""

MAX_VARINT_BYTES = 5


def zigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Map 0, -1, 1, -2, 2 ... to 0, 1, 2, 3, 4 ..."""
    return np.where(values < 0, -2 * values - 1, 2 * values)


def unzigzag(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Undo :func:`zigzag`."""
    return (codes >> 1) ^ -(codes & 1)


def pack_planes(values: NDArray[np.int64]) -> bytes:
    """All lowest bytes, then all second bytes ...: as many planes as the largest value needs."""
    largest = int(values.max()) if values.size else 0
    n_planes = (largest.bit_length() + 7) // 8
    flat = values.astype("<i8").ravel()
    return flat.view(np.uint8).reshape(-1, 8)[:, :n_planes].T.tobytes()


def unpack_planes(raw: bytes, count: int, name: str) -> NDArray[np.int64]:
    """Undo :func:`pack_planes` for `count` values; the length of `raw` tells how many planes there are."""
    n_planes = len(raw) // count if count else 0
    if n_planes > MAX_PLANES or n_planes * count != len(raw):
        raise FormatError(
            f"section {name!r} must hold 0 to {MAX_PLANES} bytes for each of its {count} values, "
            f"got {len(raw)} bytes; the file is damaged"
        )
    wide = np.zeros((count, 8), np.uint8)
    wide[:, :n_planes] = np.frombuffer(raw, np.uint8).reshape(n_planes, count).T
    return wide.view("<i8").ravel().astype(np.int64, copy=False)


def pack_bits(mask: NDArray[np.bool_]) -> bytes:
    """Eight flags a byte, the first in the lowest bit."""
    return np.packbits(mask, bitorder="little").tobytes()


def unpack_bits(raw: bytes, count: int, name: str) -> NDArray[np.bool_]:
    """Undo :func:`pack_bits`."""
    if len(raw) != (count + 7) // 8:
        raise FormatError(
            f"section {name!r} must hold {(count + 7) // 8} bytes, one bit for each of {count} nodes, "
            f"got {len(raw)}; the file is damaged"
        )
    if count % 8 and raw[-1] >> count % 8:
        raise FormatError(f"the spare bits of section {name!r} must be 0; the file is damaged")
    return np.unpackbits(np.frombuffer(raw, np.uint8), count=count, bitorder="little").astype(bool)


def varint(value: int) -> bytes:
    """LEB128: seven bits a byte, lowest first, the high bit set on all but the last."""
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def read_varint(data: bytes, at: int, name: str) -> tuple[int, int]:
    """Return the number that begins at byte `at`, and where the next one begins."""
    value = 0
    for shift in range(0, 7 * MAX_VARINT_BYTES, 7):
        if at >= len(data):
            raise FormatError(f"{name} ends within a number; the file is damaged")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise FormatError(
        f"a number in {name} must take at most {MAX_VARINT_BYTES} bytes, got a longer one; "
        "the file is damaged"
    )


def join_sections(sections: list[bytes]) -> bytes:
    """Table of sizes, then the sections, each compressed where that makes it smaller."""
    compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL, write_content_size=False)
    table, bodies = bytearray(), []
    for raw in sections:
        packed = compressor.compress(raw) if raw else raw
        body = packed if len(packed) < len(raw) else raw
        table += varint(len(raw)) + varint(len(body))
        bodies.append(body)
    return bytes(table) + b"".join(bodies)


def split_sections(data: bytes, limits: dict[str, int]) -> dict[str, bytes]:
    """Undo :func:`join_sections`; nothing is decompressed before all sizes are known to be allowed.

    Parameters
    ----------
    data : bytes
        Table and sections, nothing after them.
    limits : dict of str to int
        Name of every section in the order of the file, with the most bytes it may hold.
    """
    sizes, at = {}, 0
    for name, limit in limits.items():
        raw_size, at = read_varint(data, at, "the table of sections")
        size, at = read_varint(data, at, "the table of sections")
        if raw_size > limit:
            raise FormatError(
                f"section {name!r} must hold at most {limit} bytes by the counts in the header, "
                f"but declares {raw_size}; the file is damaged"
            )
        if size > raw_size:
            raise FormatError(
                f"section {name!r} must not be stored in more bytes than it holds ({raw_size}), got {size}; "
                "the file is damaged"
            )
        sizes[name] = (raw_size, size)
    total = sum(size for _, size in sizes.values())
    if total != len(data) - at:
        raise FormatError(
            f"the sections must fill the rest of the file ({len(data) - at} bytes), "
            f"but declare {total}; the file is damaged"
        )
    sections = {}
    for name, (raw_size, size) in sizes.items():
        body = data[at : at + size]
        at += size
        sections[name] = body if size == raw_size else _decompress(body, raw_size, name)
    return sections


def _decompress(body: bytes, raw_size: int, name: str) -> bytes:
    """Decompress one zstd frame without ever holding more than `raw_size` bytes and the window."""
    if not body.startswith(zstandard.FRAME_HEADER):
        raise FormatError(
            f"section {name!r} must be a zstd frame that begins with {zstandard.FRAME_HEADER!r}, "
            f"got {body[:4]!r}; the file is damaged"
        )
    try:
        declared = zstandard.frame_content_size(body)
        if declared not in (-1, raw_size):
            raise FormatError(
                f"section {name!r} must decompress to {raw_size} bytes, but its frame declares {declared}; "
                "the file is damaged"
            )
        raw = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW).decompress(
            body, max_output_size=raw_size, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise FormatError(
            f"section {name!r} cannot be decompressed ({error}); the file is damaged"
        ) from error
    if len(raw) != raw_size:
        raise FormatError(
            f"section {name!r} must decompress to {raw_size} bytes, got {len(raw)}; the file is damaged"
        )
    return raw
