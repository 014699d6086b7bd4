"""Trees dressed with the leaves of their species: clusters textured, meshes decoded at a level of detail."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from treegraph.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from render import DecodedTree, Foliage, Part
    from species import PatchTable, Texture
    from species.library import Library, Species
    from treegraph import ClusterTree, TreeGraph

__all__ = ["Dressed", "coarser", "dress", "find_kind", "open_library", "unknown_kind"]

LEAF_STREAM = 3  # of the seed's random numbers: leaves do not change what else is drawn at random
DECIMALS = 3
TOLERANCE = 0.01  # of the leaf area; what is farther off is said
COARSER = (0.5, 0.2)  # levels of detail below which branches are meshed a step more coarsely
BEARER_STEP = 0.05  # metres between the points of branches among which those that bear twigs are found


@dataclass(frozen=True, eq=False)
class Dressed:
    """A tree with its foliage.

    Attributes
    ----------
    tree : ClusterTree
    species : Species
    texture : Texture
        Which patch is where.
    decoded : DecodedTree
        Branches and instances, ready to be drawn or written.
    season : str
    """

    tree: ClusterTree
    species: Species
    texture: Texture
    decoded: DecodedTree
    season: str

    def __repr__(self) -> str:
        return f"<Dressed {self.species.name}, {self.season}: {self.decoded!r}>"

    @property
    def leaf_area(self) -> float:
        """One side of all leaves as they are drawn, m2; 0 in a season without."""
        return 0.0 if self.species.definition.is_bare(self.season) else self.decoded.leaf_area

    @property
    def remark(self) -> str | None:
        """One line for the user if the clusters could not be filled as their density asks; else None."""
        wanted, there = float(self.texture.target.sum()), float(self.texture.leaf_area.sum())
        if abs(there - wanted) <= TOLERANCE * wanted:
            return None
        return (
            f"twigs of {self.species.name} do not fill these clusters: {there:.3g} m2 of leaves, where their "
            f"density asks for {wanted:.3g} m2; they are too large, or so small that too many are needed"
        )

    def parts(self) -> tuple[Part, ...]:
        """Wood, twigs and leaves as plain meshes."""
        from render import flat_parts

        return flat_parts(self.decoded)

    def figures(self) -> dict[str, Any]:
        """What is said of the foliage in reports: species, season, leaf area (m2), leaves, twigs."""
        from recon.hulls import mesh_volume

        hulls = [cluster for cluster in self.tree.clusters if len(cluster.faces)]
        volume = sum((max(0.0, mesh_volume(hull.vertices, hull.faces)) for hull in hulls), 0.0)
        return {
            "species": self.species.name,
            "season": self.season,
            "leaf_area_m2": round(self.leaf_area, DECIMALS),
            "cluster_volume_m3": round(volume, DECIMALS),
            "leaf_area_density": self.species.definition.leaf_area_density,
            "n_leaves": 0 if self.leaf_area == 0.0 else self.decoded.n_leaves,
            "n_twigs": self.decoded.n_instances,
        }


def open_library(folder: str | os.PathLike[str] | None = None) -> Library:
    """The library that comes along; with a folder, that is looked into first.

    Raises
    ------
    InputError
        If there is no such folder.
    """
    from pathlib import Path

    from species.library import Library, builtin_library

    if folder is None:
        return builtin_library()
    return Library((Path(folder), *builtin_library().folders))


def unknown_kind(tree: ClusterTree) -> str:
    """What is said of a tree whose species :func:`find_kind` does not know."""
    then = "; its clusters stay hulls" if tree.clusters else ""
    return f"there is no species {tree.species!r} in the library{then}"


def find_kind(
    tree: ClusterTree, species: str | None = None, folder: str | os.PathLike[str] | None = None
) -> Species | None:
    """The species with which a tree is dressed: the one named, else the tree's own; None if it has none.

    Raises
    ------
    InputError
        If the library has no species of the name that is asked for, or cannot derive it. A tree's own name
        that it does not know, of another library, gives None.
    """
    library = open_library(folder)
    if species is not None:
        return library.load(species)
    if tree.species is None:
        return None
    try:
        library.find(tree.species)
    except InputError:  # made with another library
        return None
    return library.load(tree.species)


def dress(
    tree: ClusterTree,
    species: Species,
    *,
    lod: float = 1.0,
    season: str = "summer",
    seed: int = 0,
    density: ArrayLike = 1.0,
    detail: str = "normal",
) -> Dressed:
    """Fill a tree's clusters with the twigs and leaves of a species, and decode it.

    Parameters
    ----------
    tree : ClusterTree
        Every radius must be known. Without clusters it gets no leaves.
    species : Species
        Of :func:`species.library.find_species`.
    lod : float, default 1
        Level of detail: part of the leaves and of the branches' edges that is kept, above 0 to 1. Leaf area
        stays, and so do branches that lead to twigs; below 0.5 they are meshed more coarsely.
    season : str, default "summer"
        "spring", "summer", "autumn" or "winter".
    seed : int, default 0
        Another one, another arrangement of twigs.
    density : float or (k,) array_like
        Factor on the leaf area of each cluster, >= 0 (thesis, Eq. 4.13).
    detail : str
        How finely branches are meshed: "fine", "normal" or "coarse".

    Returns
    -------
    dressed : Dressed

    Raises
    ------
    InputError
        If an argument is out of its range.
    TreeError
        If a radius is unknown.

    Notes
    -----
    The same tree, species and seed give the same leaves, bit for bit.
    """
    import render
    from species import texture_tree

    if detail not in render.DETAIL:
        raise InputError(f"detail must be one of {', '.join(render.DETAIL)}, got {detail!r}")
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed must be a whole number from 0, got {seed!r}")
    if np.shape(density) not in ((), (len(tree.clusters),)):
        raise InputError(
            f"density must be one factor or one for each of {len(tree.clusters)} clusters, "
            f"got shape {np.shape(density)}"
        )
    foliage = _foliage(species, float(lod), season)
    texture = texture_tree(
        tree,
        _table(species),
        leaf_density=species.definition.leaf_area_density,
        rng=np.random.default_rng([seed, LEAF_STREAM]),
        density=density,
    )
    settings = render.DETAIL[coarser(detail, lod)]
    keep = None if lod == 1.0 else _bearers(tree.graph, texture)
    decoded = render.decode_tree(tree.graph, texture.instances, foliage, settings=settings, keep=keep)
    return Dressed(tree, species, texture, decoded, season)


def coarser(detail: str, lod: float) -> str:
    """How finely branches are meshed at a level of detail: a step coarser below 0.5, another below 0.2."""
    from render import DETAIL

    names = list(DETAIL)
    step = sum(lod < edge for edge in COARSER)
    return names[min(names.index(detail) + step, len(names) - 1)]


def _bearers(graph: TreeGraph, texture: Texture) -> NDArray[np.int64]:
    """Nodes at the ends of the segments from which the patches of the foliage grow."""
    from scipy.spatial import cKDTree

    from treegraph import NO_PARENT

    foot = texture.instances.position[texture.holder < 0]
    node = np.flatnonzero(graph.parent != NO_PARENT)
    if not len(foot) or not len(node):
        return np.empty(0, np.int64)
    begin, end = graph.position[graph.parent[node]], graph.position[node]
    count = np.ceil(np.linalg.norm(end - begin, axis=1) / BEARER_STEP).astype(np.int64) + 1
    which = np.repeat(np.arange(len(node)), count)
    at = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + 1) / count[which]
    points = begin[which] + at[:, None] * (end - begin)[which]
    return np.unique(node[which[cKDTree(points).query(foot)[1]]])


@lru_cache(maxsize=32)
def _table(species: Species) -> PatchTable:
    from render.dressing import blade_of, leaf_share
    from species import pack_patches

    bend = blade_of(species).bend
    return pack_patches(species.patches, leaf_share=leaf_share(species), leaf_bend=bend)


@lru_cache(maxsize=16)
def _foliage(species: Species, lod: float, season: str) -> Foliage:
    from render.dressing import species_foliage

    return species_foliage(species, share=lod, season=season)
