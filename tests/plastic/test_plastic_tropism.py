"""Tropism and inverse tropism (thesis, Eq. 4.6 to 4.10)."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plastic import Tropisms, invert_tropism, lean_of, tropism_direction
from plastic.tropism import LEAST_ALONG
from treegraph import InputError

UP = np.array([[0.0, 0.0, 1.0]])


def unit(rows):
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def some(seed, n=50):
    """Directions, lights and lengths by chance."""
    rng = np.random.default_rng(seed)
    return unit(rng.normal(size=(n, 3))), unit(rng.normal(size=(n, 3))), rng.uniform(0.0, 3.0, n)


def test_weight_falls_with_the_length():
    """w_s = (1 - sum w)^(l_s / l_i), Eq. 4.7: tree A of section 4.5.4 over one and two internodes."""
    keep, _ = lean_of(Tropisms(0.25, 0.12), np.repeat(UP, 3, axis=0), np.array([0.0, 0.2, 0.4]), 0.2)
    npt.assert_allclose(keep, [1.0, 0.63, 0.63**2], rtol=1e-12)


def test_tropisms_are_weighed():
    """t = (0.3 light + 0.1 up) / 0.4."""
    _, lean = lean_of(Tropisms(0.3, 0.1), np.array([[1.0, 0.0, 0.0]]), np.array([0.5]), 0.5)
    npt.assert_allclose(lean, 0.4 * np.array([[0.75, 0.0, 0.25]]), rtol=1e-12)


def test_negative_gravitropism_points_down():
    _, lean = lean_of(Tropisms(0.0, -0.5), UP, np.array([1.0]), 1.0)
    npt.assert_allclose(lean, [[0.0, 0.0, -0.5]], atol=1e-15)


def test_without_tropisms_nothing_bends():
    keep, lean = lean_of(Tropisms(0.0, 0.0), UP, np.array([1.0]), 1.0)
    assert keep.tolist() == [1.0]
    assert not lean.any()
    assert invert_tropism(UP, keep, lean).tolist() == UP.tolist()


def test_known_inverse():
    """h level, t_w = 0.6 up, w_s = 1: d_o = (0.8, 0, -0.6), the triangle of 3, 4 and 5."""
    rest = invert_tropism(np.array([[1.0, 0.0, 0.0]]), np.array([1.0]), np.array([[0.0, 0.0, 0.6]]))
    npt.assert_allclose(rest, [[0.8, 0.0, -0.6]], atol=1e-15)


def test_the_larger_solution_is_taken():
    """h = t, w_s = 1, t_w = 0.6: p = 1.6 or -0.4."""
    rest = invert_tropism(UP, np.array([1.0]), 0.6 * UP)
    npt.assert_allclose(rest, UP, atol=1e-15)


@given(st.integers(0, 2**31), st.floats(0.0, 0.3), st.floats(-0.3, 0.3))
@settings(deadline=None, max_examples=100)
def test_forward_after_inverse_is_the_same(seed, light, up):
    """Also where the line misses the sphere: d_o is then no unit vector, but h is h."""
    heading, toward, length = some(seed)
    keep, lean = lean_of(Tropisms(light, up), toward, length, 0.3)
    back = tropism_direction(invert_tropism(heading, keep, lean), lean)
    npt.assert_allclose(back, heading, atol=1e-12)


def test_d_o_is_a_unit_vector_where_there_is_a_solution():
    heading, toward, length = some(4, 500)
    keep, lean = lean_of(Tropisms(0.2, 0.1), toward, length, 0.5)
    rest = invert_tropism(heading, keep, lean)
    along = (heading * lean).sum(axis=1)
    root = along**2 - (lean**2).sum(axis=1) + keep**2
    p = along + np.sqrt(np.maximum(root, 0.0))
    solved = (root > 0.0) & (p > LEAST_ALONG * (1.0 - keep))
    assert 200 < solved.sum() < 500
    npt.assert_allclose(np.linalg.norm(rest[solved], axis=1), keep[solved], rtol=1e-12)
    missed = (root <= 0.0) & (along > LEAST_ALONG * (1.0 - keep))
    assert missed.sum() > 10
    # the closest point of the line to the sphere: d_o is across h
    npt.assert_allclose((rest * heading).sum(axis=1)[missed], 0.0, atol=1e-12)
    assert (np.linalg.norm(rest, axis=1)[missed] >= keep[missed]).all()


def test_against_a_strong_tropism_p_has_a_floor():
    """h straight against t: both solutions are behind the foot."""
    keep, lean = np.array([0.2]), np.array([[0.0, 0.0, -0.8]])
    rest = invert_tropism(UP, keep, lean)
    npt.assert_allclose(rest, [[0.0, 0.0, 0.5 * 0.8 + 0.8]], atol=1e-15)


def test_light_that_turns_turns_the_branch_towards_it():
    heading, toward, length = some(7, 200)
    length += 0.1
    strengths = Tropisms(0.2, 0.05)
    keep, lean = lean_of(strengths, toward, length, 0.5)
    rest = invert_tropism(heading, keep, lean)
    other = unit(toward + 0.3 * unit(np.random.default_rng(1).normal(size=(200, 3))))
    new = tropism_direction(rest, lean_of(strengths, other, length, 0.5)[1])
    change = ((new - heading) * (other - toward)).sum(axis=1)
    assert (change > 0.0).all()


@pytest.mark.parametrize(
    "light, up, match",
    [
        (-0.1, 0.0, "phototropism must be from 0 to below 1, got -0.1"),
        (1.0, 0.0, "phototropism must be from 0 to below 1, got 1.0"),
        (math.nan, 0.0, "phototropism must be from 0 to below 1, got nan"),
        (0.1, -1.0, "gravitropism must be above -1 and below 1, got -1.0"),
        (0.5, -0.5, "phototropism and gravitropism must be below 1 together, got 1.0"),
    ],
)
def test_bad_strengths(light, up, match):
    with pytest.raises(InputError, match=match):
        Tropisms(light, up)
