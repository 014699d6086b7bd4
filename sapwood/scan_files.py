"""Virtual scans as files: LAS, LAZ and PLY with the truth of every point in columns of its own."""

from __future__ import annotations

import datetime
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.scan_scenes import WOOD
from sapwood._version import __version__
from sapwood.outputs import write_whole
from treegraph.errors import InputError

if TYPE_CHECKING:
    from recon.scanning import Scan

__all__ = ["SCAN_SUFFIXES", "write_scan"]

SCAN_SUFFIXES = (".laz", ".las", ".ply")
LAS_SCALE = 1e-4  # metres: coordinates are whole multiples of it
LAS_REACH = LAS_SCALE * (2**31 - 1)
PULSE_SECONDS = 1e-6  # from pulse to pulse, as recorded
UNCLASSIFIED = 1
NO_DATE = datetime.date(2000, 1, 1)  # of the file's creation: the bytes must not depend on the day
TRUTH = (  # name, type in LAS and NumPy, type in PLY, what it is
    ("tree_id", "i4", "int", "tree, -1 none"),
    ("part", "u1", "uchar", "1 wood 2 leaf 3 ground 4 other"),
    ("node_id", "i4", "int", "node of the graph, -1 none"),
    ("spread", "f4", "float", "depth of the return, m"),
)
LABEL = ("is_wood", "u1", "uchar", "1 wood, 0 anything else")


def write_scan(
    scan: Scan, path: str | os.PathLike[str], *, labels: bool = False, force: bool = False
) -> Path:
    """Write a virtual scan; the file appears whole or not at all.

    Parameters
    ----------
    scan : Scan
    path : path
        Ends in ``.laz``, ``.las`` (coordinates to 0.1 mm) or ``.ply`` (float64).
    labels : bool
        Whether to write a column ``is_wood`` too. `reconstruct` takes it for labels of wood and leaf; the
        columns of truth that are always there (``part``, ``node_id``, ``spread``) it does not read.
    force : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    InputError
        If the suffix is unknown, there are no points, or the file cannot be written.

    Notes
    -----
    The same scan gives the same bytes. LAS: format 1.4, point format 6; ``gps_time`` is a microsecond for
    each pulse, ``point_source_id`` the station from 1, every point is class 1 (unclassified).
    """
    name = os.fspath(path)
    suffix = Path(path).suffix.lower()
    if suffix not in SCAN_SUFFIXES:
        raise InputError(f"{name}: the name must end in one of {' '.join(SCAN_SUFFIXES)}.")
    if not len(scan):
        raise InputError(f"{name}: nothing was hit, so there is no point to write.")
    columns = {key: np.asarray(getattr(scan, key)) for key, *_ in TRUTH}
    if labels:
        columns["is_wood"] = (scan.part == WOOD).astype(np.uint8)
    writer = _write_ply if suffix == ".ply" else _write_las
    return write_whole(path, lambda part: writer(scan, part, columns), force=force)


def _write_las(scan: Scan, path: Path, columns: dict[str, np.ndarray]) -> None:
    import laspy

    low, high = scan.xyz.min(axis=0), scan.xyz.max(axis=0)
    if (high - low).max() >= LAS_REACH:
        raise InputError(f"{path.name}: the points spread over more than a LAS file of 0.1 mm can hold.")
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.creation_date = NO_DATE
    header.generating_software = f"Sapwood {__version__}"
    header.system_identifier = "virtual scanner"
    header.scales, header.offsets = np.full(3, LAS_SCALE), np.floor(low)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name=key, type=kind, description=text)
            for key, kind, _, text in (*TRUTH, LABEL)
            if key in columns
        ]
    )
    las = laspy.LasData(header)
    las.xyz = scan.xyz
    las.return_number, las.number_of_returns = scan.return_number, scan.n_returns
    las.classification = np.full(len(scan), UNCLASSIFIED, np.uint8)
    las.point_source_id = np.minimum(scan.station + 1, 65535).astype(np.uint16)
    las.gps_time = scan.ray * PULSE_SECONDS
    for key, column in columns.items():
        las[key] = column
    las.write(path)


def _write_ply(scan: Scan, path: Path, columns: dict[str, np.ndarray]) -> None:
    fields: list[tuple[str, str, str, np.ndarray]] = [
        (axis, "<f8", "double", scan.xyz[:, k]) for k, axis in enumerate("xyz")
    ]
    types = {key: (kind, ply) for key, kind, ply, _ in (*TRUTH, LABEL)}
    fields += [(key, f"<{types[key][0]}", types[key][1], column) for key, column in columns.items()]
    fields += [
        ("return_number", "u1", "uchar", scan.return_number),
        ("number_of_returns", "u1", "uchar", scan.n_returns),
        ("station", "<i4", "int", scan.station + 1),
        ("pulse", "<f8", "double", scan.ray),
    ]
    layout: Any = [(key, kind) for key, kind, _, _ in fields]
    rows = np.empty(len(scan), layout)
    for key, _, _, column in fields:
        rows[key] = column
    lines = ["ply", "format binary_little_endian 1.0", "comment Sapwood virtual scan: metres, z up"]
    lines += [f"comment {key}: {text}" for key, _, _, text in (*TRUTH, LABEL) if key in columns]
    lines += [f"element vertex {len(rows)}", *(f"property {ply} {key}" for key, _, ply, _ in fields)]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode("ascii") + rows.tobytes())
