"""Samples that are far apart, and the ends of smoothed records."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.forecast import forecasts
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import start_model
from sugiyama_ros.fit.model import evaluate, filtered_states
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.recording import FOLDS
from sugiyama_ros.fit.simulated import resample
from sugiyama_ros.fit.smooth_positions import (
    measured,
    measured_every,
    smoothing_window,
    with_short_periods,
)
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.trajectories.dense import tracks_of

CARS, EVERY = 8, 3


@pytest.fixture(scope="module")
def slow():
    """A camera that keeps every third picture of a run: a picture a second."""
    length = np.full(CARS, 4.33)
    start = platoon(length, 2.0)
    rng = np.random.default_rng(11)
    run = simulate(Simulator(ROW.with_effects(defaults(CARS)), length, start, Road(84.0), rng), 150.0)
    kept = run.dense.position_m[::EVERY]
    return replace(run.dense, position_m=kept, period_s=EVERY * run.dense.period_s)


def test_empty_samples_come_in_between_and_go_again(slow):
    finer = with_short_periods(slow)
    assert finer.period_s == pytest.approx(1.0 / 3.0)
    assert measured_every(finer) == EVERY
    assert np.array_equal(finer.position_m[::EVERY], slow.position_m)
    assert np.isfinite(finer.position_m).sum() == np.isfinite(slow.position_m).sum()
    again = measured(finer)
    assert np.array_equal(again.position_m, slow.position_m)
    assert again.period_s == pytest.approx(slow.period_s)
    assert with_short_periods(finer) is finer
    assert measured(slow) is slow


def test_a_filter_knows_its_errors_between_pictures_that_are_a_second_apart(slow):
    data = prepare(tracks_of(slow))
    assert (data.every, data.measured_samples) == (EVERY, len(slow.position_m))
    model = start_model(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V))
    model.rows[:], model.ahead[:] = ROW.with_effects(defaults(CARS)), ROW.with_effects(defaults(CARS))
    with ThreadPoolExecutor(1) as work:
        found = evaluate(data, model, work)
    normal = (found.innovation_m / np.sqrt(found.innovation_var))[np.isfinite(found.log_likelihood)]
    assert CARS * 140 < len(normal) <= CARS * len(slow.position_m)
    # the mean of n squares of standard normal numbers has the variance 2 / n; 4 standard deviations
    assert np.mean(np.square(normal)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(normal)))


def test_simulated_recordings_miss_what_the_recording_misses(slow):
    data = prepare(tracks_of(slow))
    model = start_model(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V))
    with ThreadPoolExecutor(1) as work:
        states = filtered_states(data, model, work)
        simulated = resample(data, model, states, np.random.default_rng(3))
        runs = forecasts(data, [model] * FOLDS, work)
    assert np.array_equal(np.isnan(simulated.trajectories.position_m), np.isnan(data.trajectories.position_m))
    assert (simulated.every, simulated.even.period_s) == (EVERY, data.even.period_s)
    # free runs start at and are compared with pictures
    assert (runs.start % EVERY == 0).all()
    assert np.isfinite(runs.road.error).all()


def smoothed(noise, window):
    """White noise (T, N), averaged over a window; the ends are repeated."""
    half = window // 2
    edge = np.concatenate([np.repeat(noise[:1], half, axis=0), noise, np.repeat(noise[-1:], half, axis=0)])
    return np.stack([np.convolve(one, np.full(window, 1.0 / window), "valid") for one in edge.T], axis=1)


@pytest.mark.parametrize("window", [5, 11, 21])
def test_the_window_of_a_smoother_is_found(window):
    time = 0.1 * np.arange(900)[:, None]
    noise = 0.3 * np.random.default_rng(6).standard_normal((900, 3))
    way = 12.0 * time + 20.0 * np.sin(0.15 * time)
    assert smoothing_window((way + noise).T, 0.1) == 0
    assert smoothing_window(smoothed(way + noise, window).T, 0.1) == window


def test_the_ends_of_a_smoothed_record_do_not_count(slow):
    rng = np.random.default_rng(9)
    way = 5.0 * 0.1 * np.arange(400)[:, None] + np.array([0.0, 20.0, 40.0])
    t = replace(
        slow,
        position_m=smoothed(way + 0.3 * rng.standard_normal((400, 3)), 11),
        length_m=np.full(3, 4.0),
        vehicle=np.arange(3),
        period_s=0.1,
        road=Road(0.0),
    )
    data = prepare(tracks_of(t))
    # three quarters of the window are 0.9 s, but samples are at most 0.8 s apart
    assert (data.every, data.apart_s, data.smoothed_s) == (8, pytest.approx(0.8), pytest.approx(1.1))
    assert np.isfinite(data.trajectories.position_m[::8]).all()
    assert np.isnan(np.delete(data.trajectories.position_m, np.s_[::8], axis=0)).all()
    # nobody is ahead of the last vehicle, which does not count at all
    assert (data.scored[:2, 11:-11]).all()
    assert not data.scored[:, :11].any()
    assert not data.scored[:, -11:].any()
