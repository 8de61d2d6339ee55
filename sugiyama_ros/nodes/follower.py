"""One driver who is followed: what the filter gets of a sample, and where the driver will be."""

from collections import deque
from dataclasses import dataclass
from math import exp, isfinite, isnan, nan
from typing import Any, NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.chain import NO_LINES
from sugiyama_ros.filters.first_look import steps_between
from sugiyama_ros.filters.online import NOBODY, Estimate, Learnt, OnlineFilter
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.qos import DEPTH
from sugiyama_ros.nodes.base.samples import UNKNOWN_LEADER, Sample
from sugiyama_ros.nodes.keeper import Kept
from sugiyama_ros.trajectories.about import LONGEST_M

#: How far ahead [s] a path is predicted, unless asked otherwise.
AHEAD_S = 5.0
#: Vehicles in the chain of a filter that predicts a path: what they do reaches the driver within these seconds.
VEHICLES = 7
# Which entries of lines are times, which pass.
_PASSES = np.array([0.0, 1.0, 1.0, 0.0] * 2)
#: What is published where nothing is known, so that every topic has a message for every step.
UNKNOWN = Estimate(nan, nan, nan, np.full((3, 3), nan), nan, nan, nan, nan, nan, nan, nan, scored=False)


class DivergedError(ArithmeticError):
    """The state of a filter is no number any more."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """States of a driver now and in the next seconds.

    time_s: (K,), times [s] from now on; the first is 0; position_m, speed: (K,), positions [m], not wrapped on a ring,
    and speeds [m/s]; covariance: (K, 2, 2), of positions and speeds.
    """

    time_s: Array
    position_m: Array
    speed: Array
    covariance: Array


class _Past(NamedTuple):
    """A sample that was taken in, and what was known before it."""

    sample: Sample
    filter_: Any
    stamp_ns: int | None
    missing_in_a_row: int
    chain: list[int]
    shift_m: list[float]
    behind: int


class Follower:
    """Brings the filter of one driver to the time of each sample.

    The stamps of the samples say how much time has passed. What the filter knew before each of the last samples is
    kept for a while, so that a late sample can be sorted in.

    period_s: time between two samples [s]; the filter's own period is shorter where drivers decide more often; kept:
    what an earlier run has learnt, from which the filter goes on; counts: numbers of samples by what became of
    them, counted on; window_s: time [s] by which a sample may be late and still be sorted in.
    """

    def __init__(
        self,
        vehicle: int,
        filter_: OnlineFilter,
        period_s: float,
        kept: Kept | None,
        counts: dict[str, int],
        window_s: float,
    ) -> None:
        self.vehicle, self._period_s = vehicle, period_s
        self.filter = filter_
        self._kept = kept
        self._counts = counts
        self._window_ns = round(window_s * NS)
        if kept is not None:
            filter_.recall(kept.learnt)
        #: Stamp [ns] of the last sample.
        self.stamp_ns: int | None = None
        self.missing_in_a_row = 0
        self._chain: list[int] = []
        # what to add to the positions of the chain [m], and the lines of the last sample
        self._shift_m: list[float] = []
        self._lines: tuple[float, ...] = NO_LINES
        self._behind = -1
        self._length_m: dict[int, float] = {}
        self._past: deque[_Past] = deque()
        self._seen: Kept | None = None
        self._unled: Learnt | None = None

    def restart(self) -> None:
        """Forget where the vehicles are, after a jump in time. What was learnt of the driver stays.

        If time has jumped back, samples come that were learnt from already. They are followed, but not learnt again.
        """
        self.filter.restart()
        if self.stamp_ns is not None:
            self._seen = Kept(self.filter.learnt, self.stamp_ns)
        self.stamp_ns = None
        self.missing_in_a_row = 0
        self._chain, self._shift_m, self._lines = [], [], NO_LINES
        self._behind = -1
        self._length_m = {}
        self._past.clear()

    def change(self, effects: Array) -> None:
        """Go on with other effects; see ``OnlineFilter.change``."""
        self.filter.change(effects)
        self._past.clear()

    def follow(self, sample: Sample) -> Estimate:
        """Take in the next sample. Raises DivergedError."""
        self._keep_what_is_known(sample)
        return self._step(sample)

    def sort_in(self, sample: Sample) -> Estimate | None:
        """Take in a sample that is late: go back to its time, and take in all later samples again.

        Raises DivergedError.
        """
        later = [past for past in self._past if past.sample.stamp_ns > sample.stamp_ns]
        if not later or later[0].stamp_ns is None or later[0].stamp_ns >= sample.stamp_ns:
            return None
        for _ in later:
            self._past.pop()
        before = later[0]
        self.filter.restore(before.filter_)
        self.stamp_ns, self.missing_in_a_row = before.stamp_ns, before.missing_in_a_row
        self._chain, self._shift_m, self._behind = before.chain, before.shift_m, before.behind
        counted = self._counts["missing"], self._counts["skipped"]
        estimate = self.follow(sample)
        for past in later:
            self.follow(past.sample)
        self._counts["missing"], self._counts["skipped"] = counted
        return estimate

    def predict(self, now: Estimate, stamp_ns: int, ahead_s: float) -> Prediction:
        """Predict the driver's path from the latest sample on.

        Nothing is known of the preferences of the drivers ahead but their spread over the population. So the filter
        also goes on with each of these preferences one standard deviation lower and higher. What this changes adds to
        the mean and to the covariance, as in a cubature rule: a slower leader slows the driver down, but a faster one
        does not pull. Afterwards, the filter knows what it knew before.
        """
        filter_, saved = self.filter, self.filter.saved()
        path = self._path(now, stamp_ns, ahead_s)
        model, middle = filter_.kalman.model, np.column_stack([path.position_m, path.speed])
        for m in (m for m in range(1, len(self._chain)) if self._chain[m] >= 0):
            for place, std in zip(model.adapted, np.sqrt(model.prior_var).tolist(), strict=True):
                for sign in (-1.0, 1.0):
                    filter_.restore(saved)
                    filter_.kalman.rows[m, place] *= exp(sign * std)
                    other = self._path(now, stamp_ns, ahead_s)
                    off = np.column_stack([other.position_m, other.speed]) - middle
                    path.position_m[:] += 0.5 * off[:, 0]
                    path.speed[:] += 0.5 * off[:, 1]
                    path.covariance[:] += 0.5 * off[:, :, None] * off[:, None, :]
        filter_.restore(saved)
        return path

    def _path(self, now: Estimate, stamp_ns: int, ahead_s: float) -> Prediction:
        """Let the filter go on without samples. Lines stay where they are, and their times pass."""
        filter_, chain = self.filter, self._chain
        length_m = [self._length_m.get(vehicle, 0.0) for vehicle in chain]
        time_s = np.asarray(filter_.period_s * np.arange(round(ahead_s / filter_.period_s) + 1), np.float64)
        states = [now]
        for after_s in time_s[1:].tolist():
            at_s = stamp_ns / NS + after_s
            lines = np.array(self._lines) - after_s * _PASSES
            states.append(filter_.step([nan] * len(chain), chain, length_m, at_s, (nan, -1, 0.0), lines=lines))
        position = np.array([state.position_m for state in states])
        steps: Array = np.diff(position)
        if filter_.road.is_ring:
            lap = filter_.road.circumference_m
            steps -= lap * np.round(steps / lap)
        return Prediction(
            time_s=time_s,
            position_m=position[0] + np.concatenate([[0.0], np.cumsum(steps)]),
            speed=np.array([state.speed for state in states]),
            covariance=np.array([state.covariance[:2, :2] for state in states]),
        )

    def _keep_what_is_known(self, sample: Sample) -> None:
        """Keep what is known before a sample, and forget what is older than any sample may be late."""
        past = self._past
        chain = self._chain, self._shift_m, self._behind
        past.append(_Past(sample, self.filter.saved(), self.stamp_ns, self.missing_in_a_row, *chain))
        # before the first sample of the window comes the sample at which the window may begin
        while len(past) > 1 and past[1].sample.stamp_ns <= sample.stamp_ns - self._window_ns:
            past.popleft()

    def _step(self, sample: Sample) -> Estimate:
        elapsed_s = None if self.stamp_ns is None else (sample.stamp_ns - self.stamp_ns) / NS
        self.stamp_ns = sample.stamp_ns
        if self.vehicle in sample.place:
            self._chain = sample.chain(self.vehicle, self.filter.vehicles)
            self._shift_m = sample.shifts(self._chain)
        if not self._chain:
            self.missing_in_a_row += 1
            return UNKNOWN
        self._note_leader(sample)
        position, length = self._chain_in(sample)
        self.missing_in_a_row = self.missing_in_a_row + 1 if isnan(position[0]) else 0
        self._counts["missing"] += isnan(position[0])
        if elapsed_s is not None:
            self._counts["skipped"] += steps_between(elapsed_s, self._period_s)[0] - 1
        behind, self._lines = self._vehicle_behind(sample), sample.lines(self._chain)
        was_smooth = self.filter.is_smooth
        time_s = sample.stamp_ns / NS
        estimate = self.filter.step(position, self._chain, length, time_s, behind, elapsed_s, self._lines)
        if not isfinite(estimate.speed):
            raise DivergedError("the filter has diverged and starts anew; are its effects and parameters sensible?")
        self._recall_if_known(sample.stamp_ns)
        if estimate.covariance[1, 1] == 0.0:
            # one position says nothing about the speed
            estimate = UNKNOWN._replace(position_m=estimate.position_m)
        if self._unled is None:
            return estimate
        if self.filter.is_smooth != was_smooth:
            # what was learnt before is of noises that do not suit the positions
            self._unled = self.filter.prior if self._kept is None else self._kept.learnt
        self.filter.recall(self._unled)
        return estimate._replace(gap_m=nan, approach_rate=nan, mean_action=nan, scored=False)

    def _note_leader(self, sample: Sample) -> None:
        """Note what was learnt before the leader got out of view: how the driver then drives tells nothing of them."""
        place = sample.place.get(self.vehicle)
        if place is None or sample.leader[place] != UNKNOWN_LEADER:
            self._unled = None
        elif self._unled is None:
            self._unled = self.filter.learnt

    def _recall_if_known(self, stamp_ns: int) -> None:
        """Go back to what was learnt before, if the sample was learnt from already."""
        if self._kept is not None and self._is_known(stamp_ns, self._kept):
            self.filter.recall(self._kept.learnt)
        if self._seen is not None:
            if stamp_ns <= self._seen.until_ns:
                self.filter.recall(self._seen.learnt)
            else:
                self._seen = None

    def _chain_in(self, sample: Sample) -> tuple[list[float], list[float]]:
        """Positions [m] (NaN if missing) and lengths [m] of the vehicle and of those ahead of it."""
        position, length, place_of = [], [], sample.place.get
        for m, vehicle in enumerate(self._chain):
            place, measured = place_of(vehicle), nan
            if place is not None:
                if isfinite(sample.position_m[place]):
                    measured = sample.position_m[place] + self._shift_m[m]
                    if sample.stamp_offset_s:
                        # measured at another time than the sample: where the vehicle is at the time of the sample
                        measured -= sample.stamp_offset_s[place] * self.filter.speed_of(m, vehicle)
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
        shift = sample.leader_shift_m[place] if sample.leader_shift_m else 0.0
        return sample.position_m[place] - shift, self._behind, self._length_m[self._behind]

    def _is_known(self, stamp_ns: int, kept: Kept) -> bool:
        """Whether an earlier run has learnt from the sample: the last samples may be sent once more."""
        return kept.until_ns - DEPTH * self._period_s * NS < stamp_ns <= kept.until_ns
