"""The cylinder table: known values, what always holds, and the text that other programs read."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sapwood.cylinders import (
    CYLINDER_HEADER,
    cylinder_length,
    cylinder_table,
    cylinder_volume,
    format_cylinders,
)
from treegraph import TreeGraph, chains, gravelius_order


def points(table, end):
    return np.stack([table[f"{axis}{end}"] for axis in "xyz"], axis=1)


def trunk_and(branch, *, trunk_radius=0.2, branch_radius=0.03):
    """A trunk of 4 m with a node each metre, and a side branch of these points from (0, 0, 2)."""
    trunk = [[0, 0, z] for z in range(5)]
    parent = [-1, 0, 1, 2, 3, 2] + list(range(5, 4 + len(branch)))
    radius = [trunk_radius] * 5 + [branch_radius] * len(branch)
    return TreeGraph(parent, trunk + list(branch), radius)


@pytest.mark.parametrize("angle_deg, carrier", [(90, 1), (60, 2), (30, 2), (8, 3), (150, 1), (172, 0)])
def test_a_branch_starts_on_its_parents_surface(angle_deg, carrier):
    """Its parent is the cylinder of the trunk that it comes out of, wherever its foot is: here at z = 2."""
    angle = math.radians(angle_deg)
    tree = trunk_and([[3 * math.sin(angle), 0, 2 + 3 * math.cos(angle)]])
    table = cylinder_table(tree)
    assert table.size == 5
    branch = table[table["order"] == 1][0]
    out = 0.2 / math.sin(angle)  # along the branch to the wall of the trunk
    npt.assert_allclose([branch["x0"], branch["z0"]], [0.2, 2 + out * math.cos(angle)], atol=1e-9)
    npt.assert_allclose(cylinder_length(table)[branch["id"]], 3 - out, atol=1e-9)
    assert branch["r0"] == branch["r1"] == 0.03  # its own, not the trunk's
    trunk = table[table["order"] == 0]
    assert trunk["z0"].tolist() == [0, 1, 2, 3]
    assert branch["parent"] == trunk["id"][carrier]


def test_a_tapering_parent_is_a_cone():
    tree = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 2], [0, 0, 4], [1, 0, 3]], [0.3, 0.2, 0.1, 0.01])
    branch = cylinder_table(tree)[-1]
    x = 0.2 / (1 + 0.05)  # the wall is at x = 0.2 - 0.05 (z - 2), the branch at z - 2 = x
    # The kernel measures the radius at the foot of the perpendicular, which is what x and z give here.
    npt.assert_allclose([branch["x0"], branch["z0"]], [x, 2 + x], atol=1e-9)


def test_a_segment_inside_the_parent_is_left_out():
    """Nodes at 0.05 and 0.15 m from the axis of a trunk of 0.2 m: only the third segment is visible."""
    tree = trunk_and([[0.05, 0, 2], [0.15, 0, 2], [1, 0, 2], [2, 0, 2]])
    table = cylinder_table(tree)
    assert table.size == 6  # 4 of the trunk, 2 of the branch
    npt.assert_allclose(points(table, 0)[4], [0.2, 0, 2], atol=1e-9)
    assert table["parent"].tolist() == [-1, 0, 1, 2, 1, 4]


def test_what_grows_from_a_hidden_segment_is_cut_at_the_same_surface():
    """A twig that leaves the branch while still inside the trunk starts on the trunk's surface."""
    tree = TreeGraph(
        [-1, 0, 1, 1, 3, 3],
        [[0, 0, 0], [0, 0, 2], [0, 0, 4], [0.1, 0, 2], [3, 0, 2], [0.1, 2, 2]],
        [0.2, 0.2, 0.2, 0.05, 0.05, 0.01],
    )
    table = cylinder_table(tree)
    assert table.size == 4
    twig = table[-1]
    npt.assert_allclose([twig["x0"], twig["y0"]], [0.1, math.sqrt(0.2**2 - 0.1**2)], atol=1e-9)
    assert twig["parent"] == table[-2]["parent"] == 0
    assert twig["order"] == 2


def test_a_twig_comes_out_where_the_hidden_branch_has_led():
    """The branch runs 10 m up inside the trunk; its twig is cut at the trunk's surface up there."""
    trunk = [[0, 0, z] for z in range(21)]
    hidden = [[0.05, 0, 12]]
    rest = [[4, 0, 12.5], [0.05, 5, 12.5]]  # the branch goes on along x, a thinner twig along y
    parent = [-1, *range(20), 2, 21, 21]
    tree = TreeGraph(parent, trunk + hidden + rest, [0.3] * 21 + [0.05, 0.05, 0.01])
    table = cylinder_table(tree)
    side = table[table["order"] > 0]
    assert side.size == 2
    for row in side:
        npt.assert_allclose(np.hypot(row["x0"], row["y0"]), 0.3, atol=1e-9)
        assert table[row["parent"]]["z0"] == 12
        assert table[row["parent"]]["order"] == 0


def test_a_branch_wholly_inside_vanishes():
    tree = trunk_and([[0.05, 0, 2.1], [0.1, 0, 2.2]])
    assert cylinder_table(tree).size == 4


def test_stems_from_one_root():
    """The second stem is cut at the first one's surface and hangs on it: a tree has one root."""
    tree = TreeGraph([-1, 0, 0], [[0, 0, 0], [0, 0, 3], [2, 0, 0.5]], [0.1, 0.1, 0.05])
    table = cylinder_table(tree)
    assert table["parent"].tolist() == [-1, 0]
    assert np.hypot(table["x0"][1], table["y0"][1]) == pytest.approx(0.1, abs=1e-9)


def test_a_segment_without_length_is_no_cylinder():
    tree = TreeGraph([-1, 0, 1, 2], [[0, 0, 0], [0, 0, 1], [0, 0, 1], [0, 0, 2]], [0.1] * 4)
    table = cylinder_table(tree)
    assert table["parent"].tolist() == [-1, 0]
    assert cylinder_length(table).tolist() == [1.0, 1.0]


def test_one_node_has_no_cylinder():
    table = cylinder_table(TreeGraph([-1], [[0, 0, 0]], [0.1]))
    assert table.size == 0
    assert format_cylinders(table) == CYLINDER_HEADER + "\n"


def test_unknown_radius_cuts_nothing():
    tree = TreeGraph(
        [-1, 0, 1, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2], [1, 0, 1]], [np.nan, np.nan, np.nan, 0.1]
    )
    table = cylinder_table(tree)
    assert table.size == 3
    assert cylinder_volume(table)[0] == 0.0


def test_measured_is_the_nodes_own():
    tree = trunk_and([[1, 0, 2]])
    tree = tree.replace(attribute={"measured": np.array([True, True, False, True, False, False])})
    assert cylinder_table(tree)["measured"].tolist() == [True, False, True, False, False]


def test_volume_of_a_frustum():
    tree = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 3]], [0.2, 0.1])
    assert cylinder_volume(cylinder_table(tree)).tolist() == pytest.approx([math.pi * 3 * 0.07 / 3])


# ---------------------------------------------------------------- what always holds


@st.composite
def trees(draw):
    n = draw(st.integers(2, 30))
    parent = [-1] + [draw(st.integers(max(0, i - 6), i - 1)) for i in range(1, n)]
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    step = rng.normal(0.0, 0.3, (n, 3)) + [0, 0, 0.2]
    position = np.zeros((n, 3))
    radius = np.full(n, 0.25)
    for i in range(1, n):
        position[i] = position[parent[i]] + step[i]
        radius[i] = radius[parent[i]] * rng.uniform(0.5, 1.0)
    return TreeGraph(parent, position, radius)


@given(trees())
@settings(deadline=None, max_examples=150)
def test_invariants(tree):
    table = cylinder_table(tree)
    assert table.size < tree.n_nodes
    assert table["id"].tolist() == list(range(table.size))
    assert (table["parent"] < table["id"]).all()
    length = np.linalg.norm(tree.position[1:] - tree.position[tree.parent[1:]], axis=1)
    assert cylinder_length(table).sum() <= length.sum() * (1 + 1e-9)
    # Every end is a node, and every cylinder lies on the segment of that node.
    order = gravelius_order(tree)
    for row in table:
        end = np.array([row["x1"], row["y1"], row["z1"]])
        node = int(np.flatnonzero((tree.position == end).all(axis=1))[0])
        foot = tree.position[tree.parent[node]]
        start = np.array([row["x0"], row["y0"], row["z0"]])
        share = np.linalg.norm(end - start) / np.linalg.norm(end - foot)
        npt.assert_allclose(start, end + share * (foot - end), atol=1e-9)
        assert row["order"] == order[node]
        assert row["r1"] == tree.radius[node]


@given(trees())
@settings(deadline=None, max_examples=150)
def test_the_trunk_is_never_cut(tree):
    start, node = chains(tree)
    trunk = node[start[0] : start[1]]
    table = cylinder_table(tree)
    ends = {
        tuple(p): tuple(q) for p, q in zip(points(table, 1).tolist(), points(table, 0).tolist(), strict=True)
    }
    for before, after in zip(trunk[:-1], trunk[1:], strict=True):
        assert ends[tuple(tree.position[after].tolist())] == tuple(tree.position[before].tolist())


@given(trees())
@settings(deadline=None, max_examples=100)
def test_a_branch_touches_the_cylinder_that_is_its_parent(tree):
    """Of what leaves the trunk, which is never cut itself; within one axis ends meet."""
    table = cylinder_table(tree)
    start, node = chains(tree)
    trunk = set(map(tuple, tree.position[node[start[0] : start[1]]].tolist()))
    foot, end = points(table, 0), points(table, 1)
    for row in table[table["parent"] >= 0]:
        k, below = row["id"], table[row["parent"]]
        touches = (foot[k] == end[row["parent"]]).all()
        if tuple(end[row["parent"]].tolist()) in trunk and not touches:
            a, b = foot[row["parent"]], end[row["parent"]]
            assert abs(cone_distance(foot[k], a, b, below["r0"], below["r1"])) < 1e-6


#: A trunk that turns back on itself: past the deepest wood on its way the branch meets its foot's neighbours.
CRUMPLED = TreeGraph(
    [-1, 0, 1, 2, 3, 4, 3, 6],
    [
        [0.0, 0.0, 0.0],
        [0.404, -0.229, -0.079],
        [0.166, -0.147, 0.073],
        [0.035, -0.197, -0.022],
        [0.063, 0.132, 0.005],
        [-0.222, 0.311, 0.234],
        [0.125, 0.227, 0.037],
        [-0.067, 0.149, 0.08],
    ],
    [0.25, 0.2, 0.176, 0.12, 0.119, 0.1, 0.071, 0.036],
)


@given(trees())
@example(CRUMPLED)
@settings(deadline=None, max_examples=100)
def test_feet_are_outside_the_wood_they_leave(tree):
    """Slow reference: distance of each foot to every cone of the parent chain next to the foot's node."""
    table = cylinder_table(tree)
    start, node = chains(tree)
    position, radius = tree.position, tree.radius
    trunk = set(node[start[0] : start[1]].tolist())
    for k in range(1, start.size - 1):
        foot, first = node[start[k]], node[start[k] + 1]
        if foot not in trunk:
            continue
        row = table[(points(table, 1) == position[first]).all(axis=1)]
        if row.size:
            near = [i for i in trunk if i and (i == foot or tree.parent[i] == foot)]
            for i in near:
                gap = cone_distance(
                    points(row, 0)[0],
                    position[tree.parent[i]],
                    position[i],
                    radius[tree.parent[i]],
                    radius[i],
                )
                assert gap > -1e-9


def cone_distance(p, a, b, ra, rb):
    t = float(np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1))
    return np.linalg.norm(p - a - t * (b - a)) - (ra + t * (rb - ra))


# ---------------------------------------------------------------- as text


def test_text_has_the_agreed_header_and_reads_back(tmp_path):
    tree = trunk_and([[1.23456789, 0, 2.5], [2, 0.1, 2.5]])
    origin = np.array([677123.4567, 5403210.9876, 412.3])
    table = cylinder_table(tree, origin)
    path = tmp_path / "cylinders.csv"
    path.write_text(format_cylinders(table))
    lines = path.read_text().splitlines()
    assert lines[0] == "id,parent,x0,y0,z0,x1,y1,z1,r0,r1,order,measured"
    back = np.genfromtxt(path, delimiter=",", names=True)
    for name in ("x0", "y0", "z0", "x1", "y1", "z1"):
        npt.assert_allclose(back[name], table[name], atol=0.6e-4)
    npt.assert_allclose(back["r0"], table["r0"], atol=0.6e-5)
    for name in ("id", "parent", "order", "measured"):
        assert back[name].tolist() == table[name].tolist()
    # What touches in the tree touches in the text.
    rows = [line.split(",") for line in lines[1:]]
    assert rows[1][2:5] == rows[0][5:8]


def test_no_minus_zero():
    tree = TreeGraph([-1, 0], [[-1e-9, 0, 0], [0, -0.00001, 1]], [0.1, 0.05])
    assert "-0.0000" not in format_cylinders(cylinder_table(tree))
