"""``adapt``: a tree beside a wall, among others, or in other light."""

from __future__ import annotations

import math
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from plastic import Adapted
    from sapwood.adapting import Look, Yard

AROUND, HOW = "Its surroundings", "How it reacts"
MOVING_SIZE, SERIES_SIZE = (480, 600), (800, 1000)  # pixels, where no size is given
DEFAULT_FRAMES = 24

Tree = Annotated[
    Path | None,
    typer.Argument(metavar="[X.lobes]", help="A tree that grew in the open.", show_default=False),
]
SceneOption = Annotated[
    Path | None,
    o.option(AROUND, "--scene", metavar="FILE.toml", help="Trees, obstacles, light; docs/plastic.md."),
]
Obstacles = Annotated[
    list[str] | None,
    o.option(
        AROUND,
        "--obstacle",
        metavar="WHAT",
        help="wall:x=1.2 (all beyond it is solid), box:x,y,z,dx,dy,dz, sphere:x,y,z,r or mesh:FILE; metres "
        "from the foot of the trunk; repeatable.",
    ),
]
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
PathOption = Annotated[
    str | None,
    o.option(
        AROUND,
        "--path",
        metavar="'DX,DY,DZ ...'",
        help="Move the last obstacle through these places, metres from its own, and draw the frames: a .gif, "
        "or a .png for each.",
    ),
]
Frames = Annotated[
    int | None,
    o.option(
        AROUND, "--frames", metavar="N", min=2, max=1000, help=f"Of a path. (default: {DEFAULT_FRAMES})"
    ),
]
Bending = Annotated[
    float | None,
    o.option(HOW, "--bending", metavar="X", help="Strength of bending; 0: none. (default: 1)"),
]
Pruning = Annotated[
    float | None,
    o.option(HOW, "--pruning", metavar="X", help="Strength of pruning, c_psi; 0: none. (default: 0.8)"),
]
Phototropism = Annotated[
    float | None,
    o.option(HOW, "--phototropism", metavar="W", help="Weight of light per internode. (default: 0.12)"),
]
Gravitropism = Annotated[
    float | None,
    o.option(
        HOW,
        "--gravitropism",
        metavar="W",
        help="Weight of up per internode; negative: down. (default: 0.08)",
    ),
]
Output = Annotated[
    Path,
    o.option(
        o.OUTPUT,
        "--output",
        "-o",
        metavar="FILE",
        help="Ends in .lobes .swc .csv (tree), .glb .obj .ply (mesh), .png .jpg or, of a path, .gif "
        "(picture).",
        show_default=False,
    ),
]
Changes = Annotated[
    bool,
    o.option(o.OUTPUT, "--changes", help="Colour branches red by how far they moved, and what fell blue."),
]


def adapt(
    output: Output,
    tree: Tree = None,
    obstacles: Obstacles = None,
    scene: SceneOption = None,
    latitude_deg: Latitude = None,
    path: PathOption = None,
    frames: Frames = None,
    bending: Bending = None,
    pruning: Pruning = None,
    phototropism: Phototropism = None,
    gravitropism: Gravitropism = None,
    changes: Changes = False,
    species: o.DressedAs = None,
    library: o.LibraryFolder = None,
    season: o.SeasonOption = o.Season.summer,
    hulls: o.Hulls = False,
    detail: Annotated[
        o.Detail, o.option(o.OUTPUT, "--detail", help="How finely a mesh is made.")
    ] = o.Detail.normal,
    size: o.Size = None,
    azimuth_deg: o.Azimuth = None,
    renderer: o.RendererOption = o.Renderer.auto,
    force: o.Force = False,
    seed: o.Seed = 0,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Put a tree beside a wall, among others or into other light: it bends, sheds and thins.

    \b
    Example:  sapwood adapt oak.lobes --obstacle wall:x=1.2 -o oak-wall.lobes
              sapwood adapt oak.lobes --obstacle box:2,-3,0,0.3,6,4 --changes -o oak.png
              sapwood adapt oak.lobes --obstacle wall:x=4 --path '0,0,0 -3,0,0' -o oak.gif
              sapwood adapt --scene yard.toml -o yard.glb

    Meshes and pictures hold all trees of a scene; .lobes, .swc and .csv hold X.lobes, or each tree of the
    scene.
    """
    from sapwood.adapting import read_yard
    from sapwood.obstacles import parse_obstacle
    from sapwood.trees import blame
    from treegraph import Sky
    from treegraph.errors import InputError

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    start = perf_counter()
    places = _check_output(output, path, frames, changes, force)
    terminal.warn_of_compiling()
    yard = read_yard(
        tree,
        scene,
        obstacles=tuple(parse_obstacle(text) for text in obstacles or []),
        sky=None if latitude_deg is None else Sky.at_latitude(math.radians(latitude_deg)),
        bending=bending,
        pruning=pruning,
        phototropism=phototropism,
        gravitropism=gravitropism,
    )
    if places is not None and not yard.scene.obstacles:
        raise InputError("a path moves an obstacle, and there is none: name one with --obstacle.")
    source = scene if tree is None else tree
    more: dict[str, Any] = {
        "renderer": renderer.value,
        "size": None if size is None else o.parse_size(size),
        "azimuth": None if azimuth_deg is None else math.radians(azimuth_deg),
    }
    look = _look(terminal, yard, output, species, library, season, hulls, changes, detail, seed, more)
    only = 0 if tree is not None else None
    with blame(source or ""):
        if places is None:
            adapted, files, seconds = _write_one(terminal, yard, output, look, only, force)
        else:
            adapted, files, seconds = _write_frames(
                terminal, yard, output, look, places, frames or DEFAULT_FRAMES, force
            )
    _say(terminal, yard, adapted, files, seconds, perf_counter() - start, seed)
    return 0


def _check_output(output: Path, path: str | None, frames: int | None, changes: bool, force: bool) -> Any:
    """Refuse what cannot be written before anything is read; the places of the path, or None."""
    from sapwood.adapting import ADAPTED_SUFFIXES, MESHES, PICTURES, parse_path
    from sapwood.outputs import check_free
    from treegraph.errors import InputError

    suffix = output.suffix.lower()
    if changes and suffix not in (*PICTURES, *MESHES, ".gif"):
        raise InputError(f"{output}: --changes colours pictures and meshes, not {suffix or 'this'}.")
    if path is None:
        if frames is not None:
            raise InputError("--frames goes with --path.")
        if suffix not in ADAPTED_SUFFIXES:
            raise InputError(f"{output}: the name must end in one of {' '.join(ADAPTED_SUFFIXES)}.")
        check_free([output], force=force)
        return None
    if suffix not in (".gif", *PICTURES):
        raise InputError(f"{output}: the frames of a path are a .gif, or a .png or .jpg each.")
    count = frames or DEFAULT_FRAMES
    check_free([output] if suffix == ".gif" else [_frame(output, k) for k in range(count)], force=force)
    return parse_path(path)


def _frame(output: Path, k: int) -> Path:
    return output.with_name(f"{output.stem}_{k:03d}{output.suffix}")


def _look(
    terminal: Terminal,
    yard: Yard,
    output: Path,
    species: str | None,
    library: Path | None,
    season: o.Season,
    hulls: bool,
    changes: bool,
    detail: o.Detail,
    seed: int,
    more: dict[str, Any],
) -> Look:
    """How trees are drawn; whose leaves they bear is only asked where there will be any."""
    from sapwood.adapting import TREES, Look
    from sapwood.dressing import find_kind, open_library

    kinds: tuple[Any, ...] = ()
    if not (hulls or changes or output.suffix.lower() in TREES):
        if library is not None:
            for fault in open_library(library).faults:
                terminal.notice(f"left out: {fault}")
        kinds = tuple(find_kind(tree.state.tree, species, library) for tree in yard.trees)
        if any(k is None and t.state.tree.clusters for k, t in zip(kinds, yard.trees, strict=True)):
            terminal.note("a tree says no species, so its clusters stay hulls; name one with --species")
    return Look(kinds, season.value, seed, detail.value, changes, more)


def _write_one(
    terminal: Terminal, yard: Yard, output: Path, look: Look, only: int | None, force: bool
) -> tuple[tuple[Adapted, ...], list[Path], float]:
    from sapwood.adapting import adapt_yard, output_paths, write_adapted
    from sapwood.outputs import check_free

    count = 1 if only is not None else len(yard.trees)
    check_free(output_paths(output, count), force=force)
    start = perf_counter()
    adapted = adapt_yard(yard)
    seconds = perf_counter() - start
    with terminal.progress(None, f"{output}: writing"):
        files, drawn = write_adapted(adapted, yard.scene.obstacles, output, look, only=only, force=force)
    if drawn is not None and drawn.notice:
        terminal.notice(drawn.notice)
    return adapted, files, seconds


def _write_frames(
    terminal: Terminal, yard: Yard, output: Path, look: Look, places: Any, frames: int, force: bool
) -> tuple[tuple[Adapted, ...], list[Path], float]:
    """All frames are worked out first, so that one camera holds them all."""
    from dataclasses import replace

    import numpy as np

    import render
    from sapwood.adapting import cloud_of, draw_adapted, follow, reach_of
    from sapwood.outputs import write_whole

    moving = output.suffix.lower() == ".gif"
    if look.more["size"] is None:
        look = replace(look, more=look.more | {"size": MOVING_SIZE if moving else SERIES_SIZE})
    start = perf_counter()
    run = list(follow(yard, places, frames))
    seconds = perf_counter() - start
    frame = reach_of(np.concatenate([reach_of(cloud_of(adapted)) for _, adapted in run]))
    images, files = [], []
    with terminal.progress(frames, str(output)) as bar:
        for k, (obstacles, adapted) in enumerate(run):
            if moving:
                images.append(draw_adapted(adapted, obstacles, look, frame=frame))
            else:
                to = _frame(output, k)

                def draw(part: Path, adapted: Any = adapted, obstacles: Any = obstacles) -> None:
                    images.append(draw_adapted(adapted, obstacles, look, part, frame=frame))

                files.append(write_whole(to, draw, force=force))
            bar.advance()
    if moving:
        pictures = [drawn.image for drawn in images]
        files.append(write_whole(output, lambda to: render.write_gif(to, pictures), force=force))
    for notice in {drawn.notice for drawn in images if drawn.notice}:
        terminal.notice(notice)
    return run[-1][1], files, seconds


def _say(
    terminal: Terminal,
    yard: Yard,
    adapted: tuple[Adapted, ...],
    files: list[Path],
    adapt_s: float,
    seconds: float,
    seed: int,
) -> None:
    from sapwood.adapting import figures

    found = figures(yard, adapted)
    trees = f"{len(adapted)} trees, " if len(adapted) > 1 else ""
    terminal.result(
        f"{trees}{found['nodes_after']} of {found['nodes_before']} nodes, moved by "
        f"{found['mean_shift_m']:.2f} m on average -> {files[0]}"
        + (f" and {len(files) - 1} more" if len(files) > 1 else "")
    )
    terminal.json(
        "adapt",
        **found,
        files=[str(path) for path in files],
        seed=seed,
        analyse_s=round(yard.analyse_s, 4),
        adapt_s=round(adapt_s, 4),
        seconds=round(seconds, 3),
    )
