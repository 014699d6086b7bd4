"""``classify``: which species the trees in scans are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from classify import SpeciesModel
    from sapwood.batch import Outcome

N_OTHERS = 2


def classify(
    scans: o.Scans,
    model: o.ModelFile = None,
    units: o.UnitsOption = None,
    up: o.UpOption = o.Up.z,
    base: o.Base = None,
    largest: o.Largest = False,
    tree_id: o.TreeId = None,
    keep_ground: o.KeepGround = False,
    max_points: o.MaxPoints = None,
    as_points: o.AsPoints = False,
    decimal: o.DecimalOption = None,
    jobs: o.Jobs = 1,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Say which species the trees in scans are, how sure that is, and what spoke for it.

    \b
    Example:  sapwood classify oak.laz
              sapwood classify plots --model kinds.model --json

    A scan that resembles none of the model's species is said to be of none of these.
    """
    from sapwood.batch import DONE, INPUT
    from sapwood.classifying import find_model
    from sapwood.cli.reconstruct import scan_options
    from sapwood.naming import find_scans

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    trained = find_model(model)
    start = perf_counter()
    skipped: list[Path] = []
    refused: list[tuple[str, str]] = []
    paths = find_scans(scans, skipped, refused)
    for path in skipped:
        terminal.note(f"{path}: left out, there are no points in it")
    said = scan_options(units, up, base, largest, tree_id, keep_ground, max_points, as_points, decimal)
    outcomes = describe_scans(terminal, paths, jobs, said)
    answers = [_answer(trained, outcome) for outcome in outcomes if outcome.kind == DONE]
    for answer in answers:
        _say(terminal, answer)
    failed = failures(outcomes)
    failed += [{"file": given, "kind": INPUT, "message": message} for given, message in refused]
    say_failures(terminal, failed, outcomes, len(outcomes) + len(refused))
    terminal.json(
        "classify",
        model=str(model) if model else trained.name,
        scans=answers,
        failed=failed,
        seconds=round(perf_counter() - start, 3),
    )
    return exit_code(failed, len(answers))


def describe_scans(
    terminal: Terminal, paths: Sequence[Path], n_workers: int, options: Mapping[str, Any]
) -> list[Outcome]:
    """The features of scans, in their order: one is described here, several by workers.

    `options` are those of :func:`sapwood.reconstruct`.
    """
    from sapwood.batch import DONE, Job, run_batch
    from sapwood.classifying import describe_job

    jobs = [Job(str(path), str(k), "", "", options) for k, path in enumerate(paths)]
    if not jobs:
        return []
    terminal.warn_of_compiling()
    if len(jobs) == 1:
        with terminal.progress(None, jobs[0].scan):
            outcomes = [describe_job(jobs[0])]
    else:
        outcomes = []
        workers = run_batch(jobs, min(n_workers, len(jobs)), describe_job)
        with terminal.progress(len(jobs), "scans") as bar, closing(workers) as coming:
            for outcome in coming:
                outcomes.append(outcome)
                bar.advance()
                if not terminal.shows_progress:
                    state = "done" if outcome.kind == DONE else "failed"
                    terminal.log(f"[{len(outcomes)}/{len(jobs)}] {outcome.job.scan}: {state}")
    outcomes.sort(key=lambda outcome: int(outcome.job.name))
    for outcome in outcomes:
        for note in (outcome.report or {}).get("notes", ()):
            terminal.note(f"{outcome.job.scan}: {note}")
    return outcomes


def failures(outcomes: Sequence[Outcome]) -> list[dict[str, str]]:
    """The scans that could not be described, and why."""
    from sapwood.batch import DONE

    return [
        {"file": outcome.job.scan, "kind": outcome.kind, "message": outcome.message}
        for outcome in outcomes
        if outcome.kind != DONE
    ]


def say_failures(
    terminal: Terminal, failed: Sequence[dict[str, str]], outcomes: Sequence[Outcome], total: int
) -> None:
    """A line for each scan that failed; of our own faults also where to report them."""
    from sapwood.batch import INTERNAL
    from sapwood.cli.reconstruct import REPORT_IT

    traces = {outcome.job.scan: outcome.trace for outcome in outcomes}
    if failed and total > 1:
        terminal.error(f"{len(failed)} of {total} scans failed:")
    for each in failed:
        ours = f" ({REPORT_IT})" if each["kind"] == INTERNAL else ""
        terminal.error(each["message"] + ours, traces.get(each["file"], ""))


def exit_code(failed: Sequence[dict[str, str]], n_done: int) -> int:
    """0 if nothing failed, 3 if something is done, else 2, or 1 where the fault is ours."""
    from sapwood.batch import INPUT
    from sapwood.cli.reconstruct import FAILED_ALL, FAILED_OURS, FAILED_SOME

    if not failed:
        return 0
    if n_done:
        return FAILED_SOME
    return FAILED_ALL if all(each["kind"] == INPUT for each in failed) else FAILED_OURS


def _answer(model: SpeciesModel, outcome: Outcome) -> dict[str, Any]:
    from sapwood.classifying import say_species

    assert outcome.report is not None
    return {"file": outcome.job.scan, **say_species(model, outcome.report["features"])}


def _say(terminal: Terminal, answer: dict[str, Any]) -> None:
    """Two lines on a scan: what it is, and why."""
    ranked = [f"{name} {p:.2f}" for name, p in answer["probabilities"].items()]
    if answer["species"] is None:
        terminal.result(f"{answer['file']}: none of these (most like {', '.join(ranked[: 1 + N_OTHERS])})")
    else:
        terminal.result(f"{answer['file']}: {ranked[0]} ({', '.join(ranked[1 : 1 + N_OTHERS])})")
    terminal.result(f"  what spoke for it: {', '.join(map(_shown, answer['features'])) or '-'}")


def _shown(feature: dict[str, Any]) -> str:
    if feature["value"] is None:
        return f"{feature['name']} missing"
    return f"{feature['name']} {feature['value']:.3g} {feature['unit']}".rstrip()
