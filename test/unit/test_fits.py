"""Fits, held-out scores and the diagnosis on small simulated recordings whose truth is known."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import yaml

from sugiyama_ros.diagnosis import prescreen
from sugiyama_ros.diagnosis.candidates import named
from sugiyama_ros.diagnosis.compare import SIMULATED
from sugiyama_ros.diagnosis.diagnosis import diagnose
from sugiyama_ros.diagnosis.errors import errors_of
from sugiyama_ros.diagnosis.free_runs import free_runs
from sugiyama_ros.diagnosis.screen import screen
from sugiyama_ros.diagnosis.use import Goal
from sugiyama_ros.diagnosis.verdict import document, sentences
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.causal import filter_chain
from sugiyama_ros.filters.state import STATE
from sugiyama_ros.fit.cross_validation import held_out, held_out_nearly, without_folds
from sugiyama_ros.fit.joint import fit, objective
from sugiyama_ros.fit.model_file import read_model, write_model
from sugiyama_ros.fit.population import fit_base, start_model
from sugiyama_ros.fit.recording import FOLDS, prepare
from sugiyama_ros.fit.score import evaluate, filtered_states, follow
from sugiyama_ros.fit.slopes import slopes
from sugiyama_ros.laws.registry import RIVALS
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

CARS, RING_M, LENGTH_M = 7, 77.0, 4.33
INDIVIDUAL = (SIGMA_NU, SIGMA_A, V_STAR, KAPPA_V)


def recording(effect: str = "", duration_s: float = 100.0, seed: int = 1, **values: float):
    rng = np.random.default_rng(seed)
    rows = ROW.with_effects(defaults(CARS))
    for k in (V_STAR, KAPPA_V):
        rows[:, k] *= np.exp(0.1 * rng.standard_normal(CARS))
    if effect:
        rows = switch_on(rows, effect, values)
    length = np.full(CARS, LENGTH_M)
    return simulate(Simulator(rows, length, platoon(length, 4.0), Road(RING_M), rng), duration_s)


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def fitted(work):
    run = recording()
    data = prepare(run.measured)
    return run, data, fit_base(data, INDIVIDUAL, work)


def test_a_fit_is_at_a_maximum(fitted, work):
    _, data, base = fitted
    again = fit(data, base.model, work, iterations=10)
    everywhere = range(FOLDS)
    rise = objective(again.slopes, again.model, everywhere) - objective(base.slopes, base.model, everywhere)
    assert -1e-9 <= rise < 0.5


def test_a_fit_beats_the_truth_by_as_much_as_its_freedom_allows(fitted, work):
    run, data, base = fitted
    truth = start_model(data, INDIVIDUAL)
    truth.rows[:], truth.ahead[:] = run.parameters, run.parameters
    excess = 2.0 * (base.log_likelihood - evaluate(data, truth, work).total)
    # chi-squared with 4 parameters per driver, some of them held by the prior: mean 28, 99.9 % below 56
    assert 0.0 < excess < 56.0


def test_slopes_are_the_derivatives_of_the_likelihood(fitted, work):
    _, data, base = fitted
    here, _ = slopes(data, base.model, work, base.slopes)
    score = sum(s.score.sum(axis=0) for s in here)
    size = sum(np.abs(s.score).sum(axis=0) for s in here)
    # at the maximum the slopes of the folds cancel, except for the slope of the prior
    assert np.all(np.abs(score) < 0.5 * size)


def test_each_fitted_parameter_costs_a_held_out_nat(fitted, work):
    _, data, base = fitted
    searched = held_out(data, without_folds(data, base, work, searched=True), work).total
    stepped = held_out(data, without_folds(data, base, work, searched=False), work).total
    nearly = held_out_nearly(data, base).total
    lost = base.log_likelihood - searched
    # Akaike: a parameter costs about one nat, half of it in sample; 28 parameters, some held by the prior
    assert 5.0 < lost < 84.0
    assert base.log_likelihood - stepped == pytest.approx(lost, rel=0.5)
    assert nearly == pytest.approx(stepped, abs=0.1 * lost)


def test_a_change_of_preferences_is_found_at_its_time(work):
    """The change lies between two starting points of the search, and is a third as strong as they assume."""
    change = {"v_star_change": -0.035, "kappa_v_change": 0.07, "time": 38.0}
    data = prepare(recording("preference_switch", **change).measured)
    look = screen(data, fit_base(data, INDIVIDUAL, work), *named(data, ["preference_switch"]), work)
    found = dict(zip(look.candidate.parameters, look.fit.model.rows[0, look.candidate.places], strict=True))
    # Wilks: three parameters gain 7.8 nats by chance in one of 1000 recordings
    assert look.gain > 7.8
    assert found["time"] == pytest.approx(38.0, abs=5.0)
    assert found["v_star_change"] < -0.01


@pytest.mark.parametrize("some", [3, 11])
def test_a_patch_is_found_whether_some_or_all_drivers_compare_starts(work, monkeypatch, some):
    """Drivers 0, 2, 4 and 6 choose among twelve places as well as all drivers do."""
    data = prepare(recording("slow_patch", reduction=0.15, centre=50.0, width=30.0).measured)
    monkeypatch.setattr(prescreen, "_DRIVERS", some)
    look = screen(data, fit_base(data, INDIVIDUAL, work), *named(data, ["slow_patch"]), work)
    found = dict(zip(look.candidate.parameters, look.fit.model.rows[0, look.candidate.places], strict=True))
    # Wilks: three parameters gain 7.8 nats by chance in one of 1000 recordings
    assert look.gain > 7.8
    # inside the patch
    assert found["centre"] == pytest.approx(50.0, abs=15.0)
    assert found["reduction"] > 0.05


def test_scores_of_some_drivers_equal_their_scores_among_all(fitted, work):
    _, data, base = fitted
    some, every = evaluate(data, base.model, work, [1, 4]), evaluate(data, base.model, work)
    assert np.isnan(some.log_likelihood[[0, 2, 3, 5, 6]]).all()
    for i in (1, 4):
        np.testing.assert_array_equal(some.of(i), every.of(i))
    assert every.only([1, 4]).total == some.total


def test_free_runs_start_where_the_filter_is(fitted, work):
    _, data, base = fitted
    errors = errors_of(data, without_folds(data, base, work, searched=False), work)
    found = errors.summary()
    # errors grow with the horizon; the error of one step is mostly measurement noise (sigma_nu 0.263 m)
    assert 0.263 < found["one_step_rmse_m"] < found["free_run_2s_m"] < found["free_run_10s_m"]
    assert errors.no_worse_than(errors)
    details = errors.details()
    assert details["single_car_10s_gap_m"] == pytest.approx(found["single_car_10s_m"], rel=1e-9)
    assert details["single_car_2s_gap_fit_percent"] < 100.0


def test_runs_of_all_folds_are_the_runs_of_the_whole_recording(fitted, work):
    _, data, base = fitted
    whole = free_runs(data, base.model, filtered_states(data, base.model, work), work)
    found = errors_of(data, [base.model] * FOLDS, work)
    for name, values in vars(whole).items():
        assert np.array_equal(getattr(found.runs, name), values, equal_nan=True), name
    # the blocks of every fold are driven, but for the samples in which the filter settles
    assert np.isfinite(found.block_position_m[20:]).mean() > 0.95


def test_free_runs_start_with_the_preferences_that_the_filter_knows(fitted, work):
    _, data, base = fitted
    time_constant, left = 30.0, np.exp(-5.0 / 30.0)
    rows = switch_on(base.model.rows, "preference_drift", {"std": 0.1, "time_constant": time_constant})
    wandering = replace(base.model, rows=rows, ahead=rows)
    states = follow(data, wandering, work)[1]
    assert states.shape[-1] == STATE + 2
    adapted = filter_chain(data.chains[3], rows[3], ahead=rows[[4, 5]]).mean[:, -2:]
    np.testing.assert_allclose(states[:, 3, STATE:], adapted, rtol=1e-12)
    # halfway through the longest run, the mood has returned to what is left of it: here, a fifth faster than usual
    states[:, :, STATE:] = np.log(rows[:, [V_STAR, KAPPA_V]])
    states[:, :, STATE] += np.log(1.2) / left
    faster = base.model.rows.copy()
    faster[:, V_STAR] *= 1.2
    found = free_runs(data, wandering, states, work)
    expected = free_runs(data, replace(base.model, rows=faster), states[:, :, :STATE].copy(), work)
    np.testing.assert_allclose(found.single, expected.single, atol=1e-9)
    np.testing.assert_allclose(found.coupled, expected.coupled, atol=1e-9)


@pytest.fixture(scope="module")
def hidden():
    run = recording("slow_patch", reduction=0.2, centre=20.0, width=25.0)
    return run, diagnose(run.measured, quick=True, goal=Goal(most=1), workers=2, seed=3)


def test_a_hidden_effect_is_named(hidden):
    _, d = hidden
    assert d.named[0].name == "slow_patch"
    assert d.named[0].p_value < 0.01
    assert d.named[0].parameters["reduction"] == pytest.approx(0.2, abs=0.06)
    assert d.after.loglik_per_sample > d.before.loglik_per_sample


def test_the_document_has_all_fields(hidden):
    _, d = hidden
    found = document(d)
    json.dumps(found, allow_nan=False)
    assert {"verdict", "candidates", "errors", "bootstrap_runs", "seed", "wall_s", "quick"} <= set(found)
    (named,) = found["verdict"]["effects"]
    assert {
        "name",
        "kind",
        "parameters",
        "indistinguishable",
        "p_value",
        "heldout_gain_nats",
        "heldout_gain_se",
        "free_run_rmse_before_m",
        "free_run_rmse_after_m",
    } <= set(named)
    assert found["verdict"]["none_detectable"] is False
    for errors in (found["errors"][name] for name in ("before", "after", "idm", "fvdm")):
        assert {f"free_run_{h}s_m" for h in (2, 5, 10)} | {"one_step_rmse_m", "single_car_10s_m"} < set(errors)
    known = [c["heldout_gain_nats"] is not None for c in found["candidates"]]
    gains = [c["heldout_gain_nats"] for c in found["candidates"][: sum(known)]]
    assert gains == sorted(gains, reverse=True)
    # what promised too little to be fitted stands at the end, with what it promised
    assert known == sorted(known, reverse=True)
    assert all(c["gain_nats"] <= 5.0 for c in found["candidates"][sum(known) :])
    assert {c["name"] for c in found["candidates"]} >= {"actuation_lag", "slow_patch", "noise_constants"}
    assert {"outcome", "better_law", "bins_flagged", "bins_expected", "explained_share", "reasons"} == set(
        found["verdict"]["adequacy"]
    )
    assert "slow_patch" in found["verdict"]["searched"]
    assert named["who"] == "all" or set(named["who"]) <= set(range(1, CARS + 1))
    assert sentences(d)[1].startswith("slow_patch (reduction 0.")


def test_the_document_has_what_a_page_needs(hidden):
    run, d = hidden
    found = document(d)
    # every block starts where the cars were measured, and goes on at their speed
    t, driven = d.data.trajectories, d.before.block_position_m
    first = [k for k in range(len(driven)) if k > 10 and d.data.block[0, k] != d.data.block[0, k - 1]]
    off = t.road.difference(driven[first], t.position_m[first])
    assert len(first) >= 4
    # the measurement noise is 0.26 m: six standard deviations
    assert np.nanmax(np.abs(off)) < 1.6
    assert np.isfinite(driven[20:]).all()
    shown = found["free_run"]
    assert len(shown["time_s"]) == len(shown["block"]) == len(shown["before"]) == len(shown["after"])
    assert all(len(row) == CARS for row in shown["after"])
    assert found["about"]["slow_patch"]["title"] == "slower stretch of road"
    assert found["about"]["slow_patch"]["parameters"]["centre"]["axis"] == "place"
    assert found["about"]["road_grade"]["kind"] == "effect"
    assert "floor" in found["errors"]
    assert found["verdict"]["told"] == sentences(d)
    assert found["verdict"]["effects"][0]["parameters_std"]["reduction"] > 0.0
    for driver, row in zip(found["drivers"], run.parameters, strict=True):
        # five standard deviations
        assert abs(driver["v_star"] - row[V_STAR]) < 5.0 * max(driver["v_star_std"], 0.05)
    for one in found["where"]["before"]["maps"]:
        assert np.shape(one["flagged"]) == np.shape(one["bias"])


def test_what_was_asked_for_is_added_and_nothing_else(hidden):
    run, _ = hidden
    asked = {"quick": True, "workers": 1, "seed": 3, "verdict_only": True}
    d = diagnose(run.measured, goal=Goal(("gap_offset",), most=1), **asked)
    assert d.searched == ("gap_offset",)
    assert [one.name for one in d.named] == ["gap_offset"]
    assert not d.named[0].is_supported  # the slower stretch of road, which is hidden, is no constant error
    with pytest.raises(InputError, match="magic"):
        diagnose(run.measured, goal=Goal(("magic",), most=1), **asked)


def test_the_same_seed_gives_the_same_verdict(hidden):
    run, d = hidden
    again = diagnose(run.measured, quick=True, goal=Goal(most=1), workers=1, seed=3, verdict_only=True)
    assert [(n.name, n.p_value, n.parameters) for n in again.named] == [
        (n.name, n.p_value, n.parameters) for n in d.named
    ]


def test_a_model_file_gives_the_model_back(hidden, tmp_path):
    run, d = hidden
    path = tmp_path / "model.yaml"
    write_model(path, d.data, d.final)
    read = read_model(path)
    assert read.effects == ("slow_patch",)
    assert read.rows_of(run.measured.vehicle) == pytest.approx(d.final.model.rows)
    assert yaml.safe_load(path.read_text())["shared_std"]["slow_patch.reduction"] > 0.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1, 2", "model.yaml"),
        ("nonsense: 3\n", "model file of format 1"),
        ("!!python/object/apply:os.system ['true']\n", "model.yaml"),
    ],
)
def test_a_bad_model_file_is_one_clear_line(tmp_path, text, says):
    path = tmp_path / "model.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as error:
        read_model(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("classes", ["[]", "[{share: -1, parameters: {}}]", "3", "[{share: 1}]"])
def test_bad_classes_in_a_model_file_are_one_clear_line(hidden, tmp_path, classes):
    _, d = hidden
    path = tmp_path / "model.yaml"
    write_model(path, d.data, d.final)
    path.write_text(path.read_text() + f"classes: {classes}\n")
    with pytest.raises(InputError, match=r"model\.yaml: classes: .*; give share and every parameter") as error:
        read_model(path)
    assert "\n" not in str(error.value)


def test_too_short_a_recording_is_refused():
    with pytest.raises(InputError, match="at least 8 s"):
        prepare(recording(duration_s=5.0).measured)


def test_diagnose_and_compare_on_the_command_line(hidden, tmp_path):
    run, d = hidden
    write_model(tmp_path / "model.yaml", d.data, d.final)
    lines = ["time_s,vehicle,position_m,length_m"]
    for k, row in enumerate(run.measured.position_m[:151]):
        lines += [f"{k / 3.0:.6f},{v},{x:.5f},{LENGTH_M}" for v, x in enumerate(row)]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "sugiyama_ros.cli", "compare", "run.csv", "--ring", str(RING_M)]
    done = subprocess.run(
        [*command, "--model", "model.yaml", "--json"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    names = [m["name"] for m in found["models"]]
    rivals = [
        name for law in RIVALS for name in (law, f"{law}_least_squares") if name != "constant_speed_least_squares"
    ]
    assert names == ["base", "file: slow_patch", *rivals, SIMULATED]
    scores = {m["name"]: m["loglik_per_sample"] for m in found["models"]}
    assert scores["file: slow_patch"] > scores["base"] > scores["constant_speed"]
    assert found["measured"]["mean_speed"] > 0.0
    done = subprocess.run(
        [*command, "--effects", "telepathy"], cwd=tmp_path, capture_output=True, text=True, check=False, env=os.environ
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: effect 'telepathy'")
    assert done.stderr.count("\n") == 1


def test_where_the_model_fails_is_where_the_slow_patch_is(hidden):
    _, d = hidden
    places = [b for b in d.where_before.bins if b.covariate == "place"]
    assert len(places) == 10
    centre = min(places, key=lambda b: abs(0.5 * (b.low + b.high) - 20.0))
    assert centre.bias < 0.0
    assert any(b.covariate == "place" for b in d.where_before.flagged)
    after = [b for b in d.where_after.flagged if b.covariate == "place"]
    assert len(after) < len([b for b in d.where_before.flagged if b.covariate == "place"])
    assert [(m.first, m.second) for m in d.where_before.maps] == [("speed", "gap"), ("place", "time")]
