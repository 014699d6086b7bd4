"""Joint boosting: equal to its definition, fewer features by sharing, and a well-behaved estimator."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from benchmarks.class_problems import coded, mixed, projected
from classify import BoostSettings, JointBoostClassifier, Stumps, boost
from classify.boosting import _find_split, _split_table
from classify.stumps import two_sided
from tests.classify.boost_reference import accuracy, boost_slowly, error_of, search_slowly
from treegraph import InputError

EVERY = BoostSettings(max_thresholds=None)


def train(x, y, settings=EVERY, weight=None, seed=0):
    weight = np.ones(len(y)) if weight is None else np.asarray(weight, float)
    return boost(np.asarray(x, float), np.asarray(y), weight, settings, np.random.default_rng(seed))


def columns(stumps):
    return [getattr(stumps, name) for name in Stumps.__dataclass_fields__ if name != "n_features"]


def assert_same(one, other):
    for a, b in zip(columns(one), columns(other), strict=True):
        npt.assert_array_equal(a, b)


# ---------------------------------------------------------------- the definition


@pytest.mark.parametrize("n_classes, missing", [(3, 0.0), (4, 0.15)])
def test_every_round_is_that_of_the_definition(n_classes, missing):
    x, y = mixed(6, n_classes, 4, seed=n_classes, missing=missing)
    stumps = train(x, y, BoostSettings(n_rounds=5, max_thresholds=None)).stumps
    for j, (_, (feature, threshold, missing_above), shared) in enumerate(boost_slowly(x, y, 5)):
        assert stumps.feature[j] == feature
        npt.assert_allclose(stumps.threshold[j], threshold, rtol=1e-15)
        assert tuple(stumps.shared[j]) == shared
        if np.isnan(x[:, feature]).any():
            assert stumps.missing_above[j] == missing_above


@pytest.mark.parametrize("seed", range(12))
def test_the_search_is_right_for_any_weights(seed):
    """Weights as unequal as late rounds have them; then the constants of the classes matter."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(12, 3))
    x[rng.random(x.shape) < 0.1] = np.nan
    sign = np.where(rng.random((12, 4)) < rng.random(4), 1.0, -1.0)
    weight = np.exp(rng.normal(0.0, 1.0, (12, 4)) + seed / 4.0 * rng.normal(size=4))
    splits = _split_table(x, np.ones(12), None)
    room = np.empty((2, 4, int(splits.sizes(np.arange(3)).sum())))
    found = _find_split(weight / weight.sum(), sign, splits, BoostSettings(), rng, room)
    error, (feature, threshold, missing_above), shared = search_slowly(x, sign, weight)
    assert tuple(found.shared) == shared
    assert (found.feature, found.missing_above) == (feature, missing_above)
    npt.assert_allclose(splits.threshold[feature][found.place], threshold)
    constants = error_of(x, sign, weight, (0, 0.0, False, np.zeros(4, bool)))[0]
    npt.assert_allclose(found.gain, (constants - error) / weight.sum(), rtol=1e-9)


def test_values_are_those_that_leave_the_least_error():
    """By hand: one feature, two classes of three samples; one output."""
    x, y = [[0.0], [1.0], [2.0], [3.0], [4.0], [5.0]], [0, 0, 1, 0, 1, 1]
    stumps = train(x, y, BoostSettings(n_rounds=1)).stumps
    assert stumps.threshold[0] in (1.5, 3.5)  # one of six wrong either way; the first is taken
    npt.assert_allclose([stumps.threshold[0], stumps.below[0], stumps.above[0]], [1.5, -1.0, 0.5])
    npt.assert_allclose(stumps.above_share, 4 / 6)
    npt.assert_allclose(stumps.gain, 1 / 3 + 2 / 3 * 0.25)  # sum of w mean(z)^2, in shares
    npt.assert_allclose(stumps.scores([[1.5], [1.6]])[:, 0], [-1.0, 0.5])  # equal is below


def test_constants_are_the_means_of_the_classes_outside():
    x, y = mixed(10, 5, 6, seed=3)
    boosted = train(x, y, BoostSettings(n_rounds=3, max_thresholds=None))
    stumps = boosted.stumps
    sign = np.where(y[:, None] == np.arange(5), 1.0, -1.0)
    score = np.tile(stumps.intercept, (len(y), 1))
    for j in range(3):
        weight = np.exp(-sign * score)
        npt.assert_allclose(boosted.train_loss[j], weight.mean())
        split = (stumps.feature[j], stumps.threshold[j], stumps.missing_above[j])
        error, h = error_of(x, sign, weight, (*split, stumps.shared[j]))
        score += h
        constants = error_of(x, sign, weight, (*split, np.zeros(5, bool)))[0]
        start = np.exp(-sign * stumps.intercept).sum()
        npt.assert_allclose(stumps.gain[j], (constants - error) / start)
        out = ~stumps.shared[j]
        npt.assert_allclose(stumps.constant[j, out], h[0, out], atol=1e-15)
        assert not stumps.constant[j, ~out].any()
    npt.assert_allclose(stumps.scores(x), score, atol=1e-12)


def test_loss_falls_in_every_round():
    x, y = mixed(15, 6, 12, spread=1.5)
    for settings_ in (EVERY, BoostSettings(learning_rate=0.3), BoostSettings(sharing="single")):
        loss = train(x, y, settings_).train_loss
        assert (np.diff(loss) <= 0.0).all() and loss[-1] < 0.3 * loss[0]


def test_a_constant_and_an_unknown_feature_are_never_chosen():
    x, y = mixed(10, 3, 4)
    x = np.column_stack([np.full(len(y), 7.0), x, np.full(len(y), np.nan)])
    stumps = train(x, y, BoostSettings(n_rounds=60)).stumps
    assert set(stumps.feature) <= {1, 2, 3, 4}
    assert stumps.importances()[[0, 5]].tolist() == [0.0, 0.0]


def test_features_that_say_nothing_leave_the_frequencies():
    boosted = train(np.zeros((6, 2)), [0, 0, 0, 1, 1, 2])
    assert boosted.stumps.n_stumps == 0
    npt.assert_allclose(two_sided(boosted.stumps.scores(np.zeros((1, 2))))[0, 0], 0.0, atol=1e-15)
    npt.assert_allclose(boosted.stumps.intercept, 0.5 * np.log([1.0, 0.5, 0.2]), atol=1e-15)
    assert boosted.stumps.importances().tolist() == [0.0, 0.0]


def test_perfect_separation_ends_before_the_weights_vanish():
    x = np.repeat([[0.0], [1.0], [2.0]], 4, axis=0)
    boosted = train(x, np.repeat([0, 1, 2], 4), BoostSettings(n_rounds=5000))
    assert boosted.stumps.n_stumps < 5000
    assert np.isfinite(boosted.stumps.scores(x)).all()
    assert accuracy(boosted.stumps.scores(x), np.repeat([0, 1, 2], 4)) == 1.0


# ---------------------------------------------------------------- sharing, the paper's point


def stumps_needed(x, y, x_test, y_test, sharing, error):
    """Stumps, and features among them, until the error on other samples is no more than `error`."""
    stumps = train(x, y, BoostSettings(n_rounds=300, sharing=sharing)).stumps
    for k, scores in enumerate(stumps.staged_scores(x_test), 1):
        if 1.0 - accuracy(scores, y_test) <= error:
            return k, len(set(stumps.feature[:k].tolist()))
    return np.inf, np.inf


@pytest.mark.parametrize("n_classes, factor", [(8, 1.8), (16, 4.0)])
def test_shared_stumps_are_fewer_for_the_same_error(n_classes, factor):
    problem = (*coded(n_classes, 40, 1), *coded(n_classes, 100, 2))
    shared, shared_features = stumps_needed(*problem, "greedy", 0.05)
    alone, alone_features = stumps_needed(*problem, "single", 0.05)
    assert factor * shared <= alone < np.inf
    assert shared_features < alone_features


def test_shared_stumps_are_fewer_on_discs_seen_from_many_directions():
    problem = (*projected(16, 40, 1), *projected(16, 100, 2))
    shared, shared_features = stumps_needed(*problem, "greedy", 0.08)
    alone, alone_features = stumps_needed(*problem, "single", 0.08)
    assert 2.5 * shared <= alone < np.inf
    assert shared_features < alone_features


def test_stumps_needed_grow_slower_than_the_classes_do():
    needed = [stumps_needed(*coded(c, 40, 1), *coded(c, 100, 2), "greedy", 0.05)[0] for c in (4, 8, 16)]
    assert needed[2] <= 2 * needed[0]  # four times the classes


def test_single_shares_nothing_and_greedy_leaves_no_more_error():
    x, y = mixed(15, 6, 12)
    alone = train(x, y, BoostSettings(n_rounds=40, sharing="single"))
    together = train(x, y, BoostSettings(n_rounds=40))
    assert (alone.stumps.shared.sum(axis=1) == 1).all()
    assert (together.stumps.shared.sum(axis=1) >= 1).all()
    assert together.stumps.gain[0] >= alone.stumps.gain[0]
    assert together.train_loss[-1] < alone.train_loss[-1]


# ---------------------------------------------------------------- missing values


def test_missing_values_take_the_side_where_they_belong():
    x = np.array([[0.0], [0.1], [0.2], [1.0], [1.1], [1.2], [np.nan], [np.nan]])
    for side in (0, 1):
        stumps = train(x, [0, 0, 0, 1, 1, 1, side, side], BoostSettings(n_rounds=1)).stumps
        assert bool(stumps.missing_above[0]) == (side == 1)
        npt.assert_allclose(stumps.scores([[np.nan]]), stumps.scores([[float(side)]]))
        npt.assert_allclose(stumps.threshold, 0.6)


def test_a_feature_that_was_always_there_sends_missing_values_to_the_heavier_side():
    x, y = np.array([[0.0], [1.0], [2.0]]), [0, 1, 1]
    assert train(x, y, BoostSettings(n_rounds=1)).stumps.missing_above[0]
    assert not train(x, y, BoostSettings(n_rounds=1), weight=[5, 1, 1]).stumps.missing_above[0]


def test_a_tenth_of_the_values_missing_costs_little():
    x, y = mixed(40, seed=1, missing=0.0)
    x_test, y_test = mixed(100, seed=2, missing=0.0)
    full = accuracy(train(x, y).stumps.scores(x_test), y_test)
    rng = np.random.default_rng(3)
    for array in (x, x_test):
        array[rng.random(array.shape) < 0.1] = np.nan
    assert accuracy(train(x, y).stumps.scores(x_test), y_test) > full - 0.05


# ---------------------------------------------------------------- invariants


def test_a_sample_of_weight_two_counts_as_two_and_of_none_as_none():
    x, y = mixed(8, 4, 5, seed=1)
    weight = np.random.default_rng(0).integers(0, 4, len(y))
    one = JointBoostClassifier(n_rounds=20).fit(x, y, weight)
    other = JointBoostClassifier(n_rounds=20).fit(np.repeat(x, weight, axis=0), np.repeat(y, weight))
    npt.assert_array_equal(one.stumps_.feature, other.stumps_.feature)
    npt.assert_array_equal(one.sharing_, other.sharing_)
    npt.assert_allclose(one.decision_function(x), other.decision_function(x), atol=1e-9)


def test_weights_count_by_their_ratio():
    x, y = mixed(8, 4, 5, seed=1)
    one, other = train(x, y), train(x, y, weight=np.full(len(y), 1e-6))
    npt.assert_allclose(one.stumps.scores(x), other.stumps.scores(x), rtol=1e-6)


def test_a_class_of_hardly_any_weight_is_learnt_all_the_same():
    x, y = mixed(8, 3, 4, seed=1)
    stumps = train(x, y, weight=np.where(y == 0, 1e-30, 1.0)).stumps
    assert stumps.intercept[0] < -17.0
    assert accuracy(stumps.scores(x)[:, 1:], y - 1) >= 2 / 3 - 1e-9  # the others are not disturbed


def test_order_of_samples_features_and_classes_does_not_matter():
    x, y = mixed(10, 4, 6, seed=5)
    few = BoostSettings(n_rounds=25, max_thresholds=None)
    scores = train(x, y, few).stumps.scores(x)
    rng = np.random.default_rng(0)
    row, column, name = rng.permutation(len(y)), rng.permutation(6), rng.permutation(4)
    npt.assert_allclose(train(x[row], y[row], few).stumps.scores(x), scores, atol=1e-9)
    npt.assert_allclose(train(x[:, column], y, few).stumps.scores(x[:, column]), scores, atol=1e-9)
    npt.assert_allclose(train(x, name[y], few).stumps.scores(x)[:, name], scores, atol=1e-9)


def test_units_do_not_matter():
    """An increasing function of a feature moves thresholds, not the sides of the training samples."""
    x, y = mixed(10, 4, 6, seed=5)
    other = x.copy()
    other[:, 0] = 1000.0 * x[:, 0] - 30.0
    other[:, 1] = x[:, 1] ** 3
    npt.assert_allclose(train(other, y).stumps.scores(other), train(x, y).stumps.scores(x), atol=1e-9)


@given(seed=st.integers(0, 1000), max_thresholds=st.sampled_from([1, 3, None]), n=st.integers(2, 12))
@settings(max_examples=25, deadline=None)
def test_few_samples_with_ties_and_gaps_make_a_finite_model(seed, max_thresholds, n):
    rng = np.random.default_rng(seed)
    x = rng.integers(0, 3, (n, 3)).astype(float)
    x[rng.random(x.shape) < 0.2] = np.nan
    y = np.concatenate([np.arange(min(n, 3)), rng.integers(0, min(n, 3), n - min(n, 3))])
    boosted = train(x, y, BoostSettings(n_rounds=30, max_thresholds=max_thresholds))
    assert np.isfinite(boosted.stumps.scores(x)).all()
    assert (np.diff(boosted.train_loss) <= 1e-15).all()


def test_neighbouring_floats_can_be_told_apart():
    low = 0.1
    for _ in range(4):  # half of the middles round up, half down
        high = np.nextafter(low, 1.0)
        stumps = train([[low], [high]], [0, 1], BoostSettings(n_rounds=1)).stumps
        assert stumps.scores([[low]])[0, 0] < 0.0 < stumps.scores([[high]])[0, 0]
        low = high
    stumps = train([[-1.7e308], [1.7e308]], [0, 1], BoostSettings(n_rounds=1)).stumps
    assert stumps.threshold[0] == 0.0


def test_thresholds_are_quantiles_of_weight():
    x = np.arange(1000.0)[:, None]
    y = (np.arange(1000) >= 500).astype(int)
    found = {
        n: train(x, y, BoostSettings(n_rounds=1, max_thresholds=n)).stumps.threshold[0] for n in (1, 9, 99)
    }
    npt.assert_allclose(list(found.values()), 499.5)
    third = train(x, (np.arange(1000) >= 300).astype(int), BoostSettings(n_rounds=1, max_thresholds=9))
    npt.assert_allclose(third.stumps.threshold[0], 299.5)
    heavy = np.where(np.arange(1000) < 100, 9.0, 1.0)  # half of the weight lies below 100
    half = train(x, (np.arange(1000) >= 100).astype(int), BoostSettings(n_rounds=1, max_thresholds=1), heavy)
    npt.assert_allclose(half.stumps.threshold[0], 99.5)


def test_threads_change_no_byte():
    x, y = mixed(20, seed=1)
    few = BoostSettings(n_rounds=30, max_features=0.5)
    alone = train(x, y, few).stumps
    with ThreadPoolExecutor(4) as pool:
        for other in pool.map(lambda _: train(x, y, few).stumps, range(8)):
            assert_same(alone, other)


# ---------------------------------------------------------------- stages, stopping, what was learnt


def test_stages_end_in_the_model():
    x, y = mixed(10)
    model = JointBoostClassifier(n_rounds=15).fit(x, y)
    stages = list(model.staged_decision_function(x))
    assert len(stages) == model.n_rounds_ == 15
    npt.assert_array_equal(stages[-1], model.decision_function(x))
    npt.assert_array_equal(list(model.staged_predict_proba(x))[-1], model.predict_proba(x))
    npt.assert_array_equal(list(model.staged_predict(x))[-1], model.predict(x))
    npt.assert_array_equal(stages[6], model.stumps_.first(7).scores(x))


def test_stopping_keeps_the_best_round_and_takes_it_from_samples_set_aside():
    x, y = mixed(40, spread=1.5, seed=4)
    model = JointBoostClassifier(validation_fraction=0.25, n_rounds_no_change=10, random_state=0).fit(x, y)
    loss = model.validation_loss_
    assert 0 < model.n_rounds_ < 300
    assert loss.size == model.n_rounds_ + 11
    npt.assert_allclose(loss[model.n_rounds_], loss.min(), atol=model.tol)
    assert loss[0] > loss.min() and model.train_loss_.size == model.n_rounds_ + 1
    again = JointBoostClassifier(validation_fraction=0.25, n_rounds_no_change=10, random_state=0).fit(x, y)
    assert_same(model.stumps_, again.stumps_)
    other = JointBoostClassifier(validation_fraction=0.25, n_rounds_no_change=10, random_state=1).fit(x, y)
    assert other.validation_loss_.tolist() != loss.tolist()


def test_a_loss_that_falls_by_less_than_asked_is_no_better():
    x, y = mixed(20)
    model = JointBoostClassifier(validation_fraction=0.25, n_rounds_no_change=5, tol=10.0).fit(x, y)
    assert model.n_rounds_ == 0 and model.validation_loss_.size == 6
    assert model.validation_loss_[5] < model.validation_loss_[0]


def test_without_samples_set_aside_nothing_is_random():
    x, y = mixed(10)
    one, other = (JointBoostClassifier(n_rounds=10, random_state=k).fit(x, y) for k in (0, 1))
    assert_same(one.stumps_, other.stumps_)
    drawn, same, another = (
        JointBoostClassifier(n_rounds=10, max_features=0.3, random_state=k).fit(x, y) for k in (0, 0, 1)
    )
    assert_same(drawn.stumps_, same.stumps_)
    assert drawn.stumps_.feature.tolist() != another.stumps_.feature.tolist()


def test_a_draw_of_useless_features_is_followed_by_a_search_of_all():
    x = np.zeros((20, 50))
    x[:, 17] = y = np.repeat([0, 1], 10)
    stumps = train(x, y, BoostSettings(n_rounds=3, max_features=0.02)).stumps
    assert stumps.feature.tolist() == [17, 17, 17]


def test_learning_rate_shortens_stumps():
    x, y = mixed(10)
    whole, short = (train(x, y, BoostSettings(n_rounds=1, learning_rate=r)).stumps for r in (1.0, 0.25))
    npt.assert_allclose([short.above, short.below], [0.25 * whole.above, 0.25 * whole.below])
    npt.assert_allclose(short.constant, 0.25 * whole.constant)


def test_importances_are_shares_of_the_gain():
    x, y = coded(8, 40, 1)
    model = JointBoostClassifier(n_rounds=30).fit(x, y)
    importance = model.feature_importances_
    npt.assert_allclose(importance.sum(), 1.0)
    assert importance[:10].sum() > 0.95  # the others say nothing
    own = model.stumps_.gain[model.stumps_.feature == 3].sum() / model.stumps_.gain.sum()
    npt.assert_allclose(importance[3], own)


def test_contributions_add_up_to_the_scores_and_to_nothing_over_the_training():
    x, y = mixed(12, 5)
    stumps = train(x, y, BoostSettings(n_rounds=50)).stumps
    each = np.array([stumps.contributions(row) for row in x])
    npt.assert_allclose(each.sum(axis=1) + stumps.mean_scores(), stumps.scores(x), atol=1e-12)
    npt.assert_allclose(each.mean(axis=0), 0.0, atol=1e-12)
    npt.assert_allclose(stumps.mean_scores(), stumps.scores(x).mean(axis=0), atol=1e-12)
    assert not each[:, np.setdiff1d(np.arange(30), stumps.feature)].any()


def test_scores_are_the_same_bytes_alone_and_among_others():
    x, y = mixed(10)
    stumps = train(x, y).stumps
    alone = np.concatenate([stumps.scores(row[None]) for row in x])
    assert alone.tobytes() == stumps.scores(x).tobytes()
    assert stumps.scores(np.asfortranarray(x)).tobytes() == alone.tobytes()


# ---------------------------------------------------------------- the estimator


@parametrize_with_checks(
    [
        JointBoostClassifier(n_rounds=30),
        JointBoostClassifier(n_rounds=30, sharing="single", learning_rate=0.5, max_features=0.5),
    ]
)
def test_estimator_keeps_the_rules_of_scikit_learn(estimator, check):
    check(estimator)


def test_estimator_in_a_pipeline_and_under_cross_validation():
    x, y = mixed(25)
    names = np.array(["ash", "birch", "cedar", "elm", "fir", "oak"])[y]
    pipeline = make_pipeline(StandardScaler(), JointBoostClassifier(n_rounds=60))
    assert cross_val_score(pipeline, x, names, cv=5).mean() > 0.7  # chance is 1 in 6
    fitted = pipeline.fit(x, names)
    assert fitted[-1].classes_.tolist() == ["ash", "birch", "cedar", "elm", "fir", "oak"]
    npt.assert_allclose(fitted.predict_proba(x).sum(axis=1), 1.0)


def test_two_classes_have_one_output():
    x, y = mixed(20, 2)
    model = JointBoostClassifier(n_rounds=20).fit(x, np.array(["yew", "ash"])[y])
    scores = model.decision_function(x)
    assert scores.shape == (40,) and model.sharing_.shape == (20, 1)
    npt.assert_array_equal(model.predict(x) == "yew", scores > 0.0)
    npt.assert_allclose(model.predict_proba(x)[:, 1], 1.0 / (1.0 + np.exp(-2.0 * scores)))


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"n_rounds": 0}, "n_rounds must be a whole number from 1, got 0"),
        ({"n_rounds": 2.5}, "n_rounds must be a whole number from 1, got 2.5"),
        ({"learning_rate": 0.0}, "learning_rate must be over 0 and at most 1, got 0.0"),
        ({"learning_rate": np.nan}, "learning_rate must be over 0 and at most 1, got nan"),
        ({"sharing": "all"}, "sharing must be one of greedy, single, got 'all'"),
        ({"max_thresholds": 70_000}, "max_thresholds must be a whole number from 1 to 65000, or None"),
        ({"max_features": 1.5}, "max_features must be over 0 and at most 1, got 1.5"),
        ({"validation_fraction": 0.6}, "validation_fraction must be from 0 to 0.5, got 0.6"),
        ({"n_rounds_no_change": 0}, "n_rounds_no_change must be a whole number from 1, got 0"),
        ({"tol": -1.0}, "tol must be at least 0, got -1.0"),
        ({"validation_fraction": 0.1}, "sets? samples aside, but 0.1 of 6 samples is none"),
    ],
)
def test_parameters_out_of_range_are_refused(changed, message):
    with pytest.raises(InputError, match=message):
        JointBoostClassifier(**changed).fit(np.arange(6.0)[:, None], [0, 0, 0, 1, 1, 1])


@pytest.mark.parametrize(
    "weight, message",
    [
        (np.ones(5), r"sample_weight must have shape \(6,\), got \(5,\)"),
        ([1, 1, 1, 1, 1, -1], "sample_weight must be finite and at least 0, got -1.0"),
        ([1, 1, 1, 1, 1, np.nan], "sample_weight must be finite and at least 0, got nan"),
        (np.zeros(6), "sample_weight must not be zero everywhere, got 6 zeros"),
        ([1, 1, 1, 0, 0, 0], "y must have at least 2 classes .with weight., got 1 class in 6 samples"),
    ],
)
def test_weights_out_of_range_are_refused(weight, message):
    with pytest.raises(InputError, match=message):
        JointBoostClassifier().fit(np.arange(6.0)[:, None], [0, 0, 0, 1, 1, 1], weight)


def stump(**changed):
    fields = {
        "n_features": 2,
        "intercept": [0.0, 0.0, 0.0],
        "feature": [1],
        "threshold": [0.5],
        "missing_above": [True],
        "above": [0.75],
        "below": [-0.5],
        "shared": [[True, False, True]],
        "constant": [[0.0, -0.25, 0.0]],
        "above_share": [0.4],
        "gain": [0.1],
    }
    return Stumps(**(fields | changed))


def test_a_stump_by_hand():
    scores = stump(intercept=[0.0, 1.0, 0.0]).scores([[9.0, 0.6], [9.0, 0.5], [9.0, np.nan]])
    npt.assert_allclose(scores, [[0.75, 0.75, 0.75], [-0.5, 0.75, -0.5], [0.75, 0.75, 0.75]])
    npt.assert_allclose(stump().mean_scores(), [0.0, -0.25, 0.0], atol=1e-15)  # 0.4 0.75 - 0.6 0.5
    npt.assert_allclose(stump().contributions([9.0, 0.6]), [[0, 0, 0], [0.75, 0, 0.75]], atol=1e-15)
    assert not stump().shared.flags.writeable


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"shared": [True]}, r"shared must have shape \(stumps, outputs\) with an output, got \(1,\)"),
        ({"n_features": 0}, "n_features must be at least 1, got 0"),
        ({"feature": [2]}, "feature must be from 0 to 1, got 2; 1 of 1 break this"),
        ({"feature": [-1]}, "feature must be from 0 to 1, got -1"),
        ({"feature": [1.0]}, "feature must be of type int32, got float64"),
        ({"threshold": [np.nan]}, "threshold must be finite, got nan"),
        ({"threshold": [0.5, 0.5]}, r"threshold must have shape \(1,\), got \(2,\)"),
        ({"above": [np.inf]}, "above must be finite, got inf"),
        ({"above_share": [1.5]}, "above_share must be from 0.0 to 1.0, got 1.5"),
        ({"gain": [-0.1]}, "gain must be from 0.0 to 2.0, got -0.1"),
        ({"above": [1.1]}, "above must be from -1.0 to 1.0, got 1.1"),
        ({"below": [-1.1]}, "below must be from -1.0 to 1.0, got -1.1"),
        ({"constant": [[0.0, 1.1, 0.0]]}, "constant must be from -1.0 to 1.0, got 1.1; 1 of 3 break this"),
        ({"intercept": [0.0, 51.0, 0.0]}, "intercept must be from -50.0 to 50.0, got 51.0"),
        ({"constant": [[0.1, 0.1, 0.0]]}, "constant must be 0 where shared"),
        ({"intercept": [0.0]}, r"intercept must have shape \(3,\), got \(1,\)"),
    ],
)
def test_wrong_stumps_are_refused(changed, message):
    with pytest.raises(InputError, match=message):
        stump(**changed)


@pytest.mark.parametrize(
    "x, message",
    [
        ([1.0, 2.0], r"x must have shape \(samples, 2\), got \(2,\)"),
        ([[1.0]], r"x must have shape \(samples, 2\), got \(1, 1\)"),
        ([[1.0, 2.0], [1.0, np.inf]], r"x must be finite or NaN, but x\[1, 1\] is inf; give NaN"),
    ],
)
def test_wrong_features_are_refused(x, message):
    with pytest.raises(InputError, match=message):
        stump().scores(x)
