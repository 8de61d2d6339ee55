"""How well the filter in the plane knows simulated drivers, and what it costs; the figures of docs/bicycle.md.

    python -m benchmarks.bicycle

Drivers steer along a ring of 230 m or an S-curve behind two others, 400 samples each. All that is measured has noise:
0.26 m for places, 0.03 rad for headings. The filters know the drivers' parameters.
"""

import math
import time
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.bicycle import (
    SIGMA_DELTA,
    SIGMA_PSI,
    Pose,
    Steering,
    car_at_period,
    car_of,
    drive,
    foot_of,
    mean_steering,
    wanted_line,
    wrapped,
)
from sugiyama_ros.driver.parameters import (
    RATIONALITY,
    RHO,
    SIGMA_A,
    SIGMA_NU,
    SIGMA_V,
    SIGMA_X,
    V_STAR,
    at_period,
    defaults,
    horizon_at,
)
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.filters.plane import PlaneFilter, PlaneTrack
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Clock, Simulator
from sugiyama_ros.trajectories.centre_line import CentreLine

LENGTH_M, SAMPLES = 4.33, 400
PERIODS_S = (1.0 / 3.0, 0.1)
SEEDS = range(1000, 1400)
# Samples after which a filter is judged, and between two predictions; times [s] after which these are judged.
_SETTLED, _EVERY, _AFTER_S = 50, 25, (1, 2, 3)
# Squared distance in standard deviations within which 95 % of a normal distribution in the plane lie.
_ELLIPSE = 5.991


def ring() -> CentreLine:
    """A circle of the length of the Sugiyama experiment's ring."""
    angle = np.linspace(0.0, 2.0 * np.pi, 721, dtype=np.float64)
    x, y = 36.6 * np.cos(angle), 36.6 * np.sin(angle)
    x[-1], y[-1] = x[0], y[0]
    return CentreLine(x, y)


def s_curve() -> CentreLine:
    """Bends to the left and to the right in turn, with a radius of 40 m at the tightest."""
    angle = np.cumsum(np.sin(2.0 * np.pi * np.arange(2400.0) / 120.0) / 40.0)
    return CentreLine(np.cumsum(np.cos(angle)), np.cumsum(np.sin(angle)))


LINES = {"ring": ring(), "S-curve": s_curve()}


@dataclass(frozen=True, eq=False)
class Driven:
    """A simulated driver: what is measured; true places x, y [m] and headings, (T, 3); the drivers' row (P,)."""

    track: PlaneTrack
    truth: Array
    row: Array


def driven(line: CentreLine, period_s: float, seed: int) -> Driven:
    """Simulate a driver in the plane behind two vehicles."""
    rng, row, car = np.random.default_rng(seed), defaults(), car_of()
    row[V_STAR] = 8.0
    p, c, horizon = at_period(row, period_s), car_at_period(car, period_s), horizon_at(period_s)
    steering = Steering(wanted_line(line), c, float(row[RATIONALITY]), horizon * period_s)
    start, length = np.array([20.0, 35.0]), np.full(2, LENGTH_M)
    noises = np.random.default_rng(seed + 100)
    ahead = Simulator(np.tile(row, (2, 1)), length, start, Road(), noises, speed=np.full(2, 4.8), clock=Clock(period_s))
    x, y = line.at(np.array([5.0]), np.zeros(1))
    pose, s, noise = Pose(float(x[0]), float(y[0]), float(line.heading(np.array([5.0]))[0]), 4.8, 0.0), 5.0, 0.0
    truth, places = np.zeros((SAMPLES, 3)), np.zeros((SAMPLES, 2))
    for t in range(SAMPLES):
        s = foot_of(pose.x, pose.y, s, steering.line)[0]
        truth[t], places[t] = pose[:3], ahead.position_m
        gap, leader_speed = float(ahead.position_m[0]) - s - LENGTH_M, float(ahead.speed[0])
        meant = mean_action(gap, pose.speed, leader_speed, p, ACTIONS, period_s, horizon)
        angle = mean_steering(pose, s, steering) + c[SIGMA_DELTA] * rng.standard_normal()
        pose = drive(pose._replace(steering=angle), meant + noise, c, period_s)
        x_noise, y_noise, v_noise, shock = rng.standard_normal(4) * p[[SIGMA_X, SIGMA_X, SIGMA_V, SIGMA_A]]
        pose = pose._replace(x=pose.x + x_noise, y=pose.y + y_noise, speed=pose.speed + v_noise)
        noise = p[RHO] * noise + shock
        ahead.step()
    x_m, y_m = truth[:, :2].T + row[SIGMA_NU] * rng.standard_normal((2, SAMPLES))
    heading = truth[:, 2] + car[SIGMA_PSI] * rng.standard_normal(SAMPLES)
    ahead_m = line.road.wrap(places + row[SIGMA_NU] * rng.standard_normal(places.shape))
    return Driven(PlaneTrack(x_m, y_m, heading, ahead_m, length_m=LENGTH_M), truth, row)


def filter_of(line: CentreLine, period_s: float, one: Driven, **car: float) -> PlaneFilter:
    """Make the filter of a driver, who is known but for what is given of the car."""
    return PlaneFilter(line, period_s, CHAIN, one.row, one.row, car_of(**car))


def nis(line: CentreLine, period_s: float, seeds: range, **car: float) -> Array:
    """Normalised innovation squared of each number that was measured of drivers, (K,)."""
    each = []
    for seed in seeds:
        one = driven(line, period_s, seed)
        found = filter_of(line, period_s, one, **car).run(one.track)
        counts = np.isfinite(found.sample_log_likelihood)
        each.append(found.innovation[counts] ** 2 / found.innovation_var[counts])
    return np.concatenate(each)


def heading_std(line: CentreLine, period_s: float, seeds: range, measured: bool) -> float:
    """Standard deviation [rad] of the errors of the heading, with measured headings or without."""
    errors = []
    for seed in seeds:
        one = driven(line, period_s, seed)
        found = filter_of(line, period_s, one).run(one.track if measured else replace(one.track, heading=None))
        errors += [wrapped(off) for off in (found.heading - one.truth[:, 2])[_SETTLED:].tolist()]
    return float(np.std(errors))


def paths(line: CentreLine, period_s: float, seeds: range) -> dict[int, tuple[float, float, int]]:
    """Share of true places in the 95 % ellipse of predicted ones, rms error [m], and number, by time ahead [s]."""
    squares: dict[int, list[float]] = defaultdict(list)
    inside: dict[int, list[bool]] = defaultdict(list)
    for seed in seeds:
        one = driven(line, period_s, seed)
        filter_ = filter_of(line, period_s, one)
        for end in range(_EVERY, SAMPLES - round(_AFTER_S[-1] / period_s), _EVERY):
            filter_.run(_part(one.track, end - _EVERY, end))
            if end < _SETTLED:
                continue
            path = filter_.predicted_path(_AFTER_S[-1])
            for after_s in _AFTER_S:
                k = round(after_s / period_s) - 1
                off = np.array([path.x_m[k], path.y_m[k]]) - one.truth[end + k, :2]
                covariance = path.covariance[k][np.ix_([0, -3], [0, -3])]
                squares[after_s].append(float(off @ off))
                inside[after_s].append(bool(off @ np.linalg.solve(covariance, off) < _ELLIPSE))
    return {t: (float(np.mean(inside[t])), math.sqrt(np.mean(squares[t])), len(inside[t])) for t in _AFTER_S}


def _part(track: PlaneTrack, start: int, end: int) -> PlaneTrack:
    """Some samples of a track."""
    x_m, y_m, heading, ahead_m = (getattr(track, name)[start:end] for name in ("x_m", "y_m", "heading", "ahead_m"))
    return PlaneTrack(x_m, y_m, heading, ahead_m, length_m=LENGTH_M)


def cost_us(rounds: int = 41) -> tuple[float, float, float]:
    """CPU time [µs] for each sample of the filter in the plane and of the base filter, and the ratio, interleaved."""
    line, period_s = ring(), 0.1
    one = driven(line, period_s, 0)
    assert one.track.ahead_m is not None
    along = line.project(one.track.x_m, one.track.y_m)[0]
    position, shape = np.column_stack([along, one.track.ahead_m]), (SAMPLES, CHAIN)
    identity, length = np.tile(np.arange(CHAIN), (SAMPLES, 1)), np.full(shape, LENGTH_M)
    nobody = np.full((SAMPLES, 3), np.nan)
    chain = Chain(position, identity, length, nobody, period_s, 0.0, line.road.circumference_m)
    filters = [filter_of(line, period_s, one) for _ in range(rounds)]
    spent = np.array([[_spent(f.run, one.track), _spent(filter_chain, chain, one.row, ahead=one.row)] for f in filters])
    plane, base = np.median(spent, axis=0) / SAMPLES * 1e6
    return float(plane), float(base), float(np.median(spent[:, 0] / spent[:, 1]))


def _spent(function: Any, *given: Any, **named: Any) -> float:
    """CPU time [s] of a call."""
    before = time.process_time()
    function(*given, **named)
    return time.process_time() - before


def main() -> None:
    """Print all figures."""
    for name, line in LINES.items():
        for period_s in PERIODS_S:
            each = nis(line, period_s, SEEDS)
            low, high = chi2.ppf([0.025, 0.975], len(each)) / len(each)
            print(
                f"{name}, {period_s:.2f} s: NIS {each.mean():.4f} of {len(each)} numbers, band {low:.4f} to {high:.4f}"
            )
            stds = [heading_std(line, period_s, SEEDS[:20], measured) for measured in (True, False)]
            print(f"    heading {stds[0]:.4f} rad, {stds[1]:.4f} rad where it is not measured")
            for after_s, (share, rms_m, count) in paths(line, period_s, SEEDS[:20]).items():
                print(f"    after {after_s} s: {100.0 * share:.1f} % of {count} inside, rms {rms_m:.2f} m")
    print(f"S-curve, 0.10 s, a look-ahead of 15 m: NIS {nis(s_curve(), 0.1, SEEDS[:50], look_ahead=15.0).mean():.3f}")
    cost_us(3)
    print("{:.1f} µs, {:.1f} µs, ratio {:.2f}".format(*cost_us()))


if __name__ == "__main__":
    main()
