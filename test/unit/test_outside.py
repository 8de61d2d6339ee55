"""The generator of drivers outside the catalogue: its driver is the paper's, written down a second time."""

import numpy as np
import pytest

from benchmarks import outside
from sugiyama_ros.driver.parameters import KAPPA_V, REFERENCE_HORIZON, REFERENCE_PERIOD_S, V_STAR, defaults
from sugiyama_ros.driver.utility import ACTIONS, mean_action


def test_both_drivers_mean_the_same():
    rng = np.random.default_rng(0)
    gap, speed, leader = rng.uniform(0.2, 40.0, 200), rng.uniform(0.0, 14.0, 200), rng.uniform(0.0, 14.0, 200)
    v_star, kappa_v = rng.uniform(6.0, 14.0, 200), rng.uniform(0.1, 0.5, 200)
    found = outside.mean_action(gap, speed, leader, v_star, kappa_v)
    for k in range(200):
        row = defaults()
        row[V_STAR], row[KAPPA_V] = v_star[k], kappa_v[k]
        own = mean_action(gap[k], speed[k], leader[k], row, ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON)
        assert found[k] == pytest.approx(own, abs=1e-9)
