"""Solid things that stand in a tree's light: half-spaces, boxes, walls, balls, triangle meshes.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, sections 4.3.2 and 4.4.3 (tree-obstacle interaction).
Departs from it in: shadows are cast along rays; there are no shadow volumes with a range of influence.

Every obstacle answers one question, exactly: which rays from a point run into it? A point inside a solid
obstacle is in its shadow whichever way it looks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph.errors import InputError

__all__ = ["Ball", "Box", "HalfSpace", "Obstacle", "TriangleMesh", "make_wall", "stands_inside"]

ROTATION_TOLERANCE = 1e-9  # how far R R^T may be from the identity
PARALLEL = 1e-300  # a component below this is replaced by it, so that 0 / 0 does not arise in the slab test


def check_array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return a read-only float64 copy of a finite array of the given shape (None: any length)."""
    array = np.array(value, dtype=np.float64, order="C")
    wanted = f"({', '.join('n' if n is None else str(n) for n in shape)}{',' * (len(shape) == 1)})"
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=True)
    ):
        raise InputError(f"{name} must have shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0][0])
        raise InputError(f"{name} must be finite, but {name}[{row}] is {array[row]}")
    array.flags.writeable = False
    return array


def check_unit(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Return a direction (3,) of any length as a read-only unit vector."""
    array = check_array(name, value, (3,))
    length = float(np.linalg.norm(array))
    if length == 0.0:
        raise InputError(f"{name} must be a direction, got the zero vector")
    array = array / length
    array.flags.writeable = False
    return array


def check_share(name: str, value: float) -> float:
    """Return a number from 0 to 1."""
    value = float(value)
    if not 0.0 <= value <= 1.0:
        raise InputError(f"{name} must be from 0 (opaque) to 1 (clear), got {value!r}")
    return value


def check_rows(name: str, values: NDArray, good: NDArray[np.bool_], rule: str) -> None:
    """Name the first row of `values` that is not good."""
    bad = np.flatnonzero(~good)
    if bad.size:
        raise InputError(
            f"{name} must be {rule}, but {name}[{bad[0]}] is {values[bad[0]]}; "
            f"{bad.size} of {len(values)} break this"
        )


def put_fields(self: Any, **values: Any) -> None:
    """Set fields of a frozen dataclass while it is being made."""
    for name, value in values.items():
        object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """Everything behind a plane is solid.

    Attributes
    ----------
    point : (3,) float64
        A point of the plane, metres.
    normal : (3,) float64
        Points out of the solid into the open; any length, kept as a unit vector.
    translucency : float
        Share of the light that passes, 0 (opaque) to 1.
    """

    point: NDArray[np.float64]
    normal: NDArray[np.float64]
    translucency: float = 0.0

    def __post_init__(self) -> None:
        put_fields(
            self,
            point=check_array("point", self.point, (3,)),
            normal=check_unit("normal", self.normal),
            translucency=check_share("translucency", self.translucency),
        )

    def blocks(self, point: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the rays (k, 3) from `point` (3,) run into it, (k,)."""
        if (point - self.point) @ self.normal <= 0.0:
            return np.ones(len(direction), bool)
        return direction @ self.normal < 0.0


@dataclass(frozen=True, eq=False)
class Ball:
    """A solid ball.

    Attributes
    ----------
    center : (3,) float64
        Metres.
    radius : float
        Metres, > 0.
    translucency : float
        Share of the light that passes, 0 (opaque) to 1.
    """

    center: NDArray[np.float64]
    radius: float
    translucency: float = 0.0

    def __post_init__(self) -> None:
        radius = float(self.radius)
        if not 0.0 < radius < math.inf:
            raise InputError(f"radius must be a positive finite number of metres, got {radius!r}")
        put_fields(
            self,
            center=check_array("center", self.center, (3,)),
            radius=radius,
            translucency=check_share("translucency", self.translucency),
        )

    def blocks(self, point: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the rays (k, 3) from `point` (3,) run into it, (k,)."""
        to = self.center - point
        room = to @ to - self.radius**2
        if room <= 0.0:
            return np.ones(len(direction), bool)
        return direction @ to >= math.sqrt(room)


@dataclass(frozen=True, eq=False)
class Box:
    """A solid box, upright or turned.

    Attributes
    ----------
    center : (3,) float64
        Metres.
    size : (3,) float64
        Full lengths of the edges, metres, > 0.
    rotation : (3, 3) float64
        Its columns are the directions of the edges: box to world. Default: along the axes.
    translucency : float
        Share of the light that passes, 0 (opaque) to 1.
    """

    center: NDArray[np.float64]
    size: NDArray[np.float64]
    rotation: NDArray[np.float64] | None = None
    translucency: float = 0.0

    def __post_init__(self) -> None:
        size = check_array("size", self.size, (3,))
        if not (size > 0.0).all():
            raise InputError(f"size must be three positive lengths in metres, got {size}")
        turn = check_array("rotation", np.eye(3) if self.rotation is None else self.rotation, (3, 3))
        if np.abs(turn @ turn.T - np.eye(3)).max() > ROTATION_TOLERANCE:
            raise InputError("rotation must be orthonormal: its columns are the unit directions of the edges")
        put_fields(
            self,
            center=check_array("center", self.center, (3,)),
            size=size,
            rotation=turn,
            translucency=check_share("translucency", self.translucency),
        )

    def blocks(self, point: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the rays (k, 3) from `point` (3,) run into it, (k,)."""
        turn = np.asarray(self.rotation)
        middle, along = (self.center - point) @ turn, direction @ turn
        along = np.where(np.abs(along) < PARALLEL, PARALLEL, along)
        with np.errstate(over="ignore"):
            one, two = (middle - self.size / 2) / along, (middle + self.size / 2) / along
        near, far = np.minimum(one, two).max(axis=1), np.maximum(one, two).min(axis=1)
        return (near <= far) & (far > 0.0)


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Any surface of triangles, seen from both sides; rays are cast with Open3D.

    Attributes
    ----------
    vertices : (v, 3) float64
        Metres. Rays are cast in single precision, relative to the mesh's middle.
    faces : (f, 3) int32
        Rows of `vertices`, f > 0.
    translucency : float
        Share of the light that passes, 0 (opaque) to 1; once per ray, however many triangles it meets.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    translucency: float = 0.0

    def __post_init__(self) -> None:
        vertices = check_array("vertices", self.vertices, (None, 3))
        faces = np.array(self.faces, order="C")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces) or faces.dtype.kind not in "iu":
            raise InputError(
                f"faces must be integers of shape (f, 3), f > 0, got {faces.dtype} {faces.shape}"
            )
        bad = np.flatnonzero((faces < 0).any(axis=1) | (faces >= len(vertices)).any(axis=1))
        if bad.size:
            raise InputError(
                f"faces must be rows of vertices (0 to {len(vertices) - 1}), but faces[{bad[0]}] is "
                f"{faces[bad[0]].tolist()}; {bad.size} of {len(faces)} faces break this"
            )
        faces = faces.astype(np.int32)
        faces.flags.writeable = False
        put_fields(
            self,
            vertices=vertices,
            faces=faces,
            translucency=check_share("translucency", self.translucency),
            _cast=None,  # Open3D's search tree, built at the first ray
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return TriangleMesh, (self.vertices, self.faces, self.translucency)

    def blocks(self, point: NDArray[np.float64], direction: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the rays (k, 3) from `point` (3,) run into it, (k,)."""
        return self.blocks_many(point[None], direction)[0]

    def blocks_many(self, point: NDArray[np.float64], direction: NDArray) -> NDArray[np.bool_]:
        """Which rays run into it: all directions (k, 3) from all points (n, 3), as (n, k)."""
        from open3d import core

        scene, middle = self._scene()
        rays = np.empty((len(point), len(direction), 6), np.float32)
        rays[..., :3] = (point - middle)[:, None]
        rays[..., 3:] = direction
        return scene.test_occlusions(core.Tensor.from_numpy(rays), nthreads=1).numpy()

    def crosses(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which of the straight ways from `start` (n, 3) to `end` (n, 3) lead through a triangle, (n,)."""
        from open3d import core

        scene, middle = self._scene()
        rays = np.empty((len(start), 6), np.float32)
        rays[:, :3] = start - middle
        rays[:, 3:] = end - start
        return scene.test_occlusions(core.Tensor.from_numpy(rays), tfar=1.0, nthreads=1).numpy()

    def _scene(self) -> tuple[Any, NDArray[np.float64]]:
        """Open3D's search tree, built at the first call, and the point about which its rays are cast."""
        from open3d import core, t

        middle = (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2
        scene = self.__dict__["_cast"]
        if scene is None:
            scene = t.geometry.RaycastingScene(nthreads=1)
            local = (self.vertices - middle).astype(np.float32)
            scene.add_triangles(
                core.Tensor.from_numpy(local), core.Tensor.from_numpy(self.faces.astype(np.uint32))
            )
            put_fields(self, _cast=scene)
        return scene, middle


Obstacle = HalfSpace | Ball | Box | TriangleMesh


def stands_inside(obstacle: Obstacle, point: ArrayLike) -> bool:
    """Whether a point is inside a solid obstacle; a mesh may be a room, and is never called solid."""
    if isinstance(obstacle, TriangleMesh):
        return False
    both = np.concatenate([np.eye(3), -np.eye(3)])
    return bool(obstacle.blocks(np.asarray(point, float), both).all())


def make_wall(
    point: Sequence[float], normal: Sequence[float], *, width: float, height: float, thickness: float = 0.2
) -> Box:
    """Return an upright wall as a box.

    Parameters
    ----------
    point : (3,) floats
        Middle of the lower edge of the side that faces the tree, metres.
    normal : (3,) floats
        Direction in which that side faces; horizontal, any length.
    width, height, thickness : float
        Metres, > 0. A wall that is many times as wide as the tree is high acts as an endless one.

    Returns
    -------
    wall : Box
        Stands on the height of `point`, behind it.

    Raises
    ------
    InputError
        If `normal` is not horizontal or a size is not positive.

    Examples
    --------
    >>> make_wall((1.5, 0, 0), (-1, 0, 0), width=40, height=6).center.tolist()
    [1.6, 0.0, 3.0]
    """
    facing = check_unit("normal", normal)
    if abs(facing[2]) > ROTATION_TOLERANCE:
        raise InputError(f"normal must be horizontal for an upright wall, got {tuple(normal)}")
    side = np.array([-facing[1], facing[0], 0.0])
    rotation = np.column_stack([facing, side, (0.0, 0.0, 1.0)])
    center = check_array("point", point, (3,)) - facing * (thickness / 2) + (0.0, 0.0, height / 2)
    return Box(center, np.array([thickness, width, height]), rotation)
