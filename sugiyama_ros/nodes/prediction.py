"""Where a driver will be in the next seconds, with its spread: the driver's filter goes on without samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, nan

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.online import Estimate, OnlineFilter

#: How far ahead [s] a path is predicted, unless asked otherwise.
AHEAD_S = 5.0
#: Vehicles in the chain of a filter that predicts a path: what they do reaches the driver within these seconds.
VEHICLES = 7


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


def predict(
    filter_: OnlineFilter,
    now: Estimate,
    identity: Sequence[int],
    length_m: Sequence[float],
    time_s: float = 0.0,
    ahead_s: float = AHEAD_S,
) -> Prediction:
    """Predict a driver's path with a filter, which afterwards knows what it knew before.

    Nothing is known of the preferences of the drivers ahead but their spread over the population. So the filter also
    goes on with each of these preferences one standard deviation lower and higher. What this changes adds to the mean
    and to the covariance, as in a cubature rule: a slower leader slows the driver down, but a faster one does not pull.

    identity, length_m: numbers and lengths [m] of the vehicles of the chain, as in the latest sample; time_s: time of
    the latest sample [s]; ahead_s: how far ahead to predict [s].
    """
    saved = filter_.saved()
    path = _path(filter_, now, identity, length_m, time_s, ahead_s)
    model, middle = filter_.kalman.model, np.column_stack([path.position_m, path.speed])
    for m in (m for m in range(1, len(identity)) if identity[m] >= 0):
        for place, std in zip(model.adapted, np.sqrt(model.prior_var).tolist(), strict=True):
            for sign in (-1.0, 1.0):
                filter_.restore(saved)
                filter_.kalman.rows[m, place] *= exp(sign * std)
                other = _path(filter_, now, identity, length_m, time_s, ahead_s)
                off = np.column_stack([other.position_m, other.speed]) - middle
                path.position_m[:] += 0.5 * off[:, 0]
                path.speed[:] += 0.5 * off[:, 1]
                path.covariance[:] += 0.5 * off[:, :, None] * off[:, None, :]
    filter_.restore(saved)
    return path


def _path(
    filter_: OnlineFilter,
    now: Estimate,
    identity: Sequence[int],
    length_m: Sequence[float],
    time_s: float,
    ahead_s: float,
) -> Prediction:
    """Let a filter go on without samples; the arguments are those of ``predict``."""
    periods = round(ahead_s / filter_.period_s)
    found, nowhere = [now], [nan] * len(identity)
    for k in range(1, periods + 1):
        at_s = time_s + k * filter_.period_s
        found.append(filter_.step(nowhere, identity, length_m, at_s, (nan, -1, 0.0)))
    position = np.array([one.position_m for one in found])
    steps: Array = np.diff(position)
    if filter_.road.is_ring:
        lap = filter_.road.circumference_m
        steps -= lap * np.round(steps / lap)
    return Prediction(
        time_s=np.array([k * filter_.period_s for k in range(periods + 1)]),
        position_m=position[0] + np.concatenate([[0.0], np.cumsum(steps)]),
        speed=np.array([one.speed for one in found]),
        covariance=np.array([one.covariance[:2, :2] for one in found]),
    )
