"""Positions against the speeds that a file gives: they differ for an axis across the road, or another unit."""

from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.road import Road

#: Part by which the ways of positions and of speeds may differ, and way [m] from which on this is judged.
MOST_OFF, _LEAST_WAY_M = 0.1, 10.0
# A vehicle that is away for longer [s] tells no speed.
_LONGEST_STEP_S = 2.0
#: Units of a speed whose unit is not known [m/s]: m/s, km/h, miles/h and feet/s.
UNITS = (1.0, 1.0 / 3.6, 0.44704, 0.3048)


class Motion(NamedTuple):
    """Rows, sorted by vehicle and time: piece (a vehicle on a road), time [s], position [m], speed [m/s]."""

    piece: Ints
    time_s: Array
    s_m: Array
    speed: Array


class OffSpeeds(NamedTuple):
    """How far positions and speeds differ: as a part of the way, and the mean speeds [m/s] of both."""

    part: float
    by_position: float
    by_speed: float


def difference(motion: Motion, ring_m: float, unit: float = 1.0) -> OffSpeeds | None:
    """Compare the way that vehicles go by their positions with the way by their speeds.

    ring_m: circumference [m] of the ring; 0 for an open road; unit: unit [m/s] of the speeds.
    """
    step_s = np.diff(motion.time_s)
    speed = unit * np.abs(motion.speed)
    with np.errstate(over="ignore", invalid="ignore"):
        way, by_speed = (
            Road(ring_m).difference(motion.s_m[1:], motion.s_m[:-1]),
            0.5 * (speed[1:] + speed[:-1]) * step_s,
        )
    known = (np.diff(motion.piece) == 0) & (step_s <= _LONGEST_STEP_S) & np.isfinite(way) & np.isfinite(by_speed)
    if not known.any() or not by_speed[known].any():
        return None
    _, piece = np.unique(motion.piece[1:][known], return_inverse=True)
    # noise goes to and fro, so that the ways of a vehicle are added with their signs
    ways = np.abs(np.bincount(piece, weights=way[known]))
    told = np.bincount(piece, weights=by_speed[known])
    total, seconds = float(max(told.sum(), ways.sum())), float(step_s[known].sum())
    if total < _LEAST_WAY_M or seconds <= 0.0:
        return None
    off = float(np.abs(ways - told).sum())
    return OffSpeeds(off / total, float(ways.sum()) / seconds, float(told.sum()) / seconds)
