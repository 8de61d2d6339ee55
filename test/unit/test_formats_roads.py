"""Roads out of files: CSV, Lanelet2 and CommonRoad."""

from pathlib import Path

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.lanelet2 import projected
from sugiyama_ros.formats.road_csv import write_road
from sugiyama_ros.roads.examples import crossing, merge, roundabout
from sugiyama_ros.roads.network import Conflict, Network


def conflict(network: Network, lane: str, other: str) -> Conflict:
    (found,) = (one for one in network.conflicts if (one.lane, one.other) == (lane, other))
    return found


@pytest.mark.parametrize("network", [roundabout(), crossing(), crossing(cycle_s=60.0), merge()])
def test_a_road_comes_back_from_csv(tmp_path: Path, network: Network) -> None:
    write_road(network, tmp_path / "road.csv")
    back = sg.read_road(tmp_path / "road.csv")
    assert [(one.name, one.successors, one.speed_limit) for one in back.lanes] == [
        (one.name, one.successors, one.speed_limit) for one in network.lanes
    ]
    assert {(one.lane, one.other, one.enter_m, one.yields) for one in back.conflicts} == {
        (one.lane, one.other, one.enter_m, one.yields) for one in network.conflicts
    }
    time = np.linspace(0.0, 120.0, 50)
    for one, other in zip(back.signals, network.signals, strict=True):
        assert one.lane == other.lane
        np.testing.assert_array_equal(one.red_at(time), other.red_at(time))


def test_a_road_in_csv_says_who_yields_where(tmp_path: Path) -> None:
    path = tmp_path / "road.csv"
    path.write_text(
        "lane,x_m,y_m,priority,stop_m,signal,speed_limit\n"
        "a,-30,0,1,,,13.9\na,30,0,,,,\n"
        "b,0,-30,,20,0:red 30.5:green /60,\nb,0,30,,,,\n"
    )
    road = sg.read_road(path)
    one = conflict(road, "b", "a")
    assert (one.yields, one.stop_m, one.enter_m, one.leave_m) == (True, 20.0, 27.5, 32.5)
    assert not conflict(road, "a", "b").yields
    assert road.lanes[0].speed_limit == 13.9
    (signal,) = road.signals
    assert (signal.stop_m, signal.red_at(np.array([30.0, 31.0, 61.0])).tolist()) == (60.0, [True, False, True])


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("lane,x_m\na,1\n", "road.csv:1: no column y_m"),
        ("lane,x_m,y_m,z_m\na,1,1,1\n", "road.csv:1: unknown column 'z_m'"),
        ("lane,x_m,y_m\na,1,far\n", "road.csv:2: y_m 'far' is not a finite number"),
        ("lane,x_m,y_m\na,1,1\n", "road.csv: lane a: centre line: 1 points"),
        ("lane,x_m,y_m\na b,1,1\n", "road.csv:2: 'a b' is not the name of a lane"),
        ("lane,x_m,y_m,successors\na,1,1,b\na,2,1,\n", "road.csv: lane a: successors: no lane b"),
        ("lane,x_m,y_m,yields_to\na,1,1,b\na,2,1,\n", "road.csv:2: yields_to: no lane b"),
        ("lane,x_m,y_m,priority\na,1,1,1\na,2,1,2\n", "road.csv:3: priority of lane a is '1' above"),
        ("lane,x_m,y_m,signal\na,1,1,red\na,2,1,\n", "road.csv:2: signal 'red' is no list of times and colours"),
        ("lane,x_m,y_m\n", "road.csv: road: no lanes"),
        ("<net></net>", "road.csv: no lanes for cars; give a network of SUMO"),
        ("<kml></kml>", "road.csv: not a road of Lanelet2, CommonRoad or SUMO"),
        ("<osm></osm>", "road.csv: no lanelets for cars"),
        ("<commonRoad></commonRoad>", "road.csv: no lanelets"),
    ],
)
def test_roads_that_cannot_be_read_say_why(tmp_path: Path, text: str, error: str) -> None:
    (tmp_path / "road.csv").write_text(text)
    with pytest.raises(InputError, match=error):
        sg.read_road(tmp_path / "road.csv")


def osm(nodes: dict[int, tuple[float, float]], ways: dict[int, list[int]], *relations: str, local: bool = True) -> str:
    """A map of Lanelet2; places are local [m], or latitudes and longitudes [degrees]."""
    text = []
    for name, (first, second) in nodes.items():
        tags = f'<tag k="local_x" v="{first}"/><tag k="local_y" v="{second}"/>' if local else ""
        degrees = (0.0, 0.0) if local else (first, second)
        text.append(f'<node id="{name}" lat="{degrees[0]}" lon="{degrees[1]}">{tags}</node>')
    for name, refs in ways.items():
        text.append(f'<way id="{name}">{"".join(f"""<nd ref="{ref}"/>""" for ref in refs)}</way>')
    return f'<?xml version="1.0"?><osm>{"".join(text)}{"".join(relations)}</osm>'


def relation(name: int, members: list[tuple[str, int]], **tags: str) -> str:
    inside = "".join(f'<member type="x" ref="{ref}" role="{role}"/>' for role, ref in members)
    return f'<relation id="{name}">{inside}{"".join(f"""<tag k="{k}" v="{v}"/>""" for k, v in tags.items())}</relation>'


def lanelet(name: int, left: int, right: int, *more: tuple[str, int], **tags: str) -> str:
    return relation(name, [("left", left), ("right", right), *more], type="lanelet", **{"subtype": "road", **tags})


def test_a_map_of_lanelet2_is_read(tmp_path: Path) -> None:
    # a road to the east of two lanelets, one beside the second, and a road to the north that yields behind a stop line
    nodes = {1: (0, 2), 2: (30, 2), 3: (60, 2), 4: (0, -2), 5: (30, -2), 6: (60, -2), 7: (30, 6), 8: (60, 6)}
    nodes |= {11: (38, -30), 12: (38, 30), 13: (42, -30), 14: (42, 30), 21: (38, -5), 22: (42, -5)}
    # the right bound of the first lanelet, and both of the crossing road, run against the direction of driving
    ways = {1: [1, 2], 2: [5, 4], 3: [2, 3], 4: [5, 6], 5: [7, 8], 11: [12, 11], 12: [14, 13], 20: [21, 22]}
    path = tmp_path / "map.osm"
    path.write_text(
        osm(
            nodes,
            ways,
            lanelet(100, 1, 2, speed_limit="36"),
            lanelet(101, 3, 4),
            lanelet(102, 5, 3),
            lanelet(103, 11, 12, ("regulatory_element", 200), ("regulatory_element", 201)),
            lanelet(104, 1, 2, subtype="crosswalk"),
            relation(
                200,
                [("right_of_way", 101), ("yield", 103), ("ref_line", 20)],
                type="regulatory_element",
                subtype="right_of_way",
            ),
            relation(201, [("refers", 9)], type="regulatory_element", subtype="traffic_light"),
        )
    )
    road = sg.read_road(path)
    first, second, beside, north = road.lanes
    assert [one.name for one in road.lanes] == ["100", "101", "102", "103"]
    assert (first.successors, first.speed_limit, first.width_m) == (("101",), 10.0, 4.0)
    assert (second.left, beside.right, second.right) == ("102", "101", "")
    np.testing.assert_allclose(first.line.at(np.array([10.0]), np.zeros(1)), [[10.0], [0.0]])
    np.testing.assert_allclose(north.line.heading(np.zeros(1)), 0.5 * np.pi)
    one = conflict(road, "103", "101")
    assert (one.yields, one.stop_m, one.enter_m) == (True, 25.0, 27.5)
    assert not conflict(road, "101", "103").yields
    # the rule does not name the lane beside
    assert not conflict(road, "103", "102").yields
    (signal,) = road.signals
    assert (signal.lane, signal.stop_m, len(signal.red)) == ("103", 60.0, 0)
    assert not signal.red_at(np.array([0.0]))[0]


def test_latitudes_and_longitudes_become_metres() -> None:
    # the meridian arc to 45 degrees is 4,984,944.378 m, and zone 31 begins 166,021.443 m from its false origin
    np.testing.assert_allclose(projected(np.array([[45.0, 9.0]])), [[500_000.0, 0.9996 * 4_984_944.378]], atol=2e-3)
    zone = projected(np.array([[0.0, 0.0], [45.0, 3.0], [45.0, 3.0]]))
    np.testing.assert_allclose(zone[:2], [[166_021.443, 0.0], [500_000.0, 0.9996 * 4_984_944.378]], atol=2e-3)
    small = projected(np.array([[0.0, 0.0], [0.0, 1e-3], [1e-3, 0.0]]))
    np.testing.assert_allclose(small, [[0.0, 0.0], [111.41, 0.0], [0.0, 110.68]], atol=0.02)
    south = projected(np.array([[-45.0, 9.0]]))
    np.testing.assert_allclose(south, [[500_000.0, 1e7 - 0.9996 * 4_984_944.378]], atol=2e-3)


def test_damaged_maps_of_lanelet2_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "map.osm"
    nodes = {1: (0.0, 0.0), 2: (0.0, 1e-4), 3: (-3e-5, 0.0), 4: (-3e-5, 1e-4)}
    good = osm(nodes, {1: [1, 2], 2: [3, 4]}, lanelet(9, 1, 2), local=False)
    path.write_text(good)
    assert sg.read_road(path).lanes[0].length_m == pytest.approx(11.13, abs=0.02)
    for old, new, error in (
        ('lat="-3e-05"', 'lat="south"', "map.osm: node 3: lat 'south' is not a finite number"),
        ('role="right"', 'role="rite"', "map.osm: lanelet 9: not one left and one right bound"),
        ('<nd ref="4"/>', '<nd ref="5"/>', "map.osm: no node 5, or no place of it"),
        ("</osm>", "", "map.osm:1: not XML"),
    ):
        path.write_text(good.replace(old, new))
        with pytest.raises(InputError, match=error):
            sg.read_road(path)


def bounds(*middle: tuple[float, float]) -> str:
    x, y = np.array(middle, dtype=float).T
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    sides = ((1.5, "left"), (-1.5, "right"))
    return "".join(
        f"<{name}Bound>"
        + "".join(
            f"<point><x>{px}</x><y>{py}</y></point>"
            for px, py in zip(x - d * np.sin(heading), y + d * np.cos(heading), strict=True)
        )
        + f"</{name}Bound>"
        for d, name in sides
    )


def scenario(sign: str, light: str) -> str:
    """A crossing of a road to the east and one to the north, straight ahead or to the left; signs are of the south."""
    turn = [(45.0 + 8.0 * (np.cos(a) - 1.0) + 5.0, -5.0 + 8.0 * np.sin(a)) for a in np.linspace(0.0, 0.5 * np.pi, 9)]
    lanelets = (
        ("1", [(0, 0), (45, 0)], '<successor ref="2"/>'),
        ("2", [(45, 0), (55, 0)], '<successor ref="3"/>'),
        ("3", [(55, 0), (90, 0)], ""),
        ("4", [(50, -50), (50, -5)], f'<successor ref="5"/><successor ref="7"/><stopLine/>{sign}{light}'),
        ("5", [(50, -5), (50, 5)], '<successor ref="6"/>'),
        ("6", [(50, 5), (50, 50)], ""),
        ("7", turn, ""),
        ("8", [(46.8, 50), (46.8, 5)], '<successor ref="9"/>'),
        ("9", [(46.8, 5), (46.8, -5)], ""),
    )
    text = "".join(f'<lanelet id="{name}">{bounds(*points)}{more}</lanelet>' for name, points, more in lanelets)
    return (
        f'<?xml version="1.0"?><commonRoad timeStepSize="0.1">{text}'
        '<trafficSign id="20"><trafficSignElement><trafficSignID>205</trafficSignID></trafficSignElement></trafficSign>'
        '<trafficSign id="21"><trafficSignElement><trafficSignID>274</trafficSignID>'
        "<additionalValue>8.5</additionalValue></trafficSignElement></trafficSign>"
        '<trafficLight id="30"><cycle><cycleElement><duration>300</duration><color>red</color></cycleElement>'
        "<cycleElement><duration>200</duration><color>green</color></cycleElement><timeOffset>100</timeOffset></cycle>"
        "<direction>left</direction></trafficLight>"
        '<intersection id="40"><incoming id="41"><incomingLanelet ref="1"/><successorsStraight ref="2"/></incoming>'
        '<incoming id="42"><incomingLanelet ref="4"/><successorsStraight ref="5"/><successorsLeft ref="7"/></incoming>'
        '<incoming id="43"><incomingLanelet ref="8"/><successorsStraight ref="9"/></incoming></intersection>'
        "</commonRoad>"
    )


def test_a_road_of_commonroad_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text(scenario("", ""))
    road = sg.read_road(path)
    # without signs, who comes from the right goes first; who turns left yields to who comes towards them
    assert [conflict(road, *pair).yields for pair in (("2", "5"), ("5", "2"))] == [True, False]
    assert [conflict(road, *pair).yields for pair in (("7", "9"), ("9", "7"))] == [True, False]
    assert [conflict(road, *pair).yields for pair in (("2", "9"), ("9", "2"))] == [False, True]
    path.write_text(scenario('<trafficSignRef ref="20"/><trafficSignRef ref="21"/>', ""))
    road = sg.read_road(path)
    assert [conflict(road, *pair).yields for pair in (("2", "5"), ("5", "2"))] == [False, True]
    # the stop line is at the end of the lanelet before the crossing
    assert conflict(road, "5", "2").stop_m == 0.0
    assert [one.speed_limit for one in road.lanes[2:5]] == [np.inf, 8.5, np.inf]
    path.write_text(scenario("", '<trafficLightRef ref="30"/>'))
    road = sg.read_road(path)
    assert not any(conflict(road, *pair).yields for pair in (("2", "5"), ("5", "2")))
    (signal,) = road.signals
    assert (signal.lane, signal.stop_m, signal.cycle_s) == ("7", 0.0, 50.0)
    # red for 30 s from 10 s on, and green before
    assert signal.red_at(np.array([5.0, 15.0, 39.0, 41.0, 61.0])).tolist() == [False, True, True, False, True]


def sumo_net(light: str = "", kind: str = "static") -> str:
    """Two roads of two lanes and one lane that cross; the one to the north yields. ``light``: states of a light."""
    shapes = {
        "east_0": "-50,0 -5,0", "east_1": "-50,3.2 -5,3.2", ":c_0_0": "-5,0 5,0", "out_0": "5,0 50,0",
        "north_0": "0,-50 0,-5", ":c_1_0": "0,-5 0,5", "up_0": "0,5 0,50", "walk_0": "-5,-5 5,-5",
    }  # fmt: skip
    edges: dict[str, list[str]] = {}
    for name, shape in shapes.items():
        forbidden = 'allow="pedestrian"' if name == "walk_0" else ""
        lane = f'<lane id="{name}" index="{name[-1]}" speed="13.9" length="45" shape="{shape}" {forbidden}/>'
        edges.setdefault(name[:-2], []).append(lane)
    links = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0" via="{via}" {said} dir="s" state="m"/>'
        for a, b, via, said in (
            ("east", "out", ":c_0_0", 'tl="c" linkIndex="0"' * bool(light)),
            ("north", "up", ":c_1_0", 'tl="c" linkIndex="1"' * bool(light)),
        )
    )
    inside = "".join(
        f'<connection from="{a}" to="{b}" fromLane="0" toLane="0"/>' for a, b in ((":c_0", "out"), (":c_1", "up"))
    )
    phases = "".join(f'<phase duration="{20 + 10 * k}" state="{state}"/>' for k, state in enumerate(light.split()))
    program = f'<tlLogic id="c" type="{kind}" programID="0" offset="5">{phases}</tlLogic>' * bool(light)
    return (
        "<net>"
        + "".join(f'<edge id="{name}" from="a" to="b">{"".join(lanes)}</edge>' for name, lanes in edges.items())
        + program
        + '<junction id="c" type="priority" incLanes="east_0 east_1 north_0" intLanes=":c_0_0 :c_1_0">'
        '<request index="0" response="00" foes="10" cont="0"/><request index="1" response="01" foes="01" cont="0"/>'
        "</junction>" + links + inside + "</net>"
    )


def test_a_network_of_sumo_is_read(tmp_path: Path) -> None:
    path = tmp_path / "road.net.xml"
    path.write_text(sumo_net())
    road = sg.read_road(path)
    lanes = {one.name: one for one in road.lanes}
    assert "walk_0" not in lanes
    assert (lanes["east_0"].successors, lanes[":c_0_0"].successors) == ((":c_0_0",), ("out_0",))
    assert (lanes["east_0"].left, lanes["east_1"].right, lanes["east_0"].right) == ("east_1", "east_0", "")
    one = conflict(road, ":c_1_0", ":c_0_0")
    assert (one.yields, one.stop_m, one.enter_m) == (True, 0.0, 2.5)
    assert not conflict(road, ":c_0_0", ":c_1_0").yields
    # who never has green together with others lets nobody pass
    path.write_text(sumo_net("Gr ry rG"))
    road = sg.read_road(path)
    assert not any(one.yields for one in road.conflicts)
    north = next(one for one in road.signals if one.lane == ":c_1_0")
    time = np.array([0.0, 6.0, 54.0, 56.0, 94.0, 96.0])
    assert north.red_at(time).tolist() == [False, True, True, False, False, True]
    path.write_text(sumo_net("Gg"))
    assert conflict(sg.read_road(path), ":c_1_0", ":c_0_0").yields
    path.write_text(sumo_net("Gr rG", kind="actuated"))
    assert [len(one.red) for one in sg.read_road(path).signals] == [0, 0]
    path.write_text(sumo_net().replace('speed="13.9"', 'speed="fast"', 1))
    with pytest.raises(InputError, match="lane east_0: speed 'fast' is not a finite number"):
        sg.read_road(path)
