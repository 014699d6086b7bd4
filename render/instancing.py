"""A decoded tree: its branches, and its patches put where the instances say; as tables or as one mesh.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, sections 3.4 (geometry from the cluster-based representation) and 3.5.2 (level of detail).
Departs from it in: patches are instanced by whoever draws them, or written out vertex by vertex here.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.levels import check_share, thickest_edges
from render.mesh import MAX_VERTICES, Mesh, MeshSettings, branch_mesh
from render.parts import WOOD, Material, Part, tile_bark
from render.patchmesh import BladeSettings, PatchMesh, patch_meshes
from species.patches import Instances, Patch
from treegraph import InputError, TreeGraph

__all__ = ["FOLIAGE", "DecodedTree", "Foliage", "decode_tree", "flat_parts", "make_foliage"]

FOLIAGE = Material("leaf", (0.36, 0.50, 0.20), roughness=0.8, double_sided=True)
THREADS = 2
LEAST_SHARED = 20_000  # vertices below which more threads do not help


@dataclass(frozen=True, eq=False)
class Foliage:
    """The patches of a species, meshed at one level of detail; shared by all its trees.

    Attributes
    ----------
    meshes : tuple of PatchMesh
        One for each patch of the species, in their order.
    twigs : tuple of Mesh
        Their twigs, with texture coordinates that fit the bark (:func:`render.parts.tile_bark`).
    bark, leaf : Material
        Of branches and twigs, and of leaves.
    share : float
        The level: part of the leaves and edges that is kept.
    """

    meshes: tuple[PatchMesh, ...]
    twigs: tuple[Mesh, ...]
    bark: Material
    leaf: Material
    share: float
    _twigs: _Template
    _leaves: _Template

    def __repr__(self) -> str:
        return f"<Foliage {len(self.meshes)} patches, share {self.share:g}>"


@dataclass(frozen=True, eq=False)
class DecodedTree:
    """A tree as its branch mesh and one table of instances for each patch.

    Attributes
    ----------
    wood : Mesh
        The branches of the graph.
    foliage : Foliage
        The patches.
    start : (p + 1,) int64
        Rows ``start[g]:start[g + 1]`` of the tables are the instances of patch g, in the order of detail.
    row : (k,) int32
        Which of the :class:`species.patches.Instances` each is.
    position : (k, 3) float32
        Metres, z up.
    rotation : (k, 4) float32
        Unit quaternions x, y, z, w.
    scale : (k,) float32
        > 0.
    """

    wood: Mesh
    foliage: Foliage
    start: NDArray[np.int64]
    row: NDArray[np.int32]
    position: NDArray[np.float32]
    rotation: NDArray[np.float32]
    scale: NDArray[np.float32]

    def __repr__(self) -> str:
        return f"<DecodedTree {self.n_instances} instances, {self.n_faces} faces>"

    @property
    def n_instances(self) -> int:
        """Number of patches that are put in place."""
        return len(self.scale)

    @property
    def n_faces(self) -> int:
        """Triangles of the whole tree, every instance counted."""
        each = np.array([mesh.n_faces for mesh in self.foliage.meshes], np.int64)
        return len(self.wood.faces) + int(np.diff(self.start) @ each)

    @property
    def n_leaves(self) -> int:
        """Leaves of the whole tree, at this level."""
        each = np.array([mesh.n_leaves for mesh in self.foliage.meshes], np.int64)
        return int(np.diff(self.start) @ each)

    @property
    def leaf_area(self) -> float:
        """One side of all leaves, m2: the blades' quads, less what the texture cuts away."""
        blade = np.array([mesh.blade_area for mesh in self.foliage.meshes])
        patch = np.repeat(np.arange(len(blade)), np.diff(self.start))
        leaf = self.foliage.leaf
        there = 1.0
        if leaf.texture is not None and leaf.alpha_cutoff is not None:
            there = leaf.texture.coverage(leaf.alpha_cutoff)
        return there * float(blade[patch] @ self.scale.astype(np.float64) ** 2)


@dataclass(frozen=True, eq=False)
class _Template:
    """The meshes of all patches one after the other, in single precision: what the kernels read.

    ``vertices`` and ``normals`` are (3, v), ``uv`` and ``color`` flat, ``faces`` (f, 3).
    """

    vertex_start: NDArray[np.int64]
    face_start: NDArray[np.int64]
    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    color: NDArray[np.uint8] | None
    faces: NDArray[np.int32]


def make_foliage(
    patches: Sequence[Patch] | Sequence[PatchMesh],
    *,
    share: float = 1.0,
    bark: Material = WOOD,
    leaf: Material = FOLIAGE,
    blade: BladeSettings | None = None,
    settings: MeshSettings | None = None,
) -> Foliage:
    """Mesh a species' patches, once for all trees of the species.

    Parameters
    ----------
    patches : sequence of Patch, or of PatchMesh
        Meshes are taken as they are; `share` then says at what level they were made.
    share : float
        Part of the leaves and of the branch edges that is kept, above 0 to 1; leaf area stays.
    bark, leaf : Material
        What branches and leaves look like.
    blade, settings
        As in :func:`render.patchmesh.patch_mesh`.

    Returns
    -------
    foliage : Foliage

    Raises
    ------
    InputError
        If there is no patch, or `share` is out of its range.
    """
    share = check_share("share", share)
    if not len(patches):
        raise InputError("foliage needs at least one patch, got none")
    ready = [mesh for mesh in patches if isinstance(mesh, PatchMesh)]
    bare = [patch for patch in patches if isinstance(patch, Patch)]
    if len(ready) not in (0, len(patches)) or len(ready) + len(bare) != len(patches):
        raise InputError("patches must all be Patch or all be PatchMesh")
    meshes = tuple(ready) if ready else patch_meshes(bare, share, blade=blade, settings=settings)
    twigs = tuple(tile_bark(mesh.twigs, bark) for mesh in meshes)
    leaves = _template([mesh.leaves for mesh in meshes])
    return Foliage(meshes, twigs, bark, leaf, share, _template(twigs), leaves)


def decode_tree(
    graph: TreeGraph,
    instances: Instances,
    foliage: Foliage,
    *,
    settings: MeshSettings | None = None,
    keep: NDArray[np.integer] | None = None,
) -> DecodedTree:
    """Make a tree's branches, and sort its instances by patch.

    Parameters
    ----------
    graph : TreeGraph
        Every radius must be known. The thickest edges are meshed, as many as the foliage's level says.
    instances : Instances
        ``instances.patch`` are rows of `foliage`.
    foliage : Foliage
    settings : MeshSettings, optional
        How finely the branches are meshed.
    keep : (k,) int, optional
        Nodes of the graph that are meshed at every level, with all that they grow from: those that bear
        instances.

    Returns
    -------
    tree : DecodedTree

    Raises
    ------
    InputError
        If an instance is of a patch that is not there.
    TreeError
        If a radius is unknown.
    """
    from render import _instance_kernels as kernels

    n, n_patches = len(instances), len(foliage.meshes)
    if n and not 0 <= instances.patch.min() <= instances.patch.max() < n_patches:
        bad = np.flatnonzero((instances.patch < 0) | (instances.patch >= n_patches))
        raise InputError(
            f"patch must be 0 to {n_patches - 1}, the rows of the foliage, but patch[{bad[0]}] is "
            f"{instances.patch[bad[0]]}; {bad.size} of {n} instances break this"
        )
    thick, node = thickest_edges(graph, foliage.share, keep)
    wood = tile_bark(branch_mesh(thick, settings), foliage.bark)
    if len(node) < graph.n_nodes and wood.node is not None:
        wood.node[:] = node[wood.node]
    start, row = np.empty(n_patches + 1, np.int64), np.empty(n, np.int32)
    position, rotation = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    scale = np.empty(n, np.float32)
    kernels.sort_instances(
        instances.patch, instances.order, instances.position, instances.rotation, instances.scale,
        start, row, position, rotation, scale,
    )  # fmt: skip
    return DecodedTree(wood, foliage, start, row, position, rotation, scale)


def flat_parts(tree: DecodedTree) -> tuple[Part, ...]:
    """The whole tree as meshes, every vertex in its place: what programs without instancing read.

    Returns
    -------
    parts : tuple of Part
        ``"wood"``, ``"twigs"`` and ``"leaves"``, those that have a face. Twigs and leaves come patch by
        patch, instance by instance as in the tables, in single precision.

    Raises
    ------
    InputError
        If there are more vertices than a mesh can number.
    """
    foliage = tree.foliage
    parts = [Part("wood", tree.wood, foliage.bark)]
    for name, template, material in (
        ("twigs", foliage._twigs, foliage.bark),
        ("leaves", foliage._leaves, foliage.leaf),
    ):
        mesh = _flatten(tree, template)
        parts.append(Part(name, mesh, material))
    return tuple(part for part in parts if len(part.mesh.faces))


def _flatten(tree: DecodedTree, template: _Template) -> Mesh:
    from render import _instance_kernels as kernels

    n = tree.n_instances
    patch = np.repeat(np.arange(len(tree.start) - 1), np.diff(tree.start))
    vertex_at = _offsets(np.diff(template.vertex_start)[patch])
    face_at = _offsets(np.diff(template.face_start)[patch])
    n_vertices, n_faces = int(vertex_at[-1]), int(face_at[-1])
    if max(n_vertices, n_faces) > MAX_VERTICES:
        raise InputError(f"the flat mesh would have {n_vertices} vertices; lower the share of leaves")
    vertices, normals = np.empty((n_vertices, 3), np.float32), np.empty((n_vertices, 3), np.float32)
    uv, faces = np.empty((n_vertices, 2), np.float32), np.empty((n_faces, 3), np.int32)
    color = None if template.color is None else np.empty((n_vertices, 3), np.uint8)

    def place(first: int, last: int) -> None:
        rows = (first, last, patch)
        kernels.place_vertices(
            *rows, tree.position, tree.rotation, tree.scale, template.vertex_start,
            template.vertices, template.normals, vertex_at, vertices.reshape(-1), normals.reshape(-1),
        )  # fmt: skip
        kernels.place_faces(*rows, template.face_start, template.faces, face_at, vertex_at, faces)
        kernels.repeat_rows(*rows, template.vertex_start, template.uv, vertex_at, 2, uv.reshape(-1))
        if color is not None:
            kernels.repeat_rows(*rows, template.vertex_start, template.color, vertex_at, 3, color.reshape(-1))

    if n_vertices < LEAST_SHARED:
        place(0, n)
    else:
        cuts = np.searchsorted(vertex_at, np.linspace(0, n_vertices, THREADS + 1)[1:-1])
        edges = [0, *(int(cut) for cut in cuts), n]
        with ThreadPoolExecutor(max_workers=THREADS) as pool:
            list(pool.map(place, edges[:-1], edges[1:]))
    return Mesh(vertices=vertices, faces=faces, normals=normals, uv=uv, color=color)


def _template(meshes: Sequence[Mesh]) -> _Template:
    def joined(arrays: list[Any], dtype: Any) -> NDArray[Any]:
        return np.ascontiguousarray(np.concatenate(arrays), dtype=dtype)

    colored = all(mesh.color is not None for mesh in meshes)
    uv = [np.zeros((len(mesh.vertices), 2)) if mesh.uv is None else mesh.uv for mesh in meshes]
    return _Template(
        _offsets(np.array([len(mesh.vertices) for mesh in meshes])),
        _offsets(np.array([len(mesh.faces) for mesh in meshes])),
        np.ascontiguousarray(joined([mesh.vertices for mesh in meshes], np.float32).T),
        np.ascontiguousarray(joined([mesh.normals for mesh in meshes], np.float32).T),
        joined(uv, np.float32).reshape(-1),
        joined([mesh.color for mesh in meshes], np.uint8).reshape(-1) if colored else None,
        joined([mesh.faces for mesh in meshes], np.int32),
    )


def _offsets(count: NDArray[Any]) -> NDArray[np.int64]:
    out = np.zeros(len(count) + 1, np.int64)
    np.cumsum(count, out=out[1:])
    return out
