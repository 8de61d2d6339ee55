"""NGSIM: the original text files, the tables of data.transportation.gov, and HIGH-SIM, which is alike."""

from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import (
    about_file,
    need,
    put_together,
    read_columns,
    rename,
    sheet_format,
    take,
    without_nobody,
)
from sugiyama_ros.formats.reading import shown_stem
from sugiyama_ros.formats.sheet import Sheet, is_number, sheet_of
from sugiyama_ros.trajectories.labels import Labels, joined, numbered, same_label
from sugiyama_ros.trajectories.tracks import Tracks

_TEXT_COLUMNS = (
    *("Vehicle_ID", "Frame_ID", "Total_Frames", "Global_Time", "Local_X", "Local_Y", "Global_X", "Global_Y"),
    *("v_Length", "v_Width", "v_Class", "v_Vel", "v_Acc", "Lane_ID", "Preceding", "Following"),
    *("Space_Headway", "Time_Headway"),
)
# A foot [m].
_FOOT_M = 0.3048
_WANTED = {
    "vehicle": need("Vehicle_ID", "Vehicle ID"),
    "s_m": need("Local_Y", "Local Y (ft)", factor=_FOOT_M),
    "d_m": take("Local_X", "Local X (ft)", factor=_FOOT_M),
    "length_m": take("v_Length", "Length (ft)", factor=_FOOT_M),
    "width_m": take("v_Width", "Width (ft)", factor=_FOOT_M),
    "speed": take("v_Vel", "Speed (ft/s)", factor=_FOOT_M),
    "class": take("v_Class", "Class"),
    "lane": take("Lane_ID", "Lane Num"),
    "leader": take("Preceding", "Preceding Vehicle ID"),
    "place": take("Location"),
    "road": take("Direction"),
}
# The time, from the first of these columns that is there.
_CLOCKS = (need("Global_Time", factor=1e-3), need("Global Time (s)"), need("Frame_ID", factor=0.1))
#: Names of the classes.
CLASSES = {"1": "motorcycle", "2": "car", "3": "truck"}
# A place where nobody is seen for this long [s] has another recording from then on.
_PAUSE_S = 60.0


def _read(sheet: Sheet, choices: Choices) -> Tracks:
    """Feet, front bumpers, times in milliseconds, numbers of vehicles that are used again."""
    clock_column = next((one for one in _CLOCKS if sheet.find(*one.names)), _CLOCKS[0])
    columns = read_columns(sheet, _WANTED | {"clock_s": clock_column})
    about = about_file(sheet.path)
    clock = np.asarray(columns.pop("clock_s"))
    place = columns.pop("place", None)
    place = place if isinstance(place, Labels) else same_label(len(clock), shown_stem(sheet.path))
    columns["recording"], columns["time_s"] = _periods(place, clock)
    without_nobody(columns, "0", "-1")
    road = columns.get("road")
    if isinstance(road, Labels) and ((road.code < 0).any() or "0" in road.used()):
        del columns["road"]
    rename(columns, "class", CLASSES)
    return put_together(columns, about, choices, reference="front")


def _periods(place: Labels, clock_s: Array) -> tuple[Labels, Array]:
    """Recording of each row, (R,), and time [s] from the start of the recording, (R,)."""
    period = np.zeros(len(clock_s), dtype=np.int64)
    time = clock_s.copy()
    for code in np.unique(place.code).tolist():
        here = np.flatnonzero((place.code == code) & np.isfinite(clock_s))
        seconds = np.unique(np.floor(clock_s[here]))
        if len(seconds) == 0:
            continue
        begins = seconds[np.concatenate(([True], np.diff(seconds) > _PAUSE_S))]
        period[here] = np.searchsorted(begins, clock_s[here], side="right") - 1
        earliest = np.full(len(begins), np.inf)
        np.minimum.at(earliest, period[here], clock_s[here])
        time[here] = np.round(clock_s[here] - earliest[period[here]], 3)
    if not period.any():
        return place, time
    return joined(place, numbered(period + 1), " period "), time


def _sheet(path: Path, head: bytes) -> Sheet | None:
    sheet = sheet_of(path, head)
    # a row with the place of the leader too is a pair
    if sheet is None or sheet.is_parquet or sheet.has("preceding_local_y"):
        return None
    if sheet.has("Vehicle_ID", "Local_Y", "Preceding") or sheet.has("Vehicle ID", "Local Y (ft)", "Lane Num"):
        return sheet
    if len(sheet.names) == len(_TEXT_COLUMNS) and all(is_number(name.partition("~")[0]) for name in sheet.names):
        return sheet_of(path, head, names=_TEXT_COLUMNS)
    return None


FORMAT = sheet_format(
    name="ngsim",
    suffixes=(".txt", ".csv"),
    summary="NGSIM (text with 18 columns, or CSV) and HIGH-SIM: feet, front bumpers, lanes, leaders",
    sheet_of=_sheet,
    read=_read,
    refusal="1: not the columns of NGSIM; say which is which with --format table --columns map.yaml",
)
