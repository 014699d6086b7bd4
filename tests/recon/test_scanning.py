"""The virtual scanner: exact scenes, occlusion, determinism, messages."""

import numpy as np
import numpy.testing as npt
import pytest

from recon.scanning import scan_mesh, stations_around


def box(low, high):
    low, high = np.asarray(low, float), np.asarray(high, float)
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = np.array([[q[i] for i in s] for q in quads for s in ((0, 1, 2), (0, 2, 3))])
    return low + corner * (high - low), faces


def plane_gap(points, vertices, faces):
    """Distance of each point to the plane of its own triangle."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.abs(((points - a) * normal).sum(axis=1))


def test_points_lie_on_the_triangle_they_name():
    vertices, faces = box([-1, -1, 0], [1, 1, 3])
    points, face = scan_mesh(vertices, faces, [[6.0, 2.0, 1.6], [-4.0, 5.0, 1.6]], step=0.01)
    assert len(points) > 2000 and points.dtype == np.float64 and face.dtype == np.int32
    assert plane_gap(points, vertices, faces[face]).max() < 2e-5
    assert (points >= vertices.min(axis=0) - 2e-5).all() and (points <= vertices.max(axis=0) + 2e-5).all()


def test_only_the_faces_towards_the_station_are_seen():
    vertices, faces = box([-1, -1, 0], [1, 1, 3])
    points, _ = scan_mesh(vertices, faces, [[6.0, 0.0, 1.5]], step=0.01)
    npt.assert_allclose(points[:, 0], 1.0, atol=1e-5)


def test_a_box_hides_what_is_behind_it():
    wall_v, wall_f = box([2.0, -1.0, 0.0], [2.1, 1.0, 3.0])
    back_v, back_f = box([4.0, -4.0, 0.0], [4.1, 4.0, 3.0])
    vertices = np.concatenate([wall_v, back_v])
    faces = np.concatenate([wall_f, back_f + len(wall_v)])
    points, face = scan_mesh(vertices, faces, [[0.0, 0.0, 1.5]], step=0.005)
    on_back = points[(face >= len(wall_f)) & (points[:, 0] < 4.05)]
    assert len(on_back) > 1000
    shadow = 1.0 * 4.0 / 2.0  # the wall's edge at y = 1, x = 2 (its far side a little less), thrown to x = 4
    assert np.abs(on_back[:, 1]).min() > shadow - 0.1 - 0.02
    alone, _ = scan_mesh(back_v, back_f, [[0.0, 0.0, 1.5]], step=0.005)
    assert np.abs(alone[:, 1]).min() < 0.02


def test_spacing_on_a_wall_is_distance_times_step():
    vertices, faces = box([5.0, -2.0, 0.0], [5.1, 2.0, 3.0])
    points, _ = scan_mesh(vertices, faces, [[0.0, 0.0, 1.5]], step=0.01)
    near = points[(np.abs(points[:, 1]) < 0.3) & (np.abs(points[:, 2] - 1.5) < 0.3)]
    y = np.unique(np.round(near[:, 1], 4))
    npt.assert_allclose(np.diff(y), 0.05, rtol=0.02)


def test_noise_is_along_the_ray_and_of_the_stated_size():
    vertices, faces = box([5.0, -1.0, 0.5], [5.1, 1.0, 2.5])
    station = np.array([0.0, 0.0, 1.5])
    clean, _ = scan_mesh(vertices, faces, station, step=0.004)
    noisy, _ = scan_mesh(vertices, faces, station, step=0.004, noise=0.01, seed=3)
    assert len(clean) == len(noisy) > 5000
    along = np.linalg.norm(noisy - station, axis=1) - np.linalg.norm(clean - station, axis=1)
    npt.assert_allclose(along.std(), 0.01, rtol=0.05)
    npt.assert_allclose(along.mean(), 0.0, atol=0.0005)
    npt.assert_allclose(np.linalg.norm(noisy - clean, axis=1), np.abs(along), atol=1e-6)


def test_same_seed_same_bytes_whatever_the_chunks():
    vertices, faces = box([-1, -1, 0], [1, 1, 3])
    stations = stations_around(vertices, 3, distance=5.0)
    arguments = {"step": 0.02, "noise": 0.005}
    first = scan_mesh(vertices, faces, stations, seed=7, **arguments)
    again = scan_mesh(vertices, faces, stations, seed=7, rays_per_chunk=500, **arguments)
    other = scan_mesh(vertices, faces, stations, seed=8, **arguments)
    assert first[0].tobytes() == again[0].tobytes() and first[1].tobytes() == again[1].tobytes()
    assert first[0].tobytes() != other[0].tobytes()


def test_nothing_beyond_the_range():
    vertices, faces = box([5.0, -3.0, 0.0], [5.1, 3.0, 3.0])
    points, face = scan_mesh(vertices, faces, [0.0, 0.0, 1.5], step=0.01, max_range=5.3)
    assert len(points) > 0 and np.linalg.norm(points - [0.0, 0.0, 1.5], axis=1).max() <= 5.3
    points, face = scan_mesh(vertices, faces, [0.0, 0.0, 1.5], step=0.01, max_range=2.0)
    assert points.shape == (0, 3) and face.shape == (0,)


def test_station_inside_sees_all_around():
    vertices, faces = box([-2, -2, -2], [2, 2, 2])
    points, face = scan_mesh(vertices, faces, [0.1, 0.2, 0.3], step=0.02)
    assert set(face.tolist()) == set(range(12))
    npt.assert_allclose(np.abs(points).max(axis=1), 2.0, atol=1e-5)


def test_window_over_the_seam_of_the_azimuth():
    vertices, faces = box([-6.0, -1.0, 0.0], [-5.0, 1.0, 2.0])
    points, _ = scan_mesh(vertices, faces, [0.0, 0.0, 1.0], step=0.01)
    assert points[:, 1].min() < -0.95 and points[:, 1].max() > 0.95
    assert len(points) < 2000  # one face, not a second turn


def test_a_wide_triangle_is_seen_up_to_its_middle():
    """Its middle is near and steep, its corners far and flat: the window must not be theirs."""
    vertices = np.array([[3.0, -30.0, 4.0], [3.0, 30.0, 4.0], [3.0, 0.0, -4.0]])
    points, _ = scan_mesh(vertices, [[0, 1, 2]], [0.0, 0.0, 0.0], step=0.01)
    npt.assert_allclose(points[:, 2].max(), 4.0, atol=0.1)
    assert np.abs(points[points[:, 2] > 3.8][:, 1]).min() < 1.0


def test_map_coordinates_lose_nothing():
    vertices, faces = box([-1, -1, 0], [1, 1, 3])
    shift = np.array([451200.0, 5411200.0, 312.0])
    here, _ = scan_mesh(vertices, faces, [6.0, 2.0, 1.6], step=0.02, noise=0.004)
    there, _ = scan_mesh(vertices + shift, faces, shift + [6.0, 2.0, 1.6], step=0.02, noise=0.004)
    npt.assert_allclose(there - shift, here, atol=1e-4)


def test_stations_stand_on_a_circle():
    vertices, _ = box([10, 20, 5], [12, 22, 9])
    stations = stations_around(vertices, 4, distance=8.0, height=1.5)
    npt.assert_allclose(np.hypot(*(stations[:, :2] - [11.0, 21.0]).T), 8.0)
    npt.assert_allclose(stations[:, 2], 6.5)
    npt.assert_allclose(stations[0], [19.0, 21.0, 6.5])


BOX = box([0, 0, 0], [1, 1, 1])


@pytest.mark.parametrize(
    "change, match",
    [
        ({"vertices": np.zeros((3, 2))}, r"vertices must have shape \(n, 3\) with n > 0, got \(3, 2\)"),
        ({"stations": np.zeros((0, 3))}, r"stations must have shape"),
        ({"stations": [np.nan, 0.0, 0.0]}, "stations must be finite, got 1 rows"),
        ({"faces": np.zeros((2, 4), int)}, r"faces must have shape \(f, 3\) with f > 0, got \(2, 4\)"),
        ({"faces": [[0, 1, 8]]}, "faces must name rows of the 8 vertices, got 0 to 8"),
        ({"step": 0.0}, "step must be an angle between"),
        ({"noise": -0.1}, "noise must be a finite number of metres >= 0, got -0.1"),
        ({"max_range": 0.0}, "max_range must be a positive number"),
        ({"rays_per_chunk": 0}, "rays_per_chunk must be at least 1"),
    ],
)
def test_bad_arguments(change, match):
    arguments = {"vertices": BOX[0], "faces": BOX[1], "stations": [5.0, 0.0, 1.0], "step": 0.1, **change}
    with pytest.raises(ValueError, match=match):
        scan_mesh(**arguments)


def test_bad_stations_around():
    with pytest.raises(ValueError, match="n_stations must be at least 1, got 0"):
        stations_around(BOX[0], 0, distance=1.0)
    with pytest.raises(ValueError, match="distance must be a positive"):
        stations_around(BOX[0], 2, distance=0.0)
