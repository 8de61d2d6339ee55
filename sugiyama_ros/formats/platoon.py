"""Platoons as the calibration package of Punzo et al. keeps them: one follower and the leader in a file."""

from pathlib import Path

import numpy as np

from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, need, put_together, read_columns, sheet_format
from sugiyama_ros.formats.pairs import both_of
from sugiyama_ros.formats.reading import shown_stem
from sugiyama_ros.formats.sheet import Sheet, is_number, sheet_of
from sugiyama_ros.trajectories.labels import same_label
from sugiyama_ros.trajectories.tracks import Tracks

_COLUMNS = ("time", "leader position", "follower position", "leader speed", "follower speed", "leader length")
_WANTED = {
    "time_s": need("time", factor=0.1),
    "leader_s_m": need("leader position"),
    "s_m": need("follower position"),
    "length_m": need("leader length"),
    "leader_speed": need("leader speed"),
    "speed": need("follower speed"),
}


def _read(sheet: Sheet, choices: Choices) -> Tracks:
    """Six columns without names, divided by tabs: front bumpers [m], times in tenths of a second."""
    path, pair = sheet.path, read_columns(sheet, _WANTED)
    rows = len(np.asarray(pair["s_m"]))
    digits = "".join(filter(str.isdigit, path.stem))[-9:]
    # Cars of a platoon are numbered from the first to the last.
    follower, leader = (digits, str(int(digits) - 1)) if digits.strip("0") else ("follower", "leader")
    pair |= {
        "recording": same_label(rows, shown_stem(path)),
        "vehicle": same_label(rows, follower),
        "leader_vehicle": same_label(rows, leader),
        "leader_length_m": pair["length_m"],
    }
    return put_together(both_of(pair), about_file(path, leaders="given"), choices, reference="front")


def _sheet(path: Path, head: bytes) -> Sheet | None:
    fields = (head.decode("utf-8-sig", errors="replace").splitlines() or [""])[0].split("\t")
    if len(fields) != len(_COLUMNS) or not all(is_number(one.strip(), ".,") for one in fields):
        return None
    return sheet_of(path, head, names=_COLUMNS)


FORMAT = sheet_format(
    name="platoon",
    suffixes=(".txt",),
    summary="a follower and the leader in six columns without names (Punzo et al.; the platoon of Hefei)",
    sheet_of=_sheet,
    read=_read,
    refusal="1: not six columns divided by tabs; give a file of a platoon",
)
