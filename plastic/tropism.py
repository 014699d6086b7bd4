r"""Tropisms: how light and gravity bend a branch, and what it would be without them.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.3.3 (Eq. 4.6 to 4.10, figure 4.5).
Departs from it in: p is at least half of 1 - w_s. Where the line misses the sphere, or meets it behind the
branch's foot, a branch that grew against the tropism would otherwise turn right round at the least change.
The text computes the strengths from the input tree without saying how; here they are given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treegraph import InputError

__all__ = ["LEAST_ALONG", "Tropisms", "invert_tropism", "lean_of", "tropism_direction"]

LEAST_ALONG = 0.5
"""The line parameter p is at least this times 1 - w_s."""


@dataclass(frozen=True)
class Tropisms:
    """Strengths of the tropisms per internode.

    Attributes
    ----------
    phototropism : float
        Weight of the light's direction, 0 to below 1.
    gravitropism : float
        Weight of up, against gravity; negative is towards it. Above -1 and below 1; both together, without
        their signs, below 1.

    Raises
    ------
    InputError
        If a weight is out of its range.
    """

    phototropism: float = 0.12
    gravitropism: float = 0.08

    def __post_init__(self) -> None:
        if not 0.0 <= self.phototropism < 1.0:
            raise InputError(f"phototropism must be from 0 to below 1, got {self.phototropism!r}")
        if not -1.0 < self.gravitropism < 1.0:
            raise InputError(f"gravitropism must be above -1 and below 1, got {self.gravitropism!r}")
        if not self.total < 1.0:
            raise InputError(f"phototropism and gravitropism must be below 1 together, got {self.total!r}")

    @property
    def total(self) -> float:
        """The sum of the weights."""
        return self.phototropism + abs(self.gravitropism)

    @property
    def light_share(self) -> float:
        """What of t, in Eq. 4.6, is the light's direction; 0 without tropisms."""
        return self.phototropism / self.total if self.total > 0.0 else 0.0

    @property
    def up_share(self) -> float:
        """What of t, in Eq. 4.6, is up; negative if it is down."""
        return self.gravitropism / self.total if self.total > 0.0 else 0.0


def lean_of(
    tropisms: Tropisms, toward: NDArray[np.float64], length: NDArray[np.float64], internode: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""The tropisms' part of Eq. 4.6: :math:`w_s` and :math:`t_w = (1 - w_s) t`.

    :math:`w_s = (1 - \sum w_\tau)^{l_s / l_i}`, Eq. 4.7, and :math:`t = \sum w_\tau t_\tau / \sum w_\tau`.

    Parameters
    ----------
    tropisms : Tropisms
    toward : (n, 3) float64 ndarray
        Direction of the light, unit vectors; 0 where there is none.
    length : (n,) float64 ndarray
        l_s, metres.
    internode : float
        l_i, metres.

    Returns
    -------
    keep : (n,) float64 ndarray
        w_s, 0 to 1.
    lean : (n, 3) float64 ndarray
        t_w; never longer than 1 - w_s.

    Examples
    --------
    >>> keep, lean = lean_of(Tropisms(0.5, 0.0), np.array([[1.0, 0, 0]]), np.array([0.2]), 0.1)
    >>> keep.tolist(), lean.tolist()
    ([0.25], [[0.75, 0.0, 0.0]])
    """
    keep = (1.0 - tropisms.total) ** (length / internode)
    t = tropisms.light_share * toward + tropisms.up_share * np.array([0.0, 0.0, 1.0])
    return keep, (1.0 - keep)[:, None] * t


def invert_tropism(
    heading: NDArray[np.float64], keep: NDArray[np.float64], lean: NDArray[np.float64]
) -> NDArray[np.float64]:
    r"""What is left of branches without their tropisms, :math:`w_s d_o = p h - t_w` (Eq. 4.8).

    p is the larger solution of :math:`w_s^2 = p^2 - 2 p (h \cdot t_w) + |t_w|^2` (Eq. 4.10), so that
    :math:`d_o` is a unit vector. Without a solution it is where the line comes closest to the sphere,
    :math:`p = h \cdot t_w`, and d_o is longer than 1. In any case :math:`p \ge (1 - w_s) / 2`.

    Parameters
    ----------
    heading : (n, 3) float64 ndarray
        h, unit vectors.
    keep, lean
        w_s and t_w, from :func:`lean_of`.

    Returns
    -------
    rest : (n, 3) float64 ndarray
        w_s d_o. With t_w added it points along h again.

    Examples
    --------
    >>> keep, lean = np.array([0.8]), np.array([[0.0, 0.0, 0.2]])
    >>> (invert_tropism(np.array([[1.0, 0.0, 0.0]]), keep, lean) / 0.8).round(6).tolist()
    [[0.968246, 0.0, -0.25]]
    """
    from plastic import _analysis_kernels as kernels

    rest = np.empty_like(heading)
    kernels.invert_tropism(heading, keep, lean, LEAST_ALONG * (1.0 - keep), rest)
    return rest


def tropism_direction(rest: NDArray[np.float64], lean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where branches grow, Eq. 4.6: unit vectors (n, 3) along w_s d_o + t_w."""
    h = rest + lean
    return h / np.linalg.norm(h, axis=1, keepdims=True)
