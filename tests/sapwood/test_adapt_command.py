"""``sapwood adapt``: a tree in other surroundings, from files to files."""

import numpy as np
import numpy.testing as npt
import pytest

import treegraph
from sapwood.adapting import Yard, adapt_yard, follow, parse_path, placed_tree, shift_obstacle
from tests.plastic.plastic_trees import grown_state, grown_tree, same
from treegraph import Ball, Box, HalfSpace, InputError, TriangleMesh

WALL = ("--obstacle", "wall:x=0.9")


@pytest.fixture
def tree(tmp_path):
    """A grown tree with its leaves, as a file."""
    treegraph.write_lobes(grown_tree(10), tmp_path / "tree.lobes")
    return "tree.lobes"


def test_a_wall_bends_and_prunes(run, tree, tmp_path):
    done = run("sapwood", "adapt", tree, *WALL, "-o", "wall.lobes", "--json")
    assert (done.code, done.err) == (0, "")
    before, after = (treegraph.read_lobes(tmp_path / f"{n}.lobes") for n in ("tree", "wall"))
    said = done.json
    assert said["command"] == "adapt"
    assert said["nodes_before"] == before.graph.n_nodes
    assert said["nodes_after"] == after.graph.n_nodes
    assert said["pruned"] == said["nodes_before"] - said["nodes_after"] > 0
    assert said["mean_shift_m"] > 0.05
    assert said["seconds"] >= said["analyse_s"] + said["adapt_s"] > 0.0
    assert said["files"] == ["wall.lobes"]
    assert after.graph.position[:, 0].max() < 0.9 + 1e-3  # of the file's precision
    assert all(c.vertices[:, 0].max() < 0.9 + 1e-2 for c in after.clusters)
    (one,) = said["trees"]
    assert one["name"] == "tree"
    assert one["pruned"] == one["pruned_by_light"] + one["pruned_by_obstacles"]


def test_untouched_surroundings_give_the_file_back(run, tree, tmp_path):
    done = run("sapwood", "adapt", tree, "--obstacle", "sphere:90,0,1,0.5", "-o", "same.lobes", "--json")
    assert done.json["pruned"] == 0
    assert done.json["mean_shift_m"] == 0.0
    assert (tmp_path / "same.lobes").read_bytes() == (tmp_path / tree).read_bytes()


def test_same_bytes_again(run, tree, tmp_path):
    for name in ("a.swc", "b.swc"):
        run("sapwood", "adapt", tree, *WALL, "-o", name)
    assert (tmp_path / "a.swc").read_bytes() == (tmp_path / "b.swc").read_bytes()


def test_strengths(run, tree):
    def shift(*more):
        return run("sapwood", "adapt", tree, *WALL, *more, "-o", "t.swc", "--force", "--json").json

    assert shift("--bending", "0", "--pruning", "0")["mean_shift_m"] == 0.0
    assert shift("--bending", "2")["mean_shift_m"] > shift()["mean_shift_m"]
    assert shift("--pruning", "1.5")["pruned"] > shift("--pruning", "0")["pruned"]
    assert shift("--phototropism", "0.3")["mean_shift_m"] > shift()["mean_shift_m"]
    assert shift("--gravitropism", "0.5")["mean_shift_m"] < shift()["mean_shift_m"]


def test_light_from_the_side(run, tree, tmp_path):
    run("sapwood", "adapt", tree, "--latitude", "60", "--pruning", "0", "-o", "north.swc")
    old, new = treegraph.read_lobes(tmp_path / tree).graph, treegraph.read_swc(tmp_path / "north.swc")
    assert new.position[:, 1].mean() < old.position[:, 1].mean() - 0.05  # the sun stands in the south


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".csv"])
def test_every_format(run, tree, tmp_path, suffix):
    done = run("sapwood", "adapt", tree, *WALL, "-o", f"t{suffix}")
    assert (done.code, done.out.split(" -> ")[1]) == (0, f"t{suffix}\n")
    assert (tmp_path / f"t{suffix}").stat().st_size > 1000


def test_dressed_with_a_species(run, tree, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    run("sapwood", "adapt", tree, *WALL, "--species", "oak", "-o", "oak.glb")
    run("sapwood", "adapt", tree, *WALL, "--hulls", "-o", "hulls.glb")
    oak, hulls = (trimesh.load(tmp_path / f"{name}.glb") for name in ("oak", "hulls"))
    assert set(hulls.geometry) == {"wood", "clusters"}
    assert len(oak.geometry) >= 2
    assert sum(len(g.faces) for g in oak.geometry.values()) > sum(
        len(g.faces) for g in hulls.geometry.values()
    )


# ---------------------------------------------------------------- pictures


def pixels(path):
    from PIL import Image

    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def test_changes_are_red_and_blue(run, tree, tmp_path):
    look = ("--size", "240x300", "--renderer", "software")
    run("sapwood", "adapt", tree, *WALL, *look, "--changes", "-o", "c.png")
    run("sapwood", "adapt", tree, *WALL, *look, "-o", "n.png")
    red, blue = [], []
    for name in ("c", "n"):
        r, g, b = pixels(tmp_path / f"{name}.png").transpose(2, 0, 1)
        red.append(int(((r > g + 40) & (r > b + 40)).sum()))
        blue.append(int(((b > r + 40) & (b > g + 20)).sum()))
    assert red[0] > red[1] + 30
    assert blue[0] > blue[1] + 30


def test_a_path_gives_frames(run, tree, tmp_path):
    from PIL import Image

    wall = ("--obstacle", "box:2.5,-2,0,0.2,4,4")
    more = ("--path", "0,0,0 -1.5,0,0", "--frames", "3", "--size", "80x100", "--renderer", "software")
    done = run("sapwood", "adapt", tree, *wall, *more, "-o", "move.gif", "--json")
    assert (done.code, done.json["files"]) == (0, ["move.gif"])
    with Image.open(tmp_path / "move.gif") as gif:
        assert (gif.n_frames, gif.size) == (3, (80, 100))
    done = run("sapwood", "adapt", tree, *wall, *more, "-o", "move.png", "--json")
    assert done.json["files"] == ["move_000.png", "move_001.png", "move_002.png"]
    first, last = (pixels(tmp_path / f"move_00{k}.png") for k in (0, 2))
    assert first.shape == (100, 80, 3)
    assert np.abs(first - last).max() > 50
    still = run("sapwood", "adapt", tree, "--obstacle", "box:1,-2,0,0.2,4,4", "-o", "end.swc", "--json").json
    for name in ("nodes_after", "mean_shift_m"):  # of the last frame
        assert done.json[name] == still[name]


def test_frames_along_a_path_are_evenly_spaced():
    path = parse_path("0,0,0 3,0,0 3,4,0")
    from dataclasses import replace

    from plastic import Neighbour, Scene

    yard = Yard((Neighbour(grown_state()),), Scene((Ball((9, 9, 9), 1.0), Ball((5, 5, 5), 0.5))), ("a",))
    found = list(follow(yard, path, 8))
    middles = np.array([things[-1].center for things, _ in found])
    npt.assert_allclose(np.linalg.norm(np.diff(middles, axis=0), axis=1), 1.0)
    assert middles[[0, -1]].tolist() == [[5, 5, 5], [8, 9, 5]]
    assert all(things[0].center.tolist() == [9, 9, 9] for things, _ in found)
    for things, (adapted,) in found[::3]:
        assert same(adapted, grown_state().adapt(replace(yard.scene, obstacles=things)))


def test_every_obstacle_can_be_shifted():
    by = np.array([1.0, 2.0, 3.0])
    assert shift_obstacle(Ball((0, 0, 0), 1.0, 0.5), by).center.tolist() == [1, 2, 3]
    assert shift_obstacle(Ball((0, 0, 0), 1.0, 0.5), by).translucency == 0.5
    assert shift_obstacle(HalfSpace((0, 0, 0), (1, 0, 0)), by).point.tolist() == [1, 2, 3]
    turned = Box((0, 0, 0), (1, 2, 3), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    assert shift_obstacle(turned, by).rotation.tolist() == turned.rotation.tolist()
    assert (
        shift_obstacle(TriangleMesh(np.eye(3), [[0, 1, 2]]), by).vertices.tolist()
        == (np.eye(3) + by).tolist()
    )


# ---------------------------------------------------------------- scenes of several trees

YARD = """
[strength]
pruning = 0.5
[[obstacle]]
kind = "wall"
x = -2.5
[[tree]]
file = "tree.lobes"
[[tree]]
file = "tree.lobes"
position = [1.5, 0.2]
turn_deg = 90
"""


def test_a_scene_of_two_trees(run, tree, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "yard.toml").write_text(YARD)
    done = run("sapwood", "adapt", "--scene", "yard.toml", "-o", "yard.lobes", "--json")
    assert done.json["files"] == ["yard_1.lobes", "yard_2.lobes"]
    assert [t["nodes_before"] for t in done.json["trees"]] == [grown_tree(10).graph.n_nodes] * 2
    assert done.json["nodes_before"] == 2 * grown_tree(10).graph.n_nodes
    run("sapwood", "adapt", "--scene", "yard.toml", "-o", "yard.glb")
    assert set(trimesh.load(tmp_path / "yard.glb").geometry) == {"wood", "clusters", "wood_1", "clusters_1"}
    again = run("sapwood", "adapt", tree, "--scene", "yard.toml", "-o", "one.lobes", "--json").json
    assert again["files"] == ["one.lobes"]
    assert len(again["trees"]) == 3


def test_placed_trees_stand_where_the_scene_says():
    from plastic import Neighbour, Scene

    state = grown_state()
    place = Neighbour(state, (5.0, 1.0, 0.5), np.pi / 2)
    (adapted,) = adapt_yard(Yard((place,), Scene(), ("a",)))
    assert adapted.tree is state.tree
    graph = placed_tree(adapted).graph
    x, y, z = state.tree.graph.position.T
    npt.assert_allclose(graph.position, np.column_stack([5.0 - y, 1.0 + x, 0.5 + z]), atol=1e-12)
    hull = placed_tree(adapted).clusters[0].vertices
    x, y, z = state.tree.clusters[0].vertices.T
    npt.assert_allclose(hull, np.column_stack([5.0 - y, 1.0 + x, 0.5 + z]), atol=1e-12)


# ---------------------------------------------------------------- what is wrong


@pytest.mark.parametrize(
    "arguments, error",
    [
        (("-o", "t.lobes"), "there is no tree: name a file X.lobes, or a scene file with [[tree]] tables."),
        (("tree.lobes", "-o", "t.stl"), "t.stl: the name must end in one of .glb .obj .ply .lobes .swc .csv"),
        (("tree.lobes", "-o", "t.swc", "--frames", "3"), "--frames goes with --path."),
        (
            ("tree.lobes", "-o", "t.swc", "--changes"),
            "t.swc: --changes colours pictures and meshes, not .swc.",
        ),
        (
            ("tree.lobes", "-o", "t.glb", "--path", "0,0,0 1,0,0"),
            "t.glb: the frames of a path are a .gif, or a .png or .jpg each.",
        ),
        (
            ("tree.lobes", "-o", "t.gif", "--path", "0,0,0"),
            "a path leads through two places or more, as in '0,0,0 -2,0,0', got '0,0,0'",
        ),
        (
            ("tree.lobes", "-o", "t.gif", "--path", "0,0 1,0,0"),
            "a path is places dx,dy,dz with blanks between them, got '0,0' in '0,0 1,0,0'",
        ),
        (
            ("tree.lobes", "-o", "t.gif", "--path", "0,0,0 1,0,0"),
            "a path moves an obstacle, and there is none: name one with --obstacle.",
        ),
        (("tree.lobes", "-o", "t.swc", "--pruning", "-1"), "pruning must be from 0 to 100, got -1.0"),
        (
            ("tree.lobes", "-o", "t.swc", "--phototropism", "2"),
            "phototropism must be from 0 to below 1, got 2.0",
        ),
        (("tree.lobes", "-o", "t.swc", "--obstacle", "cube"), "an obstacle must be wall:x=1.5"),
        (
            ("tree.lobes", "-o", "t.swc", "--obstacle", "sphere:0,0,0,1"),
            "tree 0, at [0.0, 0.0, 0.0], has its foot inside an obstacle; move one of them",
        ),
        (
            ("tree.lobes", "-o", "t.png", "--obstacle", "sphere:3,0,0,1", "--obstacle", "wall:x=1e300"),
            "obstacles must be within 1e+09 m, but the 2. of them has 1e+300 m",
        ),
        (
            ("tree.lobes", "-o", "t.gif", "--obstacle", "wall:x=3", "--path", "0,0,0 1e308,0,0"),
            "a path must stay within 1e+09 m, got '1e308,0,0'",
        ),
        (("nothing.lobes", "-o", "t.swc"), "nothing.lobes: there is no such file."),
        (
            ("tree.lobes", "-o", "tree.lobes"),
            "tree.lobes: the file exists already; overwrite it with --force",
        ),
        (
            ("--scene", "no.toml", "-o", "t.swc"),
            "no.toml: the file cannot be read (No such file or directory).",
        ),
    ],
)
def test_faults_are_one_line(run, tree, arguments, error):
    done = run("sapwood", "adapt", *arguments)
    assert done.code == 2
    assert done.error.startswith(error)


def test_trees_without_radii_cannot_be_drawn(run, tmp_path):
    bare = grown_tree(10)
    radii = np.full(bare.graph.n_nodes, np.nan)
    treegraph.write_lobes(bare.replace(graph=bare.graph.replace(radius=radii)), tmp_path / "nan.lobes")
    assert run("sapwood", "adapt", "nan.lobes", *WALL, "-o", "t.swc").code == 0
    done = run("sapwood", "adapt", "nan.lobes", *WALL, "-o", "t.glb")
    assert done.code == 2
    assert done.err.splitlines()[-1].startswith("error: nan.lobes: radius must be known")


@pytest.mark.parametrize("text", ["", "1,2,3", "a b", "0,0,0 nan,0,0"])
def test_bad_paths(text):
    with pytest.raises(InputError, match="a path "):
        parse_path(text)
