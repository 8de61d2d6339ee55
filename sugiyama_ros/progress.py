"""How long work reports its progress: functions that a caller hands in, and bars that show it."""

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec

#: Called with how much is done, and how much there is in all.
OnProgress = Callable[[int, int], None]
#: Called with the name of the stage, how much of it is done, and how much there is in all.
OnStage = Callable[[str, int, int], None]
#: Called while a function is compiled, with its name; commands put a `CompilingTold` here.
on_compiling: OnStage | None = None
# Time [s] after which it is said that something is compiled, and after which it is said again.
_LONG_S, _AGAIN_S = 1.0, 5.0
# Time [s] between two lines where no bar can be shown, such as in a log.
_LINES_EVERY_S = 60.0


class CompilingTold:
    """Says on stderr that functions are compiled, where this takes long, and how far it is."""

    def __init__(self) -> None:
        self._began = self._told = -math.inf

    def __call__(self, what: str, done: int, total: int) -> None:
        """Say it, unless this function has begun a moment ago; arguments as of ``OnStage``."""
        now = time.monotonic()
        if done == 0:
            self._began = now
        if now - self._began > _LONG_S and now - self._told > _AGAIN_S:
            self._told = now
            share = f"{100 * done // total} % of {what}"
            print(f"compiling, once after an installation or an edit: {share}", file=sys.stderr)


@contextmanager
def stages() -> Iterator[OnStage]:
    """Show a bar for work in several stages, on a terminal or in a notebook; elsewhere a line a minute."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if console.is_jupyter and find_spec("ipywidgets") is None:
        # rich's bar needs widgets there
        yield _lines()
        return
    if not (console.is_terminal or console.is_jupyter):
        with _a_line_a_minute() as tell:
            yield tell
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task, current = bar.add_task("starting", total=None), ""

        def show(what: str, done: int, total: int) -> None:
            nonlocal current
            if what != current:
                # the time left is that of the stage
                bar.reset(task, total=None)
                current = what
            bar.update(task, description=what, completed=done, total=total or None)

        yield show


@contextmanager
def stage(what: str) -> Iterator[OnProgress]:
    """Show a bar for work in a single stage, of which nothing more is known before it is first called."""
    with stages() as advance:
        advance(what, 0, 0)
        yield lambda done, total: advance(what, done, total)


@contextmanager
def _a_line_a_minute() -> Iterator[OnStage]:
    """Print a line on stderr once a minute, also while a stage lasts; nothing in the first minute."""
    began, ended = time.monotonic(), threading.Event()
    now = ("starting", 0, 0)

    def note(what: str, done: int, total: int) -> None:
        nonlocal now
        now = what, done, total

    def tell() -> None:
        while not ended.wait(_LINES_EVERY_S):
            what, done, total = now
            share = f", {done} of {total}" if total > 1 else ""
            with suppress(OSError, ValueError):  # nobody reads stderr, or it is closed
                print(f"{what}{share}; {(time.monotonic() - began) / 60.0:.0f} min", file=sys.stderr, flush=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield note
    finally:
        ended.set()
        teller.join()


def _lines() -> OnStage:
    """Print one line for each stage."""
    told: set[str] = set()

    def tell(what: str, done: int, total: int) -> None:
        if what not in told:
            told.add(what)
            print(what, file=sys.stderr)

    return tell
