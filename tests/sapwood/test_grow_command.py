"""``sapwood grow`` as people use it."""

import dataclasses
import json

import numpy as np
import pytest

import treegraph
from sapwood.growing import Request, as_cluster_tree, grow_group, neighbour_places, spread_ages
from species import find_preset, read_growth
from species.library import find_species
from species.library.catalog import BUILTIN
from treegraph import hull_volumes

SMALL = ("--preset", "F6e", "--age", "6", "--seed", "2")


def test_example_of_the_readme(run, tmp_path):
    done = run("sapwood", "grow", *SMALL, "-o", "tree.glb", "--json")
    assert done.code == 0, done.err
    said = done.json
    assert list(said) == [
        "schema_version", "command", "version", "kind", "age", "status", "nodes", "height_m", "leaf_area_m2",
        "trees", "seed", "files", "seconds",
    ]  # fmt: skip
    assert (said["kind"], said["age"], said["status"], said["seed"]) == ("F6e", 6, "grown", 2)
    assert said["files"] == ["tree.glb"]
    tree = grow_group(Request(find_preset("F6e"), 2), 6).trees[0]
    assert said["nodes"] == tree.tree.n_nodes
    assert said["height_m"] == pytest.approx(tree.height, abs=1e-4)


def test_glb_names_wood_and_leaves(run, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    run("sapwood", "grow", *SMALL, "-o", "tree.glb")
    run("sapwood", "grow", *SMALL, "-o", "bare.glb", "--leaf-off")
    scene = trimesh.load(tmp_path / "tree.glb")
    assert set(scene.geometry) == {"wood", "leaves"}
    assert set(trimesh.load(tmp_path / "bare.glb").geometry) == {"wood"}
    height = scene.bounds[1][1] - scene.bounds[0][1]  # y is up in glTF
    assert height > 3.5
    assert abs(scene.bounds[0][1]) < 0.01


@pytest.mark.parametrize("suffix", ["lobes", "swc", "csv", "ply", "obj", "png"])
def test_every_format(run, tmp_path, suffix):
    done = run("sapwood", "grow", *SMALL, "-o", f"tree.{suffix}")
    assert (done.code, done.err) == (0, "")
    assert (tmp_path / f"tree.{suffix}").stat().st_size > 100
    assert f"-> tree.{suffix}" in done.out


def test_lobes_is_the_tree_with_its_leaves(run, tmp_path):
    run("sapwood", "grow", *SMALL, "-o", "tree.lobes")
    tree = treegraph.read_lobes(tmp_path / "tree.lobes")
    grown = grow_group(Request(find_preset("F6e"), 2), 6).trees[0].tree
    assert tree.graph.n_nodes == grown.n_nodes
    assert len(tree.clusters) > 2
    assert tree.allometry.d_root == pytest.approx(2 * grown.radius[0], rel=1e-3)
    run("sapwood", "grow", *SMALL, "-o", "bare.lobes", "--leaf-off")
    assert not treegraph.read_lobes(tmp_path / "bare.lobes").clusters


def test_same_seed_same_bytes(run, tmp_path):
    for name in ("a.lobes", "b.lobes"):
        run("sapwood", "grow", *SMALL, "-o", name)
    run("sapwood", "grow", "--preset", "F6e", "--age", "6", "--seed", "3", "-o", "c.lobes")
    a, b, c = ((tmp_path / f"{name}.lobes").read_bytes() for name in "abc")
    assert a == b != c


def test_a_kind_goes_through_its_file(run, tmp_path):
    done = run("sapwood", "grow", *SMALL, "--set", "GR=3", "--set", "phototropism=0.2", "-o", "kind.toml")
    assert (done.code, done.out) == (0, "kind.toml\n")
    kind = read_growth(tmp_path / "kind.toml")
    assert (kind.parameters.growth_rate, kind.parameters.phototropism, kind.age) == (3.0, 0.2, 6)
    run("sapwood", "grow", *SMALL, "--set", "GR=3", "--set", "PT=0.2", "-o", "a.swc")
    run("sapwood", "grow", "kind.toml", "--seed", "2", "-o", "b.swc")
    assert (tmp_path / "a.swc").read_bytes() == (tmp_path / "b.swc").read_bytes()


def test_a_wall_pushes_the_tree_away(run, tmp_path):
    for name, more in (("free", ()), ("wall", ("--obstacle", "wall:x=0.6"))):
        run("sapwood", "grow", "--preset", "F6e", "--seed", "1", *more, "-o", f"{name}.swc")
    free, wall = (treegraph.read_swc(tmp_path / f"{name}.swc").position[:, 0] for name in ("free", "wall"))
    assert wall.max() < 0.6 < free.max()
    assert wall.mean() < free.mean() - 0.05


def test_neighbours_shade(run, tmp_path):
    alone = run("sapwood", "grow", "--preset", "F6b", "--age", "14", "-o", "a.swc", "--json").json
    crowd = run(
        "sapwood", "grow", "--preset", "F6b", "--age", "14", "--neighbours", "6", "--spacing", "1.5",
        "-o", "b.swc", "--json",
    ).json  # fmt: skip
    assert (alone["trees"], crowd["trees"]) == (1, 7)
    assert crowd["nodes"] < 0.9 * alone["nodes"]
    assert treegraph.read_swc(tmp_path / "b.swc").n_nodes == crowd["nodes"]  # the one in the middle


def test_mesh_of_a_group_has_all_trees(run, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    run("sapwood", "grow", *SMALL, "--neighbours", "2", "-o", "group.glb")
    names = set(trimesh.load(tmp_path / "group.glb").geometry)
    assert names == {"wood", "leaves", "wood_1", "leaves_1", "wood_2", "leaves_2"}


def test_frames(run, tmp_path):
    done = run("sapwood", "grow", *SMALL, "--frames", "3", "-o", "tree.swc", "--json")
    assert done.json["files"] == ["tree_002.swc", "tree_004.swc", "tree_006.swc"]
    sizes = [treegraph.read_swc(tmp_path / name).n_nodes for name in done.json["files"]]
    assert sizes == sorted(sizes) and sizes[0] < sizes[2]


def test_frames_are_of_one_frame(run, tmp_path):
    from PIL import Image

    run("sapwood", "grow", *SMALL, "--frames", "2", "--size", "120x160", "-o", "t.png")
    young, old = (np.asarray(Image.open(tmp_path / f"t_00{a}.png")).astype(int) for a in (3, 6))
    assert young.shape == old.shape == (160, 120, 3)

    def top(image):
        dark = (image.max(axis=2) < 170).any(axis=1)
        return int(np.argmax(dark))

    assert top(young) > top(old) + 10  # smaller in the same frame
    run("sapwood", "grow", *SMALL, "--frames", "3", "--size", "60x80", "-o", "t.gif")
    with Image.open(tmp_path / "t.gif") as gif:
        assert gif.n_frames == 3


def test_node_limit_is_said(run):
    done = run("sapwood", "grow", "--preset", "F6b", "--max-nodes", "100", "-o", "t.swc", "--json")
    assert done.code == 0
    assert done.json["status"] == "node limit"
    assert done.json["nodes"] <= 100
    assert "growth stopped after" in done.err and "of 26 cycles" in done.err


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["-o", "a.glb"], "name one: KIND.toml, --preset F6a"),
        (["k.toml", "--preset", "F6a", "-o", "a.glb"], "name one: KIND.toml"),
        (["nowhere.toml", "-o", "a.glb"], "nowhere.toml: there is no such file"),
        (["--preset", "F6z", "-o", "a.glb"], "there is no preset 'F6z'; there are F6a, F6b"),
        (["--preset", "F6a", "-o", "a.xyz"], "a.xyz: the name must end in one of .glb"),
        (["--preset", "F6a", "--age", "0", "-o", "a.glb"], "age must be 1 or more growth cycles"),
        (
            ["--preset", "F6a", "--age", "201", "-o", "a.glb"],
            "age must be from 0 to 200 growth cycles, got 201",
        ),
        (["--preset", "F6a", "--set", "GR=99", "-o", "a.glb"], r"growth_rate (GR) must be from 0 to 12"),
        (
            ["--preset", "F6a", "--set", "GR", "-o", "a.glb"],
            "--set wants NAME=NUMBER, as in --set GR=2.5, got 'GR'",
        ),
        (["--preset", "F6a", "--set", "XX=1", "-o", "a.glb"], "there is no growth parameter 'XX'"),
        (["--preset", "F6a", "--obstacle", "hedge:1", "-o", "a.glb"], "an obstacle must be wall:x=1.5"),
        (["--preset", "F6a", "--obstacle", "sphere:0,0,0,1", "-o", "a.glb"], "inside a Ball obstacle"),
        (["--preset", "F6a", "--spacing", "0", "-o", "a.glb"], "spacing must be a positive number of metres"),
        (["--preset", "F6a", "--neighbours", "61", "-o", "a.glb"], "--neighbours"),
        (["--preset", "F6a", "--latitude", "91", "-o", "a.glb"], "--latitude"),
        (["--preset", "F6a"], "--output"),
    ],
)
def test_bad_arguments(run, tmp_path, arguments, message):
    done = run("sapwood", "grow", *arguments)
    assert done.code == 2
    assert message in done.error
    assert done.out == ""
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(run, tmp_path):
    (tmp_path / "tree.swc").write_text("mine")
    done = run("sapwood", "grow", *SMALL, "-o", "tree.swc")
    assert done.code == 2
    assert "tree.swc: the file exists already" in done.error
    assert (tmp_path / "tree.swc").read_text() == "mine"
    assert run("sapwood", "grow", *SMALL, "-o", "tree.swc", "--force").code == 0


def test_errors_as_json(run):
    done = run("sapwood", "grow", "--preset", "F6z", "-o", "a.glb", "--json")
    assert json.loads(done.out)["error"]["exit_code"] == 2


def test_rings_of_neighbours():
    places = np.array(neighbour_places(20, 2.0))
    reach = np.hypot(places[:, 0], places[:, 1])
    np.testing.assert_allclose(np.sort(reach), [2.0] * 6 + [4.0] * 12 + [6.0] * 2)
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + 9 * np.eye(20)
    assert gaps.min() > 1.99


@pytest.mark.parametrize(
    "age, frames, wanted", [(30, 6, [5, 10, 15, 20, 25, 30]), (3, 10, [1, 2, 3]), (7, 1, [7]), (1, 4, [1])]
)
def test_ages_of_frames(age, frames, wanted):
    assert spread_ages(age, frames) == wanted


def test_a_species_is_grown_with_its_own_leaves(run, tmp_path):
    done = run("sapwood", "grow", "--species", "beech", "--age", "6", "-o", "tree.lobes", "--json")
    assert done.code == 0, done.err
    tree = treegraph.read_lobes(tmp_path / "tree.lobes")
    assert tree.species == "Beech"
    glb = run("sapwood", "grow", "--species", "Fagus sylvatica", "--age", "6", "-o", "tree.glb", "--json")
    assert glb.code == 0, glb.err
    assert b'"alphaMode":"MASK"' in (tmp_path / "tree.glb").read_bytes()
    assert glb.json["kind"] == "Beech"


def test_leaf_area_of_a_species_is_what_has_grown():
    kind = find_species("Beech")
    growth = dataclasses.replace(kind.definition.growth, age=9)
    group = grow_group(Request(growth, 2), species=kind)
    grown = group.trees[0].tree.attribute["leaf_area"].sum()
    assert group.dressed(0).leaf_area == pytest.approx(grown, rel=0.02)
    bare = grow_group(Request(growth, 2), species=kind, season="winter")
    assert {part.name for part in bare.parts()} == {"wood"}


def test_coarse_trees_bear_no_less_than_their_species_would():
    """An internode with a fitted tip_share stands for twigs that are not there, and so for their leaves."""
    kind = find_species("Oak")
    growth = dataclasses.replace(kind.definition.growth, age=16)
    plain = grow_group(Request(growth, 2), species=kind)
    coarse = grow_group(Request(dataclasses.replace(growth, tip_share=0.03), 2), species=kind)
    tree = as_cluster_tree(coarse.trees[0], coarse.leaves(0), kind)
    full = float(hull_volumes(tree.clusters).sum()) * kind.definition.leaf_area_density
    assert plain.trees[0].tree.attribute["leaf_area"].sum() < 0.8 * full
    assert plain.dressed(0).leaf_area < 0.82 * full
    assert coarse.dressed(0).leaf_area == coarse.leaf_area(0) == pytest.approx(full, rel=0.05)
    assert plain.leaf_area(0) == plain.trees[0].tree.attribute["leaf_area"].sum()
    thin = grow_group(Request(dataclasses.replace(growth, tip_share=0.005), 2), species=kind)
    assert not thin.coarse
    assert grow_group(Request(growth, 2), species=kind, season="winter").leaf_area(0) == 0.0


def test_a_species_without_growth_parameters_or_with_a_file_is_an_error(run, tmp_path):
    text = (BUILTIN / "beech.toml").read_text(encoding="utf-8")
    lines = text[: text.index("[growth]")]
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "stub.toml").write_text(lines.replace('"Beech"', '"Stub"'), encoding="utf-8")
    done = run("sapwood", "grow", "--species", "Stub", "--library", "own", "-o", "a.glb")
    assert (done.code, "Stub has no growth parameters" in done.err) == (2, True)
    done = run("sapwood", "grow", "--species", "Beech", "--preset", "F6a", "-o", "b.lobes", "--age", "4")
    assert done.code == 0, done.err
