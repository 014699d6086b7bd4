"""A species' patches and pictures as foliage: what its trees are dressed with.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, sections 3.5.2 (level of detail) and 6.1.5 (leaves as quads that are refined to curved
surfaces).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from render.instancing import Foliage, make_foliage
from render.parts import Material
from render.patchmesh import BladeSettings
from render.textures import Texture
from species.foliage import LeafSet
from species.patches import Patch

if TYPE_CHECKING:
    from species.library import Species

__all__ = ["blade_of", "leaf_share", "materials_of", "species_foliage"]

CUT = 0.5  # alpha from which a leaf is there
MOST_BEND = 3.0  # radians: a leaf that is curled up wholly would run into itself
LEAF_ROUGHNESS, BARK_ROUGHNESS = 0.75, 0.95


def species_foliage(species: Species, *, share: float = 1.0, season: str = "summer") -> Foliage:
    """Mesh the patches of a species, once for all its trees.

    Parameters
    ----------
    species : Species
    share : float
        Level of detail: part of the leaves and twigs that is kept, above 0 to 1; leaf area stays.
    season : str
        "spring", "summer", "autumn" or "winter"; in a season without leaves there are only twigs.

    Returns
    -------
    foliage : Foliage
        Its patches are those of the species, in their order.

    Raises
    ------
    InputError
        If `share` is out of its range, or there is no such season.
    """
    bark, leaf = materials_of(species, season)
    patches = species.patches
    if species.definition.is_bare(season):
        patches = tuple(replace(patch, leaves=_first_leaves(patch, 0)) for patch in patches)
    return make_foliage(patches, share=share, bark=bark, leaf=leaf, blade=blade_of(species))


def materials_of(species: Species, season: str = "summer") -> tuple[Material, Material]:
    """Bark and leaf of a species in a season, with their pictures; a bare season has summer's leaf.

    Raises
    ------
    InputError
        If there is no such season.
    """
    shown = season if not species.definition.is_bare(season) else "summer"
    bark = Material(
        "bark",
        (1.0, 1.0, 1.0),
        roughness=BARK_ROUGHNESS,
        texture=Texture(species.picture("bark")),
        normal_texture=Texture(species.picture("bark_normal")),
        tile=species.bark_tile,
    )
    leaf = Material(
        "leaf",
        (1.0, 1.0, 1.0),
        roughness=LEAF_ROUGHNESS,
        double_sided=True,
        texture=Texture(species.picture(f"leaf_{shown}")),
        normal_texture=Texture(species.picture("leaf_normal")),
        alpha_cutoff=CUT,
    )
    return bark, leaf


def blade_of(species: Species) -> BladeSettings:
    """How the leaves of a species are cut into quads, folded and bent."""
    rules, leaf = species.definition.blade, species.definition.leaf
    return BladeSettings(
        across=rules.across,
        along=rules.along,
        fold=max(0.0, float(np.radians(leaf.fold_deg))) if rules.across == 2 else 0.0,
        bend=float(np.clip(np.radians(leaf.curl_deg), -MOST_BEND, MOST_BEND)) if rules.along > 1 else 0.0,
        box=species.box,
    )


def leaf_share(species: Species) -> float:
    """Leaf area, one side, over length times width of a leaf as it is drawn: cut out, folded and bent."""
    blade, leaves = blade_of(species), species.branchlets[0].leaves
    drawn, flat = blade.area(leaves.width[0] / leaves.length[0]), replace(blade, fold=0.0).area()
    return min(1.0, species.leaf_share * float(drawn / flat))


def _first_leaves(patch: Patch, count: int) -> LeafSet:
    leaves = patch.leaves
    return LeafSet(
        leaves.base[:count],
        leaves.along[:count],
        leaves.normal[:count],
        leaves.length[:count],
        leaves.width[:count],
        leaves.node[:count],
    )
