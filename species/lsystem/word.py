"""A derived word: its modules and their numbers in flat arrays, and what the turtle has to know besides."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from species.errors import DerivationError
from species.lsystem.syntax import format_number

__all__ = ["TurtleSettings", "Word"]

DEFAULT_ANGLE_DEG = 90.0


@dataclass(frozen=True)
class TurtleSettings:
    """What commands without an argument mean, and how the turtle begins. Angles are degrees, as in the text.

    Attributes
    ----------
    angle_deg : float, default 90
        Turn of ``+ - & ^ \\ /``.
    step : float, default 1
        Length of ``F`` and ``f``, metres.
    width : float, default 0.01
        Diameter to begin with, metres, >= 0.
    taper : float, default 0.7
        Factor of the diameter by which ``!`` multiplies it, >= 0.
    leaf : float, default 0.1
        Size of ``L``, metres, >= 0.
    tropism : (float, float, float), default (0, 0, -1)
        Where ``~`` bends to; not zero, its length does not matter.
    """

    angle_deg: float = DEFAULT_ANGLE_DEG
    step: float = 1.0
    width: float = 0.01
    taper: float = 0.7
    leaf: float = 0.1
    tropism: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def __post_init__(self) -> None:
        for name in ("angle_deg", "step", "width", "taper", "leaf"):
            value = getattr(self, name)
            least = -np.inf if name in ("angle_deg", "step") else 0.0
            if not (np.isfinite(value) and value >= least):
                rule = "finite" if least else ">= 0 and finite"
                raise DerivationError(f"{name.removesuffix('_deg')} must be {rule}, got {value!r}")
        if len(self.tropism) != 3 or not np.isfinite(self.tropism).all() or not np.any(self.tropism):
            raise DerivationError(f"tropism must be a direction of three numbers, got {self.tropism!r}")


@dataclass(frozen=True, eq=False)
class Word:
    """A string of m modules with k numbers in all.

    Attributes
    ----------
    kinds : tuple of (str, int)
        Name and number of parameters of each kind of module.
    code : (m,) int32
        Kind of each module, an index into `kinds`.
    number : (k,) float64
        The parameters of all modules, one module's after the other's; finite; angles in degrees.
    settings : TurtleSettings

    Notes
    -----
    ``str(word)`` writes it as an axiom that would be read as the same word.
    """

    kinds: tuple[tuple[str, int], ...]
    code: NDArray[np.int32]
    number: NDArray[np.float64]
    settings: TurtleSettings = field(default_factory=TurtleSettings)

    def __post_init__(self) -> None:
        code = np.array(self.code, np.int32, order="C")
        number = np.array(self.number, np.float64, order="C")
        if code.ndim != 1 or (code.size and (code.min() < 0 or code.max() >= len(self.kinds))):
            raise DerivationError(
                f"code must have shape (m,) and be below {len(self.kinds)}, the number of kinds"
            )
        wanted = int(self._arity()[code].sum())
        if number.shape != (wanted,):
            raise DerivationError(
                f"number must have shape ({wanted},) to match the modules, got {number.shape}"
            )
        if not np.isfinite(number).all():
            raise DerivationError("the numbers of a word must be finite")
        code.flags.writeable = number.flags.writeable = False
        object.__setattr__(self, "code", code)
        object.__setattr__(self, "number", number)

    def _arity(self) -> NDArray[np.int64]:
        return np.array([n for _, n in self.kinds], np.int64)

    @property
    def n_modules(self) -> int:
        """Number of modules, brackets too."""
        return int(self.code.size)

    @property
    def start(self) -> NDArray[np.int64]:
        """Where each module's numbers begin, and the end: (m + 1,) int64."""
        out = np.zeros(self.code.size + 1, np.int64)
        np.cumsum(self._arity()[self.code], out=out[1:])
        return out

    def __repr__(self) -> str:
        return f"<Word {self.n_modules} module{'s' * (self.n_modules != 1)}>"

    def __str__(self) -> str:
        gap = " " if any(len(name) > 1 for name, _ in self.kinds) else ""
        start, number = self.start.tolist(), self.number.tolist()
        out = []
        for i, code in enumerate(self.code.tolist()):
            name, n = self.kinds[code]
            values = ", ".join(map(format_number, number[start[i] : start[i + 1]]))
            out.append(f"{name}({values})" if n else name)
        return gap.join(out)
