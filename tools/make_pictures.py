"""Draw the README's pictures: the sample scans beside what the real command makes of them.

Writes docs/pictures/NAME.png, small enough for a page and a repository.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent))
from demo import ROOT, RUNS

FOLDER = ROOT / "docs" / "pictures"
HEIGHT = 512  # pixels


def shrink(source: Path, target: Path) -> None:
    """Write a smaller copy of a picture."""
    with Image.open(source) as picture:
        width = round(picture.width * HEIGHT / picture.height)
        small = picture.convert("RGB").resize((width, HEIGHT), Image.Resampling.LANCZOS)
    small.save(target, optimize=True)


def main() -> None:
    """Command line."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    command = Path(sys.executable).with_name("reconstruct")
    with tempfile.TemporaryDirectory() as folder:
        for scans, options in RUNS:
            subprocess.run([str(command), *scans, *options, "-o", folder], cwd=ROOT, check=True)
            for scan in scans:
                name = f"{Path(scan).stem}.png"
                shrink(Path(folder) / name, FOLDER / name)
                print(f"docs/pictures/{name}: {(FOLDER / name).stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
