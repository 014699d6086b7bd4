"""Every format read back, with what the file knows of each point."""

import os
import time

import numpy as np
import numpy.testing as npt
import pytest
from scan_files import (
    FORMATS,
    e57_world,
    lzf_literal,
    pcd_bytes,
    ply_bytes,
    some_colors,
    some_points,
    write_e57,
    write_las,
    write_scan,
)  # fmt: skip

import recon
from treegraph.errors import InputError


def world(cloud):
    return cloud.xyz + cloud.origin


@pytest.mark.parametrize("kind", FORMATS)
def test_round_trip_whatever_the_name(tmp_path, kind):
    if kind == "e57":
        pytest.importorskip("pye57")
    xyz = some_points()
    path = write_scan(tmp_path, kind, xyz)  # all are called .dat
    cloud = recon.read_cloud(path)
    npt.assert_allclose(world(cloud), e57_world(xyz) if kind == "e57" else xyz, atol=1e-9)
    assert cloud.n_read == 200 and cloud.source == path.name
    assert (cloud.origin == np.floor(world(cloud).min(axis=0))).all()
    if kind in ("text", "npy", "npy-records"):
        assert cloud.color is None
    else:
        npt.assert_array_equal(cloud.color, some_colors())
    if kind.startswith("la"):
        npt.assert_array_equal(cloud.tree_id, np.arange(200) % 3)
        npt.assert_array_equal(cloud.is_wood, np.arange(200) % 2 == 1)
        npt.assert_array_equal(cloud.intensity, np.arange(200) + 1)
        assert any("treeID was read as the number of the tree (3 different)" in note for note in cloud.notes)
    if kind == "npy-records":
        npt.assert_array_equal(cloud.tree_id, np.arange(200) % 3)


@pytest.mark.parametrize("kind", FORMATS)
def test_blocks_do_not_matter(tmp_path, kind, monkeypatch):
    if kind == "e57":
        pytest.importorskip("pye57")
    path = write_scan(tmp_path, kind, some_points())
    whole = recon.read_cloud(path, max_points=50)
    for module in ("e57", "las", "npy", "pcd", "ply", "text"):
        monkeypatch.setattr(f"recon.formats.{module}.CHUNK", 17)
    monkeypatch.setattr("recon.formats.text.BLOCK", 256)
    monkeypatch.setattr("recon.thinning.SPARE_POINTS", 0)
    parts = recon.read_cloud(path, max_points=50)
    npt.assert_array_equal(parts.xyz, whole.xyz)
    for name in ("color", "intensity", "tree_id", "is_wood"):
        npt.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert parts.n_read == 200 and parts.n_points <= 50
    assert any("200 points were thinned to" in note for note in parts.notes)


@pytest.mark.parametrize("kind", ["text", "ply-little", "las", "laz14", "pcd-packed", "npy"])
def test_map_coordinates_keep_their_millimetres(tmp_path, kind):
    shift = np.array([1_234_567.0, 7_654_321.0, 1000.0])
    xyz = some_points() + shift
    if kind in ("las", "laz14"):
        path = tmp_path / f"scan.{kind[:3]}"
        fourth = kind.endswith("14")
        write_las(
            path, xyz, offset=shift, version="1.4" if fourth else "1.2", point_format=6 if fourth else 3
        )
    else:
        path = write_scan(tmp_path, kind, xyz)
    cloud = recon.read_cloud(path)
    npt.assert_allclose(cloud.xyz + (cloud.origin - shift), some_points(), atol=1e-6)
    assert np.abs(cloud.xyz).max() < 11


# PLY


def test_ply_mesh_is_told_from_a_scan(tmp_path):
    path = tmp_path / "mesh.ply"
    mesh = ply_bytes(some_points(), "ascii").replace(
        b"end_header\n", b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(mesh + b"3 0 1 2\n")
    with pytest.raises(InputError, match="this PLY is a mesh of 1 faces, not a scan.*as_points"):
        recon.read_cloud(path)
    cloud = recon.read_cloud(path, as_points=True)
    npt.assert_allclose(world(cloud), some_points(), atol=1e-9)
    assert "the vertices of a mesh of 1 faces were read as points" in cloud.notes


@pytest.mark.parametrize("kind", ["ascii", "binary_big_endian", "binary_little_endian"])
def test_ply_vertices_may_come_last(tmp_path, kind):
    data = ply_bytes(some_points(), kind)
    head, body = data.split(b"end_header\n", 1)
    first, rest = head.split(b"element vertex")
    big = ">" if "big" in kind else "<"
    lists = (
        b"2 7 8 1.5\n"
        if kind == "ascii"
        else b"\x02" + np.array([7, 8], big + "i4").tobytes() + np.array([1.5], big + "f8").tobytes()
    )
    extra = b"element odd 1\nproperty list uchar int them\nproperty double it\n"
    path = tmp_path / "scan.ply"
    path.write_bytes(first + extra + b"element vertex" + rest + b"end_header\n" + lists + body)
    npt.assert_allclose(world(recon.read_cloud(path)), some_points(), atol=1e-9)


def test_ply_by_another_writer(tmp_path):
    plyfile = pytest.importorskip("plyfile")
    table = np.zeros(
        200, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("scalar_TreeID", "f4"), ("scalar_leaf", "f4")]
    )
    table["x"], table["y"], table["z"] = some_points().T
    table["scalar_TreeID"], table["scalar_leaf"] = np.arange(200) % 4, np.arange(200) % 2
    path = tmp_path / "scan.ply"
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")], byte_order=">").write(path)
    cloud = recon.read_cloud(path)
    npt.assert_allclose(world(cloud), some_points(), atol=1e-6)
    npt.assert_array_equal(cloud.tree_id, np.arange(200) % 4)
    npt.assert_array_equal(cloud.is_wood, np.arange(200) % 2 == 0)


# LAS


def test_las_keeps_its_epsg(tmp_path):
    path = tmp_path / "scan.las"
    write_las(path, some_points(), epsg=25832)
    assert recon.read_cloud(path).epsg == 25832


def test_las_wkt_names_epsg_and_feet():
    from recon.formats.las_header import LasHeader, _read_wkt

    header = LasHeader(0, 0, 4, 6, 30, 0, *[np.zeros(3)] * 4)
    _read_wkt(
        'COMPD_CS["x",PROJCS["NAD83 / Oregon",GEOGCS["NAD83",UNIT["degree",0.017],AUTHORITY["EPSG","4269"]],'
        'UNIT["foot",0.3048],AUTHORITY["EPSG","2992"]],VERT_CS["h",UNIT["metre",1],AUTHORITY["EPSG","5703"]]]',
        header,
    )
    assert (header.epsg, header.unit, header.is_geographic) == (2992, "ft", False)
    _read_wkt('GEOGCS["WGS 84",UNIT["degree",0.017],AUTHORITY["EPSG","4326"]]\0', header)
    assert (header.epsg, header.is_geographic) == (4326, True)


@pytest.mark.parametrize("name", ["scan.las", "scan.laz"])
@pytest.mark.parametrize("version, point_format, at, code", [("1.2", 1, 107, "<I"), ("1.4", 6, 247, "<Q")])
@pytest.mark.parametrize("declared", [10**9, 10**12])
def test_las_that_declares_too_many_points(tmp_path, name, version, point_format, at, code, declared):
    import struct

    if code == "<I" and declared > 2**32:
        declared = 2**32 - 1
    path = tmp_path / name
    write_las(path, some_points(), version=version, point_format=point_format)
    raw = bytearray(path.read_bytes())
    struct.pack_into(code, raw, at, declared)
    path.write_bytes(raw)
    start = time.perf_counter()
    cloud = recon.read_cloud(path)
    assert 198 <= cloud.n_points <= 200
    npt.assert_allclose(world(cloud), some_points()[: cloud.n_points], atol=1e-9)
    assert any(f"the header declares {declared} points" in note for note in cloud.notes)
    assert time.perf_counter() - start < 5


def test_las_that_declares_too_few_points_or_is_cut(tmp_path):
    import struct

    path = tmp_path / "scan.las"
    write_las(path, some_points(), point_format=1)
    raw = bytearray(path.read_bytes())
    struct.pack_into("<I", raw, 107, 20)
    path.write_bytes(raw)
    cloud = recon.read_cloud(path)
    assert cloud.n_points == 200
    assert "the header declares 20 points, but the file holds 200; all were read" in cloud.notes
    struct.pack_into("<I", raw, 107, 200)
    path.write_bytes(raw[: -28 * 50 - 3])
    cloud = recon.read_cloud(path)
    npt.assert_allclose(world(cloud), some_points()[:149], atol=1e-9)
    assert "the header declares 200 points, but the file holds 149; those were read" in cloud.notes


def test_laz_that_declares_too_few_points(tmp_path):
    import struct

    path = tmp_path / "scan.laz"
    write_las(path, some_points(), version="1.4", point_format=6)
    raw = bytearray(path.read_bytes())
    struct.pack_into("<Q", raw, 247, 20)
    path.write_bytes(raw)
    cloud = recon.read_cloud(path)
    npt.assert_allclose(world(cloud), some_points(), atol=1e-9)
    assert "the header declares 20 points, but the file holds 200; all were read" in cloud.notes


def test_las_that_names_a_dimension_twice(tmp_path):
    path = tmp_path / "scan.las"
    write_las(
        path,
        some_points(),
        extra={"one": np.zeros(200, "f4"), "two": np.zeros(200, "u2"), "tree_id": np.arange(200, dtype="i4")},
    )
    path.write_bytes(path.read_bytes().replace(b"two\0", b"one\0"))
    npt.assert_array_equal(recon.read_cloud(path).tree_id, np.arange(200))


def test_las_noise_is_left_out_unless_it_is_most(tmp_path):
    import laspy

    path = tmp_path / "scan.las"
    write_las(path, some_points())
    las = laspy.read(path)
    las.classification[:10] = 7
    las.write(path)
    cloud = recon.read_cloud(path)
    npt.assert_allclose(world(cloud), some_points()[10:], atol=1e-9)
    assert cloud.n_read == 200
    assert "10 points that the file marks as noise or withheld were left out" in cloud.notes
    las.classification[:] = 7
    las.write(path)
    assert recon.read_cloud(path).n_points == 200


def test_degrees_are_refused(tmp_path):
    path = tmp_path / "scan.las"
    write_las(path, some_points() * [1e-3, 1e-3, 1] + [10, 50, 0])
    raw = path.read_bytes()
    from recon.formats import las

    original = las.read_header

    def geographic(file, path):
        header = original(file, path)
        header.is_geographic, header.epsg = True, 4326
        return header

    las.read_header = geographic
    try:
        with pytest.raises(InputError, match=r"the coordinates are degrees \(EPSG 4326\). Project"):
            recon.read_cloud(path)
    finally:
        las.read_header = original
    assert raw


# PCD


def test_lzf_matches_are_followed():
    from recon.formats._lzf_kernels import lzf_decode

    packed = np.frombuffer(lzf_literal(b"abc") + bytes([0x60, 2]) + bytes([0xE0, 1, 0]), np.uint8)
    out = np.zeros(18, np.uint8)
    assert lzf_decode(packed, out) == 18  # 3 literals, 5 from 3 back, 10 from 1 back
    assert out.tobytes() == b"abcab" + b"cab" + b"b" * 10
    assert lzf_decode(packed, out[:17]) == -1
    assert lzf_decode(packed[:-1], out) == -1
    assert lzf_decode(np.array([0x60, 0], np.uint8), out) == -1  # refers to before the beginning


def test_pcd_by_another_writer(tmp_path):
    o3d = pytest.importorskip("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(some_points()))
    cloud.colors = o3d.utility.Vector3dVector(some_colors() / 255.0)
    for options in ({"write_ascii": True}, {}, {"compressed": True}):
        path = tmp_path / "scan.pcd"
        o3d.io.write_point_cloud(str(path), cloud, **options)
        back = recon.read_cloud(path)
        npt.assert_allclose(world(back), some_points(), atol=1e-6)
        npt.assert_array_equal(back.color, some_colors())


# Speed and memory


def test_a_text_of_a_million_lines_takes_seconds(tmp_path):
    line = b"123.456 234.567 345.678\n"
    path = tmp_path / "scan.xyz"
    path.write_bytes(b"0 0 0\n" + line * 300_000)
    recon.read_cloud(path)
    start = time.process_time()
    assert recon.read_cloud(path).n_read == 300_001
    assert time.process_time() - start < 3  # a tenth of it is usual


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path):
    path = tmp_path / "scan.xyz"
    np.savetxt(path, some_points())
    path.chmod(0)
    with pytest.raises(InputError, match="the file may not be read. Check its permissions"):
        recon.read_cloud(path)


def test_no_permission_as_told_by_the_system(tmp_path, monkeypatch):
    path = tmp_path / "scan.xyz"
    np.savetxt(path, some_points())

    def refuse(*_args, **_named):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(InputError, match="the file may not be read. Check its permissions"):
        recon.read_cloud(path)


def test_e57_without_its_package(tmp_path, monkeypatch):
    import sys

    path = tmp_path / "scan.e57"
    path.write_bytes(b"ASTM-E57" + bytes(100))
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(InputError, match=r'pip install "sapwood\[e57\]"'):
        recon.read_cloud(path)


def test_e57_scans_are_put_together(tmp_path):
    pye57 = pytest.importorskip("pye57")
    xyz = some_points()
    path = tmp_path / "two.e57"
    file = pye57.E57(str(path), mode="w")
    for part, shift in ((xyz[:90], 0.0), (xyz[90:], 50.0)):
        data = {f"cartesian{axis}": part[:, i].copy() for i, axis in enumerate("XYZ")}
        file.write_scan_raw(data, translation=np.array([shift, 0, 0]), rotation=np.array([1.0, 0, 0, 0]))
    file.close()
    cloud = recon.read_cloud(path)
    npt.assert_allclose(
        world(cloud), xyz + np.r_[np.zeros(90), np.full(110, 50)][:, None] * [1, 0, 0], atol=1e-9
    )
    assert "2 scans of the file were put together in its common frame" in cloud.notes
    write_e57(path, xyz)
    assert recon.read_cloud(path).n_points == 200
    assert len(pcd_bytes(xyz, "binary")) > 200
