"""``grow``: a tree from the parameters of the growth model."""

from __future__ import annotations

import math
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from sapwood.growing import Group, Request
    from species import Preset

AROUND = "Its surroundings"
MOVING_SIZE, SERIES_SIZE = (480, 600), (800, 1000)  # pixels, where no size is given

Kind = Annotated[
    Path | None,
    typer.Argument(metavar="[KIND.toml]", help="Growth parameters in a file.", show_default=False),
]
PresetName = Annotated[
    str | None, o.option(o.TREE, "--preset", metavar="NAME", help="Growth parameters: F6a to F6f.")
]
KindName = Annotated[
    str | None,
    o.option(o.TREE, "--species", metavar="NAME", help="A species of the library, with its leaves and bark."),
]
Age = Annotated[
    int | None, o.option(o.TREE, "--age", metavar="N", help="Growth cycles. (default: the kind's)")
]
Changes = Annotated[
    list[str] | None,
    o.option(o.TREE, "--set", metavar="NAME=X", help="Change a parameter, by name or symbol; repeatable."),
]
Bare = Annotated[bool, o.option(o.TREE, "--leaf-off", help="Without leaves.")]
GrownNodes = Annotated[
    int | None,
    o.option(
        o.TREE,
        "--max-nodes",
        metavar="N",
        min=2,
        max=20_000_000,
        help="Growth stops there. (default: 1000000)",
    ),
]
Obstacles = Annotated[
    list[str] | None,
    o.option(
        AROUND,
        "--obstacle",
        metavar="WHAT",
        help="wall:x=1.5, box:x,y,z,dx,dy,dz, sphere:x,y,z,r or mesh:FILE; metres from the foot; repeatable.",
    ),
]
Neighbours = Annotated[
    int, o.option(AROUND, "--neighbours", metavar="N", min=0, max=60, help="Trees of its kind around it.")
]
Spacing = Annotated[float, o.option(AROUND, "--spacing", metavar="M", help="Metres from tree to tree.")]
Latitude = Annotated[
    float | None,
    o.option(
        AROUND,
        "--latitude",
        metavar="DEG",
        min=-90.0,
        max=90.0,
        help="Brightest where the equinox sun stands at noon; south is negative. (default: the zenith)",
    ),
]
Output = Annotated[
    Path,
    o.option(
        o.OUTPUT,
        "--output",
        "-o",
        metavar="FILE",
        help="Ends in .glb .obj .ply (mesh), .lobes .swc .csv (tree), .png .jpg .gif (picture) or .toml "
        "(its parameters).",
        show_default=False,
    ),
]
Series = Annotated[
    int | None,
    o.option(
        o.OUTPUT,
        "--frames",
        metavar="N",
        min=1,
        max=200,
        help="N ages from seedling to AGE, as FILE_AGE.*; of a .gif its pictures. (default of a .gif: all)",
    ),
]


def grow(
    output: Output,
    kind: Kind = None,
    preset: PresetName = None,
    species: KindName = None,
    library: o.LibraryFolder = None,
    season: o.SeasonOption = o.Season.summer,
    age: Age = None,
    changes: Changes = None,
    bare: Bare = False,
    max_nodes: GrownNodes = None,
    obstacles: Obstacles = None,
    neighbours: Neighbours = 0,
    spacing: Spacing = 4.0,
    latitude_deg: Latitude = None,
    frames: Series = None,
    detail: Annotated[
        o.Detail, o.option(o.OUTPUT, "--detail", help="How finely a mesh is made.")
    ] = o.Detail.normal,
    size: o.Size = None,
    azimuth_deg: o.Azimuth = None,
    renderer: o.RendererOption = o.Renderer.auto,
    seed: o.Seed = 0,
    force: o.Force = False,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Grow a tree from a seed: alone, beside a wall, or among others.

    \b
    Example:  sapwood grow --preset F6b --age 25 --seed 3 -o tree.glb
              sapwood grow --preset F6b --obstacle wall:x=1.5 -o tree.png
              sapwood grow --species willow --season autumn -o tree.png
              sapwood grow --preset F6e --frames 10 -o tree.gif

    Meshes and pictures show neighbours too, pictures also obstacles; .lobes, .swc and .csv hold one tree.
    """
    from sapwood.growing import PICTURES

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    dress = {"species": _load_species(species, library), "season": season.value}
    chosen = _choose(kind, preset, dress["species"], age, changes)
    suffix = output.suffix.lower()
    _check_output(output, frames, force, chosen.age)
    if suffix == ".toml":
        return _write_kind(terminal, chosen, output, force)
    request = _request(chosen, seed, obstacles, neighbours, spacing, latitude_deg, max_nodes)
    look: dict[str, Any] = {}
    if suffix in (*PICTURES, ".gif"):
        look = {"renderer": renderer.value, "size": None if size is None else o.parse_size(size)}
        look["azimuth"] = None if azimuth_deg is None else math.radians(azimuth_deg)
    else:
        look["detail"] = detail.value
    terminal.warn_of_compiling()
    start = perf_counter()
    grown, files = _grow_and_write(terminal, request, output, frames, dress | {"bare": bare}, force, look)
    _say(terminal, grown, chosen, files, seed, perf_counter() - start)
    return 0


def _load_species(name: str | None, library: Path | None) -> Any:
    """The species with its twigs and leaves; None if none is named."""
    from sapwood.dressing import open_library

    return None if name is None else open_library(library).load(name)


def _choose(
    kind: Path | None, preset: str | None, species: Any, age: int | None, changes: list[str] | None
) -> Preset:
    """The kind of tree that the arguments ask for."""
    from dataclasses import replace

    from species import find_preset, presets, read_growth
    from treegraph.errors import InputError

    if kind is not None and preset is not None or (kind or preset or species) is None:
        raise InputError(f"name one: KIND.toml, --preset {', '.join(presets())}, or --species NAME.")
    if kind is None and preset is None:
        if species.definition.growth is None:
            raise InputError(f"{species.name} has no growth parameters; name KIND.toml or --preset as well.")
        chosen = species.definition.growth
    else:
        chosen = find_preset(preset) if preset is not None else read_growth(kind)  # type: ignore[arg-type]
    values: dict[str, float] = {}
    for text in changes or []:
        name, equals, value = text.partition("=")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals:
            raise InputError(f"--set wants NAME=NUMBER, as in --set GR=2.5, got {text!r}")
    if age is not None:
        chosen = replace(chosen, age=age)
    return replace(chosen, parameters=chosen.parameters.replace(**values))


def _check_output(output: Path, frames: int | None, force: bool, age: int) -> None:
    """Refuse a name that cannot be written before anything grows."""
    from sapwood.growing import GROWN_SUFFIXES, spread_ages
    from sapwood.outputs import check_free
    from treegraph.errors import InputError

    suffix = output.suffix.lower()
    allowed = (*GROWN_SUFFIXES, ".gif", ".toml")
    if suffix not in allowed:
        raise InputError(f"{output}: the name must end in one of {' '.join(allowed)}.")
    if age < 1 and suffix != ".toml":
        raise InputError(f"age must be 1 or more growth cycles for there to be a tree, got {age}")
    if frames is None or suffix in (".gif", ".toml"):
        check_free([output], force=force)
    else:
        check_free([_frame_path(output, a) for a in spread_ages(age, frames)], force=force)


def _frame_path(output: Path, age: int) -> Path:
    return output.with_name(f"{output.stem}_{age:03d}{output.suffix}")


def _request(
    kind: Preset,
    seed: int,
    obstacles: list[str] | None,
    neighbours: int,
    spacing: float,
    latitude_deg: float | None,
    max_nodes: int | None,
) -> Request:
    from sapwood.growing import Request
    from sapwood.obstacles import parse_obstacle
    from treegraph import Sky

    solid = tuple(parse_obstacle(text) for text in obstacles or [])
    sky = None if latitude_deg is None else Sky.at_latitude(math.radians(latitude_deg))
    return Request(kind, seed, solid, sky, neighbours, spacing, max_nodes)


def _write_kind(terminal: Terminal, kind: Preset, output: Path, force: bool) -> int:
    from sapwood.outputs import write_whole
    from species import format_growth

    write_whole(output, lambda to: to.write_text(format_growth(kind), encoding="utf-8"), force=force)
    terminal.result(str(output))
    terminal.json("grow", kind=kind.name, age=kind.age, files=[str(output)])
    return 0


def _grow_and_write(
    terminal: Terminal,
    request: Request,
    output: Path,
    frames: int | None,
    dress: dict[str, Any],
    force: bool,
    look: dict[str, Any],
) -> tuple[Group, list[Path]]:
    """Grow the tree, at every age asked for, and write it; the oldest, and what was written."""
    from sapwood.growing import PICTURES, draw_grown, grow_group, spread_ages, write_grown

    moving, picture = output.suffix.lower() == ".gif", output.suffix.lower() in PICTURES
    last = request.kind.age
    wanted = last if moving and frames is None else frames
    ages = [last] if wanted is None else spread_ages(last, wanted)
    if len(ages) > 1 and (moving or picture) and look["size"] is None:
        look["size"] = MOVING_SIZE if moving else SERIES_SIZE  # one for all ages
    extras = {"kind": request.kind.name, "age": last, "seed": request.seed}
    files: list[Path] = []
    images = []
    with terminal.progress(len(ages), str(output)) as bar:
        oldest = grow_group(request, **dress)
        for age in ages:
            group = oldest if age == last else grow_group(request, age, **dress)
            frame = oldest if len(ages) > 1 else None
            if moving:
                images.append(draw_grown(group, frame=frame, **look))
            else:
                path = output if wanted is None else _frame_path(output, age)
                more = look | ({"frame": frame} if picture else {"extras": extras | {"age": age}})
                drawn = write_grown(group, path, force=force, **more)
                files.append(path)
                if drawn is not None:
                    images.append(drawn)
            bar.advance()
    if moving:
        _write_gif(output, images, force)
        files.append(output)
    for notice in {drawn.notice for drawn in images if drawn.notice}:
        terminal.notice(notice)
    return oldest, files


def _write_gif(output: Path, drawn: list[Any], force: bool) -> None:
    import render
    from sapwood.outputs import write_whole

    images = [preview.image for preview in drawn]
    write_whole(output, lambda to: render.write_gif(to, images), force=force)


def _say(
    terminal: Terminal, grown: Group, kind: Preset, files: list[Path], seed: int, seconds: float
) -> None:
    tree = grown.trees[0]
    leaves = grown.leaf_area(0)
    if tree.status != "grown":
        terminal.note(
            f"growth stopped after {tree.age} of {kind.age} cycles: the next would pass --max-nodes"
        )
    terminal.result(
        f"{kind.name}, {tree.age} cycles: {tree.tree.n_nodes} nodes, {tree.height:.1f} m high, "
        f"{leaves:.0f} m2 of leaves -> {', '.join(map(str, files[-1:]))}"
        + (f" and {len(files) - 1} more" if len(files) > 1 else "")
    )
    terminal.json(
        "grow",
        kind=kind.name,
        age=tree.age,
        status=tree.status,
        nodes=tree.tree.n_nodes,
        height_m=round(tree.height, 4),
        leaf_area_m2=round(leaves, 3),
        trees=len(grown.trees),
        seed=seed,
        files=[str(path) for path in files],
        seconds=round(seconds, 3),
    )
