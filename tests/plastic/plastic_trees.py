"""What the tests of plastic trees share: grown and hand-made trees, scenes by chance."""

from functools import cache

import numpy as np

from plastic import Scene, analyse
from species import find_preset, gather_clusters, grow, place_leaves
from treegraph import DEFAULT_ALLOMETRY, Ball, Box, Cluster, ClusterTree, HalfSpace, Sky, TreeGraph, make_wall

WALL = HalfSpace((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
"""Solid beyond x = 1 m."""


@cache
def grown_tree(age=9, kind="F6b", seed=3):
    """A grown tree with its leaves in clusters; about 170 nodes."""
    tree = grow(find_preset(kind).parameters, age, rng=np.random.default_rng(seed)).tree
    leaves = place_leaves(tree, rng=np.random.default_rng(seed))
    return ClusterTree(tree, gather_clusters(tree, leaves), None, DEFAULT_ALLOMETRY, np.zeros(3))


@cache
def grown_state(age=9, kind="F6b", seed=3):
    return analyse(grown_tree(age, kind, seed))


def ball_cluster(center, radius, seed):
    """A cluster whose hull is an octahedron of a ball's volume."""
    reach = radius * np.pi ** (1 / 3)  # 4/3 reach^3 = 4/3 pi radius^3
    corners = np.concatenate([np.eye(3), -np.eye(3)]) * reach + np.asarray(center, float)
    faces = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]
    return Cluster(corners, faces, np.atleast_1d(seed), density=100.0, n_points=50)


def mirrored_tree():
    """A trunk with pairs of branches to both sides of the plane x = 0; clusters at all tips."""
    parent, position, radius = [-1], [(0.0, 0.0, 0.0)], [0.2]
    clusters, trunk = [], 0
    for k in range(1, 7):
        parent.append(trunk)
        position.append((0.0, 0.0, float(k)))
        radius.append(0.2 - 0.02 * k)
        trunk = len(parent) - 1
        for side in (-1.0, 1.0):
            at = trunk
            for step in range(1, 8 - k):
                parent.append(at)
                position.append((side * 0.7 * step, 0.15 * step, k + 0.5 * step))
                radius.append(0.04 / step)
                at = len(parent) - 1
            clusters.append((position[at], 0.5, at))
    parent.append(trunk)
    position.append((0.0, 0.0, 7.0))
    radius.append(0.06)
    clusters.append(((0.0, 0.0, 7.3), 0.6, len(parent) - 1))
    graph = TreeGraph(parent, position, radius)
    hulls = tuple(ball_cluster(*cluster) for cluster in clusters)
    return ClusterTree(graph, hulls, None, DEFAULT_ALLOMETRY, np.zeros(3))


def palm(height=8.0, n=40):
    """A stem with leaves at its top: no branchings but there."""
    stem = [(0.0, 0.0, height * k / n) for k in range(n + 1)]
    turn = np.linspace(0.0, 2.0 * np.pi, 9)[:-1]
    leaves = [(1.5 * np.cos(a), 1.5 * np.sin(a), height + 0.5) for a in turn]
    parent = [*range(-1, n), *[n] * 8]
    return TreeGraph(parent, stem + leaves, [0.15] * (n + 1) + [0.02] * 8)


def random_obstacle(rng, reach):
    """A half-space, ball, box or wall near a tree of a size, that does not hold its foot."""
    while True:
        place = rng.uniform(-reach, reach, 3)
        kind = rng.integers(4)
        if kind == 0:
            normal = rng.normal(size=3)
            normal[2] = abs(normal[2])
            found = HalfSpace(-normal / np.linalg.norm(normal) * rng.uniform(0.05, 1.0) * reach, normal)
        elif kind == 1:
            found = Ball(place, rng.uniform(0.05, 0.5) * reach, rng.choice([0.0, 0.5]))
        elif kind == 2:
            turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
            found = Box(place, rng.uniform(0.02, 0.8, 3) * reach, turn, rng.choice([0.0, 0.3]))
        else:
            angle = rng.uniform(0, 2 * np.pi)
            away = np.array([np.cos(angle), np.sin(angle), 0.0])
            found = make_wall(
                away * rng.uniform(0.05, 1) * reach,
                -away,
                width=rng.uniform(0.2, 4) * reach,
                height=rng.uniform(0.1, 1.5) * reach,
            )
        both = np.concatenate([np.eye(3), -np.eye(3)])
        if not found.blocks(np.zeros(3), both).all():
            return found


def random_scene(rng, reach, most=3):
    """Some obstacles, a sky and strengths."""
    obstacles = tuple(random_obstacle(rng, reach) for _ in range(rng.integers(0, most + 1)))
    sky = None if rng.random() < 0.5 else Sky((*rng.normal(size=2), abs(rng.normal()) + 0.05))
    return Scene(obstacles, sky=sky, bending=rng.uniform(0, 2), pruning=rng.uniform(0, 1.5))


def same(one, two):
    """Whether two adaptations are the same to the bit."""
    return (
        one.position.tobytes() == two.position.tobytes()
        and one.alive.tobytes() == two.alive.tobytes()
        and one.cause.tobytes() == two.cause.tobytes()
        and one.light.tobytes() == two.light.tobytes()
    )
