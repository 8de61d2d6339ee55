"""A car in the plane: the kinematic bicycle, and the angle at which its driver steers along a wanted line.

Two wheels stand for four, and no wheel slips. A reference point lies l_f [m] behind the front axle and l_r [m] before
the rear axle. A pose is its place x, y [m] and speed v [m/s], the heading psi [rad] of the car, and the steering angle
delta [rad] of the front wheel. With beta = atan(l_r tan(delta) / (l_f + l_r)),

    x' = v cos(psi + beta), y' = v sin(psi + beta), psi' = v cos(beta) tan(delta) / (l_f + l_r), v' = a.

The driver chooses an acceleration as on a straight road (``utility``), and a steering angle by the same Boltzmann rule.
They look ahead along the wanted line. An angle costs the more, the further from the line it leads by then, and the more
the wheel has to turn.

References
----------
R. Rajamani, Vehicle Dynamics and Control (2006), section 2.2. The terms of the steering utility are ours.
"""

import math
from typing import NamedTuple

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S, Parameter
from sugiyama_ros.driver.utility import advance
from sugiyama_ros.jit import kernel
from sugiyama_ros.trajectories.centre_line import CentreLine

_OURS = "ours, for a passenger car"
#: Declared parameters of a car in the plane and of how its driver steers.
CAR: tuple[Parameter, ...] = (
    Parameter("l_f", "l_f", "m", 1.2, 0.1, 10.0, f"distance from the reference point to the front axle; {_OURS}"),
    Parameter("l_r", "l_r", "m", 1.4, 0.0, 10.0, f"distance from the reference point to the rear axle; {_OURS}"),
    Parameter(
        "kappa_y", "κ_y", "m", 1.75, 0.05, 50.0, "distance from the wanted line, after the look-ahead, that costs 1"
    ),
    Parameter("kappa_delta", "κ_δ", "rad", 0.3, 0.01, 10.0, "change of the steering angle in one period that costs 1"),
    Parameter("look_ahead", "l_0", "m", 6.0, 1.0, 100.0, "least distance that a driver looks ahead along the line"),
    Parameter("sigma_delta", "σ_δ", "rad", 0.005, 0.0, 0.5, "std of the steering noise in one period"),
    Parameter("sigma_psi", "σ_ψ", "rad", 0.03, 0.0, 3.0, "std of the noise of a measured heading"),
)
# Indices in the vector of a car.
L_F, L_R, KAPPA_Y, KAPPA_DELTA, LOOK_AHEAD, SIGMA_DELTA, SIGMA_PSI = range(len(CAR))

# Candidate angles on either side of straight ahead. They reach as far as wheels turn [rad], and no further than what
# leads to this distance [m] aside after the look-ahead: at speed, a lateral acceleration of 4 m/s^2.
_CANDIDATES, _MOST_STEERING, _MOST_ASIDE_M = 20, 0.6, 3.5
# Distance [m] between two points of a ``WantedLine``, at most; steps of the search for the foot of a perpendicular.
_SPACING_M, _STEPS = 0.5, 4
# Below this angle u [rad], -u / 3 is nearer to the derivative of sin(u) / u than the formula, which rounds.
_SMALL = 1e-4


def car_of(**values: float) -> Array:
    """Return the parameters of a car at the reference period, the declared ones where they are left out."""
    return np.array([values.get(p.name, p.default) for p in CAR])


def car_at_period(parameters: Array, period_s: float) -> Array:
    """Rescale the parameters of a car to a period: changes of the steering angle keep their squares per second."""
    scaled = parameters.copy()
    scaled[[KAPPA_DELTA, SIGMA_DELTA]] *= math.sqrt(period_s / REFERENCE_PERIOD_S)
    return scaled


# The wanted line.


class WantedLine(NamedTuple):
    """A centre line at evenly spaced points, for compiled code; ``wanted_line`` makes it.

    x, y, angle: (P,) of the points [m] and the line [rad]; spacing: distance [m] between two points; circumference:
    length [m] of a ring, 0 for an open road.
    """

    x: Array
    y: Array
    angle: Array
    spacing: float
    circumference: float


def wanted_line(line: CentreLine) -> WantedLine:
    """Take points of a centre line."""
    pieces = math.ceil(line.length_m / _SPACING_M)
    s = np.linspace(0.0, line.length_m, pieces + 1, dtype=np.float64)
    x, y = line.at(s, np.zeros(len(s)))
    return WantedLine(
        x, y, np.asarray(np.unwrap(line.heading(s)), np.float64), line.length_m / pieces, line.road.circumference_m
    )


@kernel
def point_at(s: float, line: WantedLine) -> tuple[float, float, float, float]:
    """Return the point (x, y) [m] at a position [m] along a line, its angle [rad] and its turn [rad/m] there.

    Beyond the ends of an open road, it goes straight on.
    """
    pieces, beyond = len(line.x) - 1, 0.0
    if line.circumference > 0.0:
        s -= line.circumference * math.floor(s / line.circumference)
    else:
        beyond = s - min(max(s, 0.0), line.spacing * pieces)
        s -= beyond
    k = min(int(s / line.spacing), pieces - 1)
    part, turn = s / line.spacing - k, (line.angle[k + 1] - line.angle[k]) / line.spacing
    angle = line.angle[k] + part * (line.angle[k + 1] - line.angle[k])
    x = line.x[k] + part * (line.x[k + 1] - line.x[k]) + beyond * math.cos(angle)
    y = line.y[k] + part * (line.y[k + 1] - line.y[k]) + beyond * math.sin(angle)
    return x, y, angle, turn if beyond == 0.0 else 0.0


@kernel
def foot_of(x: float, y: float, near: float, line: WantedLine) -> tuple[float, float, float, float]:
    """Find the position [m] along a line that is nearest to a point (x, y) [m], from a position that is ``near``.

    Returns the position; how far [m] the point is to the left of the line; the angle [rad] of the line; and by how much
    the position grows [m/m] when the point goes along the line.
    """
    s, across, angle, growth = near, 0.0, 0.0, 1.0
    for k in range(_STEPS + 1):
        at_x, at_y, angle, turn = point_at(s, line)
        ahead = math.cos(angle) * (x - at_x) + math.sin(angle) * (y - at_y)
        across = math.cos(angle) * (y - at_y) - math.sin(angle) * (x - at_x)
        growth = 1.0 / max(1.0 - turn * across, 0.2)
        if k < _STEPS:
            s += ahead * growth
    return s, across, angle, growth


@kernel
def nearest(x: float, y: float, line: WantedLine) -> float:
    """Return the position [m] along a line that is nearest to a point (x, y) [m]."""
    best = 0
    for k in range(len(line.x)):
        if (x - line.x[k]) ** 2 + (y - line.y[k]) ** 2 < (x - line.x[best]) ** 2 + (y - line.y[best]) ** 2:
            best = k
    return foot_of(x, y, best * line.spacing, line)[0]


# The car.


class Pose(NamedTuple):
    """A car in the plane: x, y [m], heading [rad], speed [m/s] and steering angle [rad]."""

    x: float
    y: float
    heading: float
    speed: float
    steering: float


@kernel
def wrapped(angle: float) -> float:
    """Wrap an angle [rad] to (-pi, pi]."""
    return angle - 2.0 * math.pi * math.ceil((angle - math.pi) / (2.0 * math.pi))


@kernel
def slip_and_turn(steering: float, car: Array) -> tuple[float, float]:
    """Return the angle [rad] between course and heading, and the turn of the heading [rad/m], at a steering angle."""
    wheelbase, tangent = car[L_F] + car[L_R], math.tan(steering)
    slip = math.atan(car[L_R] * tangent / wheelbase)
    return slip, math.cos(slip) * tangent / wheelbase


@kernel
def arc(heading: float, way: float, steering: float, car: Array) -> tuple[float, float, float]:
    """Return how far [m] a car gets in x and in y, and by how much [rad] it turns, in a ``way`` [m] along an arc."""
    slip, per_metre = slip_and_turn(steering, car)
    half = 0.5 * way * per_metre
    chord = way * (math.sin(half) / half if half != 0.0 else 1.0)
    return chord * math.cos(heading + slip + half), chord * math.sin(heading + slip + half), 2.0 * half


@kernel
def drive(pose: Pose, acceleration: float, car: Array, period: float) -> Pose:
    """Return the pose one period [s] later, at an acceleration [m/s^2] and with the steering angle held.

    The way is the way of ``utility.advance``: Euler's rule, with the speed before. The steering angle is held, so that
    the car goes along the arc of a circle, and this arc is exact.
    """
    way, speed = advance(0.0, pose.speed, acceleration, period)
    x, y, turn = arc(pose.heading, way, pose.steering, car)
    return Pose(pose.x + x, pose.y + y, wrapped(pose.heading + turn), speed, pose.steering)


@kernel
def drive_jacobian(pose: Pose, car: Array, period: float, jacobian: Array) -> None:
    """Fill in the derivatives (5, 6) of ``drive`` by x, y, heading, speed, acceleration and steering angle."""
    wheelbase, rear, tangent = car[L_F] + car[L_R], car[L_R] / (car[L_F] + car[L_R]), math.tan(pose.steering)
    slip, per_metre = slip_and_turn(pose.steering, car)
    by_angle = 1.0 + tangent * tangent
    slip_rate = rear * by_angle / (1.0 + (rear * tangent) ** 2)
    turn_rate = (math.cos(slip) * by_angle - math.sin(slip) * slip_rate * tangent) / wheelbase
    way = period * pose.speed
    half = 0.5 * way * per_metre
    ratio = math.sin(half) / half if half != 0.0 else 1.0
    ratio_rate = (math.cos(half) - ratio) / half if abs(half) > _SMALL else -half / 3.0
    chord, course = way * ratio, pose.heading + slip + half
    cos, sin = math.cos(course), math.sin(course)
    half_by_speed, half_by_angle = 0.5 * period * per_metre, 0.5 * way * turn_rate
    chord_by_speed = period * ratio + way * ratio_rate * half_by_speed
    chord_by_angle, course_by_angle = way * ratio_rate * half_by_angle, slip_rate + half_by_angle
    jacobian[:] = 0.0
    for k in range(5):
        jacobian[k, k if k < 4 else 5] = 1.0
    jacobian[0, 2], jacobian[1, 2] = -chord * sin, chord * cos
    jacobian[0, 3] = chord_by_speed * cos - chord * sin * half_by_speed
    jacobian[1, 3] = chord_by_speed * sin + chord * cos * half_by_speed
    jacobian[0, 5] = chord_by_angle * cos - chord * sin * course_by_angle
    jacobian[1, 5] = chord_by_angle * sin + chord * cos * course_by_angle
    jacobian[2, 3], jacobian[2, 5] = 2.0 * half_by_speed, 2.0 * half_by_angle
    jacobian[3, 4] = period


# The driver.


class Steering(NamedTuple):
    """What a driver needs to steer besides the pose.

    line: the wanted line; car: parameters of the car (``CAR``) at the period; rationality: of the driver;
    horizon_s: time [s] of the look-ahead.
    """

    line: WantedLine
    car: Array
    rationality: float
    horizon_s: float


@kernel
def mean_steering(pose: Pose, s: float, steering: Steering) -> float:
    """Return the Boltzmann mean [rad] of the steering angles that a driver considers.

    pose: the car; s: its position [m] along the wanted line. The utility of holding an angle is
    -(d / kappa_y)^2 - (change / kappa_delta)^2, where d [m] is the distance across the line after the
    look-ahead, and the change is that of the steering angle [rad].
    """
    line, car, rationality, horizon_s = steering
    way = max(pose.speed * horizon_s, car[LOOK_AHEAD])
    at_x, at_y, angle, _ = point_at(s + way, line)
    cos, sin = math.cos(angle), math.sin(angle)
    off = cos * (pose.y - at_y) - sin * (pose.x - at_x)
    tightest = math.atan((car[L_F] + car[L_R]) * 2.0 * _MOST_ASIDE_M / (way * way))
    step = min(tightest, _MOST_STEERING) / _CANDIDATES
    best, total, weighted = -np.inf, 0.0, 0.0
    for k in range(-_CANDIDATES, _CANDIDATES + 1):
        x, y, _ = arc(pose.heading, way, k * step, car)
        d = (off + cos * y - sin * x) / car[KAPPA_Y]
        change = (k * step - pose.steering) / car[KAPPA_DELTA]
        utility = -rationality * (d * d + change * change)
        if utility > best:
            shrink = math.exp(best - utility)
            total, weighted, best = total * shrink, weighted * shrink, utility
        weight = math.exp(utility - best)
        total += weight
        weighted += weight * (k * step)
    return weighted / total
