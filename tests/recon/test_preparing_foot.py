"""The foot of a trunk among roots, grass and twigs, and seen from the air; ground that is hit seldom."""

import numpy as np
import numpy.testing as npt
from synthetic import crown, forked_tree, tube

from recon import Cloud, PrepareSettings, prepare


def plain(rng, half=3.0, n=20000):
    return np.column_stack([rng.uniform(-half, half, (n, 2)), 0.02 * rng.standard_normal(n)])


def test_a_trunk_far_below_its_crown_is_no_stray(rng):
    leaves = crown(rng, 3000, (0, 0, 10.0), (3.0, 3.0, 5.0))
    trunk = np.array([[0.1, 0.0, 0.0], [-0.1, 0.1, 0.4], [0.0, -0.1, 1.1]])
    aside = np.array([[30.0, 0.0, 5.0]])
    got = prepare(np.concatenate([leaves, trunk, aside]))
    npt.assert_array_equal(got.index, np.arange(3003))
    npt.assert_allclose(got.cloud.origin, (0, 0, 0), atol=0.5)
    assert got.cloud.xyz[:, 2].min() == 0


def test_a_point_far_below_everything_is_a_stray(rng):
    leaves = crown(rng, 3000, (0, 0, 12.0), (3.0, 3.0, 5.0))
    got = prepare(np.concatenate([leaves, [[0.0, 0.0, -9.0]]]))
    assert len(got.index) == 3000


def test_a_wide_ground_that_is_hit_seldom_is_found(rng):
    xy = rng.uniform(-15, 15, (2500, 2))  # under three points a square metre
    ground = np.column_stack([xy, 0.3 * xy[:, 0] + 0.02 * rng.standard_normal(len(xy))])
    tree = np.concatenate([forked_tree(rng), crown(rng, 2000)])
    got = prepare(np.concatenate([tree, ground]))
    assert got.ground_z is not None and abs(got.ground_z) < 0.1
    assert (got.index >= len(tree)).sum() < 0.05 * len(ground)
    assert (got.index < len(tree)).sum() > 0.98 * len(tree)


def test_grass_at_one_side_does_not_move_the_foot(rng):
    grass = rng.uniform([0.0, -0.1, 0.0], [0.5, 0.4, 0.25], (1500, 3))
    got = prepare(np.concatenate([forked_tree(rng), grass]))
    npt.assert_allclose(got.cloud.origin, (0, 0, 0), atol=0.04)


def test_the_foot_of_a_leaning_branch_is_its_thick_end(rng):
    branch = tube((2.0, 1.0, 3.0), (0.8, 1.0, 6.0), 0.022, 0.006, 4000, rng)
    twigs = [
        tube((2 - 1.2 * t, 1.0, 3 + 3 * t), (2.5 - 1.2 * t, 1.3, 3.2 + 3 * t), 0.005, 0.003, 200, rng)
        for t in (0.1, 0.2, 0.35, 0.5, 0.8)
    ]
    got = prepare(np.concatenate([branch, *twigs]))
    npt.assert_allclose(got.cloud.origin, (2.0, 1.0, 3.0), atol=0.05)


def test_zero_is_the_number_of_no_tree(rng):
    big, small = forked_tree(rng), forked_tree(rng, density=3000.0) + [5.0, 0.5, 0]
    floor = plain(rng, half=8.0)
    number = np.repeat([1, 2, 0], [len(big), len(small), len(floor)]).astype(np.int32)
    cloud = Cloud(np.concatenate([big, small, floor]), np.zeros(3), tree_id=number)
    assert prepare(cloud).looks_like_many == 2
    taken = prepare(cloud, PrepareSettings(largest=True)).index
    assert taken.max() < len(big) or taken.min() >= len(big)
    assert taken.max() < len(big) + len(small)


def test_a_tree_without_stem_on_its_ground_is_not_told_to_lie(rng):
    skirt = rng.uniform([-1.5, -1.5, 0], [1.5, 1.5, 6.0], (40000, 3))
    got = prepare(np.concatenate([skirt, plain(rng)]))
    assert not any("if that is up" in note for note in got.notes)
