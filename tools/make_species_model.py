"""Train the model that comes along, on virtual scans of the library's species, and write the report on it.

    python -m benchmarks.virtual_set SET --trees 200 --scans 2 --jobs 2
    python tools/make_species_model.py SET

writes classify/shipped/species.model and, beside it, species.json, whose figures are of trees held out. The
same set gives the same bytes. The reliability diagram goes into docs/pictures.
"""

from __future__ import annotations

import json
import sys
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

SHIPPED = ROOT / "classify" / "shipped" / "species.model"
PICTURE = ROOT / "docs" / "pictures" / "reliability.png"
SEED = 0
FALSE_REJECTION = (
    0.25  # real trees lie at the rim of what virtual ones show: rather none than a wrong one ...
)
DISTANCE_SHARE = 0.5  # ... and it is by their distance that real ones differ
ROUNDS, RATE = 2400, 0.3  # twice as many as usual, for hundreds of scans a species: three points better
NAME, VERSION = "virtual trees of sixteen species", "1"


def train(folder: Path, jobs: int) -> tuple[bytes, dict[str, Any]]:
    """The model's file, and its report."""
    from benchmarks.virtual_set import load_set
    from classify import encode_model, train_model
    from classify.model import SPECIES_SETTINGS
    from sapwood.training import Labelled, report_training

    found = load_set(folder)
    n_trees = len(np.unique(found.tree))
    scans = [Labelled(Path(), str(s), str(t)) for s, t in zip(found.species, found.tree, strict=True)]
    training = train_model(
        found.x,
        [scan.species for scan in scans],
        [str(name) for name in found.features],
        rng=np.random.default_rng(SEED),
        settings=replace(SPECIES_SETTINGS, n_rounds=ROUNDS, learning_rate=RATE),
        trees=[scan.tree for scan in scans],
        false_rejection=FALSE_REJECTION,
        distance_share=DISTANCE_SHARE,
        name=NAME,
        version=VERSION,
        provenance={
            "data": f"{len(found)} virtual scans of {n_trees} trees (benchmarks.virtual_set)",
            "script": "tools/make_species_model.py",
            "seed": str(SEED),
        },
        n_threads=jobs,
    )
    report = report_training(training, scans, [], SEED)
    said = training.probability.argmax(axis=1) == training.label
    by = {
        f"{name} {value}": float(said[found.columns[name] == value].mean())
        for name in ("kind", "season", "place")
        for value in np.unique(found.columns[name])
    }
    return encode_model(training.model), {**report, "accuracy_by_circumstance": by}


def draw_reliability(table: dict[str, list[float]], path: Path) -> None:
    """Predicted probability along, share that was right up; a dot's area is its count."""
    from PIL import Image, ImageDraw

    size, margin = 420, 50
    image = Image.new("RGB", (2 * (size + 2 * margin),) * 2, "white")
    draw = ImageDraw.Draw(image)

    def at(x: float, y: float) -> tuple[float, float]:
        return 2 * (margin + size * x), 2 * (margin + size * (1.0 - y))

    draw.rectangle([at(0.0, 1.0), at(1.0, 0.0)], outline="black", width=2)
    draw.line([at(0.0, 0.0), at(1.0, 1.0)], fill="grey", width=2)
    for k in range(6):
        draw.text(at(0.2 * k - 0.02, -0.02), f"{0.2 * k:.1f}", fill="black", font_size=24)
        draw.text(at(-0.09, 0.2 * k + 0.02), f"{0.2 * k:.1f}", fill="black", font_size=24)
    draw.text(at(0.36, -0.07), "predicted probability", fill="black", font_size=26)
    draw.text(at(-0.09, 1.08), "share that was right", fill="black", font_size=26)
    most = max(table["count"])
    for x, y, count in zip(table["predicted"], table["observed"], table["count"], strict=True):
        if count:
            radius = 6.0 + 30.0 * (count / most) ** 0.5
            (a, b) = at(x, y)
            draw.ellipse([a - radius, b - radius, a + radius, b + radius], fill="#2a7f3f", outline="black")
    image.resize((size + 2 * margin,) * 2, Image.Resampling.LANCZOS).save(path, optimize=True)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", type=Path, help="folder of benchmarks.virtual_set")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("-o", "--output", type=Path, default=SHIPPED)
    arguments = parser.parse_args()
    data, report = train(arguments.set, arguments.jobs)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_bytes(data)
    text = json.dumps(report, indent=1, ensure_ascii=False) + "\n"
    arguments.output.with_suffix(".json").write_text(text, encoding="utf-8")
    if arguments.output == SHIPPED:
        draw_reliability(report["reliability"], PICTURE)
    print(
        f"{arguments.output}: {len(data) / 1000:.0f} kB, {report['accuracy']:.1%} held out, "
        f"calibration error {report['calibration_error']:.3f}"
    )


if __name__ == "__main__":
    main()
