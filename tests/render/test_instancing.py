"""Decoded trees: tables of instances, flat meshes, and the files of both, which show the same tree."""

import dataclasses
import gc
import io
import json
import struct
import tracemalloc

import numba
import numpy as np
import numpy.testing as npt
import pytest
from PIL import Image

from render import (
    Material,
    Mesh,
    Part,
    Texture,
    branch_mesh,
    decode_tree,
    flat_parts,
    make_foliage,
    patch_mesh,
    thickest_edges,
    write_glb,
    write_instanced_glb,
    write_obj,
    write_ply,
)
from render.gltf import encode_glb, encode_instanced_glb
from render.lighting import to_linear, to_srgb
from render.parts import tile_bark
from species.patches import Instances
from tests.corpus import TREES, realistic_tree
from tests.render.leafy import BARK, LEAF, leaf_texture, random_instances, rotate, twigs
from treegraph import InputError, TreeGraph

trimesh = pytest.importorskip("trimesh")

GRAPH = realistic_tree(step=0.1, height=5.0)
PATCHES = twigs(5)
FOLIAGE = make_foliage(PATCHES, bark=BARK, leaf=LEAF)
INSTANCES = random_instances(300, 5)
TREE = decode_tree(GRAPH, INSTANCES, FOLIAGE)
FLAT = flat_parts(TREE)
EXTENSION = "EXT_mesh_gpu_instancing"


def reference(instances, meshes):
    """Every instance of some meshes, patch by patch, transformed one by one in double precision."""
    vertices, normals = [], []
    for g in range(len(meshes)):
        for i in [i for i in instances.order if instances.patch[i] == g]:
            turned = rotate(instances.rotation[i], meshes[g].vertices)
            vertices.append(instances.position[i] + instances.scale[i] * turned)
            normals.append(rotate(instances.rotation[i], meshes[g].normals))
    return np.concatenate(vertices), np.concatenate(normals)


# Tables


def test_tables_are_the_instances_patch_by_patch_in_order_of_detail():
    assert TREE.n_instances == 300
    for g in range(5):
        rows = TREE.row[TREE.start[g] : TREE.start[g + 1]]
        assert (INSTANCES.patch[rows] == g).all()
        rank = np.argsort(INSTANCES.order)[rows]
        assert (np.diff(rank) > 0).all()
    assert sorted(TREE.row.tolist()) == list(range(300))
    npt.assert_array_equal(TREE.position, INSTANCES.position[TREE.row].astype(np.float32))
    npt.assert_array_equal(TREE.rotation, INSTANCES.rotation[TREE.row].astype(np.float32))
    npt.assert_array_equal(TREE.scale, INSTANCES.scale[TREE.row].astype(np.float32))
    npt.assert_array_equal(TREE.wood.vertices, branch_mesh(GRAPH).vertices)


def test_counts_and_leaf_area_are_sums_over_the_instances():
    meshes = [FOLIAGE.meshes[g] for g in INSTANCES.patch]
    assert TREE.n_leaves == sum(mesh.n_leaves for mesh in meshes)
    assert TREE.n_faces == len(TREE.wood.faces) + sum(mesh.n_faces for mesh in meshes)
    quads = sum(
        s**2 * (PATCHES[g].leaves.length * PATCHES[g].leaves.width).sum()
        for s, g in zip(INSTANCES.scale, INSTANCES.patch, strict=True)
    )
    alpha = leaf_texture().pixels[..., 3]
    npt.assert_allclose(TREE.leaf_area, quads * (alpha == 255).mean(), rtol=1e-6)
    bare = decode_tree(GRAPH, INSTANCES, make_foliage(PATCHES))  # no texture: whole quads
    npt.assert_allclose(bare.leaf_area, quads, rtol=1e-6)


@pytest.mark.parametrize("share", [0.5, 0.25, 0.1])
def test_a_level_of_detail_keeps_the_leaf_area_of_what_is_drawn(share):
    tree = decode_tree(GRAPH, INSTANCES, make_foliage(PATCHES, share=share, bark=BARK, leaf=LEAF))
    assert tree.n_leaves <= share * TREE.n_leaves + TREE.n_instances
    wood, node = thickest_edges(GRAPH, share)
    npt.assert_array_equal(tree.wood.vertices, branch_mesh(wood).vertices)
    assert set(np.unique(tree.wood.node)) <= set(node.tolist())

    def area(mesh):
        corner = mesh.vertices[mesh.faces].astype(float)
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        return np.linalg.norm(cross, axis=1).sum() / 2

    npt.assert_allclose(area(flat_parts(tree)[-1].mesh), area(FLAT[-1].mesh), rtol=1e-4)


def test_no_instances_and_patches_that_nobody_uses():
    none = decode_tree(GRAPH, random_instances(0), FOLIAGE)
    assert none.n_instances == 0 and none.leaf_area == 0.0
    assert [part.name for part in flat_parts(none)] == ["wood"]
    document, _ = read_glb(encode_instanced_glb(none))
    assert [node["name"] for node in document["nodes"]] == ["tree", "wood"]
    assert "extensionsUsed" not in document
    few = decode_tree(TREES["one node"], random_instances(4, 1, seed=1), FOLIAGE)
    document, _ = read_glb(encode_instanced_glb(few, name="oak"))
    assert [node["name"] for node in document["nodes"]] == ["oak", "patch_00"]


def test_a_patch_that_is_not_there():
    with pytest.raises(
        InputError, match=r"patch must be 0 to 1, the rows of the foliage, but patch\[0\] is 3"
    ):
        one = Instances(*(np.array(v) for v in ([3], [[0.0] * 3], [[0, 0, 0, 1.0]], [1.0], [0], [0])))
        decode_tree(GRAPH, one, make_foliage(PATCHES[:2]))


def test_foliage_of_nothing_and_of_mixed_things():
    with pytest.raises(InputError, match="foliage needs at least one patch, got none"):
        make_foliage([])
    with pytest.raises(InputError, match="patches must all be Patch or all be PatchMesh"):
        make_foliage([PATCHES[0], patch_mesh(PATCHES[1])])
    with pytest.raises(InputError, match="share must be above 0 and at most 1, got 0"):
        make_foliage(PATCHES, share=0)
    ready = make_foliage([patch_mesh(patch) for patch in PATCHES], bark=BARK, leaf=LEAF)
    again = decode_tree(GRAPH, INSTANCES, ready)
    assert encode_instanced_glb(again) == encode_instanced_glb(TREE)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="a hundred trees take minutes without compiled loops")
def test_a_hundred_trees_leave_nothing_behind():
    """What Python holds after 20 trees and after 120, to within a tenth of one flat tree of the hundred.

    Less is not asked: what runs the tests may keep some ten thousand bytes of its own meanwhile.
    """
    held = []
    size = sum(part.mesh.vertices.nbytes for part in FLAT)
    tracemalloc.start()
    for k in range(120):
        flat_parts(decode_tree(GRAPH, random_instances(300, 5, seed=k), FOLIAGE))
        if k in (19, 119):
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert held[1] - held[0] < 0.1 * size


# The flat mesh


@pytest.mark.parametrize("n", [40, 300])  # one thread, and several
def test_flat_meshes_are_every_instance_in_its_place(n):
    instances = random_instances(n, 5, seed=n)
    wood, twig, leaf = flat_parts(decode_tree(GRAPH, instances, FOLIAGE))
    assert [part.name for part in (wood, twig, leaf)] == ["wood", "twigs", "leaves"]
    assert wood.material is twig.material is BARK and leaf.material is LEAF
    for part, meshes in (
        (twig, [m.twigs for m in FOLIAGE.meshes]),
        (leaf, [m.leaves for m in FOLIAGE.meshes]),
    ):
        vertices, normals = reference(instances, meshes)
        npt.assert_allclose(part.mesh.vertices, vertices, atol=2e-6)
        npt.assert_allclose(part.mesh.normals, normals, atol=1e-6)
        used = [meshes[g] for g in np.sort(instances.patch)]
        npt.assert_array_equal(part.mesh.uv, np.concatenate([m.uv for m in used]))
        first = np.cumsum([0, *(len(m.vertices) for m in used)])
        faces = [m.faces + at for m, at in zip(used, first, strict=False)]
        npt.assert_array_equal(part.mesh.faces, np.concatenate(faces))
    npt.assert_array_equal(leaf.mesh.color, np.concatenate([m.leaves.color for m in np.take(
        np.array(FOLIAGE.meshes, dtype=object), np.sort(instances.patch))]))  # fmt: skip
    assert twig.mesh.color is None


# Files


def read_glb(data):
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and length % 4 == 0
    size, kind = struct.unpack_from("<I4s", data, 20 + length)
    assert kind == b"BIN\0" and size % 4 == 0 and 28 + length + size == total
    return json.loads(data[20 : 20 + length]), data[28 + length :]


ITEM = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def accessor(document, binary, index):
    item = document["accessors"][index]
    view = document["bufferViews"][item["bufferView"]]
    data = np.frombuffer(
        binary, ITEM[item["componentType"]], item["count"] * WIDTH[item["type"]], view["byteOffset"]
    )
    return data.reshape(-1, WIDTH[item["type"]])


def check_gltf(document, binary):
    """The rules of glTF 2.0 (sections 3.6 to 3.9) and of the extension that these files could break."""
    assert document["buffers"] == [{"byteLength": len(binary)}]
    used = np.zeros(len(binary), bool)
    for view in document["bufferViews"]:
        assert view["buffer"] == 0 and view["byteOffset"] % 4 == 0 and view["byteLength"] > 0
        span = slice(view["byteOffset"], view["byteOffset"] + view["byteLength"])
        assert span.stop <= len(binary) and not used[span].any()
        used[span] = True
    assert (~used).sum() < 4 * len(document["bufferViews"])
    for item in document["accessors"]:
        view = document["bufferViews"][item["bufferView"]]
        size = np.dtype(ITEM[item["componentType"]]).itemsize * WIDTH[item["type"]]
        assert item["count"] > 0 and view["byteLength"] == size * item["count"]
        assert size % 4 == 0 or item["type"] == "SCALAR"
    targets = {view: set() for view in range(len(document["bufferViews"]))}
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            check_primitive(document, binary, primitive, targets)
    for node in document["nodes"]:
        if "extensions" in node:
            check_instances(document, binary, node, targets)
    check_materials(document, binary, targets)
    for view, kinds in targets.items():
        assert kinds == {document["bufferViews"][view].get("target")}
    roots = document["scenes"][document["scene"]]["nodes"]
    below = [child for node in document["nodes"] for child in node.get("children", [])]
    assert sorted(below + roots) == list(range(len(document["nodes"])))  # a tree: everything once
    wanted = [EXTENSION] if any("extensions" in node for node in document["nodes"]) else None
    assert document.get("extensionsUsed") == document.get("extensionsRequired") == wanted


def check_primitive(document, binary, primitive, targets):
    at = {name: document["accessors"][k] for name, k in primitive["attributes"].items()}
    kinds = {"POSITION": "VEC3", "NORMAL": "VEC3", "TEXCOORD_0": "VEC2", "COLOR_0": "VEC4"}
    for name, item in at.items():
        assert item["type"] == kinds[name] and item["count"] == at["POSITION"]["count"]
        assert item["componentType"] == (5121 if name == "COLOR_0" else 5126)
        targets[item["bufferView"]].add(34962)
    position = accessor(document, binary, primitive["attributes"]["POSITION"])
    npt.assert_array_equal(at["POSITION"]["min"], position.min(axis=0))
    npt.assert_array_equal(at["POSITION"]["max"], position.max(axis=0))
    normal = accessor(document, binary, primitive["attributes"]["NORMAL"])
    npt.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=5e-7)
    index = document["accessors"][primitive["indices"]]
    targets[index["bufferView"]].add(34963)
    assert index["type"] == "SCALAR" and index["count"] % 3 == 0 and index["componentType"] in (5123, 5125)
    assert accessor(document, binary, primitive["indices"]).max() < len(position)
    assert 0 <= primitive["material"] < len(document["materials"])


def check_instances(document, binary, node, targets):
    assert "mesh" in node and set(node["extensions"]) == {EXTENSION}
    attributes = node["extensions"][EXTENSION]["attributes"]
    items = {name: document["accessors"][k] for name, k in attributes.items()}
    assert {n: (i["type"], i["componentType"]) for n, i in items.items()} == {
        "TRANSLATION": ("VEC3", 5126),
        "ROTATION": ("VEC4", 5126),
        "SCALE": ("VEC3", 5126),
    }
    assert len({item["count"] for item in items.values()}) == 1
    for item in items.values():
        targets[item["bufferView"]].add(None)
    quaternion = accessor(document, binary, attributes["ROTATION"])
    npt.assert_allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=5e-7)


def check_materials(document, binary, targets):
    for material in document["materials"]:
        pbr = material["pbrMetallicRoughness"]
        places = [pbr.get("baseColorTexture"), material.get("normalTexture")]
        for place in [place for place in places if place is not None]:
            texture = document["textures"][place["index"]]
            assert 0 <= texture["sampler"] < len(document["samplers"])
            image = document["images"][texture["source"]]
            assert image["mimeType"] == "image/png"
        assert ("alphaCutoff" in material) == (material.get("alphaMode") == "MASK")
    for image in document.get("images", []):
        view = document["bufferViews"][image["bufferView"]]
        targets[image["bufferView"]].add(None)
        data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        Image.open(io.BytesIO(data)).verify()


def unfold(document, binary):
    """Corners of all triangles of a file by material, instances placed by their matrices."""
    out = {}
    for node in document["nodes"]:
        if "mesh" not in node:
            continue
        matrices = [np.eye(4)]
        if "extensions" in node:
            at = node["extensions"][EXTENSION]["attributes"]
            t, r, s = (accessor(document, binary, at[n]) for n in ("TRANSLATION", "ROTATION", "SCALE"))
            matrices = [compose(*row) for row in zip(t, r, s, strict=True)]
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            local = accessor(document, binary, primitive["attributes"]["POSITION"]).astype(float)
            faces = accessor(document, binary, primitive["indices"]).reshape(-1, 3)
            name = document["materials"][primitive["material"]]["name"]
            for matrix in matrices:
                world = local @ matrix[:3, :3].T + matrix[:3, 3]
                out.setdefault((name, node["name"] == "wood"), []).append(world[faces])
    return {key: np.concatenate(triangles) for key, triangles in out.items()}


def compose(translation, quaternion, scale):
    """T R S, the matrix of a node by the glTF specification."""
    matrix = trimesh.transformations.quaternion_matrix(np.roll(quaternion.astype(float), 1))
    matrix[:3, :3] *= scale
    matrix[:3, 3] = translation
    return matrix


def test_the_instanced_file_keeps_the_rules():
    document, binary = read_glb(encode_instanced_glb(TREE, extras={"species": "oak"}))
    check_gltf(document, binary)
    assert document["scenes"][0]["extras"] == {"species": "oak"}
    names = [node["name"] for node in document["nodes"]]
    assert names == ["tree", "wood", "patch_00", "patch_01", "patch_02", "patch_03", "patch_04"]
    assert document["nodes"][0]["children"] == [1, 2, 3, 4, 5, 6]
    assert not any({"matrix", "translation", "rotation", "scale"} & set(n) for n in document["nodes"])


def test_the_instanced_file_is_the_flat_mesh(tmp_path):
    """The triangles of the instanced file, placed by its matrices, are the flat file's, in its order."""
    document, binary = read_glb(encode_instanced_glb(TREE))
    unfolded = unfold(document, binary)
    write_glb(tmp_path / "flat.glb", FLAT)
    scene = trimesh.load(tmp_path / "flat.glb", process=False)
    assert list(scene.geometry) == ["wood", "twigs", "leaves"]
    keys = {"wood": ("bark", True), "twigs": ("bark", False), "leaves": ("leaf", False)}
    assert set(unfolded) == set(keys.values())
    for name, mesh in scene.geometry.items():
        npt.assert_allclose(unfolded[keys[name]], mesh.triangles, atol=3e-6, err_msg=name)
    for part in FLAT:  # and y is up
        x, y, z = np.moveaxis(unfolded[keys[part.name]], -1, 0)
        own = part.mesh.vertices[part.mesh.faces]
        npt.assert_allclose(np.stack([x, -z, y], axis=-1), own, atol=3e-6)


def test_the_base_of_the_trunk_is_the_pivot():
    document, binary = read_glb(encode_instanced_glb(TREE))
    wood = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    low = accessor(document, binary, wood)
    low = low[low[:, 1] < 0.02]
    npt.assert_allclose(low.mean(axis=0), 0.0, atol=0.05)


def test_each_patch_and_each_image_is_there_once():
    document, _ = read_glb(encode_instanced_glb(TREE))
    assert len(document["meshes"]) == 6 and len(document["images"]) == 3
    assert [len(mesh["primitives"]) for mesh in document["meshes"]] == [1, 2, 2, 2, 2, 2]
    assert [m["name"] for m in document["materials"]] == ["bark", "leaf"]
    flat, _ = read_glb(encode_glb(FLAT))
    check_gltf(*read_glb(encode_glb(FLAT)))
    assert len(flat["images"]) == 3 and [m["name"] for m in flat["materials"]] == ["bark", "leaf"]
    assert len(encode_instanced_glb(TREE)) < 0.2 * len(encode_glb(FLAT))


def test_leaf_materials_are_cut_out_and_seen_from_both_sides():
    document, binary = read_glb(encode_instanced_glb(TREE))
    bark, leaf = document["materials"]
    assert leaf["alphaMode"] == "MASK" and leaf["alphaCutoff"] == 0.5 and leaf["doubleSided"] is True
    assert "alphaMode" not in bark and "doubleSided" not in bark and "normalTexture" not in bark
    leaf_image = document["textures"][leaf["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
    assert document["samplers"][leaf_image["sampler"]]["wrapS"] == 33071  # clamped
    bark_image = document["textures"][bark["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
    assert document["samplers"][bark_image["sampler"]]["wrapT"] == 10497  # repeated
    view = document["bufferViews"][document["images"][leaf_image["source"]]["bufferView"]]
    data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    pixels = np.asarray(Image.open(io.BytesIO(data)))
    npt.assert_array_equal(pixels[..., 3], LEAF.texture.pixels[..., 3])
    there = pixels[..., 3] == 255
    npt.assert_array_equal(pixels[there], LEAF.texture.pixels[there])
    assert pixels[~there][:, 1].min() > 60  # the leaf's green goes on beyond its outline, no magenta rim


def test_images_lie_the_right_way_up():
    """glTF's v runs down: the vertex at the leaf's tip (v = 1) has texture coordinate 0."""
    document, binary = read_glb(encode_instanced_glb(TREE))
    leaves = document["meshes"][1]["primitives"][1]
    uv = accessor(document, binary, leaves["attributes"]["TEXCOORD_0"])
    npt.assert_array_equal(uv[:4], [[0, 1], [1, 1], [0, 0], [1, 0]])


def test_trimesh_reads_the_flat_glb_with_its_textures(tmp_path):
    write_glb(tmp_path / "flat.glb", FLAT)
    scene = trimesh.load(tmp_path / "flat.glb", process=False)
    material = scene.geometry["leaves"].visual.material
    assert material.alphaMode == "MASK" and material.alphaCutoff == 0.5 and material.doubleSided
    npt.assert_array_equal(np.asarray(material.baseColorTexture), LEAF.texture.spread())


def test_obj_has_its_textures_beside_it(tmp_path):
    write_obj(tmp_path / "tree.obj", FLAT)
    assert {p.name for p in tmp_path.iterdir()} == {
        "tree.obj",
        "tree.mtl",
        "tree_bark.png",
        "tree_leaf.png",
        "tree_leaf_normal.png",
    }
    library = (tmp_path / "tree.mtl").read_text()
    assert "newmtl leaf" in library and "map_Kd tree_leaf.png\nmap_d tree_leaf.png\n" in library
    assert "norm tree_leaf_normal.png" in library and library.count("map_d") == 1
    npt.assert_array_equal(np.asarray(Image.open(tmp_path / "tree_leaf.png")), LEAF.texture.spread())
    text = (tmp_path / "tree.obj").read_text()
    first = text.index("vt ", text.index("o leaves"))
    assert text[first : first + 80].startswith("vt 0.00000 0.00000\nvt 1.00000 0.00000\n")  # v up, as OBJ's


def test_names_that_no_file_can_have_are_changed(tmp_path):
    odd = Material("a leaf/ä", (1, 1, 1), texture=LEAF.texture)
    write_obj(tmp_path / "t.obj", [Part("p", FOLIAGE.meshes[0].leaves, odd)])
    assert (tmp_path / "t_a_leaf__.png").exists()


def test_ply_has_the_mean_colour_of_the_texture(tmp_path):
    write_ply(tmp_path / "tree.ply", FLAT[2:])
    mesh = trimesh.load(tmp_path / "tree.ply", process=False)
    npt.assert_allclose(mesh.vertices, FLAT[2].mesh.vertices)
    pixels = LEAF.texture.pixels
    mean = to_srgb(to_linear(pixels[pixels[..., 3] == 255, :3] / 255).mean(axis=0))
    shade = FOLIAGE.meshes[0].leaves.color[0] / 255
    npt.assert_allclose(mesh.visual.vertex_colors[0, :3] / 255, mean * shade, atol=0.003)


@pytest.mark.parametrize("write, name", [(write_glb, "t.glb"), (write_obj, "t.obj")])
def test_a_texture_needs_coordinates(write, name, tmp_path):
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32), np.eye(3, dtype=np.float32))
    with pytest.raises(InputError, match="part 'p' has a texture, so its mesh must have texture coordinates"):
        write(tmp_path / name, [Part("p", mesh, BARK)])
    assert list(tmp_path.iterdir()) == []


def test_nothing_to_write(tmp_path):
    empty = decode_tree(TREES["one node"], random_instances(0), FOLIAGE)
    with pytest.raises(InputError, match="there is nothing to write: no part has a face"):
        write_instanced_glb(tmp_path / "t.glb", empty)
    assert list(tmp_path.iterdir()) == []


def test_same_tree_same_bytes(tmp_path):
    write_instanced_glb(
        tmp_path / "t.glb", decode_tree(GRAPH, INSTANCES, make_foliage(PATCHES, bark=BARK, leaf=LEAF))
    )
    assert (tmp_path / "t.glb").read_bytes() == encode_instanced_glb(TREE)


# Textures and materials


@pytest.mark.parametrize("tile, around", [(1.0, 2), (0.25, 8), (5.0, 1)])
def test_bark_goes_around_a_whole_number_of_times(tile, around):
    """A trunk of 1.9 m girth with a thin side branch."""
    graph = TreeGraph([-1, 0, 1, 1], [[0, 0, 0], [0, 0, 2], [0, 0, 3], [1, 0, 2]], [0.3, 0.3, 0.3, 0.02])
    mesh = branch_mesh(graph)
    tiled = tile_bark(mesh, dataclasses.replace(BARK, tile=tile))
    npt.assert_allclose(tiled.uv[:, 1], mesh.uv[:, 1] / tile, rtol=1e-6)
    trunk = np.unique(mesh.faces[: mesh.piece_start[1]])
    side = np.unique(mesh.faces[mesh.piece_start[1] :])
    npt.assert_allclose(tiled.uv[trunk, 0], around * mesh.uv[trunk, 0], rtol=1e-6)
    npt.assert_allclose(tiled.uv[side, 0], mesh.uv[side, 0], rtol=1e-6)
    assert mesh.uv[trunk, 0].max() == 1.0  # the mesh itself stays
    tree = decode_tree(graph, INSTANCES, make_foliage(PATCHES, bark=dataclasses.replace(BARK, tile=tile)))
    npt.assert_array_equal(tree.wood.uv, tiled.uv)


def test_bark_without_a_texture_and_meshes_that_are_no_tubes_stay():
    mesh = branch_mesh(GRAPH)
    assert tile_bark(mesh, Material("bark", (1, 1, 1), tile=0.3)) is mesh
    leaves = FOLIAGE.meshes[0].leaves
    assert tile_bark(leaves, dataclasses.replace(BARK, tile=0.3)) is leaves
    empty = branch_mesh(TREES["one node"])
    assert tile_bark(empty, BARK) is empty


@pytest.mark.parametrize(
    "pixels, match",
    [
        (np.zeros((4, 4, 2), np.uint8), r"uint8 of shape \(h, w, 3\) or \(h, w, 4\), got uint8 \(4, 4, 2\)"),
        (np.zeros((4, 4, 3)), "got float64"),
        (np.zeros((0, 4, 3), np.uint8), r"must be 1 to 8192 pixels a side, got \(0, 4\)"),
    ],
)
def test_pixels_that_are_no_texture(pixels, match):
    with pytest.raises(InputError, match=match):
        Texture(pixels)


@pytest.mark.parametrize(
    "changes, match",
    [
        ({"alpha_cutoff": 0.0}, "alpha_cutoff must be above 0 and at most 1, got 0.0"),
        ({"alpha_cutoff": 0.5}, "alpha_cutoff needs a texture with four channels"),
        ({"alpha_cutoff": 0.5, "texture": BARK.texture}, "alpha_cutoff needs a texture with four channels"),
        ({"texture": "bark.png"}, "texture must be a Texture or None, got str"),
        ({"tile": 0.0}, "tile must be a length > 0 metres, got 0.0"),
        ({"normal_texture": 3}, "normal_texture must be a Texture or None, got int"),
    ],
)
def test_materials_that_cannot_be(changes, match):
    with pytest.raises(InputError, match=match):
        Material(**{"name": "x", "color": (0, 0, 0), **changes})


def test_textures_know_what_is_there():
    alpha = np.array([[0, 127, 128, 255]], np.uint8)
    pixels = np.concatenate([np.full((1, 4, 3), 50, np.uint8), alpha[..., None]], axis=2)
    pixels[0, 3, :3] = 200
    texture = Texture(pixels)
    assert texture.coverage() == 0.5 and texture.coverage(0.9) == 0.25
    assert BARK.texture.coverage() == 1.0 and BARK.texture.spread() is BARK.texture.pixels
    assert texture.spread(0.9)[0, :, 0].tolist() == [200] * 4
    nothing = Texture(np.zeros((2, 2, 4), np.uint8))
    assert nothing.coverage() == 0.0 and nothing.spread() is nothing.pixels
    with pytest.raises(ValueError, match="read-only"):
        texture.pixels[0] = 0
