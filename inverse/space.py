"""Where a fit searches: bounds and scale of each growth parameter, and which are fixed.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014, table
1 and section 5.4. Departs from it in: the paper searches all parameters "from scratch" and gives no ranges.
These hold all of its table 2 but the misprinted column, and are narrower than what the growth model accepts.
Lengths follow the trees' height.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph import InputError

if TYPE_CHECKING:
    from species import GrowthParameters

__all__ = ["AGE", "TIP", "Dimension", "SearchSpace", "search_space"]

_Value = TypeVar("_Value")

AGE = "t"
"""Symbol of the growth time, which is fitted with the 24 parameters."""

TIP = "tip_radius"
"""Name of the radius of a tip (m), which is fitted too where wood is not as thick as the model's."""

TIP_SHARES = (0.0005, 0.2)  # what the growth model takes, in internode lengths

#: Symbol, low, high, scale. "root": evenly in the square root (of a variance), "log": in the logarithm.
_RANGES = (
    ("AAV", 0.0, 900.0, "root"),
    ("NLB", 1, 5, "whole"),
    ("BAM", 5.0, 110.0, "linear"),
    ("BAV", 0.0, 400.0, "root"),
    ("RAM", 0.0, 180.0, "linear"),
    ("RAV", 0.0, 900.0, "root"),
    ("AB_D", 0.0, 0.3, "linear"),
    ("LB_D", 0.0, 0.6, "linear"),
    ("LF_A", 0.0, 2.0, "linear"),
    ("LF_L", 0.0, 2.0, "linear"),
    ("AD_BF", 0.0, 8.0, "linear"),
    ("AD_DF", 0.0, 1.0, "linear"),
    ("AD_AF", 0.5, 1.0, "linear"),
    ("GR", 0.6, 6.0, "linear"),
    ("IBL", 0.005, 0.25, "log height"),
    ("IL_AF", 0.9, 1.0, "linear"),
    ("AC", 0.2, 8.0, "log"),
    ("AC_AF", 0.7, 1.05, "linear"),
    ("PT", -0.1, 0.8, "linear"),
    ("GT", -0.2, 0.8, "linear"),
    ("PF", 0.0, 1.5, "linear"),
    ("LB_PF", 0.0, 0.95, "height"),
    ("GBS", 0.0, 1.5, "linear"),
    ("GBA", 0.0, 1.0, "linear"),
    (AGE, 3, 30, "whole"),
)


@dataclass(frozen=True)
class Dimension:
    """One parameter of a fit.

    Attributes
    ----------
    symbol : str
        As in table 1 of the paper; ``"t"`` is the age.
    low, high : float
        Bounds, in the parameter's unit. Equal: it is fixed.
    scale : {"linear", "root", "log", "whole"}
        How the bounds are spanned: evenly, evenly in the square root, in the logarithm, or by whole numbers.
    """

    symbol: str
    low: float
    high: float
    scale: str = "linear"

    @property
    def is_fixed(self) -> bool:
        """Whether there is but one value."""
        return self.low == self.high

    def value(self, share: float) -> float:
        """The value at a place from 0 to 1 between the bounds."""
        if self.is_fixed:
            return self.low
        if self.scale == "whole":
            return min(self.low + math.floor(share * (self.high - self.low + 1.0)), self.high)
        low, high = self._spanned(self.low), self._spanned(self.high)
        value = low + share * (high - low)
        if self.scale == "root":
            value *= value
        elif self.scale == "log":
            value = math.exp(value)
        return min(max(value, self.low), self.high)

    def share(self, value: float) -> float:
        """The place from 0 to 1 of a value between the bounds; of a whole number the middle of its part."""
        if self.is_fixed:
            return 0.5
        if self.scale == "whole":
            return (value - self.low + 0.5) / (self.high - self.low + 1.0)
        low, high = self._spanned(self.low), self._spanned(self.high)
        return (self._spanned(value) - low) / (high - low)

    def _spanned(self, value: float) -> float:
        if self.scale == "root":
            return math.sqrt(value)
        return math.log(value) if self.scale == "log" else value


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """All parameters of a fit; points are places from 0 to 1 along those that are free.

    Attributes
    ----------
    dimensions : tuple of Dimension
        The 24 parameters in the order of the paper, then the age; the radius of a tip, if that is searched.
    """

    dimensions: tuple[Dimension, ...]

    @property
    def free(self) -> tuple[Dimension, ...]:
        """Those that are not fixed."""
        return tuple(dimension for dimension in self.dimensions if not dimension.is_fixed)

    @property
    def n_free(self) -> int:
        """How many they are."""
        return len(self.free)

    def decode(self, point: ArrayLike) -> tuple[GrowthParameters, int]:
        """Growth parameters and age at a point.

        Raises
        ------
        InputError
            If the point is not one number from 0 to 1 for each free parameter.
        """
        from species import GrowthParameters

        shares = np.asarray(point, np.float64)
        if shares.shape != (self.n_free,) or not ((shares >= 0.0) & (shares <= 1.0)).all():
            raise InputError(f"a point must be {self.n_free} numbers from 0 to 1, got {point!r}")
        left = iter(shares.tolist())
        values = {d.symbol: d.value(0.5 if d.is_fixed else next(left)) for d in self.dimensions}
        age = int(values.pop(AGE))
        values.pop(TIP, None)
        return GrowthParameters.from_symbols(values), age

    def tip_share(self, point: ArrayLike) -> float | None:
        """Radius of a tip at a point, as a share of the internode length; None if it is not searched."""
        shares = dict(zip((d.symbol for d in self.free), np.asarray(point, np.float64).tolist(), strict=True))
        if TIP not in shares:
            return None
        value = {
            d.symbol: d.value(shares.get(d.symbol, 0.5)) for d in self.dimensions if d.symbol in (TIP, "IBL")
        }
        return float(np.clip(value[TIP] / value["IBL"], *TIP_SHARES))

    def encode(self, parameters: GrowthParameters, age: int) -> NDArray[np.float64]:
        """The point of growth parameters and an age; what lies outside the bounds is moved to them."""
        values = parameters.symbols() | {AGE: float(age)}
        shares = [d.share(min(max(values.get(d.symbol, d.value(0.5)), d.low), d.high)) for d in self.free]
        return np.array(shares)


def search_space(
    height: float,
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    fixed: Mapping[str, float] | None = None,
    tip_radius: tuple[float, float] | None = None,
) -> SearchSpace:
    """The space in which trees of a height are searched.

    Parameters
    ----------
    height : float
        Of the trees to be fitted, metres, > 0; internode length and height without side branches follow it.
    bounds : mapping of str to (low, high), optional
        Other bounds, by symbol or name of the parameter, ``"t"`` or ``"age"``.
    fixed : mapping of str to float, optional
        Parameters that are not searched.
    tip_radius : (low, high), optional
        Where the radius of a tip is searched, metres, > 0; by default not at all.

    Returns
    -------
    space : SearchSpace

    Raises
    ------
    InputError
        If a name is unknown, a parameter is given twice or both bounded and fixed, bounds are the wrong way
        round or outside of what the growth model accepts, or nothing is free.

    Examples
    --------
    >>> space = search_space(10.0, fixed={"NLB": 2, "t": 12})
    >>> space.n_free, space.decode([0.5] * 23)[1]
    (23, 12)
    """
    if not (math.isfinite(height) and height > 0.0):
        raise InputError(f"height must be a positive number of metres, got {height!r}")
    chosen = {name: (float(low), float(high)) for name, (low, high) in _by_symbol(bounds or {}).items()}
    for symbol, value in _by_symbol(fixed or {}).items():
        if symbol in chosen:
            raise InputError(f"{symbol} must be bounded or fixed, not both")
        chosen[symbol] = (float(value), float(value))
    dimensions = []
    for symbol, low, high, scale in _RANGES:
        unit = height if scale.endswith("height") else 1.0
        kind = {"log height": "log", "height": "linear"}.get(scale, scale)
        accepted = _accepted(symbol)
        span = tuple(min(max(unit * value, accepted[0]), accepted[1]) for value in (low, high))
        dimensions.append(_dimension(symbol, chosen.get(symbol, span), kind, accepted))
    if tip_radius is not None:
        dimensions.append(Dimension(TIP, *tip_radius, "log"))
    space = SearchSpace(tuple(dimensions))
    if not space.n_free:
        raise InputError("a fit must have at least one parameter that is not fixed")
    return space


def _dimension(symbol: str, span: tuple[float, ...], scale: str, accepted: tuple[float, float]) -> Dimension:
    low, high = span
    if not low <= high:
        raise InputError(f"bounds of {symbol} must ascend, got {low!r} to {high!r}")
    if not accepted[0] <= low <= high <= accepted[1]:
        raise InputError(
            f"bounds of {symbol} must be within {accepted[0]} to {accepted[1]}, got {low!r} to {high!r}"
        )
    if scale == "whole" and not (low.is_integer() and high.is_integer()):
        raise InputError(f"bounds of {symbol} must be whole numbers, got {low!r} to {high!r}")
    if scale == "log" and low <= 0.0:
        scale = "linear"
    return Dimension(symbol, low, high, scale)


def _accepted(symbol: str) -> tuple[float, float]:
    """What the growth model accepts."""
    from species import parameter_table
    from species.parameters import MAX_AGE

    if symbol == AGE:
        return 0.0, float(MAX_AGE)
    entry = next(entry for entry in parameter_table() if entry["symbol"] == symbol)
    return float(entry["low"]), float(entry["high"])


def _by_symbol(values: Mapping[str, _Value]) -> dict[str, _Value]:
    """What is given by symbols or names, by symbols."""
    out: dict[str, _Value] = {}
    for name, value in values.items():
        symbol = _symbol(name)
        if symbol in out:
            raise InputError(f"{symbol} is given twice, by its name and by its symbol")
        out[symbol] = value
    return out


def _symbol(name: str) -> str:
    """The symbol of a parameter given by symbol or name."""
    from difflib import get_close_matches

    from species import parameter_table

    known = {entry["name"]: entry["symbol"] for entry in parameter_table()} | {"age": AGE}
    symbol = known.get(name, name)
    if symbol not in known.values():
        near = get_close_matches(name, [*known, *known.values()], 1, 0.4)
        raise InputError(f"there is no parameter {name!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
    return symbol
