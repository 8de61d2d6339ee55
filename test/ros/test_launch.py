"""The launch files under launch: they end with their source or with Ctrl-C, and leave a whole bag."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
import yaml

from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.truth import read_truth

pytestmark = [pytest.mark.ros, pytest.mark.timeout(150)]
ROOT = Path(__file__).parents[2]
ALL = {"namespace": "ring", "use_sim_time": "true", "critic": "true"}
_LAUNCH = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
given = [tuple(one.split(":=", 1)) for one in sys.argv[2:]]
included = IncludeLaunchDescription(PythonLaunchDescriptionSource(sys.argv[1]), launch_arguments=given)
service = LaunchService()
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace in which this package is installed, as colcon would install it."""
    pytest.importorskip("launch_ros.actions", reason="launch and launch_ros are not installed")
    folder = tmp_path / "install"
    (folder / "lib/sugiyama_ros").mkdir(parents=True)
    for node in ("recorder", "replay", "simulator", "keeper", "critic", "drivers", "tracks"):
        start = folder / "lib/sugiyama_ros" / f"sugiyama_{node}"
        start.write_text(f"#!{sys.executable}\nfrom sugiyama_ros.nodes.executables import {node}\n{node}()\n")
        start.chmod(0o755)
    (folder / "share/sugiyama_ros").mkdir(parents=True)
    (folder / "share/sugiyama_ros/config").symlink_to(ROOT / "config")
    index = folder / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "sugiyama_ros").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{folder}:{sys.prefix}")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    return folder


def started(name: str, log: Path, **given: object) -> "subprocess.Popen[bytes]":
    arguments = [f"{key}:={value}" for key, value in given.items()]
    with log.open("wb") as said:
        return subprocess.Popen(
            [sys.executable, "-c", _LAUNCH, str(ROOT / "launch" / f"{name}.launch.py"), *arguments],
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )


def ended(child: "subprocess.Popen[bytes]", log: Path, timeout_s: float = 100.0) -> tuple[int, str]:
    """Exit code of a launch, and what it said; nothing stays behind."""
    try:
        return child.wait(timeout_s), log.read_text(errors="replace")
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)


@pytest.mark.parametrize("given", [{}, ALL], ids=["as it is", "all arguments"])
def test_the_end_of_the_replay_ends_the_launch(prefix: Path, tmp_path: Path, given: dict[str, str]) -> None:
    rows = [f"{0.5 * k},{v},{25.0 * v + 3.0 * k},4.5" for k in range(60) for v in range(2)]
    (tmp_path / "a.csv").write_text("\n".join(["time_s,vehicle,position_m,length_m", *rows]) + "\n")
    log, output = tmp_path / "said.txt", tmp_path / "out.mcap"
    child = started("replay", log, source=tmp_path / "a.csv", output=output, rate=0.0, **given)
    code, said = ended(child, log)
    assert code == 0, said
    assert "process has died" not in said
    assert len(re.findall("process has finished cleanly", said)) == (6 if given else 5)
    with Bag(output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
    space = "/ring" if given else ""
    assert [counts[f"{space}/vehicle_{v:02}/state"] for v in range(2)] == [60, 60]
    assert counts.get(f"{space}/verdict", 0) == (6 if given else 0)


def test_ctrl_c_leaves_a_whole_bag(prefix: Path, tmp_path: Path) -> None:
    """A whole number in a parameter file will do, too."""
    config = tmp_path / "config"
    config.mkdir()
    for file in (ROOT / "config").iterdir():
        document = yaml.safe_load(file.read_text())
        if file.stem in ("drivers", "simulator"):
            document["/**"]["ros__parameters"]["v_star"] = 10
        (config / file.name).write_text(yaml.safe_dump(document))
    log, output = tmp_path / "said.txt", tmp_path / "out.mcap"
    child = started("simulate", log, output=output, vehicles=2, rate=20.0, config=config)
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not any(p.stat().st_size > 50_000 for p in tmp_path.glob("out*.part")):
        time.sleep(0.2)
    os.killpg(child.pid, signal.SIGINT)
    code, said = ended(child, log)
    assert code in (0, 130), said
    assert "process has died" not in said
    assert "Traceback" not in said
    truth = read_truth(output)
    assert truth is not None
    assert {drive.parameters["v_star"] for drive in truth.drivers} == {10.0}
    with Bag(output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
    assert counts["/vehicle_00/state"] > 10


def model_file(folder: Path) -> Path:
    """A model file with one driver, as the mean of the population."""
    driver = {"parameters": dict(zip(NAMES, population().tolist(), strict=True))}
    (folder / "model.yaml").write_text(yaml.safe_dump({"sugiyama_model": 1, "drivers": {0: driver}}))
    return folder / "model.yaml"


@pytest.mark.parametrize("given", [{}, ALL], ids=["as it is", "all arguments"])
def test_a_live_launch_waits_for_vehicles_and_ends_with_ctrl_c(
    prefix: Path, tmp_path: Path, given: dict[str, str]
) -> None:
    (tmp_path / "line.csv").write_text("x,y\n0,0\n100,0\n")
    log, output = tmp_path / "said.txt", tmp_path / "out.mcap"
    given = given | ({"frame": "map", "model": model_file(tmp_path)} if given else {})
    child = started("live", log, centre_line=tmp_path / "line.csv", topics="['/car*/odom']", output=output, **given)
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not any(p.stat().st_size > 5_000 for p in tmp_path.glob("out*.part")):
        time.sleep(0.2)
    os.killpg(child.pid, signal.SIGINT)
    code, said = ended(child, log)
    assert code in (0, 130), said
    assert "process has died" not in said
    with Bag(output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
    assert counts["/ring/road" if given else "/road"] == 1
    assert counts["/diagnostics"] > 2
    if given:
        with Bag(output) as bag:
            told = {one.name for m in bag.messages(["/diagnostics"]) for one in m.message.status}
        assert "/ring/critic" in told


def test_a_wrong_value_is_one_line() -> None:
    for given, why in (("v_star:=fast", "v_star"), ("vehicles:=0", "vehicles"), ("start:=anyhow", "give jam")):
        command = [sys.executable, "-m", "sugiyama_ros.nodes.executables", "simulator", "--ros-args", "-p", given]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode == 2, done.stderr
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert why in done.stderr
