"""The traffic on a whole road: its mean speed, its waves and its queues.

The functions take the speeds and headways of all vehicles at all samples. So they treat measurements and simulations
alike.
"""

from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array, Ints

#: Speed [m/s] below which a vehicle stands in a queue.
QUEUE_SPEED = 2.0
# Longest lag [s] between the speeds of a leader and a follower, and smallest variance [m^2/s^2] of speed in a wave.
_LONGEST_LAG_S, _LEAST_VARIANCE = 6.0, 0.05
# Smallest autocorrelation of speed at a period, and share of the largest maximum from which on a maximum counts.
_RETURNS, _NEARLY = 0.1, 0.7
# Blocks of time [s] that the standard error of the wave speed leaves out in turn, and the least number of them.
_BLOCK_S, _FEWEST_BLOCKS = 25.0, 4


@dataclass(frozen=True)
class Collective:
    """Collective measures of a recording or a simulation.

    mean_speed, least_speed, largest_speed: mean, smallest and largest speed [m/s] over the vehicles, averaged over time
    (the paper's V_avg, V_min, V_max); wave_speed: speed [m/s] of waves, negative against the direction of traffic; NaN
    if there is no wave; queue_vehicles: mean number of vehicles in a queue: slower than ``QUEUE_SPEED``, unless another
    speed was asked for; period_s: time [s] between two waves that pass the same driver; NaN if no wave returns.
    """

    mean_speed: float
    least_speed: float
    largest_speed: float
    wave_speed: float
    queue_vehicles: float
    period_s: float


def collective(
    speed: Array, headway_m: Array, leader: Ints, period_s: float, queue_speed: float = QUEUE_SPEED
) -> Collective:
    """Compute the collective measures of a recording or a simulation.

    speed: (T, N), speeds [m/s]; NaN where unknown; headway_m: (T, N), distance [m] from a vehicle's centre to its
    leader's centre; NaN without a leader; leader: (T, N), columns of the leaders; -1 without a leader; period_s: time
    [s] between two samples; queue_speed: speed [m/s] below which a vehicle is in a queue.
    """
    known = speed[np.isfinite(speed).any(axis=1)]
    if not len(known):
        return Collective(*(float("nan"),) * 6)
    return Collective(
        mean_speed=float(np.mean(np.nanmean(known, axis=1))),
        least_speed=float(np.mean(np.nanmin(known, axis=1))),
        largest_speed=float(np.mean(np.nanmax(known, axis=1))),
        wave_speed=wave_speed(speed, headway_m, leader, period_s),
        queue_vehicles=float(np.mean((known < queue_speed).sum(axis=1))),
        period_s=_wave_period(speed, period_s),
    )


def wave_speed(speed: Array, headway_m: Array, leader: Ints, period_s: float) -> float:
    """Estimate the speed of waves that pass from each leader to the follower.

    In a wave, a driver repeats the leader's speed after a lag. At this lag, the slow phases of all drivers agree best
    with the slow phases of their leaders: a wave is where drivers are slower than usual. A parabola through three
    samples gives the lag between samples. During the lag, the follower drives at the own speed, and the wave moves back
    from the leader's place to the follower's. Each moment counts as much as it contributes to the agreement, so free
    flow before the waves does not count.

    Arguments as for ``collective``. Returns speed of waves [m/s], negative against the direction of traffic; NaN if
    there is no wave.
    """
    samples = len(speed)
    lags = int(min(_LONGEST_LAG_S / period_s, samples // 4))
    off = _off(speed)
    if lags < 2 or not np.isfinite(off).any() or np.nanvar(off) < _LEAST_VARIANCE:
        return float("nan")
    off = np.minimum(off, 0.0)
    ahead = np.where(leader >= 0, np.take_along_axis(off, np.maximum(leader, 0), axis=1), np.nan)
    if not np.isfinite(ahead).any():
        return float("nan")
    shared = np.array([_agreement(off[k:], ahead[: samples - k]) for k in range(lags + 1)])
    best = int(np.argmax(np.where(np.isnan(shared), -np.inf, shared)))
    if best in (0, lags) or np.isnan(shared[best - 1 : best + 2]).any():
        return float("nan")
    before, at, after = shared[best - 1 : best + 2]
    lag = (best + 0.5 * (before - after) / (before - 2.0 * at + after)) * period_s
    weight = off[best:] * ahead[: samples - best]
    driven = np.mean([speed[k : samples - best + k] for k in range(best + 1)], axis=0)
    passed = driven - headway_m[: samples - best] / lag
    known = np.isfinite(weight) & np.isfinite(passed)
    return float(np.average(passed[known], weights=weight[known])) if weight[known].sum() > 0.0 else float("nan")


def wave_speed_error(speed: Array, headway_m: Array, leader: Ints, period_s: float) -> float:
    """Estimate the standard error of the speed of waves: each block of 25 s is left out in turn (jackknife).

    Arguments as for ``collective``. Returns standard error [m/s]; NaN if there is no wave without some block, or if the
    recording is shorter than 100 s.
    """
    count = round(len(speed) * period_s / _BLOCK_S)
    if count < _FEWEST_BLOCKS:
        return float("nan")
    left_out = []
    for block in np.array_split(np.arange(len(speed)), count):
        rest = speed.copy()
        rest[block] = np.nan
        left_out.append(wave_speed(rest, headway_m, leader, period_s))
    return float(np.sqrt((count - 1) * np.var(left_out)))


def _wave_period(speed: Array, period_s: float) -> float:
    """Estimate the time after which speeds repeat.

    The time is the first high maximum of the mean autocorrelation of speed after the autocorrelation was negative.

    speed: (T, N), speeds [m/s]; NaN where unknown. Returns time [s] between two waves; NaN if speeds do not repeat.
    """
    off = _off(speed)
    if not np.isfinite(off).any() or np.nanvar(off) < _LEAST_VARIANCE:
        return float("nan")
    samples = len(off)
    every = np.array([_agreement(off[k:], off[: samples - k]) for k in range(samples // 2)])
    lag = np.flatnonzero(np.isfinite(every))
    shared = every[lag]
    negative = np.flatnonzero(shared < 0.0)
    if not len(negative):
        return float("nan")
    rest = shared[negative[0] :]
    if rest.max() < _RETURNS * shared[0]:
        return float("nan")
    # among maxima of nearly the same height, the first maximum counts
    first = int(np.argmax(rest >= _NEARLY * rest.max()))
    falls = np.flatnonzero(np.diff(rest[first:]) < 0.0)
    return float(lag[negative[0] + first + (falls[0] if len(falls) else 0)] * period_s)


def _agreement(first: Array, second: Array) -> float:
    """Mean product of two arrays; NaN where they are never known together."""
    product = first * second
    count = np.isfinite(product).sum()
    return float(np.nansum(product) / count) if count else float("nan")


def _off(speed: Array) -> Array:
    """Subtract each driver's mean speed from their speeds, (T, N); NaN where unknown."""
    known = np.isfinite(speed)
    mean = np.where(known, speed, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(speed - mean)
