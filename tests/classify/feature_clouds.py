"""Clouds to describe: shapes and trees with known measures, and clouds that break things."""

import numpy as np

from treegraph import Cluster, ClusterTree, TreeGraph
from treegraph.allometry import DEFAULT_ALLOMETRY


def solid(rng, n, low, high, inside):
    """`n` random points of a box for which `inside` is true."""
    found = np.zeros((0, 3))
    while len(found) < n:
        some = low + rng.random((4 * n, 3)) * (np.asarray(high) - low)
        found = np.concatenate([found, some[inside(some)]])
    return found[:n]


def pole(rng, n, height, radius):
    """Points on an upright tube from the origin."""
    angle = rng.random(n) * 2.0 * np.pi
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height * rng.random(n)], axis=1)


def lollipop(rng, *, crown=(2.0, 1.0), base=4.0, top=8.0, n=60_000, trunk=0.15):
    """A filled elliptic cylinder on a pole: crown radii along x and y, from `base` to `top`, metres."""
    a, b = crown
    leaves = solid(rng, n, [-a, -b, base], [a, b, top], lambda p: (p[:, 0] / a) ** 2 + (p[:, 1] / b) ** 2 < 1)
    return np.concatenate([leaves, pole(rng, n // 20, base, trunk)])


def turned(points, angle):
    """Points turned around the vertical axis through the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def turned_tree(tree, angle):
    """A ClusterTree turned around the vertical axis through the origin."""
    return _changed(tree, lambda xyz: turned(xyz, angle), 1.0)


def grown_tree(tree, factor):
    """A ClusterTree that many times as large."""
    return _changed(tree, lambda xyz: xyz * factor, factor)


def _changed(tree, change, factor):
    graph = tree.graph.replace(position=change(tree.graph.position), radius=tree.graph.radius * factor)
    clusters = tuple(
        Cluster(change(c.vertices), c.faces, c.seed, c.density / factor**3, c.n_points) for c in tree.clusters
    )
    return ClusterTree(graph, clusters, tree.species, tree.allometry, tree.origin, tree.epsg)


def box_cluster(low, high, n_points=100):
    """A cluster whose hull is a box."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corner = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    return Cluster(low + corner * (high - low), faces, [0], n_points / np.prod(high - low), n_points)


def comb_tree():
    """A trunk of 10 m with two branches of 2 m at right angles and a twig of 1 m on the first of them."""
    step = 0.5
    trunk = [(0.0, 0.0, step * k) for k in range(21)]
    parent = list(range(-1, 20))
    position = list(trunk)
    radius = list(np.linspace(0.2, 0.05, 21))
    for foot, way in ((8, (1.0, 0.0, 0.0)), (12, (0.0, 1.0, 0.0))):
        before = foot
        for k in range(1, 5):
            parent.append(before)
            position.append(tuple(np.add(trunk[foot], np.multiply(way, step * k))))
            radius.append(0.03)
            before = len(parent) - 1
        if foot == 8:
            side = len(parent) - 3  # half way along the first branch
    for k in range(1, 3):
        parent.append(side if k == 1 else len(parent) - 1)
        position.append(tuple(np.add(position[side], (0.0, 0.0, step * k))))
        radius.append(0.01)
    return TreeGraph(parent, position, radius)


def as_cluster_tree(graph, clusters=()):
    """A ClusterTree of a graph."""
    return ClusterTree(graph, tuple(clusters), None, DEFAULT_ALLOMETRY, np.zeros(3), None)


def broken_clouds():
    """Clouds of at least 10 points that are no trees, by name."""
    rng = np.random.default_rng(5)
    upright = np.linspace(0.0, 9.0, 30)
    return {
        "ten points": rng.random((10, 3)) * 5.0,
        "one place": np.zeros((10, 3)),
        "one place elsewhere": np.full((50, 3), 3.3),
        "two places": np.repeat(rng.random((2, 3)), 10, axis=0),
        "upright line": np.stack([0.0 * upright, 0.0 * upright, upright], axis=1),
        "slanting line": np.linspace(0.0, 1.0, 40)[:, None] * [1.0, 1.0, 5.0],
        "two poles": np.stack([np.repeat([0.0, 1.0], 30), np.repeat([0.0, 1.0], 30), np.tile(upright, 2)], 1),
        "level plane": np.concatenate([rng.random((200, 2)), np.zeros((200, 1))], axis=1),
        "upright plane": np.concatenate([rng.random((200, 1)), np.zeros((200, 1)), rng.random((200, 1))], 1),
        "below the foot": rng.random((100, 3)) - [0.0, 0.0, 5.0],
        "one stray far away": np.concatenate([rng.random((100, 3)), [[1e6, 0.0, 0.0]]]),
        "kilometres": rng.random((500, 3)) * 1e4,
        "beyond reason": rng.random((500, 3)) * 1e8,
        "a millimetre": rng.random((500, 3)) * 1e-3,
        "wide and flat": rng.random((500, 3)) * [100.0, 100.0, 0.1],
        "lattice": rng.integers(0, 3, (100, 3)).astype(float),
        "whole numbers": rng.integers(-5, 5, (100, 3)),
        "single precision": rng.random((100, 3)).astype(np.float32),
    }
