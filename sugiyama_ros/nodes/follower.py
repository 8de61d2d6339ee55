"""Following one driver from sample to sample: what the filter is given, and when it starts anew."""

from math import isfinite, isnan, nan

import numpy as np

from sugiyama_ros.filters.online import NOBODY, Estimate, OnlineFilter
from sugiyama_ros.nodes.base.cdr_messages import LONGEST_M, NS, Sample
from sugiyama_ros.nodes.base.qos import DEPTH
from sugiyama_ros.nodes.saved_state import Kept

#: A prediction over more periods than this means nothing: the filter starts anew.
LONGEST_GAP = 100
# A sample that is late by at most so many periods is left out. A sample from further back says that time has jumped.
_LATE = 3
#: What is published where nothing is known, so that every topic has a message for every step.
UNKNOWN = Estimate(
    position_m=nan,
    speed=nan,
    acceleration=nan,
    covariance=np.full((3, 3), nan),
    mean_action=nan,
    gap_m=nan,
    approach_rate=nan,
    innovation_m=nan,
    innovation_var=nan,
    nis=nan,
    log_likelihood=nan,
    scored=False,
)


class DivergedError(ArithmeticError):
    """The state of a filter is no number any more."""


def new_counts() -> dict[str, int]:
    """What a follower counts, all 0."""
    names = ("samples", "missing", "duplicates", "late", "resets", "skipped", "changes of style")
    return dict.fromkeys(names, 0)


class Follower:
    """Brings the filter of one driver to the time of each sample.

    The stamps of the samples say how many periods have passed. The filter predicts over a step without a position.

    Parameters
    ----------
    vehicle : int
        Number of the driver's vehicle.
    filter_ : OnlineFilter
        The driver's filter.
    kept : Kept or None
        What an earlier run has learnt, from which the filter goes on.
    counts : dict
        Numbers of samples by what became of them. The counts continue from the previous follower's counts.
    """

    def __init__(self, vehicle: int, filter_: OnlineFilter, kept: Kept | None, counts: dict[str, int]) -> None:
        self.vehicle = vehicle
        self.filter = filter_
        self._kept = kept
        self._counts = counts
        if kept is not None:
            filter_.recall(kept.learnt)
        #: Stamp [ns] of the last sample.
        self.stamp_ns: int | None = None
        self.missing_in_a_row = 0
        self._chain: list[int] = []
        self._behind = -1
        self._length_m: dict[int, float] = {}

    def has_jumped(self, stamp_ns: int) -> bool:
        """Whether time has jumped since the last sample: far ahead, or back by more than a sample can be late."""
        return not -_LATE <= self._periods(stamp_ns) <= LONGEST_GAP

    def restart(self) -> None:
        """Forget all samples, after a jump in time."""
        self._counts["resets"] += 1
        self.filter.reset()
        self.stamp_ns = None
        self.missing_in_a_row = 0
        self._chain = []
        self._behind = -1
        self._length_m = {}

    def follow(self, sample: Sample) -> Estimate | None:
        """Take in a sample.

        Returns
        -------
        Estimate or None
            The driver's state after the sample. None for a sample that is left out: it came before, or too late.

        Raises
        ------
        DivergedError
            If the state is no number any more. The filter is of no use then.
        """
        periods = self._periods(sample.stamp_ns)
        if periods <= 0:
            self._counts["late" if periods else "duplicates"] += 1
            return None
        self.stamp_ns = sample.stamp_ns
        self._counts["samples"] += 1
        if self.vehicle in sample.place:
            self._chain = sample.chain(self.vehicle, self.filter.vehicles)
        if not self._chain:
            self.missing_in_a_row += 1
            return UNKNOWN
        position, length = self._chain_in(sample)
        self.missing_in_a_row = self.missing_in_a_row + 1 if isnan(position[0]) else 0
        self._counts["missing"] += isnan(position[0])
        time_s = sample.stamp_ns / NS
        for skipped in range(periods - 1, 0, -1):
            self._counts["skipped"] += 1
            before_s = time_s - skipped * self.filter.period_s
            self.filter.step([nan] * len(position), self._chain, length, before_s, (nan, self._behind, 0.0))
        estimate = self.filter.step(position, self._chain, length, time_s, self._vehicle_behind(sample))
        if not isfinite(estimate.speed):
            raise DivergedError("the filter has diverged and starts anew; are its effects and parameters sensible?")
        if self._kept is not None and self._is_known(sample.stamp_ns, self._kept):
            self.filter.recall(self._kept.learnt)
        return estimate

    def _periods(self, stamp_ns: int) -> int:
        """Periods from the last sample to the stamp; 1 for the first sample."""
        if self.stamp_ns is None:
            return 1
        return round((stamp_ns - self.stamp_ns) / (NS * self.filter.period_s))

    def _chain_in(self, sample: Sample) -> tuple[list[float], list[float]]:
        """Positions [m] (NaN if missing) and lengths [m] of the vehicle and of those ahead of it."""
        position, length, place_of = [], [], sample.place.get
        for vehicle in self._chain:
            place, measured = place_of(vehicle), nan
            if place is not None:
                if isfinite(sample.position_m[place]):
                    measured = sample.position_m[place]
                if 0.0 <= sample.length_m[place] < LONGEST_M:
                    self._length_m[vehicle] = sample.length_m[place]
            position.append(measured)
            length.append(self._length_m.get(vehicle, 0.0))
        return position, length

    def _vehicle_behind(self, sample: Sample) -> tuple[float, int, float]:
        """Position [m], number and length [m] of the vehicle behind, if the effects need it."""
        if not self.filter.looks_back:
            return NOBODY
        if self.vehicle in sample.place:
            self._behind = sample.behind(self.vehicle)
        place = sample.place.get(self._behind)
        if place is None:
            return nan, self._behind, self._length_m.get(self._behind, 0.0)
        self._length_m[self._behind] = sample.known_length_m(place)
        return sample.position_m[place], self._behind, self._length_m[self._behind]

    def _is_known(self, stamp_ns: int, kept: Kept) -> bool:
        """Whether an earlier run has learnt from the sample: a late subscriber gets the last samples once more."""
        return kept.until_ns - DEPTH * self.filter.period_s * NS < stamp_ns <= kept.until_ns
