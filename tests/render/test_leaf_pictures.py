"""Pictures of decoded trees: leaves cut out of their quads in images and shadows, by both renderers."""

import dataclasses
import os
from pathlib import Path

import numba
import numpy as np
import numpy.testing as npt
import pytest
from PIL import Image

from render import (
    BladeSettings,
    Material,
    Mesh,
    Part,
    Texture,
    contact_sheet,
    decode_tree,
    find_gl,
    flat_parts,
    make_foliage,
    preview,
    turntable,
)
from render.camera import Camera, view_axes
from render.lighting import SUN_MAP, Layer, cast_rays, light_layer, make_light
from render.software import LitLayer, SoftwareRenderer
from render.textures import shrink_image
from tests.corpus import along, realistic_tree
from tests.render.leafy import BARK, LEAF, leaf_texture, random_instances, twigs
from treegraph import DEFAULT_ALLOMETRY, ClusterTree, InputError, TreeGraph

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT, reason="drawing without compiled loops takes minutes"
)

GOLDEN = Path(__file__).parent / "golden"
SIZE = (256, 256)


def cluster_tree(graph):
    return ClusterTree(graph, (), None, DEFAULT_ALLOMETRY, np.zeros(3))


def crown():
    """A tree of 5 m with 200 twigs at the tips of its branches."""
    graph = realistic_tree(seed=4, step=0.1, height=5.0)
    rng = np.random.default_rng(2)
    tip = np.flatnonzero(np.bincount(graph.parent[1:], minlength=graph.n_nodes) == 0)
    instances = random_instances(200, 5, seed=3)
    at = graph.position[rng.choice(tip, 200)] + rng.normal(scale=0.1, size=(200, 3))
    instances = dataclasses.replace(instances, position=at)
    foliage = make_foliage(twigs(5, 40), bark=BARK, leaf=LEAF, blade=BladeSettings(2, 2, 0.3, 0.5))
    return cluster_tree(graph), flat_parts(decode_tree(graph, instances, foliage))


TREE, PARTS = crown()


def plate(y=0.0, material=LEAF, size=1.0, flip=False, name="leaf"):
    """An upright quad that faces a viewer at -y; turned over: its upper face looks away."""
    corner = np.array([[-0.5, 0, 0], [0.5, 0, 0], [-0.5, 0, 1], [0.5, 0, 1]]) * size + [0, y, 0.2]
    faces = np.array([[0, 1, 3], [0, 3, 2]], np.int32)
    normal = np.tile(np.float32([0, -1, 0]), (4, 1))
    if flip:
        faces, normal = faces[:, ::-1].copy(), -normal
    uv = np.float32([[0, 0], [1, 0], [0, 1], [1, 1]])
    return Part(name, Mesh(corner, faces, normal, uv), material)


STAND = cluster_tree(along([(0, 0, 0), (0, 0, 0.1)], 0.01))
LOOK = {"size": (200, 200), "azimuth": -np.pi / 2, "elevation": 0.0, "captions": False}


def plain(color, alpha=255, **changes):
    """Material of one colour, cut out or not there at all."""
    pixels = np.full((4, 4, 4), (*color, alpha), np.uint8)
    return Material("p", (1, 1, 1), texture=Texture(pixels), alpha_cutoff=0.5, double_sided=True, **changes)


@pytest.fixture(params=["software", "gl"])
def renderer(request):
    if request.param == "gl" and find_gl().platform is None:
        pytest.skip(f"no OpenGL here: {find_gl().reason}")
    return request.param


# Golden images, the same for both renderers


def check_golden(name, image, tmp_path):
    """Compare with the kept image; ``SAPWOOD_GOLDEN=new`` writes it instead."""
    kept = GOLDEN / f"{name}.png"
    if os.environ.get("SAPWOOD_GOLDEN") == "new":
        Image.fromarray(image).save(kept)
    off = np.abs(np.asarray(Image.open(kept), int) - image)
    if off.mean() > 0.6 or (off.max(axis=2) > 24).mean() > 0.01:
        Image.fromarray(image).save(tmp_path / kept.name)
        pytest.fail(
            f"{name}: mean difference {off.mean():.2f} of 255, at most 0.6; see {tmp_path / kept.name}"
        )


def close_up():
    graph = TreeGraph([-1, 0], [[0, 0, -0.05], [0, 0, 0.01]], [0.006, 0.006])
    foliage = make_foliage(twigs(1, 30), bark=BARK, leaf=LEAF, blade=BladeSettings(2, 4, 0.3, 0.8))
    upright = random_instances(1, 1)
    upright = dataclasses.replace(
        upright, position=np.zeros((1, 3)), rotation=np.array([[0, 0, 0, 1.0]]), scale=np.ones(1)
    )
    return cluster_tree(graph), flat_parts(decode_tree(graph, upright, foliage))


@pytest.mark.parametrize("name", ["leafy_tree", "leafy_twig"])
def test_golden_image(name, renderer, tmp_path):
    tree, parts = (TREE, PARTS) if name == "leafy_tree" else close_up()
    drawn = preview(tree, size=SIZE, captions=False, renderer=renderer, parts=parts, elevation=0.25)
    check_golden(name, drawn.image, tmp_path)


# What is cut out


def test_outside_the_outline_there_is_nothing(renderer):
    """A picture with a leaf and one without differ where the leaf's alpha is only: no quad, no halo."""
    ghost = dataclasses.replace(LEAF, texture=plain((9, 9, 9), 0).texture)
    leaf = preview(STAND, parts=[plate()], renderer=renderer, **LOOK).image.astype(int)
    none = preview(STAND, parts=[plate(material=ghost)], renderer=renderer, **LOOK).image.astype(int)
    full = preview(STAND, parts=[plate(material=plain((40, 90, 20)))], renderer=renderer, **LOOK).image
    differs = np.abs(leaf - none).max(axis=2) > 12
    quad = np.abs(full - none).max(axis=2) > 60
    top = np.flatnonzero(quad.any(axis=1)).min()
    left = np.flatnonzero(quad[top + 20]).min()
    right = np.flatnonzero(quad[top + 20]).max()  # further down, the shadow on the ground differs too
    bottom = top + right - left
    assert bottom - top > 130
    y, x = np.mgrid[top : bottom + 1, left : right + 1]
    alpha = LEAF.texture.pixels[..., 3] > 0
    row = ((y - top + 0.5) / (bottom - top + 1) * 64).astype(int)
    column = ((x - left + 0.5) / (right - left + 1) * 64).astype(int)
    expected = alpha[row, column]
    got = differs[top : bottom + 1, left : right + 1]
    assert (got != expected).mean() < 0.03
    magenta = (leaf[..., 0] > leaf[..., 1] + 30) & (leaf[..., 2] > leaf[..., 1] + 30)
    assert not magenta.any()


def test_what_is_behind_shows_beside_the_outline(renderer):
    """A halo is a transparent corner that hides what is behind it."""
    red = plate(0.3, plain((200, 20, 20)), size=1.6, name="behind")
    for order in ([plate(), red], [red, plate()]):  # whichever is drawn first
        image = preview(STAND, parts=order, renderer=renderer, **LOOK).image.astype(int)
        is_red = image[..., 0] > image[..., 1] + 25
        is_green = image[..., 1] > image[..., 0] + 10
        rows, columns = np.flatnonzero(is_red.any(axis=1)), np.flatnonzero(is_red.any(axis=0))
        inside = (slice(rows[0] + 2, rows[-1] - 1), slice(columns[0] + 2, columns[-1] - 1))
        neither = ~(is_red | is_green)[inside]
        midrib = 0.06  # its light stripe, and mixed pixels at the edge
        assert is_green.sum() > 2000 and neither.mean() < midrib


def test_leaves_of_one_mesh_hide_each_other_by_their_outlines_only(renderer):
    near, far = plate(-0.2), plate(0.2, size=1.4)
    both = Mesh(
        np.concatenate([near.mesh.vertices, far.mesh.vertices]),
        np.concatenate([near.mesh.faces, far.mesh.faces + 4]),
        np.concatenate([near.mesh.normals, far.mesh.normals]),
        np.concatenate([near.mesh.uv, far.mesh.uv]),
    )
    one = preview(STAND, parts=[Part("both", both, LEAF)], renderer=renderer, **LOOK).image.astype(int)
    two = preview(STAND, parts=[near, far], renderer=renderer, **LOOK).image.astype(int)
    assert (np.abs(one - two).max(axis=2) > 2).mean() < 0.002


@pytest.mark.parametrize("cutoff, share", [(0.2, 0.8), (0.5, 0.5), (0.8, 0.2)])
def test_the_cutoff_is_the_material_s(cutoff, share, renderer):
    ramp = np.full((8, 256, 4), 90, np.uint8)
    ramp[..., 3] = np.arange(256)
    part = plate(material=dataclasses.replace(LEAF, texture=Texture(ramp), alpha_cutoff=cutoff))
    image = preview(STAND, parts=[part], renderer=renderer, **LOOK).image.astype(int)
    row = image[90]
    dark = np.flatnonzero(row.max(axis=1) < 190)
    whole = preview(STAND, parts=[plate(material=plain((90, 90, 90)))], renderer=renderer, **LOOK).image
    across = np.flatnonzero(whole[90].max(axis=1) < 190)
    assert abs(len(dark) / len(across) - share) < 0.03 and dark[-1] == across[-1]


def leaf_layer(material=LEAF, part=None):
    part = part or PARTS[2]
    mesh = part.mesh
    white = np.ones((len(mesh.vertices), 3))
    image = material.texture.coded(material.alpha_cutoff)
    return Layer(
        mesh.vertices, mesh.faces, mesh.normals.astype(float), white,
        uv=mesh.uv, image=image, clamp=True, both_sides=True,
    )  # fmt: skip


def test_crowns_are_as_dense_from_afar_as_from_near():
    """Part of the picture that leaves cover, in pictures of 1000 and of 40 pixels."""
    layer = leaf_layer()
    zero = np.zeros((len(layer.vertices), 3), np.uint8)
    axes = view_axes(0.3, 0.1)
    camera = Camera(np.array([0.0, 0, 3.5]) - 14 * axes[2], axes, 0.2)
    covered = []
    for size in (1000, 200, 40):
        (seen,) = SoftwareRenderer().draw(camera, size, size, [LitLayer(layer, zero, zero)])
        covered.append((seen.key > 0).mean())
    assert covered[0] > 0.03
    npt.assert_allclose(covered[1:], covered[0], rtol=0.12)


# Shadows and light


@pytest.mark.parametrize("flip", [False, True])
def test_shadows_are_cut_out_too_whichever_side_the_light_is_on(flip):
    part = plate(flip=flip)
    frame = Layer(np.array([[0, 0, 0.7 - 0.8], [0, 0, 0.7 + 0.8]]), None, np.zeros((2, 3)), np.ones((2, 3)))
    toward = np.array([[0.0, -1.0, 0.0]])

    def shaded(layer):
        """Area of the shadow, m2."""
        rays = cast_rays([layer, frame], toward, SUN_MAP)
        return (rays.shadow[0] > -1e30).sum() / rays.focal**2

    npt.assert_allclose(shaded(leaf_layer(part=part)), leaf_texture().coverage(), rtol=0.01)
    opaque = dataclasses.replace(leaf_layer(part=part), image=np.full((2, 2, 4), 255, np.uint8))
    npt.assert_allclose(shaded(opaque), 1.0, rtol=0.01)


def test_a_leaf_looks_the_same_whichever_face_is_up(renderer):
    a, b = (
        preview(STAND, parts=[plate(flip=flip)], renderer=renderer, **LOOK).image.astype(int)
        for flip in (False, True)
    )
    assert np.abs(a - b).max() <= 3 and (a[100, 100] < 200).any()


def test_light_comes_through_a_leaf_weaker_and_yellower():
    layer = leaf_layer(part=plate())
    layer = dataclasses.replace(layer, albedo=0.5 * layer.albedo)
    eye = np.array([0, -5.0, 0.7])
    light = make_light([layer], None, view_axes(-np.pi / 2, 0.0), eye)
    front, back = (
        dataclasses.replace(light, sun=dataclasses.replace(light.sun, direction=np.array([[0, y, 0]])))
        for y in (-1.0, 1.0)
    )
    lit = (light_layer(layer, front)[1] / 255.0) ** 2
    through = (light_layer(layer, back)[1] / 255.0) ** 2
    npt.assert_allclose((through / lit)[:, :2], 0.55, atol=0.01)
    npt.assert_allclose((through / lit)[:, 2], 0.55 * 0.55, atol=0.01)
    turned = dataclasses.replace(layer, normals=-layer.normals)
    npt.assert_array_equal(light_layer(turned, front)[1], light_layer(layer, front)[1])
    npt.assert_array_equal(light_layer(turned, front)[0], light_layer(layer, front)[0])


def test_bark_has_its_texture(renderer):
    stripes = np.full((16, 16, 3), 200, np.uint8)
    stripes[:8] = 60
    pole = along([(0, 0, 0), (0, 0, 3)], 0.4)
    tree = decode_tree(
        pole,
        random_instances(0),
        make_foliage(twigs(1), bark=Material("bark", (1, 1, 1), texture=Texture(stripes))),
    )
    image = preview(cluster_tree(pole), parts=flat_parts(tree), renderer=renderer, **LOOK).image
    column = image[:, 100].astype(int).max(axis=1)
    dark = column[30:170] < 0.5 * (column[30:170].max() + column[30:170].min())
    assert np.abs(np.diff(dark.astype(int))).sum() in (5, 6)  # three metres, three times light and dark


def test_shrunk_images_keep_their_light():
    image = np.random.default_rng(0).integers(0, 256, (32, 16, 4)).astype(np.uint8)
    assert shrink_image(image, 1) is image
    small = shrink_image(image, 4)
    assert small.shape == (8, 4, 4)
    npt.assert_allclose((small.astype(float) ** 2).mean(), (image.astype(float) ** 2).mean(), rtol=0.01)
    assert shrink_image(image, 1000).shape == (2, 1, 4)


# Previews


def test_parts_take_the_place_of_hulls_and_are_framed(renderer):
    image = preview(TREE, size=SIZE, captions=False, renderer=renderer, parts=PARTS).image.astype(int)
    green = image[..., 1] > image[..., 0] + 20
    rows, columns = np.flatnonzero(green.any(axis=1)), np.flatnonzero(green.any(axis=0))
    assert green.sum() > 4000
    assert rows[0] > 5 and columns[0] > 5 and columns[-1] < 250


def test_turntable_of_a_decoded_tree(tmp_path):
    turntable(TREE, tmp_path / "t.gif", frames=3, size=(80, 96), renderer="software", parts=PARTS)
    with Image.open(tmp_path / "t.gif") as gif:
        assert gif.n_frames == 3


def test_same_tree_same_picture(renderer):
    a, b = (preview(TREE, size=(128, 128), renderer=renderer, parts=PARTS).image.tobytes() for _ in range(2))
    assert a == b


def test_parts_that_cannot_be_drawn():
    bare = dataclasses.replace(PARTS[2], mesh=dataclasses.replace(PARTS[2].mesh, uv=None))
    with pytest.raises(InputError, match="part 'leaves' has a texture, so its mesh must have texture coord"):
        preview(TREE, renderer="software", parts=[bare])
    with pytest.raises(InputError, match="there is nothing to draw: the parts have no vertices"):
        preview(TREE, renderer="software", parts=[])


# Contact sheets


def shade(value, height=20, width=30, channels=3):
    return np.full((height, width, channels), value, np.uint8)


def test_a_sheet_has_its_pictures_in_rows():
    sheet = contact_sheet([shade(10 * k) for k in range(5)], columns=3)
    assert sheet.shape == (2 * 30 + 10, 3 * 40 + 10, 3)
    for k in range(5):
        top, left = 10 + k // 3 * 30, 10 + k % 3 * 40
        assert (sheet[top : top + 20, left : left + 30] == 10 * k).all()
    assert (sheet[40:, 90:] == sheet[0, 0]).all()  # the sixth place is empty
    assert contact_sheet([shade(1)], columns=9).shape == (40, 50, 3)


def test_captions_stand_below_their_pictures_and_inside_their_cells(tmp_path):
    names = ["Ficus", "a name that is far too long for a picture of this width", ""]
    sheet = contact_sheet([shade(128, 40, 60)] * 3, names, 3, path=tmp_path / "s.png")
    npt.assert_array_equal(np.asarray(Image.open(tmp_path / "s.png")), sheet)
    ink = (sheet[50:].max(axis=2) < 160).any(axis=0)
    assert ink[10:70].any() and ink[80:140].any() and not ink[150:].any()
    assert not ink[70:80].any() and not ink[:10].any() and not ink[140:150].any()


def test_pictures_of_other_sizes_stand_in_the_middle_and_transparent_ones_show_the_paper():
    sheet = contact_sheet([shade(0, 20, 30), shade(0, 10, 10)], columns=2)
    small = (sheet[:, 45:] == 0).all(axis=2)
    assert np.argwhere(small).min(axis=0).tolist() == [15, 15]
    clear = shade(0, channels=4)
    assert (contact_sheet([clear]) == sheet[0, 0]).all()


@pytest.mark.parametrize(
    "arguments, match",
    [
        (([],), "a contact sheet needs at least one picture, got none"),
        (([shade(0)], None, 0), "columns must be 1 or more, got 0"),
        (([shade(0)], ["a", "b"]), "each picture needs one caption, got 2 for 1"),
        (([shade(0), np.zeros((3, 3))],), r"images\[1\] must be uint8 of shape .*got float64 \(3, 3\)"),
        (([np.zeros((0, 3, 3), np.uint8)],), r"images\[0\] must be uint8"),
        (([np.broadcast_to(np.uint8(0), (20000, 20000, 3))],), "at most 268435456 pixels"),
    ],
)
def test_sheets_that_cannot_be(arguments, match):
    with pytest.raises(InputError, match=match):
        contact_sheet(*arguments)


def test_a_sheet_is_a_png(tmp_path):
    with pytest.raises(InputError, match=r"written to NAME\.png, got 's\.jpg'"):
        contact_sheet([shade(0)], path=tmp_path / "s.jpg")
    assert list(tmp_path.iterdir()) == []
