"""``sapwood.reconstruct``: the tree, its figures, its files."""

import hashlib
import json
import math
import runpy

import numpy as np
import pytest
from sapwood_scans import ROOT, tree_points, write_xyz

import sapwood
import treegraph
from sapwood.measures import crown_base, crown_width, measure
from sapwood.outputs import Staging, check_free, write_whole
from sapwood.saving import output_names, save
from treegraph import Allometry, Cluster, ClusterTree, InputError, TreeGraph


def test_the_tree_that_was_scanned(bare):
    """Trunk of 30 cm at the foot, 8 m high: 27 cm at breast height, six branches of 2 m."""
    m = bare.measures
    assert m["height_m"] == pytest.approx(tree_points(leaves=False)[:, 2].max(), abs=0.05)
    assert m["dbh_m"] == pytest.approx(0.3 * (1 - 0.6 * 1.3 / 8), rel=0.03)
    assert m["dbh_method"] == "circle"
    assert m["total_length_m"] == pytest.approx(7.2 + 6 * 2, rel=0.1)
    assert m["crown_base_m"] == pytest.approx(3.2, abs=0.25)
    assert m["n_clusters"] == 0
    assert m["n_nodes"] == bare.tree.graph.n_nodes


def test_repr_says_what_it_is(bare):
    m = bare.measures
    assert repr(bare) == (
        f"<Reconstruction bare: {m['height_m']:.1f} m high, DBH {100 * m['dbh_m']:.1f} cm, "
        f"{m['n_nodes']} nodes, 0 clusters>"
    )


def test_points_from_memory_are_the_same_tree(scans, bare):
    made = sapwood.reconstruct(np.loadtxt(scans / "bare.xyz"))
    assert made.name == "tree"
    assert made.source == ""
    assert made.tree.graph.position.tobytes() == bare.tree.graph.position.tobytes()
    assert made.sha256 != bare.sha256  # of the points, not of a file


def test_hash_is_that_of_the_file(scans, bare):
    assert bare.sha256 == hashlib.sha256((scans / "bare.xyz").read_bytes()).hexdigest()


def test_cylinders_are_in_the_scans_own_coordinates(scans):
    made = sapwood.reconstruct(scans / "mapped.las")
    foot = made.cylinders[0]
    assert foot["x0"] == pytest.approx(455012.25, abs=0.05)
    assert foot["y0"] == pytest.approx(5428007.5, abs=0.05)
    assert foot["z0"] == pytest.approx(231.75, abs=0.1)
    assert np.abs(made.tree.graph.position).max() < 10


def test_options_reach_the_encoder(scans):
    made = sapwood.reconstruct(scans / "leafy.xyz", species="willow", f_s=1.0, gamma=1.2, units="m")
    assert made.tree.clusters == ()
    assert made.tree.species == "Willow"  # as the table spells it
    assert made.settings["gamma"] == made.tree.allometry.gamma == 1.2
    assert made.settings["f_s"] == 1.0
    assert made.settings["beta"] == treegraph.SPECIES_ALLOMETRY["Willow"].beta
    assert made.settings["prepare"]["units"] == "m"


@pytest.mark.parametrize(
    "options, match",
    [
        ({"species": "oka"}, "there is no species 'oka'; did you mean 'Oak'"),
        ({"f_s": 1.5}, "f_s must be"),
        ({"max_nodse": 5}, "there is no option 'max_nodse'; the options are base, beta"),
        ({"name": "../oak"}, "name must be a file name without suffix and folder, got '../oak'"),
    ],
)
def test_bad_options_are_said_before_the_scan_is_read(options, match):
    with pytest.raises(InputError, match=match):
        sapwood.reconstruct("missing.xyz", **options)


def test_reading_options_are_for_files():
    with pytest.raises(InputError, match="max_points: only a file is read; leave it out for points"):
        sapwood.reconstruct(tree_points(), max_points=1000)


def test_messages_begin_with_the_file(tmp_path):
    path = write_xyz(tmp_path / "few.xyz", tree_points()[:5])
    with pytest.raises(InputError, match=f"^{path}: "):
        sapwood.reconstruct(path)


def test_stages_are_announced_and_timed(scans):
    said = []
    made = sapwood.reconstruct(scans / "bare.xyz", progress=said.append)
    assert said == ["read", "encode", "classify", "measure"]
    said.clear()
    sapwood.reconstruct(scans / "bare.xyz", species=None, progress=said.append)
    assert said == ["read", "encode", "measure"]
    assert {"read", "prepare", "skeleton", "radii", "measure"} <= set(made.seconds)
    assert all(seconds >= 0 for seconds in made.seconds.values())


# ---------------------------------------------------------------- what is written


def test_save_writes_five_files_and_no_more(bare, tmp_path):
    files = bare.save(tmp_path / "new" / "folder", preview=False)
    names = ["bare.lobes", "bare.glb", "bare.cylinders.csv", "bare.json"]
    assert [path.name for path in files] == names
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == sorted(names)


def test_lobes_and_table_hold_the_tree(bare, tmp_path):
    bare.save(tmp_path, preview=False)
    back = sapwood.read_lobes(tmp_path / "bare.lobes")
    assert back.graph.n_nodes == bare.tree.graph.n_nodes
    rows = np.genfromtxt(tmp_path / "bare.cylinders.csv", delimiter=",", names=True)
    assert rows["id"].tolist() == bare.cylinders["id"].tolist()
    np.testing.assert_allclose(rows["x1"], bare.cylinders["x1"], atol=1e-4)


def test_files_agree_with_each_other(scans, tmp_path):
    """What a forester adds up from the table is what the report says, and the report is of these files."""
    sapwood.reconstruct(scans / "leafy.xyz", base=(0.012, 0.034, 0.05)).save(tmp_path, preview=False)
    report = json.loads((tmp_path / "leafy.json").read_text())
    rows = np.genfromtxt(tmp_path / "leafy.cylinders.csv", delimiter=",", names=True)
    start, end = (np.stack([rows[f"{axis}{k}"] for axis in "xyz"], axis=1) for k in (0, 1))
    length, r0, r1 = np.linalg.norm(end - start, axis=1), rows["r0"], rows["r1"]
    volume = (np.pi * length * (r0**2 + r0 * r1 + r1**2) / 3).sum()
    assert report["wood_volume_m3"] == pytest.approx(volume, rel=1e-3)
    assert report["total_length_m"] == pytest.approx(length.sum(), rel=1e-4)
    assert report["bytes"] == (tmp_path / "leafy.lobes").stat().st_size
    assert report["sha256"] == hashlib.sha256((scans / "leafy.xyz").read_bytes()).hexdigest()
    np.testing.assert_allclose(
        report["origin"], sapwood.read_lobes(tmp_path / "leafy.lobes").origin, atol=1e-3
    )
    assert report["n_clusters"] == len(sapwood.read_lobes(tmp_path / "leafy.lobes").clusters)
    assert (rows["parent"] < rows["id"]).all()
    assert rows["parent"].tolist().count(-1) == 1
    assert set(rows["measured"]) <= {0, 1}
    assert rows["order"][0] == 0


def test_other_units_and_axes_become_metres_with_z_up(scans, tmp_path):
    """In the frame of the scan's own numbers, converted and turned."""
    points = tree_points(leaves=False, foot=(1000.0, 2000.0, 300.0))
    feet = sapwood.reconstruct(write_xyz(tmp_path / "feet.xyz", points / 0.3048), units="ft")
    lying = points[:, [0, 2, 1]] * [1, 1, -1]  # y is up
    turned = sapwood.reconstruct(write_xyz(tmp_path / "lying.xyz", lying), up="y")
    for made, foot in ((feet, (1000, 2000, 300)), (turned, (-1000, -2000, 300))):
        assert made.measures["height_m"] == pytest.approx(np.ptp(points[:, 2]), abs=0.1)
        assert made.measures["dbh_m"] == pytest.approx(0.27, abs=0.01)
        np.testing.assert_allclose(made.tree.origin, foot, atol=0.05)
        np.testing.assert_allclose([made.cylinders[0][f"{axis}0"] for axis in "xyz"], foot, atol=0.1)


def test_every_option_of_reading_is_in_the_settings(scans, bare):
    default = {"max_points": 20_000_000, "as_points": False, "decimal": None}
    assert bare.settings["read"] == default
    assert sapwood.reconstruct(scans / "bare.xyz", decimal=".").settings["read"] == default | {"decimal": "."}
    assert sapwood.reconstruct(np.loadtxt(scans / "bare.xyz")).settings["read"] == {}


def test_glb_stands_where_its_extras_say(scans, tmp_path):
    sapwood.reconstruct(scans / "mapped.las").save(tmp_path, preview=False)
    data = (tmp_path / "mapped.glb").read_bytes()
    length = int.from_bytes(data[12:16], "little")
    scene = json.loads(data[20 : 20 + length])["scenes"][0]
    assert scene["extras"]["origin"][0] == pytest.approx(455012.25, abs=0.05)


def test_report_is_what_docs_say(bare, tmp_path):
    script = runpy.run_path(str(ROOT / "docs" / "make_commands.py"))
    documented = list(script["REPORT"])
    saved = save(bare, tmp_path, preview=False, seed=7)
    report = json.loads((tmp_path / "bare.json").read_text())
    assert report == saved.report
    assert list(report) == documented
    assert report["schema_version"] == 1
    assert report["seed"] == 7
    assert report["bytes"] == (tmp_path / "bare.lobes").stat().st_size
    assert report["files"] == output_names("bare", preview=False)
    assert report["height_m"] == round(bare.measures["height_m"], 4)
    assert report["versions"]["sapwood"] == sapwood.__version__
    kinds = {"str": str, "bytes": int, "n_nodes": int, "n_tips": int, "height_m": float, "notes": list}
    assert all(isinstance(report[key], kind) for key, kind in kinds.items() if key in report)


def test_same_scan_same_bytes(scans, tmp_path):
    for folder in ("one", "two"):
        sapwood.reconstruct(scans / "leafy.xyz").save(tmp_path / folder, preview=False)
    for name in output_names("leafy", preview=False):
        one, two = ((tmp_path / folder / name).read_bytes() for folder in ("one", "two"))
        assert one == two if not name.endswith(".json") else without_seconds(one) == without_seconds(two)


def without_seconds(text):
    return {key: value for key, value in json.loads(text).items() if key != "seconds"}


def test_a_picture_has_the_scan_in_it(bare, tmp_path):
    from PIL import Image

    saved = save(bare, tmp_path)
    assert saved.report["preview"] in ("egl", "osmesa", "software")
    with Image.open(tmp_path / "bare.png") as picture:
        assert picture.width > 0.9 * picture.height / 2
        assert np.asarray(picture).std() > 5


def test_without_pictures_the_rest_is_made(bare, tmp_path, monkeypatch):
    import render

    def fail(*_, **__):
        raise render.NoPreviewError("OpenGL cannot be used here")

    monkeypatch.setattr(render, "preview", fail, raising=False)
    saved = save(bare, tmp_path)
    assert [path.name for path in saved.files] == output_names("bare", preview=False)
    assert saved.report["preview"] is None
    assert saved.notices == (
        "no picture can be drawn on this machine (OpenGL cannot be used here); all other files are made",
    )


def test_nothing_is_replaced_unasked(bare, tmp_path):
    (tmp_path / "bare.glb").write_text("mine")
    with pytest.raises(InputError, match=r"bare\.glb: the file exists already; overwrite it with --force"):
        bare.save(tmp_path, preview=False)
    assert [path.name for path in tmp_path.iterdir()] == ["bare.glb"]
    bare.save(tmp_path, preview=False, force=True)
    assert (tmp_path / "bare.glb").read_bytes()[:4] == b"glTF"


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, RuntimeError])
def test_a_write_that_breaks_off_leaves_what_was_there(bare, tmp_path, monkeypatch, error):
    import render

    bare.save(tmp_path, preview=False)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(*_, **__):
        raise error

    monkeypatch.setattr(render, "write_glb", fail, raising=False)
    with pytest.raises(error):
        bare.save(tmp_path, preview=False, force=True)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    with pytest.raises(error):
        bare.save(tmp_path / "new", preview=False)
    assert not (tmp_path / "new").exists()


# ---------------------------------------------------------------- files whole or not at all


def test_staging_moves_only_what_is_named(tmp_path):
    with Staging(tmp_path / "out") as staging:
        (staging.path / "a").write_text("a")
        (staging.path / "b").write_text("b")
        assert staging.publish(["a"]) == [tmp_path / "out" / "a"]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a"]


@pytest.mark.parametrize(
    "make, match",
    [
        (lambda p: p.write_text(""), "this is a file, not a folder"),
        (lambda p: p.parent.joinpath("up").write_text(""), "a part of this path is a file, not a folder"),
    ],
)
def test_a_folder_that_cannot_be_made(tmp_path, make, match):
    folder = tmp_path / "out"
    make(folder)
    if not folder.exists():
        folder = tmp_path / "up" / "out"
    with pytest.raises(InputError, match=match), Staging(folder):
        pass


def test_a_file_is_not_written_over_a_folder(tmp_path):
    with pytest.raises(InputError, match="this is a folder; name a file to write"):
        check_free([tmp_path], force=True)


def test_what_is_made_beside_moves_along(tmp_path):
    def write(path):
        path.write_text("obj")
        path.with_suffix(".mtl").write_text("mtl")

    write_whole(tmp_path / "a.obj", write)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mtl", "a.obj"]
    (tmp_path / "a.obj").unlink()
    with pytest.raises(InputError, match=r"a\.mtl: the file exists already"):
        write_whole(tmp_path / "a.obj", write)


# ---------------------------------------------------------------- the figures


def cross(height, reach, *, clusters=()):
    """A straight trunk with one branch at `height` that reaches out by `reach`."""
    position = [[0, 0, 0], [0, 0, height], [0, 0, 10], [reach, 0, height]]
    graph = TreeGraph([-1, 0, 1, 1], position, [0.2, 0.2, 0.1, 0.02])
    return ClusterTree(graph, clusters, None, Allometry(1.5, 1.5, 1.0), (0, 0, 0))


def tuft(bottom, n_points):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float) + [0, 0, bottom]
    return Cluster(vertices, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], [0], 1.0, n_points)


@pytest.mark.parametrize("reach, base", [(3.0, 4.0), (0.1, None)])
def test_crown_base_is_the_lowest_branch_of_some_length(reach, base):
    assert crown_base(cross(4.0, reach)) == base


def test_crown_base_is_where_a_hanging_branch_leaves_the_trunk():
    position = [[0, 0, 0], [0, 0, 4], [0, 0, 10], [1, 0, 4], [2, 0, 2], [3, 0, 1]]
    graph = TreeGraph([-1, 0, 1, 1, 3, 4], position, [0.2, 0.2, 0.1, 0.02, 0.02, 0.02])
    tree = ClusterTree(graph, (), None, Allometry(1.5, 1.5, 1.0), (0, 0, 0))
    assert crown_base(tree) == 4.0


@pytest.mark.parametrize("low, base", [(19, 5.0), (21, 0.5)])
def test_two_in_a_hundred_leaf_points_make_a_crown(low, base):
    assert crown_base(cross(4.0, 3.0, clusters=[tuft(5.0, 1000 - low), tuft(0.5, low)])) == base


def test_crown_base_is_where_the_leaves_begin():
    tree = cross(4.0, 3.0, clusters=[tuft(6.0, 500), tuft(5.0, 500), tuft(0.5, 5)])
    assert crown_base(tree) == 5.0  # the five points at the foot are no crown
    assert crown_base(tree.replace(clusters=[tuft(-0.4, 10)])) == 0.0


def test_crown_width_of_a_square_is_its_mean_over_all_directions():
    """Cauchy: perimeter over pi."""
    assert crown_width(np.array([[0, 0, 0], [2, 0, 1], [2, 2, 0], [0, 2, 5]])) == pytest.approx(
        8 / math.pi, rel=1e-3
    )
    assert crown_width(np.empty((0, 3))) is None


def test_measures_of_a_known_tree():
    tree = cross(4.0, 3.0)
    table = sapwood.cylinder_table(tree.graph)
    points = np.array([[0, 0, 0], [-1, 0, 12.0], [3, 0, 4.5]])
    m = measure(tree, table, points, dbh_m=0.4, dbh_method="circle")
    assert (m.height_m, m.dbh_m, m.dbh_method, m.n_nodes, m.n_tips) == (12.0, 0.4, "circle", 4, 2)
    assert m.total_length_m == pytest.approx(10 + 2.8)
    branch = math.pi * 0.02**2 * 2.8  # its own radius from the trunk's surface on
    trunk = math.pi * 0.2**2 * 4 + math.pi * 6 / 3 * (0.2**2 + 0.2 * 0.1 + 0.1**2)
    assert m.wood_volume_m3 == pytest.approx(trunk + branch, rel=0.05)
    assert measure(tree, table, np.empty((0, 3))).height_m == 10.0
    assert m.crown_base_m == 4.0
    grass = np.array([[50, 0, 0.2], [-50, 0, 3.9]])  # below the crown
    wide = measure(tree, table, np.concatenate([points, grass]))
    assert wide.crown_width_m == m.crown_width_m == pytest.approx(2 / math.pi * 4, rel=1e-2)
