"""The tree graph: one rooted tree (or a forest) as a struct of NumPy arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treegraph.errors import TreeError

__all__ = ["NO_PARENT", "TreeGraph", "check_tree", "sort_topological", "tree_from_unsorted"]

NO_PARENT = -1
"""The parent of a root."""

_RESERVED = ("parent", "position", "radius")


@dataclass(frozen=True, eq=False)
class TreeGraph:
    """A rooted tree, or a forest, in topological order.

    Edge i is the piece from ``parent[i]`` to node i. The arrays given are copied, and the
    copies are C-contiguous and read-only: use :meth:`replace` to get a changed graph.

    Attributes
    ----------
    parent : (n,) int32
        Index of each node's parent, ``-1`` at a root; ``parent[i] < i`` always, n > 0.
    position : (n, 3) float64
        Node positions, metres, z up, local (near the origin); finite.
    radius : (n,) float64
        Branch radius at the node, metres, >= 0; NaN where unknown.
    attribute : mapping of str to (n, ...) ndarray
        Further values per node, for instance ``"measured"`` (bool) or ``"n_points"`` (int32).

    Raises
    ------
    TreeError
        If an array breaks a rule of :func:`check_tree`.

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 0], [[0, 0, 0], [0, 0, 1], [0, 1, 1]], radius=[0.1, 0.05, 0.05])
    >>> tree
    <TreeGraph 3 nodes, 1 root>
    >>> tree.replace(radius=tree.radius * 2).radius.tolist()
    [0.2, 0.1, 0.1]
    """

    parent: NDArray[np.int32]
    position: NDArray[np.float64]
    radius: NDArray[np.float64]
    attribute: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parent = _as_index("parent", self.parent)
        position = _as_float("position", self.position)
        radius = _as_float("radius", self.radius)
        attribute = {name: _as_column(name, value) for name, value in dict(self.attribute).items()}
        check_tree(parent, position, radius, attribute)
        arrays: list[NDArray[Any]] = [parent, position, radius, *attribute.values()]
        for array in arrays:
            array.flags.writeable = False
        object.__setattr__(self, "parent", parent)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "radius", radius)
        object.__setattr__(self, "attribute", MappingProxyType(attribute))

    @property
    def n_nodes(self) -> int:
        """Number of nodes, at least 1."""
        return int(self.parent.size)

    def __repr__(self) -> str:
        roots = int((self.parent == NO_PARENT).sum())
        nodes = self.n_nodes
        return f"<TreeGraph {nodes} node{'s' * (nodes != 1)}, {roots} root{'s' * (roots != 1)}>"

    def __reduce__(self) -> tuple[Any, ...]:
        return TreeGraph, (self.parent, self.position, self.radius, dict(self.attribute))

    def replace(self, **changes: Any) -> TreeGraph:
        """Return a graph with some of its arrays changed; the rules are checked again.

        Parameters
        ----------
        **changes
            Any of ``parent``, ``position``, ``radius``, ``attribute``. A new ``attribute``
            takes the place of the old mapping as a whole.

        Raises
        ------
        TreeError
            If the changed graph breaks a rule of :func:`check_tree`.
        TypeError
            If a name is not one of the four.
        """
        return replace(self, **changes)


def check_tree(
    parent: NDArray[np.int32],
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    attribute: Mapping[str, NDArray[Any]] | None = None,
) -> None:
    """Raise :class:`TreeError` naming the first broken rule and the node that breaks it.

    Parameters
    ----------
    parent : (n,) int ndarray
        n > 0 and ``-1 <= parent[i] < i``, so the first node is a root and children come later.
    position : (n, 3) float64 ndarray
        Metres; finite.
    radius : (n,) float64 ndarray
        Metres; >= 0 or NaN, never infinite.
    attribute : mapping of str to ndarray, optional
        Every array has n rows and a plain dtype (no objects); the names are strings and none of
        ``parent``, ``position``, ``radius``.

    Raises
    ------
    TreeError
        With the rule, what came instead, and the first node at fault.

    Notes
    -----
    O(n). The constructor of :class:`TreeGraph` calls it; compiled loops rely on it.

    Examples
    --------
    >>> check_tree(np.array([-1, 2, 1]), np.zeros((3, 3)), np.zeros(3))  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    treegraph.errors.TreeError: parent[1] is 2, but a parent must come before its child ...
    """
    n = parent.size
    if parent.ndim != 1 or n == 0:
        raise TreeError(f"parent must have shape (n,) with n > 0, got {parent.shape}")
    if position.shape != (n, 3):
        raise TreeError(f"position must have shape ({n}, 3) to match parent, got {position.shape}")
    if radius.shape != (n,):
        raise TreeError(f"radius must have shape ({n},) to match parent, got {radius.shape}")
    bad = np.flatnonzero((parent < NO_PARENT) | (parent >= np.arange(n)))
    if bad.size:
        i = int(bad[0])
        raise TreeError(
            f"parent[{i}] is {parent[i]}, but a parent must come before its child "
            f"(-1 <= parent[i] < i); {bad.size} of {n} nodes break this. "
            "Reorder them with sort_topological()."
        )
    bad = np.flatnonzero(~np.isfinite(position).all(axis=1))
    if bad.size:
        raise TreeError(
            f"position must be finite, but position[{bad[0]}] is {position[bad[0]]}; "
            f"{bad.size} of {n} nodes break this. Drop or repair them first."
        )
    bad = np.flatnonzero((radius < 0.0) | np.isinf(radius))
    if bad.size:
        raise TreeError(
            f"radius must be >= 0 and finite, or NaN where unknown, but radius[{bad[0]}] is "
            f"{radius[bad[0]]}; {bad.size} of {n} nodes break this."
        )
    _check_attributes(attribute or {}, n)


def sort_topological(parent: ArrayLike) -> NDArray[np.int64]:
    """Return an order of the nodes in which every parent comes before its children.

    The order is depth-first: a branch's nodes lie together, and siblings, as well as roots, keep
    their relative order. A graph that is in this order already is left as it is.

    Parameters
    ----------
    parent : (n,) int array_like
        Index of each node's parent in any order, -1 at a root.

    Returns
    -------
    order : (n,) int64 ndarray
        ``order[k]`` is the old index of the node that comes k-th. Apply it to all arrays, and
        renumber the parents (:func:`tree_from_unsorted` does both).

    Raises
    ------
    TreeError
        If a parent is outside -1 ... n-1, or if some nodes form a cycle.

    Notes
    -----
    O(n) time and memory; an empty input gives an empty order.

    Examples
    --------
    >>> sort_topological([2, 0, -1]).tolist()
    [2, 0, 1]
    """
    parent = _as_index("parent", parent)
    if parent.ndim != 1:
        raise TreeError(f"parent must have shape (n,), got {parent.shape}")
    n = parent.size
    bad = np.flatnonzero((parent < NO_PARENT) | (parent >= n))
    if bad.size:
        i = int(bad[0])
        raise TreeError(
            f"parent[{i}] is {parent[i]}, but a parent must be a node (0 to {n - 1}) or -1 at a root; "
            f"{bad.size} of {n} nodes break this."
        )
    from treegraph import _kernels

    child_start, child = _kernels.child_lists(parent)
    order = np.empty(n, np.int64)
    reached = _kernels.depth_first(parent, child_start, child, order)
    if reached < n:
        lost = np.ones(n, bool)
        lost[order[:reached]] = False
        raise TreeError(
            f"parents must lead to a root, but node {int(np.flatnonzero(lost)[0])} never reaches one: "
            f"{n - reached} of {n} nodes hang on a cycle. Cut it by making one of its nodes a root (-1)."
        )
    return order


def tree_from_unsorted(
    parent: ArrayLike,
    position: ArrayLike,
    radius: ArrayLike | None = None,
    attribute: Mapping[str, ArrayLike] | None = None,
) -> TreeGraph:
    """Build a :class:`TreeGraph` from arrays in any order.

    Parameters
    ----------
    parent : (n,) int array_like
        Index of each node's parent, -1 at a root, in any order.
    position : (n, 3) float array_like
        Metres.
    radius : (n,) float array_like, optional
        Metres; NaN everywhere if left out.
    attribute : mapping of str to (n, ...) array_like, optional
        Further values per node.

    Returns
    -------
    tree : TreeGraph
        The same tree with its nodes in the order of :func:`sort_topological`.

    Raises
    ------
    TreeError
        As :func:`sort_topological` and :func:`check_tree`.

    Notes
    -----
    O(n) time and memory.

    Examples
    --------
    >>> tree = tree_from_unsorted([1, -1], [[0, 0, 1], [0, 0, 0]])
    >>> tree.parent.tolist(), tree.position[:, 2].tolist()
    ([-1, 0], [0.0, 1.0])
    """
    parent = _as_index("parent", parent)
    order = sort_topological(parent)
    n = parent.size
    position = _rows("position", _as_float("position", position), n)
    radius = np.full(n, np.nan) if radius is None else _rows("radius", _as_float("radius", radius), n)
    columns = {
        name: _rows(f"attribute {name!r}", _as_column(name, v), n) for name, v in (attribute or {}).items()
    }
    rank = np.empty(n + 1, np.int32)
    rank[order] = np.arange(n, dtype=np.int32)
    rank[n] = NO_PARENT  # parent -1 reads the last entry
    return TreeGraph(
        rank[parent[order]], position[order], radius[order], {name: v[order] for name, v in columns.items()}
    )


def _rows(name: str, array: NDArray[Any], n: int) -> NDArray[Any]:
    if array.ndim == 0 or array.shape[0] != n:
        raise TreeError(f"{name} must have {n} rows to match parent, got shape {array.shape}")
    return array


def _as_index(name: str, array: ArrayLike) -> NDArray[np.int32]:
    """Copy to contiguous int32, refusing what would not survive the conversion."""
    try:
        array = np.asarray(array)
    except ValueError as error:
        raise TreeError(f"{name} must be an array of integers, got {error}") from error
    if array.dtype.kind not in "iu" and array.size:
        raise TreeError(f"{name} must hold integers, got dtype {array.dtype}")
    limit = np.iinfo(np.int32)
    if array.size and array.dtype != np.int32 and (array.min() < limit.min or array.max() > limit.max):
        raise TreeError(f"{name} must fit 32-bit integers, got values from {array.min()} to {array.max()}")
    return np.array(array, dtype=np.int32, order="C")


def _as_float(name: str, array: ArrayLike) -> NDArray[np.float64]:
    """Copy to contiguous float64, refusing what is no number (complex or text would convert in silence)."""
    try:
        array = np.asarray(array)
        if array.dtype.kind in "biufO":
            return np.array(array, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError) as error:
        raise TreeError(f"{name} must be an array of numbers, got {error}") from error
    raise TreeError(f"{name} must be an array of numbers, got dtype {array.dtype}")


def _as_column(name: str, array: ArrayLike) -> NDArray[Any]:
    try:
        return np.array(array, order="C")
    except ValueError as error:
        raise TreeError(f"attribute {name!r} must be an array, got {error}") from error


def _check_attributes(attribute: Mapping[str, NDArray[Any]], n: int) -> None:
    for name, array in attribute.items():
        if not isinstance(name, str) or not name or name in _RESERVED:
            raise TreeError(
                f"an attribute's name must be a non-empty string other than {', '.join(_RESERVED)}, "
                f"got {name!r}"
            )
        if array.dtype.hasobject:
            raise TreeError(f"attribute {name!r} must have a plain dtype, got {array.dtype}")
        _rows(f"attribute {name!r}", array, n)
