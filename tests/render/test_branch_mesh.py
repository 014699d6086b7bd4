"""The branch mesh: exact solids, slow references, closed surfaces, stated deviations, messages."""

import time
from collections import Counter

import numba
import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from render import DETAIL, MeshSettings, _mesh_kernels, branch_mesh, mesh_volume
from tests.corpus import TREES, along, make_tree, random_rotation, realistic_tree, rooted_parents
from treegraph import InputError, TreeError, TreeGraph, chains

LONG = {
    name: tree
    for name, tree in TREES.items()
    if (tree.parent >= 0).any()
    and not np.isnan(tree.radius).any()
    and np.ptp(tree.position, axis=0).max() > 0
    and tree.n_nodes < 5000
}
PLAIN = MeshSettings(tolerance=np.inf, tolerance_radii=np.inf)


def pieces(mesh):
    """Vertices and faces of each closed surface, equal vertices merged."""
    for a, b in zip(mesh.piece_start[:-1], mesh.piece_start[1:], strict=True):
        used, faces = np.unique(mesh.faces[a:b], return_inverse=True)
        place, merged = np.unique(mesh.vertices[used], axis=0, return_inverse=True)
        yield place, merged.ravel()[faces].reshape(-1, 3)


def volume(vertices, faces):
    corner = (vertices - vertices[0])[faces]
    return np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0


def edges(faces):
    return Counter(
        (int(f[i]), int(f[(i + 1) % 3])) for f in faces for i in range(3) if f[i] != f[(i + 1) % 3]
    )


def solid_angle_share(point, vertices, faces):
    """Winding number of a closed surface around a point: 1 inside, 0 outside."""
    a, b, c = (vertices[faces] - point).transpose(1, 0, 2)
    na, nb, nc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    top = np.einsum("ij,ij->i", a, np.cross(b, c))
    bottom = na * nb * nc + (a * b).sum(1) * nc + (b * c).sum(1) * na + (c * a).sum(1) * nb
    return 2.0 * np.arctan2(top, bottom).sum() / (4.0 * np.pi)


def ring_centres(mesh, sides):
    """Middle of each ring of a mesh of one tube."""
    n_rings = (len(mesh.vertices) - 2 * sides) // (sides + 1)
    rings = mesh.vertices[: n_rings * (sides + 1)].reshape(n_rings, sides + 1, 3)
    return rings[:, :sides].mean(axis=1)


# Exact solids


@pytest.mark.parametrize("sides", [3, 4, 5, 8, 16, 100])
def test_volume_of_a_cylinder_is_exact_for_any_number_of_sides(sides):
    trunk = along([(1, 2, 3), (1, 2, 4), (1, 2, 6.5)], 0.2)
    npt.assert_allclose(mesh_volume(branch_mesh(trunk, sides=sides)), np.pi * 0.2**2 * 3.5, rtol=1e-12)


def test_surface_of_a_cylinder_converges_with_the_sides():
    trunk = along([(0, 0, 0), (0, 0, 2)], 0.2)
    error = []
    for sides in (8, 16, 32, 64):
        mesh = branch_mesh(trunk, sides=sides)
        reach = np.linalg.norm(mesh.vertices[:, :2], axis=1)
        error.append(reach.max() - 0.2)
    ratio = np.array(error[:-1]) / np.array(error[1:])
    npt.assert_allclose(ratio, 4.0, rtol=0.1)  # second order


@pytest.mark.parametrize("end", [0.3, 0.1, 0.02])
def test_volume_of_a_frustum(end):
    trunk = along([(0, 0, 0), (0, 3, 4)], [0.3, end])
    expected = np.pi / 3 * 5 * (0.09 + 0.3 * end + end**2)
    npt.assert_allclose(mesh_volume(branch_mesh(trunk)), expected, rtol=1e-12)


def test_volume_of_a_torus_sector_converges_to_pappus():
    """Pappus: cross-section times the way of its middle. The spline through dense nodes is the circle."""
    turn = np.linspace(0, np.pi, 400)
    arc = along(np.column_stack([np.cos(turn), np.zeros(400), np.sin(turn)]), 0.1)
    npt.assert_allclose(mesh_volume(branch_mesh(arc, sides=24)), np.pi * 0.01 * np.pi, rtol=2e-4)


def test_a_thin_tip_has_the_least_radius():
    cone = along([(0, 0, 0), (0, 0, 1)], [0.1, 0.0])
    mesh = branch_mesh(cone, MeshSettings(min_radius=0.01))
    top = mesh.vertices[mesh.vertices[:, 2] == 1.0]
    area = 0.5 * 16 * np.sin(2 * np.pi / 16) * (np.linalg.norm(top[:, :2], axis=1) ** 2).mean()
    npt.assert_allclose(area, np.pi * 0.01**2, rtol=1e-12)


# Closed surfaces


@pytest.mark.parametrize("name", LONG)
@pytest.mark.parametrize("detail", DETAIL)
def test_every_tube_is_closed_and_encloses_a_positive_volume(name, detail):
    mesh = branch_mesh(LONG[name], DETAIL[detail])
    assert np.isfinite(mesh.vertices).all()
    npt.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
    assert mesh.piece_start[0] == 0 and mesh.piece_start[-1] == len(mesh.faces)
    assert mesh.faces.min() == 0 and mesh.faces.max() == len(mesh.vertices) - 1
    for vertices, faces in pieces(mesh):
        count = edges(faces)
        assert all(n == count[b, a] for (a, b), n in count.items())
        assert volume(vertices, faces) > 0


@pytest.mark.parametrize("name", ["two nodes", "chain", "straight chain", "even fork", "comb", "bush"])
def test_every_tube_is_a_sphere_in_topology(name):
    """Every edge has one face on either side, and V - E + F = 2: one surface, no hole, no handle."""
    for vertices, faces in pieces(branch_mesh(LONG[name])):
        count = edges(faces)
        assert set(count.values()) == {1}
        assert len(vertices) - len(count) // 2 + len(faces) == 2


def test_faces_and_normals_point_away_from_the_axis():
    graph = TREES["chain"].replace(radius=np.full(20, 0.02))
    mesh = branch_mesh(graph)
    corner = mesh.vertices[mesh.faces]
    flat = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (np.einsum("ij,ij->i", flat, mesh.normals[mesh.faces].sum(axis=1)) > 0).all()
    axis = cKDTree(ring_centres(branch_mesh(graph, steps=64, sides=16), 16))
    _, near = axis.query(mesh.vertices)
    side = mesh.vertices - axis.data[near]
    assert (np.einsum("ij,ij->i", side, mesh.normals) > -1e-9).all()


def test_normals_of_a_cone_are_at_right_angles_to_it():
    mesh = branch_mesh(along([(0, 0, 0), (0, 0, 1)], [0.5, 0.25]), sides=32)
    side = mesh.normals[: 2 * 33]
    npt.assert_allclose(side[:, 2], np.sin(np.arctan(0.25)), atol=1e-6)


@given(rooted_parents(30), st.integers(0, 10**6))
@settings(deadline=None, max_examples=40)
def test_random_trees_give_closed_tubes(parent, seed):
    tree = make_tree(parent, seed)
    mesh = branch_mesh(tree, sides=6)
    n_tubes = chains(tree)[0].size - 1 if tree.n_nodes > 1 else 0
    assert len(mesh.piece_start) - 1 == n_tubes
    for vertices, faces in pieces(mesh):
        count = edges(faces)
        assert all(n == count[b, a] for (a, b), n in count.items())
        assert volume(vertices, faces) > 0


# The axis: Eq. (6.7), ends, deviation


def reference_spline(points, steps):
    """The matrix form of Eq. (6.7), span by span, with mirrored points at the ends."""
    points = np.array([2 * points[0] - points[1], *points, 2 * points[-1] - points[-2]])
    matrix = np.array([[-1, 3, -3, 1], [3, -6, 3, 0], [-3, 0, 3, 0], [1, 4, 1, 0]]) / 6
    out = []
    for i in range(len(points) - 3):
        for k in range(steps):
            t = k / steps
            out.append(np.array([t**3, t**2, t, 1]) @ matrix @ points[i : i + 4])
    return np.array([*out, points[-2]])


def test_axis_is_the_spline_of_equation_6_7():
    tree = TREES["chain"].replace(radius=np.full(20, 0.1))
    mesh = branch_mesh(
        tree, MeshSettings(sides=8, tolerance=np.inf, tolerance_radii=np.inf, steps=5, max_turn=1e-9)
    )
    npt.assert_allclose(ring_centres(mesh, 8), reference_spline(tree.position, 5), atol=1e-12)


def test_roots_and_tips_keep_their_place():
    tree = TREES["chain"].replace(radius=np.full(20, 0.1))
    axis = ring_centres(branch_mesh(tree, PLAIN, sides=16), 16)
    npt.assert_allclose(axis[[0, -1]], tree.position[[0, -1]], atol=1e-12)


def distance_to_polyline(points, line):
    a, b = line[:-1], line[1:]
    along_ = ((points[:, None] - a) * (b - a)).sum(2) / np.maximum(((b - a) ** 2).sum(1), 1e-300)
    foot = a + along_.clip(0, 1)[..., None] * (b - a)
    return np.linalg.norm(points[:, None] - foot, axis=2).min(1)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.002, 0.01, 0.05, 0.3]), st.integers(3, 15))
@settings(deadline=None, max_examples=80)
def test_axis_stays_within_the_tolerance(seed, tolerance, n):
    """Both ways: the axis from the graph, and the graph's nodes from the axis. Corners of every kind."""
    rng = np.random.default_rng(seed)
    step = rng.normal(size=(n, 3)) * rng.lognormal(-1, 1.5, (n, 1))
    tree = along(np.cumsum(step, axis=0), 0.1)
    chosen = MeshSettings(sides=4, steps=64, max_turn=1e-3, tolerance=tolerance, tolerance_radii=np.inf)
    axis = ring_centres(branch_mesh(tree, chosen), 4)
    assert distance_to_polyline(axis, tree.position).max() <= tolerance + 1e-9
    assert distance_to_polyline(tree.position, axis).max() <= 1.05 * tolerance + 1e-9


def test_tolerance_in_radii_keeps_the_graph_inside_the_wood():
    zigzag = along([(0, 0, 0), (0.3, 0, 0.3), (0, 0, 0.6), (0.3, 0, 0.9), (0, 0, 1.2)], 0.01)
    loose = ring_centres(branch_mesh(zigzag, MeshSettings(sides=16, tolerance=np.inf, steps=64)), 16)
    plain = ring_centres(branch_mesh(zigzag, PLAIN, sides=16, steps=64), 16)
    assert distance_to_polyline(zigzag.position, loose).max() <= 0.0101
    assert distance_to_polyline(zigzag.position, plain).max() > 0.05


def test_radius_stays_between_its_neighbours():
    tree = along([(0, 0, k) for k in range(5)], [0.3, 0.1, 0.4, 0.05, 0.2])
    mesh = branch_mesh(tree, MeshSettings(sides=16, steps=16, max_turn=1e-9))
    reach = np.linalg.norm(mesh.vertices[:, :2], axis=1) / np.sqrt((2 * np.pi / 16) / np.sin(2 * np.pi / 16))
    for k in range(4):
        inside = reach[(mesh.vertices[:, 2] >= k) & (mesh.vertices[:, 2] <= k + 1)]
        near = tree.radius[max(k - 1, 0) : k + 3]
        assert near.min() - 1e-12 <= inside.min() and inside.max() <= near.max() + 1e-12


# Frames: Algorithm 1


def reference_transport(tangents, first):
    """Algorithm 1 line by line, with the rotation matrix of Eq. (6.5)."""
    out = [first]
    for t, u in zip(tangents[:-1], tangents[1:], strict=True):
        b = np.cross(t, u)
        if np.linalg.norm(b) == 0:
            out.append(out[-1])
            continue
        n = b / np.linalg.norm(b)
        theta = np.arccos(np.clip(t @ u, -1, 1))
        c, s = np.cos(theta), np.sin(theta)
        cross = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
        out.append((c * np.eye(3) + (1 - c) * np.outer(n, n) + s * cross) @ out[-1])
    return np.array(out)


def curve(n=200):
    t = np.linspace(0, 4 * np.pi, n)
    points = np.column_stack([np.cos(t), np.sin(2 * t), 0.3 * t])
    step = np.diff(points, axis=0)
    return step / np.linalg.norm(step, axis=1, keepdims=True)


def transport(tangents):
    normal = np.empty_like(tangents)
    _mesh_kernels.any_normal(tangents[0], normal[0])
    _mesh_kernels.parallel_transport(tangents, normal)
    return normal


def test_frames_match_algorithm_1():
    tangents = curve()
    normal = transport(tangents)
    npt.assert_allclose(normal, reference_transport(tangents, normal[0]), atol=1e-9)
    npt.assert_allclose(np.einsum("ij,ij->i", normal, tangents), 0.0, atol=1e-14)
    npt.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)


def test_frames_do_not_turn_about_the_axis():
    """The change of the normal has no part across the tangent beyond that of the bend, to second order."""
    tangents = curve(2000)
    normal = transport(tangents)
    middle = tangents[:-1] + tangents[1:]
    twist = np.einsum("ij,ij->i", np.cross(normal[:-1], normal[1:]), middle / 2)
    bend = np.linalg.norm(np.diff(tangents, axis=0), axis=1)
    assert np.abs(twist).max() < bend.max() ** 2 and np.abs(twist).sum() < 0.02


@pytest.mark.parametrize("tangents", [[(0, 0, 1.0)] * 3, [(0, 0, 1.0), (0, 0, -1.0), (0, 0, 1.0)]])
def test_frames_survive_straight_pieces_and_full_turns(tangents):
    normal = transport(np.array(tangents))
    npt.assert_array_equal(normal, np.tile(normal[0], (3, 1)))


def test_quads_of_a_bent_tube_are_not_twisted():
    """Along a plane curve the seam stays where it was: the rings' first corners keep their height."""
    turn = np.linspace(0, 1.5 * np.pi, 40)
    tree = along(np.column_stack([np.cos(turn), np.sin(turn), np.zeros(40)]), 0.05)
    mesh = branch_mesh(tree, sides=8)
    n_rings = (len(mesh.vertices) - 16) // 9
    seam = mesh.vertices[: 9 * n_rings].reshape(n_rings, 9, 3)[:, 0]
    height = seam[:, 2]
    npt.assert_allclose(height, height[0], atol=1e-12)


# Where branches part


def side_starts(tree):
    start, node = chains(tree)
    owner = np.full(tree.n_nodes, -1)
    for c in range(len(start) - 1):
        for k in node[start[c] : start[c + 1]]:
            if owner[k] < 0:
                owner[k] = c
    return [(c, owner[node[start[c]]]) for c in range(len(start) - 1) if owner[node[start[c]]] != c]


@pytest.mark.parametrize(
    "tree, share",
    [
        (TREES["even fork"], 1.0),
        (TREES["comb"], 1.0),
        (realistic_tree(step=0.1, height=6.0), 1.0),
        (TREES["bush"], 0.85),  # segments as short as they are thick, at random: corners show at sharp bends
    ],
    ids=["even fork", "comb", "realistic", "bush"],
)
@pytest.mark.parametrize("detail", DETAIL)
def test_a_branch_starts_inside_its_parent(tree, share, detail):
    """Its first ring lies in the parent's tube, so there is neither a gap nor a bulge."""
    mesh = branch_mesh(tree, DETAIL[detail])
    surface = list(pieces(mesh))
    inside = total = 0
    for child, parent in side_starts(tree)[:60]:
        first = mesh.faces[mesh.piece_start[child]]  # a side face of the first two rings
        sides = np.flatnonzero(mesh.uv[first[0] :, 0] == 1.0)[0]
        ring = mesh.vertices[first[0] : first[0] + sides]
        total += len(ring)
        inside += sum(solid_angle_share(point, *surface[parent]) > 0.5 for point in ring)
    if detail == "coarse":  # leaves rings out, by up to 0.3 radii
        share -= 0.1
    assert inside >= share * total


def test_a_branch_is_not_as_wide_as_its_trunk():
    tree = TREES["comb"]
    mesh = branch_mesh(tree)
    place, _ = list(pieces(mesh))[1]
    twig_axis = along(tree.position[[1, 2]], 0.01)
    assert distance_to_polyline(place, twig_axis.position).max() < 0.013  # a square of that area: 1.25 r


def test_a_branch_starts_on_the_smoothed_axis_of_its_parent():
    bent = TreeGraph([-1, 0, 1, 1], [(0, 0, 0), (0, 0, 1), (1, 0, 1.5), (0, 2, 1.2)], [0.1, 0.1, 0.1, 0.02])
    mesh = branch_mesh(bent, MeshSettings(sides=16, tolerance=0.05, tolerance_radii=np.inf, steps=64))
    trunk, twig = (place for place, _ in pieces(mesh))
    corners = twig[np.argsort(np.linalg.norm(twig - bent.position[1], axis=1))[:5]]
    assert distance_to_polyline(corners, bent.position[:3]).max() < 0.05 + 0.03
    assert np.linalg.norm(corners.mean(axis=0) - bent.position[1]) > 0.03


# Attributes, levels of detail, invariants


def test_texture_runs_around_and_along():
    mesh = branch_mesh(along([(0, 0, 0), (0, 3, 4)], 0.1), sides=12)
    ring = slice(0, 13)
    npt.assert_allclose(mesh.uv[ring, 0], np.arange(13) / 12, atol=1e-6)
    npt.assert_array_equal(mesh.vertices[0], mesh.vertices[12])  # the seam, to the bit
    npt.assert_allclose([mesh.uv[ring, 1].max(), mesh.uv[13:26, 1].min()], [0.0, 5.0], atol=1e-6)


def test_node_of_a_vertex_owns_the_segment_it_lies_on():
    tree = TREES["comb"]
    mesh = branch_mesh(tree)
    a = tree.position[tree.parent[mesh.node]]
    b = tree.position[mesh.node]
    along_ = (((mesh.vertices - a) * (b - a)).sum(1) / ((b - a) ** 2).sum(1)).clip(0, 1)[:, None]
    assert (tree.parent[mesh.node] >= 0).all()
    assert np.linalg.norm(mesh.vertices - (a + along_ * (b - a)), axis=1).max() < 0.25
    assert set(mesh.node) == set(range(1, tree.n_nodes))


def test_thin_branches_get_fewer_sides():
    mesh = branch_mesh(TREES["comb"], sides=24)
    rings = [np.flatnonzero(mesh.uv[mesh.faces[a, 0] :, 0] == 1.0)[0] for a in mesh.piece_start[:-1]]
    assert rings[0] == 24
    assert set(rings[1:]) == {5}  # a twentieth of the trunk's radius: 24 / sqrt(20)


def test_levels_of_detail_differ_in_size_and_not_in_volume():
    tree = realistic_tree(step=0.05, height=8.0)
    fine, normal, coarse = (branch_mesh(tree, DETAIL[name]) for name in ("fine", "normal", "coarse"))
    assert len(fine.faces) > 1.5 * len(normal.faces) and len(normal.faces) > 2 * len(coarse.faces)
    npt.assert_allclose(mesh_volume(fine), mesh_volume(normal), rtol=0.002)
    npt.assert_allclose(mesh_volume(coarse), mesh_volume(normal), rtol=0.03)


@pytest.mark.parametrize("error", [0.05, 0.3])
def test_rings_are_left_out_within_the_stated_error(error):
    tree = TREES["chain"].replace(radius=np.linspace(0.1, 0.02, 20))
    full = ring_centres(branch_mesh(tree, MeshSettings(sides=8)), 8)
    short = ring_centres(branch_mesh(tree, MeshSettings(sides=8, ring_error=error)), 8)
    assert len(short) < 0.8 * len(full)
    npt.assert_allclose(short[[0, -1]], full[[0, -1]], atol=1e-12)
    assert distance_to_polyline(full, short).max() <= error * 0.1


def test_straight_spans_get_one_ring():
    trunk = along([(0, 0, 0), (0, 0, 1), (0, 0, 2)])
    assert len(branch_mesh(trunk, steps=32, sides=8).vertices) == 3 * 9 + 16
    assert len(branch_mesh(trunk, MeshSettings(sides=8, ring_error=1e-6)).vertices) == 2 * 9 + 16


@pytest.mark.parametrize("name", ["chain", "comb", "bush"])
def test_mesh_moves_and_grows_with_the_tree(name):
    tree = TREES[name]
    rotation = random_rotation(np.random.default_rng(3))
    base = branch_mesh(tree)
    moved = branch_mesh(tree.replace(position=tree.position @ rotation.T + (5, -3, 2)))
    assert len(moved.faces) == len(base.faces)
    for (v, f), (w, _), (a, b) in zip(
        pieces(base),
        pieces(moved),
        zip(base.piece_start[:-1], base.piece_start[1:], strict=True),
        strict=True,
    ):
        npt.assert_allclose(volume(w, _), volume(v, f), rtol=1e-8)
        middle = base.vertices[np.unique(base.faces[a:b])].mean(axis=0) @ rotation.T + (5, -3, 2)
        thick = tree.radius.max()
        assert np.linalg.norm(moved.vertices[np.unique(moved.faces[a:b])].mean(axis=0) - middle) < 0.2 * thick
    scaled = branch_mesh(
        tree.replace(position=2 * tree.position, radius=2 * tree.radius),
        MeshSettings(tolerance=0.02, min_radius=0.001),
    )
    npt.assert_allclose(scaled.vertices, 2 * base.vertices, rtol=1e-9, atol=1e-12)


def test_same_tree_same_bytes():
    a, b = branch_mesh(TREES["bush"]), branch_mesh(TREES["bush"])
    for name in ("vertices", "faces", "normals", "uv", "node", "piece_start"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()


@pytest.mark.parametrize("name", ["one node", "only roots", "all in one place"])
def test_no_length_no_mesh(name):
    mesh = branch_mesh(TREES[name])
    assert len(mesh.vertices) == len(mesh.faces) == 0 and mesh.piece_start.tolist() == [0]
    assert mesh_volume(mesh) == 0.0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="times of loops that are not compiled say nothing")
def test_four_thousand_nodes_take_milliseconds():
    tree = realistic_tree(height=9.0, step=0.025)
    tree = TreeGraph(tree.parent[:4000], tree.position[:4000], tree.radius[:4000])
    branch_mesh(tree)
    begin = time.process_time()
    branch_mesh(tree)
    assert time.process_time() - begin < 0.2  # 0.01 s on a quiet machine


# Messages


def test_unknown_radius_is_named():
    with pytest.raises(
        TreeError, match=r"radius must be known .* radius\[0\] is NaN; 20 of 60 nodes .* allometric_radii"
    ):
        branch_mesh(TREES["some radii unknown"])


@pytest.mark.parametrize(
    "changes, match",
    [
        ({"sides": 2}, "sides must be 3 to 256, got 2"),
        ({"sides": 4, "min_sides": 5}, r"min_sides must be 3 to sides \(4\), got 5"),
        ({"steps": 0}, "steps must be 1 to 64, got 0"),
        ({"max_turn": 0.0}, "max_turn must be an angle > 0 radians, got 0.0"),
        ({"tolerance": -1.0}, "tolerance must be a distance >= 0 metres, got -1.0"),
        ({"tolerance_radii": np.nan}, "tolerance_radii must be a number >= 0, got nan"),
        ({"min_radius": 0.0}, "min_radius must be a finite length > 0 metres, got 0.0"),
    ],
)
def test_settings_out_of_range_are_named(changes, match):
    with pytest.raises(InputError, match=match):
        MeshSettings(**changes)


def test_few_sides_may_be_asked_for_without_more():
    assert len(branch_mesh(TREES["two nodes"], sides=3).faces) == 2 * 3 + 2
