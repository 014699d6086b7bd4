import numpy as np
from synthetic import crown, tube

from recon.neighbours import bridge_gaps, neighbour_graph, trusted_graph
from recon.ordering import morton_order
from recon.skeleton import Skeleton, base_points, keep_nodes, slice_tree


def sliced(xyz):
    xyz = xyz[morton_order(xyz)[0]]
    graph = bridge_gaps(xyz, neighbour_graph(xyz))
    sources = base_points(xyz, np.zeros(3), graph.spacing)
    return slice_tree(xyz, trusted_graph(graph, sources, 2.0, 4 * graph.spacing), sources), xyz


def spread(skeleton, xyz):
    off = ((xyz - skeleton.position[skeleton.label]) ** 2).sum(axis=1)
    count = np.bincount(skeleton.label)
    return np.sqrt(np.bincount(skeleton.label, off) / count)


def test_slices_of_a_trunk_are_rings_in_a_row(rng):
    skeleton, xyz = sliced(tube((0, 0, 0), (0, 0, 3), 0.1, 0.1, 8000, rng))
    assert skeleton.parent.tolist() == [-1, *range(skeleton.n_nodes - 1)]
    assert np.hypot(*skeleton.position[1:-1, :2].T).max() < 0.05
    assert np.ptp(np.diff(skeleton.position[1:-1, 2])) < 2 * skeleton.slice_width
    assert np.bincount(skeleton.label).min() > 0 and (skeleton.label == skeleton.home).all()


def test_shells_of_foliage_are_split(rng):
    stem = tube((0, 0, 0), (0, 0, 2.2), 0.05, 0.05, 4000, rng)
    skeleton, xyz = sliced(np.concatenate([stem, crown(rng, 6000, (0, 0, 3.0), (1.0, 1.0, 1.0))]))
    assert spread(skeleton, xyz)[1:].max() < 0.5  # of a whole shell: up to 1


def test_legs_that_stand_apart_have_one_root(rng):
    legs = [tube((x, 0, 0), (0, 0, 1.0), 0.03, 0.03, 2000, rng) for x in (-0.25, 0.25)]
    skeleton, _ = sliced(np.concatenate([*legs, tube((0, 0, 1.0), (0, 0, 2.0), 0.04, 0.04, 2000, rng)]))
    assert (skeleton.parent < 0).sum() == 1 and skeleton.parent[0] == -1
    assert (skeleton.parent[1:] < np.arange(1, skeleton.n_nodes)).all()


def test_points_of_dropped_nodes_go_to_the_next_one_outwards(rng):
    # a stem 0-1-2 with two branches 3-5 and 4-6; 1, 3 and 4 go
    label = np.array([0, 1, 2, 3, 4, 5, 6, -1], np.int32)
    home = np.array([0, 1, 2, 3, 4, 5, 6, 3], np.int32)
    position = rng.random((7, 3))
    parent = np.array([-1, 0, 1, 2, 2, 3, 4], np.int32)
    tree = Skeleton(parent, position, np.arange(7.0), label, home, np.ones(7, bool), np.ones(7), 0.05, 0.01)
    kept = np.array([0, 2, 5, 6])
    short = keep_nodes(tree, kept)
    assert short.parent.tolist() == [-1, 0, 1, 1]
    assert short.label.tolist() == [0, 1, 1, 2, 3, 2, 3, -1]
    assert short.home.tolist() == [0, 1, 1, 2, 3, 2, 3, 2]
    np.testing.assert_array_equal(short.position, position[kept])
    np.testing.assert_array_equal(short.radius, kept)
