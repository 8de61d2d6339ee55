"""Drivers of a generator of its own, in plain numpy, with mechanisms that the catalogue of effects does not have.

The paper's driver is written down here a second time, so that an error in the package cannot hide behind itself. What
the drivers do beyond it has no name in the package: the right verdict is not a name, but that the model does not
explain the recording, or a model that forecasts better without a claim.

    python benchmarks/outside.py MECHANISM SEED OUT.csv
"""

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ACTIONS = np.linspace(-6.0, 4.0, 41)
LENGTH_M, PERIOD_S, AHEAD = 4.33, 1.0 / 3.0, 4


def mean_action(gap: Array, speed: Array, leader: Array, v_star: Array, kappa_v: Array) -> Array:
    """Acceleration (N,) [m/s^2] that the paper's drivers mean: the Boltzmann mean over a grid of held actions."""
    a = ACTIONS[None, :]
    least = np.full((len(gap), len(ACTIONS)), np.inf)
    for tau in range(1, AHEAD + 1):
        v = speed[:, None] + tau * PERIOD_S * a
        ahead = gap[:, None] + tau * PERIOD_S * (leader - speed)[:, None] - PERIOD_S**2 * a * 0.5 * tau * (tau - 1)
        scale = 0.4 + kappa_v[:, None] * np.abs(v) + np.maximum(v - leader[:, None], 0.0)
        least = np.minimum(least, ahead / scale)
    # the reward is for the speed of the next period
    v = speed[:, None] + PERIOD_S * a
    reward = np.exp(-np.square((v - v_star[:, None]) / (0.7 * v_star[:, None])))
    reward -= np.exp(np.minimum(-10.0 * (v + 0.25), 600.0))
    inside = np.maximum(least, 0.0)
    utility = reward - 10.0 * np.exp(-inside * (inside + 2.0))
    weight = np.exp(200.0 * (utility - utility.max(axis=1, keepdims=True)))
    return np.asarray((weight * a).sum(axis=1) / weight.sum(axis=1))


class Traffic:
    """What a mechanism may look at and change: state of all cars now, and what they meant to do before."""

    last_leader: Array
    memory: Array
    until_s: Array
    gap: Array
    speed: Array
    leader: Array

    def __init__(self, cars: int, rng: np.random.Generator) -> None:
        self.rng, self.time_s = rng, 0.0
        self.last_leader, self.memory = np.zeros(cars), np.zeros(cars)
        self.until_s = np.zeros(cars)
        self.gap = self.speed = self.leader = np.zeros(cars)


def nothing(t: Traffic, meant: Array) -> Array:
    """The paper's driver."""
    return meant


def linear_friction(t: Traffic, meant: Array) -> Array:
    """A resistance in proportion to the speed."""
    return meant - 0.05 * t.speed


def gear_changes(t: Traffic, meant: Array) -> Array:
    """No pull for half a second whenever a car passes 4 or 8 m/s upward."""
    at = np.minimum(np.abs(t.speed - 4.0), np.abs(t.speed - 8.0)) < 0.5
    return np.where(at & (meant > 0.0), 0.2 * meant, meant)


def gusts(t: Traffic, meant: Array) -> Array:
    """Wind that pushes all cars alike, for seconds."""
    t.memory[:] = 0.93 * t.memory + 0.12 * t.rng.standard_normal()
    return meant + t.memory


def held_pedal(t: Traffic, meant: Array) -> Array:
    """Drivers look up after 0.35 s on average, and hold the pedal until then (action points)."""
    looks = t.time_s >= t.until_s
    t.until_s = np.where(looks, t.time_s + t.rng.exponential(0.35, len(meant)), t.until_s)
    t.memory = np.where(looks, meant, t.memory)
    return t.memory


def one_sided_feet(t: Traffic, meant: Array) -> Array:
    """Cars brake as drivers mean, but pull only two thirds as hard."""
    return np.where(meant > 0.0, 0.65 * meant, meant)


def brake_lights(t: Traffic, meant: Array) -> Array:
    """Drivers lift their foot while the car ahead brakes visibly and is near."""
    return meant - 0.5 * ((t.last_leader < -0.8) & (t.gap < 15.0))


def sticky_standstill(t: Traffic, meant: Array) -> Array:
    """Who stands does not start before the gap is 4 m."""
    return np.where((t.speed < 0.3) & (t.gap < 4.0), np.minimum(meant, 0.0), meant)


#: What is hidden: what cars do of what drivers mean, and how drivers see gap, speed and leader's speed.
MECHANISMS: dict[str, Callable[[Traffic, Array], Array]] = {
    "nothing": nothing,
    "linear friction": linear_friction,
    "gear changes": gear_changes,
    "gusts": gusts,
    "held pedal": held_pedal,
    "one-sided feet": one_sided_feet,
    "brake lights": brake_lights,
    "sticky standstill": sticky_standstill,
    "rounded speed": nothing,
    "wide gaps at speed": nothing,
    "underestimated closing": nothing,
}


def seen(name: str, t: Traffic) -> tuple[Array, Array, Array]:
    """Gap [m] and speeds [m/s] as drivers perceive them."""
    if name == "rounded speed":
        step = 5.0 / 3.6
        return t.gap, step * np.round(t.speed / step), t.leader
    if name == "wide gaps at speed":
        return t.gap - 0.006 * t.speed**2, t.speed, t.leader
    if name == "underestimated closing":
        closing = t.speed - t.leader
        return t.gap, t.speed, t.speed - np.sign(closing) * np.maximum(np.abs(closing) - 0.5, 0.0)
    return t.gap, t.speed, t.leader


def record(name: str, seed: int, most: int = 22, ring_m: float = 230.0, duration_s: float = 250.0) -> Array:
    """Measured positions (T, N) [m] of cars on a ring, not wrapped; fewer cars where so many collide.

    Raises
    ------
    ValueError
        If cars collide at every try.
    """
    for attempt in range(40):
        rng, cars = np.random.default_rng([seed, attempt, *name.encode()]), most - attempt // 4
        v_star = 10.26 * np.exp(0.1 * rng.standard_normal(cars))
        kappa_v = 0.215 * np.exp(0.15 * rng.standard_normal(cars))
        # steadier drivers where they collide
        std = 0.13 * 0.95**attempt * np.exp(0.2 * rng.standard_normal(cars))
        t = Traffic(cars, rng)
        noise: Array = np.zeros(cars)
        x: Array = (LENGTH_M + 2.0) * np.arange(cars, dtype=np.float64)
        v: Array = np.zeros(cars)
        positions: list[Array] = []
        for _ in range(round(duration_s / PERIOD_S) + 1):
            positions.append(x)
            t.gap, t.speed, leader = np.roll(x, -1) - x - LENGTH_M, v, np.roll(v, -1)
            t.gap[-1] += ring_m
            t.last_leader = (leader - t.leader) / PERIOD_S if t.time_s else np.zeros(cars)
            t.leader = leader
            if (t.gap <= 0.0).any():
                break
            meant = mean_action(*seen(name, t), v_star, kappa_v)
            noise = 0.7 * noise + std * rng.standard_normal(cars)
            x = x + PERIOD_S * v + 0.05 * rng.standard_normal(cars)
            v = v + PERIOD_S * (MECHANISMS[name](t, meant) + noise) + 0.1 * rng.standard_normal(cars)
            t.time_s += PERIOD_S
        else:
            found = np.array(positions)
            return found + 0.25 * rng.standard_normal(found.shape)
    raise ValueError(f"{name}: cars always collide")


def main() -> None:
    """Write one recording."""
    name, seed, out = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    rows = ["time_s,vehicle,position_m,length_m"]
    for k, at in enumerate(record(name, seed)):
        rows += [f"{k * PERIOD_S:.6f},{i},{x % 230.0:.4f},{LENGTH_M}" for i, x in enumerate(at)]
    out.write_text("\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
