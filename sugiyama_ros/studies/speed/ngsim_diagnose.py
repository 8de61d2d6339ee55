"""The diagnosis of 94 measured drivers of NGSIM I-80, as a command."""

import tempfile
from pathlib import Path

from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.ngsim import DRIVERS, used_on_drivers

_COMMAND = ("diagnose", "drivers.parquet", "--json")


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the command. Raises InputError without the data."""
    with tempfile.TemporaryDirectory() as name:
        used = used_on_drivers(Path(name), *_COMMAND)
    return (
        SpeedFigure("ngsim_diagnose_s", f"diagnosis of {DRIVERS} drivers", used.cpu_s, "s of CPU time", 150),
        SpeedFigure("ngsim_diagnose_mb", "memory of this diagnosis", used.memory_mb, "MB", 700),
    )
