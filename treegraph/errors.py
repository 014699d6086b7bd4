"""The errors of Sapwood: one base class, one class per kind of fault.

Every message says which rule is broken, what came instead and, where there is one, the remedy.
"""

__all__ = ["FitError", "FormatError", "InputError", "SapwoodError", "TreeError"]


class SapwoodError(Exception):
    """Base class of every error that Sapwood raises on purpose."""


class TreeError(SapwoodError, ValueError):
    """The arrays do not describe a valid tree graph or cluster tree."""


class FormatError(SapwoodError, ValueError):
    """A file or a string of bytes cannot be read as the format it claims to be."""


class InputError(SapwoodError, ValueError):
    """The user's scan or argument is at fault; the message is one line."""


class FitError(SapwoodError, ValueError):
    """A fit was asked of data that cannot carry it."""
