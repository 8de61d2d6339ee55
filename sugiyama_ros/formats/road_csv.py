"""Roads in CSV: a row for each point of the middle of a lane."""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from io import TextIOWrapper
from pathlib import Path

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import writing
from sugiyama_ros.formats.reading import lines, number, open_input
from sugiyama_ros.roads.conflicts import conflicts_of_geometry
from sugiyama_ros.roads.network import Lanelet, Network, Signal

_NEEDED = ("lane", "x_m", "y_m")
# What may be said of a lane as a whole, in any of its rows.
_TEXTS = ("successors", "left", "right", "yields_to", "signal")
_NUMBERS = ("speed_limit", "width_m", "priority", "stop_m", "signal_m")
# Points of all lanes, at most.
_MAX_POINTS = 200_000
# Times [s] and colours, and perhaps the length [s] of a cycle.
_PHASE = r"\d+(?:\.\d+)?:(?:red|green)"
_PHASES = re.compile(rf"({_PHASE}(?:\s+{_PHASE})*)(?:\s*/\s*(\d+(?:\.\d+)?))?")


@dataclass
class _LaneRows:
    """The rows of a lane: where the first one is, the points, and what is said of the lane by column."""

    where: str
    points: list[tuple[float, float]] = field(default_factory=list)
    said: dict[str, str] = field(default_factory=dict)

    def number(self, name: str) -> float | None:
        """A number that is said of the lane. Raises InputError."""
        return number(self.said[name], name, self.where) if name in self.said else None


def read_road_csv(path: Path) -> Network:
    """Read a road out of CSV; the places where lanes meet are found out of their middle lines. Raises InputError."""
    lanes: dict[str, _LaneRows] = {}
    with open_input(path) as stream:
        text = lines(path, stream)
        head = [name.strip() for name in next(csv.reader([next(text, "")]), [])]
        known = (*_NEEDED, *_TEXTS, *_NUMBERS)
        wrong = [f"unknown column {name!r}" for name in head if name not in known]
        wrong += [f"no column {name}" for name in _NEEDED if name not in head]
        if wrong:
            raise InputError(f"{path}:1: {wrong[0]}; the columns of a road are {', '.join(known)}")
        for k, line in enumerate(text, 2):
            if line.strip():
                _add(lanes, head, line, f"{path}:{k}")
            if k > _MAX_POINTS:
                raise InputError(f"{path}: more than {_MAX_POINTS} points; give fewer points of each lane")
    try:
        return _network(lanes)
    except InputError as error:
        raise error if str(error).startswith(str(path)) else InputError(f"{path}: {error}") from None


def _add(lanes: dict[str, _LaneRows], head: list[str], line: str, where: str) -> None:
    """Add a row to its lane."""
    row = [one.strip() for one in next(csv.reader([line]))]
    if len(row) != len(head):
        raise InputError(f"{where}: {len(row)} of {len(head)} fields; correct or remove the line")
    cells = dict(zip(head, row, strict=True))
    name = cells["lane"]
    if len(name.split()) != 1:
        raise InputError(f"{where}: {name!r} is not the name of a lane; give each lane a name without spaces")
    lane = lanes.setdefault(name, _LaneRows(where))
    lane.points.append((number(cells["x_m"], "x_m", where), number(cells["y_m"], "y_m", where)))
    for column, text in cells.items():
        if column not in _NEEDED and text and lane.said.setdefault(column, text) != text:
            raise InputError(f"{where}: {column} of lane {name} is {lane.said[column][:40]!r} above; a lane has one")


def _network(rows: Mapping[str, _LaneRows]) -> Network:
    lanes, signals = [], []
    for name, one in rows.items():
        x, y = np.array(one.points).T
        lane = Lanelet(
            name,
            x,
            y,
            successors=tuple(one.said.get("successors", "").split()),
            left=one.said.get("left", ""),
            right=one.said.get("right", ""),
            **{column: value for column in ("speed_limit", "width_m") if (value := one.number(column)) is not None},
        )
        lanes.append(lane)
        if "signal" in one.said:
            stop_m = one.number("signal_m")
            signals.append(_signal(one, lane, lane.length_m if stop_m is None else stop_m))
    network = Network(tuple(lanes), (), tuple(signals))
    yields_to = {name: one.said.get("yields_to", "").split() for name, one in rows.items()}
    for name, others in yields_to.items():
        for other in others:
            network.number(other, f"{rows[name].where}: yields_to")
    priority, stop = (
        {name: value for name, one in rows.items() if (value := one.number(column)) is not None}
        for column in ("priority", "stop_m")
    )
    conflicts = tuple(
        replace(one, yields=one.yields or one.other in yields_to[one.lane])
        for one in conflicts_of_geometry(lanes, priority, stop)
    )
    return replace(network, conflicts=conflicts)


def _signal(rows: _LaneRows, lane: Lanelet, stop_m: float) -> Signal:
    text = rows.said["signal"]
    if not (found := _PHASES.fullmatch(text)):
        raise InputError(
            f"{rows.where}: signal {text[:40]!r} is no list of times and colours; write 0:red 30:green /60"
        )
    phases = [one.split(":") for one in found[1].split()]
    red = np.array([colour == "red" for _, colour in phases])
    return Signal(lane.name, stop_m, np.array([float(time) for time, _ in phases]), red, float(found[2] or 0.0))


def write_road(network: Network, path: Path) -> None:
    """Write a road as CSV, with the first place of each lane where drivers wait. Raises OutputError."""
    signals = {one.lane: one for one in network.signals}
    columns = (*_NEEDED, *_TEXTS, *(name for name in _NUMBERS if name != "priority"))
    with writing(path) as stream:
        text = TextIOWrapper(stream, "utf-8", newline="")
        table = csv.DictWriter(text, columns, restval="")
        table.writeheader()
        for k, lane in enumerate(network.lanes):
            said: dict[str, object] = {"successors": " ".join(lane.successors), "left": lane.left, "right": lane.right}
            said["speed_limit"] = repr(float(lane.speed_limit)) if np.isfinite(lane.speed_limit) else ""
            said["width_m"] = repr(float(lane.width_m))
            yields = [one for one in network.conflicts_of[k] if one.yields]
            said["yields_to"] = " ".join(dict.fromkeys(one.other for one in yields))
            if stops := [one.stop_m for one in network.conflicts_of[k] if one.stop_m < one.enter_m]:
                said["stop_m"] = repr(float(min(stops)))
            if lane.name in signals:
                signal = signals[lane.name]
                phases = zip(signal.change_s.tolist(), signal.red.tolist(), strict=True)
                said["signal"] = " ".join(f"{time!r}:{'red' if red else 'green'}" for time, red in phases)
                said["signal"] = f"{said['signal']} /{signal.cycle_s!r}" if signal.cycle_s else said["signal"]
                said["signal_m"] = repr(float(signal.stop_m))
            for x, y in zip(lane.x_m.tolist(), lane.y_m.tolist(), strict=True):
                table.writerow({"lane": lane.name, "x_m": repr(x), "y_m": repr(y), **said})
                said = {}
        text.flush()
        text.detach()
