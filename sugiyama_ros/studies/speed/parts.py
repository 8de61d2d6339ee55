"""The parts of the measurement, in the order in which they run."""

from collections.abc import Callable
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
    "run": "sugiyama_ros.studies.speed.run_loop",
    "tracks": "sugiyama_ros.studies.speed.tracks",
    "many": "sugiyama_ros.studies.speed.many",
    "many_on_lanes": "sugiyama_ros.studies.speed.many_on_lanes",
    "ngsim_calibrate": "sugiyama_ros.studies.speed.ngsim_calibrate",
    "ngsim_diagnose": "sugiyama_ros.studies.speed.ngsim_diagnose",
    "ngsim_run": "sugiyama_ros.studies.speed.ngsim_run",
}


def measured(part: str) -> tuple[SpeedFigure, ...]:
    """Measure one part. Raises InputError."""
    try:
        measure: Callable[[], tuple[SpeedFigure, ...]] = import_module(PARTS[part]).measure
    except ModuleNotFoundError as error:
        raise InputError(f"{part}: {error.name} is not installed; see requirements-dev.txt") from None
    return measure()
