"""Alarm when a driver has changed their style: a jump of one of the parameters that a filter adapts.

A jump leaves its signature in all later innovations (Willsky and Jones 1976). A likelihood ratio says how much better a
jump of unknown size explains them than no jump. The sum of the ratios over all onsets (Shiryaev and Roberts) grows by
one with each onset in the mean if nothing ever changes. An alarm at a sum of A therefore comes by chance after A onsets
in the mean, at the soonest.

That promise holds for white innovations. Where the model is wrong, innovations follow one another, and sums of them are
larger than the model says. Sums over blocks of time tell by how much, and the ratio allows for it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints

#: Time [s] from one possible onset to the next, and how long one is watched.
ONSET_S, WATCHED_S = 2.0, 30.0
#: Mean time [s] between two false alarms of a driver, at least, where the model is right.
BETWEEN_FALSE_S = 7200.0
#: Prior standard deviation of a jump of a logarithm.
JUMP_STD = 0.15
#: Normalised innovation beyond which a sample tells no more: one gross error is no change of style.
LARGEST = 3.5
#: Time [s] of a block of innovations, time over which blocks count, and time in which no alarm is given at first.
BLOCK_S, BLOCKS_S, QUIET_S = 4.0, 100.0, 30.0
#: Standard errors by which the blocks must exceed what white innovations make of them.
SURE = 2.0


@dataclass(frozen=True)
class Change:
    """Which of the adapted parameters has jumped, and by how much (its logarithm)."""

    number: int
    jump: float


class StyleAlarm:
    """Watches the innovations of a filter for jumps of some entries of its state.

    places: entries of the state that may jump, (J,); size: number of entries of the state; period_s: time between two
    samples [s].
    """

    def __init__(self, places: Sequence[int], size: int, period_s: float) -> None:
        self._places = list(places)
        self._every = max(1, round(ONSET_S / period_s))
        onsets = max(1, round(WATCHED_S / (self._every * period_s)))
        self._threshold = BETWEEN_FALSE_S / (self._every * period_s)
        self._block, self._quiet = max(1, round(BLOCK_S / period_s)), QUIET_S / period_s
        self._kept = math.exp(-self._block * period_s / BLOCKS_S)
        self._samples, self._sum, self._blocks, self._squares = 0, 0.0, 0.0, 0.0
        # a column for every onset and entry, entries of one onset side by side
        columns = onsets * len(self._places)
        self._signature: Array = np.zeros((size, columns))
        self._known, self._seen = np.zeros(columns), np.zeros(columns)
        self.reset()

    def reset(self) -> None:
        """Begin anew, without the past innovations."""
        self._periods, self._onsets = 0.0, 0
        self._signature[:], self._known[:], self._seen[:] = 0.0, 0.0, 0.0

    def predict(self, jacobian: Array, periods: float = 1.0) -> None:
        """Go on by some periods with the filter's F."""
        self._signature = jacobian @ self._signature
        if self._periods >= self._onsets * self._every:
            jumps = len(self._places)
            first = self._onsets * jumps % len(self._known)
            self._onsets += 1
            oldest = slice(first, first + jumps)
            self._signature[:, oldest] = 0.0
            self._signature[self._places, np.arange(first, first + jumps)] = 1.0
            self._known[oldest], self._seen[oldest] = 0.0, 0.0
        self._periods += periods

    def observe(self, innovation: float, variance: float) -> None:
        """Take in the driver's own innovation [m] and its variance, before the filter is updated with it."""
        std = math.sqrt(variance)
        normal = min(max(innovation / std, -LARGEST), LARGEST)
        self._samples += 1
        self._sum += normal
        if self._samples % self._block == 0:
            self._blocks = self._kept * self._blocks + 1.0
            self._squares = self._kept * self._squares + self._sum * self._sum / self._block
            self._sum = 0.0
        excess, signature = self.excess, self._signature[0]
        self._known += signature * signature / (variance * excess)
        self._seen += signature * (normal / (std * excess))

    def update(self, gain: Array, measured: Ints) -> None:
        """After the filter's update with the entries ``measured`` (m,) of its state; gain: (size, m)."""
        self._signature -= gain @ self._signature[measured]

    @property
    def excess(self) -> float:
        """Variance of a sum of innovations, over the variance that it has if they are white; at least 1."""
        if self._blocks == 0.0:
            return 1.0
        return max(1.0, self._squares / self._blocks - SURE * math.sqrt(2.0 / self._blocks))

    @property
    def ratio(self) -> float:
        """Sum of the likelihood ratios over the onsets, divided by the sum at which the alarm is given."""
        return float(np.exp(self._log_ratios).sum()) / (self._threshold * len(self._places))

    @property
    def _log_ratios(self) -> Array:
        certain = self._known + 1.0 / JUMP_STD**2
        return 0.5 * self._seen**2 / certain - 0.5 * np.log(certain * JUMP_STD**2)

    def check(self, mean: Array, covariance: Array) -> Change | None:
        """Return what has jumped if the alarm is given, and correct the filter's mean and covariance in place."""
        if self._samples < self._quiet or self.ratio < 1.0:
            return None
        column = int(np.argmax(self._log_ratios))
        certain = self._known[column] + 1.0 / JUMP_STD**2
        jump, signature = float(self._seen[column] / certain), self._signature[:, column].copy()
        mean += jump * signature
        covariance += np.outer(signature, signature) / certain
        self.reset()
        return Change(column % len(self._places), jump)
