"""Reconstruct the scans in samples/ with the real command, and say what was written.

``python tools/demo.py [FOLDER] [more options for reconstruct]``
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from pathlib import Path

from sapwood import kernels

ROOT = Path(__file__).resolve().parent.parent

#: The sample scans and what their command needs to know: wood alone is a tree without leaves.
RUNS = [
    (["samples/itsme_tls_tree2.laz"], ["--species", "Terminalia"]),
    (["samples/orange_wood.laz", "samples/green_ash_wood.laz"], ["--f-s", "1"]),
]
KINDS = [".lobes", ".glb", ".png", ".cylinders.csv", ".json"]


def reconstruct(scans: list[str], options: list[str]) -> int:
    """Run the command as a user would, showing it first; return its exit status."""
    print("$ reconstruct " + shlex.join(scans + options), flush=True)
    command = Path(sys.executable).with_name("reconstruct")
    return subprocess.run([str(command), *scans, *options], cwd=ROOT, check=False).returncode


def figure(value: float | None, pattern: str) -> str:
    """Format a figure, or say that there is none."""
    return "-" if value is None else pattern.format(value)


def size(path: Path) -> str:
    """Return the size of a file in kilobytes, or say that there is no such file."""
    return f"{path.stat().st_size / 1000:.1f}" if path.exists() else "-"


def table(folder: Path, names: list[str]) -> str:
    """Return what the reconstructions measured and how large their files are, one tree a line."""
    head = ["tree", "height m", "DBH cm", "crown m", "wood L", "nodes", "clusters"]
    rows = [head + [f"{kind} kB" for kind in KINDS]]
    for name in names:
        path = folder / f"{name}.json"
        if not path.exists():
            rows.append([name, "failed"] + [""] * (len(rows[0]) - 2))
            continue
        tree = json.loads(path.read_text(encoding="utf-8"))
        dbh = tree["dbh_m"]
        rows.append(
            [
                name,
                figure(tree["height_m"], "{:.2f}"),
                figure(None if dbh is None else 100 * dbh, "{:.1f}"),
                figure(tree["crown_width_m"], "{:.1f}"),
                figure(1000 * tree["wood_volume_m3"], "{:.0f}"),
                str(tree["n_nodes"]),
                str(tree["n_clusters"]),
                *(size(folder / f"{name}{kind}") for kind in KINDS),
            ]
        )
    width = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            [row[0].ljust(width[0]), *(cell.rjust(w) for cell, w in zip(row[1:], width[1:], strict=True))]
        )
        for row in rows
    )


def main() -> int:
    """Command line."""
    folder = sys.argv[1] if len(sys.argv) > 1 else "demo-output"
    more = sys.argv[2:]
    begin = time.perf_counter()
    worst = 0
    if not kernels.kept():
        print("The first run on a machine compiles its loops, which takes a minute or two.", flush=True)
    for scans, options in RUNS:
        worst = max(worst, reconstruct(scans, [*options, "-o", folder, "--force", *more]))
    names = [Path(scan).stem for scans, _ in RUNS for scan in scans]
    print(f"\n{folder}/ after {time.perf_counter() - begin:.0f} s:\n")
    print(table(ROOT / folder, names))
    print("\nLook at the .png, open the .glb in any 3D program, the .cylinders.csv in a spreadsheet.")
    return worst


if __name__ == "__main__":
    sys.exit(main())
