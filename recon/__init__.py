"""From a scan to the tree in it: reading, preparing, skeleton, radii, clusters.

Names are imported when they are first used, so that ``import recon`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recon.cloud import Cloud, as_cloud
    from recon.encoding import Encoder, EncodeReport, EncodeSettings, Encoding, encode, encode_with_report
    from recon.preparing import Prepared, PrepareSettings, prepare
    from recon.reading import read_cloud
    from recon.scan_paths import Sweep, airborne_sweeps, mobile_sweep, station_sweeps, stations_around
    from recon.scan_scenes import Scene, ground_scene, join_scenes, make_scene, obstacle_scene
    from recon.scanning import Beam, Scan, scan_mesh, scan_scene

_LAZY = {
    "Cloud": "cloud",
    "as_cloud": "cloud",
    "EncodeReport": "encoding",
    "EncodeSettings": "encoding",
    "Encoder": "encoding",
    "Encoding": "encoding",
    "encode": "encoding",
    "encode_with_report": "encoding",
    "Prepared": "preparing",
    "PrepareSettings": "preparing",
    "prepare": "preparing",
    "read_cloud": "reading",
    "Beam": "scanning",
    "Scan": "scanning",
    "Scene": "scan_scenes",
    "Sweep": "scan_paths",
    "airborne_sweeps": "scan_paths",
    "ground_scene": "scan_scenes",
    "join_scenes": "scan_scenes",
    "make_scene": "scan_scenes",
    "mobile_sweep": "scan_paths",
    "obstacle_scene": "scan_scenes",
    "scan_mesh": "scanning",
    "scan_scene": "scanning",
    "station_sweeps": "scan_paths",
    "stations_around": "scan_paths",
}

__all__ = [
    "Beam",
    "Cloud",
    "EncodeReport",
    "EncodeSettings",
    "Encoder",
    "Encoding",
    "PrepareSettings",
    "Prepared",
    "Scan",
    "Scene",
    "Sweep",
    "airborne_sweeps",
    "as_cloud",
    "encode",
    "encode_with_report",
    "ground_scene",
    "join_scenes",
    "make_scene",
    "mobile_sweep",
    "obstacle_scene",
    "prepare",
    "read_cloud",
    "scan_mesh",
    "scan_scene",
    "station_sweeps",
    "stations_around",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"recon.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'recon' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
