"""Trees in other surroundings, from files to files: who stands where, what reacts, pictures and figures."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from sapwood.outputs import write_whole
from treegraph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from plastic import Adapted, Neighbour, Scene
    from render import Part, Preview
    from species.library import Species
    from treegraph import ClusterTree, TreeGraph, TriangleMesh
    from treegraph.obstacles import Obstacle

__all__ = [
    "ADAPTED_SUFFIXES",
    "PICTURES",
    "Look",
    "Yard",
    "adapt_yard",
    "cloud_of",
    "draw_adapted",
    "figures",
    "follow",
    "parse_path",
    "placed_tree",
    "output_paths",
    "reach_of",
    "read_mesh_obstacle",
    "read_yard",
    "shift_obstacle",
    "write_adapted",
]

PICTURES = (".png", ".jpg", ".jpeg")
TREES = (".lobes", ".swc", ".csv")
MESHES = (".glb", ".obj", ".ply")
ADAPTED_SUFFIXES = (*MESHES, *TREES, *PICTURES)
"""What adapted trees can be written as, by the suffix of the file."""

MOST_FRAMES = 1000
FARTHEST = 1e9  # metres; as in scene files
WOOD_GREY = np.array([150, 145, 138], float)  # sRGB of what did not move
BENT_RED = np.array([214, 32, 24], float)
PRUNED_BLUE = (0.16, 0.36, 0.86)
LEAF_GREEN = (0.38, 0.52, 0.23)
FADED = 0.25  # opacity of hulls beside coloured branches


@dataclass(frozen=True, eq=False)
class Yard:
    """Trees, where they stand, and what else is there.

    Attributes
    ----------
    trees : tuple of Neighbour
        Analysed; the first is the one in question.
    scene : Scene
        Without neighbours; in the frame of the first tree or of the scene file.
    names : tuple of str
        Of the trees.
    analyse_s : float
        Seconds that their analysis took.
    """

    trees: tuple[Neighbour, ...]
    scene: Scene
    names: tuple[str, ...]
    analyse_s: float = 0.0


@dataclass(frozen=True, eq=False)
class Look:
    """How trees are drawn and meshed.

    Attributes
    ----------
    species : tuple of Species or None
        Whose leaves each tree bears; None: clusters stay hulls.
    season : str
    seed : int
        Of the leaves.
    detail : str
        "fine", "normal" or "coarse".
    changes : bool
        Branches in red by how far they moved, and what fell in blue (thesis, figure 4.12), instead of leaves.
    more : dict
        Arguments of :func:`render.preview`.
    """

    species: tuple[Species | None, ...] = ()
    season: str = "summer"
    seed: int = 0
    detail: str = "normal"
    changes: bool = False
    more: dict[str, Any] = field(default_factory=dict)

    def species_of(self, k: int) -> Species | None:
        """Whose leaves tree k bears."""
        return self.species[k] if k < len(self.species) else None


def read_mesh_obstacle(path: str | os.PathLike[str]) -> TriangleMesh:
    """The triangles of a GLB, OBJ or PLY file.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    from sapwood.obstacles import parse_obstacle

    return parse_obstacle(f"mesh:{os.fspath(path)}")  # type: ignore[return-value]


def read_yard(
    tree: Path | None,
    scene_file: Path | None,
    *,
    obstacles: Sequence[Obstacle] = (),
    **changes: Any,
) -> Yard:
    """Read trees and surroundings, and analyse every tree once.

    Parameters
    ----------
    tree : path or None
        A ``.lobes`` file; it stands in the origin, before those of the scene file.
    scene_file : path or None
        TOML (:func:`plastic.read_scene`).
    obstacles : sequence of Obstacle
        Beside those of the file.
    **changes
        ``sky``, ``bending``, ``pruning`` of the scene and ``phototropism``, ``gravitropism`` of the trees;
        None leaves what the file or the defaults say.

    Raises
    ------
    InputError
        If there is no tree, a file cannot be read, or an obstacle reaches farther than 1e9 m.
    """
    import plastic
    from sapwood.trees import read_tree

    file = None
    scene = plastic.Scene()
    if scene_file is not None:
        file = plastic.read_scene(scene_file, read_mesh=read_mesh_obstacle)
        scene = file.scene
    strengths = {k: v for k in ("sky", "bending", "pruning") if (v := changes.get(k)) is not None}
    scene = replace(scene, obstacles=(*scene.obstacles, *obstacles), **strengths)
    for k, obstacle in enumerate(scene.obstacles):
        _check_near(obstacle, k + 1)
    wanted: list[Any] = [] if tree is None else [plastic.SceneTree(tree, np.zeros(3), 0.0)]
    wanted += [] if file is None else file.trees
    if not wanted:
        raise InputError("there is no tree: name a file X.lobes, or a scene file with [[tree]] tables.")
    start = perf_counter()
    known: dict[Any, Any] = {}
    trees = []
    for entry in wanted:
        weights = {
            name: value if (value := changes.get(name)) is not None else getattr(entry, name)
            for name in ("phototropism", "gravitropism")
        }
        key = (entry.file, *weights.values())
        if key not in known:
            settings = plastic.AnalysisSettings(**{k: v for k, v in weights.items() if v is not None})
            known[key] = plastic.analyse(read_tree(entry.file), settings=settings)
        trees.append(plastic.Neighbour(known[key], entry.position, entry.turn))
    names = tuple(entry.file.stem for entry in wanted)
    return Yard(tuple(trees), scene, names, perf_counter() - start)


def _check_near(obstacle: Obstacle, count: int) -> None:
    """Farther away numbers have no millimetres left, and squares of them overflow."""
    names = ("point", "center", "size", "radius", "vertices")
    far = max(
        float(np.abs(getattr(obstacle, name)).max(initial=0.0)) for name in names if hasattr(obstacle, name)
    )
    if far > FARTHEST:
        raise InputError(f"obstacles must be within {FARTHEST:g} m, but the {count}. of them has {far:g} m")


def adapt_yard(yard: Yard) -> tuple[Adapted, ...]:
    """All trees of a yard as they react to it and to each other.

    Raises
    ------
    InputError
        If a tree would stand in an obstacle.
    """
    from plastic import adapt_stand

    first = yard.trees[0]
    if len(yard.trees) == 1 and not first.turn and not first.position.any():
        return (first.state.adapt(yard.scene),)
    return adapt_stand(yard.trees, yard.scene)


# ---------------------------------------------------------------- paths


def parse_path(text: str) -> NDArray[np.float64]:
    """Places ``dx,dy,dz dx,dy,dz ...`` that a path leads through, (k, 3), metres.

    Raises
    ------
    InputError
        If there are fewer than two, or one is not three finite numbers up to 1e9.

    Examples
    --------
    >>> parse_path("0,0,0 -1.5,0,0").tolist()
    [[0.0, 0.0, 0.0], [-1.5, 0.0, 0.0]]
    """
    rows = []
    for part in text.split():
        try:
            row = [float(number) for number in part.split(",")]
        except ValueError:
            row = []
        if len(row) != 3 or not all(map(math.isfinite, row)):
            raise InputError(f"a path is places dx,dy,dz with blanks between them, got {part!r} in {text!r}")
        if max(map(abs, row)) > FARTHEST:
            raise InputError(f"a path must stay within {FARTHEST:g} m, got {part!r}")
        rows.append(row)
    if len(rows) < 2:
        raise InputError(f"a path leads through two places or more, as in '0,0,0 -2,0,0', got {text!r}")
    return np.array(rows)


def shift_obstacle(obstacle: Obstacle, by: NDArray[np.float64]) -> Obstacle:
    """The same obstacle somewhere else."""
    from treegraph import Ball, Box, HalfSpace, TriangleMesh

    if isinstance(obstacle, HalfSpace):
        return HalfSpace(obstacle.point + by, obstacle.normal, obstacle.translucency)
    if isinstance(obstacle, Ball):
        return Ball(obstacle.center + by, obstacle.radius, obstacle.translucency)
    if isinstance(obstacle, Box):
        return Box(obstacle.center + by, obstacle.size, obstacle.rotation, obstacle.translucency)
    return TriangleMesh(obstacle.vertices + by, obstacle.faces, obstacle.translucency)


def follow(
    yard: Yard, path: NDArray[np.float64], frames: int
) -> Iterator[tuple[tuple[Obstacle, ...], tuple[Adapted, ...]]]:
    """Move the last obstacle along a path; the obstacles and the trees of every frame.

    Steps are of equal length along the path, both ends among them. Only what a step affects is worked out
    anew.

    Raises
    ------
    InputError
        If there is no obstacle, the number of frames is not from 2 to 1000, or a tree would stand in an
        obstacle.
    """
    from plastic import Session

    if not yard.scene.obstacles:
        raise InputError("a path moves an obstacle, and there is none: name one with --obstacle.")
    if not 2 <= frames <= MOST_FRAMES:
        raise InputError(f"frames must be from 2 to {MOST_FRAMES}, got {frames}")
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    *others, moving = yard.scene.obstacles
    session = Session()
    for share in np.linspace(0.0, way[-1], frames):
        by = np.array([np.interp(share, way, path[:, axis]) for axis in range(3)])
        obstacles = (*others, shift_obstacle(moving, by))
        yield obstacles, session.adapt_stand(yard.trees, replace(yard.scene, obstacles=obstacles))


# ---------------------------------------------------------------- figures


def figures(yard: Yard, adapted: Sequence[Adapted]) -> dict[str, Any]:
    """What reports say: nodes before and after, what fell, how far living nodes moved; and that by tree."""
    trees: list[dict[str, Any]] = [
        {
            "name": name,
            "nodes_before": len(a.alive),
            "nodes_after": int(a.alive.sum()),
            "pruned": a.n_pruned,
            "pruned_by_light": int((a.cause == 1).sum()),
            "pruned_by_obstacles": int((a.cause == 2).sum()),
            "clusters_before": len(a.state.tree.clusters),
            "clusters_after": len(a.kept_clusters),
            "mean_shift_m": round(a.mean_shift, 4),
        }
        for name, a in zip(yard.names, adapted, strict=True)
    ]
    living = sum(t["nodes_after"] for t in trees)
    moved = sum(t["mean_shift_m"] * t["nodes_after"] for t in trees)
    total = {name: sum(t[name] for t in trees) for name in ("nodes_before", "nodes_after", "pruned")}
    return {**total, "mean_shift_m": round(moved / living, 4), "trees": trees}


# ---------------------------------------------------------------- trees in the scene's frame


def placed_tree(adapted: Adapted, tree: ClusterTree | None = None) -> ClusterTree:
    """An adapted tree, or another state of it, where it stands in the scene."""
    from treegraph import Cluster, transform

    tree = adapted.tree if tree is None else tree
    placed = adapted.placed
    if placed is None or (not placed.turn and not placed.position.any()):
        return tree
    c, s = math.cos(placed.turn), math.sin(placed.turn)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    hulls = tuple(
        Cluster(k.vertices @ turn.T + placed.position, k.faces, k.seed, k.density, k.n_points)
        for k in tree.clusters
    )
    return tree.replace(graph=transform(tree.graph, turn, placed.position), clusters=hulls)


def _with_lost_clusters(adapted: Adapted) -> ClusterTree:
    """The tree with an empty cluster for each that is gone, so that the others keep their leaves."""
    from treegraph import Cluster

    empty = Cluster(np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.zeros(0, np.int32), 0.0, 0)
    whole = [empty] * len(adapted.state.tree.clusters)
    for k, cluster in zip(adapted.kept_clusters, adapted.tree.clusters, strict=True):
        whole[int(k)] = cluster
    return adapted.tree.replace(clusters=tuple(whole))


def _tree_parts(adapted: Adapted, k: int, look: Look) -> list[Part]:
    """Wood and leaves of one tree where it stands."""
    import render
    from sapwood.dressing import dress

    tail = f"_{k}" if k else ""
    species = look.species_of(k)
    if look.changes:
        parts = _changed_parts(adapted, look)
    elif species is not None and adapted.state.tree.clusters:
        tree = placed_tree(adapted, _with_lost_clusters(adapted))
        density = adapted.density
        dressed = dress(
            tree, species, season=look.season, seed=look.seed, density=density, detail=look.detail
        )
        parts = list(dressed.parts())
    else:
        parts = list(render.tree_parts(placed_tree(adapted), render.DETAIL[look.detail]))
    return [render.Part(f"{part.name}{tail}", part.mesh, part.material) for part in parts]


def _changed_parts(adapted: Adapted, look: Look) -> list[Part]:
    """Branches in red by how far they moved, and what fell in blue where it was (thesis, figure 4.12)."""
    import render

    graph = placed_tree(adapted).graph
    parts = []
    settings = render.DETAIL[look.detail]
    if graph.n_nodes > 1:
        mesh = render.branch_mesh(graph, settings)
        shift = adapted.displacement[adapted.alive]
        share = shift / max(float(adapted.displacement.max()), 1e-9)
        tint = (1.0 - share[:, None]) * WOOD_GREY + share[:, None] * BENT_RED
        color = np.rint(tint[mesh.node]).astype(np.uint8)
        bent = render.Material("bent", (1.0, 1.0, 1.0))
        parts.append(render.Part("wood", replace(mesh, color=color), bent))
    if adapted.n_pruned:
        fallen = _fallen(placed_tree(adapted, adapted.state.tree).graph, ~adapted.alive)
        mesh = render.branch_mesh(fallen, settings)
        parts.append(render.Part("pruned", mesh, render.Material("pruned", PRUNED_BLUE)))
    hulls = render.hull_mesh(placed_tree(adapted).clusters)
    if len(hulls.faces):
        faded = render.Material("leaves", LEAF_GREEN, alpha=FADED, double_sided=True)
        parts.append(render.Part("clusters", hulls, faded))
    return parts


def _fallen(graph: TreeGraph, dead: NDArray[np.bool_]) -> TreeGraph:
    """What fell, each branch with the node that it hung on as its root."""
    from treegraph import NO_PARENT, TreeGraph

    kept = dead.copy()
    kept[graph.parent[dead & (graph.parent != NO_PARENT)]] = True
    place = np.cumsum(kept) - 1
    parent = np.where(dead & (graph.parent != NO_PARENT), place[graph.parent], NO_PARENT)
    radius = graph.radius.copy()
    bearer = kept & ~dead
    radius[bearer] = 0.0  # as thick as what it bore, not as itself
    hung = np.flatnonzero(dead & (graph.parent != NO_PARENT))
    hung = hung[bearer[graph.parent[hung]]]
    np.maximum.at(radius, graph.parent[hung], graph.radius[hung])
    return TreeGraph(parent[kept], graph.position[kept], radius[kept])


def reach_of(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The corners (8, 3) of the box around points."""
    low, high = points.min(axis=0), points.max(axis=0)
    return np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)])


def cloud_of(adapted: Sequence[Adapted]) -> NDArray[np.float64]:
    """Points that the trees reach, as they were and as they are."""
    points = []
    for a in adapted:
        for tree in (placed_tree(a, a.state.tree), placed_tree(a)):
            points += [tree.graph.position, *(c.vertices for c in tree.clusters)]
    return np.concatenate(points)


def draw_adapted(
    adapted: Sequence[Adapted],
    obstacles: Sequence[Obstacle],
    look: Look,
    path: Path | None = None,
    *,
    frame: NDArray[np.float64] | None = None,
) -> Preview:
    """Draw trees with their obstacles.

    Parameters
    ----------
    adapted : sequence of Adapted
    obstacles : sequence of Obstacle
    look : Look
        By default a wall is seen from its end.
    path : path, optional
        Where the picture is written.
    frame : (n, 3) array, optional
        Points that fit into the picture: the same for all pictures of a series. By default those of the trees
        as they were and as they are.
    """
    import render
    from sapwood.growing import obstacle_parts
    from treegraph import HalfSpace

    cloud = cloud_of(adapted) if frame is None else frame
    parts = [part for k, a in enumerate(adapted) for part in _tree_parts(a, k, look)]
    walls = obstacle_parts(obstacles, cloud)
    empty = render.Mesh(cloud, np.zeros((0, 3), np.int32), np.zeros_like(cloud, np.float32))
    clear = render.Part("frame", empty, render.Material("frame", (0.0, 0.0, 0.0)))
    solid = [part for part in parts if part.material.alpha == 1.0]
    blended = [part for part in parts if part.material.alpha < 1.0]
    more = dict(look.more)
    upright = [o for o in obstacles if isinstance(o, HalfSpace) and abs(o.normal[2]) < 1.0]
    if more.get("azimuth") is None and upright:
        more["azimuth"] = math.atan2(-upright[0].normal[0], upright[0].normal[1])
    tree = placed_tree(adapted[0])
    return render.preview(tree, path, parts=[*solid, clear, *blended, *walls], **more)


# ---------------------------------------------------------------- files


def output_paths(path: Path, n: int) -> list[Path]:
    """One file for meshes and pictures; where a file holds one tree one for each, numbered if several."""
    if n == 1 or path.suffix.lower() not in TREES:
        return [path]
    return [path.with_name(f"{path.stem}_{k + 1}{path.suffix}") for k in range(n)]


def write_adapted(
    adapted: Sequence[Adapted],
    obstacles: Sequence[Obstacle],
    path: Path,
    look: Look,
    *,
    only: int | None = None,
    force: bool = False,
    extras: dict[str, Any] | None = None,
) -> tuple[list[Path], Preview | None]:
    """Write trees in the format that the suffix of `path` names.

    Meshes (``.glb``, ``.obj``, ``.ply``) and pictures (``.png``, ``.jpg``) hold all trees, pictures also
    obstacles. ``.lobes``, ``.swc`` and ``.csv`` hold a tree each, in its own frame; of several trees they are
    numbered.

    Parameters
    ----------
    only : int, optional
        Write this tree only, where a file holds one.

    Raises
    ------
    InputError
        If the suffix is none of these, a file exists and `force` is not set, or it cannot be written.
    """
    import render
    import treegraph
    from sapwood.trees import write_tree

    suffix = path.suffix.lower()
    if suffix in PICTURES:
        drawn: list[Preview] = []
        write_whole(path, lambda to: drawn.append(draw_adapted(adapted, obstacles, look, to)), force=force)
        return [path], drawn[0]
    if suffix in MESHES:
        parts = [part for k, a in enumerate(adapted) for part in _tree_parts(a, k, look)]
        if suffix == ".glb":
            write_whole(path, lambda to: render.write_glb(to, parts, extras=extras), force=force)
        else:
            writer = render.write_obj if suffix == ".obj" else render.write_ply
            write_whole(path, lambda to: writer(to, parts), force=force)
        return [path], None
    if suffix not in TREES:
        raise InputError(f"{os.fspath(path)}: the name must end in one of {' '.join(ADAPTED_SUFFIXES)}.")
    chosen = list(adapted) if only is None else [adapted[only]]
    paths = output_paths(path, len(chosen))
    for to, a in zip(paths, chosen, strict=True):
        if suffix == ".lobes":
            write_whole(to, lambda part, a=a: treegraph.write_lobes(a.tree, part), force=force)  # type: ignore[misc]
        else:
            write_tree(a.tree, to, force=force)
    return paths, None
