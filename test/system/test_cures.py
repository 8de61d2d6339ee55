"""What a message says to do works: commands that are refused, and the same commands as the message says."""

import dataclasses
import json
import signal
import subprocess
import sys

import numpy as np
import pandas
import pytest

import sugiyama_ros as sg
from sugiyama_ros import cli
from sugiyama_ros.driver.parameters import at_period, defaults, horizon_at
from sugiyama_ros.driver.utility import ACTIONS, mean_action
from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.page.diagnosis import check_same, read_diagnosis
from sugiyama_ros.road import DECISIONS_S, SIMULATED_S
from sugiyama_ros.simulation.experiment import Experiment
from sugiyama_ros.trajectories.dense import road_of_drivers

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with tracks on two lanes, a ring, and vehicles in the plane with their road."""
    from journeys import recordings

    made = tmp_path_factory.mktemp("cures")
    sg.simulate_lane_changes(4, 2, 20.0, seed=1).tracks.save(made / "lanes.parquet")
    sg.simulate(3, ring_m=0.0, duration_s=20.0).measured.save(made / "apart.parquet")
    ring = sg.simulate(3, ring_m=40.0, duration_s=20.0)
    ring.measured.save(made / "ring.parquet")
    ring.measured.save(made / "ring.csv")
    ring.save(made / "ring.mcap")
    recordings.in_plane(made / "plane.csv", made / "road.csv")
    return made


@pytest.fixture
def run(folder, monkeypatch, capfd):
    """Run a command in the folder; returns its exit code, and its last line of error."""
    monkeypatch.chdir(folder)

    def call(words):
        monkeypatch.setattr(sys, "argv", ["sugiyama", *words.split()])
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code or 0, (capfd.readouterr().err.strip().splitlines() or [""])[-1]

    return call


REFUSED = {
    "convert plane.csv new.csv --road-file road.csv --ring 40": "ring: 40 m is given beside a road; leave out the ring",
    "info plane.csv --road-file road.csv --ring 40": "ring: 40 m is given beside a road; leave out the ring",
    "calibrate apart.parquet --ring 40": ": nobody drives once around a ring of 40 m, or follows somebody around it",
    "calibrate lanes.parquet --ring 400": ": nobody drives once around a ring of 400 m, or follows somebody around it",
    "simulate -o new.csv --duration inf": "inf cannot be simulated, for 22 vehicles every 0.333 s; give 300000 at most",
    "simulate -o new.csv --ring 1e20": "not a circumference; give a positive length, 10000000 m at most, or 0 for an",
    "calibrate ring.mcap --scheduler x": "--scheduler x: missing port number in address 'x'; start it, and give host:",
    "calibrate lanes.parquet --goal x:place=1e9": "--goal x:place=1e9: place is 1e9; give a position [m] that",
    "calibrate lanes.parquet --classes 9": "error: lanes.parquet: 2 drivers, 9 classes; give --classes 2 at most",
    "calibrate lanes.parquet --classes 99": "99 is not possible; give a number of classes, 20 and as many as there are",
    "calibrate lanes.parquet --goal x:place=20,deceleration=0": ": deceleration is 0; give 0.01 to 10 m/s^2",
    "calibrate ring.mcap --seed 3": "--seed: only classes and goals are searched at random; leave it out",
    "live nosuch.csv": "nosuch.csv: cannot be read: No such file or directory; check the name and the permissions",
    "simulate -o new.csv --set rationality=0": "--set: rationality is 0; give 1 to 100000",
    "simulate -o new.csv --effect second_leader_utility:weight=1": ": share is missing; give 0.2 to 1",
    f"simulate -o {'a' * 300}.csv": ".csv: cannot be written: File name too long; check the name",
    "run ring.mcap -o a.mcap --duration 2": "--duration: is for simulated drivers; give --simulate in place of a file",
    "simulate -o a.csv --lanes 2 --controlled 0": "is for one lane; leave out --controlled and --controller, or",
    "simulate -o a.csv --scene merge --controlled 0": "not for a scene; leave out --controlled and --controller",
    "simulate -o a.csv --ring 50": "22 vehicles with gaps of 2 m need 138 m; give a ring of 138 m or more, or fewer",
    "calibrate ring.mcap --classes 2 --effects drag": "share all parameters; leave it out, or --effects",
    "calibrate ring.mcap --profile --effects drag": "is for drivers calibrated one by one; leave it out, or --effects",
    "calibrate ring.mcap --formulation paper --law nosuch": "--law: the paper's formulation knows none; use the causal",
    "convert ring.csv a.csv --ring 40 --lane 7": "--lane 7: does not occur; the tracks do not say it; leave it out",
    "simulate -o a.csv --effect harshness:weight=x": "weight is x; give more than 0, and 100 at most",
    "simulate -o a.csv --effect slow_patch:centre=x": "centre is x; give a position [m] that vehicles come to",
    "info plane.csv": "with their road: sugiyama convert plane.csv tracks.parquet --road-file MAP.osm",
}


@pytest.mark.parametrize("words", REFUSED)
def test_refused_in_one_line(words, run):
    code, said = run(words)
    assert code == 2
    assert said.startswith("error: ")
    assert REFUSED[words] in said


CURED = (
    "convert plane.csv new.csv --road-file road.csv --overwrite",
    "calibrate lanes.parquet",
    "calibrate ring.parquet --ring 40",
    "calibrate lanes.parquet --classes 2",
    "calibrate lanes.parquet --classes 2 --seed 3",
    "simulate -o new.csv --overwrite --set rationality=1 --duration 5",
    "simulate -o new.csv --overwrite --ring 1e7 --duration 5",
    "simulate -o new.csv --overwrite --period 0.05 --duration 5",
)


@pytest.mark.parametrize("words", CURED)
def test_the_cure_works(words, run):
    code, said = run(words)
    assert code == 0, said


def test_goals_within_the_bounds_of_the_message(run):
    code, said = run("calibrate lanes.parquet --goal x:place=99999")
    assert code == 2
    first, _, last = said.split("give a place from ")[1].removesuffix(" m").split()
    for place in (first, last):
        code, said = run(f"calibrate lanes.parquet --goal x:place={place}")
        assert code == 0, said


def test_bounds_of_simulations():
    """A duration that the message allows is allowed; the usual drivers mean to drive on in the shortest period."""
    with pytest.raises(InputError, match=r"^duration_s: 1e\+12 cannot be simulated, for 3") as refused:
        Experiment(duration_s=1e12).check(3)
    longest_s = float(str(refused.value).split("give ")[1].split()[0])
    Experiment(duration_s=longest_s).check(3)
    with pytest.raises(InputError, match=r"^period_s: 0\.04 cannot be simulated; give 0\.05 to 1000"):
        Experiment(period_s=0.04).check(3)

    def wanted(period_s):
        row = at_period(defaults(), period_s)
        return mean_action(10.0, 5.0, 5.0, row, ACTIONS, period_s, horizon_at(period_s))

    found = [wanted(period_s) for period_s in (0.2, SIMULATED_S[0], 0.02)]
    assert np.round(found, 1).tolist() == [2.0, 1.0, -0.2]


def test_gaps_at_the_start():
    with pytest.raises(InputError, match=r"^gap_m: 0 cannot be simulated; give 0\.01 to 1e\+06"):
        sg.simulate(3, ring_m=40.0, duration_s=5.0, gap_m=0.0)
    assert sg.simulate(3, ring_m=40.0, duration_s=5.0, gap_m=0.01).dense.position_m.shape[1] == 3
    with pytest.raises(InputError, match=r"^gap_m: is for the start in a jam"):
        sg.simulate(3, ring_m=40.0, duration_s=5.0, gap_m=5.0, start="equal")
    with pytest.raises(InputError, match=r"^horizon: drivers by another law"):
        sg.simulate(3, ring_m=40.0, duration_s=5.0, law="idm", horizon=3)


def test_a_ring_beside_a_road_in_python(folder):
    with pytest.raises(InputError, match=r"^ring: 40 m is given beside a road"):
        sg.read(folder / "plane.csv", ring_m=40.0, road=folder / "road.csv")


def test_commands_for_a_part_can_be_pasted(folder):
    with pytest.raises(InputError, match=r"choose: sugiyama convert lanes\.parquet one\.parquet --lane \S+$"):
        sg.read(folder / "lanes.parquet").dense()


def test_who_is_measured_all_the_time_does_not_decide_all_the_time():
    """Samples that come more often than anybody decides are brought to the usual period, on whole roads, too."""
    frame = sg.simulate(3, ring_m=40.0, duration_s=10.0, period_s=0.05).dense
    rows = {
        "vehicle": np.tile(frame.vehicle, len(frame.position_m)),
        "time_s": np.repeat(frame.time_s, 3),
        "position_m": frame.position_m.ravel(),
    }
    road = road_of_drivers(sg.read(pandas.DataFrame(rows), ring_m=40.0))
    assert road is not None
    assert road.period_s == pytest.approx(0.1)


def test_a_model_file_says_how_often_somebody_decides(folder, run):
    assert run("calibrate ring.mcap -o model.yaml")[0] == 0
    text = (folder / "model.yaml").read_text()
    line = next(line for line in text.splitlines() if line.startswith("decision_period_s"))
    (folder / "model.yaml").write_text(text.replace(line, "decision_period_s: 0.001"))
    code, said = run("compare ring.mcap --model model.yaml")
    assert code == 2
    assert said.endswith(f"decision_period_s: 0.001 is not possible; give {DECISIONS_S[0]:g} to {DECISIONS_S[1]:g}")


def test_a_diagnosis_with_an_unknown_gain_says_where(folder, run):
    assert run("diagnose ring.mcap --add drag --simulations 1 --save d.json -o added.yaml")[0] == 0
    document = json.loads((folder / "d.json").read_text())
    for wrong in (None, {"nats": 1.0}):
        document["verdict"]["effects"][0]["gains"]["all"] = wrong
        (folder / "wrong.json").write_text(json.dumps(document))
        with pytest.raises(
            InputError, match=r"wrong\.json: is no diagnosis: document\.verdict\.effects\[0\]\.gains\.all: "
        ):
            read_diagnosis(folder / "wrong.json")
    document = json.loads((folder / "d.json").read_text())
    other = sg.simulate(3, ring_m=40.0, duration_s=20.0, seed=7).dense
    with pytest.raises(InputError, match=r"sugiyama run ring\.mcap -o \S+ring_run\.mcap --model added\.yaml$"):
        check_same(document, "d.json", dataclasses.replace(other, sha256="7"), folder / "other.mcap")


def test_a_force_that_cannot_be_added_says_why(run):
    code, said = run("diagnose lanes.parquet --simulations 1 --add discovered_force:time")
    assert code == 2
    assert "cannot be added here: too few samples know it, or have it in common; choose among " in said
    assert "force_along" not in said


def test_a_name_that_is_too_long(tmp_path):
    with pytest.raises(OutputError, match=r"cannot be written: File name too long; check the name"):
        sg.simulate(3, ring_m=40.0, duration_s=5.0).save(tmp_path / f"{'a' * 300}.csv")


@pytest.mark.parametrize(
    "words",
    ["calibrate ring.mcap --parameters ,", "calibrate ring.mcap --effects ,", "convert ring.csv a.csv --lane ,"],
)
def test_a_list_without_a_name_is_refused(words, run):
    assert run(words) == (2, "error: ',': has no name; give names with commas between, or leave out the option")


def test_echo_says_nothing_before_an_error(run, folder, monkeypatch, capfd):
    monkeypatch.setattr(sys, "argv", ["sugiyama", "echo", "ring.mcap", "/nosuch", "--json"])
    with pytest.raises(SystemExit):
        cli.main()
    assert capfd.readouterr().out == ""
    monkeypatch.setattr(sys, "argv", ["sugiyama", "echo", "ring.mcap", "/road", "--json"])
    with pytest.raises(SystemExit):
        cli.main()
    assert len(json.loads(capfd.readouterr().out)) == 1


def test_ctrl_c_at_the_end_of_a_command_leaves_no_traceback():
    program = (
        "import os, signal, sys\n"
        "from sugiyama_ros import cli, interrupts\n"
        "settled = interrupts.settled\n"
        "interrupts.settled = lambda: (os.kill(os.getpid(), signal.SIGINT), settled())\n"
        "sys.argv = ['sugiyama', 'laws']\n"
        "cli.main()\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ended.returncode == -signal.SIGINT
    assert "IDM" in ended.stdout
    assert ended.stderr == ""
