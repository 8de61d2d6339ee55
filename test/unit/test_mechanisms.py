"""Mechanisms in drivers of a second generator, written apart from the package's formulas, in numpy alone."""

import numpy as np
import pytest
from scipy.stats import chi2

from sugiyama_ros.driver.parameters import defaults, index
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.causal import log_likelihood
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly
from sugiyama_ros.trajectories.dense import DenseTracks

PERIOD_S, HORIZON, CARS, RING_M, LENGTH_M = 1.0 / 3.0, 4, 10, 160.0, 4.33


def risk(gap, speed, leader_speed, kappa_v):
    """Largest exp(-r (r + 2)) over the look-ahead, for all cars (N, 1) and actions (41,)."""
    found = 0.0
    for tau in range(1, HORIZON + 1):
        later = speed + tau * PERIOD_S * ACTIONS
        ahead = gap + PERIOD_S * tau * (leader_speed - speed) - PERIOD_S**2 * ACTIONS * tau * (tau - 1) / 2
        ratio = np.maximum(ahead / (0.4 + kappa_v * abs(later) + np.maximum(later - leader_speed, 0.0)), 0.0)
        found = np.maximum(found, np.exp(-ratio * (ratio + 2.0)))
    return found


def second_generator(seed, *, delay_s=0.0, second=0.0, duration_s=80.0):
    """Measured positions (T, N) of drivers who see others late, or who fear the second vehicle ahead, too."""
    rng = np.random.default_rng(seed)
    x, v, noise, kappa_v = np.arange(CARS) * RING_M / CARS, np.full(CARS, 5.0), np.zeros(CARS), 0.4
    seen, positions = [], []
    for t in range(round(duration_s / PERIOD_S)):
        ahead = np.append(x[1:], x[0] + RING_M)
        seen.append((ahead - x - LENGTH_M, np.roll(v, -1)))
        assert (seen[-1][0] > 0.0).all()
        positions.append(x)
        whole, part = divmod(delay_s / PERIOD_S, 1.0)
        late, later = seen[max(t - int(whole), 0)], seen[max(t - int(whole) - 1, 0)]
        gap, leader_speed = ((1.0 - part) * a + part * b for a, b in zip(late, later, strict=True))
        speed = v[:, None]
        utility = np.exp(-(((speed + PERIOD_S * ACTIONS - 10.26) / (0.7 * 10.26)) ** 2))
        utility -= np.exp(np.minimum(-10.0 * (speed + PERIOD_S * ACTIONS + 0.25), 500.0))
        utility -= 10.0 * risk(gap[:, None], speed, leader_speed[:, None], kappa_v)
        if second:
            both = 0.5 * (seen[t][0] + np.roll(seen[t][0], -1))
            utility -= 10.0 * second * risk(both[:, None], speed, np.roll(v, -2)[:, None], kappa_v)
        weight = np.exp(100.0 * (utility - utility.max(axis=1, keepdims=True)))
        noise = 0.7 * noise + 0.4 * rng.standard_normal(CARS)
        acceleration = (weight @ ACTIONS) / weight.sum(axis=1) + noise
        x, v = x + PERIOD_S * v, v + PERIOD_S * acceleration
    return np.array(positions) + 0.1 * rng.standard_normal((len(positions), CARS))


def recorded(positions):
    road = Road(RING_M)
    return DenseTracks(
        position_m=road.wrap(positions),
        length_m=np.full(CARS, LENGTH_M),
        vehicle=np.arange(CARS),
        road=road,
        period_s=PERIOD_S,
        start_s=0.0,
        source="second generator",
    )


def rows_of(**values):
    rows = ROW.with_effects(defaults(CARS))
    true = {"kappa_v": 0.4, "sigma_a": 0.4, "sigma_nu": 0.1, "sigma_x": 1e-3, "sigma_v": 1e-3, **values}
    for name, value in true.items():
        rows[:, index(name)] = value
    return rows


def total(measured, rows):
    return sum(log_likelihood(chain_behind(measured, i), rows[i], rows[i]) for i in range(CARS))


@pytest.mark.parametrize("delay_s", [0.5, 1.0])
def test_the_likelihood_is_largest_at_the_delay_of_the_second_generator(delay_s):
    measured, rows = recorded(second_generator(4, delay_s=delay_s)), rows_of()
    delays = delay_s + np.array([-0.3, -0.15, 0.0, 0.15, 0.3])
    found = [total(measured, switch_on(rows, "reaction_delay_others", {"delay": d})) for d in delays]
    # Wilks: the likelihood at the truth is rarely (1 in 1,000) further below the largest likelihood
    assert max(found) - found[2] < 0.5 * chi2.ppf(0.999, 1)
    assert 0 < int(np.argmax(found)) < 4
    # the form of first order cannot hold such a delay: it is worse by more than a likelihood ratio of 1e4
    first = max(total(measured, switch_on(rows, "reaction_delay", {"delay": d})) for d in (0.05, 0.15, 0.3, 0.5))
    assert found[2] > max(first, total(measured, rows)) + np.log(1e4)


@pytest.mark.parametrize(("delay_s", "share"), [(1.0 / 3.0, 0.0), (0.5, 0.5), (1.0, 0.0)])
@pytest.mark.parametrize("form", ["reaction_delay_others", "reaction_delay_all"])
def test_the_simulator_remembers_exactly(form, delay_s, share):
    rows = switch_on(rows_of(kappa_v=0.6, sigma_a=0.05), form, {"delay": delay_s})
    length, road = np.full(CARS, LENGTH_M), Road(RING_M)
    s = Simulator(rows, length, evenly(length, road), road, np.random.default_rng(1), speed=np.full(CARS, 4.0))
    seen = []
    for _ in range(12):
        seen.append(np.stack([s.gap_m, s.speed, np.roll(s.speed, -1)]))
        s.step()
    seen.append(np.stack([s.gap_m, s.speed, np.roll(s.speed, -1)]))
    back = int(delay_s / PERIOD_S + 1e-9)
    then = (1.0 - share) * seen[-1 - back] + share * seen[-2 - back]
    gap, speed, leader_speed = then[:, 0]
    own = speed if form == "reaction_delay_all" else s.speed[0]
    expected = mean_action(gap, own, leader_speed, s.parameters[0], ACTIONS, PERIOD_S, HORIZON)
    assert s.held[0] == pytest.approx(expected, abs=1e-9)
