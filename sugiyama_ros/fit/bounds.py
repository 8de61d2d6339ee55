"""Bounds of the search for one driver's parameters, and the logarithms that the search changes."""

from dataclasses import dataclass

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
