"""A camera that frames whatever it is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treegraph import InputError

__all__ = ["Camera", "fit_camera", "view_axes"]

HALF_ANGLE = np.radians(14.0)  # of the image's longer side: long enough a lens to keep a crown's proportions


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera.

    Attributes
    ----------
    eye : (3,) float64
        Where it is, metres.
    axes : (3, 3) float64
        Unit vectors to the right of the image, up in it, and forwards.
    tan_half : float
        Tangent of half the vertical angle of view.
    """

    eye: NDArray[np.float64]
    axes: NDArray[np.float64]
    tan_half: float

    def focal(self, height: int) -> float:
        """Focal length in pixels of an image of that height."""
        return 0.5 * height / self.tan_half

    def project(self, points: NDArray[np.float64], width: int, height: int) -> NDArray[np.float64]:
        """Image coordinates, x right and y down from the upper left corner, pixels; and depth, metres."""
        x, y, z = ((points - self.eye) @ self.axes.T).T
        focal = self.focal(height)
        return np.column_stack([0.5 * width + focal * x / z, 0.5 * height - focal * y / z, z])


def view_axes(azimuth: float, elevation: float) -> NDArray[np.float64]:
    """Right, up and forward of a camera that looks from an azimuth and an elevation towards the origin.

    Parameters
    ----------
    azimuth : float
        Direction from the tree to the camera, radians from +x towards +y.
    elevation : float
        Height of the camera above the horizon as seen from the tree, radians, within +-pi/2.
    """
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce], [-ce * ca, -ce * sa, -se]])


def fit_camera(
    points: NDArray[np.float64],
    axes: NDArray[np.float64],
    width: int,
    height: int,
    *,
    margin: float = 0.06,
    bottom: float = 0.06,
) -> Camera:
    """The nearest camera with the given axes that has every point in its image.

    Parameters
    ----------
    points : (n, 3) float64
        Metres; n > 0, finite.
    axes : (3, 3) float64
        See :func:`view_axes`.
    width, height : int
        Size of the image; only its proportions matter.
    margin, bottom : float
        Empty part of the image at the left, right and top, and at its bottom, 0 to 0.4.

    Returns
    -------
    camera : Camera
        The points touch the margins in at least one direction, and are about in the middle in the other.

    Notes
    -----
    For axes that are given, "inside the image" is four linear inequalities per point in the eye's
    coordinates, so the nearest eye is found without iteration, in O(n).
    """
    points = np.asarray(points, np.float64)
    if not len(points) or not np.isfinite(points).all():
        raise InputError(f"a camera needs at least one point, all of them finite, got {len(points)} points")
    longer = np.tan(HALF_ANGLE)
    tan_half = longer * min(1.0, height / width)
    tan_side = tan_half * width / height
    local = points @ axes.T
    limits = ((local[:, 0], -1.0 + 2.0 * margin, 1.0 - 2.0 * margin, tan_side),
              (local[:, 1], -1.0 + 2.0 * bottom, 1.0 - 2.0 * margin, tan_half))  # fmt: skip
    bounds = []
    forward = local[:, 2].min() - 0.05 * max(np.ptp(local[:, 2]), 1e-3)  # never inside the tree
    for across, low, high, tangent in limits:
        above = (across - high * tangent * local[:, 2]).max()
        below = (-across + low * tangent * local[:, 2]).max()
        bounds.append((above, below, low * tangent, high * tangent))
        forward = min(forward, -(above + below) / ((high - low) * tangent))
    place = [0.5 * (above + high * forward - below + low * forward) for above, below, low, high in bounds]
    return Camera(np.array([*place, forward]) @ axes, axes, float(tan_half))
