"""Trees as scenes for the scanner: nodes, leaves, names, wind."""

import numpy as np
import numpy.testing as npt
import pytest

from recon.scan_paths import station_sweeps, stations_around
from recon.scan_scenes import LEAF, NONE, WOOD
from recon.scanning import Beam, scan_scene
from sapwood.quantities import parse_angle, parse_length
from sapwood.scanning import LEAF_AREA_DENSITY, Foliage, fill_with_leaves, node_sway, scene_of
from treegraph import (
    DEFAULT_ALLOMETRY,
    Cluster,
    ClusterTree,
    FormatError,
    InputError,
    TreeGraph,
    write_lobes,
    write_swc,
)

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def fork():
    """A trunk of four segments, two branches."""
    position = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3], [0, 0, 4], [1, 0, 3], [2, 0, 3.6], [0, -1.2, 2.9]]
    return TreeGraph([-1, 0, 1, 2, 3, 2, 5, 2], position, [0.15, 0.14, 0.12, 0.1, 0.06, 0.05, 0.03, 0.04])


def hull(low=(1.5, -0.5, 3.0), size=(1.0, 2.0, 1.5), seed=(6,)):
    return Cluster(np.array(low) + CORNERS * size, BOX_FACES, np.array(seed, np.int32), np.nan, 0)


def cluster_tree(*clusters):
    return ClusterTree(fork(), clusters or (hull(),), None, DEFAULT_ALLOMETRY, np.zeros(3), None)


def segment_gap(points, graph):
    """Distance of every point to the surface of every segment's frustum (ends open), (p, n); inf at roots."""
    out = np.full((len(points), graph.n_nodes), np.inf)
    for k, parent in enumerate(graph.parent):
        if parent >= 0:
            a, b = graph.position[parent], graph.position[k]
            t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            start = graph.radius[parent] if parent in (0, 1, 2, 3) and k in (1, 2, 3, 4) else graph.radius[k]
            radius = start + t * (graph.radius[k] - start)
            out[:, k] = np.abs(np.linalg.norm(points - a - t[:, None] * (b - a), axis=1) - radius)
    return out


def scan_of(tree, step=0.004, **beam):
    stations = stations_around(tree.scene.vertices, 3, distance=6.0)
    return scan_scene(tree.scene, station_sweeps(tree.scene.vertices, stations, step), Beam(**beam))


# ---------------------------------------------------------------- nodes


def test_node_of_a_straight_trunk_is_the_upper_end_of_its_segment():
    graph = TreeGraph([-1, 0, 1, 2, 3], [[0, 0, z] for z in range(5)], [0.2, 0.2, 0.2, 0.2, 0.2])
    scan = scan_of(scene_of(graph))
    side = np.hypot(scan.xyz[:, 0], scan.xyz[:, 1]) > 0.19
    clear = side & (np.abs(scan.xyz[:, 2] - np.round(scan.xyz[:, 2])) > 1e-3)
    assert clear.sum() > 3000
    npt.assert_array_equal(scan.node_id[clear], np.ceil(scan.xyz[clear, 2]))


def test_node_is_the_one_whose_tube_was_hit():
    tree = scene_of(fork())
    scan = scan_of(tree)
    gap = segment_gap(scan.xyz, tree.graph)
    own = gap[np.arange(len(scan)), scan.node_id]
    assert len(scan) > 3000 and set(scan.node_id) == set(range(1, 8))
    near_fork = np.linalg.norm(scan.xyz - tree.graph.position[2], axis=1) < 0.25
    assert (own[~near_fork] < 0.015).mean() > 0.97  # axes are rounded at corners
    best = gap.argmin(axis=1)
    clear = ~near_fork & (np.sort(gap, axis=1)[:, 1] > 0.05)
    assert clear.sum() > 2000
    assert (best[clear] == scan.node_id[clear]).mean() > 0.995
    assert (scan.tree_id == 1).all() and (scan.part == WOOD).all()


def test_unknown_radii_are_refused():
    with pytest.raises(InputError, match="radius must be known"):
        scene_of(fork().replace(radius=np.full(8, np.nan)))
    with pytest.raises(InputError, match="no wood to scan"):
        scene_of(TreeGraph([-1], [[0, 0, 0]], [0.1]))


# ---------------------------------------------------------------- leaves


def test_leaves_fill_the_hull_with_their_area_in_all_directions():
    foliage = Foliage(density=3.0, length=0.06)
    corner, owner = fill_with_leaves([hull(), hull(low=(5, 5, 5))], foliage, np.random.default_rng(1))
    assert np.bincount(owner).tolist() == [round(3.0 * 3.0 / foliage.leaf_area)] * 2
    across, along = corner[:, 3] - corner[:, 1], corner[:, 2] - corner[:, 0]
    normal = 0.5 * np.cross(across, along)
    area = np.linalg.norm(normal, axis=1)
    npt.assert_allclose(area.sum() / 6.0, 3.0, rtol=0.01)
    length = np.linalg.norm(along, axis=1)
    assert 0.048 - 1e-9 < length.min() < 0.0485 and 0.0715 < length.max() < 0.072 + 1e-9
    npt.assert_allclose(np.einsum("ij,ij->i", along, across), 0.0, atol=1e-9)
    direction = np.abs(normal / area[:, None])
    npt.assert_allclose(direction.mean(axis=0), 0.5, atol=0.015)  # a sphere's mean |cos|: 1/2
    npt.assert_allclose((direction**2).mean(axis=0), 1 / 3, atol=0.015)
    middle = (corner[owner == 0].mean(axis=1) - [1.5, -0.5, 3.0]) / [1.0, 2.0, 1.5]
    assert middle.min() > 0 and middle.max() < 1
    for k in range(3):
        npt.assert_allclose(np.histogram(middle[:, k], 5, (0, 1))[0] / len(middle), 0.2, atol=0.03)


def test_leaves_stay_inside_a_hull_that_fills_little_of_its_box():
    corners = np.array([[0, 0, 0], [4, 4, 4], [4.2, 4, 4], [4, 4.2, 4]], float)
    thin = Cluster(corners, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]), np.array([0]), np.nan, 0)
    corner, _ = fill_with_leaves([thin], Foliage(10.0, 0.02), np.random.default_rng(0))
    assert len(corner) == round(10.0 * 0.2 * 0.2 / 2 * 4 / 3 / Foliage(length=0.02).leaf_area)
    weight = np.linalg.solve(
        np.vstack([corners.T, np.ones(4)]), np.vstack([corner.mean(axis=1).T, np.ones(len(corner))])
    )
    assert weight.min() > -1e-5


def test_clusters_become_leaves_that_know_their_tree_and_node():
    tree = scene_of(cluster_tree(hull(seed=(5, 6))))
    leaf = tree.scene.part == LEAF
    assert leaf.sum() == 2 * round(3.0 * LEAF_AREA_DENSITY / Foliage().leaf_area)
    assert set(tree.scene.node_id[leaf]) == {5, 6} and set(tree.scene.tree_id) == {1}
    middle = tree.scene.vertices[tree.scene.faces[leaf]].mean(axis=1)
    nearest = np.linalg.norm(middle[:, None] - tree.graph.position[[5, 6]], axis=2).argmin(axis=1)
    assert (tree.scene.node_id[leaf] == np.array([5, 6])[nearest]).mean() > 0.97
    scan = scan_of(tree, 0.006)
    assert {WOOD, LEAF} == set(scan.part)
    inside = (scan.xyz > np.array([1.5, -0.5, 3.0]) - 0.05).all(1) & (
        scan.xyz < np.array([2.5, 1.5, 4.5]) + 0.05
    ).all(1)
    assert inside[scan.part == LEAF].all()


def test_leaf_off_has_no_leaf():
    for source in (cluster_tree(), fork()):
        tree = scene_of(source, leaf_off=True)
        assert set(tree.scene.part) == {WOOD}
        assert set(scan_of(tree, 0.01).part) == {WOOD}
    npt.assert_array_equal(
        scene_of(cluster_tree(), leaf_off=True).scene.vertices, scene_of(fork()).scene.vertices
    )


def test_the_inside_of_a_dense_cluster_is_hidden():
    """Points per volume fall from the shell to the middle, as in a real scan."""
    big = hull(low=(3, -1.5, 2), size=(3, 3, 3), seed=(6,))
    tree = scene_of(cluster_tree(big), foliage=Foliage(density=4.0))
    scan = scan_of(tree, 0.006)
    depth = np.abs(scan.xyz[scan.part == LEAF] - [4.5, 0, 3.5]).max(axis=1) / 1.5
    shell = ((depth > 0.8) & (depth < 1.0)).sum() / (1 - 0.8**3)
    core = (depth < 0.5).sum() / 0.5**3
    assert core < 0.35 * shell


def test_leaves_follow_the_seed():
    first, again, other = (scene_of(cluster_tree(), seed=s).scene for s in (1, 1, 2))
    assert first.vertices.tobytes() == again.vertices.tobytes() != other.vertices.tobytes()


def test_sway_grows_along_every_way_and_with_thinness():
    graph = fork()
    sway = node_sway(graph)
    assert sway[0] == 0.0 and sway.max() < 1.0
    assert (sway[1:] > sway[graph.parent[1:]]).all()
    assert (node_sway(graph.replace(radius=graph.radius / 2))[1:] > sway[1:]).all()
    tree = scene_of(cluster_tree())
    height = tree.scene.vertices[:, 2]
    assert tree.scene.sway[height < 0.1].max() < 0.05 < tree.scene.sway[height > 3.9].min()


# ---------------------------------------------------------------- files


def test_lobes_and_swc_are_read(tmp_path):
    write_lobes(cluster_tree(), tmp_path / "t.lobes")
    write_swc(fork(), tmp_path / "t.swc")
    lobes, swc = scene_of(tmp_path / "t.lobes"), scene_of(tmp_path / "t.swc")
    assert set(lobes.scene.part) == {WOOD, LEAF} and set(swc.scene.part) == {WOOD}
    assert set(swc.scene.node_id) == set(range(1, 8))
    npt.assert_allclose(swc.foot, 0.0, atol=0.01)


def test_meshes_are_told_by_their_names(tmp_path):
    import render
    from render.parts import LEAF as GREEN
    from render.parts import WOOD as BARK

    crown = render.hull_mesh([hull()])
    parts = [
        render.Part("wood", render.branch_mesh(fork()), BARK),
        render.Part("leaves", crown, GREEN),
        render.Part("wood_2", render.branch_mesh(fork()), BARK),
    ]
    render.write_glb(tmp_path / "t.glb", parts)
    tree = scene_of(tmp_path / "t.glb")
    leaf = tree.scene.part == LEAF
    assert leaf.sum() == len(crown.faces) and tree.notes == ()
    assert set(tree.scene.tree_id[leaf]) == {1} and set(tree.scene.tree_id) == {1, 3}
    assert set(tree.scene.node_id) == {NONE}
    assert set(scene_of(tmp_path / "t.glb", leaf_off=True).scene.part) == {WOOD}
    (note,) = scene_of(_decoded(tmp_path, render)).notes
    assert "closed hulls; scan the .lobes file" in note


def _decoded(tmp_path, render):
    render.write_glb(tmp_path / "d.glb", render.tree_parts(cluster_tree()))
    return tmp_path / "d.glb"


OBJ = "v 0 0 0\nv 1 0 0\nv 0 0 1\nv 0 1 1\nusemtl {}\nf 1 2 3\nusemtl {}\nf 2 3 4\n"


@pytest.mark.parametrize(
    "first, second, options, kinds",
    [
        ("bark", "Leaves", {}, [WOOD, LEAF]),
        ("Tree_Trunk", "oak_foliage.001", {}, [WOOD, LEAF]),
        ("mat1", "mat2", {}, [WOOD, WOOD]),
        ("mat1", "mat2", {"leaf_names": ["MAT2"]}, [WOOD, LEAF]),
        ("leafy bark", "bark", {"wood_names": ["leafy"]}, [WOOD, WOOD]),
        ("wood", "leaves", {"leaf_names": ["wood"], "wood_names": ["leaves"]}, [LEAF, WOOD]),
    ],
)
def test_which_material_is_what(tmp_path, first, second, options, kinds):
    path = tmp_path / "t.obj"
    path.write_text(OBJ.format(first, second))
    tree = scene_of(path, **options)
    assert tree.scene.part.tolist() == kinds
    said = " ".join(tree.notes)
    assert ("mat1" in said) == (first == "mat1")


def test_what_is_refused(tmp_path):
    path = tmp_path / "t.obj"
    path.write_text(OBJ.format("leaf", "leaf"))
    with pytest.raises(InputError, match=r"t.obj: without its leaves nothing is left to scan"):
        scene_of(path, leaf_off=True)
    for name in ("t.laz", "t"):
        with pytest.raises(InputError, match=r"what is to be scanned must end in one of .lobes .swc .glb"):
            scene_of(tmp_path / name)
    for name in ("no.lobes", "no.swc", "no.glb"):
        with pytest.raises(InputError, match=f"{name}: there is no such file"):
            scene_of(tmp_path / name)
    bad = tmp_path / "bad.swc"
    bad.write_text("1 0 0 0\n")
    with pytest.raises(FormatError, match=r"bad.swc.* line 1: a row must have 7 columns"):
        scene_of(bad)
    with pytest.raises(InputError, match="leaf density must be"):
        Foliage(density=-1)
    with pytest.raises(InputError, match="leaf length must be"):
        Foliage(length=0)
    with pytest.raises(InputError, match="leaves, more than 8000000; make the leaves longer"):
        scene_of(cluster_tree(), foliage=Foliage(1e6, 0.01))


@pytest.mark.parametrize(
    "text, metres",
    [("2mm", 0.002), ("1.5 cm", 0.015), ("3", 3.0), ("-2m", -2.0), ("1e-3 KM", 1.0), (".5", 0.5)],
)
def test_lengths(text, metres):
    npt.assert_allclose(parse_length(text), metres)


@pytest.mark.parametrize(
    "text, radians",
    [("0.04deg", 0.000698131700797732), ("0.3mrad", 3e-4), ("180", np.pi), ("1rad", 1.0), ("90°", np.pi / 2)],
)
def test_angles(text, radians):
    npt.assert_allclose(parse_angle(text), radians)


@pytest.mark.parametrize("text", ["", "mm", "2 furlongs", "1,5m", "nan", "1e999", "2mmm", "--2"])
def test_bad_quantities(text):
    with pytest.raises(
        InputError, match="--step must be a number with its unit, as in 0.04deg or 0.3mrad, got"
    ):
        parse_angle(text, "--step")
    with pytest.raises(InputError, match="a length must be a number with its unit"):
        parse_length(text)
