"""Joint boosting: time, stumps needed with and without sharing, calibration, and "none of these".

``python -m benchmarks.jointboost`` prints all tables; ``--only NAME`` one of them.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.class_problems import coded, mixed, projected

N_CLASSES, N_FEATURES, N_PROPERTIES = 12, 220, 10
TEST_PER_CLASS = 100
SHARED_CLASSES = (4, 8, 16, 25)
LEFT_OUT = (0, 3, 6, 9)
FALSE_REJECTION = 0.05
Row = dict[str, Any]


def species(n_per_class: int, seed: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """The size of the real problem: 12 classes, 220 features, 3% of them missing."""
    return mixed(n_per_class, N_CLASSES, N_FEATURES, seed=seed, spread=spread, n_properties=N_PROPERTIES)


def label_names(y: np.ndarray) -> list[str]:
    return [f"species {k:02d}" for k in y]


def speed() -> list[Row]:
    """Processor time of one training on 12 x 50 samples of 220 features, and accuracy on others."""
    from classify import SPECIES_SETTINGS, BoostSettings, boost
    from classify.stumps import two_sided

    all_settings = {
        "published": BoostSettings(),
        "published, all thresholds": BoostSettings(max_thresholds=None),
        "published, one-versus-rest": BoostSettings(sharing="single"),
        "species": SPECIES_SETTINGS,
    }
    boost(*_weighted(*species(3, 0, 0.8)), BoostSettings(n_rounds=2), np.random.default_rng(0))  # compiles
    x_test, y_test = species(TEST_PER_CLASS, 2, 0.8)
    rows = []
    for name, settings in all_settings.items():
        row: Row = {"settings": name, "rounds": settings.n_rounds}
        for n_per_class in (50, 25):
            x, y = species(n_per_class, 1, 0.8)
            start = process_time()
            stumps = boost(*_weighted(x, y), settings, np.random.default_rng(0)).stumps
            row[f"seconds, 12 x {n_per_class}"] = process_time() - start
            said = two_sided(stumps.scores(x_test)).argmax(axis=1)
            row[f"accuracy, 12 x {n_per_class}"] = float(np.mean(said == y_test))
        row["sharing"] = float(stumps.shared.sum(axis=1).mean())
        rows.append(row)
    return rows


def _weighted(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return x, y, np.ones(len(y))


def training() -> list[Row]:
    """A whole model, calibrated on 10 folds: time to train, size of the file, time for one scan."""
    from classify import encode_model, train_model

    x, y = species(50, 1, 0.8)
    features = [f"feature {k}" for k in range(N_FEATURES)]
    rows = []
    for n_threads in (1, 2):
        wall, start = perf_counter(), process_time()
        model = train_model(
            x, label_names(y), features, rng=np.random.default_rng(0), n_threads=n_threads
        ).model
        row = {"threads": n_threads, "wall_s": perf_counter() - wall, "processor_s": process_time() - start}
        best, _ = report.seconds_of(lambda model=model: (model.classify(x[:1]), model.explain(x[0])), 20)
        rows.append(row | {"file_kB": len(encode_model(model)) / 1e3, "one_scan_ms": 1e3 * best})
    return rows


def sharing() -> list[Row]:
    """Stumps, and features among them, until no more than 5% (discs: 8%) of other samples are wrong."""
    from classify import BoostSettings, boost
    from classify.stumps import two_sided

    rows = []
    for name, make, error in (("codes", coded, 0.05), ("discs", projected, 0.08)):
        for n_classes in SHARED_CLASSES:
            x, y = make(n_classes, 40, 1)
            x_test, y_test = make(n_classes, TEST_PER_CLASS, 2)
            row: Row = {"problem": name, "classes": n_classes}
            for way, words in (("greedy", "shared"), ("single", "one-versus-rest")):
                stumps = boost(*_weighted(x, y), BoostSettings(sharing=way), np.random.default_rng(0)).stumps
                wrong = [np.mean(two_sided(s).argmax(axis=1) != y_test) for s in stumps.staged_scores(x_test)]
                enough = np.flatnonzero(np.array(wrong) <= error)
                k = int(enough[0]) + 1 if enough.size else None
                row[f"stumps, {words}"] = k
                row[f"features, {words}"] = len(set(stumps.feature[:k].tolist())) if k else None
            rows.append(row)
    return rows


def rivals(full: bool = False) -> list[Row]:
    """Accuracy beside scikit-learn's ensembles on the same samples (gradient boosting with --full)."""
    from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier

    from classify import SPECIES_SETTINGS, JointBoostClassifier

    settings = {
        name: getattr(SPECIES_SETTINGS, name) for name in ("n_rounds", "learning_rate", "max_features")
    }
    models = {
        "joint boosting": JointBoostClassifier(random_state=0, **settings),
        "random forest, 500 trees": RandomForestClassifier(500, random_state=0),
    }
    if full:
        models["histogram gradient boosting"] = HistGradientBoostingClassifier(random_state=0)
    rows = []
    for name, model in models.items():
        row: Row = {"model": name}
        for n_per_class in (10, 25, 50):
            found = []
            for seed in (1, 2):
                model.fit(*species(n_per_class, seed, 0.8))
                found.append(model.score(*species(TEST_PER_CLASS, seed + 100, 0.8)))
            row[f"accuracy, 12 x {n_per_class}"] = float(np.mean(found))
        rows.append(row)
    return rows


def calibration() -> list[Row]:
    """Log loss and expected calibration error on other samples, by how the probabilities are made.

    All ways see the same held-out scores of 5 folds and the same stumps.
    """
    rows: dict[str, Row] = {}
    for n_per_class in (10, 25, 50):
        for spread in (0.6, 1.2):
            x_test, y_test = species(TEST_PER_CLASS, 101, spread)
            for way, probability in _calibrated(*species(n_per_class, 1, spread), x_test).items():
                from classify import calibration_error, log_loss

                row = rows.setdefault(way, {"probabilities": way})
                place = f"12 x {n_per_class}, {'easy' if spread < 1.0 else 'hard'}"
                row[place] = (
                    f"{log_loss(probability, y_test):.2f} / {calibration_error(probability, y_test):.3f}"
                )
    return list(rows.values())


def _calibrated(x: np.ndarray, y: np.ndarray, x_test: np.ndarray) -> dict[str, np.ndarray]:
    from sklearn.isotonic import IsotonicRegression
    from sklearn.linear_model import LogisticRegression
    from sklearn.model_selection import StratifiedKFold

    from classify import SPECIES_SETTINGS, boost, fit_temperature, to_probabilities

    def train(rows: np.ndarray) -> Any:
        return boost(*_weighted(x[rows], y[rows]), SPECIES_SETTINGS, np.random.default_rng(0)).stumps

    held_out = np.empty((len(y), N_CLASSES))
    for rows, others in StratifiedKFold(5, shuffle=True, random_state=0).split(x, y):
        held_out[others] = train(rows).scores(x[others])
    scores = train(np.arange(len(y))).scores(x_test)
    sigmoid, steps = np.empty_like(scores), np.empty_like(scores)
    for k in range(N_CLASSES):
        line = LogisticRegression(C=1e3).fit(held_out[:, [k]], y == k)
        sigmoid[:, k] = line.predict_proba(scores[:, [k]])[:, 1]
        steps[:, k] = (
            IsotonicRegression(out_of_bounds="clip").fit(held_out[:, k], y == k).predict(scores[:, k])
        )
    odds = 1.0 / (1.0 + np.exp(-2.0 * scores))
    return {
        "none, each class alone": odds / odds.sum(axis=1, keepdims=True),
        "none, e^(2 H)": to_probabilities(scores, 0.5),
        "none, e^H": to_probabilities(scores, 1.0),
        "one temperature": to_probabilities(scores, fit_temperature(held_out, y)),
        "sigmoid per class": sigmoid / sigmoid.sum(axis=1, keepdims=True),
        "steps per class": (steps + 1e-9) / (steps + 1e-9).sum(axis=1, keepdims=True),
    }


def reliability_table() -> list[Row]:
    """How often the model is right when it says how sure it is: 12 x 50 samples that overlap."""
    from classify import reliability, train_model

    x, y = species(50, 1, 1.2)
    features = [f"feature {k}" for k in range(N_FEATURES)]
    model = train_model(x, label_names(y), features, rng=np.random.default_rng(0)).model
    x_test, y_test = species(TEST_PER_CLASS, 101, 1.2)
    table = reliability(model.probabilities(x_test), y_test)
    names = ("low", "high", "predicted", "observed", "count")
    columns = [getattr(table, name).tolist() for name in names]
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def unknown() -> list[Row]:
    """One of 12 species left out of the training: how many of its samples are called "none of these".

    Beside the model's rule those of its parts, and of the highest probability, each for itself; all with 5%
    of the held-out samples of known species rejected.
    """
    from classify import train_model

    features = [f"feature {k}" for k in range(N_FEATURES)]
    rows = []
    for n_per_class, spread in ((25, 0.6), (50, 0.6), (50, 0.8)):
        x, y = species(n_per_class, 1, spread)
        x_test, y_test = species(TEST_PER_CLASS, 2, spread)
        junk = np.random.default_rng(0).normal(0.0, 30.0, (200, N_FEATURES))
        found = []
        for out in LEFT_OUT:
            model = train_model(
                x[y != out],
                label_names(y[y != out]),
                features,
                rng=np.random.default_rng(0),
                false_rejection=FALSE_REJECTION,
            ).model
            said, known = model.classify(x_test), y_test != out
            parts = {
                "score": -said.score,
                "distance": said.distance,
                "probability": -said.probability.max(axis=1),
            }
            at = {name: v[~known] > np.quantile(v[known], 1.0 - FALSE_REJECTION) for name, v in parts.items()}
            found.append(
                {
                    "asked": FALSE_REJECTION,
                    "measured in training": model.rejection.measured,
                    "known rejected": said.is_unknown[known].mean(),
                    "left out rejected": said.is_unknown[~known].mean(),
                    "junk rejected": model.classify(junk).is_unknown.mean(),
                }
                | {f"{name} alone": rejected.mean() for name, rejected in at.items()}
            )
        mean = {name: float(np.mean([each[name] for each in found])) for name in found[0]}
        rows.append({"training": f"11 x {n_per_class}", "spread": spread} | mean)
    return rows


TABLES: dict[str, Callable[..., list[Row]]] = {
    "speed": speed,
    "training": training,
    "sharing": sharing,
    "rivals": rivals,
    "calibration": calibration,
    "reliability": reliability_table,
    "unknown": unknown,
}


def run(arguments: Namespace) -> None:
    """Print all tables, or the one asked for."""
    for name, make in TABLES.items():
        if arguments.only and arguments.only != name:
            continue
        rows = make(full=arguments.full) if name == "rivals" else make()
        print(f"{(make.__doc__ or '').splitlines()[0]}\n\n{report.table(rows)}\n", flush=True)
        report.write_json(getattr(arguments, "json", None), f"jointboost_{name}", rows)


def main() -> None:
    """Command line."""
    parser = ArgumentParser(prog="python -m benchmarks.jointboost", description=__doc__)
    parser.add_argument("--only", choices=list(TABLES), help="print this table alone")
    parser.add_argument(
        "--full", action="store_true", help="compare with gradient boosting too: minutes more"
    )
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
