"""Trees with the leaves of their species: as much leaf as is said, at every level, in every season."""

import re

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

import recon
from recon.hulls import mesh_volume
from render import DETAIL, flat_parts
from sapwood.dressing import coarser, dress, find_kind, open_library
from sapwood.pipeline import reconstruct
from sapwood.trees import keep_thickest
from species.library import build_species, builtin_library, open_species
from tests.corpus import TREES, realistic_cluster_tree, realistic_tree
from tests.library_examples import GRAMMAR, small_species, species_text
from tests.sapwood.sapwood_scans import ROOT, tree_points
from treegraph import SPECIES_ALLOMETRY, Allometry, ClusterTree
from treegraph.errors import InputError, TreeError

SAMPLE = ROOT / "samples" / "itsme_tls_tree2.laz"
WITHIN = 0.01  # of the leaf area, at every level (issue 4, measure 2)


@pytest.fixture(scope="module")
def rowan():
    return small_species()


@pytest.fixture(scope="module")
def oak():
    """A species that comes along, derived here."""
    definition = builtin_library().find("oak")
    return open_species(definition, build_species(definition))


@pytest.fixture(scope="module")
def tree():
    return realistic_cluster_tree(realistic_tree(1, height=8.0, step=0.2), 6)


@pytest.fixture(scope="module")
def scanned():
    """The tree of a scan that ships."""
    return reconstruct(SAMPLE).tree


def volume(tree):
    return sum(mesh_volume(cluster.vertices, cluster.faces) for cluster in tree.clusters)


def drawn_area(dressed):
    """Leaf area of the triangles that are there: the quads, times what their picture leaves of them."""
    leaves = next(part for part in flat_parts(dressed.decoded) if part.name == "leaves")
    corner = leaves.mesh.vertices[leaves.mesh.faces].astype(float)
    quads = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    return quads.sum() * (leaves.material.texture.pixels[..., 3] >= 127.5).mean()


def arrays(dressed):
    decoded = dressed.decoded
    return [a.tobytes() for a in (decoded.start, decoded.position, decoded.rotation, decoded.scale)]


# ---------------------------------------------------------------- leaf area


@pytest.mark.parametrize("lod", [1.0, 0.1])
def test_the_leaf_area_of_a_scanned_tree_is_density_times_volume(scanned, oak, lod):
    dressed = dress(scanned, oak, lod=lod)
    wanted = oak.definition.leaf_area_density * volume(scanned)
    assert wanted > 5.0
    assert dressed.leaf_area == pytest.approx(wanted, rel=WITHIN)
    assert drawn_area(dressed) == pytest.approx(wanted, rel=WITHIN)


@pytest.mark.slow
@pytest.mark.parametrize("name", builtin_library().names)
def test_so_is_that_of_every_species(scanned, name):
    definition = builtin_library().find(name)
    species = open_species(definition, build_species(definition))
    wanted = definition.leaf_area_density * volume(scanned)
    for season in ("spring", "summer", "autumn"):
        for lod in (1.0, 0.3, 0.1):
            dressed = dress(scanned, species, lod=lod, season=season)
            assert drawn_area(dressed) == pytest.approx(wanted, rel=WITHIN), (season, lod)
            assert dressed.leaf_area == pytest.approx(wanted, rel=WITHIN)


def test_a_folded_and_bent_leaf_is_counted_as_it_is_drawn(tree):
    holly = small_species(blade__across=2, blade__along=4, leaf__fold_deg=40, leaf__curl_deg=90)
    dressed = dress(tree, holly)
    assert drawn_area(dressed) == pytest.approx(2.5 * volume(tree), rel=WITHIN)


def test_fewer_and_larger_leaves_have_fewer_faces(scanned, oak):
    full, tenth = dress(scanned, oak), dress(scanned, oak, lod=0.1)
    assert tenth.decoded.n_faces < 0.25 * full.decoded.n_faces
    assert tenth.decoded.n_leaves < 0.2 * full.decoded.n_leaves
    assert tenth.decoded.n_instances == full.decoded.n_instances
    faces = [sum(len(part.mesh.faces) for part in each.parts()) for each in (full, tenth)]
    assert faces == [full.decoded.n_faces, tenth.decoded.n_faces]


@pytest.mark.parametrize("lod", [0.5, 0.1, 0.001])
def test_no_twig_floats_where_its_branch_was_left_out(scanned, oak, lod):
    dressed = dress(scanned, oak, lod=lod)
    foot = dressed.texture.instances.position[dressed.texture.holder < 0]
    assert len(foot) > 50
    gap = distance(foot, dressed.decoded.wood)
    assert (
        gap.max() <= distance(foot, dress(scanned, oak).decoded.wood).max() + 0.15
    )  # a coarser mesh is a little off
    assert np.median(gap) < 0.05


def distance(points, mesh):
    """To the nearest of many points of a mesh's surface."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return cKDTree(trimesh.sample.sample_surface(solid, 100_000, seed=0)[0]).query(points)[0]


def test_branches_are_meshed_more_coarsely_at_low_levels():
    wanted = {1.0: "fine", 0.5: "fine", 0.4: "normal", 0.2: "normal", 0.1: "coarse"}
    assert {lod: coarser("fine", lod) for lod in wanted} == wanted
    assert [coarser("normal", lod) for lod in (0.5, 0.49, 0.1)] == ["normal", "coarse", "coarse"]
    assert [coarser("coarse", lod) for lod in (1.0, 0.1)] == ["coarse", "coarse"]


def test_clusters_that_are_drawn_as_hulls_do_not_float(scanned):
    kept = keep_thickest(scanned, 0.02)
    seeds = np.concatenate([cluster.seed for cluster in scanned.clusters])
    gap = np.linalg.norm(scanned.graph.position[seeds][:, None] - kept.graph.position[None], axis=2).min(
        axis=1
    )
    assert gap.max() == 0.0
    assert keep_thickest(scanned, 1.0) is scanned
    bare = keep_thickest(scanned.replace(clusters=()), 0.02)
    assert bare.graph.n_nodes == 1 + np.ceil(0.02 * (scanned.graph.n_nodes - 1))


def test_clusters_that_cannot_be_filled_are_remarked_on(tree, rowan):
    assert dress(tree, rowan).remark is None
    assert dress(tree.replace(clusters=()), rowan).remark is None
    giant = small_species(
        leaf__length=2.0, leaf__width=1.0, branchlets__grammar=GRAMMAR.replace("L(0", "L(2")
    )
    dressed = dress(tree.replace(clusters=tree.clusters[:1]), giant, density=0.01)
    assert dressed.leaf_area == 0.0
    assert re.fullmatch(
        r"twigs of Rowan do not fill these clusters: 0 m2 of leaves, where .* asks for .* m2; .*",
        dressed.remark,
    )


@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_light_scales_the_leaves_not_the_volume(tree, rowan, factor):
    dressed = dress(tree, rowan, density=factor)
    assert dressed.leaf_area == pytest.approx(factor * 2.5 * volume(tree), rel=WITHIN)
    assert dressed.figures()["cluster_volume_m3"] == pytest.approx(volume(tree), abs=0.001)


def test_each_cluster_has_a_density_of_its_own(tree, rowan):
    factor = np.array([0.0, 2.0] * 3)
    dressed = dress(tree, rowan, density=factor)
    each = [mesh_volume(c.vertices, c.faces) for c in tree.clusters]
    assert dressed.leaf_area == pytest.approx(2.5 * (factor @ each), rel=WITHIN)
    assert set(dressed.texture.instances.cluster.tolist()) <= {1, 3, 5}


# ---------------------------------------------------------------- seasons


def test_in_winter_there_are_twigs_and_no_leaves(tree, rowan):
    summer, winter = dress(tree, rowan), dress(tree, rowan, season="winter")
    assert [part.name for part in summer.parts()] == ["wood", "twigs", "leaves"]
    assert [part.name for part in winter.parts()] == ["wood", "twigs"]
    assert (winter.leaf_area, winter.decoded.n_leaves, winter.decoded.leaf_area) == (0.0, 0, 0.0)
    assert winter.decoded.n_instances == summer.decoded.n_instances
    for one, other in zip(summer.parts(), winter.parts(), strict=False):
        assert (one.mesh.vertices == other.mesh.vertices).all()
    figures = winter.figures()
    assert (figures["season"], figures["leaf_area_m2"], figures["n_leaves"]) == ("winter", 0.0, 0)
    assert figures["n_twigs"] == winter.decoded.n_instances > 0
    assert repr(winter).startswith("<Dressed Rowan, winter: <DecodedTree ")


def test_an_evergreen_keeps_its_leaves(tree):
    holly = small_species(leaf_colors__winter=[40, 70, 35])
    assert dress(tree, holly, season="winter").leaf_area == pytest.approx(2.5 * volume(tree), rel=WITHIN)


def test_figures_are_what_is_drawn(tree, rowan):
    dressed = dress(tree, rowan)
    figures = dressed.figures()
    assert figures == {
        "species": "Rowan",
        "season": "summer",
        "leaf_area_m2": round(dressed.leaf_area, 3),
        "cluster_volume_m3": round(volume(tree), 3),
        "leaf_area_density": 2.5,
        "n_leaves": dressed.decoded.n_leaves,
        "n_twigs": dressed.decoded.n_instances,
    }


# ---------------------------------------------------------------- chance


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tree, rowan):
    first = arrays(dress(tree, rowan, seed=4))
    assert arrays(dress(tree, rowan, seed=4)) == first
    assert arrays(dress(tree, small_species(), seed=4)) == first  # nor does it depend on what was kept
    other = dress(tree, rowan, seed=5)
    assert arrays(other) != first
    assert other.leaf_area == pytest.approx(2.5 * volume(tree), rel=WITHIN)


def test_levels_and_seasons_do_not_move_anything(tree, rowan):
    first = arrays(dress(tree, rowan))
    for more in ({"lod": 0.2}, {"season": "autumn"}, {"season": "winter"}, {"detail": "coarse"}):
        assert arrays(dress(tree, rowan, **more)) == first


# ---------------------------------------------------------------- odd trees


@pytest.mark.parametrize("name", TREES)
def test_a_tree_without_clusters_has_no_leaves(rowan, name):
    graph = TREES[name]
    if not np.isfinite(graph.radius).all():
        pytest.skip("radii must be known")
    bare = ClusterTree(graph, (), None, Allometry(1.5, 1.5, 0.98), np.zeros(3))
    dressed = dress(bare, rowan)
    assert (dressed.leaf_area, dressed.decoded.n_instances) == (0.0, 0)
    assert dressed.figures()["cluster_volume_m3"] == 0.0
    assert {part.name for part in dressed.parts()} <= {"wood"}


def test_clusters_without_a_volume_stay_empty(tree, rowan):
    from dataclasses import replace

    flat = replace(tree.clusters[0], vertices=tree.clusters[0].vertices * [1, 1, 0] + [0, 0, 5])
    none = replace(tree.clusters[1], vertices=np.empty((0, 3)), faces=np.empty((0, 3), np.int32))
    some = tree.replace(clusters=(flat, none, tree.clusters[2]))
    dressed = dress(some, rowan)
    assert dressed.leaf_area == pytest.approx(
        2.5 * volume(tree.replace(clusters=tree.clusters[2:3])), rel=0.01
    )


def test_an_unknown_radius_is_said(tree, rowan):
    radius = tree.graph.radius.copy()
    radius[3] = np.nan
    with pytest.raises(TreeError, match="radius"):
        dress(tree.replace(graph=tree.graph.replace(radius=radius)), rowan)


# ---------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    "arguments, match",
    [
        ({"lod": 0.0}, "share must be"),
        ({"lod": 1.5}, "share must be"),
        ({"lod": float("nan")}, "share must be"),
        ({"season": "fall"}, "season must be one of spring, summer, autumn, winter, got 'fall'"),
        ({"detail": "best"}, "detail must be one of fine, normal, coarse, got 'best'"),
        ({"seed": -1}, "seed must be a whole number from 0, got -1"),
        ({"seed": 1.5}, "seed must be a whole number from 0, got 1.5"),
        ({"seed": True}, "seed must be a whole number from 0, got True"),
        ({"density": [1.0, 2.0]}, r"density must be one factor or one for each of 6 .*, got shape \(2,\)"),
        ({"density": -1.0}, "density must be finite numbers >= 0"),
        ({"density": float("nan")}, "density must be finite numbers >= 0"),
    ],
)  # fmt: skip
def test_every_argument_is_checked(tree, rowan, arguments, match):
    with pytest.raises(InputError, match=match):
        dress(tree, rowan, **arguments)


def test_every_level_of_detail_of_branches(tree, rowan):
    faces = [len(dress(tree, rowan, detail=detail).decoded.wood.faces) for detail in DETAIL]
    assert faces == sorted(faces, reverse=True) and faces[0] > faces[-1]


# ---------------------------------------------------------------- whose leaves


def test_the_tree_says_its_species_unless_another_is_asked_for(tree, tmp_path, monkeypatch):
    monkeypatch.setenv("SAPWOOD_CACHE", str(tmp_path / "cache"))
    from species.library import building

    monkeypatch.setattr(building, "PICTURE_SIDE", 32)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "rowan.toml").write_text(species_text())
    mine = tree.replace(species="rowan")
    assert find_kind(mine, folder=tmp_path / "mine").name == "Rowan"
    assert find_kind(mine) is None  # a library that is not at hand
    assert find_kind(tree.replace(species=None), folder=tmp_path / "mine") is None
    assert find_kind(tree.replace(species=None), "Sorbus aucuparia", tmp_path / "mine").name == "Rowan"
    with pytest.raises(InputError, match="there is no species 'roan'; did you mean 'Rowan'"):
        find_kind(mine, "roan", tmp_path / "mine")
    with pytest.raises(InputError, match="none: there is no such folder of species."):
        find_kind(mine, folder=tmp_path / "none")
    assert open_library(tmp_path / "mine").names == sorted(
        [*builtin_library().names, "Rowan"], key=str.casefold
    )


def test_a_species_that_cannot_be_derived_is_no_unknown_one(tree, tmp_path, monkeypatch):
    monkeypatch.setenv("SAPWOOD_CACHE", str(tmp_path / "cache"))
    (tmp_path / "rowan.toml").write_text(species_text(branchlets__grammar="axiom = F("))
    with pytest.raises(InputError, match=r"rowan.toml: \[branchlets\] grammar, line 1, column "):
        find_kind(tree.replace(species="Rowan"), folder=tmp_path)


# ---------------------------------------------------------------- encode(allometry=)


def test_a_scan_is_encoded_with_the_allometry_of_its_species():
    points = tree_points(1)
    mine = Allometry(1.9, 1.1, 0.97)
    made = recon.encode(points, species="Rowan", allometry=mine)
    assert made.species == "Rowan"  # which the table of the thesis does not have
    assert (made.allometry.beta, made.allometry.gamma) == (1.9, 1.1)
    with pytest.raises(InputError, match="species must be one of"):
        recon.encode(points, species="Rowan")
    willow = recon.encode(points, species="willow")
    same = recon.encode(points, species="willow", allometry=SPECIES_ALLOMETRY["Willow"])
    assert (same.graph.position == willow.graph.position).all()
    assert (same.graph.radius == willow.graph.radius).all()
    unnamed = recon.encode(points, allometry=mine)
    assert unnamed.species is None and unnamed.allometry.gamma == 1.1


def test_settings_come_before_the_allometry_of_the_species():
    settings = recon.EncodeSettings(beta=2.2, gamma=1.7)
    made = recon.encode(tree_points(1), allometry=Allometry(1.9, 1.1, 0.97), settings=settings)
    assert (made.allometry.beta, made.allometry.gamma) == (2.2, 1.7)
