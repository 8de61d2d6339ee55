"""Maps of Lanelet2 in the format of OpenStreetMap: nodes, ways, and relations that are lanelets or rules.

F. Poggenhans et al.: Lanelet2: A high-definition map framework for the future of automated driving. IEEE Intelligent
Transportation Systems Conference, 2018, doi 10.1109/ITSC.2018.8569929.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.map_parts import MapLanes, at_parts, middle_of
from sugiyama_ros.formats.reading import elements, number
from sugiyama_ros.roads.conflicts import conflicts_of_geometry
from sugiyama_ros.roads.network import FARTHEST_M, Lanelet, Network, Signal

# Subtypes of lanelets for cars; other lanelets are for cars if they say so themselves.
_FOR_CARS = {"", "road", "highway", "play_street", "exit", "bus_lane"}
_SAYS_CARS = ("participant:vehicle", "participant:vehicle:car")
# Nodes of a map, at most.
_MAX_NODES = 1_000_000
# A map nearer to latitude and longitude 0 than this [degrees] was drawn about that point.
_NEAR_ZERO = 1.0
# Parts of the lengths of two bounds between which their directions are compared, and the difference that counts.
_PARTS: Array = np.linspace(0.0, 1.0, 11, dtype=np.float64)
_CLEARLY = 0.5
# A map of roads that vehicles are recorded on spans less [degrees].
_WIDEST = 2.0


class _Relation(NamedTuple):
    """A relation: its name, its tags, and the numbers of its members by role."""

    name: str
    tags: dict[str, str]
    members: dict[str, list[str]]


@dataclass
class _Map:
    """A map: local places of nodes [m] and their latitudes and longitudes [degrees]; ways, lanelets and rules.

    map: the lanes that they make.
    """

    map: MapLanes
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
    file = _Map(MapLanes(path))
    for element in elements(path, "node", "way", "relation"):
        if element.get("action") == "delete":
            continue
        name = element.get("id", "")
        if element.tag == "node":
            with file.map.unreadable("nodes"):
                _add_node(file, element, f"{path}: node {name[:40]}")
        elif element.tag == "way":
            file.way[name] = [one.get("ref", "") for one in element.iterfind("nd")]
        else:
            relation = _relation(element)
            if relation.tags.get("type") == "lanelet":
                kind = relation.tags.get("subtype", "")
                if kind in _FOR_CARS or "yes" in (relation.tags.get(one) for one in _SAYS_CARS):
                    file.lanelets[name] = relation
                else:
                    file.map.not_for_cars(kind[:40])
            elif relation.tags.get("type") == "regulatory_element":
                file.rules[name] = relation
        if len(file.degrees) + len(file.local) + len(file.way) > _MAX_NODES:
            raise InputError(f"{path}: more than {_MAX_NODES} nodes and ways; cut the map")
    if len(file.degrees) > len(file.local) and len(set(file.degrees.values())) > 1:
        # local places count if all nodes have them
        file.local = dict(zip(file.degrees, _projected(file, path).tolist(), strict=True))
    try:
        return _network(file)
    except InputError as error:
        raise error if str(error).startswith(str(path)) else InputError(f"{path}: {error}") from None


def _projected(file: _Map, path: Path) -> Array:
    """Places (N, 2) [m] of latitudes and longitudes. Raises InputError for numbers that are none."""
    degrees = np.array([*file.degrees.values()])
    low, middle, high = np.quantile(degrees, (0.1, 0.5, 0.9), axis=0)
    if (high - low > _WIDEST).any() or (np.abs(middle) > [90.0, 180.0]).any():
        raise InputError(
            f"{path}: lat and lon of its nodes, such as {middle[0]:.6g}, {middle[1]:.6g}, are metres, not degrees;"
            " write metres as the tags local_x and local_y of each node"
        )
    return projected(degrees)


def _relation(element: Element) -> _Relation:
    members: dict[str, list[str]] = {}
    for one in element.iterfind("member"):
        members.setdefault(one.get("role", ""), []).append(one.get("ref", ""))
    return _Relation(element.get("id", ""), _tags(element), members)


def _tags(element: Element) -> dict[str, str]:
    return {one.get("k", ""): one.get("v", "").strip() for one in element.iterfind("tag")}


def _add_node(file: _Map, element: Element, where: str) -> None:
    name, tags = element.get("id", ""), _tags(element)
    for source, names, places in (
        (tags, ("local_x", "local_y"), file.local),
        (element.attrib, ("x", "y"), file.local),
        (element.attrib, ("lat", "lon"), file.degrees),
    ):
        # a map in a local frame may have empty latitudes
        if source.get(names[0], "").strip() and name not in places:
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
    bounds: dict[str, _Bounds] = {}
    for name, relation in file.lanelets.items():
        with file.map.unreadable("lanelets"):
            bounds[name] = _bounds(file, name, relation)
    begins: dict[tuple[str, str], list[str]] = {}
    for name, one in bounds.items():
        begins.setdefault((one.left[0], one.right[0]), []).append(name)
    by_left, by_right = ({getattr(one, side): name for name, one in bounds.items()} for side in ("left", "right"))
    for name, (left, right) in bounds.items():
        after = tuple(begins.get((left[-1], right[-1]), ()))
        x, y, width = middle_of(file.places(left), file.places(right))
        if len(x) == 1:
            file.map.points[name] = after
            continue
        with file.map.unreadable("lanelets"):
            limit = _limit(file, file.lanelets[name])
            file.map.lanes[name] = Lanelet(
                name, x, y, after, by_right.get(left, ""), by_left.get(right, ""), limit, width
            )
    lanes = file.map.linked("give a map of Lanelet2")
    network = Network(lanes)
    first, stop_m = _right_of_way(file, network)
    conflicts = conflicts_of_geometry(lanes, stop_m=stop_m)
    conflicts = tuple(replace(one, yields=one.other in first.get(one.lane, ())) for one in conflicts)
    return Network(lanes, conflicts, tuple(_signals(file, network)), file.map.notes())


def _bounds(file: _Map, name: str, lanelet: _Relation) -> _Bounds:
    """The bounds of a lanelet: in the direction in which the left one is to the left."""
    ways = [file.way.get(way, []) for side in ("left", "right") for way in lanelet.members.get(side, ())]
    if len(ways) != 2 or min(map(len, ways)) < 2:
        raise InputError(f"lanelet {name}: not one left and one right bound of two nodes or more; correct the map")
    left, right = ways
    try:
        one, other = file.places(left), file.places(right)
    except InputError as error:
        raise InputError(f"lanelet {name}: {error}") from None
    one, other = at_parts(one, _PARTS), at_parts(other, _PARTS)
    steps = np.diff(one, axis=0)
    same, turned = (_alike(steps, np.diff(there, axis=0)) for there in (other, other[::-1]))
    if turned > same + _CLEARLY:
        right, other = right[::-1], other[::-1]
    # forward along the right bound and back along the left one is a way around the lanelet, to the left
    around = np.concatenate((other, one[::-1])) - one[0]
    if float(np.sum(around[:, 0] * np.roll(around[:, 1], -1) - around[:, 1] * np.roll(around[:, 0], -1))) < 0.0:
        # inside a tight turn, a bound is almost a point, and stays as it is
        both, outer_is_left = abs(turned - same) > _CLEARLY, np.ptp(one, axis=0).max() > np.ptp(other, axis=0).max()
        left = left[::-1] if both or outer_is_left else left
        right = right[::-1] if both or not outer_is_left else right
    return _Bounds(tuple(left), tuple(right))


def _alike(steps: Array, others: Array) -> float:
    """Mean cosine of the angles between steps (K, 2) [m] of two lines: 1 side by side, -1 if one is turned round."""
    return float(np.sum(steps * others) / max(np.sum(np.hypot(*steps.T) * np.hypot(*others.T)), 1e-12))


def _limit(file: _Map, lanelet: _Relation) -> float:
    """Speed limit [m/s] of a lanelet; infinite where the map does not say it."""
    rules = (file.rules[name].tags for name in lanelet.members.get("regulatory_element", ()) if name in file.rules)
    texts = [tags.get("sign_type", "") for tags in rules if tags.get("subtype") == "speed_limit"]
    texts = [text for text in (*texts, lanelet.tags.get("speed_limit", "")) if text]
    return min((file.map.speed_limit(text, "km/h", f"lanelet {lanelet.name[:40]}") for text in texts), default=np.inf)


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
