r"""How much light reaches a point among leaves, branches and obstacles, and where it comes from.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.3.2 (Eq. 4.3, 4.4) and section 4.4 (Eq. 4.14, global light).
Departs from it in: the integral runs over the upper hemisphere (the printed one runs over the whole sphere,
to pi); the sky is dark at more than 90 degrees from its brightest point, where the printed cos^2 would rise
again to a second brightest point opposite; shadows have no limited range.

Two implementations have one meaning. :func:`gather_light_exact` tests every ray of a fine quadrature
against every occluder and is the reference; :func:`gather_light` blurs each shadow a little, which takes
few directions, and is several thousand times faster. docs/light.md says how far they are apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph.errors import InputError
from treegraph.graph import NO_PARENT, TreeGraph
from treegraph.obstacles import (
    Ball,
    Box,
    HalfSpace,
    Obstacle,
    TriangleMesh,
    check_array,
    check_rows,
    check_unit,
    put_fields,
)

__all__ = [
    "AMOUNT_ERROR",
    "UNIT_TRANSLUCENCY",
    "VECTOR_ERROR",
    "Branches",
    "Leaves",
    "Light",
    "Occluders",
    "Sky",
    "branches_of",
    "gather_light",
    "gather_light_exact",
    "join_occluders",
    "make_leaves",
]

UNIT_TRANSLUCENCY = 0.5
"""gamma_c0 of Eq. 4.4, the thesis' value for any species: share of the light that passes per metre of
radius."""

AMOUNT_ERROR = 0.02
"""Bound of |fast - exact| of the amount at the default fineness, for the scenes that docs/light.md names."""

VECTOR_ERROR = 0.02
"""The same bound for the length of the difference of the light vectors."""

DEFAULT_RINGS = 10  # 256 cells of the sky
FEWEST_RINGS, MOST_RINGS = 4, 64
DEFAULT_ORDER = (96, 192)  # polar and azimuthal nodes of the reference
SUBDIVISION = 8  # a cell's share of the sky is the mean over 8 x 8 directions
BLUR = 0.5  # half width of a shadow's blurred edge, in widths of a cell
TENT = 1.15  # radius of the spot that a sphere smaller than a cell is spread over, in widths of a cell
CHUNK_RAYS = 1 << 20  # rays against meshes in one go: 24 MB
NO_OWN = -1
ROUNDS = 200  # steps to the middle of a tile
ROUNDING = 1e-5  # added to a tile's radius, radians: what float32 may miss
NEVER = -1e9  # tangent of the radius of a tile that nothing touches


@dataclass(frozen=True)
class Sky:
    r"""Where the light comes from: :math:`I = \max(0, \cos \Delta\sigma)^2`.

    :math:`\Delta\sigma` is the angle between a direction and the brightest one (thesis 4.3.2). Only the upper
    hemisphere shines.

    Attributes
    ----------
    brightest : (float, float, float)
        Direction of the brightest point, not below the horizon; any length, kept as a unit vector.
    """

    brightest: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        x, y, z = check_unit("brightest", self.brightest).tolist()
        if z < 0.0:
            raise InputError(f"brightest must not point below the horizon (z >= 0), got {self.brightest}")
        object.__setattr__(self, "brightest", (x, y, z))

    @classmethod
    def from_angles(cls, elevation: float, bearing: float) -> Sky:
        """The sky whose brightest point stands on one side.

        Parameters
        ----------
        elevation : float
            Angle above the horizon, radians, 0 to pi/2.
        bearing : float
            Compass bearing, radians: 0 is north (+y), pi/2 east (+x).

        Raises
        ------
        InputError
            If an angle is out of its range or not finite.
        """
        if not 0.0 <= elevation <= math.pi / 2:
            raise InputError(f"elevation must be from 0 to pi/2 radians, got {elevation!r}")
        if not math.isfinite(bearing):
            raise InputError(f"bearing must be a finite angle in radians, got {bearing!r}")
        level = math.cos(elevation)
        return cls((level * math.sin(bearing), level * math.cos(bearing), math.sin(elevation)))

    @classmethod
    def at_latitude(cls, latitude: float, north: float = 0.0) -> Sky:
        """The sky of a place on Earth: brightest where the sun stands at noon of an equinox.

        Parameters
        ----------
        latitude : float
            Radians, -pi/2 to pi/2; south of the equator is negative. The brightest point is that far from the
            zenith, towards the south on the northern hemisphere, towards the north on the southern one.
        north : float, default 0
            Bearing of true north in the scene's frame, radians clockwise from +y.

        Raises
        ------
        InputError
            If an angle is out of its range or not finite.
        """
        if not -math.pi / 2 <= latitude <= math.pi / 2:
            raise InputError(f"latitude must be from -pi/2 to pi/2 radians, got {latitude!r}")
        side = north + math.pi if latitude > 0.0 else north
        return cls.from_angles(math.pi / 2 - abs(latitude), side)

    def radiance(self, direction: NDArray[np.float64]) -> NDArray[np.float64]:
        """Brightness, 0 to 1, of unit directions (..., 3) of the upper hemisphere."""
        return np.maximum(direction @ np.array(self.brightest), 0.0) ** 2


@dataclass(frozen=True, eq=False)
class Leaves:
    """Leaf clusters as spheres, each letting the same share of light through wherever a ray meets it.

    Attributes
    ----------
    center : (m, 3) float64
        Metres.
    radius : (m,) float64
        Metres, > 0.
    translucency : (m,) float64
        Share of the light that passes, gamma_c, 0 to 1 (:func:`make_leaves` computes it by Eq. 4.4).
    """

    center: NDArray[np.float64]
    radius: NDArray[np.float64]
    translucency: NDArray[np.float64]

    def __post_init__(self) -> None:
        center = check_array("center", self.center, (None, 3))
        m = len(center)
        radius = check_array("radius", self.radius, (m,))
        share = check_array("translucency", self.translucency, (m,))
        check_rows("radius", radius, radius > 0.0, "positive, in metres")
        check_rows("translucency", share, (share >= 0.0) & (share <= 1.0), "from 0 to 1")
        put_fields(self, center=center, radius=radius, translucency=share)


@dataclass(frozen=True, eq=False)
class Branches:
    """Opaque pieces of branches: cones with a ball at each end, the hull of two balls.

    Attributes
    ----------
    start, end : (m, 3) float64
        Centres of the balls, metres.
    start_radius, end_radius : (m,) float64
        Metres, >= 0. Equal radii make a cylinder with round ends.
    joined : (m, 2) bool
        Whether this piece goes on from another where it starts, and another from it where it ends; default:
        no. Changes nothing in what is meant, but :func:`gather_light` is closer if it knows: pieces that
        follow each other in the rows count as one branch, and joints have no round ends.
    """

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    start_radius: NDArray[np.float64]
    end_radius: NDArray[np.float64]
    joined: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        start = check_array("start", self.start, (None, 3))
        m = len(start)
        end = check_array("end", self.end, (m, 3))
        radii = {n: check_array(n, getattr(self, n), (m,)) for n in ("start_radius", "end_radius")}
        for name, radius in radii.items():
            check_rows(name, radius, radius >= 0.0, "0 or more, in metres")
        joined = np.zeros((m, 2), bool) if self.joined is None else np.array(self.joined)
        if joined.shape != (m, 2) or joined.dtype != bool:
            raise InputError(f"joined must be bool of shape ({m}, 2), got {joined.dtype} {joined.shape}")
        joined.flags.writeable = False
        put_fields(self, start=start, end=end, joined=joined, **radii)


NO_LEAVES = Leaves(np.empty((0, 3)), np.empty(0), np.empty(0))
NO_BRANCHES = Branches(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class Occluders:
    """Everything that casts shadows: one tree, or all trees of a scene and what stands between them.

    Attributes
    ----------
    leaves : Leaves
    branches : Branches
    obstacles : tuple of HalfSpace, Ball, Box, TriangleMesh
    """

    leaves: Leaves = NO_LEAVES
    branches: Branches = NO_BRANCHES
    obstacles: tuple[Obstacle, ...] = ()

    def __post_init__(self) -> None:
        obstacles = tuple(self.obstacles)
        for i, obstacle in enumerate(obstacles):
            if not isinstance(obstacle, HalfSpace | Ball | Box | TriangleMesh):
                raise InputError(
                    "obstacles must be HalfSpace, Ball, Box or TriangleMesh, "
                    f"but obstacles[{i}] is a {type(obstacle).__name__}"
                )
        put_fields(self, obstacles=obstacles)


@dataclass(frozen=True, eq=False)
class Light:
    """The light at n points.

    Attributes
    ----------
    amount : (n,) float64
        Share of the open sky's light, 0 to 1 (Eq. 4.3).
    vector : (n, 3) float64
        The same integral with its integrand times the direction; its length is at most `amount`.
    """

    amount: NDArray[np.float64]
    vector: NDArray[np.float64]

    @property
    def direction(self) -> NDArray[np.float64]:
        """Mean light direction (n, 3), unit vectors; NaN at a point without any light."""
        length = np.linalg.norm(self.vector, axis=1, keepdims=True)
        return np.divide(self.vector, length, out=np.full_like(self.vector, np.nan), where=length > 0.0)


def make_leaves(
    center: ArrayLike,
    radius: ArrayLike,
    *,
    unit_translucency: float = UNIT_TRANSLUCENCY,
    density: ArrayLike = 1.0,
) -> Leaves:
    r"""Return leaf clusters with the translucency that goes with their size.

    :math:`\gamma_c = \gamma_{c_0}^{r_c}`, Eq. 4.4, and where a cluster has lost or gained leaves
    :math:`\gamma'_c = \gamma_c^{n_c / n_0}`, Eq. 4.14.

    Parameters
    ----------
    center : (m, 3) array_like
        Metres.
    radius : (m,) array_like
        :math:`r_c`, metres, > 0.
    unit_translucency : float, default 0.5
        :math:`\gamma_{c_0}`, per metre of radius, above 0 and at most 1.
    density : float or (m,) array_like, default 1
        :math:`n_c / n_0`, leaves over the leaves it had at first, >= 0.

    Returns
    -------
    leaves : Leaves

    Raises
    ------
    InputError
        If a value is out of its range or a shape does not fit.

    Examples
    --------
    >>> make_leaves([[0, 0, 3]], [2.0]).translucency.tolist()
    [0.25]
    """
    if not 0.0 < unit_translucency <= 1.0:
        raise InputError(f"unit_translucency must be above 0 and at most 1, got {unit_translucency!r}")
    radius = check_array("radius", radius, (None,))
    ratio = check_array("density", np.broadcast_to(density, radius.shape), radius.shape)
    check_rows("density", ratio, ratio >= 0.0, "0 or more")
    check_rows("radius", radius, radius > 0.0, "positive, in metres")
    return Leaves(np.asarray(center, float), radius, unit_translucency ** (radius * ratio))


def branches_of(tree: TreeGraph) -> Branches:
    """Return the edges of a tree as occluders.

    Parameters
    ----------
    tree : TreeGraph
        ``parent``, ``position`` and ``radius`` are read.

    Returns
    -------
    branches : Branches
        One per node that has a parent, in the order of :func:`treegraph.chains`. A side branch starts with
        its own radius, not with that of the wood it leaves.

    Raises
    ------
    InputError
        If a radius is unknown (NaN).
    """
    unknown = np.flatnonzero(np.isnan(tree.radius))
    if unknown.size:
        raise InputError(
            f"radius must be known to cast a shadow, but radius[{unknown[0]}] is nan; {unknown.size} of "
            f"{tree.n_nodes} nodes break this. Fill them with allometric_radii()."
        )
    from treegraph.order import chains

    chain_start, node = chains(tree)
    begins = np.zeros(len(node) + 1, bool)
    begins[chain_start] = True
    edge = np.flatnonzero(~begins[:-1])  # places in the list whose predecessor is their node's parent
    child, parent = node[edge], node[edge - 1]
    starts = begins[edge - 1]
    start_radius = tree.radius[parent]
    leaves_wood = starts & (tree.parent[parent] != NO_PARENT)
    start_radius[leaves_wood] = np.minimum(start_radius, tree.radius[child])[leaves_wood]
    joined = np.column_stack([~starts | leaves_wood, ~begins[edge + 1]])
    return Branches(tree.position[parent], tree.position[child], start_radius, tree.radius[child], joined)


def join_occluders(*parts: Occluders) -> Occluders:
    """Return one scene of several: rows follow each other in the order of the arguments.

    Parameters
    ----------
    *parts : Occluders
        Trees, neighbours, obstacles.

    Returns
    -------
    whole : Occluders
        Row k of the second part's leaves is row ``len(first.leaves.radius) + k`` here.
    """
    if not parts:
        return Occluders()

    def stack(kind: str, name: str) -> NDArray:
        return np.concatenate([getattr(getattr(part, kind), name) for part in parts])

    return Occluders(
        Leaves(*(stack("leaves", n) for n in Leaves.__dataclass_fields__)),
        Branches(**{n: stack("branches", n) for n in Branches.__dataclass_fields__}),
        tuple(obstacle for part in parts for obstacle in part.obstacles),
    )


def gather_light(
    points: ArrayLike,
    occluders: Occluders,
    sky: Sky = Sky(),
    *,
    own: ArrayLike | None = None,
    rings: int = DEFAULT_RINGS,
) -> Light:
    r"""Return the light that reaches each point, fast.

    :math:`i(p) = c \int_0^{2\pi} \int_0^{\pi/2} I(\theta, \phi) \prod_k \gamma_k(p, \theta, \phi)
    \sin\theta \, d\theta d\phi`, Eq. 4.3 of [1]_ over the upper hemisphere, with :math:`c` such that a
    point under the open sky receives 1. An occluder multiplies each ray that meets it by its translucency
    once, and

    - a leaf cluster that contains the point dims the whole sky once, as it would from outside; the point's
      own cluster (`own`) does not dim it at all;
    - a branch that contains the point does not shade it (buds and nodes lie in their own wood);
    - an obstacle that contains the point shades it from all sides.

    Parameters
    ----------
    points : (n, 3) array_like
        Metres.
    occluders : Occluders
        Trees and obstacles.
    sky : Sky, optional
        Default: brightest in the zenith.
    own : (n,) int array_like, optional
        Row of the leaf cluster that each point belongs to, -1 for none.
    rings : int, default 10
        Fineness: the sky is divided into about 2.5 rings^2 cells of about one size; 4 to 64. Time grows as
        its square.

    Returns
    -------
    light : Light
        Never more where an occluder is added. Same input, same bytes.

    Raises
    ------
    InputError
        If a shape, an index or `rings` is out of its range.

    See Also
    --------
    gather_light_exact : the reference, with the bounds of this function's error.

    Notes
    -----
    O(n m) time for n points and m occluders, O(n) memory. Obstacles are tested at 4 directions per cell.
    The edges of leaves' and branches' shadows are blurred over one cell so that their solid angle is kept.
    What that loses is how shadows lie to each other below the size of a cell (0.16 rad): they count as
    independent there. With the default fineness the amount differs from the exact one by at most
    :data:`AMOUNT_ERROR` and the vector by at most :data:`VECTOR_ERROR` (docs/light.md says for which scenes
    and what breaks it).

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
       Konstanz, 2013, section 4.3.2.

    Examples
    --------
    >>> leaves = make_leaves([[0, 0, 5]], [2.0])
    >>> gather_light([[0, 0, 0], [9, 0, 0]], Occluders(leaves)).amount.round(2).tolist()
    [0.83, 0.99]
    """
    from treegraph import _light_kernels

    points, own = _check_points(points, own, len(occluders.leaves.radius))
    if not isinstance(rings, int | np.integer) or not FEWEST_RINGS <= rings <= MOST_RINGS:
        raise InputError(f"rings must be a whole number from {FEWEST_RINGS} to {MOST_RINGS}, got {rings!r}")
    cells = _sky_cells(int(rings))
    weight = _cell_weight(int(rings), sky)
    amount, vector = np.empty(len(points)), np.empty((len(points), 3))
    leaves, branches, packed, meshes = _pack(occluders)
    step = len(points) if not meshes else max(1, CHUNK_RAYS // cells.fine.shape[1])
    for first in range(0, len(points), max(1, step)):
        part = slice(first, first + step)
        _light_kernels.gather(
            points[part],
            own[part],
            len(occluders.leaves.radius),
            leaves,
            branches,
            packed,
            _seen_past(meshes, points[part], cells.fine),
            cells.grid,
            cells.fine,
            weight,
            _aligned(cells.grid[0].size),
            BLUR * cells.width,
            TENT * cells.width,
            amount[part],
            vector[part],
        )
    return Light(amount, vector)


def gather_light_exact(
    points: ArrayLike,
    occluders: Occluders,
    sky: Sky = Sky(),
    *,
    own: ArrayLike | None = None,
    order: tuple[int, int] = DEFAULT_ORDER,
) -> Light:
    """Return the light that reaches each point, slowly: every ray against every occluder.

    The meaning, the arguments and what is returned are those of :func:`gather_light`.

    Parameters
    ----------
    points, occluders, sky, own
        See :func:`gather_light`.
    order : (int, int), default (96, 192)
        Nodes of the quadrature, each >= 2: Gauss-Legendre in the cosine of the polar angle, equal steps in
        azimuth.

    Returns
    -------
    light : Light
        With an open sky of brightness cos^2 about the zenith exact to rounding. An opaque shadow with a
        sharp edge misses about half the share of the nodes along the edge: 0.002 at the default order, and up
        to 0.007 where the edge is a circle around the zenith, as the nodes are.

    Raises
    ------
    InputError
        If a shape, an index or `order` is out of its range.

    Notes
    -----
    O(n m order[0] order[1]) time; plain NumPy.
    """
    points, own = _check_points(points, own, len(occluders.leaves.radius))
    if len(order) != 2 or min(order) < 2:
        raise InputError(f"order must be two numbers of nodes, each 2 or more, got {order!r}")
    direction, weight = _quadrature(*order)
    weight = weight * sky.radiance(direction)
    weight /= weight.sum()
    amount, vector = np.empty(len(points)), np.empty((len(points), 3))
    for q, point in enumerate(points):
        passed = weight * _passes(point, direction, occluders, int(own[q]))
        amount[q], vector[q] = passed.sum(), passed @ direction
    return Light(amount, vector)


def _quadrature(n_polar: int, n_azimuth: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Directions (k, 3) of the upper hemisphere and the solid angle (k,) that each stands for."""
    node, share = np.polynomial.legendre.leggauss(n_polar)
    azimuth = (np.arange(n_azimuth) + 0.5) * (2.0 * math.pi / n_azimuth)
    z = np.repeat((node + 1.0) / 2.0, n_azimuth)
    level, azimuth = np.sqrt(1.0 - z * z), np.tile(azimuth, n_polar)
    direction = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), z])
    return direction, np.repeat(share * (math.pi / n_azimuth), n_azimuth)


def _passes(
    point: NDArray[np.float64], direction: NDArray[np.float64], occluders: Occluders, own: int
) -> NDArray[np.float64]:
    """Product of the translucencies on each ray, (k,)."""
    passed = np.ones(len(direction))
    leaves, branches = occluders.leaves, occluders.branches
    for k, (center, radius, share) in enumerate(
        zip(leaves.center, leaves.radius, leaves.translucency, strict=True)
    ):
        if k != own:
            passed[Ball(center, radius).blocks(point, direction)] *= share
    for start, end, r0, r1 in zip(
        branches.start, branches.end, branches.start_radius, branches.end_radius, strict=True
    ):
        passed[_cone_blocks(point, direction, start, end, r0, r1)] = 0.0
    for obstacle in occluders.obstacles:
        passed[obstacle.blocks(point, direction)] *= obstacle.translucency
    return passed


def _cone_blocks(
    point: NDArray[np.float64],
    direction: NDArray[np.float64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    r0: float,
    r1: float,
) -> NDArray[np.bool_]:
    """Which rays meet the hull of two balls; none if the point is inside.

    With c(s) and r(s) the centre and radius of the ball at s in [0, 1] of the axis, a line meets that ball
    where |c|^2 - (c . w)^2 - r^2 <= 0: a quadratic A s^2 + 2 B s + C, whose least value on the part of
    [0, 1] ahead of the point (c . w > 0) decides.
    """
    c, e, dr = start - point, end - start, r1 - r0
    grid = np.array([0.0, 1.0])  # where the gap |c| - r can be least: the ends, or the foot on the cone
    ee, ce, cc = float(e @ e), float(c @ e), float(c @ c)
    slope = ee - dr * dr
    if slope > 0.0:
        off2 = max(0.0, cc - ce * ce / ee)
        foot = -ce / ee + dr * math.sqrt(off2 / (ee * slope))
        grid = np.append(grid, np.clip(foot, 0.0, 1.0))
    if (np.linalg.norm(c + grid[:, None] * e, axis=1) <= r0 + grid * dr).any():
        return np.zeros(len(direction), bool)
    cw, ew = direction @ c, direction @ e
    a, b, gap = slope - ew**2, ce - cw * ew - r0 * dr, cc - cw**2 - r0**2
    with np.errstate(divide="ignore", invalid="ignore"):
        behind = np.clip(np.nan_to_num(-cw / ew), 0.0, 1.0)  # where c . w changes sign
        best = np.clip(np.nan_to_num(-b / a), 0.0, 1.0)
    hit = np.zeros(len(direction), bool)
    for s in (np.zeros_like(cw), np.ones_like(cw), best, behind):
        hit |= (cw + s * ew > 0.0) & ((a * s + 2.0 * b) * s + gap <= 0.0)
    return hit


class _Cells(NamedTuple):
    """Cells of about equal size in rings of equal height in angle; the first ring is around the zenith.

    They stand in tiles: compact patches of 16, of which four are quarter turns of each other.
    """

    grid: tuple[NDArray, ...]  # x, y, z (N,) float32 of the middles, 0 where filled up; _tile_rows
    fine: NDArray[np.float32]  # (3, 4 N): four directions per cell, all cells' first, then all second ...
    order: NDArray[np.int64]  # (N,) which cell, counted ring by ring, stands there; -1 where filled up
    edge: NDArray[np.float64]  # (rings + 1,) heights between the rings
    per_ring: NDArray[np.int64]  # (rings,) cells per ring
    width: float  # square root of a cell's mean solid angle


@lru_cache(maxsize=8)
def _sky_cells(rings: int) -> _Cells:
    """Cells of the upper hemisphere; multiples of four in each ring, no finer direction on an axis."""
    polar = (np.arange(rings) + 0.5) * (math.pi / 2 / rings)
    count = 4 * np.maximum(1, np.rint(np.sin(polar) * rings)).astype(np.int64)
    edge = np.cos(np.linspace(0.0, math.pi / 2, rings + 1))
    edge[-1] = 0.0
    one, two = (_cell_points(edge, count, parts).transpose(2, 1, 0) for parts in (1, 2))
    order = _order_cells(one[:, 0].T, count)
    there = order >= 0
    xyz = tuple(_aligned(len(order)) for _ in range(3))
    fine = np.zeros((3, 4, len(order)), np.float32)
    fine[:, :, there] = two[:, :, order[there]]
    for to, values in zip(xyz, one[:, 0], strict=True):
        to[there] = values[order[there]]
    tile = _tile_rows(np.column_stack(xyz).astype(np.float64), there)
    frozen: tuple[NDArray, ...] = (*xyz, tile, fine, order)
    for array in frozen:
        array.flags.writeable = False
    width = math.sqrt(2.0 * math.pi / count.sum())
    return _Cells((*xyz, tile), fine.reshape(3, -1), order, edge, count, width)


def _order_cells(direction: NDArray[np.float64], count: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells in tiles, each followed by its three quarter turns; -1 where a tile is not full."""
    from treegraph._light_kernels import LANES, QUARTERS

    n = count.sum()
    turn = np.repeat(count // QUARTERS, count)  # a cell's number grows by so much in a quarter turn
    place = np.arange(n) - np.repeat(np.cumsum(count) - count, count)
    quarter = _halve(direction, np.flatnonzero(place < turn))
    first = np.full(-(-len(quarter) // LANES) * LANES, -1)
    first[: len(quarter)] = quarter
    tile = np.where(first < 0, -1, first + np.arange(QUARTERS)[:, None] * turn[first])
    return tile.reshape(QUARTERS, -1, LANES).transpose(1, 0, 2).ravel()


def _halve(direction: NDArray[np.float64], cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """Reorder cells so that each 16 that follow each other lie close together: cut across, and cut again."""
    from treegraph._light_kernels import LANES

    if len(cell) <= LANES:
        return cell
    here = direction[cell]
    longest = np.linalg.svd(here - here.mean(axis=0))[2][0]
    cell = cell[np.argsort((here @ longest).round(9), kind="stable")]
    half = -(-len(cell) // LANES) // 2 * LANES
    return np.concatenate([_halve(direction, part) for part in (cell[:half], cell[half:])])


def _tile_rows(direction: NDArray[np.float64], there: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Caps around every fourth tile, flat: x, y, z of the axis over cos(radius), tan(radius)."""
    from treegraph._light_kernels import GROUP, LANES, PANEL, QUARTERS, TILE_ROWS

    cells = direction.reshape(-1, PANEL, 3)[:, :LANES]
    there = there.reshape(-1, PANEL)[:, :LANES]
    axis = cells.sum(axis=1)
    for step in range(2, ROUNDS):  # towards the farthest cell, less and less: Badoiu and Clarkson's least cap
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        cosine = np.where(there, np.einsum("tcx,tx->tc", cells, axis), 1.0)
        axis += (cells[np.arange(len(cells)), cosine.argmin(axis=1)] - axis) / step
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    cosine = np.where(there, np.einsum("tcx,tx->tc", cells, axis), 1.0).min(axis=1)
    radius = np.arccos(np.minimum(cosine, 1.0)) + ROUNDING
    in_group = GROUP // QUARTERS
    rows = np.zeros((-(-len(cells) // in_group) * in_group, TILE_ROWS), np.float32)
    rows[:, 3] = NEVER
    rows[: len(cells)] = np.column_stack([axis / np.cos(radius)[:, None], np.tan(radius)])
    return rows.ravel()


def _aligned(size: int) -> NDArray[np.float32]:
    """Zeros (size,) that begin at a cache line: vector code is up to twice as fast on them."""
    line = 64
    room = np.zeros(4 * size + line, np.uint8)
    begin = -room.ctypes.data % line
    return room[begin : begin + 4 * size].view(np.float32)


def _cell_points(edge: NDArray[np.float64], count: NDArray[np.int64], parts: int) -> NDArray[np.float64]:
    """Directions (N, parts^2, 3) of the middles of equal parts of each cell."""
    share = (np.arange(parts) + 0.5) / parts
    out = []
    for ring, (top, bottom, n) in enumerate(zip(edge[:-1], edge[1:], count, strict=True)):
        z = np.repeat(top + share * (bottom - top), parts)
        shift = 0.5 * (ring % 2)  # so that cells of neighbouring rings do not line up
        azimuth = (np.arange(n)[:, None] + shift + np.tile(share, parts)) * (2.0 * math.pi / n)
        level = np.sqrt(1.0 - z * z)
        height = np.broadcast_to(z, azimuth.shape)
        out.append(np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=2))
    return np.concatenate(out)


@lru_cache(maxsize=8)
def _subdivided(rings: int) -> NDArray[np.float64]:
    cells = _sky_cells(rings)
    return _cell_points(cells.edge, cells.per_ring, SUBDIVISION)


@lru_cache(maxsize=64)
def _cell_weight(rings: int, sky: Sky) -> NDArray[np.float64]:
    """(4, N): each cell's share of the light and that times its direction; 0 where cells are filled up."""
    cells, direction = _sky_cells(rings), _subdivided(rings)
    area = np.repeat((cells.edge[:-1] - cells.edge[1:]) / cells.per_ring, cells.per_ring)
    bright = sky.radiance(direction) * area[:, None]
    share = np.vstack([bright.sum(axis=1), np.einsum("ij,ijk->ki", bright, direction)])
    share /= share[0].sum()
    there = cells.order >= 0
    weight = _aligned(2 * 4 * len(there)).view(np.float64).reshape(4, -1)
    weight[:, there] = share[:, cells.order[there]]
    weight.flags.writeable = False
    return weight


def _pack_leaves(leaves: Leaves) -> NDArray[np.float64]:
    """Blocks of x, y, z, radius, gamma, flat; the last block is filled up with nothing."""
    from treegraph._light_kernels import BLOCK, LEAF_ROWS

    n_blocks = -(-len(leaves.radius) // BLOCK)
    rows = np.zeros((n_blocks * BLOCK, LEAF_ROWS))
    rows[: len(leaves.radius)] = np.column_stack([leaves.center, leaves.radius, leaves.translucency])
    return rows.reshape(n_blocks, BLOCK, LEAF_ROWS).transpose(0, 2, 1).ravel()


def _pack_branches(branches: Branches) -> NDArray[np.float64]:
    """Rows of start, end - start, radius, its change, joined at both ends, half length + radius, goes on."""
    along = branches.end - branches.start
    bound = np.linalg.norm(along, axis=1) / 2 + np.maximum(branches.start_radius, branches.end_radius)
    change = branches.end_radius - branches.start_radius
    goes_on = np.zeros(len(bound), bool)
    joined = np.asarray(branches.joined)
    goes_on[1:] = joined[1:, 0] & (branches.start[1:] == branches.end[:-1]).all(axis=1)
    columns = [branches.start, along, branches.start_radius, change, joined, bound, goes_on]
    return np.ascontiguousarray(np.column_stack(columns))


def _pack(occluders: Occluders) -> tuple[NDArray, NDArray, tuple, list[TriangleMesh]]:
    """Arrays for the kernels: leaves, branches, (half-spaces, balls, boxes); and the meshes."""
    things = occluders.obstacles
    planes = [(*o.point, *o.normal, o.translucency) for o in things if isinstance(o, HalfSpace)]
    balls = [(*o.center, o.radius, o.translucency) for o in things if isinstance(o, Ball)]
    boxes = [
        (*o.center, *np.asarray(o.rotation).T.ravel(), *o.size / 2, o.translucency)
        for o in things
        if isinstance(o, Box)
    ]
    rows = (planes, 7), (balls, 5), (boxes, 16)
    packed = tuple(np.array(values).reshape(-1, width) for values, width in rows)
    meshes = [o for o in things if isinstance(o, TriangleMesh)]
    return _pack_leaves(occluders.leaves), _pack_branches(occluders.branches), packed, meshes


def _seen_past(
    meshes: Sequence[TriangleMesh], points: NDArray[np.float64], fine: NDArray[np.float32]
) -> NDArray[np.float32]:
    """What the meshes let through, (n, 4 N) float32; no rows without meshes."""
    if not meshes:
        return np.empty((0, 0), np.float32)
    seen = np.ones((len(points), fine.shape[1]), np.float32)
    for mesh in meshes:
        seen[mesh.blocks_many(points, fine.T)] *= np.float32(mesh.translucency)
    return seen


def _check_points(
    points: ArrayLike, own: ArrayLike | None, n_leaves: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    points = check_array("points", points, (None, 3))
    if own is None:
        return points, np.full(len(points), NO_OWN)
    rows = np.asarray(own)
    if rows.shape != (len(points),) or rows.dtype.kind not in "iu":
        raise InputError(f"own must be integers of shape ({len(points)},), got {rows.dtype} {rows.shape}")
    check_rows(
        "own", rows, (rows >= NO_OWN) & (rows < n_leaves), f"-1 or a row of leaves (0 to {n_leaves - 1})"
    )
    return points, rows.astype(np.int64)
