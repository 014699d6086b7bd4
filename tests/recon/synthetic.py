"""Points on trees whose axes and radii are known."""

import numpy as np


def tube(start, end, r0, r1, n, rng, *, arc=1.0, noise=0.0):
    """Points on a frustum, spread evenly along it and around `arc` of its round."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = end - start
    length = np.linalg.norm(axis)
    axis = axis / length
    helper = np.array([1.0, 0, 0]) if abs(axis[2]) > 0.9 else np.array([0, 0, 1.0])
    u = np.cross(helper, axis)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    t = rng.random(n)
    angle = rng.random(n) * 2 * np.pi * arc
    r = r0 + t * (r1 - r0) + noise * rng.standard_normal(n)
    ring = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    return start + (t * length)[:, None] * axis + r[:, None] * ring


#: start, end, radius at the start, radius at the end, metres; the first three are the stem
FORKED = (
    ((0, 0, 0), (0, 0, 2.0), 0.10, 0.08),
    ((0, 0, 2.0), (0.25, 0, 4.0), 0.08, 0.05),
    ((0.25, 0, 4.0), (0.3, 0, 5.5), 0.05, 0.02),
    ((0, 0, 1.6), (0, 1.2, 2.6), 0.035, 0.02),
    ((0.1, 0, 2.8), (-0.9, -0.6, 3.8), 0.03, 0.015),
    ((0, 0.6, 2.1), (0.6, 0.9, 2.6), 0.012, 0.008),
)


def forked_tree(rng, *, density=9000.0, noise=0.002, parts=FORKED):
    """Points on a small tree, `density` a square metre."""
    cloud = []
    for start, end, r0, r1 in parts:
        area = 2 * np.pi * 0.5 * (r0 + r1) * np.linalg.norm(np.subtract(end, start))
        cloud.append(tube(start, end, r0, r1, max(int(area * density), 60), rng, noise=noise))
    return np.concatenate(cloud)


def axis_samples(parts=FORKED, step=0.01):
    """Points along the true axes and the true radius there."""
    at, radius = [], []
    for start, end, r0, r1 in parts:
        n = max(int(np.linalg.norm(np.subtract(end, start)) / step), 2)
        t = (np.arange(n) + 0.5) / n
        at.append(np.asarray(start, float) + t[:, None] * np.subtract(end, start))
        radius.append(r0 + t * (r1 - r0))
    return np.concatenate(at), np.concatenate(radius)


def crown(rng, n=6000, centre=(0.3, 0, 5.5), size=(1.6, 1.6, 1.0)):
    """Leaf points spread through an ellipsoid."""
    direction = rng.standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return np.asarray(centre) + direction * rng.random(n)[:, None] ** (1 / 3) * np.asarray(size)


def graph_samples(graph, step=0.005):
    """Points along the axes of a TreeGraph, the length each stands for, and the radius there."""
    child = np.flatnonzero(graph.parent >= 0)
    a, b = graph.position[graph.parent[child]], graph.position[child]
    length = np.linalg.norm(b - a, axis=1)
    n = np.maximum(1, np.ceil(length / step)).astype(int)
    row = np.repeat(np.arange(child.size), n)
    t = (np.arange(row.size) - np.repeat(np.cumsum(n) - n, n) + 0.5) / n[row]
    r0, r1 = graph.radius[graph.parent[child]], graph.radius[child]
    return a[row] + t[:, None] * (b - a)[row], (length / n)[row], r0[row] + t * (r1 - r0)[row]
