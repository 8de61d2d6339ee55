"""Fits kept on disk during a long calibration, so that an interrupted calibration can continue."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from sugiyama_ros.errors import OutputError
from sugiyama_ros.fit.driver import Fit


class Checkpoint:
    """A file with one JSON document per line: a description of the calibration, then every fit with the name of its
    pass.

    The checkpoint is a context manager. The caller removes the file once the fits are saved elsewhere.

    Parameters
    ----------
    path : Path
        The file.
    about : dict
        Description of the calibration. The fits in the file are used again only if the file has the same description.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """

    def __init__(self, path: Path, about: dict[str, Any]) -> None:
        self.path = path
        self._head = json.dumps(about, sort_keys=True)
        self._fits: dict[str, dict[int, Fit]] = {}
        self._stream: TextIO | None = None

    def __enter__(self) -> "Checkpoint":
        length = self._read()
        try:
            # overwrite an unfinished last line, or the whole file if it belongs to another calibration
            self._stream = self.path.open("r+" if length else "w")
            self._stream.seek(length)
            self._stream.truncate()
            if not length:
                self._stream.write(self._head + "\n")
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}; choose another place") from None
        return self

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            self._stream.close()

    def resume(self, name: str, fits: Callable[..., Iterator[Fit]]) -> Iterator[Fit]:
        """Yield the fits of a pass: first the fits on disk, then the new fits, which are also written to disk.

        Parameters
        ----------
        name : str
            Name of the pass.
        fits : callable
            Called as ``fits(skip=vehicles)``; yields the fits of all other vehicles.

        Yields
        ------
        Fit
            One fit for each vehicle.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        kept = self._fits.get(name, {})
        yield from kept.values()
        for fit in fits(skip=kept.keys()):
            self._write(name, fit)
            yield fit

    def _read(self) -> int:
        """Read the complete lines of the file, and return their length [bytes]."""
        if not self.path.is_file():
            return 0
        length = 0
        with self.path.open("rb") as stream:
            for number, line in enumerate(stream):
                if not line.endswith(b"\n"):
                    break
                if number == 0:
                    if line.decode(errors="replace").strip() != self._head:
                        return 0
                else:
                    name, fit = _fit_of(line)
                    self._fits.setdefault(name, {})[fit.vehicle] = fit
                length += len(line)
        return length

    def _write(self, name: str, fit: Fit) -> None:
        assert self._stream is not None
        parameters, std, interval = fit.parameters.tolist(), fit.std.tolist(), fit.interval.tolist()
        line = [name, fit.vehicle, parameters, fit.log_likelihood, std, fit.at_bound, interval]
        try:
            self._stream.write(json.dumps(line) + "\n")
            self._stream.flush()
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None


def _fit_of(line: bytes) -> tuple[str, Fit]:
    name, vehicle, parameters, log_likelihood, std, at_bound, interval = json.loads(line)
    return name, Fit(
        vehicle=vehicle,
        parameters=np.array(parameters),
        log_likelihood=log_likelihood,
        std=np.array(std),
        at_bound=tuple(at_bound),
        interval=np.array(interval),
    )
