"""The compiled growth model against the slow one, node for node."""

import numpy as np
import numpy.testing as npt
import pytest

from species import GrowthSettings, Plant, Site, find_preset, grow_stand, presets
from tests.species.growing import lively_parameters, preset, seeded
from tests.species.reference_growth import arrays_of, grow_reference
from treegraph import Ball, Box, HalfSpace, Leaves, Occluders, Sky

TOLERANCE = 1e-9
TILTED = np.linalg.qr(seeded(5).normal(size=(3, 3)))[0]
SITES = {
    "open": Site(),
    "wall": Site(occluders=Occluders(obstacles=[HalfSpace((1.0, 0, 0), (-1, 0, 0.2))])),
    "balls": Site(
        occluders=Occluders(obstacles=[Ball((1.2, 0.3, 2.5), 1.0), Ball((-1.3, 0.3, 1.5), 1.0, 0.4)])
    ),
    "boxes": Site(
        Sky((0.3, 0.2, 1.0)),
        Occluders(obstacles=[Box((-1.5, 0.3, 2.5), (1, 2, 1), TILTED), Box((0.9, 0.3, 3.5), (1, 1, 1))]),
    ),
    "leaves": Site(occluders=Occluders(Leaves([[0.5, 0, 3], [0, 5, 2]], [1.0, 2.0], [0.3, 0.0]))),
}


def check_same(plants, years, seed, **more):
    """Node for node, everything that a grown tree has. Returns how many nodes were compared."""
    fast = grow_stand(plants, years, rng=seeded(seed), **more)
    if fast[0].status != "grown":
        return 0
    slow = grow_reference(plants, years, seeded(seed), **more)
    for number, one in enumerate(fast):
        wanted = arrays_of(slow, number)
        npt.assert_array_equal(one.tree.parent, wanted["parent"])
        for name in ("birth", "order", "bud", "lateral_buds"):
            npt.assert_array_equal(one.tree.attribute[name], wanted[name], err_msg=name)
        for name in ("position", "radius"):
            npt.assert_allclose(getattr(one.tree, name), wanted[name], rtol=0, atol=TOLERANCE, err_msg=name)
        for name in ("mass", "light", "leaf_area"):
            npt.assert_allclose(one.tree.attribute[name], wanted[name], rtol=1e-7, atol=1e-9, err_msg=name)
    return sum(one.tree.n_nodes for one in fast)


@pytest.mark.parametrize(
    ("name", "age"), [("F6a", 8), ("F6b", 14), ("F6c", 14), ("F6d", 14), ("F6e", 10), ("F6f", 13)]
)
def test_presets(name, age):
    assert check_same([Plant(find_preset(name).parameters)], age, 3) >= 80


@pytest.mark.parametrize("where", SITES)
def test_presets_among_obstacles(where):
    for name, age in [("F6b", 11), ("F6e", 9), ("F6d", 11)]:
        parameters = preset(name, LB_PF=0.2, GBS=2)
        assert check_same([Plant(parameters)], age, 8, site=SITES[where]) >= 60


def test_plants_of_several_ages_and_kinds():
    kinds = presets()
    plants = [
        Plant(kinds["F6b"].parameters),
        Plant(kinds["F6e"].parameters, (1.5, 0.5, 0.2), 3),
        Plant(kinds["F6d"].parameters.replace(AB_D=0.05), (-1.0, 1.0, -0.1), 6),
    ]
    assert check_same(plants, 13, 1, settings=GrowthSettings(max_clusters=24)) >= 500


@pytest.mark.parametrize(
    "settings",
    [
        GrowthSettings(foliage=3, leaf_cycles=1, rings=4),
        GrowthSettings(leaf_cycles=4, tip_share=0.05, pipe_exponent=2.0, ground=False),
        GrowthSettings(wood_density=300, leaf_density=2, shed_unit=0.4, bend_unit=0.2, max_clusters=10),
        GrowthSettings(foliage=0),
    ],
    ids=lambda s: f"foliage {s.foliage}",
)
def test_other_settings(settings):
    assert check_same([Plant(preset("F6e", PF=0.5 * (settings.foliage > 0)))], 9, 2, settings=settings) >= 50


def random_stand(seed):
    """One to three plants of random kinds, ages, places and settings."""
    rng = seeded(seed)
    n_plants, years = 1 + seed % 3, int(rng.integers(3, 10))
    plants = [
        Plant(
            lively_parameters(rng),
            tuple(rng.uniform(-1, 1, 3) * (1, 1, 0.3)) if k else (0.0, 0.0, 0.0),
            int(rng.integers(0, 5)) if k else 0,
        )
        for k in range(n_plants)
    ]
    settings = GrowthSettings(
        max_nodes=800 * n_plants,
        max_clusters=int(rng.choice([8, 40, 192])),
        ground=bool(seed % 5),
        leaf_cycles=1 + seed % 3,
    )
    return plants, years, settings


def test_random_parameters_plants_and_obstacles():
    compared = grew = 0
    for seed in range(150):
        plants, years, settings = random_stand(seed)
        where = list(SITES.values())[seed % 4]
        if any(p.position[0] > 0.8 for p in plants) and where is SITES["wall"]:
            continue  # would stand in the wall
        n = check_same(plants, years, seed, site=where, settings=settings)
        compared += n
        grew += n > 20 * len(plants)
    assert grew > 20
    assert compared > 3000


@pytest.mark.slow
def test_many_random_parameters_plants_and_obstacles():
    compared = 0
    for seed in range(1000, 4000):
        plants, years, settings = random_stand(seed)
        if all(abs(p.position[0]) < 0.5 for p in plants):
            where = list(SITES.values())[seed % len(SITES)]
            compared += check_same(plants, years, seed, site=where, settings=settings)
    assert compared > 30_000


def test_the_plain_light_grows_nearly_the_same_tree():
    """With every ray against every leaf cluster (the benchmark's reference): the same kind of tree."""
    parameters = find_preset("F6e").parameters
    fast = [grow_stand([Plant(parameters)], 8, rng=seeded(s))[0].tree.n_nodes for s in range(4)]
    slow = [len(grow_reference([parameters], 8, seeded(s), light="exact").nodes) for s in range(4)]
    assert np.mean(slow) == pytest.approx(np.mean(fast), rel=0.1)
