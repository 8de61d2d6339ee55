"""A controlled vehicle in a recording: files keep it, and nobody judges it as a driver."""

import json
from pathlib import Path

import pytest
from journeys.forks import Forks

import sugiyama_ros as sg
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.table import write_csv
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.formats.truth import read_truth
from sugiyama_ros.trajectories.dense import tracks_of

RING_M = 65.0


@pytest.fixture(scope="module")
def simulation():
    return sg.simulate(6, ring_m=RING_M, duration_s=60.0, controlled=[0, 2], controller="constant_speed:target=5")


def test_every_file_of_ours_keeps_who_is_controlled(simulation, tmp_path: Path) -> None:
    tracks = simulation.measured
    files = {name: tmp_path / name for name in ("a.csv", "b.csv", "c.csv", "d.parquet", "e.mcap", "f.mcap")}
    write_csv(simulation.dense, files["a.csv"])
    write_tracks(tracks, files["b.csv"])
    tracks.save(files["c.csv"])
    tracks.save(files["d.parquet"])
    simulation.save(files["e.mcap"])
    write_bag(tracks.dense(), files["f.mcap"])
    for path in files.values():
        assert sg.read(path, ring_m=RING_M).controlled_names == ["0", "2"], path
    assert sg.read(tracks.to_frame(), ring_m=RING_M).controlled_names == ["0", "2"]
    assert {one.vehicle for one in read_truth(files["e.mcap"]).drivers} == {1, 3, 4, 5}


def test_files_without_controlled_vehicles_do_not_mention_them(tmp_path: Path) -> None:
    free = sg.simulate(3, ring_m=40.0, duration_s=10.0)
    free.save(tmp_path / "free.csv")
    assert (tmp_path / "free.csv").read_text().startswith("time_s,vehicle,position_m,length_m\n")
    assert free.measured.controlled is None
    assert "controlled" not in free.measured.columns


def test_a_vehicle_that_is_controlled_for_a_while_is_controlled() -> None:
    rows = {"vehicle": [], "time_s": [], "s_m": [], "controlled": []}
    for vehicle in range(2):
        for k in range(20):
            flag = "yes" if vehicle == 1 and k > 10 else ""
            for name, value in zip(rows, (vehicle, 0.5 * k, 20.0 * vehicle + 2.0 * k, flag), strict=True):
                rows[name].append(value)
    pandas = pytest.importorskip("pandas")
    assert sg.read(pandas.DataFrame(rows)).controlled_names == ["1"]
    rows["controlled"][3] = "acc"
    with pytest.raises(InputError, match="column controlled: 'acc' says neither yes nor no; give 1 or 0"):
        sg.read(pandas.DataFrame(rows))


def test_the_others_are_the_drivers(simulation) -> None:
    data = prepare(simulation.measured)
    assert data.vicinity.numbers == [1, 3, 4, 5]
    assert data.ahead[:, 0].tolist() == [-1, 2, 3, -1], "drivers know drivers ahead, and see who is controlled"
    assert (data.chains[0].identity[:, 1] >= 0).all(), "vehicle 1 follows vehicle 2, whoever drives it"


@pytest.mark.parametrize("formulation", ["causal", "paper"])
def test_calibrate_says_nothing_of_who_is_controlled(simulation, formulation) -> None:
    found = sg.calibrate(simulation, formulation, ["v_star", "kappa_v"])
    assert [one.number for one in found.drivers] == [1, 3, 4, 5]


def test_compare_says_nothing_of_who_is_controlled(simulation) -> None:
    found = sg.compare(simulation)
    assert found.data.vicinity.numbers == [1, 3, 4, 5]


def test_half_a_recording_keeps_who_is_controlled(simulation) -> None:
    tracks = simulation.measured
    half = tracks.select(tracks.time_s < 30.0)
    assert half.controlled_names == ["0", "2"]
    assert tracks_of(half.dense()).controlled.sum() == half.controlled.sum()


@pytest.mark.system
def test_the_commands_say_who_is_no_driver(simulation, tmp_path: Path, forks: Forks) -> None:
    simulation.save(tmp_path / "held.mcap")
    said = forks.run_text(tmp_path, "sugiyama calibrate held.mcap --formulation paper --json")
    assert said.err.splitlines() == ["a controller drives 0, 2: counted as no driver, but as the leader of others"]
    assert [one["vehicle"] for one in json.loads(said.out)["drivers"]] == [1, 3, 4, 5]
    said = forks.run_text(tmp_path, "sugiyama info held.mcap --json")
    assert said.code == 0
    simulation.measured.save(tmp_path / "held.parquet")
    said = forks.run_text(tmp_path, "sugiyama info held.parquet")
    assert "Controlled:  0, 2" in said.out
    said = forks.run_text(tmp_path, "sugiyama run held.mcap -o run.mcap --json")
    assert [one["vehicle"] for one in json.loads(said.out)["drivers"]] == [1, 3, 4, 5]
