"""Where a tree grows: obstacles, the ground, moved and scaled worlds."""

import math

import numpy as np
import numpy.testing as npt
import pytest

from species import GrowthSettings, Plant, Site, grow_many, grow_stand
from tests.species.growing import FREE, grown, plain, preset, same_bytes, seeded, steps
from treegraph import (
    Ball,
    Box,
    Branches,
    HalfSpace,
    InputError,
    Leaves,
    Occluders,
    Sky,
    TriangleMesh,
    make_wall,
)

TILTED = np.linalg.qr(seeded(5).normal(size=(3, 3)))[0]
CUBE = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
SIDES = np.array([face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))])
#: Droops and spreads, so that it grows and bends into everything.
DROOPING = {"LB_PF": 0.0, "GBS": 4.0, "GT": -0.02, "BAM": 75, "PT": 0.0}


def among(*obstacles, sky=None):
    return Site(sky, Occluders(obstacles=obstacles))


# ---------------------------------------------------------------- inside, by sampling


def inside_half_space(points, plane):
    return (points - plane.point) @ plane.normal < -1e-9


def inside_ball(points, ball):
    return np.linalg.norm(points - ball.center, axis=-1) < ball.radius - 1e-9


def inside_box(points, box):
    own = (points - box.center) @ np.asarray(box.rotation)
    return (np.abs(own) < box.size / 2 - 1e-9).all(axis=-1)


INSIDE = {HalfSpace: inside_half_space, Ball: inside_ball, Box: inside_box}


def sampled(tree, n=60):
    """Points (segments, n, 3) along all segments, ends included."""
    start, end = tree.position[tree.parent[1:]], tree.position[1:]
    share = np.linspace(0, 1, n)[:, None]
    return start[:, None] + share * (end - start)[:, None]


OBSTACLES = {
    "half-space": HalfSpace((0.9, 0, 0), (-1, 0.1, 0)),
    "leaning half-space": HalfSpace((1.2, 0, 2.5), (-1, 0, -0.6)),
    "ball": Ball((1.0, 0.2, 2.6), 0.9),
    "box": Box((1.1, 0, 2.5), (1.2, 1.5, 1.0)),
    "tilted box": Box((-1.3, 0.1, 2.5), (1.2, 1.5, 1.0), TILTED),
    "thin wall": make_wall((0.7, 0, 0), (-1, 0, 0), width=8, height=9, thickness=0.01),
    "clear ball": Ball((1.0, 0.2, 2.6), 0.9, 0.9),
}


@pytest.mark.parametrize("name", OBSTACLES)
def test_nothing_crosses_an_obstacle(name):
    obstacle = OBSTACLES[name]
    met = 0
    for kind in ("F6e", "F6d"):
        p = preset(kind, **DROOPING)
        free = grown(p, 11, 5).tree
        met += INSIDE[type(obstacle)](sampled(free), obstacle).sum()
        for age in (6, 11):
            tree = grown(p, age, 5, site=among(obstacle)).tree
            assert tree.n_nodes > 20
            assert not INSIDE[type(obstacle)](sampled(tree), obstacle).any()
    assert met > 100  # without it they would be inside


def test_a_bud_that_led_into_an_obstacle_is_dead():
    roof = among(HalfSpace((0, 0, 1.7), (0, 0, -1)))
    tree = grown(plain(NLB=0, GR=2), 4, site=roof, settings=FREE).tree
    npt.assert_allclose(tree.position[:, 2], [0, 0.5, 1.0, 1.5], atol=1e-12)
    assert tree.attribute["bud"].tolist() == [0, 0, 0, 2]


@pytest.mark.parametrize(
    "thing", [Ball((0.02, 0, 1.5), 0.1), Box((0, 0.02, 1.5), (0.3, 0.3, 0.05), TILTED)], ids=["ball", "box"]
)
def test_nothing_leads_through_a_thing_smaller_than_an_internode(thing):
    """Neither end of the segment that would pass it lies inside."""
    p = plain(NLB=0, IBL=1)
    assert grown(p, 3, settings=FREE).tree.n_nodes == 4
    tree = grown(p, 3, site=among(thing), settings=FREE).tree
    npt.assert_allclose(tree.position, [(0, 0, 0), (0, 0, 1)], atol=1e-12)


def test_nothing_grows_or_hangs_below_the_ground():
    p = preset("F6d", **DROOPING | {"GBS": 10})
    low = []
    for seed in range(6):
        (one,) = grow_stand([Plant(p, (0, 0, 3.0))], 12, rng=seeded(seed))
        assert one.tree.position[:, 2].min() >= 3.0
        assert one.tree.n_nodes > 20
        (free,) = grow_stand(
            [Plant(p, (0, 0, 3.0))], 12, rng=seeded(seed), settings=GrowthSettings(ground=False)
        )
        low.append(free.tree.position[:, 2].min())
    assert min(low) < 2.5


def test_of_plants_on_a_slope_each_has_its_own_ground():
    p = preset("F6d", **DROOPING | {"GBS": 10})
    high, low = grow_stand([Plant(p, (0, 0, 4.0)), Plant(p, (9, 0, 0.0))], 12, rng=seeded(1))
    assert high.tree.position[:, 2].min() >= 4.0
    assert 0.0 <= low.tree.position[:, 2].min() < 4.0


@pytest.mark.parametrize("height", [1.5, 3.0])
def test_nothing_crosses_a_mesh(height):
    corner = np.array([0.3, -0.8, height])
    size = np.array([1.4, 1.6, 0.8])
    mesh = TriangleMesh(corner + CUBE * size, SIDES)
    box = Box(corner + size / 2, size - 2e-4)
    p = preset("F6e", **DROOPING)
    assert inside_box(sampled(grown(p, 9, 5).tree), box).any()
    tree = grown(p, 9, 5, site=among(mesh)).tree
    assert tree.n_nodes > 50
    assert not inside_box(sampled(tree), box).any()


def test_a_mesh_is_the_box_that_it_encloses():
    """The path through Python and the compiled one: the same tree but for the rays' single precision."""
    corner, size = np.array([0.5, -0.9, 1.4]), np.array([1.4, 1.8, 1.1])
    p = preset("F6e")
    for seed in range(4):
        one = grown(p, 9, seed, site=among(TriangleMesh(corner + CUBE * size, SIDES))).tree
        two = grown(p, 9, seed, site=among(Box(corner + size / 2, size))).tree
        npt.assert_array_equal(one.parent, two.parent)
        npt.assert_allclose(one.position, two.position, atol=1e-5)
        npt.assert_array_equal(one.attribute["bud"], two.attribute["bud"])


def test_a_bud_that_led_into_a_mesh_is_dead():
    sheet = TriangleMesh(np.array([[-3, -3, 1.7], [3, -3, 1.7], [0, 4, 1.7]]), np.array([[0, 1, 2]]))
    tree = grown(plain(NLB=0, GR=2), 4, site=among(sheet), settings=FREE).tree
    npt.assert_allclose(tree.position[:, 2], [0, 0.5, 1.0, 1.5], atol=1e-12)
    assert tree.attribute["bud"].tolist() == [0, 0, 0, 2]


def test_standing_trees_shade_but_do_not_block():
    post = Occluders(branches=Branches([[0, 0, 1.0]], [[0, 0, 9.0]], [0.3], [0.3]))
    tree = grown(plain(NLB=0, IBL=0.4), 10, site=Site(occluders=post), settings=FREE).tree
    npt.assert_allclose(tree.position[-1], [0, 0, 4.0], atol=1e-9)
    roof = Occluders(Leaves([[0, 0, 8.0]], [4.0], [0.0]))
    p = preset("F6b")
    shaded = [grown(p, 12, s, site=Site(occluders=roof)).tree.n_nodes for s in range(8)]
    assert np.mean(shaded) < 0.5 * np.mean([grown(p, 12, s).tree.n_nodes for s in range(8)])


@pytest.mark.parametrize(
    "obstacle",
    [HalfSpace((0, 0, 1), (0, 0, 1)), HalfSpace((0, 0, 0), (0, 0, 1)), Ball((0.2, 0, 0.1), 0.5),
     Box((0, 0, 0), (1, 1, 1), TILTED)],
    ids=["half-space", "on its face", "ball", "box"],
)  # fmt: skip
def test_no_plant_stands_inside_an_obstacle(obstacle):
    kind = type(obstacle).__name__
    with pytest.raises(InputError, match=rf"plant 0 stands at \(0.0, 0.0, 0.0\), inside a {kind} obstacle"):
        grown(preset("F6e"), 3, site=among(obstacle))
    with pytest.raises(InputError, match=r"plant 1 stands at \(0.0, 0.0, 0.0\)"):
        outside = Plant(preset("F6e"), (50.0, 50.0, 50.0))
        grow_stand([outside, Plant(preset("F6e"))], 3, rng=seeded(0), site=among(obstacle))


def test_a_plant_between_obstacles_may_stand_there():
    around = [Ball((0, 0, 6), 1), Box((3, 0, 0), (1, 9, 9)), HalfSpace((0, 0, -0.1), (0, 0, 1))]
    assert grown(preset("F6e"), 4, site=among(*around)).tree.n_nodes > 5


# ---------------------------------------------------------------- the wall


def test_a_wall_turns_the_tree_away():
    """Solid beyond x = 1.5 m: shade and the lack of room push the crown to the other side."""
    p = preset("F6b")
    wall = among(HalfSpace((1.5, 0, 0), (-1, 0, 0)))
    jobs = [(p, 18)] * 12
    beside = np.array([g.tree.position[:, 0].mean() for g in grow_many(jobs, seed=2, site=wall)])
    free = np.array([g.tree.position[:, 0].mean() for g in grow_many(jobs, seed=2)])
    assert beside.mean() < -4 * beside.std() / math.sqrt(12)
    assert beside.mean() < -0.8
    assert abs(free.mean()) < 3 * free.std() / math.sqrt(12)


def test_an_obstacle_out_of_sight_changes_no_byte():
    """Below the horizon it takes no light."""
    p = preset("F6b")
    below = among(Ball((0, 0, -30.0), 3.0), Box((40, 0, -10), (2, 2, 2)))
    assert same_bytes(grown(p, 13, 3, site=below).tree, grown(p, 13, 3).tree)


def test_an_obstacle_far_away_changes_next_to_nothing():
    p = preset("F6b")
    far = among(Box((3000.0, 0, 5), (5, 5, 10)))
    one, two = grown(p, 14, 3, site=far).tree, grown(p, 14, 3).tree
    npt.assert_array_equal(one.parent, two.parent)
    npt.assert_allclose(one.position, two.position, atol=1e-3)
    assert one.n_nodes > 500


def test_draws_do_not_depend_on_what_else_grows():
    """The same seed beside a wall: the trunk's random turns are the same ones."""
    p = plain(NLB=2, AAV=25, AC=20, BAM=60)
    wall = among(HalfSpace((2.0, 0, 0), (-1, 0, 0)))
    free, beside = (grown(p, 6, 7, site=site, settings=FREE).tree for site in (Site(), wall))
    trunk = [tree.position[tree.attribute["order"] == 0] for tree in (free, beside)]
    npt.assert_array_equal(*trunk)


# ---------------------------------------------------------------- moved, turned and scaled worlds


@pytest.mark.parametrize("shift", [(10.7, -3.2, 2.1), (-1e4, 5e3, 800.0), (0.013, 0.4, -0.27)])
def test_a_moved_tree_is_the_same_tree(shift):
    for name, age in [("F6a", 8), ("F6b", 13), ("F6d", 13), ("F6e", 10)]:
        p = preset(name)
        (moved,) = grow_stand([Plant(p, shift)], age, rng=seeded(4))
        still = grown(p, age, 4)
        npt.assert_array_equal(moved.tree.parent, still.tree.parent)
        npt.assert_allclose(moved.tree.position - shift, still.tree.position, atol=1e-7)
        npt.assert_allclose(moved.tree.radius, still.tree.radius, rtol=1e-12)


def test_a_moved_scene_is_the_same_scene():
    shift = np.array([7.3, -11.1, 0.7])
    p = preset("F6e")
    plants = [((0.0, 0.0, 0.0), 0), ((1.2, 0.4, 0.1), 3)]
    here = grow_stand(
        [Plant(p, at, year) for at, year in plants],
        10, rng=seeded(1), site=among(Ball((1.5, 0, 3), 0.8), HalfSpace((-1.5, 0, 0), (1, 0, 0))),
    )  # fmt: skip
    there = grow_stand(
        [Plant(p, tuple(shift + at), year) for at, year in plants],
        10, rng=seeded(1),
        site=among(Ball(shift + (1.5, 0, 3), 0.8), HalfSpace(shift + (-1.5, 0, 0), (1, 0, 0))),
    )  # fmt: skip
    for one, two in zip(here, there, strict=True):
        npt.assert_array_equal(one.tree.parent, two.tree.parent)
        npt.assert_allclose(one.tree.position + shift, two.tree.position, atol=1e-9)


@pytest.mark.parametrize("scale", [2.0, 0.5])
def test_a_scaled_tree_is_the_same_tree(scale):
    """Lengths by s: AD_DF is per metre, GBA per centimetre, loads go as s^4, leaves' weight as s^3."""
    for name, age in [("F6b", 12), ("F6d", 13), ("F6e", 10)]:
        p = preset(name, GBS=0.08)
        q = p.replace(
            IBL=p.internode_length * scale,
            LB_PF=p.low_branch_height * scale,
            AD_DF=p.dominance_distance ** (1 / scale),
            GBA=p.bending_angle ** (1 / scale),
            GBS=p.bending_strength / scale**4,
        )
        leaves = GrowthSettings(leaf_density=0.25 * scale)
        one, two = grown(p, age, 6).tree, grown(q, age, 6, settings=leaves).tree
        npt.assert_array_equal(one.parent, two.parent)
        npt.assert_allclose(two.position, scale * one.position, atol=1e-7)
        npt.assert_allclose(two.radius, scale * one.radius, rtol=1e-9)
        npt.assert_allclose(two.attribute["mass"], scale**3 * one.attribute["mass"], rtol=1e-7)
        npt.assert_allclose(two.attribute["light"], one.attribute["light"], atol=1e-6)


def test_under_an_even_sky_no_side_is_preferred():
    """Means over many trees, of the crown's middle: zero within its error in x and y."""
    middle = np.array(
        [g.tree.position[:, :2].mean(axis=0) for g in grow_many([(preset("F6b"), 13)] * 60, seed=8)]
    )
    assert (np.abs(middle.mean(axis=0)) < 4 * middle.std(axis=0) / math.sqrt(60)).all()


def test_a_bright_side_of_the_sky_draws_the_crown():
    p = preset("F6b", PT=0.3)
    for sky, sign in ((Sky((0, 1, 0.6)), 1), (Sky((0, -1, 0.6)), -1)):
        side = [grown(p, 11, seed, site=Site(sky)).tree.position[:, 1].mean() for seed in range(6)]
        assert sign * np.mean(side) > 0.5


def test_segments_are_as_long_as_they_grew_even_when_bent():
    p = preset("F6d", GBS=8)
    tree = grown(p, 14, 1).tree
    wanted = p.internode_length * p.internode_age ** tree.attribute["birth"][1:]
    npt.assert_allclose(np.linalg.norm(steps(tree), axis=1), wanted, rtol=1e-9)
    assert (steps(tree)[:, 2] < -0.3 * wanted).sum() > 5
