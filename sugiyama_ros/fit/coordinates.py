"""Coordinates of a search, their bounds, and its damped steps.

The coordinate of a parameter with a fixed sign is the logarithm of its size. The searches are Fisher scoring: the
expected information of innovations y with variance S is sum(dy dy' / S + dS dS' / 2 S^2). It is positive, so Newton's
step with this information points uphill. The damping of Levenberg and Marquardt shortens a step that does not gain.

References
----------
Marquardt, J. SIAM 11 (1963) 431. Osborne, Fisher's method of scoring, Int. Stat. Rev. 60 (1992) 99.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import PARAMETERS, V_STAR
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.first_look import SIGMAS
from sugiyama_ros.fit.smooth_positions import Evenness
from sugiyama_ros.trajectories.dense import DenseTracks
from sugiyama_ros.trajectories.desired_speed import largest_v_star

#: Smallest size of a parameter in the search, in the parameter's own unit; noises have a bound of their own.
SMALLEST = 1e-3
#: Longest step of a logarithm.
LONGEST = 0.7
#: Predicted gain of a step [nats] below which the search for a driver ends; the causal likelihood is rough below it.
ENOUGH_CAUSAL = 0.02
#: Step of difference quotients as part of a parameter's std, and its upper limit in a logarithm. The likelihood is
#: smooth only at these scales: close to contact the filter amplifies smaller changes without limit.
PART_OF_STD, LONGEST_STEP = 0.5, 0.05
# Coordinate of each parameter p: log(p) for +1, log(-p) for -1, p itself for 0.
_SIGN = np.array([1.0 if p.lower >= 0.0 else -1.0 if p.upper <= 0.0 else 0.0 for p in ROW.declared])


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


def with_open_ends(interval: Array, places: Sequence[int] | Ints, ends: Array) -> Array:
    """Return intervals (..., K, 2) of parameters at ``places`` without the ends that the data do not set.

    An end on a bound of the search, beyond it, or unknown is open. An open end is infinite, or 0 towards 0 where the
    sign of the parameter is fixed; ``has_both_ends`` knows it by this. ends: (2, K), bounds of the search, from
    ``limits``.
    """
    sign, (lowest, highest) = _SIGN[list(places)], ends
    near = 1e-9 * np.abs(ends)
    low, high = interval[..., 0], interval[..., 1]
    return np.stack(
        [
            np.where(low > lowest + near[0], low, np.where(sign > 0.0, 0.0, -np.inf)),
            np.where(high < highest - near[1], high, np.where(sign < 0.0, 0.0, np.inf)),
        ],
        axis=-1,
    )


def has_both_ends(interval: Array) -> Mask:
    """Return whether the data set both ends of intervals (..., 2)."""
    return np.asarray((np.isfinite(interval) & (interval != 0.0)).all(axis=-1))


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
