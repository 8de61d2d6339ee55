"""Writing of files that get their name only when they are complete."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from sugiyama_ros.errors import OutputError


@contextmanager
def replacing(path: Path, suffix: str = ".part") -> Iterator[BinaryIO]:
    """Stream into a file with a suffix, which is renamed to ``path`` when the block ends and removed if it fails.

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
    """Error to raise for a place that cannot be written."""
    return OutputError(f"{path}: cannot be written: {error.strerror}; free some space there, or choose another place")


def make_directory(path: Path) -> None:
    """Make a directory if it does not exist. Raises OutputError."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(path, error) from None
