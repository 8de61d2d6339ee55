"""What a missing force may depend on: what a driver has around them now, and what they did some seconds ago."""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.effects.discovered_force import LONGEST_S, MOVING
from sugiyama_ros.fit.recording import Recorded

# Number of vehicles ahead whose mean speed is the speed of the flow.
_FLOW = 5


def covariates_of(data: Recorded, state: Array) -> dict[str, Array]:
    """Return what filtered states say of the surroundings of the drivers at each sample.

    Parameters
    ----------
    data : Recorded
        The recording.
    state : ndarray, shape (T, V, 4)
        Filtered states.

    Returns
    -------
    dict of str to ndarray, shape (T, N)
        Gaps [m], speed [m/s], and approach rates [m/s]: the driver's speed minus the speed of the vehicle ahead, and
        the speed of the vehicle behind minus the driver's; place [m] and time [s]. NaN where unknown, and all NaN where
        the recording cannot show a covariate.
    """
    around, drivers = data.vicinity, data.drivers
    x, v = around.road.wrap(state[:, :, 0]), state[:, :, 1]
    leader, length = around.leader, around.length_m
    gap = around.road.space_headway(_ahead(x, leader), x) - 0.5 * (_ahead(length, leader) + length)
    found = {
        "gap": gap,
        "speed": v,
        "approach_rate": v - _ahead(v, leader),
        "rear_gap": _behind(gap, leader),
        "rear_approach_rate": _behind(v, leader) - v,
        "second_gap": _ahead(gap, leader),
        "second_approach_rate": v - _ahead(_ahead(v, leader), leader),
        "place": x if around.has_places else np.full_like(x, np.nan),
    }
    return {**{name: values[:, :drivers] for name, values in found.items()}, "time": around.time_s}


def further_covariates(data: Recorded, state: Array, seen: Mapping[str, Array]) -> dict[str, Array]:
    """Return what else a force may depend on.

    Parameters
    ----------
    data : Recorded
        The recording.
    state : ndarray, shape (T, V, 4)
        Filtered states.
    seen : mapping of str to ndarray, shape (T, N)
        What ``covariates_of`` returns.

    Returns
    -------
    dict of str to ndarray, shape (T, N)
        Time gap [s]; speed minus the mean speed of five vehicles ahead [m/s]; accelerations [m/s^2] of the vehicle
        ahead and of the driver's own car in the last period. NaN where unknown.
    """
    around, drivers = data.vicinity, data.drivers
    leader = around.leader
    v, acceleration = state[:, :, 1], state[:, :, 2] + state[:, :, 3]
    ahead, speeds = v, []
    for _ in range(_FLOW):
        ahead = _ahead(ahead, leader)
        speeds.append(ahead)
    return {
        "time_gap": np.minimum(seen["gap"] / np.maximum(seen["speed"], MOVING), LONGEST_S),
        "flow_approach_rate": (v - np.mean(speeds, axis=0))[:, :drivers],
        "leader_acceleration": _ahead(acceleration, leader)[:, :drivers],
        "acceleration": acceleration[:, :drivers],
    }


def some_time_ago(data: Recorded, values: Array, seconds: float) -> Array:
    """Return the values (T, N) of a covariate some seconds ago; NaN where the record was broken since then."""
    back = round(seconds / data.vicinity.period_s)
    found = np.full_like(values, np.nan)
    if 0 < back < data.samples:
        unbroken = (data.segment[:, back:] == data.segment[:, :-back]).T
        found[back:] = np.where(unbroken, values[:-back], np.nan)
    return found


def _ahead(values: Array, leader: Ints) -> Array:
    """Values (T, V) of the vehicle ahead; NaN where there is none."""
    return np.where(leader >= 0, np.take_along_axis(values, np.maximum(leader, 0), axis=1), np.nan)


def _behind(values: Array, leader: Ints) -> Array:
    """Values (T, V) of the vehicle behind; NaN where there is none."""
    found = np.full_like(values, np.nan)
    samples, columns = np.nonzero(leader >= 0)
    found[samples, leader[samples, columns]] = values[samples, columns]
    return found
