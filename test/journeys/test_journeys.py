"""Journeys of users, from what they have to the numbers that they read. All commands run as a user types them.

Other journeys are elsewhere: effects, laws, formats and studies of one's own in test_own_parts.py, an effect added on
the live page in test/system/test_page.py, the measured experiment in test/system/test_main_job.py.
"""

import json
import re
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sugiyama_ros as sg
from journeys import recordings
from journeys.forks import Forks

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]
#: Desired speed [m/s] and risk premium [s] of the simulated drivers: the paper's, Eq. SimulatedModelParameters.
V_STAR, KAPPA_V = 10.26, 0.215
HILL = "--effect road_grade:grade=0.06,centre=50,width=30"


class Here:
    """A folder in which a user works."""

    def __init__(self, folder: Path, forks: Forks) -> None:
        self.folder, self._forks = folder, forks

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    def says(self, command: str) -> str:
        """What a command prints; the test fails if it does not end well."""
        said = self._forks.run_text(self.folder, f"sugiyama {command}")
        assert said.code == 0, f"sugiyama {command}\n{said.out}{said.err}"
        return said.out

    def tells(self, command: str) -> Any:
        """The document that a command prints."""
        return json.loads(self.says(f"{command} --json"))


@pytest.fixture
def here(tmp_path: Path, forks: Forks) -> Here:
    return Here(tmp_path, forks)


def free_port() -> str:
    """A port that nothing holds at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def near_the_truth(drivers: "list[dict[str, Any]]", name: str, truth: float) -> None:
    """Estimates lie within four standard errors of the truth where the data identify them, which is somewhere so."""
    known = [d for d in drivers if d["identified"][name]]
    assert known
    for driver in known:
        assert abs(driver[name] - truth) < 4.0 * driver["std"][name] + 0.02 * truth, driver


def mean_error(run: "dict[str, Any]") -> float:
    """Mean of the drivers' one-step errors [m]."""
    return float(np.mean([driver["one_step_rmse_m"] for driver in run["drivers"]]))


def test_a_csv_of_a_ring_to_an_added_effect_and_back(here: Here) -> None:
    """Cars drive over a hill that the model lacks. It is found, added, and helps on another day's recording."""
    for name, seed in (("monday.csv", 3), ("tuesday.csv", 4)):
        here.says(f"simulate --vehicles 8 --ring 85 --duration 120 --seed {seed} {HILL} -o {name}")
    told = here.tells("diagnose monday.csv --ring 85 --add auto -o hill.yaml")
    (effect,) = told["verdict"]["effects"]
    assert effect["name"] == "road_grade"
    for name, truth in (("grade", 0.06), ("centre", 50.0)):
        assert abs(effect["parameters"][name] - truth) < 4.0 * effect["parameters_std"][name]
    assert effect["heldout_gain_nats"] > 3.0 * effect["heldout_gain_se"]
    before, after = (told["errors"][when]["free_run_10s_m"] for when in ("before", "after"))
    assert after < 0.75 * before
    rows = {row["name"]: row for row in here.tells("compare tuesday.csv --ring 85 --model hill.yaml")["models"]}
    (with_hill,) = (row for name, row in rows.items() if name.startswith("file"))
    assert with_hill["heldout_gain_nats"] > 3.0 * with_hill["heldout_gain_se"]
    assert with_hill["free_run_10s_m"] < 0.85 * rows["base"]["free_run_10s_m"]
    base, better = (
        here.tells(f"run tuesday.csv --ring 85 {model} -o {name}.mcap")
        for name, model in (("base", ""), ("hill", "--model hill.yaml"))
    )
    assert base["messages_lost"] == better["messages_lost"] == 0
    assert mean_error(better) < mean_error(base)
    (here / "hill.json").write_text(json.dumps(told))
    here.says("run monday.csv --ring 85 --model hill.yaml -o monday.mcap")
    here.says("report monday.mcap --diagnosis hill.json")
    card = (here / "monday.html").read_text().split("<nav>")[0].replace("\N{NO-BREAK SPACE}", " ")
    assert told["about"]["road_grade"]["title"] in card.lower()
    assert f"{effect['heldout_gain_nats']:.0f} ± {effect['heldout_gain_se']:.0f} nats" in card


def test_a_file_of_the_mstf_to_parameters_in_the_papers_form(here: Here) -> None:
    recordings.mstf(here / "case.data", duration_s=120.0)
    assert "45 m" in here.says("info case.data")
    for formulation in ("paper", "causal"):
        drivers = here.tells(f"calibrate case.data --formulation {formulation}")["drivers"]
        assert len(drivers) == 4
        # the paper's likelihood is biased, as docs/case1.md says; its mean is still near the truth
        assert np.mean([d["kappa_v"] for d in drivers]) == pytest.approx(KAPPA_V, rel=0.25)
    near_the_truth(drivers, "v_star", V_STAR)
    near_the_truth(drivers, "kappa_v", KAPPA_V)


def test_tracks_of_several_lanes_to_parameters_and_a_recording(here: Here) -> None:
    here.says("simulate --lanes 2 --vehicles 4 --duration 80 --seed 3 -o road.parquet")
    told = here.tells("info road.parquet")
    assert (told["vehicles"], told["period_s"]) == (8, pytest.approx(1.0 / 3.0, abs=1e-3))
    here.says("convert road.parquet left.csv --lane 1 --from 10 --to 70")
    assert here.tells("info left.csv")["vehicles"] == 4
    drivers = here.tells("calibrate road.parquet")["drivers"]
    assert len(drivers) == 6  # nobody knows whom the first car of each lane follows
    run = here.tells("run road.parquet -o run.mcap")
    assert (run["vehicles"], run["messages_lost"]) == (8, 0)
    assert 0.2 < mean_error(run) < 0.5  # measurement noise of 0.26 m, and what the acceleration adds


@pytest.mark.parametrize("storage", ["mcap"])
def test_a_folder_of_rosbag2_to_parameters(here: Here, storage: str) -> None:
    """Odometry of three cars, as a robot records it, becomes tracks, and these become estimates."""
    recordings.odometry_bag(here / "drive", storage=storage)
    recordings.centre_line(here / "line.csv")
    told = here.tells("convert drive tracks.parquet --odometry /car*/odom --centerline line.csv")
    assert told["vehicles"] == 3
    true = recordings.drivers(3, 0.0, 40.0, period_s=0.1)
    tracks = sg.read(here / "tracks.parquet")
    seen = tracks.to_frame().groupby("vehicle", observed=True)["s_m"].agg(lambda s: s.iloc[-1] - s.iloc[0])
    np.testing.assert_allclose(np.sort(seen), np.sort(true.position_m[-1] - true.position_m[0]), atol=1.5)
    drivers = here.tells("calibrate tracks.parquet")["drivers"]
    assert len(drivers) >= 2
    # what is kept is chosen as of every other file
    fewer = here.tells(
        "convert drive fewer.parquet --odometry /car*/odom --centerline line.csv --without 1 --to 1700000010"
    )
    assert (fewer["vehicles"], fewer["rows"]) == (2, 202)


def test_a_perception_of_ones_own_type_to_tracks(here: Here) -> None:
    """A bag of messages of a type that nobody knows, with a file that says what their fields mean."""
    recordings.targets_bag(here / "radar")
    recordings.centre_line(here / "line.csv")
    (here / "radar.yaml").write_text(
        "type: radar_msgs/msg/Targets\nobjects: targets\nid: number\nx: at.x\ny: at.y\nheading: yaw\nlength: length\n"
    )
    seen = "--odometry /targets --centerline line.csv --bridge radar.yaml"
    told = here.tells(f"convert radar tracks.csv {seen}")
    assert told["vehicles"] == 3
    rows = sg.read(here / "tracks.csv").to_frame()
    assert set(rows.vehicle.astype(str)) == {"1", "2", "3"}
    true = recordings.drivers(3, 0.0, 20.0, period_s=0.1)
    np.testing.assert_allclose(np.sort(rows.length_m.unique()), np.sort(np.unique(true.length_m)), atol=1e-3)
    # two of the three cars have a car ahead
    assert rows.leader.isin(["1", "2", "3"]).mean() == pytest.approx(2.0 / 3.0, abs=0.02)


def test_a_data_frame_to_a_comparison_and_a_model_file(tmp_path: Path) -> None:
    table = recordings.table(recordings.drivers(duration_s=90.0))
    measured = sg.read(table, ring_m=45.0)
    assert (measured.runs, measured.about.ring_m) == (4, 45.0)
    found = sg.calibrate(measured)
    frame = found.to_frame()
    assert np.average(frame.v_star) == pytest.approx(V_STAR, rel=0.05)
    found.save(tmp_path / "model.yaml")
    again = sg.simulate(4, model=tmp_path / "model.yaml", ring_m=45.0, duration_s=60.0, seed=5)
    compared = sg.compare(again.measured, model=tmp_path / "model.yaml").to_frame().set_index("name")
    (row,) = [name for name in compared.index if name.startswith("file")]
    # drivers who drive as the file says are predicted by it as well as by what is fitted to them
    assert compared.loc[row, "one_step_rmse_m"] == pytest.approx(compared.loc["base", "one_step_rmse_m"], rel=0.05)
    assert compared.loc["constant_speed", "free_run_10s_m"] > 2.0 * compared.loc["base", "free_run_10s_m"]


def test_several_files_are_several_recordings(here: Here) -> None:
    for name, seed in (("a.mcap", 1), ("b.mcap", 2)):
        here.says(f"simulate --vehicles 3 --ring 40 --duration 60 --seed {seed} -o {name}")
    alone = [here.tells(f"calibrate {name}")["drivers"] for name in ("a.mcap", "b.mcap")]
    both = here.tells("calibrate a.mcap b.mcap")["drivers"]
    assert len(both) == len(alone[0]) + len(alone[1]) == 6
    near_the_truth(both, "v_star", V_STAR)
    models = here.tells("compare a.mcap b.mcap")["models"]
    assert {len(model["drivers"]) for model in models if model["name"] == "base"} == {6}


def test_a_run_goes_on_with_what_another_has_learnt(here: Here) -> None:
    """Drivers whose desired speed is far from the paper's are predicted better by who knows them already."""
    for name, seed in (("a", 1), ("b", 2)):
        here.says(f"simulate --vehicles 4 --ring 100 --duration 120 --set v_star=7 --seed {seed} -o {name}.mcap")
    learnt = here.tells("run a.mcap -o first.mcap --save-state known")
    assert len(list((here / "known").iterdir())) == 4
    resumed, fresh = (here.tells(f"run b.mcap -o {k}.mcap {how}") for k, how in ((1, "--resume known"), (2, "")))
    known = [driver["v_star"] for driver in learnt["drivers"] if "v_star" in driver["identified"]]
    assert known == pytest.approx([7.0] * len(known), rel=0.05)
    assert len(known) >= 3
    errors = [mean_error(run) for run in (resumed, fresh)]
    assert errors[0] < errors[1]
    said = here.says("report 1.mcap")
    assert re.search(r"page: 1\.html", said)


def test_a_live_page_says_where_its_recording_is_if_there_is_one(here: Here, forks: Forks) -> None:
    recordings.ring_csv(here / "ring.csv", duration_s=20.0)
    port = free_port()
    said = forks.run(here.folder, ["live", "ring.csv", "--ring", "45", "--rate", "max", "--port", port], "live page:")
    assert said.code == 0
    is_there = (here / "sugiyama-live.mcap").exists()
    assert ("all topics are in sugiyama-live.mcap" in said.err) == is_there
    assert ("nothing was recorded" in said.err) != is_there
