"""The fast model's search: what it leaves out changes nothing."""

import math

import numpy as np
import numpy.testing as npt
import pytest

from tests.treegraph.test_light_model import HERE, around, leafy, opaque
from treegraph import (
    Ball,
    Box,
    HalfSpace,
    Leaves,
    Occluders,
    Sky,
    gather_light,
    gather_light_exact,
    join_occluders,
    light,
    make_leaves,
)

ZENITH = Sky()
every_fineness = pytest.mark.parametrize("rings", [4, 5, 7, 10, 25, 64])


def every_cell(points, leaves, rings, own=None, sky=ZENITH):
    """The amount with every leaf sphere on every cell, in float64, by the formulas of the kernel."""
    cells, weight = light._sky_cells(rings), light._cell_weight(rings, sky)
    direction = np.column_stack(cells.grid[:3]).astype(float)
    sin_blur, cos_tent = math.sin(light.BLUR * cells.width), math.cos(light.TENT * cells.width)
    amount = np.empty(len(points))
    for q, point in enumerate(points):
        passed = np.ones(len(direction))
        for k, (center, radius, share) in enumerate(
            zip(leaves.center, leaves.radius, leaves.translucency, strict=True)
        ):
            if own is not None and own[q] == k:
                continue
            distance = np.linalg.norm(center - point)
            if distance <= radius:
                passed *= share
                continue
            sine = radius / distance
            cosine = math.sqrt(1 - sine**2)
            area, half = 1 - cosine, sine * sin_blur
            wide = half <= area
            edge = cosine - half if wide else min(1 - 2 * area, cos_tent)
            run = 2 * half if wide else 1 - edge
            top = (1 - share) * (1.0 if wide else 2 * area / run)
            along = direction @ (center - point) / distance
            passed *= 1 - np.clip((along - edge) * top / run, 0.0, top)
        amount[q] = weight[0] @ passed
    return amount


class TestTiles:
    @every_fineness
    def test_every_cell_stands_in_one_place(self, rings):
        cells = light._sky_cells(rings)
        there = cells.order >= 0
        npt.assert_array_equal(np.sort(cells.order[there]), np.arange(cells.per_ring.sum()))
        xyz = np.column_stack(cells.grid[:3])
        npt.assert_allclose(np.linalg.norm(xyz, axis=1), there, atol=1e-6)
        assert (light._cell_weight(rings, Sky())[0][~there] == 0.0).all()
        assert (xyz[there, 2] > 0.0).all()

    @every_fineness
    def test_four_tiles_are_quarter_turns_of_each_other(self, rings):
        x, y, z = (row.reshape(-1, 4, 16) for row in light._sky_cells(rings).grid[:3])
        for turn in range(3):
            npt.assert_allclose(x[:, turn + 1], -y[:, turn], atol=1e-6)
            npt.assert_allclose(y[:, turn + 1], x[:, turn], atol=1e-6)
            npt.assert_allclose(z[:, turn + 1], z[:, turn], atol=1e-6)

    @every_fineness
    def test_their_caps_hold_their_cells(self, rings):
        cells = light._sky_cells(rings)
        xyz = np.column_stack(cells.grid[:3]).reshape(-1, 4, 16, 3)[:, 0]
        rows = cells.grid[3].reshape(-1, 4)[: len(xyz)]
        cosine = np.cos(np.arctan(rows[:, 3]))
        npt.assert_allclose(np.linalg.norm(rows[:, :3], axis=1) * cosine, 1.0, atol=1e-5)
        inside = np.einsum("tcx,tx->tc", xyz, rows[:, :3]) >= 1.0 - 1e-6
        assert (inside | (np.abs(xyz).sum(axis=2) == 0.0)).all()
        if rings == light.DEFAULT_RINGS:  # compact: in a square of 4 x 4 cells it is 2.1 widths
            assert np.arccos(cosine).max() < 3.1 * cells.width


class TestNothingIsLost:
    @every_fineness
    @pytest.mark.parametrize("n_leaves", [1, 15, 128, 129, 400])
    def test_leaf_spheres(self, rings, n_leaves):
        """Search, sorting and what is left out below the horizon against every sphere on every cell."""
        rng = np.random.default_rng([rings, n_leaves])
        radius = rng.choice([0.03, 0.3, 2.0], n_leaves) * rng.uniform(0.5, 1.0, n_leaves)
        leaves = Leaves(around(rng, n_leaves), radius, rng.uniform(0.3, 1.0, n_leaves))
        points = around(rng, 8, -3.0)
        own = rng.integers(-1, n_leaves, 8)
        own[0] = n_leaves - 1
        fast = gather_light(points, Occluders(leaves), own=own, rings=rings).amount
        npt.assert_allclose(fast, every_cell(points, leaves, rings, own), atol=3e-6)

    @pytest.mark.parametrize("height", np.linspace(0.0, 4.0, 17))
    def test_spheres_near_the_horizon(self, height):
        """A ring of them that sinks below it: none is left out while its edge still shows."""
        angle = np.linspace(0, 7, 80)
        leaves = opaque(np.column_stack([20 * np.cos(angle), 20 * np.sin(angle), 0 * angle]), 0.5)
        points, sky = np.array([[0.0, 0.0, height], [9.0, 9.0, height]]), Sky((1.0, 0.2, 0.0))
        fast = gather_light(points, Occluders(leaves), sky).amount
        npt.assert_allclose(fast, every_cell(points, leaves, 10, sky=sky), atol=1e-6)

    @every_fineness
    def test_the_search_for_tiles(self, rings, monkeypatch):
        """Same bytes if each sphere and each branch works on all tiles."""
        rng = np.random.default_rng(rings)
        leaves = make_leaves(around(rng, 50), rng.uniform(0.02, 3.0, 50))
        scene = join_occluders(leafy(rng), Occluders(leaves))
        points = around(rng, 6)
        found = gather_light(points, scene, rings=rings)
        cells = light._sky_cells(rings)
        rows = cells.grid[3].reshape(-1, 4).copy()
        rows[: cells.grid[0].size // 64] = 0.0, 0.0, 0.0, 1e9
        whole = cells._replace(grid=(*cells.grid[:3], rows.ravel()))
        monkeypatch.setattr(light, "_sky_cells", lambda _: whole)
        everywhere = gather_light(points, scene, rings=rings)
        assert found.amount.tobytes() == everywhere.amount.tobytes()
        assert found.vector.tobytes() == everywhere.vector.tobytes()


class TestNumbers:
    def test_far_from_the_origin(self):
        """Coordinates of 1000 km do not make the light coarser."""
        rng = np.random.default_rng(1)
        center, radius, points = around(rng, 60), rng.uniform(0.02, 0.5, 60), around(rng, 5)
        shift = np.array([1e6, -1e6, 2e5])
        here = gather_light(points, Occluders(make_leaves(center, radius))).amount
        there = gather_light(points + shift, Occluders(make_leaves(center + shift, radius))).amount
        npt.assert_allclose(there, here, atol=3e-6)


class TestWorstObstacles:
    """Edges that run along the rings or through the middles of many cells at once."""

    @pytest.mark.parametrize("bearing", np.radians([0, 22.5, 45, 60, 90]))
    @pytest.mark.parametrize("tilt", [-0.035, -0.02, 0.0, 0.03])
    def test_half_space_past_the_zenith(self, bearing, tilt):
        """Across the edge the integral of cos^2 p, from -tilt to pi/2."""
        normal = np.array([math.cos(bearing), math.sin(bearing), math.tan(tilt)])
        low = -tilt
        seen = (math.pi / 4 - low / 2 - math.sin(2 * low) / 4) / (math.pi / 2)
        amount = gather_light([normal], Occluders(obstacles=[HalfSpace((0, 0, 0), normal)])).amount
        npt.assert_allclose(amount, seen, atol=0.009)

    @pytest.mark.parametrize("sine", np.linspace(0.02, 0.999, 40))
    def test_ball_in_the_zenith(self, sine):
        amount = gather_light(HERE, Occluders(obstacles=[Ball((0, 0, 1), sine)])).amount
        npt.assert_allclose(amount, (1 - sine**2) ** 1.5, atol=0.009)

    @pytest.mark.parametrize(
        "width, bound", [(0.15, 0.04), (0.34, 0.04), (0.7, light.AMOUNT_ERROR), (1.4, light.AMOUNT_ERROR)]
    )
    @pytest.mark.parametrize("bearing", [0.0, math.pi / 8, math.pi / 4])
    def test_beam_across_the_zenith(self, width, bound, bearing):
        """Thinner than a cell (0.16 rad) it may fall between the directions: outside the stated bound."""
        c, s = math.cos(bearing), math.sin(bearing)
        beam = Box((0, 0, 5), (200, width, 0.1), [[c, -s, 0], [s, c, 0], [0, 0, 1]])
        scene = Occluders(obstacles=[beam])
        exact = gather_light_exact(HERE, scene, order=(150, 310)).amount
        npt.assert_allclose(gather_light(HERE, scene).amount, exact, atol=bound)
