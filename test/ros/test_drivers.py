"""The node of all drivers: drivers come and go, and what was learnt of them stays."""

from math import nan
from pathlib import Path

import numpy as np
import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int32MultiArray
from std_srvs.srv import Trigger
from sugiyama_msgs.msg import DriverArray, MeasuredPositions
from sugiyama_msgs.msg import Road as RoadMessage

from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.nodes.base import cdr_messages
from sugiyama_ros.nodes.base.node import OK
from sugiyama_ros.nodes.base.qos import LATCHED, STREAM
from sugiyama_ros.nodes.drivers import DriversNode
from sugiyama_ros.nodes.keeper import read_learnt
from sugiyama_ros.road import Road as OpenRoad

pytestmark = [pytest.mark.ros, pytest.mark.timeout(60)]
PERIOD_S = 0.1


class Perception(Node):
    """Sends the road and single samples, and keeps what is said about the drivers."""

    def __init__(self, qos: QoSProfile = STREAM, road_qos: QoSProfile = LATCHED, space: str = "") -> None:
        super().__init__("perception")
        self.answers: list[DriverArray] = []
        self.step = 0
        self.to_road = self.create_publisher(RoadMessage, f"{space}road", road_qos)
        self.to_measured = self.create_publisher(MeasuredPositions, f"{space}measured", qos)
        self.create_subscription(DriverArray, f"{space}drivers", self.answers.append, STREAM)
        self.send_road()

    def send_road(self) -> None:
        self.to_road.publish(RoadMessage(circumference_m=0.0, period_s=PERIOD_S))

    def send(self, k: int, position_m: dict[int, float], leader: dict[int, int] | None = None) -> None:
        """Send sample k, at k periods."""
        ahead = leader or {}
        message = MeasuredPositions(step=self.step, vehicle=list(position_m))
        message.leader = [ahead.get(v, -1) for v in position_m]
        message.header.stamp = cdr_messages.time_message(round(k * PERIOD_S * cdr_messages.NS))
        message.position_m, message.length_m = list(position_m.values()), [4.5] * len(position_m)
        self.to_measured.publish(message)
        self.step += 1


def started(stage, *, perception: Perception | None = None, **parameters: object) -> tuple[Perception, DriversNode]:
    perception = perception or Perception()
    drivers = DriversNode(parameter_overrides=[Parameter(k, value=v) for k, v in parameters.items()])
    stage.add(perception, drivers)
    stage.until(lambda: "nothing heard on" in drivers.health().message)
    return perception, drivers


def test_drivers_come_and_go_and_come_again(stage, tmp_path: Path) -> None:
    """Vehicle 1 is in view from 0 to 3 s and again from 6 s on, vehicle 2 all the time."""
    perception, drivers = started(stage, retire_after=1.0, save_state=str(tmp_path))
    for k in range(100):
        gone = 30 <= k < 60
        perception.send(k, ({} if gone else {1: 1.0 * k}) | {2: 40.0 + 1.0 * k}, {1: 2})
        if k in (29, 55, 99):
            stage.until(lambda k=k: drivers.steps == k + 1)
            assert tuple(drivers.drivers) == ((2,) if gone else (1, 2) if k == 29 else (2, 1))
        if k == 55:
            kept = read_learnt(tmp_path / "vehicle_01.json")
    stage.until(lambda: len(perception.answers) == 100)
    assert [list(a.vehicle) for a in perception.answers] == [[1, 2]] * 30 + [[2]] * 30 + [[1, 2]] * 40
    values = drivers.health().values
    assert (values["came"], values["came again"], values["retired"]) == (2, 1, 1)
    # the filter goes on from what was learnt
    first = OnlineFilter(PERIOD_S, OpenRoad())
    first.recall(kept.learnt)
    again = OnlineFilter(PERIOD_S, OpenRoad())
    for k in range(60, 100):
        for one in (first, again):
            one.step([1.0 * k, 40.0 + 1.0 * k, nan], [1, 2, -1], [4.5, 4.5, 0.0], k * PERIOD_S)
    last = perception.answers[-1]
    value = dict(zip(last.name, np.reshape(last.value, (2, -1))[0].tolist(), strict=True))
    assert value["v_star"] == pytest.approx(first.parameters[2], abs=1e-9)
    assert value["v_star"] != pytest.approx(again.parameters[2], abs=1e-6)


def test_a_controlled_vehicle_is_not_followed(stage) -> None:
    """It says so by itself, after it was followed for a while; the driver behind it stays."""
    perception, drivers = started(stage, retire_after=1.0)
    to_controlled = perception.create_publisher(Int32MultiArray, "controlled", LATCHED)
    for k in range(60):
        perception.send(k, {1: 1.0 * k, 2: 40.0 + 1.0 * k}, {1: 2})
        if k == 19:
            stage.until(lambda: len(perception.answers) == 20)
            to_controlled.publish(Int32MultiArray(data=[2]))
            stage.until(lambda: drivers._feed.controlled == {2})
    stage.until(lambda: len(perception.answers) == 60)
    assert [list(a.vehicle) for a in perception.answers] == [[1, 2]] * 20 + [[1]] * 40
    assert np.isfinite(perception.answers[-1].gap_m).all()
    assert tuple(drivers.drivers) == (1,)


def test_ordinary_publishers_are_heard(stage) -> None:
    """A perception stack offers less than a replay does, for the road as well as for the positions."""
    perception = Perception(qos_profile_sensor_data, QoSProfile(depth=10))
    drivers = DriversNode()
    stage.add(perception, drivers)

    def heard() -> bool:
        perception.send_road()
        perception.send(perception.step, {1: 1.0 * perception.step})
        return bool(perception.answers)

    stage.until(heard)
    assert drivers.health().level == OK


def test_a_jump_of_the_clock_starts_the_state_anew_and_keeps_what_was_learnt(stage) -> None:
    """By half a second, which the stamps alone would not show to be a jump."""
    perception, drivers = started(stage, use_sim_time=True)
    to_clock = perception.create_publisher(Clock, "/clock", 10)
    stage.until(lambda: to_clock.get_subscription_count() == 1)

    def send(ks: range) -> None:
        for k in ks:
            to_clock.publish(Clock(clock=cdr_messages.time_message(round(k * PERIOD_S * cdr_messages.NS))))
            stage.until(lambda k=k: drivers.get_clock().now().nanoseconds == round(k * PERIOD_S * cdr_messages.NS))
            before = drivers.steps
            perception.send(k, {1: 0.8 * k})
            stage.until(lambda n=before: drivers.steps == n + 1)

    send(range(1, 61))
    assert drivers.health().values["resets"] == 0
    send(range(55, 60))
    stage.until(lambda: len(perception.answers) == 65)
    values = drivers.health().values
    assert (values["resets"], values["late"], values["duplicates"]) == (1, 0, 0)
    learnt = [dict(zip(a.name, a.value, strict=True))["v_star"] for a in perception.answers[59:]]
    # these samples were learnt from before the jump
    assert learnt == pytest.approx([learnt[0]] * 6, abs=1e-9)
    assert abs(learnt[0] - OnlineFilter(PERIOD_S, OpenRoad()).parameters[2]) > 0.1


def test_names_are_relative(stage) -> None:
    """In a namespace, and with a topic that is remapped."""
    perception = Perception(space="/ego/")
    stage.add(perception)
    drivers = DriversNode(namespace="/ego", cli_args=["--ros-args", "-r", "measured:=seen"])
    seen = perception.create_publisher(MeasuredPositions, "/ego/seen", STREAM)
    perception.to_measured = seen
    stage.add(drivers)
    stage.until(lambda: "nothing heard on" in drivers.health().message)
    perception.send(0, {1: 0.0})
    stage.until(lambda: bool(perception.answers))


def test_a_lifecycle_manager_starts_the_node(stage) -> None:
    perception = Perception()
    drivers = DriversNode(parameter_overrides=[Parameter("autostart", value=False)])
    stage.add(perception, drivers)
    answer = stage.call(GetState, "/drivers/get_state", GetState.Request())
    assert answer.current_state.id == State.PRIMARY_STATE_UNCONFIGURED
    drivers.trigger_configure()
    drivers.trigger_activate()
    stage.until(lambda: "nothing heard on" in drivers.health().message)
    perception.send(0, {1: 0.0})
    stage.until(lambda: len(perception.answers) == 1)
    drivers.trigger_deactivate()
    perception.send(1, {1: 1.0})
    stage.for_a_while(0.2)
    assert len(perception.answers) == 1
    drivers.trigger_cleanup()
    assert tuple(drivers.drivers) == ()


def test_reset_forgets_the_drivers(stage) -> None:
    perception, drivers = started(stage)
    perception.send(0, {1: 0.0})
    stage.until(lambda: tuple(drivers.drivers) == (1,))
    assert stage.call(Trigger, "/drivers/reset", Trigger.Request()).success
    assert tuple(drivers.drivers) == ()


def test_wrong_values_are_one_line(stage) -> None:
    with pytest.raises(InputError, match=r"retire_after: .* number"):
        DriversNode(parameter_overrides=[Parameter("retire_after", value="soon")])
    with pytest.raises(InputError, match=r"v_star: out of bounds; give 0.5 to 80"):
        DriversNode(parameter_overrides=[Parameter("v_star", value=-10)])
    drivers = DriversNode(parameter_overrides=[Parameter("v_star", value=10)])
    assert drivers.get_parameter("v_star").value == 10.0
    stage.add(drivers)


def test_a_damaged_saved_state_is_told_and_not_used(stage, tmp_path: Path, capfd) -> None:
    (tmp_path / "vehicle_01.json").write_text("{}")
    perception, drivers = started(stage, resume=str(tmp_path))
    perception.send(0, {1: 0.0})
    stage.until(lambda: tuple(drivers.drivers) == (1,))
    assert "vehicle_01.json: is no state" in capfd.readouterr().err


def test_after_a_jump_in_time_the_drivers_stay_known(stage) -> None:
    """The clock goes back by 10 s; vehicle 2 is not in view any more, and comes back later."""
    perception, drivers = started(stage, retire_after=1.0)
    for k in range(100, 160):
        perception.send(k, {1: 1.0 * k, 2: 40.0 + 1.0 * k})
    for k in range(30):
        perception.send(k, {1: 1.0 * k} | ({2: 40.0 + 1.0 * k} if k >= 20 else {}))
    stage.until(lambda: drivers.steps == 90)
    assert tuple(drivers.drivers) == (1, 2)
    values = drivers.health().values
    assert (values["resets"], values["came"], values["came again"], values["retired"]) == (1, 2, 1, 1)
