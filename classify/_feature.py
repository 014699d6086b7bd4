"""What a feature is, and the small statistics that all groups use."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Feature:
    """One number that describes a tree.

    Attributes
    ----------
    name : str
        Lower case, words joined by ``_``.
    unit : str
        "m", "m2", "m3", "rad", "1/m", "" for shares, ratios and counts.
    group : str
        Which part of the description it belongs to.
    text : str
        One line on what it is.
    """

    name: str
    unit: str
    group: str
    text: str


def family(
    group: str, name: str, text: str, keys: Iterable[str | int | tuple[str, str]], unit: str = ""
) -> list[Feature]:
    """Features that differ in one word of their name and of their text; `keys` are one word or one for each.

    >>> [f.name for f in family("stems", "n_stems_{}", "stems at {}% of the height", (5, 10))]
    ['n_stems_5', 'n_stems_10']
    """
    words = [key if isinstance(key, tuple) else (str(key), str(key)) for key in keys]
    return [Feature(name.format(key), unit, group, text.format(word)) for key, word in words]


def mean_of(value: Floats, weight: Floats | None = None) -> float:
    """Weighted mean of the known values; NaN without any."""
    good = np.isfinite(value)
    if weight is None:
        return float(value[good].mean()) if good.any() else np.nan
    total = weight[good].sum()
    return float((weight[good] * value[good]).sum() / total) if total > 0.0 else np.nan


def spread_of(value: Floats, weight: Floats | None = None) -> float:
    """Weighted standard deviation of the known values; NaN without any."""
    middle = mean_of(value, weight)
    return float(np.sqrt(max(mean_of((value - middle) ** 2, weight), 0.0))) if np.isfinite(middle) else np.nan


def ratio_of(over: float, under: float) -> float:
    """`over` / `under`; NaN where that is no finite number."""
    return over / under if under != 0.0 and np.isfinite(over) and np.isfinite(under) else np.nan


def divided(over: Floats | float, under: Floats | float) -> Floats:
    """`over` / `under`, each a number or an array; NaN where `under` is 0."""
    over, under = np.broadcast_arrays(np.asarray(over, np.float64), np.asarray(under, np.float64))
    return np.divide(over, under, out=np.full(over.shape, np.nan), where=under != 0.0)


def shares_of(row: NDArray[np.int64], n: int, weight: Floats | None = None) -> Floats:
    """Share of the weight in each of `n` bins; NaN if there is none."""
    found = np.bincount(row, weight, n).astype(np.float64)
    total = found.sum()
    return found / total if total > 0.0 else np.full(n, np.nan)


def quantiles_of(value: Floats, levels: tuple[float, ...], weight: Floats | None = None) -> Floats:
    """Weighted quantiles of the known values, by linear interpolation between the middles of weights."""
    good = np.isfinite(value)
    value = value[good]
    if not value.size:
        return np.full(len(levels), np.nan)
    if weight is None:
        return np.quantile(value, levels)
    order = np.argsort(value, kind="stable")
    mass = weight[good][order]
    place = np.cumsum(mass) - 0.5 * mass
    total = mass.sum()
    if not total > 0.0:
        return np.full(len(levels), np.nan)
    return np.interp(np.array(levels) * total, place, value[order])


def effective_boxes(count: NDArray[np.int64]) -> float:
    """How many boxes, all equally full, would have two things in one as often as these; NaN without pairs.

    The number of filled boxes if all hold as many, and fewer if some hold most. In proportion, pairs stay the
    same when things are lost at random, and so does this; the number of filled boxes does not. (Ecologists
    know it as the inverse of Simpson's index.)

    Parameters
    ----------
    count : (k,) int64
        Things in each box.

    Examples
    --------
    >>> round(effective_boxes(np.array([500, 500, 500, 0])), 1)
    3.0
    """
    pairs = pairs_in(count)
    total = float(count.sum())
    return total * (total - 1.0) / pairs if pairs > 0.0 else np.nan


def pairs_in(count: NDArray[np.int64] | Floats) -> float:
    """Ordered pairs of things in the same box."""
    count = np.asarray(count, np.float64)
    return float((count * (count - 1.0)).sum())
