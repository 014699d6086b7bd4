"""The error of this package; the others are those of :mod:`treegraph`."""

from treegraph import SapwoodError

__all__ = ["NoPreviewError"]


class NoPreviewError(SapwoodError):
    """A picture was asked for in a way that this machine cannot draw it."""
