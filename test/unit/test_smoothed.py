"""Simulated positions are smoothed as those of the recording are."""

from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.diagnosis.smoothed import as_smoothed, before_smoothing
from sugiyama_ros.driver.parameters import SIGMA_NU
from sugiyama_ros.fit.population import start_model
from sugiyama_ros.fit.recording import Recorded, prepare
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.trajectories import Trajectories

_PERIOD_S, _WINDOW, _SAMPLES = 0.1, 9, 4000


@pytest.fixture(scope="module")
def smoothed() -> Recorded:
    """Two vehicles whose positions somebody has smoothed over 0.9 s."""
    way = 10.0 * _PERIOD_S * np.arange(_SAMPLES)
    data = prepare(Trajectories(np.stack([way, way + 50.0], 1), np.full(2, 4.5), np.arange(2), Road(0.0), _PERIOD_S))
    return replace(data, smoothed_s=_WINDOW * _PERIOD_S)


def test_an_average_over_the_window_has_the_noise_of_the_model(smoothed: Recorded) -> None:
    model = start_model(smoothed, (SIGMA_NU,))
    rough = before_smoothing(smoothed, model).rows[0, SIGMA_NU]
    noise = rough * np.random.default_rng(0).standard_normal((_SAMPLES, 2))
    way = np.asarray(10.0 * _PERIOD_S * np.arange(_SAMPLES))[:, None]
    found = as_smoothed(smoothed, way + noise, np.zeros((2, _SAMPLES), dtype=np.int64)) - way
    known = found[np.isfinite(found).all(axis=1)]
    assert len(known) == _SAMPLES - _WINDOW + 1
    # 8,000 samples, of which one in nine is independent: five standard errors are 12 %
    assert known.std() == pytest.approx(model.rows[0, SIGMA_NU], rel=0.12)
    # averages that are three quarters of the window apart share a quarter of it
    apart = 7
    shared = (known[:-apart] * known[apart:]).mean() / known.var()
    assert shared == pytest.approx(1.0 - apart / _WINDOW, abs=0.12)


def test_no_average_reaches_over_a_break(smoothed: Recorded) -> None:
    way = np.repeat([[0.0], [1000.0]], _SAMPLES // 2, axis=0) * np.ones((1, 2))
    segment = np.tile(np.repeat([0, 1], _SAMPLES // 2), (2, 1))
    found = as_smoothed(smoothed, way, segment)
    assert np.unique(np.round(found[np.isfinite(found)], 6)).tolist() == [0.0, 1000.0]
    assert np.isnan(found[_SAMPLES // 2]).all()


def test_positions_that_nobody_has_smoothed_stay(smoothed: Recorded) -> None:
    rough = replace(smoothed, smoothed_s=0.0)
    model = start_model(rough, (SIGMA_NU,))
    position = np.random.default_rng(0).standard_normal((_SAMPLES, 2))
    np.testing.assert_array_equal(before_smoothing(rough, model).rows, model.rows)
    assert as_smoothed(rough, position, np.zeros((2, _SAMPLES), dtype=np.int64)) is position
