"""The .lobes file: what comes back, how exactly, and that the written format is the one in use."""

import math
import subprocess
import sys
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import treegraph
from tests.corpus import TREES, blob, parents, realistic_cluster_tree, realistic_tree
from tests.treegraph import lobes_reader
from treegraph import (
    DEFAULT_ALLOMETRY,
    Allometry,
    Cluster,
    ClusterTree,
    TreeError,
    TreeGraph,
    decode_lobes,
    encode_lobes,
    read_lobes,
    simplify,
    write_lobes,
)
from treegraph.lobes import LobesLimits

ROOT = Path(__file__).parents[2]
POSITION_STEP = 2.0**-10
RADIUS_STEP = 2.0**-12
HULL_STEP = 2.0**-7


def bare(graph, **changes):
    """A tree without clusters."""
    parts = {"clusters": (), "species": None, "allometry": DEFAULT_ALLOMETRY, "origin": (0, 0, 0)}
    return ClusterTree(graph, **(parts | changes))


def one_node(**changes):
    return bare(TreeGraph([-1], [(0, 0, 1)], [0.1]), **changes)


def with_hull(vertices, faces, seed=(0,), density=1.0, n_points=1):
    return one_node(clusters=(Cluster(vertices, np.reshape(faces, (-1, 3)), seed, density, n_points),))


def radius_error(radius):
    """What the format promises for trees of half a metre and more."""
    error = np.maximum(RADIUS_STEP / 2, radius / 512)
    return np.where((radius > 0) & (radius < RADIUS_STEP / 2), RADIUS_STEP, error)


def step_of(graph):
    """Step of the positions: halved until the tree reaches 512 of them, the coarsest where none will do."""
    reach = np.abs(graph.position).max()
    return next((2.0**-e for e in range(10, 21) if reach >= 512 * 2.0**-e), POSITION_STEP)


def match_vertices(before, after):
    """For each vertex of `after` the one of `before` that it was, by position and by the faces around it."""
    gap = np.abs(before[None] - after[:, None]).max(axis=2)
    match = gap.argmin(axis=1)
    assert len(set(match.tolist())) == len(before)
    return match


def turned(faces):
    """Faces as a multiset that forgets their order and first vertex, but not their direction."""
    return Counter(min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in np.asarray(faces).tolist())


def assert_same_graph(before, after):
    step = step_of(before)
    npt.assert_array_equal(after.parent, before.parent)
    assert np.abs(after.position - before.position).max() <= step / 2
    npt.assert_array_equal(np.isnan(after.radius), np.isnan(before.radius))
    known = ~np.isnan(before.radius)
    scale = step / POSITION_STEP
    off = np.abs(after.radius - before.radius)[known]
    assert (off <= scale * radius_error(before.radius[known] / scale) * (1 + 1e-9)).all()
    assert ((after.radius > 0) == (before.radius > 0)).all()


def assert_same_rest(before, after):
    assert after.species == before.species
    assert after.epsg == before.epsg
    npt.assert_array_equal(after.origin, before.origin)
    npt.assert_array_equal(
        [after.allometry.beta, after.allometry.gamma, after.allometry.f_s, after.allometry.d_root],
        [before.allometry.beta, before.allometry.gamma, before.allometry.f_s, before.allometry.d_root],
    )
    assert len(after.clusters) == len(before.clusters)
    for a, b in zip(before.clusters, after.clusters, strict=True):
        npt.assert_array_equal(b.seed, a.seed)
        assert b.n_points == a.n_points
        npt.assert_allclose(b.density, a.density, rtol=2.0**-16, atol=1e-33)


def assert_same_hulls(before, after):
    """For hulls whose vertices all differ."""
    for a, b in zip(before.clusters, after.clusters, strict=True):
        assert b.vertices.shape == a.vertices.shape
        if len(a.vertices) == 0:
            continue
        match = match_vertices(a.vertices, b.vertices)
        assert np.abs(a.vertices[match] - b.vertices).max() < HULL_STEP
        assert turned(match[b.faces] if len(b.faces) else b.faces) == turned(a.faces)


# ------------------------------------------------------------------------------------------ round trips


@pytest.mark.parametrize("graph", TREES.values(), ids=TREES)
def test_named_trees_come_back(graph):
    data = encode_lobes(bare(graph))
    after = decode_lobes(data)
    assert_same_graph(graph, after.graph)
    assert_same_rest(bare(graph), after)
    assert encode_lobes(after) == data


def test_a_tree_with_leaves_comes_back():
    before = realistic_cluster_tree(simplify(realistic_tree(), 0.01))
    data = encode_lobes(before)
    after = decode_lobes(data)
    assert_same_graph(before.graph, after.graph)
    assert_same_rest(before, after)
    assert_same_hulls(before, after)
    npt.assert_array_equal(after.graph.attribute["measured"], before.graph.attribute["measured"])
    assert encode_lobes(after) == data


def test_median_error_of_the_wood_is_half_a_millimetre():
    graph = realistic_tree(height=8.0)
    after = decode_lobes(encode_lobes(bare(graph))).graph
    assert np.median(np.linalg.norm(after.position - graph.position, axis=1)) < 0.0005


floats = st.floats(-30, 30)
radii = st.one_of(st.just(math.nan), st.just(0.0), st.floats(0, 2), st.floats(0, 1e-3), st.floats(0, 1e4))
scales = st.sampled_from([1.0, 1e-3, 1e-7, 1e5, 0.0])


@st.composite
def graphs(draw):
    parent = draw(parents(30))
    n = len(parent)
    position = draw(st.lists(st.tuples(floats, floats, floats), min_size=n, max_size=n))
    shift = draw(st.sampled_from([0.0, 0.0, 5e6]))
    radius = draw(st.lists(radii, min_size=n, max_size=n))
    attribute = {}
    if draw(st.booleans()):
        attribute["measured"] = draw(st.lists(st.booleans(), min_size=n, max_size=n))
    return TreeGraph(parent, np.array(position) * draw(scales) + shift, radius, attribute)


@st.composite
def clusters(draw, n_nodes):
    vertices = draw(st.lists(st.tuples(floats, floats, floats), max_size=12))
    index = st.integers(0, len(vertices) - 1) if vertices else st.nothing()
    faces = draw(st.lists(st.tuples(index, index, index), max_size=20)) if vertices else []
    seed = draw(st.lists(st.integers(0, n_nodes - 1), max_size=4))
    density = draw(st.one_of(st.just(math.nan), st.floats(0, 1e6), st.just(2.0**127)))
    scale = draw(st.sampled_from([1.0, 1e-3, 1e-6]))
    n_points = draw(st.integers(0, 2**31 - 1))
    return Cluster(
        np.reshape(vertices, (-1, 3)) * scale, np.reshape(faces, (-1, 3)).astype(int), seed, density, n_points
    )


@st.composite
def cluster_trees(draw):
    graph = draw(graphs())
    anywhere = st.floats(allow_nan=False, allow_infinity=False)
    return ClusterTree(
        graph,
        tuple(draw(st.lists(clusters(graph.n_nodes), max_size=4))),
        draw(
            st.one_of(st.none(), st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=60))
        ),
        Allometry(
            draw(st.floats(1, 1e9)),
            draw(st.floats(1e-9, 1e9)),
            draw(st.floats(0, 1, exclude_min=True)),
            draw(st.one_of(st.just(math.nan), st.floats(0, 1e9, exclude_min=True))),
        ),
        draw(st.tuples(anywhere, anywhere, anywhere)),
        draw(st.one_of(st.none(), st.integers(1, 2**31 - 1))),
    )


@given(cluster_trees())
@settings(deadline=None, max_examples=120)
def test_any_tree_comes_back_and_its_bytes_are_stable(before):
    data = encode_lobes(before)
    after = decode_lobes(data)
    assert_same_graph(before.graph, after.graph)
    assert_same_rest(before, after)
    assert set(after.graph.attribute) == set(before.graph.attribute)
    for a, b in zip(before.clusters, after.clusters, strict=True):
        assert b.vertices.shape == a.vertices.shape
        assert b.faces.shape == a.faces.shape
    assert encode_lobes(after) == data


@given(cluster_trees())
@settings(deadline=None, max_examples=60)
def test_the_reader_written_from_the_specification_agrees(tree):
    data = encode_lobes(tree)
    ours, theirs = decode_lobes(data), lobes_reader.read(data)
    npt.assert_array_equal(ours.graph.parent, theirs.parent)
    npt.assert_array_equal(ours.graph.position, theirs.position)
    npt.assert_array_equal(ours.graph.radius, theirs.radius)
    assert (theirs.measured is None) == ("measured" not in ours.graph.attribute)
    if theirs.measured is not None:
        npt.assert_array_equal(ours.graph.attribute["measured"], theirs.measured)
    assert (ours.species, ours.epsg, tuple(ours.origin)) == (theirs.species, theirs.epsg, theirs.origin)
    allometry = ours.allometry
    npt.assert_array_equal(
        [allometry.beta, allometry.gamma, allometry.f_s, allometry.d_root], theirs.allometry
    )
    assert len(ours.clusters) == len(theirs.clusters)
    for a, b in zip(ours.clusters, theirs.clusters, strict=True):
        npt.assert_array_equal(a.vertices, np.reshape(b.vertices, (-1, 3)))
        npt.assert_array_equal(a.faces, np.reshape(b.faces, (-1, 3)))
        npt.assert_array_equal(a.seed, b.seed)
        npt.assert_array_equal(a.density, b.density)
        assert a.n_points == b.n_points


def test_the_reader_written_from_the_specification_agrees_on_a_whole_tree():
    data = encode_lobes(realistic_cluster_tree(simplify(realistic_tree(), 0.01), n_clusters=10))
    ours, theirs = decode_lobes(data), lobes_reader.read(data)
    npt.assert_array_equal(ours.graph.position, theirs.position)
    npt.assert_array_equal(ours.graph.radius, theirs.radius)
    for a, b in zip(ours.clusters, theirs.clusters, strict=True):
        npt.assert_array_equal(a.vertices, b.vertices)
        npt.assert_array_equal(a.faces, b.faces)


# ---------------------------------------------------------------------------------------------- details

#: One node one metre up, with a radius of 0.1 m: nothing in it is long enough to be compressed.
SMALLEST = [
    "894c4f4245530d0a",  # magic
    "0100000083000000",  # version 1, no flags, 131 bytes
    "0100000000000000000000000000000000000000",  # one node, nothing else
    "787f00000a00",  # EPSG 32632, exponent 10, no name
    "000000000000f03f00000000000000400000000000000840",  # origin 1, 2, 3
    "000000000000f83f000000000000f43f000000000000ef3f000000000000f87f",  # 1.5, 1.25, 31/32, NaN
    "0101000006060202000000000000000000000000",  # sizes of the sections
    "00",  # the node follows its parent -1
    "000000000008",  # z is 1024 steps: 2048 = 0x0800 in zigzag, in two planes of x, y, z
    "3603",  # the radius is 409.6 steps: 410, plus one, in zigzag 822 = 0x0336
]


def test_bytes_of_the_smallest_tree():
    """Files that were written once must stay readable: these bytes only change with the version."""
    tree = one_node(origin=(1, 2, 3), epsg=32632, allometry=Allometry(1.5, 1.25, 31 / 32))
    data = encode_lobes(tree)
    assert data[:-4].hex() == "".join(SMALLEST)
    assert int.from_bytes(data[-4:], "little") == zlib.crc32(data[:-4])
    after = decode_lobes(data)
    assert after.graph.position.tolist() == [[0, 0, 1]]
    assert after.graph.radius.tolist() == [410 / 4096]


@pytest.mark.parametrize(
    "radius, kept",
    [
        (0.0, 0.0),
        (1e-9, RADIUS_STEP),
        (0.4 * RADIUS_STEP, RADIUS_STEP),
        (1.4 * RADIUS_STEP, RADIUS_STEP),
        (511.4 * RADIUS_STEP, 511 * RADIUS_STEP),
        (511.6 * RADIUS_STEP, 512 * RADIUS_STEP),
        (512.9 * RADIUS_STEP, 512 * RADIUS_STEP),
        (513.1 * RADIUS_STEP, 514 * RADIUS_STEP),
        (1023.5 * RADIUS_STEP, 1024 * RADIUS_STEP),
        (1025.9 * RADIUS_STEP, 1024 * RADIUS_STEP),
        (1026.1 * RADIUS_STEP, 1028 * RADIUS_STEP),
        (511 * 2.0**31 * RADIUS_STEP, 511 * 2.0**31 * RADIUS_STEP),
    ],
)
def test_radius_grid(radius, kept):
    data = encode_lobes(bare(TreeGraph([-1], [(0, 0, 1)], [radius])))
    assert decode_lobes(data).graph.radius.tolist() == [kept]


def test_radii_keep_their_order():
    radius = np.sort(np.random.default_rng(1).uniform(0, 1, 5000))
    graph = TreeGraph(np.arange(-1, 4999), np.ones((5000, 3)), radius)
    assert (np.diff(decode_lobes(encode_lobes(bare(graph))).graph.radius) >= 0).all()


def test_small_trees_have_finer_grids():
    rng = np.random.default_rng(2)
    for reach in (0.5, 0.4, 0.1, 0.01, 0.001):
        position = np.vstack([np.zeros(3), rng.uniform(-reach, reach, (200, 3)), [0, 0, reach]])
        graph = TreeGraph(np.arange(-1, 201), position, np.full(202, reach / 50))
        after = decode_lobes(encode_lobes(bare(graph))).graph
        assert np.abs(after.position - position).max() <= reach / 512
        npt.assert_allclose(after.radius, reach / 50, rtol=0.03)


def test_a_reach_that_rounds_up_to_the_coarser_grid():
    """1023.9 steps of the finer grid become 1024, which is 512 of the coarser one."""
    tree = bare(TreeGraph([-1], [(0, 0, 1023.9 * 2.0**-11)], [0.1]))
    data = encode_lobes(tree)
    assert encode_lobes(decode_lobes(data)) == data


def test_vertices_that_lie_close_stay_apart():
    rng = np.random.default_rng(3)
    vertices, faces = blob(rng, (3, 2, 9), 0.004)
    tree = with_hull(vertices, faces)
    data = encode_lobes(tree)
    (after,) = decode_lobes(data).clusters
    assert len(np.unique(after.vertices, axis=0)) == len(vertices)
    match = match_vertices(vertices, after.vertices)
    assert turned(match[after.faces]) == turned(faces)
    assert encode_lobes(decode_lobes(data)) == data


def test_vertices_that_part_only_after_rounding():
    """1.2 and 1.3 steps fall together, but not 1.0 and 1.5, which the finer grid makes of them."""
    tree = with_hull(np.array([(1.2, 0, 0), (1.3, 0, 0)]) * HULL_STEP, [])
    data = encode_lobes(tree)
    after = decode_lobes(data)
    assert len(np.unique(after.clusters[0].vertices, axis=0)) == 2
    assert (
        np.abs(np.sort(after.clusters[0].vertices[:, 0]) - tree.clusters[0].vertices[:, 0]).max() < HULL_STEP
    )
    assert encode_lobes(after) == data


def test_a_fine_hull_far_from_its_seed():
    """Its seed lies beyond the range of the hull's own grid."""
    cluster = Cluster([(0, 0, 0), (2.0**-23, 0, 0)], np.zeros((0, 3), int), [0], 1.0, 2)
    tree = bare(TreeGraph([-1], [(5e8, -5e8, 1)], [0.1]), clusters=(cluster,))
    data = encode_lobes(tree)
    npt.assert_array_equal(decode_lobes(data).clusters[0].vertices, cluster.vertices)
    npt.assert_array_equal(lobes_reader.read(data).clusters[0].vertices, cluster.vertices)


def test_hulls_stay_closed():
    tree = realistic_cluster_tree(simplify(realistic_tree(height=6.0), 0.01), n_clusters=12)
    for cluster in decode_lobes(encode_lobes(tree)).clusters:
        edges = np.concatenate([cluster.faces[:, [0, 1]], cluster.faces[:, [1, 2]], cluster.faces[:, [2, 0]]])
        forwards = Counter(map(tuple, edges.tolist()))
        assert set(forwards.values()) == {1}
        assert all((b, a) in forwards for a, b in forwards)
        corner = cluster.vertices[cluster.faces]
        assert np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) > 0


HULLS = {
    "no vertices": ([], []),
    "vertices without faces": ([(0, 0, 0), (1, 1, 1)], []),
    "a vertex in no face": ([(5, 5, 5), (0, 0, 0), (1, 0, 0), (0, 1, 0)], [(1, 2, 3)]),
    "one face": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(2, 0, 1)]),
    "two parts": (np.arange(18.0).reshape(6, 3), [(5, 4, 3), (0, 1, 2)]),
    "two parts that share a vertex": (np.arange(15.0).reshape(5, 3), [(0, 1, 2), (2, 3, 4)]),
    "both sides": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 1)]),
    "the same face three times": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)] * 3),
    "three faces at an edge": (np.eye(5, 3), [(0, 1, 2), (0, 1, 3), (1, 0, 4)]),
    "degenerate faces": ([(0, 0, 0), (1, 0, 0)], [(0, 0, 0), (0, 0, 1), (1, 0, 1)]),
    "vertices in one place": ([(1, 1, 1)] * 4, [(0, 1, 2), (3, 2, 1)]),
    "a strip with holes": (np.arange(21.0).reshape(7, 3), [(0, 1, 2), (2, 1, 3), (4, 5, 6), (3, 1, 6)]),
}


@pytest.mark.parametrize("vertices, faces", HULLS.values(), ids=HULLS)
def test_hulls_of_any_kind(vertices, faces):
    tree = with_hull(np.reshape(vertices, (-1, 3)), faces)
    data = encode_lobes(tree)
    after = decode_lobes(data)
    (cluster,) = after.clusters
    corners = Counter(
        min((a, b, c), (b, c, a), (c, a, b))
        for a, b, c in [tuple(tuple(vertices[v]) for v in face) for face in faces]
    )
    there = [[tuple(v) for v in triangle] for triangle in cluster.vertices[cluster.faces].tolist()]
    assert Counter(min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in there) == corners
    assert sorted(map(tuple, cluster.vertices.tolist())) == sorted(tuple(map(float, v)) for v in vertices)
    assert encode_lobes(after) == data


@given(st.lists(st.tuples(*[st.integers(0, 6)] * 3), max_size=25), st.permutations(range(7)), st.randoms())
@settings(deadline=None, max_examples=100)
def test_any_list_of_faces_is_kept(faces, order, random):
    vertices = np.array([(i, i * i, 3.0) for i in range(7)])[list(order)]
    (cluster,) = decode_lobes(encode_lobes(with_hull(vertices, faces))).clusters
    match = match_vertices(vertices, cluster.vertices)
    assert turned(match[cluster.faces] if len(faces) else []) == turned(faces)


def test_only_measured_is_kept():
    graph = TREES["comb"].replace(
        attribute={
            "measured": np.arange(25) % 3 == 0,
            "n_points": np.arange(25),
            "arc": np.linspace(0, 1, 25),
        }
    )
    after = decode_lobes(encode_lobes(bare(graph))).graph
    assert set(after.attribute) == {"measured"}
    assert after.attribute["measured"].dtype == bool
    npt.assert_array_equal(after.attribute["measured"], np.arange(25) % 3 == 0)


def test_types_of_what_comes_back():
    after = decode_lobes(bytearray(encode_lobes(realistic_cluster_tree(TREES["bush"], n_clusters=2))))
    assert (after.graph.parent.dtype, after.graph.position.dtype) == (np.int32, np.float64)
    assert (after.clusters[0].faces.dtype, after.clusters[0].seed.dtype) == (np.int32, np.int32)
    assert isinstance(after.clusters[0].n_points, int)
    assert isinstance(after.epsg, int)


# ----------------------------------------------------------------------------------------------- sizes


def test_wood_takes_less_than_four_and_a_half_bytes_a_node():
    graph = simplify(realistic_tree(height=12.0), 0.01)
    assert graph.n_nodes > 1500
    assert len(encode_lobes(bare(graph))) < 4.5 * graph.n_nodes


def test_forty_hulls_take_less_than_ten_kilobytes():
    graph = TREES["bush"]
    tree = realistic_cluster_tree(graph, n_clusters=40, n_around=8, n_levels=6)
    assert [len(cluster.faces) for cluster in tree.clusters] == [80] * 40
    assert len(encode_lobes(tree)) - len(encode_lobes(tree.replace(clusters=()))) < 10_000


# ----------------------------------------------------------------------------------------------- files


def test_files(tmp_path):
    tree = realistic_cluster_tree(TREES["bush"], n_clusters=3)
    path = tmp_path / "tree.lobes"
    write_lobes(tree, path)
    assert path.read_bytes() == encode_lobes(tree)
    assert encode_lobes(read_lobes(str(path))) == path.read_bytes()
    assert [file.name for file in tmp_path.iterdir()] == ["tree.lobes"]


def test_an_old_file_survives_a_failed_write(tmp_path):
    path = tmp_path / "tree.lobes"
    write_lobes(one_node(), path)
    before = path.read_bytes()
    with pytest.raises(TreeError):
        write_lobes(one_node(species="x" * 256), path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["tree.lobes"]


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_lobes(tmp_path / "none.lobes")


def test_reading_compiles_nothing(tmp_path):
    write_lobes(realistic_cluster_tree(TREES["bush"], n_clusters=2), tmp_path / "tree.lobes")
    code = (
        "import sys, treegraph; treegraph.read_lobes(sys.argv[1]); "
        "print(sorted({'numba', 'scipy'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "tree.lobes")], cwd=ROOT, capture_output=True, text=True
    )
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def test_names_are_exported():
    for name in ("encode_lobes", "decode_lobes", "read_lobes", "write_lobes"):
        assert name in treegraph.__all__
    assert LobesLimits().n_nodes == 2**20
