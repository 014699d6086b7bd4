"""Wavefront OBJ with its material library: text, metres, z up."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from render.gltf import check_parts
from render.parts import Material, Part
from treegraph import InputError
from treegraph._files import write_whole

__all__ = ["write_obj"]


def write_obj(path: str | os.PathLike[str], parts: Sequence[Part]) -> None:
    """Write parts as OBJ, and their materials beside it as MTL.

    Each file appears whole or not at all, the material library first.

    Parameters
    ----------
    path : path
        Must end in ``.obj``; the library is ``NAME.mtl``.
    parts : sequence of Part
        Each becomes an object with its material. At least one has a face.

    Raises
    ------
    InputError
        If the name does not end in ``.obj``, no part has a face, or a vertex is not finite.

    Notes
    -----
    Metres to five decimals. Vertex colours follow the coordinates, sRGB 0 to 1, as many readers understand.
    """
    path = Path(path)
    if path.suffix.lower() != ".obj":
        raise InputError(f"an OBJ file's name must end in .obj, got {path.name!r}")
    check_parts(parts)
    library = path.with_suffix(".mtl")
    lines = [f"# Sapwood: metres, z up\nmtllib {library.name}\n"]
    vertices = texcoords = 0
    for part in parts:
        if len(part.mesh.faces):
            lines.append(_object(part, vertices, texcoords))
            vertices += len(part.mesh.vertices)
            texcoords += 0 if part.mesh.uv is None else len(part.mesh.uv)
    write_whole(library, "".join(_material(m) for m in _distinct(parts)).encode())
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


def _material(material: Material) -> str:
    red, green, blue = material.color
    return (
        f"newmtl {material.name}\nKd {red:.4f} {green:.4f} {blue:.4f}\nKs 0 0 0\n"
        f"d {material.alpha:.4f}\nillum 1\n\n"
    )
