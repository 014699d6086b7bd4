"""Growth of patches to empty places: what they hang on, how far they turn, what they reach."""

from functools import cache
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import species
from species import _texturing_kernels as kernels
from species.foliage import LeafSet
from species.library.branchlets import cut_branchlet, derive_branchlets
from species.library.definition import read_definition
from species.patches import Patch
from species.texturing import SCALE, pack_patches, texture_tree
from treegraph import DEFAULT_ALLOMETRY, Cluster, ClusterTree, TreeGraph

TURN = np.degrees(np.arccos(kernels.COS_TURN))
BARE = LeafSet(*(np.empty((0, 3)),) * 3, np.empty(0), np.empty(0), np.empty(0, np.int32))


def leaves_at(base, along, length=0.06, width=0.04):
    n = len(base)
    along = np.tile(along, (n, 1)).astype(float)
    normal = np.cross(along, [0.0, 1.0, 0.0])
    return LeafSet(
        np.asarray(base, float), along, normal, np.full(n, length), np.full(n, width), np.ones(n, np.int32)
    )


def twig(radius, size, leaves=8, docks=(), slope=0.3):
    """A straight twig with leaves along its outer half, and docking points at shares of its length."""
    graph = TreeGraph(
        [-1, 0, 1], [[0, 0, 0], [0, 0, 0.5 * size], [0, 0, size]], radius * np.array([1, 0.8, 0.6])
    )
    base = np.column_stack([np.zeros((leaves, 2)), np.linspace(0.5, 1.0, leaves) * size])
    found = leaves_at(base, [0.0, 0.0, 1.0]) if leaves else BARE
    side = [[np.sqrt(0.75), 0.0, 0.5]] * len(docks)
    place = [[0.0, 0.0, share * size] for share in docks]
    fields = (np.reshape(place, (-1, 3)), np.reshape(side, (-1, 3)), np.full(len(docks), 0.6 * radius))
    return Patch(graph, found, *fields, radius=radius, slope=slope)


def simple_patches(bare_links=False):
    """Short twigs that end texturing, and long ones with docking points."""
    ends = [twig(radius, size) for radius, size in ((0.001, 0.08), (0.0015, 0.14), (0.002, 0.2))]
    docks = (0.3, 0.6, 0.9)
    links = [twig(0.004, 0.6, 3, docks), twig(0.006, 0.9, 3, docks)]
    return ends + links + ([twig(0.005, 0.8, 0, docks), twig(0.003, 0.5, 0, docks)] if bare_links else [])


@cache
def oak():
    definition = read_definition(Path(species.__file__).parent / "library" / "kinds" / "oak.toml")
    whole = derive_branchlets(definition)
    return tuple(patch for k, branchlet in enumerate(whole) for patch in cut_branchlet(branchlet, k))


def box(low, high):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    points = np.asarray(low) + corners * (np.asarray(high) - low)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = np.einsum("ij,ij->i", normal, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces.astype(np.int32)


def make_tree(boxes, seeds=None):
    """A trunk with a bough to the side; a cluster for each box."""
    position = [[0, 0, 0], [0, 0, 1.5], [0, 0, 3.0], [0.4, 0, 1.9], [0.9, 0, 2.2]]
    graph = TreeGraph([-1, 0, 1, 1, 3], position, [0.08, 0.06, 0.02, 0.02, 0.006])
    seeds = seeds or [[2, 4]] * len(boxes)
    clusters = [
        Cluster(*box(*edges), seed=seed, density=np.nan, n_points=0)
        for edges, seed in zip(boxes, seeds, strict=True)
    ]
    return ClusterTree(graph, tuple(clusters), None, DEFAULT_ALLOMETRY, np.zeros(3))


NEAR = ([-0.7, -0.7, 2.4], [0.7, 0.7, 3.8])
FAR = ([1.9, -0.5, 3.2], [2.9, 0.5, 4.2])  # its seeds are 1 m away
LOW = ([0.2, -0.4, 1.2], [1.2, 0.4, 1.8])  # below the bough
TREE = make_tree([NEAR, FAR, LOW])


def texture(patches, tree=TREE, seed=0, **more):
    rng = np.random.default_rng(seed)
    return texture_tree(tree, pack_patches(patches), leaf_density=1.5, rng=rng, **more)


def distance_to_lines(points, start, end):
    """Distance of each point from the nearest of some line segments: slow and obvious."""
    out = np.empty(len(points))
    for k, point in enumerate(points):
        along = end - start
        share = np.einsum("ij,ij->i", point - start, along) / np.maximum((along**2).sum(axis=1), 1e-30)
        foot = start + np.clip(share, 0.0, 1.0)[:, None] * along
        out[k] = np.linalg.norm(point - foot, axis=1).min()
    return out


def wood_lines(graph):
    node = np.flatnonzero(graph.parent >= 0)
    return graph.position[graph.parent[node]], graph.position[node]


def attachment_gaps(made, patches, tree):
    """How far each root is from the branch, or the docks and wood of the patch, that it hangs on."""
    rows, out = made.instances, []
    for i, holder in enumerate(made.holder):
        root = rows.position[i : i + 1]
        if holder < 0:
            out.append(distance_to_lines(root, *wood_lines(tree.graph))[0])
            continue
        patch = patches[rows.patch[holder]]
        turn = Rotation.from_quat(rows.rotation[holder])
        back = turn.inv().apply(root - rows.position[holder]) / rows.scale[holder]
        gap = distance_to_lines(back, *wood_lines(patch.graph))[0]
        if patch.n_docks:
            gap = min(gap, np.linalg.norm(patch.dock_position - back, axis=1).min())
        out.append(rows.scale[holder] * gap)
    return np.array(out)


# ---------------------------------------------------------------- attachment


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["simple", "bare links", "oak"])
def test_every_patch_hangs_on_something(kind, seed):
    patches = oak() if kind == "oak" else simple_patches(kind == "bare links")
    made = texture(patches, seed=seed)
    assert len(made.instances) > 100
    assert attachment_gaps(made, patches, TREE).max() < 1e-6
    held = made.holder >= 0
    assert (made.holder < np.arange(len(held))).all()
    assert 0.2 < held.mean() < 1.0
    npt.assert_array_equal(made.instances.cluster[held], made.instances.cluster[made.holder[held]])


def test_attachment_survives_the_correction_of_the_leaf_area():
    """Only patches that carry nothing are scaled at the end, so that no docking point moves."""
    patches = simple_patches()
    tree = make_tree([([-0.2, -0.2, 3.0], [0.2, 0.2, 3.3])])  # few patches: the correction is large
    made = texture(patches, tree)
    carries = np.zeros(len(made.holder), bool)
    carries[made.holder[made.holder >= 0]] = True
    assert attachment_gaps(made, patches, tree).max() < 1e-6
    scale = made.instances.scale[carries]
    assert ((scale >= SCALE[0] - 1e-12) & (scale <= SCALE[1] + 1e-12)).all()


@pytest.mark.parametrize("kind", ["simple", "oak"])
def test_turns_are_limited(kind):
    """A patch sets off within 70 degrees of what it hangs on: a seed's fan, a branch, a dock, an axis."""
    patches = oak() if kind == "oak" else simple_patches()
    made = texture(patches)
    rows, turns = made.instances, []
    for i in np.flatnonzero(made.holder >= 0):
        holder = made.holder[i]
        patch, turn = patches[rows.patch[holder]], Rotation.from_quat(rows.rotation[holder])
        back = turn.inv().apply(rows.position[i] - rows.position[holder]) / rows.scale[holder]
        way = turn.inv().apply(Rotation.from_quat(rows.rotation[i]).apply([0, 0, 1]))
        start, end = wood_lines(patch.graph)
        place = np.concatenate([patch.dock_position, end])
        ways = np.concatenate(
            [patch.dock_direction, (end - start) / np.linalg.norm(end - start, axis=1)[:, None]]
        )
        here = np.linalg.norm(place - back, axis=1) < 1e-6
        turns.append(np.degrees(np.arccos(np.clip((ways[here] @ way).max(), -1.0, 1.0))))
    assert max(turns) < TURN + 0.01
    assert np.mean(np.array(turns) > 20.0) > 0.05  # some are grown, and not all straight on


# ---------------------------------------------------------------- reaching places


def share_inside(made, cluster, patches, tree=TREE):
    table = pack_patches(patches)
    low, high = tree.clusters[cluster].vertices.min(axis=0), tree.clusters[cluster].vertices.max(axis=0)
    rows, inside = made.instances, []
    for i in np.flatnonzero(rows.cluster == cluster):
        points = Rotation.from_quat(rows.rotation[i]).apply(table.sample[rows.patch[i]])
        points = rows.position[i] + rows.scale[i] * points
        area = table.leaf_area[rows.patch[i]] * rows.scale[i] ** 2
        inside.append((area * ((points > low) & (points < high)).all(axis=1).mean(), area))
    return np.sum(inside, axis=0)


@pytest.mark.parametrize("kind", ["simple", "bare links", "oak"])
def test_far_clusters_are_reached(kind):
    """Over patches in between, for no patch alone is long enough; most of the leaves are inside."""
    patches = oak() if kind == "oak" else simple_patches(kind == "bare links")
    made = texture(patches)
    inside, area = share_inside(made, 1, patches)
    assert inside > 0.6 * made.target[1]
    assert inside / area > 0.6
    npt.assert_allclose(made.leaf_area.sum(), made.target.sum(), rtol=1e-9)


def test_bare_links_cost_no_leaves():
    patches = simple_patches(bare_links=True)
    made, leafy = texture(patches), texture(simple_patches())
    inside, area = share_inside(made, 1, patches)
    assert inside / area > 0.8
    assert np.isin(made.instances.patch, (5, 6)).any()
    off = [abs(each.leaf_area[1] / each.target[1] - 1.0) for each in (made, leafy)]
    assert off[0] < off[1] + 0.05


def test_patches_without_docks_carry_nothing():
    """A palm's fronds: all begin at the stem; what is out of their reach stays empty."""
    patches = [twig(0.004, size, 6) for size in (0.6, 0.8, 1.0)]
    made = texture(patches)
    assert (made.holder == -1).all()
    assert (made.instances.cluster == 0).any()
    inside, _ = share_inside(made, 0, patches)
    assert inside > 0.6 * made.target[0]


def test_clusters_without_seeds_grow_from_the_nearest_branch():
    patches = simple_patches()
    near, far = LOW, ([-0.5, -0.5, 8.2], [0.5, 0.5, 9.0])
    tree = make_tree([near, far], seeds=[[], []])  # 5 m are the limit
    made = texture(patches, tree)
    assert attachment_gaps(made, patches, tree).max() < 1e-6
    assert set(made.instances.cluster) == {0}
    npt.assert_allclose(made.leaf_area.sum(), made.target.sum(), rtol=0.7)


def test_droop_and_bend_are_made_good():
    """Fronds whose leaves hang down are raised, so that they come to their place."""
    straight = twig(0.004, 0.2, 1)
    frond = Patch(
        straight.graph,
        LeafSet(
            np.array([[0.0, 0.0, 0.2]]), np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]]),
            np.array([1.0]), np.array([0.3]), np.ones(1, np.int32),
        ),
        radius=0.004,
    )  # fmt: skip
    bend = 1.4
    table, flat = pack_patches([frond], leaf_bend=bend), pack_patches([frond])
    share = (np.arange(kernels.SAMPLES) + 0.5) * 0.6180339887498949 % 1.0
    npt.assert_allclose(flat.sample[0], np.column_stack([0 * share, 0 * share, 0.2 + share]), atol=1e-5)
    arc = np.column_stack([(np.cos(bend * share) - 1) / bend, 0 * share, 0.2 + np.sin(bend * share) / bend])
    npt.assert_allclose(table.sample[0], arc, atol=1e-12)
    middle = arc.mean(axis=0)
    npt.assert_allclose(table.reach, np.linalg.norm(middle))
    npt.assert_allclose(table.droop, np.arctan2(-middle[0], middle[2]))
    place, dock, frame, way = np.array([0.5, 0.3, 0.2]), np.zeros(3), np.empty((3, 3)), np.empty(3)
    assert kernels.aim(place, dock, np.array([0.0, 0.6, 0.8]), table.droop[0], way)
    kernels.frame_of(*way, 0.0, frame)
    lands = frame @ middle
    npt.assert_allclose(lands / np.linalg.norm(lands), place / np.linalg.norm(place), atol=1e-12)


corners = st.tuples(*[st.floats(-3.0, 3.0)] * 2, st.floats(0.0, 5.0))
sizes = st.tuples(*[st.floats(0.01, 1.5)] * 3)


@given(
    st.lists(st.tuples(corners, sizes, st.lists(st.integers(0, 4), max_size=3)), max_size=4),
    st.sampled_from(["simple", "bare links", "ends", "links"]),
    st.lists(st.booleans(), min_size=5, max_size=5),
    st.integers(0, 2**32),
)
@settings(deadline=None, max_examples=40)
def test_any_tree_is_filled_without_loose_ends(clusters, kind, unknown, seed):
    simple = simple_patches()
    patches = {"ends": simple[:3], "links": simple[3:], "simple": simple}.get(kind) or simple_patches(True)
    boxes = [(low, np.add(low, size)) for low, size, _ in clusters]
    tree = make_tree(boxes, seeds=[list(seeds) for _, _, seeds in clusters] or None)
    radius = np.where(unknown, np.nan, tree.graph.radius)
    tree = ClusterTree(tree.graph.replace(radius=radius), tree.clusters, None, DEFAULT_ALLOMETRY, np.zeros(3))
    made = texture(patches, tree, seed)
    assert np.isfinite(made.leaf_area).all()
    assert made.leaf_area.sum() <= made.target.sum() * (1.0 + 1e-9)  # or less, where nothing is in reach
    assert (made.holder < np.arange(len(made.holder))).all()
    assert attachment_gaps(made, patches, tree).max(initial=0.0) < 1e-6
    area = pack_patches(patches).leaf_area[made.instances.patch] * made.instances.scale**2
    npt.assert_allclose(area.sum(), made.leaf_area.sum())


# ---------------------------------------------------------------- kernels


def make_docks(rows):
    """Docks from (place, direction, radius, span, kind, used)."""
    n = len(rows)
    place, way, radius, span, kind, used = zip(*rows, strict=True)
    return kernels.Docks(
        np.array(place, float), np.array(way, float), np.array(radius), np.array(span), np.zeros(n),
        np.array(kind), np.full(n, -1), np.array(used),
    )  # fmt: skip


UP, SIDE = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)
PLACE = np.array([0.0, 0.0, 1.0])
PLAIN = ((0.0, 0.0, 0.0), UP, 0.002, 2.0, kernels.QUEUED, False)  # 1 m straight below the place


@pytest.mark.parametrize(
    "other, wins",
    [
        (((0.0, 0.0, 0.1), UP, 0.002, 2.0, kernels.QUEUED, False), True),  # nearer
        (((0.0, 0.0, 0.1), UP, 0.002, 2.0, kernels.QUEUED, True), False),  # 0.9 m, but used: counts 1.17
        (((0.0, 0.0, 0.3), UP, 0.002, 2.0, kernels.QUEUED, True), True),
        (((0.0, 0.0, 0.15), UP, 0.002, 2.0, kernels.WOOD, False), False),  # 0.85 m, of wood: counts 1.06
        (((0.0, 0.0, 0.25), UP, 0.002, 2.0, kernels.WOOD, False), True),
        (((0.0, 0.0, 0.9), SIDE, 0.002, 2.0, kernels.QUEUED, False), False),  # points elsewhere
        (((0.0, 0.0, 0.5), UP, 0.002, 0.1, kernels.QUEUED, False), False),  # no patch is long enough
        (((0.0, 0.0, 0.5), UP, 0.01, 0.1, kernels.QUEUED, False), True),  # but thick enough to lead on
    ],
)
def test_the_dock_with_the_shortest_way(other, wins):
    docks = make_docks([PLAIN, other])
    found, gap = kernels.find_dock(PLACE, docks, 2, 0.005, np.array([0.8, 1.25]))
    assert found == wins
    npt.assert_allclose(gap, 1.0 - docks.place[found, 2])
    assert kernels.find_dock(PLACE, docks, 0, 0.005, np.array([0.8, 1.25]))[0] == -1


@pytest.mark.parametrize("angle", [0.0, 30.0, 69.0, 71.0, 120.0, 180.0])
def test_aim_turns_by_70_degrees_at_most(angle):
    dock_way = np.array([0.36, 0.48, 0.8])
    across = np.cross(dock_way, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    wanted = np.cos(np.radians(angle)) * dock_way + np.sin(np.radians(angle)) * across
    way = np.empty(3)
    comes = kernels.aim(0.3 + 0.7 * wanted, np.full(3, 0.3), dock_way, 0.0, way)
    assert comes == (angle <= 70.0)
    npt.assert_allclose(np.linalg.norm(way), 1.0)
    npt.assert_allclose(np.degrees(np.arccos(way @ dock_way)), min(angle, 70.0), atol=1e-4)
    if 0.0 < angle < 180.0:
        npt.assert_allclose(np.dot(np.cross(dock_way, across), way), 0.0, atol=1e-12)
        assert way @ across > 0.0


def test_blocks_of_a_cluster_hold_its_leaf_area():
    vertices, faces = box([0.0, 0.0, 0.0], [2.0, 1.0, 1.0])
    inside = np.empty((kernels.MOST_SIDE + 1) ** 3, bool)
    room = kernels.make_room(vertices, faces, 3.0, 0.1, inside)
    assert (room.n_x, room.n_y, room.n_z) == (12, 6, 6)
    npt.assert_array_equal(room.cells, np.arange(12 * 6 * 6))
    npt.assert_allclose(room.space.sum(), 3.0)
    side = round((0.1 / 3.0 * 432) ** (1 / 3))  # a typical patch fills a block
    counted = np.bincount(room.block)
    assert counted.max() == side**3
    npt.assert_allclose(room.space, counted * 3.0 / 432)
    cells = np.empty(kernels.SAMPLES, np.int64)
    sample = np.random.default_rng(0).uniform(0.0, 0.1, (kernels.SAMPLES, 3))
    share = kernels.mark_filled(np.eye(3), 1.0, np.array([0.5, 0.5, 0.5]), sample, 0.05, room, cells)
    assert share == 1.0
    npt.assert_allclose((room.filled * room.space).sum(), 0.05)
    npt.assert_allclose(kernels.mark_filled(np.eye(3), 1.0, np.full(3, 5.0), sample, 0.05, room, cells), 0.0)


def test_places_are_the_emptiest_of_a_few():
    vertices, faces = box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
    room = kernels.make_room(vertices, faces, 1.0, 0.125, np.empty((kernels.MOST_SIDE + 1) ** 3, bool))
    room.filled[:] = 1.0
    room.filled[room.block[-1]] = 0.0  # the corner at (1, 1, 1) alone is empty
    state, place, hits = np.array([1], np.uint64), np.empty(3), 0
    for _ in range(200):
        kernels.empty_place(state, room, place)
        assert ((place >= 0.0) & (place <= 1.0)).all()
        hits += (place >= 0.5).all()
    assert hits > 150  # 1 - (7/8)^16 of 200 is 176


def test_the_middle_of_a_cluster():
    vertices, faces = box([0.0, 0.0, 0.0], [1.3, 1.3, 1.3])
    room = kernels.make_room(vertices, faces, 1.0, 0.125, np.empty((kernels.MOST_SIDE + 1) ** 3, bool))
    place = np.empty(3)
    kernels.middle_place(room, place)
    assert np.abs(place - 0.65).max() <= 0.5 * room.cell + 1e-12


def test_thick_seeds_have_a_fan():
    graph = TREE.graph
    docks = make_docks([PLAIN] * 20)
    seed, middle = np.array([2], np.int32), np.array([0.0, 0.0, 4.0])
    arrays = (graph.position, graph.parent, graph.radius, seed, middle)
    assert kernels.seed_docks(*arrays, 0.001, 0.05, docks) == 1
    npt.assert_allclose(docks.way[0], UP)
    n = kernels.seed_docks(*arrays, 0.001, 0.01, docks)
    assert n == kernels.MOST_DOCKS
    npt.assert_allclose(docks.way[1:n, 2], np.cos(kernels.FAN))
    npt.assert_allclose(docks.radius[:n], 0.01)
    assert kernels.seed_docks(*arrays, 0.01, 0.01, docks) == n
    gaps = np.linalg.norm(docks.way[1:n, None] - docks.way[None, 1:n], axis=2) + np.eye(n - 1)
    assert gaps.min() > 0.3
