"""Maps of Lanelet2 in the format of OpenStreetMap: nodes, ways, and relations that are lanelets or rules.

F. Poggenhans et al.: Lanelet2: A high-definition map framework for the future of automated driving. IEEE Intelligent
Transportation Systems Conference, 2018, doi 10.1109/ITSC.2018.8569929.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import elements, number
from sugiyama_ros.roads.conflicts import conflicts_of_geometry
from sugiyama_ros.roads.network import FARTHEST_M, Lanelet, Network, Signal

# Subtypes of lanelets for cars.
_FOR_CARS = {"road", "highway", "play_street", "exit", "bus_lane"}
# Nodes of a map, at most.
_MAX_NODES = 1_000_000
# Way [m] between two points of a middle line, about.
_STEP_M = 2.0
# Widths [m] of lanelets, at least and at most: some begin or end with no width at all.
_WIDTHS_M = (0.5, 50.0)
# A map nearer to latitude and longitude 0 than this [degrees] was drawn about that point.
_NEAR_ZERO = 1.0
# A speed, and the units it may have [m/s].
_SPEED = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(km/h|kmh|mph|m/s|mps)?\s*")
_UNITS = {"km/h": 1.0 / 3.6, "kmh": 1.0 / 3.6, "mph": 0.44704, "m/s": 1.0, "mps": 1.0}


class _Relation(NamedTuple):
    """A relation: its tags, and the numbers of its members by role."""

    tags: dict[str, str]
    members: dict[str, list[str]]


@dataclass
class _Map:
    """A map: local places of nodes [m] and their latitudes and longitudes [degrees]; ways, lanelets and rules."""

    local: dict[str, tuple[float, float]] = field(default_factory=dict)
    degrees: dict[str, tuple[float, float]] = field(default_factory=dict)
    way: dict[str, list[str]] = field(default_factory=dict)
    lanelets: dict[str, _Relation] = field(default_factory=dict)
    rules: dict[str, _Relation] = field(default_factory=dict)

    def places(self, nodes: Sequence[str]) -> Array:
        """Places (N, 2) [m] of nodes. Raises InputError."""
        if missing := [one for one in nodes if one not in self.local]:
            raise InputError(f"no node {missing[0]}, or no place of it; write the map as a whole")
        found = np.array([self.local[one] for one in nodes])
        if not (np.abs(found) < FARTHEST_M).all():
            raise InputError(f"a node is no place on earth, such as {nodes[0]} or one beside it; correct the map")
        return found


class _Bounds(NamedTuple):
    """The nodes of the left and the right bound of a lanelet, in the direction of driving."""

    left: tuple[str, ...]
    right: tuple[str, ...]


def read_lanelet2(path: Path) -> Network:
    """Read a map of Lanelet2. Raises InputError."""
    file = _Map()
    for element in elements(path, "node", "way", "relation"):
        if element.get("action") == "delete":
            continue
        name = element.get("id", "")
        if element.tag == "node":
            _add_node(file, element, f"{path}: node {name[:40]}")
        elif element.tag == "way":
            file.way[name] = [one.get("ref", "") for one in element.iterfind("nd")]
        else:
            relation = _relation(element)
            if relation.tags.get("type") == "lanelet" and relation.tags.get("subtype", "road") in _FOR_CARS:
                file.lanelets[name] = relation
            elif relation.tags.get("type") == "regulatory_element":
                file.rules[name] = relation
        if len(file.degrees) + len(file.local) + len(file.way) > _MAX_NODES:
            raise InputError(f"{path}: more than {_MAX_NODES} nodes and ways; cut the map")
    if not file.lanelets:
        raise InputError(f"{path}: no lanelets for cars; give a map of Lanelet2")
    if file.degrees.keys() - file.local.keys():
        # local places count if all nodes have them
        file.local = dict(zip(file.degrees, projected(np.array([*file.degrees.values()])).tolist(), strict=True))
    try:
        return _network(file)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _relation(element: Element) -> _Relation:
    members: dict[str, list[str]] = {}
    for one in element.iterfind("member"):
        members.setdefault(one.get("role", ""), []).append(one.get("ref", ""))
    return _Relation(_tags(element), members)


def _tags(element: Element) -> dict[str, str]:
    return {one.get("k", ""): one.get("v", "").strip() for one in element.iterfind("tag")}


def _add_node(file: _Map, element: Element, where: str) -> None:
    name, tags = element.get("id", ""), _tags(element)
    for source, names, places in (
        (tags, ("local_x", "local_y"), file.local),
        (element.attrib, ("x", "y"), file.local),
        (element.attrib, ("lat", "lon"), file.degrees),
    ):
        if names[0] in source and name not in places:
            first, second = (number(source.get(one, ""), one, where) for one in names)
            places[name] = first, second


def projected(degrees: Array) -> Array:
    """Places (N, 2) [m], east and north, of latitudes and longitudes (N, 2) [degrees], by UTM on the ellipsoid WGS 84.

    Maps that are drawn about latitude and longitude 0, as those of INTERACTION, count from there. Up to about a
    millimetre, by Krueger's series to the third order: C. F. F. Karney: Transverse Mercator with an accuracy of a few
    nanometers. Journal of Geodesy 85, 2011, doi 10.1007/s00190-011-0445-3.
    """
    middle = np.median(degrees, axis=0)
    about_zero = (np.abs(middle) < _NEAR_ZERO).all()
    meridian = 3.0 if about_zero else 6.0 * np.floor(middle[1] / 6.0) + 3.0
    place = _mercator(degrees, meridian)
    if about_zero:
        return place - _mercator(np.zeros((1, 2)), meridian)
    place[:, 0] += 500_000.0
    place[:, 1] += 10_000_000.0 * (middle[0] < 0.0)
    return place


def _mercator(degrees: Array, meridian: float) -> Array:
    """Ways (N, 2) [m] east of a meridian [degrees] and north of the equator, on a scale of 0.9996."""
    radius_m, flattening = 6_378_137.0, 1.0 / 298.257223563
    n = flattening / (2.0 - flattening)
    series = (
        n / 2.0 - 2.0 * n**2 / 3.0 + 5.0 * n**3 / 16.0,
        13.0 * n**2 / 48.0 - 3.0 * n**3 / 5.0,
        61.0 * n**3 / 240.0,
    )
    latitude, longitude = np.radians(degrees[:, 0]), np.radians(degrees[:, 1] - meridian)
    e = 2.0 * np.sqrt(n) / (1.0 + n)
    t = np.sinh(np.arctanh(np.sin(latitude)) - e * np.arctanh(e * np.sin(latitude)))
    north, east = np.arctan2(t, np.cos(longitude)), np.arctanh(np.sin(longitude) / np.hypot(1.0, t))
    both = north + 1j * east
    both = both + sum(factor * np.sin(2.0 * k * both) for k, factor in enumerate(series, 1))
    scale = 0.9996 * radius_m / (1.0 + n) * (1.0 + n**2 / 4.0 + n**4 / 64.0)
    return np.asarray(scale * np.stack((both.imag, both.real), axis=1))


def _network(file: _Map) -> Network:
    bounds = {name: _bounds(file, name, one) for name, one in file.lanelets.items()}
    begins: dict[tuple[str, str], list[str]] = {}
    for name, one in bounds.items():
        begins.setdefault((one.left[0], one.right[0]), []).append(name)
    by_left, by_right = ({getattr(one, side): name for name, one in bounds.items()} for side in ("left", "right"))
    lanes = []
    for name, (left, right) in bounds.items():
        x, y, width = _middle(file.places(left), file.places(right))
        after = tuple(begins.get((left[-1], right[-1]), ()))
        limit = _limit(file, file.lanelets[name])
        lanes.append(Lanelet(name, x, y, after, by_right.get(left, ""), by_left.get(right, ""), limit, width))
    network = Network(tuple(lanes))
    first, stop_m = _right_of_way(file, network)
    conflicts = conflicts_of_geometry(lanes, stop_m=stop_m)
    conflicts = tuple(replace(one, yields=one.other in first.get(one.lane, ())) for one in conflicts)
    return Network(network.lanes, conflicts, tuple(_signals(file, network)))


def _bounds(file: _Map, name: str, lanelet: _Relation) -> _Bounds:
    """The bounds of a lanelet: in the direction in which the left one is to the left."""
    ways = [file.way.get(way, []) for side in ("left", "right") for way in lanelet.members.get(side, ())]
    if len(ways) != 2 or min(map(len, ways)) < 2:
        raise InputError(f"lanelet {name}: not one left and one right bound of two nodes or more; correct the map")
    left, right = ways
    one, other = file.places(left), file.places(right)
    if _apart(one, other) > _apart(one, other[::-1]):
        right, other = right[::-1], other[::-1]
    way, across = one[-1] + other[-1] - one[0] - other[0], one[0] + one[-1] - other[0] - other[-1]
    if way[0] * across[1] < way[1] * across[0]:
        left, right = left[::-1], right[::-1]
    return _Bounds(tuple(left), tuple(right))


def _apart(one: Array, other: Array) -> float:
    return float(np.hypot(*(one[0] - other[0])) + np.hypot(*(one[-1] - other[-1])))


def _middle(left: Array, right: Array) -> tuple[Array, Array, float]:
    """The middle of two bounds: x, y (P,) [m], halfway between places at the same part of their lengths; its width."""
    ways = [np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(one, axis=0).T)))) for one in (left, right)]
    count = max(len(left), len(right), int(max(way[-1] for way in ways) / _STEP_M) + 1)
    part = np.linspace(0.0, 1.0, count)
    points = [
        np.stack([np.interp(part * way[-1], way, axis) for axis in one.T])
        for one, way in zip((left, right), ways, strict=True)
    ]
    x, y = 0.5 * (points[0] + points[1])
    return x, y, float(np.clip(np.hypot(*(points[0] - points[1])).mean(), *_WIDTHS_M))


def _limit(file: _Map, lanelet: _Relation) -> float:
    """Speed limit [m/s] of a lanelet; infinite where the map does not say it."""
    rules = (file.rules[name].tags for name in lanelet.members.get("regulatory_element", ()) if name in file.rules)
    texts = [tags.get("sign_type", "") for tags in rules if tags.get("subtype") == "speed_limit"]
    found = [match for text in (*texts, lanelet.tags.get("speed_limit", "")) if (match := _SPEED.fullmatch(text))]
    return min((float(one[1]) * _UNITS[one[2] or "km/h"] for one in found if float(one[1]) > 0.0), default=np.inf)


def _stop(file: _Map, rule: _Relation, lane: Lanelet) -> float:
    """Place [m] on a lanelet of the nearest stop line of a rule: without one, the end of the lanelet."""
    middles = [file.places(file.way[way]).mean(axis=0) for way in rule.members.get("ref_line", ()) if way in file.way]
    if not middles:
        return lane.length_m
    s, d = lane.line.project(*np.array(middles).T)
    return float(np.clip(s[np.argmin(np.abs(d))], 0.0, lane.length_m))


def _right_of_way(file: _Map, network: Network) -> tuple[dict[str, set[str]], dict[str, float]]:
    """For lanes by name: the lanes that drivers let pass, and the place [m] where they wait."""
    numbers = {lane.name: k for k, lane in enumerate(network.lanes)}
    first: dict[str, set[str]] = {}
    stop_m: dict[str, float] = {}
    for rule in (one for one in file.rules.values() if one.tags.get("subtype") == "right_of_way"):
        yields, passes = (
            [numbers[name] for name in rule.members.get(role, ()) if name in numbers]
            for role in ("yield", "right_of_way")
        )
        others = {network.lanes[other].name for k in passes for other in network.arm(k)}
        for k in yields:
            place = _stop(file, rule, network.lanes[k])
            for own, way_m in network.arm(k).items():
                name = network.lanes[own].name
                first.setdefault(name, set()).update(others)
                stop_m[name] = place - way_m
    return first, stop_m


def _signals(file: _Map, network: Network) -> Iterator[Signal]:
    """The traffic lights, one for each lanelet; maps do not say when they are red."""
    for lane in network.lanes:
        names = file.lanelets[lane.name].members.get("regulatory_element", ())
        lights = [file.rules[name] for name in names if name in file.rules]
        for rule in [one for one in lights if one.tags.get("subtype") == "traffic_light"][:1]:
            yield Signal(lane.name, _stop(file, rule, lane), np.zeros(0), np.zeros(0, dtype=bool))
