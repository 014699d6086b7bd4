"""Obstacles: which rays each stops, against brute force, and what they do to the light."""

import math
import pickle

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treegraph import (
    Ball,
    Box,
    HalfSpace,
    InputError,
    Occluders,
    TriangleMesh,
    gather_light,
    gather_light_exact,
    make_wall,
)

HERE = np.zeros((1, 3))
OBSTACLE_ERROR = 0.012
seeds = st.integers(0, 2**32 - 1)
both = pytest.mark.parametrize("gather", [gather_light, gather_light_exact])

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) / 2
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))])


def directions(rng, n=200):
    w = rng.normal(size=(n, 3))
    w[:, 2] = np.abs(w[:, 2])
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def rotation(rng):
    return np.linalg.qr(rng.normal(size=(3, 3)))[0]


def box_mesh(box):
    return box.center + (CORNERS * box.size) @ box.rotation.T, TRIANGLES


def march(point, direction, inside, far=40.0, steps=40_000):
    """Slow and obvious: walk along the ray."""
    t = np.linspace(0.0, far, steps)[:, None]
    return bool(inside(point + t * direction).any())


def triangles_hit(point, direction, vertices, faces):
    """Brute force: for every ray and triangle, solve for where they meet."""
    hit = np.zeros(len(direction), bool)
    for a, b, c in vertices[faces]:
        for i, w in enumerate(direction):
            u, v, t = np.linalg.solve(np.column_stack([b - a, c - a, -w]), point - a)
            hit[i] |= u >= 0 and v >= 0 and u + v <= 1 and t > 0
    return hit


class TestRays:
    @settings(deadline=None, max_examples=30)
    @given(seed=seeds)
    def test_box_is_its_twelve_triangles(self, seed):
        rng = np.random.default_rng(seed)
        box = Box(rng.normal(size=3) * 3, rng.uniform(0.2, 3, 3), rotation(rng))
        w = directions(rng, 60)
        npt.assert_array_equal(box.blocks(HERE[0], w), triangles_hit(HERE[0], w, *box_mesh(box)))

    @settings(deadline=None, max_examples=15)
    @given(seed=seeds)
    def test_ball_and_half_space_by_walking(self, seed):
        rng = np.random.default_rng(seed)
        ball = Ball(rng.normal(size=3) * 3, rng.uniform(0.2, 2))
        plane = HalfSpace(rng.normal(size=3), rng.normal(size=3))
        for w in directions(rng, 10):
            to = ball.center @ w
            gap = math.sqrt(ball.center @ ball.center - to * to) - ball.radius
            if abs(gap) > 0.01:
                walked = march(HERE[0], w, lambda p, b=ball: np.linalg.norm(p - b.center, axis=1) <= b.radius)
                assert ball.blocks(HERE[0], w[None])[0] == walked
            if abs(w @ plane.normal) > 0.1 and abs(plane.point @ plane.normal) < 3:
                walked = march(HERE[0], w, lambda p, s=plane: (p - s.point) @ s.normal <= 0)
                assert plane.blocks(HERE[0], w[None])[0] == walked

    @settings(deadline=None, max_examples=10)
    @given(seed=seeds)
    def test_mesh(self, seed):
        rng = np.random.default_rng(seed)
        vertices, faces = rng.normal(size=(12, 3)) * 3, rng.integers(0, 12, (8, 3))
        faces = faces[[len(set(f)) == 3 for f in faces.tolist()]]
        if not len(faces):
            return
        w = directions(rng, 60)
        hit = TriangleMesh(vertices, faces).blocks(HERE[0], w)
        assert (
            hit != triangles_hit(HERE[0], w, vertices, faces)
        ).mean() <= 0.02  # single precision at the edges

    def test_ray_along_a_side(self):
        box = Box((3, 0, 0), (1, 1, 1))
        assert box.blocks(HERE[0], np.array([[1.0, 0, 0]]))[0]
        assert not box.blocks(HERE[0], np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])).any()


class TestLight:
    @both
    def test_half_space_takes_half(self, gather):
        for normal in ((1, 0, 0), (0, -1, 0)):
            light = gather(HERE, Occluders(obstacles=[HalfSpace(np.multiply(normal, -2), normal)]))
            npt.assert_allclose(light.amount, 0.5, atol=1e-6)
            assert light.direction[0] @ normal > 0.4  # the light comes from the open side

    @both
    def test_half_space_below_and_around(self, gather):
        ground = HalfSpace((0, 0, -1), (0, 0, 1))
        npt.assert_allclose(gather(HERE, Occluders(obstacles=[ground])).amount, 1.0, atol=2e-6)
        assert gather([[0, 0, -2]], Occluders(obstacles=[ground])).amount[0] == 0.0

    @both
    def test_endless_wall_in_closed_form(self, gather):
        """A wall whose top stands at the angle e above the horizon leaves the half sky on the other side and
        the slice from e to the zenith: 1/2 + (b + sin(2 b) / 2) / pi with b = pi/2 - e."""
        wall = make_wall((2, 0, 0), (-1, 0, 0), width=4000, height=3)
        e = math.atan2(3, 2)
        share = 0.5 + ((math.pi / 2 - e) + math.sin(2 * (math.pi / 2 - e)) / 2) / math.pi
        npt.assert_allclose(gather(HERE, Occluders(obstacles=[wall])).amount, share, atol=0.008)

    @both
    @pytest.mark.parametrize(
        "solid", [Ball((0, 0, 0), 1.0), Box((0, 0, 0), (1, 1, 1)), TriangleMesh(CORNERS, TRIANGLES)], ids=type
    )
    def test_inside_is_dark(self, gather, solid):
        assert gather([[0.1, 0.2, 0.05]], Occluders(obstacles=[solid])).amount[0] == 0.0

    @both
    def test_translucency(self, gather):
        clear, dark = (
            [Ball((0, 1, 4), 2, t), Box((3, 0, 1), (1, 2, 3), None, t), HalfSpace((0, 5, 0), (0, -1, -1), t)]
            for t in (1.0, 0.0)
        )
        assert gather(HERE, Occluders(obstacles=clear)).amount[0] == pytest.approx(1.0, abs=2e-6)
        for kind, glass in zip(dark, clear, strict=True):
            none = gather(HERE, Occluders(obstacles=[kind])).amount[0]
            half = type(glass)(
                **{**{k: getattr(glass, k) for k in glass.__dataclass_fields__}, "translucency": 0.5}
            )
            npt.assert_allclose(gather(HERE, Occluders(obstacles=[half])).amount, (1 + none) / 2, atol=1e-6)

    @both
    def test_two_boxes_side_by_side_are_one(self, gather):
        one = gather(HERE, Occluders(obstacles=[Box((0, 0, 3), (2, 2, 1))])).amount
        two = gather(HERE, Occluders(obstacles=[Box((x, 0, 3), (1, 2, 1)) for x in (-0.5, 0.5)])).amount
        npt.assert_allclose(two, one, atol=1e-6)

    @settings(deadline=None, max_examples=25)
    @given(seed=seeds)
    def test_fast_against_exact(self, seed):
        rng = np.random.default_rng(seed)
        box = Box(rng.normal(size=3) * 3, rng.uniform(0.2, 4, 3), rotation(rng))
        vertices, faces = box_mesh(box)
        for thing in (
            box,
            Ball(rng.normal(size=3) * 3, rng.uniform(0.1, 3)),
            HalfSpace(rng.normal(size=3), rng.normal(size=3)),
            TriangleMesh(vertices, faces),
        ):
            scene = Occluders(obstacles=[thing])
            error = gather_light(HERE, scene).amount - gather_light_exact(HERE, scene).amount
            assert abs(error[0]) <= OBSTACLE_ERROR, type(thing)

    def test_mesh_in_chunks(self, monkeypatch):
        from treegraph import light

        points = np.random.default_rng(2).normal(size=(9, 3))
        scene = Occluders(obstacles=[TriangleMesh(CORNERS + (0, 0, 2), TRIANGLES, 0.3)])
        whole = gather_light(points, scene).amount
        monkeypatch.setattr(light, "CHUNK_RAYS", 2048)
        npt.assert_array_equal(gather_light(points, scene).amount, whole)

    def test_mesh_far_from_the_origin_and_pickled_after_use(self):
        far = np.array([4e5, 5e6, 300.0])
        mesh = TriangleMesh(CORNERS + far, TRIANGLES)
        near = gather_light(HERE - (0, 0, 2), Occluders(obstacles=[TriangleMesh(CORNERS, TRIANGLES)])).amount
        npt.assert_allclose(
            gather_light([far - (0, 0, 2)], Occluders(obstacles=[mesh])).amount, near, atol=1e-3
        )
        again = pickle.loads(pickle.dumps(mesh))
        npt.assert_allclose(
            gather_light([far - (0, 0, 2)], Occluders(obstacles=[again])).amount, near, atol=1e-3
        )


class TestWall:
    def test_where_it_stands(self):
        wall = make_wall((1.5, 0, 0), (-2, 0, 0), width=40, height=6, thickness=0.4)
        corners = box_mesh(wall)[0]
        npt.assert_allclose(corners.min(axis=0), (1.5, -20, 0), atol=1e-12)
        npt.assert_allclose(corners.max(axis=0), (1.9, 20, 6), atol=1e-12)


@pytest.mark.parametrize(
    "make, match",
    [
        (lambda: HalfSpace((0, 0, 0), (0, 0, 0)), "normal must be a direction, got the zero vector"),
        (lambda: HalfSpace((0, 0), (0, 0, 1)), r"point must have shape \(3,\), got \(2,\)"),
        (lambda: Ball((0, 0, 0), 0.0), "radius must be a positive finite number of metres, got 0.0"),
        (lambda: Ball((0, 0, 0), math.nan), "radius must be a positive finite number of metres, got nan"),
        (
            lambda: Ball((0, 0, 0), 1.0, 2.0),
            r"translucency must be from 0 \(opaque\) to 1 \(clear\), got 2.0",
        ),
        (lambda: Box((0, 0, 0), (1, 0, 1)), "size must be three positive lengths in metres"),
        (lambda: Box((0, 0, 0), (1, 1, 1), 2 * np.eye(3)), "rotation must be orthonormal"),
        (
            lambda: TriangleMesh(np.zeros((3, 3)), [[0, 1, 3]]),
            r"faces must be rows of vertices \(0 to 2\), but faces\[0\]",
        ),
        (lambda: TriangleMesh(np.zeros((3, 3)), [[0.0, 1, 2]]), "faces must be integers of shape"),
        (lambda: TriangleMesh(np.zeros((3, 3)), np.empty((0, 3), int)), "faces must be integers of shape"),
        (
            lambda: make_wall((0, 0, 0), (1, 0, 1), width=1, height=1),
            "normal must be horizontal for an upright wall",
        ),
        (lambda: make_wall((0, 0, 0), (1, 0, 0), width=-1, height=1), "size must be three positive lengths"),
    ],
)
def test_errors(make, match):
    with pytest.raises(InputError, match=match):
        make()
