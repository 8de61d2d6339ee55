"""Nodes that are started by hand, with the executables of the wheels, as docs/ros.md says it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.nodes.executables import NODES

pytestmark = [pytest.mark.ros, pytest.mark.timeout(200)]
BIN = Path(sys.executable).parent


def started(name: str, *arguments: str) -> "subprocess.Popen[str]":
    """A node, by its executable."""
    command = [str(BIN / f"sugiyama_{name}"), "--ros-args", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def test_three_processes_record_every_sample(ring_csv: Path, tmp_path: Path) -> None:
    """A recorder, an estimator and a replay that waits for both; each says in one line what it does."""
    output = tmp_path / "run.mcap"
    recorder = started("recorder", "-p", f"output:={output}", "-p", "time_source:=data")
    estimator = started("drivers", "-p", "vehicles:=[2]", "-p", "vehicle_topics:=true")
    try:
        replay = started(
            "replay", "-p", f"source:={ring_csv}", "-p", "ring:=100.0", "-p", "rate:=0.0", "-p", "exit_at_end:=true",
            "-p", 'wait_for:=["/recorder", "/drivers"]',
        )  # fmt: skip
        said, _ = replay.communicate(timeout=120)
        assert replay.returncode == 0, said
        lines = []
        for node in (estimator, recorder):
            node.send_signal(signal.SIGINT)
            lines.append(node.communicate(timeout=60)[0])
    finally:
        for node in (recorder, estimator):
            node.kill()
            node.communicate()
    domain = os.environ["ROS_DOMAIN_ID"]
    assert f"[replay]: in ROS domain {domain}: sends 200 samples (99.5 s) of ring.csv at the fastest rate, once" in said
    assert f"in ROS domain {domain}: records all topics in {output}" in lines[1]
    assert f"in ROS domain {domain}: waiting for a road on /road" in lines[0]
    assert (recorder.returncode, estimator.returncode) == (0, 0)
    with Bag(output) as bag:
        counts = {topic.name: topic.count for topic in bag.info().topics}
        times = [time_ns for _, _, time_ns, _ in bag.raw_messages({"/measured", "/markers"})]
    topics = ("/measured", "/markers", "/clock", "/vehicle_02/state", "/vehicle_02/innovation")
    assert {topic: counts[topic] for topic in topics} == dict.fromkeys(topics, 200)
    # the times in the file are those of the recording
    assert (min(times), max(times)) == (0, 99_500_000_000)


def test_a_node_without_the_messages_says_so_in_one_line() -> None:
    code = (
        "import sys; sys.modules['sugiyama_msgs'] = None\nfrom sugiyama_ros.nodes.executables import replay\nreplay()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == ("sugiyama_msgs: not installed; run `make demo` once, or source a ROS 2 workspace\n")


def handles_signals(pid: int) -> bool:
    """Whether a program has got so far that it handles SIGTERM; before, Python itself starts."""
    (caught,) = (line.split()[1] for line in Path(f"/proc/{pid}/status").read_text().splitlines() if "SigCgt" in line)
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


def test_a_signal_while_nodes_start_ends_them(tmp_path: Path) -> None:
    """Each node on its own, at another moment of its start: no traceback, no file that is half written."""
    (tmp_path / "line.csv").write_text("x,y\n0,0\n100,0\n")
    given = {
        "recorder": ("-p", f"output:={tmp_path / 'out.mcap'}", "-p", "time_source:=data"),
        "tracks": ("-p", f"centre_line:={tmp_path / 'line.csv'}", "-p", 'topics:=["/car*/odom"]'),
    }
    ended = {}
    for k, name in enumerate(name for name in NODES if name != "replay"):
        node = started(name, *given.get(name, ()))
        while node.poll() is None and not handles_signals(node.pid):
            time.sleep(0.01)
        time.sleep(0.1 + 0.1 * k)
        node.send_signal(signal.SIGTERM)
        said, _ = node.communicate(timeout=60)
        # before the program has begun, the interpreter itself ends, with the signal
        ended[name] = node.returncode, said
    assert all(code in (0, -signal.SIGTERM) and "Traceback" not in said for code, said in ended.values()), ended
    assert [path.name for path in tmp_path.iterdir()] == ["line.csv"]


def test_ctrl_c_that_a_library_swallows_ends_a_run_all_the_same(ring_csv: Path, tmp_path: Path) -> None:
    """It comes while the command is loaded, in a block that catches everything."""
    code = (
        "import signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell in the background ignores it
        "import sugiyama_ros.cli as cli\n"
        "load = cli._run\n"
        "def swallowing():\n"
        "    try:\n"
        "        signal.raise_signal(signal.SIGINT)\n"
        "    except BaseException:\n"
        "        pass\n"
        "    return load()\n"
        "cli._run = swallowing\n"
        f"sys.argv = ['sugiyama', 'run', {str(ring_csv)!r}, '--ring', '100', '--rate', '1', '-o', 'out.mcap']\n"
        "cli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 130, done.stderr
    told = [line for line in done.stderr.splitlines() if not line.startswith("[INFO]")]
    assert told in ([], ["interrupted before the first sample; nothing was recorded"])
    assert [path.name for path in tmp_path.iterdir()] == ["ring.csv"]
