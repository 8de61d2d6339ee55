"""The search along a time and a strength: the likelihood of a switch has several maxima."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.diagnosis import placing
from sugiyama_ros.diagnosis.candidates import candidates
from sugiyama_ros.diagnosis.placing import best_placed, profiled
from sugiyama_ros.diagnosis.screen import with_candidate
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.fit.joint import at_model, rise
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

CARS, RING_M, SWITCH_S = 6, 90.0, 47.0
# Three standard errors of the time here.
NEAR_S = 2.0
TIME, STRENGTH = (index_of("preference_switch", name) for name in ("time", "v_star_change"))


@pytest.fixture(scope="module")
def found():
    rows = switch_on(ROW.with_effects(defaults(CARS)), "preference_switch", {"v_star_change": -0.2, "time": SWITCH_S})
    length, road, rng = np.full(CARS, 4.33), Road(RING_M), np.random.default_rng(5)
    simulator = Simulator(rows, length, evenly(length, road), road, rng, speed=np.full(CARS, 5.0))
    data = prepare(simulate(simulator, 80.0).measured)
    with ThreadPoolExecutor(2) as work:
        base = fit_base(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V), work)
        candidate = next(c for c in candidates(data) if c.name == "preference_switch")
        yield data, candidate, best_placed(data, with_candidate(data, base, candidate, work), candidate, work), work


def shifted(found, by_s):
    data, _, fitted, work = found
    rows = fitted.model.rows.copy()
    rows[:, TIME] += by_s
    return at_model(data, fitted, replace(fitted.model, rows=rows), work, np.ones(data.drivers, np.bool_))


def test_the_time_of_a_switch_is_found(found):
    assert abs(found[2].model.rows[0, TIME] - SWITCH_S) < NEAR_S


@pytest.mark.parametrize("by_s", [-6.0, 6.0])
def test_a_fit_that_ended_at_another_time_goes_back(found, by_s):
    data, candidate, _, work = found
    wrong = shifted(found, by_s)
    again = best_placed(data, wrong, candidate, work)
    assert rise(wrong, again) > 2.0
    assert abs(again.model.rows[0, TIME] - SWITCH_S) < NEAR_S


def test_a_fit_that_ended_at_another_strength_goes_back(found):
    data, candidate, fitted, work = found
    rows = fitted.model.rows.copy()
    rows[:, STRENGTH] *= 0.8
    weak = at_model(data, fitted, replace(fitted.model, rows=rows), work, np.ones(data.drivers, np.bool_))
    again = best_placed(data, weak, candidate, work)
    assert rise(weak, again) > 2.0
    assert abs(again.model.rows[0, STRENGTH] / fitted.model.rows[0, STRENGTH] - 1.0) < 0.1


def test_the_error_of_a_time_reaches_to_where_the_likelihood_falls(found, monkeypatch):
    data, candidate, fitted, work = found
    names = ("preference_switch.time", "preference_switch.v_star_change")
    known = dict.fromkeys(names, 0.01)
    wide = profiled(data, fitted, [candidate], known, work)
    assert known[names[0]] <= wide[names[0]] < NEAR_S
    assert wide[names[1]] == known[names[1]]
    # where the time does not matter at all, the error reaches as far as times are tried
    monkeypatch.setattr(placing, "predicted", lambda *arguments: 0.0)
    starts = np.unique([start[TIME] for start in candidate.starts])
    wide = profiled(data, fitted, [candidate], known, work)
    assert wide[names[0]] == pytest.approx(np.diff(starts).min() / 1.96)


def test_the_best_time_stays(found):
    data, candidate, fitted, work = found
    assert best_placed(data, fitted, candidate, work) is fitted
    offset = next(c for c in candidates(data) if c.name == "gap_offset")
    assert best_placed(data, shifted(found, 6.0), offset, work).model.rows[0, TIME] != fitted.model.rows[0, TIME]
