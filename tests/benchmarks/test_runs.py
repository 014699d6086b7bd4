"""Every benchmark from its command line to its table, with a reconstruction that knows the answer."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import recon
import treegraph
from benchmarks import __main__ as everything
from benchmarks import data, dbh, sizes, skeleton_truth, speed, wood
from treegraph import DEFAULT_ALLOMETRY, ClusterTree, TreeGraph

RADIUS = 0.15
BASE = np.array([500.0, 900.0, 40.0])


def trunk_tree():
    z = np.linspace(0.0, 3.0, 31)
    position = np.column_stack([0.0 * z, 0.0 * z, z])
    graph = TreeGraph(np.arange(31) - 1, position, np.full(31, RADIUS))
    return ClusterTree(
        graph=graph, clusters=(), species=None, allometry=DEFAULT_ALLOMETRY, origin=BASE, epsg=None
    )


@pytest.fixture
def known(tmp_path, monkeypatch):
    """A data folder of one trunk under a known name, and an encode that returns that trunk."""
    rng = np.random.default_rng(0)
    turn = rng.random(60_000) * 2.0 * np.pi
    points = BASE + np.column_stack(
        [RADIUS * np.cos(turn), RADIUS * np.sin(turn), np.sort(rng.random(60_000)) * 3.0]
    )
    scan = data.Scan("archi/Tree_2", "trunk.xyz", is_wood=True, truth="truth.csv")
    np.savetxt(tmp_path / scan.path, points, fmt="%.4f")
    rows = [f"{i},{i - 1},0,{BASE[0]},{BASE[1]},{BASE[2] + 0.1 * i},{RADIUS}" for i in range(31)]
    (tmp_path / "truth.csv").write_text("id,parent,branch_order,x,y,z,radius\n" + "\n".join(rows) + "\n")
    monkeypatch.setattr(data, "SCANS", (scan,))
    monkeypatch.setattr(data, "WALNUT", ())
    monkeypatch.setattr(data, "MODELS", ())
    facts = SimpleNamespace(
        dbh_m=2.0 * RADIUS, dbh_method="circle", dbh_reason=None, seconds={"prepare": 0.1, "skeleton": 0.2}
    )
    settings = []

    def encode_with_report(points, settings_=None, **arguments):
        settings.append(arguments.get("settings"))
        return SimpleNamespace(tree=trunk_tree(), report=facts)

    monkeypatch.setattr(recon, "EncodeSettings", SimpleNamespace, raising=False)
    monkeypatch.setattr(recon, "encode", lambda points, **_: trunk_tree(), raising=False)
    monkeypatch.setattr(recon, "encode_with_report", encode_with_report, raising=False)
    monkeypatch.setattr(treegraph, "encode_lobes", lambda tree: b"x" * 1234, raising=False)
    monkeypatch.setattr(treegraph, "decode_lobes", lambda blob: trunk_tree(), raising=False)
    return SimpleNamespace(folder=tmp_path, settings=settings)


def run(module, monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["benchmark", *map(str, arguments)])
    module.main()
    return capsys.readouterr().out


def test_wood_reconstructs_judges_and_writes(known, monkeypatch, capsys):
    out, log = known.folder / "out", known.folder / "rows.json"
    text = run(wood, monkeypatch, capsys, "--data", known.folder, "--out", out, "--json", log)
    row = json.loads(log.read_text())["wood"][0]
    assert row["verdict"] == "pass" and "1 of 1 pass" in text
    assert (
        row["median_mm"].endswith("(2.7)")
        and row["dbh_cm"] == row["dbh_model_cm"] == row["dbh_circle_cm"] == 30.0
    )
    assert known.settings[0].f_s == 1.0
    csv = (out / "trunk.cylinders.csv").read_text().splitlines()
    assert csv[0].startswith("id,parent,x0,y0,z0") and len(csv) == 31
    monkeypatch.setattr(recon, "encode_with_report", None)  # from here on only the file is judged
    text = run(wood, monkeypatch, capsys, "--data", known.folder, "--models", out)
    assert "1 of 1 pass" in text


def test_skeleton_truth_of_the_truth(known, monkeypatch, capsys):
    log = known.folder / "rows.json"
    run(skeleton_truth, monkeypatch, capsys, "--data", known.folder, "--json", log)
    row = json.loads(log.read_text())["skeleton_truth"][0]
    assert row["recall_2cm"] == row["precision_2cm"] == row["seen_share"] == 1.0
    assert row["radius_error"] < 1e-4
    with pytest.raises(SystemExit):
        run(skeleton_truth, monkeypatch, capsys, "--data", known.folder, "--model", "some.csv")


def test_dbh_and_sizes(known, monkeypatch, capsys):
    assert "1 of 1 clean rings pass" in run(dbh, monkeypatch, capsys, "--data", known.folder)
    assert "1 of 1 under 40000 bytes" in run(sizes, monkeypatch, capsys, "--data", known.folder)


def test_speed_times_scans_of_50_000_points(known, monkeypatch, capsys):
    monkeypatch.setattr(speed, "measure_start", lambda: {"command": "reconstruct --help", "best_s": 0.1})
    text = run(speed, monkeypatch, capsys, "--data", known.folder, "--ladder", "")
    assert "prepare_s" in text and "archi/Tree_2" in text and "reconstruct --help" in text


def test_all_of_them(known, monkeypatch, capsys):
    long = ", ".join(name for name in everything.BENCHMARKS if name not in {"wood", "skeleton_truth", "dbh"})
    text = run(everything, monkeypatch, capsys, "--data", known.folder, "--skip", long)
    assert [line for line in text.splitlines() if line.startswith("## ")] == [
        "## wood",
        "## skeleton_truth",
        "## dbh",
    ]
