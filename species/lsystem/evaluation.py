"""Expressions as closures over a tuple of parameters. Every number that comes out is finite.

An operation whose result is not finite raises at once and names its place: so no infinity can hide in a
later one. Angles are degrees, as everywhere in a grammar. What does not depend on a parameter or on chance is
computed when it is compiled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from species.errors import DerivationError
from species.lsystem.syntax import (
    RANDOM_FUNCTIONS,
    Binary,
    Call,
    Expression,
    Name,
    Number,
    Place,
    Unary,
    format_number,
)

__all__ = ["Evaluator", "Scope", "compile_expression", "evaluate", "is_constant"]

Values = tuple[float, ...]
Evaluator = Callable[[Values], float]

DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class Scope:
    """What names mean: a number, or a position in the tuple of parameters; and where chance comes from."""

    constants: Mapping[str, float]
    position: Mapping[str, int]
    rng: np.random.Generator | None


def evaluate(expression: Expression, scope: Scope) -> float:
    """The value of an expression that has no parameters."""
    return compile_expression(expression, scope)(())


def compile_expression(expression: Expression, scope: Scope) -> Evaluator:
    """Make a closure that computes an expression from the parameters.

    Parameters
    ----------
    expression : Expression
        At most as deep as the parser lets through.
    scope : Scope
        Knows all names, and has a generator if the expression is random.

    Returns
    -------
    evaluator : callable
        From the tuple of parameters to a finite float; comparisons give 0.0 or 1.0.

    Raises
    ------
    DerivationError
        Not here: the evaluator raises it where there is no finite value.
    """
    if isinstance(expression, Number):
        return _constant(expression.value)
    if isinstance(expression, Name):
        if expression.name in scope.constants:
            return _constant(scope.constants[expression.name])
        return _getter(scope.position[expression.name])
    if isinstance(expression, Call) and expression.function in RANDOM_FUNCTIONS:
        return _random(expression, scope)
    parts = [compile_expression(part, scope) for part in _parts(expression)]
    made = _operation(expression, parts)
    if all(map(is_constant, parts)):
        try:
            return _constant(made(()))
        except DerivationError:
            return made  # it may stand where it is never computed, as in if(n > 0, 1 / n, 0) with n = 0
    return made


class _Constant:
    """An evaluator that always says the same; what is made of such ones alone is computed once."""

    def __init__(self, value: float) -> None:
        self.value = value

    def __call__(self, values: Values) -> float:
        return self.value


def is_constant(evaluator: Evaluator) -> bool:
    """Whether the value depends neither on parameters nor on chance."""
    return isinstance(evaluator, _Constant)


def _constant(value: float) -> Evaluator:
    return _Constant(float(value))


def _getter(k: int) -> Evaluator:
    if k == 0:
        return lambda v: v[0]
    return lambda v: v[k]


def _parts(expression: Expression) -> tuple[Expression, ...]:
    if isinstance(expression, Unary):
        return (expression.operand,)
    if isinstance(expression, Binary):
        return expression.left, expression.right
    assert isinstance(expression, Call)
    return expression.arguments


def _fail(place: Place, what: str) -> DerivationError:
    return DerivationError(f"line {place[0]}, column {place[1]}: {what}")


def _shown(*values: float) -> str:
    return ", ".join(format_number(float(f"{value:.6g}")) for value in values)


# ---------------------------------------------------------------- operators


def _operation(expression: Expression, parts: list[Evaluator]) -> Evaluator:
    if isinstance(expression, Unary):
        a = parts[0]
        if expression.operator == "-":
            return lambda v: -a(v)
        return lambda v: 0.0 if a(v) else 1.0
    if isinstance(expression, Binary):
        a, b = parts
        if expression.operator in _COMPARISONS:
            return _COMPARISONS[expression.operator](a, b)
        if expression.operator == "*" and isinstance(b, _Constant):  # by far the most frequent
            return _scale(expression, a, b.value)
        return _arithmetic(expression, a, b)
    assert isinstance(expression, Call)
    if expression.function == "if":
        test, a, b = parts
        return lambda v: a(v) if test(v) else b(v)
    return _function(expression, parts)


_COMPARISONS: dict[str, Callable[[Evaluator, Evaluator], Evaluator]] = {
    "<": lambda a, b: lambda v: 1.0 if a(v) < b(v) else 0.0,
    "<=": lambda a, b: lambda v: 1.0 if a(v) <= b(v) else 0.0,
    ">": lambda a, b: lambda v: 1.0 if a(v) > b(v) else 0.0,
    ">=": lambda a, b: lambda v: 1.0 if a(v) >= b(v) else 0.0,
    "==": lambda a, b: lambda v: 1.0 if a(v) == b(v) else 0.0,
    "!=": lambda a, b: lambda v: 1.0 if a(v) != b(v) else 0.0,
    "and": lambda a, b: lambda v: 1.0 if a(v) and b(v) else 0.0,
    "or": lambda a, b: lambda v: 1.0 if a(v) or b(v) else 0.0,
}


def _not_finite(node: Binary, a: float, b: float) -> DerivationError:
    return _fail(
        node.place, f"{_shown(a)} {node.operator} {_shown(b)} is too large; numbers go up to about 1e308"
    )


def _scale(node: Binary, a: Evaluator, factor: float) -> Evaluator:
    def run(v: Values) -> float:
        x = a(v)
        r = x * factor
        if r - r:  # nan for what is not finite, 0 for all else
            raise _not_finite(node, x, factor)
        return r

    return run


def _arithmetic(node: Binary, a: Evaluator, b: Evaluator) -> Evaluator:
    compute = _ARITHMETIC[node.operator]

    def run(v: Values) -> float:
        x, y = a(v), b(v)
        try:
            r = compute(x, y)
        except ZeroDivisionError:
            raise _fail(node.place, f"{_shown(x)} {node.operator} {_shown(y)} divides by zero") from None
        except ValueError:
            raise _fail(node.place, f"{_shown(x)} {node.operator} {_shown(y)} is no real number") from None
        except OverflowError:
            raise _not_finite(node, x, y) from None
        if r - r:
            raise _not_finite(node, x, y)
        return r

    return run


def _power(x: float, y: float) -> float:
    if x == 0.0 and y < 0.0:
        raise ZeroDivisionError
    return math.pow(x, y)


_ARITHMETIC: dict[str, Callable[[float, float], float]] = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": lambda x, y: x / y,
    "%": lambda x, y: x % y,
    "^": _power,
}

# ---------------------------------------------------------------- functions


def _tangent(x: float) -> float:
    if math.fmod(x, 180.0) in (90.0, -90.0):
        raise ValueError
    return math.tan(x * DEGREE)


_UNARY: dict[str, Callable[[float], float]] = {
    "abs": abs,
    "acos": lambda x: math.acos(x) / DEGREE,
    "asin": lambda x: math.asin(x) / DEGREE,
    "atan": lambda x: math.atan(x) / DEGREE,
    "ceil": lambda x: float(math.ceil(x)),
    "cos": lambda x: math.cos(x * DEGREE),
    "exp": math.exp,
    "floor": lambda x: float(math.floor(x)),
    "log": math.log,
    "sign": lambda x: float((x > 0.0) - (x < 0.0)),
    "sin": lambda x: math.sin(x * DEGREE),
    "sqrt": math.sqrt,
    "tan": _tangent,
}


def _function(node: Call, parts: list[Evaluator]) -> Evaluator:
    if node.function in ("min", "max"):
        pick = min if node.function == "min" else max
        if len(parts) == 2:
            a, b = parts
            return lambda v: pick(a(v), b(v))
        return lambda v: pick(p(v) for p in parts)
    if node.function == "atan2":
        a, b = parts
        return lambda v: math.atan2(a(v), b(v)) / DEGREE
    compute, argument = _UNARY[node.function], parts[0]

    def run(v: Values) -> float:
        x = argument(v)
        try:
            return compute(x)
        except ValueError:
            raise _fail(node.place, f"{node.function}({_shown(x)}) is no real number") from None
        except OverflowError:
            raise _fail(
                node.place, f"{node.function}({_shown(x)}) is too large; numbers go up to about 1e308"
            ) from None

    return run


def _random(node: Call, scope: Scope) -> Evaluator:
    """``uniform(a, b)`` or ``normal(mean, spread)``: one draw each time, after both arguments."""
    assert scope.rng is not None  # derive_word asks for it where the grammar is random
    a, b = (compile_expression(argument, scope) for argument in node.arguments)
    uniform = node.function == "uniform"
    draw = scope.rng.random if uniform else scope.rng.standard_normal

    def run(v: Values) -> float:
        x, y = a(v), b(v)
        if not uniform and y < 0.0:
            raise _fail(node.place, f"the spread of normal must be >= 0, got {_shown(y)}")
        r = x + (y - x) * draw() if uniform else x + y * draw()
        if r - r:
            raise _fail(
                node.place, f"{node.function}({_shown(x, y)}) is too large; numbers go up to about 1e308"
            )
        return float(r)

    return run
