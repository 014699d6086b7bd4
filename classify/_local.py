"""Features: the shape of the surroundings of each place at several distances, and where normals point.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 and figure 3.8 ("distribution of normal directions (computed in a neighborhood
of each point)"); linearity, planarity and scattering are the usual ones of the eigenvalues of a covariance.
Departs from it in: the neighbourhood of a place is its cell with the 26 around it, in which finer cells count
once each, however many points they hold; shapes are those of samples of equal size; figure 3.8 shows
histograms without numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from classify._feature import Feature, Floats, divided, family, mean_of, quantiles_of, spread_of
from classify._thinned import Grid, TreeView

SAMPLE = 8  # finer cells that a shape is found from: always as many, as few points look flatter than many
SAMPLES = 2  # shapes of a neighbourhood, at most, of which the mean is taken
LEAST = 5.0  # finer cells in a neighbourhood whose axes mean something
PARTS = ("low", "middle", "high")  # thirds of the tree's height
TILTS = (10, 25, 50, 75, 90)  # % of directions
PART_TILTS = (25, 50, 75)
LOCAL, NORMALS = "local geometry", "normals"


@dataclass(frozen=True)
class Scale:
    """A distance at which shapes are looked at: cells `ratio` fine cells wide, with those around them."""

    name: str
    ratio: int
    is_metric: bool
    text: str


SCALES = (
    Scale("fine", 3, False, "9/128 of the tree's size around"),
    Scale("medium", 4, False, "3/32 of the tree's size around"),
    Scale("coarse", 8, False, "3/16 of the tree's size around"),
    Scale("45cm", 3, True, "0.45 m around"),
    Scale("90cm", 6, True, "0.9 m around"),
)
NORMAL_SCALE = "medium"

_KINDS = [
    ("linearity", "mean linearity (l1 - l2) / l1"),
    ("linearity_spread", "standard deviation of the linearity"),
    ("planarity", "mean planarity (l2 - l3) / l1"),
    ("planarity_spread", "standard deviation of the planarity"),
    ("scattering", "mean scattering l3 / l1"),
    ("compactness", "mean extent sqrt(l1 + l2 + l3) over that of a filled neighbourhood"),
    ("uprightness", "mean |z| of the longest axis"),
]
_PART_KINDS = [
    ("linearity", "mean linearity"),
    ("planarity", "mean planarity"),
    ("scattering", "mean scattering"),
]

_WORDS = [(part, f"{part} third of the height") for part in PARTS]

FEATURES = (
    *(
        Feature(f"{name}_{scale.name}", "", LOCAL, f"{text}, {scale.text}")
        for scale in SCALES
        for name, text in _KINDS
    ),
    *(
        Feature(f"{name}_{scale.name}_{part}", "", LOCAL, f"{text}, {scale.text} ({word})")
        for scale in SCALES
        for name, text in _PART_KINDS
        for part, word in _WORDS
    ),
    *family(NORMALS, "normal_tilt_{}", "|z| that {}% of the normals are below, 0 level, 1 upright", TILTS),
    *(
        Feature(f"normal_tilt_{k}_{part}", "", NORMALS, f"|z| that {k}% of the normals are below ({word})")
        for part, word in _WORDS
        for k in PART_TILTS
    ),
    *family(NORMALS, "normal_z_{}", "mean |z| of the normals ({})", _WORDS),
    *family(NORMALS, "normal_outwards_{}", "mean |part outwards| of the normals ({})", _WORDS),
    *family(NORMALS, "axis_tilt_{}", "|z| that {}% of the longest axes are below", TILTS),
    *family(NORMALS, "axis_outwards_{}", "mean |part outwards| of the longest axes ({})", _WORDS),
    *family(NORMALS, "axis_rise_fine_{}", "mean rise of the longest axes outwards, fine scale ({})", _WORDS),
    *family(
        NORMALS, "axis_rise_medium_{}", "mean rise of the longest axes outwards, medium scale ({})", _WORDS
    ),
)


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of the surroundings of k places; NaN where too little is around.

    The three kinds and the extent are means over samples of :data:`SAMPLE` finer cells; the directions are
    those of all of them.

    Attributes
    ----------
    weight : (k,) float64
        Finer cells in the place itself: how much it counts.
    linearity, planarity, scattering : (k,) float64
    extent : (k,) float64
        Metres.
    axis, normal : (k, 3) float64
        Unit vectors of the largest and the smallest extent, of either sign.
    place : (k, 3) float64
        Mean of the points in the place, metres.
    edge : float
        Of its cell, metres.
    """

    weight: Floats
    linearity: Floats
    planarity: Floats
    scattering: Floats
    extent: Floats
    axis: Floats
    normal: Floats
    place: Floats
    edge: float

    @property
    def compactness(self) -> Floats:
        """Extent over that of an evenly filled cube of three cells (k,)."""
        return self.extent / (3.0 * self.edge * np.sqrt(3.0 / 12.0))


def find_shapes(grid: Grid, ratio: int, most: int | None = None) -> Shapes:
    """Shapes around cells `ratio` times as wide as those of the grid: all, or `most` of lowest rank."""
    from classify import _feature_kernels as kernels

    code, stride_x, stride_y = grid.coarse(ratio)
    order = grid.by_rank[np.argsort(code[grid.by_rank], kind="stable")]
    cell, own, cell_of = kernels.cell_moments(grid.xyz, order, code)
    first = np.concatenate([[0], np.cumsum(np.bincount(cell_of))])
    pick = np.arange(len(cell))
    if most is not None and len(cell) > most:
        rank = kernels.ranks_of(grid.cell[order[first[:-1]]] // ratio)
        pick = np.sort(np.argsort(rank, kind="stable")[:most])
    around = kernels.neighbour_sums(cell, own, stride_x, stride_y, pick)
    directions = kernels.shapes(around, LEAST)[:, 5:]
    sample = kernels.sample_moments(
        grid.xyz, grid.rank, order, cell, first, stride_x, stride_y, SAMPLE, SAMPLES, pick
    )
    own = own[pick]
    each = kernels.shapes(sample.reshape(-1, sample.shape[2]), SAMPLE)[:, 1:5].reshape(-1, SAMPLES, 4)
    n_known = np.isfinite(each[:, :, 0]).sum(axis=1)
    kinds = divided(np.nansum(each, axis=1), n_known[:, None])
    place = own[:, 1:4] / own[:, :1]
    axis, normal = directions[:, :3], directions[:, 3:]
    linearity, planarity, scattering, extent = kinds.T.copy()
    return Shapes(
        own[:, 0].copy(), linearity, planarity, scattering, extent, axis, normal, place, ratio * grid.edge
    )


def describe_local(view: TreeView) -> dict[str, float]:
    """Local geometry and the directions of normals, by name."""
    out: dict[str, float] = {}
    for scale in SCALES:
        grid = view.metric if scale.is_metric else view.grid
        shapes = find_shapes(grid, scale.ratio)
        part = thirds(shapes, view.height)
        out |= _statistics(shapes, part, scale)
        if scale.name in ("fine", "medium"):
            out |= _rises(shapes, part, view, scale.name)
        if scale.name == NORMAL_SCALE:
            out |= _directions(shapes, part, view)
    return out


def thirds(shapes: Shapes, height: float) -> NDArray[np.int64]:
    """Third of the height in which each place is."""
    if not height > 0.0:
        return np.zeros(len(shapes.place), np.int64)
    return np.clip(shapes.place[:, 2] / height * 3.0, 0.0, 2.0).astype(np.int64)


def _statistics(shapes: Shapes, part: NDArray[np.int64], scale: Scale) -> dict[str, float]:
    w = shapes.weight
    kinds = {
        "linearity": mean_of(shapes.linearity, w),
        "linearity_spread": spread_of(shapes.linearity, w),
        "planarity": mean_of(shapes.planarity, w),
        "planarity_spread": spread_of(shapes.planarity, w),
        "scattering": mean_of(shapes.scattering, w),
        "compactness": mean_of(shapes.compactness, w),
        "uprightness": mean_of(np.abs(shapes.axis[:, 2]), w),
    }
    out = {f"{name}_{scale.name}": value for name, value in kinds.items()}
    for name, _ in _PART_KINDS:
        value = getattr(shapes, name)
        for k, third in enumerate(PARTS):
            mine = part == k
            out[f"{name}_{scale.name}_{third}"] = mean_of(value[mine], w[mine])
    return out


def _outwards(shapes: Shapes, view: TreeView) -> Floats:
    """Unit vector (k, 2) from the crown's axis to each place; NaN on the axis."""
    off = shapes.place[:, :2] - view.crown_middle
    return divided(off, np.hypot(off[:, 0], off[:, 1])[:, None])


def _rises(shapes: Shapes, part: NDArray[np.int64], view: TreeView, scale: str) -> dict[str, float]:
    """Whether branches go up or down outwards: z of the longest axis, turned so that it leads outwards."""
    away = _outwards(shapes, view)
    along = (shapes.axis[:, :2] * away).sum(axis=1)
    rise = shapes.axis[:, 2] * np.sign(along)
    weight = shapes.weight * np.nan_to_num(shapes.linearity) * np.nan_to_num(np.abs(along))
    return {
        f"axis_rise_{scale}_{third}": mean_of(rise[part == k], weight[part == k])
        for k, third in enumerate(PARTS)
    }


def _directions(shapes: Shapes, part: NDArray[np.int64], view: TreeView) -> dict[str, float]:
    away = _outwards(shapes, view)
    normal, axis = np.abs(shapes.normal[:, 2]), np.abs(shapes.axis[:, 2])
    flat = shapes.weight * (1.0 - np.nan_to_num(shapes.scattering))  # how far there is a normal at all
    out = _tilts("normal_tilt", normal, flat, TILTS) | _tilts("axis_tilt", axis, shapes.weight, TILTS)
    for k, third in enumerate(PARTS):
        mine = part == k
        out |= _tilts("normal_tilt", normal[mine], flat[mine], PART_TILTS, f"_{third}")
        out[f"normal_z_{third}"] = mean_of(normal[mine], flat[mine])
        for name, vector, w in (("normal", shapes.normal, flat), ("axis", shapes.axis, shapes.weight)):
            across = np.abs((vector[:, :2] * away).sum(axis=1))
            out[f"{name}_outwards_{third}"] = mean_of(across[mine], w[mine])
    return out


def _tilts(
    name: str, z: Floats, weight: Floats, percent: tuple[int, ...], ending: str = ""
) -> dict[str, float]:
    """Quantiles of |z| of directions: its own percentage for each, where directions are random."""
    found = quantiles_of(z, tuple(0.01 * p for p in percent), weight)
    return {f"{name}_{p}{ending}": float(value) for p, value in zip(percent, found, strict=True)}
