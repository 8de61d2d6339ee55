"""Classic calibration of the rival laws: one car drives behind its measured leader, and least squares fit its gaps.

This is the global approach with absolute errors of gaps of Treiber and Kesting, Traffic Flow Dynamics, chapter on
calibration.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import qmc

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.utility import advance
from sugiyama_ros.effects.control import law_acceleration
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.jit import kernel
from sugiyama_ros.laws.law import Law
from sugiyama_ros.laws.registry import number_of

# Number of starts to compare. Each parameter lies between its default divided and multiplied by the factor.
_LOOKED_AT, _FACTOR = 64, 4.0
# The sum of squares has many minima. The search takes a few steps from the best starts and follows the best of them.
_FEW, _TRIED, _FOLLOWED = 10, 8, 2
# Step of the difference quotients relative to the default: about the square root of the rounding error of a run.
_STEP = 1e-7
# A search ends when the sum of squares or the parameters change by less than this share, or after so many runs.
_ENOUGH, _MOST = 1e-6, 60


@dataclass(frozen=True, eq=False)
class Following:
    """Smoothed motion of one driver behind a leader.

    Positions are continuous: they do not wrap, so the difference of two positions is the distance between them. Unknown
    samples are NaN.

    position_m, speed: (T,), position of the driver's centre [m] and speed [m/s]; leader_position_m, leader_speed: (T,),
    position of the leader's centre [m] and speed [m/s]; half_lengths_m: half of the sum of both vehicles' lengths [m];
    period_s: time between two samples [s]; source: name of the driver in error messages. Raises InputError.
    """

    position_m: Array
    speed: Array
    leader_position_m: Array
    leader_speed: Array
    half_lengths_m: float
    period_s: float
    source: str = "following"

    def __post_init__(self) -> None:
        shapes = {a.shape for a in (self.position_m, self.speed, self.leader_position_m, self.leader_speed)}
        if len(shapes) > 1 or self.position_m.ndim != 1:
            raise InputError(f"{self.source}: positions and speeds differ in length; give T samples of each")

    @cached_property
    def states(self) -> Array:
        """Positions and speeds of the driver, then of the leader, (T, 4)."""
        return np.column_stack((self.position_m, self.speed, self.leader_position_m, self.leader_speed))


@dataclass(frozen=True, eq=False)
class GapFit:
    """A law fitted to the gaps of one driver.

    parameters: (n,), parameters in the order of the law; rmse_m: root mean square error of the fitted gaps [m].
    """

    parameters: Array
    rmse_m: float


@kernel
def _run(rows: Array, states: Array, half_lengths: float, period: float, driven: Mask, out: Array) -> None:
    """Fill ``out`` (K, T) with the errors of the gaps [m] for rows (K, WIDTH); entries without an error stay as they
    are.
    """
    for k in range(len(rows)):
        x, v = 0.0, 0.0
        for t in range(len(states)):
            if not driven[t]:
                continue
            position, speed, leader_position, leader_speed = states[t]
            if t > 0 and driven[t - 1]:
                out[k, t] = position - x
            else:
                x, v = position, max(speed, 0.0)
            gap = leader_position - x - half_lengths
            a = law_acceleration(gap, v, leader_speed, rows[k])
            x, v = advance(x, v, a, period)
            v = max(v, 0.0)


def gap_errors(law: Law, parameters: Array, following: Following, chosen: Mask) -> Array:
    """Return the errors of the gaps in a simulation of one car, simulated minus measured.

    The car starts from its measured state at the first sample of each unbroken run of chosen samples. A sample that is
    left out between two blocks of time therefore restarts the car. The integration is Euler's rule as in the
    simulation; speeds stay at or above 0.

    parameters: (..., n), parameters in the order of the law; chosen: (T,), samples to simulate. Returns (..., T),
    errors [m]; naN where the car starts and where a sample is not chosen.
    """
    values = parameters.reshape(-1, parameters.shape[-1])
    rows = np.zeros((len(values), ROW.width))
    rows[:, ROW.law], rows[:, ROW.law_places[law.name]] = number_of(law.name), values
    states = following.states
    driven = chosen & np.isfinite(states).all(axis=1)
    errors = np.full((len(rows), len(states)), np.nan)
    _run(rows, states, following.half_lengths_m, following.period_s, driven, errors)
    return errors.reshape(*parameters.shape[:-1], len(states))


def fit_gaps(law: Law, following: Following, chosen: Mask, start: Array | None = None) -> GapFit:
    """Fit the parameters of a law by least squares of ``gap_errors``, within their bounds.

    chosen: (T,), samples that count; start: (n,), parameters at the start of the search; by default the search tries
    many starts. Raises InputError.
    """
    default, lower, upper = (np.array([getattr(p, of) for p in law.parameters]) for of in ("default", "lower", "upper"))
    scored = np.isfinite(gap_errors(law, default, following, chosen))
    if scored.sum() <= len(default):
        raise InputError(
            f"{following.source}: {scored.sum()} samples cannot determine {len(default)} parameters of {law.name};"
            " give more"
        )

    def errors(rows: Array) -> Array:
        return gap_errors(law, rows, following, chosen)[..., scored]

    def slopes(parameters: Array) -> Array:
        step = _STEP * default
        at = errors(np.vstack((parameters, parameters + np.diag(step))))
        return np.asarray(((at[1:] - at[0]) / step[:, None]).T)

    def search(start: Array, most: int) -> OptimizeResult:
        return least_squares(
            errors, start, slopes, bounds=(lower, upper), x_scale=default, ftol=_ENOUGH, xtol=_ENOUGH, max_nfev=most
        )

    if start is not None:
        found = search(np.clip(start, lower, upper), _MOST)
        return GapFit(found.x, float(np.sqrt(np.mean(np.square(found.fun)))))
    places = qmc.Halton(len(default), scramble=False).random(_LOOKED_AT)
    starts = np.clip(default * _FACTOR ** (2.0 * places - 1.0), lower, upper)
    starts = starts[np.argsort(np.square(errors(starts)).sum(axis=1))]
    tried = sorted((search(start, _FEW) for start in starts[:_TRIED]), key=lambda found: float(found.cost))
    best = min((search(found.x, _MOST) for found in tried[:_FOLLOWED]), key=lambda found: float(found.cost))
    return GapFit(best.x, float(np.sqrt(np.mean(np.square(best.fun)))))
