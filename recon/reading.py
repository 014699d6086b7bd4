"""Reading a scan: the kind of file is told by its content, and a huge one is thinned while it is read."""

from __future__ import annotations

import os

import numpy as np

from recon.cloud import Cloud
from recon.formats.chunks import Chunk, Source
from recon.thinning import Thinner
from treegraph.errors import FormatError, InputError

MAX_POINTS = 20_000_000
MIN_POINTS = 4  # three points have no tree in them
HEAD = 4096  # bytes that tell the kind
MAX_COORDINATE = 1e12  # beyond, float64 has lost a tenth of a millimetre: rubbish bytes


def read_cloud(
    path: str | os.PathLike[str],
    *,
    max_points: int = MAX_POINTS,
    as_points: bool = False,
    decimal: str | None = None,
) -> Cloud:
    """Read a scan from a PLY, LAS, LAZ, PCD, E57, NPY or text file.

    Parameters
    ----------
    path : path
        The file; its kind is told by content.
    max_points : int
        A scan with more is thinned while it is read: at most one point a voxel, the voxel as small as
        this allows. Which points stay depends neither on their order nor on how the file is blocked.
    as_points : bool
        Read the vertices of a mesh as points.
    decimal : {None, ".", ","}
        Decimal mark of a text file; told from the lines if None.

    Returns
    -------
    Cloud
        In file order, finite, with `origin` a whole number of units near the points.

    Raises
    ------
    InputError
        If the file is not there, is a folder, may not be read or is no point file.
    FormatError
        If it is damaged.

    Notes
    -----
    Memory is about 1.5 times the points kept, and two blocks of a million.
    """
    name = os.fsdecode(path)
    if max_points < MIN_POINTS:
        raise InputError(f"max_points must be at least {MIN_POINTS}, got {max_points}.")
    if decimal not in (None, ".", ","):
        raise InputError(f"decimal must be '.' or ',', got {decimal!r}.")
    source = open_source(name, as_points=as_points, decimal=decimal)
    thinner = Thinner(max_points)
    n_read = dropped = 0
    try:
        for chunk in source.chunks:
            n_read += len(chunk.xyz)
            chunk, lost = _finite(chunk)
            dropped += lost
            thinner.add(chunk)
    except OSError as error:
        raise InputError(
            f"{name}: reading broke off after {n_read} points ({error.strerror}). Check the disk."
        ) from error
    return _assemble(name, source, thinner, n_read + source.n_skipped, dropped)


def open_source(path: str, *, as_points: bool = False, decimal: str | None = None) -> Source:
    """Open `path` with the reader its first bytes call for."""
    head = _read_head(path)
    from recon.formats import e57, las, npy, pcd, ply, text
    from recon.formats.foreign import refuse_foreign

    if ply.is_ply(head):
        return ply.open_ply(path, as_points=as_points)
    if las.is_las(head):
        return las.open_las(path)
    if e57.is_e57(head):
        return e57.open_e57(path)
    if npy.is_npy(head):
        return npy.open_npy(path)
    if pcd.is_pcd(head):
        return pcd.open_pcd(path)
    refuse_foreign(path, head)
    return text.open_text(path, decimal=decimal)


def _read_head(path: str) -> bytes:
    if os.path.isdir(path):
        raise InputError(f"{path}: this is a folder; name a scan in it.")
    if os.path.exists(path) and not os.path.isfile(path):
        raise InputError(f"{path}: this is not a regular file; save the scan to one first.")
    try:
        with open(path, "rb") as file:
            head = file.read(HEAD)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file. Check the path.") from None
    except PermissionError:
        raise InputError(f"{path}: the file may not be read. Check its permissions.") from None
    except OSError as error:
        raise InputError(f"{path}: the file cannot be opened ({error.strerror}). Check the path.") from None
    except ValueError:
        raise InputError(f"{path!r}: this cannot be the name of a file. Check the path.") from None
    if not head:
        raise FormatError(f"{path}: the file is empty. Export the scan again.")
    return head


def _finite(chunk: Chunk) -> tuple[Chunk, int]:
    with np.errstate(invalid="ignore"):
        good = (np.abs(chunk.xyz) < MAX_COORDINATE).all(axis=1)
    if good.all():
        return chunk, 0
    kept = Chunk(chunk.xyz[good], {k: v[good] for k, v in chunk.extra.items()})
    return kept, int(len(good) - len(kept.xyz))


def _assemble(path: str, source: Source, thinner: Thinner, n_read: int, dropped: int) -> Cloud:
    chunk = thinner.result()
    notes = list(source.notes)
    if dropped:
        notes.append(f"{dropped} of {n_read} points have no finite coordinates and were left out")
    n = len(chunk.xyz)
    if n < MIN_POINTS:
        raise InputError(
            f"{path}: {n} usable points are too few for a tree (at least {MIN_POINTS}). Check the export."
        )
    low, high = chunk.xyz.min(axis=0), chunk.xyz.max(axis=0)
    if (low == high).all():
        raise InputError(f"{path}: all {n} points are the same. Export the scan again.")
    if source.is_geographic and (high - low)[:2].max() < 1 and np.abs([low[:2], high[:2]]).max() <= 360:
        raise InputError(
            f"{path}: the coordinates are degrees{f' (EPSG {source.epsg})' if source.epsg else ''}. "
            "Project the scan to metres first."
        )
    if thinner.voxel > 0:
        notes.append(
            f"{n_read} points were thinned to {n}, one in each voxel of about {thinner.voxel:.3g} "
            "(max_points)"
        )
    fields = _fields(chunk, source, notes)
    origin = np.floor(low)
    chunk.xyz -= origin  # in place: the chunk is not used again
    return Cloud(
        chunk.xyz, origin, epsg=source.epsg, unit=source.unit, notes=tuple(notes),
        source=os.path.basename(path), n_read=n_read, **fields,
    )  # fmt: skip


def _fields(chunk: Chunk, source: Source, notes: list[str]) -> dict[str, np.ndarray | None]:
    """What the file says of each point, as the cloud stores it; a column that is zero everywhere "
    "says nothing."""
    fields: dict[str, np.ndarray | None] = {}
    if "color" in chunk.extra and chunk.extra["color"].any():
        fields["color"] = _color(chunk.extra["color"])
    if "intensity" in chunk.extra and chunk.extra["intensity"].any():
        top = float(np.finfo(np.float32).max)
        fields["intensity"] = np.clip(chunk.extra["intensity"], -top, top).astype(np.float32)
    if "tree" in chunk.extra:
        fields["tree_id"] = _tree_id(chunk.extra["tree"], source.names["tree"], notes)
    for key, sign in (("wood", True), ("leaf", False)):
        if key in chunk.extra:
            fields["is_wood"] = _is_wood(chunk.extra[key], source.names[key], sign, notes)
    return fields


def _color(raw: np.ndarray) -> np.ndarray:
    """Colours as bytes: those stored as fractions of one or with 16 bits are told by the largest."""
    if raw.dtype == np.uint8:
        return raw
    value = np.clip(np.nan_to_num(raw), 0, 65535)
    top = float(value.max(initial=0))
    scale = 1.0
    if raw.dtype.kind == "f" and top <= 1.0:
        scale = 255.0
    elif top > 255:
        scale = 255.0 / 65535.0
    return np.clip(np.rint(value * scale), 0, 255).astype(np.uint8)


def _tree_id(raw: np.ndarray, name: str, notes: list[str]) -> np.ndarray | None:
    value = np.where(np.isfinite(raw), raw, -1)
    if (value != np.round(value)).any() or np.abs(value.astype(np.float64)).max() > np.iinfo(np.int32).max:
        notes.append(f"{name} does not hold whole numbers and was not used as a tree's number")
        return None
    value = value.astype(np.int32)
    notes.append(f"{name} was read as the number of the tree ({len(np.unique(value))} different)")
    return value


def _is_wood(raw: np.ndarray, name: str, means_wood: bool, notes: list[str]) -> np.ndarray | None:
    if not np.isfinite(raw).all() or raw.min() < 0 or raw.max() > 1:
        notes.append(f"{name} is not between 0 and 1 everywhere and was not used as a label of wood or leaf")
        return None
    if raw.min() == raw.max():
        notes.append(f"{name} is the same for all points and was not used as a label of wood or leaf")
        return None
    high = raw > 0.5
    word = "wood" if means_wood else "leaf"
    notes.append(f"{name} was read as {word} where it is above 0.5 ({high.mean():.0%} of the points)")
    return high if means_wood else ~high
