"""Features: shapes at the size of leaves and twigs.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 ("distribution of normal directions (computed in a neighborhood of each
point)").
Departs from it in: the thesis does not say how large a neighbourhood is; here it is a few centimetres, where
blades of leaves, leaflets and twigs differ. A scan without points so close together says nothing of it: NaN.
"""

from __future__ import annotations

import numpy as np

from classify._feature import Feature, Floats, mean_of, quantiles_of, spread_of
from classify._local import Scale, Shapes, find_shapes, thirds
from classify._thinned import TreeView

PLACES = 8000  # of a tree that are looked at, at most
LEAST_PLACES = 20  # with a known shape; fewer say nothing
SLOPES = (10, 25, 50, 75, 90)  # % of directions
GROUP = "leaves and twigs"


SCALES = (
    Scale("5cm", 2, True, "0.05 m around"),
    Scale("7cm", 3, True, "0.07 m around"),
    Scale("12cm", 5, True, "0.12 m around"),
    Scale("22cm", 9, True, "0.22 m around"),
)
"""Widths in leaf cells."""

_PARTS = {"crown": "crown", "low": "low third of the height", "high": "high third of the height"}
_MEANS = {
    "linearity": "mean linearity",
    "planarity": "mean planarity",
    "scattering": "mean scattering",
    "compactness": "mean extent over that of a filled neighbourhood",
}
_SPREADS = ("linearity", "planarity", "scattering")


def _features_of(scale: Scale) -> list[Feature]:
    """The features at one scale."""
    names = [
        (f"{kind}_{scale.name}_{part}", f"{text}, {scale.text} ({word})")
        for kind, text in _MEANS.items()
        for part, word in _PARTS.items()
    ]
    names += [
        (f"{kind}_{scale.name}_spread", f"standard deviation of the {kind} in the crown, {scale.text}")
        for kind in _SPREADS
    ]
    for kind, text in (("normal", "normals of flat places"), ("axis", "axes of long places")):
        names += [
            (f"{kind}_tilt_{scale.name}_{k}", f"|z| that {k}% of the {text} are below, {scale.text}")
            for k in SLOPES
        ]
    return [Feature(name, "", GROUP, text) for name, text in names]


FEATURES = tuple(feature for scale in SCALES for feature in _features_of(scale))


def describe_foliage(view: TreeView) -> dict[str, float]:
    """Shapes at the size of leaves and twigs, by name."""
    out: dict[str, float] = {}
    for scale in SCALES:
        out |= _statistics(find_shapes(view.leaf, scale.ratio, PLACES), view, scale.name)
    return out


def _statistics(shapes: Shapes, view: TreeView, scale: str) -> dict[str, float]:
    crown = shapes.place[:, 2] >= view.crown_base * view.height
    part = thirds(shapes, view.height)
    known = np.isfinite(shapes.linearity)
    out = {}
    for name, where in {"crown": crown, "low": part == 0, "high": part == 2}.items():
        mine = where & known
        enough = int(mine.sum()) >= LEAST_PLACES
        for kind in _MEANS:
            mean = mean_of(getattr(shapes, kind)[mine], shapes.weight[mine]) if enough else np.nan
            out[f"{kind}_{scale}_{name}"] = mean
    mine = crown & known
    enough = int(mine.sum()) >= LEAST_PLACES
    weight = shapes.weight[mine]
    for kind in _SPREADS:
        value = getattr(shapes, kind)[mine]
        out[f"{kind}_{scale}_spread"] = spread_of(value, weight) if enough else np.nan
    for name, direction, how in (("normal", shapes.normal, "planarity"), ("axis", shapes.axis, "linearity")):
        z, sure = np.abs(direction[mine, 2]), weight * getattr(shapes, how)[mine] ** 2
        found = _slopes(z, sure) if enough else np.full(len(SLOPES), np.nan)
        out |= {f"{name}_tilt_{scale}_{k}": float(v) for k, v in zip(SLOPES, found, strict=True)}
    return out


def _slopes(z: Floats, weight: Floats) -> Floats:
    """Quantiles of |z|, the more weight the flatter, or longer, a place is."""
    return quantiles_of(z, tuple(0.01 * k for k in SLOPES), weight)
