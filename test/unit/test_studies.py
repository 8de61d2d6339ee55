"""Every study answers and draws its answer; the statistics that the studies use are right."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from matplotlib.figure import Figure

from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, defaults
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.studies import effects, filters, lanes, online, recovery
from sugiyama_ros.studies.driver_types import adjusted_rand, silhouette
from sugiyama_ros.studies.effects import DURATION_S, STRENGTHS, hide
from sugiyama_ros.studies.registry import STUDIES, study
from sugiyama_ros.studies.rings import CARS, RING_M, Ring, outcome
from sugiyama_ros.studies.study import Asked


@pytest.fixture(scope="module")
def jam():
    length, drivers = np.full(22, 4.33), defaults(22)
    drivers[:, KAPPA_V] *= np.exp(0.2 * np.random.default_rng(2).standard_normal(22))
    simulator = Simulator(drivers, length, platoon(length, 2.0), Road(230.0), np.random.default_rng(4))
    return simulate(simulator, 120.0).dense


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_answers(name, jam, tmp_path, monkeypatch):
    # longer runs would say more, but take too long here
    monkeypatch.setattr(recovery, "DURATION_S", 40.0)
    monkeypatch.setattr(lanes, "DURATION_S", 40.0)
    monkeypatch.setattr(lanes, "VEHICLES", 4)
    monkeypatch.setattr(online, "DURATION_S", 60.0)
    monkeypatch.setattr(filters, "DURATION_S", 20.0)
    monkeypatch.setattr(filters, "PARTICLES", 5)
    monkeypatch.setattr(effects, "STRENGTHS", {"drag": effects.STRENGTHS["drag"]})
    monkeypatch.setattr(effects, "DURATION_S", 60.0)
    with ThreadPoolExecutor(2) as work:
        answer = study(name).answer(Asked(jam, 1, 0, work))
    assert answer.rows
    assert any(isinstance(v, int | float) and np.isfinite(v) for row in answer.rows for v in row.values())
    figure = Figure()
    answer.draw(figure)
    figure.savefig(tmp_path / "figure.png")
    assert sum(len(axes.lines) + len(axes.collections) + len(axes.patches) for axes in figure.axes) > 0


def test_an_unknown_study_and_missing_data_are_one_clear_line():
    with pytest.raises(InputError, match="study 'weather': not known; choose among recovery"):
        study("weather")
    with ThreadPoolExecutor(1) as work, pytest.raises(InputError, match="needs measured drivers"):
        study("types").answer(Asked(None, 1, 0, work))


def test_a_jam_has_a_wave_and_free_flow_has_none():
    drivers = defaults(CARS)
    drivers[:, SIGMA_A] = 0.1
    jammed = outcome(Ring(drivers, 1, jammed=True))
    free = outcome(Ring(drivers, 1, ring_m=320.0))
    assert (jammed.wave, jammed.collided, free.wave, free.collided) == (True, False, False, False)
    assert jammed.road.wave_speed == pytest.approx(-6.5, abs=0.5)  # an independent implementation
    assert free.flow_per_h == pytest.approx(3600.0 * 22 / 320.0 * free.road.mean_speed)


def test_agreement_of_clusterings():
    a = np.array([1, 1, 1, 2, 2, 2])
    assert adjusted_rand(a, a) == pytest.approx(1.0)
    assert adjusted_rand(a, 3 - a) == pytest.approx(1.0)
    # Hubert and Arabie by hand: 2 pairs in common, 6 and 3 pairs in each, 15 in all
    assert adjusted_rand(a, np.array([1, 1, 2, 2, 3, 3])) == pytest.approx((2 - 1.2) / (4.5 - 1.2))
    points = np.array([[0.0], [0.1], [10.0], [10.1]])
    assert silhouette(points, np.array([1, 1, 2, 2])) == pytest.approx(0.99, abs=0.01)


@pytest.mark.parametrize(
    ("name", "parameter", "low", "high"),
    [("slow_patch", "centre", 0.0, RING_M), ("preference_switch", "time", 0.3 * DURATION_S, 0.7 * DURATION_S)],
)
def test_a_hidden_effect_acts_at_a_place_or_a_time_that_is_drawn(name, parameter, low, high):
    strong, weak = STRENGTHS[name]
    run, values = hide(name, strong, 3)
    again, _ = hide(name, strong, 3)
    weaker, _ = hide(name, weak, 3)
    assert not run.collisions
    assert values == {**strong, parameter: values[parameter]}
    assert low <= values[parameter] <= high
    np.testing.assert_array_equal(run.dense.position_m, again.dense.position_m)
    assert not np.array_equal(run.position_m, weaker.position_m)
