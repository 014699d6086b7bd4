"""``doctor``: whether everything is there, and the one line that fixes what is not."""

from __future__ import annotations

import os
import platform
import shutil
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path

from sapwood._version import __version__
from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

OK, MISSING, BROKEN = "ok", "missing", "broken"

REQUIRED = (
    "numpy", "scipy", "numba", "scikit-learn", "trimesh", "zstandard", "laspy", "lazrs", "plyfile", "pillow",
    "typer", "rich",
)  # fmt: skip
OPTIONAL = {
    "pye57": "to read E57 files: python -m pip install pye57",
    "pyrender2": "to draw with OpenGL: python -m pip install pyrender2",
}
LOW_DISK = 1_000_000_000
"""Bytes below which a disk counts as full: kernels and outputs need about a tenth of it."""

FIX_GL = "apt-get install libegl1 libgl1 libopengl0 libosmesa6 (pictures are drawn without, a little slower)"


@dataclass(frozen=True)
class Check:
    """One thing that was looked at: ``ok``, ``missing`` (can be done without) or ``broken`` (cannot)."""

    name: str
    state: str
    found: str
    fix: str | None = None


def doctor(
    as_json: o.Json = False, quiet: o.Quiet = False, verbose: o.Verbose = False, version: o.Version = False
) -> int:
    """Check this installation: versions, OpenGL, kernel cache, disk; say how to fix what is missing.

    \b
    Example:  sapwood doctor
              sapwood doctor --json
    """
    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    checks = []
    for check in run_checks():
        checks.append(check)
        terminal.result(f"{check.state:<8} {check.name:<14} {check.found}")
        if check.fix:
            terminal.result(f"{'':<8} {'':<14} fix: {check.fix}")
    broken = [check for check in checks if check.state == BROKEN]
    terminal.json("doctor", ok=not broken, checks=[asdict(check) for check in checks])
    if broken:
        terminal.error(f"{', '.join(check.name for check in broken)}: see the fix of each above.")
        return 2
    return 0


def run_checks() -> Iterator[Check]:
    """Look at everything, the quick things first."""
    yield Check("sapwood", OK, f"{__version__} in {Path(__file__).parent.parent}")
    yield Check("python", OK, f"{platform.python_version()} ({sys.executable})")
    for name in REQUIRED:
        yield _check_package(name, BROKEN, f"python -m pip install {name}")
    for name, fix in OPTIONAL.items():
        yield _check_package(name, MISSING, fix)
    yield Check("machine", OK, _machine())
    yield _check_cache()
    yield _check_disk()
    yield _check_gl()


def _check_package(name: str, state: str, fix: str) -> Check:
    try:
        return Check(name, OK, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(name, state, "not installed", fix)


def _machine() -> str:
    memory = ""
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = f", {os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30:.1f} GiB of memory"
    return f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors{memory}"


def _check_cache() -> Check:
    from sapwood import kernels

    if not kernels.can_keep():
        fix = f"export {kernels.PLACE_VARIABLE}=/a/folder/you/can/write"
        return Check("kernel cache", BROKEN, f"{kernels.cache_folders()[0]} cannot be written", fix)
    files = kernels.kept()
    if not files:
        return Check("kernel cache", OK, "empty: the first run compiles for a minute or two")
    size = sum(file.stat().st_size for file in files)
    return Check("kernel cache", OK, f"{len(files)} compiled kernels, {size / 1e6:.0f} MB")


def _check_disk() -> Check:
    free = shutil.disk_usage(Path.cwd()).free
    found = f"{free / 1e9:.1f} GB free in {Path.cwd()}"
    if free < LOW_DISK:
        return Check("disk", MISSING, found, "make room, or write to another disk with -o")
    return Check("disk", OK, found)


def _check_gl() -> Check:
    import render

    status = render.find_gl()
    if status.platform is None:
        return Check("OpenGL", MISSING, status.reason, FIX_GL)
    return Check("OpenGL", OK, f"{status.platform}, {status.device}")
