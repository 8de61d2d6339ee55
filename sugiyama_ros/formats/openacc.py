"""OpenACC (JRC): platoons in one wide table, a group of columns for each car."""

import re
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import about_file, put_together
from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.reading import shown_stem
from sugiyama_ros.formats.sheet import Sheet, head_of, read_sheet, sheet_of
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.labels import Labels, labels
from sugiyama_ros.trajectories.tracks import Tracks

# Radius of the earth [m].
_EARTH_M = 6_371_000.0
# Coordinates [m] of a map are not larger.
_FARTHEST_M = 2e7
# Line with the names, below the metadata.
_HEADER = 6
# Car and, if the file knows it, the driver's letter behind a quantity.
_COLUMN = re.compile(r"(Time|Speed|E|N|Lat|Lon|IVS|Driver)(\d*)")
# Least distance [m] between the antennas of two cars that stand bumper to bumper, for a length to be believed.
_SHORTEST_M, _LONGEST_M = 2.5, 7.0


def _read_openacc(path: Path, choices: Choices) -> Tracks:
    """Read a platoon. Places in the plane become positions along the path that the cars share. Raises InputError."""
    sheet = _sheet(path, head_of(path))
    if sheet is None:
        raise InputError(f"{path}:{_HEADER}: not the columns of OpenACC (Time, Speed1, E1, N1, ...); check the file")
    found = {name: _COLUMN.fullmatch(name) for name in sheet.names}
    cars = sorted({int(one[2]) for one in found.values() if one is not None and one[1] == "Speed" and one[2]})
    numbers = {name for name, one in found.items() if one is not None and one[1] != "Driver"}
    table = {name: np.asarray(column) for name, column in read_sheet(sheet, numbers, set(), {"Time": 1.0}).items()}
    places = _places(table, cars, path)
    path_of_all = _common_path(places)
    if path_of_all is None:
        raise InputError(f"{path}: no car moves; give a recording of a drive")
    position, off = (np.stack(one, axis=1) for one in zip(*map(path_of_all.positions, places), strict=True))
    about = about_file(path, leaders="given").noting(
        f"positions are lengths along the common path; half of the samples lie within {np.nanmedian(off):.2g} m of it"
    )
    # The antennas' distance is the gap and the cars' lengths around it.
    length, about = _lengths(table, cars, position, about)
    brand = _brands(path, cars)
    speed = np.stack([table[f"Speed{car}"] for car in cars], axis=1)
    rows, column = np.nonzero(np.isfinite(position))
    ahead = np.array([cars.index(car - 1) if car - 1 in cars else -1 for car in cars], dtype=np.int32)
    name = [str(car) for car in cars]
    columns: dict[str, Array | Labels] = {
        "recording": labels(np.zeros(len(rows), dtype=np.int32), [shown_stem(path)]),
        "vehicle": labels(column.astype(np.int32), name),
        "leader": labels(ahead[column], name),
        "class": labels(column.astype(np.int32), brand),
        "time_s": table["Time"][rows] - np.nanmin(table["Time"]),
        "s_m": position[rows, column],
        "speed": speed[rows, column],
        "length_m": length[column],
    }
    about = about.without("a car was not recorded", int(np.sum(~np.isfinite(position))))
    return put_together(columns, about, choices)


def _places(table: dict[str, Array], cars: list[int], path: Path) -> list[Array]:
    """Places of the cars [m], (T, 2) each, east and north of one point that they share."""
    if all(f"E{car}" in table and f"N{car}" in table for car in cars):
        places = [np.stack((table[f"E{car}"], table[f"N{car}"]), axis=1) for car in cars]
        return [np.where(np.abs(place) <= _FARTHEST_M, place, np.nan) for place in places]
    bad = next((car for car in cars if f"Lat{car}" not in table or f"Lon{car}" not in table), None)
    if bad is not None or not cars:
        raise InputError(
            f"{path}:{_HEADER}: no column E{bad}, N{bad} or Lat{bad}, Lon{bad}; give the places of the cars"
        )
    latitude = np.stack([table[f"Lat{car}"] for car in cars])
    longitude = np.stack([table[f"Lon{car}"] for car in cars])
    latitude, longitude = (np.where(np.abs(angle) <= 360.0, angle, np.nan) for angle in (latitude, longitude))
    if not np.isfinite(latitude).any() or not np.isfinite(longitude).any():
        raise InputError(f"{path}: no car has a place; give a recording of a drive")
    if np.nanmax(np.abs(latitude)) > 0.5 * np.pi or np.nanmax(np.abs(longitude)) > np.pi:
        latitude, longitude = np.radians(latitude), np.radians(longitude)
    middle, east = float(np.nanmean(latitude)), float(np.nanmean(longitude))
    east_m = _EARTH_M * (longitude - east) * np.cos(middle)
    return list(np.stack((east_m, _EARTH_M * (latitude - middle)), axis=2))


def _lengths(table: dict[str, Array], cars: list[int], position: Array, about: About) -> tuple[Array, About]:
    """Lengths [m] of the cars, from the distance between two cars and the gap that the file gives."""
    between = np.full(len(cars), np.nan)
    misses = []
    for k, car in enumerate(cars[:-1]):
        if f"IVS{car}" in table and cars[k + 1] == car + 1:
            way = position[:, k] - position[:, k + 1] - table[f"IVS{car}"]
            if np.isfinite(way).any():
                between[k] = np.nanmedian(way)
                misses.append(float(np.nanmedian(np.abs(way - between[k]))))
    if not misses:
        return np.full(len(cars), np.nan), about
    note = (
        f"distances along the path agree with the given gaps within {np.median(misses):.2f} m (median) once lengths of"
    )
    note += f" {', '.join(f'{one:.1f}' for one in between[np.isfinite(between)])} m between cars are taken off"
    # One value lies between each two cars: each car has the mean of the values on its two sides.
    sides = np.stack((between, np.concatenate(([np.nan], between[:-1]))))
    known = np.isfinite(sides)
    length = np.where(known, sides, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    plausible = known.any(axis=0) & (length >= _SHORTEST_M) & (length <= _LONGEST_M)
    return np.where(plausible, length, np.nan), about.noting(note)


def _brands(path: Path, cars: list[int]) -> list[str]:
    """Make of each car, from the metadata; the car's number where it is not said."""
    with path.open(encoding="utf-8", errors="replace") as stream:
        lines = [stream.readline(10_000) for _ in range(_HEADER - 1)]
    order = next((line.strip().split(",")[1:] for line in lines if line.startswith("Vehicle_order")), [])
    return [order[car - 1] if car <= len(order) and order[car - 1] else f"car {car}" for car in cars]


def _sheet(path: Path, head: bytes) -> Sheet | None:
    sheet = None if head.startswith(b"PAR1") else sheet_of(path, head, header=_HEADER)
    found = sheet is not None and sheet.names[0] == "Time" and any(name.startswith("Speed") for name in sheet.names)
    return sheet if found else None


FORMAT = Format(
    name="openacc",
    suffixes=(".csv",),
    recognise=lambda head, path: _sheet(path, head) is not None,
    read=_read_openacc,
    summary="OpenACC: a platoon in one wide table; places become positions along the common path",
)


# Distance [m] between two points of a path.
_POINT_M = 1.0
# Distance [m] from the path within which a vehicle counts as on it when it is first seen.
_NEAR_M = 15.0
# Longest path [m] whose mean is taken.
_LONGEST_M = 1e6
# Rounds in which the mean path is taken: vehicles cut curves differently.
_ROUNDS = 2
# Points behind and ahead of the last one that are looked at, and more ahead for each sample that was missed.
_BACK, _AHEAD, _PER_MISSED = 8, 12, 5


class _Path:
    """A path of straight pieces. point_m: (P, 2), points [m] along the path."""

    def __init__(self, point_m: Array) -> None:
        self.point_m = point_m
        self._way = np.diff(point_m, axis=0)
        self._length = np.hypot(self._way[:, 0], self._way[:, 1])
        self._start = np.concatenate(([0.0], np.cumsum(self._length)))

    @property
    def length_m(self) -> float:
        """Length [m] of the path."""
        return float(self._start[-1])

    def positions(self, place_m: Array) -> tuple[Array, Array]:
        """Follow a vehicle along the path.

        place_m: (T, 2), places [m] of the vehicle; naN where missing. Returns (T,), position [m] along the path, and
        distance [m] from it; naN where missing.
        """
        position, off = np.full(len(place_m), np.nan), np.full(len(place_m), np.nan)
        piece, before = -1, 0
        for t in np.flatnonzero(np.isfinite(place_m).all(axis=1)).tolist():
            if piece < 0:
                first, last = self._first(place_m[t]), 0
                last = first + _BACK
                first = max(0, first - _BACK)
            else:
                first, last = max(0, piece - _BACK), piece + _AHEAD + _PER_MISSED * (t - before - 1)
            some = slice(first, min(last, len(self._length)))
            from_start = place_m[t] - self.point_m[:-1][some]
            way, length = self._way[some], self._length[some]
            along = np.clip(np.sum(from_start * way, axis=1) / length**2, 0.0, 1.0)
            # The first and the last piece go on beyond their ends.
            if first == 0:
                along[0] = min(1.0, float(from_start[0] @ way[0]) / length[0] ** 2)
            if last >= len(self._length):
                along[-1] = max(0.0, float(from_start[-1] @ way[-1]) / length[-1] ** 2)
            miss = from_start - along[:, None] * way
            distance = np.hypot(miss[:, 0], miss[:, 1])
            best = int(np.argmin(distance))
            position[t] = self._start[first + best] + along[best] * length[best]
            off[t], piece, before = distance[best], first + best, t
        return position, off

    def _first(self, place_m: Array) -> int:
        """Where a vehicle is first seen: the first part of the path that comes near."""
        distance = np.hypot(*(self.point_m[:-1] - place_m).T)
        near = np.flatnonzero(distance <= max(_NEAR_M, float(distance.min())))
        end = np.flatnonzero(np.diff(near) > 1)
        part = near[: end[0] + 1] if len(end) else near
        return int(part[np.argmin(distance[part])])


def _thinned(place_m: Array) -> Array:
    """Places (T, 2) that lie at least a metre apart, shape (P, 2); missing ones are left out."""
    known = place_m[np.isfinite(place_m).all(axis=1)]
    kept: list[int] = []
    for k, place in enumerate(known):
        if not kept or np.hypot(*(place - known[kept[-1]])) >= _POINT_M:
            kept.append(k)
    return np.asarray(known[kept])


def _common_path(places_m: list[Array]) -> _Path | None:
    """The path of vehicles that drive one behind the other.

    places_m: (T, 2), places [m] of the vehicles at the same times, the first vehicle first; naN where missing.
    """
    places_m = [place for place in places_m if np.isfinite(place).all(axis=1).any()]
    if not places_m:
        return None
    point = _thinned(places_m[-1])
    for place in places_m[-2::-1]:
        if len(point) < 2:
            point = _thinned(place)
            continue
        path = _Path(point)
        position, _ = path.positions(place)
        beyond: Ints = np.flatnonzero(position > path.length_m + _POINT_M)
        if len(beyond):
            point = np.concatenate((point, _thinned(place[beyond[0] :])))
    if len(point) < 2:
        return None
    path = _Path(point)
    for _ in range(_ROUNDS):
        path = _mean_path(path, places_m)
    return path


def _mean_path(path: _Path, places_m: list[Array]) -> _Path:
    """The mean of the places at which vehicles pass each point of a path."""
    followed = [(position, place) for place in places_m for position in [path.positions(place)[0]]]
    low = min(float(np.nanmin(position)) for position, _ in followed)
    high = max(float(np.nanmax(position)) for position, _ in followed)
    if high - low > _LONGEST_M:
        return path
    point = np.arange(low, high, _POINT_M)
    total, passed = np.zeros((len(point), 2)), np.zeros(len(point))
    for position, place in followed:
        known = np.isfinite(position)
        way = np.maximum.accumulate(position[known])
        inside = (point >= way[0]) & (point <= way[-1])
        passed += inside
        for axis in (0, 1):
            total[:, axis] += np.where(inside, np.interp(point, way, place[known, axis]), 0.0)
    mean = _thinned(total[passed > 0] / passed[passed > 0, None])
    return _Path(mean) if len(mean) > 1 else path
