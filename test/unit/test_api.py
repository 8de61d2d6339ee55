"""The Python interface: its examples run, and every result shows itself and can be written."""

import doctest
import json

import numpy as np
import pandas as pd
import pytest

import sugiyama_ros as sg
from sugiyama_ros import api
from sugiyama_ros.errors import InputError


@pytest.fixture(scope="module")
def simulation():
    return sg.simulate(vehicles=3, ring_m=40.0, duration_s=40.0, seed=1, effects={"drag": {"c0": 0.3}})


def test_the_examples_of_all_functions_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = doctest.testmod(api)
    assert found.attempted >= 15
    assert found.failed == 0


def test_a_name_that_is_not_there_is_told():
    with pytest.raises(AttributeError, match="'sugiyama_ros' has no attribute 'drive'"):
        sg.drive  # noqa: B018
    assert set(dir(sg)) == set(sg.__all__)


def test_laws_and_effects_are_mappings():
    assert list(sg.laws)[:2] == ["adaptive_seek", "idm"]
    assert sg.effects["slow_patch"].title == "slower stretch of road"
    assert "slower stretch of road" in sg.effects._repr_html_()


def test_a_picture_takes_the_place_of_axes(simulation):
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2)
    part = simulation.measured.plot(ax=right)
    assert part.figure is figure
    assert figure.axes == [left, *part.axes]
    with pytest.raises(InputError, match="no part of a grid"):
        simulation.measured.plot(ax=figure.add_axes((0.0, 0.0, 0.1, 0.1)))
    plt.close(figure)


def test_heldout_log_likelihoods_are_exported_for_other_tools(simulation):
    compared = sg.compare(simulation)
    exported = compared.to_xarray()["log_likelihood"]
    rows = {one["name"]: one for one in compared.records()}
    assert list(exported["driver"]) == [0, 1, 2]
    for name in ("base", "helly"):
        mean = float(exported.sel(model=name).mean())
        assert mean == pytest.approx(rows[name]["loglik_per_sample"], rel=1e-12)
    assert compared.summary().splitlines()[1].split()[:2] == ["name", "kind"]


def test_a_data_frame_is_read_like_the_file(simulation, tmp_path):
    simulation.save(tmp_path / "three.csv")
    from_file = sg.read(tmp_path / "three.csv", ring_m=40.0)
    from_frame = sg.read(pd.read_csv(tmp_path / "three.csv"), ring_m=40.0)
    assert np.array_equal(from_file.s_m, from_frame.s_m)
    assert np.array_equal(from_file.leader_row, from_frame.leader_row)
    assert np.array_equal(from_file.dense().position_m, simulation.dense.position_m)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda f: f.drop(columns="vehicle"), "no column vehicle"),
        (lambda f: f.assign(vehicle="car"), r"vehicle car is at .* and at .* give the column recording"),
        (lambda f: f.assign(vehicle=-1), r"vehicle -1 is at .* and at "),
        (lambda f: f.assign(time_s=np.nan), "no row has a vehicle, a time and a position"),
    ],
)
def test_a_bad_data_frame_is_refused_in_one_line(simulation, change, told):
    with pytest.raises(InputError, match=told):
        sg.read(change(simulation.measured.to_frame()))


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"vehicles": 0}, "vehicles: 0 cannot be simulated"),
        ({"colour": "red"}, "'colour' is not known; give ring_m"),
        ({"vehicles": 30, "ring_m": 100.0}, "30 vehicles with gaps of 2 m need"),
        ({"effects": {"drag": {"c9": 1.0}}}, "has no parameter 'c9'"),
    ],
)
def test_bad_settings_are_refused_in_one_line(settings, told):
    with pytest.raises(InputError, match=told):
        sg.simulate(**settings)


def test_results_show_themselves_and_are_written(simulation, tmp_path):
    found = sg.calibrate(simulation.measured, "paper", ["v_star"])
    for result in (simulation, simulation.measured, found):
        assert repr(result).startswith(f"<{type(result).__name__}: 3 ")
        assert len(repr(result)) < 200
        assert "<table>" in result._repr_html_()
        assert len(result.to_frame()) == len(result.records())
        assert result.plot()._repr_png_()[:4] == b"\x89PNG"
    for suffix in (".json", ".csv", ".png", ".pdf", ".yaml"):
        found.save(tmp_path / f"found{suffix}")
        assert (tmp_path / f"found{suffix}").stat().st_size > 100
    assert json.loads((tmp_path / "found.json").read_text())[0]["vehicle"] == 0
    with pytest.raises(InputError, match=r"cannot be written as '\.txt'"):
        found.save(tmp_path / "found.txt")


def test_options_that_contradict_each_other_are_refused(simulation):
    with pytest.raises(InputError, match="the paper's formulation knows none"):
        sg.calibrate(simulation.measured, "paper", effects=["drag"])
    with pytest.raises(InputError, match="'all': is not known"):
        sg.diagnose(simulation.measured, add="all")
