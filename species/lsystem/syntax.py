"""What a grammar consists of, and how it is written as text: plain data, nothing is run here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

__all__ = [
    "COMMANDS",
    "FUNCTIONS",
    "KEYWORDS",
    "MAX_PARAMETERS",
    "RANDOM_FUNCTIONS",
    "SETTINGS",
    "Binary",
    "Branch",
    "Call",
    "Constant",
    "Declaration",
    "Expression",
    "Grammar",
    "Module",
    "Name",
    "Number",
    "Pattern",
    "Place",
    "Production",
    "Unary",
    "format_expression",
    "format_grammar",
    "format_number",
    "nodes_of",
    "patterns_in",
]

Place = tuple[int, int]
"""Line and column, both from 1."""

COMMANDS = tuple("Ff+-&^\\/|$!~L[]")
"""Modules that the turtle obeys."""

SETTINGS = ("iterations", "angle", "step", "width", "taper", "leaf", "tropism")
"""What a grammar may say once, as ``angle = 22.5``."""

KEYWORDS = ("const", "param", "module", "ignore", "axiom", *SETTINGS)
"""Words that begin a statement."""

#: Least and largest number of arguments.
FUNCTIONS = {
    "abs": (1, 1),
    "acos": (1, 1),
    "asin": (1, 1),
    "atan": (1, 1),
    "atan2": (2, 2),
    "ceil": (1, 1),
    "cos": (1, 1),
    "exp": (1, 1),
    "floor": (1, 1),
    "if": (3, 3),
    "log": (1, 1),
    "max": (2, 12),
    "min": (2, 12),
    "normal": (2, 2),
    "sign": (1, 1),
    "sin": (1, 1),
    "sqrt": (1, 1),
    "tan": (1, 1),
    "uniform": (2, 2),
}
RANDOM_FUNCTIONS = ("normal", "uniform")
MAX_PARAMETERS = 8
"""Most parameters of a module: bounds the memory of a word of so many modules."""


def _place() -> Place:
    return field(default=(1, 1), compare=False, repr=False)


@dataclass(frozen=True)
class Number:
    """A number as it stands in the text."""

    value: float
    place: Place = _place()


@dataclass(frozen=True)
class Name:
    """A parameter of the predecessor or its context, or a constant."""

    name: str
    place: Place = _place()


@dataclass(frozen=True)
class Unary:
    """``-x`` or ``not x``."""

    operator: str
    operand: Expression
    place: Place = _place()


@dataclass(frozen=True)
class Binary:
    """Two operands and what is between them."""

    operator: str
    left: Expression
    right: Expression
    place: Place = _place()


@dataclass(frozen=True)
class Call:
    """One of :data:`FUNCTIONS` of some arguments."""

    function: str
    arguments: tuple[Expression, ...]
    place: Place = _place()


Expression = Number | Name | Unary | Binary | Call


@dataclass(frozen=True)
class Constant:
    """``const name = value``, or ``param name = value``, which the caller may replace."""

    name: str
    value: Expression
    is_param: bool
    place: Place = _place()


@dataclass(frozen=True)
class Declaration:
    """``module Name(a, b)``: a module that is longer than a letter or has no other meaning."""

    name: str
    parameters: tuple[str, ...]
    place: Place = _place()


@dataclass(frozen=True)
class Module:
    """A module of the axiom or of a successor."""

    name: str
    arguments: tuple[Expression, ...] = ()
    place: Place = _place()

    @property
    def kind(self) -> tuple[str, int]:
        """Name and number of parameters: what has to agree for a production to match."""
        return self.name, len(self.arguments)


@dataclass(frozen=True)
class Pattern:
    """A module of a predecessor or its context, with names for its parameters."""

    name: str
    parameters: tuple[str, ...] = ()
    place: Place = _place()

    @property
    def kind(self) -> tuple[str, int]:
        """Name and number of parameters."""
        return self.name, len(self.parameters)


@dataclass(frozen=True)
class Branch:
    """``[ ... ]`` in a right context."""

    items: tuple[Pattern | Branch, ...]


@dataclass(frozen=True)
class Production:
    """``left < predecessor > right : condition -> (weight) successor``."""

    predecessor: Pattern
    successor: tuple[Module, ...]
    left: tuple[Pattern, ...] = ()
    right: tuple[Pattern | Branch, ...] = ()
    condition: Expression | None = None
    weight: Expression | None = None
    place: Place = _place()

    @property
    def parameters(self) -> tuple[str, ...]:
        """All parameter names: of the left context, the predecessor and the right context."""
        patterns = [*self.left, self.predecessor, *patterns_in(self.right)]
        return tuple(name for pattern in patterns for name in pattern.parameters)

    @property
    def shape(self) -> tuple[object, ...]:
        """Modules of predecessor and context without the parameters' names; weighted rivals share it."""
        return tuple(p.kind for p in self.left), self.predecessor.kind, _shape(self.right)

    @property
    def expressions(self) -> Iterator[Expression]:
        """Condition, weight and all arguments."""
        for expression in (self.condition, self.weight):
            if expression is not None:
                yield expression
        for module in self.successor:
            yield from module.arguments


@dataclass(frozen=True)
class Grammar:
    """A parsed grammar: plain data that can be compared, printed and derived.

    Attributes
    ----------
    axiom : tuple of Module
        The word to begin with; its brackets are balanced, as are those of all successors.
    productions : tuple of Production
        In the order of the text, which is the order in which they are tried.
    constants : tuple of Constant
        In the order in which they are computed.
    settings : dict of str to tuple of Expression
        The statements of :data:`SETTINGS` that are there; three expressions for ``tropism``, else one.
    declarations : tuple of Declaration
    ignore : tuple of str
        Modules that context matching does not see.

    Notes
    -----
    ``str(grammar)`` is text that :func:`species.parse_grammar` reads as an equal grammar.
    """

    axiom: tuple[Module, ...]
    productions: tuple[Production, ...] = ()
    constants: tuple[Constant, ...] = ()
    settings: dict[str, tuple[Expression, ...]] = field(default_factory=dict)
    declarations: tuple[Declaration, ...] = ()
    ignore: tuple[str, ...] = ()

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names that a caller may give another value (``param``)."""
        return tuple(constant.name for constant in self.constants if constant.is_param)

    @property
    def is_random(self) -> bool:
        """Whether deriving it needs random numbers."""
        if any(production.weight is not None for production in self.productions):
            return True
        return any(
            isinstance(node, Call) and node.function in RANDOM_FUNCTIONS
            for expression in self._expressions()
            for node in nodes_of(expression)
        )

    def _expressions(self) -> Iterator[Expression]:
        for constant in self.constants:
            yield constant.value
        for values in self.settings.values():
            yield from values
        for module in self.axiom:
            yield from module.arguments
        for production in self.productions:
            yield from production.expressions

    def __str__(self) -> str:
        return format_grammar(self)


def patterns_in(items: tuple[Pattern | Branch, ...]) -> Iterator[Pattern]:
    """All patterns of a right context, from left to right."""
    for item in items:
        if isinstance(item, Branch):
            yield from patterns_in(item.items)
        else:
            yield item


def _shape(items: tuple[Pattern | Branch, ...]) -> tuple[object, ...]:
    return tuple(_shape(item.items) if isinstance(item, Branch) else item.kind for item in items)


def nodes_of(expression: Expression) -> Iterator[Expression]:
    """The expression and all parts of it."""
    pending = [expression]
    while pending:
        node = pending.pop()
        yield node
        if isinstance(node, Unary):
            pending.append(node.operand)
        elif isinstance(node, Binary):
            pending += [node.left, node.right]
        elif isinstance(node, Call):
            pending += node.arguments


def format_number(value: float) -> str:
    """Shortest text that is read as the same number: ``1``, ``0.7``, ``1e-07``."""
    text = repr(float(value))
    return text[:-2] if text.endswith(".0") else text


def format_expression(expression: Expression) -> str:
    """Text with brackets around every operation inside another one."""
    if isinstance(expression, Number):
        return format_number(expression.value)
    if isinstance(expression, Name):
        return expression.name
    if isinstance(expression, Call):
        return f"{expression.function}({', '.join(map(format_expression, expression.arguments))})"
    if isinstance(expression, Unary):
        gap = " " if expression.operator == "not" else ""
        return f"{expression.operator}{gap}{_bracketed(expression.operand)}"
    return f"{_bracketed(expression.left)} {expression.operator} {_bracketed(expression.right)}"


def _bracketed(expression: Expression) -> str:
    text = format_expression(expression)
    return f"({text})" if isinstance(expression, Unary | Binary) else text


def format_grammar(grammar: Grammar) -> str:
    """Text of a grammar, one line for each statement."""
    lines = [f"module {_declaration(d)}" for d in grammar.declarations]
    lines += [
        f"{'param' if c.is_param else 'const'} {c.name} = {format_expression(c.value)}"
        for c in grammar.constants
    ]
    lines += [
        f"{name} = {', '.join(map(format_expression, values))}" for name, values in grammar.settings.items()
    ]
    if grammar.ignore:
        lines.append(f"ignore = {' '.join(grammar.ignore)}")
    gap = " " if grammar.declarations else ""  # names of several letters would run together
    lines.append(f"axiom = {_format_modules(grammar.axiom, gap)}".rstrip())
    lines += [_format_production(production, gap) for production in grammar.productions]
    return "\n".join(lines) + "\n"


def _declaration(declaration: Declaration) -> str:
    names = ", ".join(declaration.parameters)
    return f"{declaration.name}({names})" if names else declaration.name


def _format_modules(modules: tuple[Module, ...], gap: str) -> str:
    out = []
    for module in modules:
        arguments = ", ".join(map(format_expression, module.arguments))
        out.append(f"{module.name}({arguments})" if module.arguments else module.name)
    return gap.join(out)


def _format_patterns(items: tuple[Pattern | Branch, ...]) -> str:
    out = []
    for item in items:
        if isinstance(item, Branch):
            out.append(f"[{_format_patterns(item.items)}]")
        else:
            out.append(f"{item.name}({', '.join(item.parameters)})" if item.parameters else item.name)
    return " ".join(out)


def _format_production(production: Production, gap: str) -> str:
    text = _format_patterns((production.predecessor,))
    if production.left:
        text = f"{_format_patterns(production.left)} < {text}"
    if production.right:
        text = f"{text} > {_format_patterns(production.right)}"
    if production.condition is not None:
        text = f"{text} : {format_expression(production.condition)}"
    text = f"{text} ->"
    if production.weight is not None:
        text = f"{text} ({format_expression(production.weight)})"
    return f"{text} {_format_modules(production.successor, gap)}".rstrip()
