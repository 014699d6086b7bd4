"""A species' patches and pictures as foliage: the right picture in the right place, and its leaf area."""

import numpy as np
import pytest

from render import blade_mesh
from render.dressing import MOST_BEND, blade_of, leaf_share, materials_of, species_foliage
from tests.library_examples import small_species
from treegraph.errors import InputError

SEASONS = ("spring", "summer", "autumn", "winter")


@pytest.fixture(scope="module")
def rowan():
    return small_species(leaf_colors__spring=[150, 200, 90], leaf_colors__autumn=[200, 60, 30])


@pytest.fixture(scope="module")
def holly():
    """An evergreen with blades that are folded and bent."""
    return small_species(
        name="Holly", leaf_colors__winter=[40, 70, 35], blade__across=2, blade__along=3, leaf__fold_deg=20,
        leaf__curl_deg=30,
    )  # fmt: skip


def mesh_area(mesh):
    corner = mesh.vertices[mesh.faces].astype(float)
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return 0.5 * np.linalg.norm(cross, axis=1).sum()


# ---------------------------------------------------------------- materials


def test_bark_and_leaf_have_their_pictures(rowan):
    bark, leaf = materials_of(rowan, "summer")
    assert (bark.name, leaf.name) == ("bark", "leaf")
    assert (bark.texture.pixels == rowan.picture("bark")).all()
    assert (bark.normal_texture.pixels == rowan.picture("bark_normal")).all()
    assert bark.tile == rowan.bark_tile and not bark.double_sided and bark.alpha_cutoff is None
    assert (leaf.texture.pixels == rowan.picture("leaf_summer")).all()
    assert (leaf.normal_texture.pixels == rowan.picture("leaf_normal")).all()
    assert leaf.double_sided and leaf.alpha_cutoff == 0.5 and leaf.texture.has_alpha


def test_each_season_has_its_own_leaf(rowan):
    shown = {season: materials_of(rowan, season)[1].texture for season in SEASONS[:3]}
    color = {season: texture.mean_color() for season, texture in shown.items()}
    assert color["autumn"][0] > 1.5 * color["autumn"][1]  # red
    assert color["summer"][1] > color["summer"][0]  # green
    assert color["spring"].sum() > color["summer"].sum()  # lighter
    assert (materials_of(rowan, "winter")[1].texture.pixels == shown["summer"].pixels).all()


@pytest.mark.parametrize("season", ["fall", "", "Summer", None])
def test_there_are_four_seasons(rowan, season):
    for call in (materials_of, species_foliage):
        with pytest.raises(InputError, match="season must be one of spring, summer, autumn, winter, got"):
            call(rowan, season) if call is materials_of else call(rowan, season=season)


# ---------------------------------------------------------------- blades


def test_a_flat_blade_is_neither_folded_nor_bent(rowan):
    blade = blade_of(rowan)
    assert (blade.across, blade.along, blade.fold, blade.bend) == (1, 1, 0.0, 0.0)
    assert blade.box == rowan.box


def test_a_blade_of_more_quads_is(holly):
    blade = blade_of(holly)
    assert (blade.across, blade.along) == (2, 3)
    assert np.degrees([blade.fold, blade.bend]) == pytest.approx([20, 30])


@pytest.mark.parametrize("curl", [-180, 180, 175])
def test_the_most_curled_leaf_can_be_drawn(curl):
    blade = blade_of(small_species(leaf__curl_deg=curl, leaf__fold_deg=-80, blade__across=2, blade__along=8))
    assert blade.bend == pytest.approx(np.sign(curl) * MOST_BEND) and blade.fold == 0.0


def test_a_folded_and_bent_leaf_is_larger_than_a_flat_one(rowan, holly):
    assert leaf_share(rowan) == rowan.leaf_share
    # the sides of a blade run on a larger circle: bend sin(fold) width / 4 length, a little less for quads
    wider = np.radians(30) * np.sin(np.radians(20)) * 0.5 / 4
    assert leaf_share(holly) == pytest.approx(holly.leaf_share * (1 + wider), rel=0.01)


def test_the_picture_lies_where_the_leaf_is():
    """The pixels of the leaf are along its midrib, from the stalk's begin to the tip, and as wide as it."""
    rowan = small_species(256)  # the size that is used
    petiole = rowan.definition.leaf.petiole / rowan.definition.leaf.length
    leaves = rowan.patches[1].leaves
    mesh = blade_mesh(leaves, blade_of(rowan))
    pixels = rowan.picture("leaf_summer")[::-1, :, 3] >= 128  # row 0 is v = 0
    row, column = np.nonzero(pixels)
    u, v = (column + 0.5) / pixels.shape[1], (row + 0.5) / pixels.shape[0]
    for k in range(leaves.n_leaves):
        corner = mesh.vertices[4 * k : 4 * k + 4]
        place = corner[0] + u[:, None] * (corner[1] - corner[0]) + v[:, None] * (corner[2] - corner[0])
        ahead = (place - leaves.base[k]) @ leaves.along[k] / leaves.length[k]
        aside = (place - leaves.base[k]) @ np.cross(leaves.along[k], leaves.normal[k]) / leaves.length[k]
        assert ahead.min() == pytest.approx(0.0, abs=0.01)
        assert ahead.max() == pytest.approx(1.0 + petiole, abs=0.01)
        assert [aside.min(), aside.max()] == pytest.approx([-0.25, 0.25], abs=0.01)  # 4 cm of 8 cm


# ---------------------------------------------------------------- foliage


def test_every_patch_is_meshed_in_its_order(rowan):
    foliage = species_foliage(rowan)
    assert len(foliage.meshes) == len(rowan.patches)
    for mesh, patch in zip(foliage.meshes, rowan.patches, strict=True):
        assert mesh.n_leaves == patch.leaves.n_leaves
        assert len(mesh.twigs.faces) > 0
    assert foliage.leaf.alpha_cutoff == 0.5 and foliage.share == 1.0


@pytest.mark.parametrize("kind", ["rowan", "holly"])
@pytest.mark.parametrize("share", [1.0, 0.5, 0.1, 0.01])
def test_leaf_area_is_what_is_drawn_at_every_level(request, kind, share):
    species = request.getfixturevalue(kind)
    foliage = species_foliage(species, share=share)
    there = (species.picture("leaf_summer")[..., 3] >= 128).mean()
    for mesh, patch in zip(foliage.meshes, species.patches, strict=True):
        stated = leaf_share(species) * float(patch.leaves.length @ patch.leaves.width)
        assert there * mesh.blade_area == pytest.approx(stated, rel=1e-9)
        assert there * mesh_area(mesh.leaves) == pytest.approx(stated, rel=1e-5)
        assert mesh.n_leaves == int(np.ceil(share * patch.leaves.n_leaves - 1e-9))


def test_fewer_faces_at_a_lower_level(rowan):
    faces = [sum(mesh.n_faces for mesh in species_foliage(rowan, share=s).meshes) for s in (1.0, 0.5, 0.1)]
    assert faces[2] < faces[1] < faces[0]  # by how much on a tree: tests/sapwood/test_dressed_trees.py


def test_in_winter_there_are_only_twigs(rowan, holly):
    bare = species_foliage(rowan, season="winter")
    summer = species_foliage(rowan)
    for mesh, other in zip(bare.meshes, summer.meshes, strict=True):
        assert mesh.n_leaves == 0 and len(mesh.leaves.faces) == 0 and mesh.blade_area == 0.0
        assert (mesh.twigs.vertices == other.twigs.vertices).all()
    assert sum(mesh.n_leaves for mesh in species_foliage(holly, season="winter").meshes) > 0


@pytest.mark.parametrize("share", [0.0, -1.0, 1.5, float("nan")])
def test_the_level_has_a_range(rowan, share):
    with pytest.raises(InputError, match="share must be"):
        species_foliage(rowan, share=share)
