"""Which species is it: the published experiment on virtual scans, and what happens when the scans change.

    python -m benchmarks.virtual_set CITY --campaign city --trees 60 --scans 1 --jobs 2
    python -m benchmarks.virtual_set ANY --trees 200 --scans 2 --jobs 2
    python -m benchmarks.recognition CITY --only protocol --jobs 2
    python -m benchmarks.recognition ANY --only shifts
    python -m benchmarks.recognition ANY --only foreign --jobs 2
    python -m benchmarks.recognition --only conifers --data DIR
    python -m benchmarks.recognition --only real --data DIR
    python -m benchmarks.recognition --only cost --data DIR

*protocol*: twelve species with the numbers of scans of figure 3.9 of S. Pirk's thesis (University of
Konstanz, 2013), one scan of a tree, half of each species for training, at random, again and again. The trees
that were not trained with then stand in streets of one species, and mixed at random, and the neighbours vote.
*shifts*: training on one kind of scans and testing, on other trees, on another kind. *foreign*: scans
of a species that was left out in training, how many of them are called "none of these". *conifers*: real
airborne scans of four conifers, beside two classifiers of scikit-learn. *real*: what the model that comes
along says of real scans. *cost*: the time that asking it takes beside ``reconstruct``.
"""

from __future__ import annotations

import json
import os
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks import data, report
from benchmarks.virtual_set import VirtualSet, load_set

Row = dict[str, Any]
#: Figure 3.9: scans for training and scans in all, and the percentage recognised.
PUBLISHED = {
    "Mahogany": (14, 29, 96.1),
    "Ficus benjamina": (23, 47, 97.0),
    "Ficus microcarpa": (22, 44, 98.8),
    "Bischofia polycarpa": (25, 50, 91.3),
    "Delonix": (26, 53, 99.9),
    "Lagerstroemia": (16, 32, 80.3),
    "Ailanthus altissima": (22, 44, 97.9),
    "Palm": (25, 50, 96.6),
    "Terminalia": (25, 51, 98.2),
    "Pine": (12, 24, 98.3),
    "Ficus Virens": (19, 39, 98.7),
    "Willow": (6, 12, 92.8),
}
HEIGHT = ("height",)
N_SPLITS = 100
TABLES = ("protocol", "shifts", "foreign", "conifers", "real", "cost")
N_FOLDS = 2  # in which the scans of a training are held out to calibrate it
STREET, ALONG, ACROSS = 10, 8.0, 30.0  # trees of a street, and metres between trees and between streets
SHIFT_SEEDS = 2
#: Share of known scans that may be called "none of these", and how much of it for their distance: as
#: ``species train`` and as the model that comes along.
REJECTIONS = ((0.05, 0.2), (0.25, 0.5))
CONIFER_SEEDS = 3


def take(found: VirtualSet, rows: np.ndarray) -> VirtualSet:
    """Some of the scans."""
    columns = {name: value[rows] for name, value in found.columns.items()}
    return VirtualSet(found.x[rows], found.features, found.species[rows], found.tree[rows], columns)


def published_set(found: VirtualSet) -> VirtualSet:
    """One scan of each of the first trees of the twelve species, as many as figure 3.9 has."""
    rows: list[int] = []
    for name, (_, total, _) in PUBLISHED.items():
        mine = np.flatnonzero(found.species == name)
        _, first = np.unique(found.tree[mine], return_index=True)
        if len(first) < total:
            raise SystemExit(f"the set has {len(first)} trees of {name}, and the experiment needs {total}")
        rows += mine[first[:total]].tolist()
    return take(found, np.array(rows))


def _train(x: np.ndarray, species: np.ndarray, trees: np.ndarray, features: np.ndarray, seed: int) -> Any:
    from classify import train_model

    rng = np.random.default_rng(seed)
    names = [str(name) for name in features]
    return train_model(x, [str(s) for s in species], names, rng=rng, trees=list(trees), n_folds=N_FOLDS)


def split(found: VirtualSet, columns: tuple[str, ...] | None, seed: int) -> Row:
    """One of the published experiments: the confusion (12, 12), and shares right without and with a vote."""
    from classify import reliable_ratio, vote_species

    rng = np.random.default_rng([seed, 39])
    is_train = np.zeros(len(found), bool)
    for name, (n_train, _, _) in PUBLISHED.items():
        is_train[rng.permutation(np.flatnonzero(found.species == name))[:n_train]] = True
    used = _columns(found, columns)
    training = _train(
        found.x[is_train][:, used], found.species[is_train], found.tree[is_train], found.features[used], seed
    )
    model = training.model
    probability = model.probabilities(found.x[~is_train][:, used])
    order = list(PUBLISHED)
    probability = probability[:, [model.classes.index(name) for name in order]]
    true = np.array([order.index(name) for name in found.species[~is_train]])
    said = probability.argmax(axis=1)
    confusion = np.zeros((len(order),) * 2)
    np.add.at(confusion, (true, said), 1.0)
    ratio = reliable_ratio(training.probability, training.label)
    row: Row = {"confusion": confusion, "right": float((said == true).mean()), "ratio learnt": ratio}
    for layout, place in {"streets": streets(true, rng), "mixed": mixed(len(true), rng)}.items():
        for score in ("own", "neighbours"):
            vote = vote_species(place, probability, score=score)  # type: ignore[arg-type]
            row[f"{layout}, {score}"] = float((vote.label == true).mean())
        vote = vote_species(place, probability, ratio=ratio)
        row[f"{layout}, ratio learnt"] = float((vote.label == true).mean())
    return row


def _columns(found: VirtualSet, names: tuple[str, ...] | None) -> np.ndarray:
    if names is None:
        return np.arange(len(found.features))
    return np.array([found.features.tolist().index(name) for name in names])


def streets(true: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Places (n, 2) along streets: rows of at most ten trees of one species, 8 m apart, in random order.

    The next row of a street begins 16 m on, so that the trees at its ends have neighbours of another species;
    the next street is 30 m away.
    """
    rows: list[np.ndarray] = []
    for species in np.unique(true):
        mine = rng.permutation(np.flatnonzero(true == species))
        rows += [mine[k : k + STREET] for k in range(0, len(mine), STREET)]
    place = np.zeros((len(true), 2))
    x, y = 0.0, 0.0
    for k in rng.permutation(len(rows)):
        row = rows[k]
        place[row] = np.stack([x + ALONG * np.arange(len(row)), np.full(len(row), y)], axis=1)
        x += ALONG * len(row) + ALONG
        if x > 3 * STREET * ALONG:
            x, y = 0.0, y + ACROSS
    return place


def mixed(n: int, rng: np.random.Generator) -> np.ndarray:
    """Places (n, 2): the same density, and any tree anywhere."""
    side = np.sqrt(n * ALONG * ACROSS)
    return rng.uniform(0.0, side, (n, 2))


def protocol(found: VirtualSet, n_splits: int, jobs: int) -> list[Row]:
    """The published experiment with all features, without those of leaves, and with the height alone."""
    from classify import FEATURES

    chosen = published_set(found)
    heights = chosen.columns["height"]
    folds = [float(np.ptp(np.log(heights[chosen.species == name]))) for name in PUBLISHED]
    print(f"least factor between a species' lowest and highest tree: {np.exp(min(folds)):.2f}\n")
    larger = tuple(feature.name for feature in FEATURES if feature.group != "leaves and twigs")
    rows: list[Row] = []
    for what, columns, n in (
        ("all features", None, n_splits),
        ("without leaves and twigs", larger, max(n_splits // 5, 1)),
        ("height alone", HEIGHT, max(n_splits // 5, 1)),
    ):
        found_rows = list(_each(partial(split, chosen, columns), range(n), jobs))
        confusion = np.sum([row["confusion"] for row in found_rows], axis=0)
        by_class = confusion / confusion.sum(axis=1, keepdims=True)
        row = {"features": what, "splits": n, "mean of species": float(np.diag(by_class).mean())}
        row |= {
            key: float(np.mean([r[key] for r in found_rows])) for key in found_rows[0] if key != "confusion"
        }
        rows.append(row)
        if columns is None:
            print(report.table(_figure(by_class)))
            print()
    print(report.table(rows))
    print()
    return rows


def _figure(by_class: np.ndarray) -> list[Row]:
    """The confusion as figure 3.9 has it, in percent, with the published diagonal beside it."""
    names = list(PUBLISHED)
    return [
        {
            "species": f"{name} {PUBLISHED[name][0]}/{PUBLISHED[name][1]}",
            "published": f"{PUBLISHED[name][2]:.1f}",
            **{other[:7]: f"{100.0 * by_class[i, j]:.1f}" for j, other in enumerate(_short(names))},
        }
        for i, name in enumerate(names)
    ]


def _short(names: Iterable[str]) -> list[str]:
    return [name.split()[-1].capitalize() if name.startswith("Ficus") else name.split()[0] for name in names]


def _each(work: Callable[[int], Row], seeds: Iterable[int], jobs: int) -> Iterable[Row]:
    if jobs == 1:
        return map(work, seeds)
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(work, seeds))


def kinds_of_scans(found: VirtualSet) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """What is changed from training to test: which scans may take part, and the two kinds."""
    column = found.columns
    ground = column["kind"] != "air"
    everywhere = np.ones(len(found), bool)
    points = column["n_points"]
    low, high = np.quantile(points[ground], [1 / 3, 2 / 3])
    sheds = np.isin(found.species, np.unique(found.species[column["season"] == "bare"]))
    one, many = ground & (column["n_stations"] == 1), ground & (column["n_stations"] >= 3)
    return {
        f"points: over {high:.0f} / under {low:.0f}": (
            everywhere,
            ground & (points > high),
            ground & (points < low),
        ),
        "leaves: in leaf / bare": (sheds, column["season"] != "bare", column["season"] == "bare"),
        "stations: three or four / one": (everywhere, many, one),
        "seen from: ground / air": (everywhere, ground, ~ground),
        "things in the way: none / some": (everywhere, column["n_hiding"] == 0, column["n_hiding"] > 0),
        "grown: in the open / in a stand or beside a wall": (
            everywhere,
            column["place"] == "open",
            column["place"] != "open",
        ),
        "trunk: as grown / pruned": (everywhere, column["pruned"] == 0.0, column["pruned"] > 0.0),
    }


def shifts(found: VirtualSet) -> list[Row]:
    """Accuracy where training and test are of the one kind of scans or the other, always on other trees."""
    from classify import SPECIES_SETTINGS, boost
    from classify.stumps import two_sided

    rows: list[Row] = []
    _, label = np.unique(found.species, return_inverse=True)
    for what, (allowed, first, second) in kinds_of_scans(found).items():
        sums: dict[str, list[float]] = {}
        for seed in range(SHIFT_SEEDS):
            rng = np.random.default_rng([seed, 7])
            names = np.unique(found.tree)
            in_train = np.isin(found.tree, names[rng.random(len(names)) < 0.6])
            kinds = {"A": allowed & first, "B": allowed & second}
            size = min(int((in_train & kind).sum()) for kind in kinds.values())
            mixture = np.concatenate(
                [rng.permutation(np.flatnonzero(in_train & kind))[: size // 2] for kind in kinds.values()]
            )
            trainings = {
                k: rng.permutation(np.flatnonzero(in_train & kind))[:size] for k, kind in kinds.items()
            }
            for name, train in {**trainings, "both": mixture}.items():
                classes, own = np.unique(label[train], return_inverse=True)
                fit = boost(
                    found.x[train], own, np.ones(len(train)), SPECIES_SETTINGS, np.random.default_rng(seed)
                )
                for k, kind in kinds.items():
                    test = ~in_train & kind & np.isin(label, classes)
                    said = classes[two_sided(fit.stumps.scores(found.x[test])).argmax(axis=1)]
                    sums.setdefault(f"{name} -> {k}", []).append(float((said == label[test]).mean()))
        rows.append(
            {"A / B": what, "scans": size, **{key: float(np.mean(value)) for key, value in sums.items()}}
        )
        print(f"{rows[-1]}", flush=True)
    print()
    print(report.table(rows))
    print()
    return rows


def foreign_share(found: VirtualSet, k: int) -> Row:
    """How much of the k-th species is called "none of these" by models of half of all other trees."""
    from classify import train_model

    name = str(np.unique(found.species)[k])
    rng = np.random.default_rng([k, 5])
    trees = np.unique(found.tree)
    known = found.species != name
    in_train = np.isin(found.tree, trees[rng.random(len(trees)) < 0.5]) & known
    row: Row = {"species left out": name}
    for share, distance_share in REJECTIONS:
        model = train_model(
            found.x[in_train],
            [str(species) for species in found.species[in_train]],
            [str(feature) for feature in found.features],
            rng=np.random.default_rng(0),
            trees=list(found.tree[in_train]),
            n_folds=3,
            false_rejection=share,
            distance_share=distance_share,
        ).model
        for what, rows in {"its scans": ~known, "known": known & ~in_train}.items():
            row[f"{what}, {share:.0%}"] = float(model.classify(found.x[rows]).is_unknown.mean())
    return row


def foreign(found: VirtualSet, jobs: int) -> list[Row]:
    """Share of scans that are called "none of these", of species left out and of trees not trained with."""
    rows = list(_each(partial(foreign_share, found), range(len(np.unique(found.species))), jobs))
    keys = list(rows[0])[1:]
    rows.append({"species left out": "mean", **{key: float(np.mean([r[key] for r in rows])) for key in keys}})
    print(report.table(rows))
    print()
    return rows


def run(arguments: Namespace) -> list[Row]:
    """All tables that are asked for."""
    only = getattr(arguments, "only", None) or None
    rows: list[Row] = []
    if getattr(arguments, "set", None):
        found = load_set(arguments.set)
        if only in (None, "protocol"):
            rows += protocol(found, arguments.splits, arguments.jobs)
        if only in (None, "shifts"):
            rows += shifts(found)
        if only in (None, "foreign"):
            rows += foreign(found, arguments.jobs)
    root = Path(arguments.data) if getattr(arguments, "data", None) else None
    if only in (None, "conifers"):
        rows += conifers(root)
    if only in (None, "real"):
        rows += real(root, getattr(arguments, "model", None))
    if only in (None, "cost"):
        rows += cost(root)
    report.write_json(getattr(arguments, "json", None), "recognition", rows)
    return rows


CONIFERS = {"ab": "silver fir", "ar": "Norway spruce", "la": "larch", "pc": "Swiss stone pine"}


def conifers(root: Path | None) -> list[Row]:
    """Four conifers from the air, split by file into ten folds: JointBoost beside what scikit-learn has."""
    from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
    from sklearn.impute import SimpleImputer
    from sklearn.model_selection import StratifiedKFold, cross_val_predict
    from sklearn.pipeline import make_pipeline

    from classify import SPECIES_SETTINGS, JointBoostClassifier

    if root is None:
        print(f"no data folder: give --data DIR or set {data.DATA_VARIABLE}")
        return []
    x, label = _conifer_features(root / "local" / "eqv_als_conifers")
    if not len(x):
        print("(no conifers)")
        return []
    shares: dict[str, list[float]] = {}
    for seed in range(CONIFER_SEEDS):
        s = SPECIES_SETTINGS
        models = {
            "JointBoost": JointBoostClassifier(
                n_rounds=s.n_rounds,
                learning_rate=s.learning_rate,
                max_features=s.max_features,
                random_state=seed,
            ),
            "HistGradientBoosting": HistGradientBoostingClassifier(random_state=seed),
            "random forest": make_pipeline(
                SimpleImputer(strategy="median"), RandomForestClassifier(500, random_state=seed)
            ),
        }
        folds = StratifiedKFold(10, shuffle=True, random_state=seed)
        for name, model in models.items():
            said = cross_val_predict(model, x, label, cv=folds)
            shares.setdefault(name, []).append(float((said == label).mean()))
    rows = [
        {"classifier": name, "recognised": float(np.mean(v)), "least": min(v), "most": max(v)}
        for name, v in shares.items()
    ]
    print(report.table(rows))
    print()
    return rows


def _conifer_features(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    from classify import describe_scan
    from recon import encode_with_report, read_cloud

    x, label = [], []
    for part, name in CONIFERS.items():
        for path in sorted((folder / part).glob("*.laz")):
            made = encode_with_report(read_cloud(path))
            x.append(describe_scan(made.cloud.xyz, made.tree).array)
            label.append(name)
    found = np.array(x).reshape(len(x), -1)
    known = np.isfinite(found).mean(axis=0) > 0.5  # scikit-learn's boosting fails where all is missing
    return found[:, known], np.array(label)


#: Real scans whose genus is known, and the species of the library that is of it: None, there is none.
KNOWN = {
    "treels/pine": "Pine",
    "treels/spruce": "Spruce",
    "pytlidar/tree_1 (palm)": "Palm",
    "woodske/huangshan_pine": "Pine",
    "woodske/alaska_cedar": None,
    "woodske/green_ash": None,
    "woodske/orange": None,
}
CONIFER_KINDS = {"ab": None, "ar": "Spruce", "la": None, "pc": "Pine"}


def real(root: Path | None, model: Any = None) -> list[Row]:
    """What the model that comes along says of real scans, as ``reconstruct`` asks it."""
    import sapwood

    if root is None:
        print(f"no data folder: give --data DIR or set {data.DATA_VARIABLE}")
        return []

    def say(path: Path) -> Row:
        made = sapwood.reconstruct(path, model=model).recognised or {}
        first = next(iter(made["probabilities"]), None)
        return {"first": first, "p": made["probability"], "none of these": made["species"] is None} | {
            "taken": made["taken"]
        }

    rows: list[Row] = []
    for scan in data.SCANS:
        if scan.name in KNOWN and (root / scan.path).is_file():
            rows.append(
                {"scan": scan.name, "is": KNOWN[scan.name] or "(no species here)", **say(root / scan.path)}
            )
    print(report.table(rows))
    print()
    groups: list[Row] = []
    for part, name in CONIFERS.items():
        said = [say(path) for path in sorted((root / "local" / "eqv_als_conifers" / part).glob("*.laz"))]
        if said:
            right = [one["first"] == CONIFER_KINDS[part] for one in said]
            groups.append(
                {
                    "30 airborne scans each": name,
                    "is": CONIFER_KINDS[part] or "(no species here)",
                    "first is right": sum(right),
                    "none of these": sum(one["none of these"] for one in said),
                    "taken, right": sum(one["taken"] and ok for one, ok in zip(said, right, strict=True)),
                    "taken, wrong": sum(one["taken"] and not ok for one, ok in zip(said, right, strict=True)),
                }
            )
    print(report.table(groups))
    print()
    return rows + groups


def cost(root: Path | None) -> list[Row]:
    """What asking the model adds to ``reconstruct`` with all its files; and making a taken tree again."""
    import sapwood

    if root is None:
        print(f"no data folder: give --data DIR or set {data.DATA_VARIABLE}")
        return []
    rows: list[Row] = []
    there = [scan for scan in data.SCANS if (root / scan.path).is_file()]
    for scan in there[:1]:
        sapwood.reconstruct(root / scan.path)  # what is compiled or loaded once is not counted
    for scan in there:
        with TemporaryDirectory() as folder:
            made = sapwood.reconstruct(root / scan.path)
            made.save(folder)
            seconds = json.loads((Path(folder) / f"{made.name}.json").read_text(encoding="utf-8"))["seconds"]
        asked, again = seconds["classify"], seconds.get("again", 0.0)
        rest = sum(seconds.values()) - asked - again
        row = {"scan": scan.name, "points": len(made.cloud.xyz), "reconstruct s": rest, "asking s": asked}
        rows.append(row | {"adds": asked / rest, "again s": again, "with it": (asked + again) / rest})
    print(report.table(rows))
    print()
    return rows


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.recognition", description=__doc__.splitlines()[0])
    parser.add_argument("set", type=Path, nargs="?", help="folder of benchmarks.virtual_set")
    parser.add_argument("--only", choices=TABLES, help="only this table")
    parser.add_argument(
        "--splits", type=int, default=N_SPLITS, help=f"of the experiment (default {N_SPLITS})"
    )
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--data", type=Path, default=os.environ.get(data.DATA_VARIABLE), help="folder of the scans"
    )
    parser.add_argument(
        "--model", type=Path, help="asked about real scans (default: the one that comes along)"
    )
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
