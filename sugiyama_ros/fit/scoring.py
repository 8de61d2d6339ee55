"""Damped Fisher scoring: the one optimiser of all fits.

The expected information of innovations y with variance S is sum(dy dy' / S + dS dS' / 2 S^2). It is positive, so
Newton's step with this information points uphill. The damping of Levenberg and Marquardt shortens a step that does not
gain. ``search`` fits a single driver; ``fit.joint`` and ``fit.classes`` take the same step with the same rules for many
drivers.

References
----------
Marquardt, J. SIAM 11 (1963) 431. Osborne, Fisher's method of scoring, Int. Stat. Rev. 60 (1992) 99.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import PARAMETERS, V_STAR
from sugiyama_ros.filters import paper
from sugiyama_ros.fit.smooth_positions import NOISES, Evenness
from sugiyama_ros.trajectories.desired_speed import largest_v_star
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Smallest size of a parameter in the search, in the parameter's own unit; noises have a bound of their own.
SMALLEST = 1e-3


def fastest(trajectories: Trajectories) -> float:
    """Return the speed [m/s] below which 99 % of the samples are; 0 if there are too few samples for a speed."""
    speed = paper.smoothed_speed(trajectories.road.unwrap(trajectories.position_m), 2, trajectories.period_s)
    return float(np.nanquantile(speed, 0.99)) if np.isfinite(speed).any() else 0.0


def upper_bounds(speed: float) -> Array:
    """Return the upper bounds of the search; the bound of v* follows the speeds in the data.

    speed: high speed in the data [m/s], as ``fastest`` returns it. Returns (P,), upper bound of each parameter, in its
    own unit.
    """
    upper = np.array([p.upper for p in PARAMETERS])
    upper[V_STAR] = min(upper[V_STAR], largest_v_star(speed))
    return upper


def lower_bounds(even: Evenness) -> Array:
    """Return the smallest sizes (P,) of the parameters in the search; the sizes of noises follow the data."""
    lower = np.full(len(PARAMETERS), SMALLEST)
    lower[NOISES] = even.smallest_noise
    return lower


@dataclass(frozen=True, eq=False)
class LogSpace:
    """Coordinates of the search: logarithms of the sizes of K parameters. The signs stay as they are.

    start: (P,), parameters at the start; those that are not in ``places`` stay constant; places: (K,), places of the
    parameters in the search; sign: (K,), sign of each parameter in the search; smallest, largest: (K,), bounds of the
    coordinates.
    """

    start: Array
    places: Ints
    sign: Array
    smallest: Array
    largest: Array

    @property
    def x(self) -> Array:
        """Coordinates (K,) of the start, within the bounds."""
        return np.asarray(np.clip(np.log(np.abs(self.start[self.places])), self.smallest, self.largest))

    def parameters(self, x: Array) -> Array:
        """Return all parameters (P,) at the coordinates x (K,)."""
        moved = self.start.copy()
        moved[self.places] = self.sign * np.exp(x)
        return moved

    def derivatives(self, parameters: Array, gradient: Array, information: Array) -> tuple[Array, Array]:
        """Convert derivatives by the parameters to derivatives by the coordinates.

        parameters: (P,), parameters at which the derivatives hold; gradient: (P,), gradient by the parameters;
        information: (P, P), information by the parameters. Returns gradient: (K,), gradient by the coordinates;
        information: (K, K), information by the coordinates.
        """
        scale = parameters[self.places]
        block = information[np.ix_(self.places, self.places)]
        return gradient[self.places] * scale, block * np.outer(scale, scale)


def log_space(start: Array, places: Ints, lower: Array, upper: Array) -> LogSpace:
    """Return the coordinates of a search.

    start: (P,), parameters at the start; places: (K,), places of the parameters in the search; lower, upper: (P,),
    smallest sizes, and upper bounds; the declared bounds hold too.
    """
    sign = np.sign(start[places])
    low, high = (np.array([getattr(PARAMETERS[k], side) for k in places]) for side in ("lower", "upper"))
    high = np.minimum(high, upper[places])
    smallest = np.log(np.maximum(np.where(sign > 0.0, low, -high), lower[places]))
    largest = np.log(np.maximum(np.where(sign > 0.0, high, -low), lower[places]))
    return LogSpace(start=start, places=places, sign=sign, smallest=smallest, largest=largest)


#: Longest step of a logarithm.
LONGEST = 0.7
# Maximum number of steps of a search.
_STEPS = 60


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
        """Return the damping after a step.

        damping: (...), damping before the step; better, worse: (...), whether the step gained or failed; neither if no
        step was tried. Returns (...), damping after the step.
        """
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
    """A point of a search.

    x: (K,), coordinates; value: value of the function; gradient: (K,), gradient by the coordinates; information: (K,
    K), information by the coordinates; scored: what the caller wants to keep with the point.
    """

    x: Array
    value: float
    gradient: Array
    information: Array
    scored: Any


def search(at: Callable[[Array, Point | None], Point | None], space: LogSpace, enough: float) -> Point:
    """Maximise a function of the parameters of one driver."""
    here, damping = at(space.x, None), _ALONE.start
    if here is None:
        raise ValueError("the search needs a point to begin with")
    for _ in range(_STEPS):
        x, gradient = here.x, here.gradient
        free = ~(((x <= space.smallest) & (gradient < 0.0)) | ((x >= space.largest) & (gradient > 0.0)))
        if not free.any():
            break
        change = np.zeros_like(x)
        change[free] = damped_step(here.information[np.ix_(free, free)], gradient[free], damping, 1e-9)
        if 0.5 * float(gradient @ change) < enough or damping > _ALONE.most:
            break
        there = at(np.clip(x + limited(change, LONGEST), space.smallest, space.largest), here)
        is_better = there is not None and there.value > here.value
        here = there if there is not None and is_better else here
        damping = float(_ALONE.updated(damping, is_better, not is_better))
    return here
