"""What the commands say: results to stdout, everything else to stderr."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from sapwood._version import SCHEMA_VERSION, __version__
from sapwood.text import encodable, to_json, visible

__all__ = ["Terminal"]


class Terminal:
    """Where a command's words go.

    Parameters
    ----------
    as_json : bool
        Results are one JSON object; plain ones are left out.
    quiet : bool
        Only errors are said, and no results but JSON.
    verbose : bool
        Tracebacks too.
    """

    def __init__(self, *, as_json: bool = False, quiet: bool = False, verbose: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet
        self.verbose = verbose
        self._said: set[str] = set()
        self._progress: Any = None
        self._held: list[str] = []

    def result(self, text: str) -> None:
        """A line of the result, for people; while a bar is drawn it waits."""
        if self.as_json or self.quiet:
            return
        if self._progress is not None:
            self._held.append(text)
        else:
            _print(visible(text) + "\n")

    def json(self, command: str, **fields: Any) -> None:
        """The result, for machines."""
        if self.as_json:
            said = {"schema_version": SCHEMA_VERSION, "command": command, "version": __version__, **fields}
            _print(to_json(said, sys.stdout.encoding))

    def log(self, text: str) -> None:
        """What is going on."""
        if not self.quiet:
            self._write(visible(text))

    def note(self, text: str) -> None:
        """A remark on the input."""
        self.log(f"note: {text}")

    def notice(self, text: str) -> None:
        """A remark on this machine; said once."""
        if text not in self._said:
            self._said.add(text)
            self.note(text)

    def warn_of_compiling(self) -> None:
        """Say, to someone who waits at a terminal, why the first run on a machine takes its time."""
        from sapwood import kernels

        if not kernels.can_keep():
            self.notice(
                f"compiled kernels cannot be kept; name a folder for them with {kernels.PLACE_VARIABLE}"
            )
        elif self.shows_progress and not kernels.kept():
            self.notice("the first run compiles its kernels, which takes a minute or two; once")

    def error(self, text: str, trace: str = "") -> None:
        """What went wrong; said even when quiet."""
        if trace and self.verbose:
            self._write(trace.rstrip())
        self._write(f"error: {visible(text)}")

    @property
    def shows_progress(self) -> bool:
        """Whether progress is drawn rather than logged."""
        return sys.stderr.isatty() and not self.quiet

    @contextmanager
    def progress(self, total: int | None, what: str) -> Iterator[Progress]:
        """A bar over `total` things, or a line that turns if that is None, while the block runs."""
        if not self.shows_progress:
            yield Progress(None, None)
            return
        from rich import progress as rich
        from rich.console import Console

        columns = [rich.SpinnerColumn(), rich.TextColumn("{task.description}", markup=False)]
        if total is not None:
            columns += [rich.BarColumn(), rich.MofNCompleteColumn(), rich.TimeRemainingColumn()]
        bar = rich.Progress(*columns, console=Console(stderr=True), transient=True)
        with bar:
            self._progress = bar
            try:
                yield Progress(bar, bar.add_task(what, total=total))
            finally:
                self._progress = None
        held, self._held = self._held, []
        for line in held:
            self.result(line)

    def _write(self, text: str) -> None:
        """A line to stderr. Where that cannot be (a full disk, a closed pipe) the work goes on."""
        text = encodable(text, sys.stderr.encoding)
        try:
            if self._progress is not None:
                self._progress.console.print(text, markup=False, highlight=False, soft_wrap=True)
            else:
                sys.stderr.write(text + "\n")
                sys.stderr.flush()
        except OSError:
            _send_nowhere(sys.stderr)


def _print(text: str) -> None:
    """Write to stdout; once its reader has gone (``| head -1``) nothing more, and the work goes on."""
    try:
        sys.stdout.write(encodable(text, sys.stdout.encoding))
        sys.stdout.flush()
    except BrokenPipeError:
        _send_nowhere(sys.stdout)
    except OSError as error:
        from treegraph.errors import InputError

        _send_nowhere(sys.stdout)
        raise InputError(f"standard output: cannot be written ({error.strerror}).") from None


def _send_nowhere(stream: TextIO) -> None:
    """Let a stream that cannot be written end in the null device, what it holds back included."""
    with contextlib.suppress(OSError):  # it is no file of the system, as in tests
        number = stream.fileno()
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, number)
        os.close(null)


class Progress:
    """A bar that is drawn, or nothing."""

    def __init__(self, bar: Any, task: Any) -> None:
        self._bar = bar
        self._task = task

    def advance(self) -> None:
        """One thing is done."""
        if self._bar is not None:
            self._bar.advance(self._task)

    def say(self, text: str) -> None:
        """What is being done."""
        if self._bar is not None:
            self._bar.update(self._task, description=text)
