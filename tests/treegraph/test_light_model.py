"""Light among leaves, branches and obstacles: known values, invariants, fast against exact."""

import math

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.corpus import along
from treegraph import (
    Ball,
    Box,
    Branches,
    HalfSpace,
    InputError,
    Leaves,
    Occluders,
    Sky,
    TreeGraph,
    allometric_radii,
    branches_of,
    gather_light,
    gather_light_exact,
    join_occluders,
    make_leaves,
    make_wall,
)
from treegraph.light import AMOUNT_ERROR, VECTOR_ERROR

HERE = np.zeros((1, 3))
OPEN = Occluders()
COARSE = (48, 96)
SINGLE_ERROR = 0.012  # fast against exact: one occluder, or only a few

both = pytest.mark.parametrize("gather", [gather_light, gather_light_exact])
seeds = st.integers(0, 2**32 - 1)


def opaque(center, radius):
    center = np.atleast_2d(np.asarray(center, float))
    return Leaves(center, np.broadcast_to(float(radius), len(center)), np.zeros(len(center)))


def turned(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def around(rng, n, low=-1.0):
    return rng.uniform([-5, -5, low], [5, 5, 10], (n, 3))


def random_tree(rng, levels=5):
    """Forks of two, allometric radii: about 3 * 2^levels nodes, 5 m high."""
    parent, position, tips = [-1], [np.zeros(3)], [(0, np.array([0.0, 0.0, 1.0]), 1.6)]
    for _ in range(levels):
        grown = []
        for last, heading, length in tips:
            for _ in range(3):
                step = heading + rng.normal(size=3) * 0.12
                parent.append(last)
                position.append(position[last] + step / np.linalg.norm(step) * length / 3)
                last = len(parent) - 1
            for _ in range(2):
                side = heading + rng.normal(size=3) * 0.55
                grown.append((last, side / np.linalg.norm(side), length * 0.75))
        tips = grown
    tree = TreeGraph(parent, position, np.ones(len(parent)))
    return tree.replace(radius=np.maximum(allometric_radii(tree, 0.3, 1.5), 0.002))


def leafy(rng):
    tree = random_tree(rng)
    tip = np.setdiff1d(np.arange(tree.n_nodes), tree.parent)
    return Occluders(make_leaves(tree.position[tip], rng.uniform(0.15, 0.4, len(tip))), branches_of(tree))


def random_scene(rng):
    """Leaves, a tree with its wood, obstacles of every analytic kind, in random numbers."""
    n = int(rng.integers(0, 120))
    leaves = make_leaves(around(rng, n), rng.uniform(0.05, 1.5, n), unit_translucency=rng.uniform(0.05, 0.9))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    things = [
        Box(around(rng, 1)[0], rng.uniform(0.1, 4.0, 3), turn, translucency=rng.uniform(0, 0.5)),
        Ball(around(rng, 1)[0], rng.uniform(0.1, 3.0)),
        HalfSpace(around(rng, 1)[0] + (0, 0, 8), rng.normal(size=3), translucency=rng.uniform(0, 1)),
        make_wall(
            (rng.uniform(0.5, 4), 0, 0), (-1, 0, 0), width=rng.uniform(1, 30), height=rng.uniform(1, 8)
        ),
    ]
    chosen = [thing for thing in things if rng.random() < 0.4]
    parts = [Occluders(leaves, obstacles=chosen)]
    if rng.random() < 0.6:
        parts.append(leafy(rng))
    return join_occluders(*parts)


def random_sky(rng):
    return Sky.from_angles(rng.uniform(0.2, math.pi / 2), rng.uniform(0, 7))


class TestOpenSky:
    @both
    @pytest.mark.parametrize("sky", [Sky(), Sky((1, 0, 1)), Sky((0, -2, 0.1)), Sky((1, 0, 0))])
    def test_amount_is_one(self, gather, sky):
        light = gather([[0, 0, 0], [7, -3, 2]], OPEN, sky)
        npt.assert_allclose(light.amount, 1.0, atol=2e-6)
        assert (np.linalg.norm(light.vector, axis=1) < 1.0).all()

    @both
    def test_direction_is_the_zenith(self, gather):
        npt.assert_allclose(gather(HERE, OPEN).direction, [[0, 0, 1]], atol=1e-12)
        # integral of cos^3 over that of cos^2: (2 pi / 4) / (2 pi / 3)
        npt.assert_allclose(gather(HERE, OPEN).vector, [[0, 0, 0.75]], atol=2e-4)

    @both
    @pytest.mark.parametrize("tilt", [0.0, 0.3, 0.8, 1.2, math.pi / 2])
    def test_tilted_sky_in_closed_form(self, gather, tilt):
        """With d the tilt, in the plane of the zenith and the brightest point s, the integral of
        max(0, cos)^2 w is (3 pi / 8) ((2/3 + cos d - cos^3 d / 3) s + (sin^3 d / 3) s'), s' across s on the
        zenith's side, and that without w is (2/3) (pi - d + sin(2 d) / 2)."""
        light = gather(HERE, OPEN, Sky.from_angles(math.pi / 2 - tilt, math.pi / 2))
        c, s = math.cos(tilt), math.sin(tilt)
        along = 2 / 3 + c - c**3 / 3
        across = s**3 / 3
        whole = 2 / 3 * (math.pi - tilt + math.sin(2 * tilt) / 2)
        vector = 3 * math.pi / 8 / whole * (along * np.array([s, 0, c]) + across * np.array([-c, 0, s]))
        npt.assert_allclose(light.vector[0], vector, atol=5e-4)

    @both
    def test_no_points(self, gather):
        light = gather(np.empty((0, 3)), Occluders(opaque((0, 0, 3), 1), obstacles=[Ball((0, 0, 9), 1)]))
        assert light.amount.shape == (0,)
        assert light.direction.shape == (0, 3)


class TestSky:
    def test_latitude(self):
        npt.assert_allclose(Sky.at_latitude(0.0).brightest, (0, 0, 1), atol=1e-15)
        npt.assert_allclose(
            Sky.at_latitude(math.radians(30)).brightest, (0, -0.5, math.sqrt(0.75)), atol=1e-15
        )
        npt.assert_allclose(
            Sky.at_latitude(math.radians(-30)).brightest, (0, 0.5, math.sqrt(0.75)), atol=1e-15
        )
        # true north to the east of +y: the south is to the west of -y
        npt.assert_allclose(
            Sky.at_latitude(math.pi / 6, north=math.pi / 2).brightest, (-0.5, 0, 0.75**0.5), atol=1e-15
        )

    def test_side(self):
        npt.assert_allclose(Sky.from_angles(0.0, math.pi / 2).brightest, (1, 0, 0), atol=1e-15)
        npt.assert_allclose(Sky((0, 0, 4)).brightest, (0, 0, 1))

    @both
    def test_a_wall_on_the_sun_side_takes_more(self, gather):
        wall = Occluders(obstacles=[make_wall((0, -2, 0), (0, 1, 0), width=20, height=5)])
        north, south = (
            gather(HERE, wall, Sky.at_latitude(a)).amount[0] for a in (math.radians(45), -math.radians(45))
        )
        assert south > 0.9 > 0.5 > north

    @pytest.mark.parametrize(
        "make, match",
        [
            (
                lambda: Sky((0, 0, -1)),
                r"brightest must not point below the horizon \(z >= 0\), got \(0, 0, -1\)",
            ),
            (lambda: Sky((0, 0, 0)), "brightest must be a direction, got the zero vector"),
            (lambda: Sky((0, 1)), r"brightest must have shape \(3,\), got \(2,\)"),
            (lambda: Sky.from_angles(2.0, 0.0), "elevation must be from 0 to pi/2 radians, got 2.0"),
            (lambda: Sky.from_angles(math.nan, 0.0), "elevation must be from 0 to pi/2 radians, got nan"),
            (lambda: Sky.from_angles(1.0, math.inf), "bearing must be a finite angle in radians, got inf"),
            (lambda: Sky.at_latitude(-1.6), "latitude must be from -pi/2 to pi/2 radians, got -1.6"),
        ],
    )
    def test_errors(self, make, match):
        with pytest.raises(InputError, match=match):
            make()


class TestLeaves:
    def test_translucency(self):
        leaves = make_leaves(np.zeros((3, 3)), [1.0, 2.0, 0.5], density=[1.0, 1.0, 2.0])
        npt.assert_allclose(leaves.translucency, [0.5, 0.25, 0.5])  # Eq. 4.4, and Eq. 4.14 for the third
        npt.assert_allclose(make_leaves([[0, 0, 0]], [3.0], unit_translucency=0.2).translucency, [0.008])

    @both
    @pytest.mark.parametrize("sine", [0.02, 0.1, 0.3, 0.6, 0.95, 0.9999])
    def test_opaque_sphere_in_the_zenith(self, gather, sine):
        """It hides 1 - cos^3(alpha) of a cos^2 sky: its integral from 0 to alpha over that from 0 to pi/2."""
        light = gather(HERE, Occluders(opaque((0, 0, 10), 10 * sine)))
        cosine = math.sqrt(1 - sine**2)
        npt.assert_allclose(light.amount, cosine**3, atol=AMOUNT_ERROR)
        npt.assert_allclose(light.vector, [[0, 0, 0.75 * cosine**4]], atol=VECTOR_ERROR)

    @both
    def test_sphere_anywhere_above_the_horizon(self, gather):
        """The integral of cos^2 over a cap: solid angle moments A + B (axis . zenith)^2."""
        c = math.cos(0.4)
        a, b = math.pi * (2 / 3 - c + c**3 / 3), math.pi * (c - c**3)
        for elevation in (0.45, 0.8, 1.2):
            center = 10 * np.array(
                [math.cos(elevation) * 0.6, math.cos(elevation) * 0.8, math.sin(elevation)]
            )
            hidden = (a + b * math.sin(elevation) ** 2) / (2 * math.pi / 3)
            light = gather(HERE, Occluders(opaque(center, 10 * math.sin(0.4))))
            npt.assert_allclose(1 - light.amount, hidden, atol=0.004)

    @both
    def test_translucency_multiplies(self, gather):
        one = gather(HERE, Occluders(Leaves([[0, 0, 10]], [4.0], [0.5]))).amount
        two = gather(HERE, Occluders(Leaves([[0, 0, 10]] * 2, [4.0] * 2, [0.5, 0.4]))).amount
        none = gather(HERE, Occluders(Leaves([[0, 0, 10]], [4.0], [0.0]))).amount
        npt.assert_allclose(1 - one, 0.5 * (1 - none), rtol=1e-5)
        npt.assert_allclose(
            1 - two, 0.8 * (1 - none), rtol=0.07
        )  # the blurred edge counts twice in the fast one

    @both
    def test_below_the_horizon_hides_nothing(self, gather):
        npt.assert_allclose(gather(HERE, Occluders(opaque((0, 3, -4), 2.5))).amount, 1.0, atol=2e-6)

    @both
    def test_a_cluster_around_the_point_dims_once_and_its_own_not(self, gather):
        leaves = Leaves([[0, 0, 0.3], [0, 0, -0.2]], [1.0, 1.0], [0.5, 0.8])
        points = np.zeros((4, 3))
        light = gather(points, Occluders(leaves), own=[-1, 0, 1, -1])
        npt.assert_allclose(light.amount, [0.4, 0.8, 0.5, 0.4], atol=2e-6)

    @both
    def test_own_cluster_outside_it(self, gather):
        leaves = opaque([(0, 0, 5), (0, 0, 5)], 2)
        npt.assert_allclose(gather(HERE, Occluders(opaque((0, 0, 5), 2)), own=[0]).amount, 1.0, atol=2e-6)
        shaded = gather(HERE, Occluders(opaque((0, 0, 5), 2))).amount
        npt.assert_allclose(gather(HERE, Occluders(leaves), own=[1]).amount, shaded, atol=1e-6)

    def test_own_across_blocks(self):
        """Rows beyond the first block of the compiled loop."""
        rng = np.random.default_rng(0)
        center = around(rng, 200, 1.0)
        leaves = make_leaves(center, rng.uniform(0.3, 1.0, 200))
        for row in (0, 63, 64, 127, 199):
            rest = np.delete(np.arange(200), row)
            without = Leaves(center[rest], leaves.radius[rest], leaves.translucency[rest])
            with_own = gather_light(HERE, Occluders(leaves), own=[row]).amount
            npt.assert_allclose(with_own, gather_light(HERE, Occluders(without)).amount, rtol=1e-4)

    @both
    def test_dark_where_everything_is_hidden(self, gather):
        light = gather(HERE, Occluders(opaque((0, 0, 0), 1)))
        assert light.amount[0] == 0.0
        assert np.isnan(light.direction).all()

    @pytest.mark.parametrize(
        "make, match",
        [
            (
                lambda: make_leaves([[0, 0, 0]], [0.0]),
                r"radius must be positive, in metres, but radius\[0\] is 0.0",
            ),
            (lambda: make_leaves([[0, 0, 0]], [1.0, 2.0]), r"radius must have shape \(1,\), got \(2,\)"),
            (
                lambda: make_leaves([[0, 0, 0]], [1.0], unit_translucency=0),
                "unit_translucency must be above 0",
            ),
            (
                lambda: make_leaves([[0, 0, 0]], [1.0], density=-1),
                r"density must be 0 or more, but density\[0\]",
            ),
            (lambda: make_leaves([[0, 0, math.nan]], [1.0]), r"center must be finite, but center\[0\] is"),
            (
                lambda: Leaves(np.zeros((2, 3)), [1, 1], [0.5, 1.5]),
                r"translucency must be from 0 to 1, but translucency\[1\]",
            ),
            (
                lambda: Leaves(np.zeros((2, 2)), [1, 1], [0, 0]),
                r"center must have shape \(n, 3\), got \(2, 2\)",
            ),
        ],
    )
    def test_errors(self, make, match):
        with pytest.raises(InputError, match=match):
            make()


class TestBranches:
    @both
    @pytest.mark.parametrize("radius", [0.01, 0.1, 0.5])
    def test_long_pole_overhead(self, gather, radius):
        """An endless pole of angular half width a across the zenith hides a slice between two planes: the
        cosine is the sine of the angle to the axis times the cosine of that across it; sin^3 integrates to
        4/3 and cos^2 over the slice to a + sin(2 a) / 2."""
        pole = Branches([[-4000, 0, 5.0]], [[4000, 0, 5.0]], [radius], [radius])
        a = math.asin(radius / 5)
        hidden = 4 / 3 * (a + math.sin(2 * a) / 2) / (2 * math.pi / 3)
        npt.assert_allclose(1 - gather(HERE, Occluders(branches=pole)).amount, hidden, atol=0.012)

    @both
    def test_seen_end_on_it_is_a_sphere(self, gather):
        pole = Branches([[0, 0, 5.0]], [[0, 0, 20.0]], [1.0], [1.0])
        ball = gather(HERE, Occluders(opaque((0, 0, 5), 1))).amount
        npt.assert_allclose(gather(HERE, Occluders(branches=pole)).amount, ball, atol=0.015)

    @both
    def test_no_length_is_a_sphere(self, gather):
        pole = Branches([[1, 2, 4.0]], [[1, 2, 4.0]], [0.7], [0.7])
        ball = gather(HERE, Occluders(opaque((1, 2, 4), 0.7))).amount
        npt.assert_allclose(gather(HERE, Occluders(branches=pole)).amount, ball, atol=0.004)

    @both
    def test_no_width_hides_nothing(self, gather):
        twig = Branches([[0, 0, 5.0]], [[1, 0, 5.0]], [0.0], [0.0])
        npt.assert_allclose(gather(HERE, Occluders(branches=twig)).amount, 1.0, atol=2e-6)

    @both
    def test_the_branch_around_the_point_does_not_shade_it(self, gather):
        trunk = branches_of(along([(0, 0, -1), (0, 0, 0), (0, 0, 1)], 0.2))
        npt.assert_allclose(gather(HERE, Occluders(branches=trunk)).amount, 1.0, atol=2e-6)
        assert gather([[0.3, 0, 0]], Occluders(branches=trunk)).amount[0] < 0.99

    @both
    def test_behind_the_point(self, gather):
        pole = Branches([[0, 0, -3.0]], [[1, 1, -0.5]], [0.2], [0.1])
        npt.assert_allclose(gather(HERE, Occluders(branches=pole)).amount, 1.0, atol=2e-6)

    def test_cutting_a_pole_into_pieces_changes_nothing(self):
        """Joints neither count twice nor let light through."""
        for radius in (0.01, 0.1, 0.3, 1.0):
            whole = branches_of(along([(-3, 1, 4), (3, 0, 5)], radius))
            pieces = branches_of(along(np.linspace((-3, 1, 4), (3, 0, 5), 41), radius))
            a, b = (gather_light(HERE, Occluders(branches=part)).amount for part in (whole, pieces))
            npt.assert_allclose(1 - a, 1 - b, atol=0.002 + 0.05 * (1 - a[0]))

    def test_of_a_tree(self):
        tree = TreeGraph(
            [-1, 0, 1, 1, 2],
            [(0, 0, 0), (0, 0, 1), (0, 0, 2), (1, 0, 1), (0, 0, 3)],
            [0.3, 0.25, 0.2, 0.05, 0.1],
        )
        pieces = branches_of(tree)
        npt.assert_array_equal(pieces.start, tree.position[[0, 1, 2, 1]])
        npt.assert_array_equal(pieces.end, tree.position[[1, 2, 4, 3]])
        npt.assert_array_equal(
            pieces.start_radius, [0.3, 0.25, 0.2, 0.05]
        )  # a side branch begins with its own
        npt.assert_array_equal(pieces.end_radius, [0.25, 0.2, 0.1, 0.05])
        npt.assert_array_equal(pieces.joined, [[0, 1], [1, 1], [1, 0], [1, 0]])

    def test_of_one_node(self):
        assert len(branches_of(along([(0, 0, 0)])).start) == 0

    @pytest.mark.parametrize(
        "make, match",
        [
            (
                lambda: branches_of(along([(0, 0, 0), (0, 0, 1)], math.nan)),
                "radius must be known to cast a shadow",
            ),
            (
                lambda: Branches([[0, 0, 0]], [[0, 0, 1]], [-1], [1]),
                r"start_radius must be 0 or more, in metres",
            ),
            (
                lambda: Branches([[0, 0, 0]], np.zeros((2, 3)), [1], [1]),
                r"end must have shape \(1, 3\), got \(2, 3\)",
            ),
            (lambda: Branches([[0, 0, 0]], [[0, 0, 1]], [1], [1], [[1, 0]]), "joined must be bool of shape"),
        ],
    )
    def test_errors(self, make, match):
        with pytest.raises(InputError, match=match):
            make()


class TestInvariants:
    @both
    @settings(deadline=None, max_examples=10)
    @given(seed=seeds)
    def test_more_never_lets_more_through(self, gather, seed):
        rng = np.random.default_rng(seed)
        points, scene, more = around(rng, 3), random_scene(rng), random_scene(rng)
        options = {} if gather is gather_light else {"order": COARSE}
        one = gather(points, scene, **options).amount
        two = gather(points, join_occluders(scene, more), **options).amount
        assert (two <= one + 1e-6).all()
        assert ((one >= 0.0) & (one <= 1.0 + 2e-6)).all()

    @settings(deadline=None, max_examples=15)
    @given(seed=seeds, angle=st.floats(0, 7))
    def test_turning_everything_about_the_vertical(self, seed, angle):
        """A quarter turn changes nothing but rounding in the fast model; any other, less than its error."""
        rng = np.random.default_rng(seed)
        center, radius, points, elevation = (
            around(rng, 30),
            rng.uniform(0.1, 1, 30),
            around(rng, 4),
            rng.uniform(0, 1.5),
        )
        light = gather_light(points, Occluders(make_leaves(center, radius)), Sky.from_angles(elevation, 0.3))
        for turn, tolerance in ((math.pi / 2, 2e-5), (angle, AMOUNT_ERROR)):
            spun = turned(turn)
            scene = Occluders(make_leaves(center @ spun.T, radius))
            other = gather_light(points @ spun.T, scene, Sky.from_angles(elevation, 0.3 - turn))
            npt.assert_allclose(other.amount, light.amount, atol=tolerance)
            npt.assert_allclose(other.vector, light.vector @ spun.T, atol=tolerance)

    def test_moved_and_scaled(self):
        rng = np.random.default_rng(3)
        center, radius, points = around(rng, 40), rng.uniform(0.1, 1, 40), around(rng, 5)
        share = np.full(40, 0.6)
        light = gather_light(points, Occluders(Leaves(center, radius, share)))
        moved = gather_light(
            3 * points + (50, 60, 7), Occluders(Leaves(3 * center + (50, 60, 7), 3 * radius, share))
        )
        npt.assert_allclose(moved.amount, light.amount, atol=2e-5)

    def test_same_bytes_however_the_points_are_divided(self):
        rng = np.random.default_rng(4)
        scene, points = random_scene(rng), around(rng, 20)
        whole = gather_light(points, scene)
        parts = [gather_light(points[i : i + 7], scene) for i in (0, 7, 14)]
        assert whole.amount.tobytes() == b"".join(p.amount.tobytes() for p in parts)
        assert whole.vector.tobytes() == b"".join(p.vector.tobytes() for p in parts)

    def test_deep_shade_is_zero_not_slow(self):
        """Thousands of clusters: no denormal numbers remain."""
        leaves = Leaves(np.tile([0, 0, 5.0], (3000, 1)), np.full(3000, 2.0), np.full(3000, 0.9))
        alone = gather_light(HERE, Occluders(opaque((0, 0, 5), 2)))
        assert 0.0 < gather_light(HERE, Occluders(leaves)).amount[0] < alone.amount[0]

    def test_inputs_are_not_changed_and_are_read_only(self):
        center = np.array([[0.0, 0, 3]])
        leaves = make_leaves(center, [1.0])
        center[0, 2] = 9.0
        assert leaves.center[0, 2] == 3.0
        with pytest.raises(ValueError, match="read-only"):
            leaves.radius[0] = 2.0

    def test_joining_nothing(self):
        assert len(join_occluders().leaves.radius) == 0


class TestFastAgainstExact:
    """The bounds that docs/light.md states."""

    @settings(deadline=None, max_examples=40)
    @given(seed=seeds)
    @example(seed=0)
    def test_random_scenes(self, seed):
        rng = np.random.default_rng(seed)
        points, scene, sky = around(rng, 2, 0.0), random_scene(rng), random_sky(rng)
        fast, exact = gather_light(points, scene, sky), gather_light_exact(points, scene, sky)
        assert np.abs(fast.amount - exact.amount).max() <= AMOUNT_ERROR
        assert np.linalg.norm(fast.vector - exact.vector, axis=1).max() <= VECTOR_ERROR

    @settings(deadline=None, max_examples=30)
    @given(seed=seeds)
    def test_one_opaque_sphere(self, seed):
        rng = np.random.default_rng(seed)
        scene, sky = Occluders(opaque(around(rng, 1), rng.uniform(0.05, 4))), random_sky(rng)
        error = gather_light(HERE, scene, sky).amount - gather_light_exact(HERE, scene, sky).amount
        assert abs(error[0]) <= SINGLE_ERROR

    @settings(deadline=None, max_examples=30)
    @given(seed=seeds)
    def test_few_branches(self, seed):
        rng = np.random.default_rng(seed)
        start = around(rng, 3)
        end = start + rng.normal(size=(3, 3)) * rng.uniform(0.1, 3)
        radius = np.minimum(rng.uniform(0.0, 0.3, (2, 3)), 0.3 * np.linalg.norm(end - start, axis=1))
        scene, sky = Occluders(branches=Branches(start, end, *radius)), random_sky(rng)
        error = gather_light(HERE, scene, sky).amount - gather_light_exact(HERE, scene, sky).amount
        assert abs(error[0]) <= AMOUNT_ERROR

    def test_finer_is_closer(self):
        rng = np.random.default_rng(8)
        scenes = [(around(rng, 4, 0.0), random_scene(rng)) for _ in range(6)]
        exact = [gather_light_exact(points, scene).amount for points, scene in scenes]
        errors = []
        for rings in (4, 10, 25):
            gap = [
                gather_light(p, s, rings=rings).amount - e for (p, s), e in zip(scenes, exact, strict=True)
            ]
            errors.append(np.sqrt(np.mean(np.square(gap))))
        assert errors[0] > 1.5 * errors[1] > 2.0 * errors[2]

    def test_more_nodes_change_the_exact_one_little(self):
        rng = np.random.default_rng(9)
        points, scene = around(rng, 3, 0.0), random_scene(rng)
        a, b = (gather_light_exact(points, scene, order=order).amount for order in ((96, 192), (150, 310)))
        npt.assert_allclose(a, b, atol=0.003)


@pytest.mark.parametrize(
    "call, match",
    [
        (lambda: gather_light(np.zeros(3), OPEN), r"points must have shape \(n, 3\), got \(3,\)"),
        (lambda: gather_light([[0, 0, math.inf]], OPEN), r"points must be finite, but points\[0\] is"),
        (lambda: gather_light(HERE, OPEN, rings=3), "rings must be a whole number from 4 to 64, got 3"),
        (lambda: gather_light(HERE, OPEN, rings=10.0), "rings must be a whole number from 4 to 64, got 10.0"),
        (
            lambda: gather_light(HERE, OPEN, own=[0]),
            r"own must be -1 or a row of leaves .*, but own\[0\] is 0",
        ),
        (lambda: gather_light(HERE, OPEN, own=[0.0]), r"own must be integers of shape \(1,\), got float64"),
        (
            lambda: gather_light_exact(HERE, OPEN, order=(1, 8)),
            "order must be two numbers of nodes, each 2 or more",
        ),
        (lambda: Occluders(obstacles=[3]), r"obstacles must be HalfSpace, .*, but obstacles\[0\] is a int"),
    ],
)
def test_errors(call, match):
    with pytest.raises(InputError, match=match):
        call()
