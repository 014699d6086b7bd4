"""Many scans on several processes: one that fails, or dies, does not stop the others."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from sapwood.text import one_line
from treegraph.errors import FitError, FormatError, InputError

__all__ = ["DIED", "DONE", "INPUT", "INTERNAL", "Job", "Outcome", "guarded", "run_batch", "run_job"]

DONE, INPUT, INTERNAL, DIED = "done", "input", "internal", "died"

GRACE = 5.0
"""Seconds that a worker has to clean up after itself before it is killed."""

_COMMON_DEATHS = {
    int(signal.SIGKILL): "killed from outside, most often for lack of memory; try fewer --jobs",
    int(signal.SIGSEGV): "crashed in compiled code",
}


@dataclass(frozen=True)
class Job:
    """One scan to be done.

    Attributes
    ----------
    scan, name, folder : str
        The file, the name of its outputs and where they go.
    staging : str
        Where its files are made before they appear.
    options : mapping
        For :func:`sapwood.reconstruct`.
    saving : mapping
        For :func:`sapwood.saving.save`.
    """

    scan: str
    name: str
    folder: str
    staging: str
    options: Mapping[str, Any] = field(default_factory=dict)
    saving: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """What came of a job.

    Attributes
    ----------
    job : Job
    kind : str
        ``"done"``, ``"input"`` (the scan or an argument is at fault), ``"internal"`` (Sapwood is) or
        ``"died"`` (its process came to an end).
    message : str
        One line, if it failed.
    trace : str
        Traceback of an internal fault.
    report : dict or None
        What is in its report, if it is done.
    notices : tuple of str
        Remarks on this machine.
    """

    job: Job
    kind: str
    message: str = ""
    trace: str = ""
    report: dict[str, Any] | None = None
    notices: tuple[str, ...] = ()


def run_job(job: Job, progress: Callable[[str], object] | None = None) -> Outcome:
    """Reconstruct a scan and save what came of it; every failure but an interruption is an outcome."""

    def work() -> Outcome:
        from sapwood.pipeline import reconstruct
        from sapwood.saving import save

        tree = reconstruct(job.scan, name=job.name, progress=progress, **job.options)
        if progress is not None:
            progress("write")
        saved = save(tree, job.folder, staging=job.staging, **job.saving)
        return Outcome(job, DONE, report=saved.report, notices=saved.notices)

    return guarded(job, work)


def guarded(job: Job, work: Callable[[], Outcome]) -> Outcome:
    """Return what `work` returns, or if it fails an outcome that says how; interruptions go through."""
    try:
        return work()
    except (InputError, FormatError, FitError) as error:
        return Outcome(job, INPUT, one_line(error))
    except OSError as error:
        where = error.filename or job.folder or job.scan
        return Outcome(job, INPUT, f"{where}: {error.strerror or one_line(error)}.")
    except MemoryError:
        advice = "memory ran out; thin the scan with --max-points, or use fewer --jobs."
        return Outcome(job, INPUT, f"{job.scan}: {advice}")
    except Exception as error:  # noqa: BLE001 - a bug in one scan must not stop the others; it is reported
        message = f"{job.scan}: {type(error).__name__}: {one_line(error)}"
        return Outcome(job, INTERNAL, message, trace=traceback.format_exc())


def run_batch(
    jobs: Sequence[Job], n_workers: int, work: Callable[[Job], Outcome] = run_job
) -> Generator[Outcome, None, None]:
    """Do jobs on `n_workers` processes and yield what comes of each as it ends.

    `work` is what a process does with a job; it must be importable there.

    The files of a job do not depend on `n_workers`. A process that dies fails the job that it was at;
    another one takes its place. Leaving the iteration early ends the processes.
    """
    pending = deque(jobs)
    workers: list[_Worker] = []
    try:
        while pending or workers:
            while pending and len(workers) < n_workers:
                workers.append(_Worker(work, pending.popleft()))
            ready = wait([worker.connection for worker in workers])
            for worker in [w for w in workers if w.connection in ready]:
                outcome = worker.receive()
                if outcome.kind == DIED or not pending:
                    workers.remove(worker)
                    worker.stop()
                else:
                    worker.give(pending.popleft())
                yield outcome
    finally:
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.stop()


class _Worker:
    """A process that does one job after the other."""

    def __init__(self, work: Callable[[Job], Outcome], job: Job) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, work), daemon=True)
        with _deaf_to_interrupts():
            self.process.start()
        other.close()  # so that the end of the process is the end of the connection
        self.give(job)

    def give(self, job: Job) -> None:
        self.job = job
        try:
            self.connection.send(job)
        except OSError:  # it has ended already, which receive() will see
            return

    def receive(self) -> Outcome:
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.process.join(GRACE)
            return Outcome(self.job, DIED, f"{self.job.scan}: {_cause(self.process.exitcode)}.")

    def stop(self) -> None:
        """End the process, gently if it lets us."""
        self.connection.close()
        self.process.join(GRACE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Processes started meanwhile never hear of Ctrl-C, which reaches all of a terminal; we decide."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # when it has to be started it lifts the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _cause(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"its process ended unexpectedly (status {exitcode})"
    known = _COMMON_DEATHS.get(-exitcode)
    return f"its process ended on signal {-exitcode}" + (f" ({known})" if known else "")


def _serve(connection: Connection, work: Callable[[Job], Outcome]) -> None:
    """Do the jobs that come; runs in the worker, which may be ended at any time: the parent tidies up."""
    os.dup2(sys.stderr.fileno(), 1)  # whatever a library prints must not mix with the parent's output
    while True:
        try:
            job = connection.recv()
        except (EOFError, OSError):
            return
        connection.send(work(job))
