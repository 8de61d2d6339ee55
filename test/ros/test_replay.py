"""The replay: pacing, pause, step, seek, loop."""

import time
from pathlib import Path

import pytest
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import MeasuredPositions, Road
from sugiyama_msgs.srv import Seek

from sugiyama_ros.nodes import source
from sugiyama_ros.nodes.base.node import ERROR, OK, Health, PacedNode
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM, WINDOW, offered
from sugiyama_ros.nodes.recorder import Recorder
from sugiyama_ros.nodes.replay import Replay
from sugiyama_ros.nodes.simulator import SimulatorNode

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]


class Listener(PacedNode):
    """A slow subscriber: it waits at every sample."""

    def __init__(self, name: str = "listener", slow_s: float = 0.0) -> None:
        super().__init__(name)
        self.samples: list[MeasuredPositions] = []
        self.roads: list[Road] = []
        self.slow_s = slow_s
        self.create_subscription(MeasuredPositions, "measured", self._on_measured, STREAM)
        self.create_subscription(Road, "road", self.roads.append, LATCHED)
        self.announce()

    @property
    def step_numbers(self) -> list[int]:
        """Numbers of the steps that arrived."""
        return [sample.step for sample in self.samples]

    def health(self) -> Health:
        """Always well."""
        return Health(OK, "listening")

    def _on_measured(self, sample: MeasuredPositions) -> None:
        time.sleep(self.slow_s)
        self.samples.append(sample)
        self.taken(sample.step + 1)


def replay(path: Path, **parameters: object) -> Replay:
    """A replay of a ring of 100 m."""
    parameters = {"source": str(path), "ring": 100.0, "rate": 0.0, "wait_for": ["/listener"]} | parameters
    return Replay(parameter_overrides=[Parameter(k, value=v) for k, v in parameters.items()])


def test_everything_arrives_in_order(stage, ring_csv: Path) -> None:
    listener, node = Listener(), replay(ring_csv)
    stage.add(node, listener)
    stage.until(lambda: len(listener.samples) == 200)
    assert listener.step_numbers == list(range(200))
    (road,) = listener.roads
    assert (road.circumference_m, road.period_s, road.steps, road.source) == (100.0, 0.5, 200, "ring.csv")
    sample = listener.samples[3]
    assert sample.vehicle.tolist() == [0, 1, 2, 3]
    assert sample.leader.tolist() == [1, 2, 3, 0]
    assert sample.length_m.tolist() == [4.5] * 4
    assert (sample.header.stamp.sec, sample.header.stamp.nanosec, sample.header.frame_id) == (1, 500_000_000, "road")


def test_the_source_stays_within_the_window_of_a_slow_subscriber(stage, ring_csv: Path) -> None:
    slow, fast, node = Listener(slow_s=0.005), Listener("fast"), replay(ring_csv, wait_for=["/listener", "/fast"])
    ahead: list[int] = []
    stage.add(node, slow, fast)

    def done() -> bool:
        ahead.append(node.next_step - len(slow.samples))
        return len(slow.samples) == len(fast.samples) == 200

    stage.until(done)
    assert slow.step_numbers == fast.step_numbers == list(range(200))
    assert WINDOW // 2 < max(ahead) <= WINDOW


def test_a_silent_subscriber_is_dropped(stage, ring_csv: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "PATIENCE_S", 2.0)  # a node that is well tells how far it is at least once a second
    listener, silent = Listener(), Listener("silent")
    node = replay(ring_csv, wait_for=["/listener", "/silent"])
    stage.add(node, listener)  # the silent subscriber has announced itself, but is never executed
    stage.until(lambda: len(listener.samples) == 200)
    assert node.health().level == ERROR
    assert "/silent" in node.health().message
    silent.destroy_node()


def test_pause_step_resume(stage, ring_csv: Path) -> None:
    listener, node = Listener(), replay(ring_csv, start_paused=True)
    stage.add(node, listener)
    stage.for_a_while(0.3)
    assert listener.samples == []
    for _ in range(3):
        assert stage.call(Trigger, "/replay/step", Trigger.Request()).success
    stage.until(lambda: len(listener.samples) == 3)
    node.set_parameters([Parameter("rate", value=20.0)])
    assert stage.call(Trigger, "/replay/resume", Trigger.Request()).success
    answer = stage.call(Trigger, "/replay/step", Trigger.Request())
    assert (answer.success, answer.message) == (False, "not paused: call ~/pause first")
    stage.until(lambda: len(listener.samples) > 10)
    assert stage.call(Trigger, "/replay/pause", Trigger.Request()).success
    stage.for_a_while(0.2)
    there = len(listener.samples)
    stage.for_a_while(0.2)
    assert len(listener.samples) == there < 200
    assert listener.step_numbers == list(range(there))


def test_seek(stage, ring_csv: Path) -> None:
    listener, node = Listener(), replay(ring_csv)
    stage.add(node, listener)
    stage.until(lambda: len(listener.samples) == 200)
    assert stage.call(Seek, "/replay/seek", Seek.Request(time_s=90.0)).success
    stage.until(lambda: len(listener.samples) == 220)
    assert listener.step_numbers[200:] == list(range(180, 200))
    answer = stage.call(Seek, "/replay/seek", Seek.Request(time_s=99.6))
    assert (answer.success, answer.message) == (False, "99.6 s is not within the recording, 0 to 99.5 s")


def test_the_rate_is_kept(stage, ring_csv: Path) -> None:
    listener, node = Listener(), replay(ring_csv, rate=20.0)
    stage.add(node, listener)
    stage.until(lambda: len(listener.samples) >= 1)
    start, first = time.monotonic(), len(listener.samples)
    stage.until(lambda: len(listener.samples) >= first + 40)
    # No step is early. A busy machine delays the end, but by less than the 20 s of the recording's own time.
    assert 40 * 0.5 / 20.0 - 0.02 < time.monotonic() - start < 15.0


def test_a_simulator_is_a_source_without_an_end(stage) -> None:
    listener = Listener()
    overrides = {"rate": 0.0, "wait_for": ["/listener"], "vehicles": 5, "ring": 60.0}
    node = SimulatorNode(parameter_overrides=[Parameter(k, value=v) for k, v in overrides.items()])
    stage.add(node, listener)
    stage.until(lambda: len(listener.samples) > 300)
    assert listener.step_numbers == list(range(len(listener.samples)))
    assert listener.roads[0].steps == 0
    assert listener.samples[300].leader.tolist() == [1, 2, 3, 4, 0]


class Named(Listener):
    """A listener that publishes something, too, and says so."""

    def __init__(self) -> None:
        super().__init__()
        self.stream(Road, "answer")


def test_nothing_is_sent_before_the_recorder_hears_everything(stage, ring_csv: Path, tmp_path: Path) -> None:
    node, listener = replay(ring_csv, wait_for=["/listener", "/recorder"]), Named()
    stage.add(node, listener)
    stage.until(lambda: "/listener" in node.health().message)
    assert (node.next_step, node.is_recorded, listener.is_recorded) == (0, False, False)
    stage.suspend()
    recorder = Recorder(parameter_overrides=[Parameter("output", value=str(tmp_path / "out.mcap"))])
    stage.add(recorder)
    stage.until(lambda: recorder.counts.get("/measured") == 200)
    assert node.is_recorded
    assert listener.is_recorded
    recorder.close()


def test_who_subscribes_late_hears_nothing_old(stage, ring_csv: Path) -> None:
    """As ``ros2 topic echo`` does, which asks for what the publishers offer."""
    node, listener = replay(ring_csv), Listener()
    stage.add(node, listener)
    stage.until(lambda: len(listener.samples) == 200)
    heard: list[int] = []
    late = offered(listener.get_publishers_info_by_topic("/measured"))
    listener.create_subscription(MeasuredPositions, "/measured", lambda sample: heard.append(sample.step), late)
    assert stage.call(Seek, "/replay/seek", Seek.Request(time_s=50.0)).success
    stage.until(lambda: len(heard) > 50)
    assert heard[0] == 100
