"""Drivers of the paper and of six laws, written a second time: plain numpy, all drivers and all actions at once.

Nothing here comes from ``driver``, ``laws`` or ``simulation``. A mistake that the simulator, the filter and the fit of
the package share therefore shows in recordings of these drivers.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array

# The paper's candidates for an acceleration [m/s^2], look-ahead [s], and period [s] of its experiment.
_ACTIONS: Array = np.arange(-24, 17) / 4.0
_LOOK_AHEAD_S, _PERIOD_S = 4.0 / 3.0, 1.0 / 3.0
_FAR = 1e9


@dataclass(frozen=True, eq=False)
class People:
    """N drivers with the paper's parameters; arrays of shape (N,).

    desired_speed, risk_premium: v* [m/s] and kappa_v [s]; measurement_std, acceleration_std: sigma_nu [m] and sigma_a
    [m/s^2]; noise: factor on all noises; law: name of the law that they follow; empty for the paper's drivers; values:
    (N, K), parameters of the law.
    """

    desired_speed: Array
    risk_premium: Array
    measurement_std: Array
    acceleration_std: Array
    noise: float = 1.0
    law: str = ""
    values: Array | None = None


@dataclass(frozen=True, eq=False)
class Sight:
    """What N drivers see at one moment; arrays of shape (N,), infinite gaps where nobody is.

    time_s: time of the recording; position, speed, acceleration, held: position [m] along the road, without end on a
    ring; speed [m/s]; accelerations [m/s^2] of the car and of the driver's foot in the last period; gap, leader_speed,
    leader_acceleration: of the car ahead; second_gap, second_speed: gap between the car ahead and the car before it,
    and its speed; rear_gap, rear_speed: of the car behind.
    """

    time_s: float
    position: Array
    speed: Array
    acceleration: Array
    held: Array
    gap: Array
    leader_speed: Array
    leader_acceleration: Array
    second_gap: Array
    second_speed: Array
    rear_gap: Array
    rear_speed: Array


def drawn(
    count: int, rng: np.random.Generator, noise: float = 1.0, spread: float = 0.1, desired_speed: float = 10.26
) -> People:
    """Draw drivers whose desired speeds and risk premiums differ by 10 %."""
    return People(
        desired_speed=desired_speed * np.exp(spread * rng.standard_normal(count)),
        risk_premium=0.215 * np.exp(spread * rng.standard_normal(count)),
        measurement_std=np.full(count, 0.263 * noise),
        acceleration_std=np.full(count, 0.273 * noise),
        noise=noise,
    )


def periods_ahead(period_s: float) -> int:
    """Return the number of periods that a driver looks ahead."""
    return max(1, int(np.floor(_LOOK_AHEAD_S / period_s + 1e-6)))


def risk(gap: Array, speed: Array, other_speed: Array, premium: Array) -> Array:
    """Return F(gap / sigma), the paper's risk, for speeds (N, K) that the drivers would have."""
    scale = 0.4 + premium * np.abs(speed) + np.maximum(speed - other_speed, 0.0)
    ratio = np.maximum(gap / scale, 0.0)
    return np.asarray(np.exp(-ratio * ratio - 2.0 * ratio))


def worst_risk(gap: Array, view: Sight, other_speed: Array, people: People, period_s: float) -> Array:
    """Return the largest risk in the look-ahead, (N, K), of a car that is a gap (N,) [m] ahead."""
    speed, other = view.speed[:, None], other_speed[:, None]
    worst: Array = np.zeros((len(gap), len(_ACTIONS)))
    for k in range(1, periods_ahead(period_s) + 1):
        # k periods of Euler's rule: the acceleration moves the car from the second period on
        there = np.minimum(gap, _FAR)[:, None] + k * period_s * (other - speed)
        there = there - 0.5 * k * (k - 1) * period_s**2 * _ACTIONS
        worst = np.maximum(worst, risk(there, speed + k * period_s * _ACTIONS, other, people.risk_premium[:, None]))
    return worst


def mean_action(view: Sight, people: People, period_s: float, more: Array | None = None) -> Array:
    """Return the mean action (N,) [m/s^2]; ``more``: utility (N, K) that comes on top of the paper's."""
    speed = view.speed[:, None] + period_s * _ACTIONS
    wish = people.desired_speed[:, None]
    reward = np.exp(-(((speed - wish) / (0.7 * wish)) ** 2)) - np.exp(np.minimum(-10.0 * (speed + 0.25), 600.0))
    utility = reward - 10.0 * worst_risk(view.gap, view, view.leader_speed, people, period_s)
    if more is not None:
        utility = utility + more
    weight = np.exp(200.0 * (utility - utility.max(axis=1, keepdims=True)))
    return np.asarray((weight * _ACTIONS).sum(axis=1) / weight.sum(axis=1))


def noises(people: People, period_s: float) -> tuple[float, Array, float, float]:
    """Return rho, sigma_a (N,), sigma_x and sigma_v at a period.

    The noise keeps its correlation over the look-ahead and its spread; position and speed wander by as much a second.
    """
    rho = 0.7 ** (4.0 / periods_ahead(period_s))
    acceleration = people.acceleration_std * np.sqrt((1.0 - rho**2) / (1.0 - 0.7**2))
    longer = float(np.sqrt(period_s / _PERIOD_S))
    return rho, acceleration, 0.05 * people.noise * longer, 0.1 * people.noise * longer


_MOST_BRAKING, _MOST_GAS = -6.0, 4.0
#: Mean parameters of each law, in the order in which its function takes them.
LAW_MEANS: Mapping[str, tuple[float, ...]] = {
    "idm": (11.0, 0.5, 1.2, 1.6, 2.0),
    "fvdm": (0.9, 0.8, 5.0, 5.0, 0.25, 1.2),
    "gipps": (11.0, 1.6, 3.0, 3.2, 0.5, 1.0),
    "ovm": (2.5, 4.5, 0.25, 5.5),
    "helly": (1.2, 0.3, 1.0, 1.0),
    "newell": (10.5, 1.2, 1.0, 0.4),
}


def _idm(view: Sight, p: Array) -> Array:
    """Treiber, Hennecke and Helbing 2000: v0, T, s0, a, b."""
    v0, headway, s0, a, b = p.T
    v = np.maximum(view.speed, 0.0)
    wanted = s0 + np.maximum(v * headway + v * (v - view.leader_speed) / (2.0 * np.sqrt(a * b)), 0.0)
    return np.asarray(a * (1.0 - (v / v0) ** 4 - (wanted / np.maximum(view.gap, 1e-2)) ** 2))


def _fvdm(view: Sight, p: Array) -> Array:
    """Jiang, Wu and Zhu 2001: kappa, lambda, V1, V2, C1, C2."""
    kappa, difference, v1, v2, c1, c2 = p.T
    return np.asarray(
        kappa * (v1 + v2 * np.tanh(c1 * view.gap - c2) - view.speed) + difference * (view.leader_speed - view.speed)
    )


def _gipps(view: Sight, p: Array) -> Array:
    """Gipps 1981: V, a, b, b of the leader, tau, standing gap."""
    v0, a, b, b_leader, tau, s0 = p.T
    v = np.maximum(view.speed, 0.0)
    free = v + 2.5 * a * tau * (1.0 - v / v0) * np.sqrt(0.025 + v / v0)
    leader = np.maximum(view.leader_speed, 0.0)
    inside = (b * tau) ** 2 + b * (2.0 * (view.gap - s0) - v * tau + leader**2 / b_leader)
    safe = np.sqrt(np.maximum(inside, 0.0)) - b * tau
    return np.asarray((np.maximum(np.minimum(free, safe), 0.0) - view.speed) / tau)


def _ovm(view: Sight, p: Array) -> Array:
    """Bando et al. 1995: sensitivity, V, steepness, turning point."""
    kappa, scale, steep, turn = p.T
    return np.asarray(kappa * (scale * (np.tanh(steep * (view.gap - turn)) + np.tanh(steep * turn)) - view.speed))


def _helly(view: Sight, p: Array) -> Array:
    """Helly 1959: C1, C2, alpha, beta."""
    c1, c2, alpha, beta = p.T
    return np.asarray(c1 * (view.leader_speed - view.speed) + c2 * (view.gap - alpha - beta * view.speed))


def _newell(view: Sight, p: Array) -> Array:
    """Newell 2002: free speed, tau, standing gap; the speed relaxes in a time."""
    v0, tau, s0, relaxation = p.T
    return np.asarray((np.clip((view.gap - s0) / tau, 0.0, v0) - view.speed) / relaxation)


_LAWS = {"idm": _idm, "fvdm": _fvdm, "gipps": _gipps, "ovm": _ovm, "helly": _helly, "newell": _newell}


def followers(law: str, count: int, rng: np.random.Generator, noise: float = 1.0) -> People:
    """Draw drivers of a law, whose parameters differ by 5 %."""
    base = drawn(count, rng, noise)
    values = np.array(LAW_MEANS[law]) * np.exp(0.05 * rng.standard_normal((count, len(LAW_MEANS[law]))))
    return People(
        base.desired_speed, base.risk_premium, base.measurement_std, base.acceleration_std, noise, law, values
    )


def law_action(view: Sight, people: People) -> Array:
    """Return the accelerations (N,) [m/s^2] that drivers of a law choose."""
    assert people.values is not None
    return np.clip(_LAWS[people.law](view, people.values), _MOST_BRAKING, _MOST_GAS)
