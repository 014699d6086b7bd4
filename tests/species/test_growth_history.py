"""Years of a tree, runs that go on, several trees together, caps: the same bytes wherever they must be."""

import numpy as np
import numpy.testing as npt
import pytest

from species import GrowthSettings, Plant, Site, find_preset, grow, grow_many, grow_stand, presets
from species import growth as model
from species.parameters import MAX_AGE
from tests.species.growing import FREE, grown, lively_parameters, plain, preset, same_bytes, seeded
from treegraph import Ball, InputError, Occluders, TriangleMesh

LOW_ROOF = Site(occluders=Occluders(obstacles=[Ball((1.2, 0, 3.5), 0.9), Ball((-1.3, 0.3, 2.0), 0.9)]))
#: Bends much, sheds much, dies much.
EVENTFUL = {"GBS": 8, "GBA": 0.7, "PF": 1.0, "LB_PF": 1.0, "AB_D": 0.02}


# ---------------------------------------------------------------- history


@pytest.mark.parametrize(
    ("name", "age", "changes", "site"),
    [
        ("F6a", 8, {}, Site()),
        ("F6b", 15, {}, Site()),
        ("F6c", 14, {"GBS": 6}, Site()),
        ("F6d", 15, EVENTFUL, Site()),
        ("F6e", 10, {}, LOW_ROOF),
        ("F6f", 14, EVENTFUL, LOW_ROOF),
    ],
)
def test_every_year_is_the_tree_that_grows_only_so_far(name, age, changes, site):
    p = preset(name, **changes)
    whole = grown(p, age, 4, site=site, history=True)
    assert whole.history.years == age
    for year, tree in enumerate(whole.history.trees()):
        alone = grown(p, year, 4, site=site).tree
        assert same_bytes(tree, alone), year
        assert same_bytes(tree, whole.history.at(year)), year
    assert year == age
    assert tree.n_nodes > 60
    assert same_bytes(tree, whole.tree)
    assert same_bytes(whole.tree, grown(p, age, 4, site=site).tree)


def test_every_year_of_random_trees():
    grew = 0
    for seed in range(60):
        p, age = lively_parameters(seeded(seed)), 4 + seed % 8
        settings = GrowthSettings(max_nodes=1500, ground=bool(seed % 3))
        whole = grown(p, age, seed, history=True, settings=settings, site=LOW_ROOF if seed % 2 else Site())
        for year, tree in enumerate(whole.history.trees()):
            alone = grown(p, year, seed, settings=settings, site=LOW_ROOF if seed % 2 else Site())
            assert same_bytes(tree, alone.tree), (seed, year)
        grew += whole.tree.n_nodes > 50
    assert grew > 10


def test_every_year_of_a_stand():
    plants = [
        Plant(preset("F6b")),
        Plant(preset("F6e"), (1.0, 0.0, 0.0), 4),
        Plant(preset("F6d", **EVENTFUL), (0, 2, 0.3)),
    ]
    whole = grow_stand(plants, 12, rng=seeded(0), history=True)
    for year in (0, 1, 3, 4, 5, 9, 12):
        for one, alone in zip(whole, grow_stand(plants, year, rng=seeded(0)), strict=True):
            assert same_bytes(one.history.at(year), alone.tree), year


def test_reading_the_years_twice_gives_the_same():
    whole = grown(preset("F6e"), 8, history=True)
    once = [tree.position.tobytes() for tree in whole.history.trees()]
    again = [whole.history.at(year).position.tobytes() for year in reversed(range(9))]
    assert once == again[::-1]


def with_identity(monkeypatch):
    """Let trees carry a number for each node that stays over the years."""
    plain_graph = model._graph

    def numbered(nodes, kept, **more):
        return plain_graph(nodes, kept, **more, identity=kept)

    monkeypatch.setattr(model, "_graph", numbered)


@pytest.mark.parametrize(
    ("name", "site"), [("F6b", Site()), ("F6d", LOW_ROOF), ("F6e", LOW_ROOF), ("F6f", Site())]
)
def test_no_radius_ever_shrinks(name, site, monkeypatch):
    """Not even where a branch is bent into the ground or an obstacle in the year in which it grew."""
    with_identity(monkeypatch)
    for seed in range(6):
        p = preset(name, **EVENTFUL | {"GBS": 10, "LB_PF": 0.0, "BAM": 95, "GT": -0.1})
        before, compared, fell = {}, 0, 0
        for tree in grown(p, 13, seed, site=site, history=True).history.trees():
            now = dict(zip(tree.attribute["identity"].tolist(), tree.radius.tolist(), strict=True))
            for node in before.keys() & now.keys():
                assert now[node] >= before[node] * (1 - 1e-12)
                compared += 1
            fell += len(before.keys() - now.keys())
            before = now
        assert compared > 10


def test_nodes_are_born_in_their_year_and_lengths_stay(monkeypatch):
    with_identity(monkeypatch)
    born = {}
    for year, tree in enumerate(grown(preset("F6b"), 13, 2, history=True).history.trees()):
        for node, birth in zip(
            tree.attribute["identity"].tolist(), tree.attribute["birth"].tolist(), strict=True
        ):
            assert birth <= max(0, year - 1)
            assert born.setdefault(node, birth) == birth
        if tree.n_nodes > 1:
            assert tree.attribute["birth"].max() == year - 1


def test_years_outside_the_life():
    history = grown(preset("F6e"), 3, history=True).history
    for year in (-1, 4):
        with pytest.raises(InputError, match=rf"year must be from 0 to 3, got {year}"):
            history.at(year)
    assert history.n_nodes >= history.at(3).n_nodes


def test_without_history_there_is_none():
    assert grown(preset("F6e"), 3).history is None


# ---------------------------------------------------------------- age 0, caps, room


def test_at_age_0_there_is_one_node():
    one = grown(preset("F6b"), 0, history=True)
    assert (one.tree.n_nodes, one.age, one.status, one.height) == (1, 0, "grown", 0.0)
    assert one.tree.attribute["bud"].tolist() == [1]
    assert one.tree.radius[0] == pytest.approx(0.0049)
    assert same_bytes(one.history.at(0), one.tree)
    assert repr(one) == "<GrownTree 0 cycles, 1 nodes, 0.0 m high>"


def test_a_cap_stops_before_the_cycle_that_would_pass_it():
    p = preset("F6d")
    sizes = [grown(p, age, 6).tree.n_nodes for age in range(19)]
    cap = sizes[14] + 1
    capped = grown(p, 18, 6, settings=GrowthSettings(max_nodes=cap), history=True)
    assert capped.status == "node limit"
    assert capped.tree.n_nodes <= cap
    assert capped.age <= 14 < 18
    assert capped.history.years == capped.age
    assert "stopped: node limit" in repr(capped)
    reached = grown(p, capped.age, 6)
    assert same_bytes(
        capped.tree, reached.tree
    )  # buds and light too: the cycle that was not grown left no trace
    assert set(capped.tree.attribute) == set(reached.tree.attribute)
    assert reached.status == "grown"


def test_a_cap_that_is_not_reached_changes_nothing():
    p = preset("F6e")
    free = grown(p, 9, 1)
    assert same_bytes(free.tree, grown(p, 9, 1, settings=GrowthSettings(max_nodes=400)).tree)


def test_a_cap_ends_explosive_growth_soon():
    p = plain(NLB=8, GR=12)
    capped = grown(p, 200, settings=GrowthSettings(max_nodes=5000))
    assert capped.status == "node limit"
    assert capped.age < 5


def test_a_history_ends_where_too_many_have_died(monkeypatch):
    """Hundreds of years of shedding at a hundred living nodes: memory stays bounded, and it is said."""
    p, few = preset("F6b", PF=4, LB_PF=4), GrowthSettings(max_nodes=3000)
    monkeypatch.setattr(model, "HISTORY_ROOM", 2)
    assert grown(p, 200, 3, settings=few).status == "grown"
    kept = grown(p, 200, 3, settings=few, history=True)
    assert kept.status == "node limit"
    assert kept.history.n_nodes <= 2 * 3000 + 512
    assert 20 < kept.age < 200
    assert same_bytes(kept.tree, grown(p, kept.age, 3, settings=few).tree)
    assert same_bytes(kept.history.at(kept.age), kept.tree)


@pytest.mark.parametrize("history", [False, True])
@pytest.mark.parametrize("room", [2, 7, 100_000])
def test_arrays_that_run_out_of_room_change_nothing(room, history, monkeypatch):
    p = preset("F6b")
    usual = grown(p, 16, 3, site=LOW_ROOF, history=history)
    monkeypatch.setattr(model, "FIRST_ROOM", room)
    other = grown(p, 16, 3, site=LOW_ROOF, history=history)
    assert same_bytes(usual.tree, other.tree)
    assert usual.tree.n_nodes > 512
    if history:
        assert same_bytes(usual.history.at(9), other.history.at(9))


# ---------------------------------------------------------------- the same bytes


def test_same_seed_same_bytes_other_seed_another_tree():
    p = preset("F6c")
    assert same_bytes(grown(p, 12, 1).tree, grown(p, 12, 1).tree)
    assert not same_bytes(grown(p, 12, 1).tree, grown(p, 12, 2).tree)


def test_one_number_is_drawn_from_the_generator():
    rng, other = seeded(9), seeded(9)
    grow(preset("F6e"), 5, rng=rng)
    other.integers(2**63)
    assert rng.integers(1000, size=5).tolist() == other.integers(1000, size=5).tolist()


def test_a_longer_life_begins_as_the_shorter_one():
    """Nothing is drawn in an order that depends on the age asked for."""
    p = preset("F6e", GBS=0)
    young, old = grown(p, 5, 2).tree, grown(p, 9, 2).tree
    trunk = [tree.position[tree.attribute["order"] == 0] for tree in (young, old)]
    npt.assert_array_equal(trunk[0], trunk[1][: len(trunk[0])])


def test_many_trees_do_not_depend_on_the_workers():
    jobs = [(preset(name), age) for name in presets() for age in (3, 9, 11)]
    one, two, five = (grow_many(jobs, seed=3, workers=w) for w in (1, 2, 5))
    for a, b, c, (p, age) in zip(one, two, five, jobs, strict=True):
        assert same_bytes(a.tree, b.tree)
        assert same_bytes(a.tree, c.tree)
        assert (a.parameters, a.age) == (p, age)
    again = grow_many(jobs[:2], seed=3)
    assert same_bytes(again[1].tree, one[1].tree)
    assert not same_bytes(grow_many(jobs[:2], seed=4)[1].tree, one[1].tree)
    assert grow_many([], seed=0) == []


def test_tree_k_of_many_grows_with_the_kth_spawned_generator():
    rng = np.random.default_rng(np.random.SeedSequence(7).spawn(3)[2])
    alone = grow(preset("F6e"), 7, rng=rng)
    assert same_bytes(grow_many([(preset("F6e"), 7)] * 3, seed=7)[2].tree, alone.tree)


# ---------------------------------------------------------------- several plants


def test_a_stand_of_one_is_a_tree():
    (one,) = grow_stand([Plant(preset("F6b"))], 12, rng=seeded(2))
    assert same_bytes(one.tree, grown(preset("F6b"), 12, 2).tree)


def test_far_plants_grow_as_if_alone():
    """Two kilometres away: the other's shadow is far below a thousandth."""
    p = preset("F6e")
    roomy = GrowthSettings(max_clusters=1024)
    near, far = grow_stand([Plant(p), Plant(p, (2000.0, 0.0, 0.0))], 9, rng=seeded(5), settings=roomy)
    alone = grown(p, 9, 5, settings=roomy)
    npt.assert_array_equal(near.tree.parent, alone.tree.parent)
    npt.assert_allclose(near.tree.position, alone.tree.position, atol=1e-4)
    assert far.tree.position[0].tolist() == [2000.0, 0.0, 0.0]
    assert not np.array_equal(far.tree.parent, near.tree.parent)  # its draws are its own


def test_close_plants_are_smaller():
    p = preset("F6f", AAV=0)
    alone = grow_many([(p, 17)] * 12, seed=1)
    beside = [
        one.tree.n_nodes
        for seed in range(12)
        for one in grow_stand([Plant(p), Plant(p, (1.5, 0.0, 0.0))], 17, rng=seeded(seed))
    ]
    assert np.mean(beside) < 0.8 * np.mean([one.tree.n_nodes for one in alone])


def test_close_plants_lean_apart():
    p, lean = preset("F6b"), []
    for seed in range(24):
        left, right = grow_stand([Plant(p), Plant(p, (2.5, 0.0, 0.0))], 19, rng=seeded(seed))
        lean.append((right.tree.position[:, 0].mean() - 2.5) - left.tree.position[:, 0].mean())
    assert np.mean(lean) > 2 * np.std(lean) / np.sqrt(len(lean))


def test_a_later_plant_begins_later():
    p = plain(NLB=1, IL_AF=0.9, AC=20, GR=1)
    first, late = grow_stand([Plant(p), Plant(p, (5.0, 0, 0), 4)], 10, rng=seeded(0), settings=FREE)
    assert (first.age, late.age) == (10, 6)
    assert late.tree.attribute["birth"].min() == 4
    trunk = late.tree.position[late.tree.attribute["order"] == 0, 2]
    npt.assert_allclose(np.diff(trunk), 0.5 * 0.9 ** np.arange(6), rtol=1e-9)  # its own age counts
    assert first.history is None


def test_a_seed_does_not_die_before_it_is_planted():
    p = plain(NLB=0, AB_D=0.3)
    plants = [Plant(plain(NLB=0))] + [Plant(p, (3.0 * k, 0, 0), 12) for k in range(1, 41)]
    grew = [one.tree.n_nodes > 1 for one in grow_stand(plants, 13, rng=seeded(1))[1:]]
    assert 0.5 < np.mean(grew) < 0.9  # 0.7


def test_unplanted_neighbours_change_nothing():
    """Seeds that wait all over the crown: nobody looks at their light."""
    roomy = GrowthSettings(max_clusters=1024)
    p = preset("F6e")
    waiting = [Plant(p, (0.1, 0.05, 0.1 * k), 9) for k in range(1, 40)]
    one, *others = grow_stand([Plant(p), *waiting], 9, rng=seeded(3), settings=roomy)
    assert same_bytes(one.tree, grown(p, 9, 3, settings=roomy).tree)
    assert all((other.tree.n_nodes, other.age) == (1, 0) for other in others)


def test_the_cap_is_for_all_plants_together():
    p = preset("F6e")
    plants = [Plant(p), Plant(p, (4.0, 0, 0))]
    both = grow_stand(plants, 12, rng=seeded(0), settings=GrowthSettings(max_nodes=300))
    assert all(one.status == "node limit" for one in both)
    assert sum(one.tree.n_nodes for one in both) <= 300


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("age", "message"),
    [
        (-1, r"age must be from 0 to 200 growth cycles, got -1"),
        (MAX_AGE + 1, r"age must be from 0 to 200 growth cycles, got 201"),
        (2.0, r"age must be a whole number of growth cycles, got 2.0"),
        (True, r"age must be a whole number of growth cycles, got True"),
        ("5", r"age must be a whole number of growth cycles, got '5'"),
    ],
)
def test_ages_that_cannot_be(age, message):
    with pytest.raises(InputError, match=message):
        grown(preset("F6e"), age)
    with pytest.raises(InputError, match=message):
        Plant(preset("F6e"), planted=age)


def test_numpy_ages_are_ages():
    assert grown(preset("F6e"), np.int64(3)).age == 3


@pytest.mark.parametrize("position", [(0, 0), (0, 0, float("nan")), (0, float("inf"), 0), (1, 2, 3, 4)])
def test_places_that_cannot_be(position):
    with pytest.raises(InputError, match=r"position must be three finite numbers in metres, got \("):
        Plant(preset("F6e"), position)


def test_no_plants():
    with pytest.raises(InputError, match=r"plants must have at least one plant"):
        grow_stand([], 5, rng=seeded(0))


def test_no_workers():
    with pytest.raises(InputError, match=r"workers must be 1 or more, got 0"):
        grow_many([(preset("F6e"), 3)], seed=0, workers=0)


def test_the_number_of_a_bad_job_is_said():
    with pytest.raises(InputError, match=r"^job 1: age must be from 0 to 200"):
        grow_many([(preset("F6e"), 3), (preset("F6e"), 999)], seed=0)


RANGES = {
    "foliage": (0, 20), "leaf_cycles": (1, 20), "tip_share": (0.0005, 0.2), "pipe_exponent": (1.5, 4),
    "wood_density": (1, 2000), "leaf_density": (0, 10), "shed_unit": (0, 10), "bend_unit": (0, 10),
    "max_clusters": (8, 1024), "max_nodes": (2, 20_000_000), "rings": (4, 64),
}  # fmt: skip


@pytest.mark.parametrize("name", RANGES)
def test_settings_out_of_their_range(name):
    low, high = RANGES[name]
    for good in (low, high):
        assert getattr(GrowthSettings(**{name: good}), name) == good
    for bad in (low - 1, high + 1, float("nan"), float("inf")):
        with pytest.raises(
            InputError, match=rf"^{name} must be (a whole number )?from {low} to {high}\b.*got {bad}"
        ):
            GrowthSettings(**{name: bad})
    for bad in ("3", None, True):
        with pytest.raises(InputError, match=rf"^{name} must be a number, got {bad!r}"):
            GrowthSettings(**{name: bad})


def test_settings_that_must_be_whole():
    for name in ("leaf_cycles", "max_clusters", "max_nodes", "rings"):
        with pytest.raises(InputError, match=rf"^{name} must be a whole number from .*, got 9.5"):
            GrowthSettings(**{name: 9.5})
    assert GrowthSettings(rings=8.0).rings == 8
    assert set(RANGES) | {"ground"} == set(GrowthSettings.__dataclass_fields__)


# ---------------------------------------------------------------- among meshes


def test_years_among_meshes_and_the_cap_there():
    """The path through Python that rays against meshes need: the same guarantees."""
    vertices = np.array([[-4, -4, 4.0], [4, -4, 4.0], [4, 4, 4.0], [-4, 4, 4.0]])
    sheet = Site(occluders=Occluders(obstacles=[TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))]))
    p = find_preset("F6e").parameters
    whole = grown(p, 9, 1, site=sheet, history=True)
    for year, tree in enumerate(whole.history.trees()):
        assert same_bytes(tree, grown(p, year, 1, site=sheet).tree)
    cap = GrowthSettings(max_nodes=60)
    capped = grown(p, 9, 1, site=sheet, settings=cap)
    assert capped.status == "node limit"
    assert same_bytes(capped.tree, grown(p, capped.age, 1, site=sheet).tree)
