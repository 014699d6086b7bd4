"""The errors of grammars: what is wrong with the text, and what goes wrong while it is derived or drawn."""

from treegraph.errors import InputError

__all__ = ["DerivationError", "GrammarError"]


class GrammarError(InputError):
    """A grammar's text is at fault; the message names the place.

    Attributes
    ----------
    line, column : int
        Where, both from 1; a tab is one column.
    """

    def __init__(self, message: str, line: int = 1, column: int = 1) -> None:
        super().__init__(message)
        self.line = line
        self.column = column

    def __reduce__(self) -> tuple[type, tuple[str, int, int]]:
        return type(self), (str(self), self.line, self.column)


class DerivationError(InputError):
    """A word cannot be derived or drawn: a limit is reached, or a number leaves its range."""
