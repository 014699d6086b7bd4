"""What a virtual scanner looks at: triangles that say what they are, the ground, obstacles, and the wind.

Based on: nothing published. Wind is a stand-in with the right look, not a model of a tree's mechanics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph.errors import InputError
from treegraph.obstacles import Ball, Box, HalfSpace, Obstacle, TriangleMesh

__all__ = [
    "GROUND", "LEAF", "NONE", "OTHER", "PARTS", "WOOD",
    "Scene", "ground_scene", "join_scenes", "make_scene", "obstacle_scene", "sway_in_wind",
]  # fmt: skip

WOOD, LEAF, GROUND, OTHER = 1, 2, 3, 4
PARTS = {WOOD: "wood", LEAF: "leaf", GROUND: "ground", OTHER: "other"}
NONE = -1

BALL_RINGS = 48  # of the polyhedron in the place of a ball: its faces lie at most 0.3% of the radius inside
GROUND_CELL = 0.1  # metres: finest grid of a rough ground
GROUND_CELLS = 400  # most cells along a side of it
GROUND_WAVES = 24
GROUND_WAVELENGTH = (0.3, 3.0)  # metres, shortest and longest wave of a rough ground

WIND_WAVES = 16
WIND_WAVELENGTH = (0.5, 4.0)  # metres: twigs this far apart move differently
WIND_COMMON = 0.5  # share of the variance in which the whole crown moves together
WIND_UP = 1.0 / 3.0  # how far up and down things move for one metre sideways


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles with what each of them is.

    Attributes
    ----------
    vertices : (v, 3) float64
        Metres, z up.
    faces : (f, 3) int32
        Rows of `vertices`, f > 0; both sides reflect.
    part : (f,) uint8
        ``WOOD`` 1, ``LEAF`` 2, ``GROUND`` 3 or ``OTHER`` 4.
    tree_id : (f,) int32
        Number of the tree, -1: none.
    node_id : (f,) int32
        Node of the tree's graph whose segment the triangle belongs to, -1: none.
    sway : (v,) float32
        How far a vertex goes with the wind, 0 (stiff) to 1.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    part: NDArray[np.uint8]
    tree_id: NDArray[np.int32]
    node_id: NDArray[np.int32]
    sway: NDArray[np.float32]

    def __post_init__(self) -> None:
        _check_mesh(self.vertices, self.faces)
        fields = {
            "vertices": np.float64, "faces": np.int32, "part": np.uint8,
            "tree_id": np.int32, "node_id": np.int32, "sway": np.float32,
        }  # fmt: skip
        for name, kind in fields.items():
            array = np.ascontiguousarray(getattr(self, name), kind).view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        n = {"part": len(self.faces), "tree_id": len(self.faces), "node_id": len(self.faces)}
        n["sway"] = len(self.vertices)
        for name, count in n.items():
            if getattr(self, name).shape != (count,):
                raise InputError(f"{name} must have shape ({count},), got {getattr(self, name).shape}")
        if not np.isin(self.part, list(PARTS)).all():
            raise InputError(f"part must be one of {sorted(PARTS)}, got {np.unique(self.part)}")
        if not ((self.sway >= 0.0) & (self.sway <= 1.0)).all():
            raise InputError(f"sway must be 0 to 1, got {self.sway.min()} to {self.sway.max()}")

    def __repr__(self) -> str:
        counts = ", ".join(f"{(self.part == k).sum()} {name}" for k, name in PARTS.items())
        return f"<Scene {len(self.faces)} faces: {counts}>"

    def take(self, rows: NDArray) -> Scene:
        """The scene of some faces (index or mask) only."""
        faces = self.faces[rows]
        used, inverse = np.unique(faces, return_inverse=True)
        labels = {name: getattr(self, name)[rows] for name in ("part", "tree_id", "node_id")}
        faces = inverse.reshape(faces.shape)
        return replace(self, vertices=self.vertices[used], faces=faces, sway=self.sway[used], **labels)


def make_scene(
    vertices: ArrayLike,
    faces: ArrayLike,
    part: int | ArrayLike,
    *,
    tree_id: int | ArrayLike = NONE,
    node_id: int | ArrayLike = NONE,
    sway: float | ArrayLike = 0.0,
) -> Scene:
    """A scene of a mesh; labels may be one number for all faces.

    Raises
    ------
    InputError
        If an array has the wrong shape, a vertex is not finite or a face names a vertex that is not there.
    """
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces)
    _check_mesh(vertices, faces)
    label = [np.full(len(faces), k) if np.ndim(k) == 0 else np.asarray(k) for k in (part, tree_id, node_id)]
    bend = np.full(len(vertices), sway) if np.ndim(sway) == 0 else np.asarray(sway)
    return Scene(vertices, faces, label[0], label[1], label[2], bend)


def join_scenes(scenes: Sequence[Scene]) -> Scene:
    """One scene of several, in their order."""
    if not scenes:
        raise InputError("scenes must hold at least one scene, got none")
    first = np.cumsum([0, *(len(scene.vertices) for scene in scenes)])
    faces = [scene.faces + offset for scene, offset in zip(scenes, first, strict=False)]
    columns = {
        name: np.concatenate([getattr(scene, name) for scene in scenes])
        for name in ("vertices", "part", "tree_id", "node_id", "sway")
    }
    return Scene(faces=np.concatenate(faces), **columns)


def ground_scene(
    middle: ArrayLike,
    half_width: float,
    *,
    height: float = 0.0,
    roughness: float = 0.0,
    seed: int | np.random.Generator = 0,
) -> Scene:
    """A square of ground.

    Parameters
    ----------
    middle : (2,) float
        Its middle, x and y, metres.
    half_width : float
        Half the length of its sides, metres, > 0.
    height : float, default 0.0
        Mean z, metres.
    roughness : float, default 0.0
        Standard deviation of the height, metres, >= 0: waves of 0.3 to 3 m in random directions, all of
        the same steepness. The middle keeps its `height`.
    seed : int or numpy.random.Generator, default 0
        Of the roughness.
    """
    if not 0.0 < half_width < np.inf:
        raise InputError(f"half_width must be a positive finite number of metres, got {half_width!r}")
    if not 0.0 <= roughness < np.inf:
        raise InputError(f"roughness must be a finite number of metres >= 0, got {roughness!r}")
    cell = max(GROUND_CELL, 2.0 * half_width / GROUND_CELLS)
    n = 1 if roughness == 0.0 else int(np.ceil(2.0 * half_width / cell))
    side = np.linspace(-half_width, half_width, n + 1)
    x, y = (a.ravel() for a in np.meshgrid(side, side, indexing="ij"))
    flat = np.column_stack([x, y])
    z = np.zeros(len(flat))
    if roughness > 0.0:
        length, turn, phase = _waves(np.random.default_rng(seed), GROUND_WAVES, GROUND_WAVELENGTH)
        wave = 2.0 * np.pi / length * np.array([np.cos(turn), np.sin(turn)])
        share = length / np.sqrt(0.5 * (length**2).sum())
        z = roughness * (np.sin(flat @ wave + phase) @ share - np.sin(phase) @ share)
    low = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.c_[low, low + n + 1, low + n + 2], np.c_[low, low + n + 2, low + 1]])
    return make_scene(np.column_stack([flat + np.asarray(middle, float), z + height]), faces, GROUND)


def obstacle_scene(obstacle: Obstacle, *, near: ArrayLike, reach: float) -> Scene:
    """The surface of an obstacle, labelled ``OTHER``.

    Parameters
    ----------
    obstacle : HalfSpace, Ball, Box or TriangleMesh
        A half-space becomes a square of its plane; a ball becomes a polyhedron whose faces lie at most
        0.3% of its radius inside it. Translucency is not looked at: a laser is stopped.
    near : (3,) float
        A half-space's square has its middle below this point, metres.
    reach : float
        Half the side of that square, metres, > 0.
    """
    if isinstance(obstacle, TriangleMesh):
        return make_scene(obstacle.vertices, obstacle.faces, OTHER)
    if isinstance(obstacle, Box):
        corner = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        quad = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
        faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
        turned = (corner * obstacle.size) @ np.asarray(obstacle.rotation).T
        return make_scene(obstacle.center + turned, faces, OTHER)
    if isinstance(obstacle, Ball):
        return make_scene(*_ball(obstacle), OTHER)
    if not isinstance(obstacle, HalfSpace):
        kind = type(obstacle).__name__
        raise InputError(f"obstacle must be a HalfSpace, Ball, Box or TriangleMesh, got {kind}")
    away = np.eye(3)[int(np.argmin(np.abs(obstacle.normal)))]
    u = np.cross(obstacle.normal, away)
    u /= np.linalg.norm(u)
    v = np.cross(obstacle.normal, u)
    near = np.asarray(near, float)
    foot = near - ((near - obstacle.point) @ obstacle.normal) * obstacle.normal
    corners = [foot + reach * (a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return make_scene(corners, [[0, 1, 2], [0, 2, 3]], OTHER)


def sway_in_wind(scene: Scene, wind: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Where the vertices are at one moment of a windy day.

    Each vertex goes by ``wind * sway`` times a random vector: half of its variance is the same for the
    whole scene (the crown leans), half is a sum of waves of 0.5 to 4 m (neighbouring twigs go together,
    distant ones do not). A vertex of `sway` 1 goes `wind` metres sideways in the root mean square, and a
    third of it up and down. There is no inertia and no elasticity: moments are independent of each other.

    Returns
    -------
    vertices : (v, 3) float64
        Metres.
    """
    length, turn, phase = _waves(rng, WIND_WAVES, WIND_WAVELENGTH)
    up = rng.uniform(-1.0, 1.0, WIND_WAVES)
    flat = np.sqrt(1.0 - up * up)
    wave = 2.0 * np.pi / length * np.array([flat * np.cos(turn), flat * np.sin(turn), up])
    push = rng.normal(size=(WIND_WAVES, 3)) * np.sqrt((1.0 - WIND_COMMON) * 2.0 / WIND_WAVES)
    lean = rng.normal(size=3) * np.sqrt(WIND_COMMON)
    moved = np.array(scene.vertices)
    loose = np.flatnonzero(scene.sway > 0.0)
    away = lean + np.sin(scene.vertices[loose] @ wave + phase) @ push
    away *= np.sqrt([0.5, 0.5, WIND_UP**2])
    moved[loose] += wind * scene.sway[loose, None].astype(np.float64) * away
    return moved


def _waves(
    rng: np.random.Generator, n: int, bounds: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Lengths (metres), directions and phases of n random waves."""
    length = np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]), n))
    return length, rng.uniform(0.0, 2.0 * np.pi, n), rng.uniform(0.0, 2.0 * np.pi, n)


def _ball(ball: Ball) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of a ball of parallels and meridians."""
    n, m = BALL_RINGS, 2 * BALL_RINGS
    polar, turn = np.pi * np.arange(1, n) / n, 2.0 * np.pi * np.arange(m) / m
    ring = np.empty((n - 1, m, 3))
    ring[..., 0] = np.sin(polar)[:, None] * np.cos(turn)
    ring[..., 1] = np.sin(polar)[:, None] * np.sin(turn)
    ring[..., 2] = np.cos(polar)[:, None]
    vertices = np.concatenate([[[0.0, 0, 1]], ring.reshape(-1, 3), [[0.0, 0, -1]]])
    k, after = np.arange(m), (np.arange(m) + 1) % m
    low = 1 + m * np.arange(n - 2)[:, None]
    a, b, c, d = (low + k).ravel(), (low + after).ravel(), (low + m + k).ravel(), (low + m + after).ravel()
    last = 1 + m * (n - 2)
    caps = [np.c_[0 * k, 1 + k, 1 + after], np.c_[0 * k + len(vertices) - 1, last + after, last + k]]
    return ball.center + ball.radius * vertices, np.concatenate([np.c_[a, c, d], np.c_[a, d, b], *caps])


def _check_mesh(vertices: NDArray, faces: NDArray) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or len(vertices) == 0:
        raise InputError(f"vertices must have shape (n, 3) with n > 0, got {vertices.shape}")
    if not np.isfinite(vertices).all():
        bad = (~np.isfinite(vertices)).any(axis=1).sum()
        raise InputError(f"vertices must be finite, got {bad} rows that are not")
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0 or faces.dtype.kind not in "iu":
        raise InputError(f"faces must have shape (f, 3) with f > 0, got {faces.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            f"faces must name rows of the {len(vertices)} vertices, got {faces.min()} to {faces.max()}"
        )
