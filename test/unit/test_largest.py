"""The largest gain of all candidates by chance: the test is about what prescreens promise, and sees what is hidden."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.bootstrap import resampled_fits, seeds
from sugiyama_ros.diagnosis.candidacy import UNKNOWN
from sugiyama_ros.diagnosis.candidates import candidates, named
from sugiyama_ros.diagnosis.largest import p_values, scores, with_p_values
from sugiyama_ros.diagnosis.prescreen import Promise, prescreen, promised
from sugiyama_ros.diagnosis.screen import QUICK, screen
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.fit.cross_validation import gain
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, RING_M, LENGTH_M, SEED = 12, 130.0, 4.33, 7


def fitted_to(work, effect="", **values):
    """A recording with an effect, the base model fitted to it, and prescreens of all candidates."""
    rows = ROW.with_effects(defaults(CARS))
    rows = switch_on(rows, effect, values) if effect else rows
    length = np.full(CARS, LENGTH_M)
    run = simulate(Simulator(rows, length, platoon(length, 2.0), Road(RING_M), np.random.default_rng(SEED)), 100.0)
    data = prepare(run.measured)
    base = fit_base(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V), work)
    return data, base, {c.name: prescreen(data, base, c, work) for c in candidates(data)}


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


def compared(data, base, seen, work):
    simulations = resampled_fits(data, base, seeds(SEED, 1), work, lambda *_: None)
    return p_values(data, base, seen, simulations, SEED, work)


@pytest.fixture(scope="module")
def whole(work):
    """Nothing is missing."""
    return fitted_to(work)


def test_half_a_squared_score_is_what_a_prescreen_promises(whole, work):
    data, base, seen = whole
    for name in ("road_grade", "clock_offset", "rear_pressure"):
        one = seen[name]
        found = scores(data, base, [one])
        gains = 0.5 * found.score**2 / np.diag(found.information) * data.drivers / len(one.some)
        # prescreens damp their step a little
        assert promised(data, base, one)[0] == pytest.approx(gains.max(), rel=0.01, abs=0.01)


def test_scores_of_candidates_are_correlated_but_not_the_same(whole):
    data, base, seen = whole
    some = [one for one in seen.values() if any(one.candidate.starts) and not one.candidate.individual]
    information = scores(data, base, [one for one in some if not one.candidate.happens_once]).information
    std = np.sqrt(np.diag(information))
    values = np.linalg.eigvalsh(information / np.outer(std, std))
    assert values.min() > -1e-6 * values.max()
    # many starts repeat what others say
    assert len(values) > 2 * values.sum() ** 2 / np.sum(values**2)


def test_chance_shows_as_much_where_nothing_is_missing(whole, work):
    # a smallest p-value is uniform: one recording in a thousand fails here
    assert min(compared(*whole, work).values()) > 1e-3


def test_one_moment_at_which_the_filter_is_far_off_says_little(whole, work):
    data, base, seen = whole
    driver, (innovation, _, _) = next(iter(seen["drag"].changes[0].items()))
    spoiled, k = base.samples.copy(), np.nanargmax(np.abs(innovation))
    spoiled.innovation_m[driver, k] += 100.0 * np.sqrt(spoiled.innovation_var[driver, k])
    assert min(compared(data, replace(base, samples=spoiled), seen, work).values()) > 1e-3


def test_what_is_hidden_stands_out(work):
    found = compared(*fitted_to(work, "drag", c0=0.6, c2=0.0), work)
    assert found["drag"] < 1e-3
    assert found["drag"] == min(found.values())


def test_noises_keep_their_p_value_unless_their_held_out_gain_is_more_probable(whole, work):
    data, base, seen = whole
    (noise,) = named(data, ["uneven_noise"])
    (drag,) = named(data, ["drag"])
    judged = [UNKNOWN.judge(screen(data, base, one, work, QUICK), 30) for one in (noise, drag)]
    scored = [replace(one, p_value=1e-6) for one in judged]
    nothing = gain(data, base.samples, base.samples)
    (of_noise, of_drag), (rest,) = with_p_values(
        {"drag": 0.4, "road_grade": 0.7},
        scored,
        {"uneven_noise": nothing, "drag": nothing},
        [Promise(seen["road_grade"].candidate, 1.0)],
    )
    assert (of_drag.p_value, rest.p_value) == (0.4, 0.7)
    assert of_noise.p_value > 0.5
    sure = replace(nothing, nats=100.0, se=10.0)
    (of_noise, _), _ = with_p_values({"drag": 0.4}, scored, {"uneven_noise": sure, "drag": nothing}, [])
    assert of_noise.p_value == 1e-6


def test_a_start_beyond_all_bounds_is_left_out(whole, work):
    data, base, seen = whole
    usual = compared(data, base, {name: seen[name] for name in ("road_grade", "clock_offset")}, work)
    driver, (innovation, variance, density) = next(iter(seen["rear_pressure"].changes[0].items()))
    broken = {driver: (np.full_like(innovation, np.inf), variance, density)}
    odd = replace(seen["rear_pressure"], changes=({**seen["rear_pressure"].changes[0], **broken},) * 2)
    found = compared(data, base, {"rear_pressure": odd, **{name: seen[name] for name in usual}}, work)
    assert found == usual
