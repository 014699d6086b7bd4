"""``decode``: a tree becomes a mesh or a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from sapwood.dressing import Dressed
    from treegraph import ClusterTree


def decode(
    tree: o.Lobes,
    output: Annotated[
        Path,
        o.option(
            o.OUTPUT,
            "--output",
            "-o",
            metavar="FILE",
            help="Ends in .glb, .obj, .ply, .swc or .csv.",
            show_default=False,
        ),
    ],
    species: o.DressedAs = None,
    library: o.LibraryFolder = None,
    season: o.SeasonOption = o.Season.summer,
    lod: o.Lod = 1.0,
    hulls: o.Hulls = False,
    flat: Annotated[
        bool,
        o.option(
            o.OUTPUT,
            "--flat",
            help="Every leaf in its place in a .glb, for programs without EXT_mesh_gpu_instancing.",
        ),
    ] = False,
    detail: Annotated[
        o.Detail, o.option(o.OUTPUT, "--detail", help="How finely branches are meshed.")
    ] = o.Detail.normal,
    local: Annotated[
        bool,
        o.option(
            o.OUTPUT,
            "--local",
            help="Write .swc and .csv relative to the foot of the trunk; meshes always are.",
        ),
    ] = False,
    force: o.Force = False,
    seed: o.Seed = 0,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Decode a tree to a mesh (.glb, .obj, .ply), its graph (.swc) or its cylinders (.csv).

    \b
    Example:  sapwood decode out/oak.lobes -o oak.glb --species oak --season autumn
              sapwood decode out/oak.lobes -o oak.obj --lod 0.1

    A tree of known species bears its leaves; a .glb then holds each twig once, and where it is put.
    """
    from sapwood.outputs import check_free
    from sapwood.trees import DECODED, MESHES, blame, read_tree, write_tree

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    loaded = read_tree(tree)
    dressed = None
    is_mesh = output.suffix.lower() in MESHES
    wants_leaves = species or library or flat or season != o.Season.summer
    if output.suffix.lower() in DECODED and not is_mesh and (wants_leaves or hulls or lod < 1.0):
        terminal.note(f"a {output.suffix.lower()} file holds branches only: options for leaves are left out")
    elif is_mesh and hulls and wants_leaves:
        terminal.note("--hulls: there are no leaves, so that options for them are left out")
    elif is_mesh and not hulls:
        check_free([output], force=force)
        with blame(tree):
            dressed = dress_for(terminal, loaded, species, library, season, lod, seed, detail.value)
    with blame(tree):
        path = write_tree(
            loaded, output, detail=detail.value, local=local, force=force, dressed=dressed, flat=flat, lod=lod
        )
    size = path.stat().st_size
    leaves = None if dressed is None else dressed.figures()
    said = "" if leaves is None else f", {leaves['species']}, {leaves['leaf_area_m2']:.1f} m2 of leaves"
    terminal.result(f"{path} ({size / 1000:.1f} kB{said})")
    terminal.json("decode", input=str(tree), output=str(path), bytes=size, lod=lod, leaves=leaves, seed=seed)
    return 0


def dress_for(
    terminal: Terminal,
    tree: ClusterTree,
    species: str | None,
    library: Path | None,
    season: o.Season,
    lod: float = 1.0,
    seed: int = 0,
    detail: str = "normal",
) -> Dressed | None:
    """The tree with the leaves that the options ask for; None for one of no species."""
    from sapwood.dressing import dress, find_kind, open_library, unknown_kind

    if library is not None:
        for fault in open_library(library).faults:
            terminal.notice(f"left out: {fault}")
    kind = find_kind(tree, species, library)
    if kind is None:
        if tree.species is not None:
            terminal.note(unknown_kind(tree))
        elif tree.clusters:
            terminal.note("the tree says no species, so its clusters stay hulls; name one with --species")
        return None
    dressed = dress(tree, kind, lod=lod, season=season.value, seed=seed, detail=detail)
    if dressed.remark is not None:
        terminal.note(dressed.remark)
    return dressed
