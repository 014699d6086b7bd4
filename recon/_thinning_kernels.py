"""Compiled voxel thinning with a hash table: one pass, no sorting."""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

EMPTY = -1


@_jit
def _mix(x):
    """SplitMix64's finaliser: 64 bits to 64 well-mixed bits."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@_jit
def _key(x, y, z, per_edge):
    a = np.uint64(np.int64(np.floor(x * per_edge[0])))
    b = np.uint64(np.int64(np.floor(y * per_edge[1])))
    c = np.uint64(np.int64(np.floor(z * per_edge[2])))
    return _mix(_mix(_mix(a) ^ b) ^ c)


@_jit
def _rank(bits, i):
    return _mix(_mix(_mix(bits[i, 0]) ^ bits[i, 1]) ^ bits[i, 2])


@_jit
def keep_one_per_voxel(xyz, bits, edge, limit, key, best, row):
    """Fill `row` with the point of smallest rank in each voxel of size `edge`.

    xyz (n, 3) float64; bits: the same bytes as uint64; key and best (2^k,) uint64 and row (2^k,) int32 or
    int64: the table, larger than `limit`, row full of EMPTY. Returns the number of voxels, or -1 once they
    are more than `limit`.
    """
    mask = np.uint64(key.size - 1)
    used = 0
    per_edge = 1.0 / edge  # exact: edges are powers of two
    for i in range(len(xyz)):
        k = _key(xyz[i, 0], xyz[i, 1], xyz[i, 2], per_edge)
        slot = k & mask
        while row[slot] != EMPTY and key[slot] != k:
            slot = (slot + np.uint64(1)) & mask
        if row[slot] == EMPTY:
            used += 1
            if used > limit:
                return -1
            key[slot] = k
            best[slot] = _rank(bits, i)
            row[slot] = i
        else:
            rank = _rank(bits, i)
            if rank < best[slot]:
                best[slot] = rank
                row[slot] = i
    return used
