"""The cluster-based tree: main branches, leaf clusters and where the tree stands (thesis 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph.allometry import Allometry
from treegraph.errors import TreeError
from treegraph.graph import TreeGraph, _as_float, _as_index

__all__ = ["Cluster", "ClusterTree", "hull_volumes"]


@dataclass(frozen=True, eq=False)
class Cluster:
    """A volume of leaves and twigs: its hull and the nodes from which it grows (thesis 3.3.2).

    The arrays given are copied, and the copies are C-contiguous and read-only.

    Attributes
    ----------
    vertices : (v, 3) float64
        Vertices of the hull, metres, in the frame of the graph; finite.
    faces : (f, 3) int32
        Vertex indices of each triangle, counter-clockwise seen from outside.
    seed : (s,) int32
        Nodes of the graph from which the cluster grows.
    density : float
        Points per cubic metre of hull, >= 0; NaN where unknown.
    n_points : int
        Number of scan points in the cluster, >= 0.

    Raises
    ------
    TreeError
        If an array has a wrong shape or an index points outside.

    Examples
    --------
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> Cluster(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], seed=[5], density=120.0, n_points=20)
    <Cluster 4 vertices, 4 faces, 1 seed>
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    seed: NDArray[np.int32]
    density: float
    n_points: int

    def __post_init__(self) -> None:
        vertices = _as_float("vertices", self.vertices)
        faces = _as_index("faces", self.faces)
        seed = _as_index("seed", self.seed)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise TreeError(f"vertices must have shape (v, 3), got {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise TreeError(f"faces must have shape (f, 3), got {faces.shape}")
        if seed.ndim != 1:
            raise TreeError(f"seed must have shape (s,), got {seed.shape}")
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if bad.size:
            raise TreeError(f"vertices must be finite, but vertices[{bad[0]}] is {vertices[bad[0]]}")
        bad = np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))
        if bad.size:
            raise TreeError(
                f"faces must index the {len(vertices)} vertices, but faces[{bad[0]}] is {faces[bad[0]]}; "
                f"{bad.size} of {len(faces)} faces break this"
            )
        density, n_points = float(self.density), int(self.n_points)
        if density < 0.0 or np.isinf(density):
            raise TreeError(f"density must be >= 0 points per cubic metre, or NaN, got {density!r}")
        if n_points < 0:
            raise TreeError(f"n_points must be >= 0, got {n_points}")
        for name, array in (("vertices", vertices), ("faces", faces), ("seed", seed)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "density", density)
        object.__setattr__(self, "n_points", n_points)

    def moved(self, vertices: NDArray[np.float64], seed: NDArray[np.int32], density: float) -> Cluster:
        """The same hull with its vertices elsewhere, other seeds and another density.

        Much faster than a new one, as the faces need not be checked again.

        Parameters
        ----------
        vertices : (v, 3) float64
            As many as before.
        seed : (s,) int32
        density : float

        Raises
        ------
        TreeError
            If there are more vertices, or fewer; or as for a new cluster.
        """
        vertices, seed, density = _as_float("vertices", vertices), _as_index("seed", seed), float(density)
        if vertices.shape != self.vertices.shape:
            raise TreeError(f"vertices must have shape {self.vertices.shape}, got {vertices.shape}")
        if seed.ndim != 1 or density < 0.0 or np.isinf(density) or not np.isfinite(vertices).all():
            return Cluster(vertices, self.faces, seed, density, self.n_points)  # which says what is wrong
        vertices.flags.writeable = seed.flags.writeable = False
        out = object.__new__(Cluster)
        out.__dict__.update(vars(self), vertices=vertices, seed=seed, density=density)
        return out

    def __reduce__(self) -> tuple[Any, ...]:  # a copy is checked, and read-only, again
        return Cluster, (self.vertices, self.faces, self.seed, self.density, self.n_points)

    def __repr__(self) -> str:
        n_seeds = len(self.seed)
        seeds = f"{n_seeds} seed{'s' * (n_seeds != 1)}"
        return f"<Cluster {len(self.vertices)} vertices, {len(self.faces)} faces, {seeds}>"


@dataclass(frozen=True, eq=False)
class ClusterTree:
    """A whole tree as Sapwood keeps and sends it.

    Attributes
    ----------
    graph : TreeGraph
        The main branches.
    clusters : tuple of Cluster
        The leaf clusters; none for a bare tree.
    species : str or None
        Name of the species; None where unknown.
    allometry : Allometry
        The parameters with which the tree was made.
    origin : (3,) float64
        World coordinates of the local origin (the base of the trunk), metres:
        ``world = local + origin``.
    epsg : int or None
        EPSG code of the world coordinates; None where unknown.

    Raises
    ------
    TreeError
        If a part has the wrong type or shape, or a seed is not a node of the graph.

    Examples
    --------
    >>> from treegraph import DEFAULT_ALLOMETRY
    >>> graph = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 7]], [0.2, 0.0])
    >>> ClusterTree(graph, (), "Pine", DEFAULT_ALLOMETRY, origin=(455000.0, 5428000.0, 231.0), epsg=32632)
    <ClusterTree 2 nodes, 0 clusters, Pine>
    """

    graph: TreeGraph
    clusters: tuple[Cluster, ...]
    species: str | None
    allometry: Allometry
    origin: NDArray[np.float64]
    epsg: int | None = None

    def __post_init__(self) -> None:
        clusters = tuple(self.clusters)
        for name, value, kind in (
            ("graph", self.graph, TreeGraph),
            ("allometry", self.allometry, Allometry),
            *((f"clusters[{k}]", cluster, Cluster) for k, cluster in enumerate(clusters)),
        ):
            if not isinstance(value, kind):
                raise TreeError(f"{name} must be of type {kind.__name__}, got {type(value).__name__}")
        n = self.graph.n_nodes
        seeds = np.concatenate([np.zeros(0, np.int32), *(cluster.seed for cluster in clusters)])
        fits = not seeds.size or (seeds.min() >= 0 and seeds.max() < n)
        for k, cluster in enumerate(() if fits else clusters):
            bad = np.flatnonzero((cluster.seed < 0) | (cluster.seed >= n))
            if bad.size:
                raise TreeError(
                    f"seeds must be nodes of the graph (0 to {n - 1}), "
                    f"but clusters[{k}].seed[{bad[0]}] is {cluster.seed[bad[0]]}"
                )
        if self.species is not None and not (isinstance(self.species, str) and self.species):
            raise TreeError(f"species must be a name or None, got {self.species!r}")
        if self.epsg is not None and not (isinstance(self.epsg, int | np.integer) and 0 < self.epsg < 2**31):
            raise TreeError(f"epsg must be a positive code or None, got {self.epsg!r}")
        origin = _as_float("origin", self.origin)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise TreeError(f"origin must be three finite numbers, got {self.origin!r}")
        origin.flags.writeable = False
        object.__setattr__(self, "clusters", clusters)
        object.__setattr__(self, "origin", origin)
        object.__setattr__(self, "epsg", None if self.epsg is None else int(self.epsg))

    def __reduce__(self) -> tuple[Any, ...]:  # a copy is checked, and read-only, again
        return ClusterTree, (self.graph, self.clusters, self.species, self.allometry, self.origin, self.epsg)

    def __repr__(self) -> str:
        named = f", {self.species}" if self.species else ""
        nodes, clusters = self.graph.n_nodes, len(self.clusters)
        return (
            f"<ClusterTree {nodes} node{'s' * (nodes != 1)}, "
            f"{clusters} cluster{'s' * (clusters != 1)}{named}>"
        )

    def replace(self, **changes: Any) -> ClusterTree:
        """Return a tree with some of its parts changed; the rules are checked again.

        Parameters
        ----------
        **changes
            Any of ``graph``, ``clusters``, ``species``, ``allometry``, ``origin``, ``epsg``.

        Raises
        ------
        TreeError
            If the changed tree breaks a rule.
        """
        return replace(self, **changes)


def hull_volumes(clusters: Sequence[Cluster]) -> NDArray[np.float64]:
    """Volume that the hull of each cluster encloses.

    Parameters
    ----------
    clusters : sequence of Cluster
        Hulls are closed, their faces look outwards.

    Returns
    -------
    volume : (k,) float64 ndarray
        Cubic metres, >= 0; 0 without faces.

    Examples
    --------
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    >>> hull_volumes([Cluster(corners, faces, seed=[], density=0.0, n_points=0)]).round(6).tolist()
    [0.166667]
    """
    volume = np.zeros(len(clusters))
    for k, cluster in enumerate(clusters):
        if len(cluster.faces):
            a, b, c = np.moveaxis(cluster.vertices[cluster.faces] - cluster.vertices[0], 1, 0)
            volume[k] = max(float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0, 0.0)
    return volume
