"""The header of a LAS or LAZ file, read without trust: each size is held against the file's before use.

Based on: ASPRS, "LAS Specification 1.4 - R15", 2019; M. Isenburg, "LASzip: lossless compression of LiDAR
data", PE&RS 79(2), 2013 (the record that names the compressed items).
"""

from __future__ import annotations

import math
import os
import re
import struct
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from treegraph.errors import FormatError

SMALLEST_HEADER = 227
COMPRESSED, FORMAT_BITS = 0x80, 0x3F
RECORD_SIZE = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}
COLOR_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
EXTRA_KINDS = ("", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
EXTRA_RECORD = 192  # bytes that describe one extra dimension
HAS_SCALE, HAS_OFFSET = 8, 16  # bits of an extra dimension's options
MAX_VLR_BYTES = 1 << 24
INTERNAL_WAVEFORMS = 2  # bit of the global encoding
KEY_PROJECTED, KEY_GEOGRAPHIC, KEY_LINEAR_UNIT = 3072, 2048, 3076
UNIT_CODES = {9001: "m", 9002: "ft", 9003: "ft"}


@dataclass
class ExtraDimension:
    """A dimension that the standard does not know: its name, layout and where it begins in a record."""

    name: str
    kind: str
    at: int
    scale: float = 1.0
    shift: float = 0.0


@dataclass
class LasHeader:
    """What reading the points needs.

    Attributes
    ----------
    start, end : int
        First byte of the points, and the byte after the last that can belong to them.
    version_minor, point_format, record_size : int
        As in the file, the bit for compression taken off the format.
    declared : int
        Number of points that the header names.
    scale, offset, low, high : (3,) float64
        ``world = scale * integer + offset``; and the bounds the header names, which may be wrong.
    extra : list of ExtraDimension
        In file order; a name may come more than once.
    laszip : bytes or None
        The record that describes the compression; None for plain LAS.
    epsg, unit
        As in :class:`recon.Cloud`.
    """

    start: int
    end: int
    version_minor: int
    point_format: int
    record_size: int
    declared: int
    scale: np.ndarray
    offset: np.ndarray
    low: np.ndarray
    high: np.ndarray
    extra: list[ExtraDimension] = field(default_factory=list)
    laszip: bytes | None = None
    epsg: int | None = None
    unit: str | None = None
    is_geographic: bool = False


def read_header(file: BinaryIO, path: str) -> LasHeader:
    """Read and check the header of the LAS or LAZ file that `file` is.

    Raises
    ------
    FormatError
        If the header is cut off or contradicts itself or the size of the file.
    """
    size = os.fstat(file.fileno()).st_size
    raw = file.read(375)
    if len(raw) < SMALLEST_HEADER:
        raise FormatError(f"{path}: the LAS header is cut off after {len(raw)} bytes. Copy the file again.")
    encoding, minor = struct.unpack_from("<H17xB", raw, 6)
    header_size, start, n_records, kind, record_size, declared = struct.unpack_from("<HIIBHI", raw, 94)
    point_format = kind & FORMAT_BITS
    if point_format not in RECORD_SIZE:
        raise FormatError(
            f"{path}: point format {point_format} is not one of LAS 1.0 to 1.4. Export the scan again."
        )
    if record_size < RECORD_SIZE[point_format]:
        raise FormatError(
            f"{path}: the LAS header gives a point {record_size} bytes, but format {point_format} needs "
            f"{RECORD_SIZE[point_format]}. Export the scan again."
        )
    if not SMALLEST_HEADER <= header_size <= start <= size:
        raise FormatError(
            f"{path}: the LAS points should begin at byte {start} of {size}, after a header of "
            f"{header_size}: "
            "the header is damaged or the file cut off. Copy it again."
        )
    numbers = np.frombuffer(raw, "<f8", 12, 131)
    end = size
    if minor >= 4 and header_size >= SMALLEST_HEADER + 28 and len(raw) >= 255:
        first_evlr, n_evlr, wide = struct.unpack_from("<QIQ", raw, 235)
        declared = wide or declared
        if n_evlr and start < first_evlr < size:
            end = first_evlr
    if encoding & INTERNAL_WAVEFORMS and declared:
        end = min(end, start + declared * record_size)
    header = LasHeader(
        start, end, minor, point_format, record_size, declared, numbers[:3].astype(np.float64),
        numbers[3:6].astype(np.float64), numbers[7::2].astype(np.float64), numbers[6::2].astype(np.float64),
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        good = (np.abs(header.scale) < 1e6) & (header.scale != 0) & (np.abs(header.offset) < 1e15)
    if not good.all():
        raise FormatError(
            f"{path}: the LAS header scales coordinates by {header.scale.tolist()} and shifts them by "
            f"{header.offset.tolist()}, which cannot be. Export the scan again."
        )
    _read_records(file, header, header_size, n_records)
    if kind & COMPRESSED and header.laszip is None:
        raise FormatError(f"{path}: the LAZ file does not say how it is compressed. Copy the file again.")
    if not kind & COMPRESSED:
        header.laszip = None
    return header


def _read_records(file: BinaryIO, header: LasHeader, header_size: int, n_records: int) -> None:
    """The variable-length records between header and points; what does not fit there is not read."""
    file.seek(header_size)
    block = file.read(min(header.start - header_size, MAX_VLR_BYTES))
    at = 0
    for _ in range(n_records):
        if at + 54 > len(block):
            break
        user = block[at + 2 : at + 18].split(b"\0")[0].decode("latin-1")
        number, length = struct.unpack_from("<HH", block, at + 18)
        data = block[at + 54 : at + 54 + length]
        at += 54 + length
        if user == "LASF_Spec" and number == 4:
            header.extra = _extra_dimensions(data, header)
        elif user == "laszip encoded" and number == 22204:
            header.laszip = data
        elif user == "LASF_Projection" and number == 34735:
            _read_geo_keys(data, header)
        elif user == "LASF_Projection" and number == 2112:
            _read_wkt(data.decode("utf-8", "replace"), header)


def _extra_dimensions(data: bytes, header: LasHeader) -> list[ExtraDimension]:
    found: list[ExtraDimension] = []
    at = RECORD_SIZE[header.point_format]
    for begin in range(0, len(data) - EXTRA_RECORD + 1, EXTRA_RECORD):
        one = data[begin : begin + EXTRA_RECORD]
        code, options = one[2], one[3]
        name = one[4:36].split(b"\0")[0].decode("utf-8", "replace").strip()
        if code == 0 or code > 30:  # bytes without meaning, as many as the options say
            at += options if code == 0 else 0
            continue
        kind = EXTRA_KINDS[(code - 1) % 10 + 1]
        scale = struct.unpack_from("<d", one, 112)[0] if options & HAS_SCALE else 1.0
        shift = struct.unpack_from("<d", one, 136)[0] if options & HAS_OFFSET else 0.0
        width = np.dtype(kind).itemsize
        usable = math.isfinite(scale) and math.isfinite(shift) and at + width <= header.record_size
        if code <= 10 and usable:
            found.append(ExtraDimension(name, kind, at, scale, shift))
        at += width * ((code - 1) // 10 + 1)
    return found


def _read_geo_keys(data: bytes, header: LasHeader) -> None:
    keys = np.frombuffer(data[: len(data) // 8 * 8], "<u2").reshape(-1, 4)[1:]
    known = {int(key): int(value) for key, where, _, value in keys if where == 0}
    projected, geographic = known.get(KEY_PROJECTED, 0), known.get(KEY_GEOGRAPHIC, 0)
    code = projected or geographic
    if 1024 <= code < 32767:
        header.epsg = code
    header.is_geographic = bool(geographic) and KEY_PROJECTED not in known
    header.unit = UNIT_CODES.get(known.get(KEY_LINEAR_UNIT, 0), header.unit)


def _read_wkt(text: str, header: LasHeader) -> None:
    text = text.strip("\0 \r\n\t")
    if not re.match(r"(COMPD|PROJ|GEOG|GEOD|COMPOUND|BOUND)", text):
        return
    horizontal = re.split(r"VERT_?C[SR]S?\[|VERTCRS\[", text)[0].rstrip(" ,")
    codes = re.findall(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d{4,6})"?\]\s*\]*$', horizontal)
    header.epsg = int(codes[-1]) if codes else header.epsg
    header.is_geographic = "PROJC" not in horizontal
    if header.is_geographic:
        return
    units = re.findall(r'(?<!ANGLE)(?:LENGTH)?UNIT\["([^"]*)"', horizontal)
    length = [unit.lower() for unit in units if "deg" not in unit.lower() and "unity" not in unit.lower()]
    if length:
        foot = "foot" in length[-1] or "feet" in length[-1] or "ft" in length[-1]
        header.unit = "ft" if foot else ("m" if length[-1].startswith(("met", "m")) else header.unit)
