"""Slow and obvious edit distances: every mapping there is, and the recursion as it stands in the paper.

None of it knows of the order of pieces, of savings or of bounds that the compiled loops use.
"""

import itertools
import math

import numpy as np
from scipy.optimize import linear_sum_assignment

SIGMA_ANGLE, SIGMA_STRAIGHT = 0.05, 0.01


class Fused:
    """A tree whose segments are its pieces; the properties of a run come from the segments along it."""

    def __init__(self, tree):
        self.tree = tree
        assert (np.bincount(tree.parent[1:], minlength=tree.n_nodes)[0]) == 1
        self.n = tree.n_nodes - 1  # piece i is the segment of node i + 1
        self.parent = [int(p) - 1 for p in tree.parent[1:]]
        self.known = {}
        self.kids = [[j for j in range(self.n) if self.parent[j] == i] for i in range(self.n)]

    def above(self, i):
        """The piece and all that it carries."""
        return [i, *itertools.chain.from_iterable(self.above(j) for j in self.kids[i])]

    def runs(self, i):
        """All runs that begin with piece i, as lists of pieces."""
        return [[i], *([i, *run] for j in self.kids[i] for run in self.runs(j))]

    def vector(self, i):
        node = i + 1
        return self.tree.position[node] - self.tree.position[self.tree.parent[node]]

    def cost(self, i):
        return np.linalg.norm(self.vector(i)) * 2.0 * self.tree.radius[i + 1]

    def fuse(self, run):
        """Length, thickness, slope, straightness and bend of a run (table 3)."""
        if tuple(run) not in self.known:
            self.known[tuple(run)] = self._fuse(run)
        return self.known[tuple(run)]

    def _fuse(self, run):
        vectors = [self.vector(i) for i in run]
        length = sum(np.linalg.norm(v) for v in vectors)
        chord = sum(vectors)
        bend = 0.0
        for u, v in itertools.pairwise(vectors):
            cosine = u @ v / (np.linalg.norm(u) * np.linalg.norm(v))
            bend += math.acos(min(1.0, max(-1.0, cosine)))
        slope = math.atan2(chord[2], math.hypot(chord[0], chord[1]))
        thickness = max(2.0 * self.tree.radius[i + 1] for i in run)
        return length, thickness, slope, np.linalg.norm(chord) / length, bend


def difference(x, y, least):
    """Eq. 4."""
    sigma = max(min(abs(x), abs(y)) / 5.0, least)
    return 1.0 - math.exp(-((x - y) ** 2) / (2.0 * sigma**2))


def assign(one, run_1, two, run_2):
    """Eq. 12 for two joined pieces."""
    l1, d1, *form_1 = one.fuse(run_1)
    l2, d2, *form_2 = two.fuse(run_2)
    leasts = (SIGMA_ANGLE, SIGMA_STRAIGHT, SIGMA_ANGLE)
    deltas = [difference(x, y, least) for x, y, least in zip(form_1, form_2, leasts, strict=True)]
    s = (sum(delta**2.5 for delta in deltas) / 3.0) ** (1.0 / 2.5)
    longer, thick = (l1, d1) if l1 > l2 else (l2, d2)
    shorter = min(l1, l2)
    return s * shorter * (d1 + d2) + (longer - shorter) * thick


def matchings(left, right):
    """All ways to pair some of the one with some of the other."""
    if not left:
        yield []
        return
    first, rest = left[0], left[1:]
    yield from matchings(rest, right)
    for j in right:
        others = [k for k in right if k != j]
        for more in matchings(rest, others):
            yield [(first, j), *more]


def mappings(one, two, i=0, j=0):
    """All mappings of what is at and above piece i onto the same of piece j: lists of pairs of runs."""
    for run_1 in one.runs(i):
        for run_2 in two.runs(j):
            for pairs in matchings(one.kids[run_1[-1]], two.kids[run_2[-1]]):
                for rest in itertools.product(*(list(mappings(one, two, x, y)) for x, y in pairs)):
                    yield [(run_1, run_2), *itertools.chain.from_iterable(rest)]


def cost_of(one, two, mapping, joined=assign):
    """Cost of a mapping: of its pairs, and of all pieces in none of them."""
    in_1 = {i for run, _ in mapping for i in run}
    in_2 = {j for _, run in mapping for j in run}
    cost = sum(joined(one, run_1, two, run_2) for run_1, run_2 in mapping)
    cost += sum(one.cost(i) for i in range(one.n) if i not in in_1)
    return cost + sum(two.cost(j) for j in range(two.n) if j not in in_2)


def best_by_force(tree_a, tree_b, *, joins=True):
    """The least cost over all mappings."""
    one, two = Fused(tree_a), Fused(tree_b)
    known = {}

    def joined(one, run_1, two, run_2):
        key = (tuple(run_1), tuple(run_2))
        if key not in known:
            known[key] = assign(one, run_1, two, run_2)
        return known[key]

    allowed = (m for m in mappings(one, two) if joins or all(len(u) == len(v) == 1 for u, v in m))
    return min(cost_of(one, two, mapping, joined) for mapping in allowed)


def removal(fused):
    return sum(fused.cost(i) for i in range(fused.n))


def distance_by_recursion(tree_a, tree_b):
    """d_N as in the paper, its signs set right: the state is a pair of joined pieces."""
    one, two = Fused(tree_a), Fused(tree_b)
    whole_1 = [sum(one.cost(k) for k in one.above(i)) for i in range(one.n)]
    whole_2 = [sum(two.cost(k) for k in two.above(j)) for j in range(two.n)]
    known = {}

    def d_n(run_1, run_2):
        key = (run_1[0], run_1[-1], run_2[0], run_2[-1])
        if key not in known:
            kids_1, kids_2 = one.kids[run_1[-1]], two.kids[run_2[-1]]
            best = assign(one, run_1, two, run_2) + d_f(kids_1, kids_2)
            for j in kids_2:
                beside = sum(whole_2[k] for k in kids_2 if k != j)
                best = min(best, d_n(run_1, [*run_2, j]) + beside)
            for i in kids_1:
                beside = sum(whole_1[k] for k in kids_1 if k != i)
                best = min(best, d_n([*run_1, i], run_2) + beside)
            known[key] = best
        return known[key]

    def d_f(kids_1, kids_2):
        n, m = len(kids_1), len(kids_2)
        table = np.zeros((n + m, n + m))  # every child has a partner, or a place of its own to be removed at
        table[:n, m:] = np.array([whole_1[i] for i in kids_1])[:, None]
        table[n:, :m] = np.array([whole_2[j] for j in kids_2])[None, :]
        for p, i in enumerate(kids_1):
            for q, j in enumerate(kids_2):
                table[p, q] = d_n([i], [j])
        rows, columns = linear_sum_assignment(table)
        return table[rows, columns].sum()

    return d_n([0], [0]) / (2.0 * max(whole_1[0], whole_2[0]))


def ancestors(parent, i):
    """The node and all below it, as a set."""
    found = {i}
    while parent[i] >= 0:
        i = parent[i]
        found.add(i)
    return found


def common(parent, i, j):
    """Least common ancestor of two nodes."""
    below = ancestors(parent, i)
    while j not in below:
        j = parent[j]
    return j


def is_allowed(parent_a, parent_b, pairs):
    """Eq. 4.20 and 4.21 of the thesis."""

    def below(parent, i, j):
        return i in ancestors(parent, j)

    def strictly(parent, i, j):
        return i != j and below(parent, i, j)

    for (v1, v2), (w1, w2) in itertools.product(pairs, repeat=2):
        if below(parent_a, v1, w1) != below(parent_b, v2, w2):
            return False
        for u1, u2 in pairs:
            in_a = strictly(parent_a, common(parent_a, v1, w1), u1)
            if in_a != strictly(parent_b, common(parent_b, v2, w2), u2):
                return False
    return True


def constrained_by_force(parent_a, parent_b, change, delete, insert):
    """The least cost over all mappings that Eq. 4.19 to 4.21 allow."""
    m, n = len(parent_a), len(parent_b)
    best = math.inf
    for pairs in matchings(list(range(m)), list(range(n))):
        cost = sum(change[i][j] for i, j in pairs)
        cost += sum(delete[i] for i in range(m) if i not in {i for i, _ in pairs})
        cost += sum(insert[j] for j in range(n) if j not in {j for _, j in pairs})
        if cost < best and is_allowed(parent_a, parent_b, pairs):
            best = cost
    return best
