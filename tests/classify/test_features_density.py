"""How dense a scan is changes few features: real scans and a virtual one, whole and thinned, encoded anew.

A feature *holds* when it changes by at most 10% of its value, the larger of both. Spread is not taken into
account: a feature that is near 0 has to hold to 10% of that.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from classify.features import FEATURES, describe_scan
from recon import as_cloud, encode_with_report, read_cloud
from tests.classify.feature_clouds import turned, turned_tree

SAMPLES = Path(__file__).parent.parent.parent / "samples"
GROUP = np.array([feature.group for feature in FEATURES])
OF_POINTS = ~np.isin(GROUP, ["skeleton", "clusters"])


def described(points):
    made = encode_with_report(as_cloud(points))
    return describe_scan(made.cloud.xyz, made.tree).array


def held(a, b, within=0.10):
    """Share of features that hold, of those that are known in one of the two."""
    known = ~(np.isnan(a) & np.isnan(b))
    holds = np.abs(a - b) <= within * np.fmax(np.abs(a), np.abs(b))  # a comparison with NaN is false
    return float(holds[known].mean())


def sample(name):
    cloud = read_cloud(SAMPLES / name)
    return cloud.xyz + cloud.origin


def virtual_scan():
    """A grown tree with leaves as three stations see it."""
    from benchmarks.grown_truth import Case, grow_case, scan_case

    return scan_case(grow_case(Case("F6a", 7, leaves=True)), 1, step_deg=0.12)


CLOUDS = {
    "itsme_tls_tree2": lambda: sample("itsme_tls_tree2.laz"),
    "green_ash_wood": lambda: sample("green_ash_wood.laz"),
    "virtual": virtual_scan,
}


@cache
def scan_of(name):
    """Points, what they are encoded as, and their features."""
    points = CLOUDS[name]()
    made = encode_with_report(as_cloud(points))
    return points, made, describe_scan(made.cloud.xyz, made.tree).array


@pytest.fixture(params=CLOUDS)
def scan(request):
    return scan_of(request.param)


def test_most_features_hold_with_a_third_of_the_points(scan):
    points, _, whole = scan
    rng = np.random.default_rng(3)
    thinned = described(points[rng.random(len(points)) < 1 / 3])
    assert held(whole, thinned) > 0.65
    assert held(whole[OF_POINTS], thinned[OF_POINTS]) > 0.75
    for group in ("dimensions", "slabs", "radial profile", "inhomogeneity"):
        assert held(whole[group == GROUP], thinned[group == GROUP]) > 0.7, group


def test_most_features_hold_when_near_points_are_thinned_more(scan):
    """One point in each cell of 5 cm: what a farther scanner, or the user, makes of it."""
    points, _, whole = scan
    _, first = np.unique(np.floor(points / 0.05).astype(np.int64), axis=0, return_index=True)
    assert first.size < 0.6 * len(points)
    thinned = described(points[first])
    assert held(whole[OF_POINTS], thinned[OF_POINTS]) > 0.6


def test_another_tree_does_not_hold():
    """The measure itself can fail: two trees differ in nearly everything."""
    assert held(scan_of("itsme_tls_tree2")[2], scan_of("virtual")[2]) < 0.3


def test_turning_a_tree_changes_nearly_nothing(scan):
    """But for a few points that rounding moves into the next cell; to 1% here."""
    _, made, whole = scan
    after = describe_scan(turned(made.cloud.xyz, 1.1), turned_tree(made.tree, 1.1)).array
    assert held(whole, after, within=0.01) > 0.97


def test_turning_a_scan_changes_little(scan):
    """Prepared anew, the foot moves by some centimetres, and the skeleton is another one."""
    points, _, whole = scan
    after = described(turned(points - points.mean(axis=0), 1.1))
    assert held(whole, after) > 0.6
    assert held(whole[OF_POINTS], after[OF_POINTS]) > 0.95
