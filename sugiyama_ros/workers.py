"""Who carries out work that falls into independent parts: threads, processes here, or a Dask cluster elsewhere."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

from sugiyama_ros.errors import InputError
from sugiyama_ros.progress import OnStage

# Items that are under way at the same time, all on the same workers.
_AT_ONCE = 3
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
# From so many parts on processes, which do not wait for each other's Python, are worth their start.
_MANY = 500


@contextmanager
def workers(parts: int, scheduler: str | None = None) -> Iterator[Executor]:
    """An executor for ``parts`` parts of work: of this machine, or of the Dask cluster at ``scheduler``.

    Raises InputError where Dask is not installed or the scheduler does not answer.
    """
    if scheduler is not None:
        with _cluster(scheduler) as executor:
            yield executor
        return
    cores = len(os.sched_getaffinity(0))
    local: Executor = (
        ThreadPoolExecutor(cores) if parts < _MANY else ProcessPoolExecutor(cores, mp_context=get_context("spawn"))
    )
    with local:
        yield local


@contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--scheduler: Dask is not installed; pip install 'sugiyama_ros[dask]'") from None
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: {str(error).splitlines()[0]}; is it running?") from None
    with client:
        # a worker that dies is replaced by another one: the parts are pure functions of what is sent with them
        yield client.get_executor(pure=False, retries=3)


def at_once(
    function: Callable[[_Item], _Result], items: Sequence[_Item], what: str, on_progress: OnStage
) -> list[_Result]:
    """Results of a function for all items; while one item waits for its filters, another uses the processors."""
    results = []
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for k, result in enumerate(pool.map(function, items)):
            on_progress(what, k + 1, len(items))
            results.append(result)
    return results
