"""Which desired speeds data can tell: a driver who never comes near the desired speed does not tell it."""

import numpy as np

from sugiyama_ros.arrays import Array

# Below about half the desired speed the reward of speed turns convex, so data of slow driving do not determine it
# (Sugiyama's vehicle 21). Up to this speed [m/s] it is looked for all the same.
_FASTEST = 30.0


def largest_v_star(fastest: float) -> float:
    """Return the largest desired speed [m/s] that data can tell in which nobody is faster than ``fastest`` [m/s]."""
    return max(_FASTEST, 2.0 * fastest)


def known_only(v_star: Array, std: Array, fastest: float) -> tuple[Array, Array]:
    """Return desired speeds and their standard deviations [m/s], NaN where they are beyond what the data can tell."""
    known = ~(v_star > largest_v_star(fastest))
    return np.where(known, v_star, np.nan), np.where(known, std, np.nan)
