"""The benchmark of the virtual scanner runs, and the scanner is near the bare ray caster."""

import numpy as np
import pytest

from benchmarks.scanning import make_leaves, make_sweep, measure


def test_it_runs_on_something_small():
    single, footprint = measure(n_faces=2000, n_rays=2500)
    assert (single["rays"], single["sub_rays"], footprint["sub_rays"]) == (2500, 1, 7)
    assert 0 < single["points"] <= 2500 and footprint["points"] > 0
    assert single["rays_ratio"] > 0 and footprint["whole_ratio"] > 0
    (alone,) = measure("single", 2000, 2500)
    assert alone["points"] == single["points"] and "bare_s" not in alone


def test_the_scene_is_what_it_says():
    vertices, faces = make_leaves(1000)
    assert len(faces) == 1000 and np.abs(vertices).max() < 5.1
    edge = vertices[faces[:, 1]] - vertices[faces[:, 0]]
    np.testing.assert_allclose(np.linalg.norm(edge[::2], axis=1), 0.06)
    sweep = make_sweep(10_000)
    assert sweep.n_rays == 10_000


@pytest.mark.slow
def test_a_million_rays_take_at_most_three_times_the_bare_call():
    for row in measure():
        assert row["rays_ratio"] < 3.0 and row["whole_ratio"] < 3.0, row
