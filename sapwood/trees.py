"""Trees from their files, and files of other formats from trees."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sapwood.outputs import write_whole
from treegraph.errors import FitError, FormatError, InputError, TreeError

if TYPE_CHECKING:
    from sapwood.dressing import Dressed
    from treegraph import ClusterTree

__all__ = ["DECODED", "MESHES", "blame", "is_lobes", "keep_thickest", "read_tree", "write_tree"]

DECODED = (".glb", ".obj", ".ply", ".swc", ".csv")
"""What a tree can be decoded to, by the suffix of the file."""

MESHES = (".glb", ".obj", ".ply")
"""Those of them that are meshes, and so have leaves."""


def is_lobes(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is meant as a tree rather than a scan: by its name, as scans have many."""
    return Path(path).suffix.lower() == ".lobes"


def read_tree(path: str | os.PathLike[str]) -> ClusterTree:
    """Read a ``.lobes`` file.

    Raises
    ------
    InputError
        If there is no such file, or it cannot be read.
    FormatError
        If it is damaged or something else; the message begins with the path.
    """
    import treegraph

    name = os.fspath(path)
    try:
        return treegraph.read_lobes(path)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file.") from None
    except IsADirectoryError:
        raise InputError(f"{name}: this is a folder; name a .lobes file in it.") from None
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None
    except (FormatError, TreeError, FitError) as error:
        if str(error).startswith(name):
            raise
        text = str(error).removeprefix(Path(name).name).lstrip(":, ")
        raise FormatError(f"{name}: {text}") from error


def keep_thickest(tree: ClusterTree, share: float) -> ClusterTree:
    """A tree of which the thickest branches are left, and those that lead to clusters: a level of detail.

    Parameters
    ----------
    tree : ClusterTree
    share : float
        Part of its edges that is kept, above 0 to 1. Where any are left out, the clusters lose their seeds.

    Raises
    ------
    InputError
        If `share` is out of its range.
    """
    import render

    if share == 1.0:
        return tree
    hulls = tuple(replace(cluster, seed=np.empty(0, np.int32)) for cluster in tree.clusters)
    seeds = np.concatenate([np.empty(0, np.int32), *(cluster.seed for cluster in tree.clusters)])
    return tree.replace(graph=render.thickest_edges(tree.graph, share, seeds)[0], clusters=hulls)


@contextmanager
def blame(path: str | os.PathLike[str]) -> Iterator[None]:
    """A tree that cannot be made a mesh of, for want of radii, is the file's fault."""
    try:
        yield
    except TreeError as error:
        raise InputError(f"{os.fspath(path)}: {error}") from error


def write_tree(
    tree: ClusterTree,
    path: str | os.PathLike[str],
    *,
    detail: str = "normal",
    local: bool = False,
    force: bool = False,
    dressed: Dressed | None = None,
    flat: bool = False,
    lod: float = 1.0,
) -> Path:
    """Write a tree in the format that the suffix of `path` names.

    Parameters
    ----------
    tree : ClusterTree
    path : path
        Ends in ``.glb``, ``.obj``, ``.ply`` (meshes), ``.swc`` (the graph) or ``.csv`` (the cylinders).
    detail : {"fine", "normal", "coarse"}
        Of a mesh.
    local : bool
        Write the graph or the cylinders relative to the foot of the trunk rather than in the scan's own
        coordinates. A mesh always is: single precision has no room for map coordinates.
    force : bool
        Whether a file that is there may be replaced.
    dressed : Dressed, optional
        The tree with its leaves (:func:`sapwood.dressing.dress`), which a mesh then has instead of hulls.
    flat : bool
        Write a dressed tree's ``.glb`` vertex by vertex, for programs that know no instancing; other
        meshes always are.
    lod : float
        Of a tree that is not dressed: part of its branches' edges that is kept, above 0 to 1, from the thick
        end.

    Raises
    ------
    InputError
        If the suffix is unknown, or the file exists and `force` is not set, or it cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in DECODED:
        raise InputError(f"{os.fspath(path)}: the name must end in one of {' '.join(DECODED)}.")
    if suffix not in MESHES:
        return write_whole(path, lambda part: _write_graph(tree, part, suffix, local), force=force)
    name = Path(path).stem
    if suffix == ".glb" and dressed is not None and not flat:
        return write_whole(path, lambda part: _write_instanced(dressed, part, name), force=force)
    return write_whole(path, lambda part: _write_mesh(tree, part, suffix, detail, dressed, lod), force=force)


def _extras(tree: ClusterTree) -> dict[str, Any]:
    return {"origin": tree.origin.tolist(), "epsg": tree.epsg}


def _write_instanced(dressed: Dressed, path: Path, name: str) -> None:
    import render

    render.write_instanced_glb(path, dressed.decoded, name=name, extras=_extras(dressed.tree))


def _write_mesh(
    tree: ClusterTree, path: Path, suffix: str, detail: str, dressed: Dressed | None, lod: float
) -> None:
    import render
    from sapwood.dressing import coarser

    if dressed is not None:
        parts = dressed.parts()
    else:
        parts = render.tree_parts(keep_thickest(tree, lod), render.DETAIL[coarser(detail, lod)])
    if suffix == ".glb":
        render.write_glb(path, parts, extras=_extras(tree))
    elif suffix == ".obj":
        render.write_obj(path, parts)
    else:
        render.write_ply(path, parts)


def _write_graph(tree: ClusterTree, path: Path, suffix: str, local: bool) -> None:
    import treegraph
    from sapwood.cylinders import cylinder_table, format_cylinders

    origin = (0.0, 0.0, 0.0) if local else tree.origin
    if suffix == ".csv":
        path.write_text(format_cylinders(cylinder_table(tree.graph, origin)), encoding="ascii")
    else:
        treegraph.write_swc(tree.graph.replace(position=tree.graph.position + origin), path)
