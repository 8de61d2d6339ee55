"""Fits and held-out scores on small simulated recordings whose truth is known."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sugiyama_ros.diagnosis.refine import with_named
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.joint import fit, fit_base, start_model
from sugiyama_ros.fit.model import evaluate
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.slopes import slopes
from sugiyama_ros.fit.standard_errors import own_stds
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, RING_M, LENGTH_M = 7, 77.0, 4.33
INDIVIDUAL = (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V)


def recording(duration_s: float = 100.0):
    rng = np.random.default_rng(1)
    rows = ROW.with_effects(defaults(CARS))
    for k in (V_STAR, KAPPA_V):
        rows[:, k] *= np.exp(0.1 * rng.standard_normal(CARS))
    length = np.full(CARS, LENGTH_M)
    return simulate(Simulator(rows, length, platoon(length, 4.0), Road(RING_M), rng), duration_s)


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def fitted(work):
    run = recording()
    data = prepare(run.measured)
    return run, data, fit_base(data, INDIVIDUAL, work)


def test_a_fit_is_at_a_maximum(fitted, work):
    _, data, base = fitted
    again = fit(data, base.model, work, iterations=10)
    assert -1e-9 <= again.objective - base.objective < 0.5


def test_a_fit_beats_the_truth_by_as_much_as_its_freedom_allows(fitted, work):
    run, data, base = fitted
    truth = start_model(data, INDIVIDUAL)
    truth.rows[:], truth.ahead[:] = run.parameters, run.parameters
    excess = 2.0 * (base.log_likelihood - evaluate(data, truth, work).total)
    # chi-squared with 4 parameters per driver, some of them held by the prior: mean 28, 99.9 % below 56
    assert 0.0 < excess < 56.0


def test_slopes_are_the_derivatives_of_the_likelihood(fitted, work):
    _, data, base = fitted
    here, _ = slopes(data, base.model, work, base.slopes)
    score = sum(s.score.sum(axis=0) for s in here)
    size = sum(np.abs(s.score).sum(axis=0) for s in here)
    # at the maximum the slopes of the folds cancel, except for the slope of the prior
    assert np.all(np.abs(score) < 0.5 * size)


def test_scores_of_some_drivers_equal_their_scores_among_all(fitted, work):
    _, data, base = fitted
    some, every = evaluate(data, base.model, work, [1, 4]), evaluate(data, base.model, work)
    assert np.isnan(some.log_likelihood[[0, 2, 3, 5, 6]]).all()
    for i in (1, 4):
        np.testing.assert_array_equal(some.of(i), every.of(i))


@pytest.mark.parametrize("name", ["reaction_delay", "actuation_lag"])
def test_what_is_added_by_name_never_makes_a_model_worse(fitted, work, name):
    _, data, base = fitted
    again = with_named(data, base, [name], work)
    assert again is base or again.objective - base.objective > 0.0


def test_standard_errors_are_those_of_all_drivers_and_their_centre_together(fitted):
    _, _, base = fitted
    own = len(INDIVIDUAL)
    prior = np.diag(np.array(base.model.prior_std) ** -2.0)
    # a prior around the mean driver leaves a step of all drivers at once to the samples alone
    together = -np.kron(np.full((CARS, CARS), 1.0 / CARS), prior)
    for i, one in enumerate(base.slopes):
        mine = slice(i * own, (i + 1) * own)
        together[mine, mine] += one.information.sum(axis=0) + prior
    expected = np.sqrt(np.diag(np.linalg.inv(together))).reshape(CARS, own) * base.model.rows[:, INDIVIDUAL]
    found = np.array([list(stds.values()) for stds in own_stds(base)])
    assert found == pytest.approx(expected, rel=1e-6)


def test_too_short_a_recording_is_refused():
    with pytest.raises(InputError, match="at least 8 s"):
        prepare(recording(duration_s=5.0).measured)
