"""INTERACTION: vehicles in the plane at crossings, roundabouts and merges, of which a road says where the lanes are.

W. Zhan et al.: INTERACTION Dataset: An INTERnational, Adversarial and Cooperative moTION Dataset in interactive driving
scenarios with semantic maps. arXiv 1910.03088.
"""

from dataclasses import replace
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import (
    about_file,
    drivers_of,
    fits,
    need,
    put_together,
    read_columns,
    sheet_format,
    take,
)
from sugiyama_ros.formats.on_road import on_road
from sugiyama_ros.formats.reading import command_for
from sugiyama_ros.formats.sheet import Sheet, text_sheet
from sugiyama_ros.trajectories.tracks import Tracks

# x and y are of the centre; the heading is in radians.
_WANTED = {
    "recording": take("case_id"),
    "vehicle": need("track_id"),
    "time_s": need("timestamp_ms", factor=1e-3),
    "class": take("agent_type"),
    "x_m": need("x"),
    "y_m": need("y"),
    "x_speed": take("vx"),
    "y_speed": take("vy"),
    "heading_m": take("psi_rad"),
    "length_m": take("length"),
    "width_m": take("width"),
}


def _read(sheet: Sheet, choices: Choices) -> Tracks:
    if choices.network is None:
        raise InputError(
            f"{sheet.path}: vehicles in the plane, without lanes; convert them with their road:"
            f" {command_for(sheet.path)} --road-file MAP.osm"
        )
    columns = read_columns(sheet, _WANTED)
    columns, about = drivers_of(columns, about_file(sheet.path))
    return put_together(*on_road(columns, choices.network, about), choices)


def _sheet(path: Path, head: bytes) -> Sheet | None:
    sheet = text_sheet(path, head)
    return sheet if sheet is not None and fits(sheet, _WANTED) else None


FORMAT = replace(
    sheet_format(
        name="interaction",
        suffixes=(".csv",),
        summary="INTERACTION (vehicle_tracks_NNN.csv), with a road: crossings, roundabouts and merges in the plane",
        sheet_of=_sheet,
        read=_read,
        refusal="1: not the columns of INTERACTION; check the file",
    ),
    takes_road=True,
)
