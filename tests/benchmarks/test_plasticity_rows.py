"""The published evaluation of plastic trees on few pairs: who is compared, and what the rows say."""

import numpy as np
import pytest

from benchmarks import plasticity
from benchmarks.plasticity import GROUPS, TYPES, TreeType

SMALL = TreeType("A", 0.25, 0.12, 6, 0.05, TYPES[0].published)


def test_a_row_has_every_group_and_both_tests():
    row = plasticity.evaluate(SMALL, pairs=3)
    assert all(row[group] >= 0.0 and row[f"{group} sd"] >= 0.0 for group in GROUPS)
    assert 0.0 <= row["p T-G, G-G"] <= 1.0
    assert 0.0 <= row["p T-O, T-T"] <= 1.0
    assert row["T-G published"] == 236.29
    assert row == plasticity.evaluate(SMALL, pairs=3)


def test_no_tree_is_used_twice(monkeypatch):
    seeds = []
    grow = plasticity.grow_one

    def noted(kind, seed, obstacle=None):
        seeds.append(seed)
        return grow(kind, seed, obstacle)

    monkeypatch.setattr(plasticity, "grow_one", noted)
    plasticity.measure_groups(SMALL, pairs=2)
    assert len(seeds) == len(set(seeds)) == 16


def test_sets_are_what_they_are_called():
    wall, kind = plasticity.make_obstacle(), TYPES[2]
    alone = plasticity.grow_one(kind, 4)
    beside, put = plasticity.grow_one(kind, 4, wall), plasticity.transform_one(kind, 4, wall)
    assert alone.position[:, 0].max() > plasticity.DISTANCE
    for tree in (beside, put):
        assert tree.position[:, 0].max() < plasticity.DISTANCE
        assert tree.n_nodes < alone.n_nodes
    assert len({tree.position.tobytes() for tree in (alone, beside, put)}) == 3


def test_groups_that_cannot_differ_do_not(monkeypatch):
    """Where no wall is near, T is O to the bit, and T-O is as T-T but for chance."""
    monkeypatch.setattr(plasticity, "DISTANCE", 2000.0)
    far = plasticity.make_obstacle()
    alone = plasticity.grow_one(SMALL, 5)
    np.testing.assert_array_equal(plasticity.transform_one(SMALL, 5, far).position, alone.position)
    assert plasticity.evaluate(SMALL, pairs=8)["p T-O, T-T"] > 0.001


@pytest.mark.slow
def test_the_published_result_holds_for_type_a():
    assert plasticity.evaluate(TYPES[0])["as published"]
