"""Writing a file beside its place, and giving it its name only when it is complete."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from sugiyama_ros.errors import OutputError


@contextmanager
def replacing(path: Path, suffix: str = ".part") -> Iterator[BinaryIO]:
    """A stream into ``FILE`` with a suffix, renamed to ``path`` when the block ends, removed when it fails.

    Raises OutputError where the file cannot be written.
    """
    part = path.with_name(path.name + suffix)
    try:
        with part.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    except OSError as error:
        raise not_written(path, error) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def not_written(path: Path, error: OSError) -> OutputError:
    """The one line about a place that refuses to be written."""
    return OutputError(f"{path}: cannot be written: {error.strerror}; free some space there, or choose another place")


def make_directory(path: Path) -> None:
    """Make a directory if it is not there. Raises OutputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(path, error) from None
