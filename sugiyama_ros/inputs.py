"""Which files a program has read, so that it never writes to one of them.

Files that a command reads beside the files that it is given count too: metadata, and the files of a folder. Code that
opens inputs calls `note`; the command line calls `note_given` for what it was given, read or not. Only the
command line remembers; in a notebook, a file that was read may be written.
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# A file is its device and its number there, whatever its names.
_Key = tuple[int, int]
_read: set[_Key] = set()
_own: set[_Key] = set()
_remembers = False


@contextmanager
def remembered() -> Iterator[None]:
    """Remember which files are read in the block, and forget them at its end; a command runs in such a block."""
    global _remembers
    _remembers = True
    try:
        yield
    finally:
        _remembers = False
        _read.clear()
        _own.clear()


def note(number: int) -> None:
    """Note that the program reads the file with a descriptor. A file that it has written itself does not count."""
    if _remembers and (key := _key(os.fstat(number))) not in _own:
        _read.add(key)


def note_given(path: Path) -> None:
    """Note that somebody has given a file as an input, whether the program reads it or not."""
    if _remembers:
        with suppress(OSError, ValueError):
            about = path.stat()
            if stat.S_ISREG(about.st_mode):
                _read.add(_key(about))


def note_own(number: int) -> None:
    """Note that the program has written the file with a descriptor."""
    if _remembers:
        _own.add(_key(os.fstat(number)))


def was_read(path: Path) -> bool:
    """Whether the program has read a file, under any of its names."""
    return bool(_read) and _key(path.stat()) in _read


def _key(about: os.stat_result) -> _Key:
    return about.st_dev, about.st_ino
