"""A virtual laser scanner: what an instrument would measure of a scene of triangles, and the truth with it.

Based on: nothing published line by line; the geometry of time-of-flight scanners as their data sheets give
it (exit diameter, divergence, range noise, pulse length, returns).
Departs from a real instrument in: only geometry is modelled. There is no radiometry (no intensity, no loss
at grazing incidence or far away), surfaces are opaque, and directions are exact.

A beam is a bundle of sub-rays over its footprint, weighted as a Gaussian beam. Each sub-ray ends at the
first surface. Sorted by range, the hits form one return for as long as the gap to the next is not above the
pulse's separation: the return lies at their weighted mean, along the middle of the beam. That is what puts
points between two surfaces at the edges of a real scan. Hits farther apart are returns of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recon.scan_paths import Sweep, station_sweeps, stations_around
from recon.scan_scenes import OTHER, Scene, make_scene, sway_in_wind
from treegraph.errors import InputError

__all__ = ["Beam", "Scan", "scan_mesh", "scan_scene", "stations_around"]

RAYS_PER_CHUNK = 1_000_000  # sub-rays; bounds the memory: about 250 bytes each
DEFAULT_MAX_RANGE = 120.0
WIND_MOMENTS = 8  # of a sweep: its lines take turns in showing the scene at so many moments
NO_HIT = 2**32 - 1  # the ray caster's own mark
GOLDEN_ANGLE = 2.399963229728653  # radians from the footprint of one beam to the next: no pattern repeats
MAX_RINGS = 8
REFINED = 1e-4  # of the distance: how far the exact plane may move what the ray caster found


@dataclass(frozen=True)
class Beam:
    """The instrument.

    Attributes
    ----------
    noise : float
        Standard deviation of the range, metres, >= 0.
    divergence : float
        Full angle of the beam's cone (1/e^2), radians, 0 to 0.1.
    exit_diameter : float
        Diameter of the beam where it leaves the instrument (1/e^2), metres, 0 to 1.
    rings : int
        Rings of sub-rays around the middle one, 1 to 8: 7, 19, 37 ... sub-rays. Not used by a beam without
        a footprint (no divergence and no diameter), which is one ray.
    separation : float
        Surfaces whose gap along the beam is at most this melt into one return, metres, >= 0. For a pulse of
        duration T it is c T / 2; infinite for a phase-shift scanner, which averages all it sees.
    n_returns : int
        Returns that are kept of a pulse, the nearest first, 1 to 15.
    detection : float
        Share of the beam's energy that a return needs, 0 to 1.
    min_range, max_range : float
        Surfaces nearer or farther are not measured (they still hide what is behind them), metres,
        0 <= `min_range` < `max_range`.
    """

    noise: float = 0.0
    divergence: float = 0.0
    exit_diameter: float = 0.0
    rings: int = 1
    separation: float = 0.3
    n_returns: int = 1
    detection: float = 0.1
    min_range: float = 0.0
    max_range: float = DEFAULT_MAX_RANGE

    def __post_init__(self) -> None:
        rules = (
            ("noise", 0.0 <= self.noise < np.inf, "be a finite number of metres >= 0"),
            ("divergence", 0.0 <= self.divergence <= 0.1, "be an angle from 0 to 0.1 radians"),
            ("exit_diameter", 0.0 <= self.exit_diameter <= 1.0, "be 0 to 1 metres"),
            ("rings", 1 <= self.rings <= MAX_RINGS, f"be 1 to {MAX_RINGS}"),
            ("separation", self.separation >= 0.0, "be a number of metres >= 0"),
            ("n_returns", 1 <= self.n_returns <= 15, "be 1 to 15"),
            ("detection", 0.0 <= self.detection <= 1.0, "be 0 to 1"),
            ("min_range", 0.0 <= self.min_range < np.inf, "be a finite number of metres >= 0"),
            ("max_range", self.max_range > self.min_range, "be a positive number of metres above min_range"),
        )
        for name, good, rule in rules:
            if not good:
                raise InputError(f"{name} must {rule}, got {getattr(self, name)!r}")

    @property
    def has_footprint(self) -> bool:
        """Whether the beam has any width."""
        return self.divergence > 0.0 or self.exit_diameter > 0.0

    def sub_rays(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Radius (0 to 1), angle and weight (sum 1) of the sub-rays in the beam's cross-section."""
        if not self.has_footprint:
            return np.zeros(1), np.zeros(1), np.ones(1)
        count = np.array([1, *(6 * k for k in range(1, self.rings + 1))])
        ring = np.repeat(np.arange(self.rings + 1), count)
        place = np.arange(len(ring)) - np.repeat(np.cumsum(count) - count, count)
        radius = ring / (self.rings + 0.5)
        area = np.where(ring == 0, 0.25, 2.0 * ring) / count[ring]
        weight = area * np.exp(-2.0 * radius**2)
        return radius, 2.0 * np.pi * (place + 0.5 * (ring % 2)) / count[ring], weight / weight.sum()


@dataclass(frozen=True, eq=False)
class Scan:
    """Points with the truth of each: n rows, by sweep, ray and return.

    Attributes
    ----------
    xyz : (n, 3) float64
        Metres, in the scene's coordinates.
    part : (n,) uint8
        What was hit: 1 wood, 2 leaf, 3 ground, 4 other. Of a mixed return, as all labels, that of the
        strongest sub-ray, the nearest among equals.
    tree_id, node_id : (n,) int32
        Tree and node of its graph that were hit, -1: none.
    face : (n,) int32
        Triangle of the scene that was hit.
    station : (n,) int32
        The sweep, from 0.
    ray : (n,) int64
        Number of the ray, counted over all sweeps.
    return_number, n_returns : (n,) uint8
        Which of how many returns of its pulse, from 1.
    distance : (n,) float64
        Measured range, metres, noise included.
    spread : (n,) float32
        Range from the nearest to the farthest hit in the return, metres: 0 without a footprint, large
        where the point lies between two surfaces.
    n_rays : int
        Rays that were fired.
    """

    xyz: NDArray[np.float64]
    part: NDArray[np.uint8]
    tree_id: NDArray[np.int32]
    node_id: NDArray[np.int32]
    face: NDArray[np.int32]
    station: NDArray[np.int32]
    ray: NDArray[np.int64]
    return_number: NDArray[np.uint8]
    n_returns: NDArray[np.uint8]
    distance: NDArray[np.float64]
    spread: NDArray[np.float32]
    n_rays: int

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "n_rays":
                getattr(self, field.name).flags.writeable = False

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"<Scan {len(self)} points of {self.n_rays} rays>"


def scan_scene(
    scene: Scene,
    sweeps: Sequence[Sweep],
    beam: Beam | None = None,
    *,
    seed: int | np.random.Generator = 0,
    wind: float = 0.0,
    rays_per_chunk: int = RAYS_PER_CHUNK,
    watch: Callable[[int], object] | None = None,
) -> Scan:
    """What a scanner measures of a scene.

    Parameters
    ----------
    scene : Scene
    sweeps : sequence of Sweep
        Stations, a track or flight lines: ``station_sweeps``, ``mobile_sweep``, ``airborne_sweeps``.
    beam : Beam, optional
        The instrument; by default a single ray without noise.
    seed : int or numpy.random.Generator, default 0
        Of noise and wind. The same seed gives the same bytes, whatever `rays_per_chunk` is.
    wind : float, default 0.0
        Root mean square of how far a vertex of sway 1 is from its rest, sideways, metres, >= 0. Each sweep
        sees the scene at eight independent moments, and its lines take turns: neighbouring lines see a twig
        in different places, as a scanner does that needs some time for a line. See ``sway_in_wind``.
    rays_per_chunk : int
        Sub-rays cast at once; bounds the memory.
    watch : function of int, optional
        Called after each chunk with the number of rays done.

    Returns
    -------
    scan : Scan
        May have no points.

    Raises
    ------
    InputError
        If a number is out of its range, or there is no sweep.

    Notes
    -----
    Rays are traced in float32 near the middle of the scene, and what they hit is computed once more in
    float64 with the plane of the triangle: without noise and footprint a point is on its triangle to about
    1e-9 m, but which of two triangles was hit may be wrong within 1e-6 m of their common edge.
    """
    beam = beam or Beam()
    if not 0.0 <= wind < np.inf:
        raise InputError(f"wind must be a finite number of metres >= 0, got {wind!r}")
    if rays_per_chunk < 1:
        raise InputError(f"rays_per_chunk must be at least 1, got {rays_per_chunk!r}")
    if not sweeps:
        raise InputError("sweeps must hold at least one station, track or strip, got none")
    rng = np.random.default_rng(seed)
    gusts = rng.spawn(1)[0] if wind > 0.0 else None
    still = _Caster(scene.vertices, scene.faces) if gusts is None else None
    found: list[dict[str, NDArray]] = []
    first = done = 0
    for station, sweep in enumerate(sweeps):
        rows: list[dict[str, NDArray]] = []
        for caster, lines in _moments(scene, sweep, still, wind, gusts):
            for ray in _chunks(lines, len(sweep.angle), beam, rays_per_chunk):
                row = _fire(caster, sweep, ray, beam)
                if beam.noise > 0.0:
                    row["distance"] += rng.normal(0.0, beam.noise, row["distance"].size)
                row["station"] = np.full(row["ray"].size, station, np.int32)
                rows.append(row)
                done += ray.size
                if watch is not None:
                    watch(done)
        found.append(_put_in_order(rows, sweep, first))
        first += sweep.n_rays
    return _as_scan(scene, found, first)


def scan_mesh(
    vertices: ArrayLike,
    faces: ArrayLike,
    stations: ArrayLike,
    *,
    step: float,
    noise: float = 0.0,
    seed: int | np.random.Generator = 0,
    max_range: float = DEFAULT_MAX_RANGE,
    rays_per_chunk: int = RAYS_PER_CHUNK,
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Points on a mesh as scanners at some stations measure them, with beams of no width.

    Parameters
    ----------
    vertices : (v, 3) float
        Metres, z up.
    faces : (f, 3) int
        Triangles; both sides reflect.
    stations : (s, 3) float
        Where the scanners stand, metres.
    step, noise, seed, max_range, rays_per_chunk
        As of ``station_sweeps``, ``Beam`` and ``scan_scene``.

    Returns
    -------
    points : (n, 3) float64
        Metres, station by station; n may be 0.
    face : (n,) int32
        The triangle that each point was measured on.

    Raises
    ------
    InputError
        If an array has the wrong shape or is not finite, or a number is out of range.
    """
    scene = make_scene(vertices, faces, OTHER)
    sweeps = station_sweeps(scene.vertices, stations, step)
    beam = Beam(noise=noise, max_range=max_range)
    scan = scan_scene(scene, sweeps, beam, seed=seed, rays_per_chunk=rays_per_chunk)
    return scan.xyz, scan.face


class _Caster:
    """Triangles ready for rays: in single precision around their middle, their planes in double."""

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        import open3d

        tensor: Any = open3d.core.Tensor
        self._tensor = tensor
        used = vertices if len(vertices) <= 3 * len(faces) else vertices[np.unique(faces)]
        self.middle = 0.5 * (used.min(axis=0) + used.max(axis=0))
        local = vertices - self.middle
        self.reach = float(np.sqrt((local**2).sum(axis=1).max()))
        corner = local[faces[:, 0]]
        normal = np.cross(local[faces[:, 1]] - corner, local[faces[:, 2]] - corner)
        self.plane = np.column_stack([normal, np.einsum("ij,ij->i", normal, corner)])
        self._scene: Any = open3d.t.geometry.RaycastingScene()
        single: Any = local.astype(np.float32)
        index: Any = faces.astype(np.uint32)
        self._scene.add_triangles(self._tensor(single), self._tensor(index))

    def cast(
        self, start: NDArray[np.float64], way: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Parameter along `way` (k, 3), inf without a hit, and triangle (k,) of rays from `start` (k, 3)."""
        start = start - self.middle
        far = np.einsum("ij,ij->i", start, start).max(initial=0.0) > 4.0 * self.reach**2
        skip = np.zeros(len(start))
        if far:  # begin where the scene may begin: single precision has no digits for the way there
            skip = np.maximum(-np.einsum("ij,ij->i", start, way) - self.reach, 0.0)
        both = np.empty((len(start), 6), np.float32)
        both[:, :3] = start + skip[:, None] * way if far else start
        both[:, 3:] = way
        answer = self._scene.cast_rays(self._tensor(both))
        t = answer["t_hit"].numpy().astype(np.float64) + skip
        face = answer["primitive_ids"].numpy()
        hit = np.flatnonzero(face != NO_HIT)
        plane = self.plane[face[hit]]
        begin, along = start[hit], way[hit]
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = (plane[:, 3] - np.einsum("ij,ij->i", plane[:, :3], begin)) / np.einsum(
                "ij,ij->i", plane[:, :3], along
            )
            good = np.abs(exact - t[hit]) <= REFINED * (1.0 + t[hit])
        t[hit[good]] = exact[good]
        return t, face.astype(np.int64)


def _moments(
    scene: Scene, sweep: Sweep, still: _Caster | None, wind: float, gusts: np.random.Generator | None
) -> Iterator[tuple[_Caster, NDArray[np.int64]]]:
    """The scene at each moment of a sweep, and the lines that see it then."""
    if still is not None or gusts is None:
        yield still or _Caster(scene.vertices, scene.faces), np.arange(sweep.n_lines)
        return
    for k in range(WIND_MOMENTS):
        moved = sway_in_wind(scene, wind, gusts)
        lines = np.arange(k, sweep.n_lines, WIND_MOMENTS)
        if lines.size:
            yield _Caster(moved, scene.faces), lines


def _chunks(
    lines: NDArray[np.int64], n_angles: int, beam: Beam, rays_per_chunk: int
) -> Iterator[NDArray[np.int64]]:
    """Numbers of the rays of some lines, so many at a time that their sub-rays fit into a chunk."""
    size = max(1, rays_per_chunk // len(beam.sub_rays()[0]))
    total = lines.size * n_angles
    for begin in range(0, total, size):
        k = np.arange(begin, min(begin + size, total))
        row = k // n_angles
        yield lines[row] * n_angles + (k - row * n_angles)


def _fire(caster: _Caster, sweep: Sweep, ray: NDArray[np.int64], beam: Beam) -> dict[str, NDArray]:
    """The returns of some rays of a sweep, by ray and range; without noise."""
    line = ray // len(sweep.angle)
    angle = sweep.angle[ray - line * len(sweep.angle)]
    cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
    first, second, start = sweep.first[line], sweep.second[line], sweep.origin[line]
    way = cos * first + sin * second
    radius, turn, weight = beam.sub_rays()
    n = len(radius)
    if n == 1:
        t, face = caster.cast(start, way)
        hit = np.flatnonzero((t >= beam.min_range) & (t <= beam.max_range))
        one = np.ones(hit.size, np.uint8)
        return {
            "ray": ray[hit], "distance": t[hit], "face": face[hit], "return_number": one, "n_returns": one,
            "spread": np.zeros(hit.size, np.float32),
        }  # fmt: skip
    across, beside = cos * second - sin * first, np.cross(first, second)
    spin = turn + (ray * GOLDEN_ANGLE % (2.0 * np.pi))[:, None]
    off = (radius * np.cos(spin))[..., None] * across[:, None]
    off += (radius * np.sin(spin))[..., None] * beside[:, None]
    begin = start[:, None] + 0.5 * beam.exit_diameter * off
    along = way[:, None] + np.tan(0.5 * beam.divergence) * off
    t, face = caster.cast(begin.reshape(-1, 3), along.reshape(-1, 3))
    t[(t < beam.min_range) | (t > beam.max_range)] = np.inf
    return _returns(ray, t.reshape(-1, n), face.reshape(-1, n), weight, beam)


def _returns(
    ray: NDArray[np.int64], t: NDArray[np.float64], face: NDArray[np.int64], weight: NDArray, beam: Beam
) -> dict[str, NDArray]:
    """Sub-rays (m, n) become returns: hits, in the order of their range, with no gap above the separation."""
    any_hit = np.flatnonzero(np.isfinite(t).any(axis=1))
    t, ray = t[any_hit], ray[any_hit]
    order = np.argsort(t, axis=1, kind="stable")
    t = np.take_along_axis(t, order, axis=1)
    face = np.take_along_axis(face[any_hit], order, axis=1)
    m, n = t.shape
    hit = np.isfinite(t)
    gap = np.zeros_like(t)
    np.subtract(t[:, 1:], t[:, :-1], out=gap[:, 1:], where=hit[:, 1:])
    begins = gap > beam.separation
    key = np.arange(m)[:, None] * n + np.cumsum(begins, axis=1)
    energy = np.where(hit, weight[order], 0.0)
    share = np.bincount(key.ravel(), energy.ravel(), minlength=m * n)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(key.ravel(), (energy * np.where(hit, t, 0.0)).ravel(), m * n) / share
    near, far = np.full(m * n, np.inf), np.zeros(m * n)
    best, label = np.zeros(m * n), np.zeros(m * n, np.int64)
    for k in range(n):
        row = np.flatnonzero(hit[:, k])
        at = key[row, k]
        near[at], far[at] = np.minimum(near[at], t[row, k]), t[row, k]
        better = energy[row, k] > best[at]
        best[at[better]], label[at[better]] = energy[row[better], k], face[row[better], k]
    seen = ((share > 0.0) & (share >= beam.detection * (1.0 - 1e-12))).reshape(m, n)
    rank = np.cumsum(seen, axis=1)
    kept = np.flatnonzero((seen & (rank <= beam.n_returns)).ravel())
    owner = kept // n
    return {
        "ray": ray[owner], "distance": mean[kept], "face": label[kept],
        "return_number": rank.ravel()[kept].astype(np.uint8),
        "n_returns": np.minimum(rank[:, -1], beam.n_returns)[owner].astype(np.uint8),
        "spread": (far - near)[kept].astype(np.float32),
    }  # fmt: skip


def _put_in_order(rows: list[dict[str, NDArray]], sweep: Sweep, first: int) -> dict[str, NDArray]:
    """The returns of a sweep by ray, with their places; `first` is the number of its first ray."""
    empty = {"ray": np.empty(0, np.int64), "distance": np.empty(0), "face": np.empty(0, np.int64)}
    empty |= {name: np.empty(0, np.uint8) for name in ("return_number", "n_returns")}
    empty |= {"spread": np.empty(0, np.float32), "station": np.empty(0, np.int32)}
    found = {name: np.concatenate([none, *(row[name] for row in rows)]) for name, none in empty.items()}
    if (np.diff(found["ray"]) < 0).any():  # the moments of wind take turns
        order = np.argsort(found["ray"], kind="stable")
        found = {name: column[order] for name, column in found.items()}
    ray = found["ray"]
    line = ray // max(len(sweep.angle), 1)
    angle = sweep.angle[ray - line * len(sweep.angle)]
    way = np.cos(angle)[:, None] * sweep.first[line] + np.sin(angle)[:, None] * sweep.second[line]
    found["xyz"] = sweep.origin[line] + found["distance"][:, None] * way
    found["ray"] = ray + first
    return found


def _as_scan(scene: Scene, found: list[dict[str, NDArray]], n_rays: int) -> Scan:
    names = ("xyz", "face", "station", "ray", "return_number", "n_returns", "distance", "spread")
    column = {name: np.concatenate([row[name] for row in found]) for name in names}
    face = column["face"] = column["face"].astype(np.int32)
    labels = {name: np.array(getattr(scene, name)[face]) for name in ("part", "tree_id", "node_id")}
    return Scan(**column, **labels, n_rays=n_rays)
