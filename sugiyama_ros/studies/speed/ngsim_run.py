"""The run of 94 measured drivers of NGSIM I-80 and of those ahead of them, as a command."""

import tempfile
from pathlib import Path

from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.ngsim import used_on_drivers

_COMMAND = ("run", "drivers.parquet", "-o", "run.mcap", "--json")


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the command. Raises InputError without the data."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        used = used_on_drivers(folder, *_COMMAND)
        size_mb = (folder / "run.mcap").stat().st_size / 1e6
    return (
        SpeedFigure("ngsim_run_s", "run of these drivers", used.cpu_s, "s of CPU time", 25),
        SpeedFigure("ngsim_run_mb", "memory of this run", used.memory_mb, "MB"),
        SpeedFigure("ngsim_run_bag_mb", "size of the recording", size_mb, "MB", 10),
    )
