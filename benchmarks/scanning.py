"""The virtual scanner beside the bare ray caster: 10^6 rays against 10^6 triangles, in one run.

``python -m benchmarks.scanning`` prints the table; with ``--only KIND`` one of its rows, so that
``/usr/bin/time -v`` can say what memory it takes.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import report

N_FACES = 1_000_000
N_RAYS = 1_000_000
HALF = 5.0  # metres: half the cube of leaves
LEAF = 0.06  # metres
DISTANCE = 12.0  # metres from its middle to the station
REPEATS = 5
SEED = 1


def make_leaves(n_faces: int = N_FACES) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of leaves of two triangles, everywhere in a cube and in all directions."""
    rng = np.random.default_rng(SEED)
    n = n_faces // 2
    u, w = rng.normal(size=(2, n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(u, w)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    middle = rng.uniform(-HALF, HALF, (n, 1, 3))
    corner = np.array([[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]) * (LEAF / 2)
    vertices = middle + corner[:, :1] * u[:, None] + corner[:, 1:] * v[:, None]
    faces = 4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def make_sweep(n_rays: int = N_RAYS) -> Any:
    """A station that looks at the cube with so many rays."""
    from recon.scan_paths import Sweep

    n = int(np.sqrt(n_rays))
    reach = np.arctan2(HALF, DISTANCE - HALF)
    azimuth, elevation = np.linspace(-reach, reach, n), np.linspace(-reach, reach, n)
    first = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(n)])
    return Sweep(np.tile([-DISTANCE, 0.0, 0.0], (n, 1)), first, np.tile([0.0, 0.0, 1.0], (n, 1)), elevation)


def fire_bare(scene: Any, rays: Any) -> None:
    """The ray caster alone, a million rays at a time."""
    for begin in range(0, len(rays), N_RAYS):
        scene.cast_rays(rays[begin : begin + N_RAYS])


def bare_rays(sweep: Any, n_sub: int) -> np.ndarray:
    """The rays of a sweep as the ray caster takes them, each so many times."""
    line = np.repeat(np.arange(sweep.n_lines), len(sweep.angle))
    angle = np.tile(sweep.angle, sweep.n_lines)[:, None]
    rays = np.empty((len(line), 6), np.float32)
    rays[:, :3] = sweep.origin[line]
    rays[:, 3:] = np.cos(angle) * sweep.first[line] + np.sin(angle) * sweep.second[line]
    return np.repeat(rays, n_sub, axis=0)


def bare_scene(vertices: np.ndarray, faces: np.ndarray) -> Any:
    """The ray caster with the triangles in it."""
    import open3d

    tensor: Any = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(vertices.astype(np.float32)), tensor(faces.astype(np.uint32)))
    return scene


def least(work: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Least wall-clock seconds: the ray caster uses all cores."""
    return report.seconds_of(work, repeats, perf_counter)[0]


def measure(only: str | None = None, n_faces: int = N_FACES, n_rays: int = N_RAYS) -> list[dict[str, Any]]:
    """Rows of the table: the rays alone and with the search tree built first, each beside the bare caster."""
    import open3d

    from recon.scan_scenes import LEAF as IS_LEAF
    from recon.scan_scenes import make_scene
    from recon.scanning import RAYS_PER_CHUNK, Beam, _Caster, _chunks, _fire, scan_scene

    vertices, faces = make_leaves(n_faces)
    sweep = make_sweep(n_rays)
    scene = make_scene(vertices, faces, IS_LEAF)
    beams = {
        "single": Beam(noise=0.002),
        "footprint": Beam(noise=0.002, divergence=3e-4, exit_diameter=0.004, n_returns=5),
    }
    rows = []
    for name, beam in beams.items():
        if only not in (None, name):
            continue
        n_sub = len(beam.sub_rays()[0])
        row: dict[str, Any] = {"what": name, "faces": len(faces), "rays": sweep.n_rays, "sub_rays": n_sub}
        row["points"] = len(scan_scene(scene, [sweep], beam))
        rows.append(row)
        if only is not None:
            continue
        rays = open3d.core.Tensor(bare_rays(sweep, n_sub))
        bare, caster, lines = bare_scene(vertices, faces), _Caster(vertices, faces), np.arange(sweep.n_lines)

        def fire(caster: Any = caster, beam: Any = beam, lines: Any = lines) -> None:
            for ray in _chunks(lines, len(sweep.angle), beam, RAYS_PER_CHUNK):
                _fire(caster, sweep, ray, beam)

        row["bare_s"] = least(lambda bare=bare, rays=rays: fire_bare(bare, rays))
        row["rays_s"] = least(fire)
        row["rays_ratio"] = row["rays_s"] / row["bare_s"]
        row["bare_whole_s"] = least(lambda rays=rays: fire_bare(bare_scene(vertices, faces), rays), 2)
        row["whole_s"] = least(lambda beam=beam: scan_scene(scene, [sweep], beam), 2)
        row["whole_ratio"] = row["whole_s"] / row["bare_whole_s"]
    return rows


def run(arguments: Namespace) -> None:
    """The table of both beams."""
    rows = measure(None, N_FACES, N_RAYS)
    print(report.table(rows))
    report.write_json(getattr(arguments, "json", None), "scanning", rows)


def main() -> int:
    """Print the table."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=["single", "footprint"])
    parser.add_argument("--rays", type=int, default=N_RAYS)
    parser.add_argument("--faces", type=int, default=N_FACES)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = measure(options.only, options.faces, options.rays)
    if options.json:
        print(json.dumps(rows, indent=2))
        return 0
    for row in rows:
        shown = ", ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())
        print(shown)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
