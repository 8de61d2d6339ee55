"""Roads out of files: CSV, Lanelet2 and CommonRoad."""

from pathlib import Path

import maps
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
    assert {(one.lane, one.other, one.stop_m, one.enter_m, one.yields) for one in back.conflicts} == {
        (one.lane, one.other, one.stop_m, one.enter_m, one.yields) for one in network.conflicts
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
        ("<osm></osm>", "road.csv: no lanes for cars; give a map of Lanelet2"),
        ("<commonRoad></commonRoad>", "road.csv: no lanes for cars; give a scenario with a road"),
    ],
)
def test_roads_that_cannot_be_read_say_why(tmp_path: Path, text: str, error: str) -> None:
    (tmp_path / "road.csv").write_text(text)
    with pytest.raises(InputError, match=error):
        sg.read_road(tmp_path / "road.csv")


def test_a_map_of_lanelet2_is_read(tmp_path: Path) -> None:
    path = tmp_path / "map.osm"
    path.write_text(maps.crossing_osm())
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
    good = maps.osm(nodes, {1: [1, 2], 2: [3, 4]}, maps.lanelet(9, 1, 2), local=False)
    path.write_text(good)
    assert sg.read_road(path).lanes[0].length_m == pytest.approx(11.13, abs=0.02)
    for old, new, error in (
        (
            'lat="-3e-05"',
            'lat="south"',
            "map.osm: no lanes for cars; the first cannot be read: node 3: lat 'south' is not a finite number",
        ),
        ('role="right"', 'role="rite"', "map.osm: no lanes for cars; .*: lanelet 9: not one left and one right bound"),
        ('<nd ref="4"/>', '<nd ref="5"/>', "map.osm: no lanes for cars; .*: lanelet 9: no node 5, or no place of it"),
        ("</osm>", "", "map.osm:1: ends early; get the file again, or let"),
    ):
        path.write_text(good.replace(old, new))
        with pytest.raises(InputError, match=error):
            sg.read_road(path)


def test_a_road_of_commonroad_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text(maps.scenario("", ""))
    road = sg.read_road(path)
    # without signs, who comes from the right goes first; who turns left yields to who comes towards them
    assert [conflict(road, *pair).yields for pair in (("2", "5"), ("5", "2"))] == [True, False]
    assert [conflict(road, *pair).yields for pair in (("7", "9"), ("9", "7"))] == [True, False]
    assert [conflict(road, *pair).yields for pair in (("2", "9"), ("9", "2"))] == [False, True]
    path.write_text(maps.scenario('<trafficSignRef ref="20"/><trafficSignRef ref="21"/>', ""))
    road = sg.read_road(path)
    assert [conflict(road, *pair).yields for pair in (("2", "5"), ("5", "2"))] == [False, True]
    # the stop line is at the end of the lanelet before the crossing
    assert conflict(road, "5", "2").stop_m == 0.0
    assert [one.speed_limit for one in road.lanes[2:5]] == [np.inf, 8.5, np.inf]
    path.write_text(maps.scenario("", '<trafficLightRef ref="30"/>'))
    road = sg.read_road(path)
    assert not any(conflict(road, *pair).yields for pair in (("2", "5"), ("5", "2")))
    (signal,) = road.signals
    assert (signal.lane, signal.stop_m, signal.cycle_s) == ("7", 0.0, 50.0)
    # red for 30 s from 10 s on, and green before
    assert signal.red_at(np.array([5.0, 15.0, 39.0, 41.0, 61.0])).tolist() == [False, True, True, False, True]


def test_a_network_of_sumo_is_read(tmp_path: Path) -> None:
    path = tmp_path / "road.net.xml"
    path.write_text(maps.sumo_net())
    road = sg.read_road(path)
    lanes = {one.name: one for one in road.lanes}
    assert "walk_0" not in lanes
    assert (lanes["east_0"].successors, lanes[":c_0_0"].successors) == ((":c_0_0",), ("out_0",))
    assert (lanes["east_0"].left, lanes["east_1"].right, lanes["east_0"].right) == ("east_1", "east_0", "")
    one = conflict(road, ":c_1_0", ":c_0_0")
    assert (one.yields, one.stop_m, one.enter_m) == (True, 0.0, 2.5)
    assert not conflict(road, ":c_0_0", ":c_1_0").yields
    # who never has green together with others lets nobody pass
    path.write_text(maps.sumo_net("Gr ry rG"))
    road = sg.read_road(path)
    assert not any(one.yields for one in road.conflicts)
    north = next(one for one in road.signals if one.lane == ":c_1_0")
    time = np.array([0.0, 6.0, 54.0, 56.0, 94.0, 96.0])
    assert north.red_at(time).tolist() == [False, True, True, False, False, True]
    path.write_text(maps.sumo_net("Gg"))
    assert conflict(sg.read_road(path), ":c_1_0", ":c_0_0").yields
    path.write_text(maps.sumo_net("Gr rG", kind="actuated"))
    assert [len(one.red) for one in sg.read_road(path).signals] == [0, 0]
