"""Noises of position and speed that differ from the paper's constants."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from benchmarks.away.drivers import drawn
from benchmarks.away.world import Setup, record
from sugiyama_ros.diagnosis.base import base_model
from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_V, SIGMA_X
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.trajectories.dense import tracks_of


def _driven(noise: float):
    """A jam of drivers with so many times the usual noises."""
    scene, rng = Setup(noise=noise, duration_s=120.0), np.random.default_rng(11)
    recording = record(scene, drawn(scene.drivers, rng, noise=noise), (), rng)
    assert recording is not None
    return prepare(tracks_of(recording))


def test_noises_are_fitted_where_the_constants_of_the_paper_do_not_suit():
    noise = 0.3
    with ThreadPoolExecutor(2) as work:
        data, base = base_model(_driven(noise), work)
    own = base.model.individual
    assert data.even.has_other_noises
    assert {SIGMA_X, SIGMA_V} <= set(own)
    # 0.28 m/s^2 as usual; the fixed noises leave less than a tenth of a third of it
    assert np.median(base.model.rows[:, SIGMA_A]) == pytest.approx(0.28 * noise, rel=0.25)
