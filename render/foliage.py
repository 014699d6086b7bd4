"""Leaves as blades, for pictures, for export and for the virtual scanner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from render.mesh import Mesh
from render.parts import Material, Part
from species.foliage import LeafSet
from treegraph import InputError

__all__ = ["BLADE", "leaf_part", "leaf_shades"]

BLADE = Material("leaves", (0.36, 0.50, 0.20), roughness=0.8, double_sided=True)
FOLD = 0.18  # how far a blade's two sides rise above its midrib, in half widths
LIGHTNESS_SPREAD, WARMTH_SPREAD = 0.28, 0.16
SHADES = 64  # the colours a tree's leaves have
GOLDEN = 0.6180339887498949


def leaf_part(leaves: LeafSet, name: str = "leaves", material: Material = BLADE) -> Part:
    """Two triangles for each leaf, folded along its midrib.

    Parameters
    ----------
    leaves : LeafSet
        At least one.
    name : str
        Of the part.
    material : Material
        What all leaves look like; each has a shade of it.

    Returns
    -------
    part : Part
        ``mesh.node`` says on which node of the tree each vertex hangs.

    Raises
    ------
    InputError
        If there is no leaf.
    """
    m = leaves.n_leaves
    if not m:
        raise InputError("there is nothing to mesh: the tree bears no leaves")
    across = np.cross(leaves.normal, leaves.along)
    half = 0.5 * leaves.width[:, None]
    rise = FOLD * half * leaves.normal
    middle = leaves.base + 0.45 * leaves.length[:, None] * leaves.along + rise
    corner = np.stack(
        [
            leaves.base,
            middle - half * across,
            leaves.base + leaves.length[:, None] * leaves.along,
            middle + half * across,
        ],
        axis=1,
    )
    first = 4 * np.arange(m)[:, None]
    faces = np.stack([first + [0, 1, 2], first + [0, 2, 3]], axis=1).reshape(-1, 3)
    return Part(
        name,
        Mesh(
            vertices=corner.reshape(-1, 3),
            faces=faces.astype(np.int32),
            normals=np.repeat(leaves.normal, 4, axis=0).astype(np.float32),
            node=np.repeat(leaves.node, 4),
            color=np.repeat(leaf_shades(m), 4, axis=0),
        ),
        material,
    )


def leaf_shades(m: int) -> NDArray[np.uint8]:
    """Relative colours of m leaves: some darker, some yellower."""
    k = np.arange(m) % SHADES
    light = 1.0 - LIGHTNESS_SPREAD * ((k * GOLDEN) % 1.0)
    warmth = WARMTH_SPREAD * (((k + 0.5) * GOLDEN * GOLDEN * 7.0) % 1.0 - 0.5)
    factor = np.column_stack([light * (1.0 + warmth), light, light * (1.0 - warmth)])
    return np.rint(255.0 * np.clip(factor, 0.0, 1.0)).astype(np.uint8)
