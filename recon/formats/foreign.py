"""Files that are no scan, or none this program reads: told by their first bytes, so that errors name them."""

from __future__ import annotations

import re

from treegraph.errors import FormatError, InputError

_MAGIC = (
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89PNG", "a PNG picture"),
    (b"GIF8", "a GIF picture"),
    (b"BM", "a BMP picture"),
    (b"II*\0", "a TIFF picture or raster"),
    (b"MM\0*", "a TIFF picture or raster"),
    (b"%PDF", "a PDF document"),
    (b"glTF", "a glTF model (GLB)"),
    (b"Kaydara FBX", "an FBX model"),
    (b"solid ", "an STL model"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB", "a MATLAB file"),
    (b"LOBES", "a Sapwood tree (.lobes)"),
    (b"RIEGL", "a RIEGL project file"),
    (b"SQLite format", "a database"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
)
_ARCHIVE = (
    (b"PK\x03\x04", "a zip archive"),
    (b"PK\x05\x06", "an empty zip archive"),
    (b"\x1f\x8b", "gzip-compressed"),
    (b"BZh", "bzip2-compressed"),
    (b"\xfd7zXZ", "xz-compressed"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"Rar!", "a RAR archive"),
    (b"\x28\xb5\x2f\xfd", "zstd-compressed"),
)
_REMEDY = "Give a point cloud: LAS, LAZ, PLY, PCD, E57, NPY or text."
_OBJ = re.compile(rb"^(v|vt|vn|f|usemtl|mtllib|o|g)[ \t]", re.MULTILINE)
_GRID = re.compile(rb"^\s*ncols[ \t]+\d+", re.IGNORECASE)
_NUMBERS = rb"(?:[^\S\n]*\S+(?:[ \t]+\S+){%d}[^\S\n]*\n){4}"
_PTX = re.compile(rb"^\s*\d+\s*\r?\n\s*\d+\s*\r?\n" + _NUMBERS % 2 + _NUMBERS % 3)


def refuse_foreign(path: str, head: bytes) -> None:
    """Raise if `head`, the first bytes of a file, is that of another kind of file.

    Raises
    ------
    InputError
        Naming what the file is and what to give instead.
    FormatError
        For bytes that are no text and no kind that is known.
    """
    for magic, what in _ARCHIVE:
        if head.startswith(magic):
            raise InputError(f"{path}: this is {what}, not a scan. Unpack it and give the scan in it.")
    binary = _is_binary(head)
    for magic, what in _MAGIC:
        if head.startswith(magic) and (binary or len(magic) > 2):
            raise InputError(f"{path}: this is {what}, not a scan. {_REMEDY}")
    if binary:
        raise FormatError(f"{path}: these are neither points that can be read nor text. {_REMEDY}")
    start = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if _GRID.match(start):
        raise InputError(
            f"{path}: this is an ESRI ASCII grid, a raster of heights and not a scan. "
            "Give the point cloud that it was made of."
        )
    if re.match(rb"<(!doctype html|html|head|body)\b", start[:200], re.IGNORECASE):
        raise InputError(
            f"{path}: this is a web page (HTML), not a scan. The download may have failed; get the "
            "file again."
        )
    if start[:1] == b"<":
        raise InputError(f"{path}: this is an XML file, not a scan. {_REMEDY}")
    if start[:1] in (b"{", b"["):
        raise InputError(f"{path}: this is a JSON file, not a scan. {_REMEDY}")
    if len(_OBJ.findall(start)) >= 3:
        raise InputError(f"{path}: this is a Wavefront OBJ model, a mesh and not a scan. {_REMEDY}")
    if _PTX.match(start):
        raise InputError(
            f"{path}: this is a PTX file, a grid of scanner positions. Export it as E57, LAS or PTS."
        )


def _is_binary(head: bytes) -> bool:
    """Whether `head` holds bytes that no text of any encoding in use does."""
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return False
    control = sum(head.count(bytes([c])) for c in range(32) if c not in (9, 10, 11, 12, 13, 26, 27))
    return control > 0 and (b"\0" in head or control > len(head) // 50)
