"""The Kalman algebra of filters that run side by side, against numpy and against the algebra of one filter."""

import numpy as np
import pytest

from sugiyama_ros.filters.abreast import (
    ABREAST,
    OFF,
    SHRINK,
    SLOPE,
    STEP,
    abreast_for,
    linearised_of,
    predict,
    share_columns,
    update,
)
from sugiyama_ros.filters.predict import predict as predict_one
from sugiyama_ros.filters.state import STATE, State

_SIZE = 2 * STATE + 1
# the held accelerations do not matter
_LIVE = np.array([0, 1, 2, 4, 5, 6, 8])


@pytest.fixture
def abreast(rng):
    """Filters with random states, each with other entries of F that may differ from 0."""
    filters = abreast_for(_LIVE, _SIZE)
    dead = np.setdiff1d(np.arange(_SIZE), _LIVE)
    for c in range(ABREAST):
        root = rng.normal(size=(_SIZE, _SIZE))
        root[dead] = 0.0
        filters.covariance[:, :, c] = root @ root.T
        filters.mean[:, c] = rng.normal(size=_SIZE)
        one = linearised_of.py_func(c, filters)
        one.next_mean[:] = rng.normal(size=_SIZE)
        for i in range(_SIZE):
            columns = np.sort(rng.choice(_LIVE, size=rng.integers(1, 4), replace=False))
            one.columns[i, : len(columns)], one.counts[i] = columns, len(columns)
            one.jacobian[i, columns] = rng.normal(size=len(columns))
        for first in range(0, _SIZE, STATE):
            block = slice(first, min(first + STATE, _SIZE))
            part = rng.normal(size=(block.stop - first, block.stop - first))
            one.noise[block, block] = part @ part.T
        share_columns(c, filters)
    return filters


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def test_prediction_is_the_prediction_of_one_filter_bit_for_bit(abreast):
    expected = []
    for c in range(ABREAST):
        state = State(abreast.mean[:, c].copy(), abreast.covariance[:, :, c].copy(), np.zeros(2, np.int64))
        predict_one(state, linearised_of.py_func(c, abreast), np.zeros((_SIZE, _SIZE)))
        expected.append((state.mean, state.covariance))
    predict(abreast)
    live = np.ix_(_LIVE, _LIVE)
    for c, (mean, covariance) in enumerate(expected):
        np.testing.assert_array_equal(abreast.mean[:, c], mean)
        np.testing.assert_array_equal(abreast.covariance[:, :, c][live], covariance[live])


def test_update_is_the_update_of_a_kalman_filter(abreast, rng):
    entry, noise_var = 4, 0.3
    y, slope = rng.normal(size=ABREAST), rng.uniform(0.8, 1.2, size=ABREAST)
    expected = []
    for c in range(ABREAST):
        mean, covariance = abreast.mean[:, c].copy(), abreast.covariance[:, :, c].copy()
        gain = slope[c] * covariance[:, entry]
        variance = slope[c] ** 2 * covariance[entry, entry] + noise_var
        expected.append((mean + gain * y[c] / variance, covariance - np.outer(gain, gain) / variance))
        abreast.sample[[SLOPE, OFF, STEP, SHRINK], c] = slope[c], -y[c], 1.0 / variance, 1.0 / variance
    # one filter gets no sample
    abreast.sample[:, 2] = 0.0
    expected[2] = abreast.mean[:, 2].copy(), abreast.covariance[:, :, 2].copy()
    update(entry, abreast)
    live = np.ix_(_LIVE, _LIVE)
    for c, (mean, covariance) in enumerate(expected):
        np.testing.assert_allclose(abreast.mean[_LIVE, c], mean[_LIVE], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(abreast.covariance[:, :, c][live], covariance[live], rtol=1e-12, atol=1e-12)
