"""What all drivers on a road see and do: one period of the forward problem."""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.utility import scratch_for
from sugiyama_ros.effects.control import carry_out, intend, looks_back
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.jit import kernel


class Traffic(NamedTuple):
    """The state of N vehicles.

    position: (N,), continuous positions [m] of the centres; speed: (N,), speeds [m/s]; held: (N,), accelerations
    [m/s^2] that the drivers made their cars do in the last period; acceleration: (N,), accelerations [m/s^2] of the
    cars in the last period; past: (H, 2, N), positions and speeds one period ago, two periods ago, and so on, for
    drivers who look back.
    """

    position: Array
    speed: Array
    held: Array
    acceleration: Array
    past: Array


class Order(NamedTuple):
    """Who follows whom among N vehicles.

    leader: (N,), number of each vehicle's leader; -1 without a leader; turn: (N,), whole turns of a ring [m]; the
    headway is the leader's position minus the vehicle's position minus ``turn``; length: (N,), lengths [m] of the
    vehicles.
    """

    leader: Ints
    turn: Array
    length: Array


class Setting(NamedTuple):
    """What does not change during a run.

    period: length of a period [s]; horizon: periods that a driver looks ahead; circumference: circumference [m] of the
    ring; 0 for an open road.
    """

    period: float
    horizon: int
    circumference: float


@kernel
def see(driver: int, leader: int, traffic: Traffic, order: Order) -> tuple[float, float]:
    """Compute what a driver sees of the vehicle ahead.

    Positions are continuous, so a vehicle that has passed its leader keeps a negative headway.

    driver, leader: numbers of the two vehicles; ``leader`` is -1 if there is no leader. Returns gap [m], infinite
    without a leader, and the leader's speed [m/s], 0 without a leader.
    """
    if leader < 0:
        return np.inf, 0.0
    headway = traffic.position[leader] - traffic.position[driver] - order.turn[driver]
    return headway - 0.5 * (order.length[leader] + order.length[driver]), traffic.speed[leader]


@kernel
def begin(position: Array, speed: Array, held: Array, acceleration: Array, rows: Array, period: float) -> Traffic:
    """Return traffic that begins now, with a past in which every vehicle kept its speed.

    The past is as long as the drivers of ``rows`` (N, width) look back; the other arguments as in ``Traffic``.
    """
    periods = 0
    for i in range(len(rows)):
        periods = max(periods, math.ceil(looks_back(rows[i]) / period))
    past = np.empty((periods, 2, len(speed)))
    for k in range(periods):
        for i in range(len(speed)):
            past[k, 0, i] = position[i] - (k + 1) * period * speed[i]
            past[k, 1, i] = speed[i]
    return Traffic(position, speed, held, acceleration, past)


@kernel
def remember(traffic: Traffic) -> None:
    """Put what there is now into the past, one period before the vehicles move; changed in place."""
    past = traffic.past
    for i in range(past.shape[2] if len(past) > 0 else 0):
        for k in range(len(past) - 1, 0, -1):
            past[k, 0, i], past[k, 1, i] = past[k - 1, 0, i], past[k - 1, 1, i]
        past[0, 0, i], past[0, 1, i] = traffic.position[i], traffic.speed[i]


@kernel
def _then(i: int, ago: float, traffic: Traffic) -> tuple[float, float]:
    """Return position [m] and speed [m/s] of vehicle i some periods ago, by straight lines between the periods."""
    past = traffic.past
    late = min(math.ceil(ago), len(past))
    early, share = late - 1, ago - (late - 1)
    x, v = past[late - 1, 0, i], past[late - 1, 1, i]
    if early == 0:
        x_after, v_after = traffic.position[i], traffic.speed[i]
    else:
        x_after, v_after = past[early - 1, 0, i], past[early - 1, 1, i]
    return x_after + share * (x - x_after), v_after + share * (v - v_after)


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

    rows: (N, width), rows of the drivers at this period; actions: (K,), accelerations [m/s^2] that the drivers
    consider; time: time of the recording [s]; out: (D,), filled with the accelerations [m/s^2] that the first D drivers
    make their cars do; pushed: (D,), filled with the accelerations [m/s^2] that the environment adds for the first D
    vehicles.
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
        past_gap, past_speed, past_leader_speed = gap, speed[i], leader_speed
        ago = looks_back(rows[i]) / setting.period
        if ago > 0.0:
            own, past_speed = _then(i, ago, traffic)
            if leader[i] >= 0:
                other, past_leader_speed = _then(leader[i], ago, traffic)
                past_gap = gap + (other - traffic.position[leader[i]]) - (own - position[i])
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
            past_gap=past_gap,
            past_speed=past_speed,
            past_leader_speed=past_leader_speed,
        )
        meant, pushed[i] = intend(seen, rows[i], scratch, setting.period, setting.horizon)
        out[i] = carry_out(meant, traffic.held[i], rows[i], setting.period)
