import numpy as np
import pytest
from synthetic import forked_tree, tube

from recon import _tube_kernels as kernels
from recon import encoding
from recon.encoding import build_skeleton
from recon.ordering import morton_order
from recon.skeleton import Skeleton, chains_of
from recon.trimming import drop_spurs, drop_unsupported, fit_budget


def skeleton_of(xyz):
    xyz = xyz[morton_order(xyz)[0]]
    return build_skeleton(xyz, np.zeros(3), beta=2.0), xyz


def n_tips(skeleton):
    return int((np.bincount(skeleton.parent[1:], minlength=skeleton.n_nodes) == 0).sum())


def test_a_rough_trunk_has_no_branches(rng):
    xyz = tube((0, 0, 0), (0, 0, 3), 0.15, 0.12, 20000, rng, noise=0.01)
    skeleton, _ = skeleton_of(xyz)
    assert n_tips(skeleton) == 1


def test_spurs_of_rough_bark_go(rng, monkeypatch):
    xyz = tube((0, 0, 0), (0, 0, 3), 0.15, 0.04, 20000, rng, noise=0.03)
    dropped = n_tips(skeleton_of(xyz)[0])
    monkeypatch.setattr(encoding, "drop_spurs", lambda xyz, skeleton: skeleton)
    assert dropped < n_tips(skeleton_of(xyz)[0])


def test_real_branches_stay(rng):
    skeleton, _ = skeleton_of(forked_tree(rng))
    assert n_tips(skeleton) == 4


@pytest.mark.parametrize("few, far, tips", [(1, 0.03, 4), (1e9, 0.03, 1), (1, 5.0, 1)])
def test_spurs_go_by_the_points_of_their_own(rng, few, far, tips):
    skeleton, xyz = skeleton_of(forked_tree(rng))
    while True:
        fewer = drop_spurs(xyz, skeleton, few, far)
        if fewer.n_nodes == skeleton.n_nodes:
            break
        skeleton = fewer
    assert n_tips(skeleton) == tips


def test_a_stray_point_behind_a_gap_is_no_branch(rng):
    trunk = tube((0, 0, 0), (0, 0, 2), 0.1, 0.1, 6000, rng)
    skeleton, _ = skeleton_of(np.concatenate([trunk, [[0.8, 0, 1.5], [0.82, 0, 1.5]]]))
    assert np.hypot(*skeleton.position[:, :2].T).max() < 0.2


def test_unsupported_ends_go_with_what_they_carry():
    position = np.array([[0.0, 0, 0], [0, 0, 0.1], [0, 0, 1.1], [0, 0, 1.2], [0, 0.1, 0.1]])
    parent = np.array([-1, 0, 1, 2, 1], np.int32)
    few = kernels.unsupported_tips(10.0, parent, position, np.array([9, 9, 4, 5, 1]), 0.3)
    many = kernels.unsupported_tips(10.0, parent, position, np.array([9, 9, 4, 6, 1]), 0.3)
    assert few.tolist() == [True, True, False, False, True]
    assert many.all()


@pytest.mark.parametrize("max_nodes", [400, 60, 25])
def test_budget_is_kept_and_points_are_not_lost_to_wrong_nodes(rng, max_nodes):
    skeleton, xyz = skeleton_of(forked_tree(rng))
    fitted = fit_budget(xyz, skeleton, 1.5, max_nodes)
    assert fitted.n_nodes <= max_nodes
    assert (fitted.parent[1:] < np.arange(1, fitted.n_nodes)).all()
    mine = fitted.label >= 0
    assert mine.mean() > 0.9
    assert fitted.label.max() < fitted.n_nodes


def test_budget_is_used(rng):
    skeleton, xyz = skeleton_of(forked_tree(rng))
    fitted = fit_budget(xyz, skeleton, 1.5, 4000)
    for share in (0.9, 0.8, 0.7, 0.6):
        budget = int(share * fitted.n_nodes)
        assert fit_budget(xyz, skeleton, 1.5, budget).n_nodes == budget


@pytest.mark.parametrize("n, stays", [(5, False), (40, True)])
def test_a_long_side_chain_needs_more_points(rng, n, stays):
    # a trunk of two nodes and a side chain of a metre with n points far outside the trunk
    position = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 5], [0.5, 0, 1], [1.0, 0, 1]])
    xyz = np.concatenate([position[:3], np.tile(position[4], (n, 1)), position[3:4]])
    label = np.concatenate([[0, 1, 2], np.full(n, 4), [3]]).astype(np.int32)
    tree = Skeleton(
        np.array([-1, 0, 1, 1, 3], np.int32), position, np.full(5, 0.05), label, label,
        np.ones(5, bool), np.ones(5), 0.02, 0.01,
    )  # fmt: skip
    fewer = drop_spurs(xyz, tree)
    assert fewer.n_nodes == (5 if stays else 3)
    assert (fewer.label[3:] >= 0).all() == stays


def test_a_straight_trunk_needs_few_nodes(rng):
    xyz = tube((0, 0, 0), (0, 0, 5), 0.1, 0.1, 15000, rng, noise=0.001)
    skeleton, xyz = skeleton_of(xyz)
    assert fit_budget(xyz, skeleton, 1.5, 4000).n_nodes < 0.6 * skeleton.n_nodes


def test_drop_unsupported_only_removes(rng):
    skeleton, _ = skeleton_of(forked_tree(rng))
    fewer = drop_unsupported(skeleton)
    assert fewer.n_nodes == skeleton.n_nodes
    assert chains_of(fewer).head.size == chains_of(skeleton).head.size
