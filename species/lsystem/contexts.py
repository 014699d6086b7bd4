"""Contexts in strings with brackets: what comes before and after a module on its axis.

Based on: P. Prusinkiewicz, A. Lindenmayer, "The Algorithmic Beauty of Plants", 1990, chapter 1. The left
context is the way towards the root: side branches that end before the module are skipped, and so is the
bracket in which it stands. The right context goes on towards the tips: branches that it does not name are
skipped, and so is the rest of a branch that it names.
Departs from it in: of several branches that begin at a place, a branch of the right context is the first that
fits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from species.lsystem.evaluation import Values
from species.lsystem.syntax import Branch, Pattern, Production

__all__ = ["Surroundings", "compile_context", "find_neighbours"]

OPEN, CLOSE = 0, 1
"""Codes of the brackets."""

STEPS_PER_LOOK = 4_096

Item = int | tuple["Item", ...]
Context = Callable[[Values, int], Values | None]


class Surroundings:
    """The word that is being replaced and, for each module of it, its neighbours."""

    def __init__(self, ignored: frozenset[int]) -> None:
        self.ignored = ignored
        self.is_needed = False
        self.codes: list[int] = []
        self.arguments: list[Values] = []
        self.before: list[int] = []  # module before it on its axis, -1: none
        self.after: list[int] = []  # next module or bracket; the word's length at its end
        self.closing: list[int] = []  # of an opening bracket the closing one
        self.look: Callable[[], None] = _do_nothing
        self._steps = 0

    def step(self) -> None:
        """Count a step of a search whose length is not bounded by the grammar."""
        self._steps += 1
        if self._steps % STEPS_PER_LOOK == 0:
            self.look()


def _do_nothing() -> None:
    return None


def find_neighbours(around: Surroundings) -> None:
    """Fill the neighbours of all modules: two passes, O(modules). The brackets are balanced."""
    codes, ignored = around.codes, around.ignored
    n = len(codes)
    before, after, closing = [-1] * n, [n] * n, [n] * n
    last = -1
    stack: list[int] = []
    for i, code in enumerate(codes):
        before[i] = last
        if code == OPEN:
            stack.append(last)
        elif code == CLOSE:
            last = stack.pop()
        elif code not in ignored:
            last = i
    following = n
    for i in range(n - 1, -1, -1):
        after[i] = following
        code = codes[i]
        if code == CLOSE:
            stack.append(i)
        elif code == OPEN:
            closing[i] = stack.pop()
        if code not in ignored:
            following = i
    around.before, around.after, around.closing = before, after, closing


def compile_context(
    production: Production, code: Mapping[tuple[str, int], int], around: Surroundings
) -> Context | None:
    """Make a closure from own parameters and position to all parameters; None in return: no match.

    Returns None itself if the production has no context.
    """
    if not production.left and not production.right:
        return None
    around.is_needed = True
    left = tuple(code.get(pattern.kind, -1) for pattern in reversed(production.left))
    right = _items(production.right, code)

    def match(own: Values, i: int) -> Values | None:
        codes, before = around.codes, around.before
        values = own
        j = i
        for kind in left:
            j = before[j]
            if j < 0 or codes[j] != kind:
                return None
            values = around.arguments[j] + values
        if right:
            found: list[Values] = []
            if _match_right(right, around.after[i], around, found) < 0:
                return None
            for more in found:
                values += more
        return values

    return match


def _items(items: tuple[Pattern | Branch, ...], code: Mapping[tuple[str, int], int]) -> tuple[Item, ...]:
    return tuple(
        _items(item.items, code) if isinstance(item, Branch) else code.get(item.kind, -1) for item in items
    )


def _match_right(items: tuple[Item, ...], j: int, around: Surroundings, found: list[Values]) -> int:
    """Match items from place j on; append their parameters and return the place after them, or -1."""
    codes, after, closing = around.codes, around.after, around.closing
    n = len(codes)
    for item in items:
        if isinstance(item, tuple):
            j = _match_branch(item, j, around, found)
            if j < 0:
                return -1
            continue
        while j < n and codes[j] == OPEN:
            around.step()
            j = after[closing[j]]
        if j >= n or codes[j] != item:
            return -1
        found.append(around.arguments[j])
        j = after[j]
    return j


def _match_branch(items: tuple[Item, ...], j: int, around: Surroundings, found: list[Values]) -> int:
    """Match the first of the branches that begin at j and fits."""
    n = len(around.codes)
    while j < n and around.codes[j] == OPEN:
        around.step()
        mark = len(found)
        end = around.after[around.closing[j]]
        if _match_right(items, around.after[j], around, found) >= 0:
            return end
        del found[mark:]
        j = end
    return -1
