"""Recordings that a fitted model simulates: behind a vehicle of which nobody knows what it follows."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.fit.model import Model, evaluate, filtered_states
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.simulated import resample
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, FIRST = 4, 3


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def behind_a_slow_car():
    """Four cars on an open road, and a model that takes the slow first car for an ordinary driver."""
    rows, length = ROW.with_effects(defaults(CARS)), np.full(CARS, 4.33)
    model = Model(rows.copy(), (V_STAR, KAPPA_V), (), (0.3, 0.3), rows.copy())
    rows[FIRST, V_STAR] = 4.0
    simulator = Simulator(
        rows, length, platoon(length, 8.0), Road(0.0), np.random.default_rng(2), speed=np.full(CARS, 4.0)
    )
    run = simulate(simulator, 150.0)
    assert not run.collisions
    return run, prepare(run.measured), model


def mean_error(data, model, work, driver):
    """Mean of a driver's standardised innovations, and how far it is from 0 by chance."""
    samples = evaluate(data, model, work)
    z = (samples.innovation_m / np.sqrt(samples.innovation_var))[driver]
    z = z[np.isfinite(z)]
    return z.mean(), 1.0 / np.sqrt(len(z))


def test_those_behind_a_first_car_are_simulated_as_the_model_drives(behind_a_slow_car, work):
    _, data, model = behind_a_slow_car
    states = filtered_states(data, model, work)
    simulated = resample(data, model, states, np.random.default_rng(1))
    for driver in range(FIRST):
        mean, std = mean_error(simulated, model, work, driver)
        assert abs(mean) < 4.0 * std


def test_the_last_seconds_before_a_collision_do_not_count(behind_a_slow_car, work):
    _, data, model = behind_a_slow_car
    wild = replace(model, rows=model.rows.copy())
    wild.rows[:FIRST, SIGMA_A] = 2.0
    simulated = resample(data, wild, filtered_states(data, model, work), np.random.default_rng(1))
    breaks = np.flatnonzero(np.diff(simulated.segment[0]) != 0) + 1
    breaks = breaks[breaks > 2]  # before, the first states are not known yet
    assert len(breaks) > 0
    before = breaks[:, None] - np.arange(1, round(3.0 / data.vicinity.period_s) + 1)
    left_out = ~simulated.scored[:FIRST] & data.scored[:FIRST]
    # whoever collides, and nobody else at another time
    assert left_out[:, before[before >= 0]].any(axis=0).all()
    assert set(np.flatnonzero(left_out.any(axis=0))) <= set(before.ravel())
    assert not simulated.scored[FIRST].any()


def test_a_leader_with_nobody_ahead_ends_the_chain(behind_a_slow_car):
    _, data, model = behind_a_slow_car
    driver = FIRST - 1
    of_three, of_two = (chain_behind(data.trajectories, driver, vehicles=count) for count in (3, 2))
    assert (of_three.identity[:, 2] < 0).all()
    one, other = (filter_chain(chain, model.rows[driver]) for chain in (of_three, of_two))
    np.testing.assert_allclose(one.innovation_m, other.innovation_m, rtol=0.0, atol=1e-9)
    assert one.log_likelihood == pytest.approx(other.log_likelihood, abs=1e-6)
