"""Text as terminals, files and other programs can take it, whatever names people give their scans."""

from __future__ import annotations

import json
from typing import Any

__all__ = ["encodable", "one_line", "to_json", "visible"]


def one_line(error: BaseException) -> str:
    """The error's message without line breaks."""
    return " ".join(str(error).split())


def visible(text: str) -> str:
    r"""The text on one line: line breaks, control codes and bytes that are no text become escapes.

    A file's name may hold any of them, and must neither break a line nor steer a terminal.

    Examples
    --------
    >>> print(visible("an \x1b[31moak\n.laz"))
    an \x1b[31moak\n.laz
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def encodable(text: str, encoding: str | None) -> str:
    r"""The text with escapes for what `encoding` (UTF-8 if None) cannot hold.

    Examples
    --------
    >>> print(encodable("Föhre 樹", "latin-1"))
    Föhre \u6a39
    """
    encoding = encoding or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def to_json(value: Any, encoding: str | None = None) -> str:
    r"""One JSON document that `encoding` (UTF-8 if None) can hold; NaN is an error.

    Only where it must be is it written in ASCII alone: for an encoding that lacks a letter, or for a file
    name that is not valid text, which Python reads back from the escapes as the same name.

    Examples
    --------
    >>> print(to_json(["樹"]), to_json(["tree\udcff"]), sep="\n")
    [
      "樹"
    ]
    [
      "tree\udcff"
    ]
    """
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        text.encode(encoding or "utf-8")
    except UnicodeEncodeError:
        text = json.dumps(value, indent=2, ensure_ascii=True, allow_nan=False)
    return text + "\n"
