"""More than 200 numbers that describe the shape of a tree in a scan.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1: "For each tree over 200 features are computed", of which it names the most
effective ones.
Departs from it in: the list is our own, in the groups that the thesis names, as theirs is not published.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classify import _dimensions, _foliage, _inhomogeneity, _local, _profiles, _skeleton
from classify._feature import Feature
from treegraph.errors import InputError

if TYPE_CHECKING:
    from treegraph import ClusterTree, TreeGraph

__all__ = ["FEATURES", "Feature", "FeatureVector", "describe_scan", "feature_table"]

MIN_POINTS = 10
FARTHEST = 1e9  # metres; squares and cubes of more are no numbers

FEATURES: tuple[Feature, ...] = (
    *_dimensions.FEATURES,
    *_profiles.FEATURES,
    *_local.FEATURES,
    *_foliage.FEATURES,
    *_inhomogeneity.FEATURES,
    *_skeleton.FEATURES,
)
"""All features, in the order of a vector's values."""

_PLACE = {feature.name: k for k, feature in enumerate(FEATURES)}


@dataclass(frozen=True, eq=False)
class FeatureVector(Mapping[str, float]):
    """The features of one tree: a mapping of names to numbers, and the array of these.

    Attributes
    ----------
    array : (f,) float64
        In the order of :data:`FEATURES`; NaN is unknown.
    """

    array: NDArray[np.float64]

    def __post_init__(self) -> None:
        array = np.array(self.array, np.float64)
        if array.shape != (len(FEATURES),):
            raise InputError(f"array must have shape ({len(FEATURES)},), got {array.shape}")
        array.flags.writeable = False
        object.__setattr__(self, "array", array)

    def __getitem__(self, name: str) -> float:
        return float(self.array[_PLACE[name]])

    def __iter__(self) -> Iterator[str]:
        return iter(_PLACE)

    def __len__(self) -> int:
        return len(_PLACE)

    def __repr__(self) -> str:
        return f"<FeatureVector {len(self)} features, {int(np.isnan(self.array).sum())} unknown>"


def feature_table() -> list[dict[str, str]]:
    """Name, unit, group and meaning of every feature, in the order of a vector's values."""
    return [{"name": f.name, "unit": f.unit, "group": f.group, "text": f.text} for f in FEATURES]


def describe_scan(xyz: ArrayLike, tree: ClusterTree | TreeGraph | None = None) -> FeatureVector:
    """Describe the shape of a tree by numbers that depend little on how, and how densely, it was scanned.

    Parameters
    ----------
    xyz : (n, 3) array_like of float
        The tree's points, at least 10: metres, foot of the trunk at the origin, z up, in any order.
    tree : ClusterTree or TreeGraph, optional
        A first reconstruction in the same frame. Without one, what is taken from the skeleton and the
        clusters is unknown; from a TreeGraph, what is taken from the clusters.

    Returns
    -------
    FeatureVector

    Raises
    ------
    InputError
        If `xyz` has another shape, holds less than 10 points, or one that is not finite or farther away
        than 10^9 m.

    Notes
    -----
    O(n) time for the cells, O(m log m) for the m filled ones of 16 mm, of which 500 000 are kept. The order
    of the points means nothing, to the last bit; turning the tree around the vertical changes the last
    digits, but for cells whose points rounding moves across an edge.
    """
    from classify._thinned import view_cloud

    view = view_cloud(_checked(xyz))
    graph: Any = getattr(tree, "graph", tree)
    clusters = getattr(tree, "clusters", None)
    found = _dimensions.describe_dimensions(view, graph)
    found |= _dimensions.describe_slabs(view, graph)
    found |= _profiles.describe_profiles(view)
    found |= _local.describe_local(view)
    found |= _foliage.describe_foliage(view)
    found |= _inhomogeneity.describe_inhomogeneity(view)
    found |= _inhomogeneity.describe_stems(view, graph)
    found |= _skeleton.describe_skeleton(graph, view.height)
    found |= _skeleton.describe_clusters(clusters, view.height)
    array = np.full(len(FEATURES), np.nan)
    for name, value in found.items():
        array[_PLACE[name]] = value
    return FeatureVector(array)


def _checked(xyz: ArrayLike) -> NDArray[np.float64]:
    points = np.ascontiguousarray(xyz, np.float64).view()
    points.flags.writeable = False  # one kind of array to the compiled loops
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"xyz must have shape (n, 3), got {points.shape}")
    if len(points) < MIN_POINTS:
        raise InputError(f"xyz must hold at least {MIN_POINTS} points to be described, got {len(points)}")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(
            f"xyz must be finite, got {points[bad[0]]} in row {bad[0]} ({bad.size} such rows); "
            "recon.prepare drops such points"
        )
    far = float(np.abs(points).max())
    if far > FARTHEST:
        raise InputError(
            f"xyz must be within {FARTHEST:g} m of the foot of the trunk, got {far:g}; are the units metres?"
        )
    return points
