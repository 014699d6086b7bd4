"""Compiled parser of lines of numbers. Bytes in, arrays out; the caller has chosen the layout."""

import numpy as np
from numba import njit

_jit = njit(cache=True, error_model="numpy", nogil=True)

NEWLINE, RETURN, SPACE, TAB, QUOTE, APOSTROPHE = 10, 13, 32, 9, 34, 39
PLUS, MINUS, ZERO, NINE, LOWER_E, UPPER_E = 43, 45, 48, 57, 101, 69
MAX_DIGITS = 18  # of a mantissa, so that it fits an int64
MAX_EXACT_POWER = 22  # 10^22 is the largest power of ten a float64 holds exactly
SMALLEST_POWER = 280


@_jit
def _blank(c):
    return c in (SPACE, TAB, RETURN, QUOTE, APOSTROPHE)


@_jit
def _word_is_missing(buf, i, delimiter):
    """Whether the field at i is nan, na, n/a, null, none, inf or -inf in any case; and where it ends."""
    start = i
    if buf[i] == MINUS or buf[i] == PLUS:
        i += 1
    first = buf[i] | 32
    while buf[i] != NEWLINE and buf[i] != delimiter and not _blank(buf[i]):
        i += 1
    if i == start + 1 and buf[start] == MINUS:
        return True, i  # a lone minus
    n = i - start
    return n <= 9 and (first == 110 or first == 105), i  # begins with n or i


@_jit
def _number(buf, i, decimal, delimiter):
    """Read the number at i: value, where it ends, and whether there was one."""
    start = i
    negative = buf[i] == MINUS
    if negative or buf[i] == PLUS:
        i += 1
    mantissa = np.int64(0)
    digits = 0
    power = 0
    any_digit = False
    while ZERO <= buf[i] <= NINE:
        any_digit = True
        if digits < MAX_DIGITS:
            mantissa = mantissa * 10 + np.int64(buf[i] - ZERO)
            if mantissa > 0:
                digits += 1
        else:
            power += 1
        i += 1
    if buf[i] == decimal:
        i += 1
        while ZERO <= buf[i] <= NINE:
            any_digit = True
            if digits < MAX_DIGITS:
                mantissa = mantissa * 10 + np.int64(buf[i] - ZERO)
                power -= 1
                if mantissa > 0:
                    digits += 1
            i += 1
    if not any_digit:
        missing, end = _word_is_missing(buf, start, delimiter)
        return np.nan, end, missing
    if buf[i] == LOWER_E or buf[i] == UPPER_E:
        j = i + 1
        minus = buf[j] == MINUS
        if minus or buf[j] == PLUS:
            j += 1
        exponent = 0
        has_exponent = False
        while ZERO <= buf[j] <= NINE:
            has_exponent = True
            if exponent < 10000:
                exponent = exponent * 10 + np.int64(buf[j] - ZERO)
            j += 1
        if has_exponent:
            power += -exponent if minus else exponent
            i = j
    value = float(mantissa)
    if power < -SMALLEST_POWER:  # 10^power would be 0 before the product is
        value *= 10.0**-SMALLEST_POWER
        power += SMALLEST_POWER
    if power > MAX_EXACT_POWER or power < -MAX_EXACT_POWER:
        value *= 10.0**power
    elif power < 0:
        value /= 10.0**-power
    else:
        value *= 10.0**power
    return (-value if negative else value), i, True


@_jit
def parse_lines(buf, stop, delimiter, decimal, slot, n_wanted, max_rows, out, info):
    """Parse the lines of ``buf[:stop]``, which ends in a newline, into the rows of `out`.

    slot (c,): column of `out` for each column of the file, -1 for one that is not wanted.
    delimiter: a byte, or SPACE for runs of blanks. info: bad lines, first bad line, lines seen.
    Returns the number of rows filled; a line counts if every wanted column holds a number.
    """
    blanks_separate = delimiter == SPACE
    rows = 0
    i = 0
    while i < stop and rows < max_rows:
        info[2] += 1
        field = 0
        found = 0
        while True:
            while _blank(buf[i]) and (blanks_separate or buf[i] != delimiter):
                i += 1
            if buf[i] == NEWLINE:
                break
            ok = True
            if field < slot.size and slot[field] >= 0:
                if buf[i] == delimiter:
                    out[rows, slot[field]] = np.nan  # an empty field
                else:
                    out[rows, slot[field]], i, ok = _number(buf, i, decimal, delimiter)
                if ok:
                    found += 1
            else:
                while buf[i] != NEWLINE and buf[i] != delimiter and not (blanks_separate and _blank(buf[i])):
                    i += 1
            if blanks_separate:
                ok = ok and (buf[i] == NEWLINE or _blank(buf[i]))
            else:
                while _blank(buf[i]) and buf[i] != delimiter:
                    i += 1
                ok = ok and (buf[i] == NEWLINE or buf[i] == delimiter)
                if buf[i] == delimiter:
                    i += 1
            field += 1
            if not ok:
                found = -1
            if found < 0 or found == n_wanted:
                while buf[i] != NEWLINE:
                    i += 1
        if found == n_wanted:
            rows += 1
        elif field > 0:
            info[0] += 1
            if info[1] == 0:
                info[1] = info[2]
        i += 1
    return rows, i
