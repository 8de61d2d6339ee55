"""What a whole road does: how fast it moves, how waves run through it, how long its queues are.

Speeds and positions are those of all vehicles at all samples, so that measurements and simulations are treated alike.
"""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints

#: Speed [m/s] below which a vehicle stands in a queue.
QUEUE_SPEED = 2.0
# Longest lag [s] between a leader's and a follower's speed, and least variance of speed [m^2/s^2] of a wave.
_LONGEST_LAG_S, _LEAST_VARIANCE = 6.0, 0.05
# A period is believed where the autocorrelation of speed comes back to this; and part of the largest that is as good.
_RETURNS, _NEARLY = 0.1, 0.7


@dataclass(frozen=True)
class Collective:
    """Means over the recording; NaN where there is no wave or no return.

    mean_speed, least_speed, largest_speed [m/s]: over the vehicles, then averaged over time (the paper's V_avg, V_min,
    V_max); wave_speed [m/s]: negative against the traffic; queue_vehicles: mean number of vehicles slower than
    QUEUE_SPEED; period_s: time [s] between two waves that pass the same driver.
    """

    mean_speed: float
    least_speed: float
    largest_speed: float
    wave_speed: float
    queue_vehicles: float
    period_s: float


def collective(speed: Array, headway_m: Array, leader: Ints, period_s: float) -> Collective:
    """Compute the collective measures of a recording or a simulation.

    Parameters
    ----------
    speed
        (T, N) speeds [m/s], NaN where unknown.
    headway_m
        (T, N) way [m] from a vehicle's centre to its leader's, NaN without a leader.
    leader
        (T, N) columns of the leaders, -1 without a leader.
    period_s
        Time between two samples [s].
    """
    known = speed[np.isfinite(speed).any(axis=1)]
    if not len(known):
        return Collective(*(float("nan"),) * 6)
    return Collective(
        mean_speed=float(np.mean(np.nanmean(known, axis=1))),
        least_speed=float(np.mean(np.nanmin(known, axis=1))),
        largest_speed=float(np.mean(np.nanmax(known, axis=1))),
        wave_speed=wave_speed(speed, headway_m, leader, period_s),
        queue_vehicles=float(np.mean((known < QUEUE_SPEED).sum(axis=1))),
        period_s=wave_period(speed, period_s),
    )


def wave_speed(speed: Array, headway_m: Array, leader: Ints, period_s: float) -> float:
    """Speed of waves [m/s]: drivers do what their leaders did a lag ago and a headway ahead.

    The lag is where the correlation of all drivers' speeds with their leaders' speeds is largest; a parabola through
    three samples gives it between samples. A wave takes the lag to pass from leader to follower, who drives on
    meanwhile. Arguments as for ``collective``.
    """
    samples = len(speed)
    lags = int(min(_LONGEST_LAG_S / period_s, samples // 4))
    off = _off(speed)
    ahead = np.where(leader >= 0, np.take_along_axis(off, np.maximum(leader, 0), axis=1), np.nan)
    if lags < 2 or not np.isfinite(ahead).any() or np.nanvar(off) < _LEAST_VARIANCE:
        return float("nan")
    shared = np.array([np.nanmean(off[k:] * ahead[: samples - k]) for k in range(lags + 1)])
    best = int(np.argmax(shared))
    if best in (0, lags):
        return float("nan")
    before, at, after = shared[best - 1 : best + 2]
    lag = (best + 0.5 * (before - after) / (before - 2.0 * at + after)) * period_s
    return float(np.nanmean(speed) - np.nanmean(headway_m) / lag)


def wave_period(speed: Array, period_s: float) -> float:
    """Time [s] after which speeds repeat: the first high maximum of the mean autocorrelation after it was negative."""
    off = _off(speed)
    if not np.isfinite(off).any() or np.nanvar(off) < _LEAST_VARIANCE:
        return float("nan")
    samples = len(off)
    shared = np.array([np.nanmean(off[k:] * off[: samples - k]) for k in range(samples // 2)])
    negative = np.flatnonzero(shared < 0.0)
    if not len(negative):
        return float("nan")
    rest = shared[negative[0] :]
    if rest.max() < _RETURNS * shared[0]:
        return float("nan")
    # of several returns that are nearly as high, the first
    first = int(np.argmax(rest >= _NEARLY * rest.max()))
    falls = np.flatnonzero(np.diff(rest[first:]) < 0.0)
    return float((negative[0] + first + (falls[0] if len(falls) else 0)) * period_s)


def _off(speed: Array) -> Array:
    """Speeds minus each driver's mean, (T, N), NaN where unknown."""
    known = np.isfinite(speed)
    mean = np.where(known, speed, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(speed - mean)
