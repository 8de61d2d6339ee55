"""Plain CSV: one line for each sample, with the columns time_s, vehicle, position_m and, if known, length_m."""

import csv
import math
import re
from pathlib import Path

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target, writing
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import lines, number, open_input, sha256
from sugiyama_ros.formats.samples import Samples, agreed_road
from sugiyama_ros.formats.sheet import MISSING
from sugiyama_ros.formats.table import read_table
from sugiyama_ros.trajectories.jumps import check_jumps
from sugiyama_ros.trajectories.one_lane import check_order, one_lane
from sugiyama_ros.trajectories.trajectories import DEFAULT_LENGTH_M, Trajectories

_REQUIRED = ("time_s", "vehicle", "position_m")
_VEHICLE = re.compile(r"\d{1,9}")
# A name, and a number that only a table has: one that is written as 12.0, or a long one.
_NAME = re.compile(r"[^-+.\d]|^\d+\.0+$|^\d{10,}$")
# Speeds [m/s].
_SPEEDS = {"speed_mps", "speed_m_s"}
#: Columns that make a table one of tracks.
_OF_TRACKS = {"recording", "road", "lane", "leader"}


class _OtherTableError(Exception):
    """A table with names of vehicles, clocks, decimal commas or speeds, which the format ``table`` reads."""


def read_csv(path: Path, ring_m: float | None = None) -> Trajectories:
    """Read a CSV file with a header. Other columns are ignored.

    Vehicles with names, times such as 0:01:02.5 and decimal commas are read as the format ``table`` reads them.

    ring_m: circumference [m] of the ring; without it the road is open. Raises InputError.
    """
    try:
        return _read(path, ring_m)
    except _OtherTableError:
        return one_lane(read_table(path, Choices(ring_m=ring_m)), str(path))


def _read(path: Path, ring_m: float | None) -> Trajectories:
    """Read a CSV file with numbers.

    An empty position, or nan, is a missing sample. A vehicle without a length gets ``DEFAULT_LENGTH_M``. The times of
    each vehicle must increase.

    ring_m: circumference [m] of the ring; without it the road is open. Raises InputError.
    """
    samples = Samples(path)
    lengths: dict[int, float] = {}
    with open_input(path) as stream:
        rows = csv.reader(lines(path, stream), strict=True)
        try:
            header = [name.strip() for name in next(rows, [])]
            columns = _columns(path, header)
            if _SPEEDS & set(header):
                raise _OtherTableError  # which compares positions with speeds
            for row in rows:
                where = f"{path}:{rows.line_num}"
                if not row:
                    continue
                if len(row) != len(header):
                    raise InputError(f"{where}: {len(row)} fields, the header has {len(header)}; correct the line")
                if _is_other({name: row[column].strip() for name, column in columns.items()}):
                    raise _OtherTableError
                vehicle = _vehicle(row[columns["vehicle"]].strip(), where)
                position = row[columns["position_m"]].strip()
                samples.add(
                    number(row[columns["time_s"]], "time_s", where),
                    vehicle,
                    number(position, "position_m", where) if position not in MISSING else math.nan,
                    where,
                )
                if "length_m" in columns and (text := row[columns["length_m"]].strip()):
                    length = number(text, "length_m", where)
                    if length < 0.0:
                        raise InputError(f"{where}: length_m {length:g} is negative; correct the line")
                    if lengths.setdefault(vehicle, length) != length:
                        raise InputError(
                            f"{where}: vehicle {vehicle} is {length:g} m long here and {lengths[vehicle]:g} m above;"
                            f" give it one length, or make tracks of the file: sugiyama convert {path} tracks.parquet"
                        )
        except csv.Error as error:
            raise InputError(f"{path}:{rows.line_num}: not CSV: {error}; correct the line") from None
        checksum = sha256(stream)
    length_m = [lengths.get(vehicle, DEFAULT_LENGTH_M) for vehicle in samples.vehicles]
    trajectories = samples.trajectories(length_m, agreed_road(path, None, ring_m), checksum)
    check_order(trajectories, str(path))
    check_jumps(trajectories, str(path))
    return trajectories


def write_csv(trajectories: Trajectories, target: Target) -> None:
    """Write trajectories so that ``read_csv`` gives them back; missing samples have an empty position.

    Raises OutputError where the file cannot be written.
    """
    with writing(target) as stream:
        stream.write(b"time_s,vehicle,position_m,length_m\n")
        vehicles = list(zip(trajectories.vehicle.tolist(), trajectories.length_m.tolist(), strict=True))
        for time, positions, present in zip(
            trajectories.time_s.tolist(), trajectories.position_m, trajectories.present, strict=True
        ):
            for column in np.flatnonzero(present):
                vehicle, length = vehicles[column]
                position = "" if np.isnan(positions[column]) else repr(float(positions[column]))
                stream.write(f"{time!r},{vehicle},{position},{length!r}\n".encode())


def _is_other(cells: dict[str, str]) -> bool:
    """Whether a row has a clock, a name of a vehicle, or a decimal comma."""
    named = cells["vehicle"] not in MISSING and _NAME.search(cells["vehicle"]) is not None
    return named or ":" in cells["time_s"] or any("," in text for text in cells.values())


def _columns(path: Path, header: list[str]) -> dict[str, int]:
    """Index of each column."""
    missing = [name for name in _REQUIRED if name not in header]
    if missing:
        raise InputError(f"{path}:1: no column {', '.join(missing)}; the header must name {', '.join(_REQUIRED)}")
    known = [name for name in header if name in (*_REQUIRED, "length_m")]
    if len(set(known)) != len(known):
        raise InputError(f"{path}:1: a column occurs twice; name each column once")
    return {name: header.index(name) for name in known}


def _vehicle(text: str, where: str) -> int:
    """Number of a vehicle."""
    if not _VEHICLE.fullmatch(text):
        raise InputError(f"{where}: vehicle {text[:40]!r} is not a number from 0 to 999999999; number the vehicles")
    return int(text)


def _is_plain(head: bytes, path: Path) -> bool:
    """Whether a file has the plain columns and numbers its vehicles; the format ``table`` reads other tables."""
    if path.suffix.lower() != ".csv":
        return False
    rows = list(csv.reader(head.decode("utf-8-sig", errors="replace").splitlines()[:2]))
    header = [name.strip() for name in rows[0]] if rows else []
    if not set(_REQUIRED) <= set(header) or set(header) & _OF_TRACKS:
        return False
    first = dict(zip(header, rows[1], strict=False)) if len(rows) > 1 else {}
    since_1970 = re.fullmatch(r"\d{13,19}(\.\d*)?", first.get("time_s", "").strip()) is not None
    return _VEHICLE.fullmatch(first.get("vehicle", "0").strip()) is not None and not since_1970


FORMAT = Format(
    name="csv",
    suffixes=(".csv",),
    recognise=_is_plain,
    read=read_csv,
    summary="one line for each sample, with the columns time_s, vehicle, position_m and, if known, length_m",
    tracks=read_table,
)
