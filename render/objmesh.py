"""Wavefront OBJ with its material library: text, metres, z up."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from render.gltf import check_coordinates, check_parts
from render.parts import Material, Part
from render.textures import CUTOFF, Texture
from treegraph import InputError
from treegraph._files import write_whole

__all__ = ["write_obj"]


def write_obj(path: str | os.PathLike[str], parts: Sequence[Part]) -> None:
    """Write parts as OBJ, their materials beside it as MTL, and textures as PNG.

    Each file appears whole or not at all: textures first, then the material library.

    Parameters
    ----------
    path : path
        Must end in ``.obj``; the library is ``NAME.mtl``, textures are ``NAME_MATERIAL.png`` and
        ``NAME_MATERIAL_normal.png``.
    parts : sequence of Part
        Each becomes an object with its material. At least one has a face.

    Raises
    ------
    InputError
        If the name does not end in ``.obj``, no part has a face, a vertex is not finite, or a part with a
        texture has no texture coordinates.

    Notes
    -----
    Metres to five decimals. Vertex colours follow the coordinates, sRGB 0 to 1, as many readers understand.
    """
    path = Path(path)
    if path.suffix.lower() != ".obj":
        raise InputError(f"an OBJ file's name must end in .obj, got {path.name!r}")
    check_parts(parts)
    check_coordinates(parts)
    library = path.with_suffix(".mtl")
    lines = [f"# Sapwood: metres, z up\nmtllib {library.name}\n"]
    vertices = texcoords = 0
    for part in parts:
        if len(part.mesh.faces):
            lines.append(_object(part, vertices, texcoords))
            vertices += len(part.mesh.vertices)
            texcoords += 0 if part.mesh.uv is None else len(part.mesh.uv)
    materials = []
    for material in _distinct(parts):
        images = _images(path, material)
        for name, texture in images.values():
            cutoff = CUTOFF if material.alpha_cutoff is None else material.alpha_cutoff
            write_whole(path.with_name(name), texture.encode_png(cutoff))
        materials.append(_material(material, {kind: name for kind, (name, _) in images.items()}))
    write_whole(library, "".join(materials).encode())
    write_whole(path, "".join(lines).encode())


def _object(part: Part, first_vertex: int, first_texcoord: int) -> str:
    mesh = part.mesh
    corners, color = mesh.vertices, ""
    if mesh.color is not None:
        shade = np.array(part.material.color) * (mesh.color / 255.0)
        corners, color = np.hstack([mesh.vertices, shade]), " %.4f %.4f %.4f"
    index = mesh.faces + first_vertex + 1
    if mesh.uv is None:
        faces = _rows("f %d//%d %d//%d %d//%d\n", np.repeat(index, 2, axis=1))
    else:
        both = np.stack([index, mesh.faces + first_texcoord + 1, index], axis=2).reshape(-1, 9)
        faces = _rows("f %d/%d/%d %d/%d/%d %d/%d/%d\n", both)
    return "".join(
        [
            f"o {part.name}\n",
            _rows(f"v %.5f %.5f %.5f{color}\n", corners),
            "" if mesh.uv is None else _rows("vt %.5f %.5f\n", mesh.uv),
            _rows("vn %.4f %.4f %.4f\n", mesh.normals),
            f"usemtl {part.material.name}\n",
            faces,
        ]
    )


def _rows(form: str, array: NDArray) -> str:
    return (form * len(array)) % tuple(array.ravel().tolist())


def _distinct(parts: Sequence[Part]) -> list[Material]:
    return list({part.material.name: part.material for part in parts if len(part.mesh.faces)}.values())


def _images(path: Path, material: Material) -> dict[str, tuple[str, Texture]]:
    """Name and image of each of a material's textures, by what it is for."""
    stem = f"{path.stem}_{re.sub('[^A-Za-z0-9-]', '_', material.name)}"
    out = {}
    if material.texture is not None:
        out["color"] = (f"{stem}.png", material.texture)
    if material.normal_texture is not None:
        out["normal"] = (f"{stem}_normal.png", material.normal_texture)
    return out


def _material(material: Material, images: dict[str, str]) -> str:
    red, green, blue = material.color
    lines = [
        f"newmtl {material.name}\nKd {red:.4f} {green:.4f} {blue:.4f}\nKs 0 0 0\n"
        f"d {material.alpha:.4f}\nillum 1\n"
    ]
    if "color" in images:
        lines.append(f"map_Kd {images['color']}\n")
        if material.alpha_cutoff is not None:
            lines.append(f"map_d {images['color']}\n")
    if "normal" in images:
        lines.append(f"norm {images['normal']}\n")
    return "".join([*lines, "\n"])
