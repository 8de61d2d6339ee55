"""Networks of SUMO (``.net.xml``): lanes and connections, who lets whom pass, and the programs of traffic lights.

P. Alvarez Lopez et al.: Microscopic traffic simulation using SUMO. IEEE Intelligent Transportation Systems Conference,
2018, doi 10.1109/ITSC.2018.8569938.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.map_parts import MapLanes
from sugiyama_ros.formats.reading import elements, number, root_of
from sugiyama_ros.roads.conflicts import conflicts_of_geometry
from sugiyama_ros.roads.network import Lanelet, Network, Signal, periodic

# Points of all lanes, at most.
_MAX_POINTS = 200_000
# Functions of edges that are not for cars.
_NOT_FOR_CARS = {"crossing", "walkingarea"}
# Letters of a phase with which vehicles may drive: with priority, without, after a stop, and lights that are off.
_GREEN = {"G", "g", "s", "o", "O"}


class _Link(NamedTuple):
    """A way across a junction: the lanes before and after it, its first lane inside, and its traffic light."""

    before: str
    after: str
    via: str
    light: str
    place: int


@dataclass
class _Net:
    """What a file says: lanes and the links from them, and of junctions and traffic lights by name.

    map: the lanes; some inside junctions have no length; keeps_left: whether vehicles keep to the left.
    """

    map: MapLanes
    keeps_left: bool
    links: dict[str, list[_Link]] = field(default_factory=dict)
    junctions: dict[str, Element] = field(default_factory=dict)
    programs: dict[str, Element] = field(default_factory=dict)


def read_sumo_net(path: Path) -> Network:
    """Read a network of SUMO. Raises InputError."""
    keeps_left = root_of(path).get("lefthand", "").lower() in ("1", "true")
    net, points = _Net(MapLanes(path), keeps_left), 0
    for element in elements(path, "edge", "junction", "connection", "tlLogic"):
        name = element.get("id", "")
        if element.tag == "connection":
            _add_link(net, element)
        elif element.tag == "junction":
            junction = net.junctions[name] = Element("junction", element.attrib)
            junction.extend([Element("request", one.attrib) for one in element.iterfind("request")])
        elif element.tag == "tlLogic":
            # of several programs of a light, SUMO begins with the last one
            program = net.programs[name] = Element("tlLogic", element.attrib)
            program.extend([Element("phase", one.attrib) for one in element.iterfind("phase")])
        elif element.get("function") not in _NOT_FOR_CARS:
            points += _add_lanes(net, element, path)
        if points > _MAX_POINTS:
            raise InputError(f"{path}: more than {_MAX_POINTS} points of lanes; cut the network")
    try:
        return _network(net, path)
    except InputError as error:
        raise error if str(error).startswith(str(path)) else InputError(f"{path}: {error}") from None


def _add_link(net: _Net, element: Element) -> None:
    said = element.attrib
    before, after = (
        f"{said.get(edge, '')}_{said.get(lane, '')}" for edge, lane in (("from", "fromLane"), ("to", "toLane"))
    )
    place = said.get("linkIndex", "")
    link = _Link(before, after, said.get("via", ""), said.get("tl", ""), int(place) if place.isdigit() else -1)
    net.links.setdefault(before, []).append(link)


def _is_for_cars(lane: Element) -> bool:
    allowed, forbidden = lane.get("allow", "passenger").split(), lane.get("disallow", "").split()
    return bool({"passenger", "all"} & set(allowed)) and not {"passenger", "all"} & set(forbidden)


def _add_lanes(net: _Net, edge: Element, path: Path) -> int:
    """Add the lanes of an edge that are for cars; returns the number of their points."""
    lanes = [*edge.iterfind("lane")]
    for lane in [one for one in lanes if not _is_for_cars(one)]:
        net.map.not_for_cars(" ".join(lane.get("allow", "closed").split()[:3]))
        lanes.remove(lane)
    # the first lane of an edge is the one at the side of the road
    names, points = [lane.get("id", "") for lane in lanes], 0
    for lane, name, outer, inner in zip(lanes, names, ["", *names], [*names[1:], ""], strict=False):
        with net.map.unreadable("lanes"):
            where = f"{path}: lane {name[:40]}"
            shape = _shape(lane, where)
            points += len(shape)
            if len(shape) == 1:
                net.map.points[name] = ()
                continue
            limit = net.map.speed_limit(lane.get("speed", ""), "m/s", where)
            width = number(lane.get("width", "3.2"), "width", where)
            left, right = (outer, inner) if net.keeps_left else (inner, outer)
            net.map.lanes[name] = Lanelet(name, shape[:, 0], shape[:, 1], (), left, right, limit, width)
    return points


def _shape(lane: Element, where: str) -> Array:
    """The points (P, 2) [m] of a lane, without those that are the one before them."""
    corners = [one.split(",") for one in lane.get("shape", "").split()]
    if min(map(len, corners), default=0) < 2:
        raise InputError(f"{where}: shape: no points, or a point without y; correct it")
    points = np.array([[number(text, "shape", where) for text in one[:2]] for one in corners])
    kept: Array = points[np.concatenate(([True], np.hypot(*np.diff(points, axis=0).T) > 0.0))]
    return kept


def _network(net: _Net, path: Path) -> Network:
    after = {name: tuple(one.via or one.after for one in links) for name, links in net.links.items()}
    net.map.points = {name: after.get(name, ()) for name in net.map.points}
    net.map.lanes = {name: replace(one, successors=after.get(name, ())) for name, one in net.map.lanes.items()}
    lanes = net.map.linked("give a network of SUMO")
    phases = {name: [one.get("state", "") for one in program] for name, program in net.programs.items()}
    first: dict[str, set[str]] = {}
    stop_m: dict[str, float] = {}
    for junction in net.junctions.values():
        for way, waits, others in _ways(net, junction, phases):
            before = 0.0
            for k, name in enumerate(way):
                first.setdefault(name, set()).update(others)
                # who waits inside the junction drives to the end of the first lane there
                if not (waits and k == 0):
                    stop_m[name] = 0.0 - before
                    before += net.map.lanes[name].length_m
    conflicts = tuple(
        replace(one, yields=one.other in first.get(one.lane, ())) for one in conflicts_of_geometry(lanes, stop_m=stop_m)
    )
    return Network(lanes, conflicts, tuple(_signals(net, path)), net.map.notes())


def _ways(
    net: _Net, junction: Element, phases: Mapping[str, Sequence[str]]
) -> Iterator[tuple[list[str], bool, set[str]]]:
    """Ways across a junction: the lanes inside, whether drivers wait inside, and the lanes that they let pass."""
    ways: dict[str, tuple[_Link, list[str]]] = {}
    for link in (one for name in junction.get("incLanes", "").split() for one in net.links.get(name, ())):
        inside = _inside(net, link)
        if inside:
            ways[inside[-1]] = link, [name for name in inside if name in net.map.lanes]
    # requests are numbered as the last lanes inside the junction are listed
    numbered = junction.get("intLanes", "").split()
    for request in junction.iterfind("request"):
        index, response = request.get("index", ""), request.get("response", "")[::-1]
        own = ways.get(numbered[int(index)]) if index.isdigit() and int(index) < len(numbered) else None
        if own is None:
            continue
        others = set()
        for name, yields in zip(numbered, response, strict=False):
            other = ways.get(name)
            if yields == "1" and other is not None and _together(own[0], other[0], phases):
                others.update(other[1])
        yield own[1], request.get("cont") == "1", others


def _inside(net: _Net, link: _Link) -> list[str]:
    """The lanes of a link inside its junction."""
    lanes, name = [], link.via
    while (name in net.map.lanes or name in net.map.points) and name not in lanes:
        lanes.append(name)
        name = next((one.via for one in net.links.get(name, ())), "")
    return lanes


def _together(one: _Link, other: _Link, phases: Mapping[str, Sequence[str]]) -> bool:
    """Whether two links may have green together; who has green alone lets nobody pass."""
    if not one.light or one.light != other.light:
        return True
    return any(
        max(one.place, other.place) < len(state) and {state[one.place], state[other.place]} <= _GREEN
        for state in phases.get(one.light, ())
    )


def _signals(net: _Net, path: Path) -> Iterator[Signal]:
    """The signals of links, at the start of their lanes inside; those without a fixed program have no times."""
    for link in (one for links in net.links.values() for one in links if one.light in net.programs):
        program = net.programs[link.light]
        where = f"{path}: tlLogic {link.light[:40]}"
        states = [one.get("state", "") for one in program]
        if link.via not in net.map.lanes or not all(0 <= link.place < len(state) for state in states):
            continue
        if program.get("type", "static") != "static" or not states:
            yield Signal(link.via, 0.0, np.zeros(0), np.zeros(0, dtype=bool))
            continue
        duration = np.array([number(one.get("duration", ""), "duration", where) for one in program])
        offset = number(program.get("offset", "0"), "offset", where)
        red = np.array([state[link.place] not in _GREEN for state in states])
        yield periodic(link.via, 0.0, offset, duration, red)
