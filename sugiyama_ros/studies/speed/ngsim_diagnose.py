"""The quick diagnosis of 94 measured drivers of NGSIM I-80, as a command."""

import sys
import tempfile
from pathlib import Path

from sugiyama_ros.studies.speed.figure import SpeedFigure, used_by_command
from sugiyama_ros.studies.speed.ngsim import DRIVERS, write_drivers

_COMMAND = ("diagnose", "drivers.parquet", "--quick", "--json")


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the command. Raises InputError without the data."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_drivers(folder / "drivers.parquet")
        used = used_by_command((sys.executable, "-m", "sugiyama_ros.cli", *_COMMAND), folder)
    return (
        SpeedFigure("ngsim_diagnose_s", f"quick diagnosis of {DRIVERS} drivers", used.cpu_s, "s of CPU time", 150),
        SpeedFigure("ngsim_diagnose_mb", "memory of this diagnosis", used.memory_mb, "MB", 700),
    )
