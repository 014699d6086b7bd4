"""The measure itself: known answers, before it judges anything."""

import numpy as np
import numpy.testing as npt
import pytest

from benchmarks.segments import (
    Samples,
    Segments,
    from_nodes,
    read_branch_polylines,
    read_cylinders,
    read_skeleton_nodes,
    sample,
)
from benchmarks.skeleton_truth import (
    SPACING,
    compare,
    points_against_radius,
    samples_of_points,
    weighted_median,
)

RATES = ("recall_2cm", "recall_3cm", "precision_2cm", "precision_3cm")


def tree(seed=0, n=60):
    """A random tree of upward segments about 10 cm long, and its radii."""
    rng = np.random.default_rng(seed)
    parent = np.r_[-1, [rng.integers(max(0, i - 4), i) for i in range(1, n)]]
    xyz = np.zeros((n, 3))
    for i in range(1, n):
        xyz[i] = xyz[parent[i]] + rng.normal(0.0, 0.06, 3) + [0.0, 0.0, 0.06]
    return from_nodes(parent, xyz, np.linspace(0.05, 0.01, n))


def straight(n=21, length=2.0):
    z = np.linspace(0.0, length, n)
    return from_nodes(np.arange(n) - 1, np.column_stack([0 * z, 0 * z, z]), np.full(n, 0.02))


def test_truth_against_itself_is_perfect():
    pieces = sample(tree(), SPACING)
    figures = compare(pieces, pieces, scan=pieces.xyz)
    assert all(figures[name] == 1.0 for name in RATES)
    assert figures["radius_error"] == 0.0 and figures["seen_share"] == 1.0
    assert figures["length_m"] == figures["true_length_m"]


def test_shift_of_25_mm_is_a_miss_at_2_cm_and_a_hit_at_3_cm():
    truth = straight()
    figures = compare(sample(truth.moved([0.025, 0.0, 0.0]), SPACING), sample(truth, SPACING))
    assert [figures[name] for name in RATES] == [0.0, 1.0, 0.0, 1.0]


def test_half_a_skeleton_has_half_the_recall():
    truth = sample(straight(), SPACING)
    half = sample(straight(n=11, length=1.0), SPACING)
    figures = compare(half, truth)
    npt.assert_allclose(figures["recall_2cm"], 0.51, atol=0.004)  # the tolerance reaches 2 cm past the end
    assert figures["precision_2cm"] == 1.0
    back = compare(truth, half)
    npt.assert_allclose(back["precision_2cm"], 0.51, atol=0.004)
    assert back["recall_2cm"] == 1.0


def test_a_finer_model_has_the_same_figures():
    truth, model = tree(1), tree(1).moved([0.01, 0.015, 0.0])
    coarse, fine = sample(model, SPACING), sample(model, SPACING / 5.0)
    for name in RATES:
        npt.assert_allclose(
            compare(coarse, sample(truth, SPACING))[name],
            compare(fine, sample(truth, SPACING))[name],
            atol=0.02,
        )


def test_radius_error_is_relative_and_signed():
    truth = tree(2)
    thick = Segments(truth.start, truth.end, 1.2 * truth.start_radius, 1.2 * truth.end_radius, truth.parent)
    figures = compare(sample(thick, SPACING), sample(truth, SPACING))
    npt.assert_allclose([figures["radius_error"], figures["radius_bias"]], 0.2)
    thin = Segments(truth.start, truth.end, 0.9 * truth.start_radius, 0.9 * truth.end_radius, truth.parent)
    figures = compare(sample(thin, SPACING), sample(truth, SPACING))
    npt.assert_allclose([figures["radius_error"], figures["radius_bias"]], [0.1, -0.1])


def test_unknown_radii_give_no_radius_error():
    pieces = samples_of_points(sample(straight(), SPACING).xyz)
    npt.assert_allclose(pieces.length.sum(), 2.0, rtol=0.02)
    assert np.isnan(compare(sample(straight(), SPACING), pieces)["radius_error"])


def test_what_the_scan_cannot_have_seen_is_left_out():
    truth = straight()
    lower = straight(n=11, length=1.0)
    bark = sample(lower, SPACING).xyz + [0.02, 0.0, 0.0]
    figures = compare(sample(lower, SPACING), sample(truth, SPACING), scan=bark)
    npt.assert_allclose(figures["recall_3cm"], 0.515, atol=0.004)
    npt.assert_allclose(figures["seen_share"], (1.0 + (0.07**2 - 0.02**2) ** 0.5) / 2.0, atol=0.005)
    assert figures["seen_recall_3cm"] > 0.96


def test_pieces_are_short_and_add_up():
    segments = tree(3)
    pieces = sample(segments, SPACING)
    assert pieces.length.max() <= SPACING * (1.0 + 1e-6)
    npt.assert_allclose(pieces.length.sum(), segments.length.sum())


def test_foot_of_a_side_branch_has_the_branch_radius():
    segments = from_nodes([-1, 0, 1, 1], np.eye(4, 3), np.array([0.2, 0.18, 0.17, 0.02]))
    npt.assert_allclose(segments.start_radius, [0.2, 0.18, 0.02])
    assert segments.parent.tolist() == [-1, 0, 0]


@pytest.mark.parametrize("seed", range(3))
def test_weighted_median_is_the_median_of_repeated_values(seed):
    rng = np.random.default_rng(seed)
    value, weight = rng.random(21), rng.integers(1, 6, 21)
    plain = np.sort(np.repeat(value, weight))
    assert weighted_median(value, weight) == plain[(len(plain) - 1) // 2]
    assert np.isnan(weighted_median(value[:0], weight[:0]))


def test_reads_nodes(tmp_path):
    path = tmp_path / "nodes.csv"
    path.write_text("# a remark\nid,parent,branch_order,x,y,z,radius\n7,-1,0,0,0,0,0.1\n9,7,0,0,0,1,0.09\n")
    segments = read_skeleton_nodes(path)
    assert segments.parent.tolist() == [-1]
    npt.assert_allclose(segments.end, [[0.0, 0.0, 1.0]])
    npt.assert_allclose([segments.start_radius[0], segments.end_radius[0]], [0.1, 0.09])


def test_reads_branches(tmp_path):
    path = tmp_path / "branches.csv"
    path.write_text(
        "branch_id,parent_branch,level,node,x,y,z,radius\n"
        "0,-1,0,0,0,0,0,1\n0,-1,0,1,0,0,4,0.8\n0,-1,0,2,0,0,8,0.6\n"
        "1,0,1,0,0,0,6,0.3\n1,0,1,1,4,0,6,0.1\n"
    )
    segments = read_branch_polylines(path, scale=0.25)
    assert segments.parent.tolist() == [-1, 0, 1]
    npt.assert_allclose(segments.length, [1.0, 1.0, 1.0])
    npt.assert_allclose(segments.start_radius, [0.25, 0.2, 0.075])


def test_reads_cylinders(tmp_path):
    path = tmp_path / "tree.cylinders.csv"
    path.write_text(
        "id,parent,x0,y0,z0,x1,y1,z1,r0,r1,order,measured\n0,-1,0,0,0,0,0,2,0.1,0.05,0,1\n1,0,0,0,2,1,0,2,0.05,0.02,1,0\n"
    )
    segments = read_cylinders(path)
    npt.assert_allclose(segments.length, [2.0, 1.0])
    npt.assert_allclose(segments.volume[0], np.pi * 2.0 * (0.01 + 0.005 + 0.0025) / 3.0)
    assert segments.parent.tolist() == [-1, 0]


def test_points_tell_what_the_scan_says_of_the_radius():
    n = 400
    axis = Samples(
        np.column_stack([np.zeros((n, 2)), np.arange(n) * 0.005]), np.full(n, 0.1), np.full(n, 0.005)
    )
    angle = np.random.default_rng(0).random(4000) * 2 * np.pi
    z = np.random.default_rng(1).random(4000) * 2
    scan = np.column_stack([0.08 * np.cos(angle), 0.08 * np.sin(angle), z])
    error, bias = points_against_radius(axis, scan)
    assert bias == pytest.approx(-0.2, abs=0.01) and error == pytest.approx(0.2, abs=0.01)
    unknown = Samples(axis.xyz, np.full(n, np.nan), axis.length)
    assert np.isnan(points_against_radius(unknown, scan)).all()
