"""The scan for forces that a model lacks."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.covariates import covariates_of, further_covariates, some_time_ago
from sugiyama_ros.diagnosis.scan import forces_left, scan
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.fit.score import filtered_states
from sugiyama_ros.studies.away.drivers import drawn
from sugiyama_ros.studies.away.world import Hidden, Setup, record

CARS = 10
SCENE = Setup(drivers=CARS, ring_m=105.0, duration_s=150.0)


def fitted(work, push=None):
    """A fit of the base model to drivers whom something pushes."""
    rng = np.random.default_rng(8)
    hidden = [Hidden(push=push)] if push else []
    data = prepare(record(SCENE, drawn(CARS, rng), hidden, rng))
    return data, fit_base(data, data.even.individual(V_STAR, KAPPA_V), work)


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(1) as pool:
        yield pool


@pytest.fixture(scope="module")
def plain(work):
    return fitted(work)


def chased(moment, view):
    return 1.5 * np.maximum(view.rear_speed - view.speed, 0.0)


def stubborn(moment, view):
    return 0.5 * np.clip(moment.ago(3.0).acceleration, -1.5, 1.5)


def mood(time_s):
    return 0.4 * np.sin(2.0 * np.pi * time_s / 40.0)


def moody(moment, view):
    return np.full(CARS, mood(view.time_s))


@pytest.mark.parametrize(
    ("push", "covariate", "ago_s"),
    [(chased, "rear_approach_rate", 0.0), (stubborn, "past_acceleration", 3.0), (moody, "time", 0.0)],
)
def test_the_covariate_of_a_force_is_found(push, covariate, ago_s, work):
    data, fit = fitted(work, push)
    best = forces_left(data, fit, [], 0.001, work)[0]
    assert (best.covariate, best.ago_s) == (covariate, ago_s)
    assert best.gain_nats > 20.0
    assert len(best.knots) == len(best.force)


def test_the_size_of_a_force_is_about_right(work):
    data, fit = fitted(work, moody)
    (time,) = scan(data, fit, work, ["time"])
    times = data.vicinity.time_s[:, 0]
    found, truth = np.interp(times, time.force.knots, time.force.force), mood(times)
    slope = np.polyfit(truth, found, 1)[0]
    # each driver's desired speed takes in a part, and that the cars ahead are pushed, too, is left out
    assert 0.6 < slope < 1.5
    assert np.corrcoef(truth, found)[0, 1] > 0.8


def test_nothing_is_found_where_nothing_is_missing(plain, work):
    data, fit = plain
    assert forces_left(data, fit, [], 0.001, work) == []


def test_what_simulations_show_as_well_is_not_missing(work):
    data, fit = fitted(work, chased)
    assert forces_left(data, fit, [(data, fit)], 0.001, work) == []


def test_what_is_around_a_driver(plain, work):
    data, fit = plain
    state = filtered_states(data, fit.model, work)
    seen = covariates_of(data, state)
    seen |= further_covariates(data, state, seen)
    assert {values.shape for values in seen.values()} == {(data.samples, CARS)}
    # on a ring, column i follows column i + 1
    for name, of_next in (("rear_gap", "gap"), ("rear_approach_rate", "approach_rate")):
        np.testing.assert_array_equal(seen[name], np.roll(seen[of_next], 1, axis=1))
    np.testing.assert_array_equal(seen["second_gap"], np.roll(seen["gap"], -1, axis=1))
    second = seen["approach_rate"] + np.roll(seen["approach_rate"], -1, axis=1)
    np.testing.assert_allclose(seen["second_approach_rate"], second, atol=1e-12)
    ahead = np.mean([np.roll(seen["speed"], -k, axis=1) for k in range(1, 6)], axis=0)
    np.testing.assert_allclose(seen["flow_approach_rate"], seen["speed"] - ahead, atol=1e-12)


def test_the_past_ends_where_the_record_was_broken(plain):
    data, _ = plain
    segment = data.segment.copy()
    segment[:, 100:] = 1
    values = np.arange(float(data.samples))[:, None] + np.zeros(CARS)
    ago = some_time_ago(replace(data, segment=segment), values, 2.0)
    assert np.isnan(ago[:6]).all()
    assert np.isnan(ago[100:106]).all()
    np.testing.assert_array_equal(ago[6:100], values[:94])
    np.testing.assert_array_equal(ago[106:], values[100:-6])
