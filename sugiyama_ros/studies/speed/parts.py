"""The parts of the measurement, in the order in which they run."""

from collections.abc import Iterable, Iterator
from importlib import import_module

from sugiyama_ros.errors import InputError
from sugiyama_ros.studies.speed.figure import SpeedFigure

#: Module of each part, by the name of the part. A module has a function ``measure``, which returns figures.
PARTS = {
    "floors": "sugiyama_ros.studies.speed.floors",
    "peers": "sugiyama_ros.studies.speed.peers",
    "calibration": "sugiyama_ros.studies.speed.calibration",
    "diagnosis": "sugiyama_ros.studies.speed.diagnosis",
    "commands": "sugiyama_ros.studies.speed.commands",
    "first": "sugiyama_ros.studies.speed.first_command",
    "throughput": "sugiyama_ros.studies.speed.throughput",
    "many": "sugiyama_ros.studies.speed.many",
}


def measured(names: Iterable[str]) -> Iterator[tuple[str, tuple[SpeedFigure, ...]]]:
    """Measure parts one after the other.

    Parameters
    ----------
    names : iterable of str
        Names of the parts.

    Yields
    ------
    name : str
        Name of a part.
    figures : tuple of SpeedFigure
        Its figures.

    Raises
    ------
    InputError
        For a part whose library is not installed.
    """
    for name in names:
        try:
            measure = import_module(PARTS[name]).measure
        except ModuleNotFoundError as error:
            raise InputError(f"--part {name}: {error.name} is not installed; see requirements-dev.txt") from None
        yield name, measure()
