"""The first look at a driver's positions: are they smoother than the noises with which the filter starts?

A filter that starts with the noises of a camera knows smooth positions much worse than they are, and learns next to
nothing from them. Its noises cannot find the way by themselves, because the position noise and the speed noise are not
learnt. So the third differences of the first seconds decide with which noises a filter starts.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import SIGMA_NU, SIGMA_V, SIGMA_X, V_STAR
from sugiyama_ros.filters.any_time import steps_between
from sugiyama_ros.filters.roughness import (
    LEAST,
    desired_speed_above,
    roughness,
    roughness_of_noises,
    with_smooth_noises,
)
from sugiyama_ros.road import Road

#: No vehicle behind.
NOBODY = (math.nan, -1, 0.0)
#: Places of the noises with which a filter starts anew.
SMOOTHED = [SIGMA_NU, SIGMA_X, SIGMA_V]
# Third differences of a look, and samples that are kept.
_ENOUGH, _KEPT = 25, 64
# Part of the third differences' std that the position noise and the speed noise make up: next to nothing. What
# drivers on smooth positions do, the acceleration noise alone explains best.
_REST = 0.1
# Time [s] over which the speed is measured.
_SPEED_OVER_S = 1.0


class ChainStep(NamedTuple):
    """What ``OnlineFilter.step`` takes in."""

    position_m: Sequence[float]
    identity: Sequence[int]
    length_m: Sequence[float]
    time_s: float
    behind: tuple[float, int, float]
    elapsed_s: float | None


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
        row.append(row[-1] + self._way(row[-1], position_m) if row else position_m)
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

    def _way(self, before_m: float, position_m: float) -> float:
        """Way [m] from one position to the next, the shorter one around a ring."""
        way, lap = position_m - before_m, self.road.circumference_m
        return way - lap * round(way / lap) if lap > 0.0 else way
