"""Drivers who drive by the model behind vehicles that drive as they were recorded."""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.drive import Order, Setting, Wandering, begin, drive, measure, move

# A driver who is faster than this [m/s] in reverse drives backward; noise moves those who stand a little.
_BACKWARD = 2.0


class RecordedTraffic(NamedTuple):
    """Recorded vehicles in V columns; the first N of them are drivers who drive anew.

    state: (T, V, 4), position [m], speed [m/s], acceleration noise and held acceleration [m/s^2]; NaN where unknown;
    leader: (T, V), column of the vehicle ahead; -1 where there is none; length_m: (T, V), lengths [m]; segment: (N, T),
    number of the unbroken part of each driver's record; line: (T, N, 4), of ``Order``; road: the road; period_s: time
    [s] between two samples.
    """

    state: Array
    leader: Ints
    length_m: Array
    segment: Ints
    line: Array
    road: Road
    period_s: float


def drive_behind(recorded: RecordedTraffic, rows: Array, rng: np.random.Generator) -> tuple[Array, Ints]:
    """Simulate drivers, each alone behind the recorded vehicles ahead.

    A driver starts from the recorded state, and again after a collision, when the model drives backward, and wherever a
    segment begins.

    rows: (N, width), rows of the drivers at the period of the samples. Returns position_m: (T, N), measured positions
    [m]; NaN where a driver could not be simulated; segment: (N, T), number of the unbroken part of each driver's new
    record.
    """
    samples, drivers = len(recorded.state), len(rows)
    everybody = np.resize(rows, (recorded.leader.shape[1], rows.shape[1]))
    rng_of_effects = rng.spawn(1)[0]
    wandering = Wandering(recorded.period_s, rng_of_effects)
    setting = Setting(recorded.period_s, horizon_at(recorded.period_s), recorded.road.circumference_m)
    own, there = np.zeros((5, drivers)), np.zeros(drivers, np.bool_)
    measured, begins = np.full((samples, drivers), np.nan), np.zeros((drivers, samples), np.bool_)
    can_drive = _can_drive(recorded)
    past: Array = np.full((samples, 2, len(everybody)), np.nan)
    for k in range(samples):
        if k > 0:
            own[:3] = move((own[0], own[1], own[2]), own[3] + own[4] + own[2], rows, recorded.period_s, rng)
        lost = there & ((_gaps(own[0], recorded, k) <= 0.0) | (own[1] < -_BACKWARD))
        again = (can_drive[k] & ~there) | lost
        if k > 0:
            again |= recorded.segment[:, k] != recorded.segment[:, k - 1]
            again &= can_drive[k]
        own[:4, again], own[4, again] = recorded.state[k, :drivers][again].T, 0.0
        begins[:, k] = again
        there = can_drive[k]
        everybody[:drivers] = wandering.next_rows(rows)
        past[:k, :, np.resize(again, len(everybody))] = np.nan
        past[k] = recorded.state[k, :, :2].T
        past[k, :, :drivers] = own[:2]
        _decide(own, everybody, recorded, k, setting, past)
        measured[k, there] = measure(own[0], recorded.road, rows, rng, rng_of_effects)[there]
    return measured, np.cumsum(begins, axis=1)


def _can_drive(recorded: RecordedTraffic) -> Mask:
    """Whether each driver's state, and the leader's where there is one, is known; (T, N)."""
    known = np.isfinite(recorded.state[:, :, 0])
    drivers = len(recorded.segment)
    leader = recorded.leader[:, :drivers]
    return np.asarray(known[:, :drivers] & ((leader < 0) | np.take_along_axis(known, leader, axis=1)))


def _gaps(position: Array, recorded: RecordedTraffic, k: int) -> Array:
    """Gaps [m] of the drivers at positions (N,) to the vehicles ahead, (N,); infinite or NaN without one."""
    drivers = len(position)
    leader = recorded.leader[k, :drivers]
    length = recorded.length_m[k]
    way = recorded.road.space_headway(recorded.state[k, leader, 0], position)
    return np.where(leader >= 0, way - 0.5 * (length[leader] + length[:drivers]), np.inf)


def _decide(own: Array, rows: Array, recorded: RecordedTraffic, k: int, setting: Setting, past: Array) -> None:
    """Let the drivers decide what their cars do in the coming period: the last two rows of own (5, N).

    past: (T, 2, V) positions and speeds until sample k; NaN where nobody knows them.
    """
    drivers = own.shape[1]
    state, leader = recorded.state[k].copy(), recorded.leader[k].copy()
    state[:drivers] = own[:4].T
    leader[~np.isfinite(state[leader, 0])] = -1
    position, speed, noise, held = (np.nan_to_num(state[:, j]) for j in range(4))
    turn: Array = np.zeros(len(leader))
    if setting.circumference > 0.0:
        headway = position[leader] - position
        turn = np.where(leader >= 0, setting.circumference * np.floor(headway / setting.circumference), 0.0)
    line: Array = np.full((len(leader), 4), np.nan)
    line[:drivers] = recorded.line[k]
    order = Order(leader, turn, recorded.length_m[k], line)
    traffic = begin(position, speed, held, held + noise, rows, setting.period)
    for ago in range(min(len(traffic.past), k)):
        known = np.isfinite(past[k - 1 - ago])
        traffic.past[ago][known] = past[k - 1 - ago][known]
    drive(traffic, order, rows, ACTIONS, 0.0, setting, own[3], own[4])
