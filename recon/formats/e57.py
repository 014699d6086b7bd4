"""E57 through pye57, which is an extra: all scans of the file, each in its place, block by block."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from treegraph.errors import FormatError, InputError

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
COLOR = ("colorRed", "colorGreen", "colorBlue")
INVALID: dict[tuple[str, ...], str] = {CARTESIAN: "cartesianInvalidState", SPHERICAL: "sphericalInvalidState"}


def is_e57(head: bytes) -> bool:
    """Whether a file that begins with `head` is an E57 file."""
    return head[:8] == b"ASTM-E57"


def open_e57(path: str) -> Source:
    """Open an E57 file.

    Raises
    ------
    InputError
        If pye57 is not installed.
    FormatError
        If the file is damaged or holds no points.
    """
    try:
        import pye57
    except ImportError:
        raise InputError(f'{path}: reading E57 needs an extra package: pip install "sapwood[e57]"') from None
    source = Source(iter(()))
    try:
        file = pye57.E57(path)
        headers = [file.get_header(i) for i in range(file.scan_count)]
        plans = [_fields(header) for header in headers]
    except (
        pye57.libe57.E57Exception,
        RuntimeError,
        ValueError,
        KeyError,
        OSError,
        UnicodeDecodeError,
    ) as error:
        raise FormatError(
            f"{path}: the E57 file cannot be read ({_line(error)}). Copy or export it again."
        ) from error
    usable = [i for i, plan in enumerate(plans) if plan is not None and headers[i].point_count > 0]
    if not usable:
        raise FormatError(
            f"{path}: the E57 file has {len(headers)} scans and no points in them. Export it again."
        )
    shared = set.intersection(*(set(plans[i][1:]) for i in usable))  # type: ignore[index]
    keys = [key for key in ("color", "intensity") if key in shared]
    source.chunks = _chunks(path, file, [(headers[i], plans[i][0], keys) for i in usable], source)  # type: ignore[index]
    if len(usable) > 1:
        source.notes.append(f"{len(usable)} scans of the file were put together in its common frame")
    return source


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:80] or type(error).__name__


def _fields(header: Any) -> list[Any] | None:
    """The kind of coordinates of a scan and what else it has; None without coordinates."""
    there = set(header.point_fields)
    for triple in (CARTESIAN, SPHERICAL):
        if there.issuperset(triple):
            more = (["color"] if there.issuperset(COLOR) else []) + (
                ["intensity"] if "intensity" in there else []
            )
            return [triple, *more]
    return None


def _chunks(
    path: str, file: Any, scans: list[tuple[Any, tuple[str, ...], list[str]]], source: Source
) -> Iterator[Chunk]:
    import pye57

    seen = 0
    for header, triple, keys in scans:
        try:
            for chunk in _scan(file, header, triple, keys, source):
                seen += len(chunk.xyz)
                yield chunk
        except (pye57.libe57.E57Exception, RuntimeError, ValueError, KeyError, OSError) as error:
            if seen == 0:
                raise FormatError(
                    f"{path}: the E57 points cannot be read ({_line(error)}). Copy it again."
                ) from error
            source.notes.append(f"the file breaks off after {seen} points ({_line(error)}); those were read")
            return


def _scan(
    file: Any, header: Any, triple: tuple[str, ...], keys: list[str], source: Source
) -> Iterator[Chunk]:
    names = [*triple]
    if "color" in keys:
        names += COLOR
    if "intensity" in keys:
        names.append("intensity")
    state = INVALID[triple]
    if state in header.point_fields:
        names.append(state)
    data, buffers = file.make_buffers(names, min(CHUNK, header.point_count))
    reader = header.points.reader(buffers)
    rotation, translation = np.eye(3), np.zeros(3)
    if header.has_pose():
        rotation, translation = np.asarray(header.rotation_matrix), np.asarray(header.translation, np.float64)
    left = header.point_count
    while left > 0 and (n := reader.read()) > 0:
        left -= n
        xyz = np.stack([data[name][:n] for name in triple], axis=1)
        if triple == SPHERICAL:
            distance, azimuth, elevation = xyz.T
            flat = distance * np.cos(elevation)
            xyz = np.stack(
                [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1
            )
        with np.errstate(over="ignore", invalid="ignore"):
            xyz = xyz @ rotation.T + translation
        extra = {}
        if "color" in keys:
            extra["color"] = np.stack([data[name][:n] for name in COLOR], axis=1)
        if "intensity" in keys:
            extra["intensity"] = data["intensity"][:n].copy()
        chunk = Chunk(xyz, extra)
        if state in names and data[state][:n].any():
            valid = data[state][:n] == 0
            source.n_skipped += int(n - valid.sum())
            chunk = Chunk(xyz[valid], {k: v[valid] for k, v in extra.items()})
        yield chunk
    reader.close()
