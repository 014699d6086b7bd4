"""Triangle meshes from files: GLB, OBJ and PLY, read without trust, with the names of their parts.

Based on: Khronos Group, "glTF 2.0 Specification", 2021, sections 3.6 (buffers, accessors), 3.7 (geometry)
and 4 (GLB file format).
Departs from it in: only what a mesh's shape needs is read. Pictures, skins, morph targets, sparse and
compressed accessors are not; files beside the mesh (materials, pictures) are never opened.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treegraph.errors import FormatError, InputError

__all__ = ["MESH_SUFFIXES", "MeshPart", "read_mesh"]

MESH_SUFFIXES = (".glb", ".obj", ".ply")

AXES = {  # columns of (x, y, z) with z up, and their signs, by the axis that is up in the file
    "z": ((0, 1, 2), (1, 1, 1)),
    "-z": ((0, 1, 2), (1, -1, -1)),
    "y": ((0, 2, 1), (1, -1, 1)),
    "-y": ((0, 2, 1), (1, 1, -1)),
    "x": ((2, 1, 0), (-1, 1, 1)),
    "-x": ((2, 1, 0), (1, 1, -1)),
}
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
COMPONENT = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
TRIANGLES, POINTS_AND_LINES = 4, (0, 1, 2, 3)
MAX_NODES = 100_000  # of a glTF scene; more is no tree model
MAX_FACES = 50_000_000  # a small file can show one mesh a hundred thousand times
MAX_HEADER = 1 << 20  # bytes of a PLY header
PLY_PART = re.compile(r"faces (\d{1,12}) to (\d{1,12}): (.+)")  # the comment with which Sapwood names parts
BROKEN_GLTF = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)


@dataclass(frozen=True, eq=False)
class MeshPart:
    """Triangles of one name.

    Attributes
    ----------
    names : tuple of str
        What the file calls them: object, group, geometry, material; the material last.
    vertices : (v, 3) float64
        Metres, z up; finite.
    faces : (f, 3) int32
        Rows of `vertices`.
    """

    names: tuple[str, ...]
    vertices: NDArray[np.float64]
    faces: NDArray[np.integer[Any]]


def read_mesh(
    path: str | os.PathLike[str], *, up: str | None = None, scale: float = 1.0
) -> tuple[MeshPart, ...]:
    """Read the triangles of a GLB, OBJ or PLY file.

    Parameters
    ----------
    path : path
        The suffix names the kind of file.
    up : {None, "z", "y", "x", "-z", "-y", "-x"}
        Axis of the file that points up. None: y in a GLB, by definition; z in the others.
    scale : float
        Metres per unit of the file, > 0.

    Returns
    -------
    parts : tuple of MeshPart
        At least one, each with at least one face.

    Raises
    ------
    InputError
        If the file is not there, cannot be read, is of another kind or holds no triangle.
    FormatError
        If it is damaged.
    """
    name = os.fspath(path)
    suffix = Path(path).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"{name}: a mesh must end in one of {' '.join(MESH_SUFFIXES)}.")
    if not 0.0 < scale < np.inf:
        raise InputError(f"scale must be a positive finite number, got {scale!r}")
    if up is not None and up not in AXES:
        raise InputError(f"up must be one of {', '.join(AXES)}, got {up!r}")
    reader = {".glb": _read_glb, ".obj": _read_obj, ".ply": _read_ply}[suffix]
    found: list[MeshPart] = []
    n_faces = 0
    for part in reader(name, _read_bytes(name)):
        n_faces += len(part.faces)
        if n_faces > MAX_FACES:
            raise FormatError(f"{name}: the mesh has more than {MAX_FACES} triangles. Simplify it first.")
        if len(part.faces):
            found.append(part)
    if not found:
        raise InputError(f"{name}: there is no triangle in it; name the mesh of a tree.")
    return tuple(_checked(name, part, up or ("y" if suffix == ".glb" else "z"), scale) for part in found)


def _read_bytes(name: str) -> bytes:
    try:
        return Path(name).read_bytes()
    except FileNotFoundError:
        raise InputError(f"{name}: there is no such file.") from None
    except IsADirectoryError:
        raise InputError(f"{name}: this is a folder; name a mesh in it.") from None
    except OSError as error:
        raise InputError(f"{name}: the file cannot be read ({error.strerror}).") from None


def _checked(name: str, part: MeshPart, up: str, scale: float) -> MeshPart:
    """The part with z up and in metres, once its numbers are known to be good."""
    bad = np.flatnonzero(((part.faces < 0) | (part.faces >= len(part.vertices))).any(axis=1))
    if bad.size:
        raise FormatError(
            f"{name}: face {bad[0]} of {' '.join(part.names) or 'the mesh'} names a vertex that is not "
            f"there ({part.faces[bad[0]].tolist()} of {len(part.vertices)}). Export the mesh again."
        )
    column, sign = AXES[up]
    vertices = np.ascontiguousarray(part.vertices[:, column], np.float64) * np.array(sign) * scale
    used = np.unique(part.faces)
    bad = used[~np.isfinite(vertices[used]).all(axis=1)]
    if bad.size:
        raise FormatError(
            f"{name}: vertex {bad[0]} of {' '.join(part.names) or 'the mesh'} is not finite; "
            f"{bad.size} of {used.size} are not. Export the mesh again."
        )
    if used.size < len(vertices):
        row = np.full(len(vertices), -1, np.int32)
        row[used] = np.arange(used.size, dtype=np.int32)
        return MeshPart(part.names, vertices[used], row[part.faces])
    return MeshPart(part.names, vertices, part.faces.astype(np.int32))


# ---------------------------------------------------------------- OBJ


def _read_obj(name: str, data: bytes) -> Iterator[MeshPart]:
    vertex: list[list[str]] = []
    faces: dict[tuple[str, ...], list[tuple[int, int, int]]] = {}
    label = {"o": "", "g": "", "usemtl": ""}
    current = faces.setdefault(("", "", ""), [])
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        word = line.split()
        if not word:
            continue
        if word[0] == "v":
            vertex.append(word[1:4])
        elif word[0] == "f":
            corner = _obj_corners(name, number, word[1:], len(vertex))
            current += [(corner[0], corner[k], corner[k + 1]) for k in range(1, len(corner) - 1)]
        elif word[0] in label:
            label[word[0]] = " ".join(word[1:])
            current = faces.setdefault((label["o"], label["g"], label["usemtl"]), [])
    try:
        vertices = np.array(vertex, np.float64).reshape(len(vertex), 3)
    except ValueError:
        raise FormatError(
            f"{name}: a vertex must be three numbers, and one of the {len(vertex)} is not. "
            "Export the mesh again."
        ) from None
    for names, rows in faces.items():
        if rows:
            yield MeshPart(tuple(filter(None, names)), vertices, np.array(rows, np.int64))


def _obj_corners(name: str, number: int, words: list[str], n_vertices: int) -> list[int]:
    """Rows of the vertices of a face; negative numbers count from the last vertex so far."""
    try:
        corner = [int(word.split("/", 1)[0]) for word in words]
    except ValueError:
        corner = []
    corner = [k - 1 if k > 0 else n_vertices + k for k in corner if k != 0]
    if len(corner) != len(words) or len(corner) < 3 or not all(0 <= k < 2**31 for k in corner):
        raise FormatError(
            f"{name}: line {number} must be a face of three vertices or more, as in 'f 1 2 3'. "
            "Export the mesh again."
        )
    return corner


# ---------------------------------------------------------------- PLY


def _read_ply(name: str, data: bytes) -> Iterator[MeshPart]:
    import plyfile

    counts = _ply_counts(name, data)
    if not counts.get("face"):
        raise InputError(f"{name}: this PLY has no faces; it is a scan rather than a mesh.")
    try:
        ply = plyfile.PlyData.read(io.BytesIO(data), mmap=False)
        vertex, rows = ply["vertex"], ply["face"].data
        vertices = np.column_stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"])
        field = next(f for f in ("vertex_indices", "vertex_index") if f in (rows.dtype.names or ()))
        polygon = [np.asarray(row, np.int64) for row in rows[field]]
    except (plyfile.PlyParseError, StopIteration, KeyError, ValueError, TypeError, OverflowError) as error:
        said = " ".join(str(error).split())[:80] or type(error).__name__
        raise FormatError(f"{name}: the PLY mesh cannot be read ({said}). Export it again.") from None
    size = np.array([len(row) for row in polygon])
    if (size < 3).any():
        raise FormatError(f"{name}: face {int(np.argmax(size < 3))} has fewer than three corners.")
    faces = [[row[0], row[k], row[k + 1]] for row in polygon for k in range(1, len(row) - 1)]
    triangle = np.array(faces, np.int64).reshape(-1, 3)
    marks = [m for m in map(PLY_PART.fullmatch, ply.comments) if m] if (size == 3).all() else []
    done = 0
    for mark in marks:
        first, last = int(mark[1]), int(mark[2])
        if first == done and first <= last < len(triangle):
            yield MeshPart((mark[3],), vertices, triangle[first : last + 1])
            done = last + 1
    yield MeshPart((), vertices, triangle[done:])


def _ply_counts(name: str, data: bytes) -> dict[str, int]:
    """How many of each element the header declares; never more than the file can hold."""
    end = data.find(b"end_header", 0, MAX_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise FormatError(f"{name}: this is not a PLY file, or its header is cut off. Export it again.")
    found = re.findall(rb"element\s+(\S+)\s+(\d{1,18})\s", data[:end])
    counts = {key.decode("latin-1"): int(count) for key, count in found}
    if sum(counts.values()) > len(data) - end:
        raise FormatError(
            f"{name}: the PLY header declares more elements than the file holds; it is cut off or damaged. "
            "Copy it again."
        )
    return counts


# ---------------------------------------------------------------- GLB


def _read_glb(name: str, data: bytes) -> Iterator[MeshPart]:
    document, binary = _glb_chunks(name, data)
    try:
        yield from _gltf_parts(name, document, binary)
    except FormatError:
        raise
    except BROKEN_GLTF as error:
        said = " ".join(str(error).split())[:80] or type(error).__name__
        raise FormatError(
            f"{name}: the glTF inside is damaged or not valid ({type(error).__name__}: {said}). "
            "Export it again."
        ) from None


def _glb_chunks(name: str, data: bytes) -> tuple[Any, bytes]:
    """The document and the binary chunk."""
    if len(data) < 20 or struct.unpack_from("<I", data)[0] != MAGIC:
        raise FormatError(f"{name}: this is not a GLB file (binary glTF). Export it again.")
    version, total = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise FormatError(f"{name}: glTF version {version} is not read, only 2. Export it as glTF 2.0.")
    if total != len(data):
        raise FormatError(
            f"{name}: the GLB declares {total} bytes and has {len(data)}; it is cut off or damaged. "
            "Copy it again."
        )
    chunks: dict[int, bytes] = {}
    at = 12
    while at + 8 <= total:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > total:
            raise FormatError(f"{name}: a block of the GLB is longer than the file. Copy it again.")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    try:
        return json.loads(chunks[JSON_CHUNK]), chunks.get(BINARY_CHUNK, b"")
    except (KeyError, ValueError, RecursionError):
        raise FormatError(f"{name}: the GLB has no readable description. Export it again.") from None


def _gltf_parts(name: str, document: Any, binary: bytes) -> Iterator[MeshPart]:
    for node, matrix in _gltf_nodes(name, document):
        if "mesh" not in node:
            continue
        mesh = document["meshes"][_index(node["mesh"])]
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", TRIANGLES)
            if mode in POINTS_AND_LINES or "POSITION" not in primitive["attributes"]:
                continue
            if mode != TRIANGLES:
                raise FormatError(
                    f"{name}: strips and fans of triangles are not read. Export plain triangles."
                )
            if "KHR_draco_mesh_compression" in primitive.get("extensions", {}):
                raise FormatError(f"{name}: compressed meshes (Draco) are not read. Export it without.")
            vertices = _accessor(document, binary, primitive["attributes"]["POSITION"], 3)
            vertices = vertices.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
            if "indices" in primitive:
                row = _accessor(document, binary, primitive["indices"], 1).reshape(-1)
            else:
                row = np.arange(len(vertices))
            if row.dtype.kind == "f" or len(row) % 3:
                raise ValueError(f"{len(row)} indices are no triangles")
            names = [str(node.get("name", "")), str(mesh.get("name", ""))]
            if "material" in primitive:
                names.append(str(document["materials"][_index(primitive["material"])].get("name", "")))
            yield MeshPart(
                tuple(dict.fromkeys(filter(None, names))), vertices, row.astype(np.int64).reshape(-1, 3)
            )


def _gltf_nodes(name: str, document: Any) -> Iterator[tuple[dict[str, Any], NDArray[np.float64]]]:
    """Every node of the scene with its transform to the world."""
    nodes = document["nodes"]
    roots = document["scenes"][_index(document.get("scene", 0))].get("nodes", [])
    pending = [(_index(k), np.eye(4)) for k in reversed(roots)]
    seen = 0
    while pending:
        k, above = pending.pop()
        seen += 1
        if seen > min(MAX_NODES, len(nodes)):
            raise FormatError(f"{name}: the glTF's nodes are no tree, or too many. Export it again.")
        matrix = above @ _local_matrix(nodes[k])
        yield nodes[k], matrix
        pending += [(_index(child), matrix) for child in reversed(nodes[k].get("children", []))]


def _local_matrix(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), np.float64)
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] = np.array(turn) * np.array(node.get("scale", (1.0, 1.0, 1.0)), np.float64)
    matrix[:3, 3] = np.array(node.get("translation", (0.0, 0.0, 0.0)), np.float64)
    return matrix


def _accessor(document: Any, binary: bytes, index: Any, width: int) -> NDArray[Any]:
    """The rows of an accessor, a view of the binary chunk (count, width)."""
    accessor = document["accessors"][_index(index)]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise ValueError("sparse accessors are not read")
    view = document["bufferViews"][_index(accessor["bufferView"])]
    if _index(view.get("buffer", 0)) != 0 or "uri" in document["buffers"][0]:
        raise ValueError("buffers outside the file are not read")
    if WIDTH[accessor["type"]] != width:
        raise ValueError(f"an accessor is {accessor['type']}, not {width} wide")
    kind = np.dtype(COMPONENT[accessor["componentType"]])
    count, own = _index(accessor["count"]), kind.itemsize * width
    stride = _index(view.get("byteStride", own)) or own
    first = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
    last = _index(view.get("byteOffset", 0)) + _index(view["byteLength"])
    if stride < own or (count and first + (count - 1) * stride + own > min(last, len(binary))):
        raise ValueError("an accessor reaches beyond its buffer")
    if not count:
        return np.empty((0, width), kind)
    rows: NDArray[Any] = np.ndarray((count, width), kind, binary, first, (stride, kind.itemsize))
    if accessor.get("normalized") and kind.kind in "iu":
        return np.maximum(rows / np.iinfo(kind).max, -1.0)
    return rows


def _index(value: Any) -> int:
    """A whole number >= 0, as every index, count and offset of glTF is."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**40:
        raise ValueError(f"{value!r} is no index")
    return value
