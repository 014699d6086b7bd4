"""XYZ, TXT, CSV, ASC, PTS: lines of numbers with whatever delimiter, header and decimal mark people have."""

from __future__ import annotations

import codecs
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from recon.formats.chunks import CHUNK, Chunk, Source
from recon.formats.columns import ColumnMap, chunk_of, map_columns
from treegraph.errors import FormatError

BLOCK = 1 << 24  # bytes parsed at a time
SAMPLE = 1 << 16  # bytes the layout is guessed from
MAX_HEADER_LINES = 100
MIN_SAMPLE_ROWS = 5  # rows before a column of consecutive integers is taken for an index
MAX_BAD_SHARE = 0.1  # of the lines; more that are not numbers and the file is refused
COMMENT = ("#", "//", "%", "!", "*")
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?$")
_GENERIC = re.compile(
    r"(v|c|f|col|column|field|var|scalar)?[ _]?\d*$", re.IGNORECASE
)  # names that say nothing
_MISSING = re.compile(r"(nan|na|n/a|null|none|[-+]?inf|-)?$", re.IGNORECASE)


@dataclass(frozen=True)
class Layout:
    """How the lines of a text file are to be read.

    Attributes
    ----------
    delimiter : str
        One character; " " means runs of blanks and tabs.
    decimal : str
        "." or ",".
    columns : ColumnMap
        Which columns are wanted.
    n_columns : int
        Columns a line has.
    header_lines : int
        Lines before the first row of numbers.
    """

    delimiter: str
    decimal: str
    columns: ColumnMap
    n_columns: int
    header_lines: int = 0


class _Recoded:
    """A UTF-16 file read as UTF-8."""

    def __init__(self, file: BinaryIO, encoding: str) -> None:
        self._file, self._decoder = file, codecs.getincrementaldecoder(encoding)(errors="replace")

    def read(self, size: int) -> bytes:
        """About `size` bytes; empty at the end."""
        raw = self._file.read(size)
        return self._decoder.decode(raw, final=not raw).encode()


def _blocks(path: str, start: int) -> Iterator[bytes]:
    """The file from byte `start` on in blocks of whole lines, each ending in a newline."""
    with open(path, "rb") as file:
        head = file.read(4)
        file.seek(start)
        reader: BinaryIO | _Recoded = file
        if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
            reader = _Recoded(file, "utf-16")
        elif head[:3] == codecs.BOM_UTF8 and start == 0:
            file.seek(3)
        rest = b""
        while raw := reader.read(BLOCK):
            if b"\r" in raw and b"\n" not in raw:
                raw = raw.replace(b"\r", b"\n")
            block = rest + raw
            cut = block.rfind(b"\n") + 1
            rest = block[cut:]
            if len(rest) > BLOCK:
                raise FormatError(
                    f"{path}: no line ends within {BLOCK >> 20} MB, so this is not a text file of points."
                )
            if cut:
                yield block[:cut]
        if rest:
            yield rest + b"\n"


def parse_rows(
    path: str,
    layout: Layout,
    *,
    start: int = 0,
    skip_lines: int = 0,
    max_rows: int | None = None,
    notes: list[str] | None = None,
) -> Iterator[Chunk]:
    """Parse the lines of a file as points, a block at a time.

    Lines that do not hold numbers in the wanted columns are left out and told in `notes`; when they
    are more than a tenth of the file it is refused, with the first of them.

    Notes
    -----
    About 30 million numbers a second; memory is a block and its points.
    """
    from recon.formats._text_kernels import parse_lines

    columns = layout.columns
    wanted = sorted({*(columns.xyz or ()), *(i for where in columns.extra.values() for i in where)})
    slot = np.full(max(wanted) + 1, -1, np.int64)
    slot[wanted] = np.arange(len(wanted))
    info = np.zeros(3, np.int64)
    marks = (ord(layout.delimiter), ord(layout.decimal))
    n_rows = 0
    left = np.iinfo(np.int64).max if max_rows is None else max_rows
    for block in _blocks(path, start):
        at = 0
        while skip_lines and at < len(block):
            at = block.find(b"\n", at) + 1
            skip_lines -= 1
            info[2] += 1
        if at:
            block = block[at:]
        buf = np.frombuffer(block, np.uint8)
        at = 0
        while at < len(buf) and left > 0:
            lines = block.count(b"\n", at) if len(buf) - at < BLOCK else CHUNK
            out = np.empty((min(left, lines, CHUNK), len(wanted)), np.float64)
            rows, read = parse_lines(buf[at:], len(buf) - at, *marks, slot, len(wanted), len(out), out, info)
            at += read
            n_rows += rows
            left -= rows
            _refuse_if_mostly_bad(path, info, n_rows)
            if rows:
                yield chunk_of(columns, lambda i: out[:rows, slot[i]])  # noqa: B023
        if left <= 0:
            break
    if info[0] and notes is not None:
        notes.append(
            f"{info[0]} of {n_rows + info[0]} lines are not rows of numbers and were left out "
            f"(first: line {info[1]})"
        )


def _refuse_if_mostly_bad(path: str, info: np.ndarray, n_rows: int) -> None:
    if info[0] > max(1, MAX_BAD_SHARE * (n_rows + info[0])):
        raise FormatError(
            f"{path}: {info[0]} of the first {n_rows + info[0]} lines are not rows of numbers like "
            "the others "
            f"(first: line {info[1]}). Save the scan as plain x y z columns with one delimiter."
        )


def open_text(path: str, *, decimal: str | None = None) -> Source:
    """Open a text file of points, guessing delimiter, decimal mark, header and columns from its "
    "first lines."""
    lines = sample_lines(path)
    layout, notes = guess_layout(lines, path, decimal)
    source = Source(iter(()), notes=notes, names=dict(layout.columns.names))
    source.chunks = parse_rows(path, layout, skip_lines=layout.header_lines, notes=source.notes)
    return source


def sample_lines(path: str) -> list[str]:
    """The first lines of a text file, without the one that the sample cuts."""
    with open(path, "rb") as file:
        raw = file.read(SAMPLE)
    encoding = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    whole = os.path.getsize(path) <= SAMPLE
    text = raw.decode(encoding, errors="replace")
    lines = re.split(r"\r\n|\n|\r", text)
    if not whole and len(lines) > 1:
        lines = lines[:-1]
    return lines


def guess_layout(lines: list[str], path: str, decimal: str | None = None) -> tuple[Layout, list[str]]:
    """Decide how `lines`, the first of a file, are to be read.

    Raises
    ------
    FormatError
        If no line holds three numbers, or the decimal mark cannot be told.
    """
    first = _first_row(lines, path)
    rows = [line for line in lines[first:] if line.strip() and not line.strip().startswith(COMMENT)]
    delimiter, mark = _guess_marks(rows, path, decimal, _header_names(lines[:first], None))
    table = [split_line(line, delimiter) for line in rows]
    n_columns = _most_common([len(t) for t in table])
    table = [t for t in table if len(t) == n_columns]
    names = _header_names(lines[:first], delimiter)
    worded = [line.strip() for line in lines[:first] if re.search("[A-Za-z]", line)]
    is_comment = bool(worded) and worded[-1].startswith(COMMENT)
    columns, notes = _choose_columns(names, table, n_columns, mark, path, is_comment)
    return Layout(delimiter, mark, columns, n_columns, first), notes


def split_line(line: str, delimiter: str) -> list[str]:
    """The fields of a line, without quotes and blanks around them."""
    parts = line.split() if delimiter == " " else line.rstrip().split(delimiter)
    parts = [p.strip().strip("\"'").strip() for p in parts]
    if delimiter != " " and parts and parts[-1] == "":
        parts.pop()
    return parts


def _most_common(counts: list[int]) -> int:
    values, times = np.unique(counts, return_counts=True)
    return int(values[times.argmax()])


def _is_number(word: str) -> bool:
    return bool(_NUMBER.match(word))


def _looks_numeric(line: str) -> bool:
    """Whether a line, split at anything, is three numbers or more and no words."""
    words = [w.strip("\"'") for w in re.split(r"[\s;|]+|,(?=\s)|,(?=[-+\d.\"])", line.strip()) if w]
    numbers = sum(_is_number(w) for w in words)
    return (
        numbers >= 3
        and all(_is_number(w) or _MISSING.match(w) for w in words[:3])
        and numbers * 2 >= len(words)
    )


def _first_row(lines: list[str], path: str) -> int:
    """Index of the first line of numbers."""
    for i, line in enumerate(lines[: MAX_HEADER_LINES + 1]):
        if _looks_numeric(line):
            return i
    seen = next((line.strip() for line in lines if line.strip()), "")
    raise FormatError(
        f"{path}: no line of three or more numbers in the first {min(len(lines), MAX_HEADER_LINES)} lines "
        f"(the first is {seen[:40]!r}). A text scan needs one point a line: x y z."
    )


def _header_names(lines: list[str], delimiter: str | None) -> list[str]:
    """Column names from the last line before the numbers that has words; empty if there is none."""
    for line in reversed(lines):
        text = line.strip()
        for sign in COMMENT:
            text = text.removeprefix(sign)
        text = text.strip()
        if not re.search(r"[A-Za-z]", text):
            continue
        if delimiter not in (None, " ") and delimiter in text:
            names = text.split(delimiter)
        elif '"' in text:
            names = re.findall(r'"([^"]*)"', text)
        else:
            names = re.split(r"[\s,;|]+", text)
        names = [n.strip().strip("\"'") for n in names]
        if all(_MISSING.match(n) or _is_number(n) for n in names):
            continue
        return names
    return []


def _guess_marks(rows: list[str], path: str, decimal: str | None, names: list[str]) -> tuple[str, str]:
    """Delimiter and decimal mark of `rows`."""
    for delimiter in (";", "|", "\t"):
        if all(row.count(delimiter) >= 2 for row in rows):
            return delimiter, decimal or _mark_within(rows, delimiter, path)
    if not any("," in row for row in rows):
        return " ", decimal or "."
    blank = [row.split() for row in rows]
    if all(len(words) >= 3 for words in blank):
        trailing = any(w.endswith(",") or w.startswith(",") for words in blank for w in words)
        if not trailing:
            return " ", decimal or _mark_within(rows, " ", path)
        if any(re.search(r"\d,\d", row) for row in rows) and not any("." in row for row in rows):
            raise FormatError(
                f"{path}: commas stand both inside numbers and between them ({_shown(rows)}). "
                "Save the scan with ';' or blanks between the columns."
            )
    return _bare_commas(rows, path, decimal, names)


def _shown(rows: list[str]) -> str:
    return repr(rows[0].strip()[:40])


def _mark_within(rows: list[str], delimiter: str, path: str) -> str:
    """Decimal mark where the delimiter is known not to be the comma."""
    dots = any("." in row for row in rows)
    commas = any("," in row for row in rows)
    if dots and commas:
        raise FormatError(
            f"{path}: numbers with both commas and points in them ({_shown(rows)}); thousands separators "
            "are not read. Save the scan without them."
        )
    return "," if commas else "."


def _bare_commas(rows: list[str], path: str, decimal: str | None, names: list[str]) -> tuple[str, str]:
    """Only commas separate: they can hardly be decimal marks too."""
    if decimal == ",":
        raise FormatError(
            f"{path}: the comma cannot be both the decimal mark and the delimiter. "
            "Save the scan with ';' between the columns."
        )
    most = max(len(split_line(row, ",")) for row in rows)
    spaced = any(re.search(r",\s", row) for row in rows)
    unclear = decimal is None and not spaced and not any("." in row for row in rows)
    if unclear and most >= 6 and most % 2 == 0 and len(names) != most:
        raise FormatError(
            f"{path}: {_shown(rows)} could be {most} whole numbers or {most // 2} numbers with "
            "decimal commas. "
            "Save the scan with ';' or blanks between the columns, or name all columns in a header."
        )
    return ",", "."


def _choose_columns(
    names: list[str], table: list[list[str]], n_columns: int, mark: str, path: str, is_comment: bool
) -> tuple[ColumnMap, list[str]]:
    """Which column is what, from the header or, without one, from the values."""
    notes: list[str] = []
    if len(names) == n_columns - 1 and map_columns(names).xyz:
        names = ["index", *names]  # the header of R's write.table leaves the row names out
    if names and len(names) >= min(n_columns, 3):
        columns = map_columns(names)
        if columns.xyz is not None and max(columns.xyz) < n_columns:
            columns.extra = {k: v for k, v in columns.extra.items() if max(v) < n_columns}
            if columns.unclear:
                notes.append(
                    f"column {', '.join(columns.unclear)} was not used: its name does not say what it means"
                )
            return columns, notes
        if len(names) == n_columns and not all(_GENERIC.match(name) for name in names):
            named = ", ".join(names)[:60]
            if not is_comment:
                raise FormatError(
                    f"{path}: the header names the columns {named}, but none x, y and z. "
                    "Rename those that hold the coordinates."
                )
            notes.append(
                f"the header ({named}) does not name x, y and z; the first three columns were read as such"
            )
    if n_columns < 3:
        raise FormatError(f"{path}: lines have {n_columns} columns, but a point needs x, y and z.")
    return _guess_columns(table, n_columns, mark, notes), notes


def _guess_columns(table: list[list[str]], n_columns: int, mark: str, notes: list[str]) -> ColumnMap:
    """Columns of a file without header: x y z, then colours if three columns look like them."""
    values = np.array([[_to_float(w, mark) for w in row] for row in table])
    first = 0
    if n_columns > 3 and len(values) >= MIN_SAMPLE_ROWS and _counts(values[:, 0]):
        first = 1
        notes.append("the first column counts the lines and was left out")
    columns = ColumnMap((first, first + 1, first + 2))
    for c in range(first + 3, n_columns - 2):
        block = values[:, c : c + 3]
        if (
            np.isfinite(block).all()
            and (block == np.round(block)).all()
            and block.min() >= 0
            and 1 < block.max() <= 255
        ):
            columns.extra["color"] = (c, c + 1, c + 2)
            if c == first + 4:
                columns.extra["intensity"] = (first + 3,)
            break
    used = {0} if first else set()
    used |= {*(columns.xyz or ()), *(i for where in columns.extra.values() for i in where)}
    unused = [str(i + 1) for i in range(n_columns) if i not in used]
    if unused:
        notes.append(f"column {', '.join(unused)} has no name and was not used")
    return columns


def _counts(column: np.ndarray) -> bool:
    """Whether a column holds consecutive whole numbers."""
    return bool((np.diff(column) == 1).all() and column[0] == np.round(column[0]))


def _to_float(word: str, mark: str) -> float:
    try:
        return float(word.replace(",", ".") if mark == "," else word)
    except ValueError:
        return float("nan")
