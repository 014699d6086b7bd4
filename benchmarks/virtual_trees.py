"""Trees to be scanned virtually: of a species, but of any age, place and season, as triangles.

A *source* makes trees of one species; anything that does is good enough for ``benchmarks.virtual_set``.
Here are two: the species of the library, grown and dressed in their own twigs and leaves, and growth presets
with plain blades. Within a source trees differ in age and in the length of their internodes (their height by
more than a factor of three), in the light they grew up in (alone, among others, beside a wall), in how far up
their trunks were pruned, and in the season.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from species import GrownTree, Preset
    from species.library import Species
    from treegraph import TreeGraph

__all__ = ["LibrarySource", "PresetSource", "Source", "Triangles", "VirtualTree", "draw_traits"]

AGES = (0.55, 1.15)  # of the species' own age
INTERNODES = (0.38, 1.25)  # of the species' own length
LEAST_AGE = 2
PLACES = {"open": 0.5, "stand": 0.25, "wall": 0.25}  # and how often
NEIGHBOURS = (3, 7)  # in a stand
SPACING = (0.25, 0.5)  # of the expected height, between trees of a stand
WALL = (0.1, 0.3)  # of the expected height, from the trunk to the wall
LEAST_LEAVES = 0.15  # of the leaf area in the open: a place that leaves less is none for a tree
PRUNED = 0.4  # how often a trunk is pruned ...
PRUNED_TO = (0.1, 0.4)  # ... up to this share of its height
SEASONS = {"summer": 0.55, "spring": 0.1, "autumn": 0.1, "winter": 0.25}
MOST_NODES = 60_000
MOST_FACES = 1_500_000  # of twigs and leaves; beyond, fewer and larger leaves and fewer twigs are scanned
LEVELS = (1.0, 0.5, 0.25, 0.12, 0.06)  # of detail that are tried
SIDES = 3  # corners of a twig's cross-section


@dataclass(frozen=True, eq=False)
class Triangles:
    """A mesh: vertices (v, 3) float64, metres, z up, and faces (f, 3) int."""

    vertices: np.ndarray
    faces: np.ndarray


@dataclass(frozen=True, eq=False)
class VirtualTree:
    """One tree with its foot at the origin, and how it came about.

    Attributes
    ----------
    species : str
    wood : tuple of Triangles
        Trunk, branches and twigs.
    leaves : Triangles or None
    height : float
        Metres.
    traits : dict of str to float or str
        What makes it differ from others of its species: ``age``, ``internodes``, ``place``, ``pruned``,
        ``season``.
    """

    species: str
    wood: tuple[Triangles, ...]
    leaves: Triangles | None
    height: float
    traits: dict[str, float | str]


class Source(Protocol):
    """Makes trees of one species."""

    @property
    def species(self) -> str:
        """Its name."""
        ...

    def make(self, rng: np.random.Generator) -> VirtualTree:
        """Another tree; the same for a generator in the same state."""
        ...


def draw_traits(preset: Preset, rng: np.random.Generator) -> dict[str, float | str]:
    """How a tree differs from others of its kind."""
    return {
        "age": float(max(LEAST_AGE, round(preset.age * rng.uniform(*AGES)))),
        "internodes": float(np.exp(rng.uniform(*np.log(INTERNODES)))),
        "place": str(rng.choice(list(PLACES), p=list(PLACES.values()))),
        "pruned": float(rng.uniform(*PRUNED_TO)) if rng.random() < PRUNED else 0.0,
        "season": str(rng.choice(list(SEASONS), p=list(SEASONS.values()))),
    }


def grow(preset: Preset, traits: dict[str, float | str], rng: np.random.Generator) -> Any:
    """The tree as a group of one, without its neighbours and its wall.

    A trait that would leave hardly a leaf is taken back, in `traits`, too.
    """
    from sapwood.growing import Group, Request, grow_group
    from treegraph import HalfSpace

    length = preset.parameters.internode_length * float(traits["internodes"])
    kind = replace(
        preset,
        age=int(traits["age"]),
        parameters=preset.parameters.replace(IBL=min(max(length, 0.005), 3.0)),
    )
    seed = int(rng.integers(2**31))
    tree = grow_group(Request(kind, seed, max_nodes=MOST_NODES)).trees[0]
    height, leaf_area = max(tree.height, 1.0), _leaf_area(tree)
    more: dict[str, Any] = {}
    if traits["place"] == "stand":
        spacing = max(height * float(rng.uniform(*SPACING)), 0.5)
        more = {"neighbours": int(rng.integers(*NEIGHBOURS)), "spacing": spacing}
    elif traits["place"] == "wall":
        way = float(rng.uniform(0.0, 2.0 * np.pi))
        normal = np.array([np.cos(way), np.sin(way), 0.0])
        wall = HalfSpace(-max(height * float(rng.uniform(*WALL)), 0.2) * normal, normal)
        more = {"obstacles": (wall,)}
    if more:
        other = grow_group(Request(kind, seed, max_nodes=MOST_NODES, **more)).trees[0]
        if _leaf_area(other) >= LEAST_LEAVES * leaf_area:
            tree = other
        else:
            traits["place"] = "open"
    other = pruned(tree, float(traits["pruned"]))
    if _leaf_area(other) >= LEAST_LEAVES * leaf_area:
        tree = other
    else:
        traits["pruned"] = 0.0
    return Group([tree], seed=seed)


def _leaf_area(tree: GrownTree) -> float:
    return float(np.asarray(tree.tree.attribute["leaf_area"], float).sum())


def pruned(tree: GrownTree, share: float) -> GrownTree:
    """The tree without the branches that leave its trunk below a share of its height."""
    from treegraph import gravelius_order, prune

    graph: TreeGraph = tree.tree
    order, parent, z = gravelius_order(graph), graph.parent, graph.position[:, 2]
    limit = share * float(z.max())
    keep = np.ones(graph.n_nodes, bool)
    for i in range(1, graph.n_nodes):
        p = parent[i]
        keep[i] = keep[p] and not (order[p] == 0 and order[i] == 1 and z[p] < limit)
    return replace(tree, tree=prune(graph, keep), history=None)


@dataclass(frozen=True, eq=False)
class LibrarySource:
    """Trees of a species of the library, in their own twigs and leaves."""

    kind: Species

    @property
    def species(self) -> str:
        """Its name."""
        return self.kind.name

    def make(self, rng: np.random.Generator) -> VirtualTree:
        """Another tree; a species that keeps its leaves has them in winter, too."""
        preset = self.kind.definition.growth
        if preset is None:
            raise ValueError(f"{self.species} has no growth parameters")
        traits = draw_traits(preset, rng)
        group = replace(
            grow(preset, traits, rng),
            species=self.kind,
            season=str(traits["season"]),
            _leaves={},
            _dressed={},
        )
        tree = group.trees[0]
        bare = self.kind.definition.is_bare(str(traits["season"]))
        wood, leaves = _dressed_parts(group, bare)
        if bare:
            traits["season"] = "bare"
        return VirtualTree(self.species, wood, leaves, tree.height, traits)


def _dressed_parts(group: Any, bare: bool) -> tuple[tuple[Triangles, ...], Triangles | None]:
    """Wood and leaves of a dressed tree, lean: thin twigs are prisms, leaves flat, fewer where too many."""
    import render

    graph = group.trees[0].tree
    settings = render.DETAIL["coarse"]
    if not group.leaves(0).n_leaves:
        mesh = render.branch_mesh(graph, settings)
        return (Triangles(mesh.vertices, mesh.faces),), None
    instances = group.dressed(0, "coarse").texture.instances
    for level in LEVELS:
        foliage = _lean_foliage(group.species, level, bare)
        each = np.array([mesh.n_faces for mesh in foliage.meshes])
        if int(each[instances.patch].sum()) <= MOST_FACES:
            break
    whole = np.arange(graph.n_nodes)  # wood is never left out
    decoded = render.decode_tree(graph, instances, foliage, settings=settings, keep=whole)
    parts = {
        part.name: Triangles(np.asarray(part.mesh.vertices, np.float64), part.mesh.faces)
        for part in render.flat_parts(decoded)
    }
    wood = tuple(parts[name] for name in ("wood", "twigs") if name in parts)
    return wood, parts.get("leaves")


@lru_cache(maxsize=64)
def _lean_foliage(kind: Species, share: float, bare: bool) -> Any:
    """The twigs and leaves of a species with as few triangles as a scanner can do with."""
    from render import make_foliage
    from render.mesh import MeshSettings
    from species import LeafSet

    patches = kind.patches
    if bare:
        none = LeafSet(*(getattr(patches[0].leaves, name)[:0] for name in LEAF_FIELDS))
        patches = tuple(replace(patch, leaves=none) for patch in patches)
    twigs = MeshSettings(sides=SIDES, min_sides=SIDES, steps=1, tolerance=0.01, ring_error=1.0)
    return make_foliage(patches, share=share, settings=twigs)


LEAF_FIELDS = ("base", "along", "normal", "length", "width", "node")


@dataclass(frozen=True, eq=False)
class PresetSource:
    """Trees of a growth preset with plain blades; bare in winter."""

    preset: Preset

    @property
    def species(self) -> str:
        """Name of the preset."""
        return self.preset.name

    def make(self, rng: np.random.Generator) -> VirtualTree:
        """Another tree."""
        import render
        from sapwood.growing import as_cluster_tree

        traits = draw_traits(self.preset, rng)
        group = grow(self.preset, traits, rng)
        tree = group.trees[0]
        mesh = render.branch_mesh(as_cluster_tree(tree).graph, render.DETAIL["coarse"])
        leaves = None
        if traits["season"] == "winter":
            traits["season"] = "bare"
        elif group.leaves(0).n_leaves:
            blades = render.leaf_part(group.leaves(0)).mesh
            leaves = Triangles(np.asarray(blades.vertices, np.float64), blades.faces)
        return VirtualTree(self.species, (Triangles(mesh.vertices, mesh.faces),), leaves, tree.height, traits)
