"""Contact sheets: many small pictures on one page, each with its caption."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph import InputError
from treegraph._files import write_whole

__all__ = ["contact_sheet"]

PAPER = (244, 245, 246)
INK = (70, 72, 74)
GAP = 10  # pixels between pictures and around them
LETTERS = (9, 26)  # height of captions, pixels, at least and at most
LETTER_SHARE = 0.06  # of a picture's height
MOST_PIXELS = 2**28


def contact_sheet(
    images: Sequence[ArrayLike],
    captions: Sequence[str] | None = None,
    columns: int = 4,
    *,
    path: str | os.PathLike[str] | None = None,
) -> NDArray[np.uint8]:
    """Put pictures side by side, row by row, each with a caption below it.

    Parameters
    ----------
    images : sequence of (h, w, 3) or (h, w, 4) uint8
        At least one, sRGB; they may differ in size. What is transparent shows the paper.
    captions : sequence of str, optional
        One for each picture; what is too long for its place is written smaller, then cut off.
    columns : int
        Pictures in a row, at least 1; fewer pictures than that make a narrower sheet.
    path : path, optional
        PNG file to write. It appears whole or not at all.

    Returns
    -------
    sheet : (h, w, 3) uint8
        All cells are as large as the largest picture; smaller ones stand in their middle.

    Raises
    ------
    InputError
        If there is no picture, one is not an image, or the numbers do not agree.
    """
    pictures = [_checked(k, image) for k, image in enumerate(images)]
    if not pictures:
        raise InputError("a contact sheet needs at least one picture, got none")
    if columns < 1:
        raise InputError(f"columns must be 1 or more, got {columns!r}")
    if captions is not None and len(captions) != len(pictures):
        raise InputError(f"each picture needs one caption, got {len(captions)} for {len(pictures)}")
    if path is not None and Path(path).suffix.lower() != ".png":
        raise InputError(f"a contact sheet is written to NAME.png, got {Path(path).name!r}")
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    height, width = (max(picture.shape[axis] for picture in pictures) for axis in (0, 1))
    letters = int(np.clip(round(LETTER_SHARE * height), *LETTERS))
    below = 0 if captions is None else round(1.6 * letters)
    step = (height + below + GAP, width + GAP)
    if (rows * step[0] + GAP) * (columns * step[1] + GAP) > MOST_PIXELS:
        raise InputError(f"a contact sheet has at most {MOST_PIXELS} pixels; make the pictures smaller")
    sheet = np.empty((rows * step[0] + GAP, columns * step[1] + GAP, 3), np.uint8)
    sheet[:] = PAPER
    corners = [(GAP + k // columns * step[0], GAP + k % columns * step[1]) for k in range(len(pictures))]
    for picture, (top, left) in zip(pictures, corners, strict=True):
        _paste(sheet, picture, top + (height - len(picture)) // 2, left + (width - picture.shape[1]) // 2)
    if captions is not None:
        places = [(left + 0.5 * width, top + height + 0.55 * below) for top, left in corners]
        sheet = _write(sheet, captions, places, letters, width)
    if path is not None:
        write_whole(path, _png(sheet))
    return sheet


def _checked(k: int, image: ArrayLike) -> NDArray[np.uint8]:
    picture = np.asarray(image)
    good = picture.ndim == 3 and picture.shape[2] in (3, 4) and picture.size and picture.dtype == np.uint8
    if not good:
        raise InputError(
            f"images[{k}] must be uint8 of shape (h, w, 3) or (h, w, 4), got {picture.dtype} {picture.shape}"
        )
    return picture


def _paste(sheet: NDArray[np.uint8], picture: NDArray[np.uint8], top: int, left: int) -> None:
    height, width = picture.shape[:2]
    place = sheet[top : top + height, left : left + width]
    if picture.shape[2] == 3:
        place[:] = picture
        return
    alpha = picture[..., 3:] / 255.0
    place[:] = np.rint(alpha * picture[..., :3] + (1.0 - alpha) * place)


def _write(
    sheet: NDArray[np.uint8],
    captions: Sequence[str],
    places: Sequence[tuple[float, float]],
    letters: int,
    room: int,
) -> NDArray[np.uint8]:
    """Captions centred at their places, none wider than its cell."""
    from PIL import Image, ImageDraw, ImageFont

    canvas = Image.fromarray(sheet)
    draw = ImageDraw.Draw(canvas)
    fonts: list[Any] = [ImageFont.load_default(size) for size in range(letters, LETTERS[0] - 1, -1)]
    for caption, place in zip(captions, places, strict=True):
        text = " ".join(str(caption).split())
        font = next((f for f in fonts if draw.textlength(text, font=f) <= room), fonts[-1])
        while len(text) > 1 and draw.textlength(text, font=font) > room:
            text = text[:-2].rstrip() + "…"
        draw.text(place, text, fill=INK, font=font, anchor="mm")
    return np.array(canvas)


def _png(sheet: NDArray[np.uint8]) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(sheet).save(out, "PNG", compress_level=6)
    return out.getvalue()
