"""The commands that know species: `species ...`, and the leaves of decode, preview and reconstruct."""

import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

import treegraph
from sapwood import species_pages
from sapwood.pipeline import reconstruct
from sapwood.saving import save
from species.library import building, builtin_library, catalog
from species.library.packing import unpack_species
from tests.corpus import realistic_cluster_tree, realistic_tree
from tests.library_examples import GRAMMAR, species_text
from treegraph import ClusterTree

ENDS = "the name must end in .png (a contact sheet) or .toml (the definition)."


@pytest.fixture(autouse=True)
def library(tmp_path, monkeypatch):
    """A small library in the place of the one that comes along, a folder of one's own, a cache."""
    monkeypatch.setattr(building, "PICTURE_SIDE", 32)
    monkeypatch.setattr(species_pages, "SHOWN", 2)
    monkeypatch.setattr(catalog, "BUILTIN", tmp_path / "builtin")
    monkeypatch.setenv("SAPWOOD_CACHE", str(tmp_path / "cache"))
    add(tmp_path / "builtin", "oak", name="Oak", latin="Quercus robur", also=["English oak"])
    add(tmp_path / "builtin", "pine", name="Pine", latin="Pinus", also=[], leaf_colors__winter=[60, 90, 60])
    builtin_library.cache_clear()
    yield tmp_path / "builtin"
    builtin_library.cache_clear()


def add(folder, file="rowan", **changes):
    folder.mkdir(exist_ok=True)
    path = folder / f"{file}.toml"
    path.write_text(species_text(**changes), encoding="utf-8")
    return path


@pytest.fixture
def mine(tmp_path):
    add(tmp_path / "mine")
    return tmp_path / "mine"


@pytest.fixture(scope="module")
def tree():
    return realistic_cluster_tree(realistic_tree(1, height=5.0, step=0.3), 2)  # of species Pine


@pytest.fixture
def pine(tree, tmp_path):
    path = tmp_path / "tree.lobes"
    treegraph.write_lobes(tree, path)
    return path


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def glb(path):
    """The JSON of a binary glTF file."""
    data = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", data)
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    return json.loads(data[20 : 20 + length])


# ---------------------------------------------------------------- species list


def test_list_has_a_line_for_each(run):
    done = run("sapwood", "species", "list")
    assert (done.code, done.err) == (0, "")
    lines = [line.split() for line in done.out.splitlines()]
    assert [line[:3] for line in lines] == [["Oak", "Quercus", "robur"], ["Pine", "Pinus", "simple"]]
    assert all(line[-1] == "kB" for line in lines)


def test_list_json_has_the_shape_that_is_promised(run, mine):
    done = run("sapwood", "species", "list", "--library", mine, "--json")
    said = done.json
    assert (done.code, done.err) == (0, "")
    assert list(said) == ["schema_version", "command", "version", "species", "faults"]
    assert (said["command"], said["faults"]) == ("species list", [])
    assert [row["name"] for row in said["species"]] == ["Oak", "Pine", "Rowan"]
    assert [row["builtin"] for row in said["species"]] == [True, True, False]
    for row in said["species"]:
        assert list(row) == ["name", "latin", "bytes", "branchlets", "patches", "leaf", "builtin"]
        assert row["branchlets"] == 4 and row["leaf"] == "simple"
        assert isinstance(row["bytes"], int) and 2000 < row["bytes"] < 20_000


def test_one_broken_species_does_not_hide_the_others(run, mine):
    (mine / "torn.toml").write_text("name = ")
    bad = add(mine, "bad", name="Bad", latin="Malus", also=[], branchlets__grammar="axiom = A")
    done = run("sapwood", "species", "list", "--library", mine)
    assert done.code == 0
    assert [line.split()[0] for line in done.out.splitlines()] == ["Oak", "Pine", "Rowan"]
    notes = done.err.splitlines()
    assert notes[0].startswith(f"note: left out: {mine / 'torn.toml'}: not a TOML file of a species (")
    assert notes[1].startswith(f"note: left out: {bad}: [branchlets] grammar, line 1, column 9 (line ")
    again = run("sapwood", "species", "list", "--library", mine, "--json", "--quiet")
    assert again.err == "" and len(again.json["faults"]) == 2
    assert [row["name"] for row in again.json["species"]] == ["Oak", "Pine", "Rowan"]


def test_ones_own_species_takes_the_place_of_the_builtin(run, tmp_path):
    add(tmp_path / "mine", "oak", name="oak", latin="Quercus petraea", also=[])
    said = run("sapwood", "species", "list", "--library", tmp_path / "mine", "--json").json
    assert [(row["name"], row["latin"], row["builtin"]) for row in said["species"]] == [
        ("oak", "Quercus petraea", False),
        ("Pine", "Pinus", True),
    ]


def test_a_library_that_is_not_there(run, tmp_path):
    for arguments in (["species", "list"], ["species", "show", "oak"]):
        done = run("sapwood", *arguments, "--library", "nowhere")
        assert (done.code, done.error) == (2, "nowhere: there is no such folder of species.")


@pytest.mark.slow
def test_the_species_that_come_along_are_listed(run, monkeypatch):
    monkeypatch.undo()
    builtin_library.cache_clear()
    done = run("sapwood", "species", "list", "--json")
    assert done.code == 0 and done.json["faults"] == []
    assert len(done.json["species"]) == len(list(catalog.BUILTIN.glob("*.toml"))) > 0
    for row in done.json["species"]:
        assert row["bytes"] <= 200_000 and 20 <= row["branchlets"] <= 30 and row["builtin"]


# ---------------------------------------------------------------- species show


def test_show_says_what_is_known(run, mine):
    done = run("sapwood", "species", "show", "mountain ash", "--library", mine)
    assert (done.code, done.err) == (0, "")
    said = dict(line.split(maxsplit=1) for line in done.out.splitlines())
    assert said["name"] == "Rowan" and said["latin"] == "Sorbus aucuparia"
    assert (said["branchlets"], said["leaves"], said["beta"]) == ("4", "228", "1.6")
    assert said["bare"] == "winter" and said["growth"].startswith("AAV 60, NLB 2, ")


def test_show_json_has_every_figure(run):
    said = run("sapwood", "species", "show", "english-oak", "--json").json
    assert said["command"] == "species show" and said["output"] is None
    assert (said["name"], said["also"], said["bare"]) == ("Oak", ["English oak"], ["winter"])
    assert (said["branchlets"], said["leaves"], said["leaf_length_m"]) == (4, 4 * 57, 0.08)
    assert (said["beta"], said["gamma"], said["f_s"], said["leaf_area_density"]) == (1.6, 1.5, 0.98, 2.5)
    assert said["thickness_mm"] == [6.0, 8.0]
    assert said["growth_age"] == 12 and said["growth"]["IBL"] == 0.54


def test_show_draws_the_species(run, tmp_path):
    done = run("sapwood", "species", "show", "oak", "-o", "oak.png", "--renderer", "software", "--json")
    assert done.code == 0 and done.json["output"] == "oak.png"
    with Image.open(tmp_path / "oak.png") as image:
        assert image.format == "PNG"
        check_sheet(np.asarray(image.convert("RGB")), n_pictures=6)
    again = run("sapwood", "species", "show", "oak", "-o", "oak.png")
    assert again.code == 2 and "oak.png: the file exists already" in again.error


def check_sheet(sheet, n_pictures):
    """Three seasons, bark and branchlets in rows of six; none of them is empty."""
    height, width = sheet.shape[:2]
    rows = -(-n_pictures // 6)
    assert width > 6 * 300 and height > rows * 300
    step_y, step_x = (height - 10) // rows, (width - 10) // 6
    cells = [sheet[10 + r * step_y :, 10 + c * step_x :][:300, :300] for r in range(rows) for c in range(6)]
    for cell in cells[:n_pictures]:
        assert len(np.unique(cell.reshape(-1, 3), axis=0)) > 50
    for cell in cells[n_pictures:]:
        assert len(np.unique(cell.reshape(-1, 3), axis=0)) == 1
    for green in cells[4:n_pictures]:  # branchlets: leaves and wood
        r, g, b = (green[..., k].astype(int) for k in range(3))
        assert ((g > r + 10) & (g > b + 20)).mean() > 0.01


@pytest.mark.parametrize(
    "arguments, text",
    [
        (["oka"], "there is no species 'oka'; did you mean 'Oak'?"),
        (["quercus-rubur"], "there is no species 'quercus-rubur'; did you mean 'Quercus robur' (Oak)?"),
        (["zzz"], "there is no species 'zzz'; there are Oak, Pine"),
        (
            ["oak", "-o", "oak.jpg"],
            "oak.jpg: " + ENDS,
        ),
        (["oak", "-o", "."], ".: this is a folder; name a file to write."),
        (["oak", "-o", "no/way/oak.jpeg"], "no/way/oak.jpeg: " + ENDS),
    ],
)
def test_what_show_refuses(run, arguments, text):
    done = run("sapwood", "species", "show", *arguments)
    assert (done.code, done.error) == (2, text)
    as_json = run("sapwood", "species", "show", *arguments, "--json")
    assert as_json.json["error"] == {"message": text, "exit_code": 2}


def test_a_name_that_a_broken_file_may_have_says_so(run, mine):
    (mine / "rowan.toml").write_text(species_text(leaf__kind="round"))
    done = run("sapwood", "species", "show", "Rowan", "--library", mine)
    assert done.code == 2
    assert done.error.startswith("there is no species 'Rowan'; ")
    assert f"; left out: {mine / 'rowan.toml'}: [leaf] kind must be one of" in done.error


# ---------------------------------------------------------------- species build


def test_build_writes_beside_the_definition(run, mine):
    done = run("sapwood", "species", "build", mine / "rowan.toml", "--renderer", "software")
    assert (done.code, done.err) == (0, "")
    assert names(mine) == ["rowan.png", "rowan.toml", "rowan.twigs"]
    n_bytes = sum((mine / f"rowan.{suffix}").stat().st_size for suffix in ("toml", "twigs"))
    assert done.out == (
        f"Rowan: 4 branchlets, 12 patches, {n_bytes / 1000:.0f} kB -> "
        f"{mine / 'rowan.twigs'}, {mine / 'rowan.png'}\n"
    )
    with Image.open(mine / "rowan.png") as image:
        check_sheet(np.asarray(image.convert("RGB")), n_pictures=6)
    assert len(unpack_species((mine / "rowan.twigs").read_bytes()).branchlets) == 4


def test_build_into_a_library_copies_the_definition(run, mine, tmp_path):
    done = run("sapwood", "species", "build", mine / "rowan.toml", "-o", "trees/mine", "--no-sheet", "--json")
    assert done.code == 0
    assert done.json["files"] == ["trees/mine/rowan.toml", "trees/mine/rowan.twigs"]
    assert (done.json["name"], done.json["branchlets"]) == ("Rowan", 4)
    folder = tmp_path / "trees" / "mine"
    assert names(folder) == ["rowan.toml", "rowan.twigs"] and names(mine) == ["rowan.toml"]
    assert (folder / "rowan.toml").read_bytes() == (mine / "rowan.toml").read_bytes()
    found = run("sapwood", "species", "list", "--library", folder, "--json").json["species"]
    assert [row["name"] for row in found] == ["Oak", "Pine", "Rowan"]
    cached = {path.name for path in (tmp_path / "cache").iterdir()}
    assert len(cached) == 2  # what was built is read, not derived again


def test_build_in_place_may_be_named_too(run, mine):
    done = run("sapwood", "species", "build", mine / "rowan.toml", "-o", mine, "--no-sheet")
    assert (done.code, names(mine)) == (0, ["rowan.toml", "rowan.twigs"])


def test_build_replaces_nothing_without_force(run, mine):
    (mine / "rowan.png").write_text("mine")
    done = run("sapwood", "species", "build", mine / "rowan.toml")
    assert done.code == 2 and f"{mine / 'rowan.png'}: the file exists already" in done.error
    assert names(mine) == ["rowan.png", "rowan.toml"]
    assert (
        run("sapwood", "species", "build", mine / "rowan.toml", "--force", "--renderer", "software").code == 0
    )
    assert (mine / "rowan.png").read_bytes()[:4] == b"\x89PNG"


def test_one_name_in_a_folder_is_enough(run, mine):
    other = add(mine, "sorb", name="rowan", latin="Sorbus domestica", also=[])
    done = run("sapwood", "species", "build", other)
    assert done.code == 2
    assert done.error == f"{other}: rowan.toml there has the name 'rowan' already; take another."
    assert names(mine) == ["rowan.toml", "sorb.toml"]


HOSTILE = {
    "not TOML": ("name = ", "not a TOML file of a species (Invalid value (at end of document))"),
    "nested": ("a = " + "[" * 20_000, "not a TOML file of a species ("),
    "binary": ("\0\1\2", "not a TOML file of a species ("),
    "long": ("# " + "x" * 100_000, "larger than 100000 bytes; a species is a short TOML file"),
    "empty": ("", "name, latin, leaf_area_density, allometry, branchlets, leaf, bark: missing; a species"),
    "number for a table": (species_text(leaf=3), "[leaf] must be a table, got 3"),
    "unknown key": (species_text(leaf__lenght=1), "[leaf] there is no entry 'lenght'; did you mean 'l"),
    "text for a number": (species_text(allometry__beta="x"), "[allometry] beta must be a number, got 'x'"),
    "grammar": (
        species_text(branchlets__grammar=GRAMMAR.replace("[ +(50)", "[ +(50")),
        "[branchlets] grammar, line 5, column ",
    ),
    "not declared": (
        species_text(branchlets__grammar=GRAMMAR + "B(n, w) -> Q(n)\n"),
        "[branchlets] grammar, line 9, column 12 (line ",
    ),
    "runs away": (
        species_text(branchlets__grammar=GRAMMAR.replace("iterations = 8", "iterations = 9999").replace(
            "A(n - 1, w * 0.8)", "A(n, w) A(n, w)")),
        "[branchlets] branchlet 1 of 4: the word has more than 200000 modules in iteration ",
    ),
    "never ends": (
        species_text(branchlets__grammar=GRAMMAR.replace("iterations = 8", "iterations = 1e9")),
        "[branchlets] branchlet 1 of 4: at most 10000 iterations, got 1000000000; ask for fewer",
    ),
    "too many leaves": (
        species_text(branchlets__grammar=GRAMMAR.replace("B(3,", "B(99,").replace("= 8", "= 150")),
        "[branchlets] branchlet 1 of 4: it has 797 nodes and 1593 leaves; at most 4000 and 1500 are taken",
    ),
    "divides by nothing": (
        species_text(branchlets__grammar=GRAMMAR.replace("w * 0.6) ] [", "w / (n - n)) ] [")),
        "[branchlets] branchlet 1 of 4, line 5, column ",
    ),
    "no leaves": (
        species_text(branchlets__grammar="param size = 1\nparam slope = 1\niterations = 0\naxiom = F(1)\n"),
        "[branchlets] branchlet 1 of 4: it has no leaves",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_definition_that_is_wrong_ends_with_one_clear_line(run, tmp_path, name):
    text, said = HOSTILE[name]
    path = tmp_path / "wrong.toml"
    path.write_text(text, encoding="utf-8")
    done = run("sapwood", "species", "build", path)
    assert done.code == 2
    assert done.error.startswith(f"{path}: {said}")
    assert len(done.error) < 600 and "DerivationLimits" not in done.error
    assert not (tmp_path / "wrong.twigs").exists() and not (tmp_path / "wrong.png").exists()


@pytest.mark.parametrize(
    "file, output, text",
    [
        ("none.toml", "out", "none.toml: there is no such file."),
        ("rowan.txt", "out", "rowan.txt: the name of a species' definition must end in .toml."),
        (".", "out", ".: the name of a species' definition must end in .toml."),
        ("rowan.toml", "rowan.txt", "rowan.txt: "),
    ],
)
def test_what_build_refuses(run, tmp_path, file, output, text):
    for name in ("rowan.toml", "rowan.txt"):
        (tmp_path / name).write_text(species_text())
    done = run("sapwood", "species", "build", file, "-o", output, "--no-sheet")
    assert done.code == 2
    assert done.error.startswith(text)
    assert not (tmp_path / "out").exists()


# ---------------------------------------------------------------- decode


def test_a_tree_of_known_species_bears_its_leaves(run, pine, tmp_path, tree):
    done = run("sapwood", "decode", pine, "-o", "tree.glb", "--json")
    assert (done.code, done.err) == (0, "")
    leaves = done.json["leaves"]
    assert leaves["species"] == "Pine" and leaves["season"] == "summer"
    assert leaves["leaf_area_m2"] == pytest.approx(2.5 * leaves["cluster_volume_m3"], rel=0.01)
    assert (done.json["lod"], done.json["seed"]) == (1.0, 0)
    said = glb(tmp_path / "tree.glb")
    assert said["extensionsRequired"] == said["extensionsUsed"] == ["EXT_mesh_gpu_instancing"]
    root, *children = said["nodes"]
    assert root["name"] == "tree" and children[0]["name"] == "wood"
    assert all(child["name"].startswith("patch_") for child in children[1:])
    assert said["scenes"][0]["extras"] == {"origin": tree.origin.tolist(), "epsg": 32632}
    bark, leaf = said["materials"]
    assert (bark["name"], leaf["name"]) == ("bark", "leaf")
    assert (leaf["alphaMode"], leaf["doubleSided"], leaf["alphaCutoff"]) == ("MASK", True, 0.5)
    count = 0
    for child in children[1:]:
        table = child["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
        assert set(table) == {"TRANSLATION", "ROTATION", "SCALE"}
        count += said["accessors"][table["TRANSLATION"]]["count"]
    assert count == leaves["n_twigs"] > 0


def test_a_flat_file_is_for_programs_that_know_no_instances(run, pine, tmp_path):
    for suffix in ("glb", "obj", "ply"):
        flat = ["--flat"] if suffix == "glb" else []
        done = run("sapwood", "decode", pine, "-o", f"tree.{suffix}", *flat, "--lod", "0.2")
        assert (done.code, done.err) == (0, "")
    assert "extensionsRequired" not in glb(tmp_path / "tree.glb")
    pictures = {f"tree_{name}.png" for name in ("bark", "bark_normal", "leaf", "leaf_normal")}
    assert {"tree.obj", "tree.mtl", *pictures} <= set(names(tmp_path))
    loaded = {
        "glb": trimesh.load(tmp_path / "tree.glb", process=False).to_mesh(),
        "ply": trimesh.load(tmp_path / "tree.ply", process=False),
    }
    size = {key: len(mesh.faces) for key, mesh in loaded.items()}
    n_obj = sum(line.startswith("f ") for line in (tmp_path / "tree.obj").read_text().splitlines())
    assert size["glb"] == size["ply"] == n_obj > 1000
    y_up = loaded["glb"].bounds
    z_up = loaded["ply"].bounds
    assert np.allclose(y_up[:, 1], z_up[:, 2], atol=1e-4)  # as high in both
    groups = {line for line in (tmp_path / "tree.obj").read_text().splitlines() if line.startswith("usemtl")}
    assert groups == {"usemtl bark", "usemtl leaf"}


def test_lower_levels_are_smaller_and_as_leafy(run, pine):
    size, area = [], []
    for lod in (1.0, 0.1):
        said = run("sapwood", "decode", pine, "-o", f"l{lod}.ply", "--lod", lod, "--json").json
        assert said["lod"] == lod
        size.append(said["bytes"])
        area.append(said["leaves"]["leaf_area_m2"])
    assert size[1] < 0.8 * size[0]  # of a real species: test_dressed_trees.py
    assert area == pytest.approx([area[0]] * 2, rel=0.01)


def test_options_of_leaves_reach_the_file(run, pine, mine, tmp_path):
    first = run("sapwood", "decode", pine, "-o", "a.glb", "--json")
    assert run("sapwood", "decode", pine, "-o", "b.glb", "--seed", 0).code == 0
    assert (tmp_path / "a.glb").read_bytes() != b"" and glb(tmp_path / "a.glb")["nodes"][0]["name"] == "a"
    other = run("sapwood", "decode", pine, "-o", "c.glb", "--seed", 1, "--json").json
    assert other["seed"] == 1 and other["leaves"]["n_twigs"] > 0
    data = [(tmp_path / f"{name}.glb").read_bytes() for name in "abc"]
    assert data[0].replace(b'"name":"a"', b'"name":"b"') == data[1] and data[1] != data[2]
    rowan = run(
        "sapwood", "decode", pine, "-o", "d.glb", "--species", "mountain ash", "--library", mine, "--json"
    ).json["leaves"]
    assert rowan["species"] == "Rowan" != first.json["leaves"]["species"]
    bare = run(
        "sapwood", "decode", pine, "-o", "e.glb", "--species", "oak", "--season", "winter", "--json"
    ).json
    assert (bare["leaves"]["leaf_area_m2"], bare["leaves"]["n_leaves"]) == (0.0, 0)
    assert bare["leaves"]["n_twigs"] > 0
    evergreen = run("sapwood", "decode", pine, "-o", "f.glb", "--season", "winter", "--json").json
    assert evergreen["leaves"]["leaf_area_m2"] == first.json["leaves"]["leaf_area_m2"]


def test_hulls_are_still_to_be_had(run, pine, tmp_path):
    done = run("sapwood", "decode", pine, "-o", "hulls.glb", "--hulls", "--json")
    assert done.code == 0 and done.json["leaves"] is None and done.err == ""
    assert [node["name"] for node in glb(tmp_path / "hulls.glb")["nodes"]] == ["wood", "clusters"]
    less = run("sapwood", "decode", pine, "-o", "less.glb", "--hulls", "--lod", "0.1", "--json")
    assert less.json["bytes"] < done.json["bytes"]


def test_a_tree_of_another_library_keeps_its_hulls_with_a_note(run, tree, tmp_path, mine):
    treegraph.write_lobes(tree.replace(species="Rowan"), tmp_path / "rowan.lobes")
    done = run("sapwood", "decode", "rowan.lobes", "-o", "a.glb", "--json")
    assert done.code == 0 and done.json["leaves"] is None
    assert done.err == "note: there is no species 'Rowan' in the library; its clusters stay hulls\n"
    assert run("sapwood", "decode", "rowan.lobes", "-o", "b.glb", "--library", mine, "--json").json["leaves"]


def test_a_tree_of_no_species_says_how_to_give_it_leaves(run, tree, tmp_path):
    treegraph.write_lobes(tree.replace(species=None), tmp_path / "any.lobes")
    done = run("sapwood", "decode", "any.lobes", "-o", "a.glb")
    assert done.code == 0
    assert done.err == "note: the tree says no species, so its clusters stay hulls; name one with --species\n"
    assert run("sapwood", "decode", "any.lobes", "-o", "b.glb", "--species", "oak").err == ""


def test_a_bare_tree_has_no_leaves_to_speak_of(run, tree, tmp_path):
    bare = ClusterTree(tree.graph, (), "Oak", tree.allometry, np.zeros(3))
    treegraph.write_lobes(bare, tmp_path / "bare.lobes")
    done = run("sapwood", "decode", "bare.lobes", "-o", "a.glb", "--json")
    assert (done.code, done.err) == (0, "")
    assert (done.json["leaves"]["leaf_area_m2"], done.json["leaves"]["n_twigs"]) == (0.0, 0)
    assert trimesh.load(tmp_path / "a.glb").geometry  # there is nothing in it that only few can read
    assert "extensionsRequired" not in glb(tmp_path / "a.glb")
    treegraph.write_lobes(bare.replace(species=None), tmp_path / "none.lobes")
    assert run("sapwood", "decode", "none.lobes", "-o", "b.glb").err == ""


@pytest.mark.parametrize("suffix", ["swc", "csv"])
def test_branches_alone_have_no_leaves_and_the_options_are_not_just_forgotten(run, pine, suffix):
    done = run("sapwood", "decode", pine, "-o", f"tree.{suffix}", "--species", "oak", "--lod", "0.1")
    assert done.code == 0
    assert done.err == f"note: a .{suffix} file holds branches only: options for leaves are left out\n"
    assert run("sapwood", "decode", pine, "-o", f"plain.{suffix}").err == ""


@pytest.mark.parametrize(
    "arguments, text",
    [
        (["-o", "a.glb", "--species", "oka"], "there is no species 'oka'; did you mean 'Oak'?"),
        (["-o", "a.glb", "--library", "nowhere"], "nowhere: there is no such folder of species."),
        (["-o", "a.glb", "--season", "fall"], "Invalid value for '--season'"),
        (["-o", "a.glb", "--lod", "0"], "Invalid value for '--lod'"),
        (["-o", "a.glb", "--lod", "1.1"], "Invalid value for '--lod'"),
        (["-o", "a.glb", "--lod", "nan"], ""),
        (["-o", "a.glb", "--seed", "-1"], "Invalid value for '--seed'"),
        (["-o", "a.stl"], "a.stl: the name must end in one of .glb .obj .ply .swc .csv."),
        (["-o", "tree.lobes"], "tree.lobes: the name must end in one of"),
    ],
)
def test_what_decode_refuses(run, pine, tmp_path, arguments, text):
    before = names(tmp_path)
    done = run("sapwood", "decode", pine, *arguments)
    assert done.code == 2
    assert done.error.startswith(text)
    assert set(names(tmp_path)) - set(before) <= {"cache"}


def test_nothing_is_replaced_without_force(run, pine, tmp_path):
    (tmp_path / "a.glb").write_text("mine")
    done = run("sapwood", "decode", pine, "-o", "a.glb")
    assert done.code == 2 and "a.glb: the file exists already" in done.error
    assert not (tmp_path / "cache").exists()  # said before anything is derived
    assert run("sapwood", "decode", pine, "-o", "a.glb", "--force").code == 0


def test_a_tree_without_radii_is_the_files_fault(run, tree, tmp_path):
    radius = tree.graph.radius.copy()
    radius[2] = np.nan
    treegraph.write_lobes(tree.replace(graph=tree.graph.replace(radius=radius)), tmp_path / "x.lobes")
    for arguments in (["decode", "x.lobes", "-o", "a.glb"], ["decode", "x.lobes", "-o", "a.obj", "--hulls"]):
        done = run("sapwood", *arguments)
        assert done.code == 2 and done.error.startswith("x.lobes: radius must be known at every node")


def test_a_broken_file_of_ones_own_library_is_noted(run, pine, mine):
    (mine / "torn.toml").write_text("name = ")
    done = run("sapwood", "decode", pine, "-o", "a.glb", "--library", mine)
    assert done.code == 0
    assert done.err.startswith(f"note: left out: {mine / 'torn.toml'}: not a TOML file")
    grammar = add(mine, branchlets__grammar="axiom = F(")
    done = run("sapwood", "decode", pine, "-o", "b.glb", "--species", "rowan", "--library", mine, "--quiet")
    assert done.code == 2
    assert done.error.startswith(f"{grammar}: [branchlets] grammar, line 1, column ")


# ---------------------------------------------------------------- preview, reconstruct


def test_previews_have_the_leaves_of_the_season(run, pine, tmp_path):
    look = ["--size", "96x96", "--renderer", "software", "--json"]
    bare = ["--species", "oak", "--season", "winter"]
    options = {
        "summer": ["--lod", "0.3"],
        "winter": bare,
        "hulls": ["--hulls"],
        "less": ["--hulls", "--lod", "0.05"],
    }
    shown, green = {}, {}
    for name, more in options.items():
        done = run("sapwood", "preview", pine, "-o", f"{name}.png", *look, *more)
        assert done.code == 0, done.err
        assert (done.json["leaves"] is None) == (name in ("hulls", "less"))
        shown[name] = np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")).astype(int)
        r, g, b = (shown[name][..., k] for k in range(3))
        green[name] = ((g > r + 5) & (g > b + 10)).mean()
    assert green["summer"] > 0.02 and green["winter"] < 0.2 * green["summer"]
    assert (shown["hulls"] != shown["less"]).any()


def test_a_misspelt_species_is_said_before_a_scan_is_read(run, scans, mine):
    for arguments in (
        ["reconstruct", scans / "leafy.xyz", "-o", "out", "--species", "oka"],
        ["preview", scans / "leafy.xyz", "-o", "a.png", "--species", "oka"],
    ):
        done = run("sapwood", *arguments)
        assert (done.code, done.error) == (2, "there is no species 'oka'; did you mean 'Oak'?")


def test_a_species_that_cannot_be_derived_is_said_before_a_scan_is_read(run, scans, mine, tmp_path):
    path = add(mine, branchlets__grammar=GRAMMAR.replace("L(", "f(9) F(1) L("))
    arguments = [scans / "leafy.xyz", "-o", "out", "--no-preview", "--species", "rowan", "--library", mine]
    done = run("reconstruct", *arguments)
    assert done.code == 2
    assert done.error.startswith(f"{path}: [branchlets] branchlet 1 of 4: it is in pieces")
    assert not (tmp_path / "out").exists()
    assert (
        run("reconstruct", *arguments, "--hulls", "--quiet").code == 0
    )  # its allometry is all that is asked for


def test_reconstruct_dresses_the_tree(run, scans, mine, tmp_path):
    common = [scans / "leafy.xyz", "--no-preview", "--json", "--library", mine]
    done = run("reconstruct", *common, "-o", "a", "--species", "mountain ash", "--season", "autumn")
    report = done.json["trees"][0]
    assert done.code == 0
    assert report["leaves"]["species"] == "Rowan" and report["leaves"]["season"] == "autumn"
    assert report["leaf_area_m2"] == report["leaves"]["leaf_area_m2"]
    assert report["leaf_area_m2"] == pytest.approx(2.5 * report["leaves"]["cluster_volume_m3"], rel=0.01)
    assert report["settings"]["species"] == "Rowan"
    assert (report["settings"]["beta"], report["settings"]["gamma"]) == (1.6, 1.5)
    said = glb(tmp_path / "a" / "leafy.glb")
    assert said["nodes"][0]["name"] == "leafy" and "extensionsRequired" in said
    assert treegraph.read_lobes(tmp_path / "a" / "leafy.lobes").species == "Rowan"
    decoded = run(
        "sapwood", "decode", "a/leafy.lobes", "-o", "x.glb", "--library", mine, "--season", "autumn", "--json"
    )
    assert decoded.json["leaves"]["leaf_area_m2"] == pytest.approx(report["leaf_area_m2"], rel=0.05)
    hulls = run("reconstruct", *common, "-o", "b", "--species", "rowan", "--hulls").json["trees"][0]
    assert hulls["leaf_area_m2"] is None and hulls["leaves"] is None
    none = run("reconstruct", *common, "-o", "c", "--species", "none").json["trees"][0]
    assert none["leaf_area_m2"] is None and none["settings"]["species"] is None


def test_what_the_leaves_could_not_fill_is_noted(run, scans, pine, tmp_path):
    giant = GRAMMAR.replace("L(0", "L(8")
    add(tmp_path / "mine", name="Giant", also=[], leaf__length=8, leaf__width=6, branchlets__grammar=giant)
    done = run("sapwood", "decode", pine, "-o", "a.glb", "--species", "giant", "--library", tmp_path / "mine")
    assert done.code == 0
    assert done.err.startswith(
        "note: twigs of Giant do not fill these clusters: 0 m2 of leaves, where their density"
    )
    done = run(
        "reconstruct", scans / "leafy.xyz", "-o", "out", "--no-preview", "--json", "--species", "giant",
        "--library", tmp_path / "mine",
    )  # fmt: skip
    note = done.json["trees"][0]["notes"][-1]
    assert note.startswith("twigs of Giant do not fill these clusters") and note in done.err


def test_a_tree_that_is_saved_without_its_library_says_so(scans, mine, tmp_path):
    made = reconstruct(scans / "leafy.xyz", species="rowan", library=mine)
    report = save(made, tmp_path / "out", preview=False).report
    assert report["leaves"] is None
    assert report["notes"][-1] == "there is no species 'Rowan' in the library; its clusters stay hulls"
    again = save(made, tmp_path / "out", preview=False, library=mine, force=True).report
    assert again["leaves"]["species"] == "Rowan" and again["notes"] == list(made.notes)


def test_a_definition_is_copied_to_start_from(run, tmp_path):
    oak = builtin_library().find("Oak").text
    done = run("sapwood", "species", "show", "english oak", "-o", "mine.toml")
    assert done.code == 0, done.err
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == oak
    again = run("sapwood", "species", "show", "oak", "-o", "mine.toml")
    assert again.code == 2 and "--force" in again.err
