"""Damaged files of every format: a cloud or one line comes out, never anything else."""

import random

import numpy as np
import pytest
from scan_files import FORMATS, some_points, write_scan

import recon
from treegraph.errors import FormatError, InputError

QUICK, THOROUGH = 140, 5000  # mutations of each format
N_POINTS = 40
WEIRD = (
    b"\0",
    b"\xff",
    b"\x7f",
    b"\x80",
    b"-",
    b"9",
    b"\n",
    b",",
    b"e",
    b"\xff\xff\xff\xff",
    b"\0\0\0\0",
    b"999999999999",
)


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Cut, overwrite, insert or double a few bytes; half of the time in the header, where it hurts."""
    raw = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        if not raw:
            break
        reach = len(raw) if rng.random() < 0.5 else min(len(raw), 400)
        at = rng.randrange(reach)
        kind = rng.randrange(6)
        if kind == 0:
            raw[at] = rng.randrange(256)
        elif kind == 1:
            raw[at] ^= 1 << rng.randrange(8)
        elif kind == 2:
            word = rng.choice(WEIRD)
            raw[at : at + len(word)] = word
        elif kind == 3:
            raw[at:at] = rng.choice(WEIRD)
        elif kind == 4:
            del raw[at : at + rng.choice((1, 2, 10, len(raw)))]
        else:
            raw[at:at] = raw[at : at + rng.randrange(1, 60)]
    return bytes(raw)


def check_mutations(folder, kind, n):
    data = write_scan(folder, kind, some_points(N_POINTS)).read_bytes()
    path = folder / "damaged"
    rng = random.Random(f"{kind} {n}")
    n_read = 0
    for i in range(n):
        path.write_bytes(mutate(data, rng))
        try:
            cloud = recon.read_cloud(path)
        except (InputError, FormatError) as error:
            message = str(error)
            assert message.startswith(str(path)), (i, message)
            assert "\n" not in message and len(message) < len(str(path)) + 320, (i, message)
        else:
            n_read += 1
            assert np.isfinite(cloud.xyz).all() and cloud.n_points <= cloud.n_read, i
            assert all("\n" not in note for note in cloud.notes), (i, cloud.notes)
    return n_read


@pytest.mark.parametrize("kind", FORMATS)
def test_mutated_files_end_in_a_cloud_or_in_one_line(tmp_path, kind):
    if kind == "e57":
        pytest.importorskip("pye57")
    n_read = check_mutations(tmp_path, kind, QUICK)
    assert kind == "e57" or n_read > 0  # the mutations are not all in vain


@pytest.mark.slow
@pytest.mark.parametrize("kind", FORMATS)
def test_many_mutated_files(tmp_path, kind):
    if kind == "e57":
        pytest.importorskip("pye57")
    check_mutations(tmp_path, kind, THOROUGH)


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_cut_anywhere(tmp_path, kind):
    if kind == "e57":
        pytest.importorskip("pye57")
    data = write_scan(tmp_path, kind, some_points(N_POINTS)).read_bytes()
    path = tmp_path / "cut"
    for length in np.unique(np.linspace(1, len(data) - 1, 40).astype(int)):
        path.write_bytes(data[:length])
        try:
            cloud = recon.read_cloud(path)
        except (InputError, FormatError) as error:
            assert "\n" not in str(error)
        else:
            assert cloud.n_points <= N_POINTS
