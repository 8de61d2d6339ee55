"""Numbers from the first release candidate (commit b38b8b8), which later changes must not move.

The causal and online ones were renewed when LAST_SHOCK_STD went from 0.7 to 0.5 m/s².

Six drivers drive on a ring of 70 m for 40 s, with each effect: their last positions and speeds, and what the filters
say about one driver. The numbers repeat to the last bit on the same machine. Other processors round a few functions
differently, hence 1e-9.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros.driver.parameters import COUNT, KAPPA_V, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters import paper
from sugiyama_ros.filters.causal import log_likelihood
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

REFERENCE = json.loads((Path(__file__).parent / "reference.json").read_text())
LENGTH_M, DRIVER = 4.33, 2


def simulated(name):
    """The drivers' rows, and a simulation of them with an effect."""
    rng, rows = np.random.default_rng(3), ROW.with_effects(defaults(6))
    if name != "none":
        rows = switch_on(rows, name, REFERENCE[name]["values"])
    for k in (V_STAR, KAPPA_V):
        rows[:, k] *= np.exp(0.1 * rng.standard_normal(6))
    length = np.full(6, LENGTH_M)
    return rows, simulate(Simulator(rows, length, platoon(length, 2.0), Road(70.0), rng), 40.0)


@pytest.mark.parametrize("name", REFERENCE)
def test_numbers_have_not_moved(name):
    rows, simulation = simulated(name)
    t, expected = simulation.dense, REFERENCE[name]
    assert t.position_m[-1] == pytest.approx(expected["measured_m"], rel=1e-9)
    assert simulation.speed[-1] == pytest.approx(expected["speed"], rel=1e-9)
    chain = chain_behind(t, DRIVER)
    assert log_likelihood(chain, rows[DRIVER], rows[3:5]) == pytest.approx(expected["causal"], rel=1e-9)
    online = OnlineFilter(t.period_s, t.road, rows[DRIVER], rows[3])
    behind = int(np.flatnonzero(t.leader[0] == DRIVER)[0])
    for k, sample in enumerate(zip(chain.position_m, chain.identity, chain.length_m, strict=True)):
        estimate = online.step(*sample, k * t.period_s, (t.position_m[k, behind], behind, LENGTH_M))
    assert estimate.speed == pytest.approx(expected["online_speed"], rel=1e-9)
    assert estimate.mean_action == pytest.approx(expected["online_mean_action"], rel=1e-9, abs=1e-9)


def test_the_papers_likelihood_and_its_gradient_have_not_moved():
    rows, simulation = simulated("none")
    scored = paper.score(paper.perceive(simulation.dense, DRIVER), rows[DRIVER, :COUNT])
    assert scored.log_likelihood == pytest.approx(REFERENCE["none"]["paper"], rel=1e-9)
    assert scored.gradient == pytest.approx(REFERENCE["none"]["paper_gradient"], rel=1e-9)
