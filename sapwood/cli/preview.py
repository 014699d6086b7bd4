"""``preview``: a picture of a tree, or of a scan beside the tree in it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sapwood.cli import options as o
from sapwood.cli.decode import dress_for
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from treegraph import ClusterTree


def preview(
    source: o.LobesOrScan,
    output: o.Picture,
    scan: o.Beside = None,
    species: o.DressedAs = None,
    library: o.LibraryFolder = None,
    season: o.SeasonOption = o.Season.summer,
    lod: o.Lod = 1.0,
    hulls: o.Hulls = False,
    turntable: o.Turning = False,
    frames: o.Frames = 36,
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
    """Draw a tree; of a scan, the scan beside the tree that is found in it.

    \b
    Example:  sapwood preview out/oak.lobes -o oak.png
              sapwood preview oak.laz -o oak.png --species oak
              sapwood preview out/oak.lobes -o oak.gif --turntable
    """
    from render import DETAIL
    from sapwood.dressing import coarser
    from sapwood.outputs import check_free
    from sapwood.pipeline import AUTO, asked_species
    from sapwood.trees import blame, is_lobes, keep_thickest
    from treegraph.errors import InputError

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    check_free([output], force=force)
    _check_suffix(output, turntable)
    terminal.warn_of_compiling()
    look: dict[str, Any] = {"renderer": renderer.value}
    if size is not None:
        look["size"] = o.parse_size(size)
    with terminal.progress(None, f"{source}: drawing"), blame(source):
        asked = AUTO if species is None else asked_species(species)
        tree, points = _load(terminal, source, scan, None if hulls and asked == AUTO else asked, library)
        dressed = None
        if asked is not None and not hulls:
            try:
                named = None if asked == AUTO else asked
                dressed = dress_for(terminal, tree, named, library, season, lod, seed)
            except InputError as error:
                if asked != AUTO or is_lobes(source):
                    raise
                terminal.note(f"it gets no leaves: {error}")  # nobody asked for this species
        look["parts"] = None if dressed is None else dressed.parts()
        if dressed is None:
            tree, look["settings"] = keep_thickest(tree, lod), DETAIL[coarser("normal", lod)]
        if turntable:
            drawn = _draw(output, force, "turntable", tree, frames=frames, **look)
        else:
            look["azimuth"] = None if azimuth_deg is None else math.radians(azimuth_deg)
            drawn = _draw(output, force, "preview", tree, scan=points, **look)
    if drawn.notice:
        terminal.notice(drawn.notice)
    terminal.result(str(output))
    height, width = drawn.image.shape[:2]
    facts = {"renderer": drawn.renderer, "width": width, "height": height, "seed": seed}
    facts["leaves"] = None if dressed is None else dressed.figures()
    terminal.json("preview", input=str(source), output=str(output), **facts)
    return 0


def _check_suffix(output: Path, turntable: bool) -> None:
    from treegraph.errors import InputError

    allowed = (".gif",) if turntable else (".png", ".jpg", ".jpeg")
    if output.suffix.lower() not in allowed:
        what = "a turntable" if turntable else "a picture"
        raise InputError(f"{output}: the name of {what} must end in {' or '.join(allowed)}.")


def _load(
    terminal: Terminal, source: Path, scan: Path | None, species: str | None, library: Path | None
) -> tuple[ClusterTree, Any]:
    """The tree, and the points that are drawn beside it: (xyz, color) in the tree's frame, or None."""
    from sapwood.trees import is_lobes, read_tree
    from treegraph.errors import InputError

    if is_lobes(source):
        tree = read_tree(source)
        if scan is None:
            return tree, None
        import recon

        cloud = recon.read_cloud(scan)
        return tree, (cloud.xyz + (cloud.origin - tree.origin), cloud.color)
    if scan is not None:
        raise InputError(f"{source}: --scan goes with a .lobes file; a scan is drawn beside its tree anyway.")
    from sapwood.pipeline import reconstruct

    made = reconstruct(source, species=species, library=library)
    for note in made.notes:
        terminal.note(f"{made.name}: {note}")
    return made.tree, (made.cloud.xyz, made.cloud.color)


def _draw(output: Path, force: bool, what: str, tree: ClusterTree, **look: Any) -> Any:
    import render
    from sapwood.outputs import write_whole

    drawn = []
    write_whole(output, lambda path: drawn.append(getattr(render, what)(tree, path, **look)), force=force)
    return drawn[0]
