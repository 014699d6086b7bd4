"""The numbers that a leaf is drawn from, with unit and range of each."""

from __future__ import annotations

from dataclasses import dataclass

from species._art_fields import Color, check_fields, choice, number, srgb, whole
from treegraph.errors import InputError

__all__ = ["DIVIDED", "KINDS", "MARGINS", "SEASONS", "LeafColors", "LeafShape"]

KINDS = ("simple", "linear", "lobed", "star", "fan", "palmate", "pinnate", "bipinnate", "frond", "needle")
DIVIDED = ("palmate", "pinnate", "bipinnate", "frond", "needle")
"""Kinds made of leaflets or needles, which have a length and a width of their own."""
MARGINS = ("entire", "wavy", "crenate", "serrate", "double")
SEASONS = ("spring", "summer", "autumn", "winter")

NEEDS: dict[str, tuple[str, ...]] = {
    kind: ("leaflet_length", "leaflet_width") if kind in DIVIDED else ("width",) for kind in KINDS
}
NEEDS["bipinnate"] = ("width", "leaflet_length", "leaflet_width")
NEEDS["star"] = NEEDS["fan"] = ()  # as wide as their lobes reach


@dataclass(frozen=True)
class LeafShape:
    """A leaf from a few numbers. ``docs/leaves.md`` has a table of them.

    ``simple`` and ``linear`` (parallel sides) have one undivided blade, ``lobed`` one with lobes along its
    midrib (oak), ``star`` lobes around its base (maple) and ``fan`` many narrow ones (fan palm).
    ``palmate`` leaflets come from one point, ``pinnate`` and ``bipinnate`` ones stand along a rachis once and
    twice, those of a ``frond`` (feather palm) too. ``needle`` is a shoot with needles.

    Raises
    ------
    InputError
        If a number is out of its range, or one that this kind needs is missing or means nothing to it; the
        message has the field, its range and the value.

    Examples
    --------
    >>> LeafShape("simple", length=0.08, width=0.05).petiole
    0.01
    >>> LeafShape("simple", length=0.08, width=50)
    Traceback (most recent call last):
        ...
    treegraph.errors.InputError: width must be from 0.0005 to 6 metres, got 50
    """

    kind: str = choice(KINDS, "how the blade is built")
    length: float = number(0.003, 8, "metres", "from the end of the petiole to the tip of the whole leaf")
    width: float | None = number(
        0.0005, 6, "metres", "of the blade where it is widest; of a bipinnate leaf as a whole", None, True
    )
    widest: float = number(
        0.05, 0.95, "of the length", "where the blade (or each leaflet) is widest, from its base", 0.45
    )
    tip: float = number(0, 1, "", "0 round, 0.5 pointed, 1 drawn out", 0.5)
    base: float = number(-1, 1, "", "-1 heart-shaped, 0 round, 0.5 wedge, 1 drawn out", 0.2)
    drip: float = number(0, 0.4, "of the length", "narrow tail that ends the blade", 0.0)
    bend: float = number(-0.5, 0.5, "of the length", "sickle shape of blade or leaflets", 0.0)
    margin: str = choice(MARGINS, "edge of the blade", "entire")
    teeth: int = whole(0, 80, "teeth or waves on each side of a blade, leaflet or (star) lobe", 0)
    tooth_depth: float = number(0, 0.5, "of the half width", "depth of teeth or waves", 0.08)
    lobes: int = whole(1, 60, "lobes: on each side (lobed), in all (star), segments in all (fan)", 5)
    lobe_depth: float = number(0, 0.95, "", "how far cuts between lobes reach towards midrib or base", 0.45)
    spread_deg: float = number(
        5, 350, "degrees", "angle that lobes, leaflets from one point or needles of a bundle fill", 140
    )
    leaflets: int = whole(
        1, 300, "leaflets in all, odd: one at the end; on each pinna; bundles or needles on a shoot", 1
    )
    leaflet_length: float | None = number(0.002, 3, "metres", "of the longest leaflet or needle", None, True)
    leaflet_width: float | None = number(0.0003, 1, "metres", "of that leaflet or needle", None, True)
    leaflet_angle_deg: float = number(
        5, 110, "degrees", "between rachis or shoot and leaflet, pinna or needle", 60
    )
    taper: float = number(0, 0.95, "", "how much smaller the outermost leaflets are than the largest", 0.3)
    pinnae: int = whole(1, 40, "pairs of pinnae of a bipinnate leaf", 10)
    cluster: int = whole(1, 8, "needles in a bundle", 1)
    petiole: float = number(0, 2, "metres", "length of the stalk; of a needle shoot the bare part", 0.01)
    stalk_width: float = number(0.0002, 0.2, "metres", "thickness of petiole, rachis or shoot", 0.0012)
    veins: int = whole(0, 60, "side veins on each side of a blade or leaflet", 7)
    vein_angle_deg: float = number(15, 90, "degrees", "between midrib and side veins", 50)
    midrib: float = number(0, 0.3, "of the width", "thickness of the midrib at its base", 0.03)
    relief: float = number(0, 2, "", "height of veins and cupping in the normal map", 1.0)
    fold_deg: float = number(-80, 80, "degrees", "how far each half is turned up along the midrib", 15)
    curl_deg: float = number(-180, 180, "degrees", "how far the tip is turned down against the base", 25)

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("width", "leaflet_length", "leaflet_width"):
            given = getattr(self, name) is not None
            if name in NEEDS[self.kind] and not given:
                raise InputError(
                    f"{name} is missing: a {self.kind} leaf needs {' and '.join(NEEDS[self.kind])}"
                )
            if given and name not in NEEDS[self.kind]:
                raise InputError(f"{name} means nothing to a {self.kind} leaf; leave it out")
        if self.kind in DIVIDED and self.leaflet_length is not None and self.leaflet_length > self.length:
            raise InputError(
                f"leaflet_length must be at most the length {self.length} metres, got {self.leaflet_length}"
            )
        if self.kind == "bipinnate" and self.leaflets < 2:
            raise InputError(f"leaflets must be 2 or more on each pinna, got {self.leaflets}")


@dataclass(frozen=True)
class LeafColors:
    """Colours of a leaf through the year, each ``[r, g, b]`` from 0 to 255 or ``"#rrggbb"``.

    Raises
    ------
    InputError
        If one is no colour; the message has the field and the value.
    """

    spring: Color = srgb("of young leaves", (122, 158, 62))
    summer: Color = srgb("of grown leaves", (74, 112, 44))
    autumn: Color = srgb("before they fall; of an evergreen as in summer", (190, 138, 48))
    winter: Color | None = srgb("left out: bare", None, optional=True)
    back: Color | None = srgb("of the lower side in summer; left out: paler", None, optional=True)
    vein: Color | None = srgb("of midrib and veins; left out: lighter", None, optional=True)
    stalk: Color | None = srgb("of petiole, rachis or shoot; left out: browner", None, optional=True)
    variation: float = number(0, 1, "", "how much colours differ within a leaf", 0.3)

    def __post_init__(self) -> None:
        check_fields(self)

    def of_season(self, season: str) -> Color | None:
        """The colour in "spring", "summer", "autumn" or "winter"; None when there are no leaves.

        Raises
        ------
        InputError
            If there is no such season.
        """
        if season not in SEASONS:
            raise InputError(f"season must be one of {', '.join(SEASONS)}, got {season!r}")
        return getattr(self, season)
