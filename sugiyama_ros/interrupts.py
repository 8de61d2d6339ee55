"""Ctrl-C while a program loads: a library may swallow the KeyboardInterrupt, but the signal is remembered."""

import signal
from types import FrameType

#: Signals that have come since ``remember``.
came: list[int] = []


def remember() -> None:
    """Remember each SIGINT, which raises KeyboardInterrupt as before."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    came.append(number)
    signal.default_int_handler(number, frame)
