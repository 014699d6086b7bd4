"""The first synthetic truth test: grown, scanned, reconstructed."""

import numpy as np
import pytest

from benchmarks import grown_truth
from benchmarks.grown_truth import Case, diameter_at, measure, tips
from treegraph import TreeGraph


@pytest.fixture(scope="module")
def row():
    return measure(Case("F6e", 7, leaves=False), step_deg=0.12)


def test_a_bare_grown_tree_is_found(row):
    assert row["points"] > 10_000
    assert row["recall_3cm"] > 0.95
    assert row["precision_3cm"] > 0.85
    assert row["radius_error"] < 0.2
    assert row["volume_L"] == pytest.approx(row["true_volume_L"], rel=0.15)
    assert row["dbh_cm"] == pytest.approx(row["true_dbh_cm"], abs=0.5)
    assert row["clusters"] == 0


def test_boughs_of_a_leafy_tree_are_found():
    row = measure(Case("F6d", 12, leaves=True), step_deg=0.12)
    assert row["bough_recall_3cm"] > 0.5
    assert row["dbh_cm"] == pytest.approx(row["true_dbh_cm"], abs=0.5)
    assert row["clusters"] > 3


def test_tips_and_diameter():
    tree = TreeGraph(
        [-1, 0, 1, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 1, 1.5]], radius=[0.2, 0.15, 0.1, 0.02]
    )
    assert tips(tree) == 2
    assert diameter_at(tree) == pytest.approx(0.2)
    assert np.isnan(diameter_at(tree, 3.0))


def test_cases_have_names_of_their_own():
    names = [case.name for case in grown_truth.CASES]
    assert len(set(names)) == len(names)
