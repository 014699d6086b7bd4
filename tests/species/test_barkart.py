"""Bark drawn from numbers: no seams, what is counted is there, and what is refused."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.testing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from leaf_examples import BARK, COLORS, LEAF
from scipy import ndimage

from species._art_fields import field_table
from species._art_pixels import periodic_noise
from species.barkart import BARKS, BarkShape, draw_bark, encode_webp
from species.leafart import draw_leaf
from treegraph import InputError

ROOT = Path(__file__).parents[2]
CLEAN = {"weave": 0.0, "roughness": 0.0, "variation": 0.0, "crack": 0.3}
BUDGET = 120_000  # bytes of a species' leaf and bark with their normals, of the 200 000 for all of it


@cache
def draw(shape, size=256, seed=0):
    return draw_bark(shape, size, rng=np.random.default_rng(seed))


def brightness(texture):
    return texture.rgba[:, :, :3].astype(float).mean(axis=2)


def count_runs(mask):
    """How many stretches of True there are on a line whose ends meet."""
    return int(np.sum(mask & ~np.roll(mask, 1)))


def label_on_torus(mask):
    """How many pieces there are when opposite borders meet."""
    label, n = ndimage.label(mask)
    parent = list(range(n + 1))

    def top(i):
        while parent[i] != i:
            i = parent[i]
        return i

    for a, b in [*zip(label[0], label[-1], strict=True), *zip(label[:, 0], label[:, -1], strict=True)]:
        if a and b:
            parent[top(a)] = top(b)
    return len({top(i) for i in range(1, n + 1)})


# ---------------------------------------------------------------- no seams


@pytest.mark.parametrize("size", [(64, 64), (32, 128)])
def test_noise_is_a_filter_that_wraps(size):
    white = np.random.default_rng(3).standard_normal(size)
    noise = periodic_noise(np.random.default_rng(3), size, 0.05, 0.1)
    smooth = ndimage.gaussian_filter(white, (0.05 * size[0], 0.1 * size[1]), mode="wrap", truncate=8)
    smooth -= smooth.mean()
    npt.assert_allclose(noise, smooth / smooth.std(), atol=1e-3)
    assert noise.std() == pytest.approx(1.0)
    assert noise.mean() == pytest.approx(0.0, abs=1e-12)


def test_noise_without_contrast_is_flat():
    npt.assert_allclose(periodic_noise(np.random.default_rng(0), (32, 32), 9.0, 9.0), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", list(BARK))
@pytest.mark.parametrize("axis", [0, 1])
def test_opposite_borders_continue_each_other(name, axis):
    """The step over the border is one of the steps within: no rarer than one in a hundred is larger."""
    texture = draw(BARK[name])
    for picture in (texture.rgba[:, :, :3], texture.normal):
        values = picture.astype(float)
        step = np.abs(values - np.roll(values, 1, axis=axis)).mean(axis=2)
        by_line = step.mean(axis=1 - axis)
        assert by_line[0] <= np.quantile(by_line[1:], 0.99) * 1.15 + 0.5


@pytest.mark.parametrize("kind", BARKS)
def test_a_seam_would_be_seen(kind):
    """The test above is no formality: cut in the middle and put together wrongly, it fails for most."""
    values = draw(BarkShape(kind, count=5, marks=0.5)).rgba[:, :, :3].astype(float)
    broken = values[:, :200]
    step = np.abs(broken - np.roll(broken, 1, axis=1)).mean(axis=(0, 2))
    if kind != "rings":  # which hardly change around the stem
        assert step[0] > 1.5 * np.median(step[1:])


# ---------------------------------------------------------------- what is counted


@pytest.mark.parametrize("n", [3, 6, 11])
def test_ridges_are_found_again(n):
    line = brightness(draw(BarkShape("ridged", count=n, **CLEAN))).mean(axis=0)
    assert count_runs(line < 0.5 * (line.min() + line.max())) == n


@pytest.mark.parametrize("n", [2, 5, 9])
def test_rings_are_found_again(n):
    line = brightness(draw(BarkShape("rings", count=n, **CLEAN))).mean(axis=1)
    assert count_runs(line < 0.5 * (line.min() + line.max())) == n


@pytest.mark.parametrize("n, stretch, rows", [(6, 1.5, 4), (8, 2.0, 4), (4, 1.0, 4)])
def test_plates_are_found_again(n, stretch, rows):
    shape = BarkShape("plates", count=n, stretch=stretch, **{**CLEAN, "crack": 0.5})
    grey = brightness(draw(shape))
    assert label_on_torus(grey > 0.5 * (grey.min() + grey.max())) == n * rows


def test_diamonds_are_found_again():
    """n and m turns of crossing furrows leave 2 n m diamonds."""
    grey = brightness(draw(BarkShape("diamond", count=6, stretch=3.0, **CLEAN), size=512))
    assert label_on_torus(grey > 0.6 * grey.max()) == 2 * 6 * 2


def test_ridges_run_along_the_stem_and_lenticels_across():
    def grain(shape):
        grey = brightness(draw(shape))
        return np.abs(np.diff(grey, axis=1)).mean() / np.abs(np.diff(grey, axis=0)).mean()

    assert grain(BarkShape("ridged", stretch=5.0, roughness=0.0)) > 1.8
    assert grain(BarkShape("lenticels", marks=0.5, roughness=0.0)) < 0.6


def test_more_marks_are_more_of_their_colour():
    share = []
    for marks in (0.0, 0.4, 0.9):
        shape = BarkShape("lenticels", marks=marks, color=(230, 230, 230), deep=(150,) * 3, mark=(0, 0, 0))
        share.append((brightness(draw(shape)) < 70).mean())
    assert share[0] < 0.02 < share[1] < share[2] < 0.7


def test_flakes_are_flat():
    grey = brightness(draw(BarkShape("patched", count=3, **CLEAN)))
    values, n = np.unique(np.rint(grey), return_counts=True)
    assert np.sort(n)[-4:].sum() > 0.75 * grey.size  # four levels, little between them


def test_colours_are_those_asked_for():
    shape = BarkShape("plates", color=(200, 120, 60), deep=(20, 10, 0), count=4, **CLEAN)
    rgb = draw(shape).rgba[:, :, :3].reshape(-1, 3).astype(int)
    assert (np.abs(rgb.min(axis=0) - [20, 10, 0]) <= 6).all()
    assert (rgb.max(axis=0) <= [201, 121, 61]).all() and (rgb.max(axis=0) >= [170, 100, 50]).all()


# ---------------------------------------------------------------- normals


@pytest.mark.parametrize("name", list(BARK))
def test_normals_are_unit_vectors_that_look_out(name):
    normal = draw(BARK[name], size=128).normal / 127.5 - 1.0
    npt.assert_allclose(np.linalg.norm(normal, axis=2), 1.0, atol=0.012)
    assert normal[:, :, 2].min() > 0.2
    assert np.abs(normal[:, :, :2].mean(axis=(0, 1))).max() < 0.06  # leans nowhere on the whole


@pytest.mark.parametrize("kind", BARKS)
def test_no_depth_is_flat(kind):
    assert (draw(BarkShape(kind, depth=0.0), size=64).normal == [128, 128, 255]).all()


def test_normals_lean_away_from_a_ridge():
    """Right of a furrow the surface rises to the right: the normal leans left, and the other way round."""
    texture = draw(BarkShape("ridged", count=4, depth=0.02, **CLEAN))
    red = texture.normal[128, :, 0].astype(int)
    dark = brightness(texture)[128]
    change = np.roll(dark, -1) - np.roll(dark, 1)
    assert (red[change > 12] < 120).all() and (red[change < -12] > 136).all()
    assert (change > 12).any()


def test_rings_overhang_upwards():
    """Row 0 is up: where it gets brighter upwards the surface rises and the normal leans down."""
    texture = draw(BarkShape("rings", count=4, depth=0.02, **CLEAN))
    rise = -np.gradient(brightness(texture).mean(axis=1))
    green = texture.normal[:, :, 1].astype(float).mean(axis=1)
    assert (green[rise > 4] < 110).all() and (rise > 4).any()


# ---------------------------------------------------------------- the whole


@pytest.mark.parametrize("kind", BARKS)
def test_same_seed_same_bytes(kind):
    one, two, other = (draw.__wrapped__(BarkShape(kind), 64, seed) for seed in (4, 4, 5))
    assert one.rgba.tobytes() == two.rgba.tobytes()
    assert one.normal.tobytes() == two.normal.tobytes()
    assert one.rgba.tobytes() != other.rgba.tobytes()
    assert one.rgba.shape == (64, 64, 4) and one.normal.shape == (64, 64, 3)
    assert (one.rgba[:, :, 3] == 255).all()
    assert one.tile == 0.3


def test_every_kind_of_bark_is_among_the_examples():
    assert {shape.kind for shape in BARK.values()} == set(BARKS)
    assert list(BARK) == list(LEAF) == list(COLORS)


@pytest.mark.parametrize("name", list(LEAF))
def test_a_species_pictures_are_small(name):
    leaf = draw_leaf(LEAF[name], COLORS[name], rng=np.random.default_rng(0))
    bark = draw(BARK[name])
    files = [encode_webp(picture) for picture in (leaf.rgba, leaf.normal, bark.rgba, bark.normal)]
    assert sum(map(len, files)) < BUDGET / 2


@given(
    st.fixed_dictionaries(
        {
            "kind": st.sampled_from(BARKS),
            "count": st.integers(1, 40),
            "stretch": st.floats(0.2, 12),
            "weave": st.floats(0, 1),
            "depth": st.floats(0, 0.1),
            "crack": st.floats(0, 1),
            "roughness": st.floats(0, 1),
            "marks": st.floats(0, 1),
            "variation": st.floats(0, 1),
            "tile": st.floats(0.02, 5),
        }
    )
)
@settings(max_examples=50, deadline=None)
def test_any_legal_bark_can_be_drawn(values):
    texture = draw(BarkShape(**values), size=32)
    assert (texture.normal[:, :, 2] >= 128).all()
    assert texture.tile == values["tile"]


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "row", [row for row in field_table(BarkShape) if row["low"] is not None], ids=lambda row: row["name"]
)
def test_every_number_has_its_range_in_its_message(row):
    unit = f" {row['unit']}" if row["unit"] else ""
    whole = "a whole number " if row["whole"] else ""
    rule = f"{row['name']} must be {whole}from {row['low']} to {row['high']}{unit}, got "
    for wrong in (row["low"] - 1, row["high"] + 1, float("nan"), "x", True, None):
        with pytest.raises(InputError) as caught:
            BarkShape("smooth", **{row["name"]: wrong})
        assert str(caught.value) == f"{rule}{wrong!r}"


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: BarkShape("bare"), f"kind must be one of {', '.join(BARKS)}, got 'bare'"),
        (
            lambda: BarkShape("smooth", color="grey"),
            "color must be three sRGB numbers from 0 to 255 or '#rrggbb', got 'grey'",
        ),
        (
            lambda: replace(BarkShape("smooth"), mark=(1, 2, True)),
            "mark must be three sRGB numbers from 0 to 255 or '#rrggbb', got (1, 2, True)",
        ),
        (
            lambda: draw(BarkShape("smooth"), 200),
            "size_px must be a power of two from 32 to 2048 pixels, got 200",
        ),
        (
            lambda: draw_bark(BarkShape("smooth"), rng=None),
            "rng must be a numpy.random.Generator, got NoneType",
        ),
    ],
)
def test_messages(make, message):
    with pytest.raises(InputError) as caught:
        make()
    assert str(caught.value) == message


def test_the_page_has_every_field():
    page = (ROOT / "docs" / "leaves.md").read_text(encoding="utf-8")
    for row in field_table(BarkShape):
        lines = [line for line in page.splitlines() if line.startswith(f"| `{row['name']}` |")]
        assert any(row["what"] in line for line in lines), row["name"]
        if row["low"] is not None:
            assert any(f"| {row['low']} to {row['high']} |" in line for line in lines), row["name"]
