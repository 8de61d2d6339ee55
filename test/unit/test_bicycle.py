"""A car in the plane: the bicycle against a published one, the filter against the base filter, and NIS on curves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_ks import vehicle_dynamics_ks

import sugiyama_ros as sg
from benchmarks.bicycle import LENGTH_M, LINES, PERIODS_S, SEEDS, driven, filter_of, nis, ring, s_curve
from sugiyama_ros.driver.bicycle import (
    L_F,
    L_R,
    Pose,
    car_of,
    drive,
    drive_jacobian,
    slip_and_turn,
    wrapped,
)
from sugiyama_ros.driver.parameters import (
    defaults,
    population,
)
from sugiyama_ros.driver.utility import advance
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.plane import PlaneFilter, PlaneTrack
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.trajectories.centre_line import CentreLine

# The car.


def after(period_s: float, acceleration: float, steering_rate: float) -> np.ndarray:
    """Rear axle x, y [m], its heading [rad] and speed [m/s] after 4 s; the steering angle is held in each period."""
    car = car_of()
    pose = Pose(0.0, 0.0, 0.2, 8.0, 0.05)
    for k in range(round(4.0 / period_s)):
        pose = drive(pose._replace(steering=0.05 + steering_rate * k * period_s), acceleration, car, period_s)
    slip = slip_and_turn(0.05 + steering_rate * 4.0, car)[0]
    behind = car[L_R] * np.array([math.cos(pose.heading), math.sin(pose.heading)])
    return np.array([pose.x - behind[0], pose.y - behind[1], pose.heading, pose.speed * math.cos(slip)])


def published(acceleration: float, steering_rate: float) -> np.ndarray:
    """The same by commonroad-vehicle-models, which has the rear axle as its reference point."""
    p = parameters_vehicle2()
    car = car_of()
    p.a, p.b = float(car[L_F]), float(car[L_R])

    def motion(t: float, state: np.ndarray) -> list[float]:
        slip, rate = slip_and_turn(state[2], car)[0], 1e-6
        slip_rate = (slip_and_turn(state[2] + rate, car)[0] - slip_and_turn(state[2] - rate, car)[0]) / (2.0 * rate)
        speed = 8.0 + acceleration * t  # of the reference point; the rear axle goes cos(slip) times as fast
        of_rear = acceleration * math.cos(slip) - speed * math.sin(slip) * slip_rate * steering_rate
        return vehicle_dynamics_ks(state, [steering_rate, of_rear], p)

    start = [
        -car[L_R] * math.cos(0.2),
        -car[L_R] * math.sin(0.2),
        0.05,
        8.0 * math.cos(slip_and_turn(0.05, car)[0]),
        0.2,
    ]
    x, y, _, speed, heading = solve_ivp(motion, (0.0, 4.0), start, rtol=1e-10, atol=1e-11).y[:, -1]
    return np.array([x, y, heading, speed])


def test_a_steady_curve_is_exact() -> None:
    assert after(1.0 / 3.0, 0.0, 0.0) == pytest.approx(published(0.0, 0.0), abs=1e-8)


def test_the_car_agrees_with_a_published_one_to_first_order() -> None:
    """Where speed or steering changes, halving the period halves the difference, as Euler's rule does."""
    end = published(0.8, 0.03)
    coarse, fine = (np.abs(after(period_s, 0.8, 0.03) - end)[:3] for period_s in (0.02, 0.01))
    assert (fine < 0.1).all()
    assert coarse / fine == pytest.approx(2.0, abs=0.02)


def test_straight_on_is_the_rule_of_the_base_model() -> None:
    pose = drive(Pose(3.1, 0.0, 0.0, 7.7, 0.0), 0.61, car_of(), 1.0 / 3.0)
    assert (pose.x, pose.speed) == advance(3.1, 7.7, 0.61, 1.0 / 3.0)


@pytest.mark.parametrize("steering", [0.0, 1e-5, 0.03, -0.5])
@pytest.mark.parametrize("speed", [-1.0, 0.0, 12.0])
def test_the_jacobian_is_that_of_finite_differences(speed: float, steering: float) -> None:
    at = np.array([5.0, -2.0, 0.7, speed, 0.4, steering])

    def drive_from(state: np.ndarray) -> np.ndarray:
        x, y, heading, speed, acceleration, steering = state.tolist()
        return np.array(drive(Pose(x, y, heading, speed, steering), acceleration, car_of(), 0.3))

    jacobian, step = np.zeros((5, 6)), 1e-5
    drive_jacobian(Pose(*at[:4].tolist(), steering), car_of(), 0.3, jacobian)
    for k, unit in enumerate(np.eye(6)):
        slope = (drive_from(at + step * unit) - drive_from(at - step * unit)) / (2.0 * step)
        assert jacobian[:, k] == pytest.approx(slope, abs=1e-8)


def test_headings_are_wrapped() -> None:
    assert wrapped(math.pi) == math.pi
    assert wrapped(-math.pi) == math.pi
    assert wrapped(7.0) == pytest.approx(7.0 - 2.0 * math.pi)


# The filter.


@pytest.mark.parametrize(("degrees", "effect"), [(0.0, ""), (30.0, ""), (30.0, "drag")])
def test_on_a_straight_line_the_filter_is_the_base_filter(degrees: float, effect: str) -> None:
    start = platoon(np.full(5, LENGTH_M), 2.0)
    simulated = simulate(Simulator(defaults(5), np.full(5, LENGTH_M), start, Road(), np.random.default_rng(0)), 100.0)
    chain = chain_behind(simulated.dense, 0, with_rear=False)
    position, identity = chain.position_m.copy(), chain.identity.copy()
    position[np.random.default_rng(1).random(position.shape) < 0.1] = np.nan
    identity[200:, 2] = 9  # another vehicle
    chain = replace(chain, position_m=position, identity=identity)
    row = switch_on(ROW.with_effects(population()), effect, {"c0": 0.3}) if effect else population()
    base = filter_chain(chain, row)
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    line = CentreLine(np.array([0.0, 3000.0]) * cos, np.array([0.0, 3000.0]) * sin)
    track = PlaneTrack(position[:, 0] * cos, position[:, 0] * sin, None, position[:, 1:], identity, LENGTH_M)
    found = PlaneFilter(line, chain.period_s, 3, row).run(track)
    known, size = np.isfinite(base.innovation_var), base.mean.shape[1]
    along = np.zeros((size, found.mean.shape[1]))  # the state along the line
    along[:, :size] = np.eye(size)
    along[0, [0, size]] = cos, sin
    mean = found.mean[:, :size].copy()
    mean[:, 0] = found.s_m
    covariance = along @ found.covariance @ along.T
    assert known.sum() > 290
    assert mean[known] == pytest.approx(base.mean[known], abs=1e-9)
    assert covariance[known] == pytest.approx(base.covariance[known], abs=1e-9)
    assert found.acceleration[known] == pytest.approx(base.acceleration[known], abs=1e-9)
    assert found.mean_action[known] == pytest.approx(base.mean_action[known], abs=1e-9)
    for mine, theirs in (
        (found.innovation, base.innovation_m),
        (found.innovation_var, base.innovation_var),
        (found.sample_log_likelihood, base.sample_log_likelihood),
    ):
        assert mine[:, 0] == pytest.approx(theirs, abs=1e-9, nan_ok=True)
    assert np.nansum(found.sample_log_likelihood[:, 0]) == pytest.approx(base.log_likelihood, abs=1e-9)
    assert np.abs(found.d_m[known]).max() < 1e-9


@pytest.mark.parametrize("period_s", PERIODS_S)
@pytest.mark.parametrize("name", LINES)
def test_nis_on_curves_is_in_its_band(name: str, period_s: float) -> None:
    each = nis(LINES[name], period_s, SEEDS[:50])
    low, high = chi2.ppf([0.025, 0.975], len(each)) / len(each)
    assert low < each.mean() < high


def test_nis_tells_a_driver_who_looks_further_ahead_from_one_who_does_not() -> None:
    each = nis(s_curve(), 0.1, SEEDS[:50], look_ahead=15.0)
    assert each.mean() > chi2.ppf(0.9999, len(each)) / len(each)


def test_a_predicted_path_is_what_the_filter_expects_without_measurements() -> None:
    line = ring()
    one = driven(line, 0.1, 3)
    filter_ = filter_of(line, 0.1, one)
    found = filter_.run(one.track)
    path = filter_.predicted_path(2.0)
    missing = PlaneTrack(*np.full((3, 20), np.nan), np.full((20, 2), np.nan), length_m=LENGTH_M)
    assert path.time_s[0] == pytest.approx(found.time_s[-1] + 0.1)
    assert np.array_equal(path.mean, filter_.run(missing).mean)
    assert np.abs(path.d_m).max() < 1.0
    assert path.s_m[-1] - found.s_m[-1] == pytest.approx(2.0 * found.speed[-1], rel=0.2)


def test_the_python_interface() -> None:
    turned = 0.8 * np.arange(150) / 36.6
    angle = np.linspace(0.0, 2.0 * np.pi, 361)
    circle = 36.6 * np.column_stack([np.cos(angle), np.sin(angle)])
    x_m, y_m = 36.6 * np.cos(turned), 36.6 * np.sin(turned)
    found = sg.filter_plane(x_m, y_m, circle, 0.1, parameters={"v_star": 8.0, "l_r": 1.3})
    assert found.speed[-1] == pytest.approx(8.0, abs=0.2)
    # the reference point turns with the line
    assert wrapped(found.heading[-1] - turned[-1] - np.pi / 2.0) == pytest.approx(-1.3 / 36.6, abs=0.02)
    assert found.steering[-1] == pytest.approx(2.5 / 36.6, abs=0.02)
    assert len(found.to_frame()) == 150
    assert found.plot() is not None
    gone, far = turned.copy(), turned.copy()
    gone[7], far[7] = -np.inf, 1e131
    for bad, told in (
        ({"heading": turned[:9]}, "heading: has shape"),
        ({"ahead_m": turned[:9]}, "ahead_m: has shape"),
        ({"parameters": {"l_r": -1.0}}, "l_r: -1 m is out of bounds; give 0 to 10 m"),
        ({"parameters": {"v": 1.0}}, "'v' is not known"),
        ({"heading": gone}, "heading: is infinite at sample 7"),
        ({"ahead_m": gone}, "ahead_m: is infinite at sample 7"),
        ({"ahead_m": far}, "ahead_m is impossible in 1 of 150 rows"),
        ({"length_m": -1.0}, "length_m: -1 is no length of a vehicle"),
        ({"length_m": np.nan}, "length_m: nan is no length of a vehicle"),
    ):
        with pytest.raises(InputError, match=told):
            sg.filter_plane(x_m, y_m, circle, 0.1, **bad)
    with pytest.raises(InputError, match="x_m: is infinite at sample 7"):
        sg.filter_plane(gone, y_m, circle, 0.1)


def test_effects_that_the_filter_does_not_know_are_refused() -> None:
    row = switch_on(ROW.with_effects(defaults()), "outlier_noise", {"share": 0.03, "factor": 3.0})
    with pytest.raises(InputError, match="outlier_noise"):
        PlaneFilter(ring(), 0.1, 2, row)
