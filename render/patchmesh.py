"""Patches as meshes: their twigs as tubes, their leaves as textured blades.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, sections 3.5.2 (leaves of a patch in a fixed random order) and 6.1.5 (leaves as textured
quads, refined to curved surfaces).
Departs from it in: a blade is bent along a circle and folded along its midrib, where the thesis has bicubic
surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from render.foliage import leaf_shades
from render.levels import check_share, lod_leaves, thickest_edges
from render.mesh import Mesh, MeshSettings, branch_mesh
from species.foliage import LeafSet
from species.patches import Patch
from treegraph import InputError

__all__ = ["TWIGS", "BladeSettings", "PatchMesh", "blade_mesh", "patch_mesh", "patch_meshes"]

TWIGS = MeshSettings(sides=6, min_sides=3, steps=1, tolerance=0.003, ring_error=0.3, min_radius=0.0004)
"""How finely twigs are meshed where nothing else is asked for."""

MOST_ACROSS, MOST_ALONG = 2, 8


@dataclass(frozen=True)
class BladeSettings:
    """How a leaf's blade is cut into quads and bent.

    Attributes
    ----------
    across : int
        Quads side by side, 1 or 2.
    along : int
        Quads from base to tip, 1 to 8.
    fold : float
        Angle by which either half rises above the midrib's plane, radians, 0 to 1.5; needs `across` 2.
    bend : float
        Angle by which the tip points further down than the base, radians, -3 to 3; needs `along` 2 or more.
    box : (float, float, float, float)
        Left, bottom, right and top of the image: from the midrib in widths of the leaf, from the leaf's base
        in lengths. An image with a margin, or of a lopsided leaf, reaches elsewhere than the leaf does.
    """

    across: int = 1
    along: int = 1
    fold: float = 0.0
    bend: float = 0.0
    box: tuple[float, float, float, float] = (-0.5, 0.0, 0.5, 1.0)

    def __post_init__(self) -> None:
        rules = (
            ("across", 1 <= self.across <= MOST_ACROSS, f"be 1 to {MOST_ACROSS}"),
            ("along", 1 <= self.along <= MOST_ALONG, f"be 1 to {MOST_ALONG}"),
            ("fold", 0.0 <= self.fold <= 1.5, "be an angle of 0 to 1.5 radians"),
            ("fold", self.fold == 0.0 or self.across == 2, "be 0 unless across is 2"),
            ("bend", -3.0 <= self.bend <= 3.0, "be an angle of -3 to 3 radians"),
            ("bend", self.bend == 0.0 or self.along > 1, "be 0 unless along is 2 or more"),
        )
        for name, good, rule in rules:
            if not good:
                raise InputError(f"{name} must {rule}, got {getattr(self, name)!r}")
        box = tuple(float(side) for side in self.box)
        inside = len(box) == 4 and np.isfinite(box).all() and box[0] < 0.0 < box[2] and box[1] < box[3]
        if not inside:
            raise InputError(
                f"box must have the midrib between left and right, and a height, got {self.box!r}"
            )
        object.__setattr__(self, "box", box)

    def area(self, width_share: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Of the quads, over the leaf's length times its width.

        A blade that is folded and bent at once depends on the leaf's width over its length, `width_share`:
        its sides run on another circle than its midrib.
        """
        left, bottom, right, top = self.box
        half = 0.5 * self.bend / self.along  # of the angle from one quad to the next
        across = np.hypot(np.cos(self.fold), np.sin(self.fold) * np.cos(half))
        rise = 0.0 if self.across == 1 else np.sin(self.fold) * np.sin(half) * self.along
        total = np.zeros(np.shape(width_share))
        for side in (-left, right):
            total = total + side * across * np.abs(top - bottom + rise * side * np.asarray(width_share))
        return total


@dataclass(frozen=True, eq=False)
class PatchMesh:
    """A patch at one level of detail, in the patch's own frame.

    Attributes
    ----------
    twigs : Mesh
        Closed tubes; ``node`` is a node of the patch's graph.
    leaves : Mesh
        The blades of the first `n_leaves` leaves, with texture coordinates, nodes and a shade for each.
    n_leaves : int
        Leaves that are there at this level.
    blade_area : float
        One side of all blades' quads, m2, the same at every level; what the texture leaves of it is the leaf
        area.
    """

    twigs: Mesh
    leaves: Mesh
    n_leaves: int
    blade_area: float

    def __repr__(self) -> str:
        faces = len(self.twigs.faces) + len(self.leaves.faces)
        return f"<PatchMesh {self.n_leaves} leaves, {faces} faces>"

    @property
    def n_faces(self) -> int:
        """Triangles of twigs and leaves."""
        return len(self.twigs.faces) + len(self.leaves.faces)


def blade_mesh(leaves: LeafSet, blade: BladeSettings | None = None) -> Mesh:
    """Textured blades: a grid of quads for each leaf, as long and as wide as the leaf.

    Parameters
    ----------
    leaves : LeafSet
    blade : BladeSettings, optional
        By default one flat quad.

    Returns
    -------
    mesh : Mesh
        The blades one after the other in the order of the leaves, ``(across + 1) * (along + 1)`` vertices and
        ``2 * across * along`` faces each, counter-clockwise seen from the upper face. u runs from the left to
        the right edge seen from above with the tip ahead, v from the base to the tip.

    Notes
    -----
    A blade's surface is its length times its width times :meth:`BladeSettings.area`.
    """
    blade = blade or BladeSettings()
    m = leaves.n_leaves
    right = np.cross(leaves.along, leaves.normal)[:, None]
    along, normal = leaves.along[:, None], leaves.normal[:, None]
    left, _, right_end, _ = blade.box
    row_at = np.linspace(0.0, 1.0, blade.along + 1)
    side_at = np.array([left, right_end] if blade.across == 1 else [left, 0.0, right_end])
    ahead, above = _midrib(blade)
    middle = leaves.base[:, None] + leaves.length[:, None, None] * (
        ahead[:, None] * along - above[:, None] * normal
    )
    turn = blade.bend * row_at[:, None]
    upward = np.cos(turn) * normal + np.sin(turn) * along
    side = side_at[:, None]
    fold = np.cos(blade.fold), np.sin(blade.fold)
    offset = side * fold[0] * right[:, :, None] + np.abs(side) * fold[1] * upward[:, :, None]
    vertices = middle[:, :, None] + leaves.width[:, None, None, None] * offset
    lean = np.sign(side) * fold[1]
    normals = np.sqrt(1.0 - lean**2) * upward[:, :, None] - lean * right[:, :, None]
    u, v = np.meshgrid((side_at - left) / (right_end - left), row_at)
    per_leaf = u.size
    return Mesh(
        vertices=vertices.reshape(-1, 3),
        faces=(_grid_faces(blade) + per_leaf * np.arange(m)[:, None, None]).reshape(-1, 3).astype(np.int32),
        normals=normals.reshape(-1, 3).astype(np.float32),
        uv=np.tile(np.column_stack([u.ravel(), v.ravel()]), (m, 1)).astype(np.float32),
        node=np.repeat(leaves.node, per_leaf).astype(np.int32),
        color=np.repeat(leaf_shades(m), per_leaf, axis=0),
    )


def patch_mesh(
    patch: Patch,
    share: float = 1.0,
    *,
    blade: BladeSettings | None = None,
    settings: MeshSettings | None = None,
) -> PatchMesh:
    """Mesh a patch at a level of detail.

    Parameters
    ----------
    patch : Patch
    share : float
        Part of its leaves, and of its twigs' edges from the thick end, above 0 to 1. The leaves are enlarged
        so that their area stays.
    blade : BladeSettings, optional
        By default one flat quad a leaf.
    settings : MeshSettings, optional
        How finely the twigs are meshed; default `TWIGS`.

    Returns
    -------
    mesh : PatchMesh

    Raises
    ------
    InputError
        If `share` is out of its range.
    TreeError
        If a radius of the patch is unknown.
    """
    share = check_share("share", share)
    leaves = patch.leaves
    area = leaves.length * leaves.width
    count, scale = lod_leaves(area, share)
    graph, node = thickest_edges(patch.graph, share)
    twigs = branch_mesh(graph, settings or TWIGS)
    if len(node) < patch.graph.n_nodes:
        assert twigs.node is not None
        twigs = replace(twigs, node=node[twigs.node].astype(np.int32))
    blade = blade or BladeSettings()
    share_of_length = np.divide(leaves.width, leaves.length, out=np.zeros_like(area), where=area > 0.0)
    quads = float(blade.area(share_of_length) @ area)
    return PatchMesh(twigs, blade_mesh(_first(leaves, count, scale), blade), count, quads)


def patch_meshes(
    patches: Sequence[Patch],
    share: float = 1.0,
    *,
    blade: BladeSettings | None = None,
    settings: MeshSettings | None = None,
) -> tuple[PatchMesh, ...]:
    """:func:`patch_mesh` of each patch."""
    return tuple(patch_mesh(patch, share, blade=blade, settings=settings) for patch in patches)


def _first(leaves: LeafSet, count: int, scale: float) -> LeafSet:
    """The first leaves, enlarged about their bases."""
    return LeafSet(
        leaves.base[:count],
        leaves.along[:count],
        leaves.normal[:count],
        scale * leaves.length[:count],
        scale * leaves.width[:count],
        leaves.node[:count],
    )


def _midrib(blade: BladeSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where each row is, ahead of the base and below it, for a blade of length 1 that bends evenly."""
    turn = blade.bend * (np.arange(blade.along) + 0.5) / blade.along  # of each quad; its length stays
    height = blade.box[3] - blade.box[1]
    step = height * np.stack([np.cos(turn), np.sin(turn)]) / blade.along
    ahead, below = np.concatenate([np.zeros((2, 1)), np.cumsum(step, axis=1)], axis=1)
    return ahead + blade.box[1], below


def _grid_faces(blade: BladeSettings) -> NDArray[np.int64]:
    """Two triangles for each quad of one blade."""
    width = blade.across + 1
    corner = (np.arange(blade.along)[:, None] * width + np.arange(blade.across)).ravel()[:, None]
    first, second = [0, 1, width + 1], [0, width + 1, width]
    return np.stack([corner + first, corner + second], axis=1).reshape(-1, 3)
