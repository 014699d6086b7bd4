"""``sapwood scan``: what it writes, what `reconstruct` makes of it, what it refuses."""

import numpy as np
import numpy.testing as npt
import pytest
from test_scanning_scenes import cluster_tree, fork

import recon
from recon.preparing import PrepareSettings, prepare

QUICK = ("--step", "0.5deg", "--stations", "2", "--distance", "6")


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A small tree with one cluster of leaves, as .lobes, .swc and .glb."""
    import render
    import treegraph

    folder = tmp_path_factory.mktemp("trees")
    treegraph.write_lobes(cluster_tree(), folder / "tree.lobes")
    treegraph.write_swc(fork(), folder / "tree.swc")
    render.write_glb(folder / "tree.glb", render.tree_parts(cluster_tree()))
    return folder / "tree.lobes"


def rows(path):
    """Columns of a written scan."""
    if path.endswith(".ply"):
        import plyfile

        return plyfile.PlyData.read(path)["vertex"].data
    import laspy

    return laspy.read(path)


@pytest.mark.parametrize("suffix", ["laz", "las", "ply"])
def test_written_and_read_again(run, tree, suffix):
    name = f"scan.{suffix}"
    done = run("sapwood", "scan", tree, *QUICK, "--ground", "-o", name, "--json")
    assert (done.code, done.err) == (0, "")
    said, found = done.json, rows(name)
    assert said["command"] == "scan" and said["output"] == name and said["stations"] == 2
    assert said["points"] == len(found["part"]) > 1000 and said["rays"] > said["points"]
    part = np.asarray(found["part"])
    counts = [said[f"n_{key}"] for key in ("wood", "leaf", "ground", "other")]
    assert counts == [(part == k).sum() for k in (1, 2, 3, 4)] and min(counts[:3]) > 50 and counts[3] == 0
    node, number = np.asarray(found["node_id"]), np.asarray(found["tree_id"])
    assert (node[part == 3] == -1).all() and (number[part == 3] == -1).all()
    assert set(node[part == 1]) == set(range(1, 8)) and set(number[part < 3]) == {1}
    assert set(np.asarray(found["return_number"])) == {1}
    cloud = recon.read_cloud(name)
    assert len(cloud) == said["points"]
    scan_z = np.asarray(found["z"])
    npt.assert_allclose(cloud.xyz[:, 2] + cloud.origin[2], scan_z, atol=1e-9)


def test_las_is_as_the_standard_wants_it(run, tree):
    run(
        "sapwood",
        "scan",
        tree,
        *QUICK,
        "--returns",
        "4",
        "--separation",
        "5cm",
        "--divergence",
        "5mrad",
        "-o",
        "s.laz",
    )
    las = rows("s.laz")
    assert str(las.header.version) == "1.4" and las.header.point_format.id == 6
    assert las.header.creation_date.year == 2000  # the bytes do not depend on the day
    number, count, time = (np.asarray(las[k]) for k in ("return_number", "number_of_returns", "gps_time"))
    assert count.max() > 1 and (number <= count).all() and number.min() == 1
    several = np.flatnonzero(number > 1)
    npt.assert_array_equal(time[several], time[several - 1])
    npt.assert_array_equal(number[several], number[several - 1] + 1)
    assert set(np.asarray(las.point_source_id)) == {1, 2}
    assert np.asarray(las["spread"]).max() > 0.01


def test_the_truth_does_not_reach_reconstruct_unless_asked_for(run, tree):
    """Neither part nor class is taken for labels; the tree's number is used only where it is asked for."""
    run("sapwood", "scan", tree, *QUICK, "--ground", "-o", "s.laz")
    run("sapwood", "scan", tree, *QUICK, "--ground", "-o", "s.ply")
    assert set(np.asarray(rows("s.laz").classification)) == {1}
    for name in ("s.laz", "s.ply"):
        cloud = recon.read_cloud(name)
        assert cloud.is_wood is None and cloud.intensity is None and cloud.color is None
        assert cloud.tree_id is not None
        assert len(cloud.notes) == 1 and "tree_id was read" in cloud.notes[0]
    blind = recon.read_cloud("s.ply")
    one = prepare(blind, PrepareSettings())
    two = prepare(blind.replace(tree_id=None), PrepareSettings())
    npt.assert_array_equal(one.cloud.xyz, two.cloud.xyz)
    chosen = prepare(blind, PrepareSettings(tree_id=1, keep_ground=True))
    assert len(chosen.cloud) <= (blind.tree_id == 1).sum()


def test_labels_are_written_when_asked_for(run, tree):
    for name in ("s.laz", "s.ply"):
        run("sapwood", "scan", tree, *QUICK, "--labels", "-o", name)
        cloud = recon.read_cloud(name)
        npt.assert_array_equal(cloud.is_wood, np.asarray(rows(name)["part"]) == 1)
        assert 0.05 < cloud.is_wood.mean() < 0.95


def test_same_seed_same_bytes(run, tree, tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        for suffix, more in (("laz", ("--wind", "2cm")), ("ply", ("--ground",))):
            options = ("--seed", seed, *more, "-o", f"{name}.{suffix}")
            assert run("sapwood", "scan", tree, *QUICK, *options).code == 0
    for suffix in ("laz", "ply"):
        a, b, c = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in "abc")
        assert a == b != c


@pytest.mark.parametrize("source", ["tree.swc", "tree.glb"])
def test_other_sources(run, tree, source):
    done = run("sapwood", "scan", tree.with_name(source), *QUICK, "-o", "s.ply", "--json")
    assert done.code == 0 and done.json["n_wood"] > 100
    assert ("closed hulls" in done.err) == (source == "tree.glb") == bool(done.json["notes"])


def test_leaf_off_has_no_leaf_points(run, tree):
    for source in (tree, tree.with_name("tree.glb")):
        done = run("sapwood", "scan", source, *QUICK, "--leaf-off", "--force", "-o", "s.ply", "--json")
        assert done.json["n_leaf"] == 0 < done.json["n_wood"]


def test_a_box_in_front_of_the_tree_hides_it(run, tree):
    at = ("--station", "6,0,1.6", "--step", "0.5deg", "--noise", "0", "-o", "s.ply", "--force", "--json")
    free = run("sapwood", "scan", tree, *at).json
    done = run("sapwood", "scan", tree, *at, "--obstacle", "box:4,-3,-1,0.5,6,9").json
    assert free["n_wood"] > 50 and (done["n_wood"], done["n_leaf"]) == (0, 0) and done["n_other"] > 100
    assert done["rays"] == free["rays"] and done["stations"] == 1
    npt.assert_allclose(rows("s.ply")["x"], 4.5, atol=0.01)
    half = run("sapwood", "scan", tree, *at, "--obstacle", "box:4,-3,-1,0.5,6,2.8").json  # up to z = 1.8
    assert 0 < half["n_wood"] < free["n_wood"]
    assert rows("s.ply")["z"][rows("s.ply")["part"] == 1].min() > 1.7


def test_stations_inside_a_wall_are_left_out(run, tree):
    done = run("sapwood", "scan", tree, *QUICK, "--obstacle", "wall:x=1.5", "-o", "s.ply", "--json")
    assert done.json["stations"] == 1
    assert done.err == "note: 1 of 2 stations would stand inside an obstacle; left out\n"
    assert rows("s.ply")["x"][rows("s.ply")["part"] == 1].max() < 1.53


def test_mobile_and_airborne(run, tree):
    done = run(
        "sapwood",
        "scan",
        tree,
        "--mobile",
        "--step",
        "1deg",
        "--line-spacing",
        "10cm",
        "--ground",
        "-o",
        "m.ply",
        "--json",
    )
    assert done.code == 0 and min(done.json[k] for k in ("n_wood", "n_leaf", "n_ground")) > 20
    assert rows("m.ply")["y"].min() < -5.0  # below the track too
    done = run("sapwood", "scan", tree, "--airborne", "--density", "60", "--ground", "-o", "a.ply", "--json")
    assert done.code == 0 and done.json["stations"] == 2
    assert min(done.json[k] for k in ("n_leaf", "n_ground")) > 100
    found = rows("a.ply")
    ground = found[(found["part"] == 3) & (np.abs(found["x"]) < 2) & (found["y"] < -2) & (found["y"] > -4)]
    first = ground[ground["return_number"] == 1]
    assert 2 * 60 * 8 * 0.7 < len(first) < 2 * 60 * 8 * 1.1  # two strips, seen aslant
    assert found["number_of_returns"].max() > 1


def test_a_track_is_followed(run, tree):
    corners = ("--track", "-2,-4,2", "--track", "2,-4,2", "--track", "4,0,2")
    done = run(
        "sapwood",
        "scan",
        tree,
        "--mobile",
        *corners,
        "--step",
        "1",
        "--line-spacing",
        "0.5",
        "-o",
        "t.ply",
        "--json",
    )
    assert done.code == 0 and done.json["rays"] == 360 * (int((4 + np.sqrt(20)) / 0.5) + 1)


@pytest.mark.parametrize(
    "options, said",
    [
        (("-o", "s.txt"), "s.txt: the name must end in one of .laz .las .ply."),
        (("--step", "0", "-o", "s.laz"), "step must be an angle between"),
        (("--step", "2mm", "-o", "s.laz"), "--step must be a number with its unit, as in 0.04deg or 0.3mrad"),
        (("--noise", "2deg", "-o", "s.laz"), "--noise must be a number with its unit, as in 2mm"),
        (("--noise=-2mm", "-o", "s.laz"), "noise must be a finite number of metres >= 0"),
        (("--stations", "0", "-o", "s.laz"), "Invalid value for '--stations'"),
        (("--station", "1,2", "-o", "s.laz"), "is not three numbers X,Y,Z"),
        (
            ("--station", "5,0,1", "--obstacle", "box:4,-1,0,2,2,2", "-o", "s.laz"),
            "inside an obstacle at 5,0,1",
        ),
        (
            ("--obstacle", "box:-9,-9,-1,18,18,5", "-o", "s.laz"),
            "every station would stand inside an obstacle",
        ),
        (("--obstacle", "tower", "-o", "s.laz"), "an obstacle must be wall:x=1.5"),
        (("--mobile", "--airborne", "-o", "s.laz"), "--mobile and --airborne are two scanners"),
        (("--track", "1,2,3", "-o", "s.laz"), "--track is the way of a --mobile scanner"),
        (("--mobile", "--station", "1,2,3", "-o", "s.laz"), "--station is for a scanner on a tripod"),
        (("--airborne", "--altitude", "2m", "-o", "s.laz"), "altitude must be above the target"),
        (("--max-range", "1m", "-o", "s.laz"), "s.laz: nothing was hit, so there is no point to write."),
        (
            ("--min-range", "200m", "-o", "s.laz"),
            "max_range must be a positive number of metres above min_range",
        ),
        (("--leaf-length", "0", "-o", "s.laz"), "leaf length must be a positive number"),
        (("--scale", "0", "--obstacle", "wall:z=1", "-o", "s.laz"), "must say where the wall stands"),
    ],
)
def test_what_is_refused(run, tree, tmp_path, options, said):
    done = run("sapwood", "scan", tree, "--distance", "6", "--step", "2deg", *options)
    assert done.code == 2
    assert said in done.error
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_there_stay(run, tree, tmp_path):
    (tmp_path / "s.laz").write_text("mine")
    done = run("sapwood", "scan", tree, *QUICK, "-o", "s.laz")
    assert done.code == 2 and "overwrite it with --force" in done.error
    assert (tmp_path / "s.laz").read_text() == "mine"
    bad = tmp_path / "bad.glb"
    bad.write_bytes(b"glTF" + bytes(40))
    done = run("sapwood", "scan", bad, "-o", "t.laz", "--json")
    assert done.code == 2 and done.json["error"]["exit_code"] == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.glb", "s.laz"]
