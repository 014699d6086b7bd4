"""Measure everything and write docs/results.md: the figures that the README points to.

``make results ARGS="--data DIR"`` runs all of `benchmarks`, ``--full`` with the ladder to 10 million
points. ``--keep`` leaves the sections of benchmarks in ``--skip`` as they are in the page.
"""

from __future__ import annotations

import contextlib
import io
import os
import platform
import re
import subprocess
import sys
from argparse import ArgumentParser
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

PAGE = ROOT / "docs" / "results.md"
HEAD = """# Results

Written by `tools/make_results.py`; do not edit. [benchmarks.md](benchmarks.md) says what each table measures
and when it passes. Scans are named after where they are from; those in
[samples/](../samples/SOURCES.md) ship with this repository.
"""
PACKAGES = ("numpy", "scipy", "numba")


def machine() -> str:
    """Return one line on what the figures were measured with."""
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        found = re.search(r"^model name\s*:\s*(.+)$", info.read_text(encoding="utf-8"), re.MULTILINE)
        model = found[1] if found else model
    git = ["git", "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    software = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    return (
        f"{platform.system()}, {model}, {os.cpu_count()} cores; Python {platform.python_version()}, "
        f"{software}; commit {commit or 'unknown'}."
    )


def old_sections() -> dict[str, str]:
    """Return the sections that the page has now, by name."""
    if not PAGE.exists():
        return {}
    parts = re.split(r"^## (\w+)\n", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(parts[1::2], (text.strip() for text in parts[2::2]), strict=True))


def main() -> None:
    """Command line."""
    from benchmarks import data, speed
    from benchmarks.__main__ import BENCHMARKS, QUICK_LADDER

    parser = ArgumentParser(description=__doc__.splitlines()[0])
    data.add_arguments(parser)
    parser.add_argument("--skip", default="", help=f"benchmarks to leave out: {', '.join(BENCHMARKS)}")
    parser.add_argument("--keep", action="store_true", help="keep the sections of those left out")
    parser.add_argument("--full", action="store_true", help="climb the ladder to 10 million points")
    arguments = parser.parse_args()
    arguments.rungs = list(speed.LADDER if arguments.full else QUICK_LADDER)
    skipped = {name.strip() for name in arguments.skip.split(",")}
    old = old_sections()
    speed.warm_up()  # compiling is not what is measured
    text = [HEAD]
    for name, module in BENCHMARKS.items():
        if name in skipped:
            if arguments.keep and name in old:
                text.append(f"## {name}\n\n{old[name]}\n")
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            module.run(arguments)
        # A table ends where a line of text follows it only if there is an empty line between them.
        tables = re.sub(r"^(\|.*\|)\n(?=[^|\n])", r"\1\n\n", printed.getvalue().strip(), flags=re.MULTILINE)
        doc = (module.__doc__ or "").splitlines()[0]
        text.append(f"## {name}\n\n{doc}\n\n{machine()}\n\n{tables}\n")
    PAGE.write_text("\n".join(text), encoding="utf-8")


if __name__ == "__main__":
    main()
