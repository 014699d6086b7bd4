"""Growth from random parameters all over the legal ranges: no crash, no NaN, no run-away."""

import itertools
import math
import time

import numpy as np
import pytest

from species import GrowthParameters, GrowthSettings, Plant, Site, grow, parameter_table
from species import _growth_kernels as kernels
from tests.species.growing import grown, lively_parameters, plain, random_parameters, seeded
from treegraph import Ball, HalfSpace, Occluders

CAP = 2000
SETTINGS = GrowthSettings(max_nodes=CAP)
AMONG = Site(occluders=Occluders(obstacles=[Ball((1.5, 0, 4), 1), HalfSpace((0, -3, 0), (0, 1, 0.1))]))
LONGEST = 2.0  # seconds of processor time for one vector; the slowest measured take a tenth of it


def check(one, age):
    """TreeGraph holds check_tree by itself; here is what else must be true of any grown tree."""
    tree = one.tree
    assert np.isfinite(tree.position).all()
    assert np.isfinite(tree.radius).all()
    assert (tree.radius > 0).all()
    assert (tree.parent[1:] >= 0).all()
    assert one.status in ("grown", "node limit")
    assert tree.n_nodes <= CAP
    assert one.age == age if one.status == "grown" else one.age < age
    for name, values in tree.attribute.items():
        assert np.isfinite(values).all(), name
    assert ((tree.attribute["light"] >= 0) & (tree.attribute["light"] <= 1 + 1e-9)).all()
    assert (tree.attribute["mass"] >= 0).all()
    assert (tree.attribute["birth"] < max(1, one.age)).all()
    assert (tree.attribute["order"][1:] >= tree.attribute["order"][tree.parent[1:]]).all()
    assert tree.position[:, 2].min() >= 0


def fuzz(seeds):
    """Grow one tree per seed; (seconds, seed) of the slowest."""
    slowest, statuses, sizes = (0.0, -1), set(), []
    for seed in seeds:
        rng = seeded(seed)
        p = random_parameters(rng) if seed % 2 else lively_parameters(rng)  # anywhere most die young
        age = int(rng.integers(1, 31))
        start = time.process_time()
        one = grow(p, age, rng=rng, settings=SETTINGS, site=AMONG if seed % 4 == 0 else Site())
        slowest = max(slowest, (time.process_time() - start, seed))
        check(one, age)
        statuses.add(one.status)
        sizes.append(one.tree.n_nodes)
    assert statuses == {"grown", "node limit"}
    assert np.mean(np.array(sizes) > 10) > 0.2  # not only seeds that never grew
    assert slowest[0] < LONGEST
    return slowest


def test_random_vectors():
    grown(plain(), 1)  # compiles
    fuzz(range(300))


@pytest.mark.slow
def test_ten_thousand_random_vectors():
    grown(plain(), 1)
    seconds, seed = fuzz(range(10_000, 20_000))
    print(f"slowest vector: {seconds:.3f} s of processor time (seed {seed})")  # noqa: T201


@pytest.mark.parametrize("end", ["low", "high"])
def test_each_parameter_at_the_ends_of_its_range(end):
    rng = seeded(3)
    for row in parameter_table():
        for _ in range(3):
            p = random_parameters(rng).replace(**{row["name"]: row[end]})
            check(grown(p, 25, settings=SETTINGS), 25)
            p = plain(NLB=2, GR=2, PF=0.3, LF_L=0.3, AD_BF=1).replace(**{row["name"]: row[end]})
            check(grown(p, 25, settings=SETTINGS), 25)


def test_all_parameters_at_ends_of_their_ranges():
    rng = seeded(11)
    table = parameter_table()
    for _ in range(300):
        values = {row["symbol"]: row[("low", "high")[rng.integers(2)]] for row in table}
        values["AB_D"], values["LB_D"] = rng.choice([0, 0.01]), rng.choice([0, 0.3])
        p = GrowthParameters.from_symbols(values)
        check(grown(p, 30, settings=SETTINGS), 30)


@pytest.mark.parametrize("age", [100, 200])
def test_long_lives(age):
    """Powers of the age factors under- and overflow on the way."""
    for control, factor, shorter, seed in itertools.product((0.05, 20), (0.3, 1.2), (0.5, 1), range(2)):
        p = plain(AC=control, AC_AF=factor, IL_AF=shorter, AD_AF=0.01, AD_BF=3, GR=1.6, NLB=1, GBS=5, GBA=0.5,
                  LB_D=0.5, PF=0.5, LF_L=0.5, AAV=30, PT=0.1)  # fmt: skip
        check(grown(p, age, seed, settings=SETTINGS), age)


def test_settings_at_the_ends_of_their_ranges():
    rng = seeded(4)
    for name, entry in GrowthSettings.__dataclass_fields__.items():
        for end in ("low", "high"):
            if not entry.metadata or name == "max_nodes":
                continue
            value = entry.metadata[end]
            settings = GrowthSettings(**{name: value, "max_nodes": CAP})
            for _ in range(2):
                p = random_parameters(rng).replace(AB_D=0, LB_D=0.1)
                one = grown(p, 12, settings=settings)
                check(one, 12)


def test_clusters_of_plants_far_apart_are_few():
    """The cells grow until all plants fit: a bounded number of times, wherever the plants stand."""
    from species import grow_stand

    p = plain(NLB=1, IBL=0.005)
    plants = [Plant(p, (1e5 * x, 1e5 * y, 0.0)) for x in range(4) for y in range(4)]
    start = time.process_time()
    found = grow_stand(plants, 5, rng=seeded(0), settings=GrowthSettings(max_clusters=8))
    assert time.process_time() - start < LONGEST
    assert all(one.tree.n_nodes > 10 for one in found)


def test_a_shoot_has_at_most_as_many_internodes_as_the_growth_rate():
    for rate in (0.4, 1.5, 12):
        tree = grown(plain(NLB=0, GR=rate, AC=0.05, AC_AF=0.3), 3).tree
        assert tree.n_nodes == 1 + 3 * math.floor(rate + 0.5)


def test_drawn_numbers_are_even():
    """Hashes of neighbouring keys, purposes and years are as good as independent."""
    from scipy import stats

    key = np.uint64(12345)
    draws = np.array(
        [kernels.uniform(key, a, b, y) for a in range(1, 7) for b in range(9) for y in range(60)]
    )
    assert stats.kstest(draws, "uniform").pvalue > 0.01
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 4 / math.sqrt(len(draws))
    assert len(np.unique(draws)) == len(draws)
