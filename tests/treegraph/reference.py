"""Slow and obvious versions of what treegraph computes, straight from the definitions."""

import itertools
import math

import numpy as np


def children(parent):
    kids = {i: [] for i in range(-1, len(parent))}
    for j, p in enumerate(parent):
        kids[int(p)].append(j)
    return kids


def segment(tree, i):
    p = tree.parent[i]
    return 0.0 if p < 0 else math.dist(tree.position[i], tree.position[p])


def path_length(tree, i):
    return 0.0 if tree.parent[i] < 0 else segment(tree, i) + path_length(tree, int(tree.parent[i]))


def subtree(parent, i):
    below = [i]
    for j in children(parent)[i]:
        below += subtree(parent, j)
    return below


def subtree_length(tree, i):
    return sum(segment(tree, j) for j in subtree(tree.parent, i)[1:])


def count_tips(parent, i):
    kids = children(parent)
    return sum(not kids[j] for j in subtree(parent, i))


def longest_way(tree, i):
    """From the parent of i through i to the farthest tip."""
    return segment(tree, i) + max([longest_way(tree, j) for j in children(tree.parent)[i]], default=0.0)


def heading(tree, i):
    p = int(tree.parent[i])
    if p < 0:
        return None
    v = tree.position[i] - tree.position[p]
    length = np.linalg.norm(v)
    return v / length if length > 0 else heading(tree, p)


def deviation(tree, i):
    p = int(tree.parent[i])
    a, b = (heading(tree, p) if p >= 0 else None), heading(tree, i)
    if a is None or b is None:
        return 0.0
    return math.atan2(np.linalg.norm(np.cross(a, b)), float(a @ b))


def axis_child(tree, i, tie=1e-6):
    """The rule of continue_axis, sentence by sentence."""
    kids = children(tree.parent)[i]
    if not kids:
        return -1
    r = tree.radius
    thickest = max([r[c] for c in kids if not math.isnan(r[c])], default=0.0)
    kids = [c for c in kids if math.isnan(r[c]) or r[c] >= 0.7 * thickest]
    longest = max(longest_way(tree, c) for c in kids)
    kids = [c for c in kids if longest_way(tree, c) >= 0.5 * longest]
    least = min(deviation(tree, c) for c in kids)
    kids = [c for c in kids if deviation(tree, c) <= least + tie]
    if not any(math.isnan(r[c]) for c in kids):
        kids = [c for c in kids if r[c] >= (1 - tie) * max(r[k] for k in kids)]
    longest = max(longest_way(tree, c) for c in kids)
    return min(c for c in kids if longest_way(tree, c) >= (1 - tie) * longest)


def gravelius(tree, alike=0.05, tie=1e-6):
    order = []
    for i, p in enumerate(tree.parent.tolist()):
        if p < 0:
            order.append(0)
            continue
        a = axis_child(tree, p)
        r, s = tree.radius[i], tree.radius[a]
        u, v = deviation(tree, i), deviation(tree, a)
        same = (abs(u - v) <= tie or abs(u - v) < alike * max(u, v)) and (
            r == s or abs(r - s) < alike * max(r, s)
        )
        order.append(order[p] + (i != a and not (alike > 0 and same)))
    return order


def chain_lists(tree):
    """Chains by following the axis from each node that does not continue one."""
    axis = [axis_child(tree, i) for i in range(tree.n_nodes)]
    found = []
    for i, p in enumerate(tree.parent.tolist()):
        if p >= 0 and axis[p] == i:
            continue
        chain = [i] if p < 0 else [p, i]
        while axis[chain[-1]] >= 0:
            chain.append(axis[chain[-1]])
        found.append(chain)
    return found


def distance_to_segment(p, a, b):
    """Distance, and where the foot lies between a (0) and b (1)."""
    u = b - a
    t = min(1.0, max(0.0, float((p - a) @ u / (u @ u)))) if u @ u > 0 else 0.0
    return float(np.linalg.norm(p - a - t * u)), t


def chord_holds(tree, run, i, j, tolerance, radius_tolerance=None):
    for k in range(i + 1, j):
        d, t = distance_to_segment(tree.position[run[k]], tree.position[run[i]], tree.position[run[j]])
        if d > tolerance:
            return False
        if radius_tolerance is not None:
            r = (1 - t) * tree.radius[run[i]] + t * tree.radius[run[j]]
            if not abs(r - tree.radius[run[k]]) <= radius_tolerance:
                return False
    return True


def fewest_inner_nodes(tree, run, tolerance, radius_tolerance=None):
    """Brute force over all subsets of the inner nodes of a run."""
    inner = range(1, len(run) - 1)
    for count in range(len(run) - 1):
        for chosen in itertools.combinations(inner, count):
            stops = [0, *chosen, len(run) - 1]
            if all(
                chord_holds(tree, run, a, b, tolerance, radius_tolerance)
                for a, b in zip(stops[:-1], stops[1:], strict=True)
            ):
                return count
    raise AssertionError("keeping every node always holds")


def runs(parent):
    """Paths between key nodes (roots, tips, branching nodes), root side first."""
    kids = children(parent)
    key = [parent[i] < 0 or len(kids[i]) != 1 for i in range(len(parent))]
    for i in range(len(parent)):
        if key[i] and parent[i] >= 0:
            run = [i, parent[i]]
            while not key[run[-1]]:
                run.append(parent[run[-1]])
            yield run[::-1]
