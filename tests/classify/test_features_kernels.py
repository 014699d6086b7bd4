"""The compiled loops of the features against slow and obvious references."""

from itertools import combinations, product

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classify import _feature_kernels as kernels
from classify._feature import divided, effective_boxes, mean_of, quantiles_of, ratio_of, shares_of, spread_of
from classify._thinned import make_grid
from tests.classify.feature_clouds import box_cluster

ZERO = np.zeros(3)


def cells_of(cloud, edge):
    """Rows of the cloud in each cell, by the cell's place."""
    found = {}
    for row, place in enumerate(np.floor(cloud / edge).astype(int)):
        found.setdefault(tuple(place), []).append(row)
    return found


def small_cloud(seed=0, n=400, size=(3.0, 2.0, 4.0)):
    return np.random.default_rng(seed).random((n, 3)) * size - [1.0, 1.0, 0.5]


# ---------------------------------------------------------------- cells


@given(seed=st.integers(0, 10**6), n=st.integers(1, 300), edge=st.floats(0.05, 3.0))
@settings(deadline=None, max_examples=50)
def test_a_grid_has_the_means_and_counts_of_its_cells(seed, n, edge):
    cloud = small_cloud(seed, n)
    anchor = np.random.default_rng(seed).normal(size=3)
    grid = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), edge, anchor)
    expected = cells_of(cloud - anchor, edge)
    places = [tuple(place) for place in grid.cell]
    assert places == sorted(expected)
    assert grid.count.tolist() == [len(expected[place]) for place in places]
    means = np.array([cloud[expected[place]].mean(axis=0) for place in places])
    npt.assert_allclose(grid.xyz, means, atol=edge * 1e-4)


def test_a_grid_of_many_cells_loses_none():
    """The table grows several times on the way."""
    cloud = np.stack(np.meshgrid(*[np.arange(40) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = make_grid(cloud, np.zeros(3), np.full(3, 40.0), 1.0, ZERO)
    assert len(grid.xyz) == 40**3
    npt.assert_allclose(grid.xyz, cloud, atol=1e-4)
    assert len(np.unique(grid.rank)) == 40**3


def test_points_outside_are_left_out():
    cloud = np.array([[0.5, 0.5, 0.5], [9.0, 0.5, 0.5], [0.5, -3.0, 0.5]])
    grid = make_grid(cloud, np.zeros(3), np.ones(3), 0.4, ZERO)
    assert grid.count.sum() == 1


def test_a_cell_keeps_its_rank_in_any_scan():
    cloud = small_cloud(1, 500)
    whole = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), 0.5, ZERO)
    part = cloud[cloud[:, 0] > 0.3]
    half = make_grid(part, part.min(axis=0), part.max(axis=0), 0.5, ZERO)
    known = {tuple(place): rank for place, rank in zip(np.floor(whole.xyz / 0.5), whole.rank, strict=True)}
    for place, rank in zip(np.floor(half.xyz / 0.5), half.rank, strict=True):
        assert known[tuple(place)] == rank


@pytest.mark.parametrize("most", [1, 300, 10_000])
def test_of_too_many_cells_those_of_lowest_rank_are_kept(most):
    cloud = small_cloud(5, 3000)
    whole = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), 0.2, ZERO)
    part = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), 0.2, ZERO, most)
    keep = np.isin(whole.rank, np.sort(whole.rank)[:most])
    assert keep.sum() == min(most, len(whole.rank)) and 300 < len(whole.rank) < 10_000
    npt.assert_array_equal(part.cell, whole.cell[keep])
    npt.assert_array_equal(part.xyz, whole.xyz[keep])
    npt.assert_array_equal(part.count, whole.count[keep])


@pytest.mark.parametrize("most", [1, 700, 5000, 30_000])
def test_cells_are_forgotten_and_kept_in_any_order_of_the_points(most):
    cloud = np.repeat(small_cloud(6, 40_000), 2, axis=0)
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    whole = make_grid(cloud, low, high, 0.03, ZERO)
    assert len(whole.rank) > 30_000
    keep = np.isin(whole.rank, np.sort(whole.rank)[:most])
    for points in (cloud, cloud[::-1], np.random.default_rng(7).permutation(cloud)):
        part = make_grid(points, low, high, 0.03, ZERO, most)
        npt.assert_array_equal(part.cell, whole.cell[keep])
        npt.assert_array_equal(part.xyz, whole.xyz[keep])
        npt.assert_array_equal(part.count, whole.count[keep])


def test_coarse_cells_are_runs_of_fine_ones_with_room_between():
    cloud = small_cloud(2)
    grid = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), 0.25, ZERO)
    code, stride_x, stride_y = grid.coarse(4)
    place = grid.cell // 4
    steps = {dx * stride_x + dy * stride_y + dz for dx, dy, dz in product((-1, 0, 1), repeat=3)}
    for i in range(0, len(code), 7):
        for j in range(0, len(code), 5):
            apart = place[j] - place[i]
            near = np.abs(apart).max() <= 1
            step = code[j] - code[i]
            assert near == (step in steps)


# ---------------------------------------------------------------- neighbourhoods


def neighbourhoods(grid, ratio):
    """Code of each coarse cell, and the fine rows in it and the 26 around it."""
    code = grid.coarse(ratio)[0]
    place = {int(c): grid.cell[code == c][0] // ratio for c in np.unique(code)}
    rows = {c: np.flatnonzero(code == c) for c in place}
    return place, {
        c: np.concatenate([rows[d] for d in place if np.abs(place[c] - place[d]).max() <= 1]) for c in place
    }


def moments_of(xyz):
    squares = xyz.T @ xyz
    return [len(xyz), *xyz.sum(axis=0), *squares[np.triu_indices(3)]]


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("ratio", [1, 2, 3])
def test_neighbour_sums_are_those_of_27_cells(ratio, step):
    cloud = small_cloud(3, 150)
    grid = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), 0.4, ZERO)
    code, stride_x, stride_y = grid.coarse(ratio)
    cell, own, cell_of = kernels.cell_moments(grid.xyz, np.argsort(code, kind="stable"), code)
    pick = np.arange(0, len(cell), step)
    around = kernels.neighbour_sums(cell, own, stride_x, stride_y, pick)
    place, near = neighbourhoods(grid, ratio)
    assert cell.tolist() == sorted(place)
    npt.assert_array_equal(cell[cell_of], code)
    expected = [moments_of(grid.xyz[near[c]]) for c in cell[pick].tolist()]
    npt.assert_allclose(around, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("k, parts, step", [(3, 1, 1), (5, 2, 2), (8, 3, 1)])
def test_samples_are_the_lowest_ranks_around(k, parts, step):
    cloud = small_cloud(4, 200)
    grid = make_grid(cloud, cloud.min(axis=0), cloud.max(axis=0), 0.3, ZERO)
    code, stride_x, stride_y = grid.coarse(2)
    order = grid.by_rank[np.argsort(code[grid.by_rank], kind="stable")]
    cell, _, cell_of = kernels.cell_moments(grid.xyz, order, code)
    first = np.concatenate([[0], np.cumsum(np.bincount(cell_of))])
    pick = np.arange(0, len(cell), step)
    got = kernels.sample_moments(grid.xyz, grid.rank, order, cell, first, stride_x, stride_y, k, parts, pick)
    _, near = neighbourhoods(grid, 2)
    for row, c in enumerate(cell[pick].tolist()):
        ranked = sorted(near[c], key=lambda r: grid.rank[r])
        for part in range(parts):
            mine = ranked[part * k : (part + 1) * k]
            if len(mine) == k:
                npt.assert_allclose(got[row, part], moments_of(grid.xyz[mine]), rtol=1e-9, atol=1e-9)
            else:
                assert not got[row, part].any()


@given(seed=st.integers(0, 10**6), n=st.integers(4, 60), flat=st.floats(0.0, 1.0), thin=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=80)
def test_shapes_are_those_of_the_eigenvalues(seed, n, flat, thin):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    xyz = rng.normal(size=(n, 3)) * [1.0, flat, flat * thin] @ turn + rng.normal(size=3)
    got = kernels.shapes(np.array([moments_of(xyz)], float), 4.0)[0]
    value, vector = np.linalg.eigh(np.cov(xyz.T, bias=True))
    l3, l2, l1 = np.maximum(value, 0.0)
    npt.assert_allclose(got[1:4], [(l1 - l2) / l1, (l2 - l3) / l1, l3 / l1], atol=2e-6)
    assert got[4] == pytest.approx(np.sqrt(l1 + l2 + l3), rel=1e-6)
    if l1 - l2 > 1e-3 * l1:
        assert abs(got[5:8] @ vector[:, 2]) == pytest.approx(1.0, abs=1e-6)
    if l2 - l3 > 1e-3 * l1:
        assert abs(got[8:11] @ vector[:, 0]) == pytest.approx(1.0, abs=1e-6)


def test_shapes_of_lines_planes_and_lattices():
    line = np.arange(9.0)[:, None] * [1.0, 0.0, 0.0]
    plane = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0), [2.0]), axis=-1).reshape(-1, 3)
    lattice = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), axis=-1).reshape(-1, 3)
    got = kernels.shapes(np.array([moments_of(x) for x in (line, plane, lattice)], float), 4.0)
    npt.assert_allclose(got[:, 1:4], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], atol=1e-7)
    npt.assert_allclose(np.abs(got[0, 5:8]), [1, 0, 0], atol=1e-7)
    npt.assert_allclose(np.abs(got[1, 8:11]), [0, 0, 1], atol=1e-7)
    assert np.isnan(got[2, 5:]).all()  # a lattice has no axes
    assert np.isnan(got[1, 5:8]).all()  # nor a square a longest one


def test_too_few_points_have_no_shape():
    moments = np.array([moments_of(small_cloud(5, 3)), moments_of(np.ones((7, 3)))], float)
    assert np.isnan(kernels.shapes(moments, 4.0)[:, 1:]).all()


# ---------------------------------------------------------------- statistics


@pytest.mark.parametrize("count", [[3, 1], [4, 2, 1, 1], [2, 2, 2], [5], [7, 0, 3]])
def test_effective_boxes_are_the_inverse_of_the_chance_that_two_share_one(count):
    things = np.repeat(np.arange(len(count)), count)
    draws = [a == b for a, b in combinations(things, 2)]
    assert effective_boxes(np.array(count)) == pytest.approx(1.0 / np.mean(draws), rel=1e-12)


def test_no_pairs_no_effective_boxes():
    assert np.isnan(effective_boxes(np.array([1, 1, 0])))
    assert np.isnan(effective_boxes(np.zeros(0, np.int64)))


def test_effective_boxes_do_not_change_when_things_are_lost_at_random():
    """What counting the filled boxes does not give."""
    rng = np.random.default_rng(0)
    box = rng.geometric(0.01, 20_000)
    part = box[rng.random(box.size) < 1 / 3]
    whole, thinned = (effective_boxes(np.bincount(b)) for b in (box, part))
    assert thinned == pytest.approx(whole, rel=0.05)
    assert np.count_nonzero(np.bincount(part)) < 0.95 * np.count_nonzero(np.bincount(box))


def test_weighted_statistics():
    value, weight = np.array([1.0, 2.0, np.nan, 6.0]), np.array([1.0, 1.0, 9.0, 2.0])
    assert mean_of(value) == 3.0
    assert mean_of(value, weight) == 3.75
    assert spread_of(value) == pytest.approx(np.std([1, 2, 6]))
    assert spread_of(value, weight) == pytest.approx(np.std([1, 2, 6, 6]))
    assert np.isnan([mean_of(np.array([np.nan])), spread_of(np.zeros(0)), mean_of(value, 0.0 * weight)]).all()


def test_ratios_without_an_end_are_unknown():
    assert ratio_of(1.0, 4.0) == 0.25
    assert np.isnan(
        [ratio_of(1.0, 0.0), ratio_of(np.nan, 1.0), ratio_of(np.inf, 1.0), ratio_of(1.0, np.nan)]
    ).all()
    npt.assert_array_equal(
        divided(np.array([1.0, 0.0, 3.0]), np.array([2.0, 0.0, 0.0])), [0.5, np.nan, np.nan]
    )
    assert float(divided(1.0, 2.0)) == 0.5


def test_quantiles_and_shares():
    value = np.array([4.0, 1.0, np.nan, 3.0, 2.0])
    npt.assert_allclose(quantiles_of(value, (0.0, 0.5, 1.0)), [1.0, 2.5, 4.0])
    npt.assert_allclose(quantiles_of(value, (0.5,), np.array([1.0, 1.0, 5.0, 1.0, 1.0])), [2.5])
    heavy = quantiles_of(value, (0.5,), np.array([100.0, 1.0, 5.0, 1.0, 1.0]))
    assert 3.9 < heavy[0] <= 4.0
    assert np.isnan(quantiles_of(np.array([np.nan]), (0.5,))).all()
    npt.assert_allclose(shares_of(np.array([0, 2, 2]), 4), [1 / 3, 0.0, 2 / 3, 0.0])
    npt.assert_allclose(shares_of(np.array([0, 2]), 3, np.array([1.0, 3.0])), [0.25, 0.0, 0.75])
    assert np.isnan(shares_of(np.zeros(0, np.int64), 2)).all()


# ---------------------------------------------------------------- hulls


def test_measures_of_boxes():
    boxes = [box_cluster((0, 0, 1), (2, 3, 5)), box_cluster((-1, 4, 0), (4, 6, 1))]
    first = np.array([0, 8, 16])
    table = kernels.hull_table(
        np.concatenate([b.vertices for b in boxes]),
        np.concatenate([boxes[0].faces, boxes[1].faces + 8]),
        first,
        np.array([0, 12, 24]),
    )
    npt.assert_allclose(table[0], [24.0, 2 * (6 + 8 + 12), 1.0, 5.0, 3.0, 2.0, 1.0, 1.5, 3.0], rtol=1e-12)
    npt.assert_allclose(table[1], [10.0, 2 * (10 + 5 + 2), 0.0, 1.0, 5.0, 2.0, 1.5, 5.0, 0.5], rtol=1e-12)


def test_a_hull_without_vertices_is_unknown():
    table = kernels.hull_table(
        np.zeros((0, 3)), np.zeros((0, 3), np.int32), np.array([0, 0]), np.array([0, 0])
    )
    assert np.isnan(table).all()
