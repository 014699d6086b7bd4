"""What a fit chooses on its way: searches, points of the survey, first guesses, and its own checkpoint."""

import math
from types import SimpleNamespace

import numpy as np
import numpy.testing as npt
import pytest
from inverse_trees import grown

from inverse import (
    AnnealingSettings,
    EvolutionSettings,
    Weights,
    describe_tree,
    fit_trees,
    guess_parameters,
    search_space,
)
from inverse.crowns import _thicken
from inverse.evolution import APART, Evolution, Search, _begin, _breed, _finish, _give_up, soften
from inverse.fitting import _Clock
from inverse.prior import first_point, survey_points, thickened
from inverse.runs import Time
from inverse.trials import Judge
from treegraph import InputError, TreeGraph

TARGET = grown("F6b", 8, 1)
SPACE = search_space(float(np.ptp(TARGET.position[:, 2])))
N = SPACE.n_free


class Known:
    """In place of trees: how far a point is from one that is known. Each trial is remembered."""

    samples, seed, space = 4, 7, SPACE

    def __init__(self):
        self.asked = []

    def trial(self, point, key, softness=1.0):
        self.asked.append((point.tolist(), key, softness))
        return SimpleNamespace(point=point, plain=np.full(4, abs(point[0] - 0.3)))

    def settle_all(self, trial):
        return float(trial.plain.sum())


def run_at(*places):
    return Evolution(0, [Search(np.full(N, x)) for x in places], np.full(N, 0.1), found=None)


# ---------------------------------------------------------------- searches


def test_the_nearer_half_of_the_searches_goes_on():
    judge, run = Known(), run_at(0.9, 0.35, 0.5, 0.31)
    _give_up(judge, run, 0.3)
    npt.assert_allclose([search.point[0] for search in run.searches], [0.31, 0.35])
    assert run.evaluations == 4 * 16 == 4 * len(judge.asked)  # of four trees each
    keys = [
        [key for point, key, _ in judge.asked if abs(point[0] - x) < 1e-9] for x in (0.9, 0.35, 0.5, 0.31)
    ]
    assert keys[0] == keys[1] == keys[2] == keys[3]  # the same trees for all
    assert len(set(keys[0])) == 4
    assert {softness for *_, softness in judge.asked} == {soften(0.3)}


@pytest.mark.parametrize("now, past, want", [(0.5, [0.6, 0.35, 0.9], 0.35), (0.31, [0.6, 0.35], 0.31)])
def test_the_result_is_the_nearest_of_now_and_before(now, past, want):
    judge, run = Known(), run_at(now)
    run.past = [[x] * N for x in past]
    _finish(judge, run)
    npt.assert_allclose(run.point, want)
    assert run.past == []
    assert run.curve[-1][1] == pytest.approx(abs(want - 0.3))
    assert {softness for *_, softness in judge.asked} == {1.0}


def test_searches_begin_at_the_nearest_points_that_are_apart():
    places = [0.9, 0.31, 0.31 + 0.5 * APART, 0.5, 0.7, 0.1]
    run = run_at(0.5)
    run.found = [(0.0, [x] * N) for x in places]
    _begin(Known(), run)
    npt.assert_allclose([search.point[0] for search in run.searches], [0.31, 0.1, 0.5, 0.7])
    assert run.found is None


@pytest.mark.parametrize("share", [0.2, 0.9])
def test_a_generation_is_as_soft_as_its_share_says(share):
    class Listening(Judge):
        def trial(self, point, key, softness=1.0):
            said.append(softness)
            return super().trial(point, key, softness)

    said = []
    settings = EvolutionSettings(evaluations=1000, samples=4, population=4)
    _breed(Listening([TARGET], SPACE, samples=4, seed=7), settings, run_at(0.4), share)
    assert said == [soften(share)] * 4


# ---------------------------------------------------------------- survey and thickness


def test_survey_has_the_height_of_the_target():
    """Of the very trees by which it was made; without the change of internodes it has not."""
    judge = Judge([TARGET], SPACE, samples=4, seed=7)
    guess, spread = first_point(SPACE, judge.targets)
    points = survey_points(judge, guess, spread, 30, np.random.default_rng(0))
    found = np.array([size.height for size in judge.sizes(points, (1 << 32,)) if size.pieces])
    off = np.abs(np.log(found / float(TARGET.position[:, 2].max())))
    assert np.median(off) < 0.02


def test_survey_keeps_those_with_as_many_branches(monkeypatch):
    off = []
    for drawn in (4, 1):
        monkeypatch.setattr("inverse.prior.DRAWN", drawn)
        judge = Judge([TARGET], SPACE, samples=4, seed=7)
        guess, spread = first_point(SPACE, judge.targets)
        points = survey_points(judge, guess, spread, 25, np.random.default_rng(0))
        sizes = judge.sizes(points, (1 << 32,))
        pieces = judge.targets[0].pieces.n_pieces
        off.append(np.median([abs(math.log(max(size.pieces, 1) / pieces)) for size in sizes]))
    assert off[0] < 0.5 * off[1]


def test_thickened_point_has_the_wood_of_the_target():
    thick = TARGET.replace(radius=10.0 * TARGET.radius)
    space = search_space(float(np.ptp(TARGET.position[:, 2])), tip_radius=(1e-4, 0.2))
    judge = Judge([thick], space, samples=4, seed=7)
    point, _ = first_point(space, judge.targets)
    point[-1] = 0.1  # thin as nothing
    wanted = judge.targets[0].pieces.length @ judge.targets[0].pieces.thickness

    def wood(at):
        return np.mean([judge.sizes([at], (0, k))[0].wood for k in range(6)])

    made = thickened(judge, point, (0,))
    assert wood(point) < 0.1 * wanted
    npt.assert_allclose(wood(made), wanted, rtol=0.02)
    npt.assert_array_equal(made[:-1], point[:-1])


def test_share_of_a_tip_by_hand():
    """Radius over internode length, both in the middle of logarithms; held to what the model takes."""
    space = search_space(10.0, tip_radius=(0.001, 0.1))
    point = np.full(space.n_free, 0.5)
    npt.assert_allclose(space.tip_share(point), 0.01 / math.sqrt(0.05 * 2.5))
    point[-1] = 1.0
    assert space.tip_share(point) == 0.2
    assert search_space(10.0).tip_share(np.full(25, 0.5)) is None


def test_new_branches_are_as_thick_as_pipes():
    """Two tips on a branch: each half of its section by the exponent 2.49 (Eq. 5.6)."""
    radius = _thicken(np.array([-1, 0, 1, 1], np.int32), np.array([0.1, 0.1, 0.0, 0.0]), 2)
    npt.assert_allclose(radius, [0.1, 0.1, 0.1 * 0.5 ** (1 / 2.49), 0.1 * 0.5 ** (1 / 2.49)])


# ---------------------------------------------------------------- first guess


def tree_of_forks():
    """A twig at 0.5 m on a trunk that forks at 2 m: straight on, at 40 degrees, and two that hang."""
    side, hang = np.radians(40), np.radians(120)
    rows = [(-1, (0, 0, 0)), (0, (0, 0, 0.5)), (1, (0.05, 0, 0.5)), (1, (0, 0, 2)), (3, (0, 0, 4))]
    rows += [(3, (np.sin(side), 0, 2 + np.cos(side)))]
    rows += [(3, (0, y * np.sin(hang), 2 + np.cos(hang))) for y in (1, -1)]
    rows += [(4 + k % 4, None) for k in range(100)]  # tips, so that a twig is one of many
    position = [place for _, place in rows if place is not None]
    rng = np.random.default_rng(0)
    for above, place in rows:
        if place is None:
            position.append(np.array(position[above]) + 0.01 * rng.normal(size=3))
    return TreeGraph([above for above, _ in rows], position, np.full(len(rows), 0.01))


def test_crown_begins_above_a_stray_twig():
    npt.assert_allclose(guess_parameters([describe_tree(tree_of_forks())])["LB_PF"], 0.9 * 2.0)


def test_what_hangs_is_no_branching_angle_and_buds_are_side_branches():
    tree = tree_of_forks()
    bare = TreeGraph(tree.parent[:8], tree.position[:8], tree.radius[:8])
    guess = guess_parameters([describe_tree(bare)])
    side = [np.degrees(np.pi / 2), 40.0]  # the twig's and the branch's
    npt.assert_allclose(guess["BAM"], np.median(side))
    npt.assert_allclose(guess["NLB"], np.median([2, 4]) - 1)


# ---------------------------------------------------------------- whose checkpoint it is


@pytest.mark.parametrize(
    "change",
    [
        {"weights": Weights(0.5, 0.25, 0.25)},
        {"fixed": {"NLB": 2}},
        {"bounds": {"BAM": (30, 60)}},
        {"seed": 1},
        {"runs": 2},
        {"tip_share": 0.02},
        {"settings": EvolutionSettings(evaluations=2, samples=4, population=4)},
        {"method": "annealing", "settings": AnnealingSettings(iterations=1, samples=1)},
        {"trees": [grown("F6b", 8, 2)]},
        {"trees": [TARGET.replace(radius=1.1 * TARGET.radius)]},
        {"trees": [TARGET, TARGET]},
    ],
)
def test_checkpoint_of_another_fit(change, tmp_path):
    how = {"trees": [TARGET], "settings": EvolutionSettings(evaluations=1, samples=4, population=4)}
    how["checkpoint"] = tmp_path / "state.json"
    fit_trees(**how)
    kept = how["checkpoint"].read_bytes()
    with pytest.raises(InputError, match="this checkpoint is of a fit of other trees or settings"):
        fit_trees(**(how | change))
    assert how["checkpoint"].read_bytes() == kept


# ---------------------------------------------------------------- time


def test_runs_share_the_time_and_what_one_leaves(monkeypatch):
    """Twelve seconds for three runs; the first takes two of its four, the next ones have five each."""
    now = [100.0]
    monkeypatch.setattr("inverse.fitting.monotonic", lambda: now[0])
    monkeypatch.setattr("inverse.runs.monotonic", lambda: now[0])
    clock = _Clock(12.0, 3)
    assert clock.of(0) == Time(4.0, 4.0)
    now[0] += 2.0
    assert clock.share(0, 0.1) == 0.5
    assert clock.share(0, 0.9) == 0.9
    assert clock.of(1) == Time(5.0, 5.0)
    now[0] += 9.0
    assert clock.of(2) == Time(1.0, 1.0)
    now[0] += 5.0
    assert clock.of_all() == Time(12.0, -4.0)
