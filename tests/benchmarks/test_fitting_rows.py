"""What the benchmarks of similarity and fitting set up and tell, on small trees."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import fitting, similarity


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


def test_known_trees_are_neither_bare_nor_huge_and_the_same_every_time():
    one, two = fitting.known_trees(2), fitting.known_trees(2)
    for (parameters, age, trees), (again, same_age, others) in zip(one, two, strict=True):
        assert (parameters, age) == (again, same_age)
        assert all(fitting.LEAST_NODES <= tree.n_nodes <= fitting.MOST_NODES for tree in trees)
        np.testing.assert_array_equal(trees[3].position, others[3].position)
    assert one[0][0] != one[1][0]


def test_trees_of_the_true_parameters_are_within_their_own_spread():
    parameters, age, trees = fitting.known_trees(1)[0]
    fit = SimpleNamespace(parameters=parameters, age=age)
    among, between = fitting.spread_of(parameters, age, trees, fit)
    assert (len(among), len(between)) == (28, 64)
    assert np.mean(between) <= np.quantile(among, 0.95)
    far = SimpleNamespace(parameters=parameters.replace(IBL=0.05), age=3)
    assert np.mean(fitting.spread_of(parameters, age, trees, far)[1]) > np.quantile(among, 0.95)
