"""The commands as people use them: exit code, stdout and stderr."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from sapwood_scans import ROOT, spawn, tree_points, write_xyz

import sapwood
from sapwood.cli.main import COMMANDS, main
from sapwood.saving import output_names

FILES = output_names("bare", preview=False)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


# ---------------------------------------------------------------- reconstruct


def test_one_scan(run, scans, tmp_path):
    done = run("reconstruct", scans / "bare.xyz", "-o", "out", "--no-preview")
    assert done.code == 0
    assert done.err == ""
    assert re.fullmatch(
        r"bare: \d\.\d m high, DBH \d+\.\d cm, crown \d\.\d m wide, \d+ L of wood, \d+ nodes, 0 clusters "
        r"-> out/bare\.lobes \(\d\.\d kB\)\n",
        done.out,
    )
    assert names(tmp_path / "out") == sorted(FILES)


def test_sapwood_reconstruct_is_the_same(run, scans, tmp_path):
    for program in (["reconstruct"], ["sapwood", "reconstruct"]):
        done = run(*program, scans / "bare.xyz", "-o", program[0], "--no-preview", "--quiet")
        assert (done.code, done.out, done.err) == (0, "", "")
    for name in FILES[:-1]:
        assert (tmp_path / "reconstruct" / name).read_bytes() == (tmp_path / "sapwood" / name).read_bytes()


def test_json_is_all_there_is_on_stdout(run, scans, tmp_path):
    done = run("reconstruct", scans / "bare.xyz", "-o", "out", "--no-preview", "--json", "--seed", "5")
    said = done.json
    assert done.code == 0
    assert list(said) == ["schema_version", "command", "version", "output", "trees", "failed", "seconds"]
    assert (said["schema_version"], said["command"], said["failed"]) == (1, "reconstruct", [])
    assert said["trees"] == [json.loads((tmp_path / "out" / "bare.json").read_text())]
    assert said["trees"][0]["seed"] == 5


def test_picture_and_turntable(run, scans, tmp_path):
    done = run("reconstruct", scans / "bare.xyz", "-o", "out", "--turntable", "--quiet")
    assert (done.code, done.err) == (0, "")
    assert (tmp_path / "out" / "bare.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "out" / "bare.gif").read_bytes()[:4] == b"GIF8"


def test_options_are_in_the_report(run, scans):
    done = run(
        "reconstruct", scans / "bare.xyz", "-o", "out", "--no-preview", "--json", "--f-s", "1",
        "--species", "pine", "--beta", "1.4", "--gamma", "1.3", "--max-nodes", "64", "--units", "m",
        "--up", "z", "--base", "0,0,0", "--largest", "--keep-ground", "--max-points", "5000",
    )  # fmt: skip
    assert done.code == 0, done.err
    settings = done.json["trees"][0]["settings"]
    assert (settings["species"], settings["f_s"], settings["beta"], settings["gamma"]) == (
        "Pine",
        1,
        1.4,
        1.3,
    )
    assert settings["max_nodes"] == 64
    assert settings["read"]["max_points"] == 5000
    scan = {"units": "m", "up": "z", "base": [0, 0, 0], "largest": True, "keep_ground": True}
    assert {key: settings["prepare"][key] for key in scan} == scan
    assert done.json["trees"][0]["n_nodes"] <= 64


def test_remarks_go_to_stderr_and_into_the_report(run, tmp_path):
    points = tree_points(leaves=False)
    points[7] = np.nan
    write_xyz(tmp_path / "holes.xyz", points)
    done = run("reconstruct", "holes.xyz", "-o", "out", "--no-preview", "--json")
    assert done.code == 0
    notes = done.json["trees"][0]["notes"]
    assert any("1 of" in note and "left out" in note for note in notes)
    assert done.err.splitlines() == [f"note: holes: {note}" for note in notes]
    again = run("reconstruct", "holes.xyz", "-o", "out", "--no-preview", "--quiet", "--force")
    assert (again.code, again.err, again.out) == (0, "", "")


def test_outputs_are_not_replaced_without_force(run, scans, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "bare.glb").write_text("mine")
    arguments = ["reconstruct", scans / "bare.xyz", scans / "leafy.xyz", "-o", "out", "--no-preview"]
    done = run(*arguments)
    assert done.code == 2
    assert done.error == (
        "out/bare.glb: the file exists already; overwrite it with --force, or name another place."
    )
    assert names(tmp_path / "out") == ["bare.glb"]  # nor was anything else done


# ---------------------------------------------------------------- several scans


@pytest.fixture(scope="module")
def batch(scans, tmp_path_factory):
    """Three good scans, two of one name, and a bad one, with one worker and with two."""
    folder = tmp_path_factory.mktemp("batch")
    (folder / "in" / "other").mkdir(parents=True)
    for source, target in (("bare", "bare"), ("leafy", "leafy"), ("leafy", "other/bare")):
        (folder / "in" / f"{target}.xyz").write_bytes((scans / f"{source}.xyz").read_bytes())
    (folder / "in" / "broken.laz").write_bytes(b"LASF and then nothing")
    (folder / "in" / "readme.txt").write_text("three good scans and a bad one\n")
    done = {}
    for jobs in (1, 2):
        out = f"out{jobs}"
        process = spawn(
            "reconstruct", "in", "in/*/*.xyz", "-o", out, "--no-preview", "--species", "none", "--jobs", jobs,
            cwd=folder,
        )  # fmt: skip
        done[jobs] = (*process.communicate(timeout=300), process.returncode)
    return folder, done


def test_one_bad_scan_does_not_stop_the_others(batch):
    folder, done = batch
    for jobs in (1, 2):
        out, err, code = done[jobs]
        assert code == 3, err
        assert [line.split(":")[0] for line in out.splitlines()] == ["in-bare", "leafy", "other-bare"]
        lines = err.splitlines()
        assert lines[0] == "note: in/readme.txt: left out, there are no points in it"
        assert sorted(re.sub(r"\[\d/4\] |\d+\.\d", "", line) for line in lines[1:5]) == [
            "broken: failed", "in-bare: done in  s", "leafy: done in  s", "other-bare: done in  s",
        ]  # fmt: skip
        assert [line[:6] for line in lines[1:5]] == ["[1/4] ", "[2/4] ", "[3/4] ", "[4/4] "]
        assert lines[5] == "error: 1 of 4 scans failed:"
        assert lines[6].startswith("error: in/broken.laz: the LAS header ")
        assert len(lines) == 7


def test_files_do_not_depend_on_the_number_of_workers(batch):
    folder, _ = batch
    assert names(folder / "out1") == names(folder / "out2")
    assert len(names(folder / "out1")) == 3 * 4
    for name in names(folder / "out1"):
        one, two = ((folder / f"out{jobs}" / name).read_bytes() for jobs in (1, 2))
        if name.endswith(".json"):
            one, two = ({k: v for k, v in json.loads(text).items() if k != "seconds"} for text in (one, two))
        assert one == two, name


def test_all_failed_by_input(run, tmp_path):
    for name in ("a.xyz", "b.xyz"):
        (tmp_path / name).write_text("")
    done = run("reconstruct", "a.xyz", "b.xyz", "-o", "out", "--json", "--quiet")
    assert done.code == 2
    assert [failure["kind"] for failure in done.json["failed"]] == ["input", "input"]
    assert [re.sub(r"(empty\.).*", r"\1", line) for line in done.err.splitlines()] == [
        "error: 2 of 2 scans failed:",
        "error: a.xyz: the file is empty.",
        "error: b.xyz: the file is empty.",
    ]
    assert not (tmp_path / "out").exists()


def test_what_means_no_scan_does_not_stop_the_others(run, scans, tmp_path):
    (tmp_path / "empty").mkdir()
    arguments = ["empty", scans / "bare.xyz", "*.e57"]
    done = run("reconstruct", *arguments, "-o", "out", "--no-preview", "--json")
    assert done.code == 3
    assert done.err.splitlines() == [
        "error: 2 of 3 scans failed:",
        "error: empty: no scan in this folder; looked for .las .laz .ply .pcd .e57 .xyz .txt .csv .asc .pts "
        ".npy, not in sub-folders.",
        "error: *.e57: no file matches this pattern.",
    ]
    assert [tree["name"] for tree in done.json["trees"]] == ["bare"]
    assert [(f["scan"], f["kind"]) for f in done.json["failed"]] == [("empty", "input"), ("*.e57", "input")]
    alone = run("reconstruct", "empty", "-o", "new/deep")
    assert (alone.code, alone.out) == (2, "")
    assert alone.error.startswith("empty: no scan in this folder")
    assert names(tmp_path) == ["empty", "out"]


def test_a_failure_leaves_no_folder_behind(run, tmp_path):
    (tmp_path / "a.xyz").write_text("")
    assert run("reconstruct", "a.xyz", "-o", "new/and/deep").code == 2
    assert names(tmp_path) == ["a.xyz"]


def test_resume_leaves_out_what_is_done(run, scans, tmp_path):
    arguments = ["reconstruct", scans / "bare.xyz", scans / "leafy.xyz", "-o", "out", "--no-preview"]
    run("reconstruct", scans / "bare.xyz", "-o", "out", "--no-preview")
    before = (tmp_path / "out" / "bare.json").read_bytes()
    done = run(*arguments, "--resume", "--json", "--force")
    assert done.code == 0
    assert "note: 1 of 2 scans are done already and left out" in done.err.splitlines()
    assert [tree["name"] for tree in done.json["trees"]] == ["leafy"]
    assert (tmp_path / "out" / "bare.json").read_bytes() == before
    again = run(*arguments, "--resume", "--quiet")
    assert (again.code, again.out, again.err) == (0, "", "")
    (tmp_path / "out" / "leafy.json").unlink()  # not complete, and yet not to be replaced unasked
    assert run(*arguments, "--resume").code == 2


def test_strange_names(run, scans, tmp_path):
    """Each is said in one line, and the report and the JSON can be read and give the very name."""
    strange = [os.fsdecode(b"by\xfftes"), "new\nline", "[red]樹", "-o", "x" * 250]
    (tmp_path / "in").mkdir()
    for name in strange:
        (tmp_path / "in" / f"{name}.xyz").write_bytes((scans / "bare.xyz").read_bytes())
    done = run("reconstruct", "in", "-o", "out", "--no-preview")
    assert done.code == 0, done.err
    assert len(done.out.splitlines()) == len(strange)
    assert r"by\udcfftes: " in done.out
    assert r"new\nline: " in done.out
    found = {json.loads(path.read_text("utf-8"))["name"] for path in (tmp_path / "out").glob("*.json")}
    assert found == {*strange[:-1], "x" * 220}
    failed = run(
        "reconstruct",
        f"in/{strange[0]}.xyz",
        "in/[red]樹.xyz",
        "no\n樹.xyz",
        "-o",
        "o2",
        "--no-preview",
        "--json",
    )
    assert failed.code == 3
    assert "error: no 樹.xyz: there is no such file." in failed.err
    assert failed.json["trees"][0]["source"] == f"in/{strange[0]}.xyz"


# ---------------------------------------------------------------- decode


@pytest.mark.parametrize(
    "suffix, begins",
    [("glb", b"glTF"), ("obj", b"#"), ("ply", b"ply\n"), ("swc", b"#"), ("csv", b"id,parent,x0")],
)
def test_decode(run, lobes, tmp_path, suffix, begins):
    done = run("sapwood", "decode", lobes, "-o", f"new/x.{suffix}")
    assert (done.code, done.err) == (0, "")
    assert re.fullmatch(rf"new/x\.{suffix} \(\d+\.\d kB\)\n", done.out)
    assert (tmp_path / "new" / f"x.{suffix}").read_bytes().startswith(begins)
    again = run("sapwood", "decode", lobes, "-o", f"new/x.{suffix}")
    assert again.code == 2
    assert "exists already" in again.error
    assert run("sapwood", "decode", lobes, "-o", f"new/x.{suffix}", "--force", "--quiet").out == ""


def test_decoded_tables_stand_where_the_scan_stood(run, scans, tmp_path):
    import treegraph

    run("reconstruct", scans / "mapped.las", "-o", ".", "--no-preview")
    run("sapwood", "decode", "mapped.lobes", "-o", "world.csv")
    run("sapwood", "decode", "mapped.lobes", "-o", "local.swc", "--local")
    done = run("sapwood", "decode", "mapped.lobes", "-o", "world.swc", "--json")
    assert done.json["output"] == "world.swc"
    assert done.json["bytes"] == (tmp_path / "world.swc").stat().st_size
    written = np.genfromtxt("mapped.cylinders.csv", delimiter=",", names=True)
    decoded = np.genfromtxt("world.csv", delimiter=",", names=True)
    np.testing.assert_allclose(decoded["x1"], written["x1"], atol=2e-3)
    world, local = treegraph.read_swc("world.swc").position, treegraph.read_swc("local.swc").position
    np.testing.assert_allclose((world - local)[0], [455012.25, 5428007.5, 231.75], atol=0.1)


def test_detail(run, lobes, tmp_path):
    sizes = {}
    for detail in ("coarse", "normal", "fine"):
        run("sapwood", "decode", lobes, "-o", f"{detail}.glb", "--detail", detail)
        sizes[detail] = (tmp_path / f"{detail}.glb").stat().st_size
    assert sizes["coarse"] < sizes["normal"] < sizes["fine"]


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["missing.lobes", "-o", "a.glb"], r"missing\.lobes: there is no such file\."),
        (["LOBES", "-o", "a.stl"], r"a\.stl: the name must end in one of \.glb \.obj \.ply \.swc \.csv\."),
        (["junk.lobes", "-o", "a.glb"], r"junk\.lobes: .+"),
        (["cut.lobes", "-o", "a.glb"], r"cut\.lobes: .+"),
        (["LOBES"], r"Missing option '--output' / '-o'\.? \(`sapwood decode --help` lists the options\)"),
        (["LOBES", "-o", "a.glb", "--detail", "superb"], r"Invalid value for '--detail'.+superb.+"),
        (
            ["LOBES", "-o", "junk.lobes/a.glb"],
            r"junk\.lobes: this is a file, not a folder; name another one\.",
        ),
    ],
)
def test_decode_says_what_is_wrong(run, lobes, tmp_path, arguments, said):
    (tmp_path / "junk.lobes").write_text("no tree")
    (tmp_path / "cut.lobes").write_bytes(lobes.read_bytes()[:-9])
    done = run("sapwood", "decode", *[lobes if a == "LOBES" else a for a in arguments])
    assert (done.code, done.out) == (2, "")
    assert re.fullmatch(said, done.error)


# ---------------------------------------------------------------- preview


def test_preview_of_a_tree(run, lobes, tmp_path):
    from PIL import Image

    done = run("sapwood", "preview", lobes, "-o", "x.png", "--size", "160x120", "--azimuth", "30", "--json")
    assert (done.code, done.err) == (0, "")
    said = done.json
    assert (said["command"], said["output"], said["width"], said["height"]) == ("preview", "x.png", 160, 120)
    with Image.open(tmp_path / "x.png") as picture:
        assert picture.size == (160, 120)


def test_preview_with_the_scan_beside(run, lobes, scans, tmp_path):
    small = ["--size", "300x150", "--renderer", "software"]
    run("sapwood", "preview", lobes, "-o", "a.png", "--scan", scans / "bare.xyz", *small)
    done = run("sapwood", "preview", scans / "bare.xyz", "-o", "b.png", *small)
    assert (done.code, done.out, done.err) == (0, "b.png\n", "")
    assert (tmp_path / "a.png").exists()


def test_preview_puts_the_scan_where_the_tree_is(run, scans, monkeypatch):
    """Both in the tree's frame, and the camera's angle in radians."""
    import render

    seen = {}
    draw = render.preview

    def spy(tree, path, **look):
        seen.update(look)
        return draw(tree, path, **look)

    run("reconstruct", scans / "mapped.las", "-o", ".", "--no-preview")
    monkeypatch.setattr(render, "preview", spy, raising=False)
    small = ["--size", "60x40", "--renderer", "software", "--azimuth", "30"]
    done = run("sapwood", "preview", "mapped.lobes", "-o", "a.png", "--scan", scans / "mapped.las", *small)
    assert done.code == 0, done.err
    assert seen["azimuth"] == pytest.approx(np.pi / 6)
    xyz, _ = seen["scan"]
    np.testing.assert_allclose(xyz.min(axis=0)[2], 0, atol=0.1)
    np.testing.assert_allclose(np.median(xyz, axis=0)[:2], 0, atol=0.3)


def test_preview_turntable(run, lobes, tmp_path):
    arguments = ["--turntable", "--frames", "3", "--size", "60x80", "--renderer", "software"]
    done = run("sapwood", "preview", lobes, "-o", "x.gif", *arguments)
    assert (done.code, done.out) == (0, "x.gif\n")
    assert (tmp_path / "x.gif").read_bytes()[:4] == b"GIF8"


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["-o", "x.gif"], "x.gif: the name of a picture must end in .png or .jpg or .jpeg."),
        (["-o", "x.png", "--turntable"], "x.png: the name of a turntable must end in .gif."),
        (["-o", "x.png", "--size", "big"], "'big' is not a width and a height in pixels, as in 1600x1000"),
        (
            ["-o", "x.png", "--size", "1x1"],
            "size must be a width and a height of 16 to 8192 pixels, got",
        ),
    ],
)
def test_preview_says_what_is_wrong(run, lobes, tmp_path, arguments, said):
    done = run("sapwood", "preview", lobes, *arguments)
    assert done.code == 2
    assert said in done.error
    assert names(tmp_path) == []


def test_preview_of_a_scan_needs_no_scan(run, scans):
    done = run("sapwood", "preview", scans / "bare.xyz", "-o", "x.png", "--scan", scans / "bare.xyz")
    assert done.code == 2
    assert done.error.endswith("--scan goes with a .lobes file; a scan is drawn beside its tree anyway.")


# ---------------------------------------------------------------- info, doctor


def test_info_of_a_tree(run, lobes, bare):
    done = run("sapwood", "info", lobes)
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert lines[0] == str(lobes)
    assert lines[1] == "  kind            tree"
    assert f"  n_nodes         {bare.tree.graph.n_nodes}" in lines
    said = run("sapwood", "info", lobes, "--json").json
    assert said["wood_volume_m3"] == pytest.approx(bare.measures["wood_volume_m3"], rel=0.02)
    assert said["bytes"] == lobes.stat().st_size


def test_info_of_a_scan(run, scans):
    said = run("sapwood", "info", scans / "mapped.las", "--json").json
    points = tree_points(leaves=False, foot=(455012.25, 5428007.5, 231.75))
    assert said["kind"] == "scan"
    assert said["n_points"] == len(points)
    np.testing.assert_allclose(said["low"], points.min(axis=0), atol=2e-3)
    np.testing.assert_allclose(said["high"], points.max(axis=0), atol=2e-3)


def test_info_of_a_scan_with_holes(run, tmp_path):
    points = tree_points(leaves=False)
    points[7:10] = np.nan
    said = run("sapwood", "info", write_xyz(tmp_path / "holes.xyz", points), "--json").json
    assert (said["n_points"], said["n_points_used"]) == (len(points), len(points) - 3)
    assert said["notes"]


def test_info_of_nothing(run):
    done = run("sapwood", "info", "missing.laz", "--json")
    assert done.code == 2
    assert done.error.startswith("missing.laz: there is no such file.")
    assert done.json["error"] == {"message": done.error, "exit_code": 2}
    assert done.json["command"] == "info"


def test_doctor(run):
    done = run("sapwood", "doctor")
    assert done.code == 0, done.out
    found = {line.split()[1] for line in done.out.splitlines() if line.split()[0] in ("ok", "missing")}
    assert {"sapwood", "python", "numpy", "numba", "kernel", "disk", "OpenGL"} <= found


def test_doctor_names_what_is_broken_and_the_fix(run, monkeypatch):
    from sapwood.cli import doctor

    monkeypatch.setattr(doctor, "REQUIRED", ("numpy", "no-such-package"))
    monkeypatch.setattr(
        doctor, "OPTIONAL", {"no-such-reader": "to read: python -m pip install no-such-reader"}
    )
    done = run("sapwood", "doctor")
    assert done.code == 2
    assert "broken   no-such-package not installed" in done.out
    assert "fix: python -m pip install no-such-package" in done.out
    assert "missing  no-such-reader not installed" in done.out
    assert done.error == "no-such-package: see the fix of each above."
    said = run("sapwood", "doctor", "--json").json
    assert not said["ok"]
    assert {check["state"] for check in said["checks"]} >= {"ok", "broken", "missing"}


def test_doctor_without_a_place_for_kernels(monkeypatch, tmp_path):
    from sapwood import kernels
    from sapwood.cli import doctor

    (tmp_path / "file").write_text("")
    monkeypatch.setenv(kernels.PLACE_VARIABLE, str(tmp_path / "file" / "kernels"))
    check = doctor._check_cache()
    assert check.state == "broken"
    assert check.fix.startswith("export NUMBA_CACHE_DIR=")


def test_a_first_run_says_why_it_takes_its_time(monkeypatch, tmp_path, capsys):
    from sapwood import kernels
    from sapwood.cli.terminal import Terminal

    monkeypatch.setenv(kernels.PLACE_VARIABLE, str(tmp_path))
    Terminal().warn_of_compiling()  # nobody waits
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    terminal = Terminal()
    terminal.warn_of_compiling()
    terminal.warn_of_compiling()
    said = capsys.readouterr().err
    assert said == "note: the first run compiles its kernels, which takes a minute or two; once\n"
    (tmp_path / "recon_1").mkdir()
    (tmp_path / "recon_1" / "a.nbc").write_bytes(b"")
    Terminal().warn_of_compiling()
    monkeypatch.setenv(kernels.PLACE_VARIABLE, str(tmp_path / "recon_1" / "a.nbc" / "no"))
    Terminal().warn_of_compiling()
    assert capsys.readouterr().err == (
        "note: compiled kernels cannot be kept; name a folder for them with NUMBA_CACHE_DIR\n"
    )


# ---------------------------------------------------------------- all commands


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_and_every_common_option(run, command):
    done = run("sapwood", *command.split(), "--help")
    assert (done.code, done.err) == (0, "")
    assert "Example:" in done.out
    for option in ("--json", "--quiet", "--verbose", "--version", "--help"):
        assert option in done.out
    example = re.search(r"Example:\s+(.*)", COMMANDS[command].__doc__).group(1)
    words = example.split()[0 if command == "reconstruct" else 1 :]
    assert f"{' '.join(words)} ".startswith(f"{command} ")


@pytest.mark.parametrize("arguments", [["reconstruct"], ["sapwood"], ["sapwood", "info"]])
def test_version(run, arguments):
    done = run(*arguments, "--version")
    assert (done.code, done.out, done.err) == (0, f"sapwood {sapwood.__version__}\n", "")


def test_the_page_of_commands_is_current():
    script = ROOT / "docs" / "make_commands.py"
    done = subprocess.run([sys.executable, str(script), "--check"], check=False)
    assert done.returncode == 0, "write it anew: python docs/make_commands.py"


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["reconstruct"], "Missing argument 'SCAN'."),
        (["reconstruct", "a.xyz"], "Missing option '--output' / '-o'."),
        (["reconstruct", "a.xyz", "-o", "o", "--f-s", "2"], "Invalid value for '--f-s'"),
        (["reconstruct", "a.xyz", "-o", "o", "--jobs", "0"], "Invalid value for '--jobs'"),
        (["reconstruct", "a.xyz", "-o", "o", "--base", "1,2"], "'1,2' is not three numbers X,Y,Z"),
        (["reconstruct", "a.xyz", "-o", "o", "--units", "inch"], "Invalid value for '--units'"),
        (
            ["reconstruct", "a.xyz", "-o", "o", "--species", "oka"],
            "there is no species 'oka'; did you mean 'Oak'?",
        ),
        (["reconstruct", "a.xyz", "-o", "o", "--colour"], "No such option: --colour"),
        (["sapwood", "reconstrcut"], "No such command 'reconstrcut'."),
        (["sapwood", "info"], "(`sapwood info --help` lists the options)"),
    ],
)
def test_arguments_at_fault(run, tmp_path, arguments, said):
    done = run(*arguments)
    assert done.code == 2
    assert said in done.error
    assert done.out == ""
    assert names(tmp_path) == []


def test_no_command(run):
    done = run("sapwood")
    assert done.code == 2
    assert done.error == "Missing command. (`sapwood --help` lists the options)"
    assert "Example:" in done.out


def test_our_own_fault_is_one_line_and_a_traceback_with_v(run, lobes, monkeypatch):
    from sapwood import trees

    def fail(*_, **__):
        raise RuntimeError("oh\nno")

    monkeypatch.setattr(trees, "read_tree", fail)
    done = run("sapwood", "decode", lobes, "-o", "x.glb")
    assert done.code == 1
    assert done.error.startswith("RuntimeError: oh no (this is a fault of Sapwood; please report it with")
    verbose = run("sapwood", "decode", lobes, "-o", "x.glb", "-v")
    assert verbose.code == 1
    assert "Traceback (most recent call last)" in verbose.err
    assert run("sapwood", "decode", lobes, "-o", "x.glb", "--json").json["error"]["exit_code"] == 1


def test_our_own_fault_with_one_scan(run, scans, monkeypatch):
    import recon

    def fail(*_, **__):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(recon, "Encoder", fail, raising=False)
    done = run("reconstruct", scans / "bare.xyz", "-o", "out")
    assert done.code == 1
    assert done.error.startswith(
        f"{scans / 'bare.xyz'}: ZeroDivisionError: division by zero (this is a fault"
    )
    verbose = run("reconstruct", scans / "bare.xyz", "-o", "out", "-v")
    assert "in fail" in verbose.err


def test_a_bar_is_drawn_only_on_a_terminal(capsys, monkeypatch):
    from sapwood.cli.terminal import Terminal

    terminal = Terminal()
    with terminal.progress(2, "scans") as bar:
        bar.advance()
        terminal.log("working")
    assert capsys.readouterr().err == "working\n"
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with terminal.progress(2, "scans") as bar:
        bar.advance()
        bar.say("more scans")
        terminal.result("a result")
        assert "a result" not in capsys.readouterr().out
    said = capsys.readouterr()
    assert said.out == "a result\n"
    assert "scans" in said.err


# ---------------------------------------------------------------- as a process of its own


def test_help_loads_nothing_heavy():
    """What makes the start quick, without a clock: no library that computes is imported."""
    code = (
        "import sys; from sapwood.cli.main import main; main('reconstruct', ['--help']);"
        "print(sorted({'numpy', 'scipy', 'numba', 'laspy', 'PIL', 'trimesh', 'open3d'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_closed_pipe_is_no_drama():
    process = spawn("reconstruct", "--help", cwd=ROOT)
    process.stdout.close()
    assert process.wait(timeout=60) == 0
    assert process.stderr.read() == ""
    process.stderr.close()


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_the_work_is_done_although_nobody_listens(scans, tmp_path, stream):
    """What is left to be said is said where it can be, and the exit code stays true."""
    arguments = ["reconstruct", scans / "bare.xyz", "missing.laz", "-o", "out", "--no-preview"]
    process = spawn(*arguments, cwd=tmp_path)
    getattr(process, stream).close()
    assert process.wait(timeout=120) == 3
    assert len(names(tmp_path / "out")) == 4
    other = process.stdout if stream == "stderr" else process.stderr
    said = other.read()
    other.close()
    assert ("bare: " if stream == "stderr" else "error: missing.laz: there is no such file.") in said
    assert "Traceback" not in said


@pytest.mark.parametrize("closing", ["<&-", ">&-", "2>&-"])
def test_closed_streams(lobes, scans, tmp_path, closing):
    """A file that is opened must not take the place of a closed stream."""
    command = [sys.executable, "-m", "sapwood", "decode", str(lobes), "-o", "x.swc"]
    shell = ["/bin/sh", "-c", f'exec "$@" {closing}', "sh", *command]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(shell, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("x.swc (") or closing == ">&-"
    assert (tmp_path / "x.swc").read_text().startswith("#")
    assert "x.swc (" not in (tmp_path / "x.swc").read_text()


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_full_disk_behind_stdout(lobes, tmp_path):
    command = [sys.executable, "-m", "sapwood", "info", str(lobes)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "error: standard output: cannot be written (No space left on device).\n"


def test_a_terminal_that_knows_ascii_only(scans, tmp_path):
    (tmp_path / "樹.xyz").write_bytes((scans / "bare.xyz").read_bytes())
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"}
    for more in ([], ["--json"]):
        command = [sys.executable, "-m", "sapwood", "info", "樹.xyz", *more]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (0, b"")
        assert done.stdout.startswith(b"\\u6a39.xyz\n" if not more else b"{")
    assert json.loads(done.stdout)["input"] == "樹.xyz"


def test_main_can_be_called_again_and_again(run, lobes):
    codes = [run("sapwood", "info", lobes).code, run("sapwood", "info", "missing.lobes").code]
    assert codes == [0, 2]
    assert main("sapwood", ["--version"]) == 0
