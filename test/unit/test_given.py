"""A model file on other recordings: what it holds, what is fitted anew, and what is left out."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

import sugiyama_ros as sg
from sugiyama_ros.diagnosis.refine import with_named
from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR, defaults
from sugiyama_ros.effects.registry import ROW, index_of, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.given import fit_people, prepare_for
from sugiyama_ros.fit.law import in_filter
from sugiyama_ros.fit.model import evaluate
from sugiyama_ros.fit.model_file import FittedDrivers, drive_by, read_model, write_drivers, write_model
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Clock, Simulator, platoon, simulate
from sugiyama_ros.trajectories.dense import tracks_of
from sugiyama_ros.verdict.compare import compare

CARS, RING_M, LENGTH_M = 7, 77.0, 4.2
PATCH = {"reduction": 0.25, "centre": 20.0, "width": 25.0}


def recording(people: int, noise: int, every: int = 1, effect: str = "slow_patch", **values: float):
    """Drivers of one road; people, noise: seeds; every: the camera keeps one sample of so many."""
    rng, rows = np.random.default_rng(people), ROW.with_effects(defaults(CARS))
    for k in (V_STAR, KAPPA_V):
        rows[:, k] *= np.exp(0.1 * rng.standard_normal(CARS))
    rows = switch_on(rows, effect, values or PATCH)
    length, clock = np.full(CARS, LENGTH_M), Clock(1.0 / 3.0 / every)
    start = platoon(length, 4.0)
    run = simulate(Simulator(rows, length, start, Road(RING_M), np.random.default_rng(noise), clock=clock), 150.0)
    dense = run.dense
    return tracks_of(replace(dense, position_m=dense.position_m[::every], period_s=every * dense.period_s))


@pytest.fixture(scope="module")
def work():
    with ThreadPoolExecutor(2) as pool:
        yield pool


@pytest.fixture(scope="module")
def base(work):
    data = prepare(recording(1, 1))
    return data, in_filter(data, PAPERS, work)


def written(folder: Path, data, fitted):
    write_model(folder / "model.yaml", data, fitted)
    return read_model(folder / "model.yaml")


@pytest.mark.parametrize(
    "name",
    [
        "slow_patch",
        "gap_offset",
        "sensor_eccentricity",
        "response_constants",
        "speed_dependent_noise",
        "discovered_force:gap",
        "preference_drift",
    ],
)
def test_a_file_fitted_to_its_own_recording_again_ends_where_it_was(name, base, work, tmp_path):
    data, fit = base
    fitted = with_named(data, fit, [name], work)
    again, given = fit_people(data, fit, written(tmp_path, data, fitted), work)
    # the search ends within half a nat of the maximum, on either side
    assert again.log_likelihood == pytest.approx(fitted.log_likelihood, abs=2.0)
    shared = list(fitted.model.shared)
    np.testing.assert_allclose(again.model.rows[:, shared], fitted.model.rows[:, shared], rtol=1e-12)
    assert {"sigma_nu", "v_star", "kappa_v"} <= set(given.fitted)
    assert ("gap_offset.offset" in given.fitted) == (name == "gap_offset")
    assert given.left_out == ()


def test_what_holds_of_the_road_holds_for_other_people(base, work, tmp_path):
    data, fit = base
    file = written(tmp_path, data, with_named(data, fit, ["slow_patch"], work))
    others = prepare_for(recording(2, 2), file)
    other_base = in_filter(others, PAPERS, work)
    fitted, _ = fit_people(others, other_base, file, work)
    # the truth, with the same drivers, is better than the base model by about 90 nats
    assert fitted.log_likelihood > other_base.log_likelihood + 30.0
    as_it_is = evaluate(others, replace(fitted.model, rows=file.rows, ahead=file.rows), work)
    assert fitted.log_likelihood > as_it_is.total + 30.0


@pytest.mark.parametrize(
    ("name", "strength"), [("preference_switch", "v_star_change"), ("discovered_force:time", "force_0")]
)
def test_a_moment_of_one_recording_is_left_out_of_another(name, strength, base, work, tmp_path):
    data, fit = base
    fitted, effect = with_named(data, fit, [name], work), name.partition(":")[0]
    others = prepare(recording(2, 2))
    again, given = fit_people(others, in_filter(others, PAPERS, work), written(tmp_path, data, fitted), work)
    assert given.left_out == (effect,)
    assert not again.model.rows[:, index_of(effect, strength)].any()


def test_a_comparison_names_only_the_effects_that_the_model_has_for_other_people(base, work, tmp_path):
    data, fit = base
    file = written(tmp_path, data, with_named(data, fit, ["preference_switch", "slow_patch"], work))
    compared = compare(sg.simulate(3, ring_m=33.0, duration_s=40.0, seed=2).measured, model=file)
    assert [one.name for one in compared.models if one.kind == "given"] == ["file: slow_patch"]
    assert compared.given is not None
    assert compared.given.left_out == ("preference_switch",)


def test_a_comparison_names_the_law_of_a_file(tmp_path):
    rows = switch_on(np.array([drive_by(ROW.with_effects(defaults()), "idm")] * 3), "drag", {"c0": 0.1})
    write_drivers(tmp_path / "idm.yaml", FittedDrivers(range(3), "", "", rows, [{}] * 3, {}, 0.0))
    recorded = sg.simulate(3, ring_m=33.0, duration_s=40.0, seed=2).measured
    compared = compare(recorded, model=read_model(tmp_path / "idm.yaml"))
    assert [one.name for one in compared.models if one.kind == "given"] == ["file: idm, drag"]


def test_an_effect_of_some_drivers_is_sought_in_each_of_other_people(base, work, tmp_path):
    data, fit = base
    rows = switch_on(fit.model.rows, "slow_patch", PATCH)
    rows[2:, index_of("slow_patch", "reduction")] = 0.0
    file = written(tmp_path, data, replace(fit, model=replace(fit.model, rows=rows)))
    again, given = fit_people(data, fit, file, work)
    assert "slow_patch.reduction" in given.fitted
    assert np.allclose(again.model.rows[:, index_of("slow_patch", "centre")], 20.0)
    # all drivers of the recording have it
    assert np.median(again.model.rows[:, index_of("slow_patch", "reduction")]) == pytest.approx(0.25, abs=0.1)


def test_the_typical_driver_has_an_effect_where_those_who_have_it_say_it_acts(base, tmp_path):
    data, fit = base
    rows = switch_on(fit.model.rows, "slow_patch", PATCH)
    rows[3:, ROW.places["slow_patch"]] = 0.0  # these drivers have none, and so no place
    file = written(tmp_path, data, replace(fit, model=replace(fit.model, rows=rows)))
    assert file.typical[index_of("slow_patch", "centre")] == 20.0
    assert file.typical[index_of("slow_patch", "reduction")] == 0.0
    assert np.array_equal(file.rows_of(file.vehicle, data.vicinity.sha256), file.rows)
    assert np.array_equal(file.rows_of(file.vehicle), file.rows)
    assert np.array_equal(file.rows_of(file.vehicle, "of others"), np.tile(file.typical, (CARS, 1)))


def test_a_file_keeps_how_often_drivers_decide(work, tmp_path):
    tracks = recording(1, 1, every=2)
    data = prepare(tracks, 2)
    fitted = with_named(data, in_filter(data, PAPERS, work), ["slow_patch"], work)
    file = written(tmp_path, data, fitted)
    assert file.conditions.decision_period_s == pytest.approx(1.0 / 6.0)
    again = prepare_for(recording(1, 3, every=2), file)
    assert (again.decisions, again.vicinity.period_s) == (2, pytest.approx(1.0 / 6.0))
    finer = recording(1, 3)
    assert prepare_for(finer, file).decisions == 2
    assert sg.simulate(model=tmp_path / "model.yaml", duration_s=2.0).dense.period_s == pytest.approx(1.0 / 6.0)


def test_simulated_drivers_of_a_file_drive_as_they_did(base, work, tmp_path):
    data, fit = base
    written(tmp_path, data, with_named(data, fit, ["slow_patch"], work))
    dense = sg.simulate(model=tmp_path / "model.yaml", duration_s=5.0).dense
    assert (dense.position_m.shape, dense.road) == ((16, CARS), Road(RING_M))
    assert np.allclose(dense.length_m, LENGTH_M)
    assert dense.position_m[0].argmin() == 0  # the first driver of the file is behind all others
    fewer = sg.simulate(3, model=tmp_path / "model.yaml", ring_m=60.0, period_s=0.5, duration_s=5.0).dense
    assert (fewer.position_m.shape, fewer.road) == ((11, 3), Road(60.0))


@pytest.mark.parametrize(
    ("entry", "value", "why"),
    [
        ("decision_period_s", -1, "decision_period_s: -1 is not possible"),
        ("road", {"ring_m": -4}, "ring_m: -4 is not possible"),
        ("road", 7, "road: give ring_m"),
        ("individual", ["v_sta"], "individual: 'v_sta' is not the name of a parameter"),
        ("individual", ["discovered_force.covariate"], "individual: 'discovered_force.covariate' is not the name"),
        ("individual", ["kappa_v", "law"], "individual: 'law' is not the name of a parameter"),
        ("individual", "v_star", "individual: give a list"),
    ],
)
def test_what_a_file_cannot_mean_is_refused(base, tmp_path, entry, value, why):
    data, fit = base
    written(tmp_path, data, fit)
    path = tmp_path / "model.yaml"
    document = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump({**document, entry: value}))
    with pytest.raises(InputError, match=why):
        read_model(path)


def test_drivers_by_several_laws_are_no_population(base, tmp_path):
    rows = np.array([drive_by(ROW.with_effects(defaults()), name) for name in ("idm", PAPERS, "idm")])
    write_drivers(tmp_path / "laws.yaml", FittedDrivers([0, 1, 2], "", "", rows, [{}] * 3, {}, 0.0))
    file = read_model(tmp_path / "laws.yaml")
    assert np.array_equal(file.typical, rows[0])
    assert sg.simulate(5, model=tmp_path / "laws.yaml", duration_s=5.0).dense.position_m.shape[1] == 5
    with pytest.raises(
        InputError, match=f"model: its drivers drive by several laws, {PAPERS}, idm; give a file of one"
    ):
        compare(recording(1, 1), model=file)
