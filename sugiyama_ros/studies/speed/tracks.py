"""Reading of many rows of tracks, and calibration of drivers on lanes."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from sugiyama_ros.calibration.on_tracks import calibrate_tracks
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.studies.lanes import two_lanes
from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import labels_of
from sugiyama_ros.trajectories.tracks import Tracks

# Vehicles on lanes, and the samples in which each is in view: 1.1 million rows, as many as NGSIM's I-80 has.
_VEHICLES, _LANES, _SAMPLES, _PERIOD_S = 2200, 5, 500, 0.1
_SPEED, _EVERY_S = 10.0, 10.0
#: Wanted CPU time [s] and memory [MB] to read them, and CPU time [s] to calibrate a driver.
READ_AT_MOST, MEMORY_AT_MOST, DRIVER_AT_MOST = 3.0, 500.0, 0.8
_READ = """
import json, sys, time
from pathlib import Path
from sugiyama_ros.formats.registry import read_tracks
before = time.process_time()
tracks = read_tracks(Path(sys.argv[1]))
# the kernel counts ru_maxrss from before this program began, when the process was a copy of its parent
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
peak = int(status["VmHWM"].split()[0]) / 1024
print(json.dumps([time.process_time() - before, peak, len(tracks), int((tracks.leader_row >= 0).sum())]))
"""


def measure() -> tuple[SpeedFigure, ...]:
    """Measure in a process of its own how a file is read, and calibrate a simulation of lanes here."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "many.parquet"
        write_tracks(_many(), path)
        done = subprocess.run((sys.executable, "-c", _READ, str(path)), check=True, capture_output=True, text=True)
    cpu, peak, rows, led = json.loads(done.stdout)
    tracks = two_lanes(np.random.default_rng(1))
    calibrate_tracks(tracks)
    before = time.process_time()
    found = calibrate_tracks(tracks)
    each = (time.process_time() - before) / len(found.drivers)
    text = f"reading {rows:,} rows of tracks, {led:,} with leaders"
    return (
        SpeedFigure("read_tracks_s", text, cpu, "s of CPU time", READ_AT_MOST),
        SpeedFigure("read_tracks_mb", "memory of the process that reads them", peak, "MB", MEMORY_AT_MOST),
        SpeedFigure("tracks_driver_s", "calibration of a driver on tracks", each, "s of CPU time", DRIVER_AT_MOST),
    )


def _many() -> Tracks:
    """Vehicles that come one after the other on each lane, all at one speed."""
    vehicle = np.repeat(np.arange(_VEHICLES), _SAMPLES)
    sample = np.tile(np.arange(_SAMPLES), _VEHICLES)
    came = vehicle // _LANES * round(_EVERY_S / _PERIOD_S)
    return of_columns(
        {
            "vehicle": labels_of(vehicle.tolist()),
            "lane": labels_of((vehicle % _LANES).tolist()),
            "time_s": (came + sample) * _PERIOD_S,
            "s_m": sample * (_PERIOD_S * _SPEED),
        },
        About(source="bench"),
    )
