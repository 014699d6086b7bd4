"""The gallery's part on fitted trees: an input, trees grown from what was fitted to it, one beside a wall.

``make_gallery.py`` calls :func:`draw_fitted` for each of ``FITTED`` and :func:`describe_fitted` for its page
(Stava et al. 2014, figures 13 to 15).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PANEL = (210, 330)  # pixels
BRANCHES, EVALUATIONS, SEED = 400, 3000, 3
BROTHERS = 4  # the fitted tree and three brothers
AZIMUTH, SIDE = 0.3, -np.pi / 2  # radians; the wall is seen from its end
WALL = (0.5, 0.15)  # how far a wall stands from the stem, in widths of the crown, and at least in heights
WALL_WIDTH, WALL_HEIGHT = 0.6, 0.5  # in heights of the tree
SCANNED = {"stations": 4, "distance": 12.0, "step_deg": 0.1, "noise": 0.002}


@dataclass(frozen=True)
class Input:
    """A scan or mesh, the species that dresses its trees (none: wood alone), and its place on the page."""

    name: str
    path: str
    species: str | None
    what: str
    scale: float = 1.0
    up: str = "z"


FITTED = (
    Input("fitted_tls_tree2", "ship/itsme/itsme_tls_tree2.laz", "Terminalia", "itsme_tls_tree2.laz"),
    Input("fitted_buttressed", "ship/itsme/itsme_tls_buttressed1.laz", "Ficus Virens", "buttressed1.laz"),
    Input("fitted_green_ash", "ship/woodske/green_ash_wood.laz", None, "green_ash_wood.laz, wood alone"),
    Input("fitted_oak", "ship/eztree/oak_medium.obj", "Oak", "the mesh oak_medium.obj, scanned", 0.22),
    Input(
        "fitted_ash",
        "ship/eztree/ash_medium.obj",
        "Ailanthus altissima",
        "the mesh ash_medium.obj, scanned",
        0.22,
    ),
)
PANELS = ("the input", "fitted", "a brother", "a brother", "a brother", "beside a wall")


def read_input(known: Input, path: Path) -> Any:
    """The input as a ClusterTree; a mesh is scanned virtually first."""
    import sapwood

    if path.suffix != ".obj":
        return sapwood.reconstruct(path, species=known.species).tree
    from recon.scan_paths import station_sweeps
    from recon.scanning import Beam, scan_scene, stations_around
    from sapwood.scanning import scene_of

    scene = scene_of(path, scale=known.scale, up=known.up).scene
    stations = stations_around(
        scene.vertices, SCANNED["stations"], distance=SCANNED["distance"], azimuth=AZIMUTH
    )
    sweeps = station_sweeps(scene.vertices, stations, np.radians(SCANNED["step_deg"]))
    points = scan_scene(scene, sweeps, Beam(noise=SCANNED["noise"]), seed=SEED).xyz
    return sapwood.reconstruct(points, species=known.species, name=known.name).tree


def fit_input(tree: Any) -> Any:
    """Growth parameters for a tree: branches are drawn into its leaves first, and the thinnest left out."""
    from inverse import EvolutionSettings, fill_crown, fit_trees, thin_out

    target = thin_out(fill_crown(tree), BRANCHES)
    return fit_trees([target], settings=EvolutionSettings(EVALUATIONS), seed=SEED)


def draw_fitted(known: Input, path: Path) -> tuple[Any, dict[str, Any]]:
    """Six panels in a row, (height, width, 3) uint8, and what is told of them."""
    from sapwood.dressing import find_kind
    from sapwood.growing import Group, Request, draw_grown, grow_group
    from species import Preset
    from treegraph import make_wall

    tree = read_input(known, path)
    fit = fit_input(tree)
    kind = find_kind(tree) if known.species else None
    preset = Preset(known.name, fit.parameters, fit.age, tip_share=fit.tip_share)
    how = {"bare": kind is None, "species": kind}
    groups = [grow_group(Request(preset, seed), **how) for seed in range(BROTHERS)]
    width = float(np.median([np.ptp(group.trees[0].tree.position[:, 0]) for group in groups]))
    height = float(np.median([group.trees[0].height for group in groups]))
    away = max(WALL[0] * width, WALL[1] * height)
    wall = make_wall((away, 0, 0), (-1, 0, 0), width=WALL_WIDTH * height, height=WALL_HEIGHT * height)
    groups.append(grow_group(Request(preset, 0, (wall,)), **how))
    cloud = np.concatenate([group.trees[0].tree.position for group in groups])
    frame = Group([trees for group in groups for trees in group.trees])
    look = {"size": PANEL, "captions": False}
    images = [_draw_input(tree, kind, cloud, look)]
    images += [draw_grown(group, frame=frame, azimuth=AZIMUTH, **look).image for group in groups[:-1]]
    images.append(draw_grown(groups[-1], frame=frame, azimuth=SIDE, **look).image)
    facts = {
        "evaluations": fit.evaluations,
        "distance": fit.distance, "shape": fit.shape, "geometry": fit.geometry, "structure": fit.structure,
        "age": fit.age, "tip_share": fit.tip_share, "parameters": fit.parameters.symbols(),
        "height_m": float(np.ptp(tree.graph.position[:, 2])),
        "grown_m": [round(group.trees[0].height, 1) for group in groups[:-1]],
    }  # fmt: skip
    return np.concatenate([np.asarray(image)[..., :3] for image in images], axis=1), facts


def _draw_input(tree: Any, kind: Any, cloud: Any, look: dict[str, Any]) -> Any:
    """The input in the frame of the trees that were grown."""
    import render
    from sapwood.dressing import dress

    foot = tree.graph.position[0]
    points = np.concatenate([tree.graph.position, cloud + foot])
    empty = render.Mesh(points, np.zeros((0, 3), np.int32), np.zeros_like(points, np.float32))
    frame = render.Part("frame", empty, render.Material("frame", (0.0, 0.0, 0.0)))
    if kind is None:
        return render.preview(tree, more=[frame], azimuth=AZIMUTH, **look).image
    parts = [*dress(tree, kind, seed=SEED).parts(), frame]
    return render.preview(tree, parts=parts, azimuth=AZIMUTH, **look).image


def describe_fitted(facts: dict[str, Any], folder: Path) -> list[str]:
    """The page's part on fitted trees."""
    there = [known for known in FITTED if known.name in facts and (folder / f"{known.name}.jpg").exists()]
    if not there:
        return []
    lines = [
        "## Fitted trees",
        "",
        "Growth parameters whose trees resemble the input ([fitting](fitting.md)): from the left "
        f"{', '.join(PANELS)}. D_T is the mean distance of 16 trees to the input, 0 to 1; brothers of one "
        "kind are at about 0.5 from each other. What is compared are the branches, drawn into the leaf "
        f"clusters of scans first, the {BRANCHES} with most wood.",
        "",
    ]
    for known in there:
        fact = facts[known.name]
        lines += [
            f"Fitted to {known.what}, {fact['height_m']:.1f} m high: D_T {fact['distance']:.2f} (shape "
            f"{fact['shape']:.2f}, geometry {fact['geometry']:.2f}, structure {fact['structure']:.2f}), "
            f"{fact['age']} cycles; {fact['evaluations']} trees grown and compared.",
            "",
            f"![{known.what}, and trees fitted to it](gallery/{known.name}.jpg)",
            "",
        ]
    return lines
