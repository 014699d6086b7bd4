r"""Surroundings of a tree: obstacles, neighbours, light, and how strongly it reacts. And their file.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.4.3 (three types of interaction) and Eq. 4.12 (strength of pruning).
Departs from it in: a strength of bending of our own multiplies the change of the light's direction, so that
whatever it is a tree in the surroundings that it grew in stays as it is.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from treegraph import Ball, Box, FormatError, HalfSpace, InputError, Sky, TriangleMesh
from treegraph.obstacles import check_array, put_fields

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from plastic.analysis import PlasticState
    from treegraph.obstacles import Obstacle

__all__ = [
    "DEFAULT_BENDING",
    "DEFAULT_PRUNING",
    "Neighbour",
    "Scene",
    "SceneFile",
    "SceneTree",
    "parse_scene",
    "read_scene",
]

DEFAULT_BENDING = 1.0
DEFAULT_PRUNING = 0.8
"""c_psi (thesis 4.3.4)."""

STRONGEST = 100.0
MAX_FILE_BYTES = 1_000_000
FARTHEST = 1e9
"""Greatest number of a scene file; metres that are more have lost their millimetres."""
LONGEST_QUOTE = 80  # characters of a value that a message shows
MOST_TREES = 10_000
REQUIRED = object()


@dataclass(frozen=True, eq=False)
class Neighbour:
    """An analysed tree that stands somewhere.

    Attributes
    ----------
    state : PlasticState
    position : (3,) float64
        Where its local origin stands in the scene, metres.
    turn : float
        Angle by which it is turned about the vertical, radians, counter-clockwise seen from above.

    Raises
    ------
    InputError
        If a number is not finite.
    """

    state: PlasticState
    position: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    turn: float = 0.0

    def __post_init__(self) -> None:
        turn = float(self.turn)
        if not math.isfinite(turn):
            raise InputError(f"turn must be a finite angle in radians, got {turn!r}")
        put_fields(self, position=check_array("position", self.position, (3,)), turn=turn)


@dataclass(frozen=True, eq=False)
class Scene:
    """Surroundings, in the frame of the tree that is put there.

    Attributes
    ----------
    obstacles : tuple of HalfSpace, Ball, Box, TriangleMesh
        Solid, but for meshes, which are surfaces. They are there all the tree's life (section 4.4.3).
    neighbours : tuple of Neighbour
        Trees that react too.
    sky : Sky or None
        By default that under which the tree grew.
    bending : float, default 1
        c_phi, 0 to 100: multiplies the change of the light's direction.
    pruning : float, default 0.8
        c_psi of Eq. 4.12, 0 to 100. Above 1 branches fall without any change in the surroundings.

    Raises
    ------
    InputError
        If a part has the wrong type or a number is out of its range.
    """

    obstacles: tuple[Obstacle, ...] = ()
    neighbours: tuple[Neighbour, ...] = ()
    sky: Sky | None = None
    bending: float = DEFAULT_BENDING
    pruning: float = DEFAULT_PRUNING

    def __post_init__(self) -> None:
        obstacles, neighbours = tuple(self.obstacles), tuple(self.neighbours)
        for k, obstacle in enumerate(obstacles):
            if not isinstance(obstacle, HalfSpace | Ball | Box | TriangleMesh):
                raise InputError(
                    "obstacles must be HalfSpace, Ball, Box or TriangleMesh, "
                    f"but obstacles[{k}] is a {type(obstacle).__name__}"
                )
        for k, tree in enumerate(neighbours):
            if not isinstance(tree, Neighbour):
                raise InputError(
                    f"neighbours must be Neighbour, but neighbours[{k}] is a {type(tree).__name__}"
                )
        if self.sky is not None and not isinstance(self.sky, Sky):
            raise InputError(f"sky must be a Sky or None, got {type(self.sky).__name__}")
        for name in ("bending", "pruning"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float | np.number):
                raise InputError(f"{name} must be a number, got {value!r}")
            if not 0.0 <= value <= STRONGEST:
                raise InputError(f"{name} must be from 0 to {STRONGEST:g}, got {value!r}")
            put_fields(self, **{name: float(value)})
        put_fields(self, obstacles=obstacles, neighbours=neighbours)


@dataclass(frozen=True, eq=False)
class SceneTree:
    """A tree as a scene file names it.

    Attributes
    ----------
    file : Path
        A ``.lobes`` file.
    position : (3,) float64
        Foot of its trunk in the scene, metres.
    turn : float
        Radians.
    phototropism, gravitropism : float or None
        Instead of the default strengths.
    """

    file: Path
    position: NDArray[np.float64]
    turn: float
    phototropism: float | None = None
    gravitropism: float | None = None


@dataclass(frozen=True, eq=False)
class SceneFile:
    """What a scene file holds.

    Attributes
    ----------
    trees : tuple of SceneTree
    scene : Scene
        Obstacles, light and strengths; without neighbours.
    """

    trees: tuple[SceneTree, ...]
    scene: Scene


MeshReader = Callable[[Path], TriangleMesh]


def read_scene(path: str | os.PathLike[str], *, read_mesh: MeshReader | None = None) -> SceneFile:
    """Read a scene file (TOML; docs/plastic.md shows one).

    Parameters
    ----------
    path : path
        Names of files in it are relative to its folder.
    read_mesh : callable, optional
        Takes the path of a mesh's file and returns the :class:`treegraph.TriangleMesh`.

    Returns
    -------
    scene : SceneFile
        The trees' files are not opened.

    Raises
    ------
    InputError
        If the file cannot be read.
    FormatError
        If it is no TOML, or breaks a rule; the message begins with the path and says where.
    """
    name = os.fspath(path)
    try:
        with open(path, "rb") as file:
            content = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None
    if len(content) > MAX_FILE_BYTES:
        raise FormatError(f"{name}: a scene file has at most {MAX_FILE_BYTES} bytes.")
    try:
        values = tomllib.loads(content.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"{name}: this is no TOML file: {error}.") from None
    except ValueError:
        raise FormatError(f"{name}: a number in it has too many digits to be read.") from None
    except RecursionError:
        raise FormatError(f"{name}: its brackets are too deep to be read.") from None
    try:
        return parse_scene(values, folder=Path(path).parent, read_mesh=read_mesh)
    except InputError as error:
        raise FormatError(f"{name}: {error}") from None


def parse_scene(
    values: Mapping[str, Any], *, folder: Path = Path(), read_mesh: MeshReader | None = None
) -> SceneFile:
    """The scene of a file's tables; arguments and errors as of :func:`read_scene`.

    Raises
    ------
    InputError
        If a rule is broken; the message says in which table.

    Examples
    --------
    >>> file = parse_scene({"obstacle": [{"kind": "wall", "x": 1.2}], "strength": {"pruning": 1}})
    >>> file.scene.obstacles[0].point.tolist(), file.scene.pruning
    ([1.2, 0.0, 0.0], 1.0)
    """
    _known("the file", values, ("tree", "obstacle", "light", "strength"))
    trees = [_tree(t, f"[[tree]] {k + 1}", folder) for k, t in enumerate(_tables(values, "tree"))]
    if len(trees) > MOST_TREES:
        raise InputError(f"a scene has at most {MOST_TREES} trees, got {len(trees)}")
    obstacles = [
        _obstacle(t, f"[[obstacle]] {k + 1}", folder, read_mesh)
        for k, t in enumerate(_tables(values, "obstacle"))
    ]
    strength = _table(values, "strength")
    _known("[strength]", strength, ("bending", "pruning"))
    sky = _light(_table(values, "light"))
    for key in strength:
        _check_near("[strength]", key, strength[key])
    try:
        scene = Scene(tuple(obstacles), sky=sky, **strength)
    except InputError as error:
        raise InputError(f"[strength]: {error}") from None
    return SceneFile(tuple(trees), scene)


def _table(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = values.get(name, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{name} must be a table [{name}], got {_quote(table)}")
    return table


def _tables(values: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
    tables = values.get(name, [])
    if not isinstance(tables, list) or not all(isinstance(t, Mapping) for t in tables):
        raise InputError(f"{name} must be tables [[{name}]], with two brackets")
    return tables


def _quote(value: Any) -> str:
    """A value as a message shows it, in one short line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        return "something too long to show"
    return text if len(text) <= LONGEST_QUOTE else f"{text[: LONGEST_QUOTE - 4]} ..."


def _check_near(where: str, name: str, value: Any) -> None:
    """No number is so great that to reckon with it makes no sense."""
    if isinstance(value, int | float) and abs(value) > FARTHEST and abs(value) != math.inf:
        raise InputError(f"{where}: {name} must be from {-FARTHEST:g} to {FARTHEST:g}, got {_quote(value)}")


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, int) or math.isfinite(value)


def _known(where: str, table: Mapping[str, Any], names: Iterable[str]) -> None:
    names = list(names)
    for name in table:
        if name not in names:
            raise InputError(f"{where}: there is no {_quote(name)}; there are {', '.join(names)}")


def _number(where: str, table: Mapping[str, Any], name: str, default: Any = REQUIRED) -> float:
    value = table.get(name, default)
    if value is REQUIRED:
        raise InputError(f"{where}: {name} is missing")
    if not _is_finite(value):
        raise InputError(f"{where}: {name} must be a finite number, got {_quote(value)}")
    _check_near(where, name, value)
    return float(value)


def _numbers(where: str, table: Mapping[str, Any], name: str, count: int, default: Any = REQUIRED) -> Any:
    value = table.get(name, default)
    if value is REQUIRED:
        raise InputError(f"{where}: {name} is missing")
    fine = isinstance(value, list | tuple) and len(value) == count
    if not fine or not all(map(_is_finite, value)):
        raise InputError(f"{where}: {name} must be {count} finite numbers, got {_quote(value)}")
    for number in value:
        _check_near(where, name, number)
    return np.array(value, float)


def _text(where: str, table: Mapping[str, Any], name: str) -> str:
    value = table.get(name)
    if not isinstance(value, str) or not value or "\0" in value:
        raise InputError(f"{where}: {name} must be a text, got {_quote(value)}")
    return value


def _tree(table: Mapping[str, Any], where: str, folder: Path) -> SceneTree:
    _known(where, table, ("file", "position", "turn_deg", "phototropism", "gravitropism"))
    place = table.get("position", [0.0, 0.0])
    count = 2 if isinstance(place, list) and len(place) == 2 else 3
    position = np.zeros(3)
    position[:count] = _numbers(where, table, "position", count, (0.0, 0.0, 0.0)[:count])
    turn = math.radians(_number(where, table, "turn_deg", 0.0))
    strengths = {
        name: _number(where, table, name) for name in ("phototropism", "gravitropism") if name in table
    }
    return SceneTree(folder / _text(where, table, "file"), position, turn, **strengths)


def _obstacle(table: Mapping[str, Any], where: str, folder: Path, read_mesh: MeshReader | None) -> Obstacle:
    kind = _text(where, table, "kind")
    makers = {"wall": _wall, "half-space": _half_space, "box": _box, "sphere": _sphere}
    if kind != "mesh" and kind not in makers:
        raise InputError(f"{where}: kind must be {', '.join([*makers, 'mesh'])}, got {_quote(kind)}")
    try:
        if kind == "mesh":
            return _mesh(table, where, folder, read_mesh)
        return makers[kind](table, where)
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(where) else f"{where}: {text}") from None


def _mesh(table: Mapping[str, Any], where: str, folder: Path, read_mesh: MeshReader | None) -> TriangleMesh:
    _known(where, table, ("kind", "file", "translucency"))
    if read_mesh is None:
        raise InputError(f"{where}: meshes cannot be read here")
    mesh = read_mesh(folder / _text(where, table, "file"))
    return TriangleMesh(mesh.vertices, mesh.faces, _number(where, table, "translucency", 0.0))


def _wall(table: Mapping[str, Any], where: str) -> Obstacle:
    """Everything beyond x or y is solid, on the side away from the origin."""
    _known(where, table, ("kind", "x", "y", "translucency"))
    if ("x" in table) == ("y" in table):
        raise InputError(f"{where}: a wall has either x or y, where it stands")
    axis = "x" if "x" in table else "y"
    place = _number(where, table, axis)
    if place == 0.0:
        raise InputError(f"{where}: a wall at {axis} = 0 has no side; name a half-space")
    point, normal = np.zeros(3), np.zeros(3)
    point["xy".index(axis)] = place
    normal["xy".index(axis)] = -math.copysign(1.0, place)
    return HalfSpace(point, normal, _number(where, table, "translucency", 0.0))


def _half_space(table: Mapping[str, Any], where: str) -> Obstacle:
    _known(where, table, ("kind", "point", "normal", "translucency"))
    point, normal = _numbers(where, table, "point", 3), _numbers(where, table, "normal", 3)
    return HalfSpace(point, normal, _number(where, table, "translucency", 0.0))


def _box(table: Mapping[str, Any], where: str) -> Obstacle:
    _known(where, table, ("kind", "center", "size", "turn_deg", "translucency"))
    angle = math.radians(_number(where, table, "turn_deg", 0.0))
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    center, size = _numbers(where, table, "center", 3), _numbers(where, table, "size", 3)
    return Box(center, size, turn, _number(where, table, "translucency", 0.0))


def _sphere(table: Mapping[str, Any], where: str) -> Obstacle:
    _known(where, table, ("kind", "center", "radius", "translucency"))
    center, radius = _numbers(where, table, "center", 3), _number(where, table, "radius")
    return Ball(center, radius, _number(where, table, "translucency", 0.0))


def _angle(where: str, table: Mapping[str, Any], name: str, low: float, high: float) -> float:
    """An angle of the file in radians; its limits are in degrees, as it is there."""
    degrees = _number(where, table, name)
    if not low <= degrees <= high:
        raise InputError(f"{where}: {name} must be from {low:g} to {high:g}, got {degrees:g}")
    return math.radians(degrees)


def _light(table: Mapping[str, Any]) -> Sky | None:
    """The sky of [light]: a direction, a latitude, or a height and a bearing."""
    where = "[light]"
    _known(where, table, ("brightest", "latitude_deg", "north_deg", "elevation_deg", "bearing_deg"))
    ways = [name for name in ("brightest", "latitude_deg", "elevation_deg") if name in table]
    if len(ways) > 1:
        raise InputError(f"{where}: name one of {', '.join(ways)}, not several")
    for name, owner in (("north_deg", "latitude_deg"), ("bearing_deg", "elevation_deg")):
        if name in table and owner not in table:
            raise InputError(f"{where}: {name} goes with {owner}, which is missing")
    try:
        if "brightest" in table:
            x, y, z = _numbers(where, table, "brightest", 3).tolist()
            return Sky((x, y, z))
        if "latitude_deg" in table:
            latitude = _angle(where, table, "latitude_deg", -90.0, 90.0)
            return Sky.at_latitude(latitude, math.radians(_number(where, table, "north_deg", 0.0)))
        if "elevation_deg" in table:
            elevation = _angle(where, table, "elevation_deg", 0.0, 90.0)
            return Sky.from_angles(elevation, math.radians(_number(where, table, "bearing_deg", 0.0)))
    except InputError as error:
        text = str(error)
        raise InputError(text if text.startswith(where) else f"{where}: {text}") from None
    return None
