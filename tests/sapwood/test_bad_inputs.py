"""What people really hand to the command: one line on stderr says the file, what is wrong and what to do."""

import re
import struct

import numpy as np
import pytest
from sapwood_scans import tree_points, write_las, write_xyz

PLY = "ply\nformat {order} 1.0\nelement vertex {n}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n"
FACES = "element face {n}\nproperty list uchar int vertex_indices\n"
COUNT_AT = 107  # where LAS 1.2 keeps the number of points


def las_bytes(path, points):
    return bytearray(write_las(path, points).read_bytes())


def as_text(points, delimiter, decimal):
    rows = (delimiter.join(f"{value:.4f}".replace(".", decimal) for value in point) for point in points)
    return "\n".join(rows) + "\n"


def plot(n_trees, gap=7.0):
    """Trees on a grid, `gap` metres apart."""
    side = int(np.ceil(np.sqrt(n_trees)))
    feet = [(gap * (k % side), gap * (k // side), 0.0) for k in range(n_trees)]
    return [tree_points(k, height=7 + k % 4, foot=foot, n=3000) for k, foot in enumerate(feet)]


def empty(folder):
    (folder / "scan.laz").write_bytes(b"")


def three_points(folder):
    write_xyz(folder / "scan.xyz", tree_points()[:3])


def ten_points(folder):
    write_xyz(folder / "scan.xyz", tree_points()[:10])


def one_place(folder):
    write_xyz(folder / "scan.xyz", np.repeat(tree_points()[:1], 500, axis=0))


def all_nan(folder):
    header = PLY.format(order="binary_little_endian", n=300, kind="double") + "end_header\n"
    (folder / "scan.ply").write_bytes(header.encode() + np.full((300, 3), np.nan).tobytes())


def cut_header(folder):
    (folder / "scan.las").write_bytes(las_bytes(folder / "scan.las", tree_points())[:100])


def cut_laz(folder):
    data = las_bytes(folder / "scan.laz", tree_points())
    (folder / "scan.laz").write_bytes(data[: len(data) // 2])


def cut_ply(folder):
    (folder / "scan.ply").write_text(PLY.format(order="ascii", n=100, kind="float"))


def picture(folder):
    (folder / "scan.laz").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20)


def prose(folder):
    (folder / "scan.xyz").write_text("Dear colleague,\nplease find the scan attached.\n")


def hostile_header(folder):
    """A million million points, declared, and none there."""
    header = PLY.format(order="binary_little_endian", n=10**12, kind="double") + "end_header\n"
    (folder / "scan.ply").write_text(header)


def hostile_las(folder):
    """Points of a kind that there is not, and an offset beyond the end."""
    data = las_bytes(folder / "scan.las", tree_points())
    data[96:100] = struct.pack("<I", 2**31)
    (folder / "scan.las").write_bytes(data)


def mesh(folder):
    text = PLY.format(order="ascii", n=3, kind="float") + FACES.format(n=1) + "end_header\n"
    (folder / "scan.ply").write_text(text + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")


def mesh_without_points(folder):
    text = PLY.format(order="ascii", n=0, kind="float") + FACES.format(n=0) + "end_header\n"
    (folder / "scan.ply").write_text(text)


def commas_everywhere(folder):
    (folder / "scan.csv").write_text(as_text(tree_points(), ",", ","))


def millimetres(folder):
    write_xyz(folder / "scan.xyz", 1000 * tree_points(), decimals=1)


def two_trees(folder):
    write_xyz(folder / "scan.xyz", np.concatenate(plot(2)))


def forty_trees(folder):
    write_xyz(folder / "scan.xyz", np.concatenate(plot(40)))


def missing(folder):
    pass


#: The file, and what its line must speak of; the exact words are the reader's own.
CASES = {
    empty: ("scan.laz", "empty"),
    three_points: ("scan.xyz", "3 usable points are too few"),
    ten_points: ("scan.xyz", "10 usable points are too few"),
    one_place: ("scan.xyz", "all 500 points are the same"),
    all_nan: ("scan.ply", "usable points are too few"),
    cut_header: ("scan.las", "LAS header"),
    cut_laz: ("scan.laz", "cut off|damaged|Copy the file again"),
    cut_ply: ("scan.ply", "no end_header"),
    picture: ("scan.laz", "picture|not a scan|one point a line"),
    prose: ("scan.xyz", "three or more numbers"),
    hostile_header: ("scan.ply", "1000000000000 points"),
    hostile_las: ("scan.las", "cannot be read|no point can be read|cut off|beyond|usable points"),
    mesh: ("scan.ply", "a mesh of 1 face.*--as-points"),
    mesh_without_points: ("scan.ply", "no points|mesh"),
    commas_everywhere: ("scan.csv", "decimal commas"),
    millimetres: ("scan.xyz", "--units mm"),
    two_trees: ("scan.xyz", "looks like 2 trees.*--largest"),
    forty_trees: ("scan.xyz", r"looks like \d\d+ trees.*--largest"),
    missing: ("scan.laz", "no such file"),
}


@pytest.mark.parametrize("make", CASES, ids=lambda make: make.__name__)
def test_bad_input_is_one_line_that_helps(run, tmp_path, make):
    name, said = CASES[make]
    make(tmp_path)
    done = run("reconstruct", name, "-o", "out", "--no-preview")
    assert done.code == 2, done.err
    assert done.out == ""
    assert re.match(rf"{re.escape(name)}: .*({said})", done.error), done.error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("make", [empty, picture, missing, hostile_header], ids=lambda make: make.__name__)
@pytest.mark.parametrize("command", ["info", "preview"])
def test_the_other_commands_say_the_same(run, tmp_path, make, command):
    name, said = CASES[make]
    make(tmp_path)
    more = ["-o", "x.png"] if command == "preview" else []
    done = run("sapwood", command, name, *more)
    assert done.code == 2
    assert re.match(rf"{re.escape(name)}: .*({said})", done.error), done.error


# ---------------------------------------------------------------- bad, but enough is there


def notes_of(run, *arguments):
    done = run("reconstruct", *arguments, "-o", "out", "--no-preview", "--json", "--quiet")
    assert done.code == 0, done.err
    return done.json["trees"][0], " | ".join(done.json["trees"][0]["notes"])


def test_some_points_are_no_numbers(run, tmp_path):
    points = tree_points(leaves=False)
    points[5::100] = np.nan
    write_xyz(tmp_path / "scan.xyz", points)
    tree, notes = notes_of(run, "scan.xyz")
    assert f"{len(points[5::100])} of {len(points)} points have no finite coordinates" in notes
    assert tree["dbh_m"] == pytest.approx(0.27, rel=0.05)


@pytest.mark.parametrize("declared", [10**9, 9000])
def test_a_las_that_declares_more_points_than_it_has(run, tmp_path, declared):
    data = las_bytes(tmp_path / "scan.las", tree_points())
    data[COUNT_AT : COUNT_AT + 4] = struct.pack("<I", declared)
    (tmp_path / "scan.las").write_bytes(data)
    tree, notes = notes_of(run, "scan.las")
    assert re.search(rf"declares {declared} points.*{len(tree_points())}", notes)
    assert tree["n_points_read"] == len(tree_points())


def test_a_las_that_is_cut_off_between_points(run, tmp_path):
    points = tree_points()
    data = las_bytes(tmp_path / "scan.las", points)
    (tmp_path / "scan.las").write_bytes(data[:-2000])  # a point has 20 bytes
    tree, notes = notes_of(run, "scan.las")
    assert str(len(points)) in notes
    assert tree["n_points_read"] == len(points) - 100


def test_decimal_commas(run, tmp_path):
    points = tree_points(leaves=False)
    (tmp_path / "comma.txt").write_text(as_text(points, ";", ","))
    (tmp_path / "point.txt").write_text(as_text(points, " ", "."))
    comma, point = notes_of(run, "comma.txt")[0], notes_of(run, "point.txt")[0]
    assert comma["dbh_m"] == point["dbh_m"]
    assert comma["total_length_m"] == point["total_length_m"]


def test_millimetres_are_read_when_said(run, tmp_path):
    write_xyz(tmp_path / "scan.xyz", 1000 * tree_points(leaves=False), decimals=1)
    tree, _ = notes_of(run, "scan.xyz", "--units", "mm")
    assert tree["dbh_m"] == pytest.approx(0.27, rel=0.05)
    assert tree["height_m"] == pytest.approx(7.6, abs=0.3)


def test_a_scan_that_lies_on_its_side(run, tmp_path):
    write_xyz(tmp_path / "scan.xyz", tree_points(leaves=False)[:, [0, 2, 1]] * [1, 1, -1])
    tree, _ = notes_of(run, "scan.xyz", "--up", "y")
    assert tree["dbh_m"] == pytest.approx(0.27, rel=0.05)


def test_the_largest_of_many(run, tmp_path):
    trees = plot(5)
    trees[3] = tree_points(3, height=12.0, foot=(0.0, 7.0, 0.0), n=9000)
    write_xyz(tmp_path / "scan.xyz", np.concatenate(trees))
    tree, _ = notes_of(run, "scan.xyz", "--largest")
    np.testing.assert_allclose(tree["origin"][:2], [0.0, 7.0], atol=0.3)
    assert 10.5 < tree["height_m"] < 13.5


def test_vertices_of_a_mesh_are_read_when_said(run, tmp_path):
    points = tree_points(leaves=False)
    text = PLY.format(order="ascii", n=len(points), kind="float") + FACES.format(n=1) + "end_header\n"
    (tmp_path / "scan.ply").write_text(text + as_text(points, " ", ".") + "3 0 1 2\n")
    tree, notes = notes_of(run, "scan.ply", "--as-points")
    assert "the vertices of a mesh of 1 faces were read as points" in notes
    assert tree["dbh_m"] == pytest.approx(0.27, rel=0.05)


# ---------------------------------------------------------------- places


def test_a_folder_without_scans(run, tmp_path):
    (tmp_path / "plots").mkdir()
    (tmp_path / "plots" / "notes.md").write_text("# Plots")
    done = run("reconstruct", "plots", "-o", "out")
    assert done.code == 2
    assert done.error.startswith("plots: no scan in this folder; looked for .las .laz ")


def test_a_pattern_that_matches_nothing(run):
    done = run("reconstruct", "plots/*.laz", "-o", "out")
    assert (done.code, done.error) == (2, "plots/*.laz: no file matches this pattern.")


def test_an_output_folder_that_is_a_file(run, scans, tmp_path):
    (tmp_path / "out").write_text("mine")
    done = run("reconstruct", scans / "bare.xyz", "-o", "out")
    assert (done.code, done.error) == (2, "out: this is a file, not a folder; name another one.")
    assert (tmp_path / "out").read_text() == "mine"


def test_an_output_folder_that_cannot_be_made(run, scans, tmp_path):
    done = run("reconstruct", scans / "bare.xyz", "-o", "/proc/out")
    assert done.code == 2
    assert re.fullmatch(r"/proc/out: the folder cannot be made \(.+\); name another one\.", done.error)


def test_a_folder_asked_for_as_a_scan_of_a_tree(run, tmp_path):
    (tmp_path / "oak.lobes").mkdir()
    done = run("sapwood", "info", "oak.lobes")
    assert (done.code, done.error) == (2, "oak.lobes: this is a folder; name a .lobes file in it.")
