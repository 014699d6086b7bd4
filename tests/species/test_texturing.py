"""Clusters filled with patches: geometry, leaf area, order, and what cannot be filled."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from species import _texturing_kernels as kernels
from species.foliage import LeafSet
from species.patches import Instances, Patch
from species.texturing import STRETCH, pack_patches, texture_tree
from treegraph import DEFAULT_ALLOMETRY, Cluster, ClusterTree, InputError, TreeGraph


def make_patch(rng, radius, n=30, size=0.3):
    """A straight twig with leaves around it and two docking points."""
    turn = rng.uniform(0, 2 * np.pi, n)
    along = np.column_stack([np.cos(turn), np.sin(turn), np.full(n, 0.3)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.cross(along, [0.0, 0.0, 1.0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    base = np.column_stack([np.zeros(n), np.zeros(n), rng.uniform(0.1, 1.0, n) * size])
    graph = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, size]], [radius, 0.5 * radius])
    leaves = LeafSet(base, along, normal, np.full(n, 0.06), np.full(n, 0.04), np.ones(n, np.int32))
    side = np.sqrt(0.5)
    docks = [[0, 0, size], [0, 0, 0.5 * size]], [[0, 0, 1], [side, 0, side]], [0.7 * radius, 0.5 * radius]
    return Patch(graph, leaves, *docks, radius=radius, slope=float(rng.uniform(-0.5, 1.2)))


def hull_of(points):
    """Vertices and outward faces of a convex hull."""
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces.astype(np.int32), hull


def ball(middle, radius, seed=0, n=40):
    direction = np.random.default_rng(seed).normal(size=(n, 3))
    return np.asarray(middle) + radius * direction / np.linalg.norm(direction, axis=1, keepdims=True)


def make_tree(*balls):
    """A trunk, and a cluster for each (middle, radius)."""
    graph = TreeGraph([-1, 0, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2]], [0.05, 0.03, 0.006])
    clusters = [
        Cluster(*hull_of(ball(middle, radius, k))[:2], seed=[2], density=np.nan, n_points=0)
        for k, (middle, radius) in enumerate(balls)
    ]
    return ClusterTree(graph, tuple(clusters), None, DEFAULT_ALLOMETRY, np.zeros(3))


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(0)
    return pack_patches([make_patch(rng, radius) for radius in np.geomspace(0.001, 0.006, 20)])


TREE = make_tree(((0, 0, 2.6), 0.8), ((1.2, 0, 2.2), 0.6))


def texture(table, tree=TREE, seed=1, **more):
    return texture_tree(tree, table, leaf_density=2.0, rng=np.random.default_rng(seed), **more)


# ---------------------------------------------------------------- geometry


@pytest.mark.parametrize("seed", range(4))
def test_volume_and_cells_of_a_hull(seed):
    points, faces, hull = hull_of(ball((0.3, -0.2, 1.0), 1.3, seed))
    npt.assert_allclose(kernels.hull_volume(points, faces), hull.volume, rtol=1e-12)
    low = points.min(axis=0)
    cell = np.ptp(points, axis=0).max() / kernels.MOST_SIDE
    size = np.maximum(1, np.ceil(np.ptp(points, axis=0) / cell)).astype(int)
    inside = np.empty(size.prod(), bool)
    kernels.fill_columns(points, faces, low, cell, *size, inside)
    middles = low + (np.indices(size).reshape(3, -1).T + 0.5) * cell
    wanted = (hull.equations[:, :3] @ middles.T + hull.equations[:, 3:] <= 0).all(axis=0)
    npt.assert_array_equal(inside, wanted)


@pytest.mark.parametrize("seed", range(20))
def test_frames_and_quaternions(seed):
    rng = np.random.default_rng(seed)
    d = rng.normal(size=3) if seed else np.array([0.0, 0.0, -1.0])
    d /= np.linalg.norm(d)
    frame, quaternion = np.empty((3, 3)), np.empty(4)
    kernels.frame_of(*d, 0.0, frame)
    npt.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) > 0
    npt.assert_allclose(frame[:, 2], d)
    if abs(d[2]) < 0.99:
        npt.assert_allclose(frame[2, 1], 0.0, atol=1e-12)  # x is up as far as it can be
        assert frame[2, 0] > 0
    kernels.frame_of(*d, 1.1, frame)
    kernels.quaternion_of(frame, quaternion)
    npt.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), frame, atol=1e-12)


def test_match_is_best_for_equal_thickness_and_slope():
    assert kernels.score_match(2.0, 0.3, 2.0, 0.3) == 1.0
    npt.assert_allclose(kernels.score_match(1.0, 0.3, 2.0, 0.3), 0.5)
    npt.assert_allclose(kernels.score_match(2.0, 0.0, 2.0, 1.0), np.cos(1.0))
    assert kernels.score_match(2.0, -1.5, 2.0, 1.5) == 0.0


# ---------------------------------------------------------------- filling


def test_leaf_area_is_density_times_volume(table):
    made = texture(table)
    volume = [kernels.hull_volume(c.vertices, c.faces) for c in TREE.clusters]
    npt.assert_allclose(made.target, 2.0 * np.array(volume))
    npt.assert_allclose(made.leaf_area, made.target, rtol=1e-9)
    rows = made.instances
    counted = np.bincount(rows.cluster, table.leaf_area[rows.patch] * rows.scale**2)
    npt.assert_allclose(counted, made.leaf_area, rtol=1e-9)


def test_patches_lie_in_their_cluster(table):
    rows = texture(table).instances
    for k, cluster in enumerate(TREE.clusters):
        hull = ConvexHull(cluster.vertices)
        mine = np.flatnonzero(rows.cluster == k)
        turn = Rotation.from_quat(rows.rotation[mine])
        share = []
        for i, row in enumerate(mine):
            points = rows.position[row] + rows.scale[row] * turn[i].apply(table.sample[rows.patch[row]])
            share.append(
                (hull.equations[:, :3] @ points.T + hull.equations[:, 3:] <= 0.05).all(axis=0).mean()
            )
        assert np.mean(share) > 0.75
        assert np.min(share) > 0.3


def test_all_of_a_cluster_is_filled(table):
    tree = make_tree(((0, 0, 2.9), 1.0))
    rows = texture(table, tree).instances
    turn = Rotation.from_quat(rows.rotation)
    points = np.concatenate(
        [
            rows.position[i] + rows.scale[i] * turn[i].apply(table.sample[rows.patch[i]])
            for i in range(len(rows))
        ]
    )
    hull = ConvexHull(tree.clusters[0].vertices)
    room = np.random.default_rng(0).uniform((-1, -1, 1.9), (1, 1, 3.9), (20_000, 3))
    room = room[(hull.equations[:, :3] @ room.T + hull.equations[:, 3:] <= 0).all(axis=0)]

    def share(points):
        return np.bincount(((points - (0, 0, 2.9)) > 0) @ [4, 2, 1], minlength=8) / len(points)

    assert (share(points) / share(room)).min() > 0.25
    assert (share(points) / share(room)).max() < 1.7


def test_the_first_patch_docks_at_the_seed(table):
    made = texture(table, make_tree(((0, 0, 2.8), 1.0)))
    npt.assert_allclose(made.instances.position[0], [0, 0, 2])
    up = Rotation.from_quat(made.instances.rotation[0]).apply([0, 0, 1])
    assert up[2] > 0.99
    assert made.free < len(made.instances)


def test_same_seed_same_bytes_and_clusters_apart(table):
    one, two, other = texture(table), texture(table), texture(table, seed=2)
    assert one.instances.position.tobytes() == two.instances.position.tobytes()
    assert one.instances.order.tobytes() == two.instances.order.tobytes()
    assert one.instances.position.tobytes() != other.instances.position.tobytes()
    less = texture(table, density=[1.0, 0.0])
    first = one.instances.cluster == 0
    npt.assert_array_equal(one.instances.position[first], less.instances.position)
    assert less.leaf_area[1] == less.target[1] == 0.0


def test_density_scales_the_leaves(table):
    full, half = texture(table), texture(table, density=0.5)
    npt.assert_allclose(half.leaf_area, 0.5 * full.leaf_area)
    assert len(half.instances) < 0.7 * len(full.instances)


def test_stretch_is_bounded(table):
    """A cluster smaller than a patch keeps patches of a bearable size, and says what it holds."""
    made = texture(table, make_tree(((0, 0, 2.2), 0.22)))
    assert made.leaf_area[0] >= made.target[0]
    assert (made.instances.scale >= kernels.LEAST_SCALE * STRETCH[0] - 1e-12).all()


def test_a_tree_without_clusters(table):
    made = texture(table, ClusterTree(TREE.graph, (), None, DEFAULT_ALLOMETRY, np.zeros(3)))
    assert len(made.instances) == made.free == len(made.target) == 0


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize("value", [0.0, -1.0, 51.0, np.nan])
def test_bad_density(table, value):
    with pytest.raises(InputError, match="leaf_density must be above 0 and at most 50 m2/m3, got"):
        texture_tree(TREE, table, leaf_density=value, rng=np.random.default_rng(0))


@pytest.mark.parametrize("value", [-1.0, np.nan, [1.0, np.inf]])
def test_bad_factor(table, value):
    with pytest.raises(InputError, match="density must be finite numbers >= 0"):
        texture(table, density=value)


BARE = LeafSet(*(np.empty((0, 3)),) * 3, np.empty(0), np.empty(0), np.empty(0, np.int32))


def test_patches_need_leaves():
    with pytest.raises(InputError, match="at least one patch"):
        pack_patches([])
    patch = make_patch(np.random.default_rng(0), 0.002)
    with pytest.raises(InputError, match="at least one patch must have leaves, but none of 1 has"):
        pack_patches([Patch(patch.graph, BARE)])


@pytest.mark.parametrize("share", [0.0, 1.1, np.nan])
def test_bad_leaf_share(share):
    with pytest.raises(InputError, match="leaf_share must be above 0 and at most 1, got"):
        pack_patches([make_patch(np.random.default_rng(0), 0.002)], leaf_share=share)


def test_leaf_area_of_a_patch():
    patch = make_patch(np.random.default_rng(0), 0.002, n=30)
    npt.assert_allclose(pack_patches([patch]).leaf_area, 0.5 * 30 * 0.06 * 0.04)
    npt.assert_allclose(pack_patches([patch], leaf_share=0.8).leaf_area, 0.8 * 30 * 0.06 * 0.04)


def test_a_bare_patch_is_sampled_on_its_wood():
    patch = make_patch(np.random.default_rng(0), 0.002)
    bare = Patch(patch.graph, BARE, [[0.0, 0.0, 0.1]], [[0.0, 0.0, 1.0]], [0.001])
    table = pack_patches([patch, bare])
    assert table.leaf_area[1] == 0.0
    assert {tuple(row) for row in table.sample[1]} == {(0, 0, 0), (0, 0, 0.3), (0, 0, 0.1)}


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"dock_radius": [0.0]}, "dock_radius must be positive"),
        ({"dock_direction": [[0, 0, 2]]}, "dock_direction must be unit vectors"),
        ({"dock_position": [[0, 0]]}, "dock_position must have shape"),
        ({"radius": 0.0}, "radius must be a positive finite number of metres, got 0.0"),
    ],
)
def test_bad_patches(changes, message):
    patch = make_patch(np.random.default_rng(0), 0.002)
    fine = {"dock_position": [[0, 0, 1]], "dock_direction": [[0, 0, 1]], "dock_radius": [0.001]}
    with pytest.raises(InputError, match=message):
        Patch(patch.graph, patch.leaves, **{**fine, **changes})


def test_bad_instances():
    fine = dict(patch=[0], position=[[0, 0, 0]], rotation=[[0, 0, 0, 1]], scale=[1], cluster=[0], order=[0])
    assert len(Instances(**fine)) == 1
    for changes, message in (
        ({"scale": [0.0]}, "scale must be positive"),
        ({"rotation": [[0, 0, 0, 2]]}, "rotation must be unit quaternions"),
        ({"order": [1]}, "order must be a permutation of 0 to 0"),
        ({"patch": [0.5]}, "patch must be integers of shape"),
    ):
        with pytest.raises(InputError, match=message):
            Instances(**{**fine, **changes})
