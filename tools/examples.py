"""The README's examples: run them, write their output anew, or compare it with what is printed.

An example is a code block that follows a line ``<!-- run -->``: a ``console`` block whose lines after ``$``
are commands, or a ``python`` block as in a Python session. They run in a folder that holds samples/ only.
``python tools/examples.py`` rewrites the blocks in README.md.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
README = ROOT / "README.md"
BLOCK = re.compile(r"^<!-- run -->\n```(console|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
TOLERANCE = 0.05  # share by which a printed number may differ: other machines round differently


@dataclass(frozen=True)
class Example:
    """One thing to type and what is printed then; `expected` ends with a new line unless it is empty."""

    source: str
    expected: str


def examples(kind: str, body: str) -> list[Example]:
    """Split a block into its examples."""
    if kind == "python":
        return [Example(e.source, e.want) for e in doctest.DocTestParser().get_examples(body)]
    parts = re.split(r"^\$ (.*)\n", body, flags=re.MULTILINE)
    return [Example(parts[k], parts[k + 1]) for k in range(1, len(parts), 2)]


@contextlib.contextmanager
def workplace() -> Iterator[Path]:
    """A folder with the samples in it, as the current one, while the block runs."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "samples").symlink_to(ROOT / "samples")
        os.chdir(name)
        try:
            yield Path(name)
        finally:
            os.chdir(before)


def run_console(commands: list[str]) -> list[str]:
    """Run each command in a shell and return what it wrote; commands of this installation come first."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    environment = {**os.environ, "PATH": path, "COLUMNS": "100", "NO_COLOR": "1", "PYTHONPATH": str(ROOT)}
    printed = []
    for command in commands:
        done = subprocess.run(
            ["/bin/sh", "-c", command], capture_output=True, text=True, env=environment, check=False
        )
        if done.returncode:
            raise RuntimeError(f"{command!r} ended with {done.returncode}: {done.stderr.strip()}")
        printed.append(done.stdout)
    return printed


def run_python(sources: list[str]) -> list[str]:
    """Run each statement as an interactive session would and return what it printed."""
    names: dict[str, object] = {}
    printed = []
    for source in sources:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(source, "<README>", "single"), names)
        printed.append(out.getvalue())
    return printed


def run(kind: str, found: list[Example]) -> list[str]:
    """Run the examples of one block."""
    sources = [example.source for example in found]
    return run_python(sources) if kind == "python" else run_console(sources)


def rewrite(kind: str, body: str, printed: list[str]) -> str:
    """Return the block with other outputs."""
    lines = []
    for example, output in zip(examples(kind, body), printed, strict=True):
        source = example.source.rstrip("\n").split("\n")
        first, more = (">>> ", "... ") if kind == "python" else ("$ ", "> ")
        lines += [first + source[0], *(more + line for line in source[1:])]
        lines += output.splitlines()
    return "\n".join(lines) + "\n"


def same(expected: str, got: str, tolerance: float = TOLERANCE) -> bool:
    """Whether two outputs are the same text with nearly the same numbers."""
    a, b = expected.strip(), got.strip()
    if re.sub(r"\s+", " ", NUMBER.sub("#", a)) != re.sub(r"\s+", " ", NUMBER.sub("#", b)):
        return False
    pairs = zip(NUMBER.findall(a), NUMBER.findall(b), strict=True)
    return all(math.isclose(float(x), float(y), rel_tol=tolerance, abs_tol=0.01) for x, y in pairs)


def main() -> None:
    """Command line."""
    text = README.read_text(encoding="utf-8")

    def renew(match: re.Match[str]) -> str:
        kind, body = match.groups()
        printed = run(kind, examples(kind, body))
        return f"<!-- run -->\n```{kind}\n{rewrite(kind, body, printed)}```"

    sys.path.insert(0, str(ROOT))
    with workplace():
        text = BLOCK.sub(renew, text)
    README.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
