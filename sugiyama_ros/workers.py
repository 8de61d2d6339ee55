"""Executors for work in independent parts: threads or processes of this machine, or a Dask cluster."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

from sugiyama_ros.errors import InputError
from sugiyama_ros.progress import OnStage

# Number of items that are under way at the same time. They share the same workers.
_AT_ONCE = 3
# Number of tasks that are under way at the same time: more than a large cluster has workers.
_TASKS = 512
# Number of items that a process gets at a time, at first and with many items: each message takes as long as the making
# of an item. A process gets no more than this part of what was handed out before it, so that all have work at the end.
_CHUNK, _LARGE_CHUNK, _PART = 8, 32, 32
_Common = TypeVar("_Common")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
# From this number of parts on, processes are worth the time to start them: threads wait for each other's Python code.
_MANY = 500


@contextmanager
def workers(parts: int, scheduler: str | None = None) -> Iterator[Executor]:
    """Open an executor for work in independent parts, and close it at the end of the ``with`` block.

    Raises InputError.
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
    """Open an executor on the Dask cluster at ``scheduler``."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--scheduler: Dask is not installed; pip install distributed") from None
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError, TypeError) as error:  # TypeError: an encrypted connection without certificates
        why = (str(error).splitlines() or ["no answer"])[0]
        raise InputError(
            f"--scheduler {scheduler}: {why}; start it, and give host:port, such as tcp://localhost:8786"
        ) from None
    with client:
        # another worker can repeat the work of a worker that dies: a part depends only on the data sent with it
        yield client.get_executor(pure=False, retries=3)


@contextmanager
def helpers(scheduler: str | None = None) -> Iterator[int | Executor]:
    """Yield who helps with a diagnosis: the number of processors of this machine, or the executor of a Dask cluster.

    Raises InputError.
    """
    if scheduler is None:
        yield os.cpu_count() or 1
        return
    with _cluster(scheduler) as executor:
        yield executor


@contextmanager
def here_or_there(workers: int | Executor) -> Iterator[tuple[ThreadPoolExecutor, Executor | None]]:
    """Open threads of this machine, beside a cluster that may be there.

    Yields here: the threads; there: the cluster.
    """
    threads = workers if isinstance(workers, int) else len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(threads) as here:
        yield here, None if isinstance(workers, int) else workers


def send(
    there: Executor, function: Callable[[_Common, _Item], _Result], common: _Common, items: Iterable[_Item]
) -> list[Future[_Result]]:
    """Start work on a Dask cluster.

    function: called with ``common`` and one item.
    """
    from distributed import default_client

    sent: Any = default_client().scatter(common, broadcast=True)
    return [there.submit(function, sent, item) for item in items]


def ordered_map(
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    work: Executor | None,
) -> Iterator[_Result]:
    """Call a function for many items, of which only some are under way at a time.

    Neither this machine nor the scheduler of a cluster ever holds all items, and no task is large.

    items: the items, made when their turn comes.
    """
    if work is None:
        yield from map(function, items)
        return
    least, most = (_CHUNK, _LARGE_CHUNK) if isinstance(work, ProcessPoolExecutor) else (1, 1)
    left, size, handed_out = iter(items), least, 0
    under_way: deque[Future[list[_Result]]] = deque()
    while part := tuple(islice(left, size)):
        under_way.append(work.submit(_each, function, part))
        handed_out += len(part)
        size = min(max(least, handed_out // _PART), most)
        while len(under_way) * size >= _TASKS * least:
            yield from under_way.popleft().result()
    while under_way:
        yield from under_way.popleft().result()


def _each(function: Callable[[_Item], _Result], items: Iterable[_Item]) -> list[_Result]:
    return [function(item) for item in items]


def parallel_map(
    function: Callable[[_Item], _Result], items: Sequence[_Item], what: str, on_progress: OnStage
) -> list[_Result]:
    """Call a function for several items at the same time.

    While one item waits for its filters, another item uses the processors.

    what: name of the work, for ``on_progress``.
    """
    results = []
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for k, result in enumerate(pool.map(function, items)):
            on_progress(what, k + 1, len(items))
            results.append(result)
    return results
