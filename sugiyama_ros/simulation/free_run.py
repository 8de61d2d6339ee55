"""Compiled free runs: from a given state on, the model drives on its own.

In a coupled run, all vehicles drive by the model. In a single run, one vehicle drives by the model, and its neighbours
drive as they were recorded. Nobody drives backward, and nobody drives through the vehicle ahead: who touches it stays
behind it. Without shocks, a run follows the mean of each period's acceleration. It ends ahead of the mean of many runs
with shocks, because cars brake harder than they accelerate.
"""

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import RHO, SIGMA_A
from sugiyama_ros.driver.utility import advance
from sugiyama_ros.effects.control import noise_factor
from sugiyama_ros.jit import kernel
from sugiyama_ros.simulation.drive import Order, Setting, Traffic, begin, drive, remember


@kernel
def run_coupled(
    recorded: Array,
    order: Order,
    rows: Array,
    actions: Array,
    time: float,
    setting: Setting,
    shock: Array,
    out: Array,
) -> None:
    """Let all vehicles drive by the model, except vehicles that lead others and follow nobody: what a driver does on a
    road without a leader is not in the data, so these vehicles drive as they were recorded.

    recorded: (steps + 1, N, 4), filtered position [m], speed [m/s], acceleration noise and held acceleration [m/s^2];
    rows: (N, width), rows of the drivers at this period; they stay as they are; actions: (K,), accelerations [m/s^2]
    that the drivers consider; time: time of the first sample [s]; shock: (steps, N), standard normal shocks of the
    acceleration noise; zeros for a run without noise; out: (steps, N, 2), filled with positions [m] and speeds [m/s].
    """
    x, v, n, b = recorded[0, :, 0].copy(), recorded[0, :, 1].copy(), recorded[0, :, 2].copy(), recorded[0, :, 3].copy()
    vehicles = len(x)
    is_platoon = order.leader.max() >= 0
    held, pushed = np.empty(vehicles), np.empty(vehicles)
    acceleration = b + rows[:, RHO] * n
    traffic = begin(x, v, b, acceleration, rows, setting.period)
    for k in range(len(out)):
        drive(traffic, order, rows, actions, time, setting, held, pushed)
        remember(traffic)
        for i in range(vehicles):
            acceleration[i] = held[i] + pushed[i] + n[i]
            x[i], v[i] = advance(x[i], v[i], acceleration[i], setting.period)
            n[i] = _noise(n[i], shock[k, i], v[i], rows[i])
            b[i] = held[i]
            if is_platoon and order.leader[i] < 0 and np.isfinite(recorded[k + 1, i, 0]):
                x[i], v[i], n[i], b[i] = recorded[k + 1, i]
                acceleration[i] = b[i] + rows[i, RHO] * n[i]
        for i in range(vehicles):
            ahead = order.leader[i]
            v[i] = max(v[i], 0.0)
            if ahead >= 0:
                x[i], v[i] = _behind(x[i], v[i], x[ahead], max(v[ahead], 0.0), i, order)
        time += setting.period
        for i in range(vehicles):
            out[k, i, 0], out[k, i, 1] = x[i], v[i]


@kernel
def _noise(n: float, shock: float, speed: float, row: Array) -> float:
    """Acceleration noise [m/s^2] of a driver in the next period."""
    noise: float = row[RHO] * n + row[SIGMA_A] * noise_factor(speed, row) * shock
    return noise


@kernel
def _behind(x: float, v: float, leader_x: float, leader_v: float, i: int, order: Order) -> tuple[float, float]:
    """Position [m] and speed [m/s] of vehicle i, which is at most at contact with the leader."""
    contact = leader_x - order.turn[i] - 0.5 * (order.length[i] + order.length[order.leader[i]])
    # a leader who is not known stops nobody
    return (contact, min(v, leader_v)) if x > contact else (x, v)


@kernel
def _neighbourhood(i: int, order: Order) -> tuple[Ints, Order]:
    """Find vehicle i, the two vehicles ahead and the vehicle behind: their numbers, i first, and their order."""
    leader = order.leader
    near = np.array([i, leader[i], leader[leader[i]] if leader[i] >= 0 else -1, -1])
    for j in range(len(leader)):
        if leader[j] == i:
            near[3] = j
    count, place = 0, np.full(len(leader), -1)
    chosen: Ints = np.empty(4, np.int64)
    for j in near:
        if j >= 0 and place[j] < 0:
            place[j] = count
            chosen[count] = j
            count += 1
    ahead = np.full(count, -1)
    for k in range(count):
        if leader[chosen[k]] >= 0:
            ahead[k] = place[leader[chosen[k]]]
    numbers = chosen[:count]
    return numbers, Order(ahead, order.turn[numbers], order.length[numbers], order.line[numbers])


@kernel
def _look_back_from_now(traffic: Traffic, period: float) -> None:
    """Let the neighbours of the first vehicle have come from where they are, in the past period [s]; changed in place.

    Estimated positions jump from one sample to the next, because each has seen a further measurement: the later one
    knows more of the past, too.
    """
    for j in range(1, len(traffic.speed) if len(traffic.past) > 0 else 0):
        v = max(traffic.speed[j] - period * traffic.acceleration[j], 0.0)
        traffic.past[0, 0, j] = traffic.position[j] - 0.5 * period * (traffic.speed[j] + v)
        traffic.past[0, 1, j] = v


@kernel
def run_single(
    who: Ints,
    recorded: Array,
    order: Order,
    rows: Array,
    actions: Array,
    time: float,
    setting: Setting,
    lines: Array,
    shock: Array,
    out: Array,
) -> None:
    """Let each of some vehicles drive by the model among neighbours who drive as they were recorded.

    who: (W,), numbers of the vehicles, whose columns of ``out`` are filled; lines: (steps + 1, D, 4), of ``Order``, at
    each period, of the D first vehicles, among whom are those of ``who``; other arguments as for ``run_coupled``.
    """
    for i in who:
        near, order_near = _neighbourhood(i, order)
        rows_near = rows[near]
        held, pushed = np.empty(1), np.empty(1)
        x, v, n, b = recorded[0, i, 0], recorded[0, i, 1], recorded[0, i, 2], recorded[0, i, 3]
        a = b + rows[i, RHO] * n
        past = begin(recorded[0, near, 0], recorded[0, near, 1], held, held, rows_near, setting.period).past
        now = time
        for k in range(len(out)):
            xs, vs, bs = recorded[k, near, 0].copy(), recorded[k, near, 1].copy(), recorded[k, near, 3].copy()
            accelerations = bs + recorded[k, near, 2]
            xs[0], vs[0], bs[0], accelerations[0] = x, v, b, a
            traffic = Traffic(xs, vs, bs, accelerations, past)
            _look_back_from_now(traffic, setting.period)
            order_near.line[0] = lines[k, i]
            drive(traffic, order_near, rows_near, actions, now, setting, held, pushed)
            remember(traffic)
            a = held[0] + pushed[0] + n
            x, v = advance(x, v, a, setting.period)
            ahead, v = order_near.leader[0], max(v, 0.0)
            if ahead >= 0:
                there = recorded[k + 1, near[ahead]]
                x, v = _behind(x, v, there[0], max(there[1], 0.0), 0, order_near)
            n = _noise(n, shock[k, i], v, rows[i])
            b = held[0]
            now += setting.period
            out[k, i, 0], out[k, i, 1] = x, v
