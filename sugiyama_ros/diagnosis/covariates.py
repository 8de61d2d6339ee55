"""What a missing force may depend on, the forces that a model may lack, and how the samples respond to a force.

A push of one period moves the innovations of the next seconds, by nearly the same amounts at any speed. The filter
shows these amounts once. The change of the samples by any small force is then the force convolved with them.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.diagnosis.candidates import FORCE, Candidate, force_along
from sugiyama_ros.effects.discovered_force import COVARIATES, KNOTS, LONGEST_S, MOVING
from sugiyama_ros.effects.registry import index_of
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import evaluate, filtered_states
from sugiyama_ros.fit.recording import Recorded

_FIRST = index_of(FORCE, "covariate")
# Size [m/s^2] of a push, and how many there are: any size in the linear range, enough pushes for a median.
_PUSH, _PUSHES = 0.3, 4
# A push shows in the innovations for so long [s]: longer than any filter remembers.
_SHOWS_S = 4.0
# Fewest samples at which a covariate must be known.
_FEWEST = 100


def forces(data: Recorded, fitted: JointFit, work: Executor) -> Iterator[tuple[Candidate, Array]]:
    """Yield a force along each covariate that the recording shows, one after the other.

    With it comes the change of the innovations [m] by 1 m/s^2 at each knot, (K, N, T).
    """
    states = filtered_states(data, fitted.model, work)
    seen = covariates_of(data, states)
    around, response = data.vicinity, _response(data, fitted, work)
    for name in COVARIATES:
        values = seen[name].T
        known = values[np.isfinite(values)]
        if len(known) < _FEWEST or (name == "time" and not around.is_whole_road):
            continue
        ring = name == "place" and around.road.is_ring
        first, last = (0.0, around.road.circumference_m) if ring else np.quantile(known, (0.02, 0.98)).tolist()
        if last > first:
            knots = _weights(values, first, last, is_periodic=ring)
            yield force_along(name, first, last), lfilter(response, [1.0], knots, axis=2)


def _weights(values: Array, first: float, last: float, *, is_periodic: bool) -> Array:
    """Weight of each knot at each sample (K, N, T), for values (N, T); 0 where the covariate is unknown."""
    intervals = KNOTS if is_periodic else KNOTS - 1
    known = np.isfinite(values)
    s = intervals * np.clip(np.where(known, (values - first) / (last - first), 0.0), 0.0, 1.0)
    k = np.minimum(s.astype(np.int64), intervals - 1)
    weights = np.zeros((KNOTS, *s.shape))
    for knot, weight in ((k, 1.0 - s + k), ((k + 1) % KNOTS, s - k)):
        np.put_along_axis(weights, knot[None], np.where(known, weight, 0.0)[None], axis=0)
    return weights


def _response(data: Recorded, fitted: JointFit, work: Executor) -> Array:
    """Change of the innovation [m] by a push of 1 m/s^2 in one period, after 0, 1, 2, ... samples."""
    samples, period, knot = data.samples, data.vicinity.period_s, 3
    length = min(round(_SHOWS_S / period) + 1, samples - data.every + 1)
    changes = []
    # where vehicles are measured in one sample of so many, pushes before each of the samples in between
    for n, share in enumerate(np.linspace(0.1, 0.8, max(_PUSHES, data.every))):
        at = int(share * (samples - length))
        at += (n - at) % data.every
        rows = fitted.model.rows.copy()
        # the force depends on the time, and its knots are one sample apart
        rows[:, _FIRST], rows[:, _FIRST + 3 + knot] = COVARIATES.index("time") + 1.0, _PUSH
        for back, place in ((knot, _FIRST + 1), (knot - KNOTS + 1, _FIRST + 2)):
            rows[:, place] = data.vicinity.time_s[at] - back * period
        pushed = evaluate(data, replace(fitted.model, rows=rows), work)
        change = (pushed.innovation_m - fitted.samples.innovation_m)[:, at : at + length] / _PUSH
        changes.append(change[np.any(np.nan_to_num(change) != 0.0, axis=1)])
    known = np.concatenate(changes)
    seen, response = np.isfinite(known).any(axis=0), np.zeros(length)
    response[seen] = np.nanmedian(known[:, seen], axis=0)
    return response


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
