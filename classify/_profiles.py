"""Features: how what is seen of the tree is spread over its height, and from the middle outwards.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 ("density distribution of the point set in vertical direction").
Departs from it in: the cells of a grid are counted, not the points, of which there are more near the scanner.
"""

from __future__ import annotations

import numpy as np

from classify._feature import Feature, Floats, family, mean_of, quantiles_of, ratio_of, shares_of, spread_of
from classify._thinned import N_PROFILE, TreeView

N_LAYERS = 10
LEVELS = (0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.95)
N_RINGS = 4
PARTS = ("low", "middle", "high")
RIM = 0.9  # quantile of the distances in a layer that counts as the crown's rim
VERTICAL, RADIAL = "vertical profile", "radial profile"

_OUTLINE = [
    ("height_mean", "mean height of the cells over the tree's"),
    ("height_spread", "standard deviation of the heights over the tree's height"),
    ("height_skewness", "skewness of the heights of the cells"),
    ("height_kurtosis", "kurtosis of the heights of the cells (3 for a normal distribution)"),
    ("height_entropy", "entropy of the shares of the 10 layers, 1 if all are equal"),
    ("crown_height_mean", "mean height of the crown's cells in the crown, 0 to 1"),
    ("crown_height_spread", "standard deviation of the same"),
    ("width_roughness", "bends of the outline: mean second difference of the widths"),
    ("width_slope_lower", "growth of the spread over the lower half of the crown"),
    ("width_slope_upper", "growth of the spread over the upper half of the crown"),
    ("layering", "unevenness of layers of 1/32 of the height against their neighbours, without chance's"),
]
_RADIAL = [
    ("axis_distance_mean", "mean distance of the crown's cells from its axis over the tree's height"),
    ("axis_distance_spread", "standard deviation of the same"),
    ("azimuth_lean", "median of the crown's cells off their mean, seen from above, over their mean distance"),
    ("azimuth_flatness", "how far the crown is to two opposite sides: length of the mean doubled direction"),
]
_LAYERS = range(1, N_LAYERS + 1)
_PERCENT = [(f"{round(100 * level):02d}", str(round(100 * level))) for level in LEVELS]

FEATURES = (
    *family(VERTICAL, "layer_{}_share", "share of the cells in layer {} of 10, from below", _LAYERS),
    *family(VERTICAL, "layer_{}_width", "spread of layer {} of 10 over that of the widest", _LAYERS),
    *family(
        VERTICAL, "height_quantile_{}", "height under which {}% of the cells lie over the tree's", _PERCENT
    ),
    *(Feature(name, "", VERTICAL, text) for name, text in _OUTLINE),
    *family(
        RADIAL, "ring_{}_share", "share of the crown's cells in ring {} of 4, from the axis", range(1, 5)
    ),
    *family(
        RADIAL, "outwardness_{}", "mean distance from the axis over the rim's ({} third of the crown)", PARTS
    ),
    *(Feature(name, "", RADIAL, text) for name, text in _RADIAL),
)


def describe_profiles(view: TreeView) -> dict[str, float]:
    """Vertical and radial distribution of the cells, by name."""
    share = view.share
    layer = np.minimum((share * N_LAYERS).astype(np.int64), N_LAYERS - 1)
    out = {f"layer_{k + 1}_share": float(s) for k, s in enumerate(shares_of(layer, N_LAYERS))}
    out |= _layer_widths(view, layer)
    heights = quantiles_of(share, LEVELS)
    out |= {f"height_quantile_{round(100 * q):02d}": float(h) for q, h in zip(LEVELS, heights, strict=True)}
    out |= _moments(view)
    out |= _outline(view)
    return out | _radial(view)


def _layer_widths(view: TreeView, layer: np.ndarray) -> dict[str, float]:
    """Spread of each layer around its own middle, over the largest."""
    n = np.bincount(layer, minlength=N_LAYERS).astype(float)
    n[n < 3] = np.nan
    x, y = view.xyz[:, 0], view.xyz[:, 1]
    spread2 = np.zeros(N_LAYERS)
    for value in (x, y):
        mean = np.bincount(layer, value, N_LAYERS) / n
        spread2 += np.bincount(layer, (value - mean[layer]) ** 2, N_LAYERS) / n
    known = np.isfinite(spread2)
    widest = np.sqrt(spread2[known].max()) if known.any() else np.nan
    return {f"layer_{k + 1}_width": ratio_of(float(np.sqrt(s)), widest) for k, s in enumerate(spread2)}


def _moments(view: TreeView) -> dict[str, float]:
    share = view.share
    mean, spread = mean_of(share), spread_of(share)
    layers = shares_of(np.minimum((share * N_LAYERS).astype(np.int64), N_LAYERS - 1), N_LAYERS)
    filled = layers[layers > 0.0]
    in_crown = (share[view.in_crown] - view.crown_base) / (1.0 - view.crown_base)
    return {
        "height_mean": mean,
        "height_spread": spread,
        "height_skewness": ratio_of(mean_of((share - mean) ** 3), spread**3),
        "height_kurtosis": ratio_of(mean_of((share - mean) ** 4), spread**4),
        "height_entropy": float(-(filled * np.log(filled)).sum() / np.log(N_LAYERS)),
        "crown_height_mean": mean_of(in_crown),
        "crown_height_spread": spread_of(in_crown),
    }


def _outline(view: TreeView) -> dict[str, float]:
    """How the spread changes with height, in units of the largest spread and of the crown's height."""
    row, _, spread = view.profile
    share = (np.arange(N_PROFILE) + 0.5) / N_PROFILE
    good = np.isfinite(spread) & (share >= view.crown_base)
    names = ("width_roughness", "width_slope_lower", "width_slope_upper", "layering")
    if good.sum() < 6:
        return dict.fromkeys(names, np.nan)
    width = spread[good] / spread[good].max()
    place = (share[good] - view.crown_base) / (1.0 - view.crown_base)
    slopes = []
    for half in (place < 0.5, place >= 0.5):
        enough = half.sum() >= 3
        slopes.append(float(np.polyfit(place[half], width[half], 1)[0]) if enough else np.nan)
    count = np.bincount(row, minlength=N_PROFILE)[good].astype(float)
    around = 0.5 * (count[:-2] + count[2:])
    chance = count[1:-1] + 0.25 * (count[:-2] + count[2:])
    excess = ((count[1:-1] - around) ** 2 - chance).sum() / (count[1:-1] ** 2).sum()
    layering = float(np.sqrt(max(excess, 0.0)))
    return dict(zip(names, (float(np.abs(np.diff(width, 2)).mean()), *slopes, layering), strict=True))


def _radial(view: TreeView) -> dict[str, float]:
    distance, away = view.outwards
    crown = view.in_crown
    rim = _rim(view, distance)
    relative = distance / rim
    ring = np.minimum(relative * N_RINGS, N_RINGS - 0.5)
    known = crown & np.isfinite(ring)
    rings = shares_of(ring[known].astype(np.int64), N_RINGS)
    out = {f"ring_{k + 1}_share": float(s) for k, s in enumerate(rings)}
    inside = np.clip((view.share - view.crown_base) / (1.0 - view.crown_base), 0.0, 1.0)
    part = np.minimum((inside * 3).astype(np.int64), 2)
    for k, name in enumerate(PARTS):
        out[f"outwardness_{name}"] = mean_of(relative[crown & (part == k)])
    far = distance[crown]
    x, y = away[crown].T
    twice = np.array([mean_of(x * x - y * y, far), mean_of(2.0 * x * y, far)])
    return out | {
        "axis_distance_mean": ratio_of(mean_of(far), view.height),
        "axis_distance_spread": ratio_of(spread_of(far), view.height),
        "azimuth_lean": ratio_of(
            float(np.hypot(*np.median(view.xyz[crown, :2], axis=0) - view.crown_middle)), mean_of(far)
        ),
        "azimuth_flatness": float(np.hypot(*twice)),
    }


def _rim(view: TreeView, distance: Floats) -> Floats:
    """Distance of the crown's rim from its axis at the height of each cell, metres; NaN if not known."""
    row = view.profile[0] // 2
    n = N_PROFILE // 2
    order = np.lexsort((distance, row))
    begin = np.searchsorted(row[order], np.arange(n + 1))
    size = np.diff(begin)
    rim = np.full(n, np.nan)
    some = size >= 3
    rim[some] = distance[order][begin[:-1][some] + np.rint(RIM * (size[some] - 1)).astype(np.int64)]
    rim[rim <= 0.0] = np.nan
    return rim[row]
