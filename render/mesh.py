"""The branch mesh: one smooth closed tube per chain of a tree graph.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, sections 6.1.2 to 6.1.4 (parallel transport frames, chains, cubic B-spline refinement,
generalized cylinders).
Departs from it in: control points are added near sharp corners, so that the spline stays within a stated
distance of the graph; a side chain starts on its parent's smoothed axis and inside its parent's surface;
every tube is closed at both ends; the number of sides follows the radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph import NO_PARENT, InputError, TreeError, TreeGraph

__all__ = ["DETAIL", "Mesh", "MeshSettings", "branch_mesh", "mesh_volume"]

MAX_SIDES = 256
MAX_STEPS = 64
MAX_VERTICES = 2**31 - 1


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh; one or several closed surfaces.

    Attributes
    ----------
    vertices : (v, 3) float64, or float32 in the flat mesh of a decoded tree
        Metres, z up. Vertices on a texture seam or a sharp edge are there more than once, equal to the bit.
    faces : (f, 3) int32
        Vertex indices, counter-clockwise seen from outside.
    normals : (v, 3) float32
        Unit normals, outwards.
    uv : (v, 2) float32 or None
        Texture coordinates, v upwards in the image. Of tubes: u once around (0 to 1), v along in metres
        from where the tube begins. Of leaves: (0, 0) to (1, 1) from the lower left to the upper right.
    node : (v,) int32 or None
        The graph node whose segment (parent to node) the vertex lies on.
    color : (v, 3) uint8 or None
        sRGB colour of each vertex.
    piece_start : (k + 1,) int64 or None
        Faces ``piece_start[i]:piece_start[i + 1]`` are the i-th closed surface.
    """

    vertices: NDArray[Any]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32] | None = None
    node: NDArray[np.int32] | None = None
    color: NDArray[np.uint8] | None = None
    piece_start: NDArray[np.int64] | None = None

    def __repr__(self) -> str:
        return f"<Mesh {len(self.vertices)} vertices, {len(self.faces)} faces>"


@dataclass(frozen=True)
class MeshSettings:
    """How finely branches are meshed.

    Attributes
    ----------
    sides : int
        Corners of the thickest tube's cross-section, 3 to 256. Thinner tubes get as many as give the same
        distance between polygon and circle, so about in proportion to the root of their radius.
    min_sides : int
        Corners of the thinnest tubes, 3 to `sides`.
    steps : int
        Rings on a span between two control points, at most, 1 to 64; straight spans get one.
    max_turn : float
        Turn of the axis from ring to ring that is aimed at within `steps`, radians, > 0.
    tolerance : float
        Largest distance between graph and tube axis, metres, >= 0; 0 keeps every corner sharp.
    tolerance_radii : float
        The same as a multiple of the branch's radius, >= 0; the smaller of the two holds. At 1 the graph
        stays inside the wood. With both infinite the axis is the plain B-spline of Eq. (6.7).
    ring_error : float
        Rings are left out where the tube strays by at most this many radii without them, >= 0; 0 keeps at
        least one ring per node.
    min_radius : float
        Thinner branches are drawn with this radius, metres, > 0.
    """

    sides: int = 16
    min_sides: int = 4
    steps: int = 4
    max_turn: float = 0.25
    tolerance: float = 0.01
    tolerance_radii: float = 1.0
    ring_error: float = 0.0
    min_radius: float = 0.0005

    def __post_init__(self) -> None:
        rules = (
            ("sides", 3 <= self.sides <= MAX_SIDES, f"be 3 to {MAX_SIDES}"),
            ("min_sides", 3 <= self.min_sides <= self.sides, f"be 3 to sides ({self.sides})"),
            ("steps", 1 <= self.steps <= MAX_STEPS, f"be 1 to {MAX_STEPS}"),
            ("max_turn", self.max_turn > 0, "be an angle > 0 radians"),
            ("tolerance", self.tolerance >= 0, "be a distance >= 0 metres"),
            ("tolerance_radii", self.tolerance_radii >= 0, "be a number >= 0"),
            ("ring_error", 0 <= self.ring_error < np.inf, "be a finite number >= 0"),
            ("min_radius", 0 < self.min_radius < np.inf, "be a finite length > 0 metres"),
        )
        for name, good, rule in rules:
            if not good:
                raise InputError(f"{name} must {rule}, got {getattr(self, name)!r}")


DETAIL: dict[str, MeshSettings] = {
    "fine": MeshSettings(sides=32, min_sides=6, steps=8, max_turn=0.12, tolerance=0.005),
    "normal": MeshSettings(),
    "coarse": MeshSettings(sides=6, min_sides=3, steps=1, ring_error=0.3),
}
"""Three levels of detail, near to far."""


def branch_mesh(
    graph: TreeGraph,
    settings: MeshSettings | None = None,
    *,
    sides: int | None = None,
    steps: int | None = None,
) -> Mesh:
    """Mesh the branches of a tree: one closed tube per chain, without twist.

    The nodes of a chain are the control points of a uniform cubic B-spline, Eq. (6.7) of [1]_, held at both
    ends by a mirrored point, so roots and tips keep their place. That spline passes corners on the inside;
    where it would by more than the tolerance of `settings`, control points are added on the graph's own
    segments. The radius runs along by the same spline. Cross-sections are carried along by parallel transport
    (Algorithm 1 of [1]_) and have the area of the circle whatever their number of corners, so the volume does
    not depend on the level of detail. A side chain starts on its parent's axis, thin enough to be inside it.

    Parameters
    ----------
    graph : TreeGraph
        Every radius must be known.
    settings : MeshSettings, optional
        Default ``MeshSettings()``; ``DETAIL`` has others by name.
    sides, steps : int, optional
        Take the place of the same in `settings`.

    Returns
    -------
    mesh : Mesh
        With texture coordinates, nodes and pieces (one per chain). After merging equal vertices each piece
        is a closed surface, oriented outwards. Empty if the graph has no length.

    Raises
    ------
    TreeError
        If a radius is unknown (NaN).
    InputError
        If a setting is out of its range.

    Notes
    -----
    O(n) time and memory. The first call compiles, which takes some seconds once per installation. Tubes of
    different chains run into each other where branches part: the pieces are closed, their union is not one
    manifold.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
       Konstanz, 2013, sections 6.1.2 to 6.1.4.

    Examples
    --------
    >>> trunk = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 2]], [0.1, 0.1])
    >>> mesh = branch_mesh(trunk, sides=12)
    >>> round(mesh_volume(mesh), 4)  # pi r^2 L
    0.0628
    """
    changes = {name: v for name, v in (("sides", sides), ("steps", steps)) if v is not None}
    settings = settings or MeshSettings()
    if sides is not None:
        changes["min_sides"] = min(settings.min_sides, sides)
    settings = replace(settings, **changes)
    from treegraph import chains

    _check_radii(graph.radius)
    chain_start, chain_node = (rows.astype(np.int64) for rows in chains(graph))  # a chain after its parent
    radius = np.maximum(graph.radius, settings.min_radius)
    tube_sides = _sides(graph.parent, radius, chain_start, chain_node, settings)
    return _mesh_chains(np.array(graph.position), radius, chain_start, chain_node, tube_sides, settings)


def mesh_volume(mesh: Mesh) -> float:
    """Volume enclosed by a closed mesh, by the divergence theorem.

    Returns
    -------
    volume : float
        Cubic metres; what several pieces share is counted once for each.
    """
    if not len(mesh.faces):
        return 0.0
    corner = (mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces]
    return float(np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)


def _check_radii(radius: NDArray[np.float64]) -> None:
    bad = np.flatnonzero(np.isnan(radius))
    if bad.size:
        raise TreeError(
            f"radius must be known at every node to make a mesh, but radius[{bad[0]}] is NaN; "
            f"{bad.size} of {radius.size} nodes break this. "
            "Fill them first, for instance with allometric_radii()."
        )


def _sides(
    parent: NDArray[np.int32],
    radius: NDArray[np.float64],
    chain_start: NDArray[np.int64],
    chain_node: NDArray[np.int64],
    settings: MeshSettings,
) -> NDArray[np.int64]:
    """Corners of each chain's cross-section: the same sagitta everywhere."""
    own = radius[chain_node]
    first = chain_start[:-1]
    own[first] = np.where(parent[chain_node[first]] == NO_PARENT, own[first], 0.0)
    thickest = np.maximum.reduceat(own, first)
    sagitta = radius.max() * (1.0 - np.cos(np.pi / settings.sides))
    with np.errstate(divide="ignore"):
        ratio = np.minimum(sagitta / thickest, 1.0)  # a chain of one node alone has no thickness
    needed = np.rint(np.pi / np.arccos(1.0 - ratio)).astype(np.int64)
    return np.clip(needed, settings.min_sides, settings.sides)


def _mesh_chains(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    chain_start: NDArray[np.int64],
    chain_node: NDArray[np.int64],
    sides: NDArray[np.int64],
    settings: MeshSettings,
) -> Mesh:
    from render import _mesh_kernels as kernels

    n_chains = sides.size
    room = kernels.CONTROLS_PER_NODE * chain_node.size
    control, width = np.empty((room, 3)), np.empty(room)
    node = np.empty(room, np.int64)
    control_start = np.empty(n_chains + 1, np.int64)
    kernels.build_controls(
        chain_start, chain_node, position, radius, sides,
        float(settings.tolerance), float(settings.tolerance_radii), control, width, node, control_start,
    )  # fmt: skip
    span_steps = np.empty(max(room, 1), np.int64)
    ring_start = np.empty(n_chains + 1, np.int64)
    kernels.count_rings(control, control_start, settings.steps, settings.max_turn, span_steps, ring_start)
    n_rings = int(ring_start[-1])
    centre, ring_width, ring_node = np.empty((n_rings, 3)), np.empty(n_rings), np.empty(n_rings, np.int64)
    kernels.fill_rings(control, width, node, control_start, span_steps, centre, ring_width, ring_node)

    if settings.ring_error > 0.0:
        n_rings = kernels.drop_rings(centre, ring_width, ring_node, ring_start, float(settings.ring_error))
        centre, ring_width, ring_node = centre[:n_rings], ring_width[:n_rings], ring_node[:n_rings]

    rings = np.diff(ring_start)
    vertex_start = _offsets(np.where(rings > 0, rings * (sides + 1) + 2 * sides, 0))
    face_start = _offsets(np.where(rings > 0, (rings - 1) * 2 * sides + 2 * (sides - 2), 0))
    n_vertices, n_faces = int(vertex_start[-1]), int(face_start[-1])
    if max(n_vertices, n_faces) > MAX_VERTICES:
        raise InputError(f"the mesh would have {n_vertices} vertices; lower sides or steps")
    mesh = Mesh(
        vertices=np.empty((n_vertices, 3)),
        faces=np.empty((n_faces, 3), np.int32),
        normals=np.empty((n_vertices, 3), np.float32),
        uv=np.empty((n_vertices, 2), np.float32),
        node=np.empty(n_vertices, np.int32),
        piece_start=face_start[np.concatenate([[True], rings > 0])],
    )
    kernels.build_tubes(
        centre, ring_width, ring_node, ring_start, sides, vertex_start, face_start,
        mesh.vertices, mesh.normals, mesh.uv, mesh.node, mesh.faces,
    )  # fmt: skip
    return mesh


def _offsets(count: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(count)])
