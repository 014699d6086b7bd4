"""Grown trees from a request to files: the tree, its leaves, its neighbours and obstacles, its pictures."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sapwood.outputs import write_whole
from treegraph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from render import Part
    from sapwood.dressing import Dressed
    from species import GrownTree, Preset
    from species.library import Species
    from treegraph import ClusterTree, Sky, TreeGraph
    from treegraph.obstacles import Obstacle

__all__ = [
    "GROWN_SUFFIXES",
    "PICTURES",
    "Group",
    "Request",
    "as_cluster_tree",
    "draw_grown",
    "grow_group",
    "spread_ages",
    "write_grown",
]

PICTURES = (".png", ".jpg", ".jpeg")
GROWN_SUFFIXES = (".glb", ".obj", ".ply", ".lobes", ".swc", ".csv", *PICTURES)
"""What a grown tree can be written as, by the suffix of the file."""

MOST_NEIGHBOURS = 60
RING = 6  # neighbours in the first ring around the tree
DEFAULT_SPACING = 4.0  # metres
WALL_COLOR = (0.62, 0.60, 0.57)
WALL_MARGIN = (
    0.15  # how far the piece of an endless wall that is drawn reaches past the trees, in their height
)
WALL_THICKNESS = 0.2  # metres, as drawn
UPRIGHT = 1e-9  # height of the normal of a half-space that is drawn as a wall
LEAF_STREAM = 1  # of the seeds spawned from the tree's: leaves do not change what grows


@dataclass(frozen=True, eq=False)
class Request:
    """What is to be grown.

    Attributes
    ----------
    kind : Preset
        Parameters and age.
    seed : int
    obstacles : tuple of Obstacle
        In the frame of the tree, whose foot is (0, 0, 0).
    sky : Sky, optional
    neighbours : int
        Trees of the same kind around it, 0 to 60, in rings of 6, 12, ... trees.
    spacing : float
        Distance between trees, metres, > 0.
    max_nodes : int, optional
        Most nodes of all trees together.
    """

    kind: Preset
    seed: int = 0
    obstacles: tuple[Obstacle, ...] = ()
    sky: Sky | None = None
    neighbours: int = 0
    spacing: float = DEFAULT_SPACING
    max_nodes: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.neighbours <= MOST_NEIGHBOURS:
            raise InputError(f"neighbours must be from 0 to {MOST_NEIGHBOURS}, got {self.neighbours}")
        if not 0.0 < self.spacing < math.inf:
            raise InputError(f"spacing must be a positive number of metres, got {self.spacing!r}")


@dataclass(frozen=True, eq=False)
class Group:
    """Trees that grew together, and what stands among them.

    Attributes
    ----------
    trees : sequence of GrownTree
        The first is the one in question.
    obstacles : tuple of Obstacle
    seed : int
        Of the leaves.
    bare : bool
        Without leaves.
    species : Species, optional
        Whose twigs, leaves and bark they have; else leaves are plain blades.
    season : str
        Of a species' leaves.
    coarse : bool
        Whether an internode stands for all the twigs that a scan did not show, as in trees whose
        ``tip_share`` is above that of the growth model: their clusters are at least as dense as the species
        has them.
    """

    trees: Sequence[GrownTree]
    obstacles: tuple[Obstacle, ...] = ()
    seed: int = 0
    bare: bool = False
    species: Species | None = None
    season: str = "summer"
    coarse: bool = False
    _leaves: dict[int, Any] = field(default_factory=dict)
    _dressed: dict[int, Any] = field(default_factory=dict)

    def leaves(self, k: int) -> Any:
        """The leaves of tree k, a :class:`species.LeafSet`; made when they are first asked for."""
        from species import place_leaves

        if k not in self._leaves:
            rng = np.random.default_rng([self.seed, LEAF_STREAM, k])
            self._leaves[k] = place_leaves(self.trees[k].tree, rng=rng)
        return self._leaves[k]

    def dressed(self, k: int, detail: str = "normal") -> Dressed:
        """Tree k with the leaves of its species: as much leaf area in each cluster as has grown there."""
        from sapwood.dressing import dress

        if k not in self._dressed:
            assert self.species is not None
            tree = as_cluster_tree(self.trees[k], self.leaves(k), self.species)
            density = grown_density(tree, self.trees[k].tree, self.species)
            density = np.maximum(density, 1.0) if self.coarse else density
            self._dressed[k] = dress(
                tree, self.species, season=self.season, seed=self.seed, density=density, detail=detail
            )
        return self._dressed[k]

    def leaf_area(self, k: int) -> float:
        """Leaves of tree k, one side, m2: what has grown, or what a coarse tree is dressed in."""
        if self.bare:
            return 0.0
        grown = float(self.trees[k].tree.attribute["leaf_area"].sum())
        if self.coarse and self.species is not None and self.leaves(k).n_leaves:
            return self.dressed(k).leaf_area
        return grown

    def parts(self, detail: str = "normal") -> list[Part]:
        """Wood and leaves of all trees: ``wood`` and ``leaves``, ``wood_1`` and so on for the neighbours."""
        import render

        parts: list[Part] = []
        for k, tree in enumerate(self.trees):
            tail = f"_{k}" if k else ""
            if self.species is not None and not self.bare and self.leaves(k).n_leaves:
                made = self.dressed(k, detail).parts()
                parts += [render.Part(f"{part.name}{tail}", part.mesh, part.material) for part in made]
                continue
            if tree.tree.n_nodes > 1:
                wood = render.tree_parts(as_cluster_tree(tree), render.DETAIL[detail])[0]
                parts.append(render.Part(f"wood{tail}", wood.mesh, wood.material))
            if not self.bare and self.leaves(k).n_leaves:
                parts.append(render.leaf_part(self.leaves(k), f"leaves{tail}"))
        return parts


def neighbour_places(n: int, spacing: float) -> list[tuple[float, float, float]]:
    """Feet of n trees around the origin: 6 at one spacing, 12 at two, and so on."""
    places: list[tuple[float, float, float]] = []
    ring = 1
    while len(places) < n:
        count = min(RING * ring, n - len(places))
        for k in range(count):
            angle = 2.0 * math.pi * k / count
            places.append((ring * spacing * math.cos(angle), ring * spacing * math.sin(angle), 0.0))
        ring += 1
    return places


def grow_group(
    request: Request,
    age: int | None = None,
    *,
    bare: bool = False,
    species: Species | None = None,
    season: str = "summer",
) -> Group:
    """Grow the tree asked for and its neighbours; it is the first.

    Raises
    ------
    InputError
        If a number is out of its range, or a tree would stand in an obstacle.
    """
    from species import GrowthSettings, Plant, Site, grow_stand
    from treegraph import Occluders

    settings = GrowthSettings(tip_share=request.kind.tip_share)
    if request.max_nodes is not None:
        settings = replace(settings, max_nodes=request.max_nodes)
    places = [(0.0, 0.0, 0.0), *neighbour_places(request.neighbours, request.spacing)]
    trees = grow_stand(
        [Plant(request.kind.parameters, place) for place in places],
        request.kind.age if age is None else age,
        rng=np.random.default_rng(request.seed),
        site=Site(request.sky, Occluders(obstacles=request.obstacles)),
        settings=settings,
    )
    bare = bare or (species is not None and species.definition.is_bare(season))
    coarse = settings.tip_share > GrowthSettings().tip_share
    return Group(trees, request.obstacles, request.seed, bare, species, season, coarse)


def spread_ages(age: int, frames: int) -> list[int]:
    """So many ages up to `age`, as evenly as whole numbers allow, ascending and without repetition."""
    return sorted({max(1, round(age * (k + 1) / frames)) for k in range(frames)} | {age})


def grown_density(tree: ClusterTree, grown: TreeGraph, species: Species) -> NDArray[np.float64]:
    """Factor on a species' leaf area density for each cluster, so that it bears what has grown in the tree.

    Notes
    -----
    The tree's leaf area is shared among its clusters by their volumes.
    """
    from treegraph import hull_volumes

    volume = hull_volumes(tree.clusters)
    total = float(np.asarray(grown.attribute["leaf_area"], float).sum())
    wanted = species.definition.leaf_area_density * float(volume.sum())
    return np.full(len(volume), total / wanted if wanted > 0.0 else 1.0)


def as_cluster_tree(tree: GrownTree, leaves: Any = None, species: Species | None = None) -> ClusterTree:
    """A grown tree as ClusterTree: its graph, and its leaves, if they are given, in clusters."""
    from dataclasses import replace

    from species import gather_clusters
    from treegraph import DEFAULT_ALLOMETRY, ClusterTree

    clusters = () if leaves is None else gather_clusters(tree.tree, leaves)
    kind = DEFAULT_ALLOMETRY if species is None else species.definition.allometry
    allometry = replace(kind, d_root=2.0 * float(tree.tree.radius[0]))
    return ClusterTree(tree.tree, clusters, None if species is None else species.name, allometry, np.zeros(3))


def obstacle_parts(obstacles: Sequence[Obstacle], cloud: NDArray[np.float64]) -> list[Part]:
    """Obstacles as they are drawn; of an endless one the piece beside the points (n, 3) of trees."""
    import render

    material = render.Material("wall", WALL_COLOR, alpha=0.5, double_sided=True)
    return [
        render.Part(f"obstacle_{k}", _obstacle_mesh(obstacle, cloud), material)
        for k, obstacle in enumerate(obstacles)
    ]


def _obstacle_mesh(obstacle: Any, cloud: NDArray[np.float64]) -> Any:
    """The obstacle's surface as the scanner has it, every face with corners of its own: sharp edges."""
    import render
    from recon.scan_scenes import obstacle_scene
    from treegraph import HalfSpace

    if isinstance(obstacle, HalfSpace):
        is_wall = abs(float(obstacle.normal[2])) < UPRIGHT
        obstacle = (_piece_of_wall if is_wall else _piece_of_plane)(obstacle, cloud)
    solid = obstacle_scene(obstacle, near=cloud[0], reach=1.0)
    corner = solid.vertices[solid.faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    faces = np.arange(3 * len(corner), dtype=np.int32).reshape(-1, 3)
    return render.Mesh(corner.reshape(-1, 3), faces, np.repeat(normal, 3, axis=0).astype(np.float32))


def _piece_of_wall(wall: Any, cloud: NDArray[np.float64]) -> Any:
    """The part of an endless upright wall that stands beside the trees."""
    from treegraph import make_wall

    side = np.array([-wall.normal[1], wall.normal[0], 0.0])
    reach = cloud @ side
    height = float(np.ptp(cloud[:, 2])) * (1.0 + WALL_MARGIN) + WALL_THICKNESS
    middle = 0.5 * (reach.min() + reach.max())
    foot = wall.point + (middle - wall.point @ side) * side
    foot[2] = cloud[:, 2].min()
    width = float(np.ptp(reach)) + 2.0 * WALL_MARGIN * height
    return make_wall(foot, wall.normal, width=width, height=height, thickness=WALL_THICKNESS)


def _piece_of_plane(solid: Any, cloud: NDArray[np.float64]) -> Any:
    """The part of any other endless plane that is near the trees, as a plate."""
    from treegraph import Box

    middle = 0.5 * (cloud.min(axis=0) + cloud.max(axis=0))
    reach = float(np.ptp(cloud, axis=0).max()) * (1.0 + 2.0 * WALL_MARGIN) + WALL_THICKNESS
    foot = middle - ((middle - solid.point) @ solid.normal + WALL_THICKNESS / 2) * solid.normal
    side = np.linalg.svd(solid.normal[None])[2]
    side[0] = solid.normal
    side[2] = np.cross(side[0], side[1])
    return Box(foot, np.array([WALL_THICKNESS, reach, reach]), side.T)


def draw_grown(group: Group, path: Path | None = None, *, frame: Group | None = None, **look: Any) -> Any:
    """Draw the tree with its leaves, its neighbours and its obstacles.

    Parameters
    ----------
    group : Group
    path : path, optional
        Where the picture is written.
    frame : Group, optional
        Trees that would fit into the picture too: the same frame for all pictures of a series.
    **look
        As of :func:`render.preview`. By default a wall is seen from its end.

    Returns
    -------
    preview : render.Preview
    """
    import render

    widest = (frame or group).trees
    cloud = np.concatenate([tree.tree.position for tree in widest])
    more = group.parts() + obstacle_parts(group.obstacles, cloud)
    if frame is not None:
        points = np.concatenate([tree.tree.position for tree in frame.trees])
        empty = render.Mesh(points, np.zeros((0, 3), np.int32), np.zeros_like(points, np.float32))
        more.append(render.Part("frame", empty, render.Material("frame", (0.0, 0.0, 0.0))))
    walls = [o for o in group.obstacles if hasattr(o, "normal")]
    if look.get("azimuth") is None and walls:
        look["azimuth"] = math.atan2(-walls[0].normal[0], walls[0].normal[1])
    first = group.trees[0]
    if group.species is not None and not group.bare:
        return render.preview(as_cluster_tree(first), path, parts=more, **look)
    if first.tree.n_nodes > 1:
        more = [part for part in more if part.name != "wood"]  # which the preview makes itself
    return render.preview(as_cluster_tree(first), path, more=more, **look)


def write_grown(
    group: Group,
    path: str | os.PathLike[str],
    *,
    detail: str = "normal",
    force: bool = False,
    extras: dict[str, Any] | None = None,
    frame: Group | None = None,
    **look: Any,
) -> Any:
    """Write a grown tree in the format that the suffix of `path` names.

    Meshes (``.glb``, ``.obj``, ``.ply``) and pictures (``.png``, ``.jpg``) hold the neighbours too, pictures
    also the obstacles; ``.lobes``, ``.swc`` and ``.csv`` hold the first tree alone.

    Raises
    ------
    InputError
        If the suffix is none of these, the file exists and `force` is not set, or it cannot be written.

    Returns
    -------
    drawn : render.Preview or None
        Of a picture.
    """
    import render
    import treegraph
    from sapwood.trees import write_tree

    suffix, first = Path(path).suffix.lower(), group.trees[0]
    if suffix in PICTURES:
        drawn: list[Any] = []
        write_whole(path, lambda to: drawn.append(draw_grown(group, to, frame=frame, **look)), force=force)
        return drawn[0]
    if suffix == ".glb":
        write_whole(path, lambda to: render.write_glb(to, group.parts(detail), extras=extras), force=force)
    elif suffix == ".obj":
        write_whole(path, lambda to: render.write_obj(to, group.parts(detail)), force=force)
    elif suffix == ".ply":
        write_whole(path, lambda to: render.write_ply(to, group.parts(detail)), force=force)
    elif suffix == ".lobes":
        leaves = None if group.bare else group.leaves(0)
        tree = as_cluster_tree(first, leaves, group.species)
        write_whole(path, lambda to: treegraph.write_lobes(tree, to), force=force)
    elif suffix in (".swc", ".csv"):
        write_tree(as_cluster_tree(first), path, local=True, force=force)
    else:
        raise InputError(f"{os.fspath(path)}: the name must end in one of {' '.join(GROWN_SUFFIXES)}.")
    return None
