"""Whole diagnoses and comparisons of small simulated rings whose truth is known."""

import json

import numpy as np
import pytest
import yaml
from scipy.stats import t as student

from sugiyama_ros.diagnosis.check import as_simulated
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.laws.registry import number_of
from sugiyama_ros.page import tables
from sugiyama_ros.page.document import additions, document
from sugiyama_ros.results import plain
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, evenly, platoon, simulate

CARS, RING_M, LENGTH_M = 7, 77.0, 4.33


def recording(effect: str = "", duration_s: float = 150.0, **values: float):
    """Drivers who differ by 10 %, with an effect."""
    rng = np.random.default_rng(1)
    rows = ROW.with_effects(defaults(CARS))
    for k in (V_STAR, KAPPA_V):
        rows[:, k] *= np.exp(0.1 * rng.standard_normal(CARS))
    rows = switch_on(rows, effect, values) if effect else rows
    length = np.full(CARS, LENGTH_M)
    run = simulate(Simulator(rows, length, platoon(length, 4.0), Road(RING_M), rng), duration_s)
    assert not run.collisions
    return run


@pytest.fixture(scope="module")
def hidden():
    run = recording("slow_patch", 250.0, reduction=0.2, centre=20.0, width=25.0)
    return run, diagnose(run.measured, most=1, workers=2, seed=3)


@pytest.fixture(scope="module")
def nothing():
    run = recording()
    return run, diagnose(run.measured, workers=2, seed=3)


def test_a_hidden_effect_is_added_and_makes_forecasts_better(hidden):
    _, d = hidden
    (one,) = additions(d)
    assert (one.name, one.kind, one.is_supported) == ("slow_patch", "effect", True)
    assert one.p_value < 0.01
    assert one.parameters["reduction"] == pytest.approx(0.2, abs=5.0 * one.parameters_std["reduction"])
    assert one.parameters["centre"] == pytest.approx(20.0, abs=5.0 * one.parameters_std["centre"])
    assert one.heldout_gain_nats > one.heldout_gain_se
    assert {"one_step", "1s", "2s", "5s", "10s", "road_10s", "all"} <= set(one.gains)
    assert d.final.over(d.data, d.base)["all"].nats == pytest.approx(one.heldout_gain_nats)
    # the table shows every column whose sum the gain is
    summed = {name.replace("_", "") for name in one.gains if name != "all" and not name.startswith("road")}
    assert {name.replace(" ", "") for name in tables.steps(plain(document(d))).headings[2:-3]} == summed
    assert d.outcome == ("not_explained" if any(check.failed for check in d.checks) else "explained")


def test_the_model_fails_where_the_slow_patch_is(hidden):
    _, d = hidden
    places = [b for b in d.where_before.bins if b.covariate == "place"]
    assert len(places) == 10
    nearest = min(places, key=lambda b: abs(0.5 * (b.low + b.high) - 20.0))
    assert nearest.bias < 0.0
    before, after = (
        [b for b in located.flagged if b.covariate == "place"] for located in (d.where_before, d.where_after)
    )
    assert len(after) < len(before)
    assert [(m.first, m.second) for m in d.where_before.maps] == [("speed", "gap"), ("place", "time")]


def test_the_document_is_plain_and_has_what_a_page_needs(hidden):
    run, d = hidden
    found = plain(document(d))
    json.dumps(found, allow_nan=False)
    assert found["verdict"]["outcome"] == d.outcome
    for errors in (found["errors"][name] for name in ("before", "after", "floor")):
        assert {f"free_run_{h}s_m" for h in (1, 2, 5, 10)} | {"one_step_rmse_m", "single_car_10s_crps_m"} < set(errors)
    fall = found["verdict"]["fall"]
    told = found["errors"]["before"]["free_run_10s_m"] - found["errors"]["after"]["free_run_10s_m"]
    assert fall["physics_m"] + fall["other_m"] == pytest.approx(told)
    assert found["candidates"][0]["name"] == "slow_patch"
    assert {c["name"] for c in found["candidates"]} >= {"actuation_lag", "noise_constants", "discovered_force"}
    assert [c["p_value"] for c in found["checks"]] == sorted(c["p_value"] for c in found["checks"])
    shown = found["free_run"]
    assert len(shown["time_s"]) == len(shown["block"]) == len(shown["before"]) == len(shown["after"])
    assert all(len(row) == CARS for row in shown["after"])
    assert found["about"]["slow_patch"]["parameters"]["centre"]["axis"] == "place"
    for driver, row in zip(found["drivers"], run.parameters, strict=True):
        # five standard deviations
        assert abs(driver["v_star"] - row[V_STAR]) < 5.0 * max(driver["v_star_std"], 0.05)
    for one in found["where"]["before"]["maps"]:
        assert np.shape(one["flagged"]) == np.shape(one["bias"])


def test_nothing_is_added_where_nothing_is_hidden(nothing):
    _, d = nothing
    assert additions(d) == []
    assert (d.outcome, len(d.rounds)) == ("adequate", 1)
    assert d.final is d.base
    # a strong effect would have shown
    assert {"drag", "slow_patch"} & {one["name"] for one in d.smallest}


def test_what_is_asked_for_is_added_whatever_the_data_say(nothing):
    run, _ = nothing
    d = diagnose(run.measured, add=("second_leader", "discovered_force:speed"), workers=2, seed=3)
    asked = additions(d)
    assert [one.name for one in asked] == ["second_leader", "discovered_force"]
    assert not any(one.is_supported for one in asked)
    assert asked[1].covariate == "speed"
    assert d.asked == ("second_leader", "discovered_force:speed")
    with pytest.raises(InputError, match="magic"):
        diagnose(run.measured, add=("magic",), workers=2)


def test_no_model_forecasts_clearly_worse_than_the_model_inside_it(hidden, nothing):
    """Where one does, its fit or its forecast has failed."""
    for _, d in (hidden, nothing):
        for one in d.rounds:
            assert not [e.name for e, won in one.gains.items() if won["all"].is_loss(len(one.gains))]


def test_the_same_seed_gives_the_same_verdict(hidden):
    run, d = hidden
    again = diagnose(run.measured, most=1, workers=1, seed=3)
    assert additions(again) == additions(d)
    assert again.checks == d.checks


def test_drivers_of_another_law_are_not_explained():
    rng, rows, places = np.random.default_rng(3), ROW.with_effects(defaults(8)), ROW.law_places["fvdm"]
    rows[:, ROW.law] = number_of("fvdm")
    rows[:, places] = [ROW.declared[k].default for k in range(places.start, places.stop)]
    length, road = np.full(8, LENGTH_M), Road(84.0)
    run = simulate(Simulator(rows, length, evenly(length, road), road, rng, speed=np.full(8, 4.0)), 150.0)
    d = diagnose(run.measured, most=1, simulations=1, workers=2)
    assert d.outcome == "not_explained"
    assert "gain_of_fvdm" in {one.name for one in d.checks if one.failed}
    ahead = {one.name: one.over(d.data, d.final)["all"].nats for one in d.laws}
    assert max(ahead, key=lambda name: ahead[name]) == "fvdm"


def test_a_model_file_gives_the_model_back(hidden, tmp_path):
    run, d = hidden
    path = tmp_path / "model.yaml"
    d.save(path)
    read = read_model(path)
    assert read.effects == ("slow_patch",)
    rows, patch = (
        d.final.fit.model.rows.copy(),
        [index_of("slow_patch", name) for name in ("reduction", "centre", "width")],
    )
    # who does not have the patch needs no place for it
    rows[np.ix_(rows[:, patch[0]] == 0.0, patch)] = 0.0
    assert read.rows_of(run.dense.vehicle) == pytest.approx(rows)
    assert yaml.safe_load(path.read_text())["shared_std"]["slow_patch.reduction"] > 0.0


def test_a_check_knows_how_well_simulations_say_what_to_expect():
    """A fit makes the spread of its own innovations nearly 1; the error of the simulated spreads is what counts."""
    expected, p_value = as_simulated([(0.996, 0.0004, 9), (1.001, 0.003, 9), (1.003, 0.004, 9)])
    error = np.sqrt(0.0004**2 + (0.003**2 + 0.004**2) / 4.0)
    assert expected == pytest.approx(1.002)
    assert p_value == pytest.approx(2.0 * student.sf(0.006 / error, 8))
    assert p_value > 0.01
