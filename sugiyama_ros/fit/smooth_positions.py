"""Positions that are smoother than the model's fixed noises: what to estimate then, and where to start.

The model keeps the position noise and the speed noise at the paper's values, which suit the positions of a camera above
a ring. Positions from satellites, or positions that were smoothed, move more evenly than these noises alone would let
them. A filter with the fixed noises then believes neither its measurements nor its own errors.

The third differences of positions show it: they are large where noise is, and small where a vehicle moves by itself.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import (
    LEAST_NOISE,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    V_STAR,
    defaults,
    index,
    population,
)
from sugiyama_ros.filters.first_look import (
    LEAST,
    WHITE,
    desired_speed_above,
    in_proportion,
    roughness,
    roughness_of_noises,
    with_smooth_noises,
)
from sugiyama_ros.trajectories.trajectories import Trajectories

#: The parameters that the paper estimates; section 4.1.
ESTIMATED = ("sigma_nu", "sigma_a", "v_star", "kappa_v")
#: The parameters that are estimated as well where positions are smooth.
FREED = ("sigma_x", "sigma_v")
#: Places of the noises among the parameters.
NOISES = [SIGMA_NU, SIGMA_A, SIGMA_X, SIGMA_V]
# Fewest third differences of a vehicle.
_FEWEST = 8
# Third differences of noise are correlated over three samples. Beyond these, smoothing shows as an autocorrelation
# above this one; over so much time [s] it is looked for.
_OF_NOISE, _CORRELATED, _LONGEST_S = 3, 0.2, 3.0
# It ends where autocorrelations are no longer above this number, or above so many standard errors. Those of an average
# over W samples are 1/3 at W + 1 samples, 1/12 at W + 2 samples, and then 0.
_ENDS, _STDS = 1.0 / 6.0, 3.0
# Third differences beyond so many stds count as this much: spikes tell nothing about smoothing.
_SPIKE = 3.0
# Bound of the noises in a search, as a part of the noise that the positions show.
_PART = 0.01


class Evenness(NamedTuple):
    """How evenly the vehicles of a recording move.

    roughness_m: std of the third differences of the positions [m]; naN if it is not known; period_s: time [s] between
    two samples; has_other_noises: whether the model's fixed noises do not suit the vehicles, although their positions
    are not smooth.
    """

    roughness_m: float
    period_s: float
    has_other_noises: bool = False

    @property
    def is_smooth(self) -> bool:
        """Whether the positions move more evenly than the model's fixed noises alone would let them."""
        return self.roughness_m < roughness_of_noises(defaults(), self.period_s)

    @property
    def frees_noises(self) -> bool:
        """Whether the model's fixed noises are estimated for each driver."""
        return self.is_smooth or self.has_other_noises

    @property
    def smallest_noise(self) -> float:
        """Lower bound of all noises in a search, in their own units."""
        noise = float(np.nanmax([self.roughness_m, LEAST])) / np.sqrt(WHITE)
        return float(np.clip(_PART * noise, LEAST_NOISE, 1e-3))

    def typical(self, speed: float) -> Array:
        """Return a driver of the population, with noises and a desired speed that suit the recording.

        Where positions are smooth, each of three noises makes a third of the third differences' variance. Where the
        fixed noises do not suit the vehicles for another reason, all noises are in proportion. A driver far above the
        desired speed hardly says how much too small it is, so it starts above the speeds in the data.

        speed: high speed in the data [m/s], as ``bounds.fastest`` returns it. Returns (P,), parameters at the reference
        period.
        """
        driver = population()
        driver[V_STAR] = desired_speed_above(speed, float(driver[V_STAR]))
        if not self.is_smooth:
            return in_proportion(driver, self.roughness_m, self.period_s) if self.has_other_noises else driver
        third = max(self.roughness_m, LEAST) / float(np.sqrt(3.0))
        return with_smooth_noises(driver, third, third, self.period_s)

    def estimated(self, formulation: str = "causal") -> tuple[str, ...]:
        """Return the names of the parameters that are estimated unless the user names others."""
        return ESTIMATED + FREED if formulation == "causal" and self.frees_noises else ESTIMATED

    def individual(self, *others: int) -> tuple[int, ...]:
        """Return the places of the noises that each driver has, then ``others``."""
        noises = [index(name) for name in self.estimated() if name.startswith("sigma_")]
        return (*noises, *others)


def evenness_of(positions: Iterable[Array], period_s: float) -> Evenness:
    """Return how evenly vehicles move.

    positions: (T,), continuous positions of each vehicle [m]; naN where missing; period_s: time [s] between two
    samples.
    """
    found = []
    for one in positions:
        third = np.abs(np.diff(one, n=3))
        moving = third[np.isfinite(third) & (third > 0.0)]
        if len(moving) >= _FEWEST:
            found.append(roughness(moving))
    return Evenness(float(np.median(found)) if found else float("nan"), period_s)


def smoothing_window(positions: Iterable[Array], period_s: float) -> int:
    """Return over how many samples somebody has smoothed positions.

    Third differences of unsmoothed positions are correlated over three samples at most. A smoother adds correlation up
    to the width of its window and a little more.

    positions: (T,), continuous positions of each vehicle [m]; naN where missing; period_s: time [s] between two
    samples.
    """
    products = np.zeros(max(0, round(_LONGEST_S / period_s) - _OF_NOISE))
    square, count = 0.0, 0
    for one in positions:
        third = np.diff(one, n=3)
        known = np.isfinite(third)
        if known.sum() < _FEWEST + _OF_NOISE + len(products):
            continue
        most = _SPIKE * roughness(np.abs(third[known]))
        third = np.where(known, np.clip(third, -most, most), 0.0)
        square, count = square + float(third @ third), count + int(known.sum())
        products += [third[k:] @ third[:-k] for k in range(_OF_NOISE + 1, _OF_NOISE + 1 + len(products))]
    if count == 0:
        return 0
    chance = _STDS / math.sqrt(count)
    if not (np.abs(products) > max(_CORRELATED, chance) * square).any():
        return 0
    ends = max(_ENDS, chance)
    return _OF_NOISE + int(np.flatnonzero(np.abs(products) > ends * square)[-1])


def evenness(trajectories: Trajectories) -> Evenness:
    """Return how evenly the vehicles of a recording move."""
    return evenness_of(trajectories.road.unwrap(trajectories.position_m).T, trajectories.period_s)
