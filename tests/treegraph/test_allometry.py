"""Species parameters (thesis Table 3.1) and allometric radii (Eq. 3.1)."""

import dataclasses
import math
import pickle
import statistics

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corpus import TREES, make_tree, parents, random_rotation, rooted_parents
from tests.treegraph import reference
from treegraph import (
    DEFAULT_ALLOMETRY,
    SPECIES_ALLOMETRY,
    Allometry,
    InputError,
    TreeGraph,
    allometric_radii,
    find_allometry,
    transform,
)

TABLE_3_1 = """
Mahogany            1.7 1.3 0.975
Bischofia polycarpa 1.8 1.5 0.986
Delonix             1.7 1.5 0.982
Lagerstroemia       1.6 1.5 0.976
Ailanthus altissima 1.5 1.9 0.980
Palm                1.8 1.3 0.800
Terminalia          1.5 1.5 0.970
Pine                1.3 1.2 0.980
Willow              1.5 1.9 0.980
Ficus Virens        2.0 1.6 0.975
"""


class TestSpecies:
    def test_table_of_the_thesis(self):
        rows = {line[:20].strip(): line[20:].split() for line in TABLE_3_1.strip().splitlines()}
        assert list(SPECIES_ALLOMETRY) == list(rows)
        for name, (beta, gamma, f_s) in rows.items():
            known = SPECIES_ALLOMETRY[name]
            assert (known.beta, known.gamma, known.f_s) == (float(beta), float(gamma), float(f_s))
            assert math.isnan(known.d_root)

    @pytest.mark.parametrize("name", ["beta", "gamma", "f_s"])
    def test_default_is_the_median(self, name):
        median = statistics.median(getattr(a, name) for a in SPECIES_ALLOMETRY.values())
        assert getattr(DEFAULT_ALLOMETRY, name) == pytest.approx(median)

    @pytest.mark.parametrize("name", ["Ficus Virens", "ficus virens", " FICUS   virens\n"])
    def test_case_and_blanks_do_not_matter(self, name):
        assert find_allometry(name) is SPECIES_ALLOMETRY["Ficus Virens"]

    def test_none_is_the_default(self):
        assert find_allometry(None) is DEFAULT_ALLOMETRY

    @pytest.mark.parametrize("name", ["Oak", "", "Pin"])
    def test_unknown_species_lists_the_known(self, name):
        with pytest.raises(InputError, match=f"Ailanthus .*, Willow, got {name!r}; leave it out") as caught:
            find_allometry(name)
        assert all(known in str(caught.value) for known in SPECIES_ALLOMETRY)
        assert "\n" not in str(caught.value)


class TestParameters:
    @pytest.mark.parametrize(
        "changes, match",
        [
            ({"beta": 0.99}, "beta must be a finite number >= 1, got 0.99"),
            ({"beta": math.inf}, "beta must be a finite number >= 1, got inf"),
            ({"beta": math.nan}, "beta must be a finite number >= 1, got nan"),
            ({"gamma": 0.0}, "gamma must be a positive finite number, got 0.0"),
            ({"gamma": math.nan}, "gamma must be a positive finite number, got nan"),
            ({"f_s": 0.0}, "f_s must be above 0 and at most 1, got 0.0"),
            ({"f_s": 1.01}, "f_s must be above 0 and at most 1, got 1.01"),
            ({"d_root": 0.0}, "d_root must be a positive diameter in metres or NaN, got 0.0"),
            ({"d_root": math.inf}, "d_root must be a positive diameter in metres or NaN, got inf"),
        ],
    )
    def test_ranges(self, changes, match):
        with pytest.raises(InputError, match=match):
            Allometry(**({"beta": 1.5, "gamma": 1.5, "f_s": 0.98} | changes))

    def test_limits_are_inside(self):
        bare = Allometry(1, 0.1, 1, d_root=np.float32(0.5))
        assert (bare.beta, bare.f_s, bare.d_root) == (1.0, 1.0, 0.5)
        assert all(type(value) is float for value in dataclasses.astuple(bare))

    def test_frozen_and_comparable(self):
        a = Allometry(1.5, 1.5, 0.98, 0.4)
        assert a == pickle.loads(pickle.dumps(a)) != dataclasses.replace(a, d_root=0.5)
        with pytest.raises(dataclasses.FrozenInstanceError):
            a.beta = 2.0


class TestRadii:
    def test_equation_by_hand(self):
        """d_root 0.4 m, gamma 1.5, a trunk of 2 m with a fork of 1 m and 3 m: l = 6, 4, 0, 0."""
        tree = TreeGraph([-1, 0, 1, 1], [(0, 0, 0), (0, 0, 2), (1, 0, 2), (0, 0, 5)], [math.nan] * 4)
        want = [0.2, 0.2 * (4 / 6) ** 1.5, 0, 0]
        npt.assert_allclose(allometric_radii(tree, 0.4, 1.5), want, rtol=1e-14)

    @pytest.mark.parametrize("gamma", [0.5, 1.0, 1.5, 1.9])
    @pytest.mark.parametrize("name", ["comb", "star", "not depth-first", "zero-length segment"])
    def test_equation(self, name, gamma):
        tree = TREES[name]
        whole = reference.subtree_length(tree, 0)
        want = [0.3 * (reference.subtree_length(tree, i) / whole) ** gamma for i in range(tree.n_nodes)]
        npt.assert_allclose(allometric_radii(tree, 0.6, gamma), want, rtol=1e-12, atol=1e-15)

    def test_each_tree_of_a_forest_has_its_own_root(self):
        one = [(0, 0, 0), (0, 0, 1), (0, 0, 2)]
        far = [(9, 0, 0), (9, 0, 8), (9, 0, 16)]
        radius = allometric_radii(TreeGraph([-1, 0, 1, -1, 3, 4], one + far, [0] * 6), 0.4, 1.0)
        npt.assert_allclose(radius, [0.2, 0.1, 0, 0.2, 0.1, 0])

    @pytest.mark.parametrize("name", ["one node", "only roots", "all in one place"])
    def test_a_tree_without_length(self, name):
        npt.assert_array_equal(allometric_radii(TREES[name], 0.4, 1.5), 0.2)

    @given(parents(), st.floats(0.2, 4.0))
    @settings(deadline=None)
    def test_falls_towards_the_tips(self, parent, gamma):
        tree = make_tree(parent)
        radius = allometric_radii(tree, 0.5, gamma)
        child = np.flatnonzero(tree.parent >= 0)
        assert (radius[child] <= radius[tree.parent[child]] * (1 + 1e-12)).all()
        npt.assert_array_equal(radius[tree.parent < 0], 0.25)
        tips = np.setdiff1d(child, tree.parent)
        npt.assert_array_equal(radius[tips], 0.0)

    @given(rooted_parents())
    @settings(deadline=None)
    def test_gamma_one_is_da_vincis_rule_for_short_segments(self, parent):
        """With gamma = 1 diameters add up at a branching, apart from the wood of the segments between."""
        tree = make_tree(parent)
        radius = allometric_radii(tree, 2.0, 1.0)
        whole = reference.subtree_length(tree, 0)
        for i in range(len(parent)):
            kids = np.flatnonzero(tree.parent == i)
            if kids.size and whole > 0:
                wood = sum(reference.segment(tree, int(k)) for k in kids) / whole
                assert radius[i] == pytest.approx(radius[kids].sum() + wood)

    @pytest.mark.parametrize("name", ["bush", "comb", "tiny"])
    def test_only_proportions_matter(self, name):
        tree = TREES[name]
        rng = np.random.default_rng(2)
        moved = transform(tree, random_rotation(rng), rng.normal(size=3), 7.0)
        npt.assert_allclose(
            allometric_radii(moved, 0.5, 1.5), allometric_radii(tree, 0.5, 1.5), rtol=1e-6, atol=1e-15
        )
        npt.assert_allclose(
            allometric_radii(tree, 1.0, 1.5), 2 * allometric_radii(tree, 0.5, 1.5), rtol=1e-14
        )

    @pytest.mark.parametrize("value", [0, -1.0, math.nan, math.inf])
    def test_bad_numbers(self, value):
        tree = TREES["comb"]
        with pytest.raises(InputError, match=f"root_diameter must be a positive finite number, got {value}"):
            allometric_radii(tree, value, 1.5)
        with pytest.raises(InputError, match=f"gamma must be a positive finite number, got {value}"):
            allometric_radii(tree, 0.4, value)
