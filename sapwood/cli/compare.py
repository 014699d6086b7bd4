"""``compare``: how unlike two trees are, and which branches of the one became which of the other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sapwood.cli import options as o
from sapwood.cli.terminal import Terminal

if TYPE_CHECKING:
    from inverse import Comparison, Weights

SHOWN = 8  # pairs of branches that are printed
MOST = 3  # descriptors that are named as those that differ most

Tree = Annotated[Path, o.argument("A", "A tree: .lobes or .swc.")]
Other = Annotated[Path, o.argument("B", "Another one.")]
WeightsOption = Annotated[
    str | None,
    o.option(
        o.TREE,
        "--weights",
        metavar="S,G,T",
        help="How much shape, geometry and structure count; together 1. (default: a third each)",
    ),
]
Picture = Annotated[
    Path | None,
    o.option(
        o.OUTPUT,
        "--picture",
        metavar="FILE",
        help="Draw both trees, branches that became each other in one colour: .png or .jpg.",
    ),
]


def compare(
    a: Tree,
    b: Other,
    weights: WeightsOption = None,
    picture: Picture = None,
    size: o.Size = None,
    renderer: o.RendererOption = o.Renderer.auto,
    force: o.Force = False,
    as_json: o.Json = False,
    quiet: o.Quiet = False,
    verbose: o.Verbose = False,
    version: o.Version = False,
) -> int:
    """Say how unlike two trees are: 0 is alike, 1 is nothing in common.

    \b
    Example:  sapwood compare oak.lobes elm.lobes
              sapwood compare oak.lobes grown.swc --json
              sapwood compare oak.lobes elm.lobes --picture mapping.png

    The distance is the mean of three: of the crowns' shapes, of the branches' geometry, and of the
    structure: what it costs to make the branches of the one into those of the other.
    """
    from sapwood.outputs import check_free

    terminal = Terminal(as_json=as_json, quiet=quiet, verbose=verbose)
    share = _parse_weights(weights)
    if picture is not None:
        check_free([picture], force=force)
        _check_suffix(picture)
    terminal.warn_of_compiling()
    with terminal.progress(None, f"{a}, {b}: comparing"):
        found = _compare(a, b, share)
    drawn = None
    if picture is not None:
        look = {} if size is None else {"size": o.parse_size(size)}
        with terminal.progress(None, f"{picture}: drawing"):
            drawn = _draw(found, picture, force, renderer=renderer.value, **look)
        if drawn.notice:
            terminal.notice(drawn.notice)
    for line in _lines(a, b, found):
        terminal.result(line)
    _say_json(terminal, a, b, found, picture, drawn)
    return 0


def _compare(a: Path, b: Path, weights: Weights) -> Comparison:
    from inverse import compare_trees, describe_tree
    from sapwood.comparing import at_fault, read_graph

    described = []
    for path in (a, b):
        graph = read_graph(path)
        with at_fault(path):
            described.append(describe_tree(graph))
    with at_fault(f"{a}, {b}"):
        return compare_trees(*described, weights=weights)


def _parse_weights(text: str | None) -> Weights:
    from inverse import EQUAL_WEIGHTS, Weights

    if text is None:
        return EQUAL_WEIGHTS
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise typer.BadParameter(f"{text!r} is not three numbers S,G,T, as in 0.5,0.25,0.25")
    return Weights(*numbers)


def _check_suffix(picture: Path) -> None:
    from treegraph.errors import InputError

    allowed = (".png", ".jpg", ".jpeg")
    if picture.suffix.lower() not in allowed:
        raise InputError(f"{picture}: the name of a picture must end in {' or '.join(allowed)}.")


def _draw(found: Comparison, picture: Path, force: bool, **look: Any) -> Any:
    from sapwood.comparing import draw_mapping
    from sapwood.outputs import write_whole

    drawn: list[Any] = []
    write_whole(picture, lambda path: drawn.append(draw_mapping(found.mapping, path, **look)), force=force)
    return drawn[0]


def _lines(a: Path, b: Path, found: Comparison) -> list[str]:
    """The result for people."""
    from sapwood.comparing import list_pairs

    mapping = found.mapping
    shares = f"{mapping.matched_a:.0%} of A and {mapping.matched_b:.0%} of B by length have a counterpart"
    lines = [
        f"A {a}, {mapping.a.n_pieces} branches between forks",
        f"B {b}, {mapping.b.n_pieces} branches between forks",
        f"  distance   {found.distance:.4f}",
        f"  shape      {found.shape:.4f}  {_most(found.shape_parts)}",
        f"  geometry   {found.geometry:.4f}  {_most(found.geometry_parts)}",
        f"  structure  {found.structure:.4f}  {shares}",
    ]
    pairs = list_pairs(mapping)
    for pair in pairs[:SHOWN]:
        one, two = (
            f"{key.upper()} {pair[key][0]}-{pair[key][1]} ({pair[f'{key}_length_m']:.2f} m)" for key in "ab"
        )
        lines.append(f"  {one} -> {two}")
    if len(pairs) > SHOWN:
        lines.append(f"  and {len(pairs) - SHOWN} more pairs of branches, from node to node; --json has all")
    return lines


def _most(parts: dict[str, float]) -> str:
    """The descriptors that differ most."""
    named = sorted(parts.items(), key=lambda item: (-item[1], item[0]))[:MOST]
    return "most in " + ", ".join(f"{name.replace('_', ' ')} {value:.2f}" for name, value in named)


def _say_json(
    terminal: Terminal, a: Path, b: Path, found: Comparison, picture: Path | None, drawn: Any
) -> None:
    from sapwood.comparing import list_pairs

    terminal.json(
        "compare",
        input=[str(a), str(b)],
        distance=found.distance,
        shape=found.shape,
        geometry=found.geometry,
        structure=found.structure,
        weights=[found.weights.shape, found.weights.geometry, found.weights.structure],
        parts={"shape": found.shape_parts, "geometry": found.geometry_parts},
        matched=[found.mapping.matched_a, found.mapping.matched_b],
        pairs=list_pairs(found.mapping),
        picture=None if picture is None else str(picture),
        renderer=None if drawn is None else drawn.renderer,
    )
