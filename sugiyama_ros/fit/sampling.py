"""Samples in which somebody is measured, and empty samples between measurements that are far apart.

The driver of the model decides anew at every sample, three times a second in the paper. A camera that keeps one picture
a second does not make drivers decide less often. Between its pictures the model therefore goes on in shorter periods,
in which nobody is measured.

The errors of positions that somebody has smoothed are correlated over the smoother's window. The filter takes errors
for independent, so of such positions only samples count that are some way apart: three quarters of the window, but at
most 0.8 s. The errors of an average over a window then share a quarter.
"""

import math
from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S
from sugiyama_ros.fit.smooth_positions import Evenness
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Longest time [s] between samples of smoothed positions. Where samples are further apart, the filter knows too little
#: of what drivers saw in between to tell what moved them.
LONGEST_APART_S = 0.8
# Longest period [s] that one step of the model covers.
_LONGEST_S = 0.5
# Distance between samples of smoothed positions, over the window.
_OF_WINDOW = 0.75
#: Periods that differ by less than this part are equal.
ROUNDING = 1e-6


def with_short_periods(trajectories: Trajectories) -> Trajectories:
    """Return a recording with empty samples in between if its samples are more than 0.5 s apart.

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.road import Road
    >>> slow = Trajectories(np.array([[0.0], [9.0]]), np.array([4.0]), np.array([1]), Road(0.0), period_s=1.0)
    >>> with_short_periods(slow).position_m.ravel().tolist()
    [0.0, nan, nan, 9.0]
    """
    parts = usual_decisions(trajectories.period_s)
    return trajectories if parts == 1 else divided(trajectories, parts)


def usual_decisions(period_s: float) -> int:
    """Return how often the model's drivers decide from one sample to the next, if the samples do not say it.

    period_s: time [s] between two samples.
    """
    return 1 if period_s <= _LONGEST_S * (1.0 + ROUNDING) else round(period_s / REFERENCE_PERIOD_S)


def divided(trajectories: Trajectories, parts: int) -> Trajectories:
    """Return a recording with empty samples that divide its period."""
    samples, vehicles = trajectories.position_m.shape
    position = np.full((parts * (samples - 1) + 1, vehicles), np.nan)
    position[::parts] = trajectories.position_m
    return replace(trajectories, position_m=position, period_s=trajectories.period_s / parts)


def apart_if_smoothed(window: int, even: Evenness) -> int:
    """Return the number of periods from one sample that counts to the next, if somebody has smoothed the positions.

    Rounding hides a smoother from ``smoothing_window``, but such positions still move more evenly than the noises of
    the model let them.

    window: samples over which positions were smoothed, as ``smoothing_window`` returns them; 0 if they were not.
    """
    longest_s = LONGEST_APART_S if window else _LONGEST_S
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
    """Return whether samples are as smooth as all others: at the ends of a record, smoothers have half a window.

    present: (N, T), whether a vehicle is recorded. Returns (N, T), false at the ends, and where the vehicle is not
    recorded unless ``ends`` is 0.
    """
    since, until = np.cumsum(present, axis=1), np.cumsum(present[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((since > ends) & (until > ends) | (ends == 0))


def measured_every(trajectories: Trajectories) -> int:
    """Return the number of periods from one sample in which somebody is measured to the next, for ``measured``."""
    return max(1, int(np.gcd.reduce(np.flatnonzero(np.isfinite(trajectories.position_m).any(axis=1)))))


def measured(trajectories: Trajectories) -> Trajectories:
    """Return a recording without its empty samples in between."""
    every = measured_every(trajectories)
    if every == 1:
        return trajectories
    return replace(trajectories, position_m=trajectories.position_m[::every], period_s=every * trajectories.period_s)
