"""A species ready for use: patches and pictures, derived from its definition or read where they are kept.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University of
Konstanz, 2013, section 3.4 (the species library).
"""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from species._art_shape import SEASONS
from species.library.branchlets import Branchlet, cut_branchlet, derive_branchlets
from species.library.definition import Definition
from species.library.packing import PICTURES, Packed, pack_species, unpack_species
from species.patches import Patch
from treegraph.errors import FormatError, InputError

__all__ = ["BUILDER", "MOST_SPECIES_BYTES", "Species", "build_species", "derived_key", "open_species"]

BUILDER = 1
"""Version of how things are derived: what an older builder made is made anew."""
PICTURE_SIDE = 256  # pixels
MOST_SPECIES_BYTES = 200_000
OPAQUE = 128  # alpha from which a leaf is there
LEAST_COVERAGE = 0.002  # of its picture that a leaf has to cover
MOST_PIXELS = 2048  # a side of a picture that is read
LEAF_STREAM, BARK_STREAM = 11, 12  # of random numbers


@dataclass(frozen=True, eq=False)
class Species:
    """A species with all that is derived of it.

    Attributes
    ----------
    definition : Definition
    branchlets : tuple of Branchlet
        Whole, as they hang on the tree.
    patches : tuple of Patch
        What clusters are textured with.
    pictures : dict of str to bytes
        WebP files: ``leaf_summer``, other seasons, ``leaf_normal``, ``bark``, ``bark_normal``.
    leaf_box : (float, float, float, float)
        Left, bottom, right and top of the leaf's pictures in the leaf's frame, metres.
    bark_tile : float
        Metres of stem that the bark's pictures cover.
    n_bytes : int
        Of the definition and the derived file together.
    """

    definition: Definition
    branchlets: tuple[Branchlet, ...]
    patches: tuple[Patch, ...]
    pictures: dict[str, bytes]
    leaf_box: tuple[float, float, float, float]
    bark_tile: float
    n_bytes: int

    def __repr__(self) -> str:
        return (
            f"<Species {self.name}: {len(self.branchlets)} branchlets, {len(self.patches)} patches, "
            f"{self.n_bytes / 1000:.0f} kB>"
        )

    @property
    def name(self) -> str:
        """The name under which it is found."""
        return self.definition.name

    def picture(self, name: str) -> NDArray[np.uint8]:
        """The pixels of a picture by its name in :attr:`pictures`: (h, w, 3), of a season's leaf (h, w, 4).

        Raises
        ------
        InputError
            If there is none: of a season without leaves.
        FormatError
            If it is damaged.
        """
        if name not in self.pictures:
            raise InputError(f"{self.name} has no picture {name!r}; it has {', '.join(self.pictures)}")
        return _pixels(self.pictures[name], "RGBA" if name[len("leaf_") :] in SEASONS else "RGB")

    @property
    def box(self) -> tuple[float, float, float, float]:
        """The pictures' place on a leaf: sides in widths, heights in lengths of :class:`LeafSet`'s leaves."""
        left, bottom, right, top = self.leaf_box
        width, length = right - left, self.definition.leaf.length
        return left / width, bottom / length, right / width, top / length

    @cached_property
    def leaf_share(self) -> float:
        """Leaf area, one side, over length times width of a leaf: what the outline leaves of its quad."""
        name = next(f"leaf_{season}" for season in SEASONS if f"leaf_{season}" in self.pictures)
        left, bottom, right, top = self.box
        there = float((self.picture(name)[..., 3] >= OPAQUE).mean())
        return there * (right - left) * (top - bottom)


def derived_key(definition: Definition) -> str:
    """SHA-256 of the definition and the builder's version: what a derived file belongs to."""
    return hashlib.sha256(f"{BUILDER}\n{definition.text}".encode()).hexdigest()


def build_species(definition: Definition) -> bytes:
    """Derive branchlets and draw pictures: the bytes of the derived file.

    Raises
    ------
    GrammarError, DerivationError, InputError
        If something in the definition cannot be derived, its leaves are too thin to be drawn, or it gets
        larger than a species may be.
    """
    from species.barkart import draw_bark
    from species.leafart import draw_leaf, encode_webp

    branchlets = derive_branchlets(definition)
    pictures: dict[str, bytes] = {}
    box: tuple[float, ...] = ()
    for season in SEASONS:
        if definition.is_bare(season):
            continue
        rng = np.random.default_rng(LEAF_STREAM)
        drawn = draw_leaf(definition.leaf, definition.colors, PICTURE_SIDE, rng=rng, season=season)
        if (drawn.rgba[..., 3] >= OPAQUE).mean() < LEAST_COVERAGE:
            raise InputError(f"[leaf] its picture of {PICTURE_SIDE} pixels is all but empty; make it wider")
        pictures[f"leaf_{season}"] = encode_webp(drawn.rgba)
        pictures["leaf_normal"] = encode_webp(drawn.normal)
        box = tuple(float(side) for side in drawn.box)
    bark = draw_bark(definition.bark, PICTURE_SIDE, rng=np.random.default_rng(BARK_STREAM))
    pictures["bark"] = encode_webp(np.ascontiguousarray(bark.rgba[..., :3]))
    pictures["bark_normal"] = encode_webp(bark.normal)
    data = pack_species(derived_key(definition), branchlets, pictures, box, bark.tile)
    total = len(data) + len(definition.text.encode())
    if total > MOST_SPECIES_BYTES:
        raise InputError(
            f"the species takes {total / 1000:.0f} kB, more than {MOST_SPECIES_BYTES // 1000}: "
            "derive fewer or smaller branchlets, or with fewer leaves"
        )
    return data


def open_species(definition: Definition, data: bytes) -> Species:
    """The species of a definition and its derived file.

    Raises
    ------
    FormatError
        If the file is damaged, or belongs to another definition or builder.
    """
    packed: Packed = unpack_species(data)
    if packed.key != derived_key(definition):
        raise FormatError(f"the derived file does not belong to this definition of {definition.name}")
    bare = {f"leaf_{season}" for season in SEASONS if definition.is_bare(season)}
    if set(packed.pictures) != set(PICTURES) - bare or len(packed.branchlets) != definition.branchlets.count:
        raise FormatError("pictures or branchlets of the definition are not in it; the file is damaged")
    patches = [
        patch
        for number, branchlet in enumerate(packed.branchlets)
        for patch in cut_branchlet(branchlet, number)
    ]
    size = len(data) + len(definition.text.encode())
    return Species(
        definition,
        packed.branchlets,
        tuple(patches),
        packed.pictures,
        packed.leaf_box,
        packed.bark_tile,
        size,
    )


def _pixels(data: bytes, mode: str) -> NDArray[np.uint8]:
    from PIL import Image, UnidentifiedImageError

    if max(_webp_size(data)) > MOST_PIXELS:  # said before anything is made ready for it
        raise FormatError(f"a picture has more than {MOST_PIXELS} pixels a side; the file is damaged")
    try:
        with Image.open(io.BytesIO(data), formats=["WEBP"]) as image:
            return np.array(image.convert(mode))
    except (UnidentifiedImageError, OSError, ValueError) as error:
        raise FormatError(f"a picture cannot be read ({error}); the file is damaged") from None


def _webp_size(data: bytes) -> tuple[int, int]:
    """Width and height that a WebP file declares: of its canvas, or of the only image in it."""
    kind, body = data[12:16], data[20:30]
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP" and len(body) == 10:
        if kind == b"VP8X":
            return int.from_bytes(body[4:7], "little") + 1, int.from_bytes(body[7:10], "little") + 1
        if kind == b"VP8 ":
            return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF
        if kind == b"VP8L":
            bits = int.from_bytes(body[1:5], "little")
            return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    raise FormatError("a picture must be a WebP file; the file is damaged")
