"""The turtle: each command by hand, trees of the textbook by hand, equality with a slow, obvious turtle."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from species import DerivationError, TurtleSettings, Word, derive_word, draw_word, parse_grammar
from species.lsystem import _turtle_kernels, turtle

X, Y, Z = np.eye(3)
LEFT, UP = -X, -Y  # of the turtle where it begins; its heading is Z


def draw(axiom, **options):
    settings = "".join(f"{name} = {value}\n" for name, value in options.items())
    return draw_word(derive_word(parse_grammar(f"{settings}axiom = {axiom}\niterations = 0")))


def heading(axiom, **options):
    """Direction of the last segment."""
    tree = draw(f"{axiom} F", **options).tree
    return tree.position[-1] - tree.position[tree.parent[-1]]


def turned(axis, degrees):
    """Rotation matrix about an axis, by Rodrigues' formula."""
    a = math.radians(degrees)
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + math.sin(a) * k + (1 - math.cos(a)) * (k @ k)


# ---------------------------------------------------------------- commands


def test_a_square_closes():
    tree = draw("F+F+F+F").tree
    npt.assert_allclose(tree.position, [[0, 0, 0], [0, 0, 1], [-1, 0, 1], [-1, 0, 0], [0, 0, 0]], atol=1e-15)
    assert tree.parent.tolist() == [-1, 0, 1, 2, 3]


@pytest.mark.parametrize(
    "command, wanted",
    [
        ("", Z),
        ("+", LEFT),
        ("-", -LEFT),
        ("^", UP),
        ("&", -UP),
        ("/", Z),
        ("\\", Z),
        ("|", -Z),
        ("/+", UP),  # rolled to the right: its left side is where up was
        ("\\+", -UP),
        ("/^", -LEFT),
        ("+&", -UP),
        ("&+", LEFT),
        ("+(30)", math.cos(math.pi / 6) * Z + 0.5 * LEFT),
        ("&(-30)", math.cos(math.pi / 6) * Z + 0.5 * UP),
        ("-(450)", -LEFT),
    ],
)
def test_turns(command, wanted):
    npt.assert_allclose(heading(command), wanted, atol=1e-15)


def test_default_angle_is_that_of_the_grammar():
    npt.assert_allclose(heading("+", angle=60), 0.5 * Z + math.sqrt(0.75) * LEFT, atol=1e-15)


def test_levelling_makes_left_horizontal_and_up_point_up():
    leaves = draw("/(40) &(30) \\(77) $ L").leaves
    along, normal = leaves.along[0], leaves.normal[0]
    left = np.cross(normal, along)
    npt.assert_allclose(along, turned(Z, 40) @ turned(LEFT, 30) @ Z, atol=1e-15)
    assert left[2] == pytest.approx(0, abs=1e-15)
    assert normal[2] == pytest.approx(math.sin(math.radians(30)), rel=1e-14)
    npt.assert_allclose(left, np.cross(Z, along) / np.linalg.norm(np.cross(Z, along)), atol=1e-15)


def test_levelling_a_vertical_heading_changes_nothing():
    leaves = draw("/(40) L $ L").leaves
    npt.assert_array_equal(leaves.normal[0], leaves.normal[1])


def test_move_leaves_a_gap_and_what_follows_is_a_tree_of_its_own():
    tree = draw("F(1) f(2) F(3) [f F] f").tree
    assert tree.parent.tolist() == [-1, 0, -1, 2, -1, 4]
    assert tree.position[:, 2].tolist() == [0, 1, 3, 6, 7, 8]


def test_branches_return():
    tree = draw("F[+F(2)[-F]]F(3)").tree
    assert tree.parent.tolist() == [-1, 0, 1, 2, 1]
    assert tree.attribute["order"].tolist() == [0, 0, 1, 2, 0]
    npt.assert_allclose(tree.position[:, [0, 2]], [[0, 0], [0, 1], [-2, 1], [-2, 2], [0, 4]], atol=1e-15)


def test_branches_at_the_begin_share_the_root():
    tree = draw("[+F][-F]").tree
    assert tree.parent.tolist() == [-1, 0, 0]
    npt.assert_allclose(tree.position, [[0, 0, 0], LEFT, -LEFT], atol=1e-15)


def test_widths_are_diameters():
    tree = draw("!(0.4) F !F [!(0.1) F] !!F", taper=0.5).tree
    npt.assert_allclose(tree.radius, [0.2, 0.2, 0.1, 0.05, 0.025], rtol=1e-15)
    assert draw("F", width=0.3).tree.radius.tolist() == [0.15, 0.15]


def test_lengths():
    assert draw("F F(0.5) F(-1)", step=2).tree.position[:, 2].tolist() == [0, 2, 2.5, 1.5]


def test_leaves_hang_on_the_last_node():
    drawing = draw("L(0.2) F [+ L L(0.3, 4) f(0.5) L] F L", leaf=0.7)
    leaves = drawing.leaves
    assert leaves.n_leaves == 5
    assert leaves.size.tolist() == [0.2, 0.7, 0.3, 0.7, 0.7]
    assert leaves.kind.tolist() == [0, 0, 4, 0, 0]
    assert leaves.node.tolist() == [0, 1, 1, 1, 2]
    npt.assert_allclose(leaves.base, [0 * Z, Z, Z, Z + 0.5 * LEFT, 2 * Z], atol=1e-15)
    npt.assert_allclose(leaves.along, [Z, LEFT, LEFT, LEFT, Z], atol=1e-15)
    npt.assert_allclose(leaves.normal, np.tile(UP, (5, 1)), atol=1e-15)
    assert (leaves.kind.dtype, leaves.node.dtype, leaves.size.dtype) == (np.int32, np.int32, np.float64)
    assert not leaves.base.flags.writeable


def test_tropism_bends_after_each_segment():
    """By e sin(angle) radians, at most onto the direction."""
    tree = draw("&(90) ~(0.2) F F ~(0) F", tropism="0, 0, -5").tree
    steps = np.diff(tree.position, axis=0)
    first, second = math.pi / 2 + 0.2, math.pi / 2 + 0.2 + 0.2 * math.sin(math.pi / 2 + 0.2)
    for step, polar in zip(steps, [math.pi / 2, first, second], strict=True):
        npt.assert_allclose(step, [0, math.sin(polar), math.cos(polar)], atol=1e-14)


@pytest.mark.parametrize("strength, end", [(1000, -Z), (-1000, Z)])
def test_tropism_never_passes_its_direction(strength, end):
    npt.assert_allclose(heading(f"&(60) ~({strength}) F"), end, atol=1e-12)


def test_tropism_leaves_a_parallel_heading():
    npt.assert_array_equal(heading("~(5) F"), Z)


def test_modules_that_are_no_commands_are_passed_over():
    grammar = parse_grammar("module Bud(x) A\naxiom = F(1, 7) Bud(3) A F(2)\niterations = 0")
    tree = draw_word(derive_word(grammar)).tree
    assert tree.position[:, 2].tolist() == [0, 1, 3]
    assert tree.attribute["module"].tolist() == [0, 0, 3]


@pytest.mark.parametrize("axiom", ["", "+", "f(3) !(2)"])
def test_nothing_drawn_is_one_node(axiom):
    drawing = draw(axiom, width=0.2)
    assert drawing.tree.position.tolist() == [[0, 0, 0]]
    assert drawing.tree.radius.tolist() == [0.1]
    assert drawing.tree.attribute["module"].tolist() == [-1]
    assert drawing.leaves.n_leaves == 0


def test_axes_stay_perpendicular():
    leaves = draw("+(1)&(1)/(1)" * 8_000 + "L").leaves
    assert np.linalg.norm(leaves.along) == pytest.approx(1, abs=1e-10)
    assert leaves.along[0] @ leaves.normal[0] == pytest.approx(0, abs=1e-10)


def test_the_loop_and_its_caller_agree_on_the_operations():
    names = ["NOTHING", "DRAW", "MOVE", "YAW", "PITCH", "ROLL", "LEVEL", "WIDTH", "THIN", "BEND", "LEAF"]
    for name in [*names, "PUSH", "POP"]:
        assert getattr(turtle, name) == getattr(_turtle_kernels, name)


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    "axiom, message",
    [
        ("!(-1)F", r"the width, !\(x\), must be >= 0, got -1"),
        ("L(-0.5)", r"the size of a leaf, L\(x\), must be >= 0, got -0.5"),
        (
            "L(1, 0.5)",
            r"the kind of a leaf, L\(size, kind\), must be a whole number from 0 to 2147483647, got 0.5",
        ),
        ("L(1, -1)", "the kind of a leaf, .*, got -1"),
        ("L(1, 3e9)", r"the kind of a leaf, .*, got 3e\+09"),
        ("+(2e9)", r"a turn, \+\(x\), must be within 1e\+09 degrees, got 2e\+09"),
        ("F(1e300)", r"F\(x\) must be within 1e\+09, got 1e\+300"),
        ("~(-1e300)", r"~\(x\) must be within 1e\+09, got -1e\+300"),
        (
            "F(9e8)F(9e8)",
            r"the turtle goes farther than 1e\+09 m from where it began; make the lengths smaller",
        ),
        ("f(9e8)f(9e8)L", r"the turtle goes farther than 1e\+09 m from .*"),
    ],
)
def test_wrong_numbers(axiom, message):
    with pytest.raises(DerivationError, match=f"^{message}$"):
        draw(axiom)


def test_widths_cannot_run_away():
    with pytest.raises(DerivationError, match=r"^a width is above 1e\+09 m; make width or taper smaller$"):
        draw("!" * 100 + "F", taper="1e300")


@pytest.mark.parametrize("code", [[0], [1], [1, 0], [0, 1, 1, 0]])
def test_unbalanced_words(code):
    with pytest.raises(DerivationError, match=r"^the brackets \[ \] of the word are not balanced$"):
        draw_word(Word((("[", 0), ("]", 0)), np.array(code), np.zeros(0)))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"angle_deg": math.inf}, "angle must be finite, got inf"),
        ({"step": math.nan}, "step must be finite, got nan"),
        ({"leaf": -1}, "leaf must be >= 0 and finite, got -1"),
        ({"taper": -0.1}, "taper must be >= 0 and finite, got -0.1"),
        ({"tropism": (1, 2)}, r"tropism must be a direction of three numbers, got \(1, 2\)"),
    ],
)
def test_wrong_settings(options, message):
    with pytest.raises(DerivationError, match=f"^{message}$"):
        TurtleSettings(**options)


# ---------------------------------------------------------------- trees of the textbook, chapter 2

MONOPODIAL = """
    const r1 = 0.9
    const r2 = 0.6
    const wr = 0.707
    axiom = A(1, 10)
    A(l, w) -> !(w) F(l) [&(45) B(l * r2, w * wr)] /(137.5) A(l * r1, w * wr)
    B(l, w) -> !(w) F(l) [-(45) $ C(l * r2, w * wr)] C(l * r1, w * wr)
    C(l, w) -> !(w) F(l) [+(45) $ B(l * r2, w * wr)] B(l * r1, w * wr)
"""


def test_monopodial_tree():
    tree = draw_word(derive_word(parse_grammar(MONOPODIAL), iterations=10)).tree
    order = tree.attribute["order"]
    start = tree.position[np.maximum(tree.parent, 0)]
    axis = tree.position - start
    length = np.linalg.norm(axis, axis=1)
    trunk = np.flatnonzero(order == 0)
    npt.assert_allclose(length[trunk[1:]], 0.9 ** np.arange(10), rtol=1e-12)
    npt.assert_allclose(tree.radius[trunk], 5 * 0.707 ** np.array([0, *range(10)]), rtol=1e-12)
    npt.assert_allclose(tree.position[trunk, :2], 0, atol=1e-15)
    bough = np.flatnonzero((order == 1) & (order[np.maximum(tree.parent, 0)] == 0))
    assert len(bough) == 9
    npt.assert_allclose(length[bough], 0.6 * 0.9 ** np.arange(9), rtol=1e-12)
    npt.assert_allclose(axis[bough, 2] / length[bough], math.sqrt(0.5), rtol=1e-12)
    azimuth = np.degrees(np.arctan2(axis[bough, 1], axis[bough, 0]))
    npt.assert_allclose((np.diff(azimuth) - 137.5 + 180) % 360 - 180, 0, atol=1e-9)
    twig = np.flatnonzero((order == 2) & (order[np.maximum(tree.parent, 0)] == 1))
    before = axis[tree.parent[twig]]
    cosine = (axis[twig] * before).sum(1) / length[twig] / length[tree.parent[twig]]
    npt.assert_allclose(cosine, math.sqrt(0.5), rtol=1e-12)
    assert tree.n_nodes == 1 + sum(2**k for k in range(10))


def test_sympodial_tree():
    """The apex dies: both branches leave the axis, at 5 and at 65 degrees."""
    text = """
        axiom = A(1, 10)
        A(l, w) -> !(w) F(l) [&(5) B(l * 0.9, w * 0.707)] /(180) [&(65) B(l * 0.7, w * 0.707)]
        B(l, w) -> !(w) F(l) [+(5) $ B(l * 0.9, w * 0.707)] [-(65) $ B(l * 0.7, w * 0.707)]
    """
    tree = draw_word(derive_word(parse_grammar(text), iterations=8)).tree
    depth = np.zeros(tree.n_nodes, int)
    axis = np.zeros((tree.n_nodes, 3))
    for i in range(1, tree.n_nodes):
        depth[i] = depth[tree.parent[i]] + 1
        axis[i] = tree.position[i] - tree.position[tree.parent[i]]
    length = np.linalg.norm(axis, axis=1)
    npt.assert_array_equal(np.bincount(depth)[1:], 2 ** np.arange(8))
    npt.assert_allclose(tree.radius[1:], 5 * 0.707 ** (depth[1:] - 1), rtol=1e-12)
    share = length[2:] / length[tree.parent[2:]]
    cosine = (axis[2:] * axis[tree.parent[2:]]).sum(1) / length[2:] / length[tree.parent[2:]]
    is_long = share > 0.8
    assert is_long.sum() == (~is_long).sum()
    npt.assert_allclose(share[is_long], 0.9, rtol=1e-12)
    npt.assert_allclose(share[~is_long], 0.7, rtol=1e-12)
    npt.assert_allclose(cosine[is_long], math.cos(math.radians(5)), rtol=1e-12)
    npt.assert_allclose(cosine[~is_long], math.cos(math.radians(65)), rtol=1e-12)


def test_koch_curve_has_its_size():
    tree = draw_word(derive_word(parse_grammar("angle = 60\naxiom = F\nF -> F+F--F+F"), iterations=5)).tree
    npt.assert_allclose(tree.position[-1], [0, 0, 3**5], atol=1e-9)
    npt.assert_allclose(np.ptp(tree.position[:, 0]), 3**5 * math.sqrt(3) / 6, rtol=1e-12)


# ---------------------------------------------------------------- the slow, obvious turtle


class SlowTurtle:
    """Rotation matrices about the turtle's own axes; nodes and leaves as tuples in lists."""

    def __init__(self, word):
        self.settings = word.settings
        self.tropism = np.array(word.settings.tropism) / np.linalg.norm(word.settings.tropism)
        self.state = {
            "at": np.zeros(3),
            "h": Z,
            "l": LEFT,
            "w": word.settings.width,
            "bend": 0.0,
            "node": None,
            "loose": False,
        }
        self.nodes, self.leaves, self.stack = [], [], []

    def up(self):
        return np.cross(self.state["h"], self.state["l"])

    def rotate(self, axis, degrees):
        matrix = turned(axis, degrees)
        self.state["h"], self.state["l"] = matrix @ self.state["h"], matrix @ self.state["l"]

    def node(self, parent, i):
        s = self.state
        self.nodes.append((-1 if parent is None else parent, s["at"], s["w"] / 2, len(self.stack), i))
        s["node"], s["loose"] = len(self.nodes) - 1, False

    def obey(self, name, given, i):
        if name in "+-&^/\\|$":
            self.turn(name, given[0] if given else self.settings.angle_deg)
        elif name in "[]":
            self.branch(name, i)
        elif name == "!":
            self.state["w"] = given[0] if given else self.state["w"] * self.settings.taper
        elif name == "~":
            self.state["bend"] = given[0] if given else 0.0
        elif name == "L":
            self.leaf(*(given or [self.settings.leaf]), i=i)
        elif name in "Ff":
            self.go(name, given[0] if given else self.settings.step, i)

    def turn(self, name, angle):
        s = self.state
        if name == "|":
            self.rotate(self.up(), 180)
        elif name == "$":
            left = np.cross(Z, s["h"])
            if np.linalg.norm(left) > 1e-12:
                s["l"] = left / np.linalg.norm(left)
        else:
            axis = self.up() if name in "+-" else s["l"] if name in "&^" else s["h"]
            self.rotate(axis, angle if name in "+&/" else -angle)

    def branch(self, name, i):
        if name == "]":
            self.state = self.stack.pop()
            return
        if self.state["node"] is None and not self.state["loose"]:
            self.node(None, i)
        self.stack.append(dict(self.state))

    def leaf(self, size, kind=0, *, i):
        s = self.state
        if s["node"] is None:
            self.node(None, i)
        self.leaves.append((s["at"], s["h"], self.up(), size, kind, s["node"]))

    def go(self, name, length, i):
        s = self.state
        if name == "F" and (s["node"] is None or s["loose"]):
            self.node(None, i)
        s["at"] = s["at"] + length * s["h"]
        if name == "f":
            s["loose"] = True
            return
        self.node(s["node"], i)
        across = np.cross(s["h"], self.tropism)
        sine = np.linalg.norm(across)
        if s["bend"] and sine > 1e-12:
            between = math.degrees(math.atan2(sine, s["h"] @ self.tropism))
            amount = math.degrees(s["bend"] * sine)
            self.rotate(across / sine, min(max(amount, between - 180), between))


def reference(word):
    """Nodes and leaves of the slow turtle."""
    slow = SlowTurtle(word)
    for i, code in enumerate(word.code):
        slow.obey(word.kinds[code][0], word.number[word.start[i] : word.start[i + 1]].tolist(), i)
    return slow.nodes, slow.leaves


NUMBERS = st.integers(-40, 40).map(lambda k: k * 7.5)
ONE = st.one_of(
    st.sampled_from(
        ["F", "f", "F(2)", "f(0.5)", "F(-0.3)", "!", "!(0.2)", "L", "L(2)", "L(0.1, 3)", "$", "|"]
    ),
    st.sampled_from(["~(0.3)", "~(-0.4)", "~(9)", "~", "A"]),
    st.sampled_from("+-&^/\\"),
    st.tuples(st.sampled_from("+-&^/\\"), NUMBERS).map(lambda p: f"{p[0]}({p[1]})"),
)
AXIOMS = st.recursive(
    st.lists(ONE, max_size=12).map(" ".join),
    lambda inner: st.lists(st.one_of(ONE, inner.map(lambda t: f"[{t}]")), max_size=8).map(" ".join),
    max_leaves=8,
)


@given(AXIOMS, st.sampled_from(["0, 0, -1", "1, 2, 3"]))
@settings(deadline=None, max_examples=200)
def test_matches_the_slow_turtle(axiom, tropism):
    text = f"module A\nangle = 25\nwidth = 0.5\ntropism = {tropism}\niterations = 0\naxiom = {axiom}"
    word = derive_word(parse_grammar(text))
    nodes, leaves = reference(word)
    drawing = draw_word(word)
    tree, got = drawing.tree, drawing.leaves
    if not nodes:
        assert tree.n_nodes == 1
        assert got.n_leaves == 0
        return
    parent, position, radius, order, module = map(np.array, zip(*nodes, strict=True))
    npt.assert_array_equal(tree.parent, parent)
    npt.assert_allclose(tree.position, position, atol=1e-9)
    npt.assert_allclose(tree.radius, radius, rtol=1e-12)
    npt.assert_array_equal(tree.attribute["order"], order)
    npt.assert_array_equal(tree.attribute["module"], module)
    assert got.n_leaves == len(leaves)
    if leaves:
        base, along, normal, size, kind, node = map(np.array, zip(*leaves, strict=True))
        npt.assert_allclose(got.base, base, atol=1e-9)
        npt.assert_allclose(got.along, along, atol=1e-9)
        npt.assert_allclose(got.normal, normal, atol=1e-9)
        npt.assert_array_equal(got.size, size)
        npt.assert_array_equal(got.kind, kind)
        npt.assert_array_equal(got.node, node)


@given(AXIOMS, st.floats(0.01, 100))
@settings(deadline=None)
def test_size_follows_the_step(axiom, scale):
    """Twice the step and twice the width make the same tree twice as large, where lengths are not given."""
    plain = axiom.replace("F(2)", "F").replace("F(-0.3)", "F").replace("f(0.5)", "f").replace("!(0.2)", "!")
    one = draw(plain.replace("A", ""), width=0.5, angle=25).tree
    other = draw(plain.replace("A", ""), width=0.5 * scale, step=scale, angle=25).tree
    npt.assert_array_equal(one.parent, other.parent)
    npt.assert_allclose(other.position, scale * one.position, rtol=1e-9, atol=1e-9 * scale)
    npt.assert_allclose(other.radius, scale * one.radius, rtol=1e-12)
