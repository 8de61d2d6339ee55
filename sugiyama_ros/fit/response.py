"""How samples respond to drivers who act otherwise, to first order and without a pass of the filter.

A push of one period moves the innovations of the next seconds, by nearly the same amounts at any speed. The filter
shows these amounts once. The change of the samples by any small change of the accelerations is then this change, along
the filtered path, convolved with them.
"""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import at_period, horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.discovered_force import COVARIATES, KNOTS
from sugiyama_ros.effects.discovered_force import EFFECT as FORCE
from sugiyama_ros.effects.registry import index_of
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import between_measurements, evaluate, filtered_states, followed
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.simulation.drive import Setting, act_along

_FIRST = index_of(FORCE.name, "covariate")
# Size [m/s^2] of a push, and how many there are: any size in the linear range, enough pushes for a median.
_PUSH, _PUSHES = 0.3, 4
# A push shows in the innovations for so long [s]: longer than any filter remembers.
_SHOWS_S = 4.0


class Response:
    """The response of a fitted model's samples.

    states: filtered states (T, V, 4) of all vehicles.
    """

    def __init__(self, data: Recorded, fitted: JointFit, work: Executor) -> None:
        self._data, self.states = data, filtered_states(data, fitted.model, work)
        self._after_push = _after_push(data, fitted, work)
        moved = np.ascontiguousarray(between_measurements(data, self.states))
        self._moved, (self._leader, self._turn) = moved, followed(data.vicinity, slice(None), moved)
        self._usual = self._actions(fitted.model.rows)

    def to_rows(self, rows: Array) -> Array:
        """Change of the innovations [m] (N, T) by drivers with other rows (N, WIDTH)."""
        return self.to_push(np.nan_to_num(self._actions(rows) - self._usual).T)

    def to_push(self, acceleration: Array) -> Array:
        """Change of the innovations [m] by further accelerations [m/s^2], (..., N, T) both."""
        own = [lfilter(after, [1.0], acceleration[..., i, :]) for i, after in enumerate(self._after_push)]
        return np.stack(own, axis=-2)

    def _actions(self, rows: Array) -> Array:
        """Accelerations [m/s^2] (T, N) along the filtered path."""
        data, around = self._data, self._data.vicinity
        out = np.empty((data.samples, data.drivers))
        everybody = np.resize(at_period(rows, around.period_s), (self._moved.shape[1], rows.shape[1]))
        setting = Setting(around.period_s, horizon_at(around.period_s), around.road.circumference_m)
        time_s = np.ascontiguousarray(around.time_s[:, 0])
        place = self._moved, self._leader, self._turn, around.length_m, data.lines
        act_along(*place, everybody, ACTIONS, time_s, setting, out)
        return out


def _after_push(data: Recorded, fitted: JointFit, work: Executor) -> Array:
    """Change of each driver's innovation [m] by a push of 1 m/s^2 in one period, after 0, 1, 2, ... samples, (N, L)."""
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
        # whoever is not there does not respond
        change[~np.any(np.nan_to_num(change) != 0.0, axis=1)] = np.nan
        changes.append(change)
    known = np.array(changes)
    seen = np.isfinite(known)
    usual = [float(np.median(lag[there])) if there.any() else 0.0 for lag, there in zip(known.T, seen.T, strict=True)]
    own = seen.any(axis=0)
    return np.where(own, np.nanmedian(np.where(own, known, 0.0), axis=0), usual)
