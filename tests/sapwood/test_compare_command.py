"""``sapwood compare``: two trees from files."""

import numpy as np
import numpy.testing as npt
import pytest

from inverse import Weights, compare_trees, map_pieces
from sapwood.comparing import UNMATCHED, list_pairs, mapping_parts, pair_colors, read_graph
from treegraph import InputError, TreeGraph, write_swc

FORK = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 2], [0.5, 0, 3], [-0.8, 0, 3]], [0.1, 0.1, 0.05, 0.06])
MORE = TreeGraph(
    [-1, 0, 1, 1, 1], [[0, 0, 0], [0, 0, 2.2], [0.5, 0, 3], [-0.8, 0.1, 3], [0, 2, 2.5]],
    [0.1, 0.1, 0.05, 0.06, 0.01],
)  # fmt: skip


@pytest.fixture
def files(tmp_path):
    """Two trees as SWC, far from the origin."""
    for name, tree in (("fork", FORK), ("more", MORE)):
        mapped = tree.replace(position=tree.position + (455012.0, 5428007.0, 231.0))
        write_swc(mapped, tmp_path / f"{name}.swc")
    return tmp_path / "fork.swc", tmp_path / "more.swc"


def test_numbers(run, files):
    done = run("sapwood", "compare", *files, "--json")
    assert (done.code, done.err) == (0, "")
    want = compare_trees(FORK, MORE)
    for name in ("distance", "shape", "geometry", "structure"):
        npt.assert_allclose(done.json[name], getattr(want, name), atol=1e-5)
    assert done.json["parts"].keys() == {"shape", "geometry"}
    npt.assert_allclose([*done.json["parts"]["shape"].values()], [*want.shape_parts.values()], atol=1e-4)
    assert done.json["matched"][0] == 1.0
    assert done.json["matched"][1] < 1.0
    assert {tuple(pair["a"]) for pair in done.json["pairs"]} == {(0, 1), (1, 2), (1, 3)}
    assert done.json["pairs"][0] == {"a": [0, 1], "b": [0, 1], "a_length_m": 2.0, "b_length_m": 2.2} | {
        "cost_m2": done.json["pairs"][0]["cost_m2"]
    }
    assert (done.json["picture"], done.json["renderer"]) == (None, None)


def test_lines(run, files):
    done = run("sapwood", "compare", *files)
    lines = done.out.splitlines()
    assert lines[0] == f"A {files[0]}, 3 branches between forks"
    assert lines[1] == f"B {files[1]}, 4 branches between forks"
    assert [line.split()[0] for line in lines[2:6]] == ["distance", "shape", "geometry", "structure"]
    assert lines[5].endswith("100% of A and 68% of B by length have a counterpart")
    assert lines[6] == "  A 0-1 (2.00 m) -> B 0-1 (2.20 m)"
    assert len(lines) == 9


def test_a_tree_and_itself(run, lobes):
    done = run("sapwood", "compare", lobes, lobes, "--json")
    assert done.json["distance"] < 1e-9
    assert done.json["matched"] == [1.0, 1.0]


def test_weights(run, files):
    done = run("sapwood", "compare", *files, "--json", "--weights", "0.5,0.25,0.25")
    want = compare_trees(*map(read_graph, files), weights=Weights(0.5, 0.25, 0.25))
    assert done.json["distance"] == want.distance
    assert done.json["weights"] == [0.5, 0.25, 0.25]


def test_picture(run, files, tmp_path):
    arguments = (
        "sapwood",
        "compare",
        *files,
        "--picture",
        "new.png",
        "--size",
        "200x160",
        "--renderer",
        "software",
    )
    done = run(*arguments, "--json")
    assert done.code == 0
    assert (done.json["picture"], done.json["renderer"]) == ("new.png", "software")
    assert (tmp_path / "new.png").read_bytes()[:4] == b"\x89PNG"
    again = run(*arguments)
    assert again.code == 2
    assert again.error.startswith("new.png: the file exists already")


@pytest.mark.parametrize(
    "arguments, match",
    [
        (("none.swc", "none.swc"), "none.swc: there is no such file."),
        (("fork.swc", "tree.laz"), "tree.laz: the name of a tree to compare must end in .lobes or .swc."),
        (("fork.swc", "bad.swc"), "bad.swc: line 1: a row must have 7 columns"),
        (("fork.swc", "forest.swc"), "forest.swc: a tree to compare must have one root, got 2"),
        (("radii.swc", "fork.swc"), "radii.swc: a tree to compare must have known radii"),
        (
            ("fork.swc", "more.swc", "--weights", "1,1,1"),
            "weights must be three numbers from 0 to 1 that add",
        ),
        (("fork.swc", "more.swc", "--weights", "a,b"), "'a,b' is not three numbers S,G,T"),
        (("fork.swc", "more.swc", "--picture", "x.gif"), "x.gif: the name of a picture must end in .png"),
    ],
)
def test_errors(run, files, tmp_path, arguments, match):
    (tmp_path / "bad.swc").write_text("1 2 3\n")
    write_swc(TreeGraph([-1, -1], [[0, 0, 0], [0, 0, 1]], [0.1, 0.1]), tmp_path / "forest.swc")
    write_swc(FORK.replace(radius=[np.nan] * 4), tmp_path / "radii.swc")
    done = run("sapwood", "compare", *arguments)
    assert done.code == 2
    assert match in done.error


def test_colors():
    """Both sides of a pair have one colour, what has no counterpart is grey; the root may have no radius."""
    mapping = map_pieces(FORK, MORE.replace(radius=[np.nan, *MORE.radius[1:]]))
    one, two = (part.mesh for part in mapping_parts(mapping, "coarse"))
    grey = np.array(UNMATCHED, np.uint8)
    assert not (one.color == grey).all(axis=1).any()
    assert (two.color == grey).all(axis=1).any()
    colors = {tuple(c) for c in one.color.tolist()}
    assert len(colors) == 3
    assert colors == {tuple(c) for c in two.color.tolist()} - {tuple(UNMATCHED)}
    assert two.vertices[:, 0].min() > one.vertices[:, 0].max()
    assert len({tuple(c) for c in pair_colors(300).tolist()}) > 290


def test_pairs_have_all_that_is_mapped():
    mapping = map_pieces(FORK, MORE)
    pairs = list_pairs(mapping)
    npt.assert_allclose(sum(p["a_length_m"] for p in pairs), mapping.a.length.sum(), atol=1e-3)
    npt.assert_allclose(sum(p["cost_m2"] for p in pairs), mapping.cost.sum(), atol=1e-8)


def test_nothing_to_draw():
    node = TreeGraph([-1], [[0, 0, 0]], [0.1])
    with pytest.raises(InputError, match="the trees have no length: there is nothing to draw"):
        mapping_parts(map_pieces(node, node))
