"""Stanford PLY, binary: one mesh of all parts, with normals and colours; metres, z up."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from render.gltf import check_parts
from render.lighting import to_linear, to_srgb
from render.parts import Part
from render.textures import CUTOFF
from treegraph._files import write_whole

__all__ = ["write_ply"]

VERTEX = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("color", "u1", 4)])
FACE = np.dtype([("count", "u1"), ("index", "<i4", 3)])
NAMES = (("float", ("x", "y", "z", "nx", "ny", "nz")), ("uchar", ("red", "green", "blue", "alpha")))


def write_ply(path: str | os.PathLike[str], parts: Sequence[Part]) -> None:
    """Write parts as one binary little-endian PLY mesh; it appears whole or not at all.

    Parameters
    ----------
    path : path
        Usually ends in ``.ply``.
    parts : sequence of Part
        At least one has a face. A comment in the header names each part and its faces.

    Raises
    ------
    InputError
        If no part has a face, or a vertex is not finite.

    Notes
    -----
    PLY knows no textures: a textured part has its texture's mean colour, and its leaves are whole quads.
    """
    check_parts(parts)
    parts = [part for part in parts if len(part.mesh.faces)]
    first = np.cumsum([0, *(len(part.mesh.vertices) for part in parts)])
    vertices = np.concatenate([_vertices(part) for part in parts])
    index = np.concatenate([part.mesh.faces + offset for part, offset in zip(parts, first, strict=False)])
    faces = np.empty(len(index), FACE)
    faces["count"], faces["index"] = 3, index
    lines = ["ply", "format binary_little_endian 1.0", "comment Sapwood: metres, z up"]
    start = 0
    for part in parts:
        lines.append(f"comment faces {start} to {start + len(part.mesh.faces) - 1}: {part.name}")
        start += len(part.mesh.faces)
    lines.append(f"element vertex {len(vertices)}")
    lines += [f"property {kind} {name}" for kind, names in NAMES for name in names]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    write_whole(path, "\n".join(lines).encode() + vertices.tobytes() + faces.tobytes())


def _vertices(part: Part) -> np.ndarray:
    out = np.empty(len(part.mesh.vertices), VERTEX)
    material = part.material
    base = np.array(material.color)
    if material.texture is not None:
        cutoff = CUTOFF if material.alpha_cutoff is None else material.alpha_cutoff
        base = to_srgb(to_linear(base) * to_linear(material.texture.mean_color(cutoff)))
    color = np.array([*base, material.alpha])
    own = 1.0 if part.mesh.color is None else np.hstack([part.mesh.color / 255.0, np.ones((len(out), 1))])
    out["xyz"], out["normal"] = part.mesh.vertices, part.mesh.normals
    out["color"] = np.rint(255.0 * color * own)
    return out
