"""Where the compiled kernels are kept between runs, and whether there are any."""

from __future__ import annotations

import os
from importlib import util
from pathlib import Path

__all__ = ["PLACE_VARIABLE", "cache_folders", "can_keep", "is_writable", "kept"]

PLACE_VARIABLE = "NUMBA_CACHE_DIR"
"""Environment variable by which the user names another place."""

PACKAGES = ("treegraph", "recon", "classify", "species", "inverse", "plastic", "render", "sapwood")


def cache_folders() -> list[Path]:
    """Where the kernels are kept: in one folder if the user named it, else beside each package's code."""
    named = os.environ.get(PLACE_VARIABLE)
    if named:
        return [Path(named)]
    specs = [util.find_spec(package) for package in PACKAGES]
    return [Path(spec.origin).parent / "__pycache__" for spec in specs if spec is not None and spec.origin]


def kept() -> list[Path]:
    """The files of compiled kernels that are there."""
    found = [*cache_folders(), *([] if os.environ.get(PLACE_VARIABLE) else [_of_the_user()])]
    return sorted(file for folder in found if folder.is_dir() for file in folder.rglob("*.nbc"))


def can_keep() -> bool:
    """Whether there is a place for them: the packages' own folders, or else the user's cache."""
    return all(is_writable(folder) for folder in cache_folders()) or (
        not os.environ.get(PLACE_VARIABLE) and is_writable(_of_the_user())
    )


def is_writable(folder: Path) -> bool:
    """Whether a file can be made in `folder`, or in the nearest folder above it that is there."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK)


def _of_the_user() -> Path:
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path(os.path.expanduser("~")) / ".cache") / "numba"
