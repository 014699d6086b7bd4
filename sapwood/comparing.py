"""Two trees from their files, and a picture of which branches of the one became which of the other."""

from __future__ import annotations

import colorsys
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from treegraph.errors import FormatError, InputError, TreeError

if TYPE_CHECKING:
    from inverse import Mapping, Pieces
    from render import Part
    from treegraph import TreeGraph

__all__ = ["draw_mapping", "list_pairs", "mapping_parts", "read_graph"]

GOLDEN = 0.6180339887498949  # steps of it spread hues evenly
UNMATCHED = (158, 158, 158)  # sRGB of what has no counterpart
SATURATION, VALUES = 0.62, (0.86, 0.62)  # of the others; every second one is darker
GAP = 0.12  # between the two trees, as a share of the higher one
FRONT = -0.5 * np.pi  # the camera's azimuth from which the first tree is on the left


def read_graph(path: str | os.PathLike[str]) -> TreeGraph:
    """The graph of a tree in a ``.lobes`` or ``.swc`` file.

    Raises
    ------
    InputError
        If there is no such file, it cannot be read, or its name ends otherwise.
    FormatError
        If it is damaged or something else; the message begins with the path.
    """
    from sapwood.trees import is_lobes, read_tree
    from treegraph import read_swc

    name = os.fspath(path)
    if is_lobes(path):
        return read_tree(path).graph
    if Path(path).suffix.lower() != ".swc":
        raise InputError(f"{name}: the name of a tree to compare must end in .lobes or .swc.")
    try:
        return read_swc(path)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file.") from None
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None
    except (FormatError, TreeError) as error:
        text = str(error).removeprefix(Path(name).name).lstrip(":, ")
        raise FormatError(f"{name}: {text}") from error


@contextmanager
def at_fault(path: str | os.PathLike[str]) -> Iterator[None]:
    """A tree that cannot be compared is the file's fault."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error


def list_pairs(mapping: Mapping) -> list[dict[str, Any]]:
    """The pairs of a mapping, those with most wood first.

    Each has ``a`` and ``b``, the nodes at which the two runs of branches begin and end, ``a_length_m`` and
    ``b_length_m``, and ``cost_m2`` of making the one into the other.
    """
    sides = []
    for pieces, pair_of, foot, head in (
        (mapping.a, mapping.pair_of_a, mapping.foot_a, mapping.head_a),
        (mapping.b, mapping.pair_of_b, mapping.foot_b, mapping.head_b),
    ):
        mapped = pair_of >= 0
        length, wood = (
            np.bincount(pair_of[mapped], values[mapped], mapping.n_pairs)
            for values in (pieces.length, pieces.length * pieces.thickness)
        )
        sides.append((pieces.first[foot], pieces.last[head], length, wood))
    one, two = sides
    order = np.argsort(-(one[3] + two[3]), kind="stable")
    return [
        {
            "a": [int(one[0][k]), int(one[1][k])],
            "b": [int(two[0][k]), int(two[1][k])],
            "a_length_m": round(float(one[2][k]), 4),
            "b_length_m": round(float(two[2][k]), 4),
            "cost_m2": round(float(mapping.cost[k]), 9),
        }
        for k in order
    ]


def mapping_parts(mapping: Mapping, detail: str = "normal") -> list[Part]:
    """Both trees side by side, branches that became each other in one colour, the others grey.

    Raises
    ------
    InputError
        If neither tree has any length.
    """
    import render

    meshes: list[Any] = []
    material = render.Material("branches", (1.0, 1.0, 1.0))
    shift = np.zeros(3)
    sides = ((mapping.a, mapping.pair_of_a), (mapping.b, mapping.pair_of_b))
    graphs = [_from_foot(pieces) for pieces, _ in sides]
    height = max(float(np.ptp(graph.position[:, 2])) for graph in graphs)
    for (pieces, pair_of), graph in zip(sides, graphs, strict=True):
        if meshes:
            left, right = graphs[0].position[:, 0].max(), graph.position[:, 0].min()
            shift = np.array([left - right + GAP * height, 0.0, 0.0])
        moved = graph.replace(position=graph.position + shift)
        mesh = render.branch_mesh(moved, render.DETAIL[detail])
        if not len(mesh.faces):
            continue
        color = pair_colors(mapping.n_pairs)[pair_of[pieces.piece_of[mesh.node]]]
        meshes.append(render.Mesh(mesh.vertices, mesh.faces, mesh.normals, color=color))
    if not meshes:
        raise InputError("the trees have no length: there is nothing to draw.")
    return [render.Part(f"tree_{k}", mesh, material) for k, mesh in enumerate(meshes)]


def draw_mapping(mapping: Mapping, path: Path | None = None, **look: Any) -> Any:
    """Draw both trees side by side, branches that became each other in one colour.

    Parameters
    ----------
    mapping : Mapping
    path : path, optional
        PNG or JPEG.
    **look
        ``size`` and ``renderer`` as of :func:`render.preview`.

    Returns
    -------
    preview : render.Preview
    """
    import render
    from treegraph import DEFAULT_ALLOMETRY, ClusterTree

    parts = mapping_parts(mapping)
    stand = ClusterTree(_from_foot(mapping.a), (), None, DEFAULT_ALLOMETRY, np.zeros(3))
    return render.preview(stand, path, parts=parts, azimuth=FRONT, **look)


def pair_colors(n: int) -> NDArray[np.uint8]:
    """sRGB of n pairs, (n + 1, 3); the last one, which -1 reads, is that of what has no counterpart."""
    hues = [(k * GOLDEN) % 1.0 for k in range(n)]
    colors = [colorsys.hsv_to_rgb(hue, SATURATION, VALUES[k % 2]) for k, hue in enumerate(hues)]
    out = np.rint(255.0 * np.array(colors).reshape(-1, 3)).astype(np.uint8)
    return np.concatenate([out, np.array([UNMATCHED], np.uint8)])


def _from_foot(pieces: Pieces) -> TreeGraph:
    """The tree with its root at the origin, its root's radius known."""
    graph = pieces.graph
    radius = np.where(np.isnan(graph.radius), 0.0, graph.radius)
    return graph.replace(position=graph.position - graph.position[0], radius=radius)
