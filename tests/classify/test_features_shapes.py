"""Features of bodies whose measures are known: sizes, slabs, profiles, shapes, normals, gaps, stems."""

import numpy as np
import pytest
from scipy.optimize import brentq

from classify.features import describe_scan
from tests.classify.feature_clouds import comb_tree, lollipop, pole, solid, turned
from treegraph import TreeGraph


@pytest.fixture(scope="module")
def cylinder():
    """An elliptic crown from 4 to 8 m with radii of 2 and 1 m on a pole of 30 cm, turned by 0.7."""
    return describe_scan(turned(lollipop(np.random.default_rng(0)), 0.7))


def box(rng, n, low, high):
    return solid(rng, n, low, high, lambda p: np.ones(len(p), bool))


def rods(rng, n_rods, slope, length=2.0, height=6.0, n=80):
    """Rods that start on the axis at any height and rise outwards by `slope`, and the axis itself."""
    angle, foot = rng.random(n_rods) * 2.0 * np.pi, rng.random(n_rods) * height + 2.0
    way = np.stack(
        [np.cos(angle) * np.cos(slope), np.sin(angle) * np.cos(slope), np.full(n_rods, np.sin(slope))], 1
    )
    along = np.linspace(0.3, length, n)
    rod = way[:, None] * along[:, None] + foot[:, None, None] * [0.0, 0.0, 1.0]
    return np.concatenate([rod.reshape(-1, 3), pole(rng, 2000, height + 2.0, 0.02)])


# ---------------------------------------------------------------- sizes


def test_sizes_of_a_known_tree(cylinder):
    """Widths are between the quantiles 0.01 and 0.99 of an even ellipse seen from the side."""
    around = np.linspace(0.0, np.pi, 1000)
    inner = brentq(lambda x: 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi - 0.99, 0.0, 1.0)
    width = inner * np.mean(2.0 * np.hypot(2.0 * np.cos(around), np.sin(around)))
    for name, value, within in (
        ("height", 8.0, 0.02),
        ("crown_width_long", 4.0 * inner, 0.08),
        ("crown_width_short", 2.0 * inner, 0.05),
        ("crown_width", width, 0.05),
        ("crown_base", 4.0, 0.2),
        ("crown_height", 4.0, 0.2),
        ("trunk_spread", 0.3, 0.02),
        ("crown_offset", 0.0, 0.03),
        ("crown_profile_volume", np.pi * 2.0 * 1.0 * 4.0, 1.5),
        ("crown_area", np.pi * 2.0 * 1.0, 1.0),
        ("crown_fill", 1.1, 0.15),
        ("crown_roundness", 0.5, 0.02),
        ("width_to_height", width / 8.0, 0.02),
        ("crown_height_share", 0.5, 0.03),
        ("trunk_spread_to_height", 0.3 / 8.0, 0.003),
        ("crown_profile_volume_to_cube", np.pi * 8.0 / 8.0**3, 0.003),
    ):
        assert cylinder[name] == pytest.approx(value, abs=within), name


def test_a_crown_to_one_side_is_off_the_foot():
    rng = np.random.default_rng(1)
    crown = lollipop(rng, crown=(1.0, 1.0), base=4.0, top=7.0)
    crown[crown[:, 2] > 4.0] += [1.5, 0.0, 0.0]
    vector = describe_scan(crown)
    assert vector["crown_offset"] == pytest.approx(1.5, abs=0.05)
    assert vector["crown_offset_to_height"] == pytest.approx(1.5 / 7.0, abs=0.01)


def test_the_trunk_is_measured_where_the_skeleton_has_it():
    cloud = lollipop(np.random.default_rng(2), crown=(2.0, 2.0), base=5.0, top=10.0)
    vector = describe_scan(cloud, comb_tree())  # radius 0.2 to 0.05 over 10 m
    assert vector["breast_width"] == pytest.approx(2.0 * (0.2 - 0.015 * 1.3), rel=1e-6)
    assert vector["trunk_width"] == pytest.approx(2.0 * (0.2 - 0.015 * 1.0), rel=0.03)
    assert vector["trunk_width_to_height"] == pytest.approx(vector["trunk_width"] / vector["height"])


# ---------------------------------------------------------------- slabs


def test_slabs_of_an_even_crown(cylinder):
    """Even from 4 to 8: the mean is 6, those of the halves are 5 and 7."""
    for slab, height in (("lower", 1.0), ("middle", 2.0), ("upper", 1.0)):
        assert cylinder[f"slab_{slab}_height"] == pytest.approx(height, abs=0.2), slab
        assert cylinder[f"slab_{slab}_radius_long"] == pytest.approx(2.0, abs=0.12), slab
        assert cylinder[f"slab_{slab}_radius_short"] == pytest.approx(1.0, abs=0.08), slab
        assert 0.9 < cylinder[f"slab_{slab}_fill"] < 1.7, slab  # boxes stand out at the ends
        assert cylinder[f"slab_{slab}_roundness"] == pytest.approx(0.5, abs=0.04), slab
    assert cylinder["slab_middle_height_share"] == pytest.approx(0.5, abs=0.03)


def test_slabs_of_a_cone_grow_narrower():
    rng = np.random.default_rng(3)
    cone = solid(
        rng, 60_000, [-2, -2, 0], [2, 2, 8], lambda p: np.hypot(p[:, 0], p[:, 1]) < (8.0 - p[:, 2]) / 4.0
    )
    vector = describe_scan(cone)
    lower, middle, upper = (vector[f"slab_{s}_radius_long"] for s in ("lower", "middle", "upper"))
    assert lower > 1.2 * middle > 1.8 * upper
    assert vector["width_slope_lower"] < -0.5
    assert vector["width_slope_upper"] < -0.5
    assert vector["widest_share"] < 0.25
    assert vector["height_skewness"] > 0.5


def test_tips_are_counted_in_their_slabs():
    """The crown is even from 4 to 10: planes at 5.5 and 8.5; tips at 10, 6 and twice in between."""
    cloud = lollipop(np.random.default_rng(4), crown=(2.5, 2.5), base=4.0, top=10.0)
    foot = [(0.0, 0.0, 0.0), (0.0, 0.0, 4.0)]
    tips = [(1.0, 0.0, 5.0), (0.0, 1.0, 7.0), (0.0, -1.0, 7.5), (0.0, 0.0, 9.5)]
    vector = describe_scan(cloud, TreeGraph([-1, 0, 1, 1, 1, 1], foot + tips, [0.1] * 6))
    assert [vector[f"slab_{s}_tip_share"] for s in ("lower", "middle", "upper")] == [0.25, 0.5, 0.25]
    assert vector["slab_middle_tips"] == pytest.approx(2.0 / (np.pi * 2.5**2 * 3.0), rel=0.1)


# ---------------------------------------------------------------- profiles


def test_profile_of_an_even_column():
    column = box(np.random.default_rng(5), 60_000, [-0.5, -0.5, 0.0], [0.5, 0.5, 10.0])
    vector = describe_scan(column)
    for k in range(1, 11):
        assert vector[f"layer_{k}_share"] == pytest.approx(0.1, abs=0.012), k
        assert vector[f"layer_{k}_width"] == pytest.approx(1.0, abs=0.04), k
    for percent in (10, 25, 50, 75, 90):
        assert vector[f"height_quantile_{percent}"] == pytest.approx(percent / 100.0, abs=0.02)
    assert vector["height_mean"] == pytest.approx(0.5, abs=0.01)
    assert vector["height_spread"] == pytest.approx(np.sqrt(1 / 12), abs=0.01)
    assert vector["height_skewness"] == pytest.approx(0.0, abs=0.05)
    assert vector["height_kurtosis"] == pytest.approx(1.8, abs=0.05)
    assert vector["height_entropy"] == pytest.approx(1.0, abs=0.005)
    assert vector["layering"] < 0.1


def test_whorls_are_layers():
    rng = np.random.default_rng(6)
    column = box(rng, 40_000, [-1.0, -1.0, 0.0], [1.0, 1.0, 10.0])
    whorls = column[(column[:, 2] % 1.0) < 0.25]
    assert describe_scan(whorls)["layering"] > describe_scan(column)["layering"] + 0.3


def test_cells_of_a_disc_and_of_a_shell():
    rng = np.random.default_rng(7)
    inside = describe_scan(lollipop(rng, crown=(2.0, 2.0), base=0.1, top=8.0, n=60_000))
    shell = describe_scan(pole(rng, 30_000, 8.0, 2.0))
    rim = np.sqrt(0.9)  # of the distances in a disc 90% are below
    for part in ("low", "middle", "high"):
        assert inside[f"outwardness_{part}"] == pytest.approx(2 / 3 / rim, abs=0.03)
        assert shell[f"outwardness_{part}"] == pytest.approx(1.0, abs=0.03)
    assert shell["ring_4_share"] == pytest.approx(1.0, abs=0.01)
    rings = [inside[f"ring_{k}_share"] for k in (1, 2, 3, 4)]
    edges = np.array([0.0, 0.25, 0.5, 0.75]) * rim
    np.testing.assert_allclose(rings, np.diff([*edges**2, 1.0]), atol=0.03)


def test_a_flat_crown_has_two_sides_and_a_round_one_none():
    rng = np.random.default_rng(8)
    flat = describe_scan(box(rng, 30_000, [-4.0, -0.5, 0.0], [4.0, 0.5, 5.0]))
    cube = describe_scan(box(rng, 30_000, [-2.0, -2.0, 0.0], [2.0, 2.0, 5.0]))
    assert flat["azimuth_flatness"] > 0.8
    assert cube["azimuth_flatness"] < 0.05
    assert cube["azimuth_lean"] < 0.03


# ---------------------------------------------------------------- shapes around, and directions


@pytest.mark.parametrize("slope_deg", [-40, 0, 40])
def test_branches_rise_or_droop_outwards(slope_deg):
    slope = np.radians(slope_deg)
    vector = describe_scan(rods(np.random.default_rng(9), 20, slope, length=5.0, n=300))
    assert vector["axis_rise_fine_middle"] == pytest.approx(np.sin(slope), abs=0.15)
    assert vector["axis_outwards_middle"] > 0.5


def test_wires_walls_and_fill_have_the_shapes_that_they_have():
    rng = np.random.default_rng(10)
    foot = np.stack(np.meshgrid([-2.0, 0.0, 2.0], [-2.0, 0.0, 2.0]), axis=-1).reshape(-1, 2)
    z = np.linspace(0.0, 8.0, 800)
    wires = np.concatenate([np.stack([x + 0 * z, y + 0 * z, z], axis=1) for x, y in foot])
    walls = pole(rng, 60_000, 8.0, 2.0)
    fill = box(rng, 200_000, [-2.0, -2.0, 0.0], [2.0, 2.0, 8.0])
    wires, walls, fill = describe_scan(wires), describe_scan(walls), describe_scan(fill)
    assert wires["linearity_fine"] > 0.9 > walls["linearity_fine"]
    assert walls["planarity_fine"] > wires["planarity_fine"] + 0.3
    assert walls["planarity_fine"] > fill["planarity_fine"] + 0.1
    assert fill["scattering_fine"] > walls["scattering_fine"] + 0.15
    assert wires["scattering_fine"] < 0.02
    assert wires["uprightness_fine"] > 0.99
    assert fill["uprightness_fine"] == pytest.approx(0.5, abs=0.1)
    assert walls["normal_tilt_90"] < 0.1  # level normals ...
    assert walls["normal_outwards_middle"] > 0.95  # ... that point outwards
    assert wires["axis_tilt_10"] > 0.95


def test_random_directions_are_as_often_below_as_the_share_says():
    """|z| of directions that are even on the sphere is even from 0 to 1: Archimedes' hat box."""
    rng = np.random.default_rng(17)
    way = rng.normal(size=(300, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    middle = rng.random((300, 3)) * [8.0, 8.0, 8.0]
    sticks = middle[:, None] + np.linspace(-0.9, 0.9, 60)[:, None] * way[:, None]
    vector = describe_scan(sticks.reshape(-1, 3) + [0.0, 0.0, 1.0])
    for percent in (10, 25, 50, 75, 90):
        assert vector[f"axis_tilt_{percent}"] == pytest.approx(percent / 100.0, abs=0.1)


def test_level_sheets_have_upright_normals():
    rng = np.random.default_rng(11)
    sheet = box(rng, 60_000, [-2.0, -2.0, 0.0], [2.0, 2.0, 6.0])
    sheet[:, 2] = 0.3 + 2.7 * np.round(sheet[:, 2] / 3.0)
    vector = describe_scan(sheet)
    assert vector["normal_tilt_10"] > 0.95
    assert vector["axis_tilt_90"] < 0.1
    for part in ("low", "middle", "high"):
        assert vector[f"normal_z_{part}"] > 0.95
        assert vector[f"normal_tilt_25_{part}"] > 0.95


# ---------------------------------------------------------------- gaps and stems


def test_dimensions_of_lines_sheets_and_bodies():
    rng = np.random.default_rng(12)
    line = np.stack([np.zeros(5000), np.zeros(5000), np.linspace(0.0, 8.0, 5000)], axis=1)
    wall = box(rng, 100_000, [-4.0, 0.0, 0.0], [4.0, 0.0, 8.0])
    body = box(rng, 300_000, [-4.0, -4.0, 0.0], [4.0, 4.0, 8.0])
    for k, cloud in enumerate((line, wall, body), 1):
        vector = describe_scan(cloud)
        for step, m in (("1_32", 2), ("1_16", 4)):  # fine cells in the box's edge
            expected = np.log2(((2 * m) ** k - 1) / (m**k - 1))  # near k, for boxes that are filled
            assert vector[f"pair_dimension_{step}"] == pytest.approx(expected, abs=0.25), (k, step)
    assert describe_scan(line)["largest_piece_1_16"] == 1.0


def test_tufts_are_uneven_and_a_full_crown_is_not():
    rng = np.random.default_rng(18)
    full = box(rng, 60_000, [-3.0, -3.0, 0.0], [3.0, 3.0, 8.0])
    middle = box(rng, 25, [-3.0, -3.0, 0.0], [3.0, 3.0, 8.0])
    tufts = (middle[:, None] + 0.25 * rng.normal(size=(25, 2400, 3))).reshape(-1, 3)
    even, uneven = describe_scan(full), describe_scan(tufts + [0.0, 0.0, 0.7])
    assert uneven["cell_unevenness"] > even["cell_unevenness"] + 0.3
    assert uneven["point_unevenness"] > even["point_unevenness"] + 0.5
    assert uneven["crown_fill"] < even["crown_fill"]


def test_pieces_of_a_crown_in_two():
    rng = np.random.default_rng(13)
    low = box(rng, 20_000, [-1.0, -1.0, 0.0], [1.0, 1.0, 3.0])
    high = box(rng, 20_000, [-1.0, -1.0, 5.0], [1.0, 1.0, 8.0])
    vector = describe_scan(np.concatenate([low, high]))
    for step in ("1_16", "1_8"):
        assert vector[f"n_pieces_{step}"] == 2.0
        assert vector[f"largest_piece_{step}"] == pytest.approx(0.5, abs=0.1)
    assert describe_scan(low)["core_share_1_16"] > 0.4


def test_sectors_of_a_round_and_of_a_half_crown():
    rng = np.random.default_rng(14)
    whole = lollipop(rng, crown=(2.0, 2.0), base=0.1, top=8.0)
    spokes = whole[np.arctan2(whole[:, 1], whole[:, 0]) % (np.pi / 3.0) < np.pi / 6.0]
    vector, gapped = describe_scan(whole), describe_scan(spokes)
    for part in ("low", "middle", "high"):
        assert vector[f"sector_unevenness_{part}"] < 0.15
        assert gapped[f"sector_unevenness_{part}"] > 0.5
        assert gapped[f"empty_sectors_{part}"] > vector[f"empty_sectors_{part}"]


@pytest.mark.parametrize("n_stems", [1, 2, 3])
def test_stems_are_counted(n_stems):
    rng = np.random.default_rng(15)
    angle = np.arange(n_stems) * 2.0 * np.pi / n_stems
    feet = 1.5 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) * (n_stems > 1)
    stems = np.concatenate([pole(rng, 3000, 5.0, 0.1) + foot for foot in feet])
    crown = box(rng, 40_000, [-2.5, -2.5, 5.0], [2.5, 2.5, 9.0])
    vector = describe_scan(np.concatenate([stems, crown]))
    assert vector["n_stems"] == n_stems
    assert [vector[f"n_stems_{cut}"] for cut in (5, 10, 15, 20, 30, 40)] == [n_stems] * 6
    assert vector["cut_10_share"] < 0.2


def test_leaders_of_a_fork():
    """Two alike from 2 m up, and a thin branch that is no leader."""
    cloud = box(np.random.default_rng(16), 5000, [-1.0, -1.0, 0.0], [1.0, 1.0, 10.0])
    at = [(0, 0, 0), (0, 0, 2), (1, 0, 10), (-1, 0, 10), (0, 0.5, 6)]
    vector = describe_scan(cloud, TreeGraph([-1, 0, 1, 1, 1], at, [0.2, 0.2, 0.15, 0.12, 0.02]))
    assert [vector[f"n_leaders_{cut}"] for cut in (5, 10, 15, 30, 50)] == [1.0, 1.0, 1.0, 2.0, 2.0]
    assert vector["n_leaders"] == pytest.approx((1 + 1 + 1 + 2 + 2 + 2) / 6, abs=0.17)
