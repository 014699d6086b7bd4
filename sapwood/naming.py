"""Which scans a command line means, and the name that each scan's outputs bear."""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from treegraph.errors import InputError

__all__ = ["SCAN_SUFFIXES", "find_scans", "name_scans"]

#: What is looked for in a folder. A file that is named itself is read whatever its name is.
SCAN_SUFFIXES = (".las", ".laz", ".ply", ".pcd", ".e57", ".xyz", ".txt", ".csv", ".asc", ".pts", ".npy")

#: Of these many are no scans: in a folder they count if there are rows of three numbers in them.
TEXT_SUFFIXES = (".txt", ".csv", ".asc", ".pts", ".xyz")

LONGEST = 220
"""Bytes of a name, so that suffixes and a number have room behind it in the 255 that file systems allow."""

_GLOB_CHARACTERS = "*?["
_HEAD = 8192
"""Bytes of a text file that are looked at."""


def find_scans(
    arguments: Iterable[str],
    skipped: list[Path] | None = None,
    refused: list[tuple[str, str]] | None = None,
) -> list[Path]:
    """List the scans that the arguments of a command mean.

    A folder means the scans in it (not in its sub-folders, and no hidden files) by their suffix, a
    pattern such as ``"plots/**/*.laz"`` what it matches; both in alphabetical order. A file named twice
    is taken once. Text files of a folder without rows of numbers (a licence, a list) are left out, and
    listed in `skipped`.

    Folders without scans and patterns that match nothing are listed in `refused` with what is to be
    said of them, and do not keep the others from being found.

    Raises
    ------
    InputError
        If there is no argument; without `refused`, if one means no scan.
    """
    named = [str(argument) for argument in arguments]
    if not named:
        raise InputError("no scan was named; give at least one file, folder or pattern.")
    found: dict[str, Path] = {}
    for argument in named:
        try:
            for path in _expand(argument, skipped if skipped is not None else []):
                found.setdefault(os.path.realpath(path), path)
        except InputError as error:
            if refused is None:
                raise
            refused.append((argument, str(error)))
    return list(found.values())


def _expand(argument: str, skipped: list[Path]) -> list[Path]:
    path = Path(argument)
    if path.is_dir():
        try:
            found = sorted(p for p in path.iterdir() if _looks_like_a_scan(p))
        except OSError as error:
            raise InputError(f"{argument}: the folder cannot be read ({error.strerror}).") from None
        scans = [p for p in found if p.suffix.lower() not in TEXT_SUFFIXES or _has_rows(p)]
        skipped.extend(p for p in found if p not in scans)
        if not scans:
            raise InputError(
                f"{argument}: no scan in this folder; looked for {' '.join(SCAN_SUFFIXES)}, "
                "not in sub-folders."
            )
        return scans
    if not path.exists() and any(character in argument for character in _GLOB_CHARACTERS):
        scans = sorted(Path(p) for p in glob.glob(argument, recursive=True) if os.path.isfile(p))
        if not scans:
            raise InputError(f"{argument}: no file matches this pattern.")
        return scans
    return [path]  # a missing file is said by the reader, as that scan's own failure


def _looks_like_a_scan(path: Path) -> bool:
    """Whether a file of a folder is meant: a link to what is not there is, and fails as a scan of its own.

    Hidden files are not: some systems put ``._oak.laz`` beside every ``oak.laz``.
    """
    if path.name.startswith(".") or path.suffix.lower() not in SCAN_SUFFIXES:
        return False
    return path.is_file() or (path.is_symlink() and not path.exists())


def _has_rows(path: Path) -> bool:
    """Whether a line among the first of a text file begins with three numbers; True if it cannot be read.

    The table of cylinders that Sapwood itself writes has such lines, and is no scan.
    """
    if path.name.lower().endswith(".cylinders.csv"):
        return False
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD)
    except OSError:  # the reader says why, as that scan's own failure
        return True
    rows = (re.split(rb"[;,\s]+", line.strip()) for line in head.splitlines())
    return not head or any(len(row) >= 3 and all(map(_is_number, row[:3])) for row in rows)


def _is_number(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def name_scans(scans: Iterable[Path]) -> list[str]:
    """Give each scan the name of its outputs: the file's name without suffix, made unique.

    Scans that would share a name get as many of their folders in front as it takes to tell them
    apart (``north/tree.laz`` and ``south/tree.laz`` become ``north-tree`` and ``south-tree``); those of
    one folder get their suffix behind (``tree-laz``, ``tree-ply``). Upper and lower case count as the same
    letter, as they do on some file systems. Of a name that leaves no room for the suffixes of the outputs
    the end is cut off.

    Examples
    --------
    >>> name_scans([Path("north/tree.laz"), Path("south/tree.laz"), Path("south/oak.laz")])
    ['north-tree', 'south-tree', 'oak']
    """
    paths = [Path(os.path.abspath(scan)) for scan in scans]
    names = [path.stem or path.name for path in paths]
    per_folder = Counter((path.parent, name.casefold()) for path, name in zip(paths, names, strict=True))
    for k, path in enumerate(paths):
        if per_folder[path.parent, names[k].casefold()] > 1:
            names[k] = f"{names[k]}-{path.suffix.lstrip('.')}"
    full = list(names)
    depth = [0] * len(paths)
    while True:
        count = Counter(name.casefold() for name in full)
        shared = [k for k, name in enumerate(full) if count[name.casefold()] > 1]
        deeper = [k for k in shared if depth[k] < len(paths[k].parent.parts) - 1]
        if not deeper:
            break
        for k in deeper:
            depth[k] += 1
            full[k] = "-".join([*paths[k].parent.parts[-depth[k] :], names[k]])
    return _number([_shorten(name) for name in full])


def _shorten(name: str) -> str:
    while len(os.fsencode(name)) > LONGEST:
        name = name[:-1]
    return name


def _number(names: list[str]) -> list[str]:
    """Add -2, -3 ... to names that are still the same."""
    taken: set[str] = set()
    unique = []
    for name in names:
        candidate, k = name, 1
        while candidate.casefold() in taken:
            k += 1
            candidate = f"{name}-{k}"
        taken.add(candidate.casefold())
        unique.append(candidate)
    return unique
