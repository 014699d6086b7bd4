"""The OpenGL renderer: pyrender in a child process.

A driver that crashes or hangs takes the child with it, never the program. EGL is tried first, then OSMesa;
what came of it is remembered for the life of the process.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from render.camera import Camera
from render.errors import NoPreviewError
from render.software import LitLayer, Seen, SoftwareRenderer

__all__ = ["GLRenderer", "GLStatus", "find_gl"]

PLATFORMS = ("egl", "osmesa")
START_TIMEOUT = 60.0  # seconds: importing from a cold disk is slow, a hanging driver is endless
DRAW_TIMEOUT = 120.0
END_TIMEOUT = 5.0
WORKER = Path(__file__).with_name("_gl_worker.py")
LONGEST_REASON = 160  # characters


@dataclass(frozen=True)
class GLStatus:
    """Whether OpenGL can be used here.

    Attributes
    ----------
    platform : str or None
        ``"egl"`` or ``"osmesa"``; None if neither works.
    device : str
        What draws, as the driver calls it; empty if nothing does.
    reason : str
        Why what was tried does not work; empty if the first did.
    """

    platform: str | None
    device: str
    reason: str


class _Child:
    """A running worker."""

    def __init__(self, platform: str) -> None:
        self.platform = platform
        self.owner = os.getpid()
        self._busy = threading.Lock()
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - read when the child has failed, closed in close()
        try:
            self._process = subprocess.Popen(
                [sys.executable, str(WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                env={**os.environ, "PYOPENGL_PLATFORM": platform},
            )
        except OSError as error:
            self._log.close()
            raise NoPreviewError(f"{platform}: no process could be started ({error.strerror})") from error
        assert self._process.stdin is not None and self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        try:
            self.device = str(self._receive(START_TIMEOUT))
        except NoPreviewError:
            self.close()
            raise

    def ask(self, request: dict[str, Any]) -> Any:
        """Send a request and wait for the answer."""
        with self._busy:
            try:
                pickle.dump(request, self._input, protocol=5)
                self._input.flush()
            except OSError as error:
                raise NoPreviewError(self._why()) from error
            return self._receive(DRAW_TIMEOUT)

    def alive(self) -> bool:
        """Whether it can be asked: it runs, and this process, not one that it forked from, started it."""
        return self.owner == os.getpid() and self._process.poll() is None

    def close(self) -> None:
        """End the child, if it is this process's own."""
        if self.owner != os.getpid():
            return
        if self.alive():
            self._process.kill()
        self._process.wait()
        for stream in (self._input, self._output, self._log):
            with contextlib.suppress(OSError):  # a pipe whose reader is gone cannot be flushed
                stream.close()

    def _receive(self, timeout: float) -> Any:
        timer = threading.Timer(timeout, self._process.kill)
        timer.start()
        try:
            return pickle.load(self._output)
        except (EOFError, pickle.UnpicklingError) as error:
            raise NoPreviewError(self._why()) from error
        finally:
            timer.cancel()

    def _why(self) -> str:
        """One line on why the child ended: the last that it said."""
        try:
            code = self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:  # it goes on, but what it says makes no sense
            self._process.kill()
            code = self._process.wait()
        self._log.seek(0)
        lines = [line for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        said = lines[-1].strip()[:LONGEST_REASON] if lines else f"ended with status {code}"
        return f"{self.platform}: {said}"


class GLRenderer:
    """Draws triangles with OpenGL; points are drawn by the software renderer, which draws them as discs."""

    name = "gl"

    def __init__(self, child: _Child) -> None:
        self._child = child
        self._software = SoftwareRenderer()

    @property
    def platform(self) -> str:
        """``"egl"`` or ``"osmesa"``."""
        return self._child.platform

    def draw(self, camera: Camera, width: int, height: int, layers: Sequence[LitLayer]) -> list[Seen]:
        """What the camera sees of each layer on its own.

        Raises
        ------
        NoPreviewError
            If the driver fails; nothing is drawn then.
        """
        pose = np.eye(4)
        pose[:3, :3] = (camera.axes * [[1.0], [1.0], [-1.0]]).T
        pose[:3, 3] = camera.eye
        solid = [lit for lit in layers if lit.layer.faces is not None]
        request = {
            "pose": pose,
            "yfov": float(2.0 * np.arctan(camera.tan_half)),
            "width": width,
            "height": height,
            "layers": [_asked(lit) for lit in solid],
        }
        answers = iter(self._child.ask(request) if solid else ())
        return [
            self._software.draw(camera, width, height, [lit])[0]
            if lit.layer.faces is None
            else _seen(*next(answers))
            for lit in layers
        ]


def _asked(lit: LitLayer) -> dict[str, Any]:
    """What the child needs of a layer."""
    layer = lit.layer
    out: dict[str, Any] = {
        "vertices": layer.vertices,
        "faces": layer.faces,
        "colors": (lit.ambient, lit.direct),
    }
    if layer.image is not None:
        out["texture"] = (layer.uv, layer.image, layer.clamp, layer.both_sides)
    return out


def _seen(depth: Any, images: Any) -> Seen:
    from render import _raster_kernels as kernels

    with np.errstate(divide="ignore"):
        key = np.where(depth > 0.0, 1.0 / depth, kernels.NOTHING).astype(np.float32)
    return Seen(key, *images)


_found: tuple[_Child | None, GLStatus] | None = None
_lock = threading.Lock()


def find_gl() -> GLStatus:
    """Find out, once per process, whether OpenGL can draw here.

    ``PYOPENGL_PLATFORM``, if it is set, is the only platform that is tried.
    """
    return _find()[1]


def open_gl() -> GLRenderer:
    """The OpenGL renderer of this process.

    Raises
    ------
    NoPreviewError
        If OpenGL cannot be used.
    """
    child, status = _find()
    if child is None:
        raise NoPreviewError(f"OpenGL cannot be used here ({status.reason})")
    return GLRenderer(child)


def give_up_gl(reason: str) -> None:
    """Remember that OpenGL failed while it was drawing."""
    global _found
    with _lock:
        if _found is not None and _found[0] is not None:
            _found[0].close()
        _found = (None, GLStatus(None, "", reason))


def _find() -> tuple[_Child | None, GLStatus]:
    global _found
    with _lock:
        if _found is not None and (_found[0] is None or _found[0].alive()):
            return _found
        wanted = os.environ.get("PYOPENGL_PLATFORM")
        reasons = []
        for platform in (wanted,) if wanted in PLATFORMS else PLATFORMS:
            try:
                child = _Child(platform)
            except NoPreviewError as error:
                reasons.append(str(error))
                continue
            atexit.register(child.close)
            _found = (child, GLStatus(platform, child.device, "; ".join(reasons)))
            return _found
        _found = (None, GLStatus(None, "", "; ".join(reasons)))
        return _found
