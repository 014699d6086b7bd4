"""Checked fields of the dataclasses that describe leaves and bark: range, unit and meaning of each."""

from __future__ import annotations

import math
import re
from dataclasses import MISSING, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph.errors import InputError

__all__ = ["check_fields", "check_rng", "check_size", "choice", "field_table", "number", "srgb", "whole"]

SMALLEST_PX, LARGEST_PX = 32, 2048
COLOR_RULE = "three sRGB numbers from 0 to 255 or '#rrggbb'"

Color = tuple[int, int, int]


def number(
    low: float, high: float, unit: str, what: str, default: Any = MISSING, optional: bool = False
) -> Any:
    """A field that holds a number from ``low`` to ``high``; with ``optional`` it may be None."""
    about = {"low": low, "high": high, "unit": unit, "what": what, "optional": optional, "whole": False}
    return field(default=default, metadata=about)


def whole(low: int, high: int, what: str, default: Any = MISSING) -> Any:
    """A field that holds a whole number from ``low`` to ``high``."""
    about = {"low": low, "high": high, "unit": "", "what": what, "optional": False, "whole": True}
    return field(default=default, metadata=about)


def choice(names: tuple[str, ...], what: str, default: Any = MISSING) -> Any:
    """A field that holds one of some names."""
    return field(default=default, metadata={"names": names, "unit": "", "what": what, "optional": False})


def srgb(what: str, default: Any = MISSING, optional: bool = False) -> Any:
    """A field that holds an sRGB triple; with ``optional`` it may be None."""
    return field(
        default=default, metadata={"color": True, "unit": "sRGB", "what": what, "optional": optional}
    )


def check_fields(value: Any) -> None:
    """Check and convert every field of a frozen dataclass made of the fields above, in place.

    Raises
    ------
    InputError
        For the first field out of its range; the message has its name, its range and the value.
    """
    for entry in fields(value):
        given = getattr(value, entry.name)
        if given is None and entry.metadata["optional"]:
            continue
        if "names" in entry.metadata:
            checked: Any = _check_name(entry.name, entry.metadata["names"], given)
        elif "color" in entry.metadata:
            checked = _check_color(entry.name, given)
        else:
            checked = _check_number(entry.name, entry.metadata, given)
        object.__setattr__(value, entry.name, checked)


def field_table(kind: type) -> list[dict[str, Any]]:
    """Name, unit, range, default and meaning of each field, for tables and for search.

    ``default`` is None where a value has to be given or where None is the default.
    """
    return [
        {
            "name": entry.name,
            "default": None if entry.default is MISSING else entry.default,
            "low": None,
            "high": None,
            "whole": False,
            **entry.metadata,
        }
        for entry in fields(kind)
    ]


def check_size(size_px: Any) -> int:
    """Return a texture's size: a power of two from 32 to 2048."""
    right = isinstance(size_px, int | np.integer) and not isinstance(size_px, bool)
    if not right or not SMALLEST_PX <= size_px <= LARGEST_PX or size_px & (size_px - 1):
        rule = f"a power of two from {SMALLEST_PX} to {LARGEST_PX} pixels"
        raise InputError(f"size_px must be {rule}, got {size_px!r}")
    return int(size_px)


def check_rng(rng: Any) -> np.random.Generator:
    """Return the generator, if it is one."""
    if not isinstance(rng, np.random.Generator):
        raise InputError(f"rng must be a numpy.random.Generator, got {type(rng).__name__}")
    return rng


def as_unit(color: Color) -> NDArray[np.float64]:
    """An sRGB triple as (3,) float64 from 0 to 1."""
    return np.array(color, float) / 255.0


def _check_name(name: str, names: tuple[str, ...], value: Any) -> str:
    if value not in names:
        raise InputError(f"{name} must be one of {', '.join(names)}, got {value!r}")
    return str(value)


def _check_number(name: str, about: Any, value: Any) -> float | int:
    low, high, unit, whole = (about[key] for key in ("low", "high", "unit", "whole"))
    rule = f"{'a whole number ' * whole}from {low} to {high}{' ' * bool(unit)}{unit}"
    try:
        real = math.nan if isinstance(value, bool | str) else float(value)
    except (TypeError, ValueError):
        real = math.nan
    if not low <= real <= high or (whole and real != math.floor(real)):
        raise InputError(f"{name} must be {rule}, got {value!r}")
    return int(real) if whole else real


def _check_color(name: str, value: Any) -> Color:
    if isinstance(value, str) and re.fullmatch(r"#[0-9a-fA-F]{6}", value):
        value = [int(value[i : i + 2], 16) for i in (1, 3, 5)]
    right = isinstance(value, list | tuple) and len(value) == 3
    if not right or not all(
        isinstance(part, int) and not isinstance(part, bool) and 0 <= part <= 255 for part in value
    ):
        raise InputError(f"{name} must be {COLOR_RULE}, got {value!r}")
    return (int(value[0]), int(value[1]), int(value[2]))
