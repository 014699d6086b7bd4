"""A set of virtual scans with the name of their species: what a classifier is trained and tried with.

Trees come from any source (``benchmarks.virtual_trees``); each is scanned several times: from one to four
stations, from a street along one side, or from the air; with noise, with or without a beam of some width,
with bodies in between that hide parts of it, from a few hundred to tens of thousands of points. Only points
on the tree are kept; they are reconstructed with the default allometry and described as any scan is.

    python -m benchmarks.virtual_set DIR --trees 40 --scans 2 --jobs 2
    python -m benchmarks.virtual_set DIR --species Oak,Pine --trees 3 --keep-scans

    python -m benchmarks.virtual_set DIR --again --jobs 2

writes DIR/SPECIES.npz for every species; one that is there already is given the trees that it lacks. With
--keep-scans also DIR/SPECIES/TREE_SCAN.xyz, and DIR/scans.csv with their paths, species and trees. With
--again the kept scans, which are rounded to a millimetre, are reconstructed and described anew, whenever
what describes them has changed. The same seed gives the same set, whatever --jobs is.
"""

from __future__ import annotations

import csv
import sys
import zlib
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.virtual_trees import ANY, CITY, LibrarySource, Source, Variety, VirtualTree

__all__ = [
    "CAMPAIGNS",
    "Campaign",
    "Survey",
    "VirtualSet",
    "draw_survey",
    "load_set",
    "make_samples",
    "scan_tree",
]

LEAST_POINTS = 300  # fewer are no scan of a tree ...
LEAST_HEIGHT = 0.5  # ... nor is one of less than this share of its height
MOST_TRIES = 3  # at twice the resolution each
SILHOUETTE = 0.45  # share of the box around a tree that stops a ray
DISTANCE = (0.45, 1.2)  # of the tree's height
LEAST_DISTANCE = 4.0  # metres
STREET_HEIGHT, STATION_HEIGHT = 2.2, 1.6
STEPS = (np.radians(0.01), np.radians(2.0))
TREE = 1


@dataclass(frozen=True)
class Campaign:
    """What a set is of: how trees differ, and how they are scanned.

    Attributes
    ----------
    variety : Variety
        Of the trees.
    kinds : tuple of (str, float)
        Ways to scan, and how often.
    points, points_air : (least, most) tuple of int
        That are aimed at, from the ground and from the air.
    hiding : float
        How often something is in the way.
    """

    variety: Variety = ANY
    kinds: tuple[tuple[str, float], ...] = (("stations", 0.7), ("street", 0.15), ("air", 0.15))
    points: tuple[int, int] = (4_000, 120_000)
    points_air: tuple[int, int] = (800, 12_000)
    hiding: float = 0.35


CAMPAIGNS = {
    "any": Campaign(),
    "city": Campaign(CITY, kinds=(("stations", 1.0),), points=(40_000, 200_000), hiding=0.25),
}
"""Any tree, scanned in any way, to train with; and trees in leaf from one to four stations."""


@dataclass(frozen=True)
class Survey:
    """How a tree is scanned.

    Attributes
    ----------
    kind : str
        "stations", "street" or "air".
    n_stations : int
        Stations, or flight strips.
    distance : float
        Of the stations or the street from the trunk, in heights of the tree; of the flight, metres.
    azimuth : float
        Of the first station, the street or the flight, radians.
    aim : int
        Points that the resolution is chosen for.
    noise : float
        Standard deviation of the range, metres.
    divergence : float
        Of the beam, radians; 0: a ray.
    n_hiding : int
        Bodies between the scanner and the tree.
    """

    kind: str
    n_stations: int
    distance: float
    azimuth: float
    aim: int
    noise: float
    divergence: float
    n_hiding: int


def draw_survey(rng: np.random.Generator, campaign: Campaign = CAMPAIGNS["any"]) -> Survey:
    """Some way to scan a tree."""
    names, shares = zip(*campaign.kinds, strict=True)
    kind = str(rng.choice(names, p=shares))
    is_air = kind == "air"
    aim = np.exp(rng.uniform(*np.log(campaign.points_air if is_air else campaign.points)))
    return Survey(
        kind=kind,
        n_stations=int(rng.integers(1, 4 if is_air else 5)),
        distance=float(rng.uniform(60.0, 300.0) if is_air else rng.uniform(*DISTANCE)),
        azimuth=float(rng.uniform(0.0, 2.0 * np.pi)),
        aim=int(aim),
        noise=float(rng.uniform(0.01, 0.03) if is_air else rng.uniform(0.001, 0.01)),
        divergence=float(0.5e-3 if is_air else rng.choice([0.0, 0.3e-3])),
        n_hiding=int(rng.integers(1, 4)) if not is_air and rng.random() < campaign.hiding else 0,
    )


def scan_tree(tree: VirtualTree, survey: Survey, rng: np.random.Generator) -> np.ndarray:
    """Points (n, 3) on the tree, metres; none if hardly any can be had."""
    from recon.scan_scenes import LEAF, WOOD, join_scenes, make_scene
    from recon.scanning import Beam, scan_scene

    wood = [part for part in tree.wood if len(part.faces)]
    pieces = [make_scene(part.vertices, part.faces, WOOD, tree_id=TREE) for part in wood]
    if tree.leaves is not None and len(tree.leaves.faces):
        pieces.append(make_scene(tree.leaves.vertices, tree.leaves.faces, LEAF, tree_id=TREE))
    if not pieces:  # a seedling in the shade has nothing to be hit
        return np.zeros((0, 3))
    vertices = np.concatenate([piece.vertices for piece in pieces])
    bodies = _bodies(vertices, survey, rng)
    scene = join_scenes(pieces + bodies)
    is_air = survey.kind == "air"
    beam = Beam(
        noise=survey.noise,
        divergence=survey.divergence,
        exit_diameter=0.005 if survey.divergence else 0.0,
        n_returns=4 if is_air else 1,
        max_range=2000.0 if is_air else 200.0,
    )
    seed = int(rng.integers(2**31))
    factor = 1.0
    for _ in range(MOST_TRIES):
        scan = scan_scene(scene, _sweeps(vertices, survey, factor), beam, seed=seed)
        points = scan.xyz[scan.tree_id == TREE]
        if len(points) >= max(LEAST_POINTS, survey.aim // 4):
            break
        factor *= 2.0
    seen = len(points) >= LEAST_POINTS and np.ptp(points[:, 2]) >= LEAST_HEIGHT * tree.height
    return points if seen else np.zeros((0, 3))


def _sweeps(vertices: np.ndarray, survey: Survey, factor: float) -> list[Any]:
    """Sweeps that would give `factor` times the points aimed at, if a share of the box stops rays."""
    from recon.scan_paths import airborne_sweeps, mobile_sweep, station_sweeps, stations_around

    size = np.maximum(np.ptp(vertices, axis=0), 0.5)
    aim = factor * survey.aim
    if survey.kind == "air":
        area = SILHOUETTE * size[0] * size[1]
        altitude = max(survey.distance, size[2] + 20.0)
        density = aim / (1.5 * area * survey.n_stations)
        return airborne_sweeps(
            vertices, altitude=altitude, density=density, scan_angle=np.radians(60.0),
            n_strips=survey.n_stations, strip_spacing=0.3 * altitude, azimuth=survey.azimuth,
        )  # fmt: skip
    distance = max(survey.distance * size[2], LEAST_DISTANCE, 0.6 * float(size[:2].max()))
    face = SILHOUETTE * size[2] * float(size[:2].mean())
    if survey.kind == "street":
        gap = float(np.sqrt(face / aim))
        step = float(np.clip(gap / distance, *STEPS))
        side = np.array([-np.sin(survey.azimuth), np.cos(survey.azimuth)])
        away = distance * np.array([np.cos(survey.azimuth), np.sin(survey.azimuth)])
        reach = 1.5 * float(size[:2].max()) + 2.0
        ends = [[*(away + way * reach * side), STREET_HEIGHT] for way in (-1.0, 1.0)]
        return [mobile_sweep(ends, step=step, spacing=max(gap, 0.004))]
    step = float(np.clip(np.sqrt(face * survey.n_stations / aim) / distance, *STEPS))
    stations = stations_around(
        vertices, survey.n_stations, distance=distance, height=STATION_HEIGHT, azimuth=survey.azimuth
    )
    return station_sweeps(vertices, stations, step)


def _bodies(vertices: np.ndarray, survey: Survey, rng: np.random.Generator) -> list[Any]:
    """Balls that stand between the first station and the tree."""
    from recon.scan_scenes import obstacle_scene
    from treegraph import Ball

    if not survey.n_hiding:
        return []
    size = np.ptp(vertices, axis=0)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    made = []
    for _ in range(survey.n_hiding):
        angle = survey.azimuth + rng.normal(0.0, 0.3)
        away = 0.5 * float(size[:2].max()) + rng.uniform(0.5, 0.3 * max(survey.distance * size[2], 4.0))
        radius = float(rng.uniform(0.06, 0.18) * size[2])
        place = middle[:2] + (away + radius) * np.array([np.cos(angle), np.sin(angle)])
        at = np.array([*place, rng.uniform(0.0, 0.8) * size[2]])
        made.append(obstacle_scene(Ball(at, radius), near=at, reach=radius))
    return made


@dataclass(frozen=True, eq=False)
class VirtualSet:
    """Described scans; n rows.

    Attributes
    ----------
    x : (n, f) float64
        Features, NaN where unknown: ``classify.train_model(x, species, features, trees=tree, ...)``.
    features : (f,) str
    species : (n,) str
    tree : (n,) str
        Name of the tree; scans of one tree belong on the same side of any split.
    columns : dict of str to (n,) arrays
        How the tree and the scan came about: the fields of :class:`Survey`, the traits of the tree,
        ``height`` (metres) and ``n_points``.
    """

    x: np.ndarray
    features: np.ndarray
    species: np.ndarray
    tree: np.ndarray
    columns: dict[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.x)


def save_set(path: Path, samples: Sequence[dict[str, Any]], features: Sequence[str]) -> None:
    """Write samples, the rows of :func:`make_samples`, to an npz file without any pickle."""
    plain = [key for key in samples[0] if key not in ("x", "points")]
    columns = {f"column_{key}": np.array([sample[key] for sample in samples]) for key in plain}
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            x=np.array([sample["x"] for sample in samples]),
            features=np.array(list(features)),
            **columns,
        )


def load_set(source: Path) -> VirtualSet:
    """Read a file, or all files of a folder, in alphabetical order; all must have the same features."""
    paths = sorted(source.glob("*.npz")) if source.is_dir() else [source]
    parts = []
    for path in paths:
        with np.load(path, allow_pickle=False) as file:
            parts.append({name: file[name] for name in file.files})
    if not parts:
        raise SystemExit(f"{source}: there are no files SPECIES.npz")
    if any(part["features"].tolist() != parts[0]["features"].tolist() for part in parts):
        raise SystemExit(f"{source}: the files have different features; make them anew")
    names = [name for name in parts[0] if name != "features"]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in names}
    columns = {name.removeprefix("column_"): value for name, value in joined.items() if name != "x"}
    return VirtualSet(joined["x"], parts[0]["features"], columns.pop("species"), columns.pop("tree"), columns)


def make_samples(
    source: Source, number: int, n_scans: int, seed: int, campaign: Campaign = CAMPAIGNS["any"]
) -> list[dict[str, Any]]:
    """Tree `number` of a source, scanned and described `n_scans` times at most.

    Returns
    -------
    list of dict
        ``x`` (f,), ``points`` (n, 3), ``species``, ``tree`` and what :class:`VirtualSet` has in columns.
        Scans with too few points, and those that the reconstruction refuses, are not there.
    """
    from classify import describe_scan
    from treegraph import InputError

    key = [seed, zlib.crc32(source.species.encode()), number]
    tree = source.make(np.random.default_rng(key))
    found = []
    for scan in range(n_scans):
        rng = np.random.default_rng([*key, scan])
        survey = draw_survey(rng, campaign)
        points = scan_tree(tree, survey, rng)
        if not len(points):
            continue
        try:
            made = _encoded(points)
        except InputError:
            continue
        found.append(
            {
                "x": describe_scan(made.cloud.xyz, made.tree).array,
                "points": points,
                "species": source.species,
                "tree": f"{source.species} {number:04d}",
                "scan": scan,
                "height": tree.height,
                "n_points": len(points),
                **tree.traits,
                **asdict(survey),
            }
        )
    return found


def _encoded(points: np.ndarray) -> Any:
    """The reconstruction; a tree that looks like several is told where its foot is, as with ``--base``."""
    from recon import EncodeSettings, PrepareSettings, encode_with_report
    from treegraph import InputError

    try:
        return encode_with_report(points)
    except InputError:
        foot = PrepareSettings(base=(0.0, 0.0, 0.0))
        return encode_with_report(points, settings=EncodeSettings(prepare=foot))


def library_source(name: str, variety: Variety = ANY) -> Source:
    """A species of the library that comes along."""
    from species.library import builtin_library

    return LibrarySource(_open(builtin_library(), name), variety)


@cache
def _open(library: Any, name: str) -> Any:
    return library.load(name)


def _task(task: tuple[str, int, int, int, str, bool]) -> list[dict[str, Any]]:
    name, number, n_scans, seed, campaign, keep = task
    kind = CAMPAIGNS[campaign]
    samples = make_samples(library_source(name, kind.variety), number, n_scans, seed, kind)
    return samples if keep else [{**sample, "points": None} for sample in samples]


def write_scans(folder: Path, samples: Iterable[dict[str, Any]]) -> None:
    """Write each scan as text, to a millimetre."""
    for sample in samples:
        path = folder / _listed(sample)[0]
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(path, sample["points"], fmt="%.3f")


def _listed(sample: dict[str, Any]) -> tuple[str, str, str]:
    """Path below the set's folder, species and tree of a sample."""
    species, tree = str(sample["species"]), str(sample["tree"])
    return str(scan_path(Path(), species, tree, int(sample["scan"]))), species, tree


def scan_path(folder: Path, species: str, tree: str, scan: int) -> Path:
    """Where a kept scan lies."""
    return folder / species / f"{tree.replace(' ', '_')}_{scan}.xyz"


def describe_again(path: Path) -> int:
    """Describe the kept scans of one file of a set anew; how many they are."""
    from classify import FEATURES, describe_scan

    samples = _samples(path)
    for sample in samples:
        made = _encoded(np.loadtxt(path.parent / _listed(sample)[0]))
        sample["x"] = describe_scan(made.cloud.xyz, made.tree).array
    save_set(path, samples, [feature.name for feature in FEATURES])
    return len(samples)


def _samples(path: Path) -> list[dict[str, Any]]:
    """The rows of a file as :func:`make_samples` made them, without points."""
    with np.load(path, allow_pickle=False) as file:
        columns = {name.removeprefix("column_"): file[name] for name in file.files if name != "features"}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def main() -> None:
    """Command line."""
    from classify import FEATURES
    from species.library import builtin_library

    parser = ArgumentParser(prog="python -m benchmarks.virtual_set", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--species", default="", help="names, by commas; all of the library if left out")
    parser.add_argument("--trees", type=int, default=40, help="of each species (default 40)")
    parser.add_argument("--scans", type=int, default=2, help="of each tree (default 2)")
    parser.add_argument("--campaign", choices=CAMPAIGNS, default="any", help="what the set is of")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep-scans", action="store_true", help="write the points, too, and scans.csv")
    parser.add_argument("--again", action="store_true", help="describe the scans that were kept anew")
    arguments = parser.parse_args()
    if arguments.again:
        paths = sorted(arguments.folder.glob("*.npz"))
        with ProcessPoolExecutor(arguments.jobs) as pool:
            for path, count in zip(paths, pool.map(describe_again, paths), strict=True):
                print(f"{path.stem}: {count} scans described anew", file=sys.stderr)
        return
    names = [name.strip() for name in arguments.species.split(",") if name.strip()] or builtin_library().names
    arguments.folder.mkdir(parents=True, exist_ok=True)
    listed: list[tuple[str, str, str]] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        run: Callable[..., Iterable[Any]] = pool.map if arguments.jobs > 1 else map
        for name in names:
            path = arguments.folder / f"{name}.npz"
            kept = _samples(path) if path.exists() else []
            first = 1 + max((int(str(sample["tree"])[-4:]) for sample in kept), default=-1)
            more = (arguments.scans, arguments.seed, arguments.campaign, arguments.keep_scans)
            tasks = [(name, number, *more) for number in range(first, arguments.trees)]
            samples = [sample for some in run(_task, tasks) for sample in some]
            print(f"{name}: {len(kept)} and {len(samples)} scans", file=sys.stderr)
            if arguments.keep_scans:
                write_scans(arguments.folder, samples)
                listed += [_listed(sample) for sample in kept + samples]
            if samples:
                save_set(path, kept + samples, [feature.name for feature in FEATURES])
    if listed:
        with (arguments.folder / "scans.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([("path", "species", "tree"), *listed])


if __name__ == "__main__":
    main()
