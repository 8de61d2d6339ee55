"""The first look at a driver's positions: are they smoother than the noises with which the filter starts?

A filter that starts with the noises of a camera knows smooth positions much worse than they are, and learns next to
nothing from them. Its noises cannot find the way by themselves, because the position noise and the speed noise are not
learnt. So the third differences of the first seconds decide with which noises a filter starts: they are large where
noise is, and small where a vehicle moves by itself.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import (
    REFERENCE_PERIOD_S,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    V_STAR,
    at_period,
)
from sugiyama_ros.road import Road

#: No vehicle behind.
NOBODY = (math.nan, -1, 0.0)
#: Places of the standard deviations of noises among the parameters; rho, a correlation, is none.
SIGMAS = [SIGMA_NU, SIGMA_A, SIGMA_X, SIGMA_V]
#: Places of the noises with which a filter starts anew.
SMOOTHED = [SIGMA_NU, SIGMA_X, SIGMA_V]
# Third differences of a look, and samples that are kept.
_ENOUGH, _KEPT = 25, 64
# Part of the third differences' std that the position noise and the speed noise make up: next to nothing. What
# drivers on smooth positions do, the acceleration noise alone explains best.
_REST = 0.1
# Time [s] over which the speed is measured.
_SPEED_OVER_S = 1.0
#: Variance of a third difference, in variances of white noise, of the position noise and of the speed noise (times the
#: squared period): sums of squares of the coefficients of the third, the second and the first difference.
WHITE, _OF_POSITION, _OF_SPEED = (float(math.comb(2 * k, k)) for k in (3, 2, 1))
#: Smallest std of third differences [m]: less is the rounding of the numbers.
LEAST = 1e-5
# A speed is far above the desired speed by this factor; the desired speed is then slightly above it.
_FAR_ABOVE, _SLIGHTLY_ABOVE = 1.5, 1.1
#: Scale of the normal distribution over the median of its absolute values.
PER_MEDIAN = 1.4826
# Times between samples [s] that differ from whole periods by less than this count as whole periods.
_EXACT_S = 1e-6


def steps_between(elapsed_s: float, period_s: float) -> tuple[int, float]:
    """Return in how many steps a filter goes over a time, and how many periods each of them takes.

    elapsed_s: time [s] from one sample to the next, above 0; period_s: period of the model [s].
    """
    steps = max(1, round(elapsed_s / period_s))
    exact = abs(elapsed_s - steps * period_s) < _EXACT_S
    return steps, 1.0 if exact else elapsed_s / (steps * period_s)


def roughness(third: Array) -> float:
    """Return the std [m] of third differences, from their absolute values (n,); spikes do not move it."""
    return PER_MEDIAN * float(np.median(third))


def roughness_of_noises(row: Array, period_s: float) -> float:
    """Return the std [m] of third differences that position noise and speed noise alone make.

    row: (P,), the driver's parameters at the reference period; period_s: time between two samples [s].
    """
    there = at_period(row, period_s)
    return math.sqrt(_OF_POSITION * float(there[SIGMA_X]) ** 2 + _OF_SPEED * (period_s * float(there[SIGMA_V])) ** 2)


def with_smooth_noises(row: Array, white_m: float, rest_m: float, period_s: float) -> Array:
    """Return a row with noises that make third differences of a given size.

    row: (P,), the driver's parameters at the reference period; white_m: std [m] of the third differences that the
    measurement noise makes; rest_m: std [m] of the third differences that the position noise makes, and the speed noise
    at most: it does not grow; period_s: time between two samples [s].
    """
    start, scale = row.copy(), math.sqrt(period_s / REFERENCE_PERIOD_S)
    start[SIGMA_NU] = white_m / math.sqrt(WHITE)
    start[SIGMA_X] = rest_m / math.sqrt(_OF_POSITION) / scale
    start[SIGMA_V] = min(rest_m / math.sqrt(_OF_SPEED) / period_s / scale, row[SIGMA_V])
    return start


def in_proportion(row: Array, roughness_m: float, period_s: float) -> Array:
    """Return a row whose noises are smaller or larger in proportion, so that they make third differences of a size.

    row: (P,), the driver's parameters at the reference period; roughness_m: std [m] of the third differences; period_s:
    time between two samples [s].
    """
    start = row.copy()
    start[SIGMAS] *= roughness_m / math.hypot(math.sqrt(WHITE) * row[SIGMA_NU], roughness_of_noises(row, period_s))
    return start


def desired_speed_above(speed: float, desired: float) -> float:
    """Return a desired speed [m/s] to start from, for a driver who has driven at a speed [m/s].

    A driver far above a desired speed hardly says how much too small it is.
    """
    return _SLIGHTLY_ABOVE * speed if speed > _FAR_ABOVE * desired else desired


class ChainStep(NamedTuple):
    """What ``OnlineFilter.step`` takes in."""

    position_m: Sequence[float]
    identity: Sequence[int]
    length_m: Sequence[float]
    time_s: float
    behind: tuple[float, int, float]
    elapsed_s: float | None
    lines: Sequence[float]


@dataclass(eq=False)
class FirstLook:
    """Looks at the positions of a vehicle until it knows how smooth they are.

    road: the road; period_s: time between two samples [s]; samples: the latest samples.
    """

    road: Road
    period_s: float
    samples: deque[ChainStep] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _row: list[float] = field(default_factory=list)
    _third: list[float] = field(default_factory=list)

    def take_in(self, sample: ChainStep) -> None:
        """Take in the next sample."""
        self.samples.append(sample)
        position_m, elapsed_s = sample.position_m[0], sample.elapsed_s
        if math.isnan(position_m):
            self._row.clear()
            return
        if elapsed_s is not None and steps_between(elapsed_s, self.period_s) != (1, 1.0):
            self._row.clear()
        row = self._row
        row.append(
            row[-1] + float(self.road.difference(np.array(position_m), np.array(row[-1]))) if row else position_m
        )
        if len(row) > self._most:
            del row[0]
        if len(row) > 3:
            third = abs(row[-1] - 3.0 * row[-2] + 3.0 * row[-3] - row[-4])
            # a vehicle that stands still says nothing
            if third > 0.0:
                self._third.append(third)

    def copied(self) -> "FirstLook":
        """Return a look that has seen the same. The samples are shared: nobody changes them."""
        return replace(self, samples=self.samples.copy(), _row=self._row.copy(), _third=self._third.copy())

    @property
    def is_over(self) -> bool:
        """Whether it has seen enough."""
        return len(self._third) >= _ENOUGH

    def start(self, row: Array) -> Array | None:
        """Return with what a filter should start that has started with a row.

        row: (WIDTH,), the driver's row at the reference period. Returns (WIDTH,), the row with noises and a desired
        speed that suit the positions; none if they are not smooth.
        """
        rough = roughness(np.array(self._third))
        if rough >= roughness_of_noises(row, self.period_s):
            return None
        rough = max(rough, LEAST)
        start = with_smooth_noises(row, rough, _REST * rough, self.period_s)
        start[V_STAR] = desired_speed_above(self._speed, float(row[V_STAR]))
        return start

    @property
    def _most(self) -> int:
        """Positions that are kept: those of a second, and enough for a third difference."""
        return max(4, 1 + round(_SPEED_OVER_S / self.period_s))

    @property
    def _speed(self) -> float:
        """Speed [m/s] over the latest positions."""
        steps = len(self._row) - 1
        return (self._row[-1] - self._row[0]) / (steps * self.period_s) if steps > 0 else 0.0
