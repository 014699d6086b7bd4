"""Write docs/features.md: what stands in front is here, the tables come from the features themselves.

``python docs/make_features.py`` writes the page, ``--check`` only says whether it is current.
"""

from __future__ import annotations

import sys
from itertools import groupby
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from classify.features import FEATURES

PAGE = Path(__file__).with_name("features.md")

HEAD = """\
<!-- Written by docs/make_features.py from the features themselves; do not edit. -->
# Features of a scan

`classify.describe_scan(xyz, tree)` describes a tree by {n} numbers: the input of the classifier (thesis
3.5.1). `xyz` are the tree's own points, `tree` is a first reconstruction; `sapwood.features_of` takes both
from a `Reconstruction`. What cannot be known (no trunk, no clusters, hardly any points) is NaN; 10 points
are enough for the call.

**Cells, not points.** A scan has many points near the scanner and few elsewhere. The tree's *size* is the
larger of its height and its width; a grid of 1/64 of the size keeps one point for each filled cell, the mean
of its points, and these are what is counted. A second grid of 0.1 m is there for what is looked at in
metres, and a third of 16 mm for leaves and twigs: shapes of 0.05 to 0.22 m around at most 8000 places, NaN
where fewer than 20 have enough points (at most 500 000 of its cells are kept). All lie along the
crown's long side and start at the mean of the points, so that they do not turn with the axes and do not
follow the foot when it is found some centimetres elsewhere. They are the only
neighbour structure, and all groups use them: a larger box is a run of cells, and the neighbourhood of a
place is its box with the 26 around it.

**Equal samples.** A few points always look flatter and straighter than many from the same place. Shapes are
therefore found from 8 cells each, drawn the same way in every scan. Filled boxes are not counted, as fewer
points fill fewer; pairs of cells in one box are, which in proportion do not change when points are lost at
random. The *effective number* of boxes is how many equally full ones would have as many pairs.

**The crown** begins where the spread of a layer of 1/32 of the height falls below 0.35 of the widest
layer's, going down from that one. Slabs are those of Stava et al., section 5.1: the mean height of the
crown's cells halves it, the mean heights of the halves are the planes.

**The skeleton** is taken as it comes; directions are over 1/40 of the height, and branches shorter than
1/20 are left out.

What this buys is measured in [results.md](results.md), by `python -m benchmarks.features`: how many features
stay within 10% when a scan is thinned to a third, and what they cost beside the encoding.
"""


def make_page() -> str:
    """The page as it should be."""
    lines = [HEAD.format(n=len(FEATURES))]
    for group, features in groupby(FEATURES, key=lambda feature: feature.group):
        rows = list(features)
        lines.append(
            f"## {group.capitalize()}\n\n{len(rows)} features.\n\n| name | unit | what |\n|---|---|---|"
        )
        lines += [f"| `{f.name}` | {f.unit} | {f.text.replace('|', chr(92) + '|')} |" for f in rows]
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Write the page, or with ``--check`` say whether it is current: 0 it is, 1 it is not."""
    page = make_page()
    if "--check" in sys.argv[1:]:
        return int(not PAGE.exists() or PAGE.read_text(encoding="utf-8") != page)
    PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
