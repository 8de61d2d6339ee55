"""The calibration of two thousand simulated drivers on lanes, as a command."""

import sys
import tempfile
from pathlib import Path

import numpy as np

from sugiyama_ros.driver.parameters import SIGMA_A
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.simulation.lanes import Lane, simulate_lanes
from sugiyama_ros.studies.rings import LENGTH_M, alike
from sugiyama_ros.studies.speed.figure import SpeedFigure, used_by_command

# Lanes, vehicles on each, the time [s] for which they drive, and acceleration noise [m/s^2] with which nobody collides.
_LANES, _VEHICLES, _DURATION_S, _CALM = 96, 22, 60.0, 0.1


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the command; its memory is that of all processes together."""
    rows = alike(_VEHICLES)
    rows[:, SIGMA_A] = _CALM
    lane = Lane(rows, np.full(_VEHICLES, LENGTH_M), ["car"] * _VEHICLES)
    drivers = _LANES * (_VEHICLES - 1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tracks = simulate_lanes([lane] * _LANES, _DURATION_S, np.random.default_rng(1))
        write_tracks(tracks, folder / "drivers.parquet")
        used = used_by_command((sys.executable, "-m", "sugiyama_ros.cli", "calibrate", "drivers.parquet"), folder)
    text = f"calibration of {drivers:,} drivers of {_DURATION_S:.0f} s, {len(tracks):,} rows"
    return (
        SpeedFigure("many_on_lanes_s", text, used.cpu_s, "s of CPU time"),
        SpeedFigure("many_on_lanes_mb", "memory of all its processes", used.memory_mb, "MB", 1000),
    )
