"""Run the same work in one process, in several, or on a Dask cluster; the results are the same."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import active_children, get_context, parent_process

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from vpp_fmu.errors import BadInput, WorkerLost
from vpp_fmu.stopping import SIGNALS, unbroken


def spread(work: Callable, items: Iterable, workers: int = 1, scheduler: str | None = None, what: str = "") -> list:
    """`[work(item) for item in items]`, in order. `work` and the items must be picklable and bring their own seeds.

    `scheduler`: address of a Dask scheduler; None: `workers` processes. These end with this call, and with this process,
    however either ends. `what` heads the progress bar on a terminal. BadInput if Dask isn't installed or doesn't answer,
    WorkerLost if a process has died.
    """
    items, work = list(items), partial(_on_one_thread, work)
    if scheduler is not None:
        return _on_dask(work, items, scheduler, what)
    if workers <= 1:
        return [work(item) for item in tqdm(items, desc=what, disable=None, leave=False)]
    # Not fork: a forked child inherits the threads of numerical libraries in an arbitrary state.
    others = set(active_children())
    with _deaf():
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        with _deaf():
            # Not `map`: it cancels pending items as it ends, and the pool fails on a cancelled item whose worker is killed.
            futures = [pool.submit(work, item) for item in items]
        return [future.result() for future in tqdm(futures, desc=what, disable=None, leave=False)]
    except BrokenProcessPool as error:
        raise WorkerLost(f"{what or 'work'}: one of {workers} processes has died: killed, or short of memory?") from error
    except BaseException:
        for process in set(active_children()) - others:
            process.kill()  # else it would finish its current item
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _on_one_thread(work: Callable, item):
    """`work(item)` with one thread of BLAS, wherever it runs: with more, sums round differently, and a Dask worker has one."""
    with threadpool_limits(1):
        return work(item)


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Block signals while processes are started: the pool's workers, and a tracker of their shared resources. They inherit
    this, so that a signal to all (Ctrl-C, a closed terminal) reaches this process only. A signal that arrives meanwhile waits,
    even if another thread receives it: during a start it would leave half a worker."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    with unbroken():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """Initialise a worker so that it ends with its parent process, even if a SIGKILL ends the parent."""
    threading.Thread(target=_wait_for_parent, name="parent", daemon=True).start()


def _wait_for_parent() -> None:
    parent_process().join()
    os._exit(1)


def _on_dask(work: Callable, items: Sequence, scheduler: str, what: str) -> list:
    try:
        from dask.distributed import Client  # noqa: PLC0415  (an extra)
    except ImportError as error:
        raise BadInput(
            "command line", "--scheduler", "no dask.distributed", "the library, installed", "pip install 'vpp-fmu[dask]'"
        ) from error
    try:
        with Client(scheduler, timeout=10) as client:
            futures = client.map(work, items)
            return [future.result() for future in tqdm(futures, desc=what, disable=None, leave=False)]
    except OSError as error:
        raise BadInput("command line", "--scheduler", scheduler, "the address of a Dask scheduler that answers") from error
