"""Reader of the ring experiments of the Mathematical Society of Traffic Flow (MSTF)."""

import re
from array import array
from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices, agreed_ring
from sugiyama_ros.formats.columns import Rows, about_file, put_together
from sugiyama_ros.formats.format import Format, has_suffix
from sugiyama_ros.formats.reading import lines, number, open_input
from sugiyama_ros.trajectories.labels import numbered
from sugiyama_ros.trajectories.tracks import Tracks

# Lengths [m] of the cars of case 1, measured from the video: Dai et al., Table 1 (Vehicle sizes). Number = block.
_CASE_1_LENGTH_M = [
    *(3.52, 4.65, 3.68, 4.54, 3.90, 4.92, 4.87, 5.03, 4.62, 4.81, 4.92),
    *(3.95, 4.11, 3.95, 4.49, 4.81, 4.81, 3.57, 4.38, 4.06, 3.08, 4.71),
]
_CASE_1_SHA256 = "91cf02c7cbf3fe6d817dd02ef347586b12a9134b1f914655e486be2f8773457c"
_CIRCUIT = re.compile(r"circuit length is +(\d+(?:\.\d*)?) *m\b")


def _read_mstf(path: Path, choices: Choices) -> Tracks:
    """Read a ``.data`` file: lines of position [m] and time [s], one block for each car.

    Cars are numbered by block, from 0. The file has no lengths: the cars of case 1 get the lengths in the reference.
    Raises InputError.

    References
    ----------
    Dai et al., Table 1 (Vehicle sizes): lengths of the cars of case 1.
    """
    rows = array("d")
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
            rows.extend((block, number(fields[0], "position", where), number(fields[1], "time", where)))
    if said_m is None and choices.ring_m is None:
        raise InputError(f"{path}: does not say the length of the circuit; give it with --ring (0 for an open road)")
    if not rows:
        raise InputError(f"{path}: no samples; give a table of positions")
    car, position, time = np.frombuffer(rows).reshape(-1, 3).T
    columns: Rows = {"vehicle": numbered(car), "s_m": position, "time_s": time}
    about = replace(about_file(path), view="whole", ring_m=agreed_ring(path, said_m, choices))
    if about.sha256 == _CASE_1_SHA256:
        columns["length_m"] = np.array(_CASE_1_LENGTH_M)[car.astype(np.int64)]
    return put_together(columns, about, choices)


FORMAT = Format(
    name="mstf",
    suffixes=(".data",),
    recognise=has_suffix(".data"),
    read=_read_mstf,
    summary="ring experiments of the Mathematical Society of Traffic Flow: position and time, one block for each car",
)
