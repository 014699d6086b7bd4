"""Thinning a stream: bounded, and the same however the points come."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.formats.chunks import Chunk
from recon.thinning import FINEST, Thinner, thin_rows, voxel_edges


@pytest.fixture(autouse=True)
def _thin_often(monkeypatch):
    monkeypatch.setattr("recon.thinning.SPARE_POINTS", 0)


def thin(xyz, max_points, blocks=1, label=None):
    thinner = Thinner(max_points)
    label = np.arange(len(xyz)) if label is None else label
    for part, mark in zip(np.array_split(xyz, blocks), np.array_split(label, blocks), strict=True):
        thinner.add(Chunk(part, {"tree": mark}))
    return thinner.result(), thinner


def slow_thin(xyz, max_points):
    """Every level in turn, voxels in a set: the first level that is coarse enough, and its voxels."""
    for level in range(200):
        cells = {tuple(cell) for cell in np.floor(xyz / voxel_edges(level)).astype(int)}
        if len(cells) <= max_points:
            return level, cells
    raise AssertionError


@pytest.mark.parametrize("max_points", [10, 137, 900])
def test_level_and_voxels_are_those_of_the_slow_search(rng, max_points):
    xyz = rng.normal(size=(1000, 3)) * [1, 2, 5]
    level, cells = slow_thin(xyz, max_points)
    found, keep = thin_rows(xyz, max_points)
    assert found == level
    kept = [tuple(cell) for cell in np.floor(xyz[keep] / voxel_edges(level)).astype(int)]
    assert len(kept) == len(set(kept)) == len(cells)
    assert set(kept) == cells


@given(blocks=st.integers(1, 40), max_points=st.integers(4, 600), seed=st.integers(0, 5))
def test_neither_blocks_nor_order_change_the_points(blocks, max_points, seed):
    rng = np.random.default_rng(seed)
    xyz = rng.normal(size=(500, 3)).round(2) * [1, 1, 4] + [4e5, 5e6, 100]
    whole, a = thin(xyz, max_points)
    parts, b = thin(xyz, max_points, blocks)
    npt.assert_array_equal(parts.xyz, whole.xyz)
    npt.assert_array_equal(parts.extra["tree"], whole.extra["tree"])
    assert a.voxel == b.voxel
    order = rng.permutation(500)
    turned, _ = thin(xyz[order], max_points, blocks)
    npt.assert_array_equal(np.unique(turned.xyz, axis=0), np.unique(whole.xyz, axis=0))


def test_few_points_stay_as_they_are(rng):
    xyz = rng.normal(size=(50, 3))
    chunk, thinner = thin(xyz, 50, blocks=7)
    npt.assert_array_equal(chunk.xyz, xyz)
    assert thinner.voxel == 0


def test_never_more_than_asked_for_and_labels_stay_with_their_points(rng):
    xyz = rng.uniform(size=(5000, 3))
    chunk, _ = thin(xyz, 700, blocks=20)
    assert 200 < len(chunk.xyz) <= 700
    npt.assert_array_equal(xyz[chunk.extra["tree"]], chunk.xyz)


def test_levels_are_nested():
    for level in range(9):
        ratio = voxel_edges(level + 1) / voxel_edges(level)
        assert sorted(ratio.tolist()) == [1, 1, 2]
    assert voxel_edges(0).tolist() == [FINEST] * 3
