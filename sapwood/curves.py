"""A picture of how a fit came nearer: distance over trees grown and compared, one line for each run."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from treegraph.errors import InputError

__all__ = ["check_curve_name", "draw_curves"]

SUFFIXES = (".png", ".jpg", ".jpeg")
SIZE = (900, 520)  # pixels
LEFT, RIGHT, TOP, BOTTOM = 78, 28, 28, 64  # pixels around the axes
LETTERS = 18  # pixels
BACK, INK, GRID, FAINT = (255, 255, 255), (60, 60, 60), (226, 226, 226), 0.55
STEPS = (1.0, 2.0, 5.0, 10.0)
LINES = 5  # of the grid, about, each way
GOLDEN = 0.6180339887498949  # steps of it spread hues evenly


def check_curve_name(path: Path) -> None:
    """Refuse the name of a picture that cannot be written.

    Raises
    ------
    InputError
        If it does not end in .png, .jpg or .jpeg.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: the name of a picture must end in {' or '.join(SUFFIXES)}.")


def draw_curves(curves: Sequence[Sequence[tuple[int, float]]], path: Path | None = None) -> Any:
    """Draw the distance of each run over its evaluations (Stava et al. 2014, figure 11).

    What was found on the way is drawn faintly, the least so far in full colour.

    Parameters
    ----------
    curves : sequence of sequences of (int, float)
        Of :attr:`inverse.Fit.curves`.
    path : path, optional
        Where it is written.

    Returns
    -------
    image : PIL.Image.Image
    """
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("RGB", SIZE, BACK)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(LETTERS)
    points = [pair for curve in curves for pair in curve]
    last = max([1, *(count for count, _ in points)])
    values = [value for _, value in points]
    step = _step(max(max(values, default=1.0) - min(values, default=0.0), 0.05))
    low = step * math.floor(min(values, default=0.0) / step)
    high = step * math.ceil(max(values, default=1.0) / step + 1e-9)

    def place(count: float, value: float) -> tuple[float, float]:
        x = LEFT + (SIZE[0] - LEFT - RIGHT) * count / last
        return x, SIZE[1] - BOTTOM - (SIZE[1] - TOP - BOTTOM) * (value - low) / (high - low)

    for k in range(round((high - low) / step) + 1):
        value = low + k * step
        draw.line([place(0, value), place(last, value)], GRID, 1)
        draw.text((LEFT - 10, place(0, value)[1]), f"{value:.3g}", INK, font, anchor="rm")
    across = max(1.0, _step(last))
    for k in range(int(last / across) + 1):
        x, y = place(k * across, low)
        draw.line([(x, y), (x, y + 5)], INK, 1)
        draw.text((x, y + 9), f"{k * across:.0f}", INK, font, anchor="mt")
    for k, curve in enumerate(curves):
        color = tuple(round(255 * part) for part in colorsys.hsv_to_rgb((0.6 + k * GOLDEN) % 1.0, 0.7, 0.75))
        faint = tuple(round(FAINT * 255 + (1.0 - FAINT) * part) for part in color)
        draw.line([place(*pair) for pair in curve], faint, 1)
        draw.line([place(*pair) for pair in _least_so_far(curve)], color, 3, joint="curve")
    draw.line([place(0, high), place(0, low), place(last, low)], INK, 1)
    draw.text((SIZE[0] - RIGHT, SIZE[1] - 8), "trees grown and compared", INK, font, anchor="rb")
    draw.text((LEFT + 8, TOP), "distance", INK, font, anchor="lb")
    if path is not None:
        image.save(path)
    return image


def _step(reach: float) -> float:
    """A round step that divides a length into about so many parts."""
    rough = reach / LINES
    unit = 10.0 ** math.floor(math.log10(rough))
    return unit * next(step for step in STEPS if unit * step >= rough * 0.999)


def _least_so_far(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """A staircase: each distance that is less than all before, and the last count."""
    out: list[tuple[int, float]] = []
    least = math.inf
    for count, value in curve:
        if out and value < least:
            out.append((count, least))
        least = min(least, value)
        out.append((count, least))
    return out
