"""What all drivers on a road see and do: one period of the forward problem."""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import RHO, SIGMA_A, SIGMA_NU, SIGMA_V, SIGMA_X, index
from sugiyama_ros.driver.utility import advance, scratch_for
from sugiyama_ros.effects.control import (
    carry_out,
    displacements,
    intend,
    looks_back,
    noise_factor,
    noise_std_factors,
    spoil,
)
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.jit import kernel
from sugiyama_ros.road import Road

# Positions [m], speeds [m/s] and acceleration noises [m/s^2] of N vehicles.
_Motion = tuple[Array, Array, Array]
_WANDERING = tuple(e for e in EFFECTS.values() if e.wanders)


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
    vehicles; line: (N, 4), position [m] of the line ahead of each vehicle, times [s] until who goes first reaches the
    place behind it and has left it, and curvature [1/m]; NaN where there is none.
    """

    leader: Ints
    turn: Array
    length: Array
    line: Array


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
def gaps(traffic: Traffic, order: Order) -> Array:
    """Gaps (N,) [m] of all vehicles to the vehicles ahead, as of ``see``."""
    found = np.empty(len(order.leader))
    for i in range(len(order.leader)):
        found[i], _ = see(i, order.leader[i], traffic, order)
    return found


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
        line_gap, arrive_s, clear_s, curvature = np.inf, np.inf, np.inf, 0.0
        if not math.isnan(order.line[i, 0]):
            line_gap = order.line[i, 0] - position[i] - 0.5 * order.length[i]
            arrive_s, clear_s = order.line[i, 1], order.line[i, 2]
        if not math.isnan(order.line[i, 3]):
            curvature = order.line[i, 3]
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
            line_gap=line_gap,
            arrive_s=arrive_s,
            clear_s=clear_s,
            curvature=curvature,
        )
        meant, pushed[i] = intend(seen, rows[i], scratch, setting.period, setting.horizon)
        out[i] = carry_out(meant, traffic.held[i], rows[i], setting.period)


@kernel
def act_along(
    states: Array,
    leader: Ints,
    turn: Array,
    length: Array,
    lines: Array,
    rows: Array,
    actions: Array,
    time_s: Array,
    setting: Setting,
    out: Array,
) -> None:
    """Compute the accelerations [m/s^2] of drivers at every state of known traffic, which does not follow them.

    states: (T, V, 4), position [m], speed [m/s], noise and held acceleration [m/s^2]; leader, turn, length: (T, V), as
    in ``Order``; lines: (T, N, 4), of the N first vehicles; rows: (V, width); time_s: (T,); out: (T, N), filled.
    """
    samples, vehicles, drivers = len(states), states.shape[1], out.shape[1]
    held, pushed, line = states[0, :, 3].copy(), np.zeros(drivers), np.full((vehicles, lines.shape[2]), np.nan)
    past = begin(states[0, :, 0], states[0, :, 1], held, held, rows, setting.period).past
    for t in range(samples):
        x, v, acceleration = states[t, :, 0].copy(), states[t, :, 1].copy(), states[t, :, 2] + states[t, :, 3]
        line[:drivers] = lines[t]
        traffic = Traffic(x, v, held, acceleration, past)
        drive(traffic, Order(leader[t], turn[t], length[t], line), rows, actions, time_s[t], setting, out[t], pushed)
        remember(traffic)
        for i in range(vehicles):
            # what a driver holds comes from the driver's own actions, as far as they are known
            held[i] = out[t, i] if i < drivers and not math.isnan(out[t, i]) else states[t, i, 3]
            if i < drivers:
                out[t, i] += pushed[i]


@kernel
def noise_factors(speed: Array, rows: Array) -> Array:
    """Factors (N,) of the acceleration noises of drivers with rows (N, width) at speeds (N,) [m/s]."""
    found = np.empty(len(speed))
    for i in range(len(speed)):
        found[i] = noise_factor(speed[i], rows[i])
    return found


def move(own: _Motion, acceleration: Array, rows: Array, period: float, rng: np.random.Generator) -> _Motion:
    """Move vehicles by one period [s], with random shocks.

    acceleration: (N,), of the cars [m/s^2]; rows: (N, width), rows of the drivers at this period.
    """
    x, v, noise = own
    shock = rng.standard_normal((3, len(x)))
    factor = noise_factors(v, rows)
    position, speed = advance(x, v, acceleration, period)
    return (
        position + rows[:, SIGMA_X] * shock[0],
        speed + rows[:, SIGMA_V] * shock[1],
        rows[:, RHO] * noise + rows[:, SIGMA_A] * factor * shock[2],
    )


def measure(
    position: Array, road: Road, rows: Array, rng: np.random.Generator, rng_of_effects: np.random.Generator
) -> Array:
    """Measure positions (N,) [m] of drivers with rows (N, width), wrapped on a ring; draws measurement noise."""
    noise = rows[:, SIGMA_NU] * rng.standard_normal(len(position))
    noise *= noise_std_factors(position, road.circumference_m, rows)
    noise = spoil(noise, rows, rng_of_effects)
    off = displacements(position, road.circumference_m, rows)
    return road.wrap(position + off + noise)


class Wandering:
    """Preferences of N drivers that wander as Ornstein-Uhlenbeck processes.

    period_s: time [s] between two samples; rng: generator of the random changes.
    """

    def __init__(self, period_s: float, rng: np.random.Generator) -> None:
        self._period_s, self._rng = period_s, rng
        self._mood: dict[str, Array] = {}

    def next_rows(self, drivers: Array) -> Array:
        """Return the rows (N, width) of the drivers, at the period of the samples, with the preferences of the moment.

        The rows that are given stay as they are.
        """
        rows = drivers
        for effect in _WANDERING:
            std, time = drivers[:, ROW.places[effect.name]].T[:2]
            if not std.any():
                continue
            is_first = effect.name not in self._mood
            mood = self._mood.setdefault(effect.name, np.zeros((len(effect.wanders), len(rows))))
            memory: Array = np.exp(-self._period_s / np.where(std > 0.0, time, 1.0)) * (not is_first)
            fresh = self._rng.standard_normal(mood.shape)
            mood[:] = memory * mood + std * np.sqrt(1.0 - np.square(memory)) * fresh
            rows = rows.copy()
            rows[:, [index(name) for name in effect.wanders]] *= np.exp(mood.T)
        return rows
