"""The derived file: what it keeps, how exactly, and that nothing in it is trusted."""

import hashlib
import json
import tracemalloc

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from species.foliage import LeafSet
from species.library import Branchlet, cut_branchlet
from species.library import packing as module
from species.library.packing import HEAD, MAGIC, PICTURES, pack_species, unpack_species
from tests.library_examples import random_branchlet
from treegraph import TreeGraph
from treegraph._lobes_bytes import join_sections, pack_planes, split_sections
from treegraph.errors import FormatError

KEY = "ab" * 32
BOX = (-0.02, -0.005, 0.03, 0.09)
IMAGES = {name: name.encode() * 3 for name in PICTURES}
DAMAGED = "the file is damaged"


def pack(*made, key=KEY, pictures=IMAGES, box=BOX, tile=0.3):
    return pack_species(key, made, pictures, box, tile)


# ---------------------------------------------------------------- what is kept


@settings(max_examples=50, deadline=None)
@given(
    st.integers(0, 10**6),
    st.integers(2, 60),
    st.integers(1, 40),
    st.sampled_from([1e-3, 0.1, 1.0, 20.0]),
    st.floats(1e-3, 500),
)
def test_everything_comes_back_as_exactly_as_is_said(seed, n_nodes, n_leaves, reach, share):
    made = [random_branchlet(seed + k, n_nodes + k, n_leaves, reach, share) for k in range(2)]
    found = unpack_species(pack(*made))
    assert (found.key, found.pictures, found.leaf_box, found.bark_tile) == (KEY, IMAGES, BOX, 0.3)
    assert len(found.branchlets) == 2
    for before, after in zip(made, found.branchlets, strict=True):
        assert (after.size, after.slope_deg) == (before.size, before.slope_deg)
        assert (after.graph.parent == before.graph.parent).all()
        assert (after.graph.attribute["order"] == before.graph.attribute["order"]).all()
        assert after.graph.attribute["order"].dtype == np.int32
        assert (after.leaves.node == before.leaves.node).all()
        points = np.concatenate([before.graph.position, before.leaves.base])
        step = max((points - points.min(axis=0)).max(), 1e-6) / 16383
        assert np.abs(after.graph.position - before.graph.position).max() <= 0.501 * step
        assert np.abs(after.leaves.base - before.leaves.base).max() <= 0.501 * step
        for value, wanted in (
            (after.graph.radius, before.graph.radius),
            (after.leaves.length, before.leaves.length),
            (after.leaves.width, before.leaves.width),
        ):
            assert np.abs(value / wanted - 1.0).max() <= 0.0015
        for value, wanted in (
            (after.leaves.along, before.leaves.along),
            (after.leaves.normal, before.leaves.normal),
        ):
            assert np.allclose(np.linalg.norm(value, axis=1), 1.0, atol=1e-12)
            off = np.degrees(2 * np.arcsin(0.5 * np.linalg.norm(value - wanted, axis=1)))
            assert off.max() <= 0.35
        across = np.einsum("ij,ij->i", after.leaves.along, after.leaves.normal)
        assert np.allclose(across, 0.0, atol=1e-12)


def directions():
    """Every direction that rounding or a sign could spoil, and many others."""
    grid = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], float)
    grid = grid[np.abs(grid).sum(axis=1) > 0]
    near = np.concatenate([grid + 1e-9, grid - 1e-9, grid * [1, 1, -0.0]])
    near = near[np.linalg.norm(near, axis=1) > 0.5]
    more = np.random.default_rng(0).normal(size=(3000, 3))
    every = np.concatenate([grid, near, more])
    return every / np.linalg.norm(every, axis=1, keepdims=True)


def test_directions_of_all_kinds_keep_a_quarter_of_a_degree():
    way = directions()
    back = module._from_octahedron(module._to_octahedron(way))
    assert np.degrees(2 * np.arcsin(0.5 * np.linalg.norm(back - way, axis=1))).max() < 0.25
    for turn in (0.0, 1.0, 2.5, 3.2, 6.28318):
        side, other = module._across(back)
        normal = np.cos(turn) * side + np.sin(turn) * other
        n = len(way)
        leaves = LeafSet(0 * way, way, normal, np.ones(n), np.ones(n), np.zeros(n, np.int32))
        again = module._normal_of(back, module._turn_of(leaves))
        assert np.degrees(2 * np.arcsin(0.5 * np.linalg.norm(again - normal, axis=1))).max() < 0.2


def test_the_same_branchlets_give_the_same_bytes():
    made = random_branchlet(1), random_branchlet(2)
    assert pack(*made) == pack(*made)
    assert pack(*made, pictures=dict(reversed(IMAGES.items()))) == pack(*made)
    assert pack(*made) != pack(*made[::-1])


def test_what_was_unpacked_packs_to_the_same_bytes_again():
    once = unpack_species(pack(random_branchlet(1), random_branchlet(2)))
    data = pack(*once.branchlets)
    assert pack(*unpack_species(data).branchlets) == data


def test_seasons_without_leaves_have_no_picture():
    some = {name: IMAGES[name] for name in ("leaf_summer", "leaf_normal", "bark", "bark_normal")}
    assert unpack_species(pack(random_branchlet(), pictures=some)).pictures == some


def test_a_species_is_small():
    made = [random_branchlet(k, 200, 150) for k in range(24)]
    assert len(pack(*made)) < 24 * (200 * 11 + 150 * 15)  # bytes for each node and leaf


# ---------------------------------------------------------------- what is no such file


GOOD = pack(random_branchlet(1, 12, 9), random_branchlet(2, 30, 20))


def sealed(body, key=KEY, version=1):
    """A body with the right checksum before it."""
    return MAGIC + bytes([version]) + bytes.fromhex(key) + hashlib.sha256(body).digest() + body


def parts(data=GOOD):
    """The sections of a good file, the header as JSON."""
    limits = dict.fromkeys(("header", *module.SECTIONS, *PICTURES), 10**6)
    sections = split_sections(data[HEAD:], limits)
    return json.loads(sections.pop("header")), sections


def rebuilt(header, sections):
    raw = header if isinstance(header, bytes) else json.dumps(header).encode()
    return sealed(join_sections([raw, *sections.values()]))


def test_the_tools_of_these_tests_are_right():
    assert sealed(GOOD[HEAD:]) == GOOD
    found = unpack_species(rebuilt(*parts()))
    assert (found.branchlets[1].graph.parent == random_branchlet(2, 30, 20).graph.parent).all()


@pytest.mark.parametrize(
    "data, text",
    [
        (b"", "not a file of a species' branchlets: it must begin with b'SAPTWIGS'"),
        (b"PK\3\4" + GOOD[4:], "not a file of a species' branchlets"),
        (GOOD[: HEAD - 1], "not a file of a species' branchlets"),
        (GOOD[:8] + b"\2" + GOOD[9:], "version 2 is not known; this reads version 1"),
        (GOOD[:-1], "the checksum does not fit; the file is damaged"),
        (GOOD + b"\0", "the checksum does not fit; the file is damaged"),
        (GOOD[:HEAD], "the checksum does not fit; the file is damaged"),
        (sealed(b""), "the table of sections ends within a number; the file is damaged"),
        (sealed(b"\xff" * 40), "a number in the table of sections must take at most 5 bytes"),
        (sealed(GOOD[HEAD:] + b"\0"), "the sections must fill the file; the file is damaged"),
        (sealed(b"\x05\x09" + b"\0" * 60), "the header must hold at most 100000 bytes"),
        (sealed(b"\xff\xff\xff\x7f\x05" + b"\0" * 60), "the header must hold at most 100000 bytes"),
        (sealed(b"\0\0" * 500_000), "the sections must fill the file; the file is damaged"),
        (GOOD + b"\0" * 4_000_000, "a species' derived file has at most 4000000 bytes, got 400"),
    ],
)
def test_what_is_no_such_file_is_said(data, text):
    with pytest.raises(FormatError) as error:
        unpack_species(data)
    assert str(error.value).startswith(text)


HEADERS = {
    "no JSON": b"{",
    "no UTF-8": b"\xff",
    "deep": b"[" * 50_000,
    "a list": [],
    "no branchlets": {"branchlets": []},
    "too many": {"branchlets": "all"},
    "nodes 1": {"nodes": 1},
    "nodes 4001": {"nodes": 4001},
    "nodes 12.0": {"nodes": 12.0},
    "nodes '12'": {"nodes": "12"},
    "nodes true": {"nodes": True},
    "nodes null": {"nodes": None},
    "nodes huge": {"nodes": 10**500},
    "leaves 0": {"leaves": 0},
    "leaves 1501": {"leaves": 1501},
    "leaves -9": {"leaves": -9},
    "low of two": {"low": [0, 0]},
    "low of four": {"low": [0, 0, 0, 0]},
    "low far": {"low": [0, 0, 1e4]},
    "low text": {"low": "abc"},
    "extent 0": {"extent": 0},
    "extent nan": {"extent": float("nan")},
    "extent inf": {"extent": float("inf")},
    "size -1": {"size": -1},
    "slope 91": {"slope_deg": 91},
    "share 0": {"width_share": 0},
    "share gone": {"width_share": "gone"},
    "box of three": {"leaf_box": [-1, -1, 1]},
    "box upside down": {"leaf_box": [-1, 1, 1, -1]},
    "box beside the midrib": {"leaf_box": [0.1, 0, 1, 1]},
    "box far": {"leaf_box": [-30, 0, 1, 1]},
    "box null": {"leaf_box": None},
    "tile 0": {"bark_tile": 0},
    "tile true": {"bark_tile": True},
    "pictures a list": {"pictures": [1, 2]},
    "picture of another name": {"pictures": {"leaf_fall": 3}},
    "picture 0": {"pictures": {"bark": 0}},
    "picture huge": {"pictures": {"bark": 1_000_001}},
    "picture 1.0": {"pictures": {"bark": 1.0}},
}


@pytest.mark.parametrize("name", HEADERS)
def test_every_value_of_the_header_is_checked(name):
    change = HEADERS[name]
    header, sections = parts()
    if isinstance(change, dict):
        for key, value in change.items():
            if key == "branchlets":
                header[key] = header[key] * 31 if value == "all" else value
            elif key in header["branchlets"][0]:
                if value == "gone":
                    del header["branchlets"][0][key]
                else:
                    header["branchlets"][0][key] = value
            else:
                header[key] = value
    else:
        header = change
    with pytest.raises(FormatError, match=f"the header is wrong .*; {DAMAGED}"):
        unpack_species(rebuilt(header, sections))


def planes(values):
    return pack_planes(np.array(values, np.int64))


@pytest.mark.parametrize(
    "name, raw, text",
    [
        ("parent", planes([0, *[1] * 11, *[0] * 30]), "a parent does not come before its child"),
        # at the second node -1, which would be a root of its own
        ("parent", planes([0, *[2] * 11, 0, *[1] * 29]), "a parent does not come before its child"),
        ("parent", planes([0, *[60_000] * 41]), "a parent does not come before its child"),
        ("node", planes([12] * 29), "a leaf hangs on a node that is not there"),
        ("node", planes([65_535] * 29), "a leaf hangs on a node that is not there"),
        ("position", b"", None),
        ("position", planes([65_535] * 126), None),
        ("along", planes([65_535] * 58), None),
        ("along", b"", None),
        ("turn", planes([65_535] * 29), None),
        ("radius", planes([65_535] * 42), None),
        ("length", planes([65_535] * 29), None),
        ("order", planes([65_535] * 42), None),
        ("parent", b"\1" * 85, "section 'parent' must hold at most 84 bytes"),
        ("parent", b"\1" * 41, "section 'parent' must hold 0 to 6 bytes for each of its 42 values"),
        ("bark", b"", "picture 'bark' must have 12 bytes; the file is damaged"),
        ("bark", b"1" * 11, "picture 'bark' must have 12 bytes; the file is damaged"),
        ("bark", b"1" * 13, "section 'bark' must hold at most 12 bytes"),
    ],
)  # fmt: skip
def test_every_section_is_checked(name, raw, text):
    header, sections = parts()
    sections[name] = raw
    data = rebuilt(header, sections)
    if text is None:  # odd, but a tree: finite, connected, unit vectors
        for branchlet in unpack_species(data).branchlets:
            check_sound(branchlet)
        return
    with pytest.raises(FormatError) as error:
        unpack_species(data)
    assert text in str(error.value) and DAMAGED in str(error.value)


def check_sound(branchlet):
    graph, leaves = branchlet.graph, branchlet.leaves
    assert (graph.parent[1:] >= 0).all()
    assert np.isfinite(graph.position).all() and np.isfinite(leaves.base).all()
    assert ((graph.radius > 0.0) & (graph.radius <= 1.0001)).all()
    assert ((leaves.length > 0.0) & (leaves.length < 10.01) & (leaves.width > 0.0)).all()
    for vectors in (leaves.along, leaves.normal):
        assert np.allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-9)
    assert 0 <= leaves.node.min() <= leaves.node.max() < graph.n_nodes
    for patch in cut_branchlet(branchlet):
        assert patch.graph.n_nodes >= 1


def test_a_frame_of_zstd_that_gets_too_large_is_stopped():
    header, sections = parts()
    raw = json.dumps(header).encode()
    bomb = zstandard.ZstdCompressor(level=19).compress(b"\0" * 200_000_000)
    body = join_sections([raw, *sections.values()])
    small = join_sections([raw])
    declared = [module.MOST_HEADER, len(bomb)]
    table = b"".join(module_varint(value) for value in declared)
    tracemalloc.start()
    try:
        for data in (sealed(table + bomb), sealed(body[: len(small)] + bomb)):
            with pytest.raises(FormatError):
                unpack_species(data)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


def module_varint(value):
    from treegraph._lobes_bytes import varint

    return varint(value)


# ---------------------------------------------------------------- fuzzing


def mutate(rng, data, seal):
    """A good file with some bits turned, bytes put in, taken out, or copied; perhaps sealed again."""
    start = HEAD if seal else 0
    body = bytearray(data[start:])
    for _ in range(int(rng.integers(1, 4))):
        what, at = int(rng.integers(5)), int(rng.integers(len(body)))
        if what == 0:
            body[at] ^= 1 << int(rng.integers(8))
        elif what == 1:
            body[at] = int(rng.integers(256))
        elif what == 2:
            del body[at : at + int(rng.integers(1, 20))]
        elif what == 3:
            body[at:at] = rng.bytes(int(rng.integers(1, 20)))
        else:
            other = int(rng.integers(len(body)))
            body[at : at + 8] = body[other : other + 8]
        if not body:
            body = bytearray(b"\0")
    return sealed(bytes(body)) if seal else bytes(body)


def mutate_inside(rng):
    """A good file whose sections are changed before they are compressed, so that all checksums fit."""
    header, sections = parts()
    name = list(sections)[int(rng.integers(len(module.SECTIONS)))]
    raw = np.frombuffer(sections[name], np.uint8).copy()
    if raw.size:
        at = rng.integers(0, raw.size, int(rng.integers(1, 6)))
        raw[at] = rng.integers(0, 256, at.size)
    sections[name] = raw.tobytes()
    if rng.random() < 0.3:
        text = bytearray(json.dumps(header).encode())
        text[int(rng.integers(len(text)))] = int(rng.integers(32, 127))
        return rebuilt(bytes(text), sections)
    return rebuilt(header, sections)


def check_mutations(count, seed):
    rng = np.random.default_rng(seed)
    passed = 0
    for k in range(count):
        data = mutate_inside(rng) if k % 3 == 2 else mutate(rng, GOOD, seal=k % 3 == 1)
        try:
            found = unpack_species(data)
        except FormatError as error:
            assert "\n" not in str(error)
            continue
        passed += 1
        for branchlet in found.branchlets:
            check_sound(branchlet)
    return passed


def test_mutations_are_refused_or_sound():
    assert 10 < check_mutations(500, seed=1) < 250  # some must get through, or nothing behind is tested


@pytest.mark.slow
def test_many_mutations_are_refused_or_sound():
    tracemalloc.start()
    try:
        check_mutations(20_000, seed=2)
        assert tracemalloc.get_traced_memory()[1] < 30_000_000
    finally:
        tracemalloc.stop()


def test_the_largest_branchlets_fit():
    n, m = module.MOST_NODES, module.MOST_LEAVES
    parent = np.concatenate([[-1], np.zeros(n - 1, int)]).astype(np.int32)
    position = np.random.default_rng(0).uniform(-100, 100, (n, 3))
    position[0] = 0.0
    graph = TreeGraph(parent, position, np.full(n, 1.0), {"order": np.full(n, 300, np.int32)})
    way = np.tile([[0.0, 0.0, -1.0]], (m, 1))
    leaves = LeafSet(
        position[-m:], way, np.tile([[1.0, 0, 0]], (m, 1)), np.full(m, 10.0), np.full(m, 5.0),
        np.arange(n - m, n, dtype=np.int32),
    )  # fmt: skip
    (found,) = unpack_species(pack(Branchlet(graph, leaves, 100.0, 90.0))).branchlets
    assert (found.graph.parent == parent).all()
    assert np.abs(found.graph.position - position).max() < 0.5 * 200 / 16383 + 1e-9
    assert np.allclose(found.leaves.length, 10.0, rtol=0.0015)
