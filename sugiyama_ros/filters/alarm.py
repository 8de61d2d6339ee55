"""Alarm when a driver has changed their style: a jump of one of the parameters that a filter adapts.

A jump leaves its signature in all later innovations (Willsky and Jones 1976). A likelihood ratio says how much better a
jump of unknown size explains them than no jump. The sum of the ratios over all onsets (Shiryaev and Roberts) grows by
one with each onset in the mean if nothing ever changes. An alarm at a sum of A therefore comes by chance after A onsets
in the mean, at the soonest.

That promise holds for white innovations. Where the model is wrong, innovations follow one another, and sums of them are
larger than the model says. Sums over blocks of time tell by how much, and the ratio allows for it.
"""

import math
from typing import NamedTuple

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.filters.state import Linearised, State
from sugiyama_ros.jit import kernel

# Time [s] from one possible onset to the next, and how long one is watched; before that time, no alarm is given.
_ONSET_S, _WATCHED_S = 2.0, 30.0
# Mean time [s] between two false alarms of a driver, at least, where the model is right.
_BETWEEN_FALSE_S = 7200.0
# Prior variance of a jump of a logarithm.
_JUMP_VAR = 0.15**2
# Normalised innovation beyond which a sample tells no more: one gross error is no change of style.
_LARGEST = 3.5
# Time [s] of a block of innovations, and time over which blocks count.
_BLOCK_S, _BLOCKS_S = 2.0 * _ONSET_S, 100.0
# Standard errors by which the blocks must exceed what white innovations make of them.
_SURE = 2.0
# Entries of ``Alarm.colour``.
_BLOCK, _KEPT, _QUIET, _SAMPLES, _SUM, _BLOCKS, _SQUARES = range(7)


def onsets_for(period_s: float) -> tuple[int, int]:
    """Return periods from one onset to the next, and number of onsets that are watched."""
    every = max(1, round(_ONSET_S / period_s))
    return every, max(1, round(_WATCHED_S / (every * period_s)))


class Alarm(NamedTuple):
    """Watches the innovations of a filter for jumps of the last entries of its state.

    It has C columns, one for each onset and entry, the entries of an onset side by side; C = 0 where no parameter is
    adapted. signature, moved: (N, C), the second is overwritten; known, seen: (C,); threshold: (1,); every: (1,)
    periods from one onset to the next; periods: (1,) since the alarm began; onsets: (1,) their number; colour: (7,),
    samples in a block, what is kept of the sums in a block, samples without an alarm at first; then the number of
    samples, the sum in this block, the number of blocks with forgetting, and the sum of their squares.
    """

    signature: Array
    moved: Array
    known: Array
    seen: Array
    threshold: Array
    every: Array
    periods: Array
    onsets: Ints
    colour: Array

    def begin(self, period_s: float) -> None:
        """Put in how the alarm is given."""
        every, _ = onsets_for(period_s)
        self.every[0], self.threshold[0] = every, _BETWEEN_FALSE_S / (every * period_s)
        block = max(1, round(_BLOCK_S / period_s))
        self.colour[:3] = block, math.exp(-block * period_s / _BLOCKS_S), _WATCHED_S / period_s


@kernel(allocates=False)
def reset_alarm(alarm: Alarm) -> None:
    """Begin anew, without the past innovations."""
    alarm.periods[0] = 0.0
    alarm.onsets[0] = 0
    alarm.signature[:] = 0.0
    alarm.known[:] = 0.0
    alarm.seen[:] = 0.0


@kernel(allocates=False)
def predict_alarm(alarm: Alarm, linearised: Linearised, first: int, periods: float) -> None:
    """Go on by some periods with the filter's F; first: of the entries of the state that may jump, the last ones."""
    signature, moved = alarm.signature, alarm.moved
    size, columns = signature.shape
    for i in range(size):
        moved[i] = 0.0
        for c in range(linearised.counts[i]):
            k = linearised.columns[i, c]
            factor = linearised.jacobian[i, k]
            for j in range(columns):
                moved[i, j] += factor * signature[k, j]
    for i in range(size):
        for j in range(columns):
            signature[i, j] = moved[i, j]
    if alarm.periods[0] >= alarm.onsets[0] * alarm.every[0]:
        jumps = size - first
        oldest = alarm.onsets[0] * jumps % columns
        alarm.onsets[0] += 1
        for j in range(jumps):
            signature[:, oldest + j] = 0.0
            signature[first + j, oldest + j] = 1.0
            alarm.known[oldest + j] = alarm.seen[oldest + j] = 0.0
    alarm.periods[0] += periods


@kernel(allocates=False)
def observe(alarm: Alarm, innovation: float, variance: float) -> None:
    """Take in the driver's own innovation [m] and its variance, before the filter is updated with it."""
    std = math.sqrt(variance)
    normal = min(max(innovation / std, -_LARGEST), _LARGEST)
    _add_up(alarm.colour, normal)
    excess = excess_of(alarm.colour)
    weighted, certain = normal / (std * excess), 1.0 / (variance * excess)
    signature = alarm.signature[0]
    for j in range(len(signature)):
        alarm.known[j] += signature[j] * signature[j] * certain
        alarm.seen[j] += signature[j] * weighted


@kernel(allocates=False)
def _add_up(colour: Array, normal: float) -> None:
    """Add a normalised innovation to the sum of its block."""
    colour[_SAMPLES] += 1.0
    colour[_SUM] += normal
    if colour[_SAMPLES] % colour[_BLOCK] == 0.0:
        colour[_BLOCKS] = colour[_KEPT] * colour[_BLOCKS] + 1.0
        colour[_SQUARES] = colour[_KEPT] * colour[_SQUARES] + colour[_SUM] * colour[_SUM] / colour[_BLOCK]
        colour[_SUM] = 0.0


@kernel(allocates=False)
def excess_of(colour: Array) -> float:
    """Return the variance of a sum of innovations, over the variance that it has if they are white; at least 1."""
    if colour[_BLOCKS] == 0.0:
        return 1.0
    excess: float = colour[_SQUARES] / colour[_BLOCKS] - _SURE * math.sqrt(2.0 / colour[_BLOCKS])
    return max(1.0, excess)


@kernel(allocates=False)
def update_alarm(alarm: Alarm, gain: Array, factor: float, measured: int) -> None:
    """After the filter's update with entry ``measured`` of its state; gain: (N,), factor: entry of H."""
    signature = alarm.signature
    size, columns = signature.shape
    row = alarm.moved[0]
    for j in range(columns):
        row[j] = factor * signature[measured, j]
    for i in range(size):
        for j in range(columns):
            signature[i, j] -= gain[i] * row[j]


@kernel(allocates=False)
def check_style(alarm: Alarm, state: State, first: int) -> tuple[float, float]:
    """Correct the state if the alarm is given; returns which entry from ``first`` on has jumped, or -1, and how far.

    The sum of the likelihood ratios is only worked out if it may reach the threshold.
    """
    if alarm.colour[_SAMPLES] < alarm.colour[_QUIET]:
        return -1.0, 0.0
    known, seen = alarm.known, alarm.seen
    columns, jumps = len(known), len(state.mean) - first
    largest = 0.0
    for j in range(columns):
        largest = max(largest, seen[j] * seen[j] / (known[j] + 1.0 / _JUMP_VAR))
    enough = alarm.threshold[0] * jumps
    if columns * math.exp(min(0.5 * largest, 700.0)) < enough:
        return -1.0, 0.0
    total, best, likeliest = 0.0, -math.inf, 0
    for j in range(columns):
        certain = known[j] + 1.0 / _JUMP_VAR
        ratio = 0.5 * seen[j] * seen[j] / certain - 0.5 * math.log(certain * _JUMP_VAR)
        total += math.exp(min(ratio, 700.0))
        if ratio > best:
            best, likeliest = ratio, j
    if total < enough:
        return -1.0, 0.0
    certain = known[likeliest] + 1.0 / _JUMP_VAR
    jump, signature = seen[likeliest] / certain, alarm.signature[:, likeliest]
    for i in range(len(state.mean)):
        state.mean[i] += jump * signature[i]
        for j in range(len(state.mean)):
            state.covariance[i, j] += signature[i] * signature[j] / certain
    reset_alarm(alarm)
    return float(likeliest % jumps), jump
