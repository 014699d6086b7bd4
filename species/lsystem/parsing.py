"""The parser of grammars: recursive descent, operators by precedence, nothing is evaluated."""

from __future__ import annotations

import difflib
import math
import re

from species.lsystem.checking import check_grammar
from species.lsystem.scanning import NUMBER, WORD, Scanner, Source, Statement, shorten
from species.lsystem.syntax import (
    COMMANDS,
    FUNCTIONS,
    KEYWORDS,
    MAX_PARAMETERS,
    Binary,
    Branch,
    Call,
    Constant,
    Declaration,
    Expression,
    Grammar,
    Module,
    Name,
    Number,
    Pattern,
    Production,
    Unary,
    patterns_in,
)

__all__ = ["parse_grammar"]

MAX_DEPTH = 40
"""Most operations inside each other: an evaluator's calls are as deep."""
MAX_CONTEXT = 16
"""Most modules of a left or right context."""
MAX_NAME = 32
"""Most characters of a name: bounds the search for the longest one and for similar ones."""

LETTERS = "".join(map(chr, (*range(ord("a"), ord("z") + 1), *range(ord("A"), ord("Z") + 1))))
DIGITS = "0123456789"
SINGLES = LETTERS + DIGITS + "".join(c for c in COMMANDS if c not in LETTERS)
UNBRACKETED = SINGLES.replace("[", "").replace("]", "")

#: How tightly an operator binds, and how it is written out.
BINARY = {
    "or": (1, "or"),
    "||": (1, "or"),
    "and": (2, "and"),
    "&&": (2, "and"),
    "<": (4, "<"),
    "<=": (4, "<="),
    ">": (4, ">"),
    ">=": (4, ">="),
    "=": (4, "=="),
    "==": (4, "=="),
    "!=": (4, "!="),
    "+": (5, "+"),
    "-": (5, "-"),
    "*": (6, "*"),
    "/": (6, "/"),
    "%": (6, "%"),
    "^": (8, "^"),
    "**": (8, "^"),
}
NOT, COMPARISON, SIGN, POWER = 3, 4, 7, 8
RESERVED = frozenset({"and", "or", "not", *FUNCTIONS})
LOGIC = re.compile(r"(?:and|or)(?![A-Za-z0-9_])")


def parse_grammar(text: str, *, name: str = "") -> Grammar:
    """Read the text of a grammar (docs/lsystem.md has the language).

    Parameters
    ----------
    text : str
        At most 100 000 characters.
    name : str, optional
        What errors begin with, for instance the name of the file.

    Returns
    -------
    grammar : Grammar
        Plain data; nothing has been computed.

    Raises
    ------
    GrammarError
        With line and column, the text that is wrong, and what was expected there.

    Notes
    -----
    O(length of the text); the text is never run as a program of any kind.

    Examples
    --------
    >>> from species import derive_word, parse_grammar
    >>> algae = parse_grammar("axiom = A\\nA -> AB\\nB -> A")
    >>> str(derive_word(algae, iterations=4))
    'ABAABABA'
    """
    source = Source(text, name)
    statements = list(source.statements())
    names = frozenset(d.name for s in statements for d in _Parser(source, s, frozenset()).declarations())
    out = _Draft()
    for statement in statements:
        _Parser(source, statement, names).statement(out)
    if out.axiom is None:
        source.fail(len(text), 'a grammar needs an axiom, as in "axiom = A"', excerpt=False)
    grammar = Grammar(
        out.axiom,
        tuple(out.productions),
        tuple(out.constants),
        out.settings,
        tuple(out.declarations),
        out.ignore or (),
    )
    check_grammar(grammar, source.fail_at)
    return grammar


class _Draft:
    """What has been read so far."""

    def __init__(self) -> None:
        self.axiom: tuple[Module, ...] | None = None
        self.productions: list[Production] = []
        self.constants: list[Constant] = []
        self.settings: dict[str, tuple[Expression, ...]] = {}
        self.declarations: list[Declaration] = []
        self.ignore: tuple[str, ...] | None = None


class _Parser(Scanner):
    """Reads one statement."""

    def __init__(self, source: Source, statement: Statement, names: frozenset[str]) -> None:
        super().__init__(source, statement, names)
        self._first = statement.begin
        self._depth = 0

    # ------------------------------------------------------------ statements

    def keyword(self) -> str:
        """Go past the keyword that the statement begins with; "" if it begins with something else."""
        at = self.at
        word = self.match(WORD)
        if word in KEYWORDS:
            return word
        self.at = at
        return ""

    def statement(self, out: _Draft) -> None:
        """Read the statement into `out`."""
        word = self.keyword()
        if word == "":
            out.productions.append(self.production())
        elif word in ("const", "param"):
            out.constants.append(self.constant(word))
        elif word == "module":
            self.at = self._first
            out.declarations += self.declarations()
        elif word == "ignore":
            self.once(word, out.ignore)
            out.ignore = self.ignored()
        elif word == "axiom":
            self.once(word, out.axiom)
            self.take("=")
            out.axiom = self.modules()
        else:
            self.once(word, out.settings.get(word))
            out.settings[word] = self.setting(word)
        if not self.done:
            self.unexpected("the end of the statement")

    def once(self, word: str, before: object) -> None:
        """Fail if there was such a statement before."""
        if before is not None:
            self.source.fail(self._first, f'"{word}" may stand in a grammar once')

    def constant(self, word: str) -> Constant:
        """``name = expression``."""
        at = self.skip_blank()
        name = self.name(f"a name after {word}")
        self.expect("=")
        return Constant(name, self.expression(), word == "param", self.source.place(at))

    def name(self, wanted: str) -> str:
        """A name that has no meaning yet."""
        at = self.skip_blank()
        name = self.match(WORD)
        if not name:
            self.unexpected(wanted)
        self.short(name, at)
        if name in RESERVED:
            self.source.fail(at, f'"{name}" is the name of a function or an operator; take another name')
        return name

    def short(self, name: str, at: int) -> None:
        """Fail if a name is too long."""
        if len(name) > MAX_NAME:
            self.source.fail(at, f"a name has at most {MAX_NAME} characters, got {len(name)}")

    def declarations(self) -> list[Declaration]:
        """``module Name(a, b) Other``; nothing if the statement is another one."""
        if self.keyword() != "module":
            return []
        out = []
        while not self.done:
            at = self.skip_blank()
            name = self.match(WORD)
            if not name:
                self.unexpected("a module's name")
            self.short(name, at)
            if name in KEYWORDS or name in COMMANDS:
                self.source.fail(at, f'"{name}" has a meaning already; take another name for the module')
            out.append(Declaration(name, self.names(), self.source.place(at)))
            self.take(",")
        if not out:
            self.unexpected("a module's name")
        return out

    def ignored(self) -> tuple[str, ...]:
        """Modules that contexts do not see."""
        self.take("=")
        out = []
        while not self.done:
            out.append(self.module_name(UNBRACKETED) or self.unexpected("a module's name"))
        return tuple(out)

    def setting(self, word: str) -> tuple[Expression, ...]:
        """One expression, or three for a direction."""
        self.take("=")
        values = [self.expression()]
        while word == "tropism" and len(values) < 3:
            self.expect(",", '"," and the next of three numbers')
            values.append(self.expression())
        return tuple(values)

    # ------------------------------------------------------------ productions

    def production(self) -> Production:
        """``left < predecessor > right : condition -> (weight) successor``."""
        place = self.source.place(self._first)
        patterns = self.patterns()
        left: tuple[Pattern, ...] = ()
        if self.take("<"):
            left, patterns = patterns, self.patterns()
        right: tuple[Pattern | Branch, ...] = ()
        if self.take(">"):
            right = self.branch_patterns()
        condition = self.expression() if self.take(":") else None
        if not self.take("->"):
            self.no_arrow(len(patterns))
        if len(patterns) != 1:
            self.source.fail(self._first, f"one module is replaced at a time, got {len(patterns)}")
        if len(left) > MAX_CONTEXT:
            self.source.fail(self._first, f"a context has at most {MAX_CONTEXT} modules, got {len(left)}")
        weight = None
        if self.take("("):
            weight = self.expression()
            self.expect(")")
        return Production(patterns[0], self.modules(), left, right, condition, weight, place)

    def no_arrow(self, n_patterns: int) -> None:
        """Fail where a production should go on."""
        word = WORD.match(self.source.text, self._first, self.end)
        typed = word[0][:MAX_NAME] if word else ""
        near = difflib.get_close_matches(typed, KEYWORDS, n=1) if len(typed) > 2 else []
        hint = f' (did you mean "{near[0]}"?)' if near else ""
        wanted = '"->"' if n_patterns else "a module or a statement"
        self.unexpected(f"{wanted}{hint}")

    def patterns(self) -> tuple[Pattern, ...]:
        """Modules with names for their parameters."""
        out: list[Pattern] = []
        while True:
            at = self.skip_blank()
            name = self.module_name(UNBRACKETED)
            if not name:
                return tuple(out)
            out.append(Pattern(name, self.names(), self.source.place(at)))

    def branch_patterns(self) -> tuple[Pattern | Branch, ...]:
        """A right context, with branches in it."""
        start = self.skip_blank()
        stack: list[list[Pattern | Branch]] = [[]]
        count = 0
        while True:
            stack[-1] += self.patterns()
            if self.looking_at("["):
                self.at += 1
                stack.append([])
            elif self.looking_at("]") and len(stack) > 1:
                self.at += 1
                inner = stack.pop()
                stack[-1].append(Branch(tuple(inner)))
            else:
                break
            count += 1
            if count > 2 * MAX_CONTEXT:
                self.source.fail(start, f"a right context has at most {MAX_CONTEXT} branches")
        if len(stack) > 1:
            self.unexpected('a module or "]"')
        if not stack[0]:
            self.unexpected("a module of the right context")
        if sum(1 for _ in patterns_in(tuple(stack[0]))) > MAX_CONTEXT:
            self.source.fail(start, f"a context has at most {MAX_CONTEXT} modules")
        return tuple(stack[0])

    def names(self) -> tuple[str, ...]:
        """``(a, b)``, or nothing."""
        if not self.take("("):
            return ()
        out = [self.name("a parameter's name")]
        while self.take(","):
            out.append(self.name("a parameter's name"))
            self.few_parameters(len(out))
        self.expect(")", '"," or ")"')
        return tuple(out)

    def few_parameters(self, n: int) -> None:
        """Fail if a module has too many parameters."""
        if n > MAX_PARAMETERS:
            self.source.fail(self.at, f"a module has at most {MAX_PARAMETERS} parameters")

    def modules(self) -> tuple[Module, ...]:
        """A successor or an axiom, with balanced brackets."""
        out = []
        opened: list[int] = []
        while not self.done:
            at = self.skip_blank()
            name = self.module_name(SINGLES) or self.unexpected("a module")
            if name == "[":
                opened.append(at)
            elif name == "]":
                if not opened:
                    self.source.fail(at, '"]" closes no "["')
                opened.pop()
            out.append(Module(name, self.arguments(), self.source.place(at)))
            if name in "[]" and out[-1].arguments:
                self.source.fail(at, f'"{name}" has no parameters')
        if opened:
            self.source.fail(opened[-1], '"[" is not closed before the end of the statement')
        return tuple(out)

    def arguments(self) -> tuple[Expression, ...]:
        """``(x + 1, y)``, or nothing."""
        if not self.take("("):
            return ()
        out = [self.expression()]
        while self.take(","):
            out.append(self.expression())
            self.few_parameters(len(out))
        self.expect(")", '"," or ")"')
        return tuple(out)

    # ------------------------------------------------------------ expressions

    def expression(self) -> Expression:
        """An expression up to what cannot belong to it."""
        return self.climb(0)[0]

    def climb(self, least: int) -> tuple[Expression, int]:
        """Operand and all operators that bind at least so tightly; and how deep it is."""
        self._depth += 1
        if self._depth > 3 * MAX_DEPTH:
            self.too_deep(self.skip_blank())
        left, depth = self.operand()
        compared = False
        while True:
            at = self.skip_blank()
            operator = self.logic() or self.operator()
            level, written = BINARY.get(operator, (-1, ""))
            if level < least or level < 0:
                break
            if level == COMPARISON and compared:
                self.source.fail(at, 'comparisons do not chain; write "a < b and b < c"')
            compared = level == COMPARISON
            self.at = at + len(operator)
            right, below = self.climb(level if level == POWER else level + 1)
            depth = max(depth, below) + 1
            if depth > MAX_DEPTH:
                self.too_deep(at)
            left = Binary(written, left, right, self.source.place(at))
        self._depth -= 1
        return left, depth

    def logic(self) -> str:
        """``and`` or ``or`` without going past it."""
        match = LOGIC.match(self.source.text, self.skip_blank(), self.end)
        return match[0] if match else ""

    def operand(self) -> tuple[Expression, int]:
        """A number, a name, a call, something in brackets, or one of them with a sign."""
        at = self.skip_blank()
        place = self.source.place(at)
        number = self.match(NUMBER)
        if number:
            return Number(self.finite(at, number), place), 1
        if self.take("("):
            inner = self.climb(0)
            self.expect(")", 'an operator or ")"')
            return inner
        word = self.match(WORD)
        if word in FUNCTIONS:
            return self.call(word, at)
        if word == "not" or (not word and not self.looking_at("->") and self.take("-")):
            operand, depth = self.climb(NOT if word else SIGN)
            if depth >= MAX_DEPTH:
                self.too_deep(at)
            return Unary(word or "-", operand, place), depth + 1
        if not word and self.take("+"):
            return self.climb(SIGN)
        if not word or word in RESERVED:
            self.at = at
            self.unexpected("a number, a name or a function")
        self.short(word, at)
        return Name(word, place), 1

    def finite(self, at: int, number: str) -> float:
        """The value of a number that fits."""
        value = float(number)
        if math.isinf(value):
            self.source.fail(at, f"{shorten(number)} is too large, numbers go up to about 1e308")
        return value

    def call(self, function: str, at: int) -> tuple[Expression, int]:
        """The arguments of a function."""
        self.expect("(", f'"(" after the function {function}')
        out: list[Expression] = []
        depth = 0
        least, most = FUNCTIONS[function]
        while not out or self.take(","):
            value, below = self.climb(0)
            out.append(value)
            depth = max(depth, below)
            if len(out) > most:
                break
        if not least <= len(out) <= most:
            wanted = str(least) if least == most else f"{least} to {most}"
            got = f"more than {most}" if len(out) > most else str(len(out))
            self.source.fail(at, f"{function} takes {wanted} argument{'s' * (most > 1)}, got {got}")
        self.expect(")", '"," or ")"')
        if depth >= MAX_DEPTH:
            self.too_deep(at)
        return Call(function, tuple(out), self.source.place(at)), depth + 1

    def too_deep(self, at: int) -> None:
        """Fail where an expression has too many levels."""
        self.source.fail(
            at, f"at most {MAX_DEPTH} operations inside each other; name a part of it with const"
        )
