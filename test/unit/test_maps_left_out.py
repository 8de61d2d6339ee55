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
