"""Errors that a user can cause and cure.

The text of an error is one line. It says where the error happened (file, line or field), what is wrong, and how to cure
it. The command line prints the text and exits with code 2. The user never sees a traceback for such an error.
"""

import errno
import re

#: Longest text of an error; the middle of a longer one is left out, so that the place and the cure stay.
_LONGEST = 1000
# Characters that steer a terminal, end a line, or turn the direction of what follows.
_STEERS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+")


def harmless(text: str) -> str:
    """The lines of a text with spaces in place of what would steer a terminal; names in files may hold anything."""
    return "\n".join(_STEERS.sub(" ", line) for line in text.split("\n"))


class SugiyamaError(Exception):
    """Base class of all errors that a user can cause.

    Parameters
    ----------
    text : str
        What the user reads. Names from files may be in it: control characters, such as ends of lines, become spaces,
        and the middle of a very long text is left out.
    """

    def __init__(self, text: str) -> None:
        line = _STEERS.sub(" ", text)
        half = _LONGEST // 2
        super().__init__(line if len(line) <= _LONGEST else f"{line[:half]} ... {line[-half:]}")


class InputError(SugiyamaError):
    """An input cannot be used: a file, a line of a file, an option or an argument."""


class OutputError(SugiyamaError):
    """An output cannot be written to the place that the user asked for."""


def cure_of_place(error: OSError | ValueError) -> str:
    """Say what to do where a file cannot be written; a ValueError is of a name with a zero byte."""
    is_name = isinstance(error, ValueError) or error.errno in (errno.ENOENT, errno.ENAMETOOLONG)
    return "check the name" if is_name else "free some space there, or choose another place"


def nowhere_to_compile(error: Exception) -> str | None:
    """Say what to do where numba can keep compiled code nowhere.

    Parameters
    ----------
    error : Exception
        What an import has raised.

    Returns
    -------
    str or None
        One line; None for any other error.
    """
    if not (isinstance(error, RuntimeError) and "no locator available" in str(error)):
        return None
    return (
        "compiled code can be kept neither in the installation nor in the home directory; set NUMBA_CACHE_DIR to a"
        " directory that can be written"
    )
