"""TGSIM and ARED: tables whose columns only need other names."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import Take, about_file, need, nobody, put_together, read_columns, take, text_of
from sugiyama_ros.formats.format import tracks_format
from sugiyama_ros.formats.sheet import Sheet, head_of, sheet_of
from sugiyama_ros.trajectories.about import About, Reference
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.tracks import Tracks


@dataclass(frozen=True)
class _Known:
    """A data set: its columns, what positions are of, and what else is known."""

    wanted: dict[str, Take]
    reference: Reference
    said: Callable[[About], About]


#: Circumference [m] of the ring of ARED.
ARED_RING_M = 260.0
_KNOWN = (
    _Known(
        {
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
        },
        "centre",
        lambda about: replace(about, smoothing="Kalman filter, as published", licence="US DOT, public"),
    ),
    _Known(
        {
            "recording": take("exp_id"),
            "vehicle": need("veh_id"),
            "time_s": need("timestamp"),
            "s_m": need("cam_distance"),
            "speed": take("cam_velocity"),
            "length_m": take("length"),
            "class": take("make"),
            "leader": take("leader_id"),
        },
        "front",
        lambda about: replace(about, ring_m=ARED_RING_M, leaders="given"),
    ),
)


def read_known(path: Path, choices: Choices) -> Tracks:
    """Read a table of TGSIM or ARED. Raises InputError."""
    sheet = sheet_of(path, head_of(path))
    known = None if sheet is None else _known(sheet)
    if sheet is None or known is None:
        raise InputError(f"{path}:1: not the columns of TGSIM or ARED; check the file")
    columns = read_columns(sheet, known.wanted)
    about = known.said(about_file(path))
    if "x_m" in columns:
        columns = _along_travel(columns)
    if isinstance(leader := columns.get("leader"), Labels):
        columns["leader"] = nobody(leader, text_of(columns, "vehicle"), "-1")
    elif about.leaders == "given":
        about = replace(about, leaders="found")
    return put_together(columns, about, choices, known.reference)


def _along_travel(columns: dict[str, Array | Labels]) -> dict[str, Array | Labels]:
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


def _known(sheet: Sheet) -> _Known | None:
    for known in _KNOWN:
        if all(sheet.find(*one.names) for one in known.wanted.values() if not one.optional):
            return known
    return None


def _recognise(head: bytes, path: Path) -> bool:
    sheet = None if head.startswith(b"PAR1") else sheet_of(path, head)
    return sheet is not None and _known(sheet) is not None


FORMAT = tracks_format(
    name="tgsim",
    suffixes=(".csv",),
    recognise=_recognise,
    tracks=read_known,
    summary="TGSIM (lanes of a motorway) and ARED (a ring of 260 m)",
)
