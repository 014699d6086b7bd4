"""``decode``: a tree becomes a mesh or a table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal


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
    detail: Annotated[
        o.Detail, o.option(o.OUTPUT, "--detail", help="How finely a mesh is made.")
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
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Decode a tree to a mesh (.glb, .obj, .ply), its graph (.swc) or its cylinders (.csv).

    \b
    Example:  sapwood decode out/oak.lobes -o oak.obj --detail fine
    """
    from sapwood.trees import read_tree, write_tree

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    path = write_tree(read_tree(tree), output, detail=detail.value, local=local, force=force)
    size = path.stat().st_size
    terminal.result(f"{path} ({size / 1000:.1f} kB)")
    terminal.json("decode", input=str(tree), output=str(path), bytes=size)
    return 0
