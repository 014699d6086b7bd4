"""Write what is generated anew: the pages of docs, the README's pictures and the output of its examples."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STEPS = ["docs/make_commands.py", "docs/make_features.py", "tools/make_pictures.py", "tools/examples.py"]


def main() -> int:
    """Run the steps; the first that fails ends it."""
    for step in STEPS:
        print(step, flush=True)
        status = subprocess.run([sys.executable, str(ROOT / step)], cwd=ROOT, check=False).returncode
        if status:
            return status
    return 0


if __name__ == "__main__":
    sys.exit(main())
