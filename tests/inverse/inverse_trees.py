"""What the tests of similarity share: all small shapes, random trees, turned and resampled ones."""

from functools import cache

import numpy as np
from hypothesis import strategies as st

from species import find_preset, grow
from treegraph import TreeGraph, transform, tree_from_unsorted


def all_shapes(n):
    """Parent arrays of all rooted unordered trees of n nodes, one of each kind."""
    found = {}

    def extend(parent):
        if len(parent) == n:
            found.setdefault(canonical(parent), parent)
            return
        for p in range(len(parent)):
            extend([*parent, p])

    extend([-1])
    return list(found.values())


def canonical(parent):
    """A name that two parent arrays share if and only if they are the same unordered tree."""
    names = [[] for _ in parent]
    for i in range(len(parent) - 1, -1, -1):
        name = "(" + "".join(sorted(names[i])) + ")"
        if i == 0:
            return name
        names[parent[i]].append(name)
    raise AssertionError


def segments_tree(parent, rng, *, lean=0.5):
    """A tree whose segments hang together as ``parent`` says, in random places and with random radii."""
    parent = [-1, *(p + 1 for p in parent)]
    position = np.zeros((len(parent), 3))
    for i, p in enumerate(parent[1:], 1):
        position[i] = position[p] + rng.normal(size=3) * lean + (0.0, 0.0, 0.3)
    radius = rng.uniform(0.005, 0.1, len(parent))
    radius[0] = radius[1]
    return TreeGraph(parent, position, radius)


def random_tree(n, rng, *, spread=4):
    """A tree of n nodes; each hangs on one of the last few."""
    return segments_tree([-1, *(int(rng.integers(max(0, i - spread), i)) for i in range(1, n - 1))], rng)


trees = st.builds(
    lambda n, seed, spread: random_tree(n, np.random.default_rng(seed), spread=spread),
    st.integers(2, 40), st.integers(0, 10**6), st.integers(1, 12),
)  # fmt: skip


@cache
def grown(kind="F6b", age=9, seed=1):
    """A small tree of the growth model."""
    return grow(find_preset(kind).parameters, age, rng=np.random.default_rng(seed)).tree


def turned(tree, angle):
    """The tree turned about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return transform(tree, [[c, -s, 0], [s, c, 0], [0, 0, 1]])


def shuffled(tree, rng):
    """The same tree with its nodes, and so its children, in another order."""
    order = np.concatenate([[0], 1 + rng.permutation(tree.n_nodes - 1)])
    rank = np.argsort(order)
    parent = np.where(tree.parent < 0, -1, rank[tree.parent])[order]
    return tree_from_unsorted(parent, tree.position[order], tree.radius[order])


def subdivided(tree, k):
    """Every segment in k equal ones of its own thickness."""
    parent, position, radius, new = [-1], [tree.position[0]], [tree.radius[0]], {0: 0}
    for i in range(1, tree.n_nodes):
        below = new[tree.parent[i]]
        for step in range(1, k + 1):
            parent.append(below)
            t = step / k
            position.append((1 - t) * tree.position[tree.parent[i]] + t * tree.position[i])
            radius.append(tree.radius[i])
            below = len(parent) - 1
        new[i] = below
    return TreeGraph(parent, position, radius)
