"""Reader of the ring experiments of the Mathematical Society of Traffic Flow (MSTF)."""

import re
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.format import Format, has_suffix
from sugiyama_ros.formats.reading import lines, number, open_input, sha256
from sugiyama_ros.formats.samples import Samples, agreed_road
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M, Trajectories

# Lengths [m] of the cars of case 1, measured from the video: Dai et al., Table 1 (Vehicle sizes). Number = block.
_CASE_1_LENGTH_M = [
    *(3.52, 4.65, 3.68, 4.54, 3.90, 4.92, 4.87, 5.03, 4.62, 4.81, 4.92),
    *(3.95, 4.11, 3.95, 4.49, 4.81, 4.81, 3.57, 4.38, 4.06, 3.08, 4.71),
]
_CASE_1_SHA256 = "91cf02c7cbf3fe6d817dd02ef347586b12a9134b1f914655e486be2f8773457c"
_CIRCUIT = re.compile(r"circuit length is +(\d+(?:\.\d*)?) *m\b")


def read_mstf(path: Path, ring_m: float | None = None) -> Trajectories:
    """Read a ``.data`` file: lines of position [m] and time [s], one block for each car.

    Cars are numbered by block, from 0. The file has no lengths: the cars of case 1 get the lengths in the reference,
    other cars get ``DEFAULT_LENGTH_M``.

    ring_m: circumference [m] of the ring, where the head of the file does not say it; 0 for an open road. Raises
    InputError.

    References
    ----------
    Dai et al., Table 1 (Vehicle sizes): lengths of the cars of case 1.
    """
    samples = Samples(path)
    said_m = None
    block, in_block = -1, False
    with open_input(path) as stream:
        for count, line in enumerate(lines(path, stream), start=1):
            where = f"{path}:{count}"
            if line.startswith("#"):
                found = _CIRCUIT.search(line)
                said_m = float(found[1]) if found else said_m
                continue
            fields = line.split()
            if not fields:
                in_block = False
                continue
            if len(fields) != 2:
                raise InputError(f"{where}: {len(fields)} columns; an MSTF file has two, position and time")
            if not in_block:
                block, in_block = block + 1, True
            samples.add(number(fields[1], "time", where), block, number(fields[0], "position", where), where)
        checksum = sha256(stream)
    if said_m is None and ring_m is None:
        raise InputError(f"{path}: does not say the length of the circuit; give it with --ring (0 for an open road)")
    cars = len(samples.vehicles)
    lengths = _CASE_1_LENGTH_M if checksum == _CASE_1_SHA256 else [DEFAULT_LENGTH_M] * cars
    return samples.trajectories(lengths, agreed_road(path, said_m, ring_m), checksum)


FORMAT = Format(
    name="mstf",
    suffixes=(".data",),
    recognise=has_suffix(".data"),
    read=read_mstf,
    summary="ring experiments of the Mathematical Society of Traffic Flow: position and time, one block for each car",
)
