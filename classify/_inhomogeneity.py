"""Features: how unevenly the crown is filled, and how many stems carry it.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", PhD thesis, University of
Konstanz, 2013, section 3.5.1 ("inhomogeneity of point set, number of main stems").
Departs from it in: it names them without a rule. Here: boxes and pairs counted at several sizes, pieces,
gaps, and the groups of cells and the branches of the skeleton that a horizontal plane cuts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from classify._feature import Feature, effective_boxes, family, mean_of, pairs_in, ratio_of
from classify._thinned import TreeView

if TYPE_CHECKING:
    from treegraph import TreeGraph

RATIOS = (2, 4, 8, 16)  # fine cells in the edges of boxes
STEPS = ("1_32", "1_16", "1_8")  # of the smaller box of each pair, over the tree's size
N_SECTORS = 12
N_LAYERS = 8
PARTS = ("low", "middle", "high")
PIECE = 0.02  # of all cells: what is smaller is no piece
CUTS = (5, 10, 15, 20, 30, 40, 50)  # % of the height
CUT_THICKNESS = 0.025  # of the height
STEM = 0.1  # of a cut's cells: what is smaller is no stem
LEADER = 0.5  # of the thickest branch that a plane cuts: what is thinner is no leader
INHOMOGENEITY, STEMS = "inhomogeneity", "stems"

_SIZES = [(step, f"{step.replace('_', '/')} of the size") for step in STEPS]
_THIRDS = [(part, f"{part} third of the crown") for part in PARTS]

FEATURES = (
    *family(
        INHOMOGENEITY,
        "pair_dimension_{}",
        "log2 of the pairs of cells in boxes of twice {} over those in boxes half as large",
        _SIZES,
    ),
    *family(INHOMOGENEITY, "point_dimension_{}", "the same of points in place of cells, {}", _SIZES),
    *family(
        INHOMOGENEITY, "core_share_{}", "share of boxes of {} whose six neighbours are filled", _SIZES[1:]
    ),
    *family(INHOMOGENEITY, "n_pieces_{}", "pieces of touching boxes of {} that hold 2% of all", _SIZES[1:]),
    *family(INHOMOGENEITY, "largest_piece_{}", "share of boxes of {} in the largest piece", _SIZES[1:]),
    *family(
        INHOMOGENEITY, "sector_unevenness_{}", "variation of 12 sectors without that of chance ({})", _THIRDS
    ),
    *family(
        INHOMOGENEITY,
        "empty_sectors_{}",
        "1 less the effective share of filled boxes, 12 sectors by 8 layers ({})",
        _THIRDS,
    ),
    Feature(
        "point_unevenness", "", INHOMOGENEITY, "variation of the points among boxes of 1/16 without chance's"
    ),
    Feature(
        "cell_unevenness", "", INHOMOGENEITY, "variation of the cells among boxes of 1/8 without chance's"
    ),
    *family(STEMS, "n_stems_{}", "groups with 10% of the cells at {}% of the height", CUTS),
    *family(STEMS, "cut_{}_share", "cells at {}% of the height over those of the fullest cut", CUTS),
    *family(STEMS, "n_leaders_{}", "branches with half of the largest radius at {}% of the height", CUTS),
    Feature("n_stems", "", STEMS, "median number of stems from 5 to 20% of the height"),
    Feature("n_leaders", "", STEMS, "mean number of leaders from 10 to 50% of the height"),
)


def describe_inhomogeneity(view: TreeView) -> dict[str, float]:
    """How the cells fill the crown, by name."""
    boxes = [np.unique(view.grid.coarse(ratio)[0], return_inverse=True) for ratio in RATIOS]
    out: dict[str, float] = {}
    pairs = [pairs_in(np.bincount(row)) for _, row in boxes]
    points = [pairs_in(np.bincount(row, view.grid.count)) for _, row in boxes]
    for k, step in enumerate(STEPS):
        out[f"pair_dimension_{step}"] = _log_ratio(pairs[k + 1], pairs[k])
        out[f"point_dimension_{step}"] = _log_ratio(points[k + 1], points[k])
    for ratio, step in zip(RATIOS[1:], STEPS[1:], strict=False):
        out |= _pieces(view, ratio, step)
    n_boxes = [codes.size for codes, _ in boxes]
    n_points, n_cells = float(view.grid.count.sum()), float(len(view.grid.count))
    out["point_unevenness"] = _excess(points[1], n_points, n_boxes[1])
    out["cell_unevenness"] = _excess(pairs[2], n_cells, n_boxes[2])
    return out | _sectors(view)


def _log_ratio(over: float, under: float) -> float:
    return float(np.log2(over / under)) if over > 0.0 and under > 0.0 else np.nan


def _excess(pairs: float, n: float, n_boxes: int) -> float:
    """Coefficient of variation of the counts of boxes less what chance would give."""
    return float(np.sqrt(max(n_boxes * pairs / n**2 - 1.0, 0.0))) if n > 0.0 else np.nan


def _pieces(view: TreeView, ratio: int, step: str) -> dict[str, float]:
    """Connected pieces and the core of the filled boxes."""
    from scipy import ndimage

    place = view.grid.cell // ratio
    place = place - place.min(axis=0) + 1
    filled = np.zeros(place.max(axis=0) + 2, bool)
    filled[tuple(place.T)] = True
    core = filled[1:-1, 1:-1, 1:-1].copy()
    for axis in range(3):
        for side in (slice(None, -2), slice(2, None)):
            at = [slice(1, -1)] * 3
            at[axis] = side
            core &= filled[tuple(at)]
    label, _ = ndimage.label(filled, np.ones((3, 3, 3)))
    size = np.bincount(label[filled])
    total = float(size.sum())
    return {
        f"core_share_{step}": float(core.sum()) / total,
        f"n_pieces_{step}": float((size >= PIECE * total).sum()),
        f"largest_piece_{step}": float(size.max()) / total,
    }


def _sectors(view: TreeView) -> dict[str, float]:
    """How evenly the crown is filled around its axis."""
    crown = view.in_crown
    off = view.xyz[crown, :2] - view.crown_middle
    # the first sector begins at the crown's own long side, so that its heading does not matter
    twice = np.arctan2((2.0 * off[:, 0] * off[:, 1]).sum(), (off[:, 0] ** 2 - off[:, 1] ** 2).sum())
    angle = np.arctan2(off[:, 1], off[:, 0]) - 0.5 * twice
    sector = (angle / (2.0 * np.pi) % 1.0 * N_SECTORS).astype(np.int64) % N_SECTORS
    inside = np.clip((view.share[crown] - view.crown_base) / (1.0 - view.crown_base), 0.0, 1.0)
    layer = np.minimum((inside * 3 * N_LAYERS).astype(np.int64), 3 * N_LAYERS - 1)
    table = np.bincount(layer * N_SECTORS + sector, minlength=3 * N_LAYERS * N_SECTORS)
    table = table.reshape(3, N_LAYERS, N_SECTORS)
    out = {}
    for k, part in enumerate(PARTS):
        around = table[k].sum(axis=0)
        out[f"sector_unevenness_{part}"] = _excess(pairs_in(around), float(around.sum()), N_SECTORS)
        out[f"empty_sectors_{part}"] = 1.0 - effective_boxes(table[k]) / table[k].size
    return out


def describe_stems(view: TreeView, graph: TreeGraph | None) -> dict[str, float]:
    """What horizontal planes cut, by name."""
    n_cells = {}
    out: dict[str, float] = {}
    for cut in CUTS:
        inside = np.abs(view.share - 0.01 * cut) <= 0.5 * CUT_THICKNESS
        n_cells[cut] = float(inside.sum())
        out[f"n_stems_{cut}"] = _groups(view.grid.cell[inside, :2])
        out[f"n_leaders_{cut}"] = _leaders(graph, 0.01 * cut * view.height)
    width = np.convolve(np.bincount((view.share * 200).astype(np.int64), minlength=201), np.ones(5), "valid")
    for cut in CUTS:
        out[f"cut_{cut}_share"] = ratio_of(n_cells[cut], float(width.max()))
    low = np.array([out[f"n_stems_{cut}"] for cut in CUTS if cut <= 20])
    out["n_stems"] = float(np.median(low[np.isfinite(low)])) if np.isfinite(low).any() else np.nan
    out["n_leaders"] = mean_of(np.array([out[f"n_leaders_{cut}"] for cut in CUTS if cut >= 10]))
    return out


def _groups(cell: NDArray[np.int64]) -> float:
    """Groups of touching columns that hold a share `STEM` of all; NaN without any."""
    from scipy import ndimage

    if not len(cell):
        return np.nan
    place = cell - cell.min(axis=0)
    filled = np.zeros(place.max(axis=0) + 1, np.int64)
    np.add.at(filled, tuple(place.T), 1)
    label, _ = ndimage.label(filled > 0, np.ones((3, 3)))
    size = np.bincount(label.ravel(), filled.ravel())[1:]
    return float((size >= STEM * size.sum()).sum())


def _leaders(graph: TreeGraph | None, z: float) -> float:
    """Branches of the skeleton through a height that have a share `LEADER` of the largest radius there."""
    if graph is None:
        return np.nan
    child = np.flatnonzero(graph.parent >= 0)
    low, high = graph.position[graph.parent[child], 2], graph.position[child, 2]
    cut = child[(np.minimum(low, high) <= z) & (np.maximum(low, high) > z)]
    radius = graph.radius[cut]
    radius = radius[np.isfinite(radius)]
    return float((radius >= LEADER * radius.max()).sum()) if radius.size else np.nan
