"""Derive the species that come along anew, those whose definition has changed: species/library/kinds/*.twigs.

``--all`` derives every one of them, as after a change of the builder.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


def main() -> None:
    """Command line."""
    from species.library import open_species, read_definition
    from species.library.catalog import BUILTIN, DERIVED, derive_beside
    from treegraph.errors import FormatError

    for path in sorted(BUILTIN.glob("*.toml")):
        derived = path.with_suffix(DERIVED)
        try:
            if "--all" in sys.argv[1:]:
                raise FileNotFoundError
            open_species(read_definition(path), derived.read_bytes())
        except (FormatError, FileNotFoundError):
            species, _ = derive_beside(path)
            print(f"{derived.name}: {derived.stat().st_size / 1000:.0f} kB, {len(species.patches)} patches")


if __name__ == "__main__":
    main()
