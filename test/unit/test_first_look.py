"""The online filter on smooth positions: it starts anew with other noises, and its alarm allows for a wrong model."""

import numpy as np
import pytest

import sugiyama_ros as sg
from sugiyama_ros.driver.parameters import SIGMA_NU
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.filters.alarm import check_style, excess_of, observe, onsets_for, predict_alarm
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.filters.online_step import Sizes, memory_for, online_arrays
from sugiyama_ros.filters.state import State
from sugiyama_ros.road import Road

SMOOTH = {"sigma_nu": 0.004, "sigma_x": 0.0005, "sigma_v": 0.005}
PERIOD_S = 0.1


@pytest.fixture(scope="module")
def smooth():
    return sg.simulate(vehicles=6, ring_m=68.0, duration_s=90.0, period_s=PERIOD_S, seed=3, parameters=SMOOTH).dense


def steps_of(t, driver, vehicles=3):
    chain = chain_behind(t, driver, vehicles)
    return list(zip(chain.position_m, chain.identity, chain.length_m, strict=True))


def filter_of(t, row=None, **options):
    return OnlineFilter(PERIOD_S, t.road, row, **options)


def test_the_filter_knows_its_errors_on_smooth_positions(smooth):
    mean, learnt, alarms = [], [], 0
    for driver in range(6):
        online = filter_of(smooth)
        estimates = [(online.step(*s), online.change_of_style) for s in steps_of(smooth, driver)]
        alarms += sum(change is not None for _, change in estimates)
        mean.append(np.mean([one.nis for one, _ in estimates[300:]]))
        learnt.append(online.parameters[SIGMA_NU])
        assert online.is_smooth
    # 600 samples know the mean NIS to 0.06; with the noises of a camera it is below 0.2
    assert mean == pytest.approx([1.0] * 6, abs=0.24)
    # what is left of the position noise counts as measurement noise
    assert learnt == pytest.approx([0.004] * 6, rel=0.3)
    assert alarms <= 1


def test_a_camera_is_followed_as_before():
    camera = sg.simulate(vehicles=4, ring_m=45.0, duration_s=60.0, seed=1).dense
    looking, blind = OnlineFilter(camera.period_s, camera.road), OnlineFilter(camera.period_s, camera.road)
    blind._look = None
    for s in steps_of(camera, 1):
        assert looking.step(*s).speed == blind.step(*s).speed
    assert not looking.is_smooth


def test_both_engines_start_anew_alike(smooth):
    compiled, readable = filter_of(smooth), filter_of(smooth, engine="filterpy")
    for s in steps_of(smooth, 2)[:60]:
        one, other = compiled.step(*s), readable.step(*s)
    assert compiled.is_smooth
    assert readable.is_smooth
    assert one.speed == pytest.approx(other.speed, abs=1e-7)
    assert one.innovation_var == pytest.approx(other.innovation_var, rel=1e-6)


def test_the_filter_goes_back_to_before_it_started_anew(smooth):
    online = filter_of(smooth)
    steps = steps_of(smooth, 4)
    for s in steps[:20]:
        online.step(*s)
    saved = online.saved()
    first = [online.step(*s).speed for s in steps[20:60]]
    assert online.is_smooth
    online.restore(saved)
    assert not online.is_smooth
    assert [online.step(*s).speed for s in steps[20:60]] == first


def test_a_vehicle_that_stands_says_nothing():
    online = OnlineFilter(PERIOD_S, Road())
    for _ in range(200):
        online.step([5.0, 20.0, 40.0], [0, 1, 2], [4.0, 4.0, 4.0])
    assert not online.is_smooth
    assert len(online._look.samples) < 100


def alarms_of(innovations):
    """Number of alarms, and the variance of sums of innovations in the end; the jumps' signature fades slowly."""
    arrays = online_arrays(memory_for(Sizes(3, 2, 0, 2 * onsets_for(PERIOD_S)[1], ROW.width)))
    alarm, out, given = arrays.alarm, arrays.step.out, 0
    alarm.begin(PERIOD_S)
    out.columns[:], out.counts[:], out.jacobian[:] = np.arange(14), 14, np.eye(14)
    jacobian = out.jacobian
    jacobian[0, :2], jacobian[0, 12], jacobian[1, 1], jacobian[1, 13] = (0.9, 0.1), 0.1, 0.9, 0.05
    for y in innovations:
        predict_alarm(alarm, out, 12, 1.0)
        observe(alarm, y, 1.0)
        given += check_style(alarm, State(np.zeros(14), np.zeros((14, 14)), np.zeros(3, np.int64)), 12)[0] >= 0.0
    return given, excess_of(alarm.colour)


def test_innovations_that_follow_one_another_are_no_change_of_style():
    """An alarm in two hours is promised. Without the allowance there are 20 in these five minutes."""
    white = np.random.default_rng(1).standard_normal(3000)
    coloured = np.zeros(3000)
    for k in range(1, 3000):
        coloured[k] = 0.9 * coloured[k - 1] + np.sqrt(1.0 - 0.81) * white[k]
    given, excess = alarms_of(white)
    assert given == 0
    assert excess < 1.5
    given, excess = alarms_of(coloured)
    assert given <= 1
    # the variance of a sum over 40 samples is 15 times that of white innovations; 23 blocks know it to 30 %
    assert 6.0 < excess < 24.0
