"""The point cloud that reading, preparing and encoding hand to each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from treegraph.errors import InputError

PER_POINT = ("color", "intensity", "tree_id", "is_wood")
_DTYPE = {"color": np.uint8, "intensity": np.float32, "tree_id": np.int32, "is_wood": np.bool_}


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points near the origin, with where they stand in the world and what the file knew of each.

    ``world = xyz + origin``. Scanner and map coordinates have up to seven digits before the
    point; local ones keep their millimetres in any later float32 step.

    Attributes
    ----------
    xyz : (n, 3) float64
        Points, metres (or whatever unit the file is in until :func:`recon.prepare` was told),
        z up, relative to `origin`. Finite.
    origin : (3,) float64
        World position of ``xyz == 0``.
    color : (n, 3) uint8 or None
        Red, green, blue.
    intensity : (n,) float32 or None
        As the file has it; no unit, only comparable within a scan.
    tree_id : (n,) int32 or None
        Which tree a point belongs to; -1 where the file says none.
    is_wood : (n,) bool or None
        True where a label says wood, False where it says anything else.
    epsg : int or None
        EPSG code of the horizontal coordinate system, if the file names one.
    notes : tuple of str
        One-line remarks for the user.
    source : str
        Name of the file, or "" for points from memory.
    n_read : int
        Points in the file, before any were dropped or thinned.
    unit : str or None
        Unit of length that the file itself declares ("m", "ft", ...), if it declares one.

    Notes
    -----
    The arrays are read-only views: a cloud of 10^7 points is not copied to be wrapped.
    """

    xyz: np.ndarray
    origin: np.ndarray
    color: np.ndarray | None = None
    intensity: np.ndarray | None = None
    tree_id: np.ndarray | None = None
    is_wood: np.ndarray | None = None
    epsg: int | None = None
    notes: tuple[str, ...] = ()
    source: str = ""
    n_read: int = -1
    unit: str | None = None

    def __post_init__(self) -> None:
        xyz = _frozen(self.xyz, np.float64)
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise InputError(f"xyz must have shape (n, 3), got {np.shape(self.xyz)}.")
        origin = _frozen(self.origin, np.float64)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise InputError(f"origin must be three finite numbers, got {self.origin!r}.")
        object.__setattr__(self, "xyz", xyz)
        object.__setattr__(self, "origin", origin)
        for name in PER_POINT:
            value = getattr(self, name)
            if value is None:
                continue
            value = _frozen(value, _DTYPE[name])
            expected = (len(xyz), 3) if name == "color" else (len(xyz),)
            if value.shape != expected:
                raise InputError(f"{name} must have shape {expected} to match xyz, got {value.shape}.")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "notes", tuple(self.notes))
        if self.n_read < 0:
            object.__setattr__(self, "n_read", len(xyz))

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.xyz)

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        has = [name for name in PER_POINT if getattr(self, name) is not None]
        return f"<Cloud {len(self.xyz)} points{' with ' + ', '.join(has) if has else ''}>"

    def replace(self, **changes: Any) -> Cloud:
        """A copy with some fields changed."""
        return replace(self, **changes)

    def take(self, rows: np.ndarray) -> Cloud:
        """The points of `rows` (index or mask), with everything that belongs to each."""
        fields = {n: getattr(self, n)[rows] for n in PER_POINT if getattr(self, n) is not None}
        return replace(self, xyz=self.xyz[rows], **fields)

    def shifted(self, base: np.ndarray) -> Cloud:
        """The same points with the local point `base` as the new zero; the world does not move."""
        base = np.asarray(base, np.float64)
        return replace(self, xyz=self.xyz - base, origin=self.origin + base)


def _frozen(array: Any, dtype: type) -> np.ndarray:
    view: np.ndarray = np.ascontiguousarray(array, dtype=dtype).view()
    view.flags.writeable = False
    return view


def near_origin(xyz: np.ndarray) -> np.ndarray:
    """A whole-metre origin at the low corner of `xyz` (n, 3), so that subtracting it is exact."""
    if len(xyz) == 0:
        return np.zeros(3)
    return np.floor(xyz.min(axis=0))


def as_cloud(points: Any) -> Cloud:
    """Wrap an (n, 3) array as a :class:`Cloud`; a Cloud comes back as it is.

    Raises
    ------
    InputError
        If `points` is neither a Cloud nor numbers of shape (n, 3) with at least one finite row.

    Examples
    --------
    >>> as_cloud([[500000.25, 5000000.5, 100.0]]).origin.tolist()
    [500000.0, 5000000.0, 100.0]
    """
    if isinstance(points, Cloud):
        return points
    try:
        xyz = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"points must be numbers of shape (n, 3), got {type(points).__name__}.") from None
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise InputError(f"points must have shape (n, 3), got {xyz.shape}.")
    finite = np.isfinite(xyz).all(axis=1)
    if not finite.any():
        raise InputError(f"points must have at least one finite row, got {len(xyz)} rows and none is.")
    origin = near_origin(xyz if finite.all() else xyz[finite])
    return Cloud(xyz - origin, origin)
