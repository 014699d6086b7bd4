import numpy as np
import pytest
from synthetic import tube

from recon import EncodeSettings, encode_with_report


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


def test_a_low_shrub_has_none(rng):
    got = report(tube((0, 0, 0), (0, 0, 1.0), 0.02, 0.01, 2000, rng, noise=0.001))
    assert got.dbh_m is None and got.dbh_method == "none"
    assert got.dbh_reason == "the stem does not reach 1.3 m above its foot"
