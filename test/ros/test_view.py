"""The node behind the live page."""

import pytest
from bokeh.document import Document
from bokeh.models import Div
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sugiyama_msgs.msg import DriverArray, Innovation, MeasuredPositions, VehicleState, Verdict

from sugiyama_ros.formats.measured import FRAME
from sugiyama_ros.nodes.base import node as base_node
from sugiyama_ros.nodes.base.qos import STREAM
from sugiyama_ros.nodes.view import View
from sugiyama_ros.page import live


def test_a_page_hears_of_drivers_who_come_and_go_in_one_message(stage) -> None:
    """As `sugiyama live` has it on tracks: one node follows all drivers."""
    view, world = View(1.0), Node("drivers")
    to_measured = world.create_publisher(MeasuredPositions, "/measured", qos_profile_sensor_data)
    to_drivers = world.create_publisher(DriverArray, "/drivers", qos_profile_sensor_data)
    stage.add(view, world)
    steps = iter(range(100_000))

    def told() -> bool:
        k = next(steps)
        vehicles = [3, 120] if k < 3 else [120]
        count = len(vehicles)
        message = MeasuredPositions(vehicle=vehicles, leader=[-2] * count, position_m=[1.0 * k] * count, step=k)
        message.length_m = [4.5] * count
        array = DriverArray(vehicle=vehicles, position_m=[1.0 * k] * count, speed=[10.0] * count)
        array.state_covariance = [0.04] * (9 * count)
        array.innovation_m, array.innovation_var, array.nis = [0.1] * count, [0.01] * count, [1.0] * count
        array.log_likelihood, array.scored = [0.0] * count, [v == 120 for v in vehicles]
        array.name, array.estimated = ["sigma_a", "v_star", "kappa_v"], [False, True, True]
        array.value, array.parameter_covariance = [0.5, 9.0, 0.3] * count, [0.25, 0.0, 0.0, 0.01] * count
        array.identified = [True] * (2 * count)
        for one in (message, array):
            one.header.frame_id = FRAME
            one.header.stamp.sec, one.header.stamp.nanosec = divmod(k * 100_000_000, 1_000_000_000)
        to_measured.publish(message)
        to_drivers.publish(array)
        return 120 in view.adapted and 3 not in view.now and 120 in view.now

    stage.until(told)
    assert view.now[120][1] == 10.0
    assert view.followers == {120}  # of the first one, who follows nobody, nothing is learnt
    assert view.adapted[120] == pytest.approx((9.0, 0.5, 0.3, 0.1))


def test_states_that_come_after_their_innovations_stand_at_their_own_times(stage) -> None:
    """As at the fastest rate: a burst of one topic arrives before the other topic."""
    view, world = View(0.0, expected=[1]), Node("world")
    to_measured = world.create_publisher(MeasuredPositions, "/measured", STREAM)
    to_state = world.create_publisher(VehicleState, "/vehicle_01/state", STREAM)
    to_innovation = world.create_publisher(Innovation, "/vehicle_01/innovation", STREAM)
    stage.add(view, world)
    stage.until(lambda: all(p.get_subscription_count() for p in (to_measured, to_state, to_innovation)))
    sent = [
        (to_innovation, lambda k: Innovation(vehicle=1, innovation_m=0.01 * k, innovation_var=0.04, scored=True)),
        (to_state, lambda k: VehicleState(vehicle=1, position_m=1.0 * k, speed=10.0 + k)),
        (
            to_measured,
            lambda k: MeasuredPositions(vehicle=[1], leader=[-1], position_m=[1.5 * k], length_m=[4.5], step=k),
        ),
    ]
    for publisher, message_of in sent:
        for k in range(40):
            message = message_of(k)
            message.header.frame_id, message.header.stamp.sec = FRAME, k
            publisher.publish(message)
    stage.until(lambda: 1 in view.driver and view.driver[1].heard == 40)
    time_s, speed, _, innovation, _, place = view.driver[1].since(0).T
    assert time_s.tolist() == list(range(40))
    assert speed == pytest.approx(10.0 + time_s)
    assert innovation == pytest.approx(0.01 * time_s)
    assert place == pytest.approx(1.5 * time_s)


def test_an_effect_that_nobody_takes_is_not_added_and_nothing_waits(stage, monkeypatch) -> None:
    """30 vehicles are on the road, but nobody estimates their drivers: the answer does not take 30 times as long."""
    view, world = View(1.0), Node("world")
    to_measured = world.create_publisher(MeasuredPositions, "/measured", STREAM)
    stage.add(view, world)
    stage.until(lambda: bool(to_measured.get_subscription_count()))
    message = MeasuredPositions(vehicle=list(range(30)), leader=[-1] * 30, position_m=[0.0] * 30, length_m=[4.5] * 30)
    message.header.frame_id = FRAME
    to_measured.publish(message)
    stage.until(lambda: len(view.vehicles) == 30)
    monkeypatch.setattr(base_node, "_READY_S", 3600.0)
    view.add("drag", "c0=0.1")
    assert view.said == "no node follows drivers"
    assert view.added == []


def test_the_page_repeats_the_words_of_the_critic(stage) -> None:
    """Best and settled are fields of the message: the largest gain alone does not make a model the best one."""
    view, world = View(1.0), Node("critic_of_others")
    to_verdict = world.create_publisher(Verdict, "/verdict", qos_profile_sensor_data)
    stage.add(view, world)
    message = Verdict(best="base", model=["base", "drag"], weight=[0.6, 0.4], strength=[0.0, 0.1], settled=True)
    message.log_likelihood = [0.0, 1.0]

    def told() -> bool:
        to_verdict.publish(message)
        return bool(view.best)

    stage.until(told)
    document = Document()
    live.page(view)(document)
    said = " ".join(div.text for div in document.select({"type": Div}))
    assert "settled among the models" in said
    assert ": the base model leads. Gains over the base model: " in said
