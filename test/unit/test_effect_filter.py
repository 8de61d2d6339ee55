"""Parameters of effects learnt online: they converge, their intervals hold, and what was learnt stays."""

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, active, index_of, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.effect_filter import EffectFilter
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

DRIVERS, DT = 22, 1.0 / 3.0
DRAG, C0 = index_of("drag", "c0"), 0.5


def recorded(rows, seed, seconds=150.0):
    """Measured positions of drivers in a jam."""
    length = np.full(DRIVERS, 4.33)
    simulator = Simulator(rows, length, platoon(length, 2.0), Road(230.0), np.random.default_rng(seed))
    return simulate(simulator, seconds).dense


@pytest.fixture(scope="module")
def dragged():
    return recorded(switch_on(ROW.with_effects(defaults(DRIVERS)), "drag", {"c0": C0}), 8)


def row_with(c0):
    return switch_on(ROW.with_effects(defaults()), "drag", {"c0": c0})


def samples_of(t, driver):
    chain = chain_behind(t, driver)
    rows = zip(chain.position_m, chain.identity, chain.length_m, strict=True)
    return [(*sample, k * DT) for k, sample in enumerate(rows)]


def follow(online, samples):
    return [online.step(*sample) for sample in samples]


def test_a_drag_is_learnt_and_its_interval_holds(dragged):
    """All drivers start from a fifth of it. Sums of squares of 22 standard normal variables: 6.4 to 48.3 in 99.9 %."""
    off, of_v_star = [], []
    for driver in range(DRIVERS):
        online = EffectFilter(DT, dragged.road, row_with(0.1), ["drag.c0"])
        follow(online, samples_of(dragged, driver))
        std = np.sqrt(np.diag(online.parameter_covariance))
        off.append((online.parameters[DRAG] - C0) / std[DRAG])
        of_v_star.append((online.parameters[V_STAR] - defaults()[V_STAR]) / std[V_STAR])
        assert "drag.c0" in online.adapted
    assert 6.4 < np.sum(np.square(off)) < 48.3
    assert np.sum(np.square(of_v_star)) < 48.3
    # the mean over the drivers has left the prior: it is nearer to the truth than to the start
    assert np.mean(off) * np.mean(std[DRAG]) > -0.2


def test_nothing_changes_before_the_first_second_is_over(dragged):
    samples = samples_of(dragged, 3)[:3]
    plain, learning = (
        OnlineFilter(DT, dragged.road, row_with(0.1)),
        EffectFilter(DT, dragged.road, row_with(0.1), ["effects"]),
    )
    for a, b in zip(follow(plain, samples), follow(learning, samples), strict=True):
        assert (a.position_m, a.speed) == (b.position_m, b.speed)
    assert learning.adapted == (*plain.adapted, "drag.c0", "drag.c2")


def test_what_was_saved_goes_on_as_if_nothing_had_been(dragged):
    samples = samples_of(dragged, 3)
    online = EffectFilter(DT, dragged.road, row_with(0.1), ["effects"])
    follow(online, samples[:200])
    saved = online.saved()
    ends = []
    for _ in range(2):
        follow(online, samples[200:230])
        ends.append((online.parameters, online.parameter_covariance))
        online.restore(saved)
    assert np.array_equal(ends[0][0], ends[1][0])
    assert np.array_equal(ends[0][1], ends[1][1])


def test_what_was_learnt_is_recalled_and_survives_other_effects(dragged):
    online = EffectFilter(DT, dragged.road, row_with(0.1), ["effects"])
    follow(online, samples_of(dragged, 3)[:300])
    learnt, covariance = online.learnt, online.parameter_covariance
    again = EffectFilter(DT, dragged.road, row_with(0.1), ["effects"])
    again.recall(learnt)
    assert again.learnt.mean == pytest.approx(learnt.mean, abs=1e-12)
    assert again.learnt.covariance == pytest.approx(learnt.covariance, abs=1e-12)
    online.restart()
    assert online.parameter_covariance == pytest.approx(covariance, abs=1e-9)

    known = online.parameters[DRAG]
    assert known != 0.1
    more = switch_on(row_with(0.1), "speed_dependent_noise", {"exponent": 0.2})
    online.change(more)
    assert online.parameters[DRAG] == known
    assert set(online.adapted[-3:]) == {"speed_dependent_noise.exponent", "drag.c0", "drag.c2"}
    online.change(row_with(0.3))
    assert online.parameters[DRAG] == 0.3
    online.change(ROW.with_effects(defaults()))
    assert not active(online.parameters)
    assert online.adapted == OnlineFilter(DT, dragged.road).adapted


def test_a_name_that_is_no_parameter_of_an_effect_is_refused():
    with pytest.raises(InputError, match="cannot be learnt online"):
        EffectFilter(DT, Road(230.0), names=["drag.weight"])
