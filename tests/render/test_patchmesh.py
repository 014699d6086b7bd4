"""Patches as meshes, and their levels of detail."""

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from render import BladeSettings, blade_mesh, branch_mesh, lod_leaves, mesh_volume, patch_mesh, thickest_edges
from render.patchmesh import TWIGS, patch_meshes
from species.foliage import LeafSet
from species.patches import Patch
from tests.corpus import TREES, realistic_tree
from tests.render.leafy import twig
from treegraph import NO_PARENT, InputError, TreeError, TreeGraph

ONE = LeafSet(
    np.array([[1.0, 2.0, 3.0]]),
    np.array([[0.0, 1.0, 0.0]]),
    np.array([[0.0, 0.0, 1.0]]),
    np.array([0.2]),
    np.array([0.1]),
    np.array([7], np.int32),
)
NONE = LeafSet(*(a[:0] for a in (ONE.base, ONE.along, ONE.normal, ONE.length, ONE.width, ONE.node)))


def face_areas(mesh):
    corner = mesh.vertices[mesh.faces]
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2


# Blades


def test_a_flat_blade_is_one_quad_that_lies_as_its_image_does():
    """Seen from above with the tip ahead: u from left to right, v from base to tip, faces towards the eye."""
    mesh = blade_mesh(ONE)
    npt.assert_allclose(
        mesh.vertices, [[0.95, 2, 3], [1.05, 2, 3], [0.95, 2.2, 3], [1.05, 2.2, 3]], atol=1e-12
    )
    npt.assert_array_equal(mesh.uv, [[0, 0], [1, 0], [0, 1], [1, 1]])
    npt.assert_allclose(face_areas(mesh), np.tile([0, 0, 0.01], (2, 1)), atol=1e-12)
    npt.assert_array_equal(mesh.normals, np.tile([0, 0, 1], (4, 1)))
    npt.assert_array_equal(mesh.node, [7] * 4)


@pytest.mark.parametrize("fold", [0.0, 0.5])
@pytest.mark.parametrize("along, bend", [(1, 0.0), (2, 0.8), (5, -1.5), (8, 3.0)])
def test_bent_and_folded_blades_keep_their_area(along, bend, fold):
    blade = BladeSettings(2, along, fold, bend)
    leaves = twig(1, 40).leaves
    mesh = blade_mesh(leaves, blade)
    per_leaf = 4 * along
    area = np.linalg.norm(face_areas(mesh), axis=1).reshape(40, per_leaf).sum(axis=1)
    box = leaves.length * leaves.width
    share = leaves.width / leaves.length
    npt.assert_allclose(area, box * blade.area(share), rtol=1e-9)
    if fold == 0.0 or bend == 0.0:
        npt.assert_allclose(area, box, rtol=1e-9)
    else:  # the sides run on a larger circle
        npt.assert_allclose(area, box * (1.0 + bend * np.sin(fold) * share / 4), rtol=0.02)
    npt.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)
    facing = np.einsum("ij,ij->i", face_areas(mesh), mesh.normals[mesh.faces].mean(axis=1))
    assert (facing > 0).all()


def test_a_bent_blade_points_down_at_its_tip_and_a_folded_one_rises_at_its_sides():
    bent = blade_mesh(ONE, BladeSettings(1, 8, 0.0, np.pi / 2)).vertices.reshape(9, 2, 3).mean(axis=1)
    radius = 0.2 / (np.pi / 2)
    npt.assert_allclose(bent[-1] - ONE.base[0], [0, radius, -radius], rtol=0.01, atol=1e-12)
    folded = blade_mesh(ONE, BladeSettings(2, 1, 0.3)).vertices.reshape(2, 3, 3) - ONE.base[0]
    npt.assert_allclose(folded[:, 1, [0, 2]], 0, atol=1e-12)  # the midrib
    npt.assert_allclose(folded[:, 0], folded[:, 2] * [-1, 1, 1], atol=1e-12)
    npt.assert_allclose(folded[0, 2], [0.05 * np.cos(0.3), 0, 0.05 * np.sin(0.3)], atol=1e-12)


@pytest.mark.parametrize("across, along", [(1, 1), (2, 1), (2, 3)])
def test_the_image_reaches_as_far_as_its_box_says(across, along):
    """A lopsided leaf: the midrib is at a quarter of the image's width, and is where the blade folds."""
    blade = BladeSettings(across, along, box=(-0.2, -0.1, 0.6, 1.1))
    mesh = blade_mesh(ONE, blade)
    local = mesh.vertices - ONE.base[0]
    npt.assert_allclose(local.min(axis=0), [-0.02, -0.02, 0], atol=1e-12)
    npt.assert_allclose(local.max(axis=0), [0.06, 0.22, 0], atol=1e-12)
    npt.assert_allclose(local[:, 0], -0.02 + 0.08 * mesh.uv[:, 0], atol=1e-8)
    npt.assert_allclose(local[:, 1], -0.02 + 0.24 * mesh.uv[:, 1], atol=1e-8)
    if across == 2:
        npt.assert_allclose(mesh.uv[1], [0.25, 0.0])
    patch = twig(1, 20)
    area = np.linalg.norm(face_areas(patch_mesh(patch, 0.3, blade=blade).leaves), axis=1).sum()
    npt.assert_allclose(area, patch_mesh(patch, blade=blade).blade_area)
    npt.assert_allclose(area, 0.8 * 1.2 * (patch.leaves.length * patch.leaves.width).sum())


@pytest.mark.parametrize(
    "arguments, match",
    [
        ({"across": 3}, "across must be 1 to 2, got 3"),
        ({"along": 0}, "along must be 1 to 8, got 0"),
        ({"fold": 0.2}, "fold must be 0 unless across is 2, got 0.2"),
        ({"across": 2, "fold": 2.0}, "fold must be an angle of 0 to 1.5 radians, got 2.0"),
        ({"bend": 0.2}, "bend must be 0 unless along is 2 or more, got 0.2"),
        (
            {"box": (0.0, 0.0, 0.5, 1.0)},
            r"box must have the midrib between left and right, and a height, got",
        ),
        ({"box": (-0.5, 1.0, 0.5, 1.0)}, "box must have the midrib between"),
        ({"box": (-0.5, 0.0, 0.5)}, "box must have the midrib between"),
        ({"along": 3, "bend": np.nan}, "bend must be an angle of -3 to 3 radians, got nan"),
    ],
)
def test_blade_settings_out_of_range(arguments, match):
    with pytest.raises(InputError, match=match):
        BladeSettings(**arguments)


# Leaves at a level


@given(st.integers(1, 400), st.floats(0.001, 1.0))
def test_equal_leaves_keep_their_area(n, share):
    count, scale = lod_leaves(n, share)
    assert 1 <= count <= n and share * n - 1e-9 <= count < share * n + 1
    npt.assert_allclose(count * scale**2, n)


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.floats(0.001, 1.0))
def test_leaves_of_any_size_keep_their_area(seed, n, share):
    area = np.random.default_rng(seed).lognormal(0, 1, n)
    count, scale = lod_leaves(area, share)
    npt.assert_allclose(area[:count].sum() * scale**2, area.sum())
    assert lod_leaves(area, 1.0) == (n, 1.0)


def test_no_leaves_stay_none():
    assert lod_leaves(0, 0.5) == (0, 1.0)
    assert lod_leaves(np.empty(0), 0.5) == (0, 1.0)


@pytest.mark.parametrize("share", [0.0, 1.01, -1.0, np.nan])
def test_share_out_of_range(share):
    for act in (
        lambda: lod_leaves(10, share),
        lambda: thickest_edges(TREES["comb"], share),
        lambda: patch_mesh(twig(), share),
    ):
        with pytest.raises(InputError, match="share must be above 0 and at most 1, got"):
            act()


@pytest.mark.parametrize("share", [1.0, 0.5, 0.25, 0.1, 0.02])
def test_a_prefix_of_the_leaves_is_a_level_of_the_same_area(share):
    patch = twig(3, 120)
    whole, level = patch_mesh(patch), patch_mesh(patch, share)
    count, scale = level.n_leaves, lod_leaves(patch.leaves.length * patch.leaves.width, share)[1]
    assert count == int(np.ceil(round(share * 120, 9)))
    base = np.repeat(patch.leaves.base[:count], 4, axis=0)
    npt.assert_allclose(
        level.leaves.vertices, base + scale * (whole.leaves.vertices[: 4 * count] - base), atol=1e-12
    )
    for name in ("uv", "node", "color", "normals"):
        npt.assert_array_equal(getattr(level.leaves, name), getattr(whole.leaves, name)[: 4 * count])
    area = np.linalg.norm(face_areas(level.leaves), axis=1).sum()
    npt.assert_allclose(area, (patch.leaves.length * patch.leaves.width).sum(), rtol=1e-9)
    npt.assert_allclose(level.blade_area, area, rtol=1e-9)


# Branches at a level


GRAPHS = ["chain", "comb", "forest", "one node", "only roots"]


@pytest.mark.parametrize("share", [0.05, 0.3, 0.77, 1.0])
@pytest.mark.parametrize("name", [*GRAPHS, "realistic"])
def test_the_thickest_edges_are_connected_and_counted(name, share):
    tree = realistic_tree(step=0.1, height=6.0) if name == "realistic" else TREES[name]
    part, node = thickest_edges(tree, share)
    roots = tree.parent == NO_PARENT
    assert (part.parent == NO_PARENT).sum() == roots.sum()
    n_edges = int((~roots).sum())
    assert part.n_nodes - roots.sum() == int(np.ceil(round(share * n_edges, 9)))
    edge = part.parent != NO_PARENT
    npt.assert_array_equal(node[part.parent[edge]], tree.parent[node[edge]])  # the parent is the old one
    npt.assert_array_equal(part.position, tree.position[node])
    kept = np.zeros(tree.n_nodes, bool)
    kept[node] = True
    left_out = np.flatnonzero(~kept)
    thinnest = way_down(tree)
    if left_out.size and edge.any():
        assert thinnest[left_out].max() <= thinnest[node[edge]].min()


def way_down(tree):
    """The least radius of the edges between each node and its root, node by node."""
    out = []
    for k in range(tree.n_nodes):
        least, at = np.inf, k
        while tree.parent[at] != NO_PARENT:
            least, at = min(least, tree.radius[at]), tree.parent[at]
        out.append(least)
    return np.array(out)


def test_levels_of_branches_are_nested():
    tree = realistic_tree(step=0.1, height=6.0)
    kept = [set(thickest_edges(tree, share)[1].tolist()) for share in (0.1, 0.2, 0.5, 1.0)]
    assert all(a < b for a, b in zip(kept, kept[1:], strict=False))


def test_a_twig_thicker_than_what_bears_it_does_not_come_alone():
    tree = TreeGraph([-1, 0, 1, 0], [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 1]], [0.1, 0.01, 0.05, 0.02])
    assert thickest_edges(tree, 0.3)[1].tolist() == [0, 3]
    assert thickest_edges(tree, 0.6)[1].tolist() == [0, 1, 3]


@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize("share", [0.01, 0.3, 1.0])
def test_what_bears_leaves_is_kept_with_its_way_to_the_root(name, share):
    tree = TREES[name]
    if not np.isfinite(tree.radius).all():
        pytest.skip("radii must be known")
    rng = np.random.default_rng(0)
    for keep in (np.empty(0, int), rng.integers(0, tree.n_nodes, 3), np.arange(tree.n_nodes)):
        part, node = thickest_edges(tree, share, keep)
        wanted = set()
        for i in keep:
            while i != NO_PARENT and i not in wanted:
                wanted.add(int(i))
                i = tree.parent[i]
        assert wanted <= set(node.tolist())
        roots = set(np.flatnonzero(tree.parent == NO_PARENT).tolist())
        n_edges = tree.n_nodes - len(roots)
        assert len(node) - len(roots) == max(int(np.ceil(share * n_edges - 1e-9)), len(wanted - roots))
        above = tree.parent[node]
        assert set(above[above != NO_PARENT].tolist()) <= set(node.tolist())
        npt.assert_array_equal(part.position, tree.position[node])
        if not len(keep):
            npt.assert_array_equal(node, thickest_edges(tree, share)[1])


# Patches


def test_a_patch_is_its_twigs_and_leaves():
    patch = twig(2)
    mesh = patch_mesh(patch)
    npt.assert_array_equal(mesh.twigs.vertices, branch_mesh(patch.graph, TWIGS).vertices)
    assert mesh.n_faces == len(mesh.twigs.faces) + 200 and mesh.n_leaves == 100
    npt.assert_array_equal(mesh.leaves.node, np.repeat(patch.leaves.node, 4))
    assert repr(mesh).startswith("<PatchMesh 100 leaves,")


def test_twigs_at_a_level_are_numbered_as_the_patch_is():
    patch = twig(2)
    mesh = patch_mesh(patch, 0.4)
    part, node = thickest_edges(patch.graph, 0.4)
    assert 0 < mesh_volume(mesh.twigs) <= mesh_volume(patch_mesh(patch).twigs)
    assert set(np.unique(mesh.twigs.node)) <= set(node.tolist())
    own = branch_mesh(part, TWIGS)
    npt.assert_array_equal(mesh.twigs.node, node[own.node])


def test_a_bare_patch_and_one_that_is_a_point():
    bare = patch_mesh(Patch(twig().graph, NONE), 0.5)
    assert bare.n_leaves == 0 and bare.blade_area == 0.0 and len(bare.leaves.faces) == 0
    point = patch_mesh(Patch(TreeGraph([-1], [[0, 0, 0]], [0.001]), ONE))
    assert len(point.twigs.faces) == 0 and len(point.leaves.faces) == 2


def test_unknown_radii_of_a_patch():
    graph = twig().graph
    with pytest.raises(TreeError, match="radius must be known at every node"):
        patch_meshes([Patch(graph.replace(radius=np.full(graph.n_nodes, np.nan)), ONE)])
