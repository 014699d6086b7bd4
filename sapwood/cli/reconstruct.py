"""``reconstruct``: scans become trees."""

from __future__ import annotations

import os
from collections.abc import Generator, Sequence
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from sapwood.cli import options as o
from sapwood.cli.terminal import Progress, Terminal

if TYPE_CHECKING:
    from sapwood.batch import Job, Outcome

STAGES = {"read": "reading", "encode": "finding the tree", "measure": "measuring", "write": "drawing"}
FAILED_ALL, FAILED_OURS, FAILED_SOME = 2, 1, 3
REPORT_IT = "this is a fault of Sapwood; please report it with what -v adds and with `sapwood doctor --json`"


def reconstruct(
    scans: o.Scans,
    output: o.Folder,
    species: o.Species = "auto",
    model: o.ModelFile = None,
    f_s: o.FS = None,
    beta: o.Beta = None,
    gamma: o.Gamma = None,
    max_nodes: o.MaxNodes = None,
    library: o.LibraryFolder = None,
    season: o.SeasonOption = o.Season.summer,
    hulls: o.Hulls = False,
    units: o.UnitsOption = None,
    up: o.UpOption = o.Up.z,
    base: o.Base = None,
    largest: o.Largest = False,
    tree_id: o.TreeId = None,
    keep_ground: o.KeepGround = False,
    max_points: o.MaxPoints = None,
    as_points: o.AsPoints = False,
    decimal: o.DecimalOption = None,
    no_preview: o.NoPreview = False,
    turntable: o.Turntable = False,
    force: o.Force = False,
    resume: o.Resume = False,
    jobs: o.Jobs = 1,
    seed: o.Seed = 0,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Reconstruct the trees in LiDAR scans.

    \b
    Example:  reconstruct oak.laz -o out
              reconstruct plots/ "more/*.ply" -o out --jobs 4

    For each scan NAME it writes:

    \b
    NAME.lobes          the tree, a few kilobytes
    NAME.glb            its mesh, with leaves if its species is known
    NAME.cylinders.csv  its cylinders, in the scan's coordinates
    NAME.png            the scan beside the model
    NAME.json           its measures, and how it was made
    """
    from sapwood.pipeline import asked_species

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    reading = {
        "species": asked_species(species),
        "model": str(model) if model else None,
        "library": str(library) if library else None,
        "f_s": f_s,
        "beta": beta,
        "gamma": gamma,
        "max_nodes": max_nodes,
        **scan_options(units, up, base, largest, tree_id, keep_ground, max_points, as_points, decimal),
    }
    saving: dict[str, Any] = {"preview": not no_preview, "turntable": turntable, "force": force, "seed": seed}
    saving |= {"season": season.value, "leaves": not hulls, "library": str(library) if library else None}
    return run(terminal, scans, output, reading, saving, jobs, resume)


def scan_options(
    units: o.Units | None,
    up: o.Up,
    base: str | None,
    largest: bool,
    tree_id: int | None,
    keep_ground: bool,
    max_points: int | None,
    as_points: bool,
    decimal: o.Decimal | None,
) -> dict[str, Any]:
    """What the user said of the scan, as :func:`sapwood.reconstruct` takes it."""
    said = {
        "units": units.value if units else None,
        "up": up.value,
        "base": o.parse_point(base) if base else None,
        "largest": largest,
        "tree_id": tree_id,
        "keep_ground": keep_ground,
        "max_points": max_points,
        "as_points": as_points,
        "decimal": decimal.value if decimal else None,
    }
    return {key: value for key, value in said.items() if value is not None}


def run(
    terminal: Terminal,
    scans: Sequence[str],
    folder: Path,
    reading: dict[str, Any],
    saving: dict[str, Any],
    n_workers: int,
    resume: bool = False,
) -> int:
    """Do the scans, say what came of them, and return the exit code."""
    from sapwood.batch import DONE, INPUT, Job, Outcome
    from sapwood.outputs import Staging, check_free
    from sapwood.saving import output_names

    start = perf_counter()
    scan_of, refused = _find(terminal, scans)
    _check_options(reading)
    if resume:
        done = [name for name in scan_of if (folder / f"{name}.json").exists()]
        terminal.note(f"{len(done)} of {len(scan_of)} scans are done already and left out")
        scan_of = {name: path for name, path in scan_of.items() if name not in {*done}}
    wanted = {"preview": saving["preview"], "turntable": saving["turntable"]}
    files = [folder / file for name in scan_of for file in output_names(name, **wanted)]
    check_free(files, force=saving["force"])
    _prepare_leaves(terminal, reading, saving)
    outcomes: list[Outcome] = []
    if scan_of:
        terminal.warn_of_compiling()
        with Staging(folder) as staging:
            place = str(folder), str(staging.path)
            jobs = [Job(str(path), name, *place, reading, saving) for name, path in scan_of.items()]
            with closing(_outcomes(terminal, jobs, n_workers)) as coming:  # no worker outlives its folder
                for outcome in coming:
                    outcomes.append(outcome)
                    _say(terminal, outcome, len(outcomes), len(jobs))
    order = {name: k for k, name in enumerate(scan_of)}
    outcomes.sort(key=lambda outcome: order[outcome.job.name])
    for argument, message in refused:
        outcomes.append(Outcome(Job(argument, Path(argument).name, str(folder), ""), INPUT, message))
    failed = [outcome for outcome in outcomes if outcome.kind != DONE]
    for outcome in outcomes:
        if outcome.report is not None:
            terminal.result(describe(outcome.report, outcome.job.folder))
    _say_failures(terminal, failed, len(outcomes))
    terminal.json(
        "reconstruct",
        output=str(folder),
        trees=[outcome.report for outcome in outcomes if outcome.kind == DONE],
        failed=[
            {"scan": f.job.scan, "name": f.job.name, "kind": f.kind, "message": f.message} for f in failed
        ],
        seconds=round(perf_counter() - start, 3),
    )
    return _exit_code(outcomes, failed)


def _find(terminal: Terminal, arguments: Sequence[str]) -> tuple[dict[str, Path], list[tuple[str, str]]]:
    """The scans by the names of their outputs, and the arguments that mean no scan with what is wrong."""
    from sapwood.naming import find_scans, name_scans

    skipped: list[Path] = []
    refused: list[tuple[str, str]] = []
    paths = find_scans(arguments, skipped, refused)
    for path in skipped:
        terminal.note(f"{path}: left out, there are no points in it")
    return dict(zip(name_scans(paths), paths, strict=True)), refused


def _check_options(reading: dict[str, Any]) -> None:
    """Find a misspelt species, a bad model or a value out of range before any scan is read."""
    from sapwood.pipeline import READ_OPTIONS, find_judge, known_species, make_settings

    known_species(reading["species"], reading["library"])
    find_judge(reading["species"], reading["model"])
    skipped = ("species", "library", "model", *READ_OPTIONS)
    make_settings(**{key: value for key, value in reading.items() if key not in skipped})


def _prepare_leaves(terminal: Terminal, reading: dict[str, Any], saving: dict[str, Any]) -> None:
    """Derive the species, unless that is kept: what is wrong with it is said before any scan is read."""
    from sapwood.dressing import open_library
    from sapwood.pipeline import AUTO

    species = reading["species"]
    if species is None or (species != AUTO and not saving.get("leaves", False)):
        return
    library = open_library(reading["library"])
    for fault in library.faults:
        terminal.notice(f"left out: {fault}")
    if species != AUTO:
        library.load(species)


def _outcomes(terminal: Terminal, jobs: Sequence[Job], n_workers: int) -> Generator[Outcome, None, None]:
    """What comes of each scan: one is done here, several by workers."""
    from sapwood.batch import run_batch, run_job

    if len(jobs) == 1:
        with terminal.progress(None, jobs[0].name) as line:
            outcome = run_job(jobs[0], _stage_sayer(line, jobs[0].name))
        yield outcome
        return
    with (
        terminal.progress(len(jobs), "scans") as bar,
        closing(run_batch(jobs, min(n_workers, len(jobs)))) as coming,
    ):
        for outcome in coming:
            bar.advance()
            yield outcome


def _stage_sayer(line: Progress, name: str) -> Any:
    return lambda stage: line.say(f"{name}: {STAGES.get(stage, stage)}")


def _say(terminal: Terminal, outcome: Outcome, done: int, total: int) -> None:
    """One line for a finished scan, and one for each remark on it."""
    from sapwood.batch import DONE

    name = outcome.job.name
    if outcome.kind != DONE or outcome.report is None:
        if total > 1 and not terminal.shows_progress:
            terminal.log(f"[{done}/{total}] {name}: failed")
        return
    for note in outcome.report["notes"]:
        terminal.note(f"{name}: {note}")
    for notice in outcome.notices:
        terminal.notice(notice)
    if total > 1 and not terminal.shows_progress:
        terminal.log(f"[{done}/{total}] {name}: done in {sum(outcome.report['seconds'].values()):.1f} s")


def describe(report: dict[str, Any], folder: str) -> str:
    """A line on a tree."""
    said = [f"{report['height_m']:.1f} m high"]
    if report["dbh_m"] is not None:
        said.append(f"DBH {100 * report['dbh_m']:.1f} cm")
    else:
        said.append(f"no DBH ({report['dbh_reason']})")
    if report["crown_width_m"] is not None:
        said.append(f"crown {report['crown_width_m']:.1f} m wide")
    said.append(f"{1000 * report['wood_volume_m3']:.0f} L of wood")
    said.append(f"{report['n_nodes']} nodes")
    said.append(f"{report['n_clusters']} clusters")
    size = f"{report['bytes'] / 1000:.1f} kB"
    return f"{report['name']}: {', '.join(said)} -> {os.path.join(folder, report['name'])}.lobes ({size})"


def _say_failures(terminal: Terminal, failed: Sequence[Outcome], total: int) -> None:
    from sapwood.batch import DIED, INTERNAL

    if failed and total > 1:
        terminal.error(f"{len(failed)} of {total} scans failed:")
    for outcome in failed:
        ours = f" ({REPORT_IT})" if outcome.kind == INTERNAL else ""
        ours = f" ({REPORT_IT})" if outcome.kind == DIED and "compiled" in outcome.message else ours
        terminal.error(outcome.message + ours, outcome.trace)


def _exit_code(outcomes: Sequence[Outcome], failed: Sequence[Outcome]) -> int:
    from sapwood.batch import INPUT

    if not failed:
        return 0
    if len(failed) < len(outcomes):
        return FAILED_SOME
    return FAILED_ALL if all(outcome.kind == INPUT for outcome in failed) else FAILED_OURS
