"""Features: how large the tree, its trunk and its crown are, and the crown in slabs.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 ("trunk width, trunk height, crown width, height, ratio of tree width and
height"); O. Stava et al., "Inverse Procedural Modelling of Trees", Computer Graphics Forum, 2014,
section 5.1 (slabs).
Departs from it in: both say what is measured but not how. The radius of a slab along a principal direction is
twice the standard deviation there, which is the radius of an evenly filled ellipse. The slabs are those of
the crown's cells, as a scan shows no leaf branches; tips of the skeleton are counted beside them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classify._feature import Feature, Floats, effective_boxes, mean_of, ratio_of
from classify._thinned import TreeView

if TYPE_CHECKING:
    from treegraph import TreeGraph

DIRECTIONS = 18  # over half a turn in which the crown's width is taken
EDGES = (0.01, 0.99)  # quantiles between which it is taken: single twigs and strays do not count
COARSE = 4  # fine cells in the edge of the boxes that area and volume are counted in
BREAST_HEIGHT = 1.3  # metres
SLABS = ("lower", "middle", "upper")
DIMENSIONS, SLAB = "dimensions", "slabs"

_D = [
    ("height", "m", "height of the tree: quantile 0.998 of the points' heights"),
    ("crown_width", "m", "mean extent of the crown, seen from above, over all directions"),
    ("crown_width_long", "m", "largest extent of the crown in any direction"),
    ("crown_width_short", "m", "smallest extent of the crown in any direction"),
    ("crown_roundness", "", "smallest over largest extent of the crown"),
    ("crown_base", "m", "height at which the crown begins: its spread falls below 0.35 of the largest"),
    ("crown_height", "m", "height of the tree less that of the crown's base"),
    ("trunk_spread", "m", "width of the lower trunk by its points: 2 x root mean square distance"),
    ("trunk_width", "m", "diameter of the skeleton's trunk, median over 0.05 to 0.15 of the height"),
    ("breast_width", "m", "diameter of the skeleton's trunk 1.3 m above the foot"),
    ("width_to_height", "", "crown width over height"),
    ("crown_height_share", "", "crown height over height"),
    ("crown_width_to_crown_height", "", "crown width over crown height"),
    ("trunk_spread_to_height", "", "trunk spread over height"),
    ("trunk_width_to_height", "", "trunk width over height"),
    ("trunk_width_to_crown_width", "", "trunk width over crown width"),
    ("crown_offset", "m", "horizontal distance of the crown's middle from the foot"),
    ("crown_offset_to_height", "", "the same over height"),
    ("crown_area", "m2", "area of the crown from above: effective number of columns of 1/16 of the size"),
    ("crown_area_fill", "", "the same over the area of an ellipse of the crown's widths"),
    ("filled_volume", "m3", "volume of the tree: effective number of boxes of 1/16 of the size"),
    ("filled_volume_to_cube", "", "the same over the cube of the tree's size"),
    ("crown_fill", "", "the same for the crown alone over its volume as a stack of ellipses"),
    ("crown_profile_volume", "m3", "volume of the crown as a stack of ellipses"),
    ("crown_profile_volume_to_cube", "", "the same over the cube of the height"),
    ("widest_share", "", "height at which the crown is widest, over the tree's (soft maximum)"),
]  # fmt: skip
_S = [
    ("height", "m", "height of the slab"),
    ("height_share", "", "height of the slab over that of the crown"),
    ("radius_long", "m", "radius of the slab along its longer principal direction, seen from above"),
    ("radius_short", "m", "radius of the slab along its shorter principal direction"),
    ("radius_long_to_height", "", "longer radius over the tree's height"),
    ("radius_short_to_height", "", "shorter radius over the tree's height"),
    ("roundness", "", "shorter over longer radius"),
    ("fill", "", "effective number of boxes of 1/16 of the size over those of its ellipse"),
    ("tips", "1/m3", "tips of the skeleton per volume of the slab's elliptic cylinder"),
    ("tip_share", "", "share of the crown's tips of the skeleton in the slab"),
    ("offset_to_height", "", "distance of the slab's middle from the crown's middle over the height"),
]  # fmt: skip
FEATURES = tuple(
    [Feature(name, unit, DIMENSIONS, text) for name, unit, text in _D]
    + [
        Feature(f"slab_{slab}_{name}", unit, SLAB, f"{text} ({slab} slab of the crown)")
        for slab in SLABS
        for name, unit, text in _S
    ]
)


def describe_dimensions(view: TreeView, graph: TreeGraph | None) -> dict[str, float]:
    """Sizes of the tree and of its parts, by name."""
    crown = view.xyz[view.in_crown]
    widths = _widths(crown)
    width, long, short = float(widths.mean()), float(widths.max()), float(widths.min())
    height, base = view.height, view.crown_base * view.height
    offset = float(np.hypot(*view.crown_middle))
    trunk, breast = _trunk_widths(graph, height)
    edge = COARSE * view.grid.edge
    code, _, stride = view.grid.coarse(COARSE)
    filled = effective_boxes(_counts(code)) * edge**3
    crown_code = code[view.in_crown]
    crown_filled = effective_boxes(_counts(crown_code)) * edge**3
    area = effective_boxes(_counts(crown_code // stride)) * edge**2
    stack, widest = _stack(view)
    return {
        "height": height,
        "crown_width": width,
        "crown_width_long": long,
        "crown_width_short": short,
        "crown_roundness": ratio_of(short, long),
        "crown_base": base,
        "crown_height": height - base,
        "trunk_spread": view.trunk_spread,
        "trunk_width": trunk,
        "breast_width": breast,
        "width_to_height": ratio_of(width, height),
        "crown_height_share": 1.0 - view.crown_base,
        "crown_width_to_crown_height": ratio_of(width, height - base),
        "trunk_spread_to_height": ratio_of(view.trunk_spread, height),
        "trunk_width_to_height": ratio_of(trunk, height),
        "trunk_width_to_crown_width": ratio_of(trunk, width),
        "crown_offset": offset,
        "crown_offset_to_height": ratio_of(offset, height),
        "crown_area": area,
        "crown_area_fill": ratio_of(area, 0.25 * np.pi * long * short),
        "filled_volume": filled,
        "filled_volume_to_cube": filled / view.size**3,
        "crown_fill": ratio_of(crown_filled, stack),
        "crown_profile_volume": stack,
        "crown_profile_volume_to_cube": ratio_of(stack, height**3),
        "widest_share": widest,
    }


def _counts(code: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(code, return_counts=True)[1]


def _widths(xyz: Floats) -> Floats:
    """Extent of points in `DIRECTIONS`, seen from above, metres."""
    angle = np.arange(DIRECTIONS) * (np.pi / DIRECTIONS)
    along = xyz[:, :2] @ np.stack([np.cos(angle), np.sin(angle)])
    low, high = np.quantile(along, EDGES, axis=0)
    return high - low


def _trunk_widths(graph: TreeGraph | None, height: float) -> tuple[float, float]:
    """Diameter of the trunk's lower part and at breast height, metres; NaN where it is not known."""
    from treegraph import chains

    if graph is None or graph.n_nodes < 2:
        return np.nan, np.nan
    start, node = chains(graph)
    trunk = node[start[0] : start[1]]
    z, radius = graph.position[trunk, 2], graph.radius[trunk]
    lower = (z >= 0.05 * height) & (z <= 0.15 * height) & np.isfinite(radius)
    width = 2.0 * float(np.median(radius[lower])) if lower.any() else np.nan
    above = np.flatnonzero(z >= BREAST_HEIGHT)
    if not above.size or above[0] == 0:
        return width, np.nan
    k = int(above[0])
    return width, 2.0 * float(np.interp(BREAST_HEIGHT, z[k - 1 : k + 1], radius[k - 1 : k + 1]))


def _ellipse(xy: Floats) -> tuple[float, float, Floats]:
    """Longer and shorter radius of points (n, 2) as an even ellipse, and its middle; NaN for too few."""
    if len(xy) < 3:
        return np.nan, np.nan, np.full(2, np.nan)
    middle = xy.mean(axis=0)
    off = xy - middle
    a, b, c = (off[:, 0] ** 2).mean(), (off[:, 0] * off[:, 1]).mean(), (off[:, 1] ** 2).mean()
    half, swing = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    return 2.0 * np.sqrt(half + swing), 2.0 * np.sqrt(max(half - swing, 0.0)), middle


def _stack(view: TreeView) -> tuple[float, float]:
    """Volume of the crown as a stack of ellipses, m3, and the height at which it is widest, 0 to 1."""
    row, _, spread = view.profile
    n = len(spread)
    share = (np.arange(n) + 0.5) / n
    in_crown = np.isfinite(spread) & (share >= view.crown_base)
    if not in_crown.any():
        return np.nan, np.nan
    area = np.zeros(n)
    for k in np.flatnonzero(in_crown):
        long, short, _ = _ellipse(view.xyz[row == k, :2])
        area[k] = np.pi * long * short
    weight = np.where(in_crown, np.nan_to_num(spread), 0.0) ** 8
    return float(area.sum() * view.height / n), ratio_of(float((weight * share).sum()), float(weight.sum()))


def describe_slabs(view: TreeView, graph: TreeGraph | None) -> dict[str, float]:
    """The crown in three slabs (section 5.1 of Stava et al.), by name.

    The mean height of the crown's cells halves it; the mean heights of both halves are the planes between the
    slabs.
    """
    z = view.xyz[:, 2]
    crown = view.in_crown
    base = view.crown_base * view.height
    middle = mean_of(z[crown])
    lower, upper = mean_of(z[crown & (z < middle)]), mean_of(z[crown & (z >= middle)])
    planes = np.array([base, lower, upper, view.height])
    slab = np.searchsorted(planes[1:3], z, side="right")
    tips = _tip_heights(graph)
    tips = tips[(tips >= base) & (tips <= view.height)]
    tip_slab = np.searchsorted(planes[1:3], tips, side="right")
    code, _, _ = view.grid.coarse(COARSE)
    box = (COARSE * view.grid.edge) ** 3
    out = {}
    for k, name in enumerate(SLABS):
        mine = crown & (slab == k)
        high = float(planes[k + 1] - planes[k])
        long, short, at = _ellipse(view.xyz[mine, :2])
        volume = np.pi * long * short * high
        n_tips = float((tip_slab == k).sum()) if graph is not None else np.nan
        values = {
            "height": high,
            "height_share": ratio_of(high, view.height - base),
            "radius_long": long,
            "radius_short": short,
            "radius_long_to_height": ratio_of(long, view.height),
            "radius_short_to_height": ratio_of(short, view.height),
            "roundness": ratio_of(short, long),
            "fill": ratio_of(effective_boxes(_counts(code[mine])) * box, volume),
            "tips": ratio_of(n_tips, volume),
            "tip_share": ratio_of(n_tips, float(tips.size)),
            "offset_to_height": ratio_of(float(np.hypot(*(at - view.crown_middle))), view.height),
        }
        out.update({f"slab_{name}_{key}": value for key, value in values.items()})
    return out


def _tip_heights(graph: TreeGraph | None) -> Floats:
    if graph is None:
        return np.zeros(0)
    is_tip = np.ones(graph.n_nodes, bool)
    is_tip[graph.parent[graph.parent >= 0]] = False
    return graph.position[is_tip, 2]
