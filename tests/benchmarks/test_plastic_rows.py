"""The benchmark of plastic trees on small trees: every question gets its rows."""

from benchmarks import plastic

SMALL = ((7, (530, 216.3, 3.82)),)


def test_adaptation_beside_regrowth():
    rows = plastic.beside_regrowth(SMALL, repeats=1)
    assert [row["obstacle"] for row in rows] == ["fence", "house", "cliff"]
    for row in rows:
        assert 0 < row["adapted_nodes"] <= row["nodes"]
        assert row["times_faster"] == row["regrow_ms"] / row["adapt_ms"]
        assert row["with_tree_ms"] > 0.0
    assert round(rows[0]["published_times"]) == 57


def test_analysis_and_small_moves():
    (row,) = plastic.analysis(SMALL)
    assert row["nodes"] == plastic.grown_tree(7).graph.n_nodes
    rows = plastic.small_moves(7, moves=2)
    assert [row["step_mm"] for row in rows] == [1.0, 10.0, 100.0] * 2
    assert all(row["turned_nodes"] <= row["nodes"] for row in rows)


def test_trees_and_boxes():
    rows = plastic.box_through_trees(7, moves=3)
    assert {row["trees"] for row in rows} == {20}
    assert [row["trees_affected"] for row in plastic.trees_apart(7, n=20)] == [0, 1, 2, 5, 10, 20]
