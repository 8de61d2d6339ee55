"""Prescreens promise little where nothing is missing, and nearly all that a fit gains where something is."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.stats import chi2

from sugiyama_ros.diagnosis.candidacy import null_gains
from sugiyama_ros.diagnosis.candidates import candidates, named
from sugiyama_ros.diagnosis.prescreen import PROMISE, beyond_chance, prescreen, promised, worth_screening
from sugiyama_ros.diagnosis.screen import QUICK, screen
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import EFFECTS, ROW, switch_on
from sugiyama_ros.effects.sensing import displacements
from sugiyama_ros.fit.population import fit_base
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, RING_M, LENGTH_M = 22, 230.0, 4.33


def fitted_to(work, effect="", **values):
    """A recording with an effect, and the base model fitted to it."""
    rng, rows = np.random.default_rng(5), ROW.with_effects(defaults(CARS))
    for k in (V_STAR, KAPPA_V):
        rows[:, k] *= np.exp(0.1 * rng.standard_normal(CARS))
    rows = switch_on(rows, effect, values) if effect else rows
    length = np.full(CARS, LENGTH_M)
    run = simulate(Simulator(rows, length, platoon(length, 2.0), Road(RING_M), rng), 80.0)
    data = prepare(run.measured)
    return data, fit_base(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V), work)


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def whole(work):
    """Nothing is missing."""
    return fitted_to(work)


def test_the_prior_of_drivers_who_are_left_out_promises_nothing(whole, work):
    data, base = whole
    (drag,) = named(data, ["drag"])
    seen = prescreen(data, base, drag, work)
    assert len(seen.some) < CARS
    assert np.abs(base.model.away).max() > 1.0
    # Wilks: two parameters, and half of the drivers stand for all
    assert promised(data, base, seen)[0] < 0.5 * CARS / len(seen.some) * chi2.isf(1e-3, 2)


def test_few_candidates_promise_something_where_nothing_is_missing(whole, work):
    data, base = whole
    possible = [c for c in candidates(data) if not c.individual and any(c.starts)]
    prescreens = {c.name: prescreen(data, base, c, work) for c in possible}
    kept, left = worth_screening(data, base, prescreens, np.inf)
    assert len(kept) + len(left) == len(possible)
    # a start gains by chance more than 5 nats of all drivers, 2.5 of half of them, in 3 of 100 recordings (Wilks)
    assert len(kept) <= len(possible) // 3
    # the most promising one is looked at all the same
    best = max(prescreens, key=lambda name: beyond_chance(data, base, prescreens[name]))
    assert best in {c.name for c in kept}


def test_a_candidate_that_loses_much_at_its_best_start_is_not_screened(whole, work):
    data, base = whole
    possible = named(data, ["reaction_delay", "actuation_lag", "drag"])
    prescreens = {c.name: prescreen(data, base, c, work) for c in possible}
    # a strength is scaled, so that a loss at a start says little
    most = {name: max(seen.rises(base)) for name, seen in prescreens.items() if not seen.candidate.strengths}
    refuted = -0.5 * (max(most.values()) + min(most.values()))
    kept, left = worth_screening(data, base, prescreens, refuted)
    gains = {one.candidate.name: one.gain for one in left}
    for name, rise in most.items():
        assert (
            (gains[name] == rise and name not in {c.name for c in kept}) if rise < -refuted else gains.get(name) != rise
        )
    assert any(rise < -refuted for rise in most.values())


def test_what_chance_gains_on_a_simulation_is_not_cut_off(whole, work):
    """A candidate that promises too little to be screened gains there what its prescreen predicts, and not nothing."""
    data, base = whole
    possible = [c for c in candidates(data) if not c.individual and any(c.starts)]
    predicted = {c.name: beyond_chance(data, base, prescreen(data, base, c, work)) for c in possible}
    small = [c for c in possible if predicted[c.name] <= PROMISE]
    gains = null_gains([(data, base)], small, QUICK, work, lambda *_: None).gains
    assert {name: g for name, (g,) in gains.items()} == {c.name: max(predicted[c.name], 0.0) for c in small}
    # half a nat for each parameter (Wilks), so that most of the gains are above 0.05
    assert np.median([g for (g,) in gains.values()]) > 0.05


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
def test_a_camera_off_the_centre_promises_at_every_angle_what_a_fit_gains(work, phase):
    """The start of the search stands at one angle; the prescreen looks at both axes."""
    angle = np.pi * (phase + 0.125)
    data, base = fitted_to(work, "sensor_eccentricity", cosine=1.5 * np.cos(angle), sine=1.5 * np.sin(angle))
    (camera,) = named(data, ["sensor_eccentricity"])
    seen = prescreen(data, base, camera, work)
    look = screen(data, base, camera, work, seen=seen)
    assert beyond_chance(data, base, seen) > PROMISE
    assert look.gain > 20.0
    # half of the drivers stand for all, so the prediction has an error of its own size's root, and three of these
    assert abs(beyond_chance(data, base, seen) - look.gain) < 3.0 * np.sqrt(2.0 * look.gain) + 0.3 * look.gain


@pytest.mark.parametrize("name", [name for name, e in EFFECTS.items() if e.displacement is not None])
def test_a_displaced_measurement_needs_only_one_of_its_waves(name):
    for parameter in EFFECTS[name].switches:
        row = switch_on(ROW.with_effects(defaults(1)), name, {parameter: 1.0})
        at = np.array([displacements(np.array([x]), RING_M, row)[0] for x in np.linspace(0.0, RING_M, 24)])
        assert np.abs(at).max() == pytest.approx(1.0, abs=0.05)
