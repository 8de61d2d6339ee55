"""Which candidates stay beside the best one: by their held-out predictions of each driver."""

from types import SimpleNamespace

import numpy as np
import pytest

from sugiyama_ros.diagnosis import telling_apart
from sugiyama_ros.diagnosis.telling_apart import indistinguishable

DRIVERS = 20


@pytest.fixture(autouse=True)
def _fits_are_predictions(monkeypatch):
    """A fit is here what it predicts, one sample of each driver."""
    monkeypatch.setattr(telling_apart, "held_out_nearly", lambda data, fit: predicted(fit))


def predicted(log_likelihood: np.ndarray) -> SimpleNamespace:
    """Held-out predictions of drivers."""
    return SimpleNamespace(log_likelihood=log_likelihood)


@pytest.fixture
def data():
    return SimpleNamespace(block=np.zeros((DRIVERS, 1), int))


def each(nats: float, spread: float = 0.01) -> np.ndarray:
    """Predictions that sum up to so many nats, with alternating parts of each driver."""
    return (nats / DRIVERS + spread * np.where(np.arange(DRIVERS) % 2, 1.0, -1.0))[:, None]


def test_a_rival_that_is_not_clearly_worse_stays(data):
    near, far = each(60.0, spread=3.0), each(20.0)
    assert indistinguishable(
        data, predicted(each(0.0)), ("drag", predicted(each(70.0))), [("grade", near), ("lag", far)]
    ) == ("grade",)


def test_the_closest_rival_stays_if_it_has_three_quarters_of_the_gain(data):
    """All rivals are clearly worse, driver by driver."""
    others = [("lag", each(34.0)), ("patch", each(33.0)), ("drag", each(5.0))]
    assert indistinguishable(data, predicted(each(0.0)), ("delay", predicted(each(42.0))), others) == ("lag",)
    assert indistinguishable(data, predicted(each(0.0)), ("delay", predicted(each(42.0))), [("lag", each(31.0))]) == ()
    # the gain counts from the model without them
    assert indistinguishable(data, predicted(each(30.0)), ("delay", predicted(each(42.0))), others) == ()


def test_of_a_small_gain_half_is_enough(data):
    found = [
        indistinguishable(data, predicted(each(0.0)), ("delay", predicted(each(won))), [("lag", each(won - lost))])
        for won, lost in ((24.0, 9.0), (24.0, 11.0), (14.0, 8.0))
    ]
    assert found == [("lag",), (), ()]


def test_nothing_is_a_rival_of_itself_or_twice(data):
    best = each(42.0)
    others = [("delay", best), ("lag", best), ("lag", each(0.0))]
    assert indistinguishable(data, predicted(each(0.0)), ("delay", predicted(best)), others) == ("lag",)
    assert indistinguishable(data, predicted(each(0.0)), ("delay", predicted(best)), []) == ()
