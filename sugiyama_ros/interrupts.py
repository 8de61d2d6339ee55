"""Ctrl-C and SIGTERM while a program loads: a library may swallow the KeyboardInterrupt, so it is raised again."""

import signal
import sys
from types import FrameType

#: Signals that have come since ``remember``.
came: list[int] = []
# Time [s] after which an interrupt that nobody handles is raised again.
_AGAIN_S = 0.2


def remember() -> None:
    """Remember SIGINT and SIGTERM, which raise KeyboardInterrupt until somebody handles it; see ``settled``."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
        signal.signal(signal.SIGALRM, _again)
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        # what has been begun is removed, as after Ctrl-C
        signal.signal(signal.SIGTERM, _interrupt)


def settled() -> None:
    """Raise no interrupt again: the program ends, or somebody else watches ``came``."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def _interrupt(number: int, frame: FrameType | None) -> None:
    came.append(number)
    signal.setitimer(signal.ITIMER_REAL, _AGAIN_S, _AGAIN_S)
    signal.default_int_handler(number, frame)


def _again(number: int, frame: FrameType | None) -> None:
    # an exception that is being handled may be the interrupt itself, on its way out
    if sys.exc_info()[0] is None:
        raise KeyboardInterrupt
