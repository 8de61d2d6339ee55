"""Other laws: fits to some drivers first, and no fit in full where it could not matter."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.speed.timing import jam
from sugiyama_ros.diagnosis.base import laws
from sugiyama_ros.diagnosis.forecast import forecasts
from sugiyama_ros.diagnosis.refine import without_folds
from sugiyama_ros.diagnosis.table import Entry
from sugiyama_ros.fit.joint import fit_base, start_model
from sugiyama_ros.fit.law import in_filter
from sugiyama_ros.fit.model import evaluate, follow
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.recording import some_drivers
from sugiyama_ros.laws import registry
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.trajectories.dense import tracks_of

CARS = 18
WHO = [0, 5, 11]


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def data():
    return prepare(tracks_of(jam(CARS, 60.0)))


@pytest.fixture(scope="module")
def base(data, work):
    return fit_base(data, data.even.individual(), work)


def entry(data, name, fitted, work):
    models = without_folds(data, fitted, work)
    return Entry(name, (), fitted, models, forecasts(data, models, work))


def test_some_drivers_are_predicted_as_among_all_drivers(data, work):
    """All drivers are alike here, so it does not matter whose parameters the vehicles ahead have."""
    model, part = start_model(data, data.even.individual()), some_drivers(data, WHO)
    alone = replace(model, rows=model.rows[WHO], ahead=model.ahead[WHO])
    all_, states = follow(data, model, work)
    some, of_some = follow(part, alone, work)
    np.testing.assert_array_equal(some.log_likelihood, all_.log_likelihood[WHO])
    np.testing.assert_array_equal(of_some[:, : len(WHO)], states[:, WHO])
    np.testing.assert_array_equal(evaluate(part, alone, work).innovation_m, all_.innovation_m[WHO])


def test_only_laws_that_may_be_better_are_fitted_to_all_drivers(data, base, work, monkeypatch):
    """The cars drive by the model of the paper, so that a constant speed is far behind. Then the IDM has to beat it."""
    names = ("constant_speed", "idm")
    assert set(names) < set(RIVALS) < set(registry.LAWS)
    monkeypatch.setattr("sugiyama_ros.diagnosis.base.LAWS", {names[0]: registry.LAWS[names[0]]})
    assert laws(data, entry(data, "base", base, work), work) == ()
    monkeypatch.setattr("sugiyama_ros.diagnosis.base.LAWS", {names[1]: registry.LAWS[names[1]]})
    slow = entry(data, "constant_speed", in_filter(data, "constant_speed", work), work)
    (idm,) = laws(data, slow, work)
    assert idm.name == "idm"
    assert idm.over(data, slow)["all"].is_clear
