"""``--species auto``: a tree that a model recognises gets its parameters, and any other stays as it is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from sapwood_scans import tree_points

import sapwood
from classify import FEATURES, train_model, write_model
from sapwood.classifying import find_model, recognise
from treegraph import InputError, encode_lobes

NAMES = [feature.name for feature in FEATURES]
N_EACH = 12


def plain(points):
    return sapwood.reconstruct(points, species=None)


@pytest.fixture(scope="module")
def points():
    """Of a leafy tree, and of a bare one."""
    return {"leafy": tree_points(1), "bare": tree_points(leaves=False)}


@pytest.fixture(scope="module")
def described(points):
    return {name: sapwood.features_of(plain(xyz)).array for name, xyz in points.items()}


def taught(described, leafy, bare):
    """A model for which trees like the leafy one are of one species, those like the bare one of another."""
    rng = np.random.default_rng(0)
    x = np.concatenate([
        described[name] * rng.normal(1.0, 0.02, (N_EACH, len(NAMES))) for name in ("leafy", "bare")
    ])  # fmt: skip
    names = [leafy] * N_EACH + [bare] * N_EACH
    return train_model(x, names, NAMES, rng=rng, n_folds=3, name="two kinds").model


@pytest.fixture(scope="module")
def model(described):
    return taught(described, "Oak", "Pine")


def refusing(model):
    """The same, but every tree is none of these."""
    return replace(model, rejection=replace(model.rejection, score_min=1e6))


def undecided(model):
    """The same, but both species are about as probable."""
    s = model.stumps
    faint = {name: 1e-3 * getattr(s, name) for name in ("intercept", "above", "below", "constant")}
    rejection = replace(model.rejection, score_min=-1e6)
    return replace(model, stumps=replace(s, **faint), temperature=1000.0, rejection=rejection)


def test_a_leafy_tree_gets_the_parameters_of_its_species(points, model):
    made = sapwood.reconstruct(points["leafy"], model=model)
    named = sapwood.reconstruct(points["leafy"], species="Oak")
    assert made.recognised["species"] == "Oak" and made.recognised["taken"]
    assert encode_lobes(made.tree) == encode_lobes(named.tree)
    assert encode_lobes(made.tree) != encode_lobes(plain(points["leafy"]).tree)
    assert {"again", "classify"} < set(made.seconds)
    said = [note for note in made.notes if note.startswith("taken for Oak by its shape (probability ")]
    assert len(said) == 1 and named.recognised is None


def test_a_bare_tree_keeps_its_branches(points, model):
    made = sapwood.reconstruct(points["bare"], model=model)
    assert made.tree.species == "Pine" and made.tree.allometry.f_s == 1.0
    assert not made.tree.clusters
    assert encode_lobes(replace(made.tree, species=None)) == encode_lobes(plain(points["bare"]).tree)


@pytest.mark.parametrize("change", [refusing, undecided])
def test_what_is_not_recognised_is_left_as_it_is(points, model, change):
    made = sapwood.reconstruct(points["leafy"], model=change(model))
    assert not made.recognised["taken"]
    assert (made.recognised["species"] is None) == (change is refusing)
    assert encode_lobes(made.tree) == encode_lobes(plain(points["leafy"]).tree)
    assert made.tree.species is None
    assert not [note for note in made.notes if "taken for" in note]


def test_a_species_that_the_library_lacks_is_only_a_name(points, described):
    made = sapwood.reconstruct(points["leafy"], model=taught(described, "Baobab", "Pine"))
    assert made.tree.species == "Baobab"
    assert encode_lobes(replace(made.tree, species=None)) == encode_lobes(plain(points["leafy"]).tree)


def test_the_species_that_is_named_is_taken_without_asking(points, model):
    made = sapwood.reconstruct(points["leafy"], species="Beech")
    assert made.tree.species == "Beech" and made.recognised is None
    for species in ("Beech", "none", None):
        with pytest.raises(InputError, match="a model recognises species, and with a species named, or none"):
            sapwood.reconstruct(points["leafy"], species=species, model=model)


def test_auto_and_none_are_words_in_capitals_or_not(points, model):
    made = sapwood.reconstruct(points["bare"], species="Auto", model=model)
    assert made.tree.species == "Pine"
    assert sapwood.reconstruct(points["bare"], species="NONE").recognised is None


def test_a_model_is_asked_about_the_tree_of_the_default_settings(points, model):
    plain_answer = sapwood.reconstruct(points["leafy"], model=model).recognised
    made = sapwood.reconstruct(points["leafy"], model=model, gamma=1.2, f_s=1.0)
    assert made.recognised == plain_answer
    assert not made.tree.clusters and made.settings["gamma"] == 1.2


def test_a_leafy_tree_keeps_its_clusters_whatever_its_species(points, described, tmp_path):
    """A species of one's own that has no leaves: f_s = 1."""
    from species.library.catalog import BUILTIN

    text = (BUILTIN / "pine.toml").read_text(encoding="utf-8")
    assert "f_s = 0.9" in text
    lines = ["f_s = 1.0" if line.startswith("f_s = ") else line for line in text.splitlines()]
    (tmp_path / "pine.toml").write_text("\n".join(lines), encoding="utf-8")
    model = taught(described, "Pine", "Oak")
    assert not sapwood.reconstruct(points["leafy"], species="Pine", library=tmp_path).tree.clusters
    made = sapwood.reconstruct(points["leafy"], library=tmp_path, model=model)
    assert made.recognised["taken"] and made.tree.species == "Pine"
    assert encode_lobes(replace(made.tree, species=None)) == encode_lobes(plain(points["leafy"]).tree)


def test_a_recognised_species_that_cannot_be_derived_costs_only_the_leaves(points, described, tmp_path):
    (tmp_path / "pine.toml").write_text(broken_pine(), encoding="utf-8")
    model = taught(described, "Pine", "Oak")
    made = sapwood.reconstruct(points["leafy"], library=tmp_path, model=model)
    made.save(tmp_path / "out", preview=False, library=tmp_path)
    report = json.loads((tmp_path / "out" / f"{made.name}.json").read_text())
    said = [note for note in report["notes"] if note.startswith("it gets no leaves: ")]
    assert len(said) == 1 and "pine.toml" in said[0]
    named = sapwood.reconstruct(points["leafy"], library=tmp_path, species="Pine")
    with pytest.raises(InputError, match="pine.toml"):
        named.save(tmp_path / "named", preview=False, library=tmp_path)


def broken_pine():
    from species.library.catalog import BUILTIN

    return (BUILTIN / "pine.toml").read_text(encoding="utf-8").replace("axiom =", "axiom = [", 1)


def test_a_preview_of_a_recognised_species_that_cannot_be_derived_has_hulls(
    monkeypatch, run, scans, described, tmp_path
):
    model = taught(described, "Pine", "Oak")
    monkeypatch.setattr("sapwood.pipeline.find_model", lambda _: model)
    (tmp_path / "kinds").mkdir()
    (tmp_path / "kinds" / "pine.toml").write_text(broken_pine(), encoding="utf-8")
    asked = ("sapwood", "preview", scans / "leafy.xyz", "-o", "a.png", "--library", "kinds", "--force")
    for more in ((), ("--species", "auto")):
        done = run(*asked, *more)
        assert done.code == 0 and "it gets no leaves: " in done.err and (tmp_path / "a.png").exists()
    named = run(*asked, "--species", "Pine")
    assert named.code == 2 and "pine.toml" in named.err


def test_a_preview_without_a_species_has_hulls(run, scans, tmp_path):
    done = run("sapwood", "preview", scans / "leafy.xyz", "-o", "a.png", "--species", "NONE", "--json")
    assert done.code == 0 and done.json["leaves"] is None


def test_a_faulty_species_of_the_library_is_said_though_none_is_named(run, scans, tmp_path):
    (tmp_path / "kinds").mkdir()
    (tmp_path / "kinds" / "oak.toml").write_text("name = ", encoding="utf-8")
    done = run("reconstruct", scans / "leafy.xyz", "-o", "a", "--no-preview", "--library", "kinds")
    assert done.code == 0 and "left out: " in done.err and "oak.toml" in done.err


def test_a_bare_tree_is_said_to_be_bare(points, model):
    notes = sapwood.reconstruct(points["bare"], model=model).notes
    assert any(note.startswith("taken for Pine and bare by its shape") for note in notes)


def test_names_are_no_longer_than_a_tree_file_holds(model):
    assert replace(model, classes=("ä" * 127, "Pine")).classes[0] == "ä" * 127
    with pytest.raises(InputError, match="classes must take at most 255 bytes in UTF-8"):
        replace(model, classes=("ä" * 128, "Pine"))


def test_too_few_points_are_not_recognised(points, model):
    import recon

    encoding = recon.encode_with_report(points["leafy"])
    few = replace(encoding, cloud=encoding.cloud.take(np.arange(5)))
    assert recognise(few, model) == {
        "species": None, "probability": None, "probabilities": {}, "features": [], "taken": False,
        "model": "two kinds, 1",
    }  # fmt: skip


def test_the_model_that_comes_along_knows_the_library():
    from species.library import builtin_library

    assert list(find_model().classes) == sorted(builtin_library().names)
    assert find_model() is find_model()


def test_a_model_of_other_features_is_refused(model):
    with pytest.raises(InputError, match="the model looks at 'heat'"):
        find_model(replace(model, features=("heat", *model.features[1:])))


def test_the_command_takes_a_model(run, scans, model, tmp_path):
    write_model(tmp_path / "two.model", model)
    done = run(
        "reconstruct", scans / "leafy.xyz", "-o", "a", "--no-preview", "--json", "--model", "two.model"
    )
    report = done.json["trees"][0]
    assert done.code == 0
    assert (report["recognised"]["species"], report["settings"]["species"]) == ("Oak", "Oak")
    assert report["leaves"]["species"] == "Oak" and report["leaf_area_m2"] > 0.0
    assert json.loads((tmp_path / "a" / "leafy.json").read_text())["recognised"] == report["recognised"]
    none = run("reconstruct", scans / "leafy.xyz", "-o", "b", "--no-preview", "--json", "--species", "none")
    assert (
        none.json["trees"][0]["recognised"] is None and none.json["trees"][0]["settings"]["species"] is None
    )


def test_a_bad_model_is_said_before_any_scan_is_read(run, tmp_path):
    (tmp_path / "bad.model").write_text("{}")
    done = run("reconstruct", "absent.laz", "also.laz", "-o", "a", "--model", "bad.model")
    assert done.code == 2 and "bad.model: a model must begin with" in done.err
    assert not (tmp_path / "a").exists()
