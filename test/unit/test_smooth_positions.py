"""Smooth positions: what is estimated then, and that the filter knows its own errors."""

from dataclasses import replace

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.calibration.soundness import mean_nis
from sugiyama_ros.driver.parameters import SIGMA_NU, SIGMA_V, SIGMA_X, V_STAR, defaults
from sugiyama_ros.filters.first_look import SIGMAS
from sugiyama_ros.fit.coordinates import SMALLEST, lower_bounds
from sugiyama_ros.fit.smooth_positions import ESTIMATED, FREED, evenness
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks


def recording(noise_std, vehicles=3, samples=900, period_s=0.1):
    """Vehicles that follow each other smoothly, measured with white noise."""
    time = period_s * np.arange(samples)
    rng = np.random.default_rng(4)
    own = [12.0 * time + 20.0 * np.sin(0.15 * time - 0.4 * i) - 25.0 * i for i in range(vehicles)]
    position = np.column_stack(own) + noise_std * rng.standard_normal((samples, vehicles))
    return DenseTracks(
        position_m=position,
        length_m=np.full(vehicles, 4.5),
        vehicle=np.arange(1, vehicles + 1),
        period_s=period_s,
        start_s=0.0,
        road=Road(0.0),
        source="test",
        sha256="",
    )


def test_roughness_is_the_noise_of_third_differences():
    # third differences of white noise have 20 times its variance; 2700 of them know their std to 3 %
    assert evenness(recording(0.05)).roughness_m == pytest.approx(0.05 * np.sqrt(20.0), rel=0.1)


def test_a_camera_is_not_smooth_and_positions_from_a_satellite_are():
    camera = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1).dense
    even = evenness(camera)
    assert not even.is_smooth
    assert even.estimated() == ESTIMATED
    assert np.array_equal(even.typical(12.0)[[SIGMA_NU, SIGMA_X, SIGMA_V]], defaults()[[SIGMA_NU, SIGMA_X, SIGMA_V]])
    assert (lower_bounds(even) == SMALLEST).all()
    smooth = evenness(recording(0.001))
    assert smooth.is_smooth
    assert smooth.estimated() == ESTIMATED + FREED
    assert smooth.estimated("paper") == ESTIMATED
    assert (smooth.typical(12.0)[[SIGMA_NU, SIGMA_X, SIGMA_V]] < defaults()[[SIGMA_NU, SIGMA_X, SIGMA_V]]).all()
    assert (lower_bounds(smooth)[SIGMAS] < 1e-4).all()


def standing() -> DenseTracks:
    moving = recording(0.0)
    return replace(moving, position_m=np.tile(moving.position_m[:1], (len(moving.position_m), 1)))


def test_vehicles_that_stand_still_show_no_noise_but_drivers_have_some():
    still = evenness(standing())
    assert np.isnan(still.roughness_m)
    assert np.array_equal(still._replace(has_other_noises=True).typical(0.0), still.typical(0.0))
    assert np.isfinite(still.typical(0.0)).all()


def test_the_desired_speed_starts_above_the_speeds_of_a_motorway():
    even = evenness(recording(0.05))
    assert even.typical(12.0)[V_STAR] == defaults()[V_STAR]
    assert even.typical(30.0)[V_STAR] == pytest.approx(33.0)


def test_the_filter_knows_its_errors_on_smooth_positions():
    noises = {"sigma_nu": 0.004, "sigma_x": 0.0005, "sigma_v": 0.005}
    t = sg.simulate(vehicles=4, ring_m=45.0, duration_s=90.0, period_s=0.1, seed=3, parameters=noises).measured
    found = sg.calibrate(t)
    assert set(found.settings.estimated) == {*ESTIMATED, *FREED}
    # 900 samples each know a mean NIS to 5 %; with the fixed noises it is below 0.2
    assert mean_nis(found) == pytest.approx(1.0, abs=0.2)
    assert found.rows[:, SIGMA_NU] == pytest.approx(0.004, rel=0.25)
