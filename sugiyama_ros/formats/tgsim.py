"""TGSIM and ARED: tables whose columns only need other names."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import (
    Rows,
    about_file,
    fits,
    need,
    put_together,
    read_columns,
    sheet_format,
    take,
    text_of,
    without_nobody,
)
from sugiyama_ros.formats.sheet import Sheet, text_sheet
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.tracks import Tracks

_TGSIM = {
    "recording": take("run_index"),
    "vehicle": need("id"),
    "time_s": need("time"),
    "x_m": need("xloc_kf"),
    "y_m": take("yloc_kf"),
    "speed": take("speed_kf"),
    "lane": need("lane_kf"),
    "length_m": take("length_smoothed"),
    "width_m": take("width_smoothed"),
    "class": take("type_most_common"),
}
_ARED = {
    "recording": take("exp_id"),
    "vehicle": need("veh_id"),
    "time_s": need("timestamp"),
    "s_m": need("cam_distance"),
    "speed": take("cam_velocity"),
    "length_m": take("length"),
    "class": take("make"),
    "leader": take("leader_id"),
}
# Circumference [m] of the ring of ARED.
_ARED_RING_M = 260.0


def _read(sheet: Sheet, choices: Choices) -> Tracks:
    about = about_file(sheet.path)
    if fits(sheet, _TGSIM):
        columns = _along_travel(read_columns(sheet, _TGSIM))
        return put_together(columns, about, choices)
    columns = read_columns(sheet, _ARED)
    without_nobody(columns, "-1")
    about = replace(about, ring_m=_ARED_RING_M, leaders="given" if "leader" in columns else "found")
    return put_together(columns, about, choices, "front")


def _along_travel(columns: Rows) -> Rows:
    """Positions along the axis that vehicles travel on, and across it."""
    x = np.asarray(columns.pop("x_m"))
    if "y_m" not in columns:
        return columns | {"s_m": x}
    y, time, vehicle = np.asarray(columns.pop("y_m")), np.asarray(columns["time_s"]), text_of(columns, "vehicle").code
    recording = columns.get("recording")
    other = recording.code.astype(np.int64) if isinstance(recording, Labels) else 0
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(time))
    key = (other * (int(vehicle.max()) + 2) + vehicle)[known]
    order = known[np.lexsort((time[known], key))]
    key = np.sort(key)
    first, last = order[np.diff(key, prepend=np.nan) != 0], order[np.diff(key, append=np.nan) != 0]
    way = (x[last] - x[first]) + 1j * (y[last] - y[first])
    # both directions of one axis have the same square; long ways count more
    axis = np.sqrt(complex(np.sum(way**2)) or 1.0)
    # it grows with the coordinate that it is nearer to
    axis *= np.sign(axis.real if abs(axis.real) >= abs(axis.imag) else axis.imag) / abs(axis)
    turned = (x + 1j * y) * axis.conjugate()
    return columns | {"s_m": np.asarray(turned.real), "d_m": np.asarray(turned.imag)}


def _sheet(path: Path, head: bytes) -> Sheet | None:
    sheet = text_sheet(path, head)
    return sheet if sheet is not None and (fits(sheet, _TGSIM) or fits(sheet, _ARED)) else None


FORMAT = sheet_format(
    name="tgsim",
    suffixes=(".csv",),
    summary="TGSIM (lanes of a motorway) and ARED (a ring of 260 m)",
    sheet_of=_sheet,
    read=_read,
    refusal="1: not the columns of TGSIM or ARED; check the file",
)
