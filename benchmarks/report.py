"""A stopwatch, and rows of figures as a text table and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any


def seconds_of(
    work: Callable[[], Any], repeats: int, clock: Callable[[], float] = process_time
) -> tuple[float, float]:
    """Least and median time of several runs, by default processor time, after one that compiles."""
    work()
    seconds = []
    for _ in range(repeats):
        start = clock()
        work()
        seconds.append(clock() - start)
    return min(seconds), median(seconds)


def format_value(value: Any) -> str:
    """One cell: floats with three significant digits, unknown as a dash."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return str(value)


def table(rows: Iterable[Mapping[str, Any]]) -> str:
    """A Markdown table; the columns are the keys of all rows, in the order they come."""
    rows = list(rows)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    if not columns:
        return "(nothing measured)"
    cells = [columns] + [[format_value(row.get(c)) for c in columns] for row in rows]
    width = [max(len(line[k]) for line in cells) for k in range(len(columns))]
    lines = [
        "| " + " | ".join(cell.ljust(w) for cell, w in zip(line, width, strict=True)) + " |" for line in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(lines)


def write_json(path: Path | None, name: str, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the rows under `name`; what the file holds under other names stays."""
    if path is None:
        return
    old = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    old[name] = list(rows)
    path.write_text(json.dumps(old, indent=1, default=float) + "\n", encoding="utf-8")
