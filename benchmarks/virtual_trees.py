"""Trees to be scanned virtually: of a species, but of any age, place and season, as triangles.

A *source* makes trees of one species; anything that does is good enough for ``benchmarks.virtual_set``.
Here are two: the species of the library, grown and dressed in their own twigs and leaves, and growth presets
with plain blades. Within a source trees differ in age and in the length of their internodes (their height by
more than a factor of three), a little in all their other growth parameters, in the light they grew up in
(alone, among others, beside a wall), in how far up their trunks were pruned, and in the season.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from species import GrownTree, GrowthParameters, LeafSet, Preset
    from species.library import Species
    from treegraph import TreeGraph

__all__ = [
    "ANY",
    "CITY",
    "LibrarySource",
    "PresetSource",
    "Source",
    "Triangles",
    "Variety",
    "VirtualTree",
    "draw_traits",
]

PER_UNIT = ("dominance_distance", "dominance_age", "internode_age", "apical_control_age")
LEAST_AGE = 2
NEIGHBOURS = (3, 7)  # in a stand
SPACING = (0.25, 0.5)  # of the expected height, between trees of a stand
WALL = (0.1, 0.3)  # of the expected height, from the trunk to the wall
LEAST_LEAVES = 0.15  # of the leaf area in the open: a place that leaves less is none for a tree
MOST_NODES = 60_000
MOST_FACES = 500_000  # of twigs and leaves; beyond, fewer and larger leaves and fewer twigs are scanned
LEVELS = (1.0, 0.5, 0.25, 0.12, 0.06)  # of detail that are tried
SIDES = 3  # corners of a twig's cross-section
LEAFLETS = {"pinnate": 5, "bipinnate": 4, "palmate": 5, "frond": 24, "needle": 6}
"""Strips across a leaf that stand for its leaflets; a leaf of any other kind is one narrower blade."""


@dataclass(frozen=True)
class Variety:
    """How trees of a species differ.

    Attributes
    ----------
    ages, internodes : (low, high) tuple
        Of the species' own age, and of the length of its internodes.
    own : float
        By how much other parameters are a tree's own: standard deviation of their logarithm.
    places, seasons : dict of str to float
        And how often.
    pruned : float
        How often a trunk is pruned, from a tenth to four tenths of its height.
    """

    ages: tuple[float, float] = (0.5, 1.15)
    internodes: tuple[float, float] = (0.5, 1.4)
    own: float = 0.08
    places: tuple[tuple[str, float], ...] = (("open", 0.5), ("stand", 0.25), ("wall", 0.25))
    seasons: tuple[tuple[str, float], ...] = (
        ("summer", 0.55),
        ("spring", 0.1),
        ("autumn", 0.1),
        ("winter", 0.25),
    )
    pruned: float = 0.4


ANY = Variety()
"""Trees of any kind, for a model that is to know them."""

CITY = Variety(
    ages=(0.7, 1.15),
    internodes=(0.45, 1.6),
    own=0.02,
    places=(("open", 0.9), ("stand", 0.05), ("wall", 0.05)),
    seasons=(("summer", 1.0),),
)
"""Trees of a city in leaf."""

PRUNED_TO = (0.1, 0.4)  # of a tree's height


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
        What makes it differ from others of its species: ``age``, ``internodes``, ``own``, ``place``,
        ``pruned``, ``season``.
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


def draw_traits(preset: Preset, rng: np.random.Generator, variety: Variety = ANY) -> dict[str, float | str]:
    """How a tree differs from others of its kind."""
    return {
        "age": float(max(LEAST_AGE, round(preset.age * rng.uniform(*variety.ages)))),
        "internodes": float(np.exp(rng.uniform(*np.log(variety.internodes)))),
        "own": variety.own,
        "place": _pick(variety.places, rng),
        "pruned": float(rng.uniform(*PRUNED_TO)) if rng.random() < variety.pruned else 0.0,
        "season": _pick(variety.seasons, rng),
    }


def _pick(table: tuple[tuple[str, float], ...], rng: np.random.Generator) -> str:
    names, shares = zip(*table, strict=True)
    return str(rng.choice(names, p=shares))


def grow(preset: Preset, traits: dict[str, float | str], rng: np.random.Generator) -> Any:
    """The tree as a group of one, without its neighbours and its wall.

    A trait that would leave hardly a leaf is taken back, in `traits`, too.
    """
    from sapwood.growing import Group, Request, grow_group
    from treegraph import HalfSpace

    kind = replace(preset, age=int(traits["age"]), parameters=_own_parameters(preset.parameters, traits, rng))
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


def _own_parameters(
    kind: GrowthParameters, traits: dict[str, float | str], rng: np.random.Generator
) -> GrowthParameters:
    """Parameters of one tree: all but the number of buds a little off those of its kind.

    What is a factor per year or per metre differs in its logarithm; lengths go with the internodes.
    """
    size, spread = float(traits["internodes"]), float(traits["own"])
    own = {}
    for each in fields(kind):
        value, factor = getattr(kind, each.name), float(np.exp(rng.normal(0.0, spread))) if spread else 1.0
        if each.name in ("internode_length", "low_branch_height"):
            value *= size
        elif each.name in PER_UNIT:
            value **= factor
        elif each.name != "n_lateral_buds":
            value *= factor
        own[each.name] = float(np.clip(value, each.metadata["low"], each.metadata["high"]))
    return replace(kind, **{**own, "n_lateral_buds": kind.n_lateral_buds})


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
    variety: Variety = ANY

    @property
    def species(self) -> str:
        """Its name."""
        return self.kind.name

    def make(self, rng: np.random.Generator) -> VirtualTree:
        """Another tree; a species that keeps its leaves has them in winter, too."""
        preset = self.kind.definition.growth
        if preset is None:
            raise ValueError(f"{self.species} has no growth parameters")
        traits = draw_traits(preset, rng, self.variety)
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
    from render.dressing import leaf_share
    from render.mesh import MeshSettings

    covered, strips = leaf_share(kind), LEAFLETS.get(kind.definition.leaf.kind, 1)
    dressed = [
        _first_leaves(each.leaves, 0) if bare else _blades(each.leaves, covered, strips)
        for each in kind.patches
    ]
    patches = [replace(each, leaves=leaves) for each, leaves in zip(kind.patches, dressed, strict=True)]
    twigs = MeshSettings(sides=SIDES, min_sides=SIDES, steps=1, tolerance=0.01, ring_error=1.0)
    return make_foliage(patches, share=share, settings=twigs)


def _first_leaves(leaves: LeafSet, count: int) -> LeafSet:
    return replace(leaves, **{each.name: getattr(leaves, each.name)[:count] for each in fields(leaves)})


def _blades(leaves: LeafSet, covered: float, strips: int) -> LeafSet:
    """Leaves as solid blades of the same area: what a picture cuts out of a leaf's rectangle, a laser passes.

    A simple leaf is made narrower; a divided one becomes strips across, evenly spaced.
    """
    if strips == 1:
        return replace(leaves, width=leaves.width * covered)
    place = np.tile((np.arange(strips) + 0.5) / strips, leaves.n_leaves)
    again = {each.name: np.repeat(getattr(leaves, each.name), strips, axis=0) for each in fields(leaves)}
    across = np.cross(again["normal"], again["along"])
    base = again["base"] + place[:, None] * again["length"][:, None] * again["along"]
    return replace(
        leaves,
        base=base - 0.5 * again["width"][:, None] * across,
        along=across,
        normal=again["normal"],
        length=again["width"],
        width=again["length"] * covered / strips,
        node=again["node"],
    )


@dataclass(frozen=True, eq=False)
class PresetSource:
    """Trees of a growth preset with plain blades; bare in winter."""

    preset: Preset
    variety: Variety = ANY

    @property
    def species(self) -> str:
        """Name of the preset."""
        return self.preset.name

    def make(self, rng: np.random.Generator) -> VirtualTree:
        """Another tree."""
        import render
        from sapwood.growing import as_cluster_tree

        traits = draw_traits(self.preset, rng, self.variety)
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
