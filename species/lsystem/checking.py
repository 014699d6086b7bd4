"""What a grammar must agree on: names are known, modules have their parameters, nothing is out of reach."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Set
from typing import NoReturn

from species.lsystem.syntax import (
    COMMANDS,
    Expression,
    Grammar,
    Module,
    Name,
    Pattern,
    Place,
    Production,
    nodes_of,
    patterns_in,
)

__all__ = ["check_grammar"]

Fail = Callable[[Place, str], NoReturn]


def check_grammar(grammar: Grammar, fail: Fail) -> None:
    """Call `fail` with the place and the message of the first thing that is wrong."""
    constants = _check_constants(grammar, fail)
    for name, values in grammar.settings.items():
        for value in values:
            _check_names(value, constants, f"in {name}", fail)
    for module in grammar.axiom:
        for argument in module.arguments:
            _check_names(argument, constants, "in the axiom", fail)
    for production in grammar.productions:
        _check_production(production, constants, fail)
    _check_declarations(grammar, fail)
    _check_meaning(grammar, fail)
    _check_arity(grammar, fail)
    _check_ignored(grammar, fail)


def _check_constants(grammar: Grammar, fail: Fail) -> frozenset[str]:
    known: set[str] = set()
    for constant in grammar.constants:
        _check_names(constant.value, known, f"before {constant.name}", fail)
        if constant.name in known:
            fail(constant.place, f'"{constant.name}" has a value already')
        known.add(constant.name)
    return frozenset(known)


def _check_names(expression: Expression, known: Set[str], where: str, fail: Fail) -> None:
    for node in nodes_of(expression):
        if isinstance(node, Name) and node.name not in known:
            near = difflib.get_close_matches(node.name, sorted(known), n=1)
            hint = f', did you mean "{near[0]}"?' if near else ""
            fail(node.place, f'"{node.name}" is not a parameter or a constant {where}{hint}')


def _check_production(production: Production, constants: frozenset[str], fail: Fail) -> None:
    known = set(constants)
    for pattern in (*production.left, production.predecessor, *patterns_in(production.right)):
        for name in pattern.parameters:
            if name in constants:
                fail(pattern.place, f'the parameter "{name}" has the name of a constant; rename one of them')
            if name in known:
                fail(pattern.place, f'"{name}" is the name of two parameters; rename one of them')
            known.add(name)
    for expression in production.expressions:
        _check_names(expression, known, "of this production", fail)


def _check_declarations(grammar: Grammar, fail: Fail) -> None:
    seen: set[str] = set()
    for declaration in grammar.declarations:
        if declaration.name in seen:
            fail(declaration.place, f'the module "{declaration.name}" is declared twice')
        seen.add(declaration.name)
        for name in declaration.parameters:
            if declaration.parameters.count(name) > 1:
                fail(declaration.place, f'"{name}" is the name of two parameters; rename one of them')


def _written(grammar: Grammar) -> Iterator[Module]:
    yield from grammar.axiom
    for production in grammar.productions:
        yield from production.successor


def _matched(grammar: Grammar) -> Iterator[Pattern]:
    for production in grammar.productions:
        yield production.predecessor
        yield from production.left
        yield from patterns_in(production.right)


def _check_meaning(grammar: Grammar, fail: Fail) -> None:
    """Every module does something, or is said to do nothing: that finds names that are mistyped."""
    known = {d.name for d in grammar.declarations} | {p.name for p in _matched(grammar)} | set(COMMANDS)
    for module in _written(grammar):
        if module.name not in known:
            fail(
                module.place,
                f'"{module.name}" is no turtle command, has no production and stands in no context; '
                f'if that is meant write "module {module.name}" (longer names are declared so too)'
                if not module.name.isdigit()
                else f'the module "{module.name}" has no production and stands in no context',
            )


def _check_arity(grammar: Grammar, fail: Fail) -> None:
    """A module has the same number of parameters everywhere; a turtle command may also have fewer."""
    arity = {d.name: (len(d.parameters), d.place) for d in grammar.declarations}
    written = list(_written(grammar))
    modules: list[Module | Pattern] = [*written, *_matched(grammar)]
    for one in modules:
        if one.name in COMMANDS:
            continue
        n = one.kind[1]
        first, place = arity.setdefault(one.name, (n, one.place))
        if n != first:
            fail(
                one.place,
                f'"{one.name}" has {n} parameter{"s" * (n != 1)} here and {first} in line {place[0]}',
            )
    kinds = {module.kind for module in written}
    names = {module.name for module in written}
    for pattern in _matched(grammar):
        if pattern.name in names and pattern.kind not in kinds:
            n = pattern.kind[1]
            fail(
                pattern.place,
                f'"{pattern.name}" never occurs with {n} parameter{"s" * (n != 1)}, so this never matches',
            )


def _check_ignored(grammar: Grammar, fail: Fail) -> None:
    for production in grammar.productions:
        for pattern in (*production.left, *patterns_in(production.right)):
            if pattern.name in grammar.ignore:
                fail(pattern.place, f'"{pattern.name}" is ignored, so it cannot be a context')
