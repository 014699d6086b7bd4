"""The text of a grammar as statements and tokens, and errors that point into it."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

from species.errors import GrammarError
from species.lsystem.syntax import Place

__all__ = ["Scanner", "Source", "Statement"]

MAX_TEXT = 100_000
"""Most characters of a grammar; the longest of the book has about a thousand."""

EXCERPT = 48
"""Characters of the line at fault that an error shows."""

BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
NUMBER = re.compile(r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
OPERATOR = re.compile(r"->|<=|>=|==|!=|&&|\|\||\*\*|[-+*/%^<>=()\[\],:]")


@dataclass(frozen=True)
class Statement:
    """From where to where in the text; lines that begin farther right than the first go on with the last."""

    begin: int
    end: int


class Source:
    """A grammar's text, its lines, and how to speak of a place in it."""

    def __init__(self, text: str, name: str = "") -> None:
        self.text = text
        self.name = name
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]
        if len(text) > MAX_TEXT:
            self.fail(
                MAX_TEXT, f"a grammar has at most {MAX_TEXT} characters, got {len(text)}", excerpt=False
            )

    def place(self, at: int) -> Place:
        """Line and column of a character."""
        line = bisect_right(self._starts, at) - 1
        return line + 1, at - self._starts[line] + 1

    def fail(self, at: int, message: str, *, excerpt: bool = True) -> NoReturn:
        """Raise a GrammarError for a place."""
        line, column = self.place(at)
        shown = f' in "{self._excerpt(at)}"' if excerpt else ""
        head = f"{self.name}: " if self.name else ""
        raise GrammarError(f"{head}line {line}, column {column}: {message}{shown}", line, column)

    def fail_at(self, place: Place, message: str) -> NoReturn:
        """Raise a GrammarError for a line and column."""
        self.fail(self._starts[place[0] - 1] + place[1] - 1, message)

    def _excerpt(self, at: int) -> str:
        """The line, or what is around the place in a long one, in characters that can be printed."""
        line = self.place(at)[0] - 1
        begin = self._starts[line]
        end = self._starts[line + 1] - 1 if line + 1 < len(self._starts) else len(self.text)
        first = max(begin, min(at - EXCERPT // 2, end - EXCERPT))
        last = min(end, first + EXCERPT)
        middle = printable(self.text[first:last])
        return f"{'...' * (first > begin)}{middle.strip()}{'...' * (last < end)}"

    def statements(self) -> Iterator[Statement]:
        """Split the text into statements."""
        begin = end = margin = -1
        for start in self._starts:
            stop = self.text.find("\n", start)
            line = self.text[start : stop if stop >= 0 else len(self.text)].split("#", 1)[0]
            body = line.strip(" \t\r")
            if not body:
                continue
            indent = len(line) - len(line.lstrip(" \t\r"))
            margin = indent if margin < 0 else margin
            if begin < 0 or indent <= margin:
                if begin >= 0:
                    yield Statement(begin, end)
                begin = start + indent
            end = start + indent + len(body)
        if begin >= 0:
            yield Statement(begin, end)


class Scanner:
    """Reads one statement from left to right."""

    def __init__(self, source: Source, statement: Statement, names: frozenset[str]) -> None:
        self.source = source
        self.at = statement.begin
        self.end = statement.end
        self._names = names
        self._longest = max(map(len, names), default=1)

    def skip_blank(self) -> int:
        """Go to the next token and return where that is; nothing is left at `end`."""
        match = BLANK.match(self.source.text, self.at, self.end)
        self.at = match.end() if match else self.at
        return self.at

    @property
    def done(self) -> bool:
        """Whether nothing is left of the statement."""
        return self.skip_blank() >= self.end

    def looking_at(self, token: str) -> bool:
        """Whether the next characters are these."""
        return self.source.text.startswith(token, self.skip_blank(), self.end)

    def take(self, token: str) -> bool:
        """Go past these characters if they are next."""
        found = self.looking_at(token)
        if found:
            self.at += len(token)
        return found

    def match(self, pattern: re.Pattern[str]) -> str:
        """Go past what a pattern finds here; "" if it finds nothing."""
        match = pattern.match(self.source.text, self.skip_blank(), self.end)
        if match is None:
            return ""
        self.at = match.end()
        return match[0]

    def operator(self) -> str:
        """The next operator, without going past it; "" if there is none."""
        match = OPERATOR.match(self.source.text, self.skip_blank(), self.end)
        return match[0] if match else ""

    def module_name(self, singles: str) -> str:
        """Go past the longest declared name, or one of the single characters; "" if there is neither."""
        at = self.skip_blank()
        text = self.source.text
        for length in range(min(self._longest, self.end - at), 1, -1):
            if text[at : at + length] in self._names:
                self.at += length
                return text[at : at + length]
        if at < self.end and text[at] in singles and not text.startswith("->", at):
            self.at += 1
            return text[at]
        return ""

    def expect(self, token: str, wanted: str | None = None) -> None:
        """Go past these characters or fail."""
        if not self.take(token):
            self.unexpected(wanted or f'"{token}"')

    def unexpected(self, wanted: str) -> NoReturn:
        """Fail with what was expected and what is there."""
        at = self.skip_blank()
        self.source.fail(at, f"expected {wanted}, got {self.here()}")

    def here(self) -> str:
        """The next token as an error shows it."""
        at = self.skip_blank()
        if at >= self.end:
            return "the end of the statement"
        for pattern in (WORD, NUMBER, OPERATOR):
            match = pattern.match(self.source.text, at, self.end)
            if match:
                return f'"{shorten(match[0])}"'
        character = self.source.text[at]
        if character.isascii() and character.isprintable():
            return f'"{character}"'
        return f"the character U+{ord(character):04X}"


def shorten(text: str) -> str:
    """At most twenty characters of a token."""
    return text if len(text) <= 20 else f"{text[:17]}..."


def printable(text: str) -> str:
    """Text on one line, with ? for what cannot be printed."""
    return "".join(c if c.isprintable() else " " if c in "\t\r\n" else "?" for c in text)
