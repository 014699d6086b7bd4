"""The part of the gallery on plastic trees: scans beside a wall, between two walls, and as a pair.

``make_gallery.py`` calls :func:`draw_plastic` for each of ``PLASTIC``, :func:`describe_plastic` for the page.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PANEL = (260, 360)  # pixels
SEED = 3
PAIR_WIDTHS, PAIR_HEIGHTS, TURN = 0.45, 0.15, 2.5  # how near the second tree of a pair stands
NEAR = 0.35  # share of the crown's reach at which a wall stands
AZIMUTH = 1.5707963267948966  # the walls are seen from their ends


@dataclass(frozen=True)
class Scan:
    """A scan, the species that dresses it (none: wood alone), and its place on the page."""

    name: str
    path: str
    species: str | None
    what: str


PLASTIC = (
    Scan("plastic_green_ash", "ship/woodske/green_ash_wood.laz", None, "A green ash without leaves"),
    Scan("plastic_pine", "ship/woodske/huangshan_pine_wood.laz", None, "The wood of a Huangshan pine"),
    Scan("plastic_orange", "ship/woodske/orange_wood.laz", None, "The wood of an orange tree"),
    Scan("plastic_buttressed", "ship/itsme/itsme_tls_buttressed1.laz", "Ficus Virens", "A slender tree"),
)


HEAD = """\
## Plastic trees

Scans that `plastic` ([plastic.md](plastic.md)) puts elsewhere. In each row: the tree as it was scanned,
beside a wall, between two walls, as one of a pair, and the first wall's change in colour, red by how far a
branch moved and blue what fell. The walls stand at a third of the crown's reach and are four fifths as high
as the tree."""


def walls_of(tree: Any) -> tuple[Any, Any]:
    """A wall east and one west of a tree, a little higher than it, at about a third of its crown's reach."""
    from treegraph import make_wall

    foot, position = tree.graph.position[0], tree.graph.position
    height = float(np.ptp(position[:, 2]))
    points = np.concatenate([position, *(c.vertices for c in tree.clusters)]) - foot
    out = []
    for side in (1.0, -1.0):
        reach = float(np.quantile(side * points[:, 0], 0.98))
        x = float(foot[0]) + side * max(NEAR * reach, 0.04 * height)
        out.append(make_wall((x, foot[1], foot[2]), (-side, 0, 0), width=1.2 * height, height=0.8 * height))
    return out[0], out[1]


def draw_plastic(path: Path, species: str | None) -> tuple[Any, dict[str, Any]]:
    """Five panels in a row, (height, width, 3) uint8, and what they show in figures."""
    import sapwood
    from plastic import Neighbour, Scene, adapt_stand, analyse
    from sapwood.adapting import Look, cloud_of, draw_adapted
    from sapwood.dressing import find_kind

    made = sapwood.reconstruct(path, species=species)
    state = analyse(made.tree)
    east, west = walls_of(state.tree)
    reach = float(np.ptp(state.tree.graph.position[:, 0]))
    height = float(np.ptp(state.tree.graph.position[:, 2]))
    away = max(PAIR_WIDTHS * reach, PAIR_HEIGHTS * height)
    pair = adapt_stand((Neighbour(state), Neighbour(state, position=(away, 0, 0), turn=TURN)), Scene())
    shown = [(state.adapt(scene),) for scene in (Scene(), Scene((east,)), Scene((east, west)))] + [
        pair,
        (state.adapt(Scene((east,))),),
    ]
    kind = find_kind(state.tree) if species else None
    more = {"size": PANEL, "captions": False, "azimuth": -AZIMUTH}
    frame = np.concatenate([cloud_of(trees) for k, trees in enumerate(shown) if k != 3])
    images = []
    for k, trees in enumerate(shown):
        look = Look(species=(kind,) * len(trees), seed=SEED, changes=k == 4, more=more)
        obstacles = trees[0].scene.obstacles
        images.append(draw_adapted(trees, obstacles, look, frame=frame if k != 3 else None).image)
    beside, between = shown[1][0], shown[2][0]
    facts = {
        "nodes": len(beside.alive),
        "beside": int(beside.alive.sum()),
        "between": int(between.alive.sum()),
        "pair": [int(tree.alive.sum()) for tree in pair],
        "shift_m": round(beside.mean_shift, 2),
    }
    return np.concatenate(images, axis=1), facts


def describe_plastic(facts: dict[str, Any]) -> list[str]:
    """Lines of the page, from what is known of each picture."""
    known = [scan for scan in PLASTIC if scan.name in facts]
    lines = [HEAD, ""] if known else []
    for scan in known:
        fact = facts[scan.name]
        one, two = fact["pair"]
        lines += [
            f"**{scan.what}** (`{Path(scan.path).name}`): {fact['nodes']} nodes, {fact['beside']} beside the "
            f"wall (moved by {fact['shift_m']:.1f} m on average), {fact['between']} between two, "
            f"{one} and {two} as a pair.",
            "",
            f"![{scan.what} beside walls and as a pair](gallery/{scan.name}.jpg)",
            "",
        ]
    return lines
