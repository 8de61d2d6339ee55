"""The paper's formulation: what a driver perceives is smoothed from the measurements and enters as a given control.

Sections 2.3 (smoothing), 3.3 and 3.4 (state space and likelihood). The perceived state of sample t uses measurements up
to t + 3, so this likelihood is not causal; it is kept because it is the paper's.
"""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.moments import mean_actions
from sugiyama_ros.driver.parameters import COUNT, UTILITY, at_period, horizon_at, jacobian_at_reference
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.paper_kalman import UNSCORED, Control, LikelihoodDerivatives, run
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Samples without a perceived state at the start and at the end: the smoothed speed reaches from t - 2 to t + 3.
MARGIN_BEFORE, MARGIN_AFTER = 2, 3


def smooth(position_m: Array, times: int) -> Array:
    """Smooth positions (T, ...) [m] with ``times`` passes of the (1, 2, 1) / 4 filter of section 2.3, NaN at ends."""
    smoothed = position_m
    for _ in range(times):
        inner = 0.25 * (smoothed[:-2] + 2.0 * smoothed[1:-1] + smoothed[2:])
        smoothed = np.full_like(smoothed, np.nan)
        smoothed[1:-1] = inner
    return smoothed


def smoothed_speed(position_m: Array, times: int, period_s: float) -> Array:
    """Return the naive speed (T, ...) [m/s] of positions smoothed ``times`` times; Eq. SmoothedState."""
    speed = np.full_like(position_m, np.nan)
    speed[:-1] = np.diff(smooth(position_m, times), axis=0) / period_s
    return speed


@dataclass(frozen=True, eq=False)
class Perceived:
    """What one driver perceives by section 2.3, and the measured positions, over the T' samples where both are known.

    gap_m: (T',) smoothed once; speed, leader_speed: (T',) [m/s] smoothed twice; measured_m: (T',) continuous positions;
    period_s: time [s] between two samples.
    """

    gap_m: Array
    speed: Array
    leader_speed: Array
    measured_m: Array
    period_s: float


def perceive(trajectories: Trajectories, driver: int) -> Perceived:
    """Return what a driver perceives. Raises InputError."""
    where = f"{trajectories.source or 'trajectories'}: vehicle {trajectories.vehicle[driver]}"
    leaders = np.unique(trajectories.leader[:, driver])
    if len(leaders) > 1:
        raise InputError(f"{where}: its leader changes; the paper's formulation cannot follow that, the causal one can")
    leader = int(leaders[0])
    pair = trajectories.road.unwrap(trajectories.position_m[:, [driver, leader] if leader >= 0 else [driver]])
    if np.isnan(pair).any():
        raise InputError(
            f"{where}: a sample is missing; the paper's smoothing cannot skip it, the causal formulation can"
        )
    kept = slice(MARGIN_BEFORE, len(pair) - MARGIN_AFTER)
    if len(pair) - MARGIN_BEFORE - MARGIN_AFTER <= UNSCORED:
        raise InputError(f"{where}: {len(pair)} samples are too few for the paper's smoothing")
    once, speed = smooth(pair, 1)[kept], smoothed_speed(pair, 2, trajectories.period_s)[kept]
    gap: Array = np.full(len(once), np.inf)
    leader_speed: Array = np.zeros(len(once))
    if leader >= 0:
        # the leader's lap number is arbitrary: bring the first headway into one circumference
        headway = once[:, 1] - once[:, 0]
        headway += float(trajectories.road.wrap(headway[:1])[0]) - headway[0]
        gap = headway - 0.5 * (trajectories.length_m[leader] + trajectories.length_m[driver])
        leader_speed = speed[:, 1]
    return Perceived(
        gap_m=gap,
        speed=np.ascontiguousarray(speed[:, 0]),
        leader_speed=np.ascontiguousarray(leader_speed),
        measured_m=np.ascontiguousarray(pair[kept, 0]),
        period_s=trajectories.period_s,
    )


@dataclass(frozen=True, eq=False)
class Scored:
    """Log-likelihood (no 2 pi term), its gradient (P,) and its expected information (P, P).

    scatter: (P, P), the sum over the samples of the outer product of the sample's gradient, where it is known; it
    estimates the same information from the data.
    """

    log_likelihood: float
    gradient: Array
    information: Array
    scatter: Array | None = None


def score(perceived: Perceived, parameters: Array, places: Collection[int] = range(COUNT)) -> Scored:
    """Return Eq. SSM_Likelihood of one driver and its derivatives."""
    samples, scaled = len(perceived.measured_m), at_period(parameters, perceived.period_s)
    wanted = np.array([k in places for k in UTILITY])
    action, partials = np.empty(samples), np.empty((samples, len(UTILITY)))
    seen = (perceived.gap_m, perceived.speed, perceived.leader_speed)
    ahead = tuple(range(1, 1 + horizon_at(perceived.period_s)))
    mean_actions(*seen, scaled, ACTIONS, perceived.period_s, ahead, wanted, action, partials)
    derivatives = LikelihoodDerivatives(np.empty(COUNT), np.empty((COUNT, COUNT)))
    value = run(
        Control(action, partials),
        perceived.measured_m,
        perceived.speed[0],
        scaled,
        perceived.period_s,
        np.empty(samples),
        np.empty(samples),
        np.empty((0, 3)),
        derivatives,
    )
    jacobian = jacobian_at_reference(parameters, scaled, perceived.period_s)
    return Scored(float(value), jacobian @ derivatives.gradient, jacobian @ derivatives.information @ jacobian.T)


def log_likelihood(perceived: Perceived, parameters: Array) -> tuple[float, Array]:
    """Return the log-likelihood of parameters (P,), without the term of 2 pi, and its gradient (P,)."""
    scored = score(perceived, parameters)
    return scored.log_likelihood, scored.gradient
