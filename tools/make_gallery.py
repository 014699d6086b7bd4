"""Draw the gallery: docs/gallery/*.jpg and its page, docs/gallery.md.

``python tools/make_gallery.py --data DIR``; without a data folder only what needs none: the species.
``--only`` takes words that the names of pictures contain; the page is written anew from all that is there.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "tools"))

from gallery_fitted import FITTED, describe_fitted, draw_fitted  # noqa: E402
from gallery_plastic import PLASTIC, describe_plastic, draw_plastic  # noqa: E402

FOLDER = ROOT / "docs" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
FACTS = FOLDER / "facts.json"
HEIGHT, QUALITY = 620, 86
TREE = (330, 400)  # pixels of a tree on the page of species
TWIG = 330
SEED = 3
AGE_SHARE = 0.75  # of the age at which a species is grown up
MODEL, MODEL_SCALE = "ship/eztree/oak_medium.obj", 0.22
MODEL_SPECIES = "Oak"

SCANS = (
    ("itsme_tls_tree1", "ship/itsme/itsme_tls_tree1.laz", "Mahogany"),
    ("itsme_tls_tree2", "ship/itsme/itsme_tls_tree2.laz", "Terminalia"),
    ("itsme_tls_buttressed1", "ship/itsme/itsme_tls_buttressed1.laz", "Ficus Virens"),
    ("itsme_uav_tree", "ship/itsme/itsme_uav_tree.laz", "Bischofia polycarpa"),
    ("vegetation_1_3", "ship/laspy/vegetation_1_3.las", "Lagerstroemia"),
)

HEAD = """\
<!-- Written by tools/make_gallery.py; do not edit. -->
# Gallery

Scans on the left, what Sapwood makes of them on the right. The scans are of trees whose species is not known
to us: the species of the library is the one that suits each best by eye. Where they come from is in
[samples/SOURCES.md](../samples/SOURCES.md) and below.
"""


def save(name: str, image: Any) -> None:
    """Write a picture, no higher than the page takes."""
    picture = Image.fromarray(np.asarray(image)).convert("RGB")
    path = FOLDER / f"{name}.jpg"
    picture.save(path, quality=QUALITY, optimize=True)
    print(f"docs/gallery/{path.name}: {path.stat().st_size / 1000:.0f} kB")


def shrink(image: Any, height: int = HEIGHT) -> Any:
    """The picture with this height."""
    picture = Image.fromarray(np.asarray(image))
    width = round(picture.width * height / picture.height)
    return np.asarray(picture.convert("RGB").resize((width, height), Image.Resampling.LANCZOS))


def draw_scan(name: str, path: Path, species: str) -> dict[str, Any]:
    """A scan beside the tree, dressed with a species."""
    import render
    import sapwood
    import treegraph
    from sapwood.dressing import dress, find_kind

    made = sapwood.reconstruct(path, species=species)
    kind = find_kind(made.tree)
    assert kind is not None
    dressed = dress(made.tree, kind, seed=SEED)
    scan = (made.cloud.xyz, made.cloud.color)
    save(name, shrink(render.preview(made.tree, scan=scan, parts=dressed.parts()).image))
    return {
        "species": species,
        "points": made.cloud.n_read,
        "lobes_bytes": len(treegraph.encode_lobes(made.tree)),
        "height_m": round(made.measures["height_m"], 1),
        "leaf_area_m2": round(dressed.leaf_area, 1),
        "triangles": dressed.decoded.n_faces,
    }


def draw_species() -> None:
    """All species as trees that grew with their own parameters, and a twig of each."""
    import render
    from sapwood.growing import Request, draw_grown, grow_group
    from sapwood.species_pages import draw_branchlet
    from species.library import builtin_library

    library = builtin_library()
    trees, twigs = [], []
    for name in library.names:
        species = library.load(name)
        growth = species.definition.growth
        assert growth is not None
        kind = replace(growth, age=max(1, round(AGE_SHARE * growth.age)))
        group = grow_group(Request(kind, SEED), species=species)
        trees.append(draw_grown(group, size=TREE, azimuth=0.3).image)
        middle = species.branchlets[2 * len(species.branchlets) // 3]
        twigs.append(draw_branchlet(species, middle, side=TWIG))
    save("species_trees", render.contact_sheet(trees, library.names, 4))
    save("species_twigs", render.contact_sheet(twigs, library.names, 4))


def draw_model(path: Path) -> dict[str, Any]:
    """A polygon model, scanned virtually, reconstructed and dressed: thesis figure 3.15."""
    import render
    import sapwood
    import treegraph
    from recon.scan_paths import station_sweeps
    from recon.scanning import Beam, scan_scene, stations_around
    from sapwood.dressing import dress, find_kind
    from sapwood.meshes import read_mesh
    from sapwood.scanning import scene_of

    scene = scene_of(path, scale=MODEL_SCALE, up="z").scene
    stations = stations_around(scene.vertices, 4, distance=12.0, azimuth=0.3)
    sweeps = station_sweeps(scene.vertices, stations, np.radians(0.05))
    points = scan_scene(scene, sweeps, Beam(noise=0.002), seed=SEED).xyz
    made = sapwood.reconstruct(points, species=MODEL_SPECIES, name="model")
    kind = find_kind(made.tree)
    assert kind is not None
    dressed = dress(made.tree, kind, seed=SEED)
    parts = []
    for part in read_mesh(path, up="z", scale=MODEL_SCALE):
        parts.append(_plain_part(part, made.tree.origin))
    look = {"size": (520, HEIGHT), "azimuth": 0.3}
    before = render.preview(made.tree, parts=parts, **look).image
    after = render.preview(made.tree, parts=dressed.parts(), **look).image
    save("model", np.concatenate([before, after], axis=1))
    with tempfile.TemporaryDirectory() as folder:
        flat = Path(folder) / "flat.glb"
        render.write_glb(flat, dressed.parts())
        flat_bytes = flat.stat().st_size
    return {
        "obj_bytes": path.stat().st_size,
        "points": len(points),
        "lobes_bytes": len(treegraph.encode_lobes(made.tree)),
        "species_bytes": kind.n_bytes,
        "triangles": dressed.decoded.n_faces,
        "flat_glb_bytes": flat_bytes,
    }


def _plain_part(part: Any, origin: Any) -> Any:
    """A part of a mesh file as it is drawn: brown wood, green leaves."""
    import render

    corner = (part.vertices - origin)[part.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    faces = np.arange(3 * len(corner), dtype=np.int32).reshape(-1, 3)
    mesh = render.Mesh(corner.reshape(-1, 3), faces, np.repeat(normal, 3, axis=0).astype(np.float32))
    leafy = "lea" in " ".join(part.names).lower()
    color = (0.30, 0.44, 0.18) if leafy else (0.46, 0.40, 0.345)
    return render.Part("leaves" if leafy else "wood", mesh, render.Material("m", color, double_sided=True))


def write_page(facts: dict[str, Any]) -> None:
    """The page, from what is known of each picture."""
    lines = [HEAD]
    for name, path, species in SCANS:
        fact = facts.get(name)
        if fact is None:
            continue
        lines += [
            f"## {Path(path).name} as {species}",
            "",
            f"{fact['points']} points, {fact['height_m']} m high. The tree: "
            f"{fact['lobes_bytes'] / 1000:.1f} kB, {fact['leaf_area_m2']:.0f} m2 of leaves, "
            f"{fact['triangles']} triangles when decoded.",
            "",
            f"![{Path(path).name} beside its model](gallery/{name}.jpg)",
            "",
        ]
    fact = facts.get("model")
    if fact is not None:
        lines += [
            "## A polygon model, compressed",
            "",
            f"`{Path(MODEL).name}` of [ez-tree](https://github.com/dgreenheck/ez-tree) (MIT), "
            f"{fact['obj_bytes'] / 1000:.0f} kB, {MODEL_SCALE} m to its unit, scanned virtually from four "
            f"sides ({fact['points']} points) and reconstructed with `--species {MODEL_SPECIES}`: "
            f"{fact['lobes_bytes'] / 1000:.1f} kB beside a species of {fact['species_bytes'] / 1000:.0f} kB "
            f"that all its trees share. Decoded it has {fact['triangles']} triangles, "
            f"{fact['flat_glb_bytes'] / 1e6:.0f} MB as a flat GLB. Left the model, right what came back.",
            "",
            "![the model beside what came back](gallery/model.jpg)",
            "",
        ]
    lines += describe_plastic(facts)
    lines += describe_fitted(facts, FOLDER)
    if (FOLDER / "species_trees.jpg").exists():
        lines += [
            "## The library's species",
            "",
            "Each grown with its own parameters (`sapwood grow --species NAME`), and one of its branchlets.",
            "",
            "![trees of all species](gallery/species_trees.jpg)",
            "",
            "![a branchlet of each species](gallery/species_twigs.jpg)",
            "",
        ]
    PAGE.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=os.environ.get("SAPWOOD_DATA"))
    parser.add_argument("--only", default="", help="pictures whose names contain one of these, by commas")
    arguments = parser.parse_args()
    words = [word for word in arguments.only.split(",") if word]

    def wanted(name: str) -> bool:
        return not words or any(word in name for word in words)

    FOLDER.mkdir(parents=True, exist_ok=True)
    facts = json.loads(FACTS.read_text(encoding="utf-8")) if FACTS.exists() else {}
    if arguments.data is not None:
        for name, path, species in SCANS:
            if wanted(name):
                facts[name] = draw_scan(name, arguments.data / path, species)
        for scan in PLASTIC:
            if wanted(scan.name):
                image, facts[scan.name] = draw_plastic(arguments.data / scan.path, scan.species)
                save(scan.name, image)
        if wanted("model"):
            facts["model"] = draw_model(arguments.data / MODEL)
        for known in FITTED:
            if wanted(known.name):
                image, facts[known.name] = draw_fitted(known, arguments.data / known.path)
                save(known.name, image)
    if wanted("species"):
        draw_species()
    FACTS.write_text(json.dumps(facts, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    write_page(facts)


if __name__ == "__main__":
    main()
