"""The recorder: what it keeps, and what is left after a crash."""

import random
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Reader
from std_msgs.msg import Header, String
from sugiyama_msgs.msg import MeasuredPositions

from sugiyama_ros.errors import InputError, OutputError
from sugiyama_ros.formats.mcap_reader import Bag, bag_files
from sugiyama_ros.formats.recover import recover
from sugiyama_ros.nodes import recorder as recorder_module
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.node import ERROR
from sugiyama_ros.nodes.base.qos import STREAM, reliable
from sugiyama_ros.nodes.recorder import Recorder
from sugiyama_ros.trajectories.placing import Positions

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]


ALWAYS = ("/diagnostics", "/rosout")


def recorder(output: Path, *paced: str) -> Recorder:
    """A recorder in this process."""
    overrides = [Parameter("output", value=str(output)), Parameter("metadata", value=["a=b=c"])]
    if paced:
        overrides.append(Parameter("paced_topics", value=list(paced)))
    return Recorder(parameter_overrides=overrides)


def holds(recording: Recorder, topic: str, messages: int) -> bool:
    """Whether the recorder has this number of messages of each topic; it records its own /diagnostics as well."""
    return recording.counts.get(topic, 0) >= messages


def test_bytes_and_quality_of_service_are_kept(stage, tmp_path: Path) -> None:
    node = Node("sender")
    best_effort = QoSProfile(depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
    plain = node.create_publisher(String, "plain", 10)
    loose = node.create_publisher(String, "loose", best_effort)
    early = node.create_publisher(String, "early", latched)
    hidden = node.create_publisher(String, "_hidden", latched)
    early.publish(String(data="sent before the recorder was there"))
    hidden.publish(String(data="not for the file"))
    recording = recorder(tmp_path / "out.mcap")
    stage.add(node, recording)
    stage.until(lambda: holds(recording, "/early", 1))
    before = time.time_ns()
    plain.publish(String(data="one"))
    loose.publish(String(data="two"))
    stage.until(lambda: holds(recording, "/plain", 1) and holds(recording, "/loose", 1))
    recording.finish()
    recording.close()
    assert recording.failure is None
    with Bag(tmp_path / "out.mcap") as bag:
        info = bag.info()
        assert info.metadata["sugiyama"]["a"] == "b=c"
        assert {t.name: (t.type, t.reliability, t.durability) for t in info.topics if t.name not in ALWAYS} == {
            "/plain": ("std_msgs/msg/String", "reliable", "volatile"),
            "/loose": ("std_msgs/msg/String", "best_effort", "volatile"),
            "/early": ("std_msgs/msg/String", "reliable", "transient_local"),
        }
        (message,) = bag.raw_messages(["/plain"])
    assert message.message == serialize_message(String(data="one"))
    assert before < message.log_time_ns < time.time_ns()


def test_a_topic_that_appears_later_is_recorded_too(stage, tmp_path: Path) -> None:
    node, recording = Node("sender"), recorder(tmp_path / "out.mcap")
    stage.add(node, recording)
    stage.for_a_while(0.1)
    publisher = node.create_publisher(String, "late", reliable(5))
    for k in range(5):
        publisher.publish(String(data=str(k)))
    stage.until(lambda: holds(recording, "/late", 5))
    recording.finish()
    recording.close()
    with Bag(tmp_path / "out.mcap") as bag:
        assert [m.message.data for m in bag.messages(["/late"])] == list("01234")


def test_a_topic_that_falls_silent_is_no_longer_waited_for(stage, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(recorder_module, "PATIENCE_S", 1.0)
    node = Node("sender")
    measured = node.create_publisher(Header, "measured", STREAM)
    state = node.create_publisher(Header, "state", STREAM)
    # These stand for measured positions: the recorder reads only their stamps and steps.
    monkeypatch.setattr(
        recorder_module.incoming, "sample", lambda raw: type("Sample", (), {"step": raw[4], "stamp_ns": 0})
    )
    recording = recorder(tmp_path / "out.mcap", "/measured", "/state")
    stage.add(node, recording)

    def send(step: int, *publishers: object) -> None:
        header = Header()
        header.stamp.sec = step
        for publisher in publishers:
            publisher.publish(header)

    for step in range(3):
        send(step, measured, state)
    stage.until(lambda: recording.steps == 3)
    for step in range(3, 6):
        send(step, measured)
    stage.until(lambda: recording.received >= 9)
    assert recording.steps == 3
    stage.until(lambda: recording.steps == 6, 5.0)
    assert recording.health().level == ERROR
    assert recording.health().message == "gave up waiting for /state"
    recording.close()


def test_an_output_that_cannot_be_written_is_one_line(stage, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        recorder(tmp_path / "missing" / "out.mcap")
    with pytest.raises(InputError, match="recorder: no file given"):
        Recorder()
    with pytest.raises(InputError, match="recorder: metadata 'run' is no line key=value"):
        Recorder(parameter_overrides=[Parameter("output", value="out.mcap"), Parameter("metadata", value=["run"])])


def started_recorder(output: Path) -> subprocess.Popen[bytes]:
    """A recorder in a process of its own."""
    node = [sys.executable, "-m", "sugiyama_ros.nodes.executables", "recorder"]
    return subprocess.Popen([*node, "--ros-args", "-p", f"output:={output}"])


def test_kill_loses_at_most_a_second(stage, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    node = Node("sender")
    publisher = node.create_publisher(Header, "beat", STREAM)
    stage.add(node)
    child = started_recorder(output)
    sent: list[tuple[int, float]] = []

    def send() -> bool:
        header = Header()
        header.stamp.sec = len(sent)
        publisher.publish(header)
        sent.append((len(sent), time.monotonic()))
        time.sleep(0.01)
        return publisher.get_subscription_count() > 0 and sent[-1][1] > heard_s + 3.0

    try:
        heard_s = float("inf")
        stage.until(lambda: publisher.get_subscription_count() > 0)
        heard_s = time.monotonic()
        stage.until(send)
    finally:
        child.send_signal(signal.SIGKILL)
        killed_s = time.monotonic()
        child.wait()
    assert not output.exists()
    (part,) = output.parent.glob("out.mcap.*.part")
    recovered = recover(part, output)
    assert recovered.messages > 0
    with Bag(output) as bag:
        kept = [m.message.stamp.sec for m in bag.messages(["/beat"])]
    assert kept == list(range(kept[0], kept[0] + len(kept)))
    last_kept_s = dict(sent)[kept[-1]]
    # One second between two flushes, and the time to receive, to write and to be killed.
    assert killed_s - last_kept_s < 1.3


def test_a_signal_leaves_a_closed_file(stage, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    node = Node("sender")
    publisher = node.create_publisher(String, "plain", STREAM)
    stage.add(node)
    child = started_recorder(output)
    try:
        stage.until(lambda: publisher.get_subscription_count() > 0)
        for k in range(100):
            publisher.publish(String(data=str(k)))
        stage.for_a_while(0.5)
        child.send_signal(signal.SIGTERM)
        assert child.wait(15) == 0
    finally:
        child.kill()
        child.wait()
    with Bag(output) as bag:
        assert [m.message.data for m in bag.messages(["/plain"])] == [str(k) for k in range(100)]


def test_a_directory_of_rosbag2_in_the_time_of_the_data(stage, tmp_path: Path) -> None:
    """Files of a bounded size that readers take for one bag; a message has its stamp, or that of the last sample."""
    node, given = Node("sender"), {"time_source": "data", "split_mb": 0.5, "output": str(tmp_path / "run")}
    recording = Recorder(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
    measured = node.create_publisher(MeasuredPositions, "measured", STREAM)
    stamped = node.create_publisher(Header, "h", 10)
    plain = node.create_publisher(String, "plain", 100)
    stage.add(node, recording)
    stage.until(lambda: all(p.get_subscription_count() for p in (measured, stamped, plain)))
    plain.publish(String(data="before the first sample"))
    stage.until(lambda: recording.received >= 1)
    for k in range(40):
        positions = Positions([0], [-1], [float(k)], [4.0])
        measured.publish(cdr_messages.measured_positions((100 + k) * cdr_messages.NS, k, positions))
        stage.until(partial(holds, recording, "/measured", k + 1))
        plain.publish(String(data=f"{k} " + random.Random(k).randbytes(20_000).hex()))
        stage.until(partial(holds, recording, "/plain", k + 2))
    near, far = Header(), Header()
    near.stamp.sec, far.stamp.sec = 138, 5
    for header in (near, far):
        stamped.publish(header)
    node.get_logger().info("it is recorded, too")
    stage.until(lambda: holds(recording, "/h", 2) and holds(recording, "/rosout", 1))
    recording.finish()
    recording.close()
    assert recording.failure is None
    files = bag_files(tmp_path / "run")
    assert len(files) > 1
    assert all(file.stat().st_size < 1_500_000 for file in files)
    with Reader(tmp_path / "run") as bag:
        times = {topic: [t for c, t, _ in bag.messages() if c.topic == topic] for topic in recording.counts}
        assert bag.message_count == sum(recording.counts.values())
    assert times["/measured"] == [(100 + k) * cdr_messages.NS for k in range(40)]
    assert sorted(times["/plain"])[0] == 100 * cdr_messages.NS
    assert sorted(times["/plain"])[-1] == 139 * cdr_messages.NS
    assert sorted(times["/h"]) == [138 * cdr_messages.NS, 139 * cdr_messages.NS]  # the other stamp is of another clock
