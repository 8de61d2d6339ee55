"""The online filter at the rates at which samples come: its speed does not depend on them."""

import math

import numpy as np
import pytest

from sugiyama_ros.filters.first_look import steps_between
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.road import Road

PERIOD_S, SPEED, NOISE_M, DURATION_S = 0.1, 12.0, 0.263, 60.0


def mean_speed_errors(time_s, seed, amplitude=0.0):
    """Mean and mean size of the speed error [m/s] after 10 s, behind a leader 30 m ahead at the same speed.

    The speed swings around 12 m/s within 20 s; ``amplitude``: by how much [m/s].
    """
    rng, turn = np.random.default_rng(seed), 2.0 * math.pi / 20.0
    position = SPEED * time_s + amplitude / turn * np.sin(turn * time_s)
    speed = SPEED + amplitude * np.cos(turn * time_s)
    own = position + rng.normal(0.0, NOISE_M, len(time_s))
    leader = position + 30.0 + rng.normal(0.0, NOISE_M, len(time_s))
    filter_, last, errors = OnlineFilter(PERIOD_S, Road()), None, []
    for k, now in enumerate(time_s.tolist()):
        elapsed = None if last is None else now - last
        estimate = filter_.step([own[k], leader[k], math.nan], [1, 2, -1], [4.5, 4.5, 0.0], now, elapsed_s=elapsed)
        last = now
        if now > 10.0:
            errors.append(estimate.speed - speed[k])
    return np.array([np.mean(errors), np.mean(np.abs(errors))])


def jittered():
    regular = np.arange(0.0, DURATION_S, PERIOD_S)
    return regular + np.random.default_rng(9).uniform(-0.045, 0.045, len(regular))


TIMES = {
    "7 Hz": np.arange(0.0, DURATION_S, 1.0 / 7.0),
    "jitter": jittered(),
}


@pytest.mark.parametrize("name", TIMES)
def test_the_speed_error_is_that_of_regular_samples(name):
    """Within 0.05 m/s, in the mean over 8 drives."""
    regular = np.mean([mean_speed_errors(np.arange(0.0, DURATION_S, PERIOD_S), seed) for seed in range(8)], axis=0)
    other = np.mean([mean_speed_errors(TIMES[name], seed) for seed in range(8)], axis=0)
    assert np.abs(other - regular).max() < 0.05


def test_a_predicted_time_depends_on_the_number_of_steps_as_eulers_rule_does():
    """Speed and variances over 0.4 s without a sample: with twice as many steps, the change is about half as large.

    The entries that Euler's rule moves exactly, such as the correlated noise, do not depend on the steps.
    """
    ends = []
    for pieces in (16, 32, 64):
        filter_ = OnlineFilter(PERIOD_S, Road(), vehicles=1)
        for k in range(50):
            filter_.step([1.2 * k], [1], [4.5], k * PERIOD_S)
        for k in range(pieces):
            filter_.step([math.nan], [1], [4.5], 4.9 + 0.4 * (k + 1) / pieces, elapsed_s=0.4 / pieces)
        covariance = filter_.kalman.P
        ends.append((covariance[0, 0], covariance[1, 1], covariance[2, 2]))
    position, speed, noise = np.diff(ends, axis=0).T
    assert position[0] / position[1] == pytest.approx(2.0, rel=0.15)
    assert speed[0] / speed[1] == pytest.approx(2.0, rel=0.15)
    assert np.abs(noise).max() < 1e-12


@pytest.mark.parametrize(
    ("elapsed_s", "expected"),
    [(0.1, (1, 1.0)), (0.3, (3, 1.0)), (0.100000001, (1, 1.0)), (0.04, (1, 0.4)), (0.25, (2, 1.25)), (0.14, (1, 1.4))],
)
def test_steps_between_two_samples(elapsed_s, expected):
    assert steps_between(elapsed_s, PERIOD_S) == pytest.approx(expected)
