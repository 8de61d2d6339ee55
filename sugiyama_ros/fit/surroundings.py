"""What filtered states say of the surroundings of drivers, on which a force or a bias of innovations may depend."""

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.effects.discovered_force import LONGEST_S, MOVING
from sugiyama_ros.fit.recording import Recorded


def covariates_of(data: Recorded, state: Array) -> dict[str, Array]:
    """Return what filtered states (T, V, 4) say of the surroundings of the drivers at each sample, (T, N) by name.

    Gaps [m], speed [m/s], and approach rates [m/s]: the driver's speed minus the speed of the vehicle ahead, and the
    speed of the vehicle behind minus the driver's; place [m], time gap and time [s]; accelerations [m/s^2] in the last
    period. NaN where unknown.
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
    acceleration = state[:, :, 2] + state[:, :, 3]
    found |= {
        "time_gap": np.minimum(gap / np.maximum(v, MOVING), LONGEST_S),
        "acceleration": acceleration,
        "leader_acceleration": _ahead(acceleration, leader),
    }
    return {**{name: values[:, :drivers] for name, values in found.items()}, "time": around.time_s}


def _ahead(values: Array, leader: Ints) -> Array:
    """Values (T, V) of the vehicle ahead; NaN where there is none."""
    return np.where(leader >= 0, np.take_along_axis(values, np.maximum(leader, 0), axis=1), np.nan)


def _behind(values: Array, leader: Ints) -> Array:
    """Values (T, V) of the vehicle behind; NaN where there is none."""
    found = np.full_like(values, np.nan)
    samples, columns = np.nonzero(leader >= 0)
    found[samples, leader[samples, columns]] = values[samples, columns]
    return found
