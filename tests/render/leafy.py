"""Patches, textures and instances made by hand: what the tests of decoded trees share."""

import numpy as np

from render import Material
from render.textures import Texture
from species.foliage import LeafSet
from species.patches import Instances, Patch
from treegraph import TreeGraph


def leaf_texture(size=64, rim=(255, 0, 255)):
    """A pointed leaf with a midrib; beyond its outline the colour is one that must never be seen."""
    y, x = (np.mgrid[0:size, 0:size] + 0.5) / size
    along = 1.0 - y
    half = 0.46 * np.sin(np.pi * along.clip(0, 1)) ** 0.7
    inside = np.abs(x - 0.5) < half
    pixels = np.empty((size, size, 4), np.uint8)
    pixels[...] = (*rim, 0)
    green = np.stack([70 + 40 * along, 120 + 30 * along, 40 + 10 * along], axis=2)
    pixels[inside, :3] = green[inside]
    pixels[inside & (np.abs(x - 0.5) < 0.02), :3] = (170, 190, 110)
    pixels[inside, 3] = 255
    return Texture(pixels)


def bark_texture(size=32):
    rng = np.random.default_rng(1)
    shade = rng.integers(90, 150, (size, size, 1))
    return Texture(np.clip(shade * [1.0, 0.85, 0.7], 0, 255).astype(np.uint8))


def flat_normals(size=8):
    return Texture(np.full((size, size, 3), (128, 128, 255), np.uint8))


LEAF = Material(
    "leaf",
    (1, 1, 1),
    double_sided=True,
    texture=leaf_texture(),
    alpha_cutoff=0.5,
    normal_texture=flat_normals(),
)
BARK = Material("bark", (1, 1, 1), texture=bark_texture())


def twig(seed=0, n_leaves=100, length=0.5):
    """A twig with two side twigs and leaves all along, in a random order."""
    rng = np.random.default_rng(seed)
    z = np.linspace(0, length, 8)
    main = np.column_stack([0.02 * np.sin(9 * z), 0.01 * np.cos(7 * z) - 0.01, z])
    main[0] = 0
    left = main[3] + np.array([[0.08, 0.0, 0.08], [0.16, 0.02, 0.14]]) * length / 0.5
    right = main[5] + np.array([[-0.06, 0.05, 0.05], [-0.11, 0.10, 0.09]]) * length / 0.5
    position = np.concatenate([main, left, right])
    parent = [-1, 0, 1, 2, 3, 4, 5, 6, 3, 8, 5, 10]
    radius = np.concatenate([np.linspace(0.006, 0.002, 8), [0.0025, 0.0012], [0.002, 0.001]])
    graph = TreeGraph(parent, position, radius)
    node = rng.integers(1, graph.n_nodes, n_leaves)
    at = rng.random((n_leaves, 1))
    base = at * position[node] + (1 - at) * position[graph.parent[node]]
    along = rng.normal(size=(n_leaves, 3)) + [0.4, 0, 0.6]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    up = np.array([1.0, 0, 0]) + 0.5 * rng.normal(size=(n_leaves, 3))
    normal = up - (up * along).sum(axis=1, keepdims=True) * along
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    size = rng.uniform(0.04, 0.09, n_leaves)
    leaves = LeafSet(base, along, normal, size, 0.6 * size, node.astype(np.int32))
    return Patch(graph, leaves, radius=0.006)


def twigs(n=5, n_leaves=100):
    return [twig(k, n_leaves + 3 * k, 0.4 + 0.05 * k) for k in range(n)]


def random_instances(n=300, n_patches=5, seed=0, middle=(0, 0, 4.0), reach=2.0):
    """Instances spread through a ball, pointing outwards more or less."""
    rng = np.random.default_rng(seed)
    out = rng.normal(size=(n, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    position = np.array(middle) + reach * out * rng.random((n, 1)) ** (1 / 3)
    rotation = rng.normal(size=(n, 4))
    rotation /= np.linalg.norm(rotation, axis=1, keepdims=True)
    patch = rng.integers(0, n_patches, n).astype(np.int32)
    scale = rng.uniform(0.6, 1.4, n)
    cluster = rng.integers(-1, 4, n).astype(np.int32)
    return Instances(patch, position, rotation, scale, cluster, rng.permutation(n).astype(np.int32))


def rotate(quaternion, points):
    """Rotate by quaternions x, y, z, w, by the definition q p q*."""
    q, w = quaternion[..., :3], quaternion[..., 3:]
    t = 2 * np.cross(q, points)
    return points + w * t + np.cross(q, t)
