"""The scanner's beams, labels, wind and paths: exact scenes, independent references, statistics."""

import numpy as np
import numpy.testing as npt
import pytest
from test_scanning import box, plane_gap

from recon.scan_paths import airborne_sweeps, mobile_sweep, station_sweeps
from recon.scan_scenes import (
    GROUND,
    LEAF,
    OTHER,
    WOOD,
    ground_scene,
    join_scenes,
    make_scene,
    obstacle_scene,
    sway_in_wind,
)
from recon.scanning import Beam, scan_scene
from treegraph import Ball, Box, HalfSpace, InputError, TriangleMesh, make_wall
from treegraph.obstacles import stands_inside

STATION = [0.0, 0.0, 1.5]
WIDE = {"divergence": 4e-3, "exit_diameter": 0.004}


def plate(x, low, high, **labels):
    """An upright rectangle at x, from (y, z) to (y, z)."""
    corner = [[x, low[0], low[1]], [x, high[0], low[1]], [x, high[0], high[1]], [x, low[0], high[1]]]
    return make_scene(corner, [[0, 1, 2], [0, 2, 3]], labels.pop("part", OTHER), **labels)


def soup(n=3000, seed=2):
    """Leaves in a cube 6 m away: edges everywhere."""
    rng = np.random.default_rng(seed)
    corner = rng.uniform(-1, 1, (n, 1, 3)) + [6.0, 0.0, 1.5] + rng.normal(0, 0.05, (n, 3, 3))
    faces = np.arange(3 * n).reshape(n, 3)
    sway = rng.uniform(0, 1, n).repeat(3)
    return make_scene(corner.reshape(-1, 3), faces, LEAF, tree_id=1, node_id=np.arange(n), sway=sway)


def nearest_hit(origin, way, vertices, faces):
    """Moeller and Trumbore, every triangle by every ray: the slow and obvious reference."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    best, face = np.full(len(way), np.inf), np.full(len(way), -1)
    for k in range(len(way)):
        p = np.cross(way[k], c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / ((b - a) * p).sum(axis=1)
            u = ((origin[k] - a) * p).sum(axis=1) * scale
            q = np.cross(origin[k] - a, b - a)
            v = (way[k] * q).sum(axis=1) * scale
            t = ((c - a) * q).sum(axis=1) * scale
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
        if np.isfinite(t).any():
            best[k], face[k] = t.min(), t.argmin()
    return best, face


# ---------------------------------------------------------------- single rays


def test_every_ray_ends_where_the_reference_says():
    scene = soup(600)
    (sweep,) = station_sweeps(scene.vertices, STATION, 0.012)
    scan = scan_scene(scene, [sweep])
    line, k = np.divmod(np.arange(sweep.n_rays), len(sweep.angle))
    angle = sweep.angle[k][:, None]
    way = np.cos(angle) * sweep.first[line] + np.sin(angle) * sweep.second[line]
    t, face = nearest_hit(sweep.origin[line], way, scene.vertices, scene.faces)
    assert (face >= 0).sum() > 200
    npt.assert_array_equal(scan.ray, np.flatnonzero(face >= 0))
    npt.assert_array_equal(scan.face, face[face >= 0])
    npt.assert_allclose(scan.distance, t[face >= 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("far", [6.0, 300.0])
def test_points_lie_on_their_triangle(far):
    scene = soup()
    station = np.array([6.0 - far, 0.3, 2.0])
    sweeps = station_sweeps(scene.vertices, station, 0.02 / far)
    scan = scan_scene(scene, sweeps, Beam(max_range=1000.0))
    assert len(scan) > 1000
    assert plane_gap(scan.xyz, scene.vertices, scene.faces[scan.face]).max() < 1e-5
    npt.assert_array_equal(scan.node_id, scene.node_id[scan.face])


def test_noise_lies_along_the_ray_with_its_sigma():
    scene = soup()
    sweeps = station_sweeps(scene.vertices, [STATION, [12.0, 1.0, 1.0]], 0.003)
    clean = scan_scene(scene, sweeps)
    noisy = scan_scene(scene, sweeps, Beam(noise=0.003), seed=4)
    npt.assert_array_equal(noisy.face, clean.face)
    gap = noisy.distance - clean.distance
    assert len(gap) > 20_000
    npt.assert_allclose(gap.std(), 0.003, rtol=0.02)
    assert abs(gap.mean()) < 4 * 0.003 / np.sqrt(len(gap))
    npt.assert_allclose((np.abs(gap) < 0.003).mean(), 0.6827, atol=0.015)  # it is a Gaussian
    off = noisy.xyz - clean.xyz
    origin = np.array([sweep.origin[0] for sweep in sweeps])[clean.station]
    way = clean.xyz - origin
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    npt.assert_allclose(off, gap[:, None] * way, atol=1e-9)


def test_ranges_near_and_far():
    scene = join_scenes([plate(3.0, (-1, 1), (1, 2)), plate(5.0, (-4, 0), (4, 4))])
    sweeps = station_sweeps(scene.vertices, STATION, 0.01)
    every = scan_scene(scene, sweeps)
    some = scan_scene(scene, sweeps, Beam(min_range=4.0, max_range=5.5))
    keep = (every.distance >= 4.0) & (every.distance <= 5.5)
    assert 0 < keep.sum() < len(every)
    npt.assert_array_equal(some.xyz, every.xyz[keep])  # what is too near still hides what is behind it


# ---------------------------------------------------------------- what hides what


@pytest.mark.parametrize("obstacle", ["box", "ball", "wall", "mesh"])
def test_an_obstacle_hides_exactly_what_is_behind_it(obstacle):
    """With it, the same points but those whose line of sight meets the solid, tested by the solid itself."""
    solid = {
        "box": Box([3.0, 0.2, 1.4], [0.4, 0.7, 0.8]),
        "ball": Ball([3.0, 0.3, 1.3], 0.35),
        "wall": HalfSpace([6.1, 0.0, 0.0], [-1.0, 0.0, 0.0]),
        "mesh": TriangleMesh(*box([2.8, -0.2, 1.0], [3.2, 0.6, 1.8])),
    }[obstacle]
    scene = soup()
    sweeps = station_sweeps(scene.vertices, STATION, 0.004)
    free = scan_scene(scene, sweeps)
    both = scan_scene(join_scenes([scene, obstacle_scene(solid, near=[6, 0, 1.5], reach=20.0)]), sweeps)
    way = free.xyz - STATION
    if obstacle == "wall":  # half of the leaves stand before it
        hidden = free.xyz[:, 0] > 6.1
        edge = np.abs(free.xyz[:, 0] - 6.1) < 1e-6
    else:
        turn = way / np.linalg.norm(way, axis=1, keepdims=True)
        hidden = solid.blocks(np.array(STATION), turn)
        slack = 4e-4 if obstacle == "ball" else 1e-6  # the ball is a polyhedron
        aside = slack * np.concatenate([np.eye(3), -np.eye(3)])
        moved = [solid.blocks(np.array(STATION), turn + shift) for shift in aside]
        edge = np.any([m != hidden for m in moved], axis=0)
    assert 1000 < hidden.sum() < len(free) - 1000
    left = both.part == LEAF
    seen = np.isin(free.ray, both.ray[left])
    wrong = (seen == hidden) & ~edge
    assert wrong.sum() <= 2  # a ray along the edge of a leaf may go either way in single precision
    assert edge.sum() < 0.04 * len(free)
    assert np.isin(free.ray[hidden & ~edge], both.ray[~left]).all()
    same = np.isin(free.ray, both.ray[left]) & ~wrong
    mine = both.xyz[left][np.isin(both.ray[left], free.ray[same])]
    assert (np.linalg.norm(mine - free.xyz[same], axis=1) < 1e-6).mean() > 0.9995


def test_obstacles_are_closed_surfaces_where_they_should_be():
    ball = obstacle_scene(Ball([1, 2, 3], 0.5), near=[0, 0, 0], reach=1.0)
    corner = ball.vertices[ball.faces] - [1, 2, 3]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    npt.assert_allclose(abs(volume), 4 / 3 * np.pi * 0.125, rtol=0.004)
    npt.assert_allclose(np.linalg.norm(corner.reshape(-1, 3), axis=1), 0.5, atol=1e-12)
    assert np.linalg.norm(corner.mean(axis=1), axis=1).min() > 0.5 * 0.997
    wall = make_wall((2, 0, 0), (-1, 1, 0), width=3, height=2, thickness=0.2)
    scene = obstacle_scene(wall, near=[0, 0, 0], reach=1.0)
    local = (scene.vertices - wall.center) @ wall.rotation
    npt.assert_allclose(np.abs(local), np.tile(wall.size / 2, (8, 1)), atol=1e-12)
    assert stands_inside(wall, wall.center) and not stands_inside(wall, [0, 0, 0])
    half = HalfSpace([1.5, 0, 0], [-1, 0, 0])
    assert stands_inside(half, [2.0, 5, 5]) and not stands_inside(half, [0, 0, 0])


# ---------------------------------------------------------------- beams with a width


def test_mixed_points_only_at_edges_and_only_with_a_footprint():
    """A plate 0.2 m before a wall: between the two only along the plate's outline."""
    scene = join_scenes([plate(5.0, (-1, 1), (1, 2), part=LEAF), plate(5.2, (-3, -1), (3, 4), part=WOOD)])
    sweeps = station_sweeps(scene.vertices, STATION, 0.002)
    sharp = scan_scene(scene, sweeps)
    assert np.minimum(np.abs(sharp.xyz[:, 0] - 5.0), np.abs(sharp.xyz[:, 0] - 5.2)).max() < 1e-9
    scan = scan_scene(scene, sweeps, Beam(**WIDE, separation=0.5))
    between = (scan.xyz[:, 0] > 5.01) & (scan.xyz[:, 0] < 5.19)
    assert between.sum() > 500
    y, z = np.abs(scan.xyz[:, 1]), scan.xyz[:, 2]
    beam = 0.002 + 5.2 * np.tan(0.002)  # its radius
    to_edge = np.maximum(y - 1.0 * scan.xyz[:, 0] / 5.0, np.abs(z - 1.5) - 0.5 * scan.xyz[:, 0] / 5.0)
    assert np.abs(to_edge[between]).max() < beam + 1e-3
    outline = np.abs(to_edge) < 0.1 * beam
    assert between[outline].mean() > 0.95
    npt.assert_array_equal(between, scan.spread > 0.15)
    middle = np.abs(scan.xyz[between, 0] - 5.1) < 0.03  # both labels occur in mixed points
    assert set(scan.part[between][middle]) == {LEAF, WOOD}


def test_surfaces_far_apart_are_several_returns():
    scene = join_scenes(
        [
            plate(5.0, (-1, 1), (0, 2), part=LEAF),
            plate(7.0, (-1, 0), (1, 3), part=WOOD),
            plate(9.0, (-5, -5), (5, 9)),
        ]
    )
    sweeps = station_sweeps(scene.vertices[:8], STATION, 0.002)
    scan = scan_scene(scene, sweeps, Beam(**WIDE, separation=0.5, n_returns=4, rings=2))
    assert scan.n_returns.max() >= 2
    depth = scan.xyz[:, 0]
    npt.assert_allclose(depth, np.choose(scan.part // 2, [7.0, 5.0, 9.0]), atol=1e-2)
    pulse, first, count = np.unique(scan.ray, return_index=True, return_counts=True)
    npt.assert_array_equal(count, scan.n_returns[first])
    npt.assert_array_equal(scan.return_number, np.arange(len(scan)) - np.repeat(first, count) + 1)
    assert (np.diff(scan.distance)[np.diff(scan.ray) == 0] > 1.5).all()
    one = scan_scene(scene, sweeps, Beam(**WIDE, separation=0.5, n_returns=1, rings=2))
    npt.assert_array_equal(one.xyz, scan.xyz[scan.return_number == 1])
    assert set(one.n_returns) == {1}
    average = scan_scene(scene, sweeps, Beam(**WIDE, separation=np.inf, rings=2))  # a phase-shift scanner
    assert (average.n_returns == 1).all() and average.spread.max() > 1.9


def test_a_return_needs_its_share_of_the_energy():
    """A wire thinner than the beam, with nothing behind it: found while its share of the beam suffices."""
    wire = plate(5.0, (-0.0005, 1), (0.0005, 2))
    sweeps = station_sweeps(plate(5.0, (-0.1, 1), (0.1, 2)).vertices, STATION, 0.001)
    n = [len(scan_scene(wire, sweeps, Beam(**WIDE, rings=4, detection=d))) for d in (0.0, 0.1, 0.3, 0.9)]
    assert n[0] > n[1] > n[2] and n[3] == 0
    assert len(scan_scene(wire, sweeps)) < 0.2 * n[0]


@pytest.mark.parametrize("rings", [1, 2, 4])
def test_the_sub_rays_are_a_gaussian_beam(rings):
    radius, turn, weight = Beam(divergence=1e-3, rings=rings).sub_rays()
    assert len(radius) == 1 + 3 * rings * (rings + 1) and radius.max() < 1
    npt.assert_allclose(weight.sum(), 1.0)
    npt.assert_allclose([weight @ (radius * np.cos(turn)), weight @ (radius * np.sin(turn))], 0.0, atol=1e-12)
    r = np.linspace(0, 1, 10_001)[1:]  # mean square radius within 1/e^2
    exact = (r**3 * np.exp(-2 * r**2)).sum() / (r * np.exp(-2 * r**2)).sum()
    npt.assert_allclose(weight @ radius**2, exact, rtol=0.12)


def test_the_footprint_has_its_size():
    """Cast on a plate with a sharp edge, the beam is caught within its radius of the edge."""
    scene = plate(8.0, (-2, 0), (0, 3))
    (sweep,) = station_sweeps(plate(8.0, (-0.1, 1.48), (0.1, 1.52)).vertices, STATION, 0.0002)
    scan = scan_scene(scene, [sweep], Beam(divergence=6e-3, exit_diameter=0.01, rings=8, detection=0.0))
    radius = 0.005 + 8.0 * 0.003
    assert 0.85 * radius < scan.xyz[:, 1].max() < radius
    assert scan.xyz[:, 2].min() < 1.5 < scan.xyz[:, 2].max()


def test_a_slanted_plane_is_not_moved_by_the_footprint():
    floor = ground_scene([0.0, 0.0], 30.0)
    target = np.array([[8.0, -0.5, 0.0], [12.0, 0.5, 0.0]])
    scan = scan_scene(floor, station_sweeps(target, STATION, 0.003), Beam(divergence=1e-3, separation=1.0))
    assert len(scan) > 300
    assert np.abs(scan.xyz[:, 2]).max() < 1e-3 and scan.spread.min() > 0.02


# ---------------------------------------------------------------- seeds, chunks, wind


@pytest.mark.parametrize("beam", [Beam(noise=0.002), Beam(noise=0.002, n_returns=3, **WIDE)])
@pytest.mark.parametrize("wind", [0.0, 0.05])
def test_same_seed_same_bytes_whatever_the_chunks(beam, wind):
    scene = soup(500)
    sweeps = station_sweeps(scene.vertices, [STATION, [12.0, 1.0, 1.0]], 0.015)

    def scan(seed, size):
        found = scan_scene(scene, sweeps, beam, seed=seed, wind=wind, rays_per_chunk=size)
        return {name: np.asarray(value).tobytes() for name, value in vars(found).items()}

    first = scan(7, 1_000_000)
    assert scan(7, 999) == first and scan(7, 1) == first if beam.n_returns == 1 else scan(7, 999) == first
    assert scan(8, 1_000_000)["xyz"] != first["xyz"]
    assert scan(np.random.default_rng(7), 5000) == first


def test_wind_moves_what_sways_by_its_amplitude():
    scene = soup(20_000)
    rng = np.random.default_rng(3)
    gap = np.concatenate([sway_in_wind(scene, 0.04, rng) - scene.vertices for _ in range(60)])
    sway = np.tile(scene.sway, 60).astype(float)
    flat = np.hypot(gap[:, 0], gap[:, 1])
    npt.assert_allclose(np.sqrt((flat**2).sum() / (sway**2).sum()), 0.04, rtol=0.15)
    npt.assert_allclose(np.sqrt((gap[:, 2] ** 2).sum() / (sway**2).sum()), 0.04 / 3, rtol=0.25)
    stiff = make_scene(scene.vertices, scene.faces, LEAF, sway=0.0)
    npt.assert_array_equal(sway_in_wind(stiff, 0.04, rng), stiff.vertices)


def test_wind_differs_from_station_to_station_and_line_to_line():
    """A loose plate before a stiff one: its points scatter by the wind, those behind it do not."""
    loose = plate(5.0, (-0.4, 1.1), (0.4, 1.9), part=LEAF, sway=1.0)
    scene = join_scenes([loose, plate(6.0, (-3, 0), (3, 3), part=WOOD)])
    sweeps = station_sweeps(loose.vertices, [STATION, STATION], 0.004)
    scan = scan_scene(scene, sweeps, wind=0.05, seed=1)
    npt.assert_allclose(scan.xyz[scan.part == WOOD, 0], 6.0, atol=1e-9)
    leaf = scan.part == LEAF
    per_line = scan.ray // len(sweeps[0].angle)
    middle = np.array([scan.xyz[leaf & (per_line == k), 0].mean() for k in np.unique(per_line[leaf])[20:-20]])
    assert 0.01 < middle.std() < 0.1  # moments differ
    change = [(middle[k:] - middle[:-k]).std() for k in (8, 3, 5)]
    assert 1.3 * change[0] < min(change[1:])  # and take turns, eight of them
    both = [scan.xyz[leaf & (scan.station == k), 0].mean() for k in (0, 1)]
    assert abs(both[0] - both[1]) > 1e-4


def test_wind_has_no_say_without_wind():
    scene = soup(500)
    sweeps = station_sweeps(scene.vertices, STATION, 0.015)
    npt.assert_array_equal(scan_scene(scene, sweeps, wind=0.0).xyz, scan_scene(scene, sweeps).xyz)


# ---------------------------------------------------------------- tracks and flights


def test_a_mobile_scanner_draws_profiles_across_its_way():
    tunnel = make_scene(*box([-20, -3, 0], [20, 3, 5]), OTHER)
    sweep = mobile_sweep([[-2.0, 0.5, 2.0], [2.0, 0.5, 2.0]], step=0.02, spacing=0.25)
    scan = scan_scene(tunnel, [sweep])
    assert sweep.n_lines == 17 and sweep.n_rays == 17 * 314 == len(scan)  # closed all around
    line = scan.ray // 314
    npt.assert_allclose(scan.xyz[:, 0], -2.0 + 0.25 * line, atol=1e-9)
    assert np.abs(scan.xyz[:314] - [-2.0, 0.5, 5.0]).sum(axis=1).min() < 1e-9  # the zenith
    assert scan.xyz[1, 1] < 0.5  # then to the right


def test_a_track_may_turn():
    sweep = mobile_sweep([[0, 0, 1], [3, 0, 1], [3, 2, 1]], step=0.1, spacing=0.5)
    npt.assert_allclose(sweep.origin[-1], [3, 2, 1])
    npt.assert_allclose(sweep.origin[7], [3, 0.5, 1])
    npt.assert_allclose(sweep.second[[0, 7]], [[0, -1, 0], [1, 0, 0]], atol=1e-12)
    npt.assert_allclose(np.cross(sweep.first, sweep.second)[:, 2], 0.0, atol=1e-12)


def test_an_airborne_strip_has_its_density_and_reaches_everything():
    floor = ground_scene([0.0, 0.0], 200.0)
    target = np.array([[-10.0, -6.0, 0.0], [14.0, 8.0, 0.0], [-10.0, 8.0, 0.0], [14.0, -6.0, 0.0]])
    sweeps = airborne_sweeps(
        target, altitude=300.0, density=20.0, scan_angle=1.0, n_strips=2, strip_spacing=100.0, azimuth=0.4
    )
    scan = scan_scene(floor, sweeps, Beam(max_range=1000.0))
    assert len(sweeps) == 2 and np.abs(scan.xyz[:, 2]).max() < 1e-9
    middle = np.abs(scan.xyz[:, :2] - [2.0, 1.0]).max(axis=1) < 3.0
    for k, sweep in enumerate(sweeps):
        cos2 = 300.0**2 / (300.0**2 + 50.0**2)  # the rays are this much farther apart there
        npt.assert_allclose((middle & (scan.station == k)).sum() / 36.0, 20.0 * cos2, rtol=0.1)
        npt.assert_allclose(sweep.origin[:, 2], 300.0)
        for corner in ([-10, -6], [-10, 8], [14, -6], [14, 8]):
            assert np.linalg.norm(scan.xyz[scan.station == k, :2] - corner, axis=1).min() < 0.35
    ways = [sweep.origin[-1] - sweep.origin[0] for sweep in sweeps]
    npt.assert_allclose(ways[0] / np.linalg.norm(ways[0]), [np.cos(0.4), np.sin(0.4), 0], atol=1e-9)
    assert ways[0] @ ways[1] < 0  # flown back


def test_a_narrow_scan_angle_is_kept():
    target = np.array([[-50.0, -50.0, 0.0], [50.0, 50.0, 0.0]])
    (sweep,) = airborne_sweeps(target, altitude=100.0, density=4.0, scan_angle=0.2)
    npt.assert_allclose(np.abs(sweep.angle).max(), 0.1, atol=0.005)


def test_rough_ground_has_its_roughness():
    flat, rough = (
        ground_scene([3, 4], 10.0, height=-0.5),
        ground_scene([3, 4], 10.0, height=-0.5, roughness=0.03, seed=2),
    )
    assert len(flat.faces) == 2 and set(flat.part) == {GROUND} and (flat.vertices[:, 2] == -0.5).all()
    npt.assert_allclose(rough.vertices[:, 2].std(), 0.03, rtol=0.3)
    middle = np.linalg.norm(rough.vertices[:, :2] - [3, 4], axis=1).argmin()
    npt.assert_allclose(rough.vertices[middle, 2], -0.5, atol=1e-9)
    assert ground_scene([3, 4], 10.0, roughness=0.03, seed=3).vertices.tobytes() != rough.vertices.tobytes()
    npt.assert_allclose(rough.vertices.min(axis=0)[:2], [-7, -6])


# ---------------------------------------------------------------- messages


def test_taking_faces_keeps_their_labels():
    scene = soup(50)
    some = scene.take([3, 7])
    npt.assert_array_equal(some.node_id, [3, 7])
    npt.assert_array_equal(some.vertices[some.faces], scene.vertices[scene.faces[[3, 7]]])
    npt.assert_array_equal(some.sway[some.faces], scene.sway[scene.faces[[3, 7]]])


@pytest.mark.parametrize(
    "change, said",
    [
        ({"noise": -1}, "noise must be a finite number of metres >= 0, got -1"),
        ({"divergence": 0.2}, "divergence must be an angle from 0 to 0.1 radians, got 0.2"),
        ({"exit_diameter": 2}, "exit_diameter must be 0 to 1 metres, got 2"),
        ({"rings": 0}, "rings must be 1 to 8, got 0"),
        ({"separation": np.nan}, "separation must be a number of metres >= 0, got nan"),
        ({"n_returns": 16}, "n_returns must be 1 to 15, got 16"),
        ({"detection": 1.5}, "detection must be 0 to 1, got 1.5"),
        ({"min_range": -1}, "min_range must be a finite"),
        (
            {"min_range": 5, "max_range": 4},
            "max_range must be a positive number .* got 4",
        ),
    ],
)
def test_bad_beams(change, said):
    with pytest.raises(InputError, match=said):
        Beam(**change)


SCENE = plate(5.0, (-1, 1), (1, 2))
TARGET = SCENE.vertices
FAR = {"target": TARGET, "altitude": 50, "density": 1, "scan_angle": 0.1, "n_strips": 2, "strip_spacing": 500}


@pytest.mark.parametrize(
    "work, said",
    [
        (lambda: scan_scene(SCENE, []), "sweeps must hold at least one"),
        (lambda: scan_scene(SCENE, station_sweeps(TARGET, STATION, 0.1), wind=-1), "wind must be a finite"),
        (lambda: make_scene(TARGET, [[0, 1, 2]], 9), "part must be one of"),
        (lambda: make_scene(TARGET, [[0, 1, 2]], WOOD, node_id=[1, 2]), r"node_id must have shape \(1,\)"),
        (lambda: make_scene(TARGET, [[0, 1, 2]], WOOD, sway=2.0), "sway must be 0 to 1"),
        (lambda: join_scenes([]), "scenes must hold at least one scene"),
        (lambda: ground_scene([0, 0], -1), "half_width must be"),
        (lambda: ground_scene([0, 0], 1, roughness=-1), "roughness must be"),
        (lambda: mobile_sweep([[0, 0, 0]], step=0.1, spacing=1), "track must have at least two corners"),
        (lambda: mobile_sweep([[0, 0, 0], [0, 0, 2]], step=0.1, spacing=1), "must not run straight up"),
        (lambda: mobile_sweep([[0, 0, 0], [1, 0, 0]], step=0.1, spacing=0), "spacing must be a positive"),
        (lambda: mobile_sweep([[0, 0, 0], [1, 0, 0]], step=0.1, spacing=1e-9), "at most 1000000 profiles"),
        (lambda: airborne_sweeps(TARGET, altitude=0.5, density=1, scan_angle=1), "altitude must be above"),
        (lambda: airborne_sweeps(TARGET, altitude=50, density=-1, scan_angle=1), "density must be"),
        (lambda: airborne_sweeps(TARGET, altitude=50, density=1, scan_angle=4), "scan_angle must be"),
        (lambda: airborne_sweeps(**FAR), "no flight line sees the target"),
        (
            lambda: airborne_sweeps(TARGET, altitude=50, density=1, scan_angle=1, n_strips=0),
            "n_strips must be >= 1",
        ),
    ],
)  # fmt: skip
def test_bad_scenes_and_paths(work, said):
    with pytest.raises(InputError, match=said):
        work()
