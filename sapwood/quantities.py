"""Lengths and angles as people write them: a number with its unit."""

from __future__ import annotations

import math
import re

from treegraph.errors import InputError

__all__ = ["parse_angle", "parse_length"]

LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3}
ANGLES = {"deg": math.pi / 180.0, "°": math.pi / 180.0, "mrad": 1e-3, "rad": 1.0}
QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([a-z°]*)\s*", re.IGNORECASE)


def parse_length(text: str, name: str = "a length") -> float:
    """Metres; a plain number is metres.

    Raises
    ------
    InputError
        If `text` is not a finite number with mm, cm, m, km or nothing behind it.

    Examples
    --------
    >>> parse_length("2mm"), parse_length("0.5"), parse_length("1.5 m")
    (0.002, 0.5, 1.5)
    """
    return _parse(text, name, LENGTHS, "m", "2mm, 5cm or 1.5m")


def parse_angle(text: str, name: str = "an angle") -> float:
    """Radians; a plain number is degrees.

    Raises
    ------
    InputError
        If `text` is not a finite number with deg, mrad, rad or nothing behind it.

    Examples
    --------
    >>> round(parse_angle("0.3mrad"), 6), round(parse_angle("180"), 4)
    (0.0003, 3.1416)
    """
    return _parse(text, name, ANGLES, "deg", "0.04deg or 0.3mrad")


def _parse(text: str, name: str, units: dict[str, float], default: str, example: str) -> float:
    match = QUANTITY.fullmatch(text)
    unit = (match[2].lower() or default) if match else ""
    if match is None or unit not in units or not math.isfinite(float(match[1])):
        raise InputError(f"{name} must be a number with its unit, as in {example}, got {text!r}")
    return float(match[1]) * units[unit]
