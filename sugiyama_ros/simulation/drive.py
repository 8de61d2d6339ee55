"""What every driver in a line of vehicles sees, and what they make of it: one period of the forward problem."""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.utility import scratch_for
from sugiyama_ros.effects.control import carry_out, intend
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.jit import kernel


class Traffic(NamedTuple):
    """The state of N vehicles, each (N,).

    position: continuous [m]; speed [m/s]; held: what each driver made the car do in the last period [m/s^2];
    acceleration: of the car in the last period [m/s^2].
    """

    position: Array
    speed: Array
    held: Array
    acceleration: Array


class Order(NamedTuple):
    """Who follows whom among N vehicles, each (N,).

    leader: number of the vehicle ahead, -1 without one; turn: whole turns of a ring [m] by which the leader's
    continuous position exceeds the vehicle's own; length: of the vehicles [m].
    """

    leader: Ints
    turn: Array
    length: Array


class Setting(NamedTuple):
    """What does not change during a run: period [s], planning horizon [periods], circumference [m] (0 on a line)."""

    period: float
    horizon: int
    circumference: float


@kernel
def see(driver: int, leader: int, traffic: Traffic, order: Order) -> tuple[float, float]:
    """What a driver sees of the vehicle ahead.

    Positions are continuous, so a vehicle that passed its leader keeps a negative headway.

    Parameters
    ----------
    driver, leader
        Numbers of the two vehicles; leader is -1 if there is none.
    traffic, order
        State and order of all vehicles.

    Returns
    -------
    Gap [m], infinite without a leader, and the leader's speed [m/s].
    """
    if leader < 0:
        return np.inf, 0.0
    headway = traffic.position[leader] - traffic.position[driver] - order.turn[driver]
    return headway - 0.5 * (order.length[leader] + order.length[driver]), traffic.speed[leader]


@kernel
def drive(
    traffic: Traffic,
    order: Order,
    rows: Array,
    actions: Array,
    time: float,
    setting: Setting,
    out: Array,
    pushed: Array,
) -> None:
    """Compute what drivers make their cars do in one period, and what the environment adds.

    Parameters
    ----------
    traffic, order
        State and order of all N vehicles.
    rows
        (N, WIDTH) parameters of the drivers at this period; preferences may be changed in place.
    actions
        (K,) accelerations that drivers choose among [m/s^2].
    time
        Time of the recording [s].
    setting
        Period, horizon and circumference.
    out, pushed
        (D,) filled for the first D vehicles: the drivers' accelerations, and those of the environment [m/s^2].
    """
    position, speed, leader = traffic.position, traffic.speed, order.leader
    follower, scratch = np.full(len(leader), -1), scratch_for(actions)
    for i in range(len(leader)):
        if leader[i] >= 0:
            follower[leader[i]] = i
    for i in range(len(out)):
        gap, leader_speed = see(i, leader[i], traffic, order)
        leader_acceleration, second_gap, second_speed, rear_gap, rear_speed = 0.0, np.inf, 0.0, np.inf, 0.0
        if leader[i] >= 0:
            leader_acceleration = traffic.acceleration[leader[i]]
            second_gap, second_speed = see(leader[i], leader[leader[i]], traffic, order)
        if follower[i] >= 0:
            rear_gap, _ = see(follower[i], i, traffic, order)
            rear_speed = speed[follower[i]]
        seen = Seen(
            gap=gap,
            speed=speed[i],
            leader_speed=leader_speed,
            position=position[i],
            time=time,
            circumference=setting.circumference,
            acceleration=traffic.acceleration[i],
            leader_acceleration=leader_acceleration,
            second_gap=second_gap,
            second_speed=second_speed,
            rear_gap=rear_gap,
            rear_speed=rear_speed,
        )
        meant, pushed[i] = intend(seen, rows[i], scratch, setting.period, setting.horizon)
        out[i] = carry_out(meant, traffic.held[i], rows[i], setting.period)
