"""Small roads for studies and tests: a roundabout, a crossing and a merge. Vehicles drive on the right."""

from collections.abc import Sequence

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.errors import InputError
from sugiyama_ros.roads.conflicts import conflicts_of_geometry
from sugiyama_ros.roads.network import Lanelet, Network, Signal

#: Speed limit [m/s] of these roads: 50 km/h.
LIMIT = 50.0 / 3.6
# Half of the width [m] of a lane: middle lines of two directions are twice this apart.
_HALF_LANE_M = 1.75
# Angle [rad] on a roundabout between the middle of an arm and where its lanes reach the ring.
_BESIDE = np.radians(25.0)
# Way [m] from the ring over which the lanes of an arm bend.
_BEND_M = 12.0
# Time [s] from the end of green for one road to green for the other.
_CLEAR_S = 5.0


def roundabout(arms: int = 4, radius_m: float = 20.0, approach_m: float = 80.0) -> Network:
    """Make a roundabout with one lane, on which drivers who come in yield.

    Parameters
    ----------
    arms : int
        Number of arms, evenly around the ring.
    radius_m : float
        Radius [m] of the middle of the ring.
    approach_m : float
        Length [m] of each arm, from the ring.

    Returns
    -------
    Network
        For each arm k from 1 on the lanes ``in{k}``, ``out{k}`` and ``ring{k}`` (from its way out to its way in), and
        ``ring1_2`` and so on, from the way in of an arm to the way out of the next one.
    """
    if not (arms >= 2 and radius_m >= 10.0 and approach_m > _BEND_M):
        raise InputError(
            f"roundabout: {arms} arms of {approach_m:g} m, radius {radius_m:g} m; give two arms or more, a radius of"
            f" 10 m or more, and arms of more than {_BEND_M:g} m"
        )
    lanes = []
    far, bend = radius_m + approach_m, radius_m + _BEND_M
    for k in range(arms):
        angle, after = 2.0 * np.pi * k / arms, 2.0 * np.pi * (k + 1) / arms
        begin, bend_in, bend_out, end = _turned(
            [[far, _HALF_LANE_M], [bend, _HALF_LANE_M], [bend, -_HALF_LANE_M], [far, -_HALF_LANE_M]], angle
        )
        leave = _arc(radius_m, angle - _BESIDE, angle + _BESIDE)
        enter = _arc(radius_m, angle + _BESIDE, after - _BESIDE)
        onto, off = angle + _BESIDE + 0.5 * np.pi, angle - _BESIDE + 0.5 * np.pi
        here, there = k + 1, (k + 1) % arms + 1
        between = f"ring{here}_{there}"
        lanes += [
            _lane(f"in{here}", np.vstack((begin, _curve(bend_in, angle + np.pi, enter[0], onto))), between),
            _lane(f"out{here}", np.vstack((_curve(leave[0], off, bend_out, angle), end))),
            _lane(f"ring{here}", leave, between),
            _lane(between, enter, f"ring{there}", f"out{there}"),
        ]
    return Network(tuple(lanes), conflicts_of_geometry(lanes, {f"in{k + 1}": -1.0 for k in range(arms)}))


def crossing(approach_m: float = 80.0, cycle_s: float = 0.0) -> Network:
    """Make a crossing of two roads with one lane in each direction.

    Parameters
    ----------
    approach_m : float
        Length [m] of each arm, from the crossing.
    cycle_s : float
        Length [s] of the cycle of the signals: arms 1 and 3 may drive in its first half, arms 2 and 4 in the second
        one, but for the last 5 s of each half. 0 for no signals: then the road of arms 1 and 3 has priority.

    Returns
    -------
    Network
        For each arm k from 1 to 4 the lanes ``in{k}`` and ``out{k}``, and ``1to2`` and so on across the crossing.
        Drivers who turn left yield to those who come towards them.
    """
    lanes: list[Lanelet] = []
    priority: dict[str, float] = {}
    half = 10.0
    for k in range(4):
        angle = 0.5 * np.pi * k
        far = [[half + approach_m, _HALF_LANE_M], [half, _HALF_LANE_M]]
        away = [[half, -_HALF_LANE_M], [half + approach_m, -_HALF_LANE_M]]
        others = [(k + turn) % 4 + 1 for turn in (1, 2, 3)]
        names = [f"{k + 1}to{other}" for other in others]
        lanes += [_lane(f"in{k + 1}", _turned(far, angle), *names), _lane(f"out{k + 1}", _turned(away, angle))]
        bend = np.linspace(0.0, 0.5 * np.pi, 16)
        ways = {
            -1: np.stack((half - (half - _HALF_LANE_M) * np.sin(bend), half - (half - _HALF_LANE_M) * np.cos(bend)), 1),
            0: np.array([[half, _HALF_LANE_M], [-half, _HALF_LANE_M]]),
            1: np.stack((half - (half + _HALF_LANE_M) * np.sin(bend), (half + _HALF_LANE_M) * np.cos(bend) - half), 1),
        }
        for name, other, (turn, way) in zip(names, others, ways.items(), strict=True):
            lanes.append(_lane(name, _turned(way, angle), f"out{other}"))
            priority[name] = 2.0 * (k % 2 == 0 and not cycle_s) - (turn == 1)
    stop = {name: 0.0 for name in priority if name[0] in "24" and not cycle_s}
    conflicts = conflicts_of_geometry(lanes, priority, stop_m=stop)
    return Network(tuple(lanes), conflicts, _signals(approach_m, cycle_s) if cycle_s else ())


def merge(main_m: float = 300.0, ramp_m: float = 150.0, after_m: float = 200.0) -> Network:
    """Make a main road of one lane, and a ramp whose drivers yield.

    Parameters
    ----------
    main_m, ramp_m, after_m : float
        Length [m] of the main road before the merge, of the ramp in the direction of the main road, and of the road
        after the merge.

    Returns
    -------
    Network
        The lanes ``main``, ``ramp`` and ``after``.
    """
    ramp = _curve(np.array([-ramp_m, -0.15 * ramp_m]), np.arctan(0.15), np.zeros(2), 0.0)
    lanes = (
        _lane("main", np.array([[-main_m, 0.0], [0.0, 0.0]]), "after"),
        _lane("ramp", ramp, "after"),
        _lane("after", np.array([[0.0, 0.0], [after_m, 0.0]])),
    )
    return Network(lanes, conflicts_of_geometry(lanes, {"ramp": -1.0}))


def _signals(stop_m: float, cycle_s: float) -> tuple[Signal, ...]:
    half = 0.5 * cycle_s
    first = np.array([0.0, half - _CLEAR_S]), np.array([False, True])
    second = np.array([0.0, half, cycle_s - _CLEAR_S]), np.array([True, False, True])
    return tuple(Signal(f"in{k + 1}", stop_m, *(first, second)[k % 2], cycle_s) for k in range(4))


def _lane(name: str, point: Array, *successors: str) -> Lanelet:
    return Lanelet(name, point[:, 0], point[:, 1], successors, speed_limit=LIMIT)


def _turned(point: Sequence[Sequence[float]] | Array, angle: float) -> Array:
    """Points (P, 2), turned around the middle."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(np.asarray(point) @ np.array([[cos, sin], [-sin, cos]]))


def _arc(radius_m: float, begin: float, end: float) -> Array:
    angle = np.linspace(begin, end, max(3, int(np.ceil((end - begin) * radius_m)) + 1))
    return np.asarray(radius_m * np.stack((np.cos(angle), np.sin(angle)), axis=1))


def _curve(begin: Array, out: float, end: Array, into: float) -> Array:
    """A cubic curve from one point and direction [rad] to another."""
    part = np.linspace(0.0, 1.0, 25)[:, None]
    reach = np.hypot(*(end - begin))
    first, last = (reach * np.array([np.cos(angle), np.sin(angle)]) for angle in (out, into))
    point = begin * (1.0 + 2.0 * part) * (1.0 - part) ** 2 + end * part**2 * (3.0 - 2.0 * part)
    return np.asarray(point + first * part * (1.0 - part) ** 2 - last * part**2 * (1.0 - part))
