"""How many passes of the causal filter some work takes."""

import threading
import time
from collections.abc import Callable
from typing import Any
from unittest import mock

from sugiyama_ros.filters import causal
from sugiyama_ros.filters.causal import Observed, run


def counted(work: Callable[[], object]) -> tuple[int, float]:
    """Do some work and count the passes of the causal filter over the recording of one driver.

    Returns passes: number of passes; cpu_s: CPU time [s] of the work, over all threads.
    """
    lock, passes = threading.Lock(), 0

    def passes_of(observed: Observed, *others: Any) -> None:
        nonlocal passes
        with lock:
            passes += len(observed.position)
        run(observed, *others)

    with mock.patch.object(causal, "run", passes_of):
        began = time.process_time()
        work()
        return passes, time.process_time() - began
