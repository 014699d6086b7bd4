"""Small synthetic scans, and the commands as processes of their own."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parent.parent.parent


def tree_points(seed=0, *, height=8.0, foot=(0.0, 0.0, 0.0), leaves=True, n=6000):
    """A trunk that tapers, six branches and, if wanted, a ball of leaf points on each; (m, 3) metres."""
    rng = np.random.default_rng(seed)
    h, a = rng.uniform(0, 0.9 * height, n // 2), rng.uniform(0, 2 * np.pi, n // 2)
    r = 0.15 * (1 - 0.6 * h / height)
    parts = [np.c_[r * np.cos(a), r * np.sin(a), h]]
    for k in range(6):
        low, turn = np.array([0, 0, height * (0.4 + 0.08 * k)]), 2.4 * k
        t, a = rng.uniform(0, 2, n // 20), rng.uniform(0, 2 * np.pi, n // 20)
        out = np.array([0.8 * np.cos(turn), 0.8 * np.sin(turn), 0.6])
        side = np.array([-np.sin(turn), np.cos(turn), 0])
        round_ = np.cos(a)[:, None] * side + np.sin(a)[:, None] * np.cross(out, side)
        parts.append(low + t[:, None] * out + (0.04 * (1 - 0.3 * t))[:, None] * round_)
        if leaves:
            parts.append(low + 2.2 * out + rng.normal(0, 0.45, (n // 10, 3)))
    return np.concatenate(parts) + foot


def write_xyz(path, points, decimals=4):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, points, fmt=f"%.{decimals}f")
    return path


def write_las(path, points, scale=0.001):
    import laspy

    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales, header.offsets = [scale] * 3, np.floor(points.min(axis=0))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.write(path)
    return path


def spawn(*arguments, cwd, **more):
    """Start ``python -m sapwood`` as a process of its own, which hears Ctrl-C even where the tests run in the
    background of a shell (there it is ignored, and that is inherited)."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-m", "sapwood", *map(str, arguments)],
        cwd=cwd,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        **more,
    )
