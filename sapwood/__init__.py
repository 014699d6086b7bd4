"""Sapwood: a LiDAR scan of a tree becomes a compact living tree.

>>> import sapwood
>>> tree = sapwood.reconstruct("samples/orange_wood.laz")  # doctest: +SKIP

Names are imported when they are first used, so that ``import sapwood`` and the commands start at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sapwood._version import __version__

if TYPE_CHECKING:
    from sapwood.classifying import features_of
    from sapwood.cylinders import cylinder_table
    from sapwood.measures import Measures
    from sapwood.pipeline import Reconstruction, reconstruct
    from sapwood.scan_files import write_scan
    from sapwood.scanning import scene_of
    from treegraph import read_lobes, write_lobes

_LAZY = {
    "Measures": "sapwood.measures",
    "Reconstruction": "sapwood.pipeline",
    "cylinder_table": "sapwood.cylinders",
    "features_of": "sapwood.classifying",
    "read_lobes": "treegraph",
    "reconstruct": "sapwood.pipeline",
    "scene_of": "sapwood.scanning",
    "write_lobes": "treegraph",
    "write_scan": "sapwood.scan_files",
}

__all__ = [
    "Measures",
    "Reconstruction",
    "__version__",
    "cylinder_table",
    "features_of",
    "read_lobes",
    "reconstruct",
    "scene_of",
    "write_lobes",
    "write_scan",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'sapwood' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
