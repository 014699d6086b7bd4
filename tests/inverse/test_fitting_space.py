"""Where a fit searches."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inverse import search_space
from inverse.space import AGE, Dimension
from species import GrowthParameters, presets
from treegraph import InputError

SPACE = search_space(10.0)


def test_all_parameters_are_there_in_the_order_of_the_paper():
    symbols = list(presets()["F6a"].parameters.symbols())
    assert [d.symbol for d in SPACE.dimensions] == [*symbols, AGE]
    assert SPACE.n_free == 25


@pytest.mark.parametrize("name", ["F6a", "F6b", "F6c", "F6d", "F6f"])
def test_table_2_lies_within(name):
    """And comes back from its point."""
    preset = presets()[name]
    space = search_space(12.0, bounds={"IBL": (0.05, 3.0), "LB_PF": (0, 10)})
    for d in space.dimensions:
        value = (preset.parameters.symbols() | {AGE: preset.age})[d.symbol]
        assert d.low <= value <= d.high, (d.symbol, value)
    parameters, age = space.decode(space.encode(preset.parameters, preset.age))
    assert age == preset.age
    for symbol, value in preset.parameters.symbols().items():
        npt.assert_allclose(parameters.symbols()[symbol], value, atol=1e-9, err_msg=symbol)


@given(st.integers(0, 10**6))
def test_every_point_is_a_kind_of_tree_and_comes_back(seed):
    point = np.random.default_rng(seed).random(25)
    parameters, age = SPACE.decode(point)
    assert isinstance(parameters, GrowthParameters)
    again = SPACE.encode(parameters, age)
    whole = np.array([d.scale == "whole" for d in SPACE.free])
    npt.assert_allclose(again[~whole], point[~whole], atol=1e-9)
    same, same_age = SPACE.decode(again)
    assert same_age == age
    npt.assert_allclose([*same.symbols().values()], [*parameters.symbols().values()], rtol=1e-9, atol=1e-12)


def test_ends_of_the_bounds():
    for share, end in ((0.0, "low"), (1.0, "high")):
        parameters, age = SPACE.decode(np.full(25, share))
        values = parameters.symbols() | {AGE: age}
        for d in SPACE.dimensions:
            npt.assert_allclose(values[d.symbol], getattr(d, end), err_msg=d.symbol)


def test_scales():
    assert Dimension("x", 0.0, 100.0, "root").value(0.5) == 25.0
    npt.assert_allclose(Dimension("x", 1.0, 100.0, "log").value(0.5), 10.0)
    whole = Dimension("x", 1, 4, "whole")
    assert [whole.value(s) for s in (0.0, 0.24, 0.26, 0.99, 1.0)] == [1, 1, 2, 4, 4]


def test_lengths_follow_the_height():
    small, large = search_space(1.0), search_space(10.0)
    for one, two in zip(small.dimensions, large.dimensions, strict=True):
        if one.symbol in ("IBL", "LB_PF"):
            npt.assert_allclose((two.high, two.low), (10 * one.high, 10 * one.low))
        else:
            assert one == two


def test_bounds_and_fixed_ones():
    space = search_space(10.0, bounds={"branching_angle_mean_deg": (30, 60)}, fixed={"NLB": 3, "age": 12})
    assert space.n_free == 23
    parameters, age = space.decode(np.zeros(23))
    assert (parameters.n_lateral_buds, age, parameters.branching_angle_mean_deg) == (3, 12, 30.0)


@pytest.mark.parametrize(
    "height, how, match",
    [
        (0.0, {}, "height must be a positive number of metres, got 0.0"),
        (math.nan, {}, "height must be a positive number of metres"),
        (5.0, {"fixed": {"BAN": 3}}, "there is no parameter 'BAN'; did you mean 'GBA'"),
        (5.0, {"fixed": {"BAM": 3}, "bounds": {"BAM": (1, 2)}}, "BAM must be bounded or fixed, not both"),
        (5.0, {"fixed": {"BAM": 3, "branching_angle_mean_deg": 4}}, "BAM is given twice, by its name and by"),
        (5.0, {"bounds": {"t": (5, 9), "age": (4, 9)}}, "t is given twice, by its name and by its symbol"),
        (5.0, {"bounds": {"BAM": (60, 30)}}, "bounds of BAM must ascend, got 60.0 to 30.0"),
        (5.0, {"bounds": {"BAM": (0, 300)}}, "bounds of BAM must be within 0.0 to 180.0, got 0.0 to 300.0"),
        (5.0, {"fixed": {"NLB": 2.5}}, "bounds of NLB must be whole numbers, got 2.5 to 2.5"),
        (
            5.0,
            {"fixed": {d.symbol: d.low for d in SPACE.dimensions}},
            "at least one parameter that is not fixed",
        ),
    ],
)
def test_errors(height, how, match):
    with pytest.raises(InputError, match=match):
        search_space(height, **how)


@pytest.mark.parametrize("point", [np.zeros(3), np.full(25, 1.5), np.full(25, np.nan)])
def test_bad_point(point):
    with pytest.raises(InputError, match="a point must be 25 numbers from 0 to 1"):
        SPACE.decode(point)
