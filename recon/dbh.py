"""Diameter at breast height, from the points there or with a reason why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.skeleton import Skeleton, chains_of

BREAST_HEIGHT = 1.3  # metres above the foot of the trunk
HALF_SLICE = 0.10  # metres
SEARCH_RADII = 1.6  # points this near the axis, in radii of the fitted trunk
MIN_POINTS = 10
CIRCLE_ROUNDS = 20
MIN_ARC = 0.4  # share of the round
MAX_SCATTER = 0.15  # scale of the residuals, in radii
MAX_TUBE_SCATTER = 0.4  # points that scatter more, in radii, speak against the fitted trunk, too
MAX_SLENDERNESS = 0.08  # diameter over height of a fitted trunk to be believed without a circle
INSIDE = 0.6  # a trunk is empty nearer to its axis than this, in radii ...
MAX_INSIDE = 0.15  # ... but for this share of the points
MAX_SHIFT = 0.5  # a circle whose centre is farther from the trunk's axis, in radii, is another's
MAX_RATIO = 1.6  # nor may its radius differ more from the fitted trunk's


@dataclass(frozen=True)
class BreastHeight:
    """Diameter at breast height.

    Attributes
    ----------
    diameter : float or None
        Metres.
    method : str
        "circle", "tube" or "none".
    reason : str or None
        Why it is no circle.
    arc : float
        Share of the round with points, 0 to 1.
    """

    diameter: float | None
    method: str
    reason: str | None
    arc: float


def breast_height(
    xyz: np.ndarray, skeleton: Skeleton, measured: np.ndarray, has_stem: bool = True
) -> BreastHeight:
    """Fit a circle across the trunk 1.3 m above its foot.

    Parameters
    ----------
    xyz : (n, 3) float64
        Points, metres, foot of the trunk at the origin.
    skeleton : Skeleton
        With final radii.
    measured : (n_nodes,) bool
        Where a circle stands behind a node's radius.
    has_stem : bool
        Whether an upright stem stands out near the foot; without one only a circle counts.

    Returns
    -------
    BreastHeight
        From a circle of the points if they close at least 40% of the round, lie on it and leave
        its middle empty; else from the fitted trunk if that is measured there and the points of the
        slice are few or near its surface; else none.
    """
    found = _trunk_at(skeleton, BREAST_HEIGHT)
    if found is None:
        return BreastHeight(None, "none", f"the stem does not reach {BREAST_HEIGHT} m above its foot", 0.0)
    centre, radius, direction, node = found
    circle, reason, scatter = _circle(xyz, centre, radius, direction)
    if circle is not None:
        return BreastHeight(2 * circle[0], "circle", None, circle[1])
    slender = 2 * radius <= MAX_SLENDERNESS * skeleton.position[:, 2].max()
    if measured[node] and has_stem and slender and scatter <= MAX_TUBE_SCATTER:
        return BreastHeight(2 * radius, "tube", reason, 0.0)
    return BreastHeight(None, "none", reason, 0.0)


def _trunk_at(skeleton: Skeleton, height: float) -> tuple[np.ndarray, float, np.ndarray, int] | None:
    """Centre, radius and direction of the main chain where it first passes a height."""
    onward = chains_of(skeleton).onward
    low, high = 0, int(onward[0])
    while high >= 0:
        a, b = skeleton.position[low], skeleton.position[high]
        if a[2] <= height < b[2]:
            t = (height - a[2]) / (b[2] - a[2])
            radius = float(skeleton.radius[low] + t * (skeleton.radius[high] - skeleton.radius[low]))
            return a + t * (b - a), radius, (b - a) / np.linalg.norm(b - a), high
        low, high = high, int(onward[high])
    return None


def _circle(
    xyz: np.ndarray, centre: np.ndarray, radius: float, direction: np.ndarray
) -> tuple[tuple[float, float] | None, str | None, float]:
    """Radius and arc of a circle of the points across the trunk, or why not; its scatter in radii."""
    from recon import _tube_kernels as tubes

    offset = xyz - centre
    along = offset @ direction
    near = np.abs(along) <= HALF_SLICE
    u, v = tubes.plane_basis(direction)
    x, y = offset[near] @ u, offset[near] @ v
    close = np.hypot(x, y) <= SEARCH_RADII * radius
    x, y = x[close], y[close]
    where = f"between {BREAST_HEIGHT - HALF_SLICE:.1f} and {BREAST_HEIGHT + HALF_SLICE:.1f} m"
    if x.size < MIN_POINTS:
        return None, f"only {x.size} points on the trunk {where}", 0.0
    from_tube = _judged(x, y, (0.0, 0.0, radius), radius, where)
    through = tubes.circle_through(x, y, np.ones(x.size))
    if from_tube[0] is not None or not np.isfinite(through).all():
        return from_tube
    from_points = _judged(x, y, through, radius, where)
    return from_tube if from_points[0] is None else from_points


def _judged(
    x: np.ndarray, y: np.ndarray, guess: tuple[float, float, float], radius: float, where: str
) -> tuple[tuple[float, float] | None, str | None, float]:
    """The circle that a first guess leads to, as :func:`_circle` gives it."""
    from recon import _tube_kernels as tubes

    weight = np.ones(x.size)
    cx, cy, r, scatter = tubes.refine_circle(x, y, *guess, weight, CIRCLE_ROUNDS)
    arc = float(tubes.arc_covered(x, y, cx, cy, weight))
    reason = None
    if np.hypot(cx, cy) > MAX_SHIFT * radius or not 1 / MAX_RATIO < r / radius < MAX_RATIO:
        reason = f"the points {where} show no circle around the trunk"
    elif arc < MIN_ARC:
        reason = f"points {where} on only {100 * arc:.0f}% of the trunk's round"
    elif scatter > MAX_SCATTER * r:
        reason = f"the points {where} scatter by {100 * scatter / r:.0f}% of the radius"
    else:
        inside = np.mean(np.hypot(x - cx, y - cy) < INSIDE * r)
        if inside > MAX_INSIDE:
            reason = f"{100 * inside:.0f}% of the points {where} lie inside the trunk"
    return (None if reason else (float(r), arc)), reason, float(scatter / r)


def hold_breast_height(skeleton: Skeleton, radius: np.ndarray, found: BreastHeight) -> np.ndarray:
    """Radii that agree with a circle at breast height: no thinner below it on the trunk, no thicker above.

    Parameters
    ----------
    skeleton : Skeleton
    radius : (n,) float64
        Metres, not growing towards the tips.
    found : BreastHeight

    Returns
    -------
    (n,) float64
        Not growing towards the tips; `radius` if the diameter is not from a circle.
    """
    if found.diameter is None or found.method != "circle":
        return radius
    out = radius.copy()
    onward = chains_of(skeleton).onward
    node, below = 0, True
    while node >= 0:
        below = below and skeleton.position[node, 2] < BREAST_HEIGHT
        bound = max if below else min
        out[node] = bound(out[node], 0.5 * found.diameter)
        node = int(onward[node])
    for i in range(1, out.size):
        out[i] = min(out[i], out[skeleton.parent[i]])
    return out
