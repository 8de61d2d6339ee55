"""The causal filter in the plane: a car as a kinematic bicycle along a wanted line, behind vehicles on the same line.

This is an extended Kalman filter. Its state is the state of a chain (``causal``) with x [m] in place of the own
position along the road, and with y [m], the heading and the steering angle [rad] at the end. Seen along the line, it is
the state of a chain again. So the driver accelerates as in ``predict``, with the same cubature and the same effects.
The steering angle of the next period (``driver.bicycle.mean_steering``) is expected over a cubature of the same kind.
The motion of the car is linearised by its analytic Jacobian. Measured are x, y and perhaps the heading, whose
innovation is wrapped. On a straight line, everything along the road equals the base filter.

References
----------
The kinematic bicycle: R. Rajamani, Vehicle Dynamics and Control (2006), section 2.2; section 7 of the paper names it.
Extended Kalman filter: Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
Navigation (2001), section 10.3.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.bicycle import (
    SIGMA_DELTA,
    SIGMA_PSI,
    Pose,
    Steering,
    drive,
    drive_jacobian,
    foot_of,
    mean_steering,
    nearest,
    wrapped,
)
from sugiyama_ros.driver.parameters import SIGMA_NU
from sugiyama_ros.filters.predict import cholesky, linearise_chain, look_around, moments, regress
from sugiyama_ros.filters.state import (
    MOVING,
    POSITION,
    STATE,
    UNKNOWN,
    FilterStep,
    State,
)
from sugiyama_ros.filters.update import (
    SETTLING,
    forget_vehicle,
    innovation,
    start_vehicle,
    update,
)
from sugiyama_ros.jit import kernel

# Entries of the state that follow those of the vehicles: y, heading, steering angle.
_BESIDE = 3
# A driver's heading [rad] and steering angle [rad] differ by so much (std) from those of the line, before anything is
# measured of them.
_START_HEADING_STD, _START_STEERING_STD = 0.3, 0.1
# Identity of a vehicle before the first sample.
_NO_SAMPLE = -2
# What is measured of the own car: the place along and across the line, and the heading.
_ALONG, _ACROSS, _HEADING = range(3)
# Where a car is on the line.
_S, _D, _ANGLE, _GROWTH = range(4)
# Number of quantities on which a driver's steering depends.
_SEEN = 5


class PlaneSamples(NamedTuple):
    """What is measured at T samples of a chain of M vehicles in the plane.

    own: (T, 3) x, y [m] and heading [rad] of the driver's car; ahead: (T, M - 1) positions [m] along the line; all of
    these NaN where not measured; identity, length: (T, M), as in ``Chain``.
    """

    own: Array
    ahead: Array
    identity: Ints
    length: Array


class Plane(NamedTuple):
    """What a filter in the plane keeps from sample to sample, and the arrays that it overwrites.

    mean: (N,) and covariance: (N, N) of the state, N = 4 M + 3; known: (M,) of ``State``; on_line: (4,) own position
    [m] along the line, not wrapped, and across it, angle [rad] of the line there, and growth of ``foot_of``; identity,
    settled, waited: (M,) the vehicle at the sample before, samples since its record began, periods since its first
    position; clock: (1,) time [s]; places: (3, 5) of the steering: two rows for ``predict``, and entries of the state.
    Overwritten: next_mean, slope: (N,); jacobian, noise, half: (N, N); root: (8, 5), chosen: (10,), seen: (5, 5) and
    response: (5,), of the steering; kinematic: (5, 6) of ``drive_jacobian``.
    """

    mean: Array
    covariance: Array
    known: Ints
    on_line: Array
    identity: Ints
    settled: Ints
    waited: Ints
    clock: Array
    next_mean: Array
    slope: Array
    jacobian: Array
    noise: Array
    half: Array
    places: Ints
    root: Array
    chosen: Array
    seen: Array
    response: Array
    kinematic: Array


class PlaneTrace(NamedTuple):
    """Arrays that a run fills, as in `PlaneEstimates`.

    mean: (T, N); covariance: (T, N, N); innovation, innovation_var, log_likelihood: (T, 3) along, across, heading;
    line: (T, 2) position [m] along and across the line; motion: (T, 3) own acceleration and what the driver means to
    do [m/s^2], and the steering angle [rad] of the next period.
    """

    mean: Array
    covariance: Array
    innovation: Array
    innovation_var: Array
    log_likelihood: Array
    line: Array
    motion: Array


@kernel
def plane_for(vehicles: int, start_s: float) -> Plane:
    """Return the arrays of a filter that knows nothing."""
    y = STATE * vehicles
    n, places = y + _BESIDE, np.full((3, _SEEN), -1, np.int64)
    places[0] = np.arange(_SEEN)
    places[2] = np.array([0, y, y + 1, 1, y + 2])
    return Plane(
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(vehicles, np.int64),
        np.array([0.0, 0.0, 0.0, 1.0]),
        np.full(vehicles, _NO_SAMPLE, np.int64),
        np.zeros(vehicles, np.int64),
        np.zeros(vehicles, np.int64),
        np.full(1, start_s),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros((n, n)),
        np.zeros((n, n)),
        places,
        np.zeros((_SEEN + 3, _SEEN)),
        np.zeros(2 * _SEEN),
        np.zeros((_SEEN, _SEEN)),
        np.zeros(_SEEN),
        np.zeros((5, 6)),
    )


# The state along the line.


@kernel(allocates=False)
def _growths(plane: Plane) -> tuple[float, float]:
    """Return the derivatives of the own position along the line by x and y."""
    growth, angle = plane.on_line[_GROWTH], plane.on_line[_ANGLE]
    return growth * math.cos(angle), growth * math.sin(angle)


@kernel(allocates=False)
def _see_along(plane: Plane, chain: State, steering: Steering) -> None:
    """Find where the car is on the line, and fill in the state of the chain along the line."""
    mean, covariance, y = plane.mean, plane.covariance, STATE * len(plane.known)
    if plane.known[0] != UNKNOWN:
        foot = foot_of(mean[0], mean[y], plane.on_line[_S], steering.line)
        for k in range(len(foot)):
            plane.on_line[k] = foot[k]
    by_x, by_y = _growths(plane)
    chain.mean[0] = plane.on_line[_S]
    for i in range(1, y):
        chain.mean[i] = mean[i]
        chain.covariance[0, i] = chain.covariance[i, 0] = by_x * covariance[0, i] + by_y * covariance[y, i]
        for j in range(1, y):
            chain.covariance[i, j] = covariance[i, j]
    along = by_x * covariance[0, 0] + by_y * covariance[y, 0]
    chain.covariance[0, 0] = by_x * along + by_y * (by_x * covariance[0, y] + by_y * covariance[y, y])


# Predict.


@kernel(allocates=False)
def _expect_steering(plane: Plane, steering: Steering) -> tuple[float, float]:
    """Return the expected steering angle [rad] of the next period, and the variance that ``slope`` leaves.

    It depends on the place along and across the line, on heading, speed and steering angle. In these directions, the
    points of the cubature lie alike on both sides of the line.
    """
    work, places, seen, response, slope = plane.root, plane.places, plane.seen, plane.response, plane.slope
    mean, y, angle = plane.mean, STATE * len(plane.known), plane.on_line[_ANGLE]
    cos, sin = math.cos(angle), math.sin(angle)
    for i in range(_SEEN):
        for j in range(_SEEN):
            seen[i, j] = plane.covariance[places[2, i], places[2, j]]
    for j in range(_SEEN):
        seen[0, j], seen[1, j] = cos * seen[0, j] + sin * seen[1, j], cos * seen[1, j] - sin * seen[0, j]
    for i in range(_SEEN):
        seen[i, 0], seen[i, 1] = cos * seen[i, 0] + sin * seen[i, 1], cos * seen[i, 1] - sin * seen[i, 0]
    cholesky(seen, places, _SEEN, work)
    for i in range(_SEEN):
        work[_SEEN, i] = 0.0
    for point in range(2 * _SEEN):
        look_around(work, _SEEN, point)
        look = _SEEN + 1
        along, across = work[look, 0], work[look, 1]
        turned, faster, steered = work[look, 2], work[look, 3], work[look, 4]
        x, at_y = mean[0] + cos * along - sin * across, mean[y] + sin * along + cos * across
        pose = Pose(x, at_y, mean[y + 1] + turned, mean[1] + faster, mean[y + 2] + steered)
        s = plane.on_line[_S] + plane.on_line[_GROWTH] * along
        plane.chosen[point] = mean_steering(pose, s, steering)
    expected, variance = moments(plane.chosen, work[_SEEN + 2], _SEEN)
    regress(work, _SEEN + 2, places, _SEEN, response)
    slope[:] = 0.0
    for i in range(_SEEN):
        slope[places[2, i]] = response[i]
    slope[0], slope[y] = cos * response[0] - sin * response[1], sin * response[0] + cos * response[1]
    return expected, variance


@kernel(allocates=False)
def _linearise(plane: Plane, step: FilterStep, steering: Steering) -> tuple[float, float]:
    """Linearise a period; returns what the driver means to do [m/s^2], and the steering angle [rad]."""
    _see_along(plane, step.state, steering)
    meant = linearise_chain(step)
    by_x, by_y = _growths(plane)
    out, period, y = step.out, step.scene.period_s, STATE * len(plane.known)
    jacobian, noise, next_mean = plane.jacobian, plane.noise, plane.next_mean
    jacobian[:] = 0.0
    noise[:] = 0.0
    for i in range(y):
        next_mean[i] = out.next_mean[i]
        jacobian[i, 0], jacobian[i, y] = out.jacobian[i, 0] * by_x, out.jacobian[i, 0] * by_y
        for j in range(1, y):
            jacobian[i, j] = out.jacobian[i, j]
        for j in range(y):
            noise[i, j] = out.noise[i, j]
    for i in (0, y, y + 1, y + 2):
        next_mean[i] = plane.mean[i]
        jacobian[i, :] = 0.0
        jacobian[i, i] = 1.0
    if plane.known[0] != MOVING:
        return np.nan, np.nan
    angle, variance = _expect_steering(plane, steering)
    pose = Pose(plane.mean[0], plane.mean[y], plane.mean[y + 1], plane.mean[1], angle)
    then = drive(pose, 0.0, steering.car, period)
    drive_jacobian(pose, steering.car, period, plane.kinematic)
    next_mean[0], next_mean[y], next_mean[y + 1], next_mean[y + 2] = then.x, then.y, then.heading, angle
    variance += steering.car[SIGMA_DELTA] ** 2
    noise[y, y] = noise[0, 0]
    rows, by_angle = (0, y, y + 1, y + 2), (plane.kinematic[0, 5], plane.kinematic[1, 5], plane.kinematic[2, 5], 1.0)
    for a in range(4):
        i = rows[a]
        for j in range(len(next_mean)):
            jacobian[i, j] = by_angle[a] * plane.slope[j]
        if a < 3:
            jacobian[i, 0] += plane.kinematic[a, 0]
            jacobian[i, y] += plane.kinematic[a, 1]
            jacobian[i, y + 1] += plane.kinematic[a, 2]
            jacobian[i, 1] += plane.kinematic[a, 3]
        for b in range(4):
            noise[i, rows[b]] += by_angle[a] * by_angle[b] * variance
    return meant, angle


@kernel(allocates=False)
def _predict(plane: Plane) -> None:
    """Go on by the linearised period: F P F' + Q."""
    n = len(plane.mean)
    jacobian, covariance, half = plane.jacobian, plane.covariance, plane.half
    half[:] = 0.0
    for i in range(n):
        for k in range(n):
            if jacobian[i, k] != 0.0:
                for j in range(n):
                    half[i, j] += jacobian[i, k] * covariance[k, j]
    for i in range(n):
        plane.mean[i] = plane.next_mean[i]
        for j in range(i, n):
            total = plane.noise[i, j]
            for k in range(n):
                total += half[i, k] * jacobian[j, k]
            covariance[i, j] = covariance[j, i] = total


# Update.


@kernel(allocates=False)
def _condition(plane: Plane, by: tuple[float, float, float], y: float, noise_var: float) -> float:
    """Take in a measured combination of x, y and heading; returns the variance of its innovation ``y``."""
    covariance, at = plane.covariance, STATE * len(plane.known)
    gain = plane.slope
    for i in range(len(gain)):
        gain[i] = by[0] * covariance[i, 0] + by[1] * covariance[i, at] + by[2] * covariance[i, at + 1]
    variance: float = by[0] * gain[0] + by[1] * gain[at] + by[2] * gain[at + 1] + noise_var
    if not math.isnan(y):
        update(State(plane.mean, covariance, plane.known), gain, y / variance, 1.0 / variance)
    return variance


@kernel(allocates=False)
def _forget(m: int, plane: Plane) -> None:
    """Forget a vehicle, and of the own car also where it is in the plane."""
    forget_vehicle(m, State(plane.mean, plane.covariance, plane.known))
    plane.settled[m] = 0
    if m == 0:
        for k in range(STATE * len(plane.known), len(plane.mean)):
            plane.mean[k] = 0.0
            plane.covariance[k, :] = 0.0
            plane.covariance[:, k] = 0.0


@kernel(allocates=False)
def _start_own(measured: Array, plane: Plane, step: FilterStep, steering: Steering) -> None:
    """Take in a sample of a car that is not moving yet, as ``start_vehicle``, with a heading near that of the line."""
    mean, covariance, y = plane.mean, plane.covariance, STATE * len(plane.known)
    if plane.known[0] == UNKNOWN:
        s, lap = nearest(measured[0], measured[1], steering.line), steering.line.circumference
        if lap > 0.0 and len(plane.known) > 1 and plane.known[1] != UNKNOWN:
            s += lap * math.floor((mean[STATE] - s) / lap)
        plane.on_line[_S], plane.known[0], mean[0], mean[y] = s, POSITION, measured[0], measured[1]
        return
    angle = foot_of(measured[0], measured[1], plane.on_line[_S], steering.line)[2]
    cos, sin = math.cos(angle), math.sin(angle)
    way = cos * (measured[0] - mean[0]) + sin * (measured[1] - mean[y])
    aside = cos * (measured[1] - mean[y]) - sin * (measured[0] - mean[0])
    # along the line as on a road: a car that has gone ``way`` from 0
    step.state.mean[0] = 0.0
    elapsed = plane.waited[0] * step.scene.period_s
    start_vehicle(0, way, elapsed, step.state, step.drivers.parameters, step.scene)
    for i in range(1, STATE):
        mean[i] = step.state.mean[i]
        for j in range(1, STATE):
            covariance[i, j] = step.state.covariance[i, j]
    place_var, with_speed = step.state.covariance[0, 0], step.state.covariance[0, 1]
    # the way aside is a measurement of the heading, with the errors of two positions
    prior_var, two_var = _START_HEADING_STD**2, 2.0 * step.drivers.parameters[0, SIGMA_NU] ** 2
    gain = prior_var * way / (prior_var * way * way + two_var) if prior_var * way * way + two_var > 0.0 else 0.0
    heading_var, with_aside = prior_var * (1.0 - gain * way), gain * 0.5 * two_var
    mean[0], mean[y], mean[y + 1] = measured[0], measured[1], wrapped(angle + gain * aside)
    covariance[0, 0] = covariance[y, y] = place_var
    covariance[0, 1], covariance[y, 1] = cos * with_speed, sin * with_speed
    covariance[0, y + 1], covariance[y, y + 1] = -sin * with_aside, cos * with_aside
    for i in (0, y):
        for j in (1, y + 1):
            covariance[j, i] = covariance[i, j]
    covariance[y + 1, y + 1], covariance[y + 2, y + 2] = heading_var, _START_STEERING_STD**2
    if not math.isnan(measured[2]):
        off = wrapped(measured[2] - mean[y + 1])
        _condition(plane, (0.0, 0.0, 1.0), off, steering.car[SIGMA_PSI] ** 2)


@kernel(allocates=False)
def _compare_own(
    t: int, measured: Array, plane: Plane, step: FilterStep, steering: Steering, trace: PlaneTrace
) -> None:
    """Compare the sample of the own car with its prediction, and take it in."""
    mean, y, parameters = plane.mean, STATE * len(plane.known), step.drivers.parameters[0]
    if plane.known[0] != MOVING:
        if not math.isnan(measured[0]):
            _start_own(measured, plane, step, steering)
            plane.waited[0] = 0
        return
    angle = foot_of(mean[0], mean[y], plane.on_line[_S], steering.line)[2]
    cos, sin, noise_var = math.cos(angle), math.sin(angle), parameters[SIGMA_NU] ** 2
    for k in range(3):
        by = (cos, sin, 0.0) if k == _ALONG else (-sin, cos, 0.0) if k == _ACROSS else (0.0, 0.0, 1.0)
        if k == _HEADING:
            off, noise_var = wrapped(measured[2] - mean[y + 1]), steering.car[SIGMA_PSI] ** 2
        else:
            off = by[0] * (measured[0] - mean[0]) + by[1] * (measured[1] - mean[y])
        variance = _condition(plane, by, off, noise_var)
        trace.innovation[t, k], trace.innovation_var[t, k] = off, variance
        if plane.settled[0] > SETTLING:
            trace.log_likelihood[t, k] = -0.5 * (math.log(variance) + off * off / variance)
    mean[y + 1] = wrapped(mean[y + 1])


@kernel(allocates=False)
def _compare_ahead(m: int, measured: float, plane: Plane, step: FilterStep, steering: Steering) -> None:
    """Compare the sample of vehicle m ahead with its prediction, and take it in; as in ``causal``."""
    parameters, x = step.drivers.parameters, STATE * m
    if math.isnan(measured):
        return
    if plane.known[m] == MOVING:
        state = State(plane.mean, plane.covariance, plane.known)
        off, variance, _ = innovation(m, measured, state, parameters[m], step.scene)
        for i in range(len(plane.mean)):
            plane.slope[i] = plane.covariance[i, x]
        update(state, plane.slope, off / variance, 1.0 / variance)
        return
    chain = step.state
    _see_along(plane, chain, steering)
    start_vehicle(m, measured, plane.waited[m] * step.scene.period_s, chain, parameters, step.scene)
    plane.waited[m] = 0
    for i in range(x, x + STATE):
        plane.mean[i] = chain.mean[i]
        for j in range(x, x + STATE):
            plane.covariance[i, j] = chain.covariance[i, j]


@kernel(allocates=False)
def _take_in(
    t: int, samples: PlaneSamples, plane: Plane, step: FilterStep, steering: Steering, trace: PlaneTrace
) -> None:
    """Take in what is measured at sample t."""
    for m in range(len(plane.known)):
        plane.settled[m] += 1
        plane.waited[m] += 1
        before, identity = plane.identity[m], samples.identity[t, m]
        plane.identity[m] = identity
        if identity < 0 or (before != _NO_SAMPLE and before != identity):
            _forget(m, plane)
        if identity >= 0 and m == 0:
            _compare_own(t, samples.own[t], plane, step, steering, trace)
        elif identity >= 0:
            _compare_ahead(m, samples.ahead[t, m - 1], plane, step, steering)


@kernel(allocates=False)
def _at(t: int, samples: PlaneSamples, plane: Plane, step: FilterStep) -> FilterStep:
    """Return the step of the chain at sample t."""
    return FilterStep(
        State(step.state.mean, step.state.covariance, plane.known),
        step.drivers,
        step.scene,
        step.out,
        step.batch,
        samples.length[t],
        step.around,
        plane.clock[0],
        step.places,
        step.root,
        step.points,
        step.chosen,
        step.slope,
        step.held_slope,
    )


@kernel(allocates=False)
def _record(t: int, meant: float, angle: float, plane: Plane, step: FilterStep, trace: PlaneTrace) -> None:
    """Fill in the trace after the update with sample t."""
    for i in range(len(plane.mean)):
        trace.mean[t, i] = plane.mean[i]
        for j in range(len(plane.mean)):
            trace.covariance[t, i, j] = plane.covariance[i, j]
    if plane.known[0] == MOVING:
        trace.line[t, 0], trace.line[t, 1] = plane.on_line[_S], plane.on_line[_D]
        trace.motion[t, 0] = (plane.next_mean[1] - plane.mean[1]) / step.scene.period_s
        trace.motion[t, 1], trace.motion[t, 2] = meant, angle


@kernel(allocates=False)
def _filter(samples: PlaneSamples, plane: Plane, start: FilterStep, steering: Steering, trace: PlaneTrace) -> None:
    """Go on with the filter over T samples."""
    for t in range(len(samples.own)):
        step = _at(t, samples, plane, start)
        _take_in(t, samples, plane, step, steering, trace)
        meant, angle = _linearise(plane, step, steering)
        _record(t, meant, angle, plane, step, trace)
        _predict(plane)
        plane.clock[0] += step.scene.period_s


@kernel
def run_plane(samples: PlaneSamples, plane: Plane, start: FilterStep, steering: Steering, trace: PlaneTrace) -> None:
    """Go on with the filter over T samples."""
    _filter(samples, plane, start, steering, trace)
