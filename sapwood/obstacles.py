"""Obstacles as the command line names them: walls, boxes, balls and meshes in a tree's way."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from treegraph.errors import InputError

if TYPE_CHECKING:
    from treegraph.obstacles import Obstacle

__all__ = ["OBSTACLES", "parse_obstacle"]

OBSTACLES = "wall:x=1.5, box:x,y,z,dx,dy,dz, sphere:x,y,z,r or mesh:FILE"
"""What :func:`parse_obstacle` reads, for help texts and messages."""


def parse_obstacle(text: str) -> Obstacle:
    """Read one obstacle; the foot of the tree is (0, 0, 0), lengths are metres.

    ``wall:x=1.5``
        Everything beyond the plane x = 1.5 is solid: the side away from the tree. Also ``y=``, and
        negative numbers.
    ``box:x,y,z,dx,dy,dz``
        A solid box: its corner with the least coordinates, and its three edges.
    ``sphere:x,y,z,r``
        A solid ball: its middle and its radius.
    ``mesh:FILE``
        The triangles of a GLB (y up), OBJ or PLY (z up) file.

    Raises
    ------
    InputError
        If `text` is none of these, or the file of a mesh cannot be read.

    Examples
    --------
    >>> parse_obstacle("wall:x=1.5").normal.tolist()
    [-1.0, 0.0, 0.0]
    >>> parse_obstacle("box:2,-1,0,0.5,2,3").center.tolist()
    [2.25, 0.0, 1.5]
    """
    kind, colon, rest = text.partition(":")
    readers: dict[str, Callable[[str, str], Obstacle]] = {
        "wall": _wall,
        "box": _box,
        "sphere": _sphere,
        "mesh": _mesh,
    }
    reader = readers.get(kind.strip().lower())
    if reader is None or not colon:
        raise InputError(f"an obstacle must be {OBSTACLES}, got {text!r}")
    return reader(rest.strip(), text)


def _numbers(rest: str, text: str, names: str) -> list[float]:
    """As many finite numbers as there are names, or an error that shows them."""
    try:
        numbers = [float(part) for part in rest.split(",")]
    except ValueError:
        numbers = []
    count = len(names.split(","))
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise InputError(f"{text!r} must have {count} finite numbers {names}")
    return numbers


def _wall(rest: str, text: str) -> Obstacle:
    from treegraph import HalfSpace

    axis, equals, value = rest.partition("=")
    axis = axis.strip().lower()
    if axis not in ("x", "y") or not equals:
        raise InputError(f"{text!r} must say where the wall stands, as in wall:x=1.5 or wall:y=-2")
    (place,) = _numbers(value, text, "x" if axis == "x" else "y")
    if place == 0.0:
        raise InputError(f"{text!r} runs through the foot of the tree; a wall stands beside it")
    point, normal = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    point["xy".index(axis)] = place
    normal["xy".index(axis)] = -math.copysign(1.0, place)
    return HalfSpace(point, normal)  # type: ignore[arg-type]


def _box(rest: str, text: str) -> Obstacle:
    from treegraph import Box

    x, y, z, *size = _numbers(rest, text, "x,y,z,dx,dy,dz")
    if min(size) <= 0.0:
        raise InputError(f"{text!r} must have edges dx,dy,dz > 0")
    center = [low + edge / 2.0 for low, edge in zip((x, y, z), size, strict=True)]
    return Box(center, size)  # type: ignore[arg-type]


def _sphere(rest: str, text: str) -> Obstacle:
    from treegraph import Ball

    x, y, z, radius = _numbers(rest, text, "x,y,z,r")
    if radius <= 0.0:
        raise InputError(f"{text!r} must have a radius r > 0")
    return Ball([x, y, z], radius)  # type: ignore[arg-type]


def _mesh(rest: str, text: str) -> Obstacle:
    import numpy as np

    from sapwood.meshes import read_mesh
    from treegraph import TriangleMesh

    if not rest:
        raise InputError(f"{text!r} must name a file, as in mesh:house.obj")
    parts = read_mesh(rest)
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + offset for part, offset in zip(parts, first, strict=False)]
    return TriangleMesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))
