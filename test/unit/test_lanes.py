"""Lanes: the same mean actions as one moment at a time, whatever stands beside them."""

import numpy as np
import pytest

from sugiyama_ros.driver.lanes import LANES, MEAN, average_actions, blocks_for, find_best, grid_for, put, value_actions
from sugiyama_ros.driver.parameters import KAPPA_C, KAPPA_D, KAPPA_V, V_STAR, defaults
from sugiyama_ros.driver.utility import ACTIONS, mean_action, preferences


def decide(block, grid, period, horizon):
    value_actions(block, grid, period, horizon)
    average_actions(block, grid.actions)
    return block[MEAN : MEAN + LANES].copy()


@pytest.mark.parametrize(("period", "horizon"), [(1.0 / 3.0, 4), (0.1, 13), (1.0, 1), (0.5, 2), (0.4, 3)])
def test_lanes_decide_as_the_utility_says(period, horizon):
    """Only the ends of the look-ahead are looked at where drivers do not brake; any preferences, any moment."""
    rng, grid = np.random.default_rng(5), grid_for(ACTIONS, period)
    for _ in range(40):
        (block,) = blocks_for(LANES, len(ACTIONS))
        expected = []
        for lane in range(LANES):
            p = defaults()
            p[[V_STAR, KAPPA_V, KAPPA_C, KAPPA_D]] *= np.exp(0.5 * rng.standard_normal(4))
            seen = rng.uniform(-1.0, 30.0), rng.uniform(-1.0, 15.0), rng.uniform(-1.0, 15.0)
            put(block, lane, *seen, preferences(p))
            expected.append(mean_action(*seen, p, ACTIONS, period, horizon))
        # rounding of utilities, times the rationality of 200, as in the test of the mean action
        assert decide(block, grid, period, horizon) == pytest.approx(expected, abs=2e-11)


def test_a_lane_does_not_depend_on_its_neighbours():
    grid, (alone,), (beside,) = grid_for(ACTIONS, 0.2), blocks_for(1, len(ACTIONS)), blocks_for(1, len(ACTIONS))
    put(alone, 3, 4.0, 6.0, 5.0, preferences(defaults()))
    for lane in range(LANES):
        put(beside, lane, 4.0 + 3.0 * abs(lane - 3), 6.0, 5.0, preferences(defaults()))
    assert decide(alone, grid, 0.2, 6)[3] == decide(beside, grid, 0.2, 6)[3]


def test_no_leader_is_a_free_road_and_the_best_action_can_be_found_again():
    grid, (block,) = grid_for(ACTIONS, 1.0 / 3.0), blocks_for(1, len(ACTIONS))
    put(block, 0, np.inf, 5.0, 0.0, preferences(defaults()))
    first = decide(block, grid, 1.0 / 3.0, 4)
    assert first[0] == pytest.approx(mean_action(np.inf, 5.0, 0.0, defaults(), ACTIONS, 1.0 / 3.0, 4), abs=1e-12)
    find_best(block, len(ACTIONS))
    average_actions(block, grid.actions)
    assert np.array_equal(block[MEAN : MEAN + LANES], first)
