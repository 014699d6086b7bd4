"""``fit``: the growth parameters whose trees resemble the given ones."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from inverse import Fit
    from sapwood.fitting import Budget
    from treegraph import TreeGraph

SEARCH = "The search"


class Method(StrEnum):
    """Ways of fitting."""

    evolution = "evolution"
    annealing = "annealing"


Trees = Annotated[list[Path], o.argument("TREE", "A tree, .lobes or .swc; or several of one kind.")]
Output = Annotated[
    Path,
    o.option(
        o.OUTPUT,
        "--output",
        "-o",
        metavar="FILE.toml",
        help="Growth parameters, for `sapwood grow`.",
        show_default=False,
    ),
]
BudgetOption = Annotated[
    str | None,
    o.option(
        SEARCH,
        "--budget",
        metavar="N|TIME",
        help="Trees grown and compared per run, or a time for all, as in 90s or 5min. (default: 6000; of "
        "annealing 60000)",
    ),
]
MethodOption = Annotated[Method, o.option(SEARCH, "--method", help="annealing is the published one.")]
Runs = Annotated[
    int,
    o.option(
        SEARCH, "--runs", metavar="N", min=1, max=100, help="From different random numbers; the best is kept."
    ),
]
Fixed = Annotated[
    list[str] | None,
    o.option(SEARCH, "--fix", metavar="NAME=X", help="A parameter that is not searched; repeatable."),
]
Bounds = Annotated[
    list[str] | None,
    o.option(SEARCH, "--bounds", metavar="NAME=LOW:HIGH", help="Where it is searched; repeatable."),
]
SkeletonOnly = Annotated[
    bool,
    o.option(
        o.TREE,
        "--skeleton-only",
        help="Fit the branches that are there; by default a scan's go on into its leaf clusters.",
    ),
]
Branches = Annotated[
    int | None,
    o.option(
        o.TREE, "--branches", metavar="N", min=1, help="Leave the thinnest out, until so many are left."
    ),
]
Curve = Annotated[
    Path | None,
    o.option(
        o.OUTPUT,
        "--picture",
        metavar="FILE",
        help="Draw how the distance fell with the trees grown: .png or .jpg.",
    ),
]
Jobs = Annotated[
    int,
    o.option(
        o.RUN,
        "--jobs",
        "-j",
        metavar="N",
        min=1,
        help="Processes, of several runs; threads of a single one.",
    ),
]
DaskAddress = Annotated[
    str | None,
    o.option(
        o.RUN,
        "--dask",
        metavar="ADDRESS",
        help="Spread the runs over the Dask cluster of this scheduler, as in tcp://127.0.0.1:8786.",
    ),
]
Checkpoint = Annotated[
    Path | None,
    o.option(
        o.RUN,
        "--checkpoint",
        metavar="FILE",
        help="Keep the state here; if it is there, go on from it. The result is the same.",
    ),
]


def fit(
    trees: Trees,
    output: Output,
    budget: BudgetOption = None,
    method: MethodOption = Method.evolution,
    runs: Runs = 1,
    fixed: Fixed = None,
    bounds: Bounds = None,
    skeleton_only: SkeletonOnly = False,
    branches: Branches = None,
    picture: Curve = None,
    checkpoint: Checkpoint = None,
    jobs: Jobs = 1,
    dask: DaskAddress = None,
    seed: o.Seed = 0,
    force: o.Force = False,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Find growth parameters whose trees resemble a given one.

    \b
    Example:  sapwood fit out/oak.lobes -o oak.toml --budget 5min
              sapwood fit a.swc b.swc -o kind.toml --runs 4 --fix NLB=2
              sapwood grow oak.toml --seed 7 -o brother.glb

    Angles, the distance of forks and the height are read off the trees; from there the search begins.
    """
    from sapwood.curves import check_curve_name, draw_curves
    from sapwood.fitting import format_fit, parse_bounds, parse_budget, parse_fixed, read_target
    from sapwood.outputs import check_free, write_whole

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    made = [output] + ([] if picture is None else [picture])
    check_free(made, force=force)
    _check_suffix(output)
    if picture is not None:
        check_curve_name(picture)
    _check_places(made, checkpoint, trees)
    limits = parse_budget(budget) if budget is not None else None
    how: dict[str, Any] = {"bounds": parse_bounds(bounds or []), "fixed": parse_fixed(fixed or [])}
    terminal.warn_of_compiling()
    start = perf_counter()
    how |= {"runs": runs, "checkpoint": checkpoint, "seed": seed}
    graphs = [read_target(path, crown=not skeleton_only, branches=branches) for path in trees]
    found = _fit(terminal, trees, graphs, limits, method.value, jobs, dask, **how)
    text = format_fit(found, output.stem, trees, method.value, seed)
    write_whole(output, lambda path: path.write_text(text, encoding="utf-8"), force=force)
    if picture is not None:
        write_whole(picture, lambda path: draw_curves(found.curves, path), force=force)
    if found.status == "stopped" and method == Method.annealing:
        terminal.note("time ran out before the search was done")
    terminal.result(
        f"{output}: distance {found.distance:.4f} (shape {found.shape:.4f}, geometry {found.geometry:.4f}, "
        f"structure {found.structure:.4f}), {found.age} cycles, {found.evaluations} evaluations"
    )
    _say_json(terminal, trees, output, picture, found, perf_counter() - start)
    return 0


def _fit(
    terminal: Terminal, paths: list[Path], graphs: list[TreeGraph], budget: Budget | None, method: str,
    jobs: int, dask: str | None, **how: Any,
) -> Fit:  # fmt: skip
    from inverse import fit_trees
    from sapwood.spreading import open_workplace

    with (
        open_workplace(how["runs"], jobs, dask) as place,
        terminal.progress(None, f"{', '.join(map(str, paths))}: fitting") as bar,
    ):
        return fit_trees(
            graphs,
            method=method,
            executor=place.executor,
            workers=place.threads,
            settings=_settings(method, budget),
            seconds=None if budget is None else budget.seconds,
            progress=lambda p: bar.say(
                f"run {p.run + 1} of {p.runs}, {p.share:.0%}, distance {p.distance:.3f}"
            ),
            **how,
        )


def _settings(method: str, budget: Budget | None) -> Any:
    """The method's, with as many evaluations as the budget has; of a time the default method uses all."""
    from inverse import AnnealingSettings, EvolutionSettings

    if budget is not None and budget.seconds is not None and method != "annealing":
        return None
    evaluations = None if budget is None else budget.evaluations
    if method == "annealing":
        samples = AnnealingSettings().samples
        return (
            AnnealingSettings() if evaluations is None else AnnealingSettings(max(evaluations // samples, 1))
        )
    return EvolutionSettings() if evaluations is None else EvolutionSettings(evaluations)


def _check_suffix(output: Path) -> None:
    from treegraph.errors import InputError

    if output.suffix.lower() != ".toml":
        raise InputError(f"{output}: the name of fitted parameters must end in .toml.")


def _check_places(made: list[Path], checkpoint: Path | None, trees: list[Path]) -> None:
    """Whether what a fit ends with can be written: known before it, not after hours."""
    from sapwood.outputs import Staging
    from treegraph.errors import InputError

    if checkpoint is not None and checkpoint.resolve() in {path.resolve() for path in [*made, *trees]}:
        raise InputError(f"{checkpoint}: the checkpoint must have a name of its own.")
    for path in made:
        with Staging(path.parent):
            pass


def _say_json(
    terminal: Terminal, trees: list[Path], output: Path, picture: Path | None, found: Fit, seconds: float
) -> None:
    terminal.json(
        "fit",
        input=[str(path) for path in trees],
        output=str(output),
        picture=None if picture is None else str(picture),
        distance=found.distance,
        shape=found.shape,
        geometry=found.geometry,
        structure=found.structure,
        age=found.age,
        tip_share=found.tip_share,
        parameters=found.parameters.symbols(),
        distances=list(found.distances),
        runs=list(found.runs),
        spread={key: None if value != value else value for key, value in found.spread.items()},
        curves=[[list(pair) for pair in curve] for curve in found.curves],
        evaluations=found.evaluations,
        grown=found.grown,
        compared=found.compared,
        status=found.status,
        seconds=round(seconds, 3),
    )
