"""Collective measures of waves that are known."""

import numpy as np
import pytest

from sugiyama_ros.simulation.collective import collective, wave_speed_error

PERIOD_S, RING_M, DRIVERS = 1.0 / 3.0, 230.0, 22


def wave(speed_of_wave: float, mean: float = 7.0, swing: float = 3.0):
    """Drivers whose speed is a sine over place and time. The sine moves at ``speed_of_wave``."""
    time = np.arange(900)[:, None] * PERIOD_S
    number = 2.0 * np.pi / RING_M
    position = RING_M / DRIVERS * np.arange(DRIVERS) * np.ones((900, 1))
    speed = np.empty((900, DRIVERS))
    for k in range(900):
        speed[k] = mean + swing * np.sin(number * (position[k] - speed_of_wave * time[k]))
        if k + 1 < 900:
            position[k + 1] = position[k] + PERIOD_S * speed[k]
    leader = np.tile((np.arange(DRIVERS) + 1) % DRIVERS, (900, 1))
    headway = np.mod(np.take_along_axis(position, leader, axis=1) - position, RING_M)
    return speed, headway, leader


@pytest.mark.parametrize("speed_of_wave", [-4.0, -6.0])
def test_speed_and_period_of_a_wave(speed_of_wave):
    speed, headway, leader = wave(speed_of_wave)
    found = collective(speed, headway, leader, PERIOD_S)
    # drivers are slower in the wave, so they meet it at their own mean speed
    assert found.wave_speed == pytest.approx(speed_of_wave, abs=0.5)
    meets = RING_M / (speed.mean() - speed_of_wave)
    assert found.period_s == pytest.approx(meets, rel=0.05)
    assert found.mean_speed == pytest.approx(speed.mean())
    assert found.least_speed == pytest.approx(speed.min(axis=1).mean())


def test_missing_samples_and_drivers_do_not_matter():
    speed, headway, leader = wave(-5.0)
    whole = collective(speed, headway, leader, PERIOD_S)
    speed[:7] = np.nan
    speed[400:420, 3] = np.nan
    found = collective(speed, headway, leader, PERIOD_S)
    assert found.wave_speed == pytest.approx(whole.wave_speed, abs=0.2)
    assert found.period_s == pytest.approx(whole.period_s, abs=2.0 * PERIOD_S)


def test_free_flow_before_a_wave_does_not_count():
    speed, headway, leader = wave(-6.0)
    # everybody drives at 9 m/s first: the wave is slower
    free = np.full((900, DRIVERS), 9.0)
    both = collective(np.vstack([free, speed]), np.vstack([np.full_like(free, RING_M / DRIVERS), headway]),
                      np.vstack([leader, leader]), PERIOD_S)  # fmt: skip
    assert both.wave_speed == pytest.approx(-6.0, abs=0.5)


def test_queue_counts_the_standing_drivers():
    speed = np.full((50, 4), 8.0)
    speed[:, :3] = 0.5
    found = collective(speed, np.full((50, 4), 10.0), np.full((50, 4), -1), PERIOD_S)
    assert found.queue_vehicles == 3.0
    assert np.isnan(found.wave_speed)
    assert np.isnan(found.period_s)


def test_the_error_of_a_wave_follows_from_its_blocks_of_time():
    steady, headway, leader = wave(-5.0)
    assert wave_speed_error(steady, headway, leader, PERIOD_S) < 0.1
    # the wave of the second half is faster
    other, other_headway, _ = wave(-7.0)
    both = np.vstack([steady, other]), np.vstack([headway, other_headway]), np.vstack([leader, leader])
    assert 0.2 < wave_speed_error(*both, PERIOD_S) < 2.0
    assert np.isnan(wave_speed_error(steady[:240], headway[:240], leader[:240], PERIOD_S))
    assert np.isnan(wave_speed_error(np.full_like(steady, 8.0), headway, leader, PERIOD_S))


def test_samples_that_are_known_at_other_times_are_no_wave():
    """At some lags no two samples are known together. Warnings are errors."""
    speed, headway, leader = wave(-5.0)
    speed[1::2] = np.nan
    found = collective(speed, headway, leader, PERIOD_S)
    assert found.mean_speed == pytest.approx(speed[::2].mean())
    assert found.period_s == pytest.approx(RING_M / (speed[::2].mean() + 5.0), rel=0.05)
    speed[6:] = np.nan
    few = collective(speed, headway, leader, PERIOD_S)
    assert np.isnan([few.wave_speed, few.period_s]).all()
    assert few.mean_speed == pytest.approx(np.nanmean(speed))
