"""What the online filter learns about a driver while they drive."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import SIGMA_A, SIGMA_NU, V_STAR, defaults, population
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.chain import Adaptation
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.noise import Learning
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, platoon, simulate

DT = 1.0 / 3.0


@pytest.fixture(scope="module")
def jam():
    length = np.full(22, 4.33)
    start = platoon(length, 2.0)
    return simulate(Simulator(defaults(22), length, start, Road(230.0), np.random.default_rng(0)), 150.0).dense


def follow(t, driver, online, samples=None):
    """Estimates of a driver, sample by sample."""
    chain = chain_behind(t, driver, online.vehicles)
    steps = zip(chain.position_m[:samples], chain.identity, chain.length_m, strict=False)
    return [online.step(*s) for s in steps]


@pytest.mark.parametrize(("place", "k", "vehicles", "tolerance"), [(SIGMA_NU, 0, 1, 1e-6), (SIGMA_A, 1, 3, 0.3)])
def test_sensitivities_to_the_noises_equal_difference_quotients(jam, place, k, vehicles, tolerance):
    """Exact where the model is linear; within a third for a chain, because its F depends on the covariance too.

    Root mean squares over samples count, because a sensitivity passes through zero.
    """
    fixed = Learning((1e-9, 1e-9))
    off, size = np.zeros(2), np.zeros(2)
    for samples in range(40, 121, 8):
        online = OnlineFilter(DT, jam.road, defaults(), adaptation=Adaptation(), learning=fixed, vehicles=vehicles)
        follow(jam, 3, online, samples)
        ends = []
        for side in (1.0, -1.0):
            row = defaults()
            row[place] *= np.exp(side * 1e-4)
            other = OnlineFilter(DT, jam.road, row, adaptation=Adaptation(), learning=None, vehicles=vehicles)
            follow(jam, 3, other, samples)
            ends.append((other.kalman.x[:3].copy(), other.kalman.P[:3, :3].copy()))
        found = online.kalman.noises.d_mean[k][:3], online.kalman.noises.d_covariance[k][:3, :3]
        by_differences = [(a - b) / 2e-4 for a, b in zip(*ends, strict=True)]
        off += [np.abs(a - b).max() ** 2 for a, b in zip(found, by_differences, strict=True)]
        size += [np.abs(b).max() ** 2 for b in by_differences]
    assert np.all(np.sqrt(off) < tolerance * np.sqrt(size))


def test_the_noises_are_learnt_and_their_errors_hold(jam):
    """22 drivers with the paper's mean parameters. The filter starts with noises that are too large."""
    truth = defaults()[[SIGMA_NU, SIGMA_A]]
    z = []
    for driver in range(22):
        online = OnlineFilter(DT, jam.road, learning=replace(Learning(), relaxations_s=((math.inf, math.inf),)))
        assert population()[SIGMA_A] > 2.0 * truth[1]
        follow(jam, driver, online)
        error = np.log(online.parameters[[SIGMA_NU, SIGMA_A]] / truth)
        std = np.sqrt(np.diag(online.parameter_covariance))[[SIGMA_NU, SIGMA_A]]
        z.append(error / (std / online.parameters[[SIGMA_NU, SIGMA_A]]))
    # the sum of squares of 22 standard normal variables is below 48 with a probability of 99.9 %, and above 6.4
    assert np.all(np.sum(np.square(z), axis=0) < 48.3)
    assert np.all(np.sum(np.square(z), axis=0) > 6.4)


def test_a_vehicle_whose_place_jumps_is_found_again(jam):
    """Four gross errors in a row are no errors: with the next sample the filter knows place and speed again."""
    moved = jam.position_m.copy()
    moved[200:, 3] -= 6.0
    ends = []
    for positions in (jam.position_m, moved):
        online = OnlineFilter(DT, jam.road)
        ends.append(follow(replace(jam, position_m=positions), 3, online, 205)[-1])
    usual, found = ends
    assert (
        abs(found.position_m - (usual.position_m - 6.0) % jam.road.circumference_m)
        < 4.0 * usual.covariance[0, 0] ** 0.5
    )
    assert abs(found.speed - usual.speed) < 4.0 * usual.covariance[1, 1] ** 0.5


def changing(factor, ring_m, seed):
    """A recording of 200 s in which every third driver's desired speed changes at 100 s; and these drivers."""
    rows = ROW.with_effects(defaults(22))
    who = np.arange(22) % 3 == 0
    switched = switch_on(rows, "preference_switch", {"v_star_change": np.log(factor), "time": 100.0})
    rows[who] = switched[who]
    length, road = np.full(22, 4.33), Road(ring_m)
    simulator = Simulator(rows, length, evenly(length, road), road, np.random.default_rng(seed))
    return simulate(simulator, 200.0).dense, np.flatnonzero(who)


def changes(t, driver):
    """Reported changes of style: time [s], name and factor; and the filter at the end."""
    online, found = OnlineFilter(DT, t.road), []
    chain = chain_behind(t, driver)
    for k, sample in enumerate(zip(chain.position_m, chain.identity, chain.length_m, strict=True)):
        online.step(*sample)
        if online.change_of_style is not None:
            found.append((k * DT, *online.change_of_style))
    return found, online


def test_a_fall_of_the_desired_speed_is_noticed_and_followed():
    """Drivers on a nearly free road: with this seed 8 of 8 are noticed within 10 s, with other seeds 67 of 68."""
    t, who = changing(0.85, 400.0, 3)
    assert len(who) == 8
    soon = 0
    for driver in who:
        found, online = changes(t, driver)
        after = [c for c in found if 100.0 <= c[0] <= 125.0]
        if after:
            soon += 1
            _, name, factor = after[0]
            assert name == "v_star"
            assert 0.7 < factor < 0.95
            # within 100 s the desired speed is known again
            assert online.parameters[V_STAR] == pytest.approx(0.85 * defaults()[V_STAR], rel=0.05)
    assert soon >= 7
