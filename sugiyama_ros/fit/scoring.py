"""Fisher scoring: the coordinates and the bounds of a search, its damped step, and the search for one driver.

The expected information of innovations y with variance S is sum(dy dy' / S + dS dS' / 2 S^2). It is positive, so
Newton's step with this information points uphill. The damping of Levenberg and Marquardt shortens a step that does not
gain. ``search`` fits a single driver; ``fit.joint`` and ``fit.classes`` take the same step for many drivers, and have
loops of their own: one keeps derivatives from step to step, the other weights drivers by the class they may be in.

The coordinate of a parameter with a fixed sign is the logarithm of its size.

References
----------
Marquardt, J. SIAM 11 (1963) 431. Osborne, Fisher's method of scoring, Int. Stat. Rev. 60 (1992) 99.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import OMEGA_2, PARAMETERS, V_STAR
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.first_look import SIGMAS
from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.smooth_positions import Evenness
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.desired_speed import largest_v_star

#: Smallest size of a parameter in the search, in the parameter's own unit; noises have a bound of their own.
SMALLEST = 1e-3
#: Longest step of a logarithm.
LONGEST = 0.7
# Maximum number of steps of a search.
_STEPS = 60
# Coordinate of each parameter p: log(p) for +1, log(-p) for -1, p itself for 0.
_SIGN = np.array([1.0 if p.lower >= 0.0 else 0.0 for p in ROW.declared])
_SIGN[OMEGA_2] = -1.0


def fastest(trajectories: DenseTracks) -> float:
    """Return the speed [m/s] below which 99 % of the samples are; 0 if there are too few samples for a speed."""
    speed = paper.smoothed_speed(trajectories.road.unwrap(trajectories.position_m), 2, trajectories.period_s)
    return float(np.nanquantile(speed, 0.99)) if np.isfinite(speed).any() else 0.0


def upper_bounds(speed: float) -> Array:
    """Return the upper bounds (P,) of the search; the bound of v* follows the high ``speed`` in the data [m/s]."""
    upper = np.array([p.upper for p in PARAMETERS])
    upper[V_STAR] = min(upper[V_STAR], largest_v_star(speed))
    return upper


def lower_bounds(even: Evenness) -> Array:
    """Return the smallest sizes (P,) of the parameters in the search; the sizes of noises follow the data."""
    lower = np.full(len(PARAMETERS), SMALLEST)
    lower[SIGMAS] = even.smallest_noise
    return lower


def coordinate(values: Array, places: Sequence[int] | Ints) -> Array:
    """Return the coordinates of parameters (..., K) at ``places``: logarithms for parameters with a fixed sign."""
    sign = _SIGN[list(places)]
    logarithm = np.log(np.maximum(np.where(sign == 0.0, 1.0, sign * values), 1e-12))
    return np.where(sign == 0.0, values, logarithm)


def value(coordinates: Array, places: Sequence[int] | Ints) -> Array:
    """Return the parameters (..., K) at ``places`` from their coordinates."""
    sign = _SIGN[list(places)]
    return np.where(sign == 0.0, coordinates, sign * np.exp(np.where(sign == 0.0, 0.0, coordinates)))


def is_linear(places: Sequence[int] | Ints) -> Mask:
    """Return whether the coordinate of each parameter at ``places`` (K,) is the parameter itself, not a logarithm."""
    return np.asarray(_SIGN[list(places)] == 0.0)


def limits(places: Sequence[int] | Ints, least: Array, upper: Array) -> Array:
    """Return the bounds (2, K) of parameters at ``places``; parameters with a fixed sign stay away from zero.

    least: smallest sizes; upper: upper bounds, both for all entries of a row.
    """
    chosen = list(places)
    sign, size, highest = _SIGN[chosen], least[chosen], upper[chosen]
    declared = np.array([ROW.declared[k].lower for k in chosen])
    lowest = np.where(sign > 0.0, np.maximum(declared, size), declared)
    return np.array([lowest, np.where(sign < 0.0, np.minimum(highest, -size), highest)])


def derivatives(scored: Scored, parameters: Array, places: Ints) -> tuple[Array, Array]:
    """Return gradient (K,) and information (K, K) of a score at parameters (P,), by the coordinates at ``places``."""
    scale, block = parameters[places], scored.information[np.ix_(places, places)]
    return scored.gradient[places] * scale, block * np.outer(scale, scale)


@dataclass(frozen=True)
class Damping:
    """How the damping of a search changes: it is divided by ten after a success and multiplied by ten after a failure.

    least: smallest value after a success; least_after_failure: smallest value after a failure; most: the search ends
    beyond this value; start: value at the start.
    """

    least: float
    least_after_failure: float
    most: float
    start: float = 1e-3

    def updated(self, damping: Any, better: Any, worse: Any) -> Any:
        """Return the damping (...) after a step that was better or worse, or neither if none was tried."""
        eased = np.maximum(damping / 10.0, self.least)
        raised = np.maximum(10.0 * damping, self.least_after_failure)
        return np.where(better, eased, np.where(worse, raised, damping))


# Damping of the search for the parameters of a single driver.
_ALONE = Damping(least=1e-9, least_after_failure=1e-2, most=1e8)


def damped(information: Array, relative: Any, absolute: float = 0.0) -> Array:
    """Return information (..., K, K) with a ridge: its diagonal times ``relative`` (...), plus ``absolute``."""
    diagonal = np.arange(information.shape[-1])
    ridge = np.zeros_like(information)
    size = np.abs(information[..., diagonal, diagonal])
    ridge[..., diagonal, diagonal] = np.asarray(relative)[..., None] * size + absolute
    return np.asarray(information + ridge)


def damped_step(information: Array, gradient: Array, relative: float, absolute: float) -> Array:
    """Return Newton's step (K,) from a gradient (K,) with damped information (K, K)."""
    return np.asarray(np.linalg.solve(damped(information, relative, absolute), gradient), np.float64)


def limited(change: Array, longest: Any) -> Array:
    """Return a step (...) with every entry limited to plus or minus ``longest``."""
    return np.asarray(np.clip(change, -longest, longest))


class Point(NamedTuple):
    """A point of a search: coordinates (K,), the function's value, its derivatives, and what the caller keeps."""

    x: Array
    value: float
    gradient: Array
    information: Array
    scored: Any


def search(at: Callable[[Array, Point | None], Point | None], start: Array, ends: Array, enough: float) -> Point:
    """Maximise a function of coordinates (K,) between their ``ends`` (2, K)."""
    (smallest, largest), here, damping = ends, at(start, None), _ALONE.start
    if here is None:
        raise ValueError("the search needs a point to begin with")
    for _ in range(_STEPS):
        x, gradient = here.x, here.gradient
        free = ~(((x <= smallest) & (gradient < 0.0)) | ((x >= largest) & (gradient > 0.0)))
        if not free.any():
            break
        change = np.zeros_like(x)
        change[free] = damped_step(here.information[np.ix_(free, free)], gradient[free], damping, 1e-9)
        if 0.5 * float(gradient @ change) < enough or damping > _ALONE.most:
            break
        there = at(np.clip(x + limited(change, LONGEST), smallest, largest), here)
        is_better = there is not None and there.value > here.value
        here = there if there is not None and is_better else here
        damping = float(_ALONE.updated(damping, is_better, not is_better))
    return here
