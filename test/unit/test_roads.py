"""Roads as graphs: geometry, conflicts, readers, and the routes of vehicles."""

import time

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.roads.conflicts import CLEARANCE_M, conflicts_of_geometry
from sugiyama_ros.roads.examples import crossing, merge, roundabout
from sugiyama_ros.roads.network import Conflict, Lanelet, Network, Signal
from sugiyama_ros.roads.routes import routes_of


def arc(name: str, begin: float, end: float, radius_m: float = 20.0, **more: object) -> Lanelet:
    angle = np.linspace(begin, end, 60)
    return Lanelet(name, radius_m * np.cos(angle), radius_m * np.sin(angle), **more)  # type: ignore[arg-type]


def test_a_path_around_a_circle_has_its_length_and_curvature() -> None:
    quarter = 0.5 * np.pi
    circle = [arc(str(k), k * quarter, (k + 1) * quarter, successors=(str((k + 1) % 4),)) for k in range(4)]
    path = Network(tuple(circle)).path(["1", "2", "3", "0"])
    s = np.linspace(0.0, path.length_m, 100)
    assert path.length_m == pytest.approx(2.0 * np.pi * 20.0, rel=1e-3)
    np.testing.assert_allclose(path.curvature(s), 1.0 / 20.0, rtol=2e-3)
    x, y, _ = path.at(s)
    np.testing.assert_allclose(np.hypot(x, y), 20.0, atol=0.01)
    back, across = path.project(0.9 * x[1:-1], 0.9 * y[1:-1])
    np.testing.assert_allclose(back, s[1:-1], atol=0.01)
    np.testing.assert_allclose(across, 2.0, atol=0.02)
    assert path.place_of(2) == pytest.approx(path.length_m / 4.0, abs=0.01)
    assert np.isnan(Network(tuple(circle)).path(["1"]).place_of(0))


def test_conflicts_of_a_path_count_along_the_path() -> None:
    lanes = (
        Lanelet("a", np.array([0.0, 10.0]), np.zeros(2), ("b",)),
        Lanelet("b", np.array([10.0, 30.0]), np.zeros(2)),
        Lanelet("c", np.full(2, 20.0), np.array([-10.0, 10.0])),
    )
    signal = Signal("b", 0.0, np.array([0.0, 30.0]), np.array([True, False]), 60.0)
    network = Network(lanes, (Conflict("b", "c", -1.0, 7.5, 12.5, 7.5, 12.5, True),), (signal,))
    found = network.path([0, 1]).conflicts
    assert (found.stop_m[0], found.enter_m[0], found.leave_m[0]) == (9.0, 17.5, 22.5)
    assert found.other.tolist() == [2]
    assert found.yields.tolist() == [True]
    assert network.path([0, 1]).signals == ((10.0, signal),)


def test_a_signal_repeats_after_its_cycle() -> None:
    signal = Signal("a", 0.0, np.array([10.0, 40.0, 50.0]), np.array([True, True, False]), 60.0)
    time = np.array([5.0, 10.0, 45.0, 55.0, 65.0, 75.0])
    assert signal.red_at(time).tolist() == [False, True, True, False, False, True]
    since, until = signal.changes(time)
    assert since.tolist() == [15.0, 0.0, 35.0, 5.0, 15.0, 5.0]
    assert until.tolist() == [5.0, 40.0, 5.0, 15.0, 5.0, 35.0]
    once = Signal("a", 0.0, np.array([0.0, 10.0, 20.0]), np.array([True, True, False]))
    assert once.red_at(np.array([-5.0, 15.0, 99.0])).tolist() == [True, True, False]
    assert once.changes(np.array([5.0, 25.0]))[0].tolist() == [np.inf, 5.0]
    assert once.changes(np.array([5.0, 25.0]))[1].tolist() == [15.0, np.inf]


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: Network(()), "no lanes"),
        (lambda: Network((arc("a", 0.0, 1.0), arc("a", 1.0, 2.0))), "lane a: there are two"),
        (lambda: Network((arc("a", 0.0, 1.0, successors=("b",)),)), "lane a: successors: no lane b"),
        (lambda: Network((arc("a", 0.0, 1.0, left="b"),)), "lane a: left: no lane b"),
        (lambda: Network((arc("a", 0.0, 1.0),), (Conflict("a", "b", 0, 1, 2, 1, 2),)), "no lane b"),
        (lambda: Network((arc("a", 0.0, 1.0),)).path(["a", "a"]), "comes twice"),
        (lambda: Network((arc("a", 0.0, 1.0), arc("b", 1.0, 2.0))).path(["a", "b"]), "b does not follow a"),
        (lambda: arc("a", 0.0, 2.0 * np.pi), "ends where it begins"),
        (lambda: arc("a", 0.0, 1.0, speed_limit=0.0), "speed_limit 0 m/s"),
        (lambda: Conflict("a", "b", 3, 1, 2, 1, 2), "not in the order"),
        (lambda: Signal("a", 0.0, np.array([5.0, 70.0]), np.array([True, False]), 60.0), "within a cycle of 60 s"),
    ],
)
def test_a_road_that_cannot_be_says_why(make: object, error: str) -> None:
    with pytest.raises(InputError, match=error):
        make()  # type: ignore[operator]


def areas(network: Network, lane: str, other: str) -> list[Conflict]:
    return [one for one in network.conflicts if (one.lane, one.other) == (lane, other)]


def test_two_lanes_that_cross_meet_where_they_are_nearer_than_the_clearance() -> None:
    way = np.linspace(-30.0, 30.0, 7)
    slope = np.radians(60.0)
    lanes = (Lanelet("a", way, 0.0 * way), Lanelet("b", way * np.cos(slope), way * np.sin(slope)))
    for name, priority, yields in (("a", {"a": 1.0}, (False, True)), ("b", {"b": 1.0}, (True, False))):
        found = conflicts_of_geometry(lanes, priority)
        # a straight line is nearer than the clearance within clearance / sin(angle) of where the lines cross
        for one in found:
            reach = CLEARANCE_M / np.sin(slope)
            places = (one.enter_m, one.leave_m, one.other_enter_m, one.other_leave_m)
            np.testing.assert_allclose(places, 30.0 + reach * np.array([-1.0, 1.0, -1.0, 1.0]), atol=1e-6)
            assert one.stop_m == one.enter_m
        assert tuple(one.yields for one in found) == yields, name
    assert [one.yields for one in conflicts_of_geometry(lanes)] == [False, False]


def test_lanes_that_part_follow_or_lie_side_by_side_do_not_meet() -> None:
    straight, bend = np.arange(0.0, 50.0), np.linspace(0.0, 1.0, 40)
    lanes = (
        Lanelet("in", straight - 49.0, 0.0 * straight, ("on", "piece")),
        Lanelet("on", straight, 0.0 * straight),
        # the other way begins with a piece of 2 m
        Lanelet("piece", 30.0 * np.sin(bend[:3]), 30.0 * (1.0 - np.cos(bend[:3])), ("turn",)),
        Lanelet("turn", 30.0 * np.sin(bend[2:]), 30.0 * (1.0 - np.cos(bend[2:]))),
        Lanelet("back", straight[::-1], np.full(50, 3.5)),
    )
    found = {(one.lane, one.other) for one in conflicts_of_geometry(lanes)}
    assert found == {("turn", "back"), ("back", "turn")}


def test_near_lanes_are_found_wherever_they_lie() -> None:
    """Each two lanes that come nearer than the clearance are compared: all points with all points."""
    rng = np.random.default_rng(4)
    start, end = rng.uniform(-40.0, 40.0, (2, 25, 2))
    lanes = [Lanelet(f"l{k}", *np.stack((start[k], end[k]), axis=1)) for k in range(25)]
    points = [start[k] + np.linspace(0.0, 1.0, 2000)[:, None] * (end[k] - start[k]) for k in range(25)]
    near = {
        (i, j)
        for i in range(25)
        for j in range(25)
        if i != j and np.hypot(*(points[i][:, None] - points[j]).transpose(2, 0, 1)).min() < CLEARANCE_M - 0.1
    }
    found = {(int(one.lane[1:]), int(one.other[1:])) for one in conflicts_of_geometry(lanes)}
    assert near <= found
    assert len(near) > 100


def test_many_lanes_that_all_cross_are_refused_at_once() -> None:
    way = np.linspace(0.0, 3.0, 1000)
    lanes = [Lanelet(f"l{k}", np.array([0.0, 100.0]), np.array([a, 3.0 - a])) for k, a in enumerate(way.tolist())]
    began = time.process_time()
    with pytest.raises(
        InputError, match="lanes lie over one another, and more than 17000 pairs of the 1000 lanes meet"
    ):
        conflicts_of_geometry(lanes)
    assert time.process_time() - began < 10.0


def test_a_road_that_is_too_large_for_the_plane_is_refused() -> None:
    lanes = [Lanelet(f"l{k}", np.array([0.0, 9e4]), np.full(2, 10.0 * k)) for k in range(20)]
    with pytest.raises(InputError, match="1800 km in all are more than 1000 km; cut out a part"):
        conflicts_of_geometry(lanes)


def test_roads_of_the_examples_have_the_conflicts_of_their_kind() -> None:
    ring = roundabout()
    yields = {(one.lane, one.other) for one in ring.conflicts if one.yields}
    assert yields == {(f"in{k}", f"ring{k}") for k in range(1, 5)}
    around = ring.path(["in1", "ring1_2", "ring2", "ring2_3", "ring3", "ring3_4", "ring4"])
    inside = np.linspace(around.place_of(ring.number("ring1_2")) + 5.0, around.length_m - 5.0, 50)
    np.testing.assert_allclose(around.curvature(inside), 1.0 / 20.0, rtol=0.01)
    four = crossing()
    # two lanes of 3.5 m at right angles: the oncoming lane is 1.75 m left of the middle, which is 10 m away
    (place,) = areas(four, "2to4", "1to3")
    assert (place.enter_m, place.leave_m) == pytest.approx((10.0 - 1.75 - 2.5, 10.0 - 1.75 + 2.5), abs=1e-6)
    assert (place.stop_m, place.yields) == (0.0, True)
    assert [one.yields for one in areas(four, "1to4", "3to1")] == [True]
    assert not areas(four, "1to3", "3to1")
    lights = crossing(cycle_s=60.0)
    time = np.arange(0.0, 60.0)
    green = np.array([~one.red_at(time) for one in lights.signals])
    assert green.sum(axis=1).tolist() == [25, 25, 25, 25]
    assert not (green[0] & green[1]).any()
    assert [one.yields for one in areas(merge(), "ramp", "main")] == [True]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def noisy_drives(network: Network, rng: np.random.Generator, vehicles: int) -> tuple[list[np.ndarray], list[list[int]]]:
    """Vehicles on random ways, with a stop somewhere: vehicle, time, x and y of each row with 0.3 m noise; the ways."""
    rows, ways = [], []
    for vehicle in range(vehicles):
        way = [int(rng.choice([k for k, before in enumerate(network.before) if not before]))]
        while after := [k for k in network.after[way[-1]] if k not in way]:
            way.append(int(rng.choice(after)))
        path = network.path(way)
        # up to where the last lane lies alone
        s = np.arange(0.0, path.length_m - 1.0, rng.uniform(0.5, 1.2))
        s = np.insert(s, rng.integers(len(s)), np.full(50, rng.choice(s)))
        s.sort()
        x, y, _ = path.at(s)
        rows.append(np.stack((np.full(len(s), vehicle), 0.1 * np.arange(len(s)), *(rng.normal((x, y), 0.3)))))
        ways.append(way)
    return [*np.concatenate(rows, axis=1)], ways


@pytest.mark.parametrize("network", [roundabout(), crossing(), merge()], ids=["roundabout", "crossing", "merge"])
def test_routes_of_noisy_tracks_are_found(network: Network, rng: np.random.Generator) -> None:
    (vehicle, time, x, y), ways = noisy_drives(network, rng, 100)
    shuffled = rng.permutation(len(x))
    found = routes_of(network, vehicle[shuffled].astype(int), time[shuffled], x[shuffled], y[shuffled])
    right = 0
    for k, way in enumerate(ways):
        whose = vehicle[shuffled] == k
        routes = np.unique(found.route[whose]).tolist()
        # a way that ends because the next lane would come twice has no lane of its own at its end
        right += len(routes) == 1 and found.paths[routes[0]].lanes in (tuple(way), tuple(way[:-1]))
    assert right >= 99
    assert np.nanstd(found.d_m) == pytest.approx(0.3, rel=0.1)


def test_a_vehicle_that_turns_back_or_leaves_begins_another_route() -> None:
    way = np.arange(0.0, 60.0, 0.5)
    there = Lanelet("there", np.array([0.0, 60.0]), np.zeros(2))
    back = Lanelet("back", np.array([60.0, 0.0]), np.full(2, 3.5))
    x = np.concatenate((way, way[::-1], way))
    y = np.concatenate((0.0 * way, 0.0 * way + 3.5, 0.0 * way + 20.0))
    found = routes_of(Network((there, back)), np.zeros(len(x), dtype=int), 0.1 * np.arange(len(x)), x, y)
    assert [one.lanes for one in found.paths] == [(0,), (1,)]
    assert np.mean(found.route == np.repeat([0, 1, -1], len(way))) > 0.95
    assert len(found.notes) == 2
    np.testing.assert_allclose(np.diff(found.s_m[5:100]), 0.5)


def test_a_vehicle_that_waits_between_two_lanes_stays_on_its_route(rng: np.random.Generator) -> None:
    network = crossing()
    way = ["in2", "2to4", "out4"]
    path = network.path(way)
    # it waits where its lane ends and three others begin, and is seen up to 3 m before and behind
    line = path.place_of(network.number("2to4"))
    waits = line + 3.0 * np.sin(np.arange(300) / 20.0)
    s = np.concatenate((np.arange(0.0, line, 0.8), waits, np.arange(line, 150.0, 0.8)))
    x, y, heading = path.at(s)
    x, y = rng.normal((x, y), 0.2)
    found = routes_of(network, np.zeros(len(s), dtype=int), 0.1 * np.arange(len(s)), x, y, heading)
    assert [[network.lanes[k].name for k in one.lanes] for one in found.paths] == [way]
    assert (found.route == 0).all()
    np.testing.assert_allclose(found.s_m, s, atol=1.0)
