"""Draw the pictures of README and docs: the sample scans beside what is made of them, and grown trees.

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
PANEL = 300  # pixels, width of one grown tree
SEED = 3
AGES = (5, 10, 15, 20, 25, 30)
AZIMUTH, SIDE = 0.3, -1.5708  # radians


def shrink(source: Path, target: Path) -> None:
    """Write a smaller copy of a picture."""
    with Image.open(source) as picture:
        width = round(picture.width * HEIGHT / picture.height)
        small = picture.convert("RGB").resize((width, HEIGHT), Image.Resampling.LANCZOS)
    small.save(target, optimize=True)


def grown_trees() -> None:
    """The six trees of figure 6, the ages of one of them, and what a wall does to it."""
    from sapwood.growing import Request, draw_grown, grow_group
    from sapwood.obstacles import parse_obstacle
    from species import find_preset, presets

    look = {"size": (PANEL, round(1.25 * PANEL)), "captions": False}
    groups = [grow_group(Request(kind, SEED)) for kind in presets().values()]
    save_row("figure6.png", [draw_grown(group, azimuth=AZIMUTH, **look).image for group in groups], columns=3)
    kind = find_preset("F6f")
    oldest = grow_group(Request(kind, SEED), AGES[-1])
    ages = [grow_group(Request(kind, SEED), age) for age in AGES]
    save_row(
        "ages.png",
        [draw_grown(group, frame=oldest, azimuth=AZIMUTH, **look).image for group in ages],
        columns=len(AGES) // 2,
    )
    walls = ["", "box:1.5,-15,0,0.3,30,6", "wall:x=1.5"]
    scenes = [
        grow_group(Request(find_preset("F6b"), SEED, tuple(parse_obstacle(w) for w in [wall] if w)))
        for wall in walls
    ]
    save_row("wall.png", [draw_grown(group, azimuth=SIDE, **look).image for group in scenes], columns=3)


def two_trees() -> None:
    """Two trees of one kind, branches that became each other in one colour."""
    import numpy as np

    from inverse import map_pieces
    from sapwood.comparing import draw_mapping
    from species import find_preset, grow

    kind = find_preset("F6b").parameters
    trees = [grow(kind, 14, rng=np.random.default_rng(seed)).tree for seed in (1, 2)]
    save_row("mapping.png", [draw_mapping(map_pieces(*trees), size=(720, 576)).image], columns=1)


def fit_curves() -> None:
    """How the distance of a fit falls, for two runs."""
    import numpy as np

    from inverse import EvolutionSettings, fit_trees
    from sapwood.curves import draw_curves
    from species import find_preset, grow

    tree = grow(find_preset("F6b").parameters, 9, rng=np.random.default_rng(1)).tree
    fit = fit_trees([tree], settings=EvolutionSettings(3000), runs=2, seed=SEED)
    save_row("curve.png", [np.asarray(draw_curves(fit.curves))], columns=1, colors=32)


def plastic_trees() -> None:
    """Two sample scans as they are, beside a high and beside a low wall, and what that changes."""
    import numpy as np

    import sapwood
    from plastic import Scene, analyse
    from sapwood.adapting import Look, cloud_of, draw_adapted
    from treegraph import make_wall

    images = []
    for name in ("green_ash_wood", "itsme_tls_tree2"):
        state = analyse(sapwood.reconstruct(ROOT / "samples" / f"{name}.laz", species=None).tree)
        height, east = np.ptp(state.tree.graph.position[:, 2]), state.tree.graph.position[:, 0].max()
        walls = [
            make_wall((0.5 * east, 0, 0), (-1, 0, 0), width=0.9 * height, height=share * height)
            for share in (1.2, 0.45)
        ]
        scenes = [Scene(), *(Scene((wall,)) for wall in walls)]
        adapted = [state.adapt(scene) for scene in scenes]
        frame = np.concatenate([cloud_of([tree]) for tree in adapted])
        frame = np.concatenate([frame, frame * (-1, 1, 1)])
        more = {"size": (PANEL, round(1.6 * PANEL)), "captions": False, "azimuth": SIDE}
        for tree, changes in zip([*adapted, adapted[1]], (False, False, False, True), strict=True):
            look = Look(changes=changes, more=more)
            images.append(draw_adapted([tree], tree.scene.obstacles, look, frame=frame).image)
    save_row("plastic.png", images, columns=4, colors=None)


def save_row(name: str, images: list, columns: int, *, colors: int | None = 256) -> None:
    """Write panels of one size as one picture, with so many colours, or with all of them."""
    import numpy as np

    rows = [np.concatenate(images[k : k + columns], axis=1) for k in range(0, len(images), columns)]
    picture = Image.fromarray(np.concatenate(rows))
    if colors is not None:
        picture = picture.quantize(colors, dither=Image.Dither.NONE)
    picture.save(FOLDER / name, optimize=True)
    print(f"docs/pictures/{name}: {(FOLDER / name).stat().st_size / 1000:.0f} kB")


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
    grown_trees()
    two_trees()
    fit_curves()
    plastic_trees()


if __name__ == "__main__":
    main()
