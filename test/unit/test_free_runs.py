"""Free runs: vehicles that drive by the model from a given state on."""

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import SIGMA_A, at_period, defaults, horizon_at
from sugiyama_ros.driver.utility import ACTIONS
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.model import between_measurements
from sugiyama_ros.fit.preparation import prepare, prepare_stretches
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.drive import Order, Setting
from sugiyama_ros.simulation.free_run import run_coupled, run_single
from sugiyama_ros.trajectories.dense import DenseTracks, tracks_of

_PERIOD_S, _STEPS, _LENGTH_M = 1.0 / 3.0, 30, 4.0


@pytest.mark.parametrize("run", ["single", "coupled"])
def test_nobody_drives_through_the_vehicle_ahead(run):
    """A driver at 20 m/s, 12 m behind a vehicle that stands: nobody can brake so hard."""
    recorded = np.zeros((_STEPS + 1, 2, 4))
    recorded[:, 0, :2], recorded[:, 1, 0] = (0.0, 20.0), 16.0
    order = Order(np.array([1, -1]), np.zeros(2), np.full(2, _LENGTH_M), np.full((2, 4), np.nan))
    no_lines = np.full((_STEPS + 1, 2, 4), np.nan)
    rows = at_period(np.tile(ROW.with_effects(defaults()), (2, 1)), _PERIOD_S)
    setting = Setting(_PERIOD_S, horizon_at(_PERIOD_S), 0.0)
    out = np.full((_STEPS, 2, 2), np.nan)
    if run == "single":
        run_single(np.array([0]), recorded, order, rows, ACTIONS, 0.0, setting, no_lines, np.zeros((_STEPS, 2)), out)
    else:
        run_coupled(recorded, order, rows, ACTIONS, 0.0, setting, np.zeros((_STEPS, 2)), out)
    gap = 16.0 - out[:, 0, 0] - _LENGTH_M
    assert gap.min() == pytest.approx(0.0, abs=1e-9)
    assert out[np.argmin(gap), 0, 1] <= 0.0


_CARS, _RING_M = 10, 105.0


def ends_in_a_jam(shock, sigma_a=None):
    """Positions after 10 s of cars that start 2 m apart and nearly stand, (CARS,) [m]."""
    recorded = np.zeros((_STEPS + 1, _CARS, 4))
    recorded[0, :, 0], recorded[0, :, 1] = 6.0 * np.arange(_CARS), 0.5
    turn = np.where(np.arange(_CARS) == _CARS - 1, -_RING_M, 0.0)
    order = Order(np.roll(np.arange(_CARS), -1), turn, np.full(_CARS, _LENGTH_M), np.full((_CARS, 4), np.nan))
    parameters = defaults(_CARS)
    if sigma_a is not None:
        parameters[:, SIGMA_A] = sigma_a
    rows = at_period(ROW.with_effects(parameters), _PERIOD_S)
    out = np.full((_STEPS, _CARS, 2), np.nan)
    run_coupled(recorded, order, rows, ACTIONS, 0.0, Setting(_PERIOD_S, horizon_at(_PERIOD_S), _RING_M), shock, out)
    return out[-1, :, 0]


def test_without_acceleration_noise_shocks_change_nothing():
    shock = np.random.default_rng(3).standard_normal((_STEPS, _CARS))
    np.testing.assert_array_equal(ends_in_a_jam(shock, 0.0), ends_in_a_jam(np.zeros_like(shock), 0.0))


def test_motion_between_measurements_is_the_smooth_curve_through_them():
    time = np.arange(40.0)
    position = np.column_stack((5.0 * time + 0.05 * time**2, 30.0 + 5.0 * time + 0.05 * time**2))
    recording = DenseTracks(position, np.full(2, _LENGTH_M), np.array([1, 2]), Road(0.0), period_s=1.0)
    for data in (prepare(tracks_of(recording)), prepare_stretches(tracks_of(recording))):
        assert data.every == 3
        states = np.full((data.samples, data.vicinity.leader.shape[1], 4), np.nan)
        there = np.arange(0.0, data.samples) / 3.0
        x, v = 5.0 * there + 0.05 * there**2, 5.0 + 0.1 * there
        states[:, 0] = np.column_stack((x, v, 0.0 * x, 0.0 * x))
        jumping = states.copy()
        jumping[np.arange(data.samples) % 3 > 0, 0, :2] += 2.0
        last = 3 * (len(time) - 1)
        moved = between_measurements(data, jumping)[: last + 1, 0]
        np.testing.assert_allclose(moved, states[: last + 1, 0], atol=1e-9)
