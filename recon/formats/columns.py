"""Which column, property or dimension means what, by the names people give them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from recon.formats.chunks import Chunk

# All names as plain() leaves them: lower case, letters and digits only.
XYZ_NAMES = (
    ("x", "y", "z"),
    ("xm", "ym", "zm"),
    ("px", "py", "pz"),
    ("posx", "posy", "posz"),
    ("pointx", "pointy", "pointz"),
    ("points0", "points1", "points2"),
    ("coordx", "coordy", "coordz"),
    ("xcoord", "ycoord", "zcoord"),
    ("xcoordinate", "ycoordinate", "zcoordinate"),
    ("cartesianx", "cartesiany", "cartesianz"),
    ("easting", "northing", "elevation"),
    ("easting", "northing", "height"),
    ("east", "north", "up"),
    ("e", "n", "h"),
    ("x", "y", "height"),
    ("x", "y", "elevation"),
)
COLOR_NAMES = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffusered", "diffusegreen", "diffuseblue"),
    ("colorred", "colorgreen", "colorblue"),
)
INTENSITY_NAMES = ("intensity", "reflectance", "reflectivity", "amplitude")
TREE_NAMES = (
    "treeid", "treeids", "treenumber", "treeno", "treenr", "treeindex", "treelabel", "treeinstance", "idtree",
    "tree", "instance", "instanceid", "instanceseg", "predinstance",
)  # fmt: skip
WOOD_NAMES = ("wood", "iswood", "woody", "woodlabel")
LEAF_NAMES = ("leaf", "isleaf", "foliage", "isfoliage", "leaflabel")
UNCLEAR_NAMES = ("label", "labels", "class", "classification", "semantic", "pred", "prediction")


def plain(name: str) -> str:
    """A name without case, quotes, punctuation, units in brackets and CloudCompare's ``scalar_``.

    >>> plain('"Scalar_Tree ID"'), plain("//X"), plain("z [m]")
    ('treeid', 'x', 'z')
    """
    name = re.sub(r"\[.*?\]|\(.*?\)", "", name.strip().strip("\"'").lower())
    name = re.sub(r"[^a-z0-9]+", "", name)
    return re.sub(r"^scalar(?=.)", "", name)


@dataclass
class ColumnMap:
    """Where in a row of values each thing is; None or absent where it is not.

    Attributes
    ----------
    xyz : tuple of int or None
        Columns of the coordinates.
    extra : dict of str to tuple of int
        For each key of :attr:`Chunk.extra`, its column (three for "color").
    names : dict of str to str
        The same, as the file calls them.
    unclear : list of str
        Label columns whose meaning the name does not tell; they are left alone.
    """

    xyz: tuple[int, int, int] | None
    extra: dict[str, tuple[int, ...]] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    unclear: list[str] = field(default_factory=list)


def map_columns(names: Sequence[str]) -> ColumnMap:
    """Find coordinates, colour, intensity and labels among `names`.

    Only names that say what they mean are used: "label" or "class" could be anything and is left alone.

    >>> m = map_columns(["X", "Y", "Z", "Red", "Green", "Blue", "tree_id"])
    >>> m.xyz, m.extra
    ((0, 1, 2), {'color': (3, 4, 5), 'tree': (6,)})
    """
    first: dict[str, int] = {}
    for i, name in enumerate(names):
        first.setdefault(plain(name), i)
    result = ColumnMap(None)
    for triple in XYZ_NAMES:
        if all(name in first for name in triple):
            result.xyz = (first[triple[0]], first[triple[1]], first[triple[2]])
            break
    for triple in COLOR_NAMES:
        if all(name in first for name in triple):
            result.extra["color"] = tuple(first[name] for name in triple)
            break
    for key, options in (
        ("intensity", INTENSITY_NAMES),
        ("tree", TREE_NAMES),
        ("wood", WOOD_NAMES),
        ("leaf", LEAF_NAMES),
    ):
        found = [first[name] for name in options if name in first]
        if found:
            result.extra[key] = (found[0],)
            result.names[key] = str(names[found[0]]).strip().strip("\"'")
    if "wood" in result.extra:
        result.extra.pop("leaf", None)
    result.unclear = [str(names[first[n]]).strip("\"'") for n in UNCLEAR_NAMES if n in first]
    return result


def chunk_of(columns: ColumnMap, get: Callable[[int], np.ndarray]) -> Chunk:
    """Build a chunk from `get`, which gives column i of the block as an array."""
    if columns.xyz is None:
        raise AssertionError("chunk_of needs coordinates; the reader checks that")
    xyz = np.empty((len(get(columns.xyz[0])), 3), np.float64)
    for axis, column in enumerate(columns.xyz):
        xyz[:, axis] = get(column)
    extra = {}
    for key, where in columns.extra.items():
        values = [np.ascontiguousarray(get(i)) for i in where]
        extra[key] = values[0] if len(values) == 1 else np.stack(values, axis=1)
    return Chunk(xyz, extra)
