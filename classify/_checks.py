"""Checks of arrays that a model is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from treegraph.errors import InputError

__all__ = ["check_array", "check_number", "check_range"]


def check_array(
    name: str,
    value: ArrayLike,
    shape: tuple[int, ...],
    dtype: DTypeLike = np.float64,
    *,
    may_miss: bool = False,
) -> NDArray:
    """Return a read-only copy; refuse other shapes and kinds, infinities, and NaN unless it `may_miss`."""
    wanted, given = np.dtype(dtype), np.asarray(value)
    if given.size and not np.can_cast(given.dtype, wanted, "same_kind"):
        raise InputError(f"{name} must be of type {wanted}, got {given.dtype}")
    array = np.array(given, dtype=wanted, order="C")
    if array.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {array.shape}")
    if wanted.kind == "f":
        bad = np.isinf(array) if may_miss else ~np.isfinite(array)
        if bad.any():
            raise InputError(f"{name} must be finite{' or NaN' * may_miss}, got {array[bad][0]}")
    array.flags.writeable = False
    return array


def check_range(name: str, array: NDArray, lowest: float, highest: float) -> None:
    """Refuse values under `lowest` or over `highest`; NaN passes."""
    bad = array[(array < lowest) | (array > highest)]
    if bad.size:
        raise InputError(
            f"{name} must be from {lowest} to {highest}, got {bad[0]}; {bad.size} of {array.size} break this"
        )


def check_number(name: str, value: float, lowest: float, highest: float) -> None:
    """Refuse a number under `lowest`, over `highest`, or NaN."""
    if not lowest <= value <= highest:
        raise InputError(f"{name} must be from {lowest} to {highest}, got {value}")
