"""What Ctrl-C and SIGTERM do: libraries that load may swallow the KeyboardInterrupt, and compilers do not hear it."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

#: Signals that have come since ``remember``.
came: list[int] = []
# Time [s] after which an interrupt that nobody handles is raised again, and that a compiler gets to come to its end.
_AGAIN_S, _GRACE_S = 0.2, 1.0
_INTERRUPTED = 130
# An entry for each function that is being compiled.
_compiled: list[None] = []
# Where signals are written to for the thread that watches for them, while it does.
_watching: list[tuple[int, threading.Thread]] = []


def remember() -> None:
    """Remember SIGINT and SIGTERM, which raise KeyboardInterrupt until somebody handles it; see ``settled``."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
        signal.signal(signal.SIGALRM, _again)
        _watch()
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        # what has been begun is removed, as after Ctrl-C
        signal.signal(signal.SIGTERM, _interrupt)


def settled() -> None:
    """Raise no interrupt again: the program ends, or somebody else watches ``came``."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    while _watching:
        send, watcher = _watching.pop()
        other = signal.set_wakeup_fd(-1)
        if other not in (-1, send):  # of an event loop
            signal.set_wakeup_fd(other)
        os.close(send)
        watcher.join(_AGAIN_S)


@contextmanager
def compiling() -> Iterator[None]:
    """Mark a block that only compiles: an interrupt that is not heard in it ends the program."""
    _compiled.append(None)
    try:
        yield
    finally:
        _compiled.pop()


def _watch() -> None:
    """Watch for signals in a thread of its own: compilers keep the main thread, which alone can raise an exception."""
    receive, send = os.pipe()
    os.set_blocking(send, False)
    signal.set_wakeup_fd(send, warn_on_full_buffer=False)
    watcher = threading.Thread(target=_end_compilation, args=(receive,), daemon=True)
    watcher.start()
    _watching.append((send, watcher))


def _end_compilation(receive: int) -> None:
    """End the program where an interrupt has come and, a moment later, something is still being compiled."""
    while numbers := os.read(receive, 64):
        for number in {signal.SIGINT, signal.SIGTERM}.intersection(numbers):
            time.sleep(_GRACE_S)
            if _compiled and signal.getsignal(number) in (_interrupt, signal.SIG_DFL):  # nobody else handles it
                if os.isatty(2):
                    os.write(2, b"\r\x1b[2K\x1b[?25h")  # a bar of progress has hidden the cursor
                os._exit(_INTERRUPTED)
    os.close(receive)


def _interrupt(number: int, frame: FrameType | None) -> None:
    came.append(number)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S, _AGAIN_S)
    signal.default_int_handler(number, frame)


def _again(number: int, frame: FrameType | None) -> None:
    # an exception that is being handled may be the interrupt itself, on its way out
    if sys.exc_info()[0] is None:
        raise KeyboardInterrupt
