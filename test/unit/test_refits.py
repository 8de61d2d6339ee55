"""Fits from nothing to simulated recordings: they find what was simulated, where they can."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.candidates import named
from sugiyama_ros.diagnosis.refits import added_to_all, fit_from_nothing, refits
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

CARS, RING_M, SWITCH_S = 6, 90.0, 47.0
# Three standard errors of the time here.
NEAR_S = 2.0


@pytest.fixture(scope="module")
def recording():
    rows = switch_on(ROW.with_effects(defaults(CARS)), "preference_switch", {"v_star_change": -0.2, "time": SWITCH_S})
    length, road, rng = np.full(CARS, 4.33), Road(RING_M), np.random.default_rng(5)
    simulator = Simulator(rows, length, evenly(length, road), road, rng, speed=np.full(CARS, 5.0))
    return prepare(simulate(simulator, 80.0).measured)


def test_the_time_of_a_switch_is_found_again(recording):
    effects, time = named(recording, ["preference_switch"]), index_of("preference_switch", "time")
    with ThreadPoolExecutor(2) as work:
        fitted = fit_from_nothing(recording, effects, work)
        again = refits(recording, fitted, effects, 1, 2, work)
        assert refits(recording, fitted, [], 1, 2, work) == refits(recording, fitted, effects, 1, 0, work) == []
    times = [one.model.rows[0, time] for one in again]
    assert fitted.model.rows[0, time] == pytest.approx(SWITCH_S, abs=NEAR_S)
    assert times == pytest.approx([fitted.model.rows[0, time]] * 2, abs=NEAR_S)
    assert times[0] != times[1]


def test_only_what_all_drivers_have_is_fitted_from_nothing(recording):
    def added(form, drivers=()):
        return SimpleNamespace(form=form, drivers=drivers)

    assert [c.name for c in added_to_all(recording, [added("drag"), added("noise_constants")])] == [
        "drag",
        "noise_constants",
    ]
    assert added_to_all(recording, [added("drag"), added("actuation_lag", (1, 2))]) == []
    assert added_to_all(recording, [added("drag"), added("external_push")]) == []
    assert added_to_all(recording, [added("discovered_force")]) == []
