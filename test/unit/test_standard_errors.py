"""Standard errors: closed forms, and infinity where the data say nothing."""

import numpy as np
import pytest

from sugiyama_ros.filters.paper import Scored
from sugiyama_ros.fit.driver import calibrate, stds, untouched
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks

PLACES = np.array([0, 1, 2])


def scored(information):
    return Scored(0.0, np.zeros(len(information)), information)


def test_they_are_the_roots_of_the_inverse_information():
    information = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, 2.0]])
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    assert stds(scored(information), np.ones(3), PLACES) == pytest.approx(expected, rel=1e-12)


def test_no_information_is_no_knowledge():
    information = np.diag([4.0, 0.0, 2.0])
    assert stds(scored(information), np.ones(3), PLACES).tolist() == [0.5, np.inf, pytest.approx(2.0**-0.5)]


def test_a_combination_without_information_leaves_both_unknown():
    """The data hold the sum of the first two parameters, and nothing else of them."""
    information = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert untouched(information, np.ones(3)).tolist() == [True, True, False]


def test_a_car_that_nobody_leads_does_not_tell_its_risk_premium():
    """Without a leader there is no gap, so that kappa_v changes nothing."""
    rng, time = np.random.default_rng(0), np.arange(150) / 3.0
    position = (8.0 * time + 20.0 * np.sin(0.1 * time) + 0.26 * rng.standard_normal(150))[:, None]
    alone = DenseTracks(position, np.array([4.33]), np.array([1]), Road(), 1.0 / 3.0)
    for formulation in ("paper", "causal"):
        (fit,) = calibrate(alone, formulation)
        assert np.isinf(fit.std[3]), formulation
        assert not fit.identified("kappa_v")
        assert fit.identified("sigma_nu")
