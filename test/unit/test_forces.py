"""Forces without a name: the covariate along which one acts is found, with its size."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from benchmarks.away.drivers import drawn
from benchmarks.away.world import Hidden, Setup, record
from sugiyama_ros.diagnosis.chance import chance_of
from sugiyama_ros.diagnosis.refine import refined
from sugiyama_ros.diagnosis.score import directions, scores
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.fit.joint import fit_base
from sugiyama_ros.fit.model import filtered_states
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.surroundings import covariates_of
from sugiyama_ros.trajectories.dense import tracks_of

CARS = 10
SCENE = Setup(drivers=CARS, ring_m=105.0, duration_s=150.0)


def fitted(work, push=None):
    """A fit of the base model to drivers whom something pushes."""
    rng = np.random.default_rng(8)
    hidden = [Hidden(push=push)] if push else []
    data = prepare(tracks_of(record(SCENE, drawn(CARS, rng), hidden, rng)))
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


def mood(time_s):
    return 0.4 * np.sin(2.0 * np.pi * time_s / 100.0)


def moody(moment, view):
    return np.full(CARS, mood(view.time_s))


def along(data, fit, work):
    """Directions of all forces."""
    return list(directions(data, fit, [], work, with_forces=True))


def forces_of(data, fit, work):
    """Scores of forces, the largest gain first, and the p-value of the largest."""
    found = sorted(scores(data, fit, along(data, fit, work), work), key=lambda one: -one.gain)
    return found, min(chance_of(found, [], 0).p_values.values())


@pytest.mark.parametrize(("push", "covariate"), [(chased, "rear_approach_rate")])
def test_the_covariate_of_a_force_is_found(push, covariate, work):
    (best, *_), p_value = forces_of(*fitted(work, push), work)
    assert best.candidate.name == f"force_along_{covariate}"
    assert best.gain > 20.0
    assert p_value < 0.01


def test_the_size_of_a_force_is_about_right(work):
    data, fit = fitted(work, moody)
    (one,) = [
        one for one in scores(data, fit, along(data, fit, work), work) if one.candidate.name == "force_along_time"
    ]
    rows = refined(data, fit, one.candidate, [one], work).model.rows
    start = one.candidate.starts[0]
    first, last = (value for place, value in sorted(start.items()) if place != min(start))
    times = data.vicinity.time_s[:, 0]
    found = np.interp(times, np.linspace(first, last, len(one.candidate.places)), rows[0, one.candidate.places])
    truth = mood(times)
    slope = np.polyfit(truth, found, 1)[0]
    # each driver's desired speed takes in a part
    assert 0.6 < slope < 1.5
    assert np.corrcoef(truth, found)[0, 1] > 0.8


def test_what_is_around_a_driver(plain, work):
    data, fit = plain
    state = filtered_states(data, fit.model, work)
    seen = covariates_of(data, state)
    assert {values.shape for values in seen.values()} == {(data.samples, CARS)}
    # on a ring, column i follows column i + 1
    for name, of_next in (("rear_gap", "gap"), ("rear_approach_rate", "approach_rate")):
        np.testing.assert_array_equal(seen[name], np.roll(seen[of_next], 1, axis=1))
    np.testing.assert_array_equal(seen["second_gap"], np.roll(seen["gap"], -1, axis=1))
    second = seen["approach_rate"] + np.roll(seen["approach_rate"], -1, axis=1)
    np.testing.assert_allclose(seen["second_approach_rate"], second, atol=1e-12)
