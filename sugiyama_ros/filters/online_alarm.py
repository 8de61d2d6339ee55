"""The alarm of a change of style in the compiled online filter: what ``alarm`` does, without new arrays.

``alarm`` explains the method and gives its sources.
"""

import math

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.alarm import JUMP_STD, LARGEST, SURE
from sugiyama_ros.filters.online_state import (
    BLOCK,
    BLOCKS,
    CHANGED,
    JUMP,
    KEPT,
    QUIET,
    SAMPLES,
    SQUARES,
    SUM,
    Alarm,
)
from sugiyama_ros.filters.state import Linearised, State
from sugiyama_ros.jit import kernel

_JUMP_VAR = JUMP_STD**2


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
    normal = min(max(innovation / std, -LARGEST), LARGEST)
    excess = _excess(alarm.colour, normal)
    weighted, certain = normal / (std * excess), 1.0 / (variance * excess)
    signature = alarm.signature[0]
    for j in range(len(signature)):
        alarm.known[j] += signature[j] * signature[j] * certain
        alarm.seen[j] += signature[j] * weighted


@kernel(allocates=False)
def _excess(colour: Array, normal: float) -> float:
    """Take in a normalised innovation, and return ``alarm.StyleAlarm.excess``."""
    colour[SAMPLES] += 1.0
    colour[SUM] += normal
    if colour[SAMPLES] % colour[BLOCK] == 0.0:
        colour[BLOCKS] = colour[KEPT] * colour[BLOCKS] + 1.0
        colour[SQUARES] = colour[KEPT] * colour[SQUARES] + colour[SUM] * colour[SUM] / colour[BLOCK]
        colour[SUM] = 0.0
    if colour[BLOCKS] == 0.0:
        return 1.0
    excess: float = colour[SQUARES] / colour[BLOCKS] - SURE * math.sqrt(2.0 / colour[BLOCKS])
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
def check_style(alarm: Alarm, state: State, first: int, result: Array) -> None:
    """Correct the state if the alarm is given, and put down which entry from ``first`` on has jumped, and by how much.

    The sum of the likelihood ratios is only worked out if it may reach the threshold.
    """
    if alarm.colour[SAMPLES] < alarm.colour[QUIET]:
        return
    known, seen = alarm.known, alarm.seen
    columns, jumps = len(known), len(state.mean) - first
    largest = 0.0
    for j in range(columns):
        largest = max(largest, seen[j] * seen[j] / (known[j] + 1.0 / _JUMP_VAR))
    enough = alarm.threshold[0] * jumps
    if columns * math.exp(min(0.5 * largest, 700.0)) < enough:
        return
    total, best, likeliest = 0.0, -math.inf, 0
    for j in range(columns):
        certain = known[j] + 1.0 / _JUMP_VAR
        ratio = 0.5 * seen[j] * seen[j] / certain - 0.5 * math.log(certain * _JUMP_VAR)
        total += math.exp(min(ratio, 700.0))
        if ratio > best:
            best, likeliest = ratio, j
    if total < enough:
        return
    certain = known[likeliest] + 1.0 / _JUMP_VAR
    jump, signature = seen[likeliest] / certain, alarm.signature[:, likeliest]
    for i in range(len(state.mean)):
        state.mean[i] += jump * signature[i]
        for j in range(len(state.mean)):
            state.covariance[i, j] += signature[i] * signature[j] / certain
    result[CHANGED], result[JUMP] = likeliest % jumps, jump
    reset_alarm(alarm)
