"""Work on several items at a time, and how far it has come."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

# Fits that are under way at the same time, all on the same workers.
_AT_ONCE = 3
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
#: Called with what is being done, and the steps done and to do.
OnProgress = Callable[[str, int, int], None]


def at_once(
    function: Callable[[_Item], _Result], items: Sequence[_Item], what: str, on_progress: OnProgress
) -> list[_Result]:
    """Results of a function for all items; while one item waits for its filters, another uses the processors."""
    results = []
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        for k, result in enumerate(pool.map(function, items)):
            on_progress(what, k + 1, len(items))
            results.append(result)
    return results
