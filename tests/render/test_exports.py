"""Parts and files: what is written is what another program reads."""

import json
import struct

import numpy as np
import numpy.testing as npt
import pytest

from render import Material, Mesh, Part, branch_mesh, hull_mesh, tree_parts, write_glb, write_obj, write_ply
from render.gltf import encode_glb
from tests.corpus import TREES, realistic_cluster_tree, realistic_tree
from treegraph import InputError, TreeError

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def tree():
    return realistic_cluster_tree(realistic_tree(step=0.1, height=5.0), 6)


@pytest.fixture(scope="module")
def parts(tree):
    return tree_parts(tree)


def read_glb(data):
    """The document and the binary chunk, checked against the container's rules (glTF 2.0, section 4)."""
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and length % 4 == 0
    size, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0" and size % 4 == 0 and 28 + length + size == total
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def accessor(document, binary, index):
    item = document["accessors"][index]
    view = document["bufferViews"][item["bufferView"]]
    dtype = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[item["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[item["type"]]
    assert view["byteOffset"] % 4 == 0
    assert view["byteLength"] == item["count"] * width * np.dtype(dtype).itemsize
    return np.frombuffer(binary, dtype, item["count"] * width, view["byteOffset"]).reshape(-1, width)


# Parts


def test_parts_are_wood_and_clusters(tree, parts):
    assert [part.name for part in parts] == ["wood", "clusters"]
    npt.assert_array_equal(parts[0].mesh.vertices, branch_mesh(tree.graph).vertices)
    assert len(parts[1].mesh.faces) == sum(len(c.faces) for c in tree.clusters)
    assert len(parts[1].mesh.piece_start) == len(tree.clusters) + 1
    assert [part.name for part in tree_parts(tree.replace(clusters=()))] == ["wood"]


def test_hulls_keep_their_shape_and_have_shades_of_their_own(tree):
    mesh = hull_mesh(tree.clusters)
    npt.assert_array_equal(mesh.vertices, np.concatenate([c.vertices for c in tree.clusters]))
    for k, cluster in enumerate(tree.clusters):
        faces = mesh.faces[mesh.piece_start[k] : mesh.piece_start[k + 1]]
        npt.assert_array_equal(mesh.vertices[faces], cluster.vertices[cluster.faces])
    shades = np.unique(mesh.color, axis=0)
    assert len(shades) == len(tree.clusters) and shades.min() > 200
    npt.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-6)


def test_hull_normals_of_a_ball_point_outwards(tree):
    ball = trimesh.creation.icosphere(2, 1.0)
    cluster = type(tree.clusters[0])(ball.vertices + 5.0, ball.faces, [0], 1.0, 1)
    npt.assert_allclose(hull_mesh([cluster]).normals, ball.vertices, atol=0.02)


def test_a_cluster_without_faces_is_left_out(tree):
    empty = type(tree.clusters[0])(np.zeros((3, 3)), np.zeros((0, 3), int), [0], 1.0, 1)
    assert len(hull_mesh([empty]).vertices) == 0
    assert len(hull_mesh([empty, tree.clusters[0]]).faces) == len(tree.clusters[0].faces)


def test_unknown_radii_are_an_error(tree):
    with pytest.raises(TreeError, match="radius must be known at every node"):
        tree_parts(tree.replace(graph=TREES["radii unknown"], clusters=()))


@pytest.mark.parametrize(
    "changes, match",
    [
        ({"color": (0, 0, 2)}, r"color must be three numbers from 0 to 1, got \(0, 0, 2\)"),
        ({"alpha": 1.5}, "alpha must be 0 to 1, got 1.5"),
        ({"roughness": -1}, "roughness must be 0 to 1, got -1"),
    ],
)
def test_material_out_of_range(changes, match):
    with pytest.raises(InputError, match=match):
        Material(**{"name": "x", "color": (0, 0, 0), **changes})


# GLB


def test_glb_holds_the_parts_y_up(parts):
    document, binary = read_glb(encode_glb(parts))
    assert document["asset"]["version"] == "2.0"
    assert [node["name"] for node in document["nodes"]] == ["wood", "clusters"]
    for part, mesh in zip(parts, document["meshes"], strict=True):
        (primitive,) = mesh["primitives"]
        at = primitive["attributes"]
        x, y, z = accessor(document, binary, at["POSITION"]).T
        npt.assert_allclose(np.column_stack([x, -z, y]), part.mesh.vertices, atol=1e-6)
        npt.assert_array_equal(
            accessor(document, binary, primitive["indices"]).reshape(-1, 3), part.mesh.faces
        )
        bounds = document["accessors"][at["POSITION"]]
        npt.assert_array_equal(bounds["min"], [x.min(), y.min(), z.min()])
        npt.assert_array_equal(bounds["max"], [x.max(), y.max(), z.max()])
        npt.assert_allclose(np.linalg.norm(accessor(document, binary, at["NORMAL"]), axis=1), 1, atol=5e-7)
    npt.assert_array_equal(
        accessor(document, binary, document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]),
        parts[0].mesh.uv,
    )


def test_glb_materials(parts):
    document, _ = read_glb(encode_glb(parts))
    bark, leaves = document["materials"]
    assert (bark["name"], leaves["name"]) == ("bark", "leaves")
    assert "alphaMode" not in bark and "doubleSided" not in bark
    assert leaves["alphaMode"] == "BLEND" and leaves["doubleSided"] is True
    pbr = bark["pbrMetallicRoughness"]
    assert pbr["metallicFactor"] == 0.0 and pbr["roughnessFactor"] == 0.9
    srgb = np.array(parts[0].material.color)
    npt.assert_allclose(
        pbr["baseColorFactor"][:3], ((srgb + 0.055) / 1.055) ** 2.4, atol=1e-6
    )  # linear, by rule


def test_trimesh_reads_the_glb(parts, tmp_path):
    write_glb(tmp_path / "tree.glb", parts)
    scene = trimesh.load(tmp_path / "tree.glb", process=False)
    assert list(scene.geometry) == ["wood", "clusters"]
    for part, (name, mesh) in zip(parts, scene.geometry.items(), strict=True):
        assert (len(mesh.vertices), len(mesh.faces)) == (len(part.mesh.vertices), len(part.mesh.faces))
        assert mesh.visual.material.name == part.material.name
        assert mesh.volume > 0, name
    low, high = scene.bounds
    vertices = np.concatenate([part.mesh.vertices for part in parts])
    npt.assert_allclose([low[1], high[1]], [vertices[:, 2].min(), vertices[:, 2].max()], atol=1e-5)
    npt.assert_allclose([low[2], high[2]], [-vertices[:, 1].max(), -vertices[:, 1].min()], atol=1e-5)


def test_glb_keeps_what_else_is_said(parts):
    origin = {"origin": [455000.125, 5428000.5, 231.75], "epsg": 32632}
    document, _ = read_glb(encode_glb(parts, extras=origin))
    assert document["scenes"][0]["extras"] == origin


def big_mesh(n):
    return Mesh(
        np.zeros((n, 3)) + [1, 2, 3], np.array([[0, 1, n - 1]], np.int32), np.tile([0, 0, 1.0], (n, 1))
    )


@pytest.mark.parametrize("n, kind", [(65534, 5123), (65535, 5125), (70000, 5125)])
def test_glb_indices_are_as_wide_as_needed(n, kind):
    document, binary = read_glb(encode_glb([Part("big", big_mesh(n), Material("m", (1, 1, 1)))]))
    index = document["meshes"][0]["primitives"][0]["indices"]
    assert document["accessors"][index]["componentType"] == kind
    assert accessor(document, binary, index).ravel().tolist() == [0, 1, n - 1]


def test_same_parts_same_bytes(parts):
    assert encode_glb(parts) == encode_glb(parts)


# OBJ and PLY


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # from the reader, where it keeps our order
def test_trimesh_reads_the_obj(parts, tmp_path):
    write_obj(tmp_path / "tree.obj", parts)
    text = (tmp_path / "tree.obj").read_text().splitlines()
    assert text[:2] == ["# Sapwood: metres, z up", "mtllib tree.mtl"]
    assert [line for line in text if line[:2] == "o "] == ["o wood", "o clusters"]
    scene = trimesh.load(tmp_path / "tree.obj", process=False, maintain_order=True)
    by_material = {mesh.visual.material.name: mesh for mesh in scene.geometry.values()}
    for part in parts:
        mesh = by_material[part.material.name]
        npt.assert_allclose(mesh.triangles, part.mesh.vertices[part.mesh.faces], atol=6e-6)
        npt.assert_allclose(mesh.visual.material.diffuse[:3] / 255, part.material.color, atol=0.005)


def test_obj_indices_point_at_the_right_texture_and_normal(parts, tmp_path):
    write_obj(tmp_path / "tree.obj", parts[::-1])  # a part without texture coordinates first
    rows = {"v": [], "vt": [], "vn": [], "f": []}
    for line in (tmp_path / "tree.obj").read_text().splitlines():
        kind, *rest = line.split()
        if kind in rows:
            rows[kind].append(rest)
    wood = parts[0].mesh
    corner = np.array([[c.split("/") for c in row] for row in rows["f"][-len(wood.faces) :]], int) - 1
    npt.assert_allclose(np.array(rows["vt"], float)[corner[..., 1]], wood.uv[wood.faces], atol=6e-6)
    npt.assert_allclose(np.array(rows["vn"], float)[corner[..., 2]], wood.normals[wood.faces], atol=6e-5)


def test_trimesh_reads_the_ply(parts, tmp_path):
    write_ply(tmp_path / "tree.ply", parts)
    head = (tmp_path / "tree.ply").read_bytes().split(b"end_header")[0].decode()
    assert "comment Sapwood: metres, z up" in head
    assert f"comment faces 0 to {len(parts[0].mesh.faces) - 1}: wood" in head
    mesh = trimesh.load(tmp_path / "tree.ply", process=False)
    vertices = np.concatenate([part.mesh.vertices for part in parts])
    npt.assert_allclose(mesh.vertices, vertices, atol=1e-6)
    npt.assert_allclose(mesh.vertex_normals, np.concatenate([p.mesh.normals for p in parts]), atol=1e-5)
    assert len(mesh.faces) == sum(len(part.mesh.faces) for part in parts)
    npt.assert_array_equal(mesh.faces[-1], parts[1].mesh.faces[-1] + len(parts[0].mesh.vertices))
    npt.assert_allclose(mesh.visual.vertex_colors[0, :3] / 255, parts[0].material.color, atol=0.003)
    assert mesh.visual.vertex_colors[-1, 3] == round(255 * parts[1].material.alpha)


# Files appear whole or not at all


@pytest.mark.parametrize("write, name", [(write_glb, "t.glb"), (write_obj, "t.obj"), (write_ply, "t.ply")])
def test_nothing_to_write(write, name, tmp_path):
    empty = Part("wood", branch_mesh(TREES["one node"]), Material("m", (1, 1, 1)))
    with pytest.raises(InputError, match="there is nothing to write: no part has a face"):
        write(tmp_path / name, [empty])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write, name", [(write_glb, "t.glb"), (write_obj, "t.obj"), (write_ply, "t.ply")])
def test_a_vertex_that_is_not_finite(write, name, tmp_path):
    mesh = big_mesh(3)
    mesh.vertices[1, 0] = np.nan
    with pytest.raises(InputError, match=r"vertices must be finite, but vertices\[1\] of part 'p' is \[nan"):
        write(tmp_path / name, [Part("p", mesh, Material("m", (1, 1, 1)))])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write, name", [(write_glb, "t.glb"), (write_obj, "t.obj"), (write_ply, "t.ply")])
def test_an_old_file_is_replaced_and_no_other_is_left(parts, write, name, tmp_path):
    (tmp_path / name).write_bytes(b"old")
    write(tmp_path / name, parts)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == ({name, "t.mtl"} if name == "t.obj" else {name})
    assert (tmp_path / name).read_bytes() != b"old"


def test_obj_needs_its_suffix(parts, tmp_path):
    with pytest.raises(InputError, match=r"must end in \.obj, got 'tree\.txt'"):
        write_obj(tmp_path / "tree.txt", parts)
