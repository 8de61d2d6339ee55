"""Fits of laws to some drivers first: the same drivers as before, and no fit in full where it could not matter."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.errors import held_out_errors
from sugiyama_ros.diagnosis.rival_fits import _LACKS, start_rivals
from sugiyama_ros.diagnosis.rivals import in_filter, start_of_drivers
from sugiyama_ros.fit.population import fit_base, fit_nearly, start_model
from sugiyama_ros.fit.recording import prepare
from sugiyama_ros.fit.score import evaluate, follow
from sugiyama_ros.fit.some_drivers import some_drivers
from sugiyama_ros.laws import registry
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.studies.speed.recording import jam

CARS = 18
WHO = [0, 5, 11]


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def data():
    return prepare(jam(CARS, 60.0))


@pytest.fixture(scope="module")
def before(data, work):
    return held_out_errors(data, fit_base(data, data.even.individual(), work), work, searched=False)


def nearly(data, law, work):
    start = start_of_drivers(data, law)
    return fit_nearly(data, start.individual, work, start)


def test_some_drivers_are_predicted_as_among_all_drivers(data, work):
    """All drivers are alike here, so it does not matter whose parameters the vehicles ahead have."""
    model, part = start_model(data, data.even.individual()), some_drivers(data, WHO)
    alone = replace(model, rows=model.rows[WHO], ahead=model.ahead[WHO])
    all_, states = follow(data, model, work)
    some, of_some = follow(part, alone, work)
    np.testing.assert_array_equal(some.log_likelihood, all_.log_likelihood[WHO])
    np.testing.assert_array_equal(of_some[:, : len(WHO)], states[:, WHO])
    np.testing.assert_array_equal(evaluate(part, alone, work).innovation_m, all_.innovation_m[WHO])


def test_some_drivers_know_which_of_them_are_ahead(data):
    part = some_drivers(data, [3, 4, 9])
    ahead = data.ahead[[3, 4, 9]]
    numbers = {3: 0, 4: 1, 9: 2}
    assert part.ahead.tolist() == [[numbers.get(i, -1) for i in row] for row in ahead.tolist()]
    assert [name.number for name in part.vicinity.names] == [data.vicinity.names[i].number for i in (3, 4, 9)]
    assert part.vicinity.position_m.shape == (data.samples, 9)
    assert (part.vicinity.leader[:, :3] == np.arange(3, 6)).all()


def test_a_quick_diagnosis_fits_a_law_that_is_far_behind_to_some_drivers(data, before, work, monkeypatch):
    """The cars drive by the model of the paper, so that a constant speed is far behind."""
    monkeypatch.setattr("sugiyama_ros.diagnosis.rival_fits.RIVALS", ("constant_speed",))
    with ThreadPoolExecutor(1) as aside:
        (found,) = start_rivals(data, before, work, aside)
    one = found.result()["constant_speed"]
    assert one.is_far
    assert one.summary(CARS)["drivers"] == 8
    assert one.errors.free_run_10s_beside(before)[0] > before.free_run_10s_beside(one.errors)[0]
    assert one.errors.loglik_per_sample < before.loglik_per_sample
    # the fit does not come to the end
    alone = some_drivers(data, one.errors.predicted_drivers)
    again = held_out_errors(alone, nearly(alone, "constant_speed", work), work, searched=False)
    assert one.errors.samples.total == pytest.approx(again.samples.total, rel=1e-12)


@pytest.mark.parametrize("law", ["idm", "fvdm", "gipps"])
def test_a_fit_that_does_not_come_to_the_end_lacks_little(data, work, law):
    """A law counts as far behind only if it lacks more than that."""
    alone = some_drivers(data, range(0, 16, 2))
    lacks = in_filter(alone, law, work).log_likelihood - nearly(alone, law, work).log_likelihood
    assert lacks < _LACKS


def test_a_law_that_may_be_better_is_fitted_to_all_drivers(data, work, monkeypatch):
    """Here the law has to beat a constant speed."""
    assert {"idm", "constant_speed"} < set(RIVALS) < set(registry.LAWS)
    slow = held_out_errors(data, in_filter(data, "constant_speed", work), work, searched=False)
    monkeypatch.setattr("sugiyama_ros.diagnosis.rival_fits.RIVALS", ("idm",))
    with ThreadPoolExecutor(1) as aside:
        (found,) = start_rivals(data, slow, work, aside)
    one = found.result()["idm"]
    assert not one.is_far
    assert "drivers" not in one.summary(CARS)
    assert np.isfinite(one.errors.summary()["free_run_10s_m"])


def test_some_of_many_drivers_decide_about_a_law(data, work, monkeypatch):
    monkeypatch.setattr("sugiyama_ros.diagnosis.rival_fits._ENOUGH", CARS // 2)
    slow = held_out_errors(data, in_filter(data, "constant_speed", work), work, searched=False)
    monkeypatch.setattr("sugiyama_ros.diagnosis.rival_fits.RIVALS", ("idm",))
    with ThreadPoolExecutor(1) as aside:
        (found,) = start_rivals(data, slow, work, aside)
    one = found.result()["idm"]
    assert not one.is_far
    assert one.summary(CARS)["drivers"] == CARS // 2
    assert one.errors.predicted_drivers == list(range(0, CARS, 2))
    alone = some_drivers(data, one.errors.predicted_drivers)
    again = held_out_errors(alone, in_filter(alone, "idm", work, _total(slow, alone, data)), work, searched=False)
    assert one.errors.samples.total == pytest.approx(again.samples.total, rel=1e-12)


def _total(errors, alone, data):
    who = [data.vicinity.names.index(name) for name in alone.vicinity.names]
    return float(np.nansum(errors.samples.log_likelihood[who]))
