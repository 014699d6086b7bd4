r"""A tree as it stands in its surroundings: bent, pruned, thinned and cut.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 4.4.2 (Eq. 4.13, figures 4.6 and 4.7).
Departs from it in: the vertices of a hull that an obstacle hides from the nearest living node of the cluster
are moved towards that node, not just out of the obstacle, so that no leaves stay behind a wall; the text
leaves the density's dependence on light open (rho(i) = i / (i + 1/4) here).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from treegraph import ClusterTree, TriangleMesh

if TYPE_CHECKING:
    from plastic.analysis import PlasticState
    from plastic.scene import Neighbour, Scene

__all__ = ["BY_LIGHT", "BY_OBSTACLE", "Adapted", "light_density"]

BY_LIGHT, BY_OBSTACLE = 1, 2
"""What a branch died of (:attr:`Adapted.cause`)."""

HALF_LIGHT = 0.25
"""Light at which a cluster has half of the leaves that it could have."""

SHORT = 1e-3  # of the way from a node to an obstacle that hulls keep away from it
LEAST_VOLUME = 0.02  # of a hull's volume; a cluster that an obstacle leaves less of is gone


def light_density(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """rho(i) of Eq. 4.13: how many leaves a cluster has in some light, 0 to 0.8.

    Examples
    --------
    >>> light_density(np.array([0.0, 0.25, 1.0])).tolist()
    [0.0, 0.5, 0.8]
    """
    return light / (light + HALF_LIGHT)


@dataclass(frozen=True, eq=False)
class Adapted:
    """A tree in a scene; made by :meth:`PlasticState.adapt`. n nodes and k clusters as in the input tree.

    Attributes
    ----------
    state : PlasticState
    scene : Scene
    position : (n, 3) float64
        Of all nodes of the input tree, metres, in its own frame; of dead ones where they were.
    alive : (n,) bool
    cause : (n,) uint8
        What a dead node, or the branch that it hung on, died of: 1 too little light, 2 an obstacle; 0 lives.
    light, light_before : (k,) float64
        Light at the present clusters (of a tree without any: at the virtual ones), here and where the tree
        grew, 0 to 1.
    touched : bool
        Whether any node moved or died.
    placed : Neighbour or None
        Where the tree stands in the scene; None: its frame is that of the scene.
    neighbours : tuple of Adapted
        The scene's neighbours as they react.
    """

    state: PlasticState
    scene: Scene
    position: NDArray[np.float64]
    alive: NDArray[np.bool_]
    cause: NDArray[np.uint8]
    light: NDArray[np.float64]
    light_before: NDArray[np.float64]
    touched: bool
    placed: Neighbour | None = field(default=None, repr=False)
    neighbours: tuple[Adapted, ...] = ()

    @classmethod
    def of_run(
        cls,
        state: PlasticState,
        position: NDArray[np.float64],
        death: NDArray[np.int32],
        cause: NDArray[np.uint8],
        light: NDArray[np.float64],
        light_before: NDArray[np.float64],
        scene: Scene,
        touched: bool,
        placed: Neighbour | None = None,
    ) -> Adapted:
        """Copy what came out of a run, from the order of the plan to that of the tree."""
        from plastic import _plastic_kernels as kernels

        n = len(position)
        out, alive, why = np.empty((n, 3)), np.empty(n, bool), np.empty(n, np.uint8)
        kernels.read_nodes(position, death, cause, state._plan.position, state._order, out, alive, why)
        return cls(state, scene, out, alive, why, light.copy(), light_before, touched, placed)

    def in_light(self, scene: Scene, light: NDArray[np.float64]) -> Adapted:
        """The same tree, all of whose nodes are as they were, in another scene and its light."""
        return Adapted(
            self.state,
            scene,
            self.position,
            self.alive,
            self.cause,
            light.copy(),
            self.light_before,
            self.touched,
            self.placed,
        )

    def with_neighbours(self, neighbours: tuple[Adapted, ...]) -> Adapted:
        """The same with the trees around it."""
        return replace(self, neighbours=neighbours)

    def __repr__(self) -> str:
        n = len(self.alive)
        return f"<Adapted {int(self.alive.sum())} of {n} nodes, mean shift {self.mean_shift:.3g} m>"

    @property
    def n_pruned(self) -> int:
        """Number of nodes that died."""
        return int((~self.alive).sum())

    @property
    def displacement(self) -> NDArray[np.float64]:
        """How far each living node moved, metres (n,); 0 for dead ones."""
        return np.linalg.norm(self.position - self.state.tree.graph.position, axis=1)

    @property
    def mean_shift(self) -> float:
        """How far living nodes moved on average, metres."""
        return float(self.displacement[self.alive].mean())

    @property
    def density(self) -> NDArray[np.float64]:
        r"""Factor on the leaves of each of the tree's clusters (k,), :math:`\rho(i) / \rho(i_0)`, Eq. 4.13.

        0 for clusters that are gone, and for those in the dark. Of a tree without clusters it is empty.
        """
        if not self.state.has_leaves:
            return np.empty(0)
        before = self.light_before
        now = light_density(self.light)
        factor = np.divide(now, light_density(before), out=np.ones(len(now)), where=before > 0.0)
        return np.where(self._n_seats > 0, factor, 0.0)

    @cached_property
    def tree(self) -> ClusterTree:
        """The tree as it stands, in its own frame: dead nodes gone, clusters moved, cut and thinned.

        Where nothing changed it is the tree that was analysed, the same object. Radii and attributes of the
        nodes stay as they were.
        """
        from treegraph import prune

        before = self.state.tree
        density = self.density
        if not self.touched and (density == 1.0).all() and not self._is_cut:
            return before
        graph = before.graph.replace(position=self.position)
        place = (np.cumsum(self.alive) - 1).astype(np.int32)
        clusters = []
        for k, cluster in enumerate(before.clusters):
            vertices = self._hulls[k]
            if vertices is None:
                continue
            seed = cluster.seed[self.alive[cluster.seed]]
            clusters.append(cluster.moved(vertices, place[seed], cluster.density * float(density[k])))
        if not self.alive.all():
            graph = prune(graph, self.alive)
        return before.replace(graph=graph, clusters=tuple(clusters))

    @property
    def kept_clusters(self) -> NDArray[np.int64]:
        """Which of the input tree's clusters the clusters of :attr:`tree` are."""
        return np.array([k for k, hull in enumerate(self._hulls) if hull is not None], np.int64)

    @cached_property
    def _n_seats(self) -> NDArray[np.int64]:
        """Living nodes of each present cluster."""
        packed = self.state._hulls
        first, last = packed.seat_first[0], packed.seat_first[-1]
        living = np.concatenate([[0], np.cumsum(self.alive[packed.seat[first:last]])])
        return np.diff(living[packed.seat_first - first])

    @property
    def _is_cut(self) -> bool:
        """Whether an obstacle took something of a hull, or a hull is gone."""
        return bool(self._moved[1].any()) or not self._n_seats.all()

    @cached_property
    def _solids(self) -> tuple[Any, list[TriangleMesh]]:
        """The scene's obstacles as the kernels want them, and its meshes."""
        from plastic.stand import pack_solids

        return pack_solids(self.scene.obstacles)

    @cached_property
    def _moved(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Vertices of all hulls, and whether an obstacle took something of each."""
        from plastic import _cut_kernels as cuts
        from plastic.stand import turn_matrix

        packed, (solids, meshes) = self.state._hulls, self._solids
        turn, shift = np.eye(3), np.zeros(3)
        if self.placed is not None:
            turn, shift = turn_matrix(self.placed.turn), self.placed.position
        vertex, is_cut = np.empty_like(packed.vertex), np.empty(len(packed.first) - 1, np.bool_)
        before = self.state.tree.graph.position
        cuts.move_hulls(
            packed.vertex, packed.first, packed.seat, packed.seat_first, before, self.position, self.alive,
            turn, np.asarray(shift, np.float64), solids, SHORT, vertex, is_cut,
        )  # fmt: skip
        for k in np.flatnonzero(self._n_seats) if meshes else ():
            seats = packed.seat[packed.seat_first[k] : packed.seat_first[k + 1]]
            nodes = self.position[seats[self.alive[seats]]] @ turn.T + shift
            own = slice(packed.first[k], packed.first[k + 1])
            hull = vertex[own] @ turn.T + shift
            if sum([_cut_at_mesh(mesh, hull, nodes) for mesh in meshes]):
                vertex[own], is_cut[k] = (hull - shift) @ turn, True
        return vertex, is_cut

    @cached_property
    def _hulls(self) -> list[NDArray[np.float64] | None]:
        """Vertices of each of the tree's clusters; None for those that are gone, or next to it."""
        from treegraph import hull_volumes

        (vertex, is_cut), n_seats = self._moved, self._n_seats
        first = self.state._hulls.first
        out: list[NDArray[np.float64] | None] = []
        for k, cluster in enumerate(self.state.tree.clusters if self.state.has_leaves else ()):
            hull = vertex[first[k] : first[k + 1]] if n_seats[k] else None
            if hull is not None and is_cut[k]:
                whole, left = hull_volumes([cluster, cluster.moved(hull, cluster.seed, cluster.density)])
                hull = None if whole > 0.0 and left <= LEAST_VOLUME * whole else hull
            out.append(hull)
        return out


def _cut_at_mesh(mesh: TriangleMesh, hull: NDArray[np.float64], nodes: NDArray[np.float64]) -> int:
    """The same for a surface of triangles; ways are halved until they do not cross it."""
    from scipy.spatial import cKDTree

    start = nodes[cKDTree(nodes).query(hull)[1]]
    hidden = np.flatnonzero(mesh.crosses(start, hull))
    if not hidden.size:
        return 0
    clear, blocked = np.zeros(len(hidden)), np.ones(len(hidden))
    for _ in range(12):
        middle = 0.5 * (clear + blocked)
        end = start[hidden] + middle[:, None] * (hull[hidden] - start[hidden])
        hit = mesh.crosses(start[hidden], end)
        clear, blocked = np.where(hit, clear, middle), np.where(hit, middle, blocked)
    hull[hidden] = start[hidden] + clear[:, None] * (hull[hidden] - start[hidden])
    return len(hidden)
