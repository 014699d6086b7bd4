"""Small scan files of every format, written byte by byte or by other people's writers."""

from __future__ import annotations

import struct

import numpy as np

FORMATS = (
    "text", "csv", "ply-ascii", "ply-little", "ply-big", "las", "las14", "laz", "laz14",
    "pcd-ascii", "pcd-binary", "pcd-packed", "npy", "npy-records", "e57",
)  # fmt: skip


def some_points(n: int = 200, seed: int = 0) -> np.ndarray:
    """Points of a made-up crown on whole millimetres, so that every format holds them."""
    return np.random.default_rng(seed).uniform([0, 0, 0], [3, 3, 9], (n, 3)).round(3)


def some_colors(n: int = 200) -> np.ndarray:
    """Colours (n, 3) uint8 that differ from point to point."""
    return np.random.default_rng(1).integers(0, 256, (n, 3)).astype(np.uint8)


def ply_bytes(xyz: np.ndarray, kind: str, color: np.ndarray | None = None) -> bytes:
    """A PLY file with an unused property between, and colours if given."""
    names = "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) if color is not None else ""
    head = (
        f"ply\nformat {kind} 1.0\ncomment made up\nelement vertex {len(xyz)}\nproperty double x\n"
        f"property double y\nproperty float odd\nproperty double z\n{names}end_header\n"
    ).encode()
    if kind == "ascii":
        rows = []
        for i, (x, y, z) in enumerate(xyz):
            tail = " {} {} {}".format(*color[i]) if color is not None else ""
            rows.append(f"{x:.3f} {y:.3f} 0.5 {z:.3f}{tail}\n")
        return head + "".join(rows).encode()
    order = "<" if "little" in kind else ">"
    fields = [("x", order + "f8"), ("y", order + "f8"), ("odd", order + "f4"), ("z", order + "f8")]
    table = np.zeros(len(xyz), fields + ([("c", "u1", 3)] if color is not None else []))
    table["x"], table["y"], table["z"] = xyz.T
    if color is not None:
        table["c"] = color
    return head + table.tobytes()


def lzf_literal(data: bytes) -> bytes:
    """LZF without any match: runs of at most 32 literal bytes."""
    return b"".join(bytes([len(data[i : i + 32]) - 1]) + data[i : i + 32] for i in range(0, len(data), 32))


def pcd_bytes(xyz: np.ndarray, kind: str, color: np.ndarray | None = None) -> bytes:
    """A PCD file; the colour packed into a float as PCL does."""
    n = len(xyz)
    names, size, type_, count = "x y z", "8 8 8", "F F F", "1 1 1"
    if color is not None:
        names, size, type_, count = names + " rgb", size + " 4", type_ + " F", count + " 1"
    head = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {names}\nSIZE {size}\n"
        f"TYPE {type_}\nCOUNT {count}\nWIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {kind}\n"
    ).encode()
    table = np.zeros(
        n, [("x", "<f8"), ("y", "<f8"), ("z", "<f8")] + ([("rgb", "<u4")] if color is not None else [])
    )
    table["x"], table["y"], table["z"] = xyz.T
    if color is not None:
        c = color.astype(np.uint32)
        table["rgb"] = c[:, 0] << 16 | c[:, 1] << 8 | c[:, 2]
    if kind == "ascii":
        rows = []
        for row in table:
            tail = f" {np.uint32(row['rgb']).view(np.float32):.9g}" if color is not None else ""
            rows.append(f"{row['x']:.3f} {row['y']:.3f} {row['z']:.3f}{tail}\n")
        return head + "".join(rows).encode()
    if kind == "binary":
        return head + table.tobytes()
    raw = b"".join(np.ascontiguousarray(table[name]).tobytes() for name in table.dtype.names)
    packed = lzf_literal(raw)
    return head + struct.pack("<II", len(packed), len(raw)) + packed


def write_las(path, xyz, *, version="1.2", point_format=3, color=None, extra=None, epsg=None, offset=None):
    """A LAS or LAZ file (by the name of `path`) on a millimetre grid."""
    import laspy

    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales = [0.001] * 3
    header.offsets = np.zeros(3) if offset is None else offset
    for name, values in (extra or {}).items():
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=values.dtype))
    if epsg is not None:
        from laspy.vlrs.known import GeoKeyDirectoryVlr, GeoKeyEntryStruct

        directory = GeoKeyDirectoryVlr()
        directory.geo_keys_header.number_of_keys = 1
        directory.geo_keys = [GeoKeyEntryStruct(id=3072, tiff_tag_location=0, count=1, value_offset=epsg)]
        header.vlrs.append(directory)
    las = laspy.LasData(header)
    las.xyz = xyz
    las.intensity = np.arange(len(xyz)) % 1000 + 1
    if color is not None:
        las.red, las.green, las.blue = (color.astype(np.uint16) * 257).T
    for name, values in (extra or {}).items():
        las[name] = values
    las.write(path)


def write_e57(path, xyz, color=None):
    """An E57 file with one scan, turned by a quarter about z and shifted."""
    import pye57

    data = {"cartesianX": xyz[:, 0].copy(), "cartesianY": xyz[:, 1].copy(), "cartesianZ": xyz[:, 2].copy()}
    if color is not None:
        data.update({f"color{name}": color[:, i].copy() for i, name in enumerate(("Red", "Green", "Blue"))})
    half = np.sqrt(0.5)
    file = pye57.E57(str(path), mode="w")
    file.write_scan_raw(
        data, rotation=np.array([half, 0, 0, half]), translation=np.array([100.0, 200.0, 0.0])
    )
    file.close()


def e57_world(xyz: np.ndarray) -> np.ndarray:
    """Where :func:`write_e57` puts `xyz`."""
    return np.stack([100 - xyz[:, 1], 200 + xyz[:, 0], xyz[:, 2]], axis=1)


def write_scan(folder, kind: str, xyz: np.ndarray):
    """Write `xyz` in the format `kind` (one of FORMATS); the path."""
    path = folder / f"{kind}.dat"
    color = some_colors(len(xyz))
    if kind == "text":
        np.savetxt(path, xyz, fmt="%.3f")
    elif kind == "csv":
        np.savetxt(path, np.c_[xyz, color], fmt="%.3f", delimiter=",", header="x,y,z,r,g,b", comments="")
    elif kind.startswith("ply"):
        name = {"ply-ascii": "ascii", "ply-little": "binary_little_endian", "ply-big": "binary_big_endian"}[
            kind
        ]
        path.write_bytes(ply_bytes(xyz, name, color))
    elif kind.startswith("pcd"):
        name = {"pcd-ascii": "ascii", "pcd-binary": "binary", "pcd-packed": "binary_compressed"}[kind]
        path.write_bytes(pcd_bytes(xyz, name, color))
    elif kind.startswith("la"):
        real = folder / f"{kind}.{kind[:3]}"
        new = kind.endswith("14")
        extra = {
            "treeID": (np.arange(len(xyz)) % 3).astype(np.int32),
            "wood": (np.arange(len(xyz)) % 2).astype(np.uint8),
        }
        write_las(
            real, xyz, version="1.4" if new else "1.2", point_format=7 if new else 3, color=color, extra=extra
        )
        real.rename(path)
    elif kind == "npy":
        with open(path, "wb") as file:
            np.save(file, xyz)
    elif kind == "npy-records":
        table = np.zeros(len(xyz), [("x", "f8"), ("y", "f8"), ("z", "f8"), ("tree_id", "i4")])
        table["x"], table["y"], table["z"] = xyz.T
        table["tree_id"] = np.arange(len(xyz)) % 3
        with open(path, "wb") as file:
            np.save(file, table)
    else:
        write_e57(path, xyz, color)
    return path
