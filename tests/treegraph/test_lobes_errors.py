"""Every reason for which a tree is not written or a .lobes file is not read, and what is then said."""

import struct
import tracemalloc

import numpy as np
import pytest
import zstandard

from tests.corpus import TREES, realistic_cluster_tree
from tests.treegraph.lobes_forge import checksummed, forge, put_together, take_apart, varint
from treegraph import (
    DEFAULT_ALLOMETRY,
    Cluster,
    ClusterTree,
    FormatError,
    TreeError,
    TreeGraph,
    decode_lobes,
    encode_lobes,
    read_lobes,
)
from treegraph import lobes as lobes_module
from treegraph.lobes import LobesLimits

NAN = struct.pack("<d", float("nan"))


def small_tree(**changes):
    """Six nodes with a fork, one tetrahedron with two seeds."""
    graph = TreeGraph(
        [-1, 0, 1, 0, 3, 3],
        [(0, 0, 0), (0, 0, 1), (0, 0, 2), (1, 0, 1), (2, 0, 1), (1, 1, 1)],
        [0.2, 0.1, 0.05, 0.1, np.nan, 0.05],
        {"measured": [True, True, False, True, False, False]},
    )
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    cluster = Cluster(corners, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], [2, 4], 90.0, 15)
    parts = {
        "graph": graph,
        "clusters": (cluster,),
        "species": "Pine",
        "allometry": DEFAULT_ALLOMETRY,
        "origin": (1, 2, 3),
    }
    return ClusterTree(**(parts | changes))


DATA = encode_lobes(small_tree())
HEADER, NAME, RAW = take_apart(DATA)
FRAME = zstandard.ZstdCompressor(write_content_size=False)


def sized_frame(raw):
    return zstandard.ZstdCompressor(write_content_size=True).compress(raw)


def table(*rows):
    """The section ``clusters``, six planes of one number for each cluster."""
    return b"".join(bytes(column) for column in zip(*rows, strict=True))


def wide_table(density):
    """The cluster of DATA with another code of its density, in three planes."""
    row = [4, 4, 2, 15, 0, density]
    return b"".join(bytes((value >> shift) & 255 for value in row) for shift in (0, 8, 16))


def planes(values, n_planes):
    return b"".join(bytes((value >> 8 * k) & 255 for value in values) for k in range(n_planes))


def test_the_tree_that_is_broken_here_is_sound():
    assert decode_lobes(forge(DATA)).clusters[0].n_points == 15
    assert RAW["clusters"] == wide_table(int(np.float32(90).view(np.uint32)) >> 8)


WRONG_FILES = {
    "empty": (b"", r"must begin with b'\\x89LOBES\\r\\n', got b''"),
    "another kind": (b"PK\x03\x04" * 100, r"must begin with .*, got b'PK"),
    "line ends changed": (DATA.replace(b"\r\n", b"\n", 1), r"must begin with .*, got b'\\x89LOBES\\n"),
    "header cut": (DATA[:50], r"must be at least 102 bytes long, got 50; it has been cut short"),
    "version": (forge(DATA, header={"version": 2}), r"must be of version 1, got 2; read it with a newer"),
    "cut": (DATA[:-1], rf"must be {len(DATA)} bytes long by its header, got {len(DATA) - 1}"),
    "longer": (DATA + b"x", rf"must be {len(DATA)} bytes long by its header, got {len(DATA) + 1}"),
    "bit": (
        DATA[:70] + bytes([DATA[70] ^ 1]) + DATA[71:],
        r"checksum must be [0-9a-f]{8} .*, got [0-9a-f]{8}",
    ),
    "flags": (forge(DATA, header={"flags": 3}), r"flags must be 0 or 1, got 3"),
    "no nodes": (forge(DATA, header={"n_nodes": 0}), r"at least one node, got 0"),
    "nodes": (forge(DATA, header={"n_nodes": 2**20 + 1}), r"n_nodes must be at most 1048576, got 1048577"),
    "clusters": (forge(DATA, header={"n_clusters": 2**32 - 1}), r"n_clusters must be at most 16384, got"),
    "vertices": (forge(DATA, header={"n_vertices": 2**31}), r"n_vertices must be at most 262144, got"),
    "faces": (forge(DATA, header={"n_faces": 2**31}), r"n_faces must be at most 262144, got"),
    "seeds": (forge(DATA, header={"n_seeds": 2**31}), r"n_seeds must be at most 1048576, got"),
    "coarse grid": (forge(DATA, header={"exponent": 9}), r"exponent of the grid must be 10 to 20, got 9"),
    "fine grid": (forge(DATA, header={"exponent": 21}), r"exponent of the grid must be 10 to 20, got 21"),
    "name too long": (
        put_together({**HEADER, "name_length": 255}, b"", dict.fromkeys(RAW, b"")),
        r"name of the species must end within the file, got 255 bytes",
    ),
    "name not UTF-8": (
        forge(DATA, name=b"\xff\xfe", header={"name_length": 2}),
        r"must be UTF-8, got b'\\xff\\xfe'",
    ),
    "origin": (
        forge(DATA, header={"y": float("inf")}),
        r"no valid tree: origin must be three finite numbers",
    ),
    "epsg": (forge(DATA, header={"epsg": 2**31}), r"no valid tree: epsg must be a positive code"),
    "beta": (forge(DATA, header={"beta": 0.5}), r"no valid tree: beta must be a finite number >= 1"),
    "gamma": (forge(DATA, header={"gamma": float("nan")}), r"no valid tree: gamma must be a positive"),
    "f_s": (forge(DATA, header={"f_s": 1.5}), r"no valid tree: f_s must be above 0 and at most 1"),
    "d_root": (forge(DATA, header={"d_root": -1.0}), r"no valid tree: d_root must be a positive diameter"),
    # Sections
    "table cut": (
        checksummed(
            DATA[:12] + struct.pack("<I", 104) + DATA[16:41] + b"\0" + DATA[42:98] + b"\x01\x01" + b"????"
        ),
        r"the table of sections ends within a number",
    ),
    "long number": (
        checksummed(
            DATA[:12] + struct.pack("<I", 112) + DATA[16:41] + b"\0" + DATA[42:98] + b"\xff" * 10 + b"????"
        ),
        r"a number in the table of sections must take at most 5 bytes",
    ),
    "too much declared": (
        forge(DATA, bodies={"positions": (6 * 18 + 1, RAW["positions"])}),
        r"section 'positions' must hold at most 108 bytes by the counts in the header, but declares 109",
    ),
    "stored too long": (
        forge(DATA, bodies={"radii": (6, b"x" * 7)}),
        r"section 'radii' must not be stored in more bytes than it holds \(6\), got 7",
    ),
    "left over": (
        (lambda data: checksummed(data[:12] + struct.pack("<I", len(data) + 3) + data[16:-4] + b"abc????"))(
            DATA
        ),
        r"sections must fill the rest of the file \(\d+ bytes\), but declare \d+",
    ),
    "not zstd": (
        forge(DATA, bodies={"positions": (36, b"x" * 30)}),
        r"section 'positions' must be a zstd frame that begins with b'\(\\xb5/\\xfd', got b'xxxx'",
    ),
    "skippable frame": (
        forge(DATA, bodies={"positions": (36, b"\x50\x2a\x4d\x18\x04\0\0\0abcd")}),
        r"section 'positions' must be a zstd frame",
    ),
    "broken zstd": (
        forge(DATA, bodies={"positions": (36, zstandard.FRAME_HEADER + b"\x00\x58" + b"\xff" * 9)}),
        r"section 'positions' cannot be decompressed \(.*\); the file is damaged",
    ),
    "frame says more": (
        forge(DATA, bodies={"positions": (36, sized_frame(bytes(2**24)).ljust(1)[:35])}),
        r"section 'positions' must decompress to 36 bytes, but its frame declares 16777216",
    ),
    "frame holds more": (
        forge(DATA, bodies={"positions": (36, FRAME.compress(bytes(2**20))[:35])}),
        r"section 'positions' (cannot be decompressed|must decompress to 36 bytes)",
    ),
    "frame holds less": (
        forge(DATA, bodies={"positions": (36, FRAME.compress(bytes(20)))}),
        r"section 'positions' must decompress to 36 bytes, got 20",
    ),
    "frame cut": (
        forge(DATA, bodies={"positions": (108, FRAME.compress(bytes(range(107)) + b"x")[:-10])}),
        r"section 'positions' (cannot be decompressed|must decompress to 108 bytes)",
    ),
    "bytes after the frame": (
        forge(DATA, bodies={"positions": (36, FRAME.compress(bytes(36)) + b"more")}),
        r"section 'positions' cannot be decompressed",
    ),
    "large window": (
        forge(DATA, bodies={"positions": (36, zstandard.FRAME_HEADER + b"\x00\xa0" + b"\x01\0\0")}),
        r"section 'positions' cannot be decompressed \(.*memory",
    ),
    # Graph
    "bits": (
        forge(DATA, starts=b""),
        r"section 'starts' must hold 1 bytes, one bit for each of 6 nodes, got 0",
    ),
    "spare bits": (
        forge(DATA, starts=bytes([RAW["starts"][0] | 64])),
        r"spare bits of section 'starts' must be 0",
    ),
    "measured": (forge(DATA, measured=b""), r"section 'measured' must hold 1 bytes"),
    "measured without flag": (
        forge(DATA, header={"flags": 0}),
        r"section 'measured' must hold at most 0 bytes",
    ),
    "planes": (
        forge(DATA, radii=b"x" * 7),
        r"section 'radii' must hold 0 to 6 bytes for each of its 6 values, got 7 bytes",
    ),
    "planes of nothing": (
        forge(DATA, starts=b"\0", jumps=b"abc"),
        r"section 'jumps' must hold 0 to 6 bytes for each of its 0 values, got 3 bytes",
    ),
    "jump to itself": (forge(DATA, jumps=b"\0\1"), r"node 3 must go back 1 to 3 nodes to its parent, got 0"),
    "jump too far": (forge(DATA, jumps=b"\1\6"), r"node 5 must go back 1 to 5 nodes to its parent, got 6"),
    "node too far": (
        forge(DATA, positions=planes([2**41] + [0] * 17, 6)),
        r"coordinates must be less than 1099511627776 steps, but node 0 is at",
    ),
    "radius below": (
        forge(DATA, radii=b"\1" + bytes(5)),
        r"code of a radius must be 0 to 8448, but node 0 has -1",
    ),
    "radius above": (
        forge(DATA, radii=planes([2 * 8449] + [0] * 5, 2)),
        r"code of a radius must be 0 to 8448, but node 0 has 8449",
    ),
    # Clusters
    "counts": (
        forge(DATA, header={"n_faces": 5}),
        r"must have \(4, 5, 2\) vertices, faces and seeds by the header, got \(4, 4, 2\)",
    ),
    "level": (
        forge(DATA, clusters=table([4, 4, 2, 15, 17, 0])),
        r"level of a cluster must be 0 to 16, got 17",
    ),
    "density infinite": (
        forge(DATA, clusters=wide_table(0x7F8000)),
        r"must be less than 0x7f8000 or 0x7fc000",
    ),
    "density negative": (
        forge(DATA, clusters=wide_table(0x800001)),
        r"code of a density must be .* got 0x800001",
    ),
    "seed": (forge(DATA, seeds=bytes([4, 8])), r"seeds must be nodes of the graph \(0 to 5\), got 6"),
    "seed negative": (
        forge(DATA, seeds=bytes([1, 2])),
        r"seeds must be nodes of the graph \(0 to 5\), got -1",
    ),
    "vertex away": (
        forge(DATA, vertices=planes([2**43] + [0] * 11, 6)),
        r"vertices must be less than 4398046511104 steps from where they are expected, got 4398046511104",
    ),
    "vertex too far": (
        forge(DATA, vertices=planes([2**42] + [0] * 11, 6)),
        r"coordinates must be less than 1099511627776 steps, but a vertex is at",
    ),
    "symbols short": (forge(DATA, symbols=RAW["symbols"][:-1]), r"'symbols' ends before the last face"),
    "symbols left": (
        forge(DATA, symbols=RAW["symbols"] + b"\0"),
        r"but 1 bytes of 'symbols' and 0 bytes of 'names'",
    ),
    "names short": (forge(DATA, names=RAW["names"][:-1]), r"section 'names' ends within a number"),
    "names left": (
        forge(DATA, names=RAW["names"] + b"\0"),
        r"but 0 bytes of 'symbols' and 1 bytes of 'names'",
    ),
    "names long": (
        forge(DATA, names=b"\x80" * 9),
        r"a number in section 'names' must take at most 5 bytes",
    ),
    "symbol": (forge(DATA, symbols=b"\5" + RAW["symbols"][1:]), r"symbol of a mesh must be 0 to 4, got 5"),
    "name of no vertex": (forge(DATA, names=b"\0\0\3"), r"name one of the 2 vertices before it, got the 3th"),
    "new vertex by name": (
        forge(DATA, symbols=b"\4" + RAW["symbols"][1:], names=b"\0\0\0\0"),
        r"name one of the 3 vertices before it, got the 0th",
    ),
    "too many vertices": (forge(DATA, symbols=b"\1\1\1"), r"must use at most its 4 vertices"),
    "no open edge": (
        # Faces (0, 0, 1) and (0, 1, 2): at gate (2, 1) no edge that leaves 1 was ever open.
        forge(DATA, names=b"\0\1\0\2\1\0", symbols=b"\2"),
        r"a face must lie at an open edge, but there is none",
    ),
}


@pytest.mark.parametrize("data, message", WRONG_FILES.values(), ids=WRONG_FILES)
def test_wrong_files(data, message):
    with pytest.raises(FormatError, match=message) as caught:
        decode_lobes(data)
    assert "\n" not in str(caught.value)


def test_file_is_named(tmp_path):
    path = tmp_path / "broken.lobes"
    path.write_bytes(DATA[:-1])
    with pytest.raises(FormatError, match=r"^broken\.lobes: the file must be \d+ bytes long"):
        read_lobes(path)


def test_a_long_file_is_not_read_whole(tmp_path):
    path = tmp_path / "long.lobes"
    path.write_bytes(DATA + bytes(10_000_000))
    tracemalloc.start()
    with pytest.raises(FormatError, match=r"at most 2000 bytes long, got 2001 or more"):
        read_lobes(path, limits=LobesLimits(n_bytes=2000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000


@pytest.mark.parametrize(
    "name, count", [("n_nodes", 6), ("n_clusters", 1), ("n_vertices", 4), ("n_faces", 4), ("n_seeds", 2)]
)
def test_own_limits(name, count):
    decode_lobes(DATA, limits=LobesLimits(**{name: count}))
    with pytest.raises(FormatError, match=rf"{name} must be at most {count - 1}, got {count}"):
        decode_lobes(DATA, limits=LobesLimits(**{name: count - 1}))


GIANTS = {
    "frame that declares a gigabyte": zstandard.FRAME_HEADER
    + b"\xa0"
    + struct.pack("<I", 2**30)
    + b"\x01\0\0",
    "frame that holds a gigabyte": zstandard.FRAME_HEADER
    + b"\x00\x58"
    + b"".join(((2**17 << 3) | 2 | (k == 8191)).to_bytes(3, "little") + b"\0" for k in range(8192)),
    "window of a gigabyte": zstandard.FRAME_HEADER + b"\x00\xa0" + b"\x03\0\0",
}


@pytest.mark.parametrize("frame", GIANTS.values(), ids=GIANTS)
def test_giants_are_not_unpacked(frame):
    import resource

    n = 2**16
    data = forge(DATA, header={"n_nodes": n}, bodies={"positions": (18 * n, frame)}, starts=bytes(n // 8))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FormatError):
        decode_lobes(data)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


# ----------------------------------------------------------------------------------------------- writing


def tree_of(position=(0, 0, 1), radius=0.1, **changes):
    return small_tree(graph=TreeGraph([-1], [position], [radius]), **({"clusters": ()} | changes))


def hull(vertices=((0, 0, 0),), density=1.0, n_points=1):
    return Cluster(np.reshape(vertices, (-1, 3)), np.zeros((0, 3), int), [0], density, n_points)


UNFIT = {
    "far node": (
        tree_of((0, 2.0**30, 0)),
        r"position must lie within 1073741824 m of the origin along each axis, but position\[0\] is .*; "
        r"1 of 1 break this. Move the tree with transform\(\)",
    ),
    "farthest node": (tree_of((0, 1e308, 0)), r"position must lie within 1073741824 m"),
    "far hull": (
        tree_of(clusters=(hull(), hull([(0, 0, 0), (1e18, 0, 0)]))),
        r"clusters\[1\]\.vertices must lie within 8589934592 m of the origin",
    ),
    "thick": (
        tree_of(radius=1e12),
        r"radius must be at most 2\.67911e\+08 m in a \.lobes file, but radius\[0\] is",
    ),
    "thickest": (tree_of(radius=1e308), r"radius must be at most"),
    "dense": (
        tree_of(clusters=(hull(density=1e39),)),
        r"clusters\[0\]\.density must be at most 2\*\*127 points",
    ),
    "many points": (
        tree_of(clusters=(hull(n_points=2**48),)),
        r"clusters\[0\]\.n_points must be less than 281474976710656, got 281474976710656",
    ),
    "long name": (tree_of(species="ä" * 128), r"species must take at most 255 bytes in UTF-8, got 256"),
    "broken name": (tree_of(species="\ud800"), r"species must be valid Unicode text, got '\\ud800'"),
    "measured of another type": (
        small_tree(graph=TREES["star"].replace(attribute={"measured": np.ones(41)})),
        r"'measured' must be one bool per node, got dtype float64 and shape \(41,\)",
    ),
    "measured of another shape": (
        small_tree(graph=TREES["star"].replace(attribute={"measured": np.ones((41, 2), bool)})),
        r"'measured' must be one bool per node, got dtype bool and shape \(41, 2\)",
    ),
    "many clusters": (
        tree_of(clusters=(hull(),) * (2**14 + 1)),
        r"n_clusters must be at most 16384 in a \.lobes file, got 16385; simplify the tree",
    ),
}


@pytest.mark.parametrize("tree, message", UNFIT.values(), ids=UNFIT)
def test_trees_that_do_not_fit(tree, message):
    with pytest.raises(TreeError, match=message):
        encode_lobes(tree)


@pytest.mark.parametrize("name", ["n_nodes", "n_vertices", "n_faces", "n_seeds", "n_bytes"])
def test_trees_that_are_too_large(name, monkeypatch):
    tree = realistic_cluster_tree(TREES["bush"], n_clusters=5)
    monkeypatch.setattr(lobes_module, "DEFAULT_LIMITS", LobesLimits(**{name: 9}))
    message = r"at most 9 bytes long, got" if name == "n_bytes" else rf"{name} must be at most 9 in a"
    with pytest.raises(TreeError, match=message):
        encode_lobes(tree)


def test_varint_of_the_forge():
    assert [varint(0), varint(127), varint(128), varint(300)] == [b"\0", b"\x7f", b"\x80\1", b"\xac\2"]
