"""Odd parts of maps: they are passed over, repaired or left out, and a note counts them."""

import gzip
from pathlib import Path

import maps
import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.reading import GZIP

CASES = Path(__file__).parents[2].parent / "shared/cases"
handed = pytest.mark.skipif(not CASES.is_dir(), reason="the handed cases are not here")


def net(*edges: str, links: str = "", said: str = "") -> str:
    return f"<net {said}>{''.join(edges)}{links}</net>"


def edge(name: str, *lanes: str, said: str = "") -> str:
    return f'<edge id="{name}" {said}>{"".join(lanes)}</edge>'


def lane(name: str, shape: str, said: str = 'speed="13.9"') -> str:
    return f'<lane id="{name}" {said} shape="{shape}"/>'


def link(before: str, after: str, via: str = "") -> str:
    said = f'via="{via}"' * bool(via)
    return f'<connection from="{before}" to="{after}" fromLane="0" toLane="0" {said}/>'


def test_lanes_without_length_are_passed_over(tmp_path: Path) -> None:
    """Two such lanes inside one junction, one behind the other."""
    path = tmp_path / "a.net.xml"
    path.write_text(
        net(
            edge(":j_0", lane(":j_0_0", "50,0 50,0"), said='function="internal"'),
            edge(":j_1", lane(":j_1_0", "50,0"), said='function="internal"'),
            edge("in", lane("in_0", "0,0 50,0")),
            edge("out", lane("out_0", "50,0 50,0 90,0")),
            links=link("in", "out", ":j_0_0") + link(":j_0", "out", ":j_1_0") + link(":j_1", "out"),
        )
    )
    road = sg.read_road(path)
    assert [(one.name, one.successors) for one in road.lanes] == [("in_0", ("out_0",)), ("out_0", ())]
    assert road.path(["in_0", "out_0"]).length_m == 90.0
    assert road.notes == ()


@pytest.mark.parametrize(("said", "left"), [("", "e_1"), ('lefthand="false"', "e_1"), ('lefthand="true"', "")])
def test_lanes_count_from_the_side_where_vehicles_keep(tmp_path: Path, said: str, left: str) -> None:
    path, y = tmp_path / "a.net.xml", 3.2 if left else -3.2
    path.write_text(net(edge("e", lane("e_0", "0,0 50,0"), lane("e_1", f"0,{y} 50,{y}")), said=said))
    outer, inner = sg.read_road(path).lanes
    assert (outer.left, outer.right) == (left, "" if left else "e_1")
    assert (inner.left, inner.right) == ("" if left else "e_0", "e_0" if left else "")


def test_odd_lanes_of_sumo_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.net.xml"
    path.write_text(
        net(
            edge(
                "e",
                lane("e_0", "0,0 50,0", 'speed="13.9" allow="bicycle"'),
                lane("e_1", "0,3 50,3", 'speed="30 mph"'),
                lane("e_2", "0,6 fifty,6"),
                lane("e_3", "0,9 50,9", 'speed="fast"'),
            )
        )
    )
    road = sg.read_road(path)
    assert [(one.name, one.left, one.right) for one in road.lanes] == [("e_1", "", ""), ("e_3", "", "")]
    assert [one.speed_limit for one in road.lanes] == [pytest.approx(30 * 0.44704), np.inf]
    assert road.notes == (
        "road: 1 lanes cannot be read and were left out; the first: lane e_2: shape 'fifty' is not a finite number;"
        " correct or remove the line",
        "road: 1 speed limits cannot be read and were left out; the first: lane e_3: speed limit 'fast' is no speed",
        "road: lanes that are not for cars were left out: 1 bicycle",
    )


def test_a_network_packed_by_gzip_is_read(tmp_path: Path) -> None:
    plain, packed = tmp_path / "a.net.xml", tmp_path / "a.net.xml.gz"
    plain.write_text(maps.sumo_net())
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert sg.read_road(packed).headline() == sg.read_road(plain).headline()
    packed.write_bytes(packed.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"a\.net\.xml\.gz: damaged: .*; get the file again"):
        sg.read_road(packed)
    packed.write_bytes(GZIP + b"nothing")
    with pytest.raises(InputError, match=r"a\.net\.xml\.gz: damaged"):
        sg.read_road(packed)
    # a small file that unpacks to a large element is refused before it fills the memory
    packed.write_bytes(gzip.compress(b"<net><edge>" + b" " * 60_000_000 + b"</edge></net>"))
    with pytest.raises(InputError, match=r"a\.net\.xml\.gz: an element of more than 50 MB"):
        sg.read_road(packed)


def test_an_empty_road_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.osm").touch()
    with pytest.raises(InputError, match=r"a\.osm: empty file; give a road"):
        sg.read_road(tmp_path / "a.osm")


@handed
def test_the_handed_network_with_a_point_is_read() -> None:
    case = CASES / "sumo_net_point_lane"
    tracks = sg.read(case / "fcd.xml", road=case / "n.net.xml")
    assert tracks.road.used() == ("E1_0 E2_0",)


@handed
def test_lengths_follow_from_gaps_also_on_a_road() -> None:
    case = CASES / "sumo_lengths_lost_with_road"
    tracks = sg.read(case / "fcd.xml", road=case / "n.net.xml")
    assert set(tracks.length_m.tolist()) == {4.5, 12.0}
    led = tracks.leader_row >= 0
    leader = tracks.leader_row[led]
    gap = tracks.s_m[leader] - tracks.s_m[led] - 0.5 * (tracks.length_m[leader] + tracks.length_m[led])
    assert gap[tracks.vehicle_class.values()[leader] == "truck"].mean() == pytest.approx(12.55, abs=0.01)
    assert "road: lanes that are not for cars were left out: 1 bus" in tracks.about.notes


def ladder(*more: str) -> str:
    """Two lanelets of Lanelet2 in a line, from 0 to 40 m and on to 80 m, and more relations."""
    places = {1: (0.0, 2.0), 2: (40.0, 2.0), 3: (80.0, 2.0), 4: (0.0, -2.0), 5: (40.0, -2.0), 6: (80.0, -2.0)}
    ways = {10: [1, 2], 11: [4, 5], 12: [2, 3], 13: [5, 6], 14: [7, 8], 15: [9, 9]}
    return maps.osm(places, ways, maps.lanelet(20, 10, 11), maps.lanelet(21, 12, 13), *more)


def test_odd_parts_of_a_map_of_lanelet2_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "map.osm"
    path.write_text(
        ladder(
            maps.lanelet(22, 14, 11),
            maps.lanelet(23, 10, 99),
            maps.lanelet(24, 12, 13, subtype="crosswalk"),
            maps.lanelet(25, 12, 13, subtype="tram"),
            maps.lanelet(26, 12, 13, subtype="crosswalk"),
        )
    )
    road = sg.read_road(path)
    assert [(one.name, one.successors) for one in road.lanes] == [("20", ("21",)), ("21", ())]
    assert road.notes == (
        "road: 2 lanelets cannot be read and were left out; the first: lanelet 22: no node 7, or no place of it; write"
        " the map as a whole",
        "road: lanes that are not for cars were left out: 2 crosswalk, 1 tram",
    )


def test_a_lanelet_says_itself_that_it_is_for_cars(tmp_path: Path) -> None:
    path = tmp_path / "map.osm"
    tags = {"subtype": "parking_aisle", "participant:vehicle": "yes", "speed_limit": "30 kph"}
    path.write_text(ladder().replace("</osm>", f"{maps.lanelet(30, 12, 13, **tags)}</osm>"))
    road = sg.read_road(path)
    assert [one.name for one in road.lanes] == ["20", "21", "30"]
    assert road.lanes[2].speed_limit == pytest.approx(30.0 / 3.6)


@pytest.mark.parametrize("empty", ['lat="" lon=""', 'lat=" " lon=" "', 'lat="0" lon="0"'])
def test_places_in_a_local_frame_need_no_latitudes(tmp_path: Path, empty: str) -> None:
    """A node that nothing uses has no place at all."""
    path = tmp_path / "map.osm"
    path.write_text(ladder().replace('lat="0.0" lon="0.0"', empty).replace("<osm>", f'<osm><node id="99" {empty}/>'))
    assert [one.length_m for one in sg.read_road(path).lanes] == [40.0, 40.0]


@pytest.mark.parametrize("shift", [(0.0, 0.0), (3000.0, 5_000_000.0), (-40.0, 0.0)])
def test_metres_in_the_place_of_latitudes_are_told(tmp_path: Path, shift: tuple[float, float]) -> None:
    path = tmp_path / "map.osm"
    corners = {1: (0, 2), 2: (40, 2), 4: (0, -2), 5: (40, -2)}
    nodes = {k: (x + shift[0], y + shift[1]) for k, (x, y) in corners.items()}
    path.write_text(maps.osm(nodes, {10: [1, 2], 11: [4, 5]}, maps.lanelet(20, 10, 11), local=False))
    with pytest.raises(InputError, match=r"map\.osm: lat and lon .* are metres, not degrees; write metres"):
        sg.read_road(path)
    # the cure works
    path.write_text(maps.osm(nodes, {10: [1, 2], 11: [4, 5]}, maps.lanelet(20, 10, 11)))
    assert sg.read_road(path).lanes[0].length_m == 40.0


def test_tight_turns_and_loops_have_their_direction(tmp_path: Path) -> None:
    """A turn of two lanelets about a point, of which bounds run either way, and nearly a whole circle."""
    turn = {k: 0.5 * np.pi * (k - 10) / 10 for k in range(10, 21)}
    outer = {k: (40.0 + 4.0 * np.sin(a), -2.0 + 4.0 * np.cos(a)) for k, a in turn.items()}
    nodes = {1: (0.0, 2.0), 2: (40.0, 2.0), 3: (0.0, -2.0), 4: (40.0, -2.0), 5: (40.0, -2.0), 6: (44.0, -50.0)}
    nodes |= {7: (40.0, -50.0), **outer}
    for first, radius in ((100, 30.0), (120, 34.0)):
        nodes |= {first + k: (radius * np.cos(0.3 * k), radius * np.sin(0.3 * k) + 200.0) for k in range(20)}
    ways = {30: [1, 10], 31: [4, 3], 32: [*range(20, 9, -1)], 33: [4, 5], 34: [20, 6], 35: [5, 7]}
    ways |= {36: [*range(119, 99, -1)], 37: [*range(120, 140)]}
    nodes[10] = (40.0, 2.0)
    lanelets = [maps.lanelet(40 + k, 30 + 2 * k, 31 + 2 * k) for k in range(4)]
    path = tmp_path / "map.osm"
    path.write_text(maps.osm(nodes, ways, *lanelets))
    road = sg.read_road(path)
    assert [one.successors for one in road.lanes] == [("41",), ("42",), (), ()]
    # lanelets that follow one another over a short one do not meet
    assert road.conflicts == ()
    loop = road.lanes[3]
    heading = loop.line.heading(np.array([0.0, loop.length_m]))
    # counter-clockwise: the inner circle is to the left
    assert heading[1] - heading[0] == pytest.approx(0.3 * 18, abs=0.1)


@handed
def test_the_handed_maps_of_lanelet2() -> None:
    for name in ("map", "map_no_attributes", "map_zero"):
        case = CASES / "lanelet2_empty_latlon"
        tracks = sg.read(case / "vehicle_tracks_000.csv", road=case / f"{name}.osm")
        assert set(tracks.leader.values()[tracks.vehicle.values() == "2"].tolist()) == {"1"}
    for name in ("far", "near"):
        with pytest.raises(InputError, match="are metres, not degrees"):
            sg.read_road(CASES / f"lanelet2_metres_in_latlon/map_{name}.osm")
    case = CASES / "lanelet2_zero_length_bound"
    assert sg.read_road(case / "map.osm").conflicts == ()
    tracks = sg.read(case / "vehicle_tracks_000.csv", road=case / "map.osm")
    assert tracks.road.used() == ("7 15 20",)
    assert np.isnan(tracks.line_m).all()


def test_odd_parts_of_a_scenario_are_counted(tmp_path: Path) -> None:
    """Bounds of unlike many points are repaired; a lanelet without length is passed over."""
    here, gone = "<point><x>{}</x><y>{}</y></point>", '<lanelet id="99"><leftBound/><rightBound/></lanelet>'
    point = "".join(
        f"<{side}Bound>{here.format(55, y) * 2}</{side}Bound>" for side, y in (("left", 1.5), ("right", -1.5))
    )
    text = maps.scenario('<trafficSignRef ref="21"/>', '<trafficLightRef ref="30"/>')
    first = text.index("<rightBound>")
    text = text[:first] + text[first:].replace("<rightBound>", f"<rightBound>{here.format(0.0, -1.5)}", 1)
    text = text.replace('<successor ref="3"/>', '<successor ref="8a"/>').replace(">8.5<", ">50 km/h<")
    walk = maps.bounds((0.0, 9.0), (9.0, 9.0)) + "<laneletType>sidewalk</laneletType>"
    text = text.replace("<duration>300<", "<duration>long<").replace(
        "</commonRoad>",
        f'<lanelet id="8a">{point}<successor ref="3"/></lanelet>{gone}<lanelet id="10">{walk}</lanelet></commonRoad>',
    )
    path = tmp_path / "a.xml"
    path.write_text(text)
    road = sg.read_road(path)
    lanes = {one.name: one for one in road.lanes}
    assert "8a" not in lanes
    assert (lanes["2"].successors, lanes["1"].length_m) == (("3",), 45.0)
    assert lanes["4"].speed_limit == pytest.approx(50.0 / 3.6)
    assert road.signals == ()
    assert road.notes == (
        "road: 1 traffic lights cannot be read and were left out; the first: traffic light 30: duration 'long' is not a"
        " finite number; correct or remove the line",
        "road: 1 lanelets cannot be read and were left out; the first: lanelet 99: 0 points on the left and 0 on the"
        " right; give two or more of each",
        "road: lanes that are not for cars were left out: 1 sidewalk",
    )


@handed
def test_the_handed_scenarios() -> None:
    for name in (
        "commonroad_goal_lanelet/cr_goal",
        "commonroad_goal_lanelet/cr_plain",
        "commonroad_uncertain_position/cr_rect",
    ):
        tracks = sg.read(CASES / f"{name}.xml")
        assert (tracks.runs, len(tracks)) == (2, 120)
        assert tracks.leader.values()[:60].tolist().count(None) in (0, 60)
