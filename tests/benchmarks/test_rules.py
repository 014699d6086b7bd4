"""What the benchmarks call a pass, and what they read to get there."""

from argparse import ArgumentParser
from types import SimpleNamespace

import numpy as np
import numpy.testing as npt
import pytest

from benchmarks import data, dbh, report, sizes, speed, synthetic, wood
from benchmarks.fidelity_measure import Circle

BOUNDS = wood.Bounds(median_mm=2.0, within_5cm_pct=98.0, back_over_10cm_pct=0.5, unsupported_pct=0.0)
GOOD = {
    "median_mm": 2.0,
    "within_5cm_pct": 98.0,
    "back_over_10cm_pct": 0.5,
    "unsupported_pct": 0.0,
    "segments": 4000.0,
}


@pytest.mark.parametrize(
    "change, verdict, failed",
    [
        ({}, "pass", []),
        ({"median_mm": 2.1}, "near", ["median_mm"]),
        ({"median_mm": 2.5}, "fail", ["median_mm"]),
        ({"within_5cm_pct": 97.9}, "near", ["within_5cm_pct"]),
        ({"within_5cm_pct": 78.0}, "fail", ["within_5cm_pct"]),
        ({"back_over_10cm_pct": 0.6}, "near", ["back_over_10cm_pct"]),
        ({"back_over_10cm_pct": 0.7}, "fail", ["back_over_10cm_pct"]),
        ({"unsupported_pct": 0.2}, "near", ["unsupported_pct"]),
        ({"unsupported_pct": 0.3}, "fail", ["unsupported_pct"]),
        ({"segments": 4001.0}, "near", ["segments"]),
        ({"segments": 4801.0}, "fail", ["segments"]),
        ({"median_mm": 2.1, "segments": 9999.0}, "fail", ["median_mm", "segments"]),
    ],
)
def test_wood_rules(change, verdict, failed):
    assert wood.judge({**GOOD, **change}, BOUNDS) == (verdict, failed)


def test_bounds_come_from_the_right_rivals():
    rival = {
        "scan": "a",
        "median_mm": 5.0,
        "within_5cm_pct": 90.0,
        "back_over_10cm_pct": 3.0,
        "unsupported_pct": 2.0,
    }
    rivals = [
        {**rival, "program": "AdTree"},
        {
            **rival,
            "program": "PyTLidar (TreeQSM)",
            "median_mm": 4.0,
            "back_over_10cm_pct": 1.0,
            "unsupported_pct": 3.0,
        },
        {
            **rival,
            "program": "rayextract",
            "median_mm": 3.0,
            "within_5cm_pct": 95.0,
            "back_over_10cm_pct": 0.0,
        },
        {**rival, "program": "AdTree", "scan": "b", "median_mm": 0.1},
    ]
    assert wood.bounds_for("a", rivals) == wood.Bounds(3.0, 94.0, 1.0, 2.0)
    assert wood.bounds_for("c", rivals) is None
    assert wood.bounds_for("a", rivals[2:]) is None


def test_every_wood_scan_has_rivals():
    rivals = wood.read_rivals()
    names = [scan.name for scan in data.SCANS if scan.is_wood]
    assert len(names) == 9
    for name in names:
        assert wood.bounds_for(name, rivals) is not None, name
    archi = wood.bounds_for("archi/Tree_2", rivals)
    npt.assert_allclose([archi.median_mm, archi.within_5cm_pct], [2.7, 98.0])
    npt.assert_allclose([archi.back_over_10cm_pct, archi.unsupported_pct], [0.1, 0.2])
    assert {row["scan"] for row in rivals} <= {s.name for s in (*data.SCANS, *data.WALNUT)}


def test_figures_are_rounded_as_the_rivals_are():
    figures = {
        "median": 0.00274,
        "within_5cm": 0.98649,
        "back_over_10cm": 0.00051,
        "unsupported": 0.0,
        "segments": 7,
    }
    assert wood.rounded(figures) == {
        "median_mm": 2.7,
        "within_5cm_pct": 98.6,
        "back_over_10cm_pct": 0.1,
        "unsupported_pct": 0.0,
        "segments": 7.0,
    }


@pytest.mark.parametrize(
    "ours, circle, agrees",
    [(0.10, 0.109, True), (0.10, 0.111, False), (1.04, 1.0, True), (1.06, 1.0, False), (None, 1.0, None)],
)
def test_dbh_rule(ours, circle, agrees):
    assert wood.dbh_agrees(ours, circle) is agrees


@pytest.mark.parametrize(
    "ours, reason, circle, verdict",
    [
        (0.31, None, Circle(0, 0, 0.15, 0.004, 0.9), "pass"),
        (0.40, None, Circle(0, 0, 0.15, 0.004, 0.9), "fail"),
        (None, "hidden", Circle(0, 0, 0.15, 0.004, 0.9), "fail"),
        (0.40, None, Circle(0, 0, 0.15, 0.004, 0.4), "no clean ring"),
        (0.40, None, Circle(0, 0, 0.15, 0.050, 0.9), "no clean ring"),
        (None, "the trunk was not seen", None, "null, explained"),
        (None, "", None, "null without a reason"),
    ],
)
def test_dbh_verdicts(ours, reason, circle, verdict):
    assert dbh.judge(ours, reason, circle) == verdict


def test_off_circle_is_signed_per_cent():
    circle = Circle(0, 0, 0.1, 0.001, 1.0)
    assert dbh.off_circle(0.21, circle) == 5.0 and dbh.off_circle(0.19, circle) == -5.0
    assert dbh.off_circle(None, circle) is None and dbh.off_circle(0.2, None) is None


def tree(position, radius, origin=(0.0, 0.0, 0.0)):
    graph = SimpleNamespace(position=np.asarray(position, float), radius=np.asarray(radius, float))
    return SimpleNamespace(graph=graph, origin=np.asarray(origin, float))


def test_coding_error_row_by_row_and_by_nearest():
    before = tree([[0, 0, 0], [0, 0, 1], [0, 0, 2]], [0.1, 0.05, np.nan], origin=(5.0, 0.0, 0.0))
    after = tree([[0, 0, 0], [0, 0.002, 1], [0, 0, 2.004]], [0.1, 0.06, 0.0], origin=(5.0, 0.0, 0.001))
    error = sizes.coding_error(before, after)
    npt.assert_allclose(error["median_error"], np.hypot(0.002, 0.001))
    npt.assert_allclose(error["worst_error"], 0.005)
    npt.assert_allclose(error["radius_error"], 0.005)
    fewer = tree([[0, 0, 0], [0, 0, 2]], [0.1, 0.05], origin=(5.0, 0.0, 0.0))
    npt.assert_allclose(sizes.coding_error(before, fewer)["worst_error"], 1.0)


def test_resampling_draws_and_thickens():
    points = np.random.default_rng(0).random((500, 3))
    fewer = speed.resample(points, 100)
    assert len({tuple(p) for p in fewer.tolist()} & {tuple(p) for p in points.tolist()}) == 100
    more = speed.resample(points, 2000)
    gap = np.sqrt(((more[:, None] - points[None]) ** 2).sum(2).min(axis=1))
    assert len(more) == 2000 and gap.max() < 0.012 and gap.min() > 0.0
    assert speed.resample(points, 2000).tobytes() == more.tobytes()


def test_neighbour_seconds_grow_with_the_points():
    points = np.random.default_rng(0).random((60_000, 3))
    assert 0.0 < speed.neighbour_seconds(points[:2000]) < speed.neighbour_seconds(points)


def test_small_tree_stands_on_the_ground():
    points = speed.small_tree()
    assert points.shape == (speed.WARM_UP_POINTS, 3)
    assert abs(points[:, 2].min()) < 0.02 and 2.8 < points[:, 2].max() <= 3.0


def parse(arguments):
    parser = ArgumentParser()
    data.add_arguments(parser)
    return parser.parse_args(arguments)


def test_only_scans_that_are_there_and_asked_for(tmp_path, monkeypatch):
    monkeypatch.delenv(data.DATA_VARIABLE, raising=False)
    scans = (data.Scan("a/one", "one.xyz"), data.Scan("a/two", "two.xyz"), data.Scan("b/one", "b.xyz"))
    for name in ("one.xyz", "b.xyz"):
        (tmp_path / name).write_text("0 0 0\n")
    folder = ["--data", str(tmp_path)]
    assert [s.name for s in data.chosen(parse(folder), scans)] == ["a/one", "b/one"]
    assert [s.name for s in data.chosen(parse([*folder, "--only", "b/, two"]), scans)] == ["b/one"]
    with pytest.raises(SystemExit, match="no data folder: give --data DIR or set SAPWOOD_DATA"):
        data.chosen(parse([]), scans)


def test_tables_and_json(tmp_path):
    rows = [{"scan": "a", "x": 1.23456, "ok": True}, {"scan": "b", "n": 12345, "x": float("nan")}]
    lines = report.table(rows).splitlines()
    assert [cell.strip() for cell in lines[0].strip("|").split("|")] == ["scan", "x", "ok", "n"]
    assert [cell.strip() for cell in lines[2].strip("|").split("|")] == ["a", "1.23", "yes", "-"]
    assert [cell.strip() for cell in lines[3].strip("|").split("|")] == ["b", "-", "-", "12345"]
    assert report.table([]) == "(nothing measured)"
    path = tmp_path / "rows.json"
    report.write_json(path, "one", rows[:1])
    report.write_json(path, "two", [])
    assert path.read_text().count('"one"') == 1 and '"two"' in path.read_text()


def test_models_are_read_by_material(tmp_path):
    path = tmp_path / "tree.obj"
    path.write_text(
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 9 9 9\n"
        "usemtl bark\nf 1/1/1 2/2/2 3/3/3 4/4/4\nusemtl leaves\nf 1 2 5\n"
    )
    vertices, faces = synthetic.read_obj(path, "bark")
    assert len(vertices) == 4 and faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    vertices, faces = synthetic.read_obj(path)
    assert len(vertices) == 5 and len(faces) == 3
