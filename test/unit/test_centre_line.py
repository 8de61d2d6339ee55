"""Positions along and across a centre line against closed forms, and who follows whom on lanes."""

from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.centre_line import read_lanes
from sugiyama_ros.trajectories.centre_line import CentreLine, RoadLanes
from sugiyama_ros.trajectories.placing import Placer, SeenVehicle

RNG = np.random.default_rng(5)


def circle(radius_m: float, points: int, clockwise: bool = False) -> CentreLine:
    angle = np.linspace(0.0, 2.0 * np.pi, points) * (-1.0 if clockwise else 1.0)
    return CentreLine(radius_m * np.cos(angle), radius_m * np.sin(angle))


def test_a_straight_line() -> None:
    """A line at 30 degrees: along and across it are a rotation, also before and after its ends."""
    along, across = RNG.uniform(-20.0, 120.0, 200), RNG.uniform(-8.0, 8.0, 200)
    cos, sin = np.cos(np.pi / 6.0), np.sin(np.pi / 6.0)
    ends = np.array([0.0, 3.0, 50.0, 100.0])
    line = CentreLine(5.0 + cos * ends, -7.0 + sin * ends)
    s, d = line.project(5.0 + cos * along - sin * across, -7.0 + sin * along + cos * across)
    assert s == pytest.approx(along, abs=1e-12 * 200)
    assert d == pytest.approx(across, abs=1e-12 * 200)
    assert not line.road.is_ring


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_circle(clockwise: bool) -> None:
    """Chords are shorter than arcs by angle^2 / 24, and lie inside of the circle by angle^2 radius / 8 at most."""
    radius, points = 60.0, 400
    line, turn = circle(radius, points, clockwise), 2.0 * np.pi / (points - 1)
    angle, off = RNG.uniform(0.0, 2.0 * np.pi, 500), RNG.uniform(-8.0, 8.0, 500)
    sign = -1.0 if clockwise else 1.0
    # the left of a driver who goes round counterclockwise is the inside
    x, y = ((radius - sign * off) * f(sign * angle) for f in (np.cos, np.sin))
    s, d = line.project(x, y)
    assert line.road.circumference_m == pytest.approx(2.0 * np.pi * radius * (1.0 - turn**2 / 24.0), rel=turn**4)
    sag = radius * turn**2 / 8.0
    assert np.abs(d - off).max() < 1.5 * sag
    assert np.abs(line.road.difference(s, angle * line.length_m / (2.0 * np.pi))).max() < 2.0 * turn * sag
    there_x, there_y = line.at(s, d)
    assert np.hypot(there_x - x, there_y - y).max() < 1e-6


def test_the_position_grows_steadily_beside_the_corners_of_a_line() -> None:
    """Outside of a bend, the nearest point of a polyline stays at its corners. Here nothing stands still or jumps."""
    line = circle(30.0, 40)
    angle = np.linspace(0.3, 5.9, 4000)
    s, _ = line.project(36.0 * np.cos(angle), 36.0 * np.sin(angle))
    step = np.diff(s) / (30.0 * np.diff(angle))
    assert step.min() > 0.97
    assert step.max() < 1.03


def test_lines_that_are_no_road(tmp_path: Path) -> None:
    for text, why in (
        ("a,b\n1,2\n", "x,y"),
        ("x,y\n", "no points"),
        ("x,y\n0,0\n", "at least two"),
        ("x,y\n0,0\n0,0\n1,1\n", "point 2 is the one before it"),
        ("x,y\n0,0\n1,fast\n", ":3: y 'fast' is not a finite number"),
        ("x,y,lane\n0,0\n", ":2: 2 of 3 fields"),
        ("x,y,width\n0,0,900\n", "give 0.5 to 50"),
        ("x,y,lane\n0,0,a\n9,0,a\n9,9,a\n0,9,a\n0,0,a\n0,0,b\n9,0,b\n", "close all of them, or none"),
    ):
        (tmp_path / "line.csv").write_text(text)
        with pytest.raises(InputError, match=why):
            read_lanes(tmp_path / "line.csv")
    (tmp_path / "line.csv").write_text("x,y,lane,width\n0,0,right,3\n10,0,right,3\n0,3,left,4\n10,3,left,4\n")
    lanes = read_lanes(tmp_path / "line.csv")
    assert (lanes.names, lanes.width_m.tolist()) == (("right", "left"), [3.0, 4.0])


def two_lanes() -> RoadLanes:
    x, zero = np.array([0.0, 500.0]), np.zeros(2)
    return RoadLanes(["right", "left"], [CentreLine(x, zero), CentreLine(x, zero + 3.5)], [3.5, 3.5])


def test_leaders_follow_lanes_and_a_change_needs_a_margin() -> None:
    placer = Placer(two_lanes())

    def leader_of_c(y_m: float) -> str:
        seen = [SeenVehicle(0, "a", 100.0, 0.0), SeenVehicle(0, "b", 80.0, 3.5), SeenVehicle(0, "c", 60.0, y_m)]
        return next(one.leader for one in placer.place(seen) if one.seen.name == "c")

    # the marking is at 1.75 m; 0.2 m beyond it, the vehicle is nearer to the other line by 0.4 m
    assert [leader_of_c(y) for y in (0.0, 1.7, 1.9, 2.0, 1.7, 1.6, 1.5)] == ["a", "a", "a", "b", "b", "b", "a"]


def test_vehicles_beside_the_road_or_against_it_are_left_out() -> None:
    placer = Placer(two_lanes())
    seen = [
        SeenVehicle(0, "on", 10.0, 0.1, heading=0.2),
        SeenVehicle(0, "parked", 20.0, -3.0),
        SeenVehicle(0, "oncoming", 30.0, 3.5, heading=np.pi),
        SeenVehicle(0, "ahead", 40.0, -0.1),
    ]
    assert [(one.seen.name, one.leader) for one in placer.place(seen)] == [("on", "ahead"), ("ahead", "")]


def test_on_a_ring_the_first_leads_the_last() -> None:
    placer = Placer(RoadLanes(["0"], [circle(50.0, 500)], [3.5]))
    seen = [
        SeenVehicle(0, name, 50.0 * np.cos(a), 50.0 * np.sin(a)) for name, a in (("a", 0.1), ("b", 2.0), ("c", 6.2))
    ]
    assert [one.leader for one in placer.place(seen)] == ["b", "c", "a"]


@pytest.mark.parametrize("far_m", [1e8, 1e200, 1.7e308])
def test_a_line_longer_than_any_road_is_refused(far_m: float) -> None:
    with pytest.raises(InputError, match=r"centre line: is .* m long; give points in metres, 1e\+07 m at most"):
        CentreLine(np.array([0.0, 10.0, -far_m, far_m]), np.zeros(4))
