"""One car is once braked hard: found by its innovations, fitted, and worth it on what the fit has not seen."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sugiyama_ros.diagnosis.candidates import push_of_one
from sugiyama_ros.diagnosis.forecast import forecasts
from sugiyama_ros.diagnosis.refine import refined, without_folds
from sugiyama_ros.diagnosis.score import directions, scores
from sugiyama_ros.diagnosis.table import Entry
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.fit.law import in_filter
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, PUSHED = 7, 3


@pytest.mark.parametrize("time_s", [62.0, 75.0])
def test_the_car_and_the_moment_of_a_push_are_found(time_s):
    """The second push lies on the border of two blocks of time."""
    rows = switch_on(
        ROW.with_effects(defaults(CARS)), "external_push", {"strength": -5.0, "time": time_s, "duration": 0.8}
    )
    rows[np.arange(CARS) != PUSHED, index_of("external_push", "strength")] = 0.0
    length = np.full(CARS, 4.33)
    start = platoon(length, 4.0)
    run = simulate(Simulator(rows, length, start, Road(77.0), np.random.default_rng(4)), 150.0)
    data = prepare(run.measured)
    with ThreadPoolExecutor(2) as work:
        base = in_filter(data, PAPERS, work)
        push = push_of_one(data, base.samples)
        found = sorted(scores(data, base, list(directions(data, base, [push], work)), work), key=lambda one: -one.gain)
        fit = refined(data, base, push, found, work)
        fits = [without_folds(data, one, work) for one in (base, fit)]
        plain, pushed = (forecasts(data, models, work) for models in fits)
    assert push.drivers == (PUSHED,)
    assert found[0].gain > 5.0
    strength, time, duration = push.places
    assert fit.model.rows[PUSHED, time] == pytest.approx(time_s, abs=1.0)
    assert fit.model.rows[PUSHED, strength] * fit.model.rows[PUSHED, duration] == pytest.approx(-4.0, abs=2.0)
    assert not np.delete(fit.model.rows[:, strength], PUSHED).any()
    # the other blocks of time say nothing of the push, and leave it as it is
    for model in fits[1]:
        np.testing.assert_array_equal(model.rows[PUSHED, list(push.places)], fit.model.rows[PUSHED, list(push.places)])
    assert Entry("push", (push,), fit, fits[1], pushed).is_better(data, Entry("base", (), base, fits[0], plain))
