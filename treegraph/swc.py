"""SWC: the plain text table of branching structures that neuroscience and forestry tools exchange."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from treegraph._files import write_whole
from treegraph.errors import FormatError, InputError
from treegraph.graph import TreeGraph, tree_from_unsorted

__all__ = ["read_swc", "write_swc"]

UNKNOWN_RADIUS = -1.0
"""SWC has no word for an unknown radius; a negative one stands for it."""

MAX_ID = 2**53
"""Largest identifier that survives being read as a number."""

MAX_TYPE = 2**31 - 1
"""Largest type, which is kept as int32."""


def read_swc(path: str | os.PathLike[str]) -> TreeGraph:
    """Read a tree, or a forest, from an SWC file.

    Each line holds ``id type x y z radius parent``; further columns are ignored. Nodes may come in any
    order and have any non-negative identifiers. A negative parent, or a row that is its own parent,
    marks a root. Blank lines and what follows ``#`` are skipped; commas may stand for blanks, but not for
    the decimal point.

    Parameters
    ----------
    path : path-like
        The file; lengths are taken as metres.

    Returns
    -------
    tree : TreeGraph
        In depth-first order; a negative or NaN radius becomes NaN. ``attribute["type"]`` (int32) holds
        the second column.

    Raises
    ------
    FormatError
        If the file is not such a table; the message names the line and what is wrong with it.
    OSError
        If the file cannot be opened.

    Notes
    -----
    O(n log n) time.
    """
    name = Path(path).name
    line, table = _parse_rows(name, Path(path).read_bytes())
    ident = _as_integers(name, "id", line, table[:, 0], 0)
    kind = _as_integers(name, "type", line, table[:, 1], -MAX_TYPE, MAX_TYPE)
    above = _as_integers(name, "parent", line, table[:, 6], -MAX_ID)
    bad = np.flatnonzero(~np.isfinite(table[:, 2:5]).all(axis=1))
    if bad.size:
        raise FormatError(f"{name}, line {line[bad[0]]}: x, y and z must be finite, got {table[bad[0], 2:5]}")
    bad = np.flatnonzero(np.isinf(table[:, 5]))
    if bad.size:
        raise FormatError(f"{name}, line {line[bad[0]]}: radius must be finite, got {table[bad[0], 5]}")
    parent = _find_parents(name, line, ident, above)
    radius = np.where(table[:, 5] < 0.0, np.nan, table[:, 5])
    return tree_from_unsorted(parent, table[:, 2:5], radius, {"type": kind.astype(np.int32)})


def write_swc(tree: TreeGraph, path: str | os.PathLike[str]) -> None:
    """Write a tree, or a forest, as an SWC file; an existing file is replaced.

    Identifiers count from 1 in the order of the nodes. Lengths are written in metres with seven digits
    after the point, so that they come back to 1e-6; an unknown radius is written as -1. The type
    column is ``attribute["type"]`` if there is one, else 0 (undefined).

    Parameters
    ----------
    tree : TreeGraph
        ``attribute`` is not written, ``"type"`` apart.
    path : path-like
        The file appears whole or not at all.

    Raises
    ------
    InputError
        If ``attribute["type"]`` is not one integer per node.
    OSError
        If the file cannot be written.

    Notes
    -----
    O(n).
    """
    kind = np.asarray(tree.attribute.get("type", np.zeros(tree.n_nodes, np.int32)))
    if kind.ndim != 1 or kind.dtype.kind not in "iu":
        raise InputError(
            f"attribute 'type' must hold one integer per node, got {kind.dtype} of shape {kind.shape}"
        )
    radius = np.where(np.isnan(tree.radius), UNKNOWN_RADIUS, tree.radius)
    parent = np.where(tree.parent < 0, -1, tree.parent.astype(np.int64) + 1)
    columns = zip(kind.tolist(), tree.position.tolist(), radius.tolist(), parent.tolist(), strict=True)
    lines = [
        f"{i} {k} {x:.7f} {y:.7f} {z:.7f} {r:.9g} {p}" for i, (k, (x, y, z), r, p) in enumerate(columns, 1)
    ]
    write_whole(path, ("# id type x y z radius parent; metres\n" + "\n".join(lines) + "\n").encode())


def _parse_rows(name: str, data: bytes) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    numbers: list[int] = []
    rows: list[list[float]] = []
    for number, text in enumerate(data.decode("utf-8-sig", errors="replace").splitlines(), 1):
        fields = _split(name, number, text.partition("#")[0])
        if not fields:
            continue
        if len(fields) < 7:
            raise FormatError(
                f"{name}, line {number}: a row must have 7 columns (id type x y z radius parent), "
                f"got {len(fields)}: {text.strip()[:60]!r}"
            )
        try:
            rows.append([float(field) for field in fields[:7]])
        except ValueError as error:
            raise FormatError(f"{name}, line {number}: {error}") from error
        numbers.append(number)
    if not rows:
        raise FormatError(f"{name} has no rows; an SWC file has one 'id type x y z radius parent' per node")
    return np.array(numbers), np.array(rows)


def _split(name: str, number: int, text: str) -> list[str]:
    words = text.split()
    if len(words) >= 7 and any("," in word.strip(",") for word in words):
        raise FormatError(
            f"{name}, line {number}: numbers must have a decimal point, got a comma: {text.strip()[:60]!r}"
        )
    return text.replace(",", " ").split()


def _as_integers(
    name: str,
    column: str,
    line: NDArray[np.int64],
    values: NDArray[np.float64],
    least: int,
    most: int = MAX_ID,
) -> NDArray[np.int64]:
    bad = np.flatnonzero(~((values == np.floor(values)) & (values >= least) & (values <= most)))
    if bad.size:
        rule = f"an integer from {least} to {most}"
        raise FormatError(f"{name}, line {line[bad[0]]}: {column} must be {rule}, got {values[bad[0]]:.17g}")
    return values.astype(np.int64)


def _find_parents(
    name: str, line: NDArray[np.int64], ident: NDArray[np.int64], above: NDArray[np.int64]
) -> NDArray[np.int64]:
    by_ident = np.argsort(ident, kind="stable")
    known = ident[by_ident]
    twice = np.flatnonzero(known[1:] == known[:-1])
    if twice.size:
        first, second = line[by_ident[twice[0]]], line[by_ident[twice[0] + 1]]
        raise FormatError(f"{name}, line {second}: id {known[twice[0]]} is already taken by line {first}")
    slot = np.minimum(np.searchsorted(known, above), known.size - 1)
    bad = np.flatnonzero((above >= 0) & (known[slot] != above))
    if bad.size:
        raise FormatError(
            f"{name}, line {line[bad[0]]}: parent {above[bad[0]]} is not the id of any row; "
            "a root has the parent -1"
        )
    parent = np.where((above < 0) | (above == ident), -1, by_ident[slot])
    _check_no_cycle(name, line, ident, parent)
    return parent


def _check_no_cycle(
    name: str, line: NDArray[np.int64], ident: NDArray[np.int64], parent: NDArray[np.int64]
) -> None:
    """Follow all parents at once, twice as far each time: who is not at a root in the end circles."""
    ancestor = np.append(parent, -1)  # -1 stays -1
    for _ in range(parent.size.bit_length()):
        ancestor = ancestor[ancestor]
    bad = np.flatnonzero(ancestor >= 0)
    if bad.size:
        raise FormatError(
            f"{name}, line {line[bad[0]]}: parents must lead to a root, but those of id {ident[bad[0]]} go "
            f"round in a circle; {bad.size} of {parent.size} rows hang on one"
        )
