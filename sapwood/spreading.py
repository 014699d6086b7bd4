"""Where the runs of a fit are done: here, on several processes, or on a Dask cluster."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sapwood.text import one_line
from treegraph.errors import InputError, SapwoodError

__all__ = ["Workplace", "open_workplace"]

DASK_SECONDS = 10.0  # that a scheduler has to answer
WATCH_SECONDS = 1.0
NEED_DASK = "--dask needs the package distributed; install it with: pip install 'sapwood[dask]'"


@dataclass(frozen=True)
class Workplace:
    """Who does the runs.

    Attributes
    ----------
    executor : concurrent.futures.Executor or None
        None: they are done here, one after the other.
    threads : int
        For each run.
    """

    executor: Executor | None = None
    threads: int = 1


@contextmanager
def open_workplace(runs: int, jobs: int, dask: str | None = None) -> Iterator[Workplace]:
    """Get processes or a cluster ready for so many runs.

    Parameters
    ----------
    runs : int
    jobs : int
        Processes, if there are several runs; threads, if there is one.
    dask : str, optional
        Address of a Dask scheduler, as in ``tcp://10.0.0.5:8786``; a file that it wrote with
        ``--scheduler-file`` does too.

    Raises
    ------
    InputError
        If `distributed` is not installed, the scheduler does not answer, has no workers, or what is done on
        the cluster fails.
    """
    if dask is not None:
        with _dask(dask) as executor:
            yield Workplace(executor)
    elif runs > 1 and jobs > 1:
        with _processes(min(runs, jobs)) as executor:
            yield Workplace(executor, max(1, jobs // runs))
    else:
        yield Workplace(None, jobs)


@contextmanager
def _processes(n: int) -> Iterator[Executor]:
    import multiprocessing
    from concurrent.futures.process import BrokenProcessPool

    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(n, mp_context=context, initializer=_settle_in, initargs=(os.getpid(),))
    try:
        yield pool
    except BrokenProcessPool:
        raise InputError(
            "a process of this fit came to an end, most often for lack of memory; try fewer --jobs"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _settle_in(parent: int) -> None:
    """Begin a process: Ctrl-C is the parent's to hear, and if that is killed this one ends too."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            threading.Event().wait(WATCH_SECONDS)
        os._exit(1)

    if hasattr(os, "getppid") and os.name == "posix":
        threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    try:
        import distributed
    except ModuleNotFoundError:
        raise InputError(NEED_DASK) from None
    client = _connect(distributed, address)
    try:
        if not client.scheduler_info()["workers"]:
            raise InputError(f"{address}: this Dask cluster has no workers yet; start some")
        yield client.get_executor(pure=False)
    except SapwoodError:
        raise
    except Exception as error:  # whatever a cluster answers with
        raise InputError(
            f"{address}: the fit failed on this Dask cluster ({type(error).__name__}: {one_line(error)}); "
            "its workers must have the same Sapwood and Python as this machine"
        ) from error
    finally:
        client.close()


def _connect(distributed: Any, address: str) -> Any:
    """A client; what the library says of its tries is kept back, as the error says it."""
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        where = {"scheduler_file": address} if os.path.isfile(address) else {"address": address}
        return distributed.Client(**where, timeout=DASK_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(
            f"{address}: no Dask scheduler answers there ({one_line(error) or type(error).__name__}); "
            "give its address, as in tcp://127.0.0.1:8786"
        ) from None
    finally:
        logger.setLevel(before)
