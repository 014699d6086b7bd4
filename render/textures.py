"""Images on surfaces: leaf blades with their outline as alpha, bark, normal maps."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph import InputError

__all__ = ["CUTOFF", "Texture"]

CUTOFF = 0.5  # alpha below which a surface is not there, where no other is asked for
MAX_SIDE = 8192  # pixels


@dataclass(frozen=True, eq=False)
class Texture:
    """An image that lies on a surface.

    Attributes
    ----------
    pixels : (h, w, 3) or (h, w, 4) uint8
        sRGB colour (of a normal map: its three components) and, if there are four channels, alpha. The first
        row is the upper edge. Texture coordinates run from (0, 0) in the lower left corner to (1, 1) in the
        upper right: a leaf stands upright in its image, its base in the middle of the lower edge.
    """

    pixels: NDArray[np.uint8]

    def __post_init__(self) -> None:
        pixels = np.array(self.pixels, order="C")
        if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
            raise InputError(
                f"a texture must be uint8 of shape (h, w, 3) or (h, w, 4), got {pixels.dtype} {pixels.shape}"
            )
        if not all(1 <= side <= MAX_SIDE for side in pixels.shape[:2]):
            raise InputError(f"a texture must be 1 to {MAX_SIDE} pixels a side, got {pixels.shape[:2]}")
        pixels.flags.writeable = False
        object.__setattr__(self, "pixels", pixels)

    def __repr__(self) -> str:
        height, width, channels = self.pixels.shape
        return f"<Texture {width} x {height}, {channels} channels>"

    @property
    def has_alpha(self) -> bool:
        """Whether there is a fourth channel."""
        return self.pixels.shape[2] == 4

    def coverage(self, cutoff: float = CUTOFF) -> float:
        """Part of the image that is there: alpha at or above the cutoff, 0 to 1."""
        if not self.has_alpha:
            return 1.0
        return float((self.pixels[..., 3] >= 255.0 * cutoff).mean())

    def mean_color(self, cutoff: float = CUTOFF) -> NDArray[np.float64]:
        """Mean sRGB colour (3,), 0 to 1, of what is there; averaged as light."""
        from render.lighting import to_linear, to_srgb

        shown = self.pixels[..., :3].reshape(-1, 3)
        if self.has_alpha:
            there = self.pixels[..., 3].reshape(-1) >= 255.0 * cutoff
            shown = shown[there] if there.any() else shown
        return to_srgb(to_linear(shown / 255.0).mean(axis=0))

    def spread(self, cutoff: float = CUTOFF) -> NDArray[np.uint8]:
        """The pixels, with the nearest leaf's colour where there is none.

        What lies beyond the outline is not seen, but filters mix it into the edge: whatever colour it has
        becomes a rim around every leaf.

        Returns
        -------
        pixels : (h, w, c) uint8
            Alpha is as it was. An image without alpha, or with nothing in it, is returned as it is.
        """
        if not self.has_alpha:
            return self.pixels
        away = self.pixels[..., 3] < 255.0 * cutoff
        if away.all() or not away.any():
            return self.pixels
        from scipy.ndimage import distance_transform_edt

        row, column = distance_transform_edt(away, return_distances=False, return_indices=True)
        out = self.pixels.copy()
        out[..., :3] = self.pixels[row, column, :3]
        return out

    def coded(self, cutoff: float | None) -> NDArray[np.uint8]:
        """The image for :class:`render.lighting.Layer`: (h, w, 4) uint8, alpha cut at one half."""
        from render.lighting import to_linear

        out = np.full((*self.pixels.shape[:2], 4), 255, np.uint8)
        color = self.pixels if cutoff is None else self.spread(cutoff)
        out[..., :3] = np.rint(255.0 * np.sqrt(to_linear(color[..., :3] / 255.0)))
        if cutoff is not None:
            out[..., 3] = np.clip(np.rint(self.pixels[..., 3] + 255.0 * (0.5 - cutoff)), 0.0, 255.0)
        return out

    def encode_png(self, cutoff: float = CUTOFF) -> bytes:
        """The image as a PNG file, colours spread beyond the outline."""
        from PIL import Image

        out = io.BytesIO()
        Image.fromarray(self.spread(cutoff)).save(out, "PNG", compress_level=9)
        return out.getvalue()


def shrink_image(image: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """The coded image with blocks of pixels averaged as light: halved while `factor` is 2 or more."""
    while factor >= 2 and min(image.shape[:2]) >= 2:
        height, width = (side // 2 * 2 for side in image.shape[:2])
        light = image[:height, :width].astype(np.float64) ** 2
        light = light.reshape(height // 2, 2, width // 2, 2, 4).mean(axis=(1, 3))
        image = np.rint(np.sqrt(light)).astype(np.uint8)
        factor //= 2
    return image


def check_texture(name: str, value: Any) -> None:
    """Raise :class:`InputError` unless the value is a texture or None."""
    if value is not None and not isinstance(value, Texture):
        raise InputError(f"a material's {name} must be a Texture or None, got {type(value).__name__}")
