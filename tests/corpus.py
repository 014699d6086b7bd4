"""Named trees that have broken, or would break, tree code; and makers of many more."""

import math

import numpy as np
from hypothesis import strategies as st

from treegraph import Allometry, Cluster, ClusterTree, TreeGraph


def make_tree(parent, seed=0):
    """A tree of the given shape with random segments and radii; the same for the same arguments."""
    rng = np.random.default_rng(seed)
    n = len(parent)
    position = rng.normal(size=(n, 3))
    for i, p in enumerate(parent):
        position[i] = position[p] + 0.3 * position[i] + (0, 0, 0.1) if p >= 0 else 0.0
    return TreeGraph(parent, position, rng.uniform(0.001, 0.2, n))


def along(positions, radius=0.1):
    """A chain through the given positions."""
    n = len(positions)
    return TreeGraph(np.arange(-1, n - 1), positions, np.broadcast_to(radius, n))


def _comb(teeth):
    """A straight trunk of ``teeth`` segments, each with one side twig."""
    parent, position, radius = [-1], [(0.0, 0.0, 0.0)], [0.2]
    trunk = 0
    for k in range(1, teeth + 1):
        parent += [trunk, len(parent)]
        position += [(0.0, 0.0, float(k)), (0.5, 0.0, k + 0.3)]
        radius += [0.2 - 0.1 * k / teeth, 0.01]
        trunk = len(parent) - 2
    return TreeGraph(parent, position, radius)


def _trees():
    up = [(0, 0, 0), (0, 0, 1), (0, 0, 2)]
    rng = np.random.default_rng(7)
    bush = [-1] + [int(rng.integers(max(0, i - 30), i)) for i in range(1, 500)]
    return {
        "one node": TreeGraph([-1], [(0, 0, 0)], [0.1]),
        "one node, radius unknown": TreeGraph([-1], [(0, 0, 0)], [math.nan]),
        "two nodes": along([(0, 0, 0), (0, 0, 1)]),
        "chain": along(np.cumsum(rng.normal(size=(20, 3)) * 0.1 + (0, 0, 0.3), axis=0)),
        "straight chain": along(np.linspace((0, 0, 0), (0, 0, 10), 101), np.linspace(0.3, 0, 101)),
        "deep chain": along(np.cumsum(rng.normal(size=(20_000, 3)) * 0.002 + (0, 0, 0.01), axis=0)),
        "even fork": TreeGraph([-1, 0, 1, 1], [*up[:2], (1, 0, 2), (-1, 0, 2)], [0.2, 0.2, 0.1, 0.1]),
        "star": make_tree([-1] + [0] * 40),
        "comb": _comb(12),
        "forest": make_tree([-1, -1, 0, 1, 2, -1, 3, 3]),
        "only roots": TreeGraph([-1] * 3, up, [0.1, 0.2, 0.3]),
        "zero-length segment": TreeGraph(
            [-1, 0, 1, 2, 2], [*up[:2], up[1], up[2], (1, 0, 1)], [0.2, 0.2, 0.2, 0.1, 0.1]
        ),
        "zero-length tip": TreeGraph([-1, 0, 1, 1], [*up, up[1]], [0.2, 0.1, 0.1, 0.1]),
        "all in one place": TreeGraph([-1, 0, 1, 1, 0], [(1, 2, 3)] * 5, [0.1] * 5),
        "there and back": along([(0, 0, 0), (0, 0, 1), (0, 0, 0.2), (0, 0, 2)]),
        "not depth-first": make_tree([-1, 0, 0, 1, 2, 1, 2, 3, 0]),
        "many stems": TreeGraph(
            [-1, 0, 0, 0, 1, 2, 3],
            [up[0], *[(x, 0, z) for z in (1, 2) for x in (-1, 0, 1)]],
            [0.3, 0.1, 0.1, 0.1, 0.05, 0.05, 0.05],
        ),
        "one branch twice": TreeGraph([-1, 0, 1, 1, 2, 3], [*up, up[2], (0, 1, 3), (0, 1, 3)], [0.1] * 6),
        "radii unknown": make_tree([-1, 0, 1, 1, 2, 2]).replace(radius=[math.nan] * 6),
        "some radii unknown": make_tree(bush[:60]).replace(
            radius=np.where(np.arange(60) % 3 == 0, math.nan, 0.01)
        ),
        "radii zero": make_tree([-1, 0, 1, 1, 2, 2]).replace(radius=[0.0] * 6),
        "radii growing": make_tree([-1, 0, 1, 2, 2, 4]).replace(radius=np.arange(1, 7) / 10),
        "a million metres off": make_tree(bush[:50]).replace(
            position=make_tree(bush[:50]).position + (4.5e6, 5.4e6, 1e3)
        ),
        "tiny": make_tree(bush[:50]).replace(position=make_tree(bush[:50]).position * 1e-4),
        "bush": make_tree(bush),
    }


TREES = _trees()
"""Name to TreeGraph."""


def parents(max_nodes=40):
    """Hypothesis: any valid parent list."""
    return st.integers(1, max_nodes).flatmap(
        lambda n: st.tuples(*[st.integers(-1 if i else -1, i - 1) for i in range(n)])
    )


def rooted_parents(max_nodes=40):
    """Hypothesis: parent lists with one root."""
    return st.integers(1, max_nodes).flatmap(
        lambda n: st.tuples(st.just(-1), *[st.integers(0, i - 1) for i in range(1, n)])
    )


def random_rotation(rng):
    """A rotation matrix, uniformly distributed."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, [1, 0, 2]]


def realistic_tree(seed=0, height=15.0, step=0.02, noise=0.002, levels=3):
    """A tree as a reconstruction gives it before simplification: smooth crooked branches, noisy nodes.

    Branches leave by a golden angle, grow thinner and bend upwards; nodes lie ``step`` metres apart with
    ``noise`` metres of jitter; radii fall along each branch and carry 3% of noise.
    """
    rng = np.random.default_rng(seed)
    parent, position, radius = [-1], [np.zeros(3)], [0.012 * height]
    todo = [(0, np.array([0.0, 0.0, 1.0]), height, 0.012 * height, 0)]
    while todo:
        base, heading, length, thick, level = todo.pop()
        node, n = base, max(2, int(length / step))
        bend = rng.normal(size=3) * 0.01
        gap = max(2, n // (14 - 3 * level))
        for k in range(1, n + 1):
            bend = 0.97 * bend + rng.normal(size=3) * 0.003
            heading = heading + bend * np.sqrt(step / 0.02) + (0, 0, 0.002)
            heading /= np.linalg.norm(heading)
            parent.append(node)
            position.append(position[node] + step * heading)
            radius.append(thick * (1 - 0.9 * k / n))
            node = len(parent) - 1
            if level < levels and k > n // 4 and k % gap == 0:
                side = np.cross(heading, rng.normal(size=3))
                side = 0.6 * heading + side / np.linalg.norm(side)
                rest = length * (1 - k / n)
                todo.append((node, side, rng.uniform(0.3, 0.6) * rest + 0.2, 0.6 * radius[node], level + 1))
    position = np.array(position)
    position[1:] += rng.normal(size=position[1:].shape) * noise
    radius = np.array(radius) * (1 + 0.03 * rng.normal(size=len(radius)))
    measured = radius > 0.02
    return TreeGraph(parent, position, radius, {"measured": measured})


def blob(rng, centre, size, n_around=8, n_levels=7):
    """A closed, outward-facing, bumpy hull of about ``2 * n_around * (n_levels - 1)`` faces."""
    vertices = [(0, 0, -1)]
    for i in range(1, n_levels):
        polar = math.pi * i / n_levels
        for j in range(n_around):
            turn = 2 * math.pi * (j + 0.5 * i) / n_around
            vertices.append(
                (math.sin(polar) * math.cos(turn), math.sin(polar) * math.sin(turn), -math.cos(polar))
            )
    vertices.append((0, 0, 1))
    top = len(vertices) - 1
    faces = []
    for j in range(n_around):
        after = (j + 1) % n_around
        faces.append((0, 1 + after, 1 + j))
        faces.append((top, top - n_around + j, top - n_around + after))
        for i in range(n_levels - 2):
            a, b = 1 + i * n_around + j, 1 + i * n_around + after
            faces += [(a, b, a + n_around), (b, b + n_around, a + n_around)]
    vertices = np.array(vertices) * rng.uniform(0.7, 1.3, (len(vertices), 1)) * size + centre
    return vertices, np.array(faces)


def realistic_cluster_tree(graph, n_clusters=30, seed=0, **blob_shape):
    """``graph`` with bumpy hulls around its tips."""
    rng = np.random.default_rng(seed)
    tips = np.setdiff1d(np.arange(graph.n_nodes), graph.parent)
    seeds = rng.choice(tips, min(n_clusters, tips.size), replace=False)
    clusters = []
    for tip in seeds:
        vertices, faces = blob(rng, graph.position[tip] + (0, 0, 0.4), rng.uniform(0.3, 1.5), **blob_shape)
        clusters.append(Cluster(vertices, faces, [tip, graph.parent[tip]], rng.uniform(10, 5000), 1234))
    return ClusterTree(
        graph,
        tuple(clusters),
        "Pine",
        Allometry(1.3, 1.2, 0.98, 0.36),
        (455000.125, 5428000.5, 231.75),
        32632,
    )
