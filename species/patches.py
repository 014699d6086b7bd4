"""What clusters are textured with: patches of branchlets, and where each is put.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 3.4 (branchlets, patches, docking points).
Departs from it in: a patch is kept upright in a frame of its own, so that placing it is one rotation, one
scale and one shift.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from species.foliage import LeafSet
from treegraph import InputError, TreeGraph
from treegraph.obstacles import check_array, check_rows, put_fields

__all__ = ["Instances", "Patch"]


@dataclass(frozen=True, eq=False)
class Patch:
    """A twig with its leaves, or a piece of one to which others dock.

    Its root is at the origin and it sets off along +z; +x is the side that looked up when it was cut from its
    branchlet, so that leaves which turned to the light do so again.

    Attributes
    ----------
    graph : TreeGraph
        Its wood, metres; node 0 is the root.
    leaves : LeafSet
        In a random order that never changes: any prefix is a level of detail (thesis 3.5.2).
    dock_position, dock_direction : (d, 3) float64
        Docking points: where further patches go on, metres, and in which direction, unit vectors.
    dock_radius : (d,) float64
        Thickness there, as radius, metres, > 0. No docking points: texturing ends with this patch.
    radius : float
        Thickness of the root, as radius, metres, > 0.
    slope : float
        Angle between the root's direction in the branchlet and the horizontal, radians, -pi/2 to pi/2.
    branchlet : int
        Which of the species' branchlets it was cut from.
    """

    graph: TreeGraph
    leaves: LeafSet
    dock_position: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    dock_direction: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    dock_radius: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    radius: float = 0.001
    slope: float = 0.0
    branchlet: int = 0

    def __post_init__(self) -> None:
        position = check_array("dock_position", self.dock_position, (None, 3))
        n = len(position)
        direction = check_array("dock_direction", self.dock_direction, (n, 3))
        radius = check_array("dock_radius", self.dock_radius, (n,))
        check_rows("dock_radius", radius, radius > 0.0, "positive, in metres")
        length = np.linalg.norm(direction, axis=1)
        check_rows("dock_direction", direction, np.abs(length - 1.0) < 1e-6, "unit vectors")
        if not 0.0 < self.radius < np.inf:
            raise InputError(f"radius must be a positive finite number of metres, got {self.radius!r}")
        put_fields(self, dock_position=position, dock_direction=direction, dock_radius=radius)

    @property
    def n_docks(self) -> int:
        """Number of docking points."""
        return len(self.dock_radius)


@dataclass(frozen=True, eq=False)
class Instances:
    """Where patches are put: a point p of a patch goes to ``position + scale * rotate(rotation, p)``.

    Attributes
    ----------
    patch : (k,) int32
        Row of the species' patches.
    position : (k, 3) float64
        Of the patch's root, metres.
    rotation : (k, 4) float64
        Unit quaternions x, y, z, w.
    scale : (k,) float64
        > 0.
    cluster : (k,) int32
        The tree's cluster that it fills, -1: none.
    order : (k,) int32
        A permutation of the rows: any prefix of it is a level of detail for the instances as a whole.
    """

    patch: NDArray[np.int32]
    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    scale: NDArray[np.float64]
    cluster: NDArray[np.int32]
    order: NDArray[np.int32]

    def __post_init__(self) -> None:
        position = check_array("position", self.position, (None, 3))
        n = len(position)
        rotation = check_array("rotation", self.rotation, (n, 4))
        scale = check_array("scale", self.scale, (n,))
        check_rows("scale", scale, scale > 0.0, "positive")
        length = np.linalg.norm(rotation, axis=1)
        check_rows("rotation", rotation, np.abs(length - 1.0) < 1e-6, "unit quaternions")
        whole = {name: _whole(name, getattr(self, name), n) for name in ("patch", "cluster", "order")}
        if (np.sort(whole["order"]) != np.arange(n)).any():
            raise InputError(f"order must be a permutation of 0 to {n - 1}")
        put_fields(self, position=position, rotation=rotation, scale=scale, **whole)

    def __len__(self) -> int:
        return len(self.scale)


def _whole(name: str, value: NDArray, n: int) -> NDArray[np.int32]:
    array = np.array(value)
    if array.shape != (n,) or array.dtype.kind not in "iu":
        raise InputError(f"{name} must be integers of shape ({n},), got {array.dtype} {array.shape}")
    array = array.astype(np.int32)
    array.flags.writeable = False
    return array
