"""D_T and its parts together."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from inverse_trees import grown, shuffled, trees, turned

from inverse import (
    GEOMETRIC_DESCRIPTORS,
    SHAPE_DESCRIPTORS,
    Weights,
    compare_trees,
    describe_tree,
    geometric_distance,
    shape_distance,
    structural_distance,
)
from treegraph import InputError, TreeGraph, resample


@given(trees, trees)
@settings(deadline=None, max_examples=30)
def test_the_parts_are_the_functions_of_their_own(a, b):
    got = compare_trees(a, b)
    assert got.shape == shape_distance(a, b)
    assert got.geometry == geometric_distance(a, b)
    assert got.structure == structural_distance(a, b)
    npt.assert_allclose(got.distance, (got.shape + got.geometry + got.structure) / 3.0)
    assert 0.0 <= got.distance <= 1.0
    assert list(got.shape_parts) == list(SHAPE_DESCRIPTORS)
    assert list(got.geometry_parts) == list(GEOMETRIC_DESCRIPTORS)
    back = compare_trees(b, a)
    npt.assert_allclose(back.distance, got.distance, atol=1e-12)


def test_the_same_tree():
    tree = grown("F6b", 9, 1)
    assert compare_trees(tree, tree).distance < 1e-12
    assert compare_trees(tree, shuffled(turned(tree, 2.0), np.random.default_rng(0))).distance < 1e-6
    assert compare_trees(tree, resample(tree, 0.1)).distance < 0.02


def test_brothers_are_nearer_than_strangers():
    one, brother, stranger = grown("F6b", 11, 1), grown("F6b", 11, 2), grown("F6d", 11, 1)
    near, far = compare_trees(one, brother), compare_trees(one, stranger)
    assert near.distance < far.distance
    assert near.geometry < far.geometry


def test_weights():
    a, b = grown("F6b", 9, 1), grown("F6b", 9, 2)
    got = compare_trees(a, b, weights=Weights(0.5, 0.3, 0.2))
    npt.assert_allclose(got.distance, 0.5 * got.shape + 0.3 * got.geometry + 0.2 * got.structure)
    assert compare_trees(a, b, weights=Weights(1.0, 0.0, 0.0)).distance == got.shape


@pytest.mark.parametrize("values", [(0.5, 0.5, 0.5), (1.5, -0.5, 0.0), (float("nan"), 0.5, 0.5)])
def test_bad_weights(values):
    with pytest.raises(InputError, match="weights must be three numbers from 0 to 1 that add up to 1, got"):
        Weights(*values)


def test_description_is_made_once():
    a, b = grown("F6b", 9, 1), grown("F6b", 9, 2)
    one = describe_tree(a)
    assert describe_tree(one) is one
    assert compare_trees(one, describe_tree(b)).distance == compare_trees(a, b).distance


def test_printed():
    pole = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 4]], [0.1, 0.1])
    assert repr(compare_trees(pole, pole)) == (
        "<Comparison 0.0000: shape 0.0000, geometry 0.0000, structure 0.0000>"
    )


def test_same_bytes_every_time():
    a, b = grown("F6b", 9, 1), grown("F6b", 9, 2)
    one, two = compare_trees(a, b), compare_trees(a, b)
    assert one.distance == two.distance
    npt.assert_array_equal(one.mapping.pair_of_a, two.mapping.pair_of_a)
