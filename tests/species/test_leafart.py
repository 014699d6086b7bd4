"""Leaves drawn from numbers: outlines, alpha, colours, normals, and what is refused."""

import subprocess
import sys
import tomllib
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leaf_examples import COLORS, LEAF
from scipy import ndimage

from species._art_fields import field_table
from species._art_pixels import balance_alpha, bleed, coverage, encode_normals, smoothstep
from species.leafart import (
    DIVIDED,
    KINDS,
    MARGINS,
    LeafColors,
    LeafShape,
    draw_leaf,
    encode_png,
    encode_webp,
    leaf_area,
    outline,
    stalk_outline,
)
from treegraph import InputError

ROOT = Path(__file__).parents[2]
PLAIN = LeafShape("simple", length=0.08, width=0.05)
EVEN = LeafColors(variation=0.0)
BY_KIND = {
    "simple": {"width": 0.05},
    "linear": {"width": 0.02},
    "lobed": {"width": 0.06},
    "star": {},
    "fan": {"lobes": 12},
    "palmate": {"leaflets": 5, "leaflet_length": 0.08, "leaflet_width": 0.03},
    "pinnate": {"leaflets": 9, "leaflet_length": 0.04, "leaflet_width": 0.015},
    "bipinnate": {"width": 0.08, "pinnae": 5, "leaflets": 8, "leaflet_length": 0.01, "leaflet_width": 0.004},
    "frond": {"leaflets": 21, "leaflet_length": 0.05, "leaflet_width": 0.004},
    "needle": {"leaflets": 12, "leaflet_length": 0.03, "leaflet_width": 0.002},
}


def kind_of_leaf(kind, **more):
    return LeafShape(kind, **{"length": 0.1, **BY_KIND[kind], **more})


@cache
def draw(shape, colors=EVEN, size=256, seed=0, **options):
    return draw_leaf(shape, colors, size, rng=np.random.default_rng(seed), **options)


def shoelace(polygon):
    x, y = polygon.T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def box_area(texture):
    left, bottom, right, top = texture.box
    return (right - left) * (top - bottom)


def is_leaf(texture):
    return texture.rgba[:, :, 3] >= 128


def runs(ring):
    """How many stretches of True there are around a circle."""
    return int(np.sum(ring & ~np.roll(ring, 1)))


def around(texture, centre, radius, n=4000):
    """Whether there is leaf at n points of a circle (metres) around a point of the leaf's frame."""
    left, bottom, right, top = texture.box
    height, width = texture.rgba.shape[:2]
    turn = 2.0 * np.pi * np.arange(n) / n
    x, y = centre[0] + radius * np.sin(turn), centre[1] + radius * np.cos(turn)
    column = np.clip(((x - left) / (right - left) * width).astype(int), 0, width - 1)
    row = np.clip(((top - y) / (top - bottom) * height).astype(int), 0, height - 1)
    inside = (x > left) & (x < right) & (y > bottom) & (y < top)
    return is_leaf(texture)[row, column] & inside


# ---------------------------------------------------------------- coverage


def slow_coverage(polygon, shape, fine=40):
    """Share of fine x fine points of each pixel that lie inside, by the crossing number."""
    y, x = np.mgrid[0 : shape[0] * fine, 0 : shape[1] * fine]
    x, y = (x + 0.5) / fine, (y + 0.5) / fine
    inside = np.zeros(x.shape, bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))


def test_coverage_of_a_box_by_hand():
    box = np.array([[1.5, 1.0], [3.0, 1.0], [3.0, 2.25], [1.5, 2.25]])
    wanted = np.zeros((4, 4))
    wanted[1, 1:3] = 0.5, 1.0
    wanted[2, 1:3] = 0.125, 0.25
    npt.assert_allclose(coverage([box], (4, 4)), wanted, atol=1e-12)
    npt.assert_allclose(coverage([box[::-1]], (4, 4)), wanted, atol=1e-12)


@given(st.integers(0, 10**6), st.integers(3, 9))
@settings(max_examples=25, deadline=None)
def test_coverage_agrees_with_counting_points(seed, n):
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.random(n)) * 2.0 * np.pi
    reach = (0.1 + 0.9 * rng.random(n))[:, None]
    polygon = [5.0, 4.0] + reach * np.stack([4.9 * np.cos(turn), 3.9 * np.sin(turn)], axis=1)
    turn_sense = polygon[::-1] if seed % 2 else polygon
    if shoelace(polygon) < 0.5:
        return
    share, wanted = coverage([turn_sense], (8, 10)), slow_coverage(polygon, (8, 10))
    bearing = np.sort(np.arctan2(*(polygon - [5, 4]).T[::-1]))
    if np.diff(bearing, append=bearing[0] + 2.0 * np.pi).max() < np.pi:  # no edge crosses another
        npt.assert_allclose(share, wanted, atol=0.03)


def test_overlaps_are_not_counted_twice():
    box = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]])
    share = coverage([box, box[::-1], box + [1.0, 0.0]], (4, 5))
    assert share.max() == 1.0
    assert share.sum() == pytest.approx(6.0)


def test_balanced_alpha_keeps_the_area_at_one_half():
    share = np.random.default_rng(0).random((64, 64)) ** 3
    alpha = balance_alpha(share)
    assert (alpha >= 0.5).sum() == pytest.approx(share.sum(), abs=1.0)
    order = np.argsort(share.ravel())
    assert (np.diff(alpha.ravel()[order]) >= 0.0).all()
    npt.assert_array_equal(balance_alpha(np.zeros((4, 4))), 0.0)
    npt.assert_array_equal(balance_alpha(np.ones((4, 4))), 1.0)


def test_bleeding_keeps_what_is_known():
    values = np.random.default_rng(0).random((40, 40, 3))
    known = np.zeros((40, 40), bool)
    known[18:22, 18:22] = True
    filled = bleed(values, known)
    npt.assert_array_equal(filled[known], values[known])
    npt.assert_allclose(filled[20, 22], values[20, 21])  # next to it: the nearest
    npt.assert_allclose(filled[0, 0], values[known].mean(axis=0))  # far: the mean


def test_smoothstep_and_normals_by_hand():
    npt.assert_allclose(smoothstep(0.0, 2.0, np.array([-1.0, 0.0, 1.0, 2.0, 3.0])), [0, 0, 0.5, 1, 1])
    flat, right, up = encode_normals(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    npt.assert_array_equal(flat, [128, 128, 255])
    npt.assert_array_equal(right, [37, 128, 218])  # rises to the right: leans left
    npt.assert_array_equal(up, [128, 37, 218])


# ---------------------------------------------------------------- outlines


def test_an_ellipse_has_its_area():
    leaf = LeafShape("simple", length=0.2, width=0.1, widest=0.5, tip=0.0, base=0.0, petiole=0.0)
    assert leaf_area(leaf) == pytest.approx(np.pi / 4.0 * 0.2 * 0.1, rel=2e-3)
    (polygon,) = outline(leaf, 400)
    assert shoelace(polygon) == pytest.approx(np.pi / 4.0 * 0.2 * 0.1, rel=1e-4)


@pytest.mark.parametrize("margin", MARGINS)
@pytest.mark.parametrize("kind", ["simple", "linear", "lobed"])
def test_a_blade_is_as_long_and_wide_as_said(kind, margin):
    leaf = LeafShape(kind, length=0.1, width=0.04, petiole=0.02, margin=margin, teeth=9, lobes=4)
    (polygon,) = outline(leaf)
    assert np.ptp(polygon[:, 0]) == pytest.approx(0.04, rel=1e-3)
    assert polygon[:, 1].min() == pytest.approx(0.02)
    assert polygon[:, 1].max() == pytest.approx(0.12)


@pytest.mark.parametrize("widest", [0.2, 0.5, 0.8])
def test_the_widest_place_is_where_it_should_be(widest):
    (polygon,) = outline(replace(PLAIN, widest=widest, petiole=0.0), 400)
    at = polygon[np.argmax(polygon[:, 0]), 1] / 0.08
    assert at == pytest.approx(widest, abs=0.02)


def test_sharper_is_smaller_and_a_sickle_keeps_the_area():
    areas = [leaf_area(replace(PLAIN, tip=tip)) for tip in (0.0, 0.5, 1.0)]
    assert areas == sorted(areas, reverse=True)
    areas = [leaf_area(replace(PLAIN, base=base)) for base in (0.0, 0.5, 1.0)]
    assert areas == sorted(areas, reverse=True)
    assert leaf_area(replace(PLAIN, bend=0.3)) == pytest.approx(leaf_area(PLAIN), rel=1e-9)


def test_a_heart_reaches_behind_its_petiole():
    (polygon,) = outline(replace(PLAIN, base=-0.8))
    assert polygon[:, 1].min() < PLAIN.petiole - 0.1 * PLAIN.length


def test_a_drip_tip_is_long_and_narrow():
    leaf = replace(PLAIN, drip=0.2, petiole=0.0)
    (polygon,) = outline(leaf, 200)
    tail = polygon[polygon[:, 1] > 0.82 * leaf.length]
    assert np.abs(tail[:, 0]).max() < 0.2 * leaf.width / 2
    assert polygon[:, 1].max() == pytest.approx(leaf.length)


@pytest.mark.parametrize("scale", [0.5, 3.0])
def test_area_grows_with_the_square_of_the_size(scale):
    sizes = {"length", "width", "petiole", "stalk_width", "leaflet_length", "leaflet_width"}
    for kind in KINDS:
        leaf = kind_of_leaf(kind)
        values = {key: value for key, value in asdict(leaf).items() if value is not None}
        larger = LeafShape(**{k: v * scale if k in sizes else v for k, v in values.items()})
        assert leaf_area(larger) == pytest.approx(scale**2 * leaf_area(leaf), rel=1e-6)


@pytest.mark.parametrize("name", ["mahogany", "bischofia", "delonix", "ailanthus", "palm", "pine", "spruce"])
def test_every_leaflet_has_an_outline(name):
    leaf = LEAF[name]
    wanted = {"bipinnate": 2 * leaf.pinnae * leaf.leaflets, "needle": leaf.leaflets * leaf.cluster}
    assert len(outline(leaf)) == wanted.get(leaf.kind, leaf.leaflets)


@pytest.mark.parametrize("kind", sorted(set(DIVIDED) - {"needle"}))
def test_divided_leaves_are_as_long_as_said(kind):
    leaf = kind_of_leaf(kind, petiole=0.02)
    top = np.concatenate(outline(leaf))[:, 1].max()
    assert top - 0.02 == pytest.approx(0.1, rel=0.08)


# ---------------------------------------------------------------- area in the texture

SINGLE = [name for name, leaf in LEAF.items() if leaf.kind not in DIVIDED]


@pytest.mark.parametrize("name", SINGLE)
def test_texture_covers_what_the_outline_encloses(name):
    leaf = replace(LEAF[name], petiole=0.0)
    texture = draw(leaf)
    assert texture.area_share * box_area(texture) == pytest.approx(leaf_area(leaf), rel=0.01)


@pytest.mark.parametrize("name", list(LEAF))
def test_texture_covers_the_union_of_all_parts(name):
    """Counted with the imaging library's own polygons, at twelve times the resolution."""
    from PIL import Image, ImageDraw

    leaf, fine = LEAF[name], 12
    texture = draw(leaf)
    left, bottom, right, top = texture.box
    height, width = np.array(texture.rgba.shape[:2]) * fine
    picture = Image.new("L", (int(width), int(height)))
    pen = ImageDraw.Draw(picture)
    for polygon in outline(leaf) + stalk_outline(leaf):
        x = (polygon[:, 0] - left) / (right - left) * width - 0.5
        y = (top - polygon[:, 1]) / (top - bottom) * height - 0.5
        pen.polygon(list(zip(x, y, strict=True)), fill=1)
    assert texture.area_share == pytest.approx(np.asarray(picture).mean(), rel=0.025)
    assert texture.area_share == is_leaf(texture).mean()


@pytest.mark.parametrize("size", [64, 128])
def test_area_does_not_depend_on_the_resolution(size):
    for name in ("oak", "ailanthus", "spruce"):
        coarse, fine = draw(LEAF[name], size=size), draw(LEAF[name], size=256)
        wanted = pytest.approx(fine.area_share * box_area(fine), rel=5.0 / size)
        assert coarse.area_share * box_area(coarse) == wanted


# ---------------------------------------------------------------- what is in the alpha mask


def test_straight_leaves_are_symmetric():
    for name in ("lagerstroemia", "oak", "birch", "beech", "delonix", "mahogany", "bischofia"):
        alpha = draw(LEAF[name]).rgba[:, :, 3].astype(int)
        assert np.abs(alpha - alpha[:, ::-1]).max() <= 1, name
    bent = draw(LEAF["willow"]).rgba[:, :, 3].astype(int)
    assert np.abs(bent - bent[:, ::-1]).max() > 100


@pytest.mark.parametrize("n", [6, 9, 14])
def test_leaflets_are_found_again(n):
    """Right of the rachis each leaflet is a piece of its own; an odd one ends the leaf."""
    leaf = LeafShape("pinnate", length=0.3, leaflets=n, leaflet_length=0.09, leaflet_width=0.025)
    texture = draw(leaf)
    left, _, right, _ = texture.box
    x = left + (np.arange(texture.rgba.shape[1]) + 0.5) / texture.rgba.shape[1] * (right - left)
    beside = is_leaf(texture) & (x > 0.017)[None, :]
    assert ndimage.label(beside)[1] == n // 2
    above = around(texture, (0.0, leaf.petiole), leaf.length - 0.01)
    assert above[0] == bool(n % 2)  # straight up


@pytest.mark.parametrize("n", [3, 5, 7])
def test_leaflets_from_one_point_are_found_again(n):
    leaf = LeafShape(
        "palmate",
        length=0.1,
        leaflets=n,
        leaflet_length=0.09,
        leaflet_width=0.02,
        spread_deg=200,
        petiole=0.05,
    )
    assert runs(around(draw(leaf), (0.0, 0.05), 0.055)) == n
    assert runs(around(draw(leaf), (0.0, 0.05), 0.045)) == n + 1  # and the petiole


@pytest.mark.parametrize("kind, n", [("star", 5), ("star", 7), ("fan", 16)])
def test_lobes_around_the_base_are_found_again(kind, n):
    leaf = LeafShape(kind, length=0.1, lobes=n, lobe_depth=0.6, spread_deg=240, taper=0.1, petiole=0.02)
    assert runs(around(draw(leaf), (0.0, 0.02), 0.075)) == n


@pytest.mark.parametrize("n", [3, 4, 6])
def test_lobes_along_the_midrib_are_found_again(n):
    """So many maxima of the width along the leaf as there are pairs of lobes, and the one at the tip."""
    leaf = LeafShape("lobed", length=0.1, width=0.06, lobes=n, lobe_depth=0.5, petiole=0.0, tip=0.1)
    width = is_leaf(draw(leaf, size=512)).sum(axis=1).astype(float)
    smooth = ndimage.gaussian_filter1d(width, 1.5)
    maxima = (smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])
    assert maxima.sum() == n + 1


@pytest.mark.parametrize("margin", ["serrate", "crenate", "wavy"])
@pytest.mark.parametrize("n", [6, 11])
def test_teeth_are_found_again(margin, n):
    """Along a blade with parallel sides the width has a maximum at every tooth."""
    leaf = LeafShape(
        "linear",
        length=0.1,
        width=0.03,
        tip=0.02,
        base=0.0,
        margin=margin,
        teeth=n,
        tooth_depth=0.2,
        petiole=0,
    )
    width = is_leaf(draw(leaf, size=512)).sum(axis=1).astype(float)
    smooth = ndimage.gaussian_filter1d(width, 2.0)
    maxima = (smooth[1:-1] > smooth[:-2]) & (smooth[1:-1] >= smooth[2:])
    assert maxima.sum() == n


@pytest.mark.parametrize("n", [2, 5])
def test_needles_of_a_bundle_are_found_again(n):
    leaf = LeafShape(
        "needle",
        length=0.06,
        leaflet_length=0.06,
        leaflet_width=0.0015,
        cluster=n,
        spread_deg=60,
        petiole=0.005,
    )
    assert runs(around(draw(leaf), (0.0, 0.005), 0.045)) == n


def test_needles_stand_on_both_sides_of_a_shoot():
    alpha = is_leaf(draw(LEAF["spruce"]))
    left, right = alpha[:, : alpha.shape[1] // 2].mean(), alpha[:, alpha.shape[1] // 2 :].mean()
    assert left == pytest.approx(right, rel=0.15)


# ---------------------------------------------------------------- alpha and colours


@pytest.mark.parametrize("name", ["oak", "beech", "willow"])
def test_alpha_is_soft_at_the_edge_only(name):
    alpha = draw(LEAF[name]).rgba[:, :, 3]
    assert {0, 255} <= set(np.unique(alpha))
    soft = (alpha > 0) & (alpha < 255)
    assert len(np.unique(alpha[soft])) > 100
    near = ndimage.binary_dilation(alpha == 0, iterations=2) & ndimage.binary_dilation(
        alpha >= 128, iterations=2
    )
    assert (near | ~soft).mean() > 0.999


@pytest.mark.parametrize("name", list(LEAF))
def test_border_is_transparent(name):
    alpha = draw(LEAF[name], size=64).rgba[:, :, 3]
    assert not (alpha[[0, -1]].any() or alpha[:, [0, -1]].any())


@pytest.mark.parametrize("name", ["oak", "pine", "delonix", "palm"])
def test_no_fringes(name):
    """Colours outside are the leaf's: halving the texture without regard to alpha darkens nothing."""
    texture = draw(LEAF[name], COLORS[name])
    rgb, alpha = texture.rgba[:, :, :3].astype(float), texture.rgba[:, :, 3] / 255.0
    inside = rgb[alpha >= 0.5]
    outside = rgb[alpha < 0.5]
    assert (outside.min(axis=0) >= inside.min(axis=0) - 2).all()
    assert (outside.max(axis=0) <= inside.max(axis=0) + 2).all()
    height, width = alpha.shape
    mip = rgb.reshape(height // 8, 8, width // 8, 8, 3).mean(axis=(1, 3))
    weight = alpha.reshape(height // 8, 8, width // 8, 8).mean(axis=(1, 3))
    edge, core = (weight > 0.05) & (weight < 0.3), weight > 0.4
    npt.assert_allclose(mip[edge].mean(axis=0), mip[core].mean(axis=0), atol=18)


def test_the_midrib_is_lighter_than_the_blade_and_so_are_side_veins():
    leaf = replace(PLAIN, midrib=0.06, veins=6, petiole=0.0, width=0.07)
    light = draw(leaf, size=512).rgba[:, :, :3].sum(axis=2).astype(int)
    middle = light.shape[1] // 2
    beside = light[150:350, middle + 25 : middle + 30].mean()
    assert light[150:350, middle - 1 : middle + 1].mean() > beside + 20
    column = ndimage.gaussian_filter1d(light[:, middle + 60].astype(float), 2.0)
    alpha = draw(leaf, size=512).rgba[:, middle + 60, 3]
    ground = ndimage.gaussian_filter1d(column, 25.0)
    peaks = ndimage.label((column - ground > 8) & (alpha > 250))[1]
    assert 4 <= peaks <= 6  # those that start near the tip do not come so far out


@pytest.mark.parametrize("season", ["spring", "summer", "autumn", "winter"])
def test_each_season_has_its_colour(season):
    colors = LeafColors((200, 60, 60), (60, 200, 60), (200, 200, 40), (60, 60, 200), variation=0.2)
    texture = draw(replace(PLAIN, midrib=0.0, veins=0, petiole=0.0), colors, season=season)
    mean = texture.rgba[is_leaf(texture)][:, :3].mean(axis=0)
    npt.assert_allclose(mean, getattr(colors, season), rtol=0.25, atol=6)


def test_the_back_is_paler_and_its_veins_stand_out():
    front, back = draw(PLAIN), draw(PLAIN, back=True)
    npt.assert_array_equal(front.rgba[:, :, 3], back.rgba[:, :, 3])
    leaf = is_leaf(front)
    assert back.rgba[leaf][:, :3].mean() > front.rgba[leaf][:, :3].mean() + 15
    turned = back.normal[:, :, :2].astype(int) + front.normal[:, :, :2].astype(int)
    assert np.abs(turned - 255).max() <= 1
    own = draw(PLAIN, LeafColors(back=(250, 250, 250), variation=0.0), back=True)
    assert own.rgba[leaf][:, :3].mean() > 225


def test_variation_is_what_chance_changes():
    calm, wild = LeafColors(variation=0.0), LeafColors(variation=1.0)
    leaf = is_leaf(draw(PLAIN))
    spread = [draw(PLAIN, colors).rgba[leaf][:, 0].astype(float).std() for colors in (calm, wild)]
    assert spread[1] > 1.3 * spread[0]
    npt.assert_array_equal(draw(PLAIN, calm, seed=1).rgba[:, :, 3], draw(PLAIN, wild, seed=2).rgba[:, :, 3])


def test_same_seed_same_bytes():
    for name in ("birch", "pine"):
        one, two, other = (draw.__wrapped__(LEAF[name], COLORS[name], seed=seed) for seed in (5, 5, 6))
        assert one.rgba.tobytes() == two.rgba.tobytes()
        assert one.normal.tobytes() == two.normal.tobytes()
        assert one.rgba.tobytes() != other.rgba.tobytes()
        assert one.normal.tobytes() == other.normal.tobytes()
        npt.assert_array_equal(one.rgba[:, :, 3], other.rgba[:, :, 3])


# ---------------------------------------------------------------- normals


@pytest.mark.parametrize("name", ["oak", "mahogany", "spruce"])
def test_normals_are_unit_vectors_that_look_out(name):
    normal = draw(LEAF[name]).normal / 127.5 - 1.0
    npt.assert_allclose(np.linalg.norm(normal, axis=2), 1.0, atol=0.012)
    assert normal[:, :, 2].min() > 0.3
    assert np.abs(normal[:, :, 0]).max() > 0.1


def test_normals_are_flat_without_relief():
    for kind in KINDS:
        normal = draw(kind_of_leaf(kind, relief=0.0), size=64).normal
        assert (normal == [128, 128, 255]).all(), kind


def test_the_blade_is_cupped():
    """The margins stand higher than the midrib: left of it normals lean right, right of it left."""
    texture = draw(replace(PLAIN, veins=0, midrib=0.0, petiole=0.0))
    height, width = texture.rgba.shape[:2]
    row = texture.normal[height // 2, :, 0].astype(int)
    assert row[width // 4] > 135 and row[3 * width // 4] < 121
    assert abs(int(row[width // 2]) - 128) <= 3


# ---------------------------------------------------------------- sizes and shapes


def test_pixels_follow_the_leaf():
    shapes = {name: draw(LEAF[name], size=128).rgba.shape[:2] for name in ("oak", "willow", "palm")}
    assert shapes == {"oak": (128, 128), "willow": (128, 16), "palm": (128, 64)}
    wide = draw(LeafShape("simple", length=0.03, width=0.2, petiole=0.0), size=128)
    assert wide.rgba.shape == (32, 128, 4)
    assert wide.normal.shape == (32, 128, 3)


@pytest.mark.parametrize("name", ["oak", "willow", "palm"])
def test_box_holds_the_leaf(name):
    texture = draw(LEAF[name])
    left, bottom, right, top = texture.box
    points = np.concatenate(outline(LEAF[name]) + stalk_outline(LEAF[name]))
    assert left < points[:, 0].min() and points[:, 0].max() < right
    assert bottom < 0.0 and points[:, 1].max() < top
    assert texture.aspect == pytest.approx((right - left) / (top - bottom))


def test_files_are_small():
    """The largest leaf, with its normals, well under the 200 kB that a whole species may have."""
    for name in ("pine", "delonix", "palm", "mahogany"):
        texture = draw(LEAF[name], COLORS[name])
        assert len(encode_webp(texture.rgba)) + len(encode_webp(texture.normal)) < 32_000, name


def test_png_is_without_loss_and_webp_keeps_alpha():
    from io import BytesIO

    from PIL import Image

    rgba = draw(LEAF["oak"], size=128).rgba
    npt.assert_array_equal(np.asarray(Image.open(BytesIO(encode_png(rgba)))), rgba)
    back = np.asarray(Image.open(BytesIO(encode_webp(rgba))))
    npt.assert_array_equal(back[:, :, 3], rgba[:, :, 3])
    assert np.abs(back[:, :, :3].astype(int) - rgba[:, :, :3]).mean() < 4.0
    assert encode_webp(rgba) == encode_webp(rgba)
    assert len(encode_webp(rgba, 20)) < len(encode_webp(rgba, 95))


_leaves = st.fixed_dictionaries(
    {
        "widest": st.floats(0.05, 0.95),
        "tip": st.floats(0, 1),
        "base": st.floats(-1, 1),
        "drip": st.floats(0, 0.4),
        "bend": st.floats(-0.5, 0.5),
        "margin": st.sampled_from(MARGINS),
        "teeth": st.integers(0, 80),
        "tooth_depth": st.floats(0, 0.5),
        "lobes": st.integers(1, 60),
        "lobe_depth": st.floats(0, 0.95),
        "spread_deg": st.floats(5, 350),
        "leaflet_angle_deg": st.floats(5, 110),
        "leaflets": st.integers(2, 40),
        "taper": st.floats(0, 0.95),
        "cluster": st.integers(1, 8),
        "petiole": st.floats(0, 0.3),
        "stalk_width": st.floats(0.0002, 0.01),
        "veins": st.integers(0, 60),
        "midrib": st.floats(0, 0.3),
        "relief": st.floats(0, 2),
    }
)


@given(st.sampled_from(KINDS), _leaves)
@settings(max_examples=40, deadline=None)
def test_any_legal_leaf_can_be_drawn(kind, values):
    leaf = kind_of_leaf(kind, **values)
    assert np.isfinite(np.concatenate(outline(leaf))).all()
    assert leaf_area(leaf) > 0.0
    texture = draw(leaf, size=32)
    assert 0.0 < texture.area_share < 1.0
    assert texture.aspect > 0.0


# ---------------------------------------------------------------- what is refused


def test_a_leaf_comes_from_a_table_of_toml():
    text = """
    kind = "pinnate"
    length = 0.5
    leaflets = 21
    leaflet_length = 0.1
    leaflet_width = 0.04
    margin = "serrate"
    """
    assert LeafShape(**tomllib.loads(text)).leaflets == 21
    colors = LeafColors(**tomllib.loads('summer = [10, 20, 30]\nautumn = "#ff8000"'))
    assert (colors.summer, colors.autumn, colors.winter) == ((10, 20, 30), (255, 128, 0), None)


NUMBERS = [row for row in field_table(LeafShape) if row["low"] is not None]


@pytest.mark.parametrize("row", NUMBERS, ids=lambda row: row["name"])
def test_every_number_has_its_range_in_its_message(row):
    kind = next(
        kind for kind in KINDS if row["name"] not in ("width", "leaflet_length", "leaflet_width")
        or row["name"] in BY_KIND[kind]
    )  # fmt: skip
    unit = f" {row['unit']}" if row["unit"] else ""
    whole = "a whole number " if row["whole"] else ""
    rule = f"{row['name']} must be {whole}from {row['low']} to {row['high']}{unit}, got "
    for wrong in (row["low"] - 1, row["high"] + 1, float("nan"), "x", True, [1]):
        with pytest.raises(InputError) as caught:
            kind_of_leaf(kind, **{row["name"]: wrong})
        assert str(caught.value).startswith(rule)
        assert "\n" not in str(caught.value)
    if row["whole"]:
        with pytest.raises(InputError, match="must be a whole number"):
            kind_of_leaf(kind, **{row["name"]: row["low"] + 0.5})


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: LeafShape("round", length=1), f"kind must be one of {', '.join(KINDS)}, got 'round'"),
        (
            lambda: replace(PLAIN, margin="torn"),
            f"margin must be one of {', '.join(MARGINS)}, got 'torn'",
        ),
        (lambda: LeafShape("simple", length=0.1), "width is missing: a simple leaf needs width"),
        (
            lambda: LeafShape("pinnate", length=0.1, leaflet_length=0.05),
            "leaflet_width is missing: a pinnate leaf needs leaflet_length and leaflet_width",
        ),
        (
            lambda: LeafShape("star", length=0.1, width=0.1),
            "width means nothing to a star leaf; leave it out",
        ),
        (
            lambda: kind_of_leaf("pinnate", leaflet_length=0.2),
            "leaflet_length must be at most the length 0.1 metres, got 0.2",
        ),
        (lambda: kind_of_leaf("bipinnate", leaflets=1), "leaflets must be 2 or more on each pinna, got 1"),
        (
            lambda: LeafColors(summer=(1, 2)),
            "summer must be three sRGB numbers from 0 to 255 or '#rrggbb', got (1, 2)",
        ),
        (
            lambda: LeafColors(vein=[1, 2, 256]),
            "vein must be three sRGB numbers from 0 to 255 or '#rrggbb', got [1, 2, 256]",
        ),
        (
            lambda: LeafColors(autumn="red"),
            "autumn must be three sRGB numbers from 0 to 255 or '#rrggbb', got 'red'",
        ),
        (
            lambda: LeafColors(summer=None),
            "summer must be three sRGB numbers from 0 to 255 or '#rrggbb', got None",
        ),
        (lambda: LeafColors(variation=2), "variation must be from 0 to 1, got 2"),
        (lambda: draw(PLAIN, size=100), "size_px must be a power of two from 32 to 2048 pixels, got 100"),
        (lambda: draw(PLAIN, size=4096), "size_px must be a power of two from 32 to 2048 pixels, got 4096"),
        (
            lambda: draw(PLAIN, season="may"),
            "season must be one of spring, summer, autumn, winter, got 'may'",
        ),
        (
            lambda: draw(PLAIN, season="winter"),
            "there are no leaves in winter: colors.winter is left out",
        ),
        (lambda: draw_leaf(PLAIN, EVEN, rng=3), "rng must be a numpy.random.Generator, got int"),
        (lambda: outline(PLAIN, 4), "n must be a whole number of 8 or more points, got 4"),
        (
            lambda: encode_png(np.zeros((4, 4), np.uint8)),
            "picture must be (h, w, 3 or 4) uint8, got (4, 4) uint8",
        ),
        (
            lambda: encode_webp(np.zeros((4, 4, 3))),
            "picture must be (h, w, 3 or 4) uint8, got (4, 4, 3) float64",
        ),
        (
            lambda: encode_webp(np.zeros((4, 4, 3), np.uint8), 101),
            "quality must be a whole number from 0 to 100, got 101",
        ),
    ],
)
def test_messages(make, message):
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value) == message


# ---------------------------------------------------------------- house


@pytest.mark.parametrize("kind", [LeafShape, LeafColors])
def test_the_page_has_every_field(kind):
    page = (ROOT / "docs" / "leaves.md").read_text(encoding="utf-8")
    for row in field_table(kind):
        lines = [line for line in page.splitlines() if line.startswith(f"| `{row['name']}` |")]
        assert lines, row["name"]
        if row["low"] is not None:
            assert any(f"| {row['low']} to {row['high']} |" in line for line in lines), row["name"]
        assert any(row["what"] in line for line in lines), row["name"]


def test_importing_it_is_cheap():
    program = (
        "import sys, species.leafart, species.barkart; print(*{'scipy', 'PIL', 'numba'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
