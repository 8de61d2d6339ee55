"""Positions that are smoother than the model's fixed noises: what to estimate then, and where to start.

The model keeps the position noise and the speed noise at the paper's values, which suit the positions of a camera above
a ring. Positions from satellites, or positions that were smoothed, move more evenly than these noises alone would let
them. A filter with the fixed noises then believes neither its measurements nor its own errors.

The third differences of positions show it: they are large where noise is, and small where a vehicle moves by itself.
"""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import (
    NAMES,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    at_period,
    defaults,
    index,
    population,
)
from sugiyama_ros.trajectories.trajectories import Trajectories

#: The parameters that the paper estimates; section 4.1.
ESTIMATED = ("sigma_nu", "sigma_a", "v_star", "kappa_v")
#: The parameters that are estimated as well where positions are smooth.
FREED = ("sigma_x", "sigma_v")
#: Places of the noises among the parameters.
NOISES = [SIGMA_NU, SIGMA_A, SIGMA_X, SIGMA_V]
# Variance of a third difference, in variances of white noise, of the position noise and of the speed noise (times the
# squared period): sums of squares of the coefficients of the third, the second and the first difference.
_WHITE, _OF_POSITION, _OF_SPEED = 20.0, 6.0, 2.0
# Fewest third differences of a vehicle, and smallest std of the noise [m]: less is the rounding of the numbers.
_FEWEST, _LEAST = 8, 1e-5
# Bound of the noises in a search, as a part of the noise that the positions show.
_PART = 0.01
# Scale of the normal distribution over the median of its absolute values.
_PER_MEDIAN = 1.4826


def roughness(trajectories: Trajectories) -> float:
    """Return the std of the third differences of the positions.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.

    Returns
    -------
    float
        Median over the vehicles [m], from the median of the absolute values, which spikes do not move. Vehicles that
        stand still or are hardly seen do not count; NaN if none is left.
    """
    third = np.abs(np.diff(trajectories.road.unwrap(trajectories.position_m), n=3, axis=0))
    found = []
    for one in third.T:
        moving = one[np.isfinite(one) & (one > 0.0)]
        if len(moving) >= _FEWEST:
            found.append(_PER_MEDIAN * float(np.median(moving)))
    return float(np.median(found)) if found else float("nan")


def are_smooth(trajectories: Trajectories) -> bool:
    """Return whether the positions move more evenly than the model's fixed noises alone would let them."""
    period = trajectories.period_s
    fixed = at_period(defaults(), period)
    expected = _OF_POSITION * fixed[SIGMA_X] ** 2 + _OF_SPEED * (period * fixed[SIGMA_V]) ** 2
    return roughness(trajectories) ** 2 < float(expected)


def estimated_in(trajectories: Trajectories, formulation: str = "causal") -> tuple[str, ...]:
    """Return the names of the parameters that are estimated unless the user names others.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.
    formulation : {"causal", "paper"}
        Likelihood. The paper's keeps the paper's parameters.

    Returns
    -------
    tuple of str
        Names.
    """
    freed = formulation == "causal" and are_smooth(trajectories)
    return ESTIMATED + FREED if freed else ESTIMATED


def individual_in(trajectories: Trajectories, *others: int) -> tuple[int, ...]:
    """Return the places of the noises that each driver has, then ``others``."""
    noises = [index(name) for name in estimated_in(trajectories) if name.startswith("sigma_")]
    return (*noises, *others)


def typical(trajectories: Trajectories) -> Array:
    """Return a driver of the population, with noises that suit the recording.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.

    Returns
    -------
    ndarray, shape (P,)
        Parameters at the reference period: of ``population``, with smaller noises where positions are smooth. Each of
        the three noises then makes a third of the third differences' variance.
    """
    driver = population()
    if not are_smooth(trajectories):
        return driver
    period = trajectories.period_s
    third = max(roughness(trajectories), _LEAST) / np.sqrt(3.0)
    scale = at_period(np.ones(len(NAMES)) * 0.5, period)[SIGMA_X] / 0.5
    driver[SIGMA_NU] = third / np.sqrt(_WHITE)
    driver[SIGMA_X] = third / np.sqrt(_OF_POSITION) / scale
    driver[SIGMA_V] = min(third / np.sqrt(_OF_SPEED) / period / scale, driver[SIGMA_V])
    return driver


def smallest_noise(trajectories: Trajectories) -> float:
    """Return the lower bound of all noises in a search, in their own units."""
    noise = float(np.nanmax([roughness(trajectories), _LEAST])) / np.sqrt(_WHITE)
    return float(min(1e-3, _PART * noise))
