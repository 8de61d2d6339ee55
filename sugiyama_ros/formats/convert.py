"""Conversion of trajectory files to bags."""

from dataclasses import replace
from pathlib import Path

from sugiyama_ros.formats.mcap_writer import LATCHED_TOPIC, BagWriter, Qos
from sugiyama_ros.formats.measured import MEASURED_TYPE, ROAD_TYPE, messages
from sugiyama_ros.formats.registry import read_trajectories
from sugiyama_ros.outputs import Target, output_of
from sugiyama_ros.trajectories.trajectories import Trajectories


def convert(source: Path, target: Target, ring_m: float | None = None) -> Trajectories:
    """Convert a trajectory file to a bag with the topics /road and /measured.

    Parameters
    ----------
    source : Path
        File to read, in any known format.
    target : Path or Output
        Bag to write.
    ring_m : float, optional
        Circumference [m] of the ring, where the file does not say it; 0 for an open road.

    Returns
    -------
    Trajectories
        What the file contains.

    Raises
    ------
    InputError, OutputError
        For a file that cannot be read, or a bag that cannot be written.
    """
    output = replace(output_of(target), inputs=(Path(source),))
    output.check()
    trajectories = read_trajectories(source, ring_m)
    write_trajectories(trajectories, output)
    return trajectories


def write_trajectories(trajectories: Trajectories, target: Target) -> None:
    """Write a bag with the topics /road and /measured. Stamps and log times are the times of the samples."""
    about = {"source": trajectories.source, "sha256": trajectories.sha256}
    with BagWriter(target, about) as bag:
        channels = {
            ROAD_TYPE: bag.topic("/road", ROAD_TYPE, LATCHED_TOPIC),
            MEASURED_TYPE: bag.topic("/measured", MEASURED_TYPE, Qos()),
        }
        for type_name, stamp, data in messages(trajectories):
            bag.write(channels[type_name], data, stamp, stamp)
