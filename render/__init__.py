"""Meshes, exports and pictures of trees.

Names are imported when they are first used, so that ``import render`` stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from render.errors import NoPreviewError
    from render.foliage import leaf_part
    from render.gl import GLStatus, find_gl
    from render.gltf import write_glb, write_instanced_glb
    from render.instancing import DecodedTree, Foliage, decode_tree, flat_parts, make_foliage
    from render.levels import lod_leaves, thickest_edges
    from render.mesh import DETAIL, Mesh, MeshSettings, branch_mesh, mesh_volume
    from render.objmesh import write_obj
    from render.parts import Material, Part, hull_mesh, tree_parts
    from render.patchmesh import BladeSettings, PatchMesh, blade_mesh, patch_mesh
    from render.plymesh import write_ply
    from render.sheets import contact_sheet
    from render.textures import Texture
    from render.views import Preview, preview, turntable, write_gif

_LAZY = {
    "BladeSettings": "patchmesh",
    "DETAIL": "mesh",
    "DecodedTree": "instancing",
    "Foliage": "instancing",
    "GLStatus": "gl",
    "Material": "parts",
    "Mesh": "mesh",
    "MeshSettings": "mesh",
    "NoPreviewError": "errors",
    "Part": "parts",
    "PatchMesh": "patchmesh",
    "Preview": "views",
    "Texture": "textures",
    "blade_mesh": "patchmesh",
    "branch_mesh": "mesh",
    "contact_sheet": "sheets",
    "decode_tree": "instancing",
    "find_gl": "gl",
    "flat_parts": "instancing",
    "hull_mesh": "parts",
    "leaf_part": "foliage",
    "lod_leaves": "levels",
    "make_foliage": "instancing",
    "mesh_volume": "mesh",
    "patch_mesh": "patchmesh",
    "preview": "views",
    "thickest_edges": "levels",
    "tree_parts": "parts",
    "turntable": "views",
    "write_gif": "views",
    "write_glb": "gltf",
    "write_instanced_glb": "gltf",
    "write_obj": "objmesh",
    "write_ply": "plymesh",
}

__all__ = [
    "BladeSettings",
    "DETAIL",
    "DecodedTree",
    "Foliage",
    "GLStatus",
    "Material",
    "Mesh",
    "MeshSettings",
    "NoPreviewError",
    "Part",
    "PatchMesh",
    "Preview",
    "Texture",
    "blade_mesh",
    "branch_mesh",
    "contact_sheet",
    "decode_tree",
    "find_gl",
    "flat_parts",
    "hull_mesh",
    "leaf_part",
    "lod_leaves",
    "make_foliage",
    "mesh_volume",
    "patch_mesh",
    "preview",
    "thickest_edges",
    "tree_parts",
    "turntable",
    "write_gif",
    "write_glb",
    "write_instanced_glb",
    "write_obj",
    "write_ply",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"render.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'render' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
