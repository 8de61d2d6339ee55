"""The measured drivers of NGSIM I-80 on which commands are timed, where their file is."""

import sys
from pathlib import Path

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.studies.speed.figure import Used, used_by_command

#: Drivers who are taken, and the file of pairs in which they are.
DRIVERS = 94
DATA = Path(__file__).parents[4] / "shared/data/ngsim_i80_pairs/ngsim_i80_pairs.parquet"


def used_on_drivers(folder: Path, *command: str) -> Used:
    """Write ``drivers.parquet``, and measure what a command uses on it. Raises InputError without the data."""
    write_drivers(folder / "drivers.parquet")
    return used_by_command((sys.executable, "-m", "sugiyama_ros.cli", *command), folder)


def write_drivers(path: Path) -> None:
    """Write the tracks of the first drivers who follow somebody, and of those ahead of them. Raises InputError."""
    if not DATA.exists():
        raise InputError(f"{DATA}: not found; put the car-following pairs of NGSIM I-80 there")
    tracks = read_tracks(DATA)
    follows = tracks.leader_row >= 0
    first = np.unique(tracks.run[follows])[:DRIVERS]
    ahead = tracks.run[tracks.leader_row[follows & np.isin(tracks.run, first)]]
    write_tracks(tracks.select(np.isin(tracks.run, np.concatenate((first, ahead)))), path)
