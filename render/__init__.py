"""Meshes, exports and pictures of trees.

Names are imported when they are first used, so that ``import render`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from render.errors import NoPreviewError
    from render.foliage import leaf_part
    from render.gl import GLStatus, find_gl
    from render.gltf import write_glb
    from render.mesh import DETAIL, Mesh, MeshSettings, branch_mesh, mesh_volume
    from render.objmesh import write_obj
    from render.parts import Material, Part, hull_mesh, tree_parts
    from render.plymesh import write_ply
    from render.views import Preview, preview, turntable, write_gif

_LAZY = {
    "DETAIL": "mesh",
    "GLStatus": "gl",
    "Material": "parts",
    "Mesh": "mesh",
    "MeshSettings": "mesh",
    "NoPreviewError": "errors",
    "Part": "parts",
    "Preview": "views",
    "branch_mesh": "mesh",
    "find_gl": "gl",
    "hull_mesh": "parts",
    "leaf_part": "foliage",
    "mesh_volume": "mesh",
    "preview": "views",
    "tree_parts": "parts",
    "turntable": "views",
    "write_gif": "views",
    "write_glb": "gltf",
    "write_obj": "objmesh",
    "write_ply": "plymesh",
}

__all__ = [
    "DETAIL",
    "GLStatus",
    "Material",
    "Mesh",
    "MeshSettings",
    "NoPreviewError",
    "Part",
    "Preview",
    "branch_mesh",
    "find_gl",
    "hull_mesh",
    "leaf_part",
    "mesh_volume",
    "preview",
    "tree_parts",
    "turntable",
    "write_gif",
    "write_glb",
    "write_obj",
    "write_ply",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"render.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'render' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
