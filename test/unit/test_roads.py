"""Roads as graphs: geometry, conflicts, readers, and the routes of vehicles."""

import numpy as np
import pytest

from sugiyama_ros.errors import InputError
from sugiyama_ros.roads.network import Conflict, Lanelet, Network, Signal


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
