"""Take .lobes files apart and put them together again, sound or not, always with a right checksum."""

import struct
import zlib

import zstandard

from tests.treegraph.lobes_reader import SECTIONS, read_sections

HEADER = "<8sHHIIIIIIIBB3d4d"
FIELDS = [
    "magic",
    "version",
    "flags",
    "size",
    "n_nodes",
    "n_clusters",
    "n_vertices",
    "n_faces",
    "n_seeds",
    "epsg",
    "exponent",
    "name_length",
    "x",
    "y",
    "z",
    "beta",
    "gamma",
    "f_s",
    "d_root",
]


def varint(value):
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def checksummed(data):
    """The same bytes with the right checksum at their end."""
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def take_apart(data):
    """Header fields, name of the species, raw sections."""
    header = dict(zip(FIELDS, struct.unpack_from(HEADER, data), strict=True))
    name_end = 98 + header["name_length"]
    return header, data[98:name_end], read_sections(data, name_end)


def put_together(header, name, sections, *, keep_size=False, bodies=None):
    """A whole file; `bodies` replaces what is stored of some sections, as (declared size, bytes)."""
    table, stored = b"", b""
    for section in SECTIONS:
        raw = sections[section]
        packed = zstandard.ZstdCompressor(level=1, write_content_size=False).compress(raw) if raw else raw
        size, body = (bodies or {}).get(section, (len(raw), min(raw, packed, key=len)))
        table += varint(size) + varint(len(body))
        stored += body
    header = dict(header) | {"name_length": header.get("name_length", len(name))}
    if not keep_size:
        header["size"] = 98 + len(name) + len(table) + len(stored) + 4
    head = struct.pack(HEADER, *(header[field] for field in FIELDS))
    return checksummed(head + name + table + stored + b"????")


def forge(data, *, name=None, bodies=None, header=None, keep_size=False, **sections):
    """`data` with some parts replaced."""
    fields, old_name, raw = take_apart(data)
    return put_together(
        fields | (header or {}),
        old_name if name is None else name,
        raw | sections,
        keep_size=keep_size,
        bodies=bodies,
    )
