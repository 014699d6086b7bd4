"""How thick a tree's branches are: species parameters and the allometric rule.

Based on: S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", dissertation, University
of Konstanz, 2013, section 3.3.1 (Eq. 3.1) and Table 3.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treegraph.errors import InputError
from treegraph.graph import TreeGraph

__all__ = ["DEFAULT_ALLOMETRY", "SPECIES_ALLOMETRY", "Allometry", "allometric_radii", "find_allometry"]


@dataclass(frozen=True)
class Allometry:
    """The parameters that tie a species' branches to its trunk (thesis 3.3).

    Attributes
    ----------
    beta : float
        Exponent of the edge weight ``|u - v|**beta`` of the shortest paths, dimensionless, >= 1.
    gamma : float
        Exponent of Eq. 3.1, dimensionless, > 0.
    f_s : float
        Factor by which Eq. 3.2 reduces the diameters when leaf clusters are cut off; > 0 and
        <= 1, where 1 keeps the wood of a leafless tree.
    d_root : float
        Diameter of the trunk at its base, metres, > 0; NaN where unknown.
    """

    beta: float
    gamma: float
    f_s: float
    d_root: float = math.nan

    def __post_init__(self) -> None:
        for name in ("beta", "gamma", "f_s", "d_root"):
            object.__setattr__(self, name, float(getattr(self, name)))
        if not 1.0 <= self.beta < math.inf:
            raise InputError(f"beta must be a finite number >= 1, got {self.beta!r}")
        if not 0.0 < self.gamma < math.inf:
            raise InputError(f"gamma must be a positive finite number, got {self.gamma!r}")
        if not 0.0 < self.f_s <= 1.0:
            raise InputError(f"f_s must be above 0 and at most 1, got {self.f_s!r}")
        if not (math.isnan(self.d_root) or 0.0 < self.d_root < math.inf):
            raise InputError(f"d_root must be a positive diameter in metres or NaN, got {self.d_root!r}")


SPECIES_ALLOMETRY: dict[str, Allometry] = {
    "Mahogany": Allometry(1.7, 1.3, 0.975),
    "Bischofia polycarpa": Allometry(1.8, 1.5, 0.986),
    "Delonix": Allometry(1.7, 1.5, 0.982),
    "Lagerstroemia": Allometry(1.6, 1.5, 0.976),
    "Ailanthus altissima": Allometry(1.5, 1.9, 0.980),
    "Palm": Allometry(1.8, 1.3, 0.800),
    "Terminalia": Allometry(1.5, 1.5, 0.970),
    "Pine": Allometry(1.3, 1.2, 0.980),
    "Willow": Allometry(1.5, 1.9, 0.980),
    "Ficus Virens": Allometry(2.0, 1.6, 0.975),
}
"""Thesis Table 3.1."""

DEFAULT_ALLOMETRY = Allometry(1.65, 1.5, 0.978)
"""For an unknown species: the medians of Table 3.1 (the thesis names no default)."""


def find_allometry(name: str | None) -> Allometry:
    """Return the parameters of a species of thesis Table 3.1.

    Parameters
    ----------
    name : str or None
        Name as in :data:`SPECIES_ALLOMETRY`; case and surrounding blanks do not matter. None
        gives :data:`DEFAULT_ALLOMETRY`.

    Raises
    ------
    InputError
        If the table has no such species; the message lists those it has.

    Examples
    --------
    >>> find_allometry("willow").gamma
    1.9
    """
    if name is None:
        return DEFAULT_ALLOMETRY
    wanted = " ".join(str(name).split()).casefold()
    for known, allometry in SPECIES_ALLOMETRY.items():
        if known.casefold() == wanted:
            return allometry
    raise InputError(
        f"species must be one of {', '.join(sorted(SPECIES_ALLOMETRY))}, got {name!r}; "
        "leave it out for the default"
    )


def allometric_radii(tree: TreeGraph, root_diameter: float, gamma: float) -> NDArray[np.float64]:
    r"""Radius at every node from the length of wood that it carries.

    Half of :math:`d(u) = d_{root} (l(u) / l(root))^\gamma`, Eq. (3.1) of [1]_, where
    :math:`l(u)` is the length of all edges in the subtree of node u.

    Parameters
    ----------
    tree : TreeGraph
        Only ``parent`` and ``position`` are read.
    root_diameter : float
        :math:`d_{root}`, diameter at every root, metres, > 0.
    gamma : float
        :math:`\gamma`, dimensionless, > 0.

    Returns
    -------
    radius : (n,) float64 ndarray
        Metres. Never larger than at the parent; exactly 0 at the tips, where nothing is carried.

    Raises
    ------
    InputError
        If `root_diameter` or `gamma` is not a positive finite number.

    Notes
    -----
    O(n). In a forest every tree is measured against its own root. A tree without length (one node,
    or all nodes in one place) has half of `root_diameter` everywhere.

    References
    ----------
    .. [1] S. Pirk, "Efficient Processing of Plant Life in Computer Graphics", 2013, section 3.3.1

    Examples
    --------
    >>> tree = TreeGraph([-1, 0, 1], [[0, 0, 0], [0, 0, 1], [0, 0, 2]], [0.0] * 3)
    >>> allometric_radii(tree, 0.4, 1.0).tolist()
    [0.2, 0.1, 0.0]
    """
    from treegraph import _kernels

    for name, value in (("root_diameter", root_diameter), ("gamma", gamma)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} must be a positive finite number, got {value!r}")
    carried = _kernels.carried_length(tree.parent, tree.position)
    root = _kernels.root_of(tree.parent)
    whole = carried[root]
    share = np.ones(tree.n_nodes)
    np.divide(carried, whole, out=share, where=whole > 0.0)
    return 0.5 * root_diameter * share**gamma
