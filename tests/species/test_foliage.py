"""Leaves of grown trees and the clusters they are gathered in."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from species import find_preset, gather_clusters, grow, place_leaves
from species.foliage import LEAF_ASPECT
from treegraph import InputError, TreeGraph


@pytest.fixture(scope="module")
def grown():
    kind = find_preset("F6e")
    return grow(kind.parameters, kind.age, rng=np.random.default_rng(2)).tree


@pytest.fixture(scope="module")
def leaves(grown):
    return place_leaves(grown, rng=np.random.default_rng(0))


def chain(area, step=1.0):
    """A straight pole with a leaf area on each segment."""
    n = len(area)
    position = np.zeros((n, 3))
    position[:, 2] = step * np.arange(n)
    return TreeGraph(np.arange(n) - 1, position, np.full(n, 0.01), {"leaf_area": np.array(area, float)})


def test_the_area_is_that_of_the_tree(grown, leaves):
    wanted = grown.attribute["leaf_area"].sum()
    npt.assert_allclose(leaves.area, wanted, rtol=0.02)
    of_node = np.bincount(leaves.node, 0.5 * leaves.length * leaves.width, grown.n_nodes)
    blade = 0.5 * 0.09**2 * LEAF_ASPECT
    assert (
        np.abs(of_node - grown.attribute["leaf_area"]).max()
        < 0.1 * grown.attribute["leaf_area"].max() + blade
    )
    assert not of_node[grown.attribute["leaf_area"] == 0.0].any()


@pytest.mark.parametrize("most", [1, 10, 1000])
def test_fewer_leaves_are_larger(grown, most):
    some = place_leaves(grown, rng=np.random.default_rng(0), most=most)
    assert some.n_leaves <= most + 3 * np.sqrt(grown.n_nodes)
    means = [
        place_leaves(grown, rng=np.random.default_rng(s), most=most).area
        for s in range(200 if most < 1000 else 3)
    ]
    npt.assert_allclose(
        np.mean(means), grown.attribute["leaf_area"].sum(), rtol={1: 0.25, 10: 0.1}.get(most, 0.03)
    )


def test_leaves_hang_on_their_segment(grown, leaves):
    start = grown.position[grown.parent[leaves.node]]
    end = grown.position[leaves.node]
    axis = end - start
    length = np.linalg.norm(axis, axis=1)
    share = np.einsum("ij,ij->i", leaves.base - start, axis) / length**2
    away = np.linalg.norm(leaves.base - start - share[:, None] * axis, axis=1)
    assert ((share >= -1e-9) & (share <= 1.0 + 1e-9)).all()
    assert (away <= 0.36 * np.sqrt(grown.attribute["leaf_area"][leaves.node]) + 1e-9).all()
    assert share.std() > 0.25  # all along it, not in a heap


def test_frames_are_orthonormal(leaves):
    npt.assert_allclose(np.linalg.norm(leaves.along, axis=1), 1.0, atol=1e-9)
    npt.assert_allclose(np.linalg.norm(leaves.normal, axis=1), 1.0, atol=1e-6)
    npt.assert_allclose(np.einsum("ij,ij->i", leaves.along, leaves.normal), 0.0, atol=1e-6)
    assert leaves.normal[:, 2].mean() > 0.3  # they look up


def test_upper_faces_look_up_at_every_place_around_a_pole():
    tree = chain([0.0, 3.0])
    leaves = place_leaves(tree, rng=np.random.default_rng(1))
    turn = np.arctan2(leaves.along[:, 1], leaves.along[:, 0])
    counts = np.histogram(turn, 8, (-np.pi, np.pi))[0]
    assert counts.min() > 0.8 * counts.mean()


def test_same_seed_same_leaves(grown, leaves):
    again = place_leaves(grown, rng=np.random.default_rng(0))
    other = place_leaves(grown, rng=np.random.default_rng(1))
    assert again.base.tobytes() == leaves.base.tobytes()
    assert other.base.tobytes() != leaves.base.tobytes()


def test_a_bare_tree_has_no_leaves():
    leaves = place_leaves(chain([0.0, 0.0]), rng=np.random.default_rng(0))
    assert leaves.n_leaves == 0
    assert leaves.area == 0.0
    assert gather_clusters(chain([0.0, 0.0]), leaves) == ()


def volume(cluster):
    corner = cluster.vertices[cluster.faces]
    return np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6.0


def check_cluster(cluster):
    """Closed, outward, small."""
    edges = np.concatenate([cluster.faces[:, [0, 1]], cluster.faces[:, [1, 2]], cluster.faces[:, [2, 0]]])
    assert len({tuple(e) for e in edges.tolist()}) == len(edges)
    assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}
    assert volume(cluster) > 0.0
    assert len(cluster.faces) <= 80


def test_clusters_hold_the_leaves(grown, leaves):
    clusters = gather_clusters(grown, leaves)
    assert 4 < len(clusters) <= 64
    inside = np.zeros(leaves.n_leaves, bool)
    for cluster in clusters:
        check_cluster(cluster)
        corner = cluster.vertices[cluster.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        inside |= ((leaves.base @ normal.T) <= np.einsum("ij,ij->i", normal, corner[:, 0]) + 1e-9).all(axis=1)
        assert (grown.attribute["leaf_area"][cluster.seed] > 0.0).all()
    assert inside.mean() > 0.9


def test_two_far_groups_are_two_clusters():
    area = np.zeros(40)
    area[1:13] = area[28:] = 0.1
    tree = chain(area)
    clusters = gather_clusters(tree, place_leaves(tree, rng=np.random.default_rng(0)), most=2)
    heights = sorted((c.vertices[:, 2].min(), c.vertices[:, 2].max()) for c in clusters)
    assert len(clusters) == 2
    assert heights[0][1] < 15 < heights[1][0]
    assert sorted(int(c.seed[0]) for c in clusters) == [1, 28]
    assert [len(c.seed) for c in clusters] == [1, 1]


@given(st.integers(1, 64), st.integers(0, 5))
@settings(deadline=None, max_examples=20)
def test_no_more_clusters_than_asked_for(most, seed):
    rng = np.random.default_rng(seed)
    tree = chain(rng.choice([0.0, 0.02], 200))
    clusters = gather_clusters(tree, place_leaves(tree, rng=rng), most=most)
    assert len(clusters) <= most
    for cluster in clusters:
        check_cluster(cluster)


def test_flat_leaves_make_no_cluster():
    tree = chain([0.0, 0.001])  # one leaf at most
    leaves = place_leaves(tree, rng=np.random.default_rng(0), leaf_length=1.0)
    assert gather_clusters(tree, leaves) == ()


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"leaf_length": 0.0}, "leaf_length must be from 0.001 to 2 metres, got 0.0"),
        ({"leaf_length": float("nan")}, "leaf_length must be from 0.001 to 2 metres, got nan"),
        ({"most": 0}, "most must be 1 or more leaves, got 0"),
    ],
)
def test_bad_numbers_are_named(grown, arguments, message):
    with pytest.raises(InputError, match=message):
        place_leaves(grown, rng=np.random.default_rng(0), **arguments)


def test_only_grown_trees_have_leaves():
    tree = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 1]], [0.1, 0.1])
    with pytest.raises(InputError, match="no attribute leaf_area; only grown trees"):
        place_leaves(tree, rng=np.random.default_rng(0))
