"""Vehicles that have names: what is printed and written of a driver has the name, and the number says the same car."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import yaml

import sugiyama_ros as sg
from sugiyama_ros.fit.law import in_filter
from sugiyama_ros.fit.model_file import read_model, write_model
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.page import tables
from sugiyama_ros.page.words import on_unseen
from sugiyama_ros.trajectories.dense import whole_road

NAMES = ("Ann", "Bob", "Cyd", "Dee")


@pytest.fixture(scope="module")
def named():
    """Four cars on a ring, who are named against the order in which they drive."""
    frame = sg.simulate(4, ring_m=50.0, duration_s=60.0, seed=1).measured.to_frame()
    frame = frame[["vehicle", "time_s", "s_m"]].rename(columns={"s_m": "position_m"})
    frame["vehicle"] = [NAMES[3 - int(v)] for v in frame["vehicle"]]
    return sg.read(frame, ring_m=50.0)


def test_one_road_keeps_the_names_of_its_vehicles(named):
    road = whole_road(named)
    assert (road.names, road.vehicle.tolist()) == (NAMES, [0, 1, 2, 3])
    assert road.around([2], 1).names == ("Cyd", "Bob")
    assert whole_road(sg.simulate(4, ring_m=50.0, duration_s=60.0).measured).names == ()


def test_a_model_file_and_the_tables_name_the_drivers(named, tmp_path):
    data = prepare(named)
    with ThreadPoolExecutor(2) as work:
        write_model(tmp_path / "model.yaml", data, in_filter(data, PAPERS, work))
    written = yaml.safe_load((tmp_path / "model.yaml").read_text())["drivers"]
    assert {number: one["name"] for number, one in written.items()} == dict(enumerate(NAMES))
    assert read_model(tmp_path / "model.yaml").vehicle.tolist() == [0, 1, 2, 3]
    drivers = [name.document() for name in data.vicinity.names]
    gains = {"heldout_gain_nats": 1.0, "single_car_10s_before_m": 2.0, "single_car_10s_after_m": 1.0}
    shown = tables.by_driver({"drivers": [{**one, **gains} for one in drivers]})
    assert [row[0] for row in shown.rows] == list(NAMES)
    addition = {"heldout_gain_nats": 9.0, "heldout_gain_se": 1.0, "gains": {}, "vehicles": [1, 3]}
    assert on_unseen({"drivers": drivers}, addition).endswith("shown by vehicles 1 (Bob) and 3 (Dee) only")


@pytest.mark.parametrize("formulation", ["causal", "paper"])
def test_a_calibration_names_the_drivers(named, tmp_path, formulation):
    found = sg.calibrate(named, formulation=formulation)
    assert [one["vehicle"] for one in found.records()] == list(NAMES)
    found.write(tmp_path / "model.yaml")
    written = yaml.safe_load((tmp_path / "model.yaml").read_text())["drivers"]
    assert {number: one["name"] for number, one in written.items()} == dict(enumerate(NAMES))


def test_vehicles_without_names_are_numbers_everywhere(tmp_path):
    tracks = sg.simulate(3, ring_m=40.0, duration_s=60.0).measured
    found = sg.calibrate(tracks)
    assert [one["vehicle"] for one in found.records()] == [0, 1, 2]
    found.write(tmp_path / "model.yaml")
    assert all("name" not in one for one in yaml.safe_load((tmp_path / "model.yaml").read_text())["drivers"].values())
    assert prepare(tracks).vicinity.names[2].document() == {"vehicle": 2}


def test_a_road_with_a_controlled_vehicle_keeps_the_names(named):
    is_led = np.array([name == "Bob" for name in named.vehicle.values()])
    drivers = prepare(replace(named, controlled=is_led)).vicinity.names
    assert [one.shown for one in drivers] == ["Ann", "Cyd", "Dee"]
