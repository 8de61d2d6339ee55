"""What a driver intends, sample by sample: one filter for each goal, and Bayes' rule between them."""

import math
from typing import Any

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.chain import CHAIN, Adaptation
from sugiyama_ros.filters.online import ADAPT, Estimate, OnlineFilter
from sugiyama_ros.road import Road

# Mean time [s] after which a driver thinks of the goal anew: longer than a driver is usually in view of an exit.
_THINKS_ANEW_S = 300.0


class GoalFilter(OnlineFilter):
    """An `OnlineFilter` of a driver who may have one of several goals, which nobody sees.

    The filter is that of a driver who drives through; another filter follows each further goal. A goal lasts for a
    while, and is then drawn anew. The estimates are those of the likeliest goal.

    period_s, road, parameters, adaptation, vehicles: as for `OnlineFilter`; goals: (G, width), entries of a driver's
    row that each goal sets, 0 for the others; those of the first one are all 0; share: (G,), share of the drivers who
    have each goal; goal_probability: (G,), of each goal now.

    References
    ----------
    Models that switch: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation (2001), section 11.6.
    """

    def __init__(
        self,
        period_s: float,
        road: Road,
        parameters: Array,
        goals: Array,
        share: Array,
        adaptation: Adaptation = ADAPT,
        vehicles: int = CHAIN,
    ) -> None:
        self._goals, self._share = goals, share
        rows = [np.where(goal != 0.0, goal, parameters) for goal in goals[1:]]
        self._others = [OnlineFilter(period_s, road, row, adaptation=adaptation, vehicles=vehicles) for row in rows]
        super().__init__(period_s, road, parameters, adaptation=adaptation, vehicles=vehicles)

    def reset(self) -> None:
        """Forget all samples and everything learnt."""
        super().reset()
        self.goal_probability: Array = self._share.copy()
        for one in self._others:
            one.reset()

    def restart(self) -> None:
        """Forget where the vehicles are, and keep what was learnt of the driver, also of the goal."""
        known = self.goal_probability
        super().restart()
        self.goal_probability = known
        for one in self._others:
            one.restart()

    def change(self, parameters: Array) -> None:
        """Go on with other effects, as in `OnlineFilter.change`."""
        super().change(parameters)
        for goal, one in zip(self._goals[1:], self._others, strict=True):
            one.change(np.where(goal != 0.0, goal, parameters))

    def saved(self) -> Any:
        """Return all that the filter knows now, for ``restore``."""
        return super().saved(), self.goal_probability.copy(), [one.saved() for one in self._others]

    def restore(self, saved: Any) -> None:
        """Go back to what ``saved`` has returned. ``change`` must not have been called since."""
        own, probability, others = saved
        super().restore(own)
        self.goal_probability = probability.copy()
        for one, known in zip(self._others, others, strict=True):
            one.restore(known)

    def step(self, *sample: Any, **more: Any) -> Estimate:
        """Go on in time and take in a sample, as in `OnlineFilter.step`."""
        elapsed_s = more.get("elapsed_s", sample[5] if len(sample) > 5 else None)
        stays = math.exp(-(self.period_s if elapsed_s is None else elapsed_s) / _THINKS_ANEW_S)
        self.goal_probability = stays * self.goal_probability + (1.0 - stays) * self._share
        estimates = [super().step(*sample, **more), *(one.step(*sample, **more) for one in self._others)]
        # who follows nobody is not told from whoever wants to drive as fast
        is_led = math.isfinite(estimates[0].gap_m)
        if is_led and all(one.scored and math.isfinite(one.log_likelihood) for one in estimates):
            density = np.array([one.log_likelihood for one in estimates])
            both = self.goal_probability * np.exp(density - density.max())
            self.goal_probability = both / both.sum()
        return estimates[int(self.goal_probability.argmax())]
