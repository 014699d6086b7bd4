"""``species train``: a model that tells species apart, from scans whose species is known."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from sapwood.cli import options as o
from sapwood.cli.classify import describe_scans, exit_code, failures, say_failures
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from classify import Training
    from sapwood.batch import Outcome
    from sapwood.training import Labelled

Source = Annotated[
    Path,
    o.argument(
        "DIR|TABLE.csv", "A folder with one sub-folder of scans per species; or a table path,species."
    ),
]
Output = Annotated[
    Path,
    o.option(
        o.OUTPUT,
        "--output",
        "-o",
        metavar="FILE",
        help="The model; the report goes beside it, with the suffix .json.",
        show_default=False,
    ),
]


def species_train(
    source: Source,
    output: Output,
    units: o.UnitsOption = None,
    up: o.UpOption = o.Up.z,
    largest: o.Largest = False,
    keep_ground: o.KeepGround = False,
    max_points: o.MaxPoints = None,
    as_points: o.AsPoints = False,
    decimal: o.DecimalOption = None,
    jobs: o.Jobs = 1,
    seed: o.Seed = 0,
    force: o.Force = False,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Train a model that tells species apart, from scans whose species is known.

    \b
    Example:  sapwood species train scans -o kinds.model
              sapwood species train scans.csv -o kinds.model --jobs 2
              sapwood classify oak.laz --model kinds.model

    A table has the columns path (relative to it) and species, and where several scans show the same tree
    a column tree, so that none of them is judged by a model that has seen another.
    """
    from classify import encode_model
    from sapwood.cli.reconstruct import scan_options
    from sapwood.outputs import check_free, write_whole
    from sapwood.training import check_enough, find_labelled, report_path, report_training

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    beside = report_path(output)
    check_free([output, beside], force=force)
    start = perf_counter()
    skipped: list[Path] = []
    scans = find_labelled(source, skipped)
    for path in skipped:
        terminal.note(f"{path}: left out, there are no points in it")
    check_enough(scans, source)
    said = scan_options(units, up, None, largest, None, keep_ground, max_points, as_points, decimal)
    outcomes = describe_scans(terminal, [scan.path for scan in scans], jobs, said)
    failed = failures(outcomes)
    good = [scan for scan, outcome in zip(scans, outcomes, strict=True) if outcome.report is not None]
    try:
        check_enough(good, source, "good scans")
    finally:  # what is wrong with the scans is said in any case
        say_failures(terminal, failed, outcomes, len(scans))
    training = _train(terminal, good, outcomes, source.stem, seed, jobs)
    report = report_training(training, good, failed, seed)
    data, text = encode_model(training.model), json.dumps(report, indent=1, ensure_ascii=False) + "\n"
    write_whole(output, lambda path: path.write_bytes(data), force=force)
    write_whole(beside, lambda path: path.write_text(text, encoding="utf-8"), force=force)
    _say(terminal, report, output, len(data))
    files = [str(output), str(beside)]
    terminal.json("species train", **_body(report), files=files, seconds=round(perf_counter() - start, 3))
    return exit_code(failed, len(good))


def _train(
    terminal: Terminal,
    scans: Sequence[Labelled],
    outcomes: Sequence[Outcome],
    name: str,
    seed: int,
    jobs: int,
) -> Training:
    import numpy as np

    from classify import FEATURES, train_model
    from sapwood._version import __version__

    features = [outcome.report["features"] for outcome in outcomes if outcome.report is not None]
    with terminal.progress(None, f"training with {len(scans)} scans"):
        return train_model(
            np.array(features),
            [scan.species for scan in scans],
            [feature.name for feature in FEATURES],
            rng=np.random.default_rng(seed),
            trees=[scan.tree for scan in scans],
            name=name if name.isprintable() and 1 <= len(name) <= 200 else "species",
            provenance={"seed": str(seed), "scans": str(len(scans)), "sapwood": __version__},
            n_threads=jobs,
        )


def _say(terminal: Terminal, report: dict[str, Any], output: Path, n_bytes: int) -> None:
    """A line on each species, and one on the model."""
    for k, name in enumerate(report["classes"]):
        wrong = {report["classes"][j]: n for j, n in enumerate(report["confusion"][k]) if n and j != k}
        others = ", ".join(f"{n} as {other}" for other, n in wrong.items())
        right = f"{report['confusion'][k][k]} of {report['scans'][name]} recognised when held out"
        terminal.result(f"{name}: {right}{f' ({others})' if others else ''}")
    terminal.result(
        f"{output}: {len(report['classes'])} species, {sum(report['scans'].values())} scans, accuracy "
        f"{report['accuracy']:.1%} held out, calibration error {report['calibration_error']:.3f}, "
        f"{n_bytes / 1000:.0f} kB"
    )


def _body(report: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in report.items() if key != "schema_version"}
