"""How smooth positions are, what to estimate then, and which samples count.

The model keeps the position noise and the speed noise at the paper's values, which suit the positions of a camera above
a ring. Positions from satellites, or positions that were smoothed, move more evenly than these noises alone would let
them. A filter with the fixed noises then believes neither its measurements nor its own errors.

The third differences of positions show it: they are large where noise is, and small where a vehicle moves by itself.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import (
    LEAST_NOISE,
    REFERENCE_PERIOD_S,
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
from sugiyama_ros.trajectories.dense import DenseTracks

#: The parameters that the paper estimates; section 4.1.
ESTIMATED = ("sigma_nu", "sigma_a", "v_star", "kappa_v")
#: The parameters that are estimated as well where positions are smooth.
FREED = ("sigma_x", "sigma_v")
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
    """How evenly the vehicles of a recording move: std of the third differences [m], NaN if unknown; period [s].

    has_other_noises: whether the fixed noises do not suit the vehicles, although their positions are not smooth.
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
        """Return a driver of the population (P,), with noises and a desired speed that suit the recording.

        Where positions are smooth, each of three noises makes a third of the third differences' variance. Where the
        fixed noises do not suit the vehicles for another reason, all noises are in proportion. A driver far above the
        desired speed hardly says how much too small it is, so it starts above the high ``speed`` in the data [m/s].
        """
        driver = population()
        driver[V_STAR] = desired_speed_above(speed, float(driver[V_STAR]))
        if not self.is_smooth:
            # vehicles that stand still show no noise to be in proportion to
            is_other = self.has_other_noises and np.isfinite(self.roughness_m)
            return in_proportion(driver, self.roughness_m, self.period_s) if is_other else driver
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
    """Return how evenly vehicles move, from each one's continuous positions (T,) [m]."""
    found = []
    for one in positions:
        third = np.abs(np.diff(one, n=3))
        moving = third[np.isfinite(third) & (third > 0.0)]
        if len(moving) >= _FEWEST:
            found.append(roughness(moving))
    return Evenness(float(np.median(found)) if found else float("nan"), period_s)


def smoothing_window(positions: Iterable[Array], period_s: float) -> int:
    """Return over how many samples somebody has smoothed positions, from each vehicle's continuous ones (T,) [m].

    Third differences of unsmoothed positions are correlated over three samples at most. A smoother adds correlation up
    to the width of its window and a little more.
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


def evenness(trajectories: DenseTracks) -> Evenness:
    """Return how evenly the vehicles of a recording move."""
    return evenness_of(trajectories.road.unwrap(trajectories.position_m).T, trajectories.period_s)


# Longest time [s] between samples of smoothed positions. Where samples are further apart, the filter knows too little
# of what drivers saw in between to tell what moved them.
_LONGEST_APART_S = 0.8
# Longest period [s] that one step of the model covers.
_LONGEST_STEP_S = 0.5
# Distance between samples of smoothed positions, over the window.
_OF_WINDOW = 0.75
#: Periods that differ by less than this part are equal.
ROUNDING = 1e-6


def with_short_periods(trajectories: DenseTracks) -> DenseTracks:
    """Return a recording with empty samples in between if its samples are more than 0.5 s apart.

    The driver of the model decides anew at every sample, three times a second in the paper. A camera that keeps one
    picture a second does not make drivers decide less often.
    """
    parts = usual_decisions(trajectories.period_s)
    return trajectories if parts == 1 else divided(trajectories, parts)


def usual_decisions(period_s: float) -> int:
    """Return how often the model's drivers decide from one sample to the next, if the samples do not say it."""
    return 1 if period_s <= _LONGEST_STEP_S * (1.0 + ROUNDING) else round(period_s / REFERENCE_PERIOD_S)


def divided(trajectories: DenseTracks, parts: int) -> DenseTracks:
    """Return a recording with empty samples that divide its period."""
    samples, vehicles = trajectories.position_m.shape
    position = np.full((parts * (samples - 1) + 1, vehicles), np.nan)
    position[::parts] = trajectories.position_m
    return replace(trajectories, position_m=position, period_s=trajectories.period_s / parts)


def apart_if_smoothed(window: int, even: Evenness) -> int:
    """Return the number of periods from one sample that counts to the next, if somebody has smoothed the positions.

    Rounding hides a smoother from ``smoothing_window``, but such positions still move more evenly than the noises of
    the model let them.
    """
    longest_s = _LONGEST_APART_S if window else _LONGEST_STEP_S
    longest = max(1, math.floor(longest_s * (1.0 + ROUNDING) / even.period_s))
    if window:
        return min(math.ceil(_OF_WINDOW * window), longest)
    return longest if even.is_smooth else 1


def thinned(position_m: Array, every: int) -> Array:
    """Return positions (T, ...) of which only one sample in so many is known."""
    known = np.full_like(position_m, np.nan)
    known[::every] = position_m[::every]
    return known


def smoothed_alike(present: Mask, ends: int) -> Mask:
    """Return whether samples (N, T) are as smooth as all others: at the ends of a record, smoothers have half a window.

    Where a vehicle is not recorded they are not, unless ``ends`` is 0.
    """
    since, until = np.cumsum(present, axis=1), np.cumsum(present[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((since > ends) & (until > ends) | (ends == 0))


def measured_every(trajectories: DenseTracks) -> int:
    """Return the number of periods from one sample in which somebody is measured to the next, for ``measured``."""
    return max(1, int(np.gcd.reduce(np.flatnonzero(np.isfinite(trajectories.position_m).any(axis=1)))))


def measured(trajectories: DenseTracks) -> DenseTracks:
    """Return a recording without its empty samples in between."""
    every = measured_every(trajectories)
    if every == 1:
        return trajectories
    return replace(trajectories, position_m=trajectories.position_m[::every], period_s=every * trajectories.period_s)
