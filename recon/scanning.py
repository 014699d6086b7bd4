"""A virtual terrestrial laser scanner: what stations around a mesh would measure of it.

A model of the instrument's geometry, not of its optics: one ray per step of a regular grid of azimuth and
elevation, the first surface that it hits, and Gaussian noise along the ray. There is no beam width, so
no points between two surfaces, no intensity and no limit on the angle of incidence.
"""

from __future__ import annotations

from typing import Any

import numpy as np

RAYS_PER_CHUNK = 1_000_000  # bounds the memory: about 100 bytes a ray
DEFAULT_MAX_RANGE = 120.0
NO_HIT = 2**32 - 1  # the ray caster's own mark


def scan_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    stations: np.ndarray,
    *,
    step: float,
    noise: float = 0.0,
    seed: int | np.random.Generator = 0,
    max_range: float = DEFAULT_MAX_RANGE,
    rays_per_chunk: int = RAYS_PER_CHUNK,
) -> tuple[np.ndarray, np.ndarray]:
    """Points on a mesh as scanners at some stations measure them.

    Parameters
    ----------
    vertices : (v, 3) float
        Metres, z up.
    faces : (f, 3) int
        Triangles; both sides reflect.
    stations : (s, 3) float
        Where the scanners stand, metres.
    step : float
        Angle between neighbouring rays in azimuth and in elevation, radians, > 0. As with a real
        instrument the rays crowd together towards the zenith.
    noise : float, default 0.0
        Standard deviation of the measured distance, metres, >= 0.
    seed : int or numpy.random.Generator, default 0
        Of the noise. The same seed gives the same bytes, whatever `rays_per_chunk` is.
    max_range : float, default 120.0
        Surfaces farther away than this are not measured, metres, > 0.
    rays_per_chunk : int
        Rays cast at once; bounds the memory.

    Returns
    -------
    points : (n, 3) float64
        Metres, station by station; n may be 0.
    face : (n,) int32
        The triangle that each point was measured on.

    Raises
    ------
    ValueError
        If an array has the wrong shape or is not finite, or a number is out of range.

    Notes
    -----
    Only the window of angles in which a station can see the mesh is scanned. Rays are traced in
    float32 around the middle of the mesh: a point lies within about 1e-6 of its distance to the surface.
    """
    vertices, faces, stations = _check_arrays(vertices, faces, stations)
    _check_numbers(step, noise, max_range, rays_per_chunk)
    rng = np.random.default_rng(seed)
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    scene = _scene(vertices - middle, faces)
    points: list[np.ndarray] = [np.empty((0, 3))]
    hit_faces: list[np.ndarray] = [np.empty(0, np.int32)]
    for station in stations - middle:
        azimuth, elevation = _window(vertices - middle, station, step)
        rows = max(1, rays_per_chunk // max(1, elevation.size))
        for first in range(0, azimuth.size, rows):
            ray = _directions(azimuth[first : first + rows], elevation)
            distance, face = _cast(scene, station, ray)
            hit = np.flatnonzero((face != NO_HIT) & (distance <= max_range))
            measured = distance[hit].astype(np.float64)
            if noise > 0.0:
                measured = measured + rng.normal(0.0, noise, hit.size)
            points.append(middle + station + measured[:, None] * ray[hit])
            hit_faces.append(face[hit].astype(np.int32))
    return np.concatenate(points), np.concatenate(hit_faces)


def stations_around(
    vertices: np.ndarray, n_stations: int, *, distance: float, height: float = 1.6, azimuth: float = 0.0
) -> np.ndarray:
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
        raise ValueError(f"n_stations must be at least 1, got {n_stations!r}")
    if not distance > 0.0:
        raise ValueError(f"distance must be a positive number of metres, got {distance!r}")
    z = vertices[:, 2]
    foot = vertices[z <= z.min() + 0.1 * np.ptp(z)]
    middle = 0.5 * (foot.min(axis=0) + foot.max(axis=0))
    angle = azimuth + 2.0 * np.pi * np.arange(n_stations) / n_stations
    return np.column_stack(
        [
            middle[0] + distance * np.cos(angle),
            middle[1] + distance * np.sin(angle),
            np.full(n_stations, z.min() + height),
        ]
    )


def _check_arrays(
    vertices: np.ndarray, faces: np.ndarray, stations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices = np.ascontiguousarray(vertices, np.float64)
    stations = np.ascontiguousarray(np.atleast_2d(stations), np.float64)
    faces = np.asarray(faces)
    for name, array in (("vertices", vertices), ("stations", stations)):
        if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
            raise ValueError(f"{name} must have shape (n, 3) with n > 0, got {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError(
                f"{name} must be finite, got {(~np.isfinite(array)).any(axis=1).sum()} rows that are not"
            )
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise ValueError(f"faces must have shape (f, 3) with f > 0, got {faces.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"faces must name rows of the {len(vertices)} vertices, got {faces.min()} to {faces.max()}"
        )
    return vertices, faces, stations


def _check_numbers(step: float, noise: float, max_range: float, rays_per_chunk: int) -> None:
    if not 1e-5 <= step <= np.pi / 4.0:
        raise ValueError(f"step must be an angle between 1e-5 and pi / 4 radians, got {step!r}")
    if not (np.isfinite(noise) and noise >= 0.0):
        raise ValueError(f"noise must be a finite number of metres >= 0, got {noise!r}")
    if not max_range > 0.0:
        raise ValueError(f"max_range must be a positive number of metres, got {max_range!r}")
    if rays_per_chunk < 1:
        raise ValueError(f"rays_per_chunk must be at least 1, got {rays_per_chunk!r}")


def _scene(vertices: np.ndarray, faces: np.ndarray) -> Any:
    import open3d

    tensor: Any = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))
    return scene


def _cast(scene: Any, station: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (k,), inf without a hit, and triangle (k,) of unit rays (k, 3) from a station."""
    import open3d

    tensor: Any = open3d.core.Tensor
    both = np.empty((len(ray), 6), np.float32)
    both[:, :3] = station
    both[:, 3:] = ray
    answer = scene.cast_rays(tensor(both))
    return answer["t_hit"].numpy(), answer["primitive_ids"].numpy()


def _window(vertices: np.ndarray, station: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths and elevations, multiples of `step`, that hold every vertex seen from the station."""
    gap = vertices - station
    flat = np.hypot(gap[:, 0], gap[:, 1])
    low, high = vertices[:, :2].min(axis=0), vertices[:, :2].max(axis=0)
    if ((station[:2] >= low) & (station[:2] <= high)).all():  # the mesh may be anywhere around it
        n = int(np.floor(2.0 * np.pi / step))
        k = np.floor(np.pi / 2.0 / step)
        return np.arange(n) * step, np.arange(-k, k + 1) * step
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


def _multiples(low: float, high: float, step: float) -> np.ndarray:
    return np.arange(np.floor(low / step), np.ceil(high / step) + 1.0) * step


def _directions(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Unit vectors (a e, 3), elevation running fastest."""
    flat, up = np.cos(elevation), np.sin(elevation)
    ray = np.empty((azimuth.size, elevation.size, 3))
    ray[..., 0] = np.cos(azimuth)[:, None] * flat
    ray[..., 1] = np.sin(azimuth)[:, None] * flat
    ray[..., 2] = up
    return ray.reshape(-1, 3)
