"""A trained model: what it says, why, and when it says "none of these"."""

from collections import Counter
from dataclasses import replace

import numpy as np
import numpy.testing as npt
import pytest

from benchmarks.class_problems import mixed
from classify import BoostSettings, SpeciesModel, Stumps, calibration_error, log_loss, train_model
from classify.calibration import FeatureRange, Rejection
from treegraph import InputError

NAMES = ("ash", "birch", "cedar", "elm", "fir", "oak")
FEATURES = tuple(f"feature_{k:02d}" for k in range(30))
FAST = BoostSettings(n_rounds=120, learning_rate=0.3, max_features=0.3)


def train(x, y, *, seed=0, **options):
    names = [NAMES[k] for k in y]
    rng = np.random.default_rng(seed)
    return train_model(
        x, names, FEATURES[: x.shape[1]], rng=rng, **({"settings": FAST, "n_folds": 5} | options)
    )


@pytest.fixture(scope="module")
def training():
    return train(*mixed(40, seed=1), name="six trees", version="7", provenance={"seed": "0"})


@pytest.fixture(scope="module")
def model(training):
    return training.model


# ---------------------------------------------------------------- training


def test_the_model_keeps_what_it_was_given(model):
    assert (model.name, model.version, model.classes, model.features) == ("six trees", "7", NAMES, FEATURES)
    assert model.provenance == {"seed": "0"}
    assert model.stumps.n_stumps == 120


def test_held_out_scans_are_calibrated(training):
    x, y = mixed(200, seed=2)
    said = training.model.classify(x)
    assert np.mean(said.label == y) > 0.75
    assert calibration_error(said.probability, y) < 0.06
    assert log_loss(training.probability, training.label) <= log_loss(training.uncalibrated, training.label)
    npt.assert_allclose(
        log_loss(said.probability, y), log_loss(training.probability, training.label), atol=0.15
    )


def test_boosting_to_certainty_is_brought_back_to_what_is_true():
    """Full stumps on classes that overlap are often wrong, and before calibration sure of it."""
    settings = BoostSettings(n_rounds=200)
    training = train(*mixed(25, seed=1, spread=1.5), settings=settings)
    x, y = mixed(200, seed=2, spread=1.5)
    raw = replace(training.model, temperature=1.0).classify(x).probability
    said = training.model.classify(x).probability
    assert training.model.temperature > 2.0
    assert calibration_error(said, y) < 0.08 < 0.25 < calibration_error(raw, y)
    assert log_loss(said, y) < 0.6 * log_loss(raw, y)


def test_known_species_are_rejected_as_rarely_as_asked(training):
    rule = training.model.rejection
    x, _ = mixed(300, seed=3)
    assert rule.asked == 0.05 and rule.n_measured == 240
    assert abs(rule.measured - 0.05) < 0.03
    assert training.model.classify(x).is_unknown.mean() < 0.08


def test_a_species_left_out_is_rejected_more_often():
    x, y = mixed(40, seed=1)
    x_test, y_test = mixed(100, seed=2)
    found = []
    for out in (0, 2, 5):
        said = train(x[y != out], y[y != out]).model.classify(x_test)
        found.append((said.is_unknown[y_test == out].mean(), said.is_unknown[y_test != out].mean()))
    strange, known = np.mean(found, axis=0)
    assert strange > 3.0 * known and known < 0.09


def test_what_is_no_tree_is_unknown(model):
    junk = np.random.default_rng(0).normal(0.0, 30.0, (100, 30))
    said = model.classify(junk)
    assert said.is_unknown.mean() > 0.97
    nothing = model.classify(np.full((1, 30), np.nan))
    assert nothing.is_unknown.all() and nothing.distance[0] == 5.0
    assert nothing.species == (None,) and np.isfinite(nothing.probability).all()


def test_a_feature_that_decides_nothing_makes_nobody_unknown():
    x, y = mixed(20, 3, 4, seed=1)
    x = np.column_stack([x, np.ones(len(y))])
    model = train(x, y).model
    moved = x.copy()
    moved[:, 4] = 1e6
    npt.assert_array_equal(model.classify(moved).distance, model.classify(x).distance)


def test_training_depends_on_the_seed_and_not_on_threads():
    x, y = mixed(12, seed=1)
    few = BoostSettings(n_rounds=20, max_features=0.3)
    one, same, other = (
        train(x, y, settings=few, seed=seed, n_threads=n) for seed, n in ((0, 1), (0, 3), (1, 1))
    )
    assert one.model.probabilities(x).tobytes() == same.model.probabilities(x).tobytes()
    assert one.probability.tobytes() == same.probability.tobytes()
    assert one.model.rejection == same.model.rejection
    assert one.model.probabilities(x).tobytes() != other.model.probabilities(x).tobytes()


def test_scans_of_one_tree_are_held_out_together():
    x, y = mixed(12, seed=1)
    tree = [f"{NAMES[k]} {j // 3}" for k, j in zip(y, np.arange(len(y)) % 12, strict=True)]
    training = train(x, y, trees=tree, settings=BoostSettings(n_rounds=5))
    folds = {}
    for name, fold in zip(tree, training.fold, strict=True):
        assert folds.setdefault(name, fold) == fold
    assert set(training.fold) == {0, 1, 2, 3, 4}
    size = Counter(folds.values())
    assert max(size.values()) - min(size.values()) <= 1


def test_two_species_and_two_trees_each_are_enough():
    x = np.array([[0.0], [0.1], [1.0], [1.1]])
    training = train_model(
        x, ["oak", "oak", "elm", "elm"], ["h"], rng=np.random.default_rng(0), settings=FAST
    )
    assert training.model.classify([[0.05], [1.05]]).label.tolist() == [1, 0]
    assert training.model.stumps.n_outputs == 1
    npt.assert_allclose(training.model.probabilities([[0.05]]).sum(), 1.0)


# ---------------------------------------------------------------- answers


def test_an_answer_is_the_same_bytes_alone_and_among_others(model):
    x, _ = mixed(7, seed=4)
    alone = [model.classify(row[None]) for row in x]
    said = model.classify(x)
    assert b"".join(each.probability.tobytes() for each in alone) == said.probability.tobytes()
    assert b"".join(each.distance.tobytes() for each in alone) == said.distance.tobytes()
    assert said.probability.tobytes() == model.probabilities(x).tobytes()


def test_species_are_named_unless_rejected(model):
    x, y = mixed(30, seed=5)
    said = model.classify(x)
    for name, label, unknown in zip(said.species, said.label, said.is_unknown, strict=True):
        assert name == (None if unknown else NAMES[label])
    npt.assert_array_equal(said.label, said.probability.argmax(axis=1))


def test_explanation_adds_up(model):
    x, _ = mixed(5, seed=6)
    for row in x:
        why = model.explain(row)
        said = model.probabilities(row[None])[0]
        first, second = np.argsort(-said)[:2]
        assert (why.species, why.against) == (NAMES[first], NAMES[second])
        npt.assert_allclose(why.log_odds, np.log(said[first] / said[second]), rtol=1e-9)
        npt.assert_allclose(why.base + sum(part for _, _, part in why.features), why.log_odds, atol=1e-9)
        parts = [part for _, _, part in why.features]
        assert parts == sorted(parts, reverse=True)
        assert len(why.features) == np.unique(model.stumps.feature).size
        values = {name: value for name, value, _ in why.features}
        for name, value in values.items():
            npt.assert_equal(value, row[FEATURES.index(name)])


def test_the_feature_that_tells_two_species_apart_speaks_for_the_answer():
    rng = np.random.default_rng(0)
    y = np.repeat([0, 1, 2], 30)
    x = rng.normal(size=(90, 3))
    x[:, 0] += 8.0 * (y > 0)  # ash against the others
    x[:, 1] += 8.0 * (y > 1)  # birch against cedar
    model = train(x, y, settings=BoostSettings(n_rounds=30)).model
    tells = {"ash": "feature_00", "cedar": "feature_01"}  # from birch
    why = model.explain([8.0, 0.0, 0.0])
    assert why.species == "birch"
    assert why.features[0][0] == tells[why.against] and why.features[0][2] > 0.0
    why = model.explain([0.0, 0.0, 0.0])
    assert why.species == "ash" and why.features[0][0] == "feature_00"
    why = model.explain([8.0, 8.0, 0.0])
    assert why.species == "cedar" and why.features[0][0] == "feature_01"


def test_explanation_of_two_species_is_one_sided():
    x, y = mixed(20, 2, seed=1)
    model = train(x, y, settings=BoostSettings(n_rounds=10)).model
    why = model.explain(x[0])
    said = model.probabilities(x[:1])[0]
    npt.assert_allclose(why.log_odds, np.log(said.max() / said.min()))
    npt.assert_allclose(why.base + sum(part for _, _, part in why.features), why.log_odds)


# ---------------------------------------------------------------- messages


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"species": ["oak"] * 3}, r"species must have one name per scan \(4\), got 3"),
        ({"species": ["oak"] * 4}, "species must name at least 2 species, got 1: oak"),
        (
            {"species": ["oak", "oak", "oak", "elm"]},
            "every species must have scans of at least 2 trees, got 1 of elm; add scans",
        ),
        ({"trees": [1, 1, 2, 3]}, "every species must have scans of at least 2 trees, got 1 of oak"),
        ({"trees": [1, 2, 2, 3]}, "a tree must be of one species, but 2 is oak and elm"),
        ({"trees": [1, 2, 3]}, r"trees must have one entry per scan \(4\), got 3"),
        ({"n_folds": 1}, "n_folds must be at least 2, got 1"),
        ({"false_rejection": 0.0}, "false_rejection must be over 0 and under 1, got 0.0"),
        ({"distance_share": 2.0}, "distance_share must be from 0 to 1, got 2.0"),
        ({"features": ["a", "b"]}, r"x must have shape \(samples, 2\), got \(4, 1\)"),
        ({"features": [""]}, "features must be 1 to 200 printable characters, got ''"),
        ({"name": "two\nlines"}, "name must be 1 to 200 printable characters, got 'two"),
        ({"x": [[np.inf], [1.0], [2.0], [3.0]]}, r"x must be finite or NaN, but x\[0, 0\] is inf"),
    ],
)
def test_wrong_training_is_refused(changed, message):
    given = {
        "x": np.arange(4.0)[:, None],
        "species": ["oak", "oak", "elm", "elm"],
        "features": ["height"],
        "rng": np.random.default_rng(0),
        "settings": BoostSettings(n_rounds=2),
    }
    with pytest.raises(InputError, match=message):
        train_model(**(given | changed))


def small(**changed):
    stumps = Stumps(
        n_features=1,
        intercept=[0.0],
        feature=[0],
        threshold=[1.0],
        missing_above=[False],
        above=[0.5],
        below=[-0.5],
        shared=[[True]],
        constant=[[0.0]],
        above_share=[0.5],
        gain=[0.1],
    )
    fields = {
        "name": "small",
        "version": "1",
        "classes": ("elm", "oak"),
        "features": ("height",),
        "stumps": stumps,
        "temperature": 0.5,
        "span": FeatureRange([[0.0], [2.0]], [[1.0], [1.0]]),
        "rejection": Rejection(0.1, 2.0, 0.05, 0.05, 10),
    }
    return SpeciesModel(**(fields | changed))


def test_a_model_by_hand():
    said = small().classify([[2.0], [5.0], [0.0]])
    high = 1.0 / (1.0 + np.exp(-2.0))  # scores 0.5 and -0.5 at temperature 0.5
    npt.assert_allclose(said.probability, [[1 - high, high], [1 - high, high], [high, 1 - high]])
    npt.assert_allclose(said.distance, [0.0, 3.0, 0.0])
    npt.assert_allclose(said.score, 0.5)
    assert said.species == ("oak", None, "elm")
    why = small().explain([2.0])
    assert (why.species, why.against) == ("oak", "elm")
    npt.assert_allclose([why.log_odds, why.base], [2.0, 0.0])
    assert why.features[0][:2] == ("height", 2.0)


@pytest.mark.parametrize(
    "changed, message",
    [
        ({"classes": ("elm",)}, "classes must be at least 2, got 1"),
        ({"classes": ("elm", "elm")}, "classes must differ from each other, but 'elm' comes twice"),
        ({"classes": ("elm", "oak", "yew")}, "stumps must be for 1 features and 3 outputs, got 1 and 1"),
        ({"features": ("a", "b")}, "stumps must be for 2 features and 1 outputs, got 1 and 1"),
        ({"temperature": 0.0}, "temperature must be from 0.001 to 1000.0, got 0.0"),
        ({"temperature": np.nan}, "temperature must be from 0.001 to 1000.0, got nan"),
        ({"span": FeatureRange([[0.0]], [[1.0]])}, r"span must have shape \(2, 1\), got \(1, 1\)"),
        ({"version": 3}, "version must be 1 to 200 printable characters, got '3'"),
        ({"provenance": {"seed": 3}}, "provenance must be 1 to 2000 printable characters, got '3'"),
        ({"provenance": {"": "x"}}, "provenance must be 1 to 200 printable characters, got ''"),
    ],
)
def test_wrong_models_are_refused(changed, message):
    with pytest.raises(InputError, match=message):
        small(**changed)
