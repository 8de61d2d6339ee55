"""The calibration of 94 measured drivers of NGSIM I-80, as a command."""

import tempfile
from pathlib import Path

from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.ngsim import DRIVERS, used_on_drivers

_COMMAND = ("calibrate", "drivers.parquet", "--json")


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the command. Raises InputError without the data."""
    with tempfile.TemporaryDirectory() as name:
        used = used_on_drivers(Path(name), *_COMMAND)
    return (
        SpeedFigure("ngsim_calibrate_s", "calibration of a driver", used.cpu_s / DRIVERS, "s of CPU time", 0.8),
        SpeedFigure("ngsim_calibrate_mb", "memory of this calibration", used.memory_mb, "MB"),
    )
