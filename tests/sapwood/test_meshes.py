"""Meshes from files: what is read, the axes, and what is refused."""

import json
import struct

import numpy as np
import numpy.testing as npt
import pytest

from sapwood.meshes import AXES, read_mesh
from treegraph import FormatError, InputError, SapwoodError, TreeGraph

TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def tree_parts():
    """The wood of a small tree and one hull, as `decode` and `grow` write them."""
    import render
    from render.parts import LEAF, WOOD, Part
    from treegraph import Cluster

    graph = TreeGraph([-1, 0, 1], [[0, 0, 0], [0, 0, 2], [1, 0, 3]], [0.2, 0.1, 0.05])
    hull = render.hull_mesh([Cluster(TETRA, FACES.astype(np.int32), np.zeros(1, np.int32), np.nan, 0)])
    return (Part("wood", render.branch_mesh(graph), WOOD), Part("leaves", hull, LEAF))


def glb(document, binary=b""):
    """Bytes of a GLB of a description and a binary chunk."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 28 + len(text) + len(binary)
    return b"".join(
        [
            struct.pack("<IIIII", 0x46546C67, 2, total, len(text), 0x4E4F534A),
            text,
            struct.pack("<II", len(binary), 0x004E4942),
            binary,
        ]
    )


def tetra_document(**node):
    """A description of one tetrahedron, and its binary chunk."""
    binary = TETRA.astype("<f4").tobytes() + FACES.astype("<u2").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "n", **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "bark"}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 24},
        ],
        "buffers": [{"byteLength": len(binary)}],
    }
    return document, binary


@pytest.mark.parametrize("suffix", ["glb", "obj", "ply"])
def test_what_sapwood_writes_comes_back_with_its_names(tmp_path, suffix):
    import render

    parts = tree_parts()
    path = tmp_path / f"tree.{suffix}"
    getattr(render, f"write_{suffix}")(path, parts)
    read = read_mesh(path)
    assert len(read) == 2
    for part, again, word in zip(parts, read, ("wood", "leaves"), strict=True):
        assert word in again.names
        npt.assert_allclose(again.vertices[again.faces], part.mesh.vertices[part.mesh.faces], atol=1e-5)


def test_the_same_as_another_reader_sees(tmp_path):
    import trimesh

    import render

    path = tmp_path / "tree.glb"
    render.write_glb(path, tree_parts())
    theirs = trimesh.load(path, force="scene")
    ours = read_mesh(path)
    assert sum(len(part.faces) for part in ours) == sum(len(g.faces) for g in theirs.geometry.values())
    low, high = theirs.bounds
    mine = np.concatenate([part.vertices for part in ours])
    npt.assert_allclose(mine.min(axis=0), [low[0], -high[2], low[1]], atol=1e-6)
    npt.assert_allclose(mine.max(axis=0), [high[0], -low[2], high[1]], atol=1e-6)


def test_transforms_of_nodes_are_applied(tmp_path):
    """A turn of 90 degrees about y, twice as large, moved: by hand."""
    half = np.sqrt(0.5)
    document, binary = tetra_document(
        translation=[10, 0, 0], rotation=[0, half, 0, half], scale=[2, 2, 2], children=[1]
    )
    document["nodes"].append({"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 5, 1]})
    path = tmp_path / "t.glb"
    path.write_bytes(glb(document, binary))
    first, second = read_mesh(path, up="z")
    npt.assert_allclose(first.vertices, [[10, 0, 0], [10, 0, -2], [10, 4, 0], [16, 0, 0]], atol=1e-12)
    npt.assert_allclose(second.vertices[0], [20, 0, 0], atol=1e-12)
    assert first.names == ("n", "bark")


@pytest.mark.parametrize("up", AXES)
def test_turning_up_is_a_rotation(tmp_path, up):
    path = tmp_path / "t.obj"
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    rows = np.concatenate([TETRA, axis[None]])
    lines = ["v {} {} {}".format(*row) for row in rows]
    lines += ["f {} {} {}".format(*(face + 1)) for face in FACES]
    path.write_text("\n".join([*lines, "f 1 2 5", "f 1 3 5"]))
    (part,) = read_mesh(path, up=up, scale=2.0)
    npt.assert_allclose(part.vertices[4], [0, 0, 2.0], atol=1e-12)
    edge = part.vertices[1:4] - part.vertices[0]
    npt.assert_allclose(np.linalg.det(edge), 8 * np.linalg.det(TETRA[1:]), rtol=1e-12)  # not mirrored


def test_quantised_positions_are_scaled(tmp_path):
    document, _ = tetra_document(scale=[2, 2, 2])
    quantised = np.rint(TETRA / 3.0 * 32767).astype("<i2")
    binary = np.pad(quantised, ((0, 0), (0, 1))).tobytes() + FACES.astype("<u2").tobytes()
    document["accessors"][0] |= {"componentType": 5122, "normalized": True}
    document["bufferViews"][0] |= {"byteLength": 32, "byteStride": 8}
    document["bufferViews"][1] |= {"byteOffset": 32}
    (tmp_path / "q.glb").write_bytes(glb(document, binary))
    (part,) = read_mesh(tmp_path / "q.glb", up="z")
    npt.assert_allclose(part.vertices, 2.0 / 3.0 * TETRA, atol=1e-4)


def test_one_mesh_shown_very_often_is_refused(tmp_path, monkeypatch):
    from sapwood import meshes

    document, binary = tetra_document()
    document["nodes"] = [{"mesh": 0} for _ in range(30)]
    document["scenes"][0]["nodes"] = list(range(30))
    (tmp_path / "o.glb").write_bytes(glb(document, binary))
    assert len(read_mesh(tmp_path / "o.glb")) == 30
    monkeypatch.setattr(meshes, "MAX_FACES", 100)
    with pytest.raises(FormatError, match="more than 100 triangles. Simplify it first"):
        read_mesh(tmp_path / "o.glb")


def test_obj_with_groups_polygons_and_negative_rows(tmp_path):
    path = tmp_path / "t.obj"
    path.write_text(
        "# made by hand\no tree\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
        "g stem\nusemtl bark\nf 1/1/1 2//2 3 4\ng crown\nusemtl green leaf\nf -4 -3 -2\n"
    )
    wood, leaf = read_mesh(path)
    assert wood.names == ("tree", "stem", "bark") and leaf.names == ("tree", "crown", "green leaf")
    assert wood.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert leaf.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]


def test_ascii_ply_with_quads(tmp_path):
    path = tmp_path / "t.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    )
    (part,) = read_mesh(path)
    assert part.faces.tolist() == [[0, 1, 2], [0, 2, 3]] and part.names == ()


def test_every_damage_is_one_line(tmp_path):
    """600 mutations of each kind of file: a mesh comes back or one line, never anything else."""
    import render

    rng = np.random.default_rng(5)
    path = tmp_path / "whole"
    refused = 0
    for suffix in ("glb", "obj", "ply"):
        whole = path.with_suffix(f".{suffix}")
        getattr(render, f"write_{suffix}")(whole, tree_parts())
        data = whole.read_bytes()
        bad = tmp_path / f"bad.{suffix}"
        for k in range(200):
            raw = bytearray(data)
            if k % 4 == 0:
                raw = raw[: rng.integers(0, len(raw))]
            else:  # half of them in the head, where the structure stands
                reach = len(raw) if k % 2 else min(1500, len(raw))
                for at in rng.integers(0, reach, rng.integers(1, 6)):
                    raw[at] = rng.integers(0, 256)
            bad.write_bytes(raw)
            try:
                assert all(np.isfinite(part.vertices).all() for part in read_mesh(bad))
            except SapwoodError as error:
                refused += 1
                assert str(error).startswith(str(bad)) and "\n" not in str(error)
    assert refused > 150


def broken(change):
    document, binary = tetra_document()
    change(document)
    return glb(document, binary)


def put(*path_and_value):
    *path, key, value = path_and_value

    def change(document):
        for step in path:
            document = document[step]
        document[key] = value

    return change


OBJ_HEAD = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY_HEAD = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
REFUSED = {
    "empty.glb": (b"", "not a GLB file"),
    "text.glb": (b"hello, this is no mesh at all", "not a GLB file"),
    "old.glb": (struct.pack("<IIIII", 0x46546C67, 1, 20, 0, 0), "glTF version 1 is not read"),
    "cut.glb": (glb(*tetra_document())[:-8], "declares .* bytes and has"),
    "loop.glb": (broken(put("nodes", 0, "children", [0])), "nodes are no tree"),
    "reach.glb": (broken(put("accessors", 0, "count", 10**9)), "reaches beyond its buffer"),
    "minus.glb": (broken(put("bufferViews", 0, "byteOffset", -4)), "-4 is no index"),
    "outside.glb": (broken(put("buffers", 0, "uri", "secret.bin")), "buffers outside the file are not read"),
    "row.glb": (broken(put("accessors", 0, "count", 3)), "names a vertex that is not there"),
    "strip.glb": (broken(put("meshes", 0, "primitives", 0, "mode", 5)), "strips and fans"),
    "lines.glb": (broken(put("meshes", 0, "primitives", 0, "mode", 1)), "there is no triangle in it"),
    "huge.glb": (broken(put("nodes", 0, "scale", [1e308, 1e308, 1e308])), "is not finite"),
    "points.obj": (OBJ_HEAD, "there is no triangle in it"),
    "two.obj": (OBJ_HEAD + b"f 1 2\n", "line 4 must be a face of three vertices"),
    "zero.obj": (OBJ_HEAD + b"f 0 1 2\n", "line 4 must be a face"),
    "word.obj": (OBJ_HEAD + b"f a b c\n", "line 4 must be a face"),
    "beyond.obj": (OBJ_HEAD + b"f 1 2 9\n", "names a vertex that is not there"),
    "short.obj": (b"v 0 0\n" + OBJ_HEAD + b"f 1 2 3\n", "a vertex must be three numbers"),
    "nan.obj": (b"v nan 0 0\n" + OBJ_HEAD + b"f 1 2 3\n", "is not finite"),
    "scan.ply": (PLY_HEAD + b"end_header\n0 0 0\n1 0 0\n0 1 0\n", "has no faces; it is a scan"),
    "count.ply": (
        PLY_HEAD + b"element face 999999999\nproperty list uchar int vertex_indices\nend_header\n",
        "declares more elements than the file holds",
    ),
    "head.ply": (b"ply\nformat ascii 1.0\n", "its header is cut off"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(tmp_path, name):
    data, said = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises((InputError, FormatError), match=said) as caught, np.errstate(all="ignore"):
        read_mesh(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


def test_bad_arguments(tmp_path):
    path = tmp_path / "t.obj"
    path.write_bytes(OBJ_HEAD + b"f 1 2 3\n")
    with pytest.raises(InputError, match="scale must be a positive finite number, got 0"):
        read_mesh(path, scale=0)
    with pytest.raises(InputError, match="up must be one of z, -z, y"):
        read_mesh(path, up="w")
    with pytest.raises(InputError, match="this is a folder"):
        read_mesh((tmp_path / "folder.obj").mkdir() or tmp_path / "folder.obj")
