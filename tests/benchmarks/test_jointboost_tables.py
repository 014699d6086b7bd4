"""Every table of the benchmark of joint boosting, on problems small enough for a test."""

import json
from argparse import Namespace

import pytest

from benchmarks import jointboost
from benchmarks.class_problems import mixed
from classify import BoostSettings, model


@pytest.fixture
def small(monkeypatch):
    def species(n_per_class, seed, spread):
        return mixed(max(6, n_per_class // 5), 4, 6, seed=seed, spread=spread)

    monkeypatch.setattr(jointboost, "N_CLASSES", 4)
    monkeypatch.setattr(jointboost, "N_FEATURES", 6)
    monkeypatch.setattr(jointboost, "TEST_PER_CLASS", 50)
    monkeypatch.setattr(jointboost, "LEFT_OUT", (0, 3))
    monkeypatch.setattr(jointboost, "species", species)
    monkeypatch.setattr("classify.SPECIES_SETTINGS", BoostSettings(n_rounds=10), raising=False)
    monkeypatch.setitem(model.train_model.__kwdefaults__, "settings", BoostSettings(n_rounds=10))


@pytest.mark.parametrize("name", [n for n in jointboost.TABLES if n not in ("sharing", "rivals")])
def test_table(name, small, capsys, tmp_path):
    path = tmp_path / "rows.json"
    jointboost.run(Namespace(only=name, full=False, json=path))
    rows = json.loads(path.read_text())[f"jointboost_{name}"]
    text = capsys.readouterr().out
    assert rows and all(key in text for key in rows[0])
    for row in rows:
        for key in ("accuracy, 12 x 50", "left out rejected", "junk rejected", "observed"):
            assert 0.0 <= row.get(key, 0.5) <= 1.0


@pytest.mark.parametrize("only", [None, ""])
def test_all_tables_unless_one_is_asked_for(only, monkeypatch, capsys):
    def table(name):
        def make(**_):
            """One row."""
            return [{"made": name}]

        return make

    monkeypatch.setattr(jointboost, "TABLES", {name: table(name) for name in jointboost.TABLES})
    jointboost.run(Namespace(only=only, full=False, json=None))
    text = capsys.readouterr().out
    assert all(f"| {name} " in text for name in jointboost.TABLES)


def test_sharing_needs_fewer_stumps(monkeypatch):
    monkeypatch.setattr(jointboost, "SHARED_CLASSES", (8,))
    for row in jointboost.sharing():
        assert row["stumps, shared"] < row["stumps, one-versus-rest"]
