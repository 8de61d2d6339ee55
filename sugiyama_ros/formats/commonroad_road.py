"""The road of a CommonRoad scenario: lanelets, traffic signs, stop lines, traffic lights and intersections.

M. Althoff, M. Koschi, S. Manzinger: CommonRoad: Composable benchmarks for motion planning on roads. IEEE Intelligent
Vehicles Symposium, 2017, doi 10.1109/IVS.2017.7995802. The form of the files is that of versions 2018b and 2020a.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.map_parts import MapLanes, middle_of
from sugiyama_ros.formats.reading import elements, number, root_of
from sugiyama_ros.roads.conflicts import conflicts_of_geometry
from sugiyama_ros.roads.network import Conflict, Lanelet, Network, Signal, periodic

#: Points of all lanelets of a file, at most.
MAX_POINTS = 200_000
#: Time [s] between two steps where the file does not say it.
USUAL_S = 0.1
# Types of lanelets that are not for vehicles.
_NOT_FOR_VEHICLES = {"crosswalk", "sidewalk", "bicycleLane"}
# Traffic signs: yield and stop; right of way and priority road; a speed limit [m/s]. The numbers are German.
_YIELD, _FIRST, _LIMIT = {"205", "206", "R1-1", "R1-2"}, {"301", "306"}, {"274", "274.1", "R2-1"}
# Where the lanelets go for which a traffic light is.
_GOES = {"left": "Left", "straight": "Straight", "right": "Right"}
# Two roads come from opposite directions if the cosine of the angle between them is below this: more than 135 degrees.
_OPPOSITE = -np.sqrt(0.5)


def value_of(element: Element, name: str, where: str, of: str = "") -> float:
    """A number below an element. Raises InputError."""
    return number(element.findtext(name, "").strip(), of + name.replace("/", " "), where)


def add_lanelet(element: Element, path: Path, lanes: MapLanes) -> None:
    """Add a lanelet, which names others that may not be there, or leave it out."""
    name = element.get("id", "")
    where, after = f"{path}: lanelet {name[:40]}", _refs(element, "successor")
    with lanes.unreadable("lanelets"):
        left, right = (
            np.array(
                [[value_of(p, "x", where), value_of(p, "y", where)] for p in element.iterfind(f"{side}Bound/point")]
            )
            for side in ("left", "right")
        )
        if min(len(left), len(right)) < 2:
            raise InputError(
                f"{where}: {len(left)} points on the left and {len(right)} on the right; give two or more of each"
            )
        x, y, width = middle_of(left, right, len(left) == len(right))
        beside_left, beside_right = (
            next((one.get("ref", "") for one in element.iterfind(side) if one.get("drivingDir", "same") == "same"), "")
            for side in ("adjacentLeft", "adjacentRight")
        )
        if len(x) == 1:
            lanes.points[name] = after
        else:
            lanes.lanes[name] = Lanelet(name, x, y, after, beside_left, beside_right, width_m=width)


def read_commonroad_road(path: Path) -> Network:
    """Read the road of a scenario. Raises InputError."""
    said = root_of(path).get("timeStepSize")
    period = USUAL_S if said is None else number(said.strip(), "timeStepSize", str(path))
    file = _Scenario(MapLanes(path))
    count = 0
    for element in elements(path, "lanelet", "trafficSign", "trafficLight", "intersection"):
        name = element.get("id", "")
        if element.tag == "trafficSign":
            file.signs[name] = [*_signs(element, file.map)]
        elif element.tag == "trafficLight":
            with file.map.unreadable("traffic lights"):
                file.lights[name] = _light(element, path, period)
        elif element.tag == "intersection":
            file.incoming += [
                ({goes: _refs(one, f"successors{goes}") for goes in _GOES.values()}, _refs(one, "incomingLanelet"))
                for one in element.iterfind("incoming")
            ]
        elif (
            kinds := {one.text for kind in ("laneletType", "type") for one in element.iterfind(kind)}
            & _NOT_FOR_VEHICLES
        ):
            file.map.not_for_cars(" ".join(sorted(map(str, kinds))))
        else:
            add_lanelet(element, path, file.map)
            file.signs_of[name] = _refs(element, "trafficSignRef")
            file.lights_of[name] = _refs(element, "trafficLightRef")
            if element.find("stopLine") is not None:
                with file.map.unreadable("stop lines"):
                    points = element.iterfind("stopLine/point")
                    file.stop[name] = [(value_of(p, "x", str(path)), value_of(p, "y", str(path))) for p in points]
            count += len(element.findall("leftBound/point"))
        if count > MAX_POINTS:
            raise InputError(f"{path}: more than {MAX_POINTS} points of lanelets; split the file")
    return _network(file)


class _Light(NamedTuple):
    """A traffic light: where the lanelets go for which it is (empty for everywhere), and a signal with its phases."""

    goes: tuple[str, ...]
    signal: Signal


@dataclass
class _Scenario:
    """What a file says: of lanelets by name, of signs and lights by name, and where incoming lanelets lead."""

    map: MapLanes
    signs_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    lights_of: dict[str, tuple[str, ...]] = field(default_factory=dict)
    stop: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    signs: dict[str, list[tuple[str, float]]] = field(default_factory=dict)
    lights: dict[str, _Light] = field(default_factory=dict)
    incoming: list[tuple[dict[str, tuple[str, ...]], tuple[str, ...]]] = field(default_factory=list)


class _Arm(NamedTuple):
    """How vehicles come to a lanelet of an intersection: their heading [rad] before; whether to turn left; a light."""

    heading: float
    left: bool
    has_light: bool


def _refs(element: Element, name: str) -> tuple[str, ...]:
    return tuple(one.get("ref", "") for one in element.iterfind(name))


def _signs(element: Element, lanes: MapLanes) -> Iterator[tuple[str, float]]:
    """The signs at a place: the number of each, and the speed limit on it, or infinity."""
    where = f"traffic sign {element.get('id', '')[:40]}"
    for one in element.iterfind("trafficSignElement"):
        kind, value = one.findtext("trafficSignID", "").strip(), one.findtext("additionalValue", "").strip()
        yield kind, lanes.speed_limit(value, "m/s", where) if kind in _LIMIT and value else np.inf


def _light(element: Element, path: Path, period_s: float) -> _Light:
    where = f"{path}: traffic light {element.get('id', '')[:40]}"
    phases = [*element.iterfind("cycle/cycleElement")]
    if element.findtext("active", "true").strip().lower() == "false":
        phases = []
    duration = np.array([value_of(one, "duration", where) for one in phases]) * period_s
    red = np.array([one.findtext("color", "").strip() not in ("green", "inactive") for one in phases], dtype=bool)
    offset = value_of(element, "cycle/timeOffset", where) if element.find("cycle/timeOffset") is not None else 0.0
    direction = element.findtext("direction", "all").strip().lower()
    goes = tuple(_GOES[name] for name in _GOES if name in direction)
    try:
        return _Light(goes, periodic("", 0.0, offset * period_s, duration, red))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _network(file: _Scenario) -> Network:
    file.map.lanes = {
        name: replace(one, speed_limit=min((limit for _, limit in _of(file, name)), default=np.inf))
        for name, one in file.map.lanes.items()
    }
    bare = Network(file.map.linked("give a scenario with a road"))
    priority: dict[str, int] = {}
    stop_m: dict[str, float] = {}
    for k, lane in enumerate(bare.lanes):
        kinds = {kind for kind, _ in _of(file, lane.name)}
        if sign := -1 if kinds & _YIELD else int(bool(kinds & _FIRST)):
            place = _stop(file, lane)
            for other, way_m in bare.arm(k).items():
                name = bare.lanes[other].name
                priority[name] = min(sign, priority.get(name, sign))
                if sign < 0 and lane.name in file.stop:
                    stop_m[name] = place - way_m
    arms = _arms(file, bare)
    found = conflicts_of_geometry(bare.lanes, priority, stop_m)
    conflicts = tuple(replace(one, yields=one.yields or _yields(one, priority, arms)) for one in found)
    return Network(bare.lanes, conflicts, _signals(file, bare), file.map.notes())


def _of(file: _Scenario, name: str) -> list[tuple[str, float]]:
    """The signs of a lanelet."""
    return [one for sign in file.signs_of[name] for one in file.signs.get(sign, ())]


def _stop(file: _Scenario, lane: Lanelet) -> float:
    """Place [m] on a lanelet of its stop line: without points, its end."""
    if not file.stop.get(lane.name):
        return lane.length_m
    x, y = np.mean(file.stop[lane.name], axis=0)
    s, _ = lane.line.project(np.array([x]), np.array([y]))
    return float(np.clip(s[0], 0.0, lane.length_m))


def _arms(file: _Scenario, network: Network) -> dict[str, _Arm]:
    """How vehicles come to each lanelet of an intersection."""
    arms = {}
    names = {lane.name for lane in network.lanes}
    for leads, incoming in file.incoming:
        before = [network.lanes[network.number(name)] for name in incoming if name in names]
        for goes, after in leads.items():
            for name in (one for one in after if one in names and before):
                heading = float(before[0].line.heading(np.array([before[0].length_m]))[0])
                lit = any(file.lights_of[one] for one in (*(lane.name for lane in before), name))
                for k in network.arm(network.number(name)):
                    arms[network.lanes[k].name] = _Arm(heading, goes == "Left", lit)
    return arms


def _yields(one: Conflict, priority: Mapping[str, float], arms: Mapping[str, _Arm]) -> bool:
    """Whether drivers yield where no sign says it: to those who come towards them, or from the right."""
    own, its = arms.get(one.lane), arms.get(one.other)
    if own is None or its is None or priority.get(one.lane, 0.0) != priority.get(one.other, 0.0):
        return False
    if np.cos(its.heading - own.heading) < _OPPOSITE:
        return own.left and not its.left
    # who drives towards the left comes from the right
    return not (own.has_light or its.has_light) and bool(np.sin(its.heading - own.heading) > 0.0)


def _signals(file: _Scenario, network: Network) -> tuple[Signal, ...]:
    """The first traffic light of each lanelet, or of each lanelet behind it for which it is."""
    goes_of = {name: goes for leads, _ in file.incoming for goes, names in leads.items() for name in names}
    found: dict[str, Signal] = {}
    for lane in network.lanes:
        stop = _stop(file, lane)
        for light in (file.lights[name] for name in file.lights_of[lane.name] if name in file.lights):
            own = not light.goes or goes_of.get(lane.name) in light.goes
            behind = [name for name in lane.successors if goes_of.get(name) in light.goes]
            places: Sequence[tuple[str, float]] = [(name, stop - lane.length_m) for name in behind]
            for name, stop_m in [(lane.name, stop)] if own else places:
                found.setdefault(name, replace(light.signal, lane=name, stop_m=stop_m))
    return tuple(found.values())
