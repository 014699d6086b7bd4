"""Probabilities that can be believed, the reliability table, and "none of these"."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from classify import calibration_error, log_loss, reliability
from classify.calibration import (
    FeatureRange,
    Rejection,
    fit_range,
    fit_rejection,
    fit_temperature,
    to_probabilities,
)
from treegraph import InputError


def drawn(n, n_classes, temperature, seed=0):
    """Scores, and labels drawn with the probabilities that belong to them at a temperature."""
    rng = np.random.default_rng(seed)
    scores = rng.normal(0.0, 2.0, (n, n_classes))
    wanted = to_probabilities(scores, temperature)
    label = (wanted.cumsum(axis=1) > rng.random((n, 1))).argmax(axis=1)
    return scores, label


# ---------------------------------------------------------------- temperature


def test_probabilities_by_hand():
    got = to_probabilities(np.array([[0.0, np.log(3.0)], [np.log(9.0), 0.0]]), 1.0)
    npt.assert_allclose(got, [[0.25, 0.75], [0.9, 0.1]])
    npt.assert_allclose(to_probabilities(np.array([[0.0, np.log(9.0)]]), 2.0), [[0.25, 0.75]])
    npt.assert_allclose(to_probabilities(np.array([[1e6, 0.0, -1e6]]), 1e-3), [[1.0, 0.0, 0.0]])


@pytest.mark.parametrize("temperature", [0.3, 1.0, 4.0])
def test_temperature_is_found_again(temperature):
    npt.assert_allclose(fit_temperature(*drawn(20_000, 5, temperature)), temperature, rtol=0.03)


def test_temperature_is_that_of_least_loss():
    """Against a general minimiser, with the same targets."""
    scores, label = drawn(50, 4, 2.0)
    target = np.full(scores.shape, 1 / 52 / 3)
    target[np.arange(50), label] = 1 - 1 / 52

    def loss(log_t):
        return -(target * np.log(to_probabilities(scores, np.exp(log_t)))).sum()

    best = minimize_scalar(loss, bounds=(-3.0, 3.0), method="bounded", options={"xatol": 1e-10})
    npt.assert_allclose(fit_temperature(scores, label), np.exp(best.x), rtol=1e-6)


def test_all_right_is_not_certain():
    """n right samples: the temperature leaves room for one wrong in about n."""
    label = np.arange(40) % 4
    scores = np.where(label[:, None] == np.arange(4), 1.0, -1.0)
    sure = to_probabilities(scores, fit_temperature(scores, label)).max(axis=1)
    npt.assert_allclose(sure, 1.0 - 1.0 / 42.0)


def test_all_wrong_is_as_flat_as_it_may_be():
    label = np.arange(40) % 4
    scores = np.where(label[:, None] == np.arange(4), -1.0, 1.0)
    npt.assert_allclose(fit_temperature(scores, label), 1000.0)


# ---------------------------------------------------------------- reliability


def test_reliability_by_hand():
    probability = [[0.7, 0.3], [0.62, 0.38], [0.1, 0.9], [0.5, 0.5], [0.0, 1.0]]
    table = reliability(probability, [0, 1, 1, 1, 1], n_bins=5)
    npt.assert_allclose(table.low, [0.4, 0.6, 0.8])
    npt.assert_allclose(table.high, [0.6, 0.8, 1.0])
    npt.assert_allclose(table.predicted, [0.5, 0.66, 0.95])
    npt.assert_allclose(table.observed, [0.0, 0.5, 1.0])
    assert table.count.tolist() == [1, 2, 2]
    npt.assert_allclose(
        calibration_error(probability, [0, 1, 1, 1, 1], n_bins=5), (0.5 + 2 * 0.16 + 2 * 0.05) / 5
    )
    npt.assert_allclose(log_loss(probability, [0, 1, 1, 1, 1]), -np.log([0.7, 0.38, 0.9, 0.5, 1.0]).mean())


def test_a_probability_on_the_edge_is_in_the_lower_bin():
    table = reliability([[0.5, 0.5], [0.25, 0.75], [0.0, 1.0]], [0, 0, 0], n_bins=4)
    assert table.high.tolist() == [0.5, 0.75, 1.0] and table.count.tolist() == [1, 1, 1]


def test_true_probabilities_are_reliable_and_exaggerated_ones_are_not():
    scores, label = drawn(20_000, 5, 1.0)
    true, bold = to_probabilities(scores, 1.0), to_probabilities(scores, 0.25)
    assert calibration_error(true, label) < 0.015 < 0.1 < calibration_error(bold, label)
    assert log_loss(true, label) < log_loss(bold, label)
    table = reliability(true, label)
    npt.assert_allclose(table.observed, table.predicted, atol=4.0 * 0.5 / np.sqrt(table.count.min()))


@given(seed=st.integers(0, 100), n_bins=st.integers(1, 12), n=st.integers(1, 30))
def test_every_sample_is_in_one_bin(seed, n_bins, n):
    scores, label = drawn(n, 3, 1.0, seed)
    probability = to_probabilities(scores, 1.0)
    table = reliability(probability, label, n_bins=n_bins)
    assert table.count.sum() == n and (table.count > 0).all()
    assert ((table.low < table.predicted + 1e-12) & (table.predicted <= table.high + 1e-12)).all()
    npt.assert_allclose(table.count @ table.observed, (probability.argmax(axis=1) == label).sum())


def test_a_certain_error_is_a_finite_loss():
    npt.assert_allclose(log_loss([[1.0, 0.0]], [1]), -np.log(1e-15))


@pytest.mark.parametrize(
    "probability, label, n_bins, message",
    [
        ([0.5, 0.5], [0], 10, r"must have shape \(n, classes\) and label \(n,\), got \(2,\) and \(1,\)"),
        ([[0.5, 0.5]], [0, 1], 10, r"got \(1, 2\) and \(2,\)"),
        ([[0.5, 0.4]], [0], 10, "every row must add up to 1; scale the rows"),
        ([[1.5, -0.5]], [0], 10, "probability must be at least 0"),
        ([[np.nan, 1.0]], [0], 10, "probability must be at least 0"),
        ([[0.5, 0.5]], [2], 10, r"label must be a class from 0 to 1, got \[2\]"),
        ([[0.5, 0.5]], [0.5], 10, "label must be a class from 0 to 1"),
        ([[0.5, 0.5]], [0], 0, "n_bins must be at least 1, got 0"),
    ],
)
def test_wrong_probabilities_are_refused(probability, label, n_bins, message):
    with pytest.raises(InputError, match=message):
        reliability(probability, label, n_bins=n_bins)


# ---------------------------------------------------------------- range


def test_range_by_hand():
    x = np.array([[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [3.0, np.nan], [4.0, np.nan], [10.0, 7.0]])
    span = fit_range(x, np.array([0, 0, 0, 0, 0, 1]), 2)
    npt.assert_allclose(span.centre, [[2.0, 5.0], [10.0, 7.0]])
    own = 2.0 / 1.349  # quartiles 1 and 3; the single sample of class 1 has no spread of its own
    pooled = own**2 / 2.0
    npt.assert_allclose(span.spread[0, 0], np.sqrt(0.5 * own**2 + 0.5 * pooled))
    npt.assert_allclose(span.spread[1, 0], np.sqrt(0.5 * pooled))
    npt.assert_allclose(span.spread[:, 1], 0.1 * 0.5 / 1.349)  # the quartiles of 5 5 5 7 are 5 and 5.5


def test_distance_by_hand():
    span = FeatureRange(np.array([[0.0, 0.0, np.nan]]), np.array([[1.0, 2.0, 1.0]]))
    x = np.array([[1.0, 4.0, 9.0], [np.nan, 4.0, 0.0], [100.0, 0.0, 0.0], [np.nan, np.nan, 1.0]])
    got = span.distance(x, np.zeros(4, np.int64), np.array([1.0, 3.0, 6.0]))
    npt.assert_allclose(got, [np.sqrt((1 + 3 * 4) / 4), 2.0, np.sqrt(25 / 4), 5.0])


def test_distance_of_what_is_inside_is_about_one_and_of_what_is_far_is_five():
    rng = np.random.default_rng(0)
    label = np.repeat([0, 1], 500)
    x = rng.normal(size=(1000, 20)) * np.arange(1, 21) + 30.0 * label[:, None]
    span = fit_range(x, label, 2)
    weight = np.ones(20)
    npt.assert_allclose(span.distance(x, label, weight).mean(), 1.0, atol=0.05)
    npt.assert_allclose(span.distance(x + 1e4, label, weight), 5.0)
    moved = fit_range(1000.0 * x - 7.0, label, 2)  # units do not matter
    npt.assert_allclose(moved.distance(1000.0 * x - 7.0, label, weight), span.distance(x, label, weight))


def test_a_feature_that_no_sample_has_is_left_out():
    x = np.array([[0.0, np.nan], [1.0, np.nan], [5.0, np.nan], [6.0, np.nan]])
    span = fit_range(x, np.array([0, 0, 1, 1]), 2)
    assert np.isnan(span.centre[:, 1]).all() and (span.spread > 0.0).all()
    with_it = np.array([[0.5, 1e9]])
    npt.assert_allclose(span.distance(with_it, np.array([0]), np.ones(2)), 0.0)


@pytest.mark.parametrize(
    "centre, spread, message",
    [
        ([1.0], [1.0], r"centre must have shape \(classes, features\), got \(1,\)"),
        ([[1.0]], [[1.0, 1.0]], r"spread must have shape \(1, 1\), got \(1, 2\)"),
        ([[np.inf]], [[1.0]], "centre must be finite or NaN, got inf"),
        ([[1e101]], [[1.0]], "centre must be from -1e.100 to 1e.100, got 1e.101"),
        ([[1.0]], [[np.nan]], "spread must be finite, got nan"),
        ([[1.0]], [[0.0]], "spread must be from 1e-100 to 1e.100, got 0.0; 1 of 1 break this"),
    ],
)
def test_wrong_ranges_are_refused(centre, spread, message):
    with pytest.raises(InputError, match=message):
        FeatureRange(np.array(centre), np.array(spread))


# ---------------------------------------------------------------- none of these


@given(seed=st.integers(0, 200), n=st.integers(5, 200), asked=st.floats(0.01, 0.5), ties=st.booleans())
def test_no_more_are_rejected_than_asked(seed, n, asked, ties):
    rng = np.random.default_rng(seed)
    score, distance = rng.normal(size=n), rng.random(n) * 5.0
    if ties:
        score, distance = score.round(), distance.round()
    found = fit_rejection(score, distance, np.arange(n) % 5, asked)
    rejected = found.rejects(score, distance).sum()
    assert rejected <= asked * n
    if not ties:
        assert rejected == int(asked * n)


def test_the_measured_rate_is_that_of_unseen_scans():
    rng = np.random.default_rng(1)
    score, distance, fold = rng.normal(size=5000), rng.random(5000), np.arange(5000) % 5
    found = fit_rejection(score, distance, fold, 0.1)
    npt.assert_allclose(found.measured, 0.1, atol=0.015)
    unseen = found.rejects(rng.normal(size=50_000), rng.random(50_000)).mean()
    npt.assert_allclose(unseen, 0.1, atol=0.01)
    assert found.n_measured == 5000 and found.asked == 0.1
    score[fold == 0] -= 10.0  # a fold unlike the others: all of it, and of the others the 2% that are far
    npt.assert_allclose(fit_rejection(score, distance, fold, 0.1).measured, 0.2 + 0.8 * 0.02, atol=0.003)


def test_low_scores_and_far_scans_are_rejected_each_for_itself():
    rule = Rejection(score_min=0.5, distance_max=2.0, asked=0.05, measured=0.04, n_measured=100)
    got = rule.rejects(np.array([0.5, 0.4, 3.0, 3.0]), np.array([2.0, 1.0, 2.1, 1.0]))
    assert got.tolist() == [False, True, True, False]


@pytest.mark.parametrize("share, far", [((), 20), ((0.0,), 0), ((0.5,), 50), ((1.0,), 100)])
def test_the_distance_has_its_share_of_the_rejections(share, far):
    """A fifth without being asked; the score has the rest of 100."""
    rng = np.random.default_rng(2)
    score, distance = rng.normal(size=1000), rng.random(1000)
    found = fit_rejection(score, distance, np.arange(1000) % 5, 0.1, *share)
    assert (distance > found.distance_max).sum() == far
    assert found.rejects(score, distance).sum() == 100


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_wrong_share_for_the_distance_is_refused(share):
    with pytest.raises(InputError, match=f"distance_share must be from 0 to 1, got {share}"):
        fit_rejection(np.zeros(4), np.zeros(4), np.arange(4), 0.1, share)


@pytest.mark.parametrize(
    "fold, asked, message",
    [
        ([0, 1], 0.0, "false_rejection must be over 0 and under 1, got 0.0"),
        ([0, 1], 1.0, "false_rejection must be over 0 and under 1, got 1.0"),
        ([3, 3], 0.1, "fold must have at least 2 folds, got 1"),
    ],
)
def test_wrong_rates_are_refused(fold, asked, message):
    with pytest.raises(InputError, match=message):
        fit_rejection(np.zeros(2), np.zeros(2), np.array(fold), asked)


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"score_min": np.nan}, "score_min must be from -1000000.0 to 1000000.0, got nan"),
        ({"distance_max": 6.0}, "distance_max must be from 0.0 to 5.0, got 6.0"),
        ({"asked": -0.1}, "asked must be from 0.0 to 1.0, got -0.1"),
        ({"measured": 1.1}, "measured must be from 0.0 to 1.0, got 1.1"),
        ({"n_measured": 0}, "n_measured must be from 1 to 1000000000, got 0"),
    ],
)
def test_wrong_rules_are_refused(changed, message):
    fields = {"score_min": 0.5, "distance_max": 2.0, "asked": 0.05, "measured": 0.04, "n_measured": 100}
    with pytest.raises(InputError, match=message):
        Rejection(**(fields | changed))
