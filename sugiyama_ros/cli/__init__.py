"""The command line: ``sugiyama``. Arguments in, a table or one JSON document out; other rooms do the work.

Tables and documents go to stdout, everything else to stderr. An error that a user can correct ends the program with one
line and exit code 2, Ctrl-C with exit code 130. This file imports nothing that takes long, so that Ctrl-C while the
commands are loaded ends the program in good order too.
"""

import os
import signal
import sys
from contextlib import suppress

from sugiyama_ros import interrupts
from sugiyama_ros.errors import SugiyamaError, cure_of_place, nowhere_to_compile

_FAILED, _REFUSED, _INTERRUPTED = 1, 2, 130


def main() -> None:
    """Entry point of the console script."""
    try:
        _open_standard_streams()
        interrupts.remember()
        # The work is shared out over drivers. Threads of the linear algebra would only take processor time from it.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        sys.unraisablehook = _say_unless_half_made
        code = _run()
        sys.stdout.flush()
    except SugiyamaError as error:
        code = _refused(str(error))
    except KeyboardInterrupt:
        _end_at_once()
        code = _INTERRUPTED
    except BrokenPipeError:  # the program that reads the output has closed it
        code = _FAILED
    except Exception as error:
        reason = _cause_outside(error)
        if reason is None:
            raise
        code = _refused(reason)
    _end_at_once()
    _flush_or_drop()
    sys.exit(code)


def _end_at_once() -> None:
    """Let another Ctrl-C end the program without a word: all files are written, or removed."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    interrupts.settled()


def _run() -> int | str | None:
    """Run the command, and return its exit code."""
    from sugiyama_ros import files
    from sugiyama_ros.cli.app import app

    try:
        with files.remembered():
            app()
    except SystemExit as end:
        return end.code
    return 0


def _say_unless_half_made(error: "sys.UnraisableHookArgs") -> None:
    """Say nothing of an object that was half made when Ctrl-C came, nor of a Ctrl-C that is raised again."""
    half_made = isinstance(error.exc_value, AttributeError) and getattr(error.object, "__name__", "") == "__del__"
    if not half_made and not isinstance(error.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(error)


def _cause_outside(error: Exception) -> str | None:
    """What the user reads where the system refused something; None for an error of the program itself."""
    if isinstance(error, OSError) and error.errno is not None:
        where = error.filename if error.filename is not None else "the output"
        return f"{where}: {error.strerror or error}; {cure_of_place(error)}"
    if (reason := nowhere_to_compile(error)) is not None:
        return reason
    if isinstance(error, ZeroDivisionError) and (names := _effects_of_others()):
        return (
            f"an effect divides by zero; effects of other packages here: {', '.join(names)}; a function must"
            " have a value for every speed and gap, such as 0 (docs/howto/effect.md)"
        )
    if isinstance(error, MemoryError):
        return "not enough memory; give less data, or fewer vehicles"
    limit = limit_bytes()
    if limit is None:
        return None
    # Without memory, libraries fail in ways of their own.
    said = (str(error).splitlines() or [""])[0]
    return f"ulimit -v: {limit >> 20} MB of memory may be too little ({type(error).__name__}: {said}); allow more"


def limit_bytes() -> int | None:
    """Address space that the program may take; None without a limit."""
    import resource

    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if soft == resource.RLIM_INFINITY else soft


def _effects_of_others() -> list[str]:
    """Names of the effects that come from other packages."""
    from sugiyama_ros.effects.registry import GROUP
    from sugiyama_ros.plugins import FAILED, entry_points

    return [point.name for point in entry_points(GROUP) if (GROUP, point.name) not in FAILED]


def _refused(reason: str) -> int:
    with suppress(OSError):  # the disk of a log may be full too
        print(f"error: {reason}", file=sys.stderr)
    return _REFUSED


def _open_standard_streams() -> None:
    """Give the program the streams that its caller has closed, and print characters that the terminal lacks as codes.

    Without it, the first file that is opened would stand in the place of stdout.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free, which is this one
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _flush_or_drop() -> None:
    """Flush both streams. What cannot be written is dropped, so that the interpreter does not try again at its end."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
