"""Six laws of car following, written a second time from their sources: plain numpy, all drivers at once."""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.away.drivers import People, Sight, drawn

_MOST_BRAKING, _MOST_GAS = -6.0, 4.0
#: Mean parameters of each law, in the order in which its function takes them.
MEANS: Mapping[str, tuple[float, ...]] = {
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
    values = np.array(MEANS[law]) * np.exp(0.05 * rng.standard_normal((count, len(MEANS[law]))))
    return People(
        base.desired_speed, base.risk_premium, base.measurement_std, base.acceleration_std, noise, law, values
    )


def act(view: Sight, people: People) -> Array:
    """Return the accelerations (N,) [m/s^2] that drivers of a law choose."""
    assert people.values is not None
    return np.clip(_LAWS[people.law](view, people.values), _MOST_BRAKING, _MOST_GAS)
