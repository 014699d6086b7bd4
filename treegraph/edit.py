"""New tree graphs out of old ones: resampled, simplified, moved, pruned."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph import _kernels
from treegraph.errors import InputError, TreeError
from treegraph.graph import NO_PARENT, TreeGraph

__all__ = ["prune", "resample", "simplify", "simplify_nodes", "take_nodes", "transform"]

MAX_RESAMPLED = 50_000_000
"""More nodes than this are taken for a mistyped spacing."""

MAX_SPAN = 1000
"""Longest piece, in nodes, that one segment of a simplified run takes the place of."""

MAX_SKEW = 1e-6
"""Largest entry by which a rotation matrix times its transpose may miss the identity."""


def resample(tree: TreeGraph, spacing: float) -> TreeGraph:
    """Replace the nodes along each branch by evenly spaced ones.

    Roots, tips and branching nodes stay exactly where they are. Each run between two of them is
    divided into the fewest equal steps, measured along the old polyline, that are not longer than
    `spacing`.

    Parameters
    ----------
    tree : TreeGraph
        All arrays are read.
    spacing : float
        Metres, > 0.

    Returns
    -------
    tree : TreeGraph
        Positions and radii are interpolated linearly along the old segments (NaN if one end is NaN);
        other attributes are those of the old segment, that is of its node farther from the root.
        Depth-first if `tree` is.

    Raises
    ------
    InputError
        If `spacing` is not a positive finite number, or gives more than 50 million nodes.

    Notes
    -----
    O(n + m) for m new nodes. A run without length becomes one step.

    Examples
    --------
    >>> tree = TreeGraph([-1, 0], [[0, 0, 0], [0, 0, 1]], [0.2, 0.1])
    >>> resample(tree, 0.4).position[:, 2].round(3).tolist()
    [0.0, 0.333, 0.667, 1.0]
    """
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise InputError(f"spacing must be a positive finite number of metres, got {spacing!r}")
    key = np.empty(tree.n_nodes, bool)
    _kernels.mark_keys(tree.parent, key)
    edge = _kernels.edge_length(tree.parent, tree.position)
    steps = _kernels.count_steps(tree.parent, edge, key, float(spacing))
    total = steps.sum() + (tree.parent == NO_PARENT).sum()
    if not total <= MAX_RESAMPLED:
        raise InputError(
            f"spacing must give at most {MAX_RESAMPLED} nodes, but {spacing!r} m over "
            f"{edge.sum():.6g} m of branches gives {total:.3g}; is it in metres?"
        )
    m = int(total)
    parent, node, fraction = np.empty(m, np.int32), np.empty(m, np.int32), np.empty(m)
    _kernels.lay_steps(tree.parent, edge, key, steps, parent, node, fraction)
    below = np.maximum(tree.parent[node], 0)
    inside = fraction < 1.0
    position = tree.position[node]
    t = fraction[inside, None]
    position[inside] = (1.0 - t) * tree.position[below[inside]] + t * position[inside]
    radius = tree.radius[node]
    t = fraction[inside]
    radius[inside] = (1.0 - t) * tree.radius[below[inside]] + t * radius[inside]
    return TreeGraph(parent, position, radius, {name: v[node] for name, v in tree.attribute.items()})


def simplify_nodes(
    tree: TreeGraph,
    tolerance: ArrayLike,
    radius_tolerance: ArrayLike | None = None,
    *,
    keep: ArrayLike | None = None,
) -> NDArray[np.int64]:
    """The nodes that :func:`simplify` keeps.

    Parameters
    ----------
    tree, tolerance, radius_tolerance, keep
        As for :func:`simplify`.

    Returns
    -------
    node : (m,) int64 ndarray
        Old indices, ascending: node k of the simplified tree is ``node[k]`` of the old one.

    Raises
    ------
    InputError
        As :func:`simplify`.

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 1], [[0, 0, 0], [0.01, 0, 1], [0, 0, 2]], [0.2, 0.1, 0.1])
    >>> simplify_nodes(tree, 0.02).tolist()
    [0, 2]
    """
    n = tree.n_nodes
    allowed = _tolerances("tolerance", tolerance, n)
    use_radius = radius_tolerance is not None
    allowed_radius = _tolerances("radius_tolerance", radius_tolerance, n) if use_radius else allowed
    key = np.empty(n, bool)
    _kernels.mark_keys(tree.parent, key)
    if keep is not None:
        key |= _mask("keep", keep, n)
    out = np.empty(n, bool)
    _kernels.thin_runs(
        tree.parent, tree.position, tree.radius, key, allowed, allowed_radius, use_radius, MAX_SPAN, out
    )
    return np.flatnonzero(out)


def simplify(
    tree: TreeGraph,
    tolerance: ArrayLike,
    radius_tolerance: ArrayLike | None = None,
    *,
    keep: ArrayLike | None = None,
) -> TreeGraph:
    """Drop as many nodes along the branches as a tolerance allows.

    Roots, tips and branching nodes stay. On each run between two of them the nodes that stay are a
    smallest set for which every dropped node lies within `tolerance` of the one straight segment that
    takes the place of its piece of the run, and, if asked for, its radius within `radius_tolerance` of
    the radius interpolated at its foot on that segment. They are found by breadth-first search over
    all chords that hold the tolerance, so no other choice of old nodes is smaller. Distance to a segment is a
    convex function, so the whole old polyline stays within `tolerance` of the new one, and the new one within
    `tolerance` of the old.

    Parameters
    ----------
    tree : TreeGraph
        All arrays are read.
    tolerance : float or (n,) array_like
        Metres, >= 0; one for all nodes or one for each.
    radius_tolerance : float or (n,) array_like, optional
        Metres, >= 0. Left out, radii do not matter. Given, an unknown radius (NaN) is only ever
        replaced by an unknown one.
    keep : (n,) bool array_like, optional
        Further nodes that must stay, for instance the seeds of clusters.

    Returns
    -------
    tree : TreeGraph
        The kept nodes with their own values, in their old order (:func:`simplify_nodes` tells which).

    Raises
    ------
    InputError
        If a tolerance is negative or not finite, or an array does not have one value per node.

    Notes
    -----
    A segment takes the place of at most 1000 old ones, unless it takes that of a whole run: beyond that
    the result may not be a smallest one. Time about O(n w) for segments that replace w old ones.

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 1], [[0, 0, 0], [0.01, 0, 1], [0, 0, 2]], [0.2, 0.1, 0.1])
    >>> simplify(tree, 0.02).n_nodes, simplify(tree, 0.005).n_nodes, simplify(tree, 0.02, 0.01).n_nodes
    (2, 3, 3)
    """
    return take_nodes(tree, simplify_nodes(tree, tolerance, radius_tolerance, keep=keep))


def take_nodes(tree: TreeGraph, node: ArrayLike) -> TreeGraph:
    """Keep some nodes; each hangs on its nearest kept ancestor.

    Parameters
    ----------
    tree : TreeGraph
        All arrays are read.
    node : (m,) int array_like or (n,) bool array_like
        Ascending node indices, or a mask; at least one node.

    Returns
    -------
    tree : TreeGraph
        The kept nodes in their old order. A node without a kept ancestor is a root.

    Raises
    ------
    InputError
        If no node is kept, or the indices do not ascend strictly within 0 ... n-1.

    Notes
    -----
    O(n).

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 1, 2], [[0, 0, z] for z in range(4)], [0.2, 0.1, 0.1, 0.0])
    >>> take_nodes(tree, [0, 1, 3]).parent.tolist()
    [-1, 0, 1]
    """
    n = tree.n_nodes
    node = np.asarray(node)
    if node.dtype == bool:
        keep = _mask("node", node, n)
    else:
        if node.ndim != 1 or (node.size and node.dtype.kind not in "iu"):
            raise InputError(f"node must hold indices or be a mask, got {node.dtype} of shape {node.shape}")
        if node.size and (node[0] < 0 or node[-1] >= n or (np.diff(node.astype(np.int64)) <= 0).any()):
            raise InputError(f"node must ascend strictly within 0 to {n - 1}; sort it and drop duplicates")
        keep = np.zeros(n, bool)
        keep[node.astype(np.int64)] = True
    count = int(keep.sum())
    if count == 0:
        raise InputError("at least one node must be kept, got none")
    parent = np.empty(count, np.int32)
    _kernels.kept_parents(tree.parent, keep, parent)
    attribute = {name: v[keep] for name, v in tree.attribute.items()}
    return TreeGraph(parent, tree.position[keep], tree.radius[keep], attribute)


def prune(tree: TreeGraph, keep_mask: ArrayLike) -> TreeGraph:
    """Cut off the branches that are not kept.

    Parameters
    ----------
    tree : TreeGraph
        All arrays are read.
    keep_mask : (n,) bool array_like
        True where a node stays. Where a node stays, its parent must.

    Returns
    -------
    tree : TreeGraph
        The nodes that stay, in their old order.

    Raises
    ------
    InputError
        If the mask has another shape or keeps nothing.
    TreeError
        If a kept node has a parent that is not kept; the message names the node.

    Notes
    -----
    O(n).

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 0], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], [0.2, 0.1, 0.1])
    >>> prune(tree, [True, False, True]).position[1].tolist()
    [0.0, 1.0, 0.0]
    """
    keep = _mask("keep_mask", keep_mask, tree.n_nodes)
    bad = np.flatnonzero(keep & (tree.parent >= 0) & ~keep[np.maximum(tree.parent, 0)])
    if bad.size:
        i = int(bad[0])
        raise TreeError(
            f"keep_mask must keep the parent of every kept node, but node {i} is kept and its parent "
            f"{tree.parent[i]} is not; {bad.size} nodes break this. take_nodes() reconnects instead."
        )
    return take_nodes(tree, keep)


def transform(
    tree: TreeGraph,
    rotation: ArrayLike | None = None,
    translation: ArrayLike | None = None,
    scale: float = 1.0,
) -> TreeGraph:
    """Rotate, scale and shift a tree: ``scale * rotation @ position + translation``.

    Parameters
    ----------
    tree : TreeGraph
        All arrays are read.
    rotation : (3, 3) array_like, optional
        Rotation matrix: orthonormal to 1e-6, determinant +1.
    translation : (3,) array_like, optional
        Metres; finite.
    scale : float, default 1.0
        Dimensionless, > 0; multiplies the radii too.

    Returns
    -------
    tree : TreeGraph
        The moved tree. Attributes are copied as they are, lengths among them included.

    Raises
    ------
    InputError
        If an argument is not what is said above.

    Notes
    -----
    O(n).

    Examples
    --------
    >>> tree = TreeGraph([-1, 0], [[0, 0, 0], [1, 0, 0]], [0.2, 0.1])
    >>> quarter_turn = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    >>> transform(tree, quarter_turn, translation=(0, 0, 5), scale=2.0).position.tolist()
    [[0.0, 0.0, 5.0], [0.0, 2.0, 5.0]]
    """
    if not (np.isfinite(scale) and scale > 0.0):
        raise InputError(f"scale must be a positive finite number, got {scale!r}")
    position = tree.position
    if rotation is not None:
        matrix = np.asarray(rotation, np.float64)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise InputError(f"rotation must be a finite matrix of shape (3, 3), got shape {matrix.shape}")
        skew = np.abs(matrix @ matrix.T - np.eye(3)).max()
        if skew > MAX_SKEW or np.linalg.det(matrix) < 0.0:
            raise InputError(
                f"rotation must be a rotation matrix (orthonormal, determinant 1); it misses this by "
                f"{skew:.3g} and has determinant {np.linalg.det(matrix):.3g}"
            )
        position = position @ matrix.T
    position = scale * position
    if translation is not None:
        shift = np.asarray(translation, np.float64)
        if shift.shape != (3,) or not np.isfinite(shift).all():
            raise InputError(f"translation must be three finite numbers, got {translation!r}")
        position = position + shift
    return tree.replace(position=position, radius=scale * tree.radius)


def _mask(name: str, mask: ArrayLike, n: int) -> NDArray[np.bool_]:
    array = np.asarray(mask)
    if array.dtype != bool or array.shape != (n,):
        raise InputError(f"{name} must be a mask of shape ({n},), got {array.dtype} of shape {array.shape}")
    return array


def _tolerances(name: str, value: ArrayLike | None, n: int) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be a number or an array of numbers, got {error}") from error
    if array.shape not in ((), (n,)):
        raise InputError(f"{name} must be one number or have shape ({n},), got shape {array.shape}")
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        raise InputError(f"{name} must be finite and >= 0 metres, got {array.min()} to {array.max()}")
    return np.ascontiguousarray(np.broadcast_to(array, (n,)))
