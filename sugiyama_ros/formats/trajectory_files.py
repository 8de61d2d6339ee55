"""The one door through which every file of trajectories comes in."""

from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.mcap_records import MAGIC
from sugiyama_ros.formats.measured import read_measured
from sugiyama_ros.formats.mstf import read_mstf
from sugiyama_ros.formats.plain_csv import read_csv
from sugiyama_ros.formats.reading import open_input
from sugiyama_ros.trajectories.trajectories import Trajectories

_READERS = {".data": read_mstf, ".csv": read_csv, ".mcap": read_measured}


def read_trajectories(path: Path, ring_m: float | None = None) -> Trajectories:
    """Trajectories out of an MSTF file (``.data``), a plain CSV file (``.csv``) or a bag (``.mcap``).

    ring_m: circumference [m] of the road, where the file does not say it; 0 for an open road.

    Raises InputError, with the line or the offset, for a file that is missing, empty or not what it should be, and
    where ``ring_m`` contradicts the file.
    """
    path = Path(path)
    with open_input(path) as stream:
        head = stream.read(len(MAGIC))
    if not head:
        raise InputError(f"{path}: empty file; give trajectories in {', '.join(_READERS)}")
    reader = read_measured if head == MAGIC else _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: not known what this is; give a file in {', '.join(_READERS)}")
    return reader(path, ring_m)
