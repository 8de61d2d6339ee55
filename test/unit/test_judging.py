"""The judgement of a search: simulations are added where they alone speak against the model."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from sugiyama_ros.diagnosis import discover as discovering
from sugiyama_ros.diagnosis import judging
from sugiyama_ros.diagnosis.diagnosis import diagnose
from sugiyama_ros.diagnosis.discover import Discovery, against_simulations
from sugiyama_ros.diagnosis.screen import FULL, QUICK
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model import Model
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, simulate

CARS, RING_M = 6, 63.0


@pytest.fixture(scope="module")
def own():
    length, road = np.full(CARS, 4.33), Road(RING_M)
    rows, rng = ROW.with_effects(defaults(CARS)), np.random.default_rng(3)
    simulator = Simulator(rows, length, evenly(length, road), road, rng, speed=np.full(CARS, 4.0))
    return diagnose(simulate(simulator, 60.0).measured, quick=True, workers=2, verdict_only=True)


def with_biases(located, bias):
    return replace(located, bins=tuple(replace(b, bias=bias, flagged=bias > 0.2) for b in located.bins))


class SearchEnd:
    """A search at its end, whose simulations are numbers."""

    quick, named, refused, senseless = True, (), (), {}
    current = JointFit(Model(np.zeros((CARS, ROW.width)), (), (), (), np.zeros((CARS, ROW.width))), None, ())

    def __init__(self, d):
        self.data, self.before, self.errors = d.data, d.before, d.after
        self.asked = []

    def simulations(self, runs=0):
        self.asked.append(runs)
        return [(k, self.current) for k in range(max(runs, QUICK.runs))]


def judged(monkeypatch, own, biases_of_simulations, left=(), laws=()):
    """The judgement of a model that is biased by 0.3, and whose simulations are biased as told."""

    def located_in(simulations, work):
        return tuple(with_biases(own.where_after, biases_of_simulations[k]) for k, _ in simulations)

    monkeypatch.setattr(judging, "simulated_failures", located_in)
    monkeypatch.setattr(judging, "held_out_errors", lambda *arguments, **options: own.after)
    monkeypatch.setattr(judging, "shared_stds", lambda *arguments: {})
    search = SearchEnd(own)

    def forces_left(data, current, simulations, level, work):
        return [force for force in left if force.p_value < level]

    monkeypatch.setattr(judging, "forces_left", forces_left)
    found = judging.judged(search, with_biases(own.where_after, 0.3), dict(laws), None)
    return found, search.asked


def test_more_simulations_where_two_alone_speak_against_the_model(monkeypatch, own):
    found, asked = judged(monkeypatch, own, [0.05, 0.05, 0.3, 0.35, 0.25, 0.3])
    assert asked == [0, FULL.runs]
    assert found.adequacy.outcome == "adequate"
    assert len(found.evidence.simulated) == FULL.runs
    found, _ = judged(monkeypatch, own, [0.05] * FULL.runs)
    assert found.adequacy.outcome == "not_explained"


def test_no_further_simulations_for_an_adequate_model(monkeypatch, own):
    found, asked = judged(monkeypatch, own, [0.3, 0.3])
    assert (found.adequacy.outcome, asked) == ("adequate", [0])


def test_no_further_simulations_where_a_law_speaks_against_the_model(monkeypatch, own):
    better = own.after.samples.copy()
    better.log_likelihood[:] += 0.1
    force = Discovery("gap", 0.7, 1e-6, 40.0, (), ())
    monkeypatch.setattr(judging, "check_laws", lambda *arguments: {})
    laws = {"law": replace(own.after, samples=better)}
    found, asked = judged(monkeypatch, own, [0.05, 0.05], [force], laws)
    assert (found.adequacy.better_law, asked) == ("law", [0, 0])
    assert found.evidence.forces == [force]


def test_a_model_is_not_adequate_where_something_was_refused(monkeypatch, own):
    monkeypatch.setattr(SearchEnd, "refused", (("drag", ("free runs of 2 s into the last part end further off",)),))
    found, _ = judged(monkeypatch, own, [0.3, 0.3])
    assert found.adequacy.outcome == "not_explained"
    assert found.adequacy.reasons == ("what predicts better makes worse what the model is for: drag",)


def test_a_force_speaks_against_a_model_to_which_nothing_was_added(monkeypatch, own):
    monkeypatch.setattr(judging, "check_laws", lambda *arguments: {})
    laws = {"law": own.after}
    surely, perhaps = (Discovery("rear_approach_rate", 0.7, p, 40.0, (), ()) for p in (1e-6, 0.01))
    found, _ = judged(monkeypatch, own, [0.3, 0.3], [surely], laws)
    assert found.adequacy.outcome == "not_explained"
    assert "rear_approach_rate" in found.adequacy.reasons[0]
    found, _ = judged(monkeypatch, own, [0.3, 0.3], [perhaps], laws)
    assert found.adequacy.outcome == "adequate"
    far_apart = replace(own, data=replace(own.data, every=3))
    found, asked = judged(monkeypatch, far_apart, [0.3] * FULL.runs, [surely], laws)
    assert (found.adequacy.outcome, asked) == ("adequate", [FULL.runs])


def test_a_force_counts_by_what_it_gains_beyond_simulations(monkeypatch):
    force = Discovery("gap", 0.7, 1e-6, 40.0, (0.0,) * 8, (0.0,) * 8)

    def p_value(simulated):
        def discover(data, fitted, work, effort, only):
            assert only == ["gap"]
            yield replace(force, gain_nats=data), None

        monkeypatch.setattr(discovering, "discover", discover)
        ((found, _),) = against_simulations([(force, None)], [(gain, None) for gain in simulated], None, QUICK)
        return found.p_value

    by_chance, as_usual = p_value([2.0, 4.0]), p_value([7.0, 7.0])
    # a chi-squared variable of the seven free knots, over all covariates
    assert by_chance == as_usual == pytest.approx(1.0 - (1.0 - chi2.sf(40.0, 7)) ** len(COVARIATES), rel=1e-6)
    assert as_usual < p_value([15.0, 15.0]) < p_value([25.0, 30.0])
    assert p_value([25.0, 30.0]) < 0.99 < p_value([40.0, 45.0])
