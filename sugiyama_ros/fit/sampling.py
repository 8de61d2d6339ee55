"""Samples in which somebody is measured, and empty samples between measurements that are far apart.

The driver of the model decides anew at every sample, three times a second in the paper. A camera that keeps one picture
a second does not make drivers decide less often. Between its pictures the model therefore goes on in shorter periods,
in which nobody is measured.
"""

from dataclasses import replace

import numpy as np

from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S
from sugiyama_ros.trajectories.trajectories import Trajectories

# Longest period [s] that one step of the model covers.
_LONGEST_S = 0.5
# Periods that differ by less than this part are equal.
_ROUNDING = 1e-6


def with_short_periods(trajectories: Trajectories) -> Trajectories:
    """Return a recording with empty samples in between if its samples are more than 0.5 s apart.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.

    Returns
    -------
    Trajectories
        The recording at the part of its period that is nearest to the paper's 1/3 s; the recording itself if its period
        is at most 0.5 s.

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.road import Road
    >>> slow = Trajectories(np.array([[0.0], [9.0]]), np.array([4.0]), np.array([1]), Road(0.0), period_s=1.0)
    >>> with_short_periods(slow).position_m.ravel().tolist()
    [0.0, nan, nan, 9.0]
    """
    if trajectories.period_s <= _LONGEST_S * (1.0 + _ROUNDING):
        return trajectories
    parts = round(trajectories.period_s / REFERENCE_PERIOD_S)
    samples, vehicles = trajectories.position_m.shape
    position = np.full((parts * (samples - 1) + 1, vehicles), np.nan)
    position[::parts] = trajectories.position_m
    return replace(trajectories, position_m=position, period_s=trajectories.period_s / parts)


def measured_every(trajectories: Trajectories) -> int:
    """Return the number of periods from one sample in which somebody is measured to the next, as ``measured`` takes it.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.

    Returns
    -------
    int
        Largest number that divides all distances between the first sample and samples with a measurement; 1 for a
        recording without empty samples.
    """
    return max(1, int(np.gcd.reduce(np.flatnonzero(np.isfinite(trajectories.position_m).any(axis=1)))))


def measured(trajectories: Trajectories) -> Trajectories:
    """Return a recording without the samples that ``with_short_periods`` has added."""
    every = measured_every(trajectories)
    if every == 1:
        return trajectories
    return replace(trajectories, position_m=trajectories.position_m[::every], period_s=every * trajectories.period_s)
