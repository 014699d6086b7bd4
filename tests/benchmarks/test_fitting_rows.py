"""What the benchmarks of similarity and fitting set up and tell, on small trees."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import fitting, recovery, similarity


@pytest.fixture
def small(monkeypatch):
    """One small pair of trees, measured once."""
    for module in (similarity, fitting):
        monkeypatch.setattr(module, "SIZES", (("F6b", 7, (1, 2)),))
        monkeypatch.setattr(module, "PUBLISHED", ((298, 83.0),))
    monkeypatch.setattr(similarity, "REPEATS", 1)
    monkeypatch.setattr(fitting, "SPEED_ITERATIONS", 4)


def test_times_are_all_there(small):
    (row,) = similarity.by_size()
    for name in ("grow_ms", "describe_ms", "structure_ms", "compare_ms", "constrained_ms"):
        assert row[name] > 0.0
    assert (row["published_nodes"], row["published_per_s"]) == (298, 83.0)


def test_resampled_tree_is_near_itself_by_segments_only_with_joins(small):
    for row in similarity.resampled():
        assert row["structure"] < 0.01
        assert row["by_segments"] < 0.01
        assert row["by_segments_without_joins"] > 0.3


def test_both_ways_of_annealing_are_timed(small):
    (row,) = fitting.speed(1)
    assert row["lazy_per_cpu_s"] > 0.0
    assert row["lazy_compared"] <= row["full_compared"] <= 1.5


@pytest.mark.parametrize("where", [recovery.AROUND, recovery.ANYWHERE])
def test_known_trees_are_neither_bare_nor_huge_and_the_same_every_time(where):
    one, two = recovery.known_trees(2, where), recovery.known_trees(2, where)
    for (parameters, age, trees), (again, same_age, others) in zip(one, two, strict=True):
        assert (parameters, age) == (again, same_age)
        assert all(recovery.LEAST_NODES <= tree.n_nodes <= recovery.MOST_NODES for tree in trees)
        np.testing.assert_array_equal(trees[3].position, others[3].position)
    assert one[0][0] != one[1][0]


def test_trees_of_the_true_parameters_are_within_their_own_spread():
    parameters, age, trees = recovery.known_trees(1)[0]
    fit = SimpleNamespace(parameters=parameters, age=age, tip_share=0.01)
    among, between = recovery.spread_of(parameters, age, trees, fit)
    assert (len(among), len(between)) == (28, 64)
    assert np.mean(between) <= np.quantile(among, 0.95)
    far = SimpleNamespace(parameters=parameters.replace(IBL=0.05), age=3, tip_share=0.01)
    assert np.mean(recovery.spread_of(parameters, age, trees, far)[1]) > np.quantile(among, 0.95)


def test_rows_of_recovery(monkeypatch, capsys):
    monkeypatch.setattr(recovery, "BROTHERS", 3)
    monkeypatch.setattr(recovery, "MOST_NODES", 150)
    rows, parameters = recovery.found_again(2, recovery.AROUND, 60)
    assert [row["tree"] for row in rows] == [0, 1]
    for row in rows:
        assert row["within"] == (row["fitted_to_true"] <= row["among_true_95"])
    assert len(parameters) == 25
    assert capsys.readouterr().err.count("around the presets, tree") == 2


def test_ranks_of_known_and_found_parameters():
    truth = np.arange(100.0).reshape(4, 25)
    found = truth.copy()
    found[:, 3] = -truth[:, 3]
    found[:, 5] = 1.0
    rows = {row["parameter"]: row["rank_correlation"] for row in recovery.identified(truth, found)}
    assert rows["AAV"] == rows["t"] == pytest.approx(1.0)
    assert rows["BAV"] == pytest.approx(-1.0)
    assert np.isnan(rows["RAV"])
