"""The memory of a program: the limit that the shell sets (``ulimit -v``), and one heap for all threads."""

import contextlib
import ctypes

from sugiyama_ros.errors import InputError

#: Address space [bytes] below which libraries may end in an endless loop instead of an error.
_LEAST = 1 << 30
# Parameter of mallopt in glibc: the largest number of heaps.
_HEAPS = -8


def limit_bytes() -> int | None:
    """Address space that the program may take; None without a limit."""
    import resource

    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if soft == resource.RLIM_INFINITY else soft


def check_limit() -> None:
    """Raise InputError if the shell gives less address space than the libraries need."""
    limit = limit_bytes()
    if limit is not None and limit < _LEAST:
        raise InputError(f"ulimit -v: gives {limit >> 20} MB of memory; the commands need {_LEAST >> 20} MB or more")


def share_heap() -> None:
    """Let all threads share one heap: by default each has its own, and keeps what it has freed (glibc)."""
    # other C libraries have no mallopt
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(_HEAPS, 1)
