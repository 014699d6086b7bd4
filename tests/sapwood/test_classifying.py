"""The features of a reconstruction, and that it does not matter where on the map the tree stands."""

import numpy as np
import numpy.testing as npt
import pytest
from sapwood_scans import tree_points

import sapwood
from classify import describe_scan


@pytest.fixture(scope="module")
def binary_points():
    """Coordinates of a power of two as their last digit: they can be moved without rounding."""
    return np.round(tree_points(foot=(3.0, 2.0, 1.0)) * 2**12) / 2**12


@pytest.fixture(scope="module")
def features(binary_points):
    return sapwood.features_of(sapwood.reconstruct(binary_points, species=None))


def test_they_describe_the_tree_that_was_scanned(features):
    top = tree_points()[:, 2].max()
    assert top - 0.8 < features["height"] <= top + 0.05
    assert features["breast_width"] == pytest.approx(0.3 * (1 - 0.6 * 1.3 / 8), rel=0.1)
    assert features["cluster_number"] > 0
    assert features["n_leaders_15"] == 1.0
    assert np.isfinite(features.array).mean() > 0.95


def test_they_are_those_of_its_cloud_and_its_tree(binary_points, features):
    made = sapwood.reconstruct(binary_points, species=None)
    assert features.array.tobytes() == describe_scan(made.cloud.xyz, made.tree).array.tobytes()


def test_map_coordinates_mean_nothing(binary_points, features):
    far = binary_points + np.array([455_000.0, 5_428_000.0, 231.0])
    moved = sapwood.features_of(sapwood.reconstruct(far, species=None))
    npt.assert_array_equal(moved.array, features.array)


def test_the_order_of_the_points_means_nothing(binary_points, features):
    mixed = np.random.default_rng(0).permutation(binary_points)
    moved = sapwood.features_of(sapwood.reconstruct(mixed, species=None))
    npt.assert_allclose(moved.array, features.array, rtol=1e-9, atol=1e-9)
