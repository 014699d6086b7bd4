"""Leaves as a mesh."""

import numpy as np
import numpy.testing as npt
import pytest

import render
from species.foliage import LeafSet
from treegraph import DEFAULT_ALLOMETRY, ClusterTree, InputError, TreeGraph


def leaf_set(m=3, seed=0):
    rng = np.random.default_rng(seed)
    along = rng.normal(size=(m, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.cross(along, rng.normal(size=(m, 3)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    length = rng.uniform(0.05, 0.1, m)
    base = rng.normal(size=(m, 3))
    return LeafSet(base, along, normal, length, 0.6 * length, np.arange(m, dtype=np.int32))


def test_two_triangles_a_leaf_of_its_area():
    leaves = leaf_set(50)
    part = render.leaf_part(leaves)
    corner = part.mesh.vertices[part.mesh.faces]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1).reshape(50, 2).sum(axis=1)
    npt.assert_allclose(area, 0.5 * leaves.length * leaves.width, rtol=0.03)  # folded: a little more
    assert (area >= 0.5 * leaves.length * leaves.width).all()
    facing = np.einsum("ij,ij->i", cross, np.repeat(leaves.normal, 2, axis=0))
    assert (facing > 0.0).all()
    npt.assert_array_equal(part.mesh.node, np.repeat(leaves.node, 4))
    assert part.material.double_sided
    assert part.material.alpha == 1.0


def test_a_leaf_begins_at_its_base_and_ends_at_its_tip():
    leaves = leaf_set(5)
    vertices = render.leaf_part(leaves).mesh.vertices.reshape(5, 4, 3)
    npt.assert_allclose(vertices[:, 0], leaves.base)
    npt.assert_allclose(vertices[:, 2], leaves.base + leaves.length[:, None] * leaves.along)
    npt.assert_allclose(np.linalg.norm(vertices[:, 3] - vertices[:, 1], axis=1), leaves.width)


def test_no_leaves_no_part():
    with pytest.raises(InputError, match="bears no leaves"):
        render.leaf_part(leaf_set(0))


POLE = ClusterTree(
    TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 2]], [0.05, 0.05]), (), None, DEFAULT_ALLOMETRY, np.zeros(3)
)


def test_further_parts_are_drawn_and_framed():
    """A leaf of one metre beside a pole: green in the picture, and the picture is wider for it."""
    leaves = LeafSet(
        np.array([[1.0, 0.0, 1.0]]),
        np.array([[1.0, 0.0, 0.0]]),
        np.array([[0.0, -1.0, 0.0]]),
        np.array([1.0]),
        np.array([1.0]),
        np.array([1], np.int32),
    )
    look = {"size": (160, 160), "azimuth": -np.pi / 2, "captions": False, "renderer": "software"}
    with_leaf = render.preview(POLE, more=[render.leaf_part(leaves)], **look).image.astype(int)
    without = render.preview(POLE, **look).image.astype(int)

    def green(image):
        return (image[..., 1] > image[..., 0] + 25) & (image[..., 1] > image[..., 2] + 25)

    assert green(with_leaf).sum() > 300
    assert not green(without).any()
    columns = np.flatnonzero(green(with_leaf).any(axis=0))
    assert columns.min() > 2 and columns.max() < 157


def test_gif_of_pictures(tmp_path):
    from PIL import Image

    images = [np.full((8, 9, 3), shade, np.uint8) for shade in (0, 100, 200)]
    render.write_gif(tmp_path / "a.gif", images, seconds=0.1)
    with Image.open(tmp_path / "a.gif") as gif:
        assert (gif.n_frames, gif.size, gif.info["duration"]) == (3, (9, 8), 100)
    for bad in ([], [images[0], images[1][:4]]):
        with pytest.raises(InputError, match="one or more pictures of one size"):
            render.write_gif(tmp_path / "b.gif", bad)
    assert not (tmp_path / "b.gif").exists()
