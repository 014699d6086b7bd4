"""``sapwood fit``: growth parameters from trees."""

import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
from PIL import Image

import treegraph
from sapwood.fitting import Budget, parse_bounds, parse_budget, parse_fixed
from species import find_preset, grow, read_growth
from treegraph import InputError, TreeGraph, write_swc

FEW = ("--budget", "40")


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A small grown tree as SWC."""
    grown = grow(find_preset("F6b").parameters, 6, rng=np.random.default_rng(1)).tree
    path = tmp_path_factory.mktemp("fit") / "tree.swc"
    write_swc(TreeGraph(grown.parent, grown.position, grown.radius), path)
    return path


def test_what_is_written_can_be_grown(run, tree, tmp_path):
    done = run(
        "sapwood", "fit", tree, "-o", "kind.toml", *FEW, "--fix", "NLB=3", "--bounds", "BAM=30:40", "--json"
    )
    assert (done.code, done.err) == (0, "")
    said = done.json
    kind = read_growth(tmp_path / "kind.toml")
    assert kind.parameters.symbols() == said["parameters"]
    assert (kind.name, kind.age, kind.parameters.n_lateral_buds) == ("kind", said["age"], 3)
    assert 30 <= kind.parameters.branching_angle_mean_deg <= 40
    table = tomllib.loads((tmp_path / "kind.toml").read_text())["fit"]
    for name in ("distance", "shape", "geometry", "structure", "evaluations", "status", "distances"):
        assert table[name] == said[name]
    assert said["curves"][0][-1][0] == said["evaluations"] >= 40
    assert said["spread"]["BAM"] is None
    assert said["distances"] == [said["distance"]]
    assert run("sapwood", "grow", "kind.toml", "-o", "brother.swc").code == 0


def test_same_bytes_with_threads_and_after_a_break(run, tree, tmp_path):
    names = ("kind_1.toml", "kind_2.toml", "kind_3.toml")
    extra = ((), ("--jobs", "2"), ("--checkpoint", "state.json"))
    for name, more in zip(names, extra, strict=True):
        assert run("sapwood", "fit", tree, "-o", name, *FEW, "--runs", "2", "--seed", "4", *more).code == 0
    texts = {(tmp_path / name).read_text().replace(name.removesuffix(".toml"), "kind") for name in names}
    assert len(texts) == 1
    assert "[fit.spread]" in texts.pop()
    again = run(
        "sapwood", "fit", tree, "-o", "kind_3.toml", "--force", *FEW, "--runs", "2", "--seed", "4",
        "--checkpoint", "state.json", "--json",
    )  # fmt: skip
    assert again.json["grown"] == 0
    assert (tmp_path / "kind_3.toml").read_text().replace("kind_3", "kind") == (
        tmp_path / "kind_1.toml"
    ).read_text().replace("kind_1", "kind")


KILLED = """
import inverse.fitting, inverse.runs
inverse.fitting.CHECKPOINT_SECONDS = 0.0
inverse.runs.SLICE_SECONDS = 0.1
from sapwood.cli.main import sapwood_main
if __name__ == "__main__":
    sapwood_main()
"""


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_killed_and_resumed_it_ends_with_the_same_bytes(run, tree, tmp_path, jobs):
    """kill -9 in the middle, from outside; then the same command again."""
    words = ("--budget", "900", "--runs", "2", "--seed", "4", "--checkpoint", "state.json")
    command = ["fit", str(tree), "-o", "kind.toml", *words, "--jobs", jobs]
    process = subprocess.Popen([sys.executable, "-c", KILLED, *command], cwd=tmp_path)
    end = time.monotonic() + 120.0
    while not (tmp_path / "state.json").exists() and time.monotonic() < end and process.poll() is None:
        time.sleep(0.02)
    process.kill()
    assert process.wait() == -9
    assert not (tmp_path / "kind.toml").exists()
    assert not list(tmp_path.glob("kind*"))
    resumed = run("sapwood", *command, "--json")
    assert resumed.code == 0
    assert resumed.json["grown"] > 0
    whole = (tmp_path / "kind.toml").read_text()
    assert run("sapwood", "fit", tree, "-o", "kind.toml", "--force", *words[:-2]).code == 0
    assert (tmp_path / "kind.toml").read_text() == whole


def test_picture_of_the_curves(run, tree, tmp_path):
    words = ("--runs", "2", "--picture", "curve.png", "--json")
    done = run("sapwood", "fit", tree, "-o", "kind.toml", *FEW, *words)
    assert (done.code, done.json["picture"]) == (0, "curve.png")
    with Image.open(tmp_path / "curve.png") as picture:
        colors = {color for _, color in picture.getcolors(100_000) if max(color) - min(color) > 60}
    assert len(colors) >= 2  # one for each run
    again = run("sapwood", "fit", tree, "-o", "other.toml", *FEW, "--picture", "curve.png")
    assert again.error.startswith("curve.png: the file exists already")
    bad = run("sapwood", "fit", tree, "-o", "other.toml", *FEW, "--picture", "curve.pdf")
    assert bad.error == "curve.pdf: the name of a picture must end in .png or .jpg or .jpeg."


@pytest.mark.parametrize("curve", [[], [(0, 0.5)], [(10, 0.4), (20, 0.4)], [(1, 0.9), (60_000, 0.1)]])
def test_curves_of_any_length_can_be_drawn(curve):
    from sapwood.curves import draw_curves

    assert draw_curves([curve]).size == (900, 520)


def test_least_so_far_is_a_staircase():
    from sapwood.curves import _least_so_far

    assert _least_so_far([(1, 0.5), (2, 0.7), (3, 0.4)]) == [(1, 0.5), (2, 0.5), (3, 0.5), (3, 0.4)]


def test_dask_that_is_not_installed(run, tree, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    done = run("sapwood", "fit", tree, "-o", "kind.toml", *FEW, "--dask", "tcp://127.0.0.1:1")
    assert done.error == "--dask needs the package distributed; install it with: pip install 'sapwood[dask]'"


def test_dask_that_does_not_answer(run, tree, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("sapwood.spreading.DASK_SECONDS", 0.5)
    for address in ("tcp://127.0.0.1:1", "nowhere"):
        done = run("sapwood", "fit", tree, "-o", "kind.toml", *FEW, "--dask", address)
        assert done.code == 2
        assert done.error.startswith(f"{address}: no Dask scheduler answers there (")


@pytest.mark.filterwarnings("default")  # of what a cluster of threads says when it ends
def test_runs_on_a_dask_cluster(run, tree, tmp_path):
    distributed = pytest.importorskip("distributed")
    words = (*FEW, "--runs", "3", "--seed", "4")
    assert run("sapwood", "fit", tree, "-o", "kind.toml", *words).code == 0
    here = (tmp_path / "kind.toml").read_text()
    with distributed.LocalCluster(2, processes=False, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        done = run("sapwood", "fit", tree, "-o", "kind.toml", "--force", *words, "--dask", address)
        assert (done.code, done.err) == (0, "")
    assert (tmp_path / "kind.toml").read_text() == here
    with distributed.LocalCluster(1, processes=False, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        cluster.scale(0)
        end = time.monotonic() + 20.0
        while cluster.scheduler.workers and time.monotonic() < end:
            time.sleep(0.02)
        done = run("sapwood", "fit", tree, "-o", "other.toml", *words, "--dask", address)
        assert done.error == f"{address}: this Dask cluster has no workers yet; start some"


def test_annealing_and_several_trees(run, tree):
    done = run(
        "sapwood", "fit", tree, tree, "-o", "kind.toml", "--method", "annealing", "--budget", "40", "--json"
    )
    assert done.code == 0
    assert done.json["evaluations"] == 48  # five iterations and the point it began with
    assert len(done.json["input"]) == 2


def test_time(run, tree):
    done = run("sapwood", "fit", tree, "-o", "kind.toml", "--budget", "0.5s")
    assert (done.code, done.err) == (0, "")
    assert done.out.startswith("kind.toml: distance 0.")
    long = run("sapwood", "fit", tree, "-o", "other.toml", "--budget", "0.2s", "--method", "annealing")
    assert long.err.splitlines() == ["note: time ran out before the search was done"]
    assert done.out.startswith("kind.toml: distance 0.")


@pytest.mark.parametrize(
    "arguments, match",
    [
        (("none.swc", "-o", "x.toml"), "none.swc: there is no such file."),
        (("forest.swc", "-o", "x.toml"), "forest.swc: a tree to compare must have one root, got 2"),
        (("node.swc", "-o", "x.toml"), "a tree to fit must have some height, got none"),
        (("forest.swc", "-o", "x.swc"), "x.swc: the name of fitted parameters must end in .toml."),
        (
            ("forest.swc", "-o", "x.toml", "--budget", "soon"),
            "budget must be a number of evaluations or a time",
        ),
        (("forest.swc", "-o", "x.toml", "--fix", "NLB"), "'NLB' is not NAME=X, as in NLB=2"),
        (("TREE", "-o", "x.toml", "--fix", "XYZ=3"), "there is no parameter 'XYZ'"),
    ],
)
def test_errors(run, tree, tmp_path, arguments, match):
    write_swc(TreeGraph([-1, -1], [[0, 0, 0], [0, 0, 1]], [0.1, 0.1]), tmp_path / "forest.swc")
    write_swc(TreeGraph([-1], [[0, 0, 0]], [0.1]), tmp_path / "node.swc")
    done = run("sapwood", "fit", *(tree if word == "TREE" else word for word in arguments))
    assert done.code == 2
    assert match in done.error
    assert not (tmp_path / "x.toml").exists()


def test_branches_go_on_into_the_leaves_of_a_scan(scans, tmp_path):
    """What is fitted has more branches than the skeleton, or only that, or only so many."""
    import sapwood
    from inverse import cut_into_pieces
    from sapwood.fitting import read_target

    made = sapwood.reconstruct(scans / "leafy.xyz")
    path = tmp_path / "leafy.lobes"
    treegraph.write_lobes(made.tree, path)
    own = made.tree.graph.n_nodes
    assert read_target(path, crown=False).n_nodes == own
    filled = read_target(path)
    assert filled.n_nodes >= own
    assert cut_into_pieces(read_target(path, branches=3)).n_pieces <= 3


@pytest.mark.parametrize("suffix", ["swc", "lobes"])
def test_empty_files_and_numbers_that_are_none(run, tmp_path, suffix):
    for name, text in (("empty", b""), ("nan", b"1 1 0 0 0 nan -1\n2 1 0 0 nan 1 1\n"), ("text", b"a tree")):
        (tmp_path / f"{name}.{suffix}").write_bytes(text)
        done = run("sapwood", "fit", f"{name}.{suffix}", "-o", "x.toml", *FEW)
        assert done.code == 2
        assert done.error.startswith(f"{name}.{suffix}: ")
    assert not (tmp_path / "x.toml").exists()


def test_bush_of_ten_thousand_tips_ends_with_a_reason_or_is_thinned(run, tmp_path):
    rng = np.random.default_rng(0)
    tips = rng.normal(size=(10_000, 3)) * 0.4 + (0.0, 0.0, 3.0)
    position = np.concatenate([[[0, 0, 0], [0, 0, 2]], tips])
    radius = np.concatenate([[0.2, 0.2], rng.uniform(0.002, 0.01, 10_000)])
    write_swc(TreeGraph([-1, 0] + [1] * 10_000, position, radius), tmp_path / "bush.swc")
    start = time.monotonic()
    done = run("sapwood", "fit", "bush.swc", "-o", "x.toml", *FEW)
    assert (done.code, time.monotonic() - start < 20.0) == (2, True)
    assert done.error == (
        "a tree to fit must have at most 4000 branches between forks, but tree 0 has 10001; leave its "
        "thinnest ones out (--branches, inverse.thin_out)"
    )
    assert run("sapwood", "fit", "bush.swc", "-o", "x.toml", *FEW, "--branches", "40").code == 0


def test_what_is_fitted_can_be_a_species(run, tree, tmp_path):
    """The [growth] table in place of a species' own: it builds, and grows."""
    assert run("sapwood", "fit", tree, "-o", "kind.toml", *FEW).code == 0
    assert run("sapwood", "species", "show", "oak", "-o", "mine.toml").code == 0
    text = (tmp_path / "mine.toml").read_text().replace('name = "Oak"', 'name = "Mine"', 1)
    before, _, after = text.partition("[growth]")
    rest = after.partition("\n[")[1] + after.partition("\n[")[2]
    fitted = (tmp_path / "kind.toml").read_text().partition("[fit]")[0].replace('name = "kind"\n', "")
    others = "\n".join(line for line in before.splitlines() if not line.startswith("also"))
    (tmp_path / "mine.toml").write_text(others + "\n" + fitted + rest)
    built = run("sapwood", "species", "build", "mine.toml", "--no-sheet")
    assert built.code == 0, built.err
    grown = run(
        "sapwood", "grow", "--species", "Mine", "--library", ".", "--seed", "2", "-o", "tree.swc", "--json"
    )
    assert grown.code == 0, grown.err
    again = run("sapwood", "grow", "kind.toml", "--seed", "2", "-o", "same.swc")
    assert again.code == 0
    rows = [(tmp_path / name).read_text().splitlines()[-5:] for name in ("tree.swc", "same.swc")]
    assert rows[0] == rows[1]


def test_thick_wood_is_grown_as_it_was_fitted(run, tree, tmp_path):
    graph = treegraph.read_swc(tree)
    write_swc(graph.replace(radius=10.0 * graph.radius), tmp_path / "thick.swc")
    done = run("sapwood", "fit", "thick.swc", "-o", "thick.toml", *FEW, "--json")
    assert done.json["tip_share"] == read_growth(tmp_path / "thick.toml").tip_share > 0.03
    assert run("sapwood", "grow", "thick.toml", "-o", "thick_grown.swc").code == 0
    assert run("sapwood", "grow", "thick.toml", "--age", "2", "-o", "young.swc").code == 0
    text = (tmp_path / "thick.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith("tip_share")]
    (tmp_path / "thin.toml").write_text("\n".join(lines))
    assert run("sapwood", "grow", "thin.toml", "-o", "thin_grown.swc").code == 0
    radii = [treegraph.read_swc(tmp_path / f"{name}_grown.swc").radius.max() for name in ("thick", "thin")]
    assert radii[0] > 2.0 * radii[1]


def test_outputs_are_not_replaced(run, tree, tmp_path):
    (tmp_path / "kind.toml").write_text("mine")
    done = run("sapwood", "fit", tree, "-o", "kind.toml", *FEW)
    assert done.code == 2
    assert done.error.startswith("kind.toml: the file exists already")


def test_places_that_cannot_be_written_are_known_before_the_fit(run, tree, tmp_path, monkeypatch):
    monkeypatch.setattr("inverse.fit_trees", None)  # it must not come so far
    (tmp_path / "file").write_text("")
    for words, match in (
        (("-o", "file/kind.toml"), "file: this is a file, not a folder; name another one."),
        (("-o", "kind.toml", "--picture", "file/curve.png"), "file: this is a file, not a folder"),
        (
            ("-o", "kind.toml", "--checkpoint", "kind.toml"),
            "kind.toml: the checkpoint must have a name of its",
        ),
        (("-o", "kind.toml", "--checkpoint", tree), f"{tree}: the checkpoint must have a name of its own."),
    ):
        done = run("sapwood", "fit", tree, *words)
        assert done.code == 2
        assert done.error.startswith(match)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_folders_of_a_fit_that_fails_are_not_left(run, tree, tmp_path):
    assert run("sapwood", "fit", tree, "-o", "a/b/kind.toml", "--fix", "XYZ=3").code == 2
    assert not (tmp_path / "a").exists()
    assert run("sapwood", "fit", tree, "-o", "a/b/kind.toml", *FEW).code == 0


@pytest.mark.skipif(sys.platform != "linux", reason="other systems' names are text")
def test_names_that_are_no_text(run, tree, tmp_path):
    """Bytes, quotes and control codes: what is written is TOML all the same."""
    name = 'b\udcff\x7f"'
    (tmp_path / f"{name}.swc").write_bytes(tree.read_bytes())
    assert run("sapwood", "fit", f"{name}.swc", "-o", f"{name}.toml", *FEW).code == 0
    table = tomllib.loads((tmp_path / f"{name}.toml").read_text())
    assert table["fit"]["trees"] == ['b\\udcff\x7f".swc']
    assert table["growth"]["name"] == 'b\\udcff\x7f"'
    assert run("sapwood", "grow", f"{name}.toml", "-o", "brother.swc").code == 0


def test_coordinates_that_are_too_large(run, tree, tmp_path):
    (tmp_path / "far.swc").write_text("1 1 0 0 0 1 -1\n2 1 0 0 1e200 1 1\n")
    for words in (("fit", "far.swc", "-o", "x.toml"), ("compare", "far.swc", tree)):
        done = run("sapwood", *words)
        assert done.code == 2
        assert done.error.startswith("far.swc: a tree to compare must have coordinates and radii up to 1e+09")


def test_budget():
    assert parse_budget("6000") == Budget(evaluations=6000)
    assert parse_budget(" 5min ") == Budget(seconds=300.0)
    assert parse_budget("1.5h") == Budget(seconds=5400.0)
    for text in ("", "0", "5 days", "1.5", "-3", "nan", "1e5", "9999999999"):
        with pytest.raises(InputError, match="budget must be a number of evaluations or a time"):
            parse_budget(text)


def test_parameters_from_words():
    assert parse_fixed(["NLB=2", "PT=-0.1"]) == {"NLB": 2.0, "PT": -0.1}
    assert parse_bounds(["BAM=30:60"]) == {"BAM": (30.0, 60.0)}
    for parse, items, match in (
        (parse_fixed, ["NLB=two"], "'NLB=two' is not NAME=X"),
        (parse_fixed, ["NLB=nan"], "is not NAME=X"),
        (parse_fixed, ["NLB=2", "NLB=3"], "'NLB=3': NLB is given twice"),
        (parse_bounds, ["BAM=30"], "'BAM=30' is not NAME=LOW:HIGH, as in BAM=30:60"),
    ):
        with pytest.raises(InputError, match=match):
            parse(items)
