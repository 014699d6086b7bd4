"""Scans with exact truth: polygon models of trees seen by the virtual scanner."""

from __future__ import annotations

from pathlib import Path

import numpy as np

STEP_DEG = 0.06  # 10 mm at 10 m, as terrestrial scanners are commonly set
NOISE = 0.002  # metres
N_STATIONS = 4
DISTANCE_PER_HEIGHT = 0.8
BARK = "bark"


def read_obj(path: str | Path, material: str | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a Wavefront file, of one material if it is named."""
    vertices, faces, current = [], [], None
    with open(path, encoding="utf-8") as file:
        for line in file:
            word = line.split()
            if not word:
                continue
            if word[0] == "v":
                vertices.append([float(x) for x in word[1:4]])
            elif word[0] == "usemtl":
                current = word[1]
            elif word[0] == "f" and (material is None or current == material):
                corner = [int(c.split("/")[0]) - 1 for c in word[1:]]
                faces += [[corner[0], corner[k], corner[k + 1]] for k in range(1, len(corner) - 1)]
    xyz, triangles = np.array(vertices, float), np.array(faces, np.int64)
    used, inverse = np.unique(triangles, return_inverse=True)
    return xyz[used], inverse.reshape(triangles.shape)


def scan_model(
    path: str | Path,
    *,
    scale: float,
    leaves: bool = False,
    step_deg: float = STEP_DEG,
    noise: float = NOISE,
    n_stations: int = N_STATIONS,
    seed: int = 0,
) -> np.ndarray:
    """Virtual scan of a model: (n, 3) metres.

    The bark only, unless `leaves`: they hide wood and are hit themselves.
    """
    from recon.scanning import scan_mesh, stations_around

    vertices, faces = read_obj(path, None if leaves else BARK)
    vertices = vertices * scale
    distance = DISTANCE_PER_HEIGHT * float(np.ptp(vertices[:, 2]))
    stations = stations_around(vertices, n_stations, distance=distance, azimuth=0.3)
    return scan_mesh(vertices, faces, stations, step=np.radians(step_deg), noise=noise, seed=seed)[0]
