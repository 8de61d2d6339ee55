"""pNEUMA: vehicles seen from drones, one line for each vehicle, with as many groups of six values as it was seen."""

import math
from array import array
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, put_together
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import number, open_input
from sugiyama_ros.formats.sheet import MAX_ROWS
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import Tracks

_HEAD = ("track_id", "type", "traveled_d", "avg_speed")
_GROUP = 6
# Longest line [bytes]: a vehicle that is seen for two hours at 25 Hz has 15 MB.
_LONGEST = 32 << 20
_EARTH_M = 6_371_000.0
_SIDES = ("east", "north", "west", "south")


def _read_pneuma(path: Path, choices: Choices) -> Tracks:
    """Read a file of pNEUMA.

    The file names neither lanes nor leaders. A road is a direction of the compass, and a position is measured in the
    mean direction of its vehicles. So all leaders are unknown, until lanes are added.

    Raises InputError.
    """
    values, rows, names, kinds = _read(path)
    vehicle: Ints = np.repeat(np.arange(len(rows)), rows)
    latitude, longitude, speed, time = values[:, 0], values[:, 1], values[:, 2] / 3.6, values[:, 5]
    east = _EARTH_M * np.radians(longitude - longitude.mean()) * np.cos(np.radians(latitude.mean()))
    north = _EARTH_M * np.radians(latitude - latitude.mean())
    last = np.cumsum(rows) - 1
    first = last - rows + 1
    way = (east[last] - east[first]) + 1j * (north[last] - north[first])
    sides = np.round(np.angle(way) / (0.5 * np.pi)).astype(np.int64) % 4
    # streets seldom lie along the compass: positions count in the mean direction of a road
    mean = np.array([np.sum(way[sides == one]) or 1j**one for one in range(4)])
    side, turn = sides[vehicle], np.angle(mean)[sides][vehicle]
    columns: dict[str, Array | Labels] = {
        "vehicle": labels(vehicle.astype(np.int32), names),
        "class": labels(vehicle.astype(np.int32), kinds),
        "time_s": time,
        "s_m": east * np.cos(turn) + north * np.sin(turn),
        "d_m": north * np.cos(turn) - east * np.sin(turn),
        "speed": speed,
        "road": labels(side.astype(np.int32), _SIDES),
        "lane": Labels(np.full(len(time), -1, dtype=np.int32), ()),
    }
    about = about_file(path).noting(
        "the file has no lanes, so all leaders are unknown; write a CSV, fill its column lane, and read it again"
    )
    return put_together(columns, about, choices)


def _read(path: Path) -> tuple[Array, Ints, list[str], list[str]]:
    """Values of all groups (R, 6), and for each vehicle its number of groups, its name and its class."""
    values, rows = array("d"), array("q")
    names: list[str] = []
    kinds: list[str] = []
    with open_input(path) as stream:
        stream.readline(_LONGEST)
        count = 1
        while line := stream.readline(_LONGEST):
            count += 1
            where = f"{path}:{count}"
            fields = [one.strip() for one in line.decode("utf-8", errors="replace").split(";")]
            fields = fields[:-1] if fields[-1] == "" else fields
            if not fields:
                continue
            groups, rest = divmod(len(fields) - len(_HEAD), _GROUP)
            if rest or groups < 0:
                raise InputError(f"{where}: {len(fields)} fields are not four and groups of six; correct the line")
            if (len(values) // _GROUP) + groups > MAX_ROWS:
                raise InputError(f"{where}: more than {MAX_ROWS} rows; split the file")
            names.append(fields[0])
            kinds.append(fields[1])
            rows.append(groups)
            values.extend(_numbers(fields[len(_HEAD) :], where))
    if not values:
        raise InputError(f"{path}: no samples; give a file with vehicles")
    seen = np.frombuffer(rows, dtype=np.int64)
    kept = seen > 0
    return (
        np.frombuffer(values).reshape(-1, _GROUP),
        seen[kept],
        [name for name, keep in zip(names, kept.tolist(), strict=True) if keep],
        [kind for kind, keep in zip(kinds, kept.tolist(), strict=True) if keep],
    )


def _numbers(texts: list[str], where: str) -> list[float]:
    """The values of a line, of which each sixth and the one behind it are degrees."""
    try:
        found = list(map(float, texts))
    except ValueError:
        found = [number(text, "value", where) for text in texts]
    if not all(map(math.isfinite, found)) or any(abs(one) > 360.0 for one in (*found[::_GROUP], *found[1::_GROUP])):
        raise InputError(f"{where}: a value is not a finite number, or not a place in degrees; correct the line")
    return found


def _recognise(head: bytes, path: Path) -> bool:
    first = head.decode("utf-8-sig", errors="replace").partition("\n")[0]
    return tuple(one.strip().lower() for one in first.split(";"))[: len(_HEAD)] == _HEAD


FORMAT = Format(
    name="pneuma",
    suffixes=(".csv",),
    recognise=_recognise,
    read=_read_pneuma,
    summary="pNEUMA: lines of different lengths, places in degrees; no lanes and no leaders",
)
