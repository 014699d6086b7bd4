"""Fits from the words of a command to a file of growth parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treegraph.errors import InputError

if TYPE_CHECKING:
    from inverse import Fit
    from treegraph import TreeGraph

__all__ = ["Budget", "format_fit", "parse_bounds", "parse_budget", "parse_fixed", "read_target"]

TIMES = {"s": 1.0, "min": 60.0, "h": 3600.0}
BUDGET = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h)?")
MOST_EVALUATIONS = 10**9


@dataclass(frozen=True)
class Budget:
    """How much a fit may do.

    Attributes
    ----------
    evaluations : int or None
        Trees grown and compared; None: as the method has it, or until time is over.
    seconds : float or None
    """

    evaluations: int | None = None
    seconds: float | None = None


def read_target(path: Path, *, crown: bool = True, branches: int | None = None) -> TreeGraph:
    """The tree of a file as it is fitted: with branches in its leaf clusters, without the thinnest.

    Raises
    ------
    InputError, FormatError
        If the file cannot be read, or its tree cannot be compared; the message begins with the path.
    """
    from inverse import describe_tree, fill_crown, thin_out
    from sapwood.comparing import at_fault, read_graph
    from sapwood.trees import is_lobes, read_tree
    from treegraph import ClusterTree

    tree = read_tree(path) if crown and is_lobes(path) else read_graph(path)
    with at_fault(path):
        describe_tree(tree)
        graph = fill_crown(tree) if isinstance(tree, ClusterTree) else tree
        return graph if branches is None else thin_out(graph, branches)


def parse_budget(text: str) -> Budget:
    """A number of evaluations, or a time with its unit.

    Raises
    ------
    InputError
        If `text` is neither.

    Examples
    --------
    >>> parse_budget("6000"), parse_budget("5min").seconds
    (Budget(evaluations=6000, seconds=None), 300.0)
    """
    match = BUDGET.fullmatch(text.strip())
    number = float(match[1]) if match else 0.0
    whole = bool(match and not match[2])
    if match is None or not 0.0 < number <= MOST_EVALUATIONS or (whole and not number.is_integer()):
        rule = "budget must be a number of evaluations or a time, as in 6000, 90s or 5min"
        raise InputError(f"{rule}, got {text!r}")
    if whole:
        return Budget(evaluations=int(number))
    return Budget(seconds=number * TIMES[match[2]])


def parse_fixed(items: Sequence[str]) -> dict[str, float]:
    """Parameters that are not searched, from ``NAME=X``.

    Raises
    ------
    InputError
        If an item is something else, or a name comes twice.
    """
    out: dict[str, float] = {}
    for item in items:
        name, _, text = item.partition("=")
        out[_new(name, out, item)] = _number(text, item, "NAME=X, as in NLB=2")
    return out


def parse_bounds(items: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Bounds, from ``NAME=LOW:HIGH``.

    Raises
    ------
    InputError
        If an item is something else, or a name comes twice.
    """
    out: dict[str, tuple[float, float]] = {}
    for item in items:
        name, _, text = item.partition("=")
        low, _, high = text.partition(":")
        form = "NAME=LOW:HIGH, as in BAM=30:60"
        out[_new(name, out, item)] = _number(low, item, form), _number(high, item, form)
    return out


def _new(name: str, known: dict[str, Any], item: str) -> str:
    if name in known:
        raise InputError(f"{item!r}: {name} is given twice")
    return name


def _number(text: str, item: str, form: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{item!r} is not {form}")
    return value


def format_fit(fit: Fit, name: str, sources: Sequence[Path], method: str, seed: int) -> str:
    """The text of a TOML file: growth parameters that ``sapwood grow`` takes, and how well they fit.

    The same fit gives the same text. Bytes of a file's name that are no text become escapes.
    """
    import json

    from sapwood.text import encodable
    from species import Preset, format_growth

    what = encodable(f"fitted to {', '.join(path.name for path in sources)}", None)
    name = encodable(name, None)
    lines = [format_growth(Preset(name, fit.parameters, fit.age, what, fit.tip_share)), "[fit]"]
    values = {
        "method": method,
        "seed": seed,
        "trees": [encodable(str(path), None) for path in sources],
        "distance": fit.distance,
        "shape": fit.shape,
        "geometry": fit.geometry,
        "structure": fit.structure,
        "distances": list(fit.distances),
        "evaluations": fit.evaluations,
        "status": fit.status,
    }
    for key, value in values.items():
        text = json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # as TOML has it
        lines.append(f"{key} = {text}")
    if len(fit.runs) > 1:
        lines += ["", "[fit.spread]  # standard deviation over the runs"]
        lines += [f"{symbol} = {value!r}" for symbol, value in fit.spread.items()]
    return "\n".join(lines) + "\n"
