"""Virtual scans with the name of their species: what they are of, what they depend on, and their file."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks import virtual_set
from benchmarks.virtual_set import (
    Survey,
    describe_again,
    draw_survey,
    load_set,
    make_samples,
    save_set,
    scan_tree,
    write_scans,
)
from benchmarks.virtual_trees import (
    ANY,
    CITY,
    PresetSource,
    Triangles,
    Variety,
    VirtualTree,
    draw_traits,
    grow,
    pruned,
)
from classify import FEATURES, describe_scan
from recon import encode_with_report
from species import find_preset
from treegraph import gravelius_order

NAMES = [feature.name for feature in FEATURES]


def box(low, high):
    """The triangles of a box."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    quad = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Triangles(low + corner * (high - low), np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]))


@dataclass(frozen=True)
class Boxes:
    """A source of another kind: a post with a box on it."""

    species: str = "Box tree"

    def make(self, rng):
        top = float(rng.uniform(4.0, 9.0))
        half = rng.uniform(0.8, 1.6)
        wood = box((-0.1, -0.1, 0.0), (0.1, 0.1, 0.5 * top))
        leaves = box((-half, -half, 0.5 * top), (half, half, top))
        return VirtualTree(self.species, (wood,), leaves, top, {"season": "summer"})


def survey(**changes):
    plain = {"kind": "stations", "n_stations": 2, "distance": 0.8, "azimuth": 0.3, "aim": 5000}
    plain |= {"noise": 0.002, "divergence": 0.0, "n_hiding": 0}
    return Survey(**{**plain, **changes})


def tree(seed=0):
    return Boxes().make(np.random.default_rng(seed))


# ---------------------------------------------------------------- scans


@pytest.mark.parametrize("kind, distance", [("stations", 0.8), ("street", 0.8), ("air", 80.0)])
def test_all_points_are_on_the_tree_and_about_as_many_as_aimed_at(kind, distance):
    points = scan_tree(tree(), survey(kind=kind, distance=distance), np.random.default_rng(0))
    assert 0.2 * 5000 < len(points) < 5 * 5000
    half = np.abs(points[:, :2]).max()
    vertices = np.concatenate([tree().wood[0].vertices, tree().leaves.vertices])
    assert half < np.abs(vertices[:, :2]).max() + 0.02
    assert points[:, 2].max() < vertices[:, 2].max() + 0.02


def test_bodies_hide_points_and_are_not_scanned():
    free = scan_tree(tree(), survey(n_stations=1), np.random.default_rng(1))
    hidden = scan_tree(tree(), survey(n_stations=1, n_hiding=3), np.random.default_rng(1))
    assert len(hidden) < 0.98 * len(free)
    assert np.abs(hidden[:, :2]).max() <= np.abs(free[:, :2]).max() + 0.02


def test_one_station_sees_one_side():
    points = scan_tree(tree(), survey(n_stations=1, azimuth=0.0), np.random.default_rng(2))
    assert (points[:, 0] > 0.0).mean() > 0.9


def test_too_few_points_are_no_scan(monkeypatch):
    monkeypatch.setattr(virtual_set, "LEAST_POINTS", 10**7)
    assert scan_tree(tree(), survey(), np.random.default_rng(0)).shape == (0, 3)
    assert make_samples(Boxes(), 0, 1, seed=0) == []


def test_surveys_are_of_all_kinds():
    rng = np.random.default_rng(0)
    drawn = [draw_survey(rng) for _ in range(300)]
    assert {one.kind for one in drawn} == {"stations", "street", "air"}
    assert {one.n_stations for one in drawn if one.kind == "stations"} == {1, 2, 3, 4}
    assert max(one.aim for one in drawn) > 8 * min(one.aim for one in drawn)
    assert 0.2 < np.mean([one.n_hiding > 0 for one in drawn]) < 0.45


# ---------------------------------------------------------------- samples


def test_samples_are_described_scans_of_one_tree():
    samples = make_samples(Boxes(), 4, 2, seed=7)
    assert [sample["scan"] for sample in samples] == [0, 1]
    assert {sample["tree"] for sample in samples} == {"Box tree 0004"}
    assert {sample["height"] for sample in samples} == {
        Boxes().make(np.random.default_rng(_key(4, 7))).height
    }
    made = encode_with_report(samples[1]["points"])
    assert samples[1]["x"].tobytes() == describe_scan(made.cloud.xyz, made.tree).array.tobytes()
    assert samples[0]["n_points"] == len(samples[0]["points"])


def _key(number, seed):
    import zlib

    return [seed, zlib.crc32(b"Box tree"), number]


def test_the_same_seed_gives_the_same_samples_in_any_order():
    one, two = (make_samples(Boxes(), number, 1, seed=3)[0] for number in (1, 2))
    again = make_samples(Boxes(), 1, 1, seed=3)[0]
    assert again["points"].tobytes() == one["points"].tobytes()
    assert two["height"] != one["height"]
    assert make_samples(Boxes(), 1, 1, seed=4)[0]["height"] != one["height"]


def test_a_file_gives_back_what_was_written(tmp_path):
    samples = make_samples(Boxes(), 1, 2, seed=3)
    others = make_samples(Boxes("Another"), 1, 1, seed=3)
    save_set(tmp_path / "Box.npz", samples, NAMES)
    save_set(tmp_path / "Another.npz", others, NAMES)
    found = load_set(tmp_path)
    assert len(found) == 3
    assert found.species.tolist() == ["Another", "Box tree", "Box tree"]
    assert found.tree.tolist() == ["Another 0001", "Box tree 0001", "Box tree 0001"]
    np.testing.assert_array_equal(found.x[1:], [sample["x"] for sample in samples])
    assert found.features.tolist() == NAMES
    assert found.columns["n_stations"].tolist()[1:] == [sample["n_stations"] for sample in samples]
    assert set(found.columns) >= {"kind", "aim", "noise", "season", "height", "n_points", "scan"}
    assert len(load_set(tmp_path / "Box.npz")) == 2


def test_kept_scans_are_described_anew(tmp_path):
    samples = make_samples(Boxes(), 2, 2, seed=3)
    path = tmp_path / "Box tree.npz"
    write_scans(tmp_path, samples)
    assert len(list((tmp_path / "Box tree").glob("*.xyz"))) == 2
    save_set(path, [{**sample, "x": np.zeros(3)} for sample in samples], ["a", "b", "c"])
    before = load_set(path)
    assert describe_again(path) == 2
    after = load_set(path)
    assert after.features.tolist() == NAMES
    for name, value in before.columns.items():
        np.testing.assert_array_equal(after.columns[name], value, err_msg=name)
    made = encode_with_report(np.round(samples[1]["points"], 3))
    np.testing.assert_allclose(after.x[1], describe_scan(made.cloud.xyz, made.tree).array, rtol=1e-6)


def test_a_file_is_given_the_trees_that_it_lacks_as_if_made_in_one(tmp_path, monkeypatch):
    monkeypatch.setattr(virtual_set, "library_source", lambda name, variety: Boxes(name))
    made = []

    def run(folder, *options):
        arguments = ["", str(tmp_path / folder), "--species", "Box tree", "--scans", "1", *options]
        monkeypatch.setattr("sys.argv", arguments)
        made.clear()
        virtual_set.main()

    task = virtual_set._task
    monkeypatch.setattr(virtual_set, "_task", lambda given: made.append(given[1]) or task(given))
    run("whole", "--trees", "3", "--keep-scans")
    assert made == [0, 1, 2]
    run("parts", "--trees", "1", "--keep-scans")
    run("parts", "--trees", "3", "--keep-scans")
    assert made == [1, 2]
    whole, parts = (load_set(tmp_path / folder) for folder in ("whole", "parts"))
    assert whole.tree.tolist() == parts.tree.tolist() == [f"Box tree {k:04d}" for k in range(3)]
    assert whole.x.tobytes() == parts.x.tobytes()
    for name, value in whole.columns.items():
        np.testing.assert_array_equal(parts.columns[name], value, err_msg=name)
    tables = [(tmp_path / folder / "scans.csv").read_text() for folder in ("whole", "parts")]
    assert tables[0] == tables[1]
    assert len(tables[0].splitlines()) == 4
    run("parts", "--trees", "3", "--keep-scans")
    assert not made


def test_files_of_other_features_and_empty_folders_are_refused(tmp_path):
    with pytest.raises(SystemExit, match="there are no files"):
        load_set(tmp_path)
    samples = make_samples(Boxes(), 1, 1, seed=3)
    save_set(tmp_path / "a.npz", samples, NAMES)
    save_set(tmp_path / "b.npz", samples, NAMES[::-1])
    with pytest.raises(SystemExit, match="different features"):
        load_set(tmp_path)


# ---------------------------------------------------------------- grown trees


def test_heights_within_a_species_differ_more_than_threefold():
    rng = np.random.default_rng(0)
    preset = find_preset("F6a")
    for variety in (ANY, CITY):
        drawn = [draw_traits(preset, rng, variety) for _ in range(300)]
        size = [float(traits["internodes"]) * float(traits["age"]) for traits in drawn]
        assert np.quantile(size, 0.99) > 3.0 * np.quantile(size, 0.01)
    places = [draw_traits(preset, rng)["place"] for _ in range(200)]
    assert set(places) == {"open", "stand", "wall"}


def test_pruned_trunks_are_bare_below_and_as_they_were_above():
    preset = find_preset("F6b")
    traits = {"age": 9.0, "internodes": 1.0, "own": 0.0, "place": "open", "pruned": 0.0}
    whole = grow(preset, traits, np.random.default_rng(1)).trees[0]
    cut = pruned(whole, 0.4)
    order, parent, z = gravelius_order(cut.tree), cut.tree.parent, cut.tree.position[:, 2]
    leaves_trunk = (parent >= 0) & (order == 1) & (order[np.maximum(parent, 0)] == 0)
    assert z[parent[leaves_trunk]].min() >= 0.4 * z.max() - 1e-9
    assert 1 < cut.tree.n_nodes < whole.tree.n_nodes
    assert cut.height == whole.height
    assert pruned(whole, 0.0).tree.n_nodes == whole.tree.n_nodes


def test_a_preset_stands_bare_in_winter():
    preset, young = find_preset("F6a"), Variety(ages=(0.5, 0.5))
    winter = replace(young, seasons=(("winter", 1.0),))
    bare = PresetSource(preset, winter).make(np.random.default_rng(0))
    assert bare.leaves is None
    assert bare.traits["season"] == "bare"
    summer = replace(young, seasons=(("summer", 1.0),))
    assert len(PresetSource(preset, summer).make(np.random.default_rng(0)).leaves.faces) > 0


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_a_tree_beside_a_wall_is_one_sided(seed):
    off = []
    for place in ("open", "wall"):
        traits = {"age": 6.0, "internodes": 1.0, "own": 0.0, "place": place, "pruned": 0.0}
        graph = grow(find_preset("F6a"), traits, np.random.default_rng(seed)).trees[0].tree
        off.append(float(np.hypot(*graph.position[:, :2].mean(axis=0))))
        assert traits["place"] == place
    assert off[1] > 1.5 * off[0]


def test_a_place_that_leaves_no_leaves_is_taken_back():
    """Here the wall would kill the tree: it stands in the open, and its traits say so."""
    traits = {"age": 6.0, "internodes": 1.0, "own": 0.0, "place": "wall", "pruned": 0.0}
    beside = grow(find_preset("F6a"), traits, np.random.default_rng(3)).trees[0].tree
    assert traits["place"] == "open"
    free = grow(find_preset("F6a"), {**traits}, np.random.default_rng(3)).trees[0].tree
    assert beside.n_nodes == free.n_nodes
