"""The same work on one process, several, or a Dask cluster: the results do not depend on which."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from tqdm import tqdm

from vpp_fmu.errors import BadInput


def spread(work: Callable, items: Iterable, workers: int = 1, scheduler: str | None = None, what: str = "") -> list:
    """`[work(item) for item in items]`, in order. `work` and the items must be picklable and bring their own seeds.

    `scheduler`: address of a Dask scheduler, else `workers` processes. `what` heads the progress bar on a terminal.
    BadInput where Dask isn't installed or doesn't answer.
    """
    items = list(items)
    if scheduler is not None:
        return _on_dask(work, items, scheduler, what)
    if workers <= 1:
        return [work(item) for item in tqdm(items, desc=what, disable=None, leave=False)]
    # Not fork: a forked child inherits threads of numerical libraries in whatever state they are.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(tqdm(pool.map(work, items), total=len(items), desc=what, disable=None, leave=False))


def _on_dask(work: Callable, items: Sequence, scheduler: str, what: str) -> list:
    try:
        from dask.distributed import Client  # noqa: PLC0415  (an extra)
    except ImportError as error:
        raise BadInput("command line", "--scheduler", "no dask.distributed here", "an installed extra 'dask'") from error
    try:
        with Client(scheduler, timeout=10) as client:
            futures = client.map(work, items)
            return [future.result() for future in tqdm(futures, desc=what, disable=None, leave=False)]
    except OSError as error:
        raise BadInput("command line", "--scheduler", scheduler, "the address of a Dask scheduler that answers") from error
