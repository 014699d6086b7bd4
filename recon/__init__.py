"""From a scan to the tree in it: reading, preparing, skeleton, radii, clusters.

Names are imported when they are first used, so that ``import recon`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.cloud import Cloud, as_cloud
    from recon.encoding import EncodeReport, EncodeSettings, Encoding, encode, encode_with_report
    from recon.preparing import Prepared, PrepareSettings, prepare
    from recon.reading import read_cloud

_LAZY = {
    "Cloud": "cloud",
    "as_cloud": "cloud",
    "EncodeReport": "encoding",
    "EncodeSettings": "encoding",
    "Encoding": "encoding",
    "encode": "encoding",
    "encode_with_report": "encoding",
    "Prepared": "preparing",
    "PrepareSettings": "preparing",
    "prepare": "preparing",
    "read_cloud": "reading",
}

__all__ = [
    "Cloud",
    "EncodeReport",
    "EncodeSettings",
    "Encoding",
    "PrepareSettings",
    "Prepared",
    "as_cloud",
    "encode",
    "encode_with_report",
    "prepare",
    "read_cloud",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"recon.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'recon' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
