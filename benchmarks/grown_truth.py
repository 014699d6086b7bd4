"""Grown trees, scanned virtually and reconstructed: every node of the truth is known.

Each tree is grown, meshed, scanned from four sides with noise and a beam of some width, and given to the
reconstruction as bare points: no label, no colour, no species. Skeletons are compared as in
``benchmarks.skeleton_truth`` (pieces of 5 mm; *seen* pieces have a scan point within 5 cm of their bark).
Volumes and lengths are those of the cylinder table of both trees; tips are the nodes without children.

    python -m benchmarks.grown_truth
    python -m benchmarks.grown_truth --only F6b --pictures DIR
"""

from __future__ import annotations

import sys
import time
from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.segments import Samples, from_tree, sample
from benchmarks.skeleton_truth import SPACING, compare

NOISE = 0.002  # metres
DIVERGENCE, EXIT_DIAMETER = 0.35e-3, 0.0025  # radians and metres: a common terrestrial instrument
STEP_DEG = 0.05
N_STATIONS = 4
DISTANCE_PER_HEIGHT = 0.8
BREAST_HEIGHT = 1.3  # metres
THICK = 0.015  # metres: from this radius on wood is a bough


@dataclass(frozen=True)
class Case:
    """One tree."""

    preset: str
    age: int
    leaves: bool
    seed: int = 3

    @property
    def name(self) -> str:
        """How it is called in the table."""
        return f"{self.preset} {self.age} {'leaves' if self.leaves else 'bare'}"


CASES = tuple(
    Case(preset, age, leaves)
    for leaves in (False, True)
    for preset, age in (
        ("F6a", 8),
        ("F6b", 14),
        ("F6b", 20),
        ("F6c", 14),
        ("F6d", 14),
        ("F6e", 10),
        ("F6f", 16),
    )
)


def grow_case(case: Case) -> Any:
    """The tree with its leaves: a group of one."""
    from dataclasses import replace

    from sapwood.growing import Request, grow_group
    from species import find_preset

    kind = replace(find_preset(case.preset), age=case.age)
    return grow_group(Request(kind, case.seed), bare=not case.leaves)


def scan_case(group: Any, seed: int, step_deg: float = STEP_DEG) -> np.ndarray:
    """What four stations see of it, on flat ground that is not scanned: (n, 3) metres."""
    from recon.scan_paths import station_sweeps
    from recon.scan_scenes import LEAF, WOOD, join_scenes, make_scene
    from recon.scanning import Beam, scan_scene, stations_around

    parts = group.parts()
    scene = join_scenes(
        [make_scene(p.mesh.vertices, p.mesh.faces, WOOD if p.name == "wood" else LEAF) for p in parts]
    )
    wood = parts[0].mesh.vertices
    distance = DISTANCE_PER_HEIGHT * max(float(np.ptp(wood[:, 2])), 4.0)
    stations = stations_around(wood, N_STATIONS, distance=distance, azimuth=0.3)
    beam = Beam(noise=NOISE, divergence=DIVERGENCE, exit_diameter=EXIT_DIAMETER)
    return scan_scene(
        scene, station_sweeps(scene.vertices, stations, np.radians(step_deg)), beam, seed=seed
    ).xyz


def diameter_at(graph: Any, height: float = BREAST_HEIGHT) -> float:
    """Diameter of the trunk at a height above its foot, metres; NaN if it does not reach it."""
    from treegraph import chains

    start, node = chains(graph)
    trunk = node[start[0] : start[1]]
    z = graph.position[trunk, 2] - graph.position[0, 2]
    above = np.flatnonzero(z >= height)
    return 2.0 * float(graph.radius[trunk[above[0]]]) if above.size else float("nan")


def measure(case: Case, step_deg: float = STEP_DEG, pictures: Path | None = None) -> dict[str, Any]:
    """One row of the table."""
    from recon import EncodeSettings, encode_with_report
    from sapwood.growing import as_cluster_tree

    group = grow_case(case)
    points = scan_case(group, case.seed, step_deg)
    grown = as_cluster_tree(group.trees[0])
    begin = time.process_time()
    settings = EncodeSettings() if case.leaves else EncodeSettings(f_s=1.0)
    made = encode_with_report(points, settings=settings)
    tree, dbh = made.tree, made.report.dbh_m
    cpu = time.process_time() - begin
    truth, model = from_tree(grown), from_tree(tree)
    pieces, true_pieces = sample(model, SPACING), sample(truth, SPACING)
    figures = compare(pieces, true_pieces, points)
    thick = true_pieces.radius >= THICK
    boughs = Samples(*(getattr(true_pieces, name)[thick] for name in ("xyz", "radius", "length")))
    row = {
        "tree": case.name,
        "points": len(points),
        "cpu_s": cpu,
        "true_length_m": figures["true_length_m"],
        "seen_share": figures["seen_share"],
        "length_m": figures["length_m"],
        **{key: figures[key] for key in ("recall_3cm", "seen_recall_3cm", "precision_3cm")},
        "bough_recall_3cm": compare(pieces, boughs)["recall_3cm"],
        "radius_error": figures["radius_error"],
        "radius_bias": figures["radius_bias"],
        "true_volume_L": 1000.0 * float(truth.volume.sum()),
        "volume_L": 1000.0 * float(model.volume.sum()),
        "true_tips": tips(grown.graph),
        "tips": tips(tree.graph),
        "true_dbh_cm": 100.0 * diameter_at(grown.graph),
        "dbh_cm": None if dbh is None else 100.0 * dbh,
        "clusters": len(tree.clusters),
    }
    if pictures is not None:
        draw(group, tree, points, pictures / f"{case.name.replace(' ', '_')}.png")
    return row


def tips(graph: Any) -> int:
    """Nodes without children."""
    return int(graph.n_nodes - len(np.unique(graph.parent[graph.parent >= 0])))


def draw(group: Any, tree: Any, points: np.ndarray, path: Path) -> None:
    """The grown tree, its scan and what was reconstructed, side by side."""
    from PIL import Image

    import render
    from sapwood.growing import draw_grown

    look = {"azimuth": 0.3, "captions": False}
    grown = draw_grown(group, size=(480, 720), **look).image
    pair = render.preview(tree, scan=points - tree.origin, size=(960, 720), **look).image
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate([grown, pair], axis=1)).save(path)


def run(arguments: Namespace) -> list[dict[str, Any]]:
    """All rows, printed as a table."""
    words = [word.strip() for word in arguments.only.split(",") if word.strip()]
    rows = []
    for case in CASES:
        if words and not any(word in case.name for word in words):
            continue
        print(case.name, file=sys.stderr)
        rows.append(measure(case, pictures=getattr(arguments, "pictures", None)))
    print(report.table(rows))
    report.write_json(arguments.json, "grown_truth", rows)
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.grown_truth", description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="only trees whose name contains one of these, by commas")
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw each tree, its scan and its model")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
