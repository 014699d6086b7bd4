"""Deriving a word: all modules of a word are replaced at once, again and again, within limits.

Based on: P. Prusinkiewicz, A. Lindenmayer, "The Algorithmic Beauty of Plants", 1990, chapter 1 (parametric,
stochastic and context-sensitive L-systems; contexts in strings with brackets).
Departs from it in: probabilities are weights, which need not add up to 1; productions are tried in the order
of the text, where the book lets those with a context precede; a branch in a right context may be any of the
branches that begin there.
"""

from __future__ import annotations

import difflib
import math
import numbers
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import chain
from time import perf_counter

import numpy as np

from species.errors import DerivationError
from species.lsystem.contexts import Surroundings, compile_context, find_neighbours
from species.lsystem.evaluation import Evaluator, Scope, Values, compile_expression, evaluate, is_constant
from species.lsystem.syntax import (
    Expression,
    Grammar,
    Module,
    Production,
    format_number,
    nodes_of,
    patterns_in,
)
from species.lsystem.word import TurtleSettings, Word

__all__ = ["DerivationLimits", "derive_word"]

Codes = list[int]
Arguments = list[Values]
Rule = Callable[[Values, Codes, Arguments, int], None]

CHUNK_WORK = 65_536
"""Operations between two looks at the clock and at the length of the word: a few hundredths of a second."""
LARGEST_CHUNK = 4_096
MOST_MODULES = 50_000_000


@dataclass(frozen=True)
class DerivationLimits:
    """Where a derivation is stopped with an error.

    Attributes
    ----------
    modules : int, default 1000000
        Most modules of a word, brackets too; up to 50 million. A module takes 100 to 600 bytes.
    seconds : float, default 10
        Longest time, > 0.
    iterations : int, default 10000
        Most iterations.
    """

    modules: int = 1_000_000
    seconds: float = 10.0
    iterations: int = 10_000

    def __post_init__(self) -> None:
        if not 1 <= self.modules <= MOST_MODULES:
            raise DerivationError(f"modules must be from 1 to {MOST_MODULES}, got {self.modules!r}")
        if not self.seconds > 0.0:
            raise DerivationError(f"seconds must be above 0, got {self.seconds!r}")
        if not self.iterations >= 0:
            raise DerivationError(f"iterations must be 0 or more, got {self.iterations!r}")


DEFAULT_LIMITS = DerivationLimits()


def derive_word(
    grammar: Grammar,
    *,
    rng: np.random.Generator | None = None,
    parameters: Mapping[str, float] | None = None,
    iterations: int | None = None,
    limits: DerivationLimits = DEFAULT_LIMITS,
) -> Word:
    """Derive a word from a grammar's axiom.

    Parameters
    ----------
    grammar : Grammar
        From :func:`parse_grammar`.
    rng : numpy.random.Generator, optional
        Needed if ``grammar.is_random``. The same grammar, parameters and state give the same word.
    parameters : mapping of str to float, optional
        Other values for the grammar's ``param`` statements.
    iterations : int, optional
        How often all modules are replaced; left out, what the grammar says.
    limits : DerivationLimits, optional

    Returns
    -------
    word : Word

    Raises
    ------
    DerivationError
        If a limit is reached, a number has no finite value (with line and column), a weight is negative, a
        parameter is unknown, or the number of iterations or the generator is missing.

    Notes
    -----
    O(modules of all words) time; two words at a time are in memory. Random numbers are drawn in the order of
    the constants, the settings, the axiom, and of the modules of each word from left to right; a production's
    weights and choice come before its arguments.

    Examples
    --------
    >>> from species import parse_grammar
    >>> grammar = parse_grammar("param r = 0.5\\naxiom = A(1)\\nA(x) : x > 0.3 -> F(x)[+A(x * r)]A(x * r)")
    >>> str(derive_word(grammar, iterations=1))
    'F(1)[+A(0.5)]A(0.5)'
    >>> str(derive_word(grammar, iterations=1, parameters={"r": 0.25}))
    'F(1)[+A(0.25)]A(0.25)'
    """
    if rng is None and grammar.is_random:
        raise DerivationError("the grammar draws random numbers: hand in a numpy.random.Generator as rng")
    scope = Scope(_constants(grammar, parameters or {}, rng), {}, rng)
    n_iterations, settings = _settings(grammar, scope, iterations, limits)
    table = _Table(grammar, scope)
    codes = [table.code[module.kind] for module in grammar.axiom]
    arguments = [tuple(evaluate(a, scope) for a in module.arguments) for module in grammar.axiom]
    clock = _Clock(limits, n_iterations)
    clock.look(len(codes))
    table.around.look = clock.look
    for _ in range(n_iterations):
        clock.iteration += 1
        codes, arguments = _iterate(table, codes, arguments, clock)
    n_numbers = sum(map(len, arguments))
    return Word(
        tuple(table.code),
        np.fromiter(codes, np.int32, len(codes)),
        np.fromiter(chain.from_iterable(arguments), np.float64, n_numbers),
        settings,
    )


# ---------------------------------------------------------------- constants and settings


def _constants(
    grammar: Grammar, given: Mapping[str, float], rng: np.random.Generator | None
) -> dict[str, float]:
    for name in given:
        if name not in grammar.parameters:
            near = difflib.get_close_matches(str(name)[:32], grammar.parameters, n=1)
            known = ", ".join(grammar.parameters) or "none"
            hint = f', did you mean "{near[0]}"?' if near else f"; it has {known}"
            raise DerivationError(f"the grammar has no param {str(name)[:32]!r}{hint}")
    values: dict[str, float] = {}
    for constant in grammar.constants:
        if constant.name in given:
            values[constant.name] = _given(constant.name, given[constant.name])
        else:
            values[constant.name] = evaluate(constant.value, Scope(values, {}, rng))
    return values


def _given(name: str, value: object) -> float:
    try:
        out = float(value) if isinstance(value, numbers.Real) else math.nan
    except OverflowError:
        out = math.inf
    if not math.isfinite(out):
        raise DerivationError(f"the parameter {name} must be a finite number, got {str(value)[:40]!r}")
    return out


def _settings(
    grammar: Grammar, scope: Scope, iterations: int | None, limits: DerivationLimits
) -> tuple[int, TurtleSettings]:
    values: dict[str, float | tuple[float, ...]] = {}
    for name, expressions in grammar.settings.items():
        several = tuple(evaluate(e, scope) for e in expressions)
        values["angle_deg" if name == "angle" else name] = several if name == "tropism" else several[0]
    said = values.pop("iterations", None)
    wanted = said if iterations is None else iterations
    if wanted is None:
        raise DerivationError('say how many iterations: in the grammar ("iterations = 5") or as an argument')
    if not isinstance(wanted, numbers.Real) or not 0 <= wanted == math.floor(wanted):
        raise DerivationError(f"iterations must be a whole number from 0, got {wanted!r}")
    if wanted > limits.iterations:
        raise DerivationError(
            f"at most {limits.iterations} iterations, got {format_number(float(wanted))}; "
            "ask for fewer, or for more with DerivationLimits(iterations=...)"
        )
    return int(wanted), TurtleSettings(**values)


# ---------------------------------------------------------------- limits


class _Clock:
    """Stops a derivation that takes too long or gets too large."""

    def __init__(self, limits: DerivationLimits, n_iterations: int) -> None:
        self.limits = limits
        self.iteration = 0
        self.n_iterations = n_iterations
        self._end = perf_counter() + limits.seconds

    def look(self, n_modules: int = 0) -> None:
        """Raise if the word is too long or the time is up."""
        if n_modules > self.limits.modules:
            raise DerivationError(
                f"the word has more than {self.limits.modules} modules in iteration {self.iteration} of "
                f"{self.n_iterations}; ask for fewer iterations, or for more modules with "
                "DerivationLimits(modules=...)"
            )
        if perf_counter() > self._end:
            raise DerivationError(
                f"deriving takes longer than {self.limits.seconds:g} s, in iteration {self.iteration} of "
                f"{self.n_iterations}; ask for fewer iterations, or for more time with "
                "DerivationLimits(seconds=...)"
            )


# ---------------------------------------------------------------- rewriting


def _iterate(table: _Table, codes: Codes, arguments: Arguments, clock: _Clock) -> tuple[Codes, Arguments]:
    """Replace all modules once."""
    if table.around.is_needed:
        table.around.codes, table.around.arguments = codes, arguments
        find_neighbours(table.around)
    rules = table.rules
    out_codes: Codes = []
    out_arguments: Arguments = []
    for low in range(0, len(codes), table.chunk):
        high = low + table.chunk
        for i, (code, values) in enumerate(zip(codes[low:high], arguments[low:high], strict=True), low):
            rule = rules[code]
            if rule is None:
                out_codes.append(code)
                out_arguments.append(values)
            else:
                rule(values, out_codes, out_arguments, i)
        clock.look(len(out_codes))
    return out_codes, out_arguments


class _Table:
    """A grammar compiled: the code of each kind of module, and its rule."""

    def __init__(self, grammar: Grammar, scope: Scope) -> None:
        self.code: dict[tuple[str, int], int] = {("[", 0): 0, ("]", 0): 1}
        for module in chain(grammar.axiom, *(p.successor for p in grammar.productions)):
            self.code.setdefault(module.kind, len(self.code))
        ignored = frozenset(code for (name, _), code in self.code.items() if name in grammar.ignore)
        self.around = Surroundings(ignored)
        by_code: dict[int, list[Production]] = {}
        for production in grammar.productions:
            code = self.code.get(production.predecessor.kind, -1)  # -1: does not occur, so never matches
            by_code.setdefault(code, []).append(production)
        self.rules: list[Rule | None] = [None] * len(self.code)
        for code, productions in by_code.items():
            if code >= 0:
                self.rules[code] = self._rule(code, productions, scope)
        work = max((sum(map(_work, p)) for p in by_code.values()), default=1)
        self.chunk = max(1, min(LARGEST_CHUNK, CHUNK_WORK // work))

    def _rule(self, code: int, productions: list[Production], scope: Scope) -> Rule:
        """What replaces a module of one kind."""
        compiled = [_Compiled(p, self.code, self.around, scope) for p in productions]
        first = compiled[0]
        if first.context is None and first.condition is None and first.weight is None:
            return first.emit
        groups: list[list[_Compiled]] = []
        rivals: dict[object, list[_Compiled]] = {}
        for one in compiled:
            if one.weight is not None and one.shape in rivals:
                rivals[one.shape].append(one)
                continue
            groups.append([one])
            if one.weight is not None:
                rivals[one.shape] = groups[-1]
        return _choose(code, groups, scope.rng)


def _work(production: Production) -> int:
    """About how many operations trying and using a production takes."""
    expressions = sum(sum(1 for _ in nodes_of(e)) for e in production.expressions)
    context = len(production.left) + sum(1 for _ in patterns_in(production.right))
    return 1 + expressions + context + len(production.successor)


class _Compiled:
    """A production as closures."""

    def __init__(
        self,
        production: Production,
        code: Mapping[tuple[str, int], int],
        around: Surroundings,
        scope: Scope,
    ) -> None:
        position = {name: k for k, name in enumerate(production.parameters)}
        local = Scope(scope.constants, position, scope.rng)
        self.shape = production.shape
        self.place = production.place
        self.context = compile_context(production, code, around)
        self.condition = (
            None if production.condition is None else compile_expression(production.condition, local)
        )
        self.weight = None if production.weight is None else compile_expression(production.weight, local)
        self.emit = _emitter(production.successor, code, local)

    def values(self, values: Values, i: int) -> Values | None:
        """All parameters if context and condition hold, else None."""
        if self.context is not None:
            found = self.context(values, i)
            if found is None:
                return None
            values = found
        if self.condition is not None and not self.condition(values):
            return None
        return values


def _choose(code: int, groups: list[list[_Compiled]], rng: np.random.Generator | None) -> Rule:
    """Rule that tries productions in order; of a group of weighted ones it draws one."""

    def rule(own: Values, out_codes: Codes, out_arguments: Arguments, i: int) -> None:
        for group in groups:
            first = group[0]
            if first.weight is None:
                values = first.values(own, i)
                if values is not None:
                    first.emit(values, out_codes, out_arguments, i)
                    return
            else:
                drawn = _draw(group, own, i, rng)
                if drawn is not None:
                    drawn[0].emit(drawn[1], out_codes, out_arguments, i)
                    return
        out_codes.append(code)
        out_arguments.append(own)

    return rule


def _draw(
    group: list[_Compiled], own: Values, i: int, rng: np.random.Generator | None
) -> tuple[_Compiled, Values] | None:
    """One of the productions that match, with a probability in proportion to its weight."""
    candidates = []
    total = 0.0
    for one in group:
        values = one.values(own, i)
        if values is None:
            continue
        assert one.weight is not None
        weight = one.weight(values)
        if weight < 0.0:
            line, column = one.place
            raise DerivationError(
                f"line {line}, column {column}: a weight must be >= 0, got {format_number(weight)}"
            )
        if weight > 0.0:
            total += weight
            candidates.append((total, one, values))
    if not candidates:
        return None
    if math.isinf(total):
        line, column = group[0].place
        raise DerivationError(f"line {line}, column {column}: the weights are too large to be added")
    if len(candidates) > 1:
        assert rng is not None
        mark = rng.random() * total
        for up_to, one, values in candidates:
            if mark < up_to:
                return one, values
    return candidates[-1][1:]


def _emitter(successor: tuple[Module, ...], code: Mapping[tuple[str, int], int], scope: Scope) -> Rule:
    """Rule that appends a successor: a template, and what has to be computed for it."""
    codes = [code[module.kind] for module in successor]
    template: Arguments = []
    varying: list[tuple[int, Callable[[Values], Values]]] = []
    for k, module in enumerate(successor):
        evaluators = [compile_expression(a, scope) for a in module.arguments]
        if all(map(is_constant, evaluators)):
            template.append(tuple(evaluator(()) for evaluator in evaluators))
        else:
            template.append(())
            varying.append((k, _row(module.arguments, evaluators)))
    if not varying:

        def emit_template(own: Values, out_codes: Codes, out_arguments: Arguments, i: int) -> None:
            out_codes += codes
            out_arguments += template

        return emit_template

    def emit(own: Values, out_codes: Codes, out_arguments: Arguments, i: int) -> None:
        row = template.copy()
        for k, build in varying:
            row[k] = build(own)
        out_codes += codes
        out_arguments += row

    return emit


def _row(arguments: tuple[Expression, ...], evaluators: list[Evaluator]) -> Callable[[Values], Values]:
    """All arguments of a module; those of one and two, the most frequent, without a loop."""
    if len(evaluators) == 1:
        (a,) = evaluators
        return lambda v: (a(v),)
    if len(evaluators) == 2:
        a, b = evaluators
        return lambda v: (a(v), b(v))
    return lambda v: tuple([f(v) for f in evaluators])
