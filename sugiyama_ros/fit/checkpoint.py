"""Fits kept on disk during a long calibration, so that an interrupted calibration can continue."""

import json
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from sugiyama_ros.driver.parameters import COUNT
from sugiyama_ros.errors import OutputError
from sugiyama_ros.fit.driver import Fit
from sugiyama_ros.outputs import not_written, open_regular

#: Longest line [bytes] that is read; a fit takes less than 2 kB.
_LONGEST_LINE = 1 << 16


class Checkpoint:
    """A file with one JSON document per line: a description of the calibration, then every fit with the name of its
    pass.

    The checkpoint is a context manager. The caller removes the file once the fits are saved elsewhere.

    path: the file; about: description of the calibration; the fits in the file are used again only if the file has the
    same description; a checkpoint with another description is replaced. Raises OutputError.
    """

    def __init__(self, path: Path, about: dict[str, Any]) -> None:
        self.path = path
        self._about = about
        self._head = json.dumps(about, sort_keys=True).encode() + b"\n"
        self._fits: dict[str, dict[int, Fit]] = {}
        self._stream: BinaryIO | None = None

    def __enter__(self) -> "Checkpoint":
        try:
            try:
                self._stream = os.fdopen(open_regular(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL), "r+b")
            except FileExistsError:
                self._stream = os.fdopen(open_regular(self.path, os.O_RDWR), "r+b")
            self._go_on(self._stream)
        except OSError as error:
            self.__exit__()
            raise not_written(self.path, error) from None
        except OutputError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            with suppress(OSError):  # a full disk was reported where a fit was written
                self._stream.close()

    def resume(self, name: str, fits: Callable[..., Iterator[Fit]]) -> Iterator[Fit]:
        """Yield the fits of a pass: first the fits on disk, then the new fits, which are also written to disk.

        fits: called as ``fits(skip=vehicles)``; yields the fits of all other vehicles. Raises OutputError.
        """
        kept = self._fits.get(name, {})
        yield from kept.values()
        for fit in fits(skip=kept.keys()):
            self._write(name, fit)
            yield fit

    def _go_on(self, stream: BinaryIO) -> None:
        """Overwrite an unfinished or damaged line, or the whole file if it belongs to another calibration."""
        length = self._read(stream)
        stream.seek(length)
        stream.truncate()
        if not length:
            stream.write(self._head)

    def _read(self, stream: BinaryIO) -> int:
        """Read the lines up to the first one that is unfinished or damaged, and return their length [bytes]."""
        head = stream.readline(_LONGEST_LINE)
        if head != self._head and self._head.startswith(head):
            return 0  # the disk was full
        about = _document(head)
        if not isinstance(about, dict) or set(about) != set(self._about):
            raise OutputError(f"{self.path}: is there, and is no checkpoint of a calibration; move it, or name another")
        if about != self._about:
            return 0
        length = len(head)
        while (line := stream.readline(_LONGEST_LINE)).endswith(b"\n"):
            try:
                name, fit = _fit_of(_document(line))
            except (TypeError, ValueError):
                break
            self._fits.setdefault(name, {})[fit.vehicle] = fit
            length += len(line)
        return length

    def _write(self, name: str, fit: Fit) -> None:
        assert self._stream is not None
        parameters, std, interval = fit.parameters.tolist(), fit.std.tolist(), fit.interval.tolist()
        line = [name, fit.vehicle, parameters, fit.log_likelihood, std, fit.at_bound, interval]
        try:
            self._stream.write(json.dumps(line).encode() + b"\n")
            self._stream.flush()
        except OSError as error:
            raise not_written(self.path, error) from None


def _document(line: bytes) -> Any:
    """A line as JSON; None if it is none."""
    try:
        return json.loads(line) if line.endswith(b"\n") else None
    except (ValueError, RecursionError):
        return None


def _fit_of(line: Any) -> tuple[str, Fit]:
    """A fit and the name of its pass. Raises TypeError or ValueError for a damaged line."""
    name, vehicle, parameters, log_likelihood, std, at_bound, interval = line
    if not isinstance(name, str) or type(vehicle) is not int:
        raise TypeError
    fit = Fit(
        vehicle=vehicle,
        parameters=np.array(parameters, dtype=np.float64),
        log_likelihood=float(log_likelihood),
        std=np.array(std, dtype=np.float64),
        at_bound=tuple(map(str, at_bound)),
        interval=np.array(interval, dtype=np.float64),
    )
    if fit.std.shape != fit.parameters.shape or fit.interval.shape != (*fit.parameters.shape, 2):
        raise ValueError
    if fit.parameters.shape != (COUNT,) or not np.isfinite(fit.parameters).all():
        raise ValueError
    return name, fit
