"""Fits: the chain that full evaluation gives, the same on any number of workers, broken off and resumed."""

import json
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.testing as npt
import pytest
from inverse_trees import grown

from inverse import (
    AnnealingSettings,
    EvolutionSettings,
    compare_trees,
    describe_tree,
    fit_trees,
    guess_parameters,
    guess_tip_share,
    search_space,
)
from inverse.annealing import Chain, anneal, propose, start_chain
from inverse.evolution import Evolution, Search, _adapt, _root, evolve, rank, reflected, soften
from inverse.prior import first_point, survey_points
from inverse.runs import Time
from inverse.structure import bounds_of, distance_of
from inverse.trials import BOUNDED, EXACT, Judge, is_no_farther
from species import find_preset, grow
from treegraph import InputError, TreeGraph

TARGET = grown("F6b", 8, 1)
SPACE = search_space(float(np.ptp(TARGET.position[:, 2])))
QUICK = EvolutionSettings(evaluations=150, samples=4, population=6)


def judge(**how):
    return Judge([TARGET], SPACE, **{"samples": 4, "seed": 7} | how)


# ---------------------------------------------------------------- trials


def test_trial_is_the_distance_of_grown_trees():
    """By hand: grow from the same numbers and compare."""
    one = judge()
    preset = find_preset("F6b")
    trial = one.trial(SPACE.encode(preset.parameters, 8), (3, 5))
    parameters, age = SPACE.decode(trial.point)
    trees = [grow(parameters, age, rng=np.random.default_rng([7, 3, 5, j])).tree for j in range(4)]
    want = [compare_trees(TARGET, tree).distance for tree in trees]
    assert not trial.is_exact
    npt.assert_allclose(one.settle_all(trial), sum(want))
    npt.assert_allclose(trial.low, want)
    assert trial.is_exact
    assert (one.grown, one.compared) == (4, 4)
    npt.assert_allclose(one.mean_distance(trial), np.mean(want))


@pytest.mark.parametrize("seed", range(6))
def test_bounds_hold(seed):
    one = judge()
    trial = one.trial(np.random.default_rng(seed).random(25), (0, 1))
    one.bound((trial, j) for j in range(4))
    low, high = trial.low.copy(), trial.high.copy()
    assert (low <= high).all()
    one.settle_all(trial)
    assert (low <= trial.low + 1e-12).all()
    assert (trial.low <= high + 1e-12).all()


def test_bounds_of_the_structure():
    """Of trees of many kinds and sizes, both ways round."""
    trees = [
        grown(kind, age, 1) for kind, age in (("F6b", 4), ("F6b", 9), ("F6d", 9), ("F6a", 6), ("F6e", 7))
    ]
    trees.append(TreeGraph([-1], [[0, 0, 0]], [0.1]))
    edits = [describe_tree(tree).edit for tree in trees]
    gaps = []
    for one in edits:
        for two in edits:
            low, high = bounds_of(one, two)
            assert 0.0 <= low <= distance_of(one, two) + 1e-12 <= high + 2e-12
            gaps.append(low)
    assert max(gaps) > 0.1


def test_several_targets_count_by_their_mean():
    other = grown("F6b", 8, 2)
    both = Judge([TARGET, other], SPACE, samples=2, seed=7)
    alone = [Judge([tree], SPACE, samples=2, seed=7) for tree in (TARGET, other)]
    point = np.full(25, 0.4)
    want = np.mean([one.settle_all(one.trial(point, (0, 1))) for one in alone])
    npt.assert_allclose(both.settle_all(both.trial(point, (0, 1))), want)


def test_tree_that_outgrows_the_limit_is_as_far_as_can_be():
    small = judge(max_nodes=10)
    trial = small.trial(SPACE.encode(find_preset("F6b").parameters, 20), (0, 1))
    assert small.settle_all(trial) == 4.0
    assert small.compared == 0


@pytest.mark.parametrize("seed", range(8))
def test_decision_is_that_of_the_exact_sums(seed):
    rng = np.random.default_rng(seed)
    one = judge()
    points = rng.random((2, 25))
    exact = [one.settle_all(one.trial(point, (0, k))) for k, point in enumerate(points)]
    gap = exact[0] - exact[1]
    for slack in (0.0, 0.5, max(gap - 1e-4, 0.0), max(gap + 1e-4, 0.0), 4.0):
        trial, current = (one.trial(point, (0, k)) for k, point in enumerate(points))
        assert is_no_farther(one, trial, current, slack) == (exact[0] <= exact[1] + slack)


def test_decision_takes_no_more_than_it_needs():
    one = judge()
    trial, current = (one.trial(np.full(25, x), (0, k)) for k, x in enumerate((0.3, 0.5)))
    assert is_no_farther(one, trial, current, 4.0 + 1e-6)
    assert (one.grown, one.compared) == (0, 0)


# ---------------------------------------------------------------- annealing


def test_temperature():
    """4 at first, 0 at last, linear between (section 5.4)."""
    settings = AnnealingSettings()
    assert (settings.iterations, settings.samples) == (7500, 8)
    assert settings.temperature(0) == 4.0
    assert settings.temperature(7499) == 0.0
    npt.assert_allclose(settings.temperature(7499 / 4), 3.0)


def test_lazy_chain_is_the_chain_of_full_evaluation():
    chains, judges = [], []
    for lazy in (True, False):
        judges.append(judge())
        settings = AnnealingSettings(iterations=60, samples=4, hottest=0.5, report_every=20, lazy=lazy)
        chains.append(anneal(judges[-1], settings, start_chain(judges[-1], 0)))
    assert chains[0].to_dict() == chains[1].to_dict()
    assert 0 < chains[0].accepted < 60
    assert judges[0].compared < judges[1].compared


def test_metropolis_hastings_by_hand():
    """Accept if u <= (p' / p)^(1 / zeta), p = exp(-sum of distances), Eq. 10 and 11."""
    one = judge()
    settings = AnnealingSettings(iterations=25, samples=4, hottest=1.0, report_every=100)
    chain = start_chain(one, 2)
    point = np.array(chain.point)
    total = one.settle_all(one.trial(point, (2, 0)))
    accepted = 0
    for i in range(25):
        rng = np.random.default_rng([7, 2, i])
        u = 1.0 - rng.random()
        proposed = propose(point, settings, rng)
        new = one.settle_all(one.trial(proposed, (2, i + 1)))
        zeta = 1.0 * (1.0 - i / 24)
        chance = (math.exp(-new) / math.exp(-total)) ** (1.0 / zeta) if zeta > 0 else float(new <= total)
        if u <= chance:
            point, total, accepted = proposed, new, accepted + 1
    found = anneal(judge(), settings, chain)
    assert found.accepted == accepted
    npt.assert_array_equal(found.point, point)


def test_proposal_stays_inside_and_is_symmetric():
    settings = AnnealingSettings(step=0.6, share=0.5)
    rng = np.random.default_rng(0)
    points = np.array([propose(np.full(5, 0.05), settings, rng) for _ in range(4000)])
    assert ((points >= 0.0) & (points <= 1.0)).all()
    assert ((points != 0.05).any(axis=1)).all()
    there = np.array([propose(np.array([0.1]), settings, rng)[0] for _ in range(20000)])
    back = np.array([propose(np.array([0.7]), settings, rng)[0] for _ in range(20000)])
    npt.assert_allclose((np.abs(there - 0.7) < 0.05).mean(), (np.abs(back - 0.1) < 0.05).mean(), atol=0.012)


# ---------------------------------------------------------------- evolution


def test_evolution_finds_the_least_of_a_known_function():
    """An ellipsoid in place of trees: the strategy itself."""
    aim = np.linspace(0.2, 0.8, 8)
    search, spread = Search(np.full(8, 0.5)), np.full(8, 0.2)
    scale = np.linspace(1.0, 30.0, 8)
    rng = np.random.default_rng(0)
    for _ in range(300):
        root = _root(search.covariance)
        steps = rng.standard_normal((12, 8)) @ root.T
        points = search.mean + search.sigma * spread * steps
        order = np.argsort([((scale * (reflected(p) - aim)) ** 2).sum() for p in points])
        _adapt(search, spread, steps[order], root)
        search.generation += 1
    npt.assert_allclose(search.point, aim, atol=1e-4)


@pytest.mark.parametrize("softness", [1.0, 3.0])
def test_rank_is_that_of_one_tree_each_where_it_matters(softness):
    one, full = judge(samples=8), judge(samples=8)
    points = [np.random.default_rng(k).random(25) for k in range(8)]
    order, cost, best = rank(one, [one.trial(point, (0, 1), softness) for point in points])
    table = [full.trial(point, (0, 1), softness) for point in points]
    full.settle((trial, 0) for trial in table)
    assert order[:4] == sorted(range(8), key=lambda k: table[k].low[0])[:4]
    npt.assert_allclose(best, np.mean([table[k].plain[0] for k in order[:2]]))
    assert one.grown == cost == 8
    assert one.compared <= full.compared


def test_rank_looks_closely_at_the_best():
    one, full = judge(samples=8), judge(samples=8)
    trials = [one.trial(np.random.default_rng(k).random(25), (0, 1)) for k in range(8)]
    order, cost, best = rank(one, trials, closely=True)
    assert sorted(order) == list(range(8))
    assert cost == 8 + 4 * 3 + 2 * 4 == one.grown
    assert [int((trials[k].known == EXACT).sum()) for k in order[:4]] == [8, 8, 4, 4]
    npt.assert_allclose(best, np.mean([trials[k].low.mean() for k in order[:2]]))
    table = np.array([full.settle_all(again) and again.low for again in (
        full.trial(trials[k].point, (0, 1)) for k in range(8))])  # fmt: skip
    left = sorted(range(8), key=lambda k: table[k, 0])[:4]
    left.sort(key=lambda k: table[k, :4].sum())
    assert order[:4] == sorted(left[:2], key=lambda k: table[k].sum()) + left[2:]


def test_softness_falls_to_none():
    assert soften(0.0) == 5.0
    assert soften(0.4) == pytest.approx(5.0**0.5)
    assert soften(0.8) == soften(1.0) == 1.0


def test_soft_trial_knows_the_distance_itself():
    """Softer differences are smaller; the structure's are what they are."""
    one, point = judge(), SPACE.encode(find_preset("F6b").parameters, 8)
    hard, soft = one.trial(point, (0, 1)), one.trial(point, (0, 1), 4.0)
    one.settle_all(hard)
    one.settle_all(soft)
    npt.assert_array_equal(hard.plain, hard.low)
    npt.assert_allclose(soft.plain, hard.low)
    assert (soft.low < hard.low).all()


def test_survey_has_the_size_of_the_target():
    one = judge()
    guess, spread = first_point(SPACE, one.targets)
    points = survey_points(one, guess, spread, 40, np.random.default_rng(0))
    assert len(points) == 40
    assert one.grown == 160
    assert all(((point >= 0.0) & (point <= 1.0)).all() for point in points)
    wanted = float(TARGET.position[:, 2].max()), one.targets[0].pieces.n_pieces
    drawn = [np.random.default_rng(k).random(25) for k in range(40)]
    off = []
    for some in (points, drawn):
        sizes = np.array([(s.height, s.pieces) for s in one.sizes(some, (5,)) if s.pieces])
        assert len(sizes) > 10
        off.append(np.median(np.abs(np.log(sizes / wanted)), axis=0))
    assert (off[0] < 0.7 * off[1]).all()


def test_searches_are_given_up_one_half_after_the_other():
    one, settings = judge(), EvolutionSettings(evaluations=900, samples=4, population=6)
    mean, spread = first_point(SPACE, one.targets)
    run = Evolution(0, [Search(mean)], spread)
    seen = []

    def watch(state):
        seen.append((state.evaluations / 900, len(state.searches), state.found is None))
        return True

    evolve(one, settings, run, keep_going=watch)
    assert [n for share, n, over in seen if share >= 0.55] == [1] * sum(share >= 0.55 for share, *_ in seen)
    assert {n for share, n, over in seen if over and share < 0.25} == {4}
    assert {2} <= {n for _, n, _ in seen}
    assert not any(over for share, _, over in seen if share < 0.1)
    assert run.evaluations == one.grown


def test_time_stands_for_evaluations():
    """What is nearly over has one search and no softness left, however few trees were grown."""
    one, settings = judge(), EvolutionSettings(evaluations=10**9, samples=4, population=6)
    mean, spread = first_point(SPACE, one.targets)
    run = Evolution(0, [Search(mean)], spread)
    clock = iter(np.linspace(0.0, 0.99, 30))
    evolve(one, settings, run, spent=lambda: next(clock, 1.0), keep_going=lambda _: next(clock, 1.0) < 0.95)
    assert len(run.searches) == 1
    assert run.found is None


@pytest.mark.parametrize("left, total, after, want", [
    (10.0, 10.0, 0.0, 0.0), (10.0, 10.0, 5.0, 0.5), (4.0, 10.0, 2.0, 0.8), (4.0, 10.0, 9.0, 1.0),
    (0.0, 0.0, 0.0, 1.0), (math.inf, math.inf, 5.0, 0.0),
])  # fmt: skip
def test_share_of_time(monkeypatch, left, total, after, want):
    monkeypatch.setattr("inverse.runs.monotonic", lambda: 100.0 + after)
    assert Time(total, left).spent(100.0) == pytest.approx(want)


def test_evolution_gets_nearer():
    """Than the guess that it begins with, by new trees."""
    one = judge(samples=8, seed=99)
    guess, _ = first_point(SPACE, one.targets)
    before = one.mean_distance(one.trial(guess, (0,)))
    fit = fit_trees([TARGET], settings=EvolutionSettings(evaluations=1200, samples=4, population=10), seed=3)
    assert fit.distance < before - 0.02
    assert fit.status == "done"
    assert 1200 <= fit.evaluations == fit.grown < 1300


# ---------------------------------------------------------------- fits


def same(one, two):
    assert one.parameters == two.parameters
    assert (one.age, one.distance, one.distances, one.curves) == (
        two.age,
        two.distance,
        two.distances,
        two.curves,
    )


@pytest.mark.parametrize(
    "method, settings",
    [("evolution", QUICK), ("annealing", AnnealingSettings(iterations=30, samples=4, report_every=10))],
)
def test_same_result_on_any_number_of_workers_and_after_a_break(method, settings, tmp_path):
    how = {"method": method, "settings": settings, "seed": 5, "runs": 2}
    whole = fit_trees([TARGET], **how)
    same(fit_trees([TARGET], workers=3, **how), whole)
    path = tmp_path / "state.json"
    stops = []

    def stop(progress):
        stops.append(progress)
        if len(stops) == 7:
            raise KeyboardInterrupt

    import inverse.fitting as module

    patch = pytest.MonkeyPatch()
    patch.setattr(module, "CHECKPOINT_SECONDS", 0.0)
    try:
        with pytest.raises(KeyboardInterrupt):
            fit_trees([TARGET], checkpoint=path, progress=stop, **how)
        resumed = fit_trees([TARGET], checkpoint=path, **how)
    finally:
        patch.undo()
    same(resumed, whole)
    done = fit_trees([TARGET], checkpoint=path, **how)
    same(done, whole)
    assert done.grown == 0


@pytest.mark.parametrize(
    "method, settings",
    [("evolution", QUICK), ("annealing", AnnealingSettings(iterations=30, samples=4, report_every=10))],
)
def test_same_result_on_an_executor_slice_by_slice_and_after_a_break(method, settings, tmp_path, monkeypatch):
    how = {"method": method, "settings": settings, "seed": 5, "runs": 3}
    whole = fit_trees([TARGET], **how)
    monkeypatch.setattr("inverse.runs.SLICE_SECONDS", 0.05)  # some steps each
    monkeypatch.setattr("inverse.fitting.CHECKPOINT_SECONDS", 0.0)
    said = []

    def stop(progress):
        said.append(progress)
        if len(said) == 5:
            raise KeyboardInterrupt

    with ThreadPoolExecutor(2) as executor:
        same(fit_trees([TARGET], executor=executor, **how), whole)
        with pytest.raises(KeyboardInterrupt):
            fit_trees([TARGET], executor=executor, checkpoint=tmp_path / "state", progress=stop, **how)
        assert {progress.run for progress in said} >= {0, 1}  # side by side
        assert all(0.0 < progress.share <= 1.0 for progress in said)
        same(fit_trees([TARGET], executor=executor, checkpoint=tmp_path / "state", **how), whole)
    same(fit_trees([TARGET], checkpoint=tmp_path / "state", **how), whole)


def test_time_runs_out_on_an_executor():
    with ThreadPoolExecutor(2) as executor:
        how = {"settings": EvolutionSettings(evaluations=10**9), "runs": 2}
        fit = fit_trees([TARGET], executor=executor, seconds=0.3, **how)
    assert fit.status == "stopped"
    assert all(len(curve) > 0 for curve in fit.curves)


def test_a_run_that_fails_elsewhere_fails_the_fit():
    class Broken(ThreadPoolExecutor):
        def submit(self, work, *arguments):
            return super().submit(lambda: 1 / 0)

    with Broken(1) as executor, pytest.raises(ZeroDivisionError):
        fit_trees([TARGET], settings=QUICK, executor=executor)


def test_fit_says_what_it_is():
    fit = fit_trees([TARGET], settings=QUICK, runs=2, fixed={"NLB": 2}, bounds={"BAM": (30, 50)})
    npt.assert_allclose(fit.distance, min(fit.distances))
    npt.assert_allclose(fit.distance, (fit.shape + fit.geometry + fit.structure) / 3.0)
    assert fit.parameters.n_lateral_buds == 2
    assert 30 <= fit.parameters.branching_angle_mean_deg <= 50
    assert len(fit.runs) == 2
    assert "NLB" not in fit.spread
    npt.assert_allclose(fit.spread["BAM"], np.std([run["BAM"] for run in fit.runs], ddof=1))
    assert repr(fit).startswith(f"<Fit {fit.distance:.4f} after {fit.age} cycles, 2 runs, ")


def test_time_without_settings_is_used():
    fit = fit_trees([TARGET], seconds=1.5)
    assert fit.evaluations > 100
    assert fit.distance < 0.7


def test_time_runs_out():
    fit = fit_trees([TARGET], settings=EvolutionSettings(evaluations=10**9), seconds=0.0)
    assert fit.status == "stopped"
    assert 0.0 <= fit.distance <= 1.0
    assert math.isnan(fit.spread["BAM"])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_guess_is_near(seed):
    """What a grown tree shows of its parameters: angles, internodes."""
    kind = find_preset("F6b").parameters
    guess = guess_parameters([describe_tree(grown("F6b", 11, seed))])
    assert abs(guess["BAM"] - kind.branching_angle_mean_deg) < 15
    assert abs(math.log(guess["IBL"] / kind.internode_length)) < 0.4
    assert set(guess) == {d.symbol for d in SPACE.dimensions}


def test_thickness_is_read_off_where_it_is_not_the_models_own():
    tree = grown("F6b", 11, 1)
    assert guess_tip_share([describe_tree(tree)]) == 0.01
    thick = tree.replace(radius=8.0 * tree.radius)
    share = guess_tip_share([describe_tree(thick)])
    assert 0.05 < share < 0.16
    assert guess_tip_share([describe_tree(tree.replace(radius=1000.0 * tree.radius))]) == 0.2
    fit = fit_trees([thick], settings=EvolutionSettings(evaluations=60, population=6), seed=1)
    assert 0.2 * share < fit.tip_share <= 0.2
    assert fit_trees([tree], tip_share=0.03, settings=EvolutionSettings(1)).tip_share == 0.03
    with pytest.raises(InputError, match="tip_share must be from 0.0005 to 0.2"):
        fit_trees([tree], tip_share=0.5)


@pytest.mark.parametrize("parent", [[-1, 0], [-1, 0, 0, 0], [-1, 0, 1, 2, 3]])
def test_guess_of_bare_trees(parent):
    rng = np.random.default_rng(0)
    tree = TreeGraph(parent, np.cumsum(rng.random((len(parent), 3)), axis=0), np.full(len(parent), 0.1))
    guess = guess_parameters([describe_tree(tree)])
    assert all(math.isfinite(value) for value in guess.values())


@pytest.mark.parametrize(
    "trees, how, match",
    [
        ([], {}, "a tree to fit must have some height, got none"),
        ([TreeGraph([-1], [[0, 0, 0]], [0.1])], {}, "a tree to fit must have some height, got none"),
        ([TreeGraph([-1, -1], np.eye(3)[:2], [0.1, 0.1])], {}, "must have one root, got 2"),
        ([TARGET], {"method": "magic"}, "method must be one of annealing, evolution, got 'magic'"),
        (
            [TARGET],
            {"settings": AnnealingSettings()},
            "settings must be EvolutionSettings with method 'evolution'",
        ),
        ([TARGET], {"runs": 0}, "runs must be 1 or more, got 0"),
        ([TARGET], {"workers": 0}, "samples and workers must be 1 or more, got 4 and 0"),
        ([TARGET], {"seconds": -1.0}, "seconds must be a finite number >= 0, got -1.0"),
    ],
)
def test_errors(trees, how, match):
    with pytest.raises(InputError, match=match):
        fit_trees(trees, **how)


@pytest.mark.parametrize(
    "kind, change, match",
    [
        (AnnealingSettings, {"iterations": 0}, "iterations must be a whole number >= 1, got 0"),
        (AnnealingSettings, {"hottest": -1.0}, "hottest must be a finite number >= 0, got -1.0"),
        (AnnealingSettings, {"share": 1.5}, "step must be > 0 and share above 0 to 1, got 0.1 and 1.5"),
        (EvolutionSettings, {"population": 3}, "population must be a whole number >= 4, got 3"),
    ],
)
def test_bad_settings(kind, change, match):
    with pytest.raises(InputError, match=match):
        kind(**change)


def test_bush_of_ten_thousand_tips():
    rng = np.random.default_rng(0)
    bush = TreeGraph([-1] + [0] * 10_000, rng.normal(size=(10_001, 3)), np.full(10_001, 0.01))
    with pytest.raises(
        InputError, match="at most 4000 branches between forks, but tree 0 has 10001; leave its"
    ):
        fit_trees([bush])


def test_no_targets_or_none_with_length():
    with pytest.raises(InputError, match="a fit must have at least one tree, got none"):
        Judge([], SPACE)
    with pytest.raises(InputError, match="must have some length, but tree 0 has none"):
        Judge([TreeGraph([-1], [[0, 0, 0]], [0.1])], SPACE)


def test_samples_of_judge_and_settings_must_agree():
    with pytest.raises(InputError, match="samples must be 8 as in the settings, got 4"):
        anneal(judge(), AnnealingSettings(), start_chain(judge(), 0))
    with pytest.raises(InputError, match="samples must be 8 as in the settings, got 4"):
        evolve(
            judge(), EvolutionSettings(samples=8), Evolution(0, [Search(np.full(25, 0.5))], np.full(25, 0.1))
        )


@pytest.mark.parametrize(
    "text, match",
    [
        ("nonsense", "this is no checkpoint of a fit; remove it"),
        ("{}", "this is no checkpoint of a fit; remove it"),
        ('{"fit": {}, "runs": []}', "this checkpoint is of a fit of other trees or settings; remove it"),
    ],
)
def test_bad_checkpoint(tmp_path, text, match):
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(InputError, match=match):
        fit_trees([TARGET], settings=QUICK, checkpoint=path)


def test_damaged_states(tmp_path):
    path = tmp_path / "state.json"
    fit_trees([TARGET], settings=EvolutionSettings(evaluations=1, samples=4, population=4), checkpoint=path)
    state = json.loads(path.read_text())
    del state["runs"][0]["searches"][0]["mean"]
    path.write_text(json.dumps(state))
    with pytest.raises(InputError, match="the state of a run is damaged: KeyError 'mean'"):
        fit_trees(
            [TARGET], settings=EvolutionSettings(evaluations=1, samples=4, population=4), checkpoint=path
        )
    with pytest.raises(InputError, match="the state of a chain is damaged"):
        Chain.from_dict({"number": 0})
    assert BOUNDED < EXACT


ONE_TREE = EvolutionSettings(evaluations=1, samples=4, population=4)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """What a short fit leaves, as a dict."""
    path = tmp_path_factory.mktemp("checkpoint") / "state.json"
    fit_trees([TARGET], settings=ONE_TREE, checkpoint=path)
    return json.loads(path.read_text())


@pytest.mark.parametrize(
    "change, match",
    [
        (lambda fit, run: fit.update(runs=3), "this is no checkpoint of a fit; remove it"),
        (lambda fit, run: fit.update(runs=None), "this is no checkpoint of a fit; remove it"),
        (lambda fit, run: fit.update(runs=[]), "the runs of this checkpoint are not those of its fit"),
        (
            lambda fit, run: fit.update(runs=[run, run]),
            "the runs of this checkpoint are not those of its fit",
        ),
        (lambda fit, run: run.update(number=7), "the runs of this checkpoint are not those of its fit"),
        (lambda fit, run: run.update(generation=-5), "a count is negative; remove it"),
        (lambda fit, run: run.update(spread=[1.0, 2.0]), "mean does not fit 2 parameters; remove it"),
        (lambda fit, run: run.update(past=[[0.5]]), "a point is not 25 numbers from 0 to 1; remove it"),
        (lambda fit, run: run.update(found=[[0.5, [2.0] * 25]]), "a point is not 25 numbers from 0 to 1"),
        (lambda fit, run: run["searches"][0]["mean"].pop(), "mean does not fit 25 parameters; remove it"),
        (lambda fit, run: run["searches"][0].update(covariance=[[1.0]]), "covariance does not fit 25 param"),
        (lambda fit, run: run["searches"][0]["path_c"].__setitem__(0, math.nan), "path_c does not fit"),
        (lambda fit, run: run["searches"][0].update(sigma=math.inf), "sigma is no number from 0 on"),
    ],
)
def test_checkpoint_that_was_tampered_with(tmp_path, checkpoint, change, match):
    fit = json.loads(json.dumps(checkpoint))
    change(fit, fit["runs"][0])
    path = tmp_path / "state.json"
    path.write_text(json.dumps(fit))
    with pytest.raises(InputError, match=match) as error:
        fit_trees([TARGET], settings=ONE_TREE, checkpoint=path)
    assert str(error.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    "change", [{"iteration": -1}, {"origin": -2}, {"point": [0.5, 1.5]}, {"point": ["x"]}]
)
def test_chain_out_of_its_range(change):
    state = Chain(0, [0.5, 0.5]).to_dict()
    assert Chain.from_dict(state) == Chain(0, [0.5, 0.5])
    with pytest.raises(InputError, match="the state of a chain is damaged: ValueError"):
        Chain.from_dict(state | change)


def test_checkpoint_of_endless_brackets(tmp_path):
    (tmp_path / "state.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match="this is no checkpoint of a fit; remove it"):
        fit_trees([TARGET], settings=ONE_TREE, checkpoint=tmp_path / "state.json")


@pytest.mark.parametrize("place", ["no_folder/state.json", "file/state.json"])
def test_checkpoint_that_cannot_be_written_is_known_before_the_fit(tmp_path, place):
    (tmp_path / "file").write_text("")
    said = []
    with pytest.raises(InputError, match=f"{place}: cannot write here"):
        fit_trees([TARGET], settings=ONE_TREE, checkpoint=tmp_path / place, progress=said.append)
    assert said == []
