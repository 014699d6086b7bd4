"""Clusters filled with patches: geometry, leaf area, order, and what cannot be filled."""

import numpy as np
import numpy.testing as npt
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from species import _space_kernels as space
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
    npt.assert_allclose(space.hull_volume(points, faces), hull.volume, rtol=1e-12)
    low = points.min(axis=0)
    cell = np.ptp(points, axis=0).max() / kernels.MOST_SIDE
    size = np.maximum(1, np.ceil(np.ptp(points, axis=0) / cell)).astype(int)
    inside = np.empty(size.prod(), bool)
    space.fill_columns(points, faces, low, cell, *size, inside)
    middles = low + (np.indices(size).reshape(3, -1).T + 0.5) * cell
    wanted = (hull.equations[:, :3] @ middles.T + hull.equations[:, 3:] <= 0).all(axis=0)
    npt.assert_array_equal(inside, wanted)


@pytest.mark.parametrize("seed", range(20))
def test_frames_and_quaternions(seed):
    rng = np.random.default_rng(seed)
    d = rng.normal(size=3) if seed else np.array([0.0, 0.0, -1.0])
    d /= np.linalg.norm(d)
    frame, quaternion = np.empty((3, 3)), np.empty(4)
    space.frame_of(*d, 0.0, frame)
    npt.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) > 0
    npt.assert_allclose(frame[:, 2], d)
    if abs(d[2]) < 0.99:
        npt.assert_allclose(frame[2, 1], 0.0, atol=1e-12)  # x is up as far as it can be
        assert frame[2, 0] > 0
    space.frame_of(*d, 1.1, frame)
    space.quaternion_of(frame, quaternion)
    npt.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), frame, atol=1e-12)


def test_match_is_best_for_equal_thickness_and_slope():
    assert kernels.score_match(2.0, 0.3, 2.0, 0.3) == 1.0
    npt.assert_allclose(kernels.score_match(1.0, 0.3, 2.0, 0.3), 0.5)
    npt.assert_allclose(kernels.score_match(2.0, 0.0, 2.0, 1.0), np.cos(1.0))
    assert kernels.score_match(2.0, -1.5, 2.0, 1.5) == 0.0


# ---------------------------------------------------------------- filling


def volumes(tree):
    return np.array([space.hull_volume(c.vertices, c.faces) for c in tree.clusters])


def test_leaf_area_is_density_times_volume(table):
    made = texture(table)
    npt.assert_allclose(made.target, 2.0 * volumes(TREE))
    npt.assert_allclose(made.leaf_area, made.target, rtol=0.1)
    npt.assert_allclose(made.leaf_area.sum(), made.target.sum(), rtol=1e-9)
    rows = made.instances
    counted = np.bincount(rows.cluster, table.leaf_area[rows.patch] * rows.scale**2)
    npt.assert_allclose(counted, made.leaf_area, rtol=1e-9)


def points_of(table, rows, i):
    turn = Rotation.from_quat(rows.rotation[i])
    return rows.position[i] + rows.scale[i] * turn.apply(table.sample[rows.patch[i]])


def test_patches_lie_in_their_cluster(table):
    rows = texture(table).instances
    for k, cluster in enumerate(TREE.clusters):
        hull = ConvexHull(cluster.vertices)
        share = []
        for i in np.flatnonzero(rows.cluster == k):
            points = points_of(table, rows, i)
            share.append(
                (hull.equations[:, :3] @ points.T + hull.equations[:, 3:] <= 0.05).all(axis=0).mean()
            )
        assert np.mean(share) > 0.75
        assert np.mean(np.array(share) < 0.3) < 0.1  # but for those that lead there


def test_all_of_a_cluster_is_filled(table):
    tree = make_tree(((0, 0, 2.9), 1.0))
    rows = texture(table, tree).instances
    points = np.concatenate([points_of(table, rows, i) for i in range(len(rows))])
    hull = ConvexHull(tree.clusters[0].vertices)
    room = np.random.default_rng(0).uniform((-1, -1, 1.9), (1, 1, 3.9), (20_000, 3))
    room = room[(hull.equations[:, :3] @ room.T + hull.equations[:, 3:] <= 0).all(axis=0)]

    def share(points):
        return np.bincount(((points - (0, 0, 2.9)) > 0) @ [4, 2, 1], minlength=8) / len(points)

    assert (share(points) / share(room)).min() > 0.6
    assert (share(points) / share(room)).max() < 1.6


def test_the_first_patch_docks_at_the_seed(table):
    made = texture(table, make_tree(((0, 0, 2.8), 1.0)))
    npt.assert_allclose(made.instances.position[0], [0, 0, 2])
    up = Rotation.from_quat(made.instances.rotation[0]).apply([0, 0, 1])
    assert up[2] > 0.99
    assert made.holder[0] == -1


def test_same_seed_same_bytes_and_clusters_apart(table):
    one, two, other = texture(table), texture(table), texture(table, seed=2)
    for name in ("patch", "position", "rotation", "scale", "order"):
        assert getattr(one.instances, name).tobytes() == getattr(two.instances, name).tobytes()
    assert one.instances.position.tobytes() != other.instances.position.tobytes()
    less = texture(table, density=[1.0, 0.0])
    first = one.instances.cluster == 0
    npt.assert_array_equal(one.instances.position[first], less.instances.position)
    assert less.leaf_area[1] == less.target[1] == 0.0


def test_density_scales_the_leaves(table):
    full, half = texture(table), texture(table, density=0.5)
    npt.assert_allclose(half.target, 0.5 * full.target)
    npt.assert_allclose(half.leaf_area.sum(), 0.5 * full.leaf_area.sum(), rtol=1e-9)
    assert len(half.instances) < 0.7 * len(full.instances)


def with_density(tree, *density):
    clusters = tuple(
        Cluster(c.vertices, c.faces, seed=c.seed, density=value, n_points=0)
        for c, value in zip(tree.clusters, density, strict=True)
    )
    return ClusterTree(tree.graph, clusters, None, DEFAULT_ALLOMETRY, np.zeros(3))


def test_density_of_the_scan(table):
    """Root of the density over the mean by volume; bounded; the sum stays; unknown is the mean."""
    volume = volumes(TREE)
    plain = texture(table).target
    points = np.array([400.0, 1600.0])
    got = texture(table, with_density(TREE, *points), follow_scan=True).target
    weight = np.sqrt(points / (points @ volume / volume.sum()))
    npt.assert_allclose(got / plain, weight * (plain.sum() / (plain @ weight)))
    npt.assert_allclose(got.sum(), plain.sum())
    got = texture(table, with_density(TREE, 1.0, 1e9), follow_scan=True).target
    assert 1.0 < (got / plain)[1] / (got / plain)[0] <= 4.0  # 0.5 to 2
    for densities in ((np.nan, 5.0), (np.nan, np.nan), (0.0, 0.0)):
        got = texture(table, with_density(TREE, *densities), follow_scan=True).target
        npt.assert_allclose(got, plain)
    got = texture(table, with_density(TREE, *points), follow_scan=True, density=[1.0, 0.0]).target
    npt.assert_allclose(got, [plain[0], 0.0])


def test_small_clusters_get_the_right_leaf_area_on_average(table):
    """Each has room for a third of the smallest patch: one of three gets one, and the tree's sum is right."""
    area = table.leaf_area[0]
    rng = np.random.default_rng(3)
    radius = (area / 3.0 / 2.0 / 3.9) ** (1.0 / 3.0)
    way = rng.normal(size=(400, 3)) + (0.0, 0.0, 3.0)
    way[:, 2] = np.abs(way[:, 2])
    places = (0.0, 0.0, 2.0) + 0.17 * way / np.linalg.norm(way, axis=1, keepdims=True)
    tree = make_tree(*((place, radius) for place in places))
    made = texture(table, tree)
    wanted = made.target.sum() / area
    assert abs(len(made.instances) - wanted) < 4.0 * np.sqrt(wanted)
    npt.assert_allclose(made.leaf_area.sum(), made.target.sum(), rtol=1e-9)
    assert np.unique(made.instances.cluster).size == len(made.instances)


@pytest.mark.parametrize("limits", [(0.8, 1.25), (0.5, 2.0), (1.0, 1.0)])
def test_scales_are_bounded(table, limits):
    scale = texture(table, scale_limits=limits).instances.scale
    assert (scale >= limits[0] * STRETCH[0] - 1e-12).all()
    assert (scale <= limits[1] * STRETCH[1] + 1e-12).all()
    if limits == (0.5, 2.0):
        assert scale.min() < 0.75 < 1.4 < scale.max()


def test_a_tree_without_clusters(table):
    made = texture(table, ClusterTree(TREE.graph, (), None, DEFAULT_ALLOMETRY, np.zeros(3)))
    assert len(made.instances) == len(made.holder) == len(made.target) == 0


def test_a_flat_cluster_is_filled(table):
    """Thinner than a cell of the grid, so that no middle of a cell is in it."""
    points = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (2.2, 2.25)])
    points += np.random.default_rng(0).uniform(0.0, 1e-3, points.shape)
    cluster = Cluster(*hull_of(points)[:2], seed=[2], density=np.nan, n_points=0)
    tree = ClusterTree(TREE.graph, (cluster,), None, DEFAULT_ALLOMETRY, np.zeros(3))
    made = texture(table, tree)
    npt.assert_allclose(made.leaf_area, made.target, rtol=0.05)


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


@pytest.mark.parametrize("limits", [(0.05, 1.0), (1.25, 0.8), (0.8, 11.0), (np.nan, 1.0)])
def test_bad_scale_limits(table, limits):
    with pytest.raises(InputError, match="scale_limits must be two ascending numbers from 0.1 to 10, got"):
        texture(table, scale_limits=limits)


@pytest.mark.parametrize("bend", [-3.1, np.nan])
def test_bad_leaf_bend(bend):
    with pytest.raises(InputError, match="leaf_bend must be an angle of -3 to 3 radians, got"):
        pack_patches([make_patch(np.random.default_rng(0), 0.002)], leaf_bend=bend)


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
