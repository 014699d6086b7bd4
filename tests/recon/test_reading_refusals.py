"""What is no scan is refused in one line that says what it is and what to do."""

import os
import struct
import time
import tracemalloc

import numpy as np
import pytest
from scan_files import pcd_bytes, ply_bytes, some_points

import recon
from treegraph.errors import FormatError, InputError

XYZ = some_points(20)
PLY = ply_bytes(XYZ, "binary_little_endian")
FACES = b"element face 7\nproperty list uchar int i\nend_header"
PCD = pcd_bytes(XYZ, "binary")
HUGE = str(10**12).encode()


def npy(shape, descr="'<f8'", data=b"\0" * 480):
    head = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


REFUSED = {
    "empty": (b"", "the file is empty. Export the scan again"),
    "JPEG": (b"\xff\xd8\xff\xe0" + bytes(100), "this is a JPEG picture, not a scan. Give a point cloud"),
    "PNG": (b"\x89PNG\r\n\x1a\n" + bytes(100), "this is a PNG picture"),
    "GLB": (b"glTF\x02\0\0\0" + bytes(100), r"this is a glTF model \(GLB\)"),
    "zip": (b"PK\x03\x04" + bytes(100), "this is a zip archive, not a scan. Unpack it"),
    "gzip": (b"\x1f\x8b" + bytes(100), "this is gzip-compressed"),
    "lobes": (b"LOBES" + bytes(100), "this is a Sapwood tree"),
    "HTML": (b"<!DOCTYPE html>\n<html></html>", r"this is a web page \(HTML\).*get the file again"),
    "XML": (b'<?xml version="1.0"?>\n<a/>', "this is an XML file"),
    "JSON": (b'{"a": [1, 2, 3]}', "this is a JSON file"),
    "OBJ": (b"# a\nv 1 2 3\nv 2 3 4\nv 3 4 5\nf 1 2 3\n", "this is a Wavefront OBJ model, a mesh"),
    "grid": (b"NCOLS 3\nNROWS 2\nXLLCORNER 1\nYLLCORNER 2\n1 2 3\n4 5 6\n", "this is an ESRI ASCII grid"),
    "PTX": (b"2\n2\n" + b"0 0 0\n" * 4 + b"1 0 0 0\n" * 4 + b"1 2 3 0.5\n" * 4, "this is a PTX file"),
    "bytes": (bytes(range(256)) * 4, "neither points that can be read nor text"),
    "three points": (b"1 2 3\n4 5 6\n7 8 9\n", "3 usable points are too few for a tree"),
    "one place": (b"1 2 3\n" * 50, "all 50 points are the same"),
    "NaN only": (b"nan nan nan\n" * 3 + b"1 2 3\n" + b"nan nan nan\n" * 6, "usable points are too few"),
    "LAS cut in the header": (b"LASF" + bytes(100), "the LAS header is cut off after 104 bytes"),
    "LAS of zeros": (b"LASF" + bytes(400), "the LAS header gives a point 0 bytes"),
    "PLY without end": (PLY[:60], "the PLY header has no end_header line"),
    "PLY without vertices": (b"ply\nformat ascii 1.0\nelement a 0\nend_header\n", "this PLY has no vertices"),
    "PLY of none": (PLY.replace(b"vertex 20", b"vertex 0"), "this PLY declares no points"),
    "PLY without x": (PLY.replace(b"double x", b"double a"), "the PLY vertices have no x, y and z"),
    "PLY of an odd type": (PLY.replace(b"float odd", b"quad odd"), "a property of unknown type"),
    "PLY with an odd line": (PLY.replace(b"comment", b"hello"), "a line that is not understood"),
    "PLY with a superscript": (PLY.replace(b"vertex 20", b"vertex \xb2"), "a line that is not understood"),
    "PLY of no kind": (PLY.replace(b"format", b"comment"), "does not say ascii"),
    "PLY cut after the header": (PLY[: PLY.index(b"end_header") + 11], "declares 20 points and holds none"),
    "PLY with lists": (PLY.replace(b"float odd", b"list uchar int odd"), "the PLY vertices hold lists"),
    "PLY mesh": (PLY.replace(b"end_header", FACES), "mesh of 7 faces"),
    "PCD without data": (PCD.replace(b"DATA", b"DATE"), "the PCD header has no DATA line"),
    "PCD of an odd kind": (PCD.replace(b"DATA binary", b"DATA morse"), "not ascii, binary or binary_"),
    "PCD mismatch": (PCD.replace(b"SIZE 8 8 8", b"SIZE 8 8"), "of the PCD header do not match"),
    "PCD size": (PCD.replace(b"SIZE 8 8 8", b"SIZE 8 8 7"), "has the unknown type F7"),
    "PCD count": (PCD.replace(b"POINTS 20", b"POINTS -1"), "must be whole numbers, got '-1'"),
    "PCD of none": (PCD.replace(b"POINTS 20", b"POINTS 0"), "the PCD header declares no points"),
    "PCD without x": (PCD.replace(b"FIELDS x", b"FIELDS a"), "the PCD fields have no x, y and z"),
    "PCD cut": (PCD[: PCD.index(b"DATA binary\n") + 12], "declares 20 points and holds none"),
    "PCD packed and cut": (pcd_bytes(XYZ, "binary_compressed")[:-9], "the compressed PCD data are cut off"),
    "NPY damaged": (npy("(20,)", "'<f8' +"), "the header of the .npy file is damaged"),
    "NPY objects": (npy("(20, 3)", "'|O'"), "must hold plain numbers"),
    "NPY flat": (npy("(60,)"), r"must hold numbers of shape \(n, 3\), got float64 of shape \(60,\)"),
    "NPY cut": (npy("(30, 3)"), "needs 720 bytes, but the file has 480"),
    "NPY of none": (npy("(0, 3)"), "the array holds no points"),
    "NPY fields": (npy("(20,)", "[('a', '<f8'), ('b', '<f8'), ('c', '<f8')]"), "no fields x, y and z"),
    "E57 damaged": (b"ASTM-E57" + bytes(200), "the E57 file cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_scan(tmp_path, case):
    if case.startswith("E57"):
        pytest.importorskip("pye57")
    data, message = REFUSED[case]
    path = tmp_path / "scan.las"  # the name tells nothing
    path.write_bytes(data)
    with pytest.raises((InputError, FormatError), match=message) as error:
        recon.read_cloud(path)
    text = str(error.value)
    assert text.startswith(f"{path}: ") and "\n" not in text


ODD = b"element odd " + HUGE + b"\nproperty int a\nelement vertex"
LISTS = b"element odd " + HUGE + b"\nproperty list int int a\nelement vertex"
HOSTILE = {
    "PLY": PLY.replace(b"vertex 20", b"vertex " + HUGE),
    "PLY ascii": ply_bytes(XYZ, "ascii").replace(b"vertex 20", b"vertex " + HUGE),
    "PLY before": PLY.replace(b"element vertex", ODD),
    "PLY lists before": PLY.replace(b"element vertex", LISTS),
    "PCD": PCD.replace(b"POINTS 20", b"POINTS " + HUGE),
    "PCD ascii": pcd_bytes(XYZ, "ascii").replace(b"POINTS 20", b"POINTS " + HUGE),
    "PCD packed": pcd_bytes(XYZ, "binary_compressed").replace(b"POINTS 20", b"POINTS " + HUGE),
    "PCD repeats": PCD.replace(b"COUNT 1", b"COUNT " + HUGE),
    "NPY": npy("(10**12, 3)".replace("10**12", HUGE.decode())),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_counts_of_a_million_millions_allocate_nothing(tmp_path, case):
    path = tmp_path / "scan"
    path.write_bytes(HOSTILE[case])
    for _ in range(2):  # the second time nothing is compiled
        tracemalloc.start()
        start = time.perf_counter()
        try:
            cloud = recon.read_cloud(path)
        except (InputError, FormatError) as error:
            assert "\n" not in str(error)
        else:
            assert cloud.n_points <= 20
            assert any(f"declares {10**12} points" in note for note in cloud.notes)
        seconds, peak = time.perf_counter() - start, tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 50e6 and seconds < 2


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match="no.xyz: there is no such file. Check the path"):
        recon.read_cloud(tmp_path / "no.xyz")
    with pytest.raises(InputError, match="cannot be the name of a file"):
        recon.read_cloud("a\0b")


def test_folder_and_pipe(tmp_path):
    with pytest.raises(InputError, match="this is a folder; name a scan in it"):
        recon.read_cloud(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="this is not a regular file"):
        recon.read_cloud(tmp_path / "pipe")


def test_arguments(tmp_path):
    with pytest.raises(InputError, match="max_points must be at least 4, got 3"):
        recon.read_cloud(tmp_path, max_points=3)
    with pytest.raises(InputError, match="decimal must be '.' or ',', got ';'"):
        recon.read_cloud(tmp_path, decimal=";")


def test_nan_rows_are_dropped_and_told(tmp_path):
    xyz = XYZ.copy()
    xyz[3, 1], xyz[7] = np.nan, np.inf
    path = tmp_path / "scan.ply"
    path.write_bytes(ply_bytes(xyz, "binary_big_endian"))
    cloud = recon.read_cloud(path)
    assert (cloud.n_points, cloud.n_read) == (18, 20)
    assert "2 of 20 points have no finite coordinates and were left out" in cloud.notes
