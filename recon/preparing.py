"""Preparing a scan: what is no part of the tree goes, and the trunk's foot becomes the origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from recon.cloud import Cloud, as_cloud
from treegraph.errors import InputError

MIN_POINTS = 4


@dataclass(frozen=True)
class PrepareSettings:
    """What the user can say about a scan.

    Attributes
    ----------
    base : (3,) tuple or None
        Foot of the trunk in the scan's own coordinates and unit; found if None.
    units : {None, "m", "cm", "mm", "ft"}
        Unit of the scan; metres if None, with a remark if that looks wrong.
    up : {"z", "y", "x", "-z", "-y", "-x"}
        Axis of the scan that points up.
    keep_ground : bool
        Leave the ground in.
    largest : bool
        Of several trees take the largest.
    tree_id : int or None
        Of a scan with tree numbers take this one.
    """

    base: tuple[float, float, float] | None = None
    units: str | None = None
    up: str = "z"
    keep_ground: bool = False
    largest: bool = False
    tree_id: int | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A cloud ready for the skeleton.

    Attributes
    ----------
    cloud : Cloud
        Metres, z up, foot of the trunk at (0, 0, 0).
    index : (m,) int64
        Row of the given cloud of each point.
    ground_z : float or None
        Height of the ground at the trunk, metres, in the new frame.
    looks_like_many : int
        Number of trees if the scan looks like several, else 1.
    notes : tuple of str
        What was noticed and done.
    """

    cloud: Cloud
    index: np.ndarray
    ground_z: float | None
    looks_like_many: int
    notes: tuple[str, ...]


def prepare(points: Any, settings: PrepareSettings = PrepareSettings()) -> Prepared:  # noqa: B008
    """Drop what is no part of the tree and move its foot to the origin."""
    cloud = as_cloud(points)
    xyz = cloud.xyz
    good = np.flatnonzero(np.isfinite(xyz).all(axis=1))
    xyz = xyz[good]
    if len(xyz) < MIN_POINTS:
        raise InputError(f"{len(xyz)} usable points are too few for a tree (at least {MIN_POINTS}).")
    low = xyz[:, 2] <= xyz[:, 2].min() + 0.05 * np.ptp(xyz[:, 2])
    base = np.array([*np.median(xyz[low, :2], axis=0), xyz[low, 2].min()])
    if settings.base is not None:
        base = np.asarray(settings.base, np.float64) - cloud.origin
    return Prepared(cloud.take(good).shifted(base), good, None, 1, ())
