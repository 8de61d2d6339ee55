"""Simulated positions, smoothed as somebody has smoothed those of a recording.

The errors of smoothed positions are correlated, and so are those of samples that are three quarters of the smoother's
window apart. What a candidate gains by that shows in simulations only if these are smoothed, too.
"""

from dataclasses import replace

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import SIGMA_NU
from sugiyama_ros.fit.model import Model
from sugiyama_ros.fit.recording import Recorded


def before_smoothing(data: Recorded, model: Model) -> Model:
    """Return the model with the position noise that an average over the smoother's window brings down to its own.

    Parameters
    ----------
    data : Recorded
        The recording.
    model : Model
        The model fitted to the recording.

    Returns
    -------
    Model
        The model itself if nobody has smoothed the positions.
    """
    rows = model.rows.copy()
    rows[:, SIGMA_NU] *= np.sqrt(2 * _half(data) + 1)
    return replace(model, rows=rows)


def as_smoothed(data: Recorded, position_m: Array, segment: Ints) -> Array:
    """Return positions averaged over the smoother's window of a recording.

    Parameters
    ----------
    data : Recorded
        The recording.
    position_m : ndarray, shape (T, N)
        Measured positions of the drivers [m] at the periods of the recording; NaN where missing.
    segment : ndarray of int, shape (N, T)
        Number of the unbroken part of each driver's record.

    Returns
    -------
    ndarray, shape (T, N)
        Positions [m]; NaN where the window is not within one part. The positions themselves if nobody has smoothed
        those of the recording.
    """
    half = _half(data)
    if not half:
        return position_m
    road = data.vicinity.road
    continuous, smoothed = road.unwrap(position_m), np.full_like(position_m, np.nan)
    for i, of_driver in enumerate(segment):
        for part in np.unique(of_driver):
            own = np.flatnonzero(of_driver == part)
            if len(own) > 2 * half:
                kernel = np.full(2 * half + 1, 1.0 / (2 * half + 1))
                smoothed[own[half:-half], i] = np.convolve(continuous[own, i], kernel, "valid")
    return road.wrap(smoothed)


def _half(data: Recorded) -> int:
    """Number of samples on each side of the one that the smoother's window is around."""
    return round(0.5 * (data.smoothed_s / data.vicinity.period_s - 1.0)) if data.smoothed_s else 0
