"""Effects that only some drivers have: who has them, and what is fitted to whom."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sugiyama_ros.diagnosis.candidates import OF_SOME, candidates
from sugiyama_ros.diagnosis.chance import chance_of
from sugiyama_ros.diagnosis.refine import refined
from sugiyama_ros.diagnosis.score import directions, scores
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.fit.joint import fit_base
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.standard_errors import own_stds, shared_stds
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, RING_M = 8, 88.0
SLOW = (1, 5)
PLACE = index_of("slow_patch", "reduction")


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


def fitted_to(slower, work):
    """Eight drivers, of whom some are slower on a patch, and the base model fitted to them."""
    rows = ROW.with_effects(defaults(CARS))
    slow = switch_on(rows, "slow_patch", {"reduction": 0.3, "centre": 44.0, "width": 30.0})
    rows = np.where(np.isin(np.arange(CARS), list(slower))[:, None], slow, rows)
    length = np.full(CARS, 4.33)
    run = simulate(Simulator(rows, length, platoon(length, 4.0), Road(RING_M), np.random.default_rng(1)), 200.0)
    assert not run.collisions
    data = prepare(run.measured)
    return data, fit_base(data, (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V), work)


@pytest.fixture(scope="module")
def fitted(work):
    return fitted_to(SLOW, work)


@pytest.fixture(scope="module")
def scored(fitted, work):
    """Scores of the patch, the largest gain first."""
    patch = [c for c in candidates(fitted[0]) if c.name == "slow_patch"]
    return sorted(scores(*fitted, list(directions(*fitted, patch, work)), work), key=lambda one: -one.gain)


@pytest.fixture(scope="module")
def grown(fitted, scored, work):
    return refined(*fitted, scored[0].candidate, scored[:1], work)


def test_the_drivers_who_have_an_effect_are_found(scored):
    best = scored[0]
    assert best.candidate.name == "slow_patch" + OF_SOME
    assert best.candidate.drivers == SLOW
    everybody = max(one.gain for one in scored if not one.candidate.drivers)
    assert best.gain > everybody + 2.0
    assert chance_of(scored, [], 0).p_values["slow_patch"] < 0.01


def test_only_these_drivers_get_the_effect(fitted, grown):
    _, base = fitted
    strength = grown.model.rows[:, PLACE]
    assert np.flatnonzero(strength).tolist() == list(SLOW)
    assert strength[list(SLOW)] == pytest.approx([0.3, 0.3], abs=0.12)
    assert grown.log_likelihood > base.log_likelihood + 20.0
    assert grown.model.has[:, list(grown.model.shared).index(PLACE)].tolist() == [i in SLOW for i in range(CARS)]


def test_standard_errors_hold(fitted, grown, work):
    data, _ = fitted
    stds = shared_stds(data, grown, work)
    assert set(stds) == {f"slow_patch.{name}" for name in ("reduction", "centre", "width")}
    information = sum(np.diag(s.information.sum(axis=0))[-3:] for s in grown.slopes)
    # no smaller than what the information says of each parameter alone; the reduction is no logarithm
    assert stds["slow_patch.reduction"] > 1.0 / np.sqrt(information[0])
    assert stds["slow_patch.width"] < 20.0
    assert len(own_stds(grown)) == CARS
    assert shared_stds(data, fitted[1], work) == {}
