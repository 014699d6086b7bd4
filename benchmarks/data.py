"""The scans the benchmarks know, by their places below a data folder that is the user's own."""

from __future__ import annotations

import os
from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DATA_VARIABLE = "SAPWOOD_DATA"


@dataclass(frozen=True)
class Scan:
    """One scan of one tree.

    ``is_wood``: leaf-off, or only the wood of a tree; reconstructed with f_s = 1. ``species``: that of the
    library which fits a tree with leaves best, where it is not known.
    """

    name: str
    path: str
    is_wood: bool = False
    truth: str | None = None
    more: tuple[str, ...] = ()
    species: str | None = None


SCANS = (
    Scan("archi/Tree_2", "local/archi/Tree_2_point_cloud.las", is_wood=True),
    Scan("rtwig/cloud", "local/rtwig/cloud.txt", is_wood=True),
    Scan("adtree/tree7", "local/adtree/tree7.xyz", is_wood=True),
    Scan("adtree/Lille_2", "local/adtree/Lille_2.xyz", is_wood=True),
    Scan("gbs_rc151 wood", "local/gbs_rc151/rc_151_pc_wood.txt", is_wood=True),
    Scan(
        "woodske/alaska_cedar",
        "ship/woodske/alaska_cedar_wood.laz",
        is_wood=True,
        truth="ship/woodske/alaska_cedar_reference_skeleton.laz",
    ),
    Scan("woodske/green_ash", "ship/woodske/green_ash_wood.laz", is_wood=True),
    Scan(
        "woodske/huangshan_pine",
        "ship/woodske/huangshan_pine_wood.laz",
        is_wood=True,
        truth="ship/woodske/huangshan_pine_reference_skeleton.laz",
    ),
    Scan(
        "woodske/orange",
        "ship/woodske/orange_wood.laz",
        is_wood=True,
        truth="ship/woodske/orange_reference_skeleton.laz",
    ),
    Scan("itsme/tree1", "ship/itsme/itsme_tls_tree1.laz", species="Mahogany"),
    Scan("itsme/tree2", "ship/itsme/itsme_tls_tree2.laz", species="Terminalia"),
    Scan("itsme/buttressed1", "ship/itsme/itsme_tls_buttressed1.laz", species="Ficus Virens"),
    Scan("itsme/uav", "ship/itsme/itsme_uav_tree.laz", species="Bischofia polycarpa"),
    Scan("laspy/vegetation", "ship/laspy/vegetation_1_3.las", species="Lagerstroemia"),
    Scan("adtree/Lille_11", "local/adtree/Lille_11.xyz", species="Spruce"),
    Scan("adtree/tree1", "local/adtree/tree1.xyz", species="Ficus microcarpa"),
    Scan("adtree/tree13", "local/adtree/tree13.xyz", species="Birch"),
    Scan("adtree/ahn3_delft", "local/adtree/ahn3_delft.xyz", species="Oak"),
    Scan("arbor/tree_qsm", "local/arbor/tree_qsm.laz", species="Beech"),
    Scan("treels/pine", "local/treels/pine.laz", species="Pine"),
    Scan("treels/spruce", "local/treels/spruce.laz", species="Spruce"),
    Scan("pytlidar/tree_1 (palm)", "local/pytlidar/tree_1.las", species="Palm"),
    Scan(
        "gbs_rc151 wood+leaf",
        "local/gbs_rc151/rc_151_pc_wood.txt",
        more=("local/gbs_rc151/rc_151_pc_leaf.txt",),
        species="Mahogany",
    ),
    Scan("geometricfeatures/tree", "local/geometricfeatures/tree.txt", species="Spruce"),
    Scan("rtls/pc_tree", "local/rtls/pc_tree.txt", species="Oak"),
)

WALNUT = tuple(
    Scan(
        f"walnut_branches/{name}",
        f"local/walnut_branches/{name}.asc",
        is_wood=True,
        truth=f"local/walnut_branches/walnut_branch_{name}_corrected.csv",
    )
    for name in ("A1B2", "A3B4", "A4B6")
)

MODELS = tuple(
    Scan(
        f"eztree/{name}",
        f"ship/eztree/{name}.obj",
        is_wood=True,
        truth=f"ship/eztree/{name}_skeleton.csv",
    )
    for name in (
        "ash_medium",
        "aspen_medium",
        "bush_1",
        "oak_medium",
        "oak_small",
        "pine_large",
        "pine_medium",
    )
)


def add_arguments(parser: ArgumentParser) -> None:
    """The arguments all benchmarks share."""
    parser.add_argument(
        "--data",
        type=Path,
        default=os.environ.get(DATA_VARIABLE),
        help=f"folder of the scans (default: the variable {DATA_VARIABLE})",
    )
    parser.add_argument("--only", default="", help="only scans whose name contains one of these, by commas")
    parser.add_argument("--json", type=Path, help="write the rows to this file as JSON")


def chosen(arguments: Namespace, scans: tuple[Scan, ...]) -> list[Scan]:
    """The scans that were asked for and that the data folder holds."""
    if arguments.data is None:
        raise SystemExit(f"no data folder: give --data DIR or set {DATA_VARIABLE}")
    root = Path(arguments.data)
    words = [word.strip() for word in arguments.only.split(",") if word.strip()]
    named = [s for s in scans if not words or any(word in s.name for word in words)]
    return [s for s in named if (root / s.path).is_file()]


def read_points(root: Path, scan: Scan) -> np.ndarray:
    """All points of a scan, (n, 3) world metres, in file order."""
    from recon import read_cloud

    parts = []
    for path in (scan.path, *scan.more):
        cloud = read_cloud(root / path)
        parts.append(cloud.xyz + cloud.origin)
    return np.concatenate(parts)
