"""The spatial vote of thesis 3.5.1: by hand, against a slow reference, and what it must not depend on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from classify.vote import MOST_RATIO, is_confident, reliable_ratio, vote_species
from treegraph import InputError

NAN = np.nan


def reference_vote(position, probability, reach=25.0, ratio=1.5, score="own"):
    """Slow and obvious: every tree looks at every other one."""
    place = np.asarray(position, float)
    n, c = np.shape(probability)
    rows = [None if np.isnan(row).any() or max(row) <= 0 else list(row) for row in np.asarray(probability)]

    def two_highest(row):
        return [*sorted(row, reverse=True), 0.0][:2]

    def margin(i):
        if rows[i] is None:
            return -1.0
        first, second = two_highest(rows[i])
        return first / second if second > 0 else np.inf

    def confident(i):
        return rows[i] is not None and two_highest(rows[i])[0] > ratio * two_highest(rows[i])[1]

    def near(i, j):
        known = np.isfinite(place[[i, j]]).all()
        return i != j and known and np.hypot(*(place[i, :2] - place[j, :2])) <= reach

    label, n_voters = [], []
    for i in range(n):
        mine = -1 if rows[i] is None else int(np.argmax(rows[i]))
        others = [] if confident(i) else [j for j in range(n) if near(i, j) and rows[j] is not None]
        voters = [j for j in others if confident(j)] or [j for j in others if margin(j) > margin(i)]
        n_voters.append(len(voters))
        if voters:
            best = [int(np.argmax(rows[j])) for j in voters]
            own = rows[i] or [0.0] * c

            def value(s, best=best, voters=voters, own=own):
                if score == "own":
                    return own[s]
                return sum(sorted(rows[j][s] for j, b in zip(voters, best, strict=True) if b == s))

            mine = max(set(best), key=lambda s, best=best: (value(s), best.count(s), -s))
        label.append(mine)
    return label, n_voters


# ---------------------------------------------------------------- by hand


def test_confident_is_more_than_one_and_a_half():
    """h1 > 1.5 h2, not >=; nothing known is not confident."""
    rows = [[0.6, 0.4, 0.0], [0.75, 0.25, 0.0], [0.3, 0.2, 0.1], [NAN, 0.5, 0.1], [0, 0, 0], [0, 0, 1e-9]]
    assert is_confident(rows).tolist() == [False, True, False, False, False, True]
    assert is_confident([[0.6, 0.4]], ratio=1.4).tolist() == [True]
    assert is_confident([[0.2], [0.0], [NAN]]).tolist() == [True, False, False]


def test_a_tree_in_doubt_takes_the_species_around_that_it_finds_most_probable():
    doubt = [0.40, 0.35, 0.25]
    sure = [[0.0, 0.1, 0.9], [0.0, 0.9, 0.1], [0.1, 0.1, 0.8]]
    vote = vote_species([[0, 0], [5, 0], [0, 5], [5, 5]], [doubt, *sure])
    assert vote.label.tolist() == [1, 2, 1, 2]  # 0 is no candidate; of 1 and 2 it finds 1 more probable
    assert vote.changed.tolist() == [True, False, False, False]
    assert vote.n_voters.tolist() == [3, 0, 0, 0]
    assert vote_species([[0, 0], [5, 0], [0, 5], [5, 5]], [doubt, *sure], score="neighbours").label[0] == 2
    assert repr(vote) == "<Vote 4 trees, 1 in doubt, 1 changed>"


def test_confident_trees_are_not_asked():
    vote = vote_species([[0, 0], [1, 0], [2, 0]], [[0.61, 0.39], [0, 1], [0, 1]])
    assert vote.label.tolist() == [0, 1, 1]
    assert not vote.changed.any()
    assert vote.is_confident.all()


def test_confident_neighbours_come_first():
    """A far confident tree decides against nearer ones that are only more reliable."""
    place = [[0, 0], [1, 0], [1, 1], [24, 0]]
    probability = [[0.50, 0.48, 0.02], [0.2, 0.5, 0.4], [0.2, 0.5, 0.4], [0.0, 0.1, 0.9]]
    assert vote_species(place, probability).label.tolist()[0] == 2
    without = vote_species(place[:3], probability[:3])
    assert without.label.tolist() == [1, 1, 1]
    assert without.n_voters.tolist() == [2, 0, 0]  # the more reliable two do not move each other


@pytest.mark.parametrize("distance, label", [(25.0, 1), (np.nextafter(25.0, 26.0), 0), (24.9, 1), (26.0, 0)])
def test_the_reach_is_25_metres(distance, label):
    vote = vote_species([[100, 0], [100, distance]], [[0.5, 0.5], [0.1, 0.9]])
    assert vote.label.tolist() == [label, 1]


def test_distance_is_horizontal():
    vote = vote_species([[0, 0, 0], [7, 0, 900.0]], [[0.5, 0.4], [0.1, 0.9]])
    assert vote.label.tolist() == [1, 1]


def test_ties_go_to_more_voters_then_to_the_lower_column():
    place = np.zeros((4, 2))
    equal = [0.1, 0.3, 0.3, 0.3]
    sure = np.eye(4)
    assert vote_species(place, [equal, sure[3], sure[2], sure[3]]).label[0] == 3
    assert vote_species(place[:3], [equal, sure[3], sure[2]]).label[0] == 2
    assert vote_species([[0, 0]], [[0.2, 0.4, 0.4]]).label.tolist() == [1]


def test_a_tree_of_which_nothing_is_known_follows_and_does_not_vote():
    nothing = [NAN, NAN, NAN]
    place = np.zeros((4, 2))
    vote = vote_species(place, [nothing, [0, 1, 0], [0, 0, 1], [0, 0, 1]])
    assert vote.label.tolist() == [2, 1, 2, 2]
    assert vote.changed.tolist() == [True, False, False, False]
    alone = vote_species(place[:2], [nothing, [0, 0, 0]])
    assert alone.label.tolist() == [-1, -1]
    assert not alone.changed.any()
    assert vote_species(place[:2], [nothing, [0.3, 0.4, 0.3]]).label.tolist() == [1, 1]


def test_unknown_places_have_no_neighbours():
    place = [[0, 0, 0], [NAN, 0, 0], [0, np.inf, 0], [0, 0, NAN]]
    vote = vote_species(place, [[0.5, 0.45], [0, 1], [0.5, 0.45], [0, 1]])
    assert vote.label.tolist() == [0, 1, 0, 1]
    assert vote.n_voters.tolist() == [0, 0, 0, 0]


def test_no_trees():
    vote = vote_species(np.zeros((0, 2)), np.zeros((0, 3)))
    assert vote.label.shape == (0,)
    assert vote.label.dtype == np.int32


def test_nothing_can_be_written():
    vote = vote_species([[0, 0]], [[1.0, 0.0]])
    with pytest.raises(ValueError, match="read-only"):
        vote.label[0] = 1


# ---------------------------------------------------------------- against the slow reference


def random_trees(rng, n, n_species, *, crowded=True):
    """Trees with doubts, ties, unknown rows, unknown and equal places."""
    place = rng.integers(0, 12, (n, 2)) * 5.0 if crowded else rng.random((n, 2)) * 120.0
    probability = (
        rng.integers(0, 6, (n, n_species)) / 10.0 if crowded else rng.dirichlet([0.5] * n_species, n)
    )
    probability[rng.random(n) < 0.1] = NAN
    probability[rng.random(n) < 0.1] = 0.0
    place[rng.random(n) < 0.05] = NAN
    return place, probability


@pytest.mark.parametrize("score", ["own", "neighbours"])
@given(seed=st.integers(0, 10**6), n=st.integers(1, 40), n_species=st.integers(1, 5), crowded=st.booleans())
@settings(deadline=None, max_examples=60)
def test_matches_reference(score, seed, n, n_species, crowded):
    place, probability = random_trees(np.random.default_rng(seed), n, n_species, crowded=crowded)
    vote = vote_species(place, probability, score=score)
    label, n_voters = reference_vote(place, probability, score=score)
    assert vote.label.tolist() == label
    assert vote.n_voters.tolist() == n_voters


@pytest.mark.parametrize("score", ["own", "neighbours"])
def test_order_and_place_on_the_map_mean_nothing(score):
    rng = np.random.default_rng(3)
    place, probability = random_trees(rng, 3000, 4)
    vote = vote_species(place, probability, score=score)
    order = rng.permutation(3000)
    again = vote_species(place[order], probability[order], score=score)
    assert again.label.tolist() == vote.label[order].tolist()
    moved = vote_species(place + [4_500_000.0, 5_400_000.0], probability, score=score)
    assert moved.label.tolist() == vote.label.tolist()


def test_pieces_of_work_do_not_show(monkeypatch):
    rng = np.random.default_rng(5)
    place, probability = random_trees(rng, 2000, 5, crowded=False)
    whole = vote_species(place, probability)
    monkeypatch.setattr("classify.vote.MAX_PAIRS", 50)
    pieces = vote_species(place, probability)
    assert pieces.label.tolist() == whole.label.tolist()
    assert pieces.n_voters.tolist() == whole.n_voters.tolist()


def test_the_vote_helps_where_one_species_stands_together():
    """Streets of one species: fewer errors after the vote. Any species anywhere: hardly a gain."""
    rng = np.random.default_rng(0)
    n, n_species = 4000, 12
    place = rng.random((n, 2)) * 600.0
    street = (place[:, 0] // 100).astype(int) * 6 + (place[:, 1] // 100).astype(int)
    for layout, least_gain in (("streets", 0.05), ("mixed", -0.05)):
        true = rng.integers(0, n_species, 36)[street] if layout == "streets" else rng.integers(0, 12, n)
        score = rng.normal(size=(n, n_species))
        score[np.arange(n), true] += 2.5
        probability = np.exp(score) / np.exp(score).sum(axis=1, keepdims=True)
        before = (probability.argmax(axis=1) == true).mean()
        after = (vote_species(place, probability).label == true).mean()
        assert after - before > least_gain
        if layout == "mixed":
            assert after - before < 0.01


# ---------------------------------------------------------------- what is refused

FINE = [[0.5, 0.5], [0.1, 0.9]]
TWO = np.zeros((2, 2))


@pytest.mark.parametrize(
    "position, probability, options, message",
    [
        ([[0, 0]], FINE, {}, r"position must have shape \(2, 2\) or \(2, 3\) to match .*, got \(1, 2\)"),
        (np.zeros((2, 4)), FINE, {}, r"got \(2, 4\)"),
        (TWO, [0.5, 0.5], {}, r"probability must have shape \(n, c\) with c > 0, got \(2,\)"),
        (TWO, np.zeros((2, 0)), {}, r"got \(2, 0\)"),
        (TWO, [[0.5, 0.5], [-0.1, 0.9]], {}, r"must be >= 0 and finite, got -0.1 in row 1 \(1 such rows\)"),
        (TWO, [[0.5, np.inf], [0.1, 0.9]], {}, r"must be >= 0 and finite, got inf in row 0"),
        (TWO, FINE, {"reach": -1.0}, r"reach must be a finite number of metres >= 0, got -1.0"),
        (TWO, FINE, {"reach": np.inf}, r"reach must be a finite number .* got inf"),
        (TWO, FINE, {"ratio": 0.5}, r"ratio must be a finite number >= 1, got 0.5"),
        (TWO, FINE, {"score": "all"}, r"score must be one of own, neighbours, got 'all'"),
    ],
)
def test_refusals(position, probability, options, message):
    with pytest.raises(InputError, match=message):
        vote_species(position, probability, **options)


# ---------------------------------------------------------------- the ratio learnt


def slow_ratio(probability, label, share):
    """Every ratio between rows that are right and wrong, from the least on."""
    rows = [
        sorted(row, reverse=True) for row in probability.tolist() if not np.isnan(row).any() and max(row) > 0
    ]
    pick = [
        int(k) for k in range(len(label)) if not np.isnan(probability[k]).any() and probability[k].max() > 0
    ]
    right = [int(probability[k].argmax()) == label[k] for k in pick]
    ratio = [np.inf if row[1] == 0.0 else row[0] / row[1] for row in rows]
    for least in sorted({1.5} | {min(max(r, 1.5), 1000.0) for r in ratio}):
        sure = [ok for r, ok in zip(ratio, right, strict=True) if r > least]
        if sure and np.mean(sure) >= share:
            return least
    return 1000.0


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9, 0.99, 1.0])
@pytest.mark.parametrize("seed", range(12))
def test_the_least_ratio_that_is_reliable(seed, share):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 80))
    probability = rng.dirichlet(np.full(4, 0.3), n)
    label = np.where(rng.random(n) < 0.8, probability.argmax(axis=1), rng.integers(0, 4, n))
    probability[rng.random(n) < 0.1] = np.nan
    probability[rng.random(n) < 0.1] = np.eye(4)[1]
    got = reliable_ratio(probability, label, share)
    assert got == pytest.approx(slow_ratio(probability, label, share), rel=1e-12)
    sure = is_confident(probability, got)
    if got < MOST_RATIO:
        assert (probability.argmax(axis=1) == label)[sure].mean() >= share


def test_a_ratio_is_learnt_from_wrong_answers_that_look_sure():
    """Nine of ten are right; the wrong ones are up to four times as probable as the next."""
    first = np.concatenate([np.linspace(0.82, 0.99, 90), np.linspace(0.6, 0.8, 10)])
    label = np.concatenate([np.zeros(90, int), np.ones(10, int)])
    probability = np.stack([first, 1.0 - first], axis=1)
    assert reliable_ratio(probability, label, 1.0) == pytest.approx(4.0)
    assert reliable_ratio(probability, label, 0.9) == 1.5


def test_answers_that_are_all_right_need_no_more_than_the_published_ratio():
    assert reliable_ratio([[0.9, 0.1], [0.75, 0.25]], [0, 0]) == 1.5
    assert reliable_ratio([[1.0, 0.0]], [0]) == 1.5
    assert reliable_ratio([[0.7], [0.2]], [0, 0]) == 1.5


def test_a_share_that_is_just_reached_is_enough():
    probability = [[0.9, 0.1]] * 100
    assert reliable_ratio(probability, [0] * 55 + [1] * 45, 0.55) == 1.5


def test_no_ratio_is_enough():
    assert reliable_ratio([[1.0, 0.0]], [1]) == MOST_RATIO
    assert reliable_ratio(np.empty((0, 3)), np.empty(0, int)) == MOST_RATIO


@pytest.mark.parametrize(
    "label, share, message",
    [
        ([0.0], 0.9, r"label must be 1 whole numbers to match probability, got \(1,\)"),
        ([0, 1], 0.9, r"label must be 1 whole numbers to match probability, got \(2,\)"),
        ([0], 1.1, "share must be from 0 to 1, got 1.1"),
        ([0], np.nan, "share must be from 0 to 1, got nan"),
    ],
)
def test_ratios_that_cannot_be_learnt(label, share, message):
    with pytest.raises(InputError, match=message):
        reliable_ratio([[0.6, 0.4]], label, share)
