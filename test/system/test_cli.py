"""The command line as a user sees it: an error is one line and exit code 2, a result is one document."""

import json
import os
import re
import struct
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from sugiyama_ros import cli

pytestmark = pytest.mark.system
GOOD = "time_s,vehicle,position_m\n" + "".join(f"{0.5 * t},{v},{20 * v + 4 * t}\n" for t in range(40) for v in range(3))


@pytest.fixture
def sugiyama(monkeypatch, capfd):
    """Run a command in this process: exit code, stdout, stderr."""

    # a run chooses a ROS domain for its process; the next run chooses anew
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["sugiyama", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        out, err = capfd.readouterr()
        return end.value.code or 0, out, err

    return run


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.csv").write_text(GOOD)
    return tmp_path


def one_line(result, *words):
    """The command was refused with one line, which contains the words."""
    code, out, err = result
    assert code == 2
    assert out == ""
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert all(word in err for word in words), err


LOADED = """
import sys
from sugiyama_ros import cli
try:
    cli.main()
except SystemExit as end:
    assert not end.code, end.code
loaded = {name.partition(".")[0] for name in sys.modules}
assert not loaded & {"numba", "scipy", "filterpy", "rclpy", "bokeh"}, loaded
"""


@pytest.mark.parametrize("arguments", [["calibrate", "--help"], ["info", "good.mcap"], ["echo", "good.mcap", "/road"]])
def test_short_commands_load_no_compiled_code(sugiyama, here, arguments):
    assert sugiyama("convert", "good.csv", "good.mcap")[0] == 0
    done = subprocess.run([sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("command", ["convert", "run"])
def test_bad_csv(sugiyama, here, command):
    (here / "bad.csv").write_text("time_s,vehicle,position_m\n0,1,2\nnan,1,3\n")
    output = ["out.mcap"] if command == "convert" else ["-o", "out.mcap"]
    one_line(sugiyama(command, "bad.csv", *output), "bad.csv", "two samples")
    assert sorted(p.name for p in here.iterdir()) == ["bad.csv", "good.csv"]


def bad_bag(kind, good):
    if kind == "random":
        return good[:8] + np.random.default_rng(0).bytes(5000)
    if kind == "cut":
        return good[: len(good) * 7 // 10]
    # a chunk record that claims a gigabyte of content, in a kilobyte
    body = struct.pack("<QQQI", 0, 1, 1 << 30, 0) + struct.pack("<I4sQ", 4, b"zstd", 900) + b"\0" * 900
    header = bytes([1]) + struct.pack("<Q", 8) + bytes(8)
    return good[:8] + header + bytes([6]) + struct.pack("<Q", len(body)) + body + good[:8]


@pytest.mark.parametrize("kind", ["random", "cut", "gigabyte"])
@pytest.mark.parametrize("command", ["info", "echo", "convert", "run", "recover"])
def test_bad_bags(sugiyama, here, kind, command):
    assert sugiyama("convert", "good.csv", "good.mcap")[0] == 0
    good = (here / "good.mcap").read_bytes()
    (here / "good.mcap").unlink()
    (here / "bad.mcap").write_bytes(bad_bag(kind, good))
    more = {"echo": ["/measured"], "convert": ["out.mcap"], "run": ["-o", "out.mcap"]}.get(command, [])
    result = sugiyama(command, "bad.mcap", *more)
    if (kind, command) in {("cut", "recover"), ("cut", "info")}:
        # the intact part of a cut file can be described and saved
        assert result[0] in (0, 2)
    else:
        one_line(result, "bad.mcap")
    assert not (here / "out.mcap").exists()
    assert not list(here.glob("*.part"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("convert", "missing.csv", "out.mcap"), ("missing.csv",)),
        (("convert", "/dev/null", "out.mcap"), ("/dev/null",)),
        (("convert", "good.csv", "nowhere/out.mcap"), ("nowhere",)),
        (("convert", "good.csv", "good.csv/out.mcap"), ("good.csv",)),
        (("convert", "good.csv", "out.mcap", "--ring", "-5"), ("ring", "-5")),
        (("convert", "good.csv", "out.mcap", "--ring", "nan"), ("ring", "nan")),
        (("run", "good.csv", "-o", "nowhere/out.mcap"), ("nowhere",)),
        (("run", "good.csv", "-o", "out.mcap", "--rate", "0"), ("--rate 0", "max")),
        (("run", "good.csv", "-o", "out.mcap", "--rate", "fast"), ("--rate fast",)),
        (("simulate", "-o", "out.txt"), ("out.txt", ".csv")),
        (("simulate", "-o", "out.csv", "--set", "v_star"), ("--set: v_star", "NAME=VALUE")),
        (("simulate", "-o", "out.csv", "--effect", "drag"), ("--effect drag", "drag has c0 (", "m/s^2")),
        (("simulate", "-o", "out.csv", "--set", "speed=3"), ("speed", "v_star")),
        (("simulate", "-o", "out.csv", "--set", "v_star=-3"), ("v_star is -3", "0.5 to 80 m/s")),
        (("simulate", "-o", "out.csv", "--set", "v_star=nan"), ("v_star is nan", "0.5 to 80 m/s")),
        (("simulate", "-o", "out.csv", "--ring", "50"), ("ring of 50 m", "22 vehicles")),
        (("simulate", "-o", "nowhere/out.csv"), ("nowhere",)),
        (("simulate", "-o", "out.parquet", "--scene", "bridge"), ("bridge", "roundabout")),
        (("simulate", "-o", "out.parquet", "--scene", "merge", "--lanes", "2"), ("--lanes", "--scene")),
        (("demo", "--scene", "merge"), ("--scene merge", "roundabout")),
        (("demo", "--scene", "signals", "--hidden", "drag"), ("--hidden drag", "late_start")),
        (("live", "good.csv", "--host", ""), ("--host", "leave it out")),
        (("simulate", "-o", "out.csv", "--lanes", "2", "--view", "9,0"), ("--view 9,0", "100,500")),
        (("fetch", "sugiyama1999"), ("sugiyama1999", "sugiyama2008")),
        (("info", "missing.mcap"), ("missing.mcap",)),
        (("info", "missing.csv"), ("missing.csv",)),
        (("recover", "missing.mcap"), ("missing.mcap",)),
        (("recover", "good.csv", "-o", "good.csv"), ("good.csv",)),
    ],
)
def test_bad_arguments(sugiyama, here, arguments, words):
    one_line(sugiyama(*arguments), *words)
    assert (here / "good.csv").read_text() == GOOD
    assert sorted(p.name for p in here.iterdir()) == ["good.csv"]


def test_a_refused_output_leaves_what_was_there(sugiyama, here):
    (here / "out.mcap").write_bytes(b"mine")
    (here / "bad.csv").write_text("time_s,vehicle,position_m\n0,1,2\nnan,1,3\n")
    one_line(sugiyama("convert", "bad.csv", "out.mcap"))
    assert (here / "out.mcap").read_bytes() == b"mine"


def test_a_full_disk_is_one_line(sugiyama, here):
    """The file system has 64 kB. The test is skipped where mounting is not allowed."""
    small = here / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", small], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("not allowed to mount a small file system")
    try:
        assert sugiyama("simulate", "-o", "large.csv", "--duration", "600")[0] == 0
        one_line(sugiyama("convert", "large.csv", "small/out.mcap", "--ring", "230"), "out.mcap", "space")
        one_line(sugiyama("simulate", "-o", "small/out.csv", "--duration", "600"), "out.csv", "space")
        assert list(small.iterdir()) == []
    finally:
        subprocess.run(["umount", small], check=True)


def test_every_json_is_one_document(sugiyama, here):
    commands = [
        ("simulate", "-o", "sim.mcap", "--vehicles", "4", "--ring", "60", "--duration", "30", "--json"),
        ("convert", "good.csv", "good.mcap", "--json"),
        ("info", "good.mcap", "--json"),
        ("echo", "good.mcap", "/measured", "--json"),
        ("echo", "good.mcap", "/road", "--json"),
        ("recover", "good.mcap", "-o", "again.mcap", "--json"),
        ("run", "sim.mcap", "-o", "run.mcap", "--json"),
        ("echo", "run.mcap", "/vehicle_03/parameters", "--json"),
        ("echo", "run.mcap", "/diagnostics", "--json"),
        ("echo", "run.mcap", "/markers", "--json"),
    ]
    documents = {}
    for command in commands:
        code, out, err = sugiyama(*command)
        assert (code, err) == (0, ""), command
        documents[command[:3]] = json.loads(out, parse_constant=pytest.fail)
    run = documents["run", "sim.mcap", "-o"]
    assert {"steps", "vehicles", "messages_published", "messages_recorded", "messages_lost", "wall_s"} <= set(run)
    assert {"real_time_factor", "output", "drivers"} <= set(run)
    keys = {"vehicle", "name", "follows", "law", "v_star", "kappa_v", "sigma_nu", "sigma_a", "identified"}
    assert [set(d) for d in run["drivers"]] == [keys | {"one_step_rmse_m", "nis_mean"}] * 4
    assert (run["steps"], run["vehicles"], run["messages_lost"]) == (91, 4, 0)
    assert len(documents["echo", "good.mcap", "/measured"]) == 40


COMMANDS = (
    *(
        "demo",
        "run",
        "simulate",
        "calibrate",
        "diagnose",
        "study",
        "compare",
        "effects",
        "laws",
        "controllers",
        "report",
    ),
    *("live", "convert", "fetch", "info", "echo", "recover"),
)


def test_the_version_is_the_packages(sugiyama):
    assert sugiyama("--version") == (0, f"sugiyama {version('sugiyama_ros')}\n", "")


def test_help_describes_every_command_in_a_full_sentence(sugiyama):
    code, out, err = sugiyama("--help")
    assert (code, err) == (0, "")
    told = out.split("Commands:\n")[1].splitlines()
    assert tuple(line.split()[0] for line in told) == COMMANDS
    assert all(line.endswith(".") and not line.endswith("...") for line in told)


def test_effects_and_laws_are_listed_with_units(sugiyama):
    code, out, err = sugiyama("effects")
    assert (code, err) == (0, "")
    assert "slower stretch of road (slow_patch)" in out
    assert "    delay [s]: reaction time; 0 to 2" in out
    assert all(len(line) < 200 for line in out.splitlines())
    (idm,) = json.loads(sugiyama("laws", "idm", "--json")[1])
    assert {p["name"]: p["unit"] for p in idm["parameters"]}["v0"] == "m/s"
    one_line(sugiyama("effects", "magic"), "magic")


def test_a_collision_is_reported(sugiyama, here):
    command = ("simulate", "-o", "a.csv", "--duration", "900", "--set", "sigma_a=1.2")
    code, out, _ = sugiyama(*command, "--json")
    (collision,) = json.loads(out)["collisions"]
    assert code == 0
    code, _, err = sugiyama(*command, "--overwrite")
    where = f"vehicle {collision['vehicle']} into {collision['leader']} at {collision['time_s']:.1f} s"
    assert (code, err) == (0, f"collision: {where}; the run ends there\n")


def test_a_scene_that_ends_with_collisions_says_so(sugiyama, here):
    command = ("simulate", "-o", "a.parquet", "--scene", "roundabout", "--vehicles", "10")
    command += ("--effect", "ignored_yield:share=1")
    code, out, _ = sugiyama(*command, "--json")
    told = json.loads(out)
    assert code == 0
    assert told["duration_s"] < 250.0
    code, _, err = sugiyama(*command, "--overwrite")
    *collisions, last = err.splitlines()
    assert (code, len(collisions)) == (0, len(told["collisions"]))
    assert last == (
        f"the run ends at {told['duration_s']:.1f} s, when nobody is left: {told['came_through']} of 10 came through;"
        " take another --seed, or other drivers"
    )


def test_output_that_nobody_reads_is_no_error(here):
    subprocess.run(
        [sys.executable, "-m", "sugiyama_ros.cli", "simulate", "-o", "a.mcap"], check=True, capture_output=True
    )
    piped = f"{sys.executable} -m sugiyama_ros.cli echo a.mcap /measured | head -1"
    told = subprocess.run(["bash", "-c", piped], capture_output=True, text=True, check=False)
    assert told.stdout.startswith("# 0")
    assert told.stderr == ""


def test_licence_is_asked_for(sugiyama, here, monkeypatch):
    monkeypatch.setattr(os, "isatty", lambda _: False)
    code, out, err = sugiyama("fetch", "sugiyama2008")
    assert (code, out) == (2, "")
    assert "non-commercial" in err
    assert err.splitlines()[-1].startswith("error: sugiyama2008: its terms were not accepted")
    assert sorted(p.name for p in here.iterdir()) == ["good.csv"]


def test_progress_is_for_terminals_only(here):
    command = [sys.executable, "-m", "sugiyama_ros.cli", "run", "good.csv", "-o", "out.mcap"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (told.returncode, told.stderr) == (0, "")
    assert "\x1b" not in told.stdout
    assert Path("out.mcap").exists()


@pytest.mark.parametrize("made", ["short.mcap", "short.csv", "short.parquet"])
def test_who_simulates_and_is_refused_reads_the_name_of_the_file(sugiyama, here, made):
    arguments = ["--lanes", 1] if made.endswith(".parquet") else ["--ring", 45]
    assert sugiyama("simulate", "--vehicles", 4, *arguments, "--duration", 2, "-o", made)[0] == 0
    ring = ["--ring", 45] if made.endswith(".csv") else []
    for command in ("diagnose", "compare"):
        one_line(sugiyama(command, made, *ring), f"error: {made}", "; give at least 8 s")
    # and a replay of the file
    assert sugiyama("run", made, *ring, "-o", "run.mcap")[0] == 0
    one_line(sugiyama("diagnose", "run.mcap"), f"error: {made}", "; give at least 8 s")


WAITED = """
import sys
from sugiyama_ros import cli, progress
progress._LINES_EVERY_S = 0.05
sys.argv[0] = "sugiyama"
cli.main()
"""


@pytest.mark.parametrize(
    ("said", "arguments"),
    [
        (r"simulating; 0 min", ["simulate", "-o", "a.csv", "--json"]),
        (r"calibrating(, \d of 4)?; 0 min", ["calibrate", "ring.csv", "--ring", "45", "--json"]),
        (r"fitting the base model, 0 of \d+; 0 min", ["compare", "ring.csv", "--ring", "45", "--json"]),
        (r"round 1: scoring; 0 min", ["diagnose", "ring.csv", "--ring", "45", "--simulations", "1", "--json"]),
        (r"study beta-nash; 0 min", ["study", "beta-nash", "--runs", "1", "--json"]),
    ],
    ids=["simulate", "calibrate", "compare", "diagnose", "study"],
)
def test_who_waits_for_long_work_in_a_pipe_is_told_and_the_document_stays_whole(sugiyama, here, said, arguments):
    assert sugiyama("simulate", "--vehicles", 4, "--ring", 45, "--duration", 40, "-o", "ring.csv")[0] == 0
    done = subprocess.run([sys.executable, "-c", WAITED, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert isinstance(json.loads(done.stdout), dict)
    assert any(re.fullmatch(said, line) for line in done.stderr.splitlines()), done.stderr


def test_where_nothing_can_be_written_the_cure_is_said(here) -> None:
    """Neither the installation nor the home directory can keep compiled code."""
    code = "from numba.core import caching\ncaching.CacheImpl._locator_classes = []\n"
    code += "from sugiyama_ros.cli import main\nmain()"
    command = [sys.executable, "-c", code, "simulate", "-o", "a.csv"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2
    assert len([line for line in done.stderr.splitlines() if not line.startswith("[INFO]")]) == 1
    assert "set NUMBA_CACHE_DIR to a directory that can be written" in done.stderr
