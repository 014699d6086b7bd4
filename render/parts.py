"""What a tree looks like: named meshes with a material each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from render.mesh import Mesh, MeshSettings, branch_mesh
from render.textures import Texture, check_texture
from treegraph import Cluster, ClusterTree, InputError

__all__ = ["LEAF", "WOOD", "Material", "Part", "hull_mesh", "tile_bark", "tree_parts"]

ROUND_SHARE = 0.35  # how far a hull's normals lean from its surface to the rays from its middle
GOLDEN = 0.6180339887498949  # steps of it spread evenly over the unit interval: one shade per cluster
LIGHTNESS_SPREAD = 0.16
WARMTH_SPREAD = 0.10


@dataclass(frozen=True)
class Material:
    """A surface's look, in the terms of glTF's metallic-roughness model.

    Attributes
    ----------
    name : str
        Name in the exported file.
    color : (float, float, float)
        sRGB base colour, 0 to 1; multiplied with the mesh's own colours where it has some.
    alpha : float
        Opacity, 0 to 1; below 1 the surface is blended.
    roughness : float
        0 (mirror) to 1 (matt).
    double_sided : bool
        Whether its back is drawn too.
    texture : Texture or None
        Image that `color` is multiplied with; the mesh needs texture coordinates.
    alpha_cutoff : float or None
        The surface is there where the texture's alpha is at least this, 0 to 1; None: everywhere.
    normal_texture : Texture or None
        Normal map (glTF's: x to the right, y up in the image); for exports.
    tile : float
        Of bark: width and height that the texture covers, metres, > 0. See :func:`render.parts.tile_bark`.
    """

    name: str
    color: tuple[float, float, float]
    alpha: float = 1.0
    roughness: float = 0.9
    double_sided: bool = False
    texture: Texture | None = None
    alpha_cutoff: float | None = None
    normal_texture: Texture | None = None
    tile: float = 1.0

    def __post_init__(self) -> None:
        color = tuple(float(c) for c in self.color)
        if len(color) != 3 or not all(0.0 <= c <= 1.0 for c in color):
            raise InputError(f"a material's color must be three numbers from 0 to 1, got {self.color!r}")
        for name in ("alpha", "roughness"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"a material's {name} must be 0 to 1, got {getattr(self, name)!r}")
        if self.alpha_cutoff is not None and not 0.0 < self.alpha_cutoff <= 1.0:
            raise InputError(
                f"a material's alpha_cutoff must be above 0 and at most 1, got {self.alpha_cutoff!r}"
            )
        if not 0.0 < self.tile < np.inf:
            raise InputError(f"a material's tile must be a length > 0 metres, got {self.tile!r}")
        check_texture("texture", self.texture)
        check_texture("normal_texture", self.normal_texture)
        if self.alpha_cutoff is not None and (self.texture is None or not self.texture.has_alpha):
            raise InputError("a material with an alpha_cutoff needs a texture with four channels")
        object.__setattr__(self, "color", color)


WOOD = Material("bark", (0.46, 0.40, 0.345))
LEAF = Material("leaves", (0.38, 0.52, 0.23), alpha=0.9, roughness=0.8, double_sided=True)


@dataclass(frozen=True, eq=False)
class Part:
    """A named mesh with its material."""

    name: str
    mesh: Mesh
    material: Material


def tile_bark(mesh: Mesh, material: Material) -> Mesh:
    """Texture coordinates with which a bark image covers `material.tile` metres along each tube.

    Around a tube it is repeated a whole number of times, at least once, as fits the tube's thickest ring
    best: so it has no seam. A mesh is returned as it is if the material has no texture, or if it is no tubes.
    """
    textured = material.texture is not None or material.normal_texture is not None
    if not textured or mesh.uv is None or mesh.piece_start is None or not len(mesh.faces):
        return mesh
    from render import _instance_kernels as kernels

    first = mesh.faces[:, 0]  # the least vertex of a tube is the first corner of one of its faces
    start = np.append(np.minimum.reduceat(first, mesh.piece_start[:-1]), len(mesh.vertices))
    uv = mesh.uv.copy()
    kernels.wrap_tubes(mesh.vertices, start, float(material.tile), uv)
    return replace(mesh, uv=uv)


def tree_parts(tree: ClusterTree, settings: MeshSettings | None = None) -> tuple[Part, ...]:
    """The parts of which a tree is drawn: its wood, and its leaf clusters as shaded hulls.

    Parameters
    ----------
    tree : ClusterTree
        Every radius of its graph must be known.
    settings : MeshSettings, optional
        How finely the branches are meshed.

    Returns
    -------
    parts : tuple of Part
        ``"wood"`` and, if there are clusters, ``"clusters"`` (one mesh, one piece per cluster, with vertex
        colours that differ a little from cluster to cluster).

    Raises
    ------
    TreeError
        If a radius is unknown.
    """
    parts = [Part("wood", branch_mesh(tree.graph, settings), WOOD)]
    hulls = hull_mesh(tree.clusters)
    if len(hulls.faces):
        parts.append(Part("clusters", hulls, LEAF))
    return tuple(parts)


def hull_mesh(clusters: Sequence[Cluster]) -> Mesh:
    """One mesh of all cluster hulls, each in its own shade.

    Parameters
    ----------
    clusters : sequence of Cluster
        Those without a face are left out.

    Returns
    -------
    mesh : Mesh
        Vertex normals are angle-weighted and lean a little away from the hull's middle, which lets a coarse
        hull look round. ``mesh.color`` is relative: it is multiplied with the material's colour.
    """
    kept = [(k, cluster) for k, cluster in enumerate(clusters) if len(cluster.faces)]
    counts = np.array([len(c.vertices) for _, c in kept], np.int64)
    offset = np.concatenate([[0], np.cumsum(counts)])
    faces = [c.faces + offset[i] for i, (_, c) in enumerate(kept)]
    colors = [np.tile(_shade(k), (len(c.vertices), 1)) for k, c in kept]
    return Mesh(
        vertices=np.concatenate([np.zeros((0, 3)), *(c.vertices for _, c in kept)]),
        faces=np.concatenate([np.zeros((0, 3), np.int32), *faces]).astype(np.int32),
        normals=np.concatenate([np.zeros((0, 3), np.float32), *(_hull_normals(c) for _, c in kept)]),
        color=np.concatenate([np.zeros((0, 3), np.uint8), *colors]),
        piece_start=np.concatenate([[0], np.cumsum([len(f) for f in faces])]).astype(np.int64),
    )


def _shade(index: int) -> NDArray[np.uint8]:
    """Relative colour of a cluster: a little darker, and a little cooler or warmer, than the material."""
    light = 1.0 - LIGHTNESS_SPREAD * ((index * GOLDEN) % 1.0)
    warmth = WARMTH_SPREAD * (((index + 0.5) * GOLDEN * GOLDEN) % 1.0 - 0.5)
    factor = np.array([light * (1.0 + warmth), light, light * (1.0 - warmth)])
    return np.rint(255.0 * np.clip(factor, 0.0, 1.0)).astype(np.uint8)


def _hull_normals(cluster: Cluster) -> NDArray[np.float32]:
    """Angle-weighted vertex normals, leaning away from the middle."""
    corner = cluster.vertices[cluster.faces]
    total = np.zeros_like(cluster.vertices)
    side = _unit(np.roll(corner, -1, axis=1) - corner)
    flat = _unit(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    for k in range(3):
        cosine = -np.einsum("ij,ij->i", side[:, k], side[:, k - 1])
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        np.add.at(total, cluster.faces[:, k], angle[:, None] * flat)
    middle = cluster.vertices[np.unique(cluster.faces)].mean(axis=0)
    total = (1.0 - ROUND_SHARE) * _unit(total) + ROUND_SHARE * _unit(cluster.vertices - middle)
    return _unit(total).astype(np.float32)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors scaled to length one; (0, 0, 1) for those without length."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(length > 0.0, vector / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))
