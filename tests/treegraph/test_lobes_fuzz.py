"""Broken .lobes files by the thousand: whatever the bytes are, a tree or one line of FormatError."""

import re
import resource
import time

import numpy as np
import pytest

from tests.corpus import TREES, realistic_cluster_tree
from tests.treegraph.lobes_forge import FIELDS, checksummed, put_together, take_apart
from tests.treegraph.lobes_reader import SECTIONS
from treegraph import DEFAULT_ALLOMETRY, ClusterTree, FormatError, decode_lobes, encode_lobes
from treegraph.lobes import LobesLimits

COUNTS = ["n_nodes", "n_clusters", "n_vertices", "n_faces", "n_seeds"]
LIES = [0, 1, 2, 7, 8, 9, 255, 256, 4096, 4097, 2**16, 2**31 - 1, 2**31, 2**32 - 1]

#: Small, so that a file that declares as much as it may is read at once and 10^5 of them in minutes.
LIMITS = LobesLimits(n_nodes=4096, n_clusters=256, n_vertices=4096, n_faces=4096, n_seeds=4096)
MAX_GROWTH = 100_000  # kB of the whole process, over all files
MAX_SECONDS = 1.0  # for the slowest file, with room for a busy machine; typical ones take 1 ms


def seeds():
    """Sound files of several kinds."""
    measured = TREES["bush"].replace(attribute={"measured": np.arange(500) % 5 < 3})
    trees = [
        ClusterTree(TREES[name], (), None, DEFAULT_ALLOMETRY, (1e6, 2e6, 3.5), None)
        for name in ("one node", "forest", "some radii unknown", "a million metres off")
    ]
    trees.append(realistic_cluster_tree(measured, n_clusters=6))
    trees.append(realistic_cluster_tree(TREES["comb"], n_clusters=2, n_around=3, n_levels=3))
    return [encode_lobes(tree) for tree in trees]


def flip_bits(rng, data):
    out = bytearray(data)
    for at in rng.integers(0, len(out), rng.integers(1, 9)) if out else ():
        out[at] ^= 1 << int(rng.integers(8))
    return bytes(out)


def set_bytes(rng, data):
    out = bytearray(data)
    for at in rng.integers(0, len(out), rng.integers(1, 5)) if out else ():
        out[at] = int(rng.choice([0, 1, 127, 128, 255]))
    return bytes(out)


def cut(rng, data):
    return data[: rng.integers(0, len(data) + 1)]


def drop(rng, data):
    start, end = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:start] + data[end:]


def repeat(rng, data):
    start, end = np.sort(rng.integers(0, len(data) + 1, 2))
    return data[:end] + data[start:]


def overwrite(rng, data):
    out = bytearray(data)
    start = int(rng.integers(0, len(out) + 1))
    noise = rng.bytes(int(rng.integers(1, 40)))
    out[start : start + len(noise)] = noise
    return bytes(out)


CHANGES = [flip_bits, flip_bits, set_bytes, cut, drop, repeat, overwrite]


def change(rng, data):
    return CHANGES[rng.integers(len(CHANGES))](rng, data)


def raw_damage(rng, files):
    """Bytes changed anywhere, as a bad disk or line does."""
    return change(rng, files[rng.integers(len(files))])


def checked_damage(rng, files):
    """The same with size and checksum made right, so that it is read further."""
    data = change(rng, files[rng.integers(len(files))])
    if len(data) < 20:
        return data
    return checksummed(data[:12] + len(data).to_bytes(4, "little") + data[16:])


def splice(rng, files):
    """The beginning of one file and the end of another."""
    first, second = (files[k] for k in rng.integers(len(files), size=2))
    data = first[: rng.integers(17, len(first))] + second[rng.integers(0, len(second)) :]
    return checksummed(data[:12] + len(data).to_bytes(4, "little") + data[16:] + b"????")


def header_lie(rng, files):
    """Another number in the header, all else sound."""
    header, name, sections = take_apart(files[rng.integers(len(files))])
    for _ in range(rng.integers(1, 3)):
        field = str(rng.choice(FIELDS[1:]))
        if field in ("x", "y", "z", "beta", "gamma", "f_s", "d_root"):
            header[field] = float(rng.choice([0.0, -1.0, np.nan, np.inf, 1e308, 5e-324]))
        else:
            most = {"version": 3, "flags": 3, "exponent": 30, "name_length": 255}.get(field, 2**32 - 1)
            near = [header[field] - 1, header[field] + 1] if field in COUNTS else []
            header[field] = int(min(max(rng.choice(LIES + near), 0), most))
    return put_together(header, name, sections, keep_size=bool(rng.integers(2)))


def payload_damage(rng, files):
    """Sections changed and compressed again: what the reader finds behind all its outer checks."""
    header, name, sections = take_apart(files[rng.integers(len(files))])
    for section in rng.choice(SECTIONS, rng.integers(1, 3)):
        raw = sections[section]
        kind = rng.integers(3)
        if kind == 0:
            raw = flip_bits(rng, raw)
        elif kind == 1:
            raw = set_bytes(rng, raw)
        else:
            raw = change(rng, raw)
        sections[section] = raw
    return put_together(header, name, sections)


def size_lie(rng, files):
    """Sections whose declared size or stored bytes are false."""
    header, name, sections = take_apart(files[rng.integers(len(files))])
    section = str(rng.choice(SECTIONS))
    size = int(rng.choice([*LIES[:-1], len(sections[section]) + int(rng.integers(-2, 3))]))
    body = change(rng, bytes.fromhex("28b52ffd") + sections[section])
    return put_together(header, name, sections, bodies={section: (max(size, 0), body)})


def inflated(rng, files):
    """Counts raised to the limits, with sections of zeros as long as they then must be."""
    header, name, sections = take_apart(files[rng.integers(len(files))])
    n = int(rng.choice([1, 4095, 4096, 4097]))
    field = str(rng.choice(["n_nodes", "n_faces", "n_vertices", "n_seeds", "n_clusters"]))
    header[field] = n
    if field == "n_nodes":
        sections |= {"starts": bytes((n + 7) // 8), "jumps": b"", "positions": b"", "radii": bytes(n)}
        sections["measured"] = bytes((n + 7) // 8) if header["flags"] else b""
    if field == "n_clusters":
        sections |= {"clusters": b"", "seeds": b"", "symbols": b"", "names": b"", "vertices": b""}
        header |= {"n_vertices": 0, "n_faces": 0, "n_seeds": 0}
    if field in ("n_faces", "n_vertices"):
        header |= {"n_clusters": 1, "n_seeds": 0, "n_vertices": max(3, n), "n_faces": n}
        row = [max(3, n), n, 0, 0, int(rng.integers(17)), 0]
        sections["clusters"] = bytes(v & 255 for v in row) + bytes(v >> 8 for v in row)
        sections |= {"seeds": b"", "vertices": b""}
        sections["names"] = bytes(3 * int(rng.integers(1, 3)))
        sections["symbols"] = bytes(
            rng.choice(5, 3 * n, p=[0.02, 0.4, 0.28, 0.28, 0.02]).astype(np.uint8).tobytes()
        )
    return put_together(header, name, sections)


KINDS = [raw_damage, checked_damage, splice, header_lie, payload_damage, payload_damage, size_lie, inflated]


def attack(n_files, seed):
    """Read `n_files` broken files; return how many were refused and the longest time taken for one."""
    files = seeds()
    rng = np.random.default_rng(seed)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused, slowest, reasons = 0, 0.0, set()
    for k in range(n_files):
        data = KINDS[k % len(KINDS)](rng, files)
        start = time.process_time()
        try:
            tree = decode_lobes(data, limits=LIMITS)
        except FormatError as error:
            refused += 1
            reasons.add(" ".join(re.sub(r"\d+", "#", str(error)).split()[:4]))
            assert "\n" not in str(error)
        else:
            assert tree.graph.n_nodes <= LIMITS.n_nodes
            again = encode_lobes(tree)  # what can be read can be written
            assert encode_lobes(decode_lobes(again)) == again
        slowest = max(slowest, time.process_time() - start)
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert growth < MAX_GROWTH
    assert slowest < MAX_SECONDS
    return refused, slowest, growth, reasons


@pytest.fixture
def memory_limit():
    """No more than 1 GB of address space beyond what there is: a wild allocation fails at once."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**30, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def test_a_thousand_broken_files(memory_limit):
    refused, _, _, reasons = attack(1000, seed=11)
    assert refused > 700
    assert len(reasons) > 40  # the inner checks are reached, not only the checksum


@pytest.mark.slow
def test_a_hundred_thousand_broken_files(memory_limit):
    refused, _, _, reasons = attack(100_000, seed=12)
    assert refused > 70_000
    assert len(reasons) > 60


def test_the_fuzzer_leaves_sound_files_alone():
    """Taking apart and putting together is no damage of its own."""
    for data in seeds():
        header, name, sections = take_apart(data)
        assert encode_lobes(decode_lobes(put_together(header, name, sections))) == data
