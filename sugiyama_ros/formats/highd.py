"""highD, and the files of exiD, inD and rounD, which name their columns in another way."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import (
    Rows,
    about_file,
    drivers_of,
    need,
    put_together,
    read_columns,
    sheet_format,
    take,
    text_of,
    without_nobody,
)
from sugiyama_ros.formats.on_road import moved, on_road
from sugiyama_ros.formats.reading import command_for, shown_stem
from sugiyama_ros.formats.sheet import Sheet, head_of, sheet_of, text_sheet
from sugiyama_ros.roads.network import Network
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.labels import Labels, labels, same_label
from sugiyama_ros.trajectories.tracks import Tracks

_RATE_HZ = 25.0
# x and y are of the upper left corner of the box; width is along the road.
_HIGHD = {
    "vehicle": need("id"),
    "frame_s": need("frame"),
    "x_m": need("x"),
    "y_m": need("y"),
    "length_m": need("width"),
    "width_m": take("height"),
    "lane": need("laneId"),
    "leader": take("precedingId"),
    "x_speed": take("xVelocity"),
}
# x and y are of the centre. Only exiD says who leads, and on which lane; a lane may be given as "12" or "12;13".
_EXID = {
    "recording": take("recordingId"),
    "vehicle": need("trackId"),
    "frame_s": need("frame"),
    "x_m": need("xCenter"),
    "y_m": need("yCenter"),
    "length_m": take("length"),
    "width_m": take("width"),
    "heading_m": need("heading"),
    "leader": need("leadId"),
    "x_speed": take("xVelocity"),
    "y_speed": take("yVelocity"),
}
# inD and rounD have no leaders; on a road, leaders are found.
_ON_ROAD = {name: one for name, one in _EXID.items() if name != "leader"}


def _read(sheet: Sheet, choices: Choices) -> Tracks:
    """Read ``XX_tracks.csv``; ``XX_tracksMeta.csv`` and ``XX_recordingMeta.csv`` beside it are read where they are."""
    path, is_highd, network = sheet.path, sheet.has("laneId"), choices.network
    if is_highd and network is not None:
        raise InputError(f"{path}: highD names its lanes; leave out the road")
    if not is_highd and network is None and sheet.find("leadId") is None:
        raise InputError(
            f"{path}:1: no column leadId: crossings (inD, rounD) have neither lanes nor leaders; convert them with"
            f" their road: {command_for(path)} --road-file MAP.osm"
        )
    columns = read_columns(sheet, _HIGHD if is_highd else _EXID if network is None else _ON_ROAD)
    about = about_file(path, leaders="found" if is_highd or network is not None else "given")
    columns["time_s"] = np.asarray(columns.pop("frame_s")) / _rate(path)
    if network is not None:
        return _on_road(columns, path, about, choices, network)
    without_nobody(columns, "0", "-1")
    columns = _of_highd(columns) if is_highd else _of_exid(columns)
    return put_together(_named(columns, path), about, choices)


def _named(columns: Rows, path: Path) -> Rows:
    """Columns with the recording, and with classes where the metadata say them."""
    columns.setdefault("recording", same_label(len(np.asarray(columns["time_s"])), shown_stem(path).partition("_")[0]))
    if (kind := _classes(path, text_of(columns, "vehicle"))) is not None:
        columns["class"] = kind
    return columns


def _on_road(columns: Rows, path: Path, about: About, choices: Choices, network: Network) -> Tracks:
    """Tracks of vehicles in the plane, on the lanes of a road."""
    columns["heading_m"] = np.radians(np.asarray(columns["heading_m"]))
    columns, about = drivers_of(_named(columns, path), about)
    columns = moved(columns, _meta(path, "xUtmOrigin", 0.0), _meta(path, "yUtmOrigin", 0.0), network)
    cure = "" if _beside(path).is_file() else f"put {_beside(path).name} beside the file, which says its origin"
    return put_together(*on_road(columns, network, about, cure=cure), choices)


def _of_highd(columns: Rows) -> Rows:
    """Centres, and a road for each direction."""
    x, length = np.asarray(columns.pop("x_m")), np.asarray(columns["length_m"])
    y, width = np.asarray(columns.pop("y_m")), np.asarray(columns.get("width_m", 0.0))
    speed = np.asarray(columns.pop("x_speed", np.full(len(x), np.nan)))
    code = text_of(columns, "vehicle").code
    forward = np.bincount(code + 1, weights=np.nan_to_num(speed))[code + 1] >= 0.0
    road = Labels(np.where(forward, 0, 1).astype(np.int32), ("lower", "upper"))
    return columns | {"s_m": x + 0.5 * length, "d_m": y + 0.5 * width, "road": road, "speed": speed}


def _of_exid(columns: Rows) -> Rows:
    """Positions along the two main directions of the road."""
    x, y = np.asarray(columns.pop("x_m")), np.asarray(columns.pop("y_m"))
    heading = np.radians(np.asarray(columns.pop("heading_m")))
    # Both directions of one axis have the same doubled angle.
    axis = 0.5 * np.arctan2(np.nanmean(np.sin(2.0 * heading)), np.nanmean(np.cos(2.0 * heading)))
    side: Ints = (np.cos(heading - axis) < 0.0).astype(np.int64)
    sign = 1.0 - 2.0 * side
    along, across = x * np.cos(axis) + y * np.sin(axis), y * np.cos(axis) - x * np.sin(axis)
    road = Labels(side.astype(np.int32), ("forward", "backward"))
    if "x_speed" in columns and "y_speed" in columns:
        columns["speed"] = np.hypot(np.asarray(columns.pop("x_speed")), np.asarray(columns.pop("y_speed")))
    return columns | {"s_m": sign * along, "d_m": sign * across, "road": road}


def _rate(path: Path) -> float:
    """Frames in a second, from the recording's metadata where there is such a file."""
    rate = _meta(path, "frameRate", _RATE_HZ)
    if not 1.0 <= rate <= 1000.0:
        raise InputError(f"{_beside(path)}: frameRate {rate:g} is no rate; correct the file")
    return rate


def _beside(path: Path) -> Path:
    """The recording's metadata."""
    return path.with_name(path.name.replace("_tracks", "_recordingMeta"))


def _meta(path: Path, name: str, otherwise: float) -> float:
    """A number of the recording's metadata; another one where there is no such file, or no such column."""
    beside = _beside(path)
    if beside == path or not beside.is_file():
        return otherwise
    sheet = sheet_of(beside, head_of(beside))
    if sheet is None or sheet.find(name) is None:
        return otherwise
    return float(np.asarray(read_columns(sheet, {"value_m": need(name)})["value_m"])[0])


def _classes(path: Path, vehicle: Labels) -> Labels | None:
    """Class of each row, (R,), from the metadata of the tracks; None without such a file."""
    beside = path.with_name(path.name.replace("_tracks", "_tracksMeta"))
    if beside == path or not beside.is_file():
        return None
    sheet = sheet_of(beside, head_of(beside))
    if sheet is None:
        return None
    meta = read_columns(sheet, {"vehicle": need("id", "trackId"), "class": need("class")})
    names, kinds = text_of(meta, "vehicle"), text_of(meta, "class")
    of_name = dict(zip(names.values().tolist(), kinds.code.tolist(), strict=True))
    code = np.array([of_name.get(text, -1) for text in vehicle.text] + [-1], dtype=np.int32)[vehicle.code]
    return labels(code, kinds.text)


def _sheet(path: Path, head: bytes) -> Sheet | None:
    sheet = text_sheet(path, head)
    marks = ("frame", "id", "x", "laneId", "width"), ("trackId", "frame", "xCenter", "yCenter")
    return sheet if sheet is not None and any(sheet.has(*names) for names in marks) else None


FORMAT = replace(
    sheet_format(
        name="highd",
        suffixes=(".csv",),
        summary="highD and exiD (tracks.csv with its metadata beside it); with a road also inD and rounD",
        sheet_of=_sheet,
        read=_read,
        refusal="1: not the columns of highD, exiD or inD; check the file",
    ),
    takes_road=True,
)
