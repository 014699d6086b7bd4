"""How two numbers differ, on a scale from 0 to 1, and how differences add up.

Based on: O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014, Eq. 4,
and the Minkowski distance of section 5.1.

Departs from it in, or reads it as:

- where a value is 0 in one tree, sigma of Eq. 4 is 0: the difference is then 0 if both are 0, else 1, its
  limit;
- sigma has a least value, the resolution. Without one, angles of 0 and of 0.001 degrees would be wholly
  different, and a tree would not be like itself after a turn, in which a 0 becomes 1e-17;
- sigma is a share of the smaller absolute value, as slopes are negative too;
- the Minkowski distance is divided by its largest possible value, as in appendix B.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "ANGLE_RESOLUTION",
    "LENGTH_RESOLUTION",
    "ORDER",
    "SHARE",
    "STRAIGHT_RESOLUTION",
    "differences",
    "minkowski_mean",
]

ORDER = 2.5
"""Order of the Minkowski distance."""

SHARE = 0.2
"""Sigma of Eq. 4 as a share of the smaller value."""

ANGLE_RESOLUTION = 0.05
"""Least sigma of an angle, radians: about 3 degrees."""

STRAIGHT_RESOLUTION = 0.01
"""Least sigma of a straightness."""

LENGTH_RESOLUTION = 0.01
"""Least sigma of a length, as a share of the tree's size or of the mean length."""


def differences(
    x: ArrayLike, y: ArrayLike, resolution: ArrayLike = 0.0, softness: float = 1.0
) -> NDArray[np.float64]:
    r"""Difference of each two values on a scale from 0 to 1, Eq. 4 of [1]_.

    :math:`1 - \exp(-(x - y)^2 / (2 \sigma^2))` with :math:`\sigma = \max(0.2 \min(|x|, |y|), resolution)`.

    Parameters
    ----------
    x, y : (n,) array_like
        Values of two trees. NaN where a tree has none.
    resolution : (n,) array_like
        Least :math:`\sigma`, in the unit of the values, >= 0.
    softness : float, default 1
        Factor on :math:`\sigma`, > 0: with more of it, differences that would all be 1 can be told apart.

    Returns
    -------
    difference : (n,) float64 ndarray
        0 where the values are equal or both missing; 1 where one is missing, or :math:`\sigma` is 0 and they
        differ.

    References
    ----------
    .. [1] O. Stava et al., "Inverse Procedural Modeling of Trees", Computer Graphics Forum 33(6), 2014.

    Examples
    --------
    >>> differences([1.0, 1.0, 0.0, 0.0], [1.0, 1.2, 0.0, 0.1]).round(3).tolist()
    [0.0, 0.393, 0.0, 1.0]
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    sigma = softness * np.maximum(SHARE * np.minimum(np.abs(x), np.abs(y)), resolution)
    apart = np.abs(x - y)
    out = np.where(apart > 0.0, 1.0, 0.0)
    measured = sigma > 0.0
    out[measured] = -np.expm1(-0.5 * (apart[measured] / sigma[measured]) ** 2)
    out[np.isnan(x) != np.isnan(y)] = 1.0
    out[np.isnan(x) & np.isnan(y)] = 0.0
    return out


def minkowski_mean(difference: ArrayLike, order: float = ORDER) -> float:
    """Minkowski distance of differences from 0, divided by the largest it can be: 0 to 1.

    Examples
    --------
    >>> round(minkowski_mean([0.0, 0.0, 1.0]), 4), minkowski_mean([1.0, 1.0])
    (0.6444, 1.0)
    """
    power = np.asarray(difference, np.float64) ** order
    return float(power.mean() ** (1.0 / order))
