"""LAS and LAZ through laspy, in chunks, with what laspy trusts checked first."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from recon.formats.columns import map_columns
from treegraph.errors import FormatError

LAS_GROUND, LAS_NOISE = 2, (7, 18)
KEY_PROJECTED, KEY_GEOGRAPHIC, KEY_LINEAR_UNIT = 3072, 2048, 3076
UNIT_CODES = {9001: "m", 9002: "ft", 9003: "ft"}


def is_las(head: bytes) -> bool:
    """Whether a file that begins with `head` is LAS or LAZ."""
    return head[:4] == b"LASF"


def open_las(path: str) -> Source:
    """Open a LAS or LAZ file."""
    import laspy

    try:
        reader = laspy.open(path)
    except (laspy.LaspyException, ValueError, RuntimeError, OSError, EOFError) as error:
        raise FormatError(f"{path}: the LAS header cannot be read ({_one_line(error)}).") from error
    source = Source(iter(()))
    source.chunks = _chunks(reader, path, source)
    source.epsg, source.unit = _crs(reader.header)
    return source


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


def _chunks(reader, path: str, source: Source) -> Iterator[Chunk]:
    import laspy

    header = reader.header
    extra_names = list(header.point_format.extra_dimension_names)
    columns = map_columns(extra_names)
    source.names.update(columns.names)
    has_color = "red" in header.point_format.dimension_names
    seen = 0
    with reader:
        iterator = reader.chunk_iterator(CHUNK)
        while True:
            try:
                points = next(iterator)
            except StopIteration:
                break
            except (laspy.LaspyException, ValueError, RuntimeError, OSError, EOFError) as error:
                if seen == 0:
                    raise FormatError(f"{path}: no point can be read ({_one_line(error)}). Copy the file again.") from error
                source.notes.append(f"the file declares {header.point_count} points and breaks off after {seen}")
                return
            seen += len(points)
            yield _chunk(points, columns, extra_names, has_color)
    if seen < header.point_count:
        source.notes.append(f"the file declares {header.point_count} points and ends after {seen}: it is cut off")


def _chunk(points, columns, extra_names: list[str], has_color: bool) -> Chunk:
    xyz = np.stack([np.asarray(points.x), np.asarray(points.y), np.asarray(points.z)], axis=1)
    extra: dict[str, np.ndarray] = {"intensity": np.asarray(points.intensity, np.float32)}
    if has_color:
        extra["color"] = np.stack([points.red, points.green, points.blue], axis=1)
    for key in ("tree", "wood", "leaf"):
        if key in columns.extra:
            extra[key] = np.asarray(points[extra_names[columns.extra[key][0]]], np.float64)
    code = np.asarray(points.classification)
    extra["ground"] = code == LAS_GROUND
    noise = np.isin(code, LAS_NOISE)
    if noise.any():
        keep = ~noise
        return Chunk(xyz[keep], {k: v[keep] for k, v in extra.items()})
    return Chunk(xyz, extra)


def _crs(header) -> tuple[int | None, str | None]:
    """EPSG code and unit of length from the GeoTIFF keys or the WKT of a header."""
    epsg: int | None = None
    unit: str | None = None
    for vlr in header.vlrs:
        keys = getattr(vlr, "geo_keys", None)
        if keys:
            found = {k.id: k.value_offset for k in keys}
            code = found.get(KEY_PROJECTED) or found.get(KEY_GEOGRAPHIC)
            epsg = code if code and 1024 <= code < 32767 else epsg
            unit = UNIT_CODES.get(found.get(KEY_LINEAR_UNIT, 0), unit)
        text = getattr(vlr, "string", None)
        if text and ("PROJCS" in text or "PROJCRS" in text or "GEOGC" in text):
            codes = re.findall(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\s*\]*\s*$', text.strip().strip("\0"))
            epsg = int(codes[-1]) if codes else epsg
            if re.search(r'UNIT\["[^"]*f(oo|ee)t', text, re.IGNORECASE):
                unit = "ft"
    return epsg, unit
