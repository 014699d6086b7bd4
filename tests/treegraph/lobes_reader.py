"""A slow reader of .lobes files, written from docs/lobes-format.md alone: plain Python and zstandard."""

import struct
import zlib
from collections import deque
from dataclasses import dataclass, field

import zstandard

SECTIONS = [
    "starts",
    "jumps",
    "positions",
    "radii",
    "measured",
    "clusters",
    "seeds",
    "symbols",
    "names",
    "vertices",
]


@dataclass
class Hull:
    vertices: list
    faces: list
    seed: list
    density: float
    n_points: int


@dataclass
class Tree:
    parent: list
    position: list
    radius: list
    measured: list | None
    species: str | None
    epsg: int | None
    origin: tuple
    allometry: tuple
    clusters: list = field(default_factory=list)


def read_varint(data, at):
    value, shift = 0, 0
    while True:
        byte = data[at]
        at += 1
        value += (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at


def bits(raw, count):
    return [raw[i // 8] >> (i % 8) & 1 for i in range(count)]


def planes(raw, count):
    if count == 0:
        assert raw == b""
        return []
    k, rest = divmod(len(raw), count)
    assert rest == 0
    assert k <= 6
    return [sum(raw[plane * count + i] << (8 * plane) for plane in range(k)) for i in range(count)]


def signed(raw, count):
    return [(code >> 1) ^ -(code & 1) for code in planes(raw, count)]


def triples(raw, count):
    flat = signed(raw, 3 * count)
    return [(flat[i], flat[count + i], flat[2 * count + i]) for i in range(count)]


def read_sections(data, at):
    sizes = []
    for _ in SECTIONS:
        raw_size, at = read_varint(data, at)
        size, at = read_varint(data, at)
        sizes.append((raw_size, size))
    sections = {}
    for name, (raw_size, size) in zip(SECTIONS, sizes, strict=True):
        raw = data[at : at + size]
        at += size
        if size != raw_size:
            raw = zstandard.ZstdDecompressor().decompress(raw, max_output_size=raw_size)
        assert len(raw) == raw_size
        sections[name] = raw
    assert at == len(data) - 4
    return sections


def read_parents(sections, n):
    start = bits(sections["starts"], n)
    jumps = iter(planes(sections["jumps"], sum(start)))
    return start, [i - 1 - next(jumps) if start[i] else i - 1 for i in range(n)]


def read_positions(raw, start, parent):
    segment, position = [], []
    for i, r in enumerate(triples(raw, len(parent))):
        before = (0, 0, 0) if i == 0 or start[i] else segment[i - 1]
        segment.append(tuple(r[k] + before[k] for k in range(3)))
        base = (0, 0, 0) if parent[i] == -1 else position[parent[i]]
        position.append(tuple(base[k] + segment[i][k] for k in range(3)))
    return position


def read_radii(raw, parent, e):
    code, radius = [], []
    for i, change in enumerate(signed(raw, len(parent))):
        code.append(change + (0 if parent[i] == -1 else code[parent[i]]))
        m = code[i] - 1
        t = max(m // 256 - 1, 0)
        radius.append(float("nan") if code[i] == 0 else (m - 256 * t) * 2.0**t * 2.0 ** -(e + 2))
    return radius


class Walk:
    def __init__(self, symbols, names):
        self.symbols = iter(symbols)
        self.names, self.at = names, 0

    def new_vertex(self, near):
        self.near.append(near)
        return len(self.near) - 1

    def name(self):
        n, self.at = read_varint(self.names, self.at)
        count = len(self.near)
        if n == 0:
            return self.new_vertex((count - 1, count - 1))
        assert n <= count
        return count - n

    def third(self, a, b):
        symbol = next(self.symbols)
        if symbol == 0:
            return None
        if symbol == 1:
            return self.new_vertex((a, b))
        return {2: lambda: self.after[b], 3: lambda: self.before[a], 4: self.name}[symbol]()

    def hull(self, n_vertices, n_faces):
        self.near, self.after, self.before = [], {}, {}
        used, gates, faces = set(), deque(), []
        while len(faces) < n_faces:
            while gates and gates[0] in used:
                gates.popleft()
            if gates:
                a, b = gates.popleft()
                c = self.third(a, b)
                if c is None:
                    continue
            else:
                a, b, c = self.name(), self.name(), self.name()
            faces.append((a, b, c))
            used |= {(a, b), (b, c), (c, a)}
            for first, second in ((b, a), (c, b), (a, c)):
                if (first, second) not in used:
                    gates.append((first, second))
                    self.after[first] = second
                    self.before[second] = first
        while len(self.near) < n_vertices:
            self.new_vertex((len(self.near) - 1, len(self.near) - 1))
        return faces, self.near


def expected_at(k, near, vertices, anchor):
    if k == 0:
        return anchor
    a, b = near
    return tuple((vertices[a][axis] + vertices[b][axis]) >> 1 for axis in range(3))


def anchor_of(seeds, position, level):
    if not seeds:
        return (0, 0, 0)
    limit = 2**40 - 1
    moved = [p << (level - 3) if level >= 3 else p >> (3 - level) for p in position[seeds[0]]]
    return tuple(max(-limit, min(limit, p)) for p in moved)


def read_clusters(sections, counts, position, e):
    n_clusters, n_vertices, _, n_seeds = counts
    flat = planes(sections["clusters"], 6 * n_clusters)
    rows = [[flat[column * n_clusters + k] for column in range(6)] for k in range(n_clusters)]
    seed, last = [], 0
    for change in signed(sections["seeds"], n_seeds):
        last += change
        seed.append(last)
    residual = triples(sections["vertices"], n_vertices)
    walk = Walk(sections["symbols"], sections["names"])
    clusters = []
    for vertices_here, faces_here, seeds_here, n_points, level, density in rows:
        mine, seed = seed[:seeds_here], seed[seeds_here:]
        rest, residual = residual[:vertices_here], residual[vertices_here:]
        faces, near = walk.hull(vertices_here, faces_here)
        steps = []
        for k, off in enumerate(rest):
            there = expected_at(k, near[k], steps, anchor_of(mine, position, level))
            steps.append(tuple(there[axis] + off[axis] for axis in range(3)))
        vertices = [tuple(v * 2.0 ** -(e - 3 + level) for v in vertex) for vertex in steps]
        value = struct.unpack("<f", struct.pack("<I", density << 8))[0]
        clusters.append(Hull(vertices, faces, mine, value, n_points))
    assert next(walk.symbols, None) is None
    assert walk.at == len(walk.names)
    return clusters


def read(data):
    assert data[:8] == bytes.fromhex("894C4F4245530D0A")
    version, flags, size, n, *counts, epsg, e, length = struct.unpack_from("<HHIIIIIIIBB", data, 8)
    assert (version, size) == (1, len(data))
    assert struct.unpack("<I", data[-4:])[0] == zlib.crc32(data[:-4])
    origin, allometry = struct.unpack_from("<3d", data, 42), struct.unpack_from("<4d", data, 66)
    sections = read_sections(data, 98 + length)
    start, parent = read_parents(sections, n)
    steps = read_positions(sections["positions"], start, parent)
    return Tree(
        parent=parent,
        position=[tuple(p * 2.0**-e for p in point) for point in steps],
        radius=read_radii(sections["radii"], parent, e),
        measured=[bit == 1 for bit in bits(sections["measured"], n)] if flags & 1 else None,
        species=data[98 : 98 + length].decode("utf-8") or None,
        epsg=epsg or None,
        origin=origin,
        allometry=allometry,
        clusters=read_clusters(sections, counts, steps, e),
    )
