"""``sapwood species train`` and ``sapwood classify``: from scans to a model, and from a model to species."""

import json

import numpy as np
import pytest
from sapwood_scans import tree_points, write_xyz

from classify import FEATURES, read_model, shipped_model, write_model
from sapwood.batch import DONE, INPUT, INTERNAL, Job, Outcome
from sapwood.classifying import describe_job, say_species
from sapwood.training import find_labelled
from treegraph import InputError

N_EACH = 4


def oak(seed):
    return tree_points(seed, height=6.0 + seed % 4, n=3000)


def pole(seed):
    return tree_points(seed, height=11.0 + seed % 4, leaves=False, n=3000)


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """A folder of two species with a few scans each."""
    folder = tmp_path_factory.mktemp("train") / "kinds"
    for seed in range(N_EACH):
        write_xyz(folder / "oak" / f"{seed}.xyz", oak(seed))
        write_xyz(folder / "pole" / f"{seed}.xyz", pole(seed))
    return folder


@pytest.fixture
def known(monkeypatch):
    """Scans are described in this process, each once for all tests: the workers have tests of their own."""
    monkeypatch.setattr(
        "sapwood.batch.run_batch", lambda jobs, n_workers, work: (described(job) for job in jobs)
    )


KEPT = {}


def described(job):
    if job.scan not in KEPT:
        KEPT[job.scan] = describe_job(job)
    kept = KEPT[job.scan]
    return Outcome(job, kept.kind, kept.message, kept.trace, kept.report)


@pytest.fixture(scope="module")
def trained():
    """The files of the first training, by suffix."""
    return {}


@pytest.fixture
def model(run, kinds, known, trained, tmp_path):
    """The model of these scans, with its report beside it."""
    path = tmp_path / "kinds.model"
    if not trained:
        assert run("sapwood", "species", "train", kinds, "-o", path).code == 0
        trained |= {suffix: path.with_suffix(suffix).read_bytes() for suffix in (".model", ".json")}
    for suffix, data in trained.items():
        path.with_suffix(suffix).write_bytes(data)
    return path


def test_training_writes_a_model_and_its_report(run, kinds, known, tmp_path):
    done = run("sapwood", "species", "train", kinds, "-o", "kinds.model", "--seed", "3", "--json")
    assert done.code == 0
    report = json.loads((tmp_path / "kinds.json").read_text())
    said = done.json
    assert {key: said[key] for key in report if key != "schema_version"} == {
        key: value for key, value in report.items() if key != "schema_version"
    }
    assert said["files"] == ["kinds.model", "kinds.json"]
    assert report["classes"] == ["oak", "pole"]
    assert report["scans"] == report["trees"] == {"oak": N_EACH, "pole": N_EACH}
    assert report["confusion"] == [[N_EACH, 0], [0, N_EACH]]
    assert report["accuracy"] == 1.0
    assert 0.0 <= report["calibration_error"] <= 1.0
    assert 0.0 <= report["false_rejections"] <= 1.0
    assert (report["seed"], report["failed"]) == (3, [])
    assert sum(report["reliability"]["count"]) == 2 * N_EACH
    assert {"sapwood", "python", "numpy"} <= report["versions"].keys()
    model = read_model(tmp_path / "kinds.model")
    assert model.features == tuple(feature.name for feature in FEATURES)
    assert model.provenance["seed"] == "3"


def test_same_seed_same_bytes_whatever_the_jobs(run, kinds, model, trained, tmp_path):
    done = run("sapwood", "species", "train", kinds, "-o", model, "--jobs", "2", "--force")
    assert done.code == 0
    assert f"kinds.model: 2 species, {2 * N_EACH} scans, accuracy 100.0% held out" in done.out
    assert f"pole: {N_EACH} of {N_EACH} recognised when held out" in done.out
    for suffix, data in trained.items():
        assert model.with_suffix(suffix).read_bytes() == data


def test_new_scans_are_told_apart(run, model, tmp_path):
    write_xyz(tmp_path / "new.xyz", pole(6))
    done = run("sapwood", "classify", "new.xyz", "--model", model, "--json")
    assert done.code == 0
    assert done.json["failed"] == []
    (scan,) = done.json["scans"]
    assert scan["file"] == "new.xyz"
    assert next(iter(scan["probabilities"])) == "pole"
    assert scan["species"] in ("pole", None)
    assert scan["probability"] == scan["probabilities"]["pole"] > 0.5
    assert sum(scan["probabilities"].values()) == pytest.approx(1.0)
    parts = [feature["part"] for feature in scan["features"]]
    assert 1 <= len(parts) <= 5
    assert parts == sorted(parts, reverse=True)
    assert parts[-1] > 0.0
    features = dict(
        zip(
            [f.name for f in FEATURES],
            describe_job(Job("new.xyz", "", "", "")).report["features"],
            strict=True,
        )
    )
    for feature in scan["features"]:
        assert feature["value"] == pytest.approx(features[feature["name"]])


def test_what_is_printed_for_people(run, kinds, model):
    done = run("sapwood", "classify", kinds / "oak" / "1.xyz", "--model", model)
    first, second = done.out.splitlines()
    assert first.startswith(f"{kinds / 'oak' / '1.xyz'}: oak ")
    assert "(pole 0." in first
    assert second.startswith("  what spoke for it: ")
    assert run("sapwood", "classify", kinds / "oak" / "1.xyz", "--model", model, "--quiet").out == ""


def test_a_scan_unlike_all_is_of_none_of_these(run, model, tmp_path):
    ball = np.random.default_rng(0).normal(0, 3.0, (4000, 3)) * (1, 1, 0.2) + (0, 0, 40)
    trunk = np.c_[np.random.default_rng(1).normal(0, 1.0, (4000, 2)), np.linspace(0, 40, 4000)]
    write_xyz(tmp_path / "odd.xyz", np.concatenate([ball, trunk]))
    done = run("sapwood", "classify", "odd.xyz", "--model", model, "--json")
    assert done.code == 0
    (scan,) = done.json["scans"]
    assert scan["species"] is None
    assert scan["probability"] == max(scan["probabilities"].values())
    assert run("sapwood", "classify", "odd.xyz", "--model", model).out.startswith(
        "odd.xyz: none of these (most"
    )


def test_bad_files_fail_alone(run, kinds, model, tmp_path):
    (tmp_path / "bad.ply").write_text("no scan")
    done = run("sapwood", "classify", "bad.ply", kinds / "oak", "no/*.laz", "--model", model, "--json")
    assert done.code == 3
    assert len(done.json["scans"]) == N_EACH
    assert [(f["file"], f["kind"]) for f in done.json["failed"]] == [("bad.ply", INPUT), ("no/*.laz", INPUT)]
    assert f"error: 2 of {N_EACH + 2} scans failed:" in done.err
    alone = run("sapwood", "classify", "bad.ply", "--model", model)
    assert alone.code == 2
    assert alone.error.startswith("bad.ply: ")
    assert run("sapwood", "classify", "absent.laz", "--model", model).code == 2


def test_a_bad_scan_does_not_end_the_training(run, kinds, known, tmp_path):
    rows = [f"{kinds / kind / name}.xyz,{kind}" for kind in ("oak", "pole") for name in "012"]
    (tmp_path / "bad.xyz").write_text("1 2 3\n")
    (tmp_path / "t.csv").write_text("\n".join(["path,species", *rows, "bad.xyz,oak"]) + "\n")
    done = run("sapwood", "species", "train", "t.csv", "-o", "t.model", "--json")
    assert done.code == 3
    assert done.json["scans"] == {"oak": 3, "pole": 3}
    assert [each["file"] for each in done.json["failed"]] == ["bad.xyz"]
    assert "error: bad.xyz: " in done.err
    few = [*rows[:1], *rows[3:], "bad.xyz,oak"]
    (tmp_path / "few.csv").write_text("\n".join(["path,species", *few]) + "\n")
    done = run("sapwood", "species", "train", "few.csv", "-o", "few.model")
    assert done.code == 2
    assert "at least 2 trees of each species, got 1 of oak" in done.err.splitlines()[-1]
    assert not (tmp_path / "few.model").exists()


def test_scans_of_a_tree_are_held_out_together(run, kinds, known, tmp_path):
    rows = [
        f"{kinds / kind / name}.xyz;{kind};{kind}{int(name) % 2}"
        for kind in ("oak", "pole")
        for name in "0123"
    ]
    (tmp_path / "t.csv").write_text("\ufeffpath;species;tree\n" + "\n".join(rows) + "\n", encoding="utf-8")
    done = run("sapwood", "species", "train", "t.csv", "-o", "t.model", "--json")
    assert done.code == 0
    assert done.json["scans"] == {"oak": 4, "pole": 4}
    assert done.json["trees"] == {"oak": 2, "pole": 2}
    (tmp_path / "one.csv").write_text("path;species;tree\n" + "\n".join(rows).replace("oak1", "oak0") + "\n")
    assert "got 1 of oak" in run("sapwood", "species", "train", "one.csv", "-o", "one.model").error


def test_nothing_is_overwritten(run, kinds, model):
    done = run("sapwood", "species", "train", kinds, "-o", model)
    assert (done.code, "--force" in done.error) == (2, True)
    model.unlink()
    assert "kinds.json: the file exists" in run("sapwood", "species", "train", kinds, "-o", model).error


@pytest.mark.parametrize(
    "table, match",
    [
        ("file,kind\na.laz,oak\n", "must name the columns path,species"),
        ("", "must name the columns path,species"),
        ("path,species\n", "there is no scan in this table"),
        ("path,species\na.laz,\n", "line 2: path and species must not be empty"),
        ("path,species\na.laz,oak\na.laz,ash\n", "line 3: a.laz is named twice"),
        ("path,species,tree\na.laz,oak,1\nb.laz,ash,1\n", "tree '1' is of two species, oak and ash"),
        ("path,species\na.laz,oak\nb.laz,oak\n", "scans of at least 2 species, got 1: oak"),
        ("path,species\na.laz,oak\nb.laz,oak\nc.laz,ash\n", "at least 2 trees of each species, got 1 of ash"),
        ("path,species\na.laz,o\x07k\n", "at most 200 printable characters"),
        ('path,species\n"a.laz,oak\n', "the table cannot be read"),
    ],
)
def test_faults_of_a_table(run, tmp_path, table, match):
    (tmp_path / "t.csv").write_text(table)
    done = run("sapwood", "species", "train", "t.csv", "-o", "t.model")
    assert done.code == 2
    assert match in done.error


def test_faults_of_a_folder(run, tmp_path):
    assert "no such folder or table" in run("sapwood", "species", "train", "absent", "-o", "t.model").error
    (tmp_path / "kinds").mkdir()
    assert "one sub-folder per species" in run("sapwood", "species", "train", "kinds", "-o", "t.model").error
    (tmp_path / "kinds" / "oak").mkdir()
    assert "no scan in this folder" in run("sapwood", "species", "train", "kinds", "-o", "t.model").error
    for name in "ab":
        write_xyz(tmp_path / "kinds" / "oak" / f"{name}.xyz", np.eye(3))
    assert "got 1: oak" in run("sapwood", "species", "train", "kinds", "-o", "t.model").error
    assert "takes the suffix .json" in run("sapwood", "species", "train", "kinds", "-o", "t.json").error
    (tmp_path / "latin.csv").write_bytes(b"path,species\na.laz,h\xeatre\n")
    assert "must be text in UTF-8" in run("sapwood", "species", "train", "latin.csv", "-o", "t.model").error


def test_paths_of_a_table_are_relative_to_it(tmp_path):
    (tmp_path / "t.csv").write_text("species,path\noak,in/a.laz\n")
    (scan,) = find_labelled(tmp_path / "t.csv")
    assert (scan.path, scan.species) == (tmp_path / "in" / "a.laz", "oak")


def test_a_model_comes_along(run, kinds, known):
    done = run("sapwood", "classify", kinds / "oak" / "0.xyz", "--json")
    assert done.code == 0
    names = set(done.json["scans"][0]["probabilities"])
    assert {"Oak", "Beech", "Pine", "Palm", "Willow"} < names and len(names) == 16
    assert done.json["model"] == shipped_model().name


def test_units_and_the_largest_of_many_trees_can_be_said(run, kinds, tmp_path):
    meters = oak(0)
    write_xyz(tmp_path / "mm.xyz", 1000.0 * meters, decimals=1)
    write_xyz(tmp_path / "two.xyz", np.concatenate([meters, 0.7 * pole(1) + [9.0, 0.0, 0.0]]))
    refused = run("sapwood", "classify", "two.xyz")
    assert refused.code == 2 and "--largest" in refused.error
    asked = ["sapwood", "classify", "--json"]
    plain = run(*asked, kinds / "oak" / "0.xyz").json["scans"][0]["probabilities"]
    for more in (["mm.xyz", "--units", "mm"], ["two.xyz", "--largest"]):
        said = run(*asked, *more)
        assert said.code == 0
        assert said.json["scans"][0]["probabilities"] == pytest.approx(plain, abs=0.2)


def test_the_foot_and_the_number_of_a_tree_can_be_said(run, model, tmp_path):
    """Two trees of two kinds in one file: either is asked about."""
    both = np.concatenate([oak(0), pole(1) + [9.0, 0.0, 0.0]])
    write_xyz(tmp_path / "both.xyz", both)
    number = np.repeat([7, 8], [len(oak(0)), len(pole(1))])
    table = ["x y z tree_id", *(f"{x} {y} {z} {k}" for (x, y, z), k in zip(both, number, strict=True))]
    (tmp_path / "numbered.txt").write_text("\n".join(table))
    for more, wanted in (
        (["both.xyz", "--base", "0,0,0"], "oak"),
        (["both.xyz", "--base", "9,0,0"], "pole"),
        (["numbered.txt", "--tree-id", "7"], "oak"),
        (["numbered.txt", "--tree-id", "8"], "pole"),
    ):
        said = run("sapwood", "classify", "--json", "--model", model, *more)
        assert said.code == 0, said.err
        assert next(iter(said.json["scans"][0]["probabilities"])) == wanted


def test_a_file_that_is_no_model_is_refused(run, tmp_path):
    (tmp_path / "x.model").write_text("{}")
    assert (
        "x.model: a model must begin with" in run("sapwood", "classify", "a.laz", "--model", "x.model").error
    )
    assert run("sapwood", "classify", "a.laz", "--model", "absent.model").error.startswith("absent.model: ")


def test_a_model_of_other_features_is_refused(run, model, tmp_path):
    from dataclasses import replace

    old = read_model(model)
    write_model(tmp_path / "other.model", replace(old, features=("heat", *old.features[1:])))
    said = run("sapwood", "classify", "a.laz", "--model", "other.model").error
    assert said.startswith("other.model: the model looks at 'heat', a feature that this version does not")


def test_features_are_found_by_name(model, kinds):
    """A model whose features come in another order says the same."""
    from dataclasses import replace

    old = read_model(model)
    order = np.arange(len(old.features))[::-1]
    stumps = replace(old.stumps, feature=order[old.stumps.feature])
    span = replace(old.span, centre=old.span.centre[:, order], spread=old.span.spread[:, order])
    turned = replace(old, features=tuple(old.features[k] for k in order), stumps=stumps, span=span)
    x = KEPT[str(kinds / "oak" / "0.xyz")].report["features"]
    assert say_species(turned, x)["probabilities"] == say_species(old, x)["probabilities"]


def test_faults_in_describing_are_outcomes(tmp_path, monkeypatch):
    job = Job(str(tmp_path / "absent.laz"), "", "", "")
    assert describe_job(job).kind == INPUT
    write_xyz(tmp_path / "a.xyz", oak(0))
    job = Job(str(tmp_path / "a.xyz"), "", "", "")
    stages = []
    assert describe_job(job, stages.append).kind == DONE
    assert stages[-1] == "describe"

    def fail(error):
        def features_of(tree):
            raise error

        monkeypatch.setattr("sapwood.classifying.features_of", features_of)
        return describe_job(job)

    found = fail(InputError("xyz must hold more"))
    assert (found.kind, found.message) == (INPUT, f"{job.scan}: xyz must hold more")
    assert fail(ZeroDivisionError("x")).kind == INTERNAL


def test_workers_describe_as_this_process_does(run, kinds, model, monkeypatch):
    monkeypatch.undo()
    names = [kinds / "oak" / "0.xyz", kinds / "pole" / "1.xyz"]
    done = run("sapwood", "classify", *names, "--model", model, "--json")
    assert [scan["file"] for scan in done.json["scans"]] == [str(name) for name in names]
    one = run("sapwood", "classify", names[1], "--model", model, "--json")
    assert one.json["scans"] == done.json["scans"][1:]
