"""Compiled decoder of LZF, the compression of PCD files. Checks every step: the bytes may be anything."""

from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

LITERAL_RUN = 32  # a control byte below this begins so many literal bytes, plus one
LONG_MATCH = 7


@_jit
def lzf_decode(packed, out):
    """Decode `packed` (uint8) into `out` (uint8); the bytes written, or -1 if the data is damaged."""
    i = 0
    o = 0
    n = packed.size
    while i < n:
        control = int(packed[i])
        i += 1
        if control < LITERAL_RUN:
            length = control + 1
            if i + length > n or o + length > out.size:
                return -1
            for k in range(length):
                out[o + k] = packed[i + k]
            i += length
            o += length
        else:
            length = control >> 5
            if length == LONG_MATCH:
                if i >= n:
                    return -1
                length += int(packed[i])
                i += 1
            if i >= n:
                return -1
            back = ((control & 31) << 8) + int(packed[i]) + 1
            i += 1
            length += 2
            if back > o or o + length > out.size:
                return -1
            for k in range(length):
                out[o + k] = out[o + k - back]
            o += length
    return o
