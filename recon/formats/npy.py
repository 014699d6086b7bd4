"""NumPy's .npy: an (n, 3 or more) array of numbers, or records with named fields."""

from __future__ import annotations

import ast
import math
import os
import struct
from collections.abc import Iterator

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from recon.formats.columns import ColumnMap, chunk_of, map_columns
from treegraph.errors import FormatError

MAGIC = b"\x93NUMPY"
MAX_HEADER = 10_000  # bytes, as NumPy itself allows
_DAMAGED = "the header of the .npy file is damaged. Save the array again with numpy.save."


def is_npy(head: bytes) -> bool:
    """Whether a file that begins with `head` is a .npy file."""
    return head[:6] == MAGIC


def open_npy(path: str) -> Source:
    """Open a .npy file of points; columns after the third are left out unless the array has named fields.

    Raises
    ------
    FormatError
        If the header is damaged, the array holds no points, or there is less data than it declares.
    """
    with open(path, "rb") as file:
        head = file.read(12 + MAX_HEADER)
    dtype, shape, fortran, start = _read_header(head, path)
    notes: list[str] = []
    if dtype.names:
        columns = map_columns(dtype.names)
        plain = all(dtype[name].kind in "fiub" and dtype[name].shape == () for name in dtype.names)
        if columns.xyz is None or not plain or len(shape) != 1:
            raise FormatError(
                f"{path}: the records have no fields x, y and z of numbers, only "
                f"{', '.join(dtype.names)[:60]}."
            )
    else:
        if len(shape) != 2 or shape[1] < 3 or dtype.kind not in "fiu":
            raise FormatError(
                f"{path}: the array must hold numbers of shape (n, 3), got {dtype} of shape {shape}."
            )
        columns = ColumnMap((0, 1, 2))
        if shape[1] > 3:
            notes.append(f"columns 4 to {shape[1]} have no name and were not used")
    declared = math.prod(shape) * dtype.itemsize
    there = os.path.getsize(path) - start
    if declared > there:
        raise FormatError(
            f"{path}: the array of shape {shape} needs {declared} bytes, but the file has {there}; "
            "it is cut off. Copy it again."
        )
    if shape[0] == 0:
        raise FormatError(f"{path}: the array holds no points. Save the scan again.")
    array = np.memmap(path, dtype, "r", start, shape, "F" if fortran else "C")
    return Source(_chunks(array, columns), notes=notes, names=dict(columns.names))


def _read_header(head: bytes, path: str) -> tuple[np.dtype, tuple[int, ...], bool, int]:
    if len(head) < 12 or head[6] not in (1, 2, 3):
        raise FormatError(f"{path}: {_DAMAGED}")
    length, begin = (
        (struct.unpack_from("<H", head, 8)[0], 10)
        if head[6] == 1
        else (struct.unpack_from("<I", head, 8)[0], 12)
    )
    if length > MAX_HEADER or begin + length > len(head):
        raise FormatError(f"{path}: {_DAMAGED}")
    try:
        found = ast.literal_eval(head[begin : begin + length].decode("latin-1").strip())
        shape, fortran = tuple(found["shape"]), bool(found["fortran_order"])
        described = found["descr"]
        if not isinstance(described, str):
            described = [(str(one[0]), *one[1:]) for one in described]
        dtype = np.dtype(described)
    except (ValueError, SyntaxError, TypeError, KeyError, IndexError, MemoryError, RecursionError):
        raise FormatError(f"{path}: {_DAMAGED}") from None
    good = all(isinstance(n, int) and not isinstance(n, bool) and 0 <= n < 2**62 for n in shape)
    if not good or not shape or dtype.hasobject or dtype.itemsize == 0:
        raise FormatError(
            f"{path}: the array must hold plain numbers of shape (n, 3), got {dtype} of shape {shape}."
        )
    return dtype, shape, fortran, begin + length


def _chunks(array: np.ndarray, columns: ColumnMap) -> Iterator[Chunk]:
    names = array.dtype.names
    for begin in range(0, len(array), CHUNK):
        block = array[begin : begin + CHUNK]
        if names:
            yield chunk_of(columns, lambda i: _native(block[names[i]]))  # noqa: B023
        else:
            yield chunk_of(columns, lambda i: _native(block[:, i]))  # noqa: B023


def _native(values: np.ndarray) -> np.ndarray:
    return np.array(values, dtype=values.dtype.newbyteorder("="))
