"""A word as a drawing: the turtle walks through it and leaves a tree graph and leaves behind.

Based on: P. Prusinkiewicz, A. Lindenmayer, "The Algorithmic Beauty of Plants", 1990, chapter 1 (turtle in
space, brackets) and chapter 2 (diameters, levelling, tropism).
Departs from it in: z is up and the turtle begins by looking there; widths are metres; a tropism never
turns a segment past its direction; ``+`` is to the left, ``&`` down and ``\\`` to the left for somebody who
walks with the turtle, whatever the signs in a printed matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from species.errors import DerivationError
from species.lsystem.word import TurtleSettings, Word
from treegraph import TreeGraph

__all__ = ["Drawing", "LeafPlacements", "draw_word"]

FARTHEST = 1e9
"""Metres from the begin: beyond it millimetres are lost, and near 1e308 everything."""
MOST_TURN_DEG = 1e9
"""Degrees: beyond it a turn's direction is rounding."""

# Numbers of the operations in the compiled loop.
NOTHING, DRAW, MOVE, YAW, PITCH, ROLL, LEVEL, WIDTH, THIN, BEND, LEAF, PUSH, POP = range(13)


@dataclass(frozen=True, eq=False)
class LeafPlacements:
    """Leaves as places with a direction.

    Attributes
    ----------
    base : (m, 3) float64
        Where each one is attached, metres.
    along : (m, 3) float64
        Unit vector: the turtle's heading, from the base to the tip.
    normal : (m, 3) float64
        Unit vector across `along`: the turtle's up, out of the upper face.
    size : (m,) float64
        Metres, >= 0.
    kind : (m,) int32
        As the grammar says, >= 0; 0 if it says nothing.
    node : (m,) int32
        The node that bears it.
    """

    base: NDArray[np.float64]
    along: NDArray[np.float64]
    normal: NDArray[np.float64]
    size: NDArray[np.float64]
    kind: NDArray[np.int32]
    node: NDArray[np.int32]

    @property
    def n_leaves(self) -> int:
        """Number of leaves."""
        return len(self.node)


@dataclass(frozen=True, eq=False)
class Drawing:
    """What the turtle drew.

    Attributes
    ----------
    tree : TreeGraph
        With the attributes ``order`` (n,) int32, the number of brackets around the node, and ``module`` (n,)
        int32, the module of the word that drew it.
    leaves : LeafPlacements
        In the order of the word.
    """

    tree: TreeGraph
    leaves: LeafPlacements


def draw_word(word: Word) -> Drawing:
    """Draw a word with a turtle.

    The turtle begins at (0, 0, 0), looks along z, has -x to its left and -y above it. ``F`` adds a node. What
    is drawn after ``f`` hangs on nothing: it begins with a root of its own. Modules that are no commands are
    passed over, and so are parameters beyond those of the command.

    Parameters
    ----------
    word : Word

    Returns
    -------
    drawing : Drawing
        If there is nothing to draw, a tree of one node at the origin.

    Raises
    ------
    DerivationError
        If a width or a leaf's size is negative, a leaf's kind is not a whole number from 0 to 2^31 - 1, a
        length, width or size is above 1e9 m, a turn beyond 1e9 degrees, the brackets of the word are not
        balanced, or the turtle goes farther than 1e9 m.

    Notes
    -----
    O(modules). Rounding adds up along an axis: after 100 000 turns the turtle's axes are still
    perpendicular to 1e-10.

    Examples
    --------
    >>> from species import derive_word, parse_grammar
    >>> word = derive_word(parse_grammar("axiom = F(2)[+(90)F(1)L(0.1)]F(3)\\niterations = 0"))
    >>> drawing = draw_word(word)
    >>> drawing.tree.position.round(9).tolist()
    [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [-1.0, 0.0, 2.0], [0.0, 0.0, 5.0]]
    >>> drawing.tree.parent.tolist(), drawing.leaves.node.tolist()
    ([-1, 0, 1, 1], [2])
    """
    from species.lsystem import _turtle_kernels

    commands = _commands(word)
    deepest = _check_brackets(commands.operation)
    n_draw = int((commands.operation == DRAW).sum())
    n_leaf = int((commands.operation == LEAF).sum())
    n = 2 * n_draw + n_leaf + 1
    parent, order, module = (np.empty(n, np.int32) for _ in range(3))
    position, radius = np.empty((n, 3)), np.empty(n)
    base, along, normal = (np.empty((n_leaf, 3)) for _ in range(3))
    size, kind, node = np.empty(n_leaf), np.empty(n_leaf, np.int32), np.empty(n_leaf, np.int32)
    tropism = np.array(word.settings.tropism, np.float64)
    tropism /= np.abs(tropism).max()  # so that squares neither overflow nor vanish
    tropism /= np.linalg.norm(tropism)
    n, n_leaf = _turtle_kernels.walk(
        commands.operation,
        commands.value,
        commands.kind,
        _begin(word.settings),
        tropism,
        np.empty((deepest, _turtle_kernels.N_STATE)),
        np.empty((deepest, 2), np.int32),
        *(parent, position, radius, order, module),
        *(base, along, normal, size, kind, node),
    )
    _check_extent(position[:n], radius[:n], base)
    leaves = LeafPlacements(base, along, normal, size, kind, node)
    for array in (base, along, normal, size, kind, node):
        array.flags.writeable = False
    if n == 0:
        return Drawing(_nothing(word.settings), leaves)
    attribute = {"order": order[:n], "module": module[:n]}
    return Drawing(TreeGraph(parent[:n], position[:n], radius[:n], attribute), leaves)


def _nothing(settings: TurtleSettings) -> TreeGraph:
    one = {"order": np.zeros(1, np.int32), "module": np.full(1, -1, np.int32)}
    return TreeGraph(np.full(1, -1, np.int32), np.zeros((1, 3)), np.full(1, 0.5 * settings.width), one)


def _begin(settings: TurtleSettings) -> NDArray[np.float64]:
    """State of the turtle: position, heading, left, up, width, bend."""
    return np.array([0, 0, 0, 0, 0, 1, -1, 0, 0, 0, -1, 0, settings.width, 0], np.float64)


@dataclass(frozen=True, eq=False)
class _Commands:
    """What to do at each module: operation (m,) uint8, value (m,) in metres or radians, kind (m,) int32."""

    operation: NDArray[np.uint8]
    value: NDArray[np.float64]
    kind: NDArray[np.int32]


#: Operation, default value (a number or a setting), factor, and whether it is an angle in degrees.
_MEANING: dict[str, tuple[int, str | float, float]] = {
    "F": (DRAW, "step", 1.0),
    "f": (MOVE, "step", 1.0),
    "+": (YAW, "angle_deg", 1.0),
    "-": (YAW, "angle_deg", -1.0),
    "&": (PITCH, "angle_deg", 1.0),
    "^": (PITCH, "angle_deg", -1.0),
    "/": (ROLL, "angle_deg", 1.0),
    "\\": (ROLL, "angle_deg", -1.0),
    "|": (YAW, 180.0, 1.0),
    "$": (LEVEL, 0.0, 1.0),
    "!": (WIDTH, "taper", 1.0),
    "~": (BEND, 0.0, 1.0),
    "L": (LEAF, "leaf", 1.0),
    "[": (PUSH, 0.0, 1.0),
    "]": (POP, 0.0, 1.0),
}
_ANGLES = (YAW, PITCH, ROLL)


def _commands(word: Word) -> _Commands:
    """Look up what each module means, kind by kind."""
    m = word.n_modules
    operation, value, kind = np.zeros(m, np.uint8), np.zeros(m), np.zeros(m, np.int32)
    start = word.start[:-1]
    for code, (name, n) in enumerate(word.kinds):
        if name not in _MEANING:
            continue
        what, default, factor = _MEANING[name]
        where = np.flatnonzero(word.code == code)
        if not where.size:
            continue
        given: Any = word.number[start[where]] if n and name not in "|$[]" else None
        if given is None:
            amount = getattr(word.settings, default) if isinstance(default, str) else default
            what = THIN if what == WIDTH else what
            given = np.full(where.size, amount, np.float64)
        _check_values(name, what, given)
        operation[where] = what
        value[where] = np.radians(factor * given) if what in _ANGLES else factor * given
        if what == LEAF and n > 1:
            kind[where] = _leaf_kinds(word.number[start[where] + 1])
    return _Commands(operation, value, kind)


def _check_values(name: str, what: int, given: NDArray[np.float64]) -> None:
    if what in (WIDTH, LEAF) and (given < 0.0).any():
        noun = "width" if what == WIDTH else "size of a leaf"
        raise DerivationError(f"the {noun}, {name}(x), must be >= 0, got {given[given < 0.0][0]:.6g}")
    if what in _ANGLES and (np.abs(given) > MOST_TURN_DEG).any():
        wrong = given[np.abs(given) > MOST_TURN_DEG][0]
        raise DerivationError(f"a turn, {name}(x), must be within {MOST_TURN_DEG:g} degrees, got {wrong:.6g}")
    if what != THIN and (np.abs(given) > FARTHEST).any():
        wrong = given[np.abs(given) > FARTHEST][0]
        raise DerivationError(f"{name}(x) must be within {FARTHEST:g}, got {wrong:.6g}")


def _leaf_kinds(given: NDArray[np.float64]) -> NDArray[np.int32]:
    bad = (given < 0.0) | (given > np.iinfo(np.int32).max) | (given != np.floor(given))
    if bad.any():
        raise DerivationError(
            f"the kind of a leaf, L(size, kind), must be a whole number from 0 to 2147483647, "
            f"got {given[bad][0]:.6g}"
        )
    return given.astype(np.int32)


def _check_brackets(operation: NDArray[np.uint8]) -> int:
    """The deepest branch, or an error where brackets are not balanced (a derived word's always are)."""
    step = (operation == PUSH).astype(np.int64) - (operation == POP)
    depth = np.cumsum(step)
    if depth.size and (depth.min() < 0 or depth[-1] != 0):
        raise DerivationError("the brackets [ ] of the word are not balanced")
    return int(depth.max(initial=0))


def _check_extent(
    position: NDArray[np.float64], radius: NDArray[np.float64], base: NDArray[np.float64]
) -> None:
    for points in (position, base):
        if not (np.abs(points) <= FARTHEST).all():
            raise DerivationError(
                f"the turtle goes farther than {FARTHEST:g} m from where it began; make the lengths smaller"
            )
    if not (radius <= FARTHEST).all():
        raise DerivationError(f"a width is above {FARTHEST:g} m; make width or taper smaller")
