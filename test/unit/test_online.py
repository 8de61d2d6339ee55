"""What is learnt of a driver while he drives."""

from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU, defaults, population
from sugiyama_ros.estimation.causal import Adaptation, chain_behind
from sugiyama_ros.estimation.noise import Learning
from sugiyama_ros.estimation.online import OnlineFilter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation import Simulator, platoon, simulate

DT = 1.0 / 3.0


@pytest.fixture(scope="module")
def jam():
    length = np.full(22, 4.33)
    start = platoon(length, 2.0)
    return simulate(Simulator(defaults(22), length, start, Road(230.0), np.random.default_rng(0)), 150.0).measured


def follow(t, driver, online, samples=None):
    """Estimates of a driver, sample by sample."""
    chain = chain_behind(t, driver, online.vehicles)
    steps = zip(chain.position_m[:samples], chain.identity, chain.length_m, strict=False)
    return [online.step(*s) for s in steps]


@pytest.mark.parametrize(("place", "k", "vehicles", "tolerance"), [(SIGMA_NU, 0, 1, 1e-6), (SIGMA_A, 1, 3, 0.3)])
def test_sensitivities_to_the_noises_are_what_differences_say(jam, place, k, vehicles, tolerance):
    """Exact where the model is linear; of a chain within a third, since its F depends on the covariance too."""
    fixed = Learning((1e-9, 1e-9))
    online = OnlineFilter(DT, jam.road, defaults(), adaptation=Adaptation(), learning=fixed, vehicles=vehicles)
    follow(jam, 3, online, 80)
    ends = []
    for side in (1.0, -1.0):
        row = defaults()
        row[place] *= np.exp(side * 1e-4)
        other = OnlineFilter(DT, jam.road, row, adaptation=Adaptation(), learning=None, vehicles=vehicles)
        follow(jam, 3, other, 80)
        ends.append((other._filter.x.copy(), other._filter.P.copy()))
    by_differences = [(a - b) / 2e-4 for a, b in zip(*ends, strict=True)]
    sizes = [np.abs(d[..., :3]).max() for d in by_differences]
    assert np.abs(online._noises._d_mean[k] - by_differences[0])[:3].max() < tolerance * sizes[0]
    assert np.abs(online._noises._d_covariance[k] - by_differences[1])[:3, :3].max() < tolerance * sizes[1]


def test_the_noises_are_learnt_and_their_errors_hold(jam):
    """22 drivers at the paper's mean, who are taken for noisier ones at first."""
    truth = defaults()[[SIGMA_NU, SIGMA_A]]
    z = []
    for driver in range(22):
        online = OnlineFilter(DT, jam.road, learning=replace(Learning(), relaxation_s=1e9))
        assert population()[SIGMA_A] > 2.0 * truth[1]
        follow(jam, driver, online)
        error = np.log(online.parameters[[SIGMA_NU, SIGMA_A]] / truth)
        std = np.sqrt(np.diag(online.parameter_covariance))[[SIGMA_NU, SIGMA_A]]
        z.append(error / (std / online.parameters[[SIGMA_NU, SIGMA_A]]))
    # the sum of squares of 22 standard normal variables is below 48 with a probability of 99.9 %, and above 6.4
    assert np.all(np.sum(np.square(z), axis=0) < 48.3)
    assert np.all(np.sum(np.square(z), axis=0) > 6.4)


def test_one_gross_error_does_not_become_the_noise(jam):
    wild = jam.position_m.copy()
    wild[200, 3] += 30.0
    ends = []
    for positions in (jam.position_m, wild):
        online = OnlineFilter(DT, jam.road)
        follow(replace(jam, position_m=positions), 3, online, 205)
        ends.append(online.parameters[SIGMA_NU])
    assert ends[1] == pytest.approx(ends[0], rel=0.25)
