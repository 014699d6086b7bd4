import numpy as np
import numpy.testing as npt
import pytest
from synthetic import FORKED, crown, forked_tree, tube

from recon import Cloud, EncodeSettings, PrepareSettings, encode, prepare
from recon.ground import find_ground
from recon.plots import stem_columns
from recon.preparing import _turned
from treegraph.errors import InputError


def plain(rng, half=3.0, n=20000, slope=0.0, rough=0.02):
    xy = rng.uniform(-half, half, (n, 2))
    return np.column_stack([xy, slope * xy[:, 0] + rough * rng.standard_normal(n)])


def shifted(parts, dx, dy):
    return [((a[0] + dx, a[1] + dy, a[2]), (b[0] + dx, b[1] + dy, b[2]), r, s) for a, b, r, s in parts]


# ---- what is kept


def test_a_clean_tree_is_left_whole(rng):
    xyz = forked_tree(rng)
    got = prepare(xyz)
    npt.assert_array_equal(got.index, np.arange(len(xyz)))
    npt.assert_allclose(got.cloud.xyz + got.cloud.origin, xyz, atol=1e-9)
    assert got.ground_z is None and got.looks_like_many == 1 and got.notes == ()


@pytest.mark.parametrize("offset", [(0, 0, 0), (312_500.25, 5_204_000.5, 871.125), (-2e6, 1e6, -40)])
def test_the_foot_of_the_trunk_is_the_origin(rng, offset):
    xyz = forked_tree(rng) + offset
    got = prepare(xyz)
    npt.assert_allclose(got.cloud.origin, offset, atol=0.03)
    npt.assert_allclose(
        got.cloud.xyz + got.cloud.origin, xyz[got.index], atol=1e-9 * max(1, np.abs(offset).max())
    )


def test_doubles_go_and_are_said(rng):
    xyz = forked_tree(rng)
    got = prepare(np.concatenate([xyz, xyz[:500]]))
    assert len(got.index) == len(xyz)
    assert np.unique(got.cloud.xyz, axis=0).shape == got.cloud.xyz.shape
    assert got.notes == (f"500 of {len(xyz) + 500} points were there twice",)


@pytest.mark.parametrize("where", [(1000.0, 0, 0), (0, 0, -30.0), (5e5, 5e5, 0)])
def test_a_stray_point_goes_and_the_tree_stays(rng, where):
    xyz = forked_tree(rng)
    got = prepare(np.concatenate([xyz, [where], np.add([where], 0.1)]))
    npt.assert_array_equal(got.index, np.arange(len(xyz)))
    assert got.notes == (f"2 of {len(xyz) + 2} points are strays far from the tree",)


def test_a_crown_over_a_gap_is_no_stray(rng):
    xyz = np.concatenate([tube((0, 0, 0), (0, 0, 1.2), 0.1, 0.1, 3000, rng), crown(rng, 3000, (0, 0, 3.2))])
    assert len(prepare(xyz).index) == len(xyz)


def test_a_sparse_scan_is_not_taken_for_strays(rng):
    xyz = rng.random((4000, 3)) * [90.0, 90.0, 12.0]  # as from high above: no two points are near
    got = prepare(xyz)
    assert len(got.index) == 4000 and not any("stray" in note for note in got.notes)


def test_nan_rows_go(rng):
    xyz = forked_tree(rng)
    xyz[::50, 1] = np.nan
    got = prepare(xyz)
    assert np.isfinite(got.cloud.xyz).all()
    assert len(got.index) == len(xyz) - len(xyz[::50])


# ---- ground


@pytest.mark.parametrize("slope", [0.0, 0.3])
@pytest.mark.parametrize("half", [1.3, 6.0])
def test_ground_goes_and_the_trunk_stays(rng, slope, half):
    tree = forked_tree(rng)
    earth = plain(rng, half, int(3000 * half**2), slope)
    earth = earth[np.hypot(earth[:, 0], earth[:, 1]) > 0.1]
    got = prepare(np.concatenate([tree, earth]))
    is_tree = got.index < len(tree)
    assert (~is_tree).mean() < 0.01
    assert is_tree.sum() > 0.97 * len(tree)
    assert (got.cloud.xyz + got.cloud.origin)[
        is_tree, 2
    ].min() < 0.02  # the trunk keeps its points down to the ground
    assert got.ground_z == pytest.approx(0, abs=0.03)
    npt.assert_allclose(got.cloud.origin, 0, atol=0.05 + 0.2 * slope)
    assert "points are ground" in got.notes[-1]


def test_keep_ground(rng):
    xyz = np.concatenate([forked_tree(rng), plain(rng)])
    got = prepare(xyz, PrepareSettings(keep_ground=True))
    assert len(got.index) == len(xyz) and got.ground_z is None


def test_nothing_but_ground_is_said(rng):
    with pytest.raises(InputError, match=r"20000 of 20000 points look like ground.*pass keep_ground=True"):
        prepare(plain(rng))
    assert len(prepare(plain(rng), PrepareSettings(keep_ground=True)).index) == 20000


def test_roots_and_low_branches_are_no_ground(rng):
    roots = [
        tube((0, 0, 0.1), (0.5 * np.cos(a), 0.5 * np.sin(a), 0.0), 0.04, 0.02, 400, rng) for a in range(6)
    ]
    low = tube((0, 0, 1.0), (1.6, 0, 0.1), 0.03, 0.01, 800, rng)
    assert find_ground(np.concatenate([forked_tree(rng), *roots, low])) is None


def test_the_underside_of_a_crown_is_no_ground(rng):
    n = 20000
    r, a = 4 * np.sqrt(rng.random(n)), rng.random(n) * 2 * np.pi
    cone = np.column_stack([r * np.cos(a), r * np.sin(a), (4 - r) * rng.random(n) * 3 + 0.3 * r])
    assert find_ground(cone) is None


# ---- the foot


def foot_error(xyz, foot=(0, 0, 0)):
    return np.linalg.norm((prepare(xyz).cloud.origin - foot)[:2])


def test_foot_below_grass_and_a_drooping_branch(rng):
    grass = np.column_stack([rng.uniform(0.3, 1.0, (300, 2)), rng.uniform(-0.15, 0.2, 300)])
    droop = tube((0, 0, 1.4), (1.5, 0.4, -0.2), 0.03, 0.01, 900, rng)
    assert foot_error(np.concatenate([forked_tree(rng), grass, droop])) < 0.05


def test_foot_of_a_leaning_trunk(rng):
    lean = tube((2, 1, 0), (3.2, 1, 4.0), 0.12, 0.08, 15000, rng, noise=0.002)
    assert foot_error(lean, (2, 1, 0)) < 0.08


def test_foot_between_buttresses(rng):
    fins = [
        tube((0, 0, 0.8), (0.6 * np.cos(a), 0.6 * np.sin(a), 0.0), 0.08, 0.03, 1500, rng)
        for a in np.arange(3) * 2.1
    ]
    trunk = tube((0, 0, 0), (0, 0, 6), 0.2, 0.12, 30000, rng, noise=0.003)
    assert foot_error(np.concatenate([trunk, *fins])) < 0.2


def test_a_branch_of_another_tree_that_hangs_lower(rng):
    other = tube((3.0, 0, 2.5), (1.2, 0, -0.6), 0.04, 0.02, 1500, rng)
    assert foot_error(np.concatenate([forked_tree(rng), other])) < 0.05


def test_base_given_in_the_scans_coordinates(rng):
    xyz = forked_tree(rng) + [1000, 2000, 50]
    got = prepare(xyz, PrepareSettings(base=(1000.02, 2000.0, 50.0)))
    npt.assert_allclose(got.cloud.origin, (1000.02, 2000.0, 50.0), atol=1e-9)


@pytest.mark.parametrize(
    "base, message",
    [
        ((0, 0), "base must be three finite numbers"),
        ((0, 0, np.nan), "base must be three finite numbers"),
        ("abc", "base must be three finite numbers, got 'abc'"),
        ((0, 0, "x"), "base must be three finite numbers"),
        ((1e300, 0, 0), "base is 1.* m from the nearest point"),
        ((500.0, 0, 0), "base is 499.* m from the nearest point"),
    ],
)
def test_bad_base(rng, base, message):
    with pytest.raises(InputError, match=message):
        prepare(forked_tree(rng), PrepareSettings(base=base))


# ---- units and axes


@pytest.mark.parametrize("unit, factor", [("mm", 1000.0), ("cm", 100.0), ("ft", 1 / 0.3048)])
def test_units_are_converted_when_asked(rng, unit, factor):
    xyz = forked_tree(rng)
    got = prepare(xyz * factor, PrepareSettings(units=unit))
    npt.assert_allclose(got.cloud.xyz + got.cloud.origin, xyz, atol=1e-6)
    assert got.cloud.unit == "m"


@pytest.mark.parametrize("factor, guess", [(1000.0, "mm"), (100.0, "cm")])
def test_units_that_cannot_be_metres_are_an_error(rng, factor, guess):
    with pytest.raises(InputError, match=f"no tree is: pass units='{guess}'"):
        prepare(forked_tree(rng) * factor)
    assert prepare(forked_tree(rng) * factor, PrepareSettings(units="m")).cloud.unit == "m"


def test_feet_are_suspected_and_said(rng):
    got = prepare(forked_tree(rng) * [5, 5, 16])
    assert any("if it is in feet, pass units='ft'" in note for note in got.notes)


def test_the_unit_that_the_file_declares_is_used(rng):
    xyz = forked_tree(rng)
    got = prepare(Cloud(xyz / 0.3048, np.zeros(3), unit="ft"))
    npt.assert_allclose(np.ptp(got.cloud.xyz, axis=0), np.ptp(xyz, axis=0), rtol=1e-9)
    assert "the file says that it is in ft; it was converted to metres" in got.notes


def test_unknown_unit_and_axis(rng):
    with pytest.raises(InputError, match="units must be one of m, cm, mm, ft, got 'inch'"):
        prepare(forked_tree(rng), PrepareSettings(units="inch"))
    for up in ("w", "zz", "--z", "", None, 3):
        with pytest.raises(InputError, match=f"up must be one of z, y, x, -z, -y, -x, got {up!r}"):
            prepare(forked_tree(rng), PrepareSettings(up=up))


@pytest.mark.parametrize("up", ["z", "y", "x", "-z", "-y", "-x"])
def test_turning_is_a_rotation_that_lifts_the_axis(up):
    turned = _turned(np.eye(3), up)
    npt.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1)
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1 if up.startswith("-") else 1
    npt.assert_allclose(_turned(axis[None], up)[0], [0, 0, 1])


# ---- several trees


def two_trees(rng, distance=5.0):
    small = [(a, b, r, s) for a, b, r, s in shifted(FORKED, distance, 0.5)[:4]]
    return forked_tree(rng), forked_tree(rng, parts=small)


def test_two_trees_are_two(rng):
    big, small = two_trees(rng)
    assert prepare(np.concatenate([big, small])).looks_like_many == 2
    with pytest.raises(InputError, match="this looks like 2 trees, not one: pass largest=True"):
        encode(np.concatenate([big, small]))


def test_the_largest_is_taken_whole(rng):
    big, small = two_trees(rng)
    got = prepare(np.concatenate([big, small]), PrepareSettings(largest=True))
    assert (got.index < len(big)).mean() > 0.99
    assert (got.index < len(big)).sum() > 0.99 * len(big)
    npt.assert_allclose(got.cloud.origin, 0, atol=0.05)


def test_the_tree_at_a_given_base_is_taken(rng):
    big, small = two_trees(rng)
    got = prepare(np.concatenate([big, small]), PrepareSettings(base=(5.0, 0.5, 0.0)))
    assert (got.index >= len(big)).mean() > 0.99
    npt.assert_allclose(got.cloud.origin, (5.0, 0.5, 0.0), atol=1e-9)
    tree = encode(
        np.concatenate([big, small]),
        settings=EncodeSettings(f_s=1.0, prepare=PrepareSettings(base=(5.0, 0.5, 0.0))),
    )
    assert np.abs(tree.graph.position[:, 0]).max() < 2


def test_forty_trees_are_many(rng):
    parts = [((0, 0, 0), (0, 0, 5.0), 0.1, 0.05)]
    plot = [
        forked_tree(rng, parts=shifted(parts, 4.0 * i, 4.0 * j), density=1500)
        for i in range(8)
        for j in range(5)
    ]
    assert prepare(np.concatenate(plot)).looks_like_many == 40


@pytest.mark.parametrize("slope", [0.0, 0.25])
def test_stems_are_counted_on_any_ground(rng, slope):
    places = [(4.0 * i, 3.5 * j) for i in range(4) for j in range(3)]
    parts = [((x, y, slope * x), (x + 0.3, y, slope * x + 9.0), 0.12, 0.06) for x, y in places]
    plot = forked_tree(rng, parts=parts, density=2500)
    top = float(np.ptp(plot[:, 2]))
    centre, spread = stem_columns(plot, top)
    assert len(centre) == 12
    assert np.abs(np.sort(centre[:, 0]) - np.sort([x for x, _ in places])).max() < 0.3
    npt.assert_allclose(spread, 0.12, atol=0.03)
    crowns = np.concatenate([crown(rng, 400, (x, y, slope * x + 10.0), (2.2, 2.0, 2.0)) for x, y in places])
    got = prepare(np.concatenate([plot, crowns]), PrepareSettings(largest=True))
    assert np.ptp(got.cloud.xyz[:, :2], axis=0).max() < 6.5
    assert np.ptp(got.cloud.xyz[:, 2]) > 10.0


def test_a_tree_of_two_stems_is_one(rng):
    parts = [((0, 0, 0), (-0.5, 0, 5.0), 0.1, 0.05), ((0.1, 0, 0), (0.9, 0, 5.0), 0.1, 0.05)]
    assert prepare(forked_tree(rng, parts=parts)).looks_like_many == 1


def test_tree_numbers_of_the_file(rng):
    big, small = two_trees(rng)
    number = np.repeat([7, 3], [len(big), len(small)])
    cloud = Cloud(np.concatenate([big, small]), np.zeros(3), tree_id=number)
    assert prepare(cloud).looks_like_many == 2
    got = prepare(cloud, PrepareSettings(tree_id=3))
    assert got.looks_like_many == 1
    npt.assert_array_equal(got.index, np.arange(len(big), len(number)))
    npt.assert_allclose(got.cloud.origin, (5.0, 0.5, 0), atol=0.05)
    assert (prepare(cloud, PrepareSettings(largest=True)).index < len(big)).all()
    with pytest.raises(InputError, match="there is no tree 5; the scan has 3, 7"):
        prepare(cloud, PrepareSettings(tree_id=5))
    with pytest.raises(InputError, match="tree_id needs a scan with a tree number"):
        prepare(big, PrepareSettings(tree_id=1))


def test_lying_stems_are_remarked(rng):
    parts = [((0.0, 0, 5.0 + 2.5 * k), (0.0, 8.0, 5.0 + 2.5 * k), 0.06, 0.05) for k in range(4)]
    wall = np.column_stack(
        [rng.uniform(-4, 4, 9000), 0.01 * rng.standard_normal(9000), rng.uniform(0, 14, 9000)]
    )
    got = prepare(np.concatenate([forked_tree(rng, parts=parts), wall]))
    assert any("if that is up, pass up='y'" in note for note in got.notes)


def test_settings_reach_encode(rng):
    xyz = np.concatenate(two_trees(rng))
    tree = encode(xyz, settings=EncodeSettings(f_s=1.0, prepare=PrepareSettings(largest=True)))
    assert np.abs(tree.graph.position[:, 0]).max() < 2


@pytest.mark.parametrize("n", [1, 3, 15])
def test_too_few_points(rng, n):
    with pytest.raises(InputError, match=f"{n} usable points are too few for a tree"):
        prepare(rng.random((n, 3)))


def test_order_of_points_does_not_matter(rng):
    xyz = np.concatenate([forked_tree(rng), plain(rng)])
    shuffle = rng.permutation(len(xyz))
    a, b = prepare(xyz), prepare(xyz[shuffle])
    npt.assert_array_equal(np.sort(shuffle[b.index]), a.index)
    npt.assert_array_equal(a.cloud.origin, b.cloud.origin)
    assert a.stem_spread == b.stem_spread and a.ground_z == b.ground_z


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("distance", [3e4, 1e9, 1e15])
def test_two_places_far_apart_are_refused(rng, axis, distance):
    half = rng.random((300, 3)) * [0.2, 0.2, 3.0]
    away = np.zeros(3)
    away[axis] = distance
    with pytest.raises(InputError, match=r"the points spread over \S+ km, which no scan of a tree does"):
        prepare(np.concatenate([half, half + away]), PrepareSettings(units="m"))
