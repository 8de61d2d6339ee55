"""Best responses of drivers who merge: equilibria, cycles, the degenerate case, the study, and the effect."""

import doctest
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import REFERENCE_HORIZON, REFERENCE_PERIOD_S, defaults
from sugiyama_ros.driver.utility import ACTIONS, collision_penalty, gap_scale, mean_action, preferences
from sugiyama_ros.effects.effect import Seen
from sugiyama_ros.effects.registry import effect
from sugiyama_ros.errors import InputError
from sugiyama_ros.simulation import best_response as module
from sugiyama_ros.simulation.best_response import (
    TOLERANCE,
    Merge,
    best_response,
    chosen,
    distinct,
    equilibria,
    keep_speed,
    respond,
)
from sugiyama_ros.studies.beta_nash import STUDY, pass_merge, random_merge
from sugiyama_ros.studies.study import Asked

LENGTH_M = 4.33


def merge(place, speed, lane):
    count = len(place)
    return Merge(np.array(place), np.array(speed), np.full(count, LENGTH_M), np.array(lane), defaults(count))


def responses(state, actions):
    return respond(state, actions, ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON)


def test_the_example_runs():
    found = doctest.testmod(module)
    assert found.attempted > 0
    assert found.failed == 0


def test_an_equilibrium_is_the_best_response_to_itself():
    rng = np.random.default_rng(3)
    states = [random_merge(drivers, rng) for drivers in (2, 4) for _ in range(50)]
    found = [chosen(equilibria(state)) for state in states]
    off = [
        np.max(np.abs(responses(state, one.actions) - one.actions)) for state, one in zip(states, found, strict=True)
    ]
    assert off == pytest.approx([one.residual for one in found], abs=1e-12)
    assert np.mean(np.array(off) <= TOLERANCE) > 0.95


def test_on_one_lane_there_is_nothing_to_bargain():
    """Each depends on the vehicles ahead alone: as many rounds as drivers give the one equilibrium, from any start."""
    state = merge([0.0, -9.0, -20.0, -27.0], [6.0, 7.0, 8.0, 6.0], [0, 0, 0, 0])
    exact = np.zeros(4)
    for _ in range(4):
        exact = responses(state, exact)
    assert np.array_equal(responses(state, exact), exact)
    found = equilibria(state)
    assert distinct(found) == 1
    for one in found:
        assert one.actions == pytest.approx(exact, abs=5 * TOLERANCE)
    assert best_response(state, beta=1.0, rounds=4).actions == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize(("gap", "leader_speed"), [(6.0, 8.0), (9.0, 7.0), (30.0, 6.0)])
def test_who_assumes_that_others_keep_their_speed_drives_by_the_papers_mean_action(gap, leader_speed):
    state = merge([gap + LENGTH_M, 0.0], [leader_speed, 8.5], [0, 0])
    paper = mean_action(gap, 8.5, leader_speed, defaults(), ACTIONS, REFERENCE_PERIOD_S, REFERENCE_HORIZON)
    assert keep_speed(state)[1] == pytest.approx(paper, abs=1e-9)


def test_drivers_abreast_have_two_equilibria_and_the_roles_are_exchanged():
    state = merge([-15.0, -15.0], [7.0, 7.0], [0, 1])
    found = [one for one in equilibria(state) if one.residual <= TOLERANCE]
    assert distinct(found) == 2
    first, second = (next(one.actions for one in found if (one.actions[0] > one.actions[1]) == open) for open in (1, 0))
    assert first == pytest.approx(second[::-1], abs=5 * TOLERANCE)
    # alike in all respects and from rest, both do the same in each round, and come back to what they did
    together = best_response(state)
    assert together.is_cycle
    assert together.actions[0] == pytest.approx(together.actions[1], abs=1e-12)
    assert together.residual > TOLERANCE
    assert distinct([together]) == 0


def test_who_is_ahead_goes_first_and_bargaining_agrees():
    state = merge([-20.0, -30.0], [8.0, 8.0], [1, 0])
    seek, nash = pass_merge(state, keep_speed), pass_merge(state, lambda one: chosen(equilibria(one)).actions)
    assert seek.order == nash.order == (1, 0)
    for passing in (seek, nash):
        assert passing.has_passed
        assert not passing.is_contact


def test_a_share_of_0_is_refused():
    with pytest.raises(InputError, match="beta = 0 is out of bounds; give more than 0, and at most 1"):
        best_response(merge([0.0], [5.0], [0]), beta=0.0)


def test_the_study_repeats_and_finds_equilibria_in_nearly_all_states():
    with ThreadPoolExecutor() as work:
        rows, again = (STUDY.answer(Asked(None, 1, 5, work)).rows for _ in range(2))
    assert rows == again
    for row in rows:
        # 99.5 % and more of 2,000 states (docs/beta_nash.md): five of 100 without one have a chance below 1e-4
        assert row["equilibrium from any start"] >= 0.95
        assert row["stuck"] == 0


def test_the_effect_takes_the_risk_behind_the_accelerating_leader():
    """The leader is at x + v tau + weight a tau (tau - 1) / 2, and stops rather than drive backward."""
    driver, p = preferences(defaults()), np.array([0.8])
    _, kappa_v, _, kappa_c, kappa_d, omega_2, _ = driver
    component = effect("anticipated_leader").function

    def risk(seen, action, expected):
        ratios = []
        for tau in range(1, REFERENCE_HORIZON + 1):
            t = tau * REFERENCE_PERIOD_S
            way = REFERENCE_PERIOD_S**2 * tau * (tau - 1) / 2.0
            gap = seen.gap + t * (seen.leader_speed - seen.speed) + way * (expected - action)
            scale = gap_scale(seen.speed + t * action, seen.leader_speed + t * expected, kappa_c, kappa_v, kappa_d)
            ratios.append(gap / scale)
        return collision_penalty(min(ratios))

    nothing = Seen(**dict.fromkeys(Seen._fields, 0.0))
    for leader_acceleration, leader_speed, expected in ((-2.0, 6.0, -1.6), (1.0, 6.0, 0.8), (-2.0, 0.4, -0.3)):
        seen = nothing._replace(gap=5.0, speed=6.0, leader_speed=leader_speed, leader_acceleration=leader_acceleration)
        for action in (-3.0, 0.0, 2.0):
            value = component(seen, action, REFERENCE_PERIOD_S, REFERENCE_HORIZON, p, driver)
            assert value == pytest.approx(omega_2 * (risk(seen, action, expected) - risk(seen, action, 0.0)), abs=1e-12)
    free = nothing._replace(gap=np.inf, speed=6.0, leader_acceleration=1.0)
    assert component(free, 1.0, REFERENCE_PERIOD_S, REFERENCE_HORIZON, p, driver) == 0.0
