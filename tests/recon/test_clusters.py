import numpy as np
import pytest
from synthetic import crown, forked_tree, tube

from recon import Cloud, EncodeSettings, encode_with_report
from recon import _tube_kernels as kernels
from recon.clusters import cluster_points, lumps, separate
from recon.hulls import mesh_volume
from recon.skeleton import Skeleton


def leafy_tree(rng, **options):
    return np.concatenate([forked_tree(rng), crown(rng, **options)])


def encoded(xyz, **settings):
    return encode_with_report(xyz, settings=EncodeSettings(**settings))


def test_a_leafless_tree_has_no_clusters(rng):
    result = encoded(forked_tree(rng))
    assert result.tree.clusters == () and result.report.f_s == 1.0


def test_a_leafy_tree_has_them_around_its_leaves(rng):
    xyz = leafy_tree(rng)
    result = encoded(xyz)
    tree, origin = result.tree, result.tree.origin
    assert result.report.f_s < 1
    assert 5 <= len(tree.clusters) <= 80
    everything = np.concatenate([c.vertices for c in tree.clusters]) + origin
    leaves = xyz[len(xyz) - 6000 :]
    np.testing.assert_allclose(everything.min(axis=0), leaves.min(axis=0), atol=0.25)
    np.testing.assert_allclose(everything.max(axis=0), leaves.max(axis=0), atol=0.25)
    assert sum(c.n_points for c in tree.clusters) > 0.8 * len(leaves)
    for cluster in tree.clusters:
        volume = mesh_volume(cluster.vertices, cluster.faces)
        assert volume > 0
        assert cluster.density == pytest.approx(cluster.n_points / volume, rel=1e-6)
        assert len(cluster.faces) <= 80
        assert cluster.seed.size and (cluster.seed < tree.graph.n_nodes).all()
        to_seed = tree.graph.position[cluster.seed][:, None] - cluster.vertices
        assert np.linalg.norm(to_seed, axis=2).min() < 1.5


def test_f_s_1_makes_no_clusters_of_leaves(rng):
    assert encoded(leafy_tree(rng), f_s=1.0).tree.clusters == ()


def test_smaller_f_s_gives_more_to_the_clusters(rng):
    xyz = leafy_tree(rng)
    length = []
    for f_s in (0.99, 0.9, 0.6, 0.3):
        graph = encoded(xyz, f_s=f_s).tree.graph
        length.append(np.linalg.norm(graph.position[1:] - graph.position[graph.parent[1:]], axis=1).sum())
    assert length == sorted(length, reverse=True)
    assert length[-1] < 0.7 * length[0]


def test_max_clusters_sets_their_number(rng):
    xyz = leafy_tree(rng)
    few, many = (len(encoded(xyz, max_clusters=k).tree.clusters) for k in (3, 60))
    assert few < many
    assert few <= 8


def slow_separate(xyz, reach):
    piece = np.arange(len(xyz))
    for i in range(len(xyz)):
        near = np.linalg.norm(xyz - xyz[i], axis=1) <= reach
        piece[np.isin(piece, piece[near])] = piece[i]
    return piece


def test_separate_finds_the_pieces(rng):
    blobs = [rng.random((60, 3)) * 0.3 + centre for centre in ((0, 0, 0), (2, 0, 0), (0, 0, 1.5))]
    xyz = np.concatenate(blobs)[rng.permutation(180)]
    got, wanted = separate(xyz, 0.4), slow_separate(xyz, 0.4)
    assert got.max() + 1 == len(np.unique(wanted)) == 3
    for k in range(3):
        assert len(np.unique(wanted[got == k])) == 1


def test_strays_are_in_no_cluster(rng):
    xyz = np.concatenate([leafy_tree(rng), [[3.5, 3.5, 4.0]]])
    top = np.concatenate([c.vertices for c in encoded(xyz).tree.clusters])
    assert top[:, :2].max() < 2.6


def test_lumps_are_round_and_hold_every_point(rng):
    xyz = rng.random((2000, 3)) * [5, 1, 1]
    lump = lumps(xyz, 6)
    assert sorted(np.unique(lump)) == list(range(6))
    assert np.bincount(lump).max() < 3 * np.bincount(lump).min()
    assert max(np.ptp(xyz[lump == k, 0]) for k in range(6)) < 2.0
    shuffle = rng.permutation(2000)
    again = lumps(xyz[shuffle], 6)
    pairs = set(zip(lump[shuffle].tolist(), again.tolist(), strict=True))
    assert len(pairs) == 6


def test_labels_of_wood_and_leaf_are_used(rng):
    wood, leaves = forked_tree(rng), crown(rng)
    cloud = Cloud(
        np.concatenate([leaves, wood]),
        np.zeros(3),
        is_wood=np.repeat([False, True], [len(leaves), len(wood)]),
    )
    result = encode_with_report(cloud)
    bare = encode_with_report(wood, settings=EncodeSettings(f_s=1.0))
    tips = [
        int((np.bincount(t.graph.parent[1:], minlength=t.graph.n_nodes) == 0).sum())
        for t in (result.tree, bare.tree)
    ]
    assert tips[0] == tips[1]  # no branch is made of leaves
    assert sum(c.n_points for c in result.tree.clusters) > 0.85 * len(leaves)
    assert encode_with_report(cloud, settings=EncodeSettings(f_s=1.0)).tree.clusters == ()


def test_a_crown_without_wood_gets_a_guessed_stem_and_says_so(rng):
    n = 4000
    r, a = 2.5 * np.sqrt(rng.random(n)), rng.random(n) * 2 * np.pi
    xyz = np.column_stack([r * np.cos(a), r * np.sin(a), 12 * rng.random(n) * (1 - r / 2.6)])
    result = encoded(xyz[rng.permutation(n)[:1500]], f_s=0.02)
    graph = result.tree.graph
    height = float(np.ptp(xyz[:, 2]))
    assert any("the stem is a guess" in note for note in result.report.notes)
    assert not graph.attribute["measured"].any()
    assert 0.4 * height < graph.position[-1, 2] < 0.65 * height
    assert 2 * graph.radius[0] == pytest.approx(height / 80, rel=0.25)
    assert result.report.dbh_m is None
    assert len(result.tree.clusters) > 3


@pytest.mark.parametrize("f_s, far", [(1.0, 0.19), (0.5, 0.09)])
def test_an_edge_is_of_low_confidence_beyond_f_s_times_the_diameter(f_s, far):
    # two nodes, 0.5 m apart: one power of f_s, so the bound is f_s * 2 * 0.1 m
    parent, onward = np.array([-1, 0], np.int32), np.array([1, -1], np.int32)
    position, radius = np.array([[0.0, 0, 0], [0, 0, 0.5]]), np.array([0.1, 0.1])
    for spread, wanted in ((far, False), (far + 0.02, True)):
        low = kernels.low_confidence(
            parent, onward, position, radius, np.array([0.0, spread]), np.array([9, 9]), f_s, 0.5, 0.004, 0.4
        )
        assert low.tolist() == [False, wanted]


def test_points_on_the_bark_are_no_leaves(rng):
    position = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]])
    bark = tube((0, 0, 0.2), (0, 0, 1.8), 0.12, 0.12, 50, rng)
    leaves = [0.5, 0, 1.5] + 0.1 * rng.random((30, 3))
    xyz = np.concatenate([bark, leaves])
    home = np.repeat([1, 2], [50, 30]).astype(np.int32)
    tree = Skeleton(
        np.array([-1, 0, 1], np.int32), position, np.full(3, 0.1), np.full(80, -1, np.int32), home,
        np.ones(3, bool), np.ones(3), 0.05, 0.01,
    )  # fmt: skip
    (found,) = cluster_points(xyz, tree, np.zeros(80, np.int64), 1)
    assert sorted(found.row.tolist()) == list(range(50, 80)) and found.seed.tolist() == [2]


def test_one_ragged_slice_does_not_end_a_bough():
    parent, onward = np.array([-1, 0, 1, 2], np.int32), np.array([1, 2, 3, -1], np.int32)
    position, radius = np.array([[0.0, 0, z] for z in (0, 0.1, 0.2, 0.3)]), np.full(4, 0.02)
    spread = np.array([0.0, 0.1, 0.0, 0.0])
    chain = (parent, onward, position, radius, spread, np.full(4, 9), 1.0, 0.5)
    assert kernels.low_confidence(*chain, 0.004, 0.0).tolist() == [False, True, True, True]
    assert not kernels.low_confidence(*chain, 0.004, 0.4).any()
    assert kernels.low_confidence(*chain[:3], np.full(4, 0.001), 0 * spread, *chain[5:], 0.004, 0.4)[1:].all()
