"""Binary glTF 2.0 (``.glb``): metres, y up, one node and one material per part.

Based on: Khronos Group, "glTF 2.0 Specification", 2021, sections 3 (properties) and 4 (GLB file format).
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.lighting import to_linear
from render.parts import Material, Part
from treegraph import InputError
from treegraph._files import write_whole

__all__ = ["encode_glb", "write_glb"]

MAGIC, VERSION = 0x46546C67, 2  # "glTF"
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
ARRAY_BUFFER, ELEMENT_BUFFER = 34962, 34963
COMPONENT = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
SHORT_INDEX_LIMIT = 65535  # the largest 16-bit index is reserved
MAX_BYTES = 2**32 - 1


def write_glb(
    path: str | os.PathLike[str], parts: Sequence[Part], *, extras: Mapping[str, Any] | None = None
) -> None:
    """Write parts as one binary glTF file; it appears whole or not at all.

    Parameters
    ----------
    path : path
        Usually ends in ``.glb``.
    parts : sequence of Part
        Each becomes a node, a mesh and a material of its own; z up, metres. At least one has a face.
    extras : mapping, optional
        What else to say about the scene, for instance its world origin; JSON.

    Raises
    ------
    InputError
        If there is no face at all, a vertex is not finite, or the file would pass 4 GiB.

    Notes
    -----
    Positions are turned from z up to glTF's y up: (x, y, z) becomes (x, z, -y). They are stored in single
    precision, to about 1e-7 of their distance from the origin: parts belong near it.
    """
    write_whole(path, encode_glb(parts, extras=extras))


def encode_glb(parts: Sequence[Part], *, extras: Mapping[str, Any] | None = None) -> bytes:
    """The bytes of :func:`write_glb`."""
    check_parts(parts)
    build = _Builder()
    for part in parts:
        if len(part.mesh.faces):
            build.add_part(part)
    scene: dict[str, Any] = {"nodes": list(range(len(build.nodes)))}
    if extras:
        scene["extras"] = dict(extras)
    document = {
        "asset": {"version": "2.0", "generator": "Sapwood"},
        "scene": 0,
        "scenes": [scene],
        "nodes": build.nodes,
        "meshes": build.meshes,
        "materials": build.materials,
        "accessors": build.accessors,
        "bufferViews": build.views,
        "buffers": [{"byteLength": build.size}],
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + build.size
    if total > MAX_BYTES:
        raise InputError(f"a GLB file must be under 4 GiB, got {total} bytes; lower the detail")
    head = struct.pack("<III", MAGIC, VERSION, total) + struct.pack("<II", len(text), JSON_CHUNK)
    return b"".join([head, text, struct.pack("<II", build.size, BINARY_CHUNK), *build.chunks])


def check_parts(parts: Sequence[Part]) -> None:
    """Raise :class:`InputError` unless there is a face and every vertex is finite."""
    if not any(len(part.mesh.faces) for part in parts):
        raise InputError("there is nothing to write: no part has a face")
    for part in parts:
        bad = np.flatnonzero(~np.isfinite(part.mesh.vertices).all(axis=1))
        if bad.size:
            raise InputError(
                f"vertices must be finite, but vertices[{bad[0]}] of part {part.name!r} is "
                f"{part.mesh.vertices[bad[0]]}"
            )


class _Builder:
    """Collects the document's lists and the binary chunk."""

    def __init__(self) -> None:
        self.nodes: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.chunks: list[bytes] = []
        self.size = 0

    def add_part(self, part: Part) -> None:
        mesh = part.mesh
        index = np.uint16 if len(mesh.vertices) < SHORT_INDEX_LIMIT else np.uint32
        attributes = {
            "POSITION": self._add(_y_up(mesh.vertices), ARRAY_BUFFER, bounds=True),
            "NORMAL": self._add(_unit_rows(_y_up(mesh.normals)), ARRAY_BUFFER),
        }
        if mesh.uv is not None:
            attributes["TEXCOORD_0"] = self._add(mesh.uv.astype(np.float32), ARRAY_BUFFER)
        if mesh.color is not None:
            linear = np.rint(255.0 * to_linear(mesh.color / 255.0)).astype(np.uint8)
            opaque = np.full((len(linear), 1), 255, np.uint8)
            attributes["COLOR_0"] = self._add(np.hstack([linear, opaque]), ARRAY_BUFFER, normalized=True)
        primitive = {
            "attributes": attributes,
            "indices": self._add(mesh.faces.astype(index).reshape(-1), ELEMENT_BUFFER),
            "material": len(self.materials),
        }
        self.materials.append(_material(part.material))
        self.nodes.append({"name": part.name, "mesh": len(self.meshes)})
        self.meshes.append({"name": part.name, "primitives": [primitive]})

    def _add(
        self, array: NDArray[Any], target: int, *, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append an array to the binary chunk; return the index of its accessor."""
        data = np.ascontiguousarray(array).tobytes()
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(data), "target": target})
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": COMPONENT[array.dtype.name],
            "count": len(array),
            "type": KIND[1 if array.ndim == 1 else array.shape[1]],
        }
        if bounds:
            accessor["min"], accessor["max"] = array.min(axis=0).tolist(), array.max(axis=0).tolist()
        if normalized:
            accessor["normalized"] = True
        self.accessors.append(accessor)
        self.chunks.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.chunks[-1])
        return len(self.accessors) - 1


def _y_up(vector: NDArray[Any]) -> NDArray[np.float32]:
    return np.column_stack([vector[:, 0], vector[:, 2], -vector[:, 1]]).astype(np.float32) + np.float32(0.0)


def _unit_rows(vector: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows scaled to length one in single precision, as glTF validators demand."""
    length = np.linalg.norm(vector.astype(np.float64), axis=1, keepdims=True)
    return (vector / np.where(length > 0.0, length, 1.0)).astype(np.float32)


def _material(material: Material) -> dict[str, Any]:
    color = [round(float(c), 6) for c in to_linear(np.array(material.color))]
    out: dict[str, Any] = {
        "name": material.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*color, material.alpha],
            "metallicFactor": 0.0,
            "roughnessFactor": material.roughness,
        },
    }
    if material.alpha < 1.0:
        out["alphaMode"] = "BLEND"
    if material.double_sided:
        out["doubleSided"] = True
    return out
