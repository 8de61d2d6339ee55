"""The compiled step of the online filter says what the step on filterpy says."""

from dataclasses import replace

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import defaults, population
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.chain import Adaptation
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.noise import Learning
from sugiyama_ros.filters.online import ADAPT, LEARN, NOBODY, OnlineFilter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, platoon, simulate

#: One effect of each stage, and one that remembers.
EFFECTS = {
    "second_leader": {"weight": 0.6},
    "slow_patch": {"reduction": 0.2, "centre": 50.0, "width": 60.0},
    "keeping_up": {"weight": 0.1, "range": 50.0},
    "actuation_lag": {"time_constant": 0.3},
    "sensor_eccentricity": {"cosine": 1.5, "sine": 1.0},
}


def recorded(rows, duration_s, ring_m, seed=0):
    cars = len(rows)
    length, road, rng = np.full(cars, 4.33), Road(ring_m), np.random.default_rng(seed)
    start = platoon(length, 2.0) if 0.0 < ring_m < 300.0 else evenly(length, Road(ring_m or 20.0 * cars))
    return simulate(Simulator(rows, length, start, road, rng), duration_s, stop_at_collision=False).dense


@pytest.fixture(scope="module")
def jam():
    """A jam with missing samples, alone and in a row, and with gross errors, alone and in a row."""
    t, rng = recorded(defaults(22), 80.0, 230.0), np.random.default_rng(1)
    position = t.position_m.copy()
    position[rng.random(position.shape) < 0.06] = np.nan
    position[100:115, 4] = np.nan
    wrong = rng.random(position.shape) < 0.02
    position[wrong] += rng.normal(0.0, 5.0, wrong.sum())
    position[150:156, 3] += 6.0
    position[170:176, 4] -= 6.0
    return replace(t, position_m=t.road.wrap(position))


def samples_of(t, driver, vehicles=3):
    """Arguments of ``OnlineFilter.step``, with the vehicle behind."""
    chain = chain_behind(t, driver, vehicles)
    leaders = t.leader
    for k, sample in enumerate(zip(chain.position_m, chain.identity, chain.length_m, strict=True)):
        follower = np.flatnonzero(leaders[k] == driver)
        behind = NOBODY
        if len(follower):
            i = int(follower[0])
            behind = (float(t.position_m[k, i]), i, float(t.length_m[i]))
        yield *sample, k * t.period_s, behind


def pair(t, *args, **options):
    return [OnlineFilter(t.period_s, t.road, *args, **options, engine=engine) for engine in ("compiled", "filterpy")]


def assert_close(ours, theirs, what="", absolute=1e-9):
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=absolute, err_msg=what)


def assert_equal(filters, samples):
    """Follow the samples with two filters; returns the changes of style."""
    compiled, readable = filters
    changes = []
    for k, sample in enumerate(samples):
        ours, theirs = compiled.step(*sample), readable.step(*sample)
        for name, a, b in zip(ours._fields, ours, theirs, strict=True):
            # close to contact the mean action turns by several m/s^2 within a millimetre, and rounding with it
            steep = name in ("acceleration", "mean_action", "covariance")
            assert_close(a, b, name, 1e-8 if steep else 1e-9)
        assert (compiled.change_of_style is None) == (readable.change_of_style is None)
        if compiled.change_of_style is not None:
            changes.append(compiled.change_of_style)
            assert changes[-1][0] == readable.change_of_style[0]
            assert_close(changes[-1][1], readable.change_of_style[1])
        if k % 10 == 0:
            assert_same_knowledge(*filters)
    assert_same_knowledge(*filters)
    return changes


def assert_same_knowledge(compiled, readable):
    assert_close(compiled.kalman.x, readable.kalman.x)
    assert_close(compiled.kalman.P, readable.kalman.P, "P", 1e-8)
    assert np.array_equal(compiled.kalman.P, compiled.kalman.P.T)
    assert_close(compiled.parameters, readable.parameters)
    assert_close(compiled.parameter_covariance, readable.parameter_covariance)
    assert compiled.learnt.names == readable.learnt.names
    assert_close(compiled.learnt.mean, readable.learnt.mean)
    assert_close(compiled.learnt.covariance, readable.learnt.covariance)
    assert compiled.identified == readable.identified


@pytest.mark.parametrize(
    ("adaptation", "learning"),
    [(ADAPT, LEARN), (Adaptation(), None), (ADAPT, Learning(relaxations_s=((900.0, 300.0),)))],
)
def test_missing_samples_and_gross_errors(jam, adaptation, learning):
    assert_equal(pair(jam, adaptation=adaptation, learning=learning), samples_of(jam, 3))


@pytest.mark.parametrize("vehicles", [1, 4])
def test_chains_of_other_lengths(jam, vehicles):
    assert_equal(pair(jam, vehicles=vehicles), samples_of(jam, 4, vehicles))


def test_an_open_road():
    t = recorded(defaults(5), 60.0, 0.0)
    for driver in (0, 4):
        assert_equal(pair(t), samples_of(t, driver))


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_each_stage(name):
    rows = switch_on(ROW.with_effects(defaults(6)), name, EFFECTS[name])
    t = recorded(rows, 40.0, 70.0, 3)
    position = t.position_m.copy()
    position[np.random.default_rng(2).random(position.shape) < 0.05] = np.nan
    assert_equal(pair(t, rows[2]), samples_of(replace(t, position_m=position), 2))


def test_changes_of_style():
    rows = switch_on(ROW.with_effects(defaults(22)), "preference_switch", {"v_star_change": np.log(0.8), "time": 60.0})
    t = recorded(rows, 100.0, 400.0, 3)
    changes = [change for driver in (0, 5, 9, 14) for change in assert_equal(pair(t), samples_of(t, driver))]
    assert len(changes) >= 2


def test_reset_recall_and_other_effects(jam):
    samples = list(samples_of(jam, 5))
    filters = pair(jam)
    assert_equal(filters, samples[:80])
    learnt = filters[0].learnt
    for one in filters:
        one.reset()
        one.recall(learnt)
    assert_same_knowledge(*filters)
    assert_equal(filters, samples[80:140])
    for one in filters:
        one.change(switch_on(ROW.with_effects(population()), "drag", {"c0": 0.2, "c2": 0.003}))
    assert_same_knowledge(*filters)
    assert_equal(filters, samples[140:200])


def test_samples_at_any_time(jam):
    """Times between samples from a tenth of a period to four periods; then the model changes, and regular samples."""
    filters, rng = pair(jam), np.random.default_rng(4)
    samples = list(samples_of(jam, 5))
    irregular = [(*sample, jam.period_s * 10.0 ** rng.uniform(-1.0, 0.6)) for sample in samples[:150]]
    assert_equal(filters, irregular)
    for one in filters:
        one.change(switch_on(ROW.with_effects(population()), "reaction_delay", {"delay": 0.1}))
    assert_equal(filters, irregular[:40])
    assert_equal(filters, samples[150:180])


def test_going_back_to_what_was_saved(jam):
    samples = list(samples_of(jam, 5))
    for one in pair(jam):
        for sample in samples[:60]:
            one.step(*sample)
        saved = one.saved()
        ahead = [one.step(*sample).speed for sample in samples[60:90]]
        one.restore(saved)
        assert [one.step(*sample).speed for sample in samples[60:90]] == ahead
