"""A species on one page: its leaves through the seasons, its bark, its branchlets and patches."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from species.library import Branchlet, Species

__all__ = ["draw_branchlet", "draw_species", "species_figures"]

SIDE = 300  # pixels of one picture
COLUMNS = 6
SHOWN = 18  # branchlets on a page
SEASONS = ("spring", "summer", "autumn", "winter")
PAPER = 246


def species_figures(species: Species) -> dict[str, Any]:
    """What there is to say of a species, as JSON takes it."""
    known = species.definition
    growth = known.growth
    return {
        "name": known.name,
        "latin": known.latin,
        "also": list(known.also),
        "what": known.what,
        "bytes": species.n_bytes,
        "branchlets": len(species.branchlets),
        "patches": len(species.patches),
        "leaves": sum(branchlet.leaves.n_leaves for branchlet in species.branchlets),
        "thickness_mm": [round(2000.0 * float(edge), 1) for edge in _thickness(species)],
        "leaf": known.leaf.kind,
        "leaf_length_m": known.leaf.length,
        "leaf_area_density": known.leaf_area_density,
        "bare": [season for season in SEASONS if known.is_bare(season)],
        "beta": known.allometry.beta,
        "gamma": known.allometry.gamma,
        "f_s": known.allometry.f_s,
        "growth_age": None if growth is None else growth.age,
        "growth": None if growth is None else growth.parameters.symbols(),
    }


def draw_species(
    species: Species, path: str | os.PathLike[str] | None = None, *, renderer: str = "auto"
) -> NDArray[np.uint8]:
    """Draw the contact sheet of a species.

    Parameters
    ----------
    species : Species
    path : path, optional
        PNG file to write.
    renderer : str
        As of :func:`render.preview`.

    Returns
    -------
    sheet : (h, w, 3) uint8
    """
    import render

    pictures = [(_fit(species.picture(f"leaf_{season}")), f"leaf, {season}") for season in _leafy(species)]
    pictures.append((_fit(species.picture("bark")), f"bark, {species.bark_tile * 100:.0f} cm"))
    for number in _spread(len(species.branchlets), SHOWN):
        branchlet = species.branchlets[number]
        image = draw_branchlet(species, branchlet, renderer=renderer)
        pictures.append((image, f"{number + 1}: {_caption(branchlet)}"))
    images, captions = zip(*pictures, strict=True)
    return render.contact_sheet(images, captions, COLUMNS, path=path)


def draw_branchlet(
    species: Species,
    branchlet: Branchlet,
    *,
    season: str = "summer",
    renderer: str = "auto",
    side: int = SIDE,
) -> NDArray[np.uint8]:
    """Draw a whole branchlet as it hangs on the tree, setting off to the right; `side` pixels wide and high.

    Returns
    -------
    image : (h, w, 3) uint8
    """
    import render
    from render.dressing import blade_of, materials_of
    from render.parts import tile_bark
    from render.patchmesh import TWIGS, blade_mesh
    from treegraph import DEFAULT_ALLOMETRY, ClusterTree

    bark, leaf = materials_of(species, season)
    parts = [render.Part("twig", tile_bark(render.branch_mesh(branchlet.graph, TWIGS), bark), bark)]
    if not species.definition.is_bare(season):
        parts.append(render.Part("leaves", blade_mesh(branchlet.leaves, blade_of(species)), leaf))
    tree = ClusterTree(branchlet.graph, (), None, DEFAULT_ALLOMETRY, np.zeros(3))
    drawn = render.preview(tree, size=(side, side), azimuth=0.0, parts=parts, renderer=renderer)
    return drawn.image


def _caption(branchlet: Branchlet) -> str:
    tips = branchlet.leaves.base + branchlet.leaves.length[:, None] * branchlet.leaves.along
    reach = float(np.linalg.norm(np.concatenate([branchlet.graph.position, tips]), axis=1).max())
    return f"{reach * 100:.0f} cm, {2000.0 * branchlet.graph.radius[0]:.0f} mm thick"


def _leafy(species: Species) -> list[str]:
    return [season for season in SEASONS if f"leaf_{season}" in species.pictures]


def _thickness(species: Species) -> tuple[float, float]:
    radius = [branchlet.graph.radius[0] for branchlet in species.branchlets]
    return min(radius), max(radius)


def _spread(n: int, most: int) -> list[int]:
    """At most so many of n numbers, evenly spread."""
    return sorted({round(k) for k in np.linspace(0, n - 1, min(n, most)).tolist()})


def _fit(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture in the middle of a square of SIDE pixels, as large as fits."""
    from PIL import Image

    image = Image.fromarray(picture).convert("RGBA")
    image.thumbnail((SIDE - 20, SIDE - 20))
    canvas = Image.new("RGBA", (SIDE, SIDE), (PAPER, PAPER, PAPER, 255))
    canvas.alpha_composite(image, ((SIDE - image.width) // 2, (SIDE - image.height) // 2))
    return np.asarray(canvas.convert("RGB"))
