"""What other car-following models make of the same data: IDM and FVDM, calibrated in both ways that are in use.

In the causal filter, as the driver model is; and by least squares on the gap of one car simulated behind his leader as
he was recorded (Treiber and Kesting, Traffic Flow Dynamics, chapter 17).
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from sugiyama_ros.criticism.fitting import FOLDS, Fit, Model, Recorded, fit_base, start_model
from sugiyama_ros.criticism.free_run import filtered_states
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU
from sugiyama_ros.driver.rivals import LAWS, fvdm, idm
from sugiyama_ros.effects.catalogue import DECLARED, LAW, LAW_PLACES
from sugiyama_ros.road import Array

# Time [s] for which a car is simulated before it starts anew from where it was recorded.
_RUN_S = 25.0


def in_filter(data: Recorded, law: str, work: Executor) -> Fit:
    """A rival with his parameters and noises fitted for every driver in the causal filter."""
    places = LAW_PLACES[law]
    model = start_model(data.drivers, (SIGMA_NU, SIGMA_A, *range(places.start, places.stop)))
    for rows in (model.rows, model.ahead):
        rows[:, LAW] = 1 + [one.name for one in LAWS].index(law)
        rows[:, places] = [DECLARED[k].default for k in range(places.start, places.stop)]
    return fit_base(data, model.individual, work, model)


def by_gaps(data: Recorded, law: str, fitted: Fit, work: Executor) -> tuple[Model, ...]:
    """For every fold, the rival with parameters by least squares on the gaps outside it; the rest as in ``fitted``."""
    states = filtered_states(data, fitted.model)
    places = LAW_PLACES[law]
    jobs = [(data, law, states, i, fitted.model.rows[i, places]) for i in range(data.drivers)]
    found = np.stack(list(work.map(_fit_driver, jobs)))
    models = []
    for f in range(FOLDS):
        rows = fitted.model.rows.copy()
        rows[:, places] = found[:, f]
        models.append(replace(fitted.model, rows=rows, ahead=rows))
    return tuple(models)


def _fit_driver(job: tuple[Recorded, str, Array, int, Array]) -> Array:
    """Parameters (F, K) of one driver, without each fold in turn."""
    data, law, states, i, start = job
    t = data.trajectories
    leader = t.leader[:, i]
    samples = np.arange(len(leader))
    way = states[samples, leader, 0] - states[:, i, 0]
    if t.road.is_ring:
        way = np.mod(way, t.road.circumference_m)
    gap = np.where(leader >= 0, way - 0.5 * (t.length_m[i] + t.length_m[leader]), np.nan)
    speed, leader_speed = states[:, i, 1], states[samples, leader, 1]
    places = LAW_PLACES[law]
    declared = [DECLARED[k] for k in range(places.start, places.stop)]
    bounds = np.array([d.lower for d in declared]) + 1e-6, np.array([d.upper for d in declared])
    known = np.isfinite(gap) & np.isfinite(speed) & np.isfinite(leader_speed)
    steps = max(1, round(_RUN_S / t.period_s))
    fits = []
    for f in range(FOLDS):
        use = known & (data.fold != f)
        if use.sum() < 20:
            fits.append(start)
            continue
        wanted = (gap, speed, leader_speed, known, steps, t.period_s, law == "idm")

        def errors(p: Array, use: Array = use, wanted: tuple[Any, ...] = wanted) -> Array:
            out = np.empty(len(gap))
            _gap_errors(p, *wanted, out)  # type: ignore[call-arg]
            return np.asarray(np.clip(np.nan_to_num(out[use]), -100.0, 100.0))

        inside = np.clip(start, bounds[0] + 1e-3, bounds[1] - 1e-3)
        fits.append(
            least_squares(errors, inside, bounds=bounds, x_scale=np.maximum(np.abs(inside), 0.1), max_nfev=40).x
        )
    return np.array(fits)


@njit(nogil=True, cache=True)
def _gap_errors(
    p: Array,
    gap: Array,
    speed: Array,
    leader_speed: Array,
    known: Array,
    steps: int,
    period: float,
    is_idm: bool,
    out: Array,
) -> None:
    """Simulated minus recorded gap [m] into ``out`` (T,), with a new start every ``steps`` samples."""
    g, v, left = 0.0, 0.0, 0
    for t in range(len(gap)):
        if not known[t]:
            left = 0
            out[t] = 0.0
            continue
        if left == 0:
            g, v, left = gap[t], speed[t], steps
        out[t] = g - gap[t]
        action = idm(g, v, leader_speed[t], p) if is_idm else fvdm(g, v, leader_speed[t], p)
        g += period * (leader_speed[t] - v)
        v = max(v + period * action, 0.0)
        left -= 1


def laws() -> Sequence[str]:
    """Names of the rivals."""
    return [law.name for law in LAWS]
