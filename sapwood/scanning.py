"""From a tree or a mesh to the scene that the virtual scanner looks at."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from recon.scan_scenes import LEAF, NONE, WOOD, Scene, join_scenes, make_scene
from treegraph.clustertree import ClusterTree
from treegraph.errors import FormatError, InputError, TreeError
from treegraph.graph import NO_PARENT, TreeGraph

if TYPE_CHECKING:
    from render import Mesh
    from sapwood.meshes import MeshPart
    from treegraph import Cluster

__all__ = ["LEAF_AREA_DENSITY", "LEAF_LENGTH", "Foliage", "TreeScene", "fill_with_leaves", "scene_of"]

LEAF_AREA_DENSITY = 2.0  # m2 of one side of the leaves in a m3 of hull; broad-leaved crowns have 0.5 to 4
LEAF_LENGTH = 0.065  # metres, mean
LEAF_LENGTH_SPREAD = 0.2  # leaves are up to this share longer or shorter than the mean, uniformly
LEAF_WIDTH = 0.6  # of the length, at its middle: a leaf is a rhombus
MAX_LEAVES = 8_000_000
MAX_ROUNDS = 400  # of drawing points in a hull's box: for hulls that fill a hundredth of it

SLENDER = 200.0  # metres of path per metre of radius along which sway grows to 63%
WOOD_WORDS = ("bark", "wood", "trunk", "stem", "branch", "twig", "log", "limb")
LEAF_WORDS = ("leaf", "leaves", "foliage", "needle", "cluster", "crown", "frond", "flower", "blossom")
NUMBERED = re.compile(r"(?:wood|leaves|clusters)_(\d{1,6})")  # parts of the other trees in a file of `grow`


@dataclass(frozen=True)
class Foliage:
    """What stands for the leaves of a cluster.

    Attributes
    ----------
    density : float
        One-sided leaf area in a cubic metre of hull, m2/m3, >= 0.
    length : float
        Mean length of a leaf, metres, > 0; it is 0.6 of it wide.
    """

    density: float = LEAF_AREA_DENSITY
    length: float = LEAF_LENGTH

    def __post_init__(self) -> None:
        if not 0.0 <= self.density < np.inf:
            raise InputError(f"leaf density must be a finite number of m2/m3 >= 0, got {self.density!r}")
        if not 0.0 < self.length < np.inf:
            raise InputError(f"leaf length must be a positive number of metres, got {self.length!r}")

    @property
    def leaf_area(self) -> float:
        """Mean area of one side of a leaf, m2."""
        return 0.5 * LEAF_WIDTH * self.length**2 * (1.0 + LEAF_LENGTH_SPREAD**2 / 3.0)


@dataclass(frozen=True, eq=False)
class TreeScene:
    """A tree as triangles, and what is to be said about it.

    Attributes
    ----------
    scene : Scene
    graph : TreeGraph or None
        To whose nodes ``scene.node_id`` belongs, if there is one.
    notes : tuple of str
    """

    scene: Scene
    graph: TreeGraph | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def foot(self) -> NDArray[np.float64]:
        """Middle of the lowest wood (of the lowest triangles, if there is no wood), (3,) metres."""
        scene = self.scene
        rows = scene.faces[scene.part == WOOD]
        place = scene.vertices[np.unique(rows if len(rows) else scene.faces)]
        low = place[place[:, 2] <= place[:, 2].min() + 0.02 * np.ptp(place[:, 2])]
        return np.append(0.5 * (low.min(axis=0) + low.max(axis=0))[:2], place[:, 2].min())


def scene_of(
    source: str | os.PathLike[str] | TreeGraph | ClusterTree,
    *,
    leaf_off: bool = False,
    foliage: Foliage | None = None,
    seed: int | np.random.Generator = 0,
    tree_id: int = 1,
    detail: str = "fine",
    up: str | None = None,
    scale: float = 1.0,
    wood_names: Sequence[str] = (),
    leaf_names: Sequence[str] = (),
) -> TreeScene:
    """The triangles of a tree with their labels, as the virtual scanner takes them.

    Parameters
    ----------
    source : path, TreeGraph or ClusterTree
        A ``.lobes`` or ``.swc`` file, a ``.glb``, ``.obj`` or ``.ply`` mesh, or a tree from memory. The wood
        of a graph is its branch mesh, with the node of every triangle; clusters are filled with leaves.
    leaf_off : bool
        Without leaves.
    foliage : Foliage, optional
        Of clusters.
    seed : int or numpy.random.Generator, default 0
        Of the leaves in clusters.
    tree_id : int
        Number of the tree; neighbours in a mesh that ``grow`` wrote get the numbers after it.
    detail : {"fine", "normal", "coarse"}
        Of the branch mesh.
    up, scale
        Of a mesh file, as ``sapwood.meshes.read_mesh`` takes them.
    wood_names, leaf_names : sequence of str
        Parts of a mesh whose material, geometry or group holds one of these words are wood, or leaves,
        whatever else they are called. Without them words like bark and leaf tell; what nothing tells is wood.

    Returns
    -------
    tree : TreeScene

    Raises
    ------
    InputError
        If there is no such file, nothing is left to scan, or a radius of the graph is unknown.
    FormatError
        If the file is damaged.
    """
    rng = np.random.default_rng(seed)
    foliage = foliage or Foliage()
    if isinstance(source, ClusterTree):
        return _of_clusters(source, leaf_off, foliage, rng, tree_id, detail)
    if isinstance(source, TreeGraph):
        return TreeScene(_wood(source, tree_id, detail), source)
    suffix = Path(source).suffix.lower()
    if suffix == ".lobes":
        from sapwood.trees import read_tree

        return _of_clusters(read_tree(source), leaf_off, foliage, rng, tree_id, detail)
    if suffix == ".swc":
        graph = _read_graph(os.fspath(source))
        return TreeScene(_wood(graph, tree_id, detail), graph)
    from sapwood.meshes import MESH_SUFFIXES, read_mesh

    if suffix not in MESH_SUFFIXES:
        known = " ".join((".lobes", ".swc", *MESH_SUFFIXES))
        raise InputError(f"{os.fspath(source)}: what is to be scanned must end in one of {known}.")
    parts = read_mesh(source, up=up, scale=scale)
    return _of_parts(os.fspath(source), parts, leaf_off, tree_id, wood_names, leaf_names)


def fill_with_leaves(
    clusters: Sequence[Cluster], foliage: Foliage, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Leaves inside hulls: uniformly spread, their normals in all directions alike.

    A leaf is a flat rhombus of two triangles. Their number follows from the volume of the hull; hulls that
    overlap are both filled.

    Returns
    -------
    corner : (n, 4, 3) float64
        Base, side, tip and other side of each leaf, metres.
    cluster : (n,) int64
        Whose leaf it is.
    """
    volume = np.array([_volume(cluster) for cluster in clusters])
    count = np.rint(volume * foliage.density / foliage.leaf_area).astype(np.int64)
    if count.sum() > MAX_LEAVES:
        raise InputError(
            f"the hulls of {volume.sum():.0f} m3 would hold {count.sum()} leaves, more than {MAX_LEAVES}; "
            "make the leaves longer or their density lower"
        )
    middle = [_points_inside(cluster, int(n), rng) for cluster, n in zip(clusters, count, strict=True)]
    owner = np.repeat(np.arange(len(clusters)), [len(points) for points in middle])
    n = owner.size
    u, w = rng.normal(size=(2, n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(u, w)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    length = foliage.length * rng.uniform(1.0 - LEAF_LENGTH_SPREAD, 1.0 + LEAF_LENGTH_SPREAD, (n, 1))
    along, across = 0.5 * length * u, 0.5 * LEAF_WIDTH * length * v
    place = np.concatenate([np.empty((0, 3)), *middle])
    return np.stack([place - along, place + across, place + along, place - across], axis=1), owner


def node_sway(graph: TreeGraph) -> NDArray[np.float64]:
    """How far the nodes of a graph go with the wind, (n,), 0 at the roots, below 1.

    ``1 - exp(-s)``, where s is the sum of length over 200 radii along the way from the root: it grows with
    the height above the ground and the thinner the branches are, and nothing comes apart at a fork.
    """
    step = np.linalg.norm(graph.position - graph.position[np.maximum(graph.parent, 0)], axis=1)
    step = step / (SLENDER * np.maximum(graph.radius, 1e-3))
    total = np.zeros(graph.n_nodes)
    for i, parent in enumerate(graph.parent.tolist()):
        if parent != NO_PARENT:
            total[i] = total[parent] + step[i]
    return 1.0 - np.exp(-total)


def _of_clusters(
    tree: ClusterTree, leaf_off: bool, foliage: Foliage, rng: np.random.Generator, tree_id: int, detail: str
) -> TreeScene:
    wood = _wood(tree.graph, tree_id, detail)
    clusters = [cluster for cluster in tree.clusters if len(cluster.faces)]
    if leaf_off or not clusters or foliage.density == 0.0:
        return TreeScene(wood, tree.graph)
    corner, owner = fill_with_leaves(clusters, foliage, rng)
    if not owner.size:
        return TreeScene(wood, tree.graph)
    node = np.full(owner.size, NONE, np.int32)
    middle = corner.mean(axis=1)
    for k, cluster in enumerate(clusters):
        mine = np.flatnonzero(owner == k)
        if mine.size and cluster.seed.size:
            from scipy.spatial import cKDTree

            node[mine] = cluster.seed[cKDTree(tree.graph.position[cluster.seed]).query(middle[mine])[1]]
    sway = np.where(node == NONE, 1.0, node_sway(tree.graph)[node])
    faces = 4 * np.arange(owner.size)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    leaves = make_scene(
        corner.reshape(-1, 3), faces.reshape(-1, 3), LEAF, tree_id=tree_id, node_id=node.repeat(2),
        sway=sway.repeat(4),
    )  # fmt: skip
    return TreeScene(join_scenes([wood, leaves]), tree.graph)


def _wood(graph: TreeGraph, tree_id: int, detail: str) -> Scene:
    """The branch mesh of a graph; each triangle knows the node whose segment it belongs to."""
    import render

    try:
        mesh = render.branch_mesh(graph, render.DETAIL[detail])
    except TreeError as error:
        raise InputError(str(error)) from None
    if not len(mesh.faces):
        raise InputError("the tree has no length: there is no wood to scan")
    sway = node_sway(graph)[mesh.node]
    return make_scene(mesh.vertices, mesh.faces, WOOD, tree_id=tree_id, node_id=face_nodes(mesh), sway=sway)


def face_nodes(mesh: Mesh) -> NDArray[np.int32]:
    """Node whose segment (parent to node) each triangle of a branch mesh lies on, (f,).

    A triangle between two rings lies on the segment of the outer one: of the larger node, as parents come
    before their children.
    """
    if mesh.node is None:
        raise InputError("mesh must have the nodes of its vertices, as branch_mesh gives them")
    return mesh.node[mesh.faces].max(axis=1)


def _read_graph(name: str) -> TreeGraph:
    import treegraph

    try:
        return treegraph.read_swc(name)
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file.") from None
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None
    except (FormatError, TreeError) as error:
        text = str(error)
        raise FormatError(text if text.startswith(name) else f"{name}: {text}") from None


def _of_parts(
    name: str,
    parts: Sequence[MeshPart],
    leaf_off: bool,
    tree_id: int,
    wood_names: Sequence[str],
    leaf_names: Sequence[str],
) -> TreeScene:
    """The scene of a mesh file: wood and leaves told by the names of its parts."""
    scenes: list[Scene] = []
    unknown: list[str] = []
    hulls = False
    low = min(part.vertices[:, 2].min() for part in parts)
    high = max(part.vertices[:, 2].max() for part in parts)
    for part in parts:
        kind = _kind_of(part.names, wood_names, leaf_names)
        if kind is None:
            unknown.append(" ".join(part.names) or "a part without a name")
        hulls |= kind == LEAF and any(word.startswith("clusters") for word in part.names)
        if kind == LEAF and leaf_off:
            continue
        numbers = [int(m[1]) for m in map(NUMBERED.fullmatch, part.names) if m]
        sway = ((part.vertices[:, 2] - low) / max(high - low, 1e-9)) ** 2
        number = tree_id + (numbers[0] if numbers else 0)
        scenes.append(make_scene(part.vertices, part.faces, kind or WOOD, tree_id=number, sway=sway))
    if not scenes:
        raise InputError(f"{name}: without its leaves nothing is left to scan; name the wood (--wood-name).")
    notes = []
    if unknown:
        shown = ", ".join(unknown[:4]) + (f" and {len(unknown) - 4} more" if len(unknown) > 4 else "")
        notes.append(f"taken as wood, as nothing says what it is: {shown} (--leaf-name, --wood-name)")
    if hulls and not leaf_off:
        notes.append("the leaf clusters of this mesh are closed hulls; scan the .lobes file for leaves")
    return TreeScene(join_scenes(scenes), None, tuple(notes))


def _kind_of(names: Sequence[str], wood_names: Sequence[str], leaf_names: Sequence[str]) -> int | None:
    """WOOD or LEAF by the names of a part, the material's first; None if they do not tell."""
    text = [name.lower() for name in reversed(names)]
    for leaf_words, wood_words in ((leaf_names, wood_names), (LEAF_WORDS, WOOD_WORDS)):
        for name in text:
            for words, kind in ((leaf_words, LEAF), (wood_words, WOOD)):
                if any(word.lower() in name for word in words):
                    return kind
    return None


def _volume(cluster: Cluster) -> float:
    corner = (cluster.vertices - cluster.vertices.mean(axis=0))[cluster.faces]
    return abs(float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0))


def _points_inside(cluster: Cluster, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Points (count, 3) in a closed hull, uniformly: those of its box that are inside."""
    import open3d

    if count == 0:
        return np.empty((0, 3))
    low, high = cluster.vertices.min(axis=0), cluster.vertices.max(axis=0)
    tensor: Any = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        tensor((cluster.vertices - low).astype(np.float32)), tensor(cluster.faces.astype(np.uint32))
    )
    share = min(1.0, max(_volume(cluster) / max(float(np.prod(high - low)), 1e-12), 0.01))
    found: list[NDArray[np.float64]] = []
    missing = count
    for _ in range(MAX_ROUNDS):
        point = rng.uniform(0.0, 1.0, (int(1.1 * missing / share) + 16, 3)) * (high - low)
        inside = scene.compute_occupancy(tensor(point.astype(np.float32))).numpy() > 0.5
        found.append(low + point[inside][:missing])
        missing -= len(found[-1])
        if missing == 0:
            break
    return np.concatenate(found)
