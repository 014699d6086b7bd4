"""Branchlets: derived from a grammar within limits, and cut into patches without losing a leaf."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from species.errors import DerivationError, GrammarError
from species.foliage import LeafSet
from species.library import Branchlet, branchlets, cut_branchlet, derive_branchlets, parse_definition
from species.library.branchlets import CUT_LEAVES, KEPT, LEAST_RADIUS, WHOLE_LEAVES, leaf_box
from tests.library_examples import GRAMMAR, random_branchlet, species_text
from treegraph import TreeGraph


def derive(grammar=GRAMMAR, **changes):
    return derive_branchlets(parse_definition(species_text(branchlets__grammar=grammar, **changes)))


# ---------------------------------------------------------------- deriving


def test_branchlets_are_those_of_the_grammar():
    made = derive()
    assert len(made) == 4
    assert [round(each.size, 6) for each in made] == [0.5, 0.666667, 0.833333, 1.0]
    for each in made:
        assert (each.graph.n_nodes, each.leaves.n_leaves) == (29, 57)
        axis = each.graph.attribute["order"] == 0
        assert axis.sum() == 5
        tip = each.graph.position[np.flatnonzero(axis)[-1]]
        assert np.linalg.norm(tip) == pytest.approx(4 * 0.12 * each.size)
        slope = np.degrees(np.arcsin(tip[2] / np.linalg.norm(tip)))
        assert slope == pytest.approx(each.slope_deg)
        assert tip[0] == pytest.approx(0.0, abs=1e-12) and tip[1] >= 0.0  # sets off towards +y
        assert each.graph.radius[0] == pytest.approx(0.5 * (0.004 + 0.004 * each.size))
        assert sorted(set(each.leaves.length.round(6))) == [0.05, 0.06, 0.07, 0.08]


def test_sizes_and_slopes_are_spread_and_do_not_go_together():
    made = derive(branchlets__count=30, branchlets__slope_deg=[-20, 70])
    size = np.array([each.size for each in made])
    slope = np.array([each.slope_deg for each in made])
    assert np.allclose(np.diff(size), 0.5 / 29)
    assert (np.diff(np.sort(np.concatenate([[-20], slope, [70]]))) < 2.0 * 90 / 30).all()
    assert abs(np.corrcoef(size, slope)[0, 1]) < 0.2


def test_one_branchlet_is_of_middle_size():
    (only,) = derive(branchlets__count=1)
    assert only.size == 0.75


def test_a_leaf_is_as_wide_as_its_picture():
    definition = parse_definition(species_text())
    length, width = leaf_box(definition)
    assert length == 0.08 and 0.04 <= width < 0.05  # the blade and a margin
    for each in derive_branchlets(definition):
        assert np.allclose(each.leaves.width / each.leaves.length, width / length)


def test_random_grammars_give_the_same_branchlets_every_time():
    grammar = GRAMMAR.replace("F(0.05)", "F(uniform(0.03, 0.07)) /(normal(0, 30))")
    for one, other in zip(derive(grammar), derive(grammar), strict=True):
        assert (one.graph.position == other.graph.position).all()
        assert (one.leaves.base == other.leaves.base).all()
    first, second = derive(grammar)[:2]
    scaled = first.graph.position / first.size, second.graph.position / second.size
    assert not np.allclose(*scaled, atol=1e-3)  # each has numbers of its own


def test_leaves_without_size_are_left_out_and_wood_is_never_too_thin():
    (only,) = derive(
        GRAMMAR.replace("A(n, w) -> L(0.08)", "A(n, w) -> L(0) !(0) F(0.01) L(0.03)"), branchlets__count=1
    )
    assert only.leaves.n_leaves == 57 and only.leaves.length.min() > 0.0
    assert only.graph.radius.min() == LEAST_RADIUS


@pytest.mark.parametrize(
    "old, new, text",
    [
        ("axiom", "axium", "grammar, line 4, column 7 (line "),
        ("[ +(50)", "[ +(50", "grammar, line 5, column "),
        ("B(n, w) -> L(0.05)", "B(n, w) -> L(q)", "grammar, line 8, column 14 (line "),
        ("param size = 1\n", "", "grammar, line "),
        ("param slope = 30", "const slope = 30", "grammar: it must have `param slope = ...`"),
        ("iterations = 8", "iterations = 1000000", "branchlet 1 of 4: at most 10000 iterations, got 1000000"),
        ("iterations = 8", "", "branchlet 1 of 4: say how many iterations"),
        ("L(0.05)", "L(1 / (size - size))", "branchlet 1 of 4, line 8, column "),
        ("L(0.05)", "L(0 - 1)", "branchlet 1 of 4: the size of a leaf, L(x), must be >= 0, got -1"),
        ("L(0.05)", "L(11)", "branchlet 1 of 4: its leaves must be from 0.0001 to 10 m long, got 11 m"),
        (
            "L(0.05)",
            "L(0.00001)",
            "branchlet 1 of 4: its leaves must be from 0.0001 to 10 m long, got 1e-05 m",
        ),
        (
            "L(0.05)",
            "!(5) F(1) L(0.05)",
            "branchlet 1 of 4: its wood must be from 0 to 1 m thick, as radius, got 2.5 m",
        ),
        ("L(0.05)", "F(300) L(0.05)", "branchlet 1 of 4: it must reach from 0.001 to 100 m far, got "),
        ("L(0.05)", "f(1) F(1) L(0.05)", "branchlet 1 of 4: it is in pieces"),
        ("&(90 - slope) A", "f(1) A", "branchlet 1 of 4: it is in pieces"),
        ("L(0.05)", "L(size - 0.55)", "branchlet 1 of 4: the size of a leaf"),
        ("L(0.05)", "L(1e12)", "branchlet 1 of 4: "),
    ],
)
def test_what_is_wrong_with_a_grammar_says_where(old, new, text):
    grammar = GRAMMAR.replace(old, new)
    assert grammar != GRAMMAR
    with pytest.raises((GrammarError, DerivationError)) as error:
        derive(grammar)
    said = str(error.value)
    assert said.startswith(f"[branchlets] {text}"), said
    assert "\n" not in said and "DerivationLimits" not in said


def test_the_line_of_the_file_is_the_right_one():
    text = species_text(branchlets__grammar=GRAMMAR.replace("B(n, w) -> L(0.05)", "B(n, w) -> L(q)"))
    with pytest.raises(GrammarError) as error:
        derive_branchlets(parse_definition(text))
    line = int(str(error.value).split("(line ")[1].split()[0])
    assert text.splitlines()[line - 1] == "B(n, w) -> L(q)"
    assert (error.value.line, error.value.column) == (8, 14)


def test_a_grammar_written_with_escapes_has_no_line_of_the_file():
    one_line = GRAMMAR.replace("L(0.05)", "L(q)").replace("\n", "\\n")
    text = species_text().replace(f"'''\n{GRAMMAR}'''", f'"{one_line}"')
    with pytest.raises(GrammarError, match=r"^\[branchlets\] grammar, line 8, column 14: "):
        derive_branchlets(parse_definition(text))


@pytest.mark.parametrize(
    "grammar, text",
    [
        ("iterations = 1\naxiom = L(size + slope)", "it has no wood: its word draws no F"),
        ("iterations = 1\naxiom = F(size + slope)", "it has no leaves: its word places no L"),
        ("iterations = 1\naxiom = F(size + slope) L(0)", "it has no leaves: its word places no L"),
        (
            "iterations = 11\naxiom = A(size + slope)\nA(x) -> F(0.001) L(0.1) A(x) A(x)",
            "it has 2048 nodes and 2047 leaves; at",
        ),
        (
            "iterations = 13\naxiom = L(0.1) A(size + slope)\nA(x) -> F(0.001) A(x) A(x)",
            "it has 8192 nodes and 1 leaves; at",
        ),
        (
            "iterations = 9000\naxiom = A(size + slope)\nA(x) -> F(0.1) A(x) A(x)",
            "the word has more than 200000 modules in iteration 17 of 9000; ask for fewer iterations",
        ),
    ],
)
def test_a_branchlet_that_is_none_is_refused(grammar, text):
    with pytest.raises(DerivationError) as error:
        derive(f"param size = 1\nparam slope = 2\n{grammar}\n")
    assert str(error.value).startswith(f"[branchlets] branchlet 1 of 4: {text}"), str(error.value)


def test_the_branchlet_at_fault_is_named():
    with pytest.raises(DerivationError, match=r"^\[branchlets\] branchlet 3 of 4: it has no leaves"):
        derive("param size = 1\nparam slope = 2\niterations = 0\naxiom = F(1) L(max(0, 0.8 - size))\n")


def test_many_slow_branchlets_end_too(monkeypatch):
    monkeypatch.setattr(branchlets, "MOST_SECONDS", 0.0)
    with pytest.raises(DerivationError, match="branchlet 1 of 4: deriving all takes longer than 0 s"):
        derive()


# ---------------------------------------------------------------- cutting


def whole_after(branchlet, patches):
    """Check what holds of the patches of any branchlet; return the cut twigs that the first has docks for."""
    first = patches[0]
    assert all(patch.branchlet == 7 for patch in patches)
    for patch in patches:
        graph, leaves = patch.graph, patch.leaves
        assert (graph.parent[1:] >= 0).all() and graph.parent[0] == -1
        assert (graph.position[0] == 0.0).all()
        assert patch.radius == graph.radius[0] > 0.0
        assert -np.pi / 2 <= patch.slope <= np.pi / 2
        for vectors in (leaves.along, leaves.normal, patch.dock_direction):
            assert np.allclose(np.linalg.norm(vectors, axis=1), 1.0)
        assert np.allclose(np.einsum("ij,ij->i", leaves.along, leaves.normal), 0.0, atol=1e-9)
        if leaves.n_leaves:
            assert 0 <= leaves.node.min() <= leaves.node.max() < graph.n_nodes
        if patch.n_docks:
            gap = np.linalg.norm(patch.dock_position[:, None] - graph.position[None], axis=2)
            assert gap.min(axis=1).max() < 1e-9  # on the wood
    assert first.radius == branchlet.graph.radius[0]
    return first.n_docks


def leaves_beyond(graph, leaves, node):
    """Leaves on a node and all that hangs on it, counted one by one."""
    count = 0
    for bearer in leaves.node:
        while bearer > node:
            bearer = graph.parent[bearer]
        count += bearer == node
    return count


def slow_twigs(graph, leaves):
    """Nodes where a twig is cut off: no other cut below, a bracket deeper, enough leaves."""
    order = graph.attribute["order"].copy()
    order[0] = order[1:].min()
    twigs = []
    for i in range(1, graph.n_nodes):
        above = i
        while above > 0 and above not in twigs:
            above = graph.parent[above]
        deeper = order[i] > order[graph.parent[i]]
        if above == 0 and deeper and leaves_beyond(graph, leaves, i) >= CUT_LEAVES:
            twigs.append(i)
    return twigs


def test_a_known_branchlet_is_cut_as_by_hand():
    branchlet = derive()[0]
    patches = cut_branchlet(branchlet, 7)
    assert [(p.graph.n_nodes, p.leaves.n_leaves, p.n_docks) for p in patches] == [
        (5, 1, 8),
        (4, 7, 0),
        (4, 7, 0),
    ]
    axis, twig = patches[:2]
    along = 0.12 * 0.5 * np.arange(5)
    assert np.allclose(axis.graph.position, np.column_stack([0 * along, 0 * along, along]), atol=1e-12)
    assert np.allclose(axis.dock_position[:, 2], np.repeat(along[1:], 2))
    assert np.allclose(axis.dock_direction[:, 2], np.cos(np.radians(50)))
    side = np.degrees(np.arctan2(axis.dock_direction[:, 1], axis.dock_direction[:, 0])) % 180
    assert np.allclose(np.abs(np.diff(side[::2])), 90)  # every pair is rolled by 90 degrees
    assert np.allclose(axis.dock_radius, 0.006 / 2 * 0.6 * 0.8 ** np.repeat(np.arange(4), 2))
    assert axis.slope == pytest.approx(np.radians(branchlet.slope_deg))
    assert twig.graph.position[-1] == pytest.approx([0, 0, 0.15], abs=1e-12)
    assert twig.radius == pytest.approx(0.006 / 2 * 0.6) and twig.graph.radius[1] == twig.radius


def test_the_side_that_looked_up_still_does():
    for branchlet in derive(branchlets__slope_deg=[10, 80]):
        axis = cut_branchlet(branchlet)[0]
        up = np.array([np.cos(axis.slope), 0.0, np.sin(axis.slope)])  # the world's z in the patch's frame
        (leaf,) = np.flatnonzero(axis.leaves.length == 0.08)
        (before,) = np.flatnonzero(branchlet.leaves.length == 0.08)
        assert axis.leaves.along[leaf] @ up == pytest.approx(branchlet.leaves.along[before, 2])
        assert axis.leaves.normal[leaf] @ up == pytest.approx(branchlet.leaves.normal[before, 2])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 60), st.integers(1, 120))
def test_no_leaf_is_lost_and_every_cut_has_its_dock(seed, n_nodes, n_leaves):
    branchlet = random_branchlet(seed, n_nodes, n_leaves)
    graph, leaves = branchlet.graph, branchlet.leaves
    patches = cut_branchlet(branchlet, 7)
    n_docks = whole_after(branchlet, patches)
    twigs = slow_twigs(graph, leaves) if n_leaves > WHOLE_LEAVES else []
    assert n_docks == len(twigs)
    cut_off = [leaves_beyond(graph, leaves, twig) for twig in twigs]
    assert patches[0].leaves.n_leaves + sum(cut_off) == n_leaves
    order = np.argsort(patches[0].dock_radius, kind="stable"), np.argsort(graph.radius[twigs], kind="stable")
    assert np.allclose(patches[0].dock_radius[order[0]], graph.radius[twigs][order[1]])
    if n_leaves <= WHOLE_LEAVES:
        assert len(patches) == 1 and patches[0].n_docks == 0
    assert len(patches) <= 1 + KEPT[0] * (1 + KEPT[1])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 40), st.integers(1, 60))
def test_patches_are_rigid_pieces_of_the_branchlet(seed, n_nodes, n_leaves):
    branchlet = random_branchlet(seed, n_nodes, n_leaves)
    graph, leaves = branchlet.graph, branchlet.leaves
    first = cut_branchlet(branchlet, 7)[0]
    twigs = slow_twigs(graph, leaves) if n_leaves > WHOLE_LEAVES else []
    gone = np.zeros(n_nodes, bool)
    for i in range(n_nodes):
        gone[i] = i in twigs or (i > 0 and gone[graph.parent[i]])
    kept = np.flatnonzero(~gone)
    assert first.graph.n_nodes == len(kept)
    before, after = graph.position[kept] - graph.position[0], first.graph.position
    assert np.allclose(before @ before.T, after @ after.T, atol=1e-9)
    assert np.allclose(after @ [np.cos(first.slope), 0, np.sin(first.slope)], before[:, 2], atol=1e-9)
    stay = ~gone[leaves.node]
    size = leaves.length[stay]
    assert np.allclose(np.sort(first.leaves.length), np.sort(size))
    match = np.argsort(first.leaves.length), np.argsort(size)
    base_before = (leaves.base[stay] - graph.position[0])[match[1]]
    assert np.allclose(first.leaves.base[match[0]] @ after.T, base_before @ before.T, atol=1e-9)


def test_leaves_are_in_an_order_that_never_changes():
    branchlet = random_branchlet(3, 2, 100)
    one, other = cut_branchlet(branchlet, 5)[0], cut_branchlet(branchlet, 5)[0]
    assert (one.leaves.length == other.leaves.length).all()
    assert (one.leaves.length != branchlet.leaves.length).any()  # not that of the grammar
    another = cut_branchlet(branchlet, 6)[0]
    assert (one.leaves.length != another.leaves.length).any()
    assert (np.sort(one.leaves.length) == np.sort(another.leaves.length)).all()


def straight(position, parent, order, n_leaves, node):
    """A branchlet of given nodes whose leaves all hang on one node."""
    n = len(position)
    graph = TreeGraph(parent, position, np.full(n, 0.001), {"order": np.array(order, np.int32)})
    one = np.ones((n_leaves, 1))
    size = np.full(n_leaves, 0.05)
    leaves = LeafSet(
        one * position[node], one * [[0.0, 0, 1]], one * [[1.0, 0, 0]], size, size / 2,
        np.full(n_leaves, node, np.int32),
    )  # fmt: skip
    return Branchlet(graph, leaves, 1.0, 0.0)


def test_a_patch_sets_off_along_its_axis_not_along_its_first_side_twig():
    position = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0.0]])  # a bracket first, then the axis
    (patch,) = cut_branchlet(straight(position, [-1, 0, 0], [0, 1, 0], 3, 1))
    assert patch.graph.position[2] == pytest.approx([0, 0, 0.1])


def test_a_patch_that_begins_with_no_length_sets_off_where_it_goes():
    position = np.array([[0, 0, 0], [0, 0, 0], [0, 0.1, 0.0]])
    (patch,) = cut_branchlet(straight(position, [-1, 0, 1], [0, 0, 0], 3, 2))
    assert patch.graph.position[2] == pytest.approx([0, 0, 0.1])


@pytest.mark.parametrize("way, slope", [([0, 0, 0.1], 90), ([0, 0, -0.1], -90), ([0.1, 0, 0], 0)])
def test_twigs_straight_up_and_down_have_a_frame(way, slope):
    (patch,) = cut_branchlet(straight(np.array([[0, 0, 0], way], float), [-1, 0], [0, 0], 3, 1))
    assert np.degrees(patch.slope) == pytest.approx(slope)
    assert patch.graph.position[1] == pytest.approx([0, 0, 0.1])


def test_a_branchlet_all_of_side_twigs_leaves_a_foot_with_docks():
    position = np.array([[0, 0, 0], [0.1, 0, 0], [-0.1, 0, 0.0]])
    branchlet = straight(position, [-1, 0, 0], [0, 1, 1], 20, 1)
    patches = cut_branchlet(branchlet)
    whole_after_cut = [(p.graph.n_nodes, p.leaves.n_leaves, p.n_docks) for p in patches]
    assert whole_after_cut == [(3, 20, 0)]  # the lowest order is the axis, wherever the brackets are
