"""MOBIL, the rival: a lane is worth the acceleration that it allows, to the driver and, by politeness, to others.

References
----------
Kesting, Treiber and Helbing, Transportation Research Record 1999 (2007) 86.
"""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.lane_change import KEEP, ThreeLanes
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.idm import idm


@kernel
def _followed(gap: Array, speed: Array, leader_speed: Array, p: Array) -> Array:
    """Compute IDM's accelerations (M,) [m/s^2] with parameters (M, 5)."""
    return np.array([idm(gap[m], speed[m], leader_speed[m], p[m]) for m in range(len(gap))])


def _accelerations(gap: Array, speed: Array, leader_speed: Array, p: Array) -> Array:
    """Compute IDM's accelerations [m/s^2] of arrays that broadcast to (R, 3), with parameters (R, 5)."""
    flat = [np.ascontiguousarray(np.broadcast_to(one, gap.shape)).ravel() for one in (gap, speed, leader_speed)]
    found = _followed(flat[0], flat[1], flat[2], np.repeat(p, gap.shape[1], axis=0))
    return np.asarray(found.reshape(gap.shape))


def mobil_features(lanes: ThreeLanes, law: Array) -> Array:
    """Compute what MOBIL compares, as features of a choice among manoeuvres.

    The incentive is own gain + politeness * others' gain - threshold * change. Weighted by a rationality it is MOBIL
    with a logistic link: near its threshold, a driver may change or not.

    Parameters
    ----------
    lanes : ThreeLanes
        What R drivers see.
    law : ndarray, shape (R, 5)
        Parameters of IDM by which MOBIL judges: v0, T, s0, a, b.

    Returns
    -------
    ndarray, shape (R, 3, 3)
        For keep, left and right: what the driver's acceleration [m/s^2] gains, what the accelerations of the new and
        the old follower gain together, and -1 for a change. All are 0 for keep.
    """
    speed, length = lanes.speed[:, None], lanes.length_m[:, None]
    ahead = _accelerations(lanes.gap_m, speed, lanes.leader_speed, law)
    at_end = _accelerations(np.maximum(lanes.end_m, 0.0), speed, np.zeros_like(lanes.end_m), law)
    own = np.minimum(ahead, np.where(np.isfinite(lanes.end_m), at_end, np.inf))
    is_followed = np.isfinite(lanes.rear_gap_m)
    behind_me = _accelerations(lanes.rear_gap_m, lanes.rear_speed, speed, law)
    without_me = _accelerations(lanes.rear_gap_m + length + lanes.gap_m, lanes.rear_speed, lanes.leader_speed, law)
    # what a follower loses when the driver is ahead of them
    loss = np.where(is_followed, without_me - behind_me, 0.0)
    features = np.stack((own - own[:, [KEEP]], loss[:, [KEEP]] - loss, -np.ones_like(own)), axis=2)
    features[:, KEEP] = 0.0
    return np.where(lanes.is_open[:, :, None], features, 0.0)
