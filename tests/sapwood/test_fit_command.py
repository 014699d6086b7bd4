"""``sapwood fit``: growth parameters from trees."""

import tomllib

import numpy as np
import pytest

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


def test_annealing_and_several_trees(run, tree):
    done = run(
        "sapwood", "fit", tree, tree, "-o", "kind.toml", "--method", "annealing", "--budget", "40", "--json"
    )
    assert done.code == 0
    assert done.json["evaluations"] == 48  # five iterations and the point it began with
    assert len(done.json["input"]) == 2


def test_time(run, tree):
    done = run("sapwood", "fit", tree, "-o", "kind.toml", "--budget", "0.2s")
    assert done.code == 0
    assert done.err.splitlines() == ["note: time ran out before the search was done"]
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


def test_outputs_are_not_replaced(run, tree, tmp_path):
    (tmp_path / "kind.toml").write_text("mine")
    done = run("sapwood", "fit", tree, "-o", "kind.toml", *FEW)
    assert done.code == 2
    assert done.error.startswith("kind.toml: the file exists already")


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
