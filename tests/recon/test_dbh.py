import re

import numpy as np
import pytest
from synthetic import tube

from recon import EncodeSettings, encode_with_report, encoding
from recon.dbh import BreastHeight, breast_height, hold_breast_height
from recon.skeleton import Skeleton


def report(xyz, **settings):
    return encode_with_report(xyz, settings=EncodeSettings(f_s=1.0, **settings)).report


@pytest.mark.parametrize("lean", [0.0, 0.15, 0.4])
def test_diameter_of_a_clean_trunk(rng, lean):
    xyz = tube((0, 0, 0), (lean * 3, 0, 3), 0.16, 0.14, 8000, rng, noise=0.003)
    got = report(xyz)
    along = 1.3 * np.hypot(1, lean) / (3 * np.hypot(1, lean))
    assert got.dbh_m == pytest.approx(2 * (0.16 - 0.02 * along), rel=0.02)
    assert got.dbh_method == "circle" and got.dbh_reason is None
    assert got.dbh_arc > 0.95


def test_half_a_trunk_is_enough(rng):
    xyz = tube((0, 0, 0), (0, 0, 3), 0.15, 0.15, 8000, rng, arc=0.55, noise=0.002)
    got = report(xyz)
    assert got.dbh_m == pytest.approx(0.30, rel=0.04)
    assert got.dbh_arc == pytest.approx(0.55, abs=0.08)


def test_a_branch_beside_the_slice_is_left_out(rng):
    trunk = tube((0, 0, 0), (0, 0, 3), 0.15, 0.14, 8000, rng, noise=0.002)
    branch = tube((0, 0, 1.1), (0.7, 0, 1.7), 0.03, 0.02, 800, rng, noise=0.002)
    got = report(np.concatenate([trunk, branch]))
    assert got.dbh_m == pytest.approx(0.291, rel=0.03)


def test_a_gap_at_breast_height_is_said(rng):
    trunk = tube((0, 0, 0), (0, 0, 3), 0.12, 0.12, 8000, rng, noise=0.002)
    got = report(trunk[(trunk[:, 2] < 1.1) | (trunk[:, 2] > 1.5)])
    assert got.dbh_method == "tube"
    assert got.dbh_m == pytest.approx(0.24, rel=0.05)
    assert got.dbh_reason == "only 0 points on the trunk between 1.2 and 1.4 m"


@pytest.mark.parametrize("diameter", [0.20, 0.40])
def test_the_trunk_agrees_with_the_circle(rng, monkeypatch, diameter):
    found = BreastHeight(diameter, "circle", None, 1.0)
    monkeypatch.setattr(encoding, "breast_height", lambda *of: found)
    xyz = tube((0, 0, 0), (0, 0, 3), 0.16, 0.13, 8000, rng, noise=0.003)
    graph = encode_with_report(xyz, settings=EncodeSettings(f_s=1.0)).tree.graph
    low = graph.position[:, 2] < 1.3
    assert graph.radius[low].min() >= diameter / 2 >= graph.radius[~low].max()


def test_a_low_shrub_has_none(rng):
    got = report(tube((0, 0, 0), (0, 0, 1.0), 0.02, 0.01, 2000, rng, noise=0.001))
    assert got.dbh_m is None and got.dbh_method == "none"
    assert got.dbh_reason == "the stem does not reach 1.3 m above its foot"


@pytest.mark.parametrize(
    "diameter, method, wanted",
    [
        (0.16, "circle", [0.10, 0.10, 0.08, 0.05, 0.08]),
        (0.24, "circle", [0.12, 0.12, 0.10, 0.05, 0.09]),
        (0.16, "tube", [0.10, 0.10, 0.10, 0.05, 0.09]),
        (None, "none", [0.10, 0.10, 0.10, 0.05, 0.09]),
    ],
)
def test_radii_agree_with_the_circle(diameter, method, wanted):
    position = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 5], [1, 0, 2.2]])
    radius = np.array([0.10, 0.10, 0.10, 0.05, 0.09])
    label = np.arange(5, dtype=np.int32)
    parent = np.array([-1, 0, 1, 2, 2], np.int32)
    tree = Skeleton(parent, position, radius, label, label, np.ones(5, bool), np.ones(5), 0.05, 0.01)
    held = hold_breast_height(tree, radius, BreastHeight(diameter, method, None, 1.0))
    np.testing.assert_allclose(held, wanted)


def at_breast_height(xyz, *, height=10.0, measured=True, has_stem=True):
    """Of points around a trunk of 0.15 m radius on the z axis."""
    position = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, height]])
    parent, label = np.array([-1, 0, 1, 2], np.int32), np.zeros(len(xyz), np.int32)
    radius, is_tube = np.full(4, 0.15), np.ones(4, bool)
    tree = Skeleton(parent, position, radius, label, label, is_tube, np.ones(4), 0.05, 0.01)
    return breast_height(xyz, tree, np.full(4, measured), has_stem)


def ring(rng, n=400, **options):
    return tube((0, 0, 1.2), (0, 0, 1.4), 0.15, 0.15, n, rng, **options)


def disc(rng, n):
    r, angle = 0.08 * np.sqrt(rng.random(n)), rng.random(n) * 2 * np.pi
    return np.stack([r * np.cos(angle), r * np.sin(angle), rng.uniform(1.2, 1.4, n)], axis=1)


@pytest.mark.parametrize(
    "points, reason",
    [
        (lambda rng: ring(rng, arc=0.3), r"points between 1.2 and 1.4 m on only \d+% of the trunk's round"),
        (
            lambda rng: ring(rng, noise=0.05),
            r"the points between 1.2 and 1.4 m scatter by \d+% of the radius",
        ),
        (
            lambda rng: np.concatenate([ring(rng), disc(rng, 120)]),
            r"2\d% of the points .* lie inside the trunk",
        ),
        (lambda rng: ring(rng, 9), "only 9 points on the trunk between 1.2 and 1.4 m"),
    ],
    ids=["arc", "scatter", "inside", "few"],
)
def test_no_circle_is_said_with_its_reason(rng, points, reason):
    assert at_breast_height(ring(rng)).method == "circle"
    got = at_breast_height(points(rng))
    assert got.method in ("tube", "none")
    assert re.search(reason, got.reason)


def test_the_fitted_trunk_counts_only_where_it_is_credible(rng):
    few = ring(rng, 5)
    assert at_breast_height(few).method == "tube"
    assert at_breast_height(few).diameter == pytest.approx(0.30)
    for doubt in ({"measured": False}, {"has_stem": False}, {"height": 3.0}):
        got = at_breast_height(few, **doubt)
        assert got.method == "none" and got.diameter is None and got.reason
