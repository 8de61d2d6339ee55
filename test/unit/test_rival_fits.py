"""Other laws: fits to some drivers first, and no fit in full where it could not matter."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.speed.timing import jam
from sugiyama_ros.diagnosis.forecast import forecasts, surroundings
from sugiyama_ros.diagnosis.refine import without_folds
from sugiyama_ros.diagnosis.rivals import laws
from sugiyama_ros.diagnosis.table import Entry
from sugiyama_ros.fit.joint import fit_base, fit_nearly, start_model
from sugiyama_ros.fit.law import in_filter, start_of, start_of_drivers
from sugiyama_ros.fit.recording import prepare, some_drivers
from sugiyama_ros.fit.score import evaluate, follow
from sugiyama_ros.laws import registry
from sugiyama_ros.laws.registry import LAWS, RIVALS

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
def base(data, work):
    return fit_base(data, data.even.individual(), work)


def entry(data, around, name, fitted, work):
    models = without_folds(data, fitted, work)
    return Entry(name, (), fitted, models, forecasts(data, around, models, work))


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


def test_only_laws_that_may_be_better_are_fitted_to_all_drivers(data, base, work, monkeypatch):
    """The cars drive by the model of the paper, so that a constant speed is far behind. Then the IDM has to beat it."""
    around, names = surroundings(data, base.model, work), ("constant_speed", "idm")
    assert set(names) < set(RIVALS) < set(registry.LAWS)
    monkeypatch.setattr("sugiyama_ros.diagnosis.rivals.LAWS", {names[0]: registry.LAWS[names[0]]})
    assert laws(data, around, entry(data, around, "base", base, work), work) == ()
    monkeypatch.setattr("sugiyama_ros.diagnosis.rivals.LAWS", {names[1]: registry.LAWS[names[1]]})
    slow = entry(data, around, "constant_speed", in_filter(data, "constant_speed", work), work)
    (idm,) = laws(data, around, slow, work)
    assert idm.name == "idm"
    assert idm.over(data, slow)["all"].is_clear


@pytest.mark.parametrize("law", ["idm", "fvdm", "gipps"])
def test_a_fit_that_does_not_come_to_the_end_lacks_little(data, work, law):
    """A law that is far behind lacks hundreds of nats."""
    alone = some_drivers(data, range(0, 16, 2))
    lacks = in_filter(alone, law, work).log_likelihood - nearly(alone, law, work).log_likelihood
    assert lacks < 60.0


def test_a_law_starts_at_the_speeds_of_the_data():
    slow, fast = start_of("fvdm", 5.0), start_of("fvdm", 30.0)
    assert np.array_equal(slow, [p.default for p in LAWS["fvdm"].parameters])
    free = [LAWS["fvdm"].function(1e9, 29.0, 29.0, values) > 0.0 for values in (slow, fast)]
    assert free == [False, True]
    assert len(start_of("constant_speed", 30.0)) == 0
