"""Binary glTF 2.0 (``.glb``): metres, y up, one node and one material per part.

Based on: Khronos Group, "glTF 2.0 Specification", 2021, sections 3 (properties) and 4 (GLB file format).
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from render.lighting import to_linear
from render.mesh import Mesh
from render.parts import Material, Part
from render.textures import CUTOFF, Texture
from treegraph import InputError
from treegraph._files import write_whole

if TYPE_CHECKING:
    from render.instancing import DecodedTree

__all__ = ["encode_glb", "encode_instanced_glb", "write_glb", "write_instanced_glb"]

MAGIC, VERSION = 0x46546C67, 2  # "glTF"
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
ARRAY_BUFFER, ELEMENT_BUFFER = 34962, 34963
COMPONENT = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
KIND = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
SHORT_INDEX_LIMIT = 65535  # the largest 16-bit index is reserved
MAX_BYTES = 2**32 - 1
LINEAR, LINEAR_MIPMAP_LINEAR, CLAMP, REPEAT = 9729, 9987, 33071, 10497
INSTANCING = "EXT_mesh_gpu_instancing"


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
        If there is no face at all, a vertex is not finite, a part with a texture has no texture coordinates,
        or the file would pass 4 GiB.

    Notes
    -----
    Positions are turned from z up to glTF's y up: (x, y, z) becomes (x, z, -y). They are stored in single
    precision, to about 1e-7 of their distance from the origin: parts belong near it.
    """
    write_whole(path, encode_glb(parts, extras=extras))


def encode_glb(parts: Sequence[Part], *, extras: Mapping[str, Any] | None = None) -> bytes:
    """The bytes of :func:`write_glb`."""
    check_parts(parts)
    check_coordinates(parts)
    build = _Builder()
    for part in parts:
        if len(part.mesh.faces):
            build.add_part(part)
    return build.encode(list(range(len(build.nodes))), extras)


def write_instanced_glb(
    path: str | os.PathLike[str],
    tree: DecodedTree,
    *,
    name: str = "tree",
    extras: Mapping[str, Any] | None = None,
) -> None:
    """Write a decoded tree as binary glTF in which every patch is there once; whole or not at all.

    Parameters
    ----------
    path : path
        Usually ends in ``.glb``.
    tree : DecodedTree
    name : str
        Of the tree's node, which stands at the base of the trunk. Its children are ``wood`` and
        ``patch_00``, ``patch_01`` and so on, one for each patch that has an instance.
    extras : mapping, optional
        What else to say about the scene; JSON.

    Raises
    ------
    InputError
        If there is no face at all, a vertex is not finite, or the file would pass 4 GiB.

    Notes
    -----
    Uses ``EXT_mesh_gpu_instancing``, and requires it: a program that does not know it would show one twig of
    each kind. :func:`render.flat_parts` and :func:`write_glb` make a file for such programs. y up, metres.
    """
    write_whole(path, encode_instanced_glb(tree, name=name, extras=extras))


def encode_instanced_glb(
    tree: DecodedTree, *, name: str = "tree", extras: Mapping[str, Any] | None = None
) -> bytes:
    """The bytes of :func:`write_instanced_glb`."""
    foliage = tree.foliage
    used = [g for g in np.flatnonzero(np.diff(tree.start)).tolist() if foliage.meshes[g].n_faces]
    wood = Part("wood", tree.wood, foliage.bark)
    meshes = [(foliage.twigs[g], foliage.meshes[g].leaves) for g in used]
    pieces = [wood]
    for twigs, leaves in meshes:
        pieces += [Part("twigs", twigs, foliage.bark), Part("leaves", leaves, foliage.leaf)]
    check_parts(pieces)
    check_coordinates(pieces)
    build = _Builder()
    build.nodes.append({"name": name, "children": []})
    if len(tree.wood.faces):
        build.add_node("wood", [(tree.wood, foliage.bark)])
    digits = max(len(str(len(foliage.meshes) - 1)), 2)
    for g, (twigs, leaves) in zip(used, meshes, strict=True):
        both = [(twigs, foliage.bark), (leaves, foliage.leaf)]
        build.add_node(f"patch_{g:0{digits}d}", [pair for pair in both if len(pair[0].faces)])
        rows = slice(tree.start[g], tree.start[g + 1])
        build.add_instances(tree.position[rows], tree.rotation[rows], tree.scale[rows])
    build.nodes[0]["children"] = list(range(1, len(build.nodes)))
    return build.encode([0], extras)


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


def check_coordinates(parts: Sequence[Part]) -> None:
    """Raise :class:`InputError` where a part has a texture but its mesh no texture coordinates."""
    for part in parts:
        textured = part.material.texture is not None or part.material.normal_texture is not None
        if textured and part.mesh.uv is None and len(part.mesh.faces):
            raise InputError(
                f"part {part.name!r} has a texture, so its mesh must have texture coordinates, got none"
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
        self.textures: list[dict[str, Any]] = []
        self.images: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.extensions: list[str] = []
        self._texture_at: dict[tuple[int, bool], int] = {}
        self._material_at: dict[int, int] = {}

    def encode(self, roots: list[int], extras: Mapping[str, Any] | None) -> bytes:
        """The whole file."""
        scene: dict[str, Any] = {"nodes": roots}
        if extras:
            scene["extras"] = dict(extras)
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "Sapwood"},
            "scene": 0,
            "scenes": [scene],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": self.size}],
        }
        if self.textures:
            document |= {"textures": self.textures, "images": self.images, "samplers": self.samplers}
        if self.extensions:
            document |= {"extensionsUsed": self.extensions, "extensionsRequired": self.extensions}
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + self.size
        if total > MAX_BYTES:
            raise InputError(f"a GLB file must be under 4 GiB, got {total} bytes; lower the detail")
        head = struct.pack("<III", MAGIC, VERSION, total) + struct.pack("<II", len(text), JSON_CHUNK)
        return b"".join([head, text, struct.pack("<II", self.size, BINARY_CHUNK), *self.chunks])

    def add_part(self, part: Part) -> None:
        """A node with the mesh and a material of its own, but for textured ones, which are shared."""
        if part.material.texture is None:
            self._material_at.pop(id(part.material), None)
        self.add_node(part.name, [(part.mesh, part.material)])

    def add_node(self, name: str, pieces: Sequence[tuple[Mesh, Material]]) -> None:
        """A node with one mesh that is made of several pieces."""
        primitives = [self._add_primitive(mesh, material) for mesh, material in pieces]
        self.nodes.append({"name": name, "mesh": len(self.meshes)})
        self.meshes.append({"name": name, "primitives": primitives})

    def add_instances(
        self, position: NDArray[np.float32], rotation: NDArray[np.float32], scale: NDArray[np.float32]
    ) -> None:
        """Show the last node's mesh once for every row."""
        turned = np.column_stack([_y_up(rotation[:, :3]), rotation[:, 3]]).astype(np.float32)
        attributes = {
            "TRANSLATION": self._add(_y_up(position), None),
            "ROTATION": self._add(_unit_rows(turned), None),
            "SCALE": self._add(np.repeat(scale[:, None], 3, axis=1), None),
        }
        self.nodes[-1]["extensions"] = {INSTANCING: {"attributes": attributes}}
        self.extensions = [INSTANCING]

    def _add_primitive(self, mesh: Mesh, material: Material) -> dict[str, Any]:
        index = np.uint16 if len(mesh.vertices) < SHORT_INDEX_LIMIT else np.uint32
        attributes = {
            "POSITION": self._add(_y_up(mesh.vertices), ARRAY_BUFFER, bounds=True),
            "NORMAL": self._add(_unit_rows(_y_up(mesh.normals)), ARRAY_BUFFER),
        }
        textured = material.texture is not None or material.normal_texture is not None
        if mesh.uv is not None:
            uv = mesh.uv.astype(np.float32)
            if textured:  # glTF's images begin in the upper left corner
                uv = np.column_stack([uv[:, 0], np.float32(1.0) - uv[:, 1]])
            attributes["TEXCOORD_0"] = self._add(uv, ARRAY_BUFFER)
        if mesh.color is not None:
            linear = np.rint(255.0 * to_linear(mesh.color / 255.0)).astype(np.uint8)
            opaque = np.full((len(linear), 1), 255, np.uint8)
            attributes["COLOR_0"] = self._add(np.hstack([linear, opaque]), ARRAY_BUFFER, normalized=True)
        return {
            "attributes": attributes,
            "indices": self._add(mesh.faces.astype(index).reshape(-1), ELEMENT_BUFFER),
            "material": self._add_material(material),
        }

    def _add_material(self, material: Material) -> int:
        if id(material) not in self._material_at:
            self._material_at[id(material)] = len(self.materials)
            self.materials.append(self._material(material))
        return self._material_at[id(material)]

    def _material(self, material: Material) -> dict[str, Any]:
        out = _plain_material(material)
        clamp = material.alpha_cutoff is not None
        cutoff = material.alpha_cutoff if material.alpha_cutoff is not None else CUTOFF
        if material.texture is not None:
            index = self._add_texture(material.texture, clamp, cutoff)
            out["pbrMetallicRoughness"]["baseColorTexture"] = {"index": index}
        if material.alpha_cutoff is not None:
            out["alphaMode"], out["alphaCutoff"] = "MASK", material.alpha_cutoff
        if material.normal_texture is not None:
            out["normalTexture"] = {"index": self._add_texture(material.normal_texture, clamp, cutoff)}
        return out

    def _add_texture(self, texture: Texture, clamp: bool, cutoff: float) -> int:
        """Embed an image as PNG; return the index of its texture."""
        key = (id(texture), clamp)
        if key in self._texture_at:
            return self._texture_at[key]
        wrap = CLAMP if clamp else REPEAT
        sampler = {"magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": wrap, "wrapT": wrap}
        if sampler not in self.samplers:
            self.samplers.append(sampler)
        data = texture.encode_png(cutoff)
        self.images.append({"bufferView": self._add_bytes(data, None), "mimeType": "image/png"})
        self._texture_at[key] = len(self.textures)
        self.textures.append({"sampler": self.samplers.index(sampler), "source": len(self.images) - 1})
        return self._texture_at[key]

    def _add(
        self, array: NDArray[Any], target: int | None, *, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append an array to the binary chunk; return the index of its accessor."""
        accessor: dict[str, Any] = {
            "bufferView": self._add_bytes(np.ascontiguousarray(array).tobytes(), target),
            "componentType": COMPONENT[array.dtype.name],
            "count": len(array),
            "type": KIND[1 if array.ndim == 1 else array.shape[1]],
        }
        if bounds:
            accessor["min"], accessor["max"] = array.min(axis=0).tolist(), array.max(axis=0).tolist()
        if normalized:
            accessor["normalized"] = True
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def _add_bytes(self, data: bytes, target: int | None) -> int:
        """Append bytes to the binary chunk; return the index of their view."""
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.views.append(view)
        self.chunks.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.chunks[-1])
        return len(self.views) - 1


def _y_up(vector: NDArray[Any]) -> NDArray[np.float32]:
    return np.column_stack([vector[:, 0], vector[:, 2], -vector[:, 1]]).astype(np.float32) + np.float32(0.0)


def _unit_rows(vector: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rows scaled to length one in single precision, as glTF validators demand."""
    length = np.linalg.norm(vector.astype(np.float64), axis=1, keepdims=True)
    return (vector / np.where(length > 0.0, length, 1.0)).astype(np.float32)


def _plain_material(material: Material) -> dict[str, Any]:
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
