"""Where a virtual scanner stands, drives or flies, and in which directions it looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph.errors import InputError

__all__ = ["Sweep", "airborne_sweeps", "mobile_sweep", "station_sweeps", "stations_around"]

MIN_STEP, MAX_STEP = 1e-5, np.pi / 4.0  # radians between neighbouring rays
FOOT_SHARE = 0.1  # of a mesh's height: what lies lower is its foot
MAX_LINES = 1_000_000  # of a track or a strip: about 100 bytes each


@dataclass(frozen=True, eq=False)
class Sweep:
    """Scan lines of one set-up of a scanner.

    Ray i of line l leaves ``origin[l]`` towards ``cos(angle[i]) first[l] + sin(angle[i]) second[l]``.

    Attributes
    ----------
    origin : (l, 3) float64
        Where the scanner is during a line, metres.
    first, second : (l, 3) float64
        Unit vectors at right angles: the plane of a line.
    angle : (k,) float64
        Radians, the same in every line.
    """

    origin: NDArray[np.float64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    angle: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.origin)
        for name in ("origin", "first", "second", "angle"):
            array = np.ascontiguousarray(getattr(self, name), np.float64).view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
            if name != "angle" and array.shape != (n, 3):
                raise InputError(f"{name} must have shape ({n}, 3) to match origin, got {array.shape}")
            if not np.isfinite(array).all():
                raise InputError(f"{name} must be finite")
        if self.angle.ndim != 1:
            raise InputError(f"angle must have shape (k,), got {self.angle.shape}")

    @property
    def n_lines(self) -> int:
        """Number of lines."""
        return len(self.origin)

    @property
    def n_rays(self) -> int:
        """Number of rays."""
        return self.n_lines * len(self.angle)


def station_sweeps(target: ArrayLike, stations: ArrayLike, step: float) -> list[Sweep]:
    """Terrestrial stations: a regular grid of azimuth and elevation, aimed at a target.

    Parameters
    ----------
    target : (v, 3) float
        Only the window of angles in which a station can see these vertices is scanned, metres.
    stations : (s, 3) float
        Where the scanners stand, metres.
    step : float
        Angle between neighbouring rays in azimuth and in elevation, radians, 1e-5 to pi / 4. As with a
        real instrument the rays crowd together towards the zenith.

    Returns
    -------
    sweeps : list of Sweep
        One for each station; a line is an upright column.
    """
    target = _points("target", target)
    stations = _points("stations", np.atleast_2d(np.asarray(stations, np.float64)))
    _check_step(step)
    sweeps = []
    for station in stations:
        azimuth, elevation = _window(target, station, step)
        first = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(azimuth.size)])
        second = np.tile([0.0, 0.0, 1.0], (azimuth.size, 1))
        sweeps.append(Sweep(np.tile(station, (azimuth.size, 1)), first, second, elevation))
    return sweeps


def mobile_sweep(track: ArrayLike, *, step: float, spacing: float) -> Sweep:
    """A profile scanner that is carried along a track: full circles across the direction of travel.

    Parameters
    ----------
    track : (m, 3) float
        Corners of the way that the scanner itself takes, m > 1, metres.
    step : float
        Angle between the rays of a profile, radians, 1e-5 to pi / 4.
    spacing : float
        Between neighbouring profiles, metres, > 0: the speed in m/s divided by the profiles a second.

    Returns
    -------
    sweep : Sweep
        A line is a profile; the rays begin at the zenith.
    """
    track = _points("track", track)
    _check_step(step)
    piece = np.diff(track, axis=0)
    length = np.linalg.norm(piece, axis=1)
    if len(track) < 2 or not (length > 0.0).all():
        raise InputError("track must have at least two corners, each away from the one before")
    if np.hypot(piece[:, 0], piece[:, 1]).min() == 0.0:
        raise InputError("track must not run straight up or down")
    _check_positive("spacing", spacing)
    along = np.concatenate([[0.0], np.cumsum(length)])
    n = int(np.floor(min(along[-1] / spacing, MAX_LINES) + 1e-9)) + 1
    if n > MAX_LINES:
        raise InputError(f"spacing must give at most {MAX_LINES} profiles along the track, got {spacing!r}")
    at = np.minimum(np.arange(n) * spacing, along[-1])
    k = np.clip(np.searchsorted(along, at, side="right") - 1, 0, len(piece) - 1)
    ahead = (piece / length[:, None])[k]
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = step * np.arange(int(np.floor(2.0 * np.pi / step)), dtype=np.float64)
    return Sweep(track[k] + (at - along[k])[:, None] * ahead, np.cross(side, ahead), side, angle)


def airborne_sweeps(
    target: ArrayLike,
    *,
    altitude: float,
    density: float,
    scan_angle: float,
    n_strips: int = 1,
    strip_spacing: float = 0.0,
    azimuth: float = 0.0,
    ground: float | None = None,
) -> list[Sweep]:
    """Flight lines over a target.

    Parameters
    ----------
    target : (v, 3) float
        Only the lines and angles between which these vertices are seen are scanned, metres.
    altitude : float
        Above the ground, metres; above all of the target.
    density : float
        Pulses per square metre of flat ground below one flight line, > 0.
    scan_angle : float
        Full angle across the flight line, radians, > 0 and < pi.
    n_strips : int, default 1
        Flight lines side by side; the middle of them passes over the middle of the target.
    strip_spacing : float, default 0.0
        Between flight lines, metres.
    azimuth : float, default 0.0
        Direction of flight, radians from the x axis; every other strip is flown back.
    ground : float, optional
        z of the ground, metres; the lowest vertex by default.

    Returns
    -------
    sweeps : list of Sweep
        One for each strip that can see the target. Lines are as far apart as the pulses in a line are on
        the ground below.
    """
    target = _points("target", target)
    for name, value in (("altitude", altitude), ("density", density)):
        _check_positive(name, value)
    if not 0.0 < scan_angle < np.pi:
        raise InputError(f"scan_angle must be an angle between 0 and pi radians, got {scan_angle!r}")
    if n_strips < 1 or not 0.0 <= strip_spacing < np.inf:
        raise InputError(f"n_strips must be >= 1 and strip_spacing >= 0, got {n_strips!r}, {strip_spacing!r}")
    z = (float(target[:, 2].min()) if ground is None else ground) + altitude
    if z <= target[:, 2].max():
        raise InputError(
            f"altitude must be above the target's {np.ptp(target[:, 2]):.1f} m, got {altitude!r}"
        )
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    side = np.array([-ahead[1], ahead[0], 0.0])
    middle = 0.5 * (target.min(axis=0) + target.max(axis=0))
    along, across = (target - middle) @ ahead, (target - middle) @ side
    gap = 1.0 / np.sqrt(density)
    begin = np.arange(np.floor(along.min() / gap), np.ceil(along.max() / gap) + 1.0) * gap
    if begin.size > MAX_LINES:
        raise InputError(f"density must give at most {MAX_LINES} lines over the target, got {density!r}")
    sweeps = []
    for k in range(n_strips):
        offset = (k - 0.5 * (n_strips - 1)) * strip_spacing
        way = 1.0 if k % 2 == 0 else -1.0
        seen = np.arctan2(way * (across - offset), z - target[:, 2])
        angle = _multiples(seen.min(), seen.max(), gap / altitude)
        angle = angle[np.abs(angle) <= 0.5 * scan_angle + 1e-12]
        if angle.size:
            place = begin if way > 0.0 else begin[::-1]
            origin = middle * [1.0, 1.0, 0.0] + offset * side + place[:, None] * ahead + [0.0, 0.0, z]
            down, left = np.array([0.0, 0.0, -1.0]), way * side
            n = begin.size
            sweeps.append(Sweep(origin, np.tile(down, (n, 1)), np.tile(left, (n, 1)), angle))
    if not sweeps:
        raise InputError("no flight line sees the target; fly nearer, or widen scan_angle")
    return sweeps


def stations_around(
    vertices: NDArray, n_stations: int, *, distance: float, height: float = 1.6, azimuth: float = 0.0
) -> NDArray[np.float64]:
    """Stations on a circle around the foot of a mesh.

    Parameters
    ----------
    vertices : (v, 3) float
        Metres, z up.
    n_stations : int
        >= 1.
    distance : float
        From the middle of the lowest tenth of the mesh's height, metres, > 0.
    height : float, default 1.6
        Above the lowest vertex, metres.
    azimuth : float, default 0.0
        Direction of the first station, radians from the x axis.

    Returns
    -------
    stations : (n_stations, 3) float64
        Metres.
    """
    vertices = np.asarray(vertices, np.float64)
    if n_stations < 1:
        raise InputError(f"n_stations must be at least 1, got {n_stations!r}")
    _check_positive("distance", distance)
    z = vertices[:, 2]
    foot = vertices[z <= z.min() + FOOT_SHARE * np.ptp(z)]
    middle = 0.5 * (foot.min(axis=0) + foot.max(axis=0))
    angle = azimuth + 2.0 * np.pi * np.arange(n_stations) / n_stations
    return np.column_stack(
        [
            middle[0] + distance * np.cos(angle),
            middle[1] + distance * np.sin(angle),
            np.full(n_stations, z.min() + height),
        ]
    )


def _points(name: str, value: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(value, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise InputError(f"{name} must have shape (n, 3) with n > 0, got {array.shape}")
    if not np.isfinite(array).all():
        bad = (~np.isfinite(array)).any(axis=1).sum()
        raise InputError(f"{name} must be finite, got {bad} rows that are not")
    return array


def _check_step(step: float) -> None:
    if not MIN_STEP <= step <= MAX_STEP:
        raise InputError(f"step must be an angle between 1e-5 and pi / 4 radians, got {step!r}")


def _check_positive(name: str, value: float) -> None:
    if not 0.0 < value < np.inf:
        raise InputError(f"{name} must be a positive finite number, got {value!r}")


def _window(
    vertices: NDArray[np.float64], station: NDArray[np.float64], step: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuths and elevations, multiples of `step`, that hold every vertex seen from the station."""
    gap = vertices - station
    flat = np.hypot(gap[:, 0], gap[:, 1])
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    if ((station[:2] >= low) & (station[:2] <= high)).all():  # the mesh may be anywhere around it
        n, k = int(np.floor(2.0 * np.pi / step)), int(np.floor(np.pi / 2.0 / step))
        return step * np.arange(n, dtype=np.float64), step * np.arange(-k, k + 1, dtype=np.float64)
    to_middle = 0.5 * (low + high) - station[:2]
    middle = np.arctan2(to_middle[1], to_middle[0])
    turn = np.arctan2(gap[:, 1], gap[:, 0]) - middle
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi  # outside the box no vertex is behind the station
    reach = middle + np.array([turn.min(), turn.max()])
    # Seen from between its heights, a triangle may rise above all its corners: there the box is the bound.
    elevation = np.arctan2(gap[:, 2], flat)
    nearest = float(np.linalg.norm(np.maximum(np.maximum(low - station[:2], station[:2] - high), 0.0)))
    bottom, top = float(gap[:, 2].min()), float(gap[:, 2].max())
    below = float(np.arctan2(bottom, nearest)) if bottom < 0.0 else float(elevation.min())
    above = float(np.arctan2(top, nearest)) if top > 0.0 else float(elevation.max())
    return _multiples(reach[0], reach[1], step), _multiples(below, above, step)


def _multiples(low: float, high: float, step: float) -> NDArray[np.float64]:
    return step * np.arange(int(np.floor(low / step)), int(np.ceil(high / step)) + 1, dtype=np.float64)
