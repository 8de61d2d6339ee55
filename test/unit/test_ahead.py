"""Who is ahead on a road in the plane: the vehicle on the own way, nobody where that is seen, or somebody unknown."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.roads.network import Lanelet, Network
from sugiyama_ros.roads.view import OnNetwork, hidden, nobody_beside
from sugiyama_ros.trajectories.leaders import gaps
from sugiyama_ros.trajectories.tracks import Tracks

from .test_formats_commonroad import scenario, state

#: Recordings with their roads and the right answers, where they are at hand.
CASES = Path(__file__).parents[2].parent / "shared/cases"


class Drive(NamedTuple):
    """A vehicle at an even speed [m/s], from place to place [m], beside the middle of the road, and its size [m]."""

    name: str
    begin_s: float
    from_m: float
    to_m: float
    speed: float
    aside_m: float = 0.0
    length: str = "4.5"
    width: float = 1.8
    kind: str = "car"


def straight(*cuts: float, width_m: float = 3.5, holes: Sequence[int] = ()) -> Network:
    """A straight road of lanelets that end at places [m], some of them left out."""
    kept = [k for k in range(len(cuts) - 1) if k not in holes]
    return Network(
        tuple(
            Lanelet(
                f"p{k}",
                np.array([cuts[k], cuts[k + 1]]),
                np.zeros(2),
                (f"p{k + 1}",) if k + 1 in kept else (),
                width_m=width_m,
            )
            for k in kept
        )
    )


def recorded(
    folder: Path,
    network: Network,
    *drives: Drive,
    period_s: float = 0.2,
    unseen: Callable[[str, float], bool] = lambda name, x: False,
) -> Tracks:
    """Read what a camera sees of drives along a straight road; it does not see some vehicles at some places."""
    lines = ["case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"]
    for one in drives:
        steps = int((one.to_m - one.from_m) / (one.speed * period_s)) if one.speed else int(one.to_m / period_s)
        for k in range(steps + 1):
            t, x = one.begin_s + k * period_s, one.from_m + one.speed * k * period_s
            if not unseen(one.name, x):
                place = f"{x:.3f},{one.aside_m},{one.speed},0,0.0"
                lines.append(
                    f"1,{one.name},{k},{1000 * t:.0f},{one.kind},{place},{one.length},{one.width if one.width else ''}"
                )
    path = folder / "vehicle_tracks_000.csv"
    path.write_text("\n".join(lines) + "\n")
    return sg.read(path, road=network)


def ahead(tracks: Tracks, name: str) -> list[str | None]:
    """Who is ahead of a vehicle, each once, in the order of time."""
    rows = tracks.vehicle.values() == name
    return list(dict.fromkeys(tracks.leader.values()[rows].tolist()))


def test_a_road_is_free_where_it_was_seen_before_and_is_seen_later(tmp_path: Path) -> None:
    drives = [Drive(str(k), 80.0 * k, 0.0, 1000.0, 15.0) for k in range(3)]
    tracks = recorded(tmp_path, straight(0.0, 300.0, 1000.0), *drives)
    # nobody came before the first one, and nobody sees what is beyond the end
    assert ahead(tracks, "0") == [None]
    for name in "12":
        assert ahead(tracks, name) == ["free", None]
        free = tracks.s_m[(tracks.vehicle.values() == name) & (tracks.leader.values() == "free")]
        assert free.min() == 0.0
        assert 760.0 < free.max() <= 780.0


@pytest.mark.parametrize("end_m", [150.0, 400.0])
def test_whose_leader_has_left_the_view_has_an_unknown_leader(tmp_path: Path, end_m: float) -> None:
    drives = [Drive(str(k), 3.0 * k, 0.0, end_m, 12.0) for k in range(6)]
    tracks = recorded(tmp_path, straight(0.0, 90.0, 1000.0), *drives)
    for k in range(1, 6):
        assert ahead(tracks, str(k)) == [str(k - 1), None]


def test_who_is_not_seen_for_a_while_is_still_there(tmp_path: Path) -> None:
    drives = [Drive(str(k), 3.0 * k, 0.0, 600.0, 12.0) for k in range(3)]
    tracks = recorded(tmp_path, straight(0.0, 700.0), *drives, unseen=lambda name, x: name == "1" and 200.0 < x < 260.0)
    rows = tracks.vehicle.values() == "2"
    hole = rows & (tracks.leader.values() != "1") & (tracks.s_m < 500.0)
    assert tracks.leader.values()[hole].tolist() == [None] * int(hole.sum())
    assert hole.sum() in (24, 25)


def test_behind_who_is_seen_no_more_the_leader_is_unknown_until_somebody_new_comes_between(tmp_path: Path) -> None:
    road = straight(0.0, 900.0)
    lost = Drive("2", 0.0, 60.0, 160.0, 10.0)
    drives = (Drive("1", 0.0, 300.0, 900.0, 20.0), lost, Drive("3", 0.0, 30.0, 600.0, 10.0))
    assert ahead(recorded(tmp_path, road, *drives), "3") == ["2", None]
    newcomer = Drive("4", 20.0, 300.0, 900.0, 10.0)
    assert ahead(recorded(tmp_path, road, *drives, newcomer), "3") == ["2", None, "4"]


@pytest.mark.parametrize(("off_s", "is_there"), [(0.4, True), (3.0, False)])
def test_who_is_off_all_lanes_for_a_moment_is_still_there(off_s: float, is_there: bool) -> None:
    time = np.tile(np.arange(0.0, 6.0, 0.2), 2)
    vehicle = np.repeat([0, 1], len(time) // 2)
    off = (vehicle == 0) & (time > 1.1) & (time < 1.1 + off_s)
    place, size = 10.0 * time + 30.0 * (1 - vehicle), np.full(len(time), 4.5)
    on = OnNetwork(vehicle, np.where(off, -1, 0), time, place, size, np.zeros_like(vehicle), nobody_beside(len(time)))
    found = hidden(on)
    assert found is not None
    assert len(found.row) == is_there * off.sum()
    assert found.place == pytest.approx(place[off] if is_there else [])


@pytest.mark.parametrize("period_s", [0.2, 1.0])
def test_towards_a_hole_in_the_map_the_leader_is_unknown(tmp_path: Path, period_s: float) -> None:
    drives = [Drive(str(k), 2.0 * k, 0.0, 500.0, 10.0) for k in range(4)]
    network = straight(0.0, 200.0, 260.0, 600.0, holes=[1])
    tracks = recorded(tmp_path, network, *drives, period_s=period_s)
    assert "free" not in tracks.leader.used()
    for k in (1, 2, 3):
        assert set(ahead(tracks, str(k))) == {str(k - 1), None}


def test_short_lanelets_are_one_road_at_a_low_rate(tmp_path: Path) -> None:
    drives = [Drive(str(k), 3.0 * k, 0.0, 380.0, 14.0) for k in range(3)]
    tracks = recorded(tmp_path, straight(*np.arange(0.0, 401.0, 4.0).tolist()), *drives, period_s=1.0)
    assert not [note for note in tracks.about.notes if "routes begin" in note]
    assert tracks.road is not None
    assert ahead(tracks, "1") == ["0", None]
    np.testing.assert_allclose(np.diff(tracks.s_m[tracks.vehicle.values() == "2"]), 14.0, atol=0.01)


@pytest.mark.parametrize(("after", "leader"), [(("left",), "0"), (("left", "right"), None)])
def test_the_road_goes_on_while_there_is_no_fork(tmp_path: Path, after: tuple[str, ...], leader: str | None) -> None:
    bend = np.linspace(0.0, 60.0, 13)
    lanes = [Lanelet("in", np.array([-100.0, 0.0]), np.zeros(2), after)]
    lanes += [Lanelet("left", np.array([0.0, 200.0]), np.zeros(2))]
    lanes += [Lanelet("right", bend, -(bend**2) / 120.0)]
    # the follower is never seen beyond the first lane
    drives = Drive("0", 0.0, -20.0, 100.0, 10.0), Drive("1", 0.0, -95.0, -1.0, 10.0)
    tracks = recorded(tmp_path, Network(tuple(lanes)), *drives)
    rows = (tracks.vehicle.values() == "1") & (tracks.time_s > 4.0) & (tracks.time_s < 9.0)
    assert set(tracks.leader.values()[rows].tolist()) == {leader}


def test_who_has_come_in_with_the_front_is_ahead(tmp_path: Path) -> None:
    side = np.array([-80.0, 0.0])
    lanes = [
        Lanelet("main", np.array([-100.0, 0.0]), np.zeros(2), ("on",)),
        Lanelet("side", side, -side * 0.6, ("on",)),
    ]
    network = Network((*lanes, Lanelet("on", np.array([0.0, 200.0]), np.zeros(2))))
    path = tmp_path / "vehicle_tracks_000.csv"
    text = ["track_id,timestamp_ms,agent_type,x,y,psi_rad,length,width"]
    for k in range(100):
        along = -50.0 + k
        place = (along, 0.0, 0.0) if along > 0.0 else (along / 1.166, -0.6 * along / 1.166, -0.54)
        text += [f"m,{100 * k},car,{','.join(f'{one:.3f}' for one in place)},4.5,1.8"]
        text += [f"f,{100 * k},car,{-90.0 + k:.3f},0,0,4.5,1.8"]
    path.write_text("\n".join(text) + "\n")
    tracks = sg.read(path, road=network)
    led = tracks.leader.values()[tracks.vehicle.values() == "f"]
    # the front comes in 2.25 m before the centre
    assert led[:47].tolist() == [None] * 47
    assert led[49:].tolist() == ["m"] * 51


def test_who_has_just_changed_lanes_may_still_be_in_the_way(tmp_path: Path) -> None:
    lane = np.array([0.0, 400.0])
    lanes = Lanelet("r", lane, np.zeros(2), left="l"), Lanelet("l", lane, np.full(2, 3.5), right="r")
    path = tmp_path / "vehicle_tracks_000.csv"
    text = ["track_id,timestamp_ms,agent_type,x,y,psi_rad,length,width"]
    for k in range(100):
        for name, place in (("b", 100.0), ("a", 60.0), ("f", 10.0)):
            side = 3.5 if name == "a" and k >= 50 else 0.0
            text += [f"{name},{100 * k},car,{place + k},{side},0,4.5,1.8"]
    path.write_text("\n".join(text) + "\n")
    tracks = sg.read(path, road=Network(lanes))
    assert ahead(tracks, "f") == ["a", None, "b"]
    led = tracks.leader.values()[tracks.vehicle.values() == "f"].tolist()
    # for the way of its length, 4.5 m at 1 m a sample
    assert (led.count("a"), led.count(None), led.count("b")) == (50, 5, 45)


BESIDE = {
    "bus on a lane that is not in the map": Drive("b", 0.0, 40.0, 400.0, 8.0, 3.1, "12.0", 2.5, "bus"),
    "parked at the kerb": Drive("b", 0.0, 150.0, 60.0, 0.0, -2.7),
    "parked, half on the lane": Drive("b", 0.0, 150.0, 60.0, 0.0, -1.9),
    "cyclist at the edge": Drive("b", 0.0, 40.0, 400.0, 5.0, -1.4, "1.8", 0.7, "bicycle"),
    "cyclist without a size": Drive("b", 0.0, 40.0, 400.0, 5.0, -1.4, "", 0.0, "pedestrian/bicycle"),
}


@pytest.mark.parametrize("beside", BESIDE.values(), ids=BESIDE)
def test_beside_is_not_ahead(tmp_path: Path, beside: Drive) -> None:
    drives = [Drive(str(k), 2.0 * k, 0.0, 400.0, 14.0) for k in range(4)]
    tracks = recorded(tmp_path, straight(0.0, 200.0, 500.0), *drives, beside)
    for k in (1, 2, 3):
        assert ahead(tracks, str(k))[0] == str(k - 1)
        assert "b" not in ahead(tracks, str(k))
        # nobody knows how a driver takes who is beside the way
        assert "free" not in ahead(tracks, str(k))
    assert not set(ahead(tracks, "b")) & set("0123") if "b" in tracks.vehicle.used() else True


def test_who_drives_behind_a_cyclist_in_the_middle_follows_them(tmp_path: Path) -> None:
    drives = [Drive("b", 0.0, 40.0, 200.0, 5.0, -0.4, "1.8", 0.7, "bicycle"), Drive("1", 3.0, 0.0, 150.0, 5.0, 0.3)]
    assert ahead(recorded(tmp_path, straight(0.0, 500.0), *drives), "1")[0] == "b"


def test_two_cars_abreast_on_a_wide_lane_follow_their_own_leaders(tmp_path: Path) -> None:
    left = [Drive(f"l{k}", 3.0 * k, 0.0, 300.0, 10.0, 1.3) for k in range(3)]
    right = [Drive(f"r{k}", 3.0 * k + 1.0, 0.0, 300.0, 10.0, -1.3) for k in range(3)]
    tracks = recorded(tmp_path, straight(0.0, 400.0, width_m=6.0), *left, *right)
    assert [ahead(tracks, name)[0] for name in ("l1", "l2", "r1", "r2")] == ["l0", "l1", "r0", "r1"]


@pytest.mark.parametrize("length", ["", "nan", "0"])
def test_a_vehicle_without_a_length_is_there(tmp_path: Path, length: str) -> None:
    drives = [Drive(str(k), 2.0 * k, 0.0, 300.0, 10.0, 0.0, length if k == 1 else "5.0") for k in range(3)]
    tracks = recorded(tmp_path, straight(0.0, 400.0), *drives)
    assert [ahead(tracks, str(k))[0] for k in range(3)] == [None, "0", "1"]
    behind = (tracks.vehicle.values() == "2") & (tracks.leader_row >= 0)
    np.testing.assert_allclose(gaps(tracks)[behind], 20.0 - 0.5 * (4.33 + 5.0), atol=1e-6)


def test_a_scenario_has_cyclists_beside_cars(tmp_path: Path) -> None:
    def obstacle(name: str, kind: str, width: float, x: float, y: float, step: float) -> str:
        states = [state("initialState" if i == 0 else "state", i, x + step * i, y) for i in range(80)]
        size = f"<rectangle><length>{2.0 if width < 1.0 else 4.5}</length><width>{width}</width></rectangle>"
        return (
            f'<dynamicObstacle id="{name}"><type>{kind}</type><shape>{size}</shape>{states[0]}'
            f"<trajectory>{''.join(states[1:])}</trajectory></dynamicObstacle>"
        )

    path = tmp_path / "DEU_Test-1.xml"
    path.write_text(
        scenario(
            obstacle("1", "car", 1.8, 40.0, 0.3, 1.2),
            obstacle("2", "car", 1.8, 10.0, 0.3, 1.2),
            obstacle("3", "bicycle", 0.6, 50.0, -1.4, 0.5),
        )
    )
    tracks = sg.read(path)
    assert [ahead(tracks, name) for name in "123"] == [[None], ["1"], [None]]


def test_who_overtakes_on_the_opposite_edge_goes_on_along_their_own(tmp_path: Path) -> None:
    rows: dict[float, list[str]] = {}
    for k in range(81):
        t = 0.5 * k
        overtakes = 8.0 <= t <= 16.0
        s = {"slow": 100.0 + 4.0 * t, "fast": 10.0 + 12.0 * t, "oncoming": 700.0 - 9.0 * t}
        for name, x in s.items():
            back = name == "oncoming" or (name == "fast" and overtakes)
            speed = {"slow": 4.0, "fast": 12.0, "oncoming": 9.0}[name]
            lane, place = ("west_0", 800.0 - x) if back else ("east_0", x)
            rows.setdefault(t, []).append(f'<vehicle id="{name}" speed="{speed}" pos="{place:.2f}" lane="{lane}"/>')
    text = "".join(f'<timestep time="{t}">{"".join(each)}</timestep>' for t, each in rows.items())
    path = tmp_path / "fcd.xml"
    path.write_text(f"<fcd-export>{text}</fcd-export>")
    tracks = sg.read(path)
    assert not [note for note in tracks.about.notes if "jump" in note]
    assert [ahead(tracks, name) for name in ("slow", "fast", "oncoming")] == [[None, "fast"], ["slow", None], [None]]
    np.testing.assert_allclose(np.diff(tracks.s_m[tracks.vehicle.values() == "fast"]), 6.0, atol=0.02)


#: Handed recordings and roads: vehicles (by the start of their names) that nobody follows, and those who follow whom.
HANDED = [
    ("plane_leader_leaves_view/vehicle_tracks_000.csv", "map.osm", (), {"2": {"1"}, "4": {"3"}}),
    ("plane_leader_leaves_view/queue.csv", "queue.osm", (), {}),
    ("plane_missing_length/vehicle_tracks_000.csv", "map.osm", (), {"2": {"1"}, "3": {"2"}}),
    ("map_with_missing_lanelet/vehicle_tracks_000.csv", "map.osm", (), {"2": {"1"}, "4": {"3"}}),
    ("ind_parked_and_bicycle/00_tracks.csv", "map.osm", ("2", "3"), {"1": {"0"}}),
    ("ind_parked_and_bicycle/parked/00_tracks.csv", "../map.osm", ("2", "3"), {"1": {"0"}}),
    ("ind_parked_and_bicycle/bicycle/00_tracks.csv", "../map.osm", ("2", "3"), {"1": {"0"}}),
    ("sumo_bike_and_bus_lane/bus_fcd.xml", "bus.net.xml", ("b",), {}),
    ("sumo_bike_and_bus_lane/bus_same_speed_fcd.xml", "bus.net.xml", ("b",), {}),
    ("sumo_bike_and_bus_lane/bike_fcd.xml", "bike.net.xml", ("b",), {}),
    ("sumo_opposite_overtaking/fcd.xml", "n.net.xml", (), {"o.0": set()}),
    ("sumo_opposite_overtaking/fcd.xml", "", (), {"o.0": set(), "o.1": {"o.0"}}),
    ("commonroad_bicycle_beside_car/overtaken.xml", "", ("103",), {}),
    ("commonroad_bicycle_beside_car/beside.xml", "", ("103",), {}),
]


@pytest.mark.skipif(not CASES.is_dir(), reason="needs the handed recordings")
@pytest.mark.parametrize(("file", "road", "beside", "leaders"), HANDED, ids=[f"{one[0]} {one[1]}" for one in HANDED])
def test_handed_recordings_have_their_leaders(
    file: str, road: str, beside: tuple[str, ...], leaders: dict[str, set[str]]
) -> None:
    path = CASES / file
    tracks = sg.read(path, road=path.parent / road) if road else sg.read(path)
    led = tracks.leader.used() if road != "n.net.xml" else ()
    assert "free" not in led
    assert not [name for name in led if name.startswith(beside)] if beside else True
    for name, right in leaders.items():
        assert set(ahead(tracks, name)) - {None} == right
