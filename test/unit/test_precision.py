"""Double and single precision of what takes most of the filters' time: the exponential and the mean actions."""

import numpy as np
import pytest

from sugiyama_ros.driver.batch import MEAN, SLOTS, average_actions, blocks_for, grid_for, put, value_actions
from sugiyama_ros.driver.exponential import LOWEST, exponential
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.driver.utility import ACTIONS, mean_action, preferences

_PERIOD, _HORIZON = 1.0 / 3.0, 4


@pytest.mark.parametrize(
    ("kind", "lowest", "everywhere", "near"),
    [(np.float64, LOWEST[0], 3e-14, 1e-15), (np.float32, LOWEST[1], 6e-6, 2e-7)],
)
def test_the_exponential_is_as_exact_as_it_says(kind, lowest, everywhere, near):
    """The bounds are those of the docstring; near: from -10 to 1, or from -1 to 1 in single precision."""
    x = np.concatenate((np.linspace(lowest, 80.0, 20_001), np.linspace(-10.0, 1.0, 20_001))).astype(kind)
    error = np.array([float(exponential(one)) for one in x]) / np.exp(x.astype(np.float64)) - 1.0
    assert np.abs(error).max() < everywhere
    is_near = (x > (-10.0 if kind is np.float64 else -1.0)) & (x < 1.0)
    assert np.abs(error[is_near]).max() < near
    assert exponential(kind(-1e6)) == exponential(kind(lowest)) > 0.0


@pytest.mark.parametrize(("kind", "most"), [(np.float64, 1e-9), (np.float32, 1e-4)])
def test_mean_actions_in_a_batch_are_those_of_one_driver(kind, most):
    """Jams and free flow, large and negative gaps, standing and rolling backward; rewards too small for a recursion."""
    rng, actions = np.random.default_rng(3), ACTIONS.astype(kind)
    blocks, grid = blocks_for(4 * SLOTS, actions), grid_for(actions, _PERIOD)
    seen = np.column_stack((rng.uniform(-1.0, 40.0, 64), rng.uniform(-3.0, 30.0, 64), rng.uniform(-0.5, 30.0, 64)))
    driver = defaults()
    for k, (gap, speed, leader_speed) in enumerate(seen):
        put(blocks[k // SLOTS], k % SLOTS, gap, speed, leader_speed, preferences(driver))
    for block in blocks:
        value_actions(block, grid, _PERIOD, _HORIZON)
        average_actions(block, grid.actions)
    # processors take many times as long for subnormal numbers
    assert np.abs(blocks[blocks != 0.0]).min() >= np.finfo(kind).tiny
    one_by_one = [mean_action(*one, driver, ACTIONS, _PERIOD, _HORIZON) for one in seen]
    np.testing.assert_allclose(blocks[:, MEAN : MEAN + SLOTS].ravel(), one_by_one, atol=most)
