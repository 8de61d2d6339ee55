"""Where the search for one driver's parameters may go, and the logarithms in which it goes there."""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import PARAMETERS, V_STAR
from sugiyama_ros.filters import paper
from sugiyama_ros.trajectories.trajectories import Trajectories

# A desired speed [m/s] above this is not searched for, unless the data show at least half of it: below about half the
# desired speed the reward phi1 turns convex, and data of slow driving do not hold v* (Sugiyama's vehicle 21).
_FASTEST = 30.0
# No parameter is searched for below this, in its own unit.
_SMALLEST = 1e-3


def upper_bounds(trajectories: Trajectories) -> Array:
    """Upper bounds (P,) of the search; the bound of v* follows the speeds in the data."""
    upper = np.array([p.upper for p in PARAMETERS])
    speed = paper.smoothed_speed(trajectories.road.unwrap(trajectories.position_m), 2, trajectories.period_s)
    upper[V_STAR] = min(upper[V_STAR], max(_FASTEST, 2.0 * float(np.nanquantile(speed, 0.99))))
    return upper


@dataclass(frozen=True, eq=False)
class LogSpace:
    """Logarithms x (K,) of the sizes of the parameters at ``places``; the signs stay as they are.

    start: (P,) parameters, of which those elsewhere are kept; sign: (K,); smallest, largest: (K,) bounds of x.
    """

    start: Array
    places: Ints
    sign: Array
    smallest: Array
    largest: Array

    @property
    def x(self) -> Array:
        """Where the search starts, within the bounds."""
        return np.asarray(np.clip(np.log(np.abs(self.start[self.places])), self.smallest, self.largest))

    def parameters(self, x: Array) -> Array:
        """Parameters (P,) at x."""
        moved = self.start.copy()
        moved[self.places] = self.sign * np.exp(x)
        return moved

    def derivatives(self, parameters: Array, gradient: Array, information: Array) -> tuple[Array, Array]:
        """Gradient (K,) and information (K, K) by x, from those by all parameters, (P,) and (P, P)."""
        scale = parameters[self.places]
        block = information[np.ix_(self.places, self.places)]
        return gradient[self.places] * scale, block * np.outer(scale, scale)


def log_space(start: Array, places: Ints, upper: Array) -> LogSpace:
    """The logarithms searched from ``start`` (P,), up to ``upper`` (P,)."""
    sign = np.sign(start[places])
    low, high = (np.array([getattr(PARAMETERS[k], side) for k in places]) for side in ("lower", "upper"))
    high = np.minimum(high, upper[places])
    smallest = np.log(np.maximum(np.where(sign > 0.0, low, -high), _SMALLEST))
    largest = np.log(np.maximum(np.where(sign > 0.0, high, -low), _SMALLEST))
    return LogSpace(start=start, places=places, sign=sign, smallest=smallest, largest=largest)
