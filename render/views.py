"""Pictures of a tree, alone or beside its scan, and turntables."""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from render import gl
from render.camera import Camera, fit_camera, view_axes
from render.errors import NoPreviewError
from render.lighting import Layer, Rays
from render.mesh import MeshSettings
from render.parts import Part
from render.picture import Stage, draw_picture
from render.scene import (
    broad_side,
    choose_panels,
    find_outline,
    foot_points,
    orbit,
    pick_points,
    revolve,
    scan_layer,
    set_stage,
    tree_layers,
)
from render.software import SoftwareRenderer
from treegraph import ClusterTree, InputError
from treegraph._files import write_whole

__all__ = ["Preview", "preview", "turntable", "write_gif"]

RENDERERS = ("auto", "gl", "software")
ELEVATION = float(np.radians(9.0))
MAX_SIDE = 8192  # pixels
TURNTABLE_SIZE = (480, 540)
TURNTABLE_COLORS = 160
MARGIN, CAPTION_ROOM = 0.06, 0.085  # empty part of a panel at its bottom, without and with captions
CAPTION_COLOR = (96, 98, 100)


@dataclass(frozen=True, eq=False)
class Preview:
    """A picture that was drawn.

    Attributes
    ----------
    image : (h, w, 3) uint8
        sRGB; of a turntable its first frame.
    renderer : str
        What drew it: ``"egl"``, ``"osmesa"`` or ``"software"``.
    notice : str or None
        One line, the first time in a process that OpenGL was wanted and something else drew.
    """

    image: NDArray[np.uint8]
    renderer: str
    notice: str | None = None


def preview(
    tree: ClusterTree,
    path: str | os.PathLike[str] | None = None,
    *,
    scan: ArrayLike | tuple[ArrayLike, ArrayLike | None] | None = None,
    size: tuple[int, int] | None = None,
    azimuth: float | None = None,
    elevation: float = ELEVATION,
    captions: bool = True,
    renderer: str = "auto",
    settings: MeshSettings | None = None,
    more: Sequence[Part] = (),
    parts: Sequence[Part] | None = None,
) -> Preview:
    """Draw a tree, and its scan beside it if there is one.

    Sun, sky and ground are the same whatever draws: OpenGL (pyrender, in a child process: EGL, then OSMesa)
    or the software renderer, which takes over where there is no OpenGL.

    Parameters
    ----------
    tree : ClusterTree
        Every radius must be known.
    path : path, optional
        PNG or JPEG file to write, by its suffix. It appears whole or not at all.
    scan : (n, 3) array or (array, colors), optional
        Points in the tree's frame, metres, and their sRGB colours, (n, 3) uint8 or None. More than 300 000
        are thinned at random, always in the same way. Points without a colour are coloured by height.
    size : (int, int), optional
        Width and height of the whole image, pixels, 16 to 8192. By default 1024 high and
        as wide as the tree asks.
    azimuth : float, optional
        Direction from the tree to the camera, radians from +x towards +y. By default the tree's
        broad side is seen.
    elevation : float
        Height of the camera above the horizon as seen from the tree, radians, -1.5 to 1.5.
    captions : bool
        Whether to write what is what, and a scale bar.
    renderer : {"auto", "gl", "software"}
        ``"gl"`` insists on OpenGL.
    settings : MeshSettings, optional
        How finely the branches are meshed.
    more : sequence of Part
        What else is drawn with the tree: leaves, neighbours, obstacles. Opaque ones first.
    parts : sequence of Part, optional
        What is drawn in the place of the tree's branches and hulls: those of a decoded tree, for instance
        (:func:`render.flat_parts`). Opaque ones first.

    Returns
    -------
    preview : Preview

    Raises
    ------
    InputError
        If an argument is out of its range, the scan is not (n, 3), or there is nothing to draw.
    TreeError
        If a radius is unknown.
    NoPreviewError
        If `renderer` is ``"gl"`` and OpenGL cannot be used.
    """
    _check_view(size, azimuth, elevation, renderer, path)
    starting = _start_gl(renderer)
    cloud = None if scan is None else pick_points(scan)
    outline = find_outline(tree, cloud, more, parts)
    axes = view_axes(broad_side(outline) if azimuth is None else azimuth, elevation)
    n_panels = 1 if cloud is None else 2
    panel, width = choose_panels(size, n_panels, outline, axes)
    framed = np.concatenate([outline, foot_points(outline, tree)])
    camera = fit_camera(framed, axes, *panel, bottom=CAPTION_ROOM if captions else MARGIN)
    stage = set_stage(outline, tree)
    scenes = [tree_layers(tree, camera, panel, settings, more, parts)]
    if cloud is not None:
        scenes.insert(0, [scan_layer(*cloud, camera, panel)])
    starting.join()
    images, used, notice = _draw_all(renderer, scenes, camera, stage, panel)
    image = _join(images, width)
    if captions:
        _annotate(image, camera, stage, ("scan", "model") if cloud is not None else ())
    if path is not None:
        write_whole(path, _encoded(image, Path(path).suffix))
    return Preview(image, used, notice)


def turntable(
    tree: ClusterTree,
    path: str | os.PathLike[str],
    *,
    frames: int = 36,
    seconds: float = 4.0,
    size: tuple[int, int] = TURNTABLE_SIZE,
    elevation: float = ELEVATION,
    renderer: str = "auto",
    settings: MeshSettings | None = None,
    more: Sequence[Part] = (),
    parts: Sequence[Part] | None = None,
) -> Preview:
    """Draw a tree from all sides: an animated GIF, or one PNG per frame.

    Parameters
    ----------
    tree : ClusterTree
        Every radius must be known.
    path : path
        A name that ends in ``.gif``, or a folder (made if it is not there) for ``frame_000.png`` and so on.
    frames : int
        Pictures in one turn, 1 to 720.
    seconds : float
        Time of one turn in the GIF, > 0.
    size, elevation, renderer, settings, more, parts
        As in :func:`preview`; the size is that of every frame.

    Returns
    -------
    preview : Preview
        The first frame.

    Raises
    ------
    InputError, TreeError, NoPreviewError
        As :func:`preview`.
    """
    _check_view(size, 0.0, elevation, renderer, None)
    path = Path(path)
    if not 1 <= frames <= 720:
        raise InputError(f"frames must be 1 to 720, got {frames!r}")
    if not 0.0 < seconds < np.inf:
        raise InputError(f"seconds must be a time > 0, got {seconds!r}")
    if path.suffix.lower() not in ("", ".gif"):
        raise InputError(f"a turntable is written to NAME.gif or to a folder, got {path.name!r}")
    starting = _start_gl(renderer)
    outline = find_outline(tree, None, more, parts)
    stage = set_stage(outline, tree)
    first = broad_side(outline)
    camera = fit_camera(revolve(outline, stage), view_axes(0.0, elevation), *size)
    layers = tree_layers(tree, camera, size, settings, more, parts)
    starting.join()
    images, used, notice, sky = [], "", None, None
    for k in range(frames):
        turned = orbit(camera, stage, first + 2.0 * np.pi * k / frames)
        image, used, said, sky = _draw(renderer, layers, turned, stage, size, sky)
        notice = notice or said
        images.append(image)
    if path.suffix:
        write_whole(path, _gif(images, seconds / frames))
    else:
        path.mkdir(parents=True, exist_ok=True)
        for k, image in enumerate(images):
            write_whole(path / f"frame_{k:03d}.png", _encoded(image, ".png"))
    return Preview(images[0], used, notice)


_notice_given = threading.Event()


def _start_gl(renderer: str) -> threading.Thread:
    """Start OpenGL, if it is wanted, while the geometry is being made."""
    thread = threading.Thread(target=gl.find_gl if renderer != "software" else (lambda: None))
    thread.start()
    return thread


def _draw_all(
    renderer: str, scenes: Sequence[list[Layer]], camera: Camera, stage: Stage, size: tuple[int, int]
) -> tuple[list[NDArray[np.uint8]], str, str | None]:
    images, used, notice = [], "", None
    for layers in scenes:
        image, used, said, _ = _draw(renderer, layers, camera, stage, size, None)
        notice = notice or said
        images.append(image)
    return images, used, notice


def _draw(
    renderer: str, layers: list[Layer], camera: Camera, stage: Stage, size: tuple[int, int], sky: Rays | None
) -> tuple[NDArray[np.uint8], str, str | None, Rays]:
    """Draw with OpenGL if it is wanted and there is any, else without."""
    if renderer != "software":
        try:
            drawer = gl.open_gl()
            image, sky = draw_picture(drawer, layers, camera, stage, size, sky)
            return image, drawer.platform, None, sky
        except NoPreviewError as error:
            gl.give_up_gl(str(error))
            if renderer == "gl":
                raise
            reason = str(error)
    notice = None
    if renderer == "auto" and not _notice_given.is_set():
        _notice_given.set()
        notice = f"previews are drawn without OpenGL: {reason}"
    image, sky = draw_picture(SoftwareRenderer(), layers, camera, stage, size, sky)
    return image, SoftwareRenderer.name, notice, sky


def _join(images: Sequence[NDArray[np.uint8]], width: int) -> NDArray[np.uint8]:
    """Panels side by side; a column that is left over repeats the last one."""
    image = np.concatenate(images, axis=1)
    return np.ascontiguousarray(np.pad(image, ((0, 0), (0, width - image.shape[1]), (0, 0)), mode="edge"))


def _annotate(image: NDArray[np.uint8], camera: Camera, stage: Stage, names: Sequence[str]) -> None:
    """Write the panels' names and a scale bar into the image."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = image.shape[:2]
    canvas = Image.fromarray(image)
    draw = ImageDraw.Draw(canvas)
    letters = max(round(0.021 * height), 8)
    font = ImageFont.load_default(letters)
    line = height - round(0.035 * height)
    panel = width // max(len(names), 1)
    for k, name in enumerate(names):
        draw.text((panel * (k + 0.5), line), name, fill=CAPTION_COLOR, font=font, anchor="mm")
    base = np.array([[*stage.centre, stage.ground_z]])
    pixels_per_metre = camera.focal(height) / camera.project(base, panel, height)[0, 2]
    length = _round_length(0.2 * panel / pixels_per_metre)
    start, end = 0.03 * height, 0.03 * height + length * pixels_per_metre
    stroke = max(round(0.002 * height), 1)
    draw.line([(start, line), (end, line)], fill=CAPTION_COLOR, width=stroke)
    for x in (start, end):
        draw.line([(x, line - 2.5 * stroke), (x, line + 2.5 * stroke)], fill=CAPTION_COLOR, width=stroke)
    draw.text((end + 0.5 * letters, line), _length_text(length), fill=CAPTION_COLOR, font=font, anchor="lm")
    image[:] = np.asarray(canvas)


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20 ... that is no longer, metres."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-9)))


def _length_text(length: float) -> str:
    for factor, unit in ((1.0, "m"), (100.0, "cm"), (1000.0, "mm")):
        if length * factor >= 0.999 or unit == "mm":
            return f"{length * factor:.3g} {unit}"
    raise AssertionError("the last unit takes what is left")


def _encoded(image: NDArray[np.uint8], suffix: str) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    if suffix.lower() == ".png":
        Image.fromarray(image).save(out, "PNG", compress_level=6)
    else:
        Image.fromarray(image).save(out, "JPEG", quality=92)
    return out.getvalue()


def write_gif(
    path: str | os.PathLike[str], images: Sequence[NDArray[np.uint8]], *, seconds: float = 0.2
) -> None:
    """Write pictures of one size as an animated GIF; it appears whole or not at all.

    Parameters
    ----------
    path : path
    images : sequence of (h, w, 3) uint8
        At least one.
    seconds : float
        For which each is shown; at least 0.02.

    Raises
    ------
    InputError
        If there is no picture, or they differ in size.
    """
    if not images or any(image.shape != images[0].shape for image in images):
        raise InputError("an animation takes one or more pictures of one size")
    write_whole(path, _gif(images, seconds))


def _gif(images: Sequence[NDArray[np.uint8]], seconds: float) -> bytes:
    from PIL import Image

    palette = Image.fromarray(np.concatenate(images[:: max(len(images) // 4, 1)], axis=1))
    palette = palette.quantize(TURNTABLE_COLORS, method=Image.Quantize.MEDIANCUT)
    pages = [Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    out = io.BytesIO()
    pages[0].save(
        out, "GIF", save_all=True, append_images=pages[1:], duration=max(round(1000 * seconds), 20), loop=0
    )
    return out.getvalue()


def _check_view(
    size: tuple[int, int] | None, azimuth: float | None, elevation: float, renderer: str, path: Any
) -> None:
    if renderer not in RENDERERS:
        raise InputError(f"renderer must be one of {', '.join(RENDERERS)}, got {renderer!r}")
    if size is not None and (len(size) != 2 or not all(16 <= side <= MAX_SIDE for side in size)):
        raise InputError(f"size must be a width and a height of 16 to {MAX_SIDE} pixels, got {size!r}")
    if azimuth is not None and not np.isfinite(azimuth):
        raise InputError(f"azimuth must be a finite angle in radians, got {azimuth!r}")
    if not -1.5 <= elevation <= 1.5:
        raise InputError(f"elevation must be -1.5 to 1.5 radians, got {elevation!r}")
    if path is not None and Path(path).suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"a preview is written to NAME.png or NAME.jpg, got {Path(path).name!r}")
