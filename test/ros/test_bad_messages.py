"""Whatever other nodes send: no node ends, nothing becomes NaN, and /diagnostics tells what was dropped."""

import json
import math
import time
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from one_driver import OneDriver
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sugiyama_msgs.msg import DriverParameters, Innovation, MeasuredPositions, Progress, VehicleState, Verdict
from sugiyama_msgs.msg import Road as RoadMessage
from sugiyama_msgs.srv import AddEffect

from sugiyama_ros.errors import InputError
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.nodes.base import cdr_messages, incoming
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.base.spin import ros
from sugiyama_ros.nodes.critic import Critic
from sugiyama_ros.nodes.keeper import read_learnt
from sugiyama_ros.nodes.recorder import Recorder
from sugiyama_ros.trajectories.placing import Positions

pytestmark = [pytest.mark.ros, pytest.mark.timeout(90)]
PERIOD_S, RING_M = 0.5, 100.0


def road_of(period_s: float = PERIOD_S, ring_m: float = RING_M, steps: int = 1000) -> bytes:
    message = RoadMessage(period_s=period_s, circumference_m=ring_m, steps=steps, source="a", sha256="b")
    return bytes(serialize_message(message))


def sample_of(step: int, vehicles: list[int] | None = None, leaders: int = 3) -> bytes:
    """Three vehicles on the ring. The lists may be made uneven."""
    positions = [(30.0 * v + 2.0 * (step % 1000)) % RING_M for v in range(3)]
    given = Positions(vehicles or [0, 1, 2], [1, 2, 0], positions, [4.5] * 3)
    if leaders == 3:
        return bytes(serialize_message(cdr_messages.measured_positions(step % 1000 * 500_000_000, step, given)))
    message = MeasuredPositions(step=step, vehicle=given.vehicle, leader=given.leader[:leaders])
    message.position_m, message.length_m = array("d", positions), array("d", given.length_m)
    return bytes(serialize_message(message))


def optional(**fields: list[Any]) -> bytes:
    """A sample with optional fields."""
    given = Positions([0, 1, 2], [1, 2, 0], [0.0, 30.0, 60.0], [4.5] * 3, **fields)
    return bytes(serialize_message(cdr_messages.measured_positions(0, 0, given)))


GOOD = sample_of(0)
BAD_ROADS = {
    "zeros": road_of(0.0, 0.0, 0),
    "no period": road_of(period_s=math.nan),
    "period below 0": road_of(period_s=-0.5),
    "endless period": road_of(period_s=math.inf),
    "tiny period": road_of(period_s=1e-12),
    "no ring": road_of(ring_m=math.nan),
    "ring below 0": road_of(ring_m=-230.0),
    "steps": road_of(steps=2**64 - 1),
    "truncated": road_of()[:30],
    "nothing": road_of()[:4],
    "big endian": b"\0\0" + road_of()[2:],
    "xcdr2": b"\0\7" + road_of()[2:],
}
BAD_SAMPLES = {
    "step": sample_of(2**64 - 1),
    "truncated": GOOD[:-60],
    "short": GOOD[:6],
    "big endian": b"\0\0" + GOOD[2:],
    "xcdr2": b"\0\7" + GOOD[2:],
    "count": GOOD[:32] + b"\xff\xff\xff\x7f" + GOOD[36:],
    "vehicle below 0": sample_of(5, [-1, 1, 2]),
    "a vehicle twice": sample_of(5, [1, 1, 2]),
    "uneven": sample_of(5, leaders=2),
    "uneven lanes": optional(lane=[1]),
    "uneven variances": optional(position_var=[1.0] * 4),
    "uneven shifts": optional(leader_shift_m=[1.0]),
    "lines without times": optional(line_m=[80.0] * 3, arrive_s=[0.0] * 3),
    "a stamp that is no number": optional(stamp_offset_s=[0.0, math.nan, 0.0]),
    "a stamp far away": optional(stamp_offset_s=[0.0, 0.0, 1e9]),
}


@pytest.mark.parametrize("what", BAD_ROADS)
def test_bad_roads_are_refused(what: str) -> None:
    with pytest.raises(incoming.RefusedError, match=r"\w"):
        incoming.road(BAD_ROADS[what])
    assert incoming.road(road_of()).period_s == PERIOD_S
    assert incoming.road(road_of(ring_m=0.0)).circumference_m == 0.0


@pytest.mark.parametrize("what", BAD_SAMPLES)
def test_bad_samples_are_refused(what: str) -> None:
    with pytest.raises(incoming.RefusedError, match=r"\w"):
        incoming.sample(BAD_SAMPLES[what])
    assert incoming.sample(GOOD).place == {0: 0, 1: 1, 2: 2}


def test_random_bytes_never_raise_anything_else() -> None:
    """3,000 mutations of each kind of message; what is accepted is valid."""
    rng = np.random.default_rng(0)
    parameters = DriverParameters(name=["v_star"], value=[8.0], covariance=[1.0], estimated=[True], identified=[True])
    verdict = Verdict(model=["base"], weight=[1.0], log_likelihood=[0.0], strength=[0.0])
    kinds = {
        incoming.road: road_of(),
        incoming.sample: GOOD,
        incoming.decoder(Progress): bytes(serialize_message(Progress(node="/a", steps=1))),
        incoming.parameters: bytes(serialize_message(parameters)),
        incoming.verdict: bytes(serialize_message(verdict)),
        incoming.decoder(VehicleState): GOOD,
        incoming.decoder(Innovation): GOOD,
    }
    refused = 0
    for decode, good in kinds.items():
        for _ in range(3000):
            raw = bytearray(good[: rng.integers(len(good) + 1)] if rng.random() < 0.3 else good)
            for at in rng.integers(max(len(raw), 1), size=rng.integers(1, 4)):
                raw[at : at + 1] = rng.bytes(1)
            try:
                found: Any = decode(bytes(raw))
            except incoming.RefusedError:
                refused += 1
                continue
            if decode is incoming.sample:
                assert sorted(found.place.values()) == list(range(len(found.position_m)))
    assert refused > 3000


def test_nodes_go_on_after_bad_messages(stage: Any, tmp_path: Path) -> None:
    talker = Node("talker")
    road = talker.create_publisher(RoadMessage, "/road", LATCHED)
    measured = talker.create_publisher(MeasuredPositions, "/measured", STREAM)
    told: dict[str, Any] = {}
    states: list[VehicleState] = []
    talker.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: told.update({m.status[0].name: m.status[0]}), STREAM
    )
    talker.create_subscription(VehicleState, "/vehicle_00/state", states.append, STREAM)
    estimator, critic = OneDriver(0), Critic()
    recorder = Recorder(parameter_overrides=[Parameter("output", value=str(tmp_path / "a.mcap"))])
    nodes = (estimator, critic, recorder)
    stage.add(talker, *nodes)
    stage.until(lambda: road.get_subscription_count() >= 3 and measured.get_subscription_count() >= 3)
    for number, raw in enumerate(BAD_ROADS.values(), start=1):
        road.publish(raw)
        stage.until(lambda number=number: estimator.refused >= number and critic.refused >= number)
    road.publish(road_of())
    stage.until(lambda: estimator.follower is not None)
    for step in range(20):
        measured.publish(sample_of(step))
    stage.until(lambda: len(states) == 20)
    before = {node: node.refused for node in nodes}
    for raw in BAD_SAMPLES.values():
        measured.publish(raw)
    stage.until(lambda: all(node.refused == before[node] + len(BAD_SAMPLES) for node in nodes))
    for step in range(20, 30):
        measured.publish(sample_of(step))
    stage.until(lambda: len(states) == 30 and recorder.steps == 30)
    # one position says nothing about the speed
    assert [math.isfinite(state.speed) for state in states] == [False] + [True] * 29
    stage.until(lambda: all("refused messages" in str(told.get(f"{n.get_fully_qualified_name()}")) for n in nodes))
    recorder.close()
    received = recorder.received
    measured.publish(sample_of(31))  # a publisher that goes on is not an error
    stage.for_a_while(0.3)
    assert (recorder.received, recorder.failure) == (received, None)
    with Bag(tmp_path / "a.mcap") as bag:
        assert bag.info().messages >= 30


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "abc", "no domain; give a number from 0 to 232"),
        ("ROS_DOMAIN_ID", "500", "no domain"),
        ("ROS_SECURITY_ENABLE", "true", "ROS does not start: .*SECURITY"),
    ],
)
def test_an_environment_in_which_ros_cannot_start(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, words: str
) -> None:
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", "/nowhere")
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=words), ros():
        pass


def test_a_filter_that_diverges_starts_anew_and_tells(stage: Any) -> None:
    """With a drag below 0, the speed grows faster than exponentially."""
    estimator = OneDriver(0)
    stage.add(estimator)
    estimator._on_road(incoming.road(road_of()))
    request = AddEffect.Request(effect="drag", name=["c0", "c2"], value=[-2.0, -0.1])
    assert stage.call(AddEffect, "/drivers/add_effect", request).success
    for step in range(40):
        estimator._take_in(incoming.sample(sample_of(step)))
        assert estimator.follower is not None
        assert np.isfinite(estimator.follower.filter.learnt.mean).all()
    assert estimator.health().level == DiagnosticStatus.ERROR
    assert "diverged" in estimator.health().message
    assert estimator.steps == 40


@pytest.mark.parametrize(("name", "value"), [("sigma_nu", 0.0), ("sigma_a", 0.0), ("v_star", math.nan)])
def test_parameters_with_which_no_filter_can_run_are_refused(stage: Any, name: str, value: float) -> None:
    estimator = OneDriver(0)
    stage.add(estimator)
    before = estimator.get_parameter(name).value
    (answer,) = estimator.set_parameters([Parameter(name, value=value)])
    assert not answer.successful
    assert name in answer.reason
    assert estimator.get_parameter(name).value == before
    with pytest.raises((InputError, InvalidParameterValueException), match=name):
        OneDriver(1, **{name: value})


STATE = {"names": ["v_star", "kappa_v"], "mean": [2.0, -1.5], "covariance": [[0.1, 0.0], [0.0, 0.1]], "until_ns": 5}


@pytest.mark.parametrize(
    "changed",
    [
        {"names": ["v_star", "speed"]},
        {"names": ["v_star", "v_star"]},
        {"names": [["v_star"], "kappa_v"]},
        {"names": 7},
        {"mean": [math.nan, 0.0]},
        {"mean": [700.0, 0.0]},
        {"mean": [2.0]},
        {"covariance": [[math.nan, 0.0], [0.0, 0.1]]},
        {"covariance": [[0.1, 9.0], [9.0, 0.1]]},
        {"covariance": "text"},
        {"until_ns": 1e300},
        {"until_ns": None},
    ],
)
def test_a_damaged_state_is_refused(tmp_path: Path, changed: dict[str, Any]) -> None:
    path = tmp_path / "vehicle_00.json"
    path.write_text(json.dumps(STATE))
    assert read_learnt(path).until_ns == 5
    path.write_text(json.dumps(STATE | changed))
    with pytest.raises(InputError, match="no state that an estimator has saved"):
        read_learnt(path)


def test_events_of_a_subscription_that_was_given_up_are_ignored(stage: Any) -> None:
    """Publishers that offer less make a node subscribe anew, while the middleware still tells the old subscription."""
    listener, talker = Node("listener"), Node("talker")
    stage.add(listener)
    given_up = [listener.create_subscription(RoadMessage, "road", lambda message: None, LATCHED) for _ in range(3)]
    stage.for_a_while(0.1)
    publisher = talker.create_publisher(RoadMessage, "road", STREAM)
    time.sleep(0.3)
    for subscription in given_up:
        listener.destroy_subscription(subscription)
    stage.for_a_while(0.2)
    talker.destroy_publisher(publisher)
    talker.destroy_node()
