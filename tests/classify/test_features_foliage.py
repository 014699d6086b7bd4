"""Shapes at the size of leaves and twigs: blades and sticks whose size and slope are known."""

import numpy as np
import pytest

from classify._foliage import FEATURES, PLACES, SCALES, describe_foliage
from classify._local import find_shapes
from classify._thinned import view_cloud
from tests.classify.feature_clouds import pole

UNKNOWN = {feature.name for feature in FEATURES}


def crown(rng, n, make):
    """`n` leaves in a ball of 2 m on a pole of 4 m; `make` draws the points of one around the origin."""
    middle = rng.normal(size=(n, 3))
    middle *= (rng.random(n) ** (1 / 3) / np.linalg.norm(middle, axis=1))[:, None] * 2.0
    leaves = [at + [0.0, 0.0, 5.0] + make(rng) for at in middle]
    return np.concatenate([*leaves, pole(rng, 1000, 4.0, 0.1)])


def blade(size, tilt, points=60):
    """A square blade, its normal `tilt` off the vertical in a random direction."""

    def make(rng):
        flat = np.zeros((points, 3))
        flat[:, :2] = (rng.random((points, 2)) - 0.5) * size
        c, s = np.cos(tilt), np.sin(tilt)
        lying = flat @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        c, s = np.cos(angle := rng.random() * 2.0 * np.pi), np.sin(angle)
        return lying @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    return make


def stick(rng):
    """An upright stick of 30 cm."""
    return np.linspace([0.0, 0.0, -0.15], [0.0, 0.0, 0.15], 40)


def described(cloud):
    return describe_foliage(view_cloud(cloud))


@pytest.fixture(scope="module")
def small_and_large():
    """Blades of 5 and of 20 cm."""
    rng = np.random.default_rng(0)
    return described(crown(rng, 4000, blade(0.05, 0.6, 20))), described(
        crown(rng, 150, blade(0.20, 0.6, 320))
    )


def test_large_blades_are_flat_farther_around_than_small_ones(small_and_large):
    small, large = small_and_large
    assert large["planarity_7cm_crown"] > 0.3
    assert large["scattering_5cm_crown"] < 0.01
    assert large["scattering_12cm_crown"] < 0.02 < small["scattering_12cm_crown"]
    assert small["scattering_22cm_crown"] > 2.0 * large["scattering_22cm_crown"]


@pytest.mark.parametrize("tilt", [0.2, 0.8, 1.3])
def test_the_slope_of_normals_is_that_of_the_blades(tilt):
    cloud = crown(np.random.default_rng(1), 150, blade(0.2, tilt, 400))
    found = described(cloud)
    assert found["normal_tilt_5cm_50"] == pytest.approx(np.cos(tilt), abs=0.05)
    assert found["normal_tilt_5cm_25"] <= found["normal_tilt_5cm_50"] <= found["normal_tilt_5cm_75"]


def test_upright_sticks_are_long_and_upright():
    found = described(crown(np.random.default_rng(2), 300, stick))
    assert found["linearity_7cm_crown"] > 0.9
    assert found["axis_tilt_7cm_10"] > 0.95
    assert found["scattering_7cm_crown"] < 0.05


def test_a_coarse_scan_says_nothing_of_leaves():
    """A point every 30 cm or so."""
    cloud = np.random.default_rng(3).normal(size=(800, 3)) + [0.0, 0.0, 5.0]
    found = described(cloud)
    assert set(found) == UNKNOWN
    assert np.isnan([value for name, value in found.items() if "5cm" in name]).all()


def test_a_third_of_the_points_changes_little(small_and_large):
    rng = np.random.default_rng(4)
    cloud = crown(rng, 150, blade(0.20, 0.6, 320))
    before = np.array(list(described(cloud).values()))
    after = np.array(list(described(cloud[rng.random(len(cloud)) < 1 / 3]).values()))
    other = np.array(list(small_and_large[0].values()))
    known = np.isfinite(before) & np.isfinite(after)
    off = np.abs(after - before)[known] <= 0.1 * np.fmax(np.abs(after), np.abs(before))[known]
    assert known.mean() > 0.8
    assert off.mean() > 0.6
    apart = np.abs(other - before)[known] > 0.1 * np.fmax(np.abs(other), np.abs(before))[known]
    assert apart.mean() > 0.5


def test_some_places_are_rows_of_all_places():
    """A draw changes which places are looked at, and nothing of what is seen there."""
    view = view_cloud(crown(np.random.default_rng(5), 400, blade(0.1, 0.6)))
    every, some = find_shapes(view.leaf, 3), find_shapes(view.leaf, 3, 500)
    assert len(some.place) == 500 < len(every.place)
    row = {tuple(place): k for k, place in enumerate(every.place)}
    rows = [row[tuple(place)] for place in some.place]
    assert rows == sorted(rows)
    for name in ("weight", "linearity", "planarity", "scattering", "extent", "axis", "normal"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[rows], err_msg=name)


def test_the_draw_of_places_hardly_matters(monkeypatch):
    from classify import _foliage

    view = view_cloud(crown(np.random.default_rng(6), 600, blade(0.1, 0.6)))
    whole = describe_foliage(view)
    monkeypatch.setattr(_foliage, "PLACES", 3000)
    part = describe_foliage(view)
    assert PLACES > 3000
    for scale in SCALES:
        for kind in ("linearity", "planarity", "scattering"):
            name = f"{kind}_{scale.name}_crown"
            assert part[name] == pytest.approx(whole[name], rel=0.1, abs=0.01), name
